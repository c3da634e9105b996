//! The lane kernel of a batch of articulated systems: one block of environments, one step.
//!
//! Rows of a block: state, input, `alive`. The model's numbers stand in blocks of their own, one for all environments
//! that share them, so that a batch without randomisation reads them from cache.

use super::kernel::{EXPLODED, STOPPED};
use super::plant::Block;
use crate::autodiff::lanes::Lanes;
use crate::autodiff::program::BLOCK;
use crate::autodiff::{Mask, Scalar, safe};
use crate::dynamics::integrate::Grid;
use crate::dynamics::tree::numbers::Numbers;
use crate::dynamics::tree::scratch::{Scratch, scratch_on_stack};
use crate::dynamics::tree::step::{self, Task};
use crate::dynamics::tree::topology::Topology;
use pulp::{Simd, WithSimd};

/// The numbers of a model in rows, at one register's place.
#[derive(Clone, Copy)]
struct LaneNumbers<'a> {
    rows: &'a [[f32; BLOCK]],
    at: usize,
}

impl<S: Simd> Numbers<Lanes<S>> for LaneNumbers<'_> {
    #[inline(always)]
    fn get(self, k: usize) -> Lanes<S> {
        Lanes::load(&self.rows[k][self.at..])
    }
}

/// Steps every block of a chunk once, for the dispatcher.
pub(crate) struct StepTrees<'a> {
    pub blocks: &'a mut [Block],
    /// Numbers of all blocks without their own.
    pub shared: &'a [[f32; BLOCK]],
    pub topology: &'a Topology,
    pub grid: Grid,
}

impl WithSimd for StepTrees<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        scratch_on_stack!(scratch, self.topology, Lanes<S>);
        for b in 0..self.blocks.len() {
            let Block { rows, numbers: own } = &mut self.blocks[b];
            let mut at = 0;
            while at < BLOCK {
                let numbers = match own {
                    Some(own) => LaneNumbers { rows: own, at },
                    // equal in every lane: the first register's place stays in cache
                    None => LaneNumbers { rows: self.shared, at: 0 },
                };
                step_lanes::<S>(self.topology, numbers, self.grid, rows, at, &mut scratch);
                at += Lanes::<S>::WIDTH;
            }
        }
    }
}

/// One register of environments; lanes that stop keep their state, as in the kernel of single multirotors.
#[inline(always)]
fn step_lanes<S: Simd>(
    t: &Topology,
    numbers: LaneNumbers<'_>,
    grid: Grid,
    block: &mut [[f32; BLOCK]],
    at: usize,
    scratch: &mut Scratch<'_, Lanes<S>>,
) {
    for k in 0..t.n_state {
        scratch.end[k] = Lanes::load(&block[k][at..]);
    }
    for k in 0..t.n_input {
        scratch.input[k] = Lanes::load(&block[t.n_state + k][at..]);
    }
    step::run(t, numbers, Task::Step(grid), scratch);
    let alive = Lanes::<S>::load(&block[t.n_state + t.n_input][at..]);
    let was_alive = Lanes::constant(0.5).lt(alive);
    let mut ok = was_alive;
    for k in 0..t.n_state {
        ok = ok.and(safe::is_bounded(scratch.end[k], EXPLODED));
    }
    for k in 0..t.n_state {
        let before = Lanes::load(&block[k][at..]);
        Lanes::select(ok, scratch.end[k], before).store(&mut block[k][at..]);
    }
    let stopped = Lanes::select(was_alive, Lanes::constant(f64::from(STOPPED)), alive);
    Lanes::select(ok, alive, stopped).store(&mut block[t.n_state + t.n_input][at..]);
}
