//! A plant under a controller: latency, disturbances, injections and failures between them.
//!
//! ```text
//! target ─▶ controller ─▶ (+) ─▶ latency ─▶ plant ─▶ state
//!              ▲           ▲ plant input      ▲         │
//!              ├── (+) ◀── │ ───── wind, force, moment ─┤
//!              │    ▲ plant output                      │
//!              └── sensors ◀────────────────────────────┤
//!                                                       ▼
//! ```
//!
//! The plant is the truth; what the controller believes about it is what the controller was built for.

use super::allocation::failure::{RotorFailure, health};
use super::cascade::Rates;
use super::cascade_law::CascadeLaw;
use super::controller::{Controller, Measurement, Target};
use super::estimation::{EstimatedState, EstimatorSettings};
use super::filter::FilterSettings;
use super::law::{ControlLaw, LawController, LawInput};
use autodiff::{Scalar, System};
use base::error::{Error, Result};
use dynamics::sensors::{OnboardSensors, SensorConfig};
use dynamics::{Disturbance, Gains, Physics, Plant, Vehicle};
use std::collections::VecDeque;

/// Longest latency, steps.
pub(crate) const MAX_LATENCY: usize = 1000;

/// What acts on a loop from outside in one step.
#[derive(Debug, Clone, PartialEq)]
pub struct ExogenousInputs {
    /// Wind, force and moment; plays no part where the effect `disturbance` is off.
    pub air: Disturbance<f64>,
    /// Added to the commands before their latency, `[n_command]`; empty for nothing.
    pub at_input: Vec<f64>,
    /// Added to the state that the controller sees, `[n_state]` of the plant: noise, bias, a probe; empty for nothing.
    pub at_output: Vec<f64>,
}

impl ExogenousInputs {
    /// Still air, no injection.
    pub fn none() -> Self {
        Self::air(Disturbance::none())
    }

    /// A disturbance alone.
    pub fn air(air: Disturbance<f64>) -> Self {
        Self { air, at_input: Vec::new(), at_output: Vec::new() }
    }
}

/// A plant under a controller.
///
/// Any loop is stepped singly in `f64` by [`advance`](Self::advance). With a straight-line controller
/// ([`LawController`]) it is a [`System`] too: differentiable, and run in batches by [`MonteCarlo`](super::MonteCarlo).
///
/// - State: the plant's; the law's memory; where the law has a rate of its own, the commands it holds; the latency line,
///   newest first.
/// - Input: the law's target and ticks; where it has a rate of its own, 1 where it ticks; a [`Disturbance`] (9) if
///   that effect is on; with [`with_injections`](Self::with_injections) what is added to the commands, then what is added
///   to the measured state. [`write_input`](Self::write_input) fills it.
/// - Parameters: with [`with_physics`](Self::with_physics) the plant's, then with [`with_gains`](Self::with_gains) the law's.
///
/// The gradient of a second of flight by the gains ([`Rollout`](autodiff::Rollout)); a reference's position begins the input:
///
/// ```
/// # use omnidrones_controllers::omnidrones;
/// use omnidrones::autodiff::{Objective, Rollout, Scalar, System};
/// use omnidrones::controllers::{ClosedLoop, Rates, Reference, Target, start_on};
/// use omnidrones::dynamics::{Disturbance, Physics, vehicles};
///
/// struct Tracking;
/// impl Objective for Tracking {
///     fn stage<S: Scalar>(&self, x: &[S], u: &[S], _: &[S]) -> S {
///         (0..3).fold(S::zero(), |sum, k| sum + (x[k] - u[k]).square())
///     }
/// }
///
/// let drone = vehicles::by_name("hummingbird")?;
/// let closed = ClosedLoop::of_vehicle(&drone, Physics::default(), &drone.gains(), &Rates::default())?.with_gains();
/// let lemniscate = Reference::by_name("lemniscate")?;
/// let start = closed.initial_state(&start_on(closed.plant(), closed.controller(), &lemniscate)?);
/// let mut inputs = vec![0.0; 500 * closed.n_input()];
/// for (k, row) in inputs.chunks_exact_mut(closed.n_input()).enumerate() {
///     closed.write_input(k as u64, Target::level(&lemniscate), &Disturbance::none(), row);
/// }
/// let gains = closed.parameters();
/// let (cost, gradient) = Rollout::new(closed, Tracking)?.gradient(&start, &inputs, &gains);
/// assert!(cost > 0.0 && gradient.parameters.iter().any(|g| *g < 0.0)); // some gain is better greater
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ClosedLoop<C = Box<dyn Controller>> {
    plant: Plant,
    controller: C,
    /// Of the plant's input: commands, and the first of each disturbance.
    commands: Vec<usize>,
    disturbances: Vec<usize>,
    /// Commands that hold hover, in the line at first.
    hover: Vec<f64>,
    /// Steps between two ticks.
    every: u64,
    latency: usize,
    injects: bool,
    exposes_gains: bool,
    failures: Vec<RotorFailure>,
    detection_delay: f64,
    run: Run,
}

