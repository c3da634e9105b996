//! Where an inertial unit is, how well that is known, and how both go on from one of its samples to the next.
//!
//! ```text
//! x = (p, v, q, ω, b_a, b_g, b)      place and velocity of the inertial unit, world; q its axes → world; ω as it read last; biases
//! e = (δp, δv, δθ, δb_a, δb_g, δb)   x_true = x ⊕ e, with q_true = q ⊗ exp(δθ): δθ about the unit's axes
//!
//! θ = (½ (ω + ω⁺) − b_g) Δt          q⁺ = q ⊗ exp(θ)
//! v⁺ = v + (R(q ⊗ exp(θ/2)) (f⁺ − b_a) + g) Δt          p⁺ = p + ½ (v + v⁺) Δt
//!
//! δv⁺ = δv − R_m [f]ₓ δθ_m Δt − R_m δb_a Δt + n_v         δθ⁺ = exp(θ)ᵀ δθ − δb_g Δt + n_θ
//! ```
//!
//! An accelerometer tells the mean of the specific force since its last sample, a gyroscope the rate at the sample: so do the sensors of
//! [`dynamics::sensors`]. P goes along as P⁺ = F P Fᵀ + Q with F by blocks.
//!
//! Source: Solà 2017, chapters 5 and 6 (errors in the body's axes).

use autodiff::{Array, Scalar};
use dynamics::spatial::{
    Quat, Vec3, add, axpy, cross, exponential, multiply, neg, rotate, rotate_back, scale, sub, unit,
};

/// Numbers of x before the biases of other sensors: p, v, q, ω, b_a, b_g.
pub const NAVIGATION: usize = 19;
/// Errors that go with them: δp, δv, δθ, δb_a, δb_g.
pub const ERRORS: usize = 15;

/// Where errors lie.
pub const POSITION: usize = 0;
pub const VELOCITY: usize = 3;
pub const ATTITUDE: usize = 6;
pub const ACCELEROMETER: usize = 9;
pub const GYROSCOPE: usize = 12;

/// Largest number of a mean, and largest variance: what is beyond is rounding.
const MOST: f64 = 1e9;
const MOST_SQUARED: f64 = 1e12;
/// Deviation of places (m) and velocities (m/s) of which nothing is known.
const MOST_UNKNOWN: f64 = 1e3;

/// An estimate over any scalar.
#[derive(Debug, Clone, PartialEq)]
pub struct NavigationState<S> {
    /// p, m, world.
    pub position: Vec3<S>,
    /// v, m/s, world.
    pub velocity: Vec3<S>,
    /// q, axes of the inertial unit → world.
    pub attitude: Quat<S>,
    /// ω as read last, rad/s, axes of the unit, with its bias.
    pub read_rate: Vec3<S>,
    /// b_a, m/s².
    pub accelerometer_bias: Vec3<S>,
    /// b_g, rad/s.
    pub gyroscope_bias: Vec3<S>,
    /// Of other sensors, in their units.
    pub biases: Vec<S>,
    /// P, n × n by rows, of the errors in the order above.
    pub covariance: Vec<S>,
}

impl<S: Scalar> NavigationState<S> {
    /// n.
    pub fn n_error(&self) -> usize {
        ERRORS + self.biases.len()
    }

    /// Numbers of the flat form of a state with so many biases: x, then P row by row.
    pub fn n_flat(n_bias: usize) -> usize {
        NAVIGATION + n_bias + (ERRORS + n_bias).pow(2)
    }

    /// From the flat form.
    pub fn read(flat: &[S], n_bias: usize) -> Self {
        let end = NAVIGATION + n_bias;
        Self {
            position: flat.array(0),
            velocity: flat.array(3),
            attitude: flat.array(6),
            read_rate: flat.array(10),
            accelerometer_bias: flat.array(13),
            gyroscope_bias: flat.array(16),
            biases: flat[NAVIGATION..end].to_vec(),
            covariance: flat[end..Self::n_flat(n_bias)].to_vec(),
        }
    }

    /// The mean alone, of the flat form number by number: without biases of other sensors, and without P.
    pub fn mean(number: impl Fn(usize) -> S) -> Self {
        let three = |at: usize| [number(at), number(at + 1), number(at + 2)];
        Self {
            position: three(0),
            velocity: three(3),
            attitude: [number(6), number(7), number(8), number(9)],
            read_rate: three(10),
            accelerometer_bias: three(13),
            gyroscope_bias: three(16),
            biases: Vec::new(),
            covariance: Vec::new(),
        }
    }

