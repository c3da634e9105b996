//! Bits to numbers: one definition for all who draw, whatever computes the bits.

/// Uniform in [0, 1): the upper 53 bits.
#[inline(always)]
pub(crate) fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
}

/// Uniform in 0..`n` for n ≥ 1 (0 for n = 0), by the high half of a 128-bit product; bias below n/2⁶⁴.
#[inline(always)]
pub(crate) fn below(bits: u64, n: u64) -> u64 {
    ((u128::from(bits) * u128::from(n)) >> 64) as u64
}
