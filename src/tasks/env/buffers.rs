//! Where a step writes: arrays of the caller, row-major, one row per environment.

use super::block::EnvBlock;
use super::gradient::BlockTape;
use super::spec::Spec;
use autodiff::program::BLOCK;
use base::error::{Error, Result};
use base::parallel::Divide;

/// Arrays that [`Env::step`](super::Env::step) and [`Env::reset`](super::Env::reset) write, E environments and A agents.
///
/// Optional arrays may be empty: they are then left out. `final_*` are written in rows whose episode ended in the step;
/// other rows stay as they were.
#[derive(Debug)]
pub struct StepOut<'a> {
    /// `[E, A, observation]`, behind all transforms.
    pub observation: &'a mut [f32],
    /// `[E, A]`; all agents of an environment share one.
    pub reward: &'a mut [f32],
    /// `[E]`, 1 where the task ended the episode. Wins over `truncated` for bootstrapping.
    pub terminated: &'a mut [u8],
    /// `[E]`, 1 where its time was over.
    pub truncated: &'a mut [u8],
    /// `[E, central]`, optional: the state for critics.
    pub central: &'a mut [f32],
    /// `[E, privileged]`, optional: the numbers that differ between environments.
    pub privileged: &'a mut [f32],
    /// `[E, A, observation]`, optional.
    pub final_observation: &'a mut [f32],
    /// `[E, central]`, optional.
    pub final_central: &'a mut [f32],
    /// `[E, info]`, optional; see [`Spec::info`].
    pub info: &'a mut [f32],
}

/// Arrays for one [`Env`](super::Env), owned.
#[derive(Debug, Clone, PartialEq)]
pub struct Buffers {
    /// See [`StepOut::observation`].
    pub observation: Vec<f32>,
    /// See [`StepOut::reward`].
    pub reward: Vec<f32>,
    /// See [`StepOut::terminated`].
    pub terminated: Vec<u8>,
    /// See [`StepOut::truncated`].
    pub truncated: Vec<u8>,
    /// See [`StepOut::central`].
    pub central: Vec<f32>,
    /// See [`StepOut::privileged`].
    pub privileged: Vec<f32>,
    /// See [`StepOut::final_observation`].
    pub final_observation: Vec<f32>,
    /// See [`StepOut::final_central`].
    pub final_central: Vec<f32>,
    /// See [`StepOut::info`].
    pub info: Vec<f32>,
}

impl Buffers {
    /// All of them, of the sizes of `spec`, zeros.
    pub fn new(spec: &Spec) -> Self {
        let (e, a) = (spec.n_env, spec.n_agent);
        Self {
            observation: vec![0.0; e * a * spec.n_observation],
            reward: vec![0.0; e * a],
            terminated: vec![0; e],
            truncated: vec![0; e],
            central: vec![0.0; e * spec.n_central],
            privileged: vec![0.0; e * spec.privileged.len()],
            final_observation: vec![0.0; e * a * spec.n_observation],
            final_central: vec![0.0; e * spec.n_central],
            info: vec![0.0; e * spec.info.len()],
        }
    }

    /// To write.
    pub fn out(&mut self) -> StepOut<'_> {
        StepOut {
            observation: &mut self.observation,
            reward: &mut self.reward,
            terminated: &mut self.terminated,
            truncated: &mut self.truncated,
            central: &mut self.central,
            privileged: &mut self.privileged,
            final_observation: &mut self.final_observation,
            final_central: &mut self.final_central,
            info: &mut self.info,
        }
    }
}

