//! Which estimators there are: one row per kind, its settings, and what all of them do.

use super::complementary::{ComplementaryFilter, ComplementarySettings};
use super::hover_kalman::{HoverKalman, HoverKalmanSettings};
use super::innovations::InnovationRecord;
use super::state_estimator::{StateEstimator, StateEstimatorSettings};
use base::error::{Error, Result};
use base::reader;
use dynamics::sensors::SensorConfig;
use dynamics::spatial::{conjugate, multiply, sub};
use dynamics::{Frame, Plant};
use rng::Stream;
use serde::{Deserialize, Serialize};

/// One kind of estimator.
pub struct EstimatorEntry {
    /// As on the command line, and as `kind` in a file.
    pub name: &'static str,
    /// What it is, in words.
    pub about: &'static str,
    /// Whether it knows how good its estimate is: a covariance, and innovations that are judged by it.
    pub has_covariance: bool,
    /// Its defaults.
    pub settings: fn() -> EstimatorSettings,
}

/// All kinds, the usual one first.
pub const ESTIMATORS: [EstimatorEntry; 3] = [
    EstimatorEntry {
        name: "ekf",
        about: "error-state Kalman filter, driven by the inertial unit",
        has_covariance: true,
        settings: || EstimatorSettings::Ekf(StateEstimatorSettings::default()),
    },
    EstimatorEntry {
        name: "complementary",
        about: "fixed gains, driven by the inertial unit",
        has_covariance: false,
        settings: || EstimatorSettings::Complementary(ComplementarySettings::default()),
    },
    EstimatorEntry {
        name: "kalman",
        about: "steady Kalman filter about hover, driven by the commands",
        has_covariance: true,
        settings: || EstimatorSettings::Kalman(HoverKalmanSettings::default()),
    },
];

/// An estimator and its settings.
///
/// As TOML its settings, with `kind` beside them; without it, `ekf`.
///
/// ```
/// # use omnidrones_controllers::omnidrones;
/// use omnidrones::controllers::estimation::EstimatorSettings;
///
/// let own: EstimatorSettings = toml::from_str("kind = 'complementary'\nattitude = 5.0").unwrap();
/// assert_eq!(own.kind(), "complementary");
/// assert!(toml::from_str::<EstimatorSettings>("kind = 'kalman'\nattitude = 5.0").is_err());
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "toml::Table", into = "toml::Table")]
pub enum EstimatorSettings {
    /// [`StateEstimator`].
    Ekf(StateEstimatorSettings),
    /// [`ComplementaryFilter`].
    Complementary(ComplementarySettings),
    /// [`HoverKalman`].
    Kalman(HoverKalmanSettings),
}

impl Default for EstimatorSettings {
    fn default() -> Self {
        Self::Ekf(StateEstimatorSettings::default())
    }
}

impl EstimatorSettings {
    /// The defaults of a kind.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the names of all.
    pub fn by_name(name: &str) -> Result<Self> {
        Ok((entry(name)?.settings)())
    }

    /// What a table of a file says; `file` names it in errors.
    ///
    /// # Errors
    /// [`Error::Unknown`] for a kind that there is not; [`Error::Format`] for keys that it does not have and values of another type.
    pub fn of(mut table: toml::Table, file: &str) -> Result<Self> {
        let kind = match table.remove("kind") {
            None => "ekf".to_string(),
            Some(kind) => reader::of_value(&kind).map_err(|fault| fault.in_table(&format!("{file}: kind")))?,
        };
        let told = match entry(&kind)?.name {
            "complementary" => reader::of_table(&table).map(Self::Complementary),
            "kalman" => reader::of_table(&table).map(Self::Kalman),
            _ => reader::of_table(&table).map(Self::Ekf),
        };
        told.map_err(|fault| fault.in_table(file))
    }

    /// Name of its kind.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Ekf(_) => "ekf",
            Self::Complementary(_) => "complementary",
            Self::Kalman(_) => "kalman",
        }
    }

    /// Checks their ranges.
    ///
    /// # Errors
    /// [`Error::Value`] for the first that is out of its range.
    pub fn validate(&self) -> Result<()> {
        match self {
            Self::Ekf(own) => own.validate(),
            Self::Complementary(own) => own.validate(),
            Self::Kalman(own) => own.validate(),
        }
    }
}

fn entry(name: &str) -> Result<&'static EstimatorEntry> {
    ESTIMATORS.iter().find(|entry| entry.name == name).ok_or_else(|| Error::Unknown {
        kind: "estimator",
        name: name.into(),
        known: ESTIMATORS.iter().map(|entry| entry.name.to_string()).collect(),
    })
}

impl TryFrom<toml::Table> for EstimatorSettings {
    type Error = Error;

    fn try_from(table: toml::Table) -> Result<Self> {
        Self::of(table, "estimator")
    }
}

impl From<EstimatorSettings> for toml::Table {
    fn from(settings: EstimatorSettings) -> Self {
        let own = match &settings {
            EstimatorSettings::Ekf(own) => Self::try_from(own),
            EstimatorSettings::Complementary(own) => Self::try_from(own),
            EstimatorSettings::Kalman(own) => Self::try_from(own),
        };
        let mut table = Self::new();
        table.insert("kind".into(), settings.kind().into());
        table.extend(own.unwrap_or_default());
        table
    }
}

impl From<StateEstimatorSettings> for EstimatorSettings {
    fn from(settings: StateEstimatorSettings) -> Self {
        Self::Ekf(settings)
    }
}

/// An estimator of any kind.
#[derive(Debug, Clone)]
pub enum Estimator {
    /// Error-state Kalman filter.
    Ekf(Box<StateEstimator>),
    /// With fixed gains.
    Complementary(Box<ComplementaryFilter>),
    /// The steady one about hover.
    Kalman(Box<HoverKalman>),
}

