//! Settings of a sensor, as a `[[sensor]]` table of a TOML file.

use super::fault::SensorFault;
use super::gradient::SensorGradient;
use super::kinds::{SensorKind, SensorModel};
use super::limits::{positive, within};
use super::presets::{Preset, preset};
use crate::spatial::{Quat, Vec3};
use base::error::{Error, Result};
use base::reader;
use serde::{Deserialize, Serialize};

/// Largest number of steps between two samples.
const MAX_EVERY: u64 = 1_000_000;
/// Largest latency, steps.
const MAX_LATENCY: u64 = 1_000_000;
/// By how much of itself the time between samples may miss a whole number of steps.
const MISSED: f64 = 0.25;
/// Longest name, characters.
const MAX_NAME: usize = 64;

/// One sensor: what it measures, where, how often, how late, how wrongly.
///
/// As TOML, the keys below beside those of its kind; what a `preset` says holds unless the table says otherwise, and without
/// one a sensor has no errors.
///
/// ```
/// # use omnidrones_dynamics::omnidrones;
/// use omnidrones::dynamics::sensors::SensorConfig;
///
/// let imu: SensorConfig = toml::from_str(r#"
///     name = "imu"
///     kind = "imu"
///     preset = "bmi088"
///     position = [0.02, 0.0, 0.01]
///     latency = 1
///     accelerometer = { density = 2e-3 }
/// "#).unwrap();
/// assert_eq!(imu.latency, Some(1));
/// assert!(toml::from_str::<SensorConfig>("name = 'imu'\nkind = 'imu'\npreset = 'bmi880'").is_err());
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "toml::Table", into = "toml::Table")]
pub struct SensorConfig {
    /// Unique among the sensors; begins the names of its columns. Its noise depends on this name, not on its place.
    pub name: String,
    /// Body that carries it; the first unless given.
    pub on: Option<String>,
    /// Of the mount, from the body's origin, m, body axes.
    pub position: Vec3<f64>,
    /// Unit quaternion `[w, x, y, z]`, mount → body.
    pub rotation: Quat<f64>,
    /// Steps from one sample to the next; 1 where there is no `rate` either.
    pub every: Option<u64>,
    /// The same in Hz, to the nearest whole number of steps.
    pub rate: Option<f64>,
    /// Steps from a sample to its reading; 0 where there is no `delay` either.
    pub latency: Option<u64>,
    /// The same in s, to the nearest whole number of steps.
    pub delay: Option<f64>,
    /// What gradients know of its readings; more than nothing for lidars, range finders and cameras that show depth, read in
    /// every step and at once.
    pub gradient: SensorGradient,
    /// What happens to it, when.
    pub faults: Vec<SensorFault>,
    /// What it measures and how wrongly.
    pub model: SensorModel,
}

