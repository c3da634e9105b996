//! Transforms of observations: history, noise, normalisation, privileged numbers; in one pass, in the order given.
//!
//! Each stage maps one agent's numbers to one agent's numbers and says what they are called. They are recorded, so gradients go
//! through them; noise is a constant to a gradient.

use super::task_spec::{Field, total};
use autodiff::{Scalar, Trace, TraceMask};
use base::error::{Error, Result};
use controllers::estimation::StateEstimatorSettings;
use dynamics::domain::Domain;
use serde::{Deserialize, Serialize};

/// One transform. In TOML: `{ kind = "history", steps = 4 }`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub enum ObservationTransform {
    /// Every agent sees its own drone, and those of others, as a filter of its sensors estimates them
    /// ([`StateEstimatorBatch`](controllers::estimation::StateEstimatorBatch)), in place of the truth; the first stage. Rewards, ends and the
    /// central state are of the truth. Episodes begin with an estimate that is off by what the filter believes. Gradients take by how much it
    /// is off for a constant.
    Estimate {
        /// Whether what the sensors read is shown too, behind the task's own numbers. Default false.
        #[serde(default)]
        readings: bool,
        /// Of the filter.
        #[serde(default)]
        settings: StateEstimatorSettings,
    },
    /// The last `steps` observations, newest first; zeros before an episode began.
    History {
        /// 2 to 256.
        steps: usize,
    },
    /// Independent normal noise in every step.
    Noise {
        /// Standard deviation, in the unit of the field.
        std: f64,
        /// Names of the fields that get it; all if empty.
        #[serde(default)]
        slices: Vec<String>,
    },
    /// (x − mean)/std of statistics that [`Env::update_normaliser`](super::Env::update_normaliser) takes from all
    /// observations since its last call; frozen in between.
    Normalise {
        /// Results stay within ± this. Default 10.
        #[serde(default = "ten")]
        clip: f64,
    },
    /// The physical numbers that differ between environments. What has a size by its nature (masses, moments of inertia,
    /// coefficients of rotors, time constants, drag) is given as a ratio to its nominal value; what is nominally zero or
    /// may have any sign (centres of mass, products of inertia, positions) as it is.
    Privileged {},
}

fn ten() -> f64 {
    10.0
}

/// Most steps of history.
pub(crate) const MAX_HISTORY: usize = 256;
/// Most stages.
pub(crate) const MAX_STAGES: usize = 16;
/// Most numbers that all stages make, remember and draw for one agent.
pub(crate) const MAX_NUMBERS: usize = 1 << 18;
/// Nominal values below this are no unit to measure in.
pub(crate) const LEAST_NOMINAL: f64 = 1e-12;

impl ObservationTransform {
    /// Checks the numbers of a transform.
    ///
    /// # Errors
    /// [`Error::Limit`] or [`Error::Value`] that names the number.
    pub fn validate(&self) -> Result<()> {
        let positive = |what: &str, x: f64| {
            if x > 0.0 && x.is_finite() {
                return Ok(());
            }
            Err(Error::value(what, x, "finite and > 0", "Leave the stage out."))
        };
        match self {
            Self::History { steps } if !(2..=MAX_HISTORY).contains(steps) => {
                let limit = format!("2 to {MAX_HISTORY}");
                Err(Error::limit("observation.history.steps", steps, limit, "Leave the stage out for one step."))
            }
            Self::Noise { std, .. } => positive("observation.noise.std", *std),
            Self::Normalise { clip } => positive("observation.normalise.clip", *clip),
            Self::Estimate { settings, .. } => settings.validate(),
            Self::History { .. } | Self::Privileged {} => Ok(()),
        }
    }
}

/// Statistics of a normaliser, frozen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Observations behind them, of all agents.
    pub count: f64,
    /// Per number.
    pub mean: Vec<f64>,
    /// Mean square deviation per number.
    pub variance: Vec<f64>,
}

impl Statistics {
    /// Mean 0 and variance 1 of no observation.
    pub fn of_nothing(n: usize) -> Self {
        Self { count: 0.0, mean: vec![0.0; n], variance: vec![1.0; n] }
    }

