//! Estimation from Python: filters of what sensors read, one or many, over recorded flights; Kalman filters of linear models.

use crate::arrays::{array, flags, lengths, read, read_or_none, slice, slice_or_none};
use crate::control::{StateSpace, data, matrix};
use crate::design::{Regulator, complex};
use crate::error::{OrRaise, interruptible};
use crate::settings;
use nalgebra::{DMatrix, DVector};
use omnidrones::controllers::FlightEstimates;
use omnidrones::controllers::estimation::{
    self as library, EstimateTally, EstimatorSettings, InnovationRecord, NavigationState, SensorFilter,
    StateEstimatorSettings,
};
use omnidrones::dynamics::Frame;
use omnidrones::dynamics::sensors::{SensorConfig, SensorFile, SensorSet};
use omnidrones::dynamics::spatial::rotate_back;
use omnidrones::error::{Error, finite};
use omnidrones::internals::{MemoryRequest, read_text};
use omnidrones::layers::{self, Layer};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::path::Path;
use toml::{Table, Value};

/// Largest file of sensors, bytes.
const MOST: u64 = 16 << 20;
/// Numbers of a state of which a body's motion is the first.
const MOTION: usize = 13;

/// The sensors of an argument: a list as the command line has it, tables, a file of them or what stands in one.
pub fn sensors(given: &Bound<'_, PyAny>) -> PyResult<Vec<SensorConfig>> {
    let of_file = |text: &str, name: &str| {
        let file: SensorFile = layers::read(Table::new(), &[Layer::of_text(text, name)?])?;
        Ok(file.sensor)
    };
    let told = match settings::value("sensors", given)? {
        Some(Value::String(text)) if text.contains(['\n', '=']) => of_file(&text, "sensors"),
        Some(Value::String(named)) => match SensorConfig::parse_list(&named) {
            Err(_) if named.contains(['/', '\\']) || named.ends_with(".toml") => {
                read_text(Path::new(&named), MOST).and_then(|text| of_file(&text, &named))
            }
            listed => listed,
        },
        Some(Value::Table(table)) => SensorFile::of(table, "sensors").map(|file| file.sensor),
        Some(own @ Value::Array(_)) => SensorFile::of(layers::at("sensor", own), "sensors").map(|file| file.sensor),
        _ => {
            let kind = given.get_type().name()?;
            return Err(PyTypeError::new_err(format!(
                "sensors is a {kind}, but it must be a text as 'imu:bmi088,gnss', a list of dicts, or the path of a TOML file."
            )));
        }
    };
    told.or_raise()
}

/// The estimator of an argument: the name of a kind, or its settings, with `kind` beside them.
pub fn estimator(given: &Bound<'_, PyAny>) -> PyResult<EstimatorSettings> {
    match settings::value("estimator", given)? {
        Some(Value::String(name)) => EstimatorSettings::by_name(&name).or_raise(),
        Some(Value::Table(table)) => EstimatorSettings::of(table, "estimator").or_raise(),
        _ => {
            let kind = given.get_type().name()?;
            Err(PyTypeError::new_err(format!(
                "estimator is a {kind}, but it must be a name as 'ekf' or a dict of settings. Pass one of them."
            )))
        }
    }
}

/// Numbers of an argument that is any sequence of so many.
fn numbers<const N: usize>(name: &str, given: &Bound<'_, PyAny>) -> PyResult<[f64; N]> {
    let Ok(all) = given.extract::<Vec<f64>>() else {
        let kind = given.get_type().name()?;
        return Err(PyTypeError::new_err(format!("{name} is a {kind}, but it must be {N} floats. Pass a list.")));
    };
    let found: [f64; N] = all.as_slice().try_into().map_err(|_| {
        PyValueError::new_err(format!("{name} has {} numbers, but it must have {N}. Pass {N} floats.", all.len()))
    })?;
    Ok(found)
}

/// Farther and faster than this nothing flies, SI: a filter would begin anew.
const FARTHEST: f64 = 1e9;

/// Where a body is: as the first 13 numbers of a plant's state; `place` names it in errors.
fn motion(place: &str, mut state: [f64; MOTION]) -> Result<Frame<f64>, Error> {
    for (name, at, n) in PARTS {
        let what = || if place.is_empty() { name.to_string() } else { format!("{place}: {name}") };
        if let Some(x) = state[at..at + n].iter().find(|x| x.is_nan() || x.abs() > FARTHEST) {
            let rule = format!("finite and within ±{FARTHEST:e}");
            return Err(Error::value(what(), x, rule, "Correct it at its source."));
        }
        if n == 4 {
            // to the last bit
            let size = state[at..at + n].iter().map(|x| x * x).sum::<f64>().sqrt();
            if (size - 1.0).abs() > 1e-3 {
                let remedy = "Divide it by its length; the order is [w, x, y, z].";
                return Err(Error::value(format!("length of {}", what()), size, "1", remedy));
            }
            state[at..at + n].iter_mut().for_each(|x| *x /= size);
        }
    }
    Ok(Frame::of_vehicle(&state))
}

/// What an argument leaves out is at rest, at the origin, level.
const AT_REST: [f64; MOTION] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];

/// Names of the four parts of a motion, where each begins and how long it is.
const PARTS: [(&str, usize, usize); 4] =
    [("position", 0, 3), ("velocity", 3, 3), ("attitude", 6, 4), ("angular_velocity", 10, 3)];

type Given<'a, 'py> = Option<&'a Bound<'py, PyAny>>;

