//! When machine code is made, and of how much at once.
//!
//! Rollouts, loops and batches of gradients ask here; a workspace that is asked for by itself, and worlds, have code at once. Counts
//! decide and no clock does: the evaluations asked for so far, of one program in one
//! process, against the instructions that code would be made of.

use super::WhyInterpreted;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Most instructions of a Jacobian that becomes one code, lanes of rows and all. Where it is larger its values alone are code.
/// Measured on Zen 3: with 9 872 instructions one code is 1.4 times as fast, with 26 018 it takes 1.16 times as long.
pub(crate) const MAX_WHOLE: usize = 15_000;

/// Most instructions and multiplications of a step's sweep along a rollout of which eight steps have their weights made at once.
/// Measured on Zen 3: with 4 247 they take 0.79 of the time that one step after the other takes, with 8 965 1.16 of it.
pub(crate) const MAX_SIDE_BY_SIDE: usize = 6_000;

/// What an evaluation is without machine code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fallback {
    /// Interpreted, of one point.
    Interpreted,
    /// Interpreted over a block of environments.
    InterpretedBlock,
    /// A step that rustc compiled.
    Compiled,
    /// A step of a sweep along a rollout.
    Swept,
}

impl Fallback {
    /// Evaluations that gain at least as much as making an instruction costs. Measured on Zen 3 for steps and adjoints of rigid vehicles
    /// and of `payload`: 210 to 355 points, 62 to 105 blocks; 1000 to 1400 compiled steps and steps of a sweep.
    const fn n_even(self) -> u64 {
        match self {
            Self::Interpreted => 400,
            Self::InterpretedBlock => 120,
            Self::Compiled | Self::Swept => 1_500,
        }
    }
}

/// Instructions that a code costs beside its own: memory is asked for, sealed and mapped.
const FIXED: u64 = 50;

/// Whether so many evaluations of so many instructions gain more than their code costs.
pub(crate) fn pays(fallback: Fallback, n_instruction: usize, n_evaluation: u64) -> bool {
    let n = n_instruction as u64;
    n_evaluation.saturating_mul(n) >= fallback.n_even().saturating_mul(n + FIXED)
}

/// Machine code that is made when so many evaluations were asked for that it pays, once, for all threads.
#[derive(Debug)]
pub struct OnDemand<T> {
    asked: AtomicU64,
    /// Tried, never waited for: in a process made by `fork` nobody may be there who gives it back.
    made: Mutex<Option<Result<T, WhyInterpreted>>>,
}

impl<T> Default for OnDemand<T> {
    fn default() -> Self {
        Self { asked: AtomicU64::new(0), made: Mutex::new(None) }
    }
}

impl<T: Clone> OnDemand<T> {
    /// However many evaluations were asked for.
    pub(crate) fn now(&self, make: impl FnOnce() -> Result<T, WhyInterpreted>) -> Result<T, WhyInterpreted> {
        super::availability()?;
        let Ok(mut made) = self.made.try_lock() else { return make() };
        if let Some(Ok(made)) = &*made {
            return Ok(made.clone());
        }
        made.insert(make()).clone()
    }

    /// Asks for `n_evaluation` more; nothing where they are better done without code, or there can be none.
    #[doc(hidden)]
    pub fn ask(
        &self,
        fallback: Fallback,
        n_instruction: usize,
        n_evaluation: u64,
        make: impl FnOnce() -> Result<T, WhyInterpreted>,
    ) -> Option<T> {
        let more = |asked: u64| Some(asked.saturating_add(n_evaluation));
        let before = self.asked.fetch_update(Relaxed, Relaxed, more).unwrap_or_default();
        let asked = before.saturating_add(n_evaluation);
        if !pays(fallback, n_instruction, asked) || super::availability().is_err() {
            return None;
        }
        // whoever comes while another thread makes it does without once more
        let mut made = self.made.try_lock().ok()?;
        if matches!(*made, Some(Err(WhyInterpreted::Full))) {
            *made = None;
        }
        made.get_or_insert_with(make).as_ref().ok().cloned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn code_is_made_when_the_count_of_evaluations_says_so_and_then_once() {
        for fallback in [Fallback::Interpreted, Fallback::InterpretedBlock, Fallback::Compiled, Fallback::Swept] {
            let even = fallback.n_even();
            for n_instruction in [1, 50, 400, 1 << 20] {
                let enough = even * (n_instruction as u64 + FIXED) / n_instruction as u64;
                assert!(!pays(fallback, n_instruction, enough - 1), "{fallback:?}, {n_instruction}");
                assert!(pays(fallback, n_instruction, enough + 1), "{fallback:?}, {n_instruction}");
            }
        }
        let place = OnDemand::<u32>::default();
        let mut n_made = 0;
        let mut ask = |n| {
            place.ask(Fallback::Interpreted, 500, n, || {
                n_made += 1;
                Ok(7)
            })
        };
        let is_here = super::super::availability().is_ok();
        assert_eq!([ask(0), ask(439)], [None, None]);
        assert_eq!([ask(1), ask(0), ask(u64::MAX)], [is_here.then_some(7); 3]);
        assert_eq!(n_made, u32::from(is_here));
    }

    #[test]
    fn what_cannot_be_made_is_not_tried_again() {
        let place = OnDemand::<u32>::default();
        let mut n_tried = 0;
        for _ in 0..3 {
            let got = place.ask(Fallback::Compiled, 10, 1 << 40, || {
                n_tried += 1;
                Err(WhyInterpreted::TooLarge)
            });
            assert_eq!(got, None);
        }
        assert_eq!(n_tried, u32::from(super::super::availability().is_ok()));
    }
}
