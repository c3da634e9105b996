//! What went wrong once, or would.

use super::super::allocate::allocate;
use super::super::instruction::{Allocated, Instruction as Placed, TapeAt, Target};
use super::super::lower::{Do, Element, lower};
use super::*;
use crate::scalar::Scalar;
use crate::trace::{Recording, Trace};

fn step(first: u32, op: Op, operands: [u32; 4]) -> Instruction {
    Instruction { action: InstructionKind::Op(op, operands.map(Value)), first: Value(first) }
}

fn form(n_input: usize, constants: &[f64], instructions: Vec<Instruction>, results: &[u32]) -> ValueForm {
    let n_value = n_input + constants.len() + instructions.len();
    let constants = constants.iter().map(|number| number.to_bits()).collect();
    ValueForm {
        n_input,
        constants,
        instructions,
        calls: vec![],
        results: results.iter().map(|k| Value(*k)).collect(),
        n_value,
        tape: Tape::None,
    }
}

/// Results of one program in `f64` whose only array is `state`.
fn in_place(form: ValueForm, arguments: &[u32], results: &[u32], state: &mut [f64]) {
    let places = |rows: &[u32]| rows.iter().map(|row| Place { array: 0, row: *row }).collect();
    let layout = RowLayout::new(places(arguments), places(results)).unwrap();
    let program = Program::of_form(form, false);
    let made = Executable::<f64>::new(&program, layout).unwrap();
    made.run(&mut made.work(), &mut [Rows::Write(state)], 1).unwrap();
}

#[test]
fn a_result_over_an_argument_that_is_read_later_waits() {
    // (x + y, x·y) over (x, y): the sum is made first, and x is read by the product still
    let mut state = [3.0, 5.0];
    let both = vec![step(2, Op::Add, [0, 1, 0, 0]), step(3, Op::Mul, [0, 1, 0, 0])];
    in_place(form(2, &[], both, &[2, 3]), &[0, 1], &[0, 1], &mut state);
    assert_eq!(state, [8.0, 15.0]);
}

#[test]
fn arguments_that_change_places_do() {
    let mut state = [1.0, 2.0, 3.0];
    in_place(form(3, &[], vec![], &[1, 2, 0]), &[0, 1, 2], &[0, 1, 2], &mut state);
    assert_eq!(state, [2.0, 3.0, 1.0]);
    // one number to several places, one of them its own
    in_place(form(1, &[], vec![], &[0, 0, 0]), &[1], &[0, 1, 2], &mut state);
    assert_eq!(state, [3.0; 3]);
    // a constant over an argument that another result is
    in_place(form(1, &[7.0], vec![], &[1, 0]), &[0], &[0, 1], &mut state);
    assert_eq!(state, [7.0, 3.0, 3.0]);
}

#[test]
fn minima_and_maxima_found_in_selections_keep_what_a_nan_and_a_tie_give() {
    // a where a < b, else b; b where a < b, else a; and both the other way round, which are no minimum and no maximum
    let choices = [[0, 1, 0, 1], [0, 1, 1, 0], [0, 1, 0, 0], [0, 1, 1, 1]];
    let made = form(2, &[], choices.iter().zip(2..).map(|(o, k)| step(k, Op::SelectLess, *o)).collect(), &[2, 3, 4, 5]);
    let kinds: Vec<Do> = lower(&made, Element::F64).unwrap()[0].steps.iter().map(|step| step.what).collect();
    assert!(kinds.starts_with(&[Do::Min, Do::Max]), "{kinds:?}");
    let program = Program::of_form(made, false);
    let executable = Executable::<f64>::new(&program, RowLayout::apart(2, 4)).unwrap();
    for (a, b) in [(f64::NAN, 1.0), (1.0, f64::NAN), (0.0, -0.0), (-0.0, 0.0), (2.0, 1.0), (1.0, 2.0)] {
        let mut got = [0.0; 4];
        executable.run(&mut executable.work(), &mut [Rows::Read(&[a, b]), Rows::Write(&mut got)], 1).unwrap();
        let want = if a < b { [a, b] } else { [b, a] };
        assert_eq!(got.map(f64::to_bits)[..2], want.map(f64::to_bits), "{a}, {b}");
    }
}

#[test]
fn a_comparison_is_made_once_for_all_its_selections_until_a_call() {
    let target = Target { n_register: 32, has_masks: true, is_single: false };
    let compares = |instructions: Vec<Instruction>| {
        let results = [instructions.last().unwrap().first.0, instructions[0].first.0];
        let mut form = form(4, &[], instructions, &results);
        form.n_value += 8;
        let mut lowered = lower(&form, Element::F64).unwrap();
        let allocated = allocate(&mut lowered, &RowLayout::apart(4, 2), target);
        allocated[0].instructions.iter().filter(|i| matches!(i, Placed::Compare { .. })).count()
    };
    let first = step(4, Op::SelectLess, [0, 1, 2, 3]);
    assert_eq!(compares(vec![first, step(5, Op::SelectLess, [0, 1, 4, 3])]), 1);
    assert_eq!(
        compares(vec![first, step(5, Op::Exp, [4, 0, 0, 0]), step(6, Op::SelectLess, [0, 1, 5, 2])]),
        2,
        "masks are the callee's"
    );
}

