//! Sensors of fields that fill the world: magnetometer and barometer.

use super::chain::{ErrorModel, Errors};
use super::context::SensorContext;
use super::device::{Device, KindSettings};
use super::limits::{MAX_DISTANCE, within};
use super::mount::Motion;
use crate::spatial::{Vec3, rotate_back};
use autodiff::Scalar;
use base::error::Result;
use rng::Stream;
use serde::{Deserialize, Serialize};

/// Mᵀ Rᵀ B, mount axes. The offset of its errors is hard iron, scale and misalignment are soft iron.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Magnetometer {
    /// B of the place, T, world.
    pub field: Vec3<f64>,
    /// u is T.
    pub error: ErrorModel,
}

impl Default for Magnetometer {
    /// Of central Europe (48 µT, 63° down), x of the world to the magnetic north.
    fn default() -> Self {
        Self { field: [21.5e-6, 0.0, -43.0e-6], error: ErrorModel::default() }
    }
}

impl KindSettings for Magnetometer {
    const CHANNELS: &[(&'static str, &'static str)] = &[("field_x", "T"), ("field_y", "T"), ("field_z", "T")];

    fn validate(&self, what: &str) -> Result<()> {
        // the strongest magnets of laboratories are below 100 T
        self.field.iter().try_for_each(|b| within(&format!("{what}: field"), *b, -100.0, 100.0))?;
        self.error.validate(&format!("{what}: error"), 3)
    }
}

#[derive(Debug, Clone)]
pub(crate) struct MagnetometerDevice {
    field: Vec3<f64>,
    errors: Errors<3>,
}

impl MagnetometerDevice {
    pub(crate) fn new(settings: &Magnetometer, between: f64) -> Result<Self> {
        Ok(Self { field: settings.field, errors: Errors::new(&settings.error, between) })
    }
}

impl Device for MagnetometerDevice {
    fn draw(&mut self, stream: &mut Stream) {
        self.errors.draw(stream);
    }

    fn sample(&mut self, at: &Motion, _: &mut SensorContext<'_>, stream: &mut Stream, out: &mut [f64]) {
        out.copy_from_slice(&self.errors.apply(rotate_back(at.attitude, self.field), stream));
    }

    fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.errors.each(visit);
    }
}

/// p₀ of the standard atmosphere, Pa.
const SEA_LEVEL: f64 = 101_325.0;
/// Its temperature at sea level, K, as PX4's simulated barometer rounds it.
const TEMPERATURE: f64 = 288.0;
/// Its lapse rate, K/m.
const LAPSE: f64 = 0.0065;
/// g/(lapse rate · gas constant of air).
const EXPONENT: f64 = 5.256;

/// p = 101 325 (1 − 0.0065 h/288)^5.256 Pa, h = `altitude` + z: the standard atmosphere's troposphere as PX4 simulates it.
/// At sea level 1 Pa is 8.3 cm.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Barometer {
    /// Of the world's origin above sea level, m.
    pub altitude: f64,
    /// What the weather adds, Pa/s.
    pub drift: f64,
    /// u is Pa.
    pub error: ErrorModel,
}

impl KindSettings for Barometer {
    const CHANNELS: &[(&'static str, &'static str)] = &[("pressure", "Pa")];

    fn validate(&self, what: &str) -> Result<()> {
        within(&format!("{what}: altitude"), self.altitude, -MAX_DISTANCE, MAX_DISTANCE)?;
        within(&format!("{what}: drift"), self.drift, -SEA_LEVEL, SEA_LEVEL)?;
        self.error.validate(&format!("{what}: error"), 1)
    }
}

/// Pa, at a height above sea level, m; 0 where the troposphere's law has no air left (44 km).
fn pressure(height: f64) -> f64 {
    let share = 1.0 - LAPSE * height / TEMPERATURE;
    // a height that is no number stays one
    SEA_LEVEL * if share < 0.0 { 0.0 } else { share.powf(EXPONENT) }
}

impl Barometer {
    /// Pressure without errors and weather at the height z of the world, m, in Pa, and its slope, Pa/m; for heights with air (below 44 km).
    pub fn pressure_at<S: Scalar>(&self, z: S) -> [S; 2] {
        let share = S::one() - (z + S::constant(self.altitude)) * S::constant(LAPSE / TEMPERATURE);
        let share = S::select(share.lt(S::constant(1e-3)), S::constant(1e-3), share);
        let pressure = S::constant(SEA_LEVEL) * (share.ln() * S::constant(EXPONENT)).exp();
        [pressure, -(pressure * share.recip() * S::constant(EXPONENT * LAPSE / TEMPERATURE))]
    }
}

#[derive(Debug, Clone)]
pub(crate) struct BarometerDevice {
    altitude: f64,
    /// Pa from one sample to the next.
    drift: f64,
    /// Samples of the episode so far.
    count: f64,
    errors: Errors<1>,
}

impl BarometerDevice {
    pub(crate) fn new(settings: &Barometer, between: f64) -> Result<Self> {
        let errors = Errors::new(&settings.error, between);
        Ok(Self { altitude: settings.altitude, drift: settings.drift * between, count: 0.0, errors })
    }
}

impl Device for BarometerDevice {
    fn draw(&mut self, stream: &mut Stream) {
        self.count = 0.0;
        self.errors.draw(stream);
    }

    fn sample(&mut self, at: &Motion, _: &mut SensorContext<'_>, stream: &mut Stream, out: &mut [f64]) {
        let air = pressure(self.altitude + at.position[2]) + self.count * self.drift;
        self.count += 1.0;
        out.copy_from_slice(&self.errors.apply([air], stream));
    }

    fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        visit(&mut self.count);
        self.errors.each(visit);
    }
}
