//! Values of actions from the outputs of a network: of single numbers or quantiles, whole or parted into a state's and what an action
//! adds to it.

use super::DqnConfig;
use base::error::{Error, Result};
use tasks::{Space, Spec};

/// How a network's outputs make values: `branches` numbers of an action with `levels` values each.
#[derive(Debug, Clone, Copy)]
pub(super) struct Values {
    pub branches: usize,
    pub levels: usize,
    pub quantiles: usize,
    pub duelling: bool,
}

impl Values {
    pub fn of(spec: &Spec, config: &DqnConfig) -> Result<Self> {
        let (branches, levels) = match spec.action {
            Space::Discrete { n } => (1, n),
            Space::MultiDiscrete { n, levels } => (n, levels),
            Space::Box { .. } => {
                let remedy = "Set env.actions to discrete or multi_discrete, or learn with sac or td3.";
                return Err(Error::value("actions", "continuous", "whole numbers for this algorithm", remedy));
            }
        };
        Ok(Self { branches, levels, quantiles: config.quantiles, duelling: config.duelling })
    }

    /// Numbers of an action's values.
    pub fn n_action(&self) -> usize {
        self.branches * self.levels
    }

    /// Outputs of the network: `[branch, level, quantile]`, then `[quantile]` of the state.
    pub fn n_output(&self) -> usize {
        (self.n_action() + usize::from(self.duelling)) * self.quantiles
    }

    /// Outputs, with their weights, whose sum is quantile `q` of the value of `level` in `branch`.
    pub fn parts(&self, branch: usize, level: usize, q: usize) -> impl Iterator<Item = (usize, f32)> {
        let own = *self;
        let at = move |level: usize| (branch * own.levels + level) * own.quantiles + q;
        let mean = if own.duelling { 1.0 / own.levels as f32 } else { 0.0 };
        let others = (0..own.levels).filter(move |_| own.duelling).map(move |level| (at(level), -mean));
        let state = own.duelling.then_some((own.n_action() * own.quantiles + q, 1.0));
        [(at(level), 1.0)].into_iter().chain(others).chain(state)
    }

    pub fn quantile(&self, output: &[f32], branch: usize, level: usize, q: usize) -> f32 {
        self.parts(branch, level, q).map(|(k, w)| w * output[k]).sum()
    }

    /// The mean over quantiles.
    pub fn value(&self, output: &[f32], branch: usize, level: usize) -> f32 {
        let all: f32 = (0..self.quantiles).map(|q| self.quantile(output, branch, level, q)).sum();
        all / self.quantiles as f32
    }

    /// The level of the greatest value, the first of several.
    pub fn best(&self, output: &[f32], branch: usize) -> usize {
        let mut best = (0, f32::NEG_INFINITY);
        for level in 0..self.levels {
            // what the state adds is the same for all
            let own = &output[(branch * self.levels + level) * self.quantiles..][..self.quantiles];
            let sum: f32 = own.iter().sum();
            if sum > best.1 {
                best = (level, sum);
            }
        }
        best.0
    }

    /// Adds `up` · ∂(quantile `q` of `level` in `branch`)/∂output.
    pub fn pull(&self, (branch, level, q): (usize, usize, usize), up: f32, grad_output: &mut [f32]) {
        self.parts(branch, level, q).for_each(|(k, w)| grad_output[k] += up * w);
    }
}
