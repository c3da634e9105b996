//! The task's part of a step over a block of lanes: time, memo, reward, ends, observation.

use super::block::{EnvBlock, Sizes, Workspace, book, signal};
use super::core::AGAIN;
use crate::autodiff::lanes::Lanes;
use crate::autodiff::program::BLOCK;
use crate::autodiff::{Mask, RowsMut, Scalar};
use crate::dynamics::batch::ALIVE;
use crate::tasks::declare::{Masks, loss_of};
use crate::tasks::rig::Rig;
use crate::tasks::task::{MAX_ENDS, Task, View};
use pulp::{Simd, WithSimd};

/// 1 where the mask holds, else 0.
#[inline(always)]
pub(crate) fn number<S: Scalar>(mask: S::Mask) -> S {
    S::select(mask, S::one(), S::zero())
}

/// The view of one register of environments. `memo` is given apart: before or after the step.
#[inline(always)]
fn view<'a, S: Simd>(
    rig: &'a Rig,
    horizon: f64,
    block: &'a EnvBlock,
    frames: &'a [[f32; BLOCK]],
    speeds: &'a [[f32; BLOCK]],
    at: usize,
) -> View<'a, Lanes<S>> {
    let book = Lanes::<S>::rows(&block.book, at);
    let step = book.get(book::STEP);
    View {
        rig,
        state: Lanes::rows(&block.plant.rows, at),
        frames: Lanes::rows(frames, at),
        speeds_before: Lanes::rows(speeds, at),
        goal: Lanes::rows(&block.goal, at),
        task_state: Lanes::rows(&block.memo, at),
        step,
        clock: (step + book.get(book::OFFSET)) * Lanes::constant(1.0 / horizon),
    }
}

/// The reasons' number: 0 for none, else that of the first.
#[inline(always)]
pub(crate) fn reason<S: Scalar, T: Task>(task: &T, view: &View<'_, S>, n_end: usize) -> S {
    let mut masks = [S::one().lt(S::zero()); MAX_ENDS];
    task.ends(view, &mut Masks::new(&mut masks));
    let mut code = S::zero();
    for i in 0..n_end {
        let k = n_end - 1 - i;
        code = S::select(masks[k], S::constant((k + 1) as f64), code);
    }
    code
}

/// After physics: everything but the observation's transforms.
pub(crate) struct Judge<'a, T> {
    pub task: &'a T,
    pub sizes: &'a Sizes,
    pub alive_row: usize,
    pub block: &'a mut EnvBlock,
    pub work: &'a mut Workspace,
}

impl<T: Task> WithSimd for Judge<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let mut at = 0;
        while at < BLOCK {
            judge::<S, T>(self.task, self.sizes, self.alive_row, self.block, self.work, at);
            at += Lanes::<S>::WIDTH;
        }
    }
}

#[inline(always)]
fn judge<S: Simd, T: Task>(
    task: &T,
    sizes: &Sizes,
    alive_row: usize,
    block: &mut EnvBlock,
    work: &mut Workspace,
    at: usize,
) {
    let (rig, horizon) = (task.rig(), task.horizon() as f64);
    let (half, zero) = (Lanes::<S>::constant(0.5), Lanes::<S>::zero());
    let mut pages = Lanes::<S>::rows_mut(&mut block.book, at);
    let (was, offset) = (pages.get(book::RUNNING), pages.get(book::OFFSET));
    let running = half.lt(was);
    pages.set(book::STEP, pages.get(book::STEP) + was);

    if sizes.memo > 0 {
        let before = view::<S>(rig, horizon, block, &work.frames, &work.speeds, at);
        task.remember(&before, &mut Lanes::rows_mut(&mut work.memo, at).pen(0));
        let (new, mut memo) = (Lanes::<S>::rows(&work.memo, at), Lanes::<S>::rows_mut(&mut block.memo, at));
        for k in 0..sizes.memo {
            memo.set(k, Lanes::select(running, new.get(k), memo.get(k)));
        }
    }

    let view = view::<S>(rig, horizon, block, &work.frames, &work.speeds, at);
    task.reward(&view, &mut Lanes::rows_mut(&mut work.terms, at).pen(0));
    task.metrics(&view, &mut Lanes::rows_mut(&mut work.metrics, at).pen(0));
    let success = task.success(&view);
    let loss = loss_of(task, &view);
    let code = reason(task, &view, sizes.end);
    observe(task, sizes, &view, &mut Lanes::rows_mut(&mut work.raw, at));
    if sizes.central > 0 {
        task.central(&view, &mut Lanes::rows_mut(&mut work.central, at).pen(0));
    }

    let alive = Lanes::<S>::rows(&block.plant.rows, at).get(alive_row);
    let diverged = alive.lt(Lanes::constant(f64::from(ALIVE) - 0.5));
    let code = Lanes::select(diverged, Lanes::constant((sizes.end + 1) as f64), code);
    // in counts, which are exact up to MAX_HORIZON; shares of the time are not
    let over = (view.step + offset).lt(Lanes::constant(horizon)).not();
    let terms = Lanes::<S>::rows(&work.terms, at);
    let mut reward = zero;
    for k in 0..sizes.term {
        reward += terms.get(k);
    }
    let counts = running.and(diverged.not());
    let reward = Lanes::select(counts, reward, zero);

    let mut pages = Lanes::<S>::rows_mut(&mut block.book, at);
    for k in 0..sizes.term {
        let sum = pages.get(book::TERMS + k) + Lanes::select(counts, terms.get(k), zero);
        pages.set(book::TERMS + k, sum);
    }
    pages.set(book::RETURN, pages.get(book::RETURN) + reward);
    pages.set(book::REASON, Lanes::select(running, code, pages.get(book::REASON)));
    let truncated = Lanes::select(running, number(over), pages.get(book::TRUNCATED));
    pages.set(book::TRUNCATED, truncated);
    let due = pages.get(book::STEP).lt(pages.get(book::EVENT)).not().and(running);

    let terminated = number::<Lanes<S>>(half.lt(pages.get(book::REASON)));
    let mut signals = Lanes::<S>::rows_mut(&mut work.signals, at);
    signals.set(signal::REWARD, reward);
    // a diverged state is the rest state, which stands in for it: it is worth nothing
    signals.set(signal::SUCCESS, Lanes::select(diverged, zero, number(success)));
    signals.set(signal::LOSS, Lanes::select(counts, loss, zero));
    signals.set(signal::DUE, number(due));
    signals.set(signal::TERMINATED, terminated);
    signals.set(signal::TRUNCATED, truncated);
}

