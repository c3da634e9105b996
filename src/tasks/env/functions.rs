//! What a task computes, as recorded functions of named arrays: for who flies without this library.
//!
//! They are recorded of the phases that environments run ([`Step`]): no equation is written twice. A step of `dt` seconds is
//!
//! ```text
//! observe -> policy -> act, as often as controllers compute -> what flies -> judge
//! ```
//!
//! `observe` and `judge` have an array `memory` each, which they alone write. All of it zero is an episode that begins: the next call is
//! shown the first state. From then on there is one call with the state after every step. Memory holds what is needed and no more, so
//! some have none; so do arrays: one of which nothing is read is left out.

use super::Env;
use super::block::{episode_state, signal};
use super::control::LATCHED_PER_AGENT;
use super::core::Core;
use super::draw_plan::Planner;
use super::episode_start::EpisodeStart;
use super::phases::{Numbers, Step, number};
use crate::config::EnvConfig;
use crate::observation::{ObservationTransform, Pipeline};
use crate::task_spec::{DIVERGED, Field, FieldLayout};
use autodiff::emit::{Access, NamedArray, NamedFunction, NamedNumber};
use autodiff::program::BLOCK;
use autodiff::{Mask, Recording, Scalar, Trace};
use base::error::{Error, Result};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ops::Range;

/// What a task computes.
///
/// ```
/// # use omnidrones_tasks::omnidrones;
/// use omnidrones::autodiff::Program;
/// use omnidrones::tasks::{Env, EnvConfig};
///
/// let functions = Env::make("Hover", &EnvConfig::default())?.functions()?;
/// let observe = &functions.observe;
/// let names: Vec<&str> = observe.arrays.iter().map(|array| array.name.as_str()).collect();
/// assert_eq!(names, ["state", "goal", "memory", "observation"]);
/// let program = Program::compile(&observe.recording)?;
/// assert_eq!(program.n_output(), observe.arrays[2].numbers.len() + observe.arrays[3].numbers.len());
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct TaskFunctions {
    /// What all agents see, behind the stages of the configuration, with the statistics of a normaliser as they are now. Where noise is
    /// added, nothing is. Reads
    ///
    /// - `state`: of the robot's physics, SI; where a stage `estimate` is configured, an estimate of it;
    /// - `goal`: of the task, as it is now;
    /// - `start`: what the task keeps from step to step, as it is where the episode begins. Read where an episode begins alone. Of
    ///   numbers that begin at zero there is none;
    /// - `varied`: physical numbers that differ between environments;
    /// - `readings`: what the sensors of every agent read last, images and scans too. Who flies has real ones, and no function can cast
    ///   rays or draw noise;
    /// - `memory`: whether the episode has begun, its step, what the task keeps, rotor speeds of the last step, what histories remember.
    ///
    /// It writes `observation`, agent by agent. States beyond the [bounds](crate::Bounds) are shown as they are, where an environment
    /// would end its episode and show rest; beyond the horizon the clock, k/T, stays where it is in the last step.
    pub observe: NamedFunction,
    /// What a step was worth. Reads as `observe` does, of the truth, and writes
    ///
    /// - `reward`: of the team;
    /// - `terms`: its summands;
    /// - `ends`: whether the episode terminated, was truncated at the horizon, and is a success in this step;
    /// - `reasons`: which one it terminated for, the first that holds; `diverged` for a state beyond its bounds;
    /// - `metrics`: what the task reports.
    ///
    /// Where an episode begins, nothing is rewarded and nothing ends. It goes on counting behind an end: who begins anew zeroes the
    /// memory. Of a goal that changes in an episode it is shown the old one in the step of the change.
    pub judge: NamedFunction,
    /// From what agents say to the `commands` of what flies, each in [−1, 1], in the order of the plant's inputs. Reads
    ///
    /// - `action`: of all agents; what is not finite is the safe command;
    /// - `state` and `varied`, where controllers stand between;
    /// - `controller`: the commands of the task's own controllers, where actions correct these (`residual`);
    /// - `memory`: the number of the computation, and what is held from the first of a step to the others.
    ///
    /// A delay is not part of it: what flies has its own.
    pub act: NamedFunction,
    /// Between two calls of `observe`, and of `judge`, s.
    pub dt: f64,
    /// Between two calls of `act`, s.
    pub act_period: f64,
    /// Calls of `act` in a step: the same action in all of them.
    pub n_act: usize,
    /// Steps of an episode.
    pub horizon: usize,
    /// Agents, whose numbers stand one behind the other in `observation` and in `action`.
    pub n_agent: usize,
    /// Whether the state that is observed is meant to be an estimate.
    pub sees_estimates: bool,
}

