//! Contract: where the equations have a solution in closed form, five seconds of flight agree with it to 1e-9.

use super::common::*;
use crate::common::measure::larger;
use nalgebra::{Unit, UnitQuaternion, Vector3};
use omnidrones::dynamics::{Drag, Effects, Inertia, Vehicle, vehicles};

const ROUND: Inertia = Inertia::diagonal(0.007, 0.007, 0.012);

#[test]
fn a_torque_free_symmetric_top_precesses_as_in_the_textbook() {
    for center in [[0.0; 3], [0.04, -0.02, 0.03]] {
        let vehicle = inert(0.7, center, ROUND);
        let body = Body::of(&vehicle);
        let flight = Flight::without_gravity(&vehicle, rk4(0.001, Effects::none()));
        let mut x = vec![0.0; 17];
        let q0 = UnitQuaternion::from_euler_angles(0.3, -0.4, 0.5);
        set(&mut x, 6, [q0.w, q0.i, q0.j, q0.k]);
        set(&mut x, 10, [1.0, 0.5, 2.0]);
        let w0 = vector(&x, 10);
        let momentum = body.angular_momentum(&x, Vector3::zeros());
        let (place, speed) = (body.position(&x), body.velocity(&x));
        let mut worst = 0.0_f64;
        for step in 1..=5000 {
            x = flight.step(&x, &[-1.0; 4]);
            let t = 0.001 * f64::from(step);
            // R(t) = exp(t L/J₁) R₀ exp(t ω₃ (1 − J₃/J₁) e₃); ω turns about e₃ at (J₃/J₁ − 1) ω₃
            let precession = UnitQuaternion::from_scaled_axis(momentum * (t / 0.007));
            let angle = w0.z * (1.0 - 0.012 / 0.007) * t;
            let own = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
            let q = precession * q0 * own;
            worst =
                larger(worst, (q.to_rotation_matrix().matrix() - attitude(&x).to_rotation_matrix().matrix()).norm());
            worst = larger(worst, (own.inverse() * w0 - vector(&x, 10)).norm());
            worst = larger(worst, (place + speed * t - body.position(&x)).norm());
        }
        // measured 3.0e-13
        at_most("symmetric top: attitude, ω and centre of mass", worst, 2e-11);
        // twin: the other sense of the body's own rotation is far away
        let wrong = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), w0.z * (1.0 - 0.012 / 0.007) * 5.0);
        assert!((wrong * w0 - vector(&x, 10)).norm() > 0.1);
    }
}

/// Falls from rest for 5 s; (largest error of v, of z) against the closed form.
fn fall(drag: Drag, velocity: impl Fn(f64) -> f64, height: impl Fn(f64) -> f64) -> f64 {
    let mut vehicle = inert(0.7, [0.0; 3], ROUND);
    vehicle.drag = drag;
    let flight = Flight::new(&vehicle, rk4(0.002, still_air()));
    let mut x = vec![0.0; 17];
    x[6] = 1.0;
    let mut worst = 0.0_f64;
    for step in 1..=2500 {
        x = flight.step(&x, &[-1.0; 4]);
        let t = 0.002 * f64::from(step);
        worst = larger(worst, (x[5] - velocity(t)).abs() / 9.81);
        worst = larger(worst, (x[2] - height(t)).abs() / 9.81);
    }
    worst
}

#[test]
fn a_body_falls_through_linear_drag_exponentially() {
    let (g, d, m) = (9.81, 0.35, 0.7);
    let k: f64 = d / m;
    let end = g / k;
    let velocity = |t: f64| -end * (1.0 - (-k * t).exp());
    let height = |t: f64| -end * (t - (1.0 - (-k * t).exp()) / k);
    let drag = Drag { linear: [0.1, 0.2, d], ..Drag::default() };
    // measured 1.4e-14
    at_most("linear drag", fall(drag, velocity, height), 1e-12);
    // twin: a millionth more drag
    let drag = Drag { linear: [0.1, 0.2, d * 1.000001], ..Drag::default() };
    assert!(fall(drag, velocity, height) > 1e-7);
}

