//! References and winds written in Python, as functions of time: called once, with a time that records.

use crate::law::Raised;
use crate::number::{number, traces};
use omnidrones::autodiff::{Scalar, Trace};
use omnidrones::controllers::reference::{Reference, WrittenCurve};
use omnidrones::dynamics::aero::wind::{Wind, WrittenWind};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

/// A plan's keywords, and what of them is a function.
pub struct Courses<'py> {
    pub plan: Option<Bound<'py, PyDict>>,
    pub reference: Option<Reference>,
    pub wind: Option<Wind>,
}

impl<'py> Courses<'py> {
    pub fn of(plan: Option<&Bound<'py, PyDict>>) -> PyResult<Self> {
        let Some(plan) = plan else { return Ok(Self { plan: None, reference: None, wind: None }) };
        let plan = plan.copy()?;
        let taken = |name: &str| -> PyResult<Option<Bound<'py, PyAny>>> {
            let Some(own) = plan.get_item(name)?.filter(|own| own.is_callable()) else { return Ok(None) };
            plan.del_item(name)?;
            Ok(Some(own))
        };
        let reference = taken("reference")?.map(|own| reference(&own)).transpose()?;
        let wind = taken("wind")?.map(|own| wind(&own)).transpose()?;
        Ok(Self { plan: Some(plan), reference, wind })
    }
}

/// Of a function from the time to a position, or to a tuple of position and yaw.
pub fn reference(function: &Bound<'_, PyAny>) -> PyResult<Reference> {
    let py = function.py();
    let curve = |t: Trace| -> Result<[Trace; 6], Raised> {
        let told = function.call1((number(py, &[t], &[])?,))?;
        let (place, yaw) = match told.cast::<PyTuple>() {
            Ok(pair) if pair.len() == 2 => (pair.get_item(0)?, Some(pair.get_item(1)?)),
            _ => (told, None),
        };
        let place = traces("the position of the reference", &place, Some(&[3]))?;
        let yaw = yaw.map(|yaw| traces("the yaw of the reference", &yaw, Some(&[]))).transpose()?;
        let yaw = yaw.map_or_else(Trace::zero, |yaw| yaw[0]);
        Ok([place[0], place[1], place[2], yaw, Trace::zero(), Trace::zero()])
    };
    WrittenCurve::new(None, curve).map(Reference::own).map_err(Raised::into)
}

/// Of a function from the time to a velocity.
fn wind(function: &Bound<'_, PyAny>) -> PyResult<Wind> {
    let py = function.py();
    let own = |t: Trace| -> Result<[Trace; 3], Raised> {
        let told = function.call1((number(py, &[t], &[])?,))?;
        let velocity = traces("the velocity of the wind", &told, Some(&[3]))?;
        Ok([velocity[0], velocity[1], velocity[2]])
    };
    WrittenWind::new(own).map(Wind::Own).map_err(Raised::into)
}
