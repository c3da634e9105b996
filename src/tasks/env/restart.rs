//! What happens to single environments of a block: episodes begin, goals change. In `f64`, one after the other.

use super::block::{episode_state, take};
use super::core::Core;
use super::mask::lanes_of;
use super::stepper::Stepper;
use crate::autodiff::program::BLOCK;
use crate::dynamics::batch::ALIVE;
use crate::rng::{Purpose, Stream};
use crate::tasks::declare::Goal;
use crate::tasks::task::{Start, streams};

const STAGGER: Purpose = Purpose::user(0x57a6);
const DELAY: Purpose = Purpose::user(0xde1a);
const TRUNCATE: Purpose = Purpose::user(0x7c07);
const EASIER: Purpose = Purpose::user(0xea51);

/// Numbers of one environment where an episode begins, a goal changes, or all is ideal.
#[derive(Debug, Clone)]
pub(crate) struct Draft {
    pub state: Vec<f64>,
    pub goal: Vec<f64>,
    pub task_state: Vec<f64>,
    pub numbers: Vec<f64>,
}

impl Draft {
    /// At rest, with nominal numbers and nothing else.
    pub(crate) fn new(core: &Core) -> Self {
        let (s, state, numbers) = (&core.sizes, core.robot().rest().to_vec(), core.nominal.clone());
        Self { state, goal: vec![0.0; s.goal], task_state: vec![0.0; s.task_state], numbers }
    }

    fn clear(&mut self, core: &Core) {
        self.state.copy_from_slice(core.robot().rest());
        self.goal.fill(0.0);
        self.task_state.fill(0.0);
        self.numbers.copy_from_slice(&core.nominal);
    }

    /// For a task to change.
    pub(crate) fn start<'a>(
        &'a mut self,
        core: &'a Core,
        [reset, task, once]: [Stream; 3],
        event_at: f64,
        difficulty: f64,
    ) -> Start<'a> {
        let Self { state, goal, task_state, numbers } = self;
        let (robot, goal) = (core.robot(), Goal::over(goal));
        Start { robot, state, goal, task_state, numbers, reset, task, once, event_at, difficulty }
    }
}

/// Numbers into one lane.
fn put(rows: &mut [[f32; BLOCK]], lane: usize, values: &[f64]) {
    rows.iter_mut().zip(values).for_each(|(row, value)| row[lane] = *value as f32);
}

