//! Replay buffer of off-policy learners: a ring of whole steps of a batch, with n-step returns formed when sampled.
//!
//! The ring holds `[slot, E, A]` rows, so what followed a row stands one slot behind it. A sample that begins at step t
//! of one environment is
//!
//! ```text
//! reward   = Σ_{k<m} γᵏ r_{t+k}
//! discount = γᵐ (1 − terminated_{t+m−1})
//! target   = reward + discount · V(next_observation)        next_observation behind step t + m − 1
//! ```
//!
//! with m = n steps (Sutton and Barto 2018, section 7.1), or fewer where the episode ended, by death or by time, or
//! where the newest step is reached: such a target is of fewer steps, and right. Rewards are never summed over an end.

use crate::error::{Error, Result, finite};
use crate::rng::Stream;
use serde::{Deserialize, Serialize};

/// What a buffer keeps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReplayConfig {
    /// Most transitions, of all environments and agents; rounded down to whole steps of the batch.
    pub capacity: usize,
    /// n, steps of a return.
    pub n_step: usize,
    /// γ per step.
    pub gamma: f64,
    /// Most memory of the buffer, and of a batch, bytes.
    pub memory_limit: u64,
}

impl Default for ReplayConfig {
    fn default() -> Self {
        Self { capacity: 1 << 20, n_step: 1, gamma: 0.99, memory_limit: 4 << 30 }
    }
}

/// Most steps of a return.
const MAX_N_STEP: usize = 1024;

impl ReplayConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] and [`Error::Limit`] with the rule.
    pub fn validate(&self) -> Result<()> {
        if self.capacity == 0 {
            return Err(Error::value("capacity", 0, "at least 1 transition", "A million is usual."));
        }
        if !(1..=MAX_N_STEP).contains(&self.n_step) {
            return Err(Error::limit("n_step", self.n_step, format!("1 to {MAX_N_STEP}"), "1 to 5 are usual."));
        }
        finite("gamma", &[self.gamma])?;
        if !(0.0..=1.0).contains(&self.gamma) {
            return Err(Error::value("gamma", self.gamma, "in [0, 1]", "0.99 is usual."));
        }
        Ok(())
    }
}

/// Sizes of one step of a batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StepShape {
    /// E.
    pub n_env: usize,
    /// A: rows of an environment, which share its flags. 1 where a row is of a whole team.
    pub n_agent: usize,
    /// Numbers of a row's observation.
    pub n_observation: usize,
    /// Numbers of a row's action.
    pub n_action: usize,
}

impl StepShape {
    /// Rows of a step, or as many as can be counted.
    fn rows(&self) -> usize {
        self.n_env.saturating_mul(self.n_agent)
    }

    /// Bytes of one row in the buffer; its share of the flags counts as a number.
    fn row_bytes(&self) -> u128 {
        let floats = 2 * self.n_observation as u128 + self.n_action as u128 + 2;
        floats * size_of::<f32>() as u128
    }
}

/// Steps of a batch, one or several, row-major.
#[derive(Debug, Clone, Copy)]
pub struct Transitions<'a> {
    /// `[T, E, A, observation]`: what was acted on.
    pub observation: &'a [f32],
    /// `[T, E, A, action]`.
    pub action: &'a [f32],
    /// `[T, E, A]`.
    pub reward: &'a [f32],
    /// `[T, E, A, observation]`: behind the step, the true last one where the episode ended.
    pub next_observation: &'a [f32],
    /// `[T, E]`: not 0 where the task ended the episode. Wins over `truncated`.
    pub terminated: &'a [u8],
    /// `[T, E]`: not 0 where its time was over.
    pub truncated: &'a [u8],
}

/// Sampled rows, owned by the caller; arrays grow to the largest sample and are then reused.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Batch {
    /// `[row, observation]` at the first step.
    pub observation: Vec<f32>,
    /// `[row, action]` at the first step.
    pub action: Vec<f32>,
    /// `[row]`: discounted sum over the m steps.
    pub reward: Vec<f32>,
    /// `[row, observation]` behind the last step.
    pub next_observation: Vec<f32>,
    /// `[row]`: what V of the next observation counts, γᵐ, or 0 where the task ended the episode.
    pub discount: Vec<f32>,
}

