//! PPO: proximal policy optimisation (Schulman et al. 2017), and MAPPO (Yu et al. 2022) where there are several agents.
//!
//! Each update
//! 1. flies every environment T steps on under the stochastic policy, a ~ π(·|o), unsquashed: the environment clips;
//! 2. estimates advantages A by GAE, with V of the true last observation where time ran out, and normalises them over
//!    the batch;
//! 3. goes over the batch `epochs` times in minibatches, and descends
//!    L = −E[min(ρ A, clip(ρ, 1 − ε, 1 + ε) A)] − β E[H(π)] with ρ = π(a|o)/π_old(a|o), and fits the critic to A + V_old
//!    by Huber's loss on the scale of `ValueNorm`.
//!
//! Actor and critic have a network, an optimiser and a gradient limit each. The agents of a team share their parameters, or
//! have their own ([`Team`]), and learn at once or one after the other: HAPPO (Kuba et al. 2022, algorithm 4). Then agent i,
//! in a drawn order, takes its passes with A times Π π_j/π_old,j of those before it, as they stand behind theirs. Where the
//! environment has a central state, the critic sees that (centralised training, decentralised execution).
//!
//! A policy with memory ([`Layers::memory`](super::nn::Layers::memory)) learns from sequences instead of rows: minibatches
//! are of whole windows, and gradients flow back through each. The critic has no memory.
//!
//! Rows in which anything is not finite take no part, neither in weights nor in statistics, and are counted.
//!
//! With [`PpoConfig::target_kl`] the actor's rate follows the divergence KL(π_old, π) that minibatches find: × 2/3 above
//! twice the target, × 3/2 below half of it (Schulman et al. 2017, section 4, as in Rudin et al. 2022). A target that falls over
//! the run lets steps shrink where the rate alone would not: what follows a divergence undoes a schedule of the rate.

mod config;
mod ratios;
#[cfg(test)]
mod tests;

pub use config::{PpoConfig, Team};

use ratios::Ratios;

use super::checkpoint::Tensors;
use super::critic::{Critic, Fit, shuffle};
use super::input_scale::InputScale;
use super::learner::{Episodes, Learner, Make, Progress, Update, built_in, share_done};
use super::minibatch::{BlockLoss, Minibatch, Sums, part};
use super::nn::elementwise::{self, exp};
use super::nn::gaussian::Gaussians;
use super::nn::head::Head;
use super::nn::{Adam, Output, Recurrence, Transposed, Weights, clip_norm};
use super::policy::{Actor, Policy, ROWS};
use super::rollout::{Collector, CriticSees, How, Rollout, Shape};
use super::sequences::{Sequence, Sequences, sequences};
use super::shards::{begin_statistics, normalise, set_difficulty, shards_if};
use super::state;
use super::value_norm::ValueNorm;
use super::warm_start::WarmStart;
use base::error::Result;
use base::parallel::Threads;
use rng::{Purpose, Stream};
use std::time::{Duration, Instant};
use tasks::{Env, EnvConfig, Spec};

built_in! {
    "ppo": PpoConfig => Ppo, squashed: false, loss: "−(clipped surrogate + entropy bonus)", in: "ppo/config.rs", actor: PpoConfig::actor;

    fn seen(&self, env: &EnvConfig) -> EnvConfig {
        PpoConfig::seen(self, env)
    }

    /// Updates are few and long.
    fn evaluate_every(&self) -> u64 {
        20
    }
}

/// Proximal policy optimisation, in the middle of a run.
pub struct Ppo {
    config: PpoConfig,
    actor: Actor,
    spec: Spec,
    parameters: Vec<f32>,
    /// One for each set of the actor's parameters.
    descents: Vec<Descent>,
    batch: Minibatch,
    /// In place of rows, where the policy has a memory.
    windows: Option<Windows>,
    /// Of a team that learns one after the other.
    ratios: Option<Ratios>,
    critic: Critic,
    norm: ValueNorm,
    collectors: Vec<Collector>,
    rollout: Rollout,
    threads: Threads,
    seed: u64,
    update: u64,
    env_steps: u64,
    /// Rows of the actor and of the critic that take part, an order of them, and targets.
    rows: [Vec<u32>; 2],
    order: [Vec<u32>; 2],
    targets: Vec<f32>,
    /// A of every row of the actor.
    advantage: Vec<f32>,
    /// Sets of the actor's parameters in the order in which they learn, and the rows of the one whose turn it is.
    turns: Vec<u32>,
    own: Vec<u32>,
}

