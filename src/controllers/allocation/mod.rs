//! Allocation: a wanted wrench → rotor thrusts and thrust vectors.
//!
//! | file | idea |
//! |---|---|
//! | [`articulated`] | what the rotors of a system of many bodies can do in its present shape |
//! | [`geometry`] | what a vehicle's rotors can do: rank, weakest direction, lost axes |
//! | [`pseudo_inverse`] | the mixer: least thrusts, clipped, yaw last |
//! | [`problem`] | the bounded problem: quadratic cost, bounds, cones |
//! | [`allocator`] | its solvers behind one interface, with certificate, fallback and counts |
//! | [`active_set`] | bounds: exact and fast, branch-free |
//! | [`conic`] | cones: clarabel |
//! | [`nearest`] | of all inputs that make a wrench, those nearest to a goal |
//! | [`residual`](mod@residual) | the certificate |

pub mod active_set;
pub mod allocator;
pub mod articulated;
pub mod conic;
pub mod geometry;
pub mod nearest;
pub mod problem;
pub mod pseudo_inverse;
pub mod residual;

pub use allocator::{Allocator, Counts, Path, Reason, Settings, Solution};
pub use articulated::{composite_inertia, resistance, wrench_matrix};
pub use geometry::{Authority, Axis};
pub use problem::{Affine, Cone, Problem};
pub use pseudo_inverse::{Mixer, allocate, allocate_yaw_last, thrust_to_command};
