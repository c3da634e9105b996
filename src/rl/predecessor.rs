//! The policy that a run begins from: that of another run, or one that is trained first by its recipe.

use super::algorithm;
use super::config::{NOT_OF_ENV, TrainConfig};
use super::learner::unwritable;
use super::policy::{Actor, Policy};
use super::recipes::{USUAL, recipes_of};
use super::warm_start::WarmStart;
use base::error::{Error, Result};
use base::layers::{self, Layer, merge};
use std::path::Path;
use tasks::{Env, EnvConfig, Spec, registry};
use toml::{Table, Value};

/// What [`TrainConfig::from`] says for random weights whose mean action is the safe command.
pub(crate) const SAFE: &str = "safe_command";

/// As [`predecessor_config`], but refuses a teacher that does not fit, which would be trained in vain.
///
/// # Errors
/// As there, [`Algorithm::actor`](super::Algorithm::actor) and [`WarmStart::but_for_the_last_encoder`]; [`Error::Value`] for a teacher of
/// another task.
pub(crate) fn checked(config: &TrainConfig) -> Result<Option<(String, TrainConfig)>> {
    let Some((task, own)) = predecessor_config(config)? else { return Ok(None) };
    if config.algorithm.is_taught() {
        if task != config.task {
            let remedy = "Name it '/apg', or the folder of a run of the same task.";
            return Err(Error::value("task of the teacher", task, format!("{}, that of the run", config.task), remedy));
        }
        let (of, seen) = (spec(&task, &own)?, spec(&task, config)?);
        let (teacher, student) = (own.algorithm.actor(&of)?, config.algorithm.actor(&seen)?);
        let nothing = |actor: &Actor| vec![0.0; actor.n_parameter()];
        let policy = Policy::new(teacher.clone(), nothing(&teacher), None, &of)?;
        WarmStart::but_for_the_last_encoder(&policy, &of, &student, &nothing(&student), &seen)?;
    }
    Ok(Some((task, own)))
}

/// Task and settings of the run that is trained first; none where there is nothing to train: random weights, or a folder.
///
/// # Errors
/// As [`TrainConfig::layered`]; [`Error::Value`] for what is neither a folder nor a task, and for settings of what is trained already.
pub(crate) fn predecessor_config(config: &TrainConfig) -> Result<Option<(String, TrainConfig)>> {
    let from = &config.from;
    // names win: what lies about is no reason to begin from something else
    if from.is_empty() || from == SAFE || !is_named(from) && Path::new(from).is_dir() {
        if !config.from_settings.is_empty() {
            let remedy = "Leave from_settings out: what is there has its own.";
            return Err(Error::value("from", format!("'{from}'"), "a task where there are from_settings", remedy));
        }
        return Ok(None);
    }
    let (task, algorithm) = from.split_once('/').unwrap_or((from, ""));
    let task = if task.is_empty() { &config.task } else { task };
    if task.contains(['/', '.']) || algorithm.contains(['/', '.']) {
        let remedy = "Name a run that is there, or a task that is trained first: 'Hover', 'Hover/apg', '/dagger'.";
        return Err(Error::value("from", format!("'{from}'"), "the folder of a run, or Task/algorithm", remedy));
    }
    let algorithm = Some(algorithm).filter(|name| !name.is_empty());
    let usual = recipes_of(task).into_iter().next().unwrap_or(USUAL);
    let settings = Layer::of_table("from_settings", config.from_settings.clone());
    let own = TrainConfig::layered(task, algorithm, &[inherited(config, algorithm.unwrap_or(usual))?, settings])?;
    Ok(Some((task.into(), own)))
}

/// Whether it says what is trained first: a task, an algorithm, or both.
fn is_named(from: &str) -> bool {
    let (task, algorithm) = from.split_once('/').unwrap_or((from, ""));
    let task_known = task.is_empty() || registry::by_name(task).is_ok();
    let algorithm_known = algorithm.is_empty() || algorithm::by_name(algorithm::base(algorithm)).is_ok();
    from != "/" && task_known && algorithm_known
}

pub(super) fn spec(task: &str, config: &TrainConfig) -> Result<Spec> {
    Ok(Env::make(task, &EnvConfig { n_env: 1, ..config.seen_env() })?.spec().clone())
}

/// Settings of environments that go over to a run's predecessor: how actions enter.
const INHERITED: [&str; 7] = ["control", "own_vehicle", "dt", "action_scale", "actions", "delay", "control_rate"];

/// The settings that go over to a run's predecessor by `algorithm`: who flies, how actions enter, hidden layers, the seed. To a
/// teacher all of the environments but what it sees of them.
fn inherited(config: &TrainConfig, algorithm: &str) -> Result<Layer> {
    let mut table = Table::new();
    let seed = i64::try_from(config.seed).unwrap_or(i64::MAX);
    merge(&mut table, layers::at("seed", seed.into()));
    let env = Table::try_from(&config.env).map_err(unwritable)?;
    let teaches = config.algorithm.is_taught();
    let own_affair = |key: &str| key == "observation" || NOT_OF_ENV.iter().any(|(own, _)| *own == key);
    for (key, value) in env {
        if INHERITED.contains(&&*key) || teaches && !own_affair(&key) {
            merge(&mut table, layers::at(&format!("env.{key}"), value));
        }
    }
    let hidden = config.algorithm.table()?.get("network").and_then(|own| own.get("hidden")).cloned();
    if let Some(hidden) = hidden {
        merge(&mut table, layers::at(&format!("{algorithm}.network.hidden"), hidden));
    }
    if let Some(vehicle) = config.env.task.get("vehicle") {
        merge(&mut table, layers::at("env.task.vehicle", Value::clone(vehicle)));
    }
    Ok(Layer::of_table("the run that begins from it", table))
}
