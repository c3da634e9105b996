//! Where a body is and how it moves, as tasks and controllers see it.

use super::spatial::{Quat, Vec3, add, cross, rotate, up_axis};
use crate::autodiff::unrolled::unrolled;
use crate::autodiff::{Scalar, StridedView, StridedWriter, safe};

/// Numbers of a frame: position, velocity, attitude, angular velocity.
pub const FRAME: usize = 13;

/// Motion of a body's origin along world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame<S> {
    /// m.
    pub position: Vec3<S>,
    /// m/s.
    pub velocity: Vec3<S>,
    /// Body → world.
    pub attitude: Quat<S>,
    /// rad/s, along **world** axes.
    pub angular_velocity: Vec3<S>,
}

impl<S: Scalar> Frame<S> {
    /// Of a vehicle alone, from its state: there the angular velocity is along body axes.
    #[inline(always)]
    pub fn of_vehicle(state: &StridedView<'_, S>) -> Self {
        let mut frame = Self::read(state);
        frame.angular_velocity = rotate(frame.attitude, frame.angular_velocity);
        frame
    }

    /// From 13 numbers.
    #[inline(always)]
    pub fn read(x: &StridedView<'_, S>) -> Self {
        Self { position: x.array(0), velocity: x.array(3), attitude: x.array(6), angular_velocity: x.array(10) }
    }

    /// As 13 numbers.
    #[inline(always)]
    pub fn write(&self, writer: &mut StridedWriter<'_, S>) {
        writer.array(self.position);
        writer.array(self.velocity);
        writer.array(self.attitude);
        writer.array(self.angular_velocity);
    }

    /// Position and velocity of a point fixed in the body, world.
    #[inline(always)]
    pub fn point(&self, local: Vec3<S>) -> (Vec3<S>, Vec3<S>) {
        let lever = rotate(self.attitude, local);
        (add(self.position, lever), add(self.velocity, cross(self.angular_velocity, lever)))
    }

    /// R e_x, world.
    #[inline(always)]
    pub fn heading(&self) -> Vec3<S> {
        let [w, x, y, z] = self.attitude;
        let (one, two) = (S::one(), S::constant(2.0));
        [one - two * y.mul_add(y, z * z), two * x.mul_add(y, w * z), two * x.mul_add(z, -(w * y))]
    }

    /// R e_z, world.
    #[inline(always)]
    pub fn up(&self) -> Vec3<S> {
        up_axis(self.attitude)
    }

    /// Of the heading, rad.
    #[inline(always)]
    pub fn yaw(&self) -> S {
        let [x, y, _] = self.heading();
        safe::atan2(y, x)
    }

    /// The attitude with w ≥ 0: q and −q are one attitude, an observation should not say which.
    #[inline(always)]
    pub fn observed_attitude(&self) -> Quat<S> {
        let flip = self.attitude[0].lt(S::zero());
        let mut q = self.attitude;
        unrolled!(i in 0..4 {
            q[i] = S::select(flip, -q[i], q[i]);
        });
        q
    }
}
