//! Derivatives of one step: by dual numbers, the witness of everything else, and by a compiled program, faster.

use super::Scalar;
use super::program::{Program, Workspace};
use super::system::System;
use super::trace::{Recording, Trace};
use crate::error::Result;
use nalgebra::{DMatrix, DVector};
use num_dual::Dual64;

/// A = ∂x⁺/∂x, B = ∂x⁺/∂u, C = ∂x⁺/∂θ and x⁺ itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Linearisation {
    /// x⁺.
    pub next: DVector<f64>,
    /// n × n.
    pub state: DMatrix<f64>,
    /// n × m.
    pub input: DMatrix<f64>,
    /// n × p.
    pub parameters: DMatrix<f64>,
}

/// Scratch of [`jacobian`]; made once, reused without allocation.
#[derive(Debug, Clone)]
pub struct JacobianScratch {
    arguments: Vec<Dual64>,
    next: Vec<Dual64>,
}

impl JacobianScratch {
    /// For one system.
    pub fn new<F: System>(system: &F) -> Self {
        let n = system.n_state() + system.n_input() + system.n_parameter();
        Self { arguments: vec![Dual64::from(0.0); n], next: vec![Dual64::from(0.0); system.n_state()] }
    }
}

/// The Jacobian of one step with respect to [x; u; θ], column-major n × (n + m + p) into `jacobian`, one `Dual64` pass
/// per column: faster than one wide dual pass, whose numbers do not stay in registers.
///
/// # Panics
/// If a slice does not have the system's length.
pub fn jacobian<F: System>(
    system: &F,
    state: &[f64],
    input: &[f64],
    parameters: &[f64],
    scratch: &mut JacobianScratch,
    jacobian: &mut [f64],
) {
    let (n, m, p) = (system.n_state(), system.n_input(), system.n_parameter());
    assert_eq!((state.len(), input.len(), parameters.len()), (n, m, p), "lengths of state, input and parameters");
    assert_eq!(jacobian.len(), n * (n + m + p), "length of the jacobian");
    for (argument, value) in scratch.arguments.iter_mut().zip(state.iter().chain(input).chain(parameters)) {
        *argument = Dual64::from(*value);
    }
    for (k, column) in jacobian.chunks_exact_mut(n).enumerate() {
        scratch.arguments[k].eps = 1.0;
        let (x, rest) = scratch.arguments.split_at(n);
        let (u, theta) = rest.split_at(m);
        system.step(x, u, theta, &mut scratch.next);
        scratch.arguments[k].eps = 0.0;
        for (entry, value) in column.iter_mut().zip(&scratch.next) {
            *entry = value.eps;
        }
    }
}

/// The Jacobian of one step as a program: recorded once, faster than duals from then on.
///
/// One reverse sweep per state on one graph, so that zeros cost nothing and the value is computed once.
#[derive(Debug, Clone)]
pub struct CompiledJacobian {
    program: Program,
    workspace: Workspace,
    arguments: Vec<f64>,
}

impl CompiledJacobian {
    /// Records the step of a system and compiles its Jacobian with respect to [x; u; θ].
    ///
    /// # Errors
    /// [`Error::Limit`](crate::error::Error::Limit) if the recording is too large.
    pub fn new<F: System>(system: &F) -> Result<Self> {
        let (n, m, p) = (system.n_state(), system.n_input(), system.n_parameter());
        let recording = Recording::of(n + m + p, |z| {
            let mut next = vec![Trace::zero(); n];
            system.step(&z[..n], &z[n..n + m], &z[n + m..], &mut next);
            next
        });
        let program = Program::compile(&recording.jacobian(0..n + m + p))?;
        Ok(Self { workspace: program.workspace(), arguments: vec![0.0; n + m + p], program })
    }

    /// The Jacobian at a point, column-major n × (n + m + p), without allocation.
    ///
    /// # Panics
    /// If the three slices together, or `jacobian`, do not have the system's length.
    pub fn evaluate(&mut self, state: &[f64], input: &[f64], parameters: &[f64], jacobian: &mut [f64]) {
        let (x, rest) = self.arguments.split_at_mut(state.len());
        let (u, theta) = rest.split_at_mut(input.len());
        x.copy_from_slice(state);
        u.copy_from_slice(input);
        theta.copy_from_slice(parameters);
        self.program.evaluate(&mut self.workspace, &self.arguments, jacobian);
    }

    /// Instructions per evaluation.
    pub fn len(&self) -> usize {
        self.program.len()
    }

    /// Whether the Jacobian is constant.
    pub fn is_empty(&self) -> bool {
        self.program.is_empty()
    }
}

/// Linearises one step at a point, exactly. See [`jacobian`] for the form without allocation.
///
/// # Panics
/// If a slice does not have the system's length.
pub fn linearise<F: System>(system: &F, state: &[f64], input: &[f64], parameters: &[f64]) -> Linearisation {
    let (n, m, p) = (system.n_state(), system.n_input(), system.n_parameter());
    let mut columns = vec![0.0; n * (n + m + p)];
    jacobian(system, state, input, parameters, &mut JacobianScratch::new(system), &mut columns);
    let mut next = DVector::zeros(n);
    system.step(state, input, parameters, next.as_mut_slice());
    let block =
        |from: usize, width: usize| DMatrix::from_column_slice(n, width, &columns[n * from..n * (from + width)]);
    Linearisation { next, state: block(0, n), input: block(n, m), parameters: block(n + m, p) }
}
