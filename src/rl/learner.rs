//! What all learning algorithms have in common, as the trainer sees them: settings, and the learner that they make.

use super::checkpoint::Tensors;
use super::policy::{Actor, Policy};
use super::warm_start::WarmStart;
use base::error::{Error, Result};
use base::parallel::Threads;
use serde::Serialize;
use std::any::Any;
use std::fmt::Debug;
use std::time::Duration;
use tasks::{Env, EnvConfig, Spec};
use toml::Table;

/// Makes environments of a configuration: of a built-in task `|config| Env::make("Hover", config)`, or of one's own
/// `|config| Env::of(Climb::new(config)?, "Climb", config)`.
pub type Make<'a> = dyn Fn(&EnvConfig) -> Result<Env> + 'a;

/// A way to learn, with its settings: a struct that also derives `Debug`, `Clone`, `Default`, `Serialize` and
/// `Deserialize`, the last with `#[serde(deny_unknown_fields, default)]`. [`register`](super::algorithm::register) makes it known by its
/// name.
pub trait Algorithm: Plain + Send + Sync {
    /// In files, options and folders; the name of its table.
    fn name(&self) -> &'static str;

    /// Checks every number that can be checked without building environments.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    fn validate(&self) -> Result<()>;

    /// Updates of a run.
    fn updates(&self) -> u64;

    /// With another number of updates.
    fn set_updates(&mut self, updates: u64);

    /// The shape of the policy that is learnt.
    ///
    /// # Errors
    /// As [`Actor::new`].
    fn actor(&self, spec: &Spec) -> Result<Actor>;

    /// The learner at its first update, in environments that `make` makes of `env`; their number and seed are its own.
    ///
    /// # Errors
    /// As the learner's.
    fn learner(&self, make: &Make<'_>, env: &EnvConfig, seed: u64, threads: Threads) -> Result<Box<dyn Learner>>;

    /// The environments as the policy sees them: with the stages that it adds to the observation.
    fn seen(&self, env: &EnvConfig) -> EnvConfig {
        env.clone()
    }

    /// Whether the policy that the run begins from teaches it ([`Learner::teach`]); otherwise its weights are the first ones.
    fn is_taught(&self) -> bool {
        false
    }

    /// Updates between two evaluations, unless settings say otherwise.
    fn evaluate_every(&self) -> u64 {
        100
    }

    /// What [`Update::loss`](super::Update::loss) is, for axes.
    fn loss(&self) -> &'static str {
        "loss"
    }

    /// Rust source in which the struct's fields are documented, and the struct's name: what settings mean, for
    /// `train --toml`.
    fn source(&self) -> (&'static str, &'static str) {
        ("", "")
    }
}

/// A built-in [`Algorithm`]: its name, settings (with `validate`, `updates` and `network`) and learner (with `with`),
/// whether its policy's outputs pass tanh, what its loss is, the file of the settings, the shape of its policy where that is not
/// one without memory that agents share; then what it does otherwise.
macro_rules! built_in {
    ($name:literal: $config:ident => $learner:ident, squashed: $squashed:literal, loss: $loss:literal, in: $file:literal
     $(, actor: $actor:path)?;
     $($more:tt)*) => {
        impl $crate::learner::Algorithm for $config {
            fn name(&self) -> &'static str {
                $name
            }

            fn validate(&self) -> base::error::Result<()> {
                $config::validate(self)
            }

            fn updates(&self) -> u64 {
                self.updates
            }

            fn set_updates(&mut self, updates: u64) {
                self.updates = updates;
            }

            fn actor(&self, spec: &tasks::Spec) -> base::error::Result<$crate::policy::Actor> {
                $crate::learner::built_in!(@actor self, spec, $squashed $(, $actor)?)
            }

            fn learner(
                &self,
                make: &$crate::learner::Make<'_>,
                env: &tasks::EnvConfig,
                seed: u64,
                threads: base::parallel::Threads,
            ) -> base::error::Result<Box<dyn $crate::Learner>> {
                Ok(Box::new($learner::with(make, env, self.clone(), seed, threads)?))
            }

            fn loss(&self) -> &'static str {
                $loss
            }

            fn source(&self) -> (&'static str, &'static str) {
                (include_str!($file), stringify!($config))
            }

            $($more)*
        }
    };
    (@actor $own:ident, $spec:ident, $squashed:literal) => {
        $crate::policy::Actor::new($spec, &$own.network, $squashed)
    };
    (@actor $own:ident, $spec:ident, $squashed:literal, $actor:path) => {
        $actor($own, $spec)
    };
}
pub(super) use built_in;

/// What derives give every [`Algorithm`].
pub trait Plain: Any + Debug {
    /// A copy.
    fn copy(&self) -> Box<dyn Algorithm>;

    /// Its settings.
    ///
    /// # Errors
    /// [`Error::Value`] for a whole number above 2⁶³ − 1.
    fn table(&self) -> Result<Table>;
}

impl<A: Algorithm + Clone + Serialize> Plain for A {
    fn copy(&self) -> Box<dyn Algorithm> {
        Box::new(self.clone())
    }

    fn table(&self) -> Result<Table> {
        Table::try_from(self).map_err(unwritable)
    }
}

