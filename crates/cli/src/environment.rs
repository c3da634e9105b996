//! Which environments a command is about: a task, a configuration file, and what options change in it.

use super::arguments::{self, IntegratorName, VehicleArguments, is_path};
use super::source;
use crate::prelude::*;
use clap::Args;
use omnidrones::controllers::cascade::Level;
use omnidrones::dynamics::{Integrator, vehicles};
use omnidrones::layers::{self, Layer};
use omnidrones::rl::TrainConfig;
use omnidrones::tasks::config::TILTING;
use omnidrones::tasks::randomise::{Distribution, RandomisationOperation, RandomisationTime};
use omnidrones::tasks::registry::{self, TaskEntry};
use omnidrones::tasks::{Env, EnvConfig, Randomisation, RandomisedQuantity, TaskSpec};
use toml::Value;

/// How environments are set up. Options win over the file, the file over the task's own defaults.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Environment")]
pub struct EnvArguments {
    /// Settings; options win over it
    ///
    /// 'omnidrones tasks TASK --toml' prints such a file with every setting of the environments and what it means,
    /// 'omnidrones train TASK --toml' one with those of training too. Every command reads both.
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// What flies: a built-in vehicle ('omnidrones models'), a file FILE.toml or FILE.urdf, or omav_tilting in the tasks
    /// of one drone
    ///
    /// A run keeps the numbers of a file, so that it goes on and is evaluated without it.
    #[arg(long, value_name = "NAME|FILE")]
    vehicle: Option<String>,
    /// Where actions enter the controllers
    #[arg(long, value_name = "LEVEL", value_parser = arguments::one_of(&LEVELS))]
    control: Option<Level>,
    /// How the equations of motion are integrated
    #[arg(long, value_name = "NAME")]
    integrator: Option<IntegratorName>,
    /// Time of a step [s] [default: 0.016]
    #[arg(long, value_name = "SECONDS")]
    dt: Option<f64>,
    /// Steps of an episode [default: the task's, 500 or 600]
    #[arg(long, value_name = "STEPS")]
    horizon: Option<u32>,
    /// Any setting by its name in a file; may be repeated: --set n_drone=6
    ///
    /// A name is looked up in the run (apg.horizon), in its environments (substeps), in the task (horizon).
    #[arg(long, value_name = "KEY=VALUE", value_parser = setting)]
    set: Vec<(String, Value)>,
    /// Draw a quantity anew for every episode, between two values; may be repeated: --randomise mass:0.8:1.2
    ///
    /// Factors of mass, inertia, thrust, thrust_to_weight, moment_per_thrust, motor_time, drag, angular_drag; metres added
    /// to center_of_mass; wind in m/s per axis; hidden_mass as a share of the drone's mass, hidden_height in m. A file can
    /// do more: one draw per rotor, once per environment, any physical number by its name.
    #[arg(long, value_name = "WHAT:LOW:HIGH", value_parser = change, allow_hyphen_values = true)]
    randomise: Vec<Randomisation>,
    /// Seed of all that is drawn [default: 0]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
}

/// The levels at which actions may enter, with what an action is there.
const LEVELS: [(&str, &str, Level); 5] = [
    ("rotor", "One command per rotor", Level::Rotor),
    ("rate", "Body rates and thrust", Level::Rate),
    ("attitude", "Thrust, yaw rate, roll and pitch", Level::Attitude),
    ("velocity", "Velocity and yaw", Level::Velocity),
    ("position", "Distance to go, and yaw", Level::Position),
];

