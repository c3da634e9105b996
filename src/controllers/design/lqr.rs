//! State feedback of least quadratic cost.
//!
//! For x⁺ = A x + B u the feedback u = −K x with K = (R + Bᵀ X B)⁻¹ Bᵀ X A has the least Σ xᵀ Q x + uᵀ R u; X solves the
//! [Riccati equation](super::riccati::discrete). Where a disturbance is known ahead, x⁺ = A x + B u + w, the least cost is
//! at
//!
//! ```text
//! u = −K x + Σⱼ Fⱼ w(k + j),   Fⱼ = −(R + Bᵀ X B)⁻¹ Bᵀ ((A − B K)ᵀ)ʲ X
//! ```
//!
//! A reference is such a disturbance of the error from it.
//!
//! Source: Anderson and Moore 1990, sections 2 and 4.

use super::riccati;
use crate::linear::structure::Staircase;
use crate::linear::{Signal, eigenvalues};
use base::error::{Error, Result};
use nalgebra::{Complex, DMatrix};

/// An optimal feedback.
#[derive(Debug, Clone, PartialEq)]
pub struct Regulator {
    /// K, m × n: u = −K x.
    pub gain: DMatrix<f64>,
    /// X, n × n: xᵀ X x is the cost from x on.
    pub cost: DMatrix<f64>,
    /// A − B K, n × n.
    pub closed_loop: DMatrix<f64>,
    /// Eigenvalues of A − B K, largest modulus first, all within the unit circle.
    pub poles: Vec<Complex<f64>>,
    /// (R + Bᵀ X B)⁻¹ Bᵀ, m × n; see [`preview`](Self::preview).
    pub push: DMatrix<f64>,
    /// Doublings of the Riccati equation.
    pub doublings: usize,
    /// Relative residual of the Riccati equation ([`RiccatiSolution::residual`](riccati::RiccatiSolution::residual)).
    pub residual: f64,
}

/// The feedback u = −K x of least Σ xᵀ Q x + uᵀ R u for x⁺ = A x + B u: K = (R + Bᵀ X B)⁻¹ Bᵀ X A with X of
/// [`riccati::discrete`]. A n × n, B n × m, Q n × n, R m × m.
///
/// # Errors
/// As [`riccati::discrete`]; where combinations of states that do not decay are out of reach of B, or unseen by Q, the error
/// names them: `x0`, `x1`, ….
pub fn lqr(a: &DMatrix<f64>, b: &DMatrix<f64>, q: &DMatrix<f64>, r: &DMatrix<f64>) -> Result<Regulator> {
    lqr_of(&Signal::numbered("x", a.nrows()), a, b, q, r)
}

/// [`lqr`] of states that have names, `[n]`: its errors name them.
///
/// # Errors
/// As [`lqr`].
pub fn lqr_of(
    states: &[Signal],
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
) -> Result<Regulator> {
    riccati::check(a, b, q, r)?;
    let remedy = "Give the system an input that moves them, or leave their states out.";
    all_settle(states, &Staircase::of(a, b)?, "reached by an input", remedy)?;
    let remedy = "Weigh a state that takes part in them.";
    all_settle(states, &Staircase::of(&a.transpose(), q)?, "seen by Q", remedy)?;
    let solution = riccati::discrete(a, b, q, r)?;
    let x = solution.matrix;
    let inner = r + b.tr_mul(&(&x * b));
    let Some(inner) = inner.cholesky() else {
        return Err(Error::value("R + BᵀXB", "not positive definite", "positive definite", "Raise R."));
    };
    let push = inner.solve(&b.transpose());
    let gain = &push * &x * a;
    let closed_loop = a - b * &gain;
    let poles = eigenvalues(&closed_loop)?;
    let size = poles.first().map_or(0.0, |p| p.norm());
    if size >= 1.0 {
        let remedy = "Bring states and inputs to comparable sizes: choose other units or weights.";
        return Err(Error::value("largest pole of the closed loop", size, "< 1", remedy));
    }
    Ok(Regulator {
        gain,
        cost: x,
        closed_loop,
        poles,
        push,
        doublings: solution.doublings,
        residual: solution.residual,
    })
}

impl Regulator {
    /// ((A − B K)ᵀ)ʲ X for j = 0 to n − 1, each multiplied by `left` from the left: what a disturbance that comes j steps
    /// later weighs now. With −[`push`](Self::push) as `left` these are F₀, F₁, … of u = −K x + Σⱼ Fⱼ w(k + j).
    pub fn preview(&self, left: &DMatrix<f64>, n: usize) -> Vec<DMatrix<f64>> {
        let step = self.closed_loop.transpose();
        let mut price = self.cost.clone();
        let mut gains = Vec::with_capacity(n);
        for _ in 0..n {
            gains.push(left * &price);
            price = &step * price;
        }
        gains
    }
}

/// The feedback of least cost that also integrates y = C x (C p × n): of x⁺ = A x + B u with z⁺ = z + T C x, over both; T is
/// `period`, s.
///
/// `q` weighs (x, z), so it has n + p rows for p outputs. The [gain](Regulator::gain) is [K, K_i], m × (n + p): u = −K x − K_i z
/// holds y at zero against constant disturbances.
///
/// Source: Anderson and Moore 1990, section 4.3; Davison 1972.
///
/// # Errors
/// As [`lqr`]; [`Error::Value`] for a C that does not fit, or that has a zero of the plant at 1 (which an integrator cannot move).
pub fn lqi(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    c: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    period: f64,
) -> Result<Regulator> {
    lqi_of(&Signal::numbered("x", a.nrows()), a, b, c, q, r, period)
}

