//! Elementary functions in C: libm's in `double`, the polynomials of the lanes in `float`, so that a processor which fuses has their bits.

use super::function::ExportPrecision;
use super::text::{Dialect, literal};
use crate::polynomials::*;
use std::f64::consts::{FRAC_2_PI, FRAC_PI_2, FRAC_PI_4, LOG2_E, PI};
use std::fmt::Write;

/// A function that text calls, by the name that [`CText::need`](super::CText::need) tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Elementary {
    /// `fma(a, b, c)`: a·b + c.
    Fma,
    /// `bits(x)`, and `float(bits)`, whose name ends so.
    Bits,
    /// `sqrt(x)`
    Sqrt,
    /// `sin_cos(x, &cosine)`: the sine.
    SinCos,
    /// `exp(x)`
    Exp,
    /// `ln(x)`
    Ln,
    /// `tanh(x)`
    Tanh,
    /// `atan2(y, x)`
    Atan2,
}

impl Elementary {
    /// What its text calls, besides.
    fn needs(self, precision: ExportPrecision) -> &'static [Self] {
        if precision == ExportPrecision::Double {
            return &[];
        }
        match self {
            Self::Fma | Self::Bits | Self::Sqrt => &[],
            Self::SinCos | Self::Exp | Self::Ln => &[Self::Fma, Self::Bits],
            Self::Tanh => &[Self::Fma, Self::Bits, Self::Exp],
            Self::Atan2 => &[Self::Fma, Self::Bits],
        }
    }

    /// Bytes of stack of a call without optimisation; measured with gcc for 64 bits, and rounded up. What libm needs is not in it.
    pub fn stack(self, precision: ExportPrecision) -> usize {
        match (self, precision) {
            (Self::SinCos, ExportPrecision::Double) => 64,
            (Self::Fma | Self::Bits | Self::Sqrt, _) | (_, ExportPrecision::Double) => 8,
            (Self::SinCos | Self::Exp | Self::Ln | Self::Atan2, _) => 144,
            (Self::Tanh, _) => 240,
        }
    }

    /// These and what they call, callees first.
    pub(super) fn with_needs(all: impl Iterator<Item = Self>, precision: ExportPrecision) -> Vec<Self> {
        let mut found: Vec<Self> = all.flat_map(|own| own.needs(precision).iter().copied().chain([own])).collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    /// What its name ends with.
    fn ending(self) -> &'static str {
        match self {
            Self::Fma => "fma",
            Self::Bits => "bits",
            Self::Sqrt => "sqrt",
            Self::SinCos => "sin_cos",
            Self::Exp => "exp",
            Self::Ln => "ln",
            Self::Tanh => "tanh",
            Self::Atan2 => "atan2",
        }
    }

    /// Its name in a text whose names begin with `prefix`: several texts may be one file to a compiler.
    pub(super) fn name(self, prefix: &str) -> String {
        format!("{prefix}_od_{}", self.ending())
    }

    /// Its definition.
    pub(super) fn text(self, prefix: &str, precision: ExportPrecision, dialect: Dialect) -> String {
        let text = match (precision, dialect) {
            (ExportPrecision::Double, _) => self.double().into(),
            (_, Dialect::C99) => self.single(),
            (_, Dialect::Cuda) => self.of_device(),
        };
        text.replace('@', &format!("{prefix}_od_"))
    }

    /// What a device has built in, the polynomials around it.
    fn of_device(self) -> String {
        match self {
            Self::Fma => "#define @fma(a, b, c) __fmaf_rn((a), (b), (c))\n".into(),
            Self::Sqrt => "#define @sqrt(x) __fsqrt_rn(x)\n".into(),
            Self::Bits => "#define @bits(x) __float_as_uint(x)\n#define @float(x) __uint_as_float(x)\n".into(),
            _ => self.single().replace("static ", Dialect::Cuda.own()),
        }
    }

    fn double(self) -> &'static str {
        match self {
            Self::Fma | Self::Bits => "",
            Self::Sqrt => "#define @sqrt(x) sqrt(x)\n",
            Self::SinCos => {
                "static double @sin_cos(double x, double *cosine)\n{\n    *cosine = cos(x);\n    return sin(x);\n}\n"
            }
            Self::Exp => "#define @exp(x) exp(x)\n",
            Self::Ln => "#define @ln(x) log(x)\n",
            Self::Tanh => "#define @tanh(x) tanh(x)\n",
            Self::Atan2 => "#define @atan2(y, x) atan2((y), (x))\n",
        }
    }

    fn single(self) -> String {
        match self {
            Self::Fma => FMA.into(),
            Self::Bits => BITS.into(),
            Self::Sqrt => SQRT.into(),
            Self::SinCos => sin_cos(),
            Self::Exp => exp(),
            Self::Ln => ln(),
            Self::Tanh => tanh(),
            Self::Atan2 => atan2(),
        }
    }
}