/// What stands behind a step: the next one of its episode, ...
const GOES_ON: u8 = 0;
/// ... another episode, though this one had not ended for the task, ...
const CUT: u8 = 1;
/// ... or nothing.
const DEAD: u8 = 2;

/// The ring. See the module for its samples.
#[derive(Debug, Clone)]
pub struct Replay {
    shape: StepShape,
    config: ReplayConfig,
    /// Steps that fit, steps that are there, where the next one goes.
    n_slot: usize,
    filled: usize,
    write: usize,
    observation: Vec<f32>,
    action: Vec<f32>,
    reward: Vec<f32>,
    next_observation: Vec<f32>,
    /// `[slot, E]`.
    end: Vec<u8>,
}

impl Replay {
    /// An empty buffer. All its memory is taken now, so that a learner that fits at its start fits at its end.
    ///
    /// # Errors
    /// As [`ReplayConfig::validate`]; [`Error::Limit`] where a step does not fit into the capacity or the capacity not
    /// into the memory, before anything is allocated, and where the system refuses the memory.
    pub fn new(shape: StepShape, config: ReplayConfig) -> Result<Self> {
        config.validate()?;
        let rows = shape.rows();
        if rows == 0 || rows > config.capacity {
            let remedy = "Raise capacity to several steps, or step fewer environments.";
            return Err(Error::limit(
                "rows of a step, n_env · n_agent",
                rows,
                format!("1 to {}", config.capacity),
                remedy,
            ));
        }
        let n_slot = config.capacity / rows;
        let n = n_slot * rows;
        check_memory("capacity", n, shape, config.memory_limit)?;
        Ok(Self {
            shape,
            n_slot,
            filled: 0,
            write: 0,
            observation: reserved(n * shape.n_observation, 0.0)?,
            action: reserved(n * shape.n_action, 0.0)?,
            reward: reserved(n, 0.0)?,
            next_observation: reserved(n * shape.n_observation, 0.0)?,
            end: reserved(n_slot * shape.n_env, GOES_ON)?,
            config,
        })
    }

    /// Rows that are there.
    pub fn len(&self) -> usize {
        self.filled * self.shape.rows()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.filled == 0
    }

    /// Rows that fit.
    pub fn capacity(&self) -> usize {
        self.n_slot * self.shape.rows()
    }

    /// Appends T ≥ 0 steps, each behind the one before it; the oldest make way.
    ///
    /// # Errors
    /// [`Error::Value`] for arrays of other sizes; nothing is stored then.
    pub fn push(&mut self, new: &Transitions<'_>) -> Result<()> {
        let (rows, n_env) = (self.shape.rows(), self.shape.n_env);
        let (o, a) = (rows * self.shape.n_observation, rows * self.shape.n_action);
        let n = new.reward.len() / rows;
        for (what, got, step) in [
            ("reward", new.reward.len(), rows),
            ("observation", new.observation.len(), o),
            ("action", new.action.len(), a),
            ("next_observation", new.next_observation.len(), o),
            ("terminated", new.terminated.len(), n_env),
            ("truncated", new.truncated.len(), n_env),
        ] {
            if got != n * step {
                let limit = format!("{} ({n} steps of {step})", n * step);
                return Err(Error::value(format!("length of {what}"), got, limit, "Give whole steps of all rows."));
            }
        }
        for t in 0..n {
            let slot = self.write;
            copy_part(&mut self.observation, slot, new.observation, t, o);
            copy_part(&mut self.action, slot, new.action, t, a);
            copy_part(&mut self.reward, slot, new.reward, t, rows);
            copy_part(&mut self.next_observation, slot, new.next_observation, t, o);
            let flags = new.terminated.iter().zip(new.truncated).skip(t * n_env);
            for (end, (terminated, truncated)) in self.end[slot * n_env..(slot + 1) * n_env].iter_mut().zip(flags) {
                *end = if *terminated != 0 { DEAD } else { u8::from(*truncated != 0) * CUT };
            }
            self.write = (slot + 1) % self.n_slot;
            self.filled = (self.filled + 1).min(self.n_slot);
        }
        Ok(())
    }