/// What one set of the actor's parameters goes down with.
struct Descent {
    transposed: Transposed,
    adam: Adam,
    /// If actions are continuous.
    gaussians: Option<Gaussians>,
    /// On the rate: see [`PpoConfig::target_kl`].
    scale: f64,
}

/// What a policy with memory learns from.
struct Windows {
    all: Vec<Sequence>,
    /// Their places, and those of a minibatch.
    order: Vec<u32>,
    chosen: Vec<Sequence>,
    batch: Sequences,
}

/// Sums over rows that a minibatch gives.
mod sum {
    /// −min(ρ A, clip(ρ) A).
    pub const SURROGATE: usize = 0;
    pub const ENTROPY: usize = 1;
    /// ρ − 1 − ln ρ, whose mean is KL(π_old, π) and which is never negative (Schulman 2020).
    pub const KL: usize = 2;
    /// Rows with ρ outside 1 ± ε.
    pub const CLIPPED: usize = 3;
    /// Rows.
    pub const COUNT: usize = 4;
}

/// The actor's loss over a minibatch, row by row.
struct Loss<'a> {
    head: Head,
    gaussians: Option<&'a Gaussians>,
    extra: &'a [f32],
    rollout: &'a Rollout,
    advantage: &'a [f32],
    clip_epsilon: f64,
    entropy: f64,
    /// 1/rows of the minibatch.
    share: f64,
}

impl BlockLoss for Loss<'_> {
    fn block(&self, rows: &[u32], output: Output<'_>, grad_output: &mut [f32], d_extra: &mut [f32], sums: &mut Sums) {
        if let Some(gaussians) = self.gaussians {
            return self.block_of(gaussians, rows, output, (grad_output, d_extra), sums);
        }
        let n_out = grad_output.len() / rows.len().max(1);
        for (k, (grad_output, row)) in grad_output.chunks_exact_mut(n_out).zip(rows).enumerate() {
            self.row(*row as usize, output.row(k), grad_output, d_extra, sums);
        }
    }
}

impl Loss<'_> {
    /// The rows of a block side by side. Where there is no row, the ratio is 1 and the advantage 0.
    fn block_of(
        &self,
        gaussians: &Gaussians,
        rows: &[u32],
        output: Output<'_>,
        gradients: (&mut [f32], &mut [f32]),
        sums: &mut Sums,
    ) {
        let (n, n_action, share) = (rows.len(), self.rollout.shape.n_action, self.share as f32);
        let action = |k: usize| &self.rollout.action[rows[k] as usize * n_action..][..n_action];
        let log_probs = gaussians.log_probs(n, output, &action);
        let [mut log_ratio, mut advantage] = [[0.0_f32; ROWS]; 2];
        for (k, row) in rows.iter().map(|row| *row as usize).enumerate() {
            // within what f32 can weigh
            log_ratio[k] = (log_probs[k] - self.rollout.log_prob[row]).clamp(-30.0, 30.0);
            advantage[k] = self.advantage[row];
        }
        let mut ratio = log_ratio;
        exp(&mut ratio);
        let (least, most) = ((1.0 - self.clip_epsilon) as f32, (1.0 + self.clip_epsilon) as f32);
        let [mut weight, mut surrogate, mut divergence, mut outside] = [[0.0_f32; ROWS]; 4];
        for k in 0..ROWS {
            let (r, a) = (ratio[k], advantage[k]);
            let within = (least..=most).contains(&r);
            // as in `row`
            let passes = within | ((r > 1.0) != (a > 0.0));
            surrogate[k] = if passes { r * a } else { r.clamp(least, most) * a };
            weight[k] = if passes { -share * r * a } else { 0.0 };
            divergence[k] = ratio_divergence(log_ratio[k], r);
            outside[k] = if within { 0.0 } else { 1.0 };
        }
        let grad_entropy = (-self.share * self.entropy * n as f64) as f32;
        gaussians.gradient(n, output, &action, (&weight, grad_entropy), gradients);
        let total = |x: &[f32; ROWS]| f64::from(elementwise::sum(x));
        sums[sum::SURROGATE] -= total(&surrogate);
        sums[sum::ENTROPY] += n as f64 * gaussians.entropy;
        sums[sum::KL] += total(&divergence);
        sums[sum::CLIPPED] += total(&outside);
        sums[sum::COUNT] += n as f64;
    }

    fn row(&self, row: usize, output: &[f32], grad_output: &mut [f32], d_extra: &mut [f32], sums: &mut Sums) {
        let (n, extra) = (self.rollout.shape.n_action, self.extra);
        let action = &self.rollout.action[row * n..][..n];
        let advantage = f64::from(self.advantage[row]);
        // within what f32 can weigh
        let log_ratio = (self.head.log_prob(output, extra, action) - self.rollout.log_prob[row]).clamp(-30.0, 30.0);
        let log_ratio = f64::from(log_ratio);
        let ratio = log_ratio.exp();
        let within = (1.0 - self.clip_epsilon..=1.0 + self.clip_epsilon).contains(&ratio);
        // the clipped product is the smaller one where ρ has gone too far the way that A pulls
        let passes = within || (ratio > 1.0) != (advantage > 0.0);
        let surrogate = ratio.clamp(1.0 - self.clip_epsilon, 1.0 + self.clip_epsilon) * advantage;
        let grad_log_prob = if passes { -self.share * ratio * advantage } else { 0.0 };
        let grad_entropy = -self.share * self.entropy;
        self.head.gradient(output, extra, action, grad_log_prob as f32, grad_entropy as f32, grad_output, d_extra);
        sums[sum::SURROGATE] -= if passes { ratio * advantage } else { surrogate };
        sums[sum::ENTROPY] += f64::from(self.head.entropy(output, extra));
        sums[sum::KL] += ratio - 1.0 - log_ratio;
        sums[sum::CLIPPED] += if within { 0.0 } else { 1.0 };
        sums[sum::COUNT] += 1.0;
    }
}

