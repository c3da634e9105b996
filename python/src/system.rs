//! Discrete systems from Python, x+ = f(x, u, theta) in `float64`: a closed loop, an allocation. What cotangents of a trajectory are
//! worth comes from the library's adjoint of a rollout.

use crate::arrays::{Rows, array, read, slice};
use crate::control::{data, gains_of, plant, vehicle};
use crate::error::{OrRaise, Said, interruptible};
use omnidrones::autodiff::{self, Gradient, Objective, Rollout, Scalar};
use omnidrones::controllers::allocation::{self, Problem};
use omnidrones::controllers::law::{LawController, RecordedLaw};
use omnidrones::controllers::reference::Reference;
use omnidrones::controllers::registry::{Setup, controller};
use omnidrones::controllers::{ClosedLoop, FlightPlan, Target, default_controller, start_on};
use omnidrones::dynamics::{Disturbance, Physics};
use omnidrones::error::Error;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};

/// Steps of a trajectory whose inputs are made at once.
const MOST_STEPS: usize = 1_000_000;

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
}

/// A discrete system x+ = f(x, u, theta) in float64 that is differentiated through any number of steps: `Loop`, `AllocationFunction`.
#[pyclass(module = "omnidrones", frozen, subclass)]
pub struct System {
    recorded: Box<dyn Recorded>,
    sizes: [usize; 3],
    /// Where none are given.
    nominal: Vec<f64>,
}

impl System {
    fn of<F: autodiff::System + Send + 'static>(system: F, nominal: Vec<f64>) -> Result<Self, Error> {
        let sizes = [system.n_state(), system.n_input(), system.n_parameter()];
        let recorded = Rollout::new(Weighed(system), Worth { n_state: sizes[0] })?;
        Ok(Self { recorded: Box::new(recorded), sizes, nominal })
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
/// controller : str, optional
///     A law over any scalar: "cascade" (default), "indi", "lqi" or "lqr" of a vehicle, "formation" of a configuration of drones.
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
        controller: Option<&str>,
        gains: Option<&Bound<'_, PyMapping>>,
        rates: Option<&Bound<'_, PyDict>>,
        latency: usize,
        physics: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<PyClassInitializer<Self>> {
        let physics: Physics = data("physics", physics)?;
        let (plant, rates) = (self::plant(plant, physics)?, data("rates", rates)?);
        let gains = gains_of(gains)?;
        let named = controller;
        let made = || {
            let setup = Setup::new(gains.as_ref(), &rates);
            let own = match named {
                Some(name) => self::controller(name, &plant, &setup)?,
                None => default_controller(&plant, &setup)?,
            };
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
            Ok((System::of(closed.clone(), nominal)?, closed))
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
        reference: Option<&Bound<'py, PyDict>>,
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
        reference: Option<&Bound<'py, PyDict>>,
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

/// What a dict says, or the lemniscate that flights follow by default.
fn reference_of(given: Option<&Bound<'_, PyDict>>) -> PyResult<Reference> {
    let Some(given) = given else { return Ok(FlightPlan::default().reference) };
    let reference: Reference = data("reference", Some(given))?;
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
        let system = System::of(Answer { function, n_rotor: problem.n_input() }, Vec::new()).or_raise()?;
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
