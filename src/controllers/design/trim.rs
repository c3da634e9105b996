//! Steady flight: states and commands under which a plant goes on as it is.
//!
//! A steady flight repeats itself in axes that move with velocity v and turn about the vertical at r: hover, forward and
//! climbing flight, turns, tilted hover. One step of the plant must
//! therefore give, of every number but the places of roots,
//!
//! ```text
//! v⁺ = R_z(r dt) v,   q⁺ = q_z(r dt) ⊗ q,   all else⁺ = all else
//! ```
//!
//! in the numbers of the [error state](super::error_state). What is not prescribed is found by Gauss–Newton steps of least
//! norm from hover, commands within their limits; where there are more commands than conditions the answer lies near hover's.

use super::error_state::{ErrorState, quaternion};
use crate::HoverAxes;
use crate::allocation::Spin;
use crate::allocation::failure::{Assessment, Capability};
use autodiff::{System, linearise};
use base::error::{Error, Result};
use dynamics::rotor::{LEAST_THRUST, holding_action, thrust_action};
use dynamics::spatial::{Vec3, conjugate, dot, from_euler, multiply, rotate};
use dynamics::{Disturbance, Physics, Plant, Vehicle};
use nalgebra::{DMatrix, DVector};

/// Rates of change that count as none: m/s², rad/s², rad/s, shares of a rotor's speed per second.
pub const STEADY: f64 = 1e-8;
/// And this share of what a whole command or a unit of the state changes them by: their rounding, which is more where hardly any
/// inertia is moved.
const ROUNDED: f64 = 1e-13;
/// Most Gauss–Newton steps.
const MOST: usize = 200;
/// Most sweeps for one step's singular values: some two are needed for each.
const SWEEPS: usize = 10_000;

/// A steady flight that is asked for. The heading is 0: of body x, or of what points forward where hover leans.
#[derive(Debug, Clone, PartialEq)]
pub struct TrimTarget {
    /// Velocity of every root along the axes that turn, m/s: forward, left, up; what is not given is found.
    pub velocity: [Option<f64>; 3],
    /// Rate about the vertical, rad/s.
    pub yaw_rate: f64,
    /// Roll and pitch of every root, rad; what is not given is found.
    pub tilt: [Option<f64>; 2],
    /// Wind, force and moment; plays no part where the plant's effect is off.
    pub air: Disturbance<f64>,
}

impl TrimTarget {
    /// At rest in still air.
    pub fn hover() -> Self {
        Self::at_velocity([0.0; 3])
    }

    /// Straight flight in still air.
    pub fn at_velocity(velocity: [f64; 3]) -> Self {
        Self { velocity: velocity.map(Some), yaw_rate: 0.0, tilt: [None; 2], air: Disturbance::none() }
    }
}

/// A steady flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Trim {
    /// The plant's state, `[n_state]`, roots at the places of its hover state.
    pub state: Vec<f64>,
    /// The plant's input, `[n_input]`.
    pub input: Vec<f64>,
    /// Rate about the vertical, rad/s.
    pub yaw_rate: f64,
    /// The largest rate of change that is left (see `STEADY`).
    pub residual: f64,
    /// Commands that stand at a limit: places in the input.
    pub limited: Vec<usize>,
}

/// The steady flight of `target`, from hover.
///
/// # Errors
/// [`Error::Value`] if there is none that Gauss–Newton steps come to: the number that changes most is named; or if the plant
/// cannot hover, or a number of the target is not finite.
pub fn trim(plant: &Plant, target: &TrimTarget) -> Result<Trim> {
    let state = plant.hover_state()?;
    let mut input = vec![0.0; plant.n_input()];
    for rotor in plant.rotor_places() {
        input[rotor.action] = holding_action(rotor.max_speed, state[rotor.speed]);
    }
    trim_from(plant, target, &state, &input)
}

