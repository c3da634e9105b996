//! One step of one environment over any scalar: the function that gradients are taken of.
//!
//! The same parts as in `core`, in the same order (commands, physics, judgement, transforms), without restarts. Recorded
//! once it gives the adjoint that runs in lanes; on duals it gives Jacobians.

use super::control::clipped;
use super::core::{Core, LATCHED_PER_AGENT};
use super::engine::Engine;
use super::evaluate_step::observe;
use super::spec::fnv;
use super::transform::shift;
use crate::autodiff::{Scalar, StridedView, StridedViewMut, System};
use crate::dynamics::Plant;
use crate::dynamics::frame::FRAME;
use crate::tasks::config::EnvConfig;
use crate::tasks::declare::{Goal, loss_of};
use crate::tasks::observation::{Frozen, Moment};
use crate::tasks::robot::Robot;
use crate::tasks::task::{MAX_TERMS, Start, Task, View, streams};
use std::ops::Range;

/// Where everything stands among the arguments and results of a step that gradients are taken of.
///
/// Arguments are, in this order, what is carried from step to step (`state` to `history`), `action`, `parameters`, and
/// what no derivative is taken of (`time` to `statistics`). Results are what is carried, in the same places, then
/// `observation`, `central`, `reward`, `loss`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StepLayout {
    /// Physics, in the layout of the task's robot.
    pub state: Range<usize>,
    /// What the task keeps from step to step.
    pub task_state: Range<usize>,
    /// Commands on their way.
    pub line: Range<usize>,
    /// Memory of the transforms.
    pub history: Range<usize>,
    /// Of all agents.
    pub action: Range<usize>,
    /// Physical numbers that differ between environments.
    pub parameters: Range<usize>,
    /// Steps since the episode began, steps the clock was ahead, steps of delay.
    pub time: Range<usize>,
    /// What stays through the episode but for events.
    pub goal: Range<usize>,
    /// The goal behind the step, which is what is observed: another one where an event changed it.
    pub next_goal: Range<usize>,
    /// Randomised wind, m/s.
    pub wind: Range<usize>,
    /// Normal draws of the sensors.
    pub noise: Range<usize>,
    /// Of the normaliser: means, then 1/standard deviations.
    pub statistics: Range<usize>,
    /// Of all agents, behind the transforms; a result.
    pub observation: Range<usize>,
    /// The central state; a result.
    pub central: Range<usize>,
    /// Of the team; a result.
    pub reward: usize,
    /// A result.
    pub loss: usize,
    /// Of everything that steps and gradients depend on beside numbers of environments.
    config_hash: u64,
}

impl StepLayout {
    pub(crate) fn of(core: &Core) -> Self {
        let s = &core.sizes;
        let mut at = 0;
        let mut next = |n: usize| {
            at += n;
            at - n..at
        };
        let (state, task_state) = (next(core.engine.robot().n_state()), next(s.task_state));
        let (line, history) = (next(s.delay * s.command), next(s.history));
        let (action, parameters) = (next(s.command), next(s.theta));
        let (time, goal, next_goal, wind) = (next(3), next(s.goal), next(s.goal), next(s.air));
        let (noise, statistics) = (next(s.agent * core.pipeline.noise), next(2 * s.normalised));
        at = history.end;
        let mut next = |n: usize| {
            at += n;
            at - n..at
        };
        let (observation, central) = (next(s.agent * s.observation), next(s.central));
        let reward = central.end;
        Self {
            state,
            task_state,
            line,
            history,
            action,
            parameters,
            time,
            goal,
            next_goal,
            wind,
            noise,
            statistics,
            observation,
            central,
            reward,
            loss: reward + 1,
            config_hash: core.config_hash,
        }
    }

    /// Numbers that go from step to step.
    pub fn n_carried(&self) -> usize {
        self.history.end
    }

    /// Numbers of arguments.
    pub fn n_argument(&self) -> usize {
        self.statistics.end
    }

    /// Numbers of results.
    pub fn n_result(&self) -> usize {
        self.loss + 1
    }

    /// Arguments that differ between environments: those that a tape keeps.
    pub(crate) fn n_kept(&self) -> usize {
        self.noise.end
    }
}

/// 64 bits over what decides which gradient a step has: the task's name, the configuration without numbers that only
/// decide what is drawn, and which physical numbers vary.
pub(crate) fn config_hash(name: &str, config: &EnvConfig, varied: &[usize]) -> u64 {
    let config = EnvConfig {
        n_env: 0,
        seed: 0,
        first_environment: 0,
        randomise: None,
        difficulty: 0.0,
        stagger: false,
        memory_limit: 0,
        ..config.clone()
    };
    fnv(serde_json::to_string(&(name, config, varied)).unwrap_or_default().as_bytes())
}

