//! Two draws to a normal number by Box–Muller, in operations that every processor rounds alike.
//!
//! Logarithm and cosine are polynomials of ours: +, −, ×, ÷, √ and bits of numbers, no fused product, no library. So a draw is the same
//! bits on every system and device, and nothing branches, so that a loop over many draws is vector code. Coefficients are those of
//! fdlibm (Sun Microsystems 1993). Errors in the unit of the last bit, of 60 000 draws beside 200 bits: logarithm 0.8, cosine 1.6.

use super::unit;

/// Standard normal N(0, 1) of two draws of 64 bits: √(−2 ln(1 − u₁)) cos 2πu₂. |result| ≤ 8.6.
#[inline(always)]
#[doc(hidden)]
pub fn normal(a: u64, b: u64) -> f64 {
    // 1 − u lies in (0, 1], so the logarithm is finite
    (-2.0 * ln(1.0 - unit(a))).sqrt() * cos_of_turns(unit(b))
}

/// The bits of √½, of its upper half.
pub(crate) const SQRT_HALF: u64 = 0x3FE6_A09E << 32;
const ONE: u64 = 0x3FF << 52;
const MANTISSA: u64 = (1 << 52) - 1;
/// ln 2 in two parts (Cody and Waite 1980): products of the first with an exponent are exact.
pub(crate) const LN_2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];
/// (ln(1 + f) − ln(1 − f) − 2f)/f of f², highest power first.
pub(crate) const LN: [f64; 7] = [
    1.479_819_860_511_658_6e-1,
    1.531_383_769_920_937_3e-1,
    1.818_357_216_161_805e-1,
    2.222_219_843_214_978_4e-1,
    2.857_142_874_366_239e-1,
    3.999_999_999_940_942e-1,
    6.666_666_666_666_735e-1,
];

/// ln x of a normal number x > 0.
///
/// Exponent and mantissa are split so that the mantissa 1 + f lies in [√½, √2); s = f/(2 + f) makes of its logarithm an odd series.
#[inline(always)]
#[doc(hidden)]
pub fn ln(x: f64) -> f64 {
    let shifted = x.to_bits().wrapping_add(ONE - SQRT_HALF);
    // behind the exponent of 2⁵², a small integer is a number
    let exponent = f64::from_bits((shifted >> 52) | (1075 << 52)) - ((1_u64 << 52) + 1023) as f64;
    let f = f64::from_bits((shifted & MANTISSA).wrapping_add(SQRT_HALF)) - 1.0;
    let s = f / (2.0 + f);
    let z = s * s;
    let [a, b, c, d, e, g, h] = LN;
    let rest = z * (h + z * (g + z * (e + z * (d + z * (c + z * (b + z * a))))));
    let half_square = 0.5 * f * f;
    exponent * LN_2[0] - ((half_square - (s * (half_square + rest) + exponent * LN_2[1])) - f)
}

/// 1.5·2⁵²: adding and subtracting it rounds |x| < 2⁵¹ to an integer, and its sum with one has that integer in its lowest bits.
pub(crate) const ROUND: f64 = 6_755_399_441_055_744.0;
/// (sin r − r)/r³ of r², highest power first.
pub(crate) const SINE: [f64; 6] = [
    1.589_690_995_211_55e-10,
    -2.505_076_025_340_686_3e-8,
    2.755_731_370_707_006_8e-6,
    -1.984_126_982_985_795e-4,
    8.333_333_333_322_49e-3,
    -1.666_666_666_666_663_2e-1,
];
/// (cos r − 1 + r²/2)/r⁴ of r², highest power first.
pub(crate) const COSINE: [f64; 6] = [
    -1.135_964_755_778_819_5e-11,
    2.087_572_321_298_175e-9,
    -2.755_731_435_139_066_3e-7,
    2.480_158_728_947_673e-5,
    -1.388_888_888_887_411e-3,
    4.166_666_666_666_66e-2,
];

