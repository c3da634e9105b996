//! Model predictive control of a plant: tracks a reference by planning a second ahead in every tick.
//!
//! ```text
//! measured state ─▶ disturbance estimate ─▶ state when commands act ─▶ plan of N stages ─▶ u₀ ─▶ rotor commands
//! ```
//!
//! - The plan minimises [`TrackingCost`] along the reference, from now on, with all inputs within bounds, motors with their lag, and
//!   bounds of states that may be passed at a cost. It ends with the cost of an endless flight near hover (the Riccati equation).
//! - What moves the root beyond the model, force and moment, is estimated: d̂⁺ = d̂ + (1 − e^(−LT)) (v − v̂)/g, with v̂ the velocities that the
//!   model foretold for this tick and g what a force or a moment changes of its own in a tick. The plan flies with d̂, and the
//!   reference of a rigid vehicle leans against it.
//! - Commands that act late are answered for: the plan begins at the state that the model has when its commands will act.
//! - A tick whose program fails plans anew from the reference; where that fails too, it flies on with the plan of the last. After ten of
//!   them in a row the fallback flies, until a plan is found again. Both are counted and [told](Controller::notes).
//!
//! Source: Sun, Romero, Foehn, Kaufmann, Scaramuzza 2022 (weights, horizon); Rawlings, Mayne and Diehl 2017, sections 1.3 and 1.5 (end,
//! disturbance models).

use super::flat_motion::{FlatMotion, Push};
use super::planned_plant::{PlannedInput, PlannedPlant};
use super::problem::{OptimalProblem, OptimalTrajectory, length};
use super::qp_solver::QpStatus;
use super::real_time::{RealTimeIteration, TickReport};
use super::stage_model::StageModel;
use super::state_bound::{StateBound, soft_bounds};
use super::tracking_cost::{TrackingCost, TrackingWeights};
use crate::closed_loop::check_latency;
use crate::controller::{Controller, Measurement, Note, Target};
use crate::design::riccati;
use crate::kinematics::Kinematics;
use crate::platform_controller::is_platform;
use crate::vectored::vectored;
use autodiff::{System, linearise};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use dynamics::tree::Model;
use dynamics::{Disturbance, Effects, Physics, Plant};
use nalgebra::{DMatrix, Vector6};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Instant;

/// Ticks in a row that fly on with an old plan.
const PATIENCE: u64 = 10;

/// Share of its thrust that a lost rotor counts as keeping.
const STOPPED: f64 = 1e-6;

/// Programs of a tick that begins at the reference: the first, and where the plan of the last led nowhere.
const FIRST_ITERATIONS: usize = 15;

/// Largest step that counts as none.
const SHORTEST: f64 = 1e-9;

with_defaults! {
    /// How an [`Mpc`] plans.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct MpcSettings {
        /// N.
        pub stages: usize = 20,
        /// Of a stage, s.
        pub stage: f64 = 0.05,
        /// Steps of the integrator in a stage.
        pub substeps: usize = 1,
        /// It ticks as often as 1/dt allows, but not more often than this, Hz.
        pub rate: f64 = 100.0,
        /// Programs a tick: 1 for real-time iteration.
        pub iterations: usize = 1,
        /// What it costs to be off the reference.
        pub weights: TrackingWeights = TrackingWeights::default(),
        /// Whether the plan ends with the cost of an endless flight near hover; without, with the weights of a stage, per second.
        pub endless: bool = true,
        /// Soft bounds of states; `[[state_bound]]` in a file.
        #[serde(rename = "state_bound")]
        pub state_bounds: Vec<StateBound> = Vec::new(),
        /// Body that is tracked; without, the root.
        pub tracked: Option<String> = None,
        /// L, the rate of the disturbance estimate, 1/s; 0 for none.
        pub estimate: f64 = 10.0,
        /// Steps of the plant by which commands act late.
        pub latency: usize = 0,
        /// Whether motors speed up and slow down with different lags in its model.
        pub exact_lags: bool = false,
    }
}

