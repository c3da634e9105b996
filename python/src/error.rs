//! The library's errors as Python's: the same words, in the class that Python has for their kind.

use omnidrones::error::Error;
use pyo3::exceptions::{
    PyFileExistsError, PyFileNotFoundError, PyOSError, PyPermissionError, PyRuntimeError, PyValueError,
};
use pyo3::prelude::*;
use std::io::ErrorKind;
use std::time::{Duration, Instant};

/// How often signals are looked for within a long call: between two looks Python does not hear of them.
const LOOK: Duration = Duration::from_millis(100);

/// What the library answered, for Python.
pub trait OrRaise<T> {
    /// An error becomes an exception: `ValueError`, or `OSError` and its kinds for files.
    fn or_raise(self) -> PyResult<T>;
}

impl<T> OrRaise<T> for Result<T, Error> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(raised)
    }
}

fn raised(error: Error) -> PyErr {
    let text = error.to_string();
    match error {
        Error::File { source, .. } => match source.kind() {
            ErrorKind::NotFound => PyFileNotFoundError::new_err(text),
            ErrorKind::PermissionDenied => PyPermissionError::new_err(text),
            ErrorKind::AlreadyExists => PyFileExistsError::new_err(text),
            _ => PyOSError::new_err(text),
        },
        Error::NoRun { .. } => PyFileNotFoundError::new_err(text),
        _ => PyValueError::new_err(text),
    }
}

/// Runs what takes long without the interpreter, and raises what Python said within it in place of what that led to.
///
/// `work` asks [`Said::hear`] or [`Said::looks`] now and then, which runs Python: a callback, or the handlers of signals.
pub fn interruptible<T: Send>(py: Python<'_>, work: impl FnOnce(&mut Said) -> Result<T, Error> + Send) -> PyResult<T> {
    let mut said = Said { raised: None, looked: Instant::now() };
    let outcome = py.detach(|| work(&mut said));
    match said.raised {
        Some(raised) => Err(raised),
        None => outcome.or_raise(),
    }
}

/// What Python raised while the library worked.
pub struct Said {
    raised: Option<PyErr>,
    looked: Instant,
}

impl Said {
    /// What `python` gives, behind handlers of signals; `None` where one raised, which ends the work.
    pub fn hear<T>(&mut self, python: impl FnOnce(Python<'_>) -> PyResult<T>) -> Option<T> {
        Python::attach(|py| py.check_signals().and_then(|()| python(py))).map_err(|e| self.raised = Some(e)).ok()
    }

    /// As [`hear`](Self::hear) for work that stops by an error.
    pub fn or_stop<T>(&mut self, python: impl FnOnce(Python<'_>) -> PyResult<T>) -> Result<T, Error> {
        self.hear(python).ok_or_else(|| Error::value("the caller", "interrupted", "running", ""))
    }

    /// Looks for signals if that was a while ago: cheap enough for every step of a simulation.
    pub fn looks(&mut self) -> Result<(), Error> {
        if self.looked.elapsed() < LOOK {
            return Ok(());
        }
        self.looked = Instant::now();
        self.or_stop(|_| Ok(()))
    }
}

/// For what Python should not be able to bring about.
pub fn unexpected(what: impl std::fmt::Display) -> PyErr {
    PyRuntimeError::new_err(format!("{what}. Report this."))
}
