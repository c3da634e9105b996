//! placeholder
pub mod autodiff;
pub mod dynamics;
pub mod error;
pub mod rng;
