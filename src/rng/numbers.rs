//! Bits to numbers: one definition for all who draw, whatever computes the bits.

/// Uniform in [0, 1): the upper 53 bits.
#[inline(always)]
#[doc(hidden)]
pub fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
}

/// Uniform in 0..`n` for n ≥ 1 (0 for n = 0), by the high half of a 128-bit product; bias below n/2⁶⁴.
#[inline(always)]
#[doc(hidden)]
pub fn below(bits: u64, n: u64) -> u64 {
    ((u128::from(bits) * u128::from(n)) >> 64) as u64
}

/// A number in [0, 1) in `f32`, rounded once and never to 1: the largest below it instead.
#[inline(always)]
#[doc(hidden)]
pub fn to_f32_below_one(x: f64) -> f32 {
    (x as f32).min(1.0 - 0.5 * f32::EPSILON)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_draw_in_single_precision_stays_below_one() {
        let most = f32::from_bits(1.0_f32.to_bits() - 1);
        assert_eq!([0, 1 << 63, u64::MAX].map(|bits| to_f32_below_one(unit(bits))), [0.0, 0.5, most]);
        // halfway between the two and just below
        assert_eq!(to_f32_below_one(1.0 - f64::from(f32::EPSILON) / 4.0), most);
        assert_eq!(to_f32_below_one(f64::from(most) - 1e-9), most);
    }
}
