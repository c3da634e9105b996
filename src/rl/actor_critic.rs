//! An actor that climbs what critics say of kept experience: what SAC and TD3 share, for one drone or a team.
//!
//! Each update
//! 1. flies every environment `steps` steps on, exploring, and keeps them;
//! 2. takes `gradient_steps` gradient steps. Each draws a batch and fits every critic Q(o, a) to
//!    y = Σ γʲ rⱼ + γᵏ (minᵢ Q̄ᵢ(o', a') + b), with the slowly following Q̄ and an action a' that the algorithm chooses (and what it
//!    adds for it, b); then, in every `actor_delay`-th, it moves the actor up Q(o, π(o));
//! 3. takes the targets into the unit in which critics speak.
//!
//! Critics that tell quantiles are compared by their means, and fit all of those of the least one (Seo et al. 2025). The critics'
//! phase and the actor's go through the batch block by block: everything of a block happens on one thread while it is in cache.
//!
//! Critics speak in a running unit of their targets, and say the same when it changes (PopArt, van Hasselt et al. 2016): what
//! rewards are measured in does not matter.
//!
//! Where critics see the whole team (`central_critic`, Lowe et al. 2017), a row is an environment: they judge what all agents
//! saw and did, and each agent's own action alone carries its gradient. Agents then may have an actor each (`separate_actors`).

mod batch;
mod config;
mod kind;
mod state;
#[cfg(test)]
mod tests;

pub use config::{ActorCriticConfig, Exploration};
pub use kind::{Kind, Noise};

use super::experience::{Experience, Explore, Flown, ReplayBlock, Streams};
use super::learner::{Update, share_done};
use super::nn::elementwise::approach;
use super::nn::{Memory, Network, Pass, Scratch};
use super::policy::Actor;
use super::target_network::{NetWithTarget, Stride};
use super::value_loss::quantile_huber;
use super::value_norm::{Unit, ValueNorm};
use base::error::Result;
use base::parallel::Threads;
use batch::{Shapes, Work};
use std::time::{Duration, Instant};

/// What an update leaves of the statistics of the targets.
const VALUE_BETA: f64 = 0.98;

/// η of the mean of the actor's weights: it is of about the last fifth of its steps.
const MEAN_DECAY: f64 = 4.0;

/// An actor with critics, in the middle of a run.
pub struct ActorCritic<E: Exploration> {
    config: ActorCriticConfig<E>,
    kind: E::Kind,
    shapes: Shapes,
    actor: NetWithTarget,
    /// The mean of the actor's weights over its last steps, each of which went where the critics of its time erred (polynomial
    /// decay, Shamir and Zhang 2013): what flies.
    mean: Vec<f32>,
    /// Gradient step behind which weights are of the scale of observations in force, and count for the mean.
    mean_from: u64,
    critics: Vec<NetWithTarget>,
    value_norm: ValueNorm,
    experience: Experience,
    work: Vec<Work>,
    /// What flies.
    flown: Actor,
    threads: Threads,
    update: u64,
    env_steps: u64,
    /// Gradient steps.
    step: u64,
}

impl<E: Exploration> ActorCritic<E> {
    /// One update: the three steps of the header.
    fn update(&mut self) -> Result<Update> {
        let begun = Instant::now();
        let flown = self.collect()?;
        let flying = begun.elapsed();
        let unit = self.value_norm.unit();
        let mut metrics = Metrics::default();
        if self.experience.suffices() {
            (0..self.config.gradient_steps).for_each(|_| self.gradient_step(&mut metrics));
            self.rescale_critics()?;
        }
        let learning = begun.elapsed() - flying;
        self.update += 1;
        self.env_steps += (self.config.n_env * self.config.steps) as u64;
        Ok(self.report(&metrics, &flown, unit, flying, learning))
    }

