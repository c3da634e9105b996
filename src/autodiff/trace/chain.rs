//! The chain rule of a recording as a graph: vertices are intermediate numbers, edges carry partial derivatives.
//!
//! A recorded y = f(x) is linearised operation by operation: ȳ of an operand gets w = ∂(result)/∂(operand) times that of the
//! result (Griewank and Walther 2008, chapter 9). What a vertex passes on may be multiplied into its neighbours' edges and
//! the vertex dropped, which leaves the Jacobian as it is (*vertex elimination*, chapter 10 there): every path through it becomes
//! an edge, whose weight is computed once, while an edge costs a multiplication per row of the Jacobian. So vertices go
//! while that is cheaper; what is left is swept once for all rows.

use super::adjoint::{input_nodes, places, pull_back};
use super::graph::Place;
use super::{Recording, Trace, own, record};
use crate::scalar::Scalar;
use std::collections::{BinaryHeap, HashMap};
use std::ops::Range;

/// What an edge leads to: a result of the recording, or a vertex that was swept before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Head {
    Result(u32),
    Vertex(u32),
}

/// Edges out of one number.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Vertex {
    /// Which input it is, of those that derivatives are taken of.
    pub(crate) input: Option<u32>,
    /// To where, and which result of [`Chain::values`] is the weight.
    pub(crate) edges: Vec<(Head, u32)>,
}

/// A recording's results and partial derivatives, and how those make up its Jacobian.
#[derive(Debug, Clone)]
pub(crate) struct Chain {
    /// x → the recording's results, then weights.
    pub(crate) values: Recording,
    /// In the order of a reverse sweep, those that wait for the fewest others first; all inputs are among them, each once.
    pub(crate) vertices: Vec<Vertex>,
}

/// What is cheaper than what, measured by the time that an edge takes in a sweep.
#[derive(Debug, Clone, Copy)]
pub(crate) struct EdgeCost {
    /// Of multiplying two weights, and adding the product to a third.
    pub(crate) product: f64,
    /// Of a vertex, beside its edges.
    pub(crate) vertex: f64,
    /// A result that no more edges than these lead to is written in the inputs.
    pub(crate) few: usize,
}

impl Recording {
    /// The chain rule with respect to the inputs in `with_respect_to`; nothing where a custom function is called, whose derivative
    /// is no number.
    pub(crate) fn chain(&self, with_respect_to: Range<usize>, price: EdgeCost) -> Option<Chain> {
        let recording = self.inlined();
        if !recording.calls.is_empty() {
            return None;
        }
        let mut vertices = Vec::new();
        let values = record(recording.graph(), recording.n_input, || {
            let inputs = input_nodes(places(with_respect_to));
            let mut graph = Linear::of(&recording, &inputs);
            graph.shorten(price.few);
            graph.eliminate(price);
            let mut results: Vec<Trace> = recording.outputs.iter().map(|o| own(*o)).collect();
            vertices = graph.sweep(&inputs, &mut results);
            results
        });
        Some(Chain { values, vertices })
    }
}

/// The linearised graph. Vertices are nodes of the recording, then one per result.
struct Linear {
    n_node: usize,
    /// Edges into each vertex: from which, weight.
    into: Vec<Vec<(u32, Trace)>>,
    /// To which edges lead out of each.
    out: Vec<Vec<u32>>,
    is_input: Vec<bool>,
}

fn is_unit(x: Trace) -> bool {
    x.known().is_some_and(|c| c.abs() == 1.0)
}

