//! Environments as kernels of a device: CUDA of the programs that a batch runs, and of what stands between them.
//!
//! One thread has one environment. Its numbers stand in the arrays of the batch ([`EnvLayout`](super::layout::EnvLayout)), a row of all
//! environments for each. A step is
//!
//! ```text
//! od_step -> od_event, where goals change -> od_collect, where statistics are -> od_begin, where episodes ended -> od_collect
//! ```
//!
//! and every number of it has the bits that a batch on the host has: programs by their value form, draws by the same streams.
//! What begins on the host (assignments, searches) is drafted there, see [`Env::drafted`].
//!
//! | file | what |
//! |---|---|
//! | `mod` | what a device holds of environments, and what it can be asked |
//! | `text` | the kernels |
//! | `draws` | draws of a start or an event |
//! | `adjoint` | steps of a tape, pulled backwards |
//! | `mirror` | environments to and from a device |

mod adjoint;
mod draws;
mod mirror;
mod text;

pub use adjoint::{Given, SweepArguments};
pub use mirror::EnvRows;

use super::Env;
use super::core::Core;
use super::layout::Part;
use base::error::{Error, Result};
use std::ops::Range;

/// What stands before the kernels, and what a kernel is given: [`KernelArguments`].
pub const PRELUDE: &str = include_str!("prelude.cuh");

/// The argument of every kernel, as the text declares it: addresses on the device, then numbers.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[repr(C)]
pub struct KernelArguments {
    /// Rows of physics: state, input, whether it is alive.
    pub plant: u64,
    /// Rows of what is kept beside.
    pub kept: u64,
    /// Rows of work.
    pub work: u64,
    /// Numbers that all share.
    pub shared: u64,
    /// Rows of the model, where numbers vary.
    pub model: u64,
    /// Seed of each, 64 bits.
    pub seed: u64,
    /// Episode of each, 64 bits.
    pub episode: u64,
    /// Actions of the caller.
    pub action: u64,
    /// Rows of information.
    pub info: u64,
    /// Rows of what episodes end with.
    pub final_observation: u64,
    /// Rows of what episodes end with.
    pub final_central: u64,
    /// Flags of each, a byte.
    pub terminated: u64,
    /// Flags of each, a byte.
    pub truncated: u64,
    /// Where an event is due, a byte each.
    pub due: u64,
    /// Where an episode begins, a byte each.
    pub restart: u64,
    /// Whose observation statistics are taken of, a byte each.
    pub seen: u64,
    /// Of each block of 64: how many were seen, then sums and sums of squares about the mean, in `double`.
    pub sums: u64,
    /// Means of the statistics, in `double`.
    pub mean: u64,
    /// Rows of what a tape keeps of the step.
    pub tape: u64,
    /// Whether it ran and went well, a byte each.
    pub tape_running: u64,
    /// Whether an episode ended in it, a byte each.
    pub tape_ended: u64,
    /// Whether something moved it before, a byte each.
    pub tape_moved: u64,
    /// Whether something but a recorded step moved it since the last one, a byte each.
    pub moved: u64,
    /// From an environment to the next among the actions, in numbers.
    pub action_environment: i64,
    /// From a number to the next.
    pub action_number: i64,
    /// Number of the first environment.
    pub first_environment: u64,
    /// See [`Env::set_difficulty`].
    pub difficulty: f64,
    /// Environments.
    pub n: u32,
    /// From a row to the next, in numbers.
    pub stride: u32,
    /// Whether statistics are collected.
    pub collects: u32,
    /// Whether rewards and flags of what begins are cleared.
    pub clears: u32,
    /// Whether a step has gone before, whose ended episodes stop.
    pub stops: u32,
    /// Zero: structures end on whole words.
    pub unused: u32,
}

/// A kernel of [`EnvKernels::text`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum EnvKernel {
    /// From actions to what is told; finds where events are due and episodes begin.
    Step,
    /// Lets events happen.
    Event,
    /// Takes the statistics of what was seen.
    Collect,
    /// Begins episodes.
    Begin,
    /// Shows environments as they stand.
    Observe,
    /// Keeps what a step begins with, on a tape.
    Open,
    /// Keeps what it was given, behind it.
    Close,
    /// Pulls cotangents through a step of a tape.
    Pull,
}

impl EnvKernel {
    /// Every one.
    pub const ALL: [Self; 8] = {
        use EnvKernel::*;
        [Step, Event, Collect, Begin, Observe, Open, Close, Pull]
    };

    /// Its name in the text.
    pub fn name(self) -> &'static str {
        match self {
            Self::Step => "od_step",
            Self::Event => "od_event",
            Self::Collect => "od_collect",
            Self::Begin => "od_begin",
            Self::Observe => "od_observe",
            Self::Open => "od_open",
            Self::Close => "od_close",
            Self::Pull => "od_pull",
        }
    }
}

/// Environments as a device runs them.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvKernels {
    /// CUDA behind [`PRELUDE`].
    pub text: String,
    /// Those that there are.
    pub kernels: Vec<EnvKernel>,
    /// Rows of physics, of what is kept, of work, shared, of the model.
    pub n_row: [usize; 5],
    /// Rows of the observations as they leave, agent by agent, among those of work.
    pub observation: Range<usize>,
    /// Of the central state, among those of work.
    pub central: Range<usize>,
    /// Of the numbers that differ between environments, among those kept.
    pub privileged: Range<usize>,
    /// Of the reward, among those of work.
    pub reward: usize,
    /// Rows of information.
    pub n_info: usize,
    /// Numbers that statistics are taken of.
    pub n_normalised: usize,
    /// Rows of work that drafts of the host are written to, where episodes begin there.
    pub draft: Option<Range<usize>>,
}

impl Env {
    /// These environments as a device runs them.
    ///
    /// # Errors
    /// [`Error::Value`] for what only the host can do: sensors, estimates, controllers that actions correct.
    #[doc(hidden)]
    pub fn kernels(&self) -> Result<EnvKernels> {
        check(&self.core)?;
        text::kernels(&self.core)
    }
}

/// Refuses what stays on the host.
fn check(core: &Core) -> Result<()> {
    let refused = [
        (core.sensing.is_some(), "sensor", "Leave sensors out: sensor = []"),
        (core.estimating.is_some(), "estimate", "Leave estimates out"),
        (core.residual.is_some(), "residual", "Leave `residual` out"),
    ];
    match refused.into_iter().find(|(is_there, ..)| *is_there) {
        None => Ok(()),
        Some((_, what, remedy)) => {
            let remedy = format!("{remedy}, or step on the host.");
            Err(Error::value(format!("{what} of an environment on a device"), "there", "left out", remedy))
        }
    }
}

impl EnvKernels {
    fn of(core: &Core, text: String, kernels: Vec<EnvKernel>) -> Self {
        let (layout, s) = (&core.layout, &core.sizes);
        let shown = if core.pipeline.is_empty() { layout.work.raw } else { layout.work.observation };
        let signals = layout.work.signals.range().start;
        let numbers = if s.theta > 0 { core.plant.n_number() } else { 0 };
        let draft = core.task.start_on_host().map(|_| layout.work.draws.range());
        Self {
            text,
            kernels,
            n_row: [core.plant.n_row(), layout.kept.count, layout.work.count, layout.shared.count, numbers],
            observation: shown.range(),
            central: layout.work.central.range(),
            privileged: layout.kept.theta.range(),
            reward: signals + super::block::signal::REWARD,
            n_info: s.info,
            n_normalised: s.normalised,
            draft,
        }
    }
}

/// The places of a part's numbers.
fn rows(part: Part) -> Range<usize> {
    part.range()
}
