//! The figure of eight of the paper's Track tasks.

use super::trajectory::{Curve, coordinates, within};
use crate::autodiff::Scalar;
use crate::dynamics::spatial::Vec3;
use crate::error::Result;
use serde::{Deserialize, Serialize};

/// p = origin + Rz(ψ) (S ∘ L(θ; c)), θ = π/2 + τ(w (t + t₀)).
///
/// The paper scales after rotating, which shears a rotated curve; here the scaled curve is rotated, so its shape does
/// not depend on ψ. The warp starts from rest with velocity continuous, but its second derivative jumps at t = 0 from
/// 0 to ±2w²: position and velocity are continuous there; acceleration (from 0 to w|w| Rz(ψ) (−S_x, −S_y, 0)) and all
/// above jump. Samples at t = 0 are right-hand values; for t > 0 all derivatives exist.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Lemniscate {
    /// w, rad/s, either sign, |w| ≤ 100. Default 1.
    pub rate: f64,
    /// S per axis, m, ≥ 0. Default (2.5, 2.5, 1.2).
    pub scale: [f64; 3],
    /// c, height of the curve relative to its width. Default 0.6.
    pub vertical: f64,
    /// ψ, rotation of the curve about the vertical through its origin, rad. Default 0.
    pub rotation: f64,
    /// World, m. Default (0, 0, 2).
    pub origin: [f64; 3],
    /// Yaw of the vehicle, rad. Default 0.
    pub yaw: f64,
    /// t₀, how far the path is at t = 0, s, ≥ 0. Default 0, at rest.
    pub ahead: f64,
}

impl Default for Lemniscate {
    fn default() -> Self {
        Self {
            rate: 1.0,
            scale: [2.5, 2.5, 1.2],
            vertical: 0.6,
            rotation: 0.0,
            origin: [0.0, 0.0, 2.0],
            yaw: 0.0,
            ahead: 0.0,
        }
    }
}

/// τ(w t) = sign(w) x²/(1 + x) with x = |w| max(t, 0): the phase of the paper's trajectories, from rest to rate w.
#[inline(always)]
pub fn lemniscate_phase<S: Scalar>(rate: S, t: S) -> S {
    let t = t.max(S::zero());
    let x = rate.abs() * t;
    rate * t * x * (S::one() + x).recip()
}

/// L(θ; c) = (cos θ, sin θ cos θ, c sin θ)/(1 + sin²θ), Bernoulli's lemniscate with a vertical part.
#[inline(always)]
pub fn lemniscate_curve<S: Scalar>(phase: S, vertical: S) -> Vec3<S> {
    let (s, c) = phase.sin_cos();
    let scale = (S::one() + s * s).recip();
    [c * scale, s * c * scale, vertical * s * scale]
}

impl Curve for Lemniscate {
    fn name(&self) -> &'static str {
        "lemniscate"
    }

    fn description(&self) -> &'static str {
        "a figure of eight with a vertical part (the paper's Track tasks)"
    }

    fn validate(&self) -> Result<()> {
        within("lemniscate.rate", &[self.rate], -100.0, 100.0)?;
        within("lemniscate.scale", &self.scale, 0.0, 1e6)?;
        coordinates("lemniscate.vertical", &[self.vertical])?;
        coordinates("lemniscate.rotation", &[self.rotation])?;
        coordinates("lemniscate.origin", &self.origin)?;
        coordinates("lemniscate.yaw", &[self.yaw])?;
        within("lemniscate.ahead", &[self.ahead], 0.0, 1e6)
    }

    #[inline(always)]
    fn yaw<S: Scalar>(&self, _t: S) -> S {
        S::constant(self.yaw)
    }

    #[inline(always)]
    fn position<S: Scalar>(&self, t: S) -> Vec3<S> {
        let phase = S::constant(std::f64::consts::FRAC_PI_2)
            + lemniscate_phase(S::constant(self.rate), t + S::constant(self.ahead));
        let curve = lemniscate_curve(phase, S::constant(self.vertical));
        let (x, y) = (S::constant(self.scale[0]) * curve[0], S::constant(self.scale[1]) * curve[1]);
        let (s, c) = (S::constant(self.rotation.sin()), S::constant(self.rotation.cos()));
        [
            S::constant(self.origin[0]) + (c * x - s * y),
            S::constant(self.origin[1]) + (s * x + c * y),
            S::constant(self.origin[2]) + S::constant(self.scale[2]) * curve[2],
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::super::Reference;
    use super::*;

    #[test]
    fn the_golden_values_of_the_paper_are_met() {
        let lemniscate = Lemniscate::default();
        let golden = [
            (0, 0.0, [0.0, 0.0, 2.36]),
            (5, 0.00592593, [-0.007407, -0.007407, 2.36]),
            (10, 0.02206897, [-0.027591, -0.027584, 2.36]),
            (15, 0.04645161, [-0.058106, -0.058044, 2.36]),
            (100, 0.98461538, [-1.594663, -0.882141, 2.304968]),
            (599, 8.67848224, [-1.102820, 0.809700, 1.656524]),
        ];
        for (step, phase, position) in golden {
            let t = 0.016 * f64::from(step);
            assert!((lemniscate_phase(1.0, t) - phase).abs() < 1e-8);
            let p = lemniscate.position(t);
            for i in 0..3 {
                // printed to six decimals, z of the first steps to two
                let tolerance = if i == 2 && step < 100 { 5e-3 } else { 6e-7 };
                println!("worst step {step} axis {i}: {:.1e}", (p[i] - position[i]).abs());
                assert!((p[i] - position[i]).abs() < tolerance, "step {step}: {p:?}");
            }
        }
    }

    #[test]
    fn a_rotated_lemniscate_is_the_same_curve_turned() {
        let plain = Lemniscate { scale: [3.0, 1.0, 1.2], origin: [0.0; 3], ..Lemniscate::default() };
        let turned = Lemniscate { rotation: 0.7, ..plain };
        let (p, q) = (plain.position(1.9), turned.position(1.9));
        let (s, c) = 0.7_f64.sin_cos();
        assert!((q[0] - (c * p[0] - s * p[1])).abs() < 1e-15 && (q[1] - (s * p[0] + c * p[1])).abs() < 1e-15);
    }

    #[test]
    fn velocity_is_continuous_at_the_start_and_acceleration_jumps_to_a_known_value() {
        for rate in [1.3, -1.3] {
            let reference = Reference::Lemniscate(Lemniscate { rate, ..Lemniscate::default() });
            let start = reference.sample(0.0);
            assert_eq!(start.velocity, [0.0; 3]);
            // dL/dθ at π/2 is (−½, −½, 0), so a = 2w² S ∘ (−½, −½, 0) · sign(w).
            let expected = -1.3 * 1.3 * 2.5 * rate.signum();
            for i in 0..2 {
                assert!((start.acceleration[i] - expected).abs() < 1e-12, "{:?}", start.acceleration);
            }
            let soon = reference.sample(1e-6);
            println!("worst {:.1e}", (soon.acceleration[0] - start.acceleration[0]).abs());
            // measured: 1.6e-5
            assert!((soon.acceleration[0] - start.acceleration[0]).abs() < 1e-4);
        }
    }
}
