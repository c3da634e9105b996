//! SHAC: short-horizon actor-critic. Analytic gradients over a window, and a learnt value for what comes after it.
//!
//! Each update
//! 1. flies every environment on for a window of H steps under the deterministic policy, recording;
//! 2. weighs the costs of its steps and asks the critic for the value of what follows, and sweeps back: ∂L/∂θ;
//! 3. takes one Adam step on the clipped gradient;
//! 4. fits the critic to TD(λ) targets along the same windows in `critic_epochs` epochs of minibatches.
//!
//! The cost of a window of H steps is
//! L = 1/(E·H) Σ_environments [ Σ_t γ^t c_t + w γ^H V(o_H) ],
//! with t counted from the window's start or from the last restart in it, and at an end of an episode
//! - by time: w γ V of the final observation;
//! - by the task: the last cost c goes on, Σ γ^i c over the window's remaining k steps and w times for ever behind it,
//!   under the task's loss, which is positive: an end worth nothing would be worth seeking. Under the reward it is worth
//!   nothing, as rewards are positive. (So it is where a state diverged, whose loss is 0: the critic leaves it out.)
//!
//! Its exact gradient trains the actor; the critic is fitted to TD(λ) targets along the same windows, with a slow copy of
//! itself as V of what follows (the actor's gradient takes the critic itself). The critic learns (1 − γ)V, a mean cost per
//! step, so that its scale is that of the cost.
//! Where numbers differ between environments, masses for example, the critic sees them behind the observation
//! ([`ShacConfig::privileged_critic`]; Pinto et al. 2018): what a drone costs depends on them, and they have no gradient.
//!
//! w rises from 0 to 1 over the first part of the run ([`ShacConfig::ramp`]): the gradient of an untrained critic, times
//! 1/(1 − γ), drowns the exact one. (Xu et al. 2022; the ramp is our own finding.)

mod config;
#[cfg(test)]
mod tests;
mod value_gradient;

pub use config::ShacConfig;

use super::checkpoint::Tensors;
use super::critic::{Critic, Fit, shuffle};
use super::gae::{Steps, advantages};
use super::learner::{Learner, Make, Progress, Update, share_done};
use super::minibatch::minibatch;
use super::policy::Policy;
use super::state;
use super::warm_start::WarmStart;
use super::window::{TrainingObjective, Window, WindowStats};
use super::window_run::WindowRun;
use base::error::Result;
use base::parallel::Threads;
use rng::{Purpose, Stream};
use std::time::Instant;
use tasks::{Env, EnvConfig, Spec};
use value_gradient::{CostWeights, WindowValue};

/// Short-horizon actor-critic, in the middle of a run.
pub struct Shac {
    config: ShacConfig,
    spec: Spec,
    run: WindowRun<WindowValue>,
    critic: Critic,
    /// Parameters of the critic's slow copy.
    target_critic: Vec<f32>,
    experience: Experience,
    seed: u64,
}

impl Shac {
    /// One update: the four steps of the header.
    fn update(&mut self) -> Result<Update> {
        let begun = Instant::now();
        let progress = share_done(self.run.update, self.config.updates);
        let critic_weight = self.critic_weight(progress);
        let stats = self.policy_gradient(critic_weight)?;
        let windows = begun.elapsed();
        let optimiser = &mut self.run.optimiser;
        let rate = optimiser.rate(self.config.learning_rate.at(progress));
        let gradient_norm = optimiser.descend(self.config.max_grad_norm, rate);
        self.estimate_targets();
        let critic_loss = self.fit_critic(progress);
        let n_step = (self.config.n_env * self.config.horizon) as f64;
        if self.run.finish_update(n_step as u64, stats.saturated, self.config.saturation)? {
            self.critic.begin(&mut self.run.optimiser.stream(1));
            self.target_critic.copy_from_slice(&self.critic.parameters);
        }
        let flying = stats.time_flying(windows);
        Ok(Update {
            loss: stats.cost / n_step,
            reward: stats.reward / n_step,
            episodes: stats.episodes,
            gradient_norm,
            rate,
            extra: vec![
                ("saturated", stats.saturated),
                ("restarts", self.run.optimiser.restarts as f64),
                ("critic_loss", critic_loss),
                ("critic_weight", critic_weight),
                ("gradients_dropped", stats.dropped as f64),
            ],
            phases: vec![("fly", flying), ("sweep", windows - flying), ("critic", begun.elapsed() - windows)],
        })
    }

    /// w.
    fn critic_weight(&self, progress: f64) -> f64 {
        if self.config.ramp > 0.0 { (progress / self.config.ramp).min(1.0) } else { 1.0 }
    }