impl Linear {
    fn of(recording: &Recording, inputs: &[u32]) -> Self {
        let n_node = recording.nodes.len().max(inputs.iter().map(|i| *i as usize + 1).max().unwrap_or(0));
        let n = n_node + recording.outputs.len();
        let mut graph = Self { n_node, into: vec![Vec::new(); n], out: vec![Vec::new(); n], is_input: vec![false; n] };
        inputs.iter().for_each(|i| graph.is_input[*i as usize] = true);
        let mut needed = vec![false; n_node];
        recording.outputs.iter().for_each(|o| needed[*o as usize] = true);
        for i in (0..recording.nodes.len()).rev() {
            if needed[i] {
                recording.nodes[i].operands(&[]).for_each(|o| needed[o as usize] = true);
            }
        }
        // on the way from an input to a result
        let mut active = graph.is_input.clone();
        for (i, node) in recording.nodes.iter().enumerate() {
            if needed[i] && !graph.is_input[i] {
                for (operand, weight) in pull_back(*node, own(i as u32), Trace::one()).into_iter().flatten() {
                    if active[operand as usize] && weight.known() != Some(0.0) {
                        active[i] = true;
                        graph.connect(operand, i as u32, weight);
                    }
                }
            }
        }
        for (k, output) in recording.outputs.iter().enumerate() {
            if active[*output as usize] {
                graph.connect(*output, (n_node + k) as u32, Trace::one());
            }
        }
        // what leads to no result
        for i in (0..n_node).rev() {
            if graph.out[i].is_empty() {
                graph.isolate(i);
            }
        }
        graph
    }

    fn connect(&mut self, from: u32, to: u32, weight: Trace) {
        match self.into[to as usize].iter_mut().find(|(source, _)| *source == from) {
            Some((_, sum)) => *sum += weight,
            None => {
                self.into[to as usize].push((from, weight));
                self.out[from as usize].push(to);
            }
        }
    }

    /// Takes away the edges into a vertex.
    fn isolate(&mut self, vertex: usize) {
        for (source, _) in std::mem::take(&mut self.into[vertex]) {
            self.out[source as usize].retain(|to| *to as usize != vertex);
        }
    }

    /// Takes the edge from `vertex` to `to` away and gives its weight.
    fn cut(&mut self, vertex: u32, to: u32) -> Trace {
        let edges = &mut self.into[to as usize];
        let at = edges.iter().position(|(source, _)| *source == vertex);
        at.map_or(Trace::zero(), |at| edges.swap_remove(at).1)
    }

    /// Every path through `vertex` becomes an edge.
    fn remove(&mut self, vertex: u32) {
        let into = self.into[vertex as usize].clone();
        for to in std::mem::take(&mut self.out[vertex as usize]) {
            let behind = self.cut(vertex, to);
            for (source, weight) in &into {
                self.connect(*source, to, *weight * behind);
            }
        }
        self.isolate(vertex as usize);
    }

    /// Edges saved by removing a vertex, less what its products cost.
    fn gain(&self, vertex: usize, price: EdgeCost) -> f64 {
        let (into, out) = (&self.into[vertex], &self.out[vertex]);
        let (mut cost, mut new) = (0.0, 0);
        for to in out {
            let edges = &self.into[*to as usize];
            let behind = self.weight(vertex, *to);
            for (source, weight) in into {
                let known = |x: Trace| x.known().is_some();
                let free = is_unit(behind) || is_unit(*weight) || (known(behind) && known(*weight));
                let parallel = edges.iter().any(|(other, _)| other == source);
                new += usize::from(!parallel);
                cost += if free && !parallel { 0.0 } else { price.product };
            }
        }
        (into.len() + out.len()) as f64 - new as f64 + price.vertex - cost
    }

    fn is_inner(&self, vertex: usize) -> bool {
        vertex < self.n_node && !self.is_input[vertex] && !self.out[vertex].is_empty()
    }

