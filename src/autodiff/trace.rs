//! A scalar that records: run a kernel once over [`Trace`], get its straight-line graph.
//!
//! Because kernels do not branch on values, one recording is valid for every input. Equal nodes are shared
//! (hash-consing) and constants folded as they are recorded; `x·0` folds to 0 and `x + 0` to `x`, so a recorded
//! function returns 0 where the original would have multiplied an infinity by a constant zero.

mod adjoint;
pub(crate) mod chain;
mod function;
mod graph;
mod saved;
mod walk;

pub use self::graph::is_recording;
pub(crate) use self::graph::{Arithmetic, Call, Callee, Node};
pub use self::saved::SavedLimits;
pub use self::walk::{Values, Walk};

use self::graph::{Graph, Place, apart, local, push_on, with_graph};
use super::custom::Operation;
use super::scalar::{Mask, Scalar};
use std::borrow::Cow;
use std::ops::{Add, AddAssign, BitAnd, BitOr, Div, Mul, MulAssign, Neg, Not, Sub, SubAssign};

/// The results of a custom function: constants if all its operands are.
fn push_call(operation: &Operation, inputs: &[Trace]) -> Vec<Trace> {
    let folds = with_graph(|graph| graph.arithmetic != Arithmetic::Written);
    if let Some(x) = inputs.iter().map(|x| x.known()).collect::<Option<Vec<f64>>>().filter(|_| folds) {
        let mut y = vec![0.0; operation.n_output()];
        operation.function().value(&x, &mut y);
        return y.into_iter().map(Trace::constant).collect();
    }
    results_of(Callee::Custom(operation.clone()), inputs)
}

/// The results of a call on the graph on top, of the one that is already there or a new one.
fn results_of(callee: Callee, inputs: &[Trace]) -> Vec<Trace> {
    results(callee, inputs, Graph::call).1
}

/// Likewise of a new one, with its node.
fn new_results_of(callee: Callee, inputs: &[Trace]) -> (u32, Vec<Trace>) {
    results(callee, inputs, |graph, call| graph.new_call(&call))
}

fn results(callee: Callee, inputs: &[Trace], push: impl FnOnce(&mut Graph, Call) -> u32) -> (u32, Vec<Trace>) {
    let n = callee.n_output() as u32;
    let call = Call { callee, operands: inputs.iter().map(|x| x.node()).collect() };
    with_graph(|graph| {
        let node = push(graph, call);
        (node, (1..=n).map(|k| Trace((graph.id, node + k))).collect())
    })
}

/// A node of the graph on top.
fn own(node: u32) -> Trace {
    with_graph(|graph| Trace((graph.id, node)))
}

#[inline(never)]
fn push(node: Node) -> Trace {
    Trace(push_on([], |[]| node))
}

#[inline(never)]
fn push_one(a: Trace, make: fn(u32) -> Node) -> Trace {
    Trace(push_on([a.0], |[a]| make(a)))
}

#[inline(never)]
fn push_two(a: Trace, b: Trace, make: fn(u32, u32) -> Node) -> Trace {
    Trace(push_on([a.0, b.0], |[a, b]| make(a, b)))
}

// Recording is slow whatever the compiler does, so its operations stay calls: kernels over `Trace` are then a third as long,
// and so is the time it takes to compile them.

/// A number whose every operation is recorded. Only meaningful inside [`Recording::of`].
#[derive(Debug, Clone, Copy)]
pub struct Trace(Place);

impl Trace {
    /// Whether it is the same node. Numbers of recordings are not compared by `==`, which would be known now and not when they are.
    #[doc(hidden)]
    pub fn is(self, other: Self) -> bool {
        self.0 == other.0
    }

    /// Whether it is less than another number: true or false for each environment that runs the recording, so that nothing branches
    /// on it; [`Scalar::select`] picks.
    pub fn lt(self, other: impl Into<Self>) -> TraceMask {
        Scalar::lt(self, other.into())
    }

    /// Whether it is more than another number, likewise.
    pub fn gt(self, other: impl Into<Self>) -> TraceMask {
        Scalar::lt(other.into(), self)
    }

    /// Its value, where it depends on no input.
    #[doc(hidden)]
    pub fn known(self) -> Option<f64> {
        let node = self.node();
        with_graph(|graph| graph.constant(node))
    }

    /// Its node on the graph on top.
    fn node(self) -> u32 {
        local(self.0)
    }

    /// Its recording and node, for who keeps numbers in arrays of their own.
    #[doc(hidden)]
    pub fn to_bits(self) -> u64 {
        u64::from(self.0.0) << 32 | u64::from(self.0.1)
    }