/// What a task calls ideal.
pub(crate) struct Ideal {
    pub state: Vec<f64>,
    pub goal: Vec<f64>,
    pub task_state: Vec<f64>,
    pub numbers: Vec<f64>,
}

/// The task's ideal state.
pub(crate) fn ideal<T: Task>(task: &T, core: &Core) -> Ideal {
    let (robot, s) = (task.robot(), &core.sizes);
    let (state, numbers) = (robot.rest().to_vec(), core.nominal.clone());
    let mut own = Ideal { state, goal: vec![0.0; s.goal], task_state: vec![0.0; s.task_state], numbers };
    let [reset, draw, once] = streams(0, 0, 0);
    task.ideal(&mut Start {
        robot,
        state: &mut own.state,
        goal: Goal::over(&mut own.goal),
        task_state: &mut own.task_state,
        numbers: &mut own.numbers,
        reset,
        task: draw,
        once,
        event_at: f64::INFINITY,
        difficulty: 1.0,
    });
    own
}

/// The summands of the reward in the task's ideal state, in `f64`.
pub(crate) fn ideal_terms<T: Task>(task: &T, core: &Core) -> Vec<f64> {
    let (robot, s) = (task.robot(), &core.sizes);
    let Ideal { state, goal, task_state, numbers } = ideal(task, core);
    let mut frames = vec![0.0; robot.n_frame() * FRAME];
    core.exposed.write_frames(&numbers, &state, &mut frames);
    let speeds: Vec<f64> = core.speed_rows.iter().map(|k| state[*k]).collect();
    let view = view(robot, &state, &frames, &speeds, &goal, &task_state, 0.0, 0.0);
    let mut terms = vec![0.0; s.term];
    task.reward(&view, &mut StridedViewMut::of(&mut terms).writer(0));
    terms
}

/// Frames, rotor speeds and a blank task state of a state with nominal numbers.
pub(crate) fn first_sight(core: &Core, state: &[f64]) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let mut frames = vec![0.0; core.engine.robot().n_frame() * FRAME];
    core.exposed.write_frames(&core.nominal, state, &mut frames);
    (frames, core.speed_rows.iter().map(|k| state[*k]).collect(), vec![0.0; core.sizes.task_state])
}

/// What a transition needs of the core, without the task.
pub(crate) struct Setting<'a> {
    pub core: &'a Core,
    pub layout: &'a StepLayout,
}

