//! Vehicles, flights and linear models, from Python.

use crate::arrays::{self, array, lengths, slice};
use crate::course::Courses;
use crate::error::{OrRaise, interruptible, unexpected};
use crate::estimation::{Estimates, estimator, sensors};
use crate::figure::Figure;
use crate::law::{Choice, gains_as_given};
use crate::settings;
use nalgebra::DMatrix;
use omnidrones::controllers::allocation::{Allocator, PrioritisedAllocator, Problem};
use omnidrones::controllers::design::{self, ErrorState, TrimTarget, TunePlan};
use omnidrones::controllers::linear::{self, Signal};
use omnidrones::controllers::registry::Setup;
use omnidrones::controllers::{self, FlightCheck, FlightPlan, RotorFailure, check_flight};
use omnidrones::dynamics::urdf::{ImportOptions, import_file};
use omnidrones::dynamics::{self, Disturbance, Gains, Physics, Plant, configurations, vehicles};
use omnidrones::error::Error;
use omnidrones::layers::{self, Layer};
use omnidrones_plot::flight::FlightFigures;
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};
use std::ffi::CString;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// A multirotor: a built-in one by name, or from a TOML or URDF file.
#[pyclass(module = "omnidrones", frozen, eq)]
#[derive(PartialEq)]
pub struct Vehicle(pub dynamics::Vehicle);

/// The vehicle of a name or a file. What an import found, and what is odd about a vehicle of a file, are warnings of Python.
pub fn load(named: &str) -> PyResult<dynamics::Vehicle> {
    let (vehicle, odd) = read(named)?;
    Python::attach(|py| odd.iter().try_for_each(|text| warn(py, text)))?;
    Ok(vehicle)
}

/// A `UserWarning` at the line that called.
fn warn(py: Python<'_>, text: &str) -> PyResult<()> {
    let text = CString::new(text.replace('\0', " "))?;
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)
}

/// The vehicle, and what is to be told of it.
fn read(named: &str) -> PyResult<(dynamics::Vehicle, Vec<String>)> {
    let path = Path::new(named);
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    match extension.as_deref() {
        Some("toml") => {
            let vehicle = dynamics::Vehicle::from_toml_file(path).or_raise()?;
            let odd = vehicle.warnings().iter().map(ToString::to_string).collect();
            Ok((vehicle, odd))
        }
        Some("urdf" | "xml") => {
            let import = import_file(path, &ImportOptions::default()).or_raise()?;
            Ok((import.vehicle, import.warnings.iter().map(ToString::to_string).collect()))
        }
        _ => Ok((vehicles::by_name(named).or_raise()?, Vec::new())),
    }
}

#[pymethods]
impl Vehicle {
    /// A built-in name, as `vehicles()` lists them, or the path of a `.toml` or `.urdf` file.
    #[new]
    fn new(source: PathBuf) -> PyResult<Self> {
        Ok(Self(load(&source.to_string_lossy())?))
    }

    /// From what `to_dict` gave, changed or not: SI units, checked.
    #[staticmethod]
    fn from_dict(fields: &Bound<'_, PyMapping>) -> PyResult<Self> {
        let text = settings::table("vehicle", fields)?.to_string();
        Ok(Self(dynamics::Vehicle::from_toml_str(&text, "<dict>").or_raise()?))
    }

