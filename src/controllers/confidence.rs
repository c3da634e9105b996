//! How sure a count is: exact bounds of shares and of quantiles from a number of tries.

use serde::Serialize;

/// A share that was counted, and where it lies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Share {
    /// How often it was so.
    pub hits: usize,
    /// Of how many.
    pub n: usize,
    /// Where the share lies with the confidence ([`clopper_pearson`]).
    pub bounds: [f64; 2],
}

impl Share {
    /// `hits` of `n`, with a confidence as 0.95.
    pub fn counted(hits: usize, n: usize, confidence: f64) -> Self {
        Self { hits, n, bounds: clopper_pearson(hits, n, confidence) }
    }
}

/// A quantile that was met, and where it lies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantile {
    /// The least value that at least this share of all do not exceed.
    pub value: f64,
    /// Where the quantile lies with the confidence; without end where there are too few values to say.
    pub bounds: [f64; 2],
}

impl Quantile {
    /// Of `share` (0.5: the median) of values in rising order, with a confidence as 0.95. How many values lie below a quantile is
    /// binomial whatever their distribution: the bounds are the values at both ends of that count.
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

/// Where a share lies with a confidence, of which `hits` of `n` are known: the shares at which so many or more, and so few or
/// fewer, would each come with half of what is left. Exact, and never too narrow.
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

#[cfg(test)]
mod tests {
    use super::{Quantile, clopper_pearson};

    #[test]
    fn bounds_of_a_share_are_those_of_the_beta_distribution() {
        // scipy.stats.beta.ppf(0.025, k, n − k + 1), beta.ppf(0.975, k + 1, n − k)
        let cases = [
            (0, 10, [0.0, 0.308_497_107_8]),
            (8, 10, [0.443_904_537_7, 0.974_789_273_2]),
            (64, 64, [0.943_990_910_6, 1.0]),
            (990, 1000, [0.981_686_756_9, 0.995_194_489_3]),
        ];
        for (hits, n, wanted) in cases {
            let got = clopper_pearson(hits, n, 0.95);
            println!("{hits} of {n}: {got:.10?}");
            assert!((0..2).all(|k| (got[k] - wanted[k]).abs() < 1e-9), "{hits} of {n}: {got:?}");
        }
    }

    #[test]
    fn bounds_of_a_quantile_are_the_values_at_the_ends_of_a_binomial_count() {
        // ranks of the median of 100 at 95 %: 40 and 61 (Conover 1999, section 3.2); too few of 5 bound a 95th percentile
        let sorted: Vec<f64> = (1..=100).map(f64::from).collect();
        let median = Quantile::met(&sorted, 0.5, 0.95);
        println!("{median:?}");
        assert_eq!((median.value, median.bounds), (50.0, [40.0, 61.0]));
        let few = Quantile::met(&sorted[..5], 0.95, 0.95);
        assert_eq!((few.value, few.bounds[1]), (5.0, f64::INFINITY));
        assert!(Quantile::met(&[], 0.5, 0.95).value.is_nan());
    }
}
