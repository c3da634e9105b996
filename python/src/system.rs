//! Discrete systems from Python, x+ = f(x, u, theta) in `float64`: a closed loop, an allocation, a function of Python. What cotangents of a trajectory are
//! worth comes from the library's adjoint of a rollout.

use crate::arrays::{Rows, array, lengths, read, slice};
use crate::control::{StateSpace, data, gains_of, matrix, plant, signals, vehicle};
use crate::course;
use crate::error::{OrRaise, Said, interruptible};
use crate::law::Choice;
use crate::number::{number, record, traces};
use crate::optimal::{OptimalTrajectory, WrittenCost, WrittenProblem, optimise_written};
use nalgebra::DMatrix;
use omnidrones::autodiff::trace::SavedLimits;
use omnidrones::autodiff::{
    self, CertificateBounds, Gradient, Linearisation, Objective, Recording, Rollout, Scalar, Trace, certify, linearise,
};
use omnidrones::controllers::allocation::{self, Problem};
use omnidrones::controllers::linear;
use omnidrones::controllers::reference::Reference;
use omnidrones::controllers::registry::Setup;
use omnidrones::controllers::{ClosedLoop, FlightPlan, LawController, RecordedLaw, Target, start_on};
use omnidrones::dynamics::{Disturbance, Physics};
use omnidrones::error::{Error, finite};
use omnidrones::tasks::written::operation;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyMapping, PyTuple};
use std::sync::Arc;

/// Steps of a trajectory whose inputs are made at once.
const MOST_STEPS: usize = 1_000_000;

/// Numbers of a system that Python wrote: its Jacobian is dense.
const MOST_NUMBERS: usize = 10_000;

/// Steps of an integrator within a step.
const MOST_SUBSTEPS: usize = 1_000;

/// Steps of a trajectory between two looks for signals.
const PART: usize = 256;

/// A system whose states have cotangents: those of the first T states stand behind the inputs of their steps, those of the last behind
/// the parameters.
struct Weighed<F>(F);

impl<F: autodiff::System> autodiff::System for Weighed<F> {
    fn n_state(&self) -> usize {
        self.0.n_state()
    }
    fn n_input(&self) -> usize {
        self.0.n_input() + self.0.n_state()
    }
    fn n_parameter(&self) -> usize {
        self.0.n_parameter() + self.0.n_state()
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], next: &mut [S]) {
        self.0.step(state, &input[..self.0.n_input()], &parameters[..self.0.n_parameter()], next);
    }
}

/// The sum of all states by their cotangents: its gradient is what these are worth.
struct Worth {
    n_state: usize,
}

impl Objective for Worth {
    fn stage<S: Scalar>(&self, state: &[S], input: &[S], _: &[S]) -> S {
        dot(state, &input[input.len() - self.n_state..])
    }
    fn terminal<S: Scalar>(&self, state: &[S], parameters: &[S]) -> S {
        dot(state, &parameters[parameters.len() - self.n_state..])
    }
}

fn dot<S: Scalar>(a: &[S], b: &[S]) -> S {
    a.iter().zip(b).fold(S::zero(), |sum, (a, b)| a.mul_add(*b, sum))
}

/// A recorded system, whichever it is.
trait Recorded: Send + Sync {
    fn trajectory(&self, state: &[f64], inputs: &[f64], parameters: &[f64]) -> Vec<f64>;
    /// `None` where `goes_on` said no.
    fn gradient(
        &self,
        state: &[f64],
        inputs: &[f64],
        parameters: &[f64],
        goes_on: &mut dyn FnMut() -> bool,
    ) -> Option<Gradient>;
    fn linearise(&self, state: &[f64], input: &[f64], parameters: &[f64]) -> Linearisation;
    fn certify(&self, state: &[f64], input: &[f64], parameters: &[f64]) -> Result<autodiff::Certificate, Error>;
}

impl<F: autodiff::System + Send> Recorded for Rollout<Weighed<F>, Worth> {
    fn trajectory(&self, state: &[f64], inputs: &[f64], parameters: &[f64]) -> Vec<f64> {
        Self::trajectory(self, state, inputs, parameters)
    }
    fn gradient(
        &self,
        state: &[f64],
        inputs: &[f64],
        parameters: &[f64],
        goes_on: &mut dyn FnMut() -> bool,
    ) -> Option<Gradient> {
        let zeros = |like: &[f64]| vec![0.0; like.len()];
        let mut found = Gradient { state: zeros(state), inputs: zeros(inputs), parameters: zeros(parameters) };
        self.gradient_while(&mut self.scratch(), state, inputs, parameters, &mut found, goes_on)?;
        Some(found)
    }
    fn linearise(&self, state: &[f64], input: &[f64], parameters: &[f64]) -> Linearisation {
        linearise(&self.system().0, state, input, parameters)
    }
    fn certify(&self, state: &[f64], input: &[f64], parameters: &[f64]) -> Result<autodiff::Certificate, Error> {
        certify(&self.system().0, state, input, parameters)
    }
}

/// What a function of Python does: x+, or dx/dt that is integrated.
#[derive(Clone)]
struct Written {
    recording: Arc<Recording>,
    sizes: [usize; 3],
    /// Steps of Runge and Kutta's classical method within one of the system, and their length, s.
    integrated: Option<(usize, f64)>,
}

impl Written {
    /// dx/dt, where that was given.
    fn rate(&self) -> Option<Self> {
        let recording = self.recording.clone();
        self.integrated.map(|_| Self { recording, sizes: self.sizes, integrated: None })
    }

    fn evaluate<S: Scalar>(&self, arguments: &[S]) -> Vec<S> {
        let mut results = vec![S::zero(); self.sizes[0]];
        self.recording.evaluate(arguments, &mut results);
        results
    }
}

