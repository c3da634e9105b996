//! What a batch of environments is, as data: sizes, names, units, bounds.

use super::block::Sizes;
use super::control::Control;
use crate::config::{ActionSpace, EnvConfig};
use crate::observation::{LEAST_NOMINAL, Pipeline};
use crate::task_spec::{DIVERGED, End, Field, Success, TaskSpec, Term, below, total};
use base::error::{Error, Result};
use base::reader;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// The actions that an agent may take.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Space {
    /// `n` numbers within [`low`, `high`].
    Box {
        /// How many.
        n: usize,
        /// Smallest.
        low: f32,
        /// Largest.
        high: f32,
    },
    /// One whole number in 0 … n − 1.
    Discrete {
        /// How many values.
        n: usize,
    },
    /// `n` whole numbers, each in 0 … levels − 1.
    MultiDiscrete {
        /// How many numbers.
        n: usize,
        /// Values of each.
        levels: usize,
    },
}

impl Space {
    /// Numbers of an action.
    pub fn len(&self) -> usize {
        match self {
            Self::Box { n, .. } | Self::MultiDiscrete { n, .. } => *n,
            Self::Discrete { .. } => 1,
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether an action lies within.
    pub fn contains(&self, action: &[f32]) -> bool {
        let whole = |n: usize| move |a: &f32| a.fract() == 0.0 && *a >= 0.0 && *a < n as f32;
        action.len() == self.len()
            && match self {
                Self::Box { low, high, .. } => action.iter().all(|a| (low..=high).contains(&a)),
                Self::Discrete { n } => action.iter().all(whole(*n)),
                Self::MultiDiscrete { levels, .. } => action.iter().all(whole(*levels)),
            }
    }

    pub(crate) fn of(actions: ActionSpace, n_command: usize) -> Self {
        match actions {
            ActionSpace::Continuous => Self::Box { n: n_command, low: -1.0, high: 1.0 },
            ActionSpace::Discrete { levels } => Self::Discrete { n: levels.pow(n_command as u32) },
            ActionSpace::MultiDiscrete { levels } => Self::MultiDiscrete { n: n_command, levels },
        }
    }
}

/// One number of the information of an environment.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Info {
    /// `return`, `position_error`.
    pub name: String,
    /// SI.
    pub unit: String,
    /// What it is. Every number is reported in every step; where an episode ended it is that episode's.
    pub meaning: String,
}

/// Columns of the information that every task has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Column {
    /// Sum of the episode's rewards so far.
    Return,
    /// Steps of the episode so far.
    Length,
    /// Numbers of the action that were clipped or not finite.
    Clipped,
    /// 0, or the place, from 1 on, of the reason to terminate in [`Spec::ends`].
    Reason,
    /// 1 where the goal counts as reached in this step.
    Success,
    /// Training loss of this step.
    Loss,
}

impl Column {
    /// All, in the order of the columns.
    pub const ALL: [Self; 6] = [Self::Return, Self::Length, Self::Clipped, Self::Reason, Self::Success, Self::Loss];

    /// What [`EnvConfig::info`] calls it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Return => "return",
            Self::Length => "length",
            Self::Clipped => "clipped",
            Self::Reason => "reason",
            Self::Success => "success",
            Self::Loss => "loss",
        }
    }

    pub(super) fn info(self) -> Info {
        let (unit, meaning) = match self {
            Self::Return => ("-", "sum of rewards"),
            Self::Length => ("steps", "since the episode began"),
            Self::Clipped => ("-", "numbers of the action that were clipped or not finite"),
            Self::Reason => ("-", "why it terminated, counted from 1 as in `ends`"),
            Self::Success => ("-", "1 where the goal counts as reached"),
            Self::Loss => ("-", "training loss of this step"),
        };
        Info { name: self.name().into(), unit: unit.into(), meaning: meaning.into() }
    }
}

/// Numbers of one agent of a team of unlike ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct AgentWidths {
    /// That the task shows it, before the stages of the observation; what sensors read stands at the end of the widest row.
    pub observation: usize,
    /// Of its action.
    pub action: usize,
}

