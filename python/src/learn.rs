//! Training, evaluation and policies, from Python.

use crate::arrays::{array, flags, read, slice, slice_mut, write};
use crate::batch::{config_of, threads};
use crate::error::{OrRaise, interruptible};
use crate::law::Choice;
use crate::settings;
use crate::task;
use omnidrones::error::Error;
use omnidrones::rl::nn::Head;
use omnidrones::rl::recipes::recipes_of;
use omnidrones::rl::{self, TrainConfig, Trainer};
use omnidrones::tasks::registry::{self, TaskEntry};
use omnidrones::tasks::{self, Autoreset, Env, EnvConfig, EpisodeActivity, EpisodeRows, Evaluation, Spec, Statistics};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString, PyTuple};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Mutex;
use toml::Table;

/// What was learnt: a network over one agent's observation. Actions are the most likely ones.
#[pyclass(module = "omnidrones")]
pub struct Policy {
    pub policy: rl::Policy,
    pub task: String,
    /// How it was trained.
    pub config: TrainConfig,
}

#[pymethods]
impl Policy {
    /// The task that it was trained for.
    #[getter]
    fn task(&self) -> &str {
        &self.task
    }

    /// Settings of the environments that it was trained in: `make(policy.task, 1, config=policy.config, stagger=False)` shows what it
    /// expects. Learners stagger first episodes, which then end early.
    #[getter]
    fn config<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        settings::dict(py, &Table::try_from(self.config.seen_env()).map_err(crate::error::unexpected)?)
    }

    /// Actions for observations: float32 arrays [..., observation] to [..., action].
    #[pyo3(signature = (observation, out=None))]
    fn __call__<'py>(
        &mut self,
        py: Python<'py>,
        observation: &Bound<'py, PyAny>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (n_in, n_out) = (self.policy.actor().n_observation(), self.policy.actor().n_action());
        let mut shape: Vec<usize> = observation.getattr("shape").and_then(|s| s.extract()).unwrap_or_default();
        if shape.last() != Some(&n_in) {
            let remedy = "The last axis is one agent's observation.";
            return Err(Error::value("shape of observation", format!("{shape:?}"), format!("[..., {n_in}]"), remedy))
                .or_raise();
        }
        let rows = read::<f32>("observation", observation, &shape)?;
        if let Some(last) = shape.last_mut() {
            *last = n_out;
        }
        let out = match out {
            Some(out) => out.clone(),
            None => array(py, vec![0.0_f32; shape.iter().product()], &shape)?,
        };
        let mut actions = write("out", &out, &shape)?;
        let (policy, x, a) = (&mut self.policy, slice(&rows)?, slice_mut(&mut actions)?);
        py.detach(|| policy.act(x, a)).or_raise()?;
        Ok(out)
    }

    /// Episodes begin anew: what a policy with memory remembers of the rows of its last call is forgotten, or of the environments for
    /// which `begins` is true.
    #[pyo3(signature = (begins=None))]
    fn reset(&mut self, begins: Option<Vec<bool>>) -> PyResult<()> {
        match begins {
            None => self.policy.reset(),
            Some(begins) => {
                let begins: Vec<u8> = begins.into_iter().map(u8::from).collect();
                self.policy.forget(&begins).or_raise()?;
            }
        }
        Ok(())
    }

    /// All parameters, a new float32 array: those of the network, then those of the distribution over its outputs.
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let numbers = self.policy.parameters().to_vec();
        let n = numbers.len();
        array(py, numbers, &[n])
    }

    /// Weights by name, new float32 arrays: "0.weight" [out, in], "0.bias" [out], per layer, as PyTorch has them; "log_std" where
    /// actions are continuous and drawn. Where every agent has its own, "agent0." and so on stands before the name.
    fn weights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (actor, dict) = (self.policy.actor(), PyDict::new(py));
        for k in 0..actor.n_set() {
            let (network, extra) = actor.set(self.policy.parameters(), k);
            let of = if actor.n_set() == 1 { String::new() } else { format!("agent{k}.") };
            for part in actor.mlp.parts(network) {
                dict.set_item(format!("{of}{}", part.name), array(py, part.data, &part.shape)?)?;
            }
            if matches!(actor.head, Head::Gaussian { .. }) && !extra.is_empty() {
                dict.set_item(format!("{of}log_std"), array(py, extra.to_vec(), &[extra.len()])?)?;
            }
        }
        Ok(dict)
    }

    /// Pickles hold parameters, statistics and settings.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let restore = py.import("omnidrones._core")?.getattr("_restore_policy")?;
        let statistics = self.policy.statistics().map(|s| (s.count, s.mean.clone(), s.variance.clone()));
        let config = self.config.to_toml().or_raise()?;
        let record = task::record_of(py, registry::by_name(&self.task).or_raise()?, &self.config.env)?;
        Ok((restore, (&self.task, config, self.parameters(py)?, statistics, record).into_pyobject(py)?))
    }

    fn __repr__(&self) -> String {
        format!("Policy(task='{}', parameters={})", self.task, self.policy.parameters().len())
    }
}

