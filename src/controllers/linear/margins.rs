//! How far one loop is from instability: L(s) around which the loop is closed with −1.
//!
//! Crossovers are zeros, not samples: |L| = 1 where 1 − L(−s) L(s) vanishes, arg L = −180° where L(s) − L(−s) does. Both are
//! generalised eigenvalue problems; each zero near the imaginary axis is then polished on the response itself. A grid of
//! frequencies is searched beside them.

use super::dense::pencil_eigenvalues;
use super::norms::h_infinity;
use super::response::frequencies;
use super::state_space::{StateSpace, blocks, one_loop};
use super::swept::Swept;
use base::error::Result;
use nalgebra::{Complex, DMatrix};
use std::f64::consts::TAU;

/// A margin where it is met.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// ω, rad/s.
    pub omega: f64,
    /// A factor on the loop, or a phase in rad.
    pub margin: f64,
}

/// Margins of one loop.
#[derive(Debug, Clone, PartialEq)]
pub struct Margins {
    /// Whether the closed loop is stable: margins of one that is not mean nothing.
    pub stable: bool,
    /// Factors k at which 1 + k L has a pole on the axis, by frequency; at ω = 0 and Nyquist too.
    pub gains: Vec<Crossing>,
    /// Phases φ ∈ (−π, π] at which 1 + exp(−jφ) L has, by frequency.
    pub phases: Vec<Crossing>,
    /// Least factor above 1; infinite without.
    pub gain_up: f64,
    /// Largest factor below 1; 0 without.
    pub gain_down: f64,
    /// Least |φ|, rad; infinite without a crossover.
    pub phase: f64,
    /// Least delay that ends stability, s; infinite without.
    pub delay: f64,
    /// Least |1 + L|: the distance to −1, 1/‖S‖∞; NaN if the loop is not stable.
    pub modulus: f64,
}

/// The margins of L, `system` of one input and one output, closed with −1.
///
/// # Errors
/// [`Error::Value`](base::error::Error::Value) for more inputs or outputs, or where eigenvalues are not found.
pub fn margins(system: &StateSpace) -> Result<Margins> {
    one_loop(system)?;
    let closed = system.feedback(&unit(system)?)?;
    let stable = closed.is_stable()?;
    let bent = system.continuous()?;
    let grid = frequencies(&bent, 400)?;
    let swept = Swept::of(&bent);
    let response = |w: f64| swept.at(Complex::new(0.0, w))[(0, 0)];

    let mut gains = Vec::new();
    let mut real: Vec<f64> = axis_zeros(&mirrored(&bent, false)?, &grid, &|w| response(w).im);
    real.extend([0.0].iter().filter(|_| response(0.0).norm().is_finite()));
    for w in real {
        let value = response(w).re;
        if value < 0.0 && value.is_finite() {
            gains.push(Crossing { omega: system.unbent(w), margin: -1.0 / value });
        }
    }
    if let Some(last) = system.dt().map(|_| system.at(system.on_axis(system.nyquist()))[(0, 0)].re).filter(|v| *v < 0.0)
    {
        gains.push(Crossing { omega: system.nyquist(), margin: -1.0 / last });
    }
    gains.sort_by(|a, b| a.omega.total_cmp(&b.omega));

    let even: Vec<f64> = axis_zeros(&mirrored(&bent, true)?, &grid, &|w| response(w).norm().ln());
    let phases: Vec<Crossing> =
        even.iter().map(|w| Crossing { omega: system.unbent(*w), margin: (-response(*w)).arg() }).collect();
    let lag = |c: &Crossing| if c.margin < 0.0 { c.margin + TAU } else { c.margin };
    let fold = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::INFINITY, f64::min);
    Ok(Margins {
        stable,
        gain_up: fold(&mut gains.iter().map(|c| c.margin).filter(|k| *k > 1.0)),
        gain_down: gains.iter().map(|c| c.margin).filter(|k| *k < 1.0).fold(0.0, f64::max),
        phase: fold(&mut phases.iter().map(|c| c.margin.abs())),
        delay: fold(&mut phases.iter().map(|c| lag(c) / c.omega)),
        modulus: if stable { 1.0 / h_infinity(&sensitivity(system)?)?.gain } else { f64::NAN },
        gains,
        phases,
    })
}

