//! Which environments a command is about: a task, a configuration file, and what options change in it.

use super::arguments::IntegratorName;
use super::files;
use clap::{Args, ValueEnum};
use omnidrones::controllers::cascade::Level;
use omnidrones::dynamics::Integrator;
use omnidrones::error::{Error, Result};
use omnidrones::rl::TrainConfig;
use omnidrones::tasks::randomise::{Action, Distribution, Time};
use omnidrones::tasks::registry::Entry;
use omnidrones::tasks::{Change, Env, EnvConfig, Quantity, TaskSpec};
use std::path::{Path, PathBuf};

/// How environments are set up. Options win over the file, the file over the task's own defaults.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Environment")]
pub struct EnvArguments {
    /// Settings of the environments; options win over it
    ///
    /// 'omnidrones tasks TASK --toml' prints such a file with every setting and what it means.
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// What flies: a built-in vehicle ('omnidrones models'), or omav_tilting in the tasks of one drone
    #[arg(long, value_name = "NAME")]
    vehicle: Option<String>,
    /// Where actions enter the controllers
    #[arg(long, value_name = "LEVEL")]
    control: Option<LevelName>,
    /// How the equations of motion are integrated
    #[arg(long, value_name = "NAME")]
    integrator: Option<IntegratorName>,
    /// Time of a step [s] [default: 0.016]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    dt: Option<f64>,
    /// Steps of an episode [default: the task's, 500 or 600]
    #[arg(long, value_name = "STEPS")]
    horizon: Option<u32>,
    /// Another setting of the task, as in its Configuration table; may be repeated: --set n_drone=6
    #[arg(long, value_name = "KEY=VALUE", value_parser = setting)]
    set: Vec<(String, toml::Value)>,
    /// Draw a quantity anew for every episode, between two values; may be repeated: --randomise mass:0.8:1.2
    ///
    /// Factors of mass, inertia, thrust, thrust_to_weight, moment_per_thrust, motor_time, drag, angular_drag; metres added
    /// to center_of_mass; wind in m/s per axis; hidden_mass as a share of the drone's mass, hidden_height in m. A file can
    /// do more: one draw per rotor, once per environment, any physical number by its name.
    #[arg(long, value_name = "WHAT:LOW:HIGH", value_parser = change, allow_hyphen_values = true)]
    randomise: Vec<Change>,
    /// Seed of all that is drawn [default: 0]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
}

/// Names of the levels at which actions may enter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LevelName {
    /// One command per rotor
    Rotor,
    /// Body rates and thrust
    Rate,
    /// Thrust, yaw rate, roll and pitch
    Attitude,
    /// Velocity and yaw
    Velocity,
    /// Distance to go, and yaw
    Position,
}

impl From<LevelName> for Level {
    fn from(name: LevelName) -> Self {
        match name {
            LevelName::Rotor => Self::Rotor,
            LevelName::Rate => Self::Rate,
            LevelName::Attitude => Self::Attitude,
            LevelName::Velocity => Self::Velocity,
            LevelName::Position => Self::Position,
        }
    }
}

/// What `--randomise` knows, with how a drawn number acts and what it is.
pub const QUANTITIES: [(Quantity, Action, &str); 12] = [
    (Quantity::Mass, Action::Scale, "of every drone, with its inertia"),
    (Quantity::Inertia, Action::Scale, "principal moments of every drone, mass unchanged"),
    (Quantity::CenterOfMass, Action::Add, "of every drone, per axis, m"),
    (Quantity::Thrust, Action::Scale, "k_f of every rotor"),
    (Quantity::ThrustToWeight, Action::Scale, "k_f of every rotor, with the drone's mass"),
    (Quantity::MomentPerThrust, Action::Scale, "k_m/k_f of every rotor"),
    (Quantity::MotorTime, Action::Scale, "lag of every motor"),
    (Quantity::Drag, Action::Scale, "linear, of every drone"),
    (Quantity::AngularDrag, Action::Scale, "of every drone"),
    (Quantity::Wind, Action::Set, "constant, per axis, m/s, world"),
    (Quantity::HiddenMass, Action::Set, "a box stuck to every drone, share of its mass"),
    (Quantity::HiddenHeight, Action::Set, "where the hidden mass sits, m; give it first"),
];

/// As in files.
pub fn quantity_name(quantity: &Quantity) -> String {
    match toml::Value::try_from(quantity) {
        Ok(toml::Value::String(name)) => name,
        _ => String::new(),
    }
}

