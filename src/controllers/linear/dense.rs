//! Eigenvalues and singular values of dense matrices, by faer.
//!
//! Eigenvalues come from the QR algorithm with small bulges alone. It ends after 30 n sweeps; then it is tried once more on the
//! transpose, which converges along another way. The early deflation that faer adds from 75 rows on may swap two pairs
//! without end where they all but agree (0.24: a swap that is rejected counts as done), and a search that ended without all
//! eigenvalues is not told.

use base::error::{Error, Result};
use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::evd::{ComputeEigenvectors, EvdParams, evd_cplx, evd_real, evd_scratch};
use faer::linalg::gevd::{GevdParams, gevd_cplx, gevd_scratch};
use faer::{Auto, Mat, Par, Spec, c64};
use nalgebra::{Complex, DMatrix};

/// A pole that is nearer to the unit circle, from inside, decays so slowly that it counts as one that does not: to 1/e in a
/// billion samples.
pub const ON_CIRCLE: f64 = 1e-9;

/// Numbers below this share of their row or their column are what rounding left of none.
pub(super) const ROUNDED: f64 = 1e-13;

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
    let found = real(matrix, None).or_else(|| real(&matrix.transpose(), None));
    let Some(mut values) = found else { return Err(not_found("eigenvalues")) };
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
    complex(matrix).or_else(|| complex(&matrix.transpose())).unwrap_or(f64::INFINITY)
}

/// Eigenvalues with their right and left eigenvectors, as columns: A V = V Λ, Wᴴ A = Λ Wᴴ, wᵢᴴ vᵢ = 1. Columns of a defective
/// matrix are large.
pub(crate) fn eigenvectors(matrix: &DMatrix<f64>) -> Result<(Vec<Complex<f64>>, Complexes, Complexes)> {
    if let Some(found) = with_vectors(matrix) {
        return Ok(found);
    }
    let Some((values, right, left)) = with_vectors(&matrix.transpose()) else { return Err(not_found("eigenvectors")) };
    Ok((values, left.conjugate(), right.conjugate()))
}

fn with_vectors(matrix: &DMatrix<f64>) -> Option<(Vec<Complex<f64>>, Complexes, Complexes)> {
    let n = matrix.nrows();
    let mut parts = Mat::zeros(n, n);
    let values = real(matrix, Some(&mut parts))?;
    // of a pair the first column is the real part of the first, the second its imaginary part
    let right = Complexes::from_fn(n, n, |i, j| match values[j].im {
        im if im > 0.0 => Complex::new(parts[(i, j)], parts[(i, j + 1)]),
        im if im < 0.0 => Complex::new(parts[(i, j - 1)], -parts[(i, j)]),
        _ => Complex::new(parts[(i, j)], 0.0),
    });
    let left = match right.clone().try_inverse() {
        Some(inverse) => inverse.adjoint(),
        None => right.clone().map(|_| Complex::new(f64::INFINITY, 0.0)),
    };
    Some((values, right, left))
}

/// λ with det(A − λ E) = 0 that are finite: those of modulus up to 1e10 times what the sizes of A and E suggest.
pub(crate) fn pencil_eigenvalues(a: &DMatrix<f64>, e: &DMatrix<f64>) -> Result<Vec<Complex<f64>>> {
    let found = pencil(a, e).or_else(|| pencil(&a.transpose(), &e.transpose()));
    let Some(pairs) = found else { return Err(not_found("generalised eigenvalues")) };
    let (size_a, size_e) = (a.norm().max(f64::MIN_POSITIVE), e.norm().max(f64::MIN_POSITIVE));
    let finite = pairs
        .into_iter()
        .filter(|(a, b)| b.norm() / size_e > 1e-10 * (a.norm() / size_a).max(1e-300))
        .map(|(a, b)| a / b)
        .filter(|l| l.re.is_finite() && l.im.is_finite());
    let mut all: Vec<Complex<f64>> = finite.collect();
    make_real(&mut all);
    Ok(all)
}

/// Eigenvalues of real matrices that were sought among complex ones: what is nearer to its own conjugate than to another's is real.
fn make_real(all: &mut [Complex<f64>]) {
    let conjugates: Vec<Complex<f64>> = all.iter().map(Complex::conj).collect();
    for (i, value) in all.iter_mut().enumerate() {
        let others = conjugates.iter().enumerate().filter(|(j, _)| *j != i);
        let nearest = others.map(|(_, other)| (*value - other).norm()).fold(f64::INFINITY, f64::min);
        if 2.0 * value.im.abs() < nearest {
            value.im = 0.0;
        }
    }
}