/// ρ − 1 − ln ρ in `f32`: near ρ = 1, where nothing but rounding would be left, by its series.
fn ratio_divergence(log_ratio: f32, ratio: f32) -> f32 {
    let x = log_ratio;
    if x.abs() < 0.1 { x * x * (0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x / 120.0))) } else { ratio - 1.0 - x }
}

impl Ppo {
    /// A run from random weights on a task with this configuration; its `n_env` is [`PpoConfig::n_env`].
    ///
    /// # Errors
    /// As [`PpoConfig::validate`] and [`Env::make`]; [`Error::Limit`](base::error::Error::Limit) for rollouts beyond [`EnvConfig::memory_limit`].
    pub fn new(task: &str, env: &EnvConfig, config: PpoConfig, seed: u64, threads: Threads) -> Result<Self> {
        Self::with(&|own| Env::make(task, own), env, config, seed, threads)
    }

    /// As [`Ppo::new`] on a task of one's own: `make` builds each shard's environments from its configuration.
    ///
    /// # Errors
    /// As [`Ppo::new`], and what `make` says.
    pub fn with(make: &Make<'_>, env: &EnvConfig, config: PpoConfig, seed: u64, threads: Threads) -> Result<Self> {
        config.validate()?;
        let env = EnvConfig { n_env: config.n_env, seed, ..config.seen(env) };
        let sees = CriticSees { central: config.central_critic, privileged: config.privileged_critic };
        let n_state = config.network.memory.as_ref().map_or(0, Recurrence::units);
        let shape = |spec: &Spec| Shape::new(spec, config.steps, sees).remembering(n_state);
        let shards =
            shards_if(make, &env, config.shard, |first, _| shape(first.spec()).check(config.n_env, env.memory_limit))?;
        let spec = shards[0].env.spec().clone();
        let shape = shape(&spec);
        let actor = config.actor(&spec)?;
        let stream = |episode| Stream::new(seed, 0, episode, Purpose::LEARNING);
        let (n_set, n_of_set) = (actor.n_set(), actor.n_parameter_of_set());
        let mut parameters = Vec::with_capacity(actor.n_parameter());
        for k in 0..n_set {
            // number 1 is the critic's
            let number = if k == 0 { 0 } else { u64::MAX - k as u64 };
            parameters.extend(actor.mlp.init(&mut stream(number)));
            parameters.resize((k + 1) * n_of_set, config.log_std as f32);
        }
        let part = |rows: usize| (config.n_env * config.steps * rows).div_ceil(config.minibatches);
        let judged = (part(shape.n_judged), env.memory_limit);
        let mut critic = Critic::new(shape.n_critic(), &config.critic, config.adam, judged, &mut stream(1))?;
        let scales = config.normalise_observation && shape.n_central > 0;
        critic.inputs = scales.then(|| InputScale::new(shape.n_critic()));
        let windows = config.network.memory.as_ref().map(|memory| {
            let n_env = shards.iter().map(|shard| shard.env.spec().n_env);
            let all = sequences(shape, n_env, memory.window());
            let size = (all.len().div_ceil(config.minibatches), memory.window().min(config.steps));
            let (n_head, n_extra) = (actor.head.n_output(), actor.head.n_extra());
            let batch = Sequences::new(&*actor.mlp, n_head, n_extra, size, env.memory_limit)?;
            Ok(Windows { order: (0..all.len() as u32).collect(), chosen: Vec::with_capacity(size.0), all, batch })
        });
        let windows: Option<Windows> = windows.transpose()?;
        let rows = if windows.is_some() { 0 } else { part(shape.n_agent / n_set) };
        let mut ppo = Self {
            descents: (0..n_set)
                .map(|k| Descent {
                    transposed: Transposed::default(),
                    adam: Adam::new(config.adam, n_of_set),
                    gaussians: Gaussians::of(actor.head_of(k)),
                    scale: 1.0,
                })
                .collect(),
            ratios: (config.team == Team::Sequential && n_set > 1).then(Ratios::default),
            batch: Minibatch::new(&*actor.mlp, actor.head.n_extra(), rows, env.memory_limit)?,
            windows,
            norm: ValueNorm::new(config.value_beta)?,
            collectors: shards.into_iter().map(|shard| Collector::new(shard, &actor, &critic)).collect(),
            rollout: Rollout::new(shape, config.n_env),
            update: 0,
            env_steps: 0,
            rows: Default::default(),
            order: Default::default(),
            targets: Vec::new(),
            advantage: Vec::new(),
            turns: (0..n_set as u32).collect(),
            own: Vec::new(),
            actor,
            spec,
            parameters,
            critic,
            threads,
            seed,
            config,
        };
        ppo.transpose();
        Ok(ppo)
    }

