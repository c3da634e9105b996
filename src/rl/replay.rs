//! A ring of steps, kept to be learnt from more than once (Lin 1992).
//!
//! A slot holds one step of all environments of a shard: what was seen, what was done, the rewards, how it ended. What is seen
//! next stands in the next slot; only where time ran out is the true last observation kept
//! aside, for the next slot then holds the beginning of another episode. So a step takes the memory of one observation, not
//! of two.

mod seen;

use super::checkpoint::Tensors;
use super::schedule::Schedule;
use super::shards::within_memory;
use base::defaults::with_defaults;
use base::error::{Error, Result};
pub use seen::{Precision, ReplayCode, Seen};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use tasks::{Buffers, Spec};

with_defaults! {
    /// Settings of the steps that are kept.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ReplayConfig {
        /// Steps of environments that are kept. 2 to 2²⁸; default 200 000.
        pub capacity: usize = 200_000,
        /// Steps that are flown before the first is learnt from, with actions drawn evenly. Below `capacity`; default 4000.
        pub learning_starts: usize = 4000,
        /// n over the run, rounded: steps whose rewards a target adds up before it asks for a value. Many tell soon what follows, but
        /// of what was done then, noise and all; few are as exact as the value that they ask for (Schwarzer et al. 2023, section 3).
        /// 1 to 64; default 1.
        pub n_step: Schedule = Schedule::constant(1.0),
        /// α: a row is drawn as often as its last error to this power; 0 for all alike (Schaul et al. 2016). Within [0, 1]; default 0.
        pub priority: f64 = 0.0,
        /// β of the weights that make up for it, rising to 1 over the run. Within [0, 1]; default 0.4.
        pub beta: f64 = 0.4,
        /// How images and lidars are kept: `f32`, or `u8` in a quarter of the memory. Default `f32`.
        pub images: Precision = Precision::F32,
    }
}

/// Beginning of the names that kept steps have in a checkpoint.
pub(crate) const KEPT: &str = "replay.";
/// Most steps of a ring.
const MAX_CAPACITY: usize = 1 << 28;
/// Most steps of a target.
const MAX_N_STEP: f64 = 64.0;

impl ReplayConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        if !(2..=MAX_CAPACITY).contains(&self.capacity) {
            let limit = format!("2 to {MAX_CAPACITY}");
            return Err(Error::limit("replay.capacity", self.capacity, limit, "100 000 to a million are usual."));
        }
        if self.learning_starts >= self.capacity {
            let limit = format!("below replay.capacity, {}", self.capacity);
            return Err(Error::limit(
                "replay.learning_starts",
                self.learning_starts,
                limit,
                "A few thousand are usual.",
            ));
        }
        self.n_step.validate("replay.n_step")?;
        for n in [self.n_step.at(0.0), self.n_step.at(1.0)] {
            if !(1.0..=MAX_N_STEP).contains(&n) {
                return Err(Error::limit("replay.n_step", n, format!("1 to {MAX_N_STEP}"), "1 to 10 are usual."));
            }
        }
        for (what, x) in [("replay.priority", self.priority), ("replay.beta", self.beta)] {
            if !(0.0..=1.0).contains(&x) {
                return Err(Error::value(what, x, "within [0, 1]", "0 or 0.6, and 0.4, are usual."));
            }
        }
        Ok(())
    }

    /// As [`ReplayConfig::validate`], for so many environments.
    ///
    /// # Errors
    /// As there; [`Error::Limit`] for rings that are too short for a target.
    pub fn validate_for(&self, n_env: usize) -> Result<()> {
        self.validate()?;
        let most = self.n_step.at(0.0).max(self.n_step.at(1.0)).round() as usize;
        let least = n_env.saturating_mul(2 * most + 1);
        if self.capacity < least {
            let limit = format!("≥ {least} for {n_env} environments");
            return Err(Error::limit("replay.capacity", self.capacity, limit, "Keep more, or fly fewer environments."));
        }
        Ok(())
    }

    /// Slots of rings for so many environments: one more than whole steps.
    pub fn slots(&self, n_env: usize) -> usize {
        self.capacity.div_ceil(n_env.max(1)) + 1
    }

    /// Whether the rings of `n` shards like the one of `spec` fit, twice: a checkpoint is made of a copy.
    ///
    /// # Errors
    /// [`Error::Limit`] if they do not; as `ReplayCode::of`.
    pub fn fits(&self, spec: &Spec, n: usize, central: bool) -> Result<()> {
        let rows = self.slots(spec.n_env * n) as u128 * (spec.n_env * n) as u128;
        let widths = Widths::of(spec, central);
        // what is seen last in an episode, and a tree of sums over priorities
        let lasts =
            4 * (widths.seen() + widths.n_state) as u128 * (rows / spec.horizon.max(1) as u128 + spec.n_env as u128);
        let tree = if self.priority > 0.0 { 32 * widths.n_agent as u128 * rows } else { 0 };
        let bytes = 2 * (widths.bytes(&ReplayCode::of(spec, self.images)?) * rows + lasts) + tree;
        within_memory("replay.capacity", self.capacity, bytes, spec.config.memory_limit)
    }
}

