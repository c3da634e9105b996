//! An actor that climbs what critics say of kept experience: what SAC and TD3 share, for one drone or a team.
//!
//! A gradient step draws a batch, fits every critic Q(o, a) to y = Σ γʲ rⱼ + γᵏ (minᵢ Q̄ᵢ(o', a') + b), with the slowly following
//! Q̄ and an action a' that the algorithm chooses (and what it adds for it, b), then moves the actor up Q(o, π(o)). Critics that
//! tell quantiles are compared by their means, and fit all of those of the least one (Seo et al. 2025). The two
//! phases go through the batch block by block: everything of a block happens on one thread while it is in cache.
//!
//! Critics speak in a running unit of their targets, and say the same when it changes (PopArt, van Hasselt et al. 2016): what
//! rewards are measured in does not matter.
//!
//! Where critics see the whole team (`central_critic`, Lowe et al. 2017), a row is an environment: they judge what all agents
//! saw and did, and each agent's own action alone carries its gradient. Agents then may have an actor each (`separate_actors`).

mod config;

pub use config::{ActorCriticConfig, Exploration};

use super::checkpoint::Tensors;
use super::experience::{Block, Experience, Explore, Flown, Streams};
use super::learner::Algorithm;
use super::learner::{Learner, Make, Progress, Update, share_done};
use super::nn::elementwise::approach;
use super::nn::fold::fold;
use super::nn::{Activation, Memory, Mlp, Network, Pass, PerAgent, Scratch};
use super::policy::{Actor, Policy, ROWS, network};
use super::replay::Widths;
use super::schedule::Schedule;
use super::shards::{shards_if, within_memory};
use super::state;
use super::target_network::{NetWithTarget, Stride};
use super::value_loss::judge;
use super::value_norm::{Unit, ValueNorm};
use super::warm_start::WarmStart;
use base::error::{Error, Result};
use base::parallel::Threads;
use rng::{Purpose, Stream};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tasks::{EnvConfig, Space, Spec};

/// What an algorithm of this kind chooses for itself.
#[doc(hidden)]
pub trait Kind: Send + Sync {
    /// Numbers that the actor gives for an action of `n`; of the first n tanh is the action, or its middle.
    fn n_output(&self, n: usize) -> usize;

    /// An action to fly, of an agent of environment `environment`. Here and below an action may have fewer numbers than
    /// outputs are for, where agents are unlike: the first ones count.
    fn explore(&self, output: &[f32], environment: u64, noise: &mut Noise<'_>, action: &mut [f32]);

    /// An action to value, and what is added to its value.
    fn next(&self, output: &[f32], noise: &mut Noise<'_>, action: &mut [f32]) -> f32;

    /// An action to improve, and its ln π or 0.
    fn draw(&self, output: &[f32], noise: &[f32], action: &mut [f32]) -> f32;

    /// ∂/∂output of what is minimised, in units of `std`, where `grad_action` is that of −Q.
    fn pull(&self, output: &[f32], noise: &[f32], std: f32, grad_action: &[f32], grad_output: &mut [f32]);

    /// How many of the critics the actor climbs, by the least of them.
    fn climbed(&self, critics: usize) -> usize;

    /// Most numbers of an action.
    fn most_action(&self) -> usize {
        usize::MAX
    }

    /// Whether values behind a step are those of an actor that follows slowly.
    fn slow_actor(&self) -> bool;

    /// Behind a step of the actor whose mean ln π was `log_prob`.
    fn adapt(&mut self, _log_prob: f64) {}

    /// Figures for the log.
    fn figures(&self) -> Vec<(&'static str, f64)> {
        Vec::new()
    }

    /// Numbers to go on from.
    fn save(&self) -> Vec<f64> {
        Vec::new()
    }

    /// As saved.
    ///
    /// # Errors
    /// [`Error::Value`] for numbers that make no sense.
    fn load(&mut self, _saved: &[f64]) -> Result<()> {
        Ok(())
    }
}

/// Standard normal numbers.
#[doc(hidden)]
pub struct Noise<'a> {
    stream: &'a mut Stream,
    /// Numbers that stay the same for several steps, and ρ of what is drawn with them.
    held: Option<(Stream, f64)>,
}

impl Noise<'_> {
    /// The next one: ξ, or √ρ ξ_held + √(1 − ρ) ξ.
    pub fn normal(&mut self) -> f32 {
        let own = self.stream.normal();
        let held = self.held.as_mut().map(|(held, rho)| rho.sqrt() * held.normal() + (1.0 - *rho).sqrt() * own);
        held.unwrap_or(own) as f32
    }
}

