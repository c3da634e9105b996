//! DQN: values of discrete actions from kept experience (Mnih et al. 2015), with what has been found since: double
//! (van Hasselt et al. 2016), duelling (Wang et al. 2016), distributional by quantiles (Dabney et al. 2018), by priorities
//! (Schaul et al. 2016), and for teams VDN (Sunehag et al. 2018) and QMIX (Rashid et al. 2018).
//!
//! Where an action has several numbers of a few values each (`multi_discrete`), every number has values of its own, and the
//! value of an action is their mean (branching, Tavakoli et al. 2018): as many outputs as levels times numbers, not to their
//! power.
//!
//! Values are in a running unit of their targets, and say the same when it changes (PopArt, van Hasselt et al. 2016).
//!
//! What flies is the network folded to one output per action, Q, so that its greatest is the action.

mod config;
mod mixing;

pub use config::{DqnConfig, Mixer};

use super::checkpoint::Tensors;
use super::experience::{Block, Experience, Explore, Streams};
use super::learner::{Learner, Make, Progress, Update, built_in, share_done};
use super::nn::fold::fold;
use super::nn::{Activation, Memory, Mlp, Network, Output, Pass, PerAgent, Scratch};
use super::policy::{Actor, Policy, ROWS, network};
use super::replay::Widths;
use super::shards::{shards_if, within_memory};
use super::state;
use super::target_network::{NetWithTarget, Stride};
use super::value_loss::{Huber, judge};
use super::value_norm::{Unit, ValueNorm};
use super::warm_start::WarmStart;
use base::error::{Error, Result};
use base::parallel::Threads;
use mixing::Mixing;
use rng::{Purpose, Stream};
use std::sync::Arc;
use std::time::Instant;
use tasks::{EnvConfig, Space, Spec};

/// How a network's outputs make values: `branches` numbers of an action with `levels` values each.
#[derive(Debug, Clone, Copy)]
struct Values {
    branches: usize,
    levels: usize,
    quantiles: usize,
    duelling: bool,
}

impl Values {
    fn of(spec: &Spec, config: &DqnConfig) -> Result<Self> {
        let (branches, levels) = match spec.action {
            Space::Discrete { n } => (1, n),
            Space::MultiDiscrete { n, levels } => (n, levels),
            Space::Box { .. } => {
                let remedy = "Set env.actions to discrete or multi_discrete, or learn with sac or td3.";
                return Err(Error::value("actions", "continuous", "whole numbers for this algorithm", remedy));
            }
        };
        Ok(Self { branches, levels, quantiles: config.quantiles, duelling: config.duelling })
    }

    /// Numbers of an action's values.
    fn n_action(&self) -> usize {
        self.branches * self.levels
    }

    /// Outputs of the network: `[branch, level, quantile]`, then `[quantile]` of the state.
    fn n_output(&self) -> usize {
        (self.n_action() + usize::from(self.duelling)) * self.quantiles
    }

    /// Outputs, with their weights, whose sum is quantile `q` of the value of `level` in `branch`.
    fn parts(&self, branch: usize, level: usize, q: usize) -> impl Iterator<Item = (usize, f32)> {
        let own = *self;
        let at = move |level: usize| (branch * own.levels + level) * own.quantiles + q;
        let mean = if own.duelling { 1.0 / own.levels as f32 } else { 0.0 };
        let others = (0..own.levels).filter(move |_| own.duelling).map(move |level| (at(level), -mean));
        let state = own.duelling.then_some((own.n_action() * own.quantiles + q, 1.0));
        [(at(level), 1.0)].into_iter().chain(others).chain(state)
    }

    fn quantile(&self, output: &[f32], branch: usize, level: usize, q: usize) -> f32 {
        self.parts(branch, level, q).map(|(k, w)| w * output[k]).sum()
    }

    /// The mean over quantiles.
    fn value(&self, output: &[f32], branch: usize, level: usize) -> f32 {
        let all: f32 = (0..self.quantiles).map(|q| self.quantile(output, branch, level, q)).sum();
        all / self.quantiles as f32
    }