    /// Weights as backward passes read them.
    fn transpose(&mut self) {
        for (k, own) in self.descents.iter_mut().enumerate() {
            self.actor.mlp.transpose(self.actor.set(&self.parameters, k).0, &mut own.transposed);
        }
    }

    /// Of a shard: its `config` is the one that evaluations take, normaliser and all.
    pub fn spec(&self) -> &Spec {
        &self.spec
    }

    /// A rollout of all shards, judged.
    fn collect(&mut self) -> Result<()> {
        let (actor, parameters, critic) = (&self.actor, &self.parameters, &self.critic);
        let how = How { actor, parameters, critic, norm: &self.norm, seed: self.seed, update: self.update };
        let parts = self.rollout.parts(self.collectors.iter().map(|c| c.shard.env.spec().n_env));
        let mut own: Vec<_> = self.collectors.iter_mut().zip(parts).collect();
        let progress = share_done(self.update, self.config.updates);
        let (discount, lambda) = (self.config.discount, self.config.lambda.at(progress));
        self.threads.for_each(&mut own, |_, (collector, part)| {
            let done = collector.collect(part, how).and_then(|()| part.judge(discount, lambda));
            collector.failed = done.err();
        });
        match self.collectors.iter_mut().find_map(|c| c.failed.take()) {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }

    /// Which rows take part; advantages and targets on the scales that are learnt. Gives the share of the targets'
    /// variance that the critic explained.
    fn prepare(&mut self) -> f64 {
        let Self { rollout: r, rows: [actors, judged], targets, advantage, .. } = self;
        judged.clear();
        judged.extend((0..r.target.len() as u32).filter(|k| {
            let k = *k as usize;
            r.target[k].is_finite() && r.advantage[k].is_finite()
        }));
        actors.clear();
        actors.extend((0..r.log_prob.len() as u32).filter(|k| {
            let k = *k as usize;
            r.log_prob[k].is_finite() && r.advantage[r.shape.judged(k)].is_finite()
        }));
        targets.clear();
        targets.extend(judged.iter().map(|k| r.target[*k as usize]));
        let [mean, variance] = moments(judged.iter().map(|k| r.advantage[*k as usize]));
        let explained = 1.0 - variance / moments(targets.iter().copied())[1].max(f64::MIN_POSITIVE);
        let inverse = 1.0 / (variance.sqrt() + 1e-8);
        r.advantage.iter_mut().for_each(|a| *a = ((f64::from(*a) - mean) * inverse) as f32);
        advantage.clear();
        advantage.extend((0..r.log_prob.len()).map(|row| r.advantage[r.shape.judged(row)]));
        self.norm.update(targets);
        self.norm.normalise(&mut r.target);
        explained
    }

    /// All passes over the rollout; gives the sums of the actor, of its gradient's norm and of the critic's loss, and
    /// the time of the critic, which learns beside the first set of the actor's parameters.
    fn learn(&mut self) -> Learnt {
        let mut learnt = Learnt::default();
        if self.ratios.is_some() {
            let mut stream = Stream::new(self.seed, self.update, u64::MAX, Purpose::LEARNING);
            shuffle(&mut self.turns, self.actor.n_set(), &mut stream);
        }
        for turn in 0..self.turns.len() {
            let set = self.turns[turn] as usize;
            let n_set = self.actor.n_set();
            self.own.clear();
            self.own.extend(self.rows[0].iter().filter(|row| **row as usize % n_set == set));
            self.take_turn(turn, set, &mut learnt);
            if let Some(ratios) = self.ratios.as_mut().filter(|_| turn + 1 < n_set) {
                ratios.find(&self.threads, (&self.actor, &self.parameters, set), &self.rollout, &self.own);
                for (row, ratio) in self.own.iter().zip(&ratios.all) {
                    let first = *row as usize - set;
                    self.turns[turn + 1..].iter().for_each(|later| self.advantage[first + *later as usize] *= ratio);
                }
            }
        }
        learnt
    }

    /// All passes of one set of the actor's parameters.
    fn take_turn(&mut self, turn: usize, set: usize, learnt: &mut Learnt) {
        let progress = share_done(self.update, self.config.updates);
        let fit = Fit {
            rate: self.config.critic_learning_rate.at(progress),
            clip: self.config.max_grad_norm,
            huber: self.config.huber as f32,
        };
        let epochs = self.config.epochs as u64;
        for epoch in 0..epochs {
            let mut stream = Stream::new(self.seed, self.update, 2 + turn as u64 * epochs + epoch, Purpose::LEARNING);
            let judged = if turn == 0 { &self.rows[1][..] } else { &[] };
            let actors = self.windows.as_ref().map_or(&self.own, |windows| &windows.order);
            for (order, rows) in self.order.iter_mut().zip([&actors[..], judged]) {
                shuffle(order, rows.len(), &mut stream);
                order.iter_mut().for_each(|k| *k = rows[*k as usize]);
            }
            let [actors, judged] = std::mem::take(&mut self.order);
            let before = learnt.sums;
            for k in 0..self.config.minibatches {
                self.improve(set, part(&actors, k, self.config.minibatches), progress, learnt);
                let begun = Instant::now();
                let Rollout { target, .. } = &self.rollout;
                let of_critic = part(&judged, k, self.config.minibatches);
                learnt.value += self.critic.fit(&self.threads, self.rollout.seen(), target, of_critic, fit);
                learnt.judging += begun.elapsed();
                learnt.critic_steps += if of_critic.is_empty() { 0.0 } else { 1.0 };
            }
            self.order = [actors, judged];
            let of_pass = |k: usize| learnt.sums[k] - before[k];
            if self.config.stop_kl.is_some_and(|most| of_pass(sum::KL) > most * of_pass(sum::COUNT)) {
                break;
            }
        }
    }

    /// One step of a set of the actor's parameters, from rows or, with memory, from sequences.
    fn improve(&mut self, set: usize, chosen: &[u32], progress: f64, learnt: &mut Learnt) {
        let rollout = &self.rollout;
        let counts =
            |row: usize| rollout.log_prob[row].is_finite() && rollout.advantage[rollout.shape.judged(row)].is_finite();
        let n_row = match &mut self.windows {
            None => chosen.len(),
            Some(Windows { all, chosen: own, .. }) => {
                own.clear();
                own.extend(chosen.iter().map(|k| all[*k as usize]));
                own.iter().flat_map(|own| own.rows()).filter(|row| counts(*row)).count()
            }
        };
        if n_row == 0 {
            return;
        }
        let (network, extra) = self.actor.set(&self.parameters, set);
        let descent = &mut self.descents[set];
        descent.gaussians.iter_mut().for_each(|gaussians| gaussians.set(extra));
        let loss = Loss {
            head: self.actor.head_of(set),
            gaussians: descent.gaussians.as_ref(),
            extra,
            rollout: &self.rollout,
            advantage: &self.advantage,
            clip_epsilon: self.config.clip_epsilon,
            entropy: self.config.entropy.at(progress),
            share: 1.0 / n_row as f64,
        };
        let net = Weights { parameters: network, transposed: &descent.transposed };
        let (threads, mlp) = (&self.threads, &*self.actor.mlp);
        let sums = match &mut self.windows {
            None => self.batch.gradient(threads, mlp, net, &rollout.observation, chosen, &loss),
            Some(own) => own.batch.gradient(threads, mlp, net, rollout, &own.chosen, &counts, &loss),
        };
        let rate = self.rate(set, progress, sums[sum::KL] / sums[sum::COUNT]);
        let gradient = match &mut self.windows {
            None => &mut self.batch.gradient,
            Some(own) => &mut own.batch.gradient,
        };
        learnt.gradient_norm += clip_norm(gradient, self.config.max_grad_norm);
        learnt.sums.iter_mut().zip(sums).for_each(|(all, own)| *all += own);
        learnt.rate = rate;
        learnt.actor_steps += 1.0;
        let n = self.actor.n_parameter_of_set();
        let (own, descent) = (&mut self.parameters[set * n..(set + 1) * n], &mut self.descents[set]);
        descent.adam.descend(own, gradient, rate);
        let (network, extra) = own.split_at_mut(self.actor.mlp.n_parameter());
        self.actor.head.clamp_extra(extra);
        self.actor.mlp.transpose(network, &mut descent.transposed);
    }

    /// Learning rate of the next step of a set of the actor's parameters, behind a divergence of `kl`.
    fn rate(&mut self, set: usize, progress: f64, kl: f64) -> f64 {
        let base = self.config.learning_rate.at(progress);
        let Some(target) = self.config.target_kl.map(|target| target.at(progress)) else {
            return base;
        };
        let scale = &mut self.descents[set].scale;
        if kl > 2.0 * target {
            *scale /= 1.5;
        } else if kl < 0.5 * target {
            *scale *= 1.5;
        }
        *scale = scale.clamp(1e-2, 10.0);
        base * *scale
    }

    /// Standard deviation of continuous actions, a mean over their numbers; 0 of others.
    fn deviation(&self) -> f64 {
        let extra = || (0..self.actor.n_set()).flat_map(|k| self.actor.set(&self.parameters, k).1);
        extra().map(|x| f64::from(*x).exp()).sum::<f64>() / extra().count().max(1) as f64
    }
}

/// Sums over minibatches.
#[derive(Default)]
struct Learnt {
    sums: Sums,
    gradient_norm: f64,
    value: f64,
    actor_steps: f64,
    critic_steps: f64,
    rate: f64,
    judging: Duration,
}

/// Mean and variance.
fn moments(x: impl Iterator<Item = f32> + Clone) -> [f64; 2] {
    let n = x.clone().count().max(1) as f64;
    let mean = x.clone().map(f64::from).sum::<f64>() / n;
    [mean, x.map(|x| (f64::from(x) - mean).powi(2)).sum::<f64>() / n]
}

impl Learner for Ppo {
    fn update(&mut self) -> Result<Update> {
        let begun = Instant::now();
        self.collect()?;
        let collected = begun.elapsed();
        let explained = self.prepare();
        let learnt = self.learn();
        if let Some(scale) = &mut self.critic.inputs {
            scale.take(self.collectors.iter().map(|collector| &collector.apart));
        }
        let learning = begun.elapsed() - collected;
        normalise(&mut self.collectors.iter_mut().map(|c| &mut c.shard).collect::<Vec<_>>())?;
        let shape = self.rollout.shape;
        let n_step = (self.config.n_env * self.config.steps) as f64;
        self.update += 1;
        self.env_steps += n_step as u64;
        let (mut episodes, mut reward, mut times) = (Episodes::default(), 0.0, [0.0; 3]);
        for Collector { seen, .. } in &self.collectors {
            episodes.add(&seen.episodes);
            reward += seen.reward;
            times.iter_mut().zip(seen.times).for_each(|(sum, time)| *sum += time.as_secs_f64());
        }
        let all = times.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let [acting, stepping, valuing] = times.map(|time| collected.mul_f64(time / all));
        let mean = |k: usize| learnt.sums[k] / learnt.sums[sum::COUNT].max(1.0);
        let progress = share_done(self.update - 1, self.config.updates);
        Ok(Update {
            loss: mean(sum::SURROGATE) - self.config.entropy.at(progress) * mean(sum::ENTROPY),
            reward: reward / n_step,
            episodes,
            gradient_norm: learnt.gradient_norm / learnt.actor_steps.max(1.0),
            rate: learnt.rate,
            extra: vec![
                ("critic_loss", learnt.value / learnt.critic_steps.max(1.0)),
                ("explained_variance", explained),
                ("entropy", mean(sum::ENTROPY)),
                ("deviation", self.deviation()),
                ("kl", mean(sum::KL)),
                ("clipped", mean(sum::CLIPPED)),
                ("rows_left_out", n_step * shape.n_agent as f64 - self.rows[0].len() as f64),
            ],
            phases: vec![
                ("act", acting),
                ("step", stepping),
                ("value", valuing),
                ("actor", learning - learnt.judging),
                ("critic", learnt.judging),
            ],
        })
    }

