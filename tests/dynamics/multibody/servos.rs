//! Contract: rate servos lag by their time constant, every servo is stable at any step and gain, and none exceeds its bound.

use super::common::*;
use crate::common::measure::larger;
use crate::common::tree::{state, stream};
use omnidrones::autodiff::System;
use omnidrones::dynamics::configurations::Dragon;
use omnidrones::dynamics::tree::{Model, Multibody, inverse_dynamics};
use omnidrones::dynamics::{Effects, Integrator, Physics};

/// Bodies with a rate servo.
fn rate_servos(model: &Model) -> Vec<usize> {
    let is_rate = |i: &usize| model.bodies()[*i].joint.drive.is_some_and(|d| d.stiffness == 0.0);
    (0..model.bodies().len()).filter(is_rate).collect()
}

/// Rates of body `i`'s joint over the target after each step, from rest, with half the full command on it alone.
fn response(model: &Model, i: usize, physics: Physics, duration: f64) -> Vec<f64> {
    let system = Multibody::new(&weightless(&still(model)), physics).unwrap();
    let (mut x, mut u) = (system.rest_state(), system.rest_input());
    u[system.layout().drive[i].unwrap()] = 0.5;
    let target = 0.5 * model.bodies()[i].joint.drive.unwrap().range;
    let n = (duration / physics.dt).round() as usize;
    (0..n)
        .map(|_| {
            fly(&system, &mut x, &u, 1);
            x[system.layout().bodies[i].velocity] / target
        })
        .collect()
}

#[test]
fn rate_servos_reach_63_percent_after_20_ms() {
    for (name, model) in configurations() {
        for i in rate_servos(&model) {
            let (dt, level) = (1e-4, 1.0 - (-1.0_f64).exp());
            let rates = response(&model, i, rk4(dt, Effects::none()), 0.1);
            let k = rates.iter().position(|r| *r >= level).unwrap_or(rates.len() - 1);
            // the step that crossed, cut where it crossed; the first rate is that after one step
            let before = if k == 0 { 0.0 } else { rates[k - 1] };
            let time = dt * (k as f64 + (level - before) / (rates[k] - before));
            let joint = &model.bodies()[i].joint.name;
            // measured 19.0 ms dragon about x, where bends give way, 20.05 ms elsewhere
            near(&format!("{name}, {joint}: time to 63 %, s"), time, 0.02, 0.0015);
        }
    }
}

#[test]
fn the_response_of_a_servo_ends_at_the_same_rate_at_16_ms_as_at_1_ms_and_does_not_overshoot() {
    for (name, model) in configurations() {
        for i in rate_servos(&model) {
            for integrator in [Integrator::RungeKutta4, Integrator::SemiImplicit] {
                let at = |dt| Physics { integrator, ..rk4(dt, Effects::none()) };
                let (coarse, fine) = (response(&model, i, at(0.016), 0.16), response(&model, i, at(0.001), 0.16));
                let what = format!("{name}, {}, {integrator:?}", model.bodies()[i].joint.name);
                // the implicit lag 1 − (1 + h/T)^−k: 0.44, 0.69, 0.83 …
                // measured 0.084 dragon about x, 1e-4 elsewhere
                at_most(&format!("{what}: first step off the implicit lag"), (coarse[0] - 0.4444).abs(), 0.1);
                let most = coarse.iter().chain(&fine).fold(0.0_f64, |m, r| m.max(*r));
                // measured 0.9996
                at_most(&format!("{what}: largest rate over target"), most, 1.001);
                let gap = (coarse[9] - fine[159]).abs();
                // measured 4.7e-3 dragon about x, 2.4e-3 elsewhere
                at_most(&format!("{what}: gap after 0.16 s"), gap, 0.01);
            }
        }
    }
}

/// With all gains multiplied.
fn stiffer(model: &Model, factor: f64) -> Model {
    changed(model, |parts| {
        for drive in parts.bodies.iter_mut().filter_map(|b| b.joint.drive.as_mut()) {
            (drive.stiffness, drive.damping) = (factor * drive.stiffness, factor * drive.damping);
        }
    })
}

