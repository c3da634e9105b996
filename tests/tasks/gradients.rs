//! Gradients of steps: against duals, against differences, through episodes.

use crate::contract::transformed;
use crate::{config, everywhere};
use omnidrones::parallel::Threads;
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::{Autoreset, Buffers, Cotangents, Env, EnvConfig, SweepOptions};

/// Steps with mild random actions, so that states are off their start.
fn warm_up(env: &mut Env, out: &mut Buffers, steps: usize) -> Vec<f32> {
    env.reset(None, None, &mut out.out()).unwrap();
    let mut actions = vec![0.0; env.spec().n_env * env.spec().n_agent * env.spec().action.len()];
    for t in 0..steps {
        env.sample(t as u64, &mut actions);
        actions.iter_mut().for_each(|a| *a *= 0.3);
        env.step(&actions, &mut out.out()).unwrap();
    }
    actions
}

/// Largest |a − b| over the largest of either.
fn relative(a: &[f64], b: &[f64]) -> f64 {
    let size = a.iter().chain(b).fold(1e-12_f64, |m, x| m.max(x.abs()));
    a.iter().zip(b).fold(0.0, |m: f64, (x, y)| m.max((x - y).abs())) / size
}

/// Jᵀ y of the program and of duals in three states; and J against central differences along random directions.
fn certify(name: &str, env: &mut Env) -> (f64, f64) {
    let mut out = Buffers::new(env.spec());
    let actions = warm_up(env, &mut out, 7);
    let adjoint = env.adjoint(true).unwrap();
    let mut workspace = adjoint.program().workspace();
    let n = actions.len() / env.spec().n_env;
    let mut stream = Stream::new(31, 0, 0, Purpose::user(31));
    let (mut of_duals, mut of_differences) = (0.0_f64, 0.0_f64);
    for i in 0..env.spec().n_env {
        let action: Vec<f64> = actions[i * n..(i + 1) * n].iter().map(|a| f64::from(*a)).collect();
        let jacobian = env.jacobian(i, &action).unwrap();
        let (rows, columns) = jacobian.matrix.shape();
        let seeds: Vec<f64> = (0..rows).map(|_| stream.normal()).collect();
        let mut result = vec![0.0; columns];
        let inputs: Vec<f64> = jacobian.arguments.iter().chain(&seeds).copied().collect();
        adjoint.program().evaluate(&mut workspace, &inputs, &mut result);
        let wanted = jacobian.matrix.tr_mul(&nalgebra::DVector::from_vec(seeds));
        of_duals = of_duals.max(relative(&result, wanted.as_slice()));
        // physical numbers go by their own size: masses and inertias lie far below 0.1
        let physical = columns - env.spec().privileged.len();
        let scaled: Vec<f64> = (jacobian.arguments.iter().enumerate())
            .map(|(k, z)| stream.normal() * if k < physical { z.abs().max(0.1) } else { z.abs() })
            .collect();
        let at = |h: f64| {
            let mut z = jacobian.arguments.clone();
            z.iter_mut().zip(&scaled).for_each(|(z, d)| *z += h * d);
            env.evaluate(&z).unwrap()
        };
        let exact = &jacobian.matrix * nalgebra::DVector::from_column_slice(&scaled);
        let h = 1e-6;
        let differences: Vec<f64> = at(h).iter().zip(at(-h)).map(|(a, b)| (a - b) / (2.0 * h)).collect();
        of_differences = of_differences.max(relative(&differences, exact.as_slice()));
    }
    println!("{name}: {of_duals:.1e} against duals, {of_differences:.1e} against differences");
    (of_duals, of_differences)
}

#[test]
fn the_adjoint_of_every_task_is_that_of_duals_and_differences() {
    everywhere(3, 400, |name, make, config| {
        let (duals, differences) = certify(name, &mut make(config));
        assert!(duals <= 1e-10, "{name}: {duals:e}");
        assert!(differences <= 1e-5, "{name}: {differences:e}");
    });
}

#[test]
fn gradients_go_through_delays_transforms_and_physical_numbers() {
    let config = EnvConfig { n_env: 3, ..transformed(&config(3, 400)) };
    let (duals, differences) = certify("transformed", &mut Env::make("Hover", &config).unwrap());
    assert!(duals <= 1e-10 && differences <= 1e-5, "{duals:e} {differences:e}");
}