pub(super) fn unwritable(error: toml::ser::Error) -> Error {
    Error::value("configuration", error, "what TOML can hold", "Lower the seed or the limit of memory.")
}

impl dyn Algorithm {
    /// The settings by their type.
    pub fn get<A: Algorithm>(&self) -> Option<&A> {
        (self as &dyn Any).downcast_ref()
    }

    /// Likewise, to change them.
    pub fn get_mut<A: Algorithm>(&mut self) -> Option<&mut A> {
        (self as &mut dyn Any).downcast_mut()
    }
}

impl Clone for Box<dyn Algorithm> {
    fn clone(&self) -> Self {
        (**self).copy()
    }
}

/// A learning algorithm in the middle of its run.
pub trait Learner: Send + Sync {
    /// Collects experience and improves the policy once.
    ///
    /// # Errors
    /// As the environment's; learning itself does not fail, it reports.
    fn update(&mut self) -> Result<Update>;

    /// How far it is.
    fn progress(&self) -> Progress;

    /// Updates done.
    fn n_update(&self) -> u64 {
        self.progress().update
    }

    /// Updates after which it is done.
    fn budget(&self) -> u64 {
        self.progress().budget
    }

    /// Steps of environments done.
    fn env_steps(&self) -> u64 {
        self.progress().env_steps
    }

    /// Episodes that begin from now on have this difficulty ([`Env::set_difficulty`](tasks::Env::set_difficulty)).
    ///
    /// # Errors
    /// [`Error::Value`] outside [0, 1], and unless the algorithm takes part in curricula.
    fn set_difficulty(&mut self, _share: f64) -> Result<()> {
        Err(Error::value("curriculum", "on", "off for this algorithm", "Leave the table `curriculum` out."))
    }

    /// Takes these weights in place of random ones; before the first update.
    ///
    /// # Errors
    /// [`Error::Value`] for another number of weights, and unless the algorithm can begin from a policy.
    fn warm_start(&mut self, _start: &WarmStart) -> Result<()> {
        Err(Error::value("from", "a policy", "random weights for this algorithm", "Leave `from` out."))
    }

    /// Learns from `teacher` from now on, a policy of environments like `of`, which flies in those that `make` makes; before the
    /// first update, and before [`Learner::load`].
    ///
    /// # Errors
    /// [`Error::Value`] for a teacher that does not fit, and unless the algorithm is [taught](super::Algorithm::is_taught).
    fn teach(&mut self, _teacher: Policy, _of: &Spec, _make: &Make<'_>) -> Result<()> {
        Err(Error::value("teacher", "a policy", "none for this algorithm", "Train with rma or dagger."))
    }

    /// Bytes that steps which are kept to be learnt from take in a checkpoint, beside weights.
    fn kept_bytes(&self) -> u64 {
        0
    }

    /// The policy as it is.
    ///
    /// # Errors
    /// [`Error::Value`](base::error::Error::Value) if its numbers are not finite.
    fn policy(&self) -> Result<Policy>;

    /// Puts what is needed to fly into `policy`, and what is needed to go on with the same bits into `state`.
    ///
    /// # Errors
    /// None for a name that is used once.
    fn save(&self, policy: &mut Tensors, state: &mut Tensors) -> Result<()>;

    /// Continues from what [`Learner::save`] put there.
    ///
    /// # Errors
    /// [`Error`](base::error::Error) naming the tensor that is missing or has another shape.
    fn load(&mut self, policy: &Tensors, state: &Tensors) -> Result<()>;
}

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Updates done.
    pub update: u64,
    /// Updates after which it is done.
    pub budget: u64,
    /// Steps of environments done.
    pub env_steps: u64,
}

/// Share of a run that is done behind `update` of `updates` updates.
pub(crate) fn share_done(update: u64, updates: u64) -> f64 {
    update as f64 / updates.max(1) as f64
}

/// What one update did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Update {
    /// What was minimised, before the update; its meaning is the algorithm's.
    pub loss: f64,
    /// Mean reward of a step.
    pub reward: f64,
    /// Episodes that ended in it.
    pub episodes: Episodes,
    /// Norm of the policy's gradient before it was clipped.
    pub gradient_norm: f64,
    /// Learning rate used.
    pub rate: f64,
    /// More figures, by name.
    pub extra: Vec<(&'static str, f64)>,
    /// Time of each phase, by name.
    #[serde(skip)]
    pub phases: Vec<(&'static str, Duration)>,
}

/// Figures over episodes that ended while training, exploration and all.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Episodes {
    /// How many.
    pub count: u64,
    /// Σ return.
    pub total_return: f64,
    /// Σ steps.
    pub total_length: f64,
    /// How many the task ended.
    pub crashed: u64,
    /// How many it did not end, and whose last step was a success.
    pub succeeded: u64,
}

impl Episodes {
    /// With those of another part of the batch.
    pub fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.total_return += other.total_return;
        self.total_length += other.total_length;
        self.crashed += other.crashed;
        self.succeeded += other.succeeded;
    }
}

/// Everything that goes on, as bits.
#[cfg(test)]
pub(crate) fn saved(learner: &dyn Learner) -> (Tensors, Tensors) {
    let (mut policy, mut state) = (Tensors::new(), Tensors::new());
    learner.save(&mut policy, &mut state).unwrap();
    (policy, state)
}
