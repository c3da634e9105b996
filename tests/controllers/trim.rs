//! Steady flights: closed forms, and flights that stay as they are.

use crate::geometry::quadrotor;
use nalgebra::DVector;
use omnidrones::autodiff::{System, linearise};
use omnidrones::controllers::allocation::failure::hover;
use omnidrones::controllers::design::{ErrorState, TrimTarget, trim, trim_damaged, trim_spin};
use omnidrones::controllers::{Assessment, HoverAxes};
use omnidrones::dynamics::spatial::{Quat, conjugate, from_euler, multiply, rotate, to_euler};
use omnidrones::dynamics::{Disturbance, Effects, Physics, Plant, Vehicle, configurations, vehicles};
use std::f64::consts::FRAC_PI_2;

fn rigid(name: &str) -> Plant {
    Plant::of_vehicle(&vehicles::by_name(name).unwrap(), Physics::default()).unwrap()
}

fn angles(state: &[f64]) -> [f64; 3] {
    to_euler([state[6], state[7], state[8], state[9]])
}

/// How far numbers other than the place drift over a second of constant commands, seen along the axes that turn.
fn drift(plant: &Plant, state: &[f64], input: &[f64]) -> f64 {
    let theta = if plant.n_parameter() > 0 { plant.parameters() } else { Vec::new() };
    let (mut x, mut next) = (state.to_vec(), vec![0.0; state.len()]);
    let steps = (0.2 / plant.physics().dt) as usize;
    for _ in 0..steps {
        plant.step(&x, input, &theta, &mut next);
        std::mem::swap(&mut x, &mut next);
    }
    let places: Vec<usize> = plant.roots().iter().flat_map(|r| [r, &(r + 1), &(r + 2)].map(|k| *k)).collect();
    (0..x.len())
        .filter(|k| !places.contains(k))
        .map(|k| (x[k] - state[k]).abs() / state[k].abs().max(1.0))
        .fold(0.0, f64::max)
}

#[test]
fn hover_of_every_vehicle_is_level_with_its_known_commands() {
    for name in vehicles::names() {
        let plant = rigid(name);
        let Plant::Rigid(m) = &plant else { unreachable!() };
        let found = trim(&plant, &TrimTarget::hover()).unwrap();
        let worst = m.hover_input().unwrap().iter().zip(&found.input).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        println!("{name}: {worst:.1e}, tilt {:?}", angles(&found.state));
        // measured 2.2e-16
        assert!(worst < 2e-14 && found.residual < 1e-8 && found.limited.is_empty(), "{name}: {worst:e}, {found:?}");
    }
}

#[test]
fn forward_climbing_and_windy_flights_stay_as_they_are() {
    for name in vehicles::names() {
        for velocity in [[5.0, 0.0, 0.0], [3.0, -2.0, 1.5], [0.0, 0.0, -2.0]] {
            let plant = rigid(name);
            let found = trim(&plant, &TrimTarget::at_velocity(velocity)).unwrap();
            let off = drift(&plant, &found.state, &found.input);
            assert!(off < 1e-6, "{name} at {velocity:?}: {off:e}");
            assert_eq!(&found.state[3..6], &velocity);
        }
        let mut physics = Physics::default();
        physics.effects.disturbance = true;
        let plant = Plant::of_vehicle(&vehicles::by_name(name).unwrap(), physics).unwrap();
        let air = Disturbance { wind: [-4.0, 2.0, 0.0], ..Disturbance::none() };
        let windy = trim(&plant, &TrimTarget { air, ..TrimTarget::hover() }).unwrap();
        let off = drift(&plant, &windy.state, &windy.input);
        assert!(off < 1e-6, "{name} in wind: {off:e}");
    }
}

