//! Tasks declare by writing: whoever writes a number says beside it what it is.
//!
//! Kernels hand a task writers that ignore the names, which leaves no trace in their code. Once, when an environment is made,
//! `declare` lets the task write everything in `f64` in its ideal state, and keeps the names: that is its [`TaskSpec`].
//! Words are constants; `{key}` in them stands for the value of a setting, `{×key}` for a factor.

use super::settings::{Setting, filled};
use super::task::{Start, Task, View, streams};
use super::task_spec::{End, Field, Layout, Metric, Smoothness, TaskSpec, Term, total};
use crate::autodiff::unrolled::unrolled;
use crate::autodiff::{Scalar, StridedView, StridedWriter};
use crate::dynamics::frame::FRAME;
use crate::error::{Error, Result};
use std::ops::{Deref, DerefMut};

/// Takes numbers one after the other, and what they are called.
///
/// `out.field("target", "m, world", "p_t − p").array(error)` opens a field and writes its numbers; what is written until the
/// next field belongs to it.
pub trait Writer<S: Scalar>: Sized {
    /// The next number.
    ///
    /// # Panics
    /// Behind the last.
    fn number(&mut self, value: S);

    /// The next N numbers.
    #[inline(always)]
    fn array<const N: usize>(&mut self, values: [S; N]) {
        unrolled!(i in 0..N {
            self.number(values[i]);
        });
    }

    /// The numbers to come are a field of this name, unit (with the frame) and meaning.
    #[inline(always)]
    fn field(&mut self, _name: &'static str, _unit: &'static str, _meaning: &'static str) -> &mut Self {
        self
    }

    /// Each number of the field lies within [`low`, `high`].
    #[inline(always)]
    fn within(&mut self, _low: f64, _high: f64) -> &mut Self {
        self
    }

    /// How far gradients of the field may be trusted; [`Smoothness::Smooth`] unless said.
    #[inline(always)]
    fn smoothness(&mut self, _: Smoothness) -> &mut Self {
        self
    }

    /// Differentiable but on a thin set.
    #[inline(always)]
    fn piecewise(&mut self) -> &mut Self {
        self.smoothness(Smoothness::Piecewise)
    }

    /// With jumps.
    #[inline(always)]
    fn non_smooth(&mut self) -> &mut Self {
        self.smoothness(Smoothness::NonSmooth)
    }

    /// How the numbers of the field lie about each other; [`Layout::Vector`] unless said.
    #[inline(always)]
    fn layout(&mut self, _: Layout) -> &mut Self {
        self
    }

    /// The field is an image: rows of pixels from above, all channels of a pixel together.
    #[inline(always)]
    fn image(&mut self, height: usize, width: usize, channels: usize) -> &mut Self {
        self.layout(Layout::Image { height, width, channels })
    }

    /// The field is distances along beams, row by row.
    #[inline(always)]
    fn lidar(&mut self, rows: usize, columns: usize) -> &mut Self {
        self.layout(Layout::Lidar { rows, columns })
    }

    /// The field is the same numbers of several alike, one after the other.
    #[inline(always)]
    fn members(&mut self, members: usize) -> &mut Self {
        self.layout(Layout::Members { members })
    }

    /// The number to come is a summand of the reward between 0 and `bound`; where it may be less, [`within`](Self::within) says
    /// how much.
    #[inline(always)]
    fn term(&mut self, name: &'static str, formula: &'static str, bound: f64) -> &mut Self {
        self.field(name, "-", formula).within(0.0, bound)
    }

    /// The next number is a figure that is told in every step.
    #[inline(always)]
    fn metric(&mut self, name: &'static str, unit: &'static str, value: S) {
        self.field(name, unit, "now").number(value);
    }

    /// The same writer, deaf to names: for numbers that are parts of one field.
    #[inline(always)]
    fn unnamed(&mut self) -> Unnamed<'_, Self> {
        Unnamed(self)
    }
}

/// A kernel's writer.
impl<S: Scalar> Writer<S> for StridedWriter<'_, S> {
    #[inline(always)]
    fn number(&mut self, value: S) {
        StridedWriter::number(self, value);
    }
}

