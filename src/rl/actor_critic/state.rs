//! How a run of SAC or TD3 is made, kept and gone on with.

use super::batch::Shapes;
use super::{ActorCritic, ActorCriticConfig, Exploration, Kind, VALUE_BETA};
use crate::checkpoint::Tensors;
use crate::experience::Experience;
use crate::learner::{Algorithm, Learner, Make, Progress, Update};
use crate::nn::Network;
use crate::nn::fold::fold;
use crate::policy::Policy;
use crate::shards::{shards_if, within_memory};
use crate::state;
use crate::target_network::NetWithTarget;
use crate::value_norm::ValueNorm;
use crate::warm_start::WarmStart;
use base::error::{Error, Result};
use base::parallel::Threads;
use rng::{Purpose, Stream};
use tasks::{EnvConfig, Space, Spec};

impl<E: Exploration> ActorCritic<E> {
    /// A run from random weights; `make` builds each shard's environments from its configuration.
    ///
    /// # Errors
    /// As [`ActorCriticConfig::validate`] and `make`; [`Error::Value`] for actions that are not continuous; [`Error::Limit`] for
    /// what does not fit into [`EnvConfig::memory_limit`].
    pub fn with(
        make: &Make<'_>,
        env: &EnvConfig,
        config: ActorCriticConfig<E>,
        seed: u64,
        threads: Threads,
    ) -> Result<Self> {
        config.validate()?;
        let env = EnvConfig { n_env: config.n_env, seed, ..config.seen(env) };
        Experience::check(&env)?;
        let shards = shards_if(make, &env, config.shard, |first, n| {
            check_continuous(first.spec())?;
            config.replay.fits(first.spec(), n, config.central_critic)
        })?;
        let spec = shards[0].env.spec().clone();
        let done = (0..spec.n_agent).map(|agent| spec.n_action_of(agent) as f64).sum::<f64>();
        let kind = config.exploration.kind(done / spec.n_agent as f64);
        check_few(&spec, kind.most_action())?;
        let shapes = Shapes::new(&config, &kind, &spec)?;
        let widths = shapes.widths;
        within_memory("batch", config.batch, shapes.bytes(), env.memory_limit)?;
        let stream = |network| Stream::new(seed, 0, network, Purpose::LEARNING);
        let critic = |k| NetWithTarget::new(&shapes.critic, config.adam, true, &mut stream(1 + k));
        let actor = NetWithTarget::new(&shapes.actor, config.adam, kind.has_target_actor(), &mut stream(0));
        Ok(Self {
            mean: actor.parameters.clone(),
            mean_from: 0,
            actor,
            critics: (0..config.critics as u64).map(critic).collect(),
            experience: Experience::new(shards, &shapes.actor, (&config.replay, config.discount), widths)?,
            value_norm: ValueNorm::new(VALUE_BETA)?,
            work: shapes.work(config.central_critic),
            flown: Algorithm::actor(&config, &spec)?,
            shapes,
            kind,
            config,
            threads,
            update: 0,
            env_steps: 0,
            step: 0,
        })
    }

    /// The weights of what flies: of outputs it has those that are the action.
    pub(super) fn flown_parameters(&self) -> Result<Vec<f32>> {
        let Self { shapes: Shapes { of_set, .. }, flown, .. } = self;
        let mut parameters = Vec::with_capacity(flown.n_parameter());
        for (k, own) in self.mean.chunks_exact(of_set.n_parameter()).enumerate() {
            parameters.extend(fold((&**of_set, own), &*flown.mlp, |k| vec![(k, 1.0)])?);
            parameters.resize((k + 1) * flown.n_parameter_of_set(), 0.0);
        }
        Ok(parameters)
    }
}

fn check_few(spec: &Spec, most: usize) -> Result<()> {
    if spec.action.len() <= most {
        return Ok(());
    }
    let remedy = "Learn with td3 or ppo.";
    Err(Error::limit("numbers of an action", spec.action.len(), most, remedy))
}

fn check_continuous(spec: &Spec) -> Result<()> {
    if matches!(spec.action, Space::Box { .. }) {
        return Ok(());
    }
    let remedy = "Leave the stages that make actions discrete out, or learn with dqn or ppo.";
    Err(Error::value("actions", "whole numbers", "continuous ones for this algorithm", remedy))
}

impl<E: Exploration> Learner for ActorCritic<E> {
    fn update(&mut self) -> Result<Update> {
        Self::update(self)
    }

    fn progress(&self) -> Progress {
        Progress { update: self.update, budget: self.config.updates, env_steps: self.env_steps }
    }

    fn set_difficulty(&mut self, share: f64) -> Result<()> {
        self.experience.set_difficulty(share)
    }

    fn warm_start(&mut self, start: &WarmStart) -> Result<()> {
        start.check(&self.flown)?;
        let Self { shapes: Shapes { actor, of_set, .. }, flown, .. } = self;
        let sets = self.actor.parameters.chunks_exact(of_set.n_parameter());
        let begun = sets.zip(start.parameters.chunks_exact(flown.mlp.n_parameter())).map(|(random, start)| {
            let (known, mut own) = (flown.mlp.parts(start), of_set.parts(random));
            // outputs beyond those that fly keep their first weights
            for (to, from) in own.iter_mut().zip(&known) {
                let n = from.data.len().min(to.data.len());
                to.data[..n].copy_from_slice(&from.data[..n]);
            }
            let mut own = own.into_iter();
            of_set.from_parts(&mut |_, _| Ok(own.next().map_or(Vec::new(), |part| part.data)))
        });
        let parameters = begun.collect::<Result<Vec<_>>>()?.concat();
        self.mean.clone_from(&parameters);
        self.actor.begin(actor, parameters);
        start.statistics.as_ref().map_or(Ok(()), |known| self.experience.begin_statistics(known))
    }

    fn policy(&self) -> Result<Policy> {
        Policy::of(&self.flown, &self.flown_parameters()?, self.experience.env())
    }

    fn kept_bytes(&self) -> u64 {
        self.experience.saved_bytes()
    }

    fn save(&self, policy: &mut Tensors, out: &mut Tensors) -> Result<()> {
        state::put_actor(policy, &self.flown, &self.flown_parameters()?)?;
        self.actor.save(out, "learner", &self.shapes.actor)?;
        state::put_network(out, "mean", &self.shapes.actor, &self.mean)?;
        out.insert("mean.from", &[1], vec![self.mean_from])?;
        for (k, critic) in self.critics.iter().enumerate() {
            critic.save(out, &format!("critic.{k}"), &self.shapes.critic)?;
        }
        state::put_counters(out, [self.update, self.env_steps, self.step])?;
        state::put_value_norm(out, &self.value_norm)?;
        let own = self.kind.save();
        out.insert("kind", &[own.len()], own)?;
        self.experience.save(out)
    }

    fn load(&mut self, _: &Tensors, from: &Tensors) -> Result<()> {
        let [update, env_steps, step] = state::counters(from)?;
        self.actor.load(from, "learner", &self.shapes.actor)?;
        self.mean = state::network(from, "mean", &self.shapes.actor)?;
        for (k, critic) in self.critics.iter_mut().enumerate() {
            critic.load(from, &format!("critic.{k}"), &self.shapes.critic)?;
        }
        self.kind.load(from.get::<f64>("kind", &[self.kind.save().len()])?)?;
        state::load_value_norm(from, &mut self.value_norm)?;
        self.experience.load(from)?;
        (self.update, self.env_steps, self.step) = (update, env_steps, step);
        self.mean_from = from.get::<u64>("mean.from", &[1])?[0].min(step);
        Ok(())
    }
}
