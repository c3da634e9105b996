//! Many environments of one task, from Python.

use crate::arrays::{
    self, Layout, Slab, array, flags, read, slice, slice_mut, slice_mut_or_none, write, write_flags, write_or_none,
};
use crate::error::OrRaise;
use crate::gradient::{Adjoint, Jacobian, Tape, places};
use crate::settings;
use crate::task;
use omnidrones::error::Error;
use omnidrones::layers::Layer;
use omnidrones::parallel::Threads;
use omnidrones::tasks::registry::{self, TaskEntry};
use omnidrones::tasks::written::TaskRecord;
use omnidrones::tasks::{Env, EnvConfig, Spec, Statistics, StepOut};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyInt, PyTuple};
use std::sync::Arc;
use toml::{Table, Value};

/// Most sets of arrays of an environment.
const MOST_SETS: usize = 16;
/// The arrays of a step, as attributes and in the order of `StepOut`.
const ARRAYS: [&str; 9] = [
    "observation",
    "reward",
    "terminated",
    "truncated",
    "central",
    "privileged",
    "final_observation",
    "final_central",
    "info",
];

/// Many environments of one task, stepped together: E environments of A agents.
///
/// Parameters
/// ----------
/// name : str or Task
///     A task, as `omnidrones.tasks()` lists them; case does not matter. Or a class of your own, `omnidrones.Task`.
/// num_envs : int, optional
///     E; 4096 unless `config` says otherwise.
/// config : dict or path or str, optional
///     Settings: a dict, a TOML file, or TOML itself (a text with `=`). Tables are merged over the task's own defaults.
/// seed : int, optional
///     Of all that is drawn, 0 to 2^64 - 1.
/// threads : int, optional
///     1 runs on the caller's; by default all cores are shared by all environments of the process. The bits do not depend on it.
/// ring : int
///     Sets of arrays that take turns: arrays of a step stay as they are for `ring - 1` further steps.
/// **settings
///     Settings by name, over `config`: `dt=0.01`, `control="rate"`, `autoreset="disabled"`, and those of the task: `horizon=200`.
///     `vehicle` is a name, a `Vehicle`, or the path of a TOML or URDF file. None leaves a setting out. Functions called `reward`,
///     `observe`, `ends`, ... take the place of the task's own.
///
/// Arrays are `float32` and row-major (flags `bool`), SI units; the library owns and reuses them. `env.spec` names every
/// number with its unit.
///
/// Raises
/// ------
/// ValueError
///     For names, settings and sizes that do not fit, with the value, the limit and the remedy.
/// OSError
///     For files that cannot be read.
#[pyclass(module = "omnidrones", name = "VecEnv", weakref)]
pub struct VecEnv {
    pub env: Env,
    config: Table,
    /// Of a task that is no type of Rust.
    record: Option<Arc<TaskRecord>>,
    threads: Option<usize>,
    layout: Layout,
    action: [usize; 3],
    slots: Vec<Slot>,
    at: usize,
    spec: Py<PyAny>,
}

/// One set of arrays, and what a step that wrote them returns.
struct Slot {
    slab: Slab,
    views: Vec<Py<PyAny>>,
    step: Py<PyAny>,
}

impl Slot {
    fn new(py: Python<'_>, layout: &Layout) -> PyResult<Self> {
        let slab = Slab::new(py, layout)?;
        let views =
            ARRAYS.iter().map(|name| Ok(slab.view(py, layout, name)?.unbind())).collect::<PyResult<Vec<_>>>()?;
        let own = |k: usize| views[k].bind(py);
        let told = PyTuple::new(py, [own(0), own(1), own(2), own(3), own(8)])?;
        let step = py.import("omnidrones")?.getattr("Step")?.call1(told)?.unbind();
        Ok(Self { slab, views, step })
    }
}

/// Threads of a call; without a number those that all share.
pub fn threads(n: Option<usize>) -> PyResult<Threads> {
    n.map_or(Ok(Threads::default()), Threads::new).or_raise()
}