/// A block of the batch and all that one thread needs to learn from it.
struct Work {
    block: Block,
    /// What critics see: `[rows, critic's inputs]`.
    x: Vec<f32>,
    actor: Memory,
    critic: Memory,
    of_actor: Scratch,
    of_critic: Scratch,
    /// Of all agents: what the actor gave, noise, actions, ∂/∂ both.
    noise: Vec<f32>,
    actions: Vec<f32>,
    grad_action: Vec<f32>,
    grad_output: Vec<f32>,
    /// Of every row what is added to the value behind it, and what critics are fitted to, `[rows, quantiles]`.
    bonus: Vec<f32>,
    target: Vec<f32>,
    /// What each critic said, in the mean over quantiles: `[critics, rows]`.
    q: Vec<f32>,
    grad_q: Vec<f32>,
    grad_x: Vec<f32>,
    /// One for each critic.
    gradients: Vec<Vec<f32>>,
    gradient: Vec<f32>,
    /// Σ of the critics' losses, of values, of ln π, of the actor's −Q, of the mean square of what tanh takes in.
    sums: [f64; 5],
}

/// Networks' shapes, and how many rows they learn from.
struct Shapes {
    /// Of all agents, row by row.
    actor: Arc<dyn Network>,
    /// That of one set of parameters.
    of_set: Arc<dyn Network>,
    critic: Mlp,
    n_critic: usize,
    quantiles: usize,
    batch: usize,
    /// Numbers of what critics see before the actions.
    n_base: usize,
    agents: usize,
    /// Numbers of the action of each of them; what stands behind them in its row is 0.
    done: Vec<usize>,
    widths: Widths,
}

impl Shapes {
    fn new<E: Exploration>(settings: &ActorCriticConfig<E>, kind: &E::Kind, spec: &Spec) -> Result<Self> {
        let widths = Widths::of(spec, settings.central_critic);
        let agents = if settings.central_critic { widths.n_agent } else { 1 };
        let n_base = if widths.n_state > 0 { widths.n_state } else { agents * widths.n_observation };
        let of_set = network(spec, &settings.network, kind.n_output(widths.n_action), Activation::Identity)?;
        Ok(Self {
            actor: PerAgent::of_team(&of_set, agents, settings.separate_actors)?,
            of_set,
            critic: Mlp::new(
                n_base + agents * widths.n_action,
                &settings.critic,
                settings.quantiles,
                Activation::Identity,
            )?,
            n_critic: settings.critics,
            quantiles: settings.quantiles,
            batch: settings.batch,
            n_base,
            agents,
            done: (0..agents).map(|agent| spec.n_action_of(agent)).collect(),
            widths,
        })
    }

    /// Of every action of `x`, agent by agent, the numbers that its agent has.
    fn each<'a>(&'a self, x: &'a mut [f32]) -> impl Iterator<Item = &'a mut [f32]> {
        let own = self.done.iter().cycle();
        x.chunks_exact_mut(self.widths.n_action).zip(own).map(|(x, n)| &mut x[..*n])
    }

    /// Rows of what critics see: `base` beside `actions`.
    fn join(&self, base: &[f32], actions: &[f32], x: &mut [f32]) {
        let n_action = self.agents * self.widths.n_action;
        let rows = base.chunks_exact(self.n_base).zip(actions.chunks_exact(n_action));
        for (x, (base, action)) in x.chunks_exact_mut(self.n_base + n_action).zip(rows) {
            x[..self.n_base].copy_from_slice(base);
            x[self.n_base..].copy_from_slice(action);
        }
    }

