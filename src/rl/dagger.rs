//! DAgger: a policy that imitates a teacher on the states that it meets itself (Ross, Gordon and Bagnell 2011).
//!
//! Each update
//! 1. flies fresh episodes: a share β of the environments by the teacher, the others by the policy;
//! 2. asks the teacher for its action a* in every state that was met;
//! 3. goes over these rows `epochs` times in minibatches, and descends L = ½ ‖π(o) − a*‖², Huber's beyond 1.
//!
//! With β = 1 throughout this is behaviour cloning; with β falling to 0 the policy learns to mend its own mistakes.
//!
//! The teacher is our controller of the task ([`Baseline`](tasks::Baseline)), which sees the true state and masses, or the policy of
//! another run ([`DaggerConfig::teacher`]), which may see what the student does not: noise-free or privileged observations, where the
//! student has a history. It then flies in a twin of every environment, which takes the same actions and shows what the
//! teacher was trained to see (Chen et al. 2020; Lee et al. 2020).
//!
//! Rapid motor adaptation (`rma`; Kumar, Fu, Pathak and Malik 2021) imitates less: [`ImitationTarget::Latent`]. The teacher is the policy
//! that the run begins from, π(o, μ(θ)), whose last encoder μ reads the physical numbers θ. The student is π(o, φ(past)) with the same π,
//! which stays as it is; its last encoder φ reads what came before, flies itself, and descends ½ ‖φ(past) − μ(θ)‖².

mod config;
mod state;
mod student;
mod teacher;

pub use config::{DaggerConfig, ImitationTarget};

use super::critic::shuffle;
use super::learner::{Episodes, Update, share_done};
use super::minibatch::{Minibatch, Sums, minibatch};
use super::nn::Memory;
use super::policy::ROWS;
use super::policy_optimiser::PolicyOptimiser;
use super::shards::{Shard, episodes, normalise};
use super::window::mask_nonfinite;
use base::error::{Error, Result};
use base::parallel::Threads;
use rng::{Purpose, Stream};
use std::time::Instant;
use student::Student;
use teacher::Teacher;

/// DAgger, in the middle of a run.
pub struct Dagger {
    config: DaggerConfig,
    optimiser: PolicyOptimiser,
    student: Student,
    batch: Minibatch,
    workers: Vec<Worker>,
    /// Rows of an update, worker by worker: what was seen, what the teacher would give (NaN where there is nothing to learn).
    observation: Vec<f32>,
    label: Vec<f32>,
    order: Vec<u32>,
    threads: Threads,
    seed: u64,
    update: u64,
    env_steps: u64,
}

/// A shard with its teacher.
struct Worker {
    shard: Shard,
    teacher: Teacher,
    memory: Memory,
    seen: Vec<f32>,
    actions: Vec<f32>,
    taught: Vec<f32>,
    masked: Vec<usize>,
    reward: f64,
    episodes: Episodes,
    failed: Option<Error>,
}

impl Dagger {
    /// One update: the three steps of the header.
    fn update(&mut self) -> Result<Update> {
        let begun = Instant::now();
        let progress = share_done(self.update, self.config.updates);
        let teacher_share = self.config.teacher_share.at(progress).clamp(0.0, 1.0);
        self.collect(teacher_share)?;
        let flying = begun.elapsed();
        let rate = self.config.learning_rate.at(progress);
        let [loss, gradient_norm] = self.imitate(rate);
        if self.config.imitate == ImitationTarget::Action {
            // what was taken over knows its observations on the teacher's scale
            normalise(&mut self.workers.iter_mut().map(|worker| &mut worker.shard).collect::<Vec<_>>())?;
        }
        let n_step = (self.config.n_env * self.config.steps) as u64;
        (self.update, self.env_steps) = (self.update + 1, self.env_steps + n_step);
        let (mut episodes, mut reward) = (Episodes::default(), 0.0);
        for worker in &self.workers {
            episodes.add(&worker.episodes);
            reward += worker.reward / n_step as f64;
        }
        let extra = vec![("teacher_share", teacher_share)];
        let phases = vec![("fly", flying), ("learn", begun.elapsed() - flying)];
        Ok(Update { loss, reward, episodes, gradient_norm, rate, extra, phases })
    }

    /// Steps 1 and 2: fresh episodes of all shards, and what the teacher would do in every state.
    fn collect(&mut self, teacher_share: f64) -> Result<()> {
        let (optimiser, student, steps) = (&self.optimiser, &self.student, self.config.steps);
        let (mut observation, mut label) = (&mut self.observation[..], &mut self.label[..]);
        let mut shards = Vec::with_capacity(self.workers.len());
        for worker in &mut self.workers {
            let spec = worker.shard.env.spec();
            let rows = spec.n_env * spec.n_agent * steps;
            let (seen, behind) = observation.split_at_mut(rows * student.columns.len());
            let (taught, rest) = label.split_at_mut(rows * student.network.n_output());
            shards.push((worker, seen, taught));
            (observation, label) = (behind, rest);
        }
        self.threads.for_each(&mut shards, |_, (worker, seen, taught)| {
            worker.failed = worker.collect(optimiser, student, teacher_share, seen, taught).err();
        });
        self.workers.iter_mut().find_map(|worker| worker.failed.take()).map_or(Ok(()), Err)
    }

