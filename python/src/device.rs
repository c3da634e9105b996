//! Many environments of one task on a device, from Python. Numbers stay there; others see them by DLPack.

use crate::arrays::{array, read, slice, slice_mut, write};
use crate::batch::{VecEnv, column_of, config_of, python_spec, seeds_for, settings_of, statistics_of, threads};
use crate::error::OrRaise;
use crate::gradient::places;
use crate::settings;
use crate::task;
use gpu::{DeviceCotangents, DeviceKind, DeviceRows};
use numpy::PyUntypedArray;
use omnidrones::error::Error;
use omnidrones::tasks::registry::{self, TaskEntry};
use omnidrones::tasks::written::TaskRecord;
use omnidrones::tasks::{EnvConfig, Statistics, SweepOptions};
use pyo3::exceptions::{PyAttributeError, PyBufferError, PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};
use std::sync::Arc;
use toml::Table;

/// The arrays of a step, as attributes.
const ARRAYS: [gpu::DeviceArray; 10] = [
    gpu::DeviceArray::Observation,
    gpu::DeviceArray::Reward,
    gpu::DeviceArray::Terminated,
    gpu::DeviceArray::Truncated,
    gpu::DeviceArray::Central,
    gpu::DeviceArray::Privileged,
    gpu::DeviceArray::FinalObservation,
    gpu::DeviceArray::FinalCentral,
    gpu::DeviceArray::Info,
    gpu::DeviceArray::Action,
];

/// Numbers of an environment where they lie on its device; the next step writes them anew.
///
/// `torch.from_dlpack(array)`, `cupy.from_dlpack(array)` and `jax.dlpack.from_dlpack(array)` are views of the same memory, which stays as
/// long as one of them does. NVIDIA's array interface is there for CuPy and Numba. `array.numpy()` is a copy on the host.
#[pyclass(module = "omnidrones", frozen)]
pub struct DeviceArray {
    rows: DeviceRows,
    device: gpu::Device,
}

impl DeviceArray {
    fn dtype(&self) -> &'static str {
        if self.rows.is_float() { "float32" } else { "bool" }
    }
}

