//! What a recording compiles to: instructions over numbered slots, run in `f64` or over blocks of lanes.
//!
//! Compilation drops dead nodes, fuses multiplications into the one addition that uses them, fuses comparisons into
//! selections and sines with cosines, and gives slots by liveness so that the working set stays in cache. The
//! interpreter pays one to two nanoseconds per instruction in `f64` (`program/runs.rs`); over a block of [`BLOCK`] environments that price is
//! shared by all of them. Calls of custom functions stand between runs of instructions, which know nothing of them.

mod compile;
mod runs;

use self::runs::{Neutral, Run};
use super::columns::{Columns, LINE, Lines};
use super::custom::Operation;
use super::lanes::{Kernel, Lanes, dispatch};
use super::scalar::Scalar;
use super::trace::Recording;
use crate::error::{Error, Result};
use std::cell::Cell;
use std::ops::Range;

/// Environments per block of the lane evaluator.
pub const BLOCK: usize = 64;

/// Most slots of a program: they are numbered by `u16`.
pub(super) const MAX_SLOTS: usize = 1 << 16;

/// What a recording with more values than [`MAX_SLOTS`] alive at once is refused with.
pub(super) fn too_many(n_slot: usize) -> Error {
    let remedy = "Record a smaller function: one step instead of a rollout.";
    Error::limit("number of values alive at once in a program", n_slot, MAX_SLOTS, remedy)
}

/// Slots of a small workspace: 32 KiB.
const FEW_SLOTS: usize = 1 << 12;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum Op {
    Add,
    Sub,
    Mul,
    Div,
    Neg,
    Recip,
    Sqrt,
    /// Results in `target` (sine) and `d` (cosine).
    SinCos,
    Exp,
    Ln,
    Tanh,
    Atan2,
    /// a·b + c
    MulAdd,
    /// c − a·b
    NegMulAdd,
    /// a·b − c
    MulSub,
    /// a·b + c·d
    TwoProducts,
    /// c·d − a·b
    ProductDifference,
    Less,
    And,
    Or,
    Not,
    /// a where mask c, else b.
    Select,
    /// c where a < b, else d.
    SelectLess,
}

impl Op {
    /// Whether it is a sum of products, see [`runs`].
    const fn is_sum(self) -> bool {
        use Op::*;
        matches!(self, Add | Sub | Mul | Neg | MulAdd | NegMulAdd | MulSub | TwoProducts | ProductDifference)
    }

    /// How many of the operands a to d it reads.
    #[inline(always)]
    const fn n_operand(self) -> usize {
        match self {
            Op::Neg | Op::Recip | Op::Sqrt | Op::SinCos | Op::Exp | Op::Ln | Op::Tanh | Op::Not => 1,
            Op::Add | Op::Sub | Op::Mul | Op::Div | Op::Atan2 | Op::Less | Op::And | Op::Or => 2,
            Op::MulAdd | Op::NegMulAdd | Op::MulSub | Op::Select => 3,
            Op::TwoProducts | Op::ProductDifference | Op::SelectLess => 4,
        }
    }
}

#[derive(Debug, Clone, Copy)]
struct Instruction {
    op: Op,
    target: u16,
    a: u16,
    b: u16,
    c: u16,
    d: u16,
}

/// A custom function of slots, made when the instructions before it are done.
#[derive(Debug, Clone)]
struct Call {
    /// How many those are.
    after: usize,
    operation: Operation,
    inputs: Vec<u16>,
    /// (slot, result), for the results that matter.
    outputs: Vec<(u16, u32)>,
}

/// A compiled recording.
#[derive(Debug, Clone)]
pub struct Program {
    n_input: usize,
    n_slot: usize,
    instructions: Vec<Instruction>,
    /// The same for `f64`: before the first call, between the first and the second, and so on.
    runs: Vec<Vec<Run>>,
    neutral: Neutral,
    /// In the order they are made.
    calls: Vec<Call>,
    /// (slot, value), never overwritten.
    constants: Vec<(u16, f64)>,
    /// (slot, input), for the inputs that matter.
    inputs: Vec<(u16, u32)>,
    outputs: Vec<u16>,
}

