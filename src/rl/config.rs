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

use super::apg::{Apg, ApgConfig};
use super::config_diff::{ConfigDifference, config_diff};
use super::learner::Learner;
use super::policy::Actor;
use super::ppo::{Ppo, PpoConfig};
use super::recipes::recipe;
use super::renamed::renamed;
use super::shac::{Shac, ShacConfig};
use crate::documented::fields;
use crate::error::{Error, Result};
use crate::layers::{self, Layer, merge};
use crate::parallel::Threads;
use crate::tasks::{EnvConfig, Spec, registry};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

/// How a policy learns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Algorithm {
    /// Gradients of the loss through the physics: [`Apg`].
    #[default]
    Apg,
    /// The same over short windows, with a critic behind them: [`Shac`].
    Shac,
    /// Sampled actions, clipped steps: [`Ppo`].
    Ppo,
}

impl Algorithm {
    /// All.
    pub const ALL: [Self; 3] = [Self::Apg, Self::Shac, Self::Ppo];

    /// As in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Apg => "apg",
            Self::Shac => "shac",
            Self::Ppo => "ppo",
        }
    }

    /// The algorithm of that name (case does not matter).
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest.
    pub fn by_name(name: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|a| a.name().eq_ignore_ascii_case(name)).ok_or_else(|| Error::Unknown {
            kind: "algorithm",
            name: name.into(),
            known: Self::ALL.map(|a| a.name().to_string()).to_vec(),
        })
    }
}

/// Flights of the policy from starts that training never sees.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Evaluate {
    /// Updates between two; 0 for none before the end.
    pub every: u64,
    /// Episodes, each of an environment of its own.
    pub envs: usize,
    /// Of their starts; another one than the run's.
    pub seed: u64,
}

impl Default for Evaluate {
    fn default() -> Self {
        Self { every: 100, envs: 1024, seed: 1_000_003 }
    }
}

/// What is kept of a run while it trains.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Checkpoints {
    /// Updates between two; 0 for none before the end.
    pub every: u64,
    /// How many of the newest stay, 2 or more.
    pub keep: usize,
}

impl Default for Checkpoints {
    fn default() -> Self {
        Self { every: 100, keep: 2 }
    }
}

/// A training run. Of the algorithms' tables only that of `algorithm` counts.
///
/// `env` describes the environments but not how many there are and how they are drawn: their number stands with the
/// algorithm, and everything random comes from `seed`. First episodes begin anywhere in time (`stagger`) unless told
/// otherwise.
///
/// ```
/// use omnidrones::rl::{Algorithm, TrainConfig};
/// let own = "seed = 3\n[apg]\nnetwork.hidden = [32, 32]";
/// let config = TrainConfig::for_task("Hover", Some(Algorithm::Apg), Some((own, "my.toml")))?;
/// assert_eq!((config.seed, &config.apg.network.hidden[..]), (3, &[32, 32][..]));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainConfig {
    /// What is learnt; empty where a file does not say.
    pub task: String,
    /// How to learn.
    pub algorithm: Algorithm,
    /// Of all that is random in the run.
    pub seed: u64,
    /// Updates between two lines of the log.
    pub log_every: u64,
    /// How well the policy does.
    pub evaluate: Evaluate,
    /// What is kept.
    pub checkpoint: Checkpoints,
    /// Settings of APG.
    pub apg: ApgConfig,
    /// Settings of SHAC.
    pub shac: ShacConfig,
    /// Settings of PPO.
    pub ppo: PpoConfig,
    /// The environments.
    pub env: EnvConfig,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            task: String::new(),
            algorithm: Algorithm::default(),
            seed: 0,
            log_every: 10,
            evaluate: Evaluate::default(),
            checkpoint: Checkpoints::default(),
            apg: ApgConfig::default(),
            shac: ShacConfig::default(),
            ppo: PpoConfig::default(),
            env: EnvConfig { stagger: true, ..EnvConfig::default() },
        }
    }
}

/// Settings of an environment that a run sets itself, and where they are given instead.
const NOT_OF_ENV: [(&str, &str); 4] = [
    ("n_env", "Give n_env in the table of the algorithm."),
    ("seed", "Give seed at the top of the file."),
    ("first_environment", "Remove it: a run numbers its environments itself."),
    ("autoreset", "Remove it: environments restart in the same step while training."),
];

