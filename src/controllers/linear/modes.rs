//! Poles and zeros, and what they mean.

use super::dense::{eigenvalues, eigenvectors, pencil_eigenvalues};
use super::state_space::{StateSpace, blocks};
use base::error::{Error, Result};
use nalgebra::{Complex, DMatrix};

/// One motion of a system on its own: exp(λ t) along one direction of the state.
#[derive(Debug, Clone, PartialEq)]
pub struct Mode {
    /// The pole as it stands in the system: λ, or exp(λ dt) of a sampled one.
    pub pole: Complex<f64>,
    /// λ, 1/s.
    pub rate: Complex<f64>,
    /// Natural frequency |λ|, rad/s.
    pub frequency: f64,
    /// Damping ratio −Re λ/|λ|: 1 does not swing, 0 swings for ever, below 0 grows. 1 at λ = 0.
    pub damping: f64,
    /// Seconds to 1/e, −1/Re λ; negative where it grows, infinite where it neither grows nor decays.
    pub time_constant: f64,
    /// States that take part, most first: number and share |wᵢ vᵢ| of the sum (Pérez-Arriaga et al. 1982); those above 1 %.
    pub states: Vec<(usize, f64)>,
}

/// Poles, largest modulus first.
///
/// # Errors
/// [`Error::Value`] where eigenvalues are not found.
pub fn poles(system: &StateSpace) -> Result<Vec<Complex<f64>>> {
    eigenvalues(system.a())
}

/// All modes, the slowest to decay first; of a conjugate pair the one above the real axis.
///
/// # Errors
/// [`Error::Value`] where eigenvectors are not found.
pub fn modes(system: &StateSpace) -> Result<Vec<Mode>> {
    if system.n_state() == 0 {
        return Ok(Vec::new());
    }
    let (values, right, left) = eigenvectors(system.a())?;
    let mut all: Vec<Mode> = Vec::new();
    for (j, pole) in values.iter().enumerate().filter(|(_, pole)| pole.im >= 0.0) {
        let rate = system.dt().map_or(*pole, |dt| pole.ln() / dt);
        let share = |i: usize| (left[(i, j)].conj() * right[(i, j)]).norm();
        let whole: f64 = (0..system.n_state()).map(share).sum();
        let mut states: Vec<(usize, f64)> = (0..system.n_state()).map(|i| (i, share(i) / whole)).collect();
        states.retain(|(_, share)| *share > 0.01);
        states.sort_by(|a, b| b.1.total_cmp(&a.1));
        let frequency = rate.norm();
        let damping = if frequency > 0.0 { -rate.re / frequency } else { 1.0 };
        all.push(Mode { pole: *pole, rate, frequency, damping, time_constant: -1.0 / rate.re, states });
    }
    all.sort_by(|a, b| b.rate.re.total_cmp(&a.rate.re));
    Ok(all)
}

/// B D⁻¹ C beyond so many times A says that D is too small to be inverted: zeros would drown in it.
const NOT_SMALL: f64 = 1e3;

/// Transmission zeros: where [A − zI, B; C, D] loses rank. For as many inputs as outputs.
///
/// # Errors
/// [`Error::Value`] for other shapes, or where they are not found.
pub fn zeros(system: &StateSpace) -> Result<Vec<Complex<f64>>> {
    let (n, m, p) = (system.n_state(), system.n_input(), system.n_output());
    if m != p {
        let remedy = "Select as many inputs as outputs.";
        return Err(Error::value("outputs", p, format!("{m}, the inputs"), remedy));
    }
    if n == 0 {
        return Ok(Vec::new());
    }
    // where D has an inverse they are the poles of the inverse system, found a hundred times faster than those of a pencil
    let through = system.d().clone().try_inverse().map(|back| system.b() * back * system.c());
    let mut zeros = match through.filter(|through| through.norm() < NOT_SMALL * system.a().norm()) {
        Some(through) => eigenvalues(&(system.a() - through))?,
        None => {
            let pencil = blocks(system.a(), system.b(), system.c(), system.d());
            let mass = DMatrix::from_fn(n + m, n + m, |i, j| f64::from(u8::from(i == j && i < n)));
            pencil_eigenvalues(&pencil, &mass)?
        }
    };
    zeros.sort_by(|a, b| b.norm().total_cmp(&a.norm()));
    Ok(zeros)
}

/// Poles of the loop around one input and one output, 1 + k L = 0, for each gain k: one row per gain, branches in one column
/// as far as they can be told apart.
///
/// # Errors
/// [`Error::Value`] for more than one input or output; as [`StateSpace::feedback`].
pub fn root_locus(system: &StateSpace, gains: &[f64]) -> Result<Vec<Vec<Complex<f64>>>> {
    super::state_space::one_loop(system)?;
    let mut rows: Vec<Vec<Complex<f64>>> = Vec::with_capacity(gains.len());
    for gain in gains {
        let back = StateSpace::gain(DMatrix::from_element(1, 1, *gain), system.dt())?;
        let mut found = poles(&system.feedback(&back)?)?;
        if let Some(before) = rows.last() {
            found = before.iter().map(|old| nearest(&mut found, *old)).collect();
        }
        rows.push(found);
    }
    Ok(rows)
}

/// Takes out of `all` what is nearest to `place`.
fn nearest(all: &mut Vec<Complex<f64>>, place: Complex<f64>) -> Complex<f64> {
    let distance = |v: &Complex<f64>| (*v - place).norm();
    let at = (0..all.len()).min_by(|a, b| distance(&all[*a]).total_cmp(&distance(&all[*b])));
    at.map_or(place, |at| all.swap_remove(at))
}
