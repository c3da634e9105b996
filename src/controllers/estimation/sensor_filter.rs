//! From the settings of sensors to a filter of their readings: what each tells, its noise, its biases, where its numbers are.

use super::aiding::{Aid, AidKind, correct};
use super::navigation_state::{ERRORS, InertialNoise, NAVIGATION, NavigationState, predict};
use super::noise::{BiasProcess, white_variance};
use super::state_estimator::StateEstimatorSettings;
use autodiff::{Array, Recording, Scalar};
use base::error::{Error, Result};
use dynamics::Frame;
use dynamics::sensors::{ErrorModel, Imu, SensorConfig, SensorModel};
use dynamics::spatial::{Quat, Vec3, add, conjugate, constants, cross, multiply, rotate, rotate_back, sub};
use nalgebra::{SMatrix, SVector};

/// Where a sensor's readings are among those of all, and when they come.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorSchedule {
    /// Its name.
    pub name: String,
    /// First of its numbers among all readings.
    pub first: usize,
    /// Steps from one sample to the next.
    pub every: u64,
    /// Steps from a sample to its reading.
    pub latency: u64,
}

impl SensorSchedule {
    /// The step in which that was sampled which is read for the first time in this one, where there is such.
    pub fn sampled(&self, step: u64) -> Option<u64> {
        if step == 0 {
            return Some(0);
        }
        let sampled = step.checked_sub(self.latency).filter(|s| *s > 0)?;
        sampled.is_multiple_of(self.every).then_some(sampled)
    }
}

/// A sensor that aids, with its schedule.
#[derive(Debug, Clone, PartialEq)]
pub struct ScheduledAid {
    /// How the filter sees it; a sensor of several kinds of numbers is several of them.
    pub aid: Aid,
    /// When its readings come.
    pub schedule: SensorSchedule,
    /// Offset of a number behind its own that is 0 where a sample was lost, where it has one.
    pub valid: Option<usize>,
}

/// All that a filter of an inertial unit and what aids it has to know.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorFilter {
    /// Of the inertial unit.
    pub inertial: SensorSchedule,
    /// r and M of the unit on its body.
    pub mount: (Vec3<f64>, Quat<f64>),
    /// Per sample of it.
    pub noise: InertialNoise<f64>,
    /// Seconds between two of its samples.
    pub between: f64,
    /// Readings from which on its accelerometer (m/s²) and gyroscope (rad/s) are at their limits: low, high.
    pub limits: [[f64; 2]; 2],
    /// Sensors that aid.
    pub aids: Vec<ScheduledAid>,
    /// Variance of every bias at the beginning, `[6 + n_bias]`.
    pub bias_start: Vec<f64>,
    /// Their names.
    pub bias_names: Vec<String>,
}

/// What errors of scale act on, about hover: m/s² and rad/s of an inertial unit.
pub(super) const USUAL: [f64; 2] = [10.0, 1.0];
/// Of places and distances (m), velocities (m/s), turns (rad), pixels and pressures (Pa).
const USUAL_LENGTH: f64 = 2.0;
const USUAL_VELOCITY: f64 = 1.0;
const USUAL_TURN: f64 = 0.1;
const USUAL_PIXELS: f64 = 2.0;
const USUAL_PRESSURE: f64 = 1e5;

/// Biases while they are collected.
struct Biases {
    dt: f64,
    all: Vec<(String, BiasProcess)>,
}

impl Biases {
    /// Number of the first of a sensor's, behind the unit's, where it has any.
    fn add(&mut self, name: &str, model: &ErrorModel, n: usize) -> Option<usize> {
        let own: Vec<BiasProcess> = (0..n).map(|axis| BiasProcess::of(model, axis, self.dt)).collect();
        if !own.iter().any(BiasProcess::is_there) {
            return None;
        }
        let first = self.all.len() - 6;
        let axes = if n == 1 { [""; 3] } else { ["_x", "_y", "_z"] };
        self.all.extend(own.into_iter().zip(axes).map(|(bias, axis)| (format!("{name}{axis}"), bias)));
        Some(first)
    }
}

