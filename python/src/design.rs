//! Margins of the loop that flies, and feedback of least cost, from Python.

use crate::arrays::{array, read, slice};
use crate::control::{StateSpace, Trim, data, gains_of, matrix, vehicle};
use crate::error::{OrRaise, unexpected};
use crate::law::Choice;
use crate::settings;
use nalgebra::{Complex, DMatrix};
use omnidrones::controllers::design::{self as library, AnalysisPoint, ErrorState, LoopModel, TrimTarget};
use omnidrones::controllers::linear::Signal;
use omnidrones::controllers::reference::{Hover, Reference};
use omnidrones::controllers::registry::Setup;
use omnidrones::controllers::{ClosedLoop, LawController, Target};
use omnidrones::dynamics::{Disturbance, Physics, Plant};
use omnidrones::error::Error;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};
use toml::Table;

/// The control loop of a vehicle about hover, sampled, with all its rates, holds and latency, and what it bears.
#[pyclass(module = "omnidrones", frozen)]
pub struct Design {
    model: LoopModel,
    trim: Py<Trim>,
}

/// What a vehicle's control loop bears about hover, as `omnidrones design` reports it.
///
/// Parameters
/// ----------
/// vehicle : Vehicle or str or path
/// controller : str or ControlLaw, optional
///     As "lqi", or one of your own, in place of the cascade.
/// gains : dict, optional
///     Of the cascade, as `Vehicle.gains`, which are the default.
/// rates : dict, optional
///     How often each level computes, Hz: "velocity", "attitude", "rate".
/// latency : int
///     Steps by which commands act late.
/// wind : three floats, optional
///     In which it holds its place, m/s, world.
/// **physics
///     `dt=0.002` (s), `substeps`, `integrator`, `effects`.
#[pyfunction]
#[pyo3(signature = (
    vehicle, /, *, controller=None, gains=None, rates=None, latency=0, wind=None, **physics
))]
#[expect(clippy::too_many_arguments, reason = "by name in Python")]
pub fn design(
    py: Python<'_>,
    vehicle: &Bound<'_, PyAny>,
    controller: Option<&Bound<'_, PyAny>>,
    gains: Option<&Bound<'_, PyMapping>>,
    rates: Option<&Bound<'_, PyDict>>,
    latency: usize,
    wind: Option<[f64; 3]>,
    physics: Option<&Bound<'_, PyDict>>,
) -> PyResult<Design> {
    let vehicle = self::vehicle(vehicle)?;
    let (mut physics, rates): (Physics, _) = (data("physics", physics)?, data("rates", rates)?);
    physics.effects.disturbance |= wind.is_some();
    let plant = Plant::of_vehicle(&vehicle, physics).or_raise()?;
    let (choice, gains) = (Choice::of(controller, &plant, gains.is_some())?, gains_of(gains)?);
    let air = Disturbance { wind: wind.unwrap_or_default(), ..Disturbance::none() };
    let found = || {
        vehicle.check_steerable()?;
        let trim = library::trim(&plant, &TrimTarget { air, ..TrimTarget::hover() })?;
        let linear = ErrorState::of_plant(&plant)?.state_space(&plant, &trim.state, &trim.input, trim.yaw_rate)?;
        let hover = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
        let model = if let Choice::Default = choice {
            let gains = gains.unwrap_or_else(|| vehicle.gains());
            let closed = ClosedLoop::of_vehicle(&vehicle, physics, &gains, &rates)?.with_latency(latency)?;
            LoopModel::of_vehicle(closed, Target::level(&hover), &air, &trim.state)?
        } else {
            let own = choice.build(&plant, &Setup::new(gains.as_ref(), &rates))?;
            let Some(law) = own.recorded(&plant)? else {
                let remedy = "Take 'cascade', 'indi', 'lqi' or 'lqr', or one of your own.";
                return Err(Error::value("controller", own.name(), "a law over any scalar", remedy));
            };
            let closed = ClosedLoop::new(plant, LawController::of(law))?.with_latency(latency)?;
            LoopModel::new(closed, Target::level(&hover), &air, &trim.state)?
        };
        Ok((trim, linear, model))
    };
    let (trim, linear, model) = py.detach(found).or_raise()?;
    Ok(Design { model, trim: Py::new(py, Trim::of(py, trim, linear)?)? })
}

#[pymethods]
impl Design {
    /// The steady flight, and the linear model of the plant alone.
    #[getter]
    fn trim(&self, py: Python<'_>) -> Py<Trim> {
        self.trim.clone_ref(py)
    }

    /// Where the loop may be opened: commands, then numbers that the controller sees.
    #[getter]
    fn points(&self) -> Vec<String> {
        self.signals().map(|signal| signal.name.clone()).collect()
    }

