//! Environments that are flown on, and the steps of theirs that are kept: what off-policy algorithms have in common.
//!
//! A [`ReplayBlock`] is a fixed number of rows drawn from what is kept. Blocks have streams of their own and are gathered, valued and
//! differentiated by one thread each, so that results are the same bits for any number of threads.

use super::checkpoint::Tensors;
use super::learner::Episodes;
use super::nn::{Memory, Network};
use super::policy::ROWS;
use super::priorities::{MOST, Priorities};
use super::replay::{ReplayCode, ReplayConfig, Ring, Widths};
use super::shards::{Shard, begin_statistics, episodes, pending, set_difficulty};
use super::state;
use base::error::{Error, Result};
use base::parallel::Threads;
use rng::{Purpose, Stream};
use tasks::env::{PendingStatistics, VARIANCE_FLOOR};
use tasks::{Env, EnvConfig, ObservationTransform, Space, Spec, Statistics};

/// How actions are chosen while experience is gathered.
pub trait Explore: Sync {
    /// Actions of whole teams, about [`ROWS`] agents one after the other, who see `x`: the first is agent `first` of all of a
    /// shard's. Each environment has its stream.
    fn act(&self, x: &[f32], first: usize, memory: &mut Memory, streams: &mut Streams<'_>, actions: &mut [f32]);
}

/// The streams of a shard's environments.
pub struct Streams<'a> {
    own: &'a mut [Stream],
    n_agent: usize,
    /// Of the run and its update.
    seed: u64,
    update: u64,
    /// Number of the first environment in the whole batch.
    pub first_environment: u64,
}

impl Streams<'_> {
    /// That of an agent's environment.
    pub fn of(&mut self, agent: usize) -> &mut Stream {
        &mut self.own[agent / self.n_agent]
    }

    /// One that gives an agent the same `n` normal numbers in every step of an update.
    pub fn held(&self, agent: usize, n: usize) -> Stream {
        let key = [self.seed, self.environment(agent), self.update, Purpose::EXPLORATION.0];
        Stream::restore(key, (WORDS * (agent % self.n_agent) * n) as u64)
    }

    /// The environment of an agent, in the whole batch.
    pub fn environment(&self, agent: usize) -> u64 {
        self.first_environment.wrapping_add((agent / self.n_agent) as u64)
    }
}

/// Words of a stream in a normal number.
const WORDS: usize = 4;

/// A shard, what is kept of it, and what its policy works in.
struct Worker {
    shard: Shard,
    ring: Ring,
    memory: Memory,
    streams: Vec<Stream>,
    reward: f64,
    episodes: Episodes,
    failed: Option<Error>,
}

/// All shards, and what is kept of them.
pub struct Experience {
    workers: Vec<Worker>,
    /// Where rows are drawn by their priorities.
    priorities: Option<Priorities>,
    config: ReplayConfig,
    widths: Widths,
    space: Space,
    n_env: usize,
    discount: f64,
    seed: u64,
}

/// Figures of what was flown.
#[derive(Debug, Clone, Copy, Default)]
pub struct Flown {
    /// Σ over environments and steps of their agents' mean reward.
    pub reward: f64,
    /// Those that ended.
    pub episodes: Episodes,
    /// Whether observations have another scale behind it.
    pub rescaled: bool,
}