/// A motion by its parts.
fn known(parts: [Given<'_, '_>; 4]) -> PyResult<Frame<f64>> {
    let mut state = AT_REST;
    for ((name, at, n), given) in PARTS.into_iter().zip(parts) {
        let Some(given) = given else { continue };
        match n {
            3 => state[at..at + 3].copy_from_slice(&numbers::<3>(name, given)?),
            _ => state[at..at + 4].copy_from_slice(&numbers::<4>(name, given)?),
        }
    }
    motion("", state).or_raise()
}

/// A motion by its parts, 13 numbers: the angular velocity along body axes.
fn parts(own: &Frame<f64>) -> [f64; MOTION] {
    let mut all = [0.0; MOTION];
    own.write(&mut all);
    all[10..].copy_from_slice(&rotate_back(own.attitude, own.angular_velocity));
    all
}

/// What a filter's sensors are, apart from it.
struct Aboard {
    configs: Vec<SensorConfig>,
    names: Vec<String>,
    filter: SensorFilter,
}

impl Aboard {
    /// Refuses sensors that nobody could carry, and numbers that are none.
    fn new(configs: Vec<SensorConfig>, dt: f64, gravity: f64) -> Result<Self, Error> {
        finite("gravity", &[gravity])?;
        let mut bodies: Vec<String> = configs.iter().filter_map(|config| config.on.clone()).collect();
        bodies.push("body".into());
        let named = SensorSet::new(&configs, dt, &bodies)?.channels();
        let names = named.into_iter().map(|own| format!("{} [{}]", own.name, own.unit)).collect();
        Ok(Self { filter: SensorFilter::new(&configs, dt)?, configs, names })
    }

    /// Refuses what memory does not hold: `n` filters that keep so many samples of so many numbers.
    fn check(&self, n: usize, (samples, numbers): (u64, usize)) -> Result<(), Error> {
        let each =
            (u128::from(samples) * numbers as u128 + 2 * self.filter.n_flat() as u128) * size_of::<f64>() as u128;
        let (what, value, less) = match n {
            1 => ("latency of the sensors", format!("{samples} samples"), "Give readings that come sooner"),
            n => ("number of estimators", n.to_string(), "Make fewer"),
        };
        let bytes = n as u128 * each;
        let request = MemoryRequest { what, value, bytes, limit: u64::MAX, setting: "it", less };
        request.check(|limit| if n == 1 { String::new() } else { format!("{}", u128::from(limit) / each) })
    }

    /// What it is, in a line.
    fn told(&self) -> String {
        let kinds: Vec<&str> = self.configs.iter().map(|config| config.name.as_str()).collect();
        format!("{}, {} readings, {} errors", kinds.join(" + "), self.names.len(), self.filter.n_error())
    }

    /// Names of what is estimated, with the units of what is no sensor's own.
    fn error_names(&self) -> Vec<String> {
        let of = |what: &str, unit: &str| ["x", "y", "z"].map(|axis| format!("{what}_{axis} [{unit}]"));
        let [places, speeds, turns] =
            [("position", "m"), ("velocity", "m/s"), ("attitude", "rad")].map(|(a, b)| of(a, b));
        [places, speeds, turns].into_iter().flatten().chain(self.filter.bias_names.iter().cloned()).collect()
    }
}

/// Biases by name.
fn biases(state: &NavigationState<f64>) -> impl Iterator<Item = f64> + '_ {
    state.accelerometer_bias.iter().chain(&state.gyroscope_bias).chain(&state.biases).copied()
}

/// √diag P.
fn deviations(state: &NavigationState<f64>) -> impl Iterator<Item = f64> + '_ {
    let n = state.n_error();
    (0..n).map(move |i| state.covariance[i * (n + 1)].max(0.0).sqrt())
}

/// Sensor by sensor.
fn records<'py>(py: Python<'py>, own: &[InnovationRecord]) -> PyResult<Bound<'py, PyList>> {
    let all = PyList::empty(py);
    for record in own {
        let dict = PyDict::new(py);
        dict.set_item("name", &record.name)?;
        for (name, count) in [
            ("n", record.n),
            ("left_out", record.left_out),
            ("lost", record.lost),
            ("believed_again", record.believed_again),
        ] {
            dict.set_item(name, count)?;
        }
        dict.set_item("mean", Some(record.mean()).filter(|mean| mean.is_finite()))?;
        all.append(dict)?;
    }
    Ok(all)
}

