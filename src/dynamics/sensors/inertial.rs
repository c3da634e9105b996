//! Inertial measurement unit: accelerometer and gyroscope.

use super::chain::{ErrorModel, Errors};
use super::context::SensorContext;
use super::device::{Device, KindSettings};
use super::mount::Motion;
use base::error::Result;
use rng::Stream;
use serde::{Deserialize, Serialize};

/// f = Mᵀ Rᵀ(a_s − g) and Mᵀω, mount axes; a_s = v̇ + R(ω̇ × r + ω × (ω × r)) with v̇ = Δv/Δt over the step, what a strapdown
/// part integrates. At rest it reads +g upwards.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Imu {
    /// Of the specific force; u is m/s².
    pub accelerometer: ErrorModel,
    /// Of the angular velocity; u is rad/s.
    pub gyroscope: ErrorModel,
}

impl KindSettings for Imu {
    const CHANNELS: &[(&'static str, &'static str)] = &[
        ("accelerometer_x", "m/s^2"),
        ("accelerometer_y", "m/s^2"),
        ("accelerometer_z", "m/s^2"),
        ("gyroscope_x", "rad/s"),
        ("gyroscope_y", "rad/s"),
        ("gyroscope_z", "rad/s"),
    ];

    fn validate(&self, what: &str) -> Result<()> {
        self.accelerometer.validate(&format!("{what}: accelerometer"), 3)?;
        self.gyroscope.validate(&format!("{what}: gyroscope"), 3)
    }
}

#[derive(Debug, Clone)]
pub(crate) struct ImuDevice {
    accelerometer: Errors<3>,
    gyroscope: Errors<3>,
}

impl ImuDevice {
    pub(crate) fn new(settings: &Imu, between: f64) -> Result<Self> {
        Ok(Self {
            accelerometer: Errors::new(&settings.accelerometer, between),
            gyroscope: Errors::new(&settings.gyroscope, between),
        })
    }
}

impl Device for ImuDevice {
    fn draw(&mut self, stream: &mut Stream) {
        self.accelerometer.draw(stream);
        self.gyroscope.draw(stream);
    }

    fn sample(&mut self, at: &Motion, _: &mut SensorContext<'_>, stream: &mut Stream, out: &mut [f64]) {
        out[..3].copy_from_slice(&self.accelerometer.apply(at.specific_force, stream));
        out[3..].copy_from_slice(&self.gyroscope.apply(at.angular_velocity, stream));
    }

    fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.accelerometer.each(visit);
        self.gyroscope.each(visit);
    }
}