/// Where a loop that is stepped singly stands.
#[derive(Debug, Clone)]
struct Run {
    step: u64,
    said: Vec<f64>,
    applied: Vec<f64>,
    line: VecDeque<Vec<f64>>,
    seen: Vec<f64>,
    sensors: Option<(OnboardSensors, u64)>,
    estimate: Option<Box<EstimatedState>>,
    /// The plant as it is by now, where rotors failed.
    damaged: Option<Plant>,
    health: Vec<f64>,
    known: Vec<f64>,
}

impl ClosedLoop<LawController<CascadeLaw>> {
    /// A vehicle under the cascade built for it.
    ///
    /// # Errors
    /// [`Error::Value`] if vehicle, physics or gains are not valid, or a rate does not divide 1/dt.
    pub fn of_vehicle(vehicle: &Vehicle, physics: Physics, gains: &Gains, rates: &Rates) -> Result<Self> {
        let law = CascadeLaw::new(vehicle, &physics, gains, rates)?;
        Self::new(Plant::of_vehicle(vehicle, physics)?, law.running())
    }

    /// The same loop with filters of the measured angular velocity in its law. The loop begins anew.
    ///
    /// # Errors
    /// As [`CascadeLaw::with_filters`].
    pub fn with_filters(mut self, filters: &[FilterSettings]) -> Result<Self> {
        self.controller = self.law().clone().with_filters(filters)?.running();
        self.reset();
        Ok(self)
    }
}

impl<C: Controller> ClosedLoop<C> {
    /// A plant, the truth, under a controller.
    ///
    /// # Errors
    /// [`Error::Value`] if the controller's rate does not divide 1/dt, or it is not made for such a plant.
    pub fn new(plant: Plant, controller: C) -> Result<Self> {
        controller.check_plant(&plant)?;
        let every = steps_between(controller.rate(), plant.physics().dt)?;
        let (disturbances, commands) = (plant.disturbances(), command_places(&plant));
        let mut hover = vec![0.0; plant.n_input()];
        if let Ok(state) = plant.hover_state() {
            for rotor in plant.rotor_places() {
                hover[rotor.action] = 2.0 * (state[rotor.speed] / rotor.max_speed).powi(2) - 1.0;
            }
        }
        let whole = vec![1.0; plant.rotor_places().len()];
        let run = Run {
            step: 0,
            said: vec![0.0; hover.len()],
            applied: vec![0.0; hover.len()],
            line: VecDeque::new(),
            seen: Vec::new(),
            sensors: None,
            estimate: None,
            damaged: None,
            health: whole.clone(),
            known: whole,
        };
        Ok(Self {
            hover: commands.iter().map(|k| hover[*k]).collect(),
            plant,
            controller,
            commands,
            disturbances,
            every,
            latency: 0,
            injects: false,
            exposes_gains: false,
            failures: Vec::new(),
            detection_delay: 0.0,
            run,
        })
    }

    /// Commands act this many steps after they were given, 0 to 1000; the line begins with those of hover.
    ///
    /// # Errors
    /// [`Error::Limit`] above `MAX_LATENCY`.
    pub fn with_latency(mut self, steps: usize) -> Result<Self> {
        check_latency(steps)?;
        self.latency = steps;
        self.run.line = self.fresh_line();
        Ok(self)
    }

    /// Sensors on the plant's bodies, which draw from `seed`: the controller is given what they read beside the state. Of
    /// [`advance`](Self::advance) alone. The first accelerations of a flight are those under the commands of hover, for nobody
    /// has commanded yet; all others are means over the step before. The loop begins anew.
    ///
    /// # Errors
    /// As [`OnboardSensors::new`].
    pub fn with_sensors(mut self, configs: &[SensorConfig], seed: u64) -> Result<Self> {
        self.run.sensors =
            if configs.is_empty() { None } else { Some((OnboardSensors::new(configs, &self.plant)?, seed)) };
        self.reset();
        Ok(self)
    }

