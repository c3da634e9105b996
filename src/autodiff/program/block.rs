//! A program over a block of environments: each instruction for all registers of the block, one after the other.

use super::runs::{Run, Sum};
use super::{BLOCK, BlockWorkspace, Body, Call, Called, Interpreter, Op, Placed, Program, apply};
use crate::custom::{Operation, Points};
use crate::lanes::{Kernel, Lanes};
use std::cell::Cell;

/// One evaluation of the first `n` environments, for the dispatcher.
pub(super) struct Evaluate<'a> {
    pub(super) program: &'a Program,
    pub(super) n: usize,
    pub(super) workspace: &'a mut BlockWorkspace,
    pub(super) inputs: &'a [[f32; BLOCK]],
    pub(super) outputs: &'a mut [[f32; BLOCK]],
}

impl Kernel for Evaluate<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { program, n, workspace, inputs, outputs } = self;
        assert_eq!(inputs.len(), program.n_input(), "inputs of the program");
        assert_eq!(outputs.len(), program.n_output(), "outputs of the program");
        let interpreter = program.interpreter();
        let slots = &mut workspace.slots[..interpreter.neutral.n_slot()];
        for &(slot, k) in &interpreter.body.inputs {
            slots[slot as usize] = inputs[k as usize];
        }
        run_body::<L>(interpreter, &interpreter.body, n, slots, &mut workspace.scratch);
        for k in 0..outputs.len() {
            outputs[k] = slots[interpreter.body.outputs[k] as usize];
        }
    }
}

/// Instructions up to each call, the call, and so on.
fn run_body<L: Lanes>(
    interpreter: &Interpreter,
    body: &Body,
    n: usize,
    slots: &mut [[f32; BLOCK]],
    scratch: &mut [[f32; BLOCK]],
) {
    for k in 0..body.runs.len() {
        let (runs, cells) = (&body.runs[k], Cell::from_mut(&mut *slots).as_slice_of_cells());
        match n.div_ceil(L::WIDTH) {
            2 => Straight::<2> { runs, slots: cells, n }.outlined::<L>(),
            4 => Straight::<4> { runs, slots: cells, n }.outlined::<L>(),
            8 => Straight::<8> { runs, slots: cells, n }.outlined::<L>(),
            _ => Straight::<0> { runs, slots: cells, n }.outlined::<L>(),
        }
        match body.calls.get(k).map(|call| (call, &call.called)) {
            None => {}
            Some((call, Called::Custom(operation))) => call.run_block(operation, n, slots, scratch),
            Some((call, Called::Function(number))) => {
                let function = &interpreter.functions[*number];
                interpreter.inputs_of(function, call).for_each(|(from, to)| slots[to as usize] = slots[from as usize]);
                run_body::<L>(interpreter, function, n, slots, scratch);
                interpreter.outputs_of(function, call).for_each(|(from, to)| slots[to as usize] = slots[from as usize]);
            }
        }
    }
}

impl Call {
    /// A custom function; arguments are read before results are written.
    #[inline(never)]
    fn run_block(
        &self,
        operation: &Operation,
        n_lane: usize,
        slots: &mut [[f32; BLOCK]],
        scratch: &mut [[f32; BLOCK]],
    ) {
        let (n, m) = (self.inputs.len(), operation.n_output());
        let (arguments, results) = scratch[..n + m].split_at_mut(n);
        for (argument, slot) in arguments.iter_mut().zip(&self.inputs) {
            *argument = slots[*slot as usize];
        }
        let results_flat = results.as_flattened_mut();
        operation.function().value_block(&mut Points::new(BLOCK, n_lane, arguments.as_flattened(), results_flat));
        for &(slot, k) in &self.outputs {
            slots[slot as usize] = results[k as usize];
        }
    }
}

/// One slot of a block. A cell, since the slot of a result may be that of an operand: an instruction reads a register of
/// each operand, then writes the same register of its result, and nothing has to wait in memory.
type Slot = Cell<[f32; BLOCK]>;