/// A batch of environments as data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spec {
    /// Registered name.
    pub task: String,
    /// E.
    pub n_env: usize,
    /// A, drones as a rule. All share the reward of the team.
    pub n_agent: usize,
    /// Numbers of one agent's observation; of the widest one's, where agents are unlike ([`Spec::unlike`]).
    pub n_observation: usize,
    /// Its fields, in order.
    pub observation: Vec<Field>,
    /// One agent's actions; the widest one's, where agents are unlike.
    pub action: Space,
    /// Commands that one agent's actions become, in [−1, 1].
    pub commands: Vec<String>,
    /// What each agent is shown and does of these widths, where they are not all the same; empty otherwise. Behind an agent's
    /// own numbers stand zeros, to which stages of the observation do what they do to all (statistics are of all agents);
    /// among actions they move nothing.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unlike: Vec<AgentWidths>,
    /// Numbers of the central state; 0 where there is none.
    pub n_central: usize,
    /// Its fields, in order.
    pub central: Vec<Field>,
    /// Numbers that differ between environments, with their nominal values.
    pub privileged: Vec<(String, f64)>,
    /// The reward's summands.
    pub reward: Vec<Term>,
    /// Largest reward of a step.
    pub reward_bound: f64,
    /// Least reward of a step; −∞ (in JSON null) where a term has no least value.
    #[serde(with = "below")]
    pub reward_floor: f64,
    /// Reasons to terminate; [`Spec::diverged`] follows. The info `reason` counts them from 1.
    pub ends: Vec<End>,
    /// When an episode is a success.
    pub success: Success,
    /// Columns of the information: those of every task ([`Column`]), terms of the reward, the task's figures; of these those that
    /// [`EnvConfig::info`] names, in this order.
    pub info: Vec<Info>,
    /// T, steps.
    pub horizon: usize,
    /// Seconds per step.
    pub dt: f64,
    /// Bytes that one environment keeps between steps.
    pub bytes_per_env: usize,
    /// All settings.
    pub config: EnvConfig,
}

impl Spec {
    /// Rows of the numbers of [`Spec::privileged`] as learners see them best: (x − x₀)/x₀ about the nominal value, or x where
    /// that is nought.
    pub fn deviations(&self, rows: &[f32], to: &mut Vec<f32>) {
        to.clear();
        to.extend(rows.iter().zip(self.privileged.iter().cycle()).map(|(x, (_, nominal))| {
            let x = f64::from(*x);
            (if nominal.abs() > LEAST_NOMINAL { x / nominal - 1.0 } else { x }) as f32
        }));
    }

    /// The end that follows [`Spec::ends`]: a number of the state left the [`Bounds`](crate::Bounds) of the
    /// configuration. Reward and loss of that step are 0.
    pub fn diverged(&self) -> End {
        End { name: DIVERGED.into(), condition: self.config.bounds.text() }
    }

    /// As JSON.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// 64 bits over names, sizes, units and transforms of the observation, of actions and their scales, and of the central
    /// state: a policy fits environments of equal hash. The number of environments, the seed, the rewards and what is
    /// said for people play no part.
    pub fn hash(&self) -> u64 {
        fn shape(fields: &[Field]) -> Vec<(&str, usize, &str)> {
            fields.iter().map(|s| (s.name.as_str(), s.size, s.unit.as_str())).collect()
        }
        let seen = (shape(&self.observation), shape(&self.central), &self.config.observation);
        let done =
            (&self.action, &self.commands, &self.config.control, &self.config.action_scale, &self.config.actions);
        let text = serde_json::to_string(&(seen, done, self.n_agent, self.dt)).unwrap_or_default();
        let unlike = if self.unlike.is_empty() { String::new() } else { format!("{:?}", self.unlike) };
        fnv((text + &unlike).as_bytes())
    }

    /// Numbers of the action of agent `agent`.
    pub fn n_action_of(&self, agent: usize) -> usize {
        self.unlike.get(agent).map_or(self.action.len(), |own| own.action)
    }

    /// From JSON.
    ///
    /// # Errors
    /// [`Error::Format`](base::error::Error::Format) with line and column.
    pub fn from_json(text: &str) -> Result<Self> {
        reader::of_json(text.as_bytes(), "<spec>", "Take what Spec::to_json wrote.")
    }

    /// Place of the field called `name` in the observation; `None` where there is none.
    pub fn observation_range(&self, name: &str) -> Option<Range<usize>> {
        let mut at = 0;
        for field in &self.observation {
            if field.name == name {
                return Some(at..at + field.size);
            }
            at += field.size;
        }
        None
    }