#[test]
fn equal_terms_are_computed_once_and_what_nobody_reads_not_at_all() {
    let lowered = |instructions, results: &[u32]| {
        lower(&form(2, &[], instructions, results), Element::F32).unwrap()[0].steps.len()
    };
    let (sum, again) = (step(2, Op::Recip, [0, 0, 0, 0]), step(3, Op::Recip, [0, 0, 0, 0]));
    assert_eq!(lowered(vec![sum, again], &[2, 3]), 1);
    let mut sines = form(1, &[], vec![step(1, Op::SinCos, [0, 0, 0, 0])], &[1, 2]);
    sines.n_value = 3;
    let both = lower(&sines, Element::F32).unwrap()[0].steps.len();
    sines.results.pop();
    let one = lower(&sines, Element::F32).unwrap()[0].steps.len();
    assert!(one < both, "a sine alone: {one} of {both} steps");
}

#[test]
fn what_is_too_large_for_code_is_interpreted() {
    let n = MAX_STEPS as u32;
    let chain = (0..n).map(|k| step(k + 1, Op::Neg, [k, 0, 0, 0])).collect();
    let program = Program::of_form(form(1, &[], chain, &[n]), false);
    let made = Executable::<f64>::new(&program, RowLayout::apart(1, 1)).unwrap();
    assert!(!is_made() || made.why_interpreted() == Some(WhyInterpreted::TooLarge));
    let mut y = [0.0];
    made.run(&mut made.work(), &mut [Rows::Read(&[1.5]), Rows::Write(&mut y)], 1).unwrap();
    assert_eq!(y, [1.5], "the sign changed an even number of times");
}

#[test]
fn more_values_alive_than_a_u16_names_are_programs_too() {
    let n = 70_000;
    // values 1 to n: x + x, x + v1, …; then all of them are added up
    let grow = (0..n).map(|k| step(1 + k, Op::Add, [0, k, 0, 0]));
    let fold = (0..n).map(|k| step(1 + n + k, Op::Add, [if k == 0 { 0 } else { n + k }, n - k, 0, 0]));
    let program = Program::of_form(form(1, &[], grow.chain(fold).collect(), &[2 * n]), false);
    assert!(program.n_slot() > 1 << 16, "{}", program.n_slot());
    let (mut native, mut interpreted) = ([0.0], [0.0]);
    program.evaluate(&mut program.workspace(), &[1.0], &mut native);
    program.evaluate(&mut program.interpreter_workspace(), &[1.0], &mut interpreted);
    let sum: f64 = (1..=f64::from(n) as u64).map(|k| (k + 1) as f64).sum::<f64>() + 1.0;
    assert_eq!((native, interpreted), ([sum], [sum]));
}

/// The allocated parts of a program for AVX2.
fn parts(form: &ValueForm) -> Vec<Allocated> {
    let target = Target { n_register: 16, has_masks: false, is_single: false };
    let mut lowered = lower(form, Element::F32).unwrap();
    allocate(&mut lowered, &RowLayout::apart(form.n_input(), form.results().len()), target)
}

#[test]
fn random_programs_pass_tapes_in_every_way() {
    let (mut own, mut slots) = (0, 0);
    for instruction in (0..2000).flat_map(|seed| parts(&random_form(seed))).flat_map(|part| part.instructions) {
        match instruction {
            Placed::Invoke { tape: Some(TapeAt::Own(_)), .. } => own += 1,
            Placed::Invoke { tape: Some(TapeAt::Slot(_)), .. } => slots += 1,
            _ => {}
        }
    }
    println!("{own} on tapes of callers, {slots} in slots");
    assert!(own > 20 && slots > 200, "{own} on tapes of callers, {slots} in slots");
}

#[test]
fn an_adjoint_reads_its_tape_where_the_function_has_left_it() {
    // twice five stages of sixty sines: functions in functions
    let recording = Recording::of(2, |x| {
        let mut state = x.to_vec();
        for _ in 0..2 {
            Trace::function(&mut state, |state| {
                for _ in 0..5 {
                    Trace::function(state, |state| {
                        for k in 0..60 {
                            state[k % 2] = (state[0] * state[1]).sin_cos().0 + state[k % 2];
                        }
                    });
                }
            });
        }
        state
    });
    let program = Program::compile(&recording.adjoint(0..2)).unwrap();
    let n_tape = program.value_form().functions().iter().map(|function| function.tape.n_result()).max().unwrap();
    let parts = parts(program.value_form());
    let sizes: Vec<usize> = parts.iter().map(|part| part.instructions.len()).collect();
    println!("tape of {n_tape}, instructions of the program and its functions: {sizes:?}");
    // the program and the two outer functions move arguments and results alone
    assert!(n_tape > 500 && sizes.iter().filter(|n| **n < 100).count() == 3, "{n_tape}, {sizes:?}");
}
