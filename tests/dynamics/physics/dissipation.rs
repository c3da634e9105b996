//! Contract: in still air drag takes power, never gives it.

use super::common::*;
use crate::common::measure::larger;
use nalgebra::Vector3;
use omnidrones::dynamics::{Effects, Vehicle, vehicles};

/// F·v + M·ω at the centre of mass over ‖F‖‖v‖ + ‖M‖‖ω‖: largest over random states.
fn largest_power(vehicle: &Vehicle, effects: Effects, cases: usize) -> f64 {
    let flight = Flight::new(vehicle, rk4(0.002, effects));
    let body = Body::of(vehicle);
    let mut stream = stream(11);
    let mut largest = f64::NEG_INFINITY;
    for _ in 0..cases {
        let mut x = random_state(vehicle, &mut stream);
        set(&mut x, 10, random::<3>(&mut stream, 20.0));
        let u = random_input(&flight.system, &mut stream);
        let d = flight.system.drag_wrench(&x, &u, &flight.parameters);
        let (v, w) = (attitude(&x).inverse() * body.velocity(&x), vector(&x, 10));
        let (f, m): (Vector3<f64>, Vector3<f64>) = (vector(&d, 0), vector(&d, 3));
        let size = f.norm() * v.norm() + m.norm() * w.norm();
        largest = larger(largest, (f.dot(&v) + m.dot(&w)) / size.max(1e-300));
    }
    largest
}

#[test]
fn drag_never_feeds_power_in_still_air() {
    for vehicle in vehicles::all() {
        // the vehicle as published, then with every coefficient in use and the centre of mass moved
        // measured −0.046, Firefly
        at_most(&format!("{}: published drag", vehicle.name), largest_power(&vehicle, still_air(), 10_000), 0.0);
        let vehicle = with_everything(&vehicle);
        // measured −0.79, Firefly
        at_most(&format!("{}: every drag", vehicle.name), largest_power(&vehicle, still_air(), 10_000), 0.0);
        let none = Effects::none();
        for (name, effects) in [
            ("body", Effects { body_drag: true, ..none }),
            ("quadratic", Effects { quadratic_drag: true, ..none }),
            ("rotor", Effects { rotor_drag: true, ..none }),
        ] {
            // measured −0.78 body, −0.90 quadratic, −0.51 rotor
            at_most(&format!("{}: {name} drag alone", vehicle.name), largest_power(&vehicle, effects, 10_000), 0.0);
        }
    }
}

#[test]
fn the_rolling_moment_may_feed_power_and_is_caught_by_the_same_measure() {
    // twin, and the reason why the rolling moment is off by default
    for vehicle in vehicles::all() {
        let vehicle = with_everything(&vehicle);
        let power = largest_power(&vehicle, Effects { rolling_moment: true, ..Effects::none() }, 1000);
        assert!(power > 0.1, "{}: {power}", vehicle.name);
    }
}

#[test]
fn a_gliding_vehicle_without_thrust_and_weight_comes_to_rest_monotonically() {
    for vehicle in vehicles::all() {
        let mut vehicle = with_everything(&vehicle);
        for rotor in &mut vehicle.rotors {
            (rotor.thrust_coefficient, rotor.moment_per_thrust, rotor.inertia) = (1e-30, 0.0, 0.0);
        }
        let body = Body::of(&vehicle);
        let flight = Flight::without_gravity(&vehicle, rk4(0.002, still_air()));
        let mut x = random_state(&vehicle, &mut stream(13));
        let u = vec![-1.0; vehicle.n_rotor()];
        let energy = |x: &[f64]| body.rotational_energy(x) + body.translational_energy(x);
        let (first, mut last) = (energy(&x), energy(&x));
        for step in 0..5000 {
            x = flight.step(&x, &u);
            let now = energy(&x);
            assert!(now < last, "{}, step {step}: {last} to {now}", vehicle.name);
            last = now;
        }
        // measured 0.017 to 0.019
        at_most(&format!("{}: energy left after 10 s", vehicle.name), last / first, 0.03);
    }
}
