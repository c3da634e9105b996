//! DQN: values of discrete actions from kept experience (Mnih et al. 2015), with what has been found since: double
//! (van Hasselt et al. 2016), duelling (Wang et al. 2016), distributional by quantiles (Dabney et al. 2018), by priorities
//! (Schaul et al. 2016), and for teams VDN (Sunehag et al. 2018) and QMIX (Rashid et al. 2018).
//!
//! Each update
//! 1. flies every environment `steps` steps on, ε-greedily, and keeps them;
//! 2. takes `gradient_steps` gradient steps. Each draws a batch, makes its targets y = Σ γʲ rⱼ + γᵏ max Q̄(o', ·) with the slowly
//!    following Q̄, of the team's mixed values where there is a mixer, and steps down the loss of Q − y;
//! 3. takes the targets into the unit in which values are.
//!
//! Where an action has several numbers of a few values each (`multi_discrete`), every number has values of its own, and the
//! value of an action is their mean (branching, Tavakoli et al. 2018): as many outputs as levels times numbers, not to their
//! power.
//!
//! Values are in a running unit of their targets, and say the same when it changes (PopArt, van Hasselt et al. 2016).
//!
//! What flies is the network folded to one output per action, Q, so that its greatest is the action.

mod batch;
mod config;
mod mixing;
mod state;
#[cfg(test)]
mod tests;
mod values;

pub use config::{DqnConfig, ValueMixer};

use super::experience::{Experience, Explore, Flown, ReplayBlock, Streams};
use super::learner::{Update, share_done};
use super::nn::{Memory, Mlp, Network, Output, Pass};
use super::policy::Actor;
use super::target_network::{NetWithTarget, Stride};
use super::value_loss::{Huber, quantile_huber};
use super::value_norm::{Unit, ValueNorm};
use base::error::Result;
use base::parallel::Threads;
use batch::{Shapes, Work};
use std::time::{Duration, Instant};

/// What an update leaves of the statistics of the targets.
const VALUE_BETA: f64 = 0.98;

/// Deep Q-learning, in the middle of a run.
pub struct Dqn {
    config: DqnConfig,
    shapes: Shapes,
    net: NetWithTarget,
    mixer: Option<NetWithTarget>,
    value_norm: ValueNorm,
    experience: Experience,
    work: Vec<Work>,
    /// What flies.
    flown: Actor,
    threads: Threads,
    update: u64,
    env_steps: u64,
    step: u64,
}

impl Dqn {
    /// One update: the three steps of the header.
    fn update(&mut self) -> Result<Update> {
        let begun = Instant::now();
        let flown = self.collect()?;
        let flying = begun.elapsed();
        let unit = self.value_norm.unit();
        let mut metrics = Metrics::default();
        if self.experience.suffices() {
            (0..self.config.gradient_steps).for_each(|_| self.gradient_step(&mut metrics));
            self.rescale_values()?;
        }
        let learning = begun.elapsed() - flying;
        let report = self.report(&metrics, &flown, unit, flying, learning);
        self.update += 1;
        self.env_steps += (self.config.n_env * self.config.steps) as u64;
        Ok(report)
    }

    /// Step 1: flies on and keeps what was met.
    fn collect(&mut self) -> Result<Flown> {
        let progress = self.progress_of_run();
        let epsilon = self.config.epsilon.at(progress);
        let explore = EpsilonGreedy { shapes: &self.shapes, parameters: &self.net.parameters, epsilon };
        self.experience.fly(&self.threads, self.config.steps, (self.update, progress), &explore)
    }

    /// Step 2, one gradient step of the network and, at QMIX, of the one that gives the mixer's weights.
    fn gradient_step(&mut self, metrics: &mut Metrics) {
        let progress = self.progress_of_run();
        self.gradients(progress);
        let Self { shapes, net, mixer, experience, config, work, .. } = self;
        let stride = Stride { clip: config.max_grad_norm, rate: config.learning_rate.at(progress), tau: config.tau };
        net.descend(&shapes.network, work.iter().map(|own| &own.gradient[..]), stride);
        if let (Some(mixer), Some(mlp)) = (mixer, shapes.mixer()) {
            mixer.descend(mlp, work.iter().map(|own| &own.mixer_gradient[..]), stride);
        }
        experience.rank(work.iter().map(|work| &work.block));
        self.step += 1;
        let sum = |k: usize| work.iter().map(|own| own.sums[k]).sum::<f64>();
        let left_out: usize = work.iter().map(|own| own.block.left_out).sum();
        metrics.loss += sum(0);
        metrics.value += sum(1);
        metrics.gradient_norm += net.gradient_norm;
        metrics.left_out += left_out as f64;
        metrics.steps += 1.0;
    }

    /// Draws a batch, its targets and the gradient of the loss on it.
    fn gradients(&mut self, progress: f64) {
        let Self { shapes, net, mixer, experience, config, step, value_norm, .. } = self;
        let unit = value_norm.unit();
        self.threads.for_each(&mut self.work, |number, work| {
            experience.gather(&mut work.block, (*step, number), progress);
            work.td_targets(shapes, (net, mixer.as_ref()), config.double, unit);
            work.loss_gradient(shapes, (net, mixer.as_ref()), config.huber as f32);
        });
    }

