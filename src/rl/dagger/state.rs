//! How a run of DAgger is made, kept and gone on with.

use super::student::Student;
use super::teacher::Teacher;
use super::{Dagger, DaggerConfig, Worker};
use crate::checkpoint::Tensors;
use crate::learner::{Episodes, Learner, Make, Progress, Update};
use crate::minibatch::Minibatch;
use crate::policy::{Actor, Policy, ROWS};
use crate::policy_optimiser::PolicyOptimiser;
use crate::shards::{Shard, begin_statistics, set_difficulty, shards_if, within_memory};
use crate::state;
use crate::warm_start::WarmStart;
use base::error::{Error, Result};
use base::parallel::Threads;
use tasks::{EnvConfig, Spec};

impl Dagger {
    /// A run from random weights; `make` builds each shard's environments from its configuration.
    ///
    /// # Errors
    /// As [`DaggerConfig::validate`], [`Baseline::new`](tasks::Baseline::new) and `make`; as
    /// [`load_policy`](crate::load_policy) and [`Policy::fits`] for a teacher that is
    /// a run's; [`Error::Limit`] for rows beyond [`EnvConfig::memory_limit`].
    pub fn with(make: &Make<'_>, env: &EnvConfig, config: DaggerConfig, seed: u64, threads: Threads) -> Result<Self> {
        config.validate()?;
        let env = EnvConfig { n_env: config.n_env, seed, easier: env.easier, ..env.clone().whole_episodes() };
        let rows = |spec: &Spec| config.n_env as u128 * spec.n_agent as u128 * config.steps as u128;
        let shards = shards_if(make, &env, config.shard, |first, _| {
            let spec = first.spec();
            let student = Student::new(&Actor::new(spec, &config.network, true)?, config.imitate)?;
            let each = (student.columns.len() + student.network.n_output()) as u128;
            within_memory("rows of an update", rows(spec), 4 * rows(spec) * each, env.memory_limit)
        })?;
        let spec = shards[0].env.spec().clone();
        let actor = Actor::new(&spec, &config.network, true)?.for_team(&spec, false)?;
        let student = Student::new(&actor, config.imitate)?;
        let rows = rows(&spec) as usize;
        let batch = Minibatch::new(&student.network, 0, rows.div_ceil(config.minibatches), env.memory_limit)?;
        let workers = shards.into_iter().map(|shard| Worker::new(shard, &actor, &config, make));
        Ok(Self {
            workers: workers.collect::<Result<_>>()?,
            observation: vec![0.0; rows * student.columns.len()],
            label: vec![0.0; rows * student.network.n_output()],
            student,
            order: Vec::new(),
            optimiser: PolicyOptimiser::new(actor, config.adam, seed),
            batch,
            config,
            threads,
            seed,
            update: 0,
            env_steps: 0,
        })
    }
}

impl Worker {
    fn new(shard: Shard, actor: &Actor, config: &DaggerConfig, make: &Make<'_>) -> Result<Self> {
        let spec = shard.env.spec();
        let n_action = spec.n_env * spec.n_agent * spec.action.len();
        Ok(Self {
            teacher: Teacher::new(&shard, config, make)?,
            memory: actor.mlp.memory(ROWS),
            seen: shard.out.observation.clone(),
            actions: vec![0.0; n_action],
            taught: vec![0.0; n_action],
            masked: Vec::new(),
            reward: 0.0,
            episodes: Episodes::default(),
            failed: None,
            shard,
        })
    }
}

/// Name of a shard's environments as the teacher sees them, in a checkpoint.
fn twin(shard: usize) -> String {
    format!("teacher.{shard}.environments")
}

impl Learner for Dagger {
    fn update(&mut self) -> Result<Update> {
        Self::update(self)
    }

    fn progress(&self) -> Progress {
        Progress { update: self.update, budget: self.config.updates, env_steps: self.env_steps }
    }

    fn set_difficulty(&mut self, share: f64) -> Result<()> {
        for worker in &mut self.workers {
            if let Some(twin) = worker.teacher.twin_mut() {
                twin.set_difficulty(share)?;
            }
        }
        set_difficulty(self.workers.iter_mut().map(|worker| &mut worker.shard), share)
    }

    fn warm_start(&mut self, start: &WarmStart) -> Result<()> {
        self.optimiser.warm_start(start)?;
        begin_statistics(self.workers.iter_mut().map(|worker| &mut worker.shard), start.statistics.as_ref())
    }

    fn teach(&mut self, teacher: Policy, of: &Spec, make: &Make<'_>) -> Result<()> {
        let (actor, spec) = (&self.optimiser.actor, self.workers[0].shard.env.spec());
        self.warm_start(&WarmStart::but_for_the_last_encoder(
            &teacher,
            of,
            actor,
            self.optimiser.net().parameters,
            spec,
        )?)?;
        for worker in &mut self.workers {
            worker.teacher = Teacher::of_latent(teacher.clone(), of, &worker.shard, make)?;
        }
        Ok(())
    }

    fn policy(&self) -> Result<Policy> {
        self.optimiser.policy(&self.workers[0].shard.env)
    }

    fn save(&self, policy: &mut Tensors, out: &mut Tensors) -> Result<()> {
        self.optimiser.save(policy, out)?;
        state::put_counters(out, [self.update, self.env_steps])?;
        for (k, worker) in self.workers.iter().enumerate() {
            if let Some(own) = worker.teacher.twin() {
                let bytes = own.save();
                out.insert(twin(k), &[bytes.len()], bytes)?;
            }
        }
        state::put_shards(out, self.workers.iter().map(|worker| &worker.shard))
    }

    fn load(&mut self, policy: &Tensors, from: &Tensors) -> Result<()> {
        let [update, env_steps] = state::counters(from)?;
        if self.workers[0].teacher.teaches_latent() && !self.optimiser.begins_as(from)? {
            let remedy = "Put it back as it was, or begin a run in another folder.";
            return Err(Error::value("teacher of the run", "another one", "the one that it was begun with", remedy));
        }
        self.optimiser.load(policy, from, 0)?;
        state::load_shards(from, self.workers.iter_mut().map(|worker| &mut worker.shard))?;
        for (k, worker) in self.workers.iter_mut().enumerate() {
            if let Some(own) = worker.teacher.twin_mut() {
                let n = from.tensor(&twin(k))?.shape().iter().product();
                own.load(from.get::<u8>(&twin(k), &[n])?)?;
            }
        }
        (self.update, self.env_steps) = (update, env_steps);
        Ok(())
    }
}
