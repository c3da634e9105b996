//! Numbers: every scalar evaluates the same step, every gradient is right.

#[path = "../common/mod.rs"]
mod common;
mod gradients;
mod multibody_gradients;
mod one_source;