    /// Step 1: flies on and keeps what was met. The mean of the weights begins anew where observations come to another scale.
    fn collect(&mut self) -> Result<Flown> {
        let progress = self.progress_of_run();
        let explore = Exploring {
            kind: &self.kind,
            correlation: self.config.correlation,
            network: &*self.shapes.actor,
            parameters: &self.actor.parameters,
            shapes: &self.shapes,
        };
        let flown = self.experience.fly(&self.threads, self.config.steps, (self.update, progress), &explore)?;
        if flown.rescaled {
            self.mean_from = self.step;
        }
        Ok(flown)
    }

    /// Step 2, one gradient step: the critics, then the actor where it is its turn.
    fn gradient_step(&mut self, metrics: &mut Metrics) {
        let progress = self.progress_of_run();
        let actor_learns = (self.step + 1).is_multiple_of(self.config.actor_delay as u64);
        // where the actor's target follows with a delay, those of the critics do
        let follows = actor_learns || !self.kind.has_target_actor();
        let tau = if follows { self.config.tau } else { 0.0 };
        self.critic_step(progress, tau);
        self.step += 1;
        metrics.critic_steps += 1.0;
        if actor_learns {
            metrics.rate = self.actor_step(progress, tau);
            metrics.gradient_norm += self.actor.gradient_norm;
            metrics.actor_steps += 1.0;
        }
        for work in &self.work {
            metrics.sums.iter_mut().zip(work.sums).for_each(|(sum, x)| *sum += x);
            metrics.left_out += work.block.left_out as f64;
        }
    }

    /// Draws a batch and moves every critic towards its targets.
    fn critic_step(&mut self, progress: f64, tau: f64) {
        self.critic_gradients(progress);
        let rate = self.config.critic_learning_rate.at(progress);
        let stride = Stride { clip: self.config.max_grad_norm, rate, tau };
        let (work, mlp) = (&self.work, &self.shapes.critic);
        self.threads.for_each(&mut self.critics, |k, critic| {
            critic.descend(mlp, work.iter().map(|own| &own.gradients[k][..]), stride);
        });
        self.experience.rank(self.work.iter().map(|work| &work.block));
    }

    /// Draws a batch, its targets and every critic's gradient on it.
    fn critic_gradients(&mut self, progress: f64) {
        let Self { kind, shapes, actor, critics, experience, config, step, value_norm, .. } = self;
        let unit = value_norm.unit();
        let target_actor = if kind.has_target_actor() { &actor.following } else { &actor.parameters };
        self.threads.for_each(&mut self.work, |number, work| {
            experience.gather(&mut work.block, (*step, number), progress);
            work.td_targets(kind, shapes, (target_actor, critics), unit);
            work.critic_gradients(shapes, critics, config.huber as f32);
        });
    }

    /// Moves the actor up Q on the same batch, and the mean of its weights with it; gives its learning rate.
    fn actor_step(&mut self, progress: f64, tau: f64) -> f64 {
        self.actor_gradient(progress);
        let stride = Stride { clip: self.config.max_grad_norm, rate: self.config.learning_rate.at(progress), tau };
        self.actor.descend(&self.shapes.actor, self.work.iter().map(|own| &own.gradient[..]), stride);
        let steps = ((self.step - self.mean_from) as f64 / self.config.actor_delay as f64).max(1.0);
        let share = (MEAN_DECAY + 1.0) / (steps + MEAN_DECAY);
        approach(&mut self.mean, &self.actor.parameters, share as f32);
        let left_out: usize = self.work.iter().map(|own| own.block.left_out).sum();
        let rows = ((self.config.batch - left_out).max(1) * self.shapes.agents) as f64;
        self.kind.adapt(self.work.iter().map(|own| own.sums[2]).sum::<f64>() / rows);
        stride.rate
    }

    /// The actor's gradient on the batch.
    fn actor_gradient(&mut self, progress: f64) {
        let Self { kind, shapes, actor, critics, value_norm, config, .. } = self;
        let (std, penalty) = (value_norm.unit().std, config.saturation_penalty.at(progress) as f32);
        let climbed = &critics[..kind.critics_of_actor(critics.len())];
        self.threads.for_each(&mut self.work, |_, work| {
            work.actor_gradient(kind, shapes, (actor, climbed), (std, penalty));
        });
    }

