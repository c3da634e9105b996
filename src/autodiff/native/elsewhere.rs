//! Where no machine code is made.

use super::WhyInterpreted;
use super::executable::Row;
use super::layout::{Layout, Rows};
use crate::autodiff::columns::Lines;
use crate::autodiff::program::ValueForm;
use std::sync::Arc;

/// There is none.
#[derive(Debug, Clone)]
pub(crate) enum Code {}

impl Code {
    pub(super) fn of<R: Row>(_: &Arc<ValueForm>, _: &Layout) -> Result<Self, WhyInterpreted> {
        Err(WhyInterpreted::System)
    }
    pub(crate) fn slots(&self) -> Lines {
        match *self {}
    }
    pub(super) fn n_byte(&self) -> usize {
        match *self {}
    }
    pub(crate) fn run<R: Row>(&self, _: &mut Lines, _: &mut [Rows<'_, R>], _: usize) -> bool {
        match *self {}
    }
}

/// Modes are the host's.
pub(crate) fn in_standard_modes<R>(work: impl FnOnce() -> R) -> R {
    work()
}