#[test]
fn a_body_falls_through_quadratic_drag_as_the_hyperbolic_tangent() {
    let (g, c, m): (f64, f64, f64) = (9.81, 0.05, 0.7);
    let (end, rate) = ((m * g / c).sqrt(), (g * c / m).sqrt());
    let velocity = |t: f64| -end * (rate * t).tanh();
    let height = |t: f64| -end / rate * (rate * t).cosh().ln();
    let drag = Drag { quadratic: [0.1, 0.2, c], ..Drag::default() };
    // measured 1.4e-13
    at_most("quadratic drag", fall(drag, velocity, height), 1e-11);
    let drag = Drag { quadratic: [0.1, 0.2, c * 1.000001], ..Drag::default() };
    assert!(fall(drag, velocity, height) > 1e-8);
}

#[test]
fn body_and_rotors_keep_their_total_angular_momentum_while_rotors_change_speed() {
    for mut vehicle in vehicles::all() {
        silence(&mut vehicle);
        let body = Body::of(&vehicle);
        let flight = Flight::without_gravity(&vehicle, rk4(0.0005, Effects { rotor_inertia: true, ..Effects::none() }));
        let mut stream = stream(17);
        let mut x = random_state(&vehicle, &mut stream);
        set(&mut x, 10, random::<3>(&mut stream, 1.0));
        let first = body.angular_momentum(&x, rotor_momentum(&vehicle, &x));
        let size = first.norm() + vehicle.rotors.iter().map(|r| r.inertia * r.max_speed).sum::<f64>();
        let (mut worst, mut body_alone) = (0.0_f64, 0.0_f64);
        for _ in 0..5 {
            let u: Vec<f64> = vehicle.rotors.iter().map(|_| stream.uniform(-1.0, 1.0)).collect();
            for _ in 0..2000 {
                x = flight.step(&x, &u);
                let total = body.angular_momentum(&x, rotor_momentum(&vehicle, &x));
                worst = larger(worst, (total - first).norm() / size);
                let alone = body.angular_momentum(&x, Vector3::zeros());
                body_alone = larger(body_alone, (alone - first).norm() / size);
            }
        }
        // measured 9.0e-11, Crazyflie
        at_most(&format!("{}: total angular momentum", vehicle.name), worst, 1e-9);
        // twin: leave the rotors out of the sum
        assert!(body_alone > 1e-4, "{}: {body_alone:.3e}", vehicle.name);
    }
}

#[test]
fn a_rotor_that_spins_up_turns_the_body_the_other_way_by_the_ratio_of_inertias() {
    for vehicle in vehicles::all() {
        for (i, rotor) in vehicle.rotors.iter().enumerate() {
            let mut lone = inert(1.0, rotor.position, Inertia::diagonal(0.01, 0.01, 0.01));
            lone.rotors = vec![rotor.clone()];
            silence(&mut lone);
            let flight =
                Flight::without_gravity(&lone, rk4(0.00025, Effects { rotor_inertia: true, ..Effects::none() }));
            let mut x = vec![0.0; 14];
            x[6] = 1.0;
            let mut worst = 0.0_f64;
            for step in 1..=4000 {
                x = flight.step(&x, &[1.0]);
                let t = 0.00025 * f64::from(step);
                let speed = rotor.max_speed * -(-t / rotor.time_constant_up).exp_m1();
                let wanted = Unit::new_normalize(Vector3::from(rotor.axis)).into_inner()
                    * (-rotor.spin * rotor.inertia / 0.01 * speed);
                worst = larger(worst, (vector(&x, 10) - wanted).norm());
            }
            // measured 6.9e-11, Omav
            at_most(&format!("{} rotor {i}: reaction to spin-up, rad/s", vehicle.name), worst, 1e-9);
            assert!(vector(&x, 10).norm() > 1e-3 || rotor.inertia == 0.0);
        }
    }
}

/// Kept beside the claims: an inert vehicle is really inert.
#[test]
fn an_inert_vehicle_in_free_fall_only_falls() {
    let vehicle: Vehicle = inert(0.7, [0.02, 0.0, 0.0], ROUND);
    let flight = Flight::new(&vehicle, rk4(0.002, Effects::default()));
    let mut x = vec![0.0; 17];
    x[6] = 1.0;
    x = flight.after(&x, &[1.0; 4], 500);
    near("height after 1 s", x[2], -4.905, 1e-12);
    // measured 7.9e-24, by k_f = 1e-30
    at_most("rotation", vector(&x, 10).norm(), 5e-22);
}