    /// Least and largest value of every number of the observation; infinite where there is none.
    pub fn observation_bounds(&self) -> (Vec<f32>, Vec<f32>) {
        let each = |of: fn(&Field) -> f64| {
            self.observation.iter().flat_map(|f| std::iter::repeat_n(of(f) as f32, f.size)).collect()
        };
        (each(|f| f.low), each(|f| f.high))
    }

    /// Columns of the information with the sums of the reward's terms, as many of them as are reported.
    pub fn term_columns(&self) -> Range<usize> {
        let first = Column::ALL.into_iter().filter(|column| self.column(*column).is_some()).count();
        let n = self.reward.iter().filter(|term| self.info_column(&term.column()).is_some()).count();
        first..first + n
    }

    /// Columns of the information with the task's figures, as many of them as are reported; the first of all is the error, as a rule.
    pub fn metric_columns(&self) -> Range<usize> {
        self.term_columns().end..self.info.len()
    }

    /// Column of the information called `name`; none where there is none, or where [`EnvConfig::info`] leaves it out.
    pub fn info_column(&self, name: &str) -> Option<usize> {
        self.info.iter().position(|i| i.name == name)
    }

    /// A column of the information that every task has; none where [`EnvConfig::info`] leaves it out.
    pub fn column(&self, column: Column) -> Option<usize> {
        self.info_column(column.name())
    }

    /// As [`Spec::column`], where it must be there.
    ///
    /// # Errors
    /// [`Error::Value`] that says what is left out.
    pub fn needed_column(&self, column: Column) -> Result<usize> {
        let missing = || {
            let limit = format!("with '{}' here", column.name());
            Error::value("info", self.told(), limit, "Name it in `info`, or leave `info` out for all columns.")
        };
        self.column(column).ok_or_else(missing)
    }

    /// Whether all columns of the information are told.
    ///
    /// # Errors
    /// [`Error::Value`] otherwise.
    pub(crate) fn tells_all(&self) -> Result<()> {
        if self.config.info.is_none() {
            return Ok(());
        }
        Err(Error::value("info", self.told(), "all columns here", "Leave `info` out."))
    }

    /// The columns of the information, for people.
    fn told(&self) -> String {
        format!("[{}]", self.info.iter().map(|info| info.name.as_str()).collect::<Vec<_>>().join(", "))
    }
}

/// FNV-1a, 64 bits (Fowler, Noll and Vo 1991): the same on every machine and in every version.
pub(crate) fn fnv(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3))
}

/// Widths of all agents, unless they are the same.
fn unlike(task: &TaskSpec, control: &Control) -> Vec<AgentWidths> {
    let both = task.observation_of.iter().zip(&control.n_command_of);
    // one choice stands for all commands only where agents have equally many
    let action = |n: usize| n.min(control.n_action());
    let all: Vec<_> = both.map(|(n, m)| AgentWidths { observation: *n, action: action(*m) }).collect();
    if all.windows(2).all(|two| two[0] == two[1]) { Vec::new() } else { all }
}

#[expect(clippy::too_many_arguments, reason = "the parts of an environment, named at its only caller")]
pub(crate) fn spec_of(
    name: &str,
    config: &EnvConfig,
    horizon: usize,
    own: &TaskSpec,
    s: &Sizes,
    pipeline: &Pipeline,
    control: &Control,
    info: Vec<Info>,
    privileged: Vec<(String, f64)>,
    bytes_per_env: usize,
) -> Spec {
    let fields: Vec<Field> = pipeline.fields.clone();
    Spec {
        task: name.into(),
        n_env: config.n_env,
        n_agent: s.agent,
        n_observation: total(&fields),
        observation: fields,
        action: Space::of(config.actions, control.n_command),
        commands: control.names.clone(),
        unlike: unlike(own, control),
        n_central: s.central,
        central: own.central.clone(),
        privileged,
        reward: own.reward.clone(),
        reward_bound: own.reward_bound(),
        reward_floor: own.reward_floor(),
        ends: own.ends.clone(),
        success: own.success.clone(),
        info,
        horizon,
        dt: config.dt,
        bytes_per_env,
        config: config.clone(),
    }
}
