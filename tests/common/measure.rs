//! How far numbers are from what they should be, and the assertions that say so.
#![allow(dead_code)] // each test file uses its part

/// Largest |a − b| / max(1, |b|); infinite where either is not a number.
pub fn relative(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let error = |(x, y): (&f64, &f64)| {
        let e = (x - y).abs() / y.abs().max(1.0);
        if e.is_nan() { f64::INFINITY } else { e }
    };
    a.iter().zip(b).map(error).fold(0.0, f64::max)
}

/// Asserts `value` ≤ `bound`; with `PHYSICS_PRINT=1` prints what was measured.
#[track_caller]
pub fn at_most(what: &str, value: f64, bound: f64) {
    if std::env::var_os("PHYSICS_PRINT").is_some() {
        println!("{what}: {value:.3e} of {bound:.1e}");
    }
    assert!(value <= bound, "{what}: {value:.6e}, at most {bound:.1e} allowed");
}

/// Asserts |`value` − `wanted`| ≤ `slack`; with `PHYSICS_PRINT=1` prints what was measured.
#[track_caller]
pub fn near(what: &str, value: f64, wanted: f64, slack: f64) {
    if std::env::var_os("PHYSICS_PRINT").is_some() {
        println!("{what}: {value:.9} for {wanted} ± {slack:.1e}");
    }
    assert!((value - wanted).abs() <= slack, "{what}: {value:.9}, wanted {wanted} ± {slack:.1e}");
}
