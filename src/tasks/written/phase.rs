//! What a task says of a view, written down: one recording per phase, over all that views show.

use crate::robot::Robot;
use crate::task::View;
use crate::task_spec::Field;
use autodiff::trace::Walk;
use autodiff::{Recording, Scalar, Trace, TraceMask};
use base::error::{Error, Result};
use dynamics::frame::FRAME;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How many numbers of each kind a task was shown when it was written down.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewSizes {
    /// Of the state.
    pub state: usize,
    /// Bodies.
    pub frames: usize,
    /// Rotors.
    pub rotors: usize,
    /// Of the goal.
    pub goal: usize,
    /// That the task keeps from step to step.
    pub task_state: usize,
    /// Physical numbers of what flies.
    pub parameters: usize,
    /// Trees: what a disturbance acts on.
    pub trees: usize,
    /// Agents.
    pub agents: usize,
}

impl ViewSizes {
    /// Of a robot's views.
    pub(super) fn of(robot: &Robot, n_agent: usize, goal: usize, task_state: usize) -> Self {
        Self {
            state: robot.n_state(),
            frames: robot.n_frame(),
            rotors: robot.drones().iter().map(|drone| drone.rotors.len()).sum(),
            goal,
            task_state,
            parameters: robot.parameters().len(),
            trees: robot.roots().len(),
            agents: n_agent,
        }
    }

    /// All of them.
    pub(super) fn all(&self) -> [usize; 8] {
        let Self { state, frames, rotors, goal, task_state, parameters, trees, agents } = *self;
        [state, frames, rotors, goal, task_state, parameters, trees, agents]
    }

    /// Numbers of a view.
    pub(super) fn n_view(&self) -> usize {
        self.state + self.frames * FRAME + self.rotors + self.goal + self.task_state + 2
    }

    /// Refuses a robot that shows other numbers.
    ///
    /// # Errors
    /// [`Error::Value`] naming which.
    pub(super) fn check(&self, robot: &Robot, n_agent: usize) -> Result<()> {
        let own = Self::of(robot, n_agent, self.goal, self.task_state);
        let pairs = [
            ("numbers of the state", own.state, self.state),
            ("bodies", own.frames, self.frames),
            ("rotors", own.rotors, self.rotors),
            ("physical numbers", own.parameters, self.parameters),
            ("trees", own.trees, self.trees),
            ("agents", own.agents, self.agents),
        ];
        match pairs.into_iter().find(|(_, own, written)| own != written) {
            None => Ok(()),
            Some((what, own, written)) => {
                let remedy =
                    "The task was written down with other things that fly: write it down anew, or leave its settings.";
                Err(Error::value(format!("{what} of what flies"), own, format!("{written}, as written down"), remedy))
            }
        }
    }
}

/// One phase: numbers of a view, and what they are called.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseRecord {
    /// Of all numbers of a view.
    pub(super) recording: Arc<Recording>,
    /// What the results are, where they have names.
    pub(super) fields: Vec<Field>,
    /// Words beside results without fields: formulas, names and conditions of ends.
    pub(super) words: Vec<[String; 2]>,
}

/// What a phase answers.
#[derive(Default)]
pub(super) struct Answer {
    pub numbers: Vec<Trace>,
    pub fields: Vec<Field>,
    pub words: Vec<[String; 2]>,
}

impl PhaseRecord {
    /// What `ask` answers to views of a robot.
    pub(super) fn of(sizes: &ViewSizes, robot: &Robot, ask: impl FnOnce(&View) -> Answer) -> Self {
        let mut told = Answer::default();
        let recording = Recording::as_written(sizes.n_view(), |z| {
            let [state, frames, speeds, goal, task_state, time] = parts(sizes, z);
            told = ask(&View {
                robot,
                state,
                frames,
                speeds_before: speeds,
                goal,
                task_state,
                step: time[0],
                clock: time[1],
            });
            std::mem::take(&mut told.numbers)
        });
        Self { recording: Arc::new(recording), fields: told.fields, words: told.words }
    }

    /// Computed for a view.
    pub(super) fn on<S: Scalar>(&self, sizes: &ViewSizes, view: &View<'_, S>) -> Walk<'_, S> {
        let given = numbers(sizes, view);
        let mut walk = Walk::new(&self.recording);
        walk.run(&mut |_, k| given[k]);
        walk
    }

    /// The numbers.
    pub(super) fn numbers<S: Scalar>(&self, sizes: &ViewSizes, view: &View<'_, S>) -> Vec<S> {
        let walk = self.on(sizes, view);
        (0..self.recording.n_output()).map(|k| walk.output(k)).collect()
    }

    /// The truths.
    pub(super) fn truths(&self, sizes: &ViewSizes, view: &View) -> Vec<TraceMask> {
        let walk = self.on(sizes, view);
        (0..self.recording.n_output()).map(|k| walk.truth(k)).collect()
    }
}

/// A view's numbers, in order: state, frames, speeds before, goal, task state; step and clock.
fn parts<'a>(sizes: &ViewSizes, z: &'a [Trace]) -> [&'a [Trace]; 6] {
    let mut rest = z;
    [sizes.state, sizes.frames * FRAME, sizes.rotors, sizes.goal, sizes.task_state, 2].map(|n| {
        let (own, behind) = rest.split_at(n);
        rest = behind;
        own
    })
}

/// Likewise of a view, of whose task state more may be shown than is kept.
fn numbers<S: Scalar>(sizes: &ViewSizes, view: &View<'_, S>) -> Vec<S> {
    let mut all = Vec::with_capacity(sizes.n_view());
    for part in [view.state, view.frames, view.speeds_before, view.goal] {
        all.extend_from_slice(part);
    }
    all.extend_from_slice(&view.task_state[..sizes.task_state]);
    all.extend([view.step, view.clock]);
    all
}
