//! Settings that SAC and TD3 share.

use super::{ActorCritic, Kind};
use crate::checks::check_counts;
use crate::learner::{Algorithm, Learner, Make};
use crate::nn::{AdamConfig, Layers};
use crate::policy::Actor;
use crate::replay::ReplayConfig;
use crate::schedule::Schedule;
use crate::shards::with_normaliser;
use crate::target_network::check_targets;
use base::error::{Error, Result};
use base::parallel::Threads;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fmt::Debug;
use tasks::{EnvConfig, Spec};

/// How an algorithm of this kind explores, with its numbers.
pub trait Exploration:
    Clone + Debug + Default + PartialEq + Serialize + DeserializeOwned + Send + Sync + 'static
{
    /// What it does.
    type Kind: Kind + 'static;
    /// Of the algorithm, in files and options.
    const NAME: &'static str;
    /// Steps of the critics for one of the actor, unless settings say otherwise.
    const ACTOR_DELAY: usize;
    /// Share of the run in which the rate of the actor rises, likewise.
    const WARM_UP: f64;

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] with the number, the rule and the remedy.
    fn validate(&self) -> Result<()>;

    /// For actions of `n` numbers in the mean over agents.
    fn kind(&self, n: f64) -> Self::Kind;
}

/// Settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default, bound = "E: Exploration")]
pub struct ActorCriticConfig<E> {
    /// Environments, E. 1 to 2²⁴; default 512.
    pub n_env: usize,
    /// Environments of a shard: one thread steps it for a whole update. Default 256.
    pub shard: usize,
    /// Steps of every environment in an update. 1 to 65 536; default 8.
    pub steps: usize,
    /// Updates of a run. Default 700.
    pub updates: u64,
    /// Gradient steps of an update. 1 to 65 536; default 32.
    pub gradient_steps: usize,
    /// Rows of a gradient step. 1 to 2²⁰; default 512.
    pub batch: usize,
    /// γ, discount per step. Within [0, 1); default 0.97.
    pub discount: f64,
    /// τ, share of the way to the learnt weights that target networks go in a gradient step. Within (0, 1]; default 0.005.
    pub tau: f64,
    /// Critics, the least of whose values counts: two (Fujimoto et al. 2018), one for DDPG. 1 to 64; default 2.
    pub critics: usize,
    /// Quantiles of the return that each critic tells instead of its mean (Dabney et al. 2018); 1 for the mean alone.
    /// Up to 1024; default 1.
    pub quantiles: usize,
    /// Steps of the critics for one of the actor. 1 to 1024; default 1 for SAC, 2 for TD3.
    pub actor_delay: usize,
    /// Whether critics see what all agents of a team see and do (Lowe et al. 2017). Default false.
    pub central_critic: bool,
    /// Whether every agent of a team has an actor of its own (Lowe et al. 2017); needs `central_critic`. Default false.
    pub separate_actors: bool,
    /// Learning rate of the actor over the run. Default a cosine from 3e-3 to 1.5e-3.
    pub learning_rate: Schedule,
    /// Learning rate of the critics over the run. Default a cosine from 5e-3 to 2e-3.
    pub critic_learning_rate: Schedule,
    /// Largest norm of the gradients of actor and critics. > 0; default 10.
    pub max_grad_norm: f64,
    /// Weight, over the run, of the mean square of what tanh takes in (of means, for SAC) beside −Q, in deviations of the targets, in
    /// what the actor goes down; 0 for none. Critics that know nothing yet drive it into a corner of its range, where tanh is flat and
    /// it learns no more. The code of Lowe et al. (2017) adds such a term, 1e-3 of it beside a Q on the scale of its rewards.
    /// Up to 1000; default 0.
    pub saturation_penalty: Schedule,
    /// Errors of the critics beyond it count linearly; those of quantiles beyond 0.02 deviations of the targets. > 0; default 10.
    pub huber: f64,
    /// How it explores.
    pub exploration: E,
    /// ρ, correlation of the noise of two steps of an update. A drone hardly feels an action of one step, and its critics tell
    /// the better one from the worse only where noise lasts (Eberhard et al. 2023). Within [0, 1]; default 0.8.
    pub correlation: f64,
    /// Whether observations are normalised by their running mean and deviation. Default true.
    pub normalise_observation: bool,
    /// Steps that are kept to be learnt from. Default 400 000, with n from 10 to 3.
    pub replay: ReplayConfig,
    /// The optimiser of all.
    pub adam: AdamConfig,
    /// The policy.
    pub network: Layers,
    /// The critics. Default two layers of 128 units, ELU, normalised.
    pub critic: Layers,
}

