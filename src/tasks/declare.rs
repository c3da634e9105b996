//! Tasks declare by writing: whoever writes a number says beside it what it is.
//!
//! When an environment is made, the task writes everything once in its ideal state, and the names are kept: that is its
//! [`TaskSpec`](super::TaskSpec). When a step is recorded, the numbers are.
//! `{key}` in them stands for the value of a setting, `{×key}` for a factor.

use super::task_spec::{End, Field, FieldLayout, Smoothness};
use autodiff::{Scalar, Trace, TraceMask};
use std::ops::{Deref, DerefMut};

/// Takes numbers one after the other, and what they are called.
///
/// `out.field("target", "m, world", "p_t − p").array(error)` opens a field and writes its numbers; what is written until the
/// next field belongs to it.
#[derive(Debug)]
pub struct Writer<S = Trace> {
    fields: Vec<Field>,
    numbers: Vec<S>,
    is_muted: bool,
}

impl<S> Default for Writer<S> {
    fn default() -> Self {
        Self { fields: Vec::new(), numbers: Vec::new(), is_muted: false }
    }
}

impl<S> Writer<S> {
    /// What `write` wrote.
    pub(crate) fn written(write: impl FnOnce(&mut Self)) -> Self {
        let mut own = Self::default();
        write(&mut own);
        own
    }

    /// The numbers.
    pub(crate) fn numbers(self) -> Vec<S> {
        self.numbers
    }

    /// What they are.
    pub(crate) fn fields(self) -> Vec<Field> {
        self.fields
    }

    /// The field that is open; one without a name where there is none.
    fn open(&mut self) -> &mut Field {
        if self.fields.is_empty() {
            self.fields.push(Field::default());
        }
        let last = self.fields.len() - 1;
        &mut self.fields[last]
    }

    fn describe(&mut self, describe: impl FnOnce(&mut Field)) -> &mut Self {
        if !self.is_muted {
            describe(self.open());
        }
        self
    }

    /// The next number.
    pub fn number(&mut self, value: S) {
        self.open().size += 1;
        self.numbers.push(value);
    }

    /// The next numbers.
    pub fn array(&mut self, values: impl IntoIterator<Item = S>) {
        values.into_iter().for_each(|value| self.number(value));
    }

    /// The numbers to come are a field of this name, unit (with the frame) and meaning.
    pub fn field(&mut self, name: impl Into<String>, unit: impl Into<String>, meaning: impl Into<String>) -> &mut Self {
        if !self.is_muted {
            self.fields.push(Field::new(name, 0, unit, meaning));
        }
        self
    }

    /// Fields with their numbers, as another writer took them.
    pub(crate) fn write(&mut self, fields: &[Field], numbers: impl IntoIterator<Item = S>) {
        if self.is_muted {
            return self.array(numbers);
        }
        self.fields.extend_from_slice(fields);
        self.numbers.extend(numbers);
    }

    /// What the numbers are so far.
    #[doc(hidden)]
    pub fn named(&self) -> Vec<Field> {
        self.fields.clone()
    }

    /// The numbers, without their names.
    #[doc(hidden)]
    pub fn into_numbers(self) -> Vec<S> {
        self.numbers
    }

    /// What was written: numbers, and what they are.
    pub(crate) fn parts(self) -> (Vec<S>, Vec<Field>) {
        (self.numbers, self.fields)
    }

    /// Each number of the field lies within [`low`, `high`].
    pub fn within(&mut self, low: f64, high: f64) -> &mut Self {
        self.describe(|field| (field.low, field.high) = (low, high))
    }

    /// How far gradients of the field may be trusted; by default [`Smoothness::Smooth`].
    pub fn smoothness(&mut self, smoothness: Smoothness) -> &mut Self {
        self.describe(|field| field.smoothness = smoothness)
    }

    /// Differentiable but on a thin set.
    pub fn piecewise(&mut self) -> &mut Self {
        self.smoothness(Smoothness::Piecewise)
    }

    /// With jumps.
    pub fn non_smooth(&mut self) -> &mut Self {
        self.smoothness(Smoothness::NonSmooth)
    }

    /// How the numbers of the field are arranged; by default [`FieldLayout::Vector`].
    pub fn layout(&mut self, layout: FieldLayout) -> &mut Self {
        self.describe(|field| field.layout = layout)
    }

    /// The field is an image: rows of pixels from above, all channels of a pixel together.
    pub fn image(&mut self, height: usize, width: usize, channels: usize) -> &mut Self {
        self.layout(FieldLayout::Image { height, width, channels })
    }

    /// The field is distances along the beams of a lidar, row by row.
    pub fn lidar(&mut self, rows: usize, columns: usize) -> &mut Self {
        self.layout(FieldLayout::Lidar { rows, columns })
    }

    /// The field is the same numbers of several alike, one after the other.
    pub fn members(&mut self, members: usize) -> &mut Self {
        self.layout(FieldLayout::Members { members })
    }