impl autodiff::System for Written {
    fn n_state(&self) -> usize {
        self.sizes[0]
    }
    fn n_input(&self) -> usize {
        self.sizes[1]
    }
    fn n_parameter(&self) -> usize {
        self.sizes[2]
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], next: &mut [S]) {
        let mut arguments = [state, input, parameters].concat();
        let Some((n_step, h)) = self.integrated else {
            next.copy_from_slice(&self.evaluate(&arguments));
            return;
        };
        next.copy_from_slice(state);
        for _ in 0..n_step {
            let mut sum = vec![S::zero(); next.len()];
            let mut rate = Vec::new();
            for (stage, (share, weight)) in [(0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)].into_iter().enumerate() {
                for (i, x) in next.iter().enumerate() {
                    arguments[i] = if stage == 0 { *x } else { S::constant(share * h).mul_add(rate[i], *x) };
                }
                rate = self.evaluate(&arguments);
                for (sum, rate) in sum.iter_mut().zip(&rate) {
                    *sum = S::constant(weight).mul_add(*rate, *sum);
                }
            }
            for (x, sum) in next.iter_mut().zip(&sum) {
                *x = S::constant(h / 6.0).mul_add(*sum, *x);
            }
        }
    }
}

/// A discrete system x+ = f(x, u, theta) in float64 that is differentiated through any number of steps: `System.of` makes one of a
/// function, `Loop` and `AllocationFunction` are others.
#[pyclass(module = "omnidrones", frozen, subclass)]
pub struct System {
    recorded: Box<dyn Recorded>,
    sizes: [usize; 3],
    /// Where none are given.
    nominal: Vec<f64>,
    /// Of states, inputs and parameters.
    names: [Vec<String>; 3],
    /// Of a step, s.
    dt: Option<f64>,
    /// Where Python wrote it.
    written: Option<(Written, Option<Parameters>)>,
}

impl System {
    fn new<F: autodiff::System + Send + 'static>(system: F, nominal: Vec<f64>) -> Result<Self, Error> {
        let sizes = [system.n_state(), system.n_input(), system.n_parameter()];
        let recorded = Rollout::new(Weighed(system), Worth { n_state: sizes[0] })?;
        let names = ["x", "u", "p"].into_iter().zip(sizes).map(|(letter, n)| numbered(letter, n)).collect::<Vec<_>>();
        let names = names.try_into().unwrap_or_default();
        Ok(Self { recorded: Box::new(recorded), sizes, nominal, names, dt: None, written: None })
    }

    /// Of what a function of Python did.
    fn written(
        py: Python<'_>,
        written: Written,
        [states, inputs]: [Vec<String>; 2],
        theta: Option<Parameters>,
        dt: Option<f64>,
    ) -> PyResult<Self> {
        let nominal = theta.as_ref().map_or(Vec::new(), |own| own.nominal.clone());
        let mut own = py.detach(|| Self::new(written.clone(), nominal)).or_raise()?;
        own.dt = dt;
        own.names = [states, inputs, theta.as_ref().map_or(Vec::new(), |theta| theta.names.clone())];
        own.written = Some((written, theta));
        Ok(own)
    }

    /// Rows of `width`, each with its own of `extra` numbers behind it.
    fn beside(
        (rows, width): (&[f64], usize),
        (extra, own): (&[f64], usize),
        n_row: usize,
        said: &mut Said,
    ) -> Result<Vec<f64>, Error> {
        let mut all = Vec::with_capacity(rows.len() + extra.len());
        for t in 0..n_row {
            if t.is_multiple_of(PART) {
                said.looks()?;
            }
            all.extend_from_slice(&rows[t * width..(t + 1) * width]);
            all.extend_from_slice(&extra[t * own..(t + 1) * own]);
        }
        Ok(all)
    }
}

/// "x1", "x2".
fn numbered(letter: &str, n: usize) -> Vec<String> {
    (1..=n).map(|k| format!("{letter}{k}")).collect()
}

/// A number of signals, or their names.
#[derive(FromPyObject)]
enum Signals {
    #[pyo3(transparent)]
    Count(usize),
    #[pyo3(transparent)]
    Names(Vec<String>),
}

impl Signals {
    fn names(self, what: &str, letter: &str) -> PyResult<Vec<String>> {
        let names = match self {
            Self::Count(n) => {
                few(what, n)?;
                numbered(letter, n)
            }
            Self::Names(names) => names,
        };
        few(what, names.len())?;
        let mut sorted: Vec<&String> = names.iter().collect();
        sorted.sort();
        if let Some(twice) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(Error::value(what, twice[0], "names that differ", "Rename one.")).or_raise();
        }
        Ok(names)
    }
}

fn few(what: &str, n: usize) -> PyResult<()> {
    if n > MOST_NUMBERS {
        return Err(Error::limit(what, n, MOST_NUMBERS, "Write a smaller system.")).or_raise();
    }
    Ok(())
}

/// Parameters that are given: their names, nominal values, and how a function of Python gets them.
pub struct Parameters {
    pub names: Vec<String>,
    pub nominal: Vec<f64>,
    /// Names and shapes of those of a dict.
    fields: Option<Vec<(String, Vec<usize>)>>,
}

