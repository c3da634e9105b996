//! Executable memory: what it costs, who may touch it, and what a host or a fork does to it.

use super::super::lower::Element;
use super::super::memory::{process, with_modes};
use super::*;
use crate::{Recording, Scalar, Trace};
use base::error::Error;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

/// A small program that no other seed has.
fn small(seed: u32) -> Program {
    let (a, b) = (Value(0), Value(1));
    let constant = f64::from(seed).to_bits();
    let step = |first, op, operands| Instruction { action: InstructionKind::Op(op, operands), first };
    let instructions = vec![step(Value(2), Op::MulAdd, [a, a, b, a]), step(Value(3), Op::Exp, [Value(2), a, a, a])];
    let results = vec![Value(2), Value(3)];
    let (constants, calls, tape) = (vec![constant], vec![], Tape::None);
    let form = ValueForm { n_input: 1, constants, instructions, calls, results, n_value: 4, tape };
    Program::of_form(form, false)
}

fn executable(seed: u32) -> Executable<f64> {
    Executable::new(&small(seed), RowLayout::apart(1, 2)).unwrap()
}

fn run(executable: &Executable<f64>, x: f64) -> [f64; 2] {
    let mut y = [0.0; 2];
    executable.run(&mut executable.work(), &mut [Rows::Read(&[x]), Rows::Write(&mut y)], 1).unwrap();
    y
}

/// Runs an ignored test of this file alone in a process; returns what it prints.
fn alone(name: &str) -> String {
    if !is_made() {
        return String::new();
    }
    let name = format!("{}::{name}", module_path!().split_once("::").unwrap().1);
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", &name, "--ignored", "--nocapture"])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    println!("{text}{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success() && text.contains("1 passed"), "{name}");
    text
}

/// MiB.
fn resident() -> f64 {
    let status = std::fs::read_to_string("/proc/self/statm").unwrap();
    let pages: f64 = status.split_whitespace().nth(1).unwrap().parse().unwrap();
    pages * 4096.0 / f64::from(1 << 20)
}

/// MiB of pages that may be executed and belong to no file.
fn code_resident() -> f64 {
    let (mut is_code, mut total) = (false, 0.0);
    for line in std::fs::read_to_string("/proc/self/smaps").unwrap().lines() {
        let mut words = line.split_whitespace();
        match (words.next().unwrap_or_default(), words.next().unwrap_or_default()) {
            (first, rights) if first.contains('-') => is_code = rights == "r-xp" && words.count() == 3,
            ("Rss:", kib) if is_code => total += kib.parse::<f64>().unwrap() / 1024.0,
            _ => {}
        }
    }
    total
}

fn n_map() -> usize {
    std::fs::read_to_string("/proc/self/maps").unwrap().lines().count()
}

#[test]
fn thousands_of_programs_take_few_maps_and_give_their_memory_back() {
    alone("made_and_dropped");
}

#[test]
#[ignore = "run alone by thousands_of_programs_take_few_maps_and_give_their_memory_back"]
fn made_and_dropped() {
    (0..100).for_each(|seed| drop(executable(seed)));
    let (memory, maps) = (resident(), n_map());
    (0..10_000).for_each(|seed| drop(executable(seed)));
    println!("10 000 made and dropped: {:+.1} MiB, {:+} maps", resident() - memory, n_map() as i64 - maps as i64);
    assert!(resident() - memory < 16.0); // measured 0.1
    let alive: Vec<Executable<f64>> = (0..30_000).map(executable).collect();
    println!("30 000 alive: {:+.1} MiB, {:.1} MiB of code, {} maps", resident() - memory, code_resident(), n_map());
    assert!(alive.iter().all(Executable::is_native) && n_map() <= 1000); // measured 60
    assert_eq!(run(&alive[29_999], 2.0)[0], 30_003.0);
    // every second one goes, in between stays
    let kept: Vec<_> = alive.into_iter().enumerate().filter(|(k, _)| k % 2 == 0).map(|(_, kept)| kept).collect();
    assert!(n_map() <= 1000 && run(&kept[7], 3.0)[0] == 23.0);
    drop(kept);
    // what is left of the heap is the allocator's
    println!("all gone: {:+.1} MiB, {:.1} MiB of code, {} maps", resident() - memory, code_resident(), n_map());
    assert!(code_resident() < 1.0); // measured 0.0
}

