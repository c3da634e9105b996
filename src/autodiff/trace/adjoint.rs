//! The adjoint of a recording: what each operation passes back to its operands.
//!
//! The adjoint of y = f(x) maps (x, ȳ) to x̄ = (∂f/∂x)ᵀ ȳ. It is another [`Recording`], made by walking the graph
//! backwards once (Griewank and Walther 2008, chapter 3) with ordinary `Trace` arithmetic, so it is simplified, compiled
//! and evaluated like any other.

use super::function::{Function, Section};
use super::graph::{Call, Callee, Node};
use super::{Recording, Trace, TraceMask, inputs, new_results_of, own, push, push_call, record, results_of};
use crate::program::Tape;
use crate::scalar::Scalar;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

/// The adjoint of a function in two parts: what goes forward with it, and what runs backwards later.
#[derive(Debug)]
pub(super) struct Adjoint {
    /// Which results have seeds, and which inputs' adjoints are asked for.
    seeded: Vec<bool>,
    wanted: Vec<bool>,
    /// The function's results, and behind them what its derivatives are made of.
    pub(super) forward: Function,
    /// The adjoints of the wanted inputs.
    reverse: Section,
    /// What the inputs of `reverse` are.
    reads: Vec<Read>,
}

/// A number that runs backwards.
#[derive(Debug, Clone, Copy)]
enum Read {
    Input(u32),
    /// A result of what goes forward.
    Result(u32),
    Seed(u32),
}

impl Adjoint {
    pub(super) fn is_for(&self, seeded: &[bool], wanted: &[bool]) -> bool {
        self.seeded == seeded && self.wanted == wanted
    }
}

/// A recording that goes forward before its adjoint: its functions give what theirs are made of.
struct Taped {
    recording: Recording,
    adjoints: Adjoints,
}

/// Adjoints of functions, by the nodes of their calls.
type Adjoints = HashMap<u32, Arc<Adjoint>>;

impl Recording {
    /// The adjoint with respect to the inputs in `with_respect_to`: inputs `[x; ȳ]` (those of this recording, then one
    /// seed per result), results x̄ over that range.
    pub fn adjoint(&self, with_respect_to: Range<usize>) -> Self {
        self.adjoint_of(|_| true, with_respect_to)
    }

    /// As [`Recording::adjoint`] where the seeds of other results than `seeded` are zero: they stay inputs, and what only
    /// they need falls away.
    #[doc(hidden)]
    pub fn adjoint_of(&self, seeded: impl Fn(usize) -> bool, with_respect_to: Range<usize>) -> Self {
        let seeded: Vec<bool> = (0..self.outputs.len()).map(seeded).collect();
        let wanted: Vec<bool> = (0..self.n_input).map(|k| with_respect_to.contains(&k)).collect();
        self.taped(&seeded, &wanted).adjoint(&seeded, places(with_respect_to))
    }

    /// The Jacobian with respect to the inputs in `with_respect_to`, column by column: one reverse sweep per result, all on
    /// one graph. What is zero by structure costs nothing, and what the sweeps share is computed once.
    pub fn jacobian(&self, with_respect_to: Range<usize>) -> Self {
        let recording = self.inlined();
        record(recording.graph(), recording.n_input, || {
            let inputs = input_nodes(places(with_respect_to));
            let sweep = |output: &u32| recording.reverse_sweep(&Adjoints::new(), &[(*output, Trace::one())], &inputs);
            let rows: Vec<Vec<Trace>> = recording.outputs.iter().map(sweep).collect();
            (0..inputs.len()).flat_map(|k| rows.iter().map(move |row| row[k])).collect()
        })
    }

    /// The adjoint in two parts.
    pub(super) fn parted(&self, seeded: &[bool], wanted: &[bool]) -> Adjoint {
        let taped = self.taped(seeded, wanted);
        let places = (0..self.n_input as u32).filter(|k| wanted[*k as usize]);
        let joint = taped.adjoint(seeded, places);
        let mut is_late = vec![false; joint.nodes.len()];
        for (i, node) in joint.nodes.iter().enumerate() {
            let is_seed = matches!(node, Node::Input(k) if *k as usize >= self.n_input);
            is_late[i] = is_seed || node.operands(&joint.calls).any(|operand| is_late[operand as usize]);
        }
        let needed = joint.between(&[], &joint.outputs);
        let late = (0..joint.nodes.len()).filter(|i| needed[*i] && is_late[*i]);
        let (mut given, mut reads, mut results) = (Vec::new(), Vec::new(), taped.recording.outputs.clone());
        let mut is_given = vec![false; joint.nodes.len()];
        let mut give = |i: u32| {
            if is_given[i as usize] {
                return;
            }
            let read = match joint.nodes[i as usize] {
                Node::Input(k) if (k as usize) < self.n_input => Read::Input(k),
                Node::Input(k) => Read::Seed(k - self.n_input as u32),
                Node::Constant(_) => return,
                _ if is_late[i as usize] => return,
                _ => {
                    let known = results.iter().position(|result| *result == i).unwrap_or_else(|| {
                        results.push(i);
                        results.len() - 1
                    });
                    Read::Result(known as u32)
                }
            };
            is_given[i as usize] = true;
            given.push(i);
            reads.push(read);
        };
        late.flat_map(|i| joint.nodes[i].operands(&joint.calls))
            .chain(joint.outputs.iter().copied())
            .for_each(&mut give);
        // the tape comes last, in its order
        let n_own = self.outputs.len();
        let mut order: Vec<usize> = (0..reads.len()).collect();
        order.sort_by_key(|k| if let Read::Result(k) = reads[*k] { (k as usize).saturating_sub(n_own - 1) } else { 0 });
        let (reads, given): (Vec<Read>, Vec<u32>) = order.into_iter().map(|k| (reads[k], given[k])).unzip();
        let inputs: Vec<u32> = (0..self.n_input as u32).collect();
        let n_tape = results.len() - n_own;
        let forward = Function::of(joint.part(&inputs, &results), Tape::Results(n_tape));
        let reverse = Section::of(joint.part(&given, &joint.outputs), Tape::Inputs(n_tape));
        Adjoint { seeded: seeded.to_vec(), wanted: wanted.to_vec(), forward, reverse, reads }
    }