impl SensorFilter {
    /// For sensors on one body in steps of `dt` seconds, whose readings come in their order. Sensors that tell nothing of the motion
    /// (cameras, lidars, contact), and inertial units beyond the first, are left out.
    ///
    /// # Errors
    /// [`Error::Value`] without an inertial unit, and for sensors on other bodies than it; as [`SensorConfig::steps_between`].
    pub fn new(configs: &[SensorConfig], dt: f64) -> Result<Self> {
        let mut first = 0;
        let mut placed = Vec::new();
        for config in configs {
            let (every, latency) = (config.steps_between(dt)?, config.steps_late(dt)?);
            placed.push((config, SensorSchedule { name: config.name.clone(), first, every, latency }));
            first += config.model.channels().len();
        }
        let unit = placed.iter().find_map(|(config, schedule)| match &config.model {
            SensorModel::Imu(imu) => Some((*config, imu, schedule.clone())),
            _ => None,
        });
        let Some((own, imu, inertial)) = unit else {
            let kinds = configs.iter().map(|c| c.model.kind()).collect::<Vec<_>>().join(", ");
            let remedy = "Add an inertial unit: --sensors imu:bmi088,…, or a [[sensor]] table of kind 'imu'. A filter goes on by its readings.";
            return Err(Error::value("sensors of an estimator", format!("[{kinds}]"), "one imu among them", remedy));
        };
        let between = inertial.every as f64 * dt;
        let mut biases = Biases { dt: between, all: Vec::new() };
        let noise = inertial_noise(imu, between, &mut biases);
        let mut aids = Vec::new();
        for (config, schedule) in placed.iter().filter(|(config, _)| !matches!(config.model, SensorModel::Imu(_))) {
            for (aid, offset, valid) in aids_of(config, own, schedule.every as f64 * dt, &mut biases) {
                if config.on != own.on {
                    let on = config.on.clone().unwrap_or_else(|| "the first body".into());
                    let rule = format!("on the body of '{}'", own.name);
                    return Err(Error::value(config.place(), format!("on {on}"), rule, "Mount them on one body."));
                }
                let schedule = SensorSchedule { first: schedule.first + offset, ..schedule.clone() };
                aids.push(ScheduledAid { aid, schedule, valid });
            }
        }
        // what is clipped is then rounded, by half a bit at most
        let limit = |model: &ErrorModel| {
            let half = 0.5 * model.resolution;
            model.limits.map_or([f64::NEG_INFINITY, f64::INFINITY], |[low, high]| [low + half, high - half])
        };
        Ok(Self {
            inertial,
            mount: (own.position, own.rotation),
            noise: InertialNoise { biases: biases.all.iter().map(|(_, b)| [b.decay, b.drive]).collect(), ..noise },
            between,
            limits: [limit(&imu.accelerometer), limit(&imu.gyroscope)],
            aids,
            bias_start: biases.all.iter().map(|(_, b)| b.start).collect(),
            bias_names: biases.all.into_iter().map(|(name, _)| name).collect(),
        })
    }

