//! Whose episodes are shown: the policy of a run, or a task under our own controller.

use super::environment::EnvArguments;
use super::episodes::Flown;
use super::rollout::{ControllerName, PlanArguments};
use super::{baseline, eval, robot, rollout};
use crate::prelude::*;
use omnidrones::dynamics::vehicles;
use omnidrones::parallel::Threads;
use omnidrones::tasks::{Autoreset, EnvConfig, EvaluationStep, registry};

/// Most episodes in one picture.
pub const MAX_SHOWN: usize = 16;

/// Refuses more episodes than can be told apart.
pub fn check_number(envs: usize) -> Result<()> {
    if (1..=MAX_SHOWN).contains(&envs) {
        return Ok(());
    }
    let remedy = "More cannot be told apart; 'eval' draws thousands.";
    Err(Error::limit("envs", envs, format!("1 to {MAX_SHOWN}"), remedy))
}

/// Who flies.
pub enum Flier {
    /// A policy, from the starts of its evaluations.
    Policy(Box<eval::Ready>),
    /// Our controller.
    Own(Box<rollout::Ready>),
}

impl Flier {
    /// What `named` means: a task by its name, else the folder of a run. A task stands beside the run `beside`, if that is of it:
    /// the same starts in the same environments.
    pub fn new(named: &str, options: &EnvArguments, envs: usize, beside: Option<&Self>) -> Result<Self> {
        let threads = Threads::default();
        let path = Path::new(named);
        if let Ok(entry) = registry::by_name(named) {
            let usual = match beside {
                Some(Self::Policy(ready)) if ready.saved.manifest.task == entry.name => {
                    baseline::for_controller(entry, &ready.saved.config)
                }
                _ => EnvConfig::default(),
            };
            let config = options.config(&usual, Some(entry))?;
            let config = EnvConfig { autoreset: Autoreset::Disabled, n_env: envs, ..config.whole_episodes() };
            let by = (ControllerName::Default, &PlanArguments::default(), None);
            return Ok(Self::Own(Box::new(rollout::Ready::new(entry, &config, &threads, by)?)));
        }
        if !path.exists() {
            refuse_flyer(named)?;
        }
        Ok(Self::Policy(Box::new(eval::Ready::new(path, options, Some(envs), &threads)?)))
    }

    /// One episode of every environment, the next one with every call; `watch` sees every step.
    pub fn fly(&mut self, watch: &mut dyn FnMut(&EvaluationStep<'_>)) -> Result<Flown> {
        match self {
            Self::Policy(ready) => ready.fly(0, watch),
            Self::Own(ready) => ready.fly(0, watch),
        }
    }

    /// Where its pages go unless told otherwise.
    pub fn folder(&self, named: &str) -> std::path::PathBuf {
        match self {
            Self::Policy(_) => named.into(),
            Self::Own(_) => super::files::default_folder(named),
        }
    }
}

/// Refuses what flies where episodes are shown, with the command that is for it.
fn refuse_flyer(named: &str) -> Result<()> {
    if vehicles::by_name(named).is_err() && robot::configuration(named).is_none() {
        return Ok(());
    }
    let (value, limit) =
        (format!("'{named}', which is a vehicle or a configuration"), "a task, or the folder of a run");
    let remedy = format!(
        "'omnidrones fly {named} --replay' flies it and writes such a page; 'omnidrones tasks' lists the tasks."
    );
    Err(Error::value("what is shown", value, limit, remedy))
}