/// Widths of what an environment shows and takes in a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Widths {
    /// Agents, A.
    pub n_agent: usize,
    /// Numbers that one agent sees.
    pub n_observation: usize,
    /// Numbers of one agent's action.
    pub n_action: usize,
    /// Numbers of the central state that are kept; 0 for none.
    pub n_state: usize,
}

impl Widths {
    /// Of an environment; with its central state, where `central` asks for it.
    pub fn of(spec: &Spec, central: bool) -> Self {
        Self {
            n_agent: spec.n_agent,
            n_observation: spec.n_observation,
            n_action: spec.action.len(),
            n_state: if central { spec.n_central } else { 0 },
        }
    }

    /// Numbers that all agents see.
    pub fn seen(&self) -> usize {
        self.n_agent * self.n_observation
    }

    /// Numbers that all agents do.
    pub fn done(&self) -> usize {
        self.n_agent * self.n_action
    }

    /// Bytes of one environment's step.
    fn bytes(&self, code: &ReplayCode) -> u128 {
        (self.n_agent * code.bytes() + 4 * (self.done() + self.n_state + self.n_agent) + 5) as u128
    }
}

/// How a step ended.
mod end {
    pub const NOT: u8 = 0;
    /// By the task: nothing follows.
    pub const TERMINATED: u8 = 1;
    /// By the clock: what was seen last stands aside.
    pub const TRUNCATED: u8 = 2;
}

/// Nothing kept aside.
const NONE: u32 = u32::MAX;

/// The steps of one shard.
#[derive(Debug, Clone)]
pub struct Ring {
    widths: Widths,
    n_env: usize,
    slots: usize,
    /// Where the next step goes: what is seen now stands there already.
    head: usize,
    /// Whole steps behind it.
    len: usize,
    observation: Seen,
    state: Vec<f32>,
    action: Vec<f32>,
    reward: Vec<f32>,
    end: Vec<u8>,
    /// Of steps that time ended: which of the last observations is theirs.
    last: Vec<u32>,
    /// Rows of observations, then of the state, with places that are free again.
    lasts: Vec<f32>,
    free: Vec<u32>,
}

/// Where a step's value comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Path {
    /// What is seen behind it.
    pub next: Next,
    /// γᵏ for a path of k steps, 0 where nothing follows.
    pub discount: f32,
    /// Steps, k.
    pub steps: usize,
}

/// What is seen behind a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Next {
    /// In this slot.
    Slot(usize),
    /// Kept aside.
    Aside(usize),
}

