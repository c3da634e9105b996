//! DAgger: a policy that imitates a teacher on the states that it meets itself (Ross, Gordon and Bagnell 2011).
//!
//! Each update
//! 1. flies fresh episodes: a share β of the environments by the teacher, the others by the policy;
//! 2. asks the teacher for its action a* in every state that was met;
//! 3. goes over these rows `epochs` times in minibatches, and descends L = ½ ‖π(o) − a*‖², Huber's beyond 1.
//!
//! With β = 1 throughout this is behaviour cloning; with β falling to 0 the policy learns to mend its own mistakes.
//!
//! The teacher is our controller of the task ([`Baseline`](tasks::Baseline)), which sees the true state and masses, or the policy of another run
//! ([`DaggerConfig::teacher`]), which may see what the student does not: noise-free or privileged observations, where the
//! student has a history. It then flies in a twin of every environment, which takes the same actions and shows what the
//! teacher was trained to see (Chen et al. 2020; Lee et al. 2020).
//!
//! Rapid motor adaptation (`rma`; Kumar, Fu, Pathak and Malik 2021) imitates less: [`Imitate::Latent`]. The teacher is the policy that
//! the run begins from, π(o, μ(θ)), whose last encoder μ reads the physical numbers θ. The student is π(o, φ(past)) with the same π,
//! which stays as it is; its last encoder φ reads what came before, flies itself, and descends ½ ‖φ(past) − μ(θ)‖².

mod learnt;
mod teacher;

use super::checkpoint::Tensors;
use super::checks::{check_counts, check_positive};
use super::critic::shuffle;
use super::learner::built_in;
use super::learner::{Episodes, Learner, Make, Progress, Update, share_done};
use super::minibatch::{Minibatch, Sums, part};
use super::nn::{AdamConfig, Layers, Memory};
use super::policy::{Actor, Policy, ROWS};
use super::policy_optimiser::PolicyOptimiser;
use super::schedule::Schedule;
use super::shards::{Shard, begin_statistics, episodes, normalise, set_difficulty, shards_if, within_memory};
use super::state;
use super::warm_start::WarmStart;
use super::window::mask_nonfinite;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use base::parallel::Threads;
use learnt::Learnt;
use rng::{Purpose, Stream};
use serde::{Deserialize, Serialize};
use std::time::Instant;
use tasks::{EnvConfig, Spec};
use teacher::Teacher;

/// What of a teacher is imitated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Imitate {
    /// Its actions, by the whole policy.
    #[default]
    Action,
    /// What its last encoder gives, by the policy's last encoder; all else is taken over from it and stays.
    Latent,
}

with_defaults! {
    /// Settings; defaults clone a cascade within a minute.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct DaggerConfig {
        /// Environments, E.
        pub n_env: usize = 64,
        /// Environments of a shard: one thread steps it for a whole update.
        pub shard: usize = 32,
        /// Steps of an update, from fresh starts on.
        pub steps: usize = 250,
        /// Updates of a run.
        pub updates: u64 = 100,
        /// `action`, or `latent` of the policy that the run begins from.
        pub imitate: Imitate = Imitate::Action,
        /// Folder of the run whose policy teaches actions; empty for our controller of the task.
        pub teacher: String = String::new(),
        /// β, share of the environments that the teacher flies, over the run.
        pub teacher_share: Schedule = Schedule::Linear { from: 1.0, to: 0.0, warm_up: 0.0 },
        /// Passes over an update's rows.
        pub epochs: usize = 4,
        /// Minibatches of a pass.
        pub minibatches: usize = 16,
        /// Learning rate over the run.
        pub learning_rate: Schedule = Schedule::cosine(2e-3, 2e-5),
        /// Largest norm of the gradient.
        pub max_grad_norm: f64 = 1.0,
        /// The optimiser.
        pub adam: AdamConfig = AdamConfig::default(),
        /// The policy.
        pub network: Layers = Layers::default(),
    }
}