    /// Its node of the recording on top, by its place in it.
    #[doc(hidden)]
    pub fn place(self) -> usize {
        self.node() as usize
    }

    /// The number of these bits, which may be of no recording: see [`is_live`](Self::is_live).
    #[doc(hidden)]
    pub fn from_bits(bits: u64) -> Self {
        Self(((bits >> 32) as u32, bits as u32))
    }

    /// Whether what is being recorded on this thread may read it. Operations on one that is not panic.
    #[doc(hidden)]
    pub fn is_live(self) -> bool {
        graph::is_reachable(self.0)
    }

    /// A new input of the recording on top, beyond those that it began with.
    #[doc(hidden)]
    pub fn input(number: usize) -> Self {
        push(Node::Input(number as u32))
    }
}

/// A recorded truth value.
#[derive(Debug, Clone, Copy)]
pub struct TraceMask(Place);

impl TraceMask {
    /// The same node as a number: what recordings return for truths.
    #[doc(hidden)]
    pub fn as_number(self) -> Trace {
        Trace(self.0)
    }

    /// The truth that a number is: the inverse of [`as_number`](Self::as_number).
    #[doc(hidden)]
    pub fn of_number(number: Trace) -> Self {
        Self(number.0)
    }
}

impl Add for Trace {
    type Output = Self;
    #[inline(never)]
    fn add(self, other: Self) -> Self {
        push_two(self, other, Node::Add)
    }
}
impl Sub for Trace {
    type Output = Self;
    #[inline(never)]
    fn sub(self, other: Self) -> Self {
        push_two(self, other, Node::Sub)
    }
}
impl Mul for Trace {
    type Output = Self;
    #[inline(never)]
    fn mul(self, other: Self) -> Self {
        push_two(self, other, Node::Mul)
    }
}
impl Div for Trace {
    type Output = Self;
    #[inline(never)]
    fn div(self, other: Self) -> Self {
        push_two(self, other, Node::Div)
    }
}
impl Neg for Trace {
    type Output = Self;
    #[inline(never)]
    fn neg(self) -> Self {
        push_one(self, Node::Neg)
    }
}
impl AddAssign for Trace {
    #[inline(never)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}
impl SubAssign for Trace {
    #[inline(never)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}
impl MulAssign for Trace {
    #[inline(never)]
    fn mul_assign(&mut self, other: Self) {
        *self = *self * other;
    }
}

impl From<f64> for Trace {
    fn from(x: f64) -> Self {
        Self::constant(x)
    }
}

/// With plain numbers, which are constants of the recording.
macro_rules! with_constants {
    ($($operation:ident, $apply:ident;)*) => {$(
        impl $operation<f64> for Trace {
            type Output = Self;
            fn $apply(self, other: f64) -> Self {
                $operation::$apply(self, Self::constant(other))
            }
        }
        impl $operation<Trace> for f64 {
            type Output = Trace;
            fn $apply(self, other: Trace) -> Trace {
                $operation::$apply(Trace::constant(self), other)
            }
        }
    )*};
}

with_constants! {
    Add, add;
    Sub, sub;
    Mul, mul;
    Div, div;
}

impl Mask for TraceMask {
    #[inline(never)]
    fn and(self, other: Self) -> Self {
        Self(push_two(Trace(self.0), Trace(other.0), Node::And).0)
    }
    #[inline(never)]
    fn or(self, other: Self) -> Self {
        Self(push_two(Trace(self.0), Trace(other.0), Node::Or).0)
    }
    #[inline(never)]
    fn not(self) -> Self {
        Self(push_one(Trace(self.0), Node::Not).0)
    }
}

impl BitAnd for TraceMask {
    type Output = Self;
    fn bitand(self, other: Self) -> Self {
        self.and(other)
    }
}

impl BitOr for TraceMask {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        self.or(other)
    }
}

impl Not for TraceMask {
    type Output = Self;
    fn not(self) -> Self {
        Mask::not(self)
    }
}

impl Scalar for Trace {
    type Mask = TraceMask;
    super::compiled_once::compiled_once!(Trace);
    #[inline(never)]
    fn constant(x: f64) -> Self {
        push(Node::Constant(x.to_bits()))
    }
    #[inline(never)]
    fn sqrt(self) -> Self {
        push_one(self, Node::Sqrt)
    }
    #[inline(never)]
    fn sin_cos(self) -> (Self, Self) {
        (push_one(self, Node::Sin), push_one(self, Node::Cos))
    }
    #[inline(never)]
    fn exp(self) -> Self {
        push_one(self, Node::Exp)
    }
    #[inline(never)]
    fn ln(self) -> Self {
        push_one(self, Node::Ln)
    }
    #[inline(never)]
    fn tanh(self) -> Self {
        push_one(self, Node::Tanh)
    }
    #[inline(never)]
    fn atan2(self, x: Self) -> Self {
        push_two(self, x, Node::Atan2)
    }
    fn recip(self) -> Self {
        push_one(self, Node::Recip)
    }
    #[inline(never)]
    fn lt(self, other: Self) -> TraceMask {
        TraceMask(push_two(self, other, Node::Less).0)
    }
    #[inline(never)]
    fn select(mask: TraceMask, yes: Self, no: Self) -> Self {
        Self(push_on([mask.0, yes.0, no.0], |[mask, yes, no]| Node::Select(mask, yes, no)))
    }
    #[inline(never)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        Self(push_on([self.0, a.0, b.0], |[x, a, b]| Node::MulAdd(x, a, b)))
    }
    #[inline(never)]
    fn detach(self) -> Self {
        push_one(self, Node::Detach)
    }
    fn call(operation: &Operation, inputs: &[Self], outputs: &mut [Self]) {
        outputs.copy_from_slice(&push_call(operation, inputs));
    }
    #[inline(never)]
    fn begin_function() {
        graph::begin_function();
    }
    #[inline(never)]
    fn end_function(outputs: &mut [Self]) {
        function::end(outputs);
    }
}

