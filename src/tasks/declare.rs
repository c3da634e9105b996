//! Tasks declare by writing: whoever writes a number says beside it what it is.
//!
//! Kernels hand a task writers that ignore the names, which leaves no trace in their code. Once, when an environment is made,
//! the task writes everything in its ideal state, and the names are kept: that is its [`TaskSpec`](super::TaskSpec).
//! Words are constants; `{key}` in them stands for the value of a setting, `{×key}` for a factor.

use super::task_spec::{End, Field, Layout, Smoothness};
use crate::autodiff::unrolled::unrolled;
use crate::autodiff::{Scalar, StridedWriter};
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
    /// The next one and its formula, in the symbols of [`TaskSpec::about`](super::TaskSpec::about).
    fn add(&mut self, formula: &'static str, value: S);
}

/// A kernel's: the sum so far.
pub(crate) struct Sum<S>(Option<S>);

impl<S: Scalar> Sum<S> {
    /// Of no summand.
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self(None)
    }

    /// Cut at `most`.
    #[inline(always)]
    pub(crate) fn cut(self, most: f64) -> S {
        match self.0 {
            Some(sum) => sum.min(S::constant(most)),
            None => S::zero(),
        }
    }
}

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

/// Keeps names and numbers.
#[derive(Debug)]
pub(crate) struct Declaration<S> {
    pub fields: Vec<Field>,
    pub numbers: Vec<S>,
}

impl<S> Default for Declaration<S> {
    fn default() -> Self {
        Self { fields: Vec::new(), numbers: Vec::new() }
    }
}

impl<S> Declaration<S> {
    /// The field that is open; one without a name where there is none.
    fn open(&mut self) -> &mut Field {
        if self.fields.is_empty() {
            self.fields.push(Field::default());
        }
        let last = self.fields.len() - 1;
        &mut self.fields[last]
    }
}

// Each is called from every line of every task: calls keep those lines short.

impl<S: Scalar> Writer<S> for Declaration<S> {
    #[inline(never)]
    fn number(&mut self, value: S) {
        self.open().size += 1;
        self.numbers.push(value);
    }
    #[inline(never)]
    fn field(&mut self, name: &'static str, unit: &'static str, meaning: &'static str) -> &mut Self {
        self.fields.push(Field::new(name, 0, unit, meaning));
        self
    }
    #[inline(never)]
    fn within(&mut self, low: f64, high: f64) -> &mut Self {
        (self.open().low, self.open().high) = (low, high);
        self
    }
    #[inline(never)]
    fn smoothness(&mut self, smoothness: Smoothness) -> &mut Self {
        self.open().smoothness = smoothness;
        self
    }
    #[inline(never)]
    fn layout(&mut self, layout: Layout) -> &mut Self {
        self.open().layout = layout;
        self
    }
}

impl<S: Scalar> Ends<S> for Vec<End> {
    #[inline(never)]
    fn when(&mut self, name: &'static str, condition: &'static str, _: S::Mask) {
        self.push(End { name: name.into(), condition: condition.into() });
    }
}

/// Keeps formulas and the sum.
pub(crate) struct DeclaredLoss<S> {
    pub formulas: Vec<String>,
    pub sum: Sum<S>,
}

impl<S: Scalar> Loss<S> for DeclaredLoss<S> {
    #[inline(never)]
    fn add(&mut self, formula: &'static str, value: S) {
        self.formulas.push(formula.into());
        self.sum.add(formula, value);
    }
}

/// What stays through an episode: written once by name where an episode starts, changed by place in events.
#[derive(Debug)]
pub struct Goal<'a> {
    numbers: &'a mut Vec<f64>,
    at: usize,
    names: Option<Declaration<f64>>,
}

impl<'a> Goal<'a> {
    /// Over numbers that are there.
    pub(crate) fn over(numbers: &'a mut Vec<f64>) -> Self {
        Self { numbers, at: 0, names: None }
    }

    /// That keeps names.
    pub(crate) fn named(numbers: &'a mut Vec<f64>) -> Self {
        Self { numbers, at: 0, names: Some(Declaration::default()) }
    }

    /// Those that were kept.
    pub(crate) fn fields(self) -> Vec<Field> {
        self.names.unwrap_or_default().fields
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
