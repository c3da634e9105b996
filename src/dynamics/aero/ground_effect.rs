//! Ground effect: a rotor near the ground pushes more for the same speed.
//!
//! T/T∞ = 1/(1 − (R/4z)²) (Cheeseman, Bennett 1955, hover, one rotor, potential flow with an image source). Measured on
//! small quadrotors the effect is somewhat larger and couples the rotors (Sánchez-Cuevas et al. 2017); this is the
//! form that needs no constant beyond the radius. It is stated for z > R/2; below it diverges.

use autodiff::Scalar;

/// T/T∞ of a rotor of `radius` (m) whose hub is `height` (m) above the ground; power and speed unchanged.
///
/// The height is held at R/2 or more, so the factor is at most 4/3, reached at z = R/2 and constant below it
/// (derivative 0, also for a hub under the ground). It falls to 1.0025 at z = 5R and on towards 1, without an edge.
/// A radius of 0 switches the effect off: exactly 1. `radius` must not be negative.
#[inline]
pub fn factor<S: Scalar>(height: S, radius: S) -> S {
    // the second floor keeps 0/0 away from a rotor without radius on the ground; it is below R/2 of any real rotor
    let z = height.max(radius * S::constant(0.5)).max(S::constant(1e-6));
    let ratio = radius * (z * S::constant(4.0)).recip();
    (S::one() - ratio * ratio).recip()
}

#[cfg(test)]
mod tests {
    use super::super::test_dual::TestDual;
    use super::*;

    #[test]
    fn factor_is_cheeseman_and_bennetts_above_half_a_radius() {
        for (z, want) in [(0.05, 4.0 / 3.0), (0.1, 16.0 / 15.0), (0.2, 64.0 / 63.0), (0.5, 400.0 / 399.0)] {
            let got = factor(z, 0.1);
            // largest difference 0
            assert!((got - want).abs() < 1e-14, "z = {z}: {got} against {want}");
        }
        assert!(factor(100.0, 0.1) - 1.0 < 1e-7);
    }

    #[test]
    fn factor_is_bounded_falls_with_height_and_has_finite_slopes_everywhere() {
        let mut last = f64::INFINITY;
        for k in -200..2000 {
            let z = f64::from(k) * 0.001;
            let f = factor(TestDual(z, 1.0), TestDual(0.1, 0.0));
            assert!(f.0 <= 4.0 / 3.0 + 1e-15 && f.0 >= 1.0 && f.0 <= last, "z = {z}: {f:?}");
            // steepest at z = R/2: −(R²/8z³)/(1 − 1/4)² = −17.8 per metre for R = 0.1
            assert!(f.1.is_finite() && f.1 <= 0.0 && f.1 > -18.0, "z = {z}: {f:?}");
            let by_radius = factor(TestDual(z, 0.0), TestDual(0.1, 1.0));
            assert!(by_radius.1.is_finite(), "z = {z}: {by_radius:?}");
            last = f.0;
        }
    }

    #[test]
    fn a_rotor_without_radius_feels_no_ground() {
        for z in [-1.0, 0.0, 1e-9, 1.0] {
            let f = factor(TestDual(z, 1.0), TestDual(0.0, 0.0));
            assert_eq!((f.0, f.1), (1.0, 0.0));
        }
    }

    #[test]
    fn slope_is_that_of_central_differences() {
        for z in [0.06, 0.1, 0.3, 1.0] {
            let h = 1e-6;
            let central = (factor(z + h, 0.1) - factor(z - h, 0.1)) / (2.0 * h);
            let exact = factor(TestDual(z, 1.0), TestDual(0.1, 0.0)).1;
            // largest difference 8e-9 of 8.5, by truncation
            assert!((exact - central).abs() < 1e-7 * exact.abs().max(1.0), "z = {z}: {exact} against {central}");
        }
    }
}
