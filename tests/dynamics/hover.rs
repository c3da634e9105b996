//! Hover: where force and moment vanish, level where a vehicle can, and what is told where there is none.

use crate::common::geometry::{self, loaded_hexarotor, mirrored, quadrotor};
use nalgebra::{DVector, Vector3};
use omnidrones::autodiff::System;
use omnidrones::dynamics::assembly::single;
use omnidrones::dynamics::spatial::{Quat, from_euler, multiply, rotate};
use omnidrones::dynamics::{GRAVITY, HoverTrim, Multirotor, Physics, Plant, Vehicle, vehicles};

/// A right angle as files write it, rad.
#[allow(clippy::approx_constant)]
const ROUNDED: f64 = 1.5708;

/// Quarter turns about the vertical.
fn quarter(turns: usize) -> Quat<f64> {
    from_euler(0.0, 0.0, turns as f64 * std::f64::consts::FRAC_PI_2)
}

/// Share of its largest thrust that a rotor keeps at idle.
const IDLE: f64 = 1e-4;

/// N.
fn weight_of(vehicle: &Vehicle) -> f64 {
    vehicle.mass_properties().mass * GRAVITY
}

/// Force and moment left in hover, as shares of the weight (moments over 1 m), computed from the thrusts anew.
fn left(vehicle: &Vehicle, hover: &HoverTrim) -> f64 {
    let weight = weight_of(vehicle);
    let wrench = vehicle.allocation_matrix() * DVector::from_column_slice(&hover.thrusts);
    let force = rotate(hover.attitude, [wrench[0], wrench[1], wrench[2]]);
    let force = Vector3::new(force[0], force[1], force[2] - weight).norm();
    (force + wrench.rows(3, 3).norm()) / weight
}

/// The largest force, N, of thrusts within their limits that leave no moment: it lies at a vertex of their set, where all but three
/// rotors idle or turn at most. Whatever is less is reached on the way from none, by a vehicle that leans.
fn most_without_moment(vehicle: &Vehicle) -> f64 {
    let b = vehicle.allocation_matrix();
    let n = vehicle.rotors.len();
    let most = |i: usize| vehicle.rotors[i].max_thrust();
    let mut largest: f64 = 0.0;
    // digits of a number of base three say of each rotor: stands, turns at most, is solved for
    for number in 0..3_usize.pow(n as u32) {
        let digit = |i: usize| number / 3_usize.pow(i as u32) % 3;
        let free: Vec<usize> = (0..n).filter(|i| digit(*i) == 2).collect();
        if free.len() != 3 {
            continue;
        }
        let mut thrusts = DVector::from_fn(n, |i, _| if digit(i) == 1 { most(i) } else { IDLE * most(i) });
        let moment = (&b * &thrusts).rows(3, 3).into_owned();
        let Some(solved) = b.rows(3, 3).select_columns(&free).lu().solve(&-moment) else { continue };
        free.iter().zip(solved.iter()).for_each(|(i, thrust)| thrusts[*i] = *thrust);
        if (0..n).all(|i| (IDLE * most(i) - 1e-9..=most(i) + 1e-9).contains(&thrusts[i])) {
            largest = largest.max((&b * &thrusts).rows(0, 3).norm());
        }
    }
    largest
}

#[test]
fn every_vehicle_hovers_level_with_the_least_thrusts_to_the_bit() {
    for vehicle in vehicles::all() {
        let hover = vehicle.hover().unwrap();
        let b = vehicle.allocation_matrix();
        let weight = weight_of(&vehicle);
        let svd = b.svd(true, true);
        let wanted = DVector::from_row_slice(&[0.0, 0.0, weight, 0.0, 0.0, 0.0]);
        let least = svd.solve(&wanted, 1e-9 * svd.singular_values.max()).unwrap();
        println!("{}: reserve {:.3}", vehicle.name, hover.reserve);
        assert_eq!(hover.thrusts, least.as_slice(), "{}", vehicle.name);
        assert_eq!((hover.attitude, hover.lean()), ([1.0, 0.0, 0.0, 0.0], 0.0), "{}", vehicle.name);
        assert!(vehicle.upright() == vehicle && vehicle.authority().is_complete());
    }
}

