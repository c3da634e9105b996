//! placeholder
pub mod autodiff;
pub mod controllers;
pub mod dynamics;
pub mod error;
pub mod parallel;
pub mod rng;
