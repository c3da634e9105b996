//! Who steers an articulated system, and a whole flight of one, logged.

use super::cascade::Rates;
use super::flight::FlightPlan;
use super::formation::Formation;
use super::frozen::Frozen;
use super::kinematics::Kinematics;
use super::platform::{Platform, is_platform};
use super::reference::{Reference, Sample, Tilt};
use super::state_feedback::{Lqr, suits};
use super::transport::{Transport, is_transport};
use super::vectored::{Vectored, vectored};
use crate::autodiff::{System, safe};
use crate::dynamics::Gains;
use crate::dynamics::aero::wind::{Wind, WindState};
use crate::dynamics::batch::EXPLODED;
use crate::dynamics::rotor::commanded_speed;
use crate::dynamics::spatial::{from_matrix, to_euler};
use crate::dynamics::tree::{Model, Motion, Multibody, body_poses};
use crate::error::{Error, Result};
use crate::flight::{self, FlightLog};
use crate::rng::{Purpose, Stream};

/// What a pilot is told in every step.
#[derive(Debug, Clone, Copy)]
pub struct Command<'a> {
    /// s.
    pub time: f64,
    /// Of the whole system.
    pub state: &'a [f64],
    /// What to track.
    pub reference: &'a Reference,
    /// Roll and pitch to hold beside it.
    pub tilt: &'a Tilt,
}

/// Something a pilot says about itself after a flight.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// What.
    pub name: String,
    /// How much, with unit.
    pub value: String,
    /// The rest.
    pub note: String,
}

impl Note {
    /// From its three parts.
    pub fn new(name: impl Into<String>, value: impl Into<String>, note: impl Into<String>) -> Self {
        Self { name: name.into(), value: value.into(), note: note.into() }
    }
}

/// A controller of an articulated system: called once per step, in order.
pub trait Pilot {
    /// One word.
    fn name(&self) -> &'static str;
    /// What it does, for tables.
    fn description(&self) -> String;
    /// Whether it holds a [`Tilt`] beside the reference.
    fn holds_tilt(&self) -> bool {
        false
    }
    /// How it fared, for tables.
    fn notes(&self) -> Vec<Note> {
        Vec::new()
    }
    /// What follows the reference.
    fn tracked(&self, state: &[f64]) -> Kinematics<f64>;
    /// Writes rotor actions and drive commands.
    fn command(&mut self, moment: Command<'_>, input: &mut [f64]);
}

/// Rotors idle and servos rest.
#[derive(Debug, Clone)]
pub struct Passive(pub Multibody);

impl Pilot for Passive {
    fn name(&self) -> &'static str {
        "none"
    }

    fn description(&self) -> String {
        "rotors idle, servos rest".into()
    }

    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        super::formation::root(&self.0, state)
    }

    fn command(&mut self, _: Command<'_>, input: &mut [f64]) {
        let rest = self.0.rest_input();
        input[..rest.len()].copy_from_slice(&rest);
    }
}

/// The pilot that suits a model by its make: where all rotors sit on tilting servos they are [`Vectored`], other servos
/// are held at rest under one cascade ([`Frozen`]), one drone with one chain of passive joints gets optimal feedback
/// ([`Lqr`]) where its level hover is one, a frame on cardan joints is steered in six axes ([`Platform`]), a load under bars
/// is tracked through them ([`Transport`]), everything else is flown by its drones ([`Formation`]).
///
/// # Errors
/// [`Error::Value`] for a model that nothing lifts or that is fixed to the world; otherwise as the pilots.
pub fn suited(system: &Multibody, gains: Option<&Gains>, rates: &Rates) -> Result<Box<dyn Pilot>> {
    let model = system.model();
    free(model)?;
    if model.drones().is_empty() {
        let what = format!("model '{}': number of drones", model.name());
        return Err(Error::value(what, 0, "≥ 1 to fly", "Drop it instead."));
    }
    if !steerable(model) {
        let what = format!("model '{}': drones", model.name());
        let rule = "on the root, or without servos between them";
        return Err(Error::value(what, "on gimbals along a chain", rule, "Nobody steers it yet: drop it instead."));
    }
    if vectored(model) {
        return Ok(Box::new(Vectored::new(system, gains, rates)?));
    }
    if has_servos(model) {
        return Ok(Box::new(Frozen::new(system, gains, rates)?));
    }
    if suits(model)
        && let Ok(pilot) = Lqr::new(system, gains, rates)
    {
        return Ok(Box::new(pilot));
    }
    if is_platform(model) {
        return Ok(Box::new(Platform::new(system, gains, rates)?));
    }
    if is_transport(model) {
        return Ok(Box::new(Transport::new(system, gains, rates)?));
    }
    Ok(Box::new(Formation::new(system, gains, rates)?))
}