/// What an [`Mpc`] has done since it was reset.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MpcStatistics {
    /// Ticks.
    pub ticks: u64,
    /// Of those, ones that flew on with an old plan.
    pub kept: u64,
    /// And ones that the fallback flew.
    pub fallen_back: u64,
    /// Recursions of all ticks.
    pub recursions: u64,
    /// Time of every tick, s, of the first 65 536.
    pub times: Vec<f32>,
    /// Ticks whose program was stopped at what rounding allows: they count as plans.
    pub stopped: u64,
    /// Largest residual of the programs that were solved.
    pub residual: f64,
}

impl MpcStatistics {
    fn new() -> Self {
        Self { times: Vec::with_capacity(MAX_TIMES), ..Self::default() }
    }

    /// What a share of the ticks stayed within, s; `None` before the first.
    pub fn time_within(&self, share: f64) -> Option<f64> {
        let mut times = self.times.clone();
        times.sort_by(f32::total_cmp);
        let last = times.len().checked_sub(1)?;
        Some(f64::from(times[((times.len() as f64 * share) as usize).min(last)]))
    }
}

/// Most times that are kept: eleven minutes of a hundred ticks a second.
const MAX_TIMES: usize = 65_536;

/// Model predictive control as a [`Controller`].
pub struct Mpc {
    settings: MpcSettings,
    /// What it believes to fly, step by step, with disturbances; with the rotors that it was told of, and with all of them.
    believed: Believed,
    whole: Plant,
    planned: PlannedPlant,
    cost: TrackingCost,
    flat: FlatMotion,
    iteration: RealTimeIteration,
    /// The plan of the last tick, carried on.
    standby: OptimalTrajectory,
    observer: Observer,
    /// Steps of the plant between two ticks.
    every: u64,
    step: u64,
    period: f64,
    /// Inputs of the plant as they were given, the last behind, as many as act late; those of hover at first.
    given: Vec<Vec<f64>>,
    hover: Vec<f64>,
    /// Failed ticks in a row.
    failed: u64,
    is_fresh: bool,
    fallback: Option<Box<dyn Controller>>,
    falls_back: bool,
    effectiveness: Vec<f64>,
    /// Place of every rotor's action in the plant's input.
    actions: Vec<usize>,
    statistics: MpcStatistics,
    last: Option<TickReport>,
    commands: Vec<f64>,
    work: Work,
}

/// Numbers of a tick, so that none allocates.
#[derive(Debug, Clone)]
struct Work {
    /// The plant's state when commands act.
    ahead: Vec<f64>,
    /// And as it is planned with.
    state: Vec<f64>,
    /// Inputs of the reference.
    inputs: Vec<f64>,
    /// Parameters of a stage.
    row: Vec<f64>,
    plan: OptimalTrajectory,
}

/// A plant that is stepped under commands and a push.
#[derive(Debug, Clone)]
struct Believed {
    plant: Plant,
    parameters: Vec<f64>,
    /// First number of the push in the input.
    push: Option<usize>,
    input: Vec<f64>,
    next: Vec<f64>,
}

impl Believed {
    fn new(plant: Plant) -> Self {
        Self {
            parameters: if plant.n_parameter() > 0 { plant.parameters() } else { Vec::new() },
            push: plant.disturbances().first().copied(),
            input: vec![0.0; plant.n_input()],
            next: vec![0.0; plant.n_state()],
            plant,
        }
    }

    /// One step.
    fn step(&mut self, state: &mut [f64], commands: &[f64], push: &Push) {
        let n = commands.len().min(self.input.len());
        self.input[..n].copy_from_slice(&commands[..n]);
        if let Some(first) = self.push {
            let Push { force, moment } = *push;
            Disturbance { force, moment, ..Disturbance::none() }.write(&mut self.input[first..]);
        }
        self.plant.step(state, &self.input, &self.parameters, &mut self.next);
        state.copy_from_slice(&self.next);
    }
}

