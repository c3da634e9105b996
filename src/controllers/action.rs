//! The action modes of the paper: numbers in [−1, 1] → commands, clipped.

use super::attitude::AttitudeCommand;
use super::rate::RateCommand;
use super::reference::Setpoint;
use super::velocity::VelocityCommand;
use autodiff::Scalar;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use dynamics::spatial::{Quat, Vec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_3, PI};

with_defaults! {
    /// What an action of 1 means. Actions are clipped to [−1, 1] first (the paper leaves them unbounded); NaN stays NaN,
    /// for the environment to contain.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ActionScale {
        /// Offset of the target from the present position in position mode, per axis, m; (0, 1000]. Default 1.
        pub position: f64 = 1.0,
        /// Velocity per axis, m/s; (0, 1000]. Default 1, as in the paper; the path of Track runs at up to 3.5 m/s, beyond what that
        /// commands.
        pub velocity: f64 = 1.0,
        /// Yaw in velocity and position mode, rad; (0, 1000]. Default π, as in the paper.
        pub yaw: f64 = PI,
        /// Body rates in rate mode, rad/s; (0, 1000]. Default π, as in the paper.
        pub rate: f64 = PI,
        /// Yaw rate in attitude mode, rad/s; (0, 1000]. Default π, as in the paper.
        pub yaw_rate: f64 = PI,
        /// Roll and pitch in attitude mode, rad; (0, 1.5]. Default π/3; the paper's π asks for flight upside down.
        pub tilt: f64 = FRAC_PI_3,
    }
}

#[inline]
fn clip<S: Scalar>(a: S) -> S {
    a.clamp(-S::one(), S::one())
}

/// (a + 1)/2 of the total thrust.
#[inline]
fn thrust<S: Scalar>(a: S, total: S) -> S {
    S::constant(0.5) * (clip(a) + S::one()) * total
}

impl ActionScale {
    /// Checks that every scale is within (0, 1000], and the tilt within (0, 1.5] rad.
    ///
    /// # Errors
    /// [`Error::Value`] that names the first outside.
    pub fn validate(&self) -> Result<()> {
        let rows = [
            ("action_scale.position", self.position, 1e3),
            ("action_scale.velocity", self.velocity, 1e3),
            ("action_scale.yaw", self.yaw, 1e3),
            ("action_scale.rate", self.rate, 1e3),
            ("action_scale.yaw_rate", self.yaw_rate, 1e3),
            ("action_scale.tilt", self.tilt, 1.5),
        ];
        for (what, value, most) in rows {
            if !(value > 0.0 && value <= most) {
                return Err(Error::value(what, value, format!("within (0, {most}]"), "Leave it out for the default."));
            }
        }
        Ok(())
    }

    /// Position mode: [Δx, Δy, Δz, ψ], world: a point at rest beside `position` (world, m), p + Δ · `self.position`, at yaw ψ · `self.yaw`.
    pub fn position<S: Scalar>(&self, action: [S; 4], position: Vec3<S>) -> Setpoint<S> {
        let (o, zero, p) = (S::zero(), [S::zero(); 3], S::constant(self.position));
        let mut target = position;
        for i in 0..3 {
            target[i] = clip(action[i]).mul_add(p, position[i]);
        }
        let yaw = clip(action[3]) * S::constant(self.yaw);
        Setpoint {
            position: target,
            velocity: zero,
            acceleration: zero,
            jerk: zero,
            snap: zero,
            yaw,
            yaw_rate: o,
            yaw_acceleration: o,
        }
    }

    /// Velocity mode: [v_x, v_y, v_z, ψ], world, each times its scale; no feed-forward.
    #[inline]
    pub fn velocity<S: Scalar>(&self, action: [S; 4]) -> VelocityCommand<S> {
        let v = S::constant(self.velocity);
        VelocityCommand::constant(
            [clip(action[0]) * v, clip(action[1]) * v, clip(action[2]) * v],
            clip(action[3]) * S::constant(self.yaw),
        )
    }

    /// Rate mode: [ω_x, ω_y, ω_z, thrust], body, rates times `self.rate`; thrust (a + 1)/2 · `total_thrust` (N).
    #[inline]
    pub fn rate<S: Scalar>(&self, action: [S; 4], total_thrust: S) -> RateCommand<S> {
        let w = S::constant(self.rate);
        RateCommand::constant(
            thrust(action[3], total_thrust),
            [clip(action[0]) * w, clip(action[1]) * w, clip(action[2]) * w],
        )
    }

    /// Attitude mode: [thrust, yaw rate, roll, pitch]; thrust (a + 1)/2 · `total_thrust` (N). The heading is that of
    /// `attitude`, see [`AttitudeCommand::from_tilt`].
    pub fn attitude<S: Scalar>(&self, action: [S; 4], total_thrust: S, attitude: Quat<S>) -> AttitudeCommand<S> {
        let tilt = S::constant(self.tilt);
        AttitudeCommand::from_tilt(
            thrust(action[0], total_thrust),
            clip(action[1]) * S::constant(self.yaw_rate),
            clip(action[2]) * tilt,
            clip(action[3]) * tilt,
            attitude,
        )
    }
}
