//! A network for each agent of a team, all of one shape: rows stand agent by agent, and each goes through its own agent's.

use super::aligned::Aligned;
use super::graph::{LayerGraph, ValueSpan};
use super::network::{Level, Memory, Network, Output, Pass, Scratch, Slot, Transposed, Weights};
use base::error::{Error, Result};
use rng::Stream;
use std::sync::Arc;

/// Networks that take turns: row k goes through number k mod n. Their parameters follow each other.
///
/// # Panics
/// [`Network::forward`] and [`Network::backward`] for rows that are not of whole teams, beside what they panic for themselves.
#[derive(Debug, Clone)]
pub struct PerAgent {
    network: Arc<dyn Network>,
    agents: usize,
}

impl PerAgent {
    /// One like `network` for each of `agents` agents.
    ///
    /// # Errors
    /// [`Error::Value`] for no agent, and for a network with a memory.
    pub fn new(network: Arc<dyn Network>, agents: usize) -> Result<Self> {
        if agents == 0 {
            return Err(Error::value("agents with a network each", agents, "≥ 1", "Give a team."));
        }
        if network.n_state() > 0 {
            let remedy = "Leave it out, or show a history instead (a stage `history`, an encoder of kind conv1d).";
            return Err(Error::value("network.memory", "given", "left out where every agent has its own", remedy));
        }
        Ok(Self { network, agents })
    }

    /// One like `network` for each of `agents` agents where they are `separate`, else `network` for all.
    ///
    /// # Errors
    /// As [`PerAgent::new`].
    pub fn of_team(network: &Arc<dyn Network>, agents: usize, separate: bool) -> Result<Arc<dyn Network>> {
        Ok(if separate { Arc::new(Self::new(network.clone(), agents)?) } else { network.clone() })
    }

    /// Rows of each agent among `rows`.
    fn rows(&self, rows: usize) -> usize {
        assert!(rows.is_multiple_of(self.agents), "{rows} rows of teams of {}", self.agents);
        rows / self.agents
    }

    /// The numbers of agent `k` among all parameters.
    fn of<'a>(&self, parameters: &'a [f32], k: usize) -> &'a [f32] {
        let n = self.network.n_parameter();
        &parameters[k * n..(k + 1) * n]
    }

    /// Rows of agent `k` of `x`, `n` numbers each, side by side.
    fn gather(&self, x: &[f32], k: usize, n: usize, to: &mut [f32]) {
        let rows = x.chunks_exact(n).skip(k).step_by(self.agents);
        to.chunks_exact_mut(n).zip(rows).for_each(|(to, row)| to.copy_from_slice(row));
    }
}

impl Network for PerAgent {
    fn n_input(&self) -> usize {
        self.network.n_input()
    }

    fn n_output(&self) -> usize {
        self.network.n_output()
    }

    fn n_parameter(&self) -> usize {
        self.agents * self.network.n_parameter()
    }

    fn n_activation(&self) -> usize {
        self.network.n_activation() + self.n_input() + self.n_output()
    }

    fn slots(&self) -> Vec<Slot> {
        let n = self.network.n_parameter();
        let of = |k: usize| self.network.slots().into_iter().map(move |slot| slot.of(&format!("agent{k}."), k * n));
        (0..self.agents).flat_map(of).collect()
    }

    fn init(&self, stream: &mut Stream) -> Vec<f32> {
        (0..self.agents).flat_map(|_| self.network.init(stream)).collect()
    }

    fn memory(&self, rows: usize) -> Memory {
        let each = rows.div_ceil(self.agents);
        let levels = [self.n_output(), self.n_input()].map(|n| Level::of(each * self.agents * n));
        Memory { levels: levels.into(), parts: (0..self.agents).map(|_| self.network.memory(each)).collect() }
    }

    fn scratch(&self, rows: usize) -> Scratch {
        let each = rows.div_ceil(self.agents);
        let more = [self.n_output(), self.n_input()].map(|n| Aligned::zeros(each * n));
        Scratch { more: more.into(), parts: vec![self.network.scratch(each)], ..Scratch::default() }
    }

    fn transpose(&self, parameters: &[f32], transposed: &mut Transposed) {
        transposed.parts.resize(self.agents, Transposed::default());
        for (k, own) in transposed.parts.iter_mut().enumerate() {
            self.network.transpose(self.of(parameters, k), own);
        }
    }

    /// Of the agent that the graph is of.
    fn describe(&self, parameters: &[f32], graph: &mut LayerGraph, x: &ValueSpan, h: &ValueSpan) -> [ValueSpan; 2] {
        self.network.describe(self.of(parameters, graph.set()), graph, x, h)
    }

    fn forward<'m>(&self, parameters: &[f32], x: &[f32], rows: usize, memory: &'m mut Memory) -> Output<'m> {
        let (each, n_in, n_out) = (self.rows(rows), self.n_input(), self.n_output());
        let Memory { levels, parts } = memory;
        let (given, seen) = levels.split_at_mut(1);
        let (given, seen) = (&mut given[0].y, &mut seen[0].y);
        for (k, part) in parts.iter_mut().enumerate() {
            let seen = &mut seen[k * each * n_in..][..each * n_in];
            self.gather(&x[..rows * n_in], k, n_in, seen);
            let own = self.network.forward(self.of(parameters, k), seen, each, part);
            for row in 0..each {
                given[(row * self.agents + k) * n_out..][..n_out].copy_from_slice(own.row(row));
            }
        }
        Output { data: &given[..rows * n_out], n: n_out, wide: n_out }
    }

    fn backward(&self, net: Weights<'_>, _: &[f32], rows: usize, memory: &Memory, grad_output: &[f32], pass: Pass<'_>) {
        let (each, n, n_in, n_out) = (self.rows(rows), self.network.n_parameter(), self.n_input(), self.n_output());
        let Pass { gradient, grad_input, scratch } = pass;
        let Scratch { more, parts, .. } = scratch;
        let (pulled, moved) = more.split_at_mut(1);
        let pulled = &mut pulled[0][..each * n_out];
        let moved = if grad_input.is_empty() { &mut [][..] } else { &mut moved[0][..each * n_in] };
        for (k, part) in memory.parts.iter().enumerate() {
            self.gather(&grad_output[..rows * n_out], k, n_out, pulled);
            let own = if gradient.is_empty() { &mut [][..] } else { &mut gradient[k * n..(k + 1) * n] };
            let weights = Weights { parameters: self.of(net.parameters, k), transposed: &net.transposed.parts[k] };
            let pass = Pass { gradient: own, grad_input: &mut *moved, scratch: &mut parts[0] };
            let seen = &memory.levels[1].y[k * each * n_in..][..each * n_in];
            self.network.backward(weights, seen, each, part, pulled, pass);
            let rows = grad_input.chunks_exact_mut(n_in).skip(k).step_by(self.agents);
            rows.zip(moved.chunks_exact(n_in)).for_each(|(to, row)| to.copy_from_slice(row));
        }
    }

    fn saturated(&self, memory: &Memory, rows: usize, limit: f32) -> f64 {
        let each = self.rows(rows);
        memory.parts.iter().map(|own| self.network.saturated(own, each, limit)).sum::<f64>() / self.agents as f64
    }

    fn n_set(&self) -> usize {
        self.agents
    }

    fn bias_for(&self, y: f64) -> f64 {
        self.network.bias_for(y)
    }
}
