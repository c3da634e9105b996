//! A task that is a class in Python: asked once for everything, on the thread that makes environments of it.

use super::begin::{Pad, Start};
use super::out::{Ends, Lent, Loss, Writer};
use super::robot::PyRobot;
use super::shown::View;
use crate::error::OrRaise;
use crate::number::{mask, number, traces};
use crate::settings;
use omnidrones::autodiff::{Array, Mask, Scalar, Trace, TraceMask};
use omnidrones::dynamics::scene::Scene;
use omnidrones::error::{Error, Result};
use omnidrones::rl::TrainConfig;
use omnidrones::tasks::registry::{self, TaskEntry, TaskSource};
use omnidrones::tasks::settings::given;
use omnidrones::tasks::written::{
    Base, OwnTask, PHASES, StartPad, TaskAuthor, TaskRecord, keep_record, register_record,
};
use omnidrones::tasks::{self, EnvConfig, Field, Robot, Setting, SettingDomain, Success, Task};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyMapping};
use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

fn locked<T>(own: &Mutex<T>) -> MutexGuard<'_, T> {
    own.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What speaks against a task in Python: an exception of its own, or of the library.
pub struct Fault(PyErr);

impl From<Error> for Fault {
    fn from(error: Error) -> Self {
        Self(Err::<(), _>(error).or_raise().unwrap_err())
    }
}

/// An object with the methods of a task.
struct PythonTask {
    object: Py<PyAny>,
    base: Option<Box<dyn Task>>,
    robot: Arc<Robot>,
    horizon: usize,
    success_rule: Success,
    scene: Scene,
    /// Phases that it has.
    phases: Vec<&'static str>,
    goal: Mutex<Arc<Vec<Field>>>,
    kept: Mutex<Option<Arc<Vec<Field>>>>,
    fault: Mutex<Option<PyErr>>,
}

impl PythonTask {
    fn has(&self, phase: &str) -> bool {
        self.phases.contains(&phase)
    }

    /// Does something with Python, unless it has failed already; without, `none` stands for what it gives.
    fn ask<R>(&self, none: impl FnOnce() -> R, ask: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<R>) -> R {
        if locked(&self.fault).is_some() {
            return none();
        }
        Python::attach(|py| match ask(py, self.object.bind(py)) {
            Ok(result) => result,
            Err(fault) => {
                *locked(&self.fault) = Some(fault);
                none()
            }
        })
    }

    fn shown<'py>(&self, py: Python<'py>, view: &tasks::View<'_>) -> PyResult<Bound<'py, View>> {
        let (goal, kept) = (locked(&self.goal).clone(), locked(&self.kept).clone());
        Bound::new(py, View::of(view, &self.robot, &goal, &kept))
    }

    /// A phase that writes.
    fn writes(&self, phase: &'static str, view: &tasks::View<'_>, agent: Option<usize>, out: &mut tasks::Writer) {
        let written = self.ask(tasks::Writer::default, |py, own| {
            let (view, writer) = (self.shown(py, view)?, Bound::new(py, Writer(Lent::new(tasks::Writer::default())))?);
            let answer = match agent {
                None => own.call_method1(phase, (view, &writer))?,
                Some(agent) => own.call_method1(phase, (view, agent, &writer))?,
            };
            nothing_returned(phase, &answer)?;
            let written = writer.get().0.take().unwrap_or_default();
            if phase == "reward" && written.named().is_empty() {
                let remedy = "Write terms.term(name, formula, bound, number), once per summand.";
                return Err(Error::value("summands of 'reward'", "none", "one or more", remedy)).or_raise();
            }
            Ok(written)
        });
        *out = written;
    }

    /// Limits of the rule of success, of the figures.
    fn keeps_limits(&self, view: &tasks::View<'_>) -> TraceMask {
        let mut figures = tasks::Writer::default();
        self.metrics(view, &mut figures);
        let fields = figures.named();
        let numbers = figures.into_numbers();
        if fields.iter().any(|field| field.size != 1) {
            return never(); // which the library refuses, by name
        }
        let names: Vec<String> = fields.into_iter().map(|field| field.name).collect();
        let mut all: Option<TraceMask> = None;
        for limit in &self.success_rule.limits {
            let Some(k) = names.iter().position(|name| *name == limit.metric) else { continue };
            for mask in [
                limit.below.is_finite().then(|| numbers[k].lt(limit.below)),
                limit.above.is_finite().then(|| Trace::from(limit.above).lt(numbers[k])),
            ] {
                all = match (all, mask) {
                    (Some(a), Some(b)) => Some(a.and(b)),
                    (a, b) => a.or(b),
                };
            }
        }
        all.unwrap_or_else(never)
    }
}