    /// Poles of the closed loop over a period of all its rates, largest first, complex128 [pole]: stable within the unit circle.
    #[getter]
    fn poles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        complex(py, py.detach(|| self.model.poles()).or_raise()?)
    }

    /// Whether it settles: "stable", "marginal: ..." with the combinations of states that commands do not settle, or "unstable: ...".
    #[getter]
    fn stability(&self, py: Python<'_>) -> PyResult<String> {
        Ok(py.detach(|| self.model.stability()).or_raise()?.to_string())
    }

    /// Steps of that period.
    #[getter]
    fn period(&self) -> usize {
        self.model.period()
    }

    /// What the loop bears at a point, by name: "stable", "gain_up" and "gain_down" (factors), "phase" (rad), "delay" (s) and "disk"
    /// ("alpha", "omega" in rad/s, "gain", "phase"). Without a point the disk margin of all commands at once.
    #[pyo3(signature = (point=None))]
    fn margins<'py>(&self, py: Python<'py>, point: Option<&str>) -> PyResult<Bound<'py, PyDict>> {
        let table = match point {
            Some(name) => {
                let point = self.point(name)?;
                Table::try_from(py.detach(|| self.model.margins(point)).or_raise()?)
            }
            None => Table::try_from(py.detach(|| self.model.disk_margin(AnalysisPoint::Commands, 0.0)).or_raise()?),
        };
        settings::dict(py, &table.map_err(unexpected)?)
    }

    /// The sensitivity at a point over frequencies (rad/s, up to pi/dt), complex128 [frequency]: S = 1/(1 + L), so the loop is 1/S - 1.
    fn sensitivity<'py>(
        &self,
        py: Python<'py>,
        point: &str,
        frequencies: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (point, rows) = (self.point(point)?, read("frequencies", frequencies, &[frequencies.len()?])?);
        let omega = slice(&rows)?;
        complex(py, py.detach(|| self.model.response(point, omega)).or_raise()?)
    }

    /// The loop opened at a point, over a period: a system of as many inputs and outputs as it has steps, to be closed with -1.
    fn open(&self, py: Python<'_>, point: &str) -> PyResult<StateSpace> {
        let point = self.point(point)?;
        Ok(StateSpace(py.detach(|| self.model.open(point)).or_raise()?))
    }

    fn __repr__(&self) -> String {
        format!("Design({} commands, period {} steps of {} s)", self.model.commands.len(), self.period(), self.model.dt)
    }
}

impl Design {
    fn signals(&self) -> impl Iterator<Item = &Signal> {
        self.model.commands.iter().chain(&self.model.measurements)
    }

    fn point(&self, name: &str) -> PyResult<AnalysisPoint> {
        let n = self.model.commands.len();
        match self.signals().position(|signal| signal.name == name) {
            Some(k) if k < n => Ok(AnalysisPoint::Command(k)),
            Some(k) => Ok(AnalysisPoint::Measurement(k - n)),
            None => {
                Err(Error::Unknown { kind: "point of the loop", name: name.into(), known: self.points() }).or_raise()
            }
        }
    }
}

pub fn complex<'py>(py: Python<'py>, numbers: Vec<Complex<f64>>) -> PyResult<Bound<'py, PyAny>> {
    let n = numbers.len();
    array(py, numbers, &[n])
}

/// An optimal feedback u = -K x.
#[pyclass(module = "omnidrones", frozen, get_all)]
pub struct Regulator {
    /// K, float64 [input, state].
    pub gain: Py<PyAny>,
    /// X, float64 [state, state]: x' X x is the cost from x on.
    cost: Py<PyAny>,
    /// Eigenvalues of A - B K, complex128 [state], largest first.
    poles: Py<PyAny>,
}

/// The feedback of least sum of x' Q x + u' R u for a sampled model.
///
/// Parameters
/// ----------
/// model : StateSpace
///     As `linearise` gives it.
/// Q : array [state, state]
///     float64, symmetric.
/// R : array [input, input]
///     float64, symmetric, positive definite.
#[pyfunction]
#[pyo3(signature = (model, Q, R, /))]
#[expect(non_snake_case, reason = "as control engineers write them")]
pub fn lqr<'py>(
    py: Python<'py>,
    model: &StateSpace,
    Q: &Bound<'py, PyAny>,
    R: &Bound<'py, PyAny>,
) -> PyResult<Regulator> {
    let own = &model.0;
    if own.dt().is_none() {
        let remedy = "Give the model of one step, or design in python-control: model.to_control().";
        return Err(Error::value("model", "dx/dt", "sampled", remedy)).or_raise();
    }
    let square = |name: &str, given: &Bound<'py, PyAny>, n: usize| -> PyResult<DMatrix<f64>> {
        Ok(DMatrix::from_row_slice(n, n, slice(&read(name, given, &[n, n])?)?))
    };
    let (q, r) = (square("Q", Q, own.n_state())?, square("R", R, own.n_input())?);
    let found = py.detach(|| library::lqr_of(own.states(), own.a(), own.b(), &q, &r)).or_raise()?;
    Ok(Regulator {
        gain: matrix(py, &found.gain)?.unbind(),
        cost: matrix(py, &found.cost)?.unbind(),
        poles: complex(py, found.poles)?.unbind(),
    })
}