impl SensorConfig {
    /// A sensor at the origin of the first body, in every step, at once.
    pub fn new(name: impl Into<String>, model: SensorModel) -> Self {
        Self {
            name: name.into(),
            on: None,
            position: [0.0; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            every: None,
            rate: None,
            latency: None,
            delay: None,
            gradient: SensorGradient::None,
            faults: Vec::new(),
            model,
        }
    }

    /// As a preset says, with its rate and delay.
    pub fn of_preset(name: impl Into<String>, preset: &Preset) -> Self {
        Self { rate: preset.rate, delay: preset.delay, ..Self::new(name, (preset.model)()) }
    }

    /// Sensors in short: `imu:bmi088,gnss`, each a kind and, after a colon, a preset; named after their kinds.
    ///
    /// # Errors
    /// [`Error::Unknown`] for a kind or a preset that nobody knows.
    pub fn parse_list(text: &str) -> Result<Vec<Self>> {
        let one = |item: &str| {
            let (kind, part) = item.split_once(':').map_or((item, None), |(kind, part)| (kind, Some(part)));
            let kind = SensorKind::by_name(kind.trim())?;
            Ok(match part {
                Some(part) => Self::of_preset(kind.name, preset(kind.name, part.trim())?),
                None => Self::new(kind.name, kind.ideal()),
            })
        };
        text.split(',').map(one).collect()
    }

    /// Steps from one sample to the next where a step takes `dt` seconds.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] for `every` and `rate` together, and for steps and rates that are none or do not
    /// come within a quarter of a whole number of steps.
    pub fn steps_between(&self, dt: f64) -> Result<u64> {
        match (self.every, self.rate) {
            (Some(_), Some(_)) => Err(self.twice("every and rate")),
            (None, None) => Ok(1),
            (Some(every), None) if (1..=MAX_EVERY).contains(&every) => Ok(every),
            (Some(every), None) => {
                let limit = format!("1 to {MAX_EVERY}");
                Err(Error::limit(self.at("every"), every, limit, "Give steps from one sample to the next."))
            }
            (None, Some(rate)) => {
                positive(&self.at("rate"), rate, "Give samples per second.")?;
                self.at_rate(rate, dt)
            }
        }
    }

    /// Steps from a sample to its reading where a step takes `dt` seconds.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] for `latency` and `delay` together, and for those that are none or too long.
    pub fn steps_late(&self, dt: f64) -> Result<u64> {
        match (self.latency, self.delay) {
            (Some(_), Some(_)) => Err(self.twice("latency and delay")),
            (None, None) => Ok(0),
            (Some(latency), None) if latency <= MAX_LATENCY => Ok(latency),
            (Some(latency), None) => {
                let limit = format!("0 to {MAX_LATENCY}");
                Err(Error::limit(self.at("latency"), latency, limit, "Give steps from a sample to its reading."))
            }
            (None, Some(delay)) => {
                within(&self.at("delay"), delay, 0.0, MAX_LATENCY as f64 * dt)?;
                Ok((delay / dt).round() as u64)
            }
        }
    }

    /// Refuses slopes of kinds that have none, and of samples that are read in other steps than they were taken in.
    pub(crate) fn check_gradient(&self, every: u64, latency: u64) -> Result<()> {
        if self.gradient == SensorGradient::None {
            return Ok(());
        }
        if !self.model.has_slopes() {
            let limit =
                format!("none for a {}; lidar, range, and camera with show = \"depth\" have pose", self.model.kind());
            return Err(Error::value(
                self.at("gradient"),
                "pose",
                limit,
                "Leave gradient out: its readings are constants.",
            ));
        }
        if every == 1 && latency == 0 {
            return Ok(());
        }
        let value = format!("pose, a sample every {every} steps, read {latency} steps later");
        let remedy = "Give every = 1 and latency = 0, or leave gradient out.";
        Err(Error::value(self.at("gradient"), value, "pose of what is sampled in every step and read at once", remedy))
    }

    /// The nearest whole number of steps, unless that is another rate altogether.
    fn at_rate(&self, rate: f64, dt: f64) -> Result<u64> {
        let steps = 1.0 / (rate * dt);
        let whole = steps.round().max(1.0);
        if whole <= MAX_EVERY as f64 && (whole - steps).abs() <= MISSED * steps {
            return Ok(whole as u64);
        }
        let limit = format!("{} to {} Hz, to within a quarter", 1.0 / (MAX_EVERY as f64 * dt), 1.0 / dt);
        let remedy = "Give a smaller dt, or in a table every, the number of steps between two samples.";
        Err(Error::value(self.at("rate"), format!("{rate} Hz"), limit, remedy))
    }

    fn twice(&self, keys: &str) -> Error {
        let remedy = "Leave one out: they say the same in steps and in SI units.";
        Error::value(self.at(keys), "both given", "one of them", remedy)
    }

    fn at(&self, key: &str) -> String {
        format!("{}: {key}", self.place())
    }

    /// How errors call it.
    #[doc(hidden)]
    pub fn place(&self) -> String {
        format!("sensor '{}'", self.name)
    }

    /// Refuses names that cannot stand in the head of a table.
    pub(crate) fn check_name(&self) -> Result<()> {
        let fits = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
        if (1..=MAX_NAME).contains(&self.name.len()) && self.name.chars().all(fits) {
            return Ok(());
        }
        let limit = format!("1 to {MAX_NAME} of A-Z, a-z, 0-9, _ - . /");
        let name = self.name.chars().take(2 * MAX_NAME).collect::<String>();
        Err(Error::value("sensor: name", format!("'{name}'"), limit, "It begins the names of its columns."))
    }
}

/// The keys that every kind has.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Common {
    name: String,
    kind: String,
    preset: Option<String>,
    on: Option<String>,
    position: Option<Vec3<f64>>,
    rotation: Option<Quat<f64>>,
    every: Option<u64>,
    rate: Option<f64>,
    latency: Option<u64>,
    delay: Option<f64>,
    gradient: Option<SensorGradient>,
    faults: Option<Vec<SensorFault>>,
}

/// Of [`Common`].
pub(crate) const COMMON: [&str; 12] =
    ["name", "kind", "preset", "on", "position", "rotation", "every", "rate", "latency", "delay", "gradient", "faults"];

