//! What has been learnt: a network, a distribution over its outputs, and what it expects to see.

use super::nn::head::Head;
use super::nn::{Activation, Encoded, Encoder, Layers, Memory, Mlp, Network, Recurrence, Stack};
use super::recall::Recall;
use base::error::{Error, Result};
use base::parallel::Threads;
use std::sync::Arc;
use tasks::{Env, GroupKind, Space, Spec, Statistics};

/// What a learner says that has one policy for all agents.
const UNLIKE: &str = "Train by happo, by matd3 with td3.separate_actors = true, by vdn or qmix with dqn.separate_values = true, or by apg or shac.";

/// Rows that go through a network together: their activations stay in the second-level cache.
#[doc(hidden)]
pub const ROWS: usize = 64;

/// The shape of an actor: one network for all agents, or one of that shape for each.
#[derive(Debug, Clone)]
pub struct Actor {
    /// From one agent's observation to outputs of the head: a perceptron, or what stands before one too.
    pub mlp: Arc<dyn Network>,
    /// From outputs to actions.
    pub head: Head,
    n_action: usize,
    /// Of each set of parameters: from the first of the outputs to the first numbers of an action, where its agent has no more.
    heads: Vec<Head>,
}

/// Up to [`ROWS`] rows that one set of parameters acts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PolicyBlock {
    /// Which set.
    pub set: usize,
    /// Its first row.
    pub first: usize,
    /// From one row to the next: the number of sets.
    pub stride: usize,
    /// Rows.
    pub rows: usize,
}

impl PolicyBlock {
    /// Row `k` of the block among all.
    pub fn row(&self, k: usize) -> usize {
        self.first + k * self.stride
    }

    /// Its rows of `x`, `width` numbers each, side by side: in `x` itself, or else in `gathered`.
    pub fn of<'a>(&self, x: &'a [f32], width: usize, gathered: &'a mut Vec<f32>) -> &'a [f32] {
        if self.stride == 1 {
            return &x[self.first * width..][..self.rows * width];
        }
        gathered.clear();
        (0..self.rows).for_each(|k| gathered.extend_from_slice(&x[self.row(k) * width..][..width]));
        gathered
    }
}

impl Actor {
    /// For one agent of an environment. With `squashed`, outputs of continuous actions pass tanh.
    ///
    /// # Errors
    /// As `Mlp::new`, [`Spec::group`] and [`Encoder::network`]; [`Error::Value`] for layers with
    /// a memory: see [`Actor::with_memory`].
    pub fn new(spec: &Spec, layers: &Layers, squashed: bool) -> Result<Self> {
        if layers.memory.is_some() {
            let remedy = "Leave it out, show a history instead (a stage `history`, an encoder of kind conv1d), or train with ppo.";
            return Err(Error::value("network.memory", "given", "left out: this algorithm learns none", remedy));
        }
        Self::with_memory(spec, layers, squashed)
    }