/// Slots of one `f64` evaluation; made once, reused without allocation.
///
/// As many as a masked `u16` can name, so that no access needs a bounds check.
#[derive(Debug, Clone)]
pub struct Workspace {
    slots: Slots,
    scratch: Vec<f64>,
}

#[derive(Debug, Clone)]
enum Slots {
    Few(Box<[f64; FEW_SLOTS]>),
    Many(Box<[f64; MAX_SLOTS]>),
}

impl Workspace {
    /// Numbers held.
    pub(crate) fn len(&self) -> usize {
        self.slots().len() + self.scratch.len()
    }

    /// By number of the slot.
    pub(crate) fn slots(&self) -> &[f64] {
        match &self.slots {
            Slots::Few(slots) => &slots[..],
            Slots::Many(slots) => &slots[..],
        }
    }
}

/// Slots of one block evaluation; made once, reused without allocation.
#[derive(Debug, Clone)]
pub struct BlockWorkspace {
    slots: Columns,
    scratch: Vec<f64>,
}

impl Program {
    /// Compiles a recording.
    ///
    /// # Errors
    /// [`Error::Limit`] when more than 65 535 values are alive at once.
    pub fn compile(recording: &Recording) -> Result<Self> {
        compile::Compiler::new(&recording.attached()).run(false)
    }

    /// As [`Program::compile`] for use in `f64`: instructions that do not wait for each other stand together. Takes more slots,
    /// which over a block of environments leave the cache.
    ///
    /// # Errors
    /// As [`Program::compile`].
    pub(crate) fn compile_single(recording: &Recording) -> Result<Self> {
        compile::Compiler::new(&recording.attached()).run(true)
    }

    /// Number of inputs.
    pub fn n_input(&self) -> usize {
        self.n_input
    }

    /// Number of results.
    pub fn n_output(&self) -> usize {
        self.outputs.len()
    }

    /// Number of instructions, with calls.
    pub fn len(&self) -> usize {
        self.instructions.len() + self.calls.len()
    }

    /// Whether there is nothing to do but copy constants and inputs.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of slots: values alive at once, with constants.
    pub fn n_slot(&self) -> usize {
        self.n_slot
    }

    /// Scratch for [`Program::evaluate`].
    pub fn workspace(&self) -> Workspace {
        if self.neutral.n_slot() > FEW_SLOTS {
            return self.roomy_workspace();
        }
        let mut slots = Box::new([0.0; FEW_SLOTS]);
        self.write_constants(&mut slots[..]);
        Workspace { slots: Slots::Few(slots), scratch: self.scratch() }
    }

    /// As [`Program::workspace`], a tenth faster: half a mebibyte of addresses, where no slot number needs a mask. Memory is taken
    /// for the slots in use.
    pub(crate) fn roomy_workspace(&self) -> Workspace {
        // from the allocator's zeros, which are not written
        let zeros: Box<[f64]> = vec![0.0; MAX_SLOTS].into_boxed_slice();
        let mut slots = zeros.try_into().unwrap_or_else(|_| Box::new([0.0; MAX_SLOTS]));
        self.write_constants(&mut slots[..]);
        Workspace { slots: Slots::Many(slots), scratch: self.scratch() }
    }

    fn write_constants(&self, slots: &mut [f64]) {
        for (slot, value) in self.constants.iter().copied().chain(self.neutral.values()) {
            slots[slot as usize] = value;
        }
    }

    /// Scratch for [`Program::evaluate_block`].
    pub fn block_workspace(&self) -> BlockWorkspace {
        let mut slots = Columns::zeros(self.n_slot);
        for &(slot, value) in &self.constants {
            slots[slot as usize] = [value as f32; BLOCK];
        }
        BlockWorkspace { slots, scratch: self.scratch() }
    }

