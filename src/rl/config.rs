//! What a training run is made of, as plain data: in TOML by the same names.
//!
//! ```toml
//! task = "Hover"
//! algorithm = "apg"
//! seed = 3
//! [apg]
//! updates = 300
//! learning_rate = { kind = "cosine", from = 0.005, to = 1e-4 }
//! network = { hidden = [32, 32] }
//! [env]
//! control = "rate"
//! [env.task]
//! vehicle = "crazyflie"
//! ```
//!
//! A file says what differs: from the task's [recipe](super::recipes), which itself says what differs from the defaults.

mod run;

use super::algorithm::{self, Algorithm, Variant};
use super::apg::ApgConfig;
use super::config_diff::{ConfigDifference, config_diff};
use super::curriculum::Curriculum;
use super::learner::{Learner, unwritable};
use super::predecessor::{self, SAFE};
use super::recipes::{USUAL, recipe};
use base::defaults::with_defaults;
use base::documented::fields;
use base::error::{Error, Result};
use base::layers::{self, Layer, merge};
use base::parallel::Threads;
use run::Run;
use serde::{Deserialize, Serialize, Serializer};
use tasks::{Env, EnvConfig, registry};
use toml::{Table, Value};

with_defaults! {
    /// Flights of the policy from starts that training never sees.
    #[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Evaluate {
        /// Updates between two; 0 for none before the end. Default 100.
        pub every: u64 = 100,
        /// Episodes, each of an environment of its own. Default 1024.
        pub envs: usize = 1024,
        /// Seed of their starts; another one than the run's. Default 1 000 003.
        pub seed: u64 = 1_000_003,
    }
}

with_defaults! {
    /// What is kept of a run while it trains.
    #[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Checkpoints {
        /// Updates between two; 0 for none before the end. Default 100.
        pub every: u64 = 100,
        /// Seconds of training after which one is made in between; 0 for none. At least fifty times as long as the last one took.
        /// Default 60.
        pub seconds: u64 = 60,
        /// How many of the newest stay, 2 or more. Default 2.
        pub keep: usize = 2,
    }
}

/// A training run. In files the settings of the algorithm are a table of its name; those of others do not count.
///
/// `env` describes the environments but not how many there are and how they are drawn: their number stands with the
/// algorithm, and everything random comes from `seed`. First episodes begin anywhere in time (`stagger`) by
/// default.
///
/// ```
/// # use omnidrones_rl::omnidrones;
/// use omnidrones::rl::{TrainConfig, apg::ApgConfig};
/// let own = "seed = 3\n[apg]\nnetwork.hidden = [32, 32]";
/// let config = TrainConfig::for_task("Hover", Some("apg"), Some((own, "my.toml")))?;
/// let apg: &ApgConfig = config.algorithm.get().expect("apg was asked for");
/// assert_eq!((config.seed, &apg.network.hidden[..]), (3, &[32, 32][..]));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(remote = "Self", deny_unknown_fields, default)]
pub struct TrainConfig {
    /// What is learnt; empty where a file does not say.
    pub task: String,
    /// How to learn.
    #[serde(skip)]
    pub algorithm: Box<dyn Algorithm>,
    /// Seed of all that is random in the run. Default 0.
    pub seed: u64,
    /// Updates between two lines of the log, at least 1. Default 10.
    pub log_every: u64,
    /// The policy to begin from instead of random weights: the folder of a run, or `Task`, `Task/algorithm` or `/algorithm`,
    /// which is trained first by its recipe. Or `safe_command`: random weights that act about the command that carries the
    /// weight, where actions are continuous.
    pub from: String,
    /// Settings of the run that is trained first, over its recipe: `from_settings.apg.updates = 300`. Who names another `from` than
    /// the recipe gives those too.
    #[serde(skip_serializing_if = "Table::is_empty")]
    pub from_settings: Table,
    /// Whether an event file for TensorBoard stands beside the log: 1 or 2 kB per line. Default true.
    pub tensorboard: bool,
    /// How well the policy does.
    pub evaluate: Evaluate,
    /// What is kept.
    pub checkpoint: Checkpoints,
    /// How hard episodes are as training goes on.
    pub curriculum: Curriculum,
    /// The environments.
    pub env: EnvConfig,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            task: String::new(),
            algorithm: Box::new(ApgConfig::default()),
            seed: 0,
            log_every: 10,
            from: String::new(),
            from_settings: Table::new(),
            tensorboard: true,
            evaluate: Evaluate::default(),
            checkpoint: Checkpoints::default(),
            curriculum: Curriculum::default(),
            env: EnvConfig { stagger: true, ..EnvConfig::default() },
        }
    }
}

