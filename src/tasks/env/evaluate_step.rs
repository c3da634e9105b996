//! The task's part of a step over a block of lanes: time, task state, reward, ends, observation.

use super::block::{EnvBlock, Sizes, Workspace, episode_state, signal};
use super::core::AGAIN;
use crate::autodiff::lanes::{Lanes, RegisterKernel};
use crate::autodiff::program::BLOCK;
use crate::autodiff::{Mask, Scalar, StridedViewMut};
use crate::dynamics::batch::ALIVE;
use crate::tasks::declare::{Masks, loss_of};
use crate::tasks::robot::Robot;
use crate::tasks::task::{MAX_ENDS, Task, View};

/// 1 where the mask holds, else 0.
#[inline(always)]
pub(crate) fn number<S: Scalar>(mask: S::Mask) -> S {
    S::select(mask, S::one(), S::zero())
}

/// The view of one register of environments. `task_state` is given apart: before or after the step.
#[inline(always)]
fn view<'a, L: Lanes>(
    robot: &'a Robot,
    horizon: f64,
    block: &'a EnvBlock,
    frames: &'a [[f32; BLOCK]],
    speeds: &'a [[f32; BLOCK]],
    at: usize,
) -> View<'a, L> {
    let episode_state = L::rows(&block.episode_state, at);
    let step = episode_state.get(episode_state::STEP);
    View {
        robot,
        state: L::rows(&block.plant.rows, at),
        frames: L::rows(frames, at),
        speeds_before: L::rows(speeds, at),
        goal: L::rows(&block.goal, at),
        task_state: L::rows(&block.task_state, at),
        step,
        clock: (step + episode_state.get(episode_state::OFFSET)) * L::constant(1.0 / horizon),
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

/// The task's part of a step but for the transforms of observations: all of it behind physics, or the observation alone
/// where episodes begin and goals change. One kernel, since what tasks observe is most of what there is to compile.
pub(crate) struct EvaluateStep<'a, T> {
    pub task: &'a T,
    pub sizes: &'a Sizes,
    pub alive_row: usize,
    pub block: &'a mut EnvBlock,
    pub work: &'a mut Workspace,
    /// Whether these lanes alone are to be observed, into [`Workspace::again`]; bit i stands for lane i.
    pub again: Option<u64>,
}

impl<T: Task> RegisterKernel for EvaluateStep<'_, T> {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let Self { task, sizes, block, work, .. } = self;
        let group = if L::WIDTH == BLOCK { u64::MAX } else { ((1u64 << L::WIDTH) - 1) << at };
        match self.again {
            None => advance::<L, T>(task, sizes, self.alive_row, block, work, at),
            Some(lanes) if lanes & group == 0 => return,
            Some(_) => {}
        }
        let Workspace { raw, central, again, frames, speeds, .. } = &mut **work;
        let view = view::<L>(task.robot(), task.horizon() as f64, block, frames, speeds, at);
        let (seen, state) = if self.again.is_none() {
            (&mut raw[..], &mut central[..])
        } else {
            again.split_at_mut(sizes.agent * sizes.raw)
        };
        observe(*task, sizes, &view, &mut L::rows_mut(seen, at));
        if sizes.central > 0 {
            task.central(&view, &mut L::rows_mut(state, at).writer(0));
        }
    }
}

