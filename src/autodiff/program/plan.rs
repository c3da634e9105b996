//! From a recorded graph to values: dead nodes dropped, products fused into sums, comparisons into selections.

use super::value::{CallOf, Callee, Instruction, InstructionKind, Op, Tape, Value, ValueForm};
use crate::trace::{self, Arithmetic, Node, Recording};
use std::collections::HashMap;

/// From a graph to values.
pub(super) struct Planner<'a> {
    recording: &'a Recording,
    needed: Vec<bool>,
    /// Needed nodes that read each node, with one more for each result.
    uses: Vec<u32>,
    /// Computed inside another node's instruction.
    absorbed: Vec<bool>,
}

/// An instruction whose operands are nodes still.
struct Planned {
    what: What,
    node: u32,
}

#[derive(Clone, Copy)]
enum What {
    Op(Op, [u32; 4]),
    /// Number in the recording; the operands are there.
    Call(u32),
}

impl<'a> Planner<'a> {
    /// `recording` without detached numbers, see [`Recording::attached`].
    pub(super) fn new(recording: &'a Recording) -> Self {
        let n = recording.nodes.len();
        Self { recording, needed: vec![false; n], uses: vec![0; n], absorbed: vec![false; n] }
    }

    pub(super) fn run(mut self) -> ValueForm {
        self.mark();
        let plan = self.plan();
        self.number(&plan)
    }

    fn mark(&mut self) {
        let nodes = &self.recording.nodes;
        for &output in &self.recording.outputs {
            self.needed[output as usize] = true;
            self.uses[output as usize] += 1;
        }
        for i in (0..nodes.len()).rev() {
            if self.needed[i] {
                for operand in nodes[i].operands(&self.recording.calls) {
                    self.needed[operand as usize] = true;
                    self.uses[operand as usize] += 1;
                }
            }
        }
    }

    /// The product that `i` may absorb: a multiplication that nothing else reads.
    fn lone_product(&self, i: u32) -> Option<(u32, u32)> {
        match self.recording.nodes[i as usize] {
            Node::Mul(a, b) if self.uses[i as usize] == 1 && self.recording.arithmetic == Arithmetic::Free => {
                Some((a, b))
            }
            _ => None,
        }
    }

    fn absorb(&mut self, nodes: &[u32]) {
        for &node in nodes {
            self.absorbed[node as usize] = true;
        }
    }

    /// Needed operations in order, with fusions decided.
    fn plan(&mut self) -> Vec<Planned> {
        let mut plan = Vec::new();
        for i in 0..self.recording.nodes.len() {
            if self.needed[i]
                && let Some(planned) = self.plan_node(i as u32)
            {
                plan.push(planned);
            }
        }
        plan.retain(|p| !self.absorbed[p.node as usize]);
        plan
    }

    fn plan_node(&mut self, node: u32) -> Option<Planned> {
        let instruction = |op, list: &[u32]| {
            let mut operands = [list[0]; 4];
            operands[..list.len()].copy_from_slice(list);
            Some(Planned { what: What::Op(op, operands), node })
        };
        match self.recording.nodes[node as usize] {
            // results come with their call; detached numbers are gone by now, see `Recording::attached`
            Node::Input(_) | Node::Constant(_) | Node::Result(..) | Node::Detach(_) => None,
            Node::Call(number) => Some(Planned { what: What::Call(number), node }),
            Node::Add(a, b) => match (self.lone_product(a), self.lone_product(b)) {
                (Some((r, s)), Some((p, q))) if a != b => {
                    self.absorb(&[a, b]);
                    instruction(Op::TwoProducts, &[p, q, r, s])
                }
                (_, Some((p, q))) => {
                    self.absorb(&[b]);
                    instruction(Op::MulAdd, &[p, q, a])
                }
                (Some((p, q)), None) => {
                    self.absorb(&[a]);
                    instruction(Op::MulAdd, &[p, q, b])
                }
                (None, None) => instruction(Op::Add, &[a, b]),
            },
            Node::Sub(a, b) => match (self.lone_product(a), self.lone_product(b)) {
                (Some((r, s)), Some((p, q))) if a != b => {
                    self.absorb(&[a, b]);
                    instruction(Op::ProductDifference, &[p, q, r, s])
                }
                (_, Some((p, q))) => {
                    self.absorb(&[b]);
                    instruction(Op::NegMulAdd, &[p, q, a])
                }
                (Some((p, q)), None) => {
                    self.absorb(&[a]);
                    instruction(Op::MulSub, &[p, q, b])
                }
                (None, None) => instruction(Op::Sub, &[a, b]),
            },
            Node::MulAdd(a, b, c) => self.plan_fused([a, b, c], node),
            Node::Mul(a, b) => instruction(Op::Mul, &[a, b]),
            Node::Div(a, b) => instruction(Op::Div, &[a, b]),
            Node::Neg(a) => instruction(Op::Neg, &[a]),
            Node::Recip(a) => instruction(Op::Recip, &[a]),
            Node::Sqrt(a) => instruction(Op::Sqrt, &[a]),
            Node::Sin(a) | Node::Cos(a) => instruction(Op::SinCos, &[a]),
            Node::Exp(a) => instruction(Op::Exp, &[a]),
            Node::Ln(a) => instruction(Op::Ln, &[a]),
            Node::Tanh(a) => instruction(Op::Tanh, &[a]),
            Node::Atan2(a, b) => instruction(Op::Atan2, &[a, b]),
            Node::Less(a, b) => instruction(Op::Less, &[a, b]),
            Node::And(a, b) => instruction(Op::And, &[a, b]),
            Node::Or(a, b) => instruction(Op::Or, &[a, b]),
            Node::Not(a) => instruction(Op::Not, &[a]),
            Node::Select(m, a, b) => match self.recording.nodes[m as usize] {
                Node::Less(x, y) => {
                    self.uses[m as usize] -= 1;
                    if self.uses[m as usize] == 0 {
                        self.absorbed[m as usize] = true;
                    }
                    instruction(Op::SelectLess, &[x, y, a, b])
                }
                _ => instruction(Op::Select, &[a, b, m]),
            },
        }
    }

