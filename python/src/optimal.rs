//! Optimal control from Python: trajectories of least cost, model predictive control, programs of linked stages.

use crate::arrays::{array, lengths, read, read_or_none, slice, slice_or_none};
use crate::control::{matrices, plant};
use crate::error::{OrRaise, interruptible, unexpected};
use crate::settings;
use nalgebra::{DMatrix, DVector};
use omnidrones::autodiff::{Recording, Scalar, System};
use omnidrones::controllers::design::ErrorState;
use omnidrones::controllers::optimal::{
    self as library, CourseProblem, FirstGuess, Ilqr, IlqrReport, IlqrSettings, IlqrStatus, MpcSettings, OptimalCost,
    OptimalProblem, ProblemFile, QpSettings, QpSolver, QpStatus, StageInput, StageModel, StageQp, Terms,
};
use omnidrones::controllers::reference::{Reference, Setpoint, Trajectory};
use omnidrones::controllers::registry::Setup;
use omnidrones::controllers::{Controller, Measurement, Rates, Target, default_controller};
use omnidrones::dynamics::{Physics, Plant};
use omnidrones::error::{Error, finite};
use omnidrones::layers::{self, Layer};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyString};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use toml::{Table, Value};

/// Names with units, as columns have them.
fn named(names: Vec<(String, &'static str)>) -> Vec<String> {
    names.into_iter().map(|(name, unit)| format!("{name} [{unit}]")).collect()
}

/// A trajectory of least cost, and the search that found it.
#[pyclass(module = "omnidrones", frozen, get_all)]
pub struct OptimalTrajectory {
    /// float64 [N + 1, state], as `state_names` says: speeds of rotors are shares of their largest.
    states: Py<PyAny>,
    /// float64 [N, input], as `input_names` says.
    inputs: Py<PyAny>,
    /// K, float64 [N, input, error]: inputs + K @ error is the optimal answer to small errors of the state, 0 for inputs at a bound.
    gains: Py<PyAny>,
    /// Of the states, s, float64 [N + 1].
    times: Py<PyAny>,
    /// Names of the columns of `states`, with units.
    state_names: Vec<String>,
    /// Names of the columns of `inputs`, with units.
    input_names: Vec<String>,
    /// What `gains` multiply, with units: a rotation vector (body axes) stands where the state has its quaternion.
    error_names: Vec<String>,
    /// Of the trajectory.
    cost: f64,
    /// Sum of |x+ - f(x, u)| over all stages: 0 for a flight.
    gap: f64,
    /// Largest violation of a gate or an obstacle, m.
    violation: f64,
    /// "solved", "out_of_iterations", "no_step" (none lowers the cost any more) or "violated" (a gate or an obstacle is).
    status: &'static str,
    /// What every iteration came to, float64 arrays [iteration]: "cost" (with squares of violations), "gap", "step" (share of it that was
    /// taken, 0 for none), "violation".
    iterations: Py<PyDict>,
}

#[pymethods]
impl OptimalTrajectory {
    /// Whether it is within the tolerances of its problem.
    #[getter]
    fn solved(&self) -> bool {
        self.status == "solved"
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let n = self.inputs.bind(py).len()?;
        Ok(format!("OptimalTrajectory({n} stages, cost {:.6}, {})", self.cost, self.status))
    }
}

/// The problem of an argument.
fn course(py: Python<'_>, given: &Bound<'_, PyAny>) -> PyResult<CourseProblem> {
    if let Ok(fields) = given.cast::<PyMapping>() {
        let layer = Layer::of_table("problem", settings::table("", fields)?);
        let file: ProblemFile = layers::read(Table::new(), &[layer]).or_raise()?;
        return py.detach(|| file.problem(None)).or_raise();
    }
    if let Ok(text) = given.cast::<PyString>() {
        let text: String = text.extract()?;
        if text.contains(['\n', '=']) {
            let file = ProblemFile::from_toml_str(&text, "problem").or_raise()?;
            return py.detach(|| file.problem(None)).or_raise();
        }
        if !(text.contains(['/', '\\']) || Path::new(&text).extension().is_some()) {
            return py.detach(|| ProblemFile::by_name(&text)).or_raise();
        }
    }
    let path: PathBuf = given.extract().map_err(|_| {
        PyTypeError::new_err(
            "problem must be a name, a dict, the path of a TOML file, or TOML itself (a text with '='). Convert it first.",
        )
    })?;
    py.detach(|| ProblemFile::open(path)).or_raise()
}

/// The trajectory of least cost of a problem: a vehicle or a configuration, a start and a goal, gates and obstacles on the way.
///
/// Parameters
/// ----------
/// problem : str or path or dict
///     A built-in name ("flip", "slalom", "landing", "race"), the path of a TOML file, or what stands in one: TOML (a text with `=`) or a
///     dict.
/// guess : OptimalTrajectory or (states, inputs) or inputs, optional
///     Where the search begins, float64 arrays [N + 1, state] and [N, input]; states need not follow from the inputs. Inputs alone are
///     flown from the start. By default as the problem says.
/// iterations : int, optional
///     Most of them; by default as the problem says.
/// progress : callable, optional
///     Called with (iteration, cost, gap, violation) of every iteration. An exception ends the search and is raised.
///
/// A search that ends before the tolerances are met raises nothing: look at `solved` or `status`.
#[pyfunction]
#[pyo3(signature = (problem, /, *, guess=None, iterations=None, progress=None))]
pub fn optimise<'py>(
    py: Python<'py>,
    problem: &Bound<'py, PyAny>,
    guess: Option<&Bound<'py, PyAny>>,
    iterations: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<OptimalTrajectory> {
    let mut course = course(py, problem)?;
    if let Some(most) = iterations {
        course.settings.max_iterations = most;
    }
    let (n_stage, plant) = (course.problem.n_stage(), &course.plant);
    let (state_names, input_names) = (named(plant.state_names()), named(plant.input_names()));
    let error_names = named(plant.error_names().or_raise()?);
    let (n, m) = (state_names.len(), input_names.len());
    if let Some(guess) = guess {
        let (states, inputs) = match guess.cast::<OptimalTrajectory>() {
            Ok(own) => (Some(own.get().states.bind(py).clone()), own.get().inputs.bind(py).clone()),
            Err(_) => match guess.extract::<(Bound<'py, PyAny>, Bound<'py, PyAny>)>() {
                Ok((states, inputs)) => (Some(states), inputs),
                Err(_) => (None, guess.clone()),
            },
        };
        let inputs = read::<f64>("inputs of the guess", &inputs, &[n_stage, m])?;
        course.guess.inputs = slice(&inputs)?.to_vec();
        course.first = FirstGuess::Hover;
        if let Some(states) = states {
            let states = read::<f64>("states of the guess", &states, &[n_stage + 1, n])?;
            course.guess.states = slice(&states)?.to_vec();
            course.first = FirstGuess::Line;
        }
    }
    let CourseProblem { problem, guess, first, settings, .. } = &course;
    let begin = |search: &mut Ilqr| match first {
        FirstGuess::Hover => search.start_from_inputs(problem, &guess.inputs),
        FirstGuess::Line => search.start_from(problem, guess),
    };
    let (search, report) = searched(py, problem, settings, begin, progress.as_ref())?;
    told(py, &search, &report, plant.plant().physics().dt, [state_names, input_names, error_names])
}

/// Searches from where `begin` puts it, and tells `progress` of every iteration.
fn searched(
    py: Python<'_>,
    problem: &OptimalProblem,
    settings: &IlqrSettings,
    begin: impl FnOnce(&mut Ilqr) -> Result<(), Error> + Send,
    progress: Option<&Py<PyAny>>,
) -> PyResult<(Ilqr, IlqrReport)> {
    interruptible(py, |said| {
        let mut search = Ilqr::new(problem)?;
        begin(&mut search)?;
        let report = search.solve_while(problem, settings, |k, now| match progress {
            Some(progress) => {
                said.hear(|py| progress.call1(py, (k, now.cost, now.gap, now.violation)).map(drop)).is_some()
            }
            None => said.looks().is_ok(),
        })?;
        Ok((search, report))
    })
}

/// What was found, with the names of states, inputs and errors.
fn told(
    py: Python<'_>,
    search: &Ilqr,
    report: &IlqrReport,
    dt: f64,
    [state_names, input_names, error_names]: [Vec<String>; 3],
) -> PyResult<OptimalTrajectory> {
    let trajectory = search.trajectory();
    let (n, m, e) = (state_names.len(), input_names.len(), error_names.len());
    let n_stage = trajectory.inputs.len() / m;
    let own = |numbers: Vec<f64>, shape: &[usize]| array(py, numbers, shape).map(Bound::unbind);
    let dict = PyDict::new(py);
    let all = &report.iterations;
    let columns: [(&str, Vec<f64>); 4] = [
        ("cost", all.iter().map(|own| own.cost).collect()),
        ("gap", all.iter().map(|own| own.gap).collect()),
        ("step", all.iter().map(|own| own.step).collect()),
        ("violation", all.iter().map(|own| own.violation).collect()),
    ];
    for (name, column) in columns {
        dict.set_item(name, array(py, column, &[all.len()])?)?;
    }
    Ok(OptimalTrajectory {
        states: own(trajectory.states.clone(), &[n_stage + 1, n])?,
        inputs: own(trajectory.inputs.clone(), &[n_stage, m])?,
        gains: matrices(py, &search.gains(), &[m, e])?.unbind(),
        times: own((0..=n_stage).map(|k| k as f64 * dt).collect(), &[n_stage + 1])?,
        state_names,
        input_names,
        error_names,
        cost: report.cost,
        gap: report.gap,
        violation: report.violation,
        status: match report.status {
            IlqrStatus::Solved => "solved",
            IlqrStatus::OutOfIterations => "out_of_iterations",
            IlqrStatus::NoStep => "no_step",
            IlqrStatus::Violated => "violated",
        },
        iterations: dict.unbind(),
    })
}

/// What functions of Python say of the stages of a trajectory: of state, input, parameters and what is given for a stage.
pub struct WrittenCost {
    /// Numbers of a stage: parameters of the system, then what is given.
    pub n_parameter: usize,
    /// One result.
    pub cost: Recording,
    /// Of the last state, likewise, without an input.
    pub last: Option<Recording>,
    /// At most zero, each.
    pub conditions: Option<Recording>,
}

impl OptimalCost for WrittenCost {
    fn n_parameter(&self) -> usize {
        self.n_parameter
    }
    fn stage<S: Scalar>(&self, now: StageInput<'_, S>, terms: &mut Terms<S>) {
        let numbers = [now.state, now.input, now.parameters].concat();
        results(&self.cost, &numbers).into_iter().for_each(|cost| terms.add(cost));
        let conditions = self.conditions.iter().flat_map(|own| results(own, &numbers));
        conditions.for_each(|condition| terms.at_most_zero(condition));
    }
    fn terminal<S: Scalar>(&self, end: StageInput<'_, S>, terms: &mut Terms<S>) {
        let numbers = [end.state, end.parameters].concat();
        self.last.iter().flat_map(|own| results(own, &numbers)).for_each(|cost| terms.add(cost));
    }
}

fn results<S: Scalar>(recording: &Recording, numbers: &[S]) -> Vec<S> {
    let mut results = vec![S::zero(); recording.n_output()];
    recording.evaluate(numbers, &mut results);
    results
}

/// The numbers of a problem of a system of Python.
pub struct WrittenProblem<'a> {
    pub start: &'a [f64],
    pub stages: usize,
    /// Of stage after stage, the last state's too: parameters of the system, then those of the cost.
    pub parameters: Vec<f64>,
    pub bounds: [Vec<f64>; 2],
    /// Places of quaternions in the state.
    pub quaternions: Vec<usize>,
    /// Inputs to begin with.
    pub guess: Vec<f64>,
    pub iterations: Option<usize>,
    pub progress: Option<Py<PyAny>>,
    pub dt: f64,
    pub names: [Vec<String>; 2],
}

