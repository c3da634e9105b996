//! What has been learnt: a network, a distribution over its outputs, and what it expects to see.

use super::nn::head::Head;
use super::nn::{Activation, Encoded, Encoder, Layers, Memory, Mlp, Network, Recurrence, Stack};
use super::recall::Recall;
use crate::error::{Error, Result};
use crate::parallel::Threads;
use crate::tasks::{Env, GroupKind, Space, Spec, Statistics};
use std::sync::Arc;

/// Rows that go through a network together: their activations stay in the second-level cache.
pub const ROWS: usize = 64;

/// The shape of an actor: one network for all agents.
#[derive(Debug, Clone)]
pub struct Actor {
    /// From one agent's observation to outputs of the head: a perceptron, or what stands before one too.
    pub mlp: Arc<dyn Network>,
    /// From outputs to actions.
    pub head: Head,
    n_action: usize,
}

impl Actor {
    /// For one agent of an environment. With `squashed`, outputs of continuous actions pass tanh.
    ///
    /// # Errors
    /// As [`Mlp::new`], [`Spec::group`] and [`Encoder::network`]; [`Error::Value`] for layers with
    /// a memory: see [`Actor::with_memory`].
    pub fn new(spec: &Spec, layers: &Layers, squashed: bool) -> Result<Self> {
        if layers.memory.is_some() {
            let remedy = "Leave it out, show a history instead (a stage `history`, an encoder of kind conv1d), or train with ppo.";
            return Err(Error::value("network.memory", "given", "left out: this algorithm learns none", remedy));
        }
        Self::with_memory(spec, layers, squashed)
    }

    /// As [`Actor::new`] for learners that hand on what is remembered ([`Network::n_state`]).
    ///
    /// # Errors
    /// As there, but for layers with a memory.
    pub fn with_memory(spec: &Spec, layers: &Layers, squashed: bool) -> Result<Self> {
        let head = match spec.action {
            Space::Box { n, .. } => Head::Gaussian { n },
            Space::Discrete { n } => Head::Categorical { n },
            Space::MultiDiscrete { n, levels } => Head::MultiCategorical { n, levels },
        };
        let output = if squashed { Activation::Tanh } else { Activation::Identity };
        let mlp = network(spec, layers, head.n_output(), output)?;
        Ok(Self { mlp, head, n_action: spec.action.len() })
    }

    /// Numbers of one agent's action.
    pub fn n_action(&self) -> usize {
        self.n_action
    }

    /// Numbers of one agent's observation.
    pub fn n_observation(&self) -> usize {
        self.mlp.n_input() - self.mlp.n_state()
    }

    /// Network parameters, then those of the head.
    pub fn n_parameter(&self) -> usize {
        self.mlp.n_parameter() + self.head.n_extra()
    }

    /// Deterministic actions `[rows, action]` for observations `[rows, observation]`, of an actor without memory.
    pub fn modes(&self, parameters: &[f32], x: &[f32], memory: &mut Memory, actions: &mut [f32]) {
        let (network, extra) = parameters.split_at(self.mlp.n_parameter());
        let rows = x.len() / self.mlp.n_input();
        let output = self.mlp.forward(network, x, rows, memory);
        for (row, action) in actions.chunks_exact_mut(self.n_action).enumerate() {
            self.head.mode(output.row(row), extra, action);
        }
    }
}

/// From an agent's observation to `n_out` numbers.
pub(super) fn network(spec: &Spec, layers: &Layers, n_out: usize, output: Activation) -> Result<Arc<dyn Network>> {
    layers.validate()?;
    if layers.is_plain() {
        return Ok(Arc::new(Mlp::new(spec.n_observation, layers, n_out, output)?));
    }
    let encoded = |encoder: &Encoder| {
        let group = spec.group(encoder.group())?;
        if matches!(group.kind, GroupKind::Critic | GroupKind::Privileged) {
            let remedy = "Name a group of the observation; a stage `privileged` shows what policies are not told.";
            return Err(Error::value("group of an encoder", group.name, "one that the policy sees", remedy));
        }
        Ok(Encoded { columns: group.columns, network: encoder.network(&group.shape, layers)? })
    };
    let encoders = layers.encoder.iter().map(encoded).collect::<Result<_>>()?;
    let units = layers.memory.as_ref().map(Recurrence::units);
    let trunk = |n_in| Mlp::new(n_in, &layers.plain(), n_out, output);
    Ok(Arc::new(Stack::new(spec.n_observation, encoders, layers.join, units, trunk)?))
}

/// A policy that flies.
///
/// One with memory remembers the rows that it acted on, by their places, until [`Policy::reset`] or [`Policy::forget`], or
/// until it acts on another number of rows.
///
/// Actions are the distribution's most likely ones. Made by [`Learner::policy`](super::Learner::policy) or from a
/// checkpoint; see [`evaluate`](super::evaluate()).
#[derive(Debug, Clone)]
pub struct Policy {
    actor: Actor,
    parameters: Vec<f32>,
    statistics: Option<Statistics>,
    spec_hash: u64,
    memory: Vec<(Memory, Recall)>,
    /// Rows of the last act.
    rows: usize,
    threads: Threads,
}

