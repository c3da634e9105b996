//! What on-policy learners learn from: T steps of every environment under one policy, with the worth of each.
//!
//! Rows stand shard by shard, step by step, environment by environment, agent by agent. Every shard has T + 1 steps of
//! them: the last one holds what is seen behind the rollout and its value, and has no action and no advantage. So an
//! environment writes its observations where minibatches will read them.
//!
//! A critic that values the central state has one row per environment, which is worth the mean reward of its agents;
//! otherwise every agent has its own. Behind what it sees may stand the numbers of the episode that no policy is told
//! (an asymmetric critic: Pinto et al. 2018).

use super::critic::Critic;
use super::gae::{Steps, advantages};
use super::input_scale::InputSums;
use super::learner::Episodes;
use super::nn::Memory;
use super::nn::gaussian::Gaussians;
use super::policy::{Actor, ROWS};
use super::recall::Recall;
use super::shards::{Shard, episodes, within_memory};
use super::value_norm::ValueNorm;
use base::error::{Error, Result};
use rng::{NORMAL_WORDS, Purpose, Stream, normals};
use std::time::{Duration, Instant};
use tasks::{Spec, StepOut};

/// Widths of all rows.
#[derive(Debug, Clone, Copy)]
pub struct RolloutShape {
    /// T.
    pub steps: usize,
    /// A.
    pub n_agent: usize,
    /// Rows of the critic per environment: 1, or one per agent.
    pub n_value: usize,
    /// Numbers that an agent sees.
    pub n_observation: usize,
    /// Of the state that the critic sees; 0 where it sees observations.
    pub n_central: usize,
    /// Of those that differ between environments which it sees too.
    pub n_privileged: usize,
    /// Numbers of an agent's action.
    pub n_action: usize,
    /// Numbers that the policy remembers of an agent; 0 without memory.
    pub n_state: usize,
}

/// What the critic of a rollout may see that the policy does not; by default neither.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CriticSees {
    /// The central state, where there is one.
    pub central: bool,
    /// The numbers that differ between environments, where there are any.
    pub privileged: bool,
}

impl RolloutShape {
    /// For rollouts of `steps` steps.
    pub fn new(spec: &Spec, steps: usize, sees: CriticSees) -> Self {
        let central = sees.central && spec.n_central > 0;
        Self {
            steps,
            n_agent: spec.n_agent,
            n_value: if central { 1 } else { spec.n_agent },
            n_observation: spec.n_observation,
            n_central: if central { spec.n_central } else { 0 },
            n_privileged: if sees.privileged { spec.privileged.len() } else { 0 },
            n_action: spec.action.len(),
            n_state: 0,
        }
    }

    /// The same for a policy that remembers `n_state` numbers ([`Network::n_state`](super::nn::Network::n_state)).
    pub fn remembering(self, n_state: usize) -> Self {
        Self { n_state, ..self }
    }

    /// Checks that rows of `n_env` environments can be counted and kept.
    ///
    /// # Errors
    /// [`Error::Limit`] otherwise.
    pub fn check(&self, n_env: usize, memory_limit: u64) -> Result<()> {
        let slots = (n_env as u64).saturating_mul(self.steps as u64 + 1);
        let rows = slots.saturating_mul(self.n_agent as u64);
        let of_agent = (self.n_observation + self.n_action + self.n_state + 2) * self.n_agent
            + (5 + self.n_apart()) * self.n_value;
        let bytes = slots.saturating_mul(4 * of_agent as u64 + 2);
        if rows > u64::from(u32::MAX) {
            let remedy = "Take fewer environments or steps.";
            return Err(Error::limit("rows of a rollout", rows, u32::MAX, remedy));
        }
        within_memory("rows of a rollout", rows, u128::from(bytes), memory_limit)
    }

    /// Numbers that the critic sees.
    pub fn n_critic(&self) -> usize {
        self.n_base() + self.n_privileged
    }

    /// Of the central state, or of an observation.
    fn n_base(&self) -> usize {
        if self.n_central > 0 { self.n_central } else { self.n_observation }
    }

