//! How sure a count is: exact bounds of shares and of quantiles from a number of tries.

use serde::Serialize;

/// A share that was counted, and where it lies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Proportion {
    /// How often it was so.
    pub hits: usize,
    /// Of how many.
    pub n: usize,
    /// Bounds `[low, high]` of the true share, at the confidence ([`clopper_pearson`]).
    pub bounds: [f64; 2],
}

impl Proportion {
    /// `hits` of `n`; `confidence` within (0, 1), as 0.95.
    pub fn counted(hits: usize, n: usize, confidence: f64) -> Self {
        Self { hits, n, bounds: clopper_pearson(hits, n, confidence) }
    }
}

/// A quantile that was met, and where it lies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantile {
    /// The least value that at least this share of all do not exceed.
    pub value: f64,
    /// Bounds `[low, high]` of the true quantile, at the confidence; infinite where there are too few values to say.
    pub bounds: [f64; 2],
}

impl Quantile {
    /// Of `share` (0.5: the median) of values in rising order, with a confidence as 0.95; NaN without values. How many values lie
    /// below a quantile is binomial whatever their distribution: the bounds are the values at both ends of that count.
    ///
    /// Source: David and Nagaraja 2003, section 7.1.
    pub fn met(sorted: &[f64], share: f64, confidence: f64) -> Self {
        let (n, half) = (sorted.len(), 0.5 * (1.0 - confidence));
        let (mut low, mut high) = (None, None);
        for (k, below) in cumulative(n, share).enumerate().take(n) {
            low = if below <= half { Some(k) } else { low };
            high = high.or((below >= 1.0 - half).then_some(k));
        }
        let at = |k: Option<usize>, none: f64| k.and_then(|k| sorted.get(k)).copied().unwrap_or(none);
        let rank = ((share * n as f64).ceil() as usize).clamp(1, n.max(1)) - 1;
        Self { value: at(Some(rank), f64::NAN), bounds: [at(low, f64::NEG_INFINITY), at(high, f64::INFINITY)] }
    }
}

/// Exact bounds `[low, high]` of a share after `hits` of `n` tries: P(X ≥ hits) = (1 − confidence)/2 at `low` and P(X ≤ hits) =
/// (1 − confidence)/2 at `high`, X binomial. Never too narrow; `[0, 1]` without a try.
///
/// Source: Clopper and Pearson 1934.
pub fn clopper_pearson(hits: usize, n: usize, confidence: f64) -> [f64; 2] {
    let half = 0.5 * (1.0 - confidence);
    // P(X ≤ k) falls as the share rises
    let share_where = |k: usize, level: f64| {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if at_most(k, n, middle) > level { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    };
    let low = if hits == 0 { 0.0 } else { share_where(hits - 1, 1.0 - half) };
    let high = if hits >= n { 1.0 } else { share_where(hits, half) };
    [low, high]
}

/// P(X ≤ k) of n tries with chance p each.
fn at_most(k: usize, n: usize, p: f64) -> f64 {
    cumulative(n, p).nth(k).unwrap_or(1.0)
}

/// P(X ≤ 0), P(X ≤ 1), … P(X ≤ n) of n tries with chance p each.
fn cumulative(n: usize, p: f64) -> impl Iterator<Item = f64> {
    let odds = (p / (1.0 - p)).ln();
    let (mut log, mut sum) = (n as f64 * (1.0 - p).ln(), 0.0);
    (0..=n).map(move |i| {
        sum += log.exp();
        log += odds + ((n - i) as f64 / (i + 1) as f64).ln();
        sum
    })
}