impl Env {
    /// What the task computes, as functions.
    ///
    /// # Errors
    /// [`Error::Value`] for a task whose events change what it keeps from step to step, and for one that answers otherwise than before.
    pub fn functions(&self) -> Result<TaskFunctions> {
        let (core, config) = (&self.core, &self.spec.config);
        check_event(core)?;
        let words = Words::of(core, config)?;
        let n_act = if core.control.needs_frames() { core.control.steps } else { 1 };
        Ok(TaskFunctions {
            observe: observe(core, &words, &self.spec.observation),
            judge: judge(core, &words),
            act: act(core, &words, n_act),
            dt: self.spec.dt,
            act_period: self.spec.dt / n_act as f64,
            n_act,
            horizon: self.spec.horizon,
            n_agent: self.spec.n_agent,
            sees_estimates: core.estimating.is_some(),
        })
    }
}

/// What an environment shows beside its state and goal, as functions read it.
#[doc(hidden)]
#[derive(Debug, Clone, PartialEq)]
pub struct ShownBeside {
    /// What the task keeps, as long as the episode has just begun.
    pub start: Vec<f64>,
    /// Physical numbers that differ between environments.
    pub varied: Vec<f64>,
    /// What sensors read last.
    pub readings: Vec<f64>,
}

impl Env {
    /// Of one environment.
    ///
    /// # Errors
    /// As [`Env::functions`].
    ///
    /// # Panics
    /// For an environment that is not there.
    #[doc(hidden)]
    pub fn shown_beside(&self, environment: usize) -> Result<ShownBeside> {
        let words = Words::of(&self.core, &self.spec.config)?;
        let (block, kept) = (&self.blocks[environment / BLOCK], &self.core.layout.kept);
        let lane = environment % BLOCK;
        let column = |rows: &[[f32; BLOCK]]| rows.iter().map(|row| f64::from(row[lane])).collect::<Vec<_>>();
        let task_state = column(kept.task_state.of(&block.kept)).into_iter().zip(&words.start);
        let start = task_state.filter(|(_, start)| start.is_none()).map(|(x, _)| x).collect();
        let (varied, readings) = (column(kept.theta.of(&block.kept)), column(kept.readings.of(&block.kept)));
        Ok(ShownBeside { start, varied, readings })
    }
}

/// Names of what functions read and remember.
struct Words {
    state: Vec<NamedNumber>,
    goal: Vec<NamedNumber>,
    varied: Vec<NamedNumber>,
    readings: Vec<NamedNumber>,
    task_state: Vec<NamedNumber>,
    speeds: Vec<NamedNumber>,
    history: Vec<NamedNumber>,
    /// Inputs of the plant but for disturbances, and their places.
    commands: Vec<NamedNumber>,
    places: Vec<usize>,
    /// What the task state begins with: a constant, or a number of the array `start`.
    start: Vec<Option<f64>>,
}

impl Words {
    fn of(core: &Core, config: &EnvConfig) -> Result<Self> {
        let (own, robot) = (&core.task_spec, core.robot());
        let (parameters, states) = (robot.parameter_names(), robot.plant().state_quantities());
        let state: Vec<NamedNumber> = states.into_iter().map(|q| named(q.name, q.unit)).collect();
        let speed = |row: &usize| named(format!("{}_before", state[*row].name), "rad/s");
        let disturbed = robot.disturbances();
        let is_command = |k: &usize| !disturbed.iter().any(|first| (*first..first + 9).contains(k));
        let places: Vec<usize> = (0..robot.n_input()).filter(is_command).collect();
        let inputs = robot.plant().input_quantities();
        let mut channels = Vec::new();
        for sensor in config.sensors().iter().filter(|_| core.sizes.reading > 0) {
            let all = sensor.model.channels().into_iter();
            channels.extend(all.map(|(channel, unit)| named(format!("{}.{channel}", sensor.name), unit)));
        }
        Ok(Self {
            goal: numbers_of(&own.goal),
            varied: core.varied.iter().map(|k| named(parameters[*k].clone(), "SI")).collect(),
            readings: of_agents(core.sizes.agent, &channels),
            task_state: numbers_of(&own.task_state),
            speeds: core.speed_rows.iter().map(speed).collect(),
            history: of_agents(core.sizes.agent, &histories(core, config)?),
            commands: places.iter().map(|k| named(inputs[*k].name.clone(), inputs[*k].unit)).collect(),
            start: task_state_of_start(core)?,
            state,
            places,
        })
    }

