//! Kalman filters of linear systems: the steady one by the Riccati equation, and the one whose covariance goes along.
//!
//! ```text
//! x⁺ = A x + B u + w,   y = C x + D u + v        w ~ N(0, W),  v ~ N(0, V)
//!
//! predict   x̄ = A x̂ + B u                        P̄ = A P Aᵀ + W
//! correct   x̂ = x̄ + L (y − C x̄ − D u)            L = P̄ Cᵀ (C P̄ Cᵀ + V)⁻¹,  P = (I − L C) P̄ (I − L C)ᵀ + L V Lᵀ
//! ```
//!
//! Source: Kalman 1960; P in Joseph's form (Bucy and Joseph 1968), which stays symmetric and positive.

use crate::design::lqr::all_settle;
use crate::design::riccati;
use crate::linear::structure::Staircase;
use crate::linear::{StateSpace, eigenvalues};
use base::error::{Error, Result};
use nalgebra::{Complex, DMatrix, DVector};

/// The filter that a [`KalmanFilter`] of a system that does not change comes to.
#[derive(Debug, Clone, PartialEq)]
pub struct SteadyKalman {
    /// L, n × p: of x̂ = x̄ + L (y − ȳ) of a sampled system; of dx̂/dt = A x̂ + B u + L (y − ŷ) of a continuous one.
    pub gain: DMatrix<f64>,
    /// P̄ before a measurement is known, n × n; of a continuous system P.
    pub covariance: DMatrix<f64>,
    /// P once it is, n × n; of a continuous system the same.
    pub corrected: DMatrix<f64>,
    /// Poles of the error, A − A L C (continuous: A − L C), largest modulus first.
    pub poles: Vec<Complex<f64>>,
    /// Relative residual of the Riccati equation.
    pub residual: f64,
}

/// The steady Kalman filter of a system with state noise of covariance `process` (W, n × n) and measurement noise of covariance `noise`
/// (V, p × p); of a continuous system both are densities. P solves the Riccati equation of [`riccati`] for Aᵀ and Cᵀ.
///
/// # Errors
/// As [`riccati::discrete`]; [`Error::Value`] that names modes which do not decay and no output shows, or no noise moves.
pub fn steady_kalman(system: &StateSpace, process: &DMatrix<f64>, noise: &DMatrix<f64>) -> Result<SteadyKalman> {
    check("W", process, system.n_state())?;
    check("V", noise, system.n_output())?;
    if system.dt().is_some() {
        settles(system, process)?;
    }
    let (a, c) = (system.a(), system.c());
    let (at, ct) = (a.transpose(), c.transpose());
    if system.dt().is_none() {
        let found = riccati::continuous(&at, &ct, process, noise)?;
        let gain = solved(noise, &(c * &found.matrix))?.transpose();
        let poles = eigenvalues(&(a - &gain * c))?;
        let covariance = found.matrix;
        return Ok(SteadyKalman { corrected: covariance.clone(), gain, covariance, poles, residual: found.residual });
    }
    let found = riccati::discrete(&at, &ct, process, noise)?;
    let covariance = found.matrix;
    let gain = solved(&(c * &covariance * &ct + noise), &(c * &covariance))?.transpose();
    let corrected = corrected(&covariance, &gain, c, noise);
    let poles = eigenvalues(&(a - a * &gain * c))?;
    Ok(SteadyKalman { gain, covariance, corrected, poles, residual: found.residual })
}

/// y → u: the feedback u = −K x̂ on what a steady filter makes of measurements and of these commands. Of a sampled system the
/// measurement of a sample counts in its command, which takes D = 0:
///
/// ```text
/// x̂ = (I − L C) x̄ + L y,   u = −K x̂,   x̄⁺ = (A − B K) x̂
/// ```
///
/// In the loop with `system` it is fed back with positive sign: the minus is inside.
///
/// # Errors
/// [`Error::Value`] for a gain that is not m × n, or a sampled system whose outputs see its inputs at once.
pub fn lqg(system: &StateSpace, filter: &SteadyKalman, gain: &DMatrix<f64>) -> Result<StateSpace> {
    let (n, m, p) = (system.n_state(), system.n_input(), system.n_output());
    if gain.shape() != (m, n) {
        let size = format!("{} × {}", gain.nrows(), gain.ncols());
        return Err(Error::value("size of K", size, format!("{m} × {n}"), "Give the gain of this system."));
    }
    let (a, b, c, d, l) = (system.a(), system.b(), system.c(), system.d(), &filter.gain);
    let closed = a - b * gain;
    let loop_of = |a, b, c, d| {
        StateSpace::new(a, b, c, d, system.dt())?.named(
            system.states().to_vec(),
            system.outputs().to_vec(),
            system.inputs().to_vec(),
        )
    };
    if system.dt().is_none() {
        return loop_of(closed - l * c + l * d * gain, l.clone(), -gain, DMatrix::zeros(m, p));
    }
    if d.amax() > 0.0 {
        let remedy = "Delay the outputs by a sample, or leave out those that see inputs at once.";
        return Err(Error::value("largest |D|", d.amax(), "0 for a sampled LQG", remedy));
    }
    let kept = DMatrix::identity(n, n) - l * c;
    loop_of(&closed * &kept, &closed * l, -gain * kept, -gain * l)
}

/// What a measurement told that was not known.
#[derive(Debug, Clone, PartialEq)]
pub struct Innovation {
    /// ν = y − ȳ, `[p]`.
    pub value: DVector<f64>,
    /// S = C P̄ Cᵀ + V, p × p.
    pub covariance: DMatrix<f64>,
    /// νᵀ S⁻¹ ν: χ² with p degrees of freedom where the model is right.
    pub squared: f64,
}

