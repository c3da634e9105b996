//! What several test files share: random states, actions and effects, from seeds that failures print.
#![allow(dead_code, unused_imports)] // each test file uses its part

use omnidrones::dynamics::{Effects, Integrator, Physics, Vehicle, vehicles};
use omnidrones::rng::{Purpose, Stream};

pub mod geometry;
pub mod measure;
pub mod tree;
pub use measure::relative;

pub const INTEGRATORS: [Integrator; 2] = [Integrator::RungeKutta4, Integrator::SemiImplicit];

/// Every set of effects that batches and rollouts are used with.
pub fn effects() -> [(&'static str, Effects); 4] {
    [("none", Effects::none()), ("lean", Effects::lean()), ("default", Effects::default()), ("all", Effects::all())]
}

/// Every vehicle with its effects and integrators, under a name that failures print.
pub fn cases() -> Vec<(String, Vehicle, Physics)> {
    let mut cases = Vec::new();
    for vehicle in vehicles::all() {
        for integrator in INTEGRATORS {
            for (name, effects) in effects() {
                let physics = Physics { integrator, effects, ..Physics::default() };
                cases.push((format!("{} {integrator:?} effects {name}", vehicle.name), airframe(&vehicle), physics));
            }
        }
    }
    cases
}

/// The vehicle with airframe drag and rolling moment where it has none, so that no effect is idle.
pub fn airframe(vehicle: &Vehicle) -> Vehicle {
    let mut v = vehicle.clone();
    let mass = v.mass_properties().mass;
    let inertia = v.mass_properties().inertia;
    v.drag.linear = [0.2 * mass, 0.15 * mass, 0.25 * mass];
    v.drag.quadratic = [0.02 * mass, 0.03 * mass, 0.05 * mass];
    v.drag.angular = [0.2 * inertia[(0, 0)], 0.2 * inertia[(1, 1)], 0.3 * inertia[(2, 2)]];
    for rotor in &mut v.rotors {
        rotor.rolling_coefficient = rotor.rolling_coefficient.max(0.01 * rotor.drag_coefficient);
    }
    v
}

pub fn stream(seed: u64, case: u64) -> Stream {
    Stream::new(seed, case, 0, Purpose::user(77))
}

/// A state in flight: within 3 m and above the ground's reach, 3 m/s, any attitude, 3 rad/s, rotors at 10 to 95 %.
pub fn state(vehicle: &Vehicle, r: &mut Stream) -> Vec<f64> {
    let mut x = vec![r.uniform(-3.0, 3.0), r.uniform(-3.0, 3.0), r.uniform(1.0, 4.0)];
    x.extend((0..3).map(|_| r.uniform(-3.0, 3.0)));
    let q: Vec<f64> = (0..4).map(|_| r.normal()).collect();
    let norm = q.iter().map(|q| q * q).sum::<f64>().sqrt();
    x.extend(q.iter().map(|q| q / norm));
    x.extend((0..3).map(|_| r.uniform(-3.0, 3.0)));
    x.extend(vehicle.rotors.iter().map(|rotor| rotor.max_speed * r.uniform(0.1, 0.95)));
    x
}

/// Actions within [−0.95, 0.95], then wind, force and moment where the effects ask for them.
pub fn input(vehicle: &Vehicle, physics: &Physics, r: &mut Stream) -> Vec<f64> {
    let mut u: Vec<f64> = vehicle.rotors.iter().map(|_| r.uniform(-0.95, 0.95)).collect();
    if physics.effects.disturbance {
        let total = vehicle.mass_properties();
        u.extend((0..3).map(|_| r.uniform(-4.0, 4.0)));
        u.extend((0..3).map(|_| r.uniform(-2.0, 2.0) * total.mass));
        u.extend((0..3).map(|k| r.uniform(-3.0, 3.0) * total.inertia[(k, k)]));
    }
    u
}
