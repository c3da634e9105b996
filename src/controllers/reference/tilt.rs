//! Roll and pitch beside a reference, for vehicles whose force does not follow their attitude.

use super::Reference;
use super::trajectory::within;
use crate::autodiff::Scalar;
use crate::autodiff::jet::Jet;
use crate::controllers::attitude::Orientation;
use crate::dynamics::spatial::{from_euler, matrix};
use crate::error::Result;
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
    /// [`Error::Value`](crate::error::Error::Value) that names it.
    pub fn validate(&self) -> Result<()> {
        use std::f64::consts::{FRAC_PI_2, PI};
        within("tilt.roll", &[self.roll], -PI, PI)?;
        within("tilt.pitch", &[self.pitch], -FRAC_PI_2, FRAC_PI_2)?;
        within("tilt.at", &[self.at], 0.0, 1e6)?;
        within("tilt.ramp", &[self.ramp], 0.0, 1e6)
    }

    /// s at time t, s.
    #[inline(always)]
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
    #[inline(always)]
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

#[cfg(test)]
mod tests {
    use super::super::Circle;
    use super::*;
    use crate::dynamics::spatial::{Vec3, mat_mul, transpose};

    /// (RᵀṘ)^∨ by central differences.
    fn turning(tilt: &Tilt, reference: &Reference, t: f64, h: f64) -> Vec3<f64> {
        let [a, r, b] = [t - h, t, t + h].map(|t| tilt.orientation(reference, t).attitude);
        let (back, ahead) = (mat_mul(transpose(r), a), mat_mul(transpose(r), b));
        [(2, 1), (0, 2), (1, 0)].map(|(i, j)| (ahead[i][j] - back[i][j]) / (2.0 * h))
    }

    #[test]
    fn rates_and_accelerations_of_a_ramp_agree_with_central_differences() {
        let tilt = Tilt { roll: 1.1, pitch: -0.7, at: 0.4, ramp: 1.5 };
        let reference = Reference::Circle(Circle { along_path: true, ..Circle::default() });
        let h = 1e-4;
        let (mut worst, mut fastest) = (0.0_f64, 0.0_f64);
        for t in [0.2, 0.7, 1.1, 1.6, 1.85, 2.5] {
            let exact = tilt.orientation(&reference, t);
            let rates = turning(&tilt, &reference, t, h);
            let [a, b] = [t - h, t + h].map(|t| tilt.orientation(&reference, t).angular_velocity);
            for i in 0..3 {
                fastest = fastest.max(exact.angular_velocity[i].abs());
                worst = worst.max((rates[i] - exact.angular_velocity[i]).abs());
                worst = worst.max(((b[i] - a[i]) / (2.0 * h) - exact.angular_acceleration[i]).abs());
            }
        }
        println!("worst {worst:.1e}, fastest {fastest:.2}");
        // measured: 1.4e-7, the differences' own error, at rates up to 1.55 rad/s
        assert!(worst < 1e-6 && fastest > 1.0, "{worst:e}");
    }

    #[test]
    fn a_step_is_level_before_and_still_after() {
        let (tilt, hover) = (Tilt { roll: 0.5, ..Tilt::default() }, Reference::Hover(Default::default()));
        let (before, after) = (tilt.orientation(&hover, 0.999), tilt.orientation(&hover, 1.0));
        assert_eq!(before.attitude, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        assert!((after.attitude[2][1] - 0.5_f64.sin()).abs() < 1e-15);
        assert_eq!((after.angular_velocity, after.angular_acceleration), ([0.0; 3], [0.0; 3]));
    }

    #[test]
    fn bad_tilts_are_named() {
        let text = Tilt { pitch: 1.7, ..Tilt::default() }.validate().unwrap_err().to_string();
        assert!(text.starts_with("tilt.pitch is 1.7"), "{text}");
        assert!(Tilt { ramp: -1.0, ..Tilt::default() }.validate().is_err());
    }
}
