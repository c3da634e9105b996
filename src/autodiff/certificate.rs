//! A gradient certificate for any system: adjoint against duals against central differences, with the Taylor order.
//!
//! Three independent derivations must agree at a point: the adjoint program (symbolic, reverse), duals (forward) and
//! central differences (no derivative code at all). The Taylor remainder ‖f(z + hd) − f(z) − h J d‖ must fall with h²;
//! a wrong derivative leaves h¹, a kink within h too. A derivative that is not a number fails all of them.
//!
//! Entries of a point have sizes from 1e-9 (a thrust coefficient) to 1e4 (a rotor speed), and a zero does not tell
//! which. So errors are judged column by column, relative to max(1, largest entry), and steps are tried on a ladder:
//! differences that agree at one rung confirm the column. What this cannot see is an entry wrong by less than the bound
//! times that scale: differences end there. Between adjoint and duals the bound is 1e-10 of the scale.

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
    /// Adjoint against duals, relative to max(1, ‖column‖).
    pub adjoint: f64,
    /// Duals against central differences, relative to max(1, ‖column‖).
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
    /// Largest |adjoint − dual| over all entries, relative to max(1, ‖column‖∞); infinite where either is not finite.
    pub adjoint_error: f64,
    /// Largest |dual − central difference|, relative to max(1, ‖column‖∞); infinite where either is not finite.
    pub difference_error: f64,
    /// Slope of log ‖remainder‖ over log h; 2 for a right derivative. `NaN` where the step is affine along the
    /// direction, so that nothing remains; infinite where the remainder is not finite.
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
    let (adjoint, program_value) = by_adjoint(system, &point)?;
    let value_error =
        value.iter().zip(&program_value).map(|(a, b)| (a - b).abs() / a.abs().max(1.0)).fold(0.0, largest);
    let columns = || dual.chunks_exact(n.max(1));
    let adjoint_error = columns().zip(adjoint.chunks_exact(n.max(1))).map(|(d, a)| column_error(d, a));
    let difference_error = columns().enumerate().map(|(k, d)| difference_error(&evaluate, &point, k, d));
    Ok(Certificate {
        adjoint_error: adjoint_error.fold(0.0, largest),
        difference_error: difference_error.fold(0.0, largest),
        taylor_order: taylor_order(&evaluate, &point, &value, &dual),
        value_error,
        n_entry: n * width,
    })
}

/// The larger; infinite if either is not a number (`f64::max` would drop it).
fn largest(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::INFINITY } else { a.max(b) }
}

/// Largest |a − b| relative to max(1, ‖a‖∞).
fn column_error(a: &[f64], b: &[f64]) -> f64 {
    let scale = a.iter().fold(1.0, |s: f64, x| s.max(x.abs()));
    a.iter().zip(b).map(|(x, y)| (x - y).abs() / scale).fold(0.0, largest)
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

/// Fractions of max(|z|, 1e-3) that an entry of unknown size may be moved by.
const LADDER: [f64; 3] = [1.0, 1e-3, 1e-6];

/// Multiples of ε^⅓ that a difference step may have: where a result is large (rotor speeds of hundreds of rad/s), its
/// rounding asks for a longer step than the entry's own size suggests.
const STEPS: [f64; 4] = [30.0, 1.0, 1e-3, 1e-6];

/// Error of column k against central differences, at the step that confirms it best: 6e-6 relative to the entry (ε^⅓,
/// where truncation and rounding balance) times each of [`STEPS`].
fn difference_error(evaluate: &impl Fn(&[f64]) -> Vec<f64>, point: &[f64], k: usize, column: &[f64]) -> f64 {
    let mut z = point.to_vec();
    let error = |rung: &f64| {
        let h = 6e-6 * rung * point[k].abs().max(1e-3);
        z[k] = point[k] + h;
        let plus = evaluate(&z);
        z[k] = point[k] - h;
        let minus = evaluate(&z);
        let slope: Vec<f64> = plus.iter().zip(&minus).map(|(a, b)| (a - b) / (2.0 * h)).collect();
        column_error(column, &slope)
    };
    STEPS.iter().map(error).fold(f64::INFINITY, f64::min)
}

/// Slope of log ‖remainder‖ between h and h/10 along a fixed direction scaled to each entry, for h = 1e-2 and 1e-3 (where
/// a kink lies within the first, or the third order weighs in it); zeros are given each rung of the ladder for a size.
/// The slope nearest to 2 counts.
fn taylor_order(evaluate: &impl Fn(&[f64]) -> Vec<f64>, point: &[f64], value: &[f64], jacobian: &[f64]) -> f64 {
    let mut best = f64::NAN;
    for rung in LADDER {
        let size = |z: f64| if z == 0.0 { 1e-3 * rung } else { z.abs().min(1.0) };
        let direction: Vec<f64> = point.iter().enumerate().map(|(k, z)| (1.0 + k as f64).sin() * size(*z)).collect();
        let rest = [1e-2, 1e-3, 1e-4].map(|h| remainder(evaluate, point, value, jacobian, &direction, h));
        if rest.iter().any(|r| !r.is_finite()) {
            return f64::INFINITY;
        }
        for pair in rest.windows(2).filter(|pair| pair[1] >= 1e-13) {
            let order = (pair[0] / pair[1]).log10();
            if best.is_nan() || (order - 2.0).abs() < (best - 2.0).abs() {
                best = order;
            }
        }
    }
    best
}

/// ‖f(z + hd) − f(z) − h J d‖, each component relative to max(1, |f|).
fn remainder(
    evaluate: &impl Fn(&[f64]) -> Vec<f64>,
    point: &[f64],
    value: &[f64],
    jacobian: &[f64],
    direction: &[f64],
    h: f64,
) -> f64 {
    let n = value.len();
    let z: Vec<f64> = point.iter().zip(direction).map(|(z, d)| z + h * d).collect();
    let moved = evaluate(&z);
    let mut sum = 0.0;
    for i in 0..n {
        let slope: f64 = direction.iter().enumerate().map(|(k, d)| jacobian[k * n + i] * d).sum();
        sum += ((moved[i] - value[i] - h * slope) / value[i].abs().max(1.0)).powi(2);
    }
    sum.sqrt()
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
