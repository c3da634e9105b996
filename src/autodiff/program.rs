//! What a recording compiles to: instructions over numbered slots, run in `f64` or over blocks of lanes.
//!
//! Compilation drops dead nodes, fuses multiplications into the one addition that uses them, fuses comparisons into
//! selections and sines with cosines, and gives slots by liveness so that the working set stays in cache. The
//! interpreter pays about one nanosecond per instruction in `f64`; over a block of [`BLOCK`] environments that price is
//! shared by all of them. Calls of custom functions stand between runs of instructions, which know nothing of them.

mod compile;

use super::columns::Columns;
use super::custom::Operation;
use super::lanes::{Kernel, Lanes, dispatch};
use super::scalar::Scalar;
use super::trace::Recording;
use crate::error::Result;
use std::cell::Cell;

/// Environments per block of the lane evaluator.
pub const BLOCK: usize = 64;

/// Most slots of a program: they are numbered by `u16`.
const MAX_SLOTS: usize = 1 << 16;

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
        let slots = match &self.slots {
            Slots::Few(slots) => slots.len(),
            Slots::Many(slots) => slots.len(),
        };
        slots + self.scratch.len()
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
    /// [`Error::Limit`](crate::error::Error::Limit) when more than 65 535 values are alive at once.
    pub fn compile(recording: &Recording) -> Result<Self> {
        compile::Compiler::new(&recording.attached()).run()
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
        let mut slots = if self.n_slot <= FEW_SLOTS {
            Slots::Few(Box::new([0.0; FEW_SLOTS]))
        } else {
            Slots::Many(Box::new([0.0; MAX_SLOTS]))
        };
        let all: &mut [f64] = match &mut slots {
            Slots::Few(slots) => &mut slots[..],
            Slots::Many(slots) => &mut slots[..],
        };
        for &(slot, value) in &self.constants {
            all[slot as usize] = value;
        }
        Workspace { slots, scratch: self.scratch() }
    }

    /// Scratch for [`Program::evaluate_block`].
    pub fn block_workspace(&self) -> BlockWorkspace {
        let lanes = self.lanes_of_slot();
        let mut slots = Columns::zeros((self.n_slot * lanes).div_ceil(BLOCK));
        for &(slot, value) in &self.constants {
            slots.as_flattened_mut()[slot as usize * lanes..][..lanes].fill(value as f32);
        }
        BlockWorkspace { slots, scratch: self.scratch() }
    }

    /// Environments that go through the program together: half a block where the slots of a whole one leave the first cache.
    fn lanes_of_slot(&self) -> usize {
        if self.n_slot > NEAR_SLOTS { BLOCK / 2 } else { BLOCK }
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
        match &mut workspace.slots {
            Slots::Few(slots) => self.run(slots, &mut workspace.scratch, inputs, outputs),
            Slots::Many(slots) => self.run(slots, &mut workspace.scratch, inputs, outputs),
        }
    }

    /// The `f64` interpreter: instructions up to each call, the call, and so on. N is a power of two above every slot
    /// number, so that masking changes nothing and spares the bounds checks.
    fn run<const N: usize>(&self, slots: &mut [f64; N], scratch: &mut [f64], inputs: &[f64], outputs: &mut [f64]) {
        assert!(N >= self.n_slot, "slots of the program");
        let at = |slot: u16| slot as usize & (N - 1);
        for &(slot, k) in &self.inputs {
            slots[at(slot)] = inputs[k as usize];
        }
        let mut done = 0;
        for k in 0..self.calls.len() + 1 {
            let end = self.calls.get(k).map_or(self.instructions.len(), |call| call.after);
            run_straight(&self.instructions[done..end], slots);
            if k < self.calls.len() {
                self.calls[k].run(slots, scratch);
            }
            done = end;
        }
        for (output, slot) in outputs.iter_mut().zip(&self.outputs) {
            *output = slots[at(*slot)];
        }
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

/// Instructions without calls in `f64`. Inlined into its caller the loop was measured 10 % slower.
#[inline(never)]
fn run_straight<const N: usize>(instructions: &[Instruction], slots: &mut [f64; N]) {
    let at = |slot: u16| slot as usize & (N - 1);
    for i in instructions {
        match i.op {
            // the kinds that make up nine tenths of a program, without the operands they do not have
            Op::Add => slots[at(i.target)] = slots[at(i.a)] + slots[at(i.b)],
            Op::Mul => slots[at(i.target)] = slots[at(i.a)] * slots[at(i.b)],
            Op::MulAdd => slots[at(i.target)] = slots[at(i.a)] * slots[at(i.b)] + slots[at(i.c)],
            Op::NegMulAdd => slots[at(i.target)] = slots[at(i.c)] - slots[at(i.a)] * slots[at(i.b)],
            Op::TwoProducts => {
                slots[at(i.target)] = slots[at(i.a)] * slots[at(i.b)] + slots[at(i.c)] * slots[at(i.d)];
            }
            Op::ProductDifference => {
                slots[at(i.target)] = slots[at(i.c)] * slots[at(i.d)] - slots[at(i.a)] * slots[at(i.b)];
            }
            Op::SinCos => {
                let (sine, cosine) = slots[at(i.a)].sin_cos();
                slots[at(i.target)] = sine;
                slots[at(i.d)] = cosine;
            }
            op => {
                let x = |slot: u16| slots[at(slot)];
                slots[at(i.target)] = apply(op, x(i.a), x(i.b), x(i.c), x(i.d));
            }
        }
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

    /// The same lane by lane, the first `n_lane` of slots of `width` numbers.
    #[inline(never)]
    fn run_lanes(&self, n_lane: usize, width: usize, slots: &mut [f32], scratch: &mut [f64]) {
        let (n, m) = (self.inputs.len(), self.operation.n_output());
        let (x, y) = scratch[..n + m].split_at_mut(n);
        for lane in 0..n_lane {
            for (x, slot) in x.iter_mut().zip(&self.inputs) {
                *x = f64::from(slots[*slot as usize * width + lane]);
            }
            self.operation.function().value(x, y);
            for &(slot, k) in &self.outputs {
                slots[slot as usize * width + lane] = y[k as usize] as f32;
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
        let width = program.lanes_of_slot();
        let mut first = 0;
        while first < n {
            let n_lane = if n - first < width { n - first } else { width };
            program.evaluate_pass::<L>(first, n_lane, workspace, inputs, outputs);
            first += width;
        }
    }
}

impl Program {
    /// Environments `first` … `first + n_lane` of a block through the whole program.
    #[inline(always)]
    fn evaluate_pass<L: Lanes>(
        &self,
        first: usize,
        n_lane: usize,
        workspace: &mut BlockWorkspace,
        inputs: &[[f32; BLOCK]],
        outputs: &mut [[f32; BLOCK]],
    ) {
        let (width, n_register) = (self.lanes_of_slot(), n_lane.div_ceil(L::WIDTH));
        let BlockWorkspace { slots, scratch } = workspace;
        for &(slot, k) in &self.inputs {
            let to = &mut slots.as_flattened_mut()[slot as usize * width..][..width];
            copy_registers::<L>(n_register, &inputs[k as usize][first..][..width], to);
        }
        let mut done = 0;
        for k in 0..self.calls.len() + 1 {
            let end = if k < self.calls.len() { self.calls[k].after } else { self.instructions.len() };
            let instructions = &self.instructions[done..end];
            let (rows, n, stride) = (Cell::from_mut(&mut slots[..]).as_slice_of_cells(), n_register, width / L::WIDTH);
            match if n == stride { n } else { 0 } {
                2 => L::outlined(Straight::<2> { instructions, rows, n, stride }),
                4 => L::outlined(Straight::<4> { instructions, rows, n, stride }),
                8 => L::outlined(Straight::<8> { instructions, rows, n, stride }),
                _ => L::outlined(Straight::<0> { instructions, rows, n, stride }),
            }
            if k < self.calls.len() {
                self.calls[k].run_lanes(n_lane, width, slots.as_flattened_mut(), scratch);
            }
            done = end;
        }
        for k in 0..outputs.len() {
            let from = &slots.as_flattened()[self.outputs[k] as usize * width..][..width];
            copy_registers::<L>(n_register, from, &mut outputs[k][first..][..width]);
        }
    }
}

#[inline(always)]
fn copy_registers<L: Lanes>(n: usize, from: &[f32], to: &mut [f32]) {
    for r in 0..n {
        L::load(&from[r * L::WIDTH..]).store(&mut to[r * L::WIDTH..]);
    }
}

/// Rows of the workspace, each of one slot or of several. Cells, since the slot of a result may be that of an operand: an
/// instruction reads a register of each operand, then writes the same register of its result, and nothing has to wait in
/// memory.
type Rows = [Cell<[f32; BLOCK]>];

/// Slots of a block that stay in a first cache of 32 KiB.
const NEAR_SLOTS: usize = 128;

/// Instructions without calls over the first `n` of `stride` registers of each slot; both are `N` where that is not 0.
struct Straight<'a, const N: usize> {
    instructions: &'a [Instruction],
    rows: &'a Rows,
    n: usize,
    stride: usize,
}

impl<const N: usize> Kernel for Straight<'_, N> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let (n, stride) = if N > 0 { (N, N) } else { (self.n, self.stride) };
        let slots = Registers { cells: L::cells(self.rows), n, stride };
        for i in self.instructions {
            match i.op {
                Op::Add => slots.each(i, Op::Add),
                Op::Sub => slots.each(i, Op::Sub),
                Op::Mul => slots.each(i, Op::Mul),
                Op::Neg => slots.each(i, Op::Neg),
                Op::MulAdd => slots.each(i, Op::MulAdd),
                Op::NegMulAdd => slots.each(i, Op::NegMulAdd),
                Op::MulSub => slots.each(i, Op::MulSub),
                Op::TwoProducts => slots.each(i, Op::TwoProducts),
                Op::ProductDifference => slots.each(i, Op::ProductDifference),
                Op::Select => slots.each(i, Op::Select),
                Op::SelectLess => slots.each(i, Op::SelectLess),
                // a twentieth of a program and most of the code: calls, so that the loop stays small
                _ => L::outlined(Rare { rows: self.rows, n, stride, i }),
            }
        }
    }
}

/// One of the operations that programs have few of.
struct Rare<'a> {
    rows: &'a Rows,
    n: usize,
    stride: usize,
    i: &'a Instruction,
}