/// A writer that hands on numbers alone.
#[derive(Debug)]
pub struct Unnamed<'a, W>(&'a mut W);

impl<S: Scalar, W: Writer<S>> Writer<S> for Unnamed<'_, W> {
    #[inline(always)]
    fn number(&mut self, value: S) {
        self.0.number(value);
    }
}

/// Takes reasons to terminate, one mask each.
pub trait Ends<S: Scalar> {
    /// The next reason, and when it holds.
    ///
    /// # Panics
    /// Behind `MAX_ENDS`.
    fn when(&mut self, name: &'static str, condition: &'static str, mask: S::Mask);
}

/// A kernel's.
pub(crate) struct Masks<'a, S: Scalar> {
    masks: &'a mut [S::Mask],
    at: usize,
}

impl<'a, S: Scalar> Masks<'a, S> {
    #[inline(always)]
    pub(crate) fn new(masks: &'a mut [S::Mask]) -> Self {
        Self { masks, at: 0 }
    }
}

impl<S: Scalar> Ends<S> for Masks<'_, S> {
    #[inline(always)]
    fn when(&mut self, _: &'static str, _: &'static str, mask: S::Mask) {
        self.masks[self.at] = mask;
        self.at += 1;
    }
}

/// Takes the summands of a training loss.
pub trait Loss<S: Scalar> {
    /// The next one and its formula, in the symbols of [`TaskSpec::about`].
    fn add(&mut self, formula: &'static str, value: S);
}

/// A kernel's: the sum so far.
struct Sum<S>(Option<S>);

impl<S: Scalar> Loss<S> for Sum<S> {
    #[inline(always)]
    fn add(&mut self, _: &'static str, value: S) {
        // not from zero, which recordings would add
        self.0 = match self.0 {
            None => Some(value),
            Some(sum) => Some(sum + value),
        };
    }
}

/// The training loss of a step, cut at `most`.
#[inline(always)]
pub(crate) fn loss_of<S: Scalar, T: Task>(task: &T, view: &View<'_, S>, most: f64) -> S {
    let mut sum = Sum(None);
    task.loss(view, &mut sum);
    match sum.0 {
        Some(sum) => sum.min(S::constant(most)),
        None => S::zero(),
    }
}

/// Keeps names, and counts numbers.
#[derive(Debug, Default)]
pub(crate) struct Declaration {
    fields: Vec<Field>,
    /// Numbers to come that are counted already.
    counted: usize,
}

impl Declaration {
    /// The field that is open; one without a name where there is none.
    fn open(&mut self) -> &mut Field {
        if self.fields.is_empty() {
            self.fields.push(Field::default());
        }
        let last = self.fields.len() - 1;
        &mut self.fields[last]
    }
}

impl Writer<f64> for Declaration {
    fn number(&mut self, _: f64) {
        match self.counted {
            0 => self.open().size += 1,
            _ => self.counted -= 1,
        }
    }
    fn field(&mut self, name: &'static str, unit: &'static str, meaning: &'static str) -> &mut Self {
        self.fields.push(Field::new(name, 0, unit, meaning));
        self
    }
    fn within(&mut self, low: f64, high: f64) -> &mut Self {
        (self.open().low, self.open().high) = (low, high);
        self
    }
    fn smoothness(&mut self, smoothness: Smoothness) -> &mut Self {
        self.open().smoothness = smoothness;
        self
    }
    fn layout(&mut self, layout: Layout) -> &mut Self {
        self.open().layout = layout;
        self
    }
}

impl Ends<f64> for Vec<End> {
    fn when(&mut self, name: &'static str, condition: &'static str, _: bool) {
        self.push(End { name: name.into(), condition: condition.into() });
    }
}

impl Loss<f64> for Vec<String> {
    fn add(&mut self, formula: &'static str, _: f64) {
        self.push(formula.into());
    }
}

/// What stays through an episode: written once by name where an episode starts, changed by place in events.
#[derive(Debug)]
pub struct Goal<'a> {
    numbers: &'a mut Vec<f64>,
    at: usize,
    names: Option<Declaration>,
}

