//! A task and an algorithm that the library does not know, by name: trained, resumed, evaluated, drawn, as its own.
//! The algorithm is A2C (Mnih et al. 2016): one step of actor and critic per rollout, along advantages by GAE.
//!
//! `cargo run --release --example own_task_and_algorithm`

use omnidrones::error::{Error, Result};
use omnidrones::parallel::Threads;
use omnidrones::prelude::*;
use omnidrones::rl::checkpoint::Tensors;
use omnidrones::rl::nn::{Activation, Adam, AdamConfig, Layers, Transposed, Weights, clip_norm};
use omnidrones::rl::parts::{
    BehaviourPolicy, Collector, Critic, CriticSees, Fit, Make, Minibatch, RolloutBatch, RolloutShape, Sums, ValueNorm,
    shards,
};
use omnidrones::rl::policy::Actor;
use omnidrones::rl::{Algorithm, Episodes, Progress, Starts, Update, algorithm, evaluate, state};
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::reward::rational_kernel;
use omnidrones::tasks::{BuiltIn, Spec, registry};
use omnidrones_plot::{Figure, Panel, Series};
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// Rises two metres, and stays.
struct Climb {
    robot: Robot,
}

fn left(view: &View) -> Trace {
    2.0 - view.drone(0).position[2]
}

#[rustfmt::skip]
impl Task for Climb {
    fn robot(&self) -> &Robot { &self.robot }
    fn horizon(&self) -> usize { 100 }
    fn start(&self, start: &mut Start<'_>) {
        let position = start.position([[0.0, 0.0], [0.0, 0.0], [0.5, 1.5]]);
        start.place(0, position, [1.0, 0.0, 0.0, 0.0]);
    }
    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("left", "m", "2 − z").number(left(view));
        out.field("velocity", "m/s, world", "v").array(view.drone(0).velocity);
        out.field("up", "-, world", "u").within(-1.0, 1.0).array(view.drone(0).up());
        out.field("angular_velocity", "rad/s, world", "ω").array(view.drone(0).angular_velocity);
    }
    fn reward(&self, view: &View, terms: &mut Writer) {
        let [x, y, _] = view.drone(0).velocity;
        let square = left(view).square() + x.square() + y.square();
        terms.term("near", "1/(1 + left² + v_x² + v_y²)", 1.0).number(rational_kernel(1.0, square));
    }
    fn ends(&self, view: &View, ends: &mut Ends) {
        ends.when("fast", "|v| > 5 m/s", safe::squared_norm(view.drone(0).velocity).gt(25.0));
    }
    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("height_error", "m", left(view).abs());
    }
    fn success(&self, view: &View) -> TraceMask { left(view).abs().lt(0.1) }
    fn ideal(&self, start: &mut Start<'_>) { start.place(0, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]); }
}

impl BuiltIn for Climb {
    fn new(config: &EnvConfig) -> Result<Self> {
        Ok(Self { robot: config.single_robot("hummingbird")? })
    }
}

// The algorithm: its settings, what a run asks of them, and the learner.

/// Rollouts of `steps` steps of `n_env` environments, a constant learning rate, the layers of both networks.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct A2cConfig {
    pub n_env: usize,
    pub steps: usize,
    pub updates: u64,
    pub rate: f64,
    pub network: Layers,
}

impl Default for A2cConfig {
    fn default() -> Self {
        let network = Layers { activation: Activation::Elu, ..Layers::default() };
        Self { n_env: 128, steps: 16, updates: 600, rate: 2e-3, network }
    }
}

