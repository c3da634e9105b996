//! AscTec Neo with 11-inch rotors: a hexarotor of 3.45 kg whose rotors lean 5° to gain yaw authority.
//!
//! | constant | value | source |
//! |---|---|---|
//! | base mass, inertia | 3.42 kg, (0.060887, 0.0687913, 0.1296783) kg m² | \[USD\] |
//! | rotors | 6 × 0.005 kg, positions and axes in the code, 0.028 m up, radius 0.1397 m | \[USD\] |
//! | k_f, κ, Ω_max | 1.269e-5 N s²/rad², 0.016754 m, 1047.2 rad/s | RotorS, OmniDrones YAML |
//! | τ up / down | 0.0182 / 0.0182 s | RotorS |
//! | rotor drag, rolling | 2.0673e-4, 0 | RotorS |
//! | body drag | 0 | no source |
//! | gains | K_p (8, 8, 17), K_v (6, 6, 10), K_R (4, 4, 2), K_ω 0.7 | RotorS Lee controller |
//!
//! DIFFERENCE
//! - The published Izz, 0.148916, exceeds Ixx + Iyy = 0.1296783: no body has such an inertia. The largest possible,
//!   Ixx + Iyy (all mass in one plane), is used; roll and pitch are as published.
//! - OmniDrones' mixer ignores the tilt and the height of the rotors (defect 9). Here the axes are in the allocation:
//!   a rotor of unit thrust yaws with 0.025 m from its lean on top of κ = 0.0168 m, always in the same sense.
//! - The published axes have four digits (length 0.99995); they are normalised here.
//! - YAML mass 3.42 kg is the base link's; the parts sum to 3.45 kg (defects 5, 6). The YAML inertia
//!   (0.0608, 0.0688, 0.1489) is the published one, rounded.
//! - κ is the YAML's k_m/k_f = 2.12608256333624e-7/1.269e-5.
//! - Rotor inertia 8.2e-6 kg m², a tenth of the published 8.225e-5 (defect 4).

use super::{Blade, with_blades};
use crate::dynamics::shape::{Geometry, Shape};
use crate::dynamics::vehicle::{Drag, Gains, Inertia, Part, Rotor, Vehicle};

const IXX: f64 = 0.060887;
const IYY: f64 = 0.0687913;
const BLADE: Blade = Blade::rotors(0.005, 0.1397);

/// Position, axis (not yet of unit length) and spin of `rotor_0` …, counter-clockwise from the front left.
const LAYOUT: [([f64; 3], [f64; 3], f64); 6] = [
    ([0.247, 0.1506, 0.028], [0.0436, -0.0755, 0.9962], 1.0),
    ([-0.00067, 0.28929, 0.028], [-0.0872, 0.0, 0.9962], -1.0),
    ([-0.2501, 0.1454, 0.028], [0.0436, 0.0755, 0.9962], 1.0),
    ([-0.2501, -0.1454, 0.028], [0.0436, -0.0755, 0.9962], -1.0),
    ([-0.00067, -0.28929, 0.028], [-0.0872, 0.0, 0.9962], 1.0),
    ([0.247, -0.1506, 0.028], [0.0436, 0.0755, 0.9962], -1.0),
];

/// Builds the vehicle.
pub fn vehicle() -> Vehicle {
    let rotors: Vec<Rotor> = (LAYOUT.iter().enumerate())
        .map(|(i, &(position, axis, spin))| Rotor {
            name: format!("rotor_{i}"),
            position,
            axis: nalgebra::Vector3::from(axis).normalize().into(),
            spin,
            thrust_coefficient: 1.269e-5,
            moment_per_thrust: 2.12608256333624e-7 / 1.269e-5,
            max_speed: 1047.2,
            time_constant_up: 0.0182,
            time_constant_down: 0.0182,
            inertia: BLADE.axial(),
            radius: 0.1397,
            drag_coefficient: 2.0673e-4,
            axial_drag_coefficient: 0.0,
            rolling_coefficient: 0.0,
        })
        .collect();
    Vehicle {
        name: "neo11".into(),
        source: "OmniDrones neo11 USD and YAML; RotorS neo11".into(),
        parts: with_blades(
            vec![Part::new("base_link", 3.42, [0.0; 3], Inertia::diagonal(IXX, IYY, IXX + IYY))],
            &rotors,
            BLADE,
        ),
        rotors,
        drag: Drag::default(),
        shapes: vec![Shape::new(Geometry::Box { size: [0.2, 0.2, 0.234] })],
        published_gains: Some(Gains {
            position: [8.0, 8.0, 17.0],
            velocity: [6.0, 6.0, 10.0],
            attitude: [4.0, 4.0, 2.0],
            rate: [0.7; 3],
            integral: [2.0, 8.0],
        }),
    }
}