/// What a filter made of readings, sample by sample.
#[pyclass(module = "omnidrones", frozen, get_all)]
pub struct Estimates {
    /// m, world, float64 [sample, 3].
    position: Py<PyAny>,
    /// m/s, world, float64 [sample, 3].
    velocity: Py<PyAny>,
    /// Body to world, [w, x, y, z], float64 [sample, 4].
    attitude: Py<PyAny>,
    /// rad/s, body axes, float64 [sample, 3]; None of a flight.
    angular_velocity: Option<Py<PyAny>>,
    /// Standard deviations of position (m), velocity (m/s) and attitude (rad, about the axes of the inertial unit), float64 [sample, 9];
    /// None of an estimator that does not know how good it is.
    deviations: Option<Py<PyAny>>,
    /// Biases of sensors, float64 arrays [sample] by name; None of a flight.
    biases: Option<Py<PyDict>>,
    /// Their standard deviations, likewise.
    bias_deviations: Option<Py<PyDict>>,
    /// By how much the truth differs: position, velocity, attitude as in `deviations`, float64 [sample, 9]; None where `run` was told no
    /// truth, and of a flight.
    errors: Option<Py<PyAny>>,
    /// e' P^-1 e over these nine numbers, float64 [sample]: chi-squared with nine degrees of freedom where the filter is consistent.
    squared_errors: Option<Py<PyAny>>,
    /// Root mean square errors by name: "position" (m), "velocity" (m/s), "attitude" (rad); None without a truth.
    rms: Option<Py<PyDict>>,
    /// Mean of the squared errors (NEES): 9 where the filter is consistent; None without a truth or deviations, as the next one.
    nees: Option<f64>,
    /// Share of samples whose squared error is within the 95 % bounds of chi-squared, 2.70 to 19.02.
    share_within: Option<f64>,
    /// How readings agreed with what was expected, sensor by sensor and quantity by quantity: a dict of "name", "n" (readings that came),
    /// of those "left_out" (beyond the gate) and "lost" (no numbers, or not valid), "believed_again" (after its patience) and "mean" (squared
    /// innovation per number of those taken in: 1 where all is consistent).
    records: Py<PyList>,
    /// Samples of the inertial unit at a limit, or no numbers.
    saturated: u64,
}

#[pymethods]
impl Estimates {
    /// Samples.
    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.position.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let nees = self.nees.map(|nees| format!(", NEES {nees:.3}")).unwrap_or_default();
        Ok(format!("Estimates({} samples{nees})", self.position.bind(py).len()?))
    }
}

/// Root mean square errors by name, where there was a truth.
fn rms(py: Python<'_>, tally: &EstimateTally) -> PyResult<Option<Py<PyDict>>> {
    if tally.n == 0 {
        return Ok(None);
    }
    let dict = PyDict::new(py);
    for (name, rms) in ["position", "velocity", "attitude"].into_iter().zip(tally.rms()) {
        dict.set_item(name, rms)?;
    }
    Ok(Some(dict.unbind()))
}

impl Estimates {
    /// Of a flight on estimates.
    pub fn of_flight(py: Python<'_>, own: &FlightEstimates) -> PyResult<Self> {
        let width = own.width();
        let n_row = own.rows.len() / width;
        let columns = |at: usize, n: usize| {
            let rows = own.rows.chunks_exact(width).flat_map(|row| row[at..at + n].to_vec()).collect::<Vec<_>>();
            array(py, rows, &[n_row, n]).map(Bound::unbind)
        };
        let is_judged = own.tally.n_judged > 0 && own.has_covariance();
        Ok(Self {
            position: columns(0, 3)?,
            velocity: columns(3, 3)?,
            attitude: columns(6, 4)?,
            angular_velocity: None,
            deviations: own.has_covariance().then(|| columns(10, 9)).transpose()?,
            biases: None,
            bias_deviations: None,
            errors: None,
            squared_errors: None,
            rms: rms(py, &own.tally)?,
            nees: is_judged.then(|| own.tally.mean()),
            share_within: is_judged.then(|| own.tally.share_within()),
            records: records(py, &own.records)?.unbind(),
            saturated: own.saturated,
        })
    }
}

/// A Kalman filter of what a vehicle's sensors read: its motion and the biases of the sensors, with how well they are known. Readings may
/// come late; those that disagree are left out.
///
/// Parameters
/// ----------
/// sensors : str or list of dict or path
///     An inertial unit and what aids it: a text as "imu:bmi088,motion_capture:optical", a list of the tables that `fly` and environments
///     take, or a TOML file of `[[sensor]]` tables.
/// dt : float
///     Between two calls of `step`, s.
/// gravity : float
///     m/s^2, along -z.
/// **settings
///     Standard deviations at the beginning, `position=0.1` (m), `velocity=0.1` (m/s), `attitude=0.02` (rad); `gate=30.0`, the largest
///     squared innovation per number that is taken in; `patience=1.0`, how long a sensor is left out before it is believed again, s;
///     `beyond_accelerometer=50.0` (m/s^2) and `beyond_gyroscope=10.0` (rad/s), what a unit at its limit may miss.
#[pyclass(module = "omnidrones")]
pub struct StateEstimator {
    own: library::StateEstimator,
    aboard: Aboard,
}

#[pymethods]
impl StateEstimator {
    #[new]
    #[pyo3(signature = (sensors, /, dt, *, gravity=9.81, **settings))]
    fn new(
        py: Python<'_>,
        sensors: &Bound<'_, PyAny>,
        dt: f64,
        gravity: f64,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let configs = self::sensors(sensors)?;
        let settings: StateEstimatorSettings = data("settings", settings)?;
        py.detach(|| {
            let aboard = Aboard::new(configs, dt, gravity)?;
            let filter = &aboard.filter;
            let late = filter.aids.iter().map(|own| own.schedule.latency).max().unwrap_or(0);
            aboard.check(1, (late / filter.inertial.every + 2, filter.n_flat()))?;
            let own = library::StateEstimator::new(&aboard.configs, &settings, dt, gravity)?;
            Ok(Self { own, aboard })
        })
        .or_raise()
    }

    /// Begins a flight where the body is known to be, to the deviations of the settings; at rest at the origin by default.
    ///
    /// Parameters
    /// ----------
    /// position, velocity : three floats, optional
    ///     m and m/s, world.
    /// attitude : four floats, optional
    ///     Unit quaternion [w, x, y, z], body to world.
    /// angular_velocity : three floats, optional
    ///     rad/s, body axes.
    #[pyo3(signature = (position=None, velocity=None, attitude=None, angular_velocity=None))]
    fn begin(
        &mut self,
        position: Option<&Bound<'_, PyAny>>,
        velocity: Option<&Bound<'_, PyAny>>,
        attitude: Option<&Bound<'_, PyAny>>,
        angular_velocity: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        self.own.begin(&known([position, velocity, attitude, angular_velocity])?);
        Ok(())
    }

