//! The figure of eight of the paper's Track tasks.

use super::trajectory::{Curve, coordinates, within};
use autodiff::Scalar;
use base::defaults::with_defaults;
use base::error::Result;
use dynamics::spatial::Vec3;
use serde::{Deserialize, Serialize};

with_defaults! {
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
        pub rate: f64 = 1.0,
        /// S per axis, m, ≥ 0. Default (2.5, 2.5, 1.2).
        pub scale: [f64; 3] = [2.5, 2.5, 1.2],
        /// c, height of the curve relative to its width. Default 0.6.
        pub vertical: f64 = 0.6,
        /// ψ, rotation of the curve about the vertical through its origin, rad. Default 0.
        pub rotation: f64 = 0.0,
        /// World, m. Default (0, 0, 2).
        pub origin: [f64; 3] = [0.0, 0.0, 2.0],
        /// Yaw of the vehicle, rad. Default 0.
        pub yaw: f64 = 0.0,
        /// t₀, how far the path is at t = 0, s, ≥ 0. Default 0, at rest.
        pub ahead: f64 = 0.0,
    }
}

/// τ(w t) = sign(w) x²/(1 + x) with x = |w| max(t, 0): the phase of the paper's trajectories, from rest to rate w.
#[inline]
pub fn lemniscate_phase<S: Scalar>(rate: S, t: S) -> S {
    let t = t.max(S::zero());
    let x = rate.abs() * t;
    rate * t * x * (S::one() + x).recip()
}

/// L(θ; c) = (cos θ, sin θ cos θ, c sin θ)/(1 + sin²θ), Bernoulli's lemniscate with a vertical part.
#[inline]
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

    #[inline]
    fn yaw<S: Scalar>(&self, _t: S) -> S {
        S::constant(self.yaw)
    }

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
