//! Every gradient is right, finite, and cheap to check: adjoint, duals and differences agree.

use crate::Worst;
use crate::common::measure::larger;
use crate::common::{airframe, cases, input, state, stream};
use omnidrones::autodiff::{
    Certificate, CertificateBounds, CompiledJacobian, JacobianScratch, Objective, Rollout, Scalar, System, certify,
    jacobian, linearise, safe,
};
use omnidrones::controllers::{ClosedLoop, Rates, Reference, Target};
use omnidrones::dynamics::tree::Multibody;
use omnidrones::dynamics::{Disturbance, Effects, Multirotor, Physics, configurations, vehicles};

/// Certifies `n` random states of every vehicle with each of two integrators and four sets of effects.
fn certify_states(n: usize) {
    let mut worst = Worst::default();
    for (case, (name, vehicle, physics)) in cases().iter().enumerate() {
        let system = Multirotor::new(vehicle, *physics).unwrap();
        let mut r = stream(20, case as u64);
        for k in 0..n {
            let (x, u) = (state(vehicle, &mut r), input(vehicle, physics, &mut r));
            worst.certify(&format!("{name}, seed 20, state {k}"), &system, &x, &u, &[]);
        }
    }
    worst.print();
}

#[test]
fn the_certificate_holds_for_every_vehicle_integrator_and_effect_at_random_states() {
    certify_states(5); // measured 3.1e-15, 5.0e-9, 0.018
}

#[test]
#[ignore = "cargo test --test autodiff -- --ignored two_hundred_states: ten seconds"]
fn the_certificate_holds_at_two_hundred_states_of_every_vehicle() {
    certify_states(25); // measured 3.1e-15, 5.8e-9, 0.020
}

#[test]
fn the_certificate_holds_with_every_physical_parameter_exposed() {
    let mut worst = Worst::default();
    for (case, (name, vehicle, physics)) in cases().iter().enumerate() {
        let system = Multirotor::new(vehicle, *physics).unwrap().with_parameters();
        let mut r = stream(21, case as u64);
        let (x, u) = (state(vehicle, &mut r), input(vehicle, physics, &mut r));
        worst.certify(&format!("{name}, seed 21"), &system, &x, &u, &system.parameters());
    }
    worst.print(); // measured 2.0e-14, 4.9e-9, 0.016
}

/// Weights on everything, so that no entry of the state is out of the cost's sight.
struct Track;
impl Objective for Track {
    fn stage<S: Scalar>(&self, x: &[S], u: &[S], _: &[S]) -> S {
        let mut cost = S::zero();
        for (k, x) in x.iter().enumerate() {
            let weight = if k < 13 { 0.1 + 0.01 * k as f64 } else { 1e-7 };
            cost += S::constant(weight) * x.square();
        }
        for u in u {
            cost += S::constant(1e-2) * u.square();
        }
        cost
    }
    fn terminal<S: Scalar>(&self, x: &[S], _: &[S]) -> S {
        x[0].square() + x[4] * x[2] + x[10].square()
    }
}

/// Largest |a − b| relative to max(1, ‖a‖∞).
fn distance(a: &[f64], b: &[f64]) -> f64 {
    let scale = a.iter().fold(1.0, |s: f64, x| s.max(x.abs()));
    let error = a.iter().zip(b).map(|(x, y)| (x - y).abs());
    error.fold(0.0, |m: f64, e| if e.is_nan() { f64::INFINITY } else { m.max(e) }) / scale
}

/// Actions around hover that cross ±1 and go beyond.
fn saturating(system: &Multirotor, steps: usize, r: &mut omnidrones::rng::Stream) -> Vec<f64> {
    let hover = system.hover_input().unwrap();
    (0..steps).flat_map(|_| hover.iter().map(|u| u + r.uniform(-1.6, 1.6)).collect::<Vec<_>>()).collect()
}

