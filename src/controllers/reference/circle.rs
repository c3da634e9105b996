//! A horizontal circle with a smooth start.

use super::trajectory::{Curve, coordinates, within};
use autodiff::Scalar;
use base::defaults::with_defaults;
use base::error::Result;
use dynamics::spatial::Vec3;
use serde::{Deserialize, Serialize};

with_defaults! {
    /// p = centre + r (cos φ, sin φ, 0), φ̇ rising from 0 to `rate` within `spin_up` seconds along the smooth step
    /// 35x⁴ − 84x⁵ + 70x⁶ − 20x⁷ (three zero derivatives at either end), so that snap is continuous everywhere.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Circle {
        /// World, m. Default (0, 0, 2).
        pub center: [f64; 3] = [0.0, 0.0, 2.0],
        /// r, m, ≥ 0. Default 2.
        pub radius: f64 = 2.0,
        /// Final φ̇, rad/s, counter-clockwise from above where positive, |φ̇| ≤ 100. Default 1.
        pub rate: f64 = 1.0,
        /// s, 0.001 to 1e6. Default 2.
        pub spin_up: f64 = 2.0,
        /// Yaw, rad; relative to the direction of flight where `along_path`. Default 0.
        pub yaw: f64 = 0.0,
        /// Whether the heading turns with the direction of flight. Default false.
        pub along_path: bool = false,
        /// How far the path is at t = 0, s, ≥ 0: from `spin_up` on at its full rate. Default 0, at rest.
        pub ahead: f64 = 0.0,
    }
}

/// φ(t): the integral of the smooth step from 0 to `rate` within T = `spin_up`, ω T (7x⁵ − 14x⁶ + 10x⁷ − 2.5x⁸) with x = t/T, then
/// ω (t − T/2).
pub(super) fn smooth_phase<S: Scalar>(rate: f64, spin_up: f64, t: S) -> S {
    let t = t.max(S::zero());
    let end = S::constant(spin_up);
    let x = t * end.recip();
    let p = x.mul_add(S::constant(-2.5), S::constant(10.0));
    let p = x.mul_add(p, S::constant(-14.0));
    let p = x.mul_add(p, S::constant(7.0));
    let x2 = x * x;
    let starting = end * (x2 * x2 * x * p);
    let steady = t - S::constant(0.5) * end;
    S::constant(rate) * S::select(t.lt(end), starting, steady)
}

impl Circle {
    /// φ(t + ahead).
    #[inline]
    fn phase<S: Scalar>(&self, t: S) -> S {
        smooth_phase(self.rate, self.spin_up, t.max(S::zero()) + S::constant(self.ahead))
    }
}

impl Curve for Circle {
    fn name(&self) -> &'static str {
        "circle"
    }

    fn description(&self) -> &'static str {
        "a horizontal circle with a smooth start"
    }

    fn validate(&self) -> Result<()> {
        coordinates("circle.center", &self.center)?;
        within("circle.radius", &[self.radius], 0.0, 1e6)?;
        within("circle.rate", &[self.rate], -100.0, 100.0)?;
        within("circle.spin_up", &[self.spin_up], 1e-3, 1e6)?;
        coordinates("circle.yaw", &[self.yaw])?;
        within("circle.ahead", &[self.ahead], 0.0, 1e6)
    }

    fn position<S: Scalar>(&self, t: S) -> Vec3<S> {
        let (s, c) = self.phase(t).sin_cos();
        let r = S::constant(self.radius);
        [
            r.mul_add(c, S::constant(self.center[0])),
            r.mul_add(s, S::constant(self.center[1])),
            S::constant(self.center[2]),
        ]
    }

    #[inline]
    fn yaw<S: Scalar>(&self, t: S) -> S {
        let fixed = S::constant(self.yaw);
        if !self.along_path {
            return fixed;
        }
        fixed + self.phase(t) + S::constant(std::f64::consts::FRAC_PI_2.copysign(self.rate))
    }
}