/// Eigenvalues of a real matrix and real and imaginary parts of its right eigenvectors; none where not all are found.
fn real(matrix: &DMatrix<f64>, vectors: Option<&mut Mat<f64>>) -> Option<Vec<Complex<f64>>> {
    let n = matrix.nrows();
    let size = matrix.amax();
    if size > 0.0 && !(1e-100..1e100).contains(&size) {
        // squares of its numbers would be lost
        let values = real(&(matrix / size), vectors)?;
        return Some(values.into_iter().map(|value| value * size).collect());
    }
    let mut params: EvdParams = Auto::<f64>::auto();
    params.schur.blocking_threshold = usize::MAX;
    let params = Spec::new(params);
    let [mut re, mut im] = [0; 2].map(|_| Diag::full(n, f64::NAN));
    let wanted = if vectors.is_some() { ComputeEigenvectors::Yes } else { ComputeEigenvectors::No };
    with_memory(evd_scratch::<f64>(n, ComputeEigenvectors::No, wanted, Par::Seq, params), |stack| {
        let vectors = vectors.map(|v| v.as_mut());
        evd_real(dense(matrix).as_ref(), re.as_mut(), im.as_mut(), None, vectors, Par::Seq, stack, params).ok()
    })?;
    // what did not converge was not written
    let all = re.column_vector().iter().zip(im.column_vector().iter());
    all.map(|(re, im)| (!re.is_nan() && !im.is_nan()).then_some(Complex::new(*re, *im))).collect()
}

/// The largest modulus of a complex matrix' eigenvalues; none where not all are found.
fn complex(matrix: &Complexes) -> Option<f64> {
    let n = matrix.nrows();
    let mut params: EvdParams = Auto::<c64>::auto();
    params.schur.blocking_threshold = usize::MAX;
    let params = Spec::new(params);
    let dense = Mat::from_fn(n, n, |i, j| matrix[(i, j)]);
    let mut values = Diag::full(n, c64::new(f64::NAN, f64::NAN));
    let none = ComputeEigenvectors::No;
    with_memory(evd_scratch::<c64>(n, none, none, Par::Seq, params), |stack| {
        evd_cplx(dense.as_ref(), values.as_mut(), None, None, Par::Seq, stack, params).ok()
    })?;
    let mut sizes = values.column_vector().iter().map(|l| l.norm());
    sizes.try_fold(0.0, |most: f64, size| (!size.is_nan()).then(|| most.max(size)))
}

/// Eigenvalues of a pencil as quotients; none where not all are found. Taken for complex matrices: of real ones faer 0.24 finds pairs
/// that are a hundredth off.
fn pencil(a: &DMatrix<f64>, e: &DMatrix<f64>) -> Option<Vec<(Complex<f64>, Complex<f64>)>> {
    let n = a.nrows();
    let mut params: GevdParams = Auto::<c64>::auto();
    params.schur.blocking_threshold = usize::MAX;
    // in blocks of columns (of more than 32) faer 0.24 loses the pencil on its way to triangles
    params.hessenberg.block_size = 1;
    let params = Spec::new(params);
    let [mut above, mut below] = [0; 2].map(|_| Diag::full(n, c64::new(f64::NAN, f64::NAN)));
    let [mut a, mut e] = [a, e].map(|m| Mat::from_fn(n, n, |i, j| c64::new(m[(i, j)], 0.0)));
    let none = ComputeEigenvectors::No;
    with_memory(gevd_scratch::<c64>(n, none, none, Par::Seq, params), |stack| {
        let values = (above.as_mut(), below.as_mut());
        gevd_cplx(a.as_mut(), e.as_mut(), values.0, values.1, None, None, Par::Seq, stack, params).ok()
    })?;
    let all = above.column_vector().iter().zip(below.column_vector().iter());
    let known = |(a, b): (&c64, &c64)| {
        let [a, b] = [a, b].map(|v| Complex::new(v.re, v.im));
        (!a.is_nan() && !b.is_nan()).then_some((a, b))
    };
    all.map(known).collect()
}

fn with_memory<T>(size: StackReq, work: impl FnOnce(&mut MemStack) -> T) -> T {
    work(MemStack::new(&mut MemBuffer::new(size)))
}

/// Complex matrices.
pub(crate) type Complexes = DMatrix<Complex<f64>>;

/// Singular values, largest first; all NaN where they are not found.
pub(crate) fn singular_values(matrix: &Complexes) -> Vec<f64> {
    let (n, m) = matrix.shape();
    if n == 1 || m == 1 {
        return vec![matrix.norm()];
    }
    let dense = Mat::from_fn(n, m, |i, j| matrix[(i, j)]);
    dense.singular_values().unwrap_or_else(|_| vec![f64::NAN; n.min(m)])
}

