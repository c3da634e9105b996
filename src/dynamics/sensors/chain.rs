//! What stands between the truth and a reading: scale and misalignment, bias, noise, limits, quantisation; rate, latency,
//! dropouts.
//!
//! ```text
//! y = round(clip(M x + o + b + n))        M = I + diag(s) + off-diagonal(m), drawn per episode
//! n = √(σ²/Δt + d²) N                      σ: density, d: deviation, Δt: time between two samples
//! b⁺ = φ b + σ_b √(τ/2 (1 − φ²)) N         φ = exp(−Δt/τ); without τ the random walk b + σ_b √Δt N
//! b₀ ~ N(0, σ₀²)
//! ```
//!
//! N are independent standard normals per axis. These are the IMU model of Kalibr (Furgale, Rehder and Siegwart 2013) with the
//! bias of a first-order Gauss–Markov process in its exact discrete form, so that no figure depends on the rate. The Allan
//! deviation over T is σ/√T for white noise and σ_b √(T/3) for the walk, T ≪ τ (IEEE Std 952-1997, annex C).

use super::limits::{positive, within};
use base::error::{Error, Result};
use rng::Stream;
use serde::{Deserialize, Serialize};

/// Largest scale error and misalignment, standard deviations: beyond, a part is broken, not imprecise.
const MAX_MIXING: f64 = 0.5;
/// Largest size of any other figure, SI.
const MAX_FIGURE: f64 = 1e9;
/// Numbers that a latency may hold back.
const MAX_HELD: usize = 1 << 20;

/// A number for all axes or one for each.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a number, or three in brackets, one per axis")]
pub enum PerAxis {
    /// The same for all.
    Same(f64),
    /// Of x, y, z.
    Each([f64; 3]),
}

impl PerAxis {
    /// Per axis; of sensors with fewer than three, the first.
    pub(crate) fn axes<const N: usize>(self) -> [f64; N] {
        match self {
            Self::Same(x) => [x; N],
            Self::Each(x) => std::array::from_fn(|i| x[i.min(2)]),
        }
    }
}

impl Default for PerAxis {
    fn default() -> Self {
        Self::Same(0.0)
    }
}

/// How a quantity is measured wrongly. Units are those of the quantity, here u; the default is without error.
///
/// ```text
/// y = round(clip(M x + o + b + n))        M = I + diag(s) + off-diagonal(m), drawn per episode
/// n = √(σ²/Δt + d²) N                      Δt: time between two samples
/// b⁺ = φ b + σ_b √(τ/2 (1 − φ²)) N         φ = exp(−Δt/τ); without τ the random walk b + σ_b √Δt N
/// b₀ ~ N(0, σ₀²)
/// ```
///
/// N are independent standard normals per axis: the IMU model of Kalibr (Furgale, Rehder and Siegwart 2013), with the bias of a
/// first-order Gauss–Markov process in its exact discrete form, so that no figure depends on the rate.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ErrorModel {
    /// σ, white noise by its density, u/√Hz.
    pub density: PerAxis,
    /// d, white noise by its standard deviation in a sample, whatever the rate, u.
    pub deviation: PerAxis,
    /// o, the same in every episode, u: of a magnetometer its hard iron.
    pub offset: PerAxis,
    /// σ₀, standard deviation of the bias that an episode begins with, u.
    pub bias_start: PerAxis,
    /// σ_b, what drives the bias, u/(s √Hz).
    pub bias_walk: PerAxis,
    /// τ, correlation time of the bias, s; without it the bias is a random walk.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bias_time: Option<f64>,
    /// s, standard deviation of the scale error of an episode, per axis, as a share.
    pub scale: f64,
    /// m, standard deviation of the misalignment of an episode, of each axis towards each other one, rad.
    pub misalignment: f64,
    /// Lowest and highest reading, u.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limits: Option<[f64; 2]>,
    /// Readings are multiples of this, the least significant bit, u; 0 for any.
    pub resolution: f64,
}