    fn work(&self, team: bool) -> Vec<Work> {
        let work = |block: Block| {
            let (rows, agents) = (block.rows, block.rows * self.agents);
            let n_x = self.critic.n_input();
            Work {
                x: vec![0.0; rows * n_x],
                actor: self.actor.memory(agents),
                critic: self.critic.memory(rows),
                of_actor: self.actor.scratch(agents),
                of_critic: self.critic.scratch(rows),
                noise: vec![0.0; agents * self.widths.n_action],
                actions: vec![0.0; agents * self.widths.n_action],
                grad_action: vec![0.0; agents * self.widths.n_action],
                grad_output: vec![0.0; agents * self.actor.n_output()],
                bonus: vec![0.0; rows],
                target: vec![0.0; rows * self.quantiles],
                q: vec![0.0; self.n_critic * rows],
                grad_q: vec![0.0; rows * self.quantiles],
                grad_x: vec![0.0; rows * n_x],
                gradients: vec![vec![0.0; self.critic.n_parameter()]; self.n_critic],
                gradient: vec![0.0; self.actor.n_parameter()],
                sums: [0.0; 5],
                block,
            }
        };
        Block::cut(self.widths, self.batch, team).into_iter().map(work).collect()
    }

    /// Bytes of the work on a batch.
    fn bytes(&self) -> u128 {
        let row = 2 * (self.critic.n_activation() + self.critic.n_input())
            + self.agents * (2 * self.actor.n_activation() + 4 * self.actor.n_input());
        let networks = self.n_critic * self.critic.n_parameter() + self.actor.n_parameter();
        // beside a gradient per block: weights, those transposed, two moments, what follows, the whole gradient, their mean
        let copies = self.batch.div_ceil(ROWS) as u128 + 7;
        4 * (self.batch as u128 * row as u128 + copies * networks as u128)
    }
}

/// What an update leaves of the statistics of the targets.
const VALUE_BETA: f64 = 0.98;

/// η of the mean of the actor's weights: it is of about the last fifth of its steps.
const MEAN_DECAY: f64 = 4.0;

/// An actor with critics, in the middle of a run.
pub struct ActorCritic<E: Exploration> {
    config: ActorCriticConfig<E>,
    kind: E::Kind,
    shapes: Shapes,
    actor: NetWithTarget,
    /// The mean of the actor's weights over its last steps, each of which went where the critics of its time erred (polynomial
    /// decay, Shamir and Zhang 2013): what flies.
    mean: Vec<f32>,
    /// Gradient step behind which weights are of the scale of observations in force, and count for the mean.
    mean_from: u64,
    critics: Vec<NetWithTarget>,
    norm: ValueNorm,
    experience: Experience,
    work: Vec<Work>,
    /// What flies.
    flown: Actor,
    threads: Threads,
    update: u64,
    env_steps: u64,
    /// Gradient steps.
    step: u64,
}

/// The actor while it explores.
struct Exploring<'a, K> {
    kind: &'a K,
    /// ρ of noise in the steps of an update.
    correlation: f64,
    network: &'a dyn Network,
    parameters: &'a [f32],
    shapes: &'a Shapes,
}

