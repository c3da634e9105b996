//! What a recording compiles to: instructions over numbered slots, run in `f64` or over blocks of lanes.
//!
//! Compilation drops dead nodes, fuses multiplications into the one addition that uses them, fuses comparisons into
//! selections and sines with cosines, and gives slots by liveness so that the working set stays in cache. The
//! interpreter pays one to two nanoseconds per instruction in `f64` (`program/runs.rs`); over a block of [`BLOCK`] environments that price is
//! shared by all of them. Calls of custom functions stand between runs of instructions, which know nothing of them.

mod block;
mod compile;
mod runs;

pub use super::columns::BLOCK;

use self::runs::{Neutral, Run};
use super::columns::{Columns, LINE, Lines};
use super::custom::Operation;
use super::lanes::dispatch;
use super::scalar::Scalar;
use super::trace::Recording;
use crate::error::{Error, Result};

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
    /// The same, grouped: before the first call, between the first and the second, and so on.
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
        let mut slots = Columns::zeros(self.neutral.n_slot());
        for (slot, value) in self.constants.iter().copied().chain(self.neutral.values()) {
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
        dispatch(block::Evaluate { program: self, n: n.clamp(1, BLOCK), workspace, inputs, outputs });
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
