//! A model under given physics as a [`System`]: x⁺ = f(x, u, θ) on any scalar.

use super::model::{Model, rest_state};
use super::parameters::{Source, model_parameters};
use super::scratch::scratch_on_stack;
use super::step::{self, Task};
use super::topology::Topology;
use crate::multirotor::Physics;
use autodiff::compiled_once::{Arguments, CompiledOnce};
use autodiff::{Scalar, System};
use base::error::{Error, Result};

/// An articulated system of bodies, joints, drives and rotors.
///
/// State and input: see [`Layout`](super::Layout). Parameters: none, or with [`Multibody::with_parameters`] the vector of
/// `model_parameters`.
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
            numbers: model_parameters(model),
            topology: Topology::new(model, physics.effects, physics.grid(), false),
            model: model.clone(),
            physics,
            exposes_parameters: false,
        })
    }

    /// The same system with its physical parameters as θ; pass [`Multibody::parameters`] to `step`.
    pub fn with_parameters(mut self) -> Self {
        self.exposes_parameters = true;
        // a parameter that is zero now may be varied, so nothing may be left out
        self.topology = Topology::new(&self.model, self.physics.effects, self.physics.grid(), true);
        self
    }

    /// Nominal physical parameters, SI: `model_parameters` of the model, whose names [`Plant::parameter_names`](crate::Plant) lists.
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

    /// [`rest_state`] of the model, `[n_state]`.
    pub fn rest_state(&self) -> Vec<f64> {
        rest_state(&self.model)
    }

    /// ẋ = f(x, u, θ) in continuous time: what a step integrates. `rate` has the layout and length of the state, in its units per second.
    ///
    /// # Panics
    /// If `state`, `input` or `rate` has another length than the layout says.
    pub fn derivative<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], rate: &mut [S]) {
        self.run(Task::Derivative, state, input, parameters, rate);
    }

    fn run<S: Scalar>(&self, task: Task, state: &[S], input: &[S], parameters: &[S], result: &mut [S]) {
        if const { S::IS_COMPILED_ONCE } {
            self.run_here(task, S::compiled_once(Arguments { state, input, parameters, result }));
        } else {
            self.run_any(task, state, input, parameters, result);
        }
    }

    /// [`run_any`](Self::run_any) where it is compiled once.
    #[inline(never)]
    fn run_here(&self, task: Task, arguments: CompiledOnce<'_>) {
        match arguments {
            CompiledOnce::Plain(a) => self.run_any(task, a.state, a.input, a.parameters, a.result),
            CompiledOnce::Dual(a) => self.run_any(task, a.state, a.input, a.parameters, a.result),
            CompiledOnce::Trace(a) => self.run_any(task, a.state, a.input, a.parameters, a.result),
        }
    }

    /// One copy per scalar: the kernels are large.
    #[inline(never)]
    fn run_any<S: Scalar>(&self, task: Task, state: &[S], input: &[S], parameters: &[S], result: &mut [S]) {
        let t = &self.topology;
        scratch_on_stack!(scratch, t, S);
        scratch.end[..t.n_state].copy_from_slice(state);
        scratch.input[..t.n_input].copy_from_slice(input);
        let constants = Source::Constants(&self.numbers);
        step::run(t, if self.exposes_parameters { Source::Values(parameters) } else { constants }, task, &mut scratch);
        let done = if task == Task::Derivative { &scratch.rate } else { &scratch.end };
        result.copy_from_slice(&done[..t.n_state]);
    }

    /// Input of still rotors (−1) and drives at their centres (0), `[n_input]`.
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
        self.run(Task::Step(self.physics.grid()), state, input, parameters, next);
    }
}