/// Force and moment on the root beyond the model.
#[derive(Debug, Clone)]
struct Observer {
    /// Share of what is missing that is learnt in a tick.
    share: f64,
    /// From velocities that were not foretold to force and moment.
    inverse: Vector6<f64>,
    estimate: Vector6<f64>,
    /// Most of each.
    most: Vector6<f64>,
    /// Whether somebody else says what the moment is.
    is_told_moment: bool,
    /// The state as it should be by now, from the last tick on, and whether there is one.
    foretold: Vec<f64>,
    foretells: bool,
}

impl Mpc {
    /// Of a plant that is believed to be so.
    ///
    /// # Errors
    /// [`Error::Value`] for settings outside their ranges, a plant of several trees, or one that hover does not hold or no feedback
    /// settles; [`Error::Limit`] for too long a horizon.
    pub fn new(plant: &Plant, settings: &MpcSettings) -> Result<Self> {
        let (planned, cost, problem, inputs) = settings.problem(plant, false)?;
        let dt = plant.physics().dt;
        let every = settings.ticks_every(dt)?;
        let believed = with_disturbance(plant, *plant.physics())?;
        let period = every as f64 * dt;
        let observer = Observer::new(&believed, every, settings.estimate, period)?;
        let mut commands = vec![0.0; plant.n_input()];
        planned.write_commands(&inputs, &mut commands);
        let work = Work {
            ahead: vec![0.0; plant.n_state()],
            state: vec![0.0; planned.n_state()],
            inputs: inputs.clone(),
            row: vec![0.0; problem.model().n_parameter()],
            plan: OptimalTrajectory::default(),
        };
        let iteration = RealTimeIteration::new(problem, &inputs)?;
        Ok(Self {
            flat: FlatMotion::new(&planned)?,
            effectiveness: vec![1.0; plant.rotor_places().len()],
            actions: plant.rotor_places().iter().map(|rotor| rotor.action).collect(),
            given: vec![commands.clone(); settings.latency],
            hover: commands.clone(),
            settings: settings.clone(),
            fallback: None,
            falls_back: false,
            statistics: MpcStatistics::new(),
            last: None,
            standby: OptimalTrajectory::default(),
            step: 0,
            failed: 0,
            is_fresh: true,
            whole: believed.clone(),
            believed: Believed::new(believed),
            planned,
            cost,
            iteration,
            observer,
            every,
            period,
            commands,
            work,
        })
    }

    /// The same with a controller that flies while no plan is found; without one, those are the commands of hover.
    #[must_use]
    pub fn with_fallback(mut self, fallback: Box<dyn Controller>) -> Self {
        self.fallback = Some(fallback);
        self
    }

    /// Its settings.
    pub fn settings(&self) -> &MpcSettings {
        &self.settings
    }

    /// The plant that plans are made with.
    pub fn planned(&self) -> &PlannedPlant {
        &self.planned
    }

    /// The problem and the plan that stands.
    pub fn iteration(&self) -> &RealTimeIteration {
        &self.iteration
    }

    /// What it believes to fly, step by step, with disturbances.
    pub(super) fn believed(&self) -> &Plant {
        &self.believed.plant
    }

    /// What it costs to be off the reference.
    pub(super) fn cost(&self) -> &TrackingCost {
        &self.cost
    }

    /// Of a tick, s.
    pub fn period(&self) -> f64 {
        self.period
    }

    /// What it has done since it was reset.
    pub fn statistics(&self) -> &MpcStatistics {
        &self.statistics
    }

    /// What the program of the last tick came to; nothing where there was none, since the measurement or the reference was no number.
    pub fn last(&self) -> Option<&TickReport> {
        self.last.as_ref()
    }

    /// Force (N, world) and moment (N m, body) on the root that the model does not have.
    pub fn disturbance(&self) -> ([f64; 3], [f64; 3]) {
        let Push { force, moment } = self.observer.push();
        (force, moment)
    }

