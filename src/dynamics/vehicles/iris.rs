//! 3DR Iris: an X-quadrotor of 1.52 kg, wider than long.
//!
//! | constant | value | source |
//! |---|---|---|
//! | base mass, inertia | 1.5 kg, (0.0347563, 0.0458929, 0.0806492) kg m² | RotorS `iris.xacro` |
//! | rotors | 4 × 0.005 kg at (0.13, ∓0.22), (−0.13, ±0.20), 0.023 m up, radius 0.1 m | RotorS `iris.xacro` |
//! | k_f, κ, Ω_max | 8.54858e-6 N s²/rad², 0.016 m, 838 rad/s | RotorS, OmniDrones YAML |
//! | τ up / down | 0.0125 / 0.025 s | RotorS |
//! | rotor drag, rolling | 8.06428e-5, 1e-6 | RotorS |
//! | body drag | 0 | no source |
//! | gains | K_p 6, K_v 4.7, K_R (2, 3, 0.15), K_ω (0.4, 0.52, 0.18) | RotorS Lee controller |
//!
//! DIFFERENCE
//! - The published Izz, 0.0977, exceeds Ixx + Iyy = 0.0806492: no body has such an inertia. The largest possible,
//!   Ixx + Iyy (all mass in one plane), is used; roll and pitch are as published.
//! - The rotor angles in OmniDrones' YAML and in RotorS's controller file have x and y swapped (0.533708 =
//!   atan(0.13/0.22)): their allocation believes in a roll lever of 0.13 m and a pitch lever of 0.20–0.22 m, so it
//!   rolls 1.6 times too hard and pitches at 0.6 (defect 7). Here all levers come from the positions.
//! - The inertia is Firefly's, copied by RotorS with its flaw. PX4's Gazebo model has (0.029125, 0.029125, 0.055225) for the same
//!   1.5 kg. RotorS's is kept: the published gains belong to it.
//! - A second Iris in RotorS (`rotors_gazebo/models`, 1100 rad/s, κ 0.06) is another vehicle.
//! - OmniDrones ships no gains for it and cannot fly it; these are RotorS's.
//! - Rotor inertia 4.26e-6 kg m², a tenth of the published 4.26e-5 (defect 4); total mass throughout (defect 5).

use super::{Blade, with_blades};
use crate::dynamics::shape::{Geometry, Shape};
use crate::dynamics::vehicle::{Drag, Gains, Inertia, Part, Rotor, Vehicle};

const IXX: f64 = 0.0347563;
const IYY: f64 = 0.0458929;
const BLADE: Blade = Blade::rotors(0.005, 0.1);

/// (x, y, spin) of `rotor_0` …: front right, back left, front left, back right.
const LAYOUT: [(f64, f64, f64); 4] = [(0.13, -0.22, 1.0), (-0.13, 0.20, 1.0), (0.13, 0.22, -1.0), (-0.13, -0.20, -1.0)];

/// Builds the vehicle.
pub fn vehicle() -> Vehicle {
    let rotors: Vec<Rotor> = (LAYOUT.iter().enumerate())
        .map(|(i, &(x, y, spin))| Rotor {
            name: format!("rotor_{i}"),
            position: [x, y, 0.023],
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
        name: "iris".into(),
        source: "RotorS iris.xacro; gains RotorS lee_controller_iris.yaml".into(),
        parts: with_blades(
            vec![Part::new("base_link", 1.5, [0.0; 3], Inertia::diagonal(IXX, IYY, IXX + IYY))],
            &rotors,
            BLADE,
        ),
        rotors,
        drag: Drag::default(),
        shapes: vec![Shape::new(Geometry::Box { size: [0.47, 0.47, 0.11] })],
        published_gains: Some(Gains {
            position: [6.0; 3],
            velocity: [4.7; 3],
            attitude: [2.0, 3.0, 0.15],
            rate: [0.4, 0.52, 0.18],
            integral: [4.0, 4.0],
        }),
    }
}