/// The turn in place of a damaged vehicle that must spin to stay up, near the [`Spin`] of its assessment: its centre goes round a
/// vertical axis, and all else stays as it is in axes that turn with it. `axes` are those in which the whole vehicle hovers level: the
/// spin's are theirs.
///
/// # Errors
/// As [`trim`]; [`Error::Value`] unless `plant` is one rigid vehicle with one rotor per thrust.
pub fn trim_spin(plant: &Plant, spin: &Spin, axes: &HoverAxes<f64>) -> Result<Trim> {
    let rotors = plant.rotor_places();
    if !matches!(plant, Plant::Rigid(_)) || rotors.len() != spin.thrusts.len() {
        let (value, remedy) = (format!("of {} rotors", spin.thrusts.len()), "Assess the vehicle that the plant is of.");
        return Err(Error::value("trim: spin", value, format!("of the rotors of '{}'", plant.name()), remedy));
    }
    let (mut state, mut input) = (vec![0.0; plant.n_state()], vec![0.0; plant.n_input()]);
    let [x, y, z] = spin.axis;
    // the shortest turn from the axis to the vertical
    let turn = [1.0 + z, y, -x, 0.0].map(|v| v / (2.0 + 2.0 * z).sqrt());
    state[6..10].copy_from_slice(&axes.attitude(turn));
    state[10..13].copy_from_slice(&axes.to_body(spin.axis.map(|n| spin.rate * n / z)));
    for (rotor, (thrust, own)) in rotors.iter().zip(spin.thrusts.iter().zip(plant.rotors())) {
        let share = (thrust / own.max_thrust().max(1e-12)).clamp(LEAST_THRUST, 1.0);
        (state[rotor.speed], input[rotor.action]) = (share.sqrt() * rotor.max_speed, thrust_action(share));
    }
    let target = TrimTarget { velocity: [None, None, Some(0.0)], yaw_rate: spin.rate / z, ..TrimTarget::hover() };
    search(plant, &target, &state, &input, axes)
}

/// The plant of a vehicle whose rotor i is left the share `health[i]`, and its steady flight: that of `target` or, where it must spin to
/// stay up, the turn in place near hover.
///
/// # Errors
/// [`Error::Value`] where what is left holds no steady flight, or must spin and `target` is not hover; otherwise as [`trim`] and
/// [`Plant::damaged`].
pub fn trim_damaged(vehicle: &Vehicle, physics: Physics, health: &[f64], target: &TrimTarget) -> Result<(Plant, Trim)> {
    let left = Assessment::of(vehicle, health)?;
    let plant = Plant::of_vehicle(vehicle, physics)?.damaged(health)?;
    let refused =
        |rule: &str, remedy: &str| Err(Error::value("health of the rotors", format!("{health:?}"), rule, remedy));
    let found = match (left.capability, &left.spin) {
        (Capability::None, _) => {
            return refused(
                "enough for a steady flight that is known",
                "Leave the lost rotor a share: 1:0.6 for --fail, {1: 0.6} in Python.",
            );
        }
        // what holds the yaw by less than counts for steering may hold it still
        (Capability::YawSacrificed, _) => match trim(&plant, target) {
            Ok(found) => found,
            Err(_) => {
                let remedy = "'fly' flies it; with a larger share of the lost rotor (1:0.8, {1: 0.8} in Python) there may be a steady flight.";
                return refused("enough to hold the yaw: without, it turns faster until its drag holds it", remedy);
            }
        },
        (_, None) => trim(&plant, target)?,
        (_, Some(spin)) if *target == TrimTarget::hover() => trim_spin(&plant, spin, &HoverAxes::of(vehicle))?,
        (_, Some(_)) => {
            let remedy = "Leave out velocity, yaw rate, roll and pitch.";
            return refused("enough to fly without a spin: so the vehicle must spin to stay up, in place", remedy);
        }
    };
    Ok((plant, found))
}

/// The same from a state and an input near it.
///
/// # Errors
/// As [`trim`].
pub fn trim_from(plant: &Plant, target: &TrimTarget, state: &[f64], input: &[f64]) -> Result<Trim> {
    search(plant, target, state, input, &HoverAxes::of_plant(plant))
}