impl Parameters {
    /// `what` they are called in messages.
    pub fn of(what: &str, given: &Bound<'_, PyAny>) -> PyResult<Self> {
        let numpy = given.py().import("numpy")?;
        let numbers = |name: &str, own: &Bound<'_, PyAny>| -> PyResult<(Vec<usize>, Vec<f64>)> {
            let wrong = |_| {
                let kind = own.get_type().name().map_or_else(|_| String::new(), |kind| kind.to_string());
                PyValueError::new_err(format!(
                    "{what}: {name} is a {kind}, but it must be numbers. Give its nominal value."
                ))
            };
            few(
                &format!("numbers of {what}"),
                numpy.call_method1("size", (own,)).and_then(|n| n.extract()).map_err(wrong)?,
            )?;
            let own = numpy.call_method1("asarray", (own, "float64")).map_err(wrong)?;
            Ok((own.getattr("shape")?.extract()?, own.call_method0("ravel")?.extract()?))
        };
        let Ok(dict) = given.cast::<PyMapping>() else {
            let (shape, nominal) = numbers("it", given)?;
            if shape.len() != 1 {
                let wanted = "a dict of names and numbers, or an array of one axis";
                return Err(PyTypeError::new_err(format!("{what} must be {wanted}.")));
            }
            return Ok(Self { names: numbered("p", nominal.len()), nominal, fields: None });
        };
        let (mut names, mut nominal, mut fields) = (Vec::new(), Vec::new(), Vec::new());
        for item in dict.items()?.iter() {
            let (name, own): (Bound<'_, PyAny>, Bound<'_, PyAny>) = item.extract()?;
            let unnamed = |_| PyTypeError::new_err(format!("names of {what} must be str. Rename them."));
            let name: String = name.extract().map_err(unnamed)?;
            let (shape, own) = numbers(&name, &own)?;
            match shape.as_slice() {
                [] => names.push(name.clone()),
                _ => names.extend((0..own.len()).map(|k| format!("{name}[{k}]"))),
            }
            nominal.extend(own);
            fields.push((name, shape));
        }
        Ok(Self { names, nominal, fields: Some(fields) })
    }

    /// As the function gets them.
    pub fn passed<'py>(&self, py: Python<'py>, all: &[Trace]) -> PyResult<Bound<'py, PyAny>> {
        let Some(fields) = &self.fields else { return number(py, all, &[all.len()]) };
        let (dict, mut rest) = (PyDict::new(py), all);
        for (name, shape) in fields {
            let (own, behind) = rest.split_at(shape.iter().product());
            dict.set_item(name, number(py, own, shape)?)?;
            rest = behind;
        }
        Ok(dict.into_any())
    }

    /// As many numbers that the function gave, in the same form.
    pub fn read(&self, what: &str, given: &Bound<'_, PyAny>) -> PyResult<Vec<Trace>> {
        let Some(fields) = &self.fields else { return traces(what, given, Some(&[self.nominal.len()])) };
        let known: Vec<&str> = fields.iter().map(|(name, _)| &name[..]).collect();
        let unlike = || PyTypeError::new_err(format!("{what} must be a dict of {}.", known.join(", ")));
        let dict = given.cast::<PyMapping>().map_err(|_| unlike())?;
        if dict.len()? != fields.len() || !fields.iter().all(|(name, _)| dict.contains(name).unwrap_or(false)) {
            return Err(unlike());
        }
        let mut all = Vec::with_capacity(self.nominal.len());
        for (name, shape) in fields {
            all.extend(traces(&format!("{what}, '{name}',"), &dict.get_item(name)?, Some(shape))?);
        }
        Ok(all)
    }
}

/// A point of a system.
struct Point<'py> {
    state: Rows<'py, f64>,
    input: Rows<'py, f64>,
    parameters: Option<Rows<'py, f64>>,
}

impl<'py> Point<'py> {
    fn of(
        system: &System,
        state: &Bound<'py, PyAny>,
        input: &Bound<'py, PyAny>,
        parameters: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Self> {
        let [n, m, p] = system.sizes;
        Ok(Self {
            state: read("state", state, &[n])?,
            input: read("input", input, &[m])?,
            parameters: parameters.map(|given| read("parameters", given, &[p])).transpose()?,
        })
    }

    fn slices<'a>(&'a self, system: &'a System) -> PyResult<[&'a [f64]; 3]> {
        let theta = self.parameters.as_ref().map_or(Ok(system.nominal.as_slice()), slice)?;
        let own = [slice(&self.state)?, slice(&self.input)?, theta];
        own.iter().try_for_each(|part| finite("the point", part)).or_raise()?;
        Ok(own)
    }
}

/// Names, nominal values, and the shapes of those of a dict.
type SavedParameters = (Vec<String>, Vec<f64>, Option<Vec<(String, Vec<usize>)>>);

/// What `System.__reduce__` took apart.
#[pyfunction]
pub fn _restore_system(
    py: Python<'_>,
    recording: &[u8],
    states: Vec<String>,
    inputs: Vec<String>,
    theta: Option<SavedParameters>,
    integrated: Option<(usize, f64)>,
    dt: Option<f64>,
) -> PyResult<System> {
    let theta = theta.map(|(names, nominal, fields)| Parameters { names, nominal, fields });
    let sizes @ [n, m, p] = [states.len(), inputs.len(), theta.as_ref().map_or(0, |own| own.nominal.len())];
    let recording = Recording::from_bytes(recording, &operation, &SavedLimits::default()).or_raise()?;
    let is_sound = integrated.is_none_or(|(steps, h)| (1..=MOST_SUBSTEPS).contains(&steps) && h.is_finite());
    if recording.n_input() != n + m + p || recording.n_output() != n || n == 0 || !is_sound {
        let told = format!("{} numbers to {}", recording.n_input(), recording.n_output());
        let limit = format!("of {} numbers to {n}", n + m + p);
        return Err(Error::value("a pickled system", told, limit, "Make it anew.")).or_raise();
    }
    System::written(py, Written { recording: Arc::new(recording), sizes, integrated }, [states, inputs], theta, dt)
}

