//! A whole flight: a vehicle under its cascade along a reference, logged.

use super::allocation::failure::{Failure, damaged, health};
use super::cascade::Rates;
use super::closed_loop::{ClosedLoop, with_drag_of};
use super::fault_tolerant::FaultTolerant;
use super::kinematics::Kinematics;
use super::reference::{Reference, Tilt};
use crate::autodiff::{System, safe};
use crate::dynamics::aero::wind::{Wind, WindState};
use crate::dynamics::batch::EXPLODED;
use crate::dynamics::rigid::RIGID_DIM;
use crate::dynamics::rotor::commanded_speed;
use crate::dynamics::{Disturbance, Gains, Multirotor, Physics, Rotor, Vehicle};
use crate::error::{Error, Result};
use crate::flight::{FlightLog, Sample};
use crate::rng::{Purpose, Stream};
use serde::{Deserialize, Serialize};

/// What to fly, for how long, in what air.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlightPlan {
    /// The reference to track; the flight starts on it, at rest.
    pub reference: Reference,
    /// Roll and pitch beside it, for what can hold them; level unless told otherwise.
    pub tilt: Tilt,
    /// s.
    pub duration: f64,
    /// Time step, integrator, effects; `disturbance` is switched on where there is wind.
    pub physics: Physics,
    /// How often each control level computes.
    pub rates: Rates,
    /// Wind along the flight.
    pub wind: Wind,
    /// Of the wind.
    pub seed: u64,
    /// Rotors that weaken or stop on the way.
    pub failures: Vec<Failure>,
    /// How long after a failure the controller knows of it and of what is left, s; until then it flies on as before.
    pub detection_delay: f64,
}

impl Default for FlightPlan {
    /// The paper's lemniscate for 15 s at 2 ms in still air, failures known after 50 ms.
    fn default() -> Self {
        Self {
            reference: Reference::Lemniscate(Default::default()),
            tilt: Tilt::LEVEL,
            duration: 15.0,
            physics: Physics::default(),
            rates: Rates::default(),
            wind: Wind::Calm,
            seed: 0,
            failures: Vec::new(),
            detection_delay: 0.05,
        }
    }
}

/// A finished flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Flight {
    /// Everything up to the end, or to the last healthy state.
    pub log: FlightLog,
    /// When the vehicle's state left |x| < 1e8 (SI units, as in a [`World`](crate::dynamics::World)) or became not a
    /// number, s; `None` for a whole flight.
    pub diverged_at: Option<f64>,
    /// Where to take derivatives; in a flight with failures nowhere (its margin is negative).
    pub smoothest: SmoothPoint,
}

/// The step of a flight, of those in which every level computed, that lies farthest from the kinks of the closed loop:
/// rotor commands at a limit, and motors between speeding up and slowing down.
#[derive(Debug, Clone, PartialEq)]
pub struct SmoothPoint {
    /// State of the [`ClosedLoop`].
    pub state: Vec<f64>,
    /// Input of the [`ClosedLoop`].
    pub input: Vec<f64>,
    /// The rotor actions it answered with.
    pub actions: Vec<f64>,
    /// Least distance to a kink over the rotors, as a fraction of the range of a command or speed; negative if no step
    /// qualified.
    pub margin: f64,
}

impl SmoothPoint {
    fn new(n_rotor: usize, state: &[f64]) -> Self {
        Self { state: state.to_vec(), input: Vec::new(), actions: vec![0.0; n_rotor], margin: -1.0 }
    }

    /// Moves here if this step is farther from the kinks.
    fn consider(&mut self, system: &ClosedLoop, x: &[f64], input: &[f64], next: &[f64]) {
        let actions = system.rotor_actions(next);
        let mut margin = f64::INFINITY;
        for ((rotor, a), speed) in system.plant().vehicle().rotors.iter().zip(actions).zip(&x[RIGID_DIM..]) {
            let gap = (commanded_speed(rotor.max_speed, *a) - speed).abs() / rotor.max_speed;
            margin = margin.min(gap).min(1.0 - a.abs());
        }
        if margin > self.margin {
            self.margin = margin;
            self.state.copy_from_slice(x);
            self.input.clear();
            self.input.extend_from_slice(input);
            self.actions.copy_from_slice(actions);
        }
    }
}

/// Longest flight, in steps: what a log may hold.
pub const MAX_STEPS: f64 = 5e6;

