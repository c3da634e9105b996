//! The streams as text of C and CUDA: the words of [`Stream`](super::Stream), its uniform and normal numbers, to the bit.

use super::normal::{COSINE, LN, LN_2, ROUND, SINE, SQRT_HALF};
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;

/// Definitions of `od_words` (`open`, `next`), `od_unit`, `od_below`, `od_normal`, `od_ln`, `od_unit_float`. What stands before each is
/// `od_own`, the storage of functions; `od_high(a, b)` is the upper half of a product, `od_bits` and `od_number` carry bits of a `double`,
/// `od_root` is a square root rounded once. Compilers may not fuse products.
#[doc(hidden)]
pub fn device_text() -> String {
    let horner = |x: &str, coefficients: &[f64]| {
        let mut text = format!("{:?}", coefficients[0]);
        for own in &coefficients[1..] {
            text = format!("({own:?} + {x} * {text})");
        }
        text
    };
    let mut text = STREAMS.to_string();
    let _ = write!(
        text,
        "
od_own double od_ln(double x)
{{
    const uint64_t shifted = od_bits(x) + {to_root:#x}u;
    const double exponent = od_number((shifted >> 52) | ((uint64_t)1075 << 52)) - {bias:?};
    const double f = od_number((shifted & 0xFFFFFFFFFFFFFu) + {root:#x}u) - 1.0;
    const double s = f / (2.0 + f);
    const double z = s * s;
    const double rest = z * {ln};
    const double half_square = 0.5 * f * f;
    return exponent * {coarse:?} - ((half_square - (s * (half_square + rest) + exponent * {fine:?})) - f);
}}

od_own double od_cos_of_turns(double u)
{{
    const double quarters = 4.0 * u;
    const double shifted = quarters + {round:?};
    const double r = (quarters - (shifted - {round:?})) * {quarter:?};
    const double z = r * r;
    const double sine = r + r * z * {sine};
    const double half = 0.5 * z;
    const double first = 1.0 - half;
    const double rest = z * z * {cosine};
    const double cosine = first + (((1.0 - first) - half) + rest);
    const uint64_t quadrant = od_bits(shifted);
    const uint64_t size = od_bits((quadrant & 1u) != 0u ? sine : cosine);
    return od_number(size ^ (((quadrant + 1u) << 62) & ((uint64_t)1 << 63)));
}}

/* standard normal, of two draws */
od_own double od_normal(od_words *own)
{{
    const double first = od_unit(own), second = od_unit(own);
    return od_root(-2.0 * od_ln(1.0 - first)) * od_cos_of_turns(second);
}}
",
        to_root = (0x3FF_u64 << 52) - SQRT_HALF,
        root = SQRT_HALF,
        bias = ((1_u64 << 52) + 1023) as f64,
        ln = horner("z", &LN),
        coarse = LN_2[0],
        fine = LN_2[1],
        round = ROUND,
        quarter = FRAC_PI_2,
        sine = horner("z", &SINE),
        cosine = horner("z", &COSINE),
    );
    text
}

/// Blocks of ChaCha8 and draws from them.
const STREAMS: &str = "\
/* ChaCha8 (Bernstein 2008): consecutive words of a stream, with the block in hand that the next one is in */
typedef struct {
    uint64_t key[4], position, block; /* the number of the block in hand, above all where there is none */
    uint32_t words[16];
} od_words;

#define OD_TURN(x, by) ((x) << (by) | (x) >> (32 - (by)))
#define OD_QUARTER(a, b, c, d) \\
    a += b, d ^= a, d = OD_TURN(d, 16), c += d, b ^= c, b = OD_TURN(b, 12), \\
    a += b, d ^= a, d = OD_TURN(d, 8), c += d, b ^= c, b = OD_TURN(b, 7)

od_own void od_compute(od_words *own, uint64_t block)
{
    uint32_t begun[16], x[16];
    begun[0] = 0x61707865u, begun[1] = 0x3320646Eu, begun[2] = 0x79622D32u, begun[3] = 0x6B206574u;
    for (int k = 0; k < 4; k++) {
        begun[4 + 2 * k] = (uint32_t)own->key[k];
        begun[5 + 2 * k] = (uint32_t)(own->key[k] >> 32);
    }
    begun[12] = (uint32_t)block, begun[13] = (uint32_t)(block >> 32), begun[14] = 0, begun[15] = 0;
    for (int k = 0; k < 16; k++) x[k] = begun[k];
    for (int round = 0; round < 4; round++) {
        OD_QUARTER(x[0], x[4], x[8], x[12]);
        OD_QUARTER(x[1], x[5], x[9], x[13]);
        OD_QUARTER(x[2], x[6], x[10], x[14]);
        OD_QUARTER(x[3], x[7], x[11], x[15]);
        OD_QUARTER(x[0], x[5], x[10], x[15]);
        OD_QUARTER(x[1], x[6], x[11], x[12]);
        OD_QUARTER(x[2], x[7], x[8], x[13]);
        OD_QUARTER(x[3], x[4], x[9], x[14]);
    }
    for (int k = 0; k < 16; k++) own->words[k] = x[k] + begun[k];
    own->block = block;
}

od_own void od_open(od_words *own, uint64_t seed, uint64_t environment, uint64_t episode, uint64_t purpose, uint64_t position)
{
    own->key[0] = seed, own->key[1] = environment, own->key[2] = episode, own->key[3] = purpose;
    own->position = position, own->block = ~(uint64_t)0;
}

od_own uint32_t od_word(od_words *own)
{
    const uint64_t block = own->position / 16;
    if (block != own->block) od_compute(own, block);
    return own->words[own->position++ % 16];
}

/* 64 uniform bits */
od_own uint64_t od_next(od_words *own)
{
    const uint64_t low = od_word(own);
    return low | (uint64_t)od_word(own) << 32;
}

/* uniform in [0, 1) */
od_own double od_unit(od_words *own)
{
    return (double)(od_next(own) >> 11) * (1.0 / 9007199254740992.0);
}

/* uniform among the whole numbers below n */
od_own uint64_t od_below(od_words *own, uint64_t n)
{
    return od_high(od_next(own), n);
}

/* rounded once, and never to 1 */
od_own float od_unit_float(double x)
{
    const float near = (float)x, most = 0.99999994f;
    return near < most ? near : most;
}
";
