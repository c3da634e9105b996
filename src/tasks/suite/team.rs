//! What the tasks of several drones share: who sees whom, how far apart they are, what they carry.

use super::{clock_slice, drone_slices};
use crate::autodiff::{Pen, Scalar, safe};
use crate::dynamics::Vehicle;
use crate::dynamics::frame::Frame;
use crate::dynamics::spatial::{Vec3, sub};
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{Slice, Smoothness, total};
use crate::tasks::task::View;
use serde::{Deserialize, Serialize};

/// Settings of a team that hovers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TeamSettings {
    /// What flies.
    pub vehicle: String,
    /// Drones.
    pub n_drone: usize,
    /// T, steps.
    pub horizon: usize,
}

impl Default for TeamSettings {
    fn default() -> Self {
        Self { vehicle: "hummingbird".into(), n_drone: 4, horizon: 500 }
    }
}

/// Settings of a team that flies through obstacles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CourseSettings {
    /// What flies.
    pub vehicle: String,
    /// Drones.
    pub n_drone: usize,
    /// T, steps.
    pub horizon: usize,
    /// Whether touching an obstacle ends the episode.
    pub reset_on_collision: bool,
}

impl Default for CourseSettings {
    fn default() -> Self {
        Self { vehicle: "hummingbird".into(), n_drone: 4, horizon: 500, reset_on_collision: false }
    }
}

/// What [`observe_own`] writes: where a drone is about its load, ŝ, and which of the team it is.
fn own_slices(rig: &Rig, load: &str) -> Vec<Slice> {
    let mut slices = vec![Slice::new("place", 3, "m, world", format!("p_i − p of the {load}"))];
    slices.extend(drone_slices(rig.drone()));
    slices.push(Slice::new("index", rig.drones().len(), "-", "1 at i, else 0"));
    slices
}

/// Drone `i` as it sees itself.
#[inline(always)]
pub fn observe_own<S: Scalar>(view: &View<'_, S>, i: usize, load: Vec3<S>, out: &mut Pen<'_, S>) {
    out.array(sub(view.drone(i).position, load));
    view.observe_drone(i, out);
    for j in 0..view.rig.drones().len() {
        out.number(if i == j { S::one() } else { S::zero() });
    }
}

/// What [`observe_others`] writes.
pub fn others_slice(rig: &Rig, distance: bool) -> Slice {
    let n = rig.drones().len() - 1;
    let (size, unit, meaning) = match distance {
        true => (14, "m, m, -, m/s, rad/s", "p_i − p_j, ‖p_i − p_j‖, q_j, v_j, ω_j for every other j, ascending"),
        false => (13, "m, -, m/s, rad/s", "p_i − p_j, q_j, v_j, ω_j for every other j, ascending"),
    };
    Slice::new("others", size * n, format!("{unit}; world"), meaning).but(Smoothness::NonSmooth)
}

/// The other drones as drone `i` sees them, with their distances if asked for.
#[inline(always)]
pub fn observe_others<S: Scalar>(view: &View<'_, S>, i: usize, distance: bool, out: &mut Pen<'_, S>) {
    let own = view.drone(i).position;
    for j in 0..view.rig.drones().len() {
        if j != i {
            let other = view.drone(j);
            let between = sub(own, other.position);
            out.array(between);
            if distance {
                out.number(safe::norm(between));
            }
            out.array(other.observed_attitude());
            out.array(other.velocity);
            out.array(other.angular_velocity);
        }
    }
}

/// What [`observe_load`] writes.
fn load_slices(load: &str) -> Vec<Slice> {
    vec![
        Slice::new(format!("{load}_attitude"), 4, "-, body → world", "unit quaternion, w ≥ 0")
            .but(Smoothness::NonSmooth),
        Slice::new(format!("{load}_velocity"), 3, "m/s, world", "v"),
        Slice::new(format!("{load}_angular_velocity"), 3, "rad/s, world", "ω"),
        Slice::new(format!("{load}_heading"), 3, "-, world", "h = R e_x"),
        Slice::new(format!("{load}_up"), 3, "-, world", "u = R e_z"),
        clock_slice(),
    ]
}