/// Refuses what a method returns that writes: it would be lost.
fn nothing_returned(phase: &str, answer: &Bound<'_, PyAny>) -> PyResult<()> {
    if answer.is_none() {
        return Ok(());
    }
    let call = match phase {
        "reward" => "terms.term(name, formula, bound, number)",
        "ends" => "ends.when(name, condition, mask)",
        "loss" => "loss.add(formula, number)",
        "metrics" => "out.metric(name, unit, number)",
        _ => "out.field(name, unit, meaning, numbers)",
    };
    let kind = answer.get_type().name()?;
    Err(PyTypeError::new_err(format!("'{phase}' returned a {kind}, but what it returns is not read. Write {call}.")))
}

fn never() -> TraceMask {
    Trace::one().lt(Trace::zero())
}

impl Task for PythonTask {
    fn robot(&self) -> &Robot {
        &self.robot
    }
    fn horizon(&self) -> usize {
        self.horizon
    }
    fn n_agent(&self) -> usize {
        self.base.as_ref().map_or(self.robot.drones().len(), |base| base.n_agent())
    }
    fn scene(&self) -> Scene {
        self.scene.clone()
    }
    fn start(&self, _: &mut tasks::Start<'_>) {}
    fn ideal(&self, start: &mut tasks::Start<'_>) {
        self.base.iter().for_each(|base| base.ideal(start));
    }
    fn disturb(&self, view: &tasks::View<'_>, tree: usize) -> [Trace; 9] {
        if !self.has("disturb") {
            return [Trace::zero(); 9];
        }
        self.ask(
            || [Trace::zero(); 9],
            |py, own| {
                let answer = own.call_method1("disturb", (self.shown(py, view)?, tree))?;
                Ok(traces("what 'disturb' returns", &answer, Some(&[9]))?.array(0))
            },
        )
    }
    fn remember(&self, view: &tasks::View<'_>, task_state: &mut tasks::Writer) {
        match &self.base {
            Some(base) if !self.has("remember") => base.remember(view, task_state),
            _ if self.has("remember") => {
                self.writes("remember", view, None, task_state);
                *locked(&self.kept) = Some(Arc::new(task_state.named()));
            }
            _ => (),
        }
    }
    fn observe(&self, view: &tasks::View<'_>, agent: usize, out: &mut tasks::Writer) {
        self.writes("observe", view, Some(agent), out);
    }
    fn central(&self, view: &tasks::View<'_>, out: &mut tasks::Writer) {
        if self.has("central") {
            self.writes("central", view, None, out);
        }
    }
    fn reward(&self, view: &tasks::View<'_>, terms: &mut tasks::Writer) {
        self.writes("reward", view, None, terms);
    }
    fn ends(&self, view: &tasks::View<'_>, ends: &mut tasks::Ends) {
        *ends = self.ask(tasks::Ends::default, |py, own| {
            let (view, lent) = (self.shown(py, view)?, Bound::new(py, Ends(Lent::new(tasks::Ends::default())))?);
            nothing_returned("ends", &own.call_method1("ends", (view, &lent))?)?;
            Ok(lent.get().0.take().unwrap_or_default())
        });
    }
    fn metrics(&self, view: &tasks::View<'_>, out: &mut tasks::Writer) {
        if self.has("metrics") {
            self.writes("metrics", view, None, out);
        }
    }
    fn success(&self, view: &tasks::View<'_>) -> TraceMask {
        if !self.has("success") {
            return self.keeps_limits(view);
        }
        self.ask(never, |py, own| {
            mask("what 'success' returns", &own.call_method1("success", (self.shown(py, view)?,))?)
        })
    }
    fn loss(&self, view: &tasks::View<'_>, loss: &mut tasks::Loss) {
        if !self.has("loss") {
            let mut terms = tasks::Writer::default();
            self.reward(view, &mut terms);
            let sum = terms.into_numbers().into_iter().fold(Trace::zero(), |sum, term| sum - term);
            return loss.add("−reward", sum);
        }
        *loss = self.ask(tasks::Loss::default, |py, own| {
            let (view, lent) = (self.shown(py, view)?, Bound::new(py, Loss(Lent::new(tasks::Loss::default())))?);
            nothing_returned("loss", &own.call_method1("loss", (view, &lent))?)?;
            Ok(lent.get().0.take().unwrap_or_default())
        });
    }
}

impl TaskAuthor for PythonTask {
    type Fault = Fault;