fn has_servos(model: &Model) -> bool {
    model.bodies().iter().any(|b| b.joint.drive.is_some())
}

/// Whether [`suited`] knows a pilot: drones that sit on servos, away from the root, have none unless all their rotors tilt.
pub fn steerable(model: &Model) -> bool {
    !model.drones().is_empty() && (!has_servos(model) || vectored(model) || model.drones().iter().all(|d| d.body == 0))
}

/// Refuses models that cannot move as one whole.
fn free(model: &Model) -> Result<()> {
    let n_tree = model.layout().trees.len();
    if n_tree != 1 {
        let what = format!("model '{}': number of trees", model.name());
        return Err(Error::value(what, n_tree, "1 to be flown or dropped", "Give each tree a pilot of its own."));
    }
    if model.bodies()[0].joint.motion == Motion::Floating {
        return Ok(());
    }
    let what = format!("model '{}': root '{}'", model.name(), model.bodies()[0].name);
    Err(Error::value(what, "fixed to the world", "free to move", "It can be shown, not flown or dropped."))
}

/// A finished flight of an articulated system.
#[derive(Debug, Clone, PartialEq)]
pub struct RigFlight {
    /// Of what was tracked, with all rotors.
    pub log: FlightLog,
    /// Row-major `[sample, number]`, one row per entry of the log.
    pub states: Vec<f64>,
    /// When the state left |x| < 1e8 (SI units) or became not a number, s.
    pub diverged_at: Option<f64>,
}

/// The state in which the tracked point starts on the reference, at rest, with all joints at rest and rotors that share
/// the weight.
pub fn start_on(system: &Multibody, pilot: &dyn Pilot, reference: &Reference) -> Vec<f64> {
    let (layout, model) = (system.layout(), system.model());
    let mut state = system.rest_state();
    let (own, wanted) = (pilot.tracked(&state), reference.sample(0.0));
    let root = layout.bodies[0].position;
    let (s, c) = (0.5 * wanted.yaw).sin_cos();
    let turn = [c, 0.0, 0.0, s];
    state[root + 6..root + 10].copy_from_slice(&turn);
    // the root lies behind the tracked point, turned with it
    let offset = crate::dynamics::spatial::rotate(turn, [0, 1, 2].map(|k| state[root + k] - own.position[k]));
    for k in 0..3 {
        state[root + k] = wanted.position[k] + offset[k];
    }
    let lift: f64 = model.rotors().iter().map(|r| r.rotor.max_thrust()).sum();
    let fraction = (model.mass() * model.parts().gravity / lift).min(1.0).sqrt();
    for (rotor, at) in model.rotors().iter().zip(&layout.rotor_speed) {
        state[*at] = rotor.rotor.max_speed * fraction;
    }
    state
}

/// A drop: level at rest with its lowest collision point `height` above the ground, joints disturbed a little by `seed`
/// so that nothing stands on an edge for ever.
///
/// # Errors
/// [`Error::Value`] for a model that is fixed to the world, or without shapes that touch the ground.
pub fn start_above(system: &Multibody, height: f64, seed: u64) -> Result<Vec<f64>> {
    let model = system.model();
    free(model)?;
    let layout = system.layout();
    let mut state = system.rest_state();
    let mut stream = Stream::new(seed, 0, 0, Purpose::RESET);
    let mut small = || 0.02 * (2.0 * stream.uniform(0.0, 1.0) - 1.0);
    let root = layout.bodies[0].position;
    let turn = crate::dynamics::spatial::from_euler(small(), small(), 0.0);
    state[root + 6..root + 10].copy_from_slice(&turn);
    for (i, body) in model.bodies().iter().enumerate() {
        if matches!(body.joint.motion, Motion::Revolute(_)) {
            state[layout.bodies[i].position] += small();
        }
    }
    let ground = model.parts().contact.ground.unwrap_or(0.0);
    let Some(gap) = clearance(system, &state) else {
        let what = format!("model '{}': shapes that touch", model.name());
        return Err(Error::value(what, 0, "≥ 1 to land on the ground", "Give its parts shapes."));
    };
    state[root + 2] += ground + height - gap;
    Ok(state)
}

/// Least distance of any colliding shape to the ground, m; `None` without such shapes.
pub fn clearance(system: &Multibody, state: &[f64]) -> Option<f64> {
    use crate::dynamics::{contact, shape};
    let (model, poses) = (system.model(), body_poses(system, state));
    let height = model.parts().contact.ground.unwrap_or(0.0);
    let own = model.shapes().iter().filter(|s| s.collides);
    let gaps = own.filter_map(|s| {
        let carrier = &poses[s.body?];
        let attitude = crate::dynamics::spatial::from_matrix(carrier.rotation);
        let pose = s.shape.pose(&shape::Pose { position: carrier.position, attitude });
        Some(contact::plane_distance(&s.shape.geometry, &pose, height))
    });
    gaps.min_by(f64::total_cmp)
}

