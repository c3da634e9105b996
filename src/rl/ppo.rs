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
mod state;
#[cfg(test)]
mod tests;

pub use config::{PpoConfig, Team};

use super::critic::{Critic, Fit, shuffle};
use super::learner::{Episodes, Update, share_done};
use super::minibatch::{BlockLoss, Minibatch, Sums, minibatch};
use super::nn::elementwise::{self, exp};
use super::nn::gaussian::Gaussians;
use super::nn::head::Head;
use super::nn::{Adam, Output, Transposed, Weights, clip_norm};
use super::policy::{Actor, ROWS};
use super::rollout::{BehaviourPolicy, Collector, RolloutBatch};
use super::sequences::{Sequence, Sequences};
use super::shards::normalise;
use super::value_norm::ValueNorm;
use autodiff::Scalar;
use base::error::Result;
use base::parallel::Threads;
use ratios::Ratios;
use rng::{Purpose, Stream};
use std::time::{Duration, Instant};
use tasks::Spec;

/// Proximal policy optimisation, in the middle of a run.
pub struct Ppo {
    config: PpoConfig,
    spec: Spec,
    actor: Actor,
    parameters: Vec<f32>,
    /// One for each set of the actor's parameters.
    optimisers: Vec<ActorOptimiser>,
    /// Minibatches of rows; of sequences where the policy has a memory.
    minibatch: Minibatch,
    sequences: Option<SequenceMinibatch>,
    critic: Critic,
    value_norm: ValueNorm,
    /// Of a team that learns one after the other.
    ratios: Option<Ratios>,
    collectors: Vec<Collector>,
    rollout: RolloutBatch,
    /// A of every row of the actor, normalised.
    advantage: Vec<f32>,
    /// Rows of the actor and of the critic in which all is finite, and the order in which an epoch takes them.
    actor_rows: Vec<u32>,
    critic_rows: Vec<u32>,
    order: [Vec<u32>; 2],
    /// Targets of the critic's rows.
    targets: Vec<f32>,
    /// Sets of the actor's parameters in the order in which they learn, and the rows of the one that does.
    set_order: Vec<u32>,
    set_rows: Vec<u32>,
    threads: Threads,
    seed: u64,
    update: u64,
    env_steps: u64,
}

impl Ppo {
    /// One update: the three steps of the header.
    fn update(&mut self) -> Result<Update> {
        let begun = Instant::now();
        self.collect()?;
        self.estimate_advantages()?;
        let collecting = begun.elapsed();
        let explained_variance = self.normalise_advantages();
        let metrics = self.optimise();
        let optimising = begun.elapsed() - collecting;
        let report = self.report(&metrics, explained_variance, collecting, optimising);
        self.update_normalisers()?;
        self.env_steps += (self.config.n_env * self.config.steps) as u64;
        self.update += 1;
        Ok(report)
    }

    /// Step 1: a rollout of every shard under the policy as it is, with V of what it saw.
    fn collect(&mut self) -> Result<()> {
        let policy = BehaviourPolicy {
            actor: &self.actor,
            parameters: &self.parameters,
            critic: &self.critic,
            value_norm: &self.value_norm,
            seed: self.seed,
            update: self.update,
        };
        let parts = self.rollout.parts(self.collectors.iter().map(|c| c.shard.env.spec().n_env));
        let mut shards: Vec<_> = self.collectors.iter_mut().zip(parts).collect();
        self.threads.for_each(&mut shards, |_, (collector, part)| {
            collector.failed = collector.collect(part, policy).err();
        });
        self.collectors.iter_mut().find_map(|collector| collector.failed.take()).map_or(Ok(()), Err)
    }