    /// The level of the greatest value, the first of several.
    fn best(&self, output: &[f32], branch: usize) -> usize {
        let mut best = (0, f32::NEG_INFINITY);
        for level in 0..self.levels {
            // what the state adds is the same for all
            let own = &output[(branch * self.levels + level) * self.quantiles..][..self.quantiles];
            let sum: f32 = own.iter().sum();
            if sum > best.1 {
                best = (level, sum);
            }
        }
        best.0
    }

    /// Adds `up` · ∂(quantile `q` of `level` in `branch`)/∂output.
    fn pull(&self, (branch, level, q): (usize, usize, usize), up: f32, grad_output: &mut [f32]) {
        self.parts(branch, level, q).for_each(|(k, w)| grad_output[k] += up * w);
    }
}

/// Shapes of the networks.
struct Shapes {
    values: Values,
    /// Of all agents, row by row.
    network: Arc<dyn Network>,
    /// That of one set of parameters.
    of_set: Arc<dyn Network>,
    /// Numbers of the action of each agent of a row; those behind them move nothing.
    branches: Vec<usize>,
    mixing: Option<Mixing>,
    agents: usize,
    widths: Widths,
    batch: usize,
}

/// A block of the batch and all that one thread needs to learn from it.
struct Work {
    block: Block,
    /// Of the learnt network and of its target.
    memory: [Memory; 2],
    scratch: Scratch,
    of_mixer: Option<(Memory, Scratch)>,
    /// Target quantiles `[rows, agents, quantiles]`, or one value of the team.
    target: Vec<f32>,
    /// The best level of every number of every agent's next action.
    best: Vec<usize>,
    grad_output: Vec<f32>,
    /// Each agent's value and its slope; what the mixer's network is to learn.
    q: Vec<f32>,
    grad_q: Vec<f32>,
    grad_weights: Vec<f32>,
    gradient: Vec<f32>,
    mixer_gradient: Vec<f32>,
    /// Σ of losses and of values.
    sums: [f64; 2],
}

/// What an update leaves of the statistics of the targets.
const VALUE_BETA: f64 = 0.98;

built_in! {
    "dqn": DqnConfig => Dqn, squashed: false, loss: "error of the values", in: "dqn/config.rs", actor: DqnConfig::actor;

    fn seen(&self, env: &EnvConfig) -> EnvConfig {
        DqnConfig::seen(self, env)
    }
}

/// Deep Q-learning, in the middle of a run.
pub struct Dqn {
    config: DqnConfig,
    shapes: Shapes,
    net: NetWithTarget,
    mixer: Option<NetWithTarget>,
    norm: ValueNorm,
    experience: Experience,
    work: Vec<Work>,
    /// What flies.
    flown: Actor,
    threads: Threads,
    update: u64,
    env_steps: u64,
    step: u64,
}

/// The greatest value, but for a share of actions that are drawn evenly.
struct Greedy<'a> {
    shapes: &'a Shapes,
    parameters: &'a [f32],
    epsilon: f64,
}