    /// Refuses what an error-state filter cannot be right about: an inertial unit that is not read in every step (its accelerometer tells
    /// the mean over a step, not since its last sample), sensors without noise, and readings later than `latest` steps.
    ///
    /// # Errors
    /// [`Error::Value`] and [`Error::Limit`] that name the sensor.
    pub(super) fn check(&self, latest: u64) -> Result<()> {
        let place = |schedule: &SensorSchedule| format!("sensor '{}'", schedule.name);
        if self.inertial.every != 1 {
            let (what, value) = (place(&self.inertial), format!("read every {} steps", self.inertial.every));
            let remedy = "Leave rate and every out, or take its rate for that of the steps (--dt).";
            return Err(Error::value(what, value, "read in every step, for an ekf", remedy));
        }
        let own = [&self.noise.accelerometer[..], &self.noise.gyroscope].map(|own| (&self.inertial, own, false));
        // a bias that wanders is noise enough
        let aids = self.aids.iter().map(|own| (&own.schedule, &own.aid.variance[..], own.aid.bias.is_some()));
        for (schedule, variances, is_biased) in own.into_iter().chain(aids) {
            if !variances.iter().all(|v| (*v > 0.0 || is_biased) && v.is_finite()) {
                let remedy = "Take a preset, KIND:PRESET, or give it errors: a filter weighs sensors by their noise.";
                let limit = "with noise in every channel, for an ekf";
                return Err(Error::value(place(schedule), "without noise", limit, remedy));
            }
            if schedule.latency > latest {
                let (value, limit) =
                    (format!("{} steps late", schedule.latency), format!("{latest} steps, for an ekf"));
                return Err(Error::limit(place(schedule), value, limit, "Read it sooner, or leave it out."));
            }
        }
        Ok(())
    }

    /// Whether its accelerometer (0) or gyroscope (1) reads x where it is at a limit.
    pub(super) fn is_at_limit(&self, k: usize, x: f64) -> bool {
        let [low, high] = self.limits[k];
        x <= low || x >= high
    }

    /// Writes the flat state of a filter that begins with a body in motion, known to the deviations of the settings.
    ///
    /// # Panics
    /// For a slice of another length than [`n_flat`](Self::n_flat).
    pub fn begin(&self, known: &Frame<f64>, settings: &StateEstimatorSettings, flat: &mut [f64]) {
        assert!(flat.len() == self.n_flat(), "{} numbers for a state of {}", flat.len(), self.n_flat());
        let (lever, rotation) = self.mount;
        let n = self.n_error();
        let swung = cross(known.angular_velocity, rotate(known.attitude, lever));
        let attitude = multiply(known.attitude, rotation);
        flat.fill(0.0);
        flat[..3].copy_from_slice(&add(known.position, rotate(known.attitude, lever)));
        flat[3..6].copy_from_slice(&add(known.velocity, swung));
        flat[6..10].copy_from_slice(&attitude);
        flat[10..13].copy_from_slice(&rotate_back(attitude, known.angular_velocity));
        let covariance = &mut flat[NAVIGATION + self.n_bias()..];
        let known =
            [settings.position, settings.velocity, settings.attitude].map(|deviation| [deviation * deviation; 3]);
        let variances = known.iter().flatten().chain(&self.bias_start);
        variances.enumerate().for_each(|(i, p)| covariance[i * (n + 1)] = *p);
    }

    /// Motion of the body, of that of the unit.
    pub fn body<S: Scalar>(&self, state: &NavigationState<S>) -> Frame<S> {
        let (lever, rotation) = (constants(self.mount.0), constants(self.mount.1));
        let attitude = multiply(state.attitude, conjugate(rotation));
        let angular_velocity = rotate(state.attitude, state.angular_velocity());
        let arm = rotate(attitude, lever);
        Frame {
            position: sub(state.position, arm),
            velocity: sub(state.velocity, cross(angular_velocity, arm)),
            attitude,
            angular_velocity,
        }
    }

    /// By how much a body at `truth` differs from an estimate: place (m, world), velocity (m/s, world), attitude (rad, about the unit's
    /// axes), `[9]`.
    pub fn error(&self, state: &NavigationState<f64>, truth: &Frame<f64>) -> [f64; 9] {
        let (lever, rotation) = self.mount;
        let arm = rotate(truth.attitude, lever);
        let off = multiply(conjugate(state.attitude), multiply(truth.attitude, rotation));
        let side = if off[0] < 0.0 { -2.0 } else { 2.0 };
        let parts = [
            sub(add(truth.position, arm), state.position),
            sub(add(truth.velocity, cross(truth.angular_velocity, arm)), state.velocity),
            [off[1] * side, off[2] * side, off[3] * side],
        ];
        std::array::from_fn(|k| parts[k / 3][k % 3])
    }