    fn task(&self) -> &dyn Task {
        self
    }

    fn writes(&self, phase: &str) -> bool {
        // what an own reward leaves of the base's loss would ask for something else
        self.base.is_none() || self.has(phase) || phase == "loss" && self.has("reward")
    }

    fn begin(&self, phase: &str, mut pad: StartPad) -> StartPad {
        if self.base.is_some() && !self.has(phase) {
            pad.with(&self.robot, |start| self.ideal(start));
            *locked(&self.goal) = Arc::new(pad.fields());
            return pad;
        }
        if !self.has(phase) {
            return pad;
        }
        let fields = locked(&self.goal).clone();
        let lent = Arc::new(Pad { robot: self.robot.clone(), fields, is_event: phase == "event", pad: Lent::new(pad) });
        self.ask(|| (), |py, own| own.call_method1(phase, (Bound::new(py, Start(lent.clone()))?,)).map(drop));
        let pad = lent.pad.take();
        let pad = pad.unwrap_or_else(|| unreachable!("what was lent is there"));
        if phase == "ideal" {
            *locked(&self.goal) = Arc::new(pad.fields());
        }
        pad
    }

    fn fault(&self) -> Option<Fault> {
        locked(&self.fault).take().map(Fault)
    }

    fn place_scene(&self, goal: &[Trace], placement: &mut [Trace]) -> bool {
        self.ask(
            || false,
            |py, own| {
                if self.base.is_some() || !own.hasattr("place_scene")? {
                    return Ok(false);
                }
                let answer = own.call_method1("place_scene", (number(py, goal, &[goal.len()])?,))?;
                let n = placement.len();
                placement.copy_from_slice(&traces("what 'place_scene' returns", &answer, Some(&[n]))?);
                Ok(true)
            },
        )
    }

    fn reference(&self, view: &tasks::View<'_>) -> Option<(serde_json::Value, Vec<Trace>)> {
        self.ask(
            || None,
            |py, own| {
                if self.base.is_some() || !own.hasattr("reference")? {
                    return Ok(None);
                }
                let answer = own.call_method1("reference", (self.shown(py, view)?,))?;
                if answer.is_none() {
                    return Ok(None);
                }
                let mut numbers = Vec::new();
                let template = template("reference", &answer, &mut numbers)?;
                Ok(Some((template, numbers)))
            },
        )
    }

