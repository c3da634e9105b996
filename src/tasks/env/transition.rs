//! One step of one environment as a recording, without restarts: the function that gradients are taken of. It gives the
//! adjoint that runs in lanes; duals through the recording give Jacobians.

use super::control::clipped;
use super::core::Core;
use super::engine::Engine;
use super::evaluate_step::{sum, with_air};
use super::restart::Draft;
use super::sensing::POSE;
use super::spec::fnv;
use super::step::{Phases, step};
use super::transform::shift;
use crate::autodiff::{Scalar, StridedView, StridedViewMut, System, Trace};
use crate::dynamics::Plant;
use crate::dynamics::frame::FRAME;
use crate::tasks::any_task::Snapshot;
use crate::tasks::config::EnvConfig;
use crate::tasks::declare::Declaration;
use crate::tasks::observation::{Frozen, Moment};
use crate::tasks::robot::Robot;
use crate::tasks::task::{TaskReference, View, streams};
use std::ops::Range;

/// Where everything stands among the arguments and results of a step that gradients are taken of.
///
/// Arguments are, in this order, what is carried from step to step (`state` to `history`), `action`, `parameters`, and
/// what no derivative is taken of (`time` to `statistics`). Results are what is carried, in the same places, then
/// `observation`, `central`, `reward`, `loss`, `poses`.
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
    /// What sensors read behind the step, agent by agent.
    pub readings: Range<usize>,
    /// Normal draws of the noise of observations.
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
    /// Position and attitude of every body that carries a sensor with `gradient = "pose"`, when it reads; a result. Readings
    /// are arguments, so that their gradients come in here.
    pub poses: Range<usize>,
    /// Rows of slopes of readings that a tape keeps.
    slopes: usize,
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
        let readings = next(s.agent * s.reading);
        let (noise, statistics) = (next(s.agent * core.pipeline.noise), next(2 * s.normalised));
        at = history.end;
        let mut next = |n: usize| {
            at += n;
            at - n..at
        };
        let (observation, central) = (next(s.agent * s.observation), next(s.central));
        let reward = central.end;
        let (poses, slopes) = core.sensing.as_ref().map_or((0, 0), |own| (POSE * own.posed.len(), own.n_slope()));
        let poses = reward + 2..reward + 2 + poses;
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
            readings,
            noise,
            statistics,
            observation,
            central,
            reward,
            loss: reward + 1,
            poses,
            slopes,
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
        self.poses.end
    }

    /// Rows of slopes of readings that a tape keeps.
    pub(crate) fn n_slope(&self) -> usize {
        self.slopes
    }

    /// Numbers that a tape keeps of a step and an environment.
    pub(crate) fn n_taped(&self) -> usize {
        self.n_kept() + self.slopes
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
        memory_limit: 0,
        ..config.clone().whole_episodes()
    };
    fnv(serde_json::to_string(&(name, config, varied)).unwrap_or_default().as_bytes())
}

/// What a task calls ideal.
pub(crate) fn ideal(core: &Core) -> Draft {
    let mut own = Draft::new(core);
    let mut start = own.start(core, streams(0, 0, 0), f64::INFINITY, 1.0);
    core.engine.ideal(&mut start);
    own
}

/// The summands of the reward in the task's ideal state.
pub(crate) fn ideal_terms(core: &Core) -> Vec<f64> {
    let Draft { state, goal, task_state, numbers } = ideal(core);
    let seen = Snapshot::of(core.robot(), &core.exposed, &numbers, &state, &goal, task_state);
    seen.ask(core.robot(), |view| core.reward(view).iter().map(|x| x.known().unwrap_or(f64::NAN)).collect())
}

/// What controllers track in an episode that begins so.
pub(crate) fn reference(core: &Core, state: &[f64], goal: &[f64]) -> Option<TaskReference> {
    let blank = vec![0.0; core.sizes.task_state];
    let seen = Snapshot::of(core.robot(), &core.exposed, &core.nominal, state, goal, blank);
    core.engine.reference(&seen.view(core.robot()))
}

/// Results of a step with arguments `z`; see [`StepLayout`].
pub(crate) fn transition(core: &Core, p: &StepLayout, z: &[Trace]) -> Vec<Trace> {
    let (s, zero) = (&core.sizes, Trace::zero());
    let mut y = vec![zero; p.n_result()];
    let (carried, seen) = y.split_at_mut(p.n_carried());
    carried.copy_from_slice(&z[..p.n_carried()]);
    let mut one = Single {
        core,
        task: &*core.engine,
        p,
        z,
        carried,
        seen,
        numbers: numbers(core, &z[p.parameters.clone()]),
        frames: vec![zero; s.frame * FRAME],
        speeds: Vec::new(),
        commands: z[p.action.clone()].to_vec(),
        held: vec![zero; s.held],
        input: vec![zero; core.robot().n_input()],
        step: z[p.time.start],
        goal: &p.goal,
        terms: Vec::new(),
    };
    step(core, &mut one);
    one.goal = &p.goal;
    let loss = core.loss(&one.view());
    one.seen[p.reward - p.n_carried()] = sum(&StridedView::of(&one.terms), s.term);
    one.seen[p.loss - p.n_carried()] = loss;
    y
}

/// One environment in a step.
struct Single<'a> {
    core: &'a Core,
    task: &'a dyn Engine,
    p: &'a StepLayout,
    z: &'a [Trace],
    /// Results: what is carried, as it is now, and what comes behind it.
    carried: &'a mut [Trace],
    seen: &'a mut [Trace],
    numbers: Vec<Trace>,
    frames: Vec<Trace>,
    speeds: Vec<Trace>,
    commands: Vec<Trace>,
    held: Vec<Trace>,
    input: Vec<Trace>,
    step: Trace,
    goal: &'a Range<usize>,
    terms: Vec<Trace>,
}

