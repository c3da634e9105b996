//! APG: analytic policy gradients. The gradient of a loss along simulated windows, through the physics, straight into the
//! policy.
//!
//! Each update
//! 1. flies every environment on for a window of H steps under the deterministic policy a = tanh(network(o)), recording;
//! 2. sweeps back: ∂L/∂θ of L = 1/(E·H) Σ loss(s_{t+1}), exact within the window and cut at its start and at ends of
//!    episodes;
//! 3. takes one Adam step on the clipped gradient.
//!
//! Windows continue where the last one stopped. There is no critic, so H must span the way from a rotor to what the loss
//! sees: half a second to a second and a half. What is scarce is the number of updates, not of environment steps.
//! (Wiedemann et al. 2023; Freeman et al. 2021 in Brax.)
//!
//! An episode that the task ends inside a window costs its last loss for the window's remaining steps, under the task's
//! loss, which is positive: an end worth nothing would be worth seeking. Under the reward it is worth nothing, as rewards
//! are positive. ([`ApgConfig::lasting`]; vehicles that tumble fast end at gradients that drown all others, and learn
//! better without.)
//!
//! Too high a learning rate saturates the network and never recovers. [`ApgConfig::saturation`] watches for it: the run
//! begins again at half the rate.

use super::checkpoint::Tensors;
use super::checks::check_counts;
use super::learner::{Learner, Make, Progress, Update, built_in, share_done};
use super::nn::{AdamConfig, Layers};
use super::policy::{Actor, Policy};
use super::policy_optimiser::{PolicyOptimiser, check_optimiser};
use super::schedule::Schedule;
use super::shards::{begin_statistics, normalise, set_difficulty, shards_if};
use super::state;
use super::warm_start::WarmStart;
use super::window::{Window, check_windows, gather, windows};

pub use super::window::Objective;

use base::defaults::with_defaults;
use base::error::{Error, Result};
use base::parallel::Threads;
use serde::{Deserialize, Serialize};
use std::time::Instant;
use tasks::{Env, EnvConfig, SweepOptions};

with_defaults! {
    /// Settings; defaults fly the Hummingbird's Hover from random weights.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ApgConfig {
        /// Environments, E.
        pub n_env: usize = 64,
        /// Environments of a shard: one thread steps it for a whole window.
        pub shard: usize = 32,
        /// H, steps.
        pub horizon: usize = 48,
        /// Updates of a run.
        pub updates: u64 = 800,
        /// Learning rate over the run.
        pub learning_rate: Schedule = Schedule::cosine(0.01, 1e-4),
        /// Largest norm of the gradient.
        pub max_grad_norm: f64 = 0.2,
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
        /// Whether the last loss of an episode that the task ended goes on to the window's end.
        pub lasting: bool = true,
        /// Share of hidden tanh units beyond ±0.99 at which the run begins again at half the rate, up to six times; 1 for never.
        pub saturation: f64 = 0.25,
        /// The optimiser.
        pub adam: AdamConfig = AdamConfig { beta2: 0.99, ..AdamConfig::default() },
        /// The policy.
        pub network: Layers = Layers::default(),
    }
}

impl ApgConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        check_counts(
            &[("n_env", self.n_env, 1 << 24), ("shard", self.shard, 1 << 24), ("horizon", self.horizon, 1 << 16)],
            "64, 32 and 48 are usual.",
        )?;
        check_optimiser(self.max_grad_norm, self.decay, [self.adjoint_clip, self.action_clip], self.saturation)?;
        self.learning_rate.validate("learning_rate")?;
        self.adam.validate()?;
        self.network.validate()
    }
}

built_in! {
    "apg": ApgConfig => Apg, squashed: true, loss: "mean cost of a step", in: "apg.rs";
}

/// Analytic policy gradients, in the middle of a run.
pub struct Apg {
    config: ApgConfig,
    optimiser: PolicyOptimiser,
    workers: Vec<Worker>,
    threads: Threads,
    update: u64,
    env_steps: u64,
}

/// A shard's window, and what went wrong in it.
struct Worker {
    window: Window,
    failed: Option<Error>,
}

impl Apg {
    /// A run from random weights on a task with this configuration; its `n_env` is [`ApgConfig::n_env`].
    ///
    /// # Errors
    /// As [`ApgConfig::validate`], [`Env::make`](tasks::Env::make), [`Env::adjoint`](tasks::Env::adjoint).
    pub fn new(task: &str, env: &EnvConfig, config: ApgConfig, seed: u64, threads: Threads) -> Result<Self> {
        Self::with(&|config| Env::make(task, config), env, config, seed, threads)
    }

    /// As [`Apg::new`], on environments of one's own.
    ///
    /// # Errors
    /// As there, and as `make`.
    pub fn with(make: &Make<'_>, env: &EnvConfig, config: ApgConfig, seed: u64, threads: Threads) -> Result<Self> {
        config.validate()?;
        let env = EnvConfig { n_env: config.n_env, seed, ..env.clone() };
        let shards = shards_if(make, &env, config.shard, |first, n| {
            check_windows(first, n, &Actor::new(first.spec(), &config.network, true)?, config.horizon)
        })?;
        let actor = Actor::new(shards[0].env.spec(), &config.network, true)?;
        // the weight of a step: the mean over all environments and steps of the window
        let loss_scale = 1.0 / (config.n_env * config.horizon) as f32;
        let options = SweepOptions { decay: config.decay, clip: config.adjoint_clip * loss_scale };
        let windows = windows(shards, &actor, config.horizon, config.objective, options)?;
        let action_clip = config.action_clip * loss_scale;
        let own = |mut window: Window| {
            window.action_clip = action_clip;
            Worker { window, failed: None }
        };
        let workers = windows.into_iter().map(own).collect();
        let optimiser = PolicyOptimiser::new(actor, config.adam, seed);
        Ok(Self { config, optimiser, workers, threads, update: 0, env_steps: 0 })
    }
}

