//! The door between environments, which know no task, and tasks, which are generic over the scalar.

use super::block::{EnvBlock, Sizes, Workspace};
use super::judge::{Disturb, Judge, Observe};
use crate::autodiff::lanes::dispatch;
use crate::tasks::rig::Rig;
use crate::tasks::sheet::Sheet;
use crate::tasks::task::{Start, Task};

/// A task behind one pointer.
pub(crate) trait Engine: Send + Sync {
    fn rig(&self) -> &Rig;
    fn sheet(&self) -> &Sheet;
    fn horizon(&self) -> usize;
    fn n_agent(&self) -> usize;
    fn start(&self, start: &mut Start<'_>);
    fn event(&self, start: &mut Start<'_>);
    fn ideal(&self, start: &mut Start<'_>);
    /// Time, memo, reward, ends and observation after physics.
    fn judge(&self, sizes: &Sizes, alive_row: usize, block: &mut EnvBlock, work: &mut Workspace);
    /// Observation and central state where episodes begin.
    fn observe(&self, sizes: &Sizes, block: &EnvBlock, work: &mut Workspace, lanes: u64);
    /// Disturbances of the coming step.
    fn disturb(&self, block: &mut EnvBlock, work: &Workspace, rows: &[usize]);
}

/// A task with its sheet.
pub(crate) struct Typed<T> {
    pub task: T,
    pub sheet: Sheet,
}

impl<T: Task> Engine for Typed<T> {
    fn rig(&self) -> &Rig {
        self.task.rig()
    }
    fn sheet(&self) -> &Sheet {
        &self.sheet
    }
    fn horizon(&self) -> usize {
        self.task.horizon()
    }
    fn n_agent(&self) -> usize {
        self.task.n_agent()
    }
    fn start(&self, start: &mut Start<'_>) {
        self.task.start(start);
    }
    fn event(&self, start: &mut Start<'_>) {
        self.task.event(start);
    }
    fn ideal(&self, start: &mut Start<'_>) {
        self.task.ideal(start);
    }
    fn judge(&self, sizes: &Sizes, alive_row: usize, block: &mut EnvBlock, work: &mut Workspace) {
        dispatch(Judge { task: &self.task, sizes, alive_row, block, work });
    }
    fn observe(&self, sizes: &Sizes, block: &EnvBlock, work: &mut Workspace, lanes: u64) {
        dispatch(Observe { task: &self.task, sizes, block, work, lanes });
    }
    fn disturb(&self, block: &mut EnvBlock, work: &Workspace, rows: &[usize]) {
        dispatch(Disturb { task: &self.task, block, work, rows });
    }
}
