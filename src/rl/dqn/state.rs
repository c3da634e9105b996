//! How a run of DQN is made, kept and gone on with.

use super::batch::Shapes;
use super::values::Values;
use super::{Dqn, DqnConfig, VALUE_BETA, ValueMixer};
use crate::checkpoint::Tensors;
use crate::experience::Experience;
use crate::learner::{Learner, Make, Progress, Update};
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
use tasks::EnvConfig;

impl Dqn {
    /// A run from random weights; `make` builds each shard's environments from its configuration.
    ///
    /// # Errors
    /// As [`DqnConfig::validate`] and `make`; [`Error::Value`] for continuous actions; [`Error::Limit`] for what does not fit into
    /// [`EnvConfig::memory_limit`].
    pub fn with(make: &Make<'_>, env: &EnvConfig, config: DqnConfig, seed: u64, threads: Threads) -> Result<Self> {
        config.validate()?;
        let env = EnvConfig { n_env: config.n_env, seed, ..config.seen(env) };
        Experience::check(&env)?;
        let team = config.mixer != ValueMixer::None;
        let shards = shards_if(make, &env, config.shard, |first, n| {
            Values::of(first.spec(), &config)?;
            config.replay.fits(first.spec(), n, team)
        })?;
        let spec = shards[0].env.spec().clone();
        let shapes = Shapes::new(&spec, &config)?;
        within_memory("batch", config.batch, shapes.bytes(), env.memory_limit)?;
        let stream = |network| Stream::new(seed, 0, network, Purpose::LEARNING);
        let mixer = shapes.mixing.as_ref().and_then(|mixing| mixing.weights.as_ref());
        Ok(Self {
            net: NetWithTarget::new(&shapes.network, config.adam, true, &mut stream(0)),
            mixer: mixer.map(|mlp| NetWithTarget::new(mlp, config.adam, true, &mut stream(1))),
            experience: Experience::new(shards, &shapes.network, (&config.replay, config.discount), shapes.widths)?,
            value_norm: ValueNorm::new(VALUE_BETA)?,
            work: shapes.work(team),
            flown: config.actor(&spec)?,
            shapes,
            config,
            threads,
            update: 0,
            env_steps: 0,
            step: 0,
        })
    }

    /// The weights of what flies, those that follow slowly: one output per action, its value.
    pub(super) fn flown_parameters(&self) -> Result<Vec<f32>> {
        let values = self.shapes.values;
        let share = 1.0 / values.quantiles as f32;
        let of_set = &*self.shapes.of_set;
        let folded = self.net.following.chunks_exact(of_set.n_parameter()).map(|own| {
            fold((of_set, own), &*self.flown.mlp, |k| {
                let all = (0..values.quantiles).flat_map(|q| values.parts(k / values.levels, k % values.levels, q));
                all.map(|(j, w)| (j, share * w)).collect()
            })
        });
        Ok(folded.collect::<Result<Vec<_>>>()?.concat())
    }
}

impl Learner for Dqn {
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
        if self.shapes.values.n_output() != self.flown.mlp.n_output() {
            let remedy = "Leave duelling and quantiles out, or begin from random weights.";
            return Err(Error::value("from", "a policy", "random weights for values in parts", remedy));
        }
        self.net.begin(&self.shapes.network, start.parameters.clone());
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
        self.net.save(out, "learner", &self.shapes.network)?;
        if let (Some(net), Some(mlp)) = (&self.mixer, self.shapes.mixer()) {
            net.save(out, "mixer", mlp)?;
        }
        state::put_counters(out, [self.update, self.env_steps, self.step])?;
        state::put_value_norm(out, &self.value_norm)?;
        self.experience.save(out)
    }

    fn load(&mut self, _: &Tensors, from: &Tensors) -> Result<()> {
        let [update, env_steps, step] = state::counters(from)?;
        self.net.load(from, "learner", &self.shapes.network)?;
        if let (Some(net), Some(mlp)) = (&mut self.mixer, self.shapes.mixer()) {
            net.load(from, "mixer", mlp)?;
        }
        state::load_value_norm(from, &mut self.value_norm)?;
        self.experience.load(from)?;
        (self.update, self.env_steps, self.step) = (update, env_steps, step);
        Ok(())
    }
}
