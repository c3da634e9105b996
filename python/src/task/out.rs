//! What a task in Python writes: numbers with their names beside them.

use super::shown::View;
use crate::error::OrRaise;
use crate::number::{mask, traces};
use omnidrones::error::Error;
use omnidrones::tasks::{self, FieldLayout, Smoothness};
use pyo3::exceptions::{PyRuntimeError, PyTypeError};
use pyo3::prelude::*;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What is lent to Python while it writes, and taken back behind it.
pub struct Lent<T>(Mutex<Option<T>>);

impl<T> Lent<T> {
    pub fn new(own: T) -> Self {
        Self(Mutex::new(Some(own)))
    }

    fn lock(&self) -> MutexGuard<'_, Option<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn take(&self) -> Option<T> {
        self.lock().take()
    }

    /// Does something with it.
    pub fn with<R>(&self, work: impl FnOnce(&mut T) -> PyResult<R>) -> PyResult<R> {
        match &mut *self.lock() {
            Some(own) => work(own),
            None => Err(PyRuntimeError::new_err(
                "this was lent for one call, which is over. Write within the method that it was given to.",
            )),
        }
    }
}

/// Takes numbers one after the other, and what they are called.
#[pyclass(module = "omnidrones", frozen)]
pub struct Writer(pub Lent<tasks::Writer>);

/// How a field is arranged: a size alone, or ("image", height, width, channels), ("lidar", rows, columns), ("members", members).
fn layout(given: &Bound<'_, PyAny>) -> PyResult<FieldLayout> {
    let unknown = || {
        let wanted = "('image', height, width, channels), ('lidar', rows, columns) or ('members', members)";
        PyTypeError::new_err(format!("layout is {given}, but it must be {wanted}."))
    };
    let kind: String = given.get_item(0).and_then(|own| own.extract()).map_err(|_| unknown())?;
    let n = |k: usize| given.get_item(k).and_then(|own| own.extract::<usize>()).map_err(|_| unknown());
    Ok(match kind.as_str() {
        "image" => FieldLayout::Image { height: n(1)?, width: n(2)?, channels: n(3)? },
        "lidar" => FieldLayout::Lidar { rows: n(1)?, columns: n(2)? },
        "members" => FieldLayout::Members { members: n(1)? },
        _ => return Err(unknown()),
    })
}

/// How far gradients may be trusted.
fn smoothness(given: &str) -> PyResult<Smoothness> {
    match given {
        "smooth" => Ok(Smoothness::Smooth),
        "piecewise" => Ok(Smoothness::Piecewise),
        "non_smooth" => Ok(Smoothness::NonSmooth),
        other => Err(Error::Unknown {
            kind: "smoothness",
            name: other.into(),
            known: ["smooth", "piecewise", "non_smooth"].map(String::from).to_vec(),
        })
        .or_raise(),
    }
}

/// Bounds that are bounds.
fn bounds(what: &str, name: &str, [low, high]: [f64; 2]) -> PyResult<()> {
    if low <= high && low < f64::INFINITY && high > f64::NEG_INFINITY {
        return Ok(());
    }
    let remedy = "Give the least and the largest value that it may have.";
    Err(Error::value(format!("bounds of {what} '{name}'"), format!("[{low}, {high}]"), "low <= high", remedy))
        .or_raise()
}