    /// Those numbers of the task state that a start draws.
    fn drawn(&self) -> Vec<NamedNumber> {
        let pairs = self.task_state.iter().zip(&self.start);
        pairs.filter(|(_, start)| start.is_none()).map(|(own, _)| own.clone()).collect()
    }

    /// What a flight shows.
    fn reads(&self) -> Vec<NamedArray> {
        vec![
            array("state", "State of the physics.", Access::Read, self.state.clone()),
            array("goal", "Goal of the task.", Access::Read, self.goal.clone()),
            array("start", "What the task keeps, where the episode begins.", Access::Read, self.drawn()),
            array("varied", "Physical numbers that differ.", Access::Read, self.varied.clone()),
            array("readings", "What sensors read last.", Access::Read, self.readings.clone()),
        ]
    }

    /// What is remembered of an episode, in the order of [`Flight::remembered`].
    fn memory(&self) -> Vec<NamedNumber> {
        let mut all = vec![named("running", "-, 0 or 1"), named("step", "steps")];
        all.extend([&self.task_state, &self.speeds, &self.history].into_iter().flatten().cloned());
        all.push(named("held", "steps"));
        all
    }
}

/// What the task state begins with, where no start draws it.
fn task_state_of_start(core: &Core) -> Result<Vec<Option<f64>>> {
    let n = core.sizes.task_state;
    if core.task.start_on_host().is_some() {
        return Ok(vec![None; n]);
    }
    let (mut start, mut is_same) = (Vec::new(), true);
    Recording::of(core.sizes.draw + 1, |z| {
        let mut draft = EpisodeStart::new(core.robot(), core.sizes.goal, n);
        let source = RefCell::new(Planner::new(Some(z[1..].to_vec())));
        draft.begin((core.robot(), &core.randomiser), &source, z[0], |start| core.task.start(start));
        is_same = source.into_inner().plan == core.plans.start;
        start = draft.task_state.iter().map(|x| x.known()).collect();
        Vec::new()
    });
    if is_same {
        return Ok(start);
    }
    let remedy = "A task is asked several times: let it depend on its settings alone.";
    Err(Error::value("draws of the start", "others", "those of the first time", remedy))
}

/// Refuses a task whose events change what it keeps: functions are told of events by the goal alone.
fn check_event(core: &Core) -> Result<()> {
    let (n_draw, n) = (core.sizes.draw, core.sizes.task_state);
    if core.task.start_on_host().is_some() {
        return Ok(());
    }
    let mut changed = None;
    Recording::of(1 + n_draw + core.sizes.goal + n, |z| {
        let (draws, rest) = z[1..].split_at(n_draw);
        let (goal, task_state) = rest.split_at(core.sizes.goal);
        let mut draft = EpisodeStart::new(core.robot(), 0, 0);
        (draft.goal, draft.task_state) = (goal.to_vec(), task_state.to_vec());
        let source = RefCell::new(Planner::new(Some(draws.to_vec())));
        draft.with(core.robot(), &source, z[0], |start| core.task.event(start));
        changed = draft.task_state.iter().zip(task_state).position(|(new, old)| !new.is(*old));
        Vec::new()
    });
    let Some(k) = changed else { return Ok(()) };
    let value = format!("one that changes '{}'", numbers_of(&core.task_spec.task_state)[k].name);
    let remedy = "Let events change the goal, which functions are given, and let the task keep what follows from it.";
    Err(Error::value("an event of the task", value, "one that changes the goal alone", remedy))
}

/// A state of an episode that a function is shown.
struct Flight<'a> {
    core: &'a Core,
    words: &'a Words,
}

