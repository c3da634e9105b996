//! Systems, flights and bounds that several modules share.

use crate::common::tree::stream;
use omnidrones::autodiff::System;
use omnidrones::dynamics::configurations::REGISTRY;
use omnidrones::dynamics::tree::{Model, ModelParts, Motion, Multibody, kinetic_energy, potential_energy};
use omnidrones::dynamics::{Effects, Integrator, Physics};

pub use crate::common::measure::{at_most, near};

pub fn rk4(dt: f64, effects: Effects) -> Physics {
    Physics { dt, substeps: 1, integrator: Integrator::RungeKutta4, effects }
}

pub fn semi_implicit(dt: f64, effects: Effects) -> Physics {
    Physics { integrator: Integrator::SemiImplicit, ..rk4(dt, effects) }
}

/// Every built-in configuration.
pub fn configurations() -> impl Iterator<Item = (&'static str, Model)> {
    REGISTRY.iter().map(|entry| (entry.name, (entry.build)().unwrap()))
}

pub fn configuration(name: &str) -> Model {
    omnidrones::dynamics::configurations::by_name(name).unwrap()
}

pub fn floats(model: &Model) -> bool {
    model.bodies()[0].joint.motion == Motion::Floating
}

/// A model with its parts changed.
pub fn changed(model: &Model, change: impl FnOnce(&mut ModelParts)) -> Model {
    let mut parts = model.parts().clone();
    change(&mut parts);
    Model::new(parts).unwrap()
}

/// Without drives and stops.
pub fn loose(model: &Model) -> Model {
    changed(model, |parts| {
        for body in &mut parts.bodies {
            (body.joint.drive, body.joint.limits) = (None, None);
        }
    })
}

/// Without rotors.
pub fn still(model: &Model) -> Model {
    changed(model, |parts| {
        parts.rotors.clear();
        parts.drones.clear();
    })
}

/// Without gravity.
pub fn weightless(model: &Model) -> Model {
    changed(model, |parts| parts.gravity = 0.0)
}

/// What only inertia and springs move.
pub fn bare(model: &Model) -> Model {
    changed(&weightless(&still(&loose(model))), |parts| parts.bodies.iter_mut().for_each(|b| b.joint.damping = 0.0))
}

/// The rest state set in moderate motion: 0.4 m/s and up to 0.8 rad/s of the root, hinges bent by up to 0.4 and turning
/// at up to `rate` rad/s (a slide m/s).
pub fn in_motion(system: &Multibody, seed: u64, rate: f64) -> Vec<f64> {
    let (model, mut x) = (system.model(), system.rest_state());
    let mut r = stream(seed, 0);
    for (body, place) in model.bodies().iter().zip(&model.layout().bodies) {
        let (p, v) = (place.position, place.velocity);
        if body.joint.motion == Motion::Floating {
            x[v..v + 3].copy_from_slice(&[0.3, -0.2, 0.1]);
            x[p + 10..p + 13].copy_from_slice(&[0.5, -0.6, 0.8]);
        } else {
            x[p] += r.uniform(-0.4, 0.4);
            x[v] = r.uniform(-rate, rate);
        }
    }
    x
}

/// `steps` steps with one input.
pub fn fly(system: &Multibody, x: &mut Vec<f64>, u: &[f64], steps: usize) {
    let mut next = x.clone();
    for _ in 0..steps {
        system.step::<f64>(x, u, &[], &mut next);
        std::mem::swap(x, &mut next);
    }
}

pub fn energy(system: &Multibody, x: &[f64]) -> f64 {
    kinetic_energy(system, x) + potential_energy(system, x)
}

pub fn norm(v: &[f64]) -> f64 {
    v.iter().map(|v| v * v).sum::<f64>().sqrt()
}

pub fn apart(a: &[f64], b: &[f64]) -> f64 {
    norm(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>())
}