/// The trajectory of least cost of a system of Python.
pub fn optimise_written<F: System>(
    py: Python<'_>,
    system: &F,
    cost: &WrittenCost,
    own: WrittenProblem<'_>,
) -> PyResult<OptimalTrajectory> {
    let errors = ErrorState::new(system.n_state(), &own.quaternions).or_raise()?;
    let problem = py.detach(|| {
        let model = StageModel::new(system, cost, errors)?;
        let n_parameter = model.n_parameter();
        let mut problem = OptimalProblem::new(Arc::new(model), own.stages, own.start)?;
        problem.set_bounds(&own.bounds[0], &own.bounds[1])?;
        for stage in 0..=own.stages {
            problem.set_parameters(stage, &own.parameters[stage * n_parameter..(stage + 1) * n_parameter])?;
        }
        Ok(problem)
    });
    let problem = problem.or_raise()?;
    let mut settings = IlqrSettings::default();
    if let Some(most) = own.iterations {
        settings.max_iterations = most;
    }
    let begin = |search: &mut Ilqr| search.start_from_inputs(&problem, &own.guess);
    let (search, report) = searched(py, &problem, &settings, begin, own.progress.as_ref())?;
    let [states, inputs] = own.names;
    let turning = |at: usize| own.quaternions.iter().any(|first| (*first..first + 4).contains(&at));
    let mut error_names = Vec::new();
    for (at, name) in states.iter().enumerate() {
        if own.quaternions.contains(&at) {
            error_names.extend(["x", "y", "z"].map(|axis| format!("rotation_{axis} [rad]")));
        } else if !turning(at) {
            error_names.push(name.clone());
        }
    }
    told(py, &search, &report, own.dt, [states, inputs, error_names])
}

