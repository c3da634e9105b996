//! A scalar that records: run a kernel once over [`Trace`], get its straight-line graph.
//!
//! Because kernels do not branch on values, one recording is valid for every input. Equal nodes are shared
//! (hash-consing) and constants folded as they are recorded; `x·0` folds to 0 and `x + 0` to `x`, so a recorded
//! function returns 0 where the original would have multiplied an infinity by a constant zero.

mod adjoint;
pub(crate) mod chain;

use super::custom::Operation;
use super::scalar::{Mask, Scalar};
use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::HashMap;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};
use std::sync::Arc;

/// One operation on earlier nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Node {
    Input(u32),
    /// The bits of an `f64`.
    Constant(u64),
    Add(u32, u32),
    Sub(u32, u32),
    Mul(u32, u32),
    Div(u32, u32),
    Neg(u32),
    Recip(u32),
    Sqrt(u32),
    Sin(u32),
    Cos(u32),
    Exp(u32),
    Ln(u32),
    Tanh(u32),
    /// Of y, x.
    Atan2(u32, u32),
    Less(u32, u32),
    And(u32, u32),
    Or(u32, u32),
    Not(u32),
    /// Mask, yes, no.
    Select(u32, u32, u32),
    /// The same number, that passes nothing back.
    Detach(u32),
    /// A custom function, by number in the list of calls. Its results are the nodes right behind it.
    Call(u32),
    /// Of the call, which one.
    Result(u32, u32),
}

/// A custom function of earlier nodes.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) struct Call {
    pub(crate) operation: Operation,
    pub(crate) operands: Arc<[u32]>,
}

impl Node {
    /// Where this one names the nodes it reads, in order.
    fn operands_mut(&mut self) -> [Option<&mut u32>; 3] {
        use Node::*;
        match self {
            Input(_) | Constant(_) | Call(_) => [None, None, None],
            Neg(a)
            | Recip(a)
            | Sqrt(a)
            | Sin(a)
            | Cos(a)
            | Exp(a)
            | Ln(a)
            | Tanh(a)
            | Not(a)
            | Detach(a)
            | Result(a, _) => [Some(a), None, None],
            Add(a, b) | Sub(a, b) | Mul(a, b) | Div(a, b) | Atan2(a, b) | Less(a, b) | And(a, b) | Or(a, b) => {
                [Some(a), Some(b), None]
            }
            Select(m, a, b) => [Some(m), Some(a), Some(b)],
        }
    }

    /// The nodes this one reads, in order; `calls` is the list that it may be in.
    pub(crate) fn operands(mut self, calls: &[Call]) -> impl Iterator<Item = u32> {
        let called: &[u32] = if let Node::Call(number) = self { &calls[number as usize].operands } else { &[] };
        let own = self.operands_mut().map(|place| place.map(|operand| *operand));
        own.into_iter().flatten().chain(called.iter().copied())
    }

    /// The same operation on the nodes that `place` gives for its operands.
    fn renamed(mut self, place: &[u32]) -> Self {
        self.operands_mut().into_iter().flatten().for_each(|operand| *operand = place[*operand as usize]);
        self
    }
}

/// Nodes and calls so far, and at which node each is.
#[derive(Default)]
struct Graph {
    nodes: Vec<Node>,
    calls: Vec<Call>,
    index: HashMap<Node, u32>,
    called: HashMap<Call, u32>,
}

thread_local! {
    static GRAPH: RefCell<Graph> = RefCell::new(Graph::default());
}

impl Graph {
    fn constant(&self, i: u32) -> Option<f64> {
        match self.nodes[i as usize] {
            Node::Constant(bits) => Some(f64::from_bits(bits)),
            _ => None,
        }
    }