/// `mass:0.8:1.2`.
fn change(text: &str) -> std::result::Result<Change, String> {
    let parts: Vec<&str> = text.split(':').collect();
    let [name, low, high] = parts[..] else {
        return Err("expected WHAT:LOW:HIGH, as in mass:0.8:1.2".into());
    };
    let Some((what, by, _)) = QUANTITIES.iter().find(|(what, ..)| quantity_name(what) == name) else {
        let known = QUANTITIES.iter().map(|(what, ..)| quantity_name(what)).collect();
        return Err(Error::Unknown { kind: "quantity", name: name.into(), known }.to_string());
    };
    let number = |text: &str| text.parse::<f64>().map_err(|_| format!("'{text}' is not a number"));
    let range = [number(low)?, number(high)?];
    let change = Change {
        what: what.clone(),
        range,
        distribution: Distribution::Uniform,
        by: *by,
        when: Time::Reset,
        each: false,
    };
    change.validate().map_err(|e| e.to_string())?;
    Ok(change)
}

/// `n_drone=6`: the value as in a TOML file; a bare word is a string.
pub fn setting(text: &str) -> std::result::Result<(String, toml::Value), String> {
    let Some((key, value)) = text.split_once('=').filter(|(key, _)| !key.is_empty()) else {
        return Err("expected KEY=VALUE, as in n_drone=6".into());
    };
    let read = toml::from_str::<toml::Table>(&format!("value = {value}")).ok().and_then(|mut t| t.remove("value"));
    Ok((key.into(), read.unwrap_or_else(|| toml::Value::String(value.into()))))
}

impl EnvArguments {
    /// Whether any of them was given.
    pub fn given(&self) -> bool {
        let Self { config, vehicle, control, integrator, dt, horizon, set, randomise, seed } = self;
        let lists = !set.is_empty() || !randomise.is_empty();
        let names = config.is_some() || vehicle.is_some() || control.is_some() || integrator.is_some();
        lists || names || dt.is_some() || horizon.is_some() || seed.is_some()
    }

    /// The control level that an option names.
    pub fn level(&self) -> Option<Level> {
        self.control.map(Level::from)
    }

    /// The integrator that an option names.
    pub fn integrator(&self) -> Option<Integrator> {
        self.integrator.map(Integrator::from)
    }

    /// The configuration that was asked for. A file that says nothing of `n_env` has that of `usual`.
    pub fn config(&self, usual: &EnvConfig) -> Result<EnvConfig> {
        let mut config = match &self.config {
            None => usual.clone(),
            Some(path) => {
                let text = files::read_settings(path, "omnidrones tasks TASK --toml")?;
                check_kind(&text, path)?;
                let own = EnvConfig::from_toml(&text, &path.display().to_string())?;
                let counts = text.parse::<toml::Table>().is_ok_and(|table| table.contains_key("n_env"));
                EnvConfig { n_env: if counts { own.n_env } else { usual.n_env }, ..own }
            }
        };
        config.control = self.control.map_or(config.control, Level::from);
        config.integrator = self.integrator.map_or(config.integrator, Into::into);
        config.dt = self.dt.unwrap_or(config.dt);
        config.seed = self.seed.unwrap_or(config.seed);
        if !self.randomise.is_empty() {
            config.randomise.clone_from(&self.randomise);
        }
        if let Some(vehicle) = &self.vehicle {
            config.task.insert("vehicle".into(), vehicle.as_str().into());
        }
        if let Some(horizon) = self.horizon {
            config.task.insert("horizon".into(), i64::from(horizon).into());
        }
        config.task.extend(self.set.iter().cloned());
        config.validate()?;
        Ok(config)
    }
}

/// A file about a training run is no file about environments.
fn check_kind(text: &str, path: &Path) -> Result<()> {
    let Some(key) = TrainConfig::telling_key(text) else { return Ok(()) };
    Err(Error::Format {
        file: path.display().to_string(),
        place: key,
        rule: "is a setting of a training run, of the kind that 'train TASK --toml' prints and 'train' reads; this \
               command reads settings of environments"
            .into(),
        remedy: "Take the file that 'omnidrones tasks TASK --toml' prints; what a run has under [env] goes to its \
                 top."
            .into(),
    })
}

/// The vehicle of a task.
pub fn usual_vehicle(task: &TaskSpec) -> Option<String> {
    Some(task.settings.iter().find(|s| s.key == "vehicle")?.value.as_str()?.into())
}

/// One line per setting of an environment, in the order of a file: key, and what it means.
const KEYS: &[(&str, &str)] = &[
    ("n_env", "environments stepped together"),
    ("seed", "of all that is drawn"),
    ("first_environment", "number of the first: a shard of a larger batch gives its own"),
    ("control", "where actions enter: rotor, rate, attitude, velocity, position"),
    ("action_scale", ""),
    ("actions", "or kind = \"discrete\", \"multi_discrete\" with levels = 3"),
    ("delay", "steps between an action and its effect, drawn for every episode"),
    ("dt", "s per step"),
    ("control_rate", "computations of the control modes per step; 0: 1 for rotors, else 4"),
    ("substeps", "integrator steps per computation"),
    ("integrator", "runge_kutta4, semi_implicit"),
    ("observation", "transforms: history, noise, normalise, privileged"),
    ("randomise", "what differs between episodes"),
    ("difficulty", "share of it, 0 to 1: where a curriculum begins"),
    ("autoreset", "same_step, next_step, disabled"),
    ("stagger", "whether first episodes begin anywhere in time"),
    ("memory_limit", "bytes"),
];

