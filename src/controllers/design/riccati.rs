//! Riccati and Lyapunov equations by structure-preserving doubling.
//!
//! With W = (I + GH)⁻¹ and A₀ = A, G₀ = B R⁻¹ Bᵀ, H₀ = Q, one doubling
//!
//! ```text
//! A ← A W A,   G ← G + A W G Aᵀ,   H ← H + Aᵀ H W A
//! ```
//!
//! makes of the problem over N steps that over 2N: H is the cost to go, A the closed loop of all those steps. H grows to
//! the stabilising solution X, A falls to zero, both with the square of the square. The increment of H is computed, not
//! subtracted, so that its smallness is known beyond rounding.
//!
//! Everything is generic over nalgebra's `RealField`: over duals the same lines give the derivative of the solution.
//!
//! Source: Chu, Fan, Lin and Wang 2004 (discrete), Chu, Fan and Lin 2005 (Cayley transform of the continuous equation).

use base::error::{Error, Result};
use nalgebra::{DMatrix, RealField, convert};

/// Most doublings: 2⁶⁰ steps. A loop that needs more does not settle.
const MOST: usize = 60;
/// Largest asymmetry of Q and R, and largest negative part of Q, relative to their norm.
const TOLERANCE: f64 = 1e-10;

/// A symmetric solution X and how it was found.
#[derive(Debug, Clone, PartialEq)]
pub struct RiccatiSolution<T> {
    /// X ⪰ 0, n × n.
    pub matrix: DMatrix<T>,
    /// Doublings.
    pub doublings: usize,
    /// ‖residual‖/(sum of the norms of its terms), Frobenius, computed anew from the equation.
    pub residual: T,
}

/// X = Aᵀ X A − Aᵀ X B (R + Bᵀ X B)⁻¹ Bᵀ X A + Q, the solution that stabilises A − B K with K = (R + Bᵀ X B)⁻¹ Bᵀ X A.
/// A n × n, B n × m, Q n × n, R m × m.
///
/// # Errors
/// [`Error::Value`] where sizes do not fit, a number is not finite, Q is not symmetric and positive semi-definite or R not
/// symmetric and positive definite, or where nothing stabilises: B does not reach a mode of A that does not decay, or Q
/// does not see one.
pub fn discrete<T: RealField + Copy>(
    a: &DMatrix<T>,
    b: &DMatrix<T>,
    q: &DMatrix<T>,
    r: &DMatrix<T>,
) -> Result<RiccatiSolution<T>> {
    let g = check(a, b, q, r)?;
    let (x, doublings) = doubled(a.clone(), g, q.clone())?;
    let (xa, xb) = (&x * a, &x * b);
    let through = b.tr_mul(&xa);
    let inner = solve(r + b.tr_mul(&xb), &through)?;
    let terms = [a.tr_mul(&xa), -x.clone(), -through.tr_mul(&inner), q.clone()];
    Ok(RiccatiSolution { residual: relative(&terms), matrix: x, doublings })
}

/// Aᵀ X + X A − X B R⁻¹ Bᵀ X + Q = 0, the solution that stabilises A − B R⁻¹ Bᵀ X; sizes as in [`discrete`].
///
/// With γ above the modulus of every eigenvalue of the Hamiltonian matrix, s → (s + γ)/(s − γ) turns it into a discrete
/// equation with the same solution; γ only moves the number of doublings, by its logarithm.
///
/// # Errors
/// As [`discrete`], in continuous time.
pub fn continuous<T: RealField + Copy>(
    a: &DMatrix<T>,
    b: &DMatrix<T>,
    q: &DMatrix<T>,
    r: &DMatrix<T>,
) -> Result<RiccatiSolution<T>> {
    let g = check(a, b, q, r)?;
    let n = a.nrows();
    let floor: T = convert(1e-100);
    let product = (g.norm_squared() * q.norm_squared() + floor).sqrt();
    let gamma = (a.norm_squared() + product).sqrt() * convert(1.5);
    let shifted = a - DMatrix::identity(n, n) * gamma;
    let back = inverse(shifted.clone())?;
    let w = inverse(shifted.transpose() + q * &back * &g)?;
    let twice = gamma + gamma;
    let start = DMatrix::identity(n, n) + w.transpose() * twice;
    let (x, doublings) = doubled(start, symmetric(&back * &g * &w * twice), symmetric(&w * q * &back * twice))?;
    let xa = &x * a;
    let terms = [xa.transpose(), xa, -(&x * &g * &x), q.clone()];
    Ok(RiccatiSolution { residual: relative(&terms), matrix: x, doublings })
}

