//! Gradients through steps of many environments: a tape of what was stepped, its reverse sweep, and Jacobians.
//!
//! The tape keeps states and actions, not operations: a step's inside is recomputed by its adjoint program, as in
//! [`Rollout`](crate::autodiff::Rollout). That takes 4 (n + m) bytes per environment and step. A sweep is pulled step by
//! step, backwards, so that a policy between steps can turn the gradient of its action into one of its observation.
//!
//! Gradients are cut where an episode ends: a restart does not depend on what was before. What an earlier or later end
//! does to the return, no gradient sees.

use super::Env;
use super::block::{Columns, EnvBlock, book, columns};
use super::core::lanes_of;
use super::transition::{Places, Setting};
use crate::autodiff::Program;
use crate::autodiff::program::{BLOCK, BlockWorkspace};
use crate::error::{Error, Result};
use crate::parallel::Threads;
use crate::tasks::config::{ActionSpace, Autoreset};
use nalgebra::DMatrix;
use std::ops::Range;

/// One block before one step, with what happened in it.
#[derive(Debug, Clone)]
pub(crate) struct Slot {
    arguments: Columns,
    running: u64,
    ended: u64,
}

impl Slot {
    fn copy(&mut self, to: &Range<usize>, rows: &[[f32; BLOCK]]) {
        self.arguments[to.clone()].copy_from_slice(&rows[..to.len()]);
    }

    /// Before the step.
    pub(crate) fn open(&mut self, p: &Places, block: &EnvBlock, running: u64) {
        self.running = running;
        self.copy(&p.state, &block.plant.rows);
        self.copy(&p.memo, &block.memo);
        self.copy(&p.line, &block.line);
        self.copy(&p.history, &block.history);
        self.copy(&p.theta, &block.theta);
        for (at, k) in p.time.clone().zip([book::STEP, book::OFFSET, book::DELAY]) {
            self.arguments[at] = block.book[k];
        }
        self.copy(&p.goal, &block.goal);
        self.copy(&p.air, &block.air);
    }

    /// Actions as they came, and the noise of the observation behind the step.
    pub(crate) fn close(&mut self, p: &Places, action: &[[f32; BLOCK]], noise: &[[f32; BLOCK]], ended: u64) {
        self.ended = ended;
        self.copy(&p.action, action);
        self.copy(&p.noise, noise);
    }
}

/// The slots of one block.
#[derive(Debug, Clone)]
pub(crate) struct BlockTape {
    pub slots: Vec<Slot>,
}

/// What [`Env::step_recorded`] remembers of up to `horizon` steps.
#[derive(Debug, Clone)]
pub struct Tape {
    pub(crate) blocks: Vec<BlockTape>,
    pub(crate) places: Places,
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
        self.blocks.first().map_or(0, |b| b.slots.len())
    }
}

/// The adjoint of one step of a task. It holds for the normaliser's statistics at its making.
#[derive(Debug, Clone)]
pub struct Adjoint {
    places: Places,
    program: Program,
    parameters: bool,
    mode: Autoreset,
    threads: Threads,
    n_env: usize,
}

/// Cotangents of what one step wrote; an empty slice stands for zeros.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cotangents<'a> {
    /// `[E, A, observation]`. Where an episode ended and restarted in the step it is ignored.
    pub observation: &'a [f32],
    /// `[E, A, observation]`, used where an episode ended and restarted in the step.
    pub final_observation: &'a [f32],
    /// `[E]`, of the reward of the team.
    pub reward: &'a [f32],
    /// `[E]`, of the info `loss`.
    pub loss: &'a [f32],
}

/// How cotangents travel from step to step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepOptions {
    /// Factor per step on what is carried; 1 is the exact gradient.
    pub decay: f32,
    /// Largest norm of what is carried, per environment; infinite for none.
    pub clip: f32,
}

impl Default for SweepOptions {
    /// Exact.
    fn default() -> Self {
        Self { decay: 1.0, clip: f32::INFINITY }
    }
}

/// A reverse sweep over a tape.
#[derive(Debug, Clone)]
pub struct Sweep<'a> {
    adjoint: &'a Adjoint,
    options: SweepOptions,
    blocks: Vec<BlockSweep>,
}

#[derive(Debug, Clone)]
struct BlockSweep {
    carried: Columns,
    action: Columns,
    theta: Columns,
    arguments: Columns,
    results: Columns,
    workspace: BlockWorkspace,
    dropped: usize,
}

