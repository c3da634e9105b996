//! What inputs do not reach and outputs do not show.
//!
//! A mode λ is out of reach where [A − λI, B] loses rank, unseen where [A − λI; C] does (Popov, Belevitch, Hautus).

use super::dense::{Complexes, eigenvectors, singular_values, svd};
use super::state_space::StateSpace;
use crate::error::Result;
use nalgebra::{Complex, DMatrix};

/// A mode that is out of reach, or unseen.
#[derive(Debug, Clone, PartialEq)]
pub struct Hidden {
    /// Its pole.
    pub pole: Complex<f64>,
    /// Least singular value of the pencil there, over the largest: 0 is hidden for certain.
    pub visibility: f64,
    /// States whose combination it is, most first: numbers and shares of the direction.
    pub states: Vec<(usize, f64)>,
}

/// Modes that no input moves, with a visibility of at most `tolerance` (1e-9 is usual).
///
/// # Errors
/// Where eigenvalues are not found.
pub fn unreachable(system: &StateSpace, tolerance: f64) -> Result<Vec<Hidden>> {
    hidden(&system.a().transpose(), &system.b().transpose(), tolerance)
}

/// Modes that no output shows, with a visibility of at most `tolerance`.
///
/// # Errors
/// Where eigenvalues are not found.
pub fn unobservable(system: &StateSpace, tolerance: f64) -> Result<Vec<Hidden>> {
    hidden(system.a(), system.c(), tolerance)
}

fn hidden(a: &DMatrix<f64>, c: &DMatrix<f64>, tolerance: f64) -> Result<Vec<Hidden>> {
    let n = a.nrows();
    if n == 0 {
        return Ok(Vec::new());
    }
    let (values, right, _) = eigenvectors(a)?;
    let mut found = Vec::new();
    for (j, pole) in values.iter().enumerate().filter(|(_, pole)| pole.im >= 0.0) {
        let pencil = Complexes::from_fn(n + c.nrows(), n, |i, k| {
            let value = if i < n { a[(i, k)] } else { c[(i - n, k)] };
            Complex::new(value, 0.0) - if i == k { *pole } else { Complex::new(0.0, 0.0) }
        });
        let values = singular_values(&pencil);
        let visibility = values[n - 1] / values[0].max(f64::MIN_POSITIVE);
        if visibility <= tolerance {
            let direction = right.column(j);
            let whole: f64 = direction.iter().map(|v| v.norm()).sum();
            let mut states: Vec<(usize, f64)> = (0..n).map(|i| (i, direction[i].norm() / whole)).collect();
            states.retain(|(_, share)| *share > 0.01);
            states.sort_by(|a, b| b.1.total_cmp(&a.1));
            found.push(Hidden { pole: *pole, visibility, states });
        }
    }
    Ok(found)
}

/// The part that inputs reach and outputs show: the same response with the fewest states. Directions weaker than `tolerance`
/// (1e-9 is usual) of the matrices' size count as none.
///
/// # Errors
/// Where singular values are not found.
pub fn minimal(system: &StateSpace, tolerance: f64) -> Result<StateSpace> {
    let reached = span(system.a(), system.b(), tolerance)?;
    let (a, b, c) = (reached.tr_mul(&(system.a() * &reached)), reached.tr_mul(system.b()), system.c() * &reached);
    let shown = span(&a.transpose(), &c.transpose(), tolerance)?;
    let (a, b, c) = (shown.tr_mul(&(&a * &shown)), shown.tr_mul(&b), c * shown);
    if a.nrows() == system.n_state() {
        return Ok(system.clone());
    }
    system.with(a, b, c, system.d().clone(), system.dt())
}

/// An orthonormal basis of the span of B, A B, A² B, …: the new directions of each power, from those of the one before.
fn span(a: &DMatrix<f64>, b: &DMatrix<f64>, tolerance: f64) -> Result<DMatrix<f64>> {
    let n = a.nrows();
    let mut basis = DMatrix::zeros(n, 0);
    let (mut new, mut size) = (b.clone(), b.norm());
    while new.ncols() > 0 && basis.ncols() < n {
        // twice is enough (Parlett)
        for _ in 0..2 {
            let along = basis.tr_mul(&new);
            new -= &basis * along;
        }
        let (left, values, _) = svd(&new)?;
        let rank = values.iter().filter(|v| **v > tolerance * size).count();
        let fresh = left.columns(0, rank).into_owned();
        basis = super::state_space::beside(&basis, &fresh);
        (new, size) = (a * fresh, a.norm());
    }
    Ok(basis)
}
