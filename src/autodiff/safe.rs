//! Corner-safe functions: finite values *and* finite derivatives where the plain ones have neither.
//!
//! Each guards its argument, not its result. A guarded result (`select(ok, √x, 0)`) is fine forwards, but a reverse
//! sweep still multiplies the masked zero by the infinite slope of √ at 0 and returns NaN. Below the stated floor the
//! functions are constant in the guarded quantity, so their one-sided derivative there is 0 (or as stated).

use super::scalar::{Mask, Scalar};
use super::unrolled::unrolled;

/// Floor on squared norms: below ‖v‖ = 1e-9 a direction is not defined.
#[doc(hidden)]
pub const SQUARED_NORM_FLOOR: f64 = 1e-18;

/// √max(x, floor): for x below `floor > 0`, the constant √floor with derivative 0.
#[inline(always)]
pub fn sqrt<S: Scalar>(x: S, floor: f64) -> S {
    x.max(S::constant(floor)).sqrt()
}

/// 1/√max(x, floor): for x below `floor > 0`, the constant 1/√floor with derivative 0.
#[inline(always)]
pub fn recip_sqrt<S: Scalar>(x: S, floor: f64) -> S {
    sqrt(x, floor).recip()
}

/// ‖v‖ of a vector; below 1e-9 the constant 1e-9 with derivative 0.
#[inline(always)]
pub fn norm<S: Scalar, const N: usize>(v: [S; N]) -> S {
    sqrt(squared_norm(v), SQUARED_NORM_FLOOR)
}

/// v/max(‖v‖, 1e-9): the zero vector maps to itself with slope 1e9, never to NaN.
#[inline(always)]
pub fn normalise<S: Scalar, const N: usize>(v: [S; N]) -> [S; N] {
    let scale = recip_sqrt(squared_norm(v), SQUARED_NORM_FLOOR);
    let mut unit = v;
    unrolled!(i in 0..N {
        unit[i] = v[i] * scale;
    });
    unit
}

/// Angle of the point (x, y), rad, with value and derivative 0 at the origin (closer than 1e-9).
#[inline(always)]
pub fn atan2<S: Scalar>(y: S, x: S) -> S {
    let at_origin = (y * y + x * x).lt(S::constant(SQUARED_NORM_FLOOR));
    S::select(at_origin, S::zero(), y).atan2(S::select(at_origin, S::one(), x))
}

/// arccos of x held within [−1, 1], rad; in `f64` derivative 0 within 1e-12 of either end, where the true one is infinite.
/// In `f32`, where 1 − 1e-12 rounds to 1, it is infinite at x = ±1.
#[inline(always)]
pub fn acos<S: Scalar>(x: S) -> S {
    let end = 1.0 - 1e-12;
    let inside = x.clamp(S::constant(-end), S::constant(end));
    let angle = (S::one() - inside * inside).sqrt().atan2(inside);
    let at_one = S::constant(end).lt(x);
    let at_minus_one = x.lt(S::constant(-end));
    let angle = S::select(at_one, S::zero(), angle);
    S::select(at_minus_one, S::constant(std::f64::consts::PI), angle)
}

/// arcsin of x held within [−1, 1], rad; in `f64` derivative 0 within 1e-12 of either end, where the true one is infinite.
/// In `f32`, where 1 − 1e-12 rounds to 1, it is infinite at x = ±1.
#[inline(always)]
pub fn asin<S: Scalar>(x: S) -> S {
    S::constant(std::f64::consts::FRAC_PI_2) - acos(x)
}

/// a/b with |b| kept ≥ `floor` (sign kept, + at zero): for |b| below `floor` the quotient a/±floor, constant in b.
#[inline(always)]
pub fn div<S: Scalar>(a: S, b: S, floor: f64) -> S {
    let tiny = b.abs().lt(S::constant(floor));
    let negative = b.lt(S::zero());
    let edge = S::select(negative, S::constant(-floor), S::constant(floor));
    a * S::select(tiny, edge, b).recip()
}

/// sin(x)/x, even and smooth through 0 (series below |x| = 0.01).
#[inline(always)]
pub fn sinc<S: Scalar>(x: S) -> S {
    let x2 = x * x;
    let small = x2.lt(S::constant(1e-4));
    let guarded = S::select(small, S::one(), x);
    let series = x2.mul_add(x2.mul_add(S::constant(1.0 / 120.0), S::constant(-1.0 / 6.0)), S::one());
    S::select(small, series, guarded.sin_cos().0 * guarded.recip())
}

/// True in every lane whose value is finite and below `limit` in magnitude.
#[inline(always)]
pub fn is_bounded<S: Scalar>(x: S, limit: f64) -> S::Mask {
    x.lt(S::constant(limit)).and(S::constant(-limit).lt(x))
}

/// True in every lane whose values are all finite and below `limit` in magnitude: by the largest, the smallest, and a sum that no NaN
/// leaves.
pub fn all_bounded<S: Scalar>(values: &[S], limit: f64) -> S::Mask {
    let (mut most, mut least, mut sum) = (S::zero(), S::zero(), S::zero());
    for value in values {
        (most, least, sum) = (most.max(*value), least.min(*value), sum + *value);
    }
    let of_all = S::constant(limit * (values.len() + 1) as f64);
    most.lt(S::constant(limit)).and(S::constant(-limit).lt(least)).and(sum.lt(of_all))
}

/// Σ vᵢ².
#[inline(always)]
pub fn squared_norm<S: Scalar, const N: usize>(v: [S; N]) -> S {
    let mut sum = v[0] * v[0];
    unrolled!(i in 1..N {
        sum = v[i].mul_add(v[i], sum);
    });
    sum
}