/// How well three derivations of a step's Jacobian agree at a point: the adjoint (reverse), duals (forward) and central differences.
/// `print` shows it.
#[pyclass(module = "omnidrones", frozen)]
pub struct Certificate {
    /// Largest |adjoint - dual|, relative to the column; bound 1e-10.
    #[pyo3(get)]
    adjoint_error: f64,
    /// Largest |dual - central difference|, likewise; bound 1e-7.
    #[pyo3(get)]
    difference_error: f64,
    /// Order of the Taylor remainder, 2 within 0.1 where the Jacobian is right; None where the step is affine.
    #[pyo3(get)]
    taylor_order: Option<f64>,
    /// Largest |program - direct step|, relative to the state; bound 1e-12.
    #[pyo3(get)]
    value_error: f64,
    /// Columns along which two smooth pieces meet at the point: certify beside it.
    #[pyo3(get)]
    kinks: usize,
    /// Entries compared.
    #[pyo3(get)]
    n_entry: usize,
    /// Whether all are within their bounds.
    #[pyo3(get)]
    holds: bool,
    text: String,
}

#[pymethods]
impl Certificate {
    fn __repr__(&self) -> &str {
        &self.text
    }
}

/// The arguments of a trajectory.
struct Arguments<'py> {
    state: Rows<'py, f64>,
    inputs: Rows<'py, f64>,
    parameters: Option<Rows<'py, f64>>,
    n_step: usize,
}

impl<'py> Arguments<'py> {
    fn of(
        system: &System,
        state: &Bound<'py, PyAny>,
        inputs: &Bound<'py, PyAny>,
        parameters: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Self> {
        let ([n, m, p], n_step) = (system.sizes, inputs.len()?);
        Ok(Self {
            state: read("state", state, &[n])?,
            inputs: read("inputs", inputs, &[n_step, m])?,
            parameters: parameters.map(|given| read("parameters", given, &[p])).transpose()?,
            n_step,
        })
    }

    fn parameters<'a>(&'a self, system: &'a System) -> PyResult<&'a [f64]> {
        self.parameters.as_ref().map_or(Ok(&system.nominal), slice)
    }
}

#[pymethods]
impl System {
    /// The system that a function of Python says.
    ///
    /// Parameters
    /// ----------
    /// f : callable
    ///     Called once, with `Number` arrays: f(x, u), or f(x, u, theta) with parameters. Returns x+ or, if `continuous`, dx/dt.
    /// states, inputs : int or list of str
    ///     How many, or their names, with units behind them in brackets. No inputs by default.
    /// parameters : dict or array, optional
    ///     Nominal values. Of a dict of numbers and arrays theta is such a dict, of an array an array.
    /// dt : float, optional
    ///     Of a step, s. Needed if `continuous`; else for linear models alone.
    /// continuous : bool
    ///     Whether f gives dx/dt. A step is then one of Runge and Kutta's classical method, or `substeps` of it, u constant within.
    /// substeps : int
    ///     Of the integrator.
    ///
    /// f may not depend on values while it is recorded: see `Number`. What it raises is raised.
    ///
    /// >>> def pendulum(x, u, theta):
    /// ...     return [x[1], (u[0] - theta["damping"] * x[1]) / theta["mass"] - 9.81 * np.sin(x[0])]
    /// >>> system = omnidrones.System.of(pendulum, states=["angle [rad]", "rate [rad/s]"], inputs=["torque [N m]"],
    /// ...                               parameters={"mass": 1.0, "damping": 0.1}, dt=0.01, continuous=True)
    /// >>> A, B, by_parameters = system.jacobians(np.zeros(2), np.zeros(1))
    #[staticmethod]
    #[pyo3(signature = (f, /, *, states, inputs=None, parameters=None, dt=None, continuous=false, substeps=1))]
    #[expect(clippy::too_many_arguments, reason = "by name in Python")]
    fn of(
        py: Python<'_>,
        f: &Bound<'_, PyAny>,
        states: Signals,
        inputs: Option<Signals>,
        parameters: Option<&Bound<'_, PyAny>>,
        dt: Option<f64>,
        continuous: bool,
        substeps: usize,
    ) -> PyResult<Self> {
        let states = states.names("states", "x")?;
        let inputs = inputs.map_or(Ok(Vec::new()), |own| own.names("inputs", "u"))?;
        let theta = parameters.map(|own| Parameters::of("parameters", own)).transpose()?;
        let nominal = theta.as_ref().map_or(Vec::new(), |own| own.nominal.clone());
        finite("parameters", &nominal).or_raise()?;
        let sizes @ [n, m, p] = [states.len(), inputs.len(), nominal.len()];
        few("states, inputs and parameters", n + m + p)?;
        if n == 0 {
            return Err(Error::value("states", 0, "1 or more", "Give a state.")).or_raise();
        }
        if let Some(dt) = dt.filter(|dt| !(*dt > 0.0 && dt.is_finite())) {
            return Err(Error::value("dt", dt, "positive, s", "Give the length of a step.")).or_raise();
        }
        if !(1..=MOST_SUBSTEPS).contains(&substeps) || (substeps > 1 && !continuous) {
            let wanted = format!("1, or up to {MOST_SUBSTEPS} of a continuous system");
            return Err(Error::value("substeps", substeps, wanted, "Leave it out.")).or_raise();
        }
        let integrated = match (continuous, dt) {
            (false, _) => None,
            (true, Some(dt)) => Some((substeps, dt / substeps as f64)),
            (true, None) => {
                return Err(Error::value("dt", "None", "the length of a step, s", "Give it, as dt=0.01.")).or_raise();
            }
        };
        let recording = Arc::new(record(n + m + p, |all| {
            let (x, rest) = all.split_at(n);
            let (u, own) = rest.split_at(m);
            let (x, u) = (number(py, x, &[n])?, number(py, u, &[m])?);
            let next = match &theta {
                None => f.call1((x, u))?,
                Some(theta) => f.call1((x, u, theta.passed(py, own)?))?,
            };
            let what = if continuous { "dx/dt" } else { "the next state" };
            let name = f.getattr("__qualname__").map_or_else(|_| "f".to_owned(), |name| name.to_string());
            let name = name.rsplit("<locals>.").next().unwrap_or_default();
            traces(&format!("{what} that {name} returns"), &next, Some(&[n]))
        })?);
        Self::written(py, Written { recording, sizes, integrated }, [states, inputs], theta, dt)
    }