#[test]
fn a_turn_without_drag_banks_by_speed_times_rate_over_gravity() {
    let physics = Physics { effects: Effects::none(), ..Physics::default() };
    let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), physics).unwrap();
    let (speed, rate) = (6.0, 1.2);
    let target = TrimTarget { yaw_rate: rate, ..TrimTarget::at_velocity([speed, 0.0, 0.0]) };
    let found = trim(&plant, &target).unwrap();
    let [roll, pitch, yaw] = angles(&found.state);
    // forward flight into a left turn: the thrust leans left
    let bank = -(speed * rate / 9.81).atan();
    println!("roll {roll:.6} against {bank:.6}, pitch {pitch:.1e}, yaw {yaw:.1e}");
    assert!((roll - bank).abs() < 1e-4, "{roll} against {bank}"); // measured 2.8e-5, the step's own error: 2 ms of a turn
}

#[test]
fn systems_of_many_bodies_hover() {
    for name in configurations::names() {
        let plant = Plant::of_model(&configurations::by_name(name).unwrap(), Physics::default()).unwrap();
        let found = trim(&plant, &TrimTarget::hover()).unwrap();
        let off = drift(&plant, &found.state, &found.input);
        println!("{name}: residual {:.1e}, drift {off:.1e}", found.residual);
        // the inverted pendulum is left where it would fall from
        assert!(found.residual < 2e-12 && off < 7e-14, "{name}: {off:e}"); // measured 2.8e-14, 7.1e-16
    }
}

#[test]
fn a_vehicle_with_tilting_rotors_hovers_tilted_and_a_quadrotor_does_not() {
    let tilted = TrimTarget { tilt: [Some(0.3), Some(-0.2)], ..TrimTarget::hover() };
    let plant = Plant::of_model(&configurations::by_name("omav_tilting").unwrap(), Physics::default()).unwrap();
    let found = trim(&plant, &tilted).unwrap();
    let [roll, pitch, yaw] = angles(&found.state);
    assert!((roll - 0.3).abs() + (pitch + 0.2).abs() + yaw.abs() < 1e-8, "{roll} {pitch} {yaw}");
    assert!(drift(&plant, &found.state, &found.input) < 1e-6);
    let refused = trim(&rigid("hummingbird"), &tilted).unwrap_err().to_string();
    assert!(refused.contains("trim of hummingbird") && refused.contains("less tilt"), "{refused}");
}

#[test]
fn a_quadrotor_on_three_rotors_has_a_steady_turn_that_mueller_and_dandrea_describe() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    for lost in 0..4 {
        let mut health = [1.0; 4];
        health[lost] = 0.0;
        let spin = Assessment::of(&vehicle, &health).unwrap().spin.unwrap();
        let plant = rigid("hummingbird").damaged(&health).unwrap();
        let found = trim_spin(&plant, &spin, &HoverAxes::of(&vehicle)).unwrap();
        let x = &found.state;
        let turn = rotate([x[6], x[7], x[8], x[9]], [x[10], x[11], x[12]]);
        let thrust: Vec<f64> = (0..4).map(|i| vehicle.rotors[i].thrust_coefficient * x[13 + i] * x[13 + i]).collect();
        // the thrust turns around the vertical: its mean carries the weight, but for drag
        let up = rotate([x[6], x[7], x[8], x[9]], [0.0, 0.0, 1.0])[2];
        let carried = thrust.iter().sum::<f64>() * up / hover(&vehicle)[2];
        let (mut next, mut left) = (vec![0.0; x.len()], 0.0_f64);
        plant.step(x, &found.input, &[], &mut next);
        let back = from_euler(0.0, 0.0, -turn[2] * plant.physics().dt);
        let velocity = rotate(back, [next[3], next[4], next[5]]);
        let attitude = multiply(back, [next[6], next[7], next[8], next[9]]);
        (0..3).for_each(|k| left = left.max((velocity[k] - x[3 + k]).abs()).max((next[10 + k] - x[10 + k]).abs()));
        (0..4).for_each(|k| left = left.max((attitude[k] - x[6 + k]).abs()));
        println!("without {lost}: {turn:.2?} rad/s, {thrust:.3?} N carry {carried:.4}, a step leaves {left:.1e}");
        // measured 2.6e-11, 1.0000
        assert!(found.residual < 1e-8 && found.limited.is_empty() && left < 1e-10, "{found:?}");
        assert!(turn[0].hypot(turn[1]) < 1e-6 * turn[2].abs() && (carried - 1.0).abs() < 1e-4, "{turn:?} {carried}");
        assert!(thrust[lost] < 1e-3 && thrust[(lost + 2) % 4] > 0.1, "{thrust:?}");
    }
}