impl FlightPlan {
    /// Number of steps.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] if the plan is not valid or has more than [`MAX_STEPS`] steps.
    pub fn n_step(&self) -> Result<u64> {
        self.physics.validate()?;
        self.reference.validate()?;
        self.tilt.validate()?;
        self.wind.validate()?;
        if !(0.0..=1e3).contains(&self.detection_delay) {
            let remedy = "Real detectors take 10 to 100 ms.";
            return Err(Error::value("detection_delay", self.detection_delay, "within [0, 1000] s", remedy));
        }
        let steps = (self.duration / self.physics.dt).round();
        if !(1.0..=MAX_STEPS).contains(&steps) {
            return Err(Error::limit(
                "duration",
                format!("{} s ({steps} steps of {} s)", self.duration, self.physics.dt),
                format!("1 to {MAX_STEPS} steps"),
                "Fly shorter, or with a larger dt.",
            ));
        }
        Ok(steps as u64)
    }
}

/// Flies a vehicle with `gains` along the plan, from rest on its reference. `progress` is told the number of each
/// finished step.
///
/// A flight that diverges ends there; the log holds what came before. Where rotors fail, the plant loses them with the
/// lag of their motors and [`FaultTolerant`] steers, told of each failure after the plan's delay.
///
/// # Errors
/// [`Error::Value`] or [`Error::Limit`] if vehicle, gains or plan are not valid.
pub fn fly(vehicle: &Vehicle, gains: &Gains, plan: &FlightPlan, progress: &mut dyn FnMut(u64)) -> Result<Flight> {
    let start = plan.reference.sample(0.0);
    let state = start_state(&Multirotor::new(vehicle, plan.physics)?, start.position, start.yaw)?;
    fly_from(vehicle, gains, plan, &state, progress)
}

/// As [`fly`], from any state of the vehicle (13 + n numbers, see [`RigidState`](crate::dynamics::RigidState)).
///
/// # Errors
/// As [`fly`]; [`Error::Value`] if the state is not finite or not of this length.
pub fn fly_from(
    vehicle: &Vehicle,
    gains: &Gains,
    plan: &FlightPlan,
    state: &[f64],
    progress: &mut dyn FnMut(u64),
) -> Result<Flight> {
    let n_step = plan.n_step()?;
    if !plan.tilt.is_level() {
        let (what, rule) = (format!("tilt of vehicle '{}'", vehicle.name), "level: its force turns with it");
        let value = format!("roll {}, pitch {} rad", plan.tilt.roll, plan.tilt.pitch);
        return Err(Error::value(what, value, rule, "Fly one that can hold it, such as omav_tilting."));
    }
    for failure in &plan.failures {
        failure.validate(vehicle.n_rotor())?;
    }
    let n_state = RIGID_DIM + vehicle.n_rotor();
    if state.len() != n_state {
        let limit = format!("{n_state}, 13 and one per rotor");
        return Err(Error::value("start: length of the state", state.len(), limit, "Take Multirotor::hover_state."));
    }
    crate::error::finite("start: state", state)?;
    let mut physics = plan.physics;
    physics.effects.disturbance |= plan.wind != Wind::Calm;
    let mut system = Steered::new(vehicle, gains, plan, physics)?;
    let mut wind = WindState::new(plan.wind.clone(), Stream::new(plan.seed, 0, 0, Purpose::WIND))?;
    let mut air = Disturbance::none();

    let mut x = system.initial_state(state);
    let mut next = x.clone();
    let mut log = FlightLog::new(&vehicle.name, &vehicle.rotors.iter().map(|r| r.max_speed).collect::<Vec<_>>());
    let mut diverged_at = None;
    let mut smoothest = SmoothPoint::new(vehicle.n_rotor(), &x);
    for k in 0..=n_step {
        let time = k as f64 * physics.dt;
        let wanted = plan.reference.sample(time);
        if physics.effects.disturbance {
            air.wind = wind.sample(physics.dt);
        }
        system.step(k, &x, &wanted, &air, &mut next)?;
        record(&mut log, system.rotors(), system.actions(&next), time, &x, &wanted, &air)?;
        if next[..n_state].iter().any(|v| !safe::is_bounded(*v, EXPLODED)) {
            diverged_at = Some(time + physics.dt);
            break;
        }
        system.consider(k, &x, &next, &mut smoothest);
        std::mem::swap(&mut x, &mut next);
        progress(k);
    }
    Ok(Flight { log, diverged_at, smoothest })
}

/// A vehicle and who steers it.
enum Steered {
    /// Whole, as one differentiable system.
    Whole { system: Box<ClosedLoop>, input: Vec<f64> },
    /// With rotors that fail.
    Failing(Box<Failing>),
}

/// A vehicle as it is by now, and a controller that knows of it a little later.
struct Failing {
    vehicle: Vehicle,
    failures: Vec<Failure>,
    delay: f64,
    plant: Multirotor,
    health: Vec<f64>,
    pilot: FaultTolerant,
    known: Vec<f64>,
    input: Vec<f64>,
}

