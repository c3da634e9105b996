//! Gradients through steps of many environments: a tape of what was stepped, its reverse sweep, and Jacobians.
//!
//! The tape keeps what went into each step, not operations: a step's inside is recomputed by its adjoint program, as in
//! [`Rollout`](autodiff::Rollout). A sweep is pulled step by step, backwards, so that a policy between steps can
//! turn the gradient of its action into one of its observation.
//!
//! Gradients are cut
//! - where an episode ends: a restart does not depend on what was before. What an earlier or later end does to the return,
//!   no gradient sees;
//! - where the caller moved an environment between two recorded steps: by [`Env::reset`], [`Env::set_state`],
//!   [`Env::load`], or a step that this tape does not have;
//! - in environments whose physics gave up in a step: that step has the gradient zero.
//!
//! What sensors read is a constant, unless a sensor has `gradient = "pose"`. The tape then keeps how its readings change with
//! the pose of the body that carries it, and what the policy wants of readings is pulled into that pose behind the step. Jumps
//! at silhouettes are ignored, and what else moves in sight stands still to it: the gradient is biased by both.

use super::Env;
use super::block::{Columns, EnvBlock, Workspace};
use super::core::Core;
use super::mask::lanes_of;
use super::sensing::{POSE, SLOPE, Sloped};
use super::transition::{self, StepLayout};
use crate::config::{ActionSpace, Autoreset};
use autodiff::lanes::{to_columns, to_rows};
use autodiff::native::{Executable, Place, RowLayout, Rows, Work};
use autodiff::once::made_once;
use autodiff::program::{BLOCK, BlockWorkspace};
use autodiff::{Program, Recording};
use base::error::{Error, Result};
use base::memory::Request;
use base::parallel::{Divide, Threads};
use nalgebra::{DMatrix, DMatrixView};
use num_dual::Dual64;
use std::ops::Range;
use std::sync::{Arc, OnceLock, Weak};

/// One block before one step, with what happened in it.
#[derive(Debug, Clone)]
pub(crate) struct TapeEntry {
    arguments: Columns,
    /// Of readings by poses, behind the step.
    slopes: Columns,
    /// Lanes that stepped, and whose physics went well.
    running: u64,
    ended: u64,
    /// Lanes that were moved from outside since the recorded step before.
    moved: u64,
}

/// Copies the first `n` environments of rows: half of each where they stand in it.
fn copy(to: &mut [[f32; BLOCK]], from: &[[f32; BLOCK]], n: usize) {
    if n > BLOCK / 2 {
        return to.copy_from_slice(&from[..to.len()]);
    }
    to.iter_mut().zip(from).for_each(|(to, from)| to[..BLOCK / 2].copy_from_slice(&from[..BLOCK / 2]));
}

impl TapeEntry {
    fn new(layout: &StepLayout) -> Self {
        let (arguments, slopes) = (Columns::zeros(layout.n_kept()), Columns::zeros(layout.n_slope()));
        Self { arguments, slopes, running: 0, ended: 0, moved: 0 }
    }

    /// Before the step.
    pub(crate) fn open(&mut self, p: &StepLayout, core: &Core, block: &EnvBlock, running: u64) {
        (self.running, self.moved) = (running, block.moved);
        let n = block.plant.occupied;
        copy(&mut self.arguments[p.state.clone()], &block.plant.rows, n);
        for (place, part) in p.of_kept(&core.layout.kept) {
            copy(&mut self.arguments[place], part.of(&block.kept), n);
        }
        for (at, row) in p.time.clone().zip(StepLayout::CLOCK) {
            self.arguments[at] = block.kept[row];
        }
    }

    /// Actions as they came, the goal and the noise of the observation behind the step, and where physics went well.
    pub(crate) fn close(
        &mut self,
        p: &StepLayout,
        core: &Core,
        block: &EnvBlock,
        work: &Workspace,
        ended: u64,
        alive: u64,
    ) {
        self.ended = ended;
        self.running &= alive;
        let (kept, working) = (&core.layout.kept, &core.layout.work);
        for (place, rows) in [
            (&p.action, working.action.of(&work.rows)),
            (&p.next_goal, kept.goal.of(&block.kept)),
            (&p.readings, kept.readings.of(&block.kept)),
            (&p.estimate, kept.estimate.of(&block.kept)),
            (&p.noise, working.noise.of(&work.rows)),
        ] {
            copy(&mut self.arguments[place.clone()], rows, block.plant.occupied);
        }
        if let Some(senses) = &work.senses {
            copy(&mut self.slopes, &senses.slopes, block.plant.occupied);
        }
    }
}

/// The slots of one block.
#[derive(Debug, Clone)]
pub(crate) struct BlockTape {
    pub slots: Vec<TapeEntry>,
}

/// Which tape: a clone is another one.
#[derive(Debug, Default)]
struct Identity(Arc<()>);

impl Clone for Identity {
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// What [`Env::step_recorded`] remembers of up to `horizon` steps.
#[derive(Debug, Clone)]
pub struct Tape {
    identity: Identity,
    pub(crate) blocks: Vec<BlockTape>,
    pub(crate) layout: StepLayout,
    /// The normaliser's, step by step.
    statistics: Vec<Arc<[f64]>>,
    n_env: usize,
    n_step: usize,
}

impl Tape {
    /// Steps recorded.
    pub fn len(&self) -> usize {
        self.n_step
    }