/// Samples of a reference, evenly spaced from a time on; rest at both ends.
struct Samples {
    first: f64,
    step: f64,
    rows: Vec<[f64; WIDEST]>,
}

/// Numbers of a sample.
const WIDEST: usize = Setpoint::<f64>::DIM;

impl Trajectory for Samples {
    fn sample(&self, t: f64) -> Setpoint<f64> {
        let last = self.rows.len() - 1;
        let place = ((t - self.first) / self.step).clamp(0.0, last as f64);
        let k = (place as usize).min(last.saturating_sub(1));
        let (share, next) = (place - k as f64, (k + 1).min(last));
        let mixed: [f64; WIDEST] =
            std::array::from_fn(|i| self.rows[k][i] + share * (self.rows[next][i] - self.rows[k][i]));
        Setpoint::read(&mixed)
    }
}

/// Model predictive control: in every tick the plan of least cost from the measured state along the reference, of which the first
/// inputs are flown.
///
/// Parameters
/// ----------
/// plant : Vehicle or str or path
///     What it believes to fly: a vehicle, its name or file, or a configuration.
/// dt : float
///     Between two calls of `tick`, s. It plans in as many of them as `rate` allows and holds its commands between.
/// physics : dict, optional
///     Of its model: `integrator`, `effects`.
/// **settings
///     `stages=20`, `stage=0.05` (s of each), `rate=100.0` (plans a second at most, Hz), `iterations=1` (programs a plan), `weights` (a dict:
///     "position", "velocity", "attitude", "angular_velocity", three numbers each, "joint", "joint_rate", "input"), `endless=True` (the plan
///     ends with the cost of an endless flight), `state_bound=[{"state": "velocity_x", "lower": -2.0, "upper": 2.0, "weight": 1e3}]`, `tracked`
///     (name of a body), `estimate=10.0` (rate of the disturbance estimate, 1/s; 0 for none), `latency` (ticks by which commands act late),
///     `substeps`, `exact_lags`.
///
/// Ticks whose program fails fly on with the last plan; after ten of them the default controller of `fly` flies until a plan is found.
#[pyclass(module = "omnidrones")]
pub struct Mpc {
    own: Mutex<library::Mpc>,
    dt: f64,
    /// Names of the plant's state and of its commands.
    names: [Vec<String>; 2],
    falls_back_to: Option<String>,
}