#[test]
fn a_step_in_lanes_is_the_step_that_gradients_are_taken_of() {
    everywhere(5, 400, |name, make, config| {
        let mut env = make(config);
        let mut out = Buffers::new(env.spec());
        let actions = warm_up(&mut env, &mut out, 7);
        let n = actions.len() / 5;
        let before: Vec<Vec<f64>> = (0..5)
            .map(|i| {
                let own: Vec<f64> = actions[i * n..(i + 1) * n].iter().map(|a| f64::from(*a)).collect();
                env.jacobian(i, &own).unwrap().value
            })
            .collect();
        env.step(&actions, &mut out.out()).unwrap();
        let spec = env.spec();
        let (row, n_state) = (spec.n_agent * spec.n_observation, env.state(0).unwrap().len());
        let ended = |i: usize| out.terminated[i] == 1;
        for (i, value) in before.iter().enumerate().filter(|(i, _)| !ended(*i)) {
            let state: Vec<f64> = env.state(i).unwrap().iter().map(|x| f64::from(*x)).collect();
            let worst = relative(&state, &value[..n_state]);
            let seen: Vec<f64> = out.observation[i * row..(i + 1) * row].iter().map(|x| f64::from(*x)).collect();
            let shown = &value[value.len() - 2 - row..value.len() - 2];
            let reward = f64::from(out.reward[i * spec.n_agent]);
            let off = (reward - value[value.len() - 2]).abs();
            assert!(
                worst < 1e-5 && relative(&seen, shown) < 1e-4 && off < 1e-3,
                "{name}: state {worst:e}, observation {:e}, reward off by {off:e}",
                relative(&seen, shown)
            );
        }
    });
}

/// Recorded steps with mild actions, and the actions.
fn record(env: &mut Env, steps: usize) -> (omnidrones::tasks::Tape, Vec<Vec<f32>>, Vec<Buffers>) {
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let mut tape = env.tape(steps);
    let n = env.spec().n_env * env.spec().n_agent * env.spec().action.len();
    let (mut all, mut outs) = (Vec::new(), Vec::new());
    for t in 0..steps {
        let mut actions = vec![0.0; n];
        env.sample(t as u64, &mut actions);
        actions.iter_mut().for_each(|a| *a = 0.2 * *a - 0.3);
        env.step_recorded(&actions, &mut out.out(), &mut tape).unwrap();
        all.push(actions);
        outs.push(out.clone());
    }
    (tape, all, outs)
}

/// Gradient of the sum of all rewards with respect to the actions.
fn return_gradient(
    env: &Env,
    tape: &omnidrones::tasks::Tape,
    options: SweepOptions,
) -> (Vec<Vec<f32>>, Vec<f32>, usize) {
    let adjoint = env.adjoint(false).unwrap();
    let mut sweep = adjoint.sweep(options);
    let ones = vec![1.0; env.spec().n_env];
    let n = env.spec().n_env * env.spec().n_agent * env.spec().action.len();
    let mut all = vec![vec![0.0; n]; tape.len()];
    for t in (0..tape.len()).rev() {
        let up = Cotangents { reward: &ones, ..Cotangents::default() };
        sweep.pull(tape, t, &up, &mut all[t]).unwrap();
    }
    (all, sweep.carried(), sweep.dropped())
}

#[test]
fn a_sweep_through_twenty_steps_is_the_difference_of_two_episodes() {
    let mut worst = 0.0_f64;
    for task in ["Hover", "Track"] {
        let config = EnvConfig { n_env: 3, autoreset: Autoreset::Disabled, ..config(3, 400) };
        let mut env = Env::make(task, &config).unwrap();
        let (tape, actions, outs) = record(&mut env, 20);
        assert!(outs.iter().all(|o| o.terminated.iter().all(|t| *t == 0)));
        let (gradient, ..) = return_gradient(&env, &tape, SweepOptions::default());
        // in f64, from the state at the start, with one action changed
        let mut start = Env::make(task, &config).unwrap();
        let mut out = Buffers::new(start.spec());
        start.reset(None, None, &mut out.out()).unwrap();
        let of = |i: usize, t: usize, k: usize, h: f64| {
            let own = |s: usize| -> Vec<f64> {
                let row = &actions[s][i * 4..(i + 1) * 4];
                row.iter().enumerate().map(|(j, a)| f64::from(*a) + if (s, j) == (t, k) { h } else { 0.0 }).collect()
            };
            let mut z = start.jacobian(i, &own(0)).unwrap().arguments;
            let (n, mut total) = (start.state(i).unwrap().len(), 0.0);
            for s in 0..20 {
                z[n..n + 4].copy_from_slice(&own(s));
                let y = start.evaluate(&z).unwrap();
                total += y[y.len() - 2];
                z[..n].copy_from_slice(&y[..n]);
                z[n + 4] += 1.0; // the step count
            }
            total
        };
        for (i, t, k) in [(0, 0, 0), (1, 7, 2), (2, 19, 1), (2, 3, 3)] {
            let difference = (of(i, t, k, 1e-5) - of(i, t, k, -1e-5)) / 2e-5;
            let pulled = f64::from(gradient[t][i * 4 + k]);
            worst = worst.max((difference - pulled).abs() / difference.abs().max(0.01));
        }
    }
    println!("sweep against differences {worst:.1e}");
    assert!(worst < 2e-3, "{worst:e}");
}

