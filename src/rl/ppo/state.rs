//! How a run of PPO is made, kept and gone on with.

use super::{ActorOptimiser, Ppo, PpoConfig, Ratios, SequenceMinibatch, Team};
use crate::checkpoint::Tensors;
use crate::critic::Critic;
use crate::input_scale::InputScale;
use crate::learner::{Learner, Make, Progress, Update};
use crate::minibatch::Minibatch;
use crate::nn::gaussian::Gaussians;
use crate::nn::{Adam, Recurrence, Transposed};
use crate::policy::Policy;
use crate::rollout::{Collector, CriticSees, RolloutBatch, RolloutShape};
use crate::sequences::{Sequences, sequences};
use crate::shards::{begin_statistics, set_difficulty, shards_if};
use crate::state;
use crate::value_norm::ValueNorm;
use crate::warm_start::WarmStart;
use base::error::Result;
use base::parallel::Threads;
use rng::{Purpose, Stream};
use tasks::{Env, EnvConfig, Spec};

impl Ppo {
    /// A run from random weights on a task with this configuration; its `n_env` is [`PpoConfig::n_env`].
    ///
    /// # Errors
    /// As [`PpoConfig::validate`] and [`Env::make`]; [`Error::Limit`](base::error::Error::Limit) for rollouts beyond
    /// [`EnvConfig::memory_limit`].
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
        let shape = |spec: &Spec| RolloutShape::new(spec, config.steps, sees).remembering(n_state);
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
        let rows_of = |rows: usize| (config.n_env * config.steps * rows).div_ceil(config.minibatches);
        let critic_rows = (rows_of(shape.n_value), env.memory_limit);
        let mut critic = Critic::new(shape.n_critic(), &config.critic, config.adam, critic_rows, &mut stream(1))?;
        let scales = config.normalise_observation && shape.n_central > 0;
        critic.inputs = scales.then(|| InputScale::new(shape.n_critic()));
        let sequences = config.network.memory.as_ref().map(|memory| {
            let n_env = shards.iter().map(|shard| shard.env.spec().n_env);
            let all = sequences(shape, n_env, memory.window());
            let size = (all.len().div_ceil(config.minibatches), memory.window().min(config.steps));
            let (n_head, n_extra) = (actor.head.n_output(), actor.head.n_extra());
            let minibatch = Sequences::new(&*actor.mlp, n_head, n_extra, size, env.memory_limit)?;
            let (places, chosen) = ((0..all.len() as u32).collect(), Vec::with_capacity(size.0));
            Ok(SequenceMinibatch { all, places, chosen, minibatch })
        });
        let sequences: Option<SequenceMinibatch> = sequences.transpose()?;
        let rows = if sequences.is_some() { 0 } else { rows_of(shape.n_agent / n_set) };
        let mut ppo = Self {
            optimisers: (0..n_set)
                .map(|k| ActorOptimiser {
                    transposed: Transposed::default(),
                    adam: Adam::new(config.adam, n_of_set),
                    gaussians: Gaussians::of(actor.head_of(k)),
                    rate_scale: 1.0,
                })
                .collect(),
            ratios: (config.team == Team::Sequential && n_set > 1).then(Ratios::default),
            minibatch: Minibatch::new(&*actor.mlp, actor.head.n_extra(), rows, env.memory_limit)?,
            sequences,
            value_norm: ValueNorm::new(config.value_beta)?,
            collectors: shards.into_iter().map(|shard| Collector::new(shard, &actor, &critic)).collect(),
            rollout: RolloutBatch::new(shape, config.n_env),
            update: 0,
            env_steps: 0,
            actor_rows: Vec::new(),
            critic_rows: Vec::new(),
            order: Default::default(),
            targets: Vec::new(),
            advantage: Vec::new(),
            set_order: (0..n_set as u32).collect(),
            set_rows: Vec::new(),
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
        for (k, optimiser) in self.optimisers.iter_mut().enumerate() {
            self.actor.mlp.transpose(self.actor.set(&self.parameters, k).0, &mut optimiser.transposed);
        }
    }

    /// Of a shard: its `config` is the one that evaluations take, normaliser and all.
    pub fn spec(&self) -> &Spec {
        &self.spec
    }
}

impl Learner for Ppo {
    fn update(&mut self) -> Result<Update> {
        Self::update(self)
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
        for (k, optimiser) in self.optimisers.iter().enumerate() {
            state::put_adam(out, &self.actor.set_name(k), &optimiser.adam)?;
        }
        self.critic.save(out)?;
        state::put_counters(out, [self.update, self.env_steps])?;
        state::put_value_norm(out, &self.value_norm)?;
        let scales = self.optimisers.iter().map(|optimiser| optimiser.rate_scale).collect();
        out.insert("rate_scale", &[self.optimisers.len()], scales)?;
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
        state::load_value_norm(from, &mut self.value_norm)?;
        self.critic.load(from)?;
        state::load_recalls(from, self.collectors.iter_mut().map(|c| &mut c.recall))?;
        state::load_shards(from, self.collectors.iter_mut().map(|c| &mut c.shard))?;
        for (optimiser, (adam, scale)) in self.optimisers.iter_mut().zip(adam.into_iter().zip(scales)) {
            (optimiser.adam, optimiser.rate_scale) = (adam, scale);
        }
        (self.parameters, self.update, self.env_steps) = (parameters, update, env_steps);
        self.transpose();
        Ok(())
    }
}
