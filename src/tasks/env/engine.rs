//! The door between environments, which know no task, and tasks, which are generic over the scalar.

use super::block::{EnvBlock, Sizes, Workspace};
use super::core::Core;
use super::evaluate_step::{Disturb, EvaluateStep, Observe};
use crate::autodiff::lanes::{each_register, each_register_of, first_lanes};
use crate::tasks::any_task::AnyTask;
use crate::tasks::task::Task;

/// A task behind one pointer, with what it does in lanes.
pub(crate) trait Engine: AnyTask {
    /// Time, task state, reward and ends after physics.
    fn evaluate_lanes(&self, core: &Core, block: &mut EnvBlock, work: &mut Workspace);
    /// Observations before the transforms and central states of the registers of these lanes.
    fn observe_lanes(&self, sizes: &Sizes, block: &EnvBlock, work: &mut Workspace, lanes: u64);
    /// Disturbances of the coming step.
    fn disturb_lanes(&self, block: &mut EnvBlock, work: &Workspace, rows: &[usize]);
}

impl<T: Task> Engine for T {
    fn evaluate_lanes(&self, core: &Core, block: &mut EnvBlock, work: &mut Workspace) {
        let (occupied, throttle_change) = (block.plant.occupied, core.throttle_change);
        let (sizes, alive_row, most_loss) = (&core.sizes, core.plant.alive_row(), core.bounds.loss);
        let step = EvaluateStep { sizes, alive_row, most_loss, throttle_change, block, work };
        each_register(occupied, (self, step));
    }
    fn observe_lanes(&self, sizes: &Sizes, block: &EnvBlock, work: &mut Workspace, lanes: u64) {
        let lanes = lanes & first_lanes(block.plant.occupied);
        each_register_of(lanes, (self, Observe { sizes, block, work }));
    }
    fn disturb_lanes(&self, block: &mut EnvBlock, work: &Workspace, rows: &[usize]) {
        each_register(block.plant.occupied, (self, Disturb { block, work, rows }));
    }
}