    /// All its numbers by the names of its file, SI units.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        settings::dict(py, &self.table()?)
    }

    /// As TOML that `Vehicle` reads back bit for bit.
    fn to_toml(&self) -> PyResult<String> {
        self.0.to_toml().or_raise()
    }

    /// As in tables and messages.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// Of all parts, kg.
    #[getter]
    fn mass(&self) -> f64 {
        self.0.mass_properties().mass
    }

    /// About the centre of mass, body axes, float64 [3, 3], kg m^2.
    #[getter]
    fn inertia<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let inertia = self.0.mass_properties().inertia;
        array(py, inertia.transpose().as_slice().to_vec(), &[3, 3])
    }

    /// How many.
    #[getter]
    fn n_rotor(&self) -> usize {
        self.0.rotors.len()
    }

    /// Gains that fly it, published or derived: position, velocity (world), attitude, rate (body), 3 each, integral 2.
    #[getter]
    fn gains<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        settings::dict(py, &Table::try_from(self.0.gains()).map_err(unexpected)?)
    }

    /// The attitude and the thrusts at which force and moment vanish: `attitude` [w, x, y, z] body to world, `thrusts` N, `lean` rad from
    /// the vertical, `reserve` the least share of its largest thrust that a rotor keeps to either limit, `tightest` that rotor.
    /// Raises `ValueError` with the row that cannot be met where there is none.
    fn hover<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let hover = self.0.hover().or_raise()?;
        let found = PyDict::new(py);
        found.set_item("attitude", array(py, hover.attitude.to_vec(), &[4])?)?;
        found.set_item("lean", hover.lean())?;
        found.set_item("reserve", hover.reserve)?;
        found.set_item("tightest", hover.tightest)?;
        let n = hover.thrusts.len();
        found.set_item("thrusts", array(py, hover.thrusts, &[n])?)?;
        Ok(found)
    }

    /// Refuses what cannot be steered: raises `ValueError` that names the axes that its rotors do not turn apart.
    fn check_steerable(&self) -> PyResult<()> {
        self.0.check_steerable().or_raise()
    }

    /// What of its numbers is probably not meant: other units, an inertia that nobody gave, rotors that do not push up.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.0.warnings().iter().map(ToString::to_string).collect()
    }

    fn __repr__(&self) -> String {
        format!("Vehicle('{}')", self.0.name)
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyDict>,))> {
        Ok((py.get_type::<Self>().getattr("from_dict")?, (self.to_dict(py)?,)))
    }
}

impl Vehicle {
    /// As its file has it.
    pub fn table(&self) -> PyResult<Table> {
        Table::try_from(&self.0).map_err(unexpected)
    }
}

/// A vehicle, its name or file, or the name of a configuration, as a plant.
pub fn plant(given: &Bound<'_, PyAny>, physics: Physics) -> PyResult<Plant> {
    if let Ok(vehicle) = given.cast::<Vehicle>() {
        return Plant::of_vehicle(&vehicle.get().0, physics).or_raise();
    }
    let named: PathBuf = given.extract()?;
    let named = named.to_string_lossy();
    if configurations::names().iter().any(|name| name.eq_ignore_ascii_case(&named)) {
        let model = configurations::by_name(&named).or_raise()?;
        return Plant::of_model(&model, physics).or_raise();
    }
    Plant::of_vehicle(&load(&named)?, physics).or_raise()
}

/// The vehicle of an argument.
pub fn vehicle(given: &Bound<'_, PyAny>) -> PyResult<dynamics::Vehicle> {
    match given.cast::<Vehicle>() {
        Ok(vehicle) => Ok(vehicle.get().0.clone()),
        Err(_) => load(&given.extract::<PathBuf>()?.to_string_lossy()),
    }
}

/// Data of a dict, over defaults.
pub fn data<T: serde::de::DeserializeOwned>(name: &str, keywords: Option<&Bound<'_, PyDict>>) -> PyResult<T> {
    let own = keywords.map(|own| settings::table("", own.cast::<PyMapping>()?)).transpose()?.unwrap_or_default();
    layers::read(Table::new(), &[Layer::of_table(name, own)]).or_raise()
}

pub fn gains_of(given: Option<&Bound<'_, PyMapping>>) -> PyResult<Option<Gains>> {
    let read = |own: &Bound<'_, PyMapping>| {
        let table = settings::table("gains", own)?;
        layers::read(Table::new(), &[Layer::of_table("gains", table)]).or_raise()
    };
    given.map(read).transpose()
}

/// A flight: columns of what was, of what was wanted, of what the rotors did.
#[pyclass(module = "omnidrones", frozen)]
pub struct Flight {
    flight: controllers::Flight,
    n_state: usize,
    judgement: FlightCheck,
    estimates: Option<Py<Estimates>>,
}