impl Experience {
    /// Of these shards, flown by a network like `actor`; `discount` is γ of what paths add up.
    ///
    /// # Errors
    /// As `ReplayCode::of`.
    pub fn new(
        shards: Vec<Shard>,
        actor: &dyn Network,
        (config, discount): (&ReplayConfig, f64),
        widths: Widths,
    ) -> Result<Self> {
        let n_env: usize = shards.iter().map(|shard| shard.env.spec().n_env).sum();
        let slots = config.slots(n_env);
        let spec = shards[0].env.spec();
        let (space, seed) = (spec.action.clone(), spec.config.seed);
        let code = ReplayCode::of(spec, config.images)?;
        let worker = |shard: Shard| {
            let n_env = shard.env.spec().n_env;
            let mut ring = Ring::new(widths, code.clone(), n_env, slots);
            ring.begin(&shard.out);
            Worker {
                ring,
                memory: actor.memory(whole_teams(widths.n_agent)),
                streams: Vec::with_capacity(n_env),
                reward: 0.0,
                episodes: Episodes::default(),
                failed: None,
                shard,
            }
        };
        let workers = shards.into_iter().map(worker).collect();
        let priorities = (config.priority > 0.0).then(|| Priorities::new(slots * n_env * widths.n_agent));
        Ok(Self { workers, priorities, widths, space, n_env, discount, seed, config: config.clone() })
    }

    /// Environments of one shard: the first's.
    pub fn env(&self) -> &Env {
        &self.workers[0].shard.env
    }

    /// Steps of environments that are kept.
    pub fn kept(&self) -> usize {
        self.workers[0].ring.kept() * self.n_env
    }

    /// Whether enough is kept to learn from.
    pub fn suffices(&self) -> bool {
        self.kept() >= self.config.learning_starts.max(1)
    }

    /// Flies `steps` steps on: with actions drawn evenly until enough is kept, then as `explore` says. `update` numbers the call,
    /// `progress` is that of the run.
    ///
    /// # Errors
    /// As [`Env::step`].
    pub fn fly(
        &mut self,
        threads: &Threads,
        steps: usize,
        (update, progress): (u64, f64),
        explore: &impl Explore,
    ) -> Result<Flown> {
        let (seed, n_agent) = (self.seed, self.widths.n_agent);
        let rows = (update + 1) as f64 * (steps * self.n_env * n_agent) as f64;
        let rescaled = self.measures(rows, progress);
        for Worker { shard, .. } in &mut self.workers {
            shard.env.take_pending();
            shard.env.set_collecting(rescaled);
        }
        let random = (!self.suffices()).then_some(&self.space);
        threads.for_each(&mut self.workers, |_, worker| {
            worker.begin(seed, update);
            let fly = (0..steps).try_for_each(|_| worker.step(n_agent, (seed, update), random, explore));
            worker.failed = fly.err();
        });
        if let Some(error) = self.workers.iter_mut().find_map(|worker| worker.failed.take()) {
            return Err(error);
        }
        self.rank_new(steps);
        if rescaled {
            self.normalise(rows)?;
        }
        let mut flown = Flown { rescaled, ..Flown::default() };
        for worker in &self.workers {
            flown.reward += worker.reward;
            flown.episodes.add(&worker.episodes);
        }
        Ok(flown)
    }

    /// New steps are drawn as often as the most surprising ones; those that are being written are not drawn.
    fn rank_new(&mut self, steps: usize) {
        let Some(priorities) = &mut self.priorities else { return };
        let ring = &self.workers[0].ring;
        let rows = self.n_env * self.widths.n_agent;
        let (most, len, head) = (priorities.most(), ring.kept(), ring.head());
        for k in len - steps.min(len)..len {
            let slot = ring.slot(k);
            (slot * rows..(slot + 1) * rows).for_each(|row| priorities.set(row, most));
        }
        (head * rows..(head + 1) * rows).for_each(|row| priorities.set(row, 0.0));
    }

    /// Where an environment of the batch is.
    fn place(&self, environment: usize) -> (&Ring, usize) {
        let each = self.workers[0].ring.n_env();
        (&self.workers[environment / each].ring, environment % each)
    }

    /// Draws all rows of `block`, number `number` of gradient step `step`; `progress` is that of the run.
    pub fn gather(&self, block: &mut ReplayBlock, (step, number): (u64, usize), progress: f64) {
        let mut stream = Stream::new(self.seed, 1 + number as u64, step, Purpose::LEARNING);
        block.left_out = 0;
        for k in 0..block.rows {
            self.draw(block, k, &mut stream, progress);
        }
        block.stream = stream;
    }

