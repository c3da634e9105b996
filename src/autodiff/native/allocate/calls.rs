//! Calls: registers are the callee's, and tapes stay where they are.

use super::{Allocator, N_MASK, NEVER, NOBODY};
use crate::native::instruction::*;
use crate::native::lower::{Callee, Do, Lowered};
use crate::program::Tape;
use std::collections::HashMap;

/// The functions of a program, by their numbers.
#[derive(Clone, Copy)]
pub(super) struct Functions<'a> {
    pub(super) signatures: &'a [Signature],
    /// Which functions run when one is called.
    pub(super) reach: &'a [Vec<bool>],
}

/// How many numbers a function takes and gives, but for those on its tape.
#[derive(Debug, Clone, Copy)]
pub(super) struct Signature {
    pub(super) n_argument: usize,
    pub(super) n_result: usize,
    tape: Tape,
}

impl Signature {
    pub(super) fn of(lowered: &Lowered) -> Self {
        let tape = lowered.tape;
        Self { n_argument: lowered.n_input - tape.n_input(), n_result: lowered.results.len() - tape.n_result(), tape }
    }
}

/// Callers stand before those that they call.
pub(super) fn reach(lowered: &[Lowered]) -> Vec<Vec<bool>> {
    let n = lowered.len() - 1;
    let mut reach = vec![vec![false; n]; n];
    for k in (0..n).rev() {
        reach[k][k] = true;
        for call in &lowered[k + 1].calls {
            if let Callee::Function(other, _) = call.callee {
                for i in 0..n {
                    reach[k][i] |= reach[other as usize][i];
                }
            }
        }
    }
    reach
}

impl Allocator<'_> {
    /// All that lives on goes home: registers are the callee's.
    pub(super) fn call(&mut self, number: u32, stores: &HashMap<usize, Vec<Mem>>) {
        let site = &self.lowered.calls[number as usize];
        let values: Vec<usize> = site.operands.iter().map(|operand| self.value(*operand)).collect();
        let function = if let Callee::Function(function, _) = site.callee { Some(function) } else { None };
        let (mut n_argument, mut tape) = (values.len(), None);
        if let Some(function) = function {
            self.rescue(function);
            n_argument = self.functions.signatures[function as usize].n_argument;
            tape = self.tape(function, &values[n_argument..], stores);
        }
        for (value, k) in values[..n_argument].iter().zip(0..) {
            self.put(*value, function.map_or(Mem::Call(k), |function| Mem::Passed(function, k)));
        }
        for r in 0..self.target.n_register {
            let value = self.holds[r];
            if value != NOBODY {
                if self.next_use(value as usize) != NEVER {
                    self.send_home(value as usize);
                }
                self.forget(value as usize);
            }
        }
        self.release(&values);
        self.masks = [None; N_MASK];
        self.last_called = function.map(|function| (function, tape));
        self.out.push(match function {
            None => Instruction::Call { number },
            Some(function) => Instruction::Invoke { function, tape },
        });
    }

    fn put(&mut self, value: usize, m: Mem) {
        let s = self.ensure(value);
        self.out.push(Instruction::Store { m, s });
        self.pinned = 0;
    }

    /// Where a function that is called next has its tape. One that it reads stays where it was written, unless its numbers were moved
    /// apart; one that it writes is the caller's own, where that keeps all of it, else slots.
    fn tape(&mut self, function: u32, read: &[usize], stores: &HashMap<usize, Vec<Mem>>) -> Option<TapeAt> {
        match self.functions.signatures[function as usize].tape {
            Tape::None => None,
            Tape::Inputs(n) => TapeAt::of(read.iter().map(|value| self.home[*value])).or_else(|| {
                let at = self.new_slots(n);
                for (value, k) in read.iter().zip(0..) {
                    self.put(*value, at.mem(k));
                }
                if let TapeAt::Slot(first) = at {
                    self.ending.extend(first..first + n as u32);
                }
                Some(at)
            }),
            Tape::Results(n) => {
                let first = self.functions.signatures[function as usize].n_result as u32;
                let mut kept = vec![None; n];
                for (k, step) in (self.now as usize + 1..).zip(&self.lowered.steps[self.now as usize + 1..]) {
                    let Do::Result(result) = step.what else { break };
                    if let Some(at) = result.checked_sub(first) {
                        let is_tape = |place: &&Mem| matches!(place, Mem::Tape(_));
                        kept[at as usize] = stores.get(&k).and_then(|places| places.iter().find(is_tape)).copied();
                    }
                }
                Some(TapeAt::of(kept.into_iter()).unwrap_or_else(|| self.new_slots(n)))
            }
        }
    }

    /// Slots side by side.
    fn new_slots(&mut self, n: usize) -> TapeAt {
        self.n_slot += n as u32;
        TapeAt::Slot(self.n_slot - n as u32)
    }

    /// What lives on and stands where a function or one that it calls will leave other numbers gets a place of its own. Arguments are
    /// read before.
    fn rescue(&mut self, function: u32) {
        let reach = &self.functions.reach[function as usize];
        let mut passed = std::mem::take(&mut self.passed);
        passed.retain(|&value| {
            let Some(Mem::Passed(of, _)) = self.home[value] else { return false };
            if !reach[of as usize] {
                return true;
            }
            if self.next_use(value) != NEVER {
                self.ensure(value);
                self.home[value] = None;
                self.send_home(value);
                self.pinned = 0;
            }
            false
        });
        self.passed = passed;
    }
}