#[pymethods]
impl Flight {
    /// Columns by name with unit, new float64 arrays [sample], as in the files of the command line: what `pandas.DataFrame` takes.
    fn columns<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        for (name, column) in self.flight.log.columns() {
            let n = column.len();
            dict.set_item(name, array(py, column, &[n])?)?;
        }
        Ok(dict)
    }

    /// The plant's state, a new float64 array [sample, state].
    fn states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let n_row = self.flight.states.len() / self.n_state;
        array(py, self.flight.states.clone(), &[n_row, self.n_state])
    }

    /// Key figures by name from `after` (s) on: "rmse" and "max_error" (m), "heading_rmse", "max_heading_error" and "max_tilt" (rad),
    /// "max_speed" (m/s), "saturation" (share of rotor commands at a limit) and more. What does not exist is left out.
    #[pyo3(signature = (after=2.0))]
    fn summary<'py>(&self, py: Python<'py>, after: f64) -> PyResult<Bound<'py, PyDict>> {
        settings::dict(py, &Table::try_from(self.flight.log.summary(after)).map_err(unexpected)?)
    }

    /// A figure of it: "overview", "path", "error", "rotors", "attitude" or "rates"; the first `after` seconds are left out of the RMSE.
    #[pyo3(signature = (what="overview", *, after=2.0))]
    fn plot(&self, py: Python<'_>, what: &str, after: f64) -> PyResult<Figure> {
        let figures = py.detach(|| FlightFigures::new(&self.flight.log, after));
        let named = figures.named();
        let found = named.iter().find(|(name, _)| *name == what);
        let known = || named.iter().map(|(name, _)| name.to_string()).collect();
        let unknown = || Error::Unknown { kind: "figure of a flight", name: what.into(), known: known() };
        Ok(Figure(found.ok_or_else(unknown).or_raise()?.1.clone()))
    }

    /// What notebooks show: the overview.
    fn _repr_svg_(&self, py: Python<'_>) -> PyResult<String> {
        self.plot(py, "overview", 2.0)?.svg(py)
    }

    /// When the state exploded, s; None for a whole flight.
    #[getter]
    fn diverged_at(&self) -> Option<f64> {
        self.flight.diverged_at
    }

    /// What befell it however small its errors are, in order of time: below the ground at z = 0 (of a configuration its own), a load
    /// that turned over. Empty for a flight that is one.
    #[getter]
    fn mishaps(&self) -> Vec<String> {
        self.judgement.mishaps.iter().map(ToString::to_string).collect()
    }

    /// Least height of the lowest point of all bodies and rotors above the ground, m.
    #[getter]
    fn lowest(&self) -> f64 {
        self.judgement.lowest
    }

    /// What the estimator made of the sensors, a row per sample; None for a flight on the true state.
    #[getter]
    fn estimates(&self, py: Python<'_>) -> Option<Py<Estimates>> {
        self.estimates.as_ref().map(|own| own.clone_ref(py))
    }

    /// What sensors read but for cameras and lidars, a new float64 array [sample, reading], as `reading_names` says.
    fn readings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let log = &self.flight.log;
        array(py, log.sensor_readings.clone(), &[log.len(), log.sensor_channels.len()])
    }

    /// Names of these readings with units.
    #[getter]
    fn reading_names(&self) -> Vec<String> {
        self.flight.log.sensor_channels.iter().map(|own| format!("{} [{}]", own.name, own.unit)).collect()
    }

    /// Samples.
    fn __len__(&self) -> usize {
        self.flight.log.len()
    }

    /// Writes the columns as CSV; a file that is there is replaced.
    fn write_csv(&self, path: PathBuf) -> PyResult<()> {
        self.flight.log.write_csv(path).or_raise()
    }

    fn __repr__(&self) -> String {
        let log = &self.flight.log;
        format!("Flight('{}', {} samples)", log.vehicle, log.len())
    }
}

