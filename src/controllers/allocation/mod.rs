//! Allocation: thrust along body z and three moments → rotor thrusts.
//!
//! [`geometry`] reads what a vehicle's rotors can do and where they fall short, [`pseudo_inverse`] turns it into a
//! mixer and runs it. Bounded and prioritised allocation is a matter of other files.

pub mod geometry;
pub mod pseudo_inverse;

pub use geometry::{Authority, Axis};
pub use pseudo_inverse::{Mixer, allocate, allocate_yaw_last, thrust_to_command};
