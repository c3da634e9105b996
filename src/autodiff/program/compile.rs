//! From a recorded graph to instructions: dead nodes dropped, products fused into sums, slots given by liveness.

use super::runs::{Neutral, grouped};
use super::{Call, Instruction, MAX_SLOTS, Op, Program, too_many};
use crate::autodiff::trace::{Node, Recording};
use crate::error::Result;
use std::collections::VecDeque;

/// From a graph to instructions.
pub(super) struct Compiler<'a> {
    recording: &'a Recording,
    needed: Vec<bool>,
    /// Needed nodes that read each node, with one more for each result.
    uses: Vec<u32>,
    /// Computed inside another node's instruction.
    absorbed: Vec<bool>,
    slots: Vec<Option<u16>>,
    free: Vec<u16>,
    n_slot: usize,
}

/// An instruction or a call before slots are known: operands are nodes.
struct Planned {
    what: What,
    node: u32,
    operands: [u32; 4],
    n_operand: usize,
}

#[derive(Clone, Copy)]
enum What {
    Op(Op),
    /// Number in the recording; the operands are there.
    Call(u32),
}

impl Planned {
    /// The nodes read.
    fn reads<'p>(&'p self, recording: &'p Recording) -> &'p [u32] {
        match self.what {
            What::Op(_) => &self.operands[..self.n_operand],
            What::Call(number) => &recording.calls[number as usize].operands,
        }
    }
}

impl<'a> Compiler<'a> {
    pub(super) fn new(recording: &'a Recording) -> Self {
        let n = recording.nodes.len();
        Self {
            recording,
            needed: vec![false; n],
            uses: vec![0; n],
            absorbed: vec![false; n],
            slots: vec![None; n],
            free: Vec::new(),
            n_slot: 0,
        }
    }

