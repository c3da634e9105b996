//! Coefficients of the elementary functions in lanes, after Cephes (Moshier 1989), highest power first.
//!
//! Registers of lanes and machine code both read them: one list, the same bits.

/// 1.5·2²³: adding and subtracting it rounds |x| < 2²² to an integer, and its sum with one has that integer in its lowest bits.
pub(crate) const ROUND: f64 = 12_582_912.0;

/// π/2 in two parts (Cody and Waite 1980).
pub(crate) const HALF_PI: [f64; 2] = [1.570_796_370_506_286_6, -4.371_139_000_186_241e-8];
/// (sin r − r)/r³ of r².
pub(crate) const SINE: [f64; 3] = [-1.951_529_589_1e-4, 8.332_160_873_6e-3, -1.666_665_461_1e-1];
/// (cos r − 1 + r²/2)/r⁴ of r².
pub(crate) const COSINE: [f64; 3] = [2.443_315_711_809_948e-5, -1.388_731_625_493_765e-3, 4.166_664_568_298_827e-2];

/// Where eˣ stays finite and normal.
pub(crate) const EXP_RANGE: [f64; 2] = [-87.3, 88.3];
/// ln 2 in two parts.
pub(crate) const LN_2: [f64; 2] = [0.693_359_375, -2.121_944_4e-4];
/// (eʳ − 1 − r)/r² of r.
pub(crate) const EXP: [f64; 6] = [
    1.987_569_15e-4,
    1.398_199_950_7e-3,
    8.333_451_907_3e-3,
    4.166_579_589_4e-2,
    1.666_666_545_9e-1,
    5.000_000_120_1e-1,
];

/// The bits of √½ in `f32`.
pub(crate) const SQRT_HALF: u32 = 0x3F35_04F3;
/// (ln(1 + x) − x + x²/2)/x³ of x.
pub(crate) const LN: [f64; 9] = [
    7.037_683_629_2e-2,
    -1.151_461_031_0e-1,
    1.167_699_874_0e-1,
    -1.242_014_084_6e-1,
    1.424_932_278_7e-1,
    -1.666_805_766_5e-1,
    2.000_071_476_5e-1,
    -2.499_999_399_3e-1,
    3.333_333_117_4e-1,
];

/// Below it, tanh is a polynomial.
pub(crate) const TANH_SMALL: f64 = 0.625;
/// (tanh x − x)/x³ of x².
pub(crate) const TANH: [f64; 5] =
    [-5.704_988_727_45e-3, 2.063_908_879_54e-2, -5.373_971_555_31e-2, 1.333_144_220_36e-1, -3.333_328_194_22e-1];

/// Least divisor of an arctangent.
pub(crate) const ATAN_LEAST: f64 = 1e-37;
/// tan(π/8): above it, an arctangent is π/4 plus that of (t − 1)/(t + 1).
pub(crate) const ATAN_FOLD: f64 = std::f64::consts::SQRT_2 - 1.0;
/// (atan t − t)/t³ of t².
pub(crate) const ATAN: [f64; 4] =
    [8.053_744_495_38e-2, -1.387_768_560_32e-1, 1.997_771_064_78e-1, -3.333_294_915_39e-1];