/// Settings of an environment that a run sets itself, and where they are given instead.
pub(super) const NOT_OF_ENV: [(&str, &str); 5] = [
    ("n_env", "Give n_env in the table of the algorithm."),
    ("seed", "Give seed at the top of the file."),
    ("first_environment", "Remove it: a run numbers its environments itself."),
    ("autoreset", "Remove it: environments restart in the same step while training."),
    ("info", "Remove it: training tells what learners read, evaluations all."),
];

/// Settings that came after rows were trained, whose defaults change nothing.
const LATER: [&str; 18] = [
    "env.throttle_change",
    "env.residual",
    "env.easier",
    "env.truncate_after",
    "checkpoint.seconds",
    "ppo.team",
    "ppo.target_kl",
    "ppo.stop_kl",
    "sac.quantiles",
    "sac.separate_actors",
    "sac.saturation_penalty",
    "sac.replay.images",
    "td3.quantiles",
    "td3.separate_actors",
    "td3.saturation_penalty",
    "td3.replay.images",
    "dqn.separate_values",
    "dqn.replay.images",
];

/// Removes what stands at `path` if it is the usual value.
fn leave_out(table: &mut Table, usual: &Table, path: &str) {
    let Some((first, rest)) = path.split_once('.') else {
        if table.get(path) == usual.get(path) {
            table.remove(path);
        }
        return;
    };
    if let (Some(Value::Table(own)), Some(Value::Table(usual))) = (table.get_mut(first), usual.get(first)) {
        leave_out(own, usual, rest);
    }
}

/// What a variant of an algorithm sets.
fn settings_of(variant: Option<&Variant>) -> Result<Table> {
    variant.map_or_else(|| Ok(Table::new()), |own| Ok(Layer::of_text(own.settings, own.name)?.table().clone()))
}

/// What a recipe of a task sets, if it has that one.
fn table_of(task: &str, recipe: Option<(&str, &str)>) -> Result<Table> {
    let text = recipe.map_or("", |(_, text)| text);
    Ok(Layer::of_text(text, &format!("recipe of {task}"))?.table().clone())
}

/// Most environments of an evaluation.
const MAX_EVALUATED: usize = 1 << 20;
/// Most checkpoints kept.
const MAX_KEPT: usize = 1 << 16;

impl TrainConfig {
    /// For a task: the defaults, the task's own, its recipe, then a user's TOML (text and its file's name), table by table.
    /// The algorithm is the first of: `algorithm`, that of the user's text, that of the task's first recipe, APG.
    ///
    /// # Errors
    /// [`Error::Unknown`] for a task that is none, [`Error::Format`] with line, column and the nearest known key, and for a
    /// text that names another task; otherwise as [`TrainConfig::validate`].
    pub fn for_task(task: &str, algorithm: Option<&str>, user: Option<(&str, &str)>) -> Result<Self> {
        let layers = user.map(|(text, file)| Layer::of_text(text, file)).transpose()?;
        Self::layered(task, algorithm, layers.as_slice())
    }

    /// As [`TrainConfig::for_task`] with several layers of a user, each over those before it. Settings of environments may
    /// leave out `env.`: `dt` at the top is `env.dt`.
    ///
    /// # Errors
    /// As [`TrainConfig::for_task`].
    pub fn layered(task: &str, algorithm: Option<&str>, user: &[Layer]) -> Result<Self> {
        let entry = registry::by_name(task)?;
        let task = entry.name;
        let user = user.iter().map(|layer| check(layer.clone().map(Self::lifted), task)).collect::<Result<Vec<_>>>()?;
        let named = user.iter().rev().find_map(|layer| layer.table().get("algorithm")?.as_str());
        let asked = algorithm.or(named);
        let variant = asked.and_then(algorithm::variant);
        let algorithm = asked.map(|name| algorithm::by_name(algorithm::base(name))).transpose()?;
        let known = recipe(task, algorithm.as_ref().map(|own| own.name()));
        let own = algorithm.map_or_else(|| algorithm::by_name(known.map_or(USUAL, |(usual, _)| usual)), Ok)?;
        let mut base = Self::every_table()?;
        merge(&mut base, layers::at("env", Value::Table(entry.default_table()?)));
        let every = i64::try_from(own.evaluate_every()).unwrap_or(i64::MAX);
        merge(&mut base, layers::at("evaluate.every", every.into()));
        // a variant goes over the recipe of what it is a variant of, and its own recipe goes over both
        merge(&mut base, table_of(task, known)?);
        merge(&mut base, settings_of(variant)?);
        merge(&mut base, table_of(task, variant.and_then(|own| recipe(task, Some(own.name))))?);
        if user.iter().any(|layer| layer.table().contains_key("from")) {
            base.remove("from_settings");
        }
        let config = Self { task: task.into(), ..Self::read(base, &user, own.name())? };
        config.validate()?;
        Ok(config)
    }