impl Ring {
    /// For `n_env` environments and `slots` steps, one of which is the one that is being flown.
    pub fn new(widths: Widths, code: ReplayCode, n_env: usize, slots: usize) -> Self {
        let rows = slots * n_env;
        Self {
            observation: Seen::new(code, rows * widths.n_agent),
            state: vec![0.0; rows * widths.n_state],
            action: vec![0.0; rows * widths.done()],
            reward: vec![0.0; rows * widths.n_agent],
            end: vec![end::NOT; rows],
            last: vec![NONE; rows],
            lasts: Vec::new(),
            free: Vec::new(),
            head: 0,
            len: 0,
            widths,
            n_env,
            slots,
        }
    }

    /// Environments.
    pub fn n_env(&self) -> usize {
        self.n_env
    }

    /// Whole steps that each of them has here.
    pub fn kept(&self) -> usize {
        self.len
    }

    /// The slot of what is seen now.
    pub fn head(&self) -> usize {
        self.head
    }

    /// The slot of the `k`-th step, the oldest first.
    pub fn slot(&self, k: usize) -> usize {
        (self.head + self.slots - self.len + k) % self.slots
    }

    /// Begins with what environments show first.
    pub fn begin(&mut self, out: &Buffers) {
        let row = self.head * self.n_env;
        self.observation.put(row * self.widths.n_agent, &out.observation);
        if self.widths.n_state > 0 {
            self.state[row * self.widths.n_state..][..out.central.len()].copy_from_slice(&out.central);
        }
    }

    /// Where what is done now goes.
    pub fn actions_mut(&mut self) -> &mut [f32] {
        let done = self.widths.done() * self.n_env;
        &mut self.action[self.head * done..][..done]
    }

    /// What was seen in all steps that are kept, and is seen now.
    #[cfg(test)]
    pub fn observations(&self) -> &[f32] {
        let slots = if self.len + 1 < self.slots { self.len + 1 } else { self.slots };
        &self.observation.floats[..slots * self.n_env * self.widths.seen()]
    }

    /// Changes every observation that is kept, of each agent.
    pub fn each_observation(&mut self, mut change: impl FnMut(&mut [f32])) {
        let (seen, own) = (self.widths.seen(), self.widths.n_observation);
        self.observation.each(&mut change);
        for last in self.lasts.chunks_exact_mut(seen + self.widths.n_state) {
            last[..seen].chunks_exact_mut(own).for_each(&mut change);
        }
    }

    /// What has just been done.
    pub fn actions(&self) -> &[f32] {
        let done = self.widths.done() * self.n_env;
        &self.action[self.head * done..][..done]
    }

    /// The step that wrote `out`: the ring goes on with what it shows.
    pub fn push(&mut self, out: &Buffers) {
        let (w, first) = (self.widths, self.head * self.n_env);
        self.reward[first * w.n_agent..][..out.reward.len()].copy_from_slice(&out.reward);
        for i in 0..self.n_env {
            let row = first + i;
            self.end[row] = match (out.terminated[i], out.truncated[i]) {
                (0, 0) => end::NOT,
                (0, _) => end::TRUNCATED,
                _ => end::TERMINATED,
            };
            if self.end[row] == end::TRUNCATED {
                self.last[row] = self.keep_aside(
                    &out.final_observation[i * w.seen()..][..w.seen()],
                    if w.n_state > 0 { &out.final_central[i * w.n_state..][..w.n_state] } else { &[] },
                );
            }
        }
        self.head = (self.head + 1) % self.slots;
        self.len = (self.len + 1).min(self.slots - 1);
        let oldest = self.head * self.n_env;
        for row in oldest..oldest + self.n_env {
            if self.last[row] != NONE {
                self.free.push(std::mem::replace(&mut self.last[row], NONE));
                self.end[row] = end::NOT;
            }
        }
        self.begin(out);
    }

