//! C99 of recorded functions: no heap, no globals that change, no jump but calls.
//!
//! Numbers of a function have places by liveness, so that its stack is known; results are written when all is computed, so that arrays
//! may be the same. Recorded functions of a recording are functions of the text, also where two recordings call the same one.

use super::elementary::Elementary;
use super::function::{Access, ExportPrecision, NamedArray, NamedFunction};
use crate::program::{CallOf, Callee, Instruction, InstructionKind, Op, Program, Source, Value, ValueForm};
use base::error::{Error, Result};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::sync::Arc;

/// Longest line of text, but for comments of callers.
const WIDTH: usize = 110;

/// Bytes of a frame beside its numbers: return address, saved registers, alignment.
const FRAME: usize = 96;

/// Bytes of a pointer to an array: a place of its own without optimisation, and another one where it is passed in memory.
const POINTER: usize = 16;

/// Arrays of fewer bytes have a place each without optimisation; larger ones share theirs.
const SHARES: usize = 32;

/// Bytes to which places of arrays are rounded up.
const ALIGNED: usize = 16;

/// Who sees a function.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Linkage {
    /// Callers of the text.
    Public,
    /// The text alone.
    Static,
}

/// A function of the text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CFunction {
    /// Its name.
    pub name: String,
    /// `void name(const float state[17], float next[17])`.
    pub prototype: String,
    /// Bytes of stack of a call at most, with all that it calls but libm: from above, for compilers like those it was held against.
    pub stack: usize,
    /// Instructions of a call, with those of what it calls; a loop that ends early counts once.
    pub n_instruction: usize,
    /// Instructions of a call at most.
    pub n_most: usize,
}

/// Definitions of one file, callees first.
#[derive(Debug)]
pub struct CText {
    prefix: String,
    precision: ExportPrecision,
    needed: BTreeSet<Elementary>,
    parts: Vec<(Arc<ValueForm>, CFunction)>,
    n_name: usize,
    definitions: String,
}

/// A number as C reads it.
pub fn literal(x: f64, precision: ExportPrecision) -> String {
    let cast = if precision == ExportPrecision::Double { "(double)" } else { "" };
    match (x, precision) {
        (x, _) if x.is_nan() => format!("{cast}NAN"),
        (x, _) if x.is_infinite() => format!("{}{cast}INFINITY", if x < 0.0 { "-" } else { "" }),
        (x, ExportPrecision::Double) => format!("{x:?}"),
        (x, ExportPrecision::Single) if (x as f32).is_infinite() => literal(x * f64::INFINITY, precision),
        (x, ExportPrecision::Single) => format!("{:?}f", x as f32),
    }
}

/// `literal`, within an expression.
fn operand(x: f64, precision: ExportPrecision) -> String {
    let text = literal(x, precision);
    if x.is_sign_negative() { format!("({text})") } else { text }
}

impl CText {
    /// Of functions whose names begin with `prefix`.
    pub fn new(prefix: impl Into<String>, precision: ExportPrecision) -> Self {
        Self {
            prefix: prefix.into(),
            precision,
            needed: BTreeSet::new(),
            parts: Vec::new(),
            n_name: 0,
            definitions: String::new(),
        }
    }

    /// Of its numbers.
    pub fn precision(&self) -> ExportPrecision {
        self.precision
    }

    /// What the names of its functions begin with.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Asks for an elementary function; its name in this text.
    pub fn need(&mut self, function: Elementary) -> String {
        self.needed.insert(function);
        function.name(&self.prefix)
    }

    /// Adds definitions as they are; they stand behind all that was added before.
    pub fn add(&mut self, definitions: &str) {
        self.separate();
        self.definitions += definitions;
    }

    fn separate(&mut self) {
        if !self.definitions.is_empty() {
            self.definitions.push('\n');
        }
    }

    /// Adds a function, with what it calls.
    ///
    /// # Errors
    /// [`Error::Value`] for a custom function without C text; [`Error::Limit`] for a recording that is too large.
    pub fn function(&mut self, of: &NamedFunction, linkage: Linkage) -> Result<CFunction> {
        let form = Program::text_form(&of.recording)?;
        let name = format!("{}_{}", self.prefix, of.name);
        let storage = if linkage == Linkage::Static { "static " } else { "" };
        let prototype = format!("{storage}void {name}({})", parameters(&of.arrays, self.precision));
        self.defined(&form, Arrays::Named(&of.arrays), name, prototype)
    }