#[pymethods]
impl DeviceArray {
    /// Numbers along each axis.
    #[getter]
    fn shape<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.rows.shape())
    }

    /// From one number to the next along each axis, in numbers.
    #[getter]
    fn strides<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.rows.strides())
    }

    /// A `numpy.dtype`: float32, or bool.
    #[getter(dtype)]
    fn numpy_dtype<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        py.import("numpy")?.call_method1("dtype", (self.dtype(),))
    }

    /// Where it lies: "cuda:0"; "emulated" is the host in place of a card.
    #[getter]
    fn device(&self) -> String {
        self.rows.device().to_string()
    }

    /// Kind and number of the device, as DLPack counts them; for the stand-in those of the host.
    fn __dlpack_device__(&self) -> (i32, i32) {
        self.rows.device().dlpack()
    }

    /// A capsule of DLPack. Work of `stream`, the consumer's, waits for what was asked for so far; later steps do not wait for it.
    #[pyo3(signature = (*, stream=None, max_version=None, dl_device=None, copy=None))]
    fn __dlpack__<'py>(
        &self,
        py: Python<'py>,
        stream: Option<i64>,
        max_version: Option<(u32, u32)>,
        dl_device: Option<(i32, i32)>,
        copy: Option<bool>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let _ = max_version; // what has no version is taken by all
        if copy == Some(true) {
            return Err(PyBufferError::new_err("numbers of an environment are lent, not copied. Copy what you get."));
        }
        let own = self.__dlpack_device__();
        if let Some(wanted) = dl_device.filter(|wanted| *wanted != own) {
            let told = format!("the numbers lie on {}, not on DLPack's {wanted:?}. Move what you get.", self.device());
            return Err(PyBufferError::new_err(told));
        }
        // 1 is the default stream, which none stands for; -1 asks for no order
        match stream.unwrap_or(1) {
            -1 => {}
            stream @ (0 | ..-1) => {
                let told =
                    format!("stream is {stream}, but it must be -1 (no order), 1 (the default one), 2, or a handle.");
                return Err(PyValueError::new_err(told));
            }
            stream if stream as u64 == 1.max(self.device.stream()) => {}
            stream => self.device.let_wait(if stream == 1 { 0 } else { stream as u64 }).or_raise()?,
        }
        py.import("omnidrones._device")?.call_method1("capsule_of", (self.rows.to_dlpack(),))
    }

    /// NVIDIA's array interface, version 3; arrays of the stand-in have none.
    #[getter]
    fn __cuda_array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        if self.rows.device() == DeviceKind::Emulated {
            return Err(PyAttributeError::new_err("numbers of the stand-in lie on no card. Take DLPack."));
        }
        let (size, kind) = if self.rows.is_float() { (4, "<f4") } else { (1, "|b1") };
        let own = PyDict::new(py);
        own.set_item("shape", self.shape(py)?)?;
        own.set_item("strides", PyTuple::new(py, self.rows.strides().iter().map(|stride| size * stride))?)?;
        own.set_item("typestr", kind)?;
        own.set_item("data", (self.rows.address(), false))?;
        own.set_item("version", 3)?;
        own.set_item("stream", 1.max(self.device.stream()))?;
        Ok(own)
    }

    /// A copy on the host, when what was asked for before is done.
    fn numpy<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let rows = py.detach(|| self.rows.to_host()).or_raise()?;
        let own = array(py, rows, self.rows.shape())?;
        own.call_method1(intern!(py, "astype"), (self.dtype(), intern!(py, "C"), intern!(py, "unsafe"), true, false))
    }

    /// As `numpy`.
    #[pyo3(signature = (dtype=None, copy=None))]
    fn __array__<'py>(
        &self,
        py: Python<'py>,
        dtype: Option<&Bound<'py, PyAny>>,
        copy: Option<bool>,
    ) -> PyResult<Bound<'py, PyAny>> {
        if copy == Some(false) {
            let told =
                "numbers on a device come to the host as a copy. For a view there, take torch.from_dlpack(array).";
            return Err(PyValueError::new_err(told));
        }
        let own = self.numpy(py)?;
        dtype.map_or(Ok(own.clone()), |dtype| own.call_method1(intern!(py, "astype"), (dtype,)))
    }

    fn __len__(&self) -> usize {
        self.rows.shape().first().copied().unwrap_or(0)
    }

    fn __repr__(&self) -> String {
        format!("DeviceArray({} {:?} on {})", self.dtype(), self.rows.shape(), self.device())
    }
}

/// Numbers of the caller on a device, and what keeps them there.
struct Given {
    rows: DeviceRows,
    holder: Py<PyAny>,
}

/// An argument that lies on a device, ready for work of its stream.
fn given(name: &str, own: &Bound<'_, PyAny>, device: &gpu::Device) -> PyResult<Given> {
    let py = own.py();
    if let Ok(array) = own.cast::<DeviceArray>() {
        return Ok(Given { rows: array.get().rows.clone(), holder: own.clone().unbind() });
    }
    let kind = device.kind();
    if !own.hasattr(intern!(py, "__dlpack__"))? {
        let told = own.get_type().name()?;
        return Err(PyTypeError::new_err(format!(
            "{name} is a {told}, but it must be an array on {kind}. Pass a tensor there, or what else speaks DLPack."
        )));
    }
    let place: (i64, i64) = own.call_method0(intern!(py, "__dlpack_device__"))?.extract()?;
    let (wanted, number) = kind.dlpack();
    if place != (wanted.into(), number.into()) {
        let told = if place.0 == 1 { "the host".into() } else { format!("DLPack's device {place:?}") };
        return Err(PyValueError::new_err(format!("{name} lies on {told}, but it must lie on {kind}. Move it there.")));
    }
    let capsule = if kind == DeviceKind::Emulated {
        own.call_method0(intern!(py, "__dlpack__"))?
    } else {
        let keywords = PyDict::new(py);
        keywords.set_item(intern!(py, "stream"), 1.max(device.stream()))?;
        own.call_method(intern!(py, "__dlpack__"), (), Some(&keywords))?
    };
    let address = py.import("omnidrones._device")?.call_method1(intern!(py, "address_of"), (&capsule,))?.extract()?;
    let rows = DeviceRows::of_dlpack(address).map_err(|told| {
        let wanted = if name == "mask" { "bool" } else { "float32" };
        PyTypeError::new_err(format!("{name} holds {told}, but it must hold {wanted}. Convert it."))
    })?;
    Ok(Given { rows, holder: capsule.unbind() })
}

