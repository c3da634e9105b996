//! What is recorded: a graph of operations, in which equal nodes are one and constants are folded.
//!
//! A function is recorded on a graph of its own, above that of its caller. What it reads of the caller's numbers becomes its inputs.

use super::function::Function;
use crate::custom::Operation;
use crate::fast_hash::QuickMap;
use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

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
    /// a·b + c in one rounding where lanes have it: as a kernel of lanes wrote it.
    MulAdd(u32, u32, u32),
    /// Mask, yes, no.
    Select(u32, u32, u32),
    /// The same number, that passes nothing back.
    Detach(u32),
    /// A function, by number in the list of calls. Its results are the nodes right behind it.
    Call(u32),
    /// Of the call, which one.
    Result(u32, u32),
}

/// What a call calls.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) enum Callee {
    Custom(Operation),
    Function(Function),
}

impl Callee {
    pub(crate) fn n_output(&self) -> usize {
        match self {
            Self::Custom(operation) => operation.n_output(),
            Self::Function(function) => function.recording().n_output(),
        }
    }
}

/// A function of earlier nodes.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) struct Call {
    pub(crate) callee: Callee,
    pub(crate) operands: Arc<[u32]>,
}

impl Node {
    /// Where this one names the nodes it reads, in order.
    pub(super) fn operands_mut(&mut self) -> [Option<&mut u32>; 3] {
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
            Select(a, b, c) | MulAdd(a, b, c) => [Some(a), Some(b), Some(c)],
        }
    }

    /// The nodes this one reads, in order; `calls` is the list that it may be in.
    pub(crate) fn operands(mut self, calls: &[Call]) -> impl Iterator<Item = u32> {
        let called: &[u32] = if let Node::Call(number) = self { &calls[number as usize].operands } else { &[] };
        let own = self.operands_mut().map(|place| place.map(|operand| *operand));
        own.into_iter().flatten().chain(called.iter().copied())
    }

    /// The same operation on the nodes that `place` gives for its operands.
    pub(super) fn renamed(mut self, place: &[u32]) -> Self {
        self.operands_mut().into_iter().flatten().for_each(|operand| *operand = place[*operand as usize]);
        self
    }
}

/// How constants are folded, and which products are fused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub(crate) enum Arithmetic {
    /// Constants in `f64`; every lone product, into the sum that reads it.
    #[default]
    Free,
    /// As compiled kernels of lanes have them, to the bit: constants in `f32`; products that are written so.
    Lanes,
    /// None of it: every operation stands as it was written, so that who computes it again does what was done.
    Written,
}

/// Nodes and calls so far, and at which node each is.
pub(super) struct Graph {
    /// No other graph of the process has it.
    pub(super) id: u32,
    pub(super) nodes: Vec<Node>,
    pub(super) calls: Vec<Call>,
    pub(super) arithmetic: Arithmetic,
    index: QuickMap<Node, u32>,
    called: HashMap<Call, u32>,
    /// Of a function: nodes of the graph below that it reads, by the numbers of its inputs, and its own nodes for them.
    captured: Option<(Vec<u32>, QuickMap<u32, u32>)>,
}

/// The graph that is being recorded on, and those that wait until it is done.
struct Graphs {
    top: Graph,
    below: Vec<Graph>,
}

thread_local! {
    static GRAPHS: RefCell<Graphs> = RefCell::new(Graphs { top: Graph::empty(), below: Vec::new() });
}

/// A number of a graph: which, and its node.
pub(super) type Place = (u32, u32);

/// Does something with the graph on top.
pub(super) fn with_graph<R>(f: impl FnOnce(&mut Graph) -> R) -> R {
    GRAPHS.with_borrow_mut(|graphs| f(&mut graphs.top))
}

/// The node of the graph on top that is this number.
pub(super) fn local(place: Place) -> u32 {
    GRAPHS.with_borrow_mut(|Graphs { top, below }| top.local(below, place))
}

/// Whether anything is being recorded on this thread.
pub fn is_recording() -> bool {
    GRAPHS.with_borrow(|graphs| !graphs.below.is_empty())
}

/// Nodes so far of the graph on top.
pub(super) fn length() -> usize {
    with_graph(|graph| graph.nodes.len())
}