/// Flies a vehicle or a configuration along a reference under a controller.
///
/// Parameters
/// ----------
/// plant : Vehicle or str or path
///     A vehicle, its name or file, or a configuration as `configurations()` lists them.
/// controller : str or ControlLaw, optional
///     As "indi", or one of your own; the first that suits the plant by default.
/// gains : dict, optional
///     As `Vehicle.gains`.
/// sensors : str or list of dict or path, optional
///     What reads along: a text as "imu:bmi088,motion_capture:optical", a list of tables, or a TOML file of `[[sensor]]` tables.
/// estimator : str or dict, optional
///     What makes a state of these readings, which the controller is given in place of the truth: "ekf" (a `StateEstimator`),
///     "complementary" (fixed gains) or "kalman" (a steady filter about hover, driven by commands); or a dict of settings, with "kind"
///     beside them, by default those of `StateEstimator`.
/// **plan
///     `duration=15.0` (s), `reference={"kind": "circle", ...}`, `physics={"dt": 0.002}`, `rates`, `wind`, `failures`, `latency` (steps),
///     `detection_delay` (s), `seed`, `tilt`, `filters=[{"kind": "low_pass", "frequency": 80.0}]` (of the measured angular velocity): the
///     fields of a flight plan. `reference` may be a function of the time (s), called once, with a number that records, that returns a
///     position [3] (m), or a tuple of it and a yaw (rad): derivatives up to snap are exact. `wind` may be one that returns a velocity of
///     the air [3], m/s, world.
#[pyfunction]
#[pyo3(signature = (plant, /, *, controller=None, gains=None, sensors=None, estimator=None, **plan))]
pub fn fly(
    py: Python<'_>,
    plant: &Bound<'_, PyAny>,
    controller: Option<&Bound<'_, PyAny>>,
    gains: Option<&Bound<'_, PyMapping>>,
    sensors: Option<&Bound<'_, PyAny>>,
    estimator: Option<&Bound<'_, PyAny>>,
    plan: Option<&Bound<'_, PyDict>>,
) -> PyResult<Flight> {
    let own = Courses::of(plan)?;
    let mut plan: FlightPlan = data("plan", own.plan.as_ref())?;
    own.reference.into_iter().for_each(|reference| plan.reference = reference);
    own.wind.into_iter().for_each(|wind| plan.wind = wind);
    plan.sensors = sensors.map(self::sensors).transpose()?.unwrap_or_default();
    plan.estimator = estimator.map(self::estimator).transpose()?;
    let plant = self::plant(plant, plan.air_physics())?;
    let (choice, gains) = (Choice::of(controller, &plant, gains.is_some())?, gains_of(gains)?);
    let (flight, judgement) = interruptible(py, |said| {
        let setup = Setup { filters: &plan.filters, ..Setup::new(gains.as_ref(), &plan.rates) };
        let mut own = choice.build(&plant, &setup)?;
        let flight = controllers::fly_while(&plant, &mut *own, &plan, &mut |_| said.looks())?;
        let judgement = check_flight(&plant, &flight, true)?;
        Ok((flight, judgement))
    })?;
    let estimates = flight.estimates.as_ref().map(|own| Py::new(py, Estimates::of_flight(py, own)?)).transpose()?;
    Ok(Flight { flight, n_state: omnidrones::autodiff::System::n_state(&plant), judgement, estimates })
}

/// A linear system with named signals: x+ = A x + B u of every sample, or dx/dt where `dt` is None; y = C x + D u.
#[pyclass(module = "omnidrones", frozen)]
pub struct StateSpace(pub linear::StateSpace);

/// Row by row, as NumPy has them.
pub fn matrix<'py>(py: Python<'py>, m: &DMatrix<f64>) -> PyResult<Bound<'py, PyAny>> {
    array(py, m.transpose().as_slice().to_vec(), &[m.nrows(), m.ncols()])
}

/// As many matrices of a shape, the first axis their number.
pub fn matrices<'py>(py: Python<'py>, all: &[DMatrix<f64>], shape: &[usize; 2]) -> PyResult<Bound<'py, PyAny>> {
    let rows = all.iter().flat_map(|m| m.transpose().as_slice().to_vec()).collect();
    array(py, rows, &[all.len(), shape[0], shape[1]])
}

fn names(signals: &[Signal]) -> Vec<String> {
    let told = |s: &Signal| if s.unit.is_empty() { s.name.clone() } else { format!("{} [{}]", s.name, s.unit) };
    signals.iter().map(told).collect()
}

/// A matrix of any size.
fn given(name: &str, own: &Bound<'_, PyAny>) -> PyResult<DMatrix<f64>> {
    let [n, m] = lengths(name, own)?;
    Ok(DMatrix::from_row_slice(n, m, slice(&arrays::read::<f64>(name, own, &[n, m])?)?))
}

