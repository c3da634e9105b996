//! The estimate that agents see in place of the truth: a filter per agent, over what its sensors read.
//!
//! A step keeps by how much the estimate differs from the truth, x̂ = x ⊕ e, and observations are taken of x ⊕ e. Gradients take e for a
//! constant: the inertial unit feels every motion, so the estimate moves as the body does. What they leave out is second in the error
//! (Barrau and Bonnabel 2017: errors of such filters hardly depend on the way that is flown).

use super::Env;
use super::block::EnvBlock;
use super::core::Core;
use super::mask::lanes_of;
use super::sensing::frame;
use super::stepper::Stepper;
use crate::config::EnvConfig;
use crate::observation::ObservationTransform;
use crate::task::Task;
use autodiff::lanes::ones;
use autodiff::program::BLOCK;
use autodiff::{Array, Scalar};
use base::error::{Error, Result};
use controllers::estimation::{StateEstimatorBatch, StateEstimatorSettings};
use dynamics::frame::{FRAME, Frame};
use dynamics::spatial::{add, conjugate, multiply, rotate, rotate_back, sub};
use rng::{Purpose, Stream};

/// Numbers that tell by how much an estimate differs: place and velocity (world), turn (body), angular velocity (body).
pub(crate) const ESTIMATE: usize = 13;
/// No difference.
const NONE: [f64; ESTIMATE] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
/// Of what an estimate errs by where an episode begins.
const BEGINS: Purpose = Purpose::user(0xe571);

/// What all environments share of their filters.
#[derive(Debug)]
pub(crate) struct EstimateSetup {
    template: StateEstimatorBatch,
    settings: StateEstimatorSettings,
    /// The frame of each agent.
    frames: Vec<usize>,
}

/// The filters of a block: that of agent a in lane l is number 64 a + l.
#[derive(Debug, Clone)]
pub(crate) struct Estimates {
    filters: StateEstimatorBatch,
    /// Lanes whose state was set from outside: they begin there.
    pub anew: u64,
}

impl EstimateSetup {
    /// Of a configuration whose observation is the estimate; `None` for others.
    ///
    /// # Errors
    /// [`Error::Value`] for a robot whose drones are not alone, and as [`StateEstimatorBatch::new`].
    pub(crate) fn of(config: &EnvConfig, task: &dyn Task) -> Result<Option<Self>> {
        let asked = config.observation.iter().find_map(|stage| match stage {
            ObservationTransform::Estimate { settings, .. } => Some(*settings),
            _ => None,
        });
        let Some(settings) = asked else { return Ok(None) };
        let robot = task.robot();
        let frames: Vec<usize> = robot.drones().iter().map(|drone| drone.frame).collect();
        if frames.len() != robot.n_frame() || frames.len() != task.n_agent() {
            let value = format!(
                "asked for of '{}', {} bodies and {} drones",
                robot.plant().name(),
                robot.n_frame(),
                frames.len()
            );
            let remedy = "Show these the truth: sensors tell nothing of joints and of what is carried.";
            return Err(Error::value("observation: stage 'estimate'", value, "of drones alone", remedy));
        }
        if config.sensors().iter().any(|sensor| sensor.on.is_some()) {
            let remedy = "Leave 'on' out: each agent carries the sensors on its own drone.";
            return Err(Error::value(
                "observation: stage 'estimate'",
                "with a sensor on a named body",
                "on the agent's own",
                remedy,
            ));
        }
        let gravity = robot.parameters()[0];
        let n = BLOCK * frames.len();
        let template = StateEstimatorBatch::new(config.sensors(), &settings, [config.dt, gravity], n)?;
        Ok(Some(Self { template, settings, frames }))
    }

    /// Of a block, at the beginning of nothing.
    pub(crate) fn estimates(&self) -> Estimates {
        Estimates { filters: self.template.clone(), anew: 0 }
    }

    /// Numbers of the saved filters of one environment.
    pub(crate) fn n_saved(&self) -> usize {
        1 + self.frames.len() * self.template.n_saved()
    }

    /// Frames as they are estimated, from those that are true and the differences.
    pub(crate) fn seen<S: Scalar>(&self, off: &[S], frames: &mut [S]) {
        for (off, at) in off.chunks_exact(ESTIMATE).zip(&self.frames) {
            let own = &mut frames[at * FRAME..][..FRAME];
            added(&Frame::read(own), off).write(own);
        }
    }
}

/// x ⊕ e.
fn added<S: Scalar>(truth: &Frame<S>, off: &[S]) -> Frame<S> {
    let attitude = multiply(truth.attitude, off.array(6));
    let rate = add(rotate_back(truth.attitude, truth.angular_velocity), off.array(10));
    Frame {
        position: add(truth.position, off.array(0)),
        velocity: add(truth.velocity, off.array(3)),
        attitude,
        angular_velocity: rotate(attitude, rate),
    }
}

/// e of x ⊕ e.
fn difference(truth: &Frame<f64>, estimate: &Frame<f64>) -> [f64; ESTIMATE] {
    let rate = |own: &Frame<f64>| rotate_back(own.attitude, own.angular_velocity);
    let mut off = NONE;
    off[..3].copy_from_slice(&sub(estimate.position, truth.position));
    off[3..6].copy_from_slice(&sub(estimate.velocity, truth.velocity));
    off[6..10].copy_from_slice(&multiply(conjugate(truth.attitude), estimate.attitude));
    off[10..].copy_from_slice(&sub(rate(estimate), rate(truth)));
    off
}

fn differ_in_nothing(rows: &mut [[f32; BLOCK]]) {
    rows.iter_mut().zip(NONE.iter().cycle()).for_each(|(row, x)| *row = [*x as f32; BLOCK]);
}