    /// From TOML over the defaults, without a recipe; `file` is for messages.
    ///
    /// # Errors
    /// As [`TrainConfig::for_task`].
    pub fn from_toml(text: &str, file: &str) -> Result<Self> {
        let layer = Layer::of_text(text, file)?.map(Self::lifted);
        check_env(&layer)?;
        let mut base = Self::every_table()?;
        if let Some(task) = layer.table().get("task").and_then(Value::as_str) {
            merge(&mut base, layers::at("env", Value::Table(registry::by_name(task)?.default_table()?)));
        }
        let named = layer.table().get("algorithm").and_then(Value::as_str).unwrap_or(USUAL).to_string();
        let variant = algorithm::variant(&named);
        merge(&mut base, settings_of(variant)?);
        let config = Self::read(base, &[layer], algorithm::base(&named))?;
        config.validate()?;
        Ok(config)
    }

    /// Checks that a layer in the form of a run holds nothing but settings of runs.
    ///
    /// # Errors
    /// [`Error::Format`] with the nearest known key.
    pub fn check(layer: &Layer) -> Result<()> {
        Self::read(Self::every_table()?, std::slice::from_ref(layer), USUAL).map(drop)
    }

    /// The settings of layers over `base`, all tables of algorithms read, that of `algorithm` kept.
    fn read(base: Table, layers: &[Layer], algorithm: &str) -> Result<Self> {
        let Run(mut config) = layers::read(base.clone(), layers)?;
        for entry in algorithm::entries() {
            let own = (entry.read)(base.clone(), layers)?;
            if own.name().eq_ignore_ascii_case(algorithm) {
                config.algorithm = own;
            }
        }
        Ok(config)
    }

    /// A table with what it says of environments under `env`, where a run has it: settings that a run does not have, but
    /// environments do, and a table `task`. What neither has stays where it is.
    pub fn lifted(mut table: Table) -> Table {
        let (run, env) = (Self::keys(), EnvConfig::keys());
        let mut own = Table::new();
        for (key, value) in std::mem::take(&mut table) {
            let of_env = if key == "task" { value.is_table() } else { !run.contains(&key) && env.contains(&key) };
            if of_env {
                own.insert(key, value)
            } else {
                table.insert(key, value)
            };
        }
        if !own.is_empty() {
            // what stands under env is the more exact
            merge(&mut own, table.remove("env").and_then(|env| env.as_table().cloned()).unwrap_or_default());
            table.insert("env".into(), Value::Table(own));
        }
        table
    }

    /// The names of its settings, and of the tables of algorithms.
    pub fn keys() -> Vec<String> {
        Self::own_keys().into_iter().chain(algorithm::names().into_iter().map(String::from)).collect()
    }

    /// The names of the settings that all runs have.
    pub(super) fn own_keys() -> Vec<String> {
        let own = Self::default().own_table().unwrap_or_default();
        own.keys().cloned().chain(["algorithm", "from_settings"].map(String::from)).collect()
    }

