//! One loop over thousands of randomised plants: the recorded step of the loop, 64 flights to a block of lanes.
//!
//! Flights differ in their start, their physical parameters (and gains, where those are exposed) and their steady
//! disturbance; the target is shared. The law believes what it was built for. Results do not depend on threads or on how
//! many flights there are.

use super::clocked_step::{self, ClockedStep};
use super::closed_loop::ClosedLoop;
use super::confidence::{Proportion, Quantile};
use super::controller::Target;
use super::flight::LOST;
use super::hover_axes::HoverAxes;
use super::law::{ControlLaw, LawController};
use super::reference::{Hover, Reference};
use autodiff::System;
use autodiff::program::BLOCK;
use base::error::{Error, Result};
use base::parallel::Threads;
use dynamics::Disturbance;
use dynamics::spatial::{Quat, conjugate, multiply, up_axis};
use rng::{Purpose, Stream};
use serde::Serialize;

/// One number of each flight of a block.
type Row = [f32; BLOCK];

/// Steps that the clock is watched for.
const CLOCK: u64 = 1000;
/// Any target: it plays no part in what the clock says.
const STAY: Reference = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });

/// What one flight is flown with; nominal until it is changed.
#[derive(Debug, Clone, PartialEq)]
pub struct MonteCarloDraw {
    /// State of the plant at the start, `[n_state]` of the plant.
    pub start: Vec<f64>,
    /// θ of the loop, `[n_parameter]`, in the order of [`ClosedLoop::parameter_names`].
    pub parameters: Vec<f64>,
    /// Wind, force and moment, held all the way.
    pub air: Disturbance<f64>,
}

/// How one flight went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MonteCarloResult {
    /// Number of the flight.
    pub flight: usize,
    /// Root mean square distance of the root from the reference after the transient, m; up to where it was lost.
    pub rmse: f64,
    /// Largest distance after the transient, m.
    pub worst: f64,
    /// Largest angle between the vertical and what points up in hover, rad: the root's z, but of a vehicle that leans.
    pub tilt: f64,
    /// When it was first more than 10 m (`LOST`) away or not finite, s.
    pub lost_at: Option<f64>,
}

/// Many flights in a few numbers, each with where it lies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MonteCarloSummary {
    /// Flights that were lost.
    pub lost: Proportion,
    /// Median RMSE, m; a lost flight's is infinite.
    pub median: Quantile,
    /// RMSE that 95 % of the flights do not exceed, m; likewise.
    pub percentile_95: Quantile,
    /// Confidence of the bounds.
    pub confidence: f64,
}

impl MonteCarloSummary {
    /// Of these flights, with bounds at a confidence within (0, 1), as 0.95.
    pub fn of(flown: &[MonteCarloResult], confidence: f64) -> Self {
        let lost = flown.iter().filter(|o| o.lost_at.is_some()).count();
        let mut errors: Vec<f64> =
            flown.iter().map(|o| if o.lost_at.is_some() { f64::INFINITY } else { o.rmse }).collect();
        errors.sort_by(f64::total_cmp);
        Self {
            lost: Proportion::counted(lost, flown.len(), confidence),
            median: Quantile::met(&errors, 0.5, confidence),
            percentile_95: Quantile::met(&errors, 0.95, confidence),
            confidence,
        }
    }
}

/// Many flights of one loop.
#[derive(Debug)]
pub struct MonteCarlo<'a, L> {
    system: &'a ClosedLoop<LawController<L>>,
    step: ClockedStep,
    /// s.
    transient: f64,
    seed: u64,
}

impl<'a, L: ControlLaw> MonteCarlo<'a, L> {
    /// Records and compiles the step of a loop; with [`ClosedLoop::with_physics`] its plants may differ.
    ///
    /// # Errors
    /// [`Error::Limit`] if the recording is too large.
    pub fn new(system: &'a ClosedLoop<LawController<L>>) -> Result<Self> {
        let clocked = |k| {
            let mut row = vec![0.0; system.n_clocked()];
            system.write_clocked(k, Target::level(&STAY), &mut row);
            row
        };
        let ticks = system.law().n_target()..system.n_clocked();
        let step = ClockedStep::new(system, ticks, (0..CLOCK).map(clocked))?;
        Ok(Self { system, step, transient: 0.0, seed: 0 })
    }

    /// With errors counted from so many seconds on; default 0.
    #[must_use]
    pub fn after(mut self, seconds: f64) -> Self {
        self.transient = seconds;
        self
    }