impl<K: Kind> Explore for Exploring<'_, K> {
    fn act(&self, x: &[f32], first: usize, memory: &mut Memory, streams: &mut Streams<'_>, actions: &mut [f32]) {
        let output = self.network.forward(self.parameters, x, x.len() / self.network.n_input(), memory);
        let n_action = self.shapes.widths.n_action;
        for (k, action) in self.shapes.each(actions).enumerate() {
            let environment = streams.environment(first + k);
            let held = (self.correlation > 0.0).then(|| (streams.held(first + k, n_action), self.correlation));
            let mut noise = Noise { stream: streams.of(first + k), held };
            self.kind.explore(output.row(k), environment, &mut noise, action);
        }
    }
}

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
        let actor = NetWithTarget::new(&shapes.actor, config.adam, kind.slow_actor(), &mut stream(0));
        Ok(Self {
            mean: actor.parameters.clone(),
            mean_from: 0,
            actor,
            critics: (0..config.critics as u64).map(critic).collect(),
            experience: Experience::new(shards, &shapes.actor, (&config.replay, config.discount), widths)?,
            norm: ValueNorm::new(VALUE_BETA)?,
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

    fn progress_of_run(&self) -> f64 {
        share_done(self.update, self.config.updates)
    }

    /// Flies on.
    fn fly(&mut self) -> Result<Flown> {
        let explore = Exploring {
            kind: &self.kind,
            correlation: self.config.correlation,
            network: &*self.shapes.actor,
            parameters: &self.actor.parameters,
            shapes: &self.shapes,
        };
        self.experience.fly(&self.threads, self.config.steps, (self.update, self.progress_of_run()), &explore)
    }

    /// Takes the last targets into the unit, in which critics then say the same.
    fn measure(&mut self) -> Result<()> {
        let targets = self.work.iter().flat_map(|work| work.block.counting(&work.target, self.shapes.quantiles));
        let change = self.norm.move_unit(targets);
        self.critics.iter_mut().try_for_each(|critic| critic.rescale(&self.shapes.critic, |_| change))
    }

    /// One gradient step.
    fn improve(&mut self, learnt: &mut Learnt) {
        let progress = self.progress_of_run();
        self.judge(progress);
        let climbs = (self.step + 1).is_multiple_of(self.config.actor_delay as u64);
        // where the actor's target follows with a delay, those of the critics do
        let follows = climbs || !self.kind.slow_actor();
        let stride = |rate: &Schedule| Stride {
            clip: self.config.max_grad_norm,
            rate: rate.at(progress),
            tau: if follows { self.config.tau } else { 0.0 },
        };
        let of_critics = stride(&self.config.critic_learning_rate);
        let of_actor = stride(&self.config.learning_rate);
        let (work, mlp) = (&self.work, &self.shapes.critic);
        self.threads.for_each(&mut self.critics, |k, critic| {
            critic.descend(mlp, work.iter().map(|own| &own.gradients[k][..]), of_critics);
        });
        self.experience.rank(self.work.iter().map(|work| &work.block));
        self.step += 1;
        learnt.critic_steps += 1.0;
        if climbs {
            self.climb(progress);
            let gradients = self.work.iter().map(|own| &own.gradient[..]);
            self.actor.descend(&self.shapes.actor, gradients, of_actor);
            let steps = ((self.step - self.mean_from) as f64 / self.config.actor_delay as f64).max(1.0);
            let share = (MEAN_DECAY + 1.0) / (steps + MEAN_DECAY);
            approach(&mut self.mean, &self.actor.parameters, share as f32);
            let left_out: usize = self.work.iter().map(|own| own.block.left_out).sum();
            let rows = ((self.config.batch - left_out).max(1) * self.shapes.agents) as f64;
            self.kind.adapt(self.work.iter().map(|own| own.sums[2]).sum::<f64>() / rows);
            learnt.actor_steps += 1.0;
            learnt.gradient_norm += self.actor.gradient_norm;
            learnt.rate = of_actor.rate;
        }
        for own in &self.work {
            learnt.sums.iter_mut().zip(own.sums).for_each(|(sum, x)| *sum += x);
            learnt.left_out += own.block.left_out as f64;
        }
    }

    /// Draws a batch, and every critic's gradient on it.
    fn judge(&mut self, progress: f64) {
        let Self { kind, shapes, actor, critics, experience, config, step, norm, .. } = self;
        let unit = norm.unit();
        let follows = if kind.slow_actor() { &actor.following } else { &actor.parameters };
        self.threads.for_each(&mut self.work, |number, work| {
            experience.gather(&mut work.block, (*step, number), progress);
            work.value_next(kind, shapes, (follows, critics), unit);
            work.judge(shapes, critics, config.huber as f32);
        });
    }

    /// The actor's gradient on the batch.
    fn climb(&mut self, progress: f64) {
        let Self { kind, shapes, actor, critics, norm, config, .. } = self;
        let (std, penalty) = (norm.unit().std, config.saturation_penalty.at(progress) as f32);
        let climbed = &critics[..kind.climbed(critics.len())];
        self.threads.for_each(&mut self.work, |_, work| {
            work.climb(kind, shapes, (actor, climbed), (std, penalty));
        });
    }

    /// The weights of what flies: of outputs it has those that are the action.
    fn flown_parameters(&self) -> Result<Vec<f32>> {
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

impl Work {
    /// y of every row, in units of the critics.
    fn value_next<K: Kind>(
        &mut self,
        kind: &K,
        shapes: &Shapes,
        (follows, critics): (&[f32], &[NetWithTarget]),
        unit: Unit,
    ) {
        let (rows, n) = (self.block.rows, shapes.quantiles);
        let output = shapes.actor.forward(follows, &self.block.next, rows * shapes.agents, &mut self.actor);
        self.bonus.fill(0.0);
        let mut noise = Noise { stream: &mut self.block.stream, held: None };
        for (k, action) in shapes.each(&mut self.actions).enumerate() {
            self.bonus[k / shapes.agents] += kind.next(output.row(k), &mut noise, action);
        }
        let base = if shapes.widths.n_state > 0 { &self.block.next_state } else { &self.block.next };
        shapes.join(base, &self.actions, &mut self.x);
        self.q[..rows].fill(f32::INFINITY);
        self.target.fill(f32::INFINITY);
        for critic in critics {
            let said = shapes.critic.forward(&critic.following, &self.x, rows, &mut self.critic);
            for (k, (least, target)) in self.q[..rows].iter_mut().zip(self.target.chunks_exact_mut(n)).enumerate() {
                let mean = mean(said.row(k));
                if mean < *least {
                    *least = mean;
                    target.copy_from_slice(said.row(k));
                }
            }
        }
        for (k, target) in self.target.iter_mut().enumerate() {
            let row = k / n;
            let next = unit.denormalise(*target) + self.bonus[row];
            *target = unit.normalise(self.block.reward[row] + self.block.discount[row] * next);
        }
    }

    /// Gradients of Σ weight · loss(Q − y)/batch for every critic.
    fn judge(&mut self, shapes: &Shapes, critics: &[NetWithTarget], huber: f32) {
        let (rows, n) = (self.block.rows, shapes.quantiles);
        let share = 1.0 / (shapes.batch * n * n) as f32;
        let base = if shapes.widths.n_state > 0 { &self.block.state } else { &self.block.observation };
        shapes.join(base, &self.block.action, &mut self.x);
        self.sums = [0.0; 5];
        self.block.error.fill(0.0);
        for (critic, gradient) in critics.iter().zip(&mut self.gradients) {
            let said = shapes.critic.forward(&critic.parameters, &self.x, rows, &mut self.critic);
            for (k, grad_q) in self.grad_q.chunks_exact_mut(n).enumerate() {
                let (target, weight) = (&self.target[k * n..][..n], self.block.weight[k]);
                let mut error = 0.0;
                for (i, (own, grad)) in said.row(k).iter().zip(grad_q).enumerate() {
                    let judged = judge(*own, i, target, weight, huber);
                    *grad = judged.slope * share;
                    error += judged.error;
                    self.sums[0] += f64::from(judged.loss) / (n * n) as f64;
                }
                let known = weight > 0.0 && error.is_finite();
                self.block.error[k] = self.block.error[k].max(if known { error.abs() / (n * n) as f32 } else { 0.0 });
                self.sums[1] += f64::from(mean(said.row(k)));
            }
            gradient.fill(0.0);
            let pass = Pass { gradient, grad_input: &mut [], scratch: &mut self.of_critic };
            shapes.critic.backward(critic.weights(), &self.x, rows, &self.critic, &self.grad_q, pass);
        }
    }

    /// The gradient of the mean of −Q(o, π(o)) + what the algorithm adds + what keeps tanh from its corners, as far as the agents of
    /// this block go.
    fn climb<K: Kind>(
        &mut self,
        kind: &K,
        shapes: &Shapes,
        (actor, critics): (&NetWithTarget, &[NetWithTarget]),
        (std, penalty): (f32, f32),
    ) {
        let (rows, n, agents) = (self.block.rows, shapes.widths.n_action, shapes.agents);
        let n_output = shapes.actor.n_output();
        let output = shapes.actor.forward(&actor.parameters, &self.block.observation, rows * agents, &mut self.actor);
        self.noise.iter_mut().for_each(|e| *e = self.block.stream.normal() as f32);
        for (k, action) in shapes.each(&mut self.actions).enumerate() {
            let noise = &self.noise[k * n..][..n];
            self.sums[2] += f64::from(kind.draw(output.row(k), noise, action) * live(self.block.weight[k / agents]));
        }
        for agent in 0..agents {
            self.sums[3] -= slopes(
                (&self.block, &self.actions, agent),
                shapes,
                critics,
                (&mut self.critic, &mut self.of_critic),
                (&mut self.x, &mut self.q, &mut self.grad_q, &mut self.grad_x),
                &mut self.grad_action,
            );
        }
        for (k, own) in self.grad_output.chunks_exact_mut(n_output).enumerate() {
            let [noise, slope] = [&self.noise, &self.grad_action].map(|all| &all[k * n..][..shapes.done[k % agents]]);
            kind.pull(output.row(k), noise, std, slope, own);
            let (before, counts) = (&output.row(k)[..slope.len()], live(self.block.weight[k / agents]));
            let each = 1.0 / slope.len().max(1) as f32;
            own.iter_mut().zip(before).for_each(|(x, y)| *x += 2.0 * penalty * each * y);
            self.sums[4] += f64::from(counts * each * before.iter().map(|y| y * y).sum::<f32>());
            let share = counts / (shapes.batch * agents) as f32;
            own.iter_mut().for_each(|x| *x *= share);
        }
        self.gradient.fill(0.0);
        let pass = Pass { gradient: &mut self.gradient, grad_input: &mut [], scratch: &mut self.of_actor };
        let x = &self.block.observation;
        shapes.actor.backward(actor.weights(), x, rows * agents, &self.actor, &self.grad_output, pass);
    }
}

/// Of quantiles.
fn mean(of: &[f32]) -> f32 {
    of.iter().sum::<f32>() / of.len() as f32
}

/// Rows that do not count are left out here; others count alike.
fn live(weight: f32) -> f32 {
    if weight > 0.0 { 1.0 } else { 0.0 }
}

/// −∂minᵢ Qᵢ/∂(action of one agent of every row), where the others do what they did; gives Σ minᵢ Qᵢ.
fn slopes(
    (block, actions, agent): (&Block, &[f32], usize),
    shapes: &Shapes,
    critics: &[NetWithTarget],
    (memory, scratch): (&mut Memory, &mut Scratch),
    (x, q, grad_q, grad_x): (&mut [f32], &mut [f32], &mut [f32], &mut [f32]),
    grad_action: &mut [f32],
) -> f64 {
    let (rows, n, agents) = (block.rows, shapes.widths.n_action, shapes.agents);
    let (n_x, own) = (shapes.critic.n_input(), shapes.n_base + agent * n);
    let base = if shapes.widths.n_state > 0 { &block.state } else { &block.observation };
    shapes.join(base, &block.action, x);
    for (k, x) in x.chunks_exact_mut(n_x).enumerate() {
        x[own..own + n].copy_from_slice(&actions[(k * agents + agent) * n..][..n]);
    }
    // which critic says least is known when all have spoken; but for the last, each says it again for its slope
    for (critic, q) in critics.iter().zip(q.chunks_exact_mut(rows)) {
        let said = shapes.critic.forward(&critic.parameters, x, rows, memory);
        q.iter_mut().enumerate().for_each(|(k, q)| *q = mean(said.row(k)));
    }
    let least = |k: usize| (0..critics.len()).min_by(|a, b| q[a * rows + k].total_cmp(&q[b * rows + k])).unwrap_or(0);
    let (mut total, share) = (0.0, 1.0 / shapes.quantiles as f32);
    for (i, critic) in critics.iter().enumerate().rev() {
        for k in 0..rows {
            let chosen = least(k) == i;
            grad_q[k * shapes.quantiles..][..shapes.quantiles].fill(if chosen { -share } else { 0.0 });
            total += if chosen { f64::from(q[i * rows + k] * live(block.weight[k])) } else { 0.0 };
        }
        if i + 1 < critics.len() {
            shapes.critic.forward(&critic.parameters, x, rows, memory);
        }
        let pass = Pass { gradient: &mut [], grad_input: grad_x, scratch };
        shapes.critic.backward(critic.weights(), x, rows, memory, grad_q, pass);
        for (k, grad_x) in grad_x.chunks_exact(n_x).enumerate() {
            let to = &mut grad_action[(k * agents + agent) * n..][..n];
            if i + 1 == critics.len() {
                to.fill(0.0);
            }
            to.iter_mut().zip(&grad_x[own..own + n]).for_each(|(to, g)| *to += g);
        }
    }
    total
}

/// Sums over the gradient steps of an update.
#[derive(Default)]
struct Learnt {
    sums: [f64; 5],
    critic_steps: f64,
    actor_steps: f64,
    gradient_norm: f64,
    rate: f64,
    left_out: f64,
}

impl<E: Exploration> Learner for ActorCritic<E> {
    fn update(&mut self) -> Result<Update> {
        let begun = Instant::now();
        let flown = self.fly()?;
        if flown.rescaled {
            self.mean_from = self.step;
        }
        let flying = begun.elapsed();
        let unit = self.norm.unit();
        let mut learnt = Learnt::default();
        if self.experience.suffices() {
            (0..self.config.gradient_steps).for_each(|_| self.improve(&mut learnt));
            self.measure()?;
        }
        let learning: Duration = begun.elapsed() - flying;
        let n_step = (self.config.n_env * self.config.steps) as f64;
        self.update += 1;
        self.env_steps += n_step as u64;
        let rows = (self.config.batch as f64 * learnt.critic_steps).max(1.0);
        let acted = (self.config.batch as f64 * learnt.actor_steps * self.shapes.agents as f64).max(1.0);
        let per_critic = rows * self.config.critics as f64;
        let mut extra = vec![
            ("critic_loss", learnt.sums[0] / per_critic),
            ("value", f64::from(unit.denormalise((learnt.sums[1] / per_critic) as f32))),
            ("value_std", f64::from(unit.std)),
            ("kept", self.experience.kept() as f64),
            ("rows_left_out", learnt.left_out),
            // none where the actor did not learn
            ("before_tanh", (learnt.sums[4] / (acted * f64::from(learnt.actor_steps > 0.0))).sqrt()),
        ];
        extra.extend(self.kind.figures());
        Ok(Update {
            loss: -f64::from(unit.denormalise((-learnt.sums[3] / acted) as f32)),
            reward: flown.reward / n_step,
            episodes: flown.episodes,
            gradient_norm: learnt.gradient_norm / learnt.actor_steps.max(1.0),
            rate: learnt.rate,
            extra,
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
        state::put_value_norm(out, &self.norm)?;
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
        state::load_value_norm(from, &mut self.norm)?;
        self.experience.load(from)?;
        (self.update, self.env_steps, self.step) = (update, env_steps, step);
        self.mean_from = from.get::<u64>("mean.from", &[1])?[0].min(step);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