/// Instructions without calls over the first `n` lanes: over `N` registers, or over as many as it takes where that is 0.
struct Straight<'a, const N: usize> {
    runs: &'a [Run],
    slots: &'a [Slot],
    n: usize,
}

impl<const N: usize> Kernel for Straight<'_, N> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let slots = self.slots;
        let n = if N > 0 { N } else { self.n.div_ceil(L::WIDTH) };
        for run in self.runs {
            match run {
                Run::Sums(list) => {
                    for sum in list {
                        add_up::<L>(slots, n, sum);
                    }
                }
                Run::Selects(list) => {
                    for i in list {
                        each::<L>(slots, n, i, Op::SelectLess);
                    }
                }
                // a twentieth of a program and most of the code: calls, so that the loops stay small
                Run::Other(i) => Rare { slots, n, i }.outlined::<L>(),
            }
        }
    }
}

/// ±a·b + c·d over `n` registers, ±a·b without a rounding of its own.
#[inline(always)]
fn add_up<L: Lanes>(slots: &[Slot], n: usize, sum: &Sum) {
    let a = &L::cells(&slots[sum.slot(0)])[..n];
    let b = &L::cells(&slots[sum.slot(1)])[..n];
    let c = &L::cells(&slots[sum.slot(2)])[..n];
    let target = &L::cells(&slots[sum.target()])[..n];
    let sign = L::constant(sum.factor());
    if sum.is_short() {
        for r in 0..n {
            target[r].set((a[r].get() * sign).mul_add(b[r].get(), c[r].get()));
        }
    } else {
        let d = &L::cells(&slots[sum.slot(3)])[..n];
        for r in 0..n {
            target[r].set((a[r].get() * sign).mul_add(b[r].get(), c[r].get() * d[r].get()));
        }
    }
}

/// One of the operations that programs have few of.
struct Rare<'a> {
    slots: &'a [Slot],
    n: usize,
    i: &'a Placed,
}

impl Kernel for Rare<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { slots, n, i } = self;
        match i.op {
            Op::SinCos => {
                let [a, sine, cosine] = [i.a, i.target, i.d].map(|slot| &L::cells(&slots[slot as usize])[..n]);
                for r in 0..n {
                    let (s, c) = a[r].get().sin_cos();
                    sine[r].set(s);
                    cosine[r].set(c);
                }
            }
            Op::Div => each::<L>(slots, n, i, Op::Div),
            Op::Recip => each::<L>(slots, n, i, Op::Recip),
            Op::Sqrt => each::<L>(slots, n, i, Op::Sqrt),
            Op::Exp => each::<L>(slots, n, i, Op::Exp),
            Op::Ln => each::<L>(slots, n, i, Op::Ln),
            Op::Tanh => each::<L>(slots, n, i, Op::Tanh),
            Op::Atan2 => each::<L>(slots, n, i, Op::Atan2),
            Op::Less => each::<L>(slots, n, i, Op::Less),
            Op::And => each::<L>(slots, n, i, Op::And),
            Op::Or => each::<L>(slots, n, i, Op::Or),
            Op::Not => each::<L>(slots, n, i, Op::Not),
            Op::Select => each::<L>(slots, n, i, Op::Select),
            _ => {}
        }
    }
}

/// One instruction over `n` registers. `op` is known at compile time in each arm of the caller's match.
#[inline(always)]
fn each<L: Lanes>(slots: &[Slot], n: usize, i: &Placed, op: Op) {
    let a = L::cells(&slots[i.a as usize]);
    let b = if op.n_operand() > 1 { L::cells(&slots[i.b as usize]) } else { a };
    let c = if op.n_operand() > 2 { L::cells(&slots[i.c as usize]) } else { a };
    let d = if op.n_operand() > 3 { L::cells(&slots[i.d as usize]) } else { a };
    let target = L::cells(&slots[i.target as usize]);
    let [a, b, c, d, target] = [&a[..n], &b[..n], &c[..n], &d[..n], &target[..n]];
    for r in 0..n {
        target[r].set(apply(op, a[r].get(), b[r].get(), c[r].get(), d[r].get()));
    }
}
