//! Steps of a benchmark task's environments: everything from actions to observations, with rewards, ends and resets, beside
//! a plain loop over the physics of one of them in `f64`, without any of that, and beside one environment that is stepped in
//! a loop (which computes sixty-four and throws away all but one).
//!
//! Actions are random around those that hover, so that episodes end now and then, and first episodes begin anywhere in
//! time: a steady share of environments resets in every step, which a row of its own tells.

use super::{BenchPlan, BenchRow};
use omnidrones::controllers::cascade::Level;
use omnidrones::dynamics::{Integrator, Plant};
use omnidrones::error::{Error, Result};
use omnidrones::internals::step_plant;
use omnidrones::parallel::Threads;
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::registry::TaskEntry;
use omnidrones::tasks::{Autoreset, Buffers, Env, EnvConfig, SingleEnv};
use std::hint::black_box;
use std::time::{Duration, Instant};

/// Sizes of batches unless a plan says otherwise.
pub const SIZES: [usize; 3] = [1024, 4096, 65536];
/// Half the width of the actions around hover.
const NOISE: f64 = 0.1;
/// Different actions that take turns.
const SETS: usize = 8;
/// Rounds over the subjects of a group; each gives its least time. A slow spell of the machine then meets all of them.
const ROUNDS: u32 = 8;
/// Steps before the clock starts: the first episodes of open-loop flight are over.
const WARM_UP: usize = 64;

/// A way to step a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Case {
    /// Where actions enter.
    pub control: Level,
    /// Of the physics.
    pub integrator: Integrator,
}

impl Case {
    /// Rotor and rate commands, each under both integrators.
    pub const USUAL: [Self; 4] = [
        Self { control: Level::Rotor, integrator: Integrator::RungeKutta4 },
        Self { control: Level::Rotor, integrator: Integrator::SemiImplicit },
        Self { control: Level::Rate, integrator: Integrator::RungeKutta4 },
        Self { control: Level::Rate, integrator: Integrator::SemiImplicit },
    ];

    fn name(self) -> &'static str {
        match (self.control, self.integrator) {
            (Level::Rotor, Integrator::RungeKutta4) => "rotor, RK4",
            (Level::Rotor, Integrator::SemiImplicit) => "rotor, semi-implicit",
            (Level::Rate, Integrator::RungeKutta4) => "rate, RK4",
            (Level::Rate, Integrator::SemiImplicit) => "rate, semi-implicit",
            (Level::Attitude, Integrator::RungeKutta4) => "attitude, RK4",
            (Level::Attitude, Integrator::SemiImplicit) => "attitude, semi-implicit",
            (Level::Velocity, Integrator::RungeKutta4) => "velocity, RK4",
            (Level::Velocity, Integrator::SemiImplicit) => "velocity, semi-implicit",
            (Level::Position, Integrator::RungeKutta4) => "position, RK4",
            (Level::Position, Integrator::SemiImplicit) => "position, semi-implicit",
        }
    }
}

/// Batches of each of `sizes`, on 1, 2, 4 … threads up to the plan's, for every case that the task has: drones whose rotors
/// tilt have no rate level, and some tasks insist on an integrator. What `config` says of both is replaced, and episodes
/// restart in the same step; the rest stays.
///
/// # Errors
/// As [`TaskEntry::env`], and [`Error::Limit`] for threads.
pub fn run(
    plan: &BenchPlan,
    entry: &TaskEntry,
    config: &EnvConfig,
    cases: &[Case],
    sizes: &[usize],
    progress: &mut dyn FnMut(&BenchRow),
) -> Result<Vec<BenchRow>> {
    let (mut rows, mut refusal) = (Vec::new(), None);
    for case in cases {
        let Case { control, integrator } = *case;
        let own = EnvConfig { control, integrator, stagger: true, autoreset: Autoreset::SameStep, ..config.clone() };
        match entry.env(&EnvConfig { n_env: 1, ..own.clone() }) {
            Ok(env) if env.robot().physics().integrator == integrator => {
                group(plan, entry, &own, case.name(), sizes, &mut |row| {
                    progress(&row);
                    rows.push(row);
                })?;
            }
            Ok(env) => {
                let (what, only) = (format!("integrator of task {}", entry.name), env.robot().physics().integrator);
                refusal = Some(Error::value(what, format!("{integrator:?}"), format!("{only:?}"), "Leave it out."));
            }
            Err(error) => refusal = Some(error),
        }
    }
    match refusal {
        Some(error) if rows.is_empty() => Err(error),
        _ => Ok(rows),
    }
}

