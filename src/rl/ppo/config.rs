//! Settings of PPO.

use super::Ppo;
use crate::checks::{check_counts, check_positive};
use crate::learner::built_in;
use crate::nn::head::{LOG_STD_MAX, LOG_STD_MIN};
use crate::nn::{AdamConfig, Layers};
use crate::policy::Actor;
use crate::schedule::Schedule;
use crate::shards::with_normaliser;
use crate::value_norm::ValueNorm;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use tasks::{EnvConfig, Spec};

/// Whose policy the agents of a team fly, and how they learn it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Team {
    /// All one and the same.
    #[default]
    Shared,
    /// Each its own; all learn from the same advantages.
    Separate,
    /// Each its own; one learns after the other, in an order that is drawn anew in every update, from advantages times the
    /// ratios π/π_old of those before it: HAPPO (Kuba et al. 2022), whose updates never lower the team's return where they
    /// are small enough.
    Sequential,
}

with_defaults! {
    /// Settings; defaults fly the Hummingbird's Hover from random weights.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct PpoConfig {
        /// Environments, E. 1 to 2²⁴; default 512.
        pub n_env: usize = 512,
        /// Environments of a shard: one thread steps it for a whole rollout. Default 256.
        pub shard: usize = 256,
        /// T, steps of a rollout. 1 to 65 536; default 64.
        pub steps: usize = 64,
        /// Updates of a run. Default 220.
        pub updates: u64 = 220,
        /// Passes over a rollout. 1 to 1024; default 4.
        pub epochs: usize = 4,
        /// Minibatches of a pass. 1 to 65 536; default 16.
        pub minibatches: usize = 16,
        /// Learning rate of the actor over the run. Default a cosine from 1e-3 to 1e-5.
        pub learning_rate: Schedule = Schedule::cosine(1e-3, 1e-5),
        /// Learning rate of the critic over the run. Default a cosine from 2e-3 to 1e-4.
        pub critic_learning_rate: Schedule = Schedule::cosine(2e-3, 1e-4),
        /// KL divergence that the actor's rate follows, over the run; in files 0 for none. Default none.
        #[serde(with = "none_is_zero")]
        pub target_kl: Option<Schedule> = None,
        /// Mean KL divergence of a pass behind which no other follows; in files 0 for none. Default none.
        #[serde(with = "none_is_zero")]
        pub stop_kl: Option<f64> = None,
        /// γ, discount per step. Within [0, 1]; default 0.985.
        pub discount: f64 = 0.985,
        /// λ of advantages and of the critic's targets, over the run. Within [0, 1]; default 0.98.
        pub lambda: Schedule = Schedule::constant(0.98),
        /// ε, how far the ratio π/π_old counts: within 1 ± ε. > 0; default 0.2.
        pub clip_epsilon: f64 = 0.2,
        /// β, weight of the policy's entropy, over the run. Default a cosine from 5e-3 to 1e-3.
        pub entropy: Schedule = Schedule::cosine(5e-3, 1e-3),
        /// Largest norm of the gradients of actor and critic. > 0; default 1.
        pub max_grad_norm: f64 = 1.0,
        /// Errors of the critic beyond it count linearly, in standard deviations of the targets. > 0; default 10.
        pub huber: f64 = 10.0,
        /// What an update leaves of the statistics of the targets. Within [0, 1); default 0.995.
        pub value_beta: f64 = 0.995,
        /// First log standard deviation of continuous actions. Within [−5, 2]; default −0.5.
        pub log_std: f64 = -0.5,
        /// Whether observations are normalised by their running mean and deviation, frozen during a rollout. Default true.
        pub normalise_observation: bool = true,
        /// Whose policy agents of a team fly, and how they learn it: `shared`, `separate` or `sequential`. Default `shared`.
        pub team: Team = Team::Shared,
        /// Whether the critic sees the central state where there is one. Default true.
        pub central_critic: bool = true,
        /// Whether the critic sees the numbers that differ between environments, where there are any: it is not flown. Default true.
        pub privileged_critic: bool = true,
        /// The optimiser of both. Default ε = 1e-5.
        pub adam: AdamConfig = AdamConfig { epsilon: 1e-5, ..AdamConfig::default() },
        /// The policy.
        pub network: Layers = Layers::elu(0.01),
        /// The critic.
        pub critic: Layers = Layers::elu(1.0),
    }
}