impl<'a> Goal<'a> {
    /// Over numbers that are there.
    pub(crate) fn over(numbers: &'a mut Vec<f64>) -> Self {
        Self { numbers, at: 0, names: None }
    }
}

impl Deref for Goal<'_> {
    type Target = [f64];
    fn deref(&self) -> &[f64] {
        self.numbers
    }
}

impl DerefMut for Goal<'_> {
    fn deref_mut(&mut self) -> &mut [f64] {
        self.numbers
    }
}

impl Writer<f64> for Goal<'_> {
    fn number(&mut self, value: f64) {
        match self.numbers.get_mut(self.at) {
            Some(place) => *place = value,
            None => self.numbers.push(value),
        }
        self.at += 1;
        self.names.iter_mut().for_each(|names| names.number(value));
    }
    fn field(&mut self, name: &'static str, unit: &'static str, meaning: &'static str) -> &mut Self {
        self.names.iter_mut().for_each(|names| _ = names.field(name, unit, meaning));
        self
    }
    fn within(&mut self, low: f64, high: f64) -> &mut Self {
        self.names.iter_mut().for_each(|names| _ = names.within(low, high));
        self
    }
}

/// Most numbers that a task keeps from step to step.
pub(crate) const MAX_TASK_STATE: usize = 256;

/// An episode that a task began: physics, and the goal with its names.
struct Begun {
    state: Vec<f64>,
    numbers: Vec<f64>,
    goal: Vec<f64>,
    fields: Vec<Field>,
}

