//! How well a policy does: one episode of every environment, from fixed starts.

use super::activity::{Activity, Commands, EpisodeActivity};
use super::config::Autoreset;
use super::env::{Buffers, Column, Env, Spec};
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Figures over the episodes of a batch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Episodes.
    pub n_episode: usize,
    /// Mean of the returns.
    pub return_mean: f64,
    /// Their standard deviation, √(Σ(R − R̄)²/n).
    pub return_std: f64,
    /// Mean return over the largest, [`Spec::reward_bound`](super::Spec::reward_bound) times the horizon.
    pub share_of_bound: f64,
    /// Mean of the task's first metric in the last step, in its unit, as a rule the position error, m; 0 where a task has none.
    pub final_error: f64,
    /// Mean of the task's first metric over all steps of all episodes, in its unit.
    pub mean_error: f64,
    /// Share of episodes whose last step was a success ([`Spec::success`](super::Spec::success)) and no termination.
    pub success: f64,
    /// 95 % confidence interval `[low, high]` of the true share ([`wilson`]).
    pub success_interval: [f64; 2],
    /// Share of episodes whose last step (any, where a success counts once) had the first metric below the first limit of a
    /// success, and was no termination: neither attitude nor what was before it counts.
    pub success_by_last_error: f64,
    /// Share of episodes that the task terminated.
    pub crashed: f64,
    /// Mean number of steps.
    pub length: f64,
    /// Activity of the rotors' commands; none in evaluations written before it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub activity: Option<Activity>,
    /// Mean of every metric in the last step, in the order of the task's metrics.
    pub final_metrics: Vec<f64>,
    /// Mean sum of every term of the reward, in the order of [`Spec::reward`](super::Spec::reward).
    pub terms: Vec<f64>,
    /// Share of episodes that ended by each of [`Spec::ends`](super::Spec::ends), then by divergence.
    pub ends: Vec<f64>,
}

impl Evaluation {
    /// [`Activity::change`]; NaN where it is not known.
    pub fn command_change(&self) -> f64 {
        self.activity.map_or(f64::NAN, |activity| activity.change)
    }
}

/// 95 % confidence interval `[low, high]` of a share p after `hits` of `n`, p̂ = hits/n:
/// (p̂ + z²/2n ± z √(p̂(1 − p̂)/n + z²/4n²))/(1 + z²/n), z = 1.96 (Wilson 1927); `[0, 1]` without a try.
pub fn wilson(hits: usize, n: usize) -> [f64; 2] {
    const Z: f64 = 1.959_963_984_540_054;
    if n == 0 {
        return [0.0, 1.0];
    }
    let (n, share) = (n as f64, hits as f64 / n as f64);
    let scale = 1.0 / (1.0 + Z * Z / n);
    let middle = scale * (share + 0.5 * Z * Z / n);
    let half = scale * Z * (share * (1.0 - share) / n + 0.25 * Z * Z / (n * n)).sqrt();
    [(middle - half).max(0.0), (middle + half).min(1.0)]
}

/// A step of an evaluation, as it is shown to `watch`.
#[derive(Debug, Clone, Copy)]
pub struct EvaluationStep<'a> {
    /// After the step.
    pub env: &'a Env,
    /// What the step wrote.
    pub out: &'a Buffers,
    /// Steps done, from 1 on.
    pub step: usize,
    /// `[E]`: whose episode the step belonged to; the others had ended before.
    pub flying: &'a [bool],
}

/// A policy: fills the actions `[E, A, action]` of an environment from the arrays of the step before.
pub type PolicyFn<'a> = dyn FnMut(&Env, &Buffers, &mut [f32]) -> Result<()> + 'a;

/// Flies one episode of every environment, from the starts of its seeds. `policy` fills the actions from the arrays of
/// the step before; `watch` sees every step: a progress bar, a [`Record`](super::Record).
///
/// # Errors
/// [`Error::Value`] unless the environment was made with `autoreset = "disabled"` and reports all columns of its information; those of
/// the policy; otherwise as [`Env::step`].
pub fn evaluate(
    env: &mut Env,
    policy: &mut PolicyFn<'_>,
    watch: &mut dyn FnMut(&EvaluationStep<'_>),
) -> Result<Evaluation> {
    let episodes = EpisodeRows::fly(env, policy, watch)?;
    Ok(episodes.evaluation(env.spec()))
}

/// What is known of one episode of every environment: that of shards, joined in their order, is that of the whole.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EpisodeRows {
    /// Of the last step, `[E, info]`.
    pub info: Vec<f32>,
    /// Whether the task ended it, `[E]`.
    pub terminated: Vec<bool>,
    /// Sum of the task's first metric over its steps, `[E]`.
    pub error: Vec<f64>,
    /// Whether that metric came below the first limit of a success, `[E]`.
    pub near: Vec<bool>,
    /// Of the commands of its rotors, `[E]`.
    pub activity: Vec<EpisodeActivity>,
}

