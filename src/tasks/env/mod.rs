//! Many environments of one task, stepped together: the API of learners.
//!
//! | file | what |
//! |---|---|
//! | `mod` | [`Env`]: make, reset, step, save, load |
//! | `spec` | what an environment is, as data |
//! | `buffers` | where a step writes |
//! | `limits` | whether a batch fits into memory |
//! | `core` | what all environments share |
//! | `layout` | where their numbers stand |
//! | `phases` | a step, over recorded numbers |
//! | `step_phases` | a step phase by phase, to look at |
//! | `programs` | its phases as programs over rows |
//! | `stepper` | sixty-four environments: programs, what stands between them, ends and restarts |
//! | `control` | from an agent's numbers to rotor actions |
//! | `residual` | controllers whose commands actions change |
//! | `transform` | noise and statistics of observations |
//! | `episode_start` | how episodes begin and what events do, over recorded numbers and draws |
//! | `draw_plan` | what is drawn for these |
//! | `draws` | draws of a block |
//! | `restart` | episodes begin, goals change |
//! | `sensing` | sensors of the agents |
//! | `estimate` | what filters make of what they read, seen in place of the truth |
//! | `info_columns` | which columns of information there are |
//! | `write_out` | columns of a block into rows of the caller |
//! | `mask` | sets of environments of a block |
//! | `normaliser` | statistics of observations: collect, freeze, merge |
//! | `snapshot` | the exact state as bytes |
//! | `block` | what sixty-four environments hold |
//! | `functions` | the phases as functions of named arrays |
//! | `kernels` | the phases as kernels of a device |
//! | `transition` | the phases as the function that gradients are taken of |
//! | `gradient` | tapes, sweeps, Jacobians |
//! | `single` | one environment, for newcomers |
//! | `check` | whether an environment keeps its contract |

pub(crate) mod block;
pub(crate) mod buffers;
pub mod check;
pub(crate) mod control;
pub(crate) mod core;
pub(crate) mod draw_plan;
pub(crate) mod draws;
pub(crate) mod episode_start;
mod estimate;
pub(crate) mod functions;
pub(crate) mod gradient;
mod info_columns;
pub(crate) mod kernels;
pub(crate) mod layout;
mod limits;
mod mask;
mod normaliser;
pub(crate) mod phases;
pub(crate) mod programs;
pub(crate) mod residual;
pub(crate) mod restart;
mod sensing;
pub(crate) mod single;
mod snapshot;
pub(crate) mod spec;
pub(crate) mod step_phases;
mod stepper;
#[cfg(test)]
mod tests;
pub(crate) mod transform;
pub(crate) mod transition;
mod write_out;

pub use buffers::{Buffers, StepOut};
#[doc(hidden)]
pub use functions::{ShownBeside, TaskFunctions};
pub use gradient::{Adjoint, Cotangents, Jacobian, Seeds, Sweep, SweepOptions, Tape};
#[doc(hidden)]
pub use kernels::{EnvKernel, EnvKernels, EnvRows, Given, KernelArguments, PRELUDE, SweepArguments};
pub use normaliser::PendingStatistics;
#[doc(hidden)]
pub use normaliser::VARIANCE_FLOOR;
pub use spec::{AgentWidths, Column, Info, Space, Spec};
pub use step_phases::StepPhases;
pub use transition::StepLayout;

