//! A program as values: what every back end reads.
//!
//! Numbers are named once and never overwritten (static single assignment, Cytron et al. 1991). Which products are fused into which
//! sums is decided here, so that whoever runs the form computes the same bits.

use super::plan::Planner;
use crate::custom::Operation;
use crate::trace::Recording;
use std::collections::HashSet;
use std::fmt;
use std::hash::{Hash, Hasher};
use std::ops::Range;
use std::sync::Arc;

/// What an instruction computes of its operands a, b, c, d. Truth values are 1 and 0.
///
/// Fused means that ±a·b is not rounded in `f32` lanes; in `f64` every product and every sum is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Op {
    /// a + b
    Add,
    /// a − b
    Sub,
    /// a·b
    Mul,
    /// a / b
    Div,
    /// −a
    Neg,
    /// 1 / a
    Recip,
    /// √a
    Sqrt,
    /// Two results: sin a, cos a.
    SinCos,
    /// eᵃ
    Exp,
    /// ln a
    Ln,
    /// tanh a
    Tanh,
    /// The angle of the point (b, a).
    Atan2,
    /// a·b + c, fused.
    MulAdd,
    /// c − a·b, fused.
    NegMulAdd,
    /// a·b − c, fused.
    MulSub,
    /// a·b + c·d, where a·b is fused and c·d rounded.
    TwoProducts,
    /// c·d − a·b, where a·b is fused and c·d rounded.
    ProductDifference,
    /// Whether a < b.
    Less,
    /// Whether both truth values hold.
    And,
    /// Whether one of the truth values holds.
    Or,
    /// Whether the truth value does not hold.
    Not,
    /// a where the truth value c holds, else b.
    Select,
    /// c where a < b, else d.
    SelectLess,
}

impl Op {
    /// Every one.
    pub const ALL: [Self; 23] = {
        use Op::*;
        [
            Add,
            Sub,
            Mul,
            Div,
            Neg,
            Recip,
            Sqrt,
            SinCos,
            Exp,
            Ln,
            Tanh,
            Atan2,
            MulAdd,
            NegMulAdd,
            MulSub,
            TwoProducts,
            ProductDifference,
            Less,
            And,
            Or,
            Not,
            Select,
            SelectLess,
        ]
    };

    /// How many operands it reads.
    #[inline(always)]
    pub const fn n_operand(self) -> usize {
        match self {
            Op::Neg | Op::Recip | Op::Sqrt | Op::SinCos | Op::Exp | Op::Ln | Op::Tanh | Op::Not => 1,
            Op::Add | Op::Sub | Op::Mul | Op::Div | Op::Atan2 | Op::Less | Op::And | Op::Or => 2,
            Op::MulAdd | Op::NegMulAdd | Op::MulSub | Op::Select => 3,
            Op::TwoProducts | Op::ProductDifference | Op::SelectLess => 4,
        }
    }

    /// How many results it has.
    pub const fn n_result(self) -> usize {
        if matches!(self, Op::SinCos) { 2 } else { 1 }
    }

    /// Whether it is a sum of products: ±a·b + c·d for some of them constant.
    pub(super) const fn is_sum(self) -> bool {
        use Op::*;
        matches!(self, Add | Sub | Mul | Neg | MulAdd | NegMulAdd | MulSub | TwoProducts | ProductDifference)
    }
}

/// A number of a [`ValueForm`], by its place: inputs first, then constants, then results of instructions in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Value(pub(crate) u32);

impl Value {
    /// Its place.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// Where a [`Value`] comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Source {
    /// The input of this number.
    Input(usize),
    /// A constant.
    Constant(f64),
    /// An instruction.
    Computed,
}

/// What makes values of values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum InstructionKind {
    /// An operation on the first [`n_operand`](Op::n_operand) of these.
    Op(Op, [Value; 4]),
    /// The call of this number, see [`ValueForm::calls`].
    Call(usize),
}

/// An instruction: an action and the first of its results, which follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Instruction {
    /// What it does.
    pub action: InstructionKind,
    /// Its first result.
    pub first: Value,
}

/// What a call calls.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Callee {
    /// A custom function.
    Custom(Operation),
    /// A recorded function, with fusions decided inside.
    Function(Arc<ValueForm>),
}

/// Of a function, by its size alone: it is called many times, and hashed with each of its calls.
impl Hash for Callee {
    fn hash<H: Hasher>(&self, state: &mut H) {
        match self {
            Self::Custom(operation) => operation.hash(state),
            Self::Function(form) => (form.n_input, form.n_value, form.results.len()).hash(state),
        }
    }
}

