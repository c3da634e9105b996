//! The task's part of a step over a block of lanes: time, task state, reward, ends, observation.

use super::block::{EnvBlock, Sizes, Workspace, episode_state, signal};
use crate::autodiff::lanes::{Lanes, RegisterKernel};
use crate::autodiff::program::BLOCK;
use crate::autodiff::{Mask, Scalar, StridedView};
use crate::dynamics::batch::ALIVE;
use crate::tasks::declare::{Loss, Masks, Sum};
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

/// Time, task state, reward and ends.
pub(crate) struct EvaluateStep<'a> {
    pub sizes: &'a Sizes,
    pub alive_row: usize,
    /// Of the training loss.
    pub most_loss: f64,
    /// Weight of [`EnvConfig::throttle_change`](crate::tasks::EnvConfig::throttle_change).
    pub throttle_change: f64,
    pub block: &'a mut EnvBlock,
    pub work: &'a mut Workspace,
}

impl<T: Task> RegisterKernel for (&T, EvaluateStep<'_>) {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let (task, EvaluateStep { sizes, alive_row, most_loss, throttle_change, block, work }) = self;
        let task = *task;
        let (robot, horizon) = (task.robot(), task.horizon() as f64);
        let (half, zero) = (L::constant(0.5), L::zero());
        let mut episode = L::rows_mut(&mut block.episode_state, at);
        let (was, last) = (episode.get(episode_state::RUNNING), episode.get(episode_state::LAST));
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
        let mut success = task.success(&view);
        let mut loss = Sum::new();
        task.loss(&view, &mut loss);
        if *throttle_change > 0.0 {
            let cost = view.mean_squared_throttle_difference() * L::constant(*throttle_change);
            L::rows_mut(&mut work.terms, at).set(sizes.term - 1, -cost);
            loss.add("", cost);
        }
        let loss = loss.cut(*most_loss);
        let code = reason(task, &view, sizes.end);

        let alive = L::rows(&block.plant.rows, at).get(*alive_row);
        let diverged = alive.lt(L::constant(f64::from(ALIVE) - 0.5));
        let code = L::select(diverged, L::constant((sizes.end + 1) as f64), code);
        // in counts, which are exact up to MAX_HORIZON; shares of the time are not
        let over = view.step.lt(last).not();
        let terms = L::rows(&work.terms, at);
        let counts = running.and(diverged.not());
        let reward = L::select(counts, sum(&terms, sizes.term), zero);

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

        if sizes.hold > 0 {
            let held = L::select(success.and(counts), episode.get(sizes.held_row()) + L::one(), zero);
            episode.set(sizes.held_row(), held);
            success = L::constant(sizes.hold as f64 - 0.5).lt(held);
        }
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
}

/// Of the first `n` numbers.
#[inline(always)]
pub(crate) fn sum<S: Scalar>(numbers: &StridedView<'_, S>, n: usize) -> S {
    let mut sum = S::zero();
    for k in 0..n {
        sum += numbers.get(k);
    }
    sum
}

/// Observations before the transforms and central states.
pub(crate) struct Observe<'a> {
    pub sizes: &'a Sizes,
    pub block: &'a EnvBlock,
    pub work: &'a mut Workspace,
}

impl<T: Task> RegisterKernel for (&T, Observe<'_>) {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let (task, Observe { sizes, block, work }) = self;
        let (task, Workspace { raw, central, frames, speeds, .. }) = (*task, &mut **work);
        let view = view::<L>(task.robot(), task.horizon() as f64, block, frames, speeds, at);
        let mut raw = L::rows_mut(raw, at);
        for agent in 0..sizes.agent {
            task.observe(&view, agent, &mut raw.writer(agent * sizes.raw));
        }
        if sizes.central > 0 {
            task.central(&view, &mut L::rows_mut(central, at).writer(0));
        }
    }
}

/// A disturbance with `air`, of 3 numbers or none.
#[inline(always)]
pub(crate) fn with_air<S: Scalar>(mut own: [S; 9], air: &StridedView<'_, S>, n_air: usize) -> [S; 9] {
    for k in 0..n_air {
        own[k] += air.get(k);
    }
    own
}

/// Disturbances of the coming step into the input rows.
pub(crate) struct Disturb<'a> {
    pub block: &'a mut EnvBlock,
    pub work: &'a Workspace,
    /// Rows of each tree's nine numbers.
    pub rows: &'a [usize],
}

impl<T: Task> RegisterKernel for (&T, Disturb<'_>) {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let (task, Disturb { block, work, rows }) = self;
        let task = *task;
        for tree in 0..rows.len() {
            let view = view::<L>(task.robot(), task.horizon() as f64, block, &work.frames, &work.speeds, at);
            let air = L::rows(&block.air, at);
            let own = with_air(task.disturb(&view, tree), &air, block.air.len());
            let mut input = L::rows_mut(&mut block.plant.rows, at);
            for k in 0..9 {
                input.set(rows[tree] + k, own[k]);
            }
        }
    }
}