    /// An estimator between its sensors and the controller, which is given the estimate in place of the true state from now on. It begins
    /// off the true state by its settings' deviations, as drawn from the seed of the sensors, where it has such. Of [`advance`](Self::advance) alone. The loop begins anew.
    ///
    /// # Errors
    /// As [`EstimatedState::new`]; [`Error::Value`] where the loop has not these sensors ([`with_sensors`](Self::with_sensors)).
    pub fn with_estimator(mut self, sensors: &[SensorConfig], settings: &EstimatorSettings) -> Result<Self> {
        let estimate = EstimatedState::new(&self.plant, sensors, settings)?;
        let readings: usize = sensors.iter().map(|sensor| sensor.model.channels().len()).sum();
        let own = self.run.sensors.as_ref().map_or(0, |(own, _)| own.channels().len());
        if own == 0 || own != readings {
            let (value, remedy) = (format!("{own} readings"), "Give with_sensors the same list before.");
            return Err(Error::value("sensors of the loop", value, format!("{readings}, as of the estimator"), remedy));
        }
        self.run.estimate = Some(Box::new(estimate));
        self.reset();
        Ok(self)
    }

    /// The estimate, where there is a filter.
    pub fn estimate(&self) -> Option<&EstimatedState> {
        self.run.estimate.as_deref()
    }

    /// Its sensors, which tell what they read last.
    pub fn sensors(&self) -> Option<&OnboardSensors> {
        self.run.sensors.as_ref().map(|(sensors, _)| sensors)
    }

    /// Rotors that fail on the way; the controller learns of it `detection_delay` (s, [0, 1000]) later. Of [`advance`](Self::advance)
    /// alone: as a [`System`] the loop stays whole.
    ///
    /// # Errors
    /// As [`RotorFailure::validate`]; [`Error::Value`] for a delay that is negative or beyond 1000 s.
    pub fn with_failures(mut self, failures: &[RotorFailure], detection_delay: f64) -> Result<Self> {
        let n = self.run.health.len();
        failures.iter().try_for_each(|f| f.validate(n))?;
        check_delay(detection_delay)?;
        (self.failures, self.detection_delay) = (failures.to_vec(), detection_delay);
        Ok(self)
    }

    /// The plant, whole.
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// The plant as it is by now, with the rotors that have failed.
    pub fn present(&self) -> &Plant {
        self.run.damaged.as_ref().unwrap_or(&self.plant)
    }

    /// The controller.
    pub fn controller(&self) -> &C {
        &self.controller
    }

    /// Number of commands: rotor actions and drives.
    pub fn n_command(&self) -> usize {
        self.commands.len()
    }

    /// The plant's input in the last step, `[n_input]`, in its layout: commands behind their latency, and the disturbance.
    pub fn applied(&self) -> &[f64] {
        &self.run.applied
    }

    /// Back to step 0, all rotors whole.
    pub fn reset(&mut self) {
        self.controller.reset();
        let whole = vec![1.0; self.run.health.len()];
        (self.run.step, self.run.damaged) = (0, None);
        (self.run.health, self.run.known) = (whole.clone(), whole);
        self.run.said.fill(0.0);
        self.run.line = self.fresh_line();
        if let Some((sensors, seed)) = &mut self.run.sensors {
            sensors.reset(*seed, 0, 0);
        }
        if let Some(estimate) = &mut self.run.estimate {
            estimate.reset(self.run.sensors.as_ref().map_or(0, |(_, seed)| *seed));
        }
    }

    fn fresh_line(&self) -> VecDeque<Vec<f64>> {
        (0..self.latency).map(|_| self.hover.clone()).collect()
    }