/// Time, task state, reward and ends.
#[inline(always)]
fn advance<L: Lanes, T: Task>(
    task: &T,
    sizes: &Sizes,
    alive_row: usize,
    block: &mut EnvBlock,
    work: &mut Workspace,
    at: usize,
) {
    let (robot, horizon) = (task.robot(), task.horizon() as f64);
    let (half, zero) = (L::constant(0.5), L::zero());
    let mut episode = L::rows_mut(&mut block.episode_state, at);
    let (was, offset) = (episode.get(episode_state::RUNNING), episode.get(episode_state::OFFSET));
    let running = half.lt(was);
    episode.set(episode_state::STEP, episode.get(episode_state::STEP) + was);

    if sizes.task_state > 0 {
        let before = view::<L>(robot, horizon, block, &work.frames, &work.speeds, at);
        task.remember(&before, &mut L::rows_mut(&mut work.task_state, at).writer(0));
        let (new, mut task_state) = (L::rows(&work.task_state, at), L::rows_mut(&mut block.task_state, at));
        for k in 0..sizes.task_state {
            task_state.set(k, L::select(running, new.get(k), task_state.get(k)));
        }
    }

    let view = view::<L>(robot, horizon, block, &work.frames, &work.speeds, at);
    task.reward(&view, &mut L::rows_mut(&mut work.terms, at).writer(0));
    task.metrics(&view, &mut L::rows_mut(&mut work.metrics, at).writer(0));
    let success = task.success(&view);
    let loss = loss_of(task, &view);
    let code = reason(task, &view, sizes.end);

    let alive = L::rows(&block.plant.rows, at).get(alive_row);
    let diverged = alive.lt(L::constant(f64::from(ALIVE) - 0.5));
    let code = L::select(diverged, L::constant((sizes.end + 1) as f64), code);
    // in counts, which are exact up to MAX_HORIZON; shares of the time are not
    let over = (view.step + offset).lt(L::constant(horizon)).not();
    let terms = L::rows(&work.terms, at);
    let mut reward = zero;
    for k in 0..sizes.term {
        reward += terms.get(k);
    }
    let counts = running.and(diverged.not());
    let reward = L::select(counts, reward, zero);

    let mut episode = L::rows_mut(&mut block.episode_state, at);
    for k in 0..sizes.term {
        let sum = episode.get(episode_state::TERMS + k) + L::select(counts, terms.get(k), zero);
        episode.set(episode_state::TERMS + k, sum);
    }
    episode.set(episode_state::RETURN, episode.get(episode_state::RETURN) + reward);
    episode.set(episode_state::REASON, L::select(running, code, episode.get(episode_state::REASON)));
    let truncated = L::select(running, number(over), episode.get(episode_state::TRUNCATED));
    episode.set(episode_state::TRUNCATED, truncated);
    let due = episode.get(episode_state::STEP).lt(episode.get(episode_state::EVENT)).not().and(running);

    let terminated = number::<L>(half.lt(episode.get(episode_state::REASON)));
    let mut signals = L::rows_mut(&mut work.signals, at);
    signals.set(signal::REWARD, reward);
    // a diverged state is the rest state, which stands in for it: it is worth nothing
    signals.set(signal::SUCCESS, L::select(diverged, zero, number(success)));
    signals.set(signal::LOSS, L::select(counts, loss, zero));
    signals.set(signal::DUE, number(due));
    signals.set(signal::TERMINATED, terminated);
    signals.set(signal::TRUNCATED, truncated);
}

/// All agents' observations before the transforms.
#[inline(always)]
pub(crate) fn observe<S: Scalar, T: Task>(
    task: &T,
    sizes: &Sizes,
    view: &View<'_, S>,
    raw: &mut StridedViewMut<'_, S>,
) {
    for agent in 0..sizes.agent {
        task.observe(view, agent, &mut raw.writer(agent * sizes.raw));
    }
}

/// What was observed again takes the place of what was observed; the neighbours keep what they saw.
pub(crate) struct Replace<'a> {
    pub sizes: &'a Sizes,
    pub work: &'a mut Workspace,
}

impl RegisterKernel for Replace<'_> {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let n_raw = self.sizes.agent * self.sizes.raw;
        let chosen = L::constant(0.5).lt(L::rows(&self.work.moved, at).get(AGAIN));
        let new = L::rows(&self.work.again, at);
        let mut raw = L::rows_mut(&mut self.work.raw, at);
        for k in 0..n_raw {
            raw.set(k, L::select(chosen, new.get(k), raw.get(k)));
        }
        let mut central = L::rows_mut(&mut self.work.central, at);
        for k in 0..self.sizes.central {
            central.set(k, L::select(chosen, new.get(n_raw + k), central.get(k)));
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

impl<T: Task> RegisterKernel for Disturb<'_, T> {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let horizon = self.task.horizon() as f64;
        for tree in 0..self.rows.len() {
            let view = view::<L>(self.task.robot(), horizon, self.block, &self.work.frames, &self.work.speeds, at);
            let mut own = self.task.disturb(&view, tree);
            if !self.block.air.is_empty() {
                let wind = L::rows(&self.block.air, at);
                for k in 0..3 {
                    own[k] += wind.get(k);
                }
            }
            let mut input = L::rows_mut(&mut self.block.plant.rows, at);
            for k in 0..9 {
                input.set(self.rows[tree] + k, own[k]);
            }
        }
    }
}
