//! Settings of DQN.

use super::Dqn;
use crate::checks::check_counts;
use crate::learner::built_in;
use crate::nn::{AdamConfig, Layers};
use crate::policy::Actor;
use crate::replay::ReplayConfig;
use crate::schedule::Schedule;
use crate::shards::with_normaliser;
use crate::target_network::check_targets;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use tasks::{ActionSpace, EnvConfig, Spec};

/// How the values of a team's agents make one of the team.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum ValueMixer {
    /// They do not: every agent learns from its own reward.
    #[default]
    None,
    /// Their sum: value decomposition, VDN (Sunehag et al. 2018).
    Sum,
    /// A network of the state that is monotone in each: QMIX (Rashid et al. 2018).
    Monotone {
        /// Units of the mixing network.
        units: usize,
        /// Hidden units of the network that gives its weights.
        hidden: usize,
    },
}

/// Settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DqnConfig {
    /// Environments, E. 1 to 2²⁴; default 512.
    pub n_env: usize,
    /// Environments of a shard: one thread steps it for a whole update. Default 256.
    pub shard: usize,
    /// Steps of every environment in an update. 1 to 65 536; default 8.
    pub steps: usize,
    /// Updates of a run. Default 1000.
    pub updates: u64,
    /// Gradient steps of an update. 1 to 65 536; default 32.
    pub gradient_steps: usize,
    /// Rows of a gradient step. 1 to 2²⁰; default 512.
    pub batch: usize,
    /// γ, discount per step. Within [0, 1); default 0.97.
    pub discount: f64,
    /// τ, share of the way to the learnt weights that the target network goes in a gradient step. Within (0, 1]; default 0.005.
    pub tau: f64,
    /// ε, share of actions drawn evenly, over the run. Default exponential from 1 to 0.01.
    pub epsilon: Schedule,
    /// Whether the learnt network chooses the action whose value the target network gives (van Hasselt et al. 2016). Default true.
    pub double: bool,
    /// Whether values are a state's and what an action adds to it (Wang et al. 2016). Default true.
    pub duelling: bool,
    /// Quantiles of an action's return, 1 for its mean alone (Dabney et al. 2018). Up to 256; default 1.
    pub quantiles: usize,
    /// How the values of a team's agents make one of the team. Default none.
    pub mixer: ValueMixer,
    /// Whether every agent of a team has a network of its own; needs a `mixer`. Default false.
    pub separate_values: bool,
    /// Values of each number of an action, where `env.actions` leaves them continuous. 1 to 256; default 3.
    pub levels: usize,
    /// Learning rate over the run. Default a cosine from 3e-3 to 3e-4.
    pub learning_rate: Schedule,
    /// Largest norm of the gradient. > 0; default 10.
    pub max_grad_norm: f64,
    /// Errors of means beyond it count linearly (those of quantiles beyond 0.02, whatever stands here). > 0; default 10.
    pub huber: f64,
    /// Whether observations are normalised by their running mean and deviation. Default true.
    pub normalise_observation: bool,
    /// Steps that are kept to be learnt from. Default 400 000, with n from 10 to 3.
    pub replay: ReplayConfig,
    /// The optimiser.
    pub adam: AdamConfig,
    /// The policy: from an observation to values. Default two layers of 128 units, ELU, normalised.
    pub network: Layers,
}

impl Default for DqnConfig {
    fn default() -> Self {
        Self {
            n_env: 512,
            shard: 256,
            steps: 8,
            updates: 1000,
            gradient_steps: 32,
            batch: 512,
            discount: 0.97,
            tau: 0.005,
            epsilon: Schedule::Exponential { from: 1.0, to: 0.01, warm_up: 0.0 },
            double: true,
            duelling: true,
            quantiles: 1,
            mixer: ValueMixer::None,
            separate_values: false,
            levels: 3,
            learning_rate: Schedule::cosine(3e-3, 3e-4),
            max_grad_norm: 10.0,
            huber: 10.0,
            normalise_observation: true,
            replay: ReplayConfig { capacity: 400_000, n_step: Schedule::cosine(10.0, 3.0), ..ReplayConfig::default() },
            adam: AdamConfig::default(),
            network: Layers { hidden: vec![128; 2], layer_norm: true, ..Layers::elu(0.1) },
        }
    }
}

built_in! {
    "dqn": DqnConfig => Dqn, squashed: false, loss: "error of the values", in: "config.rs", actor: DqnConfig::actor;

    fn seen(&self, env: &EnvConfig) -> EnvConfig {
        DqnConfig::seen(self, env)
    }
}

impl DqnConfig {
    /// The environments as the policy sees them: with as many `levels` of each number of an action, where it is continuous.
    pub(crate) fn seen(&self, env: &EnvConfig) -> EnvConfig {
        let mut env = with_normaliser(env, self.normalise_observation);
        if env.actions == ActionSpace::Continuous {
            env.actions = ActionSpace::MultiDiscrete { levels: self.levels };
        }
        env
    }

    /// What flies.
    pub(crate) fn actor(&self, spec: &Spec) -> Result<Actor> {
        Actor::new(spec, &self.network, false)?.for_team(spec, self.separate_values)
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        let (units, hidden) = match self.mixer {
            ValueMixer::Monotone { units, hidden } => (units, hidden),
            _ => (1, 1),
        };
        check_counts(
            &[
                ("n_env", self.n_env, 1 << 24),
                ("shard", self.shard, 1 << 24),
                ("steps", self.steps, 1 << 16),
                ("gradient_steps", self.gradient_steps, 1 << 16),
                ("batch", self.batch, 1 << 20),
                ("quantiles", self.quantiles, 256),
                ("levels", self.levels, 256),
                ("mixer.units", units, 256),
                ("mixer.hidden", hidden, 4096),
            ],
            "512, 256, 8, 32, 512, 1, 3, 32 and 64 are usual.",
        )?;
        if self.mixer != ValueMixer::None && self.quantiles > 1 {
            let remedy = "Leave quantiles out: a mixer takes one number of each agent.";
            return Err(Error::value("quantiles", self.quantiles, "1 with a mixer", remedy));
        }
        if self.mixer != ValueMixer::None && self.replay.priority > 0.0 {
            let remedy = "Leave it out: rows of a team are drawn alike.";
            return Err(Error::value("replay.priority", self.replay.priority, "0 with a mixer", remedy));
        }
        if self.mixer == ValueMixer::None && self.separate_values {
            let remedy = "Set mixer = { kind = 'sum' } or { kind = 'monotone', units = 32, hidden = 64 }: rows of a team are drawn together then, agent by agent.";
            return Err(Error::value("separate_values", true, "false without a mixer", remedy));
        }
        check_targets(self.discount, self.tau, self.max_grad_norm, self.huber)?;
        self.epsilon.validate("epsilon")?;
        self.learning_rate.validate("learning_rate")?;
        self.replay.validate_for(self.n_env)?;
        self.adam.validate()?;
        self.network.validate()
    }
}