    /// Says what every stage is about: the reference from `time` on, and the disturbance. What follows it without error is left in
    /// `work.plan`.
    fn aim(&mut self, target: Target<'_>, time: f64) -> Result<()> {
        let Self { iteration, cost, flat, planned, settings, observer, work, .. } = self;
        let Work { state, inputs, row, plan, .. } = work;
        let first = planned.n_parameter();
        let none = TrackingWeights::zero();
        let mut attitude = [state[6], state[7], state[8], state[9]];
        let push = observer.push();
        plan.states.clear();
        plan.inputs.clear();
        for stage in 0..=settings.stages {
            let motion = flat.at(target, time + stage as f64 * settings.stage, &push, Some(attitude), inputs);
            attitude = motion.attitude;
            row.fill(0.0);
            let Push { force, moment } = push;
            Disturbance { force, moment, ..Disturbance::none() }.write(&mut row[..first.min(9)]);
            let is_end = stage == settings.stages;
            let weights = if is_end && settings.endless { &none } else { &settings.weights };
            cost.write_parameters(&motion, inputs, weights, &mut row[first..]);
            iteration.problem_mut().set_parameters(stage, row)?;
            let own = plan.states.len();
            plan.states.extend_from_slice(cost.hover());
            motion.write(&mut plan.states[own..]);
            if !is_end {
                plan.inputs.extend_from_slice(inputs);
            }
        }
        plan.states[..state.len()].copy_from_slice(state);
        Ok(())
    }

    /// One tick: plans, and leaves the commands.
    fn plan(&mut self, seen: &Measurement<'_>, target: Target<'_>) -> Result<()> {
        self.last = None;
        if !self.is_fresh {
            self.iteration.carry_on((self.period / self.settings.stage).min(1.0));
        }
        let Self { work, given, believed, planned, observer, .. } = self;
        work.ahead.copy_from_slice(seen.state);
        given.iter().for_each(|given| believed.step(&mut work.ahead, given, &observer.push()));
        planned.write_state(&work.ahead, &mut work.state);
        base::error::finite("state", &work.state)?;
        self.iteration.problem().model().errors.unite(&mut work.state)?;
        let late = self.settings.latency as f64 * self.believed.plant.physics().dt;
        self.aim(target, seen.time + late)?;
        self.standby.copy_from(self.iteration.plan());
        let Self { iteration, work, settings, .. } = self;
        let report = match (!self.is_fresh).then(|| iteration.tick(&work.state, settings.iterations, SHORTEST)) {
            Some(report) if report.is_planned => report,
            before => {
                iteration.begin_with(&work.plan)?;
                let report = iteration.tick(&work.state, FIRST_ITERATIONS, SHORTEST);
                TickReport { recursions: report.recursions + before.map_or(0, |own| own.recursions), ..report }
            }
        };
        self.last = Some(report);
        self.statistics.recursions += report.recursions as u64;
        if !report.is_planned {
            // the plan of the last flies on
            self.iteration.begin_with(&self.standby)?;
            return Err(Error::value("program of a tick", format!("{:?}", report.qp.status), "solved", "Fly on."));
        }
        match report.qp.status {
            QpStatus::Solved => self.statistics.residual = self.statistics.residual.max(report.qp.residual),
            _ => self.statistics.stopped += 1,
        }
        self.is_fresh = false;
        Ok(())
    }

    /// Commands of the plan's first inputs.
    fn command(&mut self) {
        self.planned.write_commands(self.iteration.input(0), &mut self.commands);
        for (action, left) in self.actions.iter().zip(&self.effectiveness) {
            if *left < 1.0 {
                // a weak rotor turns slower at the same command
                let share = 0.5 * (self.commands[*action] + 1.0) / left.max(STOPPED);
                self.commands[*action] = 2.0 * share.clamp(0.0, 1.0) - 1.0;
            }
        }
    }
}