#[test]
fn the_adjoint_of_a_rollout_is_its_dual_gradient_through_motor_saturation() {
    let mut worst = 0.0_f64;
    for (case, vehicle) in vehicles::all().iter().map(airframe).enumerate() {
        for integrator in crate::common::INTEGRATORS {
            let physics = Physics { integrator, ..Physics::default() };
            let system = Multirotor::new(&vehicle, physics).unwrap();
            let rollout = Rollout::new(system.clone(), Track).unwrap();
            for steps in [1, 10, 100, 500] {
                let mut r = stream(22, case as u64);
                let x = system.hover_state([0.3, -0.4, 5.0]).unwrap();
                let u = saturating(&system, steps, &mut r);
                let (cost, reverse) = rollout.gradient(&x, &u, &[]);
                let (same, forward) = rollout.gradient_forward(&x, &u, &[]);
                assert_eq!(cost, same, "the cost is the same number either way");
                assert_eq!(cost, rollout.cost(&x, &u, &[]));
                let error = distance(&forward.state, &reverse.state);
                worst = larger(worst, error);
                assert!(error <= 5e-13, "{} {integrator:?} {steps} steps, seed 22: {error:e}", vehicle.name);
            }
        }
    }
    println!("reverse against forward: {worst:.1e}"); // measured 4.8e-15
}

#[test]
fn the_adjoint_of_a_closed_loop_is_its_dual_gradient_in_state_and_gains() {
    struct Miss;
    impl Objective for Miss {
        fn stage<S: Scalar>(&self, x: &[S], u: &[S], _: &[S]) -> S {
            (x[0] - u[0]).square() + (x[1] - u[1]).square() + (x[2] - u[2]).square()
        }
    }
    let mut worst = 0.0_f64;
    for vehicle in vehicles::all() {
        let physics = Physics::default();
        let system =
            ClosedLoop::of_vehicle(&vehicle, physics, &vehicle.gains(), &Rates::default()).unwrap().with_gains();
        let reference = Reference::by_name("lemniscate").unwrap();
        let plant = Multirotor::new(&vehicle, physics).unwrap();
        let state = system.initial_state(&plant.hover_state([0.8, -0.6, 0.5]).unwrap());
        let theta = system.parameters();
        let rollout = Rollout::new(system.clone(), Miss).unwrap();
        for steps in [1, 10, 100, 500] {
            let mut inputs = vec![0.0; steps * system.n_input()];
            for (k, row) in inputs.chunks_mut(system.n_input()).enumerate() {
                system.write_input(k as u64, Target::level(&reference), &Disturbance::none(), row);
            }
            let (cost, reverse) = rollout.gradient(&state, &inputs, &theta);
            let (same, forward) = rollout.gradient_forward(&state, &inputs, &theta);
            assert_eq!(cost, same);
            let error =
                distance(&forward.state, &reverse.state).max(distance(&forward.parameters, &reverse.parameters));
            worst = larger(worst, error);
            assert!(error <= 3e-13, "{} {steps} steps: {error:e}", vehicle.name);
            assert!(steps < 100 || reverse.parameters.iter().any(|g| g.abs() > 1e-6), "gains must matter");
        }
    }
    println!("closed loop, reverse against forward: {worst:.1e}"); // measured 3.5e-15
}

#[test]
fn the_adjoint_of_a_rollout_is_its_dual_gradient_in_every_physical_parameter() {
    let mut worst = 0.0_f64;
    for (case, vehicle) in vehicles::all().iter().map(airframe).enumerate() {
        let system = Multirotor::new(&vehicle, Physics::default()).unwrap().with_parameters();
        let rollout = Rollout::new(system.clone(), Track).unwrap();
        for steps in [1, 10, 100] {
            let mut r = stream(23, case as u64);
            let x = system.hover_state([0.3, -0.4, 5.0]).unwrap();
            let u = saturating(&system, steps, &mut r);
            let theta = system.parameters();
            let (_, reverse) = rollout.gradient(&x, &u, &theta);
            let (_, forward) = rollout.gradient_forward(&x, &u, &theta);
            // a coefficient of 1e-8 has a gradient of 1e8: compare what a per cent of each is worth
            let worth = |g: &[f64]| -> Vec<f64> {
                g.iter().zip(&theta).map(|(g, p)| g * if *p == 0.0 { 1e-6 } else { p.abs() }).collect()
            };
            let error = distance(&worth(&forward.parameters), &worth(&reverse.parameters))
                .max(distance(&forward.state, &reverse.state));
            worst = larger(worst, error);
            assert!(error <= 1e-13, "{} {steps} steps, seed 23: {error:e}", vehicle.name);
        }
    }
    println!("reverse against forward: {worst:.1e}"); // measured 1.2e-15
}