/// Updates between two evaluations of PPO, whose updates are few and long.
const PPO_EVALUATES: i64 = 20;

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
    pub fn for_task(task: &str, algorithm: Option<Algorithm>, user: Option<(&str, &str)>) -> Result<Self> {
        let layers = user.map(|(text, file)| Layer::of_text(text, file)).transpose()?;
        Self::layered(task, algorithm, layers.as_slice())
    }

    /// As [`TrainConfig::for_task`] with several layers of a user, each over those before it. Settings of environments may
    /// leave out `env.`: `dt` at the top is `env.dt`.
    ///
    /// # Errors
    /// As [`TrainConfig::for_task`].
    pub fn layered(task: &str, algorithm: Option<Algorithm>, user: &[Layer]) -> Result<Self> {
        let entry = registry::by_name(task)?;
        let task = entry.name;
        let user = user.iter().map(|layer| check(Self::today(layer.clone())?, task)).collect::<Result<Vec<_>>>()?;
        let named = user.iter().rev().find_map(|layer| layer.table().get("algorithm")?.as_str());
        let algorithm = algorithm.or(named.map(Algorithm::by_name).transpose()?);
        let (usual, text) = recipe(task, algorithm).unwrap_or((algorithm.unwrap_or_default(), ""));
        let mut base = Self::default().table()?;
        merge(&mut base, layers::at("env", Value::Table(entry.default_table()?)));
        if algorithm.unwrap_or(usual) == Algorithm::Ppo {
            merge(&mut base, layers::at("evaluate.every", PPO_EVALUATES.into()));
        }
        merge(&mut base, Layer::of_text(text, &format!("recipe of {task}"))?.table().clone());
        let config = Self { task: task.into(), algorithm: algorithm.unwrap_or(usual), ..layers::read(base, &user)? };
        config.validate()?;
        Ok(config)
    }

    /// From TOML over the defaults, without a recipe; `file` is for messages.
    ///
    /// # Errors
    /// As [`TrainConfig::for_task`].
    pub fn from_toml(text: &str, file: &str) -> Result<Self> {
        let layer = Self::today(Layer::of_text(text, file)?)?;
        check_env(&layer)?;
        let mut base = Self::default().table()?;
        if let Some(task) = layer.table().get("task").and_then(Value::as_str) {
            merge(&mut base, layers::at("env", Value::Table(registry::by_name(task)?.default_table()?)));
        }
        let config: Self = layers::read(base, &[layer])?;
        config.validate()?;
        Ok(config)
    }

    /// A layer in the form of a run, [lifted](Self::lifted), and with settings of algorithms by today's names.
    ///
    /// # Errors
    /// [`Error::Format`] for a setting that is given by the name of 0.1 and by that of today.
    pub fn today(layer: Layer) -> Result<Layer> {
        renamed(layer.map(Self::lifted))
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

    /// The names of its settings.
    pub fn keys() -> Vec<String> {
        Table::try_from(Self::default()).unwrap_or_default().keys().cloned().collect()
    }

    /// What a setting means, by its table and key as in a file: `apg.network`, `hidden`.
    pub fn meaning(table: &str, key: &str) -> Option<String> {
        let (source, name) = match table.rsplit('.').next()? {
            "" => (include_str!("config.rs"), "TrainConfig"),
            "evaluate" => (include_str!("config.rs"), "Evaluate"),
            "checkpoint" => (include_str!("config.rs"), "Checkpoints"),
            "apg" => (include_str!("apg.rs"), "ApgConfig"),
            "shac" => (include_str!("shac.rs"), "ShacConfig"),
            "ppo" => (include_str!("ppo/config.rs"), "PpoConfig"),
            "adam" => (include_str!("nn/adam.rs"), "AdamConfig"),
            "network" | "critic" => (include_str!("nn/mlp.rs"), "Layers"),
            _ => return None,
        };
        fields(source, name).into_iter().find_map(|(field, meaning)| (field == key).then_some(meaning))
    }

    /// Takes settings out of a [lifted](Self::lifted) table that a training run sets itself: their names, and where they
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
        let mut table = self.table()?;
        for other in Algorithm::ALL.into_iter().filter(|a| *a != self.algorithm) {
            table.remove(other.name());
        }
        let task = table.remove("task").filter(|_| !self.task.is_empty());
        let first = task.map_or_else(String::new, |task| format!("task = {task}\n"));
        toml::to_string(&table).map(|rest| first + &rest).map_err(unwritable)
    }

    fn table(&self) -> Result<Table> {
        let mut table = Table::try_from(self).map_err(unwritable)?;
        if let Some(Value::Table(env)) = table.get_mut("env") {
            NOT_OF_ENV.iter().for_each(|(key, _)| drop(env.remove(*key)));
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
        if let Some(Value::Integer(horizon)) = self.env.task.get("horizon") {
            EnvConfig::check_horizon(usize::try_from(*horizon).unwrap_or(0))?;
        }
        match self.algorithm {
            Algorithm::Apg => self.apg.validate(),
            Algorithm::Shac => self.shac.validate(),
            Algorithm::Ppo => self.ppo.validate(),
        }
    }

    /// Updates of the run.
    pub fn updates(&self) -> u64 {
        match self.algorithm {
            Algorithm::Apg => self.apg.updates,
            Algorithm::Shac => self.shac.updates,
            Algorithm::Ppo => self.ppo.updates,
        }
    }

    /// With another number of updates.
    pub fn with_updates(mut self, updates: u64) -> Self {
        match self.algorithm {
            Algorithm::Apg => self.apg.updates = updates,
            Algorithm::Shac => self.shac.updates = updates,
            Algorithm::Ppo => self.ppo.updates = updates,
        }
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
            let Self { log_every, evaluate, checkpoint, .. } = Self::default();
            Self { log_every, evaluate, checkpoint, ..config.clone() }.with_updates(0).table()
        };
        let named = !self.task.is_empty() && !now.task.is_empty();
        let mut differences = config_diff(&bare(self)?, &bare(now)?);
        let counts = |key: &str| match Algorithm::ALL.into_iter().find(|a| of_algorithm(key, *a)) {
            Some(algorithm) => algorithm == self.algorithm && algorithm == now.algorithm,
            None => key != "task" || named,
        };
        differences.retain(|difference| counts(&difference.key));
        Ok(differences)
    }

    /// The tables of other algorithms in a user's settings, which `self` leaves unused.
    pub fn unused(&self, table: &Table) -> Vec<Algorithm> {
        Algorithm::ALL.into_iter().filter(|a| *a != self.algorithm && table.contains_key(a.name())).collect()
    }

    /// The learner at its first update.
    ///
    /// # Errors
    /// As the learner's.
    pub fn learner(&self, task: &str, threads: &Threads) -> Result<Box<dyn Learner>> {
        let (env, seed, threads) = (&self.env, self.seed, threads.clone());
        Ok(match self.algorithm {
            Algorithm::Apg => Box::new(Apg::new(task, env, self.apg.clone(), seed, threads)?),
            Algorithm::Shac => Box::new(Shac::new(task, env, self.shac.clone(), seed, threads)?),
            Algorithm::Ppo => Box::new(Ppo::new(task, env, self.ppo.clone(), seed, threads)?),
        })
    }

    /// The environments as the policy sees them: `env`, with the stage that the algorithm adds to its observation.
    pub fn seen_env(&self) -> EnvConfig {
        match self.algorithm {
            Algorithm::Ppo => self.ppo.seen(&self.env),
            Algorithm::Apg | Algorithm::Shac => self.env.clone(),
        }
    }

    /// The shape of the learner's policy.
    pub(crate) fn actor(&self, spec: &Spec) -> Result<Actor> {
        match self.algorithm {
            Algorithm::Apg => Actor::new(spec, &self.apg.network, true),
            Algorithm::Shac => Actor::new(spec, &self.shac.network, true),
            Algorithm::Ppo => Actor::new(spec, &self.ppo.network, false),
        }
    }
}