    /// Whether nothing is recorded.
    pub fn is_empty(&self) -> bool {
        self.n_step == 0
    }

    /// Forgets all steps and keeps the memory.
    pub fn clear(&mut self) {
        self.n_step = 0;
    }

    /// Steps that fit.
    pub fn horizon(&self) -> usize {
        self.statistics.len()
    }

    /// Memory that it takes, bytes.
    pub fn bytes(&self) -> u64 {
        tape_bytes(&self.layout, self.blocks.len(), self.horizon()) as u64
    }
}

/// What a tape takes: see [`Env::tape`].
fn tape_bytes(layout: &StepLayout, n_block: usize, horizon: usize) -> u128 {
    let slot = layout.n_taped() * size_of::<[f32; BLOCK]>() + size_of::<TapeEntry>();
    horizon as u128 * (n_block as u128 * slot as u128 + size_of::<Arc<[f64]>>() as u128)
}

/// The adjoint of one step of a task; clones share it. The normaliser's statistics are arguments of it, so it outlives
/// [`Env::update_normaliser`].
#[derive(Debug, Clone)]
pub struct Adjoint(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    layout: StepLayout,
    program: Program,
    /// The same that reads a step where its tape keeps it, made for the first sweep.
    in_place: OnceLock<Executable<[f32; BLOCK]>>,
    readings: Option<Readings>,
    parameters: bool,
    seeds: Seeds,
    mode: Autoreset,
    threads: Threads,
    n_env: usize,
}

impl Shared {
    fn in_place(&self) -> &Executable<[f32; BLOCK]> {
        made_once(&self.in_place, || {
            let (n_kept, program) = (self.layout.n_kept(), &self.program);
            let is_taped = |row: usize| row < n_kept && !self.layout.statistics.contains(&row);
            let argument = |row: usize| Place { array: u8::from(!is_taped(row)), row: row as u32 };
            let result = |row: usize| Place { array: 2, row: row as u32 };
            let arguments = (0..program.n_input()).map(argument).collect();
            RowLayout::new(arguments, (0..program.n_output()).map(result).collect())
                .and_then(|layout| Executable::new(program, layout))
                .expect("every result has a row of its own")
        })
    }
}

/// From cotangents of what is observed to those of the readings that gradients follow.
#[derive(Debug)]
struct Readings {
    /// Through the transforms, to those of all readings.
    program: Program,
    sloped: Vec<Sloped>,
}

/// Which results of a step an adjoint takes cotangents of, beside observations and what is carried. What only the others
/// need is left out of its program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seeds {
    /// The central state.
    pub central: bool,
    /// The reward.
    pub reward: bool,
    /// The loss.
    pub loss: bool,
}

impl Seeds {
    /// Of all results.
    pub const ALL: Self = Self { central: true, reward: true, loss: true };
}

/// Cotangents of what one step wrote; an empty slice stands for zeros.
///
/// Where an episode ended and restarted in the step ([`Autoreset::SameStep`]), `observation` and `central` show the next
/// episode and are ignored. In the other modes they show the end, as `final_*` do, and both count.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cotangents<'a> {
    /// `[E, A, observation]`.
    pub observation: &'a [f32],
    /// `[E, A, observation]`, used where an episode ended in the step.
    pub final_observation: &'a [f32],
    /// `[E, central]`.
    pub central: &'a [f32],
    /// `[E, central]`, used where an episode ended in the step.
    pub final_central: &'a [f32],
    /// `[E, carried]`, used where an episode ended in the step: of the numbers that it ended with, physics first. Where
    /// none ended, [`Sweep::add_carried`] does it.
    pub final_carried: &'a [f32],
    /// `[E]`, of the reward of the team.
    pub reward: &'a [f32],
    /// `[E]`, of the info `loss`.
    pub loss: &'a [f32],
}

/// How cotangents travel from step to step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepOptions {
    /// Factor per step on what is carried; 1, the default, is the exact gradient.
    pub decay: f32,
    /// Largest norm of what is carried, per environment; infinite, the default, for none.
    pub clip: f32,
}

impl Default for SweepOptions {
    /// Exact.
    fn default() -> Self {
        Self { decay: 1.0, clip: f32::INFINITY }
    }
}

/// A reverse sweep over a tape. It holds its adjoint, and allocates nothing after its making.
#[derive(Debug, Clone)]
pub struct Sweep {
    adjoint: Adjoint,
    options: SweepOptions,
    blocks: Vec<BlockSweep>,
    /// The step pulled last.
    last: Option<usize>,
}

#[derive(Debug, Clone)]
struct BlockSweep {
    carried: Columns,
    action: Columns,
    parameters: Columns,
    arguments: Columns,
    results: Columns,
    work: Work<[f32; BLOCK]>,
    /// Cotangents of readings, and the memory to find them; without any where no gradient follows them.
    readings: Columns,
    reading_workspace: Option<BlockWorkspace>,
    dropped: usize,
}

impl Env {
    /// Where the arguments and results of a step stand, for [`Jacobian::arguments`] and [`Env::evaluate`].
    pub fn layout(&self) -> StepLayout {
        StepLayout::of(&self.core)
    }