fn check_ring(ring: usize) -> PyResult<()> {
    if (1..=MOST_SETS).contains(&ring) {
        return Ok(());
    }
    let remedy = "2 keep the observation before a step, 1 saves memory.";
    Err(Error::limit("ring", ring, format!("1 to {MOST_SETS}"), remedy)).or_raise()
}

/// A seed.
fn seed_of(given: &Bound<'_, PyAny>) -> PyResult<u64> {
    given.extract().map_err(|_| {
        let told = Error::value("seed", given, "a whole number from 0 to 2^64 - 1", "Give another one.");
        PyValueError::new_err(told.to_string())
    })
}

/// The configuration of a call for a task.
pub fn config_of(
    entry: &TaskEntry,
    num_envs: Option<usize>,
    config: Option<&Bound<'_, PyAny>>,
    seed: Option<&Bound<'_, PyAny>>,
    keywords: Option<&Bound<'_, PyDict>>,
) -> PyResult<EnvConfig> {
    let mut layers = settings::layers(entry, config, keywords, &[])?;
    if let Some(n) = num_envs {
        let n = i64::try_from(n).unwrap_or(i64::MAX);
        layers.push(Layer::of_table("num_envs", Table::from_iter([("n_env".to_string(), Value::Integer(n))])));
    }
    let mut config = entry.config(&layers).or_raise()?;
    if let Some(seed) = seed {
        config.seed = seed_of(seed)?;
    }
    Ok(config)
}

/// Names, sizes, units and bounds, as Python has them.
pub fn python_spec(py: Python<'_>, spec: &Spec) -> PyResult<Py<PyAny>> {
    Ok(py.import("omnidrones")?.getattr("Spec")?.call_method1("of_json", (spec.to_json(),))?.unbind())
}

/// All settings but the seed: TOML has no whole numbers from 2^63 on, seeds are.
pub fn settings_of(spec: &Spec) -> PyResult<Table> {
    Table::try_from(EnvConfig { seed: 0, ..spec.config.clone() }).map_err(crate::error::unexpected)
}

/// The place of a column of information.
pub fn column_of(spec: &Spec, name: &str) -> PyResult<usize> {
    let known = || spec.info.iter().map(|info| info.name.clone()).collect();
    let unknown = || Error::Unknown { kind: "column", name: name.into(), known: known() };
    spec.info_column(name).ok_or_else(unknown).or_raise()
}

/// Statistics as Python has them: count, mean, variance.
pub fn statistics_of<'py>(
    py: Python<'py>,
    statistics: &Statistics,
) -> PyResult<(f64, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let Statistics { count, mean, variance } = statistics;
    let own = |numbers: &Vec<f64>| array(py, numbers.clone(), &[numbers.len()]);
    Ok((*count, own(mean)?, own(variance)?))
}

impl VecEnv {
    /// Environments of a configuration that is whole.
    fn made(
        py: Python<'_>,
        entry: &TaskEntry,
        config: &EnvConfig,
        n_thread: Option<usize>,
        ring: usize,
    ) -> PyResult<Self> {
        check_ring(ring)?;
        let config = &task::pinned(py, entry, config.clone())?;
        let made = py.detach(|| Ok((entry.env(config)?, entry.record(config)?)));
        Self::around(py, made.or_raise()?, n_thread, ring)
    }

    fn around(
        py: Python<'_>,
        (mut env, record): (Env, Option<Arc<TaskRecord>>),
        n_thread: Option<usize>,
        ring: usize,
    ) -> PyResult<Self> {
        check_ring(ring)?;
        env.set_threads(threads(n_thread)?);
        let spec = env.spec();
        let layout = Layout::of(spec);
        let slots = (0..ring).map(|_| Slot::new(py, &layout)).collect::<PyResult<Vec<_>>>()?;
        let python = python_spec(py, spec)?;
        let action = [spec.n_env, spec.n_agent, spec.action.len()];
        let config = settings_of(spec)?;
        Ok(Self { config, record, threads: n_thread, layout, action, slots, at: 0, spec: python, env })
    }

