//! Where a body is and how it moves, as tasks and controllers see it.

use super::spatial::{Quat, Vec3, add, cross, rotate, up_axis};
use autodiff::{Array, Scalar, safe};

/// Numbers of a frame: position, velocity, attitude, angular velocity.
pub const FRAME: usize = 13;

/// Motion of a body's origin along world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame<S> {
    /// m, world.
    pub position: Vec3<S>,
    /// m/s, world.
    pub velocity: Vec3<S>,
    /// `[w, x, y, z]`, body → world.
    pub attitude: Quat<S>,
    /// rad/s, along **world** axes.
    pub angular_velocity: Vec3<S>,
}

impl<S: Scalar> Frame<S> {
    /// Of a vehicle alone, from the first 13 numbers of its state, whose angular velocity is along body axes.
    #[inline]
    pub fn of_vehicle(state: &[S]) -> Self {
        let mut frame = Self::read(state);
        frame.angular_velocity = rotate(frame.attitude, frame.angular_velocity);
        frame
    }

    /// From the first 13 numbers of a slice: position, velocity, attitude, angular velocity.
    ///
    /// # Panics
    /// If there are fewer.
    #[inline]
    pub fn read(x: &[S]) -> Self {
        Self { position: x.array(0), velocity: x.array(3), attitude: x.array(6), angular_velocity: x.array(10) }
    }

    /// As 13 numbers in the order of [`read`](Self::read), as far as the slice reaches.
    #[inline]
    pub fn write(&self, out: &mut [S]) {
        let parts: [&[S]; 4] = [&self.position, &self.velocity, &self.attitude, &self.angular_velocity];
        out.iter_mut().zip(parts.into_iter().flatten()).for_each(|(out, number)| *out = *number);
    }

    /// Position (m) and velocity (m/s) of the point `local` (m, body) that is fixed in the body, world: p + R r, v + ω × R r.
    #[inline]
    pub fn point(&self, local: Vec3<S>) -> (Vec3<S>, Vec3<S>) {
        let lever = rotate(self.attitude, local);
        (add(self.position, lever), add(self.velocity, cross(self.angular_velocity, lever)))
    }

    /// Body x along world axes, R e_x.
    #[inline]
    pub fn heading(&self) -> Vec3<S> {
        let [w, x, y, z] = self.attitude;
        let (one, two) = (S::one(), S::constant(2.0));
        [one - two * y.mul_add(y, z * z), two * x.mul_add(y, w * z), two * x.mul_add(z, -(w * y))]
    }

    /// Body z along world axes, R e_z.
    #[inline]
    pub fn up(&self) -> Vec3<S> {
        up_axis(self.attitude)
    }

    /// Angle of the [heading](Self::heading) in the world's xy plane, rad, in (−π, π]; 0 where body x is vertical.
    #[inline]
    pub fn yaw(&self) -> S {
        let [x, y, _] = self.heading();
        safe::atan2(y, x)
    }

    /// The attitude with w ≥ 0: q and −q are one attitude, an observation should not say which.
    pub fn observed_attitude(&self) -> Quat<S> {
        let flip = self.attitude[0].lt(S::zero());
        let mut q = self.attitude;
        for i in 0..4 {
            q[i] = S::select(flip, -q[i], q[i]);
        }
        q
    }
}
