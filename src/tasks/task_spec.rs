//! What a task says about itself, as data: what came out of writing everything once (`declare`).
//!
//! Names, sizes, units and bounds are used by the program (layouts, infos, checks) and printed for people by
//! `omnidrones tasks NAME`.

use super::settings::Setting;
use base::defaults::with_defaults;
use serde::{Deserialize, Serialize};

with_defaults! {
    /// One named run of numbers in an observation, a state or a memory.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    pub struct Field {
        /// `relative_position`.
        pub name: String = String::new(),
        /// Numbers.
        pub size: usize = 0,
        /// SI, with the frame where there is one: `m, world`.
        pub unit: String = String::new(),
        /// What it is.
        pub meaning: String = String::new(),
        /// Least value of each of its numbers; −∞ (in JSON null) where there is none.
        #[serde(with = "below")]
        pub low: f64 = f64::NEG_INFINITY,
        /// Largest value of each of its numbers; ∞ (in JSON null) where there is none.
        #[serde(with = "above")]
        pub high: f64 = f64::INFINITY,
        /// Of its numbers, as functions of the state.
        pub smoothness: Smoothness = Smoothness::Smooth,
        /// How its numbers are arranged.
        #[serde(default, skip_serializing_if = "FieldLayout::is_vector")]
        pub layout: FieldLayout = FieldLayout::Vector,
    }
}

/// How the numbers of a field are arranged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum FieldLayout {
    /// One behind the other.
    #[default]
    Vector,
    /// Rows of pixels from above, all channels of a pixel together.
    Image {
        /// Rows.
        height: usize,
        /// Pixels of a row.
        width: usize,
        /// Numbers of a pixel.
        channels: usize,
    },
    /// Distances along beams, row by row.
    Lidar {
        /// Rows of beams.
        rows: usize,
        /// Beams of a row.
        columns: usize,
    },
    /// The same numbers of several alike, one after the other.
    Members {
        /// How many.
        members: usize,
    },
}

impl FieldLayout {
    fn is_vector(&self) -> bool {
        *self == Self::Vector
    }

    /// Axes of a field of `size` numbers, from the slowest to the fastest.
    pub fn shape(self, size: usize) -> Vec<usize> {
        match self {
            Self::Vector => vec![size],
            Self::Image { height, width, channels } => vec![height, width, channels],
            Self::Lidar { rows, columns } => vec![rows, columns],
            Self::Members { members } => vec![members, size / members.max(1)],
        }
    }
}

impl Field {
    /// From its parts, smooth and without bounds.
    pub fn new(name: impl Into<String>, size: usize, unit: impl Into<String>, meaning: impl Into<String>) -> Self {
        let (name, unit, meaning) = (name.into(), unit.into(), meaning.into());
        Self { name, size, unit, meaning, ..Self::default() }
    }

    /// The same with these bounds of its numbers.
    pub fn within(self, low: f64, high: f64) -> Self {
        Self { low, high, ..self }
    }

    /// Whether its numbers are what rays meet: pixels, or beams of a lidar.
    pub fn is_of_rays(&self) -> bool {
        matches!(self.layout, FieldLayout::Image { .. } | FieldLayout::Lidar { .. })
    }
}

/// Numbers of all fields.
pub fn total(fields: &[Field]) -> usize {
    fields.iter().map(|s| s.size).sum()
}

/// JSON has no infinity: a bound that is none is null.
macro_rules! bound {
    ($name:ident, $none:expr) => {
        pub(crate) mod $name {
            use serde::{Deserialize, Deserializer, Serialize, Serializer};

            pub(crate) fn serialize<S: Serializer>(bound: &f64, to: S) -> Result<S::Ok, S::Error> {
                Some(*bound).filter(|x| x.is_finite()).serialize(to)
            }

            pub(crate) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
                Ok(Option::deserialize(from)?.unwrap_or($none))
            }
        }
    };
}
bound!(below, f64::NEG_INFINITY);
bound!(above, f64::INFINITY);

/// How far a gradient may be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Smoothness {
    /// Differentiable everywhere that an episode goes.
    Smooth,
    /// Differentiable but on a thin set: a minimum over several, a clip, a norm at zero.
    Piecewise,
    /// Jumps: its gradient leaves out what matters.
    NonSmooth,
}

impl Smoothness {
    /// One word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Smooth => "smooth",
            Self::Piecewise => "piecewise",
            Self::NonSmooth => "non-smooth",
        }
    }
}

/// One summand of the reward.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Term {
    /// `pose`.
    pub name: String,
    /// In the symbols of [`TaskSpec::about`].
    pub formula: String,
    /// Least value in one step; −∞ (in JSON null) where there is none.
    #[serde(with = "below")]
    pub low: f64,
    /// Largest value in one step; ∞ (in JSON null) where there is none.
    #[serde(with = "above")]
    pub bound: f64,
    /// Of the term in the state.
    pub smoothness: Smoothness,
}

impl Term {
    /// Name of its column of the information.
    pub(crate) fn column(&self) -> String {
        format!("reward_{}", self.name)
    }
}

/// A reason to terminate.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct End {
    /// `crash`.
    pub name: String,
    /// `z < 0.2 m`.
    pub condition: String,
}

/// The end that every task has beside its own.
pub const DIVERGED: &str = "diverged";

/// A figure of an environment that is reported in every step beside the reward.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Metric {
    /// `position_error`.
    pub name: String,
    /// `m`.
    pub unit: String,
}