impl MpcSettings {
    /// For a plant: one with joints is led more gently, and its joints are held too.
    pub fn for_plant(plant: &Plant) -> Self {
        let mut settings = Self::default();
        if plant.tree().is_some() {
            settings.weights = TrackingWeights {
                position: [50.0, 50.0, 100.0],
                velocity: [10.0; 3],
                attitude: [5.0, 5.0, 20.0],
                angular_velocity: [5.0; 3],
                joint: 0.1,
                joint_rate: 1.0,
                ..settings.weights
            };
            if holds_tilt(plant) {
                settings.weights.attitude = [100.0; 3];
            }
        }
        settings
    }

    /// What is planned with, what it costs, the problem about hover, and the inputs of hover.
    pub(super) fn problem(
        &self,
        plant: &Plant,
        is_exact: bool,
    ) -> Result<(PlannedPlant, TrackingCost, OptimalProblem, Vec<f64>)> {
        self.validate()?;
        if plant.roots().len() != 1 {
            let what = format!("trees of '{}'", plant.name());
            return Err(Error::value(what, plant.roots().len(), "1", "Give each of them a controller of its own."));
        }
        let physics = Physics { dt: self.stage, substeps: self.substeps, ..*plant.physics() };
        let planned = with_disturbance(plant, physics)?;
        let planned = if self.exact_lags { planned } else { planned.with_longer_lags()? };
        let planned = PlannedPlant::new(planned, PlannedInput::Speed)?;
        let tracked = match &self.tracked {
            None => 0,
            Some(name) => {
                let known = plant.body_names();
                let found = known.iter().position(|own| own == name);
                found.ok_or_else(|| Error::Unknown { kind: "body", name: name.clone(), known })?
            }
        };
        let mut cost = TrackingCost::new(&planned, tracked)?;
        let (hover, inputs) = planned.hover()?;
        if self.endless {
            let end = endless_cost(&planned, &cost, &self.weights, &hover, &inputs)?;
            cost = cost.with_end(&end)?;
        }
        let mut model = StageModel::new(&planned, &cost, planned.errors()?)?;
        if is_exact {
            model = model.with_curvature(&planned, &cost)?;
        }
        let mut problem = OptimalProblem::new(Arc::new(model), self.stages, &hover)?;
        let (lower, upper) = planned.bounds();
        problem.set_bounds(&lower, &upper)?;
        problem.set_soft_bounds(&soft_bounds(&planned, &self.state_bounds)?)?;
        Ok((planned, cost, problem, inputs))
    }

    /// Steps of the plant between two ticks.
    ///
    /// # Errors
    /// [`Error::Value`] where they are further apart than a stage is long.
    pub(super) fn ticks_every(&self, dt: f64) -> Result<u64> {
        let every = ticks_every(self.rate, dt);
        if every as f64 * dt <= self.stage * (1.0 + 1e-9) {
            return Ok(every);
        }
        let (value, rule) = (every as f64 * dt, format!("at most {} s, a stage", self.stage));
        Err(Error::value("mpc: time between plans", value, rule, "Raise the rate, or take longer stages."))
    }

    /// Checks their ranges: 1 to 1000 stages of (0, 1] s, iterations and substeps ≥ 1, rate > 0, estimate ≥ 0.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] for the first outside.
    pub fn validate(&self) -> Result<()> {
        for (what, value, most) in [
            ("mpc: stages", self.stages, 1000),
            ("mpc: iterations", self.iterations, 1000),
            ("mpc: substeps", self.substeps, 1000),
        ] {
            if value == 0 {
                return Err(Error::value(what, 0, "≥ 1", "Leave it out for the default."));
            }
            if value > most {
                return Err(Error::limit(what, value, most, "Leave it out for the default."));
            }
        }
        let ranges = [
            ("mpc: stage", self.stage, self.stage > 0.0 && self.stage <= 1.0, "in (0, 1] s"),
            ("mpc: rate", self.rate, self.rate > 0.0 && self.rate.is_finite(), "> 0 Hz"),
            ("mpc: estimate", self.estimate, (0.0..=1e4).contains(&self.estimate), "within [0, 10⁴] 1/s"),
        ];
        if let Some((what, value, _, rule)) = ranges.into_iter().find(|row| !row.2) {
            return Err(Error::value(what, value, rule, "Leave it out for the default."));
        }
        check_latency(self.latency)?;
        self.weights.validate()?;
        if self.weights.input <= 0.0 {
            let remedy = "Weigh inputs, so that there is one best plan.";
            return Err(Error::value("weights.input", self.weights.input, "> 0", remedy));
        }
        Ok(())
    }
}