impl Callee {
    /// How many results it has.
    pub fn n_output(&self) -> usize {
        match self {
            Self::Custom(operation) => operation.n_output(),
            Self::Function(form) => form.results.len(),
        }
    }
}

/// A function of values.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct CallOf {
    /// The function.
    pub callee: Callee,
    /// Its arguments.
    pub operands: Vec<Value>,
}

/// A program as read-only values.
///
/// ```
/// # use omnidrones_autodiff::omnidrones;
/// use omnidrones::autodiff::{Program, Recording, Scalar};
///
/// let recording = Recording::of(3, |z| vec![z[0] * z[1] + z[2].sqrt(), z[2]]);
/// let program = Program::compile(&recording)?;
/// assert_eq!(
///     program.value_form().to_string(),
///     "3 inputs: v0 to v2\n\
///      v3 = sqrt v2\n\
///      v4 = v0·v1 + v3\n\
///      results: v4, v2\n",
/// );
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct ValueForm {
    pub(crate) n_input: usize,
    /// Bits of each.
    pub(crate) constants: Vec<u64>,
    pub(crate) instructions: Vec<Instruction>,
    pub(crate) calls: Vec<CallOf>,
    pub(crate) results: Vec<Value>,
    /// Inputs, constants and results of instructions.
    pub(crate) n_value: usize,
    pub(crate) tape: Tape,
}

/// Numbers that a function keeps for its adjoint, or that an adjoint has from its function: the last of the inputs or of the results.
/// Back ends leave them where they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub(crate) enum Tape {
    #[default]
    None,
    Inputs(usize),
    Results(usize),
}

impl Tape {
    pub(crate) fn n_input(self) -> usize {
        if let Self::Inputs(n) = self { n } else { 0 }
    }
    pub(crate) fn n_result(self) -> usize {
        if let Self::Results(n) = self { n } else { 0 }
    }
}

impl ValueForm {
    /// Of a recording.
    #[doc(hidden)]
    pub fn of(recording: &Recording) -> Self {
        Planner::new(&recording.attached()).run()
    }

    /// Number of inputs.
    pub fn n_input(&self) -> usize {
        self.n_input
    }

    /// Number of values: inputs, constants, results of instructions.
    pub fn n_value(&self) -> usize {
        self.n_value
    }

