//! Environments on a device: the programs that a batch runs, one thread for each environment, with the bits of the CPU.
//!
//! | file | what |
//! |---|---|
//! | `device`: [`Device`] | a card, or a stand-in on the host that runs the same text |
//! | `memory` | typed arrays on it |
//! | `compile` | text to code, kept by its hash |
//! | `env`: [`DeviceEnv`] | many environments of one task |
//! | `sweep`: [`DeviceTape`], [`DeviceSweep`] | gradients through their steps |
//! | `foreign` | what calls libraries that are found at run time: all `unsafe` of this room |

mod compile;
mod device;
mod env;
mod foreign;
mod memory;
mod sweep;
#[cfg(test)]
mod tests;

pub use device::{Device, DeviceKind};
pub use env::{DeviceArray, DeviceEnv, DeviceGraph};
pub use memory::DeviceRows;
pub use sweep::DeviceCotangents;
pub use sweep::{DeviceAdjoint, DeviceSweep, DeviceTape};

/// Names that examples in this room's documentation use.
#[doc(hidden)]
pub mod omnidrones {
    pub use crate as gpu;
    pub use base::error;
    pub use tasks;
}