#[test]
fn no_gradient_crosses_a_restart() {
    let base = EnvConfig { n_env: 70, ..config(70, 10) };
    let mut env = Env::make("Hover", &base).unwrap();
    let (tape, _, outs) = record(&mut env, 15);
    // everyone is cut at step 10: later rewards do not move earlier actions
    let adjoint = env.adjoint(false).unwrap();
    let mut sweep = adjoint.sweep(SweepOptions::default());
    let ones = vec![1.0; 70];
    let mut action = vec![0.0; 280];
    let survivors: Vec<usize> = (0..70).filter(|i| outs[..9].iter().all(|o| o.terminated[*i] == 0)).collect();
    assert!(survivors.len() > 40);
    for t in (0..15).rev() {
        let up = Cotangents { reward: if t >= 10 { &ones } else { &[] }, ..Cotangents::default() };
        sweep.pull(&tape, t, &up, &mut action).unwrap();
        for i in &survivors {
            let size = action[i * 4..i * 4 + 4].iter().fold(0.0_f32, |m, a| m.max(a.abs()));
            assert_eq!(size > 0.0, t >= 10, "environment {i}, step {t}: {size}");
        }
    }
}

#[test]
fn the_value_of_a_final_observation_reaches_the_last_action() {
    let mut env = Env::make("Hover", &config(64, 10)).unwrap();
    let (tape, ..) = record(&mut env, 10);
    let adjoint = env.adjoint(false).unwrap();
    let ones = vec![1.0; 64 * env.spec().n_observation];
    for (up, reaches) in [
        (Cotangents { final_observation: &ones, ..Cotangents::default() }, true),
        (Cotangents { observation: &ones, ..Cotangents::default() }, false),
    ] {
        let mut action = vec![0.0; 256];
        adjoint.sweep(SweepOptions::default()).pull(&tape, 9, &up, &mut action).unwrap();
        assert_eq!(action.iter().any(|a| *a != 0.0), reaches);
    }
}

#[test]
fn decay_and_clipping_act_on_what_is_carried() {
    let mut env = Env::make("Hover", &config(64, 400)).unwrap();
    let (tape, ..) = record(&mut env, 12);
    let (exact, carried, dropped) = return_gradient(&env, &tape, SweepOptions::default());
    let (decayed, ..) = return_gradient(&env, &tape, SweepOptions { decay: 0.5, ..SweepOptions::default() });
    let (_, clipped, _) = return_gradient(&env, &tape, SweepOptions { clip: 0.1, ..SweepOptions::default() });
    assert_eq!((exact[11].clone(), dropped), (decayed[11].clone(), 0));
    assert!(exact[0] != decayed[0]);
    let n = carried.len() / 64;
    let norm = |row: &[f32]| row.iter().map(|x| x * x).sum::<f32>().sqrt();
    assert!(carried.chunks(n).any(|row| norm(row) > 0.2));
    assert!(clipped.chunks(n).all(|row| norm(row) < 0.1001));
}

#[test]
fn a_poisoned_environment_has_gradient_zero_and_changes_no_other() {
    let run = |poison: bool| {
        let base = EnvConfig { autoreset: Autoreset::Disabled, ..config(70, 400) };
        let mut env = Env::make("Hover", &base).unwrap();
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        if poison {
            let mut state = env.state(5).unwrap();
            state[3] = 1e30;
            env.set_state(5, &state).unwrap();
        }
        let mut tape = env.tape(4);
        for _ in 0..4 {
            env.step_recorded(&[-0.4; 280], &mut out.out(), &mut tape).unwrap();
        }
        return_gradient(&env, &tape, SweepOptions::default())
    };
    let (clean, poisoned) = (run(false), run(true));
    for (a, b) in clean.0.iter().zip(&poisoned.0) {
        let others = |x: &[f32]| [&x[..20], &x[24..]].concat();
        assert_eq!(others(a), others(b));
        assert_eq!(b[20..24], [0.0; 4]);
    }
}

#[test]
fn a_gradient_that_is_not_a_number_becomes_zero_and_is_counted() {
    let mut env = Env::make("Hover", &config(70, 400)).unwrap();
    let (tape, ..) = record(&mut env, 3);
    let adjoint = env.adjoint(false).unwrap();
    let pull = |rewards: &[f32]| {
        let (mut sweep, mut action) = (adjoint.sweep(SweepOptions::default()), vec![0.0; 280]);
        let up = Cotangents { reward: rewards, ..Cotangents::default() };
        sweep.pull(&tape, 2, &up, &mut action).unwrap();
        (action, sweep.dropped())
    };
    let mut rewards = vec![1.0; 70];
    let (clean, none) = pull(&rewards);
    rewards[66] = f32::NAN;
    let (poisoned, dropped) = pull(&rewards);
    assert_eq!((none, dropped), (0, 1));
    assert_eq!(poisoned[264..268], [0.0; 4]);
    assert_eq!([&clean[..264], &clean[268..]], [&poisoned[..264], &poisoned[268..]]);
}

#[test]
fn the_number_of_threads_changes_no_bit_of_a_gradient() {
    let results: Vec<_> = [1, 2, 8]
        .into_iter()
        .map(|threads| {
            let mut env = Env::make("Hover", &config(300, 30)).unwrap();
            env.set_threads(Threads::new(threads).unwrap());
            let (tape, ..) = record(&mut env, 40);
            return_gradient(&env, &tape, SweepOptions::default())
        })
        .collect();
    assert!(results[0] == results[1] && results[1] == results[2]);
}
