//! Random vehicles: geometries that nobody drew, from a seed.

use omnidrones::dynamics::{Inertia, Part, Rotor, Vehicle};
use omnidrones::rng::{Purpose, Stream};
use std::f64::consts::TAU;

/// A vehicle of 4 to 8 rotors on a ring that is out of true: places, axes (up to 8°), thrusts, spins, masses and the load's place are
/// drawn. Whether it balances and can be steered is its own affair.
pub fn vehicle(seed: u64) -> Vehicle {
    let mut r = Stream::new(seed, 0, 0, Purpose::user(91));
    let n = 4 + r.below(5) as usize;
    let arm = 0.05 * 10.0_f64.powf(r.unit());
    let mass = 20.0 * arm.powi(2) * r.uniform(0.7, 1.5);
    let most = mass * 9.81 * r.uniform(1.7, 3.5) / n as f64;
    let (turn, crooked) = (r.uniform(0.0, TAU), r.below(2) == 0);
    let max_speed = 900.0 * (0.2 / arm).sqrt();
    let rotors = (0..n).map(|i| {
        let angle = turn + (i as f64 + r.uniform(-0.15, 0.15)) * TAU / n as f64;
        let radius = arm * r.uniform(0.85, 1.15);
        let lean = if crooked { r.uniform(0.0, 8.0_f64.to_radians()) } else { 0.0 };
        let about = r.uniform(0.0, TAU);
        let against = r.below(10) == 0 && n > 4;
        let own = most * r.uniform(0.9, 1.1);
        Rotor {
            name: format!("rotor_{i}"),
            position: [radius * angle.cos(), radius * angle.sin(), arm * r.uniform(-0.1, 0.1)],
            axis: [lean.sin() * about.cos(), lean.sin() * about.sin(), lean.cos()],
            spin: if (i % 2 == 0) != against { 1.0 } else { -1.0 },
            thrust_coefficient: own / max_speed.powi(2),
            moment_per_thrust: 0.08 * arm * r.uniform(0.7, 1.3),
            max_speed,
            time_constant_up: r.uniform(0.01, 0.03),
            time_constant_down: r.uniform(0.01, 0.04),
            inertia: 0.0,
            radius: 0.0,
            drag_coefficient: 0.0,
            axial_drag_coefficient: 0.0,
            rolling_coefficient: 0.0,
        }
    });
    let rotors = rotors.collect();
    let [x, y] = [0, 1].map(|_| mass * (arm * r.uniform(0.3, 0.5)).powi(2));
    let inertia = Inertia::diagonal(x, y, (x + y) * r.uniform(0.7, 0.95));
    let load = r.uniform(0.0, 0.7) * arm;
    let about = r.uniform(0.0, TAU);
    let position = [load * about.cos(), load * about.sin(), arm * r.uniform(-0.2, 0.2)];
    Vehicle {
        name: format!("random_{seed}"),
        source: "drawn".into(),
        parts: vec![Part::new("frame", mass, position, inertia)],
        rotors,
        drag: Default::default(),
        shapes: Vec::new(),
        published_gains: None,
    }
}

/// Hummingbird-like: four upright rotors on arms of 0.15 m, 1 kg.
pub fn quadrotor() -> Vehicle {
    let places = [[0.15, -0.15], [-0.15, 0.15], [0.15, 0.15], [-0.15, -0.15]];
    let rotors = places.iter().enumerate().map(|(i, [x, y])| Rotor {
        name: format!("m{i}"),
        position: [*x, *y, 0.0],
        axis: [0.0, 0.0, 1.0],
        spin: if i < 2 { 1.0 } else { -1.0 },
        thrust_coefficient: 8e-6,
        moment_per_thrust: 0.016,
        max_speed: 900.0,
        time_constant_up: 0.015,
        time_constant_down: 0.025,
        inertia: 0.0,
        radius: 0.0,
        drag_coefficient: 0.0,
        axial_drag_coefficient: 0.0,
        rolling_coefficient: 0.0,
    });
    Vehicle {
        name: "quadrotor".into(),
        source: "drawn".into(),
        parts: vec![Part::new("frame", 1.0, [0.0; 3], Inertia::diagonal(0.008, 0.008, 0.014))],
        rotors: rotors.collect(),
        drag: Default::default(),
        shapes: Vec::new(),
        published_gains: None,
    }
}

/// Six upright rotors on arms of 0.3 m under a load of 2.9 kg at `x`, `y`.
pub fn loaded_hexarotor(x: f64, y: f64) -> Vehicle {
    let mut vehicle = quadrotor();
    let rotor = vehicle.rotors[0].clone();
    vehicle.rotors = (0..6)
        .map(|i| {
            let angle = (i as f64 + 0.5) * TAU / 6.0;
            let spin = if i % 2 == 0 { 1.0 } else { -1.0 };
            let position = [0.3 * angle.cos(), 0.3 * angle.sin(), 0.0];
            Rotor { name: format!("r{i}"), position, spin, ..rotor.clone() }
        })
        .collect();
    vehicle.parts = vec![Part::new("frame", 2.9, [x, y, 0.0], Inertia::diagonal(0.04, 0.04, 0.07))];
    vehicle
}

/// The mirror image at the plane y = 0: spins change their sense.
pub fn mirrored(vehicle: &Vehicle) -> Vehicle {
    let mut vehicle = vehicle.clone();
    for part in &mut vehicle.parts {
        part.position[1] *= -1.0;
        (part.inertia.xy, part.inertia.yz) = (-part.inertia.xy, -part.inertia.yz);
    }
    for rotor in &mut vehicle.rotors {
        rotor.position[1] *= -1.0;
        rotor.axis[1] *= -1.0;
        rotor.spin *= -1.0;
    }
    vehicle
}
