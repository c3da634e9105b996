//! Many environments at once: a block of them is stepped by one program.

mod breach;
mod kernel;
mod plant;
mod step_program;
mod world;

pub use breach::Breach;
#[doc(hidden)]
pub use breach::RawBreach;
#[doc(hidden)]
pub use kernel::{ALIVE, DIVERGED_ABOVE, STOPPED};
#[doc(hidden)]
pub use plant::{BatchPlant, PlantBlock};
pub use world::{DEFAULT_MEMORY_LIMIT, StopReason, Stopped, World};