/// All agents' observations before the transforms.
#[inline(always)]
pub(crate) fn observe<S: Scalar, T: Task>(task: &T, sizes: &Sizes, view: &View<'_, S>, raw: &mut RowsMut<'_, S>) {
    for agent in 0..sizes.agent {
        task.observe(view, agent, &mut raw.pen(agent * sizes.raw));
    }
}

/// Observations and central state of some lanes as they stand, after restarts and events.
pub(crate) struct Observe<'a, T> {
    pub task: &'a T,
    pub sizes: &'a Sizes,
    pub block: &'a EnvBlock,
    pub work: &'a mut Workspace,
    /// Bit i stands for lane i; the same as numbers stand in row [`AGAIN`] of [`Workspace::moved`].
    pub lanes: u64,
}

impl<T: Task> WithSimd for Observe<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let (work, sizes) = (self.work, self.sizes);
        let horizon = self.task.horizon() as f64;
        let half = Lanes::<S>::constant(0.5);
        let n_raw = sizes.agent * sizes.raw;
        let width = Lanes::<S>::WIDTH;
        let mut at = 0;
        while at < BLOCK {
            let group = if width == BLOCK { u64::MAX } else { ((1u64 << width) - 1) << at };
            if self.lanes & group != 0 {
                let view = view::<S>(self.task.rig(), horizon, self.block, &work.frames, &work.speeds, at);
                observe(self.task, sizes, &view, &mut Lanes::rows_mut(&mut work.again, at));
                if sizes.central > 0 {
                    self.task.central(&view, &mut Lanes::rows_mut(&mut work.again, at).pen(n_raw));
                }
                // the neighbours keep what they saw
                let chosen = half.lt(Lanes::<S>::rows(&work.moved, at).get(AGAIN));
                let new = Lanes::<S>::rows(&work.again, at);
                let mut raw = Lanes::<S>::rows_mut(&mut work.raw, at);
                for k in 0..n_raw {
                    raw.set(k, Lanes::select(chosen, new.get(k), raw.get(k)));
                }
                let mut central = Lanes::<S>::rows_mut(&mut work.central, at);
                for k in 0..sizes.central {
                    central.set(k, Lanes::select(chosen, new.get(n_raw + k), central.get(k)));
                }
            }
            at += width;
        }
    }
}

/// Disturbances of the coming step into the input rows.
pub(crate) struct Disturb<'a, T> {
    pub task: &'a T,
    pub block: &'a mut EnvBlock,
    pub work: &'a Workspace,
    /// Rows of each tree's nine numbers.
    pub rows: &'a [usize],
}

impl<T: Task> WithSimd for Disturb<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let horizon = self.task.horizon() as f64;
        let mut at = 0;
        while at < BLOCK {
            for tree in 0..self.rows.len() {
                let view = view::<S>(self.task.rig(), horizon, self.block, &self.work.frames, &self.work.speeds, at);
                let mut own = self.task.disturb(&view, tree);
                if !self.block.air.is_empty() {
                    let wind = Lanes::<S>::rows(&self.block.air, at);
                    for k in 0..3 {
                        own[k] += wind.get(k);
                    }
                }
                let mut input = Lanes::<S>::rows_mut(&mut self.block.plant.rows, at);
                for k in 0..9 {
                    input.set(self.rows[tree] + k, own[k]);
                }
            }
            at += Lanes::<S>::WIDTH;
        }
    }
}