/// cos 2πu for a multiple u of 2⁻⁵³ in [0, 1).
///
/// Quarters of a turn and what is left of one, in [−½, ½], are exact; only that is multiplied by π/2.
#[inline(always)]
fn cos_of_turns(u: f64) -> f64 {
    let quarters = 4.0 * u;
    let shifted = quarters + ROUND;
    let r = (quarters - (shifted - ROUND)) * std::f64::consts::FRAC_PI_2;
    let z = r * r;
    let [a, b, c, d, e, f] = SINE;
    let sine = r + r * z * (f + z * (e + z * (d + z * (c + z * (b + z * a)))));
    let [a, b, c, d, e, f] = COSINE;
    let half = 0.5 * z;
    let first = 1.0 - half;
    let rest = z * z * (f + z * (e + z * (d + z * (c + z * (b + z * a)))));
    let cosine = first + (((1.0 - first) - half) + rest);
    // cos, −sin, −cos, sin of what is left
    let quadrant = shifted.to_bits();
    let is_odd = (quadrant & 1).wrapping_neg();
    let size = cosine.to_bits() ^ ((cosine.to_bits() ^ sine.to_bits()) & is_odd);
    f64::from_bits(size ^ ((quadrant.wrapping_add(1) << 62) & (1 << 63)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Purpose, Stream};
    use std::f64::consts::{FRAC_PI_2, TAU};

    /// Draws of 64 bits: evenly over all, from both ends on, random ones.
    fn draws() -> impl Iterator<Item = u64> {
        let n = if cfg!(miri) { 200 } else { 200_000 };
        let mut stream = Stream::new(51, 0, 0, Purpose::user(51));
        let even = (0..n).map(move |i| i * (u64::MAX / n));
        let ends = (0..n).flat_map(|i| [i << 11, u64::MAX - (i << 11)]);
        even.chain(ends).chain((0..2 * n).map(move |_| stream.next_u64()))
    }

    /// Steps of the last bit between two numbers of one sign.
    fn steps(a: f64, b: f64) -> u64 {
        if a == b { 0 } else { a.to_bits().abs_diff(b.to_bits()) }
    }

    /// By the standard library, of the same exact quarters.
    fn library_cosine(u: f64) -> f64 {
        let quarters = (4.0 * u).round();
        let rest = (4.0 * u - quarters) * FRAC_PI_2;
        match quarters as u32 {
            0 | 4 => rest.cos(),
            1 => -rest.sin(),
            2 => -rest.cos(),
            _ => rest.sin(),
        }
    }

    #[test]
    fn logarithm_and_cosine_are_within_a_step_of_the_library_s() {
        let (mut of_ln, mut of_cosine, mut worst) = (0, 0, 0.0_f64);
        for bits in draws() {
            let u = unit(bits);
            of_ln = of_ln.max(steps(ln(1.0 - u), (1.0 - u).ln()));
            of_cosine = of_cosine.max(steps(cos_of_turns(u), library_cosine(u)));
            // the argument that the library rounds is off by 4e-16
            worst = worst.max((cos_of_turns(u) - (TAU * u).cos()).abs());
        }
        println!("ln {of_ln}, cos {of_cosine} steps; {worst:e}");
        // measured 1, 1 and 6.4e-16; the library's own error is below 1
        assert!(of_ln <= 2 && of_cosine <= 2 && worst < 1e-15, "ln {of_ln}, cos {of_cosine} steps; {worst:e}");
    }

    #[test]
    fn quarters_of_a_turn_are_exact() {
        assert_eq!([0.0, 0.25, 0.5, 0.75].map(cos_of_turns), [1.0, 0.0, -1.0, 0.0]);
        // symmetric to the bit
        for u in draws().map(|bits| unit(bits >> 1)) {
            assert_eq!(cos_of_turns(0.5 + u), -cos_of_turns(u));
        }
    }

    #[test]
    fn normals_of_the_outermost_draws_are_finite() {
        assert_eq!(normal(0, 0), 0.0);
        assert_eq!(normal(u64::MAX, 0), 8.571_674_348_652_905);
        assert!(draws().all(|a| normal(a, u64::MAX).abs() < 8.6));
    }
}