    /// Step 3: takes the last targets into the unit, in which values then say the same: those that agents add up to a team's each by its
    /// share, mixed ones by what mixes them.
    fn rescale_values(&mut self) -> Result<()> {
        let Self { shapes, net, mixer, value_norm, work, .. } = self;
        let values = shapes.values;
        let n = if shapes.mixing.is_some() { 1 } else { values.quantiles };
        let targets = work.iter().flat_map(|work| work.block.counting(&work.target, n));
        let (factor, shift) = value_norm.move_unit(targets);
        if let (Some(mixer), Some(mixing), Some(mlp)) = (mixer, &shapes.mixing, shapes.mixer()) {
            return mixer.rescale(mlp, |k| mixing.moved(k, (factor, shift)));
        }
        let (of_state, share) = (values.n_action() * values.quantiles, shift / shapes.agents as f32);
        // what the state adds takes the shift where it stands apart
        let moved = |k: usize| if values.duelling && k < of_state { (factor, 0.0) } else { (factor, share) };
        net.rescale(&shapes.network, moved)
    }

    /// What the log tells of an update; `unit` is that of before.
    fn report(&self, metrics: &Metrics, flown: &Flown, unit: Unit, flying: Duration, learning: Duration) -> Update {
        let progress = self.progress_of_run();
        let rows = (self.config.batch as f64 * metrics.steps).max(1.0);
        let n_step = (self.config.n_env * self.config.steps) as f64;
        Update {
            loss: metrics.loss / rows,
            reward: flown.reward / n_step,
            episodes: flown.episodes,
            gradient_norm: metrics.gradient_norm / metrics.steps.max(1.0),
            rate: self.config.learning_rate.at(progress),
            extra: vec![
                ("value", f64::from(unit.denormalise((metrics.value / rows) as f32))),
                ("value_std", f64::from(unit.std)),
                ("epsilon", self.config.epsilon.at(progress)),
                ("kept", self.experience.kept() as f64),
                ("rows_left_out", metrics.left_out),
            ],
            phases: vec![("fly", flying), ("learn", learning)],
        }
    }

    fn progress_of_run(&self) -> f64 {
        share_done(self.update, self.config.updates)
    }
}

/// The greatest value, but for a share of actions that are drawn evenly.
struct EpsilonGreedy<'a> {
    shapes: &'a Shapes,
    parameters: &'a [f32],
    epsilon: f64,
}

impl Explore for EpsilonGreedy<'_> {
    fn act(&self, x: &[f32], first: usize, memory: &mut Memory, streams: &mut Streams<'_>, actions: &mut [f32]) {
        let Shapes { network, values, .. } = self.shapes;
        let output = network.forward(self.parameters, x, x.len() / network.n_input(), memory);
        for (k, action) in actions.chunks_exact_mut(values.branches).enumerate() {
            let stream = streams.of(first + k);
            for (branch, a) in action.iter_mut().enumerate() {
                let drawn = stream.unit() < self.epsilon;
                let own = if drawn {
                    stream.below(values.levels as u64) as usize
                } else {
                    values.best(output.row(k), branch)
                };
                *a = own as f32;
            }
        }
    }
}