    /// Takes in what is new among the readings of a step, float64 [reading], as `reading_names` says. What is held is not taken twice;
    /// numbers that are none count as lost.
    fn step(&mut self, readings: &Bound<'_, PyAny>) -> PyResult<()> {
        let rows = read::<f64>("readings", readings, &[self.aboard.names.len()])?;
        self.own.step(slice(&rows)?);
        Ok(())
    }

    /// Goes on over a recorded flight: as many calls of `step`, with what was estimated behind each.
    ///
    /// Parameters
    /// ----------
    /// readings : array
    ///     float64 [sample, reading], a row every `dt`.
    /// truth : array, optional
    ///     float64 [sample, >= 13], as `Flight.states` gives it: position, velocity, attitude, angular velocity (body axes). With it the
    ///     estimates have `errors`, `rms`, `nees` and `share_within`.
    #[pyo3(signature = (readings, /, *, truth=None))]
    fn run<'py>(
        &mut self,
        py: Python<'py>,
        readings: &Bound<'py, PyAny>,
        truth: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Estimates> {
        let (n_error, width) = (self.aboard.filter.n_error(), self.aboard.names.len());
        let [n_row, _] = lengths("readings", readings)?;
        let rows = read::<f64>("readings", readings, &[n_row, width])?;
        let truths = truth.map(|truth| Ok::<_, PyErr>((lengths::<2>("truth", truth)?, truth))).transpose()?;
        let n_truth = truths.as_ref().map_or(0, |([_, n], _)| *n);
        if truths.is_some() && n_truth < MOTION {
            let remedy = "Give position, velocity, attitude and angular velocity.";
            return Err(Error::value("width of truth", n_truth, format!("{MOTION} or more"), remedy)).or_raise();
        }
        let truth = read_or_none::<f64>("truth", truth, &[n_row, n_truth])?;
        let (rows, truth) = (slice(&rows)?, slice_or_none(&truth)?);
        let own = &mut self.own;
        let told = interruptible(py, |said| {
            // before anything is taken in: a truth that is none leaves the filter as it was
            let frames = truth.chunks_exact(n_truth.max(1)).enumerate();
            let frames = frames.map(|(i, row)| motion(&format!("truth[{i}]"), std::array::from_fn(|k| row[k])));
            let frames = frames.collect::<Result<Vec<_>, _>>()?;
            let mut told = Run::default();
            for (k, row) in rows.chunks_exact(width).enumerate() {
                own.step(row);
                told.take(own, frames.get(k));
                said.looks()?;
            }
            Ok(told)
        })?;
        let columns = |numbers: Vec<f64>, n: usize| array(py, numbers, &[n_row, n]).map(Bound::unbind);
        let part =
            |at: usize, n: usize| columns(told.motions.iter().flat_map(|own| own[at..at + n].to_vec()).collect(), n);
        let n_bias = n_error - 9;
        let by_name = |numbers: &[f64]| {
            let dict = PyDict::new(py);
            for (k, name) in self.aboard.filter.bias_names.iter().enumerate() {
                let column = numbers.iter().skip(k).step_by(n_bias).copied().collect();
                dict.set_item(name, array(py, column, &[n_row])?)?;
            }
            Ok::<_, PyErr>(dict.unbind())
        };
        let (is_told, is_judged) = (n_truth > 0, told.tally.n_judged > 0);
        Ok(Estimates {
            position: part(0, 3)?,
            velocity: part(3, 3)?,
            attitude: part(6, 4)?,
            angular_velocity: Some(part(10, 3)?),
            biases: Some(by_name(&told.biases)?),
            bias_deviations: Some(by_name(&told.bias_deviations)?),
            deviations: Some(columns(told.deviations, 9)?),
            errors: is_told.then(|| columns(told.errors, 9)).transpose()?,
            squared_errors: is_told.then(|| array(py, told.squared, &[n_row]).map(Bound::unbind)).transpose()?,
            rms: rms(py, &told.tally)?,
            nees: is_judged.then(|| told.tally.mean()),
            share_within: is_judged.then(|| told.tally.share_within()),
            records: records(py, self.own.records())?.unbind(),
            saturated: self.own.saturated(),
        })
    }

