//! What a recording compiles to: a [`ValueForm`] that every back end reads, machine code where it may be made, and instructions over
//! numbered slots for the interpreter, in `f64` or over blocks of lanes.
//!
//! Compilation drops dead nodes, fuses multiplications into the one addition that uses them, fuses comparisons into
//! selections and sines with cosines, and gives slots by liveness so that the working set stays in cache. The
//! interpreter pays one to two nanoseconds per instruction in `f64` (`program/runs.rs`); over a block of [`BLOCK`] environments that price is
//! shared by all of them. Calls of custom functions stand between runs of instructions, which know nothing of them.

mod block;
mod in_place;
mod inline;
mod plan;
mod runs;
mod slots;
mod value;

#[doc(hidden)]
pub use self::in_place::{InPlace, InPlaceWork};
pub(crate) use self::value::Tape;
pub use self::value::{CallOf, Callee, Instruction, InstructionKind, Op, Source, Split, Value, ValueForm};
pub use super::columns::BLOCK;

use self::runs::{Neutral, Run};
use super::columns::{Columns, LINE, Lines};
use super::custom::{Operation, Scratch};
use super::lanes::dispatch;
use super::native::policy::{Fallback, OnDemand};
use super::native::{self, Code, Row, RowLayout, Rows, WhyInterpreted, in_standard_modes};
use super::once::made_once;
use super::scalar::Scalar;
use super::trace::Recording;
use base::error::{Error, Result};
use std::sync::{Arc, OnceLock};

/// Slots of a small workspace: 32 KiB.
const FEW_SLOTS: usize = 1 << 12;

/// Slots of a roomy one: half a mebibyte.
const MANY_SLOTS: usize = 1 << 16;

/// Most values of a program: they are numbered by `u32`.
const MAX_VALUES: usize = u32::MAX as usize;

/// An instruction over slots.
#[derive(Debug, Clone, Copy)]
struct Placed {
    op: Op,
    target: u32,
    a: u32,
    b: u32,
    c: u32,
    /// Of a sine and cosine, the second result.
    d: u32,
}

/// What a call of the interpreter calls.
#[derive(Debug, Clone)]
enum Called {
    Custom(Operation),
    /// By its number in [`Interpreter::functions`].
    Function(usize),
}

/// A function of slots, made when the instructions before it are done.
#[derive(Debug, Clone)]
struct Call {
    /// How many those are.
    after: usize,
    called: Called,
    inputs: Vec<u32>,
    /// (slot, result), for the results that matter.
    outputs: Vec<(u32, u32)>,
}

/// A function over slots that no other writes.
#[derive(Debug, Clone)]
struct Body {
    /// Instructions, grouped: before the first call, between the first and the second, and so on.
    runs: Vec<Vec<Run>>,
    /// In the order they are made.
    calls: Vec<Call>,
    /// (slot, input), for the inputs that matter.
    inputs: Vec<(u32, u32)>,
    outputs: Vec<u32>,
}

/// A program over slots.
#[derive(Debug, Clone)]
struct Interpreter {
    n_slot: usize,
    body: Body,
    functions: Vec<Body>,
    neutral: Neutral,
    /// (slot, value), never overwritten.
    constants: Vec<(u32, f64)>,
}

impl Interpreter {
    /// Slots from which a called function's inputs are read, and where they are put.
    fn inputs_of<'a>(&self, function: &'a Body, call: &'a Call) -> impl Iterator<Item = (u32, u32)> + 'a {
        function.inputs.iter().map(|&(slot, k)| (call.inputs[k as usize], slot))
    }

    /// Slots in which a called function leaves its results, and where they are put.
    fn outputs_of<'a>(&self, function: &'a Body, call: &'a Call) -> impl Iterator<Item = (u32, u32)> + 'a {
        call.outputs.iter().map(|&(slot, k)| (function.outputs[k as usize], slot))
    }
}

/// A compiled recording.
#[derive(Debug, Clone)]
pub struct Program {
    form: Arc<ValueForm>,
    /// As code is made of it: some functions are put where they are called.
    arranged: Arc<ValueForm>,
    /// Made when somebody interprets.
    interpreter: Arc<OnceLock<Interpreter>>,
    /// For one evaluation at a time.
    scheduled: bool,
    codes: Arc<Codes>,
}