impl DaggerConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        check_counts(
            &[
                ("n_env", self.n_env, 1 << 24),
                ("shard", self.shard, 1 << 24),
                ("steps", self.steps, 1 << 16),
                ("epochs", self.epochs, 1 << 10),
                ("minibatches", self.minibatches, 1 << 16),
            ],
            "64, 32, 250, 4 and 16 are usual.",
        )?;
        check_positive(&[("max_grad_norm", self.max_grad_norm)], "1 is usual.")?;
        if self.imitate == Imitate::Latent && !self.teacher.is_empty() {
            let remedy = "Name the run in `from`: its weights are taken over too.";
            return Err(Error::value(
                "teacher",
                format!("'{}'", self.teacher),
                "left out where a latent is imitated",
                remedy,
            ));
        }
        if self.imitate == Imitate::Latent && self.adam.weight_decay > 0.0 {
            let remedy = "Leave it out: what is taken over from the teacher stays as it is.";
            return Err(Error::value(
                "adam.weight_decay",
                self.adam.weight_decay,
                "0 where a latent is imitated",
                remedy,
            ));
        }
        self.teacher_share.validate("teacher_share")?;
        self.learning_rate.validate("learning_rate")?;
        self.adam.validate()?;
        self.network.validate()
    }
}

built_in! {
    "dagger": DaggerConfig => Dagger, squashed: true, loss: "half the squared error of what is imitated", in: "dagger.rs";

    fn is_taught(&self) -> bool {
        self.imitate == Imitate::Latent
    }

    /// Updates are few and long.
    fn evaluate_every(&self) -> u64 {
        20
    }
}

/// DAgger, in the middle of a run.
pub struct Dagger {
    config: DaggerConfig,
    optimiser: PolicyOptimiser,
    learnt: Learnt,
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
    own: Vec<f32>,
    taught: Vec<f32>,
    masked: Vec<usize>,
    reward: f64,
    episodes: Episodes,
    failed: Option<Error>,
}

/// Name of a shard's environments as the teacher sees them, in a checkpoint.
fn twin(shard: usize) -> String {
    format!("teacher.{shard}.environments")
}

/// Its multiples lie evenly between whole numbers.
const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_9;

impl Worker {
    fn new(shard: Shard, actor: &Actor, config: &DaggerConfig, make: &Make<'_>) -> Result<Self> {
        let spec = shard.env.spec();
        let n_action = spec.n_env * spec.n_agent * spec.action.len();
        Ok(Self {
            teacher: Teacher::new(&shard, config, make)?,
            memory: actor.mlp.memory(ROWS),
            seen: shard.out.observation.clone(),
            own: vec![0.0; n_action],
            taught: vec![0.0; n_action],
            masked: Vec::new(),
            reward: 0.0,
            episodes: Episodes::default(),
            failed: None,
            shard,
        })
    }

    /// Flies fresh episodes, the share `by_teacher` of all environments by the teacher, and keeps what was seen and what it
    /// would give.
    fn fly(
        &mut self,
        optimiser: &PolicyOptimiser,
        learnt: &Learnt,
        by_teacher: f64,
        observation: &mut [f32],
        label: &mut [f32],
    ) -> Result<()> {
        let Self { shard: Shard { env, out }, teacher, memory, seen, own, taught, masked, .. } = self;
        let (n_env, n_agent, n_seen) = (env.spec().n_env, env.spec().n_agent, env.spec().n_observation);
        let (rows, n_action) = (n_env * n_agent, own.len() / (n_env * n_agent));
        let (n_read, n_label) = (learnt.columns.len(), learnt.network.n_output());
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
                to.copy_from_slice(&row[learnt.columns.clone()]);
            }
            for (x, actions) in seen.chunks(ROWS * n_seen).zip(own.chunks_mut(ROWS * n_action)) {
                optimiser.actor.modes(optimiser.net().parameters, x, memory, actions);
            }
            for i in (0..n_env).filter(|i| taught_one(*i)) {
                let place = i * n_agent * n_action..(i + 1) * n_agent * n_action;
                own[place.clone()].copy_from_slice(&taught[place]);
            }
            env.step(own, &mut out.out())?;
            let ended = (0..n_env).map(|i| out.terminated[i] | out.truncated[i] == 1);
            teacher.follow(own, ended)?;
            let finite = out.reward.iter().filter(|x| x.is_finite());
            self.reward += finite.map(|x| f64::from(*x)).sum::<f64>() / n_agent as f64;
            self.episodes.add(&episodes(env.spec(), out)?);
        }
        Ok(())
    }
}

