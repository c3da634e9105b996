//! What all environments of a batch share and a step only reads.

use super::block::{Columns, Sizes, Workspace};
use super::control::Control;
use super::draws::BlockDraws;
use super::episode_start::{EpisodeStart, Plans};
use super::estimate::EstimateSetup;
use super::info_columns::InfoColumns;
use super::layout::EnvLayout;
use super::programs::Programs;
use super::residual::Residual;
use super::sensing::SensorSetup;
use super::transition::{StepLayout, transition};
use crate::bounds::Bounds;
use crate::config::Autoreset;
use crate::declare::{Loss, Writer};
use crate::observation::{Pipeline, Statistics};
use crate::randomise::Randomiser;
use crate::robot::Robot;
use crate::task::{Task, View};
use crate::task_spec::TaskSpec;
use autodiff::{Program, Recording, Scalar, Trace};
use base::error::Result;
use dynamics::batch::BatchPlant;
use std::sync::{Arc, OnceLock};

/// Everything that all environments share and that a step only reads.
pub(crate) struct Core {
    pub task: Box<dyn Task>,
    /// What the task says about itself.
    pub task_spec: TaskSpec,
    pub plant: BatchPlant,
    pub control: Control,
    /// Controllers that actions change the commands of.
    pub residual: Option<Residual>,
    pub sensing: Option<SensorSetup>,
    pub estimating: Option<EstimateSetup>,
    /// With which rotors hold the speeds of rest.
    pub hover_input: Vec<f64>,
    pub bounds: Bounds,
    /// See [`EnvConfig::throttle_change`](crate::EnvConfig::throttle_change).
    pub throttle_change: f64,
    /// Rows of the state that are bounded.
    pub limits: Vec<(usize, f32)>,
    pub sizes: Sizes,
    pub layout: EnvLayout,
    /// What is told of an episode.
    pub told: InfoColumns,
    pub pipeline: Pipeline,
    pub randomiser: Randomiser,
    /// What the host draws.
    pub plans: Plans,
    /// Share of what makes episodes hard, 0 to 1.
    pub difficulty: f64,
    /// Share of the episodes that have less.
    pub easier: f64,
    /// Numbers that vary between environments.
    pub varied: Vec<usize>,
    /// Numbers of the plant's model that vary with them.
    pub varying: Vec<usize>,
    pub nominal: Vec<f64>,
    /// The robot's system, with the numbers that vary as parameters if any do: what gradients are taken of.
    pub parametric_plant: dynamics::Plant,
    pub speed_rows: Vec<usize>,
    pub statistics: Statistics,
    /// Means, then 1/standard deviations, as stages read them.
    pub frozen: Arc<[f64]>,
    /// What all environments share, as [`Shared`](super::layout::Shared) says.
    pub shared: Columns,
    pub collects: bool,
    pub delay: (usize, usize),
    pub mode: Autoreset,
    pub stagger: bool,
    pub truncate_after: usize,
    pub first_environment: u64,
    /// See [`config_hash`](super::transition::config_hash).
    pub config_hash: u64,
    /// What environments run.
    pub programs: OnceLock<Programs>,
    /// One step in `f64`, made when it is first asked for.
    pub program: OnceLock<Program>,
}

impl Core {
    pub(crate) fn robot(&self) -> &Robot {
        self.task.robot()
    }

    /// The terms of the reward in a view of a recording.
    pub(crate) fn reward(&self, view: &View) -> Vec<Trace> {
        let mut terms = Writer::written(|terms| self.task.reward(view, terms)).numbers();
        terms.extend(self.throttle_cost(view).map(|cost| -cost));
        terms
    }

    /// The training loss in a view of a recording.
    pub(crate) fn loss(&self, view: &View) -> Trace {
        let mut sum = Loss::default();
        self.task.loss(view, &mut sum);
        if let Some(cost) = self.throttle_cost(view) {
            sum.add("", cost);
        }
        sum.cut(self.bounds.loss)
    }

    fn throttle_cost(&self, view: &View) -> Option<Trace> {
        let weight = self.throttle_change;
        (weight > 0.0).then(|| view.mean_squared_throttle_difference() * Trace::constant(weight))
    }

    /// One step as a recording.
    pub(crate) fn record(&self, layout: &StepLayout) -> Recording {
        Recording::of(layout.n_argument(), |z| transition(self, layout, z))
    }

    /// One step as a program.
    pub(crate) fn program(&self, layout: &StepLayout) -> Result<&Program> {
        if let Some(program) = self.program.get() {
            return Ok(program);
        }
        let compiled = Program::compile(&self.record(layout))?;
        Ok(self.program.get_or_init(|| compiled))
    }

    /// What environments run, made when the environments are.
    pub(crate) fn programs(&self) -> &Programs {
        self.programs.get().expect("made with the environments")
    }

    /// Memory for one worker.
    pub(crate) fn workspace(&self) -> Workspace {
        Workspace {
            rows: Columns::zeros(self.layout.work.count),
            after: Columns::zeros(self.plant.n_row()),
            scratch: self.programs().scratch(),
            draft: EpisodeStart::new(self.robot(), self.sizes.goal, self.sizes.task_state),
            drawn: BlockDraws::new(),
            lead: self.residual.as_ref().map(|residual| residual.lead(self.robot())),
            senses: self.sensing.as_ref().map(|sensing| sensing.senses(self)),
        }
    }
}