    /// Steps 1 and 2: every shard flies a window, and the gradient of its cost and of the value behind it is swept back.
    fn policy_gradient(&mut self, critic_weight: f64) -> Result<WindowStats> {
        let weights = CostWeights {
            loss_scale: self.config.of_windows().loss_scale(),
            discount: self.config.discount as f32,
            critic: critic_weight as f32,
            lasting: self.config.objective == TrainingObjective::Loss,
        };
        let critic = &self.critic;
        self.run.gradient(|optimiser, window, value| {
            let (actor, net) = (&optimiser.actor, optimiser.net());
            window.fly(actor, net)?;
            value.see_privileged(window);
            value.weigh_costs(window, critic, weights);
            window.sweep(actor, net, &value.d_last).map(|_| ())
        })
    }

    /// TD(λ) targets along all windows, with the slow copy of the critic as V.
    fn estimate_targets(&mut self) {
        let Self { config, spec, run, critic, target_critic, experience: e, .. } = self;
        e.clear();
        std::mem::swap(&mut critic.parameters, target_critic);
        let mut from = 0;
        for worker in &run.workers {
            let (window, privileged) = (&worker.window, &worker.beside.privileged);
            let loss_scale = (1.0 - config.discount) as f32;
            e.extend(window, privileged, loss_scale, config.objective == TrainingObjective::Loss);
            let rows = e.cost.len();
            [&mut e.value, &mut e.next_value, &mut e.advantage, &mut e.target]
                .into_iter()
                .for_each(|x| x.resize(rows, 0.0));
            let n = critic.mlp.n_input();
            critic.values(&run.threads, &e.x[from * n..], &mut e.value[from..]);
            critic.values(&run.threads, &e.next[from * n..], &mut e.next_value[from..]);
            let steps = Steps {
                reward: &e.cost[from..],
                value: &e.value[from..],
                next_value: &e.next_value[from..],
                terminated: &e.terminated[from / spec.n_agent..],
                truncated: &e.truncated[from / spec.n_agent..],
                n_env: window.shard.env.spec().n_env,
                n_agent: spec.n_agent,
            };
            let (advantage, target) = (&mut e.advantage[from..], &mut e.target[from..]);
            // lengths agree by construction
            let _ = advantages(&steps, config.discount, config.lambda, advantage, target);
            from = rows;
        }
        std::mem::swap(&mut critic.parameters, target_critic);
    }

    /// Epochs × minibatches of the critic, then its slow copy follows; gives the mean loss.
    fn fit_critic(&mut self, progress: f64) -> f64 {
        let Self { config, run, critic, target_critic, experience: e, .. } = self;
        let fit = Fit {
            rate: config.critic_learning_rate.at(progress),
            clip: config.critic_max_grad_norm,
            huber: config.huber as f32,
        };
        let (mut loss, mut steps) = (0.0, 0.0);
        for epoch in 0..config.critic_epochs as u64 {
            let number = 2 + epoch + (run.optimiser.restarts << 32);
            shuffle(&mut e.order, e.target.len(), &mut Stream::new(self.seed, run.update, number, Purpose::LEARNING));
            for k in 0..config.minibatches {
                let chosen = minibatch(&e.order, k, config.minibatches);
                loss += critic.fit(&run.threads, &e.x, &e.target, chosen, fit);
                steps += if chosen.is_empty() { 0.0 } else { 1.0 };
            }
        }
        let (keep, learnt) = (config.polyak, critic.parameters.iter());
        target_critic.iter_mut().zip(learnt).for_each(|(slow, new)| *slow = keep * *slow + (1.0 - keep) * new);
        loss / steps
    }
}

/// All windows of an update, shard by shard, step by step: rows of the critic.
#[derive(Default)]
struct Experience {
    x: Vec<f32>,
    next: Vec<f32>,
    value: Vec<f32>,
    next_value: Vec<f32>,
    cost: Vec<f32>,
    terminated: Vec<u8>,
    truncated: Vec<u8>,
    advantage: Vec<f32>,
    target: Vec<f32>,
    order: Vec<u32>,
}

impl Experience {
    fn clear(&mut self) {
        let Self { x, next, cost, terminated, truncated, .. } = self;
        [x, next, cost].into_iter().for_each(Vec::clear);
        [terminated, truncated].into_iter().for_each(Vec::clear);
    }