    /// What a setting means, by its table and key as in a file: `apg.network`, `hidden`.
    pub fn meaning(table: &str, key: &str) -> Option<String> {
        let mut levels = table.rsplit('.');
        let (own, above) = (levels.next()?, levels.next().unwrap_or_default());
        let (source, name) = match own {
            "" => (include_str!("config.rs"), "TrainConfig"),
            "evaluate" => (include_str!("config.rs"), "Evaluate"),
            "curriculum" => (include_str!("curriculum.rs"), "Curriculum"),
            "checkpoint" => (include_str!("config.rs"), "Checkpoints"),
            "adam" => (include_str!("nn/adam.rs"), "AdamConfig"),
            "network" | "critic" => (include_str!("nn/mlp.rs"), "Layers"),
            "replay" => (include_str!("replay.rs"), "ReplayConfig"),
            "exploration" if above == "sac" => (include_str!("sac.rs"), "Entropy"),
            "exploration" => (include_str!("td3.rs"), "ActionNoise"),
            own => algorithm::by_name(own).ok()?.source(),
        };
        fields(source, name).into_iter().find_map(|(field, meaning)| (field == key).then_some(meaning))
    }

    /// Takes settings out of a [lifted](Self::lifted) table that a training run sets itself; returns their names, and where they
    /// are given instead.
    pub fn take_foreign(table: &mut Table) -> Vec<(&'static str, &'static str)> {
        let Some(Value::Table(env)) = table.get_mut("env") else { return Vec::new() };
        NOT_OF_ENV.into_iter().filter(|(key, _)| env.remove(*key).is_some()).collect()
    }

    /// All settings but those of other algorithms, the task first, as TOML that [`TrainConfig::from_toml`] reads back.
    ///
    /// # Errors
    /// [`Error::Value`] for a whole number above 2⁶³ − 1.
    pub fn to_toml(&self) -> Result<String> {
        self.text(self.table()?)
    }

    /// What a row of `train-all` or `study` is known by: the text without its seed, and without settings that came after the first
    /// rows where they are as if they were not there.
    pub(super) fn text_of_rows(&self) -> Result<String> {
        let mut table = Self { seed: 0, ..self.clone() }.table()?;
        let usual = Self::every_table()?;
        LATER.iter().for_each(|path| leave_out(&mut table, &usual, path));
        self.text(table)
    }

    /// The task first, if there is one.
    fn text(&self, mut table: Table) -> Result<String> {
        let task = table.remove("task").filter(|_| !self.task.is_empty());
        let first = task.map_or_else(String::new, |task| format!("task = {task}\n"));
        toml::to_string(&table).map(|rest| first + &rest).map_err(unwritable)
    }

    /// All settings but those of other algorithms.
    fn table(&self) -> Result<Table> {
        let mut table = self.own_table()?;
        table.insert("algorithm".into(), self.algorithm.name().into());
        table.insert(self.algorithm.name().into(), Value::Table(self.algorithm.table()?));
        Ok(table)
    }