/// Attitude and motion of what the team carries, and the clock.
#[inline(always)]
pub fn observe_load<S: Scalar>(view: &View<'_, S>, load: &Frame<S>, out: &mut Pen<'_, S>) {
    out.array(load.observed_attitude());
    out.array(load.velocity);
    out.array(load.angular_velocity);
    out.array(load.heading());
    out.array(load.up());
    view.observe_clock(out);
}

/// Observation and central state of a team with a load: drones first (one with the others, or all), then `goal`, which is
/// the task's, then the load and the clock.
pub fn carried_slices(rig: &Rig, load: &str, distance: bool, goal: &[Slice]) -> (Vec<Slice>, Vec<Slice>) {
    let mut own = own_slices(rig, load);
    let names: Vec<&str> = own.iter().map(|s| s.name.as_str()).collect();
    let meaning = format!("{} of every drone", names.join(", "));
    let mut central = vec![Slice::new("drones", total(&own) * rig.drones().len(), "as observed", meaning)];
    own.push(others_slice(rig, distance));
    for slices in [&mut own, &mut central] {
        slices.extend(goal.iter().cloned().chain(load_slices(load)));
    }
    (own, central)
}

/// All drones as they see themselves.
#[inline(always)]
pub fn observe_drones<S: Scalar>(view: &View<'_, S>, load: Vec3<S>, out: &mut Pen<'_, S>) {
    for i in 0..view.rig.drones().len() {
        observe_own(view, i, load, out);
    }
}

/// Height of the lowest drone, m.
#[inline(always)]
pub fn lowest<S: Scalar>(view: &View<'_, S>) -> S {
    let mut least = view.drone(0).position[2];
    for i in 1..view.rig.drones().len() {
        least = least.min(view.drone(i).position[2]);
    }
    least
}

/// Height of the highest drone, m.
#[inline(always)]
pub fn highest<S: Scalar>(view: &View<'_, S>) -> S {
    let mut most = view.drone(0).position[2];
    for i in 1..view.rig.drones().len() {
        most = most.max(view.drone(i).position[2]);
    }
    most
}

/// Least x of the drones, m.
#[inline(always)]
pub fn hindmost<S: Scalar>(view: &View<'_, S>) -> S {
    let mut least = view.drone(0).position[0];
    for i in 1..view.rig.drones().len() {
        least = least.min(view.drone(i).position[0]);
    }
    least
}

/// sep²: the least squared distance of two drones, m².
#[inline(always)]
pub fn squared_separation<S: Scalar>(view: &View<'_, S>) -> S {
    let mut least = S::constant(1e12);
    for i in 1..view.rig.drones().len() {
        for j in 0..i {
            let between = sub(view.drone(i).position, view.drone(j).position);
            least = least.min(safe::squared_norm(between));
        }
    }
    least
}

/// r_sep = min((sep/`wanted`)², 1).
#[inline(always)]
pub fn apart<S: Scalar>(view: &View<'_, S>, wanted: f64) -> S {
    (squared_separation(view) * S::constant(1.0 / (wanted * wanted))).min(S::one())
}

/// Mean of Δs over the drones.
#[inline(always)]
pub fn mean_throttle_difference<S: Scalar>(view: &View<'_, S>) -> S {
    let n = view.rig.drones().len();
    let mut sum = S::zero();
    for i in 0..n {
        sum += view.throttle_difference(i);
    }
    sum * S::constant(1.0 / n as f64)
}

/// (Σ|x_i|)²: the square of a 1-norm.
#[inline(always)]
pub fn squared_sum<S: Scalar>(x: Vec3<S>) -> S {
    (x[0].abs() + x[1].abs() + x[2].abs()).square()
}

/// Total mass of a team, kg.
pub fn team_mass(vehicle: &Vehicle, n_drone: usize) -> f64 {
    n_drone as f64 * vehicle.mass_properties().mass
}

/// What a task with a course remembers.
pub fn course_memo() -> Vec<Slice> {
    vec![
        Slice::new("arrived", 1, "-", "1 once the target was reached beyond the obstacles, else 0"),
        Slice::new("clearance", 1, "m", "c after the last step"),
    ]
}

/// The first of [`course_memo`].
#[inline(always)]
pub fn arrived<S: Scalar>(view: &View<'_, S>) -> S {
    view.memo.get(0)
}

/// The second of [`course_memo`].
#[inline(always)]
pub fn clearance<S: Scalar>(view: &View<'_, S>) -> S {
    view.memo.get(1)
}
