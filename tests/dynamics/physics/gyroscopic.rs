//! Contract: −ω × (Jω + H) turns the body and does no work; all power has a source that can be named.

use super::common::*;
use crate::common::measure::larger;
use nalgebra::Vector3;
use omnidrones::dynamics::{Effects, Vehicle, vehicles};

#[test]
fn gyroscopic_terms_of_body_and_rotors_do_no_work() {
    let mut worst = 0.0_f64;
    for mut vehicle in vehicles::all() {
        silence(&mut vehicle);
        let body = Body::of(&vehicle);
        let flight = Flight::without_gravity(&vehicle, rk4(0.002, Effects { rotor_inertia: true, ..Effects::none() }));
        let mut stream = stream(3);
        let (mut largest, mut defect) = (0.0_f64, 0.0_f64);
        for case in 0..1000 {
            let mut x = random_state(&vehicle, &mut stream);
            set(&mut x, 10, random::<3>(&mut stream, 10.0));
            // speeds that the command holds: no Ḣ
            let u: Vec<f64> =
                x[13..].iter().zip(&vehicle.rotors).map(|(s, r)| 2.0 * (s / r.max_speed).powi(2) - 1.0).collect();
            let (w, a) = (vector(&x, 10), vector(&flight.derivative(&x, &u), 10));
            let spin = rotor_momentum(&vehicle, &x);
            let size = w.norm_squared() * (body.inertia * w + spin).norm();
            let power = w.dot(&(body.inertia * a)).abs() / size;
            worst = larger(worst, power);
            assert!(power <= 2e-13, "{}, case {case}: {power:.3e}", vehicle.name);
            let turning = (body.inertia * a + w.cross(&(body.inertia * w + spin))).norm() / (size / w.norm());
            largest = larger(largest, turning);
            // twin: −(ω + δ) × H, as with a rotor frame that is not the body's
            let wrong = w.dot(&(w + 1e-3 * w.norm() * Vector3::x()).cross(&spin)).abs();
            defect = larger(defect, wrong / size);
        }
        assert!(defect > 1e-12, "{}: {defect:.3e}", vehicle.name);
        // ω̇ is −J⁻¹ ω × (Jω + H) and nothing else
        // measured 1.0e-14, Crazyflie
        at_most(&format!("{}: moment beside the gyroscopic ones", vehicle.name), largest, 1e-12);
    }
    // measured 2.3e-15
    at_most("gyroscopic power", worst, 2e-13);
}

/// Power that rotors, drag and the rotors' angular acceleration feed into body and weight.
fn power(vehicle: &Vehicle, flight: &Flight, x: &[f64], u: &[f64], drag_counted: f64) -> f64 {
    let (body, r) = (Body::of(vehicle), attitude(x));
    let (v, w) = (r.inverse() * body.velocity(x), vector(x, 10));
    let rate = flight.derivative(x, u);
    let mut total = 0.0;
    for (i, rotor) in vehicle.rotors.iter().enumerate() {
        let (n, arm) = (Vector3::from(rotor.axis), Vector3::from(rotor.position) - body.center_of_mass);
        let thrust = n * (rotor.thrust_coefficient * x[13 + i] * x[13 + i]);
        total += thrust.dot(&(v + w.cross(&arm))) - rotor.spin * rotor.moment_per_thrust * thrust.dot(&w);
        total -= rotor.spin * rotor.inertia * rate[13 + i] * n.dot(&w);
    }
    let d = flight.system.drag_wrench(x, u, &flight.parameters);
    total + drag_counted * (vector(&d, 0).dot(&v) + vector(&d, 3).dot(&w))
}

/// |ΔE − ∫P dt| over ∫|P| dt in ten seconds at 1 ms, the integral by Simpson's rule.
fn imbalance(vehicle: &Vehicle, wind: [f64; 3], drag_counted: f64) -> f64 {
    let effects = Effects { ground_effect: false, disturbance: true, ..still_air() };
    let flight = Flight::new(vehicle, rk4(0.001, effects));
    let body = Body::of(vehicle);
    let energy =
        |x: &[f64]| body.rotational_energy(x) + body.translational_energy(x) + body.mass * 9.81 * body.position(x).z;
    let mut x = flight.system.hover_state([0.0; 3]).unwrap();
    set(&mut x, 3, [1.0, 2.0, -1.0]);
    set(&mut x, 10, [0.3, -0.2, 1.0]);
    let rest = flight.system.hover_input().unwrap();
    let (mut u, n) = (rest.clone(), vehicle.n_rotor());
    set(&mut u, n, wind);
    let (first, mut work, mut size) = (energy(&x), 0.0, 0.0);
    let mut stream = stream(5);
    for second in 0..10 {
        if second % 2 == 1 {
            // new commands, kept apart by steps so that the integrand is smooth within each Simpson panel
            for (action, rest) in u.iter_mut().zip(&rest[..n]) {
                *action = rest + stream.uniform(-0.005, 0.005);
            }
        }
        for _ in 0..500 {
            let middle = flight.step(&x, &u);
            let end = flight.step(&middle, &u);
            let p = [&x, &middle, &end].map(|x| power(vehicle, &flight, x, &u, drag_counted));
            work += (p[0] + 4.0 * p[1] + p[2]) * 0.001 / 3.0;
            size += p.iter().map(|p| p.abs()).sum::<f64>() * 0.002 / 3.0;
            x = end;
        }
    }
    (energy(&x) - first - work).abs() / size
}

#[test]
fn energy_changes_by_the_power_of_rotors_and_drag_alone() {
    for vehicle in vehicles::all() {
        let vehicle = with_everything(&vehicle);
        for wind in [[0.0; 3], [3.0, -2.0, 1.0]] {
            let what = format!("{} in wind {wind:?}", vehicle.name);
            // measured 5.2e-12 in still air and 5.9e-12 in wind, Omav
            at_most(&format!("{what}: power balance over 10 s"), imbalance(&vehicle, wind, 1.0), 5e-10);
            // twin: a thousandth of the drag's power forgotten
            let defect = imbalance(&vehicle, wind, 0.999);
            assert!(defect > 1e-6, "{what}: {defect:.3e}");
        }
    }
}
