//! Rate level: body rates → moments.

use super::parameters::GainSet;
use autodiff::Scalar;
use dynamics::spatial::{Mat3, Vec3, add, cross, mat_vec};

/// What the rate level is asked for; body frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RateCommand<S> {
    /// Total thrust along body z, N.
    pub thrust: S,
    /// rad/s.
    pub angular_velocity: Vec3<S>,
    /// Feed-forward, rad/s².
    pub angular_acceleration: Vec3<S>,
}

impl<S: Scalar> RateCommand<S> {
    /// Numbers in the flat form: thrust, ω, ω̇.
    pub const DIM: usize = 7;

    /// Constant rates, rad/s, under a total thrust along body z, N.
    #[inline]
    pub fn constant(thrust: S, angular_velocity: Vec3<S>) -> Self {
        Self { thrust, angular_velocity, angular_acceleration: [S::zero(); 3] }
    }

    /// Writes the flat form into the first [`Self::DIM`] numbers of `out`.
    ///
    /// # Panics
    /// If `out` is shorter than that.
    #[inline]
    pub fn write(&self, out: &mut [S]) {
        out[0] = self.thrust;
        for i in 0..3 {
            out[1 + i] = self.angular_velocity[i];
            out[4 + i] = self.angular_acceleration[i];
        }
    }

    /// The inverse of [`write`](Self::write).
    ///
    /// # Panics
    /// If `x` is shorter than [`Self::DIM`].
    #[inline]
    pub fn read(x: &[S]) -> Self {
        Self { thrust: x[0], angular_velocity: [x[1], x[2], x[3]], angular_acceleration: [x[4], x[5], x[6]] }
    }
}

/// M = −K_ω(ω − ω_cmd) + ω × Jω + J α_ff, body, N m, with the full inertia matrix.
pub fn moment<S: Scalar>(
    gains: &GainSet<S>,
    inertia: Mat3<S>,
    command: &RateCommand<S>,
    angular_velocity: Vec3<S>,
) -> Vec3<S> {
    let gyroscopic = cross(angular_velocity, mat_vec(inertia, angular_velocity));
    let mut m = add(gyroscopic, mat_vec(inertia, command.angular_acceleration));
    for i in 0..3 {
        m[i] = gains.rate[i].mul_add(command.angular_velocity[i] - angular_velocity[i], m[i]);
    }
    m
}
