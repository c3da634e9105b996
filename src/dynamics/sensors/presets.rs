//! Real parts and usual installations, with their sources. Command line, tests and documentation find them in [`REGISTRY`].
//!
//! Figures without a source of their own are ours and say so. Biases of parts whose source gives none begin at 0, as after a
//! calibration.

use super::camera::{Camera, Stereo};
use super::chain::{ErrorModel, PerAxis};
use super::gnss::{Gnss, MotionCapture};
use super::inertial::Imu;
use super::kinds::SensorModel;
use super::lidar::{Lidar, Pattern};
use super::magnetometer_barometer::{Barometer, Magnetometer};
use super::range_flow::{Flow, NoiseGrowth, Range};
use super::reading::DistanceEncoding;
use PerAxis::{Each, Same};
use base::error::{Error, Result};

/// One line of the registry.
#[derive(Debug, Clone, Copy)]
pub struct Preset {
    /// As `preset` says it.
    pub name: &'static str,
    /// The kind of sensor that it is of.
    pub kind: &'static str,
    /// What it is and where its figures are from.
    pub source: &'static str,
    /// Samples per second; in every step without.
    pub rate: Option<f64>,
    /// From a sample to its reading, s.
    pub delay: Option<f64>,
    /// Its settings.
    pub model: fn() -> SensorModel,
}