/// What `Policy.__reduce__` took apart.
#[pyfunction]
#[pyo3(signature = (task, config, parameters, statistics, record=None))]
pub fn _restore_policy(
    task: String,
    config: &str,
    parameters: &Bound<'_, PyAny>,
    statistics: Option<(f64, Vec<f64>, Vec<f64>)>,
    record: Option<&[u8]>,
) -> PyResult<Policy> {
    record.map(task::_register_record).transpose()?;
    let config = TrainConfig::from_toml(config, "pickled settings").or_raise()?;
    let env = Env::make(&task, &EnvConfig { n_env: 1, ..config.seen_env() }).or_raise()?;
    let actor = config.algorithm.actor(env.spec()).or_raise()?;
    let rows = read::<f32>("parameters", parameters, &[actor.n_parameter()])?;
    let statistics = statistics.map(|(count, mean, variance)| Statistics { count, mean, variance });
    let policy = rl::Policy::new(actor, slice(&rows)?.to_vec(), statistics, env.spec()).or_raise()?;
    Ok(Policy { policy, task, config })
}

/// How far a run is, after an update: what `watch` of `train` sees.
#[pyclass(module = "omnidrones", frozen, get_all)]
pub struct Progress {
    /// Updates done.
    update: u64,
    /// Updates after which it ends.
    budget: u64,
    /// Steps of environments.
    env_steps: u64,
    /// Time spent training, s.
    seconds: f64,
    /// What was minimised, before the update.
    loss: f64,
    /// Mean reward of a step.
    reward: f64,
    /// The newest line of the log by name, or None.
    line: Option<Py<PyDict>>,
    /// The newest evaluation by name, or None.
    evaluation: Option<Py<PyDict>>,
}

/// What a training run came to.
#[pyclass(module = "omnidrones", frozen, get_all)]
pub struct Run {
    /// Ready to fly.
    policy: Py<Policy>,
    /// Of the policy, by name: "success", "return_mean", "crashed", "final_error".
    evaluation: Py<PyDict>,
    /// Columns of the log by name, float64 arrays [line]; what a line lacks is NaN.
    curve: Py<PyDict>,
    /// Updates done.
    updates: u64,
    /// Steps of environments.
    env_steps: u64,
    /// Time spent training, s, without evaluations.
    seconds: f64,
    /// Whether `watch` stopped it before its end.
    stopped: bool,
    /// The newest checkpoint; None for a run without a folder.
    checkpoint: Option<PathBuf>,
}

#[pymethods]
impl Run {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let success: f64 = self.evaluation.bind(py).as_any().get_item("success")?.extract()?;
        Ok(format!("Run(updates={}, success={success:.3}, seconds={:.1})", self.updates, self.seconds))
    }
}

fn figures<'py>(py: Python<'py>, evaluation: &Evaluation) -> PyResult<Bound<'py, PyDict>> {
    settings::dict(py, &Table::try_from(evaluation).map_err(crate::error::unexpected)?)
}

