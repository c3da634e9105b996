//! Digital filters of one signal: low-passes and notches, one multiply-add form for all, and settings of such filters in a row.
//!
//! Of H(s) over s = j ω/ω₀ by the bilinear transform, warped so that ω₀ = 2π f is met exactly:
//!
//! ```text
//! low-pass, first order   1/(s + 1)                  −3 dB and −45° at f
//! low-pass, second order  1/(s² + √2 s + 1)          −3 dB and −90° at f (Butterworth)
//! notch                   (s² + 1)/(s² + β s + 1)    nothing at f, −3 dB at two frequencies that are B apart
//! ```
//!
//! Each passes a constant signal as it is. Each is late by what its phase says: a signal slower than f by about 1/(2π f) or √2/(2π f) of
//! a low-pass, and by B/(2π f²) of a notch.
//!
//! Source: Oppenheim and Schafer, Discrete-Time Signal Processing, 3rd ed., section 7.2; Hirano, Nishimura and Mitra 1974 (notch).

use autodiff::Scalar;
use base::error::{Error, Result};
use nalgebra::Complex;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, SQRT_2};

/// Most filters in a row.
pub const MAX_FILTERS: usize = 8;
/// Least frequency and bandwidth, as a share of the rate: below it a filter forgets nothing within a flight.
const LEAST: f64 = 1e-4;

/// H(z) = (b₀ + b₁ z⁻¹ + b₂ z⁻²)/(1 + a₁ z⁻¹ + a₂ z⁻²) with H(1) = 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DigitalFilter {
    /// Of the input now, one and two samples ago.
    b: [f64; 3],
    /// Of the outputs one and two samples ago.
    a: [f64; 2],
}

impl DigitalFilter {
    /// A low-pass of first order, cut off at `frequency` (Hz, below half the rate), sampled every `period` seconds.
    pub fn first_order_low_pass(frequency: f64, period: f64) -> Self {
        let k = (PI * frequency * period).tan();
        let scale = 1.0 / (1.0 + k);
        Self { b: [k * scale, k * scale, 0.0], a: [(k - 1.0) * scale, 0.0] }
    }

    /// A Butterworth low-pass of second order, cut off at `frequency` (Hz, below half the rate), sampled every `period` seconds.
    pub fn low_pass(frequency: f64, period: f64) -> Self {
        let k = (PI * (frequency * period)).tan();
        let scale = 1.0 / (1.0 + SQRT_2 * k + k * k);
        let b = k * k * scale;
        Self { b: [b, 2.0 * b, b], a: [2.0 * (k * k - 1.0) * scale, (1.0 - SQRT_2 * k + k * k) * scale] }
    }

    /// A notch at `frequency` that takes away 3 dB and more over `bandwidth` (both Hz, below half the rate), sampled every `period` seconds.
    pub fn notch(frequency: f64, bandwidth: f64, period: f64) -> Self {
        let scale = 1.0 / (1.0 + (PI * bandwidth * period).tan());
        let turn = -2.0 * scale * (2.0 * PI * frequency * period).cos();
        Self { b: [scale, turn, scale], a: [turn, 2.0 * scale - 1.0] }
    }

    /// The memory that rests at `x`.
    #[inline]
    pub fn rest<S: Scalar>(&self, x: S) -> [S; 2] {
        [S::constant(1.0 - self.b[0]) * x, S::constant(self.b[2] - self.a[1]) * x]
    }

    /// The next output (transposed direct form II).
    #[inline]
    pub fn next<S: Scalar>(&self, memory: &mut [S; 2], x: S) -> S {
        let y = S::constant(self.b[0]) * x + memory[0];
        memory[0] = S::constant(self.b[1]) * x - S::constant(self.a[0]) * y + memory[1];
        memory[1] = S::constant(self.b[2]) * x - S::constant(self.a[1]) * y;
        y
    }

    /// H(e^(jωT)) at ω, rad/s, of samples every T = `period` seconds.
    pub fn response(&self, omega: f64, period: f64) -> Complex<f64> {
        let back = Complex::from_polar(1.0, -omega * period);
        let [b0, b1, b2] = self.b;
        let [a1, a2] = self.a;
        (b0 + (b1 + b2 * back) * back) / (1.0 + (a1 + a2 * back) * back)
    }
}