    /// Step 2: advantages and targets of all rows, by GAE.
    fn estimate_advantages(&mut self) -> Result<()> {
        let (discount, lambda) = (self.config.discount, self.config.lambda.at(self.progress_of_run()));
        let mut parts = self.rollout.parts(self.collectors.iter().map(|c| c.shard.env.spec().n_env));
        let mut shards: Vec<_> = parts.iter_mut().map(|part| (part, Ok(()))).collect();
        self.threads.for_each(&mut shards, |_, (part, done)| *done = part.estimate_advantages(discount, lambda));
        shards.into_iter().try_for_each(|(_, done)| done)
    }

    /// Which rows take part; advantages normalised over these, targets on the scale that the critic learns. Gives the share of
    /// the targets' variance that the critic explained.
    fn normalise_advantages(&mut self) -> f64 {
        let Self { rollout: r, actor_rows, critic_rows, targets, advantage, .. } = self;
        critic_rows.clear();
        critic_rows.extend((0..r.target.len() as u32).filter(|k| {
            let k = *k as usize;
            r.target[k].is_finite() && r.advantage[k].is_finite()
        }));
        actor_rows.clear();
        actor_rows.extend((0..r.log_prob.len() as u32).filter(|row| r.counts(*row as usize)));
        targets.clear();
        targets.extend(critic_rows.iter().map(|k| r.target[*k as usize]));
        let [mean, variance] = moments(critic_rows.iter().map(|k| r.advantage[*k as usize]));
        let explained = 1.0 - variance / moments(targets.iter().copied())[1].max(f64::MIN_POSITIVE);
        let inverse = 1.0 / (variance.sqrt() + 1e-8);
        r.advantage.iter_mut().for_each(|a| *a = ((f64::from(*a) - mean) * inverse) as f32);
        advantage.clear();
        advantage.extend((0..r.log_prob.len()).map(|row| r.advantage[r.shape.critic_row(row)]));
        self.value_norm.update(targets);
        self.value_norm.normalise(&mut r.target);
        explained
    }

    /// Step 3: every set of the actor's parameters goes over the rollout, at HAPPO one after the other; the critic learns beside
    /// the first.
    fn optimise(&mut self) -> Metrics {
        let mut metrics = Metrics::default();
        let n_set = self.actor.n_set();
        if self.ratios.is_some() {
            let mut stream = Stream::new(self.seed, self.update, u64::MAX, Purpose::LEARNING);
            shuffle(&mut self.set_order, n_set, &mut stream);
        }
        for turn in 0..n_set {
            let set = self.set_order[turn] as usize;
            self.set_rows.clear();
            self.set_rows.extend(self.actor_rows.iter().filter(|row| **row as usize % n_set == set));
            self.epochs(turn, set, &mut metrics);
            self.weigh_later_advantages(turn, set);
        }
        metrics
    }

    /// Epochs × minibatches of one set of the actor's parameters, and of the critic in the first turn.
    fn epochs(&mut self, turn: usize, set: usize, metrics: &mut Metrics) {
        let n_minibatch = self.config.minibatches;
        for epoch in 0..self.config.epochs {
            self.shuffle_rows(turn, epoch);
            let [actor_order, critic_order] = std::mem::take(&mut self.order);
            let before = metrics.sums;
            for k in 0..n_minibatch {
                self.actor_step(set, minibatch(&actor_order, k, n_minibatch), metrics);
                self.critic_step(minibatch(&critic_order, k, n_minibatch), metrics);
            }
            self.order = [actor_order, critic_order];
            let of_epoch = |k: usize| metrics.sums[k] - before[k];
            if self.config.stop_kl.is_some_and(|most| of_epoch(sum::KL) > most * of_epoch(sum::COUNT)) {
                break;
            }
        }
    }

    /// Rows of an epoch (or sequences) in random order.
    fn shuffle_rows(&mut self, turn: usize, epoch: usize) {
        let number = 2 + (turn * self.config.epochs + epoch) as u64;
        let mut stream = Stream::new(self.seed, self.update, number, Purpose::LEARNING);
        let actor_rows = self.sequences.as_ref().map_or(&self.set_rows, |sequences| &sequences.places);
        let critic_rows = if turn == 0 { &self.critic_rows[..] } else { &[] };
        for (order, rows) in self.order.iter_mut().zip([&actor_rows[..], critic_rows]) {
            shuffle(order, rows.len(), &mut stream);
            order.iter_mut().for_each(|k| *k = rows[*k as usize]);
        }
    }