#[test]
fn a_rotor_that_leans_by_any_angle_is_held_by_a_vehicle_that_leans() {
    for degrees in [1e-8_f64, 1e-6, 1e-4, 0.0573, 1.0, 10.0] {
        for (about, turns, mirror) in [(0.0, 0, false), (1.1, 1, false), (2.5, 2, true), (4.0, 3, true)] {
            for six in [false, true] {
                let mut vehicle = if six { loaded_hexarotor(0.0, 0.0) } else { quadrotor() };
                let (s, c) = degrees.to_radians().sin_cos();
                vehicle.rotors[0].axis = [s * f64::cos(about), s * f64::sin(about), c];
                let vehicle = vehicle.turned(quarter(turns));
                let vehicle = if mirror { mirrored(&vehicle) } else { vehicle };
                let hover = match vehicle.hover() {
                    Ok(hover) => hover,
                    Err(error) => {
                        // across its arm a rotor turns the vehicle by more than the others hold
                        assert!(error.to_string().contains("yaw moment"), "{degrees}°: {error}");
                        assert!(most_without_moment(&vehicle) < weight_of(&vehicle), "{degrees}° {six}: {error}");
                        continue;
                    }
                };
                assert!(most_without_moment(&vehicle) >= weight_of(&vehicle), "{degrees}° {six}: {hover:?}");
                let (off, lean) = (left(&vehicle, &hover), hover.lean().to_degrees());
                // measured: 7e-16 where it leans; what counts as level leaves 4e-11 of 1e-8°
                assert!(off < 1e-9, "{degrees}° {six}: {off:e}");
                assert!(lean < degrees && hover.reserve > 0.08, "{degrees}°: leans by {lean}°, {hover:?}");
                assert!(hover.is_level() || off < 1e-14, "{degrees}°: {off:e}");
                assert_eq!(hover.is_level(), degrees < 1e-6, "{degrees}°: {hover:?}");
            }
        }
    }
}

#[test]
fn a_vehicle_at_hover_stays_there_in_closed_form_and_as_a_tree() {
    for seed in 0..60 {
        let vehicle = geometry::vehicle(seed);
        let Ok(hover) = vehicle.hover() else { continue };
        let physics = Physics::default();
        let model = single(&vehicle).unwrap();
        for plant in [Plant::of_vehicle(&vehicle, physics).unwrap(), Plant::of_model(&model, physics).unwrap()] {
            let state = plant.hover_state().unwrap();
            let mut input = vec![0.0; plant.n_input()];
            let places = plant.rotor_places();
            for ((place, rotor), thrust) in places.iter().zip(&vehicle.rotors).zip(&hover.thrusts) {
                input[place.action] = 2.0 * thrust / rotor.max_thrust() - 1.0;
            }
            let (mut x, mut next) = (state.clone(), vec![0.0; plant.n_state()]);
            (0..100).for_each(|_| {
                plant.step(&x, &input, &[], &mut next);
                std::mem::swap(&mut x, &mut next);
            });
            let off = x.iter().zip(&state).map(|(a, b)| (a - b).abs() / b.abs().max(1.0)).fold(0.0, f64::max);
            // 0.2 s; measured: 6e-13, of a rotor at rest 1e-4 of its speed
            assert!(off < 1e-9 || hover.reserve < 1e-3, "{seed}: {off:e}, {hover:?}");
        }
    }
}