impl Steered {
    fn new(vehicle: &Vehicle, gains: &Gains, plan: &FlightPlan, physics: Physics) -> Result<Self> {
        if plan.failures.is_empty() {
            let system = Box::new(ClosedLoop::new(vehicle, physics, gains, &plan.rates)?);
            let input = vec![0.0; system.n_input()];
            return Ok(Self::Whole { system, input });
        }
        let plant = Multirotor::new(vehicle, physics)?;
        let whole = vec![1.0; vehicle.n_rotor()];
        Ok(Self::Failing(Box::new(Failing {
            vehicle: vehicle.clone(),
            failures: plan.failures.clone(),
            delay: plan.detection_delay,
            pilot: FaultTolerant::new(&with_drag_of(vehicle, physics.effects), gains, &plan.rates, physics.dt)?,
            input: vec![0.0; plant.n_input()],
            plant,
            known: whole.clone(),
            health: whole,
        })))
    }

    fn initial_state(&self, vehicle_state: &[f64]) -> Vec<f64> {
        match self {
            Self::Whole { system, .. } => system.initial_state(vehicle_state),
            Self::Failing(_) => vehicle_state.to_vec(),
        }
    }

    /// The rotors as they are by now.
    fn rotors(&self) -> &[Rotor] {
        match self {
            Self::Whole { system, .. } => &system.plant().vehicle().rotors,
            Self::Failing(f) => &f.plant.vehicle().rotors,
        }
    }

    /// The rotor actions of the step that led to `next`.
    fn actions<'a>(&'a self, next: &'a [f64]) -> &'a [f64] {
        match self {
            Self::Whole { system, .. } => system.rotor_actions(next),
            Self::Failing(f) => &f.input[..f.vehicle.n_rotor()],
        }
    }

    fn step(
        &mut self,
        k: u64,
        x: &[f64],
        wanted: &super::Sample<f64>,
        air: &Disturbance<f64>,
        next: &mut [f64],
    ) -> Result<()> {
        match self {
            Self::Whole { system, input } => {
                system.write_input(k, wanted, air, input);
                system.step(x, input, &[], next);
                Ok(())
            }
            Self::Failing(f) => f.step(k, x, wanted, air, next),
        }
    }

    fn consider(&self, k: u64, x: &[f64], next: &[f64], smoothest: &mut SmoothPoint) {
        if let Self::Whole { system, input } = self
            && system.computes_all(k)
        {
            smoothest.consider(system, x, input, next);
        }
    }
}

impl Failing {
    fn step(
        &mut self,
        k: u64,
        x: &[f64],
        wanted: &super::Sample<f64>,
        air: &Disturbance<f64>,
        next: &mut [f64],
    ) -> Result<()> {
        let physics = *self.plant.physics();
        let n = self.vehicle.n_rotor();
        // times are multiples of dt up to rounding
        let time = (k as f64 + 1e-6) * physics.dt;
        let health_now = health(n, &self.failures, time);
        if health_now != self.health {
            self.plant = Multirotor::new(&damaged(&self.vehicle, &health_now), physics)?;
            self.health = health_now;
        }
        let known_now = health(n, &self.failures, time - self.delay);
        if known_now != self.known {
            self.pilot.tell(&known_now)?;
            self.known = known_now;
        }
        let actions = self.pilot.position(&Kinematics::read(x), wanted);
        self.input[..n].copy_from_slice(&actions[..n]);
        air.write(&mut self.input[n..]);
        self.plant.step(x, &self.input, &[], next);
        Ok(())
    }
}

/// Hover at a point with a yaw.
fn start_state(plant: &Multirotor, position: [f64; 3], yaw: f64) -> Result<Vec<f64>> {
    let mut state = plant.hover_state(position)?;
    let (s, c) = (0.5 * yaw).sin_cos();
    state[6..10].copy_from_slice(&[c, 0.0, 0.0, s]);
    Ok(state)
}

/// Logs the state `x` at `time` and the actions given in it.
fn record(
    log: &mut FlightLog,
    rotors: &[Rotor],
    actions: &[f64],
    time: f64,
    x: &[f64],
    wanted: &super::Sample<f64>,
    air: &Disturbance<f64>,
) -> Result<()> {
    let speed = &x[RIGID_DIM..RIGID_DIM + rotors.len()];
    let thrust: Vec<f64> = rotors.iter().zip(speed).map(|(r, s)| r.thrust_coefficient * s * s).collect();
    let command: Vec<f64> = rotors.iter().zip(actions).map(|(r, a)| commanded_speed(r.max_speed, *a)).collect();
    let three = |at: usize| [x[at], x[at + 1], x[at + 2]];
    log.push(Sample {
        time,
        position: three(0),
        velocity: three(3),
        attitude: [x[6], x[7], x[8], x[9]],
        angular_velocity: three(10),
        reference_position: wanted.position,
        reference_velocity: wanted.velocity,
        reference_acceleration: wanted.acceleration,
        reference_yaw: wanted.yaw,
        rotor_speed: speed,
        rotor_command: &command,
        thrust: &thrust,
        wind: air.wind,
    })
}