    /// A function that recordings share.
    pub(super) fn part(&mut self, form: &Arc<ValueForm>) -> Result<CFunction> {
        if let Some((_, known)) = self.parts.iter().find(|(own, _)| Arc::ptr_eq(own, form) || own == form) {
            return Ok(known.clone());
        }
        let (name, real) = (self.new_name("part"), self.precision.c_type());
        let prototype = format!("static void {name}(const {real} *x, {real} *y)");
        let own = self.defined(form, Arrays::Numbered, name, prototype)?;
        self.parts.push((form.clone(), own.clone()));
        Ok(own)
    }

    fn new_name(&mut self, kind: &str) -> String {
        self.n_name += 1;
        format!("{}_{kind}_{}", self.prefix, self.n_name)
    }

    fn defined(&mut self, form: &ValueForm, arrays: Arrays<'_>, name: String, prototype: String) -> Result<CFunction> {
        let body = Body::new(self, form, arrays)?;
        let (stack, n_instruction, n_most) = (body.stack(), body.n_instruction, body.n_most);
        let text = format!("{prototype}\n{{\n{}}}\n", body.finished());
        self.add(&text);
        Ok(CFunction { name, prototype, stack, n_instruction, n_most })
    }

    /// A custom function with some of its arguments known.
    fn custom(&mut self, call: &CallOf, known: &[Option<f64>]) -> Result<CFunction> {
        let Callee::Custom(operation) = &call.callee else { unreachable!("a custom function") };
        let name = self.new_name("custom");
        operation.function().c_function(self, &name, known)?.ok_or_else(|| {
            let what = format!("custom function of {} numbers", operation.n_input());
            let remedy = "Implement CustomFunction::c_function for it, or leave out what calls it.";
            Error::value(what, "without C text", "one that says how it is written in C", remedy)
        })
    }

    /// The whole file behind its includes.
    pub fn finished(self) -> String {
        let mut text = String::new();
        for function in Elementary::with_needs(self.needed.into_iter(), self.precision) {
            let own = function.text(&self.prefix, self.precision);
            if !own.is_empty() {
                text += &own;
                text.push('\n');
            }
        }
        text + &self.definitions
    }
}

/// `const float state[17], float next[17]`.
fn parameters(arrays: &[NamedArray], precision: ExportPrecision) -> String {
    let real = precision.c_type();
    let own = arrays.iter().filter(|array| !array.numbers.is_empty()).map(|array| {
        let constant = if array.access == Access::Read { "const " } else { "" };
        format!("{constant}{real} {}[{}]", array.name, array.numbers.len())
    });
    let own: Vec<String> = own.collect();
    if own.is_empty() { "void".into() } else { own.join(", ") }
}

/// Where inputs are read and results written.
#[derive(Clone, Copy)]
enum Arrays<'a> {
    Named(&'a [NamedArray]),
    /// `x` and `y`.
    Numbered,
}

impl Arrays<'_> {
    fn places(self, reads: bool, n: usize) -> Vec<String> {
        let arrays = match self {
            Self::Numbered => return (0..n).map(|k| format!("{}[{k}]", if reads { 'x' } else { 'y' })).collect(),
            Self::Named(arrays) => arrays,
        };
        let left_out = if reads { Access::Write } else { Access::Read };
        let own = arrays.iter().filter(|array| array.access != left_out);
        own.flat_map(|array| (0..array.numbers.len()).map(move |k| format!("{}[{k}]", array.name))).collect()
    }

    /// Pointers that a call passes.
    fn n(self) -> usize {
        match self {
            Self::Numbered => 2,
            Self::Named(arrays) => arrays.iter().filter(|array| !array.numbers.is_empty()).count(),
        }
    }

    /// Names of arrays, in which a function might be interested or not.
    fn read_names(self) -> Vec<String> {
        match self {
            Self::Numbered => vec!["x".into()],
            Self::Named(arrays) => {
                let own = arrays.iter().filter(|array| array.access == Access::Read && !array.numbers.is_empty());
                own.map(|array| array.name.clone()).collect()
            }
        }
    }
}

