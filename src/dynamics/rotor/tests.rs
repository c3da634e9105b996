use super::*;
use crate::batch::BatchPlant;
use crate::domain::Domain;
use crate::rigid::{parameter_domains, parameter_names, parameter_vector};
use crate::tree::{model_parameter_domains, model_parameter_names, model_parameters};
use crate::{Effects, Physics, Rotor, Vehicle, assembly, vehicles};
use autodiff::trace::on_constants;
use autodiff::{Scalar, Trace};
use num_dual::Dual64;

const N: usize = N_ROTOR_PARAMETER;

/// A vehicle whose rotors differ in all their numbers, from each other and from zero.
fn uneven() -> Vehicle {
    let mut vehicle = vehicles::by_name("omav").unwrap();
    for (i, rotor) in vehicle.rotors.iter_mut().enumerate() {
        let some = 1.0 + 0.01 * i as f64;
        rotor.position[2] = 0.02 * some;
        (rotor.inertia, rotor.radius, rotor.moment_per_thrust) = (4e-5 * some, 0.1, 0.016 * some);
        (rotor.drag_coefficient, rotor.axial_drag_coefficient, rotor.rolling_coefficient) =
            (1e-4 * some, 3e-5 * some, 2e-6 * some);
    }
    vehicle
}

#[test]
fn every_number_of_the_table_stands_at_its_place_in_vectors_names_and_domains() {
    let vehicle = uneven();
    let model = assembly::single(&vehicle).unwrap();
    let first = model_parameter_names(&model).iter().position(|n| n.ends_with("rotor_0.position_x")).unwrap();
    let rigid = (parameter_vector(&vehicle), parameter_names(&vehicle), parameter_domains(&vehicle));
    let tree = (model_parameters(&model), model_parameter_names(&model), model_parameter_domains(&model));
    let begins = [crate::rigid::BODY_PARAMETERS.len(), first];
    for ((values, names, domains), first) in [rigid, tree].into_iter().zip(begins) {
        assert_eq!((values.len(), domains.len()), (names.len(), names.len()));
        for (r, rotor) in vehicle.rotors.iter().enumerate() {
            for (k, p) in ROTOR_PARAMETERS.iter().enumerate() {
                let at = first + r * N + k;
                assert!(names[at].ends_with(&format!("rotor_{r}.{}", p.name)), "{}: {}", names[at], p.name);
                assert_eq!((values[at], domains[at]), ((p.get)(rotor), p.domain), "{}", names[at]);
            }
        }
    }
}

#[test]
fn every_number_of_the_table_is_one_field_of_a_rotor() {
    let rotor = &uneven().rotors[0];
    let file = serde_json::to_value(rotor).unwrap();
    for (k, p) in ROTOR_PARAMETERS.iter().enumerate() {
        let mut own = rotor.clone();
        (p.set)(&mut own, 7.5);
        for (other, q) in ROTOR_PARAMETERS.iter().enumerate() {
            assert_eq!((q.get)(&own), if other == k { 7.5 } else { (q.get)(rotor) }, "{} by {}", q.name, p.name);
        }
        let (name, axis) = match p.name.rsplit_once('_') {
            Some((name, "x")) => (name, Some(0)),
            Some((name, "y")) => (name, Some(1)),
            Some((name, "z")) => (name, Some(2)),
            _ => (p.name, None),
        };
        let field = axis.map_or(&file[name], |axis| &file[name][axis]);
        assert_eq!(field.as_f64(), Some((p.get)(rotor)), "{} in a file", p.name);
    }
    let mut copy = Rotor { spin: -rotor.spin, ..vehicles::by_name("iris").unwrap().rotors[0].clone() };
    copy.set_parameters(&rotor.parameters());
    assert_eq!(copy.parameters(), rotor.parameters());
}