    /// Arguments and results of one call at a time.
    fn scratch(&self) -> Vec<f64> {
        let sizes = self.calls.iter().map(|call| call.operation.n_input() + call.operation.n_output());
        vec![0.0; sizes.max().unwrap_or(0)]
    }

    /// `outputs = f(inputs)` in `f64`, with the same operations in the same order as the recorded function.
    ///
    /// # Panics
    /// If `inputs` or `outputs` are not of this program's sizes or the workspace has too few slots. One that another
    /// program made holds other constants: it gives wrong numbers.
    pub fn evaluate(&self, workspace: &mut Workspace, inputs: &[f64], outputs: &mut [f64]) {
        assert_eq!(inputs.len(), self.n_input, "inputs of the program");
        assert_eq!(outputs.len(), self.outputs.len(), "outputs of the program");
        let slots = self.evaluate_inside(workspace, inputs);
        for (output, slot) in outputs.iter_mut().zip(&self.outputs) {
            *output = slots[*slot as usize];
        }
    }

    /// As [`Program::evaluate`]; result k stays at [`place(k)`](Self::place) of what is returned.
    pub(crate) fn evaluate_inside<'w>(&self, workspace: &'w mut Workspace, inputs: &[f64]) -> &'w [f64] {
        assert_eq!(inputs.len(), self.n_input, "inputs of the program");
        match &mut workspace.slots {
            Slots::Few(slots) => self.run(slots, &mut workspace.scratch, inputs),
            Slots::Many(slots) => self.run(slots, &mut workspace.scratch, inputs),
        }
        workspace.slots()
    }

    /// The slot of result `k`.
    pub(crate) fn place(&self, k: usize) -> u16 {
        self.outputs[k]
    }

    /// The `f64` interpreter: instructions up to each call, the call, and so on.
    fn run<const N: usize>(&self, slots: &mut [f64; N], scratch: &mut [f64], inputs: &[f64]) {
        assert!(N >= self.neutral.n_slot(), "slots of the program");
        for &(slot, k) in &self.inputs {
            slots[slot as usize & (N - 1)] = inputs[k as usize];
        }
        for (k, between) in self.runs.iter().enumerate() {
            runs::run(between, slots);
            if let Some(call) = self.calls.get(k) {
                call.run(slots, scratch);
            }
        }
    }

    /// Slots for [`Program::evaluate_steps`].
    pub(crate) fn step_slots(&self) -> Lines {
        let mut slots = Lines::zeros(self.neutral.n_slot());
        for (slot, value) in self.constants.iter().copied().chain(self.neutral.values()) {
            slots[slot as usize] = [value; LINE];
        }
        slots
    }

    /// Eight evaluations side by side, each to the bits of [`Program::evaluate`]: `inputs[k]` holds input k of each, and
    /// result k stays in the slot [`place(k)`](Self::place). For programs without calls.
    pub(crate) fn evaluate_steps(&self, slots: &mut Lines, inputs: &[[f64; LINE]]) {
        assert!(self.calls.is_empty(), "a program without calls");
        assert_eq!(inputs.len(), self.n_input, "inputs of the program");
        for &(slot, k) in &self.inputs {
            slots[slot as usize] = inputs[k as usize];
        }
        self.runs.iter().for_each(|between| runs::run_steps(between, slots));
    }

    /// `outputs = f(inputs)` over any scalar; over duals the derivative along their directions, without another compiled
    /// copy of the recorded function. Allocates its slots: [`Program::evaluate`] is the one for loops.
    ///
    /// # Panics
    /// If `inputs` or `outputs` are not of this program's sizes.
    pub fn evaluate_over<S: Scalar>(&self, inputs: &[S], outputs: &mut [S]) {
        assert_eq!(inputs.len(), self.n_input, "inputs of the program");
        assert_eq!(outputs.len(), self.outputs.len(), "outputs of the program");
        let mut slots = vec![S::zero(); self.n_slot];
        for &(slot, value) in &self.constants {
            slots[slot as usize] = S::constant(value);
        }
        for &(slot, k) in &self.inputs {
            slots[slot as usize] = inputs[k as usize];
        }
        let mut done = 0;
        for k in 0..self.calls.len() + 1 {
            let end = self.calls.get(k).map_or(self.instructions.len(), |call| call.after);
            for i in &self.instructions[done..end] {
                let [a, b, c, d] = [i.a, i.b, i.c, i.d].map(|slot| slots[slot as usize]);
                if i.op == Op::SinCos {
                    (slots[i.target as usize], slots[i.d as usize]) = a.sin_cos();
                } else {
                    slots[i.target as usize] = apply(i.op, a, b, c, d);
                }
            }
            if let Some(call) = self.calls.get(k) {
                call.run_over(&mut slots);
            }
            done = end;
        }
        for (output, slot) in outputs.iter_mut().zip(&self.outputs) {
            *output = slots[*slot as usize];
        }
    }

    /// [`BLOCK`] evaluations side by side in `f32` lanes: `inputs[k]` and `outputs[k]` hold the k-th number of each
    /// environment.
    ///
    /// # Panics
    /// If `inputs`, `outputs` or the workspace are not of this program's sizes.
    pub fn evaluate_block(
        &self,
        workspace: &mut BlockWorkspace,
        inputs: &[[f32; BLOCK]],
        outputs: &mut [[f32; BLOCK]],
    ) {
        self.evaluate_lanes(BLOCK, workspace, inputs, outputs);
    }

    /// As [`Program::evaluate_block`] for the first `n` environments of the block; what comes out for the others is left
    /// open.
    pub(crate) fn evaluate_lanes(
        &self,
        n: usize,
        workspace: &mut BlockWorkspace,
        inputs: &[[f32; BLOCK]],
        outputs: &mut [[f32; BLOCK]],
    ) {
        dispatch(Evaluate { program: self, n: n.clamp(1, BLOCK), workspace, inputs, outputs });
    }
}

