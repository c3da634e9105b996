use super::*;
use crate::columns::{BLOCK, LINE};
use crate::custom::{CustomFunction, Operation};
use crate::emit::{CFunction, CText, literal};
use crate::lanes::{InstructionSet, with_set};
use crate::program::{CallOf, Callee, Instruction, InstructionKind, Op, Program, Tape, Value, ValueForm};
use base::error::Result;
use rng::{Purpose, Stream};
use std::sync::Arc;

/// y = (x₀ − 2x₁, x₁/x₀, 3): in `f64`, as custom functions are.
struct Mixed;
impl CustomFunction for Mixed {
    fn n_input(&self) -> usize {
        2
    }
    fn n_output(&self) -> usize {
        3
    }
    fn value(&self, x: &[f64], y: &mut [f64]) {
        y.copy_from_slice(&[x[0] - 2.0 * x[1], x[1] / x[0], 3.0]);
    }
    fn forward(&self, _: &[f64], _: &[f64], dy: &mut [f64]) {
        dy.fill(f64::NAN);
    }
    fn reverse(&self, _: &[f64], _: &[f64], x_bar: &mut [f64]) {
        x_bar.fill(f64::NAN);
    }
    fn c_function(&self, text: &mut CText, name: &str, known: &[Option<f64>]) -> Result<Option<CFunction>> {
        let (precision, mut open) = (text.precision(), 0..);
        let operand = |known: &Option<f64>| match known {
            Some(x) => format!("({})", literal(*x, precision)),
            None => format!("x[{}]", open.next().unwrap_or(0)),
        };
        let operands: Vec<String> = known.iter().map(operand).collect();
        let (real, [a, b]) = (precision.c_type(), [&operands[0], &operands[1]]);
        let [two, three] = [2.0, 3.0].map(|x| literal(x, precision));
        let prototype = format!("{}void {name}(const {real} *x, {real} *y)", text.dialect().own());
        text.add(&format!(
            "{prototype}\n{{\n    (void)x;\n    y[0] = {a} - {two} * {b};\n    y[1] = {b} / {a};\n    y[2] = {three};\n}}\n"
        ));
        Ok(Some(CFunction { name: name.into(), prototype, stack: 96, n_instruction: 3, n_most: 3 }))
    }
}

pub(crate) fn draws(seed: u64) -> Stream {
    Stream::new(58, seed, 0, Purpose::user(58))
}

/// A number that may be anything.
pub(crate) fn number(r: &mut Stream) -> f64 {
    const SPECIAL: [f64; 16] = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::NAN,
        1e-40,
        -1e-42,
        5e-324,
        -1e-310,
        3e38,
        1e300,
        0.5,
        1e5,
        -3e6,
    ];
    match r.below(8) {
        0 => SPECIAL[r.below(16) as usize],
        1 => f64::from_bits(r.next_u64()),
        2 => f64::from(f32::from_bits(r.next_u64() as u32)),
        _ => r.uniform(-4.0, 4.0),
    }
}

/// A program of any operations on any values: short and long lives, results that are inputs and constants, calls of custom functions
/// and of functions of its own.
pub(crate) fn random_form(seed: u64) -> ValueForm {
    let mut r = draws(seed);
    let mut functions = Vec::new();
    for _ in 0..r.below(7).saturating_sub(2) {
        let mut function = random_form_of(&mut r, 30, &functions);
        let n = r.below(5) as usize;
        function.tape = match r.below(3) {
            0 => Tape::Inputs(n.min(function.n_input)),
            1 => Tape::Results(n.min(function.results.len())),
            _ => Tape::None,
        };
        functions.push(Arc::new(function));
    }
    random_form_of(&mut r, if seed.is_multiple_of(16) { 600 } else { 60 }, &functions)
}

