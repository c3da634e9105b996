//! Sizes of systems: the largest gain over frequency, and the energy of the impulse response.

use super::dense::{eigenvalues, singular_values};
use super::state_space::{StateSpace, blocks};
use super::swept::Swept;
use crate::design::riccati;
use base::error::{Error, Result};
use nalgebra::DMatrix;

/// The largest gain and where it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeakGain {
    /// σ_max of G there; infinite for a system that is not stable.
    pub gain: f64,
    /// ω, rad/s; NaN for a system that is not stable; of a direct path that nothing exceeds, Nyquist (infinite without samples).
    pub omega: f64,
}

/// Relative distance between the bounds at which the search ends.
const TOLERANCE: f64 = 1e-10;

/// ‖G‖∞, the largest singular value over all frequencies.
///
/// Frequencies where a singular value equals γ are imaginary eigenvalues of a Hamiltonian matrix; between two of them the gain
/// is larger, and γ rises to it until there are none. Sampled systems by Tustin's substitution, which keeps gains.
///
/// Source: Bruinsma and Steinbuch 1990.
///
/// # Errors
/// [`Error::Value`] where eigenvalues are not found.
pub fn h_infinity(system: &StateSpace) -> Result<PeakGain> {
    if !system.is_stable()? {
        return Ok(PeakGain { gain: f64::INFINITY, omega: f64::NAN });
    }
    let bent = system.continuous()?;
    let swept = Swept::of(&bent);
    let gain = |omega: f64| singular_values(&swept.at(bent.on_axis(omega))).first().copied().unwrap_or(0.0);
    let direct = singular_values(&bent.d().map(|v| v.into())).first().copied().unwrap_or(0.0);
    let mut best = PeakGain { gain: direct, omega: f64::INFINITY };
    let rise = |best: &mut PeakGain, omega: f64| {
        let gain = gain(omega);
        if gain > best.gain {
            *best = PeakGain { gain, omega };
        }
    };
    rise(&mut best, 0.0);
    for pole in eigenvalues(bent.a())? {
        rise(&mut best, pole.norm());
        rise(&mut best, pole.im.abs());
    }
    for _ in 0..60 {
        let level = best.gain * (1.0 + 2.0 * TOLERANCE) + f64::MIN_POSITIVE;
        let crossed = crossings(&bent, level)?;
        let before = best;
        for pair in crossed.windows(2) {
            rise(&mut best, f64::midpoint(pair[0], pair[1]));
        }
        if best.gain <= before.gain * (1.0 + TOLERANCE) {
            break;
        }
    }
    if best.omega.is_finite() && best.omega > 0.0 {
        let omega = top(&gain, (best.omega * 0.999, best.omega * 1.001), 60);
        rise(&mut best, omega);
    }
    Ok(PeakGain { omega: if best.omega.is_finite() { system.unbent(best.omega) } else { system.nyquist() }, ..best })
}

/// Frequencies at which a singular value of a continuous system may be γ, ascending: eigenvalues about the imaginary axis.
fn crossings(system: &StateSpace, level: f64) -> Result<Vec<f64>> {
    let (a, b, c, d) = (system.a(), system.b(), system.c(), system.d());
    let m = system.n_input();
    let r = DMatrix::identity(m, m) * (level * level) - d.tr_mul(d);
    let Some(r) = r.cholesky() else { return Ok(Vec::new()) };
    let (r_dt_c, r_bt) = (r.solve(&d.tr_mul(c)), r.solve(&b.transpose()));
    let top = a + b * &r_dt_c;
    let hamiltonian =
        blocks(&top, &(b * r_bt * level), &(-(c.tr_mul(c) + c.tr_mul(&(d * r_dt_c))) / level), &-top.transpose());
    let mut omega: Vec<f64> = eigenvalues(&hamiltonian)?
        .iter()
        .filter(|l| l.im >= 0.0 && l.re.abs() <= 1e-6 * l.norm().max(1e-12))
        .map(|l| l.im)
        .collect();
    omega.sort_by(f64::total_cmp);
    Ok(omega)
}

/// Where `value` is largest between two places, by `n` golden sections; on one hill.
pub(super) fn top(value: &dyn Fn(f64) -> f64, (mut low, mut high): (f64, f64), n: usize) -> f64 {
    let ratio = (5.0_f64.sqrt() - 1.0) / 2.0;
    for _ in 0..n {
        let (x, y) = (high - ratio * (high - low), low + ratio * (high - low));
        if value(x) > value(y) { high = y } else { low = x }
    }
    f64::midpoint(low, high)
}

/// ‖G‖₂: the root of the energy of all outputs after unit impulses, √tr(Bᵀ X B) with Aᵀ X + X A + CᵀC = 0; for a sampled system the
/// root of the sum over samples, √tr(Bᵀ X B + DᵀD) with X = Aᵀ X A + CᵀC.
///
/// # Errors
/// [`Error::Value`] for a system that is not stable, or continuous with a direct path.
pub fn h2_norm(system: &StateSpace) -> Result<f64> {
    let cost = system.c().tr_mul(system.c());
    let gramian = if system.dt().is_some() {
        riccati::lyapunov(system.a(), &cost)?.matrix
    } else {
        if system.d().iter().any(|v| *v != 0.0) {
            let remedy = "Its energy is infinite: roll it off.";
            return Err(Error::value("D of a continuous system", system.d().norm(), "0", remedy));
        }
        riccati::continuous_lyapunov(system.a(), &cost)?.matrix
    };
    let direct = if system.dt().is_some() { system.d().norm_squared() } else { 0.0 };
    Ok(((system.b().tr_mul(&(gramian * system.b()))).trace() + direct).sqrt())
}