#[pymethods]
impl Writer {
    /// A field of an observation, a state or a memory: its name, unit (with the frame), meaning, and its numbers.
    ///
    /// Each number lies within [`low`, `high`], where these are given. `smoothness` says how far gradients may be trusted: "smooth",
    /// "piecewise", "non_smooth". `layout` says how they are arranged: ("members", n), ("image", height, width, channels),
    /// ("lidar", rows, columns). Numbers may be left out and follow by `write`.
    #[pyo3(signature = (
        name, unit, meaning, numbers=None, *, low=f64::NEG_INFINITY, high=f64::INFINITY, smoothness="smooth", layout=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "by name in Python")]
    fn field(
        &self,
        name: String,
        unit: String,
        meaning: String,
        numbers: Option<&Bound<'_, PyAny>>,
        low: f64,
        high: f64,
        smoothness: &str,
        layout: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let what = format!("'{name}'");
        let numbers = numbers.map(|given| traces(&what, given, None)).transpose()?;
        let smoothness = self::smoothness(smoothness)?;
        let layout = layout.map(self::layout).transpose()?;
        bounds("field", &name, [low, high])?;
        self.0.with(|out| {
            out.field(name, unit, meaning).within(low, high).smoothness(smoothness);
            layout.into_iter().for_each(|layout| _ = out.layout(layout));
            out.array(numbers.into_iter().flatten());
            Ok(())
        })
    }

    /// More numbers of the field that is open.
    fn write(&self, numbers: &Bound<'_, PyAny>) -> PyResult<()> {
        let numbers = traces("numbers", numbers, None)?;
        self.0.with(|out| {
            out.array(numbers);
            Ok(())
        })
    }

    /// A summand of the reward: its name, formula, the largest value that it may have in a step, and the number. Its least value is `low`.
    #[pyo3(signature = (name, formula, bound, number, *, low=0.0, smoothness="smooth"))]
    fn term(
        &self,
        name: String,
        formula: String,
        bound: f64,
        number: &Bound<'_, PyAny>,
        low: f64,
        smoothness: &str,
    ) -> PyResult<()> {
        let smoothness = self::smoothness(smoothness)?;
        let number = traces(&format!("summand '{name}'"), number, Some(&[]))?;
        if !bound.is_finite() || !low.is_finite() {
            let remedy = "Rewards are bounded: one environment that explodes must not outweigh all others. Take a kernel, as \
                          omnidrones.rational_kernel, or np.clip.";
            let told = format!("[{low}, {bound}]");
            return Err(Error::value(format!("bounds of summand '{name}'"), told, "finite", remedy)).or_raise();
        }
        bounds("summand", &name, [low, bound])?;
        self.0.with(|out| {
            out.term(name, formula, bound).within(low, bound).smoothness(smoothness).array(number);
            Ok(())
        })
    }

    /// A figure that is reported in every step, in this unit; the first is the error, as a rule.
    fn metric(&self, name: String, unit: String, number: &Bound<'_, PyAny>) -> PyResult<()> {
        let number = traces(&format!("figure '{name}'"), number, Some(&[]))?;
        self.0.with(|out| {
            number.into_iter().for_each(|own| out.metric(&name, &unit, own));
            Ok(())
        })
    }

    /// The part of a drone's observation that all tasks share: attitude (w >= 0), velocity, angular velocity, heading, up, throttle
    /// 2s - 1 per rotor, then direction and rate of every drive.
    #[pyo3(signature = (view, drone=0))]
    fn observe_drone(&self, view: &View, drone: usize) -> PyResult<()> {
        let view = view.get()?;
        let drone = super::shown::within("drone", drone, view.robot.drones().len())?;
        self.0.with(|out| {
            view.observe_drone(drone, out);
            Ok(())
        })
    }

    /// The share of the time that is over, four times: a network hears it.
    fn observe_clock(&self, view: &View) -> PyResult<()> {
        let view = view.get()?;
        self.0.with(|out| {
            view.observe_clock(out);
            Ok(())
        })
    }

    /// What `write` writes, as parts of the field that is open, whatever names it gives them: `write` is called with this writer.
    fn unnamed(slf: &Bound<'_, Self>, write: &Bound<'_, PyAny>) -> PyResult<()> {
        let own = slf.get();
        let outer = own.0.with(|out| Ok(std::mem::take(out)))?;
        let called = write.call1((slf,));
        let inner = own.0.take().unwrap_or_default();
        *own.0.lock() = Some(outer);
        called?;
        own.0.with(|out| {
            out.array(inner.into_numbers());
            Ok(())
        })
    }
}

/// Takes reasons to terminate, and when each holds.
#[pyclass(module = "omnidrones", frozen)]
pub struct Ends(pub Lent<tasks::Ends>);

#[pymethods]
impl Ends {
    /// The next reason: its name, its condition in words, and the mask that holds it.
    fn when(&self, name: String, condition: String, mask: &Bound<'_, PyAny>) -> PyResult<()> {
        let mask = self::mask(&format!("end '{name}'"), mask)?;
        self.0.with(|ends| {
            ends.when(name, condition, mask);
            Ok(())
        })
    }
}

/// Takes the summands of a training loss.
#[pyclass(module = "omnidrones", frozen)]
pub struct Loss(pub Lent<tasks::Loss>);

#[pymethods]
impl Loss {
    /// The next summand: its formula, and the number.
    fn add(&self, formula: String, number: &Bound<'_, PyAny>) -> PyResult<()> {
        let number = traces(&format!("summand '{formula}' of the loss"), number, Some(&[]))?;
        self.0.with(|loss| {
            number.into_iter().for_each(|own| loss.add(&formula, own));
            Ok(())
        })
    }
}