    fn starts_on_host(&self) -> bool {
        self.ask(
            || false,
            |py, own| match own.getattr_opt(pyo3::intern!(py, "start_on_host"))? {
                None => Ok(false),
                Some(own) => own.extract(),
            },
        )
    }
}

/// Data of which some numbers record: those by their places.
fn template(name: &str, given: &Bound<'_, PyAny>, numbers: &mut Vec<Trace>) -> PyResult<serde_json::Value> {
    use serde_json::Value;
    if crate::number::is_number(given)? {
        let own = traces(name, given, None)?;
        let places: Vec<Value> = own
            .into_iter()
            .map(|own| {
                numbers.push(own);
                serde_json::json!({ "number": numbers.len() - 1 })
            })
            .collect();
        let single = given.getattr("ndim")?.extract::<usize>()? == 0;
        return Ok(if single { places[0].clone() } else { Value::Array(places) });
    }
    if let Ok(mapping) = given.cast::<PyMapping>() {
        let mut all = serde_json::Map::new();
        for pair in mapping.items()?.iter() {
            let (key, own): (String, Bound<'_, PyAny>) = pair.extract()?;
            let place = format!("{name}.{key}");
            all.insert(key, template(&place, &own, numbers)?);
        }
        return Ok(Value::Object(all));
    }
    if given.is_instance_of::<pyo3::types::PyList>() || given.is_instance_of::<pyo3::types::PyTuple>() {
        let items = given.try_iter()?.enumerate();
        let items = items.map(|(i, own)| template(&format!("{name}[{i}]"), &own?, numbers));
        return Ok(Value::Array(items.collect::<PyResult<_>>()?));
    }
    let value = settings::value(name, given)?.ok_or_else(|| PyTypeError::new_err(format!("{name} is None.")))?;
    serde_json::to_value(value).map_err(crate::error::unexpected)
}

/// A class of tasks, or changes of a task of the library.
pub struct PythonSource {
    name: String,
    class: Py<PyAny>,
    /// Of the library, whose phases the object changes.
    base: Option<&'static TaskEntry>,
    settings: Vec<Setting>,
    defaults: toml::Table,
    description: String,
    about: String,
    /// By what the class was shown; the newest last.
    known: Mutex<Vec<(String, Arc<TaskRecord>)>>,
}

thread_local! {
    /// What is being recorded, from the outermost on: name and what the class is shown.
    static RECORDING: RefCell<Vec<(String, String)>> = const { RefCell::new(Vec::new()) };
}

/// Most records of a class that are kept.
const MOST_KNOWN: usize = 16;

impl PythonSource {
    fn of(name: &str, class: &Bound<'_, PyAny>, base: Option<&'static TaskEntry>) -> PyResult<Self> {
        let text = |key: &str| class.getattr(key).and_then(|own| own.extract::<String>()).unwrap_or_default();
        let settings = match base {
            Some(_) => Vec::new(),
            None => class.call_method0("_settings")?.try_iter()?.map(|own| setting(&own?)).collect::<PyResult<_>>()?,
        };
        let defaults = match class.getattr_opt("defaults")? {
            Some(own) if base.is_none() => settings::table("defaults", own.cast::<PyMapping>()?)?,
            _ => toml::Table::new(),
        };
        let defaults = base.map_or(Ok(defaults), |base| base.default_table().or_raise())?;
        let own = Self {
            name: name.into(),
            class: class.clone().unbind(),
            base,
            settings,
            defaults,
            description: text("description"),
            about: text("about"),
            known: Mutex::default(),
        };
        Ok(own)
    }

    /// What of a configuration the class is shown.
    fn key(&self, config: &EnvConfig) -> Result<String> {
        let settings = match self.base {
            None => format!("{:?}", given(self.settings.clone(), &config.task)?),
            Some(_) => config.task.to_string(),
        };
        Ok(format!("{settings} {:?} {}", config.own_vehicle, config.dt))
    }

    /// The record for a configuration: the one that is known, or one made now.
    fn recorded(&self, py: Python<'_>, config: &EnvConfig) -> PyResult<Arc<TaskRecord>> {
        let key = self.key(config).or_raise()?;
        if let Some((_, known)) = locked(&self.known).iter().find(|(own, _)| *own == key) {
            return Ok(known.clone());
        }
        let within = RECORDING.with_borrow(|all| all.iter().any(|own| own.0 == self.name && own.1 == key));
        if within {
            let remedy = "Make another one there, or none.";
            let told = format!("of '{}' within its own recording", self.name);
            return Err(Error::value("environments", told, "of another task", remedy)).or_raise();
        }
        RECORDING.with_borrow_mut(|all| all.push((self.name.clone(), key.clone())));
        let made = self.record_now(py, config);
        RECORDING.with_borrow_mut(|all| _ = all.pop());
        let record = Arc::new(made?);
        // what is kept with runs and pickles must be what is read again
        TaskRecord::from_bytes(&record.to_bytes().or_raise()?).or_raise()?;
        let mut known = locked(&self.known);
        let oldest = if known.len() >= MOST_KNOWN { Some(known.remove(0)) } else { None };
        known.push((key, record.clone()));
        drop(known);
        drop(oldest);
        Ok(record)
    }

    fn record_now(&self, py: Python<'_>, config: &EnvConfig) -> PyResult<TaskRecord> {
        let class = self.class.bind(py);
        let (object, base, own, robot) = match self.base {
            Some(entry) => {
                let base = entry.task(config).or_raise()?;
                if base.start_on_host().is_some() && (class.hasattr("event")? || class.hasattr("start")?) {
                    let remedy = "Write a class with both: start_on_host = True.";
                    let told = format!("of {}, whose episodes begin on the host", entry.name);
                    return Err(Error::value("'start' or 'event'", told, "of a task that records them", remedy))
                        .or_raise();
                }
                let robot = base.robot().clone();
                (class.clone(), Some(base), Base::Task(entry.name.into()), robot)
            }
            None => {
                let settings = given(self.settings.clone(), &config.task).or_raise()?;
                let object = class.call0()?;
                let numpy = py.import("omnidrones._task")?.getattr("_as_attribute")?;
                for own in &settings {
                    object.setattr(own.key.as_str(), numpy.call1((settings::python(py, &own.value)?,))?)?;
                }
                object.setattr("dt", config.dt)?;
                let robot = object.call_method0("robot")?;
                let robot = robot.cast::<PyRobot>().map_err(|_| {
                    let kind = robot.get_type().name().map_or_else(|_| "?".into(), |kind| kind.to_string());
                    PyTypeError::new_err(format!(
                        "'robot' returned a {kind}, but it must return an omnidrones.Robot: omnidrones.Robot(self.vehicle)."
                    ))
                })?;
                let disturbed = object.hasattr("disturb")?;
                let (robot, source, varied) = robot.get().robot(config, disturbed).or_raise()?;
                if disturbed && robot.disturbances().is_empty() {
                    let remedy = "Take Robot(…), Robot.team or Robot.of_configuration, or leave 'disturb' out.";
                    let told = "on a robot that nothing may act on";
                    return Err(Error::value("'disturb'", told, "on one with disturbances", remedy)).or_raise();
                }
                let horizon = settings.iter().find(|own| own.key == "horizon").map(|own| own.value.clone());
                let Some(horizon) = horizon.as_ref().and_then(|own| usize::try_from(own.as_integer()?).ok()) else {
                    let told = horizon.map_or_else(|| "none".into(), |own| own.to_string());
                    let remedy = "Give the steps of an episode.";
                    return Err(Error::value("horizon", told, "a whole number above 0", remedy)).or_raise();
                };
                let own = OwnTask {
                    robot: source,
                    varied,
                    about: self.about.clone(),
                    horizon,
                    settings,
                    success_rule: success_rule(&object)?,
                    scene: scene(&object)?,
                };
                (object, None, Base::Own(Box::new(own)), robot)
            }
        };
        let mut phases = Vec::new();
        for phase in PHASES {
            if object.getattr_opt(phase)?.is_some_and(|own| !own.is_none()) {
                phases.push(phase);
            }
        }
        let (horizon, success_rule, scene) = match (&own, &base) {
            (Base::Own(own), _) => (own.horizon, own.success_rule.clone(), own.scene.clone()),
            (_, Some(base)) => (base.horizon(), base.success_rule(), base.scene()),
            _ => Default::default(),
        };
        EnvConfig::check_horizon(horizon).or_raise()?;
        // until `remember` was called once
        let kept = Mutex::new(if phases.contains(&"remember") { None } else { Some(Arc::default()) });
        let task = PythonTask {
            object: object.unbind(),
            base,
            robot: Arc::new(robot),
            horizon,
            success_rule,
            scene,
            phases,
            goal: Mutex::default(),
            kept,
            fault: Mutex::default(),
        };
        let mut record = TaskRecord::of(&task, &self.name, own, config).map_err(|Fault(error)| error)?;
        record.description.clone_from(&self.description);
        record.defaults.clone_from(&self.defaults);
        Ok(record)
    }
}

/// A setting of a class: key, default, unit, meaning, domain.
fn setting(given: &Bound<'_, PyAny>) -> PyResult<Setting> {
    let (key, default, unit, meaning, domain): (String, Bound<'_, PyAny>, String, String, String) = given.extract()?;
    let Some(default) = settings::value(&key, &default)? else {
        return Err(PyTypeError::new_err(format!("setting '{key}' has no default. Give it a value.")));
    };
    let domain: SettingDomain = serde_json::from_value(domain.clone().into()).map_err(|_| {
        let known = ["any", "positive", "not_negative", "share", "ordered", "positive_ordered"];
        let known = known.map(String::from).to_vec();
        Err::<(), _>(Error::Unknown { kind: "domain of a setting", name: domain, known }).or_raise().unwrap_err()
    })?;
    Ok(Setting { key, value: default.clone(), default, unit, meaning, domain })
}

fn success_rule(object: &Bound<'_, PyAny>) -> PyResult<Success> {
    let Some(mut own) = object.getattr_opt("success_rule")? else { return Ok(Success::default()) };
    if own.is_callable() {
        own = own.call0()?;
    }
    let text: String = own.call_method0("_json").and_then(|text| text.extract()).map_err(|_| {
        PyTypeError::new_err("success_rule must be an omnidrones.Success: omnidrones.Success().below('error', 0.1).")
    })?;
    serde_json::from_str(&text).map_err(crate::error::unexpected)
}

fn scene(object: &Bound<'_, PyAny>) -> PyResult<Scene> {
    let Some(own) = object.getattr_opt("scene")? else { return Ok(Scene::grounded()) };
    let own = if own.is_callable() { own.call0()? } else { own };
    crate::control::data("scene", Some(own.cast::<PyDict>()?))
}

impl TaskSource for PythonSource {
    fn record(&self, config: &EnvConfig) -> Result<Arc<TaskRecord>> {
        let key = self.key(config)?;
        if let Some((_, known)) = locked(&self.known).iter().find(|(own, _)| *own == key) {
            return Ok(known.clone());
        }
        Python::attach(|py| self.recorded(py, config)).map_err(|raised| {
            Error::value(format!("task {}", self.name), raised, "one that can be recorded", "Mend its class.")
        })
    }
    fn defaults(&self) -> toml::Table {
        self.defaults.clone()
    }
    fn setting_keys(&self) -> Result<Vec<String>> {
        match self.base {
            Some(base) => base.setting_keys(),
            None => Ok(self.settings.iter().map(|own| own.key.clone()).collect()),
        }
    }
    fn description(&self) -> String {
        self.description.clone()
    }
}

/// Classes that are registered.
static SOURCES: Mutex<Option<HashMap<String, Arc<PythonSource>>>> = Mutex::new(None);

/// Makes a class known by a name; with a `base`, an object whose methods take the place of that task's. Its name.
#[pyfunction]
#[pyo3(signature = (name, task, base=None))]
pub fn _register(name: &str, task: &Bound<'_, PyAny>, base: Option<&str>) -> PyResult<&'static str> {
    let base = base.map(registry::by_name).transpose().or_raise()?;
    if let Some(base) = base.filter(|base| base.is_source()) {
        let (told, limit) = (format!("'{}', of which a record is known", base.name), "one of the library, or a class");
        let remedy = "Give the functions to its class.";
        return Err(Error::value("a task whose phases are changed", told, limit, remedy)).or_raise();
    }
    let source = Arc::new(PythonSource::of(name, task, base)?);
    let entry = registry::register_source(name, source.clone()).or_raise()?;
    let old = locked(&SOURCES).get_or_insert_default().insert(entry.name.into(), source);
    drop(old);
    Ok(entry.name)
}

/// Keys of environments and of training: no settings of tasks.
#[pyfunction]
pub fn _setting_keys() -> Vec<String> {
    EnvConfig::keys()
        .into_iter()
        .chain(TrainConfig::keys())
        .chain(["threads", "config", "num_envs", "ring"].map(String::from))
        .collect()
}

/// The name of a task as the registry has it.
#[pyfunction]
pub fn _task_name(name: &str) -> PyResult<&'static str> {
    registry::by_name(name).or_raise().map(|entry| entry.name)
}

/// The configuration with the record that it means. A class is asked on this thread, if that was not done yet: exceptions are its own.
pub fn pinned(py: Python<'_>, entry: &TaskEntry, mut config: EnvConfig) -> PyResult<EnvConfig> {
    let source = locked(&SOURCES).as_ref().and_then(|all| all.get(entry.name).cloned());
    if !config.task_record.is_empty() {
        let known = entry.record(&config).or_raise()?;
        let fits = known.is_none_or(|own| own.task(&config).is_ok());
        // other settings than those of its record: of a class another one can be written
        if fits || source.is_none() {
            return Ok(config);
        }
        config.task_record.clear();
    }
    if let Some(source) = source {
        let record = source.recorded(py, &entry.over_defaults(&config).or_raise()?)?;
        config.task_record = keep_record(&record).or_raise()?;
        return Ok(config);
    }
    entry.pinned(config).or_raise()
}

/// What a task says of itself, as JSON: everything that is named where it is written.
#[pyfunction]
pub fn _task_spec(py: Python<'_>, name: &str) -> PyResult<String> {
    let entry = registry::by_name(name).or_raise()?;
    let config = pinned(py, entry, EnvConfig { n_env: 1, ..EnvConfig::default() })?;
    let env = entry.env(&config).or_raise()?;
    serde_json::to_string(env.task_spec()).map_err(crate::error::unexpected)
}

/// The record of a task that is no type of Rust, as bytes.
pub fn record_of<'py>(py: Python<'py>, entry: &TaskEntry, config: &EnvConfig) -> PyResult<Option<Bound<'py, PyBytes>>> {
    let record = entry.record(config).or_raise()?;
    let bytes = record.map(|record| record.to_bytes()).transpose().or_raise()?;
    Ok(bytes.map(|bytes| PyBytes::new(py, &bytes)))
}

/// See [`_carried`].
type Carried<'py> = (&'static str, Option<Bound<'py, PyBytes>>, Bound<'py, PyDict>);

