//! A whole flight: a vehicle under its cascade along a reference, logged.

use super::cascade::Rates;
use super::closed_loop::ClosedLoop;
use super::reference::{Reference, Tilt};
use crate::autodiff::{System, safe};
use crate::dynamics::aero::wind::{Wind, WindState};
use crate::dynamics::batch::EXPLODED;
use crate::dynamics::rigid::RIGID_DIM;
use crate::dynamics::{Disturbance, Gains, Physics, Rotor, Vehicle};
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
}

impl Default for FlightPlan {
    /// The paper's lemniscate for 15 s at 2 ms in still air.
    fn default() -> Self {
        Self {
            reference: Reference::Lemniscate(Default::default()),
            tilt: Tilt::LEVEL,
            duration: 15.0,
            physics: Physics::default(),
            rates: Rates::default(),
            wind: Wind::Calm,
            seed: 0,
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
    /// Where to take derivatives.
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
    fn new(system: &ClosedLoop, state: &[f64]) -> Self {
        let (input, actions) = (vec![0.0; system.n_input()], vec![0.0; system.plant().vehicle().n_rotor()]);
        Self { state: state.to_vec(), input, actions, margin: -1.0 }
    }

    /// Moves here if this step is farther from the kinks.
    fn consider(&mut self, system: &ClosedLoop, x: &[f64], input: &[f64], next: &[f64]) {
        let actions = system.rotor_actions(next);
        let mut margin = f64::INFINITY;
        for ((rotor, a), speed) in system.plant().vehicle().rotors.iter().zip(actions).zip(&x[RIGID_DIM..]) {
            let gap = (commanded_speed(rotor, *a) - speed).abs() / rotor.max_speed;
            margin = margin.min(gap).min(1.0 - a.abs());
        }
        if margin > self.margin {
            self.margin = margin;
            self.state.copy_from_slice(x);
            self.input.copy_from_slice(input);
            self.actions.copy_from_slice(actions);
        }
    }
}

/// Ω_cmd of an action.
fn commanded_speed(rotor: &Rotor, action: f64) -> f64 {
    rotor.max_speed * safe::sqrt((action.clamp(-1.0, 1.0) + 1.0) * 0.5, 1e-4)
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

/// Flies a vehicle with `gains` along the plan. `progress` is told the number of each finished step.
///
/// A flight that diverges ends there; the log holds what came before.
///
/// # Errors
/// [`Error::Value`] or [`Error::Limit`] if vehicle, gains or plan are not valid.
pub fn fly(vehicle: &Vehicle, gains: &Gains, plan: &FlightPlan, progress: &mut dyn FnMut(u64)) -> Result<Flight> {
    let n_step = plan.n_step()?;
    if !plan.tilt.is_level() {
        let (what, rule) = (format!("tilt of vehicle '{}'", vehicle.name), "level: its force turns with it");
        let value = format!("roll {}, pitch {} rad", plan.tilt.roll, plan.tilt.pitch);
        return Err(Error::value(what, value, rule, "Fly one that can hold it, such as omav_tilting."));
    }
    let mut physics = plan.physics;
    let windy = plan.wind != Wind::Calm;
    physics.effects.disturbance |= windy;
    let system = ClosedLoop::new(vehicle, physics, gains, &plan.rates)?;
    let mut wind = WindState::new(plan.wind.clone(), Stream::new(plan.seed, 0, 0, Purpose::WIND))?;
    let mut air = Disturbance::none();

    let start = plan.reference.sample(0.0);
    let mut x = system.initial_state(&start_state(&system, start.position, start.yaw)?);
    let mut next = x.clone();
    let mut input = vec![0.0; system.n_input()];
    let mut log = FlightLog::new(&vehicle.name, &vehicle.rotors.iter().map(|r| r.max_speed).collect::<Vec<_>>());
    let mut diverged_at = None;
    let mut smoothest = SmoothPoint::new(&system, &x);
    for k in 0..=n_step {
        let time = k as f64 * physics.dt;
        let wanted = plan.reference.sample(time);
        if windy {
            air.wind = wind.sample(physics.dt);
        }
        system.write_input(k, &wanted, &air, &mut input);
        system.step(&x, &input, &[], &mut next);
        record(&mut log, &system, time, &x, &next, &wanted, &air)?;
        if next[..system.n_plant_state()].iter().any(|v| !safe::is_bounded(*v, EXPLODED)) {
            diverged_at = Some(time + physics.dt);
            break;
        }
        if system.computes_all(k) {
            smoothest.consider(&system, &x, &input, &next);
        }
        std::mem::swap(&mut x, &mut next);
        progress(k);
    }
    Ok(Flight { log, diverged_at, smoothest })
}

/// Hover at a point with a yaw.
fn start_state(system: &ClosedLoop, position: [f64; 3], yaw: f64) -> Result<Vec<f64>> {
    let mut state = system.plant().hover_state(position)?;
    let (s, c) = (0.5 * yaw).sin_cos();
    state[6..10].copy_from_slice(&[c, 0.0, 0.0, s]);
    Ok(state)
}

/// Logs the state `x` at `time` and the commands given in it, which are in the memory of `next`.
fn record(
    log: &mut FlightLog,
    system: &ClosedLoop,
    time: f64,
    x: &[f64],
    next: &[f64],
    wanted: &super::Sample<f64>,
    air: &Disturbance<f64>,
) -> Result<()> {
    let rotors = &system.plant().vehicle().rotors;
    let speed = &x[RIGID_DIM..RIGID_DIM + rotors.len()];
    let thrust: Vec<f64> = rotors.iter().zip(speed).map(|(r, s)| r.thrust_coefficient * s * s).collect();
    let command: Vec<f64> =
        rotors.iter().zip(system.rotor_actions(next)).map(|(r, a)| commanded_speed(r, *a)).collect();
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
