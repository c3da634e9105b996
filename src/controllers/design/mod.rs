//! Design on the differentiable loop: tuning gains by gradients through whole flights.

pub mod sensitivity;
pub mod tune;

pub use sensitivity::{Sensitivity, sensitivity};
pub use tune::{Evaluation, Iteration, TunePlan, Tuning, tune};
