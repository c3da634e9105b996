//! Contract: RK4 is of fourth order with every smooth effect on; the semi-implicit step is of first order and goes to
//! the same limit.

use super::common::*;
use omnidrones::dynamics::{Effects, Integrator, Vehicle, vehicles};

/// Constant commands, every effect, an upward flight well above R/2.
fn flight(vehicle: &Vehicle, dt: f64, integrator: Integrator) -> (Flight, Vec<f64>, Vec<f64>) {
    let flight = Flight::new(vehicle, physics(dt, integrator, Effects::all()));
    let mut stream = stream(7);
    let mut x = flight.system.hover_state([0.1, -0.2, 1.0]).unwrap();
    set(&mut x, 3, [1.0, -0.8, 1.5]);
    set(&mut x, 6, [0.96, 0.0, 0.28, 0.0]);
    set(&mut x, 10, [1.0, -2.0, 1.5]);
    let mut u = flight.system.hover_input().unwrap();
    for (i, action) in u[..vehicle.n_rotor()].iter_mut().enumerate() {
        // a fifth of the hover fraction up or down, hence both time constants
        *action += if i % 2 == 0 { 0.2 } else { -0.2 } * (*action + 1.0);
    }
    let n = vehicle.n_rotor();
    set(&mut u, n, random::<3>(&mut stream, 1.0));
    (flight, x, u)
}

fn end(vehicle: &Vehicle, dt: f64, duration: f64, integrator: Integrator) -> Vec<f64> {
    let (flight, x, u) = flight(vehicle, dt, integrator);
    flight.after(&x, &u, (duration / dt).round() as usize)
}

/// Euclidean distance of the rigid part, with everything of order one.
fn distance(a: &[f64], b: &[f64]) -> f64 {
    a[..13].iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

fn order(vehicle: &Vehicle, dt: f64, duration: f64, integrator: Integrator) -> f64 {
    let best = end(vehicle, 1.25e-4, duration, Integrator::RungeKutta4);
    let coarse = distance(&end(vehicle, dt, duration, integrator), &best);
    let fine = distance(&end(vehicle, dt / 2.0, duration, integrator), &best);
    (coarse / fine).log2()
}

#[test]
fn rk4_converges_with_order_four_for_every_vehicle_with_every_effect() {
    for vehicle in vehicles::all() {
        for vehicle in [with_everything(&vehicle), vehicle] {
            let order = order(&vehicle, 0.002, 0.4, Integrator::RungeKutta4);
            // measured 3.996 to 4.001
            near(&format!("{}: order of RK4", vehicle.name), order, 4.0, 0.01);
        }
    }
}

#[test]
fn the_semi_implicit_step_converges_with_order_one_to_the_same_limit() {
    for vehicle in vehicles::all() {
        for vehicle in [with_everything(&vehicle), vehicle] {
            // half a millisecond: order one shows at small steps alone
            let order = order(&vehicle, 0.0005, 0.4, Integrator::SemiImplicit);
            // measured 0.997 to 1.001
            near(&format!("{}: order of the semi-implicit step", vehicle.name), order, 1.0, 0.01);
        }
    }
}

#[test]
fn one_step_of_either_integrator_agrees_as_substeps_grow() {
    for vehicle in vehicles::all() {
        let vehicle = with_everything(&vehicle);
        let gap = |substeps: usize| {
            let (mut semi, x, u) = flight(&vehicle, 0.016, Integrator::SemiImplicit);
            let mut physics = *semi.system.physics();
            physics.substeps = substeps;
            semi = Flight::new(&vehicle, physics);
            physics.integrator = Integrator::RungeKutta4;
            distance(&semi.step(&x, &u), &Flight::new(&vehicle, physics).step(&x, &u))
        };
        let (some, many) = (gap(100), gap(1000));
        // measured 9.99 to 10.02
        near(&format!("{}: gap at 100 substeps over gap at 1000", vehicle.name), some / many, 10.0, 0.05);
    }
}

#[test]
fn a_thrust_frozen_at_the_start_of_the_step_would_be_caught_by_the_order() {
    // twin: the lag applied before each step instead of inside it, as simulators without a closed form do
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let frozen = |dt: f64| {
        let (flight, mut x, u) = flight(&vehicle, dt, Integrator::RungeKutta4);
        let mut held = vehicle.clone();
        for rotor in &mut held.rotors {
            (rotor.time_constant_up, rotor.time_constant_down) = (1e9, 1e9);
        }
        let held = Flight::new(&held, *flight.system.physics());
        for _ in 0..(0.4 / dt).round() as usize {
            let speeds = flight.step(&x, &u)[13..].to_vec();
            x = held.step(&x, &u);
            x[13..].copy_from_slice(&speeds);
        }
        x
    };
    let best = end(&vehicle, 1.25e-4, 0.4, Integrator::RungeKutta4);
    let order = (distance(&frozen(0.002), &best) / distance(&frozen(0.001), &best)).log2();
    assert!(order < 1.5, "order {order}");
}
