//! Contract: RK4 is of fourth order on smooth motion, the semi-implicit step of first order with the same limit; a
//! trajectory is as exact as its step allows.
//!
//! Drives are left out: they are sampled once per step by design.

use super::common::*;
use crate::common::measure::larger;
use nalgebra::{DVector, Quaternion};
use omnidrones::dynamics::tree::{Model, Motion, Multibody, inverse_dynamics, mass_matrix};
use omnidrones::dynamics::{Effects, Physics};

/// Rotors at work in opposite ways, hence both time constants, damping and drag as published.
fn end(model: &Model, physics: Physics, duration: f64) -> Vec<f64> {
    let system = Multibody::new(&loose(model), physics).unwrap();
    let (mut x, mut u) = (in_motion(&system, 3, 0.8), system.rest_input());
    for (k, (action, rotor)) in u.iter_mut().zip(model.rotors()).enumerate() {
        *action = if k % 2 == 0 { 0.1 } else { -0.3 };
        x[system.layout().rotor_speed[k]] = 0.65 * rotor.rotor.max_speed;
    }
    fly(&system, &mut x, &u, (duration / physics.dt).round() as usize);
    x
}

fn order(model: &Model, of: fn(f64, Effects) -> Physics, dt: f64, best: f64) -> f64 {
    let n = model.layout().n_state() - model.rotors().len();
    let run = |physics| end(model, physics, 0.4)[..n].to_vec();
    let best = run(rk4(best, Effects::default()));
    let error = |dt| apart(&run(of(dt, Effects::default())), &best);
    (error(dt) / error(0.5 * dt)).log2()
}

#[test]
fn rk4_converges_with_order_four() {
    // 4 ms resolve every damper but that of platform_2
    for (name, model) in configurations().filter(|(name, model)| floats(model) && *name != "platform_2") {
        // measured 3.980 dragon to 4.003 Omav
        near(&format!("{name}: order of RK4"), order(&model, rk4, 0.004, 1.25e-4), 4.0, 0.1);
    }
}

#[test]
fn the_semi_implicit_step_converges_with_order_one_to_the_same_limit() {
    for (name, model) in configurations().filter(|(_, model)| floats(model)) {
        let order = order(&model, semi_implicit, 0.001, 1.25e-4);
        // measured 0.989 dragon to 1.003
        near(&format!("{name}: order of the semi-implicit step"), order, 1.0, 0.1);
    }
}

#[test]
fn a_sampled_drive_would_be_caught_by_the_order() {
    // twin, and the reason why drives are left out above: bends and gimbals of the dragon at work
    let run = |dt: f64| {
        let system = Multibody::new(&configuration("dragon"), rk4(dt, Effects::default())).unwrap();
        let mut x = in_motion(&system, 3, 0.8);
        fly(&system, &mut x, &vec![0.3; system.layout().n_input()], (0.4 / dt).round() as usize);
        x
    };
    let best = run(1.25e-4);
    let order = (apart(&run(0.004), &best) / apart(&run(0.002), &best)).log2();
    println!("order with drives {order:.2}");
    assert!(order < 2.0, "{order}");
}

/// Largest |Δ| over the state after 10 s at 1 ms, unactuated, under gravity, from where a reference ends.
fn trajectory_error(name: &str, reference: fn(&Multibody, Vec<f64>) -> Vec<f64>) -> f64 {
    let system = Multibody::new(&still(&loose(&configuration(name))), rk4(1e-3, Effects::none())).unwrap();
    let start = in_motion(&system, 5, 0.8);
    let mut x = start.clone();
    fly(&system, &mut x, &[], 10_000);
    x.iter().zip(reference(&system, start)).map(|(a, b)| (a - b).abs()).fold(0.0, larger)
}

