//! What the tasks of several drones share: who sees whom, how far apart they are, what they carry.

use super::{PoseLoss, more, times};
use crate::config::EnvConfig;
use crate::declare::Writer;
use crate::robot::Robot;
use crate::settings;
use crate::task::View;
use autodiff::{Mask, Scalar, Trace, TraceMask, safe};
use base::error::Result;
use dynamics::assembly::{Member, group, single};
use dynamics::frame::Frame;
use dynamics::spatial::{Vec3, sub};
use dynamics::{Physics, Vehicle};

settings! {
    /// Who flies, and for how long.
    pub struct TeamSettings {
        vehicle: String = "hummingbird".into() => ("", "what every drone is", Any);
        n_drone: usize = 4 => ("", "drones", Any);
    }
}

settings! {
    /// Weights of a training loss with obstacles.
    pub struct CourseLoss {
        pose: PoseLoss = PoseLoss::default() => flat;
        clearance: f64 = 0.5 => ("m", "weight of the clearance in the loss", NotNegative);
    }
}

/// Drones that are free of each other but for their wakes, with nothing to touch.
///
/// # Errors
/// As [`EnvConfig::vehicle`].
pub(crate) fn free_team(name: &str, config: &EnvConfig, vehicle: &str, n_drone: usize) -> Result<Robot> {
    team_of(name, config.physics_with(|e| e.downwash = true), &config.vehicle(vehicle)?, n_drone)
}

/// Likewise with physics of one's own.
///
/// # Errors
/// None for a vehicle and physics that may be.
pub(crate) fn team_of(name: &str, physics: Physics, vehicle: &Vehicle, n_drone: usize) -> Result<Robot> {
    let drone = single(vehicle)?;
    let member = |i| Member::new(format!("drone_{i}"), drone.clone(), [0.0; 3]);
    let members: Vec<Member> = (0..n_drone).map(member).collect();
    Robot::of_model(&group(name, &members)?, physics, Some(vehicle), |_| Vec::new())
}

/// Drone `i` as it sees itself: where it is about its load, ŝ, and which of the team it is.
pub(crate) fn observe_own(view: &View, i: usize, load: Vec3<Trace>, out: &mut Writer) {
    out.field("place", "m, world", "p_i − p of what it carries").array(sub(view.drone(i).position, load));
    view.observe_drone(i, out);
    out.field("index", "-", "1 at i, else 0").within(0.0, 1.0);
    for j in 0..view.robot.drones().len() {
        out.number(if i == j { Trace::one() } else { Trace::zero() });
    }
}