/// Statements of a function.
struct Body<'a> {
    form: &'a ValueForm,
    precision: ExportPrecision,
    arrays: Arrays<'a>,
    inputs: Vec<String>,
    results: Vec<String>,
    last_use: Vec<usize>,
    /// Of computed values that are alive.
    slots: Vec<u32>,
    free: Vec<u32>,
    n_slot: u32,
    is_read: Vec<bool>,
    /// Of the deepest call, with its arguments and results.
    below: usize,
    /// Of arrays of all calls that share no place.
    apart: usize,
    n_instruction: usize,
    n_most: usize,
    statements: String,
}

impl<'a> Body<'a> {
    fn new(text: &mut CText, form: &'a ValueForm, arrays: Arrays<'a>) -> Result<Self> {
        let (inputs, results) = (arrays.places(true, form.n_input()), arrays.places(false, form.results().len()));
        assert_eq!((inputs.len(), results.len()), (form.n_input(), form.results().len()), "arrays of the function");
        let order: Vec<u32> = (0..form.instructions().len() as u32).collect();
        let mut own = Self {
            form,
            precision: text.precision,
            arrays,
            inputs,
            results,
            last_use: form.last_uses(&order),
            slots: vec![0; form.n_value()],
            free: Vec::new(),
            n_slot: 0,
            is_read: vec![false; form.n_input()],
            below: 0,
            apart: 0,
            n_instruction: form.instructions().len(),
            n_most: form.instructions().len(),
            statements: String::new(),
        };
        for (time, instruction) in form.instructions().iter().enumerate() {
            match instruction.action {
                InstructionKind::Op(op, operands) => own.op(text, op, operands, instruction, time),
                InstructionKind::Call(number) => own.call(text, &form.calls()[number], instruction, time)?,
            }
        }
        own.write_results();
        Ok(own)
    }

    /// From above: numbers that are alive at once, more of them since compilers move instructions, and what else a frame holds.
    fn stack(&self) -> usize {
        let (numbers, of) = moved(self.precision);
        let alive = (most_alive(self.form, &self.last_use) * self.precision.bytes() * numbers).div_ceil(of);
        alive + self.apart + self.below + FRAME + POINTER * self.arrays.n()
    }

    /// An operand as an expression.
    fn read(&mut self, value: Value) -> String {
        match self.form.source(value) {
            Source::Input(k) => {
                self.is_read[k] = true;
                self.inputs[k].clone()
            }
            Source::Constant(x) => operand(x, self.precision),
            Source::Computed => format!("v{}", self.slots[value.index()]),
        }
    }

    /// Places of operands that are read for the last time are free again.
    fn release(&mut self, operands: &[Value], time: usize) {
        for (k, value) in operands.iter().enumerate() {
            let is_last = self.last_use[value.index()] == time && !operands[..k].contains(value);
            if is_last && self.form.source(*value) == Source::Computed {
                self.free.push(self.slots[value.index()]);
            }
        }
    }

    /// A place for a value that is computed now.
    fn place(&mut self, value: usize) -> u32 {
        let slot = self.free.pop().unwrap_or_else(|| {
            self.n_slot += 1;
            self.n_slot - 1
        });
        self.slots[value] = slot;
        slot
    }

    /// Results that nobody reads.
    fn forget_unread(&mut self, instruction: &Instruction) {
        let first = instruction.first.index();
        for value in first..first + self.form.n_result_of(instruction) {
            if self.last_use[value] == 0 {
                self.free.push(self.slots[value]);
            }
        }
    }

    fn op(&mut self, text: &mut CText, op: Op, operands: [Value; 4], instruction: &Instruction, time: usize) {
        let n = op.n_operand();
        let [a, b, c, d] = std::array::from_fn(|k| if k < n { self.read(operands[k]) } else { String::new() });
        self.release(&operands[..n], time);
        let first = instruction.first.index();
        let target = self.place(first);
        if op == Op::SinCos {
            let name = text.need(Elementary::SinCos);
            self.below = self.below.max(Elementary::SinCos.stack(self.precision));
            let cosine = self.place(first + 1);
            let _ = writeln!(self.statements, "    v{target} = {name}({a}, &v{cosine});");
        } else {
            let (expression, below) = self.expression(text, op, [&a, &b, &c, &d]);
            self.below = self.below.max(below);
            let _ = writeln!(self.statements, "    v{target} = {expression};");
        }
        self.forget_unread(instruction);
    }