    /// Rows of a block that has one row per environment or one per agent.
    fn draw(&self, block: &mut ReplayBlock, k: usize, stream: &mut Stream, progress: f64) {
        let (w, len) = (self.widths, self.workers[0].ring.kept());
        let per_env = if block.team { 1 } else { w.n_agent };
        let n = len * self.n_env * per_env;
        let (id, weight) = match &self.priorities {
            None => {
                let id = stream.below(n as u64) as usize;
                let slot = self.workers[0].ring.slot(id / (self.n_env * per_env));
                (slot * self.n_env * per_env + id % (self.n_env * per_env), 1.0)
            }
            Some(priorities) => {
                let id = priorities.find(stream.unit() * priorities.total());
                let share = priorities.get(id) * n as f64 / priorities.total();
                let beta = self.config.beta + (1.0 - self.config.beta) * progress;
                // of a rare row at most ten times an even one's
                (id, share.max(0.1).powf(-beta) as f32)
            }
        };
        let (slot, of_slot) = (id / (self.n_env * per_env), id % (self.n_env * per_env));
        let (environment, agent) = (of_slot / per_env, of_slot % per_env);
        let (ring, env) = self.place(environment);
        let agents = if block.team { 0..w.n_agent } else { agent..agent + 1 };
        (block.ids[k], block.weight[k]) = (id as u32, weight);
        block.take(k, ring, (slot, env), agents, (self.config.n_step.at(progress).round() as usize, self.discount));
    }