    /// One step of Adam down the actor's loss over a minibatch.
    fn actor_step(&mut self, set: usize, chosen: &[u32], metrics: &mut Metrics) {
        let Some(sums) = self.actor_gradient(set, chosen) else { return };
        let rate = self.learning_rate(set, self.progress_of_run(), sums[sum::KL] / sums[sum::COUNT]);
        let gradient = match &mut self.sequences {
            None => &mut self.minibatch.gradient,
            Some(sequences) => &mut sequences.minibatch.gradient,
        };
        metrics.gradient_norm += clip_norm(gradient, self.config.max_grad_norm);
        metrics.sums.iter_mut().zip(sums).for_each(|(total, x)| *total += x);
        metrics.rate = rate;
        metrics.actor_steps += 1.0;
        let n = self.actor.n_parameter_of_set();
        let (parameters, optimiser) = (&mut self.parameters[set * n..(set + 1) * n], &mut self.optimisers[set]);
        optimiser.adam.descend(parameters, gradient, rate);
        let (network, extra) = parameters.split_at_mut(self.actor.mlp.n_parameter());
        self.actor.head.clamp_extra(extra);
        self.actor.mlp.transpose(network, &mut optimiser.transposed);
    }

    /// The gradient of the actor's loss over rows or, with memory, over sequences; none if none of them counts.
    fn actor_gradient(&mut self, set: usize, chosen: &[u32]) -> Option<Sums> {
        let (rollout, progress) = (&self.rollout, self.progress_of_run());
        let counts = |row: usize| rollout.counts(row);
        let n_row = match &mut self.sequences {
            None => chosen.len(),
            Some(SequenceMinibatch { all, chosen: taken, .. }) => {
                taken.clear();
                taken.extend(chosen.iter().map(|k| all[*k as usize]));
                taken.iter().flat_map(|sequence| sequence.rows()).filter(|row| counts(*row)).count()
            }
        };
        if n_row == 0 {
            return None;
        }
        let (network, extra) = self.actor.set(&self.parameters, set);
        let optimiser = &mut self.optimisers[set];
        optimiser.gaussians.iter_mut().for_each(|gaussians| gaussians.set(extra));
        let loss = ActorLoss {
            head: self.actor.head_of(set),
            gaussians: optimiser.gaussians.as_ref(),
            extra,
            rollout,
            advantage: &self.advantage,
            clip_epsilon: self.config.clip_epsilon,
            entropy: self.config.entropy.at(progress),
            share: 1.0 / n_row as f64,
        };
        let net = Weights { parameters: network, transposed: &optimiser.transposed };
        let (threads, mlp) = (&self.threads, &*self.actor.mlp);
        Some(match &mut self.sequences {
            None => self.minibatch.gradient(threads, mlp, net, &rollout.observation, chosen, &loss),
            Some(SequenceMinibatch { minibatch, chosen, .. }) => {
                minibatch.gradient(threads, mlp, net, rollout, chosen, &counts, &loss)
            }
        })
    }

    /// Of the next step of a set of the actor's parameters, behind a divergence of `kl`.
    fn learning_rate(&mut self, set: usize, progress: f64, kl: f64) -> f64 {
        let base = self.config.learning_rate.at(progress);
        let Some(target) = self.config.target_kl.map(|target| target.at(progress)) else {
            return base;
        };
        let scale = &mut self.optimisers[set].rate_scale;
        if kl > 2.0 * target {
            *scale /= 1.5;
        } else if kl < 0.5 * target {
            *scale *= 1.5;
        }
        *scale = scale.clamp(1e-2, 10.0);
        base * *scale
    }

