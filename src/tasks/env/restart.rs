//! What happens to single environments of a block: episodes begin, goals change. What is recorded runs as a program over the draws of
//! the host; what no recording can hold is done in `f64`, one environment after the other.

use super::block::{beginning, episode_state, take};
use super::core::Core;
use super::draw_plan::Plan;
use super::episode_start::EpisodeStart;
use super::mask::lanes_of;
use super::programs::{RowProgram, Scratch};
use super::stepper::{Stepper, registers_of};
use crate::start::{Streams, key_of_event, key_of_start, position_of_event};
use crate::task::HostStart;
use autodiff::lanes::ones;
use autodiff::native::Work;
use autodiff::program::BLOCK;
use rng::{Purpose, Stream, ln};

pub(crate) const STAGGER: Purpose = Purpose::user(0x57a6);
pub(crate) const DELAY: Purpose = Purpose::user(0xde1a);
pub(crate) const TRUNCATE: Purpose = Purpose::user(0x7c07);
pub(crate) const EASIER: Purpose = Purpose::user(0xea51);

/// That of one program.
type OwnScratch = fn(&mut Scratch) -> &mut Option<Work<[f32; BLOCK]>>;

/// A recorded start or event: its program, what is drawn for it, scratch.
type Recorded<'a> = (&'a RowProgram, &'a Plan, OwnScratch);

impl Stepper<'_> {
    /// Begins the next episode of these lanes and looks at them.
    pub(crate) fn begin(&mut self, lanes: u64) {
        if lanes == 0 {
            return;
        }
        let core = self.core;
        let recorded: Recorded<'_> = (&core.programs().start, &core.plans.start, |scratch| &mut scratch.start);
        if let Some(host) = core.task.start_on_host() {
            lanes_of(lanes).for_each(|lane| {
                self.next_episode(lane);
                self.start_on_host(host, lane);
            });
            self.run_begun(recorded, lanes, true);
        } else {
            self.run_drawn(recorded, lanes, key_of_start, |own, lane| {
                own.next_episode(lane);
                0
            });
        }
        if core.sizes.beginning > 0 {
            let layout = &core.layout.kept;
            lanes_of(lanes).for_each(|lane| self.block.keep_beginning(layout, lane));
        }
        self.sense_first(lanes);
        self.show_readings();
        self.transformed(lanes, lanes);
    }

    /// Lets the events of these lanes happen and looks at them: goals may change, task states, and numbers that vary.
    pub(crate) fn happen(&mut self, lanes: u64) {
        let core = self.core;
        let Some(program) = &core.programs().event else { return };
        let recorded: Recorded<'_> = (program, &core.plans.event, |scratch| &mut scratch.event);
        if let Some(host) = core.task.start_on_host() {
            lanes_of(lanes).for_each(|lane| self.event_on_host(host, lane));
            self.run_begun(recorded, lanes, true);
        } else {
            self.run_drawn(recorded, lanes, key_of_event, |own, lane| {
                position_of_event(own.block.kept[episode_state::STEP][lane])
            });
        }
        lanes_of(lanes).for_each(|lane| self.look_around(lane));
        self.show_readings();
    }

    /// Seed, environment and episode of a lane.
    pub(crate) fn key(&self, lane: usize) -> [u64; 3] {
        let environment = self.core.first_environment.wrapping_add((self.first + lane) as u64);
        [self.block.seed[lane], environment, self.block.episode[lane]]
    }

    /// What the host counts of an episode, in whole steps, and what is long and zero.
    fn next_episode(&mut self, lane: usize) {
        self.block.episode[lane] = self.block.episode[lane].wrapping_add(1);
        let (core, key) = (self.core, self.key(lane));
        let (block, offset) = (&mut *self.block, core.offset(key));
        block.kept[episode_state::OFFSET][lane] = offset;
        block.kept[episode_state::LAST][lane] = core.last_step(key, offset);
        block.kept[episode_state::DELAY][lane] = core.delay_of(key);
        core.layout.kept.history.of_mut(&mut block.kept).iter_mut().for_each(|row| row[lane] = 0.0);
        block.started |= 1 << lane;
    }

    /// Draws for these lanes what a program asks for, until it is accepted: by the key of every stream, from the word on
    /// that `open` tells of a lane.
    fn run_drawn(
        &mut self,
        recorded: Recorded<'_>,
        lanes: u64,
        key_of: impl Fn([u64; 3], usize) -> [u64; 4],
        open: impl Fn(&mut Self, usize) -> u64,
    ) {
        let (core, plan) = (self.core, recorded.1);
        self.work.drawn.clear();
        for lane in lanes_of(lanes) {
            let position = open(self, lane);
            let key = self.key(lane);
            let rows = core.layout.work.beginning.of_mut(&mut self.work.rows);
            rows[beginning::DIFFICULTY][lane] = core.difficulty_of(key) as f32;
            self.work.drawn.open(plan, |stream| key_of(key, stream), position);
        }
        let mut left = lanes;
        for time in 1..=plan.most {
            let draws = core.layout.work.draws.of_mut(&mut self.work.rows);
            self.work.drawn.draw(plan, lanes, left, time == 1, draws);
            self.run_begun(recorded, left, time == plan.most);
            left &= !ones(&core.layout.work.beginning.of(&self.work.rows)[beginning::ACCEPTED]);
            if left == 0 {
                return;
            }
        }
    }

    /// Runs the program of a start or an event where these lanes are, the last time or once of several.
    fn run_begun(&mut self, (program, _, scratch): Recorded<'_>, lanes: u64, is_last: bool) {
        let (core, n) = (self.core, self.n());
        let which = &mut core.layout.work.beginning.of_mut(&mut self.work.rows)[beginning::WHERE];
        *which = [0.0; BLOCK];
        lanes_of(lanes).for_each(|lane| which[lane] = if is_last { 2.0 } else { 1.0 });
        for lanes in registers_of(lanes, n) {
            program.run(scratch(&mut self.work.scratch), core, self.block, &mut self.work.rows, lanes);
        }
    }
}

