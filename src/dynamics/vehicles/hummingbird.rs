//! AscTec Hummingbird: a +-quadrotor of 0.716 kg.
//!
//! | constant | value | source |
//! |---|---|---|
//! | base mass, inertia | 0.68 kg, (0.007, 0.007, 0.012) kg m² | RotorS `hummingbird.xacro`; logged by an OmniDrones user (issue 75) |
//! | rotors | 4 × 0.009 kg at (±0.17, 0, 0.01), (0, ±0.17, 0.01) m, radius 0.1 m | RotorS `hummingbird.xacro` |
//! | k_f, κ, Ω_max | 8.54858e-6 N s²/rad², 0.016 m, 838 rad/s | RotorS, OmniDrones YAML |
//! | τ up / down | 0.0125 / 0.025 s | RotorS |
//! | rotor drag, rolling | 8.06428e-5, 1e-6 | RotorS |
//! | body drag, quadratic | (0.005, 0.005, 0.01) N s²/m² | RotorPy `hummingbird_params.py` (Folk, Paulos, Kumar 2023) |
//! | gains | K_p 4, K_v 2.2, K_R (0.7, 0.7, 0.035), K_ω (0.1, 0.1, 0.025) | RotorS Lee controller |
//!
//! DIFFERENCE
//! - OmniDrones' USD is in no public snapshot; parts are those of RotorS, from which it was made. They sum to the YAML's
//!   0.716 kg. The whole vehicle's inertia is larger than the YAML's, which is the base link's alone: the rotors at
//!   the arms' ends add 0.0005 and 0.001 kg m².
//! - Its hover throttle and thrust-to-weight use the base link's 0.68 kg (defect 5); here the total mass.
//! - Rotor inertia 7.67e-6 kg m², a tenth of the published 7.669e-5 (defect 4).
//! - RotorPy describes another Hummingbird (0.5 kg, X layout, k_f 5.57e-6, rotor drag 1.19e-4, axial 2.32e-4); only its
//!   body drag is taken, since RotorS has none. Axial rotor drag stays zero, as in RotorS.

use super::{Blade, with_blades};
use crate::dynamics::shape::{Geometry, Shape};
use crate::dynamics::vehicle::{Drag, Gains, Inertia, Part, Rotor, Vehicle};

const BLADE: Blade = Blade::rotors(0.009, 0.1);

/// (x, y, spin) of `rotor_0` …: front, left, back, right.
const LAYOUT: [(f64, f64, f64); 4] = [(0.17, 0.0, -1.0), (0.0, 0.17, 1.0), (-0.17, 0.0, -1.0), (0.0, -0.17, 1.0)];

/// Builds the vehicle.
pub fn vehicle() -> Vehicle {
    let rotors: Vec<Rotor> = (LAYOUT.iter().enumerate())
        .map(|(i, &(x, y, spin))| Rotor {
            name: format!("rotor_{i}"),
            position: [x, y, 0.01],
            axis: [0.0, 0.0, 1.0],
            spin,
            thrust_coefficient: 8.54858e-6,
            moment_per_thrust: 0.016,
            max_speed: 838.0,
            time_constant_up: 0.0125,
            time_constant_down: 0.025,
            inertia: BLADE.axial(),
            radius: 0.1,
            drag_coefficient: 8.06428e-5,
            axial_drag_coefficient: 0.0,
            rolling_coefficient: 1e-6,
        })
        .collect();
    Vehicle {
        name: "hummingbird".into(),
        source: "RotorS hummingbird.xacro; OmniDrones; body drag from RotorPy".into(),
        parts: with_blades(
            vec![Part::new("base_link", 0.68, [0.0; 3], Inertia::diagonal(0.007, 0.007, 0.012))],
            &rotors,
            BLADE,
        ),
        rotors,
        drag: Drag { quadratic: [0.005, 0.005, 0.01], ..Drag::default() },
        shapes: vec![Shape::new(Geometry::Box { size: [0.1, 0.1, 0.12] })],
        published_gains: Some(Gains {
            position: [4.0; 3],
            velocity: [2.2; 3],
            attitude: [0.7, 0.7, 0.035],
            rate: [0.1, 0.1, 0.025],
            integral: [8.0, 4.0],
        }),
    }
}