    /// m, world, a new float64 array [3], as all that follow.
    #[getter]
    fn position<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.part(py, 0)
    }

    /// m/s, world, [3].
    #[getter]
    fn velocity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.part(py, 1)
    }

    /// Body to world, [w, x, y, z].
    #[getter]
    fn attitude<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.part(py, 2)
    }

    /// rad/s, body axes, [3].
    #[getter]
    fn angular_velocity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.part(py, 3)
    }

    /// Biases of the sensors by name, in their units: of the accelerometer m/s^2, of the gyroscope rad/s.
    #[getter]
    fn biases<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (dict, newest) = (PyDict::new(py), self.own.newest());
        for (name, bias) in self.aboard.filter.bias_names.iter().zip(biases(&newest)) {
            dict.set_item(name, bias)?;
        }
        Ok(dict)
    }

    /// P, float64 [error, error], as `error_names` says: attitude errors are about the axes of the inertial unit.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        matrix(py, &self.own.covariance())
    }

    /// Standard deviations, the roots of the diagonal of P, float64 [error].
    #[getter]
    fn deviations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, deviations(&self.own.newest()).collect(), &[self.aboard.filter.n_error()])
    }

    /// Names of the rows of P, with units where they are not the sensor's.
    #[getter]
    fn error_names(&self) -> Vec<String> {
        self.aboard.error_names()
    }

    /// Names of the readings of a step with units, as `Flight.columns` has them.
    #[getter]
    fn reading_names(&self) -> Vec<String> {
        self.aboard.names.clone()
    }

    /// How readings agreed with what was expected since the flight began, sensor by sensor: as `Estimates.records`.
    #[getter]
    fn records<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        records(py, self.own.records())
    }

    /// Samples of the inertial unit at a limit, or no numbers.
    #[getter]
    fn saturated(&self) -> u64 {
        self.own.saturated()
    }

    /// e' P^-1 e of what is estimated (NEES) where the body is in truth there, arguments as of `begin`: chi-squared with nine degrees of
    /// freedom where the estimate is consistent.
    #[pyo3(signature = (position, velocity, attitude, angular_velocity=None))]
    fn squared_error(
        &self,
        position: &Bound<'_, PyAny>,
        velocity: &Bound<'_, PyAny>,
        attitude: &Bound<'_, PyAny>,
        angular_velocity: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<f64> {
        let truth = known([Some(position), Some(velocity), Some(attitude), angular_velocity])?;
        self.own.squared_error(&truth).or_raise()
    }

    fn __repr__(&self) -> String {
        format!("StateEstimator({})", self.aboard.told())
    }
}

impl StateEstimator {
    fn part<'py>(&self, py: Python<'py>, k: usize) -> PyResult<Bound<'py, PyAny>> {
        let (_, at, n) = PARTS[k];
        array(py, parts(&self.own.estimate())[at..at + n].to_vec(), &[n])
    }
}

/// What `run` gathers.
#[derive(Default)]
struct Run {
    motions: Vec<[f64; MOTION]>,
    deviations: Vec<f64>,
    biases: Vec<f64>,
    bias_deviations: Vec<f64>,
    errors: Vec<f64>,
    squared: Vec<f64>,
    tally: EstimateTally,
}

/// 2.5 and 97.5 % of chi-squared with nine degrees of freedom.
const WITHIN: [f64; 2] = [2.7004, 19.0228];

impl Run {
    fn take(&mut self, own: &library::StateEstimator, truth: Option<&Frame<f64>>) {
        self.motions.push(parts(&own.estimate()));
        let newest = own.newest();
        self.deviations.extend(deviations(&newest).take(9));
        self.bias_deviations.extend(deviations(&newest).skip(9));
        self.biases.extend(biases(&newest));
        let Some(truth) = truth else { return };
        let e = own.filter().error(&newest, truth);
        let squared = own.filter().squared_error(&newest, &newest.covariance, truth).unwrap_or(f64::NAN);
        (0..9).for_each(|k| self.tally.squares[k / 3] += e[k] * e[k]);
        self.tally.n += 1;
        self.tally.n_judged += 1;
        self.tally.normalised += squared;
        self.tally.within += u64::from((WITHIN[0]..=WITHIN[1]).contains(&squared));
        self.errors.extend(e);
        self.squared.push(squared);
    }
}

/// Many filters of the same sensors side by side, each of a body of its own, as environments show estimates.
///
/// Where readings come late, a filter stands `late` steps behind the present, where all of a sample is known; what it estimates of the
/// present goes on from there by the inertial unit. Where none do, each is a `StateEstimator`.
///
/// Parameters
/// ----------
/// sensors : str or list of dict or path
///     As `StateEstimator` takes them.
/// n : int
///     How many.
/// dt : float
///     Between two calls of `step`, s.
/// gravity : float
///     m/s^2, along -z.
/// **settings
///     As of `StateEstimator`.
#[pyclass(module = "omnidrones")]
pub struct StateEstimatorBatch {
    own: library::StateEstimatorBatch,
    aboard: Aboard,
}

#[pymethods]
impl StateEstimatorBatch {
    #[new]
    #[pyo3(signature = (sensors, /, n, dt, *, gravity=9.81, **settings))]
    fn new(
        py: Python<'_>,
        sensors: &Bound<'_, PyAny>,
        n: usize,
        dt: f64,
        gravity: f64,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let configs = self::sensors(sensors)?;
        let settings: StateEstimatorSettings = data("settings", settings)?;
        py.detach(|| {
            let aboard = Aboard::new(configs, dt, gravity)?;
            let filter = &aboard.filter;
            let aids = filter.aids.iter().map(|own| &own.schedule);
            let late = aids.chain([&filter.inertial]).map(|own| own.latency).max().unwrap_or(0);
            // lanes are made by eights
            aboard.check(n.div_ceil(LANES).saturating_mul(LANES), (late + 1, aboard.names.len() + LANES))?;
            let own = library::StateEstimatorBatch::new(&aboard.configs, &settings, [dt, gravity], n)?;
            Ok(Self { own, aboard })
        })
        .or_raise()
    }