/// `y` = step of `z`; see [`StepLayout`].
pub(crate) fn transition<S: Scalar, T: Task>(task: &T, setting: &Setting<'_>, z: &[S], y: &mut [S]) {
    let (core, p) = (setting.core, setting.layout);
    let (robot, s) = (task.robot(), &core.sizes);
    let numbers = numbers(core, &z[p.parameters.clone()]);
    let mut state = z[p.state.clone()].to_vec();
    let (task_state, goal) = (&z[p.task_state.clone()], &z[p.goal.clone()]);
    let [step, offset, delay] = [z[p.time.start], z[p.time.start + 1], z[p.time.start + 2]];
    let speeds: Vec<S> = core.speed_rows.iter().map(|k| state[*k]).collect();
    let mut frames = vec![S::zero(); robot.n_frame() * FRAME];
    core.exposed.write_frames(&numbers, &state, &mut frames);

    let mut commands = z[p.action.clone()].to_vec();
    let n_command = core.control.n_command;
    for (k, command) in commands.iter_mut().enumerate() {
        *command = clipped(*command, core.control.safe[k % n_command]).0;
    }
    let (carried, seen) = y.split_at_mut(p.n_carried());
    carried[p.line.clone()].copy_from_slice(&z[p.line.clone()]);
    if s.delay > 0 {
        let mut line = StridedViewMut::of(&mut carried[p.line.clone()]);
        shift(s.delay, s.command, delay, &mut line, &mut StridedViewMut::of(&mut commands));
    }

    let horizon = S::constant(1.0 / task.horizon() as f64);
    let mut input = vec![S::zero(); robot.n_input()];
    if !core.disturbance_rows.is_empty() {
        let view = view(robot, &state, &frames, &speeds, goal, task_state, step, (step + offset) * horizon);
        for (tree, first) in robot.disturbances().into_iter().enumerate() {
            input[first..first + 9].copy_from_slice(&task.disturb(&view, tree));
            for (k, wind) in z[p.wind.clone()].iter().enumerate() {
                input[first + k] += *wind;
            }
        }
    }
    let mut held = vec![S::zero(); s.agent * LATCHED_PER_AGENT];
    let mut next = state.clone();
    for inner in 0..core.control.steps {
        if inner > 0 && core.control.needs_frames() {
            core.exposed.write_frames(&numbers, &state, &mut frames);
        }
        core.control.steer_one(robot, inner, &StridedView::of(&frames), &commands, &mut held, &mut input);
        physics(core, &state, &input, &numbers, &mut next);
        std::mem::swap(&mut state, &mut next);
    }
    core.exposed.write_frames(&numbers, &state, &mut frames);

    let (step, clock) = (step + S::one(), (step + S::one() + offset) * horizon);
    if s.task_state > 0 {
        let before = view(robot, &state, &frames, &speeds, goal, task_state, step, clock);
        task.remember(&before, &mut StridedViewMut::of(&mut carried[p.task_state.clone()]).writer(0));
    }
    let new_task_state = carried[p.task_state.clone()].to_vec();
    let view = view(robot, &state, &frames, &speeds, goal, &new_task_state, step, clock);
    let mut terms = [S::zero(); MAX_TERMS];
    task.reward(&view, &mut StridedViewMut::of(&mut terms).writer(0));
    let mut raw = vec![S::zero(); s.agent * s.raw];
    let shown = View { goal: StridedView::of(&z[p.next_goal.clone()]), ..view };
    observe(task, s, &shown, &mut StridedViewMut::of(&mut raw));
    carried[p.state.clone()].copy_from_slice(&state);
    carried[p.history.clone()].copy_from_slice(&z[p.history.clone()]);
    let always = S::zero().lt(S::one());
    for agent in 0..s.agent {
        let begin = agent * s.observation;
        seen[begin..begin + s.raw].copy_from_slice(&raw[agent * s.raw..(agent + 1) * s.raw]);
        let moment = Moment {
            moved: always,
            fresh: S::one().lt(S::zero()),
            noise: StridedView::of(&z[p.noise.start + agent * core.pipeline.noise..]),
            theta: StridedView::of(&z[p.parameters.clone()]),
            statistics: Frozen::Arguments(StridedView::of(&z[p.statistics.clone()])),
        };
        let mut memory = StridedViewMut::of(&mut carried[p.history.clone()]);
        core.pipeline.run(
            &moment,
            &mut memory,
            agent * core.pipeline.memory,
            &mut StridedViewMut::of(seen),
            begin,
            None,
        );
    }
    if s.central > 0 {
        let begin = p.central.start - p.n_carried();
        task.central(&shown, &mut StridedViewMut::of(seen).writer(begin));
    }
    let mut reward = S::zero();
    for term in terms.iter().take(s.term) {
        reward += *term;
    }
    seen[p.reward - p.n_carried()] = reward;
    seen[p.loss - p.n_carried()] = loss_of(task, &view);
}

/// All physical numbers: nominal ones, with those that vary in their places.
fn numbers<S: Scalar>(core: &Core, theta: &[S]) -> Vec<S> {
    let mut numbers: Vec<S> = core.nominal.iter().map(|x| S::constant(*x)).collect();
    for (k, value) in core.varied.iter().zip(theta) {
        numbers[*k] = *value;
    }
    numbers
}

/// One step of the physics; constants stay constants where nothing varies.
fn physics<S: Scalar>(core: &Core, state: &[S], input: &[S], numbers: &[S], next: &mut [S]) {
    let theta = if core.varied.is_empty() { &[] } else { numbers };
    core.exposed.step(state, input, theta, next);
}

#[expect(clippy::too_many_arguments, reason = "the parts of a view, named at its only callers")]
pub(crate) fn view<'a, S: Scalar>(
    robot: &'a Robot,
    state: &'a [S],
    frames: &'a [S],
    speeds: &'a [S],
    goal: &'a [S],
    task_state: &'a [S],
    step: S,
    clock: S,
) -> View<'a, S> {
    View {
        robot,
        state: StridedView::of(state),
        frames: StridedView::of(frames),
        speeds_before: StridedView::of(speeds),
        goal: StridedView::of(goal),
        task_state: StridedView::of(task_state),
        step,
        clock,
    }
}

/// The robot's system with the numbers that vary as parameters, if any do.
pub(crate) fn exposed(engine: &dyn Engine, varies: bool) -> Plant {
    let plant = engine.robot().plant().clone();
    if varies { plant.with_parameters() } else { plant }
}