impl Dagger {
    /// A run from random weights; `make` builds each shard's environments from its configuration.
    ///
    /// # Errors
    /// As [`DaggerConfig::validate`], [`Baseline::new`](tasks::Baseline::new) and `make`; as
    /// [`load_policy`](super::load_policy) and [`Policy::fits`] for a teacher that is
    /// a run's; [`Error::Limit`] for rows beyond [`EnvConfig::memory_limit`].
    pub fn with(make: &Make<'_>, env: &EnvConfig, config: DaggerConfig, seed: u64, threads: Threads) -> Result<Self> {
        config.validate()?;
        let env = EnvConfig { n_env: config.n_env, seed, easier: env.easier, ..env.clone().whole_episodes() };
        let rows = |spec: &Spec| config.n_env as u128 * spec.n_agent as u128 * config.steps as u128;
        let shards = shards_if(make, &env, config.shard, |first, _| {
            let spec = first.spec();
            let learnt = Learnt::new(&Actor::new(spec, &config.network, true)?, config.imitate)?;
            let each = (learnt.columns.len() + learnt.network.n_output()) as u128;
            within_memory("rows of an update", rows(spec), 4 * rows(spec) * each, env.memory_limit)
        })?;
        let spec = shards[0].env.spec().clone();
        let actor = Actor::new(&spec, &config.network, true)?.for_team(&spec, false)?;
        let learnt = Learnt::new(&actor, config.imitate)?;
        let rows = rows(&spec) as usize;
        let batch = Minibatch::new(&learnt.network, 0, rows.div_ceil(config.minibatches), env.memory_limit)?;
        let workers = shards.into_iter().map(|shard| Worker::new(shard, &actor, &config, make));
        Ok(Self {
            workers: workers.collect::<Result<_>>()?,
            observation: vec![0.0; rows * learnt.columns.len()],
            label: vec![0.0; rows * learnt.network.n_output()],
            learnt,
            order: Vec::new(),
            optimiser: PolicyOptimiser::new(actor, config.adam, seed),
            batch,
            config,
            threads,
            seed,
            update: 0,
            env_steps: 0,
        })
    }

    /// Fresh episodes of all environments.
    fn fly(&mut self, by_teacher: f64) -> Result<()> {
        let (optimiser, learnt, steps) = (&self.optimiser, &self.learnt, self.config.steps);
        let (mut seen, mut label) = (&mut self.observation[..], &mut self.label[..]);
        let mut parts = Vec::with_capacity(self.workers.len());
        for worker in &mut self.workers {
            let spec = worker.shard.env.spec();
            let rows = spec.n_env * spec.n_agent * steps;
            let (own, behind) = seen.split_at_mut(rows * learnt.columns.len());
            let (taught, rest) = label.split_at_mut(rows * learnt.network.n_output());
            parts.push((worker, own, taught));
            (seen, label) = (behind, rest);
        }
        self.threads.for_each(&mut parts, |_, (worker, seen, label)| {
            worker.failed = worker.fly(optimiser, learnt, by_teacher, seen, label).err();
        });
        self.workers.iter_mut().find_map(|worker| worker.failed.take()).map_or(Ok(()), Err)
    }

    /// All passes over the rows; gives the mean loss and the mean norm of its gradients.
    fn imitate(&mut self, rate: f64) -> [f64; 2] {
        let n = self.learnt.network.n_output();
        let rows = self.label.len() / n;
        let (mut loss, mut count, mut norms, mut steps) = (0.0, 0.0, 0.0, 0.0);
        for epoch in 0..self.config.epochs as u64 {
            shuffle(&mut self.order, rows, &mut Stream::new(self.seed, self.update, 2 + epoch, Purpose::LEARNING));
            for k in 0..self.config.minibatches {
                let chosen = part(&self.order, k, self.config.minibatches);
                let share = 1.0 / chosen.len().max(1) as f32;
                let label = &self.label;
                let own = |row: usize, given: &[f32], up: &mut [f32], _: &mut [f32], sums: &mut Sums| {
                    let taught = &label[row * n..][..n];
                    if taught.iter().any(|a| !a.is_finite()) {
                        return;
                    }
                    for ((up, a), wanted) in up.iter_mut().zip(given).zip(taught) {
                        let error = a - wanted;
                        let bounded = error.clamp(-1.0, 1.0);
                        *up = share * bounded;
                        sums[0] += f64::from(bounded * (error - 0.5 * bounded));
                    }
                    sums[1] += 1.0;
                };
                let net = self.learnt.weights(&self.optimiser.actor, self.optimiser.net());
                let network = &self.learnt.network;
                let sums = self.batch.gradient(&self.threads, network, net, &self.observation, chosen, &own);
                self.optimiser.gradient[self.learnt.place.clone()].copy_from_slice(&self.batch.gradient);
                norms += self.optimiser.descend(self.config.max_grad_norm, rate);
                (loss, count, steps) = (loss + sums[0], count + sums[1], steps + 1.0);
            }
        }
        [loss / f64::max(count, 1.0), norms / steps]
    }
}

