//! Bounded allocation: every answer is within its bounds, optimal, and differentiable.

mod active_set;
mod derivatives;
mod hard;
mod lanes;
mod prioritised;
mod problems;
mod rollouts;
mod solvers;