    fn keep_aside(&mut self, observation: &[f32], state: &[f32]) -> u32 {
        let width = observation.len() + state.len();
        let place = self.free.pop().unwrap_or_else(|| {
            let n = self.lasts.len() / width;
            self.lasts.resize((n + 1) * width, 0.0);
            n as u32
        });
        let own = &mut self.lasts[place as usize * width..][..width];
        own[..observation.len()].copy_from_slice(observation);
        own[observation.len()..].copy_from_slice(state);
        place
    }

    /// From the step in `slot` of environment `env` on, up to `n` steps as far as they are known and of one episode: the
    /// discounted rewards Σ γʲ rⱼ of every agent are added to `reward`, and what follows is told.
    pub fn path(&self, slot: usize, env: usize, n: usize, discount: f64, reward: &mut [f32]) -> Path {
        let known = (self.head + self.slots - slot) % self.slots;
        let mut weight = 1.0;
        let mut at = slot;
        for k in 1..=n.min(known) {
            let row = at * self.n_env + env;
            let own = &self.reward[row * self.widths.n_agent..][..self.widths.n_agent];
            reward.iter_mut().zip(own).for_each(|(sum, r)| *sum += weight as f32 * r);
            weight *= discount;
            at = (at + 1) % self.slots;
            let ended = |next, discount: f64| Path { next, discount: discount as f32, steps: k };
            match self.end[row] {
                end::TERMINATED => return ended(Next::Slot(slot), 0.0),
                end::TRUNCATED => return ended(Next::Aside(self.last[row] as usize), weight),
                _ => (),
            }
        }
        Path { next: Next::Slot(at), discount: weight as f32, steps: n.min(known) }
    }

    /// Writes what `agents` of `env` saw in `slot`.
    pub fn observation(&self, slot: usize, env: usize, agents: &Range<usize>, to: &mut [f32]) {
        self.observation.get((slot * self.n_env + env) * self.widths.n_agent + agents.start, to);
    }

    /// What they did.
    pub fn action(&self, slot: usize, env: usize) -> &[f32] {
        &self.action[(slot * self.n_env + env) * self.widths.done()..][..self.widths.done()]
    }

    /// The central state.
    pub fn state(&self, slot: usize, env: usize) -> &[f32] {
        &self.state[(slot * self.n_env + env) * self.widths.n_state..][..self.widths.n_state]
    }

    /// Writes what `agents` saw behind a path, and gives the central state.
    pub fn next(&self, next: Next, env: usize, agents: &Range<usize>, to: &mut [f32]) -> &[f32] {
        match next {
            Next::Slot(slot) => {
                self.observation(slot, env, agents, to);
                self.state(slot, env)
            }
            Next::Aside(k) => {
                let (width, own) = (self.widths.seen() + self.widths.n_state, self.widths.n_observation);
                let (seen, state) = self.lasts[k * width..][..width].split_at(self.widths.seen());
                to.copy_from_slice(&seen[agents.start * own..agents.end * own]);
                state
            }
        }
    }

    /// For tests: another story in place of what was flown. For each environment `tell` writes what is seen in a slot and gives,
    /// of what was done there, the reward and whether it ended; the last slot is seen only.
    #[cfg(test)]
    pub fn retell(&mut self, mut tell: impl FnMut(usize, &mut [f32], &[f32]) -> (f32, bool)) {
        let (seen, done, agents) = (self.widths.seen(), self.widths.done(), self.widths.n_agent);
        for env in 0..self.n_env {
            for k in 0..=self.len {
                let row = self.slot(k) * self.n_env + env;
                let (reward, ended) =
                    tell(env, &mut self.observation.floats[row * seen..][..seen], &self.action[row * done..][..done]);
                self.reward[row * agents..][..agents].fill(reward);
                self.end[row] = if ended { end::TERMINATED } else { end::NOT };
                self.state[row * self.widths.n_state..][..self.widths.n_state].fill(1.0);
            }
        }
    }