    /// Numbers of a row that is the critic's alone; 0 where it sees observations and nothing else.
    fn n_apart(&self) -> usize {
        if self.n_central + self.n_privileged > 0 { self.n_critic() } else { 0 }
    }

    /// Writes rows of the critic: each of `base`, then the numbers of its environment.
    fn join(&self, base: &[f32], privileged: &[f32], to: &mut [f32]) {
        let rows = to.chunks_exact_mut(self.n_critic()).zip(base.chunks_exact(self.n_base()));
        for (k, (to, base)) in rows.enumerate() {
            let (own, known) = to.split_at_mut(self.n_base());
            own.copy_from_slice(base);
            let first = k / self.n_value * self.n_privileged;
            known.copy_from_slice(&privileged[first..first + self.n_privileged]);
        }
    }

    /// Row of the critic for the row of an agent.
    pub fn critic_row(&self, row: usize) -> usize {
        if self.n_value == self.n_agent { row } else { row / self.n_agent }
    }
}

/// The rows of all shards.
pub struct RolloutBatch {
    /// Widths of the rows.
    pub shape: RolloutShape,
    /// One per agent.
    pub observation: Vec<f32>,
    /// One per agent, as drawn.
    pub action: Vec<f32>,
    /// NaN where the row is no use.
    pub log_prob: Vec<f32>,
    /// One per agent: what the policy remembered before the step; empty without memory.
    pub state: Vec<f32>,
    /// One per agent: 1 where that was nothing; empty without memory.
    pub begins: Vec<u8>,
    /// One per row of the critic; empty where it sees observations.
    pub apart: Vec<f32>,
    /// One per row of the critic.
    pub reward: Vec<f32>,
    /// V of what was acted on.
    pub value: Vec<f32>,
    /// V of what came next: of the true last observation where time ran out.
    pub next_value: Vec<f32>,
    /// NaN where the row is no use, as `target`.
    pub advantage: Vec<f32>,
    /// What the critic is fitted to.
    pub target: Vec<f32>,
    /// One per environment.
    pub terminated: Vec<u8>,
    /// Likewise.
    pub truncated: Vec<u8>,
}

/// The rows of one shard.
pub struct RolloutPart<'a> {
    /// Widths of the rows.
    pub shape: RolloutShape,
    /// Environments of the shard.
    pub n_env: usize,
    /// As [`RolloutBatch::observation`].
    pub observation: &'a mut [f32],
    /// As [`RolloutBatch::action`].
    pub action: &'a mut [f32],
    /// As [`RolloutBatch::log_prob`].
    pub log_prob: &'a mut [f32],
    /// As [`RolloutBatch::state`].
    pub state: &'a mut [f32],
    /// As [`RolloutBatch::begins`].
    pub begins: &'a mut [u8],
    /// As [`RolloutBatch::apart`].
    pub apart: &'a mut [f32],
    /// As [`RolloutBatch::reward`].
    pub reward: &'a mut [f32],
    /// As [`RolloutBatch::value`].
    pub value: &'a mut [f32],
    /// As [`RolloutBatch::next_value`].
    pub next_value: &'a mut [f32],
    /// As [`RolloutBatch::advantage`].
    pub advantage: &'a mut [f32],
    /// As [`RolloutBatch::target`].
    pub target: &'a mut [f32],
    /// As [`RolloutBatch::terminated`].
    pub terminated: &'a mut [u8],
    /// As [`RolloutBatch::truncated`].
    pub truncated: &'a mut [u8],
}

impl RolloutBatch {
    /// Empty rows of `n_env` environments.
    pub fn new(shape: RolloutShape, n_env: usize) -> Self {
        let slots = n_env * (shape.steps + 1);
        let (rows, critic_rows) = (slots * shape.n_agent, slots * shape.n_value);
        Self {
            shape,
            observation: vec![0.0; rows * shape.n_observation],
            action: vec![0.0; rows * shape.n_action],
            log_prob: vec![f32::NAN; rows],
            state: vec![0.0; rows * shape.n_state],
            begins: vec![0; if shape.n_state > 0 { rows } else { 0 }],
            apart: vec![0.0; critic_rows * shape.n_apart()],
            reward: vec![0.0; critic_rows],
            value: vec![0.0; critic_rows],
            next_value: vec![0.0; critic_rows],
            advantage: vec![f32::NAN; critic_rows],
            target: vec![f32::NAN; critic_rows],
            terminated: vec![0; slots],
            truncated: vec![0; slots],
        }
    }