/// One filter, as on a command line and in a file.
///
/// ```
/// # use omnidrones_controllers::omnidrones;
/// use omnidrones::controllers::FilterSettings;
///
/// let row = FilterSettings::parse_list("low_pass:80,notch:150:30")?;
/// assert_eq!(row[1], FilterSettings::Notch { frequency: 150.0, bandwidth: 30.0 });
/// // at 500 Hz a signal of 10 Hz is 10.4° late behind both
/// let late: f64 = row.iter().map(|filter| -filter.at(0.002).response(62.83, 0.002).arg()).sum();
/// assert!((late.to_degrees() - 10.4).abs() < 0.05);
/// // nothing is known of what is faster than half the rate
/// assert!(row[1].validate("filter 2", 250.0).is_err());
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum FilterSettings {
    /// Passes what is slower.
    LowPass {
        /// Where half the power is left, Hz; below half the rate.
        frequency: f64,
        /// 1 or 2. Default 2: Butterworth.
        #[serde(default = "second")]
        order: u32,
    },
    /// Takes out one frequency, as of rotors that turn or of a frame that bends.
    Notch {
        /// What is taken out, Hz; below half the rate.
        frequency: f64,
        /// Between the two frequencies at which half the power is left, Hz; below half the rate. Quality is frequency over bandwidth.
        bandwidth: f64,
    },
}

fn second() -> u32 {
    2
}

impl FilterSettings {
    /// Filters in short: `low_pass:80,notch:150:30`, each a kind and numbers in Hz; `low_pass:80:1` is of first order.
    ///
    /// # Errors
    /// [`Error::Unknown`] for another kind, [`Error::Value`] for numbers that are none, too few or too many.
    pub fn parse_list(text: &str) -> Result<Vec<Self>> {
        text.split(',').map(|item| Self::parse(item.trim())).collect()
    }

    fn parse(item: &str) -> Result<Self> {
        let mut parts = item.split(':').map(str::trim);
        let kind = parts.next().unwrap_or_default();
        let form = match kind {
            "low_pass" => "low_pass:FREQUENCY or low_pass:FREQUENCY:ORDER",
            "notch" => "notch:FREQUENCY:BANDWIDTH",
            name => {
                let known = ["low_pass", "notch"].map(String::from).to_vec();
                return Err(Error::Unknown { kind: "kind of filter", name: name.into(), known });
            }
        };
        let wrong = || {
            Error::value("filter", format!("'{item}'"), form, "Give frequencies in Hz, as low_pass:80,notch:150:30.")
        };
        let numbers: Vec<f64> = parts.map(|part| part.parse().map_err(|_| wrong())).collect::<Result<_>>()?;
        match (kind, &numbers[..]) {
            ("low_pass", [frequency]) => Ok(Self::LowPass { frequency: *frequency, order: second() }),
            ("low_pass", [frequency, order]) if *order == 1.0 || *order == 2.0 => {
                Ok(Self::LowPass { frequency: *frequency, order: *order as u32 })
            }
            ("notch", [frequency, bandwidth]) => Ok(Self::Notch { frequency: *frequency, bandwidth: *bandwidth }),
            _ => Err(wrong()),
        }
    }

    /// Checks it for samples of `rate` Hz; `what` names it in errors.
    ///
    /// # Errors
    /// [`Error::Value`] for a frequency or a bandwidth that is not between a ten-thousandth and half of the rate, and for an order other
    /// than 1 and 2.
    pub fn validate(&self, what: &str, rate: f64) -> Result<()> {
        let (kind, numbers) = match *self {
            Self::LowPass { order, .. } if !(1..=2).contains(&order) => {
                let remedy = "Put several in a row for a steeper one.";
                return Err(Error::value(format!("{what} (low_pass): order"), order, "1 or 2", remedy));
            }
            Self::LowPass { frequency, .. } => ("low_pass", vec![("frequency", frequency)]),
            Self::Notch { frequency, bandwidth } => ("notch", vec![("frequency", frequency), ("bandwidth", bandwidth)]),
        };
        for (name, value) in numbers {
            if !(value >= LEAST * rate && value < 0.5 * rate) {
                let what = format!("{what} ({kind}): {name}");
                let limit =
                    format!("from {} Hz to below {} Hz, half the rate of its samples", LEAST * rate, 0.5 * rate);
                let remedy = format!("Give one within, or let the rate level compute at another rate than {rate} Hz.");
                return Err(Error::value(what, format!("{value} Hz"), limit, remedy));
            }
        }
        Ok(())
    }