impl Flight<'_> {
    /// The step that led to a state, as far as the memory tells of it; `at` reads arrays.
    fn step(&self, at: &Arguments<'_>) -> Step<'_> {
        let (core, kept, work) = (self.core, &self.core.layout.kept, &self.core.layout.work);
        let mut own = Numbers::blank(core, at.of("varied"));
        let state = at.of("state");
        own.plant[..state.len()].copy_from_slice(state);
        kept.goal.of_mut(&mut own.kept).copy_from_slice(at.of("goal"));
        kept.readings.of_mut(&mut own.kept).copy_from_slice(at.of("readings"));
        let mut memory = at.of("memory").iter().copied();
        let mut next = || memory.next().unwrap_or(Trace::zero());
        let (running, step) = (next(), next());
        let runs = running.gt(0.5);
        let mut drawn = at.of("start").iter().copied();
        for (row, start) in kept.task_state.of_mut(&mut own.kept).iter_mut().zip(&self.words.start) {
            let start = start.map(Trace::constant).or_else(|| drawn.next()).unwrap_or(Trace::zero());
            *row = Trace::select(runs, next(), start);
        }
        for (row, speed) in work.speeds.of_mut(&mut own.work).iter_mut().zip(&core.speed_rows) {
            *row = Trace::select(runs, next(), state[*speed]);
        }
        kept.history.of_mut(&mut own.kept).iter_mut().for_each(|row| *row = next());
        own.kept[episode_state::RUNNING] = running;
        own.kept[episode_state::STEP] = step;
        own.kept[episode_state::LAST] = Trace::constant(core.task.horizon() as f64);
        own.kept[episode_state::EVENT] = Trace::constant(f64::from(f32::MAX));
        if core.sizes.hold > 0 {
            own.kept[core.sizes.held_row()] = next();
        }
        work.common.of_mut(&mut own.work)[0] = Trace::one();
        let statistics = core.layout.shared.statistics.of_mut(&mut own.shared);
        statistics.iter_mut().zip(&*core.frozen).for_each(|(row, x)| *row = Trace::constant(*x));
        let mut step = Step::new(core, own);
        step.errs = false;
        step
    }

    /// What the next call needs.
    fn remembered(&self, step: &Step<'_>, at: &Arguments<'_>) -> Vec<Trace> {
        let (kept, rows) = (&self.core.layout.kept, &step.numbers.kept);
        let mut all = vec![Trace::one(), step.episode(episode_state::STEP)];
        all.extend(kept.task_state.of(rows));
        all.extend(self.core.speed_rows.iter().map(|row| at.of("state")[*row]));
        all.extend(kept.history.of(rows));
        all.push(if self.core.sizes.hold > 0 { rows[self.core.sizes.held_row()] } else { Trace::zero() });
        all
    }
}

fn observe(core: &Core, words: &Words, fields: &[Field]) -> NamedFunction {
    let shown = of_agents(core.sizes.agent, &numbers_of(fields));
    let draft = Draft {
        name: "observe",
        about: "What all agents see.",
        reads: words.reads(),
        memory: words.memory(),
        writes: vec![array("observation", "Agent by agent, behind all stages.", Access::Write, shown)],
    };
    let flight = Flight { core, words };
    draft.recorded(|at| {
        let mut step = flight.step(at);
        step.is_endless = true;
        step.move_frames();
        step.judge();
        step.observe();
        step.read();
        step.transform();
        let observation = core.layout.work.observation.of(&step.numbers.work).to_vec();
        (flight.remembered(&step, at), vec![observation])
    })
}

