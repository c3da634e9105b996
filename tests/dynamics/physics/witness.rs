//! Contract: an independent engine gives the same accelerations.
//!
//! `tests/oracle/mujoco_rigid.json` holds vehicles as they were, random states, and accelerations by MuJoCo, which saw
//! the parts as separate bodies, the rotors as hinged bodies that really spin, and thrusts as forces at the hubs. Made by
//! `tests/oracle/mujoco_rigid.py`, which says how. Its vehicles are copies: editing a vehicle needs no new file.

use super::common::*;
use crate::common::measure::larger;
use omnidrones::dynamics::{Effects, Vehicle, vehicles};
use serde::Deserialize;

#[derive(Deserialize)]
struct Golden {
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    vehicle: Vehicle,
    /// State, then action, as a step takes them; the attitude not yet of unit length.
    states: Vec<(Vec<f64>, Vec<f64>)>,
    /// v̇ of the base origin (world), ω̇ (body).
    accelerations: Vec<[f64; 6]>,
}

fn golden() -> Golden {
    serde_json::from_str(include_str!("../../oracle/mujoco_rigid.json")).unwrap()
}

/// Largest ‖a − b‖/‖b‖ of linear and angular accelerations.
fn largest_gap(case: &Case, effects: Effects) -> f64 {
    let flight = Flight::new(&case.vehicle, rk4(0.002, effects));
    let mut worst = 0.0_f64;
    for ((x, u), wanted) in case.states.iter().zip(&case.accelerations) {
        let mut x = x.clone();
        let norm = x[6..10].iter().map(|q| q * q).sum::<f64>().sqrt();
        x[6..10].iter_mut().for_each(|q| *q /= norm);
        let rate = flight.derivative(&x, u);
        for (at, from) in [(3, 0), (10, 3)] {
            let gap = (vector(&rate, at) - vector(wanted, from)).norm() / vector(wanted, from).norm();
            worst = larger(worst, gap);
        }
    }
    worst
}

#[test]
fn accelerations_are_those_of_mujoco_with_spinning_rotors_for_every_vehicle() {
    let golden = golden();
    for case in &golden.cases {
        let spinning = Effects { rotor_inertia: true, ..Effects::none() };
        // measured 6.1e-13, Omav
        at_most(&format!("{}: against MuJoCo", case.vehicle.name), largest_gap(case, spinning), 1e-12);
        // twin: leave the rotors' momentum out
        let defect = largest_gap(case, Effects::none());
        assert!(defect > 1e-6, "{}: {defect:.3e}", case.vehicle.name);
    }
    for name in vehicles::names() {
        let covered = golden.cases.iter().any(|c| c.vehicle.name == name);
        assert!(covered, "{name} is not in the golden file: run tests/oracle/mujoco_rigid.py");
    }
}

/// Prints what the oracle script reads.
#[test]
#[ignore = "cargo test --test dynamics physics -- --ignored --nocapture: prints the vehicles for tests/oracle/mujoco_rigid.py"]
fn print_vehicles() {
    println!("VEHICLES {}", serde_json::to_string(&vehicles::all()).unwrap());
}
