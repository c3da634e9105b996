//! Contract: a vehicle as a tree of one body moves as the closed-form multirotor does, under every effect.

use super::common::*;
use super::models;
use crate::common::measure::larger;
use omnidrones::autodiff::System;
use omnidrones::dynamics::tree::Multibody;
use omnidrones::dynamics::{Effects, Integrator, Multirotor, Physics, Vehicle, vehicle::GRAVITY, vehicles};
use omnidrones::rng::Stream;

/// The two systems agree in layout, so one state and input serve both.
struct Pair {
    tree: Multibody,
    closed: Multirotor,
}

impl Pair {
    fn new(vehicle: &Vehicle, physics: Physics) -> Self {
        let tree = Multibody::new(&models::of_vehicle(vehicle), physics).unwrap();
        let closed = Multirotor::new(vehicle, physics).unwrap();
        assert_eq!((tree.n_state(), tree.n_input()), (closed.n_state(), closed.n_input()));
        Self { tree, closed }
    }

    /// Low enough to feel the ground, with a wind, a force and a moment if the systems take them.
    fn draw(&self, stream: &mut Stream) -> (Vec<f64>, Vec<f64>) {
        let mut x = random_state(&self.tree, stream);
        x[2] = stream.uniform(0.2, 2.0);
        let n_rotor = self.tree.layout().rotor_speed.len();
        let mut u: Vec<f64> = (0..self.tree.n_input()).map(|_| stream.uniform(-1.2, 1.2)).collect();
        let weight = self.tree.model().mass() * GRAVITY;
        for (k, d) in u[n_rotor..].iter_mut().enumerate() {
            *d *= [2.0, 0.2 * weight, 0.01 * weight][k / 3];
        }
        (x, u)
    }
}

/// Largest gap of v̇ and ω̇, and of the rotors' rates, each over the largest of its kind.
fn largest_gap(vehicle: &Vehicle, ours: Effects, theirs: Effects) -> f64 {
    let physics = |effects| Physics { effects, ..Physics::default() };
    let mut pair = Pair::new(vehicle, physics(ours));
    pair.closed = Multirotor::new(vehicle, physics(theirs)).unwrap();
    let mut stream = stream(3);
    let mut worst = 0.0_f64;
    for _ in 0..200 {
        let (x, u) = pair.draw(&mut stream);
        let (mut got, mut wanted) = (vec![0.0; x.len()], vec![0.0; x.len()]);
        pair.tree.derivative::<f64>(&x, &u, &[], &mut got);
        pair.closed.derivative::<f64>(&x, &u, &[], &mut wanted);
        for part in [0..3, 3..6, 6..10, 10..13, 13..x.len()] {
            worst = larger(worst, gap(&got[part.clone()], &wanted[part]));
        }
    }
    worst
}

#[test]
fn a_tree_of_one_body_accelerates_as_the_closed_form() {
    let all = Effects::all();
    for vehicle in vehicles::all() {
        // measured 3.8e-15 with all effects, Crazyflie, 1.3e-14 without, Iris
        at_most(&format!("{}: all effects", vehicle.name), largest_gap(&vehicle, all, all), 3e-13);
        let none = Effects::none();
        at_most(&format!("{}: no effects", vehicle.name), largest_gap(&vehicle, none, none), 1e-12);
    }
}

#[test]
fn every_effect_alone_is_the_closed_forms() {
    let none = Effects::none();
    let cases: [(&str, Effects); 7] = [
        ("body_drag", Effects { body_drag: true, ..none }),
        ("quadratic_drag", Effects { quadratic_drag: true, ..none }),
        ("rotor_drag", Effects { rotor_drag: true, ..none }),
        ("rolling_moment", Effects { rolling_moment: true, ..none }),
        ("rotor_inertia", Effects { rotor_inertia: true, ..none }),
        ("ground_effect", Effects { ground_effect: true, ..none }),
        ("disturbance", Effects { disturbance: true, ..none }),
    ];
    for mut vehicle in vehicles::all() {
        // what a vehicle lacks, an effect would not show
        vehicle.drag.linear = [0.3, 0.25, 0.4];
        vehicle.drag.quadratic = [0.02, 0.03, 0.05];
        vehicle.drag.angular = [0.003, 0.002, 0.004];
        for rotor in &mut vehicle.rotors {
            (rotor.inertia, rotor.radius) = (4e-5, 0.1);
            (rotor.drag_coefficient, rotor.axial_drag_coefficient, rotor.rolling_coefficient) = (1e-4, 3e-5, 2e-6);
        }
        for (name, effects) in cases {
            // measured 1.4e-14, Iris
            at_most(&format!("{}: {name}", vehicle.name), largest_gap(&vehicle, effects, effects), 1e-12);
            if name != "disturbance" {
                let without = largest_gap(&vehicle, none, effects);
                assert!(without > 1e-6, "{}: {name} does nothing: {without:.3e}", vehicle.name);
            }
        }
    }
}

