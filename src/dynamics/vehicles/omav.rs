//! OMAV of the Voliro family: six arms, each with a coaxial pair on a tilting unit; here with all tilts held at zero.
//!
//! | constant | value | source |
//! |---|---|---|
//! | core mass, inertia | 2.30 kg, (0.0075, 0.010939, 0.01369) kg m² | \[USD\] `omav.usd`, RotorS `omav.xacro` |
//! | tilt units | 6 × 0.277 kg, (0.00034257, 0.0013205, 0.0010037) kg m² along (radial, tangential, z), 0.3 m out | \[USD\] |
//! | rotors | 12 × 0.0065 kg, ±0.06 m above and below the unit, radius 0.1143 m | \[USD\] |
//! | k_f, Ω_max | 7.2e-6 N s²/rad², 1700 rad/s | OmniDrones YAML |
//! | k_m | upper 1.08e-7, lower 3.6e-8 N m s²/rad² (κ = 0.015, 0.005 m) | OmniDrones YAML, RotorS |
//! | τ up / down | 0.0125 / 0.025 s | RotorS |
//! | rotor drag, rolling | 8.06428e-5, 1e-6 | RotorS |
//! | body drag | 0 | no source |
//! | gains | none published | [`Vehicle::gains`] |
//!
//! Unit j carries `rotor_j` on top and `rotor_(j+6)` below; both push up. Yaw torques of equal thrusts do not cancel
//! within a pair (κ differs by a factor of three) but do over the vehicle: three upper rotors spin each way.
//!
//! DIFFERENCE
//! - Spins and κ are bound by rotor name. OmniDrones pairs its YAML list with the order of bodies in the stage, which
//!   swaps the upper and lower rotors of units 4 and 5 (defect 8).
//! - Hover uses all 4.04 kg, not the core's 2.30 kg (defect 5): thrust fraction 0.16, not 0.09.
//! - RotorS gives the core products of inertia (−3.4e-5, 2.5e-5, −3.9e-6); the USD drops them and so do we: 0.04 % of
//!   the whole vehicle's moments.
//! - OmniDrones has neither an inertia nor a controller for it; the parts give (0.084, 0.089, 0.17) kg m².
//! - Rotor inertia 7.3e-6 kg m², a tenth of the published 7.293e-5 (defect 4).
//! - Tilting (six more inputs at ≤ 10 rad/s) belongs to a later configuration; so held, it flies as a plain hexarotor.

use super::{Blade, with_blades};
use crate::dynamics::shape::{Geometry, Shape};
use crate::dynamics::vehicle::{Drag, Inertia, Part, Rotor, Vehicle};

/// Chord and thickness from the published moments, which are not those of RotorS's usual box.
const BLADE: Blade = Blade { mass: 0.0065, length: 0.1143, chord: 0.02, thickness: 0.003 };
/// (radial, tangential, z) moments of a tilt unit, kg m².
const UNIT: [f64; 3] = [0.00034257, 0.0013205, 0.0010037];

/// Unit j: (x, y), spin of `rotor_j` (upper), spin of `rotor_(j+6)` (lower).
const LAYOUT: [([f64; 2], f64, f64); 6] = [
    ([0.0, -0.3], 1.0, -1.0),
    ([0.0, 0.3], -1.0, 1.0),
    ([0.2598, 0.15], 1.0, -1.0),
    ([-0.2598, -0.15], -1.0, 1.0),
    ([0.2598, -0.15], -1.0, 1.0),
    ([-0.2598, 0.15], 1.0, -1.0),
];

/// Builds the vehicle.
pub fn vehicle() -> Vehicle {
    let upper = LAYOUT.iter().enumerate().map(|(j, &([x, y], spin, _))| rotor(j, [x, y, 0.06], spin, 1.08e-7));
    let lower = LAYOUT.iter().enumerate().map(|(j, &([x, y], _, spin))| rotor(j + 6, [x, y, -0.06], spin, 3.6e-8));
    let rotors: Vec<Rotor> = upper.chain(lower).collect();
    let mut airframe = vec![Part::new("base_link", 2.30, [0.0; 3], Inertia::diagonal(0.0075, 0.010939, 0.01369))];
    airframe.extend(LAYOUT.iter().enumerate().map(|(j, &(p, _, _))| tilt_unit(j, p)));
    Vehicle {
        name: "omav".into(),
        source: "OmniDrones omav USD and YAML; RotorS omav.xacro".into(),
        parts: with_blades(airframe, &rotors, BLADE),
        rotors,
        drag: Drag::default(),
        shapes: vec![Shape::new(Geometry::Box { size: [0.22, 0.22, 0.35] })],
        published_gains: None,
    }
}

fn rotor(number: usize, position: [f64; 3], spin: f64, torque_coefficient: f64) -> Rotor {
    Rotor {
        name: format!("rotor_{number}"),
        position,
        axis: [0.0, 0.0, 1.0],
        spin,
        thrust_coefficient: 7.2e-6,
        moment_per_thrust: torque_coefficient / 7.2e-6,
        max_speed: 1700.0,
        time_constant_up: 0.0125,
        time_constant_down: 0.025,
        inertia: BLADE.axial(),
        radius: 0.1143,
        drag_coefficient: 8.06428e-5,
        axial_drag_coefficient: 0.0,
        rolling_coefficient: 1e-6,
    }
}

/// A tilt unit at (x, y), its x axis pointing outwards: J = R diag(r, t, z) Rᵀ with R about z.
fn tilt_unit(number: usize, [x, y]: [f64; 2]) -> Part {
    let length = x.hypot(y);
    let (c, s) = (x / length, y / length);
    let [r, t, z] = UNIT;
    let inertia =
        Inertia { xx: r * c * c + t * s * s, yy: r * s * s + t * c * c, zz: z, xy: (r - t) * s * c, xz: 0.0, yz: 0.0 };
    Part::new(format!("tilt_unit_{number}"), 0.277, [x, y, 0.0], inertia)
}
