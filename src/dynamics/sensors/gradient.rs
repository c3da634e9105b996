//! How readings change with the pose of the body that carries the sensor, for sensors with `gradient = "pose"`.
//!
//! The slope is that of the ray that gave the reading, on the surface that it met: [`RayScene::slope`]. What comes behind it is
//! followed by the chain rule: scale and the form of a distance apply; bias and noise pass with derivative 1, how noise grows
//! with distance is not followed; rounding is taken for the identity; what is lost, clipped, saturated or out of range has
//! slope 0. Jumps where a ray leaves one surface for another are not seen, which biases what is learnt near silhouettes. What
//! moves by itself, a gate or another drone, stands still to the slope.

use super::cast::normal::{RangeJacobian, on_surface};
use super::cast::{GROUND, NOTHING, RayScene};
use crate::shape::Pose;
use crate::spatial::Vec3;
use serde::{Deserialize, Serialize};

/// What gradients know of readings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorGradient {
    /// Nothing: they are constants.
    #[default]
    None,
    /// How they change with the pose of the body that carries the sensor. Jumps at silhouettes are ignored: the gradient of what
    /// is seen is biased by what its edges sweep.
    Pose,
}

/// The ray that gave a reading.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ReadingRay {
    /// Of the solid.
    pub id: u32,
    /// In lengths of `direction`.
    pub t: f64,
    /// In the frame of the mount.
    pub direction: Vec3<f64>,
    /// d reading/dt.
    pub factor: f64,
}

impl ReadingRay {
    /// Of a reading that tells nothing of the pose.
    pub(crate) const NOTHING: Self = Self { id: NOTHING, t: 0.0, direction: [0.0; 3], factor: 0.0 };

    /// Of its reading.
    pub(crate) fn slope(&self, world: &RayScene, mount: &Pose<f64>, body: &Pose<f64>) -> RangeJacobian {
        if self.factor == 0.0 {
            return RangeJacobian::default();
        }
        let slope = match self.id {
            // a range finder has a ground of its own, where its world may have none
            GROUND if !world.is_uneven() => on_surface([0.0, 0.0, 1.0], self.t, self.direction, mount, body),
            id => world.slope(id, self.t, self.direction, mount, body),
        };
        RangeJacobian {
            position: slope.position.map(|x| self.factor * x),
            attitude: slope.attitude.map(|x| self.factor * x),
        }
    }
}