#[test]
fn a_fork_while_another_thread_makes_code_neither_hangs_nor_changes_a_bit() {
    alone("forked");
}

#[test]
#[ignore = "run alone by a_fork_while_another_thread_makes_code_neither_hangs_nor_changes_a_bit"]
fn forked() {
    let stop = AtomicBool::new(false);
    let (kept, want) = (executable(7), run(&executable(7), 0.3));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut seed = 1000;
            while !stop.load(Ordering::Relaxed) {
                seed += 1;
                drop(executable(seed));
            }
        });
        for k in 0..1000_u32 {
            match fork::fork().unwrap() {
                fork::Fork::Child => {
                    // no panic here: its message would wait for locks of threads that are not there
                    let made = executable(k);
                    let is_right =
                        made.is_native() && run(&kept, 0.3) == want && run(&made, 2.0)[0] == 4.0 + f64::from(k);
                    drop(made);
                    std::process::exit(if is_right { 0 } else { 1 });
                }
                fork::Fork::Parent(child) => {
                    let status = fork::waitpid(child).unwrap();
                    assert_eq!(status, 0, "child {k}");
                }
            }
        }
        stop.store(true, Ordering::Relaxed);
    });
}

#[test]
fn a_process_is_told_from_those_it_was_made_from_whatever_numbers_the_system_gives() {
    alone("told_apart");
}

#[test]
#[ignore = "run alone by a_process_is_told_from_those_it_was_made_from_whatever_numbers_the_system_gives"]
fn told_apart() {
    let asked: Vec<u64> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..8).map(|_| scope.spawn(process)).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert_eq!(asked, [process(); 8], "threads agree, whoever asks first");
    if process() == u64::from(std::process::id()) {
        println!("not run: the system empties no pages for a child");
        return;
    }
    assert!(process() <= 8, "{} is none of the system's numbers", process());
    assert!(descends(&[], 5));
}

/// Whether this process and its children's children have a number of their own, always the same.
fn descends(before: &[u64], generations: u32) -> bool {
    let own = process();
    let line = [before, &[own]].concat();
    let has_own = !before.contains(&own) && process() == own;
    has_own
        && (0..generations.min(2)).all(|_| match fork::fork().unwrap() {
            // no panic here, as above
            fork::Fork::Child => std::process::exit(i32::from(!descends(&line, generations - 1))),
            fork::Fork::Parent(child) => fork::waitpid(child).unwrap() == 0 && process() == own,
        })
}

#[test]
fn modes_of_a_host_change_no_bit_and_stay_the_hosts() {
    if !is_made() {
        return;
    }
    let program = small(0);
    let made = Executable::<f64>::new(&program, RowLayout::apart(1, 2)).unwrap();
    let x = 1.5e-160;
    let want = run(&made, x);
    assert!(want[0] > 0.0 && want[0] < f64::MIN_POSITIVE, "the square is subnormal: {}", want[0]);
    // flush to zero, denormals are zero, both, round up, all exceptions masked
    for modes in [0x9F80, 0x1FC0, 0x9FC0, 0x5F80] {
        let mut got = [[0.0; 2]; 2];
        let mut after = 0.0;
        with_modes(modes, || {
            got[0] = run(&made, x);
            program.evaluate(&mut program.interpreter_workspace(), &[x], &mut got[1]);
            after = std::hint::black_box(x) * std::hint::black_box(x);
        });
        assert_eq!(got, [want; 2], "{modes:#x}");
        let keeps = modes == 0x1FC0 || after != want[0] || modes == 0x5F80;
        assert!(keeps, "the host's modes are back: {after:e} in {modes:#x}");
    }
}

