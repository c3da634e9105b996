//! Vehicles, controllers, references, tasks and policies as C99, policies as ONNX, from Python.

use crate::batch::VecEnv;
use crate::control::{self, data, gains_of};
use crate::error::OrRaise;
use crate::learn::Policy;
use omnidrones::controllers::FilterSettings;
use omnidrones::controllers::cascade::Rates;
use omnidrones::controllers::reference::Reference;
use omnidrones::controllers::registry::{Setup, controller};
use omnidrones::dynamics::{Physics, configurations, vehicles};
use omnidrones::error::Error;
use omnidrones::export::onnx::onnx;
use omnidrones::export::{
    self as library, ExportOptions, ExportPrecision, compiler, controller_as_c, plant_as_c, policy_as_c,
    reference_as_c, task_as_c,
};
use omnidrones::parallel::Threads;
use omnidrones::rl::{self, Starts, TrainConfig, evaluate::eval_env};
use pyo3::exceptions::{PyFileExistsError, PyFileNotFoundError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyMapping};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A function of a module that callers see.
#[pyclass(module = "omnidrones", frozen, get_all)]
pub struct CFunction {
    /// "hover_policy_step".
    name: String,
    /// As the header declares it.
    prototype: String,
    /// What it computes.
    about: String,
    /// Bytes of stack at most; compilers need less.
    stack: usize,
    /// Of one call; a loop that ends early counts once.
    operations: usize,
    /// Of one call at most.
    operations_at_most: usize,
}

#[pymethods]
impl CFunction {
    fn __repr__(&self) -> String {
        format!("CFunction('{}')", self.prototype)
    }
}

/// Something as C99: a header, a source, a test with golden vectors and a description. `export_c` makes it.
#[pyclass(module = "omnidrones", frozen)]
pub struct CModule(library::CModule);

#[pymethods]
impl CModule {
    /// What its files and functions begin with.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// What it is, in a line.
    #[getter]
    fn title(&self) -> &str {
        &self.0.title
    }

    /// Of its numbers: "float" or "double".
    #[getter]
    fn precision(&self) -> &'static str {
        self.0.precision.c_type()
    }

    /// What callers see, a list of `CFunction`.
    #[getter]
    fn functions(&self) -> Vec<CFunction> {
        let own = self.0.functions.iter().cloned();
        let told = own.map(|function| CFunction {
            name: function.name,
            prototype: function.prototype,
            about: function.about,
            stack: function.stack,
            operations: function.n_instruction,
            operations_at_most: function.n_most,
        });
        told.collect()
    }

    /// Bytes that a caller keeps from call to call; 0 where nothing is.
    #[getter]
    fn memory(&self) -> usize {
        self.0.memory
    }

    /// Bytes of constant tables.
    #[getter]
    fn tables(&self) -> usize {
        self.0.tables
    }

    /// The text of its files by name.
    #[getter]
    fn files<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        self.0.files.iter().try_for_each(|(name, text)| dict.set_item(name, text))?;
        Ok(dict)
    }

    /// Writes its files into a folder, which is made where it is missing, and returns their paths. Raises `ValueError` where a file is
    /// there and is another, unless `force`.
    #[pyo3(signature = (folder, force=false))]
    fn write(&self, py: Python<'_>, folder: PathBuf, force: bool) -> PyResult<Vec<PathBuf>> {
        py.detach(|| self.0.write(folder, force)).or_raise()
    }

    /// Compiles it with the machine's C compiler (`$CC`, or `cc`), all warnings errors, runs its test and returns what that said. Raises
    /// `ValueError` with what compiler or test said where one fails, `FileNotFoundError` where there is no compiler.
    fn check(&self, py: Python<'_>) -> PyResult<String> {
        if !py.detach(compiler::has_compiler) {
            let told = format!("no C compiler here: '{}' does not run. Install one, or set CC.", compiler::compiler());
            return Err(PyFileNotFoundError::new_err(told));
        }
        py.detach(|| compiler::checked(&self.0, &["-O1"])).or_raise()
    }

    fn __repr__(&self) -> String {
        format!("CModule('{}', '{}')", self.0.name, self.0.title)
    }
}