/// The lines of `action_scale`.
const SCALES: &[(&str, &str)] = &[
    ("position", "what an action of 1 means in the control modes: distance per axis, m"),
    ("velocity", "per axis, m/s"),
    ("yaw", "in the levels velocity and position, rad"),
    ("rate", "of the body, per axis, rad/s"),
    ("yaw_rate", "in the level attitude, rad/s"),
    ("tilt", "roll and pitch in the level attitude, rad"),
];

/// Of a line of a file.
const WIDEST: usize = 110;

/// A configuration as a file with comments, which [`EnvConfig::from_toml`] reads back; `own` is the task's environment.
pub fn file(entry: &Entry, env: &Env, config: &EnvConfig) -> Result<String> {
    let plain = |e: toml::ser::Error| Error::value("configuration", e, "what TOML can hold", "Lower seed or limit.");
    let defaults = entry.default_config()?;
    let mut whole = config.clone();
    if whole.randomise.is_empty() {
        whole.randomise = defaults.randomise;
    }
    let table = toml::Table::try_from(&whole).map_err(plain)?;
    let mut lines: Vec<(String, String)> = Vec::new();
    for (key, meaning) in KEYS.iter().map(|(key, meaning)| (*key, meaning.to_string())) {
        match table.get(key) {
            Some(toml::Value::Array(items)) if items.len() > 1 => {
                lines.push((format!("{key} = ["), meaning));
                lines.extend(items.iter().map(|item| (format!("    {item},"), String::new())));
                lines.push(("]".into(), String::new()));
            }
            Some(toml::Value::Table(scales)) if key == "action_scale" => {
                let line = |(name, unit): &(&str, &str)| {
                    Some((format!("{key}.{name} = {}", scales.get(*name)?), unit.to_string()))
                };
                lines.extend(SCALES.iter().filter_map(line));
            }
            Some(value) => lines.push((format!("{key} = {value}"), meaning)),
            None => {}
        }
    }
    lines.push((String::new(), String::new()));
    lines.push(("[task]".into(), String::new()));
    for setting in &env.task_spec().settings {
        lines.push((format!("{} = {}", setting.key, setting.value), setting.text()));
    }
    let width = lines.iter().filter(|(_, m)| !m.is_empty()).map(|(l, _)| l.chars().count()).filter(|n| *n < 46).max();
    let width = width.unwrap_or(0);
    let mut text = format!("# {}: {}. Any line may be left out.\n", entry.name, entry.description);
    for (line, meaning) in lines {
        let remark = if meaning.is_empty() { String::new() } else { format!("  # {meaning}") };
        let whole = format!("{line:<width$}{remark}");
        // what would be too wide has its remark above
        text += &if whole.chars().count() > WIDEST { format!("# {meaning}\n{line}") } else { whole.trim_end().into() };
        text.push('\n');
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use omnidrones::tasks::registry::REGISTRY;

    #[test]
    fn the_file_of_every_task_reads_back_to_the_same_environments() {
        for entry in REGISTRY {
            let config = EnvConfig { n_env: 1, ..EnvConfig::default() };
            let env = entry.env(&config).unwrap();
            let text = file(entry, &env, &config).unwrap();
            let read = EnvConfig::from_toml(&text, entry.name).unwrap();
            let again = entry.env(&read).unwrap_or_else(|e| panic!("{}: {e}\n{text}", entry.name));
            assert_eq!(again.spec().hash(), env.spec().hash(), "{text}");
            assert_eq!(again.spec().privileged, env.spec().privileged, "{text}");
            assert_eq!(again.spec().horizon, env.spec().horizon, "{text}");
            assert_eq!(EnvConfig { task: toml::Table::new(), randomise: Vec::new(), ..read }, config, "{text}");
            let keys = toml::Table::try_from(&config).unwrap();
            assert!(keys.keys().all(|key| key == "task" || KEYS.iter().any(|(k, _)| k == key)), "{keys:?}");
        }
    }

    #[test]
    fn changes_and_settings_are_read_or_refused_with_a_reason() {
        let wind = change("wind:-2:2").unwrap();
        assert_eq!((wind.what, wind.by, wind.range), (Quantity::Wind, Action::Set, [-2.0, 2.0]));
        for (text, words) in [
            ("mass", "WHAT:LOW:HIGH"),
            ("mas:1:2", "did you mean 'mass'?"),
            ("mass:a:2", "'a' is not a number"),
            ("mass:2:1", "ordered"),
        ] {
            let refusal = change(text).unwrap_err();
            assert!(refusal.contains(words), "{text}: {refusal}");
        }
        assert_eq!(setting("n_drone=6"), Ok(("n_drone".into(), toml::Value::Integer(6))));
        assert_eq!(setting("formation=hexagon"), Ok(("formation".into(), "hexagon".into())));
        assert!(setting("=3").is_err());
    }
}