#[pymethods]
impl Mpc {
    #[new]
    #[pyo3(signature = (plant, /, dt, *, physics=None, **settings))]
    fn new(
        py: Python<'_>,
        plant: &Bound<'_, PyAny>,
        dt: f64,
        physics: Option<&Bound<'_, PyDict>>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let mut own =
            physics.map(|own| settings::table("physics", own.cast::<PyMapping>()?)).transpose()?.unwrap_or_default();
        own.insert("dt".into(), Value::Float(dt));
        let physics: Physics = layers::read(Table::new(), &[Layer::of_table("physics", own)]).or_raise()?;
        let plant = self::plant(plant, physics)?;
        let defaults = Table::try_from(MpcSettings::for_plant(&plant)).map_err(unexpected)?;
        let own = settings.map(|own| settings::table("", own.cast::<PyMapping>()?)).transpose()?.unwrap_or_default();
        let settings: MpcSettings = layers::read(defaults, &[Layer::of_table("settings", own)]).or_raise()?;
        let (mpc, falls_back_to) = py
            .detach(|| {
                let mpc = library::Mpc::new(&plant, &settings)?;
                Ok(match fallback(&plant, dt) {
                    Some(other) => {
                        let name = other.name().to_string();
                        (mpc.with_fallback(other), Some(name))
                    }
                    None => (mpc, None),
                })
            })
            .or_raise()?;
        let told =
            |all: Vec<omnidrones::dynamics::Quantity>| named(all.into_iter().map(|q| (q.name, q.unit)).collect());
        let names = [told(plant.state_quantities()), told(plant.input_quantities())];
        Ok(Self { own: Mutex::new(mpc), dt, names, falls_back_to })
    }

