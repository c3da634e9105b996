//! What a task says about itself: the four tables that its documentation opens with, as data.
//!
//! Names, sizes, units and bounds are used by the program (layouts, infos, checks) and printed for people; a test holds
//! the tables in the documentation of every task against them.

use crate::error::{Error, Result};
use serde::Serialize;
use std::fmt::Write as _;

/// One named run of numbers in an observation, a state or a memory.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Slice {
    /// `relative_position`.
    pub name: String,
    /// Numbers.
    pub size: usize,
    /// SI, with the frame where there is one: `m, world`.
    pub unit: String,
    /// What it is.
    pub meaning: String,
    /// Of its numbers, as functions of the state.
    pub smoothness: Smoothness,
}

impl Slice {
    /// From its parts.
    pub fn new(name: impl Into<String>, size: usize, unit: impl Into<String>, meaning: impl Into<String>) -> Self {
        let (name, unit, meaning) = (name.into(), unit.into(), meaning.into());
        Self { name, size, unit, meaning, smoothness: Smoothness::Smooth }
    }

    /// Smooth but for something.
    pub fn but(self, smoothness: Smoothness) -> Self {
        Self { smoothness, ..self }
    }
}

/// Numbers of all slices.
pub fn total(slices: &[Slice]) -> usize {
    slices.iter().map(|s| s.size).sum()
}

/// How far a gradient may be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
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
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Term {
    /// `pose`.
    pub name: &'static str,
    /// In the symbols of the task's documentation.
    pub formula: String,
    /// Largest value in one step.
    pub bound: f64,
    /// Of the term in the state.
    pub smoothness: Smoothness,
}

impl Term {
    /// A differentiable one.
    pub fn smooth(name: &'static str, formula: impl Into<String>, bound: f64) -> Self {
        Self { name, formula: formula.into(), bound, smoothness: Smoothness::Smooth }
    }

    /// One with kinks.
    pub fn piecewise(name: &'static str, formula: impl Into<String>, bound: f64) -> Self {
        Self { name, formula: formula.into(), bound, smoothness: Smoothness::Piecewise }
    }

    /// One with jumps.
    pub fn non_smooth(name: &'static str, formula: impl Into<String>, bound: f64) -> Self {
        Self { name, formula: formula.into(), bound, smoothness: Smoothness::NonSmooth }
    }
}

/// A reason to terminate.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct End {
    /// `crash`.
    pub name: &'static str,
    /// `z < 0.2 m`.
    pub condition: String,
}

impl End {
    /// From its parts.
    pub fn new(name: &'static str, condition: impl Into<String>) -> Self {
        Self { name, condition: condition.into() }
    }
}

/// The end that every task has beside its own.
pub const DIVERGED: (&str, &str) = ("diverged", "a number of the state leaves ±1e8");

/// A number of a task's configuration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Setting {
    /// Key in `[task]` of a configuration file.
    pub key: &'static str,
    /// As in the file.
    pub default: String,
    /// What it is, with unit.
    pub meaning: &'static str,
    /// What its numbers may be.
    pub sign: Sign,
}

/// What the numbers of a setting may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Sign {
    /// Any that is finite.
    #[default]
    Any,
    /// > 0: distances, lengths.
    Positive,
    /// ≥ 0: losses, standard deviations.
    NotNegative,
}

impl Setting {
    /// From its parts; its numbers may be any that are finite.
    pub fn new(key: &'static str, default: impl ToString, meaning: &'static str) -> Self {
        Self { key, default: default.to_string(), meaning, sign: Sign::Any }
    }

    /// The same with numbers > 0.
    pub fn positive(self) -> Self {
        Self { sign: Sign::Positive, ..self }
    }

    /// The same with numbers ≥ 0.
    pub fn not_negative(self) -> Self {
        Self { sign: Sign::NotNegative, ..self }
    }