/// When an episode is a success: what [`Task::success`](super::Task::success) asks, as data.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Success {
    /// All of these hold in the step.
    pub limits: Vec<Limit>,
    /// What is asked in the same step beside them, in words; mostly nothing.
    pub also: String,
    /// Whether an episode is a success if any of its steps was one, not its last.
    pub once: bool,
    /// How long all of it must have held, s; 0 for the step alone. An episode that is shorter must have it hold throughout.
    pub held: f64,
}

/// A metric that stays on one side of a number, or between two.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Limit {
    /// Name of the metric.
    pub metric: String,
    /// It is more than this; −∞ (in JSON null) where there is no such limit.
    #[serde(with = "below")]
    pub above: f64,
    /// It is less than this; ∞ (in JSON null) where there is no such limit.
    #[serde(with = "above")]
    pub below: f64,
    /// Of all.
    pub unit: String,
}

impl Limit {
    /// Whether a value keeps it.
    pub fn holds(&self, value: f64) -> bool {
        self.above < value && value < self.below
    }

    fn text(&self) -> String {
        let sides = [("<", self.below), (">", self.above)].into_iter().filter(|(_, limit)| limit.is_finite());
        let one = |(sign, limit)| format!("{} {sign} {limit} {}", self.metric, self.unit).replace(" -", "");
        sides.map(one).collect::<Vec<_>>().join(" and ")
    }
}

impl Success {
    /// A metric below a limit, in the last step of an episode.
    pub fn below(metric: &str, limit: f64) -> Self {
        Self::default().and(metric, limit)
    }

    /// And another one.
    pub fn and(mut self, metric: &str, limit: f64) -> Self {
        self.limits.push(Limit { metric: metric.into(), above: f64::NEG_INFINITY, below: limit, unit: String::new() });
        self
    }

    /// And one above a limit.
    pub fn above(mut self, metric: &str, limit: f64) -> Self {
        self.limits.push(Limit { metric: metric.into(), above: limit, below: f64::INFINITY, unit: String::new() });
        self
    }

    /// All of it through the last `seconds`.
    pub fn held(self, seconds: f64) -> Self {
        Self { held: seconds, ..self }
    }

    /// And more that is asked in the same step, in words: `with all drones beyond x = 0.05 m`.
    pub fn also(self, words: impl Into<String>) -> Self {
        Self { also: words.into(), ..self }
    }

    /// In any step of an episode.
    pub fn once(self) -> Self {
        Self { once: true, ..self }
    }

    /// `position_error < 0.1 m`, what else is asked, and when.
    pub fn text(&self) -> String {
        let mut text = self.limits.iter().map(Limit::text).collect::<Vec<_>>().join(" and ");
        for (more, words) in [
            (!self.also.is_empty(), format!(" {}", self.also)),
            (self.held > 0.0, format!(" through the last {} s", self.held)),
            (self.once, ", once in the episode".into()),
            (!self.once && self.held == 0.0, " in the last step".into()),
        ] {
            text += if more { &words } else { "" };
        }
        text
    }
}

/// All that a task says about itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskSpec {
    /// Symbols, target and start of an episode, in words.
    pub about: String,
    /// One agent's observation, in order; of the first of those that see most, where agents are unlike.
    pub observation: Vec<Field>,
    /// Numbers that each agent sees.
    pub observation_of: Vec<usize>,
    /// The central state, in order; empty where there is none.
    pub central: Vec<Field>,
    /// The reward's summands.
    pub reward: Vec<Term>,
    /// Reasons to terminate, besides divergence.
    pub ends: Vec<End>,
    /// Figures beside the reward.
    pub metrics: Vec<Metric>,
    /// When an episode is a success.
    pub success: Success,
    /// Summands of the cost that gradient methods minimise.
    pub loss: Vec<String>,
    /// Numbers that stay through an episode: targets, references, obstacles.
    pub goal: Vec<Field>,
    /// Numbers that the task keeps from step to step.
    pub task_state: Vec<Field>,
    /// Keys of its configuration.
    pub settings: Vec<Setting>,
}

impl TaskSpec {
    /// Largest reward in one step: the sum of the terms' bounds.
    pub fn reward_bound(&self) -> f64 {
        self.reward.iter().map(|t| t.bound).sum()
    }

    /// With the term of [`EnvConfig::throttle_change`](super::EnvConfig::throttle_change), behind the task's own, and its summand of
    /// the loss; `most` is the largest Σ ‖s − s_before‖²/m.
    pub(crate) fn take_off_throttle_change(&mut self, weight: f64, most: f64) {
        if weight > 0.0 {
            let formula = |sign: &str| format!("{sign}{weight} Σ ‖s − s_before‖²/m over the m drones");
            let (name, smoothness) = ("throttle_change".to_string(), Smoothness::Smooth);
            self.reward.push(Term { name, formula: formula("−"), low: -weight * most, bound: 0.0, smoothness });
            self.loss.push(formula(""));
        }
    }

    /// Least reward in one step: the sum of the terms' least values.
    pub fn reward_floor(&self) -> f64 {
        self.reward.iter().map(|t| t.low).sum()
    }

    /// The formula of the training loss.
    pub fn loss_text(&self) -> String {
        let sum = self.loss.join(" + ");
        let soft = if sum.contains("h₅(") { "; h_c(x) = 2‖x‖²/(1 + √(1 + ‖x‖²/c²))" } else { "" };
        sum + soft
    }
}
