//! The names that most programs begin with: `use omnidrones::prelude::*;`.
//!
//! | for | names |
//! |---|---|
//! | bodies | [`Vehicle`], [`vehicles`], [`configurations`], [`Physics`], [`Disturbance`], [`Plant`], [`Multirotor`], [`World`] |
//! | flights | [`fly`], [`fly_vehicle`], [`FlightPlan`], [`Flight`], [`Reference`], [`ClosedLoop`], [`Rates`] |
//! | a controller of one's own | [`Controller`] with [`Measurement`] and [`Target`]; straight-line ones: [`ControlLaw`], [`LawInput`], [`LawController`] |
//! | derivatives | [`Scalar`], [`safe`], [`System`], [`linearise`], [`Rollout`], [`certify`] |
//! | environments | [`Env`], [`EnvConfig`], [`Buffers`], [`SingleEnv`] |
//! | a task of one's own | [`Task`] with [`Robot`], [`View`], [`Start`], [`Writer`], [`Ends`]; over [`Trace`], [`TraceMask`]; [`Array`] of their slices |
//! | learning | [`TrainConfig`], [`Trainer`], [`Learner`], [`Policy`], [`load_policy`] |
//! | all of them | [`Stream`] of random numbers, [`Threads`] |
//!
//! [`error::Result`](base::error::Result) is not among them: it would hide the standard one.

#[doc(no_inline)]
pub use autodiff::{Array, Rollout, Scalar, System, Trace, TraceMask, certify, linearise, safe};
#[doc(no_inline)]
pub use base::parallel::Threads;
#[doc(no_inline)]
pub use controllers::{
    ClosedLoop, ControlLaw, Controller, Flight, FlightPlan, LawController, LawInput, Measurement, Rates, Reference,
    Target, fly, fly_vehicle,
};
#[doc(no_inline)]
pub use dynamics::{Disturbance, Multirotor, Physics, Plant, Vehicle, World, configurations, vehicles};
#[doc(no_inline)]
pub use rl::{Learner, Policy, TrainConfig, Trainer, load_policy};
#[doc(no_inline)]
pub use rng::Stream;
#[doc(no_inline)]
pub use tasks::{Buffers, Ends, Env, EnvConfig, Robot, SingleEnv, Start, Task, View, Writer};
