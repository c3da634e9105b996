//! Derivatives of one step: by dual numbers, the witness of everything else, and by a compiled program, faster.

use super::Scalar;
use super::program::{Program, Workspace};
use super::sweep::{RowsScratch, Sweep};
use super::system::System;
use super::trace::chain::EdgeCost;
use super::trace::{Recording, Trace};
use base::error::Result;
use nalgebra::{DMatrix, DVector};
use num_dual::Dual64;

/// A = ∂x⁺/∂x, B = ∂x⁺/∂u, C = ∂x⁺/∂θ and x⁺ itself, of a step with n states, m inputs and p parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Linearisation {
    /// x⁺, n.
    pub next: DVector<f64>,
    /// A = ∂x⁺/∂x, n × n.
    pub state: DMatrix<f64>,
    /// B = ∂x⁺/∂u, n × m.
    pub input: DMatrix<f64>,
    /// C = ∂x⁺/∂θ, n × p.
    pub parameters: DMatrix<f64>,
}

/// Scratch of [`jacobian`]; made once, reused without allocation.
#[derive(Debug, Clone)]
pub struct JacobianScratch {
    arguments: Vec<Dual64>,
    next: Vec<Dual64>,
}

impl JacobianScratch {
    /// For a system, or another of the same sizes.
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

/// The Jacobian of one step as a program: recorded once, ten to forty times as fast as duals from then on as machine code, eight to
/// sixteen times interpreted.
///
/// ∂x⁺/∂z at z = [x; u; θ]: values and partial derivatives of all operations first, once; then the chain rule over them
/// backwards, for all rows at once (Griewank and Walther 2008, chapters 9 and 10). The bits are the same on every machine, but where a
/// partial derivative is not finite: which entries are NaN then is left open. Where the system calls a custom function it is one
/// reverse sweep per state on one graph.
///
/// ```
/// # use omnidrones_autodiff::omnidrones;
/// use omnidrones::autodiff::{CompiledJacobian, Scalar, System, linearise};
///
/// /// 10 ms of a pendulum of 1 m that a torque swings.
/// struct Pendulum;
/// impl System for Pendulum {
///     fn n_state(&self) -> usize {
///         2
///     }
///     fn n_input(&self) -> usize {
///         1
///     }
///     fn step<S: Scalar>(&self, x: &[S], u: &[S], _: &[S], next: &mut [S]) {
///         let rate = x[1] + S::constant(0.01) * (u[0] - S::constant(9.81) * x[0].sin_cos().0);
///         (next[0], next[1]) = (x[0] + S::constant(0.01) * rate, rate);
///     }
/// }
///
/// let mut columns = [0.0; 2 * 3];
/// CompiledJacobian::new(&Pendulum)?.evaluate(&[0.3, 0.0], &[0.1], &[], &mut columns);
/// let a = linearise(&Pendulum, &[0.3, 0.0], &[0.1], &[]).state;
/// assert!(columns.iter().zip(&a).all(|(c, d)| (c - d).abs() < 1e-12));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct CompiledJacobian {
    way: Way,
    arguments: Vec<f64>,
}

#[derive(Debug, Clone)]
enum Way {
    Rows(Box<(Sweep, RowsScratch)>),
    /// With custom functions.
    Entries(Box<(Program, Workspace)>),
}

/// Measured best; a vehicle and a tree differ by a twentieth at most between 0.7 and 1.2, 1 and 2.
const PRICE: EdgeCost = EdgeCost { product: 1.0, vertex: 1.5, few: 24 };

impl CompiledJacobian {
    /// Records the step of a system and compiles its Jacobian with respect to [x; u; θ].
    ///
    /// # Errors
    /// [`Error::Limit`](base::error::Error::Limit) if the recording is too large.
    pub fn new<F: System>(system: &F) -> Result<Self> {
        let (n, m, p) = (system.n_state(), system.n_input(), system.n_parameter());
        let recording = Recording::of(n + m + p, |z| {
            let mut next = vec![Trace::zero(); n];
            system.step(&z[..n], &z[n..n + m], &z[n + m..], &mut next);
            next
        });
        let way = match Sweep::with_rows(&recording, 0..n + m + p, PRICE)? {
            Some(own) => Way::Rows(Box::new(own)),
            None => {
                let program = Program::compile_single(&recording.jacobian(0..n + m + p))?;
                let workspace = program.workspace();
                Way::Entries(Box::new((program, workspace)))
            }
        };
        Ok(Self { way, arguments: vec![0.0; n + m + p] })
    }

    /// The Jacobian at a point, column-major n × (n + m + p), without allocation.
    ///
    /// # Panics
    /// If the three slices together have not n + m + p numbers, or `jacobian` not n (n + m + p). Where slices are cut among themselves is
    /// not checked.
    pub fn evaluate(&mut self, state: &[f64], input: &[f64], parameters: &[f64], jacobian: &mut [f64]) {
        let (x, rest) = self.arguments.split_at_mut(state.len());
        let (u, theta) = rest.split_at_mut(input.len());
        x.copy_from_slice(state);
        u.copy_from_slice(input);
        theta.copy_from_slice(parameters);
        match &mut self.way {
            Way::Rows(own) => own.0.jacobian(&mut own.1, &self.arguments, jacobian),
            Way::Entries(own) => own.0.evaluate(&mut own.1, &self.arguments, jacobian),
        }
    }

    /// Number of instructions and multiplications per evaluation.
    pub fn len(&self) -> usize {
        match &self.way {
            Way::Rows(own) => own.0.len(),
            Way::Entries(own) => own.0.len(),
        }
    }

    /// Whether the Jacobian is constant.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Linearises one step at a point, exactly, by duals. To record a step costs what some hundred of its Jacobians do: for more points
/// than that, [`CompiledJacobian`]. See [`jacobian`] for the form without allocation.
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
