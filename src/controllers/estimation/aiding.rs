//! What a sensor beside the inertial unit tells of the state, and how the state takes it in.
//!
//! A sensor at r from the unit, with axes M (mount → unit), reads
//!
//! | sensor | h(x) | its slopes by the errors |
//! |---|---|---|
//! | position | p + R r | I; −R [r]ₓ by δθ |
//! | velocity | v + R (ω × r) | I; −R [ω × r]ₓ by δθ; R [r]ₓ by δb_g |
//! | attitude | 2 log(q_M* ⊗ q) | Mᵀ by δθ |
//! | pressure | p₀ (1 − a z)^c | dp/dz of the height of the mount |
//! | field | Mᵀ Rᵀ B | Mᵀ [Rᵀ B]ₓ by δθ |
//! | distance | z/cos(max(θ − α, 0)) | of height and tilt |
//! | flow | Δt (N/θ) (v_x/d − ω_y), Δt (N/θ) (v_y/d + ω_x) | of v, d, δθ, δb_g |
//!
//! Channels are taken in one after the other, about one linearisation: with independent noise that is the update of all at once, and Σ ν²/S
//! is their squared innovation, χ² with as many degrees of freedom as there are channels. Where that is beyond the gate nothing is taken in.

use super::navigation_state::{ATTITUDE, ERRORS, GYROSCOPE, NavigationState, POSITION, VELOCITY};
use autodiff::{Mask, Scalar, safe};
use dynamics::sensors::{Barometer, NoiseGrowth};
use dynamics::spatial::{Quat, Vec3, add, conjugate, constants, cross, multiply, rotate, rotate_back, scale};

/// What a sensor tells.
#[derive(Debug, Clone, PartialEq)]
pub enum AidKind {
    /// Of the mount, m, world.
    Position,
    /// Of the mount, m/s, world.
    Velocity,
    /// Mount → world, a quaternion.
    Attitude,
    /// Pa.
    Pressure(Barometer),
    /// T, mount axes, of this field, world.
    Field(Vec3<f64>),
    /// To level ground at this height, m, of a cone of this half angle, rad, with noise that may grow with it.
    Distance { ground: f64, half_cone: f64, growth: Option<NoiseGrowth> },
    /// Pixels of a picture of level ground at this height, m; Δt N/θ, s px/rad.
    Flow { ground: f64, gain: f64 },
}

impl AidKind {
    /// Channels of its innovation.
    pub fn n_channel(&self) -> usize {
        match self {
            Self::Position | Self::Velocity | Self::Attitude | Self::Field(_) => 3,
            Self::Flow { .. } => 2,
            Self::Pressure(_) | Self::Distance { .. } => 1,
        }
    }

    /// What it is called in tables.
    pub fn quantity(&self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Attitude => "attitude",
            Self::Pressure(_) => "pressure",
            Self::Field(_) => "field",
            Self::Distance { .. } => "distance",
            Self::Flow { .. } => "pixels",
        }
    }

    /// Numbers that it reads.
    pub fn n_reading(&self) -> usize {
        if *self == Self::Attitude { 4 } else { self.n_channel() }
    }
}

/// A sensor as a filter sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct Aid {
    /// What it tells.
    pub kind: AidKind,
    /// r, from the inertial unit, m, its axes.
    pub lever: Vec3<f64>,
    /// M, mount → unit.
    pub rotation: Quat<f64>,
    /// Variance of the white noise of every channel, u².
    pub variance: Vec<f64>,
    /// Number of its first bias among those beside the unit's, where it has one per channel.
    pub bias: Option<usize>,
}

/// How a measurement compared with what was expected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement<S> {
    /// νᵀ S⁻¹ ν.
    pub squared: S,
    /// 1 where it was taken in, 0 where it was beyond the gate.
    pub is_taken: S,
}

/// A channel: ν before any is taken in, and its slopes by errors, few of them.
struct Channel<S> {
    innovation: S,
    row: Vec<(usize, S)>,
    /// By what its noise is greater than usual, σ by σ.
    louder: S,
}

/// Largest correction of an estimate: what takes it further, or turns it by more than half a turn, is no reading.
const MOST_MOVED: f64 = 1e6;