/// What `--randomise` knows, with how a drawn number acts and what it is.
pub const QUANTITIES: [(RandomisedQuantity, RandomisationOperation, &str); 12] = [
    (RandomisedQuantity::Mass, RandomisationOperation::Scale, "of every drone, with its inertia"),
    (RandomisedQuantity::Inertia, RandomisationOperation::Scale, "principal moments of every drone, mass unchanged"),
    (RandomisedQuantity::CenterOfMass, RandomisationOperation::Add, "of every drone, per axis, m"),
    (RandomisedQuantity::Thrust, RandomisationOperation::Scale, "k_f of every rotor"),
    (RandomisedQuantity::ThrustToWeight, RandomisationOperation::Scale, "k_f of every rotor, with the drone's mass"),
    (RandomisedQuantity::MomentPerThrust, RandomisationOperation::Scale, "k_m/k_f of every rotor"),
    (RandomisedQuantity::MotorTime, RandomisationOperation::Scale, "lag of every motor"),
    (RandomisedQuantity::Drag, RandomisationOperation::Scale, "linear, of every drone"),
    (RandomisedQuantity::AngularDrag, RandomisationOperation::Scale, "of every drone"),
    (RandomisedQuantity::Wind, RandomisationOperation::Set, "constant, per axis, m/s, world"),
    (RandomisedQuantity::HiddenMass, RandomisationOperation::Set, "a box stuck to every drone, share of its mass"),
    (RandomisedQuantity::HiddenHeight, RandomisationOperation::Set, "where the hidden mass sits, m; give it first"),
];

/// As in files.
pub fn quantity_name(quantity: &RandomisedQuantity) -> String {
    match toml::Value::try_from(quantity) {
        Ok(toml::Value::String(name)) => name,
        _ => String::new(),
    }
}

/// `mass:0.8:1.2`.
fn change(text: &str) -> std::result::Result<Randomisation, String> {
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
    let change = Randomisation {
        what: what.clone(),
        range,
        distribution: Distribution::Uniform,
        by: *by,
        when: RandomisationTime::Reset,
        each: false,
    };
    change.validate().map_err(|e| e.to_string())?;
    Ok(change)
}

/// `n_drone=6`: the value as in a TOML file; a bare word is a string.
pub fn setting(text: &str) -> std::result::Result<(String, Value), String> {
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

    /// What flies.
    pub fn vehicle(&self) -> Option<&str> {
        self.vehicle.as_deref()
    }

    /// Time of a step, s.
    pub fn dt(&self) -> Option<f64> {
        self.dt
    }

    /// The integrator's name.
    pub fn integrator_name(&self) -> Option<IntegratorName> {
        self.integrator
    }

    /// Whether physics were asked for.
    pub fn has_physics(&self) -> bool {
        self.dt.is_some() || self.integrator.is_some()
    }

    /// Whether settings of tasks were given.
    pub fn has_settings(&self) -> bool {
        let lists = !self.set.is_empty() || !self.randomise.is_empty();
        self.config.is_some() || lists || self.control.is_some() || self.horizon.is_some()
    }

    /// The control level that an option names.
    pub fn level(&self) -> Option<Level> {
        self.control
    }

    /// The integrator that an option names.
    pub fn integrator(&self) -> Option<Integrator> {
        self.integrator.map(Integrator::from)
    }

    /// The seed that an option names.
    pub fn seed(&self) -> Option<u64> {
        self.seed
    }

    /// The file; `maker` is the command that prints one.
    pub fn file(&self, maker: &str) -> Result<Option<Layer>> {
        let Some(path) = &self.config else { return Ok(None) };
        Layer::of_text(&files::read_settings(path, maker)?, &path.display().to_string()).map(Some)
    }

    /// The options as layers in the form of a run: settings of environments under `env`. `task` has the last word on what
    /// its own settings are.
    pub fn options(&self, task: Option<&TaskEntry>, algorithm: Option<&str>) -> Result<Vec<Layer>> {
        let mut layers = Vec::new();
        let mut option = |name: &str, path: &str, value: Value| {
            layers.push(Layer::of_table(name, layers::at(path, value)));
        };
        for (key, value) in &self.set {
            option(&format!("--set {key}"), &place(key, task, algorithm)?, value.clone());
        }
        if let Some(named) = &self.vehicle {
            if is_file(named) {
                let source = source::to_use(Some(named), &VehicleArguments { rotors: None, package: Vec::new() })?;
                for verdict in source::verdicts(&source.vehicle) {
                    eprintln!("warning: {}", shown(&verdict));
                }
                let own = Value::try_from(&source.vehicle).map_err(unwritable)?;
                option("--vehicle", "env.own_vehicle", own);
                option("--vehicle", "env.task.vehicle", source.vehicle.name.into());
            } else {
                option("--vehicle", "env.task.vehicle", named.as_str().into());
            }
        }
        if let Some(level) = self.level() {
            option("--control", "env.control", level.name().into());
        }
        if let Some(integrator) = self.integrator() {
            option("--integrator", "env.integrator", Value::try_from(integrator).map_err(unwritable)?);
        }
        if let Some(dt) = self.dt {
            option("--dt", "env.dt", dt.into());
        }
        if let Some(horizon) = self.horizon {
            option("--horizon", "env.task.horizon", i64::from(horizon).into());
        }
        if !self.randomise.is_empty() {
            option("--randomise", "env.randomise", Value::try_from(&self.randomise).map_err(unwritable)?);
        }
        if let Some(seed) = self.seed {
            let seed = i64::try_from(seed).map_err(|_| too_large(seed))?;
            option("--seed", "seed", seed.into());
        }
        Ok(layers)
    }

    /// The environments that were asked for: options over the file, the file over `usual`.
    pub fn config(&self, usual: &EnvConfig, task: Option<&TaskEntry>) -> Result<EnvConfig> {
        let own = self.file("omnidrones tasks TASK --toml")?.map(|file| of_environments(file, task)).transpose()?;
        let options = self.options(task, None)?.into_iter().map(|option| of_environments(option, task));
        let layers = own.into_iter().map(Ok).chain(options).collect::<Result<Vec<_>>>()?;
        let config: EnvConfig = layers::read(toml::Table::try_from(usual).map_err(unwritable)?, &layers)?;
        config.validate()?;
        Ok(config)
    }
}

