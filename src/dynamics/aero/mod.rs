//! The air around a vehicle: each effect is optional, a function of its own, with its source.
//!
//! | file | what | where it acts |
//! |---|---|---|
//! | `wind` | velocity of the air: constant, sinusoidal, Dryden gusts | subtracted from the velocity in every drag |
//! | `downwash` | push of another vehicle's wake | force on the base |
//! | `ground_effect` | more thrust close to the ground | factor on each rotor's thrust |
//!
//! Drag of body and rotors belongs to the vehicle's equations, not here.

#[doc(hidden)]
pub mod downwash;
#[doc(hidden)]
pub mod ground_effect;
#[doc(hidden)]
pub mod wind;

pub use wind::{Dryden, Sinusoid, Wind, WindState, WrittenWind};

#[cfg(test)]
mod test_dual;
