//! The networks' shapes, and the blocks of a batch with all that one thread needs to learn from each.

use super::{ActorCriticConfig, Exploration, Kind};
use crate::experience::ReplayBlock;
use crate::nn::{Activation, Memory, Mlp, Network, PerAgent, Scratch};
use crate::policy::{ROWS, network};
use crate::replay::Widths;
use base::error::Result;
use std::sync::Arc;
use tasks::Spec;

/// A block of the batch and all that one thread needs to learn from it.
pub(super) struct Work {
    pub block: ReplayBlock,
    /// What critics see: `[rows, critic's inputs]`.
    pub x: Vec<f32>,
    pub actor: Memory,
    pub critic: Memory,
    pub of_actor: Scratch,
    pub of_critic: Scratch,
    /// Of all agents: what the actor gave, noise, actions, ∂/∂ both.
    pub noise: Vec<f32>,
    pub actions: Vec<f32>,
    pub grad_action: Vec<f32>,
    pub grad_output: Vec<f32>,
    /// Of every row what is added to the value behind it, and what critics are fitted to, `[rows, quantiles]`.
    pub bonus: Vec<f32>,
    pub target: Vec<f32>,
    /// What each critic said, in the mean over quantiles: `[critics, rows]`.
    pub q: Vec<f32>,
    pub grad_q: Vec<f32>,
    pub grad_x: Vec<f32>,
    /// One for each critic.
    pub gradients: Vec<Vec<f32>>,
    pub gradient: Vec<f32>,
    /// Σ of the critics' losses, of values, of ln π, of the actor's −Q, of the mean square of what tanh takes in.
    pub sums: [f64; 5],
}

/// Networks' shapes, and how many rows they learn from.
pub(super) struct Shapes {
    /// Of all agents, row by row.
    pub actor: Arc<dyn Network>,
    /// That of one set of parameters.
    pub of_set: Arc<dyn Network>,
    pub critic: Mlp,
    pub n_critic: usize,
    pub quantiles: usize,
    pub batch: usize,
    /// Numbers of what critics see before the actions.
    pub n_base: usize,
    pub agents: usize,
    /// Numbers of the action of each of them; what stands behind them in its row is 0.
    pub done: Vec<usize>,
    pub widths: Widths,
}

impl Shapes {
    pub fn new<E: Exploration>(settings: &ActorCriticConfig<E>, kind: &E::Kind, spec: &Spec) -> Result<Self> {
        let widths = Widths::of(spec, settings.central_critic);
        let agents = if settings.central_critic { widths.n_agent } else { 1 };
        let n_base = if widths.n_state > 0 { widths.n_state } else { agents * widths.n_observation };
        let of_set = network(spec, &settings.network, kind.n_output(widths.n_action), Activation::Identity)?;
        Ok(Self {
            actor: PerAgent::of_team(&of_set, agents, settings.separate_actors)?,
            of_set,
            critic: Mlp::new(
                n_base + agents * widths.n_action,
                &settings.critic,
                settings.quantiles,
                Activation::Identity,
            )?,
            n_critic: settings.critics,
            quantiles: settings.quantiles,
            batch: settings.batch,
            n_base,
            agents,
            done: (0..agents).map(|agent| spec.n_action_of(agent)).collect(),
            widths,
        })
    }

    /// Of every action of `x`, agent by agent, the numbers that its agent has.
    pub fn each<'a>(&'a self, x: &'a mut [f32]) -> impl Iterator<Item = &'a mut [f32]> {
        let own = self.done.iter().cycle();
        x.chunks_exact_mut(self.widths.n_action).zip(own).map(|(x, n)| &mut x[..*n])
    }

    /// Rows of what critics see: `base` beside `actions`.
    pub fn join(&self, base: &[f32], actions: &[f32], x: &mut [f32]) {
        let n_action = self.agents * self.widths.n_action;
        let rows = base.chunks_exact(self.n_base).zip(actions.chunks_exact(n_action));
        for (x, (base, action)) in x.chunks_exact_mut(self.n_base + n_action).zip(rows) {
            x[..self.n_base].copy_from_slice(base);
            x[self.n_base..].copy_from_slice(action);
        }
    }

    pub fn work(&self, team: bool) -> Vec<Work> {
        let work = |block: ReplayBlock| {
            let (rows, agents) = (block.rows, block.rows * self.agents);
            let n_x = self.critic.n_input();
            Work {
                x: vec![0.0; rows * n_x],
                actor: self.actor.memory(agents),
                critic: self.critic.memory(rows),
                of_actor: self.actor.scratch(agents),
                of_critic: self.critic.scratch(rows),
                noise: vec![0.0; agents * self.widths.n_action],
                actions: vec![0.0; agents * self.widths.n_action],
                grad_action: vec![0.0; agents * self.widths.n_action],
                grad_output: vec![0.0; agents * self.actor.n_output()],
                bonus: vec![0.0; rows],
                target: vec![0.0; rows * self.quantiles],
                q: vec![0.0; self.n_critic * rows],
                grad_q: vec![0.0; rows * self.quantiles],
                grad_x: vec![0.0; rows * n_x],
                gradients: vec![vec![0.0; self.critic.n_parameter()]; self.n_critic],
                gradient: vec![0.0; self.actor.n_parameter()],
                sums: [0.0; 5],
                block,
            }
        };
        ReplayBlock::cut(self.widths, self.batch, team).into_iter().map(work).collect()
    }

    /// Bytes of the work on a batch.
    pub fn bytes(&self) -> u128 {
        let row = 2 * (self.critic.n_activation() + self.critic.n_input())
            + self.agents * (2 * self.actor.n_activation() + 4 * self.actor.n_input());
        let networks = self.n_critic * self.critic.n_parameter() + self.actor.n_parameter();
        // beside a gradient per block: weights, those transposed, two moments, what follows, the whole gradient, their mean
        let copies = self.batch.div_ceil(ROWS) as u128 + 7;
        4 * (self.batch as u128 * row as u128 + copies * networks as u128)
    }
}