#[test]
fn the_adjoint_in_the_inputs_is_that_of_central_differences_and_zero_where_saturated() {
    let mut worst = 0.0_f64;
    for (case, vehicle) in vehicles::all().iter().map(airframe).enumerate() {
        let system = Multirotor::new(&vehicle, Physics::default()).unwrap();
        let rollout = Rollout::new(system.clone(), Track).unwrap();
        let m = system.n_input();
        for steps in [1, 10, 100, 500] {
            let mut r = stream(24, case as u64);
            let x = system.hover_state([0.3, -0.4, 5.0]).unwrap();
            let mut u = saturating(&system, steps, &mut r);
            let (_, gradient) = rollout.gradient(&x, &u, &[]);
            let scale = gradient.inputs.iter().fold(1.0, |s: f64, g| s.max(g.abs()));
            for _ in 0..12 {
                let k = r.below((steps * m) as u64) as usize;
                let (at, h) = (u[k], 1e-6);
                if (at.abs() - 1.0).abs() < 1e-3 {
                    continue; // at the kink itself there is no slope to compare with
                }
                u[k] = at + h;
                let plus = rollout.cost(&x, &u, &[]);
                u[k] = at - h;
                let minus = rollout.cost(&x, &u, &[]);
                u[k] = at;
                let error = ((plus - minus) / (2.0 * h) - gradient.inputs[k]).abs() / scale;
                worst = larger(worst, error);
                assert!(error <= 2e-7, "{} {steps} steps, entry {k}, seed 24: {error:e}", vehicle.name);
                if at.abs() > 1.0 {
                    let effort = 0.02 * at;
                    assert!((gradient.inputs[k] - effort).abs() <= 1e-12, "only effort counts beyond saturation");
                }
            }
        }
    }
    println!("adjoint against central differences: {worst:.1e}"); // measured 2.5e-8
}

/// The corners where naive kinematics, norms and motors have no derivative.
fn corners(system: &Multirotor) -> Vec<(&'static str, Vec<f64>, Vec<f64>)> {
    let hover = system.hover_state([0.0, 0.0, 1.0]).unwrap();
    let command = system.hover_input().unwrap();
    let n = system.vehicle().n_rotor();
    let with = |edit: &dyn Fn(&mut Vec<f64>, &mut Vec<f64>)| {
        let (mut x, mut u) = (hover.clone(), command.clone());
        edit(&mut x, &mut u);
        (x, u)
    };
    let bottom = system.vehicle().rotors.iter().map(|r| r.position[2]).fold(f64::INFINITY, f64::min);
    type Point = (Vec<f64>, Vec<f64>);
    let list: Vec<(&'static str, Point)> = vec![
        ("exact hover: zero velocity, identity attitude, zero wind, motors at their command", with(&|_, _| ())),
        ("origin", with(&|x, _| x[..3].fill(0.0))),
        ("rotors on the ground", with(&|x, _| x[2] = -bottom)),
        ("rotors under the ground", with(&|x, _| x[2] = -1.0)),
        ("rotors at half a radius", with(&|x, _| x[2] = 0.5 * system.vehicle().rotors[0].radius - bottom)),
        ("commands at +1", with(&|_, u| u[..n].fill(1.0))),
        ("commands at -1", with(&|_, u| u[..n].fill(-1.0))),
        ("commands beyond -1", with(&|_, u| u[..n].fill(-1e9))),
        ("commands beyond +1", with(&|_, u| u[..n].fill(1e9))),
        ("standing rotors", with(&|x, _| x[13..].fill(0.0))),
        (
            "everything zero but the attitude",
            with(&|x, u| {
                x.fill(0.0);
                x[6] = 1.0;
                u.fill(0.0);
            }),
        ),
        ("half a turn", with(&|x, _| x[6..10].copy_from_slice(&[0.0, 0.0, 1.0, 0.0]))),
        (
            "wind as fast as the vehicle",
            with(&|x, u| {
                x[3] = 2.0;
                if u.len() > n {
                    u[n] = 2.0;
                }
            }),
        ),
    ];
    list.into_iter().map(|(name, (x, u))| (name, x, u)).collect()
}

