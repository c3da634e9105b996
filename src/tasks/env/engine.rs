//! The door between environments, which know no task, and tasks, which are generic over the scalar.

use super::block::{EnvBlock, Sizes, Workspace};
use super::core::Core;
use super::evaluate_step::{Disturb, EvaluateStep, Observe};
use super::restart::Draft;
use super::transition::{Setting, first_sight, ideal, ideal_terms, transition, view};
use crate::autodiff::lanes::{each_register, each_register_of, first_lanes};
use crate::autodiff::{Recording, Scalar, Trace};
use crate::dynamics::scene::Scene;
use crate::tasks::robot::Robot;
use crate::tasks::task::{Start, Task, TaskReference};
use crate::tasks::task_spec::TaskSpec;

/// A task behind one pointer.
pub(crate) trait Engine: Send + Sync {
    fn robot(&self) -> &Robot;
    fn task_spec(&self) -> &TaskSpec;
    fn horizon(&self) -> usize;
    fn n_agent(&self) -> usize;
    fn start(&self, start: &mut Start<'_>);
    fn event(&self, start: &mut Start<'_>);
    /// What stands around.
    fn scene(&self) -> Scene;
    /// Where it stands with a goal.
    fn place_scene(&self, goal: &[f64], placement: &mut [f64]);
    /// For one environment at the start of an episode.
    fn reference(&self, core: &Core, state: &[f64], goal: &[f64]) -> Option<TaskReference>;
    /// The task's ideal state.
    fn ideal(&self, core: &Core) -> Draft;
    /// Summands of the reward in it.
    fn ideal_terms(&self, core: &Core) -> Vec<f64>;
    /// Time, task state, reward and ends after physics.
    fn evaluate_step(&self, core: &Core, block: &mut EnvBlock, work: &mut Workspace);
    /// Observations before the transforms and central states of the registers of these lanes.
    fn observe(&self, sizes: &Sizes, block: &EnvBlock, work: &mut Workspace, lanes: u64);
    /// Disturbances of the coming step.
    fn disturb(&self, block: &mut EnvBlock, work: &Workspace, rows: &[usize]);
    /// One step as a recording.
    fn record(&self, setting: &Setting<'_>) -> Recording;
}

/// A task with what it says about itself. A tuple, so that every task is compiled as a unit of its own: see [`Kernel::outlined`].
///
/// [`Kernel::outlined`]: crate::autodiff::lanes::Kernel::outlined
impl<T: Task> Engine for (T, TaskSpec) {
    fn robot(&self) -> &Robot {
        self.0.robot()
    }
    fn task_spec(&self) -> &TaskSpec {
        &self.1
    }
    fn horizon(&self) -> usize {
        self.0.horizon()
    }
    fn n_agent(&self) -> usize {
        self.0.n_agent()
    }
    fn start(&self, start: &mut Start<'_>) {
        self.0.start(start);
    }
    fn event(&self, start: &mut Start<'_>) {
        self.0.event(start);
    }
    fn scene(&self) -> Scene {
        self.0.scene()
    }
    fn place_scene(&self, goal: &[f64], placement: &mut [f64]) {
        self.0.place_scene(goal, placement);
    }
    fn reference(&self, core: &Core, state: &[f64], goal: &[f64]) -> Option<TaskReference> {
        let (frames, speeds, task_state) = first_sight(core, state);
        self.0.reference(&view(self.0.robot(), state, &frames, &speeds, goal, &task_state, 0.0, 0.0))
    }
    fn ideal(&self, core: &Core) -> Draft {
        ideal(&self.0, core)
    }
    fn ideal_terms(&self, core: &Core) -> Vec<f64> {
        ideal_terms(&self.0, core)
    }
    fn evaluate_step(&self, core: &Core, block: &mut EnvBlock, work: &mut Workspace) {
        let (sizes, alive_row, most_loss) = (&core.sizes, core.plant.alive_row(), core.bounds.loss);
        each_register(block.plant.occupied, (&self.0, EvaluateStep { sizes, alive_row, most_loss, block, work }));
    }
    fn observe(&self, sizes: &Sizes, block: &EnvBlock, work: &mut Workspace, lanes: u64) {
        let lanes = lanes & first_lanes(block.plant.occupied);
        each_register_of(lanes, (&self.0, Observe { sizes, block, work }));
    }
    fn disturb(&self, block: &mut EnvBlock, work: &Workspace, rows: &[usize]) {
        each_register(block.plant.occupied, (&self.0, Disturb { block, work, rows }));
    }
    fn record(&self, setting: &Setting<'_>) -> Recording {
        Recording::of(setting.layout.n_argument(), |z| {
            let mut y = vec![Trace::zero(); setting.layout.n_result()];
            transition(&self.0, setting, z, &mut y);
            y
        })
    }
}