use self::block::{Columns, EnvBlock, Sizes, Workspace};
use self::buffers::Span;
use self::control::{Control, LATCHED_PER_AGENT};
use self::core::Core;
use self::episode_start::Plans;
use self::estimate::{ESTIMATE, EstimateSetup};
use self::gradient::BlockTape;
use self::info_columns::InfoColumns;
use self::layout::EnvLayout;
use self::limits::{bytes_per_env, check_memory, out_bytes};
use self::programs::Programs;
use self::residual::{Residual, check_reference};
use self::sensing::SensorSetup;
use self::spec::spec_of;
use self::stepper::Stepper;
use self::transition::{config_hash, ideal_terms, parametric_plant, reference};
use crate::any_task::declare;
use crate::config::{EnvConfig, check_difficulty};
use crate::observation::{Extent, Pipeline, Statistics};
use crate::randomise::Randomiser;
use crate::task::{Task, TaskReference};
use crate::task_spec::{TaskSpec, total};
use autodiff::lanes::{first_lanes, to_rows};
use autodiff::program::{BLOCK, ValueForm};
use base::error::{Error, Result, finite};
use base::parallel::Threads;
use dynamics::Physics;
use dynamics::batch::{BatchPlant, Breach, STOPPED};
use dynamics::rigid::BODY_PARAMETERS;
use dynamics::rotor::{N_ROTOR_PARAMETER, at};
use dynamics::shape::Shape;
use rng::{Purpose, Stream};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};

/// Blocks per task of a thread: their rows stay in its second-level cache.
const BLOCKS_PER_PART: usize = 4;

/// E environments of one task.
///
/// ```
/// # use omnidrones_tasks::omnidrones;
/// use omnidrones::tasks::{Buffers, Env, EnvConfig};
///
/// let mut env = Env::make("Hover", &EnvConfig { n_env: 100, ..EnvConfig::default() })?;
/// let mut buffers = Buffers::new(env.spec());
/// env.reset(None, None, &mut buffers.out())?;
/// let actions = vec![-0.415; 100 * 4]; // [environment, agent, command]
/// for _ in 0..10 {
///     env.step(&actions, &mut buffers.out())?;
/// }
/// assert!(buffers.reward.iter().all(|r| *r <= env.spec().reward_bound as f32));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
pub struct Env {
    core: Core,
    spec: Spec,
    blocks: Vec<EnvBlock>,
    pool: Mutex<Vec<Workspace>>,
    threads: Threads,
    /// The tape that has the last step, and how many it had then.
    recorded: Option<(Weak<()>, usize)>,
}

impl std::fmt::Debug for Env {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Env({} × {})", self.spec.n_env, self.spec.task)
    }
}

impl Env {
    /// A task of one's own, built from the same configuration.
    ///
    /// # Errors
    /// [`Error::Limit`] before any large allocation if the batch needs more than
    /// [`EnvConfig::memory_limit`]; [`Error::Value`] for settings that do not fit the task.
    pub fn of(task: impl Task + 'static, name: &str, config: &EnvConfig) -> Result<Self> {
        Self::of_task(Box::new(task), name, config)
    }

