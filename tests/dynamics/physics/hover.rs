//! Contract: hover is an equilibrium, whatever the step, the number of substeps and the integrator.

use super::common::*;
use crate::common::measure::larger;
use omnidrones::dynamics::{Effects, Integrator, Physics, Vehicle, vehicles};

/// Where one second of hover leads from (1, −2, 3): largest |x − x₀| of the rigid part.
fn drift(vehicle: &Vehicle, physics: Physics, excess: f64) -> f64 {
    let flight = Flight::new(vehicle, physics);
    let x = flight.system.hover_state([1.0, -2.0, 3.0]).unwrap();
    let mut u = flight.system.hover_input().unwrap();
    for action in &mut u {
        *action += excess * (*action + 1.0);
    }
    let end = flight.after(&x, &u, (1.0 / physics.dt).round() as usize);
    end.iter().zip(&x).take(13).map(|(a, b)| (a - b).abs()).fold(0.0, larger)
}

#[test]
fn hover_holds_for_every_vehicle_step_number_of_substeps_and_integrator() {
    for vehicle in vehicles::all() {
        let mut worst = 0.0_f64;
        for integrator in [Integrator::RungeKutta4, Integrator::SemiImplicit] {
            for effects in [Effects::none(), Effects::default(), still_air()] {
                // far from the ground: its effect is not part of the hover thrust
                let effects = Effects { ground_effect: false, ..effects };
                for dt in [0.001, 0.016] {
                    for substeps in [1, 2, 4, 16] {
                        worst = larger(worst, drift(&vehicle, Physics { dt, substeps, integrator, effects }, 0.0));
                    }
                }
            }
        }
        // measured 1.3e-13, Crazyflie; Neo11 was at 3.9e-5 while its horizontal forces were left unbalanced
        at_most(&format!("{}: drift in 1 s of hover", vehicle.name), worst, 1e-11);
        // twin: a millionth more thrust is 5e-6 m higher after a second
        let physics = Physics { dt: 0.016, effects: Effects::none(), ..Physics::default() };
        let climb = drift(&vehicle, physics, 1e-6);
        assert!(climb > 1e-6, "{}: {climb:.3e}", vehicle.name);
    }
}

#[test]
fn a_climb_depends_on_the_number_of_substeps_only_within_the_integrators_order() {
    for vehicle in vehicles::all() {
        let end = |substeps: usize| {
            let physics = Physics { dt: 0.016, substeps, effects: Effects::default(), ..Physics::default() };
            let flight = Flight::new(&vehicle, physics);
            let x = flight.system.hover_state([0.0; 3]).unwrap();
            let mut u = flight.system.hover_input().unwrap();
            u.iter_mut().for_each(|a| *a += 0.1);
            flight.after(&x, &u, 62)
        };
        let best = end(16);
        for (substeps, most) in [(1, 3e-5), (2, 2e-6), (4, 1.2e-7)] {
            let gap = difference(&best, &end(substeps));
            // measured 1.5e-5, 9.1e-7, 5.7e-8 at 1, 2, 4
            at_most(&format!("{}: climb at {substeps} substeps", vehicle.name), gap, most);
        }
    }
}