/// Signals of names as `names` tells them.
pub fn signals(letter: &str, names: Option<Vec<String>>, n: usize) -> Vec<Signal> {
    let one = |name: &String| match name.strip_suffix(']').and_then(|name| name.rsplit_once(" [")) {
        Some((name, unit)) => Signal::new(name, unit),
        None => Signal::new(name, ""),
    };
    names.map_or_else(|| Signal::numbered(letter, n), |names| names.iter().map(one).collect())
}

#[pymethods]
#[expect(non_snake_case, reason = "as control engineers write them")]
impl StateSpace {
    /// A system of one's own.
    ///
    /// Parameters
    /// ----------
    /// A : array [state, state]
    /// B : array [state, input], optional
    ///     One input that moves nothing by default.
    /// C : array [output, state], optional
    ///     All states by default.
    /// D : array [output, input], optional
    ///     Zeros by default.
    /// dt : float, optional
    ///     Of a sample, s; dx/dt without it.
    /// states, inputs, outputs : list of str, optional
    ///     Names, with units behind them in brackets.
    ///
    /// Arrays are float64.
    #[new]
    #[pyo3(signature = (A, B=None, C=None, D=None, *, dt=None, states=None, inputs=None, outputs=None))]
    #[expect(clippy::too_many_arguments, reason = "by name in Python")]
    fn new(
        A: &Bound<'_, PyAny>,
        B: Option<&Bound<'_, PyAny>>,
        C: Option<&Bound<'_, PyAny>>,
        D: Option<&Bound<'_, PyAny>>,
        dt: Option<f64>,
        states: Option<Vec<String>>,
        inputs: Option<Vec<String>>,
        outputs: Option<Vec<String>>,
    ) -> PyResult<Self> {
        let a = self::given("A", A)?;
        let n = a.nrows();
        if n == 0 {
            return Err(Error::value("size of A", "0 × 0", "1 × 1 or more", "Give a state.")).or_raise();
        }
        let b = B.map_or_else(|| Ok(DMatrix::zeros(n, 1)), |own| self::given("B", own))?;
        let c = C.map_or_else(|| Ok(DMatrix::identity(n, n)), |own| self::given("C", own))?;
        let d = D.map_or_else(|| Ok(DMatrix::zeros(c.nrows(), b.ncols())), |own| self::given("D", own))?;
        let own = linear::StateSpace::new(a, b, c, d, dt).or_raise()?;
        let (m, p) = (own.n_input(), own.n_output());
        let named = own.named(signals("x", states, n), signals("u", inputs, m), signals("y", outputs, p));
        Ok(Self(named.or_raise()?))
    }

    /// float64 [state, state].
    #[getter]
    fn A<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        matrix(py, self.0.a())
    }

    /// float64 [state, input].
    #[getter]
    fn B<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        matrix(py, self.0.b())
    }

    /// float64 [output, state].
    #[getter]
    fn C<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        matrix(py, self.0.c())
    }

    /// float64 [output, input].
    #[getter]
    fn D<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        matrix(py, self.0.d())
    }

    /// Of a sample, s; None for dx/dt.
    #[getter]
    fn dt(&self) -> Option<f64> {
        self.0.dt()
    }

    /// Names with units.
    #[getter]
    fn states(&self) -> Vec<String> {
        names(self.0.states())
    }

    /// Names with units.
    #[getter]
    fn inputs(&self) -> Vec<String> {
        names(self.0.inputs())
    }

    /// Names with units.
    #[getter]
    fn outputs(&self) -> Vec<String> {
        names(self.0.outputs())
    }

    /// The system in dx/dt whose Tustin equivalent this is: the same stability, margins and largest gain.
    fn continuous(&self) -> PyResult<Self> {
        Ok(Self(self.0.continuous().or_raise()?))
    }

    /// Combinations of states that no input moves, by their names; none where inputs reach them all.
    fn unreachable(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        Ok(py.detach(|| linear::unreachable(&self.0)).or_raise()?.names(self.0.states()))
    }

    /// Combinations of states that no output shows, by their names; none where outputs show them all.
    fn unobservable(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        Ok(py.detach(|| linear::unobservable(&self.0)).or_raise()?.names(self.0.states()))
    }

    /// As `control.StateSpace` of python-control, with the names of all signals.
    fn to_control<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let how = PyDict::new(py);
        for (key, own) in [("states", self.states()), ("inputs", self.inputs()), ("outputs", self.outputs())] {
            // a point in a name is taken for that of a system
            how.set_item(key, own.iter().map(|name| name.replace('.', "_")).collect::<Vec<_>>())?;
        }
        let matrices = (self.A(py)?, self.B(py)?, self.C(py)?, self.D(py)?, self.dt().unwrap_or(0.0));
        py.import("control")?.getattr("ss")?.call(matrices, Some(&how))
    }

    /// As `scipy.signal.StateSpace`, without names.
    fn to_scipy<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let how = PyDict::new(py);
        if let Some(dt) = self.dt() {
            how.set_item("dt", dt)?;
        }
        let matrices = (self.A(py)?, self.B(py)?, self.C(py)?, self.D(py)?);
        py.import("scipy.signal")?.getattr("StateSpace")?.call(matrices, Some(&how))
    }

    fn __repr__(&self) -> String {
        let (n, m, p) = (self.0.n_state(), self.0.n_input(), self.0.n_output());
        let dt = self.dt().map_or("continuous".into(), |dt| format!("dt={dt}"));
        format!("StateSpace({n} states, {m} inputs, {p} outputs, {dt})")
    }
}

