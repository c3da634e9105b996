//! Downwash: the wake of a vehicle pushes those below it along the wake.
//!
//! With separation d = p_j − p_i from the affected vehicle i to the source j, thrust vector T_j (world) and its
//! direction T̂: z = d·T̂, r = ‖d − z T̂‖,
//!
//! a = exp(−½ (k_r r/z)²)/(1 + k_z z)², force on i: F = −a T_j (OmniDrones `multirotor.py`; k_r 2, k_z 0.3).
//!
//! On what has no rotors the force is F = −a T_j S/A with S the area that faces the wake and A that of the source's rotors, S/A at
//! most 1: by momentum theory the far wake is twice as fast as the air in the discs, v = 2 v_i with T = 2 ρ A v_i², so its dynamic
//! pressure ½ ρ v² is T/A, and a bluff body's drag coefficient is taken as 1. The effect `load_downwash`, *our model*.
//!
//! A cone that widens with z and weakens as a jet does. As published it is 0/0 on the rotor plane's axis and jumps
//! there from 1 to 0; since no two vehicles can be that close, the last `NEAR` metres below the source fade it in
//! smoothly, and at z ≥ `NEAR` it is the published formula to rounding.

use crate::spatial::{Vec3, dot, scale, sub};
use autodiff::{Scalar, safe};

/// Depth over which the wake fades in below its source, m.
pub(crate) const NEAR: f64 = 0.05;
/// OmniDrones' k_r: how narrow the cone is.
pub(crate) const DEFAULT_RADIAL: f64 = 2.0;
/// OmniDrones' k_z for its vehicles, 1/m: how fast the wake weakens.
pub(crate) const DEFAULT_AXIAL: f64 = 0.3;

/// Fraction a ∈ [0, 1] of the source's thrust felt by a vehicle `separation` = p_source − p_affected away, m.
///
/// `thrust_direction` is the unit direction of the source's thrust. Zero at and above the source's plane, with zero
/// slope; continuously differentiable everywhere, coincident vehicles included. `k_z` ≥ 0.
pub fn factor<S: Scalar>(separation: Vec3<S>, thrust_direction: Vec3<S>, k_r: S, k_z: S) -> S {
    let (zero, one) = (S::zero(), S::one());
    let along = dot(separation, thrust_direction);
    let across = sub(separation, scale(along, thrust_direction));
    let z = along.max(zero);
    // smoothstep 3t² − 2t³ over 0 ≤ z ≤ NEAR, and what it lacks to 1
    let t = (z * S::constant(1.0 / NEAR)).min(one);
    let gate = t * t * (S::constant(3.0) - t - t);
    let missing = (one - gate) * S::constant(NEAR);
    // z² below the fade, never smaller than about NEAR²/4 within it
    let spread = z.mul_add(z, missing * missing);
    let exponent = k_r * k_r * safe::squared_norm(across) * spread.recip() * S::constant(-0.5);
    // e⁻⁸⁰ is nothing and still a normal number in f32
    let cone = exponent.max(S::constant(-80.0)).exp();
    let fade = (k_z.mul_add(z, one)).square();
    gate * cone * fade.recip()
}

/// Force on the affected vehicle, N, world: −a T_j for a source with thrust vector `thrust` = T_j (world, N).
///
/// A source without thrust gives none.
#[inline]
pub fn force<S: Scalar>(separation: Vec3<S>, thrust: Vec3<S>, k_r: S, k_z: S) -> Vec3<S> {
    let a = factor(separation, safe::normalise(thrust), k_r, k_z);
    scale(-a, thrust)
}

#[cfg(test)]
mod tests {
    use super::super::test_dual::TestDual;
    use super::*;

    const UP: Vec3<f64> = [0.0, 0.0, 1.0];

    fn at(z: f64, r: f64) -> f64 {
        factor([r * 0.6, r * 0.8, z], UP, DEFAULT_RADIAL, DEFAULT_AXIAL)
    }

    #[test]
    fn factor_has_the_golden_values_of_omnidrones() {
        for (z, r, want) in [(1.0, 0.0, 0.591716), (1.0, 0.2, 0.546223), (0.5, 0.3, 0.368055)] {
            // largest difference 4e-7: the golden values have six digits
            assert!((at(z, r) - want).abs() < 6e-7, "({z}, {r}): {} against {want}", at(z, r));
        }
    }