fn told<'py>(py: Python<'py>, line: &rl::log::Line) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    line.iter().try_for_each(|(name, x)| dict.set_item(name, x))?;
    Ok(dict)
}

fn columns<'py>(py: Python<'py>, curve: &[rl::log::Line]) -> PyResult<Bound<'py, PyDict>> {
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in curve.iter().flat_map(rl::log::Line::iter) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let dict = PyDict::new(py);
    for name in names {
        let column: Vec<f64> = curve.iter().map(|line| line.get(name).unwrap_or(f64::NAN)).collect();
        let n = column.len();
        dict.set_item(name, array(py, column, &[n])?)?;
    }
    Ok(dict)
}

/// Trains a policy for a task, from random weights or from where a folder stopped, and evaluates it on starts that training
/// never saw.
///
/// Parameters
/// ----------
/// name : str or Task
///     A task, or a class of your own.
/// config : dict or path or str, optional
///     Settings of the run over the task's recipe, as `omnidrones train TASK --toml` prints them: a dict, a TOML file, or TOML.
/// algorithm : str, optional
///     "apg", "shac", "ppo", "sac", "td3", "dqn", "dagger" or a variant such as "qmix"; the task's recipe knows which by default.
/// seed : int, optional
///     Of all that is drawn, up to 2^63 - 1.
/// threads : int, optional
///     All cores by default. The bits do not depend on it.
/// folder : path, optional
///     Where the run is kept; with `resume` it goes on from the newest whole checkpoint there, to the same bits.
/// watch : callable, optional
///     Called with a `Progress` after every update; False stops the run behind it. An exception ends it and is raised.
/// **settings
///     As in `config`, by name: `evaluate={"envs": 64}`, `apg={"updates": 100}`, and those of the environment: `dt=0.01`, `horizon=200`.
#[pyfunction]
#[pyo3(signature = (
    name, /, config=None, *, algorithm=None, seed=None, threads=None, folder=None, resume=false, watch=None, **settings
))]
#[expect(clippy::too_many_arguments, reason = "by name in Python")]
pub fn train(
    py: Python<'_>,
    name: &Bound<'_, PyAny>,
    config: Option<&Bound<'_, PyAny>>,
    algorithm: Option<&str>,
    seed: Option<i64>,
    threads: Option<usize>,
    folder: Option<PathBuf>,
    resume: bool,
    watch: Option<Py<PyAny>>,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<Run> {
    let (entry, settings) = task::entry_of(name, settings)?;
    let name = entry.name;
    let mut layers = settings::layers(entry, config, settings.as_ref(), &TrainConfig::keys())?;
    if let Some(seed) = seed {
        let seed = omnidrones::layers::at("seed", seed.into());
        layers.push(omnidrones::layers::Layer::of_table("seed", seed));
    }
    let mut config = TrainConfig::layered(name, algorithm, &layers).or_raise()?;
    config.env = task::pinned(py, entry, config.env)?;
    let threads = self::threads(threads)?;
    let kept = config.clone();
    let outcome = interruptible(py, |said| {
        let mut trainer = Trainer::new(entry.name, config, threads)?;
        if let Some(folder) = folder {
            trainer = trainer.in_folder(folder, resume)?;
        }
        trainer.run(&mut |progress| {
            let goes_on = said.hear(|py| match &watch {
                None => Ok(true),
                Some(watch) => {
                    let line = progress.line.map(|(line, _)| told(py, line).map(Bound::unbind)).transpose()?;
                    let evaluation = progress.evaluation.map(|e| figures(py, e).map(Bound::unbind)).transpose()?;
                    let seen = Progress {
                        update: progress.update,
                        budget: progress.budget,
                        env_steps: progress.env_steps,
                        seconds: progress.seconds,
                        loss: progress.last.loss,
                        reward: progress.last.reward,
                        line,
                        evaluation,
                    };
                    let answer = watch.call1(py, (seen,))?;
                    Ok(!answer.bind(py).is(pyo3::types::PyBool::new(py, false)))
                }
            });
            if goes_on == Some(true) { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        })
    })?;
    let policy = Policy {
        policy: outcome.policy,
        task: entry.name.into(),
        config: TrainConfig { task: entry.name.into(), ..kept },
    };
    Ok(Run {
        policy: Py::new(py, policy)?,
        evaluation: figures(py, &outcome.evaluation)?.unbind(),
        curve: columns(py, &outcome.curve)?.unbind(),
        updates: outcome.updates,
        env_steps: outcome.env_steps,
        seconds: outcome.seconds,
        stopped: outcome.stopped,
        checkpoint: outcome.checkpoint,
    })
}

/// Flies one episode from each of so many starts and tells how well: by name "success" with "success_interval" (95 %, Wilson),
/// "crashed", "return_mean", "final_error", "ends", "activity" of the commands of rotors, and more.
///
/// Parameters
/// ----------
/// policy : Policy or callable
///     A callable gets the observations, a float32 array [E, A, observation] that is reused, and returns actions
///     [E, A, action].
/// name : str, optional
///     A task; that of a `Policy` by default, in the environments that it was trained in.
/// num_envs : int
///     Starts, one episode each.
/// seed : int
///     Of the starts; 1000003 are those that `train` evaluates on.
/// config, **settings
///     Of the environments, as in `make`.
#[pyfunction]
#[pyo3(signature = (policy, name=None, *, num_envs=1024, seed=1_000_003, threads=None, config=None, **settings))]
#[expect(clippy::too_many_arguments, reason = "by name in Python")]
pub fn evaluate<'py>(
    py: Python<'py>,
    policy: &Bound<'py, PyAny>,
    name: Option<&Bound<'py, PyAny>>,
    num_envs: usize,
    seed: u64,
    threads: Option<usize>,
    config: Option<&Bound<'py, PyAny>>,
    settings: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyDict>> {
    let whole = Shard { num_envs, first_environment: 0, seed };
    let (rows, spec) = flown(py, policy, name, &whole, threads, config, settings)?;
    figures(py, &rows.evaluation(&spec))
}

/// Which starts are flown.
struct Shard {
    num_envs: usize,
    first_environment: u64,
    seed: u64,
}

impl Shard {
    /// One episode per environment from its starts, whatever training does.
    fn env(&self, entry: &TaskEntry, config: EnvConfig) -> Result<Env, Error> {
        entry.env(&EnvConfig {
            n_env: self.num_envs,
            seed: self.seed,
            first_environment: self.first_environment,
            autoreset: Autoreset::Disabled,
            ..config.whole_episodes()
        })
    }
}

/// The task of an evaluation and its environments: those that a `Policy` was trained in, unless others are given.
fn judged(
    policy: &Bound<'_, PyAny>,
    name: Option<&Bound<'_, PyAny>>,
    config: Option<&Bound<'_, PyAny>>,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<(&'static TaskEntry, EnvConfig)> {
    if policy.is_instance_of::<PyString>() {
        return Err(pyo3::exceptions::PyTypeError::new_err(format!(
            "policy is the text '{policy}', but it must be a Policy or a callable. Pass omnidrones.load_policy('{policy}')."
        )));
    }
    let own = policy.cast::<Policy>().ok().map(|own| own.try_borrow()).transpose()?;
    let known = own.as_ref().map(|own| PyString::new(policy.py(), &own.task).into_any());
    let Some(task) = name.or(known.as_ref()) else {
        return Err(pyo3::exceptions::PyTypeError::new_err("name is missing: a callable does not know its task."));
    };
    let (entry, settings) = task::entry_of(task, settings)?;
    let given = config.is_some() || settings.as_ref().is_some_and(|settings| !settings.is_empty());
    let config = match own {
        // a class is meant as it is now
        Some(own) if !given && name.is_some_and(|name| !name.is_instance_of::<PyString>()) => {
            EnvConfig { task_record: String::new(), ..own.config.seen_env() }
        }
        Some(own) if !given => own.config.seen_env(),
        _ => config_of(entry, None, config, None, settings.as_ref())?,
    };
    Ok((entry, task::pinned(policy.py(), entry, config)?))
}

/// Flies the episodes of a shard.
fn flown(
    py: Python<'_>,
    policy: &Bound<'_, PyAny>,
    name: Option<&Bound<'_, PyAny>>,
    shard: &Shard,
    threads: Option<usize>,
    config: Option<&Bound<'_, PyAny>>,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<(EpisodeRows, Spec)> {
    let threads = self::threads(threads)?;
    let (entry, config) = judged(policy, name, config, settings)?;
    let mut env = shard.env(entry, config).or_raise()?;
    env.set_threads(threads.clone());
    let spec = env.spec().clone();
    if let Ok(own) = policy.cast::<Policy>() {
        let mut own = own.try_borrow_mut()?;
        let policy = &mut own.policy;
        policy.fits(&spec).or_raise()?;
        policy.statistics().map_or(Ok(()), |known| env.set_statistics(known.clone())).or_raise()?;
        policy.set_threads(threads);
        policy.reset();
        let rows = interruptible(py, |said| {
            let act = &mut |_: &Env, out: &tasks::Buffers, actions: &mut [f32]| {
                said.or_stop(|_| Ok(()))?;
                policy.act(&out.observation, actions)
            };
            EpisodeRows::fly(&mut env, act, &mut |_| ())
        })?;
        return Ok((rows, spec));
    }
    let seen = [spec.n_env, spec.n_agent, spec.n_observation];
    let done = [spec.n_env, spec.n_agent, spec.action.len()];
    let observation = array(py, vec![0.0_f32; seen.iter().product()], &seen)?.unbind();
    let policy = policy.clone().unbind();
    let rows = interruptible(py, |said| {
        let act = &mut |_: &Env, out: &tasks::Buffers, actions: &mut [f32]| {
            said.or_stop(|py| {
                let observation = observation.bind(py);
                slice_mut(&mut write("observation", observation, &seen)?)?.copy_from_slice(&out.observation);
                let answer = policy.bind(py).call1((observation,))?;
                actions.copy_from_slice(slice(&read("actions of the policy", &answer, &done)?)?);
                Ok(())
            })
        };
        EpisodeRows::fly(&mut env, act, &mut |_| ())
    })?;
    Ok((rows, spec))
}

/// Rows of [`EpisodeRows`] as arrays, which travel.
type Told<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>);

/// The episodes of a shard of an evaluation, for `_evaluation`.
#[pyfunction]
#[pyo3(signature = (policy, name, num_envs, first_environment, *, seed=1_000_003, threads=None, config=None, **settings))]
#[expect(clippy::too_many_arguments, reason = "by name in Python")]
pub fn _fly_shard<'py>(
    py: Python<'py>,
    policy: &Bound<'py, PyAny>,
    name: Option<&Bound<'py, PyAny>>,
    num_envs: usize,
    first_environment: u64,
    seed: u64,
    threads: Option<usize>,
    config: Option<&Bound<'py, PyAny>>,
    settings: Option<&Bound<'py, PyDict>>,
) -> PyResult<Told<'py>> {
    let shard = Shard { num_envs, first_environment, seed };
    let (rows, spec) = flown(py, policy, name, &shard, threads, config, settings)?;
    let n = [num_envs];
    let info = array(py, rows.info, &[num_envs, spec.info.len()])?;
    let activity = rows.activity.iter().flat_map(|a| [a.change, a.last_second, a.power[0], a.power[1]]).collect();
    let activity = array(py, activity, &[num_envs, 4])?;
    Ok((info, array(py, rows.terminated, &n)?, array(py, rows.error, &n)?, array(py, rows.near, &n)?, activity))
}