    /// Step 3: takes the last targets into the unit, in which critics then say the same.
    fn rescale_critics(&mut self) -> Result<()> {
        let targets = self.work.iter().flat_map(|work| work.block.counting(&work.target, self.shapes.quantiles));
        let change = self.value_norm.move_unit(targets);
        self.critics.iter_mut().try_for_each(|critic| critic.rescale(&self.shapes.critic, |_| change))
    }

    /// What the log tells of an update, behind it; `unit` is that of before.
    fn report(&self, metrics: &Metrics, flown: &Flown, unit: Unit, flying: Duration, learning: Duration) -> Update {
        let n_step = (self.config.n_env * self.config.steps) as f64;
        let rows = (self.config.batch as f64 * metrics.critic_steps).max(1.0);
        let acted = (self.config.batch as f64 * metrics.actor_steps * self.shapes.agents as f64).max(1.0);
        let per_critic = rows * self.config.critics as f64;
        let mut extra = vec![
            ("critic_loss", metrics.sums[0] / per_critic),
            ("value", f64::from(unit.denormalise((metrics.sums[1] / per_critic) as f32))),
            ("value_std", f64::from(unit.std)),
            ("kept", self.experience.kept() as f64),
            ("rows_left_out", metrics.left_out),
            // none where the actor did not learn
            ("before_tanh", (metrics.sums[4] / (acted * f64::from(metrics.actor_steps > 0.0))).sqrt()),
        ];
        extra.extend(self.kind.figures());
        Update {
            loss: -f64::from(unit.denormalise((-metrics.sums[3] / acted) as f32)),
            reward: flown.reward / n_step,
            episodes: flown.episodes,
            gradient_norm: metrics.gradient_norm / metrics.actor_steps.max(1.0),
            rate: metrics.rate,
            extra,
            phases: vec![("fly", flying), ("learn", learning)],
        }
    }

    fn progress_of_run(&self) -> f64 {
        share_done(self.update, self.config.updates)
    }
}

/// The actor while it explores.
struct Exploring<'a, K> {
    kind: &'a K,
    /// ρ of noise in the steps of an update.
    correlation: f64,
    network: &'a dyn Network,
    parameters: &'a [f32],
    shapes: &'a Shapes,
}

impl<K: Kind> Explore for Exploring<'_, K> {
    fn act(&self, x: &[f32], first: usize, memory: &mut Memory, streams: &mut Streams<'_>, actions: &mut [f32]) {
        let output = self.network.forward(self.parameters, x, x.len() / self.network.n_input(), memory);
        let n_action = self.shapes.widths.n_action;
        for (k, action) in self.shapes.each(actions).enumerate() {
            let environment = streams.environment(first + k);
            let held = (self.correlation > 0.0).then(|| (streams.held(first + k, n_action), self.correlation));
            let mut noise = Noise { stream: streams.of(first + k), held };
            self.kind.explore(output.row(k), environment, &mut noise, action);
        }
    }
}

impl Work {
    /// y of every row, in units of the critics.
    fn td_targets<K: Kind>(
        &mut self,
        kind: &K,
        shapes: &Shapes,
        (target_actor, critics): (&[f32], &[NetWithTarget]),
        unit: Unit,
    ) {
        let (rows, n) = (self.block.rows, shapes.quantiles);
        let output = shapes.actor.forward(target_actor, &self.block.next, rows * shapes.agents, &mut self.actor);
        self.bonus.fill(0.0);
        let mut noise = Noise { stream: &mut self.block.stream, held: None };
        for (k, action) in shapes.each(&mut self.actions).enumerate() {
            self.bonus[k / shapes.agents] += kind.target_action(output.row(k), &mut noise, action);
        }
        let base = if shapes.widths.n_state > 0 { &self.block.next_state } else { &self.block.next };
        shapes.join(base, &self.actions, &mut self.x);
        self.q[..rows].fill(f32::INFINITY);
        self.target.fill(f32::INFINITY);
        for critic in critics {
            let said = shapes.critic.forward(&critic.following, &self.x, rows, &mut self.critic);
            for (k, (least, target)) in self.q[..rows].iter_mut().zip(self.target.chunks_exact_mut(n)).enumerate() {
                let mean = mean(said.row(k));
                if mean < *least {
                    *least = mean;
                    target.copy_from_slice(said.row(k));
                }
            }
        }
        for (k, target) in self.target.iter_mut().enumerate() {
            let row = k / n;
            let next = unit.denormalise(*target) + self.bonus[row];
            *target = unit.normalise(self.block.reward[row] + self.block.discount[row] * next);
        }
    }