impl Policy {
    /// From its parts; `statistics` are those of the stage `normalise` of the observation, if it has one.
    ///
    /// # Errors
    /// [`Error::Value`] for another number of parameters or one that is not finite.
    pub fn new(actor: Actor, parameters: Vec<f32>, statistics: Option<Statistics>, spec: &Spec) -> Result<Self> {
        if parameters.len() != actor.n_parameter() {
            let (got, wanted) = (parameters.len(), actor.n_parameter().to_string());
            return Err(Error::value("parameters of the policy", got, wanted, "Give those of this network."));
        }
        if let Some(x) = parameters.iter().find(|x| !x.is_finite()) {
            let remedy = "Lower the learning rate, or load an earlier checkpoint.";
            return Err(Error::value("a parameter of the policy", x, "finite", remedy));
        }
        Ok(Self {
            actor,
            parameters,
            statistics,
            spec_hash: spec.hash(),
            memory: Vec::new(),
            rows: 0,
            threads: Threads::default(),
        })
    }

    /// What a learner has learnt in environments like `env`.
    ///
    /// # Errors
    /// As [`Policy::new`].
    pub fn of(actor: &Actor, parameters: &[f32], env: &Env) -> Result<Self> {
        let statistics = env.statistics();
        let statistics = (!statistics.mean.is_empty()).then(|| statistics.clone());
        Self::new(actor.clone(), parameters.to_vec(), statistics, env.spec())
    }

    /// What shape it has.
    pub fn actor(&self) -> &Actor {
        &self.actor
    }

    /// Network parameters, then those of the head.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// Of the normaliser it was trained behind.
    pub fn statistics(&self) -> Option<&Statistics> {
        self.statistics.as_ref()
    }

    /// Which environments it fits: [`Spec::hash`].
    pub fn spec_hash(&self) -> u64 {
        self.spec_hash
    }

    /// Acts on these threads from now on.
    pub fn set_threads(&mut self, threads: Threads) {
        self.threads = threads;
    }

    /// Checks that an environment shows and takes what the policy was trained with.
    ///
    /// # Errors
    /// [`Error::Value`] otherwise.
    pub fn fits(&self, spec: &Spec) -> Result<()> {
        if spec.hash() == self.spec_hash {
            return Ok(());
        }
        let remedy =
            "Use the vehicle, control mode, dt and transforms that it was trained with: they stand in its checkpoint.";
        for (what, got, wanted) in [
            ("length of an observation", spec.n_observation, self.actor.n_observation()),
            ("length of an action", spec.action.len(), self.actor.n_action),
        ] {
            if got != wanted {
                return Err(Error::value(what, got, format!("{wanted}, as the policy was trained with"), remedy));
            }
        }
        let (got, wanted) = (format!("{:016x}", spec.hash()), format!("{:016x}, that of the policy", self.spec_hash));
        Err(Error::value("hash of the environment", got, wanted, remedy))
    }

    /// Numbers that it remembers of each row; 0 without memory.
    pub fn n_state(&self) -> usize {
        self.actor.mlp.n_state()
    }

    /// All episodes begin anew: nothing is remembered.
    pub fn reset(&mut self) {
        self.memory.iter_mut().for_each(|(_, recall)| recall.forget_all());
    }

    /// The episodes of these environments begin anew: `[E]`, not 0 where one does. Before the first act it does nothing.
    ///
    /// # Errors
    /// [`Error::Value`] unless the rows of the last act are so many environments'.
    pub fn forget(&mut self, begins: &[u8]) -> Result<()> {
        if self.rows == 0 {
            return Ok(());
        }
        if begins.is_empty() || !self.rows.is_multiple_of(begins.len()) {
            let limit = format!("a divisor of {}, the rows of the last act", self.rows);
            return Err(Error::value("environments", begins.len(), limit, "Give one number per environment."));
        }
        let agents = self.rows / begins.len();
        for row in (0..self.rows).filter(|row| begins[row / agents] != 0) {
            self.memory[row / ROWS].1.forget(row % ROWS);
        }
        Ok(())
    }

    /// Actions `[E, A, action]` for observations `[E, A, observation]`.
    ///
    /// # Errors
    /// [`Error::Value`] for arrays that are not of whole rows, or not of equally many.
    pub fn act(&mut self, observation: &[f32], actions: &mut [f32]) -> Result<()> {
        let (n_in, n_out) = (self.actor.n_observation(), self.actor.n_action);
        let rows = observation.len() / n_in;
        for (what, got, wanted) in [
            ("length of observations", observation.len(), rows * n_in),
            ("length of actions", actions.len(), rows * n_out),
        ] {
            if got != wanted {
                let limit = format!("{wanted} for {rows} rows");
                let remedy = format!("Rows are [environment, agent]: {n_in} numbers observed, {n_out} acted.");
                return Err(Error::value(what, got, limit, remedy));
            }
        }
        let parts = actions.len().div_ceil(n_out * ROWS);
        let missing = parts.saturating_sub(self.memory.len());
        let fresh = |_| (self.actor.mlp.memory(ROWS), Recall::new(&self.actor, ROWS, ROWS));
        self.memory.extend((0..missing).map(fresh));
        if rows != self.rows {
            self.reset();
            self.rows = rows;
        }
        let (actor, parameters) = (&self.actor, &self.parameters);
        let own = observation.chunks(n_in * ROWS).zip(actions.chunks_mut(n_out * ROWS)).zip(&mut self.memory);
        let mut own: Vec<_> = own.collect();
        let (network, extra) = parameters.split_at(actor.mlp.n_parameter());
        self.threads.for_each(&mut own, |_, ((x, actions), (memory, recall))| {
            let output = recall.forward(actor, network, x, 0, memory);
            for (row, action) in actions.chunks_exact_mut(n_out).enumerate() {
                actor.head.mode(output.row(row), extra, action);
            }
        });
        Ok(())
    }
}
