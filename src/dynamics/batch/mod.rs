//! Many environments at once: a block of them is stepped by one program.

mod breach;
mod kernel;
mod plant;
mod step_program;
mod world;

pub use breach::Breach;
pub(crate) use breach::Culprit;
pub(crate) use kernel::{ALIVE, EXPLODED, STOPPED};
pub(crate) use plant::{Block, Plant};
pub use world::{DEFAULT_MEMORY_LIMIT, Reason, Stopped, World};
