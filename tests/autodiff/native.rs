//! Machine code of everything that is recorded has the interpreter's bits.

use crate::common::{cases, input, state, stream};
use omnidrones::autodiff::native::{Executable, RowLayout, Rows, WhyInterpreted, availability, instructions};
use omnidrones::autodiff::program::BLOCK;
use omnidrones::autodiff::{Program, Recording, Scalar, System, Trace, instruction_set};
use omnidrones::dynamics::tree::Multibody;
use omnidrones::dynamics::{Effects, Integrator, Multirotor, Physics, configurations};
use omnidrones::tasks::{Env, EnvConfig, registry};
use std::process::Command;

/// Numbers near these, the first as they are; some of them zero, negative zero, huge, infinite or NaN.
fn near(point: &[f64], seed: u64) -> Vec<Vec<f64>> {
    let mut r = stream(58, seed);
    let odd = [0.0, -0.0, 1e30, -1e30, f64::INFINITY, f64::NAN, 1e-40];
    let mut varied = |k: usize, x: f64| match r.below(40) {
        0 if k % 4 == 3 => odd[r.below(7) as usize],
        _ if k == 0 => x,
        _ => x * r.uniform(0.9, 1.1) + r.uniform(-0.01, 0.01),
    };
    (0..BLOCK).map(|k| point.iter().map(|x| varied(k, *x)).collect()).collect()
}

/// Compares a program's results both ways at 64 points: in `f64` one by one, eight side by side, in lanes whole and in part.
fn compare(name: &str, program: &Program, point: &[f64], seed: u64) {
    let points = near(point, seed);
    let same64 = |a: f64, b: f64| a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan();
    let same32 = |a: f32, b: f32| a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan();
    let (n, m) = (program.n_input(), program.n_output());
    let eight: Executable<[f64; 8]> = Executable::new(program, RowLayout::apart(n, m)).unwrap();
    let rows: Vec<[f64; 8]> = (0..n).map(|k| std::array::from_fn(|l| points[l][k])).collect();
    let mut side_by_side = vec![[0.0; 8]; m];
    eight.run(&mut eight.work(), &mut [Rows::Read(&rows), Rows::Write(&mut side_by_side)], 8).unwrap();
    let (mut native, mut interpreted) = (vec![0.0; m], vec![0.0; m]);
    let (mut own, mut other) = (program.workspace(), program.interpreter_workspace());
    for (l, z) in points.iter().enumerate() {
        program.evaluate(&mut own, z, &mut native);
        program.evaluate(&mut other, z, &mut interpreted);
        for k in 0..m {
            assert!(
                same64(native[k], interpreted[k]),
                "{name}: point {l}, result {k}: {} {}",
                native[k],
                interpreted[k]
            );
            assert!(l >= 8 || same64(side_by_side[k][l], interpreted[k]), "{name}: step {l} of eight, result {k}");
        }
    }
    let block: Vec<[f32; BLOCK]> = (0..n).map(|k| std::array::from_fn(|l| points[l][k] as f32)).collect();
    let mut interpreted = vec![[0.0; BLOCK]; m];
    program.evaluate_block(&mut program.interpreter_block_workspace(), &block, &mut interpreted);
    let lanes: Executable<[f32; BLOCK]> = Executable::new(program, RowLayout::apart(n, m)).unwrap();
    for n_env in [1, 9, 33, BLOCK] {
        let mut native = vec![[f32::NAN; BLOCK]; m];
        lanes.run(&mut lanes.work(), &mut [Rows::Read(&block), Rows::Write(&mut native)], n_env).unwrap();
        for (k, l) in (0..m).flat_map(|k| (0..n_env).map(move |l| (k, l))) {
            let (native, interpreted) = (native[k][l], interpreted[k][l]);
            assert!(same32(native, interpreted), "{name}: {n_env} lanes, lane {l}, result {k}: {native} {interpreted}");
        }
    }
    // a Jacobian of six drones and a platform by RK4 has over a million steps in f64
    for why in [lanes.why_interpreted(), eight.why_interpreted()] {
        assert!(availability().is_err() || matches!(why, None | Some(WhyInterpreted::TooLarge)), "{name}: {why:?}");
    }
}