/// A task and its settings for another process: its name, bytes for `_register_record` there (None for a task of the library), and the
/// settings that are left.
#[pyfunction]
#[pyo3(signature = (name, settings, *, training=false))]
pub fn _carried<'py>(
    py: Python<'py>,
    name: &Bound<'py, PyAny>,
    settings: &Bound<'py, PyDict>,
    training: bool,
) -> PyResult<Carried<'py>> {
    let (entry, rest) = entry_of(name, Some(settings))?;
    let rest = rest.unwrap_or_else(|| PyDict::new(py));
    if !entry.is_source() {
        return Ok((entry.name, None, rest));
    }
    let own = rest.copy()?;
    let mut taken = [None, None, None, None];
    for (key, place) in ["config", "algorithm", "threads", "seed"].into_iter().zip(&mut taken) {
        *place = own.get_item(key)?;
        if place.is_some() {
            own.del_item(key)?;
        }
    }
    let [config, algorithm, ..] = taken;
    let config = if training {
        let layers = settings::layers(entry, config.as_ref(), Some(&own), &TrainConfig::keys())?;
        let algorithm: Option<String> = algorithm.map(|own| own.extract()).transpose()?;
        TrainConfig::layered(entry.name, algorithm.as_deref(), &layers).or_raise()?.env
    } else {
        crate::batch::config_of(entry, None, config.as_ref(), None, Some(&own))?
    };
    let config = pinned(py, entry, config)?;
    rest.set_item("task_record", &config.task_record)?;
    Ok((entry.name, record_of(py, entry, &config)?, rest))
}

