//! A gradient certificate for any system: adjoint against duals against central differences, with the Taylor order.
//!
//! Three independent derivations must agree at a point: the adjoint program (symbolic, reverse), duals (forward) and
//! central differences (no derivative code at all). The Taylor remainder ‖f(z + hd) − f(z) − h J d‖ must fall with h²;
//! a wrong derivative leaves h¹, a kink within h too. A derivative that is not a number fails all of them.
//!
//! Entries of a point have sizes from 1e-9 (a thrust coefficient) to 1e4 (a rotor speed), and a zero does not tell
//! which. So errors are judged column by column, relative to max(1, largest entry), over a ladder of steps. Of a central
//! difference D(h) = f' + c h² + O(h⁴) + O(ε |f|/h) the next rung takes away the second order (Richardson),
//! R(h) = D(h/10) + (D(h/10) − D(h))/99, and what is left tells its own error: truncation from the next rung,
//! |R(h) − R(h/10)|, rounding from |f|. So the size of third derivatives, which grow with the motion, is no error. The rungs
//! that predict at most 5e-9 count, whatever the derivative says, and the worst of them is reported; where none does, the one
//! that predicts least. The Taylor remainder is judged likewise, where the function alone tells that its second order
//! dominates. What this cannot see is an entry wrong by less than the bound times that scale: differences end there. Between
//! adjoint and duals the bound is 1e-10 of the scale.
//!
//! **Kinks.** Where two smooth pieces meet, a function has two slopes and differences agree with neither, though no derivative
//! is wrong. The function alone tells so: the slopes to both sides, (f(z + h) − f(z))/h and (f(z) − f(z − h))/h, stay apart
//! as h falls, where those of a smooth function meet as h does. Such columns are counted; a certificate does not hold there,
//! and says why. A derivative is judged beside the kink.

use super::derivative::{JacobianScratch, jacobian};
use super::program::Program;
use super::system::System;
use super::trace::{Recording, Trace};
use super::{Scalar, system};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use std::fmt;

with_defaults! {
    /// What the errors of a [`Certificate`] may not exceed.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct CertificateBounds {
        /// Adjoint against duals, relative to max(1, ‖column‖).
        pub adjoint: f64 = 1e-10,
        /// Duals against central differences, relative to max(1, ‖column‖).
        pub difference: f64 = 1e-7,
        /// Distance of the Taylor order from 2.
        pub taylor: f64 = 0.1,
    }
}

/// How well three derivations of one step's Jacobian agree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Certificate {
    /// Largest |adjoint − dual| over all entries, relative to max(1, ‖column‖∞); infinite where either is not finite.
    pub adjoint_error: f64,
    /// Largest |dual − central difference| over all entries and all steps that count, relative to max(1, ‖column‖∞);
    /// infinite where either is not finite.
    pub difference_error: f64,
    /// Slope of log ‖remainder‖ over log h, of all pairs of steps that count the one farthest from 2, which a right
    /// derivative gives. `None` where the step is affine along the direction, so that nothing remains; infinite where the
    /// remainder is not finite.
    pub taylor_order: Option<f64>,
    /// Largest |program − direct step| over x⁺, relative to max(1, |x⁺|).
    pub value_error: f64,
    /// Columns along which two smooth pieces meet at the point: their slopes to both sides differ, whatever the derivative says.
    pub kinks: usize,
    /// Entries of the Jacobian compared.
    pub n_entry: usize,
}

impl Certificate {
    /// Whether all three agree within `bounds`, and the program with the step to 1e-12.
    pub fn holds(&self, bounds: CertificateBounds) -> bool {
        self.adjoint_error <= bounds.adjoint
            && self.difference_error <= bounds.difference
            && self.value_error <= 1e-12
            && self.taylor_order.is_none_or(|order| (order - 2.0).abs() <= bounds.taylor)
    }
}