    /// Refuses numbers that the setting may not have.
    pub(crate) fn check(&self, task: &toml::Table) -> Result<()> {
        let (allows, rule): (fn(f64) -> bool, &str) = match self.sign {
            Sign::Any => return Ok(()),
            Sign::Positive => (|x| x > 0.0, "> 0"),
            Sign::NotNegative => (|x| x >= 0.0, "≥ 0"),
        };
        let Some(wrong) = task.get(self.key).and_then(|value| find(value, &|x| !allows(x))) else {
            return Ok(());
        };
        Err(Error::value(format!("task.{}", self.key), wrong, rule, format!("It is {}.", self.meaning)))
    }
}

/// The first number of a value, at any depth, that `is`.
pub(crate) fn find(value: &toml::Value, is: &dyn Fn(f64) -> bool) -> Option<f64> {
    match value {
        toml::Value::Float(x) => Some(*x).filter(|x| is(*x)),
        toml::Value::Integer(x) => Some(*x as f64).filter(|x| is(*x)),
        toml::Value::Array(all) => all.iter().find_map(|x| find(x, is)),
        toml::Value::Table(all) => all.values().find_map(|x| find(x, is)),
        _ => None,
    }
}

/// A figure of an environment that is told in every step beside the reward.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Metric {
    /// `position_error`.
    pub name: &'static str,
    /// `m`.
    pub unit: &'static str,
}

/// All that a task says about itself.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sheet {
    /// One agent's observation, in order.
    pub observation: Vec<Slice>,
    /// The central state, in order; empty where there is none.
    pub central: Vec<Slice>,
    /// The reward's summands.
    pub reward: Vec<Term>,
    /// Reasons to terminate, besides divergence.
    pub ends: Vec<End>,
    /// Figures beside the reward.
    pub metrics: Vec<Metric>,
    /// Numbers that stay through an episode: targets, references, obstacles.
    pub goal: Vec<Slice>,
    /// Numbers that the task keeps from step to step.
    pub memo: Vec<Slice>,
    /// Keys of its configuration.
    pub settings: Vec<Setting>,
}

impl Sheet {
    /// Largest reward in one step: the sum of the terms' bounds.
    pub fn reward_bound(&self) -> f64 {
        self.reward.iter().map(|t| t.bound).sum()
    }

    /// The four tables, as the documentation of the task has them.
    pub fn tables(&self) -> String {
        let mut text = String::new();
        let _ = writeln!(text, "| Observation | size | unit | meaning | |\n|---|---|---|---|---|");
        for s in &self.observation {
            let _ =
                writeln!(text, "| `{}` | {} | {} | {} | {} |", s.name, s.size, s.unit, s.meaning, s.smoothness.name());
        }
        let _ = writeln!(text, "| *total* | {} | | | |\n", total(&self.observation));
        let _ = writeln!(text, "| Reward | term | at most | |\n|---|---|---|---|");
        for t in &self.reward {
            let _ = writeln!(text, "| `{}` | {} | {} | {} |", t.name, t.formula, t.bound, t.smoothness.name());
        }
        let _ = writeln!(text, "| *sum* | | {} | |\n", round(self.reward_bound()));
        let _ = writeln!(text, "| Episode end | when |\n|---|---|");
        for e in &self.ends {
            let _ = writeln!(text, "| `{}` | {} |", e.name, e.condition);
        }
        let _ = writeln!(text, "| `{}` | {} |", DIVERGED.0, DIVERGED.1);
        let _ = writeln!(text, "| *truncated* | k ≥ `horizon` |\n");
        let _ = writeln!(text, "| Configuration | default | meaning |\n|---|---|---|");
        for s in &self.settings {
            let _ = writeln!(text, "| `{}` | {} | {} |", s.key, s.default, s.meaning);
        }
        text
    }
}

/// Without the last digits of a sum.
fn round(x: f64) -> f64 {
    (x * 1e9).round() / 1e9
}