fn judge(core: &Core, words: &Words) -> NamedFunction {
    let own = &core.task_spec;
    let flags = |names: &mut dyn Iterator<Item = &str>| names.map(|name| named(name, "-, 0 or 1")).collect::<Vec<_>>();
    let reasons = flags(&mut own.ends.iter().map(|end| end.name.as_str()).chain([DIVERGED]));
    let n_reason = reasons.len();
    let terms = own.reward.iter().map(|term| named(term.name.clone(), "-")).collect();
    let metrics = own.metrics.iter().map(|metric| named(metric.name.clone(), metric.unit.clone())).collect();
    let ends = flags(&mut ["terminated", "truncated", "success"].into_iter());
    let draft = Draft {
        name: "judge",
        about: "What a step was worth.",
        reads: words.reads(),
        memory: words.memory(),
        writes: vec![
            array("reward", "Of the team.", Access::Write, vec![named("reward", "-")]),
            array("terms", "Summands of the reward.", Access::Write, terms),
            array("ends", "Whether the episode ends, and how.", Access::Write, ends),
            array("reasons", "What it terminated for.", Access::Write, reasons),
            array("metrics", "Figures of the task.", Access::Write, metrics),
        ],
    };
    let flight = Flight { core, words };
    draft.recorded(|at| {
        let mut step = flight.step(at);
        let runs = step.episode(episode_state::RUNNING).gt(0.5);
        step.contain();
        step.move_frames();
        step.judge();
        let signals = step.work(|work| work.signals);
        let success = Trace::select(runs, signals[signal::SUCCESS], Trace::zero());
        let ends = vec![signals[signal::TERMINATED], signals[signal::TRUNCATED], success];
        let reason = step.episode(episode_state::REASON);
        let is = |k: usize| number(reason.gt(k as f64 + 0.5).and(reason.gt(k as f64 + 1.5).not()));
        let terms = (0..core.sizes.term).map(|k| step.episode(episode_state::TERMS + k)).collect();
        let written = vec![
            vec![signals[signal::REWARD]],
            terms,
            ends,
            (0..n_reason).map(is).collect(),
            step.work(|work| work.metrics).to_vec(),
        ];
        (flight.remembered(&step, at), written)
    })
}

fn act(core: &Core, words: &Words, n_act: usize) -> NamedFunction {
    let control = &core.control;
    let (unit, names) = match control.levels() {
        None => ("-".to_string(), control.names.clone()),
        Some(levels) if control.n_action() < control.n_command => {
            (format!("-, whole, below {}", levels.pow(control.n_command as u32)), vec!["choice".to_string()])
        }
        Some(levels) => (format!("-, whole, below {levels}"), control.names.clone()),
    };
    let actions: Vec<NamedNumber> = names.into_iter().map(|name| named(name, unit.clone())).collect();
    let held: Vec<NamedNumber> = latched().into_iter().map(|name| named(name, "SI")).collect();
    let mut memory = vec![named("computation", "-, whole")];
    memory.extend(of_agents(core.sizes.agent, &held));
    let led = if core.residual.is_some() { words.commands.clone() } else { Vec::new() };
    let draft = Draft {
        name: "act",
        about: "From the actions of all agents to commands.",
        reads: vec![
            array("action", "Agent by agent.", Access::Read, of_agents(core.sizes.agent, &actions)),
            array("state", "State of the physics.", Access::Read, words.state.clone()),
            array("varied", "Physical numbers that differ.", Access::Read, words.varied.clone()),
            array("controller", "Commands of the controllers that actions correct.", Access::Read, led),
        ],
        memory,
        writes: vec![array("commands", "Of rotors and drives.", Access::Write, words.commands.clone())],
    };
    draft.recorded(|at| {
        let mut own = Numbers::blank(core, at.of("varied"));
        let state = at.of("state");
        own.plant[..state.len()].copy_from_slice(state);
        let mut step = Step::new(core, own);
        match control.levels() {
            None => step.clip(at.of("action")),
            Some(levels) => {
                let commands = control.decoded(levels, at.of("action"));
                step.work_mut(|work| work.command).copy_from_slice(&commands);
            }
        }
        if let Some(residual) = &core.residual {
            let mut input = vec![Trace::zero(); core.robot().n_input()];
            words.places.iter().zip(at.of("controller")).for_each(|(place, x)| input[*place] = *x);
            residual.correct(&input, step.work_mut(|work| work.command));
        }
        if control.needs_frames() {
            step.move_frames();
        }
        let (computation, held) = at.of("memory").split_first().expect("a computation");
        step.latched.copy_from_slice(held);
        let (one, zero) = (Trace::one(), Trace::zero());
        let (first, mut remembered) = if n_act == 1 {
            (one, vec![zero])
        } else {
            let is_last = computation.gt(n_act as f64 - 1.5);
            let first = number(computation.lt(0.5));
            (first, vec![Trace::select(is_last, zero, *computation + one)])
        };
        step.steer_by(first);
        remembered.extend_from_slice(&step.latched);
        let commands = words.places.iter().map(|k| step.numbers.plant[core.plant.input_row(*k)]).collect();
        (remembered, vec![commands])
    })
}