/// [`lqi`] of states that have names, `[n]`: its errors name them.
///
/// # Errors
/// As [`lqi`].
pub fn lqi_of(
    states: &[Signal],
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    c: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    period: f64,
) -> Result<Regulator> {
    let (n, p) = (a.nrows(), c.nrows());
    if a.ncols() != n || b.nrows() != n {
        let value = format!("A {:?}, B {:?}", a.shape(), b.shape());
        return Err(Error::value("sizes", value, "A n × n, B n × m", "Give one row of B per state."));
    }
    if c.ncols() != n {
        return Err(Error::value("columns of C", c.ncols(), format!("{n}, one per state"), "Give y = C x."));
    }
    if q.shape() != (n + p, n + p) {
        let rule = format!("({0}, {0}): states, then what is integrated", n + p);
        return Err(Error::value("size of Q", format!("{:?}", q.shape()), rule, "Weigh the integrals too."));
    }
    let mut state = DMatrix::identity(n + p, n + p);
    state.view_mut((0, 0), (n, n)).copy_from(a);
    state.view_mut((n, 0), (p, n)).copy_from(&(c * period));
    let mut input = DMatrix::zeros(n + p, b.ncols());
    input.rows_mut(0, n).copy_from(b);
    let integrals = (0..p).map(|i| match (0..n).filter(|j| c[(i, *j)] != 0.0).collect::<Vec<_>>()[..] {
        [one] => Signal::new(format!("integral of {}", states[one].name), ""),
        _ => Signal::new(format!("integral {i}"), ""),
    });
    let states: Vec<Signal> = states.iter().cloned().chain(integrals).collect();
    lqr_of(&states, &state, &input, q, r)
}

/// Feedback of least cost over N steps, x⁺ = A x + B u: u(k) = −K(k) x(k).
#[derive(Debug, Clone, PartialEq)]
pub struct FiniteHorizon {
    /// K(0) to K(N − 1), m × n each.
    pub gains: Vec<DMatrix<f64>>,
    /// X(0): xᵀ X x is the cost from x on.
    pub cost: DMatrix<f64>,
}

/// The feedback of least Σ xᵀ Q x + uᵀ R u over `steps` steps with xᵀ Q_N x at their end, by the Riccati recursion backwards:
/// K = (R + BᵀXB)⁻¹ BᵀXA, X⁻ = Q + Kᵀ R K + (A − BK)ᵀ X (A − BK), which keeps X symmetric and positive.
///
/// Source: Joseph's form; Anderson and Moore 1990, section 2.4.
///
/// # Errors
/// [`Error::Value`] for sizes that do not fit, or R + BᵀXB that is not positive definite.
pub fn finite_horizon(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    end: &DMatrix<f64>,
    steps: usize,
) -> Result<FiniteHorizon> {
    let (n, m) = (a.nrows(), b.ncols());
    let fits = a.ncols() == n && b.nrows() == n && q.shape() == (n, n) && r.shape() == (m, m) && end.shape() == (n, n);
    if !fits {
        let sizes = format!(
            "A {:?}, B {:?}, Q {:?}, R {:?}, Q_N {:?}",
            a.shape(),
            b.shape(),
            q.shape(),
            r.shape(),
            end.shape()
        );
        let rule = "A, Q, Q_N n × n, B n × m, R m × m";
        return Err(Error::value("sizes", sizes, rule, "Give Q and R of states and inputs."));
    }
    let (mut cost, mut gains) = (end.clone(), Vec::new());
    for _ in 0..steps {
        let Some(inner) = (r + b.tr_mul(&(&cost * b))).cholesky() else {
            return Err(Error::value("R + BᵀXB", "not positive definite", "positive definite", "Raise R."));
        };
        let gain = inner.solve(&b.tr_mul(&(&cost * a)));
        let closed = a - b * &gain;
        let next = q + gain.tr_mul(&(r * &gain)) + closed.tr_mul(&(&cost * &closed));
        cost = 0.5 * (&next + next.transpose());
        gains.push(gain);
    }
    gains.reverse();
    Ok(FiniteHorizon { gains, cost })
}

/// Bryson's rule: a diagonal weight 1/d² per number, where d is the largest acceptable deviation of it; ∞ weighs nothing.
/// Every term of the cost is then 1 at its largest acceptable value.
///
/// # Errors
/// [`Error::Value`] unless every d > 0.
pub fn bryson(deviations: &[f64]) -> Result<DMatrix<f64>> {
    if let Some(i) = deviations.iter().position(|d| d.is_nan() || *d <= 0.0) {
        let what = format!("largest acceptable deviation {i}");
        return Err(Error::value(what, deviations[i], "> 0", "Use infinity for what does not matter."));
    }
    let weights: Vec<f64> = deviations.iter().map(|d| 1.0 / (d * d)).collect();
    Ok(DMatrix::from_diagonal(&weights.into()))
}

/// Refuses what a staircase does not reach and what does not decay: no feedback ends it, and none has a least cost.
pub(crate) fn all_settle(states: &[Signal], staircase: &Staircase, rule: &str, remedy: &str) -> Result<()> {
    let Some(lasting) = staircase.lasting()? else { return Ok(()) };
    let n = lasting.directions.len();
    let what = format!("what does not decay, {n} of {} directions of the state", states.len());
    Err(Error::value(what, lasting.names(states).join(", "), rule, remedy))
}