/// Whether [`local`] finds this number from the graph on top.
pub(super) fn is_reachable((id, node): Place) -> bool {
    GRAPHS.with_borrow(|Graphs { top, below }| {
        let mut graph = top;
        for next in below.iter().rev() {
            if graph.id == id || graph.captured.is_none() {
                break;
            }
            graph = next;
        }
        graph.id == id && (node as usize) < graph.nodes.len()
    })
}

/// Appends the node that `make` makes of its operands to the graph on top.
pub(super) fn push_on<const N: usize>(operands: [Place; N], make: impl FnOnce([u32; N]) -> Node) -> Place {
    GRAPHS.with_borrow_mut(|Graphs { top, below }| {
        let node = make(operands.map(|place| top.local(below, place)));
        (top.id, top.push(node))
    })
}

/// Runs `f` with `graph` on top, and gives it back with what `f` returned. Those below are as they were, also after a panic.
pub(super) fn apart<R>(graph: Graph, f: impl FnOnce() -> R) -> (Graph, R) {
    /// How many were below.
    struct Restore(usize);
    impl Drop for Restore {
        fn drop(&mut self) {
            GRAPHS.with_borrow_mut(|Graphs { top, below }| {
                below.truncate(self.0 + 1);
                below.pop().into_iter().for_each(|graph| *top = graph);
            });
        }
    }
    let restore = Restore(GRAPHS.with_borrow_mut(|Graphs { top, below }| {
        below.push(std::mem::replace(top, graph));
        below.len() - 1
    }));
    let result = f();
    let graph = GRAPHS.with_borrow_mut(|Graphs { top, below }| {
        assert_eq!(below.len(), restore.0 + 1, "functions that have not ended");
        std::mem::replace(top, Graph::empty())
    });
    drop(restore);
    (graph, result)
}

/// Puts the graph of a function on top.
pub(super) fn begin_function() {
    GRAPHS.with_borrow_mut(|Graphs { top, below }| {
        let arithmetic = top.arithmetic;
        let function = Graph { captured: Some(Default::default()), arithmetic, ..Graph::empty() };
        below.push(std::mem::replace(top, function));
    });
}

/// Takes the graph of a function from the top; with it the nodes of the one below that it reads, by the numbers of its inputs.
pub(super) fn end_function() -> (Graph, Vec<u32>) {
    GRAPHS.with_borrow_mut(|Graphs { top, below }| {
        let (captured, _) = top.captured.take().expect("no function has begun");
        let next = below.pop().expect("the graph of a caller");
        (std::mem::replace(top, next), captured)
    })
}

