//! A gradient certificate for any system: adjoint against duals against central differences, with the Taylor order.
//!
//! Three independent derivations must agree at a point: the adjoint program (symbolic, reverse), duals (forward) and
//! central differences (no derivative code at all). The Taylor remainder ‖f(z + hd) − f(z) − h J d‖ must fall with h²;
//! a wrong derivative leaves h¹, a kink within h too.

use super::derivative::{JacobianScratch, jacobian};
use super::program::Program;
use super::system::System;
use super::trace::{Recording, Trace};
use super::{Scalar, system};
use crate::error::{Error, Result};
use std::fmt;

/// What a certificate may not exceed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Adjoint against duals, relative to max(1, ‖J‖).
    pub adjoint: f64,
    /// Duals against central differences, relative to max(1, ‖J‖).
    pub difference: f64,
    /// Distance of the Taylor order from 2.
    pub taylor: f64,
}

impl Default for Bounds {
    fn default() -> Self {
        Self { adjoint: 1e-10, difference: 1e-6, taylor: 0.1 }
    }
}

/// How well three derivations of one step's Jacobian agree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Certificate {
    /// Largest |adjoint − dual| over all entries, relative to max(1, ‖J‖∞).
    pub adjoint_error: f64,
    /// Largest |dual − central difference|, relative to max(1, ‖J‖∞).
    pub difference_error: f64,
    /// Slope of log ‖remainder‖ over log h; 2 for a right derivative. `NaN` where the step is affine along the
    /// direction, so that nothing remains.
    pub taylor_order: f64,
    /// Value of the program against the direct step, relative to max(1, |x|).
    pub value_error: f64,
    /// Entries of the Jacobian compared.
    pub n_entry: usize,
}

impl Certificate {
    /// Whether all three agree within `bounds`.
    pub fn holds(&self, bounds: Bounds) -> bool {
        self.adjoint_error <= bounds.adjoint
            && self.difference_error <= bounds.difference
            && self.value_error <= 1e-12
            && (self.taylor_order.is_nan() || (self.taylor_order - 2.0).abs() <= bounds.taylor)
    }
}

impl fmt::Display for Certificate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "gradient certificate over {} entries", self.n_entry)?;
        writeln!(f, "  program against direct value     {:.1e}", self.value_error)?;
        writeln!(f, "  adjoint against duals            {:.1e}", self.adjoint_error)?;
        writeln!(f, "  duals against central difference {:.1e}", self.difference_error)?;
        write!(f, "  Taylor order (2 when right)      {:.3}", self.taylor_order)
    }
}

/// Certifies the Jacobian of one step with respect to state, input and parameters at a point.
///
/// # Errors
/// [`Error::Value`] if a length is wrong or the point or its image is not finite.
pub fn certify<F: System>(system: &F, state: &[f64], input: &[f64], parameters: &[f64]) -> Result<Certificate> {
    let (n, m, p) = (system.n_state(), system.n_input(), system.n_parameter());
    super::rollout::check_lengths(system, state, input, parameters)?;
    let point: Vec<f64> = state.iter().chain(input).chain(parameters).copied().collect();
    crate::error::finite("the point of the certificate", &point)?;
    let evaluate = |z: &[f64]| {
        let mut next = vec![0.0; n];
        system.step(&z[..n], &z[n..n + m], &z[n + m..], &mut next);
        next
    };
    let value = evaluate(&point);
    crate::error::finite("the step at the point of the certificate", &value)?;

    let width = n + m + p;
    let mut dual = vec![0.0; n * width];
    jacobian(system, state, input, parameters, &mut JacobianScratch::new(system), &mut dual);
    let scale = dual.iter().fold(1.0, |a: f64, b| a.max(b.abs()));
    let largest = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);

    let (adjoint, program_value) = by_adjoint(system, &point)?;
    let value_error =
        value.iter().zip(&program_value).map(|(a, b)| (a - b).abs() / a.abs().max(1.0)).fold(0.0, f64::max);
    Ok(Certificate {
        adjoint_error: largest(&dual, &adjoint) / scale,
        difference_error: largest(&dual, &by_difference(&evaluate, &point)) / scale,
        taylor_order: taylor_order(&evaluate, &point, &value, &dual),
        value_error,
        n_entry: n * width,
    })
}

