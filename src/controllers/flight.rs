//! A whole flight: a plant under its controller along a reference, logged.

use super::allocation::failure::RotorFailure;
use super::cascade::{RateDivisors, Rates};
use super::closed_loop::{ClosedLoop, ExogenousInputs, check_delay, check_latency};
use super::controller::{Controller, Target};
use super::filter::FilterSettings;
use super::hover_axes::HoverAxes;
use super::reference::{Reference, Setpoint, Tilt};
use super::registry::{Setup, controller};
use super::start::start_on;
use crate::estimation::{ESTIMATORS, EstimateTally, EstimatedState, EstimatorSettings, InnovationRecord};
use autodiff::safe;
use base::error::{Error, Result};
use base::memory::Request;
use dynamics::aero::wind::{Wind, WindState};
use dynamics::batch::DIVERGED_ABOVE;
use dynamics::rotor::commanded_speed;
use dynamics::sensors::{OnboardSensors, ReadingLayout, Sensor, SensorConfig};
use dynamics::spatial::{Mat3, from_matrix, to_euler};
use dynamics::tree::check_start;
use dynamics::{Disturbance, Gains, Physics, Plant, Vehicle};
use flight::{self, FlightLog, Scans};
use rng::{Purpose, Stream};
use serde::{Deserialize, Serialize};

/// Farther from the reference than this, beyond what the reference itself jumps, a flight is lost, m.
pub const LOST: f64 = 10.0;

/// What to fly, for how long, in what air.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlightPlan {
    /// The reference to track; the flight starts on it, at rest.
    pub reference: Reference,
    /// Roll and pitch beside it, for what can hold them. Default level.
    pub tilt: Tilt,
    /// Length of the flight, s; at most 5 million steps. Default 15.
    pub duration: f64,
    /// Time step, integrator, effects; `disturbance` is switched on where there is wind.
    pub physics: Physics,
    /// How often each control level computes: what the controller was built for.
    pub rates: Rates,
    /// Filters of the measured angular velocity, first to last: what the cascade of one vehicle was built with. Default none.
    pub filters: Vec<FilterSettings>,
    /// Wind along the flight. Default none.
    pub wind: Wind,
    /// Seed of the wind and of what sensors read. Default 0.
    pub seed: u64,
    /// Rotors that weaken or stop on the way. Default none.
    pub failures: Vec<RotorFailure>,
    /// How long after a failure the controller knows of it and of what is left, s; until then it flies on as before. Default 0.05.
    pub detection_delay: f64,
    /// Steps by which commands act late, 0 to 1000. Default 0.
    pub latency: usize,
    /// Sensors that read along, into the log; controllers are given the truth unless there is an `estimator`. Default none.
    pub sensors: Vec<SensorConfig>,
    /// An estimator of the state from what they read, whose estimate the controller is given in place of the truth. Default none.
    pub estimator: Option<EstimatorSettings>,
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
            filters: Vec::new(),
            wind: Wind::Calm,
            seed: 0,
            failures: Vec::new(),
            detection_delay: 0.05,
            latency: 0,
            sensors: Vec::new(),
            estimator: None,
        }
    }
}

/// A finished flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Flight {
    /// Of what was tracked, with all rotors, up to the end or to the last healthy state.
    pub log: FlightLog,
    /// Row-major `[sample, number]`: the plant's state, one row per entry of the log.
    pub states: Vec<f64>,
    /// When the plant's state left |x| < 1e8 (SI units, as in a [`World`](dynamics::World)) or became not a
    /// number, s; `None` for a whole flight.
    pub diverged_at: Option<f64>,
    /// Where to take derivatives, [beside kinks](SmoothPoint::beside_kinks); in a flight with failures or latency nowhere (its margin is
    /// negative).
    pub smoothest: SmoothPoint,
    /// What was estimated on the way, with an `estimator`.
    pub estimates: Option<FlightEstimates>,
}

/// What a filter made of the sensors of a flight.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightEstimates {
    /// Row-major `[sample, 19]`: place (m, world), velocity (m/s, world) and attitude (body → world) as they were estimated, then standard
    /// deviations of place, velocity and attitude (rad, about the axes of the inertial unit); of an estimator without a covariance
    /// `[sample, 10]`.
    pub rows: Vec<f64>,
    /// Name of the kind of estimator.
    pub kind: &'static str,
    /// How they compared with the truth.
    pub tally: EstimateTally,
    /// How readings agreed with what was expected of them.
    pub records: Vec<InnovationRecord>,
    /// Samples of the inertial unit at a limit.
    pub saturated: u64,
    /// How often the filter began anew, knowing nothing.
    pub begun_anew: u64,
}

