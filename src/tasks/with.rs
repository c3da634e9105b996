//! Transforms of observations that are composed at compile time: a task [`With`] one is a task again.
//!
//! They run where the task writes its observation, in one pass with it, in lanes and on recordings alike. What needs memory,
//! noise or statistics is a [`Stage`](super::Stage), named in the configuration and applied behind them.
//!
//! ```
//! use omnidrones::tasks::suite::hover::Hover;
//! use omnidrones::tasks::{BuiltIn, Env, EnvConfig, Pick, Scale, With};
//!
//! let config = EnvConfig { n_env: 64, ..EnvConfig::default() };
//! let task = With::new(Hover::new(&config)?, (Pick::without(&["clock"]), Scale::of(&[("target", 0.5)])))?;
//! let env = Env::of(task, "HoverWithoutClock", &config)?;
//! assert_eq!(env.spec().n_observation, 26);
//! # Ok::<(), omnidrones::error::Error>(())
//! ```

use super::declare::{Ends, Loss, Writer, declare};
use super::robot::Robot;
use super::settings::Setting;
use super::task::{Start, Task, TaskReference, View};
use super::task_spec::{Field, Success, total};
use crate::autodiff::{Scalar, StridedView, StridedViewMut};
use crate::error::{Error, Result};

/// Most numbers of an observation under a [`Transform`].
pub const MOST: usize = 512;

/// A map of one agent's observation that needs nothing but the view.
///
/// As [`Task`]: mark `map` `#[inline(always)]`, use index loops.
pub trait Transform: Clone + Send + Sync + 'static {
    /// Learns what it is given, and says what it makes of it.
    ///
    /// # Errors
    /// [`Error`] for fields that it cannot take.
    fn prepare(&mut self, given: &[Field]) -> Result<Vec<Field>>;

    /// Writes what [`prepare`](Self::prepare) promised.
    fn map<S: Scalar>(&self, view: &View<'_, S>, agent: usize, given: &StridedView<'_, S>, out: &mut impl Writer<S>);
}

/// One after the other; nest pairs for more.
impl<A: Transform, B: Transform> Transform for (A, B) {
    fn prepare(&mut self, given: &[Field]) -> Result<Vec<Field>> {
        let between = self.0.prepare(given)?;
        fits(&between)?;
        self.1.prepare(&between)
    }

    #[inline(always)]
    fn map<S: Scalar>(&self, view: &View<'_, S>, agent: usize, given: &StridedView<'_, S>, out: &mut impl Writer<S>) {
        let mut between = [S::zero(); MOST];
        self.0.map(view, agent, given, &mut StridedViewMut::of(&mut between).writer(0));
        self.1.map(view, agent, &StridedView::of(&between), out);
    }
}

/// Leaves fields out.
#[derive(Debug, Clone, PartialEq)]
pub struct Pick {
    without: Vec<String>,
    places: Vec<usize>,
}

impl Pick {
    /// Everything but these fields.
    pub fn without(names: &[&str]) -> Self {
        Self { without: names.iter().map(|n| n.to_string()).collect(), places: Vec::new() }
    }
}

impl Transform for Pick {
    fn prepare(&mut self, given: &[Field]) -> Result<Vec<Field>> {
        known(self.without.iter().map(String::as_str), given)?;
        let (mut at, mut kept) = (0, Vec::new());
        self.places.clear();
        for field in given {
            if !self.without.contains(&field.name) {
                self.places.extend(at..at + field.size);
                kept.push(field.clone());
            }
            at += field.size;
        }
        Ok(kept)
    }

    #[inline(always)]
    fn map<S: Scalar>(&self, _: &View<'_, S>, _: usize, given: &StridedView<'_, S>, out: &mut impl Writer<S>) {
        for i in 0..self.places.len() {
            out.number(given.get(self.places[i]));
        }
    }
}

/// Multiplies fields by fixed factors.
#[derive(Debug, Clone, PartialEq)]
pub struct Scale {
    of: Vec<(String, f64)>,
    factors: Vec<f64>,
}

impl Scale {
    /// These fields; the others stay.
    pub fn of(factors: &[(&str, f64)]) -> Self {
        Self { of: factors.iter().map(|(name, factor)| (name.to_string(), *factor)).collect(), factors: Vec::new() }
    }
}