/// With as many instructions at most, and calls of these functions.
fn random_form_of(r: &mut Stream, n_most: u64, functions: &[Arc<ValueForm>]) -> ValueForm {
    let (n_input, n_constant) = (r.below(9) as usize, r.below(7) as usize);
    let mut constants: Vec<u64> = (0..=n_constant).map(|_| number(r).to_bits()).collect();
    constants.dedup();
    let reach = [4, 40, 400][r.below(3) as usize];
    let (has_calls, is_smooth) = (r.below(4) == 0, r.below(3) == 0);
    let n_value = n_input + constants.len();
    let (instructions, calls, results) = (vec![], vec![], vec![]);
    let mut form = ValueForm { n_input, constants, instructions, calls, results, n_value, tape: Tape::None };
    let operation = Operation::new(Mixed);
    for _ in 0..1 + r.below(n_most) {
        let n = form.n_value as u64;
        let mut any = || match r.below(4) {
            0 => Value(r.below(n) as u32),
            _ => Value((n - 1 - r.below(n.min(reach))) as u32),
        };
        let operands = [any(), any(), any(), any()];
        if has_calls && r.below(12) == 0 {
            let first = form.next(3);
            form.instructions.push(Instruction { action: InstructionKind::Call(form.calls.len()), first });
            let callee = Callee::Custom(operation.clone());
            form.calls.push(CallOf { callee, operands: operands[..2].to_vec() });
            continue;
        }
        if !functions.is_empty() && r.below(8) == 0 {
            let function = functions[r.below(functions.len() as u64) as usize].clone();
            let mut operands: Vec<Value> = (0..function.n_input).map(|_| Value(r.below(n) as u32)).collect();
            // numbers side by side: what a function left, or what this one is given
            let n_tape = function.tape.n_input();
            let begin = r.below(n.saturating_sub(n_tape as u64) + 1) as u32;
            let tapes = form.instructions.iter().filter(|i| matches!(i.action, InstructionKind::Call(_)));
            let begin = tapes.map(|i| i.first.0 + r.below(3) as u32).last().unwrap_or(begin);
            if r.below(2) == 0 && u64::from(begin) + n_tape as u64 <= n {
                let at = function.n_input - n_tape;
                operands.truncate(at);
                operands.extend((begin..begin + n_tape as u32).map(Value));
            }
            let first = form.next(function.results.len() as u32);
            form.instructions.push(Instruction { action: InstructionKind::Call(form.calls.len()), first });
            form.calls.push(CallOf { callee: Callee::Function(function), operands });
            continue;
        }
        let ops = if is_smooth { 17 } else { Op::ALL.len() as u64 };
        let op = if r.below(3) == 0 { Op::MulAdd } else { Op::ALL[r.below(ops) as usize] };
        let first = form.next(op.n_result() as u32);
        form.instructions.push(Instruction { action: InstructionKind::Op(op, operands), first });
    }
    let n_result = 1 + r.below(12);
    form.results = (0..n_result).map(|_| Value(r.below(form.n_value as u64) as u32)).collect();
    // results of the last call in their order
    if r.below(2) == 0
        && let Some(call) = form.instructions.iter().rfind(|i| matches!(i.action, InstructionKind::Call(_)))
    {
        let n = form.n_result_of(call) as u32;
        form.results.extend((call.first.0..call.first.0 + n).map(Value));
    }
    form
}

/// Results over arguments, beside them or in another array, in any order.
fn random_layout(seed: u64, n_argument: usize, n_result: usize) -> RowLayout {
    let mut r = draws(seed ^ 0x5A5A);
    let n_array = 1 + r.below(4) as u32;
    let n_row = (n_argument + n_result) as u64;
    let mut place = || Place { array: r.below(n_array.into()) as u8, row: r.below(n_row) as u32 };
    let arguments: Vec<Place> = (0..n_argument).map(|_| place()).collect();
    let mut results: Vec<Place> = Vec::new();
    while results.len() < n_result {
        let (other, of) = (place(), place().row as usize);
        let candidate = if of % 2 == 0 && n_argument > 0 { arguments[of % n_argument] } else { other };
        if !results.contains(&candidate) {
            results.push(candidate);
        }
    }
    RowLayout::new(arguments, results).unwrap()
}

mod forms;
mod memory;
mod simulator;
mod traps;

trait Tested: Row + PartialEq + std::fmt::Debug {
    fn random(r: &mut Stream) -> Self;
    fn interpreter(program: &Program, inputs: &[Self], n: usize) -> Vec<Self>;
    /// The first lane of the first `n` that differs; any NaN equals any NaN.
    fn differs(&self, other: &Self, n: usize) -> Option<usize>;
    const MOST: usize;
}

impl Tested for f64 {
    const MOST: usize = 1;
    fn random(r: &mut Stream) -> Self {
        number(r)
    }
    fn interpreter(program: &Program, inputs: &[Self], _: usize) -> Vec<Self> {
        let mut outputs = vec![0.0; program.n_output()];
        program.evaluate(&mut program.interpreter_workspace(), inputs, &mut outputs);
        outputs
    }
    fn differs(&self, other: &Self, _: usize) -> Option<usize> {
        (self.to_bits() != other.to_bits() && !(self.is_nan() && other.is_nan())).then_some(0)
    }
}

impl Tested for [f64; LINE] {
    const MOST: usize = LINE;
    fn random(r: &mut Stream) -> Self {
        std::array::from_fn(|_| number(r))
    }
    fn interpreter(program: &Program, inputs: &[Self], n: usize) -> Vec<Self> {
        let mut slots = program.step_slots();
        program.evaluate_steps(n, &mut slots, inputs);
        (0..program.n_output()).map(|k| slots[program.place(k) as usize]).collect()
    }
    fn differs(&self, other: &Self, n: usize) -> Option<usize> {
        (0..n).find(|k| self[*k].differs(&other[*k], 1).is_some())
    }
}

impl Tested for [f32; BLOCK] {
    const MOST: usize = BLOCK;
    fn random(r: &mut Stream) -> Self {
        std::array::from_fn(|_| number(r) as f32)
    }
    fn interpreter(program: &Program, inputs: &[Self], n: usize) -> Vec<Self> {
        let mut outputs = vec![[0.0; BLOCK]; program.n_output()];
        program.evaluate_lanes(n, &mut program.interpreter_block_workspace(), inputs, &mut outputs);
        outputs
    }
    fn differs(&self, other: &Self, n: usize) -> Option<usize> {
        (0..n).find(|k| self[*k].to_bits() != other[*k].to_bits() && !(self[*k].is_nan() && other[*k].is_nan()))
    }
}