impl ErrorModel {
    /// Refuses figures that are no noise: `what` names the quantity, which has `axes` axes.
    pub(crate) fn validate(&self, what: &str, axes: usize) -> Result<()> {
        let at = |name: &str| format!("{what}.{name}");
        let figures = [
            ("density", self.density, 0.0),
            ("deviation", self.deviation, 0.0),
            ("offset", self.offset, -MAX_FIGURE),
            ("bias_start", self.bias_start, 0.0),
            ("bias_walk", self.bias_walk, 0.0),
        ];
        for (name, figure, least) in figures {
            if axes != 3 && matches!(figure, PerAxis::Each(_)) {
                let remedy = "Give the one that holds for all.";
                return Err(Error::value(at(name), "three numbers", "one: it has no axes x, y, z", remedy));
            }
            for x in figure.axes::<3>() {
                within(&at(name), x, least, MAX_FIGURE)?;
            }
        }
        within(&at("scale"), self.scale, 0.0, MAX_MIXING)?;
        within(&at("misalignment"), self.misalignment, 0.0, MAX_MIXING)?;
        if let Some(time) = self.bias_time {
            positive(&at("bias_time"), time, "Leave it out for a random walk.")?;
        }
        let [low, high] = self.limits.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
        if low < high {
            return within(&at("resolution"), self.resolution, 0.0, MAX_FIGURE.min(high - low));
        }
        let remedy = "Leave limits out for none.";
        Err(Error::value(at("limits"), format!("[{low}, {high}]"), "[low, high] with low < high", remedy))
    }
}

/// An [`ErrorModel`] at work on N numbers, sampled every Δt.
#[derive(Debug, Clone)]
pub(crate) struct Errors<const N: usize> {
    model: ErrorModel,
    /// Standard deviation of the white noise of a sample.
    white: [f64; N],
    /// φ.
    decay: f64,
    /// Standard deviation of what comes to the bias between two samples.
    drive: [f64; N],
    /// M.
    mixing: [[f64; N]; N],
    bias: [f64; N],
    /// Of the last sample: which numbers were within the limits.
    free: [bool; N],
}

impl<const N: usize> Errors<N> {
    pub(crate) fn new(model: &ErrorModel, between: f64) -> Self {
        let (density, deviation) = (model.density.axes::<N>(), model.deviation.axes::<N>());
        let walk = model.bias_walk.axes::<N>();
        let (decay, spread) = match model.bias_time {
            // τ/2 (1 − φ²) without the difference of nearly equal numbers
            Some(time) if time.is_finite() => {
                ((-between / time).exp(), (-0.5 * time * (-2.0 * between / time).exp_m1()).sqrt())
            }
            _ => (1.0, between.sqrt()),
        };
        Self {
            model: *model,
            white: std::array::from_fn(|i| (density[i] / between.sqrt()).hypot(deviation[i])),
            decay,
            drive: walk.map(|w| w * spread),
            mixing: std::array::from_fn(|i| std::array::from_fn(|k| if i == k { 1.0 } else { 0.0 })),
            bias: [0.0; N],
            free: [true; N],
        }
    }

    /// How the last sample changes with what was measured: M, without the rows that were clipped. Rounding is taken for the
    /// identity.
    pub(crate) fn slope(&self) -> [[f64; N]; N] {
        std::array::from_fn(|i| if self.free[i] { self.mixing[i] } else { [0.0; N] })
    }

    /// What an episode begins with: M and b₀, N² + N normals.
    pub(crate) fn draw(&mut self, stream: &mut Stream) {
        let start = self.model.bias_start.axes::<N>();
        for i in 0..N {
            for k in 0..N {
                let (nominal, spread) = if i == k { (1.0, self.model.scale) } else { (0.0, self.model.misalignment) };
                self.mixing[i][k] = nominal + spread * stream.normal();
            }
            self.bias[i] = start[i] * stream.normal();
        }
    }

    /// One sample of `x`.
    pub(crate) fn apply(&mut self, x: [f64; N], stream: &mut Stream) -> [f64; N] {
        self.apply_with(x, 1.0, stream)
    }

    /// One sample of `x` with `share` of the white noise. Always 2 N normals, so that a setting changed to 0 moves no other draw.
    pub(crate) fn apply_with(&mut self, x: [f64; N], share: f64, stream: &mut Stream) -> [f64; N] {
        let offset = self.model.offset.axes::<N>();
        let mut y = [0.0; N];
        for i in 0..N {
            let mixed: f64 = (0..N).map(|k| self.mixing[i][k] * x[k]).sum();
            let noise = share * self.white[i] * stream.normal();
            let measured = mixed + offset[i] + self.bias[i] + noise;
            self.free[i] = self.model.limits.is_none_or(|[low, high]| (low..=high).contains(&measured));
            y[i] = self.converted(measured);
            self.bias[i] = self.decay * self.bias[i] + self.drive[i] * stream.normal();
        }
        y
    }

    /// Clipped, then rounded to the least significant bit.
    fn converted(&self, y: f64) -> f64 {
        let y = match self.model.limits {
            Some([low, high]) => y.clamp(low, high),
            None => y,
        };
        let bit = self.model.resolution;
        if bit > 0.0 { (y / bit).round() * bit } else { y }
    }