    /// One step as it is recorded for gradients: from arguments to results of [`Env::layout`]. Walked over node by node
    /// ([`Recording::evaluate`]) it is the witness of [`Env::program`] and of adjoints.
    ///
    /// # Errors
    /// [`Error::Value`] where controllers fly beside the actions.
    pub fn recording(&self) -> Result<Recording> {
        self.check_differentiable()?;
        Ok(self.core.record(&self.layout()))
    }

    /// The same as a program, which [`Env::evaluate`] and [`Env::jacobian`] run; made in the first call.
    ///
    /// # Errors
    /// As [`Env::recording`]; [`Error::Limit`] if it is too large.
    pub fn program(&self) -> Result<&Program> {
        self.check_differentiable()?;
        self.core.program(&self.layout())
    }

    /// The adjoint of a step, recorded once and compiled: milliseconds for a vehicle, up to seconds for a team. With
    /// `parameters`, sweeps also give gradients with respect to the numbers that differ between environments.
    ///
    /// # Errors
    /// [`Error::Value`] for discrete actions; [`Error::Limit`] if the recording is too large.
    pub fn adjoint(&self, parameters: bool) -> Result<Adjoint> {
        self.adjoint_of(parameters, Seeds::ALL)
    }

    /// As [`Env::adjoint`], for cotangents of these results alone.
    ///
    /// # Errors
    /// As [`Env::adjoint`].
    pub fn adjoint_of(&self, parameters: bool, seeds: Seeds) -> Result<Adjoint> {
        self.check_differentiable()?;
        self.check_continuous()?;
        let layout = self.layout();
        let recording = self.core.record(&layout);
        let wanted = if parameters { layout.parameters.end } else { layout.action.end };
        let seeded = |result: usize| match result {
            k if layout.central.contains(&k) => seeds.central,
            k if k == layout.reward => seeds.reward,
            k if k == layout.loss => seeds.loss,
            _ => true,
        };
        let sloped = self.core.sensing.as_ref().map_or(&[][..], |sensing| &sensing.sloped);
        let readings = if sloped.is_empty() {
            None
        } else {
            let program = Program::compile(&recording.adjoint_of(seeded, layout.readings.clone()))?;
            Some(Readings { program, sloped: sloped.to_vec() })
        };
        Ok(Adjoint(Arc::new(Shared {
            program: Program::compile(&recording.adjoint_of(seeded, 0..wanted))?,
            in_place: OnceLock::new(),
            readings,
            parameters,
            seeds,
            mode: self.core.mode,
            threads: self.threads.clone(),
            n_env: self.spec.n_env,
            layout,
        })))
    }

    fn check_continuous(&self) -> Result<()> {
        if self.spec.config.actions == ActionSpace::Continuous {
            return Ok(());
        }
        let remedy = "Whole numbers have no gradient: leave `actions` out.";
        Err(Error::value("actions", "discrete", "continuous for gradients", remedy))
    }

    /// Gradients know actions, not the controllers beside them.
    fn check_differentiable(&self) -> Result<()> {
        if self.core.residual.is_none() {
            return Ok(());
        }
        let remedy = "Learn by PPO, or leave `residual` out.";
        Err(Error::value("residual", self.spec.config.residual, "0 for gradients", remedy))
    }

    /// Memory for `horizon` recorded steps: per step and environment 4 bytes for each number that goes into a step
    /// ([`StepLayout`] up to `noise`) and six for each reading whose gradient is followed, and 1 byte of book-keeping; for whole blocks
    /// of 64 environments.
    ///
    /// # Errors
    /// [`Error::Value`] for discrete actions; [`Error::Limit`] before any allocation if that is more than
    /// [`EnvConfig::memory_limit`](crate::EnvConfig::memory_limit).
    pub fn tape(&self, horizon: usize) -> Result<Tape> {
        self.check_tape(horizon)?;
        let (layout, n_block) = (self.layout(), self.blocks.len());
        let block = BlockTape { slots: vec![TapeEntry::new(&layout); horizon] };
        let statistics = vec![self.core.frozen.clone(); horizon];
        let (identity, blocks) = (Identity::default(), vec![block; n_block]);
        Ok(Tape { identity, blocks, layout, statistics, n_env: self.spec.n_env, n_step: 0 })
    }

    /// Whether there may be a tape of so many steps.
    ///
    /// # Errors
    /// As [`Env::tape`].
    #[doc(hidden)]
    pub fn check_tape(&self, horizon: usize) -> Result<()> {
        self.check_continuous()?;
        let (layout, n_block) = (self.layout(), self.blocks.len());
        let request = Request {
            what: "horizon of the tape",
            value: horizon,
            bytes: tape_bytes(&layout, n_block, horizon),
            limit: self.spec.config.memory_limit,
            setting: "memory_limit",
            less: "Sweep over shorter windows, step fewer environments at once",
        };
        request.check(|limit| (u128::from(limit) / tape_bytes(&layout, n_block, 1)).to_string())
    }