    /// With the sums Σ(x − mean) and Σ(x − mean)² of `count` more observations about the present mean (Chan, Golub and
    /// LeVeque 1979).
    pub fn merge(&mut self, count: f64, sums: &[f64], squares: &[f64]) {
        if count <= 0.0 {
            return;
        }
        let all = self.count + count;
        for k in 0..self.mean.len() {
            let shift = sums[k] / count;
            let within = (squares[k] - count * shift * shift).max(0.0);
            let between = shift * shift * self.count * count / all;
            let old = if self.count > 0.0 { self.variance[k] * self.count } else { 0.0 };
            self.variance[k] = (old + within + between) / all;
            self.mean[k] += shift * count / all;
        }
        self.count = all;
    }
}

/// Sizes that stages come to, found before anything is built.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Extent {
    /// Numbers of one agent behind the last stage.
    pub observation: usize,
    /// Numbers of one agent's memory.
    pub memory: usize,
    /// Numbers that the normaliser sees, if there is one.
    pub normalised: Option<usize>,
}

impl Extent {
    /// For `raw` numbers of a task and `theta` that vary.
    ///
    /// # Errors
    /// [`Error::Limit`] for more than [`MAX_STAGES`] stages or [`MAX_NUMBERS`] numbers.
    pub(crate) fn of(stages: &[ObservationTransform], raw: usize, theta: usize) -> Result<Self> {
        if stages.iter().skip(1).any(|stage| matches!(stage, ObservationTransform::Estimate { .. })) {
            let remedy = "Put it before the others: they transform what it shows.";
            return Err(Error::value("observation: stage 'estimate'", "behind another", "the first, once", remedy));
        }
        if stages.len() > MAX_STAGES {
            return Err(Error::limit("observation: stages", stages.len(), MAX_STAGES, "Leave some of them out."));
        }
        let mut own = Self { observation: raw, memory: 0, normalised: None };
        let mut noise: usize = 0;
        for stage in stages {
            match stage {
                ObservationTransform::History { steps } => {
                    own.observation = own.observation.saturating_mul(*steps);
                    own.memory = own.memory.saturating_add(own.observation);
                }
                ObservationTransform::Estimate { .. } => (),
                ObservationTransform::Noise { .. } => noise = noise.saturating_add(own.observation),
                ObservationTransform::Normalise { .. } => own.normalised = Some(own.observation),
                ObservationTransform::Privileged {} => own.observation = own.observation.saturating_add(theta),
            }
            let all = own.observation.saturating_add(own.memory).saturating_add(noise);
            if all > MAX_NUMBERS {
                let remedy = "Remember fewer steps: histories of histories multiply.";
                return Err(Error::limit("observation: numbers of one agent", all, MAX_NUMBERS, remedy));
            }
        }
        Ok(own)
    }
}

/// Stages prepared for the observation of one task.
#[derive(Debug, Clone)]
pub(crate) struct Pipeline {
    steps: Vec<Step>,
    /// Fields of one agent behind the last stage.
    pub fields: Vec<Field>,
    /// Numbers of one agent's memory.
    pub memory: usize,
    /// Normal draws of one agent per step.
    pub noise: usize,
    /// Whether there is a normaliser.
    normalises: bool,
}

#[derive(Debug, Clone)]
enum Step {
    History { steps: usize, n: usize, memory: usize },
    Noise { std: Vec<f64>, first: usize },
    Normalise { n: usize, clip: f64 },
    Privileged { n: usize, scale: Vec<f64> },
}

/// One agent's arrays, as stages work on them.
#[derive(Debug)]
pub(crate) struct AgentArrays<'a> {
    /// The observation, transformed in place.
    pub observation: &'a mut [Trace],
    /// What histories remember.
    pub memory: &'a mut [Trace],
    /// What a normaliser sees; of nothing, where nobody asks.
    pub seen: &'a mut [Trace],
    /// Standard normal draws.
    pub noise: &'a [Trace],
    /// Of all agents: whether the environment moved on (history is kept otherwise), whether an episode begins, the physical numbers
    /// that vary.
    pub common: &'a [Trace],
    /// Means, then 1/standard deviations of the normaliser.
    pub statistics: &'a [Trace],
}

impl Pipeline {
    /// For a task's fields and `theta` with its nominal values and domains.
    pub(crate) fn new(stages: &[ObservationTransform], raw: &[Field], theta: &[(String, f64, Domain)]) -> Result<Self> {
        let mut p = Self { steps: Vec::new(), fields: raw.to_vec(), memory: 0, noise: 0, normalises: false };
        Extent::of(stages, total(raw), theta.len())?;
        for stage in stages {
            p.add(stage, theta)?;
        }
        Ok(p)
    }