impl Estimator {
    /// For a plant that carries these sensors.
    ///
    /// # Errors
    /// As the estimator.
    pub fn new(plant: &Plant, sensors: &[SensorConfig], settings: &EstimatorSettings) -> Result<Self> {
        let (dt, gravity) = (plant.physics().dt, plant.parameters()[0]);
        Ok(match settings {
            EstimatorSettings::Ekf(own) => Self::Ekf(Box::new(StateEstimator::new(sensors, own, dt, gravity)?)),
            EstimatorSettings::Complementary(own) => {
                Self::Complementary(Box::new(ComplementaryFilter::new(sensors, own, dt, gravity)?))
            }
            EstimatorSettings::Kalman(own) => Self::Kalman(Box::new(HoverKalman::new(plant, sensors, own)?)),
        })
    }

    /// Begins a flight in a state of the plant; one with deviations to begin with knows it to these, as drawn.
    pub fn begin(&mut self, state: &[f64], draw: &mut Stream) {
        let known = Frame::of_vehicle(state);
        match self {
            Self::Ekf(own) => {
                let begins = own.settings().drawn(&known, draw);
                own.begin(&begins);
            }
            Self::Complementary(own) => own.begin(&known),
            Self::Kalman(own) => own.begin(state),
        }
    }

    /// One step of the simulation further: takes in what is new among all readings.
    pub fn step(&mut self, readings: &[f64]) {
        match self {
            Self::Ekf(own) => own.step(readings),
            Self::Complementary(own) => own.step(readings),
            Self::Kalman(own) => own.step(readings),
        }
    }

    /// Goes on under the input that the plant is given, for those that commands drive.
    pub fn apply(&mut self, input: &[f64]) {
        if let Self::Kalman(own) = self {
            own.apply(input);
        }
    }

    /// Pose and velocities of the body, velocity and angular velocity in the world.
    pub fn estimate(&self) -> Frame<f64> {
        match self {
            Self::Ekf(own) => own.estimate(),
            Self::Complementary(own) => own.estimate(),
            Self::Kalman(own) => Frame::of_vehicle(own.state()),
        }
    }

    /// Steps that the state stands behind the present which [`squared_error`](Self::squared_error) judges.
    pub fn late(&self) -> usize {
        match self {
            Self::Ekf(own) => own.late(),
            Self::Complementary(_) | Self::Kalman(_) => 0,
        }
    }

    /// How often it began anew, knowing nothing.
    pub fn begun_anew(&self) -> u64 {
        match self {
            Self::Ekf(own) => own.begun_anew(),
            Self::Complementary(_) | Self::Kalman(_) => 0,
        }
    }

    /// Speeds of the rotors, rad/s, of those that estimate them.
    pub fn rotor_speeds(&self) -> Option<&[f64]> {
        match self {
            Self::Kalman(own) => Some(&own.state()[13..]),
            Self::Ekf(_) | Self::Complementary(_) => None,
        }
    }

    /// By how much a body at `truth` differs from the present estimate: place (m, world), velocity (m/s, world), attitude (rad, its axes), `[9]`.
    pub fn error(&self, truth: &Frame<f64>) -> [f64; 9] {
        body_error(&self.estimate(), truth)
    }

    /// eᵀ P⁻¹ e over place, velocity and attitude (NEES), of those that have a covariance; `truth` is that of [`late`](Self::late) steps ago.
    pub fn squared_error(&self, truth: &Frame<f64>) -> Option<f64> {
        match self {
            Self::Ekf(own) => Some(own.squared_error(truth).unwrap_or(f64::NAN)),
            Self::Complementary(_) => None,
            Self::Kalman(own) => Some(own.squared_error(truth)),
        }
    }

    /// Standard deviations of place (m), velocity (m/s) and attitude (rad), of those that have a covariance.
    pub fn deviations(&self) -> Option<[f64; 9]> {
        match self {
            Self::Ekf(own) => Some(own.deviations()),
            Self::Complementary(_) => None,
            Self::Kalman(own) => Some(std::array::from_fn(|k| own.covariance()[(k, k)].max(0.0).sqrt())),
        }
    }

    /// How readings agreed with what was expected, sensor by sensor; none without a covariance.
    pub fn records(&self) -> &[InnovationRecord] {
        match self {
            Self::Ekf(own) => own.records(),
            Self::Complementary(_) => &[],
            Self::Kalman(own) => own.records(),
        }
    }

    /// Samples of the inertial unit at a limit or no numbers.
    pub fn saturated(&self) -> u64 {
        match self {
            Self::Ekf(own) => own.saturated(),
            Self::Complementary(own) => own.saturated(),
            Self::Kalman(_) => 0,
        }
    }

    /// Name of its kind.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Ekf(_) => "ekf",
            Self::Complementary(_) => "complementary",
            Self::Kalman(_) => "kalman",
        }
    }
}

/// By how much a body at `truth` differs from an estimate: place, velocity (world), attitude (about the axes of the estimate).
pub(super) fn body_error(estimate: &Frame<f64>, truth: &Frame<f64>) -> [f64; 9] {
    let off = multiply(conjugate(estimate.attitude), truth.attitude);
    let side = if off[0] < 0.0 { -2.0 } else { 2.0 };
    let parts = [
        sub(truth.position, estimate.position),
        sub(truth.velocity, estimate.velocity),
        [off[1] * side, off[2] * side, off[3] * side],
    ];
    std::array::from_fn(|k| parts[k / 3][k % 3])
}

#[cfg(test)]
mod tests;