    /// As [`Env::step`], remembered by the tape.
    ///
    /// # Errors
    /// As [`Env::step`]; [`Error::Limit`] if the tape is full, [`Error::Value`] if it is of another environment.
    pub fn step_recorded(&mut self, actions: &[f32], out: &mut super::StepOut<'_>, tape: &mut Tape) -> Result<()> {
        check_same_layout(tape, &self.layout(), self.spec.n_env)?;
        if tape.n_step >= tape.horizon() {
            let remedy = "Clear it, or make a longer one with env.tape(horizon).";
            return Err(Error::limit("steps of the tape", tape.n_step + 1, tape.horizon(), remedy));
        }
        let follows = |(identity, n): &(Weak<()>, usize)| {
            *n == tape.n_step && Weak::ptr_eq(identity, &Arc::downgrade(&tape.identity.0))
        };
        if !self.recorded.as_ref().is_some_and(follows) {
            // steps of another tape lie between
            self.blocks.iter_mut().for_each(|block| block.moved = u64::MAX);
        }
        self.step_into(actions, out, Some(tape))?;
        tape.statistics[tape.n_step].clone_from(&self.core.frozen);
        tape.n_step += 1;
        self.recorded = Some((Arc::downgrade(&tape.identity.0), tape.n_step));
        Ok(())
    }

    /// Exact derivatives of one step of one environment as it stands, by duals in `f64` through the recorded step, which is
    /// made in the first call; without noise of sensors and without events. What sensors read is a constant to it: it is read
    /// behind the step, and [`Sweep`] alone follows it.
    ///
    /// # Errors
    /// As [`Env::adjoint`] and [`Env::state`]; [`Error::Value`] for an action of the wrong length.
    pub fn jacobian(&self, environment: usize, action: &[f64]) -> Result<Jacobian> {
        self.check_environment(environment)?;
        self.check_differentiable()?;
        let layout = self.layout();
        let wanted = layout.action.len();
        if action.len() != wanted || self.spec.config.actions != ActionSpace::Continuous {
            let remedy = "Give the actions of all agents, continuous.";
            return Err(Error::value("length of action", action.len(), wanted.to_string(), remedy));
        }
        let (block, lane) = (&self.blocks[environment / BLOCK], environment % BLOCK);
        let mut slot = TapeEntry::new(&layout);
        slot.open(&layout, &self.core, block, u64::MAX);
        let goal = self.core.layout.kept.goal.of(&block.kept);
        copy(&mut slot.arguments[layout.next_goal.clone()], goal, block.plant.occupied);
        let mut z: Vec<f64> = slot.arguments.iter().map(|row| f64::from(row[lane])).collect();
        z[layout.action.clone()].copy_from_slice(action);
        z.extend(self.core.frozen.iter());
        self.jacobian_at(&z)
    }

    /// As [`Env::jacobian`] where the arguments are given: along a rollout in `f64` through [`Env::evaluate`].
    ///
    /// # Errors
    /// As [`Env::adjoint`]; [`Error::Value`] for another number of arguments.
    pub fn jacobian_at(&self, arguments: &[f64]) -> Result<Jacobian> {
        self.check_differentiable()?;
        let value = self.evaluate(arguments)?;
        let layout = self.layout();
        let matrix = derivatives(self.core.program(&layout)?, arguments, layout.parameters.end);
        Ok(Jacobian { arguments: arguments.to_vec(), value, matrix, layout })
    }

    /// The results of one step in `f64` for arguments as in [`Jacobian::arguments`]; [`Env::layout`] says what is where.
    ///
    /// # Errors
    /// [`Error::Value`] for another number of arguments.
    pub fn evaluate(&self, arguments: &[f64]) -> Result<Vec<f64>> {
        let layout = self.layout();
        if arguments.len() != layout.n_argument() {
            let (got, wanted) = (arguments.len(), layout.n_argument().to_string());
            return Err(Error::value("length of arguments", got, wanted, "Take them from Env::jacobian."));
        }
        let program = self.core.program(&layout)?;
        let mut value = vec![0.0; layout.n_result()];
        program.evaluate(&mut program.workspace_for(1), arguments, &mut value);
        Ok(value)
    }

    /// Arguments of a first step from the state that the task calls ideal, with the safe action: where norms and angles
    /// have their corners.
    pub fn ideal_arguments(&self) -> Vec<f64> {
        let (core, p) = (&self.core, self.layout());
        let ideal = transition::ideal(core);
        let mut z = vec![0.0; p.n_argument()];
        z[p.state].copy_from_slice(&ideal.state);
        z[p.task_state].copy_from_slice(&ideal.task_state);
        z[p.goal].copy_from_slice(&ideal.goal);
        z[p.next_goal].copy_from_slice(&ideal.goal);
        z[p.statistics].copy_from_slice(&core.frozen);
        for place in [p.line, p.action] {
            z[place].iter_mut().zip(core.control.safe.iter().cycle()).for_each(|(x, safe)| *x = *safe);
        }
        z[p.parameters].iter_mut().zip(&core.varied).for_each(|(x, k)| *x = ideal.numbers[*k]);
        z
    }
}