/// How a controller is tuned.
#[derive(Deserialize, Default)]
#[serde(default, deny_unknown_fields)]
struct Tuning {
    rates: Rates,
    filters: Vec<FilterSettings>,
}

/// What is said of a plant and of its controller.
struct OfPlant<'a, 'py> {
    controller: Option<&'a str>,
    gains: Option<&'a Bound<'py, PyMapping>>,
    /// `rates` and `filters`.
    tuning: Bound<'py, PyDict>,
    physics: Option<&'a Bound<'py, PyDict>>,
}

impl OfPlant<'_, '_> {
    /// Names of what was given.
    fn given(&self) -> Vec<String> {
        let own = [("controller", self.controller.is_some()), ("gains", self.gains.is_some())];
        let own = own.into_iter().filter(|(_, is_given)| *is_given).map(|(name, _)| name.to_string());
        let others = [Some(&self.tuning), self.physics].into_iter().flatten();
        own.chain(others.flat_map(|dict| dict.keys().iter().map(|key| key.to_string()).collect::<Vec<_>>())).collect()
    }

    /// Refuses what `what` has no use for.
    fn is_nothing(&self, what: &str) -> PyResult<()> {
        let given = self.given();
        if given.is_empty() {
            return Ok(());
        }
        let told = format!("{what} takes no {}: only plants and their controllers do.", given.join(", "));
        Err(PyTypeError::new_err(told))
    }

    fn as_c(&self, py: Python<'_>, plant: &Bound<'_, PyAny>, options: &ExportOptions) -> PyResult<library::CModule> {
        let physics: Physics = data("physics", self.physics)?;
        let plant = control::plant(plant, physics)?;
        let Some(name) = self.controller else {
            if self.gains.is_some() || !self.tuning.is_empty() {
                let told = "gains, rates and filters are those of a controller. Name it, as controller='cascade'.";
                return Err(PyTypeError::new_err(told));
            }
            return py.detach(|| plant_as_c(&plant, options)).or_raise();
        };
        let (gains, tuning): (_, Tuning) = (gains_of(self.gains)?, data("controller", Some(&self.tuning))?);
        let made = || {
            let setup = Setup { filters: &tuning.filters, ..Setup::new(gains.as_ref(), &tuning.rates) };
            controller_as_c(&*controller(name, &plant, &setup)?, &plant, options)
        };
        py.detach(made).or_raise()
    }
}