    /// One step from a state of the plant, `[n_state]`; `next`, `[n_state]`, gets the state after it.
    ///
    /// # Errors
    /// As [`Controller::tell`], where a rotor fails.
    ///
    /// # Panics
    /// If `state` or `next` are not of the plant's length, or an injection is neither empty nor of its own.
    pub fn advance(
        &mut self,
        state: &[f64],
        target: Target<'_>,
        outside: &ExogenousInputs,
        next: &mut [f64],
    ) -> Result<()> {
        let dt = self.plant.physics().dt;
        self.fail((self.run.step as f64 + 1e-6) * dt)?; // times are multiples of dt up to rounding
        self.sense(state, outside, next);
        let run = &mut self.run;
        if run.step.is_multiple_of(self.every) {
            let time = run.step as f64 * dt;
            let mut seen = run.estimate.as_ref().map_or(state, |estimate| estimate.state());
            if !outside.at_output.is_empty() {
                run.seen = add(seen, &outside.at_output);
                seen = &run.seen;
            }
            let readings = run.sensors.as_ref().map_or(&[][..], |(sensors, _)| sensors.readings());
            self.controller.tick(Measurement { time, state: seen, readings }, target, &mut run.said);
        }
        let mut given: Vec<f64> = self.commands.iter().map(|k| run.said[*k]).collect();
        if !outside.at_input.is_empty() {
            given = add(&given, &outside.at_input);
        }
        run.line.push_front(given);
        if let Some(due) = run.line.pop_back() {
            self.commands.iter().zip(due).for_each(|(k, value)| run.applied[*k] = value);
        }
        for first in &self.disturbances {
            outside.air.write(&mut run.applied[*first..]);
        }
        if let Some(estimate) = &mut run.estimate {
            estimate.apply(&run.applied);
        }
        run.step += 1;
        self.move_on(state, &self.run.applied, next);
        Ok(())
    }

    fn move_on(&self, state: &[f64], input: &[f64], next: &mut [f64]) {
        let theta = if self.plant.n_parameter() > 0 { self.present().parameters() } else { Vec::new() };
        self.present().step(state, input, &theta, next);
    }

    /// Reads the sensors; `next` is written over in the first step.
    fn sense(&mut self, state: &[f64], outside: &ExogenousInputs, next: &mut [f64]) {
        if self.run.sensors.is_none() {
            return;
        }
        if self.run.step == 0 {
            let mut input = vec![0.0; self.plant.n_input()];
            self.commands.iter().zip(&self.hover).for_each(|(k, command)| input[*k] = *command);
            self.disturbances.iter().for_each(|first| outside.air.write(&mut input[*first..]));
            self.move_on(state, &input, next);
        }
        if let Some((sensors, _)) = &mut self.run.sensors {
            let readings = sensors.read(state, next);
            if let Some(estimate) = &mut self.run.estimate {
                estimate.take(state, readings);
            }
        }
    }

    fn fail(&mut self, time: f64) -> Result<()> {
        if self.failures.is_empty() {
            return Ok(());
        }
        let n = self.run.health.len();
        let now = health(n, &self.failures, time);
        if now != self.run.health {
            let damaged = self.plant.damaged(&now)?;
            self.run.damaged = Some(if self.plant.n_parameter() > 0 { damaged.with_parameters() } else { damaged });
            self.run.health = now;
        }
        let known = health(n, &self.failures, time - self.detection_delay);
        if known != self.run.known {
            self.controller.tell(&known)?;
            self.run.known = known;
        }
        Ok(())
    }
}

impl<L: ControlLaw> ClosedLoop<LawController<L>> {
    /// The same loop with its law's parameters among θ.
    #[must_use]
    pub fn with_gains(mut self) -> Self {
        self.exposes_gains = true;
        self
    }

    /// The same loop with the plant's physical parameters among θ.
    #[must_use]
    pub fn with_physics(mut self) -> Self {
        self.plant = self.plant.with_parameters();
        self
    }

    /// The same loop with both injection points among its inputs.
    #[must_use]
    pub fn with_injections(mut self) -> Self {
        self.injects = true;
        self
    }

    /// The law.
    pub fn law(&self) -> &L {
        self.controller.law()
    }

    /// Nominal θ.
    pub fn parameters(&self) -> Vec<f64> {
        let mut theta = if self.plant.n_parameter() > 0 { self.plant.parameters() } else { Vec::new() };
        if self.exposes_gains {
            theta.extend(self.law().parameters());
        }
        theta
    }

    /// Names of θ.
    pub fn parameter_names(&self) -> Vec<String> {
        let mut names = if self.plant.n_parameter() > 0 { self.plant.parameter_names() } else { Vec::new() };
        if self.exposes_gains {
            names.extend(self.law().parameter_names());
        }
        names
    }

    /// Place of a parameter in θ.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest name.
    pub fn parameter(&self, name: &str) -> Result<usize> {
        let known = self.parameter_names();
        known.iter().position(|n| n == name).ok_or_else(|| Error::Unknown {
            kind: "parameter of the loop",
            name: name.into(),
            known,
        })
    }

    /// The whole state, `[n_state]` of the loop, for a state of the plant: the law's memory before its first tick, the line at hover.
    pub fn initial_state(&self, plant_state: &[f64]) -> Vec<f64> {
        let mut x = plant_state.to_vec();
        x.extend(self.law().memory());
        (0..self.n_held()).for_each(|_| x.extend(&self.hover));
        x
    }