/// Machine code of a program, made when somebody asks for a workspace.
#[derive(Debug, Default)]
struct Codes {
    single: OnDemand<Code>,
    block: OnDemand<Code>,
}

/// Slots of one `f64` evaluation; made once, reused without allocation.
///
/// Where they are few or many, as many as a mask can name, so that no access needs a bounds check.
#[derive(Debug, Clone)]
pub struct Workspace {
    slots: Slots,
    scratch: Vec<f64>,
}

#[derive(Debug, Clone)]
enum Slots {
    Native(Box<NativeSlots>),
    Few(Box<[f64; FEW_SLOTS]>),
    Many(Box<[f64; MANY_SLOTS]>),
    /// As many as the program has.
    All(Vec<f64>),
}

impl Workspace {
    /// Numbers held.
    pub(crate) fn len(&self) -> usize {
        self.slots().len() + self.scratch.len()
    }

    /// Whether it is that of machine code.
    pub(crate) fn is_native(&self) -> bool {
        matches!(self.slots, Slots::Native(_))
    }

    /// By number of the slot.
    pub(crate) fn slots(&self) -> &[f64] {
        match &self.slots {
            Slots::Native(native) => native.slots.as_flattened(),
            Slots::Few(slots) => &slots[..],
            Slots::Many(slots) => &slots[..],
            Slots::All(slots) => slots,
        }
    }
}

/// Slots of one block evaluation; made once, reused without allocation.
#[derive(Debug, Clone)]
pub struct BlockWorkspace {
    slots: Columns,
    scratch: Vec<[f32; BLOCK]>,
    /// Where there is machine code; the others are empty then.
    native: Option<NativeSlots>,
}

/// Machine code, its slots, and the program that it is of.
#[derive(Debug, Clone)]
struct NativeSlots {
    code: Code,
    slots: Lines,
    form: Arc<ValueForm>,
}

impl NativeSlots {
    fn run<R: Row>(&mut self, program: &Program, arrays: &mut [Rows<'_, R>], n: usize) {
        let is_own = Arc::ptr_eq(&self.form, &program.arranged) || self.form == program.arranged;
        assert!(is_own && self.code.run(&mut self.slots, arrays, n), "slots of the program");
    }
}

impl Program {
    /// Compiles a recording.
    ///
    /// # Errors
    /// [`Error::Limit`] when it has more than 2³² values.
    pub fn compile(recording: &Recording) -> Result<Self> {
        Self::compiled(recording, false)
    }

    /// As [`Program::compile`] for use in `f64`: instructions that do not wait for each other stand together. Takes more slots,
    /// which over a block of environments leave the cache.
    ///
    /// # Errors
    /// As [`Program::compile`].
    pub(crate) fn compile_single(recording: &Recording) -> Result<Self> {
        Self::compiled(recording, true)
    }

    fn compiled(recording: &Recording, scheduled: bool) -> Result<Self> {
        Ok(Self::of_form(Self::form_of(recording)?, scheduled))
    }

    /// The values of a recording, arranged for those who make code of them and interpret nothing.
    ///
    /// # Errors
    /// As [`Program::compile`].
    pub(crate) fn code_form(recording: &Recording) -> Result<ValueForm> {
        let form = inline::with_long_functions(&Arc::new(Self::form_of(recording)?));
        Ok(Arc::unwrap_or_clone(form))
    }

    /// The values of a recording, arranged for text.
    ///
    /// # Errors
    /// As [`Program::compile`].
    pub(crate) fn text_form(recording: &Recording) -> Result<Arc<ValueForm>> {
        Ok(inline::with_short_functions(&Arc::new(Self::form_of(recording)?)))
    }

    /// Its values, arranged for text.
    pub(crate) fn as_text(&self) -> Arc<ValueForm> {
        inline::with_short_functions(&self.form)
    }

    fn form_of(recording: &Recording) -> Result<ValueForm> {
        // a sine alone has its cosine beside it
        let n_value = recording.n_input + 2 * recording.nodes.len();
        if n_value > MAX_VALUES {
            let remedy = "Record a smaller function: one step instead of a rollout.";
            return Err(Error::limit("number of values of a program", n_value, MAX_VALUES, remedy));
        }
        Ok(ValueForm::of(recording))
    }