/// A vehicle, a controller, a reference, a task or a policy as C99 without allocation, libraries or global state.
///
/// Parameters
/// ----------
/// what : Vehicle or str or path or dict or VecEnv or Policy
///     - a vehicle or a configuration, its name or file, as `fly` takes it: one step of it; with a `controller`, a tick of that;
///     - a reference, as `fly` takes it: `{"kind": "circle"}`, the target of a controller by time;
///     - environments: what their task observes, rewards and ends;
///     - a policy, or the folder of a run: from state and goal to the action.
/// folder : path, optional
///     Where its files are written, as `CModule.write` does.
/// controller : str, optional
///     Of the plant, as "indi".
/// gains : dict, optional
///     Of the controller, as `Vehicle.gains`.
/// rates : dict, optional
///     How often each of its levels computes, Hz: "velocity", "attitude", "rate".
/// filters : list of dict, optional
///     Of the measured angular velocity, as `fly` takes them.
/// name : str, optional
///     What files and functions begin with; by default after what is exported.
/// precision : str
///     Of its numbers: "float" or "double".
/// force : bool
///     Whether files that are there are replaced.
/// **physics
///     Of a plant: `dt=0.002` (s), `substeps`, `integrator`, `effects`.
#[pyfunction]
#[pyo3(signature = (
    what, /, folder=None, *, controller=None, gains=None, rates=None, filters=None, name=None, precision="float", force=false, **physics
))]
#[expect(clippy::too_many_arguments, reason = "by name in Python")]
pub fn export_c(
    py: Python<'_>,
    what: &Bound<'_, PyAny>,
    folder: Option<PathBuf>,
    controller: Option<&str>,
    gains: Option<&Bound<'_, PyMapping>>,
    rates: Option<&Bound<'_, PyMapping>>,
    filters: Option<&Bound<'_, PyAny>>,
    name: Option<String>,
    precision: &str,
    force: bool,
    physics: Option<&Bound<'_, PyDict>>,
) -> PyResult<CModule> {
    let tuning = PyDict::new(py);
    rates.map_or(Ok(()), |own| tuning.set_item("rates", own))?;
    filters.map_or(Ok(()), |own| tuning.set_item("filters", own))?;
    let of_plant = OfPlant { controller, gains, tuning, physics };
    let options = ExportOptions { name, precision: precision_of(precision)?, ..ExportOptions::default() };
    let module = CModule(module(py, what, &of_plant, &options)?);
    folder.map_or(Ok(Vec::new()), |folder| module.write(py, folder, force))?;
    Ok(module)
}

fn module(
    py: Python<'_>,
    what: &Bound<'_, PyAny>,
    of_plant: &OfPlant<'_, '_>,
    options: &ExportOptions,
) -> PyResult<library::CModule> {
    if let Ok(env) = what.cast::<VecEnv>() {
        of_plant.is_nothing("a VecEnv")?;
        let env = env.try_borrow()?;
        let (spec, statistics) = (env.env.spec(), env.env.statistics());
        if statistics.count > 0.0 && !statistics.mean.is_empty() {
            let (what, value) = ("statistics of the environments", "those of observations");
            let remedy = "Export the policy, which comes with its own, or environments that gathered none.";
            return Err(Error::value(what, value, "none", remedy)).or_raise();
        }
        let (task, config) = (spec.task.clone(), spec.config.clone());
        return py.detach(|| task_as_c(&task, &config, options)).or_raise();
    }
    if let Some(policy) = FlownPolicy::of(py, what)? {
        of_plant.is_nothing("a policy")?;
        return policy.with(|policy, task, config| {
            let env = config.seen_env();
            py.detach(|| policy_as_c(policy, task, &env, options)).or_raise()
        });
    }
    if let Ok(reference) = what.cast::<PyDict>() {
        of_plant.is_nothing("a reference")?;
        let reference: Reference = data("reference", Some(reference))?;
        return py.detach(|| reference_as_c(&reference, options)).or_raise();
    }
    if what.extract::<PathBuf>().is_err() && what.cast::<control::Vehicle>().is_err() {
        let wanted = "a Vehicle, a name, a path, a reference (a dict), a VecEnv or a Policy";
        return Err(foreign("what", what, wanted));
    }
    of_plant.as_c(py, what, options)
}