    /// Writes the flat form.
    pub fn write(&self, flat: &mut [S]) {
        let blocks: [&[S]; 8] = [
            &self.position,
            &self.velocity,
            &self.attitude,
            &self.read_rate,
            &self.accelerometer_bias,
            &self.gyroscope_bias,
            &self.biases,
            &self.covariance,
        ];
        let mut at = 0;
        for block in blocks {
            flat[at..at + block.len()].copy_from_slice(block);
            at += block.len();
        }
    }

    /// The flat form.
    pub fn flat(&self) -> Vec<S> {
        let mut flat = vec![S::zero(); Self::n_flat(self.biases.len())];
        self.write(&mut flat);
        flat
    }

    /// ω without its bias, rad/s, axes of the unit.
    pub fn angular_velocity(&self) -> Vec3<S> {
        sub(self.read_rate, self.gyroscope_bias)
    }

    /// x ⊕ e, e `[n]`. P is turned with the attitude: δθ is about other axes now.
    pub fn move_by(&mut self, error: &[S]) {
        self.position = add(self.position, error.array(POSITION));
        self.velocity = add(self.velocity, error.array(VELOCITY));
        let turn: Vec3<S> = error.array(ATTITUDE);
        self.attitude = unit(multiply(self.attitude, exponential(turn)));
        self.accelerometer_bias = add(self.accelerometer_bias, error.array(ACCELEROMETER));
        self.gyroscope_bias = add(self.gyroscope_bias, error.array(GYROSCOPE));
        self.biases.iter_mut().zip(&error[ERRORS..]).for_each(|(b, e)| *b += *e);
        let half = scale(S::constant(-0.5), turn);
        self.both_sides(|column| {
            let own: Vec3<S> = column.array(ATTITUDE);
            column[ATTITUDE..ATTITUDE + 3].copy_from_slice(&add(own, cross(half, own)));
        });
    }

    /// P ← F P Fᵀ, F given by what it makes of a column.
    fn both_sides(&mut self, f: impl Fn(&mut [S])) {
        let n = self.n_error();
        let p = &mut self.covariance;
        // rows are columns of a symmetric matrix
        p.chunks_exact_mut(n).for_each(&f);
        let mut column = vec![S::zero(); n];
        for j in 0..n {
            (0..n).for_each(|i| column[i] = p[i * n + j]);
            f(&mut column);
            // a variance that rounding takes below zero is none
            column[j] = column[j].max(S::zero());
            // the upper half is computed once
            (0..=j).for_each(|i| (p[i * n + j], p[j * n + i]) = (column[i], column[i]));
        }
    }
}

/// Where a variance or a number of the mean is none, or beyond all that flies, after readings that made no sense: knows nothing but
/// where the numbers are that are some. Whether that was so.
pub(super) fn begin_anew(flat: &mut [f64], bias_start: &[f64]) -> bool {
    let n_bias = bias_start.len() - 6;
    let (n, mean) = (ERRORS + n_bias, NAVIGATION + n_bias);
    let is_number = |x: f64| x.abs() <= MOST;
    let is_variance = |p: f64| (0.0..=MOST_SQUARED).contains(&p);
    let covariance = &flat[mean..];
    if flat[..mean].iter().all(|x| is_number(*x)) && (0..n).all(|i| is_variance(covariance[i * (n + 1)])) {
        return false;
    }
    flat[..mean].iter_mut().filter(|x| !is_number(**x)).for_each(|x| *x = 0.0);
    let length = flat[6..10].iter().map(|q| q * q).sum::<f64>().sqrt();
    if length > 0.5 {
        flat[6..10].iter_mut().for_each(|q| *q /= length);
    } else {
        flat[6..10].copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
    }
    let covariance = &mut flat[mean..];
    covariance.fill(0.0);
    let nothing = [MOST_UNKNOWN, MOST_UNKNOWN, std::f64::consts::PI].map(|d| d * d);
    let variances = nothing.iter().flat_map(|d| [*d; 3]).chain(bias_start.iter().copied());
    variances.enumerate().for_each(|(i, p)| covariance[i * (n + 1)] = p);
    true
}

