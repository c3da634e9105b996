//! Built-in vehicles: one file each, with a table of its constants, their sources, and every place where published
//! tables disagree.
//!
//! To add one: write `my_drone.rs` beside these with a function that returns a [`Vehicle`], name it as a module below
//! and give it one line in [`REGISTRY`]. Command line, tests and documentation find it there.
//!
//! Common to all files:
//! - Body x forward, y left, z up; the origin is that of the published base link, not the centre of mass.
//! - Rotors keep OmniDrones' numbers (`rotor_0` …), spins its directions: +1 is counter-clockwise seen from +axis.
//! - Rotors are parts with their honest mass. A spinning blade presents all its sides in turn, so its part has the
//!   blade's box inertia averaged about the axis: Ixx = Iyy = (I_long + I_flat)/2.
//! - DIFFERENCE marks where we depart from OmniDrones or where sources disagree, and what was chosen. Three hold
//!   everywhere: hover and thrust-to-weight use the total mass, not the base link's (defect 5 of OmniDrones' rotor
//!   model); allocation uses each rotor's true position and axis instead of an arm length and an angle (9);
//!   RotorS multiplies rotor inertias by ten because it spins the joints ten times slower, OmniDrones kept the factor
//!   and dropped the slow-down (4), we use the inertia of the rotor's own mass.
//! - `drag.linear` and `drag.angular` are zero: nobody publishes identified values that could be separated from the
//!   rotor drag. The benchmark tasks set their own effective damping.

pub mod crazyflie;
pub mod firefly;
pub mod hummingbird;
pub mod iris;
pub mod neo11;
pub mod omav;

use super::vehicle::{Inertia, Part, Rotor, Vehicle};
use crate::error::{Error, Result};

/// One line of the registry.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    /// What users type.
    pub name: &'static str,
    /// One line for tables.
    pub description: &'static str,
    /// Builds the vehicle from its constants.
    pub build: fn() -> Vehicle,
}

/// Every built-in vehicle, lightest first.
pub static REGISTRY: &[Entry] = &[
    Entry { name: "crazyflie", description: "Bitcraze Crazyflie 2.x, 27 g X-quadrotor", build: crazyflie::vehicle },
    Entry { name: "hummingbird", description: "AscTec Hummingbird, 0.7 kg +-quadrotor", build: hummingbird::vehicle },
    Entry { name: "iris", description: "3DR Iris, 1.5 kg wide X-quadrotor", build: iris::vehicle },
    Entry { name: "firefly", description: "AscTec Firefly, 1.5 kg hexarotor", build: firefly::vehicle },
    Entry {
        name: "neo11",
        description: "AscTec Neo with 11-inch rotors, 3.4 kg tilted hexarotor",
        build: neo11::vehicle,
    },
    Entry { name: "omav", description: "Voliro-type OMAV, 4 kg, six coaxial pairs held level", build: omav::vehicle },
];

/// Every built-in vehicle.
pub fn all() -> Vec<Vehicle> {
    REGISTRY.iter().map(|entry| (entry.build)()).collect()
}

/// The names that [`by_name`] knows.
pub fn names() -> Vec<&'static str> {
    REGISTRY.iter().map(|entry| entry.name).collect()
}

/// The built-in vehicle of that name (case does not matter), or [`Error::Unknown`] with the nearest.
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

/// A spinning rotor blade as seen by the airframe: a box of length x, chord y and thickness z.
#[derive(Debug, Clone, Copy)]
struct Blade {
    mass: f64,
    length: f64,
    chord: f64,
    thickness: f64,
}

impl Blade {
    /// RotorS's blade: as long as the rotor's *radius* (sic; the source of every published rotor inertia), 15 mm chord,
    /// 3 mm thick.
    const fn rotors(mass: f64, radius: f64) -> Self {
        Self { mass, length: radius, chord: 0.015, thickness: 0.003 }
    }

    /// m(x² + y²)/12 about the spin axis, kg m².
    const fn axial(&self) -> f64 {
        self.mass / 12.0 * (self.length * self.length + self.chord * self.chord)
    }

    /// Mean over a turn of the two moments across the axis: m(x² + y² + 2z²)/24, kg m².
    const fn transverse(&self) -> f64 {
        let [x, y, z] = [self.length, self.chord, self.thickness];
        self.mass / 24.0 * (x * x + y * y + 2.0 * z * z)
    }

    /// The part at `rotor`'s hub: J = J_t·1 + (J_a − J_t) n nᵀ.
    fn part(&self, rotor: &Rotor) -> Part {
        let [x, y, z] = rotor.axis;
        let (t, d) = (self.transverse(), self.axial() - self.transverse());
        let inertia = Inertia {
            xx: t + d * x * x,
            yy: t + d * y * y,
            zz: t + d * z * z,
            xy: d * x * y,
            xz: d * x * z,
            yz: d * y * z,
        };
        Part::new(rotor.name.clone(), self.mass, rotor.position, inertia)
    }
}

/// The parts of an airframe followed by one blade per rotor.
fn with_blades(mut airframe: Vec<Part>, rotors: &[Rotor], blade: Blade) -> Vec<Part> {
    airframe.extend(rotors.iter().map(|rotor| blade.part(rotor)));
    airframe
}

#[cfg(test)]
mod tests;