/// Derivatives with respect to the first `n` inputs, column by column.
fn derivatives(program: &Program, z: &[f64], n: usize) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(program.n_output(), n);
    let mut lifted: Vec<Dual64> = z.iter().map(|x| Dual64::from(*x)).collect();
    let mut y = vec![Dual64::from(0.0); program.n_output()];
    for k in 0..n {
        lifted[k].eps = 1.0;
        program.evaluate_over(&lifted, &mut y);
        lifted[k].eps = 0.0;
        y.iter().enumerate().for_each(|(row, result)| matrix[(row, k)] = result.eps);
    }
    matrix
}

/// Whether a tape is of an environment with these places.
fn check_same_layout(tape: &Tape, layout: &StepLayout, n_env: usize) -> Result<()> {
    if tape.n_env != n_env {
        let remedy = "Make it with env.tape(horizon) of that environment.";
        return Err(Error::value("environments of the tape", tape.n_env, n_env.to_string(), remedy));
    }
    if tape.layout != *layout {
        let limit = "of the same task and configuration";
        let remedy = "Make tape and adjoint of the environment that is stepped.";
        return Err(Error::value("the tape", "of another environment", limit, remedy));
    }
    Ok(())
}

/// ∂(next, observation, central, reward, loss)/∂(carried, action, parameters) of one step.
#[derive(Debug, Clone, PartialEq)]
pub struct Jacobian {
    /// Carried numbers, action, parameters, then what no derivative is taken of.
    pub arguments: Vec<f64>,
    /// The results themselves, in the order of [`Jacobian::layout`].
    pub value: Vec<f64>,
    /// Rows: carried numbers, observation, central state, reward, loss, poses. Columns: carried numbers, action, parameters.
    pub matrix: DMatrix<f64>,
    /// What is where, in all three.
    pub layout: StepLayout,
}

impl Jacobian {
    /// Part of the matrix, by [`Jacobian::layout`].
    ///
    /// # Errors
    /// [`Error::Value`] for columns behind the parameters or rows that there are not.
    pub fn part(&self, rows: &Range<usize>, columns: &Range<usize>) -> Result<DMatrixView<'_, f64>> {
        let (n_row, n_column) = self.matrix.shape();
        for (what, range, n) in [("rows", rows, n_row), ("columns", columns, n_column)] {
            if range.start > range.end || range.end > n {
                let remedy = "Take them from Jacobian::layout.";
                return Err(Error::value(
                    format!("{what} of a Jacobian"),
                    format!("{range:?}"),
                    format!("within 0..{n}"),
                    remedy,
                ));
            }
        }
        Ok(self.view(rows, columns))
    }

    fn view(&self, rows: &Range<usize>, columns: &Range<usize>) -> DMatrixView<'_, f64> {
        self.matrix.view((rows.start, columns.start), (rows.len(), columns.len()))
    }

    fn row(&self, row: usize, columns: &Range<usize>) -> DMatrixView<'_, f64> {
        self.view(&(row..row + 1), columns)
    }

    /// A of x⁺ = A x + B a + C θ, `[state, state]`: of the physical state alone.
    pub fn state(&self) -> DMatrixView<'_, f64> {
        self.view(&self.layout.state, &self.layout.state)
    }

    /// B of x⁺ = A x + B a + C θ, `[state, A · action]`.
    pub fn action(&self) -> DMatrixView<'_, f64> {
        self.view(&self.layout.state, &self.layout.action)
    }

    /// C of x⁺ = A x + B a + C θ, `[state, parameter]`: by the numbers that differ between environments.
    pub fn parameters(&self) -> DMatrixView<'_, f64> {
        self.view(&self.layout.state, &self.layout.parameters)
    }

    /// ∂observation/∂state, `[A · observation, state]`.
    pub fn observation_state(&self) -> DMatrixView<'_, f64> {
        self.view(&self.layout.observation, &self.layout.state)
    }

    /// ∂observation/∂action, `[A · observation, A · action]`.
    pub fn observation_action(&self) -> DMatrixView<'_, f64> {
        self.view(&self.layout.observation, &self.layout.action)
    }

    /// ∂reward/∂state, one row.
    pub fn reward_state(&self) -> DMatrixView<'_, f64> {
        self.row(self.layout.reward, &self.layout.state)
    }

    /// ∂reward/∂action, one row.
    pub fn reward_action(&self) -> DMatrixView<'_, f64> {
        self.row(self.layout.reward, &self.layout.action)
    }

    /// ∂loss/∂state, one row.
    pub fn loss_state(&self) -> DMatrixView<'_, f64> {
        self.row(self.layout.loss, &self.layout.state)
    }

    /// ∂loss/∂action, one row.
    pub fn loss_action(&self) -> DMatrixView<'_, f64> {
        self.row(self.layout.loss, &self.layout.action)
    }
}

impl Adjoint {
    /// Instructions of the program.
    pub fn n_instruction(&self) -> usize {
        self.0.program.len()
    }

    /// The program, for certificates: from arguments, then cotangents of results, to those of the arguments that
    /// derivatives are taken of.
    pub fn program(&self) -> &Program {
        &self.0.program
    }

    /// What is where among its arguments and results.
    pub fn layout(&self) -> &StepLayout {
        &self.0.layout
    }

    /// Numbers that go from step to step: physics, task state, delay line, history.
    pub fn n_carried(&self) -> usize {
        self.0.layout.n_carried()
    }