    /// Says that the next step pushed does not follow the last one: the environments were reset or restored by hand.
    pub fn cut(&mut self) {
        if self.filled == 0 {
            return;
        }
        let slot = (self.write + self.n_slot - 1) % self.n_slot;
        for end in &mut self.end[slot * self.shape.n_env..(slot + 1) * self.shape.n_env] {
            *end = (*end).max(CUT);
        }
    }

    /// Draws `n` rows with replacement, each stored row as likely as any other, one number of the stream per row.
    ///
    /// # Errors
    /// [`Error::Value`] for an empty buffer; [`Error::Limit`] for no rows or more than fit into the memory.
    pub fn sample(&self, n: usize, stream: &mut Stream, batch: &mut Batch) -> Result<()> {
        if self.is_empty() {
            return Err(Error::value("rows in the replay buffer", 0, "at least 1", "Push a step before sampling."));
        }
        check_memory("rows of a batch", n, self.shape, self.config.memory_limit)?;
        let (o, a) = (self.shape.n_observation, self.shape.n_action);
        batch.observation.resize(n * o, 0.0);
        batch.action.resize(n * a, 0.0);
        batch.reward.resize(n, 0.0);
        batch.next_observation.resize(n * o, 0.0);
        batch.discount.resize(n, 0.0);
        for i in 0..n {
            let place = stream.below(self.len() as u64) as usize;
            let (age, row) = (place / self.shape.rows(), place % self.shape.rows());
            let (last, reward, discount) = self.follow(age, row);
            let first = self.at(age, row);
            copy_part(&mut batch.observation, i, &self.observation, first, o);
            copy_part(&mut batch.action, i, &self.action, first, a);
            copy_part(&mut batch.next_observation, i, &self.next_observation, last, o);
            (batch.reward[i], batch.discount[i]) = (reward as f32, discount as f32);
        }
        Ok(())
    }

    /// Place of a row of the step that is `age` steps younger than the oldest.
    fn at(&self, age: usize, row: usize) -> usize {
        let slot = (self.write + self.n_slot - self.filled + age) % self.n_slot;
        slot * self.shape.rows() + row
    }

    /// Place of the last step of the return that begins there, its reward and its discount.
    fn follow(&self, first: usize, row: usize) -> (usize, f64, f64) {
        let (mut reward, mut weight) = (0.0, 1.0);
        let newest = (first + self.config.n_step).min(self.filled) - 1;
        let mut age = first;
        loop {
            let at = self.at(age, row);
            let end = self.end[at / self.shape.n_agent];
            reward += weight * f64::from(self.reward[at]);
            weight *= self.config.gamma;
            if end != GOES_ON || age == newest {
                return (at, reward, if end == DEAD { 0.0 } else { weight });
            }
            age += 1;
        }
    }
}

/// `to[i] = from[j]` for rows of `width` numbers.
fn copy_part(to: &mut [f32], i: usize, from: &[f32], j: usize, width: usize) {
    to[i * width..(i + 1) * width].copy_from_slice(&from[j * width..(j + 1) * width]);
}

fn check_memory(what: &str, rows: usize, shape: StepShape, limit: u64) -> Result<()> {
    let needed = (rows as u128).saturating_mul(shape.row_bytes());
    if rows > 0 && needed <= u128::from(limit) && isize::try_from(needed).is_ok() {
        return Ok(());
    }
    let gib = |x: f64| x / f64::from(1 << 30);
    Err(Error::limit(
        what,
        format!("{rows} ({:.2} GiB)", gib(needed as f64)),
        format!("1 to {} ({:.2} GiB)", u128::from(limit) / shape.row_bytes(), gib(limit as f64)),
        "Lower it, or raise memory_limit.",
    ))
}

