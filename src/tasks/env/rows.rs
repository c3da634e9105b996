//! What leaves a block: columns of its environments into rows of the caller's arrays.

use super::block::{book, signal};
use super::buffers::StepOut;
use super::stepper::Stepper;
use crate::autodiff::program::BLOCK;

impl Stepper<'_> {
    /// Reward, flags and information of every environment.
    pub(crate) fn write_signals(&self, out: &mut StepOut<'_>) {
        let (s, book, signals) = (&self.core.sizes, &self.block.book, &self.work.signals);
        for (row, reward) in out.reward.chunks_exact_mut(s.agent).zip(&signals[signal::REWARD]) {
            row.fill(*reward);
        }
        for (flags, of) in [(&mut out.terminated, signal::TERMINATED), (&mut out.truncated, signal::TRUNCATED)] {
            flags.iter_mut().zip(&signals[of]).for_each(|(flag, x)| *flag = u8::from(*x > 0.5));
        }
        let mut at = 0;
        for group in [&book[book::TOLD], &signals[signal::TOLD], &book[book::TERMS..], &self.work.metrics[..]] {
            transpose(group, self.n(), out.info, s.info(), at);
            at += group.len();
        }
    }

    /// What the next actions answer to.
    pub(crate) fn write_observation(&self, out: &mut StepOut<'_>) {
        for (columns, rows) in [
            (self.shown(), &mut out.observation),
            (&self.work.central, &mut out.central),
            (&self.block.theta, &mut out.privileged),
        ] {
            transpose(columns, self.n(), rows, columns.len(), 0);
        }
    }

    /// What an episode ended with.
    pub(crate) fn write_end(&self, lane: usize, out: &mut StepOut<'_>) {
        write_row(self.shown(), lane, out.final_observation);
        write_row(&self.work.central, lane, out.final_central);
    }

    /// What an episode begins with.
    pub(crate) fn write_start(&self, lane: usize, out: &mut StepOut<'_>) {
        self.clear(lane, out);
        write_row(self.shown(), lane, out.observation);
        write_row(&self.work.central, lane, out.central);
        write_row(&self.block.theta, lane, out.privileged);
    }

    /// A first step: nothing was rewarded, nothing ended.
    pub(crate) fn clear(&self, lane: usize, out: &mut StepOut<'_>) {
        let (a, n) = (self.core.sizes.agent, self.core.sizes.info());
        out.reward[lane * a..(lane + 1) * a].fill(0.0);
        (out.terminated[lane], out.truncated[lane]) = (0, 0);
        if !out.info.is_empty() {
            out.info[lane * n..(lane + 1) * n].fill(0.0);
        }
    }

    /// Observations as they leave.
    fn shown(&self) -> &[[f32; BLOCK]] {
        if self.core.pipeline.is_empty() { &self.work.raw } else { &self.work.observation }
    }
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

/// Columns of up to sixty-four environments into rows of `width` numbers from `first` on; nothing where the rows were
/// left out.
pub(crate) fn transpose(columns: &[[f32; BLOCK]], n_env: usize, rows: &mut [f32], width: usize, first: usize) {
    if columns.is_empty() || rows.is_empty() {
        return;
    }
    let whole = n_env & !3;
    for lane in (0..whole).step_by(4) {
        let four = &mut rows[lane * width..(lane + 4) * width];
        let (a, rest) = four.split_at_mut(width);
        let (b, rest) = rest.split_at_mut(width);
        let (c, d) = rest.split_at_mut(width);
        let columns =
            columns.iter().zip(&mut a[first..]).zip(&mut b[first..]).zip(&mut c[first..]).zip(&mut d[first..]);
        for ((((column, a), b), c), d) in columns {
            (*a, *b, *c, *d) = (column[lane], column[lane + 1], column[lane + 2], column[lane + 3]);
        }
    }
    for lane in whole..n_env {
        let row = &mut rows[lane * width + first..];
        row.iter_mut().zip(columns).for_each(|(x, column)| *x = column[lane]);
    }
}
