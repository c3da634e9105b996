//! Contract: the physics has the symmetries of space: mirrors, shifts, uniform motion, turns about the vertical; and
//! those of bookkeeping: order of rotors, choice of units.
//!
//! 170 random cases per vehicle and law, each 20 steps long, every effect on.

use super::common::*;
use crate::common::measure::larger;
use nalgebra::{UnitQuaternion, Vector3};
use omnidrones::autodiff::System;
use omnidrones::dynamics::{Effects, Multirotor, Physics, Vehicle, vehicles};
use omnidrones::rng::Stream;

const CASES: usize = 170;
const STEPS: usize = 20;

/// Flies random cases and their images; the largest difference between image of the end and end of the image.
fn largest_gap(
    seed: u64,
    effects: Effects,
    image_of_vehicle: impl Fn(&Vehicle) -> Vehicle,
    mut image: impl FnMut(&Vehicle, f64, &mut Vec<f64>, &mut Vec<f64>, &mut Stream),
) -> f64 {
    let mut worst = 0.0_f64;
    for vehicle in vehicles::all() {
        let vehicle = with_everything(&vehicle);
        let here = Flight::new(&vehicle, rk4(0.004, effects));
        let there = Flight::new(&image_of_vehicle(&vehicle), rk4(0.004, effects));
        let mut stream = stream(seed);
        for _ in 0..CASES {
            let (x, u) = (random_state(&vehicle, &mut stream), random_input(&here.system, &mut stream));
            let end = here.after(&x, &u, STEPS);
            let mut images = stream.clone();
            let (mut y, mut v) = (x.clone(), u.clone());
            image(&vehicle, 0.0, &mut y, &mut v, &mut images.clone());
            let (mut wanted, mut unused) = (end, u.clone());
            image(&vehicle, 0.004 * STEPS as f64, &mut wanted, &mut unused, &mut images);
            worst = larger(worst, difference(&wanted, &there.after(&y, &v, STEPS)));
            stream.next_u64();
        }
    }
    worst
}

fn mirrored(vehicle: &Vehicle) -> Vehicle {
    let mut vehicle = vehicle.clone();
    for part in &mut vehicle.parts {
        part.position[1] *= -1.0;
        part.inertia.xy *= -1.0;
        part.inertia.yz *= -1.0;
    }
    for rotor in &mut vehicle.rotors {
        rotor.position[1] *= -1.0;
        rotor.axis[1] *= -1.0;
        rotor.spin *= -1.0;
    }
    vehicle
}

/// Left becomes right: y of vectors changes sign, x and z of rotations do.
fn mirror(n_rotor: usize, x: &mut [f64], u: &mut [f64]) {
    for i in [1, 4, 7, 9, 10, 12] {
        x[i] *= -1.0;
    }
    for i in [1, 4, 6, 8] {
        u[n_rotor + i] *= -1.0;
    }
}

#[test]
fn a_mirrored_vehicle_flies_the_mirrored_trajectory() {
    let image = |vehicle: &Vehicle, _: f64, x: &mut Vec<f64>, u: &mut Vec<f64>, _: &mut Stream| {
        mirror(vehicle.n_rotor(), x, u);
    };
    // measured 0: the arithmetic is the same
    at_most("mirror", largest_gap(21, Effects::all(), mirrored, image), 1e-13);
    // twin: mirrored arms without mirrored spins
    let half = |vehicle: &Vehicle| {
        let mut vehicle = mirrored(vehicle);
        vehicle.rotors.iter_mut().for_each(|r| r.spin *= -1.0);
        vehicle
    };
    assert!(largest_gap(21, Effects::all(), half, image) > 1e-3);
}

#[test]
fn a_steady_wind_carries_the_whole_flight_along() {
    let effects = Effects { ground_effect: false, ..Effects::all() };
    let carried = |with_wind: bool| {
        move |vehicle: &Vehicle, t: f64, x: &mut Vec<f64>, u: &mut Vec<f64>, stream: &mut Stream| {
            let shift = random::<3>(stream, 4.0);
            for k in 0..3 {
                x[k] += t * shift[k];
                x[3 + k] += shift[k];
                u[vehicle.n_rotor() + k] += if with_wind { shift[k] } else { 0.0 };
            }
        }
    };
    // measured 6.0e-15
    at_most("Galilean shift", largest_gap(22, effects, Vehicle::clone, carried(true)), 5e-13);
    // twin: the air stays behind
    assert!(largest_gap(22, effects, Vehicle::clone, carried(false)) > 1e-3);
}

#[test]
fn the_same_flight_elsewhere_on_the_same_level_is_the_same_flight() {
    let shifted = |vertical: f64| {
        move |_: &Vehicle, _: f64, x: &mut Vec<f64>, _: &mut Vec<f64>, stream: &mut Stream| {
            let shift = random::<2>(stream, 10.0);
            x[0] += shift[0];
            x[1] += shift[1];
            x[2] += vertical;
        }
    };
    // measured 5.3e-15
    at_most("shift", largest_gap(23, Effects::all(), Vehicle::clone, shifted(0.0)), 5e-13);
    // twin: with the ground effect on, height matters
    assert!(largest_gap(23, Effects::all(), Vehicle::clone, shifted(1.0)) > 1e-9);
}