    fn n_env(&self) -> usize {
        self.action[0]
    }

    /// Does `work` on the arrays of a slot, without the interpreter; they are those of now behind it.
    pub fn on_arrays(
        &mut self,
        py: Python<'_>,
        at: usize,
        work: impl FnOnce(&mut Env, &mut StepOut<'_>) -> Result<(), Error> + Send,
    ) -> PyResult<Py<PyAny>> {
        let Self { env, layout, slots, .. } = self;
        let mut lent = slots[at].slab.lend(py)?;
        let memory = lent.as_slice_mut().map_err(crate::error::unexpected)?;
        py.detach(|| work(env, &mut layout.out(memory))).or_raise()?;
        self.at = at;
        Ok(self.slots[at].step.clone_ref(py))
    }

    /// The slot that comes next.
    pub fn next(&self) -> usize {
        if self.at + 1 == self.slots.len() { 0 } else { self.at + 1 }
    }

    /// Actions of the caller.
    pub fn read_actions<'py>(&self, actions: &Bound<'py, PyAny>) -> PyResult<arrays::Rows<'py, f32>> {
        read("actions", actions, &self.action)
    }

    fn view(&self, py: Python<'_>, k: usize) -> Py<PyAny> {
        self.slots[self.at].views[k].clone_ref(py)
    }
}

#[pymethods]
impl VecEnv {
    #[new]
    #[pyo3(signature = (name, /, num_envs=None, *, config=None, seed=None, threads=None, ring=2, **settings))]
    #[expect(clippy::too_many_arguments, reason = "by name in Python")]
    fn new(
        py: Python<'_>,
        name: &Bound<'_, PyAny>,
        num_envs: Option<usize>,
        config: Option<&Bound<'_, PyAny>>,
        seed: Option<&Bound<'_, PyAny>>,
        threads: Option<usize>,
        ring: usize,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (entry, settings) = task::entry_of(name, settings)?;
        Self::made(py, entry, &config_of(entry, num_envs, config, seed, settings.as_ref())?, threads, ring)
    }

    /// Names, sizes, units and bounds: a `Spec`.
    #[getter]
    fn spec(&self, py: Python<'_>) -> Py<PyAny> {
        self.spec.clone_ref(py)
    }

    /// Environments, E.
    #[getter]
    fn num_envs(&self) -> usize {
        self.n_env()
    }

