//! What tests of several rooms fly without commands.

use super::multibody::Multibody;
use super::{kinetic_energy, potential_energy};
use autodiff::System;

/// Steps `x` on for so long with all rotors at their least, and shows every state.
pub(crate) fn run(system: &Multibody, x: &mut Vec<f64>, seconds: f64, each: &mut dyn FnMut(&[f64])) {
    let (input, mut next) = (vec![-1.0; system.n_input()], x.clone());
    for _ in 0..(seconds / system.physics().dt).round() as usize {
        system.step(x, &input, &[], &mut next);
        std::mem::swap(x, &mut next);
        each(x);
    }
}

/// Kinetic and potential, J.
pub(crate) fn energy(system: &Multibody, x: &[f64]) -> f64 {
    kinetic_energy(system, x) + potential_energy(system, x)
}