    /// Checks a row of them for samples of `rate` Hz.
    ///
    /// # Errors
    /// [`Error::Limit`] for more than [`MAX_FILTERS`]; as [`validate`](Self::validate).
    pub fn validate_all(all: &[Self], rate: f64) -> Result<()> {
        if all.len() > MAX_FILTERS {
            let limit = format!("0 to {MAX_FILTERS}");
            return Err(Error::limit("filters: number", all.len(), limit, "Every one of them is late: take fewer."));
        }
        all.iter().enumerate().try_for_each(|(k, filter)| filter.validate(&format!("filter {}", k + 1), rate))
    }

    /// The filter, of samples every `period` seconds.
    pub fn at(&self, period: f64) -> DigitalFilter {
        match *self {
            Self::LowPass { frequency, order: 1 } => DigitalFilter::first_order_low_pass(frequency, period),
            Self::LowPass { frequency, .. } => DigitalFilter::low_pass(frequency, period),
            Self::Notch { frequency, bandwidth } => DigitalFilter::notch(frequency, bandwidth, period),
        }
    }

    /// By how much a row of them makes slow signals late, s, of samples every `period` seconds.
    pub fn delay_of(all: &[Self], period: f64) -> f64 {
        // so slow that the slope of the phase is that at rest
        let omega = 1e-3 * LEAST / period;
        all.iter().map(|filter| -filter.at(period).response(omega, period).arg() / omega).sum()
    }
}

impl std::fmt::Display for FilterSettings {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::LowPass { frequency, order: 1 } => write!(f, "low-pass of first order at {frequency} Hz"),
            Self::LowPass { frequency, .. } => write!(f, "low-pass at {frequency} Hz"),
            Self::Notch { frequency, bandwidth } => write!(f, "notch at {frequency} Hz, {bandwidth} Hz wide"),
        }
    }
}

/// A file of filters: `[[filter]]` tables, first to last.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilterFile {
    /// In the order in which a signal passes them.
    pub filter: Vec<FilterSettings>,
}

/// Filters in a row for each axis of a vector, which is held between two samples.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct FilterRow {
    settings: Vec<FilterSettings>,
    filters: Vec<DigitalFilter>,
}

impl FilterRow {
    /// Of samples every `period` seconds.
    ///
    /// # Errors
    /// As [`FilterSettings::validate_all`].
    pub fn new(all: &[FilterSettings], period: f64) -> Result<Self> {
        // as users say it: 500 Hz, not 499.99999999999994
        let rate = (1e6 / period).round() / 1e6;
        FilterSettings::validate_all(all, rate)?;
        Ok(Self { settings: all.to_vec(), filters: all.iter().map(|filter| filter.at(period)).collect() })
    }

    pub fn settings(&self) -> &[FilterSettings] {
        &self.settings
    }

    pub fn is_empty(&self) -> bool {
        self.filters.is_empty()
    }

    /// Numbers of its memory: whether it has begun, what it said last, two per filter and axis.
    pub fn n_memory(&self) -> usize {
        if self.filters.is_empty() { 0 } else { 4 + 6 * self.filters.len() }
    }

    /// Takes a sample in where `tick` > ½; the first is taken as what has always been.
    #[inline]
    pub fn filtered<S: Scalar>(&self, tick: S, memory: &mut [S], x: [S; 3]) -> [S; 3] {
        let due = S::constant(0.5).lt(tick);
        let first = memory[0].lt(S::constant(0.5));
        let (said, held) = memory[1..].split_at_mut(3);
        let mut y = x;
        for (filter, held) in self.filters.iter().zip(held.chunks_exact_mut(6)) {
            for (axis, held) in held.chunks_exact_mut(2).enumerate() {
                let rest = filter.rest(y[axis]);
                let mut own = [S::select(first, rest[0], held[0]), S::select(first, rest[1], held[1])];
                y[axis] = filter.next(&mut own, y[axis]);
                for k in 0..2 {
                    held[k] = S::select(due, own[k], held[k]);
                }
            }
        }
        for axis in 0..3 {
            y[axis] = S::select(due, y[axis], said[axis]);
            said[axis] = y[axis];
        }
        memory[0] = S::select(due, S::one(), memory[0]);
        y
    }
}

#[cfg(test)]
mod tests;