/// Actions of a step.
enum Actions<'py> {
    /// What lies in `DeviceEnv.action`.
    Own,
    Host(crate::arrays::Rows<'py, f32>),
    Device(DeviceRows),
}

/// Many environments of one task on a device: E environments of A agents, with the episodes and the bits of a `VecEnv` of the same settings.
///
/// `make(name, num_envs, device="cuda")` makes them; settings are those of `VecEnv`. Arrays stay on the device and are the same objects
/// always: `DeviceArray`s, which others see by DLPack. A step is asked for and not waited for. Work goes to the default stream of the
/// card, or to `stream`; whoever reads arrays on another one orders the two.
///
/// Raises
/// ------
/// ValueError
///     For what `VecEnv` refuses; where there is no driver, no card or no compiler; for tasks with sensors, estimates and controllers that
///     actions correct, which the host alone has.
#[pyclass(module = "omnidrones", name = "DeviceEnv", weakref)]
pub struct DeviceEnv {
    env: gpu::DeviceEnv,
    config: Table,
    /// Of a task that is no type of Rust.
    record: Option<Arc<TaskRecord>>,
    action: [usize; 3],
    arrays: Vec<Py<DeviceArray>>,
    step: Py<PyAny>,
    spec: Py<PyAny>,
    /// What the last step may still read.
    held: Option<Py<PyAny>>,
}

impl DeviceEnv {
    fn made(
        py: Python<'_>,
        entry: &TaskEntry,
        config: &EnvConfig,
        device: &str,
        n_thread: Option<usize>,
    ) -> PyResult<Self> {
        let (config, n_thread) = (&task::pinned(py, entry, config.clone())?, threads(n_thread)?);
        if device.starts_with("cuda") {
            py.import("omnidrones._make")?.call_method0("name_compiler")?;
        }
        let made = py.detach(|| {
            let device = gpu::Device::new(device.parse()?)?;
            let mut env = entry.env(config)?;
            env.set_threads(n_thread);
            Ok((gpu::DeviceEnv::new(env, &device)?, entry.record(config)?))
        });
        let (env, record) = made.or_raise()?;
        let (spec, device) = (env.spec(), env.device());
        let own =
            |which: &gpu::DeviceArray| Py::new(py, DeviceArray { rows: env.array(*which), device: device.clone() });
        let arrays = ARRAYS.iter().map(own).collect::<PyResult<Vec<_>>>()?;
        let told = PyTuple::new(py, [0, 1, 2, 3, 8].map(|k: usize| arrays[k].clone_ref(py)))?;
        let step = py.import("omnidrones")?.getattr("Step")?.call1(told)?.unbind();
        let action = [spec.n_env, spec.n_agent, spec.action.len()];
        let (config, spec) = (settings_of(spec)?, python_spec(py, spec)?);
        Ok(Self { env, config, record, action, arrays, step, spec, held: None })
    }

    fn view(&self, py: Python<'_>, k: usize) -> Py<DeviceArray> {
        self.arrays[k].clone_ref(py)
    }

    fn n_env(&self) -> usize {
        self.action[0]
    }

    fn actions<'py>(&mut self, actions: Option<&Bound<'py, PyAny>>) -> PyResult<Actions<'py>> {
        let Some(actions) = actions else { return Ok(Actions::Own) };
        if actions.is_instance_of::<PyUntypedArray>() || !actions.hasattr(intern!(actions.py(), "__dlpack__"))? {
            return Ok(Actions::Host(read("actions", actions, &self.action)?));
        }
        let Given { rows, holder } = given("actions", actions, self.env.device())?;
        self.held = Some(holder);
        Ok(Actions::Device(rows))
    }

    /// New rows of the host, [E, `n`].
    fn of_host<'py>(
        &mut self,
        py: Python<'py>,
        n: impl FnOnce(&omnidrones::tasks::Env) -> usize,
        fill: impl FnOnce(&omnidrones::tasks::Env, &mut [f32]) -> Result<(), Error> + Send,
    ) -> PyResult<Bound<'py, PyAny>> {
        let env = &mut self.env;
        let host = py.detach(|| env.on_host()).or_raise()?;
        let (e, n) = (host.spec().n_env, n(host));
        let mut rows = vec![0.0; e * n];
        fill(host, &mut rows).or_raise()?;
        array(py, rows, &[e, n])
    }
}

