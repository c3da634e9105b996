//! An ellipse, level or standing, with a smooth start.

use super::circle::smooth_phase;
use super::trajectory::{Curve, coordinates, within};
use autodiff::Scalar;
use base::defaults::with_defaults;
use base::error::Result;
use dynamics::spatial::Vec3;
use serde::{Deserialize, Serialize};

with_defaults! {
    /// p = centre + R_z(ψ) (a cos φ, b sin φ, 0), or standing across the heading ψ: centre + R_z(ψ) (0, a cos φ, b sin φ); φ̇ rises from 0
    /// to `rate` within `spin_up` seconds as in a [`Circle`](super::Circle).
    ///
    /// At full rate the speed is at most `rate` times the larger half axis and the acceleration `rate`² times it. A standing
    /// ellipse lies across the heading, so that the heading has a meaning upside down too.
    ///
    /// Source: the references of Sun, Romero, Foehn, Kaufmann, Scaramuzza 2022.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Ellipse {
        /// World, m. Default (0, 0, 2).
        pub center: [f64; 3] = [0.0, 0.0, 2.0],
        /// Half axes a, b, m, ≥ 0. Default 2 and 1.
        pub half_axes: [f64; 2] = [2.0, 1.0],
        /// Final φ̇, rad/s, |φ̇| ≤ 100. Default 1.
        pub rate: f64 = 1.0,
        /// s, 0.001 to 1e6. Default 2.
        pub spin_up: f64 = 2.0,
        /// Whether it stands. Default false.
        pub standing: bool = false,
        /// ψ, rad: the heading, and where the ellipse is turned to. Default 0.
        pub yaw: f64 = 0.0,
    }
}

impl Curve for Ellipse {
    fn name(&self) -> &'static str {
        "ellipse"
    }

    fn description(&self) -> &'static str {
        "a level or standing ellipse with a smooth start"
    }

    fn validate(&self) -> Result<()> {
        coordinates("ellipse.center", &self.center)?;
        within("ellipse.half_axes", &self.half_axes, 0.0, 1e6)?;
        within("ellipse.rate", &[self.rate], -100.0, 100.0)?;
        within("ellipse.spin_up", &[self.spin_up], 1e-3, 1e6)?;
        coordinates("ellipse.yaw", &[self.yaw])
    }

    fn position<S: Scalar>(&self, t: S) -> Vec3<S> {
        let (sin, cos) = smooth_phase(self.rate, self.spin_up, t).sin_cos();
        let (first, second) = (S::constant(self.half_axes[0]) * cos, S::constant(self.half_axes[1]) * sin);
        let [x, y, z] = if self.standing { [S::zero(), first, second] } else { [first, second, S::zero()] };
        let (s, c) = self.yaw.sin_cos();
        let (s, c) = (S::constant(s), S::constant(c));
        [
            S::constant(self.center[0]) + c * x - s * y,
            S::constant(self.center[1]) + s * x + c * y,
            S::constant(self.center[2]) + z,
        ]
    }

    #[inline]
    fn yaw<S: Scalar>(&self, _t: S) -> S {
        S::constant(self.yaw)
    }
}
