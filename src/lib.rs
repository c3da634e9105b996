//! placeholder
pub(crate) mod atomic_file;
pub mod autodiff;
pub mod bench;
pub mod controllers;
pub mod dynamics;
pub mod error;
pub mod flight;
pub mod parallel;
#[cfg(feature = "plot")]
pub mod plot;
pub mod rng;
