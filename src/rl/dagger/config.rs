//! Settings of DAgger.

use super::Dagger;
use crate::checks::{check_counts, check_positive};
use crate::learner::built_in;
use crate::nn::{AdamConfig, Layers};
use crate::schedule::Schedule;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// What of a teacher is imitated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ImitationTarget {
    /// Its actions, by the whole policy.
    #[default]
    Action,
    /// The output of its last encoder, by the policy's last encoder; all other weights are the teacher's and stay.
    Latent,
}

with_defaults! {
    /// Settings; defaults clone a cascade within a minute.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct DaggerConfig {
        /// Environments, E. 1 to 2²⁴; default 64.
        pub n_env: usize = 64,
        /// Environments of a shard: one thread steps it for a whole update. Default 32.
        pub shard: usize = 32,
        /// Steps of an update, from fresh starts on. 1 to 65 536; default 250.
        pub steps: usize = 250,
        /// Updates of a run. Default 100.
        pub updates: u64 = 100,
        /// `action`, or `latent` of the policy that the run begins from. Default `action`.
        pub imitate: ImitationTarget = ImitationTarget::Action,
        /// Folder of the run whose policy teaches actions; empty for our controller of the task.
        pub teacher: String = String::new(),
        /// β, share of the environments that the teacher flies, over the run. Default linear from 1 to 0.
        pub teacher_share: Schedule = Schedule::Linear { from: 1.0, to: 0.0, warm_up: 0.0 },
        /// Passes over an update's rows. 1 to 1024; default 4.
        pub epochs: usize = 4,
        /// Minibatches of a pass. 1 to 65 536; default 16.
        pub minibatches: usize = 16,
        /// Learning rate over the run. Default a cosine from 2e-3 to 2e-5.
        pub learning_rate: Schedule = Schedule::cosine(2e-3, 2e-5),
        /// Largest norm of the gradient. > 0; default 1.
        pub max_grad_norm: f64 = 1.0,
        /// The optimiser.
        pub adam: AdamConfig = AdamConfig::default(),
        /// The policy.
        pub network: Layers = Layers::default(),
    }
}

impl DaggerConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        check_counts(
            &[
                ("n_env", self.n_env, 1 << 24),
                ("shard", self.shard, 1 << 24),
                ("steps", self.steps, 1 << 16),
                ("epochs", self.epochs, 1 << 10),
                ("minibatches", self.minibatches, 1 << 16),
            ],
            "64, 32, 250, 4 and 16 are usual.",
        )?;
        check_positive(&[("max_grad_norm", self.max_grad_norm)], "1 is usual.")?;
        if self.imitate == ImitationTarget::Latent && !self.teacher.is_empty() {
            let remedy = "Name the run in `from`: its weights are taken over too.";
            return Err(Error::value(
                "teacher",
                format!("'{}'", self.teacher),
                "left out where a latent is imitated",
                remedy,
            ));
        }
        if self.imitate == ImitationTarget::Latent && self.adam.weight_decay > 0.0 {
            let remedy = "Leave it out: what is taken over from the teacher stays as it is.";
            return Err(Error::value(
                "adam.weight_decay",
                self.adam.weight_decay,
                "0 where a latent is imitated",
                remedy,
            ));
        }
        self.teacher_share.validate("teacher_share")?;
        self.learning_rate.validate("learning_rate")?;
        self.adam.validate()?;
        self.network.validate()
    }
}

built_in! {
    "dagger": DaggerConfig => Dagger, squashed: true, loss: "half the squared error of what is imitated", in: "config.rs";

    fn is_taught(&self) -> bool {
        self.imitate == ImitationTarget::Latent
    }

    /// Updates are few and long.
    fn evaluate_every(&self) -> u64 {
        20
    }
}