    /// The node that `node` is equal to: an operand, a constant, or itself with its operands in order.
    fn simplify(&self, node: Node) -> Result<Node, u32> {
        use Node::*;
        let c = |i| self.constant(i);
        let value = |x: f64| Ok(Constant(x.to_bits()));
        match node {
            Add(a, b) => match (c(a), c(b)) {
                (Some(x), Some(y)) => value(x + y),
                (Some(0.0), _) => Err(b),
                (_, Some(0.0)) => Err(a),
                _ => Ok(Add(a.min(b), a.max(b))),
            },
            Sub(a, b) => match (c(a), c(b)) {
                (Some(x), Some(y)) => value(x - y),
                (_, Some(0.0)) => Err(a),
                (Some(0.0), _) => self.simplify(Neg(b)),
                _ => Ok(node),
            },
            Mul(a, b) => match (c(a), c(b)) {
                (Some(x), Some(y)) => value(x * y),
                (Some(0.0), _) | (_, Some(0.0)) => value(0.0),
                (Some(1.0), _) => Err(b),
                (_, Some(1.0)) => Err(a),
                (Some(-1.0), _) => self.simplify(Neg(b)),
                (_, Some(-1.0)) => self.simplify(Neg(a)),
                _ => Ok(Mul(a.min(b), a.max(b))),
            },
            Div(a, b) => match (c(a), c(b)) {
                (Some(x), Some(y)) => value(x / y),
                (_, Some(1.0)) => Err(a),
                _ => Ok(node),
            },
            Neg(a) => match (c(a), self.nodes[a as usize]) {
                (Some(x), _) => value(-x),
                (_, Neg(b)) => Err(b),
                _ => Ok(node),
            },
            Recip(a) => c(a).map_or(Ok(node), |x| value(1.0 / x)),
            Sqrt(a) => c(a).map_or(Ok(node), |x| value(x.sqrt())),
            Sin(a) => c(a).map_or(Ok(node), |x| value(x.sin())),
            Cos(a) => c(a).map_or(Ok(node), |x| value(x.cos())),
            Exp(a) => c(a).map_or(Ok(node), |x| value(x.exp())),
            Ln(a) => c(a).map_or(Ok(node), |x| value(x.ln())),
            Tanh(a) => c(a).map_or(Ok(node), |x| value(x.tanh())),
            Atan2(a, b) => match (c(a), c(b)) {
                (Some(y), Some(x)) => value(y.atan2(x)),
                _ => Ok(node),
            },
            Less(a, b) => match (c(a), c(b)) {
                (Some(x), Some(y)) => value(f64::from(u8::from(x < y))),
                _ => Ok(node),
            },
            Select(_, a, b) if a == b => Err(a),
            Select(m, a, b) => match c(m) {
                Some(x) => Err(if x > 0.5 { a } else { b }),
                None => Ok(node),
            },
            Detach(a) => match self.nodes[a as usize] {
                Constant(_) | Detach(_) => Err(a),
                _ => Ok(node),
            },
            _ => Ok(node),
        }
    }

    /// What −x is the negative of.
    fn negated(&self, i: u32) -> Option<u32> {
        match self.nodes[i as usize] {
            Node::Neg(a) => Some(a),
            _ => None,
        }
    }

    /// Signs moved out of products and into sums, which changes no bit: a + (−b) = a − b, (−a) b = −(a b). Reverse sweeps
    /// are full of them.
    fn without_signs(&mut self, node: Node) -> Node {
        use Node::*;
        match node {
            Add(a, b) => match (self.negated(a), self.negated(b)) {
                (_, Some(c)) => self.without_signs(Sub(a, c)),
                (Some(c), None) => Sub(b, c),
                _ => node,
            },
            Sub(a, b) => self.negated(b).map_or(node, |c| Add(a, c)),
            Mul(a, b) => match (self.negated(a), self.negated(b)) {
                (Some(c), Some(d)) => Mul(c, d),
                (Some(c), None) => Neg(self.push(Mul(c, b))),
                (None, Some(d)) => Neg(self.push(Mul(a, d))),
                _ => node,
            },
            _ => node,
        }
    }

    fn push(&mut self, node: Node) -> u32 {
        let node = self.without_signs(node);
        match self.simplify(node) {
            Err(existing) => existing,
            Ok(node) => *self.index.entry(node).or_insert_with(|| {
                self.nodes.push(node);
                (self.nodes.len() - 1) as u32
            }),
        }
    }
}

