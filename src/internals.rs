//! What the other crates of this workspace use beside the public interface. No promises: it changes without notice.

pub use crate::atomic_file::replace_with;
pub use crate::dynamics::integrate::{Grid, step};
pub use crate::rl::policy::ROWS;
pub use crate::rl::shards::{Shard, shards};
pub use crate::tasks::rig::Craft;

use crate::dynamics::Physics;
use crate::tasks::Rig;

/// How a step is divided.
pub fn grid(physics: &Physics) -> Grid {
    physics.grid()
}

/// The system of a task.
pub fn craft(rig: &Rig) -> &Craft {
    &rig.craft
}
