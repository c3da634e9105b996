//! What leaves a block: columns of its environments into rows of the caller's arrays.

use super::block::signal;
use super::buffers::StepOut;
use super::mask::lanes_of;
use super::stepper::Stepper;
use autodiff::lanes::to_rows;
use autodiff::program::BLOCK;

impl Stepper<'_> {
    /// Reward, flags and information of every environment.
    pub(crate) fn write_signals(&self, out: &mut StepOut<'_>) {
        let (n, s, layout) = (self.n(), &self.core.sizes, &self.core.layout);
        let rows = &self.work.rows;
        let reward = &layout.work.signals.of(rows)[signal::REWARD];
        if s.agent == 1 {
            out.reward.copy_from_slice(&reward[..n]);
        } else {
            let rows = out.reward.chunks_exact_mut(s.agent).zip(reward);
            rows.for_each(|(row, reward)| row.fill(*reward));
        }
        write_flags(self.terminated, out.terminated);
        write_flags(self.truncated, out.truncated);
        self.core.told.write(self.block, rows, out.info);
    }

    /// What the next actions answer to.
    pub(crate) fn write_observation(&self, out: &mut StepOut<'_>) {
        for (columns, rows) in [
            (self.shown(), &mut out.observation),
            (self.central(), &mut out.central),
            (self.theta(), &mut out.privileged),
        ] {
            to_rows(columns, self.n(), rows);
        }
    }

    /// What an episode ended with.
    pub(crate) fn write_end(&self, lane: usize, out: &mut StepOut<'_>) {
        write_row(self.shown(), lane, out.final_observation);
        write_row(self.central(), lane, out.final_central);
    }

    /// What an episode begins with.
    pub(crate) fn write_start(&self, lane: usize, out: &mut StepOut<'_>) {
        self.clear(lane, out);
        write_row(self.shown(), lane, out.observation);
        write_row(self.central(), lane, out.central);
        write_row(self.theta(), lane, out.privileged);
    }

    /// A first step: nothing was rewarded, nothing ended.
    pub(crate) fn clear(&self, lane: usize, out: &mut StepOut<'_>) {
        let (a, n) = (self.core.sizes.agent, self.core.sizes.info);
        out.reward[lane * a..(lane + 1) * a].fill(0.0);
        (out.terminated[lane], out.truncated[lane]) = (0, 0);
        if !out.info.is_empty() {
            out.info[lane * n..(lane + 1) * n].fill(0.0);
        }
    }

    /// Observations as they leave.
    fn shown(&self) -> &[[f32; BLOCK]] {
        let work = &self.core.layout.work;
        if self.core.pipeline.is_empty() { work.raw } else { work.observation }.of(&self.work.rows)
    }

    fn central(&self) -> &[[f32; BLOCK]] {
        self.core.layout.work.central.of(&self.work.rows)
    }

    fn theta(&self) -> &[[f32; BLOCK]] {
        self.core.layout.kept.theta.of(&self.block.kept)
    }
}

/// Flags of a block's environments; most steps have none.
fn write_flags(lanes: u64, flags: &mut [u8]) {
    flags.fill(0);
    lanes_of(lanes).for_each(|lane| flags[lane] = 1);
}

/// One environment's row of an array that may have been left out.
fn write_row(columns: &[[f32; BLOCK]], lane: usize, rows: &mut [f32]) {
    let n = columns.len();
    if n > 0 && !rows.is_empty() {
        for (x, column) in rows[lane * n..(lane + 1) * n].iter_mut().zip(columns) {
            *x = column[lane];
        }
    }
}
