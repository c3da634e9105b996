//! Built-in assemblies: one file each, a parameter struct whose `Default` is the paper's, readable as a drawing.
//!
//! To add one: write `my_robot.rs` beside these with a parameter struct and its `build`, and give it a line in
//! [`REGISTRY`]. Command line, tests and documentation find it there.
//!
//! Common to all files:
//! - Numbers are those of OmniDrones' public code. What its files leave to engine defaults is marked *our assumption*;
//!   DIFFERENCE marks where we depart on purpose.
//! - Its joint damping and stiffness are per degree; here per radian (`PER_DEGREE`).
//! - DIFFERENCE: a mass that is changed takes its inertia with it (defect 25).
//! - DIFFERENCE: PhysX slows bars, frames and payload spheres at 0.05 1/s in rotation unless told otherwise; that is
//!   one part in a thousand of their motion during a swing, and left out. Rates that OmniDrones sets are kept, as
//!   [`Drag`](crate::Drag) of the same effect at the build-time mass.
//! - Maps hold numbers of bodies and rotors. A joint's number is that of the body it moves: its angle stands at
//!   `model.layout().bodies[i].position` of the state, its command at `model.layout().drive[i]` of the input.
//!
//! ```
//! # use omnidrones_dynamics::omnidrones;
//! use omnidrones::dynamics::configurations::Payload;
//!
//! let robot = Payload { length: 0.8, ..Payload::default() }.build()?;
//! let angle = robot.model.layout().bodies[robot.map.swing[0]].position; // about x, in the state
//! assert_eq!((angle, robot.map.drone.rotors.len()), (13, 4));
//! # Ok::<(), omnidrones::error::Error>(())
//! ```

mod configuration;
#[doc(hidden)]
pub mod dragon;
#[doc(hidden)]
pub mod environment;
#[doc(hidden)]
pub mod gate;
#[doc(hidden)]
pub mod inverted_pendulum;
#[doc(hidden)]
pub mod omav;
#[doc(hidden)]
pub mod payload;
#[doc(hidden)]
pub mod platform;
#[doc(hidden)]
pub mod slung_load;
#[doc(hidden)]
pub mod transport;

#[doc(hidden)]
pub use configuration::PER_DEGREE;
pub use configuration::{Configuration, DroneMap};
pub use dragon::{Dragon, DragonLink, DragonMap};
pub use environment::environment;
pub use gate::{SlidingGate, SlidingGateMap};
pub use inverted_pendulum::{InvertedPendulum, InvertedPendulumMap};
pub use omav::{Omav, OmavMap};
pub use payload::{Payload, PayloadMap};
pub use platform::{Platform, PlatformDrone, PlatformMap};
pub use slung_load::{SlungLoad, SlungLoadMap};
pub use transport::{Carrier, Transport, TransportMap};

use super::tree::Model;
use base::error::{Error, Result};

/// One line of the registry.
#[derive(Debug, Clone, Copy)]
pub struct ConfigurationEntry {
    /// What users type.
    pub name: &'static str,
    /// One line for tables.
    pub description: &'static str,
    /// Builds the model with default parameters.
    pub build: fn() -> Result<Model>,
}

/// Every configuration of the benchmark: what commands take by name. [`SlungLoad`] is one more, from Rust.
pub static REGISTRY: &[ConfigurationEntry] = &[
    ConfigurationEntry {
        name: "payload",
        description: "a drone with a ball on a stiff rope of 1 m",
        build: || Ok(Payload::default().build()?.model),
    },
    ConfigurationEntry {
        name: "inverted_pendulum",
        description: "a drone that balances a ball on a bar of 1 m",
        build: || Ok(InvertedPendulum::default().build()?.model),
    },
    ConfigurationEntry {
        name: "platform_2",
        description: "two drones on cardan joints at the ends of a bar",
        build: || Ok(Platform { n_drone: 2, ..Platform::default() }.build()?.model),
    },
    ConfigurationEntry {
        name: "platform",
        description: "four drones on cardan joints carry a cross: over-actuated",
        build: || Ok(Platform::default().build()?.model),
    },
    ConfigurationEntry {
        name: "platform_6",
        description: "six drones on cardan joints carry a star: over-actuated",
        build: || Ok(Platform { n_drone: 6, ..Platform::default() }.build()?.model),
    },
    ConfigurationEntry {
        name: "transport",
        description: "four drones carry a box of 2 kg on bars",
        build: || Ok(Transport::four().build()?.model),
    },
    ConfigurationEntry {
        name: "transport_6",
        description: "six drones carry a longer box of 2 kg on bars",
        build: || Ok(Transport::six().build()?.model),
    },
    ConfigurationEntry {
        name: "dragon",
        description: "four links in a chain, each with two rotors on a gimbal",
        build: || Ok(Dragon::default().build()?.model),
    },
    ConfigurationEntry {
        name: "omav_tilting",
        description: "Voliro-type OMAV, six coaxial pairs on tilting units",
        build: || Ok(Omav::default().build()?.model),
    },
    ConfigurationEntry {
        name: "gate",
        description: "a sliding gate on a spring, fixed to the world",
        build: || Ok(SlidingGate::default().build()?.model),
    },
];

/// Every built-in configuration with default parameters.
///
/// # Errors
/// None for the registry as it is: a test builds them all.
pub fn all() -> Result<Vec<Model>> {
    REGISTRY.iter().map(|entry| (entry.build)()).collect()
}

/// The names that [`by_name`] knows.
pub fn names() -> Vec<&'static str> {
    REGISTRY.iter().map(|entry| entry.name).collect()
}

/// The built-in configuration of that name (case does not matter).
///
/// # Errors
/// [`Error::Unknown`] with the nearest.
pub fn by_name(name: &str) -> Result<Model> {
    match REGISTRY.iter().find(|entry| entry.name.eq_ignore_ascii_case(name)) {
        Some(entry) => (entry.build)(),
        None => Err(Error::Unknown {
            kind: "configuration",
            name: name.to_string(),
            known: names().into_iter().map(String::from).collect(),
        }),
    }
}
