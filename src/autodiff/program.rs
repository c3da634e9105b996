//! What a recording compiles to: instructions over numbered slots, run in `f64` or over blocks of lanes.
//!
//! Compilation drops dead nodes, fuses multiplications into the one addition that uses them, fuses comparisons into
//! selections and sines with cosines, and gives slots by liveness so that the working set stays in cache. The
//! interpreter pays about one nanosecond per instruction in `f64`; over a block of [`BLOCK`] environments that price is
//! shared by all of them. Calls of custom functions stand between runs of instructions, which know nothing of them.

mod compile;

use super::custom::Operation;
use super::lanes::{Lanes, dispatch};
use super::scalar::Scalar;
use super::trace::Recording;
use crate::error::Result;
use pulp::{Simd, WithSimd};

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
    slots: Vec<[f32; BLOCK]>,
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
        let mut slots = vec![[0.0; BLOCK]; self.n_slot];
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
        dispatch(Evaluate { program: self, workspace, inputs, outputs });
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

    /// The same lane by lane.
    #[inline(never)]
    fn run_block(&self, slots: &mut [[f32; BLOCK]], scratch: &mut [f64]) {
        let (n, m) = (self.inputs.len(), self.operation.n_output());
        let (x, y) = scratch[..n + m].split_at_mut(n);
        for lane in 0..BLOCK {
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
    workspace: &'a mut BlockWorkspace,
    inputs: &'a [[f32; BLOCK]],
    outputs: &'a mut [[f32; BLOCK]],
}

impl WithSimd for Evaluate<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.program.run_block::<S>(self.workspace, self.inputs, self.outputs);
    }
}

impl Program {
    /// The lane interpreter, inside a dispatched region.
    #[inline(always)]
    fn run_block<S: Simd>(
        &self,
        workspace: &mut BlockWorkspace,
        inputs: &[[f32; BLOCK]],
        outputs: &mut [[f32; BLOCK]],
    ) {
        assert_eq!(inputs.len(), self.n_input, "inputs of the program");
        assert_eq!(outputs.len(), self.outputs.len(), "outputs of the program");
        let slots = &mut workspace.slots[..self.n_slot];
        for &(slot, k) in &self.inputs {
            slots[slot as usize] = inputs[k as usize];
        }
        let mut done = 0;
        for k in 0..self.calls.len() + 1 {
            let end = if k < self.calls.len() { self.calls[k].after } else { self.instructions.len() };
            run_block_straight::<S>(&self.instructions[done..end], slots);
            if k < self.calls.len() {
                self.calls[k].run_block(slots, &mut workspace.scratch);
            }
            done = end;
        }
        for k in 0..outputs.len() {
            outputs[k] = slots[self.outputs[k] as usize];
        }
    }
}

/// Instructions without calls over a block.
#[inline(always)]
fn run_block_straight<S: Simd>(instructions: &[Instruction], slots: &mut [[f32; BLOCK]]) {
    for i in instructions {
        match i.op {
            Op::Add => run::<S>(slots, i, Op::Add),
            Op::Sub => run::<S>(slots, i, Op::Sub),
            Op::Mul => run::<S>(slots, i, Op::Mul),
            Op::Div => run::<S>(slots, i, Op::Div),
            Op::Neg => run::<S>(slots, i, Op::Neg),
            Op::Recip => run::<S>(slots, i, Op::Recip),
            Op::Sqrt => run::<S>(slots, i, Op::Sqrt),
            Op::SinCos => run_sin_cos::<S>(slots, i),
            Op::Exp => run::<S>(slots, i, Op::Exp),
            Op::Ln => run::<S>(slots, i, Op::Ln),
            Op::Tanh => run::<S>(slots, i, Op::Tanh),
            Op::Atan2 => run::<S>(slots, i, Op::Atan2),
            Op::MulAdd => run::<S>(slots, i, Op::MulAdd),
            Op::NegMulAdd => run::<S>(slots, i, Op::NegMulAdd),
            Op::MulSub => run::<S>(slots, i, Op::MulSub),
            Op::TwoProducts => run::<S>(slots, i, Op::TwoProducts),
            Op::ProductDifference => run::<S>(slots, i, Op::ProductDifference),
            Op::Less => run::<S>(slots, i, Op::Less),
            Op::And => run::<S>(slots, i, Op::And),
            Op::Or => run::<S>(slots, i, Op::Or),
            Op::Not => run::<S>(slots, i, Op::Not),
            Op::Select => run::<S>(slots, i, Op::Select),
            Op::SelectLess => run::<S>(slots, i, Op::SelectLess),
        }
    }
}

/// Most registers worked on before results are stored: the target slot may be one of the operands'.
const GROUP: usize = 8;

/// One instruction over a block. `op` is known at compile time in each arm of the caller's match.
#[inline(always)]
fn run<S: Simd>(slots: &mut [[f32; BLOCK]], i: &Instruction, op: Op) {
    let group = if Lanes::<S>::WIDTH * GROUP < BLOCK { Lanes::<S>::WIDTH * GROUP } else { BLOCK };
    let mut start = 0;
    while start < BLOCK {
        let mut results = [Lanes::<S>::zero(); GROUP];
        let (a, b) = (&slots[i.a as usize], &slots[i.b as usize]);
        let (c, d) = (&slots[i.c as usize], &slots[i.d as usize]);
        for r in 0..group / Lanes::<S>::WIDTH {
            let at = start + r * Lanes::<S>::WIDTH;
            results[r] = apply(
                op,
                Lanes::<S>::load(&a[at..]),
                Lanes::<S>::load(&b[at..]),
                Lanes::<S>::load(&c[at..]),
                Lanes::<S>::load(&d[at..]),
            );
        }
        let target = &mut slots[i.target as usize];
        for r in 0..group / Lanes::<S>::WIDTH {
            results[r].store(&mut target[start + r * Lanes::<S>::WIDTH..]);
        }
        start += group;
    }
}

#[inline(always)]
fn run_sin_cos<S: Simd>(slots: &mut [[f32; BLOCK]], i: &Instruction) {
    for r in 0..BLOCK / Lanes::<S>::WIDTH {
        let at = r * Lanes::<S>::WIDTH;
        let (sine, cosine) = Lanes::<S>::load(&slots[i.a as usize][at..]).sin_cos();
        sine.store(&mut slots[i.target as usize][at..]);
        cosine.store(&mut slots[i.d as usize][at..]);
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