/// A recorded function: nodes in the order of evaluation, and which of them are its results.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Recording {
    pub(crate) nodes: Vec<Node>,
    pub(crate) calls: Vec<Call>,
    pub(crate) n_input: usize,
    pub(crate) outputs: Vec<u32>,
    pub(crate) arithmetic: Arithmetic,
}

/// Records `f` on a graph of its own, starting from `graph`.
fn record(graph: Graph, n_input: usize, f: impl FnOnce() -> Vec<Trace>) -> Recording {
    let outputs = || f().into_iter().map(Trace::node).collect();
    let (Graph { nodes, calls, arithmetic, .. }, outputs) = apart(graph, outputs);
    Recording { nodes, calls, n_input, outputs, arithmetic }
}

/// Runs `f` on constants, of which nothing is kept.
pub fn on_constants<R>(f: impl FnOnce() -> R) -> R {
    apart(Graph::empty(), f).1
}

/// The first `n` inputs.
fn inputs(n: usize) -> Vec<Trace> {
    (0..n as u32).map(|k| push(Node::Input(k))).collect()
}

impl Recording {
    /// Records `f` of `n_input` inputs.
    ///
    /// What `f` computes inside [`Scalar::function`] becomes a function of the recording. Recordings nest.
    ///
    /// # Panics
    /// If `f` returns or reads a number of another recording.
    pub fn of(n_input: usize, f: impl FnOnce(&[Trace]) -> Vec<Trace>) -> Self {
        record(Graph::empty(), n_input, || f(&inputs(n_input)))
    }

    /// As [`Recording::of`], for blocks alone: with the bits that `f` has as a compiled kernel of lanes.
    #[doc(hidden)]
    pub fn of_lanes(n_input: usize, f: impl FnOnce(&[Trace]) -> Vec<Trace>) -> Self {
        record(Graph::of_arithmetic(Arithmetic::Lanes), n_input, || f(&inputs(n_input)))
    }

    /// As [`Recording::of`], word for word: nothing is folded or put in order, equal operations are shared. To be computed again by
    /// [`evaluate`](Self::evaluate) or a [`Walk`] over recorded numbers, which is then what `f` would have recorded there; it is not to be
    /// compiled itself.
    #[doc(hidden)]
    pub fn as_written(n_input: usize, f: impl FnOnce(&[Trace]) -> Vec<Trace>) -> Self {
        record(Graph::of_arithmetic(Arithmetic::Written), n_input, || f(&inputs(n_input)))
    }

    /// The place of the next node: what is recorded from now on stands there or behind.
    #[doc(hidden)]
    pub fn place() -> usize {
        graph::length()
    }

    /// The node of a result.
    #[doc(hidden)]
    pub fn output(&self, k: usize) -> usize {
        self.outputs[k] as usize
    }

    /// The first node that is this input.
    #[doc(hidden)]
    pub fn node_of_input(&self, k: usize) -> Option<usize> {
        self.nodes.iter().position(|node| *node == Node::Input(k as u32))
    }

