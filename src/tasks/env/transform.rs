//! Delay lines and observation transforms over a block of lanes.

use super::block::{EnvBlock, Sizes, Workspace, episode_state};
use super::mask::{lanes_of, spread_bits};
use super::stepper::Stepper;
use crate::autodiff::lanes::{Lanes, RegisterKernel, each_register};
use crate::autodiff::program::BLOCK;
use crate::autodiff::{Scalar, StridedViewMut};
use crate::rng::{Purpose, Stream};
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

impl Stepper<'_> {
    /// Observations through the pipeline, where environments moved on and where episodes begin.
    pub(crate) fn transformed(&mut self, moved: u64, fresh: u64) {
        let (core, n) = (self.core, self.n());
        if core.pipeline.is_empty() {
            return;
        }
        spread_bits(moved, &mut self.work.moved[0]);
        spread_bits(fresh, &mut self.work.moved[1]);
        if core.pipeline.noise > 0 {
            (0..n).for_each(|lane| self.draw_noise(lane));
        }
        let (pipeline, sizes, statistics) = (&core.pipeline, &core.sizes, &core.frozen[..]);
        each_register(n, Transform { pipeline, sizes, statistics, block: self.block, work: self.work });
        if core.collects && core.sizes.normalised > 0 {
            self.collect(moved);
        }
    }

    /// Adds what the normaliser saw of the lanes that moved on.
    fn collect(&mut self, moved: u64) {
        let (core, block, work) = (self.core, &mut *self.block, &*self.work);
        let n = core.sizes.normalised;
        // what one environment sees must not spoil the statistics of all: 0 where all is finite, else NaN
        let mut sound = [0.0_f32; BLOCK];
        for column in &work.seen {
            sound.iter_mut().zip(column).for_each(|(sum, x)| *sum += 0.0 * x);
        }
        let moved = lanes_of(moved).filter(|lane| sound[*lane] == 0.0).fold(0, |mask, lane| mask | (1_u64 << lane));
        block.count += (moved.count_ones() as usize * core.sizes.agent) as f64;
        for (k, column) in work.seen.iter().enumerate() {
            let (mean, [sum, square]) = (core.statistics.mean[k % n], &mut block.sums[k % n]);
            for lane in lanes_of(moved) {
                let x = f64::from(column[lane]) - mean;
                *sum += x;
                *square += x * x;
            }
        }
    }

    /// Noise of one environment in this step: the same whenever it is asked for.
    fn draw_noise(&mut self, lane: usize) {
        let n = self.core.sizes.agent * self.core.pipeline.noise;
        let step = self.block.episode_state[episode_state::STEP][lane] as u64;
        let [seed, environment, episode] = self.key(lane);
        // a normal draw takes four words
        let mut stream = Stream::restore([seed, environment, episode, Purpose::SENSORS.0], 4 * n as u64 * step);
        self.work.noise.iter_mut().for_each(|row| row[lane] = stream.normal() as f32);
    }
}
