//! Goals: observations, rewards, ends, and many environments stepped together.

pub mod baseline;
pub mod config;
pub mod env;
pub mod evaluate;
pub mod observation;
pub mod path;
pub(crate) mod physical;
pub mod probe;
pub mod randomise;
pub mod record;
pub mod registry;
pub mod reward;
pub mod rig;
pub mod sheet;
pub mod suite;
pub mod task;
pub mod with;

pub use baseline::Baseline;
pub use config::{ActionSpace, Autoreset, Delay, EnvConfig};
pub use env::check::{Finding, check_env};
pub use env::single::{Outcome, SingleEnv};
pub use env::{
    Adjoint, Buffers, Cotangents, Env, Info, Jacobian, Pending, Space, Spec, StepOut, Sweep, SweepOptions, Tape,
};
pub use evaluate::{Evaluation, Watched, evaluate};
pub use observation::{Stage, Statistics};
pub use randomise::{Change, Distribution, Quantity};
pub use record::{Record, Recorded, Spread};
pub use rig::Rig;
pub use sheet::{End, Metric, Setting, Sheet, Sign, Slice, Smoothness, Term};
pub use task::{Ends, Start, Task, View, Wanted};
pub use with::{Pick, Scale, Transform, With};