impl EpisodeRows {
    /// Flies them, as [`evaluate`].
    ///
    /// # Errors
    /// As [`evaluate`].
    pub fn fly(env: &mut Env, policy: &mut PolicyFn<'_>, watch: &mut dyn FnMut(&EvaluationStep<'_>)) -> Result<Self> {
        if env.spec().config.autoreset != Autoreset::Disabled {
            let remedy = "Build it with autoreset = 'disabled'.";
            return Err(Error::value("autoreset", "on", "'disabled' to evaluate", remedy));
        }
        let spec = env.spec().clone();
        spec.tells_all()?;
        let n = spec.n_env;
        let mut out = Buffers::new(&spec);
        let mut actions = vec![0.0; n * spec.n_agent * spec.action.len()];
        env.reset(None, None, &mut out.out())?;
        let limit = spec.success.limits.first().map_or(f64::INFINITY, |limit| limit.below);
        let mut flying = vec![true; n];
        let width = spec.info.len();
        let first = first_metric(&spec);
        let mut commands = Commands::of(env);
        let mut own = Self {
            info: vec![0.0; n * width],
            terminated: vec![false; n],
            error: vec![0.0; n],
            near: vec![false; n],
            activity: Vec::new(),
        };
        for t in 0..spec.horizon {
            policy(env, &out, &mut actions)?;
            env.step(&actions, &mut out.out())?;
            for i in (0..n).filter(|i| flying[*i]) {
                let error = first.map_or(0.0, |k| f64::from(out.info[i * width + k]));
                own.error[i] += error;
                own.near[i] = error < limit || spec.success.once && own.near[i];
            }
            commands.see(env, &flying)?;
            watch(&EvaluationStep { env, out: &out, step: t + 1, flying: &flying });
            for i in 0..n {
                if flying[i] {
                    // of its own last step: what ended stands still, but not all that is told of it
                    own.info[i * width..(i + 1) * width].copy_from_slice(&out.info[i * width..(i + 1) * width]);
                    own.terminated[i] = out.terminated[i] == 1;
                }
                flying[i] &= out.terminated[i] == 0 && out.truncated[i] == 0;
            }
            if !flying.contains(&true) {
                break;
            }
        }
        own.activity = commands.episodes();
        Ok(own)
    }

    /// Appends those of the environments that follow.
    pub fn join(&mut self, next: Self) {
        self.info.extend(next.info);
        self.terminated.extend(next.terminated);
        self.error.extend(next.error);
        self.near.extend(next.near);
        self.activity.extend(next.activity);
    }

    /// Figures over them. `spec` is that of the environments but for their number.
    ///
    /// # Panics
    /// Without episodes, or if `info` has not the columns of `spec`, which are all, or a list not one entry for each.
    pub fn evaluation(&self, spec: &Spec) -> Evaluation {
        let (n, width) = (self.terminated.len(), spec.info.len());
        let [total, length, reason, success] = [Column::Return, Column::Length, Column::Reason, Column::Success]
            .map(|column| spec.column(column).expect("a spec that tells all columns"));
        assert!(n > 0 && self.info.len() == n * width, "rows of info");
        assert!(self.error.len() == n && self.near.len() == n && self.activity.len() == n, "an entry for each episode");
        let of = |k: usize| (0..n).map(move |i| f64::from(self.info[i * width + k]));
        let mean = |k: usize| of(k).sum::<f64>() / n as f64;
        let return_mean = mean(total);
        let spread = of(total).map(|x| (x - return_mean).powi(2)).sum::<f64>() / n as f64;
        let count = |holds: &dyn Fn(usize) -> bool| (0..n).filter(|i| holds(*i)).count();
        let share = |holds: &dyn Fn(usize) -> bool| count(holds) as f64 / n as f64;
        let at = |i: usize, column: usize| self.info[i * width + column];
        let succeeded = count(&|i| at(i, success) > 0.5 && !self.terminated[i]);
        let steps: f64 = of(length).sum();
        Evaluation {
            n_episode: n,
            return_mean,
            return_std: spread.sqrt(),
            share_of_bound: return_mean / (spec.reward_bound * spec.horizon as f64),
            final_error: first_metric(spec).map_or(0.0, mean),
            mean_error: self.error.iter().sum::<f64>() / steps,
            success: succeeded as f64 / n as f64,
            success_interval: wilson(succeeded, n),
            success_by_last_error: share(&|i| self.near[i] && !self.terminated[i]),
            crashed: share(&|i| self.terminated[i]),
            length: steps / n as f64,
            activity: Some(Activity::over(&self.activity)),
            final_metrics: spec.metric_columns().map(mean).collect(),
            terms: spec.term_columns().map(mean).collect(),
            ends: (1..spec.ends.len() + 2).map(|k| share(&|i| at(i, reason) as usize == k)).collect(),
        }
    }
}

/// Its column; none where the task has no metric.
fn first_metric(spec: &Spec) -> Option<usize> {
    spec.metric_columns().next()
}