    /// Whether an agent's row has anything to learn from: all that its loss reads is finite.
    pub fn counts(&self, row: usize) -> bool {
        self.log_prob[row].is_finite() && self.advantage[self.shape.critic_row(row)].is_finite()
    }

    /// What the critic sees.
    pub fn critic_input(&self) -> &[f32] {
        if self.shape.n_apart() > 0 { &self.apart } else { &self.observation }
    }

    /// The rows of shards of so many environments each.
    pub fn parts(&mut self, n_env: impl Iterator<Item = usize>) -> Vec<RolloutPart<'_>> {
        fn take<'a, T>(rest: &mut &'a mut [T], n: usize) -> &'a mut [T] {
            let (own, behind) = std::mem::take(rest).split_at_mut(n);
            *rest = behind;
            own
        }
        let s = self.shape;
        let mut all = RolloutPart {
            shape: s,
            n_env: 0,
            observation: &mut self.observation,
            action: &mut self.action,
            log_prob: &mut self.log_prob,
            state: &mut self.state,
            begins: &mut self.begins,
            apart: &mut self.apart,
            reward: &mut self.reward,
            value: &mut self.value,
            next_value: &mut self.next_value,
            advantage: &mut self.advantage,
            target: &mut self.target,
            terminated: &mut self.terminated,
            truncated: &mut self.truncated,
        };
        let own = |n_env: usize| {
            let slots = n_env * (s.steps + 1);
            let (rows, critic_rows) = (slots * s.n_agent, slots * s.n_value);
            RolloutPart {
                shape: s,
                n_env,
                observation: take(&mut all.observation, rows * s.n_observation),
                action: take(&mut all.action, rows * s.n_action),
                log_prob: take(&mut all.log_prob, rows),
                state: take(&mut all.state, rows * s.n_state),
                begins: take(&mut all.begins, if s.n_state > 0 { rows } else { 0 }),
                apart: take(&mut all.apart, critic_rows * s.n_apart()),
                reward: take(&mut all.reward, critic_rows),
                value: take(&mut all.value, critic_rows),
                next_value: take(&mut all.next_value, critic_rows),
                advantage: take(&mut all.advantage, critic_rows),
                target: take(&mut all.target, critic_rows),
                terminated: take(&mut all.terminated, slots),
                truncated: take(&mut all.truncated, slots),
            }
        };
        n_env.map(own).collect()
    }
}

impl RolloutPart<'_> {
    /// Advantages and targets. Rows in which anything is not finite get an advantage, a target or a log-probability
    /// that is not.
    ///
    /// # Errors
    /// As [`advantages`].
    pub fn estimate_advantages(&mut self, discount: f64, lambda: f64) -> Result<()> {
        let s = self.shape;
        let (flags, critic_rows) = (s.steps * self.n_env, s.steps * self.n_env * s.n_value);
        let steps = Steps {
            reward: &self.reward[..critic_rows],
            value: &self.value[..critic_rows],
            next_value: &self.next_value[..critic_rows],
            terminated: &self.terminated[..flags],
            truncated: &self.truncated[..flags],
            n_env: self.n_env,
            n_agent: s.n_value,
        };
        advantages(&steps, discount, lambda, &mut self.advantage[..critic_rows], &mut self.target[..critic_rows])?;
        let broken = |x: &[f32]| x.iter().fold(false, |broken, x| broken | !x.is_finite());
        let seen: &[f32] = if s.n_apart() > 0 { self.apart } else { self.observation };
        for (row, x) in seen.chunks_exact(s.n_critic()).take(critic_rows).enumerate() {
            if broken(x) {
                (self.advantage[row], self.target[row]) = (f32::NAN, f32::NAN);
            }
        }
        let observations = self.observation.chunks_exact(s.n_observation);
        for (log_prob, x) in self.log_prob.iter_mut().zip(observations).take(flags * s.n_agent) {
            if broken(x) {
                *log_prob = f32::NAN;
            }
        }
        Ok(())
    }
}

