//! Where the numbers of an environment stand: the one table of rows that steps, snapshots, tapes and memory limits go by.
//!
//! A row holds a number of sixty-four environments. Physics have rows of their own
//! ([`Block`](dynamics::batch::Block)); the others are of three kinds: what an environment keeps between steps, what a step
//! works with, and what all environments share.

use super::block::{Sizes, beginning, signal};
use dynamics::frame::FRAME;
use std::ops::Range;

/// Rows that belong together.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Part {
    start: usize,
    len: usize,
}

impl Part {
    pub(crate) fn len(self) -> usize {
        self.len
    }

    pub(crate) fn range(self) -> Range<usize> {
        self.start..self.start + self.len
    }

    /// These rows of all of its kind.
    pub(crate) fn of<T>(self, rows: &[T]) -> &[T] {
        &rows[self.range()]
    }

    /// As [`Part::of`], to write.
    pub(crate) fn of_mut<T>(self, rows: &mut [T]) -> &mut [T] {
        &mut rows[self.range()]
    }

    /// The next `len` rows behind `end`.
    fn next(end: &mut usize, len: usize) -> Self {
        *end += len;
        Self { start: *end - len, len }
    }
}

/// The parts of a kind of rows, in their order.
macro_rules! parts {
    ($(#[$about:meta])* $kind:ident, of $s:ident { $($(#[doc = $meaning:literal])* $name:ident: $len:expr;)* }) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(crate) struct $kind {
            $($(#[doc = $meaning])* pub $name: Part,)*
            /// Rows in all.
            pub count: usize,
        }

        impl $kind {
            pub(crate) fn of($s: &Sizes) -> Self {
                let mut count = 0;
                $(let $name = Part::next(&mut count, $len);)*
                Self { $($name,)* count }
            }
        }
    };
}

parts! {
    /// What an environment keeps between steps, beside its physics.
    Kept, of s {
        /// See [`episode_state`].
        episode_state: s.episode_state();
        /// Written where an episode begins and in events.
        goal: s.goal;
        /// Written by the task in every step.
        task_state: s.task_state;
        /// Physical numbers that vary between environments, as drawn.
        theta: s.theta;
        /// Wind, m/s, where it is randomised.
        air: s.air;
        /// Commands on their way, newest first.
        line: s.delay * s.command;
        /// Memory of the transforms of observations, agent by agent.
        history: s.history;
        /// What sensors read, agent by agent.
        readings: s.agent * s.reading;
        /// By how much estimates differ from the truth, agent by agent.
        estimate: s.estimate;
        /// State and goal that the episode began with, where controllers fly.
        beginning: s.beginning;
    }
}

parts! {
    /// What a step works with, and what it tells.
    Working, of s {
        /// Of the caller.
        action: s.action;
        /// Clipped and delayed.
        command: s.command;
        /// Rotor speeds before the step.
        speeds: s.rotor;
        /// Motion of every body.
        frames: s.frame * FRAME;
        /// One agent's observation after the other, before the transforms.
        raw: s.agent * s.raw;
        /// One agent's after the other, behind them.
        observation: s.agent * s.observation;
        central: s.central;
        metrics: s.metric;
        /// See [`signal`].
        signals: signal::COUNT;
        /// Normal draws for the observations.
        noise: s.agent * s.noise;
        /// What the stages of all agents share: which lanes moved on, which begin an episode, numbers that vary.
        common: 2 + s.theta;
        /// What the normaliser sees.
        seen: s.agent * s.normalised;
        /// See [`beginning`].
        beginning: beginning::COUNT;
        /// Drawn for a start or an event.
        draws: s.draw;
    }
}

parts! {
    /// What all environments share.
    Shared, of s {
        /// Of the normaliser: means, then 1/standard deviations.
        statistics: 2 * s.normalised;
    }
}

/// All parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct EnvLayout {
    pub kept: Kept,
    pub work: Working,
    pub shared: Shared,
}

impl EnvLayout {
    pub(crate) fn of(sizes: &Sizes) -> Self {
        Self { kept: Kept::of(sizes), work: Working::of(sizes), shared: Shared::of(sizes) }
    }
}