/// The other drones as drone `i` sees them, with their distances if asked for.
pub(crate) fn observe_others(view: &View, i: usize, distance: bool, out: &mut Writer) {
    let others = view.robot.drones().len() - 1;
    if distance {
        let meaning = "p_i − p_j, ‖p_i − p_j‖, q_j, v_j, ω_j for every other j, ascending";
        out.field("others", "m, m, -, m/s, rad/s; world", meaning).members(others).non_smooth();
    } else {
        out.field("others", "m, -, m/s, rad/s; world", "p_i − p_j, q_j, v_j, ω_j for every other j, ascending")
            .members(others)
            .non_smooth();
    }
    let own = view.drone(i).position;
    for j in 0..view.robot.drones().len() {
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

/// Names of attitude, velocity, angular velocity, heading and up of what a team carries.
pub type LoadNames = [&'static str; 5];

/// Attitude and motion of what the team carries, and the clock.
pub(crate) fn observe_load(view: &View, names: &LoadNames, load: &Frame<Trace>, out: &mut Writer) {
    out.field(names[0], "-, body → world", "unit quaternion, w ≥ 0").within(-1.0, 1.0).non_smooth();
    out.array(load.observed_attitude());
    out.field(names[1], "m/s, world", "v").array(load.velocity);
    out.field(names[2], "rad/s, world", "ω").array(load.angular_velocity);
    out.field(names[3], "-, world", "h = R e_x").within(-1.0, 1.0).array(load.heading());
    out.field(names[4], "-, world", "u = R e_z").within(-1.0, 1.0).array(load.up());
    view.observe_clock(out);
}

/// All drones as they see themselves.
pub(crate) fn observe_drones(view: &View, load: Vec3<Trace>, out: &mut Writer) {
    let own = "place, attitude, velocity, angular_velocity, heading, up, throttle, index of every drone";
    out.field("drones", "as observed", own);
    for i in 0..view.robot.drones().len() {
        out.unnamed(|out| observe_own(view, i, load, out));
    }
}

/// Height of the lowest drone, m.
pub fn lowest<S: Scalar>(view: &View<'_, S>) -> S {
    let mut least = view.drone(0).position[2];
    for i in 1..view.robot.drones().len() {
        least = least.min(view.drone(i).position[2]);
    }
    least
}

/// Height of the highest drone, m.
pub fn highest<S: Scalar>(view: &View<'_, S>) -> S {
    let mut most = view.drone(0).position[2];
    for i in 1..view.robot.drones().len() {
        most = most.max(view.drone(i).position[2]);
    }
    most
}

/// Least x of the drones, m.
pub(crate) fn hindmost<S: Scalar>(view: &View<'_, S>) -> S {
    let mut least = view.drone(0).position[0];
    for i in 1..view.robot.drones().len() {
        least = least.min(view.drone(i).position[0]);
    }
    least
}

/// sep²: the least squared distance of two drones, m².
pub(crate) fn squared_separation<S: Scalar>(view: &View<'_, S>) -> S {
    let mut least = S::constant(1e12);
    for i in 1..view.robot.drones().len() {
        for j in 0..i {
            let between = sub(view.drone(i).position, view.drone(j).position);
            least = least.min(safe::squared_norm(between));
        }
    }
    least
}

/// r_sep = min((sep/`wanted`)², 1).
pub fn apart<S: Scalar>(view: &View<'_, S>, wanted: f64) -> S {
    (squared_separation(view) * S::constant(1.0 / (wanted * wanted))).min(S::one())
}

/// What training losses pay for drones close to each other, see [`crowded`].
pub(crate) const CROWD: &str = "{×loss_crowd}(1 − min((sep/{loss_separation} m)², 1))²";

/// w (1 − r_sep)².
pub(crate) fn crowded<S: Scalar>(weight: f64, view: &View<'_, S>, wanted: f64) -> S {
    times(weight, (S::one() - apart(view, wanted)).square())
}

/// Mean of Δs over the drones.
pub(crate) fn mean_throttle_difference<S: Scalar>(view: &View<'_, S>) -> S {
    let n = view.robot.drones().len();
    let mut sum = S::zero();
    for i in 0..n {
        sum += view.throttle_difference(i);
    }
    sum * S::constant(1.0 / n as f64)
}

/// (Σ|x_i|)²: the square of a 1-norm.
pub(crate) fn squared_sum<S: Scalar>(x: Vec3<S>) -> S {
    (x[0].abs() + x[1].abs() + x[2].abs()).square()
}

/// Total mass of a team, kg.
pub(crate) fn team_mass(vehicle: &Vehicle, n_drone: usize) -> f64 {
    n_drone as f64 * vehicle.mass_properties().mass
}

/// What a task with a course remembers: whether the team was `here` once, all of it beyond the obstacles, and the clearance.
pub(crate) fn remember_course(view: &View, here: TraceMask, clearance: Trace, task_state: &mut Writer) {
    let arrived = Trace::select(here.and(more(hindmost(view), BEYOND)), Trace::one(), arrived(view));
    task_state.field("arrived", "-", "1 once the target was reached beyond the obstacles, else 0").number(arrived);
    task_state.field("clearance", "m", "c after the last step").number(clearance);
}

/// x of drones that are past the obstacles, m.
const BEYOND: f64 = 0.05;
/// What a success asks beside the error.
pub(super) const ALL_BEYOND: &str = "with all drones beyond x = 0.05 m";

/// The first of [`remember_course`].
pub(crate) fn arrived<S: Scalar>(view: &View<'_, S>) -> S {
    view.task_state[0]
}

/// The second of [`remember_course`].
pub fn clearance<S: Scalar>(view: &View<'_, S>) -> S {
    view.task_state[1]
}

/// What one of a team observes, and the central state: drones, then what the task's `observe_shared` adds.
macro_rules! observes_team {
    ($own:ident, $body:expr, $distance:expr) => {
        fn observe(&$own, view: &View, agent: usize, out: &mut Writer) {
            crate::suite::team::observe_own(view, agent, view.frame($body).position, out);
            crate::suite::team::observe_others(view, agent, $distance, out);
            $own.observe_shared(view, out);
        }
        fn central(&$own, view: &View, out: &mut Writer) {
            crate::suite::team::observe_drones(view, view.frame($body).position, out);
            $own.observe_shared(view, out);
        }
    };
}
pub(crate) use observes_team;