impl FlightEstimates {
    /// Numbers of a row with deviations.
    pub const DIM: usize = 19;

    /// Numbers of a row.
    pub fn width(&self) -> usize {
        if self.has_covariance() { Self::DIM } else { 10 }
    }

    /// Whether the estimator knows how good its estimate is.
    pub fn has_covariance(&self) -> bool {
        ESTIMATORS.iter().any(|entry| entry.name == self.kind && entry.has_covariance)
    }
}

/// A row of [`FlightEstimates`].
fn write_estimate(estimate: &EstimatedState, rows: &mut Vec<f64>) {
    rows.extend_from_slice(&estimate.state()[..10]);
    rows.extend(estimate.filter().deviations().into_iter().flatten());
}

impl Flight {
    /// When the tracked point was first more than 10 m (`LOST`) from the reference, the largest jump of the reference between
    /// two steps allowed for, s, and how far it came, m; `None` for a flight that was not lost.
    pub fn lost(&self) -> Option<(f64, f64)> {
        let (errors, wanted) = (self.log.error_norm(), &self.log.reference_position);
        let jump = |pair: &[[f64; 3]]| safe::norm([0, 1, 2].map(|k| pair[1][k] - pair[0][k]));
        let most = LOST + wanted.windows(2).map(jump).fold(0.0, f64::max);
        let first = errors.iter().position(|e| e.is_nan() || *e > most)?;
        Some((self.log.time[first], errors.iter().fold(0.0, |far: f64, e| far.max(*e))))
    }
}

/// The step of a flight, of those in which every level computed, that lies farthest from the kinks of the closed loop:
/// rotor commands at a limit, and motors between speeding up and slowing down.
#[derive(Debug, Clone, PartialEq)]
pub struct SmoothPoint {
    /// Number of the step.
    pub step: u64,
    /// State of the loop before it: the plant's, then the controller's memory.
    pub state: Vec<f64>,
    /// Input of the plant in it.
    pub input: Vec<f64>,
    /// The air in it.
    pub air: Disturbance<f64>,
    /// Least distance to a kink over the rotors, as a fraction of the range of a command or speed; negative if no step
    /// qualified.
    pub margin: f64,
}

impl SmoothPoint {
    fn nowhere() -> Self {
        Self { step: 0, state: Vec::new(), input: Vec::new(), air: Disturbance::none(), margin: -1.0 }
    }

    /// Moves here if this step is farther from the kinks.
    fn consider(
        &mut self,
        plant: &Plant,
        step: u64,
        (x, memory): (&[f64], &[f64]),
        input: &[f64],
        air: &Disturbance<f64>,
    ) {
        let mut margin = f64::INFINITY;
        for (rotor, place) in plant.rotors().into_iter().zip(plant.rotor_places()) {
            let (a, speed) = (input[place.action], x[place.speed]);
            let gap = (commanded_speed(rotor.max_speed, a) - speed).abs() / rotor.max_speed;
            margin = margin.min(gap).min(1.0 - a.abs());
        }
        if margin > self.margin {
            *self = Self { step, state: [x, memory].concat(), input: input.to_vec(), air: *air, margin };
        }
    }
}

/// Nearer to a kink than this, a step lies on it: differences are taken over steps as long.
const ON_KINK: f64 = 1e-4;
/// How far from it derivatives are judged instead.
const BESIDE: f64 = 0.01;

impl SmoothPoint {
    /// The same step moved off the kinks that it lies on; `None` where it lies on none.
    ///
    /// A motor at the speed that it is commanded, as in every steady hover, has one lag to speed up and another to slow down:
    /// there is no derivative there. Its speed is moved by 2 % of the largest, of one rotor up and of the next one down, so that
    /// both lags are seen; a command at its limit is moved inwards by 1 % of its range.
    pub fn beside_kinks(&self, plant: &Plant) -> Option<Self> {
        if !(0.0..ON_KINK).contains(&self.margin) {
            return None;
        }
        let mut moved = self.clone();
        for (i, (rotor, place)) in plant.rotors().into_iter().zip(plant.rotor_places()).enumerate() {
            let (action, speed) = (&mut moved.input[place.action], &mut moved.state[place.speed]);
            *action = action.clamp(2.0 * BESIDE - 1.0, 1.0 - 2.0 * BESIDE);
            let (command, most) = (commanded_speed(rotor.max_speed, *action), rotor.max_speed);
            let gap = 2.0 * BESIDE * most;
            if (command - *speed).abs() < gap {
                let up = command - gap < 0.0 || (i % 2 == 0 && command + gap < most);
                *speed = if up { command + gap } else { command - gap };
            }
        }
        moved.margin = BESIDE;
        Some(moved)
    }
}

