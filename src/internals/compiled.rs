//! Generic functions at the types that other crates of this workspace need, compiled once, here: a crate that calls a generic
//! function compiles it again, with all that it is made of.

use autodiff::{
    Certificate, CompiledJacobian, Gradient, JacobianScratch, Objective, Recording, Rollout, Scalar, System, Trace,
    certify, jacobian, rollout::RolloutScratch,
};
use base::error::Result;
use controllers::{CascadeLaw, ClosedLoop, LawController};
use dynamics::tree::{self, FrameKinematics, Multibody};
use dynamics::{Multirotor, Plant};
use num_dual::Dual64;

/// A system whose derivatives at a point are certified.
pub trait Certified: System {
    /// [`jacobian`].
    fn jacobian(&self, point: [&[f64]; 3], scratch: &mut JacobianScratch, entries: &mut [f64]);
    /// [`certify`].
    fn certify(&self, point: [&[f64]; 3]) -> Result<Certificate>;
}

macro_rules! certified {
    ($($system:ty),+) => {$(
        impl Certified for $system {
            fn jacobian(&self, [x, u, theta]: [&[f64]; 3], scratch: &mut JacobianScratch, entries: &mut [f64]) {
                jacobian(self, x, u, theta, scratch, entries);
            }
            fn certify(&self, [x, u, theta]: [&[f64]; 3]) -> Result<Certificate> {
                certify(self, x, u, theta)
            }
        }
    )+};
}

certified!(Plant, ClosedLoop<LawController<CascadeLaw>>);

/// A system whose steps and derivatives are timed.
pub trait Timed: System {
    /// [`System::step`] without parameters.
    fn step_f64(&self, state: &[f64], input: &[f64], next: &mut [f64]);
    /// The same along one direction.
    fn step_dual(&self, state: &[Dual64], input: &[Dual64], next: &mut [Dual64]);
    /// [`jacobian`] without parameters.
    fn jacobian(&self, state: &[f64], input: &[f64], scratch: &mut JacobianScratch, entries: &mut [f64]);
    /// [`CompiledJacobian::new`].
    fn compiled_jacobian(&self) -> Result<CompiledJacobian>;
    /// A step of [x; u].
    fn recording(&self) -> Recording;
    /// Rollouts whose cost is the squared distance from the origin along the way.
    fn to_origin(&self) -> Result<Box<dyn ToOrigin>>;
}

macro_rules! timed {
    ($($system:ty),+) => {$(
        impl Timed for $system {
            fn step_f64(&self, state: &[f64], input: &[f64], next: &mut [f64]) {
                self.step(state, input, &[], next);
            }
            fn step_dual(&self, state: &[Dual64], input: &[Dual64], next: &mut [Dual64]) {
                self.step(state, input, &[], next);
            }
            fn jacobian(&self, state: &[f64], input: &[f64], scratch: &mut JacobianScratch, entries: &mut [f64]) {
                jacobian(self, state, input, &[], scratch, entries);
            }
            fn compiled_jacobian(&self) -> Result<CompiledJacobian> {
                CompiledJacobian::new(self)
            }
            fn recording(&self) -> Recording {
                let (n, m) = (self.n_state(), self.n_input());
                Recording::of(n + m, |z| {
                    let mut next = vec![Trace::zero(); n];
                    self.step(&z[..n], &z[n..], &[], &mut next);
                    next
                })
            }
            fn to_origin(&self) -> Result<Box<dyn ToOrigin>> {
                let rollout = Rollout::new(self.clone(), Distance)?;
                Ok(Box::new(Flown { scratch: rollout.scratch(), gradient: Gradient::default(), rollout }))
            }
        }
    )+};
}

timed!(Multirotor, Multibody);

/// Rollouts of [`Timed::to_origin`].
pub trait ToOrigin {
    /// [`Rollout::cost`].
    fn cost(&self, state: &[f64], inputs: &[f64]) -> f64;
    /// [`Rollout::gradient_into`].
    fn gradient(&mut self, state: &[f64], inputs: &[f64]) -> f64;
}

struct Flown<F: System> {
    rollout: Rollout<F, Distance>,
    scratch: RolloutScratch,
    gradient: Gradient,
}

impl<F: System> ToOrigin for Flown<F> {
    fn cost(&self, state: &[f64], inputs: &[f64]) -> f64 {
        self.rollout.cost(state, inputs, &[])
    }
    fn gradient(&mut self, state: &[f64], inputs: &[f64]) -> f64 {
        if self.gradient.state.is_empty() {
            self.gradient = self.rollout.gradient(state, inputs, &[]).1;
        }
        self.rollout.gradient_into(&mut self.scratch, state, inputs, &[], &mut self.gradient)
    }
}

/// Distance from the origin along the way, squared.
struct Distance;

impl Objective for Distance {
    fn stage<S: Scalar>(&self, x: &[S], _: &[S], _: &[S]) -> S {
        x[0].square() + x[1].square() + x[2].square()
    }
    fn terminal<S: Scalar>(&self, x: &[S], _: &[S]) -> S {
        x[0].square() + x[1].square() + x[2].square()
    }
}

/// [`System::step`] of a plant without parameters.
pub fn step_plant(plant: &Plant, state: &[f64], input: &[f64], next: &mut [f64]) {
    plant.step(state, input, &[], next);
}

/// [`tree::contact_forces`].
pub fn contact_forces(system: &Multibody, state: &[f64]) -> Vec<[f64; 3]> {
    tree::contact_forces(system, state)
}

/// [`tree::kinetic_energy`] and [`tree::potential_energy`], J.
pub fn energies(system: &Multibody, state: &[f64]) -> [f64; 2] {
    [tree::kinetic_energy(system, state), tree::potential_energy(system, state)]
}

/// [`tree::body_poses`].
pub fn body_poses(system: &Multibody, state: &[f64]) -> Vec<FrameKinematics<f64>> {
    tree::body_poses(system, state)
}