    pub(crate) fn of_task(task: Box<dyn Task>, name: &str, config: &EnvConfig) -> Result<Self> {
        // what a configuration leaves to the task, a task of one's own leaves out
        let config = &EnvConfig {
            randomise: Some(config.changes().to_vec()),
            sensor: Some(config.sensors().to_vec()),
            ..config.clone()
        };
        config.validate()?;
        EnvConfig::check_horizon(task.horizon())?;
        let mut own = declare(&*task)?;
        let drones = task.robot().drones();
        let n_rotor: usize = drones.iter().map(|drone| drone.rotors.len()).sum();
        own.take_off_throttle_change(config.throttle_change, n_rotor as f64 / drones.len() as f64);
        let told = InfoColumns::of(config.info.as_deref(), &own)?;
        // all by name are all
        let config = &EnvConfig { info: config.info.clone().filter(|_| !told.is_all()), ..config.clone() };
        let robot = task.robot();
        let randomiser = Randomiser::new(config.changes(), robot)?;
        let mut varied: Vec<usize> = robot.varied().iter().copied().chain(randomiser.varied()).collect();
        varied.sort_unstable();
        varied.dedup();
        let nominal = robot.parameters();
        let (names, domains) = (robot.parameter_names(), robot.parameter_domains());
        let theta: Vec<_> = varied.iter().map(|k| (names[*k].clone(), nominal[*k], domains[*k])).collect();
        let sensing = SensorSetup::of(config, &*task)?;
        let estimating = EstimateSetup::of(config, &*task)?;
        let read = sensing.as_ref().filter(|_| config.shows_readings());
        let (mut shown, reading) = (own.observation.clone(), read.map_or(0, |sensing| sensing.n));
        shown.extend(read.iter().flat_map(|sensing| sensing.fields.iter().cloned()));
        let extent = Extent::of(&config.observation, total(&shown), theta.len())?;
        let residual = Residual::of(config, robot)?;
        let n_agent = task.n_agent();
        let control = Control::new(config, robot, n_agent)?;
        let pipeline = Pipeline::new(&config.observation, &shown, &theta)?;
        let plans = Plans::of(&*task, &randomiser, &varied, [total(&own.goal), total(&own.task_state)])?;
        let sizes = Sizes {
            term: own.reward.len(),
            hold: ((own.success.held / config.dt).round() as usize).min(task.horizon()),
            end: own.ends.len(),
            metric: own.metrics.len(),
            info: told.len(),
            goal: total(&own.goal),
            task_state: total(&own.task_state),
            theta: varied.len(),
            beginning: if residual.is_some() { robot.n_state() + total(&own.goal) } else { 0 },
            air: if randomiser.blows() { 3 } else { 0 },
            agent: n_agent,
            command: n_agent * control.n_command,
            action: n_agent * control.n_action(),
            delay: if config.delay.max > 0 { config.delay.max + 1 } else { 0 },
            raw: total(&shown),
            reading,
            estimate: if estimating.is_some() { ESTIMATE * n_agent } else { 0 },
            observation: extent.observation,
            history: n_agent * extent.memory,
            central: total(&own.central),
            frame: robot.n_frame(),
            rotor: n_rotor,
            held: n_agent * LATCHED_PER_AGENT,
            normalised: extent.normalised.unwrap_or(0),
            noise: pipeline.noise,
            draw: plans.n_draw,
        };
        // numbers that vary may leave zero, so nothing may be left out
        let plant = match robot.plant() {
            dynamics::Plant::Rigid(m) => BatchPlant::rigid(m.vehicle(), vary_effects(*m.physics(), &varied))?.0,
            dynamics::Plant::Tree(m) => BatchPlant::tree(m.model(), *m.physics(), !varied.is_empty())?.0,
        };
        let n_env = config.n_env;
        let bytes = bytes_per_env(&plant, &sizes)
            + sensing.as_ref().map_or(0, SensorSetup::bytes)
            + estimating.as_ref().map_or(0, |own| size_of::<f64>() * own.n_saved());
        check_memory(n_env, bytes + out_bytes(&sizes), config.memory_limit)?;
        let speeds = robot.drones().iter().flat_map(|d| d.rotors.iter().map(|r| r.speed)).collect();
        let privileged = theta.into_iter().map(|(name, value, _)| (name, value)).collect();
        let spec =
            spec_of(name, config, task.horizon(), &own, &sizes, &pipeline, &control, told.infos(), privileged, bytes);
        let statistics = Statistics::of_nothing(sizes.normalised);
        let rest = robot.rest().to_vec();
        let (limits, hover_input) = (config.bounds.limits(robot.plant()), robot.hover_input());
        let layout = EnvLayout::of(&sizes);
        let core = Core {
            parametric_plant: parametric_plant(robot, !varied.is_empty()),
            statistics: statistics.clone(),
            frozen: Arc::default(),
            shared: Columns::zeros(layout.shared.count),
            told: told.placed(&layout),
            layout,
            programs: OnceLock::new(),
            collects: true,
            delay: (config.delay.min, config.delay.max),
            mode: config.autoreset,
            stagger: config.stagger,
            truncate_after: config.truncate_after,
            first_environment: config.first_environment,
            config_hash: config_hash(name, config, &varied),
            program: OnceLock::new(),
            task_spec: own,
            task,
            control,
            residual,
            sensing,
            estimating,
            hover_input,
            bounds: config.bounds,
            throttle_change: config.throttle_change,
            limits,
            sizes,
            pipeline,
            randomiser,
            plans,
            difficulty: config.difficulty,
            easier: config.easier,
            varying: plant.varying(&nominal, &varied),
            plant,
            varied,
            nominal,
            speed_rows: speeds,
        };
        check_reference(&core, name)?;
        let programs = Programs::of(&core)?;
        let core = Core { programs: programs.into(), ..core };
        let mut block = EnvBlock::new(core.plant.block(&rest, BLOCK), &sizes);
        block.seed = [config.seed; BLOCK];
        // until its first reset an environment stands still; lanes behind the last one always do
        block.plant.rows[core.plant.alive_row()] = [STOPPED; BLOCK];
        if sizes.theta > 0 {
            core.plant.give_parameters(&mut block.plant);
            for (row, k) in core.layout.kept.theta.of_mut(&mut block.kept).iter_mut().zip(&core.varied) {
                *row = [core.nominal[*k] as f32; BLOCK];
            }
        }
        if let Some(estimating) = &core.estimating {
            block.give_estimates(&core, estimating);
        }
        let mut blocks = vec![block; n_env.div_ceil(BLOCK)];
        if let Some(last) = blocks.last_mut() {
            last.plant.occupied = n_env - (n_env - 1) / BLOCK * BLOCK;
        }
        if let Some(sensing) = &core.sensing {
            blocks.iter_mut().for_each(|block| block.sensors = vec![sensing.sensors(); block.plant.occupied]);
        }
        let (pool, threads) = (Mutex::new(Vec::new()), Threads::default());
        let mut env = Self { core, spec, blocks, pool, threads, recorded: None };
        env.freeze(statistics);
        env.set_threads(Threads::default());
        Ok(env)
    }