/// The policy that all shards fly while they collect, and the critic that values what they see.
#[derive(Clone, Copy)]
pub struct BehaviourPolicy<'a> {
    /// Its shape.
    pub actor: &'a Actor,
    /// Of its network, then of its head.
    pub parameters: &'a [f32],
    /// What values it.
    pub critic: &'a Critic,
    /// The scale of what it says.
    pub value_norm: &'a ValueNorm,
    /// Of the run.
    pub seed: u64,
    /// Updates done: exploration is drawn anew in each.
    pub update: u64,
}

impl BehaviourPolicy<'_> {
    /// Of the stream of environment `i` of a shard: one for each and every rollout, so that results depend neither on shards nor on
    /// threads, and none is saved.
    fn key(&self, first_environment: u64, i: usize) -> [u64; 4] {
        [self.seed, first_environment.wrapping_add(i as u64), self.update, Purpose::POLICY.0]
    }
}

/// A shard of environments with what collecting needs.
pub struct Collector {
    /// The environments.
    pub shard: Shard,
    /// Of the last rollout.
    pub stats: RolloutStats,
    /// What went wrong in it, for who collects in parallel.
    pub failed: Option<Error>,
    /// Of every environment, where actions are whole numbers.
    streams: Vec<Stream>,
    /// Where they are continuous: the normal numbers of a step, environment by environment and agent by agent.
    noise: Vec<f64>,
    /// Of the actor, one for each set of its parameters, if its actions are continuous.
    gaussians: Vec<Gaussians>,
    /// What agents see that act side by side, where they do not stand so.
    gathered: Vec<f32>,
    /// What the policy remembers of every agent.
    pub(crate) recall: Recall,
    of_actor: Memory,
    of_critic: Memory,
    /// What was seen last in episodes that ran out of time, and in which rows of the critic.
    pub(crate) ends: Vec<f32>,
    pub(crate) end_rows: Vec<usize>,
    end_values: Vec<f32>,
    /// Of what the critic alone saw, where it scales that.
    pub(crate) apart: InputSums,
    /// The numbers of the episodes that go on, as deviations from the nominal ones.
    known: Vec<f32>,
}

/// Figures of one shard's rollout.
#[derive(Debug, Clone, Copy, Default)]
pub struct RolloutStats {
    /// Σ over environments and steps.
    pub reward: f64,
    /// Those that ended.
    pub episodes: Episodes,
    /// Time of the policy, of the environments, of the critic.
    pub times: [Duration; 3],
}

impl Collector {
    /// For the environments of a shard.
    pub fn new(shard: Shard, actor: &Actor, critic: &Critic) -> Self {
        let rows = shard.env.spec().n_env * shard.env.spec().n_agent;
        Self {
            stats: RolloutStats::default(),
            recall: Recall::new(actor, rows, ROWS),
            failed: None,
            streams: Vec::with_capacity(shard.env.spec().n_env),
            noise: Vec::new(),
            gaussians: (0..actor.n_set()).filter_map(|k| Gaussians::of(actor.head_of(k))).collect(),
            gathered: Vec::new(),
            of_actor: actor.mlp.memory(ROWS),
            of_critic: critic.mlp.memory(ROWS),
            ends: Vec::new(),
            end_rows: Vec::new(),
            end_values: Vec::new(),
            apart: InputSums::default(),
            known: Vec::new(),
            shard,
        }
    }

