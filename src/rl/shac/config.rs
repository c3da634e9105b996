//! Settings of SHAC.

use super::Shac;
use crate::checks::{check_counts, check_positive};
use crate::learner::built_in;
use crate::nn::{Activation, AdamConfig, Layers};
use crate::policy_optimiser::check_optimiser;
use crate::schedule::Schedule;
use crate::window::TrainingObjective;
use crate::window_run::WindowSettings;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

with_defaults! {
    /// Settings.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ShacConfig {
        /// Environments, E. 1 to 2²⁴; default 128.
        pub n_env: usize = 128,
        /// Environments of a shard: one thread steps it for a whole window. Default 64.
        pub shard: usize = 64,
        /// H, steps of a window. 1 to 65 536; default 32.
        pub horizon: usize = 32,
        /// Updates of a run. Default 750.
        pub updates: u64 = 750,
        /// γ, discount per step. Within [0, 1); default 0.97.
        pub discount: f64 = 0.97,
        /// λ of the critic's targets. Within [0, 1]; default 0.95.
        pub lambda: f64 = 0.95,
        /// Share of the run over which the weight w of the critic's value in the actor's cost rises from 0 to 1. Within [0, 1]; default
        /// 0.5.
        pub ramp: f64 = 0.5,
        /// Learning rate of the actor over the run. Default a cosine from 0.01 to 1e-4.
        pub learning_rate: Schedule = Schedule::cosine(0.01, 1e-4),
        /// Learning rate of the critic over the run. Default a cosine from 0.002 to 1e-4.
        pub critic_learning_rate: Schedule = Schedule::cosine(0.002, 1e-4),
        /// Largest norm of the actor's gradient. > 0; default 0.2.
        pub max_grad_norm: f64 = 0.2,
        /// Largest norm of the critic's gradient. > 0; default 1.
        pub critic_max_grad_norm: f64 = 1.0,
        /// Errors of the critic beyond it count linearly, in units of the cost of a step (Huber 1964). > 0; default 5.
        pub huber: f64 = 5.0,
        /// Whether the critic sees the numbers that differ between environments, where there are any: it is not flown. Default true.
        pub privileged_critic: bool = true,
        /// Passes of the critic over a window's experience. 1 to 1024; default 2.
        pub critic_epochs: usize = 2,
        /// Minibatches of a pass. 1 to 1024; default 4.
        pub minibatches: usize = 4,
        /// Share of the critic's old copy that stays in an update: 0.2 replaces four fifths of it. Within [0, 1]; default 0.2.
        pub polyak: f32 = 0.2,
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
        /// Share of hidden tanh units beyond ±0.99 at which the run begins again at half the rate, up to six times; 1 for never.
        /// > 0; default 0.25.
        pub saturation: f64 = 0.25,
        /// The optimiser of both. Default β₂ = 0.99.
        pub adam: AdamConfig = AdamConfig { beta2: 0.99, ..AdamConfig::default() },
        /// The policy.
        pub network: Layers = Layers::default(),
        /// The critic.
        pub critic: Layers = Layers { activation: Activation::Elu, ..Layers::default() },
    }
}

impl ShacConfig {
    /// Those that APG has too.
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
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        check_counts(
            &[
                ("n_env", self.n_env, 1 << 24),
                ("shard", self.shard, 1 << 24),
                ("horizon", self.horizon, 1 << 16),
                ("critic_epochs", self.critic_epochs, 1 << 10),
                ("minibatches", self.minibatches, 1 << 10),
            ],
            "128, 64, 32, 2 and 4 are usual.",
        )?;
        check_optimiser(self.max_grad_norm, self.decay, [self.adjoint_clip, self.action_clip], self.saturation)?;
        check_positive(&[("huber", self.huber)], "5 is usual.")?;
        check_positive(&[("critic_max_grad_norm", self.critic_max_grad_norm)], "1 is usual.")?;
        let shares = [("lambda", self.lambda), ("ramp", self.ramp), ("polyak", self.polyak.into())];
        for (what, x) in shares {
            if !(0.0..=1.0).contains(&x) {
                return Err(Error::value(what, x, "within [0, 1]", "0.95, 0.5 and 0.2 are usual."));
            }
        }
        if !(0.0..1.0).contains(&self.discount) {
            return Err(Error::value("discount", self.discount, "within [0, 1)", "0.97 looks half a second ahead."));
        }
        self.learning_rate.validate("learning_rate")?;
        self.critic_learning_rate.validate("critic_learning_rate")?;
        self.adam.validate()?;
        self.network.validate()?;
        self.critic.validate()
    }
}

built_in! {
    "shac": ShacConfig => Shac, squashed: true, loss: "mean cost of a step", in: "config.rs";
}