    /// Whether all programs of another batch are those of this one, and their step for gradients too.
    #[doc(hidden)]
    pub fn is_recorded_alike(&self, other: &Self) -> bool {
        let (own, theirs) = (self.core.programs(), other.core.programs());
        let step = |env: &Self| env.core.record(&StepLayout::of(&env.core));
        own.is_same(theirs) && step(self) == step(other)
    }

    /// The programs of steps, starts and events, and of a step for gradients: printed, by name.
    #[doc(hidden)]
    pub fn printed(&self) -> Vec<(&'static str, String)> {
        let step = self.core.record(&StepLayout::of(&self.core));
        let mut all = self.core.programs().printed();
        all.push(("gradients", ValueForm::of(&step).to_string()));
        all
    }

    /// Steps on these threads from now on, with memory for each of them: later steps allocate nothing, but where physics give up for
    /// the first time, which is looked into.
    pub fn set_threads(&mut self, threads: Threads) {
        let n = threads.count().min(self.blocks.len().div_ceil(BLOCKS_PER_PART)).max(1);
        let core = &self.core;
        self.pool.get_mut().unwrap_or_else(PoisonError::into_inner).resize_with(n, || core.workspace());
        self.threads = threads;
    }

    /// What it steps on.
    pub(crate) fn threads(&self) -> &Threads {
        &self.threads
    }

    /// Names, sizes, units and bounds of all arrays.
    pub fn spec(&self) -> &Spec {
        &self.spec
    }