    pub(crate) fn of_form(form: ValueForm, scheduled: bool) -> Self {
        let form = Arc::new(form);
        let arranged = inline::with_long_functions(&form);
        Self { form, arranged, interpreter: Arc::default(), scheduled, codes: Arc::default() }
    }

    /// With every call as the form has it.
    #[cfg(test)]
    pub(crate) fn of_calls(form: ValueForm) -> Self {
        let form = Arc::new(form);
        let interpreter = Arc::new(OnceLock::from(slots::interpreter(&form, false)));
        Self { arranged: form.clone(), form, interpreter, scheduled: false, codes: Arc::default() }
    }

    fn interpreter(&self) -> &Interpreter {
        made_once(&self.interpreter, || slots::interpreter(&inline::with_few_calls(&self.form), self.scheduled))
    }

    /// The program as values: what it computes, in an order, with fusions decided.
    pub fn value_form(&self) -> &ValueForm {
        &self.form
    }

    /// As code is made of it: functions that are short, or called once, stand where they are called, and equal terms are one.
    pub(crate) fn arranged(&self) -> &Arc<ValueForm> {
        &self.arranged
    }

    /// Whether [`evaluate_block`](Self::evaluate_block) runs machine code instead of the interpreter: the same bits, several times as
    /// fast.
    pub fn is_native(&self) -> bool {
        self.why_interpreted().is_none()
    }

    /// Why [`evaluate_block`](Self::evaluate_block) interprets; `None` where it runs machine code.
    pub fn why_interpreted(&self) -> Option<WhyInterpreted> {
        self.code::<[f32; BLOCK]>(&self.codes.block).err()
    }

    fn native_slots(&self, code: Code) -> NativeSlots {
        NativeSlots { slots: code.slots(), code, form: self.arranged.clone() }
    }

    /// Machine code for rows of a kind, kept at `place`.
    fn code<R: Row>(&self, place: &OnDemand<Code>) -> std::result::Result<Code, WhyInterpreted> {
        place.now(|| self.made_code::<R>())
    }

    fn made_code<R: Row>(&self) -> std::result::Result<Code, WhyInterpreted> {
        native::code::<R>(&self.arranged, &RowLayout::apart(self.n_input(), self.n_output()))
    }

    fn native_workspace(&self, code: Code) -> Workspace {
        Workspace { scratch: Vec::new(), slots: Slots::Native(Box::new(self.native_slots(code))) }
    }

    /// Number of inputs.
    pub fn n_input(&self) -> usize {
        self.form.n_input
    }

    /// Number of results.
    pub fn n_output(&self) -> usize {
        self.form.results.len()
    }

    /// Number of instructions, with calls, as code is made of them: those of a function that is called count once, and those of one
    /// that is put where it is called count there.
    pub fn len(&self) -> usize {
        let functions = self.arranged.functions();
        self.arranged.instructions.len() + functions.iter().map(|form| form.instructions.len()).sum::<usize>()
    }

    /// Whether there is nothing to do but copy constants and inputs.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of slots: values alive at once, with constants.
    pub fn n_slot(&self) -> usize {
        self.interpreter().n_slot
    }

    /// Scratch for [`Program::evaluate`]. The first one makes its machine code: about half a microsecond an instruction.
    pub fn workspace(&self) -> Workspace {
        let code = self.code::<f64>(&self.codes.single);
        code.map_or_else(|_| self.interpreter_workspace(), |code| self.native_workspace(code))
    }

    /// As [`Program::workspace`] where so many evaluations, with those that were asked for before, are worth the code.
    #[doc(hidden)]
    pub fn workspace_for(&self, n_evaluation: u64) -> Workspace {
        self.native_workspace_for(n_evaluation).unwrap_or_else(|| self.interpreter_workspace())
    }

    /// The same; nothing where it would interpret.
    pub(crate) fn native_workspace_for(&self, n_evaluation: u64) -> Option<Workspace> {
        let place = &self.codes.single;
        let code = place.ask(Fallback::Interpreted, self.len(), n_evaluation, || self.made_code::<f64>())?;
        Some(self.native_workspace(code))
    }