/// Longest flight, in steps: what a log may hold.
pub const MAX_STEPS: f64 = 5e6;

impl FlightPlan {
    /// Its physics, with the effect `disturbance` where there is wind.
    pub fn air_physics(&self) -> Physics {
        let mut physics = self.physics;
        physics.effects.disturbance |= self.wind != Wind::Calm;
        physics
    }

    /// Number of steps.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] if the plan is not valid or has more than `MAX_STEPS` steps.
    pub fn n_step(&self) -> Result<u64> {
        self.physics.validate()?;
        self.reference.validate()?;
        self.tilt.validate()?;
        self.wind.validate()?;
        check_delay(self.detection_delay)?;
        check_latency(self.latency)?;
        let steps = (self.duration / self.physics.dt).round();
        if steps.is_nan() || steps < 1.0 {
            let (value, limit) = (format!("{} s", self.duration), format!("a step of {} s at least", self.physics.dt));
            return Err(Error::value("duration", value, limit, "Give seconds: 15 is usual."));
        }
        if steps > MAX_STEPS {
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

/// The log and the states of a flight fit.
fn check_memory(plan: &FlightPlan, n_step: u64, plant: &Plant) -> Result<()> {
    let (mut n_reading, mut scanned) = (0, 0);
    for sensor in &plan.sensors {
        let n = sensor.model.channels().len();
        match sensor.model.layout() {
            ReadingLayout::Vector => n_reading += n,
            // one row per reading
            _ => scanned += (n_step / sensor.steps_between(plan.physics.dt)? + 1) as u128 * (1 + n as u128),
        }
    }
    let estimated = if plan.estimator.is_some() { FlightEstimates::DIM * size_of::<f64>() } else { 0 };
    let each = (FlightLog::bytes_of_sample(plant, n_reading) + estimated) as u128;
    // columns double where they are full
    let bytes = 2 * (u128::from(n_step) * each + scanned * size_of::<f64>() as u128);
    let (value, less) = (format!("{} s", plan.duration), "Fly shorter, or with a larger dt");
    let request = Request { what: "duration", value, bytes, limit: u64::MAX, setting: "it", less };
    request.check(|limit| format!("{:.0} s", plan.duration * limit as f64 / bytes as f64))
}

/// Flies a plant under a controller along the plan, from rest on its reference. `progress` is called with the number of each
/// finished step.
///
/// A flight that diverges ends there; the log holds what came before. Where rotors fail, the plant loses them with the
/// lag of their motors, and the controller learns of it after the plan's delay.
///
/// # Errors
/// [`Error::Value`] or [`Error::Limit`] if the plan is not valid, or not for this plant and this controller: other physics
/// (but for the effect `disturbance`), other rates or filters, wind without that effect, a tilt that is not held. As [`OnboardSensors::new`] for
/// its sensors, and as `check_start` where the reference begins inside of something.
pub fn fly(
    plant: &Plant,
    controller: &mut dyn Controller,
    plan: &FlightPlan,
    progress: &mut dyn FnMut(u64),
) -> Result<Flight> {
    fly_while(plant, controller, plan, &mut |k| {
        progress(k);
        Ok(())
    })
}

/// As [`fly`], ended by the first error of `progress`, which is handed on.
///
/// # Errors
/// As [`fly`], and that of `progress`.
pub fn fly_while(
    plant: &Plant,
    controller: &mut dyn Controller,
    plan: &FlightPlan,
    progress: &mut dyn FnMut(u64) -> Result<()>,
) -> Result<Flight> {
    let start = start_on(plant, controller, &plan.reference)?;
    flown(plant, controller, plan, &start, progress)
}

/// As [`fly`], from any state of the plant.
///
/// # Errors
/// As [`fly`]; [`Error::Value`] if the state is not finite or not of the plant's length; as `check_start`.
pub fn fly_from(
    plant: &Plant,
    controller: &mut dyn Controller,
    plan: &FlightPlan,
    state: &[f64],
    progress: &mut dyn FnMut(u64),
) -> Result<Flight> {
    flown(plant, controller, plan, state, &mut |k| {
        progress(k);
        Ok(())
    })
}

fn flown(
    plant: &Plant,
    controller: &mut dyn Controller,
    plan: &FlightPlan,
    state: &[f64],
    progress: &mut dyn FnMut(u64) -> Result<()>,
) -> Result<Flight> {
    let n_step = plan.n_step()?;
    plant.check_state(state)?;
    plant.tree().map_or(Ok(()), |system| check_start(system, state))?;
    check_memory(plan, n_step, plant)?;
    fits(plant, controller, plan)?;
    let (dt, windy) = (plan.physics.dt, plan.wind != Wind::Calm);
    let whole = plan.failures.is_empty() && plan.latency == 0;
    let schedule = RateDivisors::new(&plan.rates, dt).ok().filter(|_| whole);
    let holds_tilt = controller.holds_tilt();
    let speeds: Vec<f64> = plant.rotors().iter().map(|r| r.max_speed).collect();
    let mut log = FlightLog::new(plant.name(), &speeds);
    log.hover_attitude = HoverAxes::of_plant(plant).attitude_in_hover();
    let mut system = ClosedLoop::new(plant.clone(), controller)?
        .with_failures(&plan.failures, plan.detection_delay)?
        .with_latency(plan.latency)?
        .with_sensors(&plan.sensors, plan.seed)?;
    if let Some(settings) = &plan.estimator {
        system = system.with_estimator(&plan.sensors, settings)?;
    }
    let mut estimates = Vec::new();
    let mut wind = WindState::new(plan.wind.clone(), Stream::new(plan.seed, 0, 0, Purpose::WIND))?;
    let target = Target { reference: &plan.reference, tilt: &plan.tilt };
    let mut outside = ExogenousInputs::none();
    let few = name_readings(&mut log, system.sensors(), &plan.sensors);

    let (mut x, mut next) = (state.to_vec(), state.to_vec());
    let (mut states, mut memory) = (Vec::new(), Vec::new());
    let (mut diverged_at, mut smoothest) = (None, SmoothPoint::nowhere());
    for k in 0..=n_step {
        let time = k as f64 * dt;
        if windy {
            outside.air.wind = wind.sample(dt);
        }
        memory.clear();
        memory.extend_from_slice(system.controller().memory());
        system.advance(&x, target, &outside, &mut next)?;
        record(&mut log, &system, time, &x, &target.sample(time), outside.air.wind)?;
        log.commanded.extend(system.controller().commanded());
        record_readings(&mut log, system.sensors(), &few, time);
        if let Some(estimate) = system.estimate() {
            write_estimate(estimate, &mut estimates);
        }
        if holds_tilt {
            log.asked_angles.push(angles(target.orientation(time).attitude));
        }
        states.extend_from_slice(&x);
        if next.iter().any(|v| !safe::is_bounded(*v, DIVERGED_ABOVE)) {
            diverged_at = Some(time + dt);
            break;
        }
        if schedule.is_some_and(|s| s.ticks(k) == [1.0; 3]) {
            smoothest.consider(plant, k, (&x, &memory), system.applied(), &outside.air);
        }
        std::mem::swap(&mut x, &mut next);
        progress(k)?;
    }
    let estimates = system.estimate().map(|own| FlightEstimates {
        rows: estimates,
        kind: own.filter().kind(),
        tally: own.tally().clone(),
        records: own.filter().records().to_vec(),
        saturated: own.filter().saturated(),
        begun_anew: own.filter().begun_anew(),
    });
    Ok(Flight { log, states, diverged_at, smoothest, estimates })
}

/// A vehicle with `gains` under its cascade along the plan, from rest on its reference; with rotors that fail, under the
/// one that flies on with what is left.
///
/// # Errors
/// As [`fly`], and if vehicle or gains are not valid.
pub fn fly_vehicle(
    vehicle: &Vehicle,
    gains: &Gains,
    plan: &FlightPlan,
    progress: &mut dyn FnMut(u64),
) -> Result<Flight> {
    plan.n_step()?;
    let plant = Plant::of_vehicle(vehicle, plan.air_physics())?;
    let name = if plan.failures.is_empty() { "cascade" } else { "fault_tolerant" };
    fly(
        &plant,
        &mut controller(name, &plant, &Setup { filters: &plan.filters, ..Setup::new(Some(gains), &plan.rates) })?,
        plan,
        progress,
    )
}

/// Refuses a plan that says otherwise than plant and controller.
fn fits(plant: &Plant, controller: &dyn Controller, plan: &FlightPlan) -> Result<()> {
    let (own, mut planned) = (plant.physics(), plan.physics);
    planned.effects.disturbance = own.effects.disturbance;
    if planned != *own {
        let remedy = "Give the plan the plant's: plan.physics = *plant.physics().";
        return Err(Error::value("plan.physics", format!("{:?}", plan.physics), "those of the plant", remedy));
    }
    if controller.schedule().is_some_and(|s| RateDivisors::new(&plan.rates, own.dt).ok() != Some(s)) {
        let value = format!("{:?}", plan.rates);
        let rule = format!("those that controller '{}' was built for", controller.name());
        return Err(Error::value("plan.rates", value, rule, "Build the controller with plan.rates."));
    }
    if plan.filters != controller.filters() {
        let value = format!("{:?}", plan.filters);
        let rule = format!("those that controller '{}' was built with", controller.name());
        return Err(Error::value(
            "plan.filters",
            value,
            rule,
            "Build the controller with plan.filters, as Setup takes them.",
        ));
    }
    if !plan.tilt.is_level() && !controller.holds_tilt() {
        let what = format!("tilt of '{}' under controller '{}'", plant.name(), controller.name());
        let value = format!("roll {}, pitch {} rad", plan.tilt.roll, plan.tilt.pitch);
        let remedy = "platform, omav_tilting and dragon can hold a tilt.";
        return Err(Error::value(what, value, "level: its force turns with it", remedy));
    }
    if plan.wind != Wind::Calm && !own.effects.disturbance {
        return Err(Error::value("effects.disturbance", "off", "on where there is wind", "Switch it on."));
    }
    Ok(())
}

/// Logs the tracked point and all rotors in the state `x` at `time`, with the commands given in it.
fn record(
    log: &mut FlightLog,
    system: &ClosedLoop<&mut dyn Controller>,
    time: f64,
    x: &[f64],
    wanted: &Setpoint<f64>,
    wind: [f64; 3],
) -> Result<()> {
    let (plant, own) = (system.present(), system.controller().tracked(x));
    let (mut speed, mut thrust, mut command) = (Vec::new(), Vec::new(), Vec::new());
    for (rotor, place) in plant.rotors().into_iter().zip(plant.rotor_places()) {
        let s = x[place.speed];
        speed.push(s);
        thrust.push(rotor.thrust_coefficient * s * s);
        command.push(commanded_speed(rotor.max_speed, system.applied()[place.action]));
    }
    log.push(flight::FlightSample {
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

/// Names what will be read; which sensors have few numbers.
fn name_readings(log: &mut FlightLog, aboard: Option<&OnboardSensors>, sensors: &[SensorConfig]) -> Vec<bool> {
    let own: &[Sensor] = aboard.map_or(&[], |aboard| aboard.set().sensors());
    let few: Vec<bool> = sensors.iter().map(|config| config.model.layout() == ReadingLayout::Vector).collect();
    let columns = own.iter().zip(&few).filter(|(_, few)| **few);
    log.sensor_channels = columns.flat_map(|(sensor, _)| sensor.channels()).cloned().collect();
    log.scans = sensors.iter().zip(own).filter_map(|(config, sensor)| Scans::of(config, sensor)).collect();
    few
}

/// Logs what was read at `time`: of sensors with few numbers in every step, of others each reading once.
fn record_readings(log: &mut FlightLog, aboard: Option<&OnboardSensors>, few: &[bool], time: f64) {
    let own: &[Sensor] = aboard.map_or(&[], |aboard| aboard.set().sensors());
    let mut scans = log.scans.iter_mut();
    for (sensor, few) in own.iter().zip(few) {
        if *few {
            log.sensor_readings.extend_from_slice(sensor.reading());
        } else if let Some(scans) = scans.next().filter(|_| sensor.is_new()) {
            scans.push(time, sensor.reading());
        }
    }
}

/// Horizontal part of a nose that points up or down, but for rounding.
const UPRIGHT_NOSE: f64 = 1e-7;

/// Roll, pitch and yaw of a rotation, from which it comes back: where the nose points up or down, roll and yaw are one angle, which is
/// told as yaw.
fn angles(m: Mat3<f64>) -> [f64; 3] {
    if m[0][0].hypot(m[1][0]) > UPRIGHT_NOSE {
        return to_euler(from_matrix(m));
    }
    [0.0, (-m[2][0]).clamp(-1.0, 1.0).asin(), (-m[0][1]).atan2(m[1][1])]
}
