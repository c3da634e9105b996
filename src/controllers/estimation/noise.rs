//! What a filter believes of the errors of a sensor: white noise by its variance, biases as processes.

use dynamics::sensors::{ErrorModel, PerAxis};

/// A bias of a sensor, as a process in steps of the filter: b⁺ = φ b + w, w ~ N(0, q).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BiasProcess {
    /// φ.
    pub decay: f64,
    /// q, u².
    pub drive: f64,
    /// Variance that a flight begins with, u².
    pub start: f64,
}

/// Numbers of axis `axis`; of sensors without axes that of all.
fn of(figure: PerAxis, axis: usize) -> f64 {
    match figure {
        PerAxis::Same(x) => x,
        PerAxis::Each(x) => x[axis.min(2)],
    }
}

impl BiasProcess {
    /// That of an axis of an error model, in steps of `dt` seconds.
    pub fn of(model: &ErrorModel, axis: usize, dt: f64) -> Self {
        // a constant offset is a bias that stays
        let (walk, start) = (of(model.bias_walk, axis), of(model.bias_start, axis).hypot(of(model.offset, axis)));
        let (decay, time) = match model.bias_time.filter(|time| time.is_finite()) {
            // τ/2 (1 − φ²) without the difference of nearly equal numbers
            Some(time) => ((-dt / time).exp(), -0.5 * time * (-2.0 * dt / time).exp_m1()),
            None => (1.0, dt),
        };
        Self { decay, drive: walk * walk * time, start: start * start }
    }

    /// Largest variance that it has in a flight, as far as it has a bound: that at the beginning, or that it comes to.
    pub fn spread(&self) -> f64 {
        let comes_to = if self.decay < 1.0 { self.drive / (1.0 - self.decay * self.decay) } else { 0.0 };
        self.start.max(comes_to)
    }

    /// Whether there is one at all.
    pub fn is_there(&self) -> bool {
        self.drive > 0.0 || self.start > 0.0
    }
}

/// Variance of the white noise of a sample, u², `between` seconds apart: of noise, rounding, and of what the scale errors and the
/// misalignment of an episode make of numbers of the size `size`.
pub fn white_variance(model: &ErrorModel, axis: usize, between: f64, size: f64) -> f64 {
    let (density, deviation) = (of(model.density, axis), of(model.deviation, axis));
    let rounding = model.resolution.powi(2) / 12.0;
    let mixed = (model.scale * size).powi(2) + 2.0 * (model.misalignment * size).powi(2);
    density * density / between + deviation * deviation + rounding + mixed
}