impl Call {
    /// Arguments are read before results are written: they may share slots.
    #[inline(never)]
    fn run(&self, slots: &mut [f64], scratch: &mut [f64]) {
        let (n, m) = (self.inputs.len(), self.operation.n_output());
        let (x, y) = scratch[..n + m].split_at_mut(n);
        for (x, slot) in x.iter_mut().zip(&self.inputs) {
            *x = slots[*slot as usize];
        }
        self.operation.function().value(x, y);
        for &(slot, k) in &self.outputs {
            slots[slot as usize] = y[k as usize];
        }
    }

    /// The same over any scalar.
    fn run_over<S: Scalar>(&self, slots: &mut [S]) {
        let x: Vec<S> = self.inputs.iter().map(|slot| slots[*slot as usize]).collect();
        let mut y = vec![S::zero(); self.operation.n_output()];
        S::call(&self.operation, &x, &mut y);
        for &(slot, k) in &self.outputs {
            slots[slot as usize] = y[k as usize];
        }
    }

    /// The same lane by lane.
    #[inline(never)]
    fn run_block(&self, n_lane: usize, slots: &mut [[f32; BLOCK]], scratch: &mut [f64]) {
        let (n, m) = (self.inputs.len(), self.operation.n_output());
        let (x, y) = scratch[..n + m].split_at_mut(n);
        for lane in 0..n_lane {
            for (x, slot) in x.iter_mut().zip(&self.inputs) {
                *x = f64::from(slots[*slot as usize][lane]);
            }
            self.operation.function().value(x, y);
            for &(slot, k) in &self.outputs {
                slots[slot as usize][lane] = y[k as usize] as f32;
            }
        }
    }
}