/// Takes in what a sensor reads, unless its squared innovation is beyond `gate`. P is multiplied by `fading` before, where it is taken in:
/// 1, or more for one that is believed against what is known.
///
/// # Panics
/// For a reading of another length than [`AidKind::n_reading`].
pub fn correct<S: Scalar>(
    state: &mut NavigationState<S>,
    aid: &Aid,
    reading: &[S],
    [gate, fading]: [S; 2],
) -> Agreement<S> {
    let mut channels = aid.channels(state, reading);
    if let Some(first) = aid.bias {
        for (k, channel) in channels.iter_mut().enumerate() {
            channel.innovation -= state.biases[first + k];
            channel.row.push((ERRORS + first + k, S::one()));
        }
    }
    let n = state.n_error();
    let mut moved = vec![S::zero(); n];
    let mut covariance: Vec<S> = state.covariance.iter().map(|p| *p * fading).collect();
    let mut squared = S::zero();
    let mut sound = S::zero().lt(S::one());
    for (channel, variance) in channels.iter().zip(&aid.variance) {
        let seen: Vec<S> = (0..n).map(|i| sum(channel.row.iter().map(|(j, h)| covariance[i * n + j] * *h))).collect();
        let spread = sum(channel.row.iter().map(|(j, h)| seen[*j] * *h))
            + S::constant(*variance) * channel.louder * channel.louder;
        let left = channel.innovation - sum(channel.row.iter().map(|(j, h)| moved[*j] * *h));
        sound = sound.and(S::zero().lt(spread));
        let weight = spread.recip();
        squared += left * left * weight;
        let gain: Vec<S> = seen.iter().map(|s| *s * weight).collect();
        moved.iter_mut().zip(&gain).for_each(|(m, k)| *m += *k * left);
        for i in 0..n {
            for j in i..n {
                let own = covariance[i * n + j] - gain[i] * seen[j];
                (covariance[i * n + j], covariance[j * n + i]) = (own, own);
            }
        }
    }
    let far = |range: std::ops::Range<usize>| sum(moved[range].iter().map(|m| *m * *m));
    let is_near = far(0..n).lt(S::constant(MOST_MOVED * MOST_MOVED));
    let is_turn = far(ATTITUDE..ATTITUDE + 3).lt(S::constant(std::f64::consts::PI.powi(2)));
    let taken = squared.lt(gate).and(sound).and(is_near).and(is_turn);
    let mut next = state.clone();
    next.covariance = covariance;
    next.move_by(&moved);
    state.choose(taken, &next);
    Agreement { squared, is_taken: S::select(taken, S::one(), S::zero()) }
}

fn sum<S: Scalar>(terms: impl Iterator<Item = S>) -> S {
    terms.fold(S::zero(), |sum, x| sum + x)
}

/// Rows of a 3 × 3 slope that begins at an error.
fn rows<S: Scalar>(first: usize, slope: [Vec3<S>; 3]) -> [Vec<(usize, S)>; 3] {
    slope.map(|row| row.iter().enumerate().map(|(j, h)| (first + j, *h)).collect())
}

/// The matrix whose product with a vector is `f` of it, by rows.
fn matrix_of<S: Scalar>(f: impl Fn(Vec3<S>) -> Vec3<S>) -> [Vec3<S>; 3] {
    let columns = [0, 1, 2].map(|j| f([0, 1, 2].map(|k| if k == j { S::one() } else { S::zero() })));
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| columns[j][i]))
}

impl Aid {
    /// Height of the mount, m, and its slopes.
    fn height<S: Scalar>(&self, state: &NavigationState<S>) -> (S, Vec<(usize, S)>) {
        let lever = constants(self.lever);
        let z = state.position[2] + rotate(state.attitude, lever)[2];
        // e_zᵀ(−R [r]ₓ δθ) = −(r × Rᵀe_z)… of the turn
        let down = rotate_back(state.attitude, [S::zero(), S::zero(), S::one()]);
        let turned = cross(lever, down);
        let mut row = vec![(POSITION + 2, S::one())];
        row.extend((0..3).map(|j| (ATTITUDE + j, turned[j])));
        (z, row)
    }