    /// Begins where the bodies are known to be, to the deviations of the settings; at rest at the origin by default.
    ///
    /// Parameters
    /// ----------
    /// position, velocity : array, optional
    ///     float64 [n, 3], m and m/s, world.
    /// attitude : array, optional
    ///     float64 [n, 4], unit quaternions [w, x, y, z], body to world.
    /// angular_velocity : array, optional
    ///     float64 [n, 3], rad/s, body axes.
    /// mask : array, optional
    ///     bool [n]: those that begin; all by default. Numbers of the others are not looked at.
    #[pyo3(signature = (position=None, velocity=None, attitude=None, angular_velocity=None, *, mask=None))]
    fn begin(
        &mut self,
        position: Option<&Bound<'_, PyAny>>,
        velocity: Option<&Bound<'_, PyAny>>,
        attitude: Option<&Bound<'_, PyAny>>,
        angular_velocity: Option<&Bound<'_, PyAny>>,
        mask: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let mask = self.mask(mask)?;
        let known = self.motions([position, velocity, attitude, angular_velocity], &mask)?;
        known
            .into_iter()
            .enumerate()
            .filter_map(|(i, own)| Some((i, own?)))
            .for_each(|(i, own)| self.own.begin(i, &own));
        Ok(())
    }

    /// Takes in what the sensors of every body read in a step.
    ///
    /// Parameters
    /// ----------
    /// readings : array
    ///     float64 [n, reading], as `reading_names` says.
    /// mask : array, optional
    ///     bool [n]: those that go on; all by default.
    #[pyo3(signature = (readings, mask=None))]
    fn step(&mut self, py: Python<'_>, readings: &Bound<'_, PyAny>, mask: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let width = self.aboard.names.len();
        let rows = read::<f64>("readings", readings, &[self.own.len(), width])?;
        let (rows, mask) = (slice(&rows)?, self.mask(mask)?);
        py.detach(|| {
            let told = rows.chunks_exact(width).enumerate().filter(|(i, _)| mask.as_ref().is_none_or(|mask| mask[*i]));
            told.for_each(|(i, row)| self.own.tell(i, row));
            self.own.advance();
        });
        Ok(())
    }

    /// m, world, at present, a new float64 array [n, 3], as all that follow.
    #[getter]
    fn position<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.part(py, 0)
    }

    /// m/s, world, [n, 3].
    #[getter]
    fn velocity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.part(py, 1)
    }

    /// Body to world, [w, x, y, z], [n, 4].
    #[getter]
    fn attitude<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.part(py, 2)
    }

    /// rad/s, body axes, [n, 3].
    #[getter]
    fn angular_velocity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.part(py, 3)
    }

    /// Biases of the sensors by name, float64 arrays [n], `late` steps ago.
    #[getter]
    fn biases<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (dict, n) = (PyDict::new(py), self.own.len());
        let all: Vec<f64> = (0..n).flat_map(|i| biases(&self.own.state(i)).collect::<Vec<_>>()).collect();
        let names = &self.aboard.filter.bias_names;
        for (k, name) in names.iter().enumerate() {
            dict.set_item(name, array(py, all.iter().skip(k).step_by(names.len()).copied().collect(), &[n])?)?;
        }
        Ok(dict)
    }

    /// P of every filter, float64 [n, error, error], as `error_names` says, `late` steps ago.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let (n, e) = (self.own.len(), self.aboard.filter.n_error());
        array(py, (0..n).flat_map(|i| self.own.state(i).covariance).collect(), &[n, e, e])
    }

    /// Standard deviations, float64 [n, error], `late` steps ago.
    #[getter]
    fn deviations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let n = self.own.len();
        let all = (0..n).flat_map(|i| deviations(&self.own.state(i)).collect::<Vec<_>>()).collect();
        array(py, all, &[n, self.aboard.filter.n_error()])
    }

    /// Names of the rows of P, with units where they are not the sensor's.
    #[getter]
    fn error_names(&self) -> Vec<String> {
        self.aboard.error_names()
    }

    /// Names of the readings of a step with units, as `Flight.columns` has them.
    #[getter]
    fn reading_names(&self) -> Vec<String> {
        self.aboard.names.clone()
    }

    /// Steps that the filters stand behind: the largest latency of the sensors.
    #[getter]
    fn late(&self) -> usize {
        self.own.late()
    }

    /// How readings of all bodies agreed with what was expected, sensor by sensor: as `Estimates.records`.
    #[getter]
    fn records<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        records(py, self.own.records())
    }

    /// Samples of inertial units at a limit, or no numbers.
    #[getter]
    fn saturated(&self) -> u64 {
        self.own.saturated()
    }

    /// e' P^-1 e (NEES) of every filter, float64 [n], where the bodies in truth were there `late` steps ago; arguments as of `begin`.
    #[pyo3(signature = (position, velocity, attitude, angular_velocity=None))]
    fn squared_error<'py>(
        &self,
        py: Python<'py>,
        position: &Bound<'py, PyAny>,
        velocity: &Bound<'py, PyAny>,
        attitude: &Bound<'py, PyAny>,
        angular_velocity: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let truths = self.motions([Some(position), Some(velocity), Some(attitude), angular_velocity], &None)?;
        let filter = &self.aboard.filter;
        let squared = truths.iter().flatten().enumerate();
        let squared = squared.map(|(i, truth)| {
            let state = self.own.state(i);
            filter.squared_error(&state, &state.covariance, truth)
        });
        array(py, squared.collect::<Result<Vec<_>, _>>().or_raise()?, &[self.own.len()])
    }

    /// Filters.
    fn __len__(&self) -> usize {
        self.own.len()
    }

    fn __repr__(&self) -> String {
        format!("StateEstimatorBatch({} of {})", self.own.len(), self.aboard.told())
    }
}

/// Filters that run side by side.
const LANES: usize = 8;