/// Singular values of a real matrix with left and right vectors as columns, largest first.
pub(crate) fn svd(matrix: &DMatrix<f64>) -> Result<(DMatrix<f64>, Vec<f64>, DMatrix<f64>)> {
    let (n, m) = matrix.shape();
    // their squares shall neither overflow nor vanish
    let size = matrix.amax();
    let unit = if size > 0.0 && size.is_finite() { size } else { 1.0 };
    let Ok(found) = dense(&(matrix / unit)).svd() else { return Err(not_found("singular values")) };
    let left = DMatrix::from_fn(n, n, |i, j| found.U()[(i, j)]);
    let right = DMatrix::from_fn(m, m, |i, j| found.V()[(i, j)]);
    Ok((left, found.S().column_vector().iter().map(|v| v * unit).collect(), right))
}

fn dense(matrix: &DMatrix<f64>) -> Mat<f64> {
    Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)])
}

fn not_found(what: &str) -> Error {
    Error::value(what, "not found", "found by the QR algorithm", "Scale the matrix.")
}

#[cfg(test)]
mod tests {
    use super::*;
    use rng::{Purpose, Stream};

    /// A delay of n samples under a weak feedback: λⁿ = ε. All eigenvalues are as large: faer's early deflation swaps pairs of them
    /// for ever.
    #[test]
    fn eigenvalues_of_a_ring_are_found_in_bounded_time() {
        for (n, weak) in [(30, 1e-8), (76, 1e-4), (110, 1e-8), (140, 1e-15)] {
            let ring = DMatrix::from_fn(n, n, |i, j| match (i, j) {
                (0, last) if last + 1 == n => weak,
                _ => f64::from(u8::from(i == j + 1)),
            });
            let radius = weak.powf(1.0 / n as f64);
            let off = |size: f64| (size / radius - 1.0).abs();
            let values = eigenvalues(&ring).unwrap();
            let (vectors, _, _) = eigenvectors(&ring).unwrap();
            let turned = ring.map(|v| Complex::new(0.0, v));
            assert_eq!((values.len(), vectors.len()), (n, n));
            let pairs = pencil_eigenvalues(&ring, &DMatrix::identity(n, n)).unwrap();
            assert_eq!(pairs.len(), n);
            let all = values.iter().chain(&vectors).chain(&pairs).map(|l| l.norm());
            let worst = all.chain([complex_spectral_radius(&turned)]).map(off).fold(0.0, f64::max);
            println!("{n}: {worst:.1e}");
            assert!(worst < 1e-3, "{n}: {worst:e}");
        }
    }

    /// The largest distance from one of `of` to the nearest of `to`.
    fn apart(of: &[Complex<f64>], to: &[Complex<f64>]) -> f64 {
        let nearest = |a: &Complex<f64>| to.iter().map(|b| (a - b).norm()).fold(f64::INFINITY, f64::min);
        of.iter().map(nearest).fold(0.0, f64::max)
    }

    /// A λ with det(A − λ E) = 0 leaves A − λ E a singular value of 0.
    #[test]
    fn pencils_of_every_order_lose_rank_at_what_is_found_of_them() {
        let mut random = Stream::new(3, 0, 0, Purpose::user(1));
        for (n, infinite) in
            [1, 2, 3, 5, 8, 20, 31, 32, 33, 34, 50, 76, 100].into_iter().flat_map(|n| [(n, 0), (n, n / 3)])
        {
            let a = DMatrix::from_fn(n, n, |_, _| random.uniform(-1.0, 1.0));
            let mut e = DMatrix::identity(n, n) + DMatrix::from_fn(n, n, |_, _| random.uniform(-0.3, 0.3) / n as f64);
            e.rows_mut(n - infinite, infinite).fill(0.0);
            let found = pencil_eigenvalues(&a, &e).unwrap();
            assert_eq!(found.len(), n - infinite, "{n}: {found:?}");
            let [a, e] = [a, e].map(|m| m.map(|v| Complex::new(v, 0.0)));
            let left = |l: &Complex<f64>| {
                let values = singular_values(&(&a - &e * *l));
                values[n - 1] / values[0]
            };
            let worst = found.iter().map(left).fold(0.0, f64::max);
            // measured: 3e-15; of real pencils faer left 8e-2
            assert!(n == 1 || worst < 1e-11, "{n}, {infinite}: {worst:e}");
            let unpaired = found.iter().filter(|l| l.im != 0.0).map(|l| apart(&[l.conj()], &found)).fold(0.0, f64::max);
            assert!(unpaired < 1e-8, "{n}, {infinite}: {unpaired:e}");
        }
    }

    #[test]
    fn matrices_without_rows_or_of_any_size_of_numbers_have_eigenvalues() {
        assert!(eigenvalues(&DMatrix::zeros(0, 0)).unwrap().is_empty());
        assert_eq!(complex_spectral_radius(&Complexes::zeros(0, 0)), 0.0);
        for size in [1e-300, 1e-160, 1.0, 1e150] {
            let matrix = DMatrix::from_row_slice(2, 2, &[0.0, size, -size, 0.0]);
            let radius = spectral_radius(&matrix).unwrap();
            assert!((radius / size - 1.0).abs() < 1e-12, "{size:e}: {radius:e}");
        }
    }
}