/// The same system at a quarter of the step.
fn finer(system: &Multibody, mut x: Vec<f64>) -> Vec<f64> {
    let finer = Multibody::new(system.model(), rk4(2.5e-4, Effects::none())).unwrap();
    fly(&finer, &mut x, &[], 40_000);
    x
}

/// d/dt of a state from M ν̇ = τ − RNEA(q, ν, 0) and kinematics written here: nothing of the forward algorithm is in it.
fn by_mass_matrix(system: &Multibody, x: &[f64]) -> Vec<f64> {
    let (model, n) = (system.model(), system.layout().n_velocity());
    let bodies = || model.bodies().iter().zip(&model.layout().bodies);
    let mut missing = vec![0.0; n];
    inverse_dynamics(system, x, &[], &vec![0.0; n], &mut missing);
    for (body, place) in bodies().filter(|(_, place)| place.n_freedom == 1) {
        let joint = &body.joint;
        missing[place.freedom] += joint.damping * x[place.velocity];
        missing[place.freedom] += joint.stiffness * (x[place.position] - joint.rest);
    }
    let mass = mass_matrix(model, x).unwrap().cholesky().unwrap();
    let acceleration = -mass.solve(&DVector::from_vec(missing));
    let mut rate = vec![0.0; x.len()];
    for (body, place) in bodies() {
        let (p, v, f) = (place.position, place.velocity, place.freedom);
        if body.joint.motion == Motion::Floating {
            rate[p..p + 3].copy_from_slice(&x[v..v + 3]);
            rate[v..v + 3].copy_from_slice(&acceleration.as_slice()[f..f + 3]);
            let turn = Quaternion::new(x[p + 6], x[p + 7], x[p + 8], x[p + 9])
                * Quaternion::new(0.0, 0.5 * x[p + 10], 0.5 * x[p + 11], 0.5 * x[p + 12]);
            rate[p + 6..p + 10].copy_from_slice(&[turn.w, turn.i, turn.j, turn.k]);
            rate[p + 10..p + 13].copy_from_slice(&acceleration.as_slice()[f + 3..f + 6]);
        } else {
            assert_eq!(place.n_freedom, 1, "{}", body.name);
            (rate[p], rate[v]) = (x[v], acceleration[f]);
        }
    }
    rate
}

/// Runge and Kutta's method at half the step, over [`by_mass_matrix`].
fn independent(system: &Multibody, mut x: Vec<f64>) -> Vec<f64> {
    let h = 5e-4;
    let moved = |x: &[f64], by: f64, rate: &[f64]| x.iter().zip(rate).map(|(x, r)| x + by * r).collect::<Vec<f64>>();
    for _ in 0..20_000 {
        let a = by_mass_matrix(system, &x);
        let b = by_mass_matrix(system, &moved(&x, 0.5 * h, &a));
        let c = by_mass_matrix(system, &moved(&x, 0.5 * h, &b));
        let d = by_mass_matrix(system, &moved(&x, h, &c));
        for (k, x) in x.iter_mut().enumerate() {
            *x += h / 6.0 * (a[k] + 2.0 * (b[k] + c[k]) + d[k]);
        }
        let length = norm(&x[6..10]);
        x[6..10].iter_mut().for_each(|q| *q /= length);
    }
    x
}

#[test]
fn ten_seconds_at_1_ms_end_where_a_quarter_of_the_step_ends() {
    // measured 5.8e-12
    at_most("payload: 10 s at 1 ms", trajectory_error("payload", finer), 3e-10);
    // measured 5.7e-10
    at_most("dragon: 10 s at 1 ms", trajectory_error("dragon", finer), 2e-9);
}

#[test]
fn ten_seconds_at_1_ms_end_where_the_mass_matrix_and_newton_and_euler_lead() {
    // measured 3.5e-13
    at_most("payload: 10 s at 1 ms", trajectory_error("payload", independent), 3e-11);
    // measured 5.6e-10
    at_most("dragon: 10 s at 1 ms", trajectory_error("dragon", independent), 2e-9);
}
