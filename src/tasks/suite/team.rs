//! What the tasks of several drones share: who sees whom, how far apart they are, what they carry, what stands in the way.

use super::{clock_slice, drone_slices};
use crate::autodiff::{Pen, Scalar, safe};
use crate::dynamics::Vehicle;
use crate::dynamics::assembly::Member;
use crate::dynamics::configurations::environment;
use crate::dynamics::contact::ContactMaterial;
use crate::dynamics::contact::distance::to_capsule;
use crate::dynamics::frame::Frame;
use crate::dynamics::scene::{Obstacle, Scene};
use crate::dynamics::shape::{Geometry, Pose, Shape};
use crate::dynamics::spatial::{Vec3, add, constants, rotate, sub};
use crate::dynamics::tree::numbers::still_numbers;
use crate::dynamics::tree::{BodyShape, Model};
use crate::error::Result;
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{Slice, total};
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
    Slice::new("others", size * n, format!("{unit}; world"), meaning)
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
        Slice::new(format!("{load}_attitude"), 4, "-, body → world", "unit quaternion, w ≥ 0"),
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

/// Still capsules that a rig flies through, and how close it comes.
#[derive(Debug, Clone)]
pub struct Course {
    poles: Vec<Pole>,
    /// Shapes of the rig that can touch them.
    shapes: Vec<(usize, Shape)>,
}

/// One capsule.
#[derive(Debug, Clone, Copy)]
struct Pole {
    axis: [[f64; 3]; 2],
    radius: f64,
}

/// Obstacles that give way by about 2 cm under a drone's weight: a choice for steps of 16 ms, not tuned.
///
/// With the default material a drone of 0.7 kg bobs at 170 rad/s, and an impact is faster still: see [`ContactMaterial`].
pub fn padding(vehicle: &Vehicle) -> ContactMaterial {
    let mass = vehicle.mass_properties().mass;
    ContactMaterial { slip_speed: 0.5, ..ContactMaterial::resting(mass, 1, 0.02) }
}

/// A capsule of 5 m along y or z, named after its number.
pub fn pole(number: usize, center: [f64; 3], radius: f64, along_y: bool) -> Obstacle {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let rotation = if along_y { [half, half, 0.0, 0.0] } else { [1.0, 0.0, 0.0, 0.0] };
    let shape = Shape::new(Geometry::Capsule { radius, length: 5.0 }).at(center).turned(rotation);
    Obstacle { name: format!("pole_{number}"), shape }
}

/// A rig among poles of 5 m, no ground, whose every contact has the same material.
///
/// # Errors
/// As [`environment()`].
pub fn course_model(name: &str, rig: Model, poles: Vec<Obstacle>, material: ContactMaterial) -> Result<Model> {
    let scene = Scene { ground: None, obstacles: poles, ..Scene::default() };
    let mut parts = environment(name, &[Member::new("rig", rig, [0.0; 3])], &scene)?.parts().clone();
    parts.contact.material = material;
    Model::new(parts)
}

impl Course {
    /// The still capsules of a model and what of it can touch them.
    pub fn of(model: &Model) -> Self {
        let pole = |s: &BodyShape| match (s.body, s.shape.geometry) {
            (None, Geometry::Capsule { radius, length }) => {
                let reach = rotate(s.shape.rotation, [0.0, 0.0, 0.5 * length]);
                let at = s.shape.position;
                Some(Pole { axis: [sub(at, reach), add(at, reach)], radius })
            }
            _ => None,
        };
        let moving = |s: &BodyShape| s.body.filter(|_| s.collides).map(|body| (body, s.shape));
        Self {
            poles: model.shapes().iter().filter_map(pole).collect(),
            shapes: model.shapes().iter().filter_map(moving).collect(),
        }
    }

    /// Where the three numbers of a pole's place stand among those of the rig.
    pub fn place(model: &Model, pole: usize) -> usize {
        still_numbers(model.bodies().len(), model.rotors().len(), pole)
    }

    /// Least distance of the rig to a pole, m; negative where they overlap. Pole k stands `lift[k]` above where it
    /// was built.
    #[inline(always)]
    pub fn clearance<S: Scalar, const N: usize>(&self, view: &View<'_, S>, lift: [S; N]) -> S {
        let mut least = S::constant(1e6);
        for i in 0..self.shapes.len() {
            let (body, shape) = &self.shapes[i];
            let frame = view.frame(*body);
            let pose = shape.pose(&Pose { position: frame.position, attitude: frame.attitude });
            for k in 0..N {
                let pole = &self.poles[k];
                let raised = [S::zero(), S::zero(), lift[k]];
                let axis = [add(constants(pole.axis[0]), raised), add(constants(pole.axis[1]), raised)];
                least = least.min(to_capsule(&shape.geometry, &pose, axis, pole.radius));
            }
        }
        least
    }
}

/// Clearance below which an episode ends: 0, or never.
pub fn collision_limit(ends: bool) -> f64 {
    if ends { 0.0 } else { -1e6 }
}

/// What a task with a course remembers.
pub fn course_memo() -> Vec<Slice> {
    vec![
        Slice::new("arrived", 1, "-", "1 once the target was reached beyond the poles, else 0"),
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

/// A cost of coming closer than 0.3 m to a pole.
#[inline(always)]
pub fn closeness<S: Scalar>(view: &View<'_, S>) -> S {
    let missing = (S::constant(0.3) - clearance(view)).max(S::zero());
    S::constant(10.0) * missing.square()
}