    /// The input of step `k` into `input`, `[n_input]` of the loop: target and ticks at k dt, and the air; injections are zero.
    pub fn write_input(&self, k: u64, target: Target<'_>, air: &Disturbance<f64>, input: &mut [f64]) {
        self.write_air(air, input);
        self.write_clocked(k, target, &mut input[..self.n_clocked()]);
    }

    /// Numbers of the input that follow from the step alone: target and ticks. The others stand behind them.
    pub(super) fn n_clocked(&self) -> usize {
        self.law().n_target() + self.law().n_tick() + usize::from(self.holds())
    }

    /// Writes them.
    pub(super) fn write_clocked(&self, k: u64, target: Target<'_>, input: &mut [f64]) {
        let (law, time) = (self.law(), k as f64 * self.plant.physics().dt);
        let (row, ticks) = input.split_at_mut(law.n_target());
        law.write_target(target, time, row);
        law.write_ticks(k / self.every, &mut ticks[..law.n_tick()]);
        if self.holds() {
            ticks[law.n_tick()] = if k.is_multiple_of(self.every) { 1.0 } else { 0.0 };
        }
    }

    /// Writes the air into an input that is zero else.
    pub(super) fn write_air(&self, air: &Disturbance<f64>, input: &mut [f64]) {
        input.fill(0.0);
        if !self.disturbances.is_empty() {
            air.write(&mut input[self.n_clocked()..]);
        }
    }

    /// Whether commands are held between ticks.
    fn holds(&self) -> bool {
        self.law().rate().is_some()
    }

    /// Command vectors in the state: the held one, and the line.
    fn n_held(&self) -> usize {
        usize::from(self.holds()) + self.latency
    }

    fn n_air(&self) -> usize {
        if self.disturbances.is_empty() { 0 } else { Disturbance::<f64>::DIM }
    }

    /// The law's new memory into `memory` and what it commands now into `commands`, the plant's whole input.
    fn tick<S: Scalar>(
        &self,
        now: &LawInput<'_, S>,
        tick: Option<S>,
        held: &[S],
        memory: &mut [S],
        commands: &mut [S],
    ) {
        let Some(tick) = tick else { return self.law().tick(now, memory, commands) };
        let (old, due) = (memory.to_vec(), S::constant(0.5).lt(tick));
        self.law().tick(now, memory, commands);
        for (new, old) in memory.iter_mut().zip(&old) {
            *new = S::select(due, *new, *old);
        }
        for (k, held) in self.commands.iter().zip(held) {
            commands[*k] = S::select(due, commands[*k], *held);
        }
    }
}

/// Of a plant's input, where commands stand: all that is not a disturbance.
#[doc(hidden)]
pub fn command_places(plant: &Plant) -> Vec<usize> {
    let disturbances = plant.disturbances();
    let outside = |k: &usize| disturbances.iter().any(|first| (*first..first + Disturbance::<f64>::DIM).contains(k));
    (0..plant.n_input()).filter(|k| !outside(k)).collect()
}

/// Checks how late a controller knows of a failure, s.
pub(super) fn check_delay(delay: f64) -> Result<()> {
    if (0.0..=1e3).contains(&delay) {
        return Ok(());
    }
    Err(Error::value("detection_delay", delay, "within [0, 1000] s", "Real detectors take 10 to 100 ms."))
}

/// Checks how many steps commands act late.
pub(crate) fn check_latency(steps: usize) -> Result<()> {
    if steps <= MAX_LATENCY {
        return Ok(());
    }
    Err(Error::limit("latency", steps, format!("0 to {MAX_LATENCY} steps"), "Give it in steps of dt."))
}

/// Steps between two ticks of a rate in Hz.
fn steps_between(rate: Option<f64>, dt: f64) -> Result<u64> {
    let Some(rate) = rate else { return Ok(1) };
    let rates = Rates { rate, attitude: rate, velocity: rate };
    Ok(super::cascade::RateDivisors::new(&rates, dt)?.every[0])
}

fn add(a: &[f64], b: &[f64]) -> Vec<f64> {
    assert_eq!(a.len(), b.len(), "length of an injection");
    a.iter().zip(b).map(|(a, b)| a + b).collect()
}