    /// Visits what changes from sample to sample.
    pub(crate) fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.bias.iter_mut().for_each(visit);
    }
}

/// Samples that are lost in runs: a chain of two states whose stationary share of lost samples is `share`, in runs of `length`
/// samples on average. An episode begins with a sample that is not lost.
#[derive(Debug, Clone)]
pub(crate) struct Dropout {
    /// Chance that a sample is lost after one that was not.
    begin: f64,
    /// Chance that one is not after one that was.
    end: f64,
    /// 1 where the last sample was lost; −1 before the first.
    lost: f64,
}

impl Dropout {
    /// Largest share.
    pub(crate) const MOST: f64 = 0.5;

    pub(crate) fn new(share: f64, length: f64) -> Self {
        let length = length.max(1.0);
        // in the mean as many runs begin as end
        Self { begin: share / ((1.0 - share) * length), end: 1.0 / length, lost: -1.0 }
    }

    pub(crate) fn draw(&mut self) {
        self.lost = -1.0;
    }

    /// Whether the next sample is lost; one draw, also for the first.
    pub(crate) fn next(&mut self, stream: &mut Stream) -> bool {
        let u = stream.unit();
        let lost = if self.lost > 0.0 { u >= self.end } else { self.lost == 0.0 && u < self.begin };
        self.lost = if lost { 1.0 } else { 0.0 };
        lost
    }

    pub(crate) fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit(&mut self.lost);
    }
}

/// Rate and latency: sample j is taken in step j·`every` and read from step j·`every` + `latency` on. Before the first arrives,
/// it is read all the same, so that no reading is older than its episode.
#[derive(Debug, Clone)]
pub(crate) struct DelayLine {
    every: u64,
    latency: u64,
    /// Numbers of a sample.
    width: usize,
    /// Samples taken last, sample j in slot j modulo their number.
    ring: Vec<f64>,
    /// Steps of the episode so far.
    step: u64,
}

impl DelayLine {
    /// # Errors
    /// [`Error::Limit`] where more numbers would be held back than a sensor may.
    pub(crate) fn new(what: &str, every: u64, latency: u64, width: usize) -> Result<Self> {
        // every sample that is taken and not yet read, and the one that is
        let slots = latency.div_ceil(every) + 1;
        let held = u128::from(slots) * width as u128;
        if held > MAX_HELD as u128 {
            let limit = format!("{} steps", (MAX_HELD / width - 1) as u64 * every);
            let remedy = "Give a shorter latency or a lower rate.";
            return Err(Error::limit(format!("{what}: latency"), format!("{latency} steps"), limit, remedy));
        }
        Ok(Self { every, latency, width, ring: vec![0.0; held as usize], step: 0 })
    }

    pub(crate) fn restart(&mut self) {
        self.step = 0;
        self.ring.fill(0.0);
    }

    /// Whether a sample is taken in this step.
    pub(crate) fn is_due(&self) -> bool {
        self.step.is_multiple_of(self.every)
    }

    /// Takes `sample` where one is due and goes on to the next step.
    pub(crate) fn advance(&mut self, sample: &[f64]) {
        if self.is_due() {
            let at = self.slot(self.step / self.every);
            self.ring[at..at + self.width].copy_from_slice(sample);
        }
        self.step += 1;
    }

    /// What is read in the step that was advanced last.
    pub(crate) fn reading(&self) -> &[f64] {
        let at = self.slot(self.read_sample());
        &self.ring[at..at + self.width]
    }

    /// Whether that sample was not read before.
    pub(crate) fn is_new(&self) -> bool {
        let last = self.step.saturating_sub(1);
        last == 0 || last > self.latency && (last - self.latency).is_multiple_of(self.every)
    }

    /// Number of the sample that is read.
    fn read_sample(&self) -> u64 {
        self.step.saturating_sub(1 + self.latency) / self.every
    }

    fn slot(&self, sample: u64) -> usize {
        let slots = (self.ring.len() / self.width) as u64;
        (sample % slots) as usize * self.width
    }

    pub(crate) fn every(&self) -> u64 {
        self.every
    }

    pub(crate) fn latency(&self) -> u64 {
        self.latency
    }

    pub(crate) fn steps(&self) -> u64 {
        self.step
    }

    pub(crate) fn set_steps(&mut self, steps: u64) {
        self.step = steps;
    }

    pub(crate) fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.ring.iter_mut().for_each(visit);
    }
}