    /// Pickles are of what was recorded, without the function; other systems are made anew.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let Some((written, theta)) = &self.written else {
            return Err(PyTypeError::new_err("this system is no System.of: make it anew where it is needed."));
        };
        let bytes = PyBytes::new(py, &written.recording.to_bytes().or_raise()?);
        let theta = theta.as_ref().map(|own| (own.names.clone(), own.nominal.clone(), own.fields.clone()));
        let [states, inputs, _] = self.names.clone();
        let made = (bytes, states, inputs, theta, written.integrated, self.dt).into_pyobject(py)?;
        Ok((py.import("omnidrones._core")?.getattr("_restore_system")?, made))
    }

    /// Names of the states: "x1" and so on where none were given.
    #[getter]
    fn state_names(&self) -> Vec<String> {
        self.names[0].clone()
    }

    /// Names of the inputs: "u1" and so on where none were given.
    #[getter]
    fn input_names(&self) -> Vec<String> {
        self.names[1].clone()
    }

    /// Names of the parameters, in the order of theta: "p1" and so on where none were given.
    #[getter]
    fn parameter_names(&self) -> Vec<String> {
        self.names[2].clone()
    }

    /// Of a step, s; None where it was not said.
    #[getter]
    fn dt(&self) -> Option<f64> {
        self.dt
    }

    /// A = dx+/dx, B = dx+/du and dx+/dtheta of a step at a point, by dual numbers: new float64 arrays [state, state], [state, input]
    /// and [state, parameter].
    #[pyo3(signature = (state, input, parameters=None))]
    fn jacobians<'py>(
        &self,
        py: Python<'py>,
        state: &Bound<'py, PyAny>,
        input: &Bound<'py, PyAny>,
        parameters: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let own = Point::of(self, state, input, parameters)?;
        let [x, u, theta] = own.slices(self)?;
        let found = py.detach(|| self.recorded.linearise(x, u, theta));
        Ok((matrix(py, &found.state)?, matrix(py, &found.input)?, matrix(py, &found.parameters)?))
    }

    /// The linear model about a point, with the names of its signals: small changes of the states, all of which are outputs, under small
    /// changes of the inputs. Of a step of `dt`; of dx/dt if `continuous`, which the system must be.
    #[pyo3(signature = (state, input, parameters=None, *, continuous=false))]
    fn linear_model(
        &self,
        py: Python<'_>,
        state: &Bound<'_, PyAny>,
        input: &Bound<'_, PyAny>,
        parameters: Option<&Bound<'_, PyAny>>,
        continuous: bool,
    ) -> PyResult<StateSpace> {
        let own = Point::of(self, state, input, parameters)?;
        let [x, u, theta] = own.slices(self)?;
        let rate = self.written.as_ref().and_then(|(own, _)| own.rate());
        let (found, dt) = match (continuous, rate, self.dt) {
            (true, Some(rate), _) => (linearise(&rate, x, u, theta), None),
            (true, None, _) => {
                let remedy = "Leave 'continuous' out, or make the system by System.of(f, continuous=True).";
                return Err(Error::value("continuous", true, "false of a system of steps", remedy)).or_raise();
            }
            (false, _, Some(dt)) => (py.detach(|| self.recorded.linearise(x, u, theta)), Some(dt)),
            (false, _, None) => {
                let remedy = "Give dt to System.of.";
                return Err(Error::value("dt", "None", "the length of a step, s", remedy)).or_raise();
            }
        };
        let [n, m, _] = self.sizes;
        if m == 0 {
            let remedy = "Give the system an input, if only one that moves nothing.";
            return Err(Error::value("inputs", 0, "1 or more", remedy)).or_raise();
        }
        let (c, d) = (DMatrix::identity(n, n), DMatrix::zeros(n, m));
        let model = linear::StateSpace::new(found.state, found.input, c, d, dt).or_raise()?;
        let states = signals("x", Some(self.state_names()), n);
        let inputs = signals("u", Some(self.input_names()), m);
        Ok(StateSpace(model.named(states.clone(), inputs, states).or_raise()?))
    }

    /// The trajectory of least cost of a system that `System.of` made, with gains along it, by a search of Newton's kind (iLQR).
    ///
    /// Parameters
    /// ----------
    /// cost : callable
    ///     Of a stage, a single number: cost(x, u), with theta behind them if the system has parameters, and the stage's row of `references`
    ///     if there are any. Called once, with numbers that record. Where it is not convex the search may end early.
    /// last : callable, optional
    ///     Of the last state likewise, without u.
    /// start : array [state]
    ///     Where it begins.
    /// stages : int
    ///     Steps.
    /// conditions : callable, optional
    ///     Called as `cost`: numbers that must not be above 0 in any stage.
    /// references : array [stages + 1, number], optional
    ///     What changes from stage to stage: a target, a weight.
    /// lower, upper : array [input], optional
    ///     Bounds of the inputs; they have none by default.
    /// quaternions : list of int
    ///     Places in the state where unit quaternions begin.
    /// guess : array [stages, input], optional
    ///     Inputs that the search begins with, zeros by default.
    /// parameters : array [parameter], optional
    ///     Nominal ones by default.
    /// iterations : int, optional
    ///     Most of them.
    /// progress : callable, optional
    ///     Called with (iteration, cost, gap, violation) of every iteration. An exception ends the search and is raised.
    ///
    /// All arrays are float64. A search that ends before the tolerances are met raises nothing: look at `solved` or `status`. Times of a
    /// system without `dt` count steps.
    #[pyo3(signature = (cost, last=None, *, start, stages, conditions=None, references=None, lower=None, upper=None, quaternions=Vec::new(), guess=None, parameters=None, iterations=None, progress=None))]
    #[expect(clippy::too_many_arguments, reason = "by name in Python")]
    fn optimise(
        &self,
        py: Python<'_>,
        cost: &Bound<'_, PyAny>,
        last: Option<&Bound<'_, PyAny>>,
        start: &Bound<'_, PyAny>,
        stages: usize,
        conditions: Option<&Bound<'_, PyAny>>,
        references: Option<&Bound<'_, PyAny>>,
        lower: Option<&Bound<'_, PyAny>>,
        upper: Option<&Bound<'_, PyAny>>,
        quaternions: Vec<usize>,
        guess: Option<&Bound<'_, PyAny>>,
        parameters: Option<&Bound<'_, PyAny>>,
        iterations: Option<usize>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<OptimalTrajectory> {
        let Some((system, theta)) = &self.written else {
            let remedy = "Use omnidrones.optimise for vehicles and configurations.";
            return Err(Error::value("the system", self.__repr__(), "made by System.of", remedy)).or_raise();
        };
        let [n, m, p] = self.sizes;
        let size = stages.saturating_mul(n + m + p);
        if size > MOST_NUMBERS * PART {
            let remedy = "Take fewer and longer steps.";
            return Err(Error::limit("numbers of all stages", size, MOST_NUMBERS * PART, remedy)).or_raise();
        }
        let start = read::<f64>("start", start, &[n])?;
        let width = match references {
            Some(given) => lengths::<2>("references", given)?[1],
            None => 0,
        };
        few("numbers of a stage", width)?;
        let given = references.map(|own| read::<f64>("references", own, &[stages + 1, width])).transpose()?;
        let given = given.as_ref().map_or(Ok([].as_slice()), slice)?;
        let nominal = parameters.map(|own| read::<f64>("parameters", own, &[p])).transpose()?;
        let nominal = nominal.as_ref().map_or(Ok(self.nominal.as_slice()), slice)?;
        let numbers = |name: &str, own: Option<&Bound<'_, PyAny>>, shape: &[usize], none: f64| match own {
            None => Ok(vec![none; shape.iter().product()]),
            Some(own) => Ok::<_, PyErr>(slice(&read::<f64>(name, own, shape)?)?.to_vec()),
        };
        let of_stage = |name: &str, f: &Bound<'_, PyAny>, n_input: usize, shape: Option<&[usize]>| {
            record(n + n_input + p + width, |all| {
                let (x, rest) = all.split_at(n);
                let (u, rest) = rest.split_at(n_input);
                let (own, reference) = rest.split_at(p);
                let mut arguments = vec![number(py, x, &[n])?];
                if n_input > 0 {
                    arguments.push(number(py, u, &[m])?);
                }
                if let Some(theta) = theta {
                    arguments.push(theta.passed(py, own)?);
                }
                if references.is_some() {
                    arguments.push(number(py, reference, &[width])?);
                }
                traces(&format!("what '{name}' returns"), &f.call1(PyTuple::new(py, arguments)?)?, shape)
            })
        };
        let cost = WrittenCost {
            n_parameter: p + width,
            cost: of_stage("cost", cost, m, Some(&[]))?,
            last: last.map(|own| of_stage("last", own, 0, Some(&[]))).transpose()?,
            conditions: conditions.map(|own| of_stage("conditions", own, m, None)).transpose()?,
        };
        let own = WrittenProblem {
            start: slice(&start)?,
            stages,
            parameters: (0..=stages)
                .flat_map(|k| [nominal, nominal, &given[k * width..(k + 1) * width]].concat())
                .collect(),
            bounds: [numbers("lower", lower, &[m], f64::NEG_INFINITY)?, numbers("upper", upper, &[m], f64::INFINITY)?],
            quaternions,
            guess: numbers("guess", guess, &[stages, m], 0.0)?,
            iterations,
            progress,
            dt: self.dt.unwrap_or(1.0),
            names: [self.state_names(), self.input_names()],
        };
        optimise_written(py, system, &cost, own)
    }

    /// How well three derivations of a step's Jacobian by state, input and parameters agree at a point.
    #[pyo3(signature = (state, input, parameters=None))]
    fn certificate(
        &self,
        py: Python<'_>,
        state: &Bound<'_, PyAny>,
        input: &Bound<'_, PyAny>,
        parameters: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Certificate> {
        let own = Point::of(self, state, input, parameters)?;
        let [x, u, theta] = own.slices(self)?;
        let found = py.detach(|| self.recorded.certify(x, u, theta)).or_raise()?;
        Ok(Certificate {
            adjoint_error: found.adjoint_error,
            difference_error: found.difference_error,
            taylor_order: found.taylor_order,
            value_error: found.value_error,
            kinks: found.kinks,
            n_entry: found.n_entry,
            holds: found.holds(CertificateBounds::default()),
            text: found.to_string(),
        })
    }

    fn __repr__(&self) -> String {
        let [n, m, p] = self.sizes;
        format!("System({n} states, {m} inputs, {p} parameters)")
    }

    /// Numbers of the state x.
    #[getter]
    fn n_state(&self) -> usize {
        self.sizes[0]
    }

    /// Numbers of the input u.
    #[getter]
    fn n_input(&self) -> usize {
        self.sizes[1]
    }

    /// Numbers of the parameters theta.
    #[getter]
    fn n_parameter(&self) -> usize {
        self.sizes[2]
    }

    /// Nominal theta, a new float64 array [parameter].
    #[getter]
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.nominal.clone(), &[self.sizes[2]])
    }

    /// The states from `state` [state] on under `inputs` [T, input], a new float64 array [T + 1, state]; with nominal parameters
    /// unless others [parameter] are given.
    #[pyo3(signature = (state, inputs, parameters=None))]
    fn trajectory<'py>(
        &self,
        py: Python<'py>,
        state: &Bound<'py, PyAny>,
        inputs: &Bound<'py, PyAny>,
        parameters: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let own = Arguments::of(self, state, inputs, parameters)?;
        let [n, m, _] = self.sizes;
        let (inputs, nothing) = (slice(&own.inputs)?, vec![0.0; PART * n]);
        let theta = [own.parameters(self)?, &vec![0.0; n]].concat();
        let x = slice(&own.state)?;
        let states = interruptible(py, |said| {
            let mut states = x.to_vec();
            for first in (0..own.n_step).step_by(PART) {
                let steps = PART.min(own.n_step - first);
                let part = (&inputs[first * m..(first + steps) * m], m);
                let part = Self::beside(part, (&nothing, n), steps, said)?;
                let from = states.split_off(states.len() - n);
                states.extend(self.recorded.trajectory(&from, &part, &theta));
            }
            Ok(states)
        })?;
        array(py, states, &[own.n_step + 1, n])
    }

    /// Cotangents of `state`, `inputs` and `parameters`, in this order, for `cotangents` [T + 1, state] of their trajectory: one reverse
    /// sweep for all, new float64 arrays.
    #[pyo3(signature = (cotangents, state, inputs, parameters=None))]
    fn pull<'py>(
        &self,
        py: Python<'py>,
        cotangents: &Bound<'py, PyAny>,
        state: &Bound<'py, PyAny>,
        inputs: &Bound<'py, PyAny>,
        parameters: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let own = Arguments::of(self, state, inputs, parameters)?;
        let ([n, m, p], n_step) = (self.sizes, own.n_step);
        let up = read("cotangents", cotangents, &[n_step + 1, n])?;
        let (first, last) = slice(&up)?.split_at(n_step * n);
        let theta = [own.parameters(self)?, last].concat();
        let (x, inputs) = (slice(&own.state)?, slice(&own.inputs)?);
        let down = interruptible(py, |said| {
            let inputs = Self::beside((inputs, m), (first, n), n_step, said)?;
            let (mut stopped, recorded) = (Ok(()), &self.recorded);
            let mut goes_on = || {
                stopped = said.looks();
                stopped.is_ok()
            };
            let found = recorded.gradient(x, &inputs, &theta, &mut goes_on);
            stopped?;
            found.ok_or_else(|| Error::value("the sweep", "given up", "whole", "Report this."))
        })?;
        let by_input = down.inputs.chunks_exact(m + n).flat_map(|row| &row[..m]).copied().collect();
        let by_parameter = down.parameters[..p].to_vec();
        Ok((array(py, down.state, &[n])?, array(py, by_input, &[n_step, m])?, array(py, by_parameter, &[p])?))
    }
}