/// State, input and parameters of a loop, divided.
struct Parts<'a, S> {
    body: &'a [S],
    memory: &'a [S],
    held: &'a [S],
    now: LawInput<'a, S>,
    tick: Option<S>,
    air: &'a [S],
    at_input: &'a [S],
    physics: &'a [S],
}

impl<L: ControlLaw> ClosedLoop<LawController<L>> {
    fn parts<'a, S: Scalar>(&self, state: &'a [S], input: &'a [S], parameters: &'a [S]) -> Parts<'a, S> {
        let law = self.law();
        let (physics, gains) = parameters.split_at(self.plant.n_parameter());
        let (target, input) = input.split_at(law.n_target());
        let (ticks, input) = input.split_at(law.n_tick());
        let (tick, input) = input.split_at(usize::from(self.holds()));
        let (air, input) = input.split_at(self.n_air());
        let (body, rest) = state.split_at(self.plant.n_state());
        let (memory, held) = rest.split_at(rest.len() - self.n_held() * self.n_command());
        let at_input = if self.injects { &input[..self.n_command()] } else { input };
        let now = LawInput { state: body, target, ticks, parameters: gains };
        Parts { body, memory, held, now, tick: tick.first().copied(), air, at_input, physics }
    }

    fn measured<S: Scalar>(&self, body: &[S], at_output: &[S]) -> Vec<S> {
        body.iter().zip(at_output).map(|(x, e)| *x + *e).collect()
    }

    /// What the law commands in a step, before anything is added to it: one number per command.
    pub(crate) fn commanded<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S]) -> Vec<S> {
        let Parts { body, memory, held, mut now, tick, .. } = self.parts(state, input, parameters);
        let measured: Vec<S>;
        if self.injects {
            measured = self.measured(body, &input[input.len() - body.len()..]);
            now.state = &measured;
        }
        let mut commands = vec![S::zero(); self.plant.n_input()];
        self.tick(&now, tick, held, &mut memory.to_vec(), &mut commands);
        self.commands.iter().map(|k| commands[*k]).collect()
    }

    /// Names of the commands.
    pub fn command_names(&self) -> Vec<String> {
        let all = self.plant.input_quantities();
        self.commands.iter().map(|k| all[*k].name.clone()).collect()
    }
}

impl<L: ControlLaw> System for ClosedLoop<LawController<L>> {
    fn n_state(&self) -> usize {
        self.plant.n_state() + self.controller.memory().len() + self.n_held() * self.n_command()
    }
    fn n_input(&self) -> usize {
        let injections = if self.injects { self.n_command() + self.plant.n_state() } else { 0 };
        self.n_clocked() + self.n_air() + injections
    }
    fn n_parameter(&self) -> usize {
        self.plant.n_parameter() + if self.exposes_gains { self.law().parameters().len() } else { 0 }
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], next: &mut [S]) {
        let Parts { body, memory, held, now, tick, air, at_input, physics } = self.parts(state, input, parameters);
        let measured: Vec<S>;
        let mut now = now;
        if self.injects {
            measured = self.measured(body, &input[input.len() - body.len()..]);
            now.state = &measured;
        }
        let n_command = self.n_command();
        let (next_body, next_rest) = next.split_at_mut(body.len());
        let (next_memory, next_held) = next_rest.split_at_mut(memory.len());
        next_memory.copy_from_slice(memory);
        let mut small = [S::zero(); 32];
        let mut large = Vec::new();
        let commands = match self.plant.n_input() {
            n_input @ 0..=32 => &mut small[..n_input],
            n_input => {
                large.resize(n_input, S::zero());
                &mut large[..]
            }
        };
        self.tick(&now, tick, held, next_memory, commands);

        // the held commands, then the line: what is given enters in front, what is due leaves behind
        let mut line = next_held;
        let mut old = held;
        if self.holds() {
            let (first, behind) = line.split_at_mut(n_command);
            self.commands.iter().zip(first).for_each(|(k, slot)| *slot = commands[*k]);
            (line, old) = (behind, &old[n_command..]);
        }
        for (i, k) in self.commands.iter().enumerate() {
            if self.injects {
                commands[*k] += at_input[i];
            }
            if self.latency > 0 {
                line[i] = commands[*k];
                commands[*k] = old[old.len() - n_command + i];
            }
        }
        if self.latency > 1 {
            line[n_command..].copy_from_slice(&old[..old.len() - n_command]);
        }
        for first in &self.disturbances {
            commands[*first..*first + air.len()].copy_from_slice(air);
        }
        self.plant.step(body, commands, physics, next_body);
    }
}
