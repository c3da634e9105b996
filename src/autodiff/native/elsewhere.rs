//! Where no machine code is made.

use super::WhyInterpreted;
use super::executable::Row;
use super::layout::{RowLayout, Rows};
use crate::columns::Lines;
use crate::program::ValueForm;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

/// There is none.
#[derive(Debug, Clone)]
pub(crate) enum Code {}

impl Code {
    pub(super) fn of<R: Row>(_: &Arc<ValueForm>, _: &RowLayout) -> Result<Self, WhyInterpreted> {
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
    pub(super) fn run_within<R: Row>(&self, _: &mut Lines, _: &mut [Rows<'_, R>], _: Range<usize>) -> bool {
        match *self {}
    }
}

/// One for all: there are no locks here that a process made by `fork` would find held.
#[derive(Debug)]
#[doc(hidden)]
pub struct PerProcess<T>(OnceLock<T>);

impl<T: Default + Sync> PerProcess<T> {
    pub const fn new() -> Self {
        Self(OnceLock::new())
    }
    pub fn get(&'static self) -> &'static T {
        self.0.get_or_init(T::default)
    }
}

/// Modes are the host's.
#[doc(hidden)]
pub fn in_standard_modes<R>(work: impl FnOnce() -> R) -> R {
    work()
}
