//! Where a sensor sits on its body, and what happens there.

use super::limits::{MAX_LEVER, within};
use crate::Frame;
use crate::shape::Pose;
use crate::spatial::{Quat, Vec3, add, axpy, cross, multiply, rotate, rotate_back, scale, sub};
use base::error::{Error, Result};

/// How a body moves over a step that just ended, as sensors need it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundTruth {
    /// Of the body's origin at the end of the step, m, world.
    pub position: Vec3<f64>,
    /// Of the body's origin at the end of the step, m/s, world.
    pub velocity: Vec3<f64>,
    /// Body → world, at the end of the step.
    pub attitude: Quat<f64>,
    /// At the end of the step, rad/s, **body** axes.
    pub angular_velocity: Vec3<f64>,
    /// Of the body's origin, mean over the step, m/s², world.
    pub mean_acceleration: Vec3<f64>,
    /// Half way through the step, body → world.
    pub mean_attitude: Quat<f64>,
    /// Mean over the step, rad/s, body axes.
    pub mean_angular_velocity: Vec3<f64>,
    /// Mean over the step, rad/s², body axes.
    pub mean_angular_acceleration: Vec3<f64>,
    /// m/s², along −z of the world.
    pub gravity: f64,
    /// Of all contacts on the body at the end of the step, N, world; zeros unless given.
    pub contact_force: Vec3<f64>,
}

impl GroundTruth {
    /// Pose of the body at the end of the step, world.
    pub fn pose(&self) -> Pose<f64> {
        Pose { position: self.position, attitude: self.attitude }
    }

    /// At an instant with the acceleration of the body's origin (m/s², world) and the angular acceleration (rad/s², body) that the dynamics
    /// give: the first of an episode. `gravity` in m/s², here and below.
    pub fn at(frame: &Frame<f64>, acceleration: Vec3<f64>, angular_acceleration: Vec3<f64>, gravity: f64) -> Self {
        let angular_velocity = rotate_back(frame.attitude, frame.angular_velocity);
        Self {
            position: frame.position,
            velocity: frame.velocity,
            attitude: frame.attitude,
            angular_velocity,
            mean_acceleration: acceleration,
            mean_attitude: frame.attitude,
            mean_angular_velocity: angular_velocity,
            mean_angular_acceleration: angular_acceleration,
            gravity,
            contact_force: [0.0; 3],
        }
    }

    /// After a step of `dt` seconds from `before` to `after`: the acceleration is Δv/Δt, what a strapdown part integrates.
    pub fn between(before: &Frame<f64>, after: &Frame<f64>, dt: f64, gravity: f64) -> Self {
        let mut truth = Self::at(after, over(before.velocity, after.velocity, dt), [0.0; 3], gravity);
        let earlier = rotate_back(before.attitude, before.angular_velocity);
        truth.mean_angular_acceleration = over(earlier, truth.angular_velocity, dt);
        truth.mean_angular_velocity = scale(0.5, add(earlier, truth.angular_velocity));
        truth.mean_attitude = middle(before.attitude, after.attitude);
        truth
    }

    /// At `before`, with the accelerations of the step of `dt` seconds that follows: where the dynamics are not known otherwise.
    pub fn ahead(before: &Frame<f64>, after: &Frame<f64>, dt: f64, gravity: f64) -> Self {
        let coming = Self::between(before, after, dt, gravity);
        Self::at(before, coming.mean_acceleration, coming.mean_angular_acceleration, gravity)
    }
}

/// (b − a)/dt.
fn over(a: Vec3<f64>, b: Vec3<f64>, dt: f64) -> Vec3<f64> {
    scale(1.0 / dt, sub(b, a))
}

/// Half way from a to b on the shorter way; q and −q are one attitude.
fn middle(a: Quat<f64>, b: Quat<f64>) -> Quat<f64> {
    let along: f64 = a.iter().zip(&b).map(|(x, y)| x * y).sum();
    let sum = axpy(b, if along < 0.0 { -1.0 } else { 1.0 }, a);
    let norm = sum.iter().map(|x| x * x).sum::<f64>().sqrt();
    scale(1.0 / norm, sum)
}

/// A place on a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Mount {
    /// r, from the body's origin, m, body axes.
    position: Vec3<f64>,
    /// M, mount → body.
    rotation: Quat<f64>,
}

/// What happens at a mount.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Motion {
    /// m, world.
    pub position: Vec3<f64>,
    /// m/s, world.
    pub velocity: Vec3<f64>,
    /// Mount → world.
    pub attitude: Quat<f64>,
    /// rad/s, mount axes.
    pub angular_velocity: Vec3<f64>,
    /// Acceleration less gravity, mean over the step, m/s², mount axes.
    pub specific_force: Vec3<f64>,
    /// Of all contacts on the body, N, mount axes.
    pub contact_force: Vec3<f64>,
}

impl Mount {
    /// # Errors
    /// [`Error::Value`] beyond [`MAX_LEVER`] and for a rotation that is not of unit length (to 1e-6).
    pub(crate) fn new(what: &str, position: Vec3<f64>, rotation: Quat<f64>) -> Result<Self> {
        for x in position {
            within(&format!("{what}: position"), x, -MAX_LEVER, MAX_LEVER)?;
        }
        let norm = rotation.iter().map(|x| x * x).sum::<f64>().sqrt();
        if (norm - 1.0).abs() <= 1e-6 {
            return Ok(Self { position, rotation });
        }
        let remedy = "Divide [w, x, y, z] by its length.";
        Err(Error::value(format!("{what}: length of rotation"), norm, "1 to within 1e-6", remedy))
    }

    /// In the frame of its body.
    pub(crate) fn pose(&self) -> Pose<f64> {
        Pose { position: self.position, attitude: self.rotation }
    }

    /// v_s = v + R (ω × r); f = Mᵀ(R_mᵀ(v̇ − g) + ω̇ × r + ω × (ω × r)) with means over the step, R_m that of its middle: the
    /// mean of what turns with the body, to second order in the step.
    pub(crate) fn motion(&self, truth: &GroundTruth) -> Motion {
        let (r, q) = (self.position, truth.attitude);
        let (mean, turning) = (truth.mean_angular_velocity, truth.mean_angular_acceleration);
        let felt = add(truth.mean_acceleration, [0.0, 0.0, truth.gravity]);
        let lever = add(cross(turning, r), cross(mean, cross(mean, r)));
        let force = add(rotate_back(truth.mean_attitude, felt), lever);
        Motion {
            position: add(truth.position, rotate(q, r)),
            velocity: add(truth.velocity, rotate(q, cross(truth.angular_velocity, r))),
            attitude: multiply(q, self.rotation),
            angular_velocity: rotate_back(self.rotation, truth.angular_velocity),
            specific_force: rotate_back(self.rotation, force),
            contact_force: rotate_back(multiply(q, self.rotation), truth.contact_force),
        }
    }
}