    /// The constants, which follow the inputs.
    pub fn constants(&self) -> impl ExactSizeIterator<Item = f64> + '_ {
        self.constants.iter().map(|bits| f64::from_bits(*bits))
    }

    /// In an order in which they can be run.
    pub fn instructions(&self) -> &[Instruction] {
        &self.instructions
    }

    /// Functions with their arguments, by the numbers that [`InstructionKind::Call`] has.
    pub fn calls(&self) -> &[CallOf] {
        &self.calls
    }

    /// The results of the program.
    pub fn results(&self) -> &[Value] {
        &self.results
    }

    /// Where a value comes from.
    pub fn source(&self, value: Value) -> Source {
        match value.index() {
            k if k < self.n_input => Source::Input(k),
            k => self
                .constants
                .get(k - self.n_input)
                .map_or(Source::Computed, |bits| Source::Constant(f64::from_bits(*bits))),
        }
    }

    /// What an instruction reads.
    pub fn operands<'a>(&'a self, instruction: &'a Instruction) -> &'a [Value] {
        match &instruction.action {
            InstructionKind::Op(op, operands) => &operands[..op.n_operand()],
            InstructionKind::Call(number) => &self.calls[*number].operands,
        }
    }

    /// How many results an instruction has.
    pub fn n_result_of(&self, instruction: &Instruction) -> usize {
        match instruction.action {
            InstructionKind::Op(op, _) => op.n_result(),
            InstructionKind::Call(number) => self.calls[number].callee.n_output(),
        }
    }

    /// The first value behind inputs and constants.
    pub(crate) fn first_computed(&self) -> usize {
        self.n_input + self.constants.len()
    }

    /// Names `n` values that are made next; returns the first.
    pub(crate) fn next(&mut self, n: u32) -> Value {
        let first = Value(self.n_value as u32);
        self.n_value += n as usize;
        first
    }

    /// Per value, which instruction reads it last; [`usize::MAX`] for results of the program, 0 where nobody does.
    pub(crate) fn last_uses(&self, order: &[u32]) -> Vec<usize> {
        let mut last = vec![0; self.n_value];
        for (time, number) in order.iter().enumerate() {
            for operand in self.operands(&self.instructions[*number as usize]) {
                last[operand.index()] = time;
            }
        }
        self.results.iter().for_each(|result| last[result.index()] = usize::MAX);
        last
    }

    /// Cuts the program in two: what depends on none of the inputs `seeds`, and the rest.
    ///
    /// An adjoint is cut so at its seeds: the first part goes forward with the function, the second runs backwards later.
    ///
    /// # Panics
    /// If `seeds` ends behind the inputs.
    pub fn split(&self, seeds: Range<usize>) -> Split {
        assert!(seeds.end <= self.n_input, "seeds among {} inputs", self.n_input);
        let mut is_late: Vec<bool> = (0..self.n_value).map(|k| seeds.contains(&k)).collect();
        for instruction in &self.instructions {
            let late = self.operands(instruction).iter().any(|operand| is_late[operand.index()]);
            let first = instruction.first.index();
            is_late[first..first + self.n_result_of(instruction)].fill(late);
        }
        let (late, early): (Vec<_>, Vec<_>) = self.instructions.iter().copied().partition(|i| is_late[i.first.index()]);
        let mut carried: Vec<Value> = Vec::new();
        let mut is_carried = vec![false; self.n_value];
        let late_reads = late.iter().flat_map(|instruction| self.operands(instruction));
        for value in late_reads.chain(&self.results).copied() {
            let k = value.index();
            if k >= self.first_computed() && !is_late[k] && !std::mem::replace(&mut is_carried[k], true) {
                carried.push(value);
            }
        }
        let before = self.part(&early, &[], &carried);
        let after = self.part(&late, &carried, &self.results);
        Split { before, after, n_carried: carried.len() }
    }

    /// Some of the instructions as a program of their own, with `given` values as further inputs.
    pub(crate) fn part(&self, instructions: &[Instruction], given: &[Value], results: &[Value]) -> Self {
        let mut place: Vec<Value> = (0..self.n_value as u32).map(Value).collect();
        let n_input = self.n_input + given.len();
        place[self.n_input..self.first_computed()].iter_mut().for_each(|value| value.0 += given.len() as u32);
        for (value, number) in given.iter().zip(self.n_input..) {
            place[value.index()] = Value(number as u32);
        }
        let mut part = Self {
            n_input,
            constants: self.constants.clone(),
            instructions: Vec::new(),
            calls: Vec::new(),
            results: Vec::new(),
            n_value: n_input + self.constants.len(),
            tape: Tape::None,
        };
        for instruction in instructions {
            let action = match instruction.action {
                InstructionKind::Op(op, operands) => {
                    InstructionKind::Op(op, operands.map(|value| place[value.index()]))
                }
                InstructionKind::Call(number) => {
                    let CallOf { callee, operands } = &self.calls[number];
                    let operands = operands.iter().map(|value| place[value.index()]).collect();
                    part.calls.push(CallOf { callee: callee.clone(), operands });
                    InstructionKind::Call(part.calls.len() - 1)
                }
            };
            let n_result = self.n_result_of(instruction);
            let first = part.next(n_result as u32);
            for k in 0..n_result {
                place[instruction.first.index() + k] = Value(first.0 + k as u32);
            }
            part.instructions.push(Instruction { action, first });
        }
        part.results = results.iter().map(|value| place[value.index()]).collect();
        part
    }
}

/// A program in two parts, see [`ValueForm::split`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Split {
    /// What depends on no seed: of all inputs, the numbers carried over.
    pub before: ValueForm,
    /// The rest: of all inputs and behind them the numbers carried over, the results of the whole.
    pub after: ValueForm,
    /// How many numbers are carried over.
    pub n_carried: usize,
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "v{}", self.0)
    }
}

/// Values with commas between them.
struct Listed<'a>(&'a ValueForm, &'a [Value]);

impl fmt::Display for Listed<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (k, value) in self.1.iter().enumerate() {
            write!(f, "{}{}", if k > 0 { ", " } else { "" }, Named(self.0, *value))?;
        }
        Ok(())
    }
}

/// A constant by its number, another value by its name.
struct Named<'a>(&'a ValueForm, Value);

impl fmt::Display for Named<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0.source(self.1) {
            Source::Constant(number) if number.is_sign_negative() => write!(f, "({number:?})"),
            Source::Constant(number) => write!(f, "{number:?}"),
            _ => self.1.fmt(f),
        }
    }
}

