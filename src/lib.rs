//! placeholder
pub mod autodiff;
pub mod controllers;
pub mod dynamics;
pub mod error;
