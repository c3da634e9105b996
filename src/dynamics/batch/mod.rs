//! Many environments at once, in lanes.

mod breach;
mod kernel;
mod plant;
mod tree_kernel;
mod world;

pub use breach::Breach;
pub(crate) use breach::Culprit;
pub(crate) use kernel::{ALIVE, EXPLODED, STOPPED};
pub(crate) use plant::{Block, Plant};
pub use world::{DEFAULT_MEMORY_LIMIT, Reason, Stopped, World};