    /// One shard's window: [H, E, A] rows. Costs are scaled to those of (1 − γ)V; the last cost of an episode that the task
    /// ended counts for ever.
    fn extend(&mut self, window: &Window, privileged: &[f32], loss_scale: f32, lasting: bool) {
        let (n_env, rows) = (window.shard.env.spec().n_env, window.rows());
        let (n_agent, n) = (rows / n_env, window.steps[0].observation.len() / rows);
        let n_privileged = privileged.len() / (n_env * (window.steps.len() + 1));
        for (t, step) in window.steps.iter().enumerate() {
            let next = window.steps.get(t + 1).map_or(&window.shard.out.observation, |step| &step.observation);
            for i in 0..n_env {
                let ended = step.terminated[i] | step.truncated[i] == 1;
                // what came next in an episode that ended is of that episode too
                let privileged = &privileged[(t * n_env + i) * n_privileged..][..n_privileged];
                for row in i * n_agent..(i + 1) * n_agent {
                    let own = row * n..(row + 1) * n;
                    self.x.extend(&step.observation[own.clone()]);
                    self.x.extend(privileged);
                    self.next.extend(if ended { &step.final_observation[own] } else { &next[own] });
                    self.next.extend(privileged);
                }
                let scale = if lasting && step.terminated[i] == 1 { 1.0 } else { loss_scale };
                self.cost.extend(std::iter::repeat_n(scale * step.cost[i], n_agent));
            }
            // what flew blind tells nothing: a target that is not finite is left out
            let first = self.cost.len() - rows;
            step.masked.iter().for_each(|row| self.cost[first + row] = f32::NAN);
            self.terminated.extend(&step.terminated);
            self.truncated.extend(&step.truncated);
        }
    }
}

impl Shac {
    /// A run from random weights on a task with this configuration; its `n_env` is [`ShacConfig::n_env`].
    ///
    /// # Errors
    /// As [`ShacConfig::validate`], [`Env::make`](tasks::Env::make), [`Env::adjoint`](tasks::Env::adjoint).
    pub fn new(task: &str, env: &EnvConfig, config: ShacConfig, seed: u64, threads: Threads) -> Result<Self> {
        Self::with(&|config| Env::make(task, config), env, config, seed, threads)
    }

    /// As [`Shac::new`], on environments of one's own.
    ///
    /// # Errors
    /// As there, and as `make`.
    pub fn with(make: &Make<'_>, env: &EnvConfig, config: ShacConfig, seed: u64, threads: Threads) -> Result<Self> {
        config.validate()?;
        let run = WindowRun::new(make, env, &config.of_windows(), (seed, threads))?;
        let spec = run.workers[0].window.shard.env.spec().clone();
        let n_row = config.n_env * spec.n_agent * config.horizon;
        let rows = (n_row.div_ceil(config.minibatches), env.memory_limit);
        let n_privileged = if config.privileged_critic { spec.privileged.len() } else { 0 };
        let n_in = spec.n_observation + n_privileged;
        let critic = Critic::new(n_in, &config.critic, config.adam, rows, &mut run.optimiser.stream(1))?;
        let run = run.beside(|window| {
            if n_privileged > 0 {
                window.see_privileged();
            }
            WindowValue::new(window, &critic)
        });
        let (target_critic, experience) = (critic.parameters.clone(), Experience::default());
        Ok(Self { config, spec, run, critic, target_critic, experience, seed })
    }

    /// What the critic expects each row of `[rows, observation]` to cost from there on, Σ γ^t c, in a mean episode where it
    /// knows more than that.
    pub fn cost_to_go(&mut self, observation: &[f32]) -> Vec<f32> {
        let n = self.spec.n_observation;
        let mut values = vec![0.0; observation.len() / n];
        let mut x = Vec::new();
        observation.chunks_exact(n).for_each(|row| {
            x.extend(row);
            x.resize(x.len() + self.critic.mlp.n_input() - n, 0.0);
        });
        self.critic.values(&self.run.threads, &x, &mut values);
        values.iter_mut().for_each(|v| *v /= (1.0 - self.config.discount) as f32);
        values
    }
}

impl Learner for Shac {
    fn update(&mut self) -> Result<Update> {
        Self::update(self)
    }

    fn progress(&self) -> Progress {
        self.run.progress(self.config.updates)
    }

    fn set_difficulty(&mut self, share: f64) -> Result<()> {
        self.run.set_difficulty(share)
    }

    fn warm_start(&mut self, start: &WarmStart) -> Result<()> {
        self.run.warm_start(start)
    }

    fn policy(&self) -> Result<Policy> {
        self.run.policy()
    }

    fn save(&self, policy: &mut Tensors, out: &mut Tensors) -> Result<()> {
        self.run.save(policy, out)?;
        self.critic.save(out)?;
        state::put_network(out, "target", &self.critic.mlp, &self.target_critic)
    }

    fn load(&mut self, policy: &Tensors, from: &Tensors) -> Result<()> {
        self.critic.load(from)?;
        let target_critic = state::network(from, "target", &self.critic.mlp)?;
        self.run.load(policy, from)?;
        self.target_critic = target_critic;
        Ok(())
    }
}
