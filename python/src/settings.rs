//! Settings as Python has them: dicts, files, keywords; merged as layers, so that what is said counts.

use crate::control::Vehicle;
use crate::error::OrRaise;
use omnidrones::dynamics::vehicles;
use omnidrones::error::Error;
use omnidrones::layers::{self, Layer};
use omnidrones::tasks::EnvConfig;
use omnidrones::tasks::config::TILTING;
use omnidrones::tasks::registry::TaskEntry;
use pyo3::exceptions::PyTypeError;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyMapping, PySequence, PyString};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Largest file of settings, bytes.
const MOST: u64 = 16 << 20;

/// Deepest settings: lists and dicts within each other.
const DEEPEST: usize = 32;

/// A value as TOML has it; what is None is left out.
pub fn value(name: &str, given: &Bound<'_, PyAny>) -> PyResult<Option<Value>> {
    within(name, given, 0)
}

fn within(name: &str, given: &Bound<'_, PyAny>, depth: usize) -> PyResult<Option<Value>> {
    if depth > DEEPEST {
        let remedy = "Take out what refers to itself.";
        let place = name.chars().take(24).collect::<String>() + "…";
        return Err(Error::limit(place, "nested deeper", format!("{DEEPEST} levels"), remedy)).or_raise();
    }
    let foreign = || {
        let kind = given.get_type().name().map_or_else(|_| "?".into(), |kind| kind.to_string());
        let wanted = "a number, a text, a list, a dict, a path or a Vehicle";
        PyTypeError::new_err(format!("{name} is a {kind}, but it must be {wanted}. Convert it first."))
    };
    if given.is_none() {
        return Ok(None);
    }
    if given.is_instance_of::<PyBool>() {
        return Ok(Some(Value::Boolean(given.extract()?)));
    }
    if given.is_instance_of::<PyInt>() {
        let number = given
            .extract::<i64>()
            .map_err(|_| Error::value(name, given, "a whole number within ±2^63", "Files hold no larger ones."));
        return Ok(Some(Value::Integer(number.or_raise()?)));
    }
    if given.is_instance_of::<PyFloat>() {
        return Ok(Some(Value::Float(given.extract()?)));
    }
    if given.is_instance_of::<PyString>() {
        return Ok(Some(Value::String(given.extract()?)));
    }
    if let Ok(vehicle) = given.cast::<Vehicle>() {
        return Ok(Some(Value::Table(vehicle.get().table()?)));
    }
    if let Ok(mapping) = given.cast::<PyMapping>() {
        return Ok(Some(Value::Table(entries(name, mapping, depth)?)));
    }
    if let Ok(list) = given.call_method0("tolist") {
        return within(name, &list, depth + 1); // of NumPy
    }
    if let Ok(path) = given.call_method0("__fspath__") {
        return within(name, &path, depth + 1);
    }
    let items = given.cast::<PySequence>().map_err(|_| foreign())?;
    let item = |k: usize| within(&format!("{name}[{k}]"), &items.get_item(k)?, depth + 1)?.ok_or_else(foreign);
    Ok(Some(Value::Array((0..items.len()?).map(item).collect::<PyResult<_>>()?)))
}

/// A dict as a table.
pub fn table(name: &str, given: &Bound<'_, PyMapping>) -> PyResult<Table> {
    entries(name, given, 0)
}

fn entries(name: &str, given: &Bound<'_, PyMapping>, depth: usize) -> PyResult<Table> {
    let mut table = Table::new();
    for pair in given.items()?.iter() {
        let (key, own): (Bound<'_, PyAny>, Bound<'_, PyAny>) = pair.extract()?;
        let Ok(key) = key.extract::<String>() else {
            return Err(PyTypeError::new_err(format!("{name} has the key {key}, but keys must be texts.")));
        };
        let place = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
        if let Some(own) = within(&place, &own, depth + 1)? {
            table.insert(key, own);
        }
    }
    Ok(table)
}

/// Data as Python has it.
pub fn python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::String(text) => PyString::new(py, text).into_any(),
        Value::Integer(number) => number.into_pyobject(py)?.into_any(),
        Value::Float(number) => PyFloat::new(py, *number).into_any(),
        Value::Boolean(flag) => PyBool::new(py, *flag).to_owned().into_any(),
        Value::Datetime(time) => PyString::new(py, &time.to_string()).into_any(),
        Value::Array(items) => {
            let items = items.iter().map(|item| python(py, item)).collect::<PyResult<Vec<_>>>()?;
            PyList::new(py, items)?.into_any()
        }
        Value::Table(table) => dict(py, table)?.into_any(),
    })
}

