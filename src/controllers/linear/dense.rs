//! Eigenvalues and singular values of dense matrices, by faer.

use crate::error::{Error, Result};
use nalgebra::{Complex, DMatrix};

/// Eigenvalues, largest modulus first.
///
/// # Errors
/// [`Error::Value`] if the matrix is not square or its eigenvalues are not found, as where a number is not finite.
pub fn eigenvalues(matrix: &DMatrix<f64>) -> Result<Vec<Complex<f64>>> {
    let n = matrix.nrows();
    if n != matrix.ncols() || matrix.iter().any(|v| !v.is_finite()) {
        let got = format!("{n} × {}, or not finite", matrix.ncols());
        return Err(Error::value("matrix", got, "square and finite", "Correct it at its source."));
    }
    if n == 0 {
        return Ok(Vec::new());
    }
    let Ok(found) = dense(matrix).eigenvalues() else { return Err(not_found("eigenvalues")) };
    let mut values: Vec<Complex<f64>> = found.iter().map(|l| Complex::new(l.re, l.im)).collect();
    values.sort_by(|a, b| b.norm().total_cmp(&a.norm()));
    Ok(values)
}

/// Largest modulus of an eigenvalue: a discrete loop settles where it is below 1.
///
/// # Errors
/// As [`eigenvalues`].
pub fn spectral_radius(matrix: &DMatrix<f64>) -> Result<f64> {
    Ok(eigenvalues(matrix)?.first().map_or(0.0, |l| l.norm()))
}

/// Largest modulus of an eigenvalue of a complex matrix; infinite where they are not found.
pub(crate) fn complex_spectral_radius(matrix: &Complexes) -> f64 {
    if matrix.is_empty() {
        return 0.0;
    }
    let n = matrix.nrows();
    let dense = faer::Mat::from_fn(n, n, |i, j| faer::c64::new(matrix[(i, j)].re, matrix[(i, j)].im));
    let size = |l: &faer::c64| l.re.hypot(l.im);
    dense.eigenvalues().map_or(f64::INFINITY, |values| values.iter().map(size).fold(0.0, f64::max))
}

/// Eigenvalues with their right and left eigenvectors, as columns: A V = V Λ, Wᴴ A = Λ Wᴴ, wᵢᴴ vᵢ = 1. Columns of a defective
/// matrix are large.
pub(crate) fn eigenvectors(matrix: &DMatrix<f64>) -> Result<(Vec<Complex<f64>>, Complexes, Complexes)> {
    let n = matrix.nrows();
    let Ok(found) = dense(matrix).eigen() else { return Err(not_found("eigenvectors")) };
    let values: Vec<Complex<f64>> = found.S().column_vector().iter().map(|l| Complex::new(l.re, l.im)).collect();
    let right = DMatrix::from_fn(n, n, |i, j| Complex::new(found.U()[(i, j)].re, found.U()[(i, j)].im));
    let left = match right.clone().try_inverse() {
        Some(inverse) => inverse.adjoint(),
        None => right.clone().map(|_| Complex::new(f64::INFINITY, 0.0)),
    };
    Ok((values, right, left))
}

/// λ with det(A − λ E) = 0 that are finite: those of modulus up to 1e10 times what the sizes of A and E suggest.
pub(crate) fn pencil_eigenvalues(a: &DMatrix<f64>, e: &DMatrix<f64>) -> Result<Vec<Complex<f64>>> {
    let Ok(found) = dense(a).generalized_eigen(dense(e)) else { return Err(not_found("generalised eigenvalues")) };
    let pairs = found.S_a().column_vector().iter().zip(found.S_b().column_vector().iter());
    let (size_a, size_e) = (a.norm().max(f64::MIN_POSITIVE), e.norm().max(f64::MIN_POSITIVE));
    let finite = pairs.filter_map(|(a, b)| {
        let (a, b) = (Complex::new(a.re, a.im), Complex::new(b.re, b.im));
        (b.norm() / size_e > 1e-10 * (a.norm() / size_a).max(1e-300)).then(|| a / b)
    });
    Ok(finite.filter(|l| l.re.is_finite() && l.im.is_finite()).collect())
}

/// Complex matrices.
pub(crate) type Complexes = DMatrix<Complex<f64>>;

/// Singular values, largest first; all NaN where they are not found.
pub(crate) fn singular_values(matrix: &Complexes) -> Vec<f64> {
    let (n, m) = matrix.shape();
    if n == 1 || m == 1 {
        return vec![matrix.norm()];
    }
    let dense = faer::Mat::from_fn(n, m, |i, j| faer::c64::new(matrix[(i, j)].re, matrix[(i, j)].im));
    dense.singular_values().unwrap_or_else(|_| vec![f64::NAN; n.min(m)])
}

/// Singular values of a real matrix with left and right vectors as columns, largest first.
pub(crate) fn svd(matrix: &DMatrix<f64>) -> Result<(DMatrix<f64>, Vec<f64>, DMatrix<f64>)> {
    let (n, m) = matrix.shape();
    let Ok(found) = dense(matrix).svd() else { return Err(not_found("singular values")) };
    let left = DMatrix::from_fn(n, n, |i, j| found.U()[(i, j)]);
    let right = DMatrix::from_fn(m, m, |i, j| found.V()[(i, j)]);
    Ok((left, found.S().column_vector().iter().copied().collect(), right))
}

fn dense(matrix: &DMatrix<f64>) -> faer::Mat<f64> {
    faer::Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)])
}

fn not_found(what: &str) -> Error {
    Error::value(what, "not found", "found by the QR algorithm", "Scale the matrix.")
}