    /// eᵀ P⁻¹ e over place, velocity and attitude (NEES), P by rows: χ² with nine degrees of freedom where the estimate is consistent.
    ///
    /// # Errors
    /// [`Error::Value`] where P is not positive definite.
    pub fn squared_error(&self, state: &NavigationState<f64>, covariance: &[f64], truth: &Frame<f64>) -> Result<f64> {
        let n = self.n_error();
        let e = SVector::<f64, 9>::from(self.error(state, truth));
        let p = SMatrix::<f64, 9, 9>::from_fn(|i, j| covariance[i * n + j]);
        let Some(factor) = p.cholesky() else {
            let remedy = "Give every sensor noise of its own.";
            return Err(Error::value(
                "covariance of the estimate",
                "not positive definite",
                "positive definite",
                remedy,
            ));
        };
        Ok(e.dot(&factor.solve(&e)))
    }

    /// One sample further, recorded: the flat state, what the unit reads (specific force, rate), and by what variances its accelerometer
    /// and its gyroscope are worse than their noise; to the flat state.
    pub(super) fn recorded_prediction(&self, gravity: f64) -> Recording {
        Recording::of(self.n_flat() + 8, |z| self.further(z, gravity))
    }

    /// As [`recorded_prediction`](Self::recorded_prediction), over any scalar.
    pub(super) fn further<S: Scalar>(&self, z: &[S], gravity: f64) -> Vec<S> {
        let n_flat = self.n_flat();
        let mut state = NavigationState::read(z, self.n_bias());
        let noise = self.noise_of(z.array(n_flat + 6));
        predict(&mut state, [z.array(n_flat), z.array(n_flat + 3)], &noise, [self.between, gravity]);
        state.flat()
    }

    /// What an aid reads taken in, recorded: the flat state, the reading, gate and fading; to the flat state, ν² and whether it is taken in.
    pub(super) fn recorded_correction(&self, aid: &Aid) -> Recording {
        let (n_flat, n_bias, n) = (self.n_flat(), self.n_bias(), aid.kind.n_reading());
        Recording::of(n_flat + n + 2, |z| {
            let mut state = NavigationState::read(z, n_bias);
            let told = correct(&mut state, aid, &z[n_flat..n_flat + n], z.array(n_flat + n));
            let mut all = state.flat();
            all.extend([told.squared, told.is_taken]);
            all
        })
    }

    /// Noise of a sample whose accelerometer and gyroscope miss these variances more.
    fn noise_of<S: Scalar>(&self, added: [S; 2]) -> InertialNoise<S> {
        let more = |own: [f64; 3], added: S| own.map(|x| S::constant(x) + added);
        InertialNoise {
            accelerometer: more(self.noise.accelerometer, added[0]),
            gyroscope: more(self.noise.gyroscope, added[1]),
            biases: self.noise.biases.iter().map(|pair| pair.map(S::constant)).collect(),
        }
    }

    /// Biases beside those of the unit.
    pub fn n_bias(&self) -> usize {
        self.bias_start.len() - 6
    }

    /// n, numbers of the error.
    pub fn n_error(&self) -> usize {
        ERRORS + self.n_bias()
    }

    /// Numbers of a state's flat form.
    pub fn n_flat(&self) -> usize {
        NavigationState::<f64>::n_flat(self.n_bias())
    }
}

fn inertial_noise(imu: &Imu, between: f64, biases: &mut Biases) -> InertialNoise<f64> {
    let models = [&imu.accelerometer, &imu.gyroscope];
    for (model, name) in models.into_iter().zip(["accelerometer", "gyroscope"]) {
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            biases.all.push((format!("{name}_{letter}"), BiasProcess::of(model, axis, biases.dt)));
        }
    }
    let [accelerometer, gyroscope] =
        [0, 1].map(|k| [0, 1, 2].map(|axis| white_variance(models[k], axis, between, USUAL[k])));
    InertialNoise { accelerometer, gyroscope, biases: Vec::new() }
}