    /// Gradients of Σ weight · loss(Q − y)/batch for every critic.
    fn critic_gradients(&mut self, shapes: &Shapes, critics: &[NetWithTarget], huber: f32) {
        let (rows, n) = (self.block.rows, shapes.quantiles);
        let share = 1.0 / (shapes.batch * n * n) as f32;
        let base = if shapes.widths.n_state > 0 { &self.block.state } else { &self.block.observation };
        shapes.join(base, &self.block.action, &mut self.x);
        self.sums = [0.0; 5];
        self.block.error.fill(0.0);
        for (critic, gradient) in critics.iter().zip(&mut self.gradients) {
            let said = shapes.critic.forward(&critic.parameters, &self.x, rows, &mut self.critic);
            for (k, grad_q) in self.grad_q.chunks_exact_mut(n).enumerate() {
                let (target, weight) = (&self.target[k * n..][..n], self.block.weight[k]);
                let mut error = 0.0;
                for (i, (own, grad)) in said.row(k).iter().zip(grad_q).enumerate() {
                    let of_pair = quantile_huber(*own, i, target, weight, huber);
                    *grad = of_pair.slope * share;
                    error += of_pair.error;
                    self.sums[0] += f64::from(of_pair.loss) / (n * n) as f64;
                }
                let known = weight > 0.0 && error.is_finite();
                self.block.error[k] = self.block.error[k].max(if known { error.abs() / (n * n) as f32 } else { 0.0 });
                self.sums[1] += f64::from(mean(said.row(k)));
            }
            gradient.fill(0.0);
            let pass = Pass { gradient, grad_input: &mut [], scratch: &mut self.of_critic };
            shapes.critic.backward(critic.weights(), &self.x, rows, &self.critic, &self.grad_q, pass);
        }
    }

    /// The gradient of the mean of −Q(o, π(o)) + what the algorithm adds + what keeps tanh from its corners, as far as the agents of
    /// this block go.
    fn actor_gradient<K: Kind>(
        &mut self,
        kind: &K,
        shapes: &Shapes,
        (actor, critics): (&NetWithTarget, &[NetWithTarget]),
        (std, penalty): (f32, f32),
    ) {
        let (rows, n, agents) = (self.block.rows, shapes.widths.n_action, shapes.agents);
        let n_output = shapes.actor.n_output();
        let output = shapes.actor.forward(&actor.parameters, &self.block.observation, rows * agents, &mut self.actor);
        self.noise.iter_mut().for_each(|e| *e = self.block.stream.normal() as f32);
        for (k, action) in shapes.each(&mut self.actions).enumerate() {
            let noise = &self.noise[k * n..][..n];
            self.sums[2] +=
                f64::from(kind.policy_action(output.row(k), noise, action) * live(self.block.weight[k / agents]));
        }
        for agent in 0..agents {
            self.sums[3] -= q_gradient(
                (&self.block, &self.actions, agent),
                shapes,
                critics,
                (&mut self.critic, &mut self.of_critic),
                (&mut self.x, &mut self.q, &mut self.grad_q, &mut self.grad_x),
                &mut self.grad_action,
            );
        }
        for (k, own) in self.grad_output.chunks_exact_mut(n_output).enumerate() {
            let [noise, slope] = [&self.noise, &self.grad_action].map(|all| &all[k * n..][..shapes.done[k % agents]]);
            kind.output_gradient(output.row(k), noise, std, slope, own);
            let (before, counts) = (&output.row(k)[..slope.len()], live(self.block.weight[k / agents]));
            let each = 1.0 / slope.len().max(1) as f32;
            own.iter_mut().zip(before).for_each(|(x, y)| *x += 2.0 * penalty * each * y);
            self.sums[4] += f64::from(counts * each * before.iter().map(|y| y * y).sum::<f32>());
            let share = counts / (shapes.batch * agents) as f32;
            own.iter_mut().for_each(|x| *x *= share);
        }
        self.gradient.fill(0.0);
        let pass = Pass { gradient: &mut self.gradient, grad_input: &mut [], scratch: &mut self.of_actor };
        let x = &self.block.observation;
        shapes.actor.backward(actor.weights(), x, rows * agents, &self.actor, &self.grad_output, pass);
    }
}