#[test]
fn no_gradient_is_nan_on_a_corner() {
    let mut worst = 0.0_f64;
    for (name, vehicle, physics) in cases() {
        let plain = Multirotor::new(&vehicle, physics).unwrap();
        for (system, theta) in [(plain.clone(), vec![]), (plain.clone().with_parameters(), plain.parameters())] {
            let rollout = Rollout::new(system.clone(), Track).unwrap();
            for (corner, x, u) in corners(&system) {
                let (cost, g) = rollout.gradient(&x, &u, &theta);
                let finite = g.state.iter().chain(&g.inputs).chain(&g.parameters).all(|g| g.is_finite());
                assert!(finite && cost.is_finite(), "adjoint of {name}: {corner}");
                let l = linearise(&system, &x, &u, &theta);
                let finite = l.state.iter().chain(l.input.iter()).chain(l.parameters.iter()).all(|d| d.is_finite());
                assert!(finite, "duals of {name}: {corner}");
                let (_, forward) = rollout.gradient_forward(&x, &u, &theta);
                let error = distance(&forward.state, &g.state);
                worst = larger(worst, error);
                assert!(error <= 2e-14, "{name}: {corner}: {error:e}");
            }
        }
    }
    println!("reverse against forward on corners: {worst:.1e}"); // measured 2.2e-16
}

/// A toy whose step is one expression, to break on purpose.
struct Toy<const KIND: u8>;
const RAW_NORM: u8 = 0;
const SAFE_NORM: u8 = 1;
const KINK: u8 = 2;
const MASKED_ROOT: u8 = 3;
const BLIND: u8 = 4;
const SECANT: u8 = 5;

/// A smooth step with one lag up and another down, as of a motor; its derivatives are too large by a share of `wrong`.
struct TwoLags {
    wrong: f64,
}

impl System for TwoLags {
    fn n_state(&self) -> usize {
        2
    }
    fn n_input(&self) -> usize {
        1
    }
    fn step<S: Scalar>(&self, x: &[S], u: &[S], _: &[S], next: &mut [S]) {
        let lag = S::select(x[0].lt(u[0]), S::constant(0.3), S::constant(0.1));
        let pull = (x[1] * S::constant(3.0)).sin_cos().0;
        let bent = |own: S| own.detach() + S::constant(1.0 + self.wrong) * (own - own.detach());
        next[0] = bent((u[0] - x[0]).mul_add(lag, x[0]));
        next[1] = bent(x[0] * pull);
    }
}

impl<const KIND: u8> System for Toy<KIND> {
    fn n_state(&self) -> usize {
        2
    }
    fn n_input(&self) -> usize {
        1
    }
    fn step<S: Scalar>(&self, x: &[S], u: &[S], _: &[S], next: &mut [S]) {
        let squared = x[0].square() + x[1].square();
        let o = S::zero();
        next[0] = match KIND {
            RAW_NORM => squared.sqrt(),
            SAFE_NORM => safe::sqrt(squared, 1e-18),
            MASKED_ROOT => S::select(o.lt(squared), squared.sqrt(), o),
            KINK => x[0].abs() + u[0],
            SECANT => {
                let (still, bend) = (x[0].detach(), x[0].detach() - S::constant(1.0 + 1e-5));
                let slope = S::constant(1.0 + 0.5 * (1.8e-4 - 1e-5) / 1.8e-4);
                still + slope * (x[0] - still) + bend.max(o) + u[0]
            }
            // the value of a branch, not its derivative: a step whose slope duals cannot see
            _ => S::select(o.lt(x[0]), S::one(), S::zero()) * u[0] + (x[0] * S::constant(1e9)).sin_cos().0,
        };
        next[1] = x[1] + u[0] * u[0];
    }
}