impl Transform for Scale {
    fn prepare(&mut self, given: &[Field]) -> Result<Vec<Field>> {
        known(self.of.iter().map(|(name, _)| name.as_str()), given)?;
        crate::error::finite("factor of Scale", &self.of.iter().map(|(_, factor)| *factor).collect::<Vec<_>>())?;
        self.factors.clear();
        let mut fields = given.to_vec();
        for field in &mut fields {
            let own = self.of.iter().find(|(name, _)| *name == field.name).map(|(_, factor)| *factor);
            self.factors.extend(std::iter::repeat_n(own.unwrap_or(1.0), field.size));
            if let Some(factor) = own {
                field.unit = format!("{factor} × {}", field.unit);
                let ends = [field.low, field.high].map(|bound| if factor == 0.0 { 0.0 } else { factor * bound });
                (field.low, field.high) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
            }
        }
        Ok(fields)
    }

    #[inline(always)]
    fn map<S: Scalar>(&self, _: &View<'_, S>, _: usize, given: &StridedView<'_, S>, out: &mut impl Writer<S>) {
        for i in 0..self.factors.len() {
            out.number(S::constant(self.factors[i]) * given.get(i));
        }
    }
}

/// A task under a [`Transform`].
#[derive(Debug, Clone)]
pub struct With<T, O> {
    task: T,
    transform: O,
    fields: Vec<Field>,
}

impl<T: Task, O: Transform> With<T, O> {
    /// The task, seen through the transform.
    ///
    /// # Errors
    /// [`Error::Limit`] above [`MOST`] numbers; as [`Transform::prepare`].
    pub fn new(task: T, mut transform: O) -> Result<Self> {
        let given = declare(&task)?.observation;
        fits(&given)?;
        let fields = transform.prepare(&given)?;
        fits(&fields)?;
        Ok(Self { task, transform, fields })
    }
}

impl<T: Task, O: Transform> Task for With<T, O> {
    fn robot(&self) -> &Robot {
        self.task.robot()
    }

    fn horizon(&self) -> usize {
        self.task.horizon()
    }

    fn n_agent(&self) -> usize {
        self.task.n_agent()
    }

    fn settings(&self) -> Vec<Setting> {
        self.task.settings()
    }

    fn about(&self) -> &'static str {
        self.task.about()
    }

    fn start(&self, start: &mut Start<'_>) {
        self.task.start(start);
    }

    fn event(&self, start: &mut Start<'_>) {
        self.task.event(start);
    }

    #[inline(always)]
    fn disturb<S: Scalar>(&self, view: &View<'_, S>, tree: usize) -> [S; 9] {
        self.task.disturb(view, tree)
    }

    #[inline(always)]
    fn remember<S: Scalar>(&self, view: &View<'_, S>, task_state: &mut impl Writer<S>) {
        self.task.remember(view, task_state);
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, view: &View<'_, S>, agent: usize, out: &mut impl Writer<S>) {
        let mut given = [S::zero(); MOST];
        self.task.observe(view, agent, &mut StridedViewMut::of(&mut given).writer(0));
        out.fields(&self.fields);
        self.transform.map(view, agent, &StridedView::of(&given), out);
    }

    #[inline(always)]
    fn central<S: Scalar>(&self, view: &View<'_, S>, out: &mut impl Writer<S>) {
        self.task.central(view, out);
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut impl Writer<S>) {
        self.task.reward(view, terms);
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut impl Ends<S>) {
        self.task.ends(view, ends);
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut impl Writer<S>) {
        self.task.metrics(view, out);
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        self.task.success(view)
    }

    fn success_rule(&self) -> Success {
        self.task.success_rule()
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>, loss: &mut impl Loss<S>) {
        self.task.loss(view, loss);
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        self.task.reference(view)
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.task.ideal(start);
    }
}

fn fits(fields: &[Field]) -> Result<()> {
    let n = total(fields);
    if n <= MOST {
        return Ok(());
    }
    Err(Error::limit("numbers of an observation under a transform", n, MOST, "Use stages by name."))
}

/// Whether every name is one of the fields'.
fn known<'a>(names: impl Iterator<Item = &'a str>, fields: &[Field]) -> Result<()> {
    for name in names {
        if !fields.iter().any(|field| field.name == name) {
            let known = fields.iter().map(|field| field.name.to_string()).collect();
            return Err(Error::Unknown { kind: "field of the observation", name: name.into(), known });
        }
    }
    Ok(())
}