impl Graph {
    /// Without nodes; it reads no other.
    pub(super) fn empty() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        Self {
            id: NEXT.fetch_add(1, Ordering::Relaxed),
            nodes: Vec::new(),
            calls: Vec::new(),
            arithmetic: Arithmetic::Free,
            index: QuickMap::default(),
            called: HashMap::new(),
            captured: None,
        }
    }

    pub(super) fn of_arithmetic(arithmetic: Arithmetic) -> Self {
        Self { arithmetic, ..Self::empty() }
    }

    /// The own node of a number of this graph or of one below, of which `below` ends with the next.
    fn local(&mut self, below: &mut [Self], place: Place) -> u32 {
        if place.0 == self.id {
            return place.1;
        }
        match below.split_last_mut() {
            Some((next, below)) if self.captured.is_some() => {
                let outside = next.local(below, place);
                self.capture(outside, next.constant(outside))
            }
            _ => panic!("a number of another recording, or of a function that has ended"),
        }
    }

    /// The own node for a node of the graph below.
    fn capture(&mut self, outside: u32, constant: Option<f64>) -> u32 {
        if let Some(x) = constant {
            return self.push(Node::Constant(x.to_bits()));
        }
        let Some((order, places)) = &mut self.captured else { return outside };
        if let Some(own) = places.get(&outside) {
            return *own;
        }
        let number = order.len() as u32;
        order.push(outside);
        let own = self.push(Node::Input(number));
        self.captured.iter_mut().for_each(|(_, places)| {
            places.insert(outside, own);
        });
        own
    }

    pub(super) fn constant(&self, i: u32) -> Option<f64> {
        match self.nodes[i as usize] {
            Node::Constant(bits) => Some(f64::from_bits(bits)),
            _ => None,
        }
    }

    /// The node that `node` is equal to: an operand, a constant, or itself with its operands in order.
    fn simplify(&self, node: Node) -> Result<Node, u32> {
        use Node::*;
        let c = |i| self.constant(i);
        let is_free = self.arithmetic == Arithmetic::Free;
        // of numbers of `f32`, sums, products, quotients and roots in `f64` are rounded to `f32` as if made there
        let value = |x: f64| Ok(Constant(if is_free { x } else { f64::from(x as f32) }.to_bits()));
        match node {
            Constant(bits) => value(f64::from_bits(bits)),
            // of lanes, polynomials
            Sin(_) | Cos(_) | Exp(_) | Ln(_) | Tanh(_) | Atan2(..) if !is_free => Ok(node),
            MulAdd(a, b, d) => match (c(a), c(b), c(d)) {
                (Some(x), Some(y), Some(z)) => value(f64::from((x as f32).mul_add(y as f32, z as f32))),
                (Some(0.0), ..) | (_, Some(0.0), _) => Err(d),
                (Some(1.0), ..) => self.simplify(Add(b, d)),
                (_, Some(1.0), _) => self.simplify(Add(a, d)),
                (Some(-1.0), ..) => self.simplify(Sub(d, b)),
                (_, Some(-1.0), _) => self.simplify(Sub(d, a)),
                (.., Some(0.0)) => self.simplify(Mul(a, b)),
                _ => Ok(MulAdd(a.min(b), a.max(b), d)),
            },
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
            And(a, b) | Or(a, b) if a == b => Err(a),
            And(a, b) => match (c(a), c(b)) {
                (Some(x), _) => Err(if x > 0.5 { b } else { a }),
                (_, Some(y)) => Err(if y > 0.5 { a } else { b }),
                _ => Ok(And(a.min(b), a.max(b))),
            },
            Or(a, b) => match (c(a), c(b)) {
                (Some(x), _) => Err(if x > 0.5 { a } else { b }),
                (_, Some(y)) => Err(if y > 0.5 { b } else { a }),
                _ => Ok(Or(a.min(b), a.max(b))),
            },
            Not(a) => match (c(a), self.nodes[a as usize]) {
                (Some(x), _) => value(f64::from(u8::from(x <= 0.5))),
                (_, Not(b)) => Err(b),
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

    pub(super) fn push(&mut self, node: Node) -> u32 {
        if self.arithmetic == Arithmetic::Written {
            return self.shared(node);
        }
        if let (Node::MulAdd(a, b, c), Arithmetic::Free) = (node, self.arithmetic) {
            let product = self.push(Node::Mul(a, b));
            return self.push(Node::Add(product, c));
        }
        let node = self.without_signs(node);
        match self.simplify(node) {
            Err(existing) => existing,
            Ok(node) => self.shared(node),
        }
    }

    /// The node that is there already, or a new one.
    fn shared(&mut self, node: Node) -> u32 {
        *self.index.entry(node).or_insert_with(|| {
            self.nodes.push(node);
            (self.nodes.len() - 1) as u32
        })
    }

    /// With these nodes and calls already recorded.
    pub(super) fn starting_from(nodes: &[Node], calls: &[Call], arithmetic: Arithmetic) -> Self {
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
            arithmetic,
            ..Self::empty()
        }
    }

    /// The node of a call: the one that is already there, or a new one with its results behind it.
    pub(super) fn call(&mut self, call: Call) -> u32 {
        if let Some(node) = self.called.get(&call) {
            return *node;
        }
        let node = self.new_call(&call);
        self.called.insert(call, node);
        node
    }

    /// The node of a new call.
    pub(super) fn new_call(&mut self, call: &Call) -> u32 {
        let node = self.nodes.len() as u32;
        self.nodes.push(Node::Call(self.calls.len() as u32));
        self.nodes.extend((0..call.callee.n_output() as u32).map(|k| Node::Result(node, k)));
        self.calls.push(call.clone());
        node
    }
}