    fn channels<S: Scalar>(&self, state: &NavigationState<S>, reading: &[S]) -> Vec<Channel<S>> {
        let q = state.attitude;
        let lever: Vec3<S> = constants(self.lever);
        let mount: Quat<S> = self.rotation.map(S::constant);
        let read = |k: usize| reading[k];
        let three = |told: Vec3<S>, expected: Vec3<S>, slopes: Vec<[Vec<(usize, S)>; 3]>| -> Vec<Channel<S>> {
            (0..3)
                .map(|i| Channel {
                    innovation: told[i] - expected[i],
                    row: slopes.iter().flat_map(|s| s[i].iter().copied()).collect(),
                    louder: S::one(),
                })
                .collect()
        };
        let identity = |first: usize| [0, 1, 2].map(|i| vec![(first + i, S::one())]);
        let one = |told: S, expected: S, row: Vec<(usize, S)>| {
            vec![Channel { innovation: told - expected, row, louder: S::one() }]
        };
        match &self.kind {
            AidKind::Position => {
                let at = add(state.position, rotate(q, lever));
                let turned = rows(ATTITUDE, matrix_of(|turn| rotate(q, cross(turn, lever))));
                three([0, 1, 2].map(read), at, vec![identity(POSITION), turned])
            }
            AidKind::Velocity => {
                let swung = cross(state.angular_velocity(), lever);
                let at = add(state.velocity, rotate(q, swung));
                let turned = rows(ATTITUDE, matrix_of(|turn| rotate(q, cross(turn, swung))));
                let biased = rows(GYROSCOPE, matrix_of(|bias| rotate(q, cross(lever, bias))));
                three([0, 1, 2].map(read), at, vec![identity(VELOCITY), turned, biased])
            }
            AidKind::Attitude => {
                let told = [0, 1, 2, 3].map(read);
                let off = multiply(conjugate(multiply(q, mount)), told);
                // 2 vec on the shorter way: the sine of half the turn, twice
                let side = S::select(off[0].lt(S::zero()), S::constant(-2.0), S::constant(2.0));
                let turned = rows(ATTITUDE, matrix_of(|turn| rotate_back(mount, turn)));
                three(scale(side, [off[1], off[2], off[3]]), [S::zero(); 3], vec![turned])
            }
            AidKind::Field(field) => {
                let here = rotate_back(q, constants(*field));
                let expected = rotate_back(mount, here);
                let turned = rows(ATTITUDE, matrix_of(|turn| rotate_back(mount, cross(here, turn))));
                three([0, 1, 2].map(read), expected, vec![turned])
            }
            AidKind::Pressure(barometer) => {
                let (z, row) = self.height(state);
                let [pressure, slope] = barometer.pressure_at(z);
                one(read(0), pressure, row.into_iter().map(|(j, h)| (j, h * slope)).collect())
            }
            AidKind::Distance { ground, half_cone, growth } => {
                let (expected, row) = self.distance(state, *ground, *half_cone);
                let louder = growth.map_or(S::one(), |growth| grown(growth, expected));
                vec![Channel { innovation: read(0) - expected, row, louder }]
            }
            AidKind::Flow { ground, gain } => self.flow(state, reading, *ground, *gain),
        }
    }

    /// cos of the tilt of the mount's axis and its slopes by δθ.
    fn upright<S: Scalar>(&self, state: &NavigationState<S>) -> (S, Vec3<S>) {
        let axis = rotate(self.rotation.map(S::constant), [S::zero(), S::zero(), S::one()]);
        let c = rotate(state.attitude, axis)[2];
        // e_zᵀ R (δθ × m) = δθ · (m × Rᵀe_z)
        let down = rotate_back(state.attitude, [S::zero(), S::zero(), S::one()]);
        (c, cross(axis, down))
    }

    /// Of ground within a cone, m, and its slopes.
    fn distance<S: Scalar>(&self, state: &NavigationState<S>, ground: f64, half: f64) -> (S, Vec<(usize, S)>) {
        let (z, mut row) = self.height(state);
        let (c, turned) = self.upright(state);
        let height = z - S::constant(ground);
        let (sin, cos) = half.sin_cos();
        let least = S::constant(0.05);
        let s = safe::sqrt(S::one() - c * c, 1e-6);
        // cos(θ − α), held above 87°: flatter a cone sees no ground
        let leaned = c * S::constant(cos) + s * S::constant(sin);
        let is_within = S::constant(cos).lt(c);
        let is_flat = leaned.lt(least);
        let leaned = S::select(is_within, S::one(), S::select(is_flat, least, leaned));
        let is_held = is_within.or(is_flat);
        let by_cos = S::select(is_held, S::zero(), S::constant(cos) - c / s * S::constant(sin));
        let share = leaned.recip();
        row.iter_mut().for_each(|(_, h)| *h *= share);
        let by_lean = -(height * share * share * by_cos);
        // heights know the turn too: the same errors, a second time
        row.extend((0..3).map(|j| (ATTITUDE + j, by_lean * turned[j])));
        (height * share, merged(row))
    }