/// Every preset.
pub const REGISTRY: &[Preset] = &[
    Preset {
        name: "adis16448",
        kind: "imu",
        source: "Analog Devices ADIS16448: default of RotorS and of PX4's simulated IMU",
        rate: None,
        delay: None,
        model: || SensorModel::Imu(px4_imu(3.394e-4, 4.0e-3)),
    },
    Preset {
        name: "mpu6000",
        kind: "imu",
        source: "InvenSense MPU-6000: noise of PX4's iris; data sheet: 2000 deg/s, 16 g, 16 bit",
        rate: None,
        delay: None,
        model: || {
            let imu = px4_imu(1.8665e-4, 1.86e-3);
            SensorModel::Imu(Imu {
                accelerometer: sixteen_bits(imu.accelerometer, 16.0 * STANDARD_GRAVITY),
                gyroscope: sixteen_bits(imu.gyroscope, 2000_f64.to_radians()),
            })
        },
    },
    Preset {
        name: "bmi088",
        kind: "imu",
        source: "Bosch BMI088: noise of Aerial Gym, as its data sheet (0.014 deg/s/sqrt(Hz), 160-190 ug/sqrt(Hz); 2000 deg/s, 24 g, 16 bit)",
        rate: None,
        delay: None,
        model: || {
            let gyroscope = ErrorModel { density: Same(2.44e-4), bias_walk: Same(1.44e-5), ..ErrorModel::default() };
            let accelerometer = ErrorModel {
                density: Each([1.57e-3, 1.57e-3, 1.86e-3]),
                bias_walk: Same(1.36e-3),
                ..ErrorModel::default()
            };
            SensorModel::Imu(Imu {
                accelerometer: sixteen_bits(accelerometer, 24.0 * STANDARD_GRAVITY),
                gyroscope: sixteen_bits(gyroscope, 2000_f64.to_radians()),
            })
        },
    },
    Preset {
        name: "pegasus",
        kind: "magnetometer",
        source: "default of Pegasus Simulator and of PX4's simulated magnetometer; 100 Hz",
        rate: Some(100.0),
        delay: None,
        model: || {
            // published in gauss, 1e-4 T
            let error = ErrorModel {
                density: Same(4.0e-8),
                bias_walk: Same(6.4e-10),
                bias_time: Some(600.0),
                ..ErrorModel::default()
            };
            SensorModel::Magnetometer(Magnetometer { error, ..Magnetometer::default() })
        },
    },
    Preset {
        name: "px4",
        kind: "barometer",
        source: "PX4's simulated barometer: 1 Pa rms, 50 Hz",
        rate: Some(50.0),
        delay: None,
        model: || {
            let error = ErrorModel { deviation: Same(1.0), ..ErrorModel::default() };
            SensorModel::Barometer(Barometer { error, ..Barometer::default() })
        },
    },
    Preset {
        name: "ms5611",
        kind: "barometer",
        source: "TE MS5611-01BA03, data sheet: 1.2 Pa rms at OSR 4096 in 8.2 ms, +-150 Pa at 25 C (as two sigma), 1 to 120 kPa",
        rate: Some(100.0),
        delay: Some(0.00822),
        model: || {
            let error = ErrorModel {
                deviation: Same(1.2),
                bias_start: Same(75.0),
                limits: Some([1.0e3, 1.2e5]),
                ..ErrorModel::default()
            };
            SensorModel::Barometer(Barometer { error, ..Barometer::default() })
        },
    },
    Preset {
        name: "single_point",
        kind: "gnss",
        source: "receiver without corrections, 5 Hz: velocity noise as PX4's simulated GPS; errors of position (1 m, vertical 2 m, over 60 s) and 0.12 s of latency ours",
        rate: Some(5.0),
        delay: Some(0.12),
        model: || {
            let (time, spread) = (60.0_f64, [1.0, 1.0, 2.0]);
            let position_error = ErrorModel {
                bias_start: Each(spread),
                // stationary: σ_b √(τ/2) is the spread
                bias_walk: Each(spread.map(|s| s * (2.0 / time).sqrt())),
                bias_time: Some(time),
                ..ErrorModel::default()
            };
            let velocity_error = ErrorModel { deviation: Each([0.09, 0.09, 0.18]), ..ErrorModel::default() };
            SensorModel::Gnss(Gnss { position_error, velocity_error })
        },
    },
    Preset {
        name: "optical",
        kind: "motion_capture",
        source: "cameras around a room, ours: 1 mm, 0.2 deg, 100 Hz, 10 ms, 1 % lost in runs of 50 ms",
        rate: Some(100.0),
        delay: Some(0.01),
        model: || {
            SensorModel::MotionCapture(MotionCapture {
                position_error: ErrorModel { deviation: Same(1e-3), ..ErrorModel::default() },
                attitude_error: ErrorModel { deviation: Same(0.2_f64.to_radians()), ..ErrorModel::default() },
                dropout: 0.01,
                dropout_time: 0.05,
            })
        },
    },
    Preset {
        name: "vl53l1x",
        kind: "range",
        source: "ST VL53L1X: cone of 27 deg, 4 m, 50 Hz, readings in mm; noise of the Crazyflie's estimator",
        rate: Some(50.0),
        delay: None,
        model: || {
            SensorModel::Range(Range {
                cone: 27_f64.to_radians(),
                nearest: 0.04,
                farthest: 4.0,
                growth: Some(NoiseGrowth { from: 2.5, until: 4.0, factor: 80.0 }),
                error: ErrorModel { deviation: Same(2.5e-3), resolution: 1e-3, ..ErrorModel::default() },
                ..Range::default()
            })
        },
    },
    Preset {
        name: "pmw3901",
        kind: "flow",
        source: "PixArt PMW3901 as the Crazyflie's estimator reads it: 35 pixels over 0.717 rad, counts of 0.1 px, 0.2 px rms, 100 Hz, from 8 cm on",
        rate: Some(100.0),
        delay: None,
        model: || {
            let error = ErrorModel { deviation: Same(0.2), resolution: 0.1, ..ErrorModel::default() };
            SensorModel::Flow(Flow { error, ..Flow::default() })
        },
    },
    Preset {
        name: "omnidrones",
        kind: "lidar",
        source: "OmniDrones' Forest: 36 x 4 beams of 4 m, told as 4 m less the distance, without errors",
        rate: None,
        delay: None,
        model: || SensorModel::Lidar(Lidar { form: DistanceEncoding::Proximity, ..Lidar::default() }),
    },
    Preset {
        name: "os0",
        kind: "lidar",
        source: "Ouster OS0-128 as Aerial Gym has it: 512 x 128 beams, +-45 deg, 35 m, noise growing with distance; 10 Hz",
        rate: Some(10.0),
        delay: None,
        model: || {
            let step = 90_f64.to_radians() / 127.0;
            SensorModel::Lidar(Lidar {
                beams: 512,
                elevations: (0..128).map(|i| 45_f64.to_radians() - step * i as f64).collect(),
                nearest: 0.3,
                farthest: 35.0,
                noise: [9.6e-3, -0.32e-3, 3.4e-5],
                ..Lidar::default()
            })
        },
    },
    Preset {
        name: "mid360",
        kind: "lidar",
        source: "Livox Mid-360, data sheet: 360 deg by -7 to 52 deg, 0.1 to 40 m, 200 000 points/s, 2 cm (1 sigma at 10 m); its pattern as a sequence that does not repeat, 2000 points at 100 Hz ours",
        rate: Some(100.0),
        delay: None,
        model: || {
            SensorModel::Lidar(Lidar {
                beams: 1000,
                elevations: [-7.0, 52.0].map(f64::to_radians).to_vec(),
                pattern: Pattern::Scatter,
                nearest: 0.1,
                farthest: 40.0,
                noise: [0.02, 0.0, 0.0],
                ..Lidar::default()
            })
        },
    },
    Preset {
        name: "d435",
        kind: "camera",
        source: "Intel RealSense D435 at 848 x 480: 87 deg, 50 mm, 0.08 px rms in steps of 1/32 px, 0.18 to 10 m, 1 % lost; 30 Hz; told by 64 x 48 pixels, ours",
        rate: Some(30.0),
        delay: None,
        model: || {
            SensorModel::Camera(Camera {
                field_of_view: 87_f64.to_radians(),
                nearest: 0.18,
                stereo: Some(Stereo { focal: 447.0, baseline: 0.05, deviation: 0.08, resolution: 1.0 / 32.0 }),
                dropout: 0.01,
                ..Camera::default()
            })
        },
    },
    Preset {
        name: "diffphysdrone",
        kind: "camera",
        source: "DiffPhysDrone: 64 x 48 pixels over 90 deg, inverse depth within 0.3 to 24 m, the nearest of 4 x 4 pixels; exact",
        rate: None,
        delay: None,
        model: || {
            SensorModel::Camera(Camera {
                field_of_view: 90_f64.to_radians(),
                farthest: 24.0,
                form: DistanceEncoding::Inverse,
                pool: 4,
                ..Camera::default()
            })
        },
    },
];