/// A plant under a controller as one differentiable system: what `fly` flies, without events.
///
/// Parameters
/// ----------
/// plant : Vehicle or str or path
///     A vehicle, its name or file, or a configuration.
/// controller : str or ControlLaw, optional
///     A law over any scalar: "cascade" (default), "indi", "lqi" or "lqr" of a vehicle, "formation" of a configuration of drones, or one
///     of your own.
/// gains : dict, optional
///     As `Vehicle.gains`; of the controller as it is built.
/// rates : dict, optional
///     How often each level computes, Hz: "velocity", "attitude", "rate".
/// latency : int
///     Steps by which commands act late.
/// **physics
///     `dt=0.002` (s), `substeps`, `integrator`, `effects`.
///
/// The state is the plant's, then the controller's memory and its commands under way; parameters are the plant's physical numbers (SI),
/// then the controller's gains: `parameter_names`. The controller goes on believing the nominal physical numbers.
#[pyclass(module = "omnidrones", frozen, extends = System)]
pub struct Loop(ClosedLoop<LawController<RecordedLaw>>);

#[pymethods]
impl Loop {
    #[new]
    #[pyo3(signature = (plant, /, *, controller=None, gains=None, rates=None, latency=0, **physics))]
    fn new(
        py: Python<'_>,
        plant: &Bound<'_, PyAny>,
        controller: Option<&Bound<'_, PyAny>>,
        gains: Option<&Bound<'_, PyMapping>>,
        rates: Option<&Bound<'_, PyDict>>,
        latency: usize,
        physics: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<PyClassInitializer<Self>> {
        let physics: Physics = data("physics", physics)?;
        let (plant, rates) = (self::plant(plant, physics)?, data("rates", rates)?);
        let (choice, gains) = (Choice::of(controller, &plant, gains.is_some())?, gains_of(gains)?);
        let made = || {
            let own = choice.build(&plant, &Setup::new(gains.as_ref(), &rates))?;
            let Some(law) = own.recorded(&plant)? else {
                let remedy = match plant.tree() {
                    None => "Take 'cascade', 'indi', 'lqi' or 'lqr'.",
                    Some(_) => "Of a configuration only 'formation' may be one; 'fly' flies every controller.",
                };
                return Err(Error::value("controller", own.name(), "a law over any scalar", remedy));
            };
            let closed =
                ClosedLoop::new(plant, LawController::of(law))?.with_latency(latency)?.with_physics().with_gains();
            let nominal = closed.parameters();
            Ok((System::new(closed.clone(), nominal)?, closed))
        };
        let (system, closed) = py.detach(made).or_raise()?;
        Ok(PyClassInitializer::from(system).add_subclass(Self(closed)))
    }

    /// Of theta, in its order: "mass", "rotor_0.thrust_coefficient", "gains.position_x".
    #[getter]
    fn parameter_names(&self) -> Vec<String> {
        self.0.parameter_names()
    }

    /// At rest on a reference (that of `fly` by default) at its beginning, the controller before its first tick, a new float64 array
    /// [state]; the plant's state stands in front.
    #[pyo3(signature = (reference=None))]
    fn initial_state<'py>(
        &self,
        py: Python<'py>,
        reference: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let reference = reference_of(reference)?;
        let start = start_on(self.0.plant(), self.0.controller(), &reference).or_raise()?;
        let state = self.0.initial_state(&start);
        let n = state.len();
        array(py, state, &[n])
    }