impl StepOut<'_> {
    /// The same arrays, lent on.
    pub(crate) fn reborrow(&mut self) -> StepOut<'_> {
        StepOut {
            observation: self.observation,
            reward: self.reward,
            terminated: self.terminated,
            truncated: self.truncated,
            central: self.central,
            privileged: self.privileged,
            final_observation: self.final_observation,
            final_central: self.final_central,
            info: self.info,
        }
    }

    /// Checks every length.
    pub(crate) fn check(&self, spec: &Spec) -> Result<()> {
        let (e, a) = (spec.n_env, spec.n_agent);
        let rows: [(&str, usize, usize, bool); 9] = [
            ("observation", self.observation.len(), e * a * spec.n_observation, false),
            ("reward", self.reward.len(), e * a, false),
            ("terminated", self.terminated.len(), e, false),
            ("truncated", self.truncated.len(), e, false),
            ("central", self.central.len(), e * spec.n_central, true),
            ("privileged", self.privileged.len(), e * spec.privileged.len(), true),
            ("final_observation", self.final_observation.len(), e * a * spec.n_observation, true),
            ("final_central", self.final_central.len(), e * spec.n_central, true),
            ("info", self.info.len(), e * spec.info.len(), true),
        ];
        for (what, got, wanted, optional) in rows {
            if got != wanted && !(optional && got == 0) {
                let remedy = "Make the arrays with Buffers::new(env.spec()).";
                return Err(Error::value(format!("length of {what}"), got, wanted.to_string(), remedy));
            }
        }
        Ok(())
    }
}

/// Numbers per environment of all arrays, in their order.
type Widths = [usize; 9];

/// Takes the first `n` off.
fn front<'a, T>(rows: &mut &'a mut [T], n: usize) -> &'a mut [T] {
    let (front, rest) = std::mem::take(rows).split_at_mut(n);
    *rows = rest;
    front
}

impl<'a> StepOut<'a> {
    fn widths(&self, n_env: usize) -> Widths {
        let (observation, reward) = (self.observation.len(), self.reward.len());
        let (terminated, truncated) = (self.terminated.len(), self.truncated.len());
        let (central, privileged) = (self.central.len(), self.privileged.len());
        let (end, central_end) = (self.final_observation.len(), self.final_central.len());
        let all = [observation, reward, terminated, truncated, central, privileged, end, central_end, self.info.len()];
        all.map(|n| n / n_env)
    }

    /// Takes the rows of the first `n` environments off.
    fn take(&mut self, n: usize, widths: &Widths) -> StepOut<'a> {
        let [observation, reward, terminated, truncated, central, privileged, end, central_end, info] = *widths;
        Self {
            observation: front(&mut self.observation, n * observation),
            reward: front(&mut self.reward, n * reward),
            terminated: front(&mut self.terminated, n * terminated),
            truncated: front(&mut self.truncated, n * truncated),
            central: front(&mut self.central, n * central),
            privileged: front(&mut self.privileged, n * privileged),
            final_observation: front(&mut self.final_observation, n * end),
            final_central: front(&mut self.final_central, n * central_end),
            info: front(&mut self.info, n * info),
        }
    }
}

/// Consecutive blocks with their rows of all arrays.
pub(crate) struct Span<'a> {
    pub blocks: &'a mut [EnvBlock],
    /// Number of the first block.
    pub first: usize,
    /// Environments in all blocks of the span.
    n_env: usize,
    /// Row-major, one row per environment; may be empty.
    pub actions: &'a [f32],
    pub out: StepOut<'a>,
    /// Of the same blocks, or empty.
    pub tape: &'a mut [BlockTape],
    widths: Widths,
    n_action: usize,
}

impl<'a> Span<'a> {
    /// Of all `n_env` environments.
    pub(crate) fn new(
        blocks: &'a mut [EnvBlock],
        n_env: usize,
        actions: &'a [f32],
        out: StepOut<'a>,
        tape: &'a mut [BlockTape],
    ) -> Self {
        let (widths, n_action) = (out.widths(n_env), actions.len() / n_env);
        Self { blocks, first: 0, n_env, actions, out, tape, widths, n_action }
    }

    /// Takes the first `n` blocks off.
    pub(crate) fn take(&mut self, n: usize) -> Span<'a> {
        let envs = (n * BLOCK).min(self.n_env);
        let (actions, rest) = self.actions.split_at(envs * self.n_action);
        let (first, n_tape) = (self.first, n.min(self.tape.len()));
        (self.actions, self.first, self.n_env) = (rest, first + n, self.n_env - envs);
        Span {
            blocks: front(&mut self.blocks, n),
            first,
            n_env: envs,
            actions,
            out: self.out.take(envs, &self.widths),
            tape: front(&mut self.tape, n_tape),
            widths: self.widths,
            n_action: self.n_action,
        }
    }
}

impl Divide for Span<'_> {
    fn count(&self) -> usize {
        self.blocks.len()
    }

    fn divide(mut self, at: usize) -> (Self, Self) {
        (self.take(at), self)
    }
}