#[test]
fn a_turned_or_mirrored_vehicle_hovers_with_the_same_thrusts() {
    for seed in 0..100 {
        let vehicle = geometry::vehicle(seed);
        let hover = vehicle.hover();
        for (roll, pitch, yaw) in [(0.0, 0.0, 1.0), (0.3, -0.2, 2.0), (ROUNDED, 0.0, 0.0), (0.0, 1.2, -2.0)] {
            let turn = from_euler(roll, pitch, yaw);
            match (&hover, vehicle.turned(turn).hover()) {
                (Ok(own), Ok(turned)) if own.is_level() || !turned.is_level() => {
                    let same = own.thrusts.iter().zip(&turned.thrusts).zip(&vehicle.rotors);
                    let off = same.map(|((a, b), r)| (a - b).abs() / r.max_thrust()).fold(0.0, f64::max);
                    // up is up however the frame lies
                    let up = rotate(turned.attitude, rotate(turn, own.up));
                    let lean = Vector3::from(up).normalize().angle(&Vector3::z());
                    // measured: 1e-8 of linear programs of six rotors and more
                    let unique = vehicle.n_rotor() == 4;
                    assert!(!unique || (off < 1e-9 && lean < 1e-7), "{seed}: {off:e} {lean:e}");
                }
                (Ok(_), Ok(_)) => {}
                (Err(_), Err(_)) => {}
                (a, b) => panic!("{seed}: {a:?} {b:?}"),
            }
        }
        let image = mirrored(&vehicle).hover();
        assert_eq!(hover.is_ok(), image.is_ok(), "{seed}");
        if let (Ok(a), Ok(b)) = (hover, image) {
            let off = a.thrusts.iter().zip(&b.thrusts).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-6 * a.thrusts[0].max(1.0) && (a.reserve - b.reserve).abs() < 1e-6, "{seed}: {off:e}");
        }
    }
}

#[test]
fn a_load_off_the_centre_of_six_rotors_is_carried_within_their_limits() {
    let mut carried = 0;
    for x in [0.0, 0.02, 0.05, 0.07, -0.07, 0.1, 0.13] {
        for y in [0.0, 0.03] {
            let vehicle = loaded_hexarotor(x, y);
            match vehicle.hover() {
                Ok(hover) => {
                    carried += 1;
                    assert!(hover.is_level() && left(&vehicle, &hover) < 1e-9, "{x} {y}");
                    let most = vehicle.rotors.iter().zip(&hover.thrusts).map(|(r, t)| t / r.max_thrust());
                    assert!(most.clone().all(|share| (0.0..=1.0).contains(&share)), "{x} {y}: {hover:?}");
                }
                Err(error) => {
                    assert!(error.to_string().contains("pitch") || error.to_string().contains("roll"), "{error}")
                }
            }
        }
    }
    assert!(carried >= 8, "{carried}");
    // where least thrusts would push one rotor down
    assert!(loaded_hexarotor(0.07, 0.0).hover().unwrap().reserve > 0.02);
}