/// Makes the task of a record known by its name, unless a class of that name is; its name.
#[pyfunction]
pub fn _register_record(record: &[u8]) -> PyResult<&'static str> {
    let record = Arc::new(TaskRecord::from_bytes(record).or_raise()?);
    Ok(register_record(&record).or_raise()?.name)
}

/// The task that a call means: a name, or a class, which is registered. Functions among the keywords that are phases of a task (`reward`,
/// `observe`, `ends`, ...) change a task of the library, and are taken out.
pub fn entry_of<'py>(
    given: &Bound<'py, PyAny>,
    keywords: Option<&Bound<'py, PyDict>>,
) -> PyResult<(&'static TaskEntry, Option<Bound<'py, PyDict>>)> {
    let mut name = match given.extract::<String>() {
        Ok(name) => name,
        Err(_) => given.py().import("omnidrones._task")?.getattr("_name_of")?.call1((given,))?.extract()?,
    };
    let Some(keywords) = keywords else { return Ok((registry::by_name(&name).or_raise()?, None)) };
    let (rest, own) = (keywords.copy()?, PyDict::new(given.py()));
    for (key, value) in keywords {
        let key: String = key.extract()?;
        if value.is_callable() && key != "watch" && !PHASES.contains(&key.as_str()) && key != "vehicle" {
            let known = PHASES.map(String::from).to_vec();
            return Err(Error::Unknown { kind: "phase of a task", name: key, known }).or_raise();
        }
    }
    for phase in PHASES {
        if let Some(function) = keywords.get_item(phase)?.filter(|function| function.is_callable()) {
            own.set_item(phase, function)?;
            rest.del_item(phase)?;
        }
    }
    if !own.is_empty() {
        name = given.py().import("omnidrones._task")?.getattr("_changed")?.call1((name, own))?.extract()?;
    }
    Ok((registry::by_name(&name).or_raise()?, Some(rest)))
}