#[pymethods]
impl DeviceEnv {
    #[new]
    #[pyo3(signature = (name, /, num_envs=None, *, device="cuda", config=None, seed=None, threads=None, **settings))]
    #[expect(clippy::too_many_arguments, reason = "by name in Python")]
    fn new(
        py: Python<'_>,
        name: &Bound<'_, PyAny>,
        num_envs: Option<usize>,
        device: &str,
        config: Option<&Bound<'_, PyAny>>,
        seed: Option<&Bound<'_, PyAny>>,
        threads: Option<usize>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (entry, settings) = task::entry_of(name, settings)?;
        Self::made(py, entry, &config_of(entry, num_envs, config, seed, settings.as_ref())?, device, threads)
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

    /// Where they are: "cuda:0"; "emulated" is the host in place of a card.
    #[getter]
    fn device(&self) -> String {
        self.env.device().kind().to_string()
    }

    /// What the device calls itself.
    #[getter]
    fn device_name(&self) -> String {
        self.env.device().name()
    }

    /// All settings as a dict.
    #[getter]
    fn config<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = settings::dict(py, &self.config)?;
        dict.set_item("seed", self.env.spec().config.seed)?;
        Ok(dict)
    }

    /// The stream of the driver that work goes to, a handle: `torch.cuda.current_stream().cuda_stream`; 0 is the default one. It must live as
    /// long as work goes to it.
    #[getter]
    fn stream(&self) -> u64 {
        self.env.device().stream()
    }

    #[setter]
    fn set_stream(&self, stream: u64) {
        self.env.device().set_stream(stream);
    }

    /// What a graph of PyTorch's keeps of these environments beside arrays, and later settings do not reach.
    #[getter]
    fn _kept_by_graphs(&self) -> (u64, u32) {
        self.env.shared_by_steps()
    }

