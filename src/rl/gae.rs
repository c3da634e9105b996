//! Generalised advantage estimation (Schulman et al. 2016) and λ-targets of critics, with time-outs that are not death.
//!
//! ```text
//! δ_t = r_t + γ (1 − terminated_t) V(next_t) − V(s_t)
//! A_t = δ_t + γ λ (1 − (terminated_t or truncated_t)) A_{t+1}
//! target_t = A_t + V(s_t)
//! ```
//!
//! next_t is the true last observation where an episode ended in the step, else the observation behind it. An episode
//! that ran out of time is valued as if it went on, but its trace ends: what follows in the row is another episode. The
//! targets are the λ-returns of TD(λ) (Sutton and Barto 2018, section 12.1), for critics that are trained without an
//! actor too.

use base::error::{Error, Result, finite};

/// What a batch of environments did, row-major: T steps of E environments of A agents, which share the flags of theirs.
#[derive(Debug, Clone, Copy)]
pub struct Steps<'a> {
    /// `[T, E, A]`.
    pub reward: &'a [f32],
    /// `[T, E, A]`: V of the observation that was acted on.
    pub value: &'a [f32],
    /// `[T, E, A]`: V of the observation behind the step, of the true last one where the episode ended. Not read where
    /// it terminated.
    pub next_value: &'a [f32],
    /// `[T, E]`: not 0 where the task ended the episode. Wins over `truncated`.
    pub terminated: &'a [u8],
    /// `[T, E]`: not 0 where its time was over.
    pub truncated: &'a [u8],
    /// E.
    pub n_env: usize,
    /// A.
    pub n_agent: usize,
}

impl Steps<'_> {
    fn check(&self, gamma: f64, lambda: f64, advantage: usize, target: usize) -> Result<()> {
        for (what, x) in [("gamma", gamma), ("lambda", lambda)] {
            finite(what, &[x])?;
            if !(0.0..=1.0).contains(&x) {
                return Err(Error::value(what, x, "in [0, 1]", "0.99 and 0.95 are usual."));
            }
        }
        let remedy = "Give arrays of [T, E] flags and [T, E, A] numbers.";
        let n = self.terminated.len();
        if self.n_env == 0 || self.n_agent == 0 || !n.is_multiple_of(self.n_env) {
            let limit = format!("T times n_env = {}, with at least 1 agent, not {}", self.n_env, self.n_agent);
            return Err(Error::value("length of terminated", n, limit, remedy));
        }
        let rows = n.saturating_mul(self.n_agent);
        let lengths = [
            ("truncated", self.truncated.len(), n),
            ("reward", self.reward.len(), rows),
            ("value", self.value.len(), rows),
            ("next_value", self.next_value.len(), rows),
            ("advantage", advantage, rows),
            ("target", target, rows),
        ];
        match lengths.iter().find(|(_, got, wanted)| got != wanted) {
            None => Ok(()),
            Some((what, got, wanted)) => {
                Err(Error::value(format!("length of {what}"), got, wanted.to_string(), remedy))
            }
        }
    }
}

