//! Contract: attitudes keep unit length after every step in every path of a state: of one body, of trees, in lanes.

use crate::common::INTEGRATORS;
use crate::common::measure::larger;
use crate::common::tree::{state, stream};
use crate::multibody::common::{configuration, still, weightless};
use crate::physics::common::{at_most, inert};
use crate::tree::models;
use omnidrones::autodiff::System;
use omnidrones::dynamics::tree::{Model, Motion, Multibody};
use omnidrones::dynamics::{Effects, Inertia, Multirotor, Physics, World};

/// Where the quaternions of a model's state begin.
fn quaternions(model: &Model) -> Vec<usize> {
    let place = |(body, place): (&omnidrones::dynamics::tree::Body, &omnidrones::dynamics::tree::BodyPlace)| match body
        .joint
        .motion
    {
        Motion::Floating => Some(place.position + 6),
        Motion::Ball => Some(place.position),
        Motion::Revolute(_) | Motion::Prismatic(_) => None,
    };
    model.bodies().iter().zip(&model.layout().bodies).filter_map(place).collect()
}

/// Largest |‖q‖ − 1|, and infinity for what is not a number.
fn off(x: &[f64], places: &[usize]) -> f64 {
    let norm = |at: &usize| x[*at..at + 4].iter().map(|q| q * q).sum::<f64>().sqrt();
    let error = places.iter().map(|at| (norm(at) - 1.0).abs());
    error.fold(0.0, |m: f64, e| if e.is_nan() { f64::INFINITY } else { m.max(e) })
}

/// Largest error after any of so many steps.
fn farthest(system: &impl System, mut x: Vec<f64>, places: &[usize], steps: usize) -> f64 {
    let (u, mut next, mut worst) = (vec![-1.0; system.n_input()], x.clone(), 0.0_f64);
    for _ in 0..steps {
        system.step::<f64>(&x, &u, &[], &mut next);
        std::mem::swap(&mut x, &mut next);
        worst = larger(worst, off(&x, places));
    }
    worst
}

/// The same of 64 environments, which take so many steps together.
fn farthest_in_lanes(model: &Model, physics: Physics, steps: usize) -> f64 {
    let mut world = World::of_model(model, physics, 64).unwrap();
    for i in 0..64 {
        let x: Vec<f32> = state(model, &mut stream(90, i)).iter().map(|x| *x as f32).collect();
        world.set_state(i as usize, &x).unwrap();
    }
    let (mut rows, mut worst) = (vec![0.0; 64 * world.n_state()], 0.0_f64);
    let places = quaternions(model);
    for _ in 0..steps / 64 {
        world.step(&[]).unwrap();
        world.read_states(&mut rows).unwrap();
        for row in rows.chunks(world.n_state()) {
            let x: Vec<f64> = row.iter().map(|x| f64::from(*x)).collect();
            worst = larger(worst, off(&x, &places));
        }
    }
    assert!(world.failures().is_empty(), "{}: {:?}", model.name(), world.failures());
    worst
}

fn check(steps: usize) {
    let body = inert(1.0, [0.0; 3], Inertia { xx: 0.010, yy: 0.015, zz: 0.020, xy: 0.001, xz: -0.002, yz: 0.0015 });
    let joints = models::all().into_iter().find(|m| m.name() == "every_joint").unwrap();
    let models = [configuration("payload"), joints].map(|model| weightless(&still(&model)));
    for integrator in INTEGRATORS {
        let physics = Physics { integrator, effects: Effects::none(), ..Physics::default() };
        let rigid = Multirotor::new(&body, physics).unwrap();
        let mut x = vec![0.0; rigid.n_state()];
        x[6] = 1.0;
        x[10..13].copy_from_slice(&[1.0, 2.0, 3.0]);
        // measured 3.3e-16
        at_most(&format!("one body, {integrator:?}"), farthest(&rigid, x, &[6], steps), 4.5e-16);
        for model in &models {
            let (name, tree) = (model.name(), Multibody::new(model, physics).unwrap());
            let start = state(model, &mut stream(91, 0));
            // measured 3.3e-16 after a hundred thousand steps, 4.4e-16 after ten million
            let worst = farthest(&tree, start, &quaternions(model), steps);
            at_most(&format!("{name}, {integrator:?}"), worst, 4.5e-16);
            // measured 1.7e-7, in f32
            at_most(&format!("{name}, {integrator:?}, in lanes"), farthest_in_lanes(model, physics, steps), 2.4e-7);
        }
    }
}

#[test]
fn every_quaternion_is_of_unit_length_after_each_of_a_hundred_thousand_steps() {
    check(100_000);
}

#[test]
#[ignore = "cargo test --test dynamics -- --ignored --nocapture million: half an hour"]
fn every_quaternion_is_of_unit_length_after_each_of_ten_million_steps() {
    check(10_000_000);
}