/// The same model under other physics, its root pushed from outside: that is where the estimate is made.
pub(super) fn with_disturbance(plant: &Plant, physics: Physics) -> Result<Plant> {
    let physics = Physics { effects: Effects { disturbance: true, contact: false, ..physics.effects }, ..physics };
    match plant {
        Plant::Rigid(m) => Plant::of_vehicle(m.vehicle(), physics),
        Plant::Tree(m) => {
            let mut parts = m.model().parts().clone();
            parts.pushed.clear();
            Plant::of_model(&Model::new(parts)?, physics)
        }
    }
}

/// What is left of every rotor: one number each, within [0, 1].
fn check_effectiveness(effectiveness: &[f64], n: usize) -> Result<()> {
    length("effectiveness of rotors", effectiveness.len(), n)?;
    match effectiveness.iter().position(|left| !(0.0..=1.0).contains(left)) {
        None => Ok(()),
        Some(i) => {
            let what = format!("effectiveness of rotor {i}");
            Err(Error::value(what, effectiveness[i], "within [0, 1]", "Tell 1 of a whole rotor."))
        }
    }
}

/// Whether a plant can lean apart from where it is pushed.
fn holds_tilt(plant: &Plant) -> bool {
    plant.tree().is_some_and(|m| is_platform(m.model()) || vectored(m.model()))
}

/// Steps between ticks that come at most so often.
fn ticks_every(rate: f64, dt: f64) -> u64 {
    // times are multiples of dt up to rounding
    (1.0 / (dt * rate) - 1e-9).ceil().max(1.0) as u64
}

/// P of the endless flight near hover: of the plan's own step and cost.
fn endless_cost(
    planned: &PlannedPlant,
    cost: &TrackingCost,
    weights: &TrackingWeights,
    hover: &[f64],
    inputs: &[f64],
) -> Result<DMatrix<f64>> {
    let errors = planned.errors()?;
    let theta = vec![0.0; planned.n_parameter()];
    let (a, b) = errors.reduce(hover, &linearise(planned, hover, inputs, &theta));
    let (q, r) = cost.hessian_at_hover(weights);
    Ok(riccati::discrete(&a, &b, &q, &r)?.matrix)
}

impl Observer {
    fn new(believed: &Plant, every: u64, rate: f64, period: f64) -> Result<Self> {
        let mass = believed.mass();
        let (hover, mut input) = (believed.hover_state()?, vec![0.0; believed.n_input()]);
        for rotor in believed.rotor_places() {
            input[rotor.action] = dynamics::rotor::holding_action(rotor.max_speed, hover[rotor.speed]);
        }
        let theta = if believed.n_parameter() > 0 { believed.parameters() } else { Vec::new() };
        let first = believed.disturbances().first().copied().unwrap_or(0) + 3;
        // what a force and a moment change of the velocities in one step, times the steps of a tick
        let own = linearise(believed, &hover, &input, &theta);
        let rows = [3, 4, 5, 10, 11, 12];
        // each by what it moves itself: how one moves the other changes sign with attitude and joints
        let effect = Vector6::from_fn(|i, _| own.input[(rows[i], first + i)] * every as f64);
        let inverse = effect.map(|e| if e.abs() > f64::MIN_POSITIVE { 1.0 / e } else { 0.0 });
        let lever = believed.rotors().iter().map(|r| r.max_thrust()).sum::<f64>();
        let most = [3.0 * 9.81 * mass; 3].into_iter().chain([0.5 * lever; 3]);
        Ok(Self {
            share: 1.0 - (-rate * period).exp(),
            inverse,
            estimate: Vector6::zeros(),
            most: Vector6::from_iterator(most),
            is_told_moment: false,
            foretold: vec![0.0; believed.n_state()],
            foretells: false,
        })
    }