/// Gauss–Newton steps from a state and an input.
fn search(plant: &Plant, target: &TrimTarget, state: &[f64], input: &[f64], axes: &HoverAxes<f64>) -> Result<Trim> {
    plant.check_state(state)?;
    base::error::finite("trim: input", input)?;
    let given = target.velocity.into_iter().chain(target.tilt).flatten().chain([target.yaw_rate]);
    base::error::finite("trim: target", &given.collect::<Vec<_>>())?;
    let search = Search::new(plant, target, state, axes)?;
    let mut now = search.begin(state, input);
    let mut left = search.residual(&now).0;
    for _ in 0..MOST {
        if left.amax() <= 0.01 * STEADY {
            break;
        }
        let Some((better, smaller)) = search.improved(&now, &left) else { break };
        (now, left) = (better, smaller);
    }
    search.finished(now, &left)
}

/// What is sought, and in which numbers.
struct Search<'a> {
    plant: &'a Plant,
    target: &'a TrimTarget,
    errors: ErrorState,
    roots: Vec<usize>,
    /// Numbers of the error that may move, and what a unit of each is.
    free: Vec<(usize, f64)>,
    /// Numbers of the error whose rate must vanish, and what a unit of each is.
    still: Vec<(usize, f64)>,
    /// Commands among the inputs.
    commands: Vec<usize>,
    theta: Vec<f64>,
    /// What points forward in hover, body axes: its heading is prescribed.
    forward: Vec3<f64>,
}

#[derive(Clone)]
struct Point {
    state: Vec<f64>,
    input: Vec<f64>,
}

impl<'a> Search<'a> {
    fn new(plant: &'a Plant, target: &'a TrimTarget, state: &[f64], axes: &HoverAxes<f64>) -> Result<Self> {
        let errors = ErrorState::of_plant(plant)?;
        // roots that float: others have no velocity of their own
        let roots: Vec<usize> = plant.roots().into_iter().filter(|root| errors.turns_at(root + 6)).collect();
        let mut units = vec![1.0; errors.n_error()];
        for rotor in plant.rotor_places() {
            units[errors.place(rotor.speed)] = rotor.max_speed;
        }
        let places: Vec<usize> = roots.iter().flat_map(|r| [0, 1, 2].map(|k| errors.place(r + k))).collect();
        let given = |place: &(usize, &Option<f64>)| place.1.is_some();
        let velocities = places.iter().map(|place| place + 3).zip(target.velocity.iter().cycle());
        let fixed: Vec<usize> = velocities.filter(given).map(|(place, _)| place).collect();
        let still: Vec<(usize, f64)> =
            (0..errors.n_error()).filter(|i| !places.contains(i)).map(|i| (i, units[i])).collect();
        let free = still.iter().copied().filter(|(i, _)| !fixed.contains(i)).collect();
        let outside = plant.disturbances();
        let commands = (0..plant.n_input()).filter(|k| !outside.iter().any(|f| (*f..f + 9).contains(k))).collect();
        let theta = if plant.n_parameter() > 0 { plant.parameters() } else { Vec::new() };
        debug_assert_eq!(state.len(), plant.n_state());
        Ok(Self { plant, target, errors, roots, free, still, commands, theta, forward: axes.to_body([1.0, 0.0, 0.0]) })
    }

    fn begin(&self, state: &[f64], input: &[f64]) -> Point {
        let (mut state, mut input) = (state.to_vec(), input.to_vec());
        for root in &self.roots {
            let velocity = state[root + 3..root + 6].iter_mut().zip(self.target.velocity);
            velocity.for_each(|(own, given)| *own = given.unwrap_or(*own));
            if let [Some(roll), Some(pitch)] = self.target.tilt {
                state[root + 6..root + 10].copy_from_slice(&from_euler(roll, pitch, 0.0));
            }
        }
        for first in self.plant.disturbances() {
            self.target.air.write(&mut input[first..]);
        }
        Point { state, input }
    }