// as `fmaf` and `sqrtf` they are calls where a compiler is told of no library, or keeps errno, which clang does on bare metal
const FMA: &str = "\
/* one rounding where the processor has the instruction, two elsewhere */
#if defined(FP_FAST_FMAF) || defined(__FP_FAST_FMAF) || defined(__ARM_FEATURE_FMA) || defined(__FMA__) || defined(__aarch64__)
#if defined(__has_builtin)
#if __has_builtin(__builtin_elementwise_fma)
#define @fma(a, b, c) __builtin_elementwise_fma((a), (b), (c))
#endif
#endif
#if !defined(@fma) && defined(__GNUC__)
#define @fma(a, b, c) __builtin_fmaf((a), (b), (c))
#elif !defined(@fma)
#define @fma(a, b, c) fmaf((a), (b), (c))
#endif
#else
#define @fma(a, b, c) ((a) * (b) + (c))
#endif
";

const SQRT: &str = "\
#if defined(__has_builtin)
#if __has_builtin(__builtin_elementwise_sqrt)
#define @sqrt(x) __builtin_elementwise_sqrt(x)
#endif
#endif
#if !defined(@sqrt) && defined(__GNUC__)
#define @sqrt(x) __builtin_sqrtf(x)
#elif !defined(@sqrt)
#define @sqrt(x) sqrtf(x)
#endif
";

const BITS: &str = "\
static uint32_t @bits(float x)
{
    union { float x; uint32_t bits; } own;
    own.x = x;
    return own.bits;
}

static float @float(uint32_t bits)
{
    union { float x; uint32_t bits; } own;
    own.bits = bits;
    return own.x;
}
";

fn number(x: f64) -> String {
    literal(x, ExportPrecision::Single)
}

/// Horner's scheme in `x`, statement by statement, into `p`.
fn polynomial(p: &str, x: &str, coefficients: &[f64]) -> String {
    let mut text = format!("    float {p} = {};\n", number(coefficients[0]));
    for coefficient in &coefficients[1..] {
        let _ = writeln!(text, "    {p} = @fma({p}, {x}, {});", number(*coefficient));
    }
    text
}

/// r = x − k·period, the period in two parts.
fn reduced(period: [f64; 2]) -> String {
    let [coarse, fine] = period.map(number);
    format!("    float r = @fma(-k, {coarse}, x);\n    r = @fma(-k, {fine}, r);\n")
}

/// The whole number k in the bits of k + ROUND: taken as a difference of floats, a compiler that may reorder sums folds it away.
fn whole(bits: &str) -> String {
    format!("    const float k = (float)(int32_t)({bits} - 0x{:08X}u);\n", (ROUND as f32).to_bits())
}