    /// The estimate.
    fn push(&self) -> Push {
        let d = &self.estimate;
        Push { force: [d[0], d[1], d[2]], moment: [d[3], d[4], d[5]] }
    }

    fn learn(&mut self, state: &[f64]) {
        if !std::mem::take(&mut self.foretells) {
            return;
        }
        let (now, foretold) = (velocities(state), velocities(&self.foretold));
        let missing = Vector6::from_fn(|k, _| now[k] - foretold[k]);
        let learnt = self.estimate + self.share * self.inverse.component_mul(&missing);
        if learnt.iter().all(|x| x.is_finite()) {
            let n = if self.is_told_moment { 3 } else { 6 };
            (0..n).for_each(|k| self.estimate[k] = learnt[k].clamp(-self.most[k], self.most[k]));
        }
    }
}

/// Velocity and angular velocity of the root.
fn velocities(state: &[f64]) -> [f64; 6] {
    [state[3], state[4], state[5], state[10], state[11], state[12]]
}

impl Controller for Mpc {
    fn name(&self) -> &str {
        "mpc"
    }

    fn why_no_law(&self) -> &'static str {
        "a plan, whose solver takes as many steps as it needs"
    }

    fn description(&self) -> String {
        let MpcSettings { stages, stage, .. } = &self.settings;
        let rate = 1.0 / self.period;
        format!("plans {stages} stages of {:.0} ms, {rate:.0} times a second", 1e3 * stage)
    }

    fn holds_tilt(&self) -> bool {
        holds_tilt(&self.believed.plant)
    }

    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        if self.settings.tracked.is_none() {
            return Kinematics::read(state);
        }
        self.planned.state_of(state).map_or_else(|_| Kinematics::read(state), |own| self.cost.tracked(&own))
    }

    fn reset(&mut self) {
        if self.effectiveness.iter().any(|left| *left < 1.0) {
            self.effectiveness.fill(1.0);
            self.believed = Believed::new(self.whole.clone());
            let (lower, upper) = self.planned.bounds();
            // as when it was made
            let _ = self.iteration.problem_mut().set_bounds(&lower, &upper);
        }
        self.step = 0;
        self.failed = 0;
        self.is_fresh = true;
        self.falls_back = false;
        self.observer.estimate = Vector6::zeros();
        self.observer.foretells = false;
        self.given.iter_mut().for_each(|given| given.clone_from(&self.hover));
        self.commands.clone_from(&self.hover);
        self.statistics = MpcStatistics::new();
        self.last = None;
        if let Some(fallback) = &mut self.fallback {
            fallback.reset();
        }
    }

    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, commands: &mut [f64]) {
        self.decide(seen, target);
        commands.copy_from_slice(&self.commands[..commands.len()]);
        self.sent(seen.state, commands);
    }

    fn tell(&mut self, effectiveness: &[f64]) -> Result<()> {
        let places = self.whole.rotor_places();
        check_effectiveness(effectiveness, places.len())?;
        let believed = Believed::new(self.whole.damaged(effectiveness)?);
        let (mut lower, mut upper) = self.planned.bounds();
        for (rotor, left) in places.iter().zip(effectiveness) {
            if let Some(i) = self.planned.commands().iter().position(|k| *k == rotor.action) {
                let most = left.sqrt().max(STOPPED.sqrt());
                (lower[i], upper[i]) = (lower[i].min(most), upper[i].min(most));
            }
        }
        self.iteration.problem_mut().set_bounds(&lower, &upper)?;
        self.effectiveness.copy_from_slice(effectiveness);
        self.believed = believed;
        match &mut self.fallback {
            Some(fallback) => fallback.tell(effectiveness),
            None => Ok(()),
        }
    }

    fn notes(&self) -> Vec<Note> {
        let own = &self.statistics;
        let per_tick = own.recursions as f64 / own.ticks.max(1) as f64;
        let mut notes = vec![Note::new(
            "plans",
            format!("{} of {} ticks", own.ticks - own.kept - own.fallen_back, own.ticks),
            format!(
                "{per_tick:.1} recursions a tick; the others flew on with the last plan ({}) or {} ({})",
                own.kept,
                if self.fallback.is_some() { "the fallback" } else { "the commands of hover" },
                own.fallen_back
            ),
        )];
        if let (Some(median), Some(late)) = (own.time_within(0.5), own.time_within(0.99)) {
            let value = format!("{:.2} ms", 1e3 * median);
            notes.push(Note::new("time of a tick", value, format!("median; 99 % within {:.2} ms", 1e3 * late)));
        }
        notes
    }
}

