//! The lane kernel of a batch of articulated systems: one block of environments, one step.
//!
//! Rows of a block: state, input, `alive`. The model's numbers stand in blocks of their own, one for all environments
//! that share them, so that a batch without randomisation reads them from cache.

use super::kernel::{EXPLODED, STOPPED, heedless};
use super::plant::Block;
use crate::autodiff::lanes::{Kernel, Lanes};
use crate::autodiff::program::BLOCK;
use crate::autodiff::{Mask, safe};
use crate::dynamics::integrate::Grid;
use crate::dynamics::tree::parameters::ParameterView;
use crate::dynamics::tree::scratch::{Scratch, scratch_on_stack};
use crate::dynamics::tree::step::{self, Task};
use crate::dynamics::tree::topology::Topology;

/// The numbers of a model in rows, at one register's place.
#[derive(Clone, Copy)]
struct LaneNumbers<'a> {
    rows: &'a [[f32; BLOCK]],
    at: usize,
}

impl<L: Lanes> ParameterView<L> for LaneNumbers<'_> {
    #[inline(always)]
    fn get(self, k: usize) -> L {
        L::load(&self.rows[k][self.at..])
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

impl Kernel for StepTrees<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        scratch_on_stack!(scratch, self.topology, L);
        for b in 0..self.blocks.len() {
            let Block { occupied, rows, numbers: own } = &mut self.blocks[b];
            let mut at = 0;
            while at < *occupied {
                let numbers = match own {
                    Some(own) => LaneNumbers { rows: own, at },
                    // equal in every lane: the first register's place stays in cache
                    None => LaneNumbers { rows: self.shared, at: 0 },
                };
                step_lanes::<L>(self.topology, numbers, self.grid, rows, at, &mut scratch);
                at += L::WIDTH;
            }
        }
    }
}

/// One register of environments; lanes that stop keep their state, as in the kernel of single multirotors.
#[inline(always)]
fn step_lanes<L: Lanes>(
    t: &Topology,
    numbers: LaneNumbers<'_>,
    grid: Grid,
    block: &mut [[f32; BLOCK]],
    at: usize,
    scratch: &mut Scratch<'_, L>,
) {
    for k in 0..t.n_state {
        scratch.end[k] = L::load(&block[k][at..]);
    }
    for k in 0..t.n_input {
        scratch.input[k] = L::load(&block[t.n_state + k][at..]);
    }
    step::run(t, numbers, Task::Step(grid), scratch);
    let alive = L::load(&block[t.n_state + t.n_input][at..]);
    let was_alive = L::constant(0.5).lt(alive);
    let mut ok = was_alive;
    for k in 0..t.n_state {
        ok = ok.and(safe::is_bounded(scratch.end[k], EXPLODED));
    }
    ok = ok.or(heedless(alive));
    for k in 0..t.n_state {
        let before = L::load(&block[k][at..]);
        L::select(ok, scratch.end[k], before).store(&mut block[k][at..]);
    }
    let stopped = L::select(was_alive, L::constant(f64::from(STOPPED)), alive);
    L::select(ok, alive, stopped).store(&mut block[t.n_state + t.n_input][at..]);
}
