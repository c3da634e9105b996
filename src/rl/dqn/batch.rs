//! The networks' shapes, and the blocks of a batch with all that one thread needs to learn from each.

use super::mixing::Mixing;
use super::values::Values;
use super::{DqnConfig, ValueMixer};
use crate::experience::ReplayBlock;
use crate::nn::{Activation, Memory, Mlp, Network, PerAgent, Scratch};
use crate::policy::{ROWS, network};
use crate::replay::Widths;
use base::error::Result;
use std::sync::Arc;
use tasks::Spec;

/// Shapes of the networks.
pub(super) struct Shapes {
    pub values: Values,
    /// Of all agents, row by row.
    pub network: Arc<dyn Network>,
    /// That of one set of parameters.
    pub of_set: Arc<dyn Network>,
    /// Numbers of the action of each agent of a row; those behind them move nothing.
    pub branches: Vec<usize>,
    pub mixing: Option<Mixing>,
    pub agents: usize,
    pub widths: Widths,
    pub batch: usize,
}

/// A block of the batch and all that one thread needs to learn from it.
pub(super) struct Work {
    pub block: ReplayBlock,
    /// Of the learnt network and of its target.
    pub memory: [Memory; 2],
    pub scratch: Scratch,
    pub of_mixer: Option<(Memory, Scratch)>,
    /// Target quantiles `[rows, agents, quantiles]`, or one value of the team.
    pub target: Vec<f32>,
    /// The best level of every number of every agent's next action.
    pub best: Vec<usize>,
    pub grad_output: Vec<f32>,
    /// Each agent's value and its slope; what the mixer's network is to learn.
    pub q: Vec<f32>,
    pub grad_q: Vec<f32>,
    pub grad_weights: Vec<f32>,
    pub gradient: Vec<f32>,
    pub mixer_gradient: Vec<f32>,
    /// Σ of losses and of values.
    pub sums: [f64; 2],
}

impl Shapes {
    pub fn new(spec: &Spec, config: &DqnConfig) -> Result<Self> {
        let (values, team) = (Values::of(spec, config)?, config.mixer != ValueMixer::None);
        let widths = Widths::of(spec, team);
        let agents = if team { widths.n_agent } else { 1 };
        let n_state = if widths.n_state > 0 { widths.n_state } else { widths.seen() };
        let of_set = network(spec, &config.network, values.n_output(), Activation::Identity)?;
        Ok(Self {
            network: PerAgent::of_team(&of_set, agents, config.separate_values)?,
            of_set,
            branches: (0..agents).map(|agent| spec.n_action_of(agent)).collect(),
            mixing: Mixing::new(config.mixer, agents, n_state)?,
            batch: config.batch,
            values,
            agents,
            widths,
        })
    }

    pub fn mixer(&self) -> Option<&Mlp> {
        self.mixing.as_ref().and_then(|mixing| mixing.weights.as_ref())
    }

    pub fn work(&self, team: bool) -> Vec<Work> {
        let n_weights = self.mixer().map_or(0, Mlp::n_output);
        let work = |block: ReplayBlock| {
            let rows = block.rows * self.agents;
            Work {
                memory: [self.network.memory(rows), self.network.memory(rows)],
                scratch: self.network.scratch(rows),
                of_mixer: self.mixer().map(|mlp| (mlp.memory(block.rows), mlp.scratch(block.rows))),
                target: vec![0.0; rows * self.values.quantiles],
                best: vec![0; rows * self.values.branches],
                grad_output: vec![0.0; rows * self.values.n_output()],
                q: vec![0.0; rows],
                grad_q: vec![0.0; self.agents],
                grad_weights: vec![0.0; block.rows * n_weights],
                gradient: vec![0.0; self.network.n_parameter()],
                mixer_gradient: vec![0.0; self.mixer().map_or(0, Mlp::n_parameter)],
                sums: [0.0; 2],
                block,
            }
        };
        ReplayBlock::cut(self.widths, self.batch, team).into_iter().map(work).collect()
    }

    /// Bytes of the work on a batch.
    pub fn bytes(&self) -> u128 {
        let row = self.agents * (4 * self.network.n_activation() + 3 * self.network.n_input())
            + self.mixer().map_or(0, |mlp| 3 * mlp.n_activation());
        let networks = self.network.n_parameter() + self.mixer().map_or(0, Mlp::n_parameter);
        4 * (self.batch as u128 * row as u128 + self.batch.div_ceil(ROWS) as u128 * networks as u128)
    }

    /// What a mixer's network sees.
    pub fn state<'a>(&self, state: &'a [f32], observation: &'a [f32]) -> &'a [f32] {
        if self.widths.n_state > 0 { state } else { observation }
    }

    /// The value of what an agent did, the mean over the numbers of its action.
    pub fn of_chosen(&self, output: &[f32], action: &[f32]) -> f32 {
        let of = |(branch, a): (usize, &f32)| self.values.value(output, branch, self.level(*a));
        action.iter().enumerate().map(of).sum::<f32>() / action.len() as f32
    }

    /// Adds `up` · ∂(that value)/∂output.
    pub fn pull_chosen(&self, action: &[f32], up: f32, grad_output: &mut [f32]) {
        let share = up / (action.len() * self.values.quantiles) as f32;
        for (branch, a) in action.iter().enumerate() {
            (0..self.values.quantiles).for_each(|q| self.values.pull((branch, self.level(*a), q), share, grad_output));
        }
    }

    pub fn level(&self, a: f32) -> usize {
        (a.max(0.0).round() as usize).min(self.values.levels - 1)
    }
}
