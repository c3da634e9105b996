//! One step of sixty-four environments: commands, physics, judgement, restarts, rows.

use super::block::{EnvBlock, LATCHED, Sizes, Workspace, episode_state, signal};
use super::buffers::StepOut;
use super::control::{Control, MAX_SLOTS};
use super::engine::Engine;
use super::evaluate_step::Replace;
use super::gradient::Slot;
use super::transform::{Shift, Transform};
use super::transition::{Setting, StepLayout};
use crate::autodiff::lanes::each_register;
use crate::autodiff::program::BLOCK;
use crate::autodiff::{Program, Recording};
use crate::dynamics::batch::{ALIVE, Plant, STOPPED};
use crate::error::Result;
use crate::rng::{Purpose, Stream};
use crate::tasks::config::Autoreset;
use crate::tasks::declare::Goal;
use crate::tasks::observation::{Pipeline, Statistics};
use crate::tasks::randomise::Randomiser;
use crate::tasks::robot::Robot;
use crate::tasks::task::{Start, streams};
use std::sync::{Arc, OnceLock};

/// Everything that all environments share and that a step only reads.
pub(crate) struct Core {
    pub engine: Box<dyn Engine>,
    pub plant: Plant,
    pub control: Control,
    pub sizes: Sizes,
    pub pipeline: Pipeline,
    pub randomiser: Randomiser,
    /// Share of what makes episodes hard, 0 to 1.
    pub difficulty: f64,
    /// Numbers that vary between environments.
    pub varied: Vec<usize>,
    pub nominal: Vec<f64>,
    /// The robot's system, with the numbers that vary as parameters if any do: what gradients are taken of.
    pub exposed: crate::dynamics::Plant,
    pub disturbance_rows: Vec<usize>,
    pub speed_rows: Vec<usize>,
    pub statistics: Statistics,
    /// Means, then 1/standard deviations, as stages read them.
    pub frozen: Arc<[f64]>,
    pub collects: bool,
    pub delay: (usize, usize),
    pub mode: Autoreset,
    pub stagger: bool,
    pub first_environment: u64,
    /// See [`config_hash`](super::transition::config_hash).
    pub config_hash: u64,
    /// One step in `f64`, made when it is first asked for.
    pub program: OnceLock<Program>,
}

/// One bit per lane of a row of zeros and ones. All equal is the rule, and found without a loop over lanes.
fn bits(row: &[f32; BLOCK]) -> u64 {
    let (any, all) = row.iter().fold((0, u32::MAX), |(any, all), x| (any | x.to_bits(), all & x.to_bits()));
    if any == 0 {
        return 0;
    }
    if all == 1.0_f32.to_bits() {
        return u64::MAX;
    }
    row.iter().enumerate().fold(0, |mask, (lane, x)| mask | (u64::from(*x > 0.5) << lane))
}

/// The first `n` bits.
pub(crate) fn first_bits(n: usize) -> u64 {
    if n >= BLOCK { u64::MAX } else { (1 << n) - 1 }
}

/// Numbers of the bits that are set.
pub(crate) fn lanes_of(mut mask: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = mask.trailing_zeros() as usize;
        (lane < BLOCK).then(|| {
            mask &= mask - 1;
            lane
        })
    })
}

impl Core {
    fn robot(&self) -> &Robot {
        self.engine.robot()
    }

    /// One step as a recording.
    pub(crate) fn record(&self, layout: &StepLayout) -> Recording {
        self.engine.record(&Setting { core: self, layout })
    }

    /// One step as a program.
    pub(crate) fn program(&self, layout: &StepLayout) -> Result<&Program> {
        if let Some(program) = self.program.get() {
            return Ok(program);
        }
        let compiled = Program::compile(&self.record(layout))?;
        Ok(self.program.get_or_init(|| compiled))
    }