    /// As [`Actor::new`] for learners that hand on what is remembered (`Network::n_state`).
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
        Ok(Self { mlp, head, n_action: spec.action.len(), heads: vec![head] })
    }

    /// With parameters for each agent of `spec` where they are `separate`: rows then follow each other agent by agent. For learners
    /// that weigh actions by their probability, fit values of them or imitate them: numbers that move nothing must take no part, so
    /// that agents who share parameters must have equally many.
    ///
    /// # Errors
    /// [`Error::Value`] for a network with a memory for each agent, and for unlike agents who share one.
    pub fn for_team(self, spec: &Spec, separate: bool) -> Result<Self> {
        let widths: Vec<usize> = (0..spec.n_agent).map(|agent| spec.n_action_of(agent)).collect();
        if separate && spec.n_agent > 1 && self.mlp.n_state() > 0 {
            let remedy = "Share the policy, or show a history instead (a stage `history`, an encoder of kind conv1d).";
            return Err(Error::value("network.memory", "given", "left out where every agent has its own", remedy));
        }
        if separate {
            let heads = widths.iter().map(|n| self.head.of_first(*n)).collect();
            return Ok(Self { heads, ..self });
        }
        if widths.iter().any(|n| *n != self.n_action) {
            let value = format!("{widths:?}");
            return Err(Error::value(
                "numbers of the agents' actions",
                value,
                "equal where agents share a policy",
                UNLIKE,
            ));
        }
        Ok(self)
    }

    /// Sets of parameters: 1, or one for each agent.
    pub fn n_set(&self) -> usize {
        self.heads.len()
    }

    /// From outputs of set `set` to actions.
    pub fn head_of(&self, set: usize) -> Head {
        self.heads[set]
    }

    /// Numbers of one agent's action.
    pub fn n_action(&self) -> usize {
        self.n_action
    }

    /// Numbers of one agent's observation.
    pub fn n_observation(&self) -> usize {
        self.mlp.n_input() - self.mlp.n_state()
    }

    /// Network parameters, then those of the head; of one agent after the other where each has its own.
    pub fn n_parameter(&self) -> usize {
        self.n_set() * self.n_parameter_of_set()
    }

    /// Those of one set.
    pub fn n_parameter_of_set(&self) -> usize {
        self.mlp.n_parameter() + self.head.n_extra()
    }

    /// Of one set those of the network, and those of the head.
    pub fn set<'a>(&self, parameters: &'a [f32], k: usize) -> (&'a [f32], &'a [f32]) {
        let n = self.n_parameter_of_set();
        parameters[k * n..(k + 1) * n].split_at(self.mlp.n_parameter())
    }

    /// What a set of parameters is called among tensors.
    pub(crate) fn set_name(&self, k: usize) -> String {
        if self.n_set() == 1 { "actor".into() } else { format!("actor.agent{k}") }
    }

    /// All of `rows` rows `[environment, agent]`, block by block.
    pub fn blocks(&self, rows: usize) -> impl Iterator<Item = PolicyBlock> {
        let (stride, of_set) = (self.n_set(), rows / self.n_set());
        let firsts = move |set| (0..of_set).step_by(ROWS).map(move |k| (set, k));
        (0..stride).flat_map(firsts).map(move |(set, k)| PolicyBlock {
            set,
            first: set + k * stride,
            stride,
            rows: ROWS.min(of_set - k),
        })
    }

    /// Deterministic actions `[rows, action]` for observations `[rows, observation]`, of a shared actor without memory.
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
    memory: Vec<Acting>,
    /// Rows of the last act.
    rows: usize,
    threads: Threads,
}

/// What one thread acts with, on its part of the rows.
#[derive(Debug, Clone)]
struct Acting {
    memory: Memory,
    recall: Recall,
    gathered: Vec<f32>,
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

    /// A learner's actor with its parameters, for environments like `env`.
    ///
    /// # Errors
    /// As [`Policy::new`].
    pub fn of(actor: &Actor, parameters: &[f32], env: &Env) -> Result<Self> {
        let statistics = env.statistics();
        let statistics = (!statistics.mean.is_empty()).then(|| statistics.clone());
        Self::new(actor.clone(), parameters.to_vec(), statistics, env.spec())
    }

    /// Its shape: network and head.
    pub fn actor(&self) -> &Actor {
        &self.actor
    }

    /// Network parameters, then those of the head.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// Statistics of the normaliser it was trained behind; `None` without one.
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
        self.memory.iter_mut().for_each(|own| own.recall.forget_all());
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
            let of_part = self.actor.n_set() * ROWS;
            self.memory[row / of_part].recall.forget(row % of_part);
        }
        Ok(())
    }

    /// Actions `[E, A, action]` for observations `[E, A, observation]`.
    ///
    /// # Errors
    /// [`Error::Value`] for arrays that are not of whole rows, or not of equally many, or not of whole teams where every agent
    /// has its own parameters.
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
        if !rows.is_multiple_of(self.actor.n_set()) {
            let limit = format!("a multiple of {}: every agent has its own network", self.actor.n_set());
            return Err(Error::value("rows", rows, limit, "Show the whole team."));
        }
        let of_part = self.actor.n_set() * ROWS;
        let missing = rows.div_ceil(of_part).saturating_sub(self.memory.len());
        let fresh = |_| Acting {
            memory: self.actor.mlp.memory(ROWS),
            recall: Recall::new(&self.actor, of_part, ROWS),
            gathered: Vec::new(),
        };
        self.memory.extend((0..missing).map(fresh));
        if rows != self.rows {
            self.reset();
            self.rows = rows;
        }
        let (actor, parameters) = (&self.actor, &self.parameters);
        let parts = observation.chunks(n_in * of_part).zip(actions.chunks_mut(n_out * of_part));
        let mut own: Vec<_> = parts.zip(&mut self.memory).collect();
        self.threads.for_each(&mut own, |_, ((x, actions), Acting { memory, recall, gathered })| {
            for block in actor.blocks(actions.len() / n_out) {
                let (network, extra) = actor.set(parameters, block.set);
                let output = recall.forward(actor, network, block.of(x, n_in, gathered), 0, memory);
                for k in 0..block.rows {
                    let action = &mut actions[block.row(k) * n_out..][..n_out];
                    action.fill(0.0);
                    actor.head_of(block.set).mode(output.row(k), extra, action);
                }
            }
        });
        Ok(())
    }
}