#[rustfmt::skip]
impl Algorithm for A2cConfig {
    fn name(&self) -> &'static str { "a2c" }
    fn updates(&self) -> u64 { self.updates }
    fn set_updates(&mut self, updates: u64) { self.updates = updates; }
    fn actor(&self, spec: &Spec) -> Result<Actor> { Actor::new(spec, &self.network, false) }
    fn validate(&self) -> Result<()> {
        if self.n_env == 0 || self.steps == 0 {
            return Err(Error::value("n_env or steps", 0, "1 or more", "128 and 16 are usual."));
        }
        self.network.validate()
    }
    fn learner(&self, make: &Make<'_>, env: &EnvConfig, seed: u64, threads: Threads) -> Result<Box<dyn Learner>> {
        let env = EnvConfig { n_env: self.n_env, seed, ..env.clone() };
        let shards = shards(make, &env, 64)?;
        let spec = shards[0].env.spec().clone();
        let (actor, shape) = (self.actor(&spec)?, RolloutShape::new(&spec, self.steps, CriticSees::default()));
        let stream = |network| Stream::new(seed, 0, network, Purpose::LEARNING);
        let mut parameters = actor.mlp.init(&mut stream(0));
        parameters.resize(actor.n_parameter(), -0.5); // log standard deviations
        let rows = self.n_env * self.steps * shape.n_agent;
        let adam = AdamConfig::default();
        let critic = Critic::new(shape.n_critic(), &self.network, adam, (rows, env.memory_limit), &mut stream(1))?;
        let mut transposed = Transposed::default();
        actor.mlp.transpose(&parameters, &mut transposed);
        Ok(Box::new(A2c {
            adam: Adam::new(adam, parameters.len()),
            batch: Minibatch::new(&actor.mlp, actor.head.n_extra(), rows, env.memory_limit)?,
            collectors: shards.into_iter().map(|shard| Collector::new(shard, &actor, &critic)).collect(),
            rollout: RolloutBatch::new(shape, self.n_env),
            norm: ValueNorm::new(0.99)?,
            counters: [0; 2],
            config: self.clone(),
            actor, parameters, transposed, critic, threads, seed,
        }))
    }
}

struct A2c {
    config: A2cConfig,
    actor: Actor,
    parameters: Vec<f32>,
    transposed: Transposed,
    adam: Adam,
    batch: Minibatch,
    critic: Critic,
    norm: ValueNorm,
    collectors: Vec<Collector>,
    rollout: RolloutBatch,
    threads: Threads,
    seed: u64,
    counters: [u64; 2], // updates, steps of environments
}

impl Learner for A2c {
    fn update(&mut self) -> Result<Update> {
        let policy = BehaviourPolicy {
            actor: &self.actor,
            parameters: &self.parameters,
            critic: &self.critic,
            value_norm: &self.norm,
            seed: self.seed,
            update: self.counters[0],
        };
        let mut parts = self.rollout.parts(self.collectors.iter().map(|c| c.shard.env.spec().n_env));
        let mut all: Vec<_> = self.collectors.iter_mut().zip(&mut parts).collect();
        self.threads.for_each(&mut all, |_, (collector, part)| {
            let collected = collector.collect(part, policy);
            collector.failed = collected.and_then(|()| part.estimate_advantages(0.98, 0.95)).err();
        });
        if let Some(error) = self.collectors.iter_mut().find_map(|c| c.failed.take()) {
            return Err(error);
        }
        let r = &mut self.rollout;
        let usable = |k: &u32| r.log_prob[*k as usize].is_finite() && r.advantage[*k as usize].is_finite();
        let rows: Vec<u32> = (0..r.log_prob.len() as u32).filter(usable).collect();
        let targets: Vec<f32> = rows.iter().map(|k| r.target[*k as usize]).collect();
        self.norm.update(&targets);
        self.norm.normalise(&mut r.target);
        let share = 1.0 / rows.len().max(1) as f32;
        let (network, extra) = self.parameters.split_at(self.actor.mlp.n_parameter());
        let (head, n) = (self.actor.head, r.shape.n_action);
        let scale = self.norm.std() as f32;
        let loss = |row: usize, y: &[f32], d_output: &mut [f32], d_extra: &mut [f32], sums: &mut Sums| {
            let (action, advantage) = (&r.action[row * n..][..n], r.advantage[row] / scale);
            sums[0] -= f64::from(share * advantage * head.log_prob(y, extra, action));
            head.gradient(y, extra, action, -share * advantage, -1e-3 * share, d_output, d_extra);
        };
        let net = Weights { parameters: network, transposed: &self.transposed };
        let sums = self.batch.gradient(&self.threads, &self.actor.mlp, net, &r.observation, &rows, &loss);
        let gradient_norm = clip_norm(&mut self.batch.gradient, 1.0);
        let rate = self.config.rate;
        self.adam.descend(&mut self.parameters, &self.batch.gradient, rate);
        self.actor.mlp.transpose(&self.parameters, &mut self.transposed);
        let critic_loss =
            self.critic.fit(&self.threads, r.critic_input(), &r.target, &rows, Fit { rate, clip: 1.0, huber: 10.0 });
        let n_step = self.config.n_env * self.config.steps;
        self.counters = [self.counters[0] + 1, self.counters[1] + n_step as u64];
        let (mut episodes, mut reward) = (Episodes::default(), 0.0);
        for Collector { stats, .. } in &self.collectors {
            episodes.add(&stats.episodes);
            reward += stats.reward / n_step as f64;
        }
        let extra = vec![("critic_loss", critic_loss)];
        Ok(Update { loss: sums[0], reward, episodes, gradient_norm, rate, extra, phases: Vec::new() })
    }
    fn progress(&self) -> Progress {
        let [update, env_steps] = self.counters;
        Progress { update, budget: self.config.updates, env_steps }
    }
    fn policy(&self) -> Result<Policy> {
        Policy::of(&self.actor, &self.parameters, &self.collectors[0].shard.env)
    }
    fn save(&self, policy: &mut Tensors, out: &mut Tensors) -> Result<()> {
        state::put_network(policy, "actor", &self.actor.mlp, &self.parameters)?;
        let extra = &self.parameters[self.actor.mlp.n_parameter()..];
        policy.insert("actor.log_std", &[extra.len()], extra.to_vec())?;
        state::put_adam(out, "actor", &self.adam)?;
        self.critic.save(out)?;
        state::put_counters(out, self.counters)?;
        out.insert("value_norm", &[4], self.norm.save().to_vec())?;
        state::put_shards(out, self.collectors.iter().map(|c| &c.shard))
    }
    fn load(&mut self, policy: &Tensors, from: &Tensors) -> Result<()> {
        self.parameters = state::network(policy, "actor", &self.actor.mlp)?;
        self.parameters.extend(policy.get::<f32>("actor.log_std", &[self.actor.head.n_extra()])?);
        self.actor.mlp.transpose(&self.parameters, &mut self.transposed);
        self.adam = state::adam(from, "actor", self.adam.config, self.parameters.len())?;
        self.critic.load(from)?;
        self.counters = state::counters(from)?;
        let mut norm = [0.0; 4];
        norm.copy_from_slice(from.get::<f64>("value_norm", &[4])?);
        self.norm.load(norm)?;
        state::load_shards(from, self.collectors.iter_mut().map(|c| &mut c.shard))
    }
}