/// Whether a key is one of an algorithm's own settings.
fn of_algorithm(key: &str, algorithm: Algorithm) -> bool {
    key.strip_prefix(algorithm.name()).is_some_and(|rest| rest.starts_with('.'))
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

fn unwritable(error: toml::ser::Error) -> Error {
    Error::value("configuration", error, "what TOML can hold", "Lower the seed or the limit of memory.")
}

#[cfg(test)]
mod tests {
    use super::super::schedule::Schedule;
    use super::*;
    use std::time::{Duration, Instant};

    fn hover(text: &str) -> Result<TrainConfig> {
        TrainConfig::for_task("hover", None, Some((text, "my.toml")))
    }

    #[test]
    fn a_users_file_wins_table_by_table() {
        let text = "seed = 3\napg = { horizon = 30, network.hidden = [8], learning_rate = 0.001 }\n\
                    env = { dt = 0.01, task.horizon = 9 }";
        let (config, usual) = (hover(text).unwrap(), hover("").unwrap());
        assert_eq!((config.seed, config.apg.horizon, config.apg.learning_rate), (3, 30, 0.001.into()));
        assert_eq!(config.apg.n_env, usual.apg.n_env);
        assert_eq!(config.apg.network.activation, usual.apg.network.activation);
        assert_eq!((config.env.dt, config.env.stagger, config.env.substeps), (0.01, true, usual.env.substeps));
        assert_eq!(config.env.task["horizon"].as_integer(), Some(9));
    }

    #[test]
    fn one_number_of_a_recipes_schedule_can_be_given() {
        let (usual, own) = (hover("").unwrap(), hover("apg.learning_rate.from = 0.005").unwrap());
        assert_eq!(
            (usual.apg.learning_rate, own.apg.learning_rate),
            (Schedule::cosine(0.01, 1e-4), Schedule::cosine(0.005, 1e-4))
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
        let usual = TrainConfig::default().apg.n_env;
        assert_ne!(of("HoverRand", "").apg.n_env, usual);
        assert_eq!(of("HoverRand", &format!("apg.n_env = {usual}")).apg.n_env, usual);
    }

    #[test]
    fn the_algorithm_is_that_of_the_caller_then_of_the_file_then_of_the_recipe() {
        let named = Some(("algorithm = 'ppo'", "my.toml"));
        let of = |wanted, user| TrainConfig::for_task("Hover", wanted, user).unwrap().algorithm;
        assert_eq!(of(Some(Algorithm::Shac), named), Algorithm::Shac);
        assert_eq!(of(None, named), Algorithm::Ppo);
        assert_eq!(of(None, None), Algorithm::Apg);
        assert!(Algorithm::by_name("pppo").unwrap_err().to_string().contains("did you mean 'ppo'?"));
        assert!(Algorithm::ALL.into_iter().all(|a| Algorithm::by_name(a.name()).unwrap() == a));
    }

    #[test]
    fn a_configuration_survives_its_own_text() {
        for algorithm in Algorithm::ALL {
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
            (
                "[env]\nn_env = 3",
                "env.n_env: is no setting of a training run. Give n_env in the table of the algorithm",
            ),
            ("[apg.network]\nhiden = [3]", "Did you mean `hidden`?"),
            ("algorithm = 'sac'", "did you mean 'shac'?"),
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
        let one = hover("seed = 1\n[apg]\nclip = 0.5").unwrap();
        assert_eq!(one.differences(&one.clone().with_updates(7)).unwrap(), []);
        let nameless = TrainConfig { task: String::new(), log_every: 3, ..one.clone() };
        assert_eq!(nameless.differences(&one).unwrap(), []);
        let other = hover("seed = 2\nenv.task.vehicle = 'iris'\n[apg]\nclip = 0.25").unwrap();
        let keys = |now: &TrainConfig| -> Vec<String> {
            one.differences(now).unwrap().into_iter().map(|difference| difference.key).collect()
        };
        assert_eq!(keys(&other), ["apg.max_grad_norm", "env.task.vehicle", "seed"]);
        let ppo = TrainConfig { algorithm: Algorithm::Ppo, ..one.clone() };
        assert_eq!(keys(&ppo), ["algorithm"]);
    }

    #[test]
    fn tables_of_other_algorithms_are_told() {
        let config = hover("").unwrap();
        let unused = |text: &str| config.unused(&toml::from_str(text).unwrap());
        assert_eq!(unused("ppo.updates = 3\napg.updates = 3"), [Algorithm::Ppo]);
        assert_eq!(unused("seed = 3"), []);
    }

    #[test]
    fn every_setting_of_a_run_has_a_meaning() {
        for algorithm in Algorithm::ALL {
            let config = TrainConfig { algorithm, ..TrainConfig::default() };
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
            let begun = Instant::now();
            let refused = hover(text).and_then(|c| c.learner("Hover", &Threads::new(1)?).map(drop));
            let took = begun.elapsed();
            assert!(refused.is_err(), "{text}");
            assert!(took < Duration::from_millis(10), "{text}: {took:?}"); // 0.34 ms
        }
    }
}