    /// One step of the critic towards the targets A + V of a minibatch.
    fn critic_step(&mut self, chosen: &[u32], metrics: &mut Metrics) {
        let begun = Instant::now();
        let fit = Fit {
            rate: self.config.critic_learning_rate.at(self.progress_of_run()),
            clip: self.config.max_grad_norm,
            huber: self.config.huber as f32,
        };
        let RolloutBatch { target, .. } = &self.rollout;
        metrics.critic_loss += self.critic.fit(&self.threads, self.rollout.critic_input(), target, chosen, fit);
        metrics.critic_time += begun.elapsed();
        metrics.critic_steps += if chosen.is_empty() { 0.0 } else { 1.0 };
    }

    /// HAPPO: those that learn later take advantages times π/π_old of the one that just did.
    fn weigh_later_advantages(&mut self, turn: usize, set: usize) {
        let later = &self.set_order[turn + 1..];
        let Some(ratios) = self.ratios.as_mut().filter(|_| !later.is_empty()) else { return };
        ratios.find(&self.threads, (&self.actor, &self.parameters, set), &self.rollout, &self.set_rows);
        for (row, ratio) in self.set_rows.iter().zip(&ratios.all) {
            let first = *row as usize - set;
            later.iter().for_each(|set| self.advantage[first + *set as usize] *= ratio);
        }
    }
}

/// The actor's loss over a minibatch: −(clipped surrogate + β H(π)), a mean over its rows.
struct ActorLoss<'a> {
    head: Head,
    /// Of continuous actions.
    gaussians: Option<&'a Gaussians>,
    extra: &'a [f32],
    rollout: &'a RolloutBatch,
    advantage: &'a [f32],
    clip_epsilon: f64,
    /// β.
    entropy: f64,
    /// 1/rows of the minibatch.
    share: f64,
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

/// The clipped surrogate min(ρ A, clip(ρ, 1 − ε, 1 + ε) A) of a row: in `f32` for rows side by side, in `f64` for one.
struct ClippedSurrogate<F> {
    /// 1 − ε, 1 + ε.
    range: [F; 2],
    /// −1/rows: what the loss takes of it.
    weight: F,
    /// |ln ρ| below which ρ − 1 − ln ρ is taken by its series, as nothing but rounding would be left of it.
    series: F,
}

/// What [`ClippedSurrogate`] says of a row.
struct Surrogate<F> {
    value: F,
    /// ∂loss/∂ln π(a|o).
    d_log_prob: F,
    /// ρ − 1 − ln ρ.
    kl: F,
    is_clipped: bool,
}

impl<F: Scalar + PartialOrd> ClippedSurrogate<F> {
    fn new(loss: &ActorLoss<'_>, series: f64) -> Self {
        let range = [1.0 - loss.clip_epsilon, 1.0 + loss.clip_epsilon].map(F::constant);
        Self { range, weight: F::constant(-loss.share), series: F::constant(series) }
    }

    #[inline(always)]
    fn of(&self, log_ratio: F, ratio: F, advantage: F) -> Surrogate<F> {
        let [least, most] = self.range;
        let within = (least..=most).contains(&ratio);
        // the clipped product is the smaller one where ρ has gone too far the way that A pulls
        let passes = within | ((ratio > F::one()) != (advantage > F::zero()));
        let x = log_ratio;
        let terms = [1.0 / 6.0, 1.0 / 24.0, 120.0].map(F::constant);
        let kl = if x.abs() < self.series {
            x * x * (F::constant(0.5) + x * (terms[0] + x * (terms[1] + x / terms[2])))
        } else {
            ratio - F::one() - x
        };
        Surrogate {
            value: if passes { ratio * advantage } else { ratio.clamp(least, most) * advantage },
            d_log_prob: if passes { self.weight * ratio * advantage } else { F::zero() },
            kl,
            is_clipped: !within,
        }
    }
}