/// The first value that differs where it is the only result.
fn culprit<R: Tested>(form: &ValueForm, inputs: &[R], n: usize) -> String {
    for instruction in form.instructions() {
        for k in 0..form.n_result_of(instruction) as u32 {
            let alone = ValueForm { results: vec![Value(instruction.first.0 + k)], ..form.clone() };
            let program = Program::of_calls(alone);
            let executable = Executable::<R>::new(&program, RowLayout::apart(inputs.len(), 1)).unwrap();
            let (want, mut got) = (R::interpreter(&program, inputs, n), [R::zeroed()]);
            executable.run(&mut executable.work(), &mut [Rows::Read(inputs), Rows::Write(&mut got)], n).unwrap();
            if let Some(lane) = want[0].differs(&got[0], n) {
                let text = program.value_form().to_string();
                let line =
                    text.lines().find(|line| line.contains(&format!("{} ", instruction.first))).unwrap_or_default();
                return format!("alone: {line}: lane {lane}: {:?} instead of {:?}", got[0], want[0]);
            }
        }
    }
    "no value differs alone".into()
}

/// Runs one random program both ways.
fn compare<R: Tested>(seed: u64) {
    let form = random_form(seed);
    let mut r = draws(seed ^ 0xF0F0);
    let program = Program::of_calls(form);
    let layout = random_layout(seed, program.n_input(), program.n_output());
    let executable = Executable::<R>::new(&program, layout.clone()).unwrap();
    let n = 1 + r.below(R::MOST as u64) as usize;
    let mut arrays: Vec<Vec<R>> =
        (0..layout.n_array()).map(|k| (0..layout.n_row(k)).map(|_| R::random(&mut r)).collect()).collect();
    let at = |arrays: &[Vec<R>], place: &Place| arrays[place.array as usize][place.row as usize];
    let inputs: Vec<R> = layout.arguments().iter().map(|place| at(&arrays, place)).collect();
    let before = arrays.clone();
    let want = R::interpreter(&program, &inputs, n);
    let mut rows: Vec<Rows<'_, R>> = arrays.iter_mut().map(|array| Rows::Write(array)).collect();
    executable.run(&mut executable.work(), &mut rows, n).unwrap();
    for (k, (want, place)) in want.iter().zip(layout.results()).enumerate() {
        let got = at(&arrays, place);
        if let Some(lane) = want.differs(&got, n) {
            let culprit = culprit::<R>(program.value_form(), &inputs, n);
            panic!("seed {seed}: result {k} in lane {lane} of {n}; {culprit}");
        }
    }
    let flat = R::interpreter(&Program::of_form(program.value_form().clone(), seed.is_multiple_of(2)), &inputs, n);
    let differs = want.iter().zip(&flat).find_map(|(want, flat)| want.differs(flat, n));
    assert_eq!(differs, None, "seed {seed}: other bits where functions stand in their callers' place");
    for (k, array) in arrays.iter().enumerate() {
        for (row, now) in array.iter().enumerate() {
            let place = Place { array: k as u8, row: row as u32 };
            let is_result = layout.results().contains(&place);
            assert!(is_result || before[k][row].differs(now, R::MOST).is_none(), "seed {seed}: {place:?} was written");
        }
    }
}

fn n_program() -> u64 {
    std::env::var("OMNIDRONES_PROGRAMS").map_or(25_000, |n| n.parse().unwrap())
}

/// Whether code is made here: not where it is switched off, the processor is too old or the system is hardened. What needs code is not
/// run then, and this says so.
fn is_made() -> bool {
    let made = Executable::<f64>::new(&Program::of_form(random_form(1), false), random_layout_of(1)).unwrap();
    match made.why_interpreted() {
        None => true,
        Some(why @ (WhyInterpreted::Off | WhyInterpreted::Processor | WhyInterpreted::Refused(_))) => {
            println!("not run, or only by the interpreter: no code is made here: {why}");
            false
        }
        Some(other) => panic!("{other}"),
    }
}

/// The layout of the random program of this seed.
fn random_layout_of(seed: u64) -> RowLayout {
    let form = random_form(seed);
    random_layout(seed, form.n_input, form.results.len())
}

fn compare_all<R: Tested>() {
    if !is_made() {
        return;
    }
    (0..n_program()).for_each(compare::<R>);
}

#[test]
fn random_programs_in_lanes_have_the_bits_of_the_interpreter() {
    compare_all::<[f32; BLOCK]>();
}

#[test]
fn random_programs_in_lanes_of_avx2_have_the_bits_of_the_interpreter() {
    with_set(InstructionSet::Avx2, compare_all::<[f32; BLOCK]>);
}

#[test]
fn random_programs_of_one_number_have_the_bits_of_the_interpreter() {
    compare_all::<f64>();
}

#[test]
fn random_programs_of_steps_side_by_side_have_the_bits_of_the_interpreter() {
    compare_all::<[f64; LINE]>();
}
