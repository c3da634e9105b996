//! Functions of a recording: recorded once, called as often as they occur.
//!
//! A function is known by what it computes. Two parts of a kernel that record the same operations of as many numbers are the same
//! function, whoever wrote them; a number that is constant for one of them is part of what it computes.

use super::adjoint::Adjoint;
use super::graph::{Call, Callee, Graph, Node, end_function};
use super::{Recording, Trace, own, push, results_of};
use crate::once::made_once;
use crate::program::{Tape, ValueForm};
use std::cell::RefCell;
use std::collections::HashMap;
use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, Mutex, OnceLock, Weak};

/// Fewer operations than these are recorded where they are: a call would cost as much.
const FEW: usize = 16;

/// A function that recordings call.
#[derive(Clone)]
pub(crate) struct Function(Arc<Inner>);

struct Inner {
    recording: Recording,
    tape: Tape,
    hash: u64,
    form: OnceLock<Arc<ValueForm>>,
    adjoints: Mutex<Vec<Arc<Adjoint>>>,
}

thread_local! {
    /// Functions that somebody has, by their hashes.
    static KNOWN: RefCell<HashMap<u64, Vec<Weak<Inner>>>> = RefCell::new(HashMap::new());
}

impl Function {
    /// The function of a recording: the one that is known, or a new one.
    pub(super) fn of(recording: Recording, tape: Tape) -> Self {
        let mut hasher = DefaultHasher::new();
        (&recording, tape).hash(&mut hasher);
        let hash = hasher.finish();
        KNOWN.with_borrow_mut(|known| {
            let alike = known.entry(hash).or_default();
            alike.retain(|function| function.strong_count() > 0);
            let found = alike.iter().filter_map(Weak::upgrade).find(|inner| inner.is(&recording, tape));
            Self(found.unwrap_or_else(|| {
                let (form, adjoints) = (OnceLock::new(), Mutex::new(Vec::new()));
                let made = Arc::new(Inner { recording, tape, hash, form, adjoints });
                alike.push(Arc::downgrade(&made));
                made
            }))
        })
    }

    pub(crate) fn recording(&self) -> &Recording {
        &self.0.recording
    }

    /// As values, made once.
    pub(crate) fn form(&self) -> &Arc<ValueForm> {
        let Inner { recording, tape, form, .. } = &*self.0;
        made_once(form, || Arc::new(ValueForm { tape: *tape, ..ValueForm::of(recording) }))
    }

    /// The adjoint with these results seeded and these inputs asked for, made once. The lock is tried and not waited for: in a process
    /// made by `fork` nobody may be there who gives it back.
    pub(super) fn adjoint(&self, seeded: &[bool], wanted: &[bool]) -> Arc<Adjoint> {
        let make = || Arc::new(self.0.recording.parted(seeded, wanted));
        let Ok(mut known) = self.0.adjoints.try_lock() else { return make() };
        if let Some(found) = known.iter().find(|adjoint| adjoint.is_for(seeded, wanted)) {
            return found.clone();
        }
        let made = make();
        // a linear function goes forward as it is, and would hold itself
        if made.forward != *self {
            known.push(made.clone());
        }
        made
    }
}

impl PartialEq for Function {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0) || self.0.hash == other.0.hash && self.0.is(&other.0.recording, other.0.tape)
    }
}

impl Eq for Function {}

impl Hash for Function {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.0.hash.hash(state);
    }
}

impl fmt::Debug for Function {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Function({} -> {})", self.0.recording.n_input(), self.0.recording.n_output())
    }
}

impl Inner {
    fn is(&self, recording: &Recording, tape: Tape) -> bool {
        self.tape == tape && self.recording == *recording
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        // not where the thread ends
        let _ = KNOWN.try_with(|known| {
            if let Ok(mut known) = known.try_borrow_mut()
                && known.get(&self.hash).is_some_and(|alike| alike.iter().all(|other| other.strong_count() == 0))
            {
                known.remove(&self.hash);
            }
        });
    }
}

/// Ends the function on top, and calls it.
pub(super) fn end(outputs: &mut [Trace]) {
    let places = outputs.iter().map(|output| output.node()).collect();
    let (Graph { nodes, calls, arithmetic, .. }, captured) = end_function();
    let recording = Recording { nodes, calls, n_input: captured.len(), outputs: places, arithmetic };
    let section = Section::of(recording, Tape::None);
    let inputs: Vec<Trace> = captured.into_iter().map(own).collect();
    outputs.copy_from_slice(&section.on(&inputs));
}

/// What a result of a [`Section`] is.
#[derive(Debug, Clone, Copy)]
pub(super) enum Source {
    Input(u32),
    Constant(f64),
    /// Of the function.
    Result(u32),
}

/// A recording as something to call: a function of the inputs that it reads, for the results that it computes; or few operations.
#[derive(Debug)]
pub(super) enum Section {
    Few(Recording),
    Call { function: Function, inputs: Vec<u32>, results: Vec<Source> },
}