    /// The inputs of so many steps along a reference, as `fly` takes it, from step `first` on, in still air unless a `wind` blows (m/s,
    /// world), a new float64 array [n_step, input].
    ///
    /// Of `cascade` and `lqi` the first 18 are the reference's position, velocity, acceleration, jerk, snap, yaw and its rates.
    #[pyo3(signature = (n_step, reference=None, *, first=0, wind=[0.0; 3]))]
    fn inputs<'py>(
        &self,
        py: Python<'py>,
        n_step: usize,
        reference: Option<&Bound<'py, PyAny>>,
        first: u32,
        wind: [f64; 3],
    ) -> PyResult<Bound<'py, PyAny>> {
        let reference = reference_of(reference)?;
        let air = Disturbance { wind, ..Disturbance::none() };
        if !wind.iter().all(|x| x.is_finite()) {
            return Err(Error::value("wind", format!("{wind:?}"), "finite, m/s", "Leave it out for still air."))
                .or_raise();
        }
        if wind != [0.0; 3] && !self.0.plant().physics().effects.disturbance {
            let remedy = "Make the loop with effects={'disturbance': True}.";
            return Err(Error::value("wind", format!("{wind:?}"), "0 without that effect", remedy)).or_raise();
        }
        if n_step > MOST_STEPS {
            let remedy = "Cut the flight in parts: 'first' is the step at which a part begins.";
            return Err(Error::limit("n_step", n_step, MOST_STEPS, remedy)).or_raise();
        }
        let m = autodiff::System::n_input(&self.0);
        let mut inputs = vec![0.0; n_step * m];
        for (k, row) in inputs.chunks_exact_mut(m).enumerate() {
            self.0.write_input(u64::from(first) + k as u64, Target::level(&reference), &air, row);
        }
        array(py, inputs, &[n_step, m])
    }

    fn __repr__(&self) -> String {
        let law = omnidrones::controllers::Controller::name(self.0.controller());
        format!("Loop('{}', controller='{law}')", self.0.plant().name())
    }
}

