//! What is differentiated: a discrete-time system and a cost along its trajectory.
//!
//! `autodiff` does not know drones. It sees x⁺ = f(x, u, θ) and c(x, u, θ), each written once over [`Scalar`].

use super::scalar::Scalar;

/// A discrete-time system x⁺ = f(x, u, θ).
///
/// `step` must be branch-free in the values (see [`Scalar`]); it may branch on plain settings of `self`.
pub trait System: Sync {
    /// Length of the state x.
    fn n_state(&self) -> usize;
    /// Length of the input u: commands, or whatever drives the system from outside, such as a reference.
    fn n_input(&self) -> usize;
    /// Length of θ, the parameters that derivatives may be taken of; 0 where all are constants.
    fn n_parameter(&self) -> usize {
        0
    }
    /// `next` = f(`state`, `input`, `parameters`); slices have the lengths above.
    fn step<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], next: &mut [S]);
}

/// A cost Σₖ c(xₖ, uₖ, θ) + c_T(x_T, θ) along a trajectory.
pub trait Objective: Sync {
    /// c(x, u, θ), at the state before the step; slices have the lengths of the [`System`].
    fn stage<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S]) -> S;
    /// c_T(x, θ), at the last state; 0 unless given.
    fn terminal<S: Scalar>(&self, _state: &[S], _parameters: &[S]) -> S {
        S::zero()
    }
}