    /// Flies T steps on from where the last rollout stopped, exploring, and values what was seen.
    ///
    /// # Errors
    /// As [`Env::step`](tasks::Env::step).
    pub fn collect(&mut self, part: &mut RolloutPart<'_>, policy: BehaviourPolicy<'_>) -> Result<()> {
        let s = part.shape;
        let n_env = part.n_env;
        let (n_seen, n_apart) = (n_env * s.n_agent * s.n_observation, n_env * s.n_value * s.n_apart());
        self.stats = RolloutStats::default();
        self.ends.clear();
        self.end_rows.clear();
        self.streams.clear();
        if self.gaussians.is_empty() {
            let first = self.shard.env.spec().config.first_environment;
            self.streams.extend((0..n_env).map(|i| Stream::restore(policy.key(first, i), 0)));
        }
        let of_team = self.gaussians.iter().map(Gaussians::n).sum::<usize>() * s.n_agent / policy.actor.n_set();
        self.noise.resize(n_env * of_team, 0.0);
        for (k, gaussians) in self.gaussians.iter_mut().enumerate() {
            gaussians.set(policy.actor.set(policy.parameters, k).1);
        }
        part.observation[..n_seen].copy_from_slice(&self.shard.out.observation);
        let Shard { env, out } = &self.shard;
        env.spec().deviations(&out.privileged, &mut self.known);
        let base = if s.n_central > 0 { &out.central } else { &out.observation };
        s.join(base, &self.known, &mut part.apart[..n_apart]);
        for t in 0..s.steps {
            self.step(part, policy, t)?;
        }
        self.shard.out.observation.copy_from_slice(&part.observation[s.steps * n_seen..]);
        if s.n_central > 0 && s.n_privileged == 0 {
            self.shard.out.central.copy_from_slice(&part.apart[s.steps * n_apart..]);
        }
        self.value(part, policy);
        Ok(())
    }

    /// The normal numbers of step t: what the streams would give one after the other.
    fn draw(&mut self, n_env: usize, policy: BehaviourPolicy<'_>, t: usize) {
        let (first, of_team) = (self.shard.env.spec().config.first_environment, self.noise.len() / n_env);
        let stream = |i| (policy.key(first, i), (NORMAL_WORDS * of_team * t) as u64);
        normals(n_env, of_team, stream, |i, k, x| self.noise[i * of_team + k] = x);
    }