    /// The number to come is a summand of the reward between 0 and `bound`; where it may be less, [`within`](Self::within) gives
    /// its least value.
    pub fn term(&mut self, name: impl Into<String>, formula: impl Into<String>, bound: f64) -> &mut Self {
        self.field(name, "-", formula).within(0.0, bound)
    }

    /// The next number is a figure that is reported in every step, in this unit.
    pub fn metric(&mut self, name: impl Into<String>, unit: impl Into<String>, value: S) {
        self.field(name, unit, "now").number(value);
    }

    /// Numbers that are parts of the open field, whatever names `write` gives them.
    pub fn unnamed(&mut self, write: impl FnOnce(&mut Self)) {
        let was_muted = std::mem::replace(&mut self.is_muted, true);
        write(self);
        self.is_muted = was_muted;
    }
}

/// Takes reasons to terminate, and when each holds.
#[derive(Debug, Default)]
pub struct Ends {
    pub(crate) ends: Vec<End>,
    pub(crate) masks: Vec<TraceMask>,
}

impl Ends {
    /// The next reason, and when it holds.
    pub fn when(&mut self, name: impl Into<String>, condition: impl Into<String>, mask: TraceMask) {
        self.ends.push(End { name: name.into(), condition: condition.into() });
        self.masks.push(mask);
    }
}

/// Takes the summands of a training loss.
#[derive(Debug, Default)]
pub struct Loss {
    pub(crate) formulas: Vec<String>,
    pub(crate) summands: Vec<Trace>,
}

impl Loss {
    /// The next one and its formula, in the symbols of [`TaskSpec::about`](super::TaskSpec::about).
    pub fn add(&mut self, formula: impl Into<String>, value: Trace) {
        self.formulas.push(formula.into());
        self.summands.push(value);
    }

    /// The sum, cut at `most`.
    pub(crate) fn cut(&self, most: f64) -> Trace {
        // not from zero, which recordings would add
        let sum = self.summands.iter().copied().reduce(|sum, value| sum + value);
        sum.map_or(Trace::zero(), |sum| sum.min(Trace::constant(most)))
    }
}

/// What stays through an episode: written once by name where an episode starts, changed by place in events.
#[derive(Debug)]
pub struct Goal<'a, S = Trace> {
    numbers: &'a mut Vec<S>,
    at: usize,
    names: Option<Writer<S>>,
}

impl<'a, S> Goal<'a, S> {
    /// Over numbers that are there.
    pub(crate) fn over(numbers: &'a mut Vec<S>) -> Self {
        Self { numbers, at: 0, names: None }
    }

    /// That keeps names.
    pub(crate) fn named(numbers: &'a mut Vec<S>) -> Self {
        Self { numbers, at: 0, names: Some(Writer::default()) }
    }

    /// That goes on where another was [left](Self::left).
    pub(crate) fn going_on(numbers: &'a mut Vec<S>, at: usize, names: Option<Writer<S>>) -> Self {
        Self { numbers, at, names }
    }

    /// Where it is, and the names so far.
    pub(crate) fn left(self) -> (usize, Option<Writer<S>>) {
        (self.at, self.names)
    }

    /// Those that were kept.
    pub(crate) fn fields(self) -> Vec<Field> {
        self.names.unwrap_or_default().fields()
    }
}

impl<S> Deref for Goal<'_, S> {
    type Target = [S];
    fn deref(&self) -> &[S] {
        self.numbers
    }
}

impl<S> DerefMut for Goal<'_, S> {
    fn deref_mut(&mut self) -> &mut [S] {
        self.numbers
    }
}

impl<S: Copy> Goal<'_, S> {
    /// The next number.
    pub fn number(&mut self, value: impl Into<S>) {
        let value = value.into();
        match self.numbers.get_mut(self.at) {
            Some(place) => *place = value,
            None => self.numbers.push(value),
        }
        self.at += 1;
        self.names.iter_mut().for_each(|names| names.number(value));
    }

    /// Fields with their numbers, as another goal took them.
    pub(crate) fn write(&mut self, fields: &[Field], numbers: impl IntoIterator<Item = S>) {
        // sizes of fields are counted from their numbers
        let names = self.names.take();
        self.array(numbers);
        self.names = names;
        self.names.iter_mut().for_each(|names| names.write(fields, []));
    }

    /// The next numbers.
    pub fn array<X: Into<S>>(&mut self, values: impl IntoIterator<Item = X>) {
        values.into_iter().for_each(|value| self.number(value));
    }

    /// The numbers to come are a field of this name, unit (with the frame) and meaning.
    pub fn field(&mut self, name: impl Into<String>, unit: impl Into<String>, meaning: impl Into<String>) -> &mut Self {
        if let Some(names) = &mut self.names {
            names.field(name, unit, meaning);
        }
        self
    }

    /// Each number of the field lies within [`low`, `high`].
    pub fn within(&mut self, low: f64, high: f64) -> &mut Self {
        self.names.iter_mut().for_each(|names| _ = names.within(low, high));
        self
    }
}
