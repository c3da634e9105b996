//! The task of a run, where it is none of Rust's: kept with every checkpoint, so that who has the run has the task.

use super::checkpoint::Tensors;
use base::error::Result;
use std::sync::Arc;
use tasks::EnvConfig;
use tasks::registry;
use tasks::written::{TaskRecord, register_record};

/// Name of the tensor, of bytes.
const RECORD: &str = "task.record";

/// Adds the record that a configuration names.
///
/// # Errors
/// As [`TaskRecord::to_bytes`].
pub(crate) fn put_task(task: &str, env: &EnvConfig, state: &mut Tensors) -> Result<()> {
    let Some(record) = registry::by_name(task)?.record(env)? else { return Ok(()) };
    let bytes = record.to_bytes()?;
    state.insert(RECORD, &[bytes.len()], bytes)
}

/// Makes the task of a checkpoint known, if it brought one.
///
/// # Errors
/// As [`TaskRecord::from_bytes`] and [`register_record`].
pub(crate) fn register_task(state: &Tensors) -> Result<()> {
    let Ok(tensor) = state.tensor(RECORD) else { return Ok(()) };
    let bytes = state.get::<u8>(RECORD, tensor.shape())?;
    register_record(&Arc::new(TaskRecord::from_bytes(bytes)?)).map(drop)
}
