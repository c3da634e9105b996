//! The recorded step of a loop, compiled once for each thing that its clock says.
//!
//! Whether a level computes or holds follows from the time alone, and is the same for all flights side by side. A program
//! for "holds" does not compute what is then thrown away: selections between constants fold while they are recorded.

use super::closed_loop::ClosedLoop;
use super::law::{ControlLaw, LawController};
use autodiff::columns::Columns;
use autodiff::native::Place;
use autodiff::program::{BLOCK, InPlace, InPlaceWork};
use autodiff::{Program, Recording, Scalar, System};
use base::error::Result;
use std::ops::Range;

/// Most programs of one loop.
const MAX_PROGRAMS: usize = 16;

/// [x, u, θ] → x⁺ of a loop.
#[derive(Debug)]
pub(super) struct ClockedStep {
    /// Inputs that are constants in `special`.
    fixed: Range<usize>,
    special: Vec<(Vec<f64>, InPlace)>,
    /// For all else.
    general: InPlace,
}

impl ClockedStep {
    /// Records and compiles the step of a loop: for whatever input, and for `fixed` inputs at each of these rows that are met.
    ///
    /// # Errors
    /// [`Error::Limit`](base::error::Error::Limit) if a recording is too large.
    pub(super) fn new<L: ControlLaw>(
        system: &ClosedLoop<LawController<L>>,
        fixed: Range<usize>,
        rows: impl Iterator<Item = Vec<f64>>,
    ) -> Result<Self> {
        let (n, m, p) = (system.n_state(), system.n_input(), system.n_parameter());
        let compiled = |row: &[f64]| {
            let recording = Recording::of(n + m + p, |z| {
                let (mut input, mut next) = (z[n..n + m].to_vec(), vec![Scalar::zero(); n]);
                input[fixed.start..].iter_mut().zip(row).for_each(|(u, value)| *u = Scalar::constant(*value));
                system.step(&z[..n], &input, &z[n + m..], &mut next);
                next
            });
            let over_state = (0..n as u32).map(|row| Place { array: 0, row }).collect();
            Program::compile(&recording).map(|program| InPlace::new(program, over_state))
        };
        let mut special: Vec<(Vec<f64>, InPlace)> = Vec::new();
        for row in rows.take_while(|_| !fixed.is_empty()) {
            let own = &row[fixed.clone()];
            if special.len() < MAX_PROGRAMS && special.iter().all(|(known, _)| known != own) {
                special.push((own.to_vec(), compiled(own)?));
            }
        }
        Ok(Self { general: compiled(&[])?, fixed, special })
    }

    /// The program for whatever input.
    pub(super) fn general(&self) -> &Program {
        self.general.program()
    }

    /// A block of flights, all numbers zero, that is to be advanced about so many times.
    pub(super) fn block(&self, n_step: u64) -> Block {
        let n_program = self.special.len() + 1;
        Block {
            arguments: Columns::zeros(self.general().n_input()),
            n_state: self.general().n_output(),
            works: (0..n_program).map(|_| None).collect(),
            n_each: n_step.div_ceil(n_program as u64),
        }
    }
}

/// Flights side by side.
pub(super) struct Block {
    /// x, u, θ.
    arguments: Columns,
    n_state: usize,
    /// Of each program, once it has been run.
    works: Vec<Option<InPlaceWork>>,
    /// How often each is about to be run.
    n_each: u64,
}

impl Block {
    /// Writes the x, u and θ of one flight.
    pub(super) fn load<'n>(&mut self, lane: usize, numbers: impl Iterator<Item = &'n f64>) {
        self.arguments.iter_mut().zip(numbers).for_each(|(row, value)| row[lane] = *value as f32);
    }

    /// Number `k` of the state of a flight.
    #[inline]
    pub(super) fn number(&self, k: usize, lane: usize) -> f32 {
        self.arguments[k][lane]
    }

    /// Puts one flight into the lane of another, which is over.
    pub(super) fn move_lane(&mut self, from: usize, to: usize) {
        self.arguments.iter_mut().for_each(|row| row[to] = row[from]);
    }

    /// One step of the first `n_flight` flights, under the same first inputs.
    pub(super) fn advance(&mut self, step: &ClockedStep, n_flight: usize, clocked: &[f64]) {
        let own = &clocked[step.fixed.clone()];
        let at = step.special.iter().position(|(known, _)| known == own).unwrap_or(step.special.len());
        // a program that is made for them does not read them
        let known = if at < step.special.len() { step.fixed.clone() } else { 0..0 };
        for (k, value) in clocked.iter().enumerate().filter(|(k, _)| !known.contains(k)) {
            self.arguments[self.n_state + k] = [*value as f32; BLOCK];
        }
        let program = step.special.get(at).map_or(&step.general, |(_, program)| program);
        let work = self.works[at].get_or_insert_with(|| program.work_for(self.n_each));
        program.evaluate(n_flight, work, &mut self.arguments, &mut []);
    }
}