    /// How surprising the rows of blocks were.
    pub fn rank<'a>(&mut self, blocks: impl Iterator<Item = &'a ReplayBlock>) {
        let Some(priorities) = &mut self.priorities else { return };
        for block in blocks {
            for (id, error) in block.ids.iter().zip(&block.error) {
                let known = if error.is_finite() { f64::from(*error).abs() } else { 0.0 };
                // none is never drawn again
                priorities.set(*id as usize, (known + 1e-6).min(MOST).powf(self.config.priority));
            }
        }
    }

    /// For tests: see [`Ring::retell`]; environments are counted over all shards.
    #[cfg(test)]
    pub fn retell(&mut self, mut tell: impl FnMut(usize, &mut [f32], &[f32]) -> (f32, bool)) {
        let mut first = 0;
        for worker in &mut self.workers {
            worker.ring.retell(|env, seen, done| tell(first + env, seen, done));
            first += worker.ring.n_env();
        }
    }

    /// The difficulty of episodes that begin from now on.
    ///
    /// # Errors
    /// As [`Env::set_difficulty`].
    pub fn set_difficulty(&mut self, share: f64) -> Result<()> {
        set_difficulty(self.workers.iter_mut().map(|worker| &mut worker.shard), share)
    }

    /// As [`begin_statistics`].
    ///
    /// # Errors
    /// As there.
    pub fn begin_statistics(&mut self, known: &Statistics) -> Result<()> {
        begin_statistics(self.workers.iter_mut().map(|worker| &mut worker.shard), Some(known))?;
        self.workers.iter_mut().for_each(|worker| worker.ring.begin(&worker.shard.out));
        Ok(())
    }

    /// Gives the normaliser the mean and deviation of what the last flight showed, and brings what is kept to the new scale; what
    /// was cut stays at the cut.
    fn normalise(&mut self, rows: f64) -> Result<()> {
        let old = self.env().statistics().clone();
        let mut shards: Vec<&mut Shard> = self.workers.iter_mut().map(|worker| &mut worker.shard).collect();
        let Some(PendingStatistics { count, sums, squares }) = pending(&mut shards)? else { return Ok(()) };
        // about the old mean, of numbers that were not cut
        let mut new = Statistics { count: 0.0, ..old.clone() };
        new.merge(count, &sums, &squares);
        new.count = rows;
        let change = Rescaling::between(&old, &new, clip(self.env().spec()));
        self.workers.iter_mut().for_each(|worker| worker.ring.each_observation(|x| change.apply(x)));
        self.begin_statistics(&new)
    }

    /// Whether this flight's observations count for the normaliser: each time that four times as many rows were seen as when it was
    /// last told of them, and not in the second half of a run, for networks have to learn the new scale.
    fn measures(&self, rows: f64, progress: f64) -> bool {
        let known = self.env().statistics();
        !known.mean.is_empty() && rows >= 4.0 * known.count && (progress < 0.5 || known.count == 0.0)
    }

    /// Refuses environments whose observations change their meaning while they are kept.
    ///
    /// # Errors
    /// [`Error::Value`] for stages behind a stage `normalise`.
    pub fn check(env: &EnvConfig) -> Result<()> {
        let normalises = |stage: &ObservationTransform| matches!(stage, ObservationTransform::Normalise { .. });
        match env.observation.iter().position(normalises) {
            Some(k) if k + 1 < env.observation.len() => {
                let remedy = "Put it last: what is kept is brought to the scale of what is seen.";
                Err(Error::value("env.observation", "stages behind normalise", "none for this algorithm", remedy))
            }
            _ => Ok(()),
        }
    }

    /// Bytes that what is kept takes in a checkpoint.
    pub fn saved_bytes(&self) -> u64 {
        let priorities = self.priorities.as_ref().map_or(0, Priorities::saved_bytes);
        priorities + self.workers.iter().map(|worker| worker.ring.saved_bytes()).sum::<u64>()
    }

    /// Environments and what is kept, into a checkpoint.
    ///
    /// # Errors
    /// None for names that are used once.
    pub fn save(&self, to: &mut Tensors) -> Result<()> {
        for (k, worker) in self.workers.iter().enumerate() {
            worker.ring.save(k, to)?;
        }
        if let Some(priorities) = &self.priorities {
            let all = priorities.save();
            to.insert("replay.priorities", &[all.len()], all)?;
        }
        state::put_shards(to, self.workers.iter().map(|worker| &worker.shard))
    }

    /// As saved.
    ///
    /// # Errors
    /// As [`Ring::load`], [`Priorities::load`] and [`state::load_shards`].
    pub fn load(&mut self, from: &Tensors) -> Result<()> {
        for (k, worker) in self.workers.iter_mut().enumerate() {
            worker.ring.load(k, from)?;
        }
        let place = |worker: &Worker| (worker.ring.head(), worker.ring.kept());
        if let Some(other) = self.workers.iter().find(|worker| place(worker) != place(&self.workers[0])) {
            let remedy = "The checkpoint is damaged or forged: go on from an earlier one.";
            let limit = format!("{:?}, as of all shards", place(&self.workers[0]));
            return Err(Error::value("place in the replay", format!("{:?}", place(other)), limit, remedy));
        }
        if let Some(priorities) = &mut self.priorities {
            let n = from.tensor("replay.priorities")?.shape().iter().product();
            priorities.load(from.get::<f64>("replay.priorities", &[n])?)?;
        }
        state::load_shards(from, self.workers.iter_mut().map(|worker| &mut worker.shard))
    }
}

impl Worker {
    fn begin(&mut self, seed: u64, update: u64) {
        let spec = self.shard.env.spec();
        let first = spec.config.first_environment;
        self.streams.clear();
        let stream = |i| Stream::new(seed, first.wrapping_add(i as u64), update, Purpose::POLICY);
        self.streams.extend((0..spec.n_env).map(stream));
        (self.reward, self.episodes) = (0.0, Episodes::default());
    }