    /// A sweep that begins behind any step of a tape, with nothing carried.
    pub fn sweep(&self, options: SweepOptions) -> Sweep {
        let (p, program) = (&self.0.layout, &self.0.program);
        let block = BlockSweep {
            carried: Columns::zeros(p.n_carried()),
            action: Columns::zeros(p.action.len()),
            parameters: Columns::zeros(if self.0.parameters { p.parameters.len() } else { 0 }),
            arguments: Columns::zeros(program.n_input()),
            results: Columns::zeros(program.n_output()),
            work: self.0.in_place().work(),
            readings: Columns::zeros(if self.0.readings.is_some() { p.readings.len() } else { 0 }),
            reading_workspace: self.0.readings.as_ref().map(|own| own.program.block_workspace()),
            dropped: 0,
        };
        let blocks = vec![block; self.0.n_env.div_ceil(BLOCK)];
        Sweep { adjoint: self.clone(), options, blocks, last: None }
    }
}

/// Blocks of a sweep with rows of the actions' cotangents.
struct Pull<'a> {
    blocks: &'a mut [BlockSweep],
    /// Number of the first block.
    first: usize,
    action: &'a mut [f32],
    /// Numbers of a row.
    n_action: usize,
}

impl Divide for Pull<'_> {
    fn count(&self) -> usize {
        self.blocks.len()
    }

    fn divide(self, at: usize) -> (Self, Self) {
        let (first, n_action) = (self.first, self.n_action);
        let (left, right) = self.blocks.split_at_mut(at);
        let (before, behind) = self.action.split_at_mut((at * BLOCK * n_action).min(self.action.len()));
        (
            Self { blocks: left, first, action: before, n_action },
            Self { blocks: right, first: first + at, action: behind, n_action },
        )
    }
}

impl Sweep {
    /// Begins again behind any step, with nothing carried; keeps the memory.
    pub fn restart(&mut self) {
        for block in &mut self.blocks {
            block.carried.iter_mut().chain(&mut block.parameters).for_each(|row| *row = [0.0; BLOCK]);
            block.dropped = 0;
        }
        self.last = None;
    }