/// Variances of what a sample of an inertial unit adds, and its biases.
#[derive(Debug, Clone, PartialEq)]
pub struct InertialNoise<S> {
    /// Of the accelerometer, (m/s²)², per axis.
    pub accelerometer: Vec3<S>,
    /// Of the gyroscope, (rad/s)².
    pub gyroscope: Vec3<S>,
    /// φ and q of every bias, in the order of the errors: `[6 + n_bias]`.
    pub biases: Vec<[S; 2]>,
}

/// One sample further: `f` the specific force (m/s²) and `rate` (rad/s) that the unit reads `dt` seconds after the last sample, gravity
/// along −z in m/s².
pub fn predict<S: Scalar>(
    state: &mut NavigationState<S>,
    [f, rate]: [Vec3<S>; 2],
    noise: &InertialNoise<S>,
    [dt, gravity]: [f64; 2],
) {
    let (h, half) = (S::constant(dt), S::constant(0.5));
    let mean = sub(scale(half, add(state.read_rate, rate)), state.gyroscope_bias);
    let turn = scale(h, mean);
    let middle = multiply(state.attitude, exponential(scale(half, turn)));
    let force = sub(f, state.accelerometer_bias);
    let acceleration = add(rotate(middle, force), [S::zero(), S::zero(), S::constant(-gravity)]);
    let velocity = axpy(state.velocity, h, acceleration);
    state.position = axpy(state.position, S::constant(0.5 * dt), add(state.velocity, velocity));
    state.velocity = velocity;
    let whole = exponential(turn);
    state.attitude = unit(multiply(state.attitude, whole));
    state.read_rate = rate;
    // b ← φ b
    let decays = noise.biases.iter().map(|[decay, _]| *decay);
    let own = state.accelerometer_bias.iter_mut().chain(&mut state.gyroscope_bias).chain(&mut state.biases);
    own.zip(decays).for_each(|(b, decay)| *b *= decay);
    let to_middle = exponential(scale(half, turn));
    state.both_sides(|column| {
        let [p, v, turned, a, g]: [Vec3<S>; 5] = [0, 3, 6, 9, 12].map(|at| column.array(at));
        // δθ at the middle of the step, in the axes there
        let there = axpy(rotate_back(to_middle, turned), S::constant(-0.5 * dt), g);
        let pushed = sub(neg(cross(force, there)), a);
        let faster = axpy(v, h, rotate(middle, pushed));
        column[POSITION..3].copy_from_slice(&axpy(p, S::constant(0.5 * dt), add(v, faster)));
        column[VELOCITY..6].copy_from_slice(&faster);
        column[ATTITUDE..9].copy_from_slice(&axpy(rotate_back(whole, turned), -h, g));
        column[ACCELEROMETER..].iter_mut().zip(&noise.biases).for_each(|(b, [decay, _])| *b *= *decay);
    });
    add_noise(state, middle, noise, dt);
}

/// P += Q.
fn add_noise<S: Scalar>(state: &mut NavigationState<S>, middle: Quat<S>, noise: &InertialNoise<S>, dt: f64) {
    let n = state.n_error();
    let p = &mut state.covariance;
    let (square, half) = (S::constant(dt * dt), S::constant(0.5 * dt));
    let turned = dynamics::spatial::matrix(middle);
    for i in 0..3 {
        for j in 0..3 {
            // R diag(σ²) Rᵀ Δt²: of a velocity, and half a step later of a place
            let own = (0..3).map(|k| turned[i][k] * noise.accelerometer[k] * turned[j][k]);
            let own = own.fold(S::zero(), |sum, x| sum + x) * square;
            p[(VELOCITY + i) * n + VELOCITY + j] += own;
            p[(POSITION + i) * n + VELOCITY + j] += own * half;
            p[(VELOCITY + i) * n + POSITION + j] += own * half;
            p[(POSITION + i) * n + POSITION + j] += own * half * half;
        }
        p[(ATTITUDE + i) * (n + 1)] += noise.gyroscope[i] * square;
    }
    noise.biases.iter().enumerate().for_each(|(k, [_, drive])| p[(ACCELEROMETER + k) * (n + 1)] += *drive);
}
