//! Responses over frequency and over time.

use super::dense::{Complexes, singular_values};
use super::modes::{poles, zeros};
use super::sampling::Hold;
use super::state_space::StateSpace;
use super::swept::Swept;
use base::error::{Error, Result};
use nalgebra::{Complex, DMatrix, DVector};
use serde::Serialize;

/// G(jω) over a list of frequencies.
#[derive(Debug, Clone, PartialEq)]
pub struct FrequencyResponse {
    /// ω, rad/s, ascending.
    pub omega: Vec<f64>,
    /// G at each frequency, p outputs × m inputs.
    pub values: Vec<Complexes>,
}

impl FrequencyResponse {
    /// From one input to one output, by their numbers, over all frequencies.
    pub fn channel(&self, output: usize, input: usize) -> Vec<Complex<f64>> {
        self.values.iter().map(|g| g[(output, input)]).collect()
    }

    /// Singular values at each frequency, `[frequency][value]`, largest first: the gains along the directions that a plant with many
    /// inputs has.
    pub fn singular_values(&self) -> Vec<Vec<f64>> {
        self.values.iter().map(singular_values).collect()
    }
}

/// The response C (s I − A)⁻¹ B + D at these frequencies, rad/s: s = jω, of a sampled system z = exp(jω dt) in its place.
pub fn frequency_response(system: &StateSpace, omega: &[f64]) -> FrequencyResponse {
    let swept = Swept::of(system);
    let values = omega.iter().map(|w| swept.at(system.on_axis(*w))).collect();
    FrequencyResponse { omega: omega.to_vec(), values }
}

/// Phases of a channel, rad, without jumps of 2π; that of the first lies in (−π, π].
pub fn unwrapped(channel: &[Complex<f64>]) -> Vec<f64> {
    let mut phases: Vec<f64> = channel.iter().map(|v| v.arg()).collect();
    for k in 1..phases.len() {
        let turns = ((phases[k] - phases[k - 1]) / std::f64::consts::TAU).round();
        phases[k] -= turns * std::f64::consts::TAU;
    }
    phases
}

/// Frequencies (rad/s, ascending) that show everything of a system: `n` in equal ratios from a decade below its slowest pole or zero to a
/// decade above its fastest (to Nyquist for a sampled one), and more about the peak of each lightly damped pair.
///
/// # Errors
/// [`Error::Value`] where eigenvalues are not found.
pub fn frequencies(system: &StateSpace, n: usize) -> Result<Vec<f64>> {
    let mut corners = poles(system)?;
    if system.n_input() == system.n_output() {
        corners.extend(zeros(system)?);
    }
    let rates: Vec<Complex<f64>> = corners.iter().map(|v| system.dt().map_or(*v, |dt| v.ln() / dt)).collect();
    let seen = rates.iter().map(|r| r.norm()).filter(|w| *w > 1e-6 && *w < 1e8 && *w < system.nyquist());
    let (low, high) = seen.fold((f64::INFINITY, 0.0_f64), |(low, high), w| (low.min(w), high.max(w)));
    let (low, high) = if low <= high { (low / 10.0, high * 10.0) } else { (0.01, 100.0) };
    let high = high.min(system.nyquist());
    let low = low.min(high / 100.0);
    let mut omega: Vec<f64> = (0..n).map(|k| low * (high / low).powf(k as f64 / (n.max(2) - 1) as f64)).collect();
    for rate in rates.iter().filter(|r| r.im > 0.0 && r.re.abs() < 0.3 * r.im) {
        let width = rate.re.abs().max(1e-6 * rate.im);
        omega.extend((-20..=20).map(|k| rate.im + width * 0.25 * f64::from(k)).filter(|w| *w > low && *w < high));
    }
    omega.sort_by(f64::total_cmp);
    omega.dedup();
    Ok(omega)
}