    /// Waits until all that was asked for is done.
    fn synchronise(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.env.device().synchronise()).or_raise()
    }

    /// Begins episodes and returns the observations, [E, A, observation].
    ///
    /// `seed` is one whole number or one per environment; `mask` chooses environments, bool [E], of NumPy or on the device. A mask on the device
    /// waits for nothing, unless seeds are given, some have never begun, or steps are being recorded.
    #[pyo3(signature = (seed=None, mask=None))]
    fn reset(
        &mut self,
        py: Python<'_>,
        seed: Option<&Bound<'_, PyAny>>,
        mask: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Py<DeviceArray>> {
        let n = self.n_env();
        let seeds = seed.map(|seed| seeds_for(seed, n)).transpose()?;
        match mask {
            Some(mask) if !mask.is_instance_of::<PyUntypedArray>() => {
                let Given { rows, holder } = given("mask", mask, self.env.device())?;
                let env = &mut self.env;
                py.detach(|| env.reset_on(&rows, seeds.as_deref())).or_raise()?;
                self.held = Some(holder);
            }
            mask => {
                let which = mask.map(|mask| crate::arrays::flags("mask", mask, n)).transpose()?;
                let env = &mut self.env;
                py.detach(|| env.reset(which.as_deref(), seeds.as_deref())).or_raise()?;
            }
        }
        Ok(self.view(py, 0))
    }

    /// One step of every environment; returns a `Step` of `DeviceArray`s, the same objects always.
    ///
    /// `actions` are float32 [E, A, action] or [E, A * action]: on the device, where they are read in place, or of NumPy. Without, they are
    /// what lies in `action`.
    #[pyo3(signature = (actions=None))]
    fn step(&mut self, py: Python<'_>, actions: Option<&Bound<'_, PyAny>>) -> PyResult<Py<PyAny>> {
        let actions = self.actions(actions)?;
        let env = &mut self.env;
        match &actions {
            Actions::Own => py.detach(|| env.step_again()),
            Actions::Device(rows) => py.detach(|| env.step_on(rows)),
            Actions::Host(rows) => {
                let rows = slice(rows)?;
                py.detach(|| env.step(rows))
            }
        }
        .or_raise()?;
        Ok(self.step.clone_ref(py))
    }

    /// As `step`, remembered by the tape.
    #[pyo3(signature = (actions, tape))]
    fn step_recorded(
        &mut self,
        py: Python<'_>,
        actions: Option<&Bound<'_, PyAny>>,
        tape: &mut DeviceTape,
    ) -> PyResult<Py<PyAny>> {
        let actions = self.actions(actions)?;
        let (env, tape) = (&mut self.env, &mut tape.0);
        match &actions {
            Actions::Own => py.detach(|| env.step_recorded_again(tape)),
            Actions::Device(rows) => py.detach(|| env.step_recorded_on(rows, tape)),
            Actions::Host(rows) => {
                let rows = slice(rows)?;
                py.detach(|| env.step_recorded(rows, tape))
            }
        }
        .or_raise()?;
        Ok(self.step.clone_ref(py))
    }

    /// `n` steps with what lies in `action`, as one piece of work for `replay`: small batches take less time to step than their kernels to be
    /// asked for.
    #[pyo3(signature = (n=1))]
    fn graph(&mut self, n: usize) -> PyResult<DeviceGraph> {
        Ok(DeviceGraph(self.env.graph(n).or_raise()?))
    }

    /// Steps as a graph does.
    fn replay(&mut self, py: Python<'_>, graph: &DeviceGraph) -> PyResult<Py<PyAny>> {
        let env = &mut self.env;
        py.detach(|| env.replay(&graph.0)).or_raise()?;
        Ok(self.step.clone_ref(py))
    }

    /// Writes what the environments look like now and returns the observations; nothing moves on.
    fn observe(&mut self, py: Python<'_>) -> PyResult<Py<DeviceArray>> {
        let env = &mut self.env;
        py.detach(|| env.observe()).or_raise()?;
        Ok(self.view(py, 0))
    }

    /// Of the last step or reset, [E, A, observation].
    #[getter]
    fn observation(&self, py: Python<'_>) -> Py<DeviceArray> {
        self.view(py, 0)
    }

    /// Of the last step, [E, A]; the agents of an environment share one number.
    #[getter]
    fn reward(&self, py: Python<'_>) -> Py<DeviceArray> {
        self.view(py, 1)
    }

    /// Whether the task ended the episode in the last step, bool [E].
    #[getter]
    fn terminated(&self, py: Python<'_>) -> Py<DeviceArray> {
        self.view(py, 2)
    }

    /// Whether the time of the episode was over in the last step, bool [E].
    #[getter]
    fn truncated(&self, py: Python<'_>) -> Py<DeviceArray> {
        self.view(py, 3)
    }

    /// State of the whole team for critics, [E, central].
    #[getter]
    fn central(&self, py: Python<'_>) -> Py<DeviceArray> {
        self.view(py, 4)
    }

    /// The physical numbers that differ between environments, [E, number], SI; `spec.privileged` names them.
    #[getter]
    fn privileged(&self, py: Python<'_>) -> Py<DeviceArray> {
        self.view(py, 5)
    }

    /// The last observation of episodes that ended in the last step, [E, A, observation]; other rows hold older numbers.
    #[getter]
    fn final_observation(&self, py: Python<'_>) -> Py<DeviceArray> {
        self.view(py, 6)
    }

    /// The last central state of episodes that ended in the last step, [E, central]; other rows hold older numbers.
    #[getter]
    fn final_central(&self, py: Python<'_>) -> Py<DeviceArray> {
        self.view(py, 7)
    }

    /// What the last step told of every episode, [E, column]; `spec.info` names the columns.
    #[getter]
    fn info(&self, py: Python<'_>) -> Py<DeviceArray> {
        self.view(py, 8)
    }

    /// Actions that `step()` and graphs step with, [E, A, action]: write there.
    #[getter]
    fn action(&self, py: Python<'_>) -> Py<DeviceArray> {
        self.view(py, 9)
    }

    /// One column of `info`, [E]: "return", "success", "position_error".
    fn column(&self, name: &str) -> PyResult<DeviceArray> {
        let k = column_of(self.env.spec(), name)?;
        Ok(DeviceArray { rows: self.env.array(gpu::DeviceArray::Info).column(k), device: self.env.device().clone() })
    }

    /// Random actions within their space, a NumPy array [E, A, action]: those of a `VecEnv` for the same draw.
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

    /// The command that an action stands for which is no number, a NumPy array [A * command].
    #[getter]
    fn safe_command<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let numbers: Vec<f32> = self.env.on_host().or_raise()?.safe_command().iter().map(|x| *x as f32).collect();
        let n = numbers.len();
        array(py, numbers, &[n])
    }

    /// From the next restarts on, episodes take this share of all randomisation, 0 to 1.
    fn set_difficulty(&mut self, share: f64) -> PyResult<()> {
        self.env.set_difficulty(share).or_raise()
    }

    /// The physical state of every environment, a new NumPy array [E, state]; `state_names` names the columns.
    fn states<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.of_host(py, |host| host.robot().n_state(), |host, rows| host.states_into(rows))
    }

    /// The goal of every environment, a new NumPy array [E, goal].
    fn goals<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let n = |host: &omnidrones::tasks::Env| host.task_spec().goal.iter().map(|field| field.size).sum();
        self.of_host(py, n, |host, rows| host.goals_into(rows))
    }

    /// Names of the columns of `states()`, with units.
    #[getter]
    fn state_names(&mut self) -> PyResult<Vec<String>> {
        let told = |q: &omnidrones::dynamics::Quantity| format!("{} [{}]", q.name, q.unit);
        Ok(self.env.on_host().or_raise()?.robot().plant().state_quantities().iter().map(told).collect())
    }

    /// Overwrites the physical state of one environment, a NumPy array [state]; its episode goes on.
    fn set_state(&mut self, environment: usize, state: &Bound<'_, PyAny>) -> PyResult<()> {
        let n = self.env.on_host().or_raise()?.robot().n_state();
        let rows = read::<f32>("state", state, &[n])?;
        self.env.set_state(environment, slice(&rows)?).or_raise()
    }

    /// Takes the statistics of all observations since the last call into the stage `normalise`, and freezes them.
    fn update_normaliser(&mut self) -> PyResult<()> {
        self.env.update_normaliser().or_raise()
    }

    /// Of the stage `normalise`: (count, mean, variance), without one of no numbers.
    #[getter]
    fn statistics<'py>(&mut self, py: Python<'py>) -> PyResult<(f64, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        statistics_of(py, self.env.on_host().or_raise()?.statistics())
    }

    /// Freezes other statistics, and collects none from now on.
    fn set_statistics(&mut self, count: f64, mean: Vec<f64>, variance: Vec<f64>) -> PyResult<()> {
        self.env.set_statistics(Statistics { count, mean, variance }).or_raise()
    }

    /// Memory on the device for so many recorded steps.
    fn tape(&self, horizon: usize) -> PyResult<DeviceTape> {
        Ok(DeviceTape(self.env.tape(horizon).or_raise()?))
    }

    /// The adjoint of a step as a kernel; with `parameters`, sweeps also give gradients by the physical numbers that differ between
    /// environments.
    #[pyo3(signature = (parameters=false))]
    fn adjoint(&self, py: Python<'_>, parameters: bool) -> PyResult<DeviceAdjoint> {
        let env = &self.env;
        let adjoint = py.detach(|| env.adjoint(parameters)).or_raise()?;
        Ok(DeviceAdjoint { adjoint, n_env: self.n_env(), device: env.device().clone() })
    }

    /// Places among the arguments and results of a step by name, as slices: see `Jacobian.layout`.
    #[getter]
    fn layout<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        places(py, &self.env.on_host().or_raise()?.layout())
    }

    /// The same environments on the host, as they are now: a `VecEnv` that goes its own way from here.
    fn on_host(&mut self, py: Python<'_>) -> PyResult<VecEnv> {
        let (task, text) = (self.env.spec().task.clone(), self.config.to_string());
        let state = self.env.on_host().or_raise()?.save();
        let record = self.record.as_ref().map(|record| record.to_bytes()).transpose().or_raise()?;
        let seed = self.env.spec().config.seed;
        crate::batch::_restore(py, &task, &text, seed, None, 2, &state, record.as_deref())
    }

    /// The exact state of all environments as bytes, as those of `VecEnv.save`.
    fn save<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let env = &mut self.env;
        Ok(PyBytes::new(py, &py.detach(|| env.on_host().map(omnidrones::tasks::Env::save)).or_raise()?))
    }

    /// Goes on from what `save` gave, here or on the host, to environments of the same settings.
    fn load(&mut self, py: Python<'_>, state: &[u8]) -> PyResult<()> {
        let env = &mut self.env;
        py.detach(|| env.load(state)).or_raise()
    }

    /// Pickles and copies are of the settings, the device's name and the exact state, with its observations.
    fn __reduce__<'py>(&mut self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let restore = py.import("omnidrones._core")?.getattr("_restore_on_device")?;
        let (task, text) = (self.env.spec().task.clone(), self.config.to_string());
        let (seed, device) = (self.env.spec().config.seed, self.device());
        let record = self.record.as_ref().map(|record| record.to_bytes()).transpose().or_raise()?;
        let record = record.map(|bytes| PyBytes::new(py, &bytes));
        let made = (task, text, seed, device, self.save(py)?, record).into_pyobject(py)?;
        Ok((restore, made))
    }

    fn __repr__(&self) -> String {
        format!("DeviceEnv('{}', {}, device='{}')", self.env.spec().task, self.n_env(), self.device())
    }
}

