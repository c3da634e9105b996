//! A process that is told to end: runs that train save what they have, then rest until it is over.
//!
//! A run asks between two updates. While one is at work, whoever ends the process waits for it.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// What became of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RunLeft {
    /// In this folder, with so many updates.
    Saved(PathBuf, u64),
    /// It is kept nowhere, or could not be saved: why.
    Lost(String),
}

/// Runs at work, and what became of those that rest.
#[derive(Debug)]
struct State {
    at_work: usize,
    left: Vec<RunLeft>,
}

static ASKED: AtomicBool = AtomicBool::new(false);
static STATE: Mutex<State> = Mutex::new(State { at_work: 0, left: Vec::new() });
static CHANGED: Condvar = Condvar::new();

fn state() -> MutexGuard<'static, State> {
    STATE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Asks all runs of the process to save and rest; how many are at work. None of them ever goes on.
pub fn ask() -> usize {
    ASKED.store(true, Ordering::SeqCst);
    state().at_work
}

/// Waits until no run is at work; what became of them.
pub fn wait() -> Vec<RunLeft> {
    let mut state = state();
    while state.at_work > 0 {
        state = CHANGED.wait(state).unwrap_or_else(PoisonError::into_inner);
    }
    state.left.clone()
}

/// A run at work.
pub(crate) struct AtWork(());

impl AtWork {
    pub(crate) fn begin() -> Self {
        state().at_work += 1;
        Self(())
    }

    /// Whether the process is told to end.
    pub(crate) fn is_asked(&self) -> bool {
        ASKED.load(Ordering::Relaxed)
    }

    /// Tells what became of the run, and rests for ever.
    pub(crate) fn rest(self, left: RunLeft) -> ! {
        state().left.push(left);
        drop(self);
        loop {
            std::thread::park();
        }
    }
}

impl Drop for AtWork {
    fn drop(&mut self) {
        state().at_work -= 1;
        CHANGED.notify_all();
    }
}