    /// a·b + c in one rounding, with signs and a product c in the same instruction where nothing else reads them.
    fn plan_fused(&mut self, [mut a, mut b, mut c]: [u32; 3], node: u32) -> Option<Planned> {
        let mut is_negative = false;
        for factor in [&mut a, &mut b] {
            if let Some(x) = self.lone(*factor, |node| if let Node::Neg(x) = node { Some(x) } else { None }) {
                is_negative = !is_negative;
                *factor = x;
            }
        }
        let product = |node| if let Node::Mul(p, q) = node { Some((p, q)) } else { None };
        let (op, operands) = if let Some((p, q)) = self.lone(c, product) {
            (if is_negative { Op::ProductDifference } else { Op::TwoProducts }, [a, b, p, q])
        } else if is_negative {
            (Op::NegMulAdd, [a, b, c, a])
        } else if let Some(x) = self.lone(c, |node| if let Node::Neg(x) = node { Some(x) } else { None }) {
            c = x;
            (Op::MulSub, [a, b, c, a])
        } else {
            (Op::MulAdd, [a, b, c, a])
        };
        Some(Planned { what: What::Op(op, operands), node })
    }

    /// What `of` finds in a node that nothing else reads, which is then computed inside its reader.
    fn lone<T>(&mut self, i: u32, of: impl FnOnce(Node) -> Option<T>) -> Option<T> {
        let found = of(self.recording.nodes[i as usize]).filter(|_| self.uses[i as usize] == 1);
        if found.is_some() {
            self.absorb(&[i]);
        }
        found
    }

    /// Names what is left.
    fn number(&self, plan: &[Planned]) -> ValueForm {
        let nodes = &self.recording.nodes;
        let mut form = ValueForm {
            n_input: self.recording.n_input,
            constants: Vec::new(),
            instructions: Vec::with_capacity(plan.len()),
            calls: Vec::new(),
            results: Vec::new(),
            n_value: self.recording.n_input,
            tape: Tape::None,
        };
        let mut place = vec![Value(0); nodes.len()];
        for (i, node) in nodes.iter().enumerate().filter(|(i, _)| self.needed[*i]) {
            match node {
                Node::Input(k) => place[i] = Value(*k),
                Node::Constant(bits) => {
                    place[i] = form.next(1);
                    form.constants.push(*bits);
                }
                _ => {}
            }
        }
        let mut angles: HashMap<Value, Value> = HashMap::new();
        for Planned { what, node } in plan {
            match *what {
                What::Op(op, operands) => {
                    let operands = operands.map(|operand| place[operand as usize]);
                    let made = if op == Op::SinCos { angles.get(&operands[0]).copied() } else { None };
                    let first = made.unwrap_or_else(|| {
                        let first = form.next(op.n_result() as u32);
                        form.instructions.push(Instruction { action: InstructionKind::Op(op, operands), first });
                        first
                    });
                    if op == Op::SinCos {
                        angles.insert(operands[0], first);
                    }
                    let second = matches!(nodes[*node as usize], Node::Cos(_));
                    place[*node as usize] = Value(first.0 + u32::from(second));
                }
                What::Call(number) => {
                    let call = &self.recording.calls[number as usize];
                    let operands = call.operands.iter().map(|operand| place[*operand as usize]).collect();
                    let callee = match &call.callee {
                        trace::Callee::Custom(operation) => Callee::Custom(operation.clone()),
                        trace::Callee::Function(function) => Callee::Function(function.form().clone()),
                    };
                    let n_result = callee.n_output() as u32;
                    let first = form.next(n_result);
                    (0..n_result).for_each(|k| place[(node + 1 + k) as usize] = Value(first.0 + k));
                    form.instructions.push(Instruction { action: InstructionKind::Call(form.calls.len()), first });
                    form.calls.push(CallOf { callee, operands });
                }
            }
        }
        form.results = self.recording.outputs.iter().map(|output| place[*output as usize]).collect();
        form
    }
}