    /// Pulls cotangents back through step `t` of a tape: `action` (`[E, A, command]`) gets those of its actions. The first
    /// step pulled may be any, then each is the one before; [`Sweep::restart`] begins again. An environment whose gradient
    /// is not finite gets zeros and is counted.
    ///
    /// # Errors
    /// [`Error::Value`] for a tape of another task, configuration or number of environments, a step out of order, a slice of
    /// the wrong length, or cotangents that the adjoint has no [`Seeds`] of; [`Error::Limit`] if the tape has no such step. Nothing is
    /// changed then.
    pub fn pull(&mut self, tape: &Tape, t: usize, up: &Cotangents<'_>, action: &mut [f32]) -> Result<()> {
        let Self { adjoint: Adjoint(a), options, blocks, last } = self;
        check_same_layout(tape, &a.layout, a.n_env)?;
        if t >= tape.n_step {
            return Err(Error::limit("step of the tape", t, tape.n_step.saturating_sub(1), "Steps count from 0."));
        }
        if let Some(last) = last.filter(|last| t + 1 != *last || *last >= tape.n_step) {
            let wanted =
                if last == 0 { "none, as all are pulled".into() } else { format!("{} of that tape", last - 1) };
            let remedy = "Pull each step once, from the last to the first; sweep.restart() begins again.";
            return Err(Error::value("step of the sweep", t, wanted, remedy));
        }
        let p = &a.layout;
        let (n_seen, n_central, n_action) = (p.observation.len(), p.central.len(), p.action.len());
        for (what, got, each, optional) in [
            ("observation", up.observation.len(), n_seen, true),
            ("final_observation", up.final_observation.len(), n_seen, true),
            ("central", up.central.len(), n_central, true),
            ("final_central", up.final_central.len(), n_central, true),
            ("final_carried", up.final_carried.len(), p.n_carried(), true),
            ("reward", up.reward.len(), 1, true),
            ("loss", up.loss.len(), 1, true),
            ("action", action.len(), n_action, false),
        ] {
            if got != a.n_env * each && !(optional && got == 0) {
                let wanted = (a.n_env * each).to_string();
                return Err(Error::value(format!("length of {what}"), got, wanted, "Rows are environments."));
            }
        }
        for (what, given, seeded) in [
            ("central", up.central, a.seeds.central),
            ("final_central", up.final_central, a.seeds.central),
            ("reward", up.reward, a.seeds.reward),
            ("loss", up.loss, a.seeds.loss),
        ] {
            if !seeded && !given.is_empty() {
                let remedy = "Make the adjoint with env.adjoint, or with seeds for it.";
                return Err(Error::value(
                    format!("cotangents of {what}"),
                    given.len(),
                    "left out, as the adjoint does",
                    remedy,
                ));
            }
        }
        let (options, behind) = (*options, *last);
        a.threads.for_each_part(Pull { blocks, first: 0, action, n_action }, 1, &|part: Pull<'_>| {
            let slots = &tape.blocks[part.first].slots;
            let moved = behind.map_or(0, |behind| slots[behind].moved);
            let (block, first) = (&mut part.blocks[0], part.first * BLOCK);
            block.pull(a, &slots[t], &tape.statistics[t], moved, first, up, options);
            to_rows(&block.action, (a.n_env - first).min(BLOCK), part.action);
        });
        *last = Some(t);
        Ok(())
    }

    /// Cotangents of what the environments carried into the last step pulled, `[E, carried]`: physics first.
    pub fn carried(&self) -> Vec<f32> {
        self.rows(|block| &block.carried)
    }

    /// As [`Sweep::carried`], written to an array of the caller.
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length.
    pub fn carried_into(&self, rows: &mut [f32]) -> Result<()> {
        self.rows_into("carried", |block| &block.carried, rows)
    }

    /// Gradients with respect to the numbers that differ between environments, summed over all steps pulled, `[E, parameter]`; empty
    /// unless the adjoint was made with parameters.
    pub fn parameters(&self) -> Vec<f32> {
        self.rows(|block| &block.parameters)
    }

    /// As [`Sweep::parameters`], written to an array of the caller.
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length.
    pub fn parameters_into(&self, rows: &mut [f32]) -> Result<()> {
        self.rows_into("parameters", |block| &block.parameters, rows)
    }

    /// Adds to what is carried, `[E, carried]`, between pulls: before the first, the gradient of a cost on the state behind
    /// the window; later, of one on the state before the step pulled last. An environment whose episode ended in the step
    /// that is pulled next, which did not run in it, or which was moved from outside behind it, does not get it: what was
    /// carried there is of another episode. A cost on the state an episode ended with goes into
    /// [`Cotangents::final_carried`].
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length.
    pub fn add_carried(&mut self, cotangents: &[f32]) -> Result<()> {
        let n = self.adjoint.n_carried();
        check_rows("carried", cotangents.len(), n * self.adjoint.0.n_env)?;
        self.adjoint.0.threads.for_each(&mut self.blocks, |b, block| {
            for (lane, row) in cotangents[b * BLOCK * n..].chunks_exact(n).take(BLOCK).enumerate() {
                block.carried.iter_mut().zip(row).for_each(|(column, x)| column[lane] += x);
            }
        });
        Ok(())
    }

    /// Gradients that were not finite and became zero, environments times steps.
    pub fn dropped(&self) -> usize {
        self.blocks.iter().map(|b| b.dropped).sum()
    }

    fn rows(&self, of: impl Fn(&BlockSweep) -> &Columns + Sync + Send) -> Vec<f32> {
        let width = self.blocks.first().map_or(0, |block| of(block).len());
        let mut rows = vec![0.0; width * self.adjoint.0.n_env];
        self.write_rows(of, width, &mut rows);
        rows
    }

    fn rows_into(
        &self,
        what: &str,
        of: impl Fn(&BlockSweep) -> &Columns + Sync + Send,
        rows: &mut [f32],
    ) -> Result<()> {
        let width = self.blocks.first().map_or(0, |block| of(block).len());
        check_rows(what, rows.len(), width * self.adjoint.0.n_env)?;
        self.write_rows(of, width, rows);
        Ok(())
    }

    fn write_rows(&self, of: impl Fn(&BlockSweep) -> &Columns + Sync + Send, width: usize, rows: &mut [f32]) {
        if width > 0 {
            self.adjoint.0.threads.for_each_chunk(rows, BLOCK * width, |b, own| {
                to_rows(of(&self.blocks[b]), own.len() / width, own);
            });
        }
    }
}

fn check_rows(what: &str, got: usize, wanted: usize) -> Result<()> {
    if got == wanted {
        return Ok(());
    }
    Err(Error::value(format!("length of {what}"), got, wanted.to_string(), "Rows are environments."))
}

/// Row-major rows of environments from `first` on into columns; zeros where there are none.
fn spread(rows: &[f32], first: usize, columns: &mut [[f32; BLOCK]]) {
    if rows.is_empty() {
        columns.iter_mut().for_each(|column| *column = [0.0; BLOCK]);
        return;
    }
    to_columns(&rows[first * columns.len()..], columns);
}

/// The row of environment `i` into one lane, on top of what is there or in its place; zeros where there are no rows.
fn put(rows: &[f32], i: usize, lane: usize, columns: &mut [[f32; BLOCK]], add: bool) {
    let n = columns.len();
    for (k, column) in columns.iter_mut().enumerate() {
        let x = rows.get(i * n + k).copied().unwrap_or(0.0);
        column[lane] = if add { column[lane] + x } else { x };
    }
}

/// The cotangent of a turn about body axes, in the first three rows, into that of the quaternion q, in all four: 2 q ⊗ (0, g),
/// which any dq = ½ q ⊗ (0, δθ) meets as g·δθ, and a change of its length not at all.
fn turn(rows: &mut [[f32; BLOCK]], q: &[[f32; BLOCK]], lane: usize) {
    let [gx, gy, gz] = [0, 1, 2].map(|k| 2.0 * rows[k][lane]);
    let [w, x, y, z] = [0, 1, 2, 3].map(|k| q[k][lane]);
    let turned =
        [-x * gx - y * gy - z * gz, w * gx + y * gz - z * gy, w * gy + z * gx - x * gz, w * gz + x * gy - y * gx];
    rows.iter_mut().zip(turned).for_each(|(row, x)| row[lane] = x);
}