    fn progress(&self) -> Progress {
        Progress { update: self.update, budget: self.config.updates, env_steps: self.env_steps }
    }

    fn set_difficulty(&mut self, share: f64) -> Result<()> {
        set_difficulty(self.collectors.iter_mut().map(|c| &mut c.shard), share)
    }

    fn warm_start(&mut self, start: &WarmStart) -> Result<()> {
        start.check(&self.actor)?;
        let (n, n_of_set) = (self.actor.mlp.n_parameter(), self.actor.n_parameter_of_set());
        for (to, from) in self.parameters.chunks_exact_mut(n_of_set).zip(start.parameters.chunks_exact(n)) {
            to[..n].copy_from_slice(from);
        }
        self.transpose();
        begin_statistics(self.collectors.iter_mut().map(|c| &mut c.shard), start.statistics.as_ref())
    }

    fn policy(&self) -> Result<Policy> {
        Policy::of(&self.actor, &self.parameters, &self.collectors[0].shard.env)
    }

    fn save(&self, policy: &mut Tensors, out: &mut Tensors) -> Result<()> {
        state::put_actor(policy, &self.actor, &self.parameters)?;
        for (k, own) in self.descents.iter().enumerate() {
            state::put_adam(out, &self.actor.set_name(k), &own.adam)?;
        }
        self.critic.save(out)?;
        state::put_counters(out, [self.update, self.env_steps])?;
        state::put_value_norm(out, &self.norm)?;
        out.insert("rate_scale", &[self.descents.len()], self.descents.iter().map(|own| own.scale).collect())?;
        state::put_recalls(out, self.collectors.iter().map(|c| &c.recall))?;
        state::put_shards(out, self.collectors.iter().map(|c| &c.shard))
    }

    fn load(&mut self, policy: &Tensors, from: &Tensors) -> Result<()> {
        let parameters = state::actor(policy, &self.actor)?;
        let (n_set, n) = (self.actor.n_set(), self.actor.n_parameter_of_set());
        let adam = (0..n_set).map(|k| state::adam(from, &self.actor.set_name(k), self.config.adam, n));
        let adam = adam.collect::<Result<Vec<_>>>()?;
        let [update, env_steps] = state::counters(from)?;
        let scales = from.get::<f64>("rate_scale", &[n_set])?.to_vec();
        state::load_value_norm(from, &mut self.norm)?;
        self.critic.load(from)?;
        state::load_recalls(from, self.collectors.iter_mut().map(|c| &mut c.recall))?;
        state::load_shards(from, self.collectors.iter_mut().map(|c| &mut c.shard))?;
        for (own, (adam, scale)) in self.descents.iter_mut().zip(adam.into_iter().zip(scales)) {
            (own.adam, own.scale) = (adam, scale);
        }
        (self.parameters, self.update, self.env_steps) = (parameters, update, env_steps);
        self.transpose();
        Ok(())
    }
}