#[test]
fn a_panic_of_a_custom_function_goes_on_behind_the_code() {
    struct Fails;
    impl CustomFunction for Fails {
        fn n_input(&self) -> usize {
            1
        }
        fn n_output(&self) -> usize {
            1
        }
        fn value(&self, x: &[f64], y: &mut [f64]) {
            assert!(x[0] < 1.0, "too large: {}", x[0]);
            y[0] = x[0];
        }
        fn forward(&self, _: &[f64], _: &[f64], _: &mut [f64]) {}
        fn reverse(&self, _: &[f64], _: &[f64], _: &mut [f64]) {}
    }
    let calls = vec![CallOf { callee: Callee::Custom(Operation::new(Fails)), operands: vec![Value(0)] }];
    let instructions = vec![Instruction { action: InstructionKind::Call(0), first: Value(1) }];
    let (constants, results, tape) = (vec![], vec![Value(1)], Tape::None);
    let form = ValueForm { n_input: 1, constants, instructions, calls, results, n_value: 2, tape };
    let made = Executable::<f64>::new(&Program::of_form(form, false), RowLayout::apart(1, 1)).unwrap();
    let run = |x: f64| {
        let mut y = [0.0];
        made.run(&mut made.work(), &mut [Rows::Read(&[x]), Rows::Write(&mut y)], 1).unwrap();
        y[0]
    };
    assert_eq!(run(0.25), 0.25);
    let panic = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| run(2.0))).unwrap_err();
    assert_eq!(panic.downcast_ref::<String>().unwrap(), "too large: 2");
    assert_eq!(run(0.5), 0.5, "and the code runs on");
}

#[test]
fn numbers_of_code_are_rounded_to_nearest_whatever_the_modes_it_was_made_in() {
    let step = |first, op, operands| Instruction { action: InstructionKind::Op(op, operands), first };
    let (x, tenth) = (Value(0), Value(1));
    let instructions = vec![step(Value(2), Op::Mul, [x, tenth, x, x])];
    let form = ValueForm {
        n_input: 1,
        constants: vec![0.1_f64.to_bits()],
        instructions,
        calls: vec![],
        results: vec![Value(2)],
        n_value: 3,
        tape: Tape::None,
    };
    let program = Program::of_form(form, false);
    let mut made = None;
    // upwards; 0.1 in f32 is above 0.1 to the nearest, so that downwards differs
    with_modes(0x3F80, || {
        let code = Executable::<[f32; BLOCK]>::new(&program, RowLayout::apart(1, 1)).unwrap();
        made = Some((code, program.interpreter_block_workspace()));
    });
    let (code, mut workspace) = made.unwrap();
    let (mut native, mut interpreted) = ([[0.0; BLOCK]], [[0.0; BLOCK]]);
    code.run(&mut code.work(), &mut [Rows::Read(&[[1.0; BLOCK]]), Rows::Write(&mut native)], BLOCK).unwrap();
    program.evaluate_block(&mut workspace, &[[1.0; BLOCK]], &mut interpreted);
    assert_eq!((native[0][0], interpreted[0][0]), (0.1, 0.1));
}

#[test]
fn a_custom_function_that_changes_its_lengths_is_held_to_the_first() {
    use std::sync::atomic::AtomicUsize;
    struct Fickle(AtomicUsize);
    impl CustomFunction for Fickle {
        fn n_input(&self) -> usize {
            1
        }
        fn n_output(&self) -> usize {
            // 300, then 1
            if self.0.fetch_add(1, Ordering::Relaxed) == 0 { 300 } else { 1 }
        }
        fn value(&self, x: &[f64], y: &mut [f64]) {
            y.iter_mut().enumerate().for_each(|(k, y)| *y = x[0] + k as f64);
        }
        fn forward(&self, _: &[f64], _: &[f64], _: &mut [f64]) {}
        fn reverse(&self, _: &[f64], _: &[f64], _: &mut [f64]) {}
    }
    let operation = Operation::new(Fickle(AtomicUsize::new(0)));
    let recording = Recording::of(1, |z| {
        let mut y = vec![Trace::constant(0.0); 300];
        operation.call(z, &mut y);
        vec![y[299], y[0]]
    });
    let program = Program::compile(&recording).unwrap();
    let mut y = [0.0; 2];
    program.evaluate(&mut program.workspace(), &[0.5], &mut y);
    assert_eq!(y, [299.5, 0.5]);
    program.evaluate(&mut program.interpreter_workspace(), &[0.5], &mut y);
    assert_eq!(y, [299.5, 0.5]);
}

