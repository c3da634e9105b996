//! Many environments at once, in lanes.

mod kernel;
mod world;

pub use world::{Failure, Reason, World};
