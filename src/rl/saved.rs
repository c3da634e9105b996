//! A policy from the files of a run, ready to fly, without the learner that made it.

use super::checkpoint::{Checkpoint, Manifest, Skipped, Store, Tensors};
use super::config::TrainConfig;
use super::policy::Policy;
use super::state;
use crate::error::{Error, Result};
use crate::tasks::{Env, EnvConfig, Spec, Statistics};
use std::path::{Path, PathBuf};

/// A policy and where it comes from.
#[derive(Debug)]
pub struct Saved {
    /// Ready to fly.
    pub policy: Policy,
    /// What its checkpoint is of.
    pub manifest: Manifest,
    /// How it was trained.
    pub config: TrainConfig,
    /// Its checkpoint.
    pub folder: PathBuf,
    /// Newer checkpoints that were damaged: say so to whoever asked for the newest.
    pub skipped: Vec<Skipped>,
}

/// The policy of a checkpoint's folder, or of the newest whole checkpoint of a run.
///
/// # Errors
/// [`Error::File`] if there is neither, [`Error::Format`] for damaged files, [`Error::Value`] if the task has changed
/// since.
pub fn load_policy(path: impl AsRef<Path>) -> Result<Saved> {
    let path = path.as_ref();
    let (checkpoint, folder, skipped) = if path.join("manifest.json").exists() {
        (Checkpoint::load(path)?, path.to_path_buf(), Vec::new())
    } else {
        let found = Store::open(path)?.latest()?.ok_or_else(|| nothing(path))?;
        (found.checkpoint, found.folder, found.skipped)
    };
    let Checkpoint { manifest, policy, state } = checkpoint;
    let file = folder.join("manifest.json").display().to_string();
    let config = TrainConfig::from_toml(&manifest.config, &file)?;
    let env = Env::make(&manifest.task, &EnvConfig { n_env: 1, ..config.seen_env() })?;
    let policy = policy_of(&config, env.spec(), &policy, &state)?;
    if policy.spec_hash() != manifest.spec_hash {
        let (now, then) = (format!("{:016x}", policy.spec_hash()), format!("{:016x}", manifest.spec_hash));
        let remedy = format!("The task has changed since: fly it with version {}.", manifest.version);
        return Err(Error::value(format!("{file}: hash of the environment"), now, then, remedy));
    }
    Ok(Saved { policy, manifest, config, folder, skipped })
}

fn nothing(path: &Path) -> Error {
    Error::value("checkpoints", format!("none in {}", path.display()), "1 or more", "Train until the first is written.")
}

/// Names of the head's parameters and of the normaliser's statistics.
const HEAD: &str = "actor.log_std";
const MEAN: &str = "normaliser.mean";
const VARIANCE: &str = "normaliser.variance";
const COUNT: &str = "normaliser.count";

/// Adds to what the learner saved: the parameters of the head and the statistics, rounded among the weights for other
/// programs, whole in the state.
pub(crate) fn put_policy(own: &Policy, policy: &mut Tensors, state: &mut Tensors) -> Result<()> {
    let head = &own.parameters()[own.actor().mlp.n_parameter()..];
    if !head.is_empty() && policy.tensor(HEAD).is_err() {
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
    let actor = config.actor(spec)?;
    let mut parameters = state::network(policy, "actor", &actor.mlp)?;
    let n_head = actor.head.n_extra();
    if n_head > 0 {
        parameters.extend_from_slice(policy.get::<f32>(HEAD, &[n_head])?);
    }
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