impl Stepper<'_> {
    /// Begins the next episode of these lanes and looks at them.
    pub(crate) fn begin(&mut self, lanes: u64) {
        if lanes != 0 {
            lanes_of(lanes).for_each(|lane| self.restart(lane));
            self.sense_first(lanes);
            self.look(lanes);
            self.transformed(lanes, lanes);
        }
    }

    /// Seed, environment and episode of a lane.
    pub(crate) fn key(&self, lane: usize) -> [u64; 3] {
        let environment = self.core.first_environment.wrapping_add((self.first + lane) as u64);
        [self.block.seed[lane], environment, self.block.episode[lane]]
    }

    fn restart(&mut self, lane: usize) {
        self.block.episode[lane] = self.block.episode[lane].wrapping_add(1);
        let (core, key) = (self.core, self.key(lane));
        let (block, draft, difficulty) = (&mut *self.block, &mut self.work.draft, core.difficulty_of(key));
        draft.clear(core);
        let mut start = draft.start(core, streams(key[0], key[1], key[2]), f64::INFINITY, difficulty);
        core.task.start(&mut start);
        let (event_at, mut wind) = (start.event_at, [0.0; 3]);
        core.randomiser.apply(key, difficulty, &mut draft.numbers, &mut wind);
        core.randomiser.hover(core.robot().rest(), &draft.numbers, &mut draft.state);
        let layout = &core.layout.kept;
        layout.episode_state.of_mut(&mut block.kept).iter_mut().for_each(|row| row[lane] = 0.0);
        let offset = core.offset(key);
        block.kept[episode_state::OFFSET][lane] = offset;
        block.kept[episode_state::LAST][lane] = core.last_step(key, offset);
        block.kept[episode_state::RUNNING][lane] = 1.0;
        block.kept[episode_state::EVENT][lane] = event_at.min(f64::from(f32::MAX)) as f32;
        block.kept[episode_state::DELAY][lane] = core.delay_of(key);
        for (k, row) in layout.line.of_mut(&mut block.kept).iter_mut().enumerate() {
            row[lane] = core.control.safe[k % core.control.safe.len()] as f32;
        }
        layout.history.of_mut(&mut block.kept).iter_mut().for_each(|row| row[lane] = 0.0);
        block.started |= 1 << lane;
        self.install(lane, wind);
        self.block.keep_beginning(layout, lane);
    }

    /// Copies the numbers of a start into a lane.
    fn install(&mut self, lane: usize, wind: [f64; 3]) {
        let (core, block, draft) = (self.core, &mut *self.block, &self.work.draft);
        put(&mut block.plant.rows, lane, &draft.state);
        block.plant.rows[core.plant.alive_row()][lane] = ALIVE;
        let (layout, kept) = (&core.layout.kept, &mut block.kept);
        put(layout.goal.of_mut(kept), lane, &draft.goal);
        put(layout.task_state.of_mut(kept), lane, &draft.task_state);
        put(layout.air.of_mut(kept), lane, &wind);
        if !core.varied.is_empty() {
            core.plant.set_numbers(&mut block.plant, lane, &draft.numbers, &core.varied);
            for (row, k) in layout.theta.of_mut(kept).iter_mut().zip(&core.varied) {
                row[lane] = draft.numbers[*k] as f32;
            }
        }
        let speeds = core.layout.work.speeds.of_mut(&mut self.work.rows);
        for (row, speed) in speeds.iter_mut().zip(&core.speed_rows) {
            row[lane] = block.plant.rows[*speed][lane];
        }
    }

    /// A task's event in one lane: its goal may change, its task state, and the numbers that vary.
    pub(crate) fn event(&mut self, lane: usize) {
        let (core, key) = (self.core, self.key(lane));
        let [seed, environment, episode] = key;
        let (block, draft) = (&mut *self.block, &mut self.work.draft);
        let step = block.kept[episode_state::STEP][lane];
        // an event draws far fewer than 256 words
        let stream = |purpose: Purpose| Stream::restore([seed, environment, episode, purpose.0], 256 * step as u64);
        take(&block.plant.rows, lane, &mut draft.state);
        let layout = &core.layout.kept;
        take(layout.goal.of(&block.kept), lane, &mut draft.goal);
        take(layout.task_state.of(&block.kept), lane, &mut draft.task_state);
        draft.numbers.copy_from_slice(&core.nominal);
        for (row, k) in layout.theta.of(&block.kept).iter().zip(&core.varied) {
            draft.numbers[*k] = f64::from(row[lane]);
        }
        let streams = [Purpose::user(0x0e11), Purpose::DISTURBANCE, Purpose::user(0x0e12)].map(stream);
        // the step count, for tasks that say when the next one comes
        let mut start = draft.start(core, streams, f64::from(step), core.difficulty_of(key));
        core.task.event(&mut start);
        let next = start.event_at;
        block.kept[episode_state::EVENT][lane] = if next > f64::from(step) { next.min(1e30) as f32 } else { f32::MAX };
        put(layout.goal.of_mut(&mut block.kept), lane, &draft.goal);
        put(layout.task_state.of_mut(&mut block.kept), lane, &draft.task_state);
        // what was drawn in f64 keeps its bits unless the task changed a number
        let mut changed = false;
        for (row, k) in layout.theta.of_mut(&mut block.kept).iter_mut().zip(&core.varied) {
            let value = draft.numbers[*k] as f32;
            changed |= row[lane].to_bits() != value.to_bits();
            row[lane] = value;
        }
        if changed {
            core.plant.set_numbers(&mut block.plant, lane, &draft.numbers, &core.varied);
        }
        self.look_around(lane);
    }
}

impl Core {
    /// How far the clock is ahead in a first episode.
    fn offset(&self, [seed, environment, episode]: [u64; 3]) -> f32 {
        if !self.stagger || episode != 1 {
            return 0.0;
        }
        Stream::new(seed, environment, episode, STAGGER).below(self.task.horizon() as u64) as f32
    }

    /// The step with which time is over: that at which the clock comes to T, or an earlier one drawn from the geometric
    /// distribution of mean `truncate_after`.
    fn last_step(&self, [seed, environment, episode]: [u64; 3], offset: f32) -> f32 {
        let left = self.task.horizon() as f32 - offset;
        if self.truncate_after == 0 {
            return left;
        }
        let more = 1.0 - Stream::new(seed, environment, episode, TRUNCATE).unit();
        let drawn = (more.ln() / (-1.0 / self.truncate_after as f64).ln_1p()).ceil();
        drawn.clamp(1.0, f64::from(left)) as f32
    }

    /// Difficulty of an episode: d min(1, u / s) with u uniform in [0, 1), for a share s of easier ones.
    fn difficulty_of(&self, [seed, environment, episode]: [u64; 3]) -> f64 {
        if self.easier == 0.0 {
            return self.difficulty;
        }
        self.difficulty * (Stream::new(seed, environment, episode, EASIER).unit() / self.easier).min(1.0)
    }

    /// Steps of delay of an episode.
    fn delay_of(&self, [seed, environment, episode]: [u64; 3]) -> f32 {
        let (least, most) = self.delay;
        if least == most {
            return least as f32;
        }
        (least as u64 + Stream::new(seed, environment, episode, DELAY).below((most - least) as u64 + 1)) as f32
    }
}