    /// Begins episodes: those of the environments marked in `which` (`[E]`), or all. `seeds` (`[E]`) are new seeds of
    /// those; with a seed, episodes count from their first again. Writes observations, central states, and zero rewards
    /// and flags of those environments. Every environment must have been reset once before the first step.
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length.
    pub fn reset(&mut self, which: Option<&[bool]>, seeds: Option<&[u64]>, out: &mut StepOut<'_>) -> Result<()> {
        out.check(&self.spec)?;
        for (what, got) in [("which", which.map(<[bool]>::len)), ("seeds", seeds.map(<[u64]>::len))] {
            if let Some(got) = got.filter(|n| *n != self.spec.n_env) {
                let remedy = "Give one entry per environment.";
                return Err(Error::value(format!("length of {what}"), got, self.spec.n_env.to_string(), remedy));
            }
        }
        if let Some(seeds) = seeds {
            for (i, seed) in seeds.iter().enumerate().filter(|(i, _)| which.is_none_or(|w| w[*i])) {
                self.blocks[i / BLOCK].seed[i % BLOCK] = *seed;
                self.blocks[i / BLOCK].episode[i % BLOCK] = 0;
            }
        }
        let chosen = |first: usize| {
            let own = |lane: usize| which.is_none_or(|w| w.get(first + lane).copied().unwrap_or(false));
            (0..BLOCK).fold(0, |mask, lane| mask | (u64::from(own(lane)) << lane))
        };
        self.for_each_block(&[], out, &mut [], |mut block, out, _| block.reset(chosen(block.first), out));
        Ok(())
    }

    /// The seed of every environment from now on; episodes count from their first again. Call [`Env::reset`] next.
    pub fn seed(&mut self, seed: u64) {
        for block in &mut self.blocks {
            block.seed = [seed; BLOCK];
            block.episode = [0; BLOCK];
        }
    }

    /// For curricula: from the next restarts on, episodes take this share of all randomisation, between the nominal
    /// numbers (0) and the ranges of the configuration (1); tasks see it as [`Start::difficulty`](super::Start::difficulty).
    /// A share of [`EnvConfig::easier`] has less. Saved with the state.
    ///
    /// # Errors
    /// [`Error::Value`] outside [0, 1].
    pub fn set_difficulty(&mut self, share: f64) -> Result<()> {
        check_difficulty(share)?;
        self.core.difficulty = share;
        Ok(())
    }

    /// One step of every environment. `actions`: row-major `[E, A, action]`. What is not a number acts as the task's safe
    /// command, what is outside [−1, 1] is clipped; both are counted in the info `clipped`.
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length, or where an environment was never [reset](Env::reset).
    pub fn step(&mut self, actions: &[f32], out: &mut StepOut<'_>) -> Result<()> {
        self.step_into(actions, out, None)
    }

    fn step_into(&mut self, actions: &[f32], out: &mut StepOut<'_>, tape: Option<&mut Tape>) -> Result<()> {
        out.check(&self.spec)?;
        let wanted = self.spec.n_env * self.core.sizes.action;
        if actions.len() != wanted {
            let remedy = "Rows are [environment, agent, action], row-major.";
            return Err(Error::value("length of actions", actions.len(), wanted.to_string(), remedy));
        }
        self.check_started()?;
        let (t, layout) = tape.as_ref().map_or((0, None), |tape| (tape.len(), Some(tape.layout.clone())));
        let tape = tape.map_or(&mut [][..], |tape| &mut tape.blocks[..]);
        self.for_each_block(actions, out, tape, |mut block, out, tape| {
            let slot = tape.first_mut().map(|block| &mut block.slots[t]);
            block.step(out, layout.as_ref().zip(slot));
        });
        Ok(())
    }

