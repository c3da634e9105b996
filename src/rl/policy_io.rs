//! A policy from the files of a run, ready to fly, without the learner that made it.

use super::checkpoint::{Checkpoint, MAX_BYTES, Manifest, SkippedCheckpoint, Store, Tensors, flies};
use super::config::TrainConfig;
use super::config_diff::{config_diff, described};
use super::policy::Policy;
use super::state;
use super::task_record::register_task;
use base::error::{Error, Result};
use std::path::{Path, PathBuf};
use tasks::{Env, EnvConfig, ObservationTransform, Spec, Statistics};

/// A policy and where it comes from.
#[derive(Debug)]
pub struct SavedPolicy {
    /// Ready to fly.
    pub policy: Policy,
    /// What its checkpoint is of.
    pub manifest: Manifest,
    /// How it was trained.
    pub config: TrainConfig,
    /// Its checkpoint.
    pub folder: PathBuf,
    /// Newer checkpoints that were damaged: say so to whoever asked for the newest.
    pub skipped: Vec<SkippedCheckpoint>,
}

impl SavedPolicy {
    /// Checks that environments show and take what the policy was trained with.
    ///
    /// # Errors
    /// [`Error::Value`] that names what differs, with the settings behind it; otherwise as [`Env::make`].
    pub fn check(&self, asked: &EnvConfig) -> Result<()> {
        let spec = |env: &EnvConfig| {
            Ok(Env::make(&self.manifest.task, &EnvConfig { n_env: 1, ..env.clone() })?.spec().clone())
        };
        let (then, now) = (spec(&self.config.seen_env())?, spec(asked)?);
        // keeps all numbers and changes what they do
        let residual = [&then, &now].map(|spec| spec.config.residual);
        if residual[0] != residual[1] {
            let limit = format!("{}, as in training", residual[0]);
            return Err(Error::value("residual", residual[1], limit, "Leave it as it was in training."));
        }
        if then.hash() == now.hash() {
            return Ok(());
        }
        let settings = config_diff(&bare(&then.config)?, &bare(&now.config)?);
        let remedy = match &settings[..] {
            [] => "Fly it with the version that trained it.".to_string(),
            settings => format!("Leave these as they were in training: {}.", described(settings)),
        };
        let limit = "what it was trained in";
        Err(Error::value("what the policy would meet", strange(&then, &now), limit, remedy))
    }
}

/// What an agent meets otherwise, in words.
fn strange(then: &Spec, now: &Spec) -> String {
    let mut parts = Vec::new();
    let mut number = |what: &str, now: usize, then: usize| {
        if now != then {
            parts.push(format!("{now} {what}, not {then}"));
        }
    };
    number("agents", now.n_agent, then.n_agent);
    number("numbers in an observation", now.n_observation, then.n_observation);
    number("numbers in an action", now.action.len(), then.action.len());
    number("numbers in the central state", now.n_central, then.n_central);
    if now.commands != then.commands {
        parts.push(format!("commands {}, not {}", now.commands.join(", "), then.commands.join(", ")));
    }
    if now.dt != then.dt {
        parts.push(format!("steps of {} s, not {} s", now.dt, then.dt));
    }
    if parts.is_empty() {
        parts.push("other names, scales or transforms of as many numbers".into());
    }
    parts.join("; ")
}

/// What of a configuration a policy can meet: what is drawn only where it sees the numbers that are.
fn bare(env: &EnvConfig) -> Result<toml::Table> {
    let EnvConfig { control, action_scale, actions, dt, observation, mut randomise, sensor, own_vehicle, task, .. } =
        env.clone();
    if !observation.iter().any(|stage| matches!(stage, ObservationTransform::Privileged {})) {
        randomise = None;
    }
    let own = EnvConfig {
        control,
        action_scale,
        actions,
        dt,
        observation,
        randomise,
        sensor,
        own_vehicle,
        task,
        ..EnvConfig::default()
    };
    toml::Table::try_from(&own).map_err(|e| Error::value("environments", e, "what TOML can hold", "Lower the numbers."))
}