#[test]
fn an_unguarded_norm_gives_a_nan_adjoint_and_no_certificate() {
    struct Sum;
    impl Objective for Sum {
        fn stage<S: Scalar>(&self, _: &[S], _: &[S], _: &[S]) -> S {
            S::zero()
        }
        fn terminal<S: Scalar>(&self, x: &[S], _: &[S]) -> S {
            x[0]
        }
    }
    let adjoint = |g: omnidrones::autodiff::Gradient| g.state[0];
    let (x, u) = ([0.0, 0.0], [0.5]);
    assert!(adjoint(Rollout::new(Toy::<RAW_NORM>, Sum).unwrap().gradient(&x, &u, &[]).1).is_nan());
    assert!(adjoint(Rollout::new(Toy::<MASKED_ROOT>, Sum).unwrap().gradient(&x, &u, &[]).1).is_nan());
    assert_eq!(adjoint(Rollout::new(Toy::<SAFE_NORM>, Sum).unwrap().gradient(&x, &u, &[]).1), 0.0);
    for c in [certify(&Toy::<RAW_NORM>, &x, &u, &[]), certify(&Toy::<MASKED_ROOT>, &x, &u, &[])] {
        let c = c.unwrap();
        assert!(!c.holds(CertificateBounds::default()) && c.adjoint_error == f64::INFINITY, "{c}");
    }
}

#[test]
fn a_kink_at_the_point_or_a_slope_that_is_not_the_functions_own_breaks_the_certificate() {
    let kink = certify(&Toy::<KINK>, &[0.0, 1.0], &[0.5], &[]).unwrap();
    assert!(kink.difference_error > 0.5 && !kink.holds(CertificateBounds::default()), "{kink}");
    let beside = certify(&Toy::<KINK>, &[0.7, 1.0], &[0.5], &[]).unwrap();
    assert!(beside.holds(CertificateBounds::default()), "{beside}");
    // no step is chosen because it agrees: this slope is the difference over the kink, at one length of step
    let secant = certify(&Toy::<SECANT>, &[1.0, 1.0], &[0.5], &[]).unwrap();
    assert!(secant.difference_error > 0.3 && !secant.holds(CertificateBounds::default()), "{secant}"); // measured 0.32
    let unknown = Certificate { taylor_order: Some(f64::NAN), ..beside };
    assert!(!unknown.holds(CertificateBounds::default()), "{unknown}");
    let blind = certify(&Toy::<BLIND>, &[0.3, 1.0], &[0.5], &[]).unwrap();
    assert!(!blind.holds(CertificateBounds::default()), "{blind}");
}

#[test]
fn a_kink_is_named_and_a_wrong_derivative_is_caught_beside_it() {
    let bounds = CertificateBounds::default();
    for side in [1.0, -1.0] {
        for size in [1e-2, 1.0, 1e3] {
            for gap in [0.0, 1e-15, 1e-12] {
                let at = size * (1.0 + side * gap);
                let kink = certify(&TwoLags { wrong: 0.0 }, &[at, 0.4], &[size], &[]).unwrap();
                // along x0 and u0
                assert!(kink.kinks == 2 && !kink.holds(bounds), "{side} {size} {gap}: {kink}");
            }
            for apart in [1e-2, 1e-3] {
                let point = [size * (1.0 + side * apart), 0.4];
                let right = certify(&TwoLags { wrong: 0.0 }, &point, &[size], &[]).unwrap();
                assert!(right.holds(bounds), "{side} {size} {apart}: {right}");
                for wrong in [1e-1, 1e-4, 1e-6, -1e-6] {
                    let caught = certify(&TwoLags { wrong }, &point, &[size], &[]).unwrap();
                    assert!(!caught.holds(bounds) && caught.kinks == 0, "{side} {size} {apart} {wrong:e}: {caught}");
                }
            }
        }
    }
}