#[test]
fn every_number_of_a_rotor_reaches_the_rows_of_its_kernel_in_the_order_of_the_table() {
    let vehicle = uneven();
    let physics = Physics { effects: Effects::all(), ..Physics::default() };
    let (plant, _) = BatchPlant::rigid(&vehicle, physics).unwrap();
    let rows = |numbers: &[f64]| {
        on_constants(|| {
            let numbers: Vec<Trace> = numbers.iter().map(|x| Trace::constant(*x)).collect();
            plant.numbers_of(&numbers).into_iter().map(|x| x.known().unwrap()).collect::<Vec<f64>>()
        })
    };
    let nominal = parameter_vector(&vehicle);
    let usual = rows(&nominal);
    let mut owner = vec![None; usual.len()];
    for r in 0..vehicle.n_rotor() {
        let mut last = 0;
        for (k, p) in ROTOR_PARAMETERS.iter().enumerate() {
            let mut numbers = nominal.clone();
            numbers[nominal.len() - (vehicle.n_rotor() - r) * N + k] += 0.25 * (p.get)(&vehicle.rotors[r]) + 1e-3;
            let changed: Vec<usize> = rows(&numbers)
                .iter()
                .zip(&usual)
                .enumerate()
                .filter(|(_, (a, b))| a != b)
                .map(|(row, _)| row)
                .collect();
            assert!(!changed.is_empty(), "rotor {r}: {} reaches no row", p.name);
            for row in &changed {
                assert_eq!(*owner[*row].get_or_insert(r), r, "row {row} belongs to two rotors");
            }
            // those that kernels read as they are, but for the sign of the spin
            let plain = matches!(p.domain, Domain::AnySign | Domain::UnitVector) || k >= at::inertia;
            if plain {
                assert!(changed[changed.len() - 1] > last, "rotor {r}: {} out of order", p.name);
                last = changed[changed.len() - 1];
            }
        }
    }
}

#[test]
fn the_slope_of_the_command_map_is_finite_at_its_lower_end_and_bounded_everywhere() {
    let of = |a: f64| commanded_speed(Dual64::from_re(838.0), Dual64::new(a, 1.0));
    let end = of(-1.0);
    assert_eq!((end.re, end.eps), (838.0 * LEAST_THRUST.sqrt(), 0.0));
    // steepest where the floor ends: dΩ/da = Ω_max/(4 √t)
    let steepest = 838.0 / (4.0 * LEAST_THRUST.sqrt());
    for k in 0..=4000 {
        let a = -1.2 + 2.4 * f64::from(k) / 4000.0;
        let speed = of(a);
        assert!(speed.eps.is_finite() && (0.0..=steepest * (1.0 + 1e-9)).contains(&speed.eps), "{a}: {speed:?}");
        if (-0.99..=1.0).contains(&a) {
            let back = holding_action(838.0, speed.re);
            assert!((back - a).abs() < 1e-14, "{a}: {back}"); // measured 2.2e-16
        }
    }
    assert_eq!((of(1.0).re, of(7.0).re, of(-7.0).re), (838.0, 838.0, end.re));
}

#[test]
fn the_lag_is_its_closed_form_in_both_directions() {
    let (up, down, h) = (0.0125, 0.025, 0.004);
    let mut rotor = uneven().rotors[0].clone();
    (rotor.time_constant_up, rotor.time_constant_down) = (up, down);
    let motors = Motors::new(&rotor.parameters(), h);
    for (start, target, tau) in [(100.0_f64, 700.0_f64, up), (700.0, 100.0, down), (300.0, 300.0, down)] {
        let mut lag = Lag::new(motors.towards(start, target), start, target);
        for t in [0.5 * h, h] {
            let wanted = target + (start - target) * (-t / tau).exp();
            let speed = lag.advance();
            assert!((speed / wanted - 1.0).abs() < 4e-15, "{start} → {target} after {t}: {speed} for {wanted}");
            assert!((lag.acceleration(speed) * tau - (target - speed)).abs() < 1e-12);
        }
    }
}

#[test]
fn one_rotor_has_the_same_wrench_in_a_rigid_vehicle_and_on_a_body_of_a_tree() {
    let vehicle = uneven();
    let center = vehicle.mass_properties().center_of_mass;
    let (velocity, w) = ([3.0, -2.0, 1.0], [0.5, -0.7, 1.1]);
    for rotor in &vehicle.rotors {
        let about = |origin| {
            let model = RotorModel::new(&rotor.parameters(), origin, rotor.radius);
            let (mut sum, mut momentum, mut rate) = (Wrench::zero(), [0.0; 3], [0.0; 3]);
            model.add_thrust(500.0, Some(0.12), true, &mut sum);
            // the velocity of the reference point
            model.add_drag(500.0, add(velocity, cross(w, origin)), w, Effects::all(), &mut sum);
            model.add_momentum(500.0, 2e3, &mut momentum, &mut rate);
            (sum, momentum, rate)
        };
        let ((own, h, rate), (other, h_other, rate_other)) = (about([0.0; 3]), about(center.into()));
        assert_eq!((h, rate), (h_other, rate_other));
        for k in 0..3 {
            assert!((own.force[k] - other.force[k]).abs() < 1e-12, "{own:?} against {other:?}");
            let carried = cross(center.into(), own.force)[k];
            assert!((own.moment[k] - carried - other.moment[k]).abs() < 1e-12, "{own:?} against {other:?}");
        }
    }
}