    /// Scratch with which [`Program::evaluate`] interprets, whether there is machine code or not.
    pub fn interpreter_workspace(&self) -> Workspace {
        if self.interpreter().neutral.n_slot() > FEW_SLOTS {
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
        let n_slot = self.interpreter().neutral.n_slot().max(MANY_SLOTS);
        let mut zeros: Box<[f64]> = vec![0.0; n_slot].into_boxed_slice();
        self.write_constants(&mut zeros);
        let slots = zeros.try_into().map_or_else(|all: Box<[f64]>| Slots::All(all.into_vec()), Slots::Many);
        Workspace { slots, scratch: self.scratch() }
    }

    fn write_constants(&self, slots: &mut [f64]) {
        for (slot, value) in self.fixed_slots() {
            slots[slot as usize] = value;
        }
    }

    /// (slot, value) of the slots that no instruction writes.
    fn fixed_slots(&self) -> impl Iterator<Item = (u32, f64)> + '_ {
        self.interpreter().constants.iter().copied().chain(self.interpreter().neutral.values())
    }

    /// Scratch for [`Program::evaluate_block`]. The first one makes its machine code, as [`Program::workspace`] does.
    pub fn block_workspace(&self) -> BlockWorkspace {
        let code = self.code::<[f32; BLOCK]>(&self.codes.block);
        code.map_or_else(|_| self.interpreter_block_workspace(), |code| self.native_block_workspace(code))
    }

    /// As [`Program::block_workspace`] where so many evaluations, with those that were asked for before, are worth the code.
    pub(crate) fn block_workspace_for(&self, n_evaluation: u64) -> BlockWorkspace {
        let (place, make) = (&self.codes.block, || self.made_code::<[f32; BLOCK]>());
        let code = place.ask(Fallback::InterpretedBlock, self.len(), n_evaluation, make);
        code.map_or_else(|| self.interpreter_block_workspace(), |code| self.native_block_workspace(code))
    }

    fn native_block_workspace(&self, code: Code) -> BlockWorkspace {
        BlockWorkspace { slots: Columns::default(), scratch: Vec::new(), native: Some(self.native_slots(code)) }
    }

    /// Scratch with which [`Program::evaluate_block`] interprets, whether there is machine code or not.
    pub fn interpreter_block_workspace(&self) -> BlockWorkspace {
        let mut slots = Columns::zeros(self.interpreter().neutral.n_slot());
        in_standard_modes(|| {
            for (slot, value) in self.fixed_slots() {
                slots[slot as usize] = [value as f32; BLOCK];
            }
        });
        BlockWorkspace { slots, scratch: vec![[0.0; BLOCK]; self.n_scratch()], native: None }
    }

    fn scratch(&self) -> Vec<f64> {
        vec![0.0; self.n_scratch()]
    }

    /// Arguments and results of one call at a time.
    fn n_scratch(&self) -> usize {
        let Interpreter { body, functions, .. } = self.interpreter();
        let calls = functions.iter().chain([body]).flat_map(|body| &body.calls);
        let sizes = calls.map(|call| match &call.called {
            Called::Custom(operation) => operation.n_input() + operation.n_output(),
            Called::Function(_) => 0,
        });
        sizes.max().unwrap_or(0)
    }

    /// `outputs = f(inputs)` in `f64`, `[n_output]` of `[n_input]`, with the same operations in the same order as the recorded function.
    ///
    /// # Panics
    /// If `inputs` or `outputs` are not of this program's sizes or the workspace has too few slots. One that another
    /// program made holds other constants: it gives wrong numbers.
    pub fn evaluate(&self, workspace: &mut Workspace, inputs: &[f64], outputs: &mut [f64]) {
        assert_eq!(inputs.len(), self.n_input(), "inputs of the program");
        assert_eq!(outputs.len(), self.n_output(), "outputs of the program");
        if let Slots::Native(native) = &mut workspace.slots {
            return native.run(self, &mut [Rows::Read(inputs), Rows::Write(outputs)], 1);
        }
        let slots = self.evaluate_inside(workspace, inputs);
        for (output, slot) in outputs.iter_mut().zip(&self.interpreter().body.outputs) {
            *output = slots[*slot as usize];
        }
    }

