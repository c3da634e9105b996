//! One step of a block of environments as a program, in place over its rows: recorded, then machine code.
//!
//! Rows of a block: state, input, `alive`. The model's numbers are constants of the program, or rows of their own.

use super::kernel::{DIVERGED_ABOVE, STOPPED, is_unchecked};
use super::plant::PlantBlock;
use autodiff::native::{Executable, Place, RowLayout, Rows as Array, Work};
use autodiff::program::BLOCK;
use autodiff::{Mask, Program, Recording, Scalar, Trace, safe};
use base::error::Result;
use std::fmt;
use std::sync::{Mutex, PoisonError};

/// A step, and scratch of those that run it.
pub(crate) struct StepProgram {
    executable: Executable<[f32; BLOCK]>,
    idle: Mutex<Vec<Work<[f32; BLOCK]>>>,
}

impl StepProgram {
    /// Of a recording of rows, of which `n_row` are the block's.
    pub(super) fn of(recording: &Recording, n_row: usize) -> Result<Self> {
        let place = |array| move |row| Place { array, row: row as u32 };
        let n_number = recording.n_input() - n_row;
        let arguments = (0..n_row).map(place(0)).chain((0..n_number).map(place(1))).collect();
        let results = (0..recording.n_output() - 1).chain([n_row - 1]).map(place(0)).collect();
        let executable = Executable::new(&Program::compile(recording)?, RowLayout::new(arguments, results)?)?;
        Ok(Self { executable, idle: Mutex::default() })
    }

    /// Steps blocks whose numbers are those of the program, or rows of their own.
    pub(super) fn run<'a>(&self, blocks: impl Iterator<Item = &'a mut PlantBlock>) {
        let idle = || self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let taken = idle().pop();
        let mut work = taken.unwrap_or_else(|| self.executable.work());
        for block in blocks {
            let rows = Array::Write(&mut block.rows);
            let ran = match &block.numbers {
                Some(numbers) => self.executable.run(&mut work, &mut [rows, Array::Read(numbers)], block.occupied),
                None => self.executable.run(&mut work, &mut [rows], block.occupied),
            };
            ran.expect("rows of the plant");
        }
        idle().push(work);
    }
}

/// Next states and `alive`. A lane that was not alive, whose new state is not finite and bounded or whose action is no number, moved it
/// what it moved, keeps its state and ceases to be alive; its neighbours do not notice.
pub(super) fn contained(state: &[Trace], actions: &[Trace], alive: Trace, next: Vec<Trace>) -> Vec<Trace> {
    let was_alive = Trace::constant(0.5).lt(alive);
    let one = Trace::one();
    let clipped: Vec<Trace> = actions.iter().map(|action| action.clamp(-one, one)).collect();
    let is_healthy = safe::all_bounded(&next, DIVERGED_ABOVE).and(safe::all_bounded(&clipped, 2.0));
    let ok = was_alive.and(is_healthy).or(is_unchecked(alive));
    let mut kept: Vec<Trace> = next.iter().zip(state).map(|(next, before)| Trace::select(ok, *next, *before)).collect();
    let stopped = Trace::select(was_alive, Trace::constant(f64::from(STOPPED)), alive);
    kept.push(Trace::select(ok, alive, stopped));
    kept
}

impl fmt::Debug for StepProgram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "StepProgram({:?})", self.executable.why_interpreted())
    }
}

#[cfg(test)]
mod tests;
