//! Delay lines and observation transforms over a block of lanes.

use super::block::{EnvBlock, Sizes, Workspace, episode_state};
use crate::autodiff::lanes::{Lanes, RegisterKernel};
use crate::autodiff::program::BLOCK;
use crate::autodiff::{Scalar, StridedViewMut};
use crate::tasks::observation::{Frozen, Moment, Pipeline};

/// Puts the commands at the head of the delay line and takes out those that are due.
pub(crate) struct Shift<'a> {
    pub slots: usize,
    pub n: usize,
    pub block: &'a mut EnvBlock,
    pub command: &'a mut [[f32; BLOCK]],
}

impl RegisterKernel for Shift<'_> {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let delay = L::rows(&self.block.episode_state, at).get(episode_state::DELAY);
        let mut line = L::rows_mut(&mut self.block.line, at);
        let mut command = L::rows_mut(self.command, at);
        shift(self.slots, self.n, delay, &mut line, &mut command);
    }
}

/// As [`Shift`] for any scalar.
#[inline(always)]
pub(crate) fn shift<S: Scalar>(
    slots: usize,
    n: usize,
    delay: S,
    line: &mut StridedViewMut<'_, S>,
    command: &mut StridedViewMut<'_, S>,
) {
    for age in 1..slots {
        let slot = slots - age;
        for k in 0..n {
            line.set(slot * n + k, line.get((slot - 1) * n + k));
        }
    }
    for k in 0..n {
        line.set(k, command.get(k));
    }
    for slot in 1..slots {
        let due = S::constant(slot as f64 - 0.5).lt(delay);
        for k in 0..n {
            command.set(k, S::select(due, line.get(slot * n + k), command.get(k)));
        }
    }
}

/// Observations through the pipeline.
pub(crate) struct Transform<'a> {
    pub pipeline: &'a Pipeline,
    pub sizes: &'a Sizes,
    pub statistics: &'a [f64],
    pub block: &'a mut EnvBlock,
    pub work: &'a mut Workspace,
}

impl RegisterKernel for Transform<'_> {
    #[inline(always)]
    fn run<L: Lanes>(&mut self, at: usize) {
        let (p, s, work) = (self.pipeline, self.sizes, &mut *self.work);
        let half = L::constant(0.5);
        let flags = L::rows(&work.moved, at);
        let (moved, fresh) = (half.lt(flags.get(0)), half.lt(flags.get(1)));
        for agent in 0..s.agent {
            let raw = L::rows(&work.raw, at);
            let mut out = L::rows_mut(&mut work.observation, at);
            let begin = agent * s.observation;
            for k in 0..s.raw {
                out.set(begin + k, raw.get(agent * s.raw + k));
            }
            let moment = Moment {
                moved,
                fresh,
                noise: L::rows(&work.noise, at).from(agent * p.noise),
                theta: L::rows(&self.block.theta, at),
                statistics: Frozen::Constants(self.statistics),
            };
            let mut memory = L::rows_mut(&mut self.block.history, at);
            let mut seen = L::rows_mut(&mut work.seen, at);
            let seen = Some((&mut seen, agent * s.normalised));
            p.run(&moment, &mut memory, agent * p.memory, &mut out, begin, seen);
        }
    }
}