impl fmt::Display for Certificate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "gradient certificate over {} entries", self.n_entry)?;
        writeln!(f, "  program against direct value     {:.1e}", self.value_error)?;
        writeln!(f, "  adjoint against duals            {:.1e}", self.adjoint_error)?;
        writeln!(f, "  duals against central difference {:.1e}", self.difference_error)?;
        match self.taylor_order {
            Some(order) => write!(f, "  Taylor order (2 when right)      {order:.3}")?,
            None => write!(f, "  Taylor order                     none: the step is affine")?,
        }
        match self.kinks {
            0 => Ok(()),
            n => write!(f, "\n  columns that meet a kink here    {n}: judge it beside the kink"),
        }
    }
}

/// Compares three independent Jacobians of one step with respect to state, input and parameters at a point: by the adjoint program
/// (reverse), by duals (forward) and by central differences (no derivative code), and the order of the Taylor remainder
/// ‖f(z + hd) − f(z) − h J d‖, which is 2 for a right J. A kink at the point spoils differences, not derivatives: certify beside it.
///
/// # Errors
/// [`Error::Value`] if a length is wrong or the point or its image is not finite; [`Error::Limit`](base::error::Error::Limit) if the
/// recording is too large to compile.
pub fn certify<F: System>(system: &F, state: &[f64], input: &[f64], parameters: &[f64]) -> Result<Certificate> {
    let (n, m, p) = (system.n_state(), system.n_input(), system.n_parameter());
    super::rollout::check_lengths(system, state, input, parameters)?;
    let point: Vec<f64> = state.iter().chain(input).chain(parameters).copied().collect();
    base::error::finite("the point of the certificate", &point)?;
    let evaluate = |z: &[f64]| {
        let mut next = vec![0.0; n];
        system.step(&z[..n], &z[n..n + m], &z[n + m..], &mut next);
        next
    };
    let value = evaluate(&point);
    base::error::finite("the step at the point of the certificate", &value)?;

    let width = n + m + p;
    let mut dual = vec![0.0; n * width];
    jacobian(system, state, input, parameters, &mut JacobianScratch::new(system), &mut dual);
    let (adjoint, program_value) = by_adjoint(system, &point)?;
    let value_error =
        value.iter().zip(&program_value).map(|(a, b)| (a - b).abs() / a.abs().max(1.0)).fold(0.0, largest);
    let columns = || dual.chunks_exact(n.max(1));
    let adjoint_error = columns().zip(adjoint.chunks_exact(n.max(1))).map(|(d, a)| column_error(d, a));
    let ladders = columns().enumerate().map(|(k, d)| (Ladder::of(&evaluate, &point, &value, k), d));
    let (mut difference_error, mut kinks) = (0.0, 0);
    for (ladder, column) in ladders {
        difference_error = largest(difference_error, ladder.error_of(column));
        kinks += usize::from(ladder.has_kink());
    }
    Ok(Certificate {
        adjoint_error: adjoint_error.fold(0.0, largest),
        difference_error,
        kinks,
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
    let scale = size_of_column(a);
    a.iter().zip(b).map(|(x, y)| (x - y).abs() / scale).fold(0.0, largest)
}

/// max(1, ‖column‖∞).
fn size_of_column(column: &[f64]) -> f64 {
    column.iter().fold(1.0, |s: f64, x| s.max(x.abs()))
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

/// Steps of differences, in fractions of max(|z|, 1e-3): entries of 1e-9 stand beside zeros of unknown size.
const STEPS: [f64; 9] = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9];
/// What a difference may predict of its own error to count, relative to max(1, ‖column‖∞): a twentieth of [`CertificateBounds`].
const PREDICTED: f64 = 5e-9;

/// Slopes along one entry of a point over [`STEPS`], by differences.
struct Ladder {
    /// To both sides, component by component; without the steps that left the domain.
    sides: Vec<[Vec<f64>; 2]>,
    /// The steps themselves.
    steps: Vec<f64>,
    /// Largest value that the entry moves: what the entry does not move has no rounding.
    high: f64,
}

impl Ladder {
    fn of(evaluate: &impl Fn(&[f64]) -> Vec<f64>, point: &[f64], value: &[f64], k: usize) -> Self {
        let mut z = point.to_vec();
        let size = point[k].abs().max(1e-3);
        let mut slope = |h: f64| {
            let mut to = |side: f64| {
                z[k] = point[k] + side * h;
                let there = evaluate(&z);
                there.iter().zip(value).map(|(a, b)| (a - b) / (side * h)).collect::<Vec<f64>>()
            };
            [to(1.0), to(-1.0)]
        };
        let all = STEPS.map(|step| step * size);
        let slopes = all.map(&mut slope);
        // a long step may leave the domain, a shorter one than a step within it may not
        let finite = |sides: &[Vec<f64>; 2]| sides.iter().flatten().all(|x| x.is_finite());
        let first = slopes.iter().position(finite).unwrap_or(STEPS.len());
        let sides = slopes[first..].to_vec();
        let moves = |i: &usize| sides.iter().flatten().any(|side| side[*i] != 0.0);
        let high = (0..value.len()).filter(moves).fold(1.0, |m: f64, i| m.max(value[i].abs()));
        Self { sides, steps: all[first..].to_vec(), high }
    }

    /// Central differences.
    fn central(&self, i: usize) -> Vec<f64> {
        let [plus, minus] = &self.sides[i];
        plus.iter().zip(minus).map(|(a, b)| 0.5 * (a + b)).collect()
    }

    /// What rounding may add to a slope, relative to `scale`.
    fn rounding(&self, i: usize, scale: f64) -> f64 {
        f64::EPSILON * self.high / (self.steps[i] * scale)
    }

    /// Largest error of a column against the differences that count; see the head of this file.
    fn error_of(&self, column: &[f64]) -> f64 {
        if self.sides.len() < 3 || !self.sides.iter().flatten().flatten().all(|x| x.is_finite()) {
            return f64::INFINITY;
        }
        let central: Vec<Vec<f64>> = (0..self.sides.len()).map(|i| self.central(i)).collect();
        let refined = |pair: &[Vec<f64>]| -> Vec<f64> {
            pair[0].iter().zip(&pair[1]).map(|(long, short)| short + (short - long) / 99.0).collect()
        };
        let slopes: Vec<Vec<f64>> = central.windows(2).map(refined).collect();
        let predicted =
            |i: usize| column_error(&slopes[i], &slopes[i + 1]) + self.rounding(i + 1, size_of_column(&slopes[i]));
        let rungs: Vec<(f64, f64)> =
            (0..slopes.len() - 1).map(|i| (predicted(i), column_error(column, &slopes[i]))).collect();
        let least = rungs.iter().fold(f64::INFINITY, |m: f64, (own, _)| m.min(*own));
        let worst =
            rungs.iter().filter(|(own, _)| *own <= PREDICTED.max(least)).map(|(_, error)| *error).reduce(largest);
        worst.unwrap_or(f64::INFINITY)
    }

    /// Whether the slopes to both sides stay apart down to the shortest step that rounding lets see it.
    fn has_kink(&self) -> bool {
        let gaps: Vec<(f64, f64)> = (self.sides.iter().enumerate())
            .map(|(i, [plus, minus])| {
                let scale = size_of_column(plus).max(size_of_column(minus));
                let apart = plus.iter().zip(minus).map(|(a, b)| (a - b).abs() / scale).fold(0.0, largest);
                (apart, SEEN * self.rounding(i, scale))
            })
            .collect();
        let Some(last) = gaps.iter().rposition(|(gap, seen)| gap > seen) else { return false };
        let hidden_below = gaps.get(last + 1).is_none_or(|(_, seen)| gaps[last].0 < 2.0 * seen);
        let stays = last > 0 && gaps[last].0 > 0.5 * gaps[last - 1].0;
        hidden_below && stays && gaps[last].0 > PREDICTED
    }
}

/// A gap of this many times its rounding is seen.
const SEEN: f64 = 100.0;

/// Steps of the Taylor remainder.
const TAYLOR: [f64; 4] = [1e-2, 1e-3, 1e-4, 1e-5];
/// Sizes that a zero is given, in thousandths.
const LADDER: [f64; 3] = [1.0, 1e-3, 1e-6];
/// Less than this of a second difference is rounding.
const ROUNDING: f64 = 1e-13;
/// How far the function itself may be from its second order between two steps to count: distance of the order of its second
/// difference from 2, or share of its third order.
const THIRD_ORDER: f64 = 0.05;

/// Slope of log ‖remainder‖ between h and h/10 along a fixed direction scaled to each entry, zeros given each rung of the
/// ladder for a size: the farthest from 2 over the pairs that count. Which do is told by the function alone: its second
/// difference ‖f(z + hd) − 2 f(z) + f(z − hd)‖ falls with h², and its third order is small beside it. Where no pair does,
/// the one nearest to that.
fn taylor_order(evaluate: &impl Fn(&[f64]) -> Vec<f64>, point: &[f64], value: &[f64], jacobian: &[f64]) -> Option<f64> {
    let mut pairs: Vec<(f64, f64)> = Vec::new();
    for rung in LADDER {
        let size = |z: f64| if z == 0.0 { 1e-3 * rung } else { z.abs().min(1.0) };
        let direction: Vec<f64> = point.iter().enumerate().map(|(k, z)| (1.0 + k as f64).sin() * size(*z)).collect();
        let slope: Vec<f64> = (0..value.len())
            .map(|i| direction.iter().enumerate().map(|(k, d)| jacobian[k * value.len() + i] * d).sum())
            .collect();
        let sides = TAYLOR.map(|h| Sides::of(evaluate, point, value, &slope, &direction, h));
        if sides.iter().any(|side| !side.remainder.is_finite()) {
            return Some(f64::INFINITY);
        }
        for pair in sides.windows(2).filter(|pair| pair[1].remainder >= ROUNDING) {
            let own = if pair[1].second >= ROUNDING {
                let third =
                    pair[0].odd.iter().zip(&pair[1].odd).map(|(a, b)| (a - 10.0 * b).powi(2)).sum::<f64>().sqrt();
                ((pair[0].second / pair[1].second).log10() - 2.0).abs().max(third / pair[0].second)
            } else {
                f64::INFINITY
            };
            pairs.push((own, (pair[0].remainder / pair[1].remainder).log10()));
        }
    }
    let least = pairs.iter().fold(f64::INFINITY, |m: f64, (own, _)| m.min(*own));
    let counts = pairs.iter().filter(|(own, _)| *own <= THIRD_ORDER.max(least));
    counts.map(|(_, order)| *order).reduce(|a, b| if (a - 2.0).abs() >= (b - 2.0).abs() { a } else { b })
}

/// A function on both sides of a point, each component relative to max(1, |f|).
struct Sides {
    /// ‖f(z + hd) − f(z) − h J d‖.
    remainder: f64,
    /// ½ ‖f(z + hd) − 2 f(z) + f(z − hd)‖.
    second: f64,
    /// ½ (f(z + hd) − f(z − hd)).
    odd: Vec<f64>,
}

impl Sides {
    fn of(
        evaluate: &impl Fn(&[f64]) -> Vec<f64>,
        point: &[f64],
        value: &[f64],
        slope: &[f64],
        direction: &[f64],
        h: f64,
    ) -> Self {
        let at = |h: f64| evaluate(&point.iter().zip(direction).map(|(z, d)| z + h * d).collect::<Vec<f64>>());
        let (plus, minus) = (at(h), at(-h));
        let (mut remainder, mut second, mut odd) = (0.0, 0.0, Vec::with_capacity(value.len()));
        for (i, own) in value.iter().enumerate() {
            let scale = own.abs().max(1.0);
            remainder += ((plus[i] - own - h * slope[i]) / scale).powi(2);
            second += (0.5 * (plus[i] - 2.0 * own + minus[i]) / scale).powi(2);
            odd.push(0.5 * (plus[i] - minus[i]) / scale);
        }
        Self { remainder: remainder.sqrt(), second: second.sqrt(), odd }
    }
}

/// Checks a certificate against bounds, with an error that says which part failed.
///
/// # Errors
/// [`Error::Value`] with the certificate's text.
pub fn require(certificate: &Certificate, bounds: CertificateBounds) -> Result<()> {
    if certificate.holds(bounds) {
        return Ok(());
    }
    Err(Error::value(
        "gradient certificate",
        format!("not held ({certificate})"),
        format!("within {bounds:?}"),
        match certificate.kinks {
            0 => "Look for a branch on a value, or an unguarded corner (see autodiff::safe).",
            _ => "A kink lies at this very point: certify beside it.",
        },
    ))
}
