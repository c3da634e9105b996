//! Learning: from random weights to a policy that flies.
//!
//! A learner sees environments through the batch API alone ([`Env`](tasks::Env)): observations in, actions out, and
//! for the analytic methods the reverse sweep. All of them share the parts below; each algorithm is one file to be read
//! from top to bottom.
//!
//! | file | what |
//! |---|---|
//! | [`apg`] | analytic policy gradients: the default where the loss is smooth |
//! | [`shac`] | the same over shorter windows, with a critic behind them |
//! | [`dagger`] | imitation of a controller, or of a policy that sees more |
//! | [`ppo`] | proximal policy optimisation, for all tasks, teams and discrete actions |
//! | [`sac`], [`td3`] | off-policy, for continuous actions; DDPG, MADDPG and MATD3 are settings of `td3` |
//! | [`dqn`] | values of discrete actions; VDN and QMIX are settings of it |
//! | [`algorithm`] | which algorithms there are, and how to add one's own |
//! | `config`, [`recipes`] | what a run is made of, and what proved good for each task |
//! | `config_diff`: [`ConfigDifference`] | in which settings two runs differ |
//! | `trainer`: [`Trainer`], [`RunProgress`] | the loop: update, log, evaluate, save, resume |
//! | [`runs`] | several runs side by side, and what seeds say together |
//! | [`search`] | which settings are best, by successive halving |
//! | `evaluate`: [`evaluate()`], [`Starts`] | a policy on fixed starts that no training saw |
//! | [`log`], `tensorboard` | the course of a run, as lines and for TensorBoard |
//! | `policy`: [`Policy`], [`Actor`] | what was learnt |
//! | `checkpoint`: [`SkippedCheckpoint`], [`Tensors`] | files that survive a kill |
//! | [`planner`] | what can be flown at all, by plans through the simulator |
//! | [`refine`] | how much more return an episode held than a policy took from it |
//! | `parts` | what algorithms are built of, for one's own |
//! | `learner`, `checks` | what all algorithms have in common |
//! | `nn`: [`Activation`], [`AdamConfig`] | networks, distributions, Adam |
//! | `window`, `window_run` | a window of steps and its exact gradient; what runs of APG and SHAC share |
//! | `shards` | a batch cut into parts that one thread steps |
//! | `state` | their state in checkpoints |
//! | `minibatch`, `critic` | the gradient of a sum over rows; a value function |
//! | [`actor_critic`] | what SAC and TD3 share |
//! | `replay`, `priorities`, `experience` | steps that are kept, how often they are drawn, who flies and draws them |
//! | `task_record` | the task of a run, where it is none of Rust's |
//! | `target_network` | a network with the one that follows it |
//! | `sequences`, `recall` | the gradient through time; what policies with memory remember |
//! | `gae`, `value_loss`, `value_norm`, `schedule` | advantages, losses and scales of values, rates |
//!
//! ```
//! # use omnidrones_rl::omnidrones;
//! use omnidrones::parallel::Threads;
//! use omnidrones::rl::{Learner, apg::{Apg, ApgConfig}};
//! use omnidrones::tasks::EnvConfig;
//!
//! let config = ApgConfig { updates: 3, ..ApgConfig::default() }; // 800 fly
//! let mut apg = Apg::new("Hover", &EnvConfig::default(), config, 0, Threads::default())?;
//! while apg.n_update() < apg.budget() {
//!     let update = apg.update()?;
//!     assert!(update.loss.is_finite());
//! }
//! let mut policy = apg.policy()?;
//! let mut actions = vec![0.0; 4];
//! policy.act(&[0.0; 30], &mut actions)?;
//! # Ok::<(), omnidrones::error::Error>(())
//! ```
//!
//! # Time-outs are not deaths
//!
//! At time t the target is r + γ (1 − terminated) V(next), with the true final observation as next where an episode
//! ended, and traces are cut by both kinds of end. Critics that see what one agent sees pass the ten-fold test of it (in the
//! tests of `ppo`, `shac`, `actor_critic` and `dqn`; APG has none): one state, reward 1, a time limit of ten steps, γ = 0.99;
//! right is 100, and taking time-outs for deaths gives 5 to 12.
//!
//! # The same bits
//!
//! Results depend on the seed and the configuration, not on the number of threads: environments are cut into shards of
//! fixed size, gradients into parts of fixed size, and sums are folded in order. A run that was killed goes on from its
//! last checkpoint with the same bits.

pub mod actor_critic;
pub mod algorithm;
pub mod apg;
#[doc(hidden)]
pub mod checkpoint;
pub(crate) mod checks;
pub(crate) mod config;
pub(crate) mod config_diff;
pub(crate) mod critic;
pub(crate) mod curriculum;
pub mod dagger;
pub mod dqn;
#[doc(hidden)]
pub mod ending;
#[doc(hidden)]
pub mod evaluate;
pub(crate) mod experience;
pub(crate) mod gae;
pub(crate) mod input_scale;
pub(crate) mod learner;
pub mod log;
pub(crate) mod minibatch;
#[doc(hidden)]
pub mod nn;
#[doc(hidden)]
pub mod parts;
pub mod planner;
#[doc(hidden)]
pub mod policy;
#[doc(hidden)]
pub mod policy_controller;
#[doc(hidden)]
pub mod policy_io;
pub(crate) mod policy_optimiser;
pub mod ppo;
pub(crate) mod predecessor;
pub(crate) mod priorities;
pub(crate) mod recall;
pub mod recipes;
pub mod refine;
#[doc(hidden)]
pub mod replay;
pub(crate) mod rollout;
pub mod runs;
pub mod sac;
#[doc(hidden)]
pub mod schedule;
pub mod search;
pub(crate) mod sequences;
pub mod shac;
#[doc(hidden)]
pub mod shards;
#[doc(hidden)]
pub mod state;
pub(crate) mod target_network;
mod task_record;
pub mod td3;
pub(crate) mod tensorboard;
#[doc(hidden)]
pub mod trainer;
pub(crate) mod value_loss;
pub(crate) mod value_norm;
pub(crate) mod warm_start;
pub(crate) mod window;
mod window_run;

pub use algorithm::Algorithm;
pub use checkpoint::{SkippedCheckpoint, Tensors};
pub use config::{Checkpoints, Evaluate, TrainConfig};
pub use config_diff::ConfigDifference;
pub use curriculum::{Curriculum, GoodEpisode};
pub use evaluate::{Starts, eval_env, evaluate};
pub use learner::{Episodes, Learner, Progress, Update};
pub use nn::{Activation, AdamConfig, Encoder, Layers, Recurrence};
pub use policy::{Actor, Policy};
pub use policy_controller::PolicyController;
pub use policy_io::{SavedPolicy, load_policy};
pub use replay::{Precision, ReplayConfig};
pub use schedule::Schedule;
pub use trainer::{RunProgress, TrainResult, Trainer, Watch};
pub use warm_start::WarmStart;

/// Examples of the documentation name things as users of `omnidrones` do.
#[doc(hidden)]
pub mod omnidrones {
    pub use crate as rl;
    pub use {autodiff, base::error, base::parallel, dynamics, rng, tasks};
}