    /// As [`Program::evaluate`]; result k stays at [`place(k)`](Self::place) of what is returned.
    pub(crate) fn evaluate_inside<'w>(&self, workspace: &'w mut Workspace, inputs: &[f64]) -> &'w [f64] {
        assert_eq!(inputs.len(), self.n_input(), "inputs of the program");
        let Workspace { slots, scratch } = workspace;
        in_standard_modes(|| match slots {
            Slots::Native(..) => panic!("slots of the program"),
            Slots::Few(slots) => self.interpreter().run(&mut **slots, scratch, inputs),
            Slots::Many(slots) => self.interpreter().run(&mut **slots, scratch, inputs),
            Slots::All(slots) => self.interpreter().run(slots, scratch, inputs),
        });
        workspace.slots()
    }

    /// The slot of result `k`.
    pub(crate) fn place(&self, k: usize) -> u32 {
        self.interpreter().body.outputs[k]
    }

    /// Slots for [`Program::evaluate_steps`].
    pub(crate) fn step_slots(&self) -> Lines {
        let mut slots = Lines::zeros(self.interpreter().neutral.n_slot());
        for (slot, value) in self.fixed_slots() {
            slots[slot as usize] = [value; LINE];
        }
        slots
    }

    /// Eight evaluations side by side, each to the bits of [`Program::evaluate`]: `inputs[k]` holds input k of each, and
    /// result k stays in the slot [`place(k)`](Self::place). Calls are made for the first `n`.
    pub(crate) fn evaluate_steps(&self, n: usize, slots: &mut Lines, inputs: &[[f64; LINE]]) {
        let interpreter = self.interpreter();
        assert_eq!(inputs.len(), self.n_input(), "inputs of the program");
        for &(slot, k) in &interpreter.body.inputs {
            slots[slot as usize] = inputs[k as usize];
        }
        in_standard_modes(|| interpreter.run_steps(&interpreter.body, n, slots));
    }

    /// `outputs = f(inputs)` over any scalar; over duals the derivative along their directions, without another compiled
    /// copy of the recorded function. Allocates its slots: [`Program::evaluate`] is the one for loops.
    ///
    /// # Panics
    /// If `inputs` or `outputs` are not of this program's sizes.
    pub fn evaluate_over<S: Scalar>(&self, inputs: &[S], outputs: &mut [S]) {
        assert_eq!(inputs.len(), self.n_input(), "inputs of the program");
        assert_eq!(outputs.len(), self.n_output(), "outputs of the program");
        self.form.evaluate_over(inputs, outputs);
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
    #[doc(hidden)]
    pub fn evaluate_lanes(
        &self,
        n: usize,
        workspace: &mut BlockWorkspace,
        inputs: &[[f32; BLOCK]],
        outputs: &mut [[f32; BLOCK]],
    ) {
        if let Some(native) = &mut workspace.native {
            assert_eq!(
                (inputs.len(), outputs.len()),
                (self.n_input(), self.n_output()),
                "inputs and outputs of the program"
            );
            return native.run(self, &mut [Rows::Read(inputs), Rows::Write(outputs)], n.clamp(1, BLOCK));
        }
        in_standard_modes(|| {
            dispatch(block::Evaluate { program: self, n: n.clamp(1, BLOCK), workspace, inputs, outputs })
        });
    }
}

impl ValueForm {
    fn evaluate_over<S: Scalar>(&self, inputs: &[S], outputs: &mut [S]) {
        let constants = self.constants().map(S::constant);
        let mut values: Vec<S> = inputs.iter().copied().chain(constants).collect();
        values.reserve_exact(self.n_value() - values.len());
        for instruction in self.instructions() {
            match instruction.action {
                InstructionKind::Op(Op::SinCos, [a, ..]) => values.extend(<[S; 2]>::from(values[a.index()].sin_cos())),
                InstructionKind::Op(op, operands) => {
                    let [a, b, c, d] = operands.map(|value| values[value.index()]);
                    values.push(apply(op, a, b, c, d));
                }
                InstructionKind::Call(number) => {
                    let CallOf { callee, operands } = &self.calls()[number];
                    let x: Vec<S> = operands.iter().map(|value| values[value.index()]).collect();
                    let mut y = vec![S::zero(); callee.n_output()];
                    match callee {
                        Callee::Custom(operation) => S::call(operation, &x, &mut y),
                        Callee::Function(form) => form.evaluate_over(&x, &mut y),
                    }
                    values.extend(y);
                }
            }
        }
        for (output, value) in outputs.iter_mut().zip(self.results()) {
            *output = values[value.index()];
        }
    }
}