/// What sensors beside inertial units tell of the motion of the body that carries them, about its origin and in its axes; and the processes
/// of their biases, which [`Aid::bias`] counts.
///
/// # Errors
/// As [`SensorConfig::steps_between`].
pub(super) fn aids_about_the_body(configs: &[SensorConfig], dt: f64) -> Result<(Vec<ScheduledAid>, Vec<BiasProcess>)> {
    let body = SensorConfig::new("", SensorModel::Imu(Imu::default()));
    let mut biases = Biases { dt, all: Vec::new() };
    inertial_noise(&Imu::default(), dt, &mut biases);
    let (mut first, mut all) = (0, Vec::new());
    for config in configs {
        let (every, latency) = (config.steps_between(dt)?, config.steps_late(dt)?);
        for (aid, offset, valid) in aids_of(config, &body, every as f64 * dt, &mut biases) {
            let schedule = SensorSchedule { name: config.name.clone(), first: first + offset, every, latency };
            all.push(ScheduledAid { aid, schedule, valid });
        }
        first += config.model.channels().len();
    }
    Ok((all, biases.all.into_iter().skip(6).map(|(_, bias)| bias).collect()))
}

/// What a sensor tells, each with the offset of its numbers in the reading and that of `valid` behind it.
fn aids_of(
    config: &SensorConfig,
    unit: &SensorConfig,
    between: f64,
    biases: &mut Biases,
) -> Vec<(Aid, usize, Option<usize>)> {
    // from the body's frame into that of the unit
    let lever = rotate_back(unit.rotation, sub(config.position, unit.position));
    let rotation = multiply(conjugate(unit.rotation), config.rotation);
    let mut aid = |kind: AidKind, model: &ErrorModel, size: f64| {
        let n = kind.n_channel();
        let variance = (0..n).map(|axis| white_variance(model, axis, between, size)).collect();
        let bias = biases.add(&format!("{}.{}", config.name, kind.quantity()), model, n);
        Aid { kind, lever, rotation, variance, bias }
    };
    match &config.model {
        SensorModel::Gnss(own) => vec![
            (aid(AidKind::Position, &own.position_error, USUAL_LENGTH), 0, None),
            (aid(AidKind::Velocity, &own.velocity_error, USUAL_VELOCITY), 3, None),
        ],
        SensorModel::MotionCapture(own) => vec![
            (aid(AidKind::Position, &own.position_error, USUAL_LENGTH), 0, Some(7)),
            (aid(AidKind::Attitude, &own.attitude_error, USUAL_TURN), 3, Some(4)),
        ],
        SensorModel::Barometer(own) => {
            vec![(aid(AidKind::Pressure(own.clone()), &own.error, USUAL_PRESSURE), 0, None)]
        }
        SensorModel::Magnetometer(own) => {
            let size = own.field.iter().map(|b| b * b).sum::<f64>().sqrt();
            vec![(aid(AidKind::Field(own.field), &own.error, size), 0, None)]
        }
        SensorModel::Range(own) => {
            let kind = AidKind::Distance { ground: own.ground, half_cone: 0.5 * own.cone, growth: own.growth };
            vec![(aid(kind, &own.error, USUAL_LENGTH), 0, Some(1))]
        }
        SensorModel::Flow(own) => {
            let kind = AidKind::Flow { ground: own.ground, gain: between * own.pixels / own.aperture };
            vec![(aid(kind, &own.error, USUAL_PIXELS), 0, Some(2))]
        }
        SensorModel::Imu(_) | SensorModel::Contact(_) | SensorModel::Lidar(_) | SensorModel::Camera(_) => Vec::new(),
    }
}