impl Graph {
    /// With these nodes and calls already recorded.
    fn starting_from(nodes: &[Node], calls: &[Call]) -> Self {
        let numbered = || nodes.iter().zip(0..);
        let called = numbered().filter_map(|(node, i)| match node {
            Node::Call(number) => Some((calls[*number as usize].clone(), i)),
            _ => None,
        });
        Self {
            index: numbered().map(|(node, i)| (*node, i)).collect(),
            called: called.collect(),
            nodes: nodes.to_vec(),
            calls: calls.to_vec(),
        }
    }

    /// The node of a call: the one that is already there, or a new one with its results behind it.
    fn call(&mut self, call: Call) -> u32 {
        if let Some(node) = self.called.get(&call) {
            return *node;
        }
        let node = self.nodes.len() as u32;
        self.nodes.push(Node::Call(self.calls.len() as u32));
        self.nodes.extend((0..call.operation.n_output() as u32).map(|k| Node::Result(node, k)));
        self.calls.push(call.clone());
        self.called.insert(call, node);
        node
    }
}

/// The results of a call: constants if all its operands are.
fn push_call(operation: &Operation, inputs: &[Trace]) -> Vec<Trace> {
    let constants = GRAPH.with_borrow(|g| inputs.iter().map(|x| g.constant(x.0)).collect::<Option<Vec<f64>>>());
    if let Some(x) = constants {
        let mut y = vec![0.0; operation.n_output()];
        operation.function().value(&x, &mut y);
        return y.into_iter().map(Trace::constant).collect();
    }
    let call = Call { operation: operation.clone(), operands: inputs.iter().map(|x| x.0).collect() };
    let node = GRAPH.with_borrow_mut(|g| g.call(call));
    (1..=operation.n_output() as u32).map(|k| Trace(node + k)).collect()
}

#[inline(never)]
fn push(node: Node) -> Trace {
    Trace(GRAPH.with_borrow_mut(|g| g.push(node)))
}

// Recording is slow whatever the compiler does, so its operations stay calls: kernels over `Trace` are then a third as long,
// and so is the time it takes to compile them.

/// A number whose every operation is recorded. Only meaningful inside [`Recording::of`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Trace(u32);

impl Trace {
    /// Its value, where it depends on no input.
    pub(crate) fn known(self) -> Option<f64> {
        GRAPH.with_borrow(|g| g.constant(self.0))
    }
}

/// A recorded truth value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TraceMask(u32);