impl Worker {
    /// Flies a window, weighs its steps and sweeps back over it. `loss_scale` is the weight of a step; with `lasting`, what an
    /// episode cost last goes on to the window's end if the task ended it.
    fn learn(&mut self, optimiser: &PolicyOptimiser, loss_scale: f32, lasting: bool) -> Result<()> {
        let (actor, net) = (&optimiser.actor, optimiser.net());
        self.window.fly(actor, net)?;
        for (left, step) in self.window.steps.iter_mut().rev().enumerate() {
            for (weight, lost) in step.weight.iter_mut().zip(&step.terminated) {
                *weight = loss_scale * if lasting && *lost == 1 { 1.0 + left as f32 } else { 1.0 };
            }
        }
        self.window.sweep(actor, net, &[]).map(|_| ())
    }
}

impl Learner for Apg {
    fn update(&mut self) -> Result<Update> {
        let begun = Instant::now();
        let (config, optimiser) = (&self.config, &self.optimiser);
        let n_step = (config.n_env * config.horizon) as f64;
        // the mean over all environments and steps of the window
        let (loss_scale, lasting) = ((1.0 / n_step) as f32, config.lasting && config.objective == Objective::Loss);
        self.threads.for_each(&mut self.workers, |_, worker| {
            worker.failed = worker.learn(optimiser, loss_scale, lasting).err()
        });
        let flown = self.workers.iter_mut().map(|worker| (&worker.window, worker.failed.take()));
        let seen = gather(flown, &mut self.optimiser.gradient)?;
        let windows = begun.elapsed();
        let rate = self.optimiser.rate(config.learning_rate.at(share_done(self.update, config.updates)));
        let norm = self.optimiser.descend(config.max_grad_norm, rate);
        normalise(&mut self.workers.iter_mut().map(|w| &mut w.window.shard).collect::<Vec<_>>())?;
        self.update += 1;
        self.env_steps += n_step as u64;
        if self.optimiser.restart_if_saturated(seen.saturated, config.saturation) {
            self.update = 0;
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
                ("gradients_dropped", seen.dropped as f64),
            ],
            phases: vec![("fly", flying), ("sweep", windows - flying), ("learn", begun.elapsed() - windows)],
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
        state::put_counters(out, [self.update, self.env_steps, self.optimiser.restarts])?;
        state::put_shards(out, self.workers.iter().map(|w| &w.window.shard))
    }

    fn load(&mut self, policy: &Tensors, from: &Tensors) -> Result<()> {
        let [update, env_steps, restarts] = state::counters(from)?;
        self.optimiser.load(policy, from, restarts)?;
        state::load_shards(from, self.workers.iter_mut().map(|w| &mut w.window.shard))?;
        (self.update, self.env_steps) = (update, env_steps);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::policy_optimiser::MAX_RESTARTS;
    use super::*;
    use crate::nn::Activation;

    #[test]
    fn a_run_ends_though_every_unit_is_beyond_the_limit_of_saturation() {
        for (activation, saturation) in [(Activation::Relu, 0.25), (Activation::Tanh, 1e-9)] {
            let network = Layers { activation, ..Layers::default() };
            let (n_env, shard, horizon, updates) = (8, 8, 4, 3);
            let config = ApgConfig { n_env, shard, horizon, updates, saturation, network, ..ApgConfig::default() };
            let mut apg = Apg::new("Hover", &EnvConfig::default(), config, 1, Threads::new(1).unwrap()).unwrap();
            for _ in 0..3 * (1 + MAX_RESTARTS) {
                if apg.n_update() < apg.budget() {
                    apg.update().unwrap();
                }
            }
            assert_eq!(apg.n_update(), apg.budget(), "{activation:?} after {} restarts", apg.optimiser.restarts);
        }
    }
    #[test]
    fn a_last_cost_goes_on_to_the_windows_end_under_the_loss_alone() {
        for objective in [Objective::Loss, Objective::Reward] {
            let text = "seed = 5\nstagger = true\ntask.horizon = 40\ntask.reset_distance = 0.15";
            let env = EnvConfig::from_toml(text, "test").unwrap();
            let config = ApgConfig { n_env: 24, shard: 24, horizon: 12, objective, ..ApgConfig::default() };
            let mut apg = Apg::new("Track", &env, config, 1, Threads::new(1).unwrap()).unwrap();
            apg.update().unwrap();
            let (mut lost, mut late) = (0, 0);
            for (t, step) in apg.workers[0].window.steps.iter().enumerate() {
                for (i, weight) in step.weight.iter().enumerate() {
                    let ended = step.terminated[i] == 1;
                    let on = if ended && objective == Objective::Loss { 12 - t } else { 1 };
                    assert_eq!(*weight, on as f32 * (1.0 / 288.0), "step {t}");
                    (lost, late) = (lost + u32::from(ended), late + u32::from(step.truncated[i]));
                }
            }
            assert!(lost > 2 && late > 2, "{lost} lost, {late} late");
        }
    }
}
