//! Sensors that tell where something is: satellite receiver and motion capture.

use super::chain::{Dropout, ErrorModel, Errors};
use super::context::SensorContext;
use super::device::{Device, KindSettings};
use super::limits::within;
use super::mount::Motion;
use crate::spatial::{exponential, multiply};
use base::error::Result;
use rng::Stream;
use serde::{Deserialize, Serialize};

/// p + R r and v + R(ω × r) of the antenna, world axes: a receiver whose fixes are local already.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Gnss {
    /// u is m.
    pub position_error: ErrorModel,
    /// u is m/s.
    pub velocity_error: ErrorModel,
}

impl KindSettings for Gnss {
    const CHANNELS: &[(&'static str, &'static str)] = &[
        ("position_x", "m"),
        ("position_y", "m"),
        ("position_z", "m"),
        ("velocity_x", "m/s"),
        ("velocity_y", "m/s"),
        ("velocity_z", "m/s"),
    ];

    fn validate(&self, what: &str) -> Result<()> {
        self.position_error.validate(&format!("{what}: position_error"), 3)?;
        self.velocity_error.validate(&format!("{what}: velocity_error"), 3)
    }
}

#[derive(Debug, Clone)]
pub(crate) struct GnssDevice {
    position: Errors<3>,
    velocity: Errors<3>,
}

impl GnssDevice {
    pub(crate) fn new(settings: &Gnss, between: f64) -> Result<Self> {
        Ok(Self {
            position: Errors::new(&settings.position_error, between),
            velocity: Errors::new(&settings.velocity_error, between),
        })
    }
}

impl Device for GnssDevice {
    fn draw(&mut self, stream: &mut Stream) {
        self.position.draw(stream);
        self.velocity.draw(stream);
    }

    fn sample(&mut self, at: &Motion, _: &mut SensorContext<'_>, stream: &mut Stream, out: &mut [f64]) {
        out[..3].copy_from_slice(&self.position.apply(at.position, stream));
        out[3..].copy_from_slice(&self.velocity.apply(at.velocity, stream));
    }

    fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.position.each(visit);
        self.velocity.each(visit);
    }
}

/// Pose of the mount in the world, with samples that are lost in runs: the last one is then held, and `valid` is 0.
///
/// The attitude is q ⊗ exp(δθ) with w ≥ 0, δθ the error about mount axes.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotionCapture {
    /// u is m.
    pub position_error: ErrorModel,
    /// Of δθ; u is rad.
    pub attitude_error: ErrorModel,
    /// Share of samples that are lost, 0 to 0.5.
    pub dropout: f64,
    /// How long markers stay unseen on average, s; at least one sample.
    pub dropout_time: f64,
}

impl KindSettings for MotionCapture {
    const CHANNELS: &[(&'static str, &'static str)] = &[
        ("position_x", "m"),
        ("position_y", "m"),
        ("position_z", "m"),
        ("attitude_w", "-"),
        ("attitude_x", "-"),
        ("attitude_y", "-"),
        ("attitude_z", "-"),
        ("valid", "-"),
    ];

    fn validate(&self, what: &str) -> Result<()> {
        self.position_error.validate(&format!("{what}: position_error"), 3)?;
        self.attitude_error.validate(&format!("{what}: attitude_error"), 3)?;
        within(&format!("{what}: dropout"), self.dropout, 0.0, Dropout::MOST)?;
        within(&format!("{what}: dropout_time"), self.dropout_time, 0.0, 1e6)
    }
}

#[derive(Debug, Clone)]
pub(crate) struct MotionCaptureDevice {
    position: Errors<3>,
    attitude: Errors<3>,
    dropout: Dropout,
}

impl MotionCaptureDevice {
    pub(crate) fn new(settings: &MotionCapture, between: f64) -> Result<Self> {
        Ok(Self {
            position: Errors::new(&settings.position_error, between),
            attitude: Errors::new(&settings.attitude_error, between),
            dropout: Dropout::new(settings.dropout, settings.dropout_time / between),
        })
    }
}

impl Device for MotionCaptureDevice {
    fn draw(&mut self, stream: &mut Stream) {
        self.position.draw(stream);
        self.attitude.draw(stream);
        self.dropout.draw();
    }

    fn sample(&mut self, at: &Motion, _: &mut SensorContext<'_>, stream: &mut Stream, out: &mut [f64]) {
        let lost = self.dropout.next(stream);
        let position = self.position.apply(at.position, stream);
        let attitude = multiply(at.attitude, exponential(self.attitude.apply([0.0; 3], stream)));
        out[7] = if lost { 0.0 } else { 1.0 };
        if !lost {
            let sign = if attitude[0] < 0.0 { -1.0 } else { 1.0 };
            out[..3].copy_from_slice(&position);
            out[3..7].copy_from_slice(&attitude.map(|c| sign * c));
        }
    }

    fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.position.each(visit);
        self.attitude.each(visit);
        self.dropout.each(visit);
    }
}