    fn flow<S: Scalar>(&self, state: &NavigationState<S>, reading: &[S], ground: f64, gain: f64) -> Vec<Channel<S>> {
        let q = state.attitude;
        let lever: Vec3<S> = constants(self.lever);
        let mount: Quat<S> = self.rotation.map(S::constant);
        let rate = state.angular_velocity();
        let (d, by_d) = self.distance(state, ground, 0.0);
        let own = rotate_back(q, state.velocity);
        let seen = rotate_back(mount, add(own, cross(rate, lever)));
        let turning = rotate_back(mount, rate);
        let by_velocity = matrix_of(|v| rotate_back(mount, rotate_back(q, v)));
        let by_turn = matrix_of(|turn| rotate_back(mount, cross(own, turn)));
        let by_bias = matrix_of(|bias| rotate_back(mount, cross(lever, bias)));
        let bias_turns = matrix_of(|bias| rotate_back(mount, bias));
        let (near, k) = (d.recip(), S::constant(gain));
        (0..2)
            .map(|i| {
                // n_x = k (v_x/d − ω_y), n_y = k (v_y/d + ω_x)
                let (other, sign) = if i == 0 { (1, S::constant(-1.0)) } else { (0, S::one()) };
                let expected = k * (seen[i] * near + sign * turning[other]);
                let mut row: Vec<(usize, S)> = Vec::new();
                for j in 0..3 {
                    row.push((VELOCITY + j, k * near * by_velocity[i][j]));
                    row.push((ATTITUDE + j, k * near * by_turn[i][j]));
                    row.push((GYROSCOPE + j, k * (near * by_bias[i][j] - sign * bias_turns[other][j])));
                }
                row.extend(by_d.iter().map(|(j, h)| (*j, -(k * seen[i] * near * near * *h))));
                Channel { innovation: reading[i] - expected, row: merged(row), louder: S::one() }
            })
            .collect()
    }
}

/// 1 + factor^((d − from)/(until − from)), as far as `until`.
fn grown<S: Scalar>(growth: NoiseGrowth, distance: S) -> S {
    let share = (distance - S::constant(growth.from)) * S::constant(1.0 / (growth.until - growth.from));
    let share = S::select(share.lt(S::one()), share, S::one());
    S::one() + (share * S::constant(growth.factor.ln())).exp()
}

/// Every error once.
fn merged<S: Scalar>(row: Vec<(usize, S)>) -> Vec<(usize, S)> {
    let mut once: Vec<(usize, S)> = Vec::new();
    for (j, h) in row {
        match once.iter_mut().find(|(own, _)| *own == j) {
            Some((_, sum)) => *sum += h,
            None => once.push((j, h)),
        }
    }
    once
}

impl<S: Scalar> NavigationState<S> {
    /// `other` where the mask holds.
    fn choose(&mut self, mask: S::Mask, other: &Self) {
        let n_bias = self.biases.len();
        let mut flat = [vec![S::zero(); Self::n_flat(n_bias)], vec![S::zero(); Self::n_flat(n_bias)]];
        let [own, new] = &mut flat;
        self.write(own);
        other.write(new);
        own.iter_mut().zip(new).for_each(|(own, new)| *own = S::select(mask, *new, *own));
        *self = Self::read(own, n_bias);
    }
}

#[cfg(test)]
mod tests {
    use super::super::navigation_state::{InertialNoise, predict};
    use super::*;
    use rng::{Purpose, Stream};

    fn state(draw: &mut Stream, n_bias: usize) -> NavigationState<f64> {
        let mut three = |size: f64| [0, 1, 2].map(|_| size * draw.normal());
        let [position, velocity, read_rate] = [three(0.5), three(2.0), three(1.0)];
        let turn = three(0.3);
        let n = ERRORS + n_bias;
        NavigationState {
            position: [position[0], position[1], 2.0 + position[2].abs()],
            velocity,
            attitude: dynamics::spatial::exponential(turn),
            read_rate,
            accelerometer_bias: three(0.1),
            gyroscope_bias: three(0.05),
            biases: (0..n_bias).map(|_| draw.normal()).collect(),
            covariance: vec![0.0; n * n],
        }
    }

    fn moved(state: &NavigationState<f64>, error: usize, by: f64) -> NavigationState<f64> {
        let mut e = vec![0.0; state.n_error()];
        e[error] = by;
        let mut own = state.clone();
        own.move_by(&e);
        own
    }