    /// One step of a block; `n` environments of it are real, the first has number `first` in the batch.
    pub(crate) fn step(
        &self,
        block: &mut EnvBlock,
        work: &mut Workspace,
        (first, n): (usize, usize),
        actions: &[f32],
        out: &mut StepOut<'_>,
        mut slot: Option<(&StepLayout, &mut Slot)>,
    ) {
        let real = first_bits(n);
        let running = bits(&block.episode_state[episode_state::RUNNING]) & real;
        if let Some((layout, slot)) = &mut slot {
            slot.open(layout, block, running);
        }
        block.moved = if slot.is_some() { 0 } else { u64::MAX };
        self.act(block, work, actions);
        self.replace_diverged(block, running);
        self.plant.frames(&block.plant, &mut work.frames);
        self.engine.evaluate_step(&self.sizes, self.plant.alive_row(), block, work, None);
        let ended = (bits(&work.signals[signal::TERMINATED]) | bits(&work.signals[signal::TRUNCATED])) & running;
        let events = bits(&work.signals[signal::DUE]) & running & !ended;
        if events != 0 {
            lanes_of(events).for_each(|lane| self.event(block, work, lane, first));
            // the reward was for the old goal, the next action is for the new one
            self.reobserve(block, work, events);
        }
        self.transform(block, work, running, 0, first);
        if let Some((layout, slot)) = slot {
            let alive = bits(&block.plant.rows[self.plant.alive_row()]);
            slot.close(layout, block, &work.action, &work.noise, ended, alive);
        }
        self.write_signals(block, work, n, out);
        for lane in lanes_of(ended) {
            self.write_ends(work, lane, out);
        }
        let restarts = match self.mode {
            Autoreset::SameStep => ended,
            Autoreset::NextStep => !running & real,
            Autoreset::Disabled => 0,
        };
        if self.mode != Autoreset::SameStep {
            let alive = self.plant.alive_row();
            for lane in lanes_of(ended) {
                block.episode_state[episode_state::RUNNING][lane] = 0.0;
                block.plant.rows[alive][lane] = STOPPED;
            }
        }
        if restarts != 0 {
            lanes_of(restarts).for_each(|lane| self.restart(block, work, lane, first));
            self.reobserve(block, work, restarts);
            self.transform(block, work, restarts, restarts, first);
        }
        if self.mode == Autoreset::NextStep {
            lanes_of(restarts).for_each(|lane| self.clear(lane, out));
        }
        self.write_observation(block, work, n, out);
    }

    /// Restarts the lanes of a mask with their next episode and shows them.
    pub(crate) fn reset(
        &self,
        block: &mut EnvBlock,
        work: &mut Workspace,
        (first, n): (usize, usize),
        which: u64,
        out: &mut StepOut<'_>,
    ) {
        let which = which & first_bits(n);
        if which == 0 {
            return;
        }
        block.moved |= which;
        lanes_of(which).for_each(|lane| self.restart(block, work, lane, first));
        self.reobserve(block, work, which);
        self.transform(block, work, which, which, first);
        for lane in lanes_of(which) {
            self.clear(lane, out);
            self.write_row(self.shown(work), lane, out.observation);
            self.write_row(&work.central, lane, out.central);
            self.write_row(&block.theta, lane, out.privileged);
        }
    }

    /// Where physics gave up, the rest state stands in for one that may be of any size: its episode ends in this step, with
    /// an observation to look at.
    fn replace_diverged(&self, block: &mut EnvBlock, running: u64) {
        let alive = bits(&block.plant.rows[self.plant.alive_row()]);
        for lane in lanes_of(!alive & running) {
            block.plant.rows.iter_mut().zip(self.robot().rest()).for_each(|(row, x)| row[lane] = *x as f32);
        }
    }

    /// Actions to physics.
    fn act(&self, block: &mut EnvBlock, work: &mut Workspace, actions: &[f32]) {
        self.control.decode(actions, work, &mut block.episode_state);
        if self.sizes.delay > 0 {
            let (slots, n) = (self.sizes.delay, self.sizes.command);
            each_register(block.plant.occupied, Shift { slots, n, block, command: &mut work.command });
        }
        for (row, speed) in work.speeds.iter_mut().zip(&self.speed_rows) {
            *row = block.plant.rows[*speed];
        }
        if !self.disturbance_rows.is_empty() {
            self.plant.frames(&block.plant, &mut work.frames);
            self.engine.disturb(block, work, &self.disturbance_rows);
        }
        for step in 0..self.control.steps {
            if self.control.needs_frames() {
                self.plant.frames(&block.plant, &mut work.frames);
            }
            self.control.steer(self.robot(), &self.plant, step, block, work);
            self.plant.step(std::slice::from_mut(&mut block.plant));
        }
    }

    /// Observations and central states of a block as it stands, into all rows.
    pub(crate) fn show(
        &self,
        block: &mut EnvBlock,
        work: &mut Workspace,
        (first, n): (usize, usize),
        out: &mut StepOut<'_>,
    ) {
        for (row, speed) in work.speeds.iter_mut().zip(&self.speed_rows) {
            *row = block.plant.rows[*speed];
        }
        self.reobserve(block, work, u64::MAX);
        self.transform(block, work, 0, 0, first);
        self.write_observation(block, work, n, out);
    }