impl BlockLoss for ActorLoss<'_> {
    fn block(&self, rows: &[u32], output: Output<'_>, grad_output: &mut [f32], d_extra: &mut [f32], sums: &mut Sums) {
        if let Some(gaussians) = self.gaussians {
            return self.gaussian_block(gaussians, rows, output, (grad_output, d_extra), sums);
        }
        let n_out = grad_output.len() / rows.len().max(1);
        for (k, (grad_output, row)) in grad_output.chunks_exact_mut(n_out).zip(rows).enumerate() {
            self.row(*row as usize, output.row(k), grad_output, d_extra, sums);
        }
    }
}

impl ActorLoss<'_> {
    /// The rows of a block side by side. Where there is no row, the ratio is 1 and the advantage 0.
    fn gaussian_block(
        &self,
        gaussians: &Gaussians,
        rows: &[u32],
        output: Output<'_>,
        gradients: (&mut [f32], &mut [f32]),
        sums: &mut Sums,
    ) {
        let (n, n_action) = (rows.len(), self.rollout.shape.n_action);
        let action = |k: usize| &self.rollout.action[rows[k] as usize * n_action..][..n_action];
        let log_probs = gaussians.log_probs(n, output, &action);
        let [mut log_ratio, mut advantage] = [[0.0_f32; ROWS]; 2];
        for (k, row) in rows.iter().map(|row| *row as usize).enumerate() {
            log_ratio[k] = self.log_ratio(row, log_probs[k]);
            advantage[k] = self.advantage[row];
        }
        let mut ratio = log_ratio;
        exp(&mut ratio);
        let objective = ClippedSurrogate::new(self, 0.1);
        let [mut surrogate, mut d_log_prob, mut kl, mut clipped] = [[0.0_f32; ROWS]; 4];
        for k in 0..ROWS {
            let own = objective.of(log_ratio[k], ratio[k], advantage[k]);
            (surrogate[k], d_log_prob[k], kl[k]) = (own.value, own.d_log_prob, own.kl);
            clipped[k] = if own.is_clipped { 1.0 } else { 0.0 };
        }
        let grad_entropy = (-self.share * self.entropy * n as f64) as f32;
        gaussians.gradient(n, output, &action, (&d_log_prob, grad_entropy), gradients);
        let total = |x: &[f32; ROWS]| f64::from(elementwise::sum(x));
        sums[sum::SURROGATE] -= total(&surrogate);
        sums[sum::ENTROPY] += n as f64 * gaussians.entropy;
        sums[sum::KL] += total(&kl);
        sums[sum::CLIPPED] += total(&clipped);
        sums[sum::COUNT] += n as f64;
    }

    /// One row, for any head.
    fn row(&self, row: usize, output: &[f32], grad_output: &mut [f32], d_extra: &mut [f32], sums: &mut Sums) {
        let (n, extra) = (self.rollout.shape.n_action, self.extra);
        let action = &self.rollout.action[row * n..][..n];
        let log_ratio = f64::from(self.log_ratio(row, self.head.log_prob(output, extra, action)));
        let objective = ClippedSurrogate::new(self, 0.0);
        let own = objective.of(log_ratio, log_ratio.exp(), f64::from(self.advantage[row]));
        let grad_entropy = -self.share * self.entropy;
        self.head.gradient(output, extra, action, own.d_log_prob as f32, grad_entropy as f32, grad_output, d_extra);
        sums[sum::SURROGATE] -= own.value;
        sums[sum::ENTROPY] += f64::from(self.head.entropy(output, extra));
        sums[sum::KL] += own.kl;
        sums[sum::CLIPPED] += if own.is_clipped { 1.0 } else { 0.0 };
        sums[sum::COUNT] += 1.0;
    }

    /// ln ρ, within what `f32` can weigh.
    fn log_ratio(&self, row: usize, log_prob: f32) -> f32 {
        (log_prob - self.rollout.log_prob[row]).clamp(-30.0, 30.0)
    }
}