    /// `scheduled`: see [`Program::compile_single`].
    pub(super) fn run(mut self, scheduled: bool) -> Result<Program> {
        self.mark();
        let plan = self.plan();
        let plan = if scheduled { self.schedule(plan) } else { plan };
        self.assign(&plan)
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
            Node::Mul(a, b) if self.uses[i as usize] == 1 => Some((a, b)),
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
            Some(Planned { what: What::Op(op), node, operands, n_operand: list.len() })
        };
        match self.recording.nodes[node as usize] {
            // results come with their call; detached numbers are gone by now, see `Recording::attached`
            Node::Input(_) | Node::Constant(_) | Node::Result(..) | Node::Detach(_) => None,
            Node::Call(number) => Some(Planned { what: What::Call(number), node, operands: [0; 4], n_operand: 0 }),
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

    /// The same instructions in an order where those of a kind stand together, as soon as they can be made: as many sums as there
    /// are, then as many selections, then what is rare. Whoever was ready first comes first, so that neighbours do not wait
    /// for each other.
    fn schedule(&self, plan: Vec<Planned>) -> Vec<Planned> {
        const NOBODY: usize = usize::MAX;
        let mut maker = vec![NOBODY; self.recording.nodes.len()];
        for (k, planned) in plan.iter().enumerate() {
            let results = match planned.what {
                What::Op(_) => 0,
                What::Call(number) => self.recording.calls[number as usize].operation.n_output(),
            };
            maker[planned.node as usize..=planned.node as usize + results].fill(k);
        }
        let kind = |planned: &Planned| match planned.what {
            What::Op(op) if op.is_sum() => 0,
            What::Op(Op::SelectLess) => 1,
            _ => 2,
        };
        let (mut waits, mut readers) = (vec![0u32; plan.len()], vec![Vec::new(); plan.len()]);
        for (k, planned) in plan.iter().enumerate() {
            for operand in planned.reads(self.recording) {
                let made = maker[*operand as usize];
                if made != NOBODY {
                    readers[made].push(k);
                    waits[k] += 1;
                }
            }
        }
        let mut ready: [VecDeque<usize>; 3] = Default::default();
        for (k, planned) in plan.iter().enumerate() {
            if waits[k] == 0 {
                ready[kind(planned)].push_back(k);
            }
        }
        let mut order = Vec::with_capacity(plan.len());
        while let Some(now) = (0..ready.len()).find(|kind| !ready[*kind].is_empty()) {
            while let Some(k) = ready[now].pop_front() {
                order.push(k);
                for &reader in &readers[k] {
                    waits[reader] -= 1;
                    if waits[reader] == 0 {
                        ready[kind(&plan[reader])].push_back(reader);
                    }
                }
            }
        }
        let mut plan: Vec<Option<Planned>> = plan.into_iter().map(Some).collect();
        order.into_iter().filter_map(|k| plan[k].take()).collect()
    }

    /// Gives each value a slot from its definition to its last use.
    fn assign(mut self, plan: &[Planned]) -> Result<Program> {
        let n = self.recording.nodes.len();
        let mut last_use = vec![0usize; n];
        for (time, planned) in plan.iter().enumerate() {
            for &operand in planned.reads(self.recording) {
                last_use[operand as usize] = time;
            }
        }
        for &output in &self.recording.outputs {
            last_use[output as usize] = usize::MAX;
        }
        let (constants, inputs) = self.assign_leaves(&mut last_use)?;
        let (mut instructions, mut calls) = (Vec::with_capacity(plan.len()), Vec::new());
        for (time, planned) in plan.iter().enumerate() {
            match planned.what {
                What::Op(op) => instructions.extend(self.assign_one(op, planned, time, &last_use)?),
                What::Call(number) => {
                    let (inputs, outputs) = self.assign_call(number, planned, time, &last_use)?;
                    let operation = self.recording.calls[number as usize].operation.clone();
                    calls.push(Call { after: instructions.len(), operation, inputs, outputs });
                }
            }
        }
        let outputs = self.recording.outputs.iter().map(|&o| self.slot_of(o)).collect();
        let neutral = Neutral::behind(self.n_slot)?;
        let ends = calls.iter().map(|call: &Call| call.after).chain([instructions.len()]);
        let runs = ends.scan(0, |done, end| Some(grouped(&instructions[std::mem::replace(done, end)..end], neutral)));
        let runs = runs.collect();
        let (n_input, n_slot) = (self.recording.n_input, self.n_slot);
        Ok(Program { n_input, n_slot, instructions, runs, neutral, calls, constants, inputs, outputs })
    }

    #[expect(clippy::type_complexity, reason = "two parallel lists, used once")]
    fn assign_leaves(&mut self, last_use: &mut [usize]) -> Result<(Vec<(u16, f64)>, Vec<(u16, u32)>)> {
        let (mut constants, mut inputs) = (Vec::new(), Vec::new());
        for i in 0..self.recording.nodes.len() {
            if !self.needed[i] {
                continue;
            }
            match self.recording.nodes[i] {
                Node::Constant(bits) => {
                    last_use[i] = usize::MAX;
                    let slot = self.take(i as u32)?;
                    constants.push((slot, f64::from_bits(bits)));
                }
                Node::Input(k) => {
                    let slot = self.take(i as u32)?;
                    inputs.push((slot, k));
                }
                _ => {}
            }
        }
        Ok((constants, inputs))
    }

    /// Slots of a call's operands, and of those of its results that somebody needs.
    #[expect(clippy::type_complexity, reason = "two parallel lists, used once")]
    fn assign_call(
        &mut self,
        number: u32,
        planned: &Planned,
        time: usize,
        last_use: &[usize],
    ) -> Result<(Vec<u16>, Vec<(u16, u32)>)> {
        let inputs = planned.reads(self.recording).iter().map(|&o| self.slot_of(o)).collect();
        self.release(planned, time, last_use);
        let mut outputs = Vec::new();
        for k in 0..self.recording.calls[number as usize].operation.n_output() as u32 {
            let result = planned.node + 1 + k;
            if self.needed[result as usize] {
                outputs.push((self.take(result)?, k));
            }
        }
        Ok((inputs, outputs))
    }

    fn assign_one(
        &mut self,
        op: Op,
        planned: &Planned,
        time: usize,
        last_use: &[usize],
    ) -> Result<Option<Instruction>> {
        let mut places = [0u16; 4];
        for k in 0..4 {
            places[k] = self.slot_of(planned.operands[k]);
        }
        let [a, b, c, mut d] = places;
        let target;
        if op == Op::SinCos {
            if self.slots[planned.node as usize].is_some() {
                // made together with its partner; the angle may end here
                self.release(planned, time, last_use);
                return Ok(None);
            }
            // two results are written, so the angle's slot may not be one of theirs
            (target, d) = self.take_sin_cos(planned)?;
            self.release(planned, time, last_use);
        } else {
            self.release(planned, time, last_use);
            target = self.take(planned.node)?;
        }
        Ok(Some(Instruction { op, target, a, b, c, d }))
    }

    /// Slots of sine and cosine of one angle; the one that nobody reads is given back at once.
    fn take_sin_cos(&mut self, planned: &Planned) -> Result<(u16, u16)> {
        let angle = planned.operands[0];
        let find = |wanted: Node| {
            self.recording.nodes.iter().position(|n| *n == wanted).filter(|&i| self.needed[i]).map(|i| i as u32)
        };
        let (sine, cosine) = (find(Node::Sin(angle)), find(Node::Cos(angle)));
        let mut place = |node: Option<u32>| match node {
            Some(i) => self.take(i),
            None => self.fresh(),
        };
        let slots = (place(sine)?, place(cosine)?);
        if sine.is_none() {
            self.free.push(slots.0);
        }
        if cosine.is_none() {
            self.free.push(slots.1);
        }
        Ok(slots)
    }

    /// Gives back the slots of operands read here for the last time.
    fn release(&mut self, planned: &Planned, time: usize, last_use: &[usize]) {
        let reads = planned.reads(self.recording);
        for (k, &operand) in reads.iter().enumerate() {
            let repeated = reads[..k].contains(&operand);
            if last_use[operand as usize] == time && !repeated {
                let slot = self.slot_of(operand);
                self.free.push(slot);
            }
        }
    }

    fn slot_of(&self, node: u32) -> u16 {
        self.slots[node as usize].unwrap_or(0)
    }

    fn take(&mut self, node: u32) -> Result<u16> {
        let slot = self.fresh()?;
        self.slots[node as usize] = Some(slot);
        Ok(slot)
    }

    fn fresh(&mut self) -> Result<u16> {
        if let Some(slot) = self.free.pop() {
            return Ok(slot);
        }
        if self.n_slot == MAX_SLOTS {
            return Err(too_many(self.n_slot + 1));
        }
        self.n_slot += 1;
        Ok((self.n_slot - 1) as u16)
    }
}
