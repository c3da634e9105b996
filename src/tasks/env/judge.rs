//! The task's part of a step over a block of lanes: time, memo, reward, ends, observation.

use super::block::{EnvBlock, Sizes, Workspace, book, signal};
use crate::autodiff::lanes::{Lanes, RegisterKernel};
use crate::autodiff::program::BLOCK;
use crate::autodiff::{Mask, Rows, RowsMut, Scalar};
use crate::dynamics::batch::ALIVE;
use crate::tasks::declare::{Masks, loss_of};
use crate::tasks::rig::Rig;
use crate::tasks::task::{MAX_ENDS, Task, View};

/// 1 where the mask holds, else 0.
#[inline(always)]
pub(crate) fn number<S: Scalar>(mask: S::Mask) -> S {
    S::select(mask, S::one(), S::zero())
}

/// The view of one register of environments. `memo` is given apart: before or after the step.
#[inline(always)]
fn view<'a, L: Lanes>(
    rig: &'a Rig,
    horizon: f64,
    block: &'a EnvBlock,
    frames: &'a [[f32; BLOCK]],
    speeds: &'a [[f32; BLOCK]],
    at: usize,
) -> View<'a, L> {
    let book = L::rows(&block.book, at);
    let step = book.get(book::STEP);
    View {
        rig,
        state: L::rows(&block.plant.rows, at),
        frames: L::rows(frames, at),
        speeds_before: L::rows(speeds, at),
        goal: L::rows(&block.goal, at),
        task_state: L::rows(&block.memo, at),
        step,
        clock: (step + book.get(book::OFFSET)) * L::constant(1.0 / horizon),
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

/// Time, memo, reward and ends.
pub(crate) struct Judge<'a, T> {
    pub task: &'a T,
    pub sizes: &'a Sizes,
    pub alive_row: usize,
    pub block: &'a mut EnvBlock,
    pub work: &'a mut Workspace,
}

impl<T: Task> RegisterKernel for Judge<'_, T> {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let Self { sizes, alive_row, block, work, .. } = self;
        let task = self.task;
        let (rig, horizon) = (task.rig(), task.horizon() as f64);
        let (half, zero) = (L::constant(0.5), L::zero());
        let mut pages = L::rows_mut(&mut block.book, at);
        let (was, offset) = (pages.get(book::RUNNING), pages.get(book::OFFSET));
        let running = half.lt(was);
        pages.set(book::STEP, pages.get(book::STEP) + was);

        if sizes.memo > 0 {
            let before = view::<L>(rig, horizon, block, &work.frames, &work.speeds, at);
            task.remember(&before, &mut L::rows_mut(&mut work.memo, at).pen(0));
            let (new, mut memo) = (L::rows(&work.memo, at), L::rows_mut(&mut block.memo, at));
            for k in 0..sizes.memo {
                memo.set(k, L::select(running, new.get(k), memo.get(k)));
            }
        }

        let view = view::<L>(rig, horizon, block, &work.frames, &work.speeds, at);
        task.reward(&view, &mut L::rows_mut(&mut work.terms, at).pen(0));
        task.metrics(&view, &mut L::rows_mut(&mut work.metrics, at).pen(0));
        let success = task.success(&view);
        let loss = loss_of(task, &view);
        let code = reason(task, &view, sizes.end);

        let alive = L::rows(&block.plant.rows, at).get(*alive_row);
        let diverged = alive.lt(L::constant(f64::from(ALIVE) - 0.5));
        let code = L::select(diverged, L::constant((sizes.end + 1) as f64), code);
        // in counts, which are exact up to MAX_HORIZON; shares of the time are not
        let over = (view.step + offset).lt(L::constant(horizon)).not();
        let terms = L::rows(&work.terms, at);
        let counts = running.and(diverged.not());
        let reward = L::select(counts, sum(&terms, sizes.term), zero);

        let mut pages = L::rows_mut(&mut block.book, at);
        for k in 0..sizes.term {
            let sum = pages.get(book::TERMS + k) + L::select(counts, terms.get(k), zero);
            pages.set(book::TERMS + k, sum);
        }
        pages.set(book::RETURN, pages.get(book::RETURN) + reward);
        pages.set(book::REASON, L::select(running, code, pages.get(book::REASON)));
        let truncated = L::select(running, number(over), pages.get(book::TRUNCATED));
        pages.set(book::TRUNCATED, truncated);
        let due = pages.get(book::STEP).lt(pages.get(book::EVENT)).not().and(running);

        let terminated = number::<L>(half.lt(pages.get(book::REASON)));
        let mut signals = L::rows_mut(&mut work.signals, at);
        signals.set(signal::REWARD, reward);
        // a diverged state is the rest state, which stands in for it: it is worth nothing
        signals.set(signal::SUCCESS, L::select(diverged, zero, number(success)));
        signals.set(signal::LOSS, L::select(counts, loss, zero));
        signals.set(signal::DUE, number(due));
        signals.set(signal::TERMINATED, terminated);
        signals.set(signal::TRUNCATED, truncated);
    }
}