impl StateEstimatorBatch {
    fn mask(&self, given: Option<&Bound<'_, PyAny>>) -> PyResult<Option<Vec<bool>>> {
        given.map(|given| flags("mask", given, self.own.len())).transpose()
    }

    /// Motions of those in the mask.
    fn motions(&self, given: [Given<'_, '_>; 4], mask: &Option<Vec<bool>>) -> PyResult<Vec<Option<Frame<f64>>>> {
        let n = self.own.len();
        let mut all = vec![AT_REST; n];
        for ((name, at, width), given) in PARTS.into_iter().zip(given) {
            let Some(rows) = read_or_none::<f64>(name, given, &[n, width])? else { continue };
            let rows = slice(&rows)?.chunks_exact(width);
            all.iter_mut().zip(rows).for_each(|(own, row)| own[at..at + width].copy_from_slice(row));
        }
        let all = all.into_iter().enumerate();
        let place = |i: usize| format!("body {i}");
        let is_asked = |i: usize| mask.as_ref().is_none_or(|mask| mask[i]);
        let told = all.map(|(i, own)| is_asked(i).then(|| motion(&place(i), own)).transpose());
        told.collect::<Result<_, _>>().or_raise()
    }

    fn part<'py>(&self, py: Python<'py>, k: usize) -> PyResult<Bound<'py, PyAny>> {
        let ((_, at, width), n) = (PARTS[k], self.own.len());
        let all = (0..n).flat_map(|i| parts(&self.own.estimate(i))[at..at + width].to_vec()).collect();
        array(py, all, &[n, width])
    }
}

/// The filter that a Kalman filter of a model that does not change comes to.
#[pyclass(module = "omnidrones", frozen)]
pub struct SteadyKalman {
    own: library::SteadyKalman,
    /// L, float64 [state, output]: of x = xp + L (y - C xp) for a sampled model, of dx/dt = A x + B u + L (y - C x) for dx/dt.
    #[pyo3(get)]
    gain: Py<PyAny>,
    /// P before a measurement is known, float64 [state, state]; for dx/dt the only one.
    #[pyo3(get)]
    covariance: Py<PyAny>,
    /// P once it is, likewise.
    #[pyo3(get)]
    corrected: Py<PyAny>,
    /// Poles of the error, complex128 [state], largest first: of A - A L C, for dx/dt of A - L C.
    #[pyo3(get)]
    poles: Py<PyAny>,
    /// Of the Riccati equation, relative.
    #[pyo3(get)]
    residual: f64,
}

#[pymethods]
impl SteadyKalman {
    fn __repr__(&self) -> String {
        let (n, p) = self.own.gain.shape();
        format!("SteadyKalman({n} states, {p} outputs)")
    }
}

/// A square argument.
fn square(name: &str, given: &Bound<'_, PyAny>, n: usize) -> PyResult<DMatrix<f64>> {
    rows(name, given, [n, n])
}

/// A matrix of finite numbers.
fn rows(name: &str, given: &Bound<'_, PyAny>, [n, m]: [usize; 2]) -> PyResult<DMatrix<f64>> {
    let own = read::<f64>(name, given, &[n, m])?;
    finite(name, slice(&own)?).or_raise()?;
    Ok(DMatrix::from_row_slice(n, m, slice(&own)?))
}

/// A vector of finite numbers.
fn column(name: &str, given: &Bound<'_, PyAny>, n: usize) -> PyResult<DVector<f64>> {
    let own = read::<f64>(name, given, &[n])?;
    finite(name, slice(&own)?).or_raise()?;
    Ok(DVector::from_column_slice(slice(&own)?))
}

/// The steady Kalman filter of a model x+ = A x + B u + w, y = C x + D u + v with white noise: by the Riccati equation of its error.
///
/// Parameters
/// ----------
/// model : StateSpace
///     As `linearise` gives it, or `StateSpace(A, B, C, dt=dt)`: what C shows is measured.
/// W : array [state, state]
///     Covariance of w, float64; for dx/dt a density.
/// V : array [output, output]
///     Covariance of v, float64, positive definite; for dx/dt a density.
///
/// Raises `ValueError` that names the states where something that does not decay is seen by no output, or moved by no noise.
#[pyfunction]
#[pyo3(signature = (model, W, V, /))]
#[expect(non_snake_case, reason = "as control engineers write them")]
pub fn steady_kalman<'py>(
    py: Python<'py>,
    model: &StateSpace,
    W: &Bound<'py, PyAny>,
    V: &Bound<'py, PyAny>,
) -> PyResult<SteadyKalman> {
    let model = &model.0;
    let (w, v) = (square("W", W, model.n_state())?, square("V", V, model.n_output())?);
    let own = py.detach(|| library::steady_kalman(model, &w, &v)).or_raise()?;
    Ok(SteadyKalman {
        gain: matrix(py, &own.gain)?.unbind(),
        covariance: matrix(py, &own.covariance)?.unbind(),
        corrected: matrix(py, &own.corrected)?.unbind(),
        poles: complex(py, own.poles.clone())?.unbind(),
        residual: own.residual,
        own,
    })
}