/// Whether `--vehicle` means a file: everything else is a name.
fn is_file(named: &str) -> bool {
    is_path(named) && !vehicles::names().iter().any(|name| name.eq_ignore_ascii_case(named)) && named != TILTING
}

fn too_large(seed: u64) -> Error {
    Error::limit("seed", seed, i64::MAX, "Files hold no larger ones.")
}

fn unwritable(error: toml::ser::Error) -> Error {
    Error::value("configuration", error, "what TOML can hold", "Lower the seed or the limit of memory.")
}

/// Where a key of `--set` stands in a run: as it is if a run has it, under `env` if environments have it, else among the
/// settings of the task. One that is none of them is told with what it may mean where that `algorithm`, or the usual one, trains.
pub fn place(key: &str, task: Option<&TaskEntry>, algorithm: Option<&str>) -> Result<String> {
    let (first, rest) = key.split_once('.').map_or((key, None), |(first, rest)| (first, Some(rest)));
    let (run, env) = (TrainConfig::keys(), EnvConfig::keys());
    let has = |keys: &[String]| keys.iter().any(|own| own == first);
    match first {
        "task" if rest.is_some() => Ok(format!("env.{key}")),
        _ if has(&run) => Ok(key.into()),
        _ if has(&env) => Ok(format!("env.{key}")),
        _ => {
            let own = task.map(settings_of).transpose()?;
            match own {
                Some(own) if !has(&own) => {
                    let found = task.map(|task| below(first, rest, task, algorithm)).transpose()?.flatten();
                    if let Some(found) = found {
                        let limit = "a setting of the run, of its environments or of the task";
                        let remedy = format!(
                            "Did you mean '{found}'? 'omnidrones train TASK --toml' prints all with their tables."
                        );
                        return Err(Error::value("--set", format!("'{key}', which stands in a table"), limit, remedy));
                    }
                    let mut known: Vec<String> = own.into_iter().chain(env).chain(run).collect();
                    known.sort();
                    known.dedup();
                    Err(Error::Unknown { kind: "setting", name: first.into(), known })
                }
                _ => Ok(format!("env.task.{key}")),
            }
        }
    }
}