/// One control level and integrator.
fn group(
    plan: &BenchPlan,
    entry: &TaskEntry,
    config: &EnvConfig,
    name: &'static str,
    sizes: &[usize],
    add: &mut dyn FnMut(BenchRow),
) -> Result<()> {
    let mut alone = Alone::new(entry, config)?;
    let mut batches = sizes.iter().map(|n| Batch::new(entry, config, *n)).collect::<Result<Vec<Batch>>>()?;
    let mut pools = Vec::new();
    let mut threads = 1;
    while threads <= plan.threads.max(1) {
        pools.push((threads, Threads::new(threads)?));
        threads *= 2;
    }
    let slice = plan.budget / ROUNDS;
    let (mut bare, mut plain) = (Bare::new(&mut alone), f64::INFINITY);
    let mut single = f64::INFINITY;
    let mut least = vec![f64::INFINITY; batches.len() * pools.len()];
    for _ in 0..ROUNDS {
        plain = plain.min(bare.time(slice)?);
        single = single.min(alone.time(slice)?);
        for (i, batch) in batches.iter_mut().enumerate() {
            for (j, (_, pool)) in pools.iter().enumerate() {
                batch.env.set_threads(pool.clone());
                let time = batch.time(slice)?;
                least[i * pools.len() + j] = least[i * pools.len() + j].min(time);
            }
        }
    }
    let row = |what: String, value: f64, unit, ratio| BenchRow {
        group: name,
        name: what,
        value,
        unit,
        ratio,
        baseline: if ratio.is_some() { BASELINE } else { "" },
    };
    add(row("physics of one in a plain loop, f64".into(), 1e-6 / plain, "M steps/s", Some(1.0)));
    add(row("one environment in a loop".into(), 1e-6 / single, "M steps/s", Some(plain / single)));
    for (i, batch) in batches.iter().enumerate() {
        for (j, (threads, _)) in pools.iter().enumerate() {
            let time = least[i * pools.len() + j];
            let plural = if *threads == 1 { "" } else { "s" };
            let what = format!("{} environments, {threads} thread{plural}", batch.n());
            add(row(what, 1e-6 / time, "M steps/s", Some(plain / time)));
        }
    }
    if let Some(batch) = batches.last() {
        add(row("steps that end an episode".into(), 100.0 * batch.ended as f64 / batch.stepped as f64, "%", None));
        let bytes = batch.env.spec().bytes_per_env as f64;
        add(row("memory of an environment".into(), bytes, "bytes", None));
    }
    Ok(())
}

/// What all ratios are of.
const BASELINE: &str = "physics in a plain loop";

/// Environments with the actions they take in turn.
struct Batch {
    env: Env,
    out: Buffers,
    actions: Vec<Vec<f32>>,
    turn: usize,
    /// Steps of environments, and how many of them ended an episode.
    stepped: usize,
    ended: usize,
}

impl Batch {
    fn new(entry: &TaskEntry, config: &EnvConfig, n_env: usize) -> Result<Self> {
        let mut env = entry.env(&EnvConfig { n_env, ..config.clone() })?;
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out())?;
        let actions = actions(&env);
        let mut own = Self { env, out, actions, turn: 0, stepped: 0, ended: 0 };
        for _ in 0..WARM_UP {
            own.step()?;
        }
        Ok(own)
    }

    fn n(&self) -> usize {
        self.env.spec().n_env
    }

    fn step(&mut self) -> Result<()> {
        self.turn = (self.turn + 1) % SETS;
        self.env.step(black_box(&self.actions[self.turn]), &mut self.out.out())
    }

    /// Least seconds per step and environment.
    fn time(&mut self, budget: Duration) -> Result<f64> {
        let least = repeat(budget, || self.step())?;
        let ended = self.out.terminated.iter().zip(&self.out.truncated).filter(|(a, b)| **a + **b > 0).count();
        (self.stepped, self.ended) = (self.stepped + self.n(), self.ended + ended);
        Ok(least / self.n() as f64)
    }
}