/// Of the first `n` numbers.
#[inline(always)]
pub(crate) fn sum<S: Scalar>(numbers: &Rows<'_, S>, n: usize) -> S {
    let mut sum = S::zero();
    for k in 0..n {
        sum += numbers.get(k);
    }
    sum
}

/// All agents' observations before the transforms.
#[inline(always)]
pub(crate) fn observe<S: Scalar, T: Task>(task: &T, sizes: &Sizes, view: &View<'_, S>, raw: &mut RowsMut<'_, S>) {
    for agent in 0..sizes.agent {
        task.observe(view, agent, &mut raw.pen(agent * sizes.raw));
    }
}

/// Observations before the transforms and central states.
pub(crate) struct Observe<'a, T> {
    pub task: &'a T,
    pub sizes: &'a Sizes,
    pub block: &'a EnvBlock,
    pub work: &'a mut Workspace,
}

impl<T: Task> RegisterKernel for Observe<'_, T> {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let (task, Workspace { raw, central, frames, speeds, .. }) = (self.task, &mut *self.work);
        let view = view::<L>(task.rig(), task.horizon() as f64, self.block, frames, speeds, at);
        observe(task, self.sizes, &view, &mut L::rows_mut(raw, at));
        if self.sizes.central > 0 {
            task.central(&view, &mut L::rows_mut(central, at).pen(0));
        }
    }
}

/// The disturbance of one tree, `air` (of 3 numbers or none) included.
#[inline(always)]
pub(crate) fn disturbance<S: Scalar, T: Task>(
    task: &T,
    view: &View<'_, S>,
    tree: usize,
    air: &Rows<'_, S>,
    n_air: usize,
) -> [S; 9] {
    let mut own = task.disturb(view, tree);
    for k in 0..n_air {
        own[k] += air.get(k);
    }
    own
}

/// Disturbances of the coming step into the input rows.
pub(crate) struct Disturb<'a, T> {
    pub task: &'a T,
    pub block: &'a mut EnvBlock,
    pub work: &'a Workspace,
    /// Rows of each tree's nine numbers.
    pub rows: &'a [usize],
}

impl<T: Task> RegisterKernel for Disturb<'_, T> {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let horizon = self.task.horizon() as f64;
        for tree in 0..self.rows.len() {
            let view = view::<L>(self.task.rig(), horizon, self.block, &self.work.frames, &self.work.speeds, at);
            let air = L::rows(&self.block.air, at);
            let own = disturbance(self.task, &view, tree, &air, self.block.air.len());
            let mut input = L::rows_mut(&mut self.block.plant.rows, at);
            for k in 0..9 {
                input.set(self.rows[tree] + k, own[k]);
            }
        }
    }
}