    /// What all runs have.
    fn own_table(&self) -> Result<Table> {
        struct Own<'a>(&'a TrainConfig);
        impl Serialize for Own<'_> {
            fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
                TrainConfig::serialize(self.0, serializer)
            }
        }
        let mut table = Table::try_from(Own(self)).map_err(unwritable)?;
        if let Some(Value::Table(env)) = table.get_mut("env") {
            NOT_OF_ENV.iter().for_each(|(key, _)| drop(env.remove(*key)));
            // environments leave 0 out, and over a recipe that has a weight a text must say it
            env.entry("throttle_change").or_insert(Value::Float(0.0));
        }
        Ok(table)
    }

    /// All defaults, of every algorithm.
    fn every_table() -> Result<Table> {
        let mut table = Self::default().table()?;
        for entry in algorithm::entries() {
            let own = (entry.default)();
            table.insert(own.name().into(), Value::Table(own.table()?));
        }
        Ok(table)
    }

    /// Checks every number that can be checked without building environments.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        if !self.task.is_empty() {
            registry::by_name(&self.task)?;
        }
        if i64::try_from(self.seed.max(self.evaluate.seed)).is_err() {
            let remedy = "Files hold no larger ones.";
            return Err(Error::limit("seed", self.seed.max(self.evaluate.seed), i64::MAX, remedy));
        }
        if self.seed == self.evaluate.seed {
            let remedy = "Starts must be new to the policy.";
            return Err(Error::value("evaluate.seed", self.evaluate.seed, "another one than seed", remedy));
        }
        if self.from.is_empty() || self.from == SAFE {
            let from = || format!("'{}'", self.from);
            if self.algorithm.is_taught() {
                let remedy = "Name the teacher: a run that is there, or '/apg', which is trained first.";
                return Err(Error::value("from", from(), "a policy, which teaches", remedy));
            }
            if !self.from_settings.is_empty() {
                let remedy = "Name what is trained first, 'Hover/apg', or leave from_settings out.";
                return Err(Error::value("from", from(), "a task where there are from_settings", remedy));
            }
        }
        if self.log_every == 0 {
            return Err(Error::value("log_every", 0, "≥ 1 update", "1 logs every update."));
        }
        let (envs, keep) = (self.evaluate.envs, self.checkpoint.keep);
        if envs == 0 || envs > MAX_EVALUATED {
            let limit = format!("1 to {MAX_EVALUATED}");
            return Err(Error::limit("evaluate.envs", envs, limit, "1024 tell a success rate to a percent."));
        }
        if !(2..=MAX_KEPT).contains(&keep) {
            return Err(Error::limit("checkpoint.keep", keep, format!("2 to {MAX_KEPT}"), "2 survive a damaged file."));
        }
        self.env.validate()?;
        self.curriculum.validate()?;
        if self.curriculum.is_on() && self.env.difficulty != 1.0 {
            let remedy = "Give curriculum.from alone: evaluations are of the task itself.";
            return Err(Error::value("env.difficulty", self.env.difficulty, "1 with a curriculum", remedy));
        }
        if let Some(Value::Integer(horizon)) = self.env.task.get("horizon") {
            EnvConfig::check_horizon(usize::try_from(*horizon).unwrap_or(0))?;
        }
        self.algorithm.validate()
    }

    /// Refuses what would be trained in vain before the run: settings of its predecessor that are none, and a teacher that does not fit.
    /// Nothing is said of a folder, which is read when the run begins.
    ///
    /// # Errors
    /// [`Error::Value`] for a `from` that is neither a folder nor a task, and for a teacher of another task, or of other layers; as
    /// [`layered`](Self::layered) and the algorithms.
    pub fn validate_from(&self) -> Result<()> {
        predecessor::checked(self).map(drop)
    }

    /// Updates of the run.
    pub fn updates(&self) -> u64 {
        self.algorithm.updates()
    }

    /// The same with this number of updates.
    pub fn with_updates(mut self, updates: u64) -> Self {
        self.algorithm.set_updates(updates);
        self
    }

    /// The settings in which two runs differ that should train to the same bits, as long as both train: number of updates,
    /// logs, evaluations and checkpoints may differ, and a task that one of them leaves out. (Schedules are stretched over
    /// the number of updates.) Of different algorithms, the algorithm's own settings are left out.
    ///
    /// # Errors
    /// As [`TrainConfig::to_toml`].
    pub fn differences(&self, now: &Self) -> Result<Vec<ConfigDifference>> {
        let bare = |config: &Self| -> Result<Table> {
            let Self { log_every, tensorboard, evaluate, checkpoint, .. } = Self::default();
            Self { log_every, tensorboard, evaluate, checkpoint, ..config.clone() }.with_updates(0).table()
        };
        let named = !self.task.is_empty() && !now.task.is_empty();
        let mut differences = config_diff(&bare(self)?, &bare(now)?);
        let (own, other) = (self.algorithm.name(), now.algorithm.name());
        let counts = |key: &str| match key.split_once('.') {
            Some((table, _)) if table == own || table == other => own == other,
            _ => key != "task" || named,
        };
        differences.retain(|difference| counts(&difference.key));
        Ok(differences)
    }

    /// The tables of other algorithms in a user's settings, which `self` leaves unused.
    pub fn unused(&self, table: &Table) -> Vec<&'static str> {
        let other = |name: &&str| *name != self.algorithm.name() && table.contains_key(*name);
        algorithm::names().into_iter().filter(other).collect()
    }

    /// The learner at its first update.
    ///
    /// # Errors
    /// As the learner's.
    pub fn learner(&self, task: &str, threads: &Threads) -> Result<Box<dyn Learner>> {
        let difficulty = self.env.difficulty.min(self.curriculum.from);
        let env = EnvConfig { difficulty, ..self.env.clone() };
        self.algorithm.learner(&|config| Env::make(task, config), &env, self.seed, threads.clone())
    }

    /// The environments as the policy sees them: `env`, with the stages that the algorithm adds to its observation.
    pub fn seen_env(&self) -> EnvConfig {
        self.algorithm.seen(&self.env)
    }
}