impl Mpc {
    /// Plans where a tick is due, and leaves the commands.
    pub(super) fn decide(&mut self, seen: Measurement<'_>, target: Target<'_>) {
        if self.is_due() {
            let begin = Instant::now();
            if self.observer.share > 0.0 {
                self.observer.learn(seen.state);
            }
            self.statistics.ticks += 1;
            match self.plan(&seen, target) {
                Ok(()) => {
                    (self.failed, self.falls_back) = (0, false);
                    self.command();
                }
                Err(_) => {
                    self.failed += 1;
                    if self.failed <= PATIENCE && !self.is_fresh {
                        self.statistics.kept += 1;
                        self.command();
                    } else {
                        self.statistics.fallen_back += 1;
                        if !self.falls_back {
                            self.fallback.iter_mut().for_each(|own| own.reset());
                        }
                        (self.falls_back, self.is_fresh) = (true, true);
                        self.commands.clone_from(&self.hover);
                    }
                }
            }
            if self.statistics.times.len() < MAX_TIMES {
                self.statistics.times.push(begin.elapsed().as_secs_f32());
            }
        }
        if self.falls_back
            && let Some(fallback) = &mut self.fallback
        {
            fallback.tick(seen, target, &mut self.commands);
            // what it makes of a measurement that is none
            for (command, hover) in self.commands.iter_mut().zip(&self.hover) {
                *command = if command.is_finite() { command.clamp(-1.0, 1.0) } else { *hover };
            }
        }
    }

    /// Takes the moment on the root (N m, body) from elsewhere, and learns a force alone from now on.
    pub(super) fn take_moment(&mut self, moment: [f64; 3]) {
        self.observer.is_told_moment = true;
        (0..3).for_each(|k| self.observer.estimate[3 + k] = moment[k]);
    }

    /// Whether the next step plans anew.
    pub(super) fn is_due(&self) -> bool {
        self.step.is_multiple_of(self.every)
    }

    /// Commands that it left.
    pub(super) fn commands(&self) -> &[f64] {
        &self.commands
    }

    /// Whether the fallback flies, or nobody does.
    pub(super) fn falls_back(&self) -> bool {
        self.falls_back
    }

    /// Learns what was sent in this step, where `state` was measured.
    pub(super) fn sent(&mut self, state: &[f64], commands: &[f64]) {
        let Self { observer, given, believed, .. } = self;
        if observer.share > 0.0 {
            // the velocities at the next tick, step by step from what is measured in this one
            if self.step.is_multiple_of(self.every) || !observer.foretells {
                observer.foretold.copy_from_slice(state);
                observer.foretells = true;
            }
            let push = observer.push();
            believed.step(&mut observer.foretold, given.first().map_or(commands, |own| own), &push);
        }
        if let Some(first) = given.first_mut() {
            let n = first.len().min(commands.len());
            first[..n].copy_from_slice(&commands[..n]);
            given.rotate_left(1);
        }
        self.step += 1;
    }
}

#[cfg(test)]
mod tests;
