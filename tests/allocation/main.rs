//! Bounded allocation: every answer is within its bounds, optimal, and differentiable.

mod derivatives;
mod problems;
mod solvers;