    fn add(&mut self, stage: &ObservationTransform, theta: &[(String, f64, Domain)]) -> Result<()> {
        let n = total(&self.fields);
        match stage {
            // it decides what the task is shown
            ObservationTransform::Estimate { .. } => (),
            ObservationTransform::History { steps } => {
                self.steps.push(Step::History { steps: *steps, n, memory: self.memory });
                self.memory += steps * n;
                let older = (1..*steps).flat_map(|k| {
                    // zeros before the episode
                    let name = move |s: &Field| Field {
                        name: format!("{}_{k}_ago", s.name),
                        low: s.low.min(0.0),
                        high: s.high.max(0.0),
                        ..s.clone()
                    };
                    self.fields.iter().map(name).collect::<Vec<_>>()
                });
                self.fields = self.fields.iter().cloned().chain(older).collect();
            }
            ObservationTransform::Noise { std, slices } => {
                if let Some(name) = slices.iter().find(|name| !self.fields.iter().any(|s| s.name == **name)) {
                    let known = self.fields.iter().map(|s| s.name.clone()).collect();
                    return Err(Error::Unknown { kind: "field of the observation", name: name.clone(), known });
                }
                let of = |s: &Field| {
                    let noisy = slices.is_empty() || slices.contains(&s.name);
                    vec![if noisy { *std } else { 0.0 }; s.size]
                };
                self.steps.push(Step::Noise { std: self.fields.iter().flat_map(of).collect(), first: self.noise });
                for field in self.fields.iter_mut().filter(|f| slices.is_empty() || slices.contains(&f.name)) {
                    (field.low, field.high) = (f64::NEG_INFINITY, f64::INFINITY);
                }
                self.noise += n;
            }
            ObservationTransform::Normalise { clip } => {
                if self.normalises {
                    let remedy = "Leave one of them out.";
                    return Err(Error::limit("observation stages of kind 'normalise'", 2, 1, remedy));
                }
                self.normalises = true;
                self.steps.push(Step::Normalise { n, clip: *clip });
                self.fields.iter_mut().for_each(|f| (f.low, f.high) = (-clip, *clip));
            }
            ObservationTransform::Privileged {} => {
                let is_ratio = |(_, x, domain): &(String, f64, Domain)| *x > LEAST_NOMINAL && domain.keeps_sign();
                let scale = theta.iter().map(|own| if is_ratio(own) { 1.0 / own.1 } else { 1.0 }).collect();
                self.steps.push(Step::Privileged { n, scale });
                let field = |own: &(String, f64, Domain)| {
                    let unit = if is_ratio(own) { "ratio to nominal" } else { "as it is" };
                    Field::new(own.0.clone(), 1, unit, "varies between environments")
                };
                self.fields.extend(theta.iter().map(field));
            }
        }
        Ok(())
    }

    /// Whether there is nothing to do.
    pub(crate) fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Transforms one agent's observation.
    pub(crate) fn run(&self, arrays: AgentArrays<'_>) {
        let AgentArrays { observation: a, memory, seen, noise, common, statistics } = arrays;
        let (moved, fresh, theta) = (common[0].gt(0.5), common[1].gt(0.5), &common[2..]);
        for step in &self.steps {
            match step {
                Step::History { steps, n, memory: at } => {
                    let memory = &mut memory[*at..][..steps * n];
                    remember(moved, fresh, memory, &a[..*n]);
                    a[..steps * n].copy_from_slice(memory);
                }
                Step::Noise { std, first } => {
                    for (k, std) in std.iter().enumerate() {
                        a[k] += *std * noise[first + k];
                    }
                }
                Step::Normalise { n, clip } => {
                    seen.iter_mut().zip(&*a).for_each(|(seen, x)| *seen = *x);
                    let most = Trace::constant(*clip);
                    for (k, x) in a[..*n].iter_mut().enumerate() {
                        *x = ((*x - statistics[k]) * statistics[n + k]).clamp(-most, most);
                    }
                }
                Step::Privileged { n, scale } => {
                    for (k, scale) in scale.iter().enumerate() {
                        a[n + k] = theta[k] * *scale;
                    }
                }
            }
        }
    }
}

/// Shifts the memory by one observation where an environment moved on.
fn remember(moved: TraceMask, fresh: TraceMask, memory: &mut [Trace], now: &[Trace]) {
    let n = now.len();
    for k in (0..memory.len()).rev() {
        let new = if k < n { now[k] } else { Trace::select(fresh, Trace::zero(), memory[k - n]) };
        memory[k] = Trace::select(moved, new, memory[k]);
    }
}
