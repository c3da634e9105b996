//! From values to what the interpreter runs: an order, and slots by liveness so that the working set stays in cache.

use super::runs::{Neutral, grouped};
use super::value::{Callee, InstructionKind, Op, Value, ValueForm};
use super::{Body, Call, Called, Interpreter, Placed};
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

/// Behind all times of use, but of results.
const RELEASED: usize = usize::MAX - 1;

/// Gives each value of a function a slot from its definition to its last use.
struct Slots<'a> {
    form: &'a ValueForm,
    functions: &'a [Arc<ValueForm>],
    last_use: Vec<usize>,
    is_read: Vec<bool>,
    slots: Vec<u32>,
    free: Vec<u32>,
    n_slot: u32,
}

/// A function over slots of its own, before its instructions are grouped.
struct Spread {
    instructions: Vec<Placed>,
    calls: Vec<Call>,
    inputs: Vec<(u32, u32)>,
    outputs: Vec<u32>,
}

/// `scheduled`: see [`Program::compile_single`](super::Program::compile_single).
pub(super) fn interpreter(form: &ValueForm, scheduled: bool) -> Interpreter {
    let functions = form.functions();
    let mut constants: HashMap<u64, u32> = HashMap::new();
    let mut n_slot = 0;
    let mut spread = |form: &ValueForm| {
        let order = if scheduled { schedule(form) } else { (0..form.instructions.len() as u32).collect() };
        let slots = Slots::new(form, &functions, &order, n_slot);
        let (spread, own) = slots.run(&order, &mut constants);
        n_slot = own;
        spread
    };
    let body = spread(form);
    let called: Vec<Spread> = functions.iter().map(|function| spread(function)).collect();
    let neutral = Neutral::behind(n_slot);
    let functions = called.into_iter().map(|spread| spread.grouped(neutral)).collect();
    let mut constants: Vec<(u32, f64)> =
        constants.into_iter().map(|(bits, slot)| (slot, f64::from_bits(bits))).collect();
    constants.sort_by_key(|(slot, _)| *slot);
    Interpreter { n_slot: n_slot as usize, body: body.grouped(neutral), functions, neutral, constants }
}

impl Spread {
    fn grouped(self, neutral: Neutral) -> Body {
        let Self { instructions, calls, inputs, outputs } = self;
        let ends = calls.iter().map(|call: &Call| call.after).chain([instructions.len()]);
        let runs = ends.scan(0, |done, end| Some(grouped(&instructions[std::mem::replace(done, end)..end], neutral)));
        Body { runs: runs.collect(), calls, inputs, outputs }
    }
}

/// The same instructions in an order where those of a kind stand together, as soon as they can be made: as many sums as there
/// are, then as many selections, then what is rare. Whoever was ready first comes first, so that neighbours do not wait
/// for each other.
fn schedule(form: &ValueForm) -> Vec<u32> {
    const NOBODY: u32 = u32::MAX;
    let n = form.instructions.len();
    let mut maker = vec![NOBODY; form.n_value];
    for (k, instruction) in form.instructions.iter().enumerate() {
        let first = instruction.first.index();
        maker[first..first + form.n_result_of(instruction)].fill(k as u32);
    }
    let kind = |k: u32| match form.instructions[k as usize].action {
        InstructionKind::Op(op, _) if op.is_sum() => 0,
        InstructionKind::Op(Op::SelectLess, _) => 1,
        _ => 2,
    };
    let (mut waits, mut readers) = (vec![0u32; n], vec![Vec::new(); n]);
    for (k, instruction) in form.instructions.iter().enumerate() {
        for operand in form.operands(instruction) {
            let made = maker[operand.index()];
            if made != NOBODY {
                readers[made as usize].push(k as u32);
                waits[k] += 1;
            }
        }
    }
    let mut ready: [VecDeque<u32>; 3] = Default::default();
    (0..n as u32).filter(|k| waits[*k as usize] == 0).for_each(|k| ready[kind(k)].push_back(k));
    let mut order = Vec::with_capacity(n);
    while let Some(now) = (0..ready.len()).find(|kind| !ready[*kind].is_empty()) {
        while let Some(k) = ready[now].pop_front() {
            order.push(k);
            for &reader in &readers[k as usize] {
                waits[reader as usize] -= 1;
                if waits[reader as usize] == 0 {
                    ready[kind(reader)].push_back(reader);
                }
            }
        }
    }
    order
}

