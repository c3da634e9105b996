//! From data to a scale: range, ticks at 1-2-5 steps or decades, labels with a common power of ten taken out.

/// Values larger than this are treated as missing: their differences would overflow.
const LARGEST: f64 = 1e150;

/// Whether a value can be drawn.
pub(super) fn drawable(v: f64, log: bool) -> bool {
    v.is_finite() && v.abs() <= LARGEST && (!log || v >= 1e-300)
}

/// How one axis maps values to [0, 1], and what is written along it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Axis {
    lo: f64,
    hi: f64,
    log: bool,
    /// Position in [0, 1] and label.
    pub ticks: Vec<(f64, String)>,
    /// `×10⁵`, written once at the end of the axis; empty mostly.
    pub multiplier: String,
}

impl Axis {
    /// A scale for values in [`lo`, `hi`] with about `wanted` ticks and the fraction `pad` of free room at both ends.
    pub fn fit(lo: f64, hi: f64, log: bool, pad: f64, wanted: usize) -> Self {
        let (mut lo, mut hi) = if drawable(lo, log) && drawable(hi, log) && lo <= hi {
            (lo, hi)
        } else if log {
            (0.1, 10.0)
        } else {
            (0.0, 1.0)
        };
        if log {
            (lo, hi) = (lo.log10(), hi.log10());
        }
        // Below a millionth of the size of the values a range would only show rounding, and labels would have 10 digits.
        let least = if log { 0.2 } else { 1e-6 * lo.abs().max(hi.abs()) };
        if hi - lo <= least {
            let half = if log {
                0.5
            } else if lo == 0.0 && hi == 0.0 {
                1.0
            } else {
                0.1 * lo.abs().max(hi.abs())
            };
            (lo, hi) = (lo - half, hi + half);
        } else {
            let room = pad * (hi - lo);
            (lo, hi) = (lo - room, hi + room);
        }
        let (ticks, multiplier) = if log { (log_ticks(lo, hi, wanted), String::new()) } else { ticks(lo, hi, wanted) };
        let ticks = ticks.into_iter().map(|(v, label)| ((v - lo) / (hi - lo), label)).collect();
        Self { lo, hi, log, ticks, multiplier }
    }

    /// 0 at the lower end, 1 at the upper; NaN for what cannot be drawn.
    pub fn unit(&self, v: f64) -> f64 {
        if !drawable(v, self.log) {
            return f64::NAN;
        }
        let v = if self.log { v.log10() } else { v };
        (v - self.lo) / (self.hi - self.lo)
    }
}

/// The largest of 1, 2, 5 · 10ⁿ that gives at least about `wanted` steps over `span`.
pub(super) fn step(span: f64, wanted: usize) -> f64 {
    let raw = span / wanted.max(1) as f64;
    let decade = 10f64.powf(raw.log10().floor());
    let factor = match raw / decade {
        f if f < 1.5 => 1.0,
        f if f < 3.5 => 2.0,
        f if f < 7.5 => 5.0,
        _ => 10.0,
    };
    factor * decade
}

/// Multiples of a tidy step inside [lo, hi], labelled.
pub(super) fn ticks(lo: f64, hi: f64, wanted: usize) -> (Vec<(f64, String)>, String) {
    let step = step(hi - lo, wanted);
    if !(step.is_finite() && step > 0.0) {
        return (Vec::new(), String::new());
    }
    let size = lo.abs().max(hi.abs());
    let exponent = if (1e-3..1e5).contains(&size) { 0 } else { size.log10().floor() as i32 };
    let power = 10f64.powi(exponent);
    let decimals = (exponent as f64 - (step * 1.0001).log10().floor()).clamp(0.0, 12.0) as usize;
    let first = (lo / step - 1e-9).ceil();
    let count = (((hi / step + 1e-9).floor() - first) as i64).clamp(-1, 50);
    let values = (0..=count).map(|i| (first + i as f64) * step);
    let labelled = values.map(|v| (v, number(v / power, decimals))).collect();
    let multiplier = if exponent == 0 { String::new() } else { format!("×10{}", superscript(exponent)) };
    (labelled, multiplier)
}

