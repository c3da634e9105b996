//! Points: stay at one, or jump to another.

use super::trajectory::{Curve, coordinates, within};
use autodiff::Scalar;
use base::defaults::with_defaults;
use base::error::Result;
use dynamics::spatial::{Vec3, constants};
use serde::{Deserialize, Serialize};

with_defaults! {
    /// Stay at a point.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Hover {
        /// World, m. Default (0, 0, 2).
        pub position: [f64; 3] = [0.0, 0.0, 2.0],
        /// rad. Default 0.
        pub yaw: f64 = 0.0,
    }
}

impl Curve for Hover {
    fn name(&self) -> &'static str {
        "hover"
    }

    fn description(&self) -> &'static str {
        "stay at a point"
    }

    fn validate(&self) -> Result<()> {
        coordinates("hover.position", &self.position)?;
        coordinates("hover.yaw", &[self.yaw])
    }

    #[inline]
    fn position<S: Scalar>(&self, _t: S) -> Vec3<S> {
        constants(self.position)
    }

    #[inline]
    fn yaw<S: Scalar>(&self, _t: S) -> S {
        S::constant(self.yaw)
    }
}

with_defaults! {
    /// Stay at one point, and from `time` on at another. The jump has no derivative: velocity and all above are zero on
    /// both sides, so the controller meets a pure position error.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Step {
        /// World, m. Default (0, 0, 2).
        pub from: [f64; 3] = [0.0, 0.0, 2.0],
        /// World, m. Default (1, 0, 2).
        pub to: [f64; 3] = [1.0, 0.0, 2.0],
        /// When to jump, s, > 0. Default 1.
        pub time: f64 = 1.0,
        /// rad. Default 0.
        pub yaw: f64 = 0.0,
    }
}

impl Curve for Step {
    fn name(&self) -> &'static str {
        "step"
    }

    fn description(&self) -> &'static str {
        "jump from one point to another"
    }

    fn validate(&self) -> Result<()> {
        coordinates("step.from", &self.from)?;
        coordinates("step.to", &self.to)?;
        within("step.time", &[self.time], 1e-9, 1e6)?;
        coordinates("step.yaw", &[self.yaw])
    }

    #[inline]
    fn yaw<S: Scalar>(&self, _t: S) -> S {
        S::constant(self.yaw)
    }

    fn position<S: Scalar>(&self, t: S) -> Vec3<S> {
        let before = t.lt(S::constant(self.time));
        let mut p = constants(self.to);
        for i in 0..3 {
            p[i] = S::select(before, S::constant(self.from[i]), p[i]);
        }
        p
    }
}