/// X = Aᵀ X A + Q, the sum Σ (Aᵀ)ᵏ Q Aᵏ: what a stable loop costs from each start on. Doubling without an input.
///
/// # Errors
/// [`Error::Value`] where sizes do not fit, a number is not finite, Q is not symmetric and positive semi-definite, or A
/// does not decay.
pub fn lyapunov<T: RealField + Copy>(a: &DMatrix<T>, q: &DMatrix<T>) -> Result<RiccatiSolution<T>> {
    let n = check_loop(a, q)?;
    let (x, doublings) = doubled(a.clone(), DMatrix::zeros(n, n), q.clone())?;
    let terms = [a.tr_mul(&(&x * a)), -x.clone(), q.clone()];
    Ok(RiccatiSolution { residual: relative(&terms), matrix: x, doublings })
}

/// Aᵀ X + X A + Q = 0, the integral of exp(Aᵀt) Q exp(At): what a stable continuous loop costs from each start on. By the Cayley
/// transform of [`continuous`].
///
/// # Errors
/// As [`lyapunov`], in continuous time.
pub fn continuous_lyapunov<T: RealField + Copy>(a: &DMatrix<T>, q: &DMatrix<T>) -> Result<RiccatiSolution<T>> {
    let n = check_loop(a, q)?;
    let gamma = a.norm_squared().sqrt() + convert(1e-100);
    let eye = DMatrix::identity(n, n) * gamma;
    let back = inverse(a - &eye)?;
    let cost = symmetric(back.tr_mul(q) * &back * (gamma + gamma));
    let (x, doublings) = doubled((a + eye) * &back, DMatrix::zeros(n, n), cost)?;
    let xa = &x * a;
    let terms = [xa.transpose(), xa, q.clone()];
    Ok(RiccatiSolution { residual: relative(&terms), matrix: x, doublings })
}

/// The limit of H, and the doublings it took.
fn doubled<T: RealField + Copy>(
    mut a: DMatrix<T>,
    mut g: DMatrix<T>,
    mut h: DMatrix<T>,
) -> Result<(DMatrix<T>, usize)> {
    let n = a.nrows();
    let (small, gone): (T, T) = (convert(1e-32), convert(1e-20));
    for k in 1..=MOST {
        let w = (DMatrix::identity(n, n) + &g * &h).lu();
        let (Some(wa), Some(wg)) = (w.solve(&a), w.solve(&g)) else { break };
        let more = a.tr_mul(&(&h * &wa));
        g = symmetric(&g + &a * wg * a.transpose());
        a *= wa;
        h = symmetric(h + &more);
        let (size, left) = (h.norm_squared(), a.norm_squared());
        if !(size + left + g.norm_squared()).is_finite() {
            break;
        }
        if more.norm_squared() <= small * size && left <= gone {
            return Ok((h, k));
        }
    }
    Err(Error::value(
        "Riccati equation: the closed loop",
        format!("not settled after 2^{MOST} steps or without bound"),
        "stable under some feedback, with every mode that does not decay seen by Q",
        "Check that the inputs reach every mode that does not decay ((A, B) stabilisable), and weigh such modes in Q.",
    ))
}