/// Names of what the cascade of one drone holds.
fn latched() -> Vec<String> {
    let axes = ["x", "y", "z"];
    let vector = |what: &str| axes.map(|axis| format!("{what}_{axis}"));
    let mut all = vec!["held_thrust".to_string()];
    all.extend(axes.iter().flat_map(|row| axes.map(|column| format!("held_attitude_{row}{column}"))));
    all.extend(["held_angular_velocity", "held_angular_acceleration"].into_iter().flat_map(vector));
    let rest = LATCHED_PER_AGENT - all.len();
    all.extend((0..rest).map(|k| format!("held_{k}")));
    all
}

/// A function before it is known what it needs.
struct Draft {
    name: &'static str,
    about: &'static str,
    reads: Vec<NamedArray>,
    memory: Vec<NamedNumber>,
    writes: Vec<NamedArray>,
}

/// All that a function may read.
struct Arguments<'a> {
    numbers: &'a [Trace],
    places: &'a [(String, Range<usize>)],
}

impl Arguments<'_> {
    /// The numbers of an array.
    fn of(&self, name: &str) -> &[Trace] {
        let place = self.places.iter().find(|(own, _)| *own == name);
        place.map_or(&[], |(_, range)| &self.numbers[range.clone()])
    }
}

impl Draft {
    /// Recorded of what is remembered and what is written to each array; what nothing written depends on is left out.
    fn recorded(self, compute: impl Fn(&Arguments<'_>) -> (Vec<Trace>, Vec<Vec<Trace>>)) -> NamedFunction {
        let Self { reads, memory, writes, .. } = self;
        let mut n_read = 0;
        let mut places: Vec<(String, Range<usize>)> = Vec::new();
        for array in &reads {
            places.push((array.name.clone(), n_read..n_read + array.numbers.len()));
            n_read += array.numbers.len();
        }
        let n = n_read + memory.len();
        places.push(("memory".into(), n_read..n));
        // of the results, what is written and these of what is remembered
        let results = |numbers: &[Trace], is_kept: &[bool]| {
            let (remembered, written) = compute(&Arguments { numbers, places: &places });
            let kept = remembered.into_iter().zip(is_kept).filter(|(_, kept)| **kept).map(|(x, _)| x);
            kept.chain(written.into_iter().flatten()).collect::<Vec<_>>()
        };
        let mut is_kept = vec![false; memory.len()];
        let is_used = loop {
            let (_, used) = Recording::of(n, |z| results(z, &is_kept)).of_used_inputs();
            let mut is_used = vec![false; n];
            used.into_iter().for_each(|k| is_used[k] = true);
            if is_used[n_read..] == is_kept {
                break is_used;
            }
            is_kept.copy_from_slice(&is_used[n_read..]);
        };
        let mut given: Vec<usize> = Vec::new();
        let mut arrays: Vec<NamedArray> = Vec::new();
        for (array, (_, range)) in reads.into_iter().zip(&places) {
            if is_used[range.clone()].contains(&true) {
                given.extend(range.clone());
                arrays.push(array);
            }
        }
        given.extend((n_read..n).filter(|k| is_used[*k]));
        let kept = memory.into_iter().zip(&is_kept).filter(|(_, kept)| **kept).map(|(own, _)| own);
        let about = "Of an episode; zeros where it begins.";
        arrays.extend(filled(array("memory", about, Access::Update, kept.collect())));
        arrays.extend(writes.into_iter().flat_map(filled));
        let recording = Recording::of(given.len(), |z| {
            let mut numbers = vec![Trace::zero(); n];
            given.iter().zip(z).for_each(|(k, x)| numbers[*k] = *x);
            results(&numbers, &is_kept)
        });
        arrays.iter_mut().for_each(|array| tell_apart(&mut array.numbers));
        NamedFunction { name: self.name.into(), about: self.about.into(), arrays, recording }
    }
}

/// What the histories of one agent remember.
fn histories(core: &Core, config: &EnvConfig) -> Result<Vec<NamedNumber>> {
    let robot = core.robot();
    let (names, domains) = (robot.parameter_names(), robot.parameter_domains());
    let theta: Vec<_> = core.varied.iter().map(|k| (names[*k].clone(), core.nominal[*k], domains[*k])).collect();
    let sensing = core.sensing.as_ref().filter(|_| core.sizes.reading > 0);
    let mut shown = core.task_spec.observation.clone();
    shown.extend(sensing.iter().flat_map(|sensing| sensing.fields.iter().cloned()));
    let stages = &config.observation;
    let is_history = |stage: &ObservationTransform| matches!(stage, ObservationTransform::History { .. });
    let is_one = stages.iter().filter(|stage| is_history(stage)).count() == 1;
    let mut all = Vec::new();
    for (i, stage) in stages.iter().enumerate() {
        let ObservationTransform::History { steps } = stage else { continue };
        let fields = Pipeline::new(&stages[..i], &shown, &theta)?.fields;
        let stage = if is_one { String::new() } else { format!("stage_{i}.") };
        for k in 1..=*steps {
            let older = |field: &Field| Field { name: format!("{stage}{}_{k}_ago", field.name), ..field.clone() };
            all.extend(numbers_of(&fields.iter().map(older).collect::<Vec<_>>()));
        }
    }
    Ok(all)
}

fn named(name: impl Into<String>, unit: impl Into<String>) -> NamedNumber {
    NamedNumber { name: name.into(), unit: unit.into() }
}

fn array(name: &str, about: &str, access: Access, numbers: Vec<NamedNumber>) -> NamedArray {
    NamedArray { name: name.into(), about: about.into(), access, numbers }
}

/// The array, if it has numbers.
fn filled(array: NamedArray) -> Option<NamedArray> {
    (!array.numbers.is_empty()).then_some(array)
}

/// The same numbers of every agent.
fn of_agents(n_agent: usize, numbers: &[NamedNumber]) -> Vec<NamedNumber> {
    if n_agent == 1 {
        return numbers.to_vec();
    }
    let of = |agent| numbers.iter().map(move |own| named(format!("agent_{agent}.{}", own.name), own.unit.clone()));
    (0..n_agent).flat_map(of).collect()
}

/// Numbers the names that are there already: histories of histories show a number twice.
fn tell_apart(numbers: &mut [NamedNumber]) {
    let mut taken = BTreeSet::new();
    for own in numbers {
        let (name, mut n) = (own.name.clone(), 1);
        while !taken.insert(own.name.clone()) {
            n += 1;
            own.name = format!("{name}_{n}");
        }
    }
}

/// A name for every number of fields.
fn numbers_of(fields: &[Field]) -> Vec<NamedNumber> {
    let of = |field: &Field| {
        let meaning = if field.meaning.is_empty() { String::new() } else { format!(": {}", field.meaning) };
        let unit = format!("{}{meaning}", field.unit);
        let ends = endings(field);
        ends.into_iter().map(|end| named(format!("{}{end}", field.name), unit.clone())).collect::<Vec<_>>()
    };
    fields.iter().flat_map(of).collect()
}

/// What stands behind a field's name in those of its numbers: axes of what has a frame or is read by a sensor, places of others.
fn endings(field: &Field) -> Vec<String> {
    let has_axes = field.unit.contains(", ") || field.name.contains('.');
    let axes = |n: usize| -> Vec<String> {
        match n {
            1 => vec![String::new()],
            2 | 3 if has_axes => ["_x", "_y", "_z"][..n].iter().map(|end| (*end).into()).collect(),
            4 if field.unit.contains('→') || field.name.contains('.') => {
                ["_w", "_x", "_y", "_z"].map(String::from).into()
            }
            _ => (0..n).map(|k| format!("_{k}")).collect(),
        }
    };
    let shape = field.layout.shape(field.size);
    match (field.layout, &shape[..]) {
        (FieldLayout::Members { .. }, [members, own]) => {
            (0..*members).flat_map(|member| axes(*own).into_iter().map(move |end| format!("_{member}{end}"))).collect()
        }
        (FieldLayout::Vector, _) => axes(field.size),
        _ => shape.iter().filter(|n| **n > 1).fold(vec![String::new()], |ends, n| {
            ends.iter().flat_map(|end| (0..*n).map(move |k| format!("{end}_{k}"))).collect()
        }),
    }
}

#[cfg(test)]
mod tests;