    fn step(
        &mut self,
        n_agent: usize,
        (seed, update): (u64, u64),
        random: Option<&Space>,
        explore: &impl Explore,
    ) -> Result<()> {
        let Shard { env, out } = &mut self.shard;
        let spec = env.spec();
        let first_environment = spec.config.first_environment;
        let (seen, actions) = (&out.observation, self.ring.actions_mut());
        let mut streams = Streams { own: &mut self.streams, n_agent, seed, update, first_environment };
        let (n_seen, n_action) = (spec.n_observation, spec.action.len());
        match random {
            Some(space) => {
                for (agent, action) in actions.chunks_exact_mut(n_action).enumerate() {
                    let action = &mut action[..spec.n_action_of(agent % n_agent)];
                    action.iter_mut().for_each(|a| *a = evenly(space, streams.of(agent)));
                }
            }
            None => {
                let rows = whole_teams(n_agent);
                let blocks = seen.chunks(rows * n_seen).zip(actions.chunks_mut(rows * n_action));
                for (block, (x, actions)) in blocks.enumerate() {
                    explore.act(x, block * rows, &mut self.memory, &mut streams, actions);
                }
            }
        }
        env.step(self.ring.actions(), &mut out.out())?;
        let finite = out.reward.iter().filter(|x| x.is_finite());
        self.reward += finite.map(|x| f64::from(*x)).sum::<f64>() / n_agent as f64;
        self.episodes.add(&episodes(env.spec(), out)?);
        self.ring.push(out);
        Ok(())
    }
}

/// Rows that go through a network together: about [`ROWS`] of teams of `n_agent`, none of them cut in two.
fn whole_teams(n_agent: usize) -> usize {
    (ROWS / n_agent).max(1) * n_agent
}

/// ± this is what observations are cut to.
fn clip(spec: &Spec) -> f32 {
    let clip = spec.config.observation.iter().find_map(|stage| match stage {
        ObservationTransform::Normalise { clip } => Some(*clip as f32),
        _ => None,
    });
    clip.unwrap_or(f32::INFINITY)
}

/// From observations of one scale to those of another.
struct Rescaling {
    slope: Vec<f32>,
    shift: Vec<f32>,
    clip: f32,
}

impl Rescaling {
    /// x ↦ (x σ + μ − μ')/σ'.
    fn between(old: &Statistics, new: &Statistics, clip: f32) -> Self {
        let std = |of: &Statistics, k: usize| (of.variance[k] + VARIANCE_FLOOR).sqrt();
        let n = old.mean.len();
        Self {
            slope: (0..n).map(|k| (std(old, k) / std(new, k)) as f32).collect(),
            shift: (0..n).map(|k| ((old.mean[k] - new.mean[k]) / std(new, k)) as f32).collect(),
            clip,
        }
    }

    /// Of one agent; what is not finite stays so.
    fn apply(&self, x: &mut [f32]) {
        for ((x, slope), shift) in x.iter_mut().zip(&self.slope).zip(&self.shift) {
            let new = *x * slope + shift;
            *x = if new.is_finite() { new.clamp(-self.clip, self.clip) } else { new };
        }
    }
}

/// An action's number, all equally likely.
fn evenly(space: &Space, stream: &mut Stream) -> f32 {
    match space {
        Space::Box { .. } => stream.uniform(-1.0, 1.0) as f32,
        Space::Discrete { n } | Space::MultiDiscrete { levels: n, .. } => stream.below(*n as u64) as f32,
    }
}

/// Rows that are learnt from together.
pub struct ReplayBlock {
    /// How many.
    pub rows: usize,
    /// Whether a row is an environment with all its agents, or one agent.
    pub team: bool,
    /// Agents of a row.
    pub agents: usize,
    widths: Widths,
    /// `[rows, agents, observation]`.
    pub observation: Vec<f32>,
    /// `[rows, state]`.
    pub state: Vec<f32>,
    /// `[rows, agents, action]`.
    pub action: Vec<f32>,
    /// Σ γʲ rⱼ over the path, the mean over the agents of the row.
    pub reward: Vec<f32>,
    /// What is seen behind the path, as `observation`.
    pub next: Vec<f32>,
    /// As `state`.
    pub next_state: Vec<f32>,
    /// γᵏ, 0 where nothing follows.
    pub discount: Vec<f32>,
    /// 0 for rows in which anything is not finite.
    pub weight: Vec<f32>,
    /// By which priorities know them.
    pub ids: Vec<u32>,
    /// The last error of each, for priorities.
    pub error: Vec<f32>,
    /// Rows of the last draw that do not count.
    pub left_out: usize,
    /// For noise.
    pub stream: Stream,
    rewards: Vec<f32>,
}

