//! What all learning algorithms have in common, as the trainer sees them.

use super::checkpoint::Tensors;
use super::policy::Policy;
use super::shards::Make;
use super::warm_start::WarmStart;
use crate::error::{Error, Result};
use crate::tasks::Spec;
use serde::Serialize;
use std::time::Duration;

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

    /// Episodes that begin from now on have this difficulty ([`Env::set_difficulty`](crate::tasks::Env::set_difficulty)).
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
    /// [`Error::Value`](crate::error::Error::Value) if its numbers are not finite.
    fn policy(&self) -> Result<Policy>;

    /// Puts what is needed to fly into `policy`, and what is needed to go on with the same bits into `state`.
    ///
    /// # Errors
    /// None for a name that is used once.
    fn save(&self, policy: &mut Tensors, state: &mut Tensors) -> Result<()>;

    /// Continues from what [`Learner::save`] put there.
    ///
    /// # Errors
    /// [`Error`](crate::error::Error) naming the tensor that is missing or has another shape.
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
    /// Time of each phase.
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