    /// The commands of a tick, a new float64 array [command] in [-1, 1], as `command_names` says.
    ///
    /// Parameters
    /// ----------
    /// state : array
    ///     What is measured, float64, as `plant_state_names` says: SI, speeds of rotors in rad/s.
    /// reference : str or dict or array
    ///     A shape by its name or as `fly` takes it; or samples of what is wanted when commands of this tick act and each `stage` later,
    ///     float64 [sample, number]: position, velocity, acceleration, jerk, snap (three numbers each), yaw and its two rates. Numbers
    ///     that are left out at the end of all rows are 0; the last row holds on.
    /// time : float
    ///     Since the start of the reference, s.
    fn tick<'py>(
        &mut self,
        py: Python<'py>,
        state: &Bound<'py, PyAny>,
        reference: &Bound<'py, PyAny>,
        time: f64,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (n, m) = (self.names[0].len(), self.names[1].len());
        let rows = read::<f64>("state", state, &[n])?;
        let state = slice(&rows)?;
        finite("state", state).or_raise()?;
        finite("time", &[time]).or_raise()?;
        let dt = self.dt;
        let mpc = self.library();
        let late = mpc.settings().latency as f64 * dt;
        let reference = self::reference(reference, time + late, mpc.settings().stage)?;
        let mut commands = vec![0.0; m];
        let seen = Measurement { time, state, readings: &[] };
        py.detach(|| mpc.tick(seen, Target::level(&reference), &mut commands));
        array(py, commands, &[m])
    }

    /// The plan that stands, new float64 arrays: states [stages + 1, state] and inputs [stages, input], as `state_names` and `input_names`
    /// say, a `stage` apart.
    fn plan<'py>(&mut self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let own = self.library();
        let (stages, plan) = (own.settings().stages, own.iteration().plan());
        let rows = |numbers: &[f64], n_row: usize| array(py, numbers.to_vec(), &[n_row, numbers.len() / n_row]);
        Ok((rows(&plan.states, stages + 1)?, rows(&plan.inputs, stages)?))
    }

    /// What it has done since it was reset, by name: "ticks" that planned, of them "kept" (flew on with the last plan) and "fallen_back",
    /// "recursions" of all, largest "residual" of a solved program, "times" (of ticks, s, float32 [tick]), the estimated disturbance "force"
    /// (N, world, [3]) and "moment" (N m, body, [3]), and "last": None before the first tick, else "status" ("solved", "stopped",
    /// "not_convex", "not_finite"), "recursions", "residual", "cost", "gap" and "step" of its program.
    fn report<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let own = self.library();
        let (dict, told) = (PyDict::new(py), own.statistics());
        for (name, count) in [
            ("ticks", told.ticks),
            ("kept", told.kept),
            ("fallen_back", told.fallen_back),
            ("recursions", told.recursions),
        ] {
            dict.set_item(name, count)?;
        }
        dict.set_item("residual", told.residual)?;
        dict.set_item("times", array(py, told.times.clone(), &[told.times.len()])?)?;
        let (force, moment) = own.disturbance();
        dict.set_item("force", array(py, force.to_vec(), &[3])?)?;
        dict.set_item("moment", array(py, moment.to_vec(), &[3])?)?;
        let last = own.last().map(|tick| {
            let last = PyDict::new(py);
            last.set_item("status", status(tick.qp.status))?;
            last.set_item("recursions", tick.recursions)?;
            for (name, number) in
                [("residual", tick.qp.residual), ("cost", tick.cost), ("gap", tick.gap), ("step", tick.step)]
            {
                last.set_item(name, number)?;
            }
            Ok::<_, PyErr>(last)
        });
        dict.set_item("last", last.transpose()?)?;
        Ok(dict)
    }

    /// Forgets: the next tick is the first.
    fn reset(&mut self) {
        self.library().reset();
    }

    /// All its settings as a dict.
    #[getter]
    fn settings<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        settings::dict(py, &Table::try_from(self.library().settings()).map_err(unexpected)?)
    }

    /// What flies while no plan is found; None where nothing does, then commands are those of hover.
    #[getter]
    fn fallback(&self) -> Option<String> {
        self.falls_back_to.clone()
    }

    /// The plant's state in hover at the origin, a new float64 array [plant state].
    #[getter]
    fn hover<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let state = self.library().planned().plant().hover_state().or_raise()?;
        let n = state.len();
        array(py, state, &[n])
    }

    /// Names of the numbers of a measured state, with units.
    #[getter]
    fn plant_state_names(&self) -> Vec<String> {
        self.names[0].clone()
    }

    /// Names of the commands, with units.
    #[getter]
    fn command_names(&self) -> Vec<String> {
        self.names[1].clone()
    }

    /// Names of the columns of the plan's states, with units: speeds of rotors are shares of their largest.
    #[getter]
    fn state_names(&mut self) -> Vec<String> {
        named(self.library().planned().state_names())
    }

    /// Names of the columns of the plan's inputs, with units.
    #[getter]
    fn input_names(&mut self) -> Vec<String> {
        named(self.library().planned().input_names())
    }

    fn __repr__(&mut self) -> String {
        let own = self.library();
        format!("Mpc('{}', {})", own.planned().plant().name(), own.description())
    }
}