    /// What it computes, and the bytes of stack of what it calls.
    fn expression(&self, text: &mut CText, op: Op, [a, b, c, d]: [&str; 4]) -> (String, usize) {
        let one = literal(1.0, self.precision);
        let mut below = 0;
        let mut call = |function: Elementary, arguments: &str| {
            below = function.stack(self.precision);
            format!("{}({arguments})", text.need(function))
        };
        let fuses = self.precision == ExportPrecision::Single;
        let fused = |text: &mut CText, a: String, c: String| format!("{}({a}, {b}, {c})", text.need(Elementary::Fma));
        let own = match op {
            Op::Add => format!("{a} + {b}"),
            Op::Sub => format!("{a} - {b}"),
            Op::Mul | Op::And => format!("{a} * {b}"),
            Op::Div => format!("{a} / {b}"),
            Op::Neg => format!("-{a}"),
            Op::Recip => format!("{one} / {a}"),
            Op::Sqrt => call(Elementary::Sqrt, a),
            Op::SinCos => String::new(), // has two results
            Op::Exp => call(Elementary::Exp, a),
            Op::Ln => call(Elementary::Ln, a),
            Op::Tanh => call(Elementary::Tanh, a),
            Op::Atan2 => call(Elementary::Atan2, &format!("{a}, {b}")),
            Op::MulAdd if fuses => fused(text, a.into(), c.into()),
            Op::NegMulAdd if fuses => fused(text, format!("-{a}"), c.into()),
            Op::MulSub if fuses => fused(text, a.into(), format!("-{c}")),
            Op::TwoProducts if fuses => fused(text, a.into(), format!("{c} * {d}")),
            Op::ProductDifference if fuses => fused(text, format!("-{a}"), format!("{c} * {d}")),
            Op::MulAdd => format!("{a} * {b} + {c}"),
            Op::NegMulAdd => format!("{c} - {a} * {b}"),
            Op::MulSub => format!("{a} * {b} - {c}"),
            Op::TwoProducts => format!("{a} * {b} + {c} * {d}"),
            Op::ProductDifference => format!("{c} * {d} - {a} * {b}"),
            Op::Less => format!("{a} < {b} ? {one} : {}", literal(0.0, self.precision)),
            Op::Or => format!("{a} < {b} ? {b} : {a}"),
            Op::Not => format!("{one} - {a}"),
            Op::Select => format!("{} < {c} ? {a} : {b}", literal(0.5, self.precision)),
            Op::SelectLess => format!("{a} < {b} ? {c} : {d}"),
        };
        (own, below)
    }

    fn call(&mut self, text: &mut CText, call: &CallOf, instruction: &Instruction, time: usize) -> Result<()> {
        let (callee, passed): (CFunction, Vec<Value>) = match &call.callee {
            Callee::Function(form) => (text.part(form)?, call.operands.clone()),
            Callee::Custom(_) => {
                let form = self.form;
                let known = |value: &Value| if let Source::Constant(x) = form.source(*value) { Some(x) } else { None };
                let all: Vec<Option<f64>> = call.operands.iter().map(known).collect();
                let open = call.operands.iter().copied().filter(|value| known(value).is_none());
                (text.custom(call, &all)?, open.collect())
            }
        };
        let arguments: Vec<String> = passed.iter().map(|value| self.read(*value)).collect();
        self.release(&call.operands, time);
        let (n, first) = (call.callee.n_output(), instruction.first.index());
        let real = self.precision.c_type();
        let mut lines = String::from("    {\n");
        let n_in = arguments.len().max(1);
        let _ = writeln!(lines, "        {real} in[{n_in}], out[{}];", n.max(1));
        // one by one: for a list compilers may call memcpy or memset
        if arguments.is_empty() {
            let _ = writeln!(lines, "        in[0] = {};", literal(0.0, self.precision));
        }
        for (k, own) in arguments.iter().enumerate() {
            let _ = writeln!(lines, "        in[{k}] = {};", bare(own));
        }
        let _ = writeln!(lines, "        {}(in, out);", callee.name);
        for k in 0..n {
            if self.last_use[first + k] == 0 {
                continue;
            }
            let target = self.place(first + k);
            let _ = writeln!(lines, "        v{target} = out[{k}];");
        }
        self.statements += &lines;
        self.statements += "    }\n";
        let mut passed = 0;
        for bytes in [n_in, n.max(1)].map(|n| (n * self.precision.bytes()).next_multiple_of(ALIGNED)) {
            *(if bytes < SHARES { &mut self.apart } else { &mut passed }) += bytes;
        }
        self.below = self.below.max(passed + callee.stack);
        self.n_instruction += callee.n_instruction;
        self.n_most += callee.n_most;
        Ok(())
    }