/// Outputs over time, `[sample, output]`, under `inputs`, `[sample, input]`, from the state `x0`, `[n_state]`. A continuous
/// system is sampled with inputs held for `dt`.
///
/// # Errors
/// [`Error::Value`] where sizes do not fit, or `dt` is not the system's own.
pub fn simulate(system: &StateSpace, dt: f64, inputs: &DMatrix<f64>, x0: &[f64]) -> Result<DMatrix<f64>> {
    let sampled = match system.dt() {
        None => system.sampled(dt, Hold::Zero)?,
        Some(own) if own == dt => system.clone(),
        Some(own) => return Err(Error::value("dt", dt, format!("{own} s, the system's"), "Give the system's own.")),
    };
    if inputs.ncols() != system.n_input() || x0.len() != system.n_state() {
        let got = format!("{} inputs, {} states", inputs.ncols(), x0.len());
        let want = format!("{} and {}", system.n_input(), system.n_state());
        return Err(Error::value("columns and start", got, want, "Give one column per input and the whole state."));
    }
    let mut x = DVector::from_column_slice(x0);
    let mut y = DMatrix::zeros(inputs.nrows(), system.n_output());
    for k in 0..inputs.nrows() {
        let u = inputs.row(k).transpose();
        y.row_mut(k).copy_from(&(sampled.c() * &x + sampled.d() * &u).transpose());
        x = sampled.a() * x + sampled.b() * u;
    }
    Ok(y)
}

/// Times (s, `[n]`) and all outputs (`[n, output]`) after one input went from 0 to 1 at time 0, from rest, sampled every `dt`
/// seconds.
///
/// # Errors
/// As [`simulate`]; [`Error::Value`] for an input that the system does not have.
pub fn step_response(system: &StateSpace, input: usize, dt: f64, n: usize) -> Result<(Vec<f64>, DMatrix<f64>)> {
    if input >= system.n_input() {
        let remedy = "Inputs count from 0.";
        return Err(Error::value("input", input, format!("below {}", system.n_input()), remedy));
    }
    let inputs = DMatrix::from_fn(n, system.n_input(), |_, j| f64::from(u8::from(j == input)));
    let y = simulate(system, dt, &inputs, &vec![0.0; system.n_state()])?;
    Ok(((0..n).map(|k| k as f64 * dt).collect(), y))
}

/// What is read off a step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StepFigures {
    /// Where it ends: the last value.
    pub last: f64,
    /// From 10 to 90 % of the way, s; NaN where it does not get there.
    pub rise_time: f64,
    /// Until it stays within 2 % of the way, s; NaN where it does not.
    pub settling_time: f64,
    /// Beyond the end, as a share of the way; 0 where it does not.
    pub overshoot: f64,
    /// First the other way, as a share of the way; 0 where it does not.
    pub undershoot: f64,
    /// The value farthest from the start, and when, s.
    pub peak: (f64, f64),
}

/// Figures of a step from the value `from` to where `values` end, at `times` (s), ascending, one per value.
///
/// # Errors
/// [`Error::Value`] for no values, not as many times as values, or values that end where they started.
pub fn step_figures(times: &[f64], values: &[f64], from: f64) -> Result<StepFigures> {
    let (Some(last), true) = (values.last().copied(), times.len() == values.len()) else {
        let got = format!("{} of {} times", values.len(), times.len());
        return Err(Error::value("values of the step", got, "as many, and some", "Give one value per time."));
    };
    let way = last - from;
    if !(way.is_finite() && way != 0.0) {
        return Err(Error::value("way of the step", way, "finite, not 0", "Look at an output that moves."));
    }
    let share: Vec<f64> = values.iter().map(|v| (v - from) / way).collect();
    let first = |level: f64| share.iter().position(|s| *s >= level).map(|k| times[k]);
    let outside = share.iter().rposition(|s| (s - 1.0).abs() > 0.02);
    let settled = outside.map_or(Some(0), |k| (k + 1 < share.len()).then_some(k + 1));
    let most = share.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let least = share.iter().copied().fold(f64::INFINITY, f64::min);
    let at = (0..share.len()).max_by(|a, b| share[*a].abs().total_cmp(&share[*b].abs())).unwrap_or(0);
    Ok(StepFigures {
        last,
        rise_time: first(0.9).zip(first(0.1)).map_or(f64::NAN, |(high, low)| high - low),
        settling_time: settled.map_or(f64::NAN, |k| times[k] - times[0]),
        overshoot: (most - 1.0).max(0.0),
        undershoot: (-least).max(0.0),
        peak: (values[at], times[at]),
    })
}
