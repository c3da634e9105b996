//! SHAC: short-horizon actor-critic. Analytic gradients over a window, and a learnt value for what comes after it.
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

use super::checkpoint::Tensors;
use super::checks::{check_counts, check_positive};
use super::critic::{Critic, Fit, shuffle};
use super::gae::{Steps, advantages};
use super::learner::built_in;
use super::learner::{Learner, Make, Progress, Update, share_done};
use super::minibatch::part;
use super::nn::{Activation, AdamConfig, Layers, Memory, Scratch};
use super::policy::{Actor, Policy};
use super::policy_optimiser::{PolicyOptimiser, check_optimiser};
use super::schedule::Schedule;
use super::shards::{begin_statistics, normalise, set_difficulty, shards_if};
use super::state;
use super::warm_start::WarmStart;
use super::window::{Objective, Window, check_windows, gather, windows};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use base::parallel::Threads;
use rng::{Purpose, Stream};
use serde::{Deserialize, Serialize};
use std::time::Instant;
use tasks::{Env, EnvConfig, Spec, SweepOptions};

with_defaults! {
    /// Settings.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ShacConfig {
        /// Environments, E.
        pub n_env: usize = 128,
        /// Environments of a shard: one thread steps it for a whole window.
        pub shard: usize = 64,
        /// H, steps.
        pub horizon: usize = 32,
        /// Updates of a run.
        pub updates: u64 = 750,
        /// γ.
        pub discount: f64 = 0.97,
        /// λ of the critic's targets.
        pub lambda: f64 = 0.95,
        /// Share of the run over which w rises from 0 to 1.
        pub ramp: f64 = 0.5,
        /// Learning rate of the actor over the run.
        pub learning_rate: Schedule = Schedule::cosine(0.01, 1e-4),
        /// Learning rate of the critic over the run.
        pub critic_learning_rate: Schedule = Schedule::cosine(0.002, 1e-4),
        /// Largest norm of the actor's gradient.
        pub max_grad_norm: f64 = 0.2,
        /// Largest norm of the critic's gradient.
        pub critic_max_grad_norm: f64 = 1.0,
        /// Errors of the critic beyond it count linearly, in units of the cost of a step (Huber 1964).
        pub huber: f64 = 5.0,
        /// Whether the critic sees the numbers that differ between environments, where there are any: it is not flown.
        pub privileged_critic: bool = true,
        /// Passes of the critic over a window's experience.
        pub critic_epochs: usize = 2,
        /// Minibatches of a pass.
        pub minibatches: usize = 4,
        /// Share of the critic's old copy that stays in an update: 0.2 replaces four fifths of it.
        pub polyak: f32 = 0.2,
        /// Factor per step on the gradient that is carried back; 1 is exact.
        pub decay: f32 = 1.0,
        /// Largest norm, per environment, of the gradient that is carried back, where a step's cost weighs 1: what tumbles
        /// would drown all others. Infinite for none.
        pub adjoint_clip: f32 = f32::INFINITY,
        /// Largest norm, per environment and step, of the gradient of its actions, where a step's cost weighs 1: one that explodes
        /// would turn the update of all. Infinite for none.
        pub action_clip: f32 = f32::INFINITY,
        /// What is minimised.
        pub objective: Objective = Objective::Loss,
        /// Share of hidden tanh units beyond ±0.99 at which the run begins again at half the rate, up to six times; 1 for never.
        pub saturation: f64 = 0.25,
        /// The optimiser of both.
        pub adam: AdamConfig = AdamConfig { beta2: 0.99, ..AdamConfig::default() },
        /// The policy.
        pub network: Layers = Layers::default(),
        /// The critic.
        pub critic: Layers = Layers { activation: Activation::Elu, ..Layers::default() },
    }
}

