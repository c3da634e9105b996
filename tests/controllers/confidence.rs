//! Bounds of shares and quantiles.

use omnidrones::controllers::{Quantile, clopper_pearson};

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