impl Work {
    /// Targets of every row.
    fn td_targets(
        &mut self,
        shapes: &Shapes,
        (net, mixer): (&NetWithTarget, Option<&NetWithTarget>),
        double: bool,
        unit: Unit,
    ) {
        let (rows, values, agents) = (self.block.rows, shapes.values, shapes.agents);
        let [of_net, of_target] = &mut self.memory;
        let said = shapes.network.forward(&net.following, &self.block.next, rows * agents, of_target);
        let chosen = double.then(|| shapes.network.forward(&net.parameters, &self.block.next, rows * agents, of_net));
        for k in 0..rows * agents {
            let (output, by) = (said.row(k), chosen.as_ref().map_or(said.row(k), |own: &Output<'_>| own.row(k)));
            let best = &mut self.best[k * values.branches..][..shapes.branches[k % agents]];
            best.iter_mut().enumerate().for_each(|(branch, level)| *level = values.best(by, branch));
            for q in 0..values.quantiles {
                let of = |(branch, level): (usize, &usize)| values.quantile(output, branch, *level, q);
                let value = best.iter().enumerate().map(of).sum::<f32>() / best.len() as f32;
                self.target[k * values.quantiles + q] = value;
            }
        }
        if let Some(mixing) = &shapes.mixing {
            let state = shapes.state(&self.block.next_state, &self.block.next);
            let weights = match (mixer, &shapes.mixing.as_ref().and_then(|m| m.weights.as_ref()), &mut self.of_mixer) {
                (Some(net), Some(mlp), Some((memory, _))) => Some(mlp.forward(&net.following, state, rows, memory)),
                _ => None,
            };
            for k in 0..rows {
                let own = weights.as_ref().map_or(&[][..], |all| all.row(k));
                self.target[k] = mixing.mix(&self.target[k * agents..(k + 1) * agents], own);
            }
        }
        for (k, value) in self.target.iter_mut().enumerate().take(rows * values.quantiles) {
            let row = k / values.quantiles;
            *value = unit.normalise(self.block.reward[row] + self.block.discount[row] * unit.denormalise(*value));
        }
    }

    /// The gradient of the mean loss, as far as the rows of this block go.
    fn loss_gradient(&mut self, shapes: &Shapes, (net, mixer): (&NetWithTarget, Option<&NetWithTarget>), huber: f32) {
        let (rows, agents) = (self.block.rows, shapes.agents);
        self.sums = [0.0; 2];
        self.grad_output.fill(0.0);
        let said = shapes.network.forward(&net.parameters, &self.block.observation, rows * agents, &mut self.memory[0]);
        match &shapes.mixing {
            None => {
                self.block.loss_gradient(shapes, (&said, huber), &self.target, &mut self.grad_output, &mut self.sums)
            }
            Some(mixing) => {
                let state = shapes.state(&self.block.state, &self.block.observation);
                let mlp = shapes.mixer();
                let weights = match (mixer, mlp, &mut self.of_mixer) {
                    (Some(net), Some(mlp), Some((memory, _))) => {
                        Some(mlp.forward(&net.parameters, state, rows, memory))
                    }
                    _ => None,
                };
                let n_weights = mlp.map_or(0, Mlp::n_output);
                for k in 0..rows {
                    let own = weights.as_ref().map_or(&[][..], |all| all.row(k));
                    let q = &mut self.q[k * agents..(k + 1) * agents];
                    for (i, q) in q.iter_mut().enumerate() {
                        *q = shapes.of_chosen(said.row(k * agents + i), self.block.done(k * agents + i, shapes));
                    }
                    let team = mixing.mix(q, own);
                    let error = Huber::of(team - self.target[k], self.block.weight[k], huber);
                    let up = error.slope / shapes.batch as f32;
                    let grad_weights = &mut self.grad_weights[k * n_weights..][..n_weights];
                    mixing.pull(q, own, up, &mut self.grad_q, grad_weights);
                    for i in 0..agents {
                        let n_output = shapes.values.n_output();
                        let to = &mut self.grad_output[(k * agents + i) * n_output..][..n_output];
                        shapes.pull_chosen(self.block.done(k * agents + i, shapes), up * self.grad_q[i], to);
                    }
                    self.sums[0] += f64::from(error.loss);
                    self.sums[1] += f64::from(team * self.block.weight[k]);
                }
                if let (Some(net), Some(mlp), Some((memory, scratch))) = (mixer, mlp, &mut self.of_mixer) {
                    self.mixer_gradient.fill(0.0);
                    let pass = Pass { gradient: &mut self.mixer_gradient, grad_input: &mut [], scratch };
                    mlp.backward(net.weights(), state, rows, memory, &self.grad_weights, pass);
                }
            }
        }
        self.gradient.fill(0.0);
        let pass = Pass { gradient: &mut self.gradient, grad_input: &mut [], scratch: &mut self.scratch };
        let x = &self.block.observation;
        shapes.network.backward(net.weights(), x, rows * agents, &self.memory[0], &self.grad_output, pass);
    }
}

impl ReplayBlock {
    /// What agent `k` of the block did.
    fn done(&self, k: usize, shapes: &Shapes) -> &[f32] {
        &self.action[k * shapes.widths.n_action..][..shapes.branches[k % self.agents]]
    }

    /// Every number of an action by itself against the target of the row; with quantiles the quantile Huber loss, each
    /// against all of the target's.
    fn loss_gradient(
        &mut self,
        shapes: &Shapes,
        (said, huber): (&Output<'_>, f32),
        target: &[f32],
        grad_output: &mut [f32],
        sums: &mut [f64; 2],
    ) {
        let (values, n) = (shapes.values, shapes.values.quantiles);
        let (n_output, share) = (values.n_output(), 1.0 / (shapes.batch * values.branches * n * n) as f32);
        for k in 0..self.rows {
            let (output, target) = (said.row(k), &target[k * n..][..n]);
            let grad_output = &mut grad_output[k * n_output..][..n_output];
            let mut worst: f32 = 0.0;
            for branch in 0..values.branches {
                let level = shapes.level(self.done(k, shapes)[branch]);
                let mut mean = 0.0;
                for q in 0..n {
                    let own =
                        quantile_huber(values.quantile(output, branch, level, q), q, target, self.weight[k], huber);
                    sums[0] += f64::from(own.loss * share * shapes.batch as f32);
                    mean += own.error / (n * n) as f32;
                    values.pull((branch, level, q), own.slope * share, grad_output);
                }
                sums[1] += f64::from(values.value(output, branch, level) * self.weight[k] / values.branches as f32);
                worst = worst.max(mean.abs());
            }
            self.error[k] = if self.weight[k] > 0.0 { worst } else { 0.0 };
        }
    }
}

/// Sums over the gradient steps of an update.
#[derive(Default)]
struct Metrics {
    loss: f64,
    value: f64,
    gradient_norm: f64,
    left_out: f64,
    steps: f64,
}