/// Decades inside [lo, hi] (both log₁₀), thinned when many, with 2 and 5 between them when few.
fn log_ticks(lo: f64, hi: f64, wanted: usize) -> Vec<(f64, String)> {
    let decades = hi - lo;
    let every = ((decades / wanted.max(1) as f64).ceil() as i32).max(1);
    let factors: &[f64] = if decades < 1.5 { &[1.0, 2.0, 5.0] } else { &[1.0] };
    // Plain numbers or powers of ten, one way along the whole axis.
    let plain = lo >= -3.01 && hi <= 5.0;
    let mut out = Vec::new();
    for exponent in lo.floor() as i32..=hi.ceil() as i32 {
        if exponent.rem_euclid(every) != 0 {
            continue;
        }
        for factor in factors {
            let v = exponent as f64 + factor.log10();
            if v < lo - 1e-9 || v > hi + 1e-9 {
                continue;
            }
            let label = match (plain, *factor == 1.0) {
                (true, _) => number(factor * 10f64.powi(exponent), (-exponent).max(0) as usize),
                (false, true) => format!("10{}", superscript(exponent)),
                (false, false) => format!("{factor:.0}×10{}", superscript(exponent)),
            };
            out.push((v, label));
        }
    }
    out
}

/// `v` with a true minus sign, and no negative zero.
pub(super) fn number(v: f64, decimals: usize) -> String {
    let text = format!("{v:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().any(|c| c.is_ascii_digit() && c != '0') => format!("−{rest}"),
        Some(rest) => rest.to_string(),
        None => text,
    }
}

/// About three significant digits, for values written beside bars and colour bars.
pub(super) fn short(v: f64) -> String {
    let size = v.abs();
    if !v.is_finite() {
        "not finite".to_string()
    } else if size == 0.0 {
        "0".to_string()
    } else if !(1e-3..1e5).contains(&size) {
        let exponent = size.log10().floor() as i32;
        format!("{}×10{}", number(v / 10f64.powi(exponent), 2), superscript(exponent))
    } else {
        number(v, (2 - size.log10().floor() as i32).max(0) as usize)
    }
}

fn superscript(n: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let digits = n.unsigned_abs().to_string();
    let sign = if n < 0 { "⁻" } else { "" };
    sign.chars().chain(digits.bytes().map(|b| DIGITS[usize::from(b - b'0')])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tick_labels_are_multiples_of_one_two_or_five_with_just_enough_digits() {
        let labels = |lo, hi| ticks(lo, hi, 5).0.into_iter().map(|t| t.1).collect::<Vec<_>>();
        assert_eq!(labels(-0.01, 1.0), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(-20.0, 20.0), ["−20", "−10", "0", "10", "20"]);
        assert_eq!(ticks(0.0, 2.5e6, 5).1, "×10⁶");
    }

    #[test]
    fn constant_extreme_and_broken_ranges_still_give_a_finite_scale() {
        for (lo, hi) in [
            (0.0, 0.0),
            (3.0, 3.0),
            (-1e150, 1e150),
            (1e-310, 2e-310),
            (f64::NAN, 1.0),
            (f64::INFINITY, f64::NEG_INFINITY),
            (1e9, 1e9 + 1e-3),
            (-5e-324, 5e-324),
        ] {
            for log in [false, true] {
                let axis = Axis::fit(lo, hi, log, 0.05, 5);
                assert!(axis.hi > axis.lo, "{lo} {hi} {log}");
                assert!(axis.ticks.len() < 60 && axis.ticks.iter().all(|t| t.0.is_finite()), "{lo} {hi} {log}");
            }
        }
    }
}
