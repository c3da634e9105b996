//! Vectors and rotations over any [`Scalar`](autodiff::Scalar), guarded at their singular points.
//!
//! nalgebra's types are the vocabulary of `f64` design code; kernels use these few functions instead, because
//! nalgebra's rotations return wrong derivatives at zero angle on dual numbers and cannot run over lanes.

mod rotation;
mod vector;

pub use rotation::*;
pub use vector::*;
