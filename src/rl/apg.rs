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

mod config;

pub use super::window::TrainingObjective;
pub use config::ApgConfig;

use super::checkpoint::Tensors;
use super::learner::{Learner, Make, Progress, Update, share_done};
use super::policy::Policy;
use super::warm_start::WarmStart;
use super::window::{Window, WindowStats};
use super::window_run::WindowRun;
use base::error::Result;
use base::parallel::Threads;
use std::time::Instant;
use tasks::{Env, EnvConfig};

/// Analytic policy gradients, in the middle of a run.
pub struct Apg {
    config: ApgConfig,
    run: WindowRun<()>,
}

impl Apg {
    /// One update: the three steps of the header.
    fn update(&mut self) -> Result<Update> {
        let begun = Instant::now();
        let stats = self.policy_gradient()?;
        let windows = begun.elapsed();
        let Self { config, run } = self;
        let rate = run.optimiser.rate(config.learning_rate.at(share_done(run.update, config.updates)));
        let gradient_norm = run.optimiser.descend(config.max_grad_norm, rate);
        let n_step = (config.n_env * config.horizon) as f64;
        run.finish_update(n_step as u64, stats.saturated, config.saturation)?;
        let flying = stats.time_flying(windows);
        Ok(Update {
            loss: stats.cost / n_step,
            reward: stats.reward / n_step,
            episodes: stats.episodes,
            gradient_norm,
            rate,
            extra: vec![
                ("saturated", stats.saturated),
                ("restarts", run.optimiser.restarts as f64),
                ("gradients_dropped", stats.dropped as f64),
            ],
            phases: vec![("fly", flying), ("sweep", windows - flying), ("learn", begun.elapsed() - windows)],
        })
    }

    /// Steps 1 and 2: every shard flies a window, and its gradient is swept back over it.
    fn policy_gradient(&mut self) -> Result<WindowStats> {
        let (config, loss_scale) = (&self.config, self.config.of_windows().loss_scale());
        let lasting = config.lasting && config.objective == TrainingObjective::Loss;
        self.run.gradient(|optimiser, window, ()| {
            let (actor, net) = (&optimiser.actor, optimiser.net());
            window.fly(actor, net)?;
            weigh_costs(window, loss_scale, lasting);
            window.sweep(actor, net, &[]).map(|_| ())
        })
    }
}

/// ∂L/∂cost of every step; with `lasting`, what an episode cost last goes on to the window's end if the task ended it.
fn weigh_costs(window: &mut Window, loss_scale: f32, lasting: bool) {
    for (left, step) in window.steps.iter_mut().rev().enumerate() {
        for (weight, lost) in step.weight.iter_mut().zip(&step.terminated) {
            *weight = loss_scale * if lasting && *lost == 1 { 1.0 + left as f32 } else { 1.0 };
        }
    }
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
        let run = WindowRun::new(make, env, &config.of_windows(), (seed, threads))?;
        Ok(Self { config, run })
    }
}

impl Learner for Apg {
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
        self.run.save(policy, out)
    }

    fn load(&mut self, policy: &Tensors, from: &Tensors) -> Result<()> {
        self.run.load(policy, from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Activation, Layers};
    use crate::policy_optimiser::MAX_RESTARTS;

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
            assert_eq!(apg.n_update(), apg.budget(), "{activation:?} after {} restarts", apg.run.optimiser.restarts);
        }
    }

    #[test]
    fn a_last_cost_goes_on_to_the_windows_end_under_the_loss_alone() {
        for objective in [TrainingObjective::Loss, TrainingObjective::Reward] {
            let text = "seed = 5\nstagger = true\ntask.horizon = 40\ntask.reset_distance = 0.15";
            let env = EnvConfig::from_toml(text, "test").unwrap();
            let config = ApgConfig { n_env: 24, shard: 24, horizon: 12, objective, ..ApgConfig::default() };
            let mut apg = Apg::new("Track", &env, config, 1, Threads::new(1).unwrap()).unwrap();
            apg.update().unwrap();
            let (mut lost, mut late) = (0, 0);
            for (t, step) in apg.run.workers[0].window.steps.iter().enumerate() {
                for (i, weight) in step.weight.iter().enumerate() {
                    let ended = step.terminated[i] == 1;
                    let on = if ended && objective == TrainingObjective::Loss { 12 - t } else { 1 };
                    assert_eq!(*weight, on as f32 * (1.0 / 288.0), "step {t}");
                    (lost, late) = (lost + u32::from(ended), late + u32::from(step.truncated[i]));
                }
            }
            assert!(lost > 2 && late > 2, "{lost} lost, {late} late");
        }
    }
}