/// What `DeviceEnv.__reduce__` took apart.
#[pyfunction]
#[pyo3(signature = (task, config, seed, device, state, record=None))]
pub fn _restore_on_device(
    py: Python<'_>,
    task: &str,
    config: &str,
    seed: u64,
    device: &str,
    state: &[u8],
    record: Option<&[u8]>,
) -> PyResult<DeviceEnv> {
    let config = EnvConfig { seed, ..EnvConfig::from_toml(config, "pickled settings").or_raise()? };
    // by value: a class of this name may be another one here
    record.map(task::_register_record).transpose()?;
    let mut env = DeviceEnv::made(py, registry::by_name(task).or_raise()?, &config, device, None)?;
    env.load(py, state)?;
    Ok(env)
}

/// Gives back what a capsule of `DeviceArray.__dlpack__` held that nobody took.
#[pyfunction]
pub fn _give_back(address: u64) {
    DeviceRows::give_back(address);
}

/// Steps of a `DeviceEnv` as one piece of work: `DeviceEnv.graph` makes it.
#[pyclass(module = "omnidrones", frozen)]
pub struct DeviceGraph(gpu::DeviceGraph);

#[pymethods]
impl DeviceGraph {
    /// Steps.
    fn __len__(&self) -> usize {
        self.0.len()
    }
}

