//! Observations through their stages: draws of noise, the program, statistics.

use super::block::episode_state;
use super::mask::{lanes_of, spread_bits};
use super::stepper::Stepper;
use autodiff::program::BLOCK;
use rng::{NORMAL_WORDS, Purpose, normals};

impl Stepper<'_> {
    /// Observations through the pipeline, where environments moved on and where episodes begin.
    pub(crate) fn transformed(&mut self, moved: u64, fresh: u64) {
        let (core, n) = (self.core, self.n());
        let Some(program) = &core.programs().transform else { return };
        let flags = core.layout.work.common.of_mut(&mut self.work.rows);
        spread_bits(moved, &mut flags[0]);
        spread_bits(fresh, &mut flags[1]);
        if core.sizes.noise > 0 {
            self.draw_noise(n);
        }
        program.run(&mut self.work.scratch.transform, core, self.block, &mut self.work.rows, n);
        if core.collects && core.sizes.normalised > 0 {
            self.collect(moved);
        }
    }

    /// Adds what the normaliser saw of the lanes that moved on.
    fn collect(&mut self, moved: u64) {
        let (core, block) = (self.core, &mut *self.block);
        let (n, seen) = (core.sizes.normalised, core.layout.work.seen.of(&self.work.rows));
        // what one environment sees must not spoil the statistics of all: 0 where all is finite, else NaN
        let mut sound = [0.0_f32; BLOCK];
        for column in seen {
            sound.iter_mut().zip(column).for_each(|(sum, x)| *sum += 0.0 * x);
        }
        let moved = lanes_of(moved).filter(|lane| sound[*lane] == 0.0).fold(0, |mask, lane| mask | (1_u64 << lane));
        block.count += (moved.count_ones() as usize * core.sizes.agent) as f64;
        for (k, column) in seen.iter().enumerate() {
            let (mean, [sum, square]) = (core.statistics.mean[k % n], &mut block.sums[k % n]);
            for lane in lanes_of(moved) {
                let x = f64::from(column[lane]) - mean;
                *sum += x;
                *square += x * x;
            }
        }
    }

    /// Noise of the first `n` environments in this step: the same whenever it is asked for.
    fn draw_noise(&mut self, n: usize) {
        let own = self.core.sizes.agent * self.core.sizes.noise;
        let mut streams = [([0; 4], 0); BLOCK];
        for (lane, stream) in streams[..n].iter_mut().enumerate() {
            let step = self.block.kept[episode_state::STEP][lane] as u64;
            let [seed, environment, episode] = self.key(lane);
            *stream = ([seed, environment, episode, Purpose::SENSORS.0], (NORMAL_WORDS * own) as u64 * step);
        }
        let rows = self.core.layout.work.noise.of_mut(&mut self.work.rows);
        normals(n, own, |lane| streams[lane], |lane, k, x| rows[k][lane] = x as f32);
    }
}