impl Call {
    /// A custom function. Arguments are read before results are written: they may share slots.
    #[inline(never)]
    fn run(&self, operation: &Operation, slots: &mut impl Storage, scratch: &mut [f64]) {
        let (n, m) = (self.inputs.len(), operation.n_output());
        let (x, y) = scratch[..n + m].split_at_mut(n);
        for (x, slot) in x.iter_mut().zip(&self.inputs) {
            *x = slots.get(*slot);
        }
        operation.function().value(x, y);
        for &(slot, k) in &self.outputs {
            slots.set(slot, y[k as usize]);
        }
    }

    /// A custom function, step by step.
    fn run_steps(&self, operation: &Operation, n_step: usize, slots: &mut [[f64; LINE]]) {
        let n = self.inputs.len();
        let mut scratch = Scratch::<f64, 256>::new();
        let (x, y) = scratch.of(n + operation.n_output()).split_at_mut(n);
        for step in 0..n_step {
            for (x, slot) in x.iter_mut().zip(&self.inputs) {
                *x = slots[*slot as usize][step];
            }
            operation.function().value(x, y);
            for &(slot, k) in &self.outputs {
                slots[slot as usize][step] = y[k as usize];
            }
        }
    }
}

impl Interpreter {
    /// In `f64`.
    fn run(&self, slots: &mut impl Storage, scratch: &mut [f64], inputs: &[f64]) {
        assert!(slots.len() >= self.neutral.n_slot(), "slots of the program");
        for &(slot, k) in &self.body.inputs {
            slots.set(slot, inputs[k as usize]);
        }
        self.run_body(&self.body, slots, scratch);
    }

    /// Instructions up to each call, the call, and so on.
    fn run_body(&self, body: &Body, slots: &mut impl Storage, scratch: &mut [f64]) {
        for (k, between) in body.runs.iter().enumerate() {
            runs::run(between, slots);
            match body.calls.get(k).map(|call| (call, &call.called)) {
                None => {}
                Some((call, Called::Custom(operation))) => call.run(operation, slots, scratch),
                Some((call, Called::Function(number))) => {
                    let function = &self.functions[*number];
                    self.inputs_of(function, call).for_each(|(from, to)| slots.set(to, slots.get(from)));
                    self.run_body(function, slots, scratch);
                    self.outputs_of(function, call).for_each(|(from, to)| slots.set(to, slots.get(from)));
                }
            }
        }
    }

    /// Of eight steps, with custom functions for the first `n`.
    fn run_steps(&self, body: &Body, n: usize, slots: &mut Lines) {
        for (k, between) in body.runs.iter().enumerate() {
            runs::run_steps(between, slots);
            match body.calls.get(k).map(|call| (call, &call.called)) {
                None => {}
                Some((call, Called::Custom(operation))) => call.run_steps(operation, n, slots),
                Some((call, Called::Function(number))) => {
                    let function = &self.functions[*number];
                    self.inputs_of(function, call).for_each(|(from, to)| slots[to as usize] = slots[from as usize]);
                    self.run_steps(function, n, slots);
                    self.outputs_of(function, call).for_each(|(from, to)| slots[to as usize] = slots[from as usize]);
                }
            }
        }
    }
}

/// Numbered slots.
trait Storage {
    fn len(&self) -> usize;
    fn get(&self, slot: u32) -> f64;
    fn set(&mut self, slot: u32, value: f64);
}

/// N is a power of two above every slot number, so that masking changes nothing and spares the bounds checks.
impl<const N: usize> Storage for [f64; N] {
    #[inline(always)]
    fn len(&self) -> usize {
        N
    }
    #[inline(always)]
    fn get(&self, slot: u32) -> f64 {
        self[slot as usize & (N - 1)]
    }
    #[inline(always)]
    fn set(&mut self, slot: u32, value: f64) {
        self[slot as usize & (N - 1)] = value;
    }
}

impl Storage for Vec<f64> {
    #[inline(always)]
    fn len(&self) -> usize {
        self.len()
    }
    #[inline(always)]
    fn get(&self, slot: u32) -> f64 {
        self[slot as usize]
    }
    #[inline(always)]
    fn set(&mut self, slot: u32, value: f64) {
        self[slot as usize] = value;
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