    fn step(&mut self, part: &mut RolloutPart<'_>, policy: BehaviourPolicy<'_>, t: usize) -> Result<()> {
        let begun = Instant::now();
        let s = part.shape;
        let (n_env, rows) = (part.n_env, part.n_env * s.n_agent);
        let (now, next) = part.observation[t * rows * s.n_observation..].split_at_mut(rows * s.n_observation);
        let actions = &mut part.action[t * rows * s.n_action..][..rows * s.n_action];
        let log_probs = &mut part.log_prob[t * rows..][..rows];
        if s.n_state > 0 {
            part.state[t * rows * s.n_state..][..rows * s.n_state].copy_from_slice(&self.recall.state);
            part.begins[t * rows..][..rows].copy_from_slice(&self.recall.begins);
        }
        self.draw(n_env, policy, t);
        let of_team = self.noise.len() / n_env;
        for block in policy.actor.blocks(rows) {
            let (network, extra) = policy.actor.set(policy.parameters, block.set);
            let before: usize = self.gaussians.iter().take(block.set).map(Gaussians::n).sum();
            let x = block.of(now, s.n_observation, &mut self.gathered);
            let output = self.recall.forward(policy.actor, network, x, block.first, &mut self.of_actor);
            let (head, gaussians) = (policy.actor.head_of(block.set), self.gaussians.get(block.set));
            for (k, row) in (0..block.rows).map(|k| (k, block.row(k))) {
                let (i, agent) = (row / s.n_agent, row % s.n_agent);
                let action = &mut actions[row * s.n_action..][..s.n_action];
                match gaussians {
                    Some(gaussians) => {
                        // behind that of agents of other sets, then of those before it in its own
                        let at = i * of_team + before + agent / policy.actor.n_set() * gaussians.n();
                        gaussians.sample(output.row(k), &self.noise[at..], action);
                    }
                    None => log_probs[row] = head.sample(output.row(k), extra, &mut self.streams[i], action),
                }
            }
            if let Some(gaussians) = gaussians {
                let action = |k: usize| &actions[block.row(k) * s.n_action..][..s.n_action];
                let all = gaussians.log_probs(block.rows, output, &action);
                (0..block.rows).for_each(|k| log_probs[block.row(k)] = all[k]);
            }
        }
        let acted = Instant::now();
        let Shard { env, out } = &mut self.shard;
        let next = &mut next[..rows * s.n_observation];
        let n_apart = n_env * s.n_value * s.n_apart();
        let (known, apart) = part.apart[t * n_apart..].split_at_mut(n_apart);
        let apart = &mut apart[..n_apart];
        let mut to = StepOut { observation: &mut *next, ..out.out() };
        if s.n_privileged == 0 {
            // written where it is read; empty where the critic sees observations
            (to.central, to.privileged) = (&mut *apart, &mut []);
        }
        env.step(actions, &mut to)?;
        if s.n_privileged > 0 {
            env.spec().deviations(&out.privileged, &mut self.known);
            s.join(if s.n_central > 0 { &out.central } else { next }, &self.known, apart);
        }
        for i in (0..n_env).filter(|i| s.n_state > 0 && out.terminated[*i] | out.truncated[*i] == 1) {
            (i * s.n_agent..(i + 1) * s.n_agent).for_each(|row| self.recall.forget(row));
        }
        part.terminated[t * n_env..][..n_env].copy_from_slice(&out.terminated);
        part.truncated[t * n_env..][..n_env].copy_from_slice(&out.truncated);
        // as many agents as share a row of the critic
        let team = s.n_agent / s.n_value;
        let critic_rows = t * n_env * s.n_value;
        for (to, own) in part.reward[critic_rows..].iter_mut().zip(out.reward.chunks_exact(team)) {
            *to = own.iter().sum::<f32>() / team as f32;
        }
        let finite = out.reward.iter().filter(|x| x.is_finite());
        self.stats.reward += finite.map(|x| f64::from(*x)).sum::<f64>() / s.n_agent as f64;
        self.stats.episodes.add(&episodes(env.spec(), out)?);
        let last = if s.n_central > 0 { &out.final_central } else { &out.final_observation };
        for i in (0..n_env).filter(|i| out.truncated[*i] == 1 && out.terminated[*i] == 0) {
            for k in i * s.n_value..(i + 1) * s.n_value {
                self.ends.extend(&last[k * s.n_base()..][..s.n_base()]);
                // of the episode that ended
                self.ends.extend(&known[k * s.n_apart()..][..s.n_apart()][s.n_base().min(s.n_apart())..]);
            }
            self.end_rows.extend((0..s.n_value).map(|k| critic_rows + i * s.n_value + k));
        }
        self.stats.times[0] += acted - begun;
        self.stats.times[1] += acted.elapsed();
        Ok(())
    }

    /// V of everything seen, and of what follows each step.
    fn value(&mut self, part: &mut RolloutPart<'_>, policy: BehaviourPolicy<'_>) {
        let begun = Instant::now();
        let n = part.shape.n_critic();
        let critic = policy.critic;
        if let Some(scale) = critic.inputs.as_ref().filter(|_| part.shape.n_apart() > 0) {
            // what is seen behind the rollout is the first of the next one
            let seen = part.shape.steps * part.n_env * part.shape.n_value * n;
            self.apart = scale.sums(&part.apart[..seen]);
            scale.scale(part.apart);
            scale.scale(&mut self.ends);
        }
        let mut value = |x: &[f32], values: &mut [f32]| {
            for (x, values) in x.chunks(ROWS * n).zip(values.chunks_mut(ROWS)) {
                critic.mlp.forward(&critic.parameters, x, values.len(), &mut self.of_critic).write(values);
            }
            policy.value_norm.denormalise(values);
        };
        value(if part.shape.n_apart() > 0 { part.apart } else { part.observation }, part.value);
        self.end_values.resize(self.end_rows.len(), 0.0);
        value(&self.ends, &mut self.end_values);
        let step = part.n_env * part.shape.n_value;
        let kept = part.value.len() - step;
        part.next_value[..kept].copy_from_slice(&part.value[step..]);
        for (row, value) in self.end_rows.iter().zip(&self.end_values) {
            part.next_value[*row] = *value;
        }
        self.stats.times[2] += begun.elapsed();
    }
}