    /// Bytes that a checkpoint takes for it.
    pub fn saved_bytes(&self) -> u64 {
        let numbers = [&self.observation.floats, &self.state, &self.action, &self.reward, &self.lasts];
        let places = self.last.len() + self.free.len() + 2;
        let numbers = numbers.iter().map(|x| x.len()).sum::<usize>();
        (4 * numbers + self.observation.bytes.len() + self.end.len() + 8 * places) as u64
    }

    /// Into a checkpoint, as `replay.<k>.…`.
    ///
    /// # Errors
    /// None for a number that is used once.
    pub fn save(&self, k: usize, to: &mut Tensors) -> Result<()> {
        let name = |what: &str| format!("{KEPT}{k}.{what}");
        for (what, x) in [
            ("observation", &self.observation.floats),
            ("state", &self.state),
            ("action", &self.action),
            ("reward", &self.reward),
            ("lasts", &self.lasts),
        ] {
            to.insert(name(what), &[x.len()], x.clone())?;
        }
        let bytes = &self.observation.bytes;
        if !bytes.is_empty() {
            to.insert(name("bytes"), &[bytes.len()], bytes.clone())?;
        }
        to.insert(name("end"), &[self.end.len()], self.end.clone())?;
        for (what, places) in [("last", &self.last), ("free", &self.free)] {
            to.insert(name(what), &[places.len()], places.iter().map(|x| u64::from(*x)).collect::<Vec<_>>())?;
        }
        to.insert(name("place"), &[2], vec![self.head as u64, self.len as u64])
    }

    /// As saved.
    ///
    /// # Errors
    /// As [`Tensors::get`]; [`Error::Value`] for places outside the ring.
    pub fn load(&mut self, k: usize, from: &Tensors) -> Result<()> {
        let name = |what: &str| format!("{KEPT}{k}.{what}");
        let count = |what: &str| Ok::<usize, Error>(from.tensor(&name(what))?.shape().iter().product());
        let place = from.get::<u64>(&name("place"), &[2])?.to_vec();
        let (head, len) = (place[0] as usize, place[1] as usize);
        let n_free = count("free")?;
        let free = from.get::<u64>(&name("free"), &[n_free])?;
        let last = from.get::<u64>(&name("last"), &[self.last.len()])?;
        let end = from.get::<u8>(&name("end"), &[self.end.len()])?;
        let width = self.widths.seen() + self.widths.n_state;
        let n_lasts = count("lasts")?;
        let kept = n_lasts / width;
        let outside = |place: &u64| *place >= kept as u64;
        let aside = |end: u8| end == end::TRUNCATED;
        let lost = |(end, place): (&u8, &u64)| if aside(*end) { outside(place) } else { *place != u64::from(NONE) };
        let mut used = vec![false; kept];
        let places = free.iter().chain(last).filter(|place| !outside(place));
        let twice = places.fold(false, |twice, place| twice | std::mem::replace(&mut used[*place as usize], true));
        if twice
            || head >= self.slots
            || len >= self.slots
            || free.iter().any(outside)
            || end.iter().zip(last).any(lost)
        {
            let remedy = "The checkpoint is damaged or forged: go on from an earlier one.";
            return Err(Error::value(name("place"), format!("{head}, {len}"), "places within the ring", remedy));
        }
        for (what, own) in [
            ("observation", &mut self.observation.floats),
            ("state", &mut self.state),
            ("action", &mut self.action),
            ("reward", &mut self.reward),
        ] {
            let n = own.len();
            own.copy_from_slice(from.get::<f32>(&name(what), &[n])?);
        }
        let bytes = &mut self.observation.bytes;
        let n = bytes.len();
        if n > 0 {
            bytes.copy_from_slice(from.get::<u8>(&name("bytes"), &[n])?);
        }
        self.lasts = from.get::<f32>(&name("lasts"), &[n_lasts])?.to_vec();
        self.free = free.iter().map(|x| *x as u32).collect();
        self.last = last.iter().map(|x| *x as u32).collect();
        self.end.copy_from_slice(end);
        (self.head, self.len) = (head, len);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
