//! What a training run is made of, as plain data: in TOML by the same names.
//!
//! ```toml
//! task = "Hover"
//! algorithm = "apg"
//! seed = 3
//! [apg]
//! updates = 300
//! rate = { kind = "cosine", from = 0.005, to = 1e-4 }
//! network = { hidden = [32, 32] }
//! [env]
//! control = "rate"
//! [env.task]
//! vehicle = "crazyflie"
//! ```
//!
//! A file says what differs: from the task's [recipe](super::recipes), which itself says what differs from the defaults.

use super::apg::{Apg, ApgConfig};
use super::differences::{Difference, differences};
use super::learner::Learner;
use super::policy::Actor;
use super::ppo::{Ppo, PpoConfig};
use super::recipes::recipe;
use super::shac::{Shac, ShacConfig};
use crate::error::{Error, Result};
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

/// Most environments of an evaluation.
const MAX_EVALUATED: usize = 1 << 20;
/// Most checkpoints kept.
const MAX_KEPT: usize = 1 << 16;

impl TrainConfig {
    /// For a task: the defaults, its recipe, then a user's TOML (text and its file's name), table by table. The algorithm
    /// is the first of: `algorithm`, that of the user's text, that of the task's first recipe, APG.
    ///
    /// # Errors
    /// [`Error::Unknown`] for a task that is none, [`Error::Format`] with line, column and the nearest known key, and for a
    /// text that names another task; otherwise as [`TrainConfig::validate`].
    pub fn for_task(task: &str, algorithm: Option<Algorithm>, user: Option<(&str, &str)>) -> Result<Self> {
        Self::layered(task, algorithm, user.as_slice())
    }

    /// As [`TrainConfig::for_task`] with several texts of a user, each over those before it.
    ///
    /// # Errors
    /// As [`TrainConfig::for_task`].
    pub fn layered(task: &str, algorithm: Option<Algorithm>, user: &[(&str, &str)]) -> Result<Self> {
        let task = registry::by_name(task)?.name;
        let (mut own, mut algorithm_of_file) = (Table::new(), None);
        for (text, file) in user {
            let (table, named) = read(text, file)?;
            check_task(&table, task, file)?;
            merge(&mut own, table);
            algorithm_of_file = named.or(algorithm_of_file);
        }
        let algorithm = algorithm.or(algorithm_of_file);
        let (usual, text) = recipe(task, algorithm).unwrap_or((algorithm.unwrap_or_default(), ""));
        let (over, _) = read(text, &format!("recipe of {task}"))?;
        let mut merged = Self::default().table()?;
        merge(&mut merged, over);
        merge(&mut merged, own);
        let config = Self { task: task.into(), algorithm: algorithm.unwrap_or(usual), ..of_table(merged)? };
        config.validate()?;
        Ok(config)
    }

