//! White noise for the many numbers of one image or scan.
//!
//! A ChaCha normal takes longer than a pixel. Here a sample draws **one** key from the sensor's stream, and the noise of number
//! i is a hash of key and i, so that it depends on neither order nor number of pixels.

/// Noise of one sample.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SampleNoise {
    key: u64,
}

/// What lies between the states of two indices: 2⁶⁴ over the golden ratio, odd.
const STRIDE: u64 = 0x9e37_79b9_7f4a_7c15;
/// Standard deviation of the sum of four whole numbers that are uniform in 0 … 2¹⁶ − 1: √((2³² − 1)/3).
const SPREAD: f64 = 37_837.227_227_983_36;
/// Its mean.
const MEAN: f64 = 131_070.0;

impl SampleNoise {
    pub(crate) fn new(key: u64) -> Self {
        Self { key }
    }

    /// 64 bits of number `i`: SplitMix64 (Steele, Lea and Flood 2014) at the i-th state from the key.
    fn bits(self, i: usize) -> u64 {
        let z = self.key.wrapping_add(STRIDE.wrapping_mul((i as u64).wrapping_add(1)));
        let z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// Mean 0, variance 1, nearly normal: the sum of four uniform numbers. Kurtosis 2.7, |n| ≤ 3.47.
    pub(crate) fn normal(self, i: usize) -> f64 {
        let bits = self.bits(i);
        let sum = (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
        (sum as f64 - MEAN) / SPREAD
    }

    /// Uniform in [0, 1).
    pub(crate) fn unit(self, i: usize) -> f64 {
        (self.bits(i) >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
    }

    /// Other noise for the same numbers.
    pub(crate) fn other(self) -> Self {
        Self { key: self.bits(usize::MAX) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grain_has_mean_0_variance_1_and_no_memory() {
        let (n, grain) = (1_000_000, SampleNoise::new(7));
        let moment = |f: &dyn Fn(usize) -> f64| (0..n).map(f).sum::<f64>() / n as f64;
        let (mean, square) = (moment(&|i| grain.normal(i)), moment(&|i| grain.normal(i).powi(2)));
        let fourth = moment(&|i| grain.normal(i).powi(4));
        let next = moment(&|i| grain.normal(i) * grain.normal(i + 1));
        let beside = moment(&|i| grain.normal(i) * SampleNoise::new(8).normal(i));
        let other = moment(&|i| grain.normal(i) * grain.other().normal(i));
        // four standard errors of a mean of a million: 4e-3; of squares 5.2e-3
        for x in [mean, next, beside, other] {
            assert!(x.abs() < 4e-3, "{x}");
        }
        assert!((square - 1.0).abs() < 5.2e-3 && (fourth - 2.7).abs() < 0.02, "{square} {fourth}");
        assert!((moment(&|i| grain.unit(i)) - 0.5).abs() < 1.2e-3);
    }
}
