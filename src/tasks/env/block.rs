//! Sixty-four environments: what they hold between steps, and the memory that a step works in.

use super::draws::BlockDraws;
use super::episode_start::EpisodeStart;
use super::estimate::Estimates;
use super::layout::Kept;
use super::programs::Scratch;
use super::residual::BaseController;
use super::sensing::{SensorScratch, Sensors};
use crate::task::TaskReference;
use autodiff::program::BLOCK;
use dynamics::batch::{PlantBlock, RawBreach};

pub(crate) use autodiff::columns::Columns;

/// Rows of the episode state: what every task keeps.
pub(crate) mod episode_state {
    /// Steps that the clock was ahead at the start.
    pub(crate) const OFFSET: usize = 0;
    /// 1 while the episode runs.
    pub(crate) const RUNNING: usize = 1;
    /// Step of the next event.
    pub(crate) const EVENT: usize = 2;
    /// Whether it was truncated.
    pub(crate) const TRUNCATED: usize = 3;
    /// Steps of delay of the actions.
    pub(crate) const DELAY: usize = 4;
    /// Step with which time is over.
    pub(crate) const LAST: usize = 5;
    /// Sum of rewards.
    pub(crate) const RETURN: usize = 6;
    /// Steps since the episode began.
    pub(crate) const STEP: usize = 7;
    /// Numbers of the last action that were clipped or not finite.
    pub(crate) const CLIPPED: usize = 8;
    /// Why the episode terminated: 0 not, n the n-th reason, one more than there are: diverged.
    pub(crate) const REASON: usize = 9;
    /// Sums of the reward's terms follow, then, where a success must hold for a while, the steps that it has.
    pub(crate) const TERMS: usize = 10;
}

/// Numbers of one environment beside its physics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sizes {
    pub term: usize,
    /// Steps that a success must hold; 0 for the step alone.
    pub hold: usize,
    pub end: usize,
    pub metric: usize,
    /// Columns of the information that are told.
    pub info: usize,
    pub goal: usize,
    pub task_state: usize,
    /// Numbers of the physics that vary.
    pub theta: usize,
    /// State and goal that an episode began with, where controllers fly; else none.
    pub beginning: usize,
    /// Numbers of a randomised wind: 3 or none.
    pub air: usize,
    /// Agents.
    pub agent: usize,
    /// Commands of all agents.
    pub command: usize,
    /// Numbers of the actions of all agents.
    pub action: usize,
    /// Slots of the delay line.
    pub delay: usize,
    /// Of one agent, before and after the transforms.
    pub raw: usize,
    pub observation: usize,
    /// Of one agent, of those before the transforms: what its sensors read, behind what the task shows.
    pub reading: usize,
    /// Of all agents: by how much their estimates differ from the truth.
    pub estimate: usize,
    /// Memory of the transforms of all agents.
    pub history: usize,
    pub central: usize,
    pub frame: usize,
    pub rotor: usize,
    /// What cascades hold within a step.
    pub held: usize,
    /// Of one agent, that a normaliser sees.
    pub normalised: usize,
    /// Normal draws of one agent in a step.
    pub noise: usize,
    /// Most draws of a start or an event.
    pub draw: usize,
}

impl Sizes {
    pub(crate) fn episode_state(&self) -> usize {
        episode_state::TERMS + self.term + usize::from(self.hold > 0)
    }

    /// Row of the steps that a success has held.
    pub(crate) fn held_row(&self) -> usize {
        episode_state::TERMS + self.term
    }
}

/// Numbers of one lane.
pub(crate) fn take(rows: &[[f32; BLOCK]], lane: usize, values: &mut [f64]) {
    values.iter_mut().zip(rows).for_each(|(value, row)| *value = f64::from(row[lane]));
}

/// Sixty-four environments.
#[derive(Debug, Clone)]
pub(crate) struct EnvBlock {
    pub plant: PlantBlock,
    /// What they keep beside their physics, as [`Kept`](super::layout::Kept) says.
    pub kept: Columns,
    /// One per environment, or none.
    pub sensors: Vec<Sensors>,
    /// Where observations are estimates.
    pub estimates: Option<Estimates>,
    /// What controllers track, from the first step of an episode on; one per lane or none. Follows from what it began with.
    pub references: Vec<Option<Box<TaskReference>>>,
    pub seed: [u64; BLOCK],
    pub episode: [u64; BLOCK],
    /// One bit per environment that was reset once.
    pub started: u64,
    /// Lanes that something but a recorded step moved since the last one.
    pub moved: u64,
    /// What broke where a simulation last diverged.
    pub broken: [Option<RawBreach>; BLOCK],
    /// Observations that a normaliser has seen, and their sums and sums of squares about its mean.
    pub count: f64,
    pub sums: Vec<[f64; 2]>,
}

impl EnvBlock {
    pub(crate) fn new(plant: PlantBlock, s: &Sizes) -> Self {
        Self {
            plant,
            kept: Columns::zeros(Kept::of(s).count),
            sensors: Vec::new(),
            estimates: None,
            references: vec![None; if s.beginning > 0 { BLOCK } else { 0 }],
            seed: [0; BLOCK],
            episode: [0; BLOCK],
            started: 0,
            moved: u64::MAX,
            broken: [None; BLOCK],
            count: 0.0,
            sums: vec![[0.0; 2]; s.normalised],
        }
    }

    /// All rows that make up the state of the environments, in order.
    pub(crate) fn all_rows(&self) -> impl Iterator<Item = &[f32; BLOCK]> {
        let numbers = self.plant.numbers.iter().flat_map(|rows| rows.iter());
        self.plant.rows.iter().chain(numbers).chain(self.kept.iter())
    }

    /// As [`EnvBlock::all_rows`], to write.
    pub(crate) fn all_rows_mut(&mut self) -> impl Iterator<Item = &mut [f32; BLOCK]> {
        let numbers = self.plant.numbers.iter_mut().flat_map(|rows| rows.iter_mut());
        self.plant.rows.iter_mut().chain(numbers).chain(self.kept.iter_mut())
    }
}

/// What one worker needs for a block.
pub(crate) struct Workspace {
    /// As [`Working`](super::layout::Working) says.
    pub rows: Columns,
    /// Where a step leads that a simulation does not survive.
    pub after: Columns,
    pub scratch: Scratch,
    pub draft: EpisodeStart,
    pub drawn: BlockDraws,
    /// Controllers that actions change the commands of.
    pub lead: Option<BaseController>,
    /// What sensors are read with.
    pub senses: Option<SensorScratch>,
}

/// Rows of signals.
pub(crate) mod signal {
    pub(crate) const REWARD: usize = 0;
    pub(crate) const SUCCESS: usize = 1;
    pub(crate) const LOSS: usize = 2;
    pub(crate) const DUE: usize = 3;
    pub(crate) const TERMINATED: usize = 4;
    pub(crate) const TRUNCATED: usize = 5;
    /// Whether physics gave up in the step.
    pub(crate) const GAVE_UP: usize = 6;
    pub(crate) const COUNT: usize = 7;
}

/// Rows of what begins.
pub(crate) mod beginning {
    /// 1 where an episode begins or an event happens, if what was drawn is accepted; 2 where it does in any case.
    pub(crate) const WHERE: usize = 0;
    pub(crate) const DIFFICULTY: usize = 1;
    /// Whether what was drawn is accepted.
    pub(crate) const ACCEPTED: usize = 2;
    pub(crate) const COUNT: usize = 3;
}