    /// Which input a node is.
    #[doc(hidden)]
    pub fn input_of_node(&self, node: usize) -> Option<usize> {
        match self.nodes.get(node) {
            Some(Node::Input(k)) => Some(*k as usize),
            _ => None,
        }
    }

    /// Whether the node at a place is a result of the call before it.
    #[doc(hidden)]
    pub fn is_result(&self, at: usize) -> bool {
        matches!(self.nodes.get(at), Some(Node::Result(..)))
    }

    /// Nodes.
    #[doc(hidden)]
    pub fn n_node(&self) -> usize {
        self.nodes.len()
    }

    /// Number of inputs.
    pub fn n_input(&self) -> usize {
        self.n_input
    }

    /// Number of results.
    pub fn n_output(&self) -> usize {
        self.outputs.len()
    }

    /// The same function with every detached number taken for the number it is, which changes every later derivative and
    /// no value: nodes that differed by a detachment alone become one. Functions that it calls are as they were.
    pub(crate) fn attached(&self) -> Cow<'_, Self> {
        if !self.nodes.iter().any(|node| matches!(node, Node::Detach(_))) {
            return Cow::Borrowed(self);
        }
        let attached = |node| if let Node::Detach(number) = node { Err(number) } else { Ok(node) };
        Cow::Owned(record(self.empty_graph(), self.n_input, || {
            self.replayed(&inputs(self.n_input), attached, |_, call, inputs| match &call.callee {
                Callee::Custom(operation) => push_call(operation, inputs),
                callee => results_of(callee.clone(), inputs),
            })
        }))
    }

    /// The same function, computed where it is called.
    pub(crate) fn inlined(&self) -> Cow<'_, Self> {
        if !self.has_functions() {
            return Cow::Borrowed(self);
        }
        Cow::Owned(record(self.empty_graph(), self.n_input, || self.on(&inputs(self.n_input))))
    }

    /// Operations, with those of functions as often as they are called.
    #[doc(hidden)]
    pub fn n_operation(&self) -> usize {
        let of_call = |call: &Call| match &call.callee {
            Callee::Custom(_) => 1,
            Callee::Function(function) => function.recording().n_operation(),
        };
        self.nodes.len() + self.calls.iter().map(of_call).sum::<usize>()
    }

    /// Whether it calls custom functions, or functions of its own do.
    #[doc(hidden)]
    pub fn has_operations(&self) -> bool {
        self.calls.iter().any(|call| match &call.callee {
            Callee::Custom(_) => true,
            Callee::Function(function) => function.recording().has_operations(),
        })
    }

    fn has_functions(&self) -> bool {
        self.calls.iter().any(|call| matches!(call.callee, Callee::Function(_)))
    }

    /// Its results on the graph on top, without calls of functions.
    fn on(&self, inputs: &[Trace]) -> Vec<Trace> {
        self.replayed(inputs, Ok, |_, call, inputs| match &call.callee {
            Callee::Custom(operation) => push_call(operation, inputs),
            Callee::Function(function) => function.recording().on(inputs),
        })
    }

    /// Its results on the graph on top, where `rename` gives each node or the one that it is equal to, and `call` the
    /// results of the call at a node.
    fn replayed(
        &self,
        inputs: &[Trace],
        rename: impl Fn(Node) -> Result<Node, u32>,
        mut call: impl FnMut(usize, &Call, &[Trace]) -> Vec<Trace>,
    ) -> Vec<Trace> {
        let mut place: Vec<u32> = Vec::with_capacity(self.nodes.len());
        let mut results: Vec<Trace> = Vec::new();
        for (at, node) in self.nodes.iter().enumerate() {
            place.push(match rename(node.renamed(&place)) {
                Err(equal) => equal,
                Ok(Node::Input(k)) => inputs[k as usize].node(),
                Ok(Node::Call(number)) => {
                    let own_call = &self.calls[number as usize];
                    let inputs: Vec<Trace> = own_call.operands.iter().map(|i| own(place[*i as usize])).collect();
                    results = call(at, own_call, &inputs);
                    0 // read by its results alone
                }
                Ok(Node::Result(_, k)) => results[k as usize].node(),
                Ok(node) => with_graph(|graph| graph.push(node)),
            });
        }
        self.outputs.iter().map(|o| own(place[*o as usize])).collect()
    }

    fn graph(&self) -> Graph {
        Graph::starting_from(&self.nodes, &self.calls, self.arithmetic)
    }

    /// Of the same arithmetic, without nodes.
    fn empty_graph(&self) -> Graph {
        Graph::of_arithmetic(self.arithmetic)
    }
}