fn begun<T: Task>(task: &T, begin: fn(&T, &mut Start<'_>)) -> Begun {
    let robot = task.robot();
    let (mut state, mut numbers) = (robot.rest().to_vec(), robot.parameters());
    let (mut goal, mut task_state) = (Vec::new(), vec![0.0; MAX_TASK_STATE]);
    let [reset, draws, once] = streams(0, 0, 0);
    let mut start = Start {
        robot,
        state: &mut state,
        goal: Goal { names: Some(Declaration::default()), ..Goal::over(&mut goal) },
        task_state: &mut task_state,
        numbers: &mut numbers,
        reset,
        task: draws,
        once,
        event_at: f64::INFINITY,
        difficulty: 1.0,
    };
    begin(task, &mut start);
    let fields = start.goal.names.take().unwrap_or_default().fields;
    Begun { state, numbers, goal, fields }
}

/// Lets a task write everything once, in its ideal state, and keeps what it said.
///
/// # Errors
/// [`Error::Value`] for numbers without a name or under a name twice, for a summand or figure of more than one number, for
/// goals that starts and the ideal write differently, for a success by a figure that is none; [`Error::Limit`] above
/// [`MAX_TASK_STATE`].
pub(crate) fn declare<T: Task>(task: &T) -> Result<TaskSpec> {
    let (started, ideal, robot) = (begun(task, T::start), begun(task, T::ideal), task.robot());
    if started.fields != ideal.fields {
        let names =
            |fields: &[Field]| fields.iter().map(|f| format!("{} ({})", f.name, f.size)).collect::<Vec<_>>().join(", ");
        let (own, other) = (names(&started.fields), names(&ideal.fields));
        return Err(Error::value("goal of a start", own, format!("that of the ideal: {other}"), "Write both alike."));
    }
    let mut frames = vec![0.0; robot.n_frame() * FRAME];
    robot.plant().write_frames(&ideal.numbers, &ideal.state, &mut frames);
    let rotors = robot.drones().iter().flat_map(|d| &d.rotors);
    let speeds: Vec<f64> = rotors.map(|r| ideal.state[r.speed]).collect();
    let task_state = vec![0.0; MAX_TASK_STATE];
    let view = View {
        robot,
        state: StridedView::of(&ideal.state[..]),
        frames: StridedView::of(&frames[..]),
        speeds_before: StridedView::of(&speeds[..]),
        goal: StridedView::of(&ideal.goal[..]),
        task_state: StridedView::of(&task_state[..]),
        step: 0.0,
        clock: 0.0,
    };
    let settings = task.settings();
    let list = |what: &str, write: &dyn Fn(&mut Declaration)| {
        let mut writer = Declaration::default();
        write(&mut writer);
        named(what, writer.fields, &settings)
    };
    let kept = list("task state", &|out| task.remember(&view, out))?;
    if total(&kept) > MAX_TASK_STATE {
        return Err(Error::limit("numbers of the task state", total(&kept), MAX_TASK_STATE, "Keep fewer."));
    }
    let metrics = single("figure", list("figure", &|out| task.metrics(&view, out))?)?;
    let metrics: Vec<Metric> = metrics.into_iter().map(|f| Metric { name: f.name, unit: f.unit }).collect();
    let term =
        |f: Field| Term { name: f.name, formula: f.meaning, low: f.low, bound: f.high, smoothness: f.smoothness };
    let reward = single("summand of the reward", list("summand of the reward", &|out| task.reward(&view, out))?)?;
    let (mut ends, mut loss): (Vec<End>, Vec<String>) = (Vec::new(), Vec::new());
    task.ends(&view, &mut ends);
    task.loss(&view, &mut loss);
    ends.iter_mut().for_each(|end| end.condition = filled(&end.condition, &settings));
    loss.iter_mut().for_each(|formula| *formula = filled(formula, &settings));
    let mut success = task.success_rule();
    success.also = filled(&success.also, &settings);
    for limit in &mut success.limits {
        let metric = metrics.iter().find(|m| m.name == limit.metric).ok_or_else(|| Error::Unknown {
            kind: "figure of the task",
            name: limit.metric.clone(),
            known: metrics.iter().map(|m| m.name.clone()).collect(),
        })?;
        limit.unit.clone_from(&metric.unit);
    }
    let seen = (0..task.n_agent().max(1)).map(|agent| list("observation", &|out| task.observe(&view, agent, out)));
    let seen = seen.collect::<Result<Vec<_>>>()?;
    let observation_of: Vec<usize> = seen.iter().map(|fields| total(fields)).collect();
    let widest = observation_of.iter().copied().fold(0, usize::max);
    let observation = seen.into_iter().find(|fields| total(fields) == widest).unwrap_or_default();
    Ok(TaskSpec {
        about: filled(task.about(), &settings),
        observation,
        observation_of,
        central: list("central state", &|out| task.central(&view, out))?,
        reward: reward.into_iter().map(term).collect(),
        ends,
        metrics,
        success,
        loss,
        goal: named("goal", ideal.fields, &settings)?,
        task_state: kept,
        settings,
    })
}

/// Fields with the values of settings in their meanings, each with a name of its own.
fn named(what: &str, mut fields: Vec<Field>, settings: &[Setting]) -> Result<Vec<Field>> {
    for i in 0..fields.len() {
        let name = &fields[i].name;
        if name.is_empty() || fields[..i].iter().any(|f| f.name == *name) {
            let remedy = "Call field(name, unit, meaning) before its numbers, once.";
            return Err(Error::value(format!("name of a {what}"), format!("'{name}'"), "one of its own", remedy));
        }
        let Field { name, size, layout, .. } = &fields[i];
        let shape = layout.shape(*size);
        if shape.iter().product::<usize>() != *size {
            let (what, limit) = (format!("shape of {what} '{name}'"), format!("of its {size} numbers"));
            return Err(Error::value(what, format!("{shape:?}"), limit, "Write as many numbers as the shape has."));
        }
        fields[i].meaning = filled(&fields[i].meaning, settings);
    }
    Ok(fields)
}

/// Refuses fields of more than one number.
fn single(what: &str, fields: Vec<Field>) -> Result<Vec<Field>> {
    match fields.iter().find(|f| f.size != 1) {
        None => Ok(fields),
        Some(f) => Err(Error::value(format!("numbers of {what} '{}'", f.name), f.size, "1", "Name each number.")),
    }
}