/// S = (I + L)⁻¹, L p × p: from what disturbs the outputs to the outputs.
///
/// # Errors
/// As [`StateSpace::feedback`].
pub fn sensitivity(system: &StateSpace) -> Result<StateSpace> {
    unit(system)?.feedback(system)
}

/// T = L (I + L)⁻¹, L p × p: from a reference to the outputs.
///
/// # Errors
/// As [`StateSpace::feedback`].
pub fn complementary(system: &StateSpace) -> Result<StateSpace> {
    system.feedback(&unit(system)?)
}

fn unit(system: &StateSpace) -> Result<StateSpace> {
    let n = system.n_output();
    StateSpace::gain(DMatrix::identity(n, n), system.dt())
}

/// The pencil whose zeros are those of L(s) − L(−s), or of 1 − L(−s) L(s).
fn mirrored(system: &StateSpace, product: bool) -> Result<(DMatrix<f64>, DMatrix<f64>)> {
    let (a, b, c, d) = (system.a(), system.b(), system.c(), system.d());
    let n = system.n_state();
    let (zero, one) = (DMatrix::zeros(n, n), DMatrix::identity(1, 1));
    let (poles, inputs, outputs, direct) = if product {
        let poles = blocks(a, &zero, &c.tr_mul(c), &-a.transpose());
        let inputs = super::state_space::stacked(b, &c.tr_mul(d));
        let outputs = super::state_space::beside(&-(d * c), &b.transpose());
        (poles, inputs, outputs, one - d * d)
    } else {
        let poles = blocks(a, &zero, &zero, &-a);
        (poles, super::state_space::stacked(b, b), super::state_space::beside(c, c), DMatrix::zeros(1, 1))
    };
    let pencil = blocks(&poles, &inputs, &outputs, &direct);
    let mass = DMatrix::from_fn(2 * n + 1, 2 * n + 1, |i, j| f64::from(u8::from(i == j && i < 2 * n)));
    Ok((pencil, mass))
}

/// ω > 0 at which `value` is 0, ascending: about the pencil's zeros near the axis, and where its sign changes along the grid.
fn axis_zeros(pencil: &(DMatrix<f64>, DMatrix<f64>), grid: &[f64], value: &dyn Fn(f64) -> f64) -> Vec<f64> {
    // an eigenvalue problem that fails leaves the grid
    let exact = pencil_eigenvalues(&pencil.0, &pencil.1).unwrap_or_default();
    let mut starts: Vec<(f64, f64)> = exact
        .iter()
        .filter(|l| l.im > 0.0 && l.re.abs() <= 1e-3 * l.im)
        .map(|l| (l.im * (1.0 - 1e-4), l.im * (1.0 + 1e-4)))
        .collect();
    starts.extend(grid.windows(2).map(|pair| (pair[0], pair[1])));
    let mut found: Vec<f64> = starts
        .into_iter()
        .filter(|(low, high)| (value(*low) < 0.0) != (value(*high) < 0.0))
        .filter_map(|(low, high)| bisected(low, high, value))
        .collect();
    found.sort_by(f64::total_cmp);
    found.dedup_by(|a, b| (*a - *b).abs() <= 1e-9 * b.abs());
    found
}

/// The root between two places of different sign; none where the sign changes through infinity.
fn bisected(mut low: f64, mut high: f64, value: &dyn Fn(f64) -> f64) -> Option<f64> {
    let below = value(low) < 0.0;
    let first = value(low).abs().max(value(high).abs());
    for _ in 0..200 {
        let middle = f64::midpoint(low, high);
        if middle <= low || middle >= high {
            break;
        }
        if (value(middle) < 0.0) == below { low = middle } else { high = middle }
    }
    (value(low).abs().min(value(high).abs()) <= first.min(1.0)).then(|| f64::midpoint(low, high))
}