/// What `DeviceEnv.step_recorded` remembers of up to so many steps, on the device.
#[pyclass(module = "omnidrones")]
pub struct DeviceTape(gpu::DeviceTape);

#[pymethods]
impl DeviceTape {
    /// Steps recorded.
    fn __len__(&self) -> usize {
        self.0.len()
    }

    /// Steps that fit.
    #[getter]
    fn horizon(&self) -> usize {
        self.0.horizon()
    }

    /// Forgets all steps and keeps the memory.
    fn clear(&mut self) {
        self.0.clear();
    }
}

/// The adjoint of one step of a task on a device: `DeviceEnv.adjoint` makes it.
#[pyclass(module = "omnidrones", frozen)]
pub struct DeviceAdjoint {
    adjoint: gpu::DeviceAdjoint,
    n_env: usize,
    device: gpu::Device,
}

#[pymethods]
impl DeviceAdjoint {
    /// Numbers that go from step to step: physics, memory of the task, delay line, history.
    #[getter]
    fn n_carried(&self) -> usize {
        self.adjoint.layout().n_carried()
    }

    /// A sweep that begins behind any step of a tape, with nothing carried: see `Adjoint.sweep`.
    #[pyo3(signature = (decay=1.0, clip=f32::INFINITY))]
    fn sweep(&self, decay: f32, clip: f32) -> PyResult<DeviceSweep> {
        let sweep = self.adjoint.sweep(SweepOptions { decay, clip }).or_raise()?;
        Ok(DeviceSweep { sweep, n_env: self.n_env, device: self.device.clone(), held: Vec::new() })
    }
}