/// One block evaluation, for the dispatcher.
struct Evaluate<'a> {
    program: &'a Program,
    n: usize,
    workspace: &'a mut BlockWorkspace,
    inputs: &'a [[f32; BLOCK]],
    outputs: &'a mut [[f32; BLOCK]],
}

impl Kernel for Evaluate<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { program, n, workspace, inputs, outputs } = self;
        assert_eq!(inputs.len(), program.n_input, "inputs of the program");
        assert_eq!(outputs.len(), program.outputs.len(), "outputs of the program");
        let slots = &mut workspace.slots[..program.n_slot];
        for &(slot, k) in &program.inputs {
            slots[slot as usize] = inputs[k as usize];
        }
        let mut done = 0;
        for k in 0..program.calls.len() + 1 {
            let end = if k < program.calls.len() { program.calls[k].after } else { program.instructions.len() };
            let instructions = &program.instructions[done..end];
            let cells = Cell::from_mut(&mut *slots).as_slice_of_cells();
            // half a block at a time where the slots of a whole one leave the first cache
            let width = if n > BLOCK / 2 && program.n_slot > NEAR_SLOTS { BLOCK / 2 } else { BLOCK };
            for first in (0..n).step_by(width) {
                let (lanes, slots) = (first..n.min(first + width), cells);
                match lanes.len().div_ceil(L::WIDTH) {
                    2 => Straight::<2> { instructions, slots, lanes }.outlined::<L>(),
                    4 => Straight::<4> { instructions, slots, lanes }.outlined::<L>(),
                    8 => Straight::<8> { instructions, slots, lanes }.outlined::<L>(),
                    _ => Straight::<0> { instructions, slots, lanes }.outlined::<L>(),
                }
            }
            if k < program.calls.len() {
                program.calls[k].run_block(n, slots, &mut workspace.scratch);
            }
            done = end;
        }
        for k in 0..outputs.len() {
            outputs[k] = slots[program.outputs[k] as usize];
        }
    }
}

/// One slot of a block. A cell, since the slot of a result may be that of an operand: an instruction reads a register of
/// each operand, then writes the same register of its result, and nothing has to wait in memory.
type Slot = Cell<[f32; BLOCK]>;

/// Slots of a block that stay in a first cache of 32 KiB.
const NEAR_SLOTS: usize = 128;

/// Instructions without calls over some lanes: over `N` registers, or over as many as it takes where that is 0.
struct Straight<'a, const N: usize> {
    instructions: &'a [Instruction],
    slots: &'a [Slot],
    lanes: Range<usize>,
}

impl<const N: usize> Kernel for Straight<'_, N> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let (slots, first) = (self.slots, self.lanes.start / L::WIDTH);
        let n = if N > 0 { N } else { (self.lanes.end - self.lanes.start).div_ceil(L::WIDTH) };
        for i in self.instructions {
            match i.op {
                Op::Add => each::<L>(slots, first, n, i, Op::Add),
                Op::Sub => each::<L>(slots, first, n, i, Op::Sub),
                Op::Mul => each::<L>(slots, first, n, i, Op::Mul),
                Op::Neg => each::<L>(slots, first, n, i, Op::Neg),
                Op::MulAdd => each::<L>(slots, first, n, i, Op::MulAdd),
                Op::NegMulAdd => each::<L>(slots, first, n, i, Op::NegMulAdd),
                Op::MulSub => each::<L>(slots, first, n, i, Op::MulSub),
                Op::TwoProducts => each::<L>(slots, first, n, i, Op::TwoProducts),
                Op::ProductDifference => each::<L>(slots, first, n, i, Op::ProductDifference),
                Op::Select => each::<L>(slots, first, n, i, Op::Select),
                Op::SelectLess => each::<L>(slots, first, n, i, Op::SelectLess),
                // a twentieth of a program and most of the code: calls, so that the loop stays small
                _ => Rare { slots, first, n, i }.outlined::<L>(),
            }
        }
    }
}