    /// From TOML over the defaults, without a recipe; `file` is for messages.
    ///
    /// # Errors
    /// As [`TrainConfig::for_task`].
    pub fn from_toml(text: &str, file: &str) -> Result<Self> {
        let mut merged = Self::default().table()?;
        merge(&mut merged, read(text, file)?.0);
        let config = of_table(merged)?;
        config.validate()?;
        Ok(config)
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
    pub fn differences(&self, now: &Self) -> Result<Vec<Difference>> {
        let bare = |config: &Self| -> Result<Table> {
            let Self { log_every, evaluate, checkpoint, .. } = Self::default();
            Self { log_every, evaluate, checkpoint, ..config.clone() }.with_updates(0).table()
        };
        let named = !self.task.is_empty() && !now.task.is_empty();
        let mut differences = differences(&bare(self)?, &bare(now)?);
        let counts = |key: &str| match Algorithm::ALL.into_iter().find(|a| of_algorithm(key, *a)) {
            Some(algorithm) => algorithm == self.algorithm && algorithm == now.algorithm,
            None => key != "task" || named,
        };
        differences.retain(|difference| counts(&difference.key));
        Ok(differences)
    }

    /// The tables of other algorithms in a user's TOML, which `self` leaves unused.
    pub fn unused(&self, text: &str) -> Vec<Algorithm> {
        let table: Table = toml::from_str(text).unwrap_or_default();
        Algorithm::ALL.into_iter().filter(|a| *a != self.algorithm && table.contains_key(a.name())).collect()
    }

    /// The first key of a TOML text that a training run has and environments do not: whether the text is of a run.
    pub fn telling_key(text: &str) -> Option<String> {
        let table: Table = toml::from_str(text).ok()?;
        let own = Table::try_from(Self::default()).ok()?;
        let telling = |key: &str, value: &Value| match key {
            "seed" => false,
            "task" => value.is_str(),
            key => own.contains_key(key),
        };
        table.iter().find(|(key, value)| telling(key, value)).map(|(key, _)| key.clone())
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

/// A text that names a task is for that one.
fn check_task(table: &Table, task: &str, file: &str) -> Result<()> {
    let Some(named) = table.get("task").and_then(Value::as_str) else { return Ok(()) };
    let named = registry::by_name(named)?.name;
    if named == task {
        return Ok(());
    }
    Err(Error::Format {
        file: file.into(),
        place: "task".into(),
        rule: format!("the settings are for {named}, but the run is of {task}"),
        remedy: format!("Train {named} with them, or change the line to task = \"{task}\"."),
    })
}

/// A text about environments alone is no text about a run.
fn check_kind(table: &Table, text: &str, file: &str) -> Result<()> {
    let environments = Table::try_from(EnvConfig::default()).map_err(unwritable)?;
    let named = |key: &str, value: &Value| key == "task" && value.is_str();
    let strange = |key: &str, value: &Value| key != "seed" && !named(key, value) && environments.contains_key(key);
    let Some(key) = table.iter().find(|(key, value)| strange(key, value)).map(|(key, _)| key) else {
        return Ok(());
    };
    if TrainConfig::telling_key(text).is_some() {
        return Ok(());
    }
    Err(Error::Format {
        file: file.into(),
        place: key.clone(),
        rule: format!(
            "is a setting of environments, of the kind that 'tasks TASK --toml' prints and 'tasks', 'rollout', 'bench', \
             'eval' and 'watch' read; in a training run it is env.{key}"
        ),
        remedy: "Write it so, or begin with the file that 'omnidrones train TASK --toml' prints.".into(),
    })
}

/// The table of a text and the algorithm that it names. Everything in it is known, by itself.
fn read(text: &str, file: &str) -> Result<(Table, Option<Algorithm>)> {
    let table: Table = toml::from_str(text).map_err(|e| Error::of_toml(&e, text, file))?;
    check_kind(&table, text, file)?;
    let whole: TrainConfig = toml::from_str(text).map_err(|e| Error::of_toml(&e, text, file))?;
    for (key, remedy) in NOT_OF_ENV {
        if table.get("env").is_some_and(|env| env.get(key).is_some()) {
            let rule = "is no setting of a training run".into();
            return Err(Error::Format { file: file.into(), place: format!("env.{key}"), rule, remedy: remedy.into() });
        }
    }
    let named = table.contains_key("algorithm").then_some(whole.algorithm);
    Ok((table, named))
}

/// Puts `over` on top of `under`, table by table. A table with a `kind` is a choice: it replaces the one below it.
fn merge(under: &mut Table, over: Table) {
    for (key, value) in over {
        match (under.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) if !above.contains_key("kind") => merge(below, above),
            (_, value) => drop(under.insert(key, value)),
        }
    }
}

fn of_table(table: Table) -> Result<TrainConfig> {
    let text = toml::to_string(&table).map_err(unwritable)?;
    toml::from_str(&text).map_err(|e| Error::of_toml(&e, &text, "configuration over the recipe"))
}

fn unwritable(error: toml::ser::Error) -> Error {
    Error::value("configuration", error, "what TOML can hold", "Lower the seed or the limit of memory.")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    fn hover(text: &str) -> Result<TrainConfig> {
        TrainConfig::for_task("hover", None, Some((text, "my.toml")))
    }

    #[test]
    fn a_users_file_wins_table_by_table() {
        let text = "seed = 3\napg = { window = 30, network.hidden = [8], rate = 0.001 }\n\
                    env = { dt = 0.01, task.horizon = 9 }";
        let (config, usual) = (hover(text).unwrap(), hover("").unwrap());
        assert_eq!((config.seed, config.apg.window, config.apg.rate), (3, 30, 0.001.into()));
        assert_eq!(config.apg.n_env, usual.apg.n_env);
        assert_eq!(config.apg.network.activation, usual.apg.network.activation);
        assert_eq!((config.env.dt, config.env.stagger, config.env.substeps), (0.01, true, usual.env.substeps));
        assert_eq!(config.env.task["horizon"].as_integer(), Some(9));
    }

    #[test]
    fn a_table_with_a_kind_replaces_another_kind() {
        let mut under: Table =
            toml::from_str("rate = { kind = 'linear', from = 1.0, to = 0.0 }\na.b = 1\na.c = 2").unwrap();
        merge(&mut under, toml::from_str("rate = { kind = 'constant', value = 2.0 }\na.c = 3").unwrap());
        let wanted = "rate = { kind = 'constant', value = 2.0 }\na.b = 1\na.c = 3";
        assert_eq!(under, toml::from_str::<Table>(wanted).unwrap());
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
            ("[apg]\nwindows = 3", "my.toml: line 2, column 1: unknown field `windows`"),
            ("[apg]\nwindows = 3", "Did you mean `window`?"),
            ("sed = 3", "Did you mean `seed`?"),
            ("[evaluate]\nenv = 3", "Did you mean `envs`?"),
            ("[env]\ncontroll = 'rate'", "Did you mean `control`?"),
            (
                "[env]\nn_env = 3",
                "env.n_env: is no setting of a training run. Give n_env in the table of the algorithm",
            ),
            ("[apg.network]\nhiden = [3]", "Did you mean `hidden`?"),
            ("algorithm = 'sac'", "unknown variant `sac`"),
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
    fn a_text_about_environments_is_told_from_one_about_a_run() {
        for text in ["n_env = 9\n[task]\nhorizon = 3", "control = 'rate'", "[task]\nvehicle = 'iris'"] {
            let error = hover(text).unwrap_err().to_string();
            assert!(error.contains("is a setting of environments") && error.contains("train TASK --toml"), "{error}");
            assert_eq!(TrainConfig::telling_key(text), None);
        }
        assert_eq!(TrainConfig::telling_key("seed = 3"), None);
        assert_eq!(TrainConfig::telling_key("seed = 3\n[apg]\nwindow = 3").as_deref(), Some("apg"));
        assert_eq!(TrainConfig::telling_key("task = 'Hover'").as_deref(), Some("task"));
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
        assert_eq!(keys(&other), ["apg.clip", "env.task.vehicle", "seed"]);
        let ppo = TrainConfig { algorithm: Algorithm::Ppo, ..one.clone() };
        assert_eq!(keys(&ppo), ["algorithm"]);
    }

    #[test]
    fn tables_of_other_algorithms_are_told() {
        let config = hover("").unwrap();
        assert_eq!(config.unused("ppo.updates = 3\napg.updates = 3"), [Algorithm::Ppo]);
        assert_eq!(config.unused("seed = 3"), []);
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
            "[apg]\nwindow = 1000000000000",
            "[apg]\nshard = 0",
            "[apg]\nrate = nan",
            "[apg]\nclip = -1.0",
            "[apg]\nclip = nan",
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
