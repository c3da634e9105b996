//! What happened in an evaluation, step by step and episode by episode: for plots and files.

use super::env::{Column, Env, Spec};
use super::evaluate::EvaluationStep;
use base::error::{Error, Result};
use dynamics::batch::Breach;
use serde::Serialize;

/// A figure over all environments that fly.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Arithmetic.
    pub mean: f64,
    /// A tenth lies below.
    pub low: f64,
    /// Half lies below.
    pub median: f64,
    /// A tenth lies above.
    pub high: f64,
}

impl Spread {
    /// Of these numbers, which are put in order; NaN of none.
    pub fn of(values: &mut [f32]) -> Self {
        values.sort_unstable_by(f32::total_cmp);
        let mean = values.iter().map(|x| f64::from(*x)).sum::<f64>() / values.len() as f64;
        let at = |share: f64| {
            let place = share * values.len().saturating_sub(1) as f64;
            let of = |k: f64| values.get(k as usize).map_or(f64::NAN, |x| f64::from(*x));
            let (below, above) = (of(place.floor()), of(place.ceil()));
            below + place.fract() * (above - below)
        };
        Self { mean, low: at(0.1), median: at(0.5), high: at(0.9) }
    }
}

/// One step over all environments whose episode it belonged to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordedStep {
    /// Since the episodes began, s.
    pub time: f64,
    /// How many environments.
    pub n_flying: usize,
    /// Mean reward.
    pub reward: f64,
    /// Mean of every term of the reward that the environment reports.
    pub terms: Vec<f64>,
    /// Every metric of the task, in its order.
    pub metrics: Vec<Spread>,
}

/// Watches an evaluation.
///
/// ```
/// # use omnidrones_tasks::omnidrones;
/// use omnidrones::tasks::{Autoreset, Baseline, Env, EnvConfig, Record, evaluate};
///
/// let config = EnvConfig::from_toml("n_env = 8\nautoreset = 'disabled'\n[task]\nhorizon = 50", "eight")?;
/// let mut env = Env::make("Hover", &config)?;
/// let mut controller = Baseline::new(&env)?;
/// let mut record = Record::new(&env, 3);
/// evaluate(&mut env, &mut controller.policy(), &mut |step| record.see(step))?;
/// let error = &record.steps[49].metrics[0]; // position_error, m
/// assert!(error.low <= error.median && error.median <= error.high);
/// assert_eq!((record.lines.len(), record.lines[0].len()), (3, 50));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Every step.
    pub steps: Vec<RecordedStep>,
    /// The task's first metric in every step of the first few environments; 0 where a task has none.
    pub lines: Vec<Vec<f32>>,
    /// `[E, info]`: the columns of [`Spec::info`] in the last step of every episode.
    pub last: Vec<f32>,
    /// What broke where a simulation diverged, per environment.
    breaches: Vec<Option<Breach>>,
    spec: Spec,
    /// Sums of terms one step ago.
    before: Vec<f32>,
    row: Vec<f32>,
}

impl Record {
    /// Of one evaluation of `env`, with single lines of its first `n_line` environments.
    pub fn new(env: &Env, n_line: usize) -> Self {
        let spec = env.spec().clone();
        let n = spec.n_env;
        Self {
            steps: Vec::new(),
            lines: vec![Vec::new(); n_line.min(n)],
            last: vec![0.0; n * spec.info.len()],
            breaches: vec![None; n],
            before: vec![0.0; n * spec.reward.len()],
            row: Vec::with_capacity(n),
            spec,
        }
    }

    /// What was evaluated.
    pub fn spec(&self) -> &Spec {
        &self.spec
    }

    /// First of the task's metrics among the columns of [`Spec::info`]; their number where a task has none.
    pub fn first_metric(&self) -> usize {
        self.spec.metric_columns().start
    }

    /// Takes a step in.
    pub fn see(&mut self, watched: &EvaluationStep<'_>) {
        let (width, first) = (self.spec.info.len(), self.first_metric());
        let flying: Vec<usize> = (0..self.spec.n_env).filter(|i| watched.flying[*i]).collect();
        let reason = self.spec.column(Column::Reason);
        let info = |i: usize, k: usize| watched.out.info[i * width + k];
        for i in &flying {
            self.last[i * width..][..width].copy_from_slice(&watched.out.info[i * width..][..width]);
            if reason.is_some_and(|k| info(*i, k) as usize > self.spec.ends.len()) {
                self.breaches[*i] = watched.env.breach(*i).ok().flatten();
            }
        }
        for (i, line) in self.lines.iter_mut().enumerate().filter(|(i, _)| watched.flying[*i]) {
            line.push(if first < width { info(i, first) } else { 0.0 });
        }
        let metrics = (first..width)
            .map(|k| {
                self.row.clear();
                self.row.extend(flying.iter().map(|i| info(*i, k)));
                Spread::of(&mut self.row)
            })
            .collect();
        let terms = self.terms(&flying, &watched.out.info);
        self.steps.push(RecordedStep {
            time: watched.step as f64 * self.spec.dt,
            n_flying: flying.len(),
            reward: terms.iter().sum(),
            terms,
            metrics,
        });
    }

    /// Mean of every term in this step: what its sum grew by.
    fn terms(&mut self, flying: &[usize], info: &[f32]) -> Vec<f64> {
        let (width, n_term) = (self.spec.info.len(), self.spec.reward.len());
        let columns = self.spec.term_columns();
        let mut means = vec![0.0; columns.len()];
        for i in flying {
            for ((k, mean), column) in means.iter_mut().enumerate().zip(columns.clone()) {
                let (now, before) = (info[i * width + column], &mut self.before[i * n_term + k]);
                *mean += f64::from(now - *before) / flying.len() as f64;
                *before = now;
            }
        }
        means
    }

    /// Column `column` of [`Spec::info`] at the end of every episode; empty if there is no such column.
    pub fn ended(&self, column: usize) -> Vec<f32> {
        self.last.chunks_exact(self.spec.info.len().max(1)).filter_map(|row| row.get(column).copied()).collect()
    }

    /// What broke in episode `environment`, where it ended as `diverged`.
    pub fn breach(&self, environment: usize) -> Option<&Breach> {
        self.breaches.get(environment)?.as_ref()
    }

    /// Why episode `environment` ended: a name of [`Spec::ends`], `diverged`, or `time`.
    ///
    /// # Errors
    /// [`Error::Value`] if there is no such environment, or where the environment does not report reasons.
    pub fn why(&self, environment: usize) -> Result<&str> {
        let (n, width) = (self.spec.n_env, self.spec.info.len());
        if environment >= n {
            let remedy = "Environments count from 0.";
            return Err(Error::value("environment", environment, format!("< {n}"), remedy));
        }
        let code = self.last[environment * width + self.spec.needed_column(Column::Reason)?];
        Ok(match (code as usize).checked_sub(1) {
            None => "time",
            Some(k) => self.spec.ends.get(k).map_or("diverged", |end| &end.name),
        })
    }
}
