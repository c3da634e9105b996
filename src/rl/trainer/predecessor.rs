//! A run that begins from another one trains that first.

use super::{Trainer, Watch};
use crate::config::TrainConfig;
use crate::policy::Policy;
use crate::policy_io::load_policy;
use crate::predecessor::{checked, spec};
use base::error::Result;
use base::file_gate;
use base::parallel::Threads;
use std::path::Path;
use tasks::Spec;

/// A policy to begin from, and what it cost.
pub(super) struct Predecessor {
    pub(super) policy: Policy,
    /// Of the environments that it was trained in.
    pub(super) spec: Spec,
    /// Time that this run spent on it, s.
    pub(super) seconds: f64,
    /// Steps of environments that this run spent on it.
    pub(super) env_steps: u64,
    /// Whether its training was asked to stop.
    pub(super) stopped: bool,
}

/// What [`TrainConfig::from`] names: the folder of a run or checkpoint; or `Task`, `Task/algorithm` or `/algorithm`, which is
/// trained by its recipe and [`TrainConfig::from_settings`], with the seed, vehicle and control mode of `config`, and kept in `folder`
/// where there is one, so that it goes on behind a kill.
///
/// # Errors
/// As [`load_policy`], [`TrainConfig::layered`] and [`Trainer::run`].
pub(super) fn predecessor(
    config: &TrainConfig,
    folder: Option<&Path>,
    threads: &Threads,
    watch: &mut Watch<'_>,
) -> Result<Predecessor> {
    let Some((task, own)) = checked(config)? else {
        let saved = load_policy(&config.from)?;
        let spec = spec(&saved.manifest.task, &saved.config)?;
        return Ok(Predecessor { policy: saved.policy, spec, seconds: 0.0, env_steps: 0, stopped: false });
    };
    let spec = spec(&task, &own)?;
    let mut trainer = Trainer::new(&task, own, threads.clone())?;
    if let Some(folder) = folder {
        file_gate::own_folder(folder)?;
        trainer = trainer.in_folder(folder, true)?;
    }
    let told = trainer.run(watch)?;
    let (seconds, env_steps, stopped) = (told.seconds, told.env_steps, told.stopped);
    Ok(Predecessor { policy: told.policy, spec, seconds, env_steps, stopped })
}