/// The physics of one environment in `f64`, as a simulator without batches steps it.
struct Bare {
    plant: Plant,
    rest: Vec<f64>,
    state: Vec<f64>,
    next: Vec<f64>,
    input: Vec<f64>,
    /// Physics steps per step of the environment.
    inner: usize,
    step: usize,
}

impl Bare {
    /// For the environment of another subject; its rotors hold their rest speeds.
    fn new(alone: &mut Alone) -> Self {
        let inner = alone.env.spec().config.control_steps();
        let robot = alone.env.env().robot();
        let rest = robot.rest().to_vec();
        let input = robot.hover_input();
        Self { plant: robot.plant().clone(), state: rest.clone(), next: rest.clone(), rest, input, inner, step: 0 }
    }

    fn time(&mut self, budget: Duration) -> Result<f64> {
        repeat(budget, || {
            self.step += 1;
            if self.step.is_multiple_of(256) {
                self.state.copy_from_slice(&self.rest);
            }
            for _ in 0..self.inner {
                step_plant(&self.plant, black_box(&self.state), &self.input, &mut self.next);
                std::mem::swap(&mut self.state, &mut self.next);
            }
            Ok(())
        })
    }
}

/// One environment, reset by its caller.
struct Alone {
    env: SingleEnv,
    actions: Vec<Vec<f32>>,
    turn: usize,
    episode: u64,
}

impl Alone {
    fn new(entry: &TaskEntry, config: &EnvConfig) -> Result<Self> {
        let mut env = SingleEnv::of(entry.env(&SingleEnv::one(config))?);
        env.env().set_threads(Threads::new(1)?);
        env.reset(0)?;
        let actions = actions(env.env());
        Ok(Self { env, actions, turn: 0, episode: 0 })
    }

    fn time(&mut self, budget: Duration) -> Result<f64> {
        repeat(budget, || {
            self.turn = (self.turn + 1) % SETS;
            let step = self.env.step(black_box(&self.actions[self.turn]))?;
            if step.terminated || step.truncated {
                self.episode += 1;
                self.env.reset(self.episode)?;
            }
            Ok(())
        })
    }
}

/// Seconds per call: the least over repeats of about a millisecond within the budget.
fn repeat(budget: Duration, mut call: impl FnMut() -> Result<()>) -> Result<f64> {
    let first = Instant::now();
    call()?;
    let per_repeat = ((1e-3 / first.elapsed().as_secs_f64().max(1e-9)) as usize).clamp(1, 100_000);
    let (start, mut least) = (Instant::now(), f64::INFINITY);
    loop {
        let own = Instant::now();
        for _ in 0..per_repeat {
            call()?;
        }
        least = least.min(own.elapsed().as_secs_f64() / per_repeat as f64);
        if start.elapsed() > budget {
            return Ok(least);
        }
    }
}

/// Sets of random actions around those that hover.
fn actions(env: &Env) -> Vec<Vec<f32>> {
    let (spec, hover) = (env.spec(), hover(env));
    let n_row = spec.n_env * spec.n_agent;
    let mut stream = Stream::new(0, 0, 0, Purpose::POLICY);
    let mut set = || {
        let mut all = Vec::with_capacity(n_row * hover.len());
        for _ in 0..n_row {
            all.extend(hover.iter().map(|a| (a + stream.uniform(-NOISE, NOISE)).clamp(-1.0, 1.0) as f32));
        }
        all
    };
    (0..SETS).map(|_| set()).collect()
}

/// One agent's commands that carry the weight: rotors at rest speed, thrust as theirs, everything else in the middle.
fn hover(env: &Env) -> Vec<f64> {
    let robot = env.robot();
    let input = robot.hover_input();
    let rest: Vec<f64> = robot.drone().rotors.iter().map(|r| input[r.action]).collect();
    let mean = rest.iter().sum::<f64>() / rest.len().max(1) as f64;
    let command = |(i, name): (usize, &String)| match name.as_str() {
        "thrust" => mean,
        name if name.starts_with("rotor_") => rest.get(i).copied().unwrap_or(mean),
        _ => 0.0,
    };
    env.spec().commands.iter().enumerate().map(command).collect()
}
