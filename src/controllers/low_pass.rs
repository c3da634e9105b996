//! A second-order Butterworth low-pass, for signals whose lags must agree.

use autodiff::Scalar;
use std::f64::consts::{PI, SQRT_2};

/// H(s) = 1/(s² + √2 s + 1) at ω = 2π f, by the bilinear transform warped so that the cut-off is met exactly.
///
/// Source: Oppenheim and Schafer, Discrete-Time Signal Processing, 3rd ed., section 7.2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LowPass {
    /// Of the input now and two samples ago; of one sample ago it is twice that.
    b: f64,
    /// Of the outputs before.
    a: [f64; 2],
}

impl LowPass {
    /// Cut off at `frequency` (Hz), sampled every `period` seconds; at a quarter of the sampling rate where that is less.
    pub(super) fn new(frequency: f64, period: f64) -> Self {
        let k = (PI * (frequency * period).min(0.25)).tan();
        let scale = 1.0 / (1.0 + SQRT_2 * k + k * k);
        Self { b: k * k * scale, a: [2.0 * (k * k - 1.0) * scale, (1.0 - SQRT_2 * k + k * k) * scale] }
    }

    /// The memory that rests at `x`.
    #[inline]
    pub(super) fn rest<S: Scalar>(&self, x: S) -> [S; 2] {
        [S::constant(1.0 - self.b) * x, S::constant(self.b - self.a[1]) * x]
    }

    /// The next output (transposed direct form II).
    #[inline]
    pub(super) fn next<S: Scalar>(&self, memory: &mut [S; 2], x: S) -> S {
        let fresh = S::constant(self.b) * x;
        let y = fresh + memory[0];
        memory[0] = fresh + fresh - S::constant(self.a[0]) * y + memory[1];
        memory[1] = fresh - S::constant(self.a[1]) * y;
        y
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_low_pass_halves_the_power_at_its_cut_off_and_rests_where_it_is_told() {
        let (filter, period) = (LowPass::new(12.0, 1.0 / 300.0), 1.0 / 300.0);
        let mut memory = filter.rest(2.5);
        let at_rest = filter.next(&mut memory, 2.5);
        println!("worst {:.1e}", (at_rest - 2.5_f64).abs());
        assert!((at_rest - 2.5).abs() < 1e-13);
        let (mut memory, mut power) = ([0.0; 2], 0.0);
        for step in 0..3000 {
            let y = filter.next(&mut memory, (2.0 * PI * 12.0 * f64::from(step) * period).sin());
            // sixty whole periods, long after the transient
            power += if step >= 1500 { 2.0 * y * y / 1500.0 } else { 0.0 };
        }
        println!("worst power {:.1e}", (power - 0.5).abs());
        // measured: 1.2e-14
        assert!((power - 0.5).abs() < 1e-10, "{power}");
    }
}
