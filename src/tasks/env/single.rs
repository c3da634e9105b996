//! One environment at a time, for newcomers and for scripts: a batch of one.

use super::{Buffers, Env, Spec};
use crate::config::{Autoreset, EnvConfig};
use base::error::Result;

/// What a step of a [`SingleEnv`] gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SingleStep<'a> {
    /// `[A · observation]`: all agents', one after the other.
    pub observation: &'a [f32],
    /// Reward of the team.
    pub reward: f32,
    /// The task ended the episode.
    pub terminated: bool,
    /// Its time was over.
    pub truncated: bool,
    /// Columns of [`Spec::info`], `[info]`.
    pub info: &'a [f32],
}

/// One environment. It does not restart by itself: call [`SingleEnv::reset`] when an episode is over.
///
/// ```
/// # use omnidrones_tasks::omnidrones;
/// use omnidrones::tasks::{EnvConfig, SingleEnv};
///
/// let mut env = SingleEnv::make("Hover", &EnvConfig::default())?;
/// let mut observation = env.reset(7)?.to_vec();
/// let mut total = 0.0;
/// loop {
///     let thrust = -0.415 + 0.3 * observation[2] - 0.2 * observation[9]; // climb towards the target, damp the climb
///     let step = env.step(&[thrust; 4])?;
///     total += step.reward;
///     observation.copy_from_slice(step.observation);
///     if step.terminated || step.truncated {
///         break;
///     }
/// }
/// assert!(total > 0.0);
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug)]
pub struct SingleEnv {
    env: Env,
    buffers: Buffers,
}

impl SingleEnv {
    /// A registered task; `n_env` and `autoreset` of the configuration play no part.
    ///
    /// # Errors
    /// As [`Env::make`].
    pub fn make(task: &str, config: &EnvConfig) -> Result<Self> {
        Ok(Self::of(Env::make(task, &Self::one(config))?))
    }

    /// The configuration of a batch of one.
    pub fn one(config: &EnvConfig) -> EnvConfig {
        EnvConfig { n_env: 1, autoreset: Autoreset::Disabled, ..config.clone() }
    }

    /// Of an environment that was built with [`SingleEnv::one`].
    pub fn of(env: Env) -> Self {
        let buffers = Buffers::new(env.spec());
        Self { env, buffers }
    }

    /// Begins the first episode of a seed; returns its first observation, `[A · observation]`.
    ///
    /// # Errors
    /// None: its buffers have the right lengths.
    pub fn reset(&mut self, seed: u64) -> Result<&[f32]> {
        self.env.reset(None, Some(&[seed]), &mut self.buffers.out())?;
        Ok(&self.buffers.observation)
    }

    /// One step with the actions of all agents, one after the other, `[A · action]`, each number in [−1, 1].
    ///
    /// # Errors
    /// As [`Env::step`].
    pub fn step(&mut self, action: &[f32]) -> Result<SingleStep<'_>> {
        self.env.step(action, &mut self.buffers.out())?;
        let b = &self.buffers;
        Ok(SingleStep {
            observation: &b.observation,
            reward: b.reward[0],
            terminated: b.terminated[0] == 1,
            truncated: b.truncated[0] == 1,
            info: &b.info,
        })
    }

    /// Names, sizes, units, bounds.
    pub fn spec(&self) -> &Spec {
        self.env.spec()
    }

    /// The batch of one.
    pub fn env(&mut self) -> &mut Env {
        &mut self.env
    }
}