/// In which data sheets give ranges of accelerometers, m/s².
const STANDARD_GRAVITY: f64 = 9.80665;

/// The biases of PX4's simulated IMUs, which all share them, with the densities of one.
fn px4_imu(gyroscope: f64, accelerometer: f64) -> Imu {
    Imu {
        accelerometer: ErrorModel {
            density: Same(accelerometer),
            bias_walk: Same(6.0e-3),
            bias_time: Some(300.0),
            bias_start: Same(0.196),
            ..ErrorModel::default()
        },
        gyroscope: ErrorModel {
            density: Same(gyroscope),
            bias_walk: Same(3.8785e-5),
            bias_time: Some(1000.0),
            bias_start: Same(8.7e-3),
            ..ErrorModel::default()
        },
    }
}

/// Converted to 16 bits over ± `range`.
fn sixteen_bits(error: ErrorModel, range: f64) -> ErrorModel {
    ErrorModel { limits: Some([-range, range]), resolution: range / 32768.0, ..error }
}

/// The preset of that name for a kind of sensor.
///
/// # Errors
/// [`Error::Unknown`] with the names of all of that kind.
pub fn preset(kind: &str, name: &str) -> Result<&'static Preset> {
    let own = || REGISTRY.iter().filter(|preset| preset.kind == kind);
    own().find(|preset| preset.name == name).ok_or_else(|| Error::Unknown {
        kind: "preset of such a sensor",
        name: name.into(),
        known: own().map(|preset| preset.name.to_string()).collect(),
    })
}