impl Explore for Greedy<'_> {
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
        let team = config.mixer != Mixer::None;
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
            norm: ValueNorm::new(VALUE_BETA)?,
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

    fn improve(&mut self) -> [f64; 4] {
        let progress = share_done(self.update, self.config.updates);
        let Self { shapes, net, mixer, experience, config, step, norm, .. } = self;
        let unit = norm.unit();
        self.threads.for_each(&mut self.work, |number, work| {
            experience.gather(&mut work.block, (*step, number), progress);
            work.value_next(shapes, (net, mixer.as_ref()), config.double, unit);
            work.judge(shapes, (net, mixer.as_ref()), config.huber as f32);
        });
        let stride = Stride { clip: config.max_grad_norm, rate: config.learning_rate.at(progress), tau: config.tau };
        net.descend(&shapes.network, self.work.iter().map(|own| &own.gradient[..]), stride);
        if let (Some(mixer), Some(mlp)) = (mixer, shapes.mixing.as_ref().and_then(|mixing| mixing.weights.as_ref())) {
            mixer.descend(mlp, self.work.iter().map(|own| &own.mixer_gradient[..]), stride);
        }
        experience.rank(self.work.iter().map(|work| &work.block));
        *step += 1;
        let sum = |k: usize| self.work.iter().map(|own| own.sums[k]).sum::<f64>();
        let left_out: usize = self.work.iter().map(|own| own.block.left_out).sum();
        [sum(0), sum(1), net.gradient_norm, left_out as f64]
    }

    /// Takes the last targets into the unit, in which values then say the same: those that agents add up to a team's each by its
    /// share, mixed ones by what mixes them.
    fn measure(&mut self) -> Result<()> {
        let Self { shapes, net, mixer, norm, work, .. } = self;
        let values = shapes.values;
        let n = if shapes.mixing.is_some() { 1 } else { values.quantiles };
        let targets = work.iter().flat_map(|work| work.block.counting(&work.target, n));
        let (factor, shift) = norm.move_unit(targets);
        if let (Some(mixer), Some(mixing), Some(mlp)) = (mixer, &shapes.mixing, shapes.mixer()) {
            return mixer.rescale(mlp, |k| mixing.moved(k, (factor, shift)));
        }
        let (of_state, share) = (values.n_action() * values.quantiles, shift / shapes.agents as f32);
        // what the state adds takes the shift where it stands apart
        let moved = |k: usize| if values.duelling && k < of_state { (factor, 0.0) } else { (factor, share) };
        net.rescale(&shapes.network, moved)
    }

    /// The weights of what flies, those that follow slowly: one output per action, its value.
    fn flown_parameters(&self) -> Result<Vec<f32>> {
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

impl Shapes {
    fn new(spec: &Spec, config: &DqnConfig) -> Result<Self> {
        let (values, team) = (Values::of(spec, config)?, config.mixer != Mixer::None);
        let widths = Widths::of(spec, team);
        let agents = if team { widths.n_agent } else { 1 };
        let n_state = if widths.n_state > 0 { widths.n_state } else { widths.seen() };
        let of_set = network(spec, &config.network, values.n_output(), Activation::Identity)?;
        Ok(Self {
            network: PerAgent::of_team(&of_set, agents, config.separate_values)?,
            of_set,
            branches: (0..agents).map(|agent| spec.n_action_of(agent)).collect(),
            mixing: Mixing::new(config.mixer, agents, n_state)?,
            batch: config.batch,
            values,
            agents,
            widths,
        })
    }

    fn mixer(&self) -> Option<&Mlp> {
        self.mixing.as_ref().and_then(|mixing| mixing.weights.as_ref())
    }

    fn work(&self, team: bool) -> Vec<Work> {
        let n_weights = self.mixer().map_or(0, Mlp::n_output);
        let work = |block: Block| {
            let rows = block.rows * self.agents;
            Work {
                memory: [self.network.memory(rows), self.network.memory(rows)],
                scratch: self.network.scratch(rows),
                of_mixer: self.mixer().map(|mlp| (mlp.memory(block.rows), mlp.scratch(block.rows))),
                target: vec![0.0; rows * self.values.quantiles],
                best: vec![0; rows * self.values.branches],
                grad_output: vec![0.0; rows * self.values.n_output()],
                q: vec![0.0; rows],
                grad_q: vec![0.0; self.agents],
                grad_weights: vec![0.0; block.rows * n_weights],
                gradient: vec![0.0; self.network.n_parameter()],
                mixer_gradient: vec![0.0; self.mixer().map_or(0, Mlp::n_parameter)],
                sums: [0.0; 2],
                block,
            }
        };
        Block::cut(self.widths, self.batch, team).into_iter().map(work).collect()
    }

    /// Bytes of the work on a batch.
    fn bytes(&self) -> u128 {
        let row = self.agents * (4 * self.network.n_activation() + 3 * self.network.n_input())
            + self.mixer().map_or(0, |mlp| 3 * mlp.n_activation());
        let networks = self.network.n_parameter() + self.mixer().map_or(0, Mlp::n_parameter);
        4 * (self.batch as u128 * row as u128 + self.batch.div_ceil(ROWS) as u128 * networks as u128)
    }

    /// What a mixer's network sees.
    fn state<'a>(&self, state: &'a [f32], observation: &'a [f32]) -> &'a [f32] {
        if self.widths.n_state > 0 { state } else { observation }
    }
}

impl Work {
    /// Targets of every row.
    fn value_next(
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
    fn judge(&mut self, shapes: &Shapes, (net, mixer): (&NetWithTarget, Option<&NetWithTarget>), huber: f32) {
        let (rows, agents) = (self.block.rows, shapes.agents);
        self.sums = [0.0; 2];
        self.grad_output.fill(0.0);
        let said = shapes.network.forward(&net.parameters, &self.block.observation, rows * agents, &mut self.memory[0]);
        match &shapes.mixing {
            None => self.block.judge(shapes, (&said, huber), &self.target, &mut self.grad_output, &mut self.sums),
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

impl Shapes {
    /// The value of what an agent did, the mean over the numbers of its action.
    fn of_chosen(&self, output: &[f32], action: &[f32]) -> f32 {
        let of = |(branch, a): (usize, &f32)| self.values.value(output, branch, self.level(*a));
        action.iter().enumerate().map(of).sum::<f32>() / action.len() as f32
    }

    /// Adds `up` · ∂(that value)/∂output.
    fn pull_chosen(&self, action: &[f32], up: f32, grad_output: &mut [f32]) {
        let share = up / (action.len() * self.values.quantiles) as f32;
        for (branch, a) in action.iter().enumerate() {
            (0..self.values.quantiles).for_each(|q| self.values.pull((branch, self.level(*a), q), share, grad_output));
        }
    }

    fn level(&self, a: f32) -> usize {
        (a.max(0.0).round() as usize).min(self.values.levels - 1)
    }
}

impl Block {
    /// What agent `k` of the block did.
    fn done(&self, k: usize, shapes: &Shapes) -> &[f32] {
        &self.action[k * shapes.widths.n_action..][..shapes.branches[k % self.agents]]
    }

    /// Every number of an action by itself against the target of the row; with quantiles the quantile Huber loss, each
    /// against all of the target's.
    fn judge(
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
                    let own = judge(values.quantile(output, branch, level, q), q, target, self.weight[k], huber);
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

impl Learner for Dqn {
    fn update(&mut self) -> Result<Update> {
        let begun = Instant::now();
        let progress = share_done(self.update, self.config.updates);
        let epsilon = self.config.epsilon.at(progress);
        let explore = Greedy { shapes: &self.shapes, parameters: &self.net.parameters, epsilon };
        let flown = self.experience.fly(&self.threads, self.config.steps, (self.update, progress), &explore)?;
        let flying = begun.elapsed();
        let (mut sums, mut steps) = ([0.0; 4], 0.0_f64);
        while self.experience.suffices() && steps < self.config.gradient_steps as f64 {
            let own = self.improve();
            sums.iter_mut().zip(own).for_each(|(sum, x)| *sum += x);
            steps += 1.0;
        }
        let unit = self.norm.unit();
        if steps > 0.0 {
            self.measure()?;
        }
        let learning = begun.elapsed() - flying;
        let n_step = (self.config.n_env * self.config.steps) as f64;
        self.update += 1;
        self.env_steps += n_step as u64;
        let rows = (self.config.batch as f64 * steps).max(1.0);
        Ok(Update {
            loss: sums[0] / rows,
            reward: flown.reward / n_step,
            episodes: flown.episodes,
            gradient_norm: sums[2] / steps.max(1.0),
            rate: self.config.learning_rate.at(progress),
            extra: vec![
                ("value", f64::from(unit.denormalise((sums[1] / rows) as f32))),
                ("value_std", f64::from(unit.std)),
                ("epsilon", epsilon),
                ("kept", self.experience.kept() as f64),
                ("rows_left_out", sums[3]),
            ],
            phases: vec![("fly", flying), ("learn", learning)],
        })
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
        state::put_value_norm(out, &self.norm)?;
        self.experience.save(out)
    }

    fn load(&mut self, _: &Tensors, from: &Tensors) -> Result<()> {
        let [update, env_steps, step] = state::counters(from)?;
        self.net.load(from, "learner", &self.shapes.network)?;
        if let (Some(net), Some(mlp)) = (&mut self.mixer, self.shapes.mixer()) {
            net.load(from, "mixer", mlp)?;
        }
        state::load_value_norm(from, &mut self.norm)?;
        self.experience.load(from)?;
        (self.update, self.env_steps, self.step) = (update, env_steps, step);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