    /// Rates of change beyond the steady ones, then what is prescribed of attitudes; and their derivative with respect to the
    /// free numbers and the commands, each in its unit.
    fn residual(&self, at: &Point) -> (DVector<f64>, DMatrix<f64>) {
        let dt = self.plant.physics().dt;
        let step = linearise(self.plant, &at.state, &at.input, &self.theta);
        let (a, b) = self.errors.reduce(&at.state, &step);
        let turn = from_euler(0.0, 0.0, self.target.yaw_rate * dt);
        let (mut want, mut change) = (at.state.clone(), DMatrix::identity(a.nrows(), a.nrows()));
        for root in &self.roots {
            let (v, q) = (root + 3, root + 6);
            let velocity = [at.state[v], at.state[v + 1], at.state[v + 2]];
            let attitude = quaternion(&at.state, q);
            let turned = rotate(turn, velocity);
            want[v..v + 3].copy_from_slice(&turned);
            want[q..q + 4].copy_from_slice(&multiply(turn, attitude));
            let row = self.errors.place(v);
            for k in 0..3 {
                let mut axis = [0.0; 3];
                axis[k] = 1.0;
                let column = rotate(turn, axis);
                (0..3).for_each(|i| change[(row + i, row + k)] = column[i]);
            }
        }
        let all = self.errors.difference(step.next.as_slice(), &want);
        let a = a - change;
        let n_column = self.free.len() + self.commands.len();
        let prescribed = self.prescribed(at);
        let n_still = self.still.len();
        let mut value = DVector::zeros(n_still + prescribed.len());
        let mut slope = DMatrix::zeros(value.len(), n_column);
        for (i, (row, unit)) in self.still.iter().enumerate() {
            let scale = 1.0 / (dt * unit);
            value[i] = all[*row] * scale;
            for (j, (column, own)) in self.free.iter().enumerate() {
                slope[(i, j)] = a[(*row, *column)] * own * scale;
            }
            for (j, column) in self.commands.iter().enumerate() {
                slope[(i, self.free.len() + j)] = b[(*row, *column)] * scale;
            }
        }
        for (i, (off, places)) in prescribed.into_iter().enumerate() {
            value[n_still + i] = off;
            for (place, derivative) in places {
                if let Some(j) = self.free.iter().position(|(free, _)| *free == place) {
                    slope[(n_still + i, j)] = derivative;
                }
            }
        }
        (value, slope)
    }

    /// Heading, and roll and pitch where they are given: how far off, and the derivative by the rotation vector.
    fn prescribed(&self, at: &Point) -> Vec<(f64, [(usize, f64); 3])> {
        let mut rows = Vec::new();
        for root in &self.roots {
            let q = quaternion(&at.state, root + 6);
            let angle = self.errors.place(root + 6);
            let row = |axis: [f64; 3]| rotate(conjugate(q), axis);
            let (x, y, z) = (row([1.0, 0.0, 0.0]), row([0.0, 1.0, 0.0]), row([0.0, 0.0, 1.0]));
            // an entry r of R changes by r × δθ: (R δ̂) of row r
            let by = |r: [f64; 3], k: usize| {
                let change = [[0.0, r[2], -r[1]], [-r[2], 0.0, r[0]], [r[1], -r[0], 0.0]];
                [0, 1, 2].map(|axis| (angle + axis, change[axis][k]))
            };
            let plus = |one: [(usize, f64); 3], a: f64, other: [(usize, f64); 3], b: f64| {
                [0, 1, 2].map(|k| (one[k].0, a * one[k].1 + b * other[k].1))
            };
            let along = |r: [f64; 3]| {
                let parts = [0, 1, 2].map(|k| by(r, k));
                let slope = [0, 1, 2].map(|i| (angle + i, (0..3).map(|k| self.forward[k] * parts[k][i].1).sum()));
                (dot(r, self.forward), slope)
            };
            let ((ahead, by_x), (aside, by_y)) = (along(x), along(y));
            let size = ahead * ahead + aside * aside;
            rows.push((aside.atan2(ahead), plus(by_y, ahead / size, by_x, -aside / size)));
            let [roll, pitch] = self.target.tilt;
            if let Some(pitch) = pitch {
                rows.push((z[0] + pitch.sin(), by(z, 0)));
            }
            if let Some(roll) = roll {
                let size = z[1] * z[1] + z[2] * z[2];
                rows.push((z[1].atan2(z[2]) - roll, plus(by(z, 1), z[2] / size, by(z, 2), -z[1] / size)));
            }
        }
        rows
    }

