//! Many environments at once, in lanes.

mod kernel;
mod world;

pub(crate) use kernel::EXPLODED;
pub use world::{Failure, Reason, World};