#[test]
fn what_does_not_balance_is_told_with_the_row_and_by_how_much() {
    let heavy = |mass: f64| {
        let mut vehicle = quadrotor();
        vehicle.parts[0].mass = mass;
        vehicle.hover().unwrap_err().to_string()
    };
    let error = heavy(3.0);
    assert!(error.contains("short of lift: 25.920 N at most for a weight of 29.430"), "{error}");
    for (x, y, row) in [(0.2, 0.0, "pitch"), (-0.3, 0.0, "pitch"), (0.0, 0.2, "roll"), (0.0, -0.16, "roll")] {
        let mut vehicle = quadrotor();
        vehicle.parts[0].position = [x, y, 0.0];
        let error = vehicle.hover().unwrap_err().to_string();
        assert!(error.contains(&format!("{row} moment")), "{x} {y}: {error}");
        // rotors at ±0.15 m hold the weight up to there
        let missing = GRAVITY * (f64::max(f64::abs(x), f64::abs(y)) - 0.15);
        let told: f64 = error.split("at least ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!((told - missing).abs() < 0.02 * missing, "{x} {y}: {told} of {missing}");
    }
}

#[test]
fn axes_that_rotors_do_not_turn_apart_are_named() {
    let spins = |spins: [f64; 4]| {
        let mut vehicle = quadrotor();
        vehicle.rotors.iter_mut().zip(spins).for_each(|(rotor, spin)| rotor.spin = spin);
        vehicle
    };
    for turns in 0..4 {
        let told = |vehicle: &Vehicle| vehicle.turned(quarter(turns)).check_steerable().unwrap_err().to_string();
        let (front, side) = if turns % 2 == 0 { ("pitch", "roll") } else { ("roll", "pitch") };
        let error = told(&spins([1.0, -1.0, 1.0, -1.0]));
        assert!(error.contains(&format!("{front} and yaw only together")), "{turns}: {error}");
        let error = told(&spins([1.0, -1.0, -1.0, 1.0]));
        assert!(error.contains(&format!("{side} and yaw only together")), "{turns}: {error}");
        let error = told(&spins([1.0; 4]));
        assert!(error.contains("thrust and yaw only together"), "{turns}: {error}");
        let mut two = spins([1.0, -1.0, 1.0, -1.0]);
        two.rotors.truncate(2);
        (two.rotors[0].position, two.rotors[1].position) = ([0.0, 0.2, 0.0], [0.0, -0.2, 0.0]);
        let error = told(&two);
        assert!(error.contains(&format!("{front} not at all")), "{turns}: {error}");
        assert!(error.contains(&format!("{side} and yaw only together")), "{turns}: {error}");
    }
}

#[test]
fn a_base_frame_that_is_not_level_costs_nothing() {
    let vehicle = quadrotor();
    for (roll, pitch) in [(4e-6, 0.0), (0.1, -0.2), (ROUNDED, 0.0), (0.0, 1.5), (3.0, 0.0)] {
        let turned = vehicle.turned(from_euler(roll, pitch, 0.0));
        let hover = turned.hover().unwrap();
        let back = multiply(hover.attitude, from_euler(roll, pitch, 0.0));
        let up = rotate(back, [0.0, 0.0, 1.0]);
        assert!(up[2] > 1.0 - 1e-12 && left(&turned, &hover) < 1e-14, "{roll} {pitch}: {up:?}");
        let system = Multirotor::new(&turned, Physics::default()).unwrap();
        assert_eq!(system.hover_state([0.0; 3]).unwrap()[6..10], hover.attitude);
        assert!(turned.check_steerable().is_ok());
    }
}

#[test]
fn a_vehicle_hovers_where_thrusts_without_moment_carry_it_and_nowhere_else() {
    let (mut held, mut refused) = (0, 0);
    for seed in 0..400 {
        let vehicle = geometry::vehicle(seed);
        let (most, weight) = (most_without_moment(&vehicle), weight_of(&vehicle));
        let hover = vehicle.hover();
        // nearer than the tolerance of a balance both answers are right
        if (most / weight - 1.0).abs() < 1e-6 {
            continue;
        }
        assert_eq!(hover.is_ok(), most > weight, "{seed}: {most} N of {weight} N, {hover:?}");
        *(if most > weight { &mut held } else { &mut refused }) += 1;
    }
    println!("{held} held, {refused} refused");
    assert!(held > 50 && refused > 50, "{held} held, {refused} refused");
}

#[test]
fn a_vehicle_described_in_the_axes_of_its_hover_hovers_with_the_same_thrusts() {
    let mut leaning = 0;
    for seed in 0..400 {
        let vehicle = geometry::vehicle(seed);
        let Ok(own) = vehicle.hover() else { continue };
        let upright = vehicle.upright().hover().unwrap();
        let worst = own.thrusts.iter().zip(&upright.thrusts).zip(&vehicle.rotors);
        let worst = worst.map(|((a, b), rotor)| (a - b).abs() / rotor.max_thrust()).fold(0.0, f64::max);
        // measured: 2e-9, the accuracy of a linear program
        assert!(upright.is_level() && worst < 1e-6, "{seed}: {worst:e}\n{own:?}\n{upright:?}");
        leaning += usize::from(!own.is_level());
    }
    assert!(leaning > 50, "{leaning}");
}