    /// Where they are: "cpu". `DeviceEnv` is elsewhere.
    #[getter]
    fn device(&self) -> &'static str {
        "cpu"
    }

    /// All settings as a dict: what another environment is made of, `make(env.spec.task, config=env.config)`.
    #[getter]
    fn config<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = settings::dict(py, &self.config)?;
        dict.set_item("seed", self.env.spec().config.seed)?;
        Ok(dict)
    }

    /// Begins episodes and returns the observations, [E, A, observation].
    ///
    /// Parameters
    /// ----------
    /// seed : int or sequence of int, optional
    ///     A whole number for all environments, whose draws still differ by their place; or one per environment, [E]. With a
    ///     seed, episodes count from their first again.
    /// mask : bool array [E], optional
    ///     Environments to reset; the rows of others stay as they are.
    #[pyo3(signature = (seed=None, mask=None))]
    fn reset(
        &mut self,
        py: Python<'_>,
        seed: Option<&Bound<'_, PyAny>>,
        mask: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Py<PyAny>> {
        let n = self.n_env();
        let which = mask.map(|mask| flags("mask", mask, n)).transpose()?;
        let seeds = seed.map(|seed| seeds_for(seed, n)).transpose()?;
        // rows that are not reset stay: they are in the arrays of now
        let at = if which.is_some() { self.at } else { self.next() };
        self.on_arrays(py, at, |env, out| env.reset(which.as_deref(), seeds.as_deref(), out))?;
        Ok(self.view(py, 0))
    }

    /// One step of every environment.
    ///
    /// Parameters
    /// ----------
    /// actions : float32 array [E, A, action] or [E, A * action]
    ///     Numbers outside of the space are clipped; one that is no number acts as the task's safe command. Both are counted in
    ///     the column `clipped`.
    ///
    /// Returns
    /// -------
    /// Step
    ///     observation [E, A, observation], reward [E, A], terminated [E], truncated [E], info [E, column]: the same objects
    ///     every `ring` steps. How episodes go on is the setting `autoreset`: "same_step" unless told otherwise.
    fn step(&mut self, py: Python<'_>, actions: &Bound<'_, PyAny>) -> PyResult<Py<PyAny>> {
        let rows = self.read_actions(actions)?;
        let actions = slice(&rows)?;
        self.on_arrays(py, self.next(), |env, out| env.step(actions, out))
    }

    /// One step into arrays of the caller: rows of a rollout's buffer. Those left out are not computed.
    ///
    /// Arrays are C-ordered `float32` in the shapes of `step`; flags are `bool` or `uint8`. `final_observation` and
    /// `final_central` are written in rows whose episode ended in this step.
    #[pyo3(signature = (
        actions, *, observation, reward, terminated, truncated, central=None, privileged=None, final_observation=None,
        final_central=None, info=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "by name in Python")]
    fn step_into(
        &mut self,
        py: Python<'_>,
        actions: &Bound<'_, PyAny>,
        observation: &Bound<'_, PyAny>,
        reward: &Bound<'_, PyAny>,
        terminated: &Bound<'_, PyAny>,
        truncated: &Bound<'_, PyAny>,
        central: Option<&Bound<'_, PyAny>>,
        privileged: Option<&Bound<'_, PyAny>>,
        final_observation: Option<&Bound<'_, PyAny>>,
        final_central: Option<&Bound<'_, PyAny>>,
        info: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let (shape, flags) = (|name: &str| self.layout.shape(name), [self.n_env()]);
        let actions = self.read_actions(actions)?;
        let mut observation = write("observation", observation, shape("observation"))?;
        let mut reward = write("reward", reward, shape("reward"))?;
        let mut terminated = write_flags("terminated", terminated, &flags)?;
        let mut truncated = write_flags("truncated", truncated, &flags)?;
        let optional = |name: &str, given| write_or_none::<f32>(name, given, shape(name));
        let mut central = optional("central", central)?;
        let mut privileged = optional("privileged", privileged)?;
        let mut final_observation = optional("final_observation", final_observation)?;
        let mut final_central = optional("final_central", final_central)?;
        let mut info = optional("info", info)?;
        let mut out = StepOut {
            observation: slice_mut(&mut observation)?,
            reward: slice_mut(&mut reward)?,
            terminated: slice_mut(&mut terminated)?,
            truncated: slice_mut(&mut truncated)?,
            central: slice_mut_or_none(&mut central)?,
            privileged: slice_mut_or_none(&mut privileged)?,
            final_observation: slice_mut_or_none(&mut final_observation)?,
            final_central: slice_mut_or_none(&mut final_central)?,
            info: slice_mut_or_none(&mut info)?,
        };
        let (env, actions) = (&mut self.env, slice(&actions)?);
        py.detach(|| env.step(actions, &mut out)).or_raise()
    }

    /// `n` steps in a loop without Python, through the rows of `actions` [set, E, A, action] in turn: what the benchmark sets the
    /// same loop in Python against. None is the crossing alone.
    fn _steps(&mut self, py: Python<'_>, actions: &Bound<'_, PyAny>, n: usize) -> PyResult<Py<PyAny>> {
        let n_set = actions.len()?.max(1);
        let [e, a, k] = self.action;
        let rows = read::<f32>("actions", actions, &[n_set, e, a, k])?;
        let actions = slice(&rows)?;
        self.on_arrays(py, self.next(), |env, out| {
            (0..n).try_for_each(|t| env.step(&actions[t % n_set * e * a * k..][..e * a * k], out))
        })
    }

    /// Writes what the environments look like now and returns the observations; nothing moves on. For observations behind
    /// `set_state`, `set_statistics` and `update_normaliser`.
    fn observe(&mut self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        self.on_arrays(py, self.at, |env, out| env.observe(out))?;
        Ok(self.view(py, 0))
    }

    /// Of the last step or reset, [E, A, observation].
    #[getter]
    fn observation(&self, py: Python<'_>) -> Py<PyAny> {
        self.view(py, 0)
    }

    /// Of the last step, [E, A]; the agents of an environment share one.
    #[getter]
    fn reward(&self, py: Python<'_>) -> Py<PyAny> {
        self.view(py, 1)
    }

    /// Whether the task ended the episode in the last step, bool [E].
    #[getter]
    fn terminated(&self, py: Python<'_>) -> Py<PyAny> {
        self.view(py, 2)
    }

    /// Whether the time of the episode was over in the last step, bool [E].
    #[getter]
    fn truncated(&self, py: Python<'_>) -> Py<PyAny> {
        self.view(py, 3)
    }

    /// State of the whole team for critics, [E, central]; no columns where the task has none.
    #[getter]
    fn central(&self, py: Python<'_>) -> Py<PyAny> {
        self.view(py, 4)
    }

    /// The physical numbers that differ between environments, [E, number], SI; `spec.privileged` names them.
    #[getter]
    fn privileged(&self, py: Python<'_>) -> Py<PyAny> {
        self.view(py, 5)
    }

    /// The last observation of episodes that ended in the last step, [E, A, observation]; other rows hold older numbers.
    #[getter]
    fn final_observation(&self, py: Python<'_>) -> Py<PyAny> {
        self.view(py, 6)
    }

    /// The last central state of episodes that ended in the last step, [E, central]; other rows hold older numbers.
    #[getter]
    fn final_central(&self, py: Python<'_>) -> Py<PyAny> {
        self.view(py, 7)
    }

    /// What the last step told of every episode, [E, column]; `spec.info` names the columns.
    #[getter]
    fn info(&self, py: Python<'_>) -> Py<PyAny> {
        self.view(py, 8)
    }

    /// One column of `info`, [E]: "return", "success", "position_error".
    fn column<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let k = column_of(self.env.spec(), name)?;
        let all = pyo3::types::PySlice::full(py);
        self.slots[self.at].views[8].bind(py).get_item((all, k))
    }

    /// Random actions within their space, [E, A, action]: the same for the same draw, whatever the shard.
    #[pyo3(signature = (draw, out=None))]
    fn sample<'py>(&self, py: Python<'py>, draw: u64, out: Option<&Bound<'py, PyAny>>) -> PyResult<Bound<'py, PyAny>> {
        let Some(out) = out else {
            let mut actions = vec![0.0; self.action.iter().product()];
            self.env.sample(draw, &mut actions);
            return array(py, actions, &self.action);
        };
        self.env.sample(draw, slice_mut(&mut write("out", out, &self.action)?)?);
        Ok(out.clone())
    }

    /// The command that an action stands for which is no number, [A * command]: rotors carry the weight, all else rests.
    #[getter]
    fn safe_command<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let numbers: Vec<f32> = self.env.safe_command().iter().map(|x| *x as f32).collect();
        let n = numbers.len();
        array(py, numbers, &[n])
    }

    /// From the next restarts on, episodes take this share of all randomisation, 0 to 1.
    fn set_difficulty(&mut self, share: f64) -> PyResult<()> {
        self.env.set_difficulty(share).or_raise()
    }

    /// Steps on so many threads from now on; None for those that all share.
    #[pyo3(signature = (n))]
    fn set_threads(&mut self, n: Option<usize>) -> PyResult<()> {
        self.env.set_threads(threads(n)?);
        self.threads = n;
        Ok(())
    }

    /// The physical state of every environment, a new array [E, state]; `state_names` names the columns.
    fn states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let n = self.env.robot().n_state();
        let mut rows = vec![0.0; self.n_env() * n];
        self.env.states_into(&mut rows).or_raise()?;
        array(py, rows, &[self.n_env(), n])
    }

    /// The goal of every environment, a new array [E, goal].
    fn goals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let n = self.env.task_spec().goal.iter().map(|field| field.size).sum();
        let mut rows = vec![0.0; self.n_env() * n];
        self.env.goals_into(&mut rows).or_raise()?;
        array(py, rows, &[self.n_env(), n])
    }

    /// The physical numbers in force in every environment, a new float64 array [E, number].
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let n = self.env.robot().parameters().len();
        let mut rows = vec![0.0; self.n_env() * n];
        self.env.parameters_into(&mut rows).or_raise()?;
        array(py, rows, &[self.n_env(), n])
    }

    /// Names of the columns of `states()`, with units.
    #[getter]
    fn state_names(&self) -> Vec<String> {
        let told = |q: &omnidrones::dynamics::Quantity| format!("{} [{}]", q.name, q.unit);
        self.env.robot().plant().state_quantities().iter().map(told).collect()
    }

    /// Names of the columns of `parameters()`.
    #[getter]
    fn parameter_names(&self) -> Vec<String> {
        self.env.robot().parameter_names()
    }

    /// Overwrites the physical state of one environment, a float32 array [state]; its episode goes on.
    fn set_state(&mut self, environment: usize, state: &Bound<'_, PyAny>) -> PyResult<()> {
        let rows = read::<f32>("state", state, &[self.env.robot().n_state()])?;
        self.env.set_state(environment, slice(&rows)?).or_raise()
    }

    /// What broke where the simulation of one environment last diverged, in words; None where none has.
    fn breach(&self, environment: usize) -> PyResult<Option<String>> {
        Ok(self.env.breach(environment).or_raise()?.map(|breach| breach.to_string()))
    }

    /// Takes the statistics of all observations since the last call into the stage `normalise`, and freezes them.
    fn update_normaliser(&mut self) {
        self.env.update_normaliser();
    }

    /// Of the stage `normalise`: (count, mean, variance), without one of no numbers.
    #[getter]
    fn statistics<'py>(&self, py: Python<'py>) -> PyResult<(f64, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        statistics_of(py, self.env.statistics())
    }

    /// Freezes other statistics, and collects none from now on.
    fn set_statistics(&mut self, count: f64, mean: Vec<f64>, variance: Vec<f64>) -> PyResult<()> {
        self.env.set_statistics(Statistics { count, mean, variance }).or_raise()
    }

    /// Memory for so many recorded steps.
    fn tape(&self, horizon: usize) -> PyResult<Tape> {
        Ok(Tape(self.env.tape(horizon).or_raise()?))
    }

    /// As `step`, remembered by the tape.
    fn step_recorded(&mut self, py: Python<'_>, actions: &Bound<'_, PyAny>, tape: &mut Tape) -> PyResult<Py<PyAny>> {
        let rows = self.read_actions(actions)?;
        let (actions, tape) = (slice(&rows)?, &mut tape.0);
        self.on_arrays(py, self.next(), |env, out| env.step_recorded(actions, out, tape))
    }

    /// The adjoint of a step, recorded and compiled: milliseconds for a vehicle, up to seconds for a team. With `parameters`,
    /// sweeps also give gradients by the physical numbers that differ between environments.
    #[pyo3(signature = (parameters=false))]
    fn adjoint(&self, py: Python<'_>, parameters: bool) -> PyResult<Adjoint> {
        let env = &self.env;
        let adjoint = py.detach(|| env.adjoint(parameters)).or_raise()?;
        Ok(Adjoint { adjoint, n_env: env.spec().n_env })
    }

    /// Places among the arguments and results of a step by name, as slices: see `Jacobian.layout`.
    #[getter]
    fn layout<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        places(py, &self.env.layout())
    }

    /// Exact derivatives of one step of one environment as it stands, for an action float64 [A * command]; without noise of
    /// sensors and without events.
    fn jacobian(&self, py: Python<'_>, environment: usize, action: Vec<f64>) -> PyResult<Jacobian> {
        let env = &self.env;
        Ok(Jacobian(py.detach(|| env.jacobian(environment, &action)).or_raise()?))
    }

    /// The same where the arguments are given, float64 [argument]: along a rollout through `evaluate`.
    fn jacobian_at(&self, py: Python<'_>, arguments: Vec<f64>) -> PyResult<Jacobian> {
        let env = &self.env;
        Ok(Jacobian(py.detach(|| env.jacobian_at(&arguments)).or_raise()?))
    }

    /// The results of one step in float64, [result], for arguments as in `Jacobian.arguments`.
    fn evaluate<'py>(&self, py: Python<'py>, arguments: Vec<f64>) -> PyResult<Bound<'py, PyAny>> {
        let value = self.env.evaluate(&arguments).or_raise()?;
        let n = value.len();
        array(py, value, &[n])
    }

    /// The exact state of all environments as bytes: what follows `load` has the bits of what follows this.
    fn save<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &py.detach(|| self.env.save()))
    }

    /// Goes on from what `save` gave to environments of the same settings, and shows what they look like.
    fn load(&mut self, py: Python<'_>, state: &[u8]) -> PyResult<()> {
        let env = &mut self.env;
        py.detach(|| env.load(state)).or_raise()?;
        // before the first reset nothing is seen
        if self.env.is_started() { self.observe(py).map(drop) } else { Ok(()) }
    }

    /// Pickles and copies are of the settings and the exact state, with its observations.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let restore = py.import("omnidrones._core")?.getattr("_restore")?;
        let (task, text) = (self.env.spec().task.as_str(), self.config.to_string());
        let seed = self.env.spec().config.seed;
        let record = self.record.as_ref().map(|record| record.to_bytes()).transpose().or_raise()?;
        let record = record.map(|bytes| PyBytes::new(py, &bytes));
        let made = (task, text, seed, self.threads, self.slots.len(), self.save(py), record).into_pyobject(py)?;
        Ok((restore, made))
    }

    /// Whether another batch runs the very programs of this one, gradients too.
    fn _is_recorded_alike(&self, other: &Self) -> bool {
        self.env.is_recorded_alike(&other.env)
    }

    /// What was recorded for it, printed, by name.
    fn _printed(&self) -> Vec<(&'static str, String)> {
        self.env.printed()
    }

    fn __repr__(&self) -> String {
        format!("VecEnv('{}', {})", self.env.spec().task, self.n_env())
    }
}