/// Sums over the steps of an update.
#[derive(Default)]
struct Metrics {
    sums: Sums,
    gradient_norm: f64,
    rate: f64,
    actor_steps: f64,
    critic_loss: f64,
    critic_steps: f64,
    critic_time: Duration,
}

impl Ppo {
    /// What the log tells of an update.
    fn report(&self, metrics: &Metrics, explained: f64, collecting: Duration, optimising: Duration) -> Update {
        let n_step = (self.config.n_env * self.config.steps) as f64;
        let n_row = n_step * self.rollout.shape.n_agent as f64;
        let (mut episodes, mut reward, mut times) = (Episodes::default(), 0.0, [0.0; 3]);
        for Collector { stats, .. } in &self.collectors {
            episodes.add(&stats.episodes);
            reward += stats.reward;
            times.iter_mut().zip(stats.times).for_each(|(total, time)| *total += time.as_secs_f64());
        }
        let all = times.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let [acting, stepping, valuing] = times.map(|time| collecting.mul_f64(time / all));
        let mean = |k: usize| metrics.sums[k] / metrics.sums[sum::COUNT].max(1.0);
        Update {
            loss: mean(sum::SURROGATE) - self.config.entropy.at(self.progress_of_run()) * mean(sum::ENTROPY),
            reward: reward / n_step,
            episodes,
            gradient_norm: metrics.gradient_norm / metrics.actor_steps.max(1.0),
            rate: metrics.rate,
            extra: vec![
                ("critic_loss", metrics.critic_loss / metrics.critic_steps.max(1.0)),
                ("explained_variance", explained),
                ("entropy", mean(sum::ENTROPY)),
                ("deviation", self.mean_std()),
                ("kl", mean(sum::KL)),
                ("clipped", mean(sum::CLIPPED)),
                ("rows_left_out", n_row - self.actor_rows.len() as f64),
            ],
            phases: vec![
                ("act", acting),
                ("step", stepping),
                ("value", valuing),
                ("actor", optimising - metrics.critic_time),
                ("critic", metrics.critic_time),
            ],
        }
    }

    /// Standard deviation of continuous actions, a mean over their numbers; 0 of others.
    fn mean_std(&self) -> f64 {
        let extra = || (0..self.actor.n_set()).flat_map(|k| self.actor.set(&self.parameters, k).1);
        extra().map(|x| f64::from(*x).exp()).sum::<f64>() / extra().count().max(1) as f64
    }

    /// Takes what was seen into the scales of observations, which are frozen during a rollout.
    fn update_normalisers(&mut self) -> Result<()> {
        if let Some(scale) = &mut self.critic.inputs {
            scale.take(self.collectors.iter().map(|collector| &collector.apart));
        }
        normalise(&mut self.collectors.iter_mut().map(|c| &mut c.shard).collect::<Vec<_>>())
    }

    fn progress_of_run(&self) -> f64 {
        share_done(self.update, self.config.updates)
    }
}

/// What one set of the actor's parameters learns with.
struct ActorOptimiser {
    transposed: Transposed,
    adam: Adam,
    /// If actions are continuous.
    gaussians: Option<Gaussians>,
    /// On the rate: see [`PpoConfig::target_kl`].
    rate_scale: f64,
}

/// What a policy with memory learns from.
struct SequenceMinibatch {
    all: Vec<Sequence>,
    /// Their places in `all`.
    places: Vec<u32>,
    /// Those of a minibatch.
    chosen: Vec<Sequence>,
    minibatch: Sequences,
}

/// Mean and variance.
fn moments(x: impl Iterator<Item = f32> + Clone) -> [f64; 2] {
    let n = x.clone().count().max(1) as f64;
    let mean = x.clone().map(f64::from).sum::<f64>() / n;
    [mean, x.map(|x| (f64::from(x) - mean).powi(2)).sum::<f64>() / n]
}