/// What a dict or a function says, or the lemniscate that flights follow by default.
fn reference_of(given: Option<&Bound<'_, PyAny>>) -> PyResult<Reference> {
    let Some(given) = given else { return Ok(FlightPlan::default().reference) };
    let reference = match given.cast::<PyDict>() {
        Err(_) if given.is_callable() => course::reference(given)?,
        own => data("reference", Some(own?))?,
    };
    reference.validate().or_raise()?;
    Ok(reference)
}

/// One allocation as a step: the thrusts that answer the numbers of a problem.
struct Answer {
    function: allocation::AllocationFunction,
    n_rotor: usize,
}

impl autodiff::System for Answer {
    fn n_state(&self) -> usize {
        self.n_rotor
    }
    fn n_input(&self) -> usize {
        self.function.n_number()
    }
    fn step<S: Scalar>(&self, _: &[S], input: &[S], _: &[S], next: &mut [S]) {
        self.function.call_numbers(input, next);
    }
}

/// The allocation of a vehicle as a differentiable system, of which every step answers another problem: inputs are the wrench (6), then
/// `numbers` in their order; the state behind the step is the rotors' thrusts, N. What cannot be certified is NaN.
///
/// Minimised is (B u - w)' W (B u - w) / 2 + rho |u - u_pref|^2 / 2 within lower <= u <= upper: the library's quadratic programme, whose
/// derivative is that of its optimality conditions.
#[pyclass(module = "omnidrones", frozen, extends = System)]
pub struct AllocationFunction(Problem);

#[pymethods]
impl AllocationFunction {
    /// Of a `Vehicle`, its name or file.
    #[new]
    fn new(vehicle: &Bound<'_, PyAny>) -> PyResult<PyClassInitializer<Self>> {
        let problem = Problem::of_vehicle(&self::vehicle(vehicle)?).or_raise()?;
        let function = allocation::AllocationFunction::new(problem.clone()).or_raise()?;
        let system = System::new(Answer { function, n_rotor: problem.n_input() }, Vec::new()).or_raise()?;
        Ok(PyClassInitializer::from(system).add_subclass(Self(problem)))
    }

    /// Nominal numbers behind the wrench, new float64 arrays by name: "weights" [6] (W), "regularisation" [1] (rho), "geometry" [rotor, 6]
    /// (the columns of B), "preference", "lower" and "upper" [rotor] (N).
    #[getter]
    fn numbers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (p, n, dict) = (&self.0, self.0.n_input(), PyDict::new(py));
        dict.set_item("weights", array(py, p.weights.to_vec(), &[6])?)?;
        dict.set_item("regularisation", array(py, vec![p.regularisation], &[1])?)?;
        dict.set_item("geometry", array(py, p.geometry.as_slice().to_vec(), &[n, 6])?)?;
        for (name, own) in [("preference", &p.preference), ("lower", &p.lower), ("upper", &p.upper)] {
            dict.set_item(name, array(py, own.clone(), &[n])?)?;
        }
        Ok(dict)
    }
}