    /// Inputs that are results are read before anything is written, since arrays may be the same.
    fn write_results(&mut self) {
        let results: Vec<Value> = self.form.results().to_vec();
        let mut copies: Vec<(Value, u32)> = Vec::new();
        for value in &results {
            if let Source::Input(k) = self.form.source(*value)
                && !copies.iter().any(|(own, _)| own == value)
            {
                self.is_read[k] = true;
                let slot = self.place(value.index());
                let _ = writeln!(self.statements, "    v{slot} = {};", self.inputs[k]);
                copies.push((*value, slot));
            }
        }
        for (k, value) in results.iter().enumerate() {
            let own = match copies.iter().find(|(own, _)| own == value) {
                Some((_, slot)) => format!("v{slot}"),
                None => self.read(*value),
            };
            let _ = writeln!(self.statements, "    {} = {};", self.results[k], bare(&own));
        }
    }

    /// Declarations and statements.
    fn finished(self) -> String {
        let mut text = String::new();
        let names: Vec<String> = (0..self.n_slot).map(|k| format!("v{k}")).collect();
        if !names.is_empty() {
            wrapped(&mut text, &format!("    {} ", self.precision.c_type()), &names, ";");
        }
        for array in self.arrays.read_names() {
            let reads = format!("{array}[");
            let is_read = self.inputs.iter().zip(&self.is_read).any(|(own, read)| *read && own.starts_with(&reads));
            if !is_read {
                let _ = writeln!(text, "    (void){array};");
            }
        }
        text + &self.statements
    }
}

/// Numbers of which a frame has place for those that are alive at once: so many for so many. Compilers take what is computed to where it
/// is read, where it has more operands, and hold numbers beside each other in vectors. Of all that is built in, what calls no other
/// needs 2.6 at worst in `float` and 1.5 in `double`, of which a register holds half as many, with gcc 12 at -O2.
fn moved(precision: ExportPrecision) -> (usize, usize) {
    match precision {
        ExportPrecision::Single => (11, 4),
        ExportPrecision::Double => (7, 4),
    }
}

/// Numbers that are alive at once at most, in order: those that are computed until they are read for the last time, and inputs from
/// where they are read first, since a compiler need not read them twice.
fn most_alive(form: &ValueForm, last_use: &[usize]) -> usize {
    let n = form.instructions().len();
    let mut first = vec![None; form.n_value()];
    for (time, instruction) in form.instructions().iter().enumerate() {
        for value in form.operands(instruction) {
            first[value.index()].get_or_insert(time);
        }
        let own = instruction.first.index();
        first[own..own + form.n_result_of(instruction)].fill(Some(time));
    }
    for value in form.results() {
        first[value.index()].get_or_insert(n);
    }
    let mut change = vec![0_isize; n + 2];
    for (value, first) in first.iter().enumerate() {
        let Some(first) = *first else { continue };
        if matches!(form.source(Value(value as u32)), Source::Constant(_)) {
            continue;
        }
        change[first] += 1;
        change[last_use[value].clamp(first, n) + 1] -= 1;
    }
    let (_, most) = change.iter().fold((0, 0), |(now, most), change| (now + change, most.max(now + change)));
    most as usize
}

/// An expression without the parentheses that only operands need.
fn bare(own: &str) -> &str {
    own.strip_prefix('(').and_then(|own| own.strip_suffix(')')).unwrap_or(own)
}

/// `begin a, b, c end` over as many lines as it takes.
fn wrapped(text: &mut String, begin: &str, items: &[String], end: &str) {
    let mut line = begin.to_string();
    let indent = " ".repeat(begin.len() - begin.trim_start().len() + 4);
    for (k, item) in items.iter().enumerate() {
        let last = k + 1 == items.len();
        let own = format!("{item}{}", if last { end } else { "," });
        if line.len() + own.len() > WIDTH && !line.trim().is_empty() {
            text.push_str(line.trim_end());
            text.push('\n');
            line.clone_from(&indent);
        }
        line += &own;
        if !last {
            line.push(' ');
        }
    }
    text.push_str(&line);
    text.push('\n');
}

#[cfg(test)]
mod tests;