impl Mpc {
    fn library(&mut self) -> &mut library::Mpc {
        self.own.get_mut().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The default controller, at its own rates or, where they do not divide 1/dt, in every step.
fn fallback(plant: &Plant, dt: f64) -> Option<Box<dyn Controller>> {
    let rates = [Rates::default(), Rates::every_step(dt)];
    rates.iter().find_map(|rates| default_controller(plant, &Setup::new(None, rates)).ok())
}

/// What is to be tracked; samples begin at `first` and are `step` apart.
fn reference(given: &Bound<'_, PyAny>, first: f64, step: f64) -> PyResult<Reference> {
    if let Ok(name) = given.cast::<PyString>() {
        return Reference::by_name(&name.extract::<String>()?).or_raise();
    }
    if let Ok(fields) = given.cast::<PyMapping>() {
        let layer = Layer::of_table("reference", settings::table("", fields)?);
        let own: Reference = layers::read(Table::new(), &[layer]).or_raise()?;
        own.validate().or_raise()?;
        return Ok(own);
    }
    let [n_row, width] = lengths("reference", given)?;
    if n_row == 0 || width == 0 || width % 3 != 0 || width > WIDEST {
        let rule = format!("[≥ 1, 3 to {WIDEST} by threes]");
        let remedy = "Give whole levels: position, velocity, acceleration, jerk, snap, yaw with its rates.";
        return Err(Error::value("reference: shape", format!("[{n_row}, {width}]"), rule, remedy)).or_raise();
    }
    let numbers = read::<f64>("reference", given, &[n_row, width])?;
    finite("reference", slice(&numbers)?).or_raise()?;
    let rows = slice(&numbers)?.chunks_exact(width).map(|own| {
        let mut row = [0.0; WIDEST];
        row[..width].copy_from_slice(own);
        row
    });
    Ok(Reference::own(Samples { first, step, rows: rows.collect() }))
}

fn status(of: QpStatus) -> &'static str {
    match of {
        QpStatus::Solved => "solved",
        QpStatus::Stopped => "stopped",
        QpStatus::NotConvex(_) => "not_convex",
        QpStatus::NotFinite => "not_finite",
    }
}

/// The solution of a program of linked stages.
#[pyclass(module = "omnidrones", frozen, get_all)]
pub struct StageQpSolution {
    /// float64 [N, input].
    inputs: Py<PyAny>,
    /// float64 [N + 1, state], x0 first.
    states: Py<PyAny>,
    /// Slopes of the cost by the states from each on, with everything behind it, float64 [N + 1, state]: multipliers of the dynamics.
    costates: Py<PyAny>,
    /// Slopes of the cost by the inputs with what follows from them, float64 [N, input]: multipliers of their bounds, positive at the lower
    /// one, negative at the upper one, 0 between.
    multipliers: Py<PyAny>,
    /// K, float64 [N, input, state]: inputs + K @ dx is the solution for a state beside its own by dx, as long as the same bounds act.
    gains: Py<PyAny>,
    /// Of the solution.
    cost: f64,
    /// "solved", or "stopped": out of iterations, within the bounds.
    status: &'static str,
    /// Largest violation of the optimality conditions: by how much a projected step would still move an input, as a share of the range
    /// between its bounds.
    residual: f64,
    /// Riccati recursions.
    iterations: usize,
}

#[pymethods]
impl StageQpSolution {
    /// Whether the residual is within the tolerance.
    #[getter]
    fn solved(&self) -> bool {
        self.status == "solved"
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let n = self.inputs.bind(py).len()?;
        Ok(format!("StageQpSolution({n} stages, cost {:.6}, {})", self.cost, self.status))
    }
}

/// Solves a convex quadratic program over N stages that linear dynamics link, with bounds on every input, in time linear in N:
///
/// least sum of x' Q x / 2 + u' S x + u' R u / 2 + q' x + r' u, with x+ = A x + B u + c from x0 on and lower <= u <= upper.
///
/// Parameters
/// ----------
/// A : array [N, state, state]
/// B : array [N, state, input]
/// c : array [N, state], optional
/// Q : array [N + 1, state, state]
///     Symmetric; the last is that of the end.
/// S : array [N, input, state], optional
/// R : array [N, input, input]
///     Symmetric.
/// q : array [N + 1, state], optional
/// r : array [N, input], optional
/// lower, upper : array [N, input], optional
///     -inf and inf where an input has none.
/// x0 : array [state]
/// tolerance : float
///     Largest `residual` of a solution.
/// iterations : int
///     Most recursions.
///
/// All arrays are float64; None stands for zeros, or for no bounds. Raises `ValueError` with the stage where the cost is not convex in the
/// inputs.
#[pyfunction]
#[pyo3(signature = (A, B, c, Q, S, R, q, r, lower, upper, x0, *, tolerance=1e-9, iterations=60))]
#[expect(non_snake_case, reason = "as control engineers write them")]
#[expect(clippy::too_many_arguments, reason = "by name in Python")]
pub fn solve_stage_qp<'py>(
    py: Python<'py>,
    A: &Bound<'py, PyAny>,
    B: &Bound<'py, PyAny>,
    c: Option<&Bound<'py, PyAny>>,
    Q: &Bound<'py, PyAny>,
    S: Option<&Bound<'py, PyAny>>,
    R: &Bound<'py, PyAny>,
    q: Option<&Bound<'py, PyAny>>,
    r: Option<&Bound<'py, PyAny>>,
    lower: Option<&Bound<'py, PyAny>>,
    upper: Option<&Bound<'py, PyAny>>,
    x0: &Bound<'py, PyAny>,
    tolerance: f64,
    iterations: usize,
) -> PyResult<StageQpSolution> {
    let [stages, n, m] = lengths("B", B)?;
    let (A, B) = (read::<f64>("A", A, &[stages, n, n])?, read::<f64>("B", B, &[stages, n, m])?);
    let (Q, R) = (read::<f64>("Q", Q, &[stages + 1, n, n])?, read::<f64>("R", R, &[stages, m, m])?);
    let (c, S) = (read_or_none("c", c, &[stages, n])?, read_or_none("S", S, &[stages, m, n])?);
    let (q, r) = (read_or_none("q", q, &[stages + 1, n])?, read_or_none("r", r, &[stages, m])?);
    let (lower, upper) = (read_or_none("lower", lower, &[stages, m])?, read_or_none("upper", upper, &[stages, m])?);
    let x0 = read::<f64>("x0", x0, &[n])?;
    let (x0, [a, b, hessian, of_inputs]) = (slice(&x0)?, [slice(&A)?, slice(&B)?, slice(&Q)?, slice(&R)?]);
    let [c, s, q, r] = [slice_or_none(&c)?, slice_or_none(&S)?, slice_or_none(&q)?, slice_or_none(&r)?];
    let (lower, upper) = (slice_or_none(&lower)?, slice_or_none(&upper)?);
    let settings = QpSettings { tolerance, max_iterations: iterations, ..QpSettings::default() };
    let (qp, solver, report) = py
        .detach(|| {
            finite("x0", x0)?;
            let mut qp = StageQp::new(n, m, stages)?;
            if tolerance.is_nan() || tolerance <= 0.0 {
                return Err(Error::value("tolerance", tolerance, "> 0", "Leave it out for the default."));
            }
            let matrix = |rows: &[f64], k: usize, (i, j): (usize, usize)| match rows {
                [] => DMatrix::zeros(i, j),
                rows => DMatrix::from_row_slice(i, j, &rows[k * i * j..(k + 1) * i * j]),
            };
            let vector = |rows: &[f64], k: usize, n: usize| match rows {
                [] => DVector::zeros(n),
                rows => DVector::from_column_slice(&rows[k * n..(k + 1) * n]),
            };
            let bound = |rows: &[f64], k: usize, none: f64| match rows {
                [] => vec![none; m],
                rows => rows[k * m..(k + 1) * m].to_vec(),
            };
            for k in 0..stages {
                qp.set_dynamics(k, &matrix(a, k, (n, n)), &matrix(b, k, (n, m)), &vector(c, k, n))?;
                let own = [matrix(hessian, k, (n, n)), matrix(s, k, (m, n)), matrix(of_inputs, k, (m, m))];
                qp.set_cost(k, own.each_ref(), [&vector(q, k, n), &vector(r, k, m)])?;
                qp.set_bounds(k, &bound(lower, k, f64::NEG_INFINITY), &bound(upper, k, f64::INFINITY))?;
            }
            qp.set_terminal(&matrix(hessian, stages, (n, n)), &vector(q, stages, n))?;
            let mut solver = QpSolver::new(&qp);
            let report = solver.solve(&qp, x0, &settings);
            match report.status {
                QpStatus::Solved | QpStatus::Stopped => Ok((qp, solver, report)),
                QpStatus::NotConvex(stage) => {
                    let what = format!("curvature of the cost by the inputs of stage {stage}");
                    Err(Error::value(what, "negative", "positive", "Weigh every input: R positive definite."))
                }
                QpStatus::NotFinite => {
                    let remedy = "Scale the states, or take a shorter horizon: the dynamics grow beyond all numbers.";
                    Err(Error::value("a number of the recursion", "NaN", "finite", remedy))
                }
            }
        })
        .or_raise()?;
    let gains: Vec<_> = (0..stages).map(|k| solver.gain(k)).collect();
    let rows = |of: &dyn Fn(usize) -> Vec<f64>, n_row: usize, width: usize| {
        array(py, (0..n_row).flat_map(of).collect(), &[n_row, width]).map(Bound::unbind)
    };
    Ok(StageQpSolution {
        inputs: rows(&|k| solver.input(k).to_vec(), stages, m)?,
        states: rows(&|k| solver.state(k).to_vec(), stages + 1, n)?,
        costates: rows(&|k| solver.costate(k).to_vec(), stages + 1, n)?,
        multipliers: rows(&|k| solver.multiplier(k).to_vec(), stages, m)?,
        gains: matrices(py, &gains, &[m, n])?.unbind(),
        cost: solver.cost(&qp),
        status: status(report.status),
        residual: report.residual,
        iterations: report.iterations,
    })
}