#[test]
fn a_kink_is_told_from_a_smooth_bend_of_any_sharpness() {
    struct Bend(f64);
    impl System for Bend {
        fn n_state(&self) -> usize {
            1
        }
        fn n_input(&self) -> usize {
            0
        }
        fn step<S: Scalar>(&self, x: &[S], _: &[S], _: &[S], next: &mut [S]) {
            next[0] = safe::sqrt(x[0].square() + S::constant(self.0 * self.0), 0.0);
        }
    }
    for radius in [1e-4, 1e-2, 1.0, 1e3] {
        for at in [0.0, 0.3, -0.3] {
            let c = certify(&Bend(radius), &[at], &[], &[]).unwrap();
            assert!(c.kinks == 0 && c.holds(CertificateBounds::default()), "{radius} at {at}: {c}");
        }
    }
}

#[test]
fn differentiating_changes_neither_the_state_nor_the_system() {
    let vehicle = vehicles::by_name("firefly").unwrap();
    let system = Multirotor::new(&vehicle, Physics { effects: Effects::all(), ..Physics::default() }).unwrap();
    let mut r = stream(25, 0);
    let (x, u) = (state(&vehicle, &mut r), input(&vehicle, system.physics(), &mut r));
    let step = || {
        let mut next = x.clone();
        system.step(&x, &u, &[], &mut next);
        next.iter().map(|v| v.to_bits()).collect::<Vec<_>>()
    };
    let before = step();
    let _ = (linearise(&system, &x, &u, &[]), certify(&system, &x, &u, &[]).unwrap());
    assert_eq!(before, step());
}

#[test]
fn the_compiled_jacobian_is_that_of_the_duals_for_every_vehicle() {
    for vehicle in vehicles::all() {
        let system = Multirotor::new(&vehicle, Physics::default()).unwrap();
        let mut x = system.hover_state([0.3, -0.2, 1.0]).unwrap();
        for (k, v) in x.iter_mut().enumerate() {
            *v += 0.1 * (1.0 + k as f64).sin();
        }
        let u = vec![0.2; system.n_input()];
        let mut dual = vec![0.0; x.len() * (x.len() + u.len())];
        let mut compiled = dual.clone();
        jacobian(&system, &x, &u, &[], &mut JacobianScratch::new(&system), &mut dual);
        CompiledJacobian::new(&system).unwrap().evaluate(&x, &u, &[], &mut compiled);
        let scale = dual.iter().fold(1.0, |a: f64, b| a.max(b.abs()));
        let worst = dual.iter().zip(&compiled).map(|(a, b)| (a - b).abs()).fold(0.0, larger) / scale;
        println!("{}: {worst:.1e}", vehicle.name);
        assert!(worst <= 1e-13, "{}: {worst:.1e}", vehicle.name); // measured 1.4e-15
    }
}

#[test]
fn the_compiled_jacobian_is_that_of_the_duals_for_every_configuration() {
    let mut worst = 0.0_f64;
    for (case, model) in configurations::all().unwrap().iter().enumerate() {
        let system = Multibody::new(model, Physics::default()).unwrap();
        let mut r = stream(29, case as u64);
        let mut x: Vec<f64> = system.rest_state().iter().map(|x| x + r.uniform(-0.1, 0.1)).collect();
        for (at, mounted) in system.layout().rotor_speed.iter().zip(model.rotors()) {
            x[*at] = mounted.rotor.max_speed * r.uniform(0.2, 0.9);
        }
        let u: Vec<f64> = (0..system.n_input()).map(|_| r.uniform(-0.9, 0.9)).collect();
        let mut dual = vec![0.0; x.len() * (x.len() + u.len())];
        let mut compiled = dual.clone();
        jacobian(&system, &x, &u, &[], &mut JacobianScratch::new(&system), &mut dual);
        CompiledJacobian::new(&system).unwrap().evaluate(&x, &u, &[], &mut compiled);
        let columns = dual.chunks_exact(x.len()).zip(compiled.chunks_exact(x.len()));
        let own = columns.map(|(a, b)| distance(a, b)).fold(0.0, larger);
        println!("{}: {own:.1e}", model.name());
        worst = larger(worst, own);
    }
    assert!(worst <= 1e-12, "{worst:e}"); // measured 8.0e-13 of dragon, 3.5e-13 of platform_2, 2.4e-15 of the others
}