impl Section {
    /// The last inputs of an adjoint may be the tape of its function: they are read.
    pub(super) fn of(recording: Recording, tape: Tape) -> Self {
        let (mut computed, mut results) = (Vec::new(), Vec::new());
        for output in &recording.outputs {
            results.push(match recording.nodes[*output as usize] {
                Node::Input(k) => Source::Input(k),
                Node::Constant(bits) => Source::Constant(f64::from_bits(bits)),
                _ => {
                    let known = computed.iter().position(|own| own == output).unwrap_or_else(|| {
                        computed.push(*output);
                        computed.len() - 1
                    });
                    Source::Result(known as u32)
                }
            });
        }
        let needed = recording.between(&[], &computed);
        let read = recording.nodes.iter().enumerate().filter(|(i, node)| needed[*i] && matches!(node, Node::Input(_)));
        let (places, inputs): (Vec<u32>, Vec<u32>) =
            read.map(|(i, node)| (i as u32, if let Node::Input(k) = node { *k } else { 0 })).unzip();
        let part = recording.part(&places, &computed);
        let is_long = part.nodes.len() - part.n_input > FEW || part.has_functions();
        if is_long { Self::Call { function: Function::of(part, tape), inputs, results } } else { Self::Few(recording) }
    }

    /// Its results on the graph on top.
    pub(super) fn on(&self, operands: &[Trace]) -> Vec<Trace> {
        match self {
            Self::Few(recording) => recording.on(operands),
            Self::Call { function, inputs, results } => {
                let own: Vec<Trace> = inputs.iter().map(|k| operands[*k as usize]).collect();
                let computed = results_of(Callee::Function(function.clone()), &own);
                let result = |source: &Source| match source {
                    Source::Input(k) => operands[*k as usize],
                    Source::Constant(x) => push(Node::Constant(x.to_bits())),
                    Source::Result(k) => computed[*k as usize],
                };
                results.iter().map(result).collect()
            }
        }
    }
}

impl Recording {
    /// Which nodes lead from `given` to `outputs`, those left out.
    pub(super) fn between(&self, given: &[u32], outputs: &[u32]) -> Vec<bool> {
        let mut is_given = vec![false; self.nodes.len()];
        given.iter().for_each(|node| is_given[*node as usize] = true);
        let mut needed = vec![false; self.nodes.len()];
        outputs.iter().for_each(|output| needed[*output as usize] = true);
        for i in (0..self.nodes.len()).rev() {
            needed[i] &= !is_given[i];
            if needed[i] {
                self.nodes[i].operands(&self.calls).for_each(|operand| needed[operand as usize] = true);
            }
        }
        needed
    }

    /// The same function of the inputs that its results depend on, and which those are.
    #[doc(hidden)]
    pub fn of_used_inputs(&self) -> (Self, Vec<usize>) {
        let needed = self.between(&[], &self.outputs);
        let of_input = |(i, node): (usize, &Node)| match node {
            Node::Input(k) if needed[i] => Some((i as u32, *k as usize)),
            _ => None,
        };
        let (places, inputs): (Vec<u32>, Vec<usize>) = self.nodes.iter().enumerate().filter_map(of_input).unzip();
        (self.part(&places, &self.outputs), inputs)
    }

    /// What leads from the nodes `given`, which become the inputs, to the nodes `outputs`. No other input is needed.
    pub(super) fn part(&self, given: &[u32], outputs: &[u32]) -> Self {
        let needed = self.between(given, outputs);
        let n_input = given.len();
        let (nodes, calls) = (Vec::with_capacity(self.nodes.len()), Vec::new());
        let mut part = Self { nodes, calls, n_input, outputs: Vec::new(), arithmetic: self.arithmetic };
        let mut place = vec![0; self.nodes.len()];
        for (node, k) in given.iter().zip(0..) {
            place[*node as usize] = k;
            part.nodes.push(Node::Input(k));
        }
        for i in (0..self.nodes.len()).filter(|i| needed[*i]) {
            let at = part.nodes.len() as u32;
            match self.nodes[i] {
                Node::Call(number) => {
                    let Call { callee, operands } = &self.calls[number as usize];
                    let operands = operands.iter().map(|o| place[*o as usize]).collect();
                    part.nodes.push(Node::Call(part.calls.len() as u32));
                    for k in 0..callee.n_output() {
                        place[i + 1 + k] = at + 1 + k as u32;
                        part.nodes.push(Node::Result(at, k as u32));
                    }
                    part.calls.push(Call { callee: callee.clone(), operands });
                }
                Node::Result(..) => continue, // it came with its call
                node => part.nodes.push(node.renamed(&place)),
            }
            place[i] = at;
        }
        part.outputs = outputs.iter().map(|o| place[*o as usize]).collect();
        part
    }
}

#[cfg(test)]
mod tests;