/// Checks sizes, numbers and signs; G = B R⁻¹ Bᵀ.
pub(super) fn check<T: RealField + Copy>(
    a: &DMatrix<T>,
    b: &DMatrix<T>,
    q: &DMatrix<T>,
    r: &DMatrix<T>,
) -> Result<DMatrix<T>> {
    let (n, m) = (a.nrows(), b.ncols());
    size("A", a, (n, n))?;
    size("B", b, (n, m))?;
    size("Q", q, (n, n))?;
    size("R", r, (m, m))?;
    check_cost(q)?;
    check_symmetry("R", r)?;
    let Some(r) = r.clone().cholesky() else {
        let remedy = "Every input must cost something: raise its entry on the diagonal.";
        return Err(Error::value("R", "not positive definite", "symmetric and positive definite", remedy));
    };
    Ok(symmetric(b * r.solve(&b.transpose())))
}

/// Checks sizes, numbers and signs of a loop without inputs; its size.
fn check_loop<T: RealField + Copy>(a: &DMatrix<T>, q: &DMatrix<T>) -> Result<usize> {
    let n = a.nrows();
    size("A", a, (n, n))?;
    size("Q", q, (n, n))?;
    check_cost(q)?;
    Ok(n)
}

fn size<T: RealField + Copy>(name: &str, m: &DMatrix<T>, (rows, columns): (usize, usize)) -> Result<()> {
    if m.shape() != (rows, columns) || m.is_empty() {
        let got = format!("{} × {}", m.nrows(), m.ncols());
        let remedy = "A is n × n, B n × m, Q n × n and R m × m, with n, m ≥ 1.";
        return Err(Error::value(format!("size of {name}"), got, format!("{rows} × {columns}"), remedy));
    }
    match m.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(at) => {
            let what = format!("{name}[{}, {}]", at % rows, at / rows);
            Err(Error::value(what, format!("{:?}", m[at]), "a finite number", "Correct it at its source."))
        }
    }
}

fn check_symmetry<T: RealField + Copy>(name: &str, m: &DMatrix<T>) -> Result<()> {
    let bound: T = convert(TOLERANCE * TOLERANCE);
    if (m - m.transpose()).norm_squared() <= bound * m.norm_squared() {
        return Ok(());
    }
    Err(Error::value(name, "not symmetric", "symmetric", format!("Use ½({name} + {name}ᵀ): the cost is the same.")))
}

/// Q symmetric, and positive definite once a rounding's worth is added to its diagonal.
fn check_cost<T: RealField + Copy>(q: &DMatrix<T>) -> Result<()> {
    check_symmetry("Q", q)?;
    let n = q.nrows();
    let lift: T = (q.norm_squared() + convert(1e-200)).sqrt() * convert(TOLERANCE);
    if (q + DMatrix::identity(n, n) * lift).cholesky().is_some() {
        return Ok(());
    }
    let remedy = "A negative cost rewards running away: use squares of what should be small.";
    Err(Error::value("Q", "not positive semi-definite", "symmetric and positive semi-definite", remedy))
}

fn symmetric<T: RealField + Copy>(m: DMatrix<T>) -> DMatrix<T> {
    let half: T = convert(0.5);
    (&m + m.transpose()) * half
}

fn solve<T: RealField + Copy>(m: DMatrix<T>, right: &DMatrix<T>) -> Result<DMatrix<T>> {
    m.lu().solve(right).ok_or_else(singular)
}

fn inverse<T: RealField + Copy>(m: DMatrix<T>) -> Result<DMatrix<T>> {
    m.try_inverse().ok_or_else(singular)
}

fn singular() -> Error {
    let remedy = "Bring states and inputs to comparable sizes: choose other units or weights.";
    Error::value("Riccati equation: a matrix", "singular to rounding", "invertible", remedy)
}

/// ‖Σ terms‖/Σ‖terms‖.
fn relative<T: RealField + Copy>(terms: &[DMatrix<T>]) -> T {
    let mut sum = terms[0].clone();
    let mut size = terms[0].norm();
    for term in &terms[1..] {
        sum += term;
        size += term.norm();
    }
    if size > T::zero() { sum.norm() / size } else { T::zero() }
}
