//! Who shows how it is done.

use super::{DaggerConfig, ImitationTarget, Shard};
use crate::learner::Make;
use crate::nn::{Encoded, Memory, last_encoder};
use crate::policy::{Policy, ROWS};
use crate::policy_io::load_policy;
use base::error::{Error, Result};
use base::parallel::Threads;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};
use tasks::{Baseline, Buffers, Env, EnvConfig, ObservationTransform, Spec};

/// A controller of the task, or a policy.
pub(super) enum Teacher {
    /// One that is yet to be told: see [`Dagger::teach`](super::Dagger).
    Awaited,
    /// Controllers may be sent to threads, but not shared.
    Controller(Mutex<Baseline>),
    Policy(Box<Expert>),
}

/// A policy, and the environments as it sees them.
pub(super) struct Expert {
    policy: Policy,
    twin: Env,
    out: Buffers,
    /// Where what its last encoder gives is taught in place of its actions: the encoder, its parameters among the policy's.
    latent: Option<(Encoded, Range<usize>, Memory)>,
    read: Vec<f32>,
}

impl Expert {
    /// In twins of a shard's environments with the observation of its training.
    fn new(mut policy: Policy, observation: Vec<ObservationTransform>, shard: &Shard, make: &Make<'_>) -> Result<Self> {
        let mut twin = make(&EnvConfig { observation, ..shard.env.spec().config.clone() })?;
        policy.fits(twin.spec())?;
        if let Some(known) = policy.statistics() {
            twin.set_statistics(known.clone())?;
        }
        let one = Threads::new(1)?;
        twin.set_threads(one.clone());
        policy.set_threads(one);
        let mut out = Buffers::new(twin.spec());
        twin.reset(None, None, &mut out.out())?;
        Ok(Self { policy, twin, out, latent: None, read: Vec::new() })
    }

    /// What its last encoder gives now, where that is taught.
    fn say(&mut self, label: &mut [f32]) {
        let Some((encoder, place, memory)) = &mut self.latent else { return };
        let (n_seen, n_label) = (self.twin.spec().n_observation, encoder.network.n_output());
        let parameters = &self.policy.parameters()[place.clone()];
        for (seen, label) in self.out.observation.chunks(ROWS * n_seen).zip(label.chunks_mut(ROWS * n_label)) {
            self.read.clear();
            seen.chunks_exact(n_seen).for_each(|row| self.read.extend_from_slice(&row[encoder.columns.clone()]));
            encoder.network.forward(parameters, &self.read, seen.len() / n_seen, memory).write(label);
        }
    }
}

impl Teacher {
    /// Of actions.
    ///
    /// # Errors
    /// As [`Baseline::new`]; [`load_policy`], [`Policy::fits`] for a run.
    pub(super) fn new(shard: &Shard, config: &DaggerConfig, make: &Make<'_>) -> Result<Self> {
        if config.imitate == ImitationTarget::Latent {
            return Ok(Self::Awaited);
        }
        if config.teacher.is_empty() {
            return Ok(Self::Controller(Mutex::new(Baseline::new(&shard.env)?)));
        }
        let saved = load_policy(&config.teacher)?;
        let observation = saved.config.seen_env().observation;
        Ok(Self::Policy(Box::new(Expert::new(saved.policy, observation, shard, make)?)))
    }

    /// Of what the last encoder of a policy gives.
    ///
    /// # Errors
    /// As [`last_encoder`] and [`Policy::fits`].
    pub(super) fn of_latent(policy: Policy, of: &Spec, shard: &Shard, make: &Make<'_>) -> Result<Self> {
        let (stack, last) = last_encoder(&*policy.actor().mlp)?;
        let encoder = stack.encoders()[last].clone();
        let (place, memory) = (stack.encoder_place(last), encoder.network.memory(ROWS));
        let own = Expert::new(policy, of.config.observation.clone(), shard, make)?;
        Ok(Self::Policy(Box::new(Expert { latent: Some((encoder, place, memory)), ..own })))
    }

    /// Fresh episodes, those that `env` has just begun.
    pub(super) fn reset(&mut self, env: &Env) -> Result<()> {
        match self {
            Self::Awaited => (),
            Self::Controller(own) => *own = Mutex::new(Baseline::new(env)?),
            Self::Policy(own) => {
                own.policy.reset();
                own.twin.reset(None, None, &mut own.out.out())?;
            }
        }
        Ok(())
    }

    /// Whether what its last encoder gives is to be imitated, not its actions.
    pub(super) fn teaches_latent(&self) -> bool {
        matches!(self, Self::Policy(own) if own.latent.is_some())
    }

    /// What it would do now.
    pub(super) fn act(&mut self, env: &Env, actions: &mut [f32]) -> Result<()> {
        match self {
            Self::Awaited => {
                Err(Error::value("teacher", "none", "told before the first update", "Call Learner::teach."))
            }
            Self::Controller(own) => own.get_mut().unwrap_or_else(PoisonError::into_inner).act(env, actions),
            Self::Policy(own) => own.policy.act(&own.out.observation, actions),
        }
    }

    /// What is to be imitated where it would do `actions`.
    pub(super) fn label(&mut self, actions: &[f32], label: &mut [f32]) {
        match self {
            Self::Policy(own) if own.latent.is_some() => own.say(label),
            _ => label.copy_from_slice(actions),
        }
    }

    /// The step that `actions` made, which ended the episodes marked in `ended`.
    pub(super) fn follow(&mut self, actions: &[f32], ended: impl Iterator<Item = bool>) -> Result<()> {
        match self {
            Self::Awaited => Ok(()),
            Self::Controller(own) => {
                let own = own.get_mut().unwrap_or_else(PoisonError::into_inner);
                ended.enumerate().filter(|(_, ended)| *ended).for_each(|(i, _)| own.forget(i));
                Ok(())
            }
            Self::Policy(own) => {
                let begins: Vec<u8> = ended.map(u8::from).collect();
                own.policy.forget(&begins)?;
                own.twin.step(actions, &mut own.out.out())
            }
        }
    }

    /// A policy's environments.
    pub(super) fn twin(&self) -> Option<&Env> {
        match self {
            Self::Awaited | Self::Controller(_) => None,
            Self::Policy(own) => Some(&own.twin),
        }
    }

    /// Likewise.
    pub(super) fn twin_mut(&mut self) -> Option<&mut Env> {
        match self {
            Self::Awaited | Self::Controller(_) => None,
            Self::Policy(own) => Some(&mut own.twin),
        }
    }
}