/// A Kalman filter whose model may differ from step to step.
#[derive(Debug, Clone, PartialEq)]
pub struct KalmanFilter {
    /// x̂, `[n]`.
    pub state: DVector<f64>,
    /// P, n × n.
    pub covariance: DMatrix<f64>,
}

impl KalmanFilter {
    /// A filter that knows the state as N(`state`, `covariance`).
    ///
    /// # Errors
    /// [`Error::Value`] for a covariance of another size, that is not finite, symmetric and positive semi-definite, or a state that is not
    /// finite.
    pub fn new(state: DVector<f64>, covariance: DMatrix<f64>) -> Result<Self> {
        check("P", &covariance, state.len())?;
        if let Some(x) = state.iter().find(|x| !x.is_finite()) {
            return Err(Error::value("state of a filter", x, "finite", "Begin where it is known."));
        }
        Ok(Self { state, covariance })
    }

    /// Over a step with commands `u` `[m]` and state noise `process` (W, n × n).
    ///
    /// # Panics
    /// For other sizes.
    pub fn predict(&mut self, [a, b]: [&DMatrix<f64>; 2], u: &DVector<f64>, process: &DMatrix<f64>) {
        self.state = a * &self.state + b * u;
        self.covariance = symmetric(&(a * &self.covariance * a.transpose() + process));
    }

    /// Takes in a measurement `y` `[p]` of C x + D u with noise `noise` (V, p × p). One that is not finite, or whose covariance is not
    /// positive, leaves the filter as it was.
    ///
    /// # Errors
    /// [`Error::Value`] for such a one.
    ///
    /// # Panics
    /// For other sizes.
    pub fn correct(
        &mut self,
        [c, d]: [&DMatrix<f64>; 2],
        u: &DVector<f64>,
        y: &DVector<f64>,
        noise: &DMatrix<f64>,
    ) -> Result<Innovation> {
        let value = y - c * &self.state - d * u;
        if let Some(x) = value.iter().find(|x| !x.is_finite()) {
            return Err(Error::value("innovation", x, "finite", "Leave out measurements that are no numbers."));
        }
        let covariance = symmetric(&(c * &self.covariance * c.transpose() + noise));
        let gain = solved(&covariance, &(c * &self.covariance))?.transpose();
        let weighted = solved(&covariance, &DMatrix::from_column_slice(value.len(), 1, value.as_slice()))?;
        self.state += &gain * &value;
        self.covariance = corrected(&self.covariance, &gain, c, noise);
        Ok(Innovation { squared: value.dot(&weighted.column(0)), value, covariance })
    }

    /// (x − x̂)ᵀ P⁻¹ (x − x̂): χ² with n degrees of freedom where the filter is consistent (NEES).
    ///
    /// # Errors
    /// [`Error::Value`] where P is singular: what is known exactly has no share.
    ///
    /// # Panics
    /// For a truth of another size.
    pub fn squared_error(&self, truth: &DVector<f64>) -> Result<f64> {
        let off = truth - &self.state;
        let weighted = solved(&self.covariance, &DMatrix::from_column_slice(off.len(), 1, off.as_slice()))?;
        Ok(off.dot(&weighted.column(0)))
    }
}

/// P in Joseph's form.
pub(super) fn corrected(
    covariance: &DMatrix<f64>,
    gain: &DMatrix<f64>,
    c: &DMatrix<f64>,
    noise: &DMatrix<f64>,
) -> DMatrix<f64> {
    let kept = DMatrix::identity(covariance.nrows(), covariance.nrows()) - gain * c;
    symmetric(&(&kept * covariance * kept.transpose() + gain * noise * gain.transpose()))
}

pub(super) fn symmetric(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    0.5 * (matrix + matrix.transpose())
}

/// S⁻¹ M of a covariance S.
fn solved(covariance: &DMatrix<f64>, matrix: &DMatrix<f64>) -> Result<DMatrix<f64>> {
    let factor = covariance.clone().cholesky().ok_or_else(|| {
        let remedy = "Give every measurement noise of its own, and every state a variance.";
        Error::value("covariance", "not positive definite", "positive definite", remedy)
    })?;
    Ok(factor.solve(matrix))
}

fn check(name: &str, covariance: &DMatrix<f64>, n: usize) -> Result<()> {
    let what = || format!("covariance {name}");
    if covariance.shape() != (n, n) {
        let size = format!("{} × {}", covariance.nrows(), covariance.ncols());
        return Err(Error::value(what(), size, format!("{n} × {n}"), "Give one row and column per signal."));
    }
    if let Some(x) = covariance.iter().find(|x| !x.is_finite()) {
        return Err(Error::value(what(), x, "finite", "Correct it at its source."));
    }
    let size = covariance.amax();
    let lean = (covariance - covariance.transpose()).amax();
    if lean > 1e-10 * size {
        return Err(Error::value(what(), format!("asymmetric by {lean:e}"), "symmetric", "Give (M + Mᵀ)/2."));
    }
    match (0..n).find(|i| covariance[(*i, *i)] < 0.0) {
        Some(i) => Err(Error::value(what(), covariance[(i, i)], "≥ 0 on its diagonal", "Variances are squares.")),
        None => Ok(()),
    }
}

/// Every mode that does not decay is shown by an output and moved by noise.
fn settles(system: &StateSpace, process: &DMatrix<f64>) -> Result<()> {
    let (states, a) = (system.states(), system.a());
    let remedy = "Measure a state that takes part in them.";
    all_settle(states, &Staircase::of(&a.transpose(), &system.c().transpose())?, "seen by an output", remedy)?;
    let remedy = "Give a state that takes part in them noise, or leave it out.";
    all_settle(states, &Staircase::of(a, process)?, "moved by noise", remedy)
}

#[cfg(test)]
mod tests;
