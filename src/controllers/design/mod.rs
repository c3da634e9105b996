//! Design on the differentiable loop: tuning gains by gradients through whole flights.

pub mod tune;

pub use tune::{Evaluation, Iteration, TunePlan, Tuning, tune};