/// From level axes to those of a vehicle that hovers rolled and pitched, up to one that stands on nose or tail.
fn mounts() -> impl Iterator<Item = Quat<f64>> {
    let lean = [(0.2, 0.0), (0.0, -0.5), (1.2, 0.5), (0.0, FRAC_PI_2), (0.0, -FRAC_PI_2)];
    lean.into_iter().map(|(roll, pitch)| conjugate(from_euler(roll, pitch, 0.0)))
}

#[test]
fn a_vehicle_mounted_askew_spins_on_three_rotors_as_the_level_one_does() {
    let level = quadrotor();
    for mount in mounts() {
        let askew = level.turned(mount);
        for lost in 0..4 {
            let mut health = [1.0; 4];
            health[lost] = 0.0;
            let found = |vehicle| trim_damaged(vehicle, Physics::default(), &health, &TrimTarget::hover()).unwrap();
            let ((_, own), (_, turned)) = (found(&level), found(&askew));
            let rate = rotate(mount, [own.state[10], own.state[11], own.state[12]]);
            let off = (0..3).map(|k| (turned.state[10 + k] - rate[k]).abs()).fold(0.0, f64::max) / own.yaw_rate.abs();
            let slower = (0..4).map(|k| (turned.state[13 + k] / own.state[13 + k] - 1.0).abs()).fold(0.0, f64::max);
            println!("{mount:?} without {lost}: {off:.1e} {slower:.1e} {:.1e}", turned.residual);
            assert!(turned.residual < 1e-8, "{turned:?}");
            // measured: 1e-12
            assert!(off < 1e-9 && slower < 1e-9, "{mount:?} without {lost}: {off:e} {slower:e}");
        }
    }
}

#[test]
fn a_vehicle_mounted_askew_hovers_and_flies_ahead_where_its_hover_points() {
    let level = quadrotor();
    for target in [TrimTarget::hover(), TrimTarget::at_velocity([4.0, 1.0, 0.5])] {
        let of = |vehicle: &Vehicle| trim(&Plant::of_vehicle(vehicle, Physics::default()).unwrap(), &target).unwrap();
        let own = of(&level);
        for mount in mounts() {
            let turned = of(&level.turned(mount));
            let q = multiply([turned.state[6], turned.state[7], turned.state[8], turned.state[9]], mount);
            let same = (0..4).map(|k| q[k] * own.state[6 + k]).sum::<f64>().abs();
            println!("{mount:?}: {:.1e}", 1.0 - same);
            assert!(1.0 - same < 1e-9, "{mount:?}: {q:?}, level {:?}", &own.state[6..10]);
            assert!(turned.residual < 1e-8, "{mount:?}: {turned:?}");
        }
    }
}