/// One of the operations that programs have few of.
struct Rare<'a> {
    slots: &'a [Slot],
    first: usize,
    n: usize,
    i: &'a Instruction,
}

impl Kernel for Rare<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { slots, first, n, i } = self;
        match i.op {
            Op::SinCos => {
                let [a, sine, cosine] = [i.a, i.target, i.d].map(|slot| &L::cells(&slots[slot as usize])[first..]);
                for r in 0..n {
                    let (s, c) = a[r].get().sin_cos();
                    sine[r].set(s);
                    cosine[r].set(c);
                }
            }
            Op::Div => each::<L>(slots, first, n, i, Op::Div),
            Op::Recip => each::<L>(slots, first, n, i, Op::Recip),
            Op::Sqrt => each::<L>(slots, first, n, i, Op::Sqrt),
            Op::Exp => each::<L>(slots, first, n, i, Op::Exp),
            Op::Ln => each::<L>(slots, first, n, i, Op::Ln),
            Op::Tanh => each::<L>(slots, first, n, i, Op::Tanh),
            Op::Atan2 => each::<L>(slots, first, n, i, Op::Atan2),
            Op::Less => each::<L>(slots, first, n, i, Op::Less),
            Op::And => each::<L>(slots, first, n, i, Op::And),
            Op::Or => each::<L>(slots, first, n, i, Op::Or),
            Op::Not => each::<L>(slots, first, n, i, Op::Not),
            _ => {}
        }
    }
}

/// One instruction over `n` registers from number `first` on. `op` is known at compile time in each arm of the caller's match.
#[inline(always)]
fn each<L: Lanes>(slots: &[Slot], first: usize, n: usize, i: &Instruction, op: Op) {
    let a = L::cells(&slots[i.a as usize]);
    let b = if op.n_operand() > 1 { L::cells(&slots[i.b as usize]) } else { a };
    let c = if op.n_operand() > 2 { L::cells(&slots[i.c as usize]) } else { a };
    let d = if op.n_operand() > 3 { L::cells(&slots[i.d as usize]) } else { a };
    let target = L::cells(&slots[i.target as usize]);
    let [a, b, c, d, target] = [
        &a[first..first + n],
        &b[first..first + n],
        &c[first..first + n],
        &d[first..first + n],
        &target[first..first + n],
    ];
    for r in 0..n {
        target[r].set(apply(op, a[r].get(), b[r].get(), c[r].get(), d[r].get()));
    }
}

/// The result of one operation. Truth values are 1 and 0.
#[inline(always)]
fn apply<S: Scalar>(op: Op, a: S, b: S, c: S, d: S) -> S {
    match op {
        Op::Add => a + b,
        Op::Sub => a - b,
        Op::Mul => a * b,
        Op::Div => a / b,
        Op::Neg => -a,
        Op::Recip => a.recip(),
        Op::Sqrt => a.sqrt(),
        Op::SinCos => a,
        Op::Exp => a.exp(),
        Op::Ln => a.ln(),
        Op::Tanh => a.tanh(),
        Op::Atan2 => a.atan2(b),
        Op::MulAdd => a.mul_add(b, c),
        Op::NegMulAdd => (-a).mul_add(b, c),
        Op::MulSub => a.mul_add(b, -c),
        Op::TwoProducts => a.mul_add(b, c * d),
        Op::ProductDifference => (-a).mul_add(b, c * d),
        Op::Less => S::select(a.lt(b), S::one(), S::zero()),
        Op::And => a * b,
        Op::Or => a.max(b),
        Op::Not => S::one() - a,
        Op::Select => S::select(S::constant(0.5).lt(c), a, b),
        Op::SelectLess => S::select(a.lt(b), c, d),
    }
}

#[cfg(test)]
mod tests;