    /// A step of least norm, halved until it helps; commands at a limit that it would leave stay there.
    fn improved(&self, now: &Point, left: &DVector<f64>) -> Option<(Point, DVector<f64>)> {
        let slope = self.residual(now).1;
        let mut held = vec![false; self.commands.len()];
        loop {
            let mut usable = slope.clone();
            for (j, _) in held.iter().enumerate().filter(|(_, held)| **held) {
                usable.column_mut(self.free.len() + j).fill(0.0);
            }
            let step = usable.try_svd(true, true, 5.0 * f64::EPSILON, SWEEPS)?.solve(&-left, 1e-9).ok()?;
            let leaves = |j: usize| {
                let (u, du) = (now.input[self.commands[j]], step[self.free.len() + j]);
                (u >= 1.0 && du > 1e-12) || (u <= -1.0 && du < -1e-12)
            };
            let fresh: Vec<usize> = (0..held.len()).filter(|j| !held[*j] && leaves(*j)).collect();
            if fresh.is_empty() {
                return (0..30).find_map(|k| {
                    let next = self.moved(now, &(&step * 0.5_f64.powi(k)));
                    let smaller = self.residual(&next).0;
                    (smaller.norm() < left.norm()).then_some((next, smaller))
                });
            }
            fresh.into_iter().for_each(|j| held[j] = true);
        }
    }

    fn moved(&self, from: &Point, step: &DVector<f64>) -> Point {
        let mut error = vec![0.0; self.errors.n_error()];
        for (k, (place, unit)) in self.free.iter().enumerate() {
            error[*place] = step[k] * unit;
        }
        let mut next = Point { state: self.errors.moved(&from.state, &error), ..from.clone() };
        for rotor in self.plant.rotor_places() {
            next.state[rotor.speed] = next.state[rotor.speed].max(1e-3 * rotor.max_speed);
        }
        for (j, command) in self.commands.iter().enumerate() {
            next.input[*command] = (from.input[*command] + step[self.free.len() + j]).clamp(-1.0, 1.0);
        }
        next
    }

    fn finished(&self, now: Point, left: &DVector<f64>) -> Result<Trim> {
        let residual = left.amax();
        let slope = self.residual(&now).1;
        let rounded = |i: usize| STEADY.max(ROUNDED * slope.row(i).amax());
        let steady = (0..left.len()).all(|i| left[i].abs() <= rounded(i));
        let limited = self.commands.iter().copied().filter(|k| now.input[*k].abs() >= 1.0).collect();
        if steady {
            let yaw_rate = self.target.yaw_rate;
            return Ok(Trim { state: now.state, input: now.input, yaw_rate, residual, limited });
        }
        let worst =
            (0..left.len()).max_by(|a, b| (left[*a].abs() / rounded(*a)).total_cmp(&(left[*b].abs() / rounded(*b))));
        let worst = worst.unwrap_or(0);
        let names = self.plant.state_quantities();
        let what =
            self.still.get(worst).and_then(|(error, _)| (0..names.len()).find(|k| self.errors.place(*k) == *error));
        let name = what.map_or("the attitude", |k| names[k].name.as_str());
        let value = format!("changing by {:.2e} per second at best", left[worst].abs());
        let remedy = "Ask for what the vehicle has the thrust and the freedom for: a slower flight, a slower turn, or less tilt.";
        Err(Error::value(format!("trim of {}: {name}", self.plant.name()), value, "steady", remedy))
    }
}