    /// Observation and central state of these lanes, before the transforms; the others' stay as they are.
    fn reobserve(&self, block: &mut EnvBlock, work: &mut Workspace, lanes: u64) {
        self.plant.frames(&block.plant, &mut work.frames);
        for (lane, chosen) in work.moved[AGAIN].iter_mut().enumerate() {
            *chosen = ((lanes >> lane) & 1) as f32;
        }
        self.engine.evaluate_step(&self.sizes, self.plant.alive_row(), block, work, Some(lanes));
        each_register(block.plant.occupied, Replace { sizes: &self.sizes, work });
    }

    fn transform(&self, block: &mut EnvBlock, work: &mut Workspace, moved: u64, fresh: u64, first: usize) {
        if self.pipeline.is_empty() {
            return;
        }
        for lane in 0..BLOCK {
            work.moved[0][lane] = ((moved >> lane) & 1) as f32;
            work.moved[1][lane] = ((fresh >> lane) & 1) as f32;
        }
        if self.pipeline.noise > 0 {
            (0..block.plant.occupied).for_each(|lane| self.draw_noise(block, work, lane, first));
        }
        let (pipeline, sizes, statistics) = (&self.pipeline, &self.sizes, &self.frozen[..]);
        each_register(block.plant.occupied, Transform { pipeline, sizes, statistics, block, work });
        if self.collects && self.sizes.normalised > 0 {
            self.collect(block, work, moved);
        }
    }

    /// Adds what the normaliser saw of the lanes that moved on.
    fn collect(&self, block: &mut EnvBlock, work: &Workspace, moved: u64) {
        let n = self.sizes.normalised;
        // what one environment sees must not spoil the statistics of all: 0 where all is finite, else NaN
        let mut sound = [0.0_f32; BLOCK];
        for column in &work.seen {
            sound.iter_mut().zip(column).for_each(|(sum, x)| *sum += 0.0 * x);
        }
        let moved = lanes_of(moved).filter(|lane| sound[*lane] == 0.0).fold(0, |mask, lane| mask | (1_u64 << lane));
        block.count += (moved.count_ones() as usize * self.sizes.agent) as f64;
        for (k, column) in work.seen.iter().enumerate() {
            let (mean, [sum, square]) = (self.statistics.mean[k % n], &mut block.sums[k % n]);
            for lane in lanes_of(moved) {
                let x = f64::from(column[lane]) - mean;
                *sum += x;
                *square += x * x;
            }
        }
    }

    /// Noise of one environment in this step: the same whenever it is asked for.
    fn draw_noise(&self, block: &EnvBlock, work: &mut Workspace, lane: usize, first: usize) {
        let n = self.sizes.agent * self.pipeline.noise;
        let step = block.episode_state[episode_state::STEP][lane] as u64;
        let environment = self.first_environment + (first + lane) as u64;
        let key = [block.seed[lane], environment, block.episode[lane], Purpose::SENSORS.0];
        // a normal draw takes four words
        let mut stream = Stream::restore(key, 4 * n as u64 * step);
        work.noise.iter_mut().for_each(|row| row[lane] = stream.normal() as f32);
    }

    /// Begins the next episode of a lane.
    pub(crate) fn restart(&self, block: &mut EnvBlock, work: &mut Workspace, lane: usize, first: usize) {
        block.episode[lane] = block.episode[lane].wrapping_add(1);
        let key = [block.seed[lane], self.first_environment + (first + lane) as u64, block.episode[lane]];
        work.state.copy_from_slice(self.robot().rest());
        work.goal.fill(0.0);
        work.memory.fill(0.0);
        work.numbers.copy_from_slice(&self.nominal);
        let [reset, task, once] = streams(key[0], key[1], key[2]);
        let mut start = Start {
            robot: self.robot(),
            state: &mut work.state,
            goal: Goal::over(&mut work.goal),
            task_state: &mut work.memory,
            numbers: &mut work.numbers,
            reset,
            task,
            once,
            event_at: f64::INFINITY,
            difficulty: self.difficulty,
        };
        self.engine.start(&mut start);
        let event_at = start.event_at;
        let mut wind = [0.0; 3];
        self.randomiser.apply(key, self.difficulty, &mut work.numbers, &mut wind);
        self.randomiser.hover(self.robot().rest(), &work.numbers, &mut work.state);
        self.install(block, work, lane, wind);
        let offset = self.offset(key);
        let delay = self.draw_delay(key);
        for row in &mut block.episode_state {
            row[lane] = 0.0;
        }
        block.episode_state[episode_state::OFFSET][lane] = offset;
        block.episode_state[episode_state::RUNNING][lane] = 1.0;
        block.episode_state[episode_state::EVENT][lane] = event_at.min(f64::from(f32::MAX)) as f32;
        block.episode_state[episode_state::DELAY][lane] = delay;
        for (k, row) in block.line.iter_mut().enumerate() {
            row[lane] = self.control.safe[k % self.control.n_command] as f32;
        }
        block.history.iter_mut().for_each(|row| row[lane] = 0.0);
        block.started |= 1 << lane;
    }