/// A steady flight and its exact linear model.
#[pyclass(module = "omnidrones", frozen, get_all)]
pub struct Trim {
    /// The plant's state, float64 [state].
    state: Py<PyAny>,
    /// The plant's input, float64 [input].
    input: Py<PyAny>,
    /// The largest rate of change that is left, SI.
    residual: f64,
    /// Places of inputs that stand at a limit.
    limited: Vec<usize>,
    /// About the vertical, rad/s.
    yaw_rate: f64,
    /// One step about it, of the error state: a rotation counts three numbers.
    model: Py<StateSpace>,
}

impl Trim {
    /// With the linear model about it.
    pub fn of(py: Python<'_>, trim: design::Trim, model: linear::StateSpace) -> PyResult<Self> {
        let own = |numbers: Vec<f64>| {
            let n = numbers.len();
            array(py, numbers, &[n]).map(Bound::unbind)
        };
        Ok(Self {
            state: own(trim.state)?,
            input: own(trim.input)?,
            residual: trim.residual,
            limited: trim.limited,
            yaw_rate: trim.yaw_rate,
            model: Py::new(py, StateSpace(model))?,
        })
    }
}

/// A steady flight of a vehicle or a configuration (hover, forward, climbing, turning, leaning) and the exact linear model of one
/// step about it.
///
/// Parameters
/// ----------
/// plant : Vehicle or str or path
/// velocity : three floats
///     Forward, left, up, m/s.
/// yaw_rate : float
///     rad/s.
/// roll, pitch : float, optional
///     To hold, rad; found where they are not given.
/// wind : three floats, optional
///     World, m/s.
/// fail : dict, optional
///     What is left of rotors, by number or name: `{1: 0.0}` lost one, `{"rotor_2": 0.6}` weakened one. A vehicle that must spin to stay
///     up is found in its turn.
/// **physics
///     `dt=0.002` (s), `substeps`, `integrator`, `effects`.
#[pyfunction]
#[pyo3(signature = (
    plant, /, *, velocity=[0.0; 3], yaw_rate=0.0, roll=None, pitch=None, wind=None, fail=None, **physics
))]
#[expect(clippy::too_many_arguments, reason = "by name in Python")]
pub fn linearise(
    py: Python<'_>,
    plant: &Bound<'_, PyAny>,
    velocity: [f64; 3],
    yaw_rate: f64,
    roll: Option<f64>,
    pitch: Option<f64>,
    wind: Option<[f64; 3]>,
    fail: Option<&Bound<'_, PyDict>>,
    physics: Option<&Bound<'_, PyDict>>,
) -> PyResult<Trim> {
    let mut physics: Physics = data("physics", physics)?;
    physics.effects.disturbance |= wind.is_some();
    let air = Disturbance { wind: wind.unwrap_or_default(), ..Disturbance::none() };
    let target = TrimTarget { velocity: velocity.map(Some), yaw_rate, tilt: [roll, pitch], air };
    let (plant, trim) = match fail {
        None => {
            let plant = self::plant(plant, physics)?;
            let found = py.detach(|| design::trim(&plant, &target)).or_raise()?;
            (plant, found)
        }
        Some(fail) => {
            let vehicle = vehicle(plant)?;
            let health = health(&vehicle, fail)?;
            py.detach(|| design::trim_damaged(&vehicle, physics, &health, &target)).or_raise()?
        }
    };
    let model = py
        .detach(|| ErrorState::of_plant(&plant)?.state_space(&plant, &trim.state, &trim.input, trim.yaw_rate))
        .or_raise()?;
    Trim::of(py, trim, model)
}

