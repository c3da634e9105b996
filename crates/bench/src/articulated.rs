//! Steps of the built-in configurations: one after the other in `f64` and `f32`, and in lanes.

use super::{BenchPlan, BenchRow, PHYSICS, seconds};
use omnidrones::autodiff::{Scalar, System};
use omnidrones::dynamics::tree::{Model, Multibody};
use omnidrones::dynamics::{World, configurations};
use omnidrones::error::Result;
use omnidrones::internals::Timed;
use omnidrones::parallel::Threads;
use std::hint::black_box;

/// Three rows per configuration, RK4 at 16 ms with linear drag, all on one core.
pub(super) fn run(plan: &BenchPlan, add: &mut dyn FnMut(BenchRow)) -> Result<()> {
    for model in configurations::all()? {
        let system = Multibody::new(&model, PHYSICS)?;
        let (x, u) = (aloft(&system), vec![-0.2; system.n_input()]);
        let wide = step_time(plan, &system, &x, &u, Timed::step_f64);
        let narrow = step_time(plan, &system, &x, &u, |system, x: &[f32], u, next| system.step(x, u, &[], next));
        let lanes = lane_time(plan, &model, &x)?;
        let n = model.layout().n_velocity();
        for (how, time) in [("f64", wide), ("f32", narrow), ("lanes", lanes)] {
            add(BenchRow {
                group: "articulated",
                name: format!("{}, {n} velocities, {how}", model.name()),
                value: 1e-6 / time,
                unit: "M steps/s",
                ratio: Some(narrow / time),
                baseline: "plain f32 step",
            });
        }
    }
    Ok(())
}

/// Above the ground near rest, rotors half way up. Nothing is exactly zero: what symmetry keeps there decays into
/// subnormal numbers, which are slow, as no real flight's do.
pub(super) fn aloft(system: &Multibody) -> Vec<f64> {
    let mut x = system.rest_state();
    for (k, x) in x.iter_mut().enumerate() {
        *x += 0.01 * (1.0 + k as f64).sin();
    }
    for tree in &system.layout().trees {
        if system.layout().bodies[tree.bodies.start].n_freedom == 6 {
            x[tree.state.start + 2] += 5.0;
        }
    }
    for (at, mounted) in system.layout().rotor_speed.iter().zip(system.model().rotors()) {
        x[*at] = 0.6 * mounted.rotor.max_speed;
    }
    x
}

fn step_time<S: Scalar>(
    plan: &BenchPlan,
    system: &Multibody,
    x: &[f64],
    u: &[f64],
    step: impl Fn(&Multibody, &[S], &[S], &mut [S]),
) -> f64 {
    let x: Vec<S> = x.iter().map(|v| S::constant(*v)).collect();
    let u: Vec<S> = u.iter().map(|v| S::constant(*v)).collect();
    let mut next = x.clone();
    seconds(plan.budget / 4, || {
        step(system, black_box(&x), black_box(&u), &mut next);
        black_box(&next);
    })
}

/// Seconds per environment and step in lanes; the flight starts anew so that no environment is lost.
fn lane_time(plan: &BenchPlan, model: &Model, x: &[f64]) -> Result<f64> {
    let n = plan.n_env.min(1024);
    let mut world = World::of_model(model, PHYSICS, n)?;
    world.set_threads(Threads::new(1)?);
    let x: Vec<f32> = x.iter().map(|v| *v as f32).collect();
    for i in 0..n {
        world.set_state(i, &x)?;
    }
    let fresh = world.clone();
    let actions = vec![-0.2; n * world.n_action()];
    let mut outcome = Ok(());
    let mut least = f64::INFINITY;
    for _ in 0..8 {
        world.clone_from(&fresh);
        let time = seconds(plan.budget / 32, || {
            if outcome.is_ok() {
                outcome = world.step(black_box(&actions));
            }
        });
        least = least.min(time);
    }
    outcome?;
    Ok(least / n as f64)
}