    /// Copies the numbers of a start into a lane.
    pub(crate) fn install(&self, block: &mut EnvBlock, work: &mut Workspace, lane: usize, wind: [f64; 3]) {
        let write = |rows: &mut [[f32; BLOCK]], values: &[f64]| {
            rows.iter_mut().zip(values).for_each(|(row, value)| row[lane] = *value as f32);
        };
        write(&mut block.plant.rows, &work.state);
        block.plant.rows[self.plant.alive_row()][lane] = ALIVE;
        write(&mut block.goal, &work.goal);
        write(&mut block.task_state, &work.memory);
        write(&mut block.air, &wind);
        if !self.varied.is_empty() {
            self.plant.set_numbers(&mut block.plant, lane, &work.numbers, &self.varied);
            for (row, k) in block.theta.iter_mut().zip(&self.varied) {
                row[lane] = work.numbers[*k] as f32;
            }
        }
        for (row, speed) in work.speeds.iter_mut().zip(&self.speed_rows) {
            row[lane] = block.plant.rows[*speed][lane];
        }
    }

    /// How far the clock is ahead in a first episode.
    fn offset(&self, [seed, environment, episode]: [u64; 3]) -> f32 {
        if !self.stagger || episode != 1 {
            return 0.0;
        }
        Stream::new(seed, environment, episode, STAGGER).below(self.engine.horizon() as u64) as f32
    }

    fn draw_delay(&self, [seed, environment, episode]: [u64; 3]) -> f32 {
        let (least, most) = self.delay;
        if least == most {
            return least as f32;
        }
        (least as u64 + Stream::new(seed, environment, episode, DELAY).below((most - least) as u64 + 1)) as f32
    }

    /// A task's event in one lane: its goal may change, its task state, and the numbers that vary.
    fn event(&self, block: &mut EnvBlock, work: &mut Workspace, lane: usize, first: usize) {
        let step = block.episode_state[episode_state::STEP][lane];
        let environment = self.first_environment + (first + lane) as u64;
        let key = |purpose: Purpose| [block.seed[lane], environment, block.episode[lane], purpose.0];
        // an event draws far fewer than 256 words
        let stream = |purpose| Stream::restore(key(purpose), 256 * step as u64);
        let read = |rows: &[[f32; BLOCK]], values: &mut [f64]| {
            values.iter_mut().zip(rows).for_each(|(value, row)| *value = f64::from(row[lane]));
        };
        read(&block.plant.rows, &mut work.state);
        read(&block.goal, &mut work.goal);
        read(&block.task_state, &mut work.memory);
        work.numbers.copy_from_slice(&self.nominal);
        for (row, k) in block.theta.iter().zip(&self.varied) {
            work.numbers[*k] = f64::from(row[lane]);
        }
        let mut start = Start {
            robot: self.robot(),
            state: &mut work.state,
            goal: Goal::over(&mut work.goal),
            task_state: &mut work.memory,
            numbers: &mut work.numbers,
            reset: stream(Purpose::user(0x0e11)),
            task: stream(Purpose::DISTURBANCE),
            once: stream(Purpose::user(0x0e12)),
            event_at: f64::INFINITY,
            difficulty: self.difficulty,
        };
        // the step count, for tasks that say when the next one comes
        start.event_at = f64::from(step);
        self.engine.event(&mut start);
        let next = start.event_at;
        block.episode_state[episode_state::EVENT][lane] =
            if next > f64::from(step) { next.min(1e30) as f32 } else { f32::MAX };
        let write = |rows: &mut [[f32; BLOCK]], values: &[f64]| {
            rows.iter_mut().zip(values).for_each(|(row, value)| row[lane] = *value as f32);
        };
        write(&mut block.goal, &work.goal);
        write(&mut block.task_state, &work.memory);
        // what was drawn in f64 keeps its bits unless the task changed a number
        let mut changed = false;
        for (row, k) in block.theta.iter_mut().zip(&self.varied) {
            let value = work.numbers[*k] as f32;
            changed |= row[lane].to_bits() != value.to_bits();
            row[lane] = value;
        }
        if changed {
            self.plant.set_numbers(&mut block.plant, lane, &work.numbers, &self.varied);
        }
    }