#[test]
fn a_flight_turned_about_the_vertical_is_the_same_flight() {
    let turned = |axis: Vector3<f64>| {
        move |vehicle: &Vehicle, _: f64, x: &mut Vec<f64>, u: &mut Vec<f64>, stream: &mut Stream| {
            let turn = UnitQuaternion::from_scaled_axis(axis * stream.uniform(-3.0, 3.0));
            for at in [0, 3] {
                let v = turn * vector(x, at);
                set(x, at, v.into());
            }
            let q = turn * attitude(x);
            set(x, 6, [q.w, q.i, q.j, q.k]);
            for at in [vehicle.n_rotor(), vehicle.n_rotor() + 3] {
                let v = turn * vector(u, at);
                set(u, at, v.into());
            }
        }
    };
    // measured 5.1e-15; 2.5e-7 while stages rotated as if their quaternions were unit
    at_most("yaw", largest_gap(24, Effects::all(), Vehicle::clone, turned(Vector3::z())), 5e-13);
    // twin: gravity and ground have a direction
    assert!(largest_gap(24, Effects::all(), Vehicle::clone, turned(Vector3::x())) > 1e-3);
}

#[test]
fn the_order_in_which_rotors_are_listed_does_not_matter() {
    let reversed = |vehicle: &Vehicle| {
        let mut vehicle = vehicle.clone();
        vehicle.rotors.reverse();
        vehicle.parts.reverse();
        vehicle
    };
    let image = |vehicle: &Vehicle, _: f64, x: &mut Vec<f64>, u: &mut Vec<f64>, _: &mut Stream| {
        x[13..].reverse();
        u[..vehicle.n_rotor()].reverse();
    };
    // measured 2.4e-15
    at_most("relabelling", largest_gap(25, Effects::all(), reversed, image), 2e-13);
    // twin: states reordered, commands not
    let half = |_: &Vehicle, _: f64, x: &mut Vec<f64>, _: &mut Vec<f64>, _: &mut Stream| x[13..].reverse();
    assert!(largest_gap(25, Effects::all(), reversed, half) > 1e-3);
}

/// Exponents of (mass, length, time) of each physical parameter.
fn dimension(name: &str) -> [i32; 3] {
    match name.rsplit('.').next().unwrap() {
        "gravity" => [0, 1, -2],
        "mass" => [1, 0, 0],
        n if n.starts_with("center_of_mass") || n.starts_with("position") || n == "moment_per_thrust" => [0, 1, 0],
        n if n.starts_with("inertia") => [1, 2, 0],
        n if n.starts_with("linear_drag") => [1, 0, -1],
        n if n.starts_with("quadratic_drag") => [1, -1, 0],
        n if n.starts_with("angular_drag") => [1, 2, -1],
        n if n.starts_with("axis") || n == "spin" => [0, 0, 0],
        "thrust_coefficient" => [1, 1, 0],
        "max_speed" => [0, 0, -1],
        "time_constant_up" | "time_constant_down" => [0, 0, 1],
        "drag_coefficient" | "axial_drag_coefficient" => [1, 0, 0],
        "rolling_coefficient" => [1, 1, 0],
        other => panic!("a parameter of unknown dimension: {other}"),
    }
}

#[test]
fn the_choice_of_units_does_not_matter() {
    // kg → 1/1.7 units, m → 1/0.6, s → 1/1.3
    let units = [1.7, 0.6, 1.3_f64];
    let scale = |d: [i32; 3]| (0..3).map(|k| units[k].powi(d[k])).product::<f64>();
    let mut worst = 0.0_f64;
    for vehicle in vehicles::all() {
        let vehicle = with_everything(&vehicle);
        let physics = rk4(0.004, Effects::all());
        let here = Flight::new(&vehicle, physics);
        let names = omnidrones::dynamics::rigid::parameter_names(&vehicle);
        let mut large = vehicle.clone();
        large.rotors.iter_mut().for_each(|r| r.radius *= scale([0, 1, 0]));
        let there = Multirotor::new(&large, Physics { dt: 0.004 * scale([0, 0, 1]), ..physics }).unwrap();
        let there = there.with_parameters();
        let nominal = omnidrones::dynamics::rigid::parameter_vector(&vehicle);
        let parameters: Vec<f64> = names.iter().zip(&nominal).map(|(n, p)| p * scale(dimension(n))).collect();
        let n = vehicle.n_rotor();
        let convert = |x: &[f64]| {
            let mut y = x.to_vec();
            for i in 0..x.len() {
                y[i] *= match i {
                    0..3 => scale([0, 1, 0]),
                    3..6 => scale([0, 1, -1]),
                    6..10 => 1.0,
                    _ => scale([0, 0, -1]),
                };
            }
            y
        };
        let mut stream = stream(26);
        for _ in 0..CASES {
            let (x, u) = (random_state(&vehicle, &mut stream), random_input(&here.system, &mut stream));
            let (mut y, mut v) = (convert(&x), u.clone());
            for k in 0..3 {
                v[n + k] *= scale([0, 1, -1]);
                v[n + 3 + k] *= scale([1, 1, -2]);
                v[n + 6 + k] *= scale([1, 2, -2]);
            }
            let wanted = convert(&here.after(&x, &u, STEPS));
            for _ in 0..STEPS {
                let mut next = vec![0.0; y.len()];
                there.step::<f64>(&y, &v, &parameters, &mut next);
                y = next;
            }
            worst = larger(worst, difference(&wanted, &y));
        }
    }
    // measured 1.1e-14
    at_most("units", worst, 1e-12);
}