/// One instruction a line, as one would write it by hand; behind the program, the functions that it calls.
impl fmt::Display for ValueForm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let functions = self.functions();
        self.fmt_alone(f, &functions)?;
        for (k, function) in functions.iter().enumerate() {
            write!(f, "\nfunction {k} of ")?;
            function.fmt_alone(f, &functions)?;
        }
        Ok(())
    }
}

impl ValueForm {
    /// Recorded functions that are called, also by each other, callers first; each once.
    pub fn functions(&self) -> Vec<Arc<Self>> {
        let mut found: Vec<Arc<Self>> = Vec::new();
        let mut done = HashSet::new();
        self.add_functions(&mut found, &mut done);
        found.reverse();
        found
    }

    /// Appends functions behind those that they call.
    fn add_functions(&self, found: &mut Vec<Arc<Self>>, done: &mut HashSet<*const Self>) {
        for call in &self.calls {
            if let Callee::Function(form) = &call.callee
                && done.insert(Arc::as_ptr(form))
            {
                form.add_functions(found, done);
                found.push(form.clone());
            }
        }
    }

    fn fmt_alone(&self, f: &mut fmt::Formatter<'_>, functions: &[Arc<Self>]) -> fmt::Result {
        match self.n_input {
            0 => writeln!(f, "no inputs")?,
            1 => writeln!(f, "1 input: v0")?,
            n => writeln!(f, "{n} inputs: v0 to v{}", n - 1)?,
        }
        for instruction in &self.instructions {
            let first = instruction.first;
            match instruction.action {
                InstructionKind::Op(op, operands) => self.fmt_op(f, op, operands, first)?,
                InstructionKind::Call(number) => {
                    let (call, n) = (&self.calls[number], self.n_result_of(instruction) as u32);
                    let arguments = Listed(self, &call.operands);
                    let called = match &call.callee {
                        Callee::Custom(_) => format!("call {number} ({arguments})"),
                        Callee::Function(form) => {
                            let own = functions.iter().position(|function| Arc::ptr_eq(function, form));
                            format!("function {} ({arguments})", own.unwrap_or(functions.len()))
                        }
                    };
                    match n {
                        0 => writeln!(f, "{called}")?,
                        1 => writeln!(f, "{first} = {called}")?,
                        n => writeln!(f, "{first} to {} = {called}", Value(first.0 + n - 1))?,
                    }
                }
            }
        }
        writeln!(f, "results: {}", Listed(self, &self.results))
    }
}

impl ValueForm {
    fn fmt_op(&self, f: &mut fmt::Formatter<'_>, op: Op, operands: [Value; 4], first: Value) -> fmt::Result {
        let [a, b, c, d] = operands.map(|value| Named(self, value));
        match op {
            Op::SinCos => writeln!(f, "{first}, {} = sin and cos {a}", Value(first.0 + 1)),
            Op::Add => writeln!(f, "{first} = {a} + {b}"),
            Op::Sub => writeln!(f, "{first} = {a} − {b}"),
            Op::Mul => writeln!(f, "{first} = {a}·{b}"),
            Op::Div => writeln!(f, "{first} = {a} / {b}"),
            Op::Neg => writeln!(f, "{first} = −{a}"),
            Op::Recip => writeln!(f, "{first} = 1 / {a}"),
            Op::Sqrt => writeln!(f, "{first} = sqrt {a}"),
            Op::Exp => writeln!(f, "{first} = exp {a}"),
            Op::Ln => writeln!(f, "{first} = ln {a}"),
            Op::Tanh => writeln!(f, "{first} = tanh {a}"),
            Op::Atan2 => writeln!(f, "{first} = atan2({a}, {b})"),
            Op::MulAdd => writeln!(f, "{first} = {a}·{b} + {c}"),
            Op::NegMulAdd => writeln!(f, "{first} = {c} − {a}·{b}"),
            Op::MulSub => writeln!(f, "{first} = {a}·{b} − {c}"),
            Op::TwoProducts => writeln!(f, "{first} = {a}·{b} + {c}·{d}"),
            Op::ProductDifference => writeln!(f, "{first} = {c}·{d} − {a}·{b}"),
            Op::Less => writeln!(f, "{first} = {a} < {b}"),
            Op::And => writeln!(f, "{first} = {a} and {b}"),
            Op::Or => writeln!(f, "{first} = {a} or {b}"),
            Op::Not => writeln!(f, "{first} = not {a}"),
            Op::Select => writeln!(f, "{first} = {a} where {c}, else {b}"),
            Op::SelectLess => writeln!(f, "{first} = {c} where {a} < {b}, else {d}"),
        }
    }
}