impl Single<'_> {
    fn state(&self) -> &[Trace] {
        &self.carried[self.p.state.clone()]
    }

    fn view(&self) -> View<'_, Trace> {
        let (robot, goal, task_state) =
            (self.task.robot(), &self.z[self.goal.clone()], &self.carried[self.p.task_state.clone()]);
        let clock = (self.step + self.z[self.p.time.start + 1]) * Trace::constant(1.0 / self.task.horizon() as f64);
        View {
            robot,
            state: StridedView::of(self.state()),
            frames: StridedView::of(&self.frames),
            speeds_before: StridedView::of(&self.speeds),
            goal: StridedView::of(goal),
            task_state: StridedView::of(task_state),
            step: self.step,
            clock,
        }
    }
}

impl Phases for Single<'_> {
    fn command(&mut self) {
        let (control, s) = (&self.core.control, &self.core.sizes);
        for (k, command) in self.commands.iter_mut().enumerate() {
            let (agent, own) = (k / control.n_command, k % control.n_command);
            let moves = own < control.n_command_of[agent];
            *command = if moves { clipped(*command, control.safe[k]).0 } else { Trace::zero() };
        }
        if s.delay > 0 {
            let (mut line, delay) =
                (StridedViewMut::of(&mut self.carried[self.p.line.clone()]), self.z[self.p.time.start + 2]);
            shift(s.delay, s.command, delay, &mut line, &mut StridedViewMut::of(&mut self.commands));
        }
        self.speeds = self.core.speed_rows.iter().map(|k| self.carried[*k]).collect();
    }

    fn frames(&mut self) {
        let state = &self.carried[self.p.state.clone()];
        self.core.exposed.write_frames(&self.numbers, state, &mut self.frames);
    }

    fn disturb(&mut self) {
        let air = StridedView::of(&self.z[self.p.wind.clone()]);
        for (tree, first) in self.task.robot().disturbances().into_iter().enumerate() {
            let own = with_air(self.task.disturb(&self.view(), tree), &air, self.p.wind.len());
            self.input[first..first + own.len()].copy_from_slice(&own);
        }
    }

    fn steer(&mut self, k: usize) {
        let (robot, frames) = (self.task.robot(), StridedView::of(&self.frames));
        self.core.control.steer_one(robot, k, &frames, &self.commands, &mut self.held, &mut self.input);
    }

    /// Constants stay constants where nothing varies.
    fn physics(&mut self) {
        let theta = if self.core.varied.is_empty() { &[] } else { &self.numbers[..] };
        let mut next = self.state().to_vec();
        self.core.exposed.step(self.state(), &self.input, theta, &mut next);
        self.carried[self.p.state.clone()].copy_from_slice(&next);
    }

    fn sense(&mut self) {
        let (core, from) = (self.core, self.p.n_carried());
        if let Some(sensing) = &core.sensing {
            sensing.write_poses(&self.frames, &mut self.seen[self.p.poses.start - from..self.p.poses.end - from]);
        }
    }

    fn evaluate_step(&mut self) {
        self.step += Trace::one();
        if !self.p.task_state.is_empty() {
            let mut task_state = Declaration::default();
            self.task.remember(&self.view(), &mut task_state);
            self.carried[self.p.task_state.clone()].copy_from_slice(&task_state.numbers);
        }
        self.terms = self.core.reward(&self.view());
    }

    fn change_goals(&mut self) {
        self.goal = &self.p.next_goal;
    }

    fn observe(&mut self) {
        let (s, begin) = (&self.core.sizes, self.p.central.start - self.p.n_carried());
        for agent in 0..s.agent {
            let mut own = Declaration::default();
            self.task.observe(&self.view(), agent, &mut own);
            let read = &self.z[self.p.readings.clone()][agent * s.reading..][..s.reading];
            let row = &mut self.seen[agent * s.observation..][..s.raw];
            row[..own.numbers.len()].copy_from_slice(&own.numbers);
            row[s.raw - s.reading..].copy_from_slice(read);
        }
        let mut central = Declaration::default();
        self.task.central(&self.view(), &mut central);
        self.seen[begin..begin + s.central].copy_from_slice(&central.numbers);
    }

    fn transform(&mut self) {
        let (pipeline, s, z, p) = (&self.core.pipeline, &self.core.sizes, self.z, self.p);
        for agent in 0..s.agent {
            let moment = Moment {
                moved: Trace::zero().lt(Trace::one()),
                fresh: Trace::one().lt(Trace::zero()),
                noise: StridedView::of(&z[p.noise.start + agent * pipeline.noise..]),
                theta: StridedView::of(&z[p.parameters.clone()]),
                statistics: Frozen::Arguments(StridedView::of(&z[p.statistics.clone()])),
            };
            let (mut memory, mut seen) =
                (StridedViewMut::of(&mut self.carried[p.history.clone()]), StridedViewMut::of(self.seen));
            pipeline.run(&moment, &mut memory, agent * pipeline.memory, &mut seen, agent * s.observation, None);
        }
    }
}

/// All physical numbers: nominal ones, with those that vary in their places.
fn numbers(core: &Core, theta: &[Trace]) -> Vec<Trace> {
    let mut numbers: Vec<Trace> = core.nominal.iter().map(|x| Trace::constant(*x)).collect();
    for (k, value) in core.varied.iter().zip(theta) {
        numbers[*k] = *value;
    }
    numbers
}

/// The robot's system with the numbers that vary as parameters, if any do.
pub(crate) fn exposed(robot: &Robot, varies: bool) -> Plant {
    let plant = robot.plant().clone();
    if varies { plant.with_parameters() } else { plant }
}