impl ReplayBlock {
    /// Blocks of up to [`ROWS`] rows each, `rows` in all; with `team`, a row is an environment.
    pub fn cut(widths: Widths, rows: usize, team: bool) -> Vec<Self> {
        let agents = if team { widths.n_agent } else { 1 };
        let block = |rows: usize| Self {
            rows,
            team,
            agents,
            widths,
            observation: vec![0.0; rows * agents * widths.n_observation],
            state: vec![0.0; rows * widths.n_state],
            action: vec![0.0; rows * agents * widths.n_action],
            reward: vec![0.0; rows],
            next: vec![0.0; rows * agents * widths.n_observation],
            next_state: vec![0.0; rows * widths.n_state],
            discount: vec![0.0; rows],
            weight: vec![0.0; rows],
            ids: vec![0; rows],
            error: vec![0.0; rows],
            left_out: 0,
            stream: Stream::new(0, 0, 0, Purpose::LEARNING),
            rewards: vec![0.0; widths.n_agent],
        };
        (0..rows.div_ceil(ROWS)).map(|k| block(ROWS.min(rows - k * ROWS))).collect()
    }

    fn take(
        &mut self,
        k: usize,
        ring: &Ring,
        (slot, env): (usize, usize),
        agents: std::ops::Range<usize>,
        (n, discount): (usize, f64),
    ) {
        let (seen, done, state) = (self.widths.n_observation, self.widths.n_action, self.widths.n_state);
        self.rewards.fill(0.0);
        let path = ring.path(slot, env, n, discount, &mut self.rewards);
        let own = &self.rewards[agents.clone()];
        self.reward[k] = own.iter().sum::<f32>() / own.len() as f32;
        self.discount[k] = path.discount;
        let n_seen = agents.len() * seen;
        let (own, next) = (&mut self.observation[k * n_seen..][..n_seen], &mut self.next[k * n_seen..][..n_seen]);
        ring.observation(slot, env, &agents, own);
        let next_state = ring.next(path.next, env, &agents, next);
        let acted = &ring.action(slot, env)[agents.start * done..agents.end * done];
        self.action[k * acted.len()..][..acted.len()].copy_from_slice(acted);
        let mut finite = self.reward[k].is_finite();
        [own, next, acted].into_iter().for_each(|all: &[f32]| finite &= all.iter().all(|x| x.is_finite()));
        for (all, to) in [(ring.state(slot, env), &mut self.state), (next_state, &mut self.next_state)] {
            to[k * state..][..state].copy_from_slice(all);
            finite &= all.iter().all(|x| x.is_finite());
        }
        if !finite {
            self.leave_out(k);
        }
    }

    /// Of `[rows, n]` numbers those of rows that count.
    pub fn counting(&self, all: &[f32], n: usize) -> impl Iterator<Item = f32> {
        all.chunks_exact(n).zip(&self.weight).filter(|(_, weight)| **weight > 0.0).flat_map(|(own, _)| own).copied()
    }

    /// A row of zeros that does not count.
    fn leave_out(&mut self, k: usize) {
        let (seen, done) = (self.agents * self.widths.n_observation, self.agents * self.widths.n_action);
        let state = self.widths.n_state;
        self.observation[k * seen..][..seen].fill(0.0);
        self.next[k * seen..][..seen].fill(0.0);
        self.action[k * done..][..done].fill(0.0);
        self.state[k * state..][..state].fill(0.0);
        self.next_state[k * state..][..state].fill(0.0);
        (self.reward[k], self.discount[k], self.weight[k]) = (0.0, 0.0, 0.0);
        self.left_out += 1;
    }
}

#[cfg(test)]
mod tests;
