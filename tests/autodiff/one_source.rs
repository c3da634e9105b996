//! One definition of the physics: every scalar evaluates the same step to the same numbers.
//!
//! Hyperduals, wide duals and Taylor series take minutes to compile for every rotor count: they are compared for one, in
//! the tests of `dynamics::integrate`.

use crate::common::measure::larger;
use crate::common::{cases, input, relative, state, stream};
use num_dual::Dual64;
use omnidrones::autodiff::{Program, Recording, Scalar, System, Trace};
use omnidrones::dynamics::{Disturbance, Multirotor, Physics, Vehicle, World};

/// Random states per vehicle, integrator and set of effects.
const STATES: usize = 50;

/// One step over any scalar, constants lifted by `lift`.
fn step<S: Scalar>(system: &Multirotor, x: &[f64], u: &[f64], lift: impl Fn(usize, f64) -> S) -> Vec<S> {
    let x: Vec<S> = x.iter().enumerate().map(|(k, v)| lift(k, *v)).collect();
    let u: Vec<S> = u.iter().enumerate().map(|(k, v)| lift(x.len() + k, *v)).collect();
    let mut next = vec![S::zero(); x.len()];
    system.step(&x, &u, &[], &mut next);
    next
}

fn step_f64(system: &Multirotor, x: &[f64], u: &[f64]) -> Vec<f64> {
    step(system, x, u, |_, v| v)
}

/// `check(name, system, vehicle, physics, state, input)` at every random state of every case.
fn everywhere(seed: u64, mut check: impl FnMut(&str, &Multirotor, &[f64], &[f64])) {
    for (case, (name, vehicle, physics)) in cases().iter().enumerate() {
        let system = Multirotor::new(vehicle, *physics).unwrap();
        let mut r = stream(seed, case as u64);
        for k in 0..STATES {
            let (x, u) = (state(vehicle, &mut r), input(vehicle, physics, &mut r));
            check(&format!("{name}, seed {seed}, state {k}"), &system, &x, &u);
        }
    }
}

#[test]
fn the_value_of_a_dual_step_is_the_plain_step_bit_for_bit() {
    everywhere(10, |name, system, x, u| {
        let dual = step(system, x, u, |k, v| Dual64::new(v, (k as f64).cos()));
        let values: Vec<f64> = dual.iter().map(|d| d.re).collect();
        assert_eq!(values, step_f64(system, x, u), "{name}");
    });
}

#[test]
fn the_program_of_a_step_computes_the_plain_step() {
    let mut worst = 0.0_f64;
    for (case, (name, vehicle, physics)) in cases().iter().enumerate() {
        let system = Multirotor::new(vehicle, *physics).unwrap();
        let (n, m) = (system.n_state(), system.n_input());
        let recording = Recording::of(n + m, |z| {
            let mut next = vec![Trace::zero(); n];
            system.step(&z[..n], &z[n..], &[], &mut next);
            next
        });
        let program = Program::compile(&recording).unwrap();
        let mut workspace = program.workspace();
        let mut r = stream(14, case as u64);
        let mut next = vec![0.0; n];
        for k in 0..STATES {
            let (x, u) = (state(vehicle, &mut r), input(vehicle, physics, &mut r));
            program.evaluate(&mut workspace, &[&x[..], &u].concat(), &mut next);
            let error = relative(&next, &step_f64(&system, &x, &u));
            worst = larger(worst, error);
            assert!(error <= 1e-14, "{name}, seed 14, state {k}: {error:e}");
        }
    }
    println!("program against direct: {worst:.1e}"); // measured 0
}

#[test]
fn a_single_precision_step_is_the_double_one_to_single_precision() {
    let mut worst = 0.0_f64;
    everywhere(15, |name, system, x, u| {
        let (x, u) = (rounded(x), rounded(u));
        let single: Vec<f64> = step(system, &x, &u, |_, v| v as f32).into_iter().map(f64::from).collect();
        let error = relative(&single, &step_f64(system, &x, &u));
        worst = larger(worst, error);
        assert!(error <= 3e-6, "{name}: {error:e}");
    });
    println!("f32 against f64: {worst:.1e}"); // measured 5.1e-7
}

/// To numbers that `f32` holds, so that only the step's own rounding is compared.
fn rounded(x: &[f64]) -> Vec<f64> {
    x.iter().map(|v| f64::from(*v as f32)).collect()
}

fn narrow(x: &[f64]) -> Vec<f32> {
    x.iter().map(|v| *v as f32).collect()
}

#[test]
fn a_step_in_lanes_is_the_scalar_single_precision_step_to_rounding() {
    let mut worst = 0.0_f64;
    for (case, (name, vehicle, physics)) in cases().iter().enumerate() {
        let mut r = stream(16, case as u64);
        let samples: Vec<_> = (0..STATES).map(|_| (state(vehicle, &mut r), input(vehicle, physics, &mut r))).collect();
        let error = lanes_against_scalar(vehicle, *physics, &samples);
        worst = larger(worst, error);
        assert!(error <= 1e-6, "{name}, seed 16: {error:e}");
    }
    println!("lanes against scalar f32: {worst:.1e}"); // measured 1.8e-7
}

fn lanes_against_scalar(vehicle: &Vehicle, physics: Physics, samples: &[(Vec<f64>, Vec<f64>)]) -> f64 {
    let system = Multirotor::new(vehicle, physics).unwrap();
    let mut world = World::new(vehicle, physics, samples.len()).unwrap();
    let n = vehicle.n_rotor();
    let mut actions = Vec::new();
    for (k, (x, u)) in samples.iter().enumerate() {
        world.set_state(k, &narrow(x)).unwrap();
        if physics.effects.disturbance {
            world.set_disturbance(k, &Disturbance::read(&narrow(&u[n..]))).unwrap();
        }
        actions.extend(narrow(&u[..n]));
    }
    world.step(&actions).unwrap();
    let mut worst = 0.0_f64;
    for (k, (x, u)) in samples.iter().enumerate() {
        let lane: Vec<f64> = world.state(k).unwrap().into_iter().map(f64::from).collect();
        let scalar: Vec<f64> = step(&system, x, u, |_, v| v as f32).into_iter().map(f64::from).collect();
        worst = larger(worst, relative(&lane, &scalar));
    }
    worst
}

#[test]
fn a_kernel_that_divides_would_be_seen() {
    // the twin: num-dual divides by multiplying with the reciprocal, which rounds twice; kernels therefore do so too
    let mut r = stream(17, 0);
    let mut differ = [0, 0];
    for _ in 0..1000 {
        let (a, b) = (r.uniform(0.1, 10.0), r.uniform(0.1, 10.0));
        let (da, db) = (Dual64::from(a), Dual64::from(b));
        differ[0] += usize::from((da / db).re != a / b);
        differ[1] += usize::from((da * Scalar::recip(db)).re != a * Scalar::recip(b));
    }
    println!("{differ:?}");
    assert!(differ[0] > 100 && differ[1] == 0, "{differ:?}"); // measured 228 and 0
}