/// On the host.
impl Stepper<'_> {
    pub(crate) fn start_on_host(&mut self, host: &dyn HostStart, lane: usize) {
        let (core, key) = (self.core, self.key(lane));
        let (source, draft) = (Streams::of_start(key), &mut self.work.draft);
        draft.clear(core);
        draft.begin((core.robot(), &core.randomiser), &source, core.difficulty_of(key), |start| host.start(start));
        self.write_draft(lane);
    }

    pub(crate) fn event_on_host(&mut self, host: &dyn HostStart, lane: usize) {
        let (core, key) = (self.core, self.key(lane));
        let (block, draft, layout) = (&*self.block, &mut self.work.draft, &core.layout.kept);
        draft.clear(core);
        take(&block.plant.rows, lane, &mut draft.state);
        take(layout.goal.of(&block.kept), lane, &mut draft.goal);
        take(layout.task_state.of(&block.kept), lane, &mut draft.task_state);
        for (row, k) in layout.theta.of(&block.kept).iter().zip(&core.varied) {
            draft.numbers[*k] = f64::from(row[lane]);
        }
        let step = block.kept[episode_state::STEP][lane];
        draft.event_at = f64::from(step);
        let source = Streams::of_event(key, step);
        draft.with(core.robot(), &source, core.difficulty_of(key), |start| host.event(start));
        self.write_draft(lane);
    }

    /// What the host drafted, for the program that keeps it.
    fn write_draft(&mut self, lane: usize) {
        let rows = self.core.layout.work.draws.of_mut(&mut self.work.rows);
        // what a task writes beyond its goal is nowhere told
        self.work.draft.goal.truncate(self.core.sizes.goal);
        self.work.draft.all(&self.core.varied).zip(rows).for_each(|(x, row)| row[lane] = *x as f32);
    }
}

impl EpisodeStart {
    fn clear(&mut self, core: &Core) {
        self.state.copy_from_slice(core.robot().rest());
        self.goal.fill(0.0);
        self.task_state.fill(0.0);
        self.numbers.copy_from_slice(&core.nominal);
        (self.wind, self.event_at) = ([0.0; 3], f64::INFINITY);
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
        let drawn = (ln(more) / (-1.0 / self.truncate_after as f64).ln_1p()).ceil();
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