impl Env {
    /// The adjoint of a step, recorded once and compiled: milliseconds for a vehicle, up to seconds for a team. With
    /// `parameters`, sweeps also give gradients with respect to the numbers that differ between environments.
    ///
    /// # Errors
    /// [`Error::Value`] for discrete actions; [`Error::Limit`] if the recording is too large.
    pub fn adjoint(&self, parameters: bool) -> Result<Adjoint> {
        if self.spec.config.actions != ActionSpace::Continuous {
            let remedy = "Whole numbers have no gradient: leave `actions` out.";
            return Err(Error::value("actions", "discrete", "continuous for gradients", remedy));
        }
        let places = Places::of(&self.core);
        let recording = self.core.engine.record(&Setting { core: &self.core, places: &places });
        let wanted = if parameters { places.theta.end } else { places.action.end };
        Ok(Adjoint {
            program: Program::compile(&recording.adjoint(0..wanted))?,
            parameters,
            mode: self.core.mode,
            threads: self.threads.clone(),
            n_env: self.spec.n_env,
            places,
        })
    }

    /// Memory for `horizon` recorded steps.
    pub fn tape(&self, horizon: usize) -> Tape {
        let places = Places::of(&self.core);
        let slot = Slot { arguments: columns(places.n_argument()), running: 0, ended: 0 };
        let block = BlockTape { slots: vec![slot; horizon] };
        Tape { blocks: vec![block; self.blocks.len()], places, n_step: 0 }
    }

    /// As [`Env::step`], remembered by the tape.
    ///
    /// # Errors
    /// As [`Env::step`]; [`Error::Limit`] if the tape is full or of another environment.
    pub fn step_recorded(&mut self, actions: &[f32], out: &mut super::StepOut<'_>, tape: &mut Tape) -> Result<()> {
        let fits = tape.blocks.len() == self.blocks.len() && tape.places == Places::of(&self.core);
        if !fits || tape.n_step >= tape.horizon() {
            let remedy = "Clear it, or make a longer one with env.tape(horizon).";
            return Err(Error::limit("steps of the tape", tape.n_step + 1, tape.horizon(), remedy));
        }
        self.step_into(actions, out, Some(tape))?;
        tape.n_step += 1;
        Ok(())
    }

    /// Exact derivatives of one step of one environment as it stands, by duals in `f64`.
    ///
    /// # Errors
    /// As [`Env::adjoint`] and [`Env::state`]; [`Error::Value`] for an action of the wrong length.
    pub fn jacobian(&self, environment: usize, action: &[f64]) -> Result<Jacobian> {
        self.check_environment(environment)?;
        let places = Places::of(&self.core);
        let wanted = places.action.len();
        if action.len() != wanted || self.spec.config.actions != ActionSpace::Continuous {
            let remedy = "Give the actions of all agents, continuous.";
            return Err(Error::value("length of action", action.len(), wanted.to_string(), remedy));
        }
        let (block, lane) = (&self.blocks[environment / BLOCK], environment % BLOCK);
        let mut slot = Slot { arguments: columns(places.n_argument()), running: 0, ended: 0 };
        slot.open(&places, block, u64::MAX);
        let mut z: Vec<f64> = slot.arguments.iter().map(|row| f64::from(row[lane])).collect();
        z[places.action.clone()].copy_from_slice(action);
        let n = places.theta.end;
        let (value, matrix) = self.core.engine.differentiate(&Setting { core: &self.core, places: &places }, &z, n);
        Ok(Jacobian { arguments: z, value, matrix, places })
    }

    /// The results of one step in `f64` for arguments as in [`Jacobian::arguments`].
    ///
    /// # Errors
    /// [`Error::Value`] for another number of arguments.
    pub fn evaluate(&self, arguments: &[f64]) -> Result<Vec<f64>> {
        let places = Places::of(&self.core);
        if arguments.len() != places.n_argument() {
            let (got, wanted) = (arguments.len(), places.n_argument().to_string());
            return Err(Error::value("length of arguments", got, wanted, "Take them from Env::jacobian."));
        }
        let setting = Setting { core: &self.core, places: &places };
        Ok(self.core.engine.differentiate(&setting, arguments, 0).0)
    }
}

/// ∂(next, observation, reward, loss)/∂(carried, action, parameters) of one step.
#[derive(Debug, Clone, PartialEq)]
pub struct Jacobian {
    /// Carried numbers, action, parameters, then what no derivative is taken of.
    pub arguments: Vec<f64>,
    /// The results themselves.
    pub value: Vec<f64>,
    /// Rows: carried numbers, observation, reward, loss. Columns: carried numbers, action, parameters.
    pub matrix: DMatrix<f64>,
    places: Places,
}