    /// The same recording with functions that give what their adjoints are made of.
    fn taped(&self, seeded: &[bool], wanted: &[bool]) -> Taped {
        let mut adjoints = Adjoints::new();
        if !self.has_functions() {
            return Taped { recording: self.clone(), adjoints };
        }
        let (is_moved, is_seeded) = (self.moved_by(wanted), self.seeded_by(seeded));
        let recording = record(self.empty_graph(), self.n_input, || {
            self.replayed(&inputs(self.n_input), Ok, |at, call, operands| match &call.callee {
                Callee::Custom(operation) => push_call(operation, operands),
                Callee::Function(function) => {
                    let n = call.callee.n_output();
                    let wanted: Vec<bool> = call.operands.iter().map(|o| is_moved[*o as usize]).collect();
                    let seeded = &is_seeded[at + 1..=at + n];
                    if !wanted.contains(&true) || !seeded.contains(&true) {
                        return results_of(call.callee.clone(), operands);
                    }
                    let adjoint = function.adjoint(seeded, &wanted);
                    // a call of its own, also where an equal one is there: that has an adjoint of its own
                    let (at, mut results) = new_results_of(Callee::Function(adjoint.forward.clone()), operands);
                    adjoints.insert(at, adjoint);
                    results.truncate(n);
                    results
                }
            })
        });
        Taped { recording, adjoints }
    }

    /// Which nodes have a derivative with respect to the `wanted` inputs, as far as structure says.
    fn moved_by(&self, wanted: &[bool]) -> Vec<bool> {
        let mut is_moved = vec![false; self.nodes.len()];
        for (i, node) in self.nodes.iter().enumerate() {
            is_moved[i] = match node {
                Node::Input(k) => wanted[*k as usize],
                node => self.passes_to(node).any(|operand| is_moved[operand as usize]),
            };
        }
        is_moved
    }

    /// Which nodes the `seeded` results have a derivative with respect to, as far as structure says.
    fn seeded_by(&self, seeded: &[bool]) -> Vec<bool> {
        let mut is_seeded = vec![false; self.nodes.len()];
        for (output, is_own) in self.outputs.iter().zip(seeded) {
            is_seeded[*output as usize] |= is_own;
        }
        for i in (0..self.nodes.len()).rev() {
            if is_seeded[i] {
                self.passes_to(&self.nodes[i]).for_each(|operand| is_seeded[operand as usize] = true);
            }
        }
        is_seeded
    }

    /// The operands that a node passes anything back to.
    fn passes_to(&self, node: &Node) -> impl Iterator<Item = u32> {
        use Node::*;
        let n_mask = usize::from(matches!(node, Select(..)));
        let n = if matches!(node, Less(..) | And(..) | Or(..) | Not(_) | Detach(_)) { 0 } else { usize::MAX };
        node.operands(&self.calls).skip(n_mask).take(n)
    }

    fn reverse_sweep(&self, adjoints: &Adjoints, seeds: &[(u32, Trace)], inputs: &[u32]) -> Vec<Trace> {
        let mut adjoint: Vec<Option<Trace>> = vec![None; self.nodes.len()];
        let accumulate = |adjoint: &mut Vec<Option<Trace>>, i: u32, value: Trace| {
            let sum = &mut adjoint[i as usize];
            *sum = Some(sum.map_or(value, |s| s + value));
        };
        for (output, seed) in seeds {
            accumulate(&mut adjoint, *output, *seed);
        }
        for i in (0..self.nodes.len()).rev() {
            if let Node::Call(number) = self.nodes[i] {
                let own = adjoints.get(&(i as u32)).map(|adjoint| &**adjoint);
                for (operand, value) in pull_back_call(&self.calls[number as usize], i as u32, own, &adjoint[i + 1..]) {
                    accumulate(&mut adjoint, operand, value);
                }
            }
            let Some(g) = adjoint[i] else { continue };
            for (operand, value) in pull_back(self.nodes[i], own(i as u32), g).into_iter().flatten() {
                accumulate(&mut adjoint, operand, value);
            }
        }
        inputs.iter().map(|i| adjoint.get(*i as usize).copied().flatten().unwrap_or_else(Trace::zero)).collect()
    }
}