/// Where a key stands in a table of a run of the task by an algorithm, or of the environments: by its own name, or the
/// beginnings of its words. Of a choice that is the number that it begins with.
fn below(key: &str, rest: Option<&str>, task: &TaskEntry, algorithm: Option<&str>) -> Result<Option<String>> {
    fn walk(path: &str, table: &toml::Table, to: &mut Vec<String>) {
        for (key, value) in table {
            let own = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
            match value {
                Value::Table(inner) => walk(&own, inner, to),
                _ => to.push(own),
            }
        }
    }
    let text = TrainConfig::for_task(task.name, algorithm, None)?.to_toml()?;
    let table = Layer::of_text(&text, "settings")?.table().clone();
    let mut all = Vec::new();
    walk("", &table, &mut all);
    let lower = key.to_lowercase();
    let initials = |part: &str| part.split('_').filter_map(|word| word.chars().next()).collect::<String>();
    let by = |is: &dyn Fn(&str) -> bool| {
        let path = all.iter().find_map(|path| {
            let parts: Vec<&str> = path.split('.').collect();
            let at = parts.iter().position(|part| is(part)).filter(|at| *at > 0)?;
            Some(parts[..=at].join("."))
        })?;
        let inner: Vec<&str> = all.iter().filter_map(|own| own.strip_prefix(&format!("{path}."))).collect();
        let first = ["from", "value"].into_iter().find(|own| inner.contains(own));
        let end = rest.or(first).map_or(String::new(), |rest| format!(".{rest}"));
        Some(path + &end)
    };
    Ok(by(&|part| part == lower).or_else(|| by(&|part| lower.len() > 1 && initials(part) == lower)))
}

/// Names of the settings of a task.
fn settings_of(entry: &TaskEntry) -> Result<Vec<String>> {
    let env = entry.env(&EnvConfig { n_env: 1, ..EnvConfig::default() })?;
    Ok(env.task_spec().settings.iter().map(|setting| setting.key.clone()).collect())
}