impl Add for Trace {
    type Output = Self;
    #[inline(never)]
    fn add(self, other: Self) -> Self {
        push(Node::Add(self.0, other.0))
    }
}
impl Sub for Trace {
    type Output = Self;
    #[inline(never)]
    fn sub(self, other: Self) -> Self {
        push(Node::Sub(self.0, other.0))
    }
}
impl Mul for Trace {
    type Output = Self;
    #[inline(never)]
    fn mul(self, other: Self) -> Self {
        push(Node::Mul(self.0, other.0))
    }
}
impl Div for Trace {
    type Output = Self;
    #[inline(never)]
    fn div(self, other: Self) -> Self {
        push(Node::Div(self.0, other.0))
    }
}
impl Neg for Trace {
    type Output = Self;
    #[inline(never)]
    fn neg(self) -> Self {
        push(Node::Neg(self.0))
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

impl Mask for TraceMask {
    #[inline(never)]
    fn and(self, other: Self) -> Self {
        Self(push(Node::And(self.0, other.0)).0)
    }
    #[inline(never)]
    fn or(self, other: Self) -> Self {
        Self(push(Node::Or(self.0, other.0)).0)
    }
    #[inline(never)]
    fn not(self) -> Self {
        Self(push(Node::Not(self.0)).0)
    }
}

impl Scalar for Trace {
    type Mask = TraceMask;
    #[inline(never)]
    fn constant(x: f64) -> Self {
        push(Node::Constant(x.to_bits()))
    }
    #[inline(never)]
    fn sqrt(self) -> Self {
        push(Node::Sqrt(self.0))
    }
    #[inline(never)]
    fn sin_cos(self) -> (Self, Self) {
        (push(Node::Sin(self.0)), push(Node::Cos(self.0)))
    }
    #[inline(never)]
    fn exp(self) -> Self {
        push(Node::Exp(self.0))
    }
    #[inline(never)]
    fn ln(self) -> Self {
        push(Node::Ln(self.0))
    }
    #[inline(never)]
    fn tanh(self) -> Self {
        push(Node::Tanh(self.0))
    }
    #[inline(never)]
    fn atan2(self, x: Self) -> Self {
        push(Node::Atan2(self.0, x.0))
    }
    fn recip(self) -> Self {
        push(Node::Recip(self.0))
    }
    #[inline(never)]
    fn lt(self, other: Self) -> TraceMask {
        TraceMask(push(Node::Less(self.0, other.0)).0)
    }
    #[inline(never)]
    fn select(mask: TraceMask, yes: Self, no: Self) -> Self {
        push(Node::Select(mask.0, yes.0, no.0))
    }
    #[inline(never)]
    fn detach(self) -> Self {
        push(Node::Detach(self.0))
    }
    fn call(operation: &Operation, inputs: &[Self], outputs: &mut [Self]) {
        outputs.copy_from_slice(&push_call(operation, inputs));
    }
}

/// A recorded function: nodes in the order of evaluation, and which of them are its results.
#[derive(Debug, Clone)]
pub struct Recording {
    pub(crate) nodes: Vec<Node>,
    pub(crate) calls: Vec<Call>,
    pub(crate) n_input: usize,
    pub(crate) outputs: Vec<u32>,
}

/// Records `f` on a graph of its own, starting from `graph`; the caller's is put back afterwards, even on panic.
fn record(graph: Graph, n_input: usize, f: impl FnOnce() -> Vec<Trace>) -> Recording {
    apart(graph, || {
        let outputs = f().iter().map(|o| o.0).collect();
        let Graph { nodes, calls, .. } = GRAPH.take();
        Recording { nodes, calls, n_input, outputs }
    })
}

/// Runs `f` on a graph of its own.
fn apart<R>(graph: Graph, f: impl FnOnce() -> R) -> R {
    struct Restore(Option<Graph>);
    impl Drop for Restore {
        fn drop(&mut self) {
            if let Some(graph) = self.0.take() {
                GRAPH.set(graph);
            }
        }
    }
    let _restore = Restore(Some(GRAPH.replace(graph)));
    f()
}

/// Runs `f` on constants, of which nothing is kept.
pub(crate) fn on_constants<R>(f: impl FnOnce() -> R) -> R {
    apart(Graph::default(), f)
}

impl Recording {
    /// Records `f` of `n_input` inputs.
    pub fn of(n_input: usize, f: impl FnOnce(&[Trace]) -> Vec<Trace>) -> Self {
        record(Graph::default(), n_input, || {
            let inputs: Vec<Trace> = (0..n_input as u32).map(|k| push(Node::Input(k))).collect();
            f(&inputs)
        })
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
    /// no value: nodes that differed by a detachment alone become one.
    pub(crate) fn attached(&self) -> Cow<'_, Self> {
        if !self.nodes.iter().any(|node| matches!(node, Node::Detach(_))) {
            return Cow::Borrowed(self);
        }
        Cow::Owned(record(Graph::default(), self.n_input, || {
            let mut place: Vec<u32> = Vec::with_capacity(self.nodes.len());
            let mut results = Vec::new();
            for node in &self.nodes {
                place.push(match node.renamed(&place) {
                    Node::Detach(number) => number,
                    Node::Call(number) => {
                        let Call { operation, operands } = &self.calls[number as usize];
                        let inputs: Vec<Trace> = operands.iter().map(|i| Trace(place[*i as usize])).collect();
                        results = push_call(operation, &inputs);
                        0 // read by its results alone
                    }
                    Node::Result(_, k) => results[k as usize].0,
                    node => push(node).0,
                });
            }
            self.outputs.iter().map(|o| Trace(place[*o as usize])).collect()
        }))
    }

    fn graph(&self) -> Graph {
        Graph::starting_from(&self.nodes, &self.calls)
    }
}
