//! What the other crates of this workspace use beside the public interface. No promises: it changes without notice.

mod compiled;

pub use self::compiled::{Certified, Timed, ToOrigin, body_poses, contact_forces, energies, step_plant};
pub use base::file_gate::{UNFINISHED_NAME, own_folder, read_text, remove_unfinished, replace, replace_with};
pub use base::memory::Request as MemoryRequest;
pub use base::names::{cell, quoted_cell, steers};
pub use base::reader::{of_json, of_toml};
pub use dynamics::contact::force::force as contact_force;
pub use dynamics::integrate::{Grid, step};
pub use rl::checkpoint::store::{check_removable, remove_checkpoints};
pub use rl::ending::{RunLeft, ask as ask_to_end, wait as wait_to_end};
pub use rl::policy::ROWS;
pub use rl::search::read_search;
pub use rl::shards::{Shard, shards};
pub use tasks::env::check::check_env_for;

use controllers::design::{self, Corner};
use controllers::{BodyModel, Setpoint, position};
use dynamics::{Physics, Vehicle};

/// How a step is divided.
pub fn grid(physics: &Physics) -> Grid {
    physics.grid()
}

/// [T, M] that fly a reference without error, linear drag included.
pub fn flat_wrench(body: &BodyModel<f64>, sample: &Setpoint<f64>) -> [f64; 4] {
    position::flat_wrench(body, sample)
}

/// The vehicle with mass, inertia, lag and centre of mass of a corner.
pub fn truth(vehicle: &Vehicle, corner: &Corner) -> Vehicle {
    design::truth(vehicle, corner)
}