/// What `VecEnv.__reduce__` took apart.
#[pyfunction]
#[pyo3(signature = (task, config, seed, threads, ring, state, record=None))]
#[expect(clippy::too_many_arguments, reason = "of a pickle")]
pub fn _restore(
    py: Python<'_>,
    task: &str,
    config: &str,
    seed: u64,
    threads: Option<usize>,
    ring: usize,
    state: &[u8],
    record: Option<&[u8]>,
) -> PyResult<VecEnv> {
    let config = EnvConfig { seed, ..EnvConfig::from_toml(config, "pickled settings").or_raise()? };
    // by value: a class of this name may be another one here
    record.map(task::_register_record).transpose()?;
    let mut env = VecEnv::made(py, registry::by_name(task).or_raise()?, &config, threads, ring)?;
    // rewards, flags and info are those of a step, of which there was none yet
    env.load(py, state)?;
    Ok(env)
}

/// Seeds of a reset: one for all, or one for each.
pub fn seeds_for(given: &Bound<'_, PyAny>, n: usize) -> PyResult<Vec<u64>> {
    let single = given.is_instance_of::<PyInt>() || given.getattr("ndim").is_ok_and(|n| n.eq(0).unwrap_or(false));
    if single { seed_of(given).map(|seed| vec![seed; n]) } else { seeds_of(given) }
}

fn seeds_of(given: &Bound<'_, PyAny>) -> PyResult<Vec<u64>> {
    let Ok(items) = given.try_iter() else {
        let kind = given.get_type().name()?;
        let told = format!("seed is a {kind}, but it must be a whole number or one per environment.");
        return Err(PyTypeError::new_err(told));
    };
    items.map(|seed| seed_of(&seed?)).collect()
}