fn main() -> Result<()> {
    registry::register::<Climb>("Climb", "rise two metres and stay")?;
    algorithm::register::<A2cConfig>()?;
    let folder = std::env::temp_dir().join(format!("omnidrones-climb-{}", std::process::id()));
    let settings = "seed = 1\nevaluate = { every = 50, envs = 128 }\n[a2c]\nnetwork.hidden = [32, 32]";
    let config = TrainConfig::for_task("climb", Some("a2c"), Some((settings, "settings")))?;
    let begin = || Trainer::new("Climb", config.clone(), Threads::default())?.in_folder(&folder, true);
    let half = config.updates() / 2;
    let stopped =
        begin()?.run(&mut |p| if p.update < half { ControlFlow::Continue(()) } else { ControlFlow::Break(()) })?;
    let mut trainer = begin()?;
    println!("resumed at update {} of {}", trainer.update(), trainer.budget());
    let whole = trainer.run(&mut |_| ControlFlow::Continue(()))?;
    let (before, after) = (stopped.evaluation.length, whole.evaluation.length);
    println!("an episode lasts {before:.0} steps after half of the updates, {after:.0} after all");
    let mut saved = load_policy(&folder)?;
    let (env, starts) = (saved.config.seen_env(), Starts { n_env: 64, seed: 7 });
    let told = evaluate(&mut saved.policy, "Climb", &env, starts, &Threads::default(), &mut |_| {})?;
    println!("from other starts: return {:.1} of 100, {:.0} % crashed", told.return_mean, 100.0 * told.crashed);
    let points =
        whole.curve.iter().filter_map(|line| Some((line.get("env_steps")?, line.get("eval_return")?))).collect();
    let panel = Panel::new("Climb by A2C", "environment steps", "return").series(Series::line("", points).markers());
    Figure::new("A task and an algorithm of one's own").grid(&[1.0], &[1.0]).place((0, 0), (1, 1), panel).svg()?;
    std::fs::remove_dir_all(&folder).map_err(|e| Error::file(&folder, e))?;
    assert!(told.return_mean > 50.0, "the policy has not learnt to climb");
    Ok(())
}