    #[test]
    fn slopes_of_every_aid_are_those_of_differences() {
        let mut draw = Stream::new(5, 0, 0, Purpose::TASK);
        let kinds = [
            AidKind::Position,
            AidKind::Velocity,
            AidKind::Attitude,
            AidKind::Pressure(Barometer { altitude: 400.0, ..Barometer::default() }),
            AidKind::Field([21.5, 1.0, -43.0]),
            AidKind::Distance { ground: -0.3, half_cone: 0.0, growth: None },
            AidKind::Distance { ground: 0.2, half_cone: 0.05, growth: None },
            AidKind::Distance { ground: 0.2, half_cone: 1.2, growth: None },
            AidKind::Flow { ground: 0.1, gain: 0.49 },
        ];
        let mut worst: f64 = 0.0;
        for kind in kinds {
            for _ in 0..20 {
                let own = state(&mut draw, 4);
                let turn = [0, 1, 2].map(|_| 0.3 * draw.normal());
                let aid = Aid {
                    lever: [0, 1, 2].map(|_| 0.2 * draw.normal()),
                    rotation: dynamics::spatial::exponential(turn),
                    variance: vec![1.0; kind.n_channel()],
                    bias: None,
                    kind: kind.clone(),
                };
                let turned = multiply(own.attitude, dynamics::spatial::exponential([0.02, -0.01, 0.03]));
                let reading = match kind {
                    // near what is expected: twice a sine is the angle to third order
                    AidKind::Attitude => multiply(turned, aid.rotation).to_vec(),
                    _ => vec![1.0; kind.n_reading()],
                };
                let rows = aid.channels(&own, &reading);
                for error in 0..own.n_error() {
                    let h = 1e-6;
                    let ahead = aid.channels(&moved(&own, error, h), &reading);
                    let behind = aid.channels(&moved(&own, error, -h), &reading);
                    for (i, channel) in rows.iter().enumerate() {
                        let slope: f64 = channel.row.iter().filter(|(j, _)| *j == error).map(|(_, h)| h).sum();
                        let wanted = -(ahead[i].innovation - behind[i].innovation) / (2.0 * h);
                        let size = 1.0 + wanted.abs();
                        // the attitude's is that at the truth
                        let bound = match kind {
                            AidKind::Attitude => 0.05,
                            // rounding of 1e5 Pa
                            AidKind::Pressure(_) => 1e-4,
                            _ => 1e-6,
                        };
                        assert!((slope - wanted).abs() <= bound * size, "{kind:?} {i} by {error}: {slope} {wanted}");
                        if bound == 1e-6 {
                            worst = worst.max((slope - wanted).abs() / size);
                        }
                    }
                }
            }
        }
        println!("slopes off by {worst:.1e}");
    }

    #[test]
    fn errors_go_on_as_differences_of_states_do() {
        let mut draw = Stream::new(6, 0, 0, Purpose::TASK);
        let none = InertialNoise { accelerometer: [0.0; 3], gyroscope: [0.0; 3], biases: vec![[0.99, 0.0]; 8] };
        for dt in [0.002, 0.02] {
            for _ in 0..20 {
                let own = state(&mut draw, 2);
                let f = [0, 1, 2].map(|k| draw.normal() + if k == 2 { 9.81 } else { 0.0 });
                let rate = [0, 1, 2].map(|_| draw.normal());
                let n = own.n_error();
                let mut nominal = own.clone();
                predict(&mut nominal, [f, rate], &none, [dt, 9.81]);
                for error in 0..n {
                    let mut given = own.clone();
                    given.covariance[error * (n + 1)] = 1.0;
                    predict(&mut given, [f, rate], &none, [dt, 9.81]);
                    let h = 1e-5;
                    let differ = |by: f64| {
                        let mut other = moved(&own, error, by);
                        predict(&mut other, [f, rate], &none, [dt, 9.81]);
                        let off = multiply(conjugate(nominal.attitude), other.attitude);
                        let mut e = Vec::new();
                        e.extend((0..3).map(|k| other.position[k] - nominal.position[k]));
                        e.extend((0..3).map(|k| other.velocity[k] - nominal.velocity[k]));
                        e.extend((0..3).map(|k| 2.0 * off[1 + k]));
                        e.extend((0..3).map(|k| other.accelerometer_bias[k] - nominal.accelerometer_bias[k]));
                        e.extend((0..3).map(|k| other.gyroscope_bias[k] - nominal.gyroscope_bias[k]));
                        e.extend(other.biases.iter().zip(&nominal.biases).map(|(a, b)| a - b));
                        e
                    };
                    let slope: Vec<f64> = differ(h).iter().zip(differ(-h)).map(|(a, b)| (a - b) / (2.0 * h)).collect();
                    for i in 0..n {
                        for j in 0..n {
                            let (found, wanted) = (given.covariance[i * n + j], slope[i] * slope[j]);
                            // half the turn of a step is left out of the slope of attitude by a bias of the rate
                            let bound = 2.0 * dt * dt * (1.0 + wanted.abs());
                            assert!((found - wanted).abs() <= bound, "{dt} {error}: {i} {j}: {found} {wanted}");
                        }
                    }
                }
            }
        }
    }
}