    /// Results that few edges lead to are written in the inputs, so that no sweep need carry them.
    fn shorten(&mut self, few: usize) {
        for result in self.n_node..self.into.len() {
            let mut before = vec![result];
            let mut seen = vec![false; self.into.len()];
            let mut edges = 0;
            while let Some(vertex) = before.pop() {
                edges += self.into[vertex].len();
                for (source, _) in &self.into[vertex] {
                    if !std::mem::replace(&mut seen[*source as usize], true) {
                        before.push(*source as usize);
                    }
                }
                if edges > few {
                    break;
                }
            }
            while edges <= few
                && let Some((source, weight)) = self.into[result]
                    .iter()
                    .copied()
                    .filter(|(s, _)| !self.is_input[*s as usize])
                    .max_by_key(|(s, _)| *s)
            {
                self.cut(source, result as u32);
                self.out[source as usize].retain(|to| *to as usize != result);
                for (before, own) in self.into[source as usize].clone() {
                    self.connect(before, result as u32, own * weight);
                }
            }
        }
        for i in (0..self.n_node).rev() {
            if self.out[i].is_empty() {
                self.isolate(i);
            }
        }
    }

    /// Takes vertices away while that gains, the one that gains most first.
    fn eliminate(&mut self, price: EdgeCost) {
        let rank = |gain: f64| (gain * 16.0) as i64;
        let mut queue: BinaryHeap<(i64, u32)> = BinaryHeap::new();
        let push = |graph: &Self, queue: &mut BinaryHeap<(i64, u32)>, vertex: usize| {
            if graph.is_inner(vertex) {
                let gain = graph.gain(vertex, price);
                if gain > 0.0 {
                    queue.push((rank(gain), vertex as u32));
                }
            }
        };
        for vertex in 0..self.n_node {
            push(self, &mut queue, vertex);
        }
        while let Some((known, vertex)) = queue.pop() {
            let at = vertex as usize;
            if !self.is_inner(at) || rank(self.gain(at, price)) != known {
                continue;
            }
            let around: Vec<u32> = self.into[at].iter().map(|e| e.0).chain(self.out[at].iter().copied()).collect();
            self.remove(vertex);
            for neighbour in around {
                push(self, &mut queue, neighbour as usize);
            }
        }
    }

    /// The weight of an edge.
    fn weight(&self, from: usize, to: u32) -> Trace {
        let edge = self.into[to as usize].iter().find(|(source, _)| *source as usize == from);
        edge.map_or_else(Trace::zero, |(_, weight)| *weight)
    }

    /// Vertices that are left; their weights go behind `results`.
    fn sweep(&self, inputs: &[u32], results: &mut Vec<Trace>) -> Vec<Vertex> {
        // sums that must be made before
        let mut level = vec![0_u32; self.into.len()];
        for i in (0..self.n_node).rev() {
            level[i] = self.out[i].iter().map(|to| level[*to as usize] + 1).max().unwrap_or(0);
        }
        let is_left = |i: &usize| self.is_input[*i] || !self.out[*i].is_empty();
        let mut order: Vec<usize> = (0..self.n_node).rev().filter(is_left).collect();
        // sums of one length side by side: their loops end where the processor expects it
        order.sort_by_key(|i| (level[*i], self.out[*i].len()));
        let mut place: HashMap<Place, u32> = HashMap::new();
        let mut number = vec![0; self.n_node];
        let mut vertices = Vec::with_capacity(order.len());
        for i in order {
            let edge = |to: &u32| {
                let weight = self.weight(i, *to);
                let at = *place.entry(weight.0).or_insert_with(|| {
                    results.push(weight);
                    results.len() as u32 - 1
                });
                let result = (*to as usize).checked_sub(self.n_node);
                (result.map_or_else(|| Head::Vertex(number[*to as usize]), |k| Head::Result(k as u32)), at)
            };
            let mut edges: Vec<(Head, u32)> = self.out[i].iter().map(edge).collect();
            // what is known last is added last
            edges.sort_by_key(|(head, _)| match head {
                Head::Result(_) => 0,
                Head::Vertex(v) => v + 1,
            });
            number[i] = vertices.len() as u32;
            let input = inputs.iter().position(|input| *input as usize == i).map(|k| k as u32);
            vertices.push(Vertex { input, edges });
        }
        vertices
    }
}