/// By all settings that a file holds.
impl PartialEq for TrainConfig {
    fn eq(&self, other: &Self) -> bool {
        self.table().ok() == other.table().ok()
    }
}

impl Serialize for TrainConfig {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        self.table().map_err(serde::ser::Error::custom)?.serialize(serializer)
    }
}

/// A layer that names a task is for that one, and sets nothing that a run sets itself.
fn check(layer: Layer, task: &str) -> Result<Layer> {
    check_env(&layer)?;
    let Some(named) = layer.table().get("task").and_then(Value::as_str) else { return Ok(layer) };
    let named = registry::by_name(named)?.name;
    if named == task {
        return Ok(layer);
    }
    Err(Error::Format {
        file: layer.name().into(),
        place: "task".into(),
        rule: format!("the settings are for {named}, but the run is of {task}"),
        remedy: format!("Take {named} with them, or change the line to task = \"{task}\"."),
    })
}

fn check_env(layer: &Layer) -> Result<()> {
    for (key, remedy) in NOT_OF_ENV {
        if layer.table().get("env").is_some_and(|env| env.get(key).is_some()) {
            let (file, place) = (layer.name().into(), format!("env.{key}"));
            let rule = "is no setting of a training run".into();
            return Err(Error::Format { file, place, rule, remedy: remedy.into() });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::ppo::PpoConfig;
    use super::super::schedule::Schedule;
    use super::*;
    use std::time::{Duration, Instant};

    fn hover(text: &str) -> Result<TrainConfig> {
        TrainConfig::for_task("hover", None, Some((text, "my.toml")))
    }

    fn apg(config: &TrainConfig) -> &ApgConfig {
        config.algorithm.get().unwrap()
    }

    #[test]
    fn a_users_file_wins_table_by_table() {
        let text = "seed = 3\napg = { horizon = 30, network.hidden = [8], learning_rate = 0.001 }\n\
                    env = { dt = 0.01, task.horizon = 9 }";
        let (config, usual) = (hover(text).unwrap(), hover("").unwrap());
        assert_eq!((config.seed, apg(&config).horizon, apg(&config).learning_rate), (3, 30, 0.001.into()));
        assert_eq!(apg(&config).n_env, apg(&usual).n_env);
        assert_eq!(apg(&config).network.activation, apg(&usual).network.activation);
        assert_eq!((config.env.dt, config.env.stagger, config.env.substeps), (0.01, true, usual.env.substeps));
        assert_eq!(config.env.task["horizon"].as_integer(), Some(9));
    }

    #[test]
    fn one_number_of_a_recipes_schedule_can_be_given() {
        let (usual, own) = (hover("").unwrap(), hover("apg.learning_rate.from = 0.005").unwrap());
        assert_eq!(
            (apg(&usual).learning_rate, apg(&own).learning_rate),
            (Schedule::cosine(0.015, 1e-4), Schedule::cosine(0.005, 1e-4))
        );
        let error = hover("log_every = 3\napg.learning_rate.fron = 0.005").unwrap_err().to_string();
        assert!(error.starts_with("my.toml: apg.learning_rate") && error.contains("Did you mean `from`?"), "{error}");
    }

    #[test]
    fn a_value_that_equals_a_default_counts_over_the_task_and_its_recipe() {
        let of = |task, text| TrainConfig::for_task(task, None, Some((text, "my.toml"))).unwrap();
        assert_eq!(
            (of("HoverRand", "").env.changes().len(), of("HoverRand", "env.randomise = []").env.changes().len()),
            (9, 0)
        );
        let usual = ApgConfig::default().n_env;
        assert_ne!(apg(&of("OmavHover", "")).n_env, usual);
        assert_eq!(apg(&of("OmavHover", &format!("apg.n_env = {usual}"))).n_env, usual);
    }

    #[test]
    fn a_recipe_of_a_variant_goes_over_that_of_its_algorithm_and_a_user_over_both() {
        let of = |name, user: &str| {
            let config = TrainConfig::for_task("Hover", Some(name), Some((user, "my.toml"))).unwrap();
            let text: Table = toml::from_str(&config.to_toml().unwrap()).unwrap();
            let dqn = text["dqn"].as_table().unwrap().clone();
            (
                dqn["tau"].as_float().unwrap(),
                dqn["quantiles"].as_integer().unwrap(),
                dqn["updates"].as_integer().unwrap(),
            )
        };
        assert_eq!(of("dqn", ""), (0.002, 16, 1500));
        assert_eq!(of("vdn", ""), (0.002, 1, 1500));
        assert_eq!(of("qmix", ""), (0.001, 1, 1500));
        assert_eq!(of("qmix", "dqn.tau = 0.01"), (0.01, 1, 1500));
    }

    #[test]
    fn the_algorithm_is_that_of_the_caller_then_of_the_file_then_of_the_recipe() {
        let named = Some(("algorithm = 'ppo'", "my.toml"));
        let of = |wanted, user| TrainConfig::for_task("Hover", wanted, user).unwrap().algorithm.name();
        assert_eq!(of(Some("shac"), named), "shac");
        assert_eq!(of(None, named), "ppo");
        assert_eq!(of(None, None), "apg");
    }

    #[test]
    fn a_configuration_survives_its_own_text() {
        for algorithm in algorithm::names() {
            let text = "seed = 9\n[env]\ncontrol = 'rate'\nrandomise = [{ what = 'mass', range = [0.7, 1.3] }]";
            let config = TrainConfig::for_task("Hover", Some(algorithm), Some((text, "t"))).unwrap();
            let text = config.with_updates(17).to_toml().unwrap();
            let again = TrainConfig::from_toml(&text, "t").unwrap();
            assert_eq!((again.updates(), again.seed, again.to_toml().unwrap()), (17, 9, text));
        }
    }

    #[test]
    fn unknown_keys_are_named_with_their_place_and_the_nearest() {
        for (text, told) in [
            ("[apg]\nhorizons = 3", "my.toml: line 2, column 1: unknown field `horizons`"),
            ("[apg]\nhorizons = 3", "Did you mean `horizon`?"),
            ("sed = 3", "Did you mean `seed`?"),
            ("[evaluate]\nenv = 3", "Did you mean `envs`?"),
            ("[env]\ncontroll = 'rate'", "Did you mean `control`?"),
            ("[shacc]\nhorizon = 3", "my.toml: line 1, column 2: unknown field `shacc`"),
            ("[shacc]\nhorizon = 3", "Did you mean `shac`?"),
            ("[ppo]\nstep = 3", "my.toml: line 2, column 1: unknown field `step`"),
            ("algorithm = 3", "my.toml: line 1, column 13: invalid type: integer"),
            (
                "[env]\nn_env = 3",
                "env.n_env: is no setting of a training run. Give n_env in the table of the algorithm",
            ),
            ("[apg.network]\nhiden = [3]", "Did you mean `hidden`?"),
            ("algorithm = 'shacc'", "did you mean 'shac'?"),
        ] {
            let error = hover(text).unwrap_err().to_string();
            assert!(error.contains(told), "{text}: {error}");
        }
        let error = TrainConfig::for_task("Hovr", None, None).unwrap_err().to_string();
        assert!(error.contains("did you mean 'Hover'?"), "{error}");
    }

    #[test]
    fn a_text_names_its_task_first_and_is_refused_for_another() {
        let config = hover("seed = 2").unwrap();
        let text = config.to_toml().unwrap();
        assert!(text.starts_with("task = \"Hover\"\n"), "{text}");
        assert_eq!(TrainConfig::from_toml(&text, "t").unwrap().task, "Hover");
        assert_eq!(hover(&text).unwrap(), config);
        assert_eq!(hover("task = 'hover'").unwrap().task, "Hover");
        let error = TrainConfig::for_task("Track", None, Some((&text, "my.toml"))).unwrap_err().to_string();
        assert!(error.contains("my.toml: task: the settings are for Hover, but the run is of Track"), "{error}");
        assert!(hover("task = 'Hovr'").unwrap_err().to_string().contains("did you mean 'Hover'?"));
    }

    #[test]
    fn settings_of_environments_may_leave_out_env() {
        let own = hover("control = 'rate'\nenv.dt = 0.01\n[task]\nhorizon = 3").unwrap();
        assert_eq!(own, hover("env = { control = 'rate', dt = 0.01, task.horizon = 3 }").unwrap());
        let error = hover("n_env = 9").unwrap_err().to_string();
        assert!(error.contains("env.n_env: is no setting of a training run"), "{error}");
        let mut table = TrainConfig::lifted(toml::from_str("n_env = 9\nseed = 3\nautoreset = 'disabled'").unwrap());
        let foreign = TrainConfig::take_foreign(&mut table);
        assert_eq!(foreign.iter().map(|(key, _)| *key).collect::<Vec<_>>(), ["n_env", "autoreset"]);
        assert_eq!(table["seed"].as_integer(), Some(3));
    }

    #[test]
    fn differences_are_named_by_their_keys_and_algorithms_by_themselves() {
        let one = hover("seed = 1\n[apg]\nmax_grad_norm = 0.5").unwrap();
        assert_eq!(one.differences(&one.clone().with_updates(7)).unwrap(), []);
        let nameless = TrainConfig { task: String::new(), log_every: 3, ..one.clone() };
        assert_eq!(nameless.differences(&one).unwrap(), []);
        let other = hover("seed = 2\nenv.task.vehicle = 'iris'\n[apg]\nmax_grad_norm = 0.25").unwrap();
        let keys = |now: &TrainConfig| -> Vec<String> {
            one.differences(now).unwrap().into_iter().map(|difference| difference.key).collect()
        };
        assert_eq!(keys(&other), ["apg.max_grad_norm", "env.task.vehicle", "seed"]);
        let ppo = TrainConfig { algorithm: Box::new(PpoConfig::default()), ..one.clone() };
        assert_eq!(keys(&ppo), ["algorithm"]);
    }

    #[test]
    fn tables_of_other_algorithms_are_told() {
        let config = hover("").unwrap();
        let unused = |text: &str| config.unused(&toml::from_str(text).unwrap());
        assert_eq!(unused("ppo.updates = 3\napg.updates = 3"), ["ppo"]);
        assert!(unused("seed = 3").is_empty());
    }

    #[test]
    fn every_setting_of_a_run_has_a_meaning() {
        for algorithm in algorithm::names() {
            let config = TrainConfig { algorithm: algorithm::by_name(algorithm).unwrap(), ..TrainConfig::default() };
            let mut table: Table = toml::from_str(&config.to_toml().unwrap()).unwrap();
            table.remove("env");
            let mut tables = vec![(String::new(), table)];
            while let Some((path, table)) = tables.pop() {
                for (key, value) in table {
                    match value {
                        Value::Table(inner) if !inner.contains_key("kind") && key != "init" => {
                            tables.push((format!("{path}.{key}"), inner));
                        }
                        _ => assert!(TrainConfig::meaning(&path, &key).is_some_and(|m| !m.is_empty()), "{path}.{key}"),
                    }
                }
            }
        }
    }

    #[test]
    fn bombs_are_refused_before_anything_is_built() {
        for text in [
            "[apg]\nnetwork.hidden = [1e9]",
            "[apg]\nnetwork.hidden = [1000000000]",
            "[apg]\nnetwork.hidden = [-1]",
            "[apg]\nn_env = 1000000000000",
            "[apg]\nn_env = -3",
            "[apg]\nn_env = 0",
            "[apg]\nhorizon = 1000000000000",
            "[apg]\nshard = 0",
            "[apg]\nlearning_rate = nan",
            "[apg]\nmax_grad_norm = -1.0",
            "[apg]\nmax_grad_norm = nan",
            "[apg]\nupdates = -1",
            "[env.task]\nhorizon = 1000000000000000",
            "[env.task]\nhorizon = 1e15",
            "[env.task]\nhorizon = -5",
            "[env]\ndt = nan",
            "[env]\nsubsteps = 1000000000000",
            "[evaluate]\nenvs = 1000000000000",
            "[evaluate]\nenvs = 0",
            "[checkpoint]\nkeep = 1",
            "[checkpoint]\nkeep = 1000000000000",
            "log_every = 0",
            "seed = -1",
            "seed = 1e300",
        ] {
            // the quickest of five: a scheduler that gives the processor to others takes longer than what is measured
            let tries = (0..5).map(|_| {
                let begun = Instant::now();
                let refused = hover(text).and_then(|c| c.learner("Hover", &Threads::new(1)?).map(drop));
                assert!(refused.is_err(), "{text}");
                begun.elapsed()
            });
            let took = tries.min().unwrap();
            assert!(took < Duration::from_millis(10), "{text}: {took:?}"); // 0.34 ms
        }
    }
}
