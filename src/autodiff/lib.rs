//! Numbers that differentiate: one scalar trait, its implementations, and what is derived from them.
//!
//! | file | what |
//! |---|---|
//! | `scalar`: [`Mask`] | the [`Scalar`] trait, `f32`, `f64` |
//! | [`safe`] | norms, roots and angles that stay finite, values and derivatives, at their corners |
//! | `dual` | num-dual's numbers as scalars: exact forward derivatives |
//! | `jet`: [`Jet`] | truncated Taylor series over any scalar |
//! | `lanes`, `columns`, `unrolled` | SIMD registers as scalars, chosen at run time; where their numbers stand; loops over components |
//! | `custom`: [`CustomFunction`], [`Operation`] | functions with a derivative of their own, for solvers inside kernels |
//! | `floor` | [`floor()`]: a step, as such a function |
//! | [`native`] | machine code of programs, made at run time |
//! | [`emit`] | text of programs in other languages |
//! | `trace`, `program` | recording scalar, functions of recordings, derived adjoints; compiled programs |
//! | `sweep` | the chain rule of a recording, backwards for all results at once |
//! | `once` | what is made when it is first asked for |
//! | `system`: [`System`], [`Objective`] | what is differentiated: x⁺ = f(x, u, θ), costs |
//! | `derivative`: [`CompiledJacobian`], [`JacobianScratch`] | Jacobians of one step, by duals and compiled |
//! | `rollout`: [`Rollout`], [`Gradient`] | gradients through whole rollouts, reverse and forward |
//! | `batch_rollout`: [`BatchRollout`], [`BatchGradient`] | the same for many rollouts at once, in lanes |
//! | `certificate`: [`Certificate`], [`CertificateBounds`] | adjoint against duals against differences, for anybody's system |
//!
//! This room does not know drones.

pub(crate) mod array;
#[doc(hidden)]
pub mod batch_rollout;
#[doc(hidden)]
pub mod certificate;
#[doc(hidden)]
pub mod columns;
#[doc(hidden)]
pub mod compiled_once;
#[doc(hidden)]
pub mod custom;
#[doc(hidden)]
pub mod derivative;
pub(crate) mod dual;
pub mod emit;
#[cfg(test)]
mod example;
pub(crate) mod fast_hash;
pub(crate) mod floor;
#[doc(hidden)]
pub mod jet;
#[doc(hidden)]
pub mod lanes;
pub mod native;
#[doc(hidden)]
pub mod once;
pub(crate) mod polynomials;
#[doc(hidden)]
pub mod program;
#[doc(hidden)]
pub mod rollout;
pub mod safe;
pub(crate) mod scalar;
pub(crate) mod sweep;
pub(crate) mod system;
#[doc(hidden)]
pub mod trace;
#[doc(hidden)]
pub mod unrolled;

pub use array::Array;
pub use batch_rollout::{BatchGradient, BatchRollout};
pub use certificate::{Certificate, CertificateBounds, certify};
pub use custom::{CustomFunction, Operation, Points};
pub use derivative::{CompiledJacobian, JacobianScratch, Linearisation, jacobian, linearise};
pub use floor::floor;
#[doc(hidden)]
pub use floor::saved_operation;
pub use jet::Jet;
pub use lanes::{instruction_set, lane_width};
pub use program::{BLOCK, BlockWorkspace, Program, Workspace};
pub use rollout::{Gradient, Rollout, RolloutScratch};
pub use scalar::{Mask, Scalar};
pub use system::{Objective, System};
pub use trace::{Recording, Trace, TraceMask};

/// Examples of the documentation name things as users of `omnidrones` do.
#[doc(hidden)]
pub mod omnidrones {
    pub use crate as autodiff;
    pub use base::{error, parallel};
}
