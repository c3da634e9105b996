//! C99 of recorded functions: no heap, no globals that change, no jump but calls.
//!
//! Numbers of a function have places by liveness, so that its stack is known; results of arrays with names are written when all is computed,
//! so that arrays may be the same. Recorded functions of a recording are functions of the text, also where two recordings call the same one.

use super::cut::{Parts, parts};
use super::elementary::Elementary;
use super::function::{Access, ExportPrecision, NamedArray, NamedFunction};
use crate::program::{CallOf, Callee, Instruction, InstructionKind, Op, Program, Source, Tape, Value, ValueForm};
use base::error::{Error, Result};
use std::collections::{BTreeSet, HashMap};
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

/// Instructions from which on a function of a device's text is called, and not put where its calls stand: shorter ones cost more in what
/// is carried over a call than in length.
const LONG: usize = 500;

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

/// Who reads a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dialect {
    /// Compilers of C99.
    C99,
    /// Those of CUDA, and of C++ behind definitions of what CUDA has built in.
    Cuda,
}

impl Dialect {
    /// What stands before a function, or a table, that the text alone sees.
    pub fn own(self) -> &'static str {
        match self {
            Self::C99 => "static ",
            Self::Cuda => "static __device__ ",
        }
    }
}

/// Definitions of one file, callees first.
#[derive(Debug)]
pub struct CText {
    prefix: String,
    precision: ExportPrecision,
    dialect: Dialect,
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
    /// C99 of functions whose names begin with `prefix`.
    pub fn new(prefix: impl Into<String>, precision: ExportPrecision) -> Self {
        Self::of(prefix.into(), precision, Dialect::C99)
    }

    /// CUDA of functions whose names begin with `prefix`, in `float`.
    pub fn cuda(prefix: impl Into<String>) -> Self {
        Self::of(prefix.into(), ExportPrecision::Single, Dialect::Cuda)
    }