impl ShacConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        check_counts(
            &[
                ("n_env", self.n_env, 1 << 24),
                ("shard", self.shard, 1 << 24),
                ("horizon", self.horizon, 1 << 16),
                ("critic_epochs", self.critic_epochs, 1 << 10),
                ("minibatches", self.minibatches, 1 << 10),
            ],
            "128, 64, 32, 2 and 4 are usual.",
        )?;
        check_optimiser(self.max_grad_norm, self.decay, [self.adjoint_clip, self.action_clip], self.saturation)?;
        check_positive(&[("huber", self.huber)], "5 is usual.")?;
        check_positive(&[("critic_max_grad_norm", self.critic_max_grad_norm)], "1 is usual.")?;
        let shares = [("lambda", self.lambda), ("ramp", self.ramp), ("polyak", self.polyak.into())];
        for (what, x) in shares {
            if !(0.0..=1.0).contains(&x) {
                return Err(Error::value(what, x, "within [0, 1]", "0.95, 0.5 and 0.2 are usual."));
            }
        }
        if !(0.0..1.0).contains(&self.discount) {
            return Err(Error::value("discount", self.discount, "within [0, 1)", "0.97 looks half a second ahead."));
        }
        self.learning_rate.validate("learning_rate")?;
        self.critic_learning_rate.validate("critic_learning_rate")?;
        self.adam.validate()?;
        self.network.validate()?;
        self.critic.validate()
    }
}

built_in! {
    "shac": ShacConfig => Shac, squashed: true, loss: "mean cost of a step", in: "shac.rs";
}

/// Short-horizon actor-critic, in the middle of a run.
pub struct Shac {
    config: ShacConfig,
    optimiser: PolicyOptimiser,
    spec: Spec,
    critic: Critic,
    /// The critic's slow copy.
    target: Vec<f32>,
    workers: Vec<Worker>,
    experience: Experience,
    threads: Threads,
    seed: u64,
    update: u64,
    env_steps: u64,
}

/// A shard's window with what the critic says of it.
struct Worker {
    window: Window,
    /// γ^k of the next step of every environment.
    discount: Vec<f32>,
    judge: Judge,
    grad_output: Vec<f32>,
    d_last: Vec<f32>,
    /// `[H + 1, E, known]`: the numbers that only the critic knows, about the nominal ones; the last of the state behind the
    /// window.
    known: Vec<f32>,
    failed: Option<Error>,
}