impl TryFrom<toml::Table> for SensorConfig {
    type Error = Error;

    fn try_from(mut table: toml::Table) -> Result<Self> {
        let named = table.get("name").and_then(toml::Value::as_str).unwrap_or("without a name");
        let place = format!("[[sensor]] '{named}'");
        let mut common = toml::Table::new();
        for key in COMMON {
            if let Some(value) = table.remove(key) {
                common.insert(key.into(), value);
            }
        }
        let common: Common = reader::of_table(&common).map_err(|fault| fault.in_table(&place))?;
        let kind = SensorKind::by_name(&common.kind)?;
        let base = match &common.preset {
            Some(name) => Self::of_preset(&common.name, preset(kind.name, name)?),
            None => Self::new(&common.name, kind.ideal()),
        };
        let mut settings = base.model.table();
        known_keys(&place, kind, &table)?;
        lay_over(&mut settings, table);
        Ok(Self {
            on: common.on,
            position: common.position.unwrap_or(base.position),
            rotation: common.rotation.unwrap_or(base.rotation),
            // who counts in steps does not want the preset's seconds
            rate: common.rate.or(base.rate.filter(|_| common.every.is_none())),
            delay: common.delay.or(base.delay.filter(|_| common.latency.is_none())),
            every: common.every,
            latency: common.latency,
            gradient: common.gradient.unwrap_or_default(),
            faults: common.faults.unwrap_or_default(),
            model: kind.read(settings, &place)?,
            name: common.name,
        })
    }
}

/// Refuses a key that neither the kind nor all kinds have.
fn known_keys(place: &str, kind: &SensorKind, table: &toml::Table) -> Result<()> {
    let own = kind.ideal().table();
    let known: Vec<String> =
        own.keys().map(String::as_str).chain(kind.optional.iter().copied()).chain(COMMON).map(String::from).collect();
    match table.keys().find(|key| !known.contains(key)) {
        None => Ok(()),
        Some(key) => Err(Error::unknown_key(place, key, &known)),
    }
}

/// Key by key, tables within tables.
fn lay_over(below: &mut toml::Table, above: toml::Table) {
    for (key, value) in above {
        match (below.get_mut(&key), value) {
            (Some(toml::Value::Table(below)), toml::Value::Table(above)) => lay_over(below, above),
            (_, value) => {
                below.insert(key, value);
            }
        }
    }
}

impl From<SensorConfig> for toml::Table {
    fn from(config: SensorConfig) -> Self {
        let common = Common {
            kind: config.model.kind().into(),
            preset: None,
            name: config.name,
            on: config.on,
            position: Some(config.position),
            rotation: Some(config.rotation),
            every: config.every,
            rate: config.rate,
            latency: config.latency,
            delay: config.delay,
            // what says nothing of gradients is written as it always was
            gradient: (config.gradient != SensorGradient::None).then_some(config.gradient),
            faults: Some(config.faults).filter(|faults| !faults.is_empty()),
        };
        let mut table = Self::try_from(&common).unwrap_or_default();
        table.extend(config.model.table());
        table
    }
}

/// A file of sensors: `[[sensor]]` tables.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorFile {
    /// In the order of their columns.
    pub sensor: Vec<SensorConfig>,
}

impl SensorFile {
    /// The tables of a file that was read; `file` names it in errors.
    ///
    /// # Errors
    /// [`Error::Format`] for keys that mean nothing there and values of another type; [`Error::Unknown`] for a kind or a preset
    /// that nobody knows.
    pub fn of(mut table: toml::Table, file: &str) -> Result<Self> {
        let tables = table.remove("sensor").unwrap_or_else(|| toml::Value::Array(Vec::new()));
        if let Some(key) = table.keys().next() {
            return Err(Error::unknown_key(file, key, &["sensor".into()]));
        }
        let tables: Vec<toml::Table> = reader::of_value(&tables).map_err(|fault| fault.in_table(file))?;
        // the table's own error, told as what it is and not as a word of the parser
        let read = |table| SensorConfig::try_from(table).map_err(|error| in_file(error, file));
        Ok(Self { sensor: tables.into_iter().map(read).collect::<Result<_>>()? })
    }
}

/// With the name of the file before that of the table.
fn in_file(error: Error, name: &str) -> Error {
    match error {
        Error::Format { file, place, rule, remedy } => {
            Error::Format { file: format!("{name}: {file}"), place, rule, remedy }
        }
        other => other,
    }
}