fn reserved<T: Copy>(n: usize, x: T) -> Result<Vec<T>> {
    let mut all = Vec::new();
    let refuse = |e| Error::limit("numbers of the replay buffer", n, "what the system gives", format!("It said: {e}."));
    all.try_reserve_exact(n).map_err(refuse)?;
    all.resize(n, x);
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Purpose;

    const SHAPE: StepShape = StepShape { n_env: 3, n_agent: 2, n_observation: 4, n_action: 2 };
    const ROWS: usize = 6;

    fn config(slots: usize, n_step: usize) -> ReplayConfig {
        ReplayConfig { capacity: slots * ROWS + ROWS - 1, n_step, gamma: 0.9, ..Default::default() }
    }

    fn stream(n: u64) -> Stream {
        Stream::new(3, n, 0, Purpose::LEARNING)
    }

    /// Everything that ever happened. Row r of step t observes [t, r, ..] and [t + ½, r, ..] behind it.
    struct History {
        observation: Vec<f32>,
        action: Vec<f32>,
        reward: Vec<f32>,
        next_observation: Vec<f32>,
        terminated: Vec<u8>,
        truncated: Vec<u8>,
    }

    impl History {
        fn random(steps: usize, ends: f64) -> Self {
            let mut s = stream(0);
            let places = || (0..steps * ROWS).map(|i| ((i / ROWS) as f32, (i % ROWS) as f32));
            let reward = (0..steps * ROWS).map(|_| s.normal() as f32).collect();
            let mut flags = || (0..steps * SHAPE.n_env).map(|_| u8::from(s.unit() < ends)).collect();
            Self {
                observation: places().flat_map(|(t, r)| [t, r, -t, 7.0]).collect(),
                action: places().flat_map(|(t, r)| [t + 0.25, r]).collect(),
                reward,
                next_observation: places().flat_map(|(t, r)| [t + 0.5, r, -t, 8.0]).collect(),
                terminated: flags(),
                truncated: flags(),
            }
        }

        fn steps(&self, from: usize, to: usize) -> Transitions<'_> {
            Transitions {
                observation: &self.observation[from * ROWS * 4..to * ROWS * 4],
                action: &self.action[from * ROWS * 2..to * ROWS * 2],
                reward: &self.reward[from * ROWS..to * ROWS],
                next_observation: &self.next_observation[from * ROWS * 4..to * ROWS * 4],
                terminated: &self.terminated[from * 3..to * 3],
                truncated: &self.truncated[from * 3..to * 3],
            }
        }

        /// Reward, discount, last step and why it was the last: 0 all n, 1 death, 2 time, 3 the newest step. `leaks`
        /// runs over time-outs.
        fn brute(&self, t: usize, row: usize, n: usize, newest: usize, leaks: bool) -> (f64, f64, usize, usize) {
            let (mut reward, env) = (0.0, row / SHAPE.n_agent);
            for k in 0.. {
                let flag = (t + k) * SHAPE.n_env + env;
                reward += 0.9_f64.powi(k as i32) * f64::from(self.reward[(t + k) * ROWS + row]);
                let discount = 0.9_f64.powi(k as i32 + 1);
                if self.terminated[flag] != 0 {
                    return (reward, 0.0, t + k, 1);
                }
                if self.truncated[flag] != 0 && !leaks {
                    return (reward, discount, t + k, 2);
                }
                if k + 1 == n || t + k == newest {
                    return (reward, discount, t + k, if k + 1 == n { 0 } else { 3 });
                }
            }
            unreachable!()
        }
    }

    fn sample(replay: &Replay, n: usize) -> Batch {
        let mut batch = Batch::default();
        replay.sample(n, &mut stream(1), &mut batch).unwrap();
        batch
    }

    #[test]
    fn returns_match_brute_force_at_ends_at_the_wrap_and_at_the_newest_step() {
        let history = History::random(40, 0.1);
        for n_step in [1, 3, 8, 100] {
            let mut replay = Replay::new(SHAPE, config(9, n_step)).unwrap();
            let mut reasons = [0; 4];
            let mut leak = 0.0_f64;
            for step in 0..40 {
                replay.push(&history.steps(step, step + 1)).unwrap();
                let batch = sample(&replay, 300);
                for i in 0..300 {
                    let (t, row) = (batch.observation[4 * i] as usize, batch.observation[4 * i + 1] as usize);
                    let (reward, discount, last, reason) = history.brute(t, row, n_step, step, false);
                    assert!((f64::from(batch.reward[i]) - reward).abs() < 1e-6, "step {t}, row {row}"); // 3e-7
                    assert!((f64::from(batch.discount[i]) - discount).abs() < 1e-7, "step {t}, row {row}"); // 3e-8
                    let (l, r) = (last as f32, row as f32);
                    assert_eq!(batch.observation[4 * i..][..4], [t as f32, r, -(t as f32), 7.0]);
                    assert_eq!(batch.action[2 * i..][..2], [t as f32 + 0.25, r]);
                    assert_eq!(batch.next_observation[4 * i..][..4], [l + 0.5, r, -l, 8.0]);
                    reasons[reason] += 1;
                    leak = leak.max((history.brute(t, row, n_step, step, true).0 - reward).abs());
                }
            }
            // every way to end was met, and the twin that sums over time-outs differs
            let possible = [n_step < 9, true, true, n_step > 1];
            assert_eq!(reasons.map(|n| n > 0), possible, "n_step {n_step}: {reasons:?}");
            assert_eq!(leak > 0.5, n_step > 1, "n_step {n_step}: {leak}");
        }
    }

    #[test]
    fn a_full_ring_holds_exactly_the_last_steps() {
        let history = History::random(25, 0.0);
        let mut replay = Replay::new(SHAPE, config(9, 1)).unwrap();
        assert_eq!((replay.len(), replay.capacity(), replay.is_empty()), (0, 54, true));
        for step in 0..25 {
            replay.push(&history.steps(step, step + 1)).unwrap();
            assert_eq!(replay.len(), ROWS * (step + 1).min(9));
            let batch = sample(&replay, 1000);
            let mut seen = [false; 25 * ROWS];
            batch.observation.chunks_exact(4).for_each(|o| seen[o[0] as usize * ROWS + o[1] as usize] = true);
            for (place, seen) in seen.iter().enumerate() {
                let t = place / ROWS;
                assert_eq!(*seen, t <= step && t + 9 > step, "step {t} of {step}");
            }
        }
    }

    #[test]
    fn many_steps_pushed_at_once_equal_steps_one_by_one() {
        let history = History::random(25, 0.2);
        let mut single = Replay::new(SHAPE, config(9, 3)).unwrap();
        let mut several = single.clone();
        (0..25).for_each(|t| single.push(&history.steps(t, t + 1)).unwrap());
        several.push(&history.steps(0, 0)).unwrap();
        several.push(&history.steps(0, 14)).unwrap();
        several.push(&history.steps(14, 25)).unwrap();
        assert_eq!(sample(&single, 500), sample(&several, 500));
    }

    #[test]
    fn rows_are_drawn_uniformly() {
        let history = History::random(13, 0.3);
        let mut replay = Replay::new(SHAPE, config(9, 3)).unwrap();
        replay.push(&history.steps(0, 13)).unwrap();
        let n = 54_000;
        let mut counts = [0.0; 9 * ROWS];
        for o in sample(&replay, n).observation.chunks_exact(4) {
            counts[(o[0] as usize - 4) * ROWS + o[1] as usize] += 1.0;
        }
        // 53 degrees of freedom: mean 53, deviation 10.3; 39.5 here
        let chi_square: f64 = counts.iter().map(|c| (c - 1000.0_f64).powi(2) / 1000.0).sum();
        assert!((20.0..95.0).contains(&chi_square), "{chi_square}");
    }

    #[test]
    fn returns_do_not_run_over_a_cut() {
        let history = History::random(6, 0.0);
        let mut replay = Replay::new(SHAPE, config(9, 4)).unwrap();
        replay.cut();
        replay.push(&history.steps(0, 3)).unwrap();
        replay.cut();
        replay.push(&history.steps(3, 6)).unwrap();
        let batch = sample(&replay, 300);
        for (o, next) in batch.observation.chunks_exact(4).zip(batch.next_observation.chunks_exact(4)) {
            assert_eq!(next[0], if o[0] < 3.0 { 2.5 } else { 5.5 });
        }
        assert!(batch.discount.iter().all(|d| *d > 0.7));
    }

    #[test]
    fn sampling_again_allocates_nothing() {
        let mut replay = Replay::new(SHAPE, config(9, 3)).unwrap();
        replay.push(&History::random(9, 0.1).steps(0, 9)).unwrap();
        let mut batch = sample(&replay, 64);
        let place =
            |b: &Batch| [&b.observation, &b.action, &b.reward, &b.next_observation, &b.discount].map(|x| x.as_ptr());
        let before = place(&batch);
        for n in [64, 10, 64] {
            replay.sample(n, &mut stream(2), &mut batch).unwrap();
            assert_eq!((place(&batch), batch.reward.len(), batch.action.len()), (before, n, 2 * n));
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_before_it_is_allocated() {
        let text = |shape: StepShape, config: ReplayConfig| Replay::new(shape, config).unwrap_err().to_string();
        let huge = ReplayConfig { capacity: usize::MAX, ..Default::default() };
        let told = text(SHAPE, huge.clone());
        assert!(told.starts_with("capacity is 18446744073709551612 (") && told.contains("1 to 89478485 (4.00 GiB)"));
        assert!(told.ends_with("Lower it, or raise memory_limit."), "{told}");
        // and where the limit itself is beyond the machine
        assert!(text(SHAPE, ReplayConfig { memory_limit: u64::MAX, ..huge.clone() }).starts_with("capacity is"));
        let wide = StepShape { n_observation: usize::MAX, ..SHAPE };
        assert!(text(wide, config(9, 1)).starts_with("capacity is 54"));
        let few = ReplayConfig { capacity: 5, ..Default::default() };
        assert!(text(SHAPE, few).starts_with("rows of a step, n_env · n_agent is 6, over the limit of 1 to 5"));
        let many = StepShape { n_env: usize::MAX, ..SHAPE };
        assert!(text(many, config(9, 1)).starts_with("rows of a step"));
        assert!(text(SHAPE, config(9, 0)).starts_with("n_step is 0, over the limit of 1 to 1024"));
        assert!(text(SHAPE, ReplayConfig { gamma: 1.1, ..config(9, 1) }).starts_with("gamma is 1.1"));
        assert!(text(SHAPE, ReplayConfig { gamma: f64::NAN, ..config(9, 1) }).starts_with("gamma is NaN"));
        assert!(text(SHAPE, ReplayConfig { capacity: 0, ..config(9, 1) }).starts_with("capacity is 0"));
    }

    #[test]
    fn arrays_of_other_sizes_are_named_and_change_nothing() {
        let history = History::random(4, 0.1);
        let mut replay = Replay::new(SHAPE, config(9, 1)).unwrap();
        let mut batch = Batch::default();
        let told = replay.sample(4, &mut stream(0), &mut batch).unwrap_err().to_string();
        assert!(told.starts_with("rows in the replay buffer is 0"), "{told}");
        let full = history.steps(0, 2);
        for (what, change) in [
            ("reward", Transitions { reward: &full.reward[1..], ..full }),
            ("observation", Transitions { observation: &full.observation[1..], ..full }),
            ("action", Transitions { action: &full.action[1..], ..full }),
            ("next_observation", Transitions { next_observation: &full.next_observation[1..], ..full }),
            ("terminated", Transitions { terminated: &full.terminated[1..], ..full }),
            ("truncated", Transitions { truncated: &[], ..full }),
        ] {
            let told = replay.push(&change).unwrap_err().to_string();
            assert!(told.starts_with(&format!("length of {what} is")), "{told}");
            assert!(replay.is_empty());
        }
        replay.push(&full).unwrap();
        for n in [0, usize::MAX] {
            let told = replay.sample(n, &mut stream(0), &mut batch).unwrap_err().to_string();
            assert!(told.starts_with("rows of a batch is"), "{told}");
        }
    }
}
