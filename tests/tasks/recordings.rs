//! Programs, adjoints and Jacobians of every task against a plain walk over what was recorded.

use crate::everywhere;
use num_dual::{Dual64, HyperDual64};
use omnidrones::autodiff::Recording;
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::{Buffers, Env};

/// Largest |a − b| over the largest of either; infinite where either is not a number.
fn relative(a: &[f64], b: &[f64]) -> f64 {
    let size = a.iter().chain(b).fold(1e-12_f64, |m, x| m.max(x.abs()));
    let error = a.iter().zip(b).map(|(x, y)| (x - y).abs());
    error.fold(0.0, |m: f64, e| if e.is_nan() { f64::INFINITY } else { m.max(e) }) / size
}

/// The arguments of a step some steps after a start.
fn arguments(env: &mut Env, stream: &mut Stream) -> Vec<f64> {
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let mut actions = vec![0.0; env.spec().n_env * env.spec().n_agent * env.spec().action.len()];
    for t in 0..7 {
        env.sample(t, &mut actions);
        actions.iter_mut().for_each(|a| *a *= 0.3);
        env.step(&actions, &mut out.out()).unwrap();
    }
    let action: Vec<f64> = (0..actions.len() / env.spec().n_env).map(|_| 0.3 * stream.normal()).collect();
    env.jacobian(0, &action).unwrap().arguments
}

fn walked(recording: &Recording, z: &[f64]) -> Vec<f64> {
    let mut y = vec![0.0; recording.n_output()];
    recording.evaluate(z, &mut y);
    y
}

/// J d by duals through the walk.
fn pushed(recording: &Recording, z: &[f64], d: &[f64]) -> Vec<f64> {
    let z: Vec<Dual64> = z.iter().zip(d).map(|(z, d)| Dual64::new(*z, *d)).collect();
    let mut y = vec![Dual64::from(0.0); recording.n_output()];
    recording.evaluate(&z, &mut y);
    y.into_iter().map(|y| y.eps).collect()
}

/// dᵀ ∂²yₖ/∂z² e of every result, through the walk and through the program.
fn bent(env: &Env, recording: &Recording, z: &[f64], d: &[f64], e: &[f64]) -> [Vec<f64>; 2] {
    let z: Vec<HyperDual64> =
        z.iter().zip(d.iter().zip(e)).map(|(z, (d, e))| HyperDual64::new(*z, *d, *e, 0.0)).collect();
    let mut y = vec![HyperDual64::from(0.0); recording.n_output()];
    recording.evaluate(&z, &mut y);
    let walk = y.iter().map(|y| y.eps1eps2).collect();
    env.program().unwrap().evaluate_over(&z, &mut y);
    [walk, y.iter().map(|y| y.eps1eps2).collect()]
}

#[test]
fn values_jacobians_and_adjoints_of_every_task_are_those_of_a_walk_over_its_recording() {
    everywhere(1, 400, |name, make, config| {
        let mut env = make(config);
        let mut stream = Stream::new(60, 0, 0, Purpose::user(60));
        let z = arguments(&mut env, &mut stream);
        let (recording, layout) = (env.recording().unwrap(), env.layout());
        let values = relative(&walked(&recording, &z), &env.evaluate(&z).unwrap());

        // by their own sizes: masses and inertias lie far below 0.1
        let n = layout.parameters.end;
        let size = |k: usize, z: f64| if k < layout.parameters.start { z.abs().max(0.1) } else { z.abs() };
        let mut direction = || -> Vec<f64> {
            z.iter().enumerate().map(|(k, z)| if k < n { stream.normal() * size(k, *z) } else { 0.0 }).collect()
        };
        let (d, e) = (direction(), direction());
        let exact = pushed(&recording, &z, &d);
        let jacobian = env.jacobian_at(&z).unwrap();
        let columns = nalgebra::DVector::from_column_slice(&d[..n]);
        let jacobians = relative(&exact, (&jacobian.matrix * columns).as_slice());

        // ⟨J d, s⟩ against ⟨d, Jᵀ s⟩
        let adjoint = env.adjoint(true).unwrap();
        let seeds: Vec<f64> = exact.iter().map(|_| stream.normal()).collect();
        let inputs: Vec<f64> = z.iter().chain(&seeds).copied().collect();
        let mut result = vec![0.0; n];
        adjoint.program().evaluate(&mut adjoint.program().workspace(), &inputs, &mut result);
        let terms: Vec<f64> = exact.iter().zip(&seeds).map(|(a, b)| a * b).collect();
        let pulled: f64 = result.iter().zip(&d).map(|(a, b)| a * b).sum();
        let sizes = terms.iter().map(|x| x.abs()).sum::<f64>();
        let adjoints = (terms.iter().sum::<f64>() - pulled).abs() / sizes;

        let [walk, program] = bent(&env, &recording, &z, &d, &e);
        let bends = relative(&walk, &program);
        println!("{name}: values {values:.1e}, Jacobian {jacobians:.1e}, adjoint {adjoints:.1e}, bends {bends:.1e}");
        assert!(values < 1e-13 && jacobians < 1e-11 && adjoints < 1e-11 && bends < 1e-9, "{name}");
    });
}

#[test]
fn a_step_done_phase_by_phase_is_the_step_of_the_environment() {
    // steps are in f32: some numbers stand far from zero, and some tasks answer steeply
    everywhere(2, 400, |name, make, config| {
        let mut env = make(config);
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        let mut actions = vec![0.0; 2 * env.spec().n_agent * env.spec().action.len()];
        let mut worst = 0.0_f64;
        for t in 0..5 {
            env.sample(t, &mut actions);
            actions.iter_mut().for_each(|a| *a *= 0.3);
            let own: Vec<f64> = actions[actions.len() / 2..].iter().map(|a| f64::from(*a)).collect();
            let inside = env.inside_step(1, &own, |step| {
                step.finish();
                let seen: Vec<f64> = (0..env.spec().n_agent).flat_map(|agent| step.observation(agent)).collect();
                (seen, step.reward(), step.is_terminated())
            });
            env.step(&actions, &mut out.out()).unwrap();
            let (seen, reward, terminated) = inside.unwrap();
            if terminated || out.terminated[1] == 1 {
                break;
            }
            // sensors read behind a step
            let of_task = |row: &[f64]| -> Vec<f64> {
                let (n, own) = (env.spec().n_observation, env.task_spec().observation.iter().map(|f| f.size).sum());
                row.chunks(n).flat_map(|row| row[..own].to_vec()).collect()
            };
            let shown: Vec<f64> = out.observation[seen.len()..].iter().map(|x| f64::from(*x)).collect();
            let paid = f64::from(out.reward[env.spec().n_agent]);
            worst = worst.max(relative(&of_task(&shown), &of_task(&seen))).max((paid - reward).abs());
        }
        println!("{name}: {worst:.1e}");
        assert!(worst < 1e-3, "{name}: {worst:e}"); // 2.5e-4 in DragonHover, 1e-6 in most
    });
}
