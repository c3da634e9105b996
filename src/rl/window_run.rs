//! An actor and the windows that it flies, from update to update: what runs of APG and SHAC share.

use super::checkpoint::Tensors;
use super::learner::{Make, Progress};
use super::nn::{AdamConfig, Layers};
use super::policy::{Actor, Policy};
use super::policy_optimiser::PolicyOptimiser;
use super::shards::{Shard, begin_statistics, normalise, set_difficulty, shards_if};
use super::state;
use super::warm_start::WarmStart;
use super::window::{TrainingObjective, Window, WindowStats, check_windows, gather, windows};
use base::error::{Error, Result};
use base::parallel::Threads;
use tasks::{EnvConfig, SweepOptions};

/// Settings that both have.
pub(super) struct WindowSettings<'a> {
    pub n_env: usize,
    pub shard: usize,
    pub horizon: usize,
    pub objective: TrainingObjective,
    pub decay: f32,
    pub adjoint_clip: f32,
    pub action_clip: f32,
    pub adam: AdamConfig,
    pub network: &'a Layers,
}

impl WindowSettings<'_> {
    /// Weight of a step in the loss: the mean over all environments and steps of the window.
    pub fn loss_scale(&self) -> f32 {
        (1.0 / (self.n_env * self.horizon) as f64) as f32
    }
}

/// The run; `X` is what an algorithm keeps beside each window.
pub(super) struct WindowRun<X> {
    pub optimiser: PolicyOptimiser,
    pub workers: Vec<Worker<X>>,
    pub threads: Threads,
    pub update: u64,
    pub env_steps: u64,
}

/// A shard's window, and what went wrong in it.
pub(super) struct Worker<X> {
    pub window: Window,
    pub beside: X,
    failed: Option<Error>,
}

impl WindowRun<()> {
    /// From random weights.
    ///
    /// # Errors
    /// As `make`, [`Actor::new`] and [`windows`].
    pub fn new(
        make: &Make<'_>,
        env: &EnvConfig,
        settings: &WindowSettings<'_>,
        (seed, threads): (u64, Threads),
    ) -> Result<Self> {
        let env = EnvConfig { n_env: settings.n_env, seed, ..env.clone() };
        let shards = shards_if(make, &env, settings.shard, |first, n| {
            check_windows(first, n, &Actor::new(first.spec(), settings.network, true)?, settings.horizon)
        })?;
        let actor = Actor::new(shards[0].env.spec(), settings.network, true)?;
        let loss_scale = settings.loss_scale();
        let options = SweepOptions { decay: settings.decay, clip: settings.adjoint_clip * loss_scale };
        let windows = windows(shards, &actor, settings.horizon, settings.objective, options)?;
        let worker = |mut window: Window| {
            window.action_clip = settings.action_clip * loss_scale;
            Worker { window, beside: (), failed: None }
        };
        let workers = windows.into_iter().map(worker).collect();
        let optimiser = PolicyOptimiser::new(actor, settings.adam, seed);
        Ok(Self { optimiser, workers, threads, update: 0, env_steps: 0 })
    }

    /// With something beside each window.
    pub fn beside<X>(self, mut make: impl FnMut(&mut Window) -> X) -> WindowRun<X> {
        let Self { optimiser, workers, threads, update, env_steps } = self;
        let worker = |mut own: Worker<()>| Worker { beside: make(&mut own.window), window: own.window, failed: None };
        WindowRun { optimiser, workers: workers.into_iter().map(worker).collect(), threads, update, env_steps }
    }
}

impl<X: Send> WindowRun<X> {
    /// ∂L/∂θ over the windows of all shards, into the optimiser: `each` flies one and sweeps back over it.
    ///
    /// # Errors
    /// The first that a window met.
    pub fn gradient(
        &mut self,
        each: impl Fn(&PolicyOptimiser, &mut Window, &mut X) -> Result<()> + Sync,
    ) -> Result<WindowStats> {
        let optimiser = &self.optimiser;
        self.threads.for_each(&mut self.workers, |_, worker| {
            worker.failed = each(optimiser, &mut worker.window, &mut worker.beside).err();
        });
        let flown = self.workers.iter_mut().map(|worker| (&worker.window, worker.failed.take()));
        gather(flown, &mut self.optimiser.gradient)
    }

    /// Takes what was seen into the scales of observations, counts the update of `n_step` steps, and begins again if the network
    /// is saturated. Gives whether it did.
    ///
    /// # Errors
    /// As [`normalise`].
    pub fn finish_update(&mut self, n_step: u64, saturated: f64, limit: f64) -> Result<bool> {
        normalise(&mut self.shards_mut().collect::<Vec<_>>())?;
        self.update += 1;
        self.env_steps += n_step;
        let restarts = self.optimiser.restart_if_saturated(saturated, limit);
        if restarts {
            self.update = 0;
        }
        Ok(restarts)
    }

    fn shards_mut(&mut self) -> impl Iterator<Item = &mut Shard> {
        self.workers.iter_mut().map(|worker| &mut worker.window.shard)
    }

    pub fn progress(&self, budget: u64) -> Progress {
        Progress { update: self.update, budget, env_steps: self.env_steps }
    }

    pub fn set_difficulty(&mut self, share: f64) -> Result<()> {
        set_difficulty(self.shards_mut(), share)
    }

    pub fn warm_start(&mut self, start: &WarmStart) -> Result<()> {
        self.optimiser.warm_start(start)?;
        begin_statistics(self.shards_mut(), start.statistics.as_ref())
    }

    pub fn policy(&self) -> Result<Policy> {
        self.optimiser.policy(&self.workers[0].window.shard.env)
    }

    pub fn save(&self, policy: &mut Tensors, out: &mut Tensors) -> Result<()> {
        self.optimiser.save(policy, out)?;
        state::put_counters(out, [self.update, self.env_steps, self.optimiser.restarts])?;
        state::put_shards(out, self.workers.iter().map(|worker| &worker.window.shard))
    }

    pub fn load(&mut self, policy: &Tensors, from: &Tensors) -> Result<()> {
        let [update, env_steps, restarts] = state::counters(from)?;
        self.optimiser.load(policy, from, restarts)?;
        state::load_shards(from, self.shards_mut())?;
        (self.update, self.env_steps) = (update, env_steps);
        Ok(())
    }
}