/// What `evaluate` tells, of shards in the order of their environments.
#[pyfunction]
#[pyo3(signature = (shards, policy, name=None, *, config=None, **settings))]
pub fn _evaluation<'py>(
    py: Python<'py>,
    shards: Vec<Told<'py>>,
    policy: &Bound<'py, PyAny>,
    name: Option<&Bound<'py, PyAny>>,
    config: Option<&Bound<'py, PyAny>>,
    settings: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (entry, config) = judged(policy, name, config, settings)?;
    let env = Shard { num_envs: 1, first_environment: 0, seed: 0 }.env(entry, config).or_raise()?;
    let (mut rows, width) = (EpisodeRows::default(), env.spec().info.len());
    for (info, terminated, error, near, activity) in &shards {
        let n = terminated.len()?;
        let activity = read("activity", activity, &[n, 4])?;
        let of = |a: &[f64]| EpisodeActivity { change: a[0], last_second: a[1], power: [a[2], a[3]] };
        rows.join(EpisodeRows {
            info: slice(&read("info", info, &[n, width])?)?.to_vec(),
            terminated: flags("terminated", terminated, n)?,
            error: slice(&read("error", error, &[n])?)?.to_vec(),
            near: flags("near", near, n)?,
            activity: slice(&activity)?.chunks_exact(4).map(of).collect(),
        });
    }
    figures(py, &rows.evaluation(env.spec()))
}