    /// With a seed of the draws; default 0.
    #[must_use]
    pub fn seeded(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Instructions of one step.
    pub fn len(&self) -> usize {
        self.step.general().len()
    }

    /// Whether a step computes nothing.
    pub fn is_empty(&self) -> bool {
        self.step.general().is_empty()
    }

    /// Flies `n_flight` flights of `n_step` steps from `start`, `[n_state]` of the plant; `draw` changes what flight i is flown with,
    /// from a stream of its own. One result per flight, in their order.
    ///
    /// # Errors
    /// [`Error::Value`] if `start` or a draw is not of the plant's or the loop's length.
    pub fn fly(
        &self,
        target: Target<'_>,
        start: &[f64],
        n_flight_and_step: (usize, u64),
        draw: &(dyn Fn(&mut Stream, &mut MonteCarloDraw) + Sync),
        threads: &Threads,
    ) -> Result<Vec<MonteCarloResult>> {
        let (n_flight, n_step) = n_flight_and_step;
        self.system.plant().check_state(start)?;
        let nominal =
            MonteCarloDraw { start: start.to_vec(), parameters: self.system.parameters(), air: Disturbance::none() };
        let blocks = threads.map(n_flight.div_ceil(BLOCK), |b| {
            let flights = b * BLOCK..n_flight.min((b + 1) * BLOCK);
            let draws: Vec<MonteCarloDraw> = flights
                .map(|i| {
                    let mut own = nominal.clone();
                    draw(&mut Stream::new(self.seed, i as u64, 0, Purpose::RESET), &mut own);
                    own
                })
                .collect();
            Block::new(self, &draws, n_step)?.run(self, target, b * BLOCK, n_step)
        });
        Ok(blocks.into_iter().collect::<Result<Vec<_>>>()?.concat())
    }
}

/// Flights side by side.
struct Block {
    n_flight: usize,
    now: clocked_step::Block,
    squares: [f64; BLOCK],
    /// Largest square.
    worst: [f64; BLOCK],
    /// Least cosine of the tilt.
    upright: Row,
    /// World → body in a hover that leans.
    back: Option<Quat<f32>>,
    lost_at: [Option<f64>; BLOCK],
    counted: [u64; BLOCK],
}

impl Block {
    fn new<L: ControlLaw>(of: &MonteCarlo<'_, L>, draws: &[MonteCarloDraw], n_step: u64) -> Result<Self> {
        let p = of.system.n_parameter();
        let (mut now, mut input) = (of.step.block(n_step), vec![0.0; of.system.n_input()]);
        for (lane, own) in draws.iter().enumerate() {
            of.system.plant().check_state(&own.start)?;
            if own.parameters.len() != p {
                let wanted = format!("{p}, as ClosedLoop::parameter_names lists them");
                return Err(Error::value("draw: parameters", own.parameters.len(), wanted, "Change them in place."));
            }
            of.system.write_air(&own.air, &mut input);
            let all = of.system.initial_state(&own.start);
            now.load(lane, all.iter().chain(&input).chain(&own.parameters));
        }
        Ok(Self {
            n_flight: draws.len(),
            now,
            squares: [0.0; BLOCK],
            worst: [0.0; BLOCK],
            upright: [1.0; BLOCK],
            back: HoverAxes::of_plant(of.system.plant()).attitude_in_hover().map(|q| conjugate(q).map(|x| x as f32)),
            lost_at: [None; BLOCK],
            counted: [0; BLOCK],
        })
    }

    fn run<L: ControlLaw>(
        mut self,
        of: &MonteCarlo<'_, L>,
        target: Target<'_>,
        first: usize,
        n_step: u64,
    ) -> Result<Vec<MonteCarloResult>> {
        let root = of.system.plant().roots()[0];
        let dt = of.system.plant().physics().dt;
        let mut input = vec![0.0; of.system.n_clocked()];
        for k in 0..=n_step {
            let time = k as f64 * dt;
            self.judge(root, target.sample(time).position, time, time >= of.transient);
            of.system.write_clocked(k, target, &mut input);
            self.now.advance(&of.step, self.n_flight, &input);
        }
        Ok((0..self.n_flight).map(|lane| self.outcome(first, lane)).collect())
    }

    /// Errors of the state before a step.
    fn judge(&mut self, root: usize, wanted: [f64; 3], time: f64, counts: bool) {
        for lane in 0..self.n_flight {
            if self.lost_at[lane].is_some() {
                continue;
            }
            let x = |k: usize| self.now.number(root + k, lane);
            let squared = (0..3).map(|k| (f64::from(x(k)) - wanted[k]).powi(2)).sum::<f64>();
            if squared.is_nan() || squared > LOST * LOST {
                self.lost_at[lane] = Some(time);
                continue;
            }
            let body = [x(6), x(7), x(8), x(9)];
            let up = up_axis(self.back.map_or(body, |back| multiply(body, back)))[2];
            self.upright[lane] = self.upright[lane].min(up);
            if counts {
                self.squares[lane] += squared;
                self.counted[lane] += 1;
                self.worst[lane] = self.worst[lane].max(squared);
            }
        }
    }

    fn outcome(&self, first: usize, lane: usize) -> MonteCarloResult {
        MonteCarloResult {
            flight: first + lane,
            rmse: (self.squares[lane] / self.counted[lane].max(1) as f64).sqrt(),
            worst: f64::from(self.worst[lane].sqrt() as f32),
            tilt: f64::from(self.upright[lane].clamp(-1.0, 1.0)).acos(),
            lost_at: self.lost_at[lane],
        }
    }
}