/// Writes A `[T, E, A]` to `advantage` and A + V to `target`, for the discount γ and the trace's decay λ, both in [0,
/// 1].
///
/// λ = 0 gives one-step TD errors, λ = 1 returns less the value. What is not finite spreads to the steps before it in
/// its episode, and no further.
///
/// # Errors
/// [`Error::Value`] for arrays of other sizes and for γ or λ out of range.
pub fn advantages(steps: &Steps<'_>, gamma: f64, lambda: f64, advantage: &mut [f32], target: &mut [f32]) -> Result<()> {
    steps.check(gamma, lambda, advantage.len(), target.len())?;
    let (n_env, n_agent) = (steps.n_env, steps.n_agent);
    for (env, agent) in (0..n_env).flat_map(|env| (0..n_agent).map(move |agent| (env, agent))) {
        // sums stay in f64 over the whole row; each number that is written is rounded once
        let mut behind = 0.0;
        for flag in (env..steps.terminated.len()).step_by(n_env).rev() {
            let at = flag * n_agent + agent;
            let terminated = steps.terminated[flag] != 0;
            let value = f64::from(steps.value[at]);
            // choices, not products: what is cut off may be NaN
            let next_value = if terminated { 0.0 } else { f64::from(steps.next_value[at]) };
            let rest = if terminated || steps.truncated[flag] != 0 { 0.0 } else { behind };
            behind = f64::from(steps.reward[at]) + gamma * next_value - value + gamma * lambda * rest;
            advantage[at] = behind as f32;
            target[at] = (behind + value) as f32;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rng::{Purpose, Stream};

    const T: usize = 40;
    const E: usize = 7;
    const A: usize = 3;

    struct Data {
        reward: Vec<f32>,
        value: Vec<f32>,
        next_value: Vec<f32>,
        terminated: Vec<u8>,
        truncated: Vec<u8>,
    }

    impl Data {
        /// Ends in a fifth of the steps, both flags in one of twenty-five; next values of their own there.
        fn random(seed: u64) -> Self {
            let mut s = Stream::new(seed, 0, 0, Purpose::LEARNING);
            let mut numbers = || (0..T * E * A).map(|_| s.normal() as f32).collect::<Vec<_>>();
            let (reward, value, mut next_value) = (numbers(), numbers(), numbers());
            let mut flags = || (0..T * E).map(|_| u8::from(s.unit() < 0.2)).collect::<Vec<_>>();
            let (terminated, truncated) = (flags(), flags());
            for at in 0..(T - 1) * E * A {
                if terminated[at / A] == 0 && truncated[at / A] == 0 {
                    next_value[at] = value[at + E * A];
                }
            }
            Self { reward, value, next_value, terminated, truncated }
        }

        fn steps(&self) -> Steps<'_> {
            Steps {
                reward: &self.reward,
                value: &self.value,
                next_value: &self.next_value,
                terminated: &self.terminated,
                truncated: &self.truncated,
                n_env: E,
                n_agent: A,
            }
        }

        fn run(&self, gamma: f64, lambda: f64) -> (Vec<f32>, Vec<f32>) {
            let mut out = (vec![f32::NAN; T * E * A], vec![f32::NAN; T * E * A]);
            advantages(&self.steps(), gamma, lambda, &mut out.0, &mut out.1).unwrap();
            out
        }

        /// Σ_k (γλ)^k δ_{t+k} from every t on its own, in f64. `cut` says whether the trace ends at a step, `dead`
        /// whether nothing is worth anything behind it, by (terminated, truncated).
        fn brute(
            &self,
            gamma: f64,
            lambda: f64,
            cut: impl Fn(bool, bool) -> bool,
            dead: impl Fn(bool, bool) -> bool,
        ) -> Vec<f64> {
            let mut all = vec![0.0; T * E * A];
            for (at, sum) in all.iter_mut().enumerate() {
                let mut weight = 1.0;
                for k in (at..T * E * A).step_by(E * A) {
                    let flags = (self.terminated[k / A] == 1, self.truncated[k / A] == 1);
                    let next = if dead(flags.0, flags.1) { 0.0 } else { f64::from(self.next_value[k]) };
                    *sum += weight * (f64::from(self.reward[k]) + gamma * next - f64::from(self.value[k]));
                    weight *= gamma * lambda;
                    if cut(flags.0, flags.1) {
                        break;
                    }
                }
            }
            all
        }
    }

    fn worst(got: &[f32], want: &[f64]) -> f64 {
        got.iter().zip(want).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max)
    }

    /// `got` beyond the one rounding to `f32` that it is allowed, at most.
    fn beyond_rounding(got: &[f32], want: &[f64]) -> f64 {
        let past =
            |(got, want): (&f32, &f64)| (f64::from(*got) - want).abs() - want.abs() * f64::from(f32::EPSILON) / 2.0;
        got.iter().zip(want).map(past).fold(0.0, f64::max)
    }

    #[test]
    fn whole_sums_of_advantages_are_exact_to_1e_12_but_for_one_rounding() {
        for (seed, (gamma, lambda)) in [(0.99, 0.95), (0.9, 1.0), (1.0, 1.0), (0.99, 0.0)].into_iter().enumerate() {
            let data = Data::random(seed as u64);
            let (advantage, target) = data.run(gamma, lambda);
            let want = data.brute(gamma, lambda, |a, b| a | b, |a, _| a);
            let target_want: Vec<f64> = want.iter().zip(&data.value).map(|(a, v)| a + f64::from(*v)).collect();
            let error = [beyond_rounding(&advantage, &want), beyond_rounding(&target, &target_want)];
            println!("gamma {gamma}, lambda {lambda}: {error:?}");
            assert!(error.iter().all(|e| *e <= 1e-12), "gamma {gamma}, lambda {lambda}: {error:?}");
            // the rounding that is allowed is no wider than what a number of that size must have
            assert!(worst(&advantage, &want) > 1e-8 && worst(&advantage, &want) < 1e-6);
        }
    }

    #[test]
    fn the_defective_twins_differ() {
        let data = Data::random(9);
        let (advantage, _) = data.run(0.99, 0.95);
        let leaks = data.brute(0.99, 0.95, |a, _| a, |a, _| a);
        let dies = data.brute(0.99, 0.95, |a, b| a | b, |a, b| a | b);
        let truncation_wins = data.brute(0.99, 0.95, |a, b| a | b, |a, b| a & !b);
        for (name, twin) in [("leaks", leaks), ("dies", dies), ("truncation wins", truncation_wins)] {
            let far = worst(&advantage, &twin);
            assert!(far > 0.5, "{name}: {far}"); // 7.4, 2.7, 2.4
        }
    }

    #[test]
    fn values_behind_a_death_are_not_read_and_nothing_crosses_an_end() {
        let clean = Data::random(4);
        let mut data = Data::random(4);
        for at in 0..T * E * A {
            if data.terminated[at / A] == 1 {
                data.next_value[at] = f32::NAN;
            }
        }
        assert_eq!(clean.run(0.99, 0.95), data.run(0.99, 0.95));
        // a broken reward reaches back to the end before it in its own row and agent alone
        let (step, env, agent) = (30, 2, 1);
        data.reward[(step * E + env) * A + agent] = f32::NAN;
        let (advantage, _) = data.run(0.99, 0.95);
        let ended = |t: usize| data.terminated[t * E + env] == 1 || data.truncated[t * E + env] == 1;
        let first = (0..step).rev().find(|t| ended(*t)).map_or(0, |t| t + 1);
        for at in 0..T * E * A {
            let (t, own) = (at / (E * A), at % (E * A) == env * A + agent);
            assert_eq!(advantage[at].is_nan(), own && (first..=step).contains(&t), "step {t}");
        }
        assert!(first > 0);
    }

    /// Fixed point of V = target in an environment of one state with reward 1 for ever and a time limit of ten steps.
    fn fixed_point(lambda: f64, terminated: bool) -> f64 {
        let ends: Vec<u8> = (0..10).map(|t| u8::from(t == 9)).collect();
        let none = [0; 10];
        let (terminated, truncated) = if terminated { (&ends[..], &none[..]) } else { (&none[..], &ends[..]) };
        let (mut value, mut advantage, mut target) = ([0.0; 10], [0.0; 10], [0.0; 10]);
        for _ in 0..2000 {
            let reward = &[1.0; 10];
            let steps =
                Steps { reward, value: &value, next_value: &value, terminated, truncated, n_env: 1, n_agent: 1 };
            advantages(&steps, 0.99, lambda, &mut advantage, &mut target).unwrap();
            value = [target.iter().sum::<f32>() / 10.0; 10];
        }
        f64::from(value[0])
    }

    #[test]
    fn time_limits_of_ten_steps_leave_the_worth_of_an_endless_task_at_one_hundred() {
        for (lambda, as_death) in [(0.0, 1.0 / (1.0 - 0.9 * 0.99)), (1.0, 5.3382)] {
            let right = fixed_point(lambda, false);
            assert!((right - 100.0).abs() < 0.01, "lambda {lambda}: {right}"); // 1e-3: sums of f32
            let wrong = fixed_point(lambda, true);
            assert!((wrong - as_death).abs() < 0.001, "lambda {lambda}: {wrong}"); // 5e-5
        }
    }

    #[test]
    fn sizes_and_factors_that_do_not_fit_are_named() {
        let data = Data::random(0);
        let run = |change: &dyn Fn(&mut Steps<'_>), gamma: f64, n: usize| {
            let mut steps = data.steps();
            change(&mut steps);
            let text = advantages(&steps, gamma, 0.95, &mut vec![0.0; n], &mut vec![0.0; T * E * A]).unwrap_err();
            text.to_string()
        };
        let n = T * E * A;
        assert!(run(&|_| (), 1.5, n).starts_with("gamma is 1.5, but it must be in [0, 1]"));
        assert!(run(&|_| (), f64::NAN, n).starts_with("gamma is NaN"));
        assert!(run(&|_| (), 0.9, n - 1).starts_with("length of advantage is 839, but it must be 840"));
        assert!(run(&|s| s.n_agent = 2, 0.9, n).starts_with("length of reward is 840, but it must be 560"));
        assert!(run(&|s| s.n_agent = usize::MAX, 0.9, n).starts_with("length of reward is 840"));
        assert!(run(&|s| s.n_env = 0, 0.9, n).starts_with("length of terminated is 280"));
        assert!(run(&|s| s.n_env = 11, 0.9, n).contains("T times n_env = 11"));
        assert!(run(&|s| s.truncated = &[], 0.9, n).starts_with("length of truncated is 0, but it must be 280"));
    }
}