impl<E: Exploration> Default for ActorCriticConfig<E> {
    fn default() -> Self {
        Self {
            n_env: 512,
            shard: 256,
            steps: 8,
            updates: 700,
            gradient_steps: 32,
            batch: 512,
            discount: 0.97,
            tau: 0.005,
            critics: 2,
            quantiles: 1,
            actor_delay: E::ACTOR_DELAY,
            central_critic: false,
            separate_actors: false,
            learning_rate: Schedule::Cosine { from: 3e-3, to: 1.5e-3, warm_up: E::WARM_UP },
            critic_learning_rate: Schedule::cosine(5e-3, 2e-3),
            max_grad_norm: 10.0,
            saturation_penalty: Schedule::constant(0.0),
            huber: 10.0,
            exploration: E::default(),
            correlation: 0.8,
            normalise_observation: true,
            replay: ReplayConfig { capacity: 400_000, n_step: Schedule::cosine(10.0, 3.0), ..ReplayConfig::default() },
            adam: AdamConfig::default(),
            network: Layers::elu(0.01),
            critic: Layers { hidden: vec![128; 2], layer_norm: true, ..Layers::elu(1.0) },
        }
    }
}

/// Most gradient steps of an update, and steps of an environment.
const MAX_STEPS: usize = 1 << 16;
/// Largest weight of what tanh takes in: beyond it nothing else is learnt.
const MAX_PENALTY: f64 = 1e3;

impl<E: Exploration> ActorCriticConfig<E> {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        check_counts(
            &[
                ("n_env", self.n_env, 1 << 24),
                ("shard", self.shard, 1 << 24),
                ("steps", self.steps, MAX_STEPS),
                ("gradient_steps", self.gradient_steps, MAX_STEPS),
                ("batch", self.batch, 1 << 20),
                ("critics", self.critics, 64),
                ("quantiles", self.quantiles, 1 << 10),
                ("actor_delay", self.actor_delay, 1 << 10),
            ],
            "512, 256, 8, 32, 512, 2, 1 and 1 are usual.",
        )?;
        check_targets(self.discount, self.tau, self.max_grad_norm, self.huber)?;
        self.learning_rate.validate("learning_rate")?;
        self.critic_learning_rate.validate("critic_learning_rate")?;
        self.replay.validate_for(self.n_env)?;
        if self.central_critic && self.replay.priority > 0.0 {
            let remedy = "Leave it out: rows of a team are drawn alike.";
            return Err(Error::value("replay.priority", self.replay.priority, "0 with a central critic", remedy));
        }
        if self.separate_actors && !self.central_critic {
            let remedy = "Set central_critic = true: rows of a team are drawn together then, agent by agent.";
            return Err(Error::value("separate_actors", true, "false without a central critic", remedy));
        }
        self.saturation_penalty.validate("saturation_penalty")?;
        if let Some(c) = self.saturation_penalty.ends().into_iter().find(|c| !(0.0..=MAX_PENALTY).contains(c)) {
            let remedy = "0 leaves it out; 0.001 to 0.1 are usual.";
            return Err(Error::value("saturation_penalty", c, format!("within [0, {MAX_PENALTY}]"), remedy));
        }
        self.exploration.validate()?;
        if !(0.0..=1.0).contains(&self.correlation) {
            return Err(Error::value("correlation", self.correlation, "within [0, 1]", "0 to 0.9 are usual."));
        }
        self.adam.validate()?;
        self.network.validate()?;
        if !self.critic.is_plain() {
            let remedy = "Give encoders to `network`: critics see what all of them see, beside the action.";
            return Err(Error::value("critic", "encoders or a memory", "hidden layers alone", remedy));
        }
        self.critic.validate()
    }
}

impl<E: Exploration> Algorithm for ActorCriticConfig<E> {
    fn name(&self) -> &'static str {
        E::NAME
    }

    fn seen(&self, env: &EnvConfig) -> EnvConfig {
        with_normaliser(env, self.normalise_observation)
    }

    fn validate(&self) -> Result<()> {
        Self::validate(self)
    }

    fn updates(&self) -> u64 {
        self.updates
    }

    fn set_updates(&mut self, updates: u64) {
        self.updates = updates;
    }

    fn actor(&self, spec: &Spec) -> Result<Actor> {
        Actor::new(spec, &self.network, true)?.for_team(spec, self.separate_actors)
    }

    fn learner(&self, make: &Make<'_>, env: &EnvConfig, seed: u64, threads: Threads) -> Result<Box<dyn Learner>> {
        Ok(Box::new(ActorCritic::with(make, env, self.clone(), seed, threads)?))
    }

    fn loss(&self) -> &'static str {
        "−value of the policy's actions"
    }

    fn source(&self) -> (&'static str, &'static str) {
        (include_str!("config.rs"), "ActorCriticConfig<E>")
    }
}
