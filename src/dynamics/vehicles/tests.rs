//! Every vehicle of the registry, judged by the same claims. A new one is picked up by itself.

use super::*;
use crate::vehicle::GRAVITY;
use nalgebra::{DVector, Vector3};
use sha2::{Digest, Sha256};
use std::time::Instant;
use toml::Value;

/// The first eight bytes of a hash over every name, word and number of a vehicle, numbers by their bits, recorded when the
/// vehicles were still computed from the constants of their published tables.
const BITS: &[(&str, &str)] = &[
    ("crazyflie", "ebec96f9585e5224"),
    ("hummingbird", "a410f69374dbeb49"),
    ("iris", "c9fb87d7abb10aed"),
    ("firefly", "fb31c67bc6ffd7f6"),
    ("neo11", "1e036514d98f6b60"),
    ("omav", "6aa0c051a24f0302"),
];

fn feed(hash: &mut Sha256, value: &Value) {
    match value {
        Value::Float(x) => hash.update(x.to_bits().to_le_bytes()),
        Value::String(word) => hash.update(word),
        Value::Array(list) => list.iter().for_each(|own| feed(hash, own)),
        Value::Table(table) => table.iter().for_each(|(key, own)| {
            hash.update(key);
            feed(hash, own);
        }),
        other => panic!("neither a number nor a word: {other}"),
    }
}

#[test]
fn every_number_of_every_vehicle_has_the_bits_that_its_tables_gave() {
    let bits = |vehicle: Vehicle| -> String {
        let mut hash = Sha256::new();
        feed(&mut hash, &Value::try_from(vehicle).unwrap());
        hash.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect()
    };
    let now: Vec<_> = REGISTRY.iter().map(|entry| (entry.name, bits((entry.build)()))).collect();
    let told: Vec<_> = now.iter().map(|(name, bits)| (*name, bits.as_str())).collect();
    assert_eq!(told, BITS);
}

#[test]
fn a_look_up_reads_the_file_once() {
    for entry in REGISTRY {
        (entry.build)();
        let took = (0..5).map(|_| {
            let begun = Instant::now();
            by_name(entry.name).unwrap();
            begun.elapsed()
        });
        let took = took.min().unwrap();
        // without optimisation 0.9 µs, of omav 2.8
        assert!(took.as_micros() < 200, "{}: {took:?}", entry.name);
    }
}

#[test]
fn every_vehicle_validates_and_bears_its_registry_name() {
    for entry in REGISTRY {
        let vehicle = (entry.build)();
        vehicle.validate().unwrap();
        assert_eq!(vehicle.name, entry.name);
        assert_eq!(by_name(&entry.name.to_uppercase()).unwrap(), vehicle);
        assert!(!vehicle.source.is_empty() && !entry.description.is_empty());
    }
    let mut unique = names();
    unique.sort_unstable();
    unique.dedup();
    assert_eq!(unique.len(), REGISTRY.len());
}

#[test]
fn an_unknown_vehicle_is_refused_with_the_nearest_name() {
    let text = by_name("humingbird").unwrap_err().to_string();
    assert!(text.contains("did you mean 'hummingbird'?"), "{text}");
}

#[test]
fn parts_sum_to_the_published_total_masses() {
    let published = [
        ("crazyflie", 0.0274),
        ("hummingbird", 0.716),
        ("firefly", 1.53),
        ("iris", 1.52),
        ("neo11", 3.45),
        ("omav", 4.04),
    ];
    for (name, mass) in published {
        let got = by_name(name).unwrap().mass_properties().mass;
        // largest difference 9e-16 kg: the tables are exact sums
        assert!((got - mass).abs() < 1e-12, "{name}: {got} against {mass} kg");
    }
}

#[test]
fn thrust_per_weight_and_per_rotor_are_the_published_ones() {
    // rotor thrust as in OmniDrones' table; thrust over weight with the total mass
    let published = [
        ("crazyflie", 0.15435, 2.297),
        ("hummingbird", 6.00319, 3.419),
        ("firefly", 6.00319, 2.400),
        ("iris", 6.00319, 1.610),
        ("neo11", 13.91621, 2.467),
        ("omav", 20.808, 6.300),
    ];
    for (name, thrust, ratio) in published {
        let vehicle = by_name(name).unwrap();
        for rotor in &vehicle.rotors {
            // largest relative difference 2.8e-5: the table has five digits
            assert!((rotor.max_thrust() / thrust - 1.0).abs() < 1e-4, "{name}: {}", rotor.max_thrust());
        }
        let got = vehicle.thrust_to_weight();
        assert!((got / ratio - 1.0).abs() < 1e-3, "{name}: {got} against {ratio}");
    }
    for vehicle in all() {
        let ratio = vehicle.thrust_to_weight();
        assert!((1.3..8.0).contains(&ratio), "{}: {ratio}", vehicle.name);
    }
}