/// A reverse sweep over a tape on a device, step by step from the last to the first.
#[pyclass(module = "omnidrones")]
pub struct DeviceSweep {
    sweep: gpu::DeviceSweep,
    n_env: usize,
    device: gpu::Device,
    /// What the last pull may still read.
    held: Vec<Py<PyAny>>,
}

#[pymethods]
impl DeviceSweep {
    /// Begins again behind any step, with nothing carried.
    fn restart(&mut self) -> PyResult<()> {
        self.sweep.restart().or_raise()
    }

    /// Pulls cotangents on the device back through step `t` of a tape and returns those of its actions, [E, A * command], which lie there and
    /// change with the next pull. What they are: see `Sweep.pull`.
    #[pyo3(signature = (
        tape, t, *, observation=None, reward=None, loss=None, central=None, final_observation=None, final_central=None,
        final_carried=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "by name in Python")]
    fn pull(
        &mut self,
        py: Python<'_>,
        tape: &DeviceTape,
        t: usize,
        observation: Option<&Bound<'_, PyAny>>,
        reward: Option<&Bound<'_, PyAny>>,
        loss: Option<&Bound<'_, PyAny>>,
        central: Option<&Bound<'_, PyAny>>,
        final_observation: Option<&Bound<'_, PyAny>>,
        final_central: Option<&Bound<'_, PyAny>>,
        final_carried: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<DeviceArray> {
        let mut held = Vec::new();
        let mut rows = |name: &str, own: Option<&Bound<'_, PyAny>>| {
            own.map(|own| {
                let Given { rows, holder } = given(name, own, &self.device)?;
                held.push(holder);
                Ok::<_, PyErr>(rows)
            })
            .transpose()
        };
        let up = DeviceCotangents {
            observation: rows("observation", observation)?,
            final_observation: rows("final_observation", final_observation)?,
            central: rows("central", central)?,
            final_central: rows("final_central", final_central)?,
            final_carried: rows("final_carried", final_carried)?,
            reward: rows("reward", reward)?,
            loss: rows("loss", loss)?,
        };
        let (sweep, tape) = (&mut self.sweep, &tape.0);
        let rows = py.detach(|| sweep.pull_on(tape, t, &up)).or_raise()?;
        self.held = held;
        Ok(DeviceArray { rows, device: self.device.clone() })
    }

    /// Cotangents of what the environments carried into the last step pulled, a new NumPy array [E, carried]: physics first.
    fn carried<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.rows(py, py.detach(|| self.sweep.carried()).or_raise()?)
    }

    /// Adds to what is carried, a NumPy array [E, carried], between pulls.
    fn add_carried(&mut self, cotangents: &Bound<'_, PyAny>) -> PyResult<()> {
        let [_, n] = crate::arrays::lengths("cotangents", cotangents)?;
        let rows = read::<f32>("cotangents", cotangents, &[self.n_env, n])?;
        self.sweep.add_carried(slice(&rows)?).or_raise()
    }

    /// Gradients by the physical numbers that differ between environments, summed over all steps pulled, a new NumPy array [E, number]; no
    /// columns unless the adjoint was made with parameters.
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.rows(py, py.detach(|| self.sweep.parameters()).or_raise()?)
    }

    /// Gradients that were not finite and became zero, environments times steps.
    #[getter]
    fn dropped(&self, py: Python<'_>) -> PyResult<usize> {
        py.detach(|| self.sweep.dropped()).or_raise()
    }
}

impl DeviceSweep {
    fn rows<'py>(&self, py: Python<'py>, numbers: Vec<f32>) -> PyResult<Bound<'py, PyAny>> {
        let width = numbers.len() / self.n_env;
        array(py, numbers, &[self.n_env, width])
    }
}