/// A step, its adjoint and its Jacobian.
fn compare_system<F: System>(name: &str, system: &F, x: &[f64], u: &[f64], seed: u64) {
    let (n, m) = (system.n_state(), system.n_input());
    let recording = Recording::of(n + m, |z| {
        let mut next = vec![Trace::constant(0.0); n];
        system.step(&z[..n], &z[n..], &[], &mut next);
        next
    });
    let point = [x, u].concat();
    let seeds: Vec<f64> = (0..n).map(|k| (k as f64).cos()).collect();
    compare(&format!("{name}, step"), &Program::compile(&recording).unwrap(), &point, seed);
    let adjoint = Program::compile(&recording.adjoint(0..n + m)).unwrap();
    compare(&format!("{name}, adjoint"), &adjoint, &[&point[..], &seeds].concat(), seed);
    let jacobian = Program::compile(&recording.jacobian(0..n + m)).unwrap();
    compare(&format!("{name}, Jacobian"), &jacobian, &point, seed);
}

#[test]
fn steps_adjoints_and_jacobians_of_every_vehicle_are_the_interpreters_to_the_bit() {
    for (case, (name, vehicle, physics)) in cases().iter().enumerate() {
        let mut r = stream(59, case as u64);
        let (x, u) = (state(vehicle, &mut r), input(vehicle, physics, &mut r));
        compare_system(name, &Multirotor::new(vehicle, *physics).unwrap(), &x, &u, case as u64);
    }
}

/// Whether code may be made. Where not, vehicles alone show that the interpreter behind an `Executable` is the interpreter.
fn is_made() -> bool {
    availability().inspect_err(|why| println!("not run: no code is made here: {why}")).is_ok()
}

#[test]
fn steps_adjoints_and_jacobians_of_every_configuration_are_the_interpreters_to_the_bit() {
    if !is_made() {
        return;
    }
    for (case, model) in configurations::all().unwrap().iter().enumerate() {
        for integrator in [Integrator::SemiImplicit, Integrator::RungeKutta4] {
            let physics = Physics { dt: 0.016, substeps: 1, integrator, effects: Effects::lean() };
            let system = Multibody::new(model, physics).unwrap();
            let mut x = system.rest_state();
            x.iter_mut().enumerate().for_each(|(k, x)| *x += 0.01 * (1.0 + k as f64).sin());
            let u = vec![-0.2; system.n_input()];
            compare_system(&format!("{} by {integrator:?}", model.name()), &system, &x, &u, case as u64);
        }
    }
}

#[test]
fn adjoints_of_every_task_are_the_interpreters_to_the_bit() {
    if !is_made() {
        return;
    }
    for (seed, task) in registry::names().into_iter().enumerate() {
        let env = Env::make(task, &EnvConfig { n_env: 1, ..EnvConfig::default() }).unwrap();
        let Ok(adjoint) = env.adjoint(false) else { continue };
        let program = adjoint.program();
        let mut point = env.ideal_arguments();
        point.resize(program.n_input(), 0.3);
        compare(task, program, &point, seed as u64);
    }
}

#[test]
fn what_computes_is_told_as_programs_then_run() {
    let shortest = Program::compile(&Recording::of(1, |x| vec![x[0] * x[0]])).unwrap();
    let how = match shortest.why_interpreted() {
        None => "machine code".to_string(),
        Some(why) => format!("interpreted: {why}"),
    };
    assert_eq!(instructions(), format!("{} ({how})", instruction_set()));
    println!("told: {}", instructions());
}

/// In processes of their own: the switch is read once.
#[test]
fn a_switch_that_is_off_is_the_reason_that_is_told() {
    let told = |switch: &str| {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "native::what_computes_is_told_as_programs_then_run", "--nocapture"]);
        let output = command.env("OMNIDRONES_NATIVE", switch).output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success() && text.contains("1 passed"), "{switch}: {text}");
        text.lines().find_map(|line| line.split_once("told: ")).expect("what is told").1.to_string()
    };
    let (set, off) = (instruction_set(), "interpreted: switched off by OMNIDRONES_NATIVE=off");
    for switch in ["off", "OFF", "0"] {
        assert_eq!(told(switch), format!("{set} ({off})"), "{switch}");
    }
    for switch in ["on", "", "1"] {
        assert!(!told(switch).contains(off), "{switch}");
    }
}