/// What is moved to tell a motor by its longer lag, against a vehicle whose motors have no other and stay where they are.
#[test]
fn the_model_of_a_hover_is_that_of_motors_with_their_longer_lag() {
    let swapped = |mut vehicle: Vehicle| {
        vehicle.rotors.iter_mut().for_each(|r| std::mem::swap(&mut r.time_constant_up, &mut r.time_constant_down));
        vehicle
    };
    for vehicle in vehicles::all().into_iter().flat_map(|vehicle| [vehicle.clone(), swapped(vehicle)]) {
        let steady = |vehicle: &Vehicle| {
            let plant = Plant::of_vehicle(vehicle, Physics::default()).unwrap();
            let found = trim(&plant, &TrimTarget::hover()).unwrap();
            let errors = ErrorState::of_plant(&plant).unwrap();
            (plant, found, errors)
        };
        let (plant, found, errors) = steady(&vehicle);
        let told = errors.state_space(&plant, &found.state, &found.input, 0.0).unwrap();
        let mut one_lag = vehicle.clone();
        for rotor in &mut one_lag.rotors {
            let longer = rotor.time_constant_up.max(rotor.time_constant_down);
            (rotor.time_constant_up, rotor.time_constant_down) = (longer, longer);
        }
        let (plant, found, errors) = steady(&one_lag);
        let exact = errors.reduce(&found.state, &linearise(&plant, &found.state, &found.input, &[]));
        for (told, exact) in [(told.a(), exact.0), (told.b(), exact.1)] {
            for (row, own) in told.row_iter().zip(exact.row_iter()) {
                let off = (row - own).amax() / own.amax().max(1e-12);
                // measured 2.8e-7
                assert!(off < 3e-7, "{}: {off:e}: {row} {own}", vehicle.name);
            }
        }
    }
}

#[test]
fn the_model_of_a_turn_says_where_disturbed_flights_go() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let (whole, lost) = (rigid("hummingbird"), [0.0, 1.0, 1.0, 1.0]);
    let turning = TrimTarget { yaw_rate: 1.2, ..TrimTarget::at_velocity([6.0, 0.0, 0.0]) };
    let spin = Assessment::of(&vehicle, &lost).unwrap().spin.unwrap();
    let three = whole.damaged(&lost).unwrap();
    let flights = [
        (&whole, trim(&whole, &turning).unwrap()),
        (&three, trim_spin(&three, &spin, &HoverAxes::of(&vehicle)).unwrap()),
    ];
    for (plant, found) in flights {
        let errors = ErrorState::of_plant(plant).unwrap();
        let model = errors.state_space(plant, &found.state, &found.input, found.yaw_rate).unwrap();
        let disturbed = |k: usize| if k < 12 { 1e-6 * (1.0 + k as f64).sin() } else { 0.0 };
        let mut predicted = DVector::from_fn(errors.n_error(), |k, _| disturbed(k));
        let mut x = errors.moved(&found.state, predicted.as_slice());
        let (mut steady, mut next) = (found.state.clone(), vec![0.0; x.len()]);
        for _ in 0..25 {
            for state in [&mut x, &mut steady] {
                plant.step(state, &found.input, &[], &mut next);
                state.copy_from_slice(&next);
            }
            predicted = model.a() * predicted;
        }
        let mut flown = errors.difference(&x, &steady);
        let turned = from_euler(0.0, 0.0, -found.yaw_rate * 25.0 * plant.physics().dt);
        for at in [0, 3] {
            let seen = rotate(turned, [flown[at], flown[at + 1], flown[at + 2]]);
            (0..3).for_each(|k| flown[at + k] = seen[k]);
        }
        let off = (&flown - &predicted).amax() / predicted.amax();
        println!("{:.2} rad/s: {off:.1e} of {:.1e}", found.yaw_rate, predicted.amax());
        // measured 3.5e-7
        assert!(off < 1e-6, "{} rad/s: {off:e}", found.yaw_rate);
    }
}

#[test]
fn a_body_of_hardly_any_inertia_is_as_steady_as_its_numbers_can_be() {
    for factor in [1.0, 1e-3, 1e-6, 1e-9] {
        let mut vehicle = vehicles::by_name("hummingbird").unwrap();
        for part in &mut vehicle.parts {
            let i = &mut part.inertia;
            [&mut i.xx, &mut i.yy, &mut i.zz].into_iter().for_each(|j| *j *= factor);
        }
        let plant = Plant::of_vehicle(&vehicle, Physics::default()).unwrap();
        let found = trim(&plant, &TrimTarget::hover()).unwrap();
        assert!(found.residual < 1e-8 / factor.min(1e-2), "{factor:e}: {found:?}");
    }
}