    /// Reward, flags and information of every environment.
    fn write_signals(&self, block: &EnvBlock, work: &Workspace, n: usize, out: &mut StepOut<'_>) {
        let s = &self.sizes;
        for (row, reward) in out.reward.chunks_exact_mut(s.agent).zip(&work.signals[signal::REWARD]) {
            row.fill(*reward);
        }
        for (flags, of) in [(&mut out.terminated, signal::TERMINATED), (&mut out.truncated, signal::TRUNCATED)] {
            flags.iter_mut().zip(&work.signals[of]).for_each(|(flag, x)| *flag = u8::from(*x > 0.5));
        }
        let (width, terms) = (s.info(), &block.episode_state[episode_state::TERMS..]);
        let groups = [&block.episode_state[episode_state::INFO], &work.signals[signal::INFO], terms, &work.metrics[..]];
        let mut at = 0;
        for group in groups {
            transpose(group, n, out.info, width, at);
            at += group.len();
        }
    }

    /// What an episode ended with.
    fn write_ends(&self, work: &Workspace, lane: usize, out: &mut StepOut<'_>) {
        self.write_row(self.shown(work), lane, out.final_observation);
        self.write_row(&work.central, lane, out.final_central);
    }

    /// One environment's row of an array that may have been left out.
    fn write_row(&self, columns: &[[f32; BLOCK]], lane: usize, rows: &mut [f32]) {
        let n = columns.len();
        if n > 0 && !rows.is_empty() {
            for (x, column) in rows[lane * n..(lane + 1) * n].iter_mut().zip(columns) {
                *x = column[lane];
            }
        }
    }

    /// A first step: nothing was rewarded, nothing ended.
    fn clear(&self, lane: usize, out: &mut StepOut<'_>) {
        let a = self.sizes.agent;
        out.reward[lane * a..(lane + 1) * a].fill(0.0);
        (out.terminated[lane], out.truncated[lane]) = (0, 0);
        let n = self.sizes.info();
        if !out.info.is_empty() {
            out.info[lane * n..(lane + 1) * n].fill(0.0);
        }
    }

    fn write_observation(&self, block: &EnvBlock, work: &Workspace, n: usize, out: &mut StepOut<'_>) {
        for (columns, rows) in [
            (self.shown(work), &mut out.observation),
            (&work.central, &mut out.central),
            (&block.theta, &mut out.privileged),
        ] {
            transpose(columns, n, rows, columns.len(), 0);
        }
    }

    /// Observations as they leave.
    fn shown<'a>(&self, work: &'a Workspace) -> &'a [[f32; BLOCK]] {
        if self.pipeline.is_empty() { &work.raw } else { &work.observation }
    }

    /// Memory for one worker.
    pub(crate) fn workspace(&self) -> Workspace {
        let noise = self.sizes.agent * self.pipeline.noise;
        Workspace::new(&self.sizes, self.robot().n_state(), self.nominal.len(), noise)
    }
}

/// Row of [`Workspace::moved`]: lanes that are looked at again.
pub(crate) const AGAIN: usize = 2;
/// Slots that cascades hold per agent.
pub(crate) const LATCHED_PER_AGENT: usize = LATCHED + MAX_SLOTS;
const STAGGER: Purpose = Purpose::user(0x57a6);
const DELAY: Purpose = Purpose::user(0xde1a);

/// Columns of up to sixty-four environments into rows of `width` numbers from `first` on; nothing where the rows were
/// left out.
pub(crate) fn transpose(columns: &[[f32; BLOCK]], n_env: usize, rows: &mut [f32], width: usize, first: usize) {
    if columns.is_empty() || rows.is_empty() {
        return;
    }
    let whole = n_env & !3;
    for lane in (0..whole).step_by(4) {
        let four = &mut rows[lane * width..(lane + 4) * width];
        let (a, rest) = four.split_at_mut(width);
        let (b, rest) = rest.split_at_mut(width);
        let (c, d) = rest.split_at_mut(width);
        let columns =
            columns.iter().zip(&mut a[first..]).zip(&mut b[first..]).zip(&mut c[first..]).zip(&mut d[first..]);
        for ((((column, a), b), c), d) in columns {
            (*a, *b, *c, *d) = (column[lane], column[lane + 1], column[lane + 2], column[lane + 3]);
        }
    }
    for lane in whole..n_env {
        let row = &mut rows[lane * width + first..];
        row.iter_mut().zip(columns).for_each(|(x, column)| *x = column[lane]);
    }
}
