//! A process made by `fork` steps as its parent does: threads are not inherited, batches are.
#![cfg(unix)]

use fork::{Fork, fork, waitpid};
use omnidrones::parallel::Threads;
use omnidrones::tasks::{Buffers, Env, EnvConfig};
use std::time::Duration;

const N_ENV: usize = 4096;
/// What a child may take for all its steps.
const LIMIT: Duration = Duration::from_secs(5);

fn batch(threads: &Threads) -> (Env, Buffers) {
    let mut env = Env::make("Hover", &EnvConfig { n_env: N_ENV, ..EnvConfig::default() }).unwrap();
    env.set_threads(threads.clone());
    let mut buffers = Buffers::new(env.spec());
    env.reset(None, None, &mut buffers.out()).unwrap();
    (env, buffers)
}

/// Observations and rewards behind a step with the random actions of this draw.
fn step((env, buffers): &mut (Env, Buffers), draw: u64) -> Vec<u32> {
    let mut actions = vec![0.0; N_ENV * env.spec().action.len()];
    env.sample(draw, &mut actions);
    env.step(&actions, &mut buffers.out()).unwrap();
    buffers.observation.iter().chain(&buffers.reward).map(|x| x.to_bits()).collect()
}

/// How a child that runs `work` ends: 0 if it holds, 1 if not, 2 if it panics, 3 if it takes too long, 128 and the signal that
/// killed it.
fn in_a_child(work: impl FnOnce() -> bool) -> i32 {
    match fork().expect("fork") {
        Fork::Parent(child) => {
            let status = waitpid(child).expect("waitpid");
            let (signal, code) = (status & 0x7f, (status >> 8) & 0xff);
            if signal == 0 { code } else { 128 + signal }
        }
        Fork::Child => {
            std::thread::spawn(|| {
                std::thread::sleep(LIMIT);
                std::process::exit(3);
            });
            let held = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
            std::process::exit(held.map_or(2, |held| i32::from(!held)))
        }
    }
}

#[test]
fn a_forked_child_steps_its_own_batch_and_an_inherited_one_to_the_same_bits() {
    for threads in [Threads::default(), Threads::new(2).unwrap()] {
        let [mut inherited, mut witness] = [(); 2].map(|()| batch(&threads));
        let first = step(&mut inherited, 0);
        assert_eq!(first, step(&mut witness, 0));
        let second = step(&mut witness, 1);
        let status = in_a_child(|| {
            let goes_on = step(&mut inherited, 1) == second;
            // by a child of the child as well
            let grandchild = in_a_child(|| step(&mut batch(&threads), 0) == first);
            let mut own = batch(&threads);
            goes_on && grandchild == 0 && step(&mut own, 0) == first && step(&mut own, 1) == second
        });
        assert_eq!(status, 0, "{threads:?}: 1 is other bits, 2 a panic, 3 no answer within {LIMIT:?}, more a signal");
        assert_eq!(step(&mut inherited, 1), second, "the parent goes on");
    }
}

#[test]
fn a_child_that_a_signal_kills_does_not_count_as_one_that_holds() {
    const SIGABRT: i32 = 6;
    assert_eq!(in_a_child(|| std::process::abort()), 128 + SIGABRT);
    assert_eq!([in_a_child(|| true), in_a_child(|| false)], [0, 1]);
}
