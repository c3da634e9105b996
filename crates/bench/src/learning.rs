//! Steps of environments with a policy in the loop, beside the figures of the OmniDrones paper for the same tasks, numbers of
//! environments and size of the network (Xu et al. 2024, table of simulation speed: three layers of 256 units, one RTX
//! 4090).
//!
//! The network has LeakyReLU between its layers and no layer norm. A figure is the best of many rounds.
//!
//! A step is observation, network, action, physics, reward, ends, resets. A frame is a step of one environment, whatever
//! its number of agents.

use super::{BenchPlan, BenchRow};
use omnidrones::error::Result;
use omnidrones::internals::{ROWS, Shard, shards};
use omnidrones::parallel::Threads;
use omnidrones::rl::nn::{Activation, Layers};
use omnidrones::rl::policy::Actor;
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::{Env, EnvConfig};
use std::time::{Duration, Instant};

/// Task, environments, and the paper's frames per second.
pub const PAPER: [(&str, usize, f64); 6] = [
    ("Track", 1024, 196e3),
    ("Track", 2048, 385e3),
    ("Track", 4096, 732e3),
    ("OverHover", 1024, 115e3),
    ("OverHover", 2048, 205e3),
    ("OverHover", 4096, 310e3),
];

/// Environments of a shard.
const SHARD: usize = 64;
/// Steps of a shard before the next one is taken up: what it needs stays in cache.
const STEPS: usize = 16;

struct Worker {
    shard: Shard,
    memory: omnidrones::rl::nn::Memory,
    action: Vec<f32>,
}

/// Measures every row of [`PAPER`] with hidden layers of these widths.
///
/// # Errors
/// As [`Layers::validate`], [`Env::make`] and [`Threads::new`].
pub fn run(plan: &BenchPlan, hidden: &[usize], tell: &mut dyn FnMut(&BenchRow)) -> Result<Vec<BenchRow>> {
    let threads = Threads::new(plan.threads)?;
    let layers = Layers { hidden: hidden.to_vec(), activation: Activation::LeakyRelu, ..Layers::default() };
    let mut rows = Vec::new();
    for (task, n_env, paper) in PAPER {
        let rate = frames_per_second(task, n_env, &layers, &threads, plan.budget)?;
        let row = BenchRow {
            group: task,
            name: format!("{n_env} environments"),
            value: 1e-3 * rate,
            unit: "k frames/s",
            ratio: Some(rate / paper),
            baseline: "the paper's RTX 4090",
        };
        tell(&row);
        rows.push(row);
    }
    Ok(rows)
}

fn frames_per_second(task: &str, n_env: usize, layers: &Layers, threads: &Threads, budget: Duration) -> Result<f64> {
    let config = EnvConfig { n_env, stagger: true, ..EnvConfig::default() };
    let shards = shards(&|config| Env::make(task, config), &config, SHARD)?;
    let actor = Actor::new(shards[0].env.spec(), layers, true)?;
    let mut parameters = actor.mlp.init(&mut Stream::new(1, 0, 0, Purpose::LEARNING));
    parameters.resize(actor.n_parameter(), 0.0);
    let worker = |shard: Shard| Worker {
        action: vec![0.0; shard.out.reward.len() * actor.n_action()],
        memory: actor.mlp.memory(ROWS),
        shard,
    };
    let mut workers: Vec<Worker> = shards.into_iter().map(worker).collect();
    let (mut best, begun) = (0.0_f64, Instant::now());
    while begun.elapsed() < 4 * budget {
        let round = Instant::now();
        threads.for_each(&mut workers, |_, worker| worker.fly(&actor, &parameters));
        best = best.max((n_env * STEPS) as f64 / round.elapsed().as_secs_f64());
    }
    Ok(best)
}

impl Worker {
    fn fly(&mut self, actor: &Actor, parameters: &[f32]) {
        let Shard { env, out } = &mut self.shard;
        let (n_in, n_out) = (actor.mlp.n_input(), actor.n_action());
        for _ in 0..STEPS {
            let rows = out.observation.chunks(ROWS * n_in).zip(self.action.chunks_mut(ROWS * n_out));
            rows.for_each(|(x, action)| actor.modes(parameters, x, &mut self.memory, action));
            // the arrays are the environment's own
            let _ = env.step(&self.action, &mut out.out());
        }
    }
}