/// A policy as ONNX (operators of version 17), from the observation that a user has, before it is normalised, to the action.
///
/// Inputs are `observation` [batch, observation] of one agent and, of a policy with memory, `memory` [batch, unit], zeros where an
/// episode begins; outputs are `action` [batch, action], the most likely one, and `memory_next`. All are float32 but for discrete
/// actions, int64. The file's metadata name every number.
///
/// Parameters
/// ----------
/// policy : Policy or str or path
///     A policy, or the folder of a run.
/// path : path, optional
///     The file to write. One that is there and is another is left with `FileExistsError`, unless `force`.
/// agent : int
///     Whose network, where agents have their own.
/// force : bool
///     Whether a file that is there is replaced.
#[pyfunction]
#[pyo3(signature = (policy, /, path=None, *, agent=0, force=false))]
pub fn export_onnx<'py>(
    py: Python<'py>,
    policy: &Bound<'py, PyAny>,
    path: Option<PathBuf>,
    agent: usize,
    force: bool,
) -> PyResult<Bound<'py, PyBytes>> {
    let found = FlownPolicy::of(py, policy)?;
    let found = match (found, policy.extract::<PathBuf>()) {
        (Some(found), _) => found,
        (None, Ok(path)) => FlownPolicy::load(py, &path)?,
        (None, Err(_)) => return Err(foreign("policy", policy, "a Policy or the folder of a run")),
    };
    let bytes = found.with(|policy, task, config| {
        let config = config.seen_env();
        let made = || {
            let env = eval_env(policy, task, &config, Starts { n_env: 1, seed: 0 }, &Threads::new(1)?)?;
            onnx(policy, env.spec(), agent)
        };
        py.detach(made).or_raise()
    })?;
    if let Some(path) = path {
        if !force && path.exists() && std::fs::read(&path).ok().as_ref() != Some(&bytes) {
            let told = format!("{}: another file is there. Give force=True, or another path.", path.display());
            return Err(PyFileExistsError::new_err(told));
        }
        std::fs::write(&path, &bytes).map_err(|source| Error::File { path, source }).or_raise()?;
    }
    Ok(PyBytes::new(py, &bytes))
}

/// A policy of an argument.
enum FlownPolicy<'py> {
    Given(PyRef<'py, Policy>),
    Loaded(Box<rl::SavedPolicy>),
}

impl<'py> FlownPolicy<'py> {
    /// `None` for what is none, nor a folder.
    fn of(py: Python<'py>, given: &Bound<'py, PyAny>) -> PyResult<Option<Self>> {
        if let Ok(policy) = given.cast::<Policy>() {
            return Ok(Some(Self::Given(policy.try_borrow()?)));
        }
        let path = given.extract::<PathBuf>().ok().filter(|path| is_run(path));
        path.map(|path| Self::load(py, &path)).transpose()
    }

    fn load(py: Python<'_>, path: &Path) -> PyResult<Self> {
        Ok(Self::Loaded(Box::new(py.detach(|| rl::load_policy(path)).or_raise()?)))
    }

    fn with<T>(&self, work: impl FnOnce(&rl::Policy, &str, &TrainConfig) -> PyResult<T>) -> PyResult<T> {
        match self {
            Self::Given(own) => work(&own.policy, &own.task, &own.config),
            Self::Loaded(own) => work(&own.policy, &own.manifest.task, &own.config),
        }
    }
}

/// Whether a text means the folder of a run: a path that is neither a plant's name, whatever folders there are, nor a vehicle's file.
fn is_run(path: &Path) -> bool {
    let mut plants = vehicles::names().into_iter().chain(configurations::names());
    let is_plant = path.to_str().is_some_and(|named| plants.any(|name| name.eq_ignore_ascii_case(named)));
    let is_file =
        path.extension().is_some_and(|own| ["toml", "urdf", "xml"].iter().any(|known| own.eq_ignore_ascii_case(known)));
    !is_plant && (path.is_dir() || !is_file && path.components().count() > 1)
}

fn precision_of(named: &str) -> PyResult<ExportPrecision> {
    let all = [ExportPrecision::Single, ExportPrecision::Double];
    let unknown =
        || Error::Unknown { kind: "precision", name: named.into(), known: all.map(|own| own.c_type().into()).into() };
    all.into_iter().find(|own| own.c_type() == named).ok_or_else(unknown).or_raise()
}

fn foreign(name: &str, given: &Bound<'_, PyAny>, wanted: &str) -> PyErr {
    let kind = given.get_type().name().map_or_else(|_| "?".into(), |kind| kind.to_string());
    PyTypeError::new_err(format!("{name} is a {kind}, but it must be {wanted}."))
}