/// The Jacobian (column-major) row by row from the adjoint program, and the program's value.
fn by_adjoint<F: system::System>(system: &F, point: &[f64]) -> Result<(Vec<f64>, Vec<f64>)> {
    let (n, m) = (system.n_state(), system.n_input());
    let recording = Recording::of(point.len(), |z| {
        let mut next = vec![Trace::zero(); n];
        system.step(&z[..n], &z[n..n + m], &z[n + m..], &mut next);
        next
    });
    let forward = Program::compile(&recording)?;
    let mut value = vec![0.0; n];
    forward.evaluate(&mut forward.workspace(), point, &mut value);

    let adjoint = Program::compile(&recording.adjoint(0..point.len()))?;
    let mut workspace = adjoint.workspace();
    let mut jacobian = vec![0.0; n * point.len()];
    let mut row = vec![0.0; point.len()];
    let mut arguments = point.to_vec();
    arguments.resize(point.len() + n, 0.0);
    for i in 0..n {
        arguments[point.len()..].fill(0.0);
        arguments[point.len() + i] = 1.0;
        adjoint.evaluate(&mut workspace, &arguments, &mut row);
        for (k, entry) in row.iter().enumerate() {
            jacobian[k * n + i] = *entry;
        }
    }
    Ok((jacobian, value))
}

/// Central differences with a step of 6e-6 relative to each entry (ε^⅓, where truncation and rounding balance).
fn by_difference(evaluate: &impl Fn(&[f64]) -> Vec<f64>, point: &[f64]) -> Vec<f64> {
    let mut z = point.to_vec();
    let mut jacobian = Vec::new();
    for k in 0..point.len() {
        let h = 6e-6 * point[k].abs().max(1e-3);
        z[k] = point[k] + h;
        let plus = evaluate(&z);
        z[k] = point[k] - h;
        let minus = evaluate(&z);
        z[k] = point[k];
        jacobian.extend(plus.iter().zip(&minus).map(|(a, b)| (a - b) / (2.0 * h)));
    }
    jacobian
}

/// Slope of the remainder between h = 1e-2 and 1e-3 along a fixed direction scaled to each entry.
fn taylor_order(evaluate: &impl Fn(&[f64]) -> Vec<f64>, point: &[f64], value: &[f64], jacobian: &[f64]) -> f64 {
    let n = value.len();
    let direction: Vec<f64> =
        point.iter().enumerate().map(|(k, z)| (1.0 + k as f64).sin() * z.abs().clamp(1e-3, 1.0)).collect();
    let remainder = |h: f64| {
        let z: Vec<f64> = point.iter().zip(&direction).map(|(z, d)| z + h * d).collect();
        let moved = evaluate(&z);
        let mut sum = 0.0;
        for i in 0..n {
            let slope: f64 = direction.iter().enumerate().map(|(k, d)| jacobian[k * n + i] * d).sum();
            sum += ((moved[i] - value[i] - h * slope) / value[i].abs().max(1.0)).powi(2);
        }
        sum.sqrt()
    };
    let (coarse, fine) = (remainder(1e-2), remainder(1e-3));
    if fine < 1e-13 { f64::NAN } else { (coarse / fine).log10() }
}

/// Checks a certificate against bounds, with an error that says which part failed.
///
/// # Errors
/// [`Error::Value`] with the certificate's text.
pub fn require(certificate: &Certificate, bounds: Bounds) -> Result<()> {
    if certificate.holds(bounds) {
        return Ok(());
    }
    Err(Error::value(
        "gradient certificate",
        format!("not held ({certificate})"),
        format!("within {bounds:?}"),
        "Look for a branch on a value, an unguarded corner (see autodiff::safe), or a kink at this very point.",
    ))
}