/// Names of the algorithms that have a recipe for a task, the usual one first.
#[pyfunction]
pub fn recipes(task: &Bound<'_, PyAny>) -> PyResult<Vec<&'static str>> {
    Ok(recipes_of(task::entry_of(task, None)?.0.name))
}

/// The policy of a run's folder, or of one of its checkpoints.
///
/// Raises `FileNotFoundError` where there is none, `ValueError` for damaged files.
#[pyfunction]
pub fn load_policy(py: Python<'_>, path: PathBuf) -> PyResult<Policy> {
    let saved = py.detach(|| rl::load_policy(&path)).or_raise()?;
    Ok(Policy { policy: saved.policy, task: saved.manifest.task, config: saved.config })
}

/// The library's own controllers as a policy: what learners have to beat. One per environment in rotor mode, which sees the true
/// state; `controller(env)` gives actions [E, A, action]. With a `name` of the table of controllers, as "mpc", that one flies in place
/// of the usual one, where it is made for what flies; or a `ControlLaw`, which knows the nominal numbers of what flies. All environments are flown at once on the environment's threads.
#[pyclass(module = "omnidrones", frozen)]
pub struct Controller(Mutex<tasks::Baseline>);

#[pymethods]
impl Controller {
    #[new]
    #[pyo3(signature = (env, name=None))]
    fn new(py: Python<'_>, env: &crate::batch::VecEnv, name: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let env = &env.env;
        let choice = Choice::of(name, env.robot().plant(), false)?;
        let made = py.detach(|| match &choice {
            Choice::Default => tasks::Baseline::new(env),
            Choice::Named(name) => tasks::Baseline::with_controller(env, name),
            Choice::Written(law) => tasks::Baseline::with_law(env, law),
        });
        Ok(Self(Mutex::new(made.or_raise()?)))
    }

    /// What flies, in one word.
    #[getter]
    fn name(&self) -> PyResult<String> {
        Ok(self.lock()?.name().to_string())
    }

    /// Actions of all agents for the state as it is, a new float32 array [E, A, action]. `reset` of an environment needs a new
    /// controller, or `forget`.
    fn __call__<'py>(&self, py: Python<'py>, env: &crate::batch::VecEnv) -> PyResult<Bound<'py, PyAny>> {
        let spec = env.env.spec();
        let shape = [spec.n_env, spec.n_agent, spec.action.len()];
        let mut actions = vec![0.0_f32; shape.iter().product()];
        let env = &env.env;
        // the lock is let go before the interpreter is waited for
        py.detach(|| self.lock()?.act(env, &mut actions).or_raise())?;
        array(py, actions, &shape)
    }

    /// Makes a new controller for one environment at the next call: where an episode began.
    fn forget(&self, environment: usize) -> PyResult<()> {
        self.lock()?.forget(environment);
        Ok(())
    }
}

impl Controller {
    fn lock(&self) -> PyResult<std::sync::MutexGuard<'_, tasks::Baseline>> {
        let busy = || {
            pyo3::exceptions::PyRuntimeError::new_err("the controller flies in another thread. Make one per thread.")
        };
        self.0.try_lock().map_err(|_| busy())
    }
}
