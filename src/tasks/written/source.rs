//! Records that this process has, by what they are; and as tasks of the registry, for processes in which nobody can write them down.

use super::TaskRecord;
use crate::config::EnvConfig;
use crate::registry::{self, TaskEntry, TaskSource};
use base::error::{Error, Result};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most records that are kept.
const MOST: usize = 512;

/// Those that were written or read, the newest last.
static KEPT: Mutex<VecDeque<Arc<TaskRecord>>> = Mutex::new(VecDeque::new());

fn kept() -> MutexGuard<'static, VecDeque<Arc<TaskRecord>>> {
    KEPT.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Keeps a record, so that configurations may name it; its [id](TaskRecord::id).
///
/// # Errors
/// As [`TaskRecord::to_bytes`].
pub fn keep_record(record: &Arc<TaskRecord>) -> Result<String> {
    let id = record.id()?.to_string();
    let mut kept = kept();
    // the newest is found first
    let known = kept.iter().position(|own| own.id().is_ok_and(|own| *own == *id)).and_then(|k| kept.remove(k));
    kept.push_back(known.unwrap_or_else(|| record.clone()));
    let oldest = if kept.len() > MOST { kept.pop_front() } else { None };
    drop(kept);
    drop(oldest);
    Ok(id)
}

/// The record that a configuration names.
///
/// # Errors
/// [`Error::Unknown`] where nobody has written or read it in this process.
pub fn record_of(name: &str, id: &str) -> Result<Arc<TaskRecord>> {
    let of_name = |own: &&Arc<TaskRecord>| own.name.eq_ignore_ascii_case(name);
    let kept = kept();
    let found = kept.iter().filter(of_name).find(|own| own.id().is_ok_and(|own| own == id));
    found.cloned().ok_or_else(|| Error::Unknown {
        kind: "record of a task",
        name: format!("{id} of {name}"),
        known: kept.iter().filter(of_name).filter_map(|own| Some(own.id().ok()?.to_string())).collect(),
    })
}

/// Makes a record known, and its task by its name, unless a class that this process has is called so.
///
/// # Errors
/// As [`registry::register_source`] and [`keep_record`].
pub fn register_record(record: &Arc<TaskRecord>) -> Result<&'static TaskEntry> {
    let entry = match registry::by_name(&record.name) {
        Ok(entry) if !entry.is_in_rust() => entry,
        _ => registry::register_source(&record.name, Arc::new(RecordSource(record.name.clone())))?,
    };
    keep_record(record)?;
    Ok(entry)
}

/// The records of a name.
struct RecordSource(String);

impl RecordSource {
    /// The newest that fits a configuration, else the newest.
    fn find(&self, config: Option<&EnvConfig>) -> Result<Arc<TaskRecord>> {
        let own: Vec<_> = kept().iter().rev().filter(|own| own.name.eq_ignore_ascii_case(&self.0)).cloned().collect();
        let fits = |own: &&Arc<TaskRecord>| config.is_none_or(|config| own.task(config).is_ok());
        let found = own.iter().find(fits).or(own.first()).cloned();
        found.ok_or_else(|| Error::Unknown { kind: "record of a task", name: self.0.clone(), known: Vec::new() })
    }
}

impl TaskSource for RecordSource {
    fn record(&self, config: &EnvConfig) -> Result<Arc<TaskRecord>> {
        self.find(Some(config))
    }
    fn defaults(&self) -> toml::Table {
        self.find(None).map(|own| own.defaults.clone()).unwrap_or_default()
    }
    fn setting_keys(&self) -> Result<Vec<String>> {
        self.find(None)?.setting_keys()
    }
    fn description(&self) -> String {
        self.find(None).map(|own| own.description.clone()).unwrap_or_default()
    }
}
