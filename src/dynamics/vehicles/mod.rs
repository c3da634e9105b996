//! Built-in vehicles: one file each in `src/dynamics/vehicles`, with a table of its constants, their sources, and every place
//! where published tables disagree.
//!
//! To add one: write `my_drone.toml` there (`omnidrones models hummingbird --toml` prints one to start from), and give it one
//! line below. Command line, tests and documentation find it then.
//!
//! Common to all files:
//! - Body x forward, y left, z up; the origin is that of the published base link, not the centre of mass.
//! - Rotors keep OmniDrones' numbers (`rotor_0` …), spins its directions: +1 is counter-clockwise seen from +axis.
//! - Rotors are parts with their honest mass. A spinning blade presents all its sides in turn, so its part has the inertia
//!   of a box of length x, chord y and thickness z averaged about the axis: m(x² + y²)/12 along it and m(x² + y² + 2z²)/24
//!   across. RotorS's blade, the source of every published rotor inertia, is as long as the rotor's *radius* (sic), 15 mm
//!   of chord, 3 mm thick.
//! - DIFFERENCE marks where we depart from OmniDrones or where sources disagree, and what was chosen. Three hold
//!   everywhere: hover and thrust-to-weight use the total mass, not the base link's (defect 5 of OmniDrones' rotor
//!   model); allocation uses each rotor's true position and axis instead of an arm length and an angle (9);
//!   RotorS multiplies rotor inertias by ten because it spins the joints ten times slower, OmniDrones kept the factor
//!   and dropped the slow-down (4), we use the inertia of the rotor's own mass.
//! - `drag.linear` and `drag.angular` are zero: nobody publishes identified values that could be separated from the
//!   rotor drag. The benchmark tasks set their own effective damping.

use super::vehicle::Vehicle;
use base::error::{Error, Result};
use std::sync::LazyLock;

/// One line of the registry.
#[derive(Debug, Clone, Copy)]
pub struct VehicleEntry {
    /// What users type.
    pub name: &'static str,
    /// One line for tables.
    pub description: &'static str,
    /// The vehicle of its file, which is read once.
    pub build: fn() -> Vehicle,
}

macro_rules! built_in {
    ($($name:ident: $description:literal,)*) => {
        /// Every built-in vehicle, lightest first.
        pub static REGISTRY: &[VehicleEntry] =
            &[$(VehicleEntry { name: stringify!($name), description: $description, build: $name }),*];

        $(
            #[doc = concat!($description, ".")]
            pub fn $name() -> Vehicle {
                static READ: LazyLock<Vehicle> = LazyLock::new(|| {
                    let text = include_str!(concat!(stringify!($name), ".toml"));
                    Vehicle::from_toml_str(text, stringify!($name)).expect("the tests read every built-in file")
                });
                READ.clone()
            }
        )*
    };
}

built_in! {
    crazyflie: "Bitcraze Crazyflie 2.x, 27 g X-quadrotor",
    hummingbird: "AscTec Hummingbird, 0.7 kg +-quadrotor",
    iris: "3DR Iris, 1.5 kg wide X-quadrotor",
    firefly: "AscTec Firefly, 1.5 kg hexarotor",
    neo11: "AscTec Neo with 11-inch rotors, 3.4 kg tilted hexarotor",
    omav: "Voliro-type OMAV, 4 kg, six coaxial pairs held level",
}

/// Every built-in vehicle.
pub fn all() -> Vec<Vehicle> {
    REGISTRY.iter().map(|entry| (entry.build)()).collect()
}

/// The names that [`by_name`] knows.
pub fn names() -> Vec<&'static str> {
    REGISTRY.iter().map(|entry| entry.name).collect()
}

/// The built-in vehicle of that name (case does not matter).
///
/// # Errors
/// [`Error::Unknown`] with the nearest.
pub fn by_name(name: &str) -> Result<Vehicle> {
    match REGISTRY.iter().find(|entry| entry.name.eq_ignore_ascii_case(name)) {
        Some(entry) => Ok((entry.build)()),
        None => Err(Error::Unknown {
            kind: "vehicle",
            name: name.to_string(),
            known: names().into_iter().map(String::from).collect(),
        }),
    }
}

#[cfg(test)]
mod tests;