/// What pulling back through the critic needs.
struct Judge {
    memory: Memory,
    scratch: Scratch,
    /// Rows of the critic, and its gradient with respect to them.
    x: Vec<f32>,
    d_x: Vec<f32>,
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
        let env = EnvConfig { n_env: config.n_env, seed, ..env.clone() };
        let shards = shards_if(make, &env, config.shard, |first, n| {
            check_windows(first, n, &Actor::new(first.spec(), &config.network, true)?, config.horizon)
        })?;
        let spec = shards[0].env.spec().clone();
        let actor = Actor::new(&spec, &config.network, true)?;
        // the weight of a step: the mean over all environments and steps of the window
        let loss_scale = 1.0 / (config.n_env * config.horizon) as f32;
        let options = SweepOptions { decay: config.decay, clip: config.adjoint_clip * loss_scale };
        let windows = windows(shards, &actor, config.horizon, config.objective, options)?;
        let optimiser = PolicyOptimiser::new(actor, config.adam, seed);
        let n_row = config.n_env * spec.n_agent * config.horizon;
        let rows = (n_row.div_ceil(config.minibatches), env.memory_limit);
        let n_known = if config.privileged_critic { spec.privileged.len() } else { 0 };
        let n_in = spec.n_observation + n_known;
        let critic = Critic::new(n_in, &config.critic, config.adam, rows, &mut optimiser.stream(1))?;
        let action_clip = config.action_clip * loss_scale;
        let own = |mut window: Window| {
            window.action_clip = action_clip;
            if n_known > 0 {
                window.see_privileged();
            }
            Worker::new(window, &critic)
        };
        let workers = windows.into_iter().map(own).collect();
        let (target, experience) = (critic.parameters.clone(), Experience::default());
        let (update, env_steps) = (0, 0);
        Ok(Self { config, optimiser, spec, critic, target, workers, experience, threads, seed, update, env_steps })
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
        self.critic.values(&self.threads, &x, &mut values);
        values.iter_mut().for_each(|v| *v /= (1.0 - self.config.discount) as f32);
        values
    }

    /// TD(λ) targets over all windows, then minibatches.
    fn fit_critic(&mut self, progress: f64) -> f64 {
        let (config, e) = (&self.config, &mut self.experience);
        let loss_scale = (1.0 - config.discount) as f32;
        e.clear();
        let mut from = 0;
        for Worker { window, known, .. } in &self.workers {
            e.take(window, known, loss_scale, config.objective == Objective::Loss);
            // the slow copy judges what follows
            std::mem::swap(&mut self.critic.parameters, &mut self.target);
            let rows = e.cost.len();
            e.value.resize(rows, 0.0);
            e.next_value.resize(rows, 0.0);
            let n = self.critic.mlp.n_input();
            self.critic.values(&self.threads, &e.x[from * n..], &mut e.value[from..]);
            self.critic.values(&self.threads, &e.next[from * n..], &mut e.next_value[from..]);
            std::mem::swap(&mut self.critic.parameters, &mut self.target);
            e.advantage.resize(rows, 0.0);
            e.target.resize(rows, 0.0);
            let steps = Steps {
                reward: &e.cost[from..],
                value: &e.value[from..],
                next_value: &e.next_value[from..],
                terminated: &e.terminated[from / self.spec.n_agent..],
                truncated: &e.truncated[from / self.spec.n_agent..],
                n_env: window.shard.env.spec().n_env,
                n_agent: self.spec.n_agent,
            };
            let (advantage, target) = (&mut e.advantage[from..], &mut e.target[from..]);
            // lengths agree by construction
            let _ = advantages(&steps, config.discount, config.lambda, advantage, target);
            from = rows;
        }
        let fit = Fit {
            rate: config.critic_learning_rate.at(progress),
            clip: config.critic_max_grad_norm,
            huber: config.huber as f32,
        };
        let (mut loss, mut count) = (0.0, 0.0);
        for pass in 0..config.critic_epochs as u64 {
            let number = 2 + pass + (self.optimiser.restarts << 32);
            let mut stream = Stream::new(self.seed, self.update, number, Purpose::LEARNING);
            shuffle(&mut e.order, e.target.len(), &mut stream);
            for k in 0..config.minibatches {
                let chosen = part(&e.order, k, config.minibatches);
                loss += self.critic.fit(&self.threads, &e.x, &e.target, chosen, fit);
                count += if chosen.is_empty() { 0.0 } else { 1.0 };
            }
        }
        let keep = config.polyak;
        let own = self.critic.parameters.iter();
        self.target.iter_mut().zip(own).for_each(|(slow, new)| *slow = keep * *slow + (1.0 - keep) * new);
        loss / count
    }
}

impl Experience {
    fn clear(&mut self) {
        let Self { x, next, cost, terminated, truncated, .. } = self;
        [x, next, cost].into_iter().for_each(Vec::clear);
        [terminated, truncated].into_iter().for_each(Vec::clear);
    }