#[test]
fn a_single_rotor_pushes_along_its_axis_and_turns_the_body_by_the_sign_table() {
    for vehicle in all() {
        let allocation = vehicle.allocation_matrix();
        let center = vehicle.mass_properties().center_of_mass;
        for (i, rotor) in vehicle.rotors.iter().enumerate() {
            let what = format!("{} {}", vehicle.name, rotor.name);
            let column = allocation.column(i);
            assert_eq!(column.rows(0, 3).clone_owned(), DVector::from_row_slice(&rotor.axis), "{what}");
            assert!(rotor.axis[2] > 0.9, "{what}: axes point up, so the table applies");
            let lever = Vector3::from(rotor.position) - center;
            // a rotor on the left (+y) lifts that side: roll > 0; one in front (+x) lifts the nose: pitch < 0
            if lever.y.abs() > 0.01 {
                assert!(column[3] * lever.y > 0.0, "{what}: roll {} at y {}", column[3], lever.y);
            }
            if lever.x.abs() > 0.01 {
                assert!(column[4] * lever.x < 0.0, "{what}: pitch {} at x {}", column[4], lever.x);
            }
            // a counter-clockwise rotor pushes the body clockwise
            assert!(column[5] * rotor.spin < 0.0, "{what}: yaw {} at spin {}", column[5], rotor.spin);
        }
    }
}

#[test]
fn yaw_moments_of_equal_thrusts_cancel() {
    for vehicle in all() {
        let wrench = vehicle.allocation_matrix() * DVector::from_element(vehicle.n_rotor(), 1.0);
        let largest = vehicle.allocation_matrix().row(5).abs().max();
        // 0 for all; neo11's axes have four digits and leave 4e-8 of the thrust sideways
        assert!(wrench[5].abs() < 1e-12 * largest, "{}: {} of {largest}", vehicle.name, wrench[5]);
        assert!(wrench[0].abs() < 1e-7 * wrench[2] && wrench[1].abs() < 1e-7 * wrench[2], "{}: {wrench}", vehicle.name);
    }
}

#[test]
fn every_vehicle_can_hover_level_within_its_rotor_limits() {
    for vehicle in all() {
        let allocation = vehicle.allocation_matrix();
        let weight = vehicle.mass_properties().mass * GRAVITY;
        let wanted = DVector::from_row_slice(&[0.0, 0.0, weight, 0.0, 0.0, 0.0]);
        let thrust = allocation.clone().pseudo_inverse(1e-9).unwrap() * &wanted;
        // largest residual 9e-15 N or N m
        assert!((allocation * &thrust - wanted).norm() < 1e-9 * weight, "{}", vehicle.name);
        for (rotor, thrust) in vehicle.rotors.iter().zip(thrust.iter()) {
            // nearest to a limit: iris 0.62, omav 0.16
            let fraction = thrust / rotor.max_thrust();
            assert!((0.1..0.75).contains(&fraction), "{} {}: {fraction}", vehicle.name, rotor.name);
        }
    }
}

#[test]
fn inertia_has_the_mirror_symmetry_of_the_airframe() {
    for vehicle in all() {
        let inertia = vehicle.mass_properties().inertia;
        let largest = inertia.max();
        for (row, column) in [(0, 1), (0, 2), (1, 2)] {
            // 0 but for neo11, 8e-6: its rotors are not quite symmetric front to back
            let product = inertia[(row, column)].abs() / largest;
            assert!(product < 1e-4, "{}: J[{row},{column}] is {product} of the largest", vehicle.name);
        }
    }
}

#[test]
fn rotor_inertias_are_a_tenth_of_the_inflated_published_ones() {
    // OmniDrones and RotorS, (xx, yy, zz); the part averages xx and yy
    let inflated = [
        ("hummingbird", [1.755e-6, 7.507e-5, 7.669e-5]),
        ("firefly", [9.75e-7, 4.170e-5, 4.260e-5]),
        ("iris", [9.75e-7, 4.170e-5, 4.260e-5]),
        ("neo11", [9.75e-7, 8.135e-5, 8.225e-5]),
        ("omav", [2.215e-6, 7.081e-5, 7.293e-5]),
    ];
    for (name, [xx, yy, zz]) in inflated {
        let vehicle = by_name(name).unwrap();
        let rotor = &vehicle.rotors[0];
        let part = vehicle.parts.iter().find(|p| p.name == rotor.name).unwrap();
        // largest relative difference 1e-4, the rounding of the published ones
        assert!((rotor.inertia / (0.1 * zz) - 1.0).abs() < 5e-4, "{name}: {}", rotor.inertia);
        let trace = part.inertia.matrix().trace();
        assert!((trace / (0.1 * (xx + yy + zz)) - 1.0).abs() < 5e-4, "{name}: {trace}");
        let along = (part.inertia.matrix() * Vector3::from(rotor.axis)).dot(&Vector3::from(rotor.axis));
        assert!((along / rotor.inertia - 1.0).abs() < 1e-12, "{name}: {along}");
    }
}

#[test]
fn hovering_iris_needs_the_levers_of_its_positions_not_of_its_yaml_angles() {
    // the swapped angles would give 0.13 m of roll lever and 0.22 of pitch
    let iris = by_name("iris").unwrap();
    let allocation = iris.allocation_matrix();
    assert!((allocation[(3, 2)] - 0.22).abs() < 1e-3 && (allocation[(4, 2)] + 0.13).abs() < 1e-3);
}

#[test]
fn omav_pairs_share_an_arm_and_spin_against_each_other() {
    let omav = by_name("omav").unwrap();
    let find = |name: String| omav.rotors.iter().find(|r| r.name == name).unwrap();
    for j in 0..6 {
        let (upper, lower) = (find(format!("rotor_{j}")), find(format!("rotor_{}", j + 6)));
        assert_eq!(upper.position[..2], lower.position[..2]);
        assert_eq!((upper.position[2], lower.position[2]), (0.06, -0.06));
        assert_eq!(upper.spin, -lower.spin);
        assert!((upper.moment_per_thrust - 0.015).abs() < 1e-12 && (lower.moment_per_thrust - 0.005).abs() < 1e-12);
    }
}