impl BlockSweep {
    #[expect(clippy::too_many_arguments, reason = "the parts of a pull, named at its only caller")]
    fn pull(
        &mut self,
        a: &Shared,
        slot: &TapeEntry,
        statistics: &[f64],
        moved: u64,
        first: usize,
        up: &Cotangents<'_>,
        options: SweepOptions,
    ) {
        let (p, n) = (&a.layout, (a.n_env - first).min(BLOCK));
        let (z, seeds) = self.arguments.split_at_mut(p.n_argument());
        if a.readings.is_some() {
            copy(&mut z[..p.n_kept()], &slot.arguments, n);
        }
        z[p.statistics.clone()].iter_mut().zip(statistics).for_each(|(row, x)| *row = [*x as f32; BLOCK]);
        copy(&mut seeds[..p.n_carried()], &self.carried, n);
        spread(up.observation, first, &mut seeds[p.observation.clone()]);
        spread(up.central, first, &mut seeds[p.central.clone()]);
        spread(up.reward, first, &mut seeds[p.reward..p.reward + 1]);
        spread(up.loss, first, &mut seeds[p.loss..p.loss + 1]);
        for lane in lanes_of(moved) {
            seeds[..p.n_carried()].iter_mut().for_each(|row| row[lane] = 0.0);
        }
        // with a restart in the same step, what it shows is of the next episode
        let adds = a.mode != Autoreset::SameStep;
        for lane in lanes_of(slot.ended) {
            put(up.final_carried, first + lane, lane, &mut seeds[..p.n_carried()], false);
            put(up.final_observation, first + lane, lane, &mut seeds[p.observation.clone()], adds);
            put(up.final_central, first + lane, lane, &mut seeds[p.central.clone()], adds);
        }
        self.pull_readings(a, slot, n);
        let seeds = &mut self.arguments[p.n_argument()..];
        let live = slot.running;
        for lane in lanes_of(!live).take_while(|lane| *lane < n) {
            seeds.iter_mut().for_each(|row| row[lane] = 0.0);
        }
        let arrays = &mut [Rows::Read(&slot.arguments), Rows::Read(&self.arguments), Rows::Write(&mut self.results)];
        assert!(a.in_place().run(&mut self.work, arrays, n).is_ok(), "rows of an adjoint");
        self.contain(live, n);
        for (row, result) in self.carried.iter_mut().zip(&self.results) {
            for (x, y) in row[..n].iter_mut().zip(result) {
                *x = options.decay * y;
            }
        }
        copy(&mut self.action, &self.results[p.action.clone()], n);
        let from = p.action.end;
        for (sum, part) in self.parameters.iter_mut().zip(&self.results[from.min(self.results.len())..]) {
            sum[..n].iter_mut().zip(part).for_each(|(x, y)| *x += y);
        }
        if options.clip.is_finite() {
            self.clip(options.clip, n);
        }
    }

    /// Cotangents of readings into those of the poses that they were read in.
    fn pull_readings(&mut self, a: &Shared, slot: &TapeEntry, n: usize) {
        let (Some(own), Some(workspace)) = (&a.readings, &mut self.reading_workspace) else { return };
        own.program.evaluate_lanes(n, workspace, &self.arguments, &mut self.readings);
        let p = &a.layout;
        let (slopes, attitudes) = slot.slopes.split_at(SLOPE * own.sloped.len());
        let poses = &mut self.arguments[p.n_argument()..][p.poses.clone()];
        poses.iter_mut().for_each(|row| *row = [0.0; BLOCK]);
        for (sloped, slope) in own.sloped.iter().zip(slopes.chunks_exact(SLOPE)) {
            let (up, pose) = (&self.readings[sloped.reading], &mut poses[sloped.body * POSE..][..SLOPE]);
            for (row, by) in pose.iter_mut().zip(slope) {
                row[..n].iter_mut().zip(up).zip(by).for_each(|((sum, up), by)| *sum += up * by);
            }
        }
        for (pose, attitude) in poses.chunks_exact_mut(POSE).zip(attitudes.chunks_exact(4)) {
            (0..n).for_each(|lane| turn(&mut pose[3..], attitude, lane));
        }
    }

    /// Zeros where a gradient is not finite, and in lanes that do not count.
    fn contain(&mut self, live: u64, n: usize) {
        // 0 where all is finite, else NaN
        let mut sound = [0.0; BLOCK];
        for row in &self.results {
            sound[..n].iter_mut().zip(row).for_each(|(sum, x)| *sum += 0.0 * x);
        }
        for (lane, sum) in sound[..n].iter().enumerate() {
            let counts = (live >> lane) & 1 == 1;
            if !counts || sum.is_nan() {
                self.results.iter_mut().for_each(|row| row[lane] = 0.0);
                self.dropped += usize::from(counts);
            }
        }
    }

    fn clip(&mut self, most: f32, n: usize) {
        for lane in 0..n {
            let norm = self.carried.iter().map(|row| row[lane] * row[lane]).sum::<f32>().sqrt();
            if norm > most {
                let factor = most / norm;
                self.carried.iter_mut().for_each(|row| row[lane] *= factor);
            }
        }
    }
}
