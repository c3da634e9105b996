//! How far numbers are from what they should be, and the assertions that say so.
#![allow(dead_code)] // each test file uses its part

/// The larger one; infinite where either is not a number, which `f64::max` leaves out: what has exploded would measure nothing.
pub fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::INFINITY } else { a.max(b) }
}

/// Largest |a − b| / max(1, |b|); infinite where either is not a number.
pub fn relative(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(x, y)| (x - y).abs() / y.abs().max(1.0)).fold(0.0, larger)
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