impl Stepper<'_> {
    /// Begins anew where states were set from outside, before a step: the estimate stays as far from the truth as it was.
    pub(crate) fn estimate_anew(&mut self) {
        let core = self.core;
        let (Some(setup), Some(own)) = (&core.estimating, &mut self.block.estimates) else { return };
        let frames = core.layout.work.frames.of(&self.work.rows);
        let rows = core.layout.kept.estimate.of(&self.block.kept);
        for lane in lanes_of(std::mem::take(&mut own.anew)) {
            for (agent, at) in setup.frames.iter().enumerate() {
                let off: [f64; ESTIMATE] = std::array::from_fn(|k| f64::from(rows[agent * ESTIMATE + k][lane]));
                own.filters.begin_amid(agent * BLOCK + lane, &added(&frame(frames, *at, lane), &off));
            }
        }
    }

    /// Begins an episode of the filters of these lanes: off by as much as they are told to believe.
    pub(crate) fn estimate_first(&mut self, lanes: u64) {
        let core = self.core;
        let Some(setup) = &core.estimating else { return };
        for lane in lanes_of(lanes) {
            let [seed, environment, episode] = self.key(lane);
            let mut draw = Stream::new(seed, environment, episode, BEGINS);
            let frames = core.layout.work.frames.of(&self.work.rows);
            let Some(own) = &mut self.block.estimates else { return };
            own.anew &= !(1 << lane);
            for (agent, at) in setup.frames.iter().enumerate() {
                let known = setup.settings.drawn(&frame(frames, *at, lane), &mut draw);
                own.filters.begin(agent * BLOCK + lane, &known);
            }
        }
        self.estimate_after(lanes);
    }

    /// Lets the filters of these lanes take in what was read, and keeps by how much they differ; shows it.
    pub(crate) fn estimate_after(&mut self, lanes: u64) {
        let core = self.core;
        let Some(setup) = &core.estimating else { return };
        let EnvBlock { estimates: Some(own), sensors, kept, plant, .. } = &mut *self.block else { return };
        for lane in lanes_of(lanes) {
            for (agent, set) in sensors[lane].sets.iter().enumerate() {
                own.filters.tell(agent * BLOCK + lane, set.readings());
            }
        }
        own.filters.advance();
        let frames = core.layout.work.frames.of(&self.work.rows);
        // what stopped is shown at rest
        let alive = ones(&plant.rows[core.plant.alive_row()]);
        let rows = core.layout.kept.estimate.of_mut(kept);
        for lane in lanes_of(lanes) {
            for (agent, at) in setup.frames.iter().enumerate() {
                let off = match alive >> lane & 1 {
                    1 => difference(&frame(frames, *at, lane), &own.filters.estimate(agent * BLOCK + lane)),
                    _ => NONE,
                };
                rows[agent * ESTIMATE..].iter_mut().zip(off).for_each(|(row, x)| row[lane] = x as f32);
            }
        }
        self.look(lanes);
    }
}

impl EnvBlock {
    /// Makes place for filters, which differ from the truth in nothing yet.
    pub(crate) fn give_estimates(&mut self, core: &Core, setup: &EstimateSetup) {
        self.estimates = Some(setup.estimates());
        differ_in_nothing(core.layout.kept.estimate.of_mut(&mut self.kept));
    }
}

impl Estimates {
    /// Visits the numbers of the filters of one lane.
    pub(crate) fn save(&self, lane: usize, saved: &mut [f64]) {
        saved[0] = f64::from(u8::from(self.anew >> lane & 1 == 1));
        let n = self.filters.n_saved();
        for (agent, saved) in saved[1..].chunks_exact_mut(n).enumerate() {
            self.filters.save(agent * BLOCK + lane, saved);
        }
    }

    /// Goes on from [`save`](Self::save)d numbers.
    ///
    /// # Errors
    /// As [`StateEstimatorBatch::restore`].
    pub(crate) fn restore(&mut self, lane: usize, saved: &[f64]) -> Result<()> {
        self.anew = self.anew & !(1 << lane) | u64::from(saved[0] == 1.0) << lane;
        let n = self.filters.n_saved();
        for (agent, saved) in saved[1..].chunks_exact(n).enumerate() {
            self.filters.restore(agent * BLOCK + lane, saved)?;
        }
        Ok(())
    }
}

impl Env {
    /// Observations are of the states as they are set, as if estimates were exact, until the next reset or step.
    #[doc(hidden)]
    pub fn take_states_for_estimates(&mut self) {
        let (layout, blocks) = (self.core.layout.kept.estimate, &mut self.blocks);
        blocks.iter_mut().for_each(|block| differ_in_nothing(layout.of_mut(&mut block.kept)));
    }

    /// The state of agent `agent`'s filter in environment `environment`, with its covariance, and how many steps ago it stands; `None`
    /// where observations are of the truth.
    ///
    /// # Errors
    /// As [`Env::state`]; [`Error::Value`] for an agent that is not there.
    pub fn estimate(
        &self,
        environment: usize,
        agent: usize,
    ) -> Result<Option<(controllers::estimation::NavigationState<f64>, usize)>> {
        self.check_environment(environment)?;
        let n = self.core.sizes.agent;
        if agent >= n {
            return Err(Error::value("agent", agent, format!("0 to {}", n - 1), "Count from 0."));
        }
        let (block, lane) = (&self.blocks[environment / BLOCK], environment % BLOCK);
        let own = block.estimates.as_ref();
        Ok(own.map(|own| (own.filters.state(agent * BLOCK + lane), own.filters.late())))
    }
}