#[test]
#[should_panic(expected = "slots of the program")]
fn a_workspace_of_another_program_is_refused() {
    let mut y = [0.0; 2];
    small(1).evaluate(&mut small(2).workspace(), &[1.0], &mut y);
    // interpreted, it gives wrong numbers
    assert!(!is_made(), "slots of the program");
    panic!("slots of the program");
}

#[test]
fn arrays_that_are_not_what_the_layout_says_are_refused_before_any_code_runs() {
    let made = executable(3);
    let mut y = [f64::NAN; 2];
    let refused = |arrays: &mut [Rows<'_, f64>], n: usize| match made.run(&mut made.work(), arrays, n) {
        Err(error @ Error::Value { .. }) => error.to_string(),
        other => panic!("{other:?}"),
    };
    assert!(refused(&mut [Rows::Read(&[1.0])], 1).contains("number of arrays is 1"));
    assert!(refused(&mut [Rows::Read(&[1.0]), Rows::Write(&mut y[..1])], 1).contains("array 1 is of 1 rows"));
    assert!(refused(&mut [Rows::Read(&[1.0]), Rows::Read(&[0.0; 2])], 1).contains("array 1 is read only"));
    assert!(refused(&mut [Rows::Read(&[]), Rows::Write(&mut y)], 1).contains("array 0 is of 0 rows"));
    for n in [0, 2, usize::MAX] {
        assert!(refused(&mut [Rows::Read(&[1.0]), Rows::Write(&mut y)], n).contains("numbers of a row"));
    }
    assert!(y.iter().all(|y| y.is_nan()), "nothing was written");
    let same = Place { array: 0, row: 1 };
    assert!(RowLayout::new(vec![], vec![same, same]).unwrap_err().to_string().contains("another result's"));
    assert!(
        RowLayout::new(vec![Place { array: 6, row: 0 }], vec![]).unwrap_err().to_string().contains("number of arrays")
    );
    for row in [1 << 22, u32::MAX] {
        assert!(
            RowLayout::new(vec![Place { array: 0, row }], vec![]).unwrap_err().to_string().contains("row of a layout")
        );
    }
    let wrong = Executable::<f64>::new(&small(3), RowLayout::apart(2, 2)).unwrap_err().to_string();
    assert!(wrong.contains("2 arguments and 2 results"), "{wrong}");
}

#[test]
fn equal_programs_share_their_code_while_somebody_has_it() {
    if !is_made() {
        return;
    }
    let (one, other, third) = (executable(900_001), executable(900_001), executable(900_002));
    assert!(one.shares_code_with(&other) && !one.shares_code_with(&third));
    assert_eq!((one.code_size(), run(&other, 2.0)[0]), (4096, 900_005.0));
}

#[test]
fn the_same_recording_has_the_same_bytes_in_every_process() {
    alone_twice("prints_its_bytes");
}

#[test]
#[ignore = "run alone by the_same_recording_has_the_same_bytes_in_every_process"]
fn prints_its_bytes() {
    for seed in 0..200 {
        let form = random_form(seed);
        let layout = random_layout(seed, form.n_input, form.results.len());
        let hash = super::super::code::bytes(&form, &layout, Element::F64, true)
            .iter()
            .fold(0_u64, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3));
        println!("bytes of {seed}: {hash:016x}");
    }
}

fn alone_twice(name: &str) {
    let lines = || -> Vec<String> {
        alone(name).lines().filter(|line| line.starts_with("bytes of")).map(String::from).collect()
    };
    let first = lines();
    assert_eq!(first, lines());
    assert!(!is_made() || first.len() == 200);
}