/// Of quantiles.
fn mean(of: &[f32]) -> f32 {
    of.iter().sum::<f32>() / of.len() as f32
}

/// Rows that do not count are left out here; others count alike.
fn live(weight: f32) -> f32 {
    if weight > 0.0 { 1.0 } else { 0.0 }
}

/// −∂minᵢ Qᵢ/∂(action of one agent of every row), where the others do what they did; gives Σ minᵢ Qᵢ.
fn q_gradient(
    (block, actions, agent): (&ReplayBlock, &[f32], usize),
    shapes: &Shapes,
    critics: &[NetWithTarget],
    (memory, scratch): (&mut Memory, &mut Scratch),
    (x, q, grad_q, grad_x): (&mut [f32], &mut [f32], &mut [f32], &mut [f32]),
    grad_action: &mut [f32],
) -> f64 {
    let (rows, n, agents) = (block.rows, shapes.widths.n_action, shapes.agents);
    let (n_x, own) = (shapes.critic.n_input(), shapes.n_base + agent * n);
    let base = if shapes.widths.n_state > 0 { &block.state } else { &block.observation };
    shapes.join(base, &block.action, x);
    for (k, x) in x.chunks_exact_mut(n_x).enumerate() {
        x[own..own + n].copy_from_slice(&actions[(k * agents + agent) * n..][..n]);
    }
    // which critic says least is known when all have spoken; but for the last, each says it again for its slope
    for (critic, q) in critics.iter().zip(q.chunks_exact_mut(rows)) {
        let said = shapes.critic.forward(&critic.parameters, x, rows, memory);
        q.iter_mut().enumerate().for_each(|(k, q)| *q = mean(said.row(k)));
    }
    let least = |k: usize| (0..critics.len()).min_by(|a, b| q[a * rows + k].total_cmp(&q[b * rows + k])).unwrap_or(0);
    let (mut total, share) = (0.0, 1.0 / shapes.quantiles as f32);
    for (i, critic) in critics.iter().enumerate().rev() {
        for k in 0..rows {
            let chosen = least(k) == i;
            grad_q[k * shapes.quantiles..][..shapes.quantiles].fill(if chosen { -share } else { 0.0 });
            total += if chosen { f64::from(q[i * rows + k] * live(block.weight[k])) } else { 0.0 };
        }
        if i + 1 < critics.len() {
            shapes.critic.forward(&critic.parameters, x, rows, memory);
        }
        let pass = Pass { gradient: &mut [], grad_input: grad_x, scratch };
        shapes.critic.backward(critic.weights(), x, rows, memory, grad_q, pass);
        for (k, grad_x) in grad_x.chunks_exact(n_x).enumerate() {
            let to = &mut grad_action[(k * agents + agent) * n..][..n];
            if i + 1 == critics.len() {
                to.fill(0.0);
            }
            to.iter_mut().zip(&grad_x[own..own + n]).for_each(|(to, g)| *to += g);
        }
    }
    total
}

/// Sums over the gradient steps of an update.
#[derive(Default)]
struct Metrics {
    sums: [f64; 5],
    critic_steps: f64,
    actor_steps: f64,
    gradient_norm: f64,
    rate: f64,
    left_out: f64,
}