    #[test]
    fn factor_is_the_published_formula_below_the_fade() {
        for k in 0..200 {
            let (z, r) = (NEAR + 0.01 * f64::from(k), 0.004 * f64::from(k));
            let want = (-0.5 * (2.0 * r / z).powi(2)).exp() / (1.0 + 0.3 * z).powi(2);
            // largest relative difference 2.2e-16
            assert!((at(z, r) - want).abs() < 1e-14 * want, "({z}, {r}): {} against {want}", at(z, r));
        }
    }

    #[test]
    fn nothing_is_felt_beside_or_above_the_source() {
        for (z, r) in [(0.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (-1.0, 0.5)] {
            assert_eq!(at(z, r), 0.0);
        }
        assert_eq!(force([0.0, 0.0, 1.0], [0.0; 3], 2.0, 0.3), [0.0; 3]);
    }

    #[test]
    fn force_pushes_against_the_sources_thrust_whatever_its_direction() {
        let thrust = [3.0, 0.0, 4.0];
        let f = force([0.6, 0.0, 0.8], thrust, 2.0, 0.3);
        let a = 1.0 / 1.69;
        for k in 0..3 {
            assert!((f[k] + a * thrust[k]).abs() < 1e-14, "{f:?}");
        }
    }

    #[test]
    fn value_and_slope_are_finite_and_continuous_everywhere_even_for_coincident_vehicles() {
        let heights = [-1e3, -1.0, -1e-9, -0.0, 0.0, 1e-300, 1e-12, 1e-6, 1e-3, 0.02, NEAR, 0.3, 10.0, 1e6];
        let offsets = [0.0, 1e-300, 1e-12, 1e-6, 1e-3, 0.1, 1.0, 1e3, 1e8];
        for z in heights {
            for x in offsets {
                for direction in 0..3 {
                    let d = |i: usize| if i == direction { 1.0 } else { 0.0 };
                    let separation = [TestDual(x, d(0)), TestDual(0.0, d(1)), TestDual(z, d(2))];
                    let thrust = [TestDual(0.0, 0.0), TestDual(0.0, 0.0), TestDual(5.0, 0.0)];
                    let f = force(separation, thrust, TestDual(2.0, 0.0), TestDual(0.3, 0.0));
                    for part in f {
                        // steepest 141 N/m, in the fade: about 5 N · 1.5/NEAR
                        assert!(part.0.is_finite() && part.1.is_finite() && part.1.abs() < 200.0, "({z}, {x}): {f:?}");
                    }
                }
            }
        }
        // no jump between neighbours 1e-5 apart on a path through source plane, fade and cone
        for x in [0.0, 0.01, 0.05] {
            for k in -2000..20_000 {
                let z = f64::from(k) * 1e-5;
                let jump = (at(z + 1e-5, x) - at(z, x)).abs();
                // largest 2.9e-4, the slope of the fade
                assert!(jump < 5e-4, "({z}, {x}): {jump}");
            }
        }
    }

    #[test]
    fn a_source_losing_its_thrust_has_finite_slopes() {
        for direction in 0..3 {
            let d = |i: usize| if i == direction { 1.0 } else { 0.0 };
            let thrust = [TestDual(0.0, d(0)), TestDual(0.0, d(1)), TestDual(0.0, d(2))];
            for separation in [[0.0; 3], [0.1, 0.2, 1.0]] {
                let f = force(separation.map(|x| TestDual(x, 0.0)), thrust, TestDual(2.0, 0.0), TestDual(0.3, 0.0));
                assert!(f.iter().all(|f| f.0 == 0.0 && f.1.is_finite()), "{f:?}");
            }
        }
    }

    #[test]
    fn slope_is_that_of_central_differences() {
        for (z, x) in [(0.01, 0.0), (0.03, 0.02), (0.2, 0.1), (1.0, 0.5)] {
            let h = 1e-6;
            let exact = factor(
                [TestDual(x, 0.0), TestDual(0.0, 0.0), TestDual(z, 1.0)],
                UP.map(|u| TestDual(u, 0.0)),
                TestDual(2.0, 0.0),
                TestDual(0.3, 0.0),
            )
            .1;
            let value = |z: f64| factor([x, 0.0, z], UP, 2.0, 0.3);
            let central = (value(z + h) - value(z - h)) / (2.0 * h);
            assert!((exact - central).abs() < 1e-6 * exact.abs().max(1.0), "({z}, {x}): {exact} against {central}");
        }
    }
}