/// What a layer says of environments. Settings of training in a file are for others; as an option they are a mistake.
fn of_environments(layer: Layer, task: Option<&TaskEntry>) -> Result<Layer> {
    let env = EnvConfig::keys();
    let run = TrainConfig::keys();
    let of_run = |(key, value): (&String, &Value)| match key.as_str() {
        "task" => value.is_str(),
        _ => run.contains(key) && !env.contains(key),
    };
    if !layer.table().iter().any(of_run) {
        return Ok(layer);
    }
    if let (Some(named), Some(task)) = (layer.table().get("task").and_then(Value::as_str), task) {
        let named = registry::by_name(named)?.name;
        if named != task.name {
            let (rule, remedy) = (
                format!("the settings are for {named}, but the task is {}", task.name),
                "Name that task, or change the line.".to_string(),
            );
            return Err(Error::Format { file: layer.name().into(), place: "task".into(), rule, remedy });
        }
    }
    // every key is known, also those that only a run reads
    TrainConfig::check(&layer.clone().map(TrainConfig::lifted))?;
    if let (Some(option), Some(key)) = (layer.name().strip_prefix("--set "), layer.table().keys().next())
        && key != "env"
        && key != "seed"
    {
        let limit = "one of environments or of the task";
        return Err(Error::value(
            format!("--set {option}"),
            "a setting of training",
            limit,
            "Leave it out: this command trains nothing.",
        ));
    }
    Ok(layer.map(|table| {
        let mut table = TrainConfig::lifted(table);
        let mut own = toml::Table::from_iter(table.remove_entry("seed"));
        layers::merge(&mut own, table.remove("env").and_then(|env| env.as_table().cloned()).unwrap_or_default());
        own
    }))
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
    ("residual", "how far an action of 1 changes what our controller commands, of [-1, 1]; 0: no controller"),
    ("actions", "or kind = \"discrete\", \"multi_discrete\" with levels = 3"),
    ("delay", "steps between an action and its effect, drawn for every episode"),
    ("dt", "s per step"),
    ("control_rate", "computations of the control modes per step; 0: 1 for rotors, else 4"),
    ("substeps", "integrator steps per computation"),
    ("integrator", "rk4, semi_implicit"),
    ("observation", "transforms: history, noise, normalise, privileged"),
    ("randomise", "what differs between episodes"),
    ("difficulty", "share of it, 0 to 1: where a curriculum begins"),
    ("easier", "share of the episodes whose difficulty is drawn between 0 and that"),
    ("bounds", ""),
    ("autoreset", "same_step, next_step, disabled"),
    ("stagger", "whether first episodes begin anywhere in time"),
    ("truncate_after", "mean steps after which episodes are truncated at random; 0: at the horizon alone"),
    ("info", "columns that are told, by name; none for all"),
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

/// The lines of `bounds`.
const BOUNDS: &[(&str, &str)] = &[
    ("distance", "a coordinate beyond it ends the episode as diverged, m"),
    ("speed", "likewise a velocity, m/s"),
    ("rate", "likewise an angular velocity or the rate of a joint, rad/s"),
    ("angle", "likewise the angle of a joint, rad"),
    ("loss", "the training loss of a step is cut here"),
];

/// A run's configuration as a file with comments, which `train --config` reads back to the same run.
pub fn run_file(entry: &TaskEntry, config: &TrainConfig) -> Result<String> {
    let text = config.to_toml()?;
    let env = entry.env(&EnvConfig { n_env: 1, ..config.env.clone() })?;
    let of_env = KEYS.iter().chain(SCALES).chain(BOUNDS);
    let meaning = |table: &str, key: &str| match table {
        "env.task" => Some(env.task_spec().settings.iter().find(|s| s.key == key)?.text()),
        "env" | "env.action_scale" | "env.bounds" => Some(of_env.clone().find(|(own, _)| *own == key)?.1.to_string()),
        _ => TrainConfig::meaning(table, key),
    };
    let (mut table, mut lines) = (String::new(), Vec::new());
    for line in text.lines() {
        let said = if let Some(name) = line.strip_prefix('[') {
            table = name.trim_matches(['[', ']']).to_string();
            table.rsplit_once('.').and_then(|(above, key)| meaning(above, key))
        } else {
            line.split_once(" = ").and_then(|(key, _)| meaning(&table, key))
        };
        lines.push((line.to_string(), said.unwrap_or_default()));
    }
    Ok(commented(&format!("# {}: {}. Any line may be left out.\n", entry.name, entry.description), &lines))
}

/// Lines with remarks in one column.
fn commented(head: &str, lines: &[(String, String)]) -> String {
    let width = lines.iter().filter(|(_, m)| !m.is_empty()).map(|(l, _)| l.chars().count()).filter(|n| *n < 46).max();
    let width = width.unwrap_or(0);
    let mut text = head.to_string();
    for (line, meaning) in lines {
        let remark = if meaning.is_empty() { String::new() } else { format!("  # {meaning}") };
        let whole = format!("{line:<width$}{remark}");
        // what would be too wide has its remark above
        text += &if whole.chars().count() > WIDEST && !meaning.is_empty() {
            format!("# {meaning}\n{line}")
        } else {
            whole.trim_end().into()
        };
        text.push('\n');
    }
    text
}

/// Of a line of a file.
const WIDEST: usize = 110;

/// A configuration as a file with comments, which [`EnvConfig::from_toml`] reads back; `own` is the task's environment.
pub fn file(entry: &TaskEntry, env: &Env, config: &EnvConfig) -> Result<String> {
    let defaults = entry.default_config()?;
    let mut whole = config.clone();
    whole.randomise = whole.randomise.or(defaults.randomise).or(Some(Vec::new()));
    let table = toml::Table::try_from(&whole).map_err(unwritable)?;
    let mut lines: Vec<(String, String)> = Vec::new();
    for (key, meaning) in KEYS.iter().map(|(key, meaning)| (*key, meaning.to_string())) {
        match table.get(key) {
            Some(toml::Value::Array(items)) if items.len() > 1 => {
                lines.push((format!("{key} = ["), meaning));
                lines.extend(items.iter().map(|item| (format!("    {item},"), String::new())));
                lines.push(("]".into(), String::new()));
            }
            Some(toml::Value::Table(own)) if ["action_scale", "bounds"].contains(&key) => {
                let line = |(name, unit): &(&str, &str)| {
                    Some((format!("{key}.{name} = {}", own.get(*name)?), unit.to_string()))
                };
                let names = if key == "bounds" { BOUNDS } else { SCALES };
                lines.extend(names.iter().filter_map(line));
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
    Ok(commented(&format!("# {}: {}. Any line may be left out.\n", entry.name, entry.description), &lines))
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
            assert_eq!(EnvConfig { task: toml::Table::new(), randomise: None, ..read }, config, "{text}");
            let keys = toml::Table::try_from(&config).unwrap();
            assert!(keys.keys().all(|key| key == "task" || KEYS.iter().any(|(k, _)| k == key)), "{keys:?}");
        }
    }

    #[test]
    fn changes_and_settings_are_read_or_refused_with_a_reason() {
        let wind = change("wind:-2:2").unwrap();
        assert_eq!(
            (wind.what, wind.by, wind.range),
            (RandomisedQuantity::Wind, RandomisationOperation::Set, [-2.0, 2.0])
        );
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

    #[test]
    fn a_key_without_its_table_is_told_with_it() {
        let told =
            |task: &str, key: &str| place(key, Some(registry::by_name(task).unwrap()), None).unwrap_err().to_string();
        for (task, key, found) in [
            ("Hover", "learning_rate", "apg.learning_rate.from"),
            ("Hover", "Learning_Rate", "apg.learning_rate.from"),
            ("Hover", "learning_rate.to", "apg.learning_rate.to"),
            ("Hover", "lr", "apg.learning_rate.from"),
            ("Hover", "hidden", "apg.network.hidden"),
            ("Hover", "max_grad_norm", "apg.max_grad_norm"),
            ("Hover", "keep", "checkpoint.keep"),
        ] {
            let text = told(task, key);
            assert!(text.contains(&format!("Did you mean '{found}'?")), "{key}: {text}");
        }
        let ppo = place("lr", Some(registry::by_name("Hover").unwrap()), Some("ppo")).unwrap_err().to_string();
        assert!(ppo.contains("Did you mean 'ppo.learning_rate"), "{ppo}");
        assert!(told("Hover", "nothing_of_that_name").contains("Known:"));
        let begun = std::time::Instant::now();
        assert!(told("Hover", &"x".repeat(10_000_000)).contains("Known:"));
        assert!(begun.elapsed().as_secs_f64() < 5.0, "{:?}", begun.elapsed());
    }

    #[test]
    fn an_unknown_setting_names_the_part_that_is_unknown_and_each_known_one_once() {
        let hover = omnidrones::tasks::registry::by_name("Hover").unwrap();
        let Error::Unknown { name, known, .. } = place("envv.control", Some(hover), None).unwrap_err() else {
            panic!("it is known");
        };
        assert_eq!(name, "envv");
        assert!(known.iter().any(|key| key == "env") && known.is_sorted_by(|a, b| a < b), "{known:?}");
    }
}