impl Learner for Dagger {
    fn update(&mut self) -> Result<Update> {
        let begun = Instant::now();
        let progress = share_done(self.update, self.config.updates);
        let by_teacher = self.config.teacher_share.at(progress).clamp(0.0, 1.0);
        self.fly(by_teacher)?;
        let flown = begun.elapsed();
        let rate = self.config.learning_rate.at(progress);
        let [loss, gradient_norm] = self.imitate(rate);
        if self.config.imitate == Imitate::Action {
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
        let extra = vec![("teacher_share", by_teacher)];
        let phases = vec![("fly", flown), ("learn", begun.elapsed() - flown)];
        Ok(Update { loss, reward, episodes, gradient_norm, rate, extra, phases })
    }

    fn progress(&self) -> Progress {
        Progress { update: self.update, budget: self.config.updates, env_steps: self.env_steps }
    }

    fn set_difficulty(&mut self, share: f64) -> Result<()> {
        for worker in &mut self.workers {
            if let Some(twin) = worker.teacher.twin_mut() {
                twin.set_difficulty(share)?;
            }
        }
        set_difficulty(self.workers.iter_mut().map(|worker| &mut worker.shard), share)
    }

    fn warm_start(&mut self, start: &WarmStart) -> Result<()> {
        self.optimiser.warm_start(start)?;
        begin_statistics(self.workers.iter_mut().map(|worker| &mut worker.shard), start.statistics.as_ref())
    }

    fn teach(&mut self, teacher: Policy, of: &Spec, make: &Make<'_>) -> Result<()> {
        let (actor, spec) = (&self.optimiser.actor, self.workers[0].shard.env.spec());
        self.warm_start(&WarmStart::but_for_the_last_encoder(
            &teacher,
            of,
            actor,
            self.optimiser.net().parameters,
            spec,
        )?)?;
        for worker in &mut self.workers {
            worker.teacher = Teacher::of_latent(teacher.clone(), of, &worker.shard, make)?;
        }
        Ok(())
    }

    fn policy(&self) -> Result<Policy> {
        self.optimiser.policy(&self.workers[0].shard.env)
    }

    fn save(&self, policy: &mut Tensors, out: &mut Tensors) -> Result<()> {
        self.optimiser.save(policy, out)?;
        state::put_counters(out, [self.update, self.env_steps])?;
        for (k, worker) in self.workers.iter().enumerate() {
            if let Some(own) = worker.teacher.twin() {
                let bytes = own.save();
                out.insert(twin(k), &[bytes.len()], bytes)?;
            }
        }
        state::put_shards(out, self.workers.iter().map(|worker| &worker.shard))
    }

    fn load(&mut self, policy: &Tensors, from: &Tensors) -> Result<()> {
        let [update, env_steps] = state::counters(from)?;
        if self.workers[0].teacher.teaches_latent() && !self.optimiser.begins_as(from)? {
            let remedy = "Put it back as it was, or begin a run in another folder.";
            return Err(Error::value("teacher of the run", "another one", "the one that it was begun with", remedy));
        }
        self.optimiser.load(policy, from, 0)?;
        state::load_shards(from, self.workers.iter_mut().map(|worker| &mut worker.shard))?;
        for (k, worker) in self.workers.iter_mut().enumerate() {
            if let Some(own) = worker.teacher.twin_mut() {
                let n = from.tensor(&twin(k))?.shape().iter().product();
                own.load(from.get::<u8>(&twin(k), &[n])?)?;
            }
        }
        (self.update, self.env_steps) = (update, env_steps);
        Ok(())
    }
}
