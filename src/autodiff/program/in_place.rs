//! A program over blocks that writes results over its arguments: what advances a state copies nothing.

use super::{BLOCK, BlockWorkspace, Program};
use crate::columns::Lines;
use crate::native::policy::{Fallback, OnDemand};
use crate::native::{Code, Place, RowLayout, Rows, WhyInterpreted, code};

type Row = [f32; BLOCK];

/// A program whose arguments are the rows of a first array, in order, and whose results go to places in it and in a second one.
#[derive(Debug)]
pub struct InPlace {
    program: Program,
    /// Why not: results share a place, or are too far.
    layout: Result<RowLayout, WhyInterpreted>,
    results: Vec<Place>,
    code: OnDemand<Code>,
}

/// What an [`InPlace`] needs; made once, reused without allocation.
#[derive(Debug)]
pub enum InPlaceWork {
    Native(Code, Lines),
    /// With the results before they go to their places.
    Interpreted(Box<BlockWorkspace>, Vec<Row>),
}

impl InPlace {
    #[doc(hidden)]
    pub fn new(program: Program, results: Vec<Place>) -> Self {
        let arguments = (0..program.n_input() as u32).map(|row| Place { array: 0, row }).collect();
        let layout = RowLayout::new(arguments, results.clone()).map_err(|_| WhyInterpreted::TooLarge);
        Self { program, layout, results, code: OnDemand::default() }
    }

    #[doc(hidden)]
    pub fn program(&self) -> &Program {
        &self.program
    }

    /// Machine code where so many evaluations, with those that were asked for before, are worth it.
    #[doc(hidden)]
    pub fn work_for(&self, n_evaluation: u64) -> InPlaceWork {
        let make = || code::<Row>(self.program.arranged(), self.layout.as_ref().map_err(|why| *why)?);
        match self.code.ask(Fallback::InterpretedBlock, self.program.len(), n_evaluation, make) {
            Some(code) => InPlaceWork::Native(code.clone(), code.slots()),
            None => {
                let workspace = Box::new(self.program.interpreter_block_workspace());
                InPlaceWork::Interpreted(workspace, vec![[0.0; BLOCK]; self.program.n_output()])
            }
        }
    }

    /// One evaluation of the first `n` numbers of the rows of `first`; what becomes of others is left open.
    ///
    /// # Panics
    /// If an array has too few rows, or `work` is of another program.
    #[doc(hidden)]
    pub fn evaluate(&self, n: usize, work: &mut InPlaceWork, first: &mut [Row], second: &mut [Row]) {
        if n == 0 {
            return;
        }
        match work {
            InPlaceWork::Native(code, slots) => {
                let arrays = &mut [Rows::Write(first), Rows::Write(second)];
                let n_array = self.layout.as_ref().map_or(0, RowLayout::n_array);
                assert!(code.run(slots, &mut arrays[..n_array], n), "rows of a program");
            }
            InPlaceWork::Interpreted(workspace, results) => {
                self.program.evaluate_lanes(n, workspace, &first[..self.program.n_input()], results);
                for (result, place) in results.iter().zip(&self.results) {
                    (if place.array == 0 { &mut *first } else { &mut *second })[place.row as usize] = *result;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Recording, Scalar, Trace};

    /// (x, v, a) → (x⁺, v⁺), and the energy apart.
    #[test]
    fn results_over_arguments_are_the_same_by_code_and_by_the_interpreter() {
        let recording = Recording::of(3, |z| {
            let (x, v, half) = (z[0] + z[1] * Trace::constant(0.01), z[1] - z[2], Trace::constant(0.5));
            vec![x, v * x.sin_cos().0, half * z[1] * z[1]]
        });
        let places = [(0, 0), (0, 1), (1, 0)].map(|(array, row)| Place { array, row });
        let own = InPlace::new(Program::compile(&recording).unwrap(), places.to_vec());
        let start: Vec<Row> = (0..3).map(|k| std::array::from_fn(|l| (k as f32 - 0.3) * (l as f32 + 0.5))).collect();
        let fly = |work: &mut InPlaceWork| {
            let (mut first, mut second) = (start.clone(), vec![[0.0; BLOCK]]);
            (0..5).for_each(|_| own.evaluate(BLOCK, work, &mut first, &mut second));
            [first, second].concat().concat().iter().map(|x| x.to_bits()).collect::<Vec<_>>()
        };
        let [few, many] = [1, 1 << 40].map(|n| own.work_for(n));
        assert!(matches!(few, InPlaceWork::Interpreted(..)));
        assert_eq!(matches!(many, InPlaceWork::Native(..)), crate::native::availability().is_ok());
        let [few, many] = [few, many].map(|mut work| fly(&mut work));
        assert!(few == many && few[..64] != few[64..128]);
    }
}