impl Jacobian {
    fn part(&self, rows: Range<usize>, columns: &Range<usize>) -> DMatrix<f64> {
        self.matrix.view((rows.start, columns.start), (rows.len(), columns.len())).into_owned()
    }

    /// A of x⁺ = A x + B a: of the physical state alone.
    pub fn state(&self) -> DMatrix<f64> {
        self.part(self.places.state.clone(), &self.places.state)
    }

    /// B of x⁺ = A x + B a.
    pub fn action(&self) -> DMatrix<f64> {
        self.part(self.places.state.clone(), &self.places.action)
    }

    /// ∂observation/∂state.
    pub fn observation_state(&self) -> DMatrix<f64> {
        self.part(self.places.observation.clone(), &self.places.state)
    }

    /// ∂reward/∂state, one row.
    pub fn reward_state(&self) -> DMatrix<f64> {
        self.part(self.places.reward..self.places.reward + 1, &self.places.state)
    }

    /// ∂reward/∂action, one row.
    pub fn reward_action(&self) -> DMatrix<f64> {
        self.part(self.places.reward..self.places.reward + 1, &self.places.action)
    }
}

impl Adjoint {
    /// Instructions of the program.
    pub fn n_instruction(&self) -> usize {
        self.program.len()
    }

    /// The program, for certificates.
    pub fn program(&self) -> &Program {
        &self.program
    }

    /// Numbers that go from step to step: physics, memo, delay line, history.
    pub fn n_carried(&self) -> usize {
        self.places.n_carried()
    }

    /// A sweep that begins behind the last step of a tape, with nothing carried.
    pub fn sweep(&self, options: SweepOptions) -> Sweep<'_> {
        let p = &self.places;
        let block = BlockSweep {
            carried: columns(p.n_carried()),
            action: columns(p.action.len()),
            theta: columns(if self.parameters { p.theta.len() } else { 0 }),
            arguments: columns(self.program.n_input()),
            results: columns(self.program.n_output()),
            workspace: self.program.block_workspace(),
            dropped: 0,
        };
        Sweep { adjoint: self, options, blocks: vec![block; self.n_env.div_ceil(BLOCK)] }
    }
}

impl Sweep<'_> {
    /// Begins again behind the last step, with nothing carried; keeps the memory.
    pub fn restart(&mut self) {
        for block in &mut self.blocks {
            block.carried.iter_mut().chain(&mut block.theta).for_each(|row| *row = [0.0; BLOCK]);
            block.dropped = 0;
        }
    }

    /// Pulls cotangents back through step `t` of a tape: `action` (`[E, A, command]`) gets those of its actions. Steps are
    /// pulled from the last to the first. An environment whose gradient is not finite gets zeros and is counted.
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length; [`Error::Limit`] if the tape has no such step.
    pub fn pull(&mut self, tape: &Tape, t: usize, up: &Cotangents<'_>, action: &mut [f32]) -> Result<()> {
        let a = self.adjoint;
        if t >= tape.n_step || tape.blocks.len() != self.blocks.len() {
            return Err(Error::limit("step of the tape", t, tape.n_step.saturating_sub(1), "Steps count from 0."));
        }
        let (n_seen, n_act) = (a.places.observation.len(), a.places.action.len());
        for (what, got, each, optional) in [
            ("observation", up.observation.len(), n_seen, true),
            ("final_observation", up.final_observation.len(), n_seen, true),
            ("reward", up.reward.len(), 1, true),
            ("loss", up.loss.len(), 1, true),
            ("action", action.len(), n_act, false),
        ] {
            if got != a.n_env * each && !(optional && got == 0) {
                let wanted = (a.n_env * each).to_string();
                return Err(Error::value(format!("length of {what}"), got, wanted, "Rows are environments."));
            }
        }
        let options = self.options;
        a.threads.for_each(&mut self.blocks, |b, block| {
            block.pull(a, &tape.blocks[b].slots[t], b * BLOCK, up, options);
        });
        for (b, block) in self.blocks.iter().enumerate() {
            let rows = &mut action[b * BLOCK * n_act..];
            for (lane, row) in rows.chunks_exact_mut(n_act).take(BLOCK).enumerate() {
                row.iter_mut().zip(&block.action).for_each(|(x, column)| *x = column[lane]);
            }
        }
        Ok(())
    }

    /// Cotangents of what the environments carried into the last step pulled, `[E, carried]`: physics first.
    pub fn carried(&self) -> Vec<f32> {
        self.rows(|block| &block.carried)
    }

    /// Sums over all steps pulled, `[E, parameter]`; empty unless the adjoint was made with parameters.
    pub fn parameters(&self) -> Vec<f32> {
        self.rows(|block| &block.theta)
    }

    /// Adds to what is carried, `[E, carried]`: the gradient of a cost on the last state.
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length.
    pub fn add_carried(&mut self, cotangents: &[f32]) -> Result<()> {
        let n = self.adjoint.n_carried();
        if cotangents.len() != n * self.adjoint.n_env {
            let wanted = (n * self.adjoint.n_env).to_string();
            return Err(Error::value("length of carried", cotangents.len(), wanted, "Rows are environments."));
        }
        for (i, row) in cotangents.chunks_exact(n).enumerate() {
            let block = &mut self.blocks[i / BLOCK];
            block.carried.iter_mut().zip(row).for_each(|(column, x)| column[i % BLOCK] += x);
        }
        Ok(())
    }

    /// Gradients that were not finite and became zero, environments times steps.
    pub fn dropped(&self) -> usize {
        self.blocks.iter().map(|b| b.dropped).sum()
    }

    fn rows(&self, of: impl Fn(&BlockSweep) -> &Columns) -> Vec<f32> {
        let row = |i: usize| of(&self.blocks[i / BLOCK]).iter().map(move |column| column[i % BLOCK]);
        (0..self.adjoint.n_env).flat_map(row).collect()
    }
}

