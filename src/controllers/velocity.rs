//! Velocity level: velocity command → thrust, attitude and their feed-forward.

use super::attitude::{AttitudeCommand, Orientation};
use super::kinematics::Kinematics;
use super::parameters::{BodyModel, ForceLimits, GainSet};
use super::reference::Setpoint;
use autodiff::jet::Jet;
use autodiff::{Scalar, safe};
use dynamics::spatial::{Mat3, Vec3, cross, dot, up_axis};

/// What the velocity level is asked for; world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VelocityCommand<S> {
    /// m/s.
    pub velocity: Vec3<S>,
    /// Feed-forward, m/s².
    pub acceleration: Vec3<S>,
    /// Feed-forward, m/s³.
    pub jerk: Vec3<S>,
    /// Feed-forward, m/s⁴.
    pub snap: Vec3<S>,
    /// rad.
    pub yaw: S,
    /// rad/s.
    pub yaw_rate: S,
    /// rad/s².
    pub yaw_acceleration: S,
}

impl<S: Scalar> VelocityCommand<S> {
    /// Along a reference, as if there were no error.
    pub(super) fn along(sample: &Setpoint<S>) -> Self {
        Self {
            velocity: sample.velocity,
            acceleration: sample.acceleration,
            jerk: sample.jerk,
            snap: sample.snap,
            yaw: sample.yaw,
            yaw_rate: sample.yaw_rate,
            yaw_acceleration: sample.yaw_acceleration,
        }
    }

    /// A wanted force f(t) per mass, m/s², whose derivatives are this command's jerk and snap.
    #[inline]
    pub(super) fn force_series(&self, force: Vec3<S>) -> Vec3<Jet<S, 3>> {
        let mut series = [Jet::<S, 3>::fixed(force[0]); 3];
        for i in 0..3 {
            series[i] = Jet::from_derivatives([force[i], self.jerk[i], self.snap[i]]);
        }
        series
    }

    /// ψ(t), rad.
    #[inline]
    pub(super) fn yaw_series(&self) -> Jet<S, 3> {
        Jet::from_derivatives([self.yaw, self.yaw_rate, self.yaw_acceleration])
    }

    /// A constant velocity (m/s) at a constant yaw (rad), without feed-forward.
    #[inline]
    pub fn constant(velocity: Vec3<S>, yaw: S) -> Self {
        let (o, zero) = (S::zero(), [S::zero(); 3]);
        Self { velocity, acceleration: zero, jerk: zero, snap: zero, yaw, yaw_rate: o, yaw_acceleration: o }
    }
}

/// f = a_ref + K_v (v_cmd − v) + g e_z, the wanted force per mass, world, m/s².
pub fn specific_force<S: Scalar>(
    gains: &GainSet<S>,
    gravity: S,
    command: &VelocityCommand<S>,
    velocity: Vec3<S>,
) -> Vec3<S> {
    let mut f = command.acceleration;
    f[2] += gravity;
    for i in 0..3 {
        f[i] = gains.velocity[i].mul_add(command.velocity[i] - velocity[i], f[i]);
    }
    f
}

/// The nearest force the limits allow, height before direction: first the vertical part is held within `vertical`, least
/// and most, then the horizontal part is shortened to the tilt limit and to what the largest norm leaves. Specific forces,
/// world, m/s². Inside the limits the input comes back unchanged.
pub fn limit_force<S: Scalar>(f: Vec3<S>, tilt_tangent: S, vertical: [S; 2], largest: S) -> Vec3<S> {
    let z = f[2].clamp(vertical[0], vertical[1]);
    let tilt = z * tilt_tangent;
    let room = (largest * largest - z * z).min(tilt * tilt);
    let horizontal = f[0].mul_add(f[0], f[1] * f[1]);
    let over = room.lt(horizontal);
    let denominator = S::select(over, horizontal, S::one());
    let shorten = S::select(over, safe::sqrt(room * denominator.recip(), safe::SQUARED_NORM_FLOOR), S::one());
    [f[0] * shorten, f[1] * shorten, z]
}

/// R_d of a wanted force and yaw: b₃ = f/‖f‖, b₁c = (cos ψ, sin ψ, 0), b₂ = b₃×b₁c/‖·‖, R_d = [b₂×b₃, b₂, b₃] by
/// columns. Undefined where f is horizontal along b₁c; the tilt limit keeps away from it.
///
/// Source: Mellinger and Kumar 2011, section III; Lee, Leok and McClamroch 2010, eq. 22.
#[inline]
pub fn desired_attitude<S: Scalar>(force: Vec3<S>, yaw: S) -> Mat3<S> {
    let b3 = safe::normalise(force);
    let (s, c) = yaw.sin_cos();
    let b2 = safe::normalise([-(b3[2] * s), b3[2] * c, b3[0].mul_add(s, -(b3[1] * c))]);
    let b1 = cross(b2, b3);
    [[b1[0], b2[0], b3[0]], [b1[1], b2[1], b3[1]], [b1[2], b2[2], b3[2]]]
}

/// Thrust T = m f·(R e_z), R_d, and the rates ω_d, ω̇_d with which R_d turns while f follows its jerk and snap.
///
/// f(t) and ψ(t) are carried as second-order series through limits and axes, so that ω_d = (R_dᵀṘ_d)^∨ and ω̇_d are
/// exact, also where a limit acts. ḟ and f̈ are the reference's jerk and snap: the derivative of the error terms would
/// need the measured acceleration (differential flatness, Mellinger and Kumar 2011).
pub fn attitude_command<S: Scalar>(
    gains: &GainSet<S>,
    body: &BodyModel<S>,
    limits: &ForceLimits<S>,
    command: &VelocityCommand<S>,
    state: &Kinematics<S>,
) -> AttitudeCommand<S> {
    let series = command.force_series(specific_force(gains, body.gravity, command, state.velocity));
    let largest = limits.force * body.mass.recip();
    let vertical = [Jet::fixed(limits.vertical), Jet::fixed(limits.ceiling * largest)];
    let series = limit_force(series, Jet::fixed(limits.tilt_tangent), vertical, Jet::fixed(largest));
    let r = desired_attitude(series, command.yaw_series());
    let force = [series[0].value(), series[1].value(), series[2].value()];
    let thrust = body.mass * dot(force, up_axis(state.attitude));
    Orientation::of_series(r).with_thrust(thrust.clamp(S::zero(), limits.thrust))
}
