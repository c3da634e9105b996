//! Settings of APG.

use super::{Apg, TrainingObjective};
use crate::checks::check_counts;
use crate::learner::built_in;
use crate::nn::{AdamConfig, Layers};
use crate::policy_optimiser::check_optimiser;
use crate::schedule::Schedule;
use crate::window_run::WindowSettings;
use base::defaults::with_defaults;
use base::error::Result;
use serde::{Deserialize, Serialize};

with_defaults! {
    /// Settings; defaults fly the Hummingbird's Hover from random weights.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ApgConfig {
        /// Environments, E. 1 to 2²⁴; default 64.
        pub n_env: usize = 64,
        /// Environments of a shard: one thread steps it for a whole window. Default 32.
        pub shard: usize = 32,
        /// H, steps of a window. 1 to 65 536; default 48.
        pub horizon: usize = 48,
        /// Updates of a run. Default 800.
        pub updates: u64 = 800,
        /// Learning rate over the run. Default a cosine from 0.01 to 1e-4.
        pub learning_rate: Schedule = Schedule::cosine(0.01, 1e-4),
        /// Largest norm of the gradient. > 0; default 0.2.
        pub max_grad_norm: f64 = 0.2,
        /// Factor per step on the gradient that is carried back; 1 is exact. > 0; default 1.
        pub decay: f32 = 1.0,
        /// Largest norm, per environment, of the gradient that is carried back, where a step's cost weighs 1: what tumbles
        /// would drown all others. Infinite for none. Default infinite.
        pub adjoint_clip: f32 = f32::INFINITY,
        /// Largest norm, per environment and step, of the gradient of its actions, where a step's cost weighs 1: one that explodes
        /// would turn the update of all. Infinite for none. Default infinite.
        pub action_clip: f32 = f32::INFINITY,
        /// What is minimised. Default the task's loss.
        pub objective: TrainingObjective = TrainingObjective::Loss,
        /// Whether the last loss of an episode that the task ended goes on to the window's end. Default true.
        pub lasting: bool = true,
        /// Share of hidden tanh units beyond ±0.99 at which the run begins again at half the rate, up to six times; 1 for never.
        /// > 0; default 0.25.
        pub saturation: f64 = 0.25,
        /// The optimiser. Default β₂ = 0.99.
        pub adam: AdamConfig = AdamConfig { beta2: 0.99, ..AdamConfig::default() },
        /// The policy.
        pub network: Layers = Layers::default(),
    }
}

impl ApgConfig {
    /// Those that SHAC has too.
    pub(super) fn of_windows(&self) -> WindowSettings<'_> {
        WindowSettings {
            n_env: self.n_env,
            shard: self.shard,
            horizon: self.horizon,
            objective: self.objective,
            decay: self.decay,
            adjoint_clip: self.adjoint_clip,
            action_clip: self.action_clip,
            adam: self.adam,
            network: &self.network,
        }
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`](base::error::Error::Value) or [`Error::Limit`](base::error::Error::Limit) with the number, the rule and
    /// the remedy.
    pub fn validate(&self) -> Result<()> {
        check_counts(
            &[("n_env", self.n_env, 1 << 24), ("shard", self.shard, 1 << 24), ("horizon", self.horizon, 1 << 16)],
            "64, 32 and 48 are usual.",
        )?;
        check_optimiser(self.max_grad_norm, self.decay, [self.adjoint_clip, self.action_clip], self.saturation)?;
        self.learning_rate.validate("learning_rate")?;
        self.adam.validate()?;
        self.network.validate()
    }
}

built_in! {
    "apg": ApgConfig => Apg, squashed: true, loss: "mean cost of a step", in: "config.rs";
}