    /// Step 3: epochs × minibatches; gives the mean loss and the mean norm of its gradients.
    fn imitate(&mut self, rate: f64) -> [f64; 2] {
        let rows = self.label.len() / self.student.network.n_output();
        let (mut sums, mut norms, mut steps) = ([0.0; 2], 0.0, 0.0);
        for epoch in 0..self.config.epochs as u64 {
            shuffle(&mut self.order, rows, &mut Stream::new(self.seed, self.update, 2 + epoch, Purpose::LEARNING));
            for k in 0..self.config.minibatches {
                let of_step = self.gradient(k);
                norms += self.optimiser.descend(self.config.max_grad_norm, rate);
                sums.iter_mut().zip(of_step).for_each(|(sum, x)| *sum += x);
                steps += 1.0;
            }
        }
        [sums[0] / f64::max(sums[1], 1.0), norms / steps]
    }

    /// ∂L/∂θ over minibatch `k`, into the optimiser: of Huber's loss of π(o) − a*. Gives the sum of the loss and of its rows.
    fn gradient(&mut self, k: usize) -> [f64; 2] {
        let Self { student, optimiser, label, observation, .. } = self;
        let (n, chosen) = (student.network.n_output(), minibatch(&self.order, k, self.config.minibatches));
        let share = 1.0 / chosen.len().max(1) as f32;
        let loss = |row: usize, given: &[f32], grad_output: &mut [f32], _: &mut [f32], sums: &mut Sums| {
            let taught = &label[row * n..][..n];
            if taught.iter().any(|a| !a.is_finite()) {
                return;
            }
            for ((grad, a), wanted) in grad_output.iter_mut().zip(given).zip(taught) {
                let error = a - wanted;
                let bounded = error.clamp(-1.0, 1.0);
                *grad = share * bounded;
                sums[0] += f64::from(bounded * (error - 0.5 * bounded));
            }
            sums[1] += 1.0;
        };
        let net = student.weights(&optimiser.actor, optimiser.net());
        let sums = self.batch.gradient(&self.threads, &student.network, net, observation, chosen, &loss);
        optimiser.gradient[student.place.clone()].copy_from_slice(&self.batch.gradient);
        [sums[0], sums[1]]
    }
}

impl Worker {
    /// Flies fresh episodes, the share `by_teacher` of all environments by the teacher, and keeps what was seen and what it
    /// would give.
    fn collect(
        &mut self,
        optimiser: &PolicyOptimiser,
        student: &Student,
        by_teacher: f64,
        observation: &mut [f32],
        label: &mut [f32],
    ) -> Result<()> {
        let Self { shard: Shard { env, out }, teacher, memory, seen, actions, taught, masked, .. } = self;
        let (n_env, n_agent, n_seen) = (env.spec().n_env, env.spec().n_agent, env.spec().n_observation);
        let (rows, n_action) = (n_env * n_agent, actions.len() / (n_env * n_agent));
        let (n_read, n_label) = (student.columns.len(), student.network.n_output());
        let first = env.spec().config.first_environment;
        // spread evenly over all shards
        let taught_one = |i: usize| (first.wrapping_add(i as u64) as f64 * GOLDEN_RATIO).fract() < by_teacher;
        let acts = !teacher.teaches_latent() || (0..n_env).any(taught_one);
        (self.reward, self.episodes) = (0.0, Episodes::default());
        env.reset(None, None, &mut out.out())?;
        teacher.reset(env)?;
        for (read, label) in observation.chunks_exact_mut(rows * n_read).zip(label.chunks_exact_mut(rows * n_label)) {
            seen.copy_from_slice(&out.observation);
            mask_nonfinite(seen, rows, masked);
            if acts {
                teacher.act(env, taught)?;
            }
            teacher.label(taught, label);
            masked.iter().for_each(|row| label[row * n_label..][..n_label].fill(f32::NAN));
            for (to, row) in read.chunks_exact_mut(n_read).zip(seen.chunks_exact(n_seen)) {
                to.copy_from_slice(&row[student.columns.clone()]);
            }
            for (x, actions) in seen.chunks(ROWS * n_seen).zip(actions.chunks_mut(ROWS * n_action)) {
                optimiser.actor.modes(optimiser.net().parameters, x, memory, actions);
            }
            for i in (0..n_env).filter(|i| taught_one(*i)) {
                let place = i * n_agent * n_action..(i + 1) * n_agent * n_action;
                actions[place.clone()].copy_from_slice(&taught[place]);
            }
            env.step(actions, &mut out.out())?;
            let ended = (0..n_env).map(|i| out.terminated[i] | out.truncated[i] == 1);
            teacher.follow(actions, ended)?;
            let finite = out.reward.iter().filter(|x| x.is_finite());
            self.reward += finite.map(|x| f64::from(*x)).sum::<f64>() / n_agent as f64;
            self.episodes.add(&episodes(env.spec(), out)?);
        }
        Ok(())
    }
}

/// Its multiples lie evenly between whole numbers.
const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_9;
