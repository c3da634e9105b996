//! Roll and pitch beside a reference, for vehicles whose force does not follow their attitude.

use super::Reference;
use super::trajectory::within;
use crate::attitude::Orientation;
use autodiff::Scalar;
use autodiff::jet::Jet;
use base::error::Result;
use dynamics::spatial::{from_euler, matrix};
use serde::{Deserialize, Serialize};

/// Level until `at`, then roll and pitch, turned to within `ramp` seconds: R_d = Rz(ψ) Ry(s·pitch) Rx(s·roll) with
/// s = x³(6x² − 15x + 10), x = (t − at)/ramp within [0, 1], and ψ the yaw of the reference.
///
/// s has two continuous derivatives, so ω_d and ω̇_d are continuous. Without a ramp s jumps at `at`, where both are zero on
/// either side: the controller meets a pure attitude error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Tilt {
    /// rad, within ±π. Default 0.
    pub roll: f64,
    /// rad, within ±π/2. Default 0.
    pub pitch: f64,
    /// s, ≥ 0. Default 1.
    pub at: f64,
    /// s, ≥ 0. Default 0: a step.
    pub ramp: f64,
}

impl Default for Tilt {
    fn default() -> Self {
        Self::LEVEL
    }
}

impl Tilt {
    /// Level for ever.
    pub const LEVEL: Self = Self { roll: 0.0, pitch: 0.0, at: 1.0, ramp: 0.0 };

    /// Whether it never leaves level.
    pub fn is_level(&self) -> bool {
        self.roll == 0.0 && self.pitch == 0.0
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`](base::error::Error::Value) that names it.
    pub fn validate(&self) -> Result<()> {
        use std::f64::consts::{FRAC_PI_2, PI};
        within("tilt.roll", &[self.roll], -PI, PI)?;
        within("tilt.pitch", &[self.pitch], -FRAC_PI_2, FRAC_PI_2)?;
        within("tilt.at", &[self.at], 0.0, 1e6)?;
        within("tilt.ramp", &[self.ramp], 0.0, 1e6)
    }

    /// s at time t, s.
    fn share<S: Scalar>(&self, t: S) -> S {
        let since = t - S::constant(self.at);
        if self.ramp == 0.0 {
            return S::select(since.lt(S::zero()), S::zero(), S::one());
        }
        let x = (since * S::constant(1.0 / self.ramp)).clamp(S::zero(), S::one());
        let inner = x.mul_add(S::constant(6.0), S::constant(-15.0)).mul_add(x, S::constant(10.0));
        x * x * x * inner
    }

    /// (roll, pitch) at time t (s), rad; generic, so that a series in t gives their derivatives.
    #[inline]
    pub fn angles<S: Scalar>(&self, t: S) -> [S; 2] {
        let s = self.share(t);
        [s * S::constant(self.roll), s * S::constant(self.pitch)]
    }

    /// R_d, ω_d, ω̇_d at time t (s), with the yaw of `reference`; derivatives exact. Level, it gives way to the angles of the
    /// reference itself.
    pub fn orientation(&self, reference: &Reference, t: f64) -> Orientation<f64> {
        let own = if self.is_level() { reference.angles(t) } else { self.angles(Jet::<f64, 3>::variable(t)) };
        Orientation::of_series(matrix(from_euler(own[0], own[1], reference.yaw(t))))
    }
}