impl Kernel for Rare<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { rows, n, stride, i } = self;
        let slots = Registers { cells: L::cells(rows), n, stride };
        match i.op {
            Op::SinCos => {
                let (a, sine, cosine) = (slots.of(i.a), slots.of(i.target), slots.of(i.d));
                for r in 0..n {
                    let (s, c) = a[r].get().sin_cos();
                    sine[r].set(s);
                    cosine[r].set(c);
                }
            }
            Op::Div => slots.each(i, Op::Div),
            Op::Recip => slots.each(i, Op::Recip),
            Op::Sqrt => slots.each(i, Op::Sqrt),
            Op::Exp => slots.each(i, Op::Exp),
            Op::Ln => slots.each(i, Op::Ln),
            Op::Tanh => slots.each(i, Op::Tanh),
            Op::Atan2 => slots.each(i, Op::Atan2),
            Op::Less => slots.each(i, Op::Less),
            Op::And => slots.each(i, Op::And),
            Op::Or => slots.each(i, Op::Or),
            Op::Not => slots.each(i, Op::Not),
            _ => {}
        }
    }
}

/// Slots of `stride` registers, of which the first `n` are in use.
struct Registers<'a, L> {
    cells: &'a [Cell<L>],
    n: usize,
    stride: usize,
}

impl<'a, L: Lanes> Registers<'a, L> {
    #[inline(always)]
    fn of(&self, slot: u16) -> &'a [Cell<L>] {
        &self.cells[slot as usize * self.stride..][..self.n]
    }

    /// One instruction. `op` is known at compile time in each arm of the caller's match.
    #[inline(always)]
    fn each(&self, i: &Instruction, op: Op) {
        let a = self.of(i.a);
        let b = if op.n_operand() > 1 { self.of(i.b) } else { a };
        let c = if op.n_operand() > 2 { self.of(i.c) } else { a };
        let d = if op.n_operand() > 3 { self.of(i.d) } else { a };
        let target = self.of(i.target);
        for r in 0..self.n {
            target[r].set(apply(op, a[r].get(), b[r].get(), c[r].get(), d[r].get()));
        }
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
