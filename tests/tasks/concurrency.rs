//! Batches and a learner side by side in one process, on threads that they share.

use crate::{config, count};
use omnidrones::autodiff::{Scalar, Trace, TraceMask};
use omnidrones::parallel::Threads;
use omnidrones::rl::Learner;
use omnidrones::rl::apg::{Apg, ApgConfig};
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::{Buffers, Ends, Env, EnvConfig, HostStart, Robot, Start, Task, View, Writer};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// Three blocks, so that threads share a step.
const N_ENV: usize = 130;
/// What a round may take.
const LIMIT: Duration = Duration::from_secs(60);

/// A task whose goal jumps into a panic, on whichever thread steps it.
struct Faulty(Robot);

impl HostStart for Faulty {
    fn start(&self, start: &mut Start<'_, f64>) {
        start.place(0, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]);
        start.event_at = 2.0;
    }
    fn event(&self, _: &mut Start<'_, f64>) {
        resume_unwind(Box::new("a goal that cannot jump"));
    }
}

impl Task for Faulty {
    fn robot(&self) -> &Robot {
        &self.0
    }
    fn horizon(&self) -> usize {
        40
    }
    fn start(&self, _: &mut Start<'_>) {}
    fn start_on_host(&self) -> Option<&dyn HostStart> {
        Some(self)
    }
    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("height", "m", "p_z").number(view.drone(0).position[2]);
    }
    fn reward(&self, _: &View, terms: &mut Writer) {
        terms.term("alive", "1", 1.0).number(Trace::one());
    }
    fn ends(&self, _: &View, _: &mut Ends) {}
    fn success(&self, _: &View) -> TraceMask {
        Trace::one().lt(Trace::zero())
    }
    fn ideal(&self, start: &mut Start<'_>) {
        start.place(0, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]);
    }
}

fn faulty(threads: &Threads) -> Env {
    let config = config(N_ENV, 40);
    let mut env = Env::of(Faulty(config.single_robot("hummingbird").unwrap()), "faulty", &config).unwrap();
    env.set_threads(threads.clone());
    env
}

fn batch(threads: &Threads, task: &str) -> Env {
    let mut env = Env::make(task, &config(N_ENV, 40)).unwrap();
    env.set_threads(threads.clone());
    env
}

/// Bits of what is seen and paid in three steps.
fn fly(env: &mut Env) -> Vec<u32> {
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let mut actions = vec![0.0; N_ENV * env.spec().action.len()];
    let mut told = Vec::new();
    for t in 0..3 {
        env.sample(t, &mut actions);
        env.step(&actions, &mut out.out()).unwrap();
        told.extend(out.observation.iter().chain(&out.reward).map(|x| x.to_bits()));
    }
    told
}

fn learner(threads: &Threads) -> Apg {
    let config = ApgConfig { n_env: 8, shard: 4, horizon: 2, ..ApgConfig::default() };
    Apg::new("Hover", &EnvConfig::default(), config, 1, threads.clone()).unwrap()
}

/// Bits of the weights behind three updates.
fn learn(learner: &mut Apg) -> Vec<u32> {
    (0..3).for_each(|_| drop(learner.update().unwrap()));
    learner.policy().unwrap().parameters().iter().map(|x| x.to_bits()).collect()
}

/// All at once, in every tenth round beside a task that panics; then dropped in an order that the round draws.
fn round(k: u64, alone: &[Vec<u32>; 3]) {
    let threads = Threads::new(2).unwrap();
    let (mut one, mut other) = (batch(&threads, "Hover"), batch(&threads, "Track"));
    let mut learner = learner(&threads);
    let mut faulty = k.is_multiple_of(10).then(|| faulty(&threads));
    let together = std::thread::scope(|scope| {
        let (one, other) = (scope.spawn(|| fly(&mut one)), scope.spawn(|| fly(&mut other)));
        let learnt = scope.spawn(|| learn(&mut learner));
        if let Some(env) = &mut faulty {
            assert!(catch_unwind(AssertUnwindSafe(|| fly(env))).is_err(), "round {k}: nothing panicked");
        }
        [one, other, learnt].map(|thread| thread.join().unwrap())
    });
    assert!(together == *alone, "round {k}: other bits than alone");
    let mut held: Vec<Box<dyn Any>> =
        vec![Box::new(threads), Box::new(one), Box::new(other), Box::new(learner), Box::new(faulty)];
    let mut stream = Stream::new(83, k, 0, Purpose::user(83));
    while !held.is_empty() {
        drop(held.swap_remove(stream.below(held.len() as u64) as usize));
    }
}

fn rounds(n: u64) {
    let (told, done) = channel();
    let work = std::thread::spawn(move || {
        let one = Threads::new(1).unwrap();
        let alone = [fly(&mut batch(&one, "Hover")), fly(&mut batch(&one, "Track")), learn(&mut learner(&one))];
        for k in 0..n {
            round(k, &alone);
            told.send(()).unwrap();
        }
    });
    for k in 0..n {
        match done.recv_timeout(LIMIT) {
            Ok(()) => {}
            Err(RecvTimeoutError::Timeout) => panic!("round {k}: no answer within {LIMIT:?}"),
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    work.join().unwrap_or_else(|panic| resume_unwind(panic));
}

#[test]
fn batches_and_a_learner_on_shared_threads_neither_wait_for_each_other_nor_change_a_bit_whoever_panics() {
    rounds(200);
}

#[test]
#[ignore = "ROUNDS=10000 cargo test --release --test tasks concurrency -- --ignored --nocapture: a minute"]
fn ten_thousand_rounds_of_batches_and_a_learner_on_shared_threads_come_to_an_end() {
    rounds(count("ROUNDS", 10_000));
}