built_in! {
    "ppo": PpoConfig => Ppo, squashed: false, loss: "−(clipped surrogate + entropy bonus)", in: "config.rs", actor: PpoConfig::actor;

    fn seen(&self, env: &EnvConfig) -> EnvConfig {
        PpoConfig::seen(self, env)
    }

    /// Updates are few and long.
    fn evaluate_every(&self) -> u64 {
        20
    }
}

impl PpoConfig {
    /// The shape of the policy.
    pub(super) fn actor(&self, spec: &Spec) -> Result<Actor> {
        Actor::with_memory(spec, &self.network, false)?.for_team(spec, self.team != Team::Shared)
    }

    /// The environments as the policy sees them.
    pub(crate) fn seen(&self, env: &EnvConfig) -> EnvConfig {
        with_normaliser(env, self.normalise_observation)
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
                ("steps", self.steps, 1 << 16),
                ("epochs", self.epochs, 1 << 10),
                ("minibatches", self.minibatches, 1 << 16),
            ],
            "512, 256, 64, 4 and 16 are usual.",
        )?;
        check_positive(
            &[("clip_epsilon", self.clip_epsilon), ("max_grad_norm", self.max_grad_norm), ("huber", self.huber)],
            "0.2, 1 and 10 are usual.",
        )?;
        let ends = self.target_kl.map_or([None; 2], |target| [0.0, 1.0].map(|progress| Some(target.at(progress))));
        for (what, x) in [("target_kl", ends[0]), ("target_kl", ends[1]), ("stop_kl", self.stop_kl)] {
            x.map_or(Ok(()), |x| check_positive(&[(what, x)], "0.01 is usual, or 0 for none."))?;
        }
        let [first, last] = [0.0, 1.0].map(|progress| self.lambda.at(progress));
        for (what, x) in [("discount", self.discount), ("lambda", first), ("lambda", last)] {
            if !(0.0..=1.0).contains(&x) {
                return Err(Error::value(what, x, "within [0, 1]", "0.99 and 0.95 are usual."));
            }
        }
        if !(LOG_STD_MIN..=LOG_STD_MAX).contains(&self.log_std) {
            let limit = format!("within [{LOG_STD_MIN}, {LOG_STD_MAX}]");
            return Err(Error::value("log_std", self.log_std, limit, "-0.5 explores 0.6 to either side."));
        }
        for (what, schedule) in [
            ("learning_rate", self.learning_rate),
            ("lambda", self.lambda),
            ("critic_learning_rate", self.critic_learning_rate),
            ("entropy", self.entropy),
        ]
        .into_iter()
        .chain(self.target_kl.map(|target| ("target_kl", target)))
        {
            schedule.validate(what)?;
        }
        ValueNorm::new(self.value_beta)?;
        self.adam.validate()?;
        if !self.critic.is_plain() {
            let remedy = "Leave them to network: critics see rows as they are.";
            return Err(Error::value("critic", "with encoder or memory", "of hidden layers alone", remedy));
        }
        self.network.validate()?;
        self.critic.validate()
    }
}

/// `None` as 0, so that a file can take away what a recipe gives: TOML has no word for nothing.
mod none_is_zero {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<T: Serialize, S: Serializer>(x: &Option<T>, to: S) -> Result<S::Ok, S::Error> {
        match x {
            None => to.serialize_f64(0.0),
            Some(x) => x.serialize(to),
        }
    }

    pub fn deserialize<'de, T, D>(from: D) -> Result<Option<T>, D::Error>
    where
        T: Deserialize<'de> + PartialEq + From<f64>,
        D: Deserializer<'de>,
    {
        T::deserialize(from).map(|x| Some(x).filter(|x| *x != T::from(0.0)))
    }
}