/// Row-major rows of environments from `first` on into columns; zeros where there are none.
fn spread(rows: &[f32], n: usize, first: usize, columns: &mut [[f32; BLOCK]]) {
    if rows.is_empty() {
        columns.iter_mut().for_each(|column| *column = [0.0; BLOCK]);
        return;
    }
    for (lane, row) in rows[first * n..].chunks_exact(n).take(BLOCK).enumerate() {
        columns.iter_mut().zip(row).for_each(|(column, x)| column[lane] = *x);
    }
}

impl BlockSweep {
    fn pull(&mut self, a: &Adjoint, slot: &Slot, first: usize, up: &Cotangents<'_>, options: SweepOptions) {
        let p = &a.places;
        let (z, seeds) = self.arguments.split_at_mut(p.n_argument());
        z.copy_from_slice(&slot.arguments);
        seeds[..p.n_carried()].copy_from_slice(&self.carried);
        let n_seen = p.observation.len();
        spread(up.observation, n_seen, first, &mut seeds[p.observation.clone()]);
        spread(up.reward, 1, first, &mut seeds[p.reward..p.reward + 1]);
        spread(up.loss, 1, first, &mut seeds[p.loss..p.loss + 1]);
        let live = slot.running;
        for lane in lanes_of(slot.ended) {
            seeds[..p.n_carried()].iter_mut().for_each(|row| row[lane] = 0.0);
            if a.mode == Autoreset::SameStep {
                for (k, row) in seeds[p.observation.clone()].iter_mut().enumerate() {
                    row[lane] = up.final_observation.get((first + lane) * n_seen + k).copied().unwrap_or(0.0);
                }
            }
        }
        for lane in lanes_of(!live) {
            seeds.iter_mut().for_each(|row| row[lane] = 0.0);
        }
        a.program.evaluate_block(&mut self.workspace, &self.arguments, &mut self.results);
        self.contain(live, first, a.n_env);
        for (row, result) in self.carried.iter_mut().zip(&self.results) {
            for (x, y) in row.iter_mut().zip(result) {
                *x = options.decay * y;
            }
        }
        self.action.copy_from_slice(&self.results[p.action.clone()]);
        let from = p.action.end;
        for (sum, part) in self.theta.iter_mut().zip(&self.results[from.min(self.results.len())..]) {
            sum.iter_mut().zip(part).for_each(|(x, y)| *x += y);
        }
        if options.clip.is_finite() {
            self.clip(options.clip);
        }
    }

    /// Zeros where a gradient is not finite, and in lanes that do not count.
    fn contain(&mut self, live: u64, first: usize, n_env: usize) {
        for lane in 0..BLOCK {
            let counts = (live >> lane) & 1 == 1 && first + lane < n_env;
            let finite = self.results.iter().fold(true, |all, row| all & row[lane].is_finite());
            if !(counts && finite) {
                self.results.iter_mut().for_each(|row| row[lane] = 0.0);
                self.dropped += usize::from(counts);
            }
        }
    }

    fn clip(&mut self, most: f32) {
        for lane in 0..BLOCK {
            let norm = self.carried.iter().map(|row| row[lane] * row[lane]).sum::<f32>().sqrt();
            if norm > most {
                let factor = most / norm;
                self.carried.iter_mut().for_each(|row| row[lane] *= factor);
            }
        }
    }
}
