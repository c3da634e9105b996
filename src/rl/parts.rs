//! What algorithms are built of: take them for your own. `examples/own_task_and_algorithm.rs` does.
//!
//! | part | what |
//! |---|---|
//! | [`shards()`], [`Shard`] | a batch cut into parts that one thread steps |
//! | [`Collector`], [`BehaviourPolicy`], [`RolloutBatch`], [`RolloutShape`], [`CriticSees`] | T steps of every environment under a stochastic policy, with their worth |
//! | [`advantages`], [`ValueNorm`] | GAE and λ-targets; their scale |
//! | [`Critic`], [`Fit`] | a value function and a step of it |
//! | [`Minibatch`], [`minibatch`], [`shuffle`] | the gradient of a loss over some rows; which rows |
//! | [`Sequences`], [`sequences()`], [`Recall`] | the same through time; what a policy with memory remembers |
//! | [`windows`], [`Window`], [`gather`] | steps under a deterministic policy and the exact gradient of their cost, by the sweeps of [`Env`](tasks::Env) |
//! | [`PolicyOptimiser`] | an actor that goes down such gradients |
//! | [`state`](super::state) | all of it into checkpoints and back |

pub use super::critic::{Critic, Fit, shuffle};
pub use super::gae::{Steps, advantages};
pub use super::learner::Make;
pub use super::minibatch::{BlockLoss, Minibatch, Sums, minibatch};
pub use super::policy_optimiser::PolicyOptimiser;
pub use super::recall::Recall;
pub use super::rollout::{
    BehaviourPolicy, Collector, CriticSees, RolloutBatch, RolloutPart, RolloutShape, RolloutStats,
};
pub use super::sequences::{Sequence, Sequences, sequences};
pub use super::shards::{Shard, episodes, normalise, shards};
pub use super::value_norm::ValueNorm;
pub use super::window::{TrainingObjective, Window, WindowStats, WindowStep, gather, windows};