/// What is left of every rotor.
fn health(vehicle: &dynamics::Vehicle, fail: &Bound<'_, PyDict>) -> PyResult<Vec<f64>> {
    let mut health = vec![1.0; vehicle.rotors.len()];
    for (rotor, share) in fail {
        let place = match rotor.extract::<usize>() {
            Ok(k) => (k < health.len()).then_some(k),
            Err(_) => {
                let name: String = rotor.extract()?;
                vehicle.rotors.iter().position(|own| own.name == name)
            }
        };
        let Some(place) = place else {
            let known = vehicle.rotors.iter().map(|own| own.name.clone()).collect();
            return Err(Error::Unknown { kind: "rotor", name: rotor.to_string(), known }).or_raise();
        };
        health[place] = share.extract()?;
        let lost = RotorFailure { rotor: place, at: 0.0, effectiveness: health[place] };
        lost.validate(health.len()).or_raise()?;
    }
    Ok(health)
}

/// Which rotor thrusts make a wrench.
#[pyclass(module = "omnidrones", frozen, get_all)]
pub struct Allocation {
    /// float64 [rotor], N.
    thrust: Py<PyAny>,
    /// The wrench that they make, float64 [6]: force (N), moment about the centre of mass (N m), body axes.
    delivered: Py<PyAny>,
    /// Largest violation of the optimality conditions, recomputed and scaled.
    residual: f64,
    /// Whether that is small enough to act on; if not, `thrust` is the preferred one within its limits.
    solved: bool,
}

/// Rotor thrusts within their limits that make a wrench as nearly as can be.
///
/// Parameters
/// ----------
/// vehicle : Vehicle or str or path
/// wrench : six floats
///     Force (N) and moment about the centre of mass (N m), body axes.
/// effectiveness : sequence of float, optional
///     What is left of each rotor's largest thrust, 0 (lost) to 1.
/// yaw_last : bool
///     Thrust, roll and pitch first; side forces and yaw with what is left.
#[pyfunction]
#[pyo3(signature = (vehicle, wrench, /, *, effectiveness=None, yaw_last=false))]
pub fn allocate(
    py: Python<'_>,
    vehicle: &Bound<'_, PyAny>,
    wrench: [f64; 6],
    effectiveness: Option<Vec<f64>>,
    yaw_last: bool,
) -> PyResult<Allocation> {
    let vehicle = self::vehicle(vehicle)?;
    let mut problem = Problem::of_vehicle(&vehicle).or_raise()?;
    if let Some(shares) = effectiveness {
        let n = problem.upper.len();
        if shares.len() != n || shares.iter().any(|e| !(0.0..=1.0).contains(e)) {
            let remedy = "0 is a lost rotor, 1 a whole one.";
            return Err(Error::value("effectiveness", format!("{shares:?}"), format!("{n} shares in [0, 1]"), remedy))
                .or_raise();
        }
        problem.upper.iter_mut().zip(shares).for_each(|(most, share)| *most *= share);
    }
    if let Some(x) = wrench.iter().find(|x| !x.is_finite()) {
        return Err(Error::value("wrench", x, "finite", "Give six numbers, N and N m.")).or_raise();
    }
    let solution = if yaw_last {
        PrioritisedAllocator::new(problem.clone(), &[&[2, 3, 4], &[0, 1, 5]]).or_raise()?.solve(&wrench).solution
    } else {
        Allocator::new(problem.clone()).or_raise()?.solve(&wrench).clone()
    };
    let delivered = problem.delivered(&solution.inputs);
    let own = |numbers: &[f64]| array(py, numbers.to_vec(), &[numbers.len()]).map(Bound::unbind);
    Ok(Allocation {
        thrust: own(&solution.inputs)?,
        delivered: own(&delivered)?,
        residual: solution.residual,
        solved: solution.reason.is_none(),
    })
}

