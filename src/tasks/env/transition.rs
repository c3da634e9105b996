//! One step of one environment as a recording, without restarts: the function that gradients are taken of. It gives the
//! adjoint that runs in lanes; duals through the recording give Jacobians.

use super::block::{episode_state, signal};
use super::core::Core;
use super::episode_start::EpisodeStart;
use super::layout::{EnvLayout, Kept, Part};
use super::phases::{Numbers, Step};
use super::sensing::POSE;
use super::spec::fnv;
use crate::any_task::Snapshot;
use crate::config::EnvConfig;
use crate::robot::Robot;
use crate::task::TaskReference;
use autodiff::{Scalar, Trace};
use dynamics::Plant;
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
    /// Actions of all agents.
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
    /// By how much estimates differ from the truth behind the step, agent by agent: see [`Env::estimate`](super::Env::estimate).
    pub estimate: Range<usize>,
    /// Normal draws of the noise of observations.
    pub noise: Range<usize>,
    /// Statistics of the normaliser: means, then 1/standard deviations.
    pub statistics: Range<usize>,
    /// Of all agents, behind the transforms; a result.
    pub observation: Range<usize>,
    /// The central state; a result.
    pub central: Range<usize>,
    /// Reward of the team; a result.
    pub reward: usize,
    /// Training loss; a result.
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
        let (state, task_state) = (next(core.task.robot().n_state()), next(s.task_state));
        let (line, history) = (next(s.delay * s.command), next(s.history));
        let (action, parameters) = (next(s.command), next(s.theta));
        let (time, goal, next_goal, wind) = (next(3), next(s.goal), next(s.goal), next(s.air));
        let (readings, estimate) = (next(s.agent * s.reading), next(s.estimate));
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
            estimate,
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

    /// Arguments that an environment keeps, and where: beside its state, and what tells the time.
    pub(crate) fn of_kept(&self, kept: &Kept) -> [(Range<usize>, Part); 8] {
        [
            (self.task_state.clone(), kept.task_state),
            (self.line.clone(), kept.line),
            (self.history.clone(), kept.history),
            (self.parameters.clone(), kept.theta),
            (self.goal.clone(), kept.goal),
            (self.wind.clone(), kept.air),
            (self.readings.clone(), kept.readings),
            (self.estimate.clone(), kept.estimate),
        ]
    }

    /// The rows of the episode state that tell the time, in the order of [`StepLayout::time`].
    pub(crate) const CLOCK: [usize; 3] = [episode_state::STEP, episode_state::OFFSET, episode_state::DELAY];

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
    #[doc(hidden)]
    pub fn n_taped(&self) -> usize {
        self.n_kept() + self.slopes
    }

    /// Arguments that differ between environments: those that a tape keeps.
    #[doc(hidden)]
    pub fn n_kept(&self) -> usize {
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
pub(crate) fn ideal(core: &Core) -> EpisodeStart {
    EpisodeStart::ideal(&*core.task, core.sizes.goal, core.sizes.task_state)
}

/// The summands of the reward in the task's ideal state.
pub(crate) fn ideal_terms(core: &Core) -> Vec<f64> {
    let EpisodeStart { state, goal, task_state, numbers, .. } = ideal(core);
    let seen = Snapshot::of(core.robot(), &core.parametric_plant, &numbers, &state, &goal, task_state);
    seen.ask(core.robot(), |view| core.reward(view).iter().map(|x| x.known().unwrap_or(f64::NAN)).collect())
}

/// What controllers track in an episode that begins so.
pub(crate) fn reference(core: &Core, state: &[f64], goal: &[f64]) -> Option<TaskReference> {
    let blank = vec![0.0; core.sizes.task_state];
    let seen = Snapshot::of(core.robot(), &core.parametric_plant, &core.nominal, state, goal, blank);
    core.task.reference(&seen.view(core.robot()))
}

/// Results of a step with arguments `z`; see [`StepLayout`].
pub(crate) fn transition(core: &Core, p: &StepLayout, z: &[Trace]) -> Vec<Trace> {
    let work = &core.layout.work;
    let mut step = Step::new(core, numbers(core, p, z));
    step.contains = false;
    step.clip(&z[p.action.clone()]);
    step.delay();
    step.fly();
    step.goal = z[p.next_goal.clone()].to_vec();
    step.observe();
    step.read();
    step.transform();

    let mut y = vec![Trace::zero(); p.n_result()];
    let kept = &core.layout.kept;
    y[p.state.clone()].copy_from_slice(&step.state);
    for (place, part) in [(&p.task_state, kept.task_state), (&p.line, kept.line), (&p.history, kept.history)] {
        y[place.clone()].copy_from_slice(part.of(&step.numbers.kept));
    }
    for (place, part) in [(&p.observation, work.observation), (&p.central, work.central)] {
        y[place.clone()].copy_from_slice(part.of(&step.numbers.work));
    }
    let signals = work.signals.of(&step.numbers.work);
    (y[p.reward], y[p.loss]) = (signals[signal::REWARD], signals[signal::LOSS]);
    if let Some(sensing) = &core.sensing {
        sensing.write_poses(&step.frames, &mut y[p.poses.clone()]);
    }
    y
}

/// What an environment holds before a step with arguments `z`, in an episode that runs on.
fn numbers(core: &Core, p: &StepLayout, z: &[Trace]) -> Numbers {
    let EnvLayout { kept, work, shared } = &core.layout;
    let mut own = Numbers::blank(core, &z[p.parameters.clone()]);
    own.plant[p.state.clone()].copy_from_slice(&z[p.state.clone()]);
    for (place, part) in p.of_kept(kept) {
        part.of_mut(&mut own.kept).copy_from_slice(&z[place]);
    }
    own.kept[episode_state::RUNNING] = Trace::one();
    StepLayout::CLOCK.into_iter().zip(&z[p.time.clone()]).for_each(|(row, value)| own.kept[row] = *value);
    work.noise.of_mut(&mut own.work).copy_from_slice(&z[p.noise.clone()]);
    work.common.of_mut(&mut own.work)[0] = Trace::one();
    shared.statistics.of_mut(&mut own.shared).copy_from_slice(&z[p.statistics.clone()]);
    own
}

/// The robot's system with the numbers that vary as parameters, if any do.
pub(crate) fn parametric_plant(robot: &Robot, varies: bool) -> Plant {
    let plant = robot.plant().clone();
    if varies { plant.with_parameters() } else { plant }
}
