//! A model under given physics as a [`System`]: x⁺ = f(x, u, θ) on any scalar.

use super::model::{Model, Motion};
use super::numbers::{Constants, Values, number_vector};
use super::scratch::scratch_on_stack;
use super::step;
use super::topology::Topology;
use crate::autodiff::{Scalar, System};
use crate::dynamics::multirotor::Physics;
use crate::dynamics::spatial::from_matrix;
use crate::error::{Error, Result};

/// An articulated system of bodies, joints, drives and rotors.
///
/// State and input: see [`Layout`](super::Layout). Parameters: none, or with [`Multibody::with_parameters`] the vector of
/// [`number_vector`].
#[derive(Debug, Clone)]
pub struct Multibody {
    model: Model,
    physics: Physics,
    numbers: Vec<f64>,
    topology: Topology,
    exposes_parameters: bool,
}

impl Multibody {
    /// The model under given physics.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] when the physics are not valid.
    pub fn new(model: &Model, physics: Physics) -> Result<Self> {
        physics.validate()?;
        Ok(Self {
            numbers: number_vector(model),
            topology: Topology::new(model, physics.effects, false),
            model: model.clone(),
            physics,
            exposes_parameters: false,
        })
    }

    /// The same system with its physical parameters as θ; pass [`Multibody::parameters`] to `step`.
    pub fn with_parameters(mut self) -> Self {
        self.exposes_parameters = true;
        // a parameter that is zero now may be varied, so nothing may be left out
        self.topology = Topology::new(&self.model, self.physics.effects, true);
        self
    }

    /// Nominal physical parameters: [`number_vector`] of the model.
    pub fn parameters(&self) -> &[f64] {
        &self.numbers
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Time step, integrator and effects.
    pub fn physics(&self) -> &Physics {
        &self.physics
    }

    /// Places of all numbers in state and input, disturbances included.
    pub fn layout(&self) -> &super::Layout {
        &self.topology.layout
    }

    pub(crate) fn topology(&self) -> &Topology {
        &self.topology
    }

    /// Every joint at rest (springs relaxed, drives at their centre, else zero), every floating root where its joint says
    /// (the world's origin, upright, unless it was placed), rotors still.
    pub fn rest_state(&self) -> Vec<f64> {
        let mut x = vec![0.0; self.topology.n_state];
        for (body, place) in self.model.bodies().iter().zip(&self.topology.layout.bodies) {
            let joint = &body.joint;
            match joint.motion {
                Motion::Floating => {
                    x[place.position..place.position + 3].copy_from_slice(&joint.position);
                    x[place.position + 6..place.position + 10].copy_from_slice(&from_matrix(joint.rotation));
                }
                Motion::Ball => x[place.position] = 1.0,
                Motion::Revolute(_) | Motion::Prismatic(_) => {
                    x[place.position] = match joint.drive {
                        Some(drive) if drive.stiffness > 0.0 => drive.center,
                        _ => joint.rest,
                    };
                }
            }
        }
        x
    }

    /// Accelerations and all else: ẋ = f(x, u, θ) in continuous time. `rate` has the layout of the state.
    pub fn derivative<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], rate: &mut [S]) {
        scratch_on_stack!(scratch, &self.topology, S);
        if self.exposes_parameters {
            step::derivative(&self.topology, Values(parameters), state, input, &mut scratch, rate);
        } else {
            step::derivative(&self.topology, Constants(&self.numbers), state, input, &mut scratch, rate);
        }
    }

    /// Input of still rotors and drives at their centres.
    pub fn rest_input(&self) -> Vec<f64> {
        let mut u = vec![0.0; self.topology.n_input];
        for at in &self.topology.layout.rotor_action {
            u[*at] = -1.0;
        }
        u
    }

    /// Checks the length of a state or input.
    pub(crate) fn check_length(what: &str, got: usize, wanted: usize) -> Result<()> {
        if got == wanted {
            return Ok(());
        }
        let remedy = "See Layout for the order of the numbers.";
        Err(Error::value(format!("length of {what}"), got, wanted.to_string(), remedy))
    }
}

impl System for Multibody {
    fn n_state(&self) -> usize {
        self.topology.n_state
    }
    fn n_input(&self) -> usize {
        self.topology.n_input
    }
    fn n_parameter(&self) -> usize {
        if self.exposes_parameters { self.numbers.len() } else { 0 }
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], next: &mut [S]) {
        scratch_on_stack!(scratch, &self.topology, S);
        let (t, grid) = (&self.topology, self.physics.grid());
        scratch.end[..t.n_state].copy_from_slice(state);
        scratch.input[..t.n_input].copy_from_slice(input);
        if self.exposes_parameters {
            step::step_in_place(t, Values(parameters), grid, &mut scratch);
        } else {
            step::step_in_place(t, Constants(&self.numbers), grid, &mut scratch);
        }
        next.copy_from_slice(&scratch.end[..t.n_state]);
    }
}
