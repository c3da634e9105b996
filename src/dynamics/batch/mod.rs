//! Many environments at once, in lanes.

mod kernel;
mod world;

pub use world::{DEFAULT_MEMORY_LIMIT, Failure, Reason, World};
