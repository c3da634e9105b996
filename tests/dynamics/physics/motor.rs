//! Contract: a rotor's speed follows Ω(t) = Ω_cmd + (Ω₀ − Ω_cmd) e^{−t/τ}, with its own τ up and down, at any step.

use super::common::*;
use crate::common::measure::larger;
use omnidrones::dynamics::{Effects, Integrator, Physics, Vehicle, vehicles};

/// Speeds over 0.48 s at every 16 ms: up for a third, then down, then in between.
fn response(vehicle: &Vehicle, dt: f64, substeps: usize, integrator: Integrator) -> Vec<f64> {
    let flight = Flight::new(vehicle, Physics { dt, substeps, integrator, effects: Effects::none() });
    let mut x = flight.system.hover_state([0.0; 3]).unwrap();
    let n = vehicle.n_rotor();
    let mut speeds = Vec::new();
    for action in [0.9, -1.5, -0.2] {
        for _ in 0..10 {
            x = flight.after(&x, &vec![action; n], (0.016 / dt).round() as usize);
            speeds.extend_from_slice(&x[13..]);
        }
    }
    speeds
}

fn gap(vehicle: &Vehicle, a: &[f64], b: &[f64]) -> f64 {
    let largest = vehicle.rotors.iter().map(|r| r.max_speed).fold(0.0, larger);
    a.iter().zip(b).map(|(a, b)| (a - b).abs() / largest).fold(0.0, larger)
}

#[test]
fn motor_response_does_not_depend_on_step_substeps_or_integrator() {
    for vehicle in vehicles::all() {
        let coarse = response(&vehicle, 0.016, 1, Integrator::RungeKutta4);
        for (dt, substeps, integrator) in [
            (0.001, 1, Integrator::RungeKutta4),
            (0.002, 1, Integrator::SemiImplicit),
            (0.008, 1, Integrator::RungeKutta4),
            (0.016, 16, Integrator::SemiImplicit),
        ] {
            let other = response(&vehicle, dt, substeps, integrator);
            // measured 1.0e-15
            at_most(&format!("{}: Ω at {dt} s", vehicle.name), gap(&vehicle, &coarse, &other), 1e-13);
        }
    }
    // twin: a lag with a fixed gain of Δt/τ per step, as it is often coded
    let euler = |dt: f64| (0..(0.016 / dt) as usize).fold(0.0, |s, _| s + dt / 0.025 * (1.0 - s));
    assert!((euler(0.016) - euler(0.001_f64)).abs() > 0.1);
}

#[test]
fn motor_response_is_the_closed_form_with_its_own_constant_in_each_direction() {
    for vehicle in vehicles::all() {
        let got = response(&vehicle, 0.002, 1, Integrator::RungeKutta4);
        let start = Flight::new(&vehicle, Physics::default()).system.hover_state([0.0; 3]).unwrap();
        let mut wanted = vec![0.0; got.len()];
        let mut swapped = wanted.clone();
        for (i, rotor) in vehicle.rotors.iter().enumerate() {
            for (out, tau) in [
                (&mut wanted, [rotor.time_constant_up, rotor.time_constant_down]),
                (&mut swapped, [rotor.time_constant_down, rotor.time_constant_up]),
            ] {
                let mut from = start[13 + i];
                for (phase, fraction) in [0.95_f64, 1e-4, 0.4].into_iter().enumerate() {
                    let target = rotor.max_speed * fraction.sqrt();
                    let tau = if from < target { tau[0] } else { tau[1] };
                    let at = |t: f64| target + (from - target) * (-t / tau).exp();
                    for k in 0..10 {
                        out[(phase * 10 + k) * vehicle.n_rotor() + i] = at(0.016 * (k + 1) as f64);
                    }
                    from = at(0.16);
                }
            }
        }
        // measured 4.3e-16
        at_most(&format!("{}: Ω against the closed form", vehicle.name), gap(&vehicle, &wanted, &got), 4e-14);
        if vehicle.rotors.iter().any(|r| r.time_constant_up != r.time_constant_down) {
            // twin: up and down exchanged
            let defect = gap(&vehicle, &swapped, &got);
            assert!(defect > 0.05, "{}: {defect:.3e}", vehicle.name);
        }
    }
}
