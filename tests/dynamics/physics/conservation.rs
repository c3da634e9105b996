//! Contract: a body without forces keeps its kinetic energy and its momenta for as long as anyone will simulate it.

use super::common::*;
use crate::common::measure::larger;
use nalgebra::Vector3;
use omnidrones::dynamics::{Effects, Inertia, Integrator, Vehicle};

const HUMMINGBIRD: Inertia = Inertia::diagonal(0.007, 0.007, 0.012);
/// With products, so that no axis of the base is a principal one.
const TRIAXIAL: Inertia = Inertia { xx: 0.010, yy: 0.015, zz: 0.020, xy: 0.001, xz: -0.002, yz: 0.0015 };
const OFFSET: [f64; 3] = [0.05, -0.03, 0.02];

fn start(w: [f64; 3]) -> Vec<f64> {
    let mut x = vec![0.0; 17];
    x[6] = 1.0;
    set(&mut x, 3, [0.3, -0.2, 0.1]);
    set(&mut x, 10, w);
    x
}

/// Largest relative errors of rotational energy, angular and linear momentum over a free flight, sampled 1000 times.
fn drift(vehicle: &Vehicle, w: [f64; 3], dt: f64, steps: usize) -> [f64; 3] {
    let flight = Flight::without_gravity(vehicle, rk4(dt, Effects::none()));
    let (body, u) = (Body::of(vehicle), [-1.0; 4]);
    let mut x = start(w);
    let energy = body.rotational_energy(&x);
    let (angular, linear) = (body.angular_momentum(&x, Vector3::zeros()), body.velocity(&x));
    let mut worst = [0.0_f64; 3];
    for _ in 0..1000 {
        x = flight.after(&x, &u, steps / 1000);
        let now = [
            (body.rotational_energy(&x) / energy - 1.0).abs(),
            (body.angular_momentum(&x, Vector3::zeros()) - angular).norm() / angular.norm(),
            (body.velocity(&x) - linear).norm() / linear.norm(),
        ];
        for (worst, now) in worst.iter_mut().zip(now) {
            *worst = larger(*worst, now);
        }
        // measured 3.3e-16
        let norm = x[6..10].iter().map(|q| q * q).sum::<f64>().sqrt();
        assert!((norm - 1.0).abs() < 4.5e-16, "‖q‖ = {norm:.17}");
    }
    worst
}

#[test]
fn a_free_body_keeps_energy_and_momenta_over_a_million_rk4_steps_of_2_ms() {
    let fast = Vector3::new(1.0, 2.0, 3.0).normalize() * 10.0;
    let cases = [
        ("hummingbird", inert(0.716, [0.0; 3], HUMMINGBIRD), fast.into()),
        ("hummingbird off centre", inert(0.716, OFFSET, HUMMINGBIRD), fast.into()),
        ("tri-axial", inert(1.0, [0.0; 3], TRIAXIAL), [1.0, 2.0, 3.0]),
        ("tri-axial off centre", inert(1.0, OFFSET, TRIAXIAL), [1.0, 2.0, 3.0]),
    ];
    for (name, vehicle, w) in cases {
        let [energy, angular, linear] = drift(&vehicle, w, 0.002, 1_000_000);
        // measured 7.7e-9 Hummingbird, 1.9e-11 tri-axial; the same off centre
        at_most(&format!("{name}: energy"), energy, 1e-8);
        // measured 2.5e-9 and 1.1e-11
        at_most(&format!("{name}: angular momentum"), angular, 1e-8);
        // measured 0 centred, 7.5e-14 off centre
        at_most(&format!("{name}: momentum"), linear, 5e-12);
    }
}

#[test]
fn energy_drift_of_rk4_falls_with_the_sixth_power_of_the_step() {
    let vehicle = inert(1.0, [0.0; 3], TRIAXIAL);
    let [coarse, ..] = drift(&vehicle, [1.0, 2.0, 3.0], 0.010, 100_000);
    let [fine, ..] = drift(&vehicle, [1.0, 2.0, 3.0], 0.005, 100_000);
    // measured 62.9
    near("drift at 10 ms over drift at 5 ms", coarse / fine, 64.0, 9.6);
}

#[test]
fn explicit_euler_of_the_same_body_gains_energy_without_bound() {
    let vehicle = inert(0.716, [0.0; 3], HUMMINGBIRD);
    let j = Body::of(&vehicle).inertia;
    let w = Vector3::new(1.0, 2.0, 3.0).normalize() * 10.0;
    let energy = |w: Vector3<f64>| 0.5 * w.dot(&(j * w));
    // the twin of both claims on this page: 5 s at 16 ms
    let gain = energy(explicit_rotation(&j, w, 0.016, 312)) / energy(w);
    // measured 4.08 after 5 s, 45.9 after 10 s
    assert!(gain > 2.0, "explicit Euler gained only {gain}");
    let later = energy(explicit_rotation(&j, w, 0.016, 624)) / energy(w);
    assert!(later > 2.0 * gain, "explicit Euler stopped gaining: {gain}, then {later}");
}

#[test]
fn the_semi_implicit_step_gains_no_energy_at_16_ms_and_10_rad_per_s() {
    let mut stream = stream(1);
    let mut largest = 0.0_f64;
    for case in 0..100 {
        let (name, inertia) = if case % 2 == 0 { ("hummingbird", HUMMINGBIRD) } else { ("tri-axial", TRIAXIAL) };
        let vehicle = inert(0.716, OFFSET, inertia);
        let body = Body::of(&vehicle);
        let flight = Flight::without_gravity(&vehicle, physics(0.016, Integrator::SemiImplicit, Effects::none()));
        let w = Vector3::from(random::<3>(&mut stream, 1.0)).normalize() * 10.0;
        let mut x = start(w.into());
        let mut last = body.rotational_energy(&x);
        for step in 0..312 {
            x = flight.step(&x, &[-1.0; 4]);
            let now = body.rotational_energy(&x);
            largest = larger(largest, now / last - 1.0);
            assert!(now <= last * (1.0 + 1e-12), "{name}, step {step}, from {w:?}: {last} to {now}");
            last = now;
        }
    }
    // measured no gain at all
    at_most("largest relative gain in a step", largest, 1e-12);
}
