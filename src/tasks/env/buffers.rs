//! Where a step writes: arrays of the caller, row-major, one row per environment.

use super::block::EnvBlock;
use super::gradient::BlockTape;
use super::spec::Spec;
use crate::error::{Error, Result};
use crate::parallel::Divide;

/// Arrays that [`Env::step`](super::Env::step) and [`Env::reset`](super::Env::reset) write, E environments and A agents.
///
/// Optional arrays may be empty: they are then left out. `final_*` are written in rows whose episode ended in the step;
/// other rows stay as they were.
#[derive(Debug)]
pub struct StepOut<'a> {
    /// `[E, A, observation]`.
    pub observation: &'a mut [f32],
    /// `[E, A]`; all agents of an environment share one.
    pub reward: &'a mut [f32],
    /// `[E]`, 1 where the task ended the episode. Wins over `truncated` for bootstrapping.
    pub terminated: &'a mut [u8],
    /// `[E]`, 1 where its time was over.
    pub truncated: &'a mut [u8],
    /// `[E, central]`, optional.
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
    /// All of them.
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

/// Consecutive blocks with their rows of all arrays.
pub(crate) struct Span<'a> {
    pub blocks: &'a mut [EnvBlock],
    /// Number of the first block.
    pub first: usize,
    /// Environments in all blocks of the span.
    pub n_env: usize,
    /// Environments of a block.
    pub per_block: usize,
    /// Row-major, one row per environment; may be empty.
    pub actions: &'a [f32],
    pub out: StepOut<'a>,
    /// Of the same blocks, or empty.
    pub tape: &'a mut [BlockTape],
}

fn cut<T>(rows: &mut [T], at: usize, n: usize) -> (&mut [T], &mut [T]) {
    let each = rows.len().checked_div(n).unwrap_or(0);
    rows.split_at_mut(at * each)
}

impl Divide for Span<'_> {
    fn count(&self) -> usize {
        self.blocks.len()
    }

    fn divide(self, at: usize) -> (Self, Self) {
        let n = self.n_env;
        let envs = (at * self.per_block).min(n);
        let (left, right) = self.blocks.split_at_mut(at);
        let actions = self.actions.split_at(envs * self.actions.len().checked_div(n).unwrap_or(0));
        let o = self.out;
        let observation = cut(o.observation, envs, n);
        let reward = cut(o.reward, envs, n);
        let terminated = cut(o.terminated, envs, n);
        let truncated = cut(o.truncated, envs, n);
        let central = cut(o.central, envs, n);
        let privileged = cut(o.privileged, envs, n);
        let final_observation = cut(o.final_observation, envs, n);
        let final_central = cut(o.final_central, envs, n);
        let info = cut(o.info, envs, n);
        let a = StepOut {
            observation: observation.0,
            reward: reward.0,
            terminated: terminated.0,
            truncated: truncated.0,
            central: central.0,
            privileged: privileged.0,
            final_observation: final_observation.0,
            final_central: final_central.0,
            info: info.0,
        };
        let b = StepOut {
            observation: observation.1,
            reward: reward.1,
            terminated: terminated.1,
            truncated: truncated.1,
            central: central.1,
            privileged: privileged.1,
            final_observation: final_observation.1,
            final_central: final_central.1,
            info: info.1,
        };
        let per_block = self.per_block;
        let tape = self.tape.split_at_mut(at.min(self.tape.len()));
        (
            Self { blocks: left, first: self.first, n_env: envs, per_block, actions: actions.0, out: a, tape: tape.0 },
            Self {
                blocks: right,
                first: self.first + at,
                n_env: n - envs,
                per_block,
                actions: actions.1,
                out: b,
                tape: tape.1,
            },
        )
    }
}