    fn of(prefix: String, precision: ExportPrecision, dialect: Dialect) -> Self {
        Self {
            prefix,
            precision,
            dialect,
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

    /// Who reads it.
    pub fn dialect(&self) -> Dialect {
        self.dialect
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
        let storage = if linkage == Linkage::Static { self.dialect.own() } else { "" };
        let prototype = format!("{storage}void {name}({})", parameters(&of.arrays, self.precision));
        self.defined(&form, Arrays::Named(&of.arrays), name, prototype)
    }

    /// Adds a program as a function whose inputs and results are these expressions of its parameters, in order. A result may lie where an
    /// input does.
    ///
    /// # Errors
    /// As [`CText::function`].
    ///
    /// # Panics
    /// For another number of inputs or results than the program has.
    pub fn function_over(
        &mut self,
        program: &Program,
        name: &str,
        parameters: &str,
        [inputs, results]: [Vec<String>; 2],
    ) -> Result<CFunction> {
        let form = program.as_text();
        let name = format!("{}_{name}", self.prefix);
        let prototype = format!("{}void {name}({parameters})", self.dialect.own());
        match parts(&form, &inputs, &results).filter(|_| self.dialect == Dialect::Cuda) {
            None => self.defined(&form, Arrays::Places(&inputs, &results), name, prototype),
            Some(parts) => self.defined_in_parts(parts, name, prototype, parameters),
        }
    }

    /// A function that calls its parts, one behind the other.
    fn defined_in_parts(&mut self, cut: Parts, name: String, prototype: String, parameters: &str) -> Result<CFunction> {
        let real = self.precision.c_type();
        let word = |c: char| !(c.is_alphanumeric() || c == '_');
        let names: Vec<&str> = parameters.split(',').filter_map(|own| own.rsplit(word).next()).collect();
        let mut body = format!("    {real} m[{}];\n", cut.n_between.max(1));
        let mut all =
            CFunction { name: name.clone(), prototype: prototype.clone(), stack: 0, n_instruction: 0, n_most: 0 };
        for (part, number) in cut.parts.iter().zip(1..) {
            let own = format!("{name}_{number}");
            let storage = format!("{}__noinline__ ", self.dialect.own());
            let head = format!("{storage}void {own}({parameters}, {real} *m)");
            let [inputs, results] = &part.places;
            let done = self.defined(&part.form, Arrays::Places(inputs, results), own.clone(), head)?;
            body += &format!("    {own}({}, m);\n", names.join(", "));
            all.stack = all.stack.max(done.stack);
            all.n_instruction += done.n_instruction;
            all.n_most += done.n_most;
        }
        self.add(&format!("{prototype}\n{{\n{body}}}\n"));
        Ok(all)
    }

    /// A function that recordings share.
    pub(super) fn part(&mut self, form: &Arc<ValueForm>) -> Result<CFunction> {
        if let Some((_, known)) = self.parts.iter().find(|(own, _)| Arc::ptr_eq(own, form) || own == form) {
            return Ok(known.clone());
        }
        let (name, real) = (self.new_name("part"), self.precision.c_type());
        let tape = match if self.dialect == Dialect::Cuda { form.tape } else { Tape::None } {
            Tape::None => String::new(),
            Tape::Inputs(_) => format!(", const {real} *tape"),
            Tape::Results(_) => format!(", {real} *tape"),
        };
        let prototype = format!("{}void {name}(const {real} *x, {real} *y{tape})", self.part_storage(form));
        let own = self.defined(form, Arrays::Numbered { is_taped: !tape.is_empty() }, name, prototype)?;
        self.parts.push((form.clone(), own.clone()));
        Ok(own)
    }

    /// What is long stays a function on a device: registers are given out for each alone, and no compiler has to see through all calls.
    fn part_storage(&self, form: &ValueForm) -> String {
        let kept =
            if self.dialect == Dialect::Cuda && form.instructions().len() >= LONG { "__noinline__ " } else { "" };
        format!("{}{kept}", self.dialect.own())
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
            let own = function.text(&self.prefix, self.precision, self.dialect);
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
    /// `x` and `y`, and `tape` for the last of one of them.
    Numbered {
        is_taped: bool,
    },
    /// These expressions.
    Places(&'a [String], &'a [String]),
}

impl Arrays<'_> {
    fn places(self, reads: bool, form: &ValueForm) -> Vec<String> {
        let arrays = match self {
            Self::Numbered { is_taped } => {
                let (array, n, n_tape) = if reads {
                    ("x", form.n_input(), form.tape.n_input())
                } else {
                    ("y", form.results().len(), form.tape.n_result())
                };
                let n_passed = n - if is_taped { n_tape } else { 0 };
                let own = (0..n_passed).map(|k| format!("{array}[{k}]"));
                return own.chain((0..n - n_passed).map(|k| format!("tape[{k}]"))).collect();
            }
            Self::Places(inputs, results) => return if reads { inputs } else { results }.to_vec(),
            Self::Named(arrays) => arrays,
        };
        let left_out = if reads { Access::Write } else { Access::Read };
        let own = arrays.iter().filter(|array| array.access != left_out);
        own.flat_map(|array| (0..array.numbers.len()).map(move |k| format!("{}[{k}]", array.name))).collect()
    }

    /// Pointers that a call passes.
    fn n(self) -> usize {
        match self {
            Self::Numbered { .. } | Self::Places(..) => 2,
            Self::Named(arrays) => arrays.iter().filter(|array| !array.numbers.is_empty()).count(),
        }
    }

    /// Names of arrays, in which a function might be interested or not.
    fn read_names(self) -> Vec<String> {
        match self {
            Self::Numbered { .. } => vec!["x".into()],
            Self::Places(..) => Vec::new(),
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
    is_of_device: bool,
    writes_early: bool,
    /// Most numbers that calls are passed.
    n_passed: usize,
    /// Where calls left what they computed.
    left: HashMap<usize, String>,
    /// Of results.
    is_written: Vec<bool>,
    /// The inputs whose places results are written to.
    covered: Vec<Option<usize>>,
    /// Which results a value is.
    results_of: HashMap<usize, Vec<usize>>,
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
        let (inputs, results) = (arrays.places(true, form), arrays.places(false, form));
        assert_eq!((inputs.len(), results.len()), (form.n_input(), form.results().len()), "arrays of the function");
        let order: Vec<u32> = (0..form.instructions().len() as u32).collect();
        let places: HashMap<&String, usize> = inputs.iter().zip(0..).collect();
        let mut results_of: HashMap<usize, Vec<usize>> = HashMap::new();
        form.results().iter().zip(0..).for_each(|(value, k)| results_of.entry(value.index()).or_default().push(k));
        let mut own = Self {
            is_of_device: text.dialect == Dialect::Cuda,
            // arrays with names may be the same ones
            writes_early: text.dialect == Dialect::Cuda && !matches!(arrays, Arrays::Named(_)),
            left: HashMap::new(),
            n_passed: 0,
            covered: results.iter().map(|place| places.get(place).copied()).collect(),
            results_of,
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
            is_written: vec![false; form.results().len()],
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
            own.write_early(instruction, time);
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
                let is_first = !std::mem::replace(&mut self.is_read[k], true);
                if !matches!(self.arrays, Arrays::Places(..)) {
                    return self.inputs[k].clone();
                }
                // once, where it is read first: who calls a function must believe that it changes all memory
                if is_first {
                    let _ =
                        writeln!(self.statements, "    const {} x{k} = {};", self.precision.c_type(), self.inputs[k]);
                }
                format!("x{k}")
            }
            Source::Constant(x) => operand(x, self.precision),
            Source::Computed => self.computed(value.index()),
        }
    }

    fn computed(&self, value: usize) -> String {
        self.left.get(&value).cloned().unwrap_or_else(|| format!("v{}", self.slots[value]))
    }

    /// Places of operands that are read for the last time are free again.
    fn release(&mut self, operands: &[Value], time: usize) {
        for (k, value) in operands.iter().enumerate() {
            let is_last = self.last_use[value.index()] == time && !operands[..k].contains(value);
            let is_own = self.form.source(*value) == Source::Computed && !self.left.contains_key(&value.index());
            if is_last && is_own {
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
            if self.last_use[value] == 0 && !self.left.contains_key(&value) {
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
        if self.is_of_device {
            return self.call_of_device(call, &callee, &passed, instruction, time);
        }
        let arguments: Vec<String> = passed.iter().map(|value| self.read(*value)).collect();
        self.release(&call.operands, time);
        let (n, first) = (call.callee.n_output(), instruction.first.index());
        let real = self.precision.c_type();
        let n_in = arguments.len().max(1);
        let mut lines = String::from("    {\n");
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

    /// On a device numbers stay where the function left them until they are read, since there are no registers for all; and a tape, from
    /// the function that wrote it to its adjoint, stays where it is.
    fn call_of_device(
        &mut self,
        call: &CallOf,
        callee: &CFunction,
        passed: &[Value],
        instruction: &Instruction,
        time: usize,
    ) -> Result<()> {
        let form = if let Callee::Function(form) = &call.callee { Some(form) } else { None };
        let tape = form.map_or(Tape::None, |form| form.tape);
        let (plain, taped) = passed.split_at(passed.len() - tape.n_input());
        for (k, value) in plain.iter().enumerate() {
            let own = self.read(*value);
            let _ = writeln!(self.statements, "    in[{k}] = {};", bare(&own));
        }
        self.n_passed = self.n_passed.max(plain.len());
        let (n, first, real) = (call.callee.n_output(), instruction.first.index(), self.precision.c_type());
        let n_own = n - tape.n_result();
        let _ = writeln!(self.statements, "    {real} out{time}[{}];", n_own.max(1));
        let tape = match tape {
            Tape::None => String::new(),
            Tape::Results(n) => match self.wanted_in_order(first + n_own, n) {
                Some(place) => format!(", {place}"),
                None => {
                    let _ = writeln!(self.statements, "    {real} tape{time}[{}];", n.max(1));
                    format!(", tape{time}")
                }
            },
            Tape::Inputs(_) => format!(", {}", self.tape_of(taped, time)),
        };
        let _ = writeln!(self.statements, "    {}(in, out{time}{tape});", callee.name);
        for k in 0..n {
            let own = if k < n_own { format!("out{time}[{k}]") } else { format!("tape{time}[{}]", k - n_own) };
            self.left.entry(first + k).or_insert(own);
        }
        self.release(&call.operands, time);
        self.n_instruction += callee.n_instruction;
        self.n_most += callee.n_most;
        Ok(())
    }

    /// Where a tape is wanted, number by number: it is written there at once.
    fn wanted_in_order(&mut self, first: usize, n: usize) -> Option<String> {
        if !self.writes_early {
            return None;
        }
        let of = |own: &Self, value: usize| {
            let [k] = own.results_of.get(&value)?[..] else { return None };
            let (array, place) = own.results[k].strip_suffix(']')?.split_once('[')?;
            Some((k, array.to_string(), place.parse::<usize>().ok()?))
        };
        let (_, array, place) = of(self, first)?;
        let wanted: Vec<usize> = (0..n)
            .map(|k| of(self, first + k).filter(|own| own.1 == array && own.2 == place + k).map(|own| own.0))
            .collect::<Option<_>>()?;
        for (value, k) in (first..).zip(wanted) {
            self.results_of.remove(&value);
            self.is_written[k] = true;
            self.left.insert(value, self.results[k].clone());
        }
        Some(format!("{array} + {place}"))
    }

    /// Where these numbers stand one behind the other: where a function left them, or copied.
    fn tape_of(&mut self, taped: &[Value], time: usize) -> String {
        let stands = |value: &Value| {
            let place = match self.form.source(*value) {
                Source::Input(k) if !self.is_read[k] => Some(&self.inputs[k]),
                _ => self.left.get(&value.index()),
            }?;
            let (array, place) = place.strip_suffix(']')?.split_once('[')?;
            Some((array.to_string(), place.parse::<usize>().ok()?))
        };
        let first = taped.first().and_then(stands);
        if let Some((array, first)) = first
            && taped.iter().zip(first..).all(|(value, place)| stands(value) == Some((array.clone(), place)))
        {
            return format!("{array} + {first}");
        }
        let _ = writeln!(self.statements, "    {} copy{time}[{}];", self.precision.c_type(), taped.len().max(1));
        for (k, value) in taped.iter().enumerate() {
            let own = self.read(*value);
            let _ = writeln!(self.statements, "    copy{time}[{k}] = {};", bare(&own));
        }
        format!("copy{time}")
    }

    /// Results among places are written when they are known, so that nothing else has to keep them; what is read there later is read
    /// before.
    fn write_early(&mut self, instruction: &Instruction, time: usize) {
        if !self.writes_early {
            return;
        }
        let first = instruction.first.index();
        for value in first..first + self.form.n_result_of(instruction) {
            for k in self.results_of.remove(&value).unwrap_or_default() {
                let covered = self.covered[k].filter(|input| self.last_use[*input] > time);
                if let Some(input) = covered {
                    self.read(Value(input as u32));
                }
                let _ = writeln!(self.statements, "    {} = {};", self.results[k], self.computed(value));
                self.is_written[k] = true;
            }
        }
    }

    /// Inputs that are results are read before anything is written, since arrays may be the same.
    fn write_results(&mut self) {
        let results: Vec<Value> = self.form.results().to_vec();
        let mut copies: Vec<(Value, u32)> = Vec::new();
        for value in &results {
            if matches!(self.form.source(*value), Source::Input(_)) && !copies.iter().any(|(own, _)| own == value) {
                let own = self.read(*value);
                let slot = self.place(value.index());
                let _ = writeln!(self.statements, "    v{slot} = {own};");
                copies.push((*value, slot));
            }
        }
        for (k, value) in results.iter().enumerate() {
            if self.is_written[k] {
                continue;
            }
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
        if self.is_of_device && !self.left.is_empty() {
            let _ = writeln!(text, "    {} in[{}];", self.precision.c_type(), self.n_passed.max(1));
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