/// Largest |τ|/τ_max of any drive and |q̇| of any hinge over ten seconds of random commands, held for 0.16 s, and the
/// largest |q̇| ten seconds after they have ended.
fn chatter(model: &Model, physics: Physics) -> [f64; 3] {
    let system = Multibody::new(&weightless(&still(model)), physics).unwrap();
    let mut x = system.rest_state();
    let mut r = stream(30, 0);
    let hinges = |x: &[f64]| {
        let places = model.layout().bodies.iter().filter(|p| p.n_freedom == 1);
        places.map(|p| x[p.velocity].abs()).fold(0.0, larger)
    };
    let (mut bound, mut rate) = (0.0_f64, 0.0_f64);
    let (n, held) = ((10.0 / physics.dt) as usize, (0.16 / physics.dt) as usize);
    let mut u = system.rest_input();
    let mut next = x.clone();
    for k in 0..n {
        if k % held == 0 {
            u.iter_mut().for_each(|a| *a = r.uniform(-1.0, 1.0));
        }
        system.step::<f64>(&x, &u, &[], &mut next);
        assert!(next.iter().all(|v| v.is_finite()), "step {k}");
        bound = larger(bound, torque_over_bound(&system, &x, &next, &u));
        rate = larger(rate, hinges(&next));
        std::mem::swap(&mut x, &mut next);
    }
    fly(&system, &mut x, &system.rest_input(), (10.0 / physics.dt) as usize);
    [bound, rate, hinges(&x)]
}

/// Torques that the step from `x` to `next` took, by inverse dynamics, over the bounds.
fn torque_over_bound(system: &Multibody, x: &[f64], next: &[f64], u: &[f64]) -> f64 {
    let (model, h) = (system.model(), system.physics().dt);
    let mut acceleration = vec![0.0; model.layout().n_velocity()];
    for place in &model.layout().bodies {
        for k in 0..place.n_freedom {
            // a floating body's angular velocity stands behind its attitude
            let at = if k < 3 { place.velocity + k } else { place.position + 7 + k };
            acceleration[place.freedom + k] = (next[at] - x[at]) / h;
        }
    }
    let mut torque = vec![0.0; acceleration.len()];
    inverse_dynamics(system, x, u, &acceleration, &mut torque);
    let over = model.bodies().iter().zip(&model.layout().bodies).map(|(body, place)| match body.joint.drive {
        Some(drive) => torque[place.freedom].abs() / drive.max_torque,
        None => 0.0,
    });
    over.fold(0.0, larger)
}

#[test]
fn servos_are_stable_and_bounded_at_16_ms_even_with_a_thousand_times_the_gain() {
    for (name, model) in configurations().filter(|(_, m)| m.bodies().iter().any(|b| b.joint.drive.is_some())) {
        for gain in [1.0, 1000.0] {
            // stops push too, so they are left out where torques are read from accelerations
            let model = changed(&stiffer(&model, gain), |p| p.bodies.iter_mut().for_each(|b| b.joint.limits = None));
            let what = |part: &str| format!("{name} × {gain}: {part}");
            let [bound, rate, rest] = chatter(&model, semi_implicit(0.016, Effects::none()));
            // measured 1.0001 (to the implicit gyroscopic moment), 13 rad/s and less, 3.5e-3 rad/s and less
            at_most(&what("torque over its bound, semi-implicit"), bound, 1.01);
            at_most(&what("hinge rate, semi-implicit"), rate, 60.0);
            at_most(&what("hinge rate 10 s later, semi-implicit"), rest, 1e-2);
            let [_, rate, rest] = chatter(&model, rk4(0.016, Effects::none()));
            at_most(&what("hinge rate, RK4"), rate, 60.0);
            at_most(&what("hinge rate 10 s later, RK4"), rest, 1e-2);
        }
    }
}

#[test]
fn a_damper_too_fast_for_the_step_is_taken_implicitly() {
    // 28.65 N m s/rad on 0.01 kg m² and less: explicit RK4 at 16 ms loses it within ten steps
    let dragon = Dragon::default().build().unwrap().model;
    let damped = changed(&loose(&dragon), |parts| {
        for (body, own) in parts.bodies.iter_mut().zip(dragon.bodies()) {
            body.joint.damping = own.joint.drive.map_or(0.0, |d| d.damping);
        }
    });
    for physics in [rk4(0.016, Effects::none()), semi_implicit(0.016, Effects::none())] {
        let system = Multibody::new(&weightless(&still(&damped)), physics).unwrap();
        let mut x = state(system.model(), &mut stream(31, 0));
        fly(&system, &mut x, &[], 600);
        let fastest = system.layout().bodies[1..].iter().map(|p| x[p.velocity].abs()).fold(0.0, larger);
        // measured 0.13: the chain turns on
        at_most(&format!("{:?}: hinge rate after 10 s", physics.integrator), fastest, 1.0);
    }
}