/// Flies `system` from `state` under a pilot along the plan. `progress` is told the number of each finished step.
///
/// # Errors
/// [`Error::Value`] or [`Error::Limit`] if the plan is not valid, its physics are not those of the system, or
/// `state` has another length.
pub fn fly_rig(
    system: &Multibody,
    pilot: &mut dyn Pilot,
    plan: &FlightPlan,
    state: &[f64],
    progress: &mut dyn FnMut(u64),
) -> Result<RigFlight> {
    let n_step = plan.n_step()?;
    let (model, layout) = (system.model(), system.layout());
    Multibody::check_length("state", state.len(), layout.n_state())?;
    if plan.physics != *system.physics() {
        let remedy = "Give the plan the system's: plan.physics = *system.physics().";
        return Err(Error::value("plan.physics", format!("{:?}", plan.physics), "those of the system", remedy));
    }
    if !plan.tilt.is_level() && !pilot.holds_tilt() {
        let what = format!("tilt of '{}' under pilot '{}'", model.name(), pilot.name());
        let value = format!("roll {}, pitch {} rad", plan.tilt.roll, plan.tilt.pitch);
        return Err(Error::value(what, value, "level", "platform, omav_tilting and dragon can hold a tilt."));
    }
    let windy = plan.wind != Wind::Calm;
    if windy && !system.physics().effects.disturbance {
        return Err(Error::value("effects.disturbance", "off", "on where there is wind", "Switch it on."));
    }
    let mut wind = WindState::new(plan.wind.clone(), Stream::new(plan.seed, 0, 0, Purpose::WIND))?;
    let speeds: Vec<f64> = model.rotors().iter().map(|r| r.rotor.max_speed).collect();
    let mut log = FlightLog::new(model.name(), &speeds);
    let (mut x, mut next, mut input) = (state.to_vec(), state.to_vec(), vec![0.0; system.n_input()]);
    let (mut states, mut diverged_at) = (Vec::new(), None);
    for k in 0..=n_step {
        let time = k as f64 * plan.physics.dt;
        let air = if windy { wind.sample(plan.physics.dt) } else { [0.0; 3] };
        for at in layout.trees.iter().filter_map(|t| t.disturbance) {
            input[at..at + 3].copy_from_slice(&air);
        }
        pilot.command(Command { time, state: &x, reference: &plan.reference, tilt: &plan.tilt }, &mut input);
        record(&mut log, system, time, pilot.tracked(&x), (&x, &input), &plan.reference.sample(time), air)?;
        if pilot.holds_tilt() {
            let asked = plan.tilt.orientation(&plan.reference, time).attitude;
            log.asked_angles.push(to_euler(from_matrix(asked)));
        }
        states.extend_from_slice(&x);
        system.step(&x, &input, &[], &mut next);
        if next.iter().any(|v| !safe::is_bounded(*v, EXPLODED)) {
            diverged_at = Some(time + plan.physics.dt);
            break;
        }
        std::mem::swap(&mut x, &mut next);
        progress(k);
    }
    Ok(RigFlight { log, states, diverged_at })
}

/// Logs the tracked point and all rotors.
fn record(
    log: &mut FlightLog,
    system: &Multibody,
    time: f64,
    own: Kinematics<f64>,
    (state, input): (&[f64], &[f64]),
    wanted: &Sample<f64>,
    wind: [f64; 3],
) -> Result<()> {
    let (rotors, layout) = (system.model().rotors(), system.layout());
    let speed: Vec<f64> = layout.rotor_speed.iter().map(|at| state[*at]).collect();
    let thrust: Vec<f64> = rotors.iter().zip(&speed).map(|(r, s)| r.rotor.thrust_coefficient * s * s).collect();
    let commands = rotors.iter().zip(&layout.rotor_action);
    let command: Vec<f64> = commands.map(|(r, at)| commanded_speed(r.rotor.max_speed, input[*at])).collect();
    log.push(flight::Sample {
        time,
        position: own.position,
        velocity: own.velocity,
        attitude: own.attitude,
        angular_velocity: own.angular_velocity,
        reference_position: wanted.position,
        reference_velocity: wanted.velocity,
        reference_acceleration: wanted.acceleration,
        reference_yaw: wanted.yaw,
        rotor_speed: &speed,
        rotor_command: &command,
        thrust: &thrust,
        wind,
    })
}