    /// One shard's window: [H, E, A] rows. Costs are scaled to those of (1 − γ)V; the last cost of an episode that the task
    /// ended counts for ever.
    fn take(&mut self, window: &Window, known: &[f32], loss_scale: f32, lasting: bool) {
        let (n_env, rows) = (window.shard.env.spec().n_env, window.rows());
        let (n_agent, n) = (rows / n_env, window.steps[0].observation.len() / rows);
        let n_known = known.len() / (n_env * (window.steps.len() + 1));
        for (t, step) in window.steps.iter().enumerate() {
            let next = window.steps.get(t + 1).map_or(&window.shard.out.observation, |step| &step.observation);
            for i in 0..n_env {
                let ended = step.terminated[i] | step.truncated[i] == 1;
                // what came next in an episode that ended is of that episode too
                let known = &known[(t * n_env + i) * n_known..][..n_known];
                for row in i * n_agent..(i + 1) * n_agent {
                    let own = row * n..(row + 1) * n;
                    self.x.extend(&step.observation[own.clone()]);
                    self.x.extend(known);
                    self.next.extend(if ended { &step.final_observation[own] } else { &next[own] });
                    self.next.extend(known);
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

impl Worker {
    fn new(window: Window, critic: &Critic) -> Self {
        let n_env = window.shard.env.spec().n_env;
        let n_seen = window.shard.out.observation.len();
        Self {
            discount: vec![1.0; n_env],
            judge: Judge::new(critic, window.rows()),
            grad_output: vec![0.0; window.rows()],
            d_last: vec![0.0; n_seen],
            known: Vec::new(),
            failed: None,
            window,
        }
    }

    /// Flies a window, weighs its steps and ends, and sweeps back over it.
    fn learn(&mut self, optimiser: &PolicyOptimiser, critic: &Critic, how: Weighing) -> Result<()> {
        let (actor, net) = (&optimiser.actor, optimiser.net());
        self.window.fly(actor, net)?;
        self.know();
        self.weigh(critic, how);
        self.window.sweep(actor, net, &self.d_last).map(|_| ())
    }

    /// What only the critic knows, step by step; nothing where windows do not keep it.
    fn know(&mut self) {
        let Window { steps, shard, .. } = &self.window;
        let mut rows: Vec<f32> = steps.iter().flat_map(|step| step.privileged.iter().copied()).collect();
        if !rows.is_empty() {
            rows.extend(&shard.out.privileged);
        }
        shard.env.spec().deviations(&rows, &mut self.known);
    }

    fn weigh(&mut self, critic: &Critic, how: Weighing) {
        let Self { window, discount, judge, grad_output, d_last, known, .. } = self;
        let n_env = discount.len();
        let n_agent = grad_output.len() / n_env;
        let beyond = 1.0 / (1.0 - how.discount);
        discount.fill(how.loss_scale);
        let n_step = window.steps.len();
        let of_step = |known: &'_ [f32], t: usize| {
            let n = known.len() / (n_step + 1);
            t * n..(t + 1) * n
        };
        for (t, step) in window.steps.iter_mut().enumerate() {
            step.d_final.clear();
            let timed_out = |i: usize| step.truncated[i] == 1 && step.terminated[i] == 0;
            if how.critic > 0.0 && (0..n_env).any(timed_out) {
                for (k, grad_output) in grad_output.iter_mut().enumerate() {
                    let i = k / n_agent;
                    let own = discount[i] * how.discount * how.critic * beyond / n_agent as f32;
                    *grad_output = if timed_out(i) { own } else { 0.0 };
                }
                step.d_final.resize(step.observation.len(), 0.0);
                let known = &known[of_step(known, t)];
                judge.pull(critic, (&step.final_observation, known), grad_output, &mut step.d_final);
            }
            // γ^(k + 1) of the last cost lie behind the window
            let behind = how.discount.powi((n_step - t) as i32);
            let lasting = 1.0 + (how.discount - (1.0 - how.critic) * behind) * beyond;
            for i in 0..n_env {
                let lost = step.terminated[i] == 1;
                step.weight[i] = discount[i] * if lost && how.lasting { lasting } else { 1.0 };
                let ended = lost || step.truncated[i] == 1;
                discount[i] = if ended { how.loss_scale } else { discount[i] * how.discount };
            }
        }
        d_last.fill(0.0);
        if how.critic > 0.0 {
            for (k, grad_output) in grad_output.iter_mut().enumerate() {
                *grad_output = discount[k / n_agent] * how.critic * beyond / n_agent as f32;
            }
            let known = &known[of_step(known, n_step)];
            judge.pull(critic, (&window.shard.out.observation, known), grad_output, d_last);
        }
    }
}

impl Judge {
    fn new(critic: &Critic, rows: usize) -> Self {
        let (memory, scratch) = (critic.mlp.memory(rows), critic.mlp.scratch(rows));
        Self { memory, scratch, x: Vec::new(), d_x: Vec::new() }
    }

    /// Adds ∂/∂o of Σ up · V(o, θ) to `d_seen`, for observations `[E, A, observation]` and what is known of each environment.
    fn pull(&mut self, critic: &Critic, (seen, known): (&[f32], &[f32]), up: &[f32], d_seen: &mut [f32]) {
        let memory = (&mut self.memory, &mut self.scratch);
        if known.is_empty() {
            return critic.pull(seen, up, memory, d_seen);
        }
        let n = seen.len() / up.len();
        let n_known = critic.mlp.n_input() - n;
        let n_agent = up.len() * n_known / known.len();
        self.x.clear();
        for (row, seen) in seen.chunks_exact(n).enumerate() {
            self.x.extend(seen);
            self.x.extend(&known[row / n_agent * n_known..][..n_known]);
        }
        self.d_x.clear();
        self.d_x.resize(self.x.len(), 0.0);
        critic.pull(&self.x, up, memory, &mut self.d_x);
        for (to, from) in d_seen.chunks_exact_mut(n).zip(self.d_x.chunks_exact(n + n_known)) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
    }
}

/// How parts of a window's cost weigh.
#[derive(Clone, Copy)]
struct Weighing {
    /// Of the first step: 1/(E·H).
    loss_scale: f32,
    /// γ.
    discount: f32,
    /// w.
    critic: f32,
    /// Whether an end by the task costs its last cost for ever.
    lasting: bool,
}

impl Learner for Shac {
    fn update(&mut self) -> Result<Update> {
        let begun = Instant::now();
        let config = &self.config;
        let progress = share_done(self.update, config.updates);
        let (optimiser, critic) = (&self.optimiser, &self.critic);
        let n_step = (config.n_env * config.horizon) as f64;
        let ramp = if config.ramp > 0.0 { (progress / config.ramp).min(1.0) } else { 1.0 };
        let how = Weighing {
            loss_scale: (1.0 / n_step) as f32,
            discount: config.discount as f32,
            critic: ramp as f32,
            lasting: config.objective == Objective::Loss,
        };
        self.threads
            .for_each(&mut self.workers, |_, worker| worker.failed = worker.learn(optimiser, critic, how).err());
        let flown = self.workers.iter_mut().map(|worker| (&worker.window, worker.failed.take()));
        let seen = gather(flown, &mut self.optimiser.gradient)?;
        let windows = begun.elapsed();
        let rate = self.optimiser.rate(config.learning_rate.at(progress));
        let norm = self.optimiser.descend(config.max_grad_norm, rate);
        let critic_loss = self.fit_critic(progress);
        normalise(&mut self.workers.iter_mut().map(|w| &mut w.window.shard).collect::<Vec<_>>())?;
        self.update += 1;
        self.env_steps += n_step as u64;
        if self.optimiser.restart_if_saturated(seen.saturated, self.config.saturation) {
            self.update = 0;
            self.critic.begin(&mut self.optimiser.stream(1));
            self.target.copy_from_slice(&self.critic.parameters);
        }
        let flying = seen.time_flying(windows);
        Ok(Update {
            loss: seen.cost / n_step,
            reward: seen.reward / n_step,
            episodes: seen.episodes,
            gradient_norm: norm,
            rate,
            extra: vec![
                ("saturated", seen.saturated),
                ("restarts", self.optimiser.restarts as f64),
                ("critic_loss", critic_loss),
                ("critic_weight", ramp),
                ("gradients_dropped", seen.dropped as f64),
            ],
            phases: vec![("fly", flying), ("sweep", windows - flying), ("critic", begun.elapsed() - windows)],
        })
    }

    fn progress(&self) -> Progress {
        Progress { update: self.update, budget: self.config.updates, env_steps: self.env_steps }
    }

    fn set_difficulty(&mut self, share: f64) -> Result<()> {
        set_difficulty(self.workers.iter_mut().map(|w| &mut w.window.shard), share)
    }

    fn warm_start(&mut self, start: &WarmStart) -> Result<()> {
        self.optimiser.warm_start(start)?;
        begin_statistics(self.workers.iter_mut().map(|w| &mut w.window.shard), start.statistics.as_ref())
    }

    fn policy(&self) -> Result<Policy> {
        self.optimiser.policy(&self.workers[0].window.shard.env)
    }

    fn save(&self, policy: &mut Tensors, out: &mut Tensors) -> Result<()> {
        self.optimiser.save(policy, out)?;
        self.critic.save(out)?;
        state::put_network(out, "target", &self.critic.mlp, &self.target)?;
        state::put_counters(out, [self.update, self.env_steps, self.optimiser.restarts])?;
        state::put_shards(out, self.workers.iter().map(|w| &w.window.shard))
    }

    fn load(&mut self, policy: &Tensors, from: &Tensors) -> Result<()> {
        let [update, env_steps, restarts] = state::counters(from)?;
        self.optimiser.load(policy, from, restarts)?;
        self.critic.load(from)?;
        self.target = state::network(from, "target", &self.critic.mlp)?;
        state::load_shards(from, self.workers.iter_mut().map(|w| &mut w.window.shard))?;
        (self.update, self.env_steps) = (update, env_steps);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