impl<'a> Slots<'a> {
    /// With slots from `n_slot` on.
    fn new(form: &'a ValueForm, functions: &'a [Arc<ValueForm>], order: &[u32], n_slot: u32) -> Self {
        let mut is_read = vec![false; form.n_value];
        let read = form.instructions.iter().flat_map(|instruction| form.operands(instruction));
        read.chain(&form.results).for_each(|value| is_read[value.index()] = true);
        let slots = vec![0; form.n_value];
        Self { form, functions, last_use: form.last_uses(order), is_read, slots, free: Vec::new(), n_slot }
    }

    /// The function over slots, and how many there are now. Those of `constants` are written once for all evaluations.
    fn run(mut self, order: &[u32], constants: &mut HashMap<u64, u32>) -> (Spread, u32) {
        let form = self.form;
        let inputs = (0..form.n_input as u32).filter(|k| self.is_read[*k as usize]).collect::<Vec<_>>();
        let inputs = inputs.into_iter().map(|k| (self.take(Value(k)), k)).collect();
        for (bits, k) in form.constants.iter().zip(form.n_input..) {
            if self.is_read[k] {
                self.last_use[k] = usize::MAX; // never overwritten
                self.slots[k] = *constants.entry(*bits).or_insert_with(|| self.take(Value(k as u32)));
            }
        }
        let (mut instructions, mut calls) = (Vec::with_capacity(order.len()), Vec::new());
        for (time, number) in order.iter().enumerate() {
            let instruction = &form.instructions[*number as usize];
            match instruction.action {
                InstructionKind::Op(op, operands) => {
                    instructions.push(self.place(op, operands, instruction.first, time))
                }
                InstructionKind::Call(number) => {
                    let call = self.place_call(number, instruction.first, time, instructions.len());
                    calls.push(call);
                }
            }
        }
        let outputs = form.results.iter().map(|value| self.slots[value.index()]).collect();
        (Spread { instructions, calls, inputs, outputs }, self.n_slot)
    }

    fn place(&mut self, op: Op, operands: [Value; 4], first: Value, time: usize) -> Placed {
        let [a, b, c, mut d] = operands.map(|value| self.slots[value.index()]);
        let reads = &operands[..op.n_operand()];
        let target;
        if op == Op::SinCos {
            // two results are written, so the angle's slot may not be one of theirs
            target = self.take(first);
            d = self.take(Value(first.0 + 1));
            self.release(reads, time);
            self.forget_unread(first, 2);
        } else {
            self.release(reads, time);
            target = self.take(first);
        }
        Placed { op, target, a, b, c, d }
    }

    /// Slots of a call's operands, and of those of its results that somebody needs.
    fn place_call(&mut self, number: usize, first: Value, time: usize, after: usize) -> Call {
        let call = &self.form.calls[number];
        let inputs = call.operands.iter().map(|value| self.slots[value.index()]).collect();
        self.release(&call.operands, time);
        let mut outputs = Vec::new();
        for k in 0..call.callee.n_output() as u32 {
            let result = Value(first.0 + k);
            if self.is_read[result.index()] {
                outputs.push((self.take(result), k));
            }
        }
        let called = match &call.callee {
            Callee::Custom(operation) => Called::Custom(operation.clone()),
            Callee::Function(form) => {
                let own = self.functions.iter().position(|function| Arc::ptr_eq(function, form));
                Called::Function(own.unwrap_or(self.functions.len()))
            }
        };
        Call { after, called, inputs, outputs }
    }

    /// Gives back the slots of operands read here for the last time.
    fn release(&mut self, reads: &[Value], time: usize) {
        for value in reads {
            if self.last_use[value.index()] == time {
                // once, however often the instruction reads it
                self.last_use[value.index()] = RELEASED;
                self.free.push(self.slots[value.index()]);
            }
        }
    }

    /// Gives back the slots of results that nobody reads.
    fn forget_unread(&mut self, first: Value, n: usize) {
        for k in first.index()..first.index() + n {
            if !self.is_read[k] {
                self.free.push(self.slots[k]);
            }
        }
    }

    fn take(&mut self, value: Value) -> u32 {
        let slot = self.free.pop().unwrap_or_else(|| {
            self.n_slot += 1;
            self.n_slot - 1
        });
        self.slots[value.index()] = slot;
        slot
    }
}