    /// Does `each` for all blocks with their rows and tapes, in parallel.
    fn for_each_block(
        &mut self,
        actions: &[f32],
        out: &mut StepOut<'_>,
        tape: &mut [BlockTape],
        each: impl Fn(Stepper<'_>, &mut StepOut<'_>, &mut [BlockTape]) + Sync + Send,
    ) {
        let (core, pool) = (&self.core, &self.pool);
        let span = Span::new(&mut self.blocks, self.spec.n_env, actions, out.reborrow(), tape);
        self.threads.for_each_part(span, BLOCKS_PER_PART, &|mut part: Span<'_>| {
            let mut own = pool.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_else(|| core.workspace());
            while !part.blocks.is_empty() {
                let mut one = part.take(1);
                let (block, first) = (&mut one.blocks[0], one.first * BLOCK);
                let block = Stepper::new(core, block, &mut own, first, one.actions);
                each(block, &mut one.out, one.tape);
            }
            pool.lock().unwrap_or_else(PoisonError::into_inner).push(own);
        });
    }

    /// Random actions of every agent within their space, `[E, A, action]`, the same for the same `draw`. They belong to the
    /// environment: a shard draws its part of the whole batch.
    pub fn sample(&self, draw: u64, actions: &mut [f32]) {
        for (i, own) in actions.chunks_mut(self.core.sizes.action.max(1)).enumerate() {
            self.sample_one(draw, i, own);
        }
    }

    /// The actions of one environment.
    pub(crate) fn sample_one(&self, draw: u64, environment: usize, actions: &mut [f32]) {
        let number = self.core.first_environment.wrapping_add(environment as u64);
        let mut stream = Stream::new(draw, number, 0, Purpose::POLICY);
        for a in actions {
            *a = match self.spec.action {
                Space::Box { low, high, .. } => stream.uniform(f64::from(low), f64::from(high)) as f32,
                Space::Discrete { n } => stream.below(n as u64) as f32,
                Space::MultiDiscrete { levels, .. } => stream.below(levels as u64) as f32,
            };
        }
    }

    /// Writes what the environments look like now: observations with the statistics and noise of this moment, central
    /// states and privileged numbers; nothing moves on. Call it where observations in hand are of another time: behind
    /// [`Env::update_normaliser`], [`Env::set_state`] or [`Env::load`]. Rotor speeds before the step count as those of now,
    /// and a history behind a normaliser keeps the scale that it remembered.
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length, or where an environment was never reset.
    pub fn observe(&mut self, out: &mut StepOut<'_>) -> Result<()> {
        out.check(&self.spec)?;
        self.check_started()?;
        self.for_each_block(&[], out, &mut [], |mut block, out, _| block.show(out));
        Ok(())
    }

    /// Whether every environment has begun an episode: what steps and observations need.
    pub fn is_started(&self) -> bool {
        self.check_started().is_ok()
    }

    /// The physical state of one environment, `[state]`, in the layout of the task's robot (SI).
    ///
    /// # Errors
    /// [`Error::Limit`] if there is no such environment.
    pub fn state(&self, environment: usize) -> Result<Vec<f32>> {
        self.check_environment(environment)?;
        let (block, lane) = (&self.blocks[environment / BLOCK], environment % BLOCK);
        Ok((0..self.core.task.robot().n_state()).map(|k| block.plant.rows[k][lane]).collect())
    }

    /// What broke where the simulation of one environment last [`diverged`](Spec::diverged): of a state beyond the
    /// [`Bounds`](super::Bounds) the number farthest beyond. `None` where none has.
    ///
    /// # Errors
    /// As [`Env::state`].
    pub fn breach(&self, environment: usize) -> Result<Option<Breach>> {
        self.check_environment(environment)?;
        let culprit = self.blocks[environment / BLOCK].broken[environment % BLOCK];
        Ok(culprit.map(|culprit| culprit.in_words(self.core.plant.words())))
    }

    /// Overwrites the physical state of one environment; its episode goes on.
    ///
    /// # Errors
    /// As [`Env::state`]; [`Error::Value`] for a wrong length or a number that is not finite.
    pub fn set_state(&mut self, environment: usize, state: &[f32]) -> Result<()> {
        self.check_environment(environment)?;
        let n = self.core.task.robot().n_state();
        if state.len() != n {
            return Err(Error::value("length of state", state.len(), n.to_string(), "Take it from Env::state."));
        }
        finite("state", &state.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>())?;
        let (block, lane) = (&mut self.blocks[environment / BLOCK], environment % BLOCK);
        block.plant.rows.iter_mut().zip(state).for_each(|(row, x)| row[lane] = *x);
        block.moved |= 1 << lane;
        if let Some(own) = &mut block.estimates {
            own.anew |= 1 << lane;
        }
        Ok(())
    }

    /// The goal of one environment: see the task's [`TaskSpec::goal`].
    ///
    /// # Errors
    /// As [`Env::state`].
    pub fn goal(&self, environment: usize) -> Result<Vec<f32>> {
        self.check_environment(environment)?;
        let (block, lane) = (&self.blocks[environment / BLOCK], environment % BLOCK);
        Ok(self.core.layout.kept.goal.of(&block.kept).iter().map(|row| row[lane]).collect())
    }

    /// What stands around in one environment, world: [`Scene::solids`](dynamics::scene::Scene::solids) of the task's
    /// scene, where the goal puts them. What the robot's model holds is not among it.
    ///
    /// # Errors
    /// As [`Env::state`].
    pub fn solids(&self, environment: usize) -> Result<Vec<Shape>> {
        let goal: Vec<f64> = self.goal(environment)?.into_iter().map(f64::from).collect();
        let scene = self.core.task.scene();
        let mut placement = scene.nominal_placement();
        self.core.task.place_scene(&goal, &mut placement);
        Ok(scene.solids(&placement))
    }

    /// The physical numbers that are in force in one environment, in the order of
    /// [`Robot::parameter_names`](super::Robot::parameter_names).
    ///
    /// # Errors
    /// As [`Env::state`].
    pub fn parameters(&self, environment: usize) -> Result<Vec<f64>> {
        self.check_environment(environment)?;
        let (block, lane) = (&self.blocks[environment / BLOCK], environment % BLOCK);
        let mut numbers = self.core.nominal.clone();
        for (row, k) in self.core.layout.kept.theta.of(&block.kept).iter().zip(&self.core.varied) {
            numbers[*k] = f64::from(row[lane]);
        }
        Ok(numbers)
    }

    /// [`Env::state`] of all environments, `[E, state]`, row-major; allocates nothing.
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length.
    pub fn states_into(&self, rows: &mut [f32]) -> Result<()> {
        let n = self.robot().n_state();
        self.check_rows("states", n, rows.len())?;
        self.columns_into(|block| &block.plant.rows[..n], n, rows);
        Ok(())
    }

    /// [`Env::goal`] of all environments, `[E, goal]`, row-major; allocates nothing. The sizes of
    /// [`TaskSpec::goal`](super::TaskSpec::goal) add up to a row.
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length.
    pub fn goals_into(&self, rows: &mut [f32]) -> Result<()> {
        let n = self.core.sizes.goal;
        self.check_rows("goals", n, rows.len())?;
        self.columns_into(|block| self.core.layout.kept.goal.of(&block.kept), n, rows);
        Ok(())
    }

    /// [`Env::parameters`] of all environments, `[E, number]`, row-major; allocates nothing.
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length.
    pub fn parameters_into(&self, rows: &mut [f64]) -> Result<()> {
        let nominal = &self.core.nominal;
        self.check_rows("numbers", nominal.len(), rows.len())?;
        for (i, own) in rows.chunks_exact_mut(nominal.len()).enumerate() {
            own.copy_from_slice(nominal);
            let theta = self.core.layout.kept.theta.of(&self.blocks[i / BLOCK].kept).iter().zip(&self.core.varied);
            theta.for_each(|(row, k)| own[*k] = f64::from(row[i % BLOCK]));
        }
        Ok(())
    }

    /// Rotors of an environment, over all its agents.
    pub fn n_rotor(&self) -> usize {
        self.core.sizes.rotor
    }

    /// Commands of all rotors, `[E, rotor]`, row-major, agent by agent: each in \[−1, 1\], at the end of the last step,
    /// before its motor's lag, whatever actions mean; allocates nothing.
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length.
    pub fn rotor_commands_into(&self, rows: &mut [f32]) -> Result<()> {
        let n = self.n_rotor();
        self.check_rows("rotor commands", n, rows.len())?;
        let rotors = self.robot().drones().iter().flat_map(|drone| &drone.rotors);
        for (k, row) in rotors.map(|rotor| self.core.plant.input_row(rotor.action)).enumerate() {
            for (i, own) in rows.chunks_exact_mut(n).enumerate() {
                own[k] = self.blocks[i / BLOCK].plant.rows[row][i % BLOCK];
            }
        }
        Ok(())
    }

    fn check_rows(&self, what: &str, n: usize, got: usize) -> Result<()> {
        let wanted = self.spec.n_env * n;
        if got == wanted {
            return Ok(());
        }
        let remedy = format!("Rows are environments, {n} numbers each.");
        Err(Error::value(format!("length of {what}"), got, wanted.to_string(), remedy))
    }

    /// Columns of every block as rows of `n` numbers.
    fn columns_into(&self, of: impl Fn(&EnvBlock) -> &[[f32; BLOCK]], n: usize, rows: &mut [f32]) {
        if n > 0 {
            let own = self.blocks.iter().zip(rows.chunks_mut(BLOCK * n));
            own.for_each(|(block, rows)| to_rows(of(block), rows.len() / n, rows));
        }
    }

    /// The summands of the reward in a state that the task calls ideal: their sum comes within 1e-6 of
    /// [`Spec::reward_bound`], effort aside.
    pub fn ideal_terms(&self) -> Vec<f64> {
        ideal_terms(&self.core)
    }

    /// What the task's own controllers track from the state of one environment on, where an episode begins; `None` where no reference
    /// can express it.
    ///
    /// # Errors
    /// As [`Env::state`].
    pub fn reference(&self, environment: usize) -> Result<Option<TaskReference>> {
        let exact = |numbers: Vec<f32>| numbers.into_iter().map(f64::from).collect::<Vec<f64>>();
        let (state, goal) = (exact(self.state(environment)?), exact(self.goal(environment)?));
        Ok(reference(&self.core, &state, &goal))
    }

    /// Of one name, configuration and varied numbers: what fits one such environment fits the other.
    pub(crate) fn config_hash(&self) -> u64 {
        self.core.config_hash
    }

    /// The commands that actions stand for which are no numbers, `[A, command]`: rotors carry the weight, drives and setpoints
    /// rest, and controllers beside the actions are left alone.
    pub fn safe_command(&self) -> &[f64] {
        &self.core.control.safe
    }

    /// What flies.
    pub fn robot(&self) -> &super::robot::Robot {
        self.core.task.robot()
    }

    /// What the task says about itself.
    pub fn task_spec(&self) -> &TaskSpec {
        &self.core.task_spec
    }

    /// Every environment has begun an episode.
    fn check_started(&self) -> Result<()> {
        for (i, block) in self.blocks.iter().enumerate() {
            let missing = first_lanes(self.spec.n_env - i * BLOCK) & !block.started;
            if missing != 0 {
                let what = format!("environment {}", i * BLOCK + missing.trailing_zeros() as usize);
                let remedy = "Reset all of them once.";
                return Err(Error::value(what, "not started", "reset before the first step", remedy));
            }
        }
        Ok(())
    }

    fn check_environment(&self, environment: usize) -> Result<()> {
        if environment < self.spec.n_env {
            return Ok(());
        }
        Err(Error::limit("environment", environment, self.spec.n_env - 1, "Environments count from 0."))
    }
}

/// Effects with every path open that numbers of other environments may need: of a rotor's axis that is upright now, also sideways.
fn vary_effects(mut physics: Physics, varied: &[usize]) -> Physics {
    let of_axis = |k: &usize| {
        let own = k.checked_sub(BODY_PARAMETERS.len()).map(|k| k % N_ROTOR_PARAMETER);
        matches!(own, Some(at::axis_x | at::axis_y | at::axis_z))
    };
    physics.effects.products_of_inertia |= !varied.is_empty();
    physics.effects.tilted_rotors |= varied.iter().any(of_axis);
    physics
}