/// The controller from y to u that feeds back what a steady filter estimates, u = -K x: least quadratic cost under white noise (LQG).
/// Close the loop with positive sign, the minus is inside. Of a sampled model the measurement of a sample counts in its command.
///
/// Parameters
/// ----------
/// model : StateSpace
///     That of the filter.
/// kalman : SteadyKalman
/// gain : Regulator or array [input, state]
///     As `lqr` gives it.
#[pyfunction]
#[pyo3(signature = (model, kalman, gain, /))]
pub fn lqg(model: &StateSpace, kalman: &SteadyKalman, gain: &Bound<'_, PyAny>) -> PyResult<StateSpace> {
    let py = gain.py();
    let (own, kalman) = (&model.0, &kalman.own);
    if kalman.gain.shape() != (own.n_state(), own.n_output()) {
        let (n, p) = kalman.gain.shape();
        let rule = format!("{} states, {} outputs", own.n_state(), own.n_output());
        let remedy = "Give the model that the filter was made for.";
        return Err(Error::value("filter", format!("{n} states, {p} outputs"), rule, remedy)).or_raise();
    }
    let gain = match gain.cast::<Regulator>() {
        Ok(regulator) => regulator.get().gain.bind(py).clone(),
        Err(_) => gain.clone(),
    };
    let k = rows("gain", &gain, [own.n_input(), own.n_state()])?;
    Ok(StateSpace(library::lqg(own, kalman, &k).or_raise()?))
}

/// A Kalman filter of a linear model that may differ from step to step: `predict`, then `correct` with what was measured.
///
/// Parameters
/// ----------
/// state : array [state]
///     Where it begins, float64.
/// covariance : array [state, state]
///     How well that is known, float64, symmetric, positive semi-definite.
#[pyclass(module = "omnidrones")]
pub struct KalmanFilter {
    own: library::KalmanFilter,
}

#[pymethods]
#[expect(non_snake_case, reason = "as control engineers write them")]
impl KalmanFilter {
    #[new]
    fn new(state: &Bound<'_, PyAny>, covariance: &Bound<'_, PyAny>) -> PyResult<Self> {
        let [n] = lengths("state", state)?;
        let (state, covariance) = (column("state", state, n)?, square("covariance", covariance, n)?);
        Ok(Self { own: library::KalmanFilter::new(state, covariance).or_raise()? })
    }

    /// A step further: x+ = A x + B u + w.
    ///
    /// Parameters
    /// ----------
    /// A : array [state, state]
    /// W : array [state, state]
    ///     Covariance of w.
    /// B : array [state, input], optional
    /// u : array [input], optional
    ///
    /// All are float64; B and u are given together.
    #[pyo3(signature = (A, W, *, B=None, u=None))]
    fn predict(
        &mut self,
        A: &Bound<'_, PyAny>,
        W: &Bound<'_, PyAny>,
        B: Option<&Bound<'_, PyAny>>,
        u: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let n = self.own.state.len();
        let (a, w) = (square("A", A, n)?, square("W", W, n)?);
        let (b, u) = pushed(("B", B), u, n)?;
        self.own.predict([&a, &b], &u, &w);
        Ok(())
    }

    /// Takes in a measurement y = C x + D u + v. What it told is returned by name: "value" (y less what was expected, float64 [output]),
    /// its "covariance" S, and "squared", value' S^-1 value: chi-squared with as many degrees of freedom as outputs where the model is
    /// right.
    ///
    /// Parameters
    /// ----------
    /// y : array [output]
    /// C : array [output, state]
    /// V : array [output, output]
    ///     Covariance of v.
    /// D : array [output, input], optional
    /// u : array [input], optional
    ///
    /// All are float64; D and u are given together. A measurement that is refused leaves the filter as it was.
    #[pyo3(signature = (y, C, V, *, D=None, u=None))]
    fn correct<'py>(
        &mut self,
        py: Python<'py>,
        y: &Bound<'py, PyAny>,
        C: &Bound<'py, PyAny>,
        V: &Bound<'py, PyAny>,
        D: Option<&Bound<'py, PyAny>>,
        u: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let [p] = lengths("y", y)?;
        let (y, c, v) = (column("y", y, p)?, rows("C", C, [p, self.own.state.len()])?, square("V", V, p)?);
        let (d, u) = pushed(("D", D), u, p)?;
        let told = self.own.correct([&c, &d], &u, &y, &v).or_raise()?;
        let dict = PyDict::new(py);
        dict.set_item("value", array(py, told.value.as_slice().to_vec(), &[p])?)?;
        dict.set_item("covariance", matrix(py, &told.covariance)?)?;
        dict.set_item("squared", told.squared)?;
        Ok(dict)
    }

    /// What is estimated, a new float64 array [state].
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.own.state.as_slice().to_vec(), &[self.own.state.len()])
    }

    /// P, a new float64 array [state, state].
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        matrix(py, &self.own.covariance)
    }

    /// e' P^-1 e of a true state, float64 [state] (NEES): chi-squared with as many degrees of freedom where the filter is consistent.
    fn squared_error(&self, truth: &Bound<'_, PyAny>) -> PyResult<f64> {
        self.own.squared_error(&column("truth", truth, self.own.state.len())?).or_raise()
    }

    fn __repr__(&self) -> String {
        format!("KalmanFilter({} states)", self.own.state.len())
    }
}

/// What inputs do, and they; nothing where neither is given.
fn pushed((name, given): (&str, Given<'_, '_>), u: Given<'_, '_>, n: usize) -> PyResult<(DMatrix<f64>, DVector<f64>)> {
    match (given, u) {
        (None, None) => Ok((DMatrix::zeros(n, 1), DVector::zeros(1))),
        (Some(given), Some(u)) => {
            let [m] = lengths("u", u)?;
            Ok((rows(name, given, [n, m])?, column("u", u, m)?))
        }
        _ => Err(PyValueError::new_err(format!("one of {name} and u is left out, but they go together. Give both."))),
    }
}