fn sin_cos() -> String {
    format!(
        "/* Cephes; |x| < 1e6 */
static float @sin_cos(float x, float *cosine)
{{
    const float quotient = x * {scale};
    const uint32_t quadrant = @bits(quotient + {round});
{whole}{reduced}    const float z = r * r;
{sine}    s = @fma(r * z, s, r);
{cos}    q = @fma(z * z, q, @fma(-z, 0.5f, 1.0f));
    const uint32_t turned = ((quadrant + 1u) << 30) & 0x80000000u;
    const float odd = (quadrant & 1u) != 0u ? s : q;
    *cosine = @float(@bits(odd) ^ turned);
    return @float(@bits((quadrant & 1u) != 0u ? q : s) ^ ((quadrant << 30) & 0x80000000u));
}}
",
        scale = number(FRAC_2_PI),
        round = number(ROUND),
        whole = whole("quadrant"),
        reduced = reduced(HALF_PI),
        sine = polynomial("s", "z", &SINE),
        cos = polynomial("q", "z", &COSINE),
    )
}

fn exp() -> String {
    let [low, high] = EXP_RANGE.map(number);
    format!(
        "static float @exp(float x)
{{
    x = x < {low} ? {low} : x;
    x = {high} < x ? {high} : x;
    const uint32_t power = @bits(@fma(x, {scale}, {round}));
{whole}{reduced}{exp}    p = @fma(r * r, p, r) + 1.0f;
    return p * @float((power << 23) + 0x3F800000u);
}}
",
        low = low,
        high = high,
        scale = number(LOG2_E),
        round = number(ROUND),
        whole = whole("power"),
        reduced = reduced(LN_2),
        exp = polynomial("p", "r", &EXP),
    )
}

fn ln() -> String {
    let [coarse, fine] = LN_2.map(number);
    format!(
        "static float @ln(float number)
{{
    const uint32_t shifted = @bits(number) + {to_root}u;
    const float exponent = @float((shifted >> 23) + 0x4B400000u) - {bias};
    const float x = @float((shifted & 0x007FFFFFu) + {root}u) - 1.0f;
    const float z = x * x;
{ln}    float y = @fma(x * z, p, exponent * ({fine}));
    y = @fma(z, -0.5f, y);
    const float logarithm = @fma(exponent, {coarse}, x + y);
    return 0.0f < number ? logarithm : NAN;
}}
",
        to_root = 0x3F80_0000 - SQRT_HALF,
        bias = number(ROUND + 127.0),
        root = SQRT_HALF,
        ln = polynomial("p", "x", &LN),
    )
}

fn tanh() -> String {
    format!(
        "static float @tanh(float x)
{{
    const float z = x * x;
{tanh}    const float size = @float(@bits(x) & 0x7FFFFFFFu);
    const float inverse = 1.0f / (@exp(size + size) + 1.0f);
    const float large = 1.0f - 2.0f * inverse;
    p = @fma(x * z, p, x);
    return size < {small} ? p : x < 0.0f ? -large : large;
}}
",
        tanh = polynomial("p", "z", &TANH),
        small = number(TANH_SMALL),
    )
}

fn atan2() -> String {
    format!(
        "static float @atan2(float y, float x)
{{
    const float ay = @float(@bits(y) & 0x7FFFFFFFu), ax = @float(@bits(x) & 0x7FFFFFFFu);
    const float low = ax < ay ? ax : ay;
    float high = ax < ay ? ay : ax;
    high = high < {least} ? {least} : high;
    const float t = low * (1.0f / high);
    const float folded = (t - 1.0f) * (1.0f / (t + 1.0f));
    const float r = {fold} < t ? folded : t;
    const float z = r * r;
{atan}    float angle = @fma(r * z, p, r);
    angle = {fold} < t ? angle + {eighth} : angle;
    angle = ax < ay ? {quarter} - angle : angle;
    angle = x < 0.0f ? {half} - angle : angle;
    return y < 0.0f ? -angle : angle;
}}
",
        least = number(ATAN_LEAST),
        fold = number(ATAN_FOLD),
        atan = polynomial("p", "z", &ATAN),
        eighth = number(FRAC_PI_4),
        quarter = number(FRAC_PI_2),
        half = number(PI),
    )
}
