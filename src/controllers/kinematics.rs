//! What a controller sees of a vehicle.

use autodiff::Scalar;
use dynamics::spatial::{Quat, Vec3, identity};

/// Pose and velocities of the base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kinematics<S> {
    /// Of the base origin, world, m.
    pub position: Vec3<S>,
    /// Of the base origin, world, m/s.
    pub velocity: Vec3<S>,
    /// Body → world, `[w, x, y, z]`, unit.
    pub attitude: Quat<S>,
    /// Body, rad/s.
    pub angular_velocity: Vec3<S>,
}

impl<S: Scalar> Kinematics<S> {
    /// Numbers in the flat form: position, velocity, attitude, angular velocity.
    pub const DIM: usize = 13;

    /// At rest and level at `position`.
    #[inline]
    pub fn at_rest(position: Vec3<S>) -> Self {
        let zero = [S::zero(); 3];
        Self { position, velocity: zero, attitude: identity(), angular_velocity: zero }
    }

    /// Writes the flat form into the first [`Self::DIM`] numbers of `out`.
    ///
    /// # Panics
    /// If `out` is shorter than that.
    pub fn write(&self, out: &mut [S]) {
        for i in 0..3 {
            out[i] = self.position[i];
            out[3 + i] = self.velocity[i];
            out[10 + i] = self.angular_velocity[i];
        }
        for i in 0..4 {
            out[6 + i] = self.attitude[i];
        }
    }

    /// The inverse of [`write`](Self::write).
    ///
    /// # Panics
    /// If `x` is shorter than [`Self::DIM`].
    pub fn read(x: &[S]) -> Self {
        Self {
            position: [x[0], x[1], x[2]],
            velocity: [x[3], x[4], x[5]],
            attitude: [x[6], x[7], x[8], x[9]],
            angular_velocity: [x[10], x[11], x[12]],
        }
    }
}