/// A table as a dict.
pub fn dict<'py>(py: Python<'py>, table: &Table) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (key, own) in table {
        dict.set_item(key, python(py, own)?)?;
    }
    Ok(dict)
}

/// What a `config` says: a dict, a TOML file, or TOML itself (a text with a line break or `=`).
pub fn layer(given: &Bound<'_, PyAny>) -> PyResult<Layer> {
    if let Ok(mapping) = given.cast::<PyMapping>() {
        return Ok(Layer::of_table("config", table("", mapping)?));
    }
    let text = given.cast::<PyString>().ok().map(|text| text.extract::<String>()).transpose()?;
    if let Some(text) = text.filter(|text| text.contains(['\n', '='])) {
        return Layer::of_text(&text, "config").or_raise();
    }
    let path: PathBuf = given.extract().map_err(|_| {
        PyTypeError::new_err("config must be a dict, the path of a TOML file, or TOML itself (a text with '=').")
    })?;
    let text = omnidrones::internals::read_text(&path, MOST).or_raise()?;
    Layer::of_text(&text, &path.display().to_string()).or_raise()
}

/// The layers of a call: its `config`, then its keywords. Settings of the task may be given as if they were the
/// environment's; `vehicle` may be a [`Vehicle`] or a file.
pub fn layers(
    entry: &TaskEntry,
    config: Option<&Bound<'_, PyAny>>,
    keywords: Option<&Bound<'_, PyDict>>,
    foreign: &[String],
) -> PyResult<Vec<Layer>> {
    let mut layers = config.map(layer).transpose()?.into_iter().collect::<Vec<_>>();
    let known = EnvConfig::keys();
    let mut own = Table::new();
    let mut of_task = None;
    for (key, given) in keywords.into_iter().flatten() {
        let key: String = key.extract()?;
        if key == "vehicle" {
            if let Some(value) = vehicle(&given)? {
                layers::merge(&mut own, value);
            }
            continue;
        }
        let Some(mut value) = value(&key, &given)? else { continue };
        if key == "sensor" && value.is_str() {
            // as `fly` takes them
            value = Value::try_from(crate::estimation::sensors(&given)?).map_err(crate::error::unexpected)?;
        }
        if known.contains(&key) || foreign.contains(&key) {
            layers::merge(&mut own, layers::at(&key, value));
            continue;
        }
        let names = of_task.get_or_insert(entry.setting_keys().or_raise()?);
        if !names.contains(&key) {
            if key == "device" {
                let told = "omnidrones.make, omnidrones.gym.VectorEnv and omnidrones.torchrl.Env take a device. All else steps on the \
                            processor: leave it out.";
                return Err(PyValueError::new_err(told));
            }
            let known = names.iter().chain(&known).chain(foreign).cloned().collect();
            return Err(Error::Unknown { kind: "setting", name: key, known }).or_raise();
        }
        layers::merge(&mut own, layers::at("task", Value::Table(layers::at(&key, value))));
    }
    layers.push(Layer::of_table("settings", own));
    Ok(layers)
}

/// What `vehicle` says: a name goes to the task, a vehicle of one's own with its numbers.
fn vehicle(given: &Bound<'_, PyAny>) -> PyResult<Option<Table>> {
    let own = match (given.cast::<Vehicle>(), value("vehicle", given)?) {
        (_, None) => return Ok(None),
        (Ok(vehicle), _) => vehicle.get().0.clone(),
        (Err(_), Some(Value::String(named))) if is_file(&named) => crate::control::load(&named)?,
        (Err(_), Some(named)) => {
            return Ok(Some(layers::at("task", Value::Table(layers::at("vehicle", named)))));
        }
    };
    let mut table = layers::at("task", Value::Table(layers::at("vehicle", own.name.clone().into())));
    table.insert("own_vehicle".into(), Value::try_from(&own).map_err(crate::error::unexpected)?);
    Ok(Some(table))
}

/// Whether a text means a file: no built-in vehicle has a point or a slash in its name.
fn is_file(named: &str) -> bool {
    let known = vehicles::names().iter().any(|name| name.eq_ignore_ascii_case(named)) || named == TILTING;
    !known && (named.contains(['/', '\\']) || Path::new(named).extension().is_some())
}