/// The policy of a checkpoint's folder, or of the newest whole checkpoint of a run.
///
/// # Errors
/// [`Error::NoRun`] if there is neither; [`Error::Value`] if the task has changed since; [`Error::File`] if the disk
/// refuses, [`Error::Format`] for damaged files.
pub fn load_policy(path: impl AsRef<Path>) -> Result<SavedPolicy> {
    let path = path.as_ref();
    let (checkpoint, folder, skipped) = if path.join("manifest.json").exists() {
        (Checkpoint::load_wanted(path, MAX_BYTES, &flies)?, path.to_path_buf(), Vec::new())
    } else {
        if !path.join("checkpoints").is_dir() {
            return Err(no_run(path));
        }
        let found = Store::open(path)?.latest_to_fly()?.ok_or_else(|| no_run(path))?;
        (found.checkpoint, found.folder, found.skipped)
    };
    let Checkpoint { manifest, policy, state } = checkpoint;
    let file = folder.join("manifest.json").display().to_string();
    register_task(&state)?;
    let config = TrainConfig::from_toml(&manifest.config, &file)?;
    let env = Env::make(&manifest.task, &EnvConfig { n_env: 1, ..config.seen_env() })?;
    let policy = policy_of(&config, env.spec(), &policy, &state)?;
    if policy.spec_hash() != manifest.spec_hash {
        let (now, then) = (format!("{:016x}", policy.spec_hash()), format!("{:016x}", manifest.spec_hash));
        let remedy = format!("The task has changed since: fly it with version {}.", manifest.version);
        return Err(Error::value(format!("{file}: hash of the environment"), now, then, remedy));
    }
    Ok(SavedPolicy { policy, manifest, config, folder, skipped })
}

fn no_run(path: &Path) -> Error {
    let lacks = if path.exists() { "which holds no checkpoint" } else { "which does not exist" };
    let remedy = "Train one: omnidrones train TASK, until its first checkpoint is written.".into();
    Error::NoRun { path: path.into(), lacks, remedy }
}

/// Names of the head's parameters and of the normaliser's statistics.
const HEAD: &str = "actor.log_std";
const MEAN: &str = "normaliser.mean";
const VARIANCE: &str = "normaliser.variance";
const COUNT: &str = "normaliser.count";

/// Adds to what the learner saved: the parameters of the head and the statistics, rounded among the weights for other
/// programs, whole in the state.
pub(crate) fn put_policy(own: &Policy, policy: &mut Tensors, state: &mut Tensors) -> Result<()> {
    let head = own.actor().set(own.parameters(), 0).1;
    if !head.is_empty() && own.actor().n_set() == 1 && policy.tensor(HEAD).is_err() {
        policy.insert(HEAD, &[head.len()], head.to_vec())?;
    }
    let Some(Statistics { count, mean, variance }) = own.statistics() else { return Ok(()) };
    for (name, values) in [(MEAN, mean), (VARIANCE, variance)] {
        policy.insert(name, &[values.len()], values.iter().map(|x| *x as f32).collect())?;
        state.insert(name, &[values.len()], values.clone())?;
    }
    state.insert(COUNT, &[1], vec![*count])
}

fn policy_of(config: &TrainConfig, spec: &Spec, policy: &Tensors, state: &Tensors) -> Result<Policy> {
    let actor = config.algorithm.actor(spec)?;
    let parameters = state::actor(policy, &actor)?;
    let statistics = match state.tensor(MEAN) {
        Err(_) => None,
        Ok(mean) => {
            let shape = mean.shape();
            let numbers = |name: &str| Ok(state.get::<f64>(name, shape)?.to_vec());
            let count = state.get::<f64>(COUNT, &[1])?[0];
            Some(Statistics { count, mean: numbers(MEAN)?, variance: numbers(VARIANCE)? })
        }
    };
    Policy::new(actor, parameters, statistics, spec)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_drawn_counts_where_the_policy_sees_it() {
        let keys = |stages: &str| -> Vec<String> {
            let bare = |more: &str| bare(&EnvConfig::from_toml(&format!("{stages}\n{more}"), "test").unwrap()).unwrap();
            let all = config_diff(&bare(""), &bare("randomise = [{ what = 'mass', range = [0.7, 1.3] }]"));
            all.into_iter().map(|difference| difference.key).collect()
        };
        assert_eq!(keys("observation = [{ kind = 'privileged' }]"), ["randomise"]);
        assert!(keys("observation = [{ kind = 'history', steps = 2 }]").is_empty());
    }
}