#[test]
fn one_rotor_alone_pushes_and_lags_as_in_the_closed_form() {
    let mut stream = stream(5);
    for mut vehicle in vehicles::all() {
        for rotor in &mut vehicle.rotors {
            (rotor.inertia, rotor.radius, rotor.rolling_coefficient) = (4e-5, 0.1, 2e-6);
        }
        let pair = Pair::new(&vehicle, Physics { effects: Effects::all(), ..Physics::default() });
        for own in 0..vehicle.n_rotor() {
            let (mut x, u) = pair.draw(&mut stream);
            (0..vehicle.n_rotor()).filter(|r| *r != own).for_each(|r| x[13 + r] = 0.0);
            let (mut got, mut wanted) = (vec![0.0; x.len()], vec![0.0; x.len()]);
            pair.tree.derivative::<f64>(&x, &u, &[], &mut got);
            pair.closed.derivative::<f64>(&x, &u, &[], &mut wanted);
            for part in [3..6, 10..13] {
                let off = gap(&got[part.clone()], &wanted[part]);
                // measured 7.5e-16, Iris
                at_most(&format!("{}: rotor {own} alone", vehicle.name), off, 7e-14);
            }
            pair.tree.step::<f64>(&x, &u, &[], &mut got);
            pair.closed.step::<f64>(&x, &u, &[], &mut wanted);
            assert_eq!(got[13..], wanted[13..], "{}: speeds after a step, to the bit", vehicle.name);
        }
    }
}

/// Largest gap after a step of `dt`, over the largest change of its kind in the step.
fn largest_gap_of_a_step(vehicle: &Vehicle, integrator: Integrator, dt: f64) -> f64 {
    let pair = Pair::new(vehicle, Physics { dt, integrator, effects: Effects::all(), ..Physics::default() });
    let mut stream = stream(4);
    let mut worst = 0.0_f64;
    for _ in 0..50 {
        let (x, u) = pair.draw(&mut stream);
        let (mut got, mut wanted) = (vec![0.0; x.len()], vec![0.0; x.len()]);
        pair.tree.step::<f64>(&x, &u, &[], &mut got);
        pair.closed.step::<f64>(&x, &u, &[], &mut wanted);
        for k in 0..x.len() {
            (got[k], wanted[k]) = (got[k] - x[k], wanted[k] - x[k]);
        }
        for part in [0..3, 3..6, 6..10, 10..13, 13..x.len()] {
            worst = larger(worst, gap(&got[part.clone()], &wanted[part]));
        }
    }
    worst
}

/// The closed form steps the centre of mass and a tree its root's origin: their steps differ by the integrator's error,
/// which vanishes as h⁵ (RK4) or h² (semi-implicit), h⁴ and h of the change in a step.
#[test]
fn a_tree_of_one_body_steps_as_the_closed_form_but_for_the_integrators_error() {
    for (integrator, least_ratio, bound) in
        [(Integrator::RungeKutta4, 12.0, 1.5e-7), (Integrator::SemiImplicit, 1.7, 0.1)]
    {
        for vehicle in vehicles::all() {
            let [long, short] = [2e-3, 1e-3].map(|dt| largest_gap_of_a_step(&vehicle, integrator, dt));
            let what = format!("{}: {integrator:?} step", vehicle.name);
            // measured 7.1e-8 and 15.7 times less, 1.9e-2 and 1.9 times less, Crazyflie
            at_most(&what, long, bound);
            at_most(&format!("{what} at half the length"), short, (long / least_ratio).max(1e-12));
        }
    }
}