impl Taped {
    fn adjoint(&self, seeded: &[bool], with_respect_to: impl Iterator<Item = u32>) -> Recording {
        let Self { recording, adjoints } = self;
        let n_seed = seeded.len();
        record(recording.graph(), recording.n_input + n_seed, || {
            let seeds: Vec<Trace> = (0..n_seed).map(|k| push(Node::Input((recording.n_input + k) as u32))).collect();
            let inputs = input_nodes(with_respect_to);
            let all = recording.outputs.iter().copied().zip(seeds).zip(seeded);
            let own: Vec<(u32, Trace)> = all.filter(|(_, seeded)| **seeded).map(|(seed, _)| seed).collect();
            recording.reverse_sweep(adjoints, &own, &inputs)
        })
    }
}

/// Numbers of inputs.
pub(super) fn places(range: Range<usize>) -> impl Iterator<Item = u32> {
    range.map(|k| k as u32)
}

pub(super) fn input_nodes(range: impl Iterator<Item = u32>) -> Vec<u32> {
    range.map(|k| push(Node::Input(k)).node()).collect()
}

/// What the call at a node passes to its operands when its results' adjoints are the first of `behind`: its transposed, once;
/// nothing where they are all zero.
fn pull_back_call(call: &Call, at: u32, adjoint: Option<&Adjoint>, behind: &[Option<Trace>]) -> Vec<(u32, Trace)> {
    let zero = Trace::zero();
    let n_seed = adjoint.map_or(call.callee.n_output(), |adjoint| adjoint.seeded.len());
    let seeds: Vec<Trace> = behind.iter().take(n_seed).map(|g| g.unwrap_or(zero)).collect();
    if seeds.iter().all(|g| g.is(zero)) {
        return Vec::new();
    }
    let x = || call.operands.iter().copied();
    match (&call.callee, adjoint) {
        (Callee::Custom(operation), _) => {
            let inputs: Vec<Trace> = x().map(own).chain(seeds).collect();
            x().zip(push_call(operation.adjoint(), &inputs)).collect()
        }
        (Callee::Function(_), Some(adjoint)) => {
            let read = |read: &Read| match read {
                Read::Input(k) => own(call.operands[*k as usize]),
                Read::Result(k) => own(at + 1 + k),
                Read::Seed(k) => seeds[*k as usize],
            };
            let inputs: Vec<Trace> = adjoint.reads.iter().map(read).collect();
            let moved = x().zip(&adjoint.wanted).filter(|(_, wanted)| **wanted).map(|(operand, _)| operand);
            moved.zip(adjoint.reverse.on(&inputs)).collect()
        }
        // by structure, no derivative passes through it
        (Callee::Function(_), None) => Vec::new(),
    }
}

/// What `node` (whose value is `y`) passes to its operands when its own adjoint is `g`.
pub(super) fn pull_back(node: Node, y: Trace, g: Trace) -> [Option<(u32, Trace)>; 3] {
    use Node::*;
    let zero = Trace::zero;
    match node {
        Input(_) | Constant(_) | Less(..) | And(..) | Or(..) | Not(_) | Detach(_) | Call(_) | Result(..) => [None; 3],
        Add(a, b) => [Some((a, g)), Some((b, g)), None],
        Sub(a, b) => [Some((a, g)), Some((b, -g)), None],
        Mul(a, b) => [Some((a, g * own(b))), Some((b, g * own(a))), None],
        MulAdd(a, b, c) => [Some((a, g * own(b))), Some((b, g * own(a))), Some((c, g))],
        Div(a, b) => {
            let over = g * own(b).recip();
            [Some((a, over)), Some((b, -(over * y))), None]
        }
        Neg(a) => [Some((a, -g)), None, None],
        Recip(a) => [Some((a, -(g * (y * y)))), None, None],
        Sqrt(a) => [Some((a, g * (Trace::constant(0.5) * y.recip()))), None, None],
        Sin(a) => [Some((a, g * push(Cos(a)))), None, None],
        Cos(a) => [Some((a, -(g * push(Sin(a))))), None, None],
        Exp(a) => [Some((a, g * y)), None, None],
        Ln(a) => [Some((a, g * own(a).recip())), None, None],
        Tanh(a) => [Some((a, g * (Trace::one() - y * y))), None, None],
        Atan2(a, b) => {
            let (ty, tx) = (own(a), own(b));
            let over = g * (tx * tx + ty * ty).recip();
            [Some((a, over * tx)), Some((b, -(over * ty))), None]
        }
        Select(m, a, b) => {
            let mask = TraceMask(own(m).0);
            [Some((a, Trace::select(mask, g, zero()))), Some((b, Trace::select(mask, zero(), g))), None]
        }
    }
}