/// Tunes the gains of a vehicle's cascade, or of a controller of one's own, by gradients through closed-loop flights, and judges them on
/// starts that tuning did not see: a dict with "gains", "before" and "after" (held-out flights: "rmse", "worst" in m, "crashed").
///
/// Parameters
/// ----------
/// vehicle : Vehicle or str or path
/// controller : ControlLaw, optional
///     Whose gains are tuned, from their own values: all of them must be positive.
/// gains : dict, optional
///     Of the cascade, to begin from; the vehicle's own by default.
/// watch : callable, optional
///     Called with (iteration, error in m) of every step.
/// **plan
///     `iterations=60`, `duration=6.0` (s), `reference`, `n_start`, `n_held_out`, `latency` (steps) and more.
#[pyfunction]
#[pyo3(signature = (vehicle, /, *, controller=None, gains=None, watch=None, **plan))]
pub fn tune<'py>(
    py: Python<'py>,
    vehicle: &Bound<'py, PyAny>,
    controller: Option<&Bound<'py, PyAny>>,
    gains: Option<&Bound<'py, PyMapping>>,
    watch: Option<Py<PyAny>>,
    plan: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyDict>> {
    let own = Courses::of(plan)?;
    let (vehicle, mut plan) = (self::vehicle(vehicle)?, data::<TunePlan>("plan", own.plan.as_ref())?);
    own.reference.into_iter().for_each(|reference| plan.reference = reference);
    let choice = Choice::of(controller, &Plant::of_vehicle(&vehicle, plan.physics).or_raise()?, gains.is_some())?;
    if let Choice::Named(name) = &choice
        && name != "cascade"
    {
        let remedy = "Leave it out for the cascade, or give a ControlLaw.";
        return Err(Error::value("controller", name, "the cascade, or one of your own", remedy)).or_raise();
    }
    let gains = gains_of(gains)?.unwrap_or_else(|| vehicle.gains());
    let (tuned, [before, after]) = interruptible(py, |said| {
        let mut heard = |iteration: usize, rmse: f64| {
            let call = |py: Python<'_>, watch: &Py<PyAny>| watch.call1(py, (iteration, rmse)).map(drop);
            let heard = said.hear(|py| watch.as_ref().map_or(Ok(()), |watch| call(py, watch)));
            if heard.is_some() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        Ok(match choice.written() {
            Some(law) => {
                let tuning = design::tune_law(&vehicle, law, &plan, &mut |step| heard(step.iteration, step.rmse))?;
                (Err(tuning.gains), tuning.flights)
            }
            None => {
                let tuning = design::tune(&vehicle, &gains, &plan, &mut |step| heard(step.iteration, step.rmse))?;
                (Ok(tuning.gains), [tuning.before, tuning.after])
            }
        })
    })?;
    let dict = PyDict::new(py);
    match (tuned, controller) {
        (Err(own), Some(law)) => {
            let own: Vec<f64> = own.into_iter().map(|(_, gain)| gain).collect();
            dict.set_item("gains", gains_as_given(law, &own)?)?;
        }
        (tuned, _) => {
            let own = Value::try_from(tuned.unwrap_or(gains)).map_err(unexpected)?;
            dict.set_item("gains", settings::python(py, &own)?)?;
        }
    }
    for (key, own) in [("before", Value::try_from(before)), ("after", Value::try_from(after))] {
        dict.set_item(key, settings::python(py, &own.map_err(unexpected)?)?)?;
    }
    Ok(dict)
}

/// Names of the built-in vehicles.
#[pyfunction]
#[pyo3(name = "vehicles")]
pub fn vehicle_names() -> Vec<&'static str> {
    vehicles::names()
}

/// Names of the built-in systems of bodies.
#[pyfunction]
#[pyo3(name = "configurations")]
pub fn configuration_names() -> Vec<&'static str> {
    configurations::names()
}
