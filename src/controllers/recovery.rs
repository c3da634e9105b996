//! From which attitudes and body rates a controller brings a plant back: shares of random starts with their confidence.
//!
//! A map has a cell per interval of tilt and of body rate. A start of a cell has its root tilted by an angle of the first
//! about a random horizontal axis, turning at a rate of the second about a random axis; joints are at rest,
//! rotors at hover. It has **recovered** when it is back: within `BACK` of where it started, upright as in hover within the same number of
//! radians, slower than `BACK` m/s and `2 BACK` rad/s, for a quarter of a second, all before the flight ends.
//!
//! Straight-line controllers fly 64 starts side by side, the next as soon as one is decided, others one by one in `f64`.

use super::clocked_step::ClockedStep;
use super::closed_loop::{ClosedLoop, ExogenousInputs};
use super::confidence::clopper_pearson;
use super::controller::{Controller, Target};
use super::law::LawController;
use super::reference::{Hover, Reference};
use super::start::start_on;
use super::written_law::RecordedLaw;
use autodiff::System;
use autodiff::program::BLOCK;
use base::error::{Error, Result};
use base::parallel::Threads;
use dynamics::spatial::{exponential, multiply, rotate, rotate_back};
use dynamics::{Disturbance, Plant};
use rng::{Purpose, Stream};
use serde::Serialize;
use std::f64::consts::PI;
use std::ops::Range;

/// What counts as back, m, rad, m/s, and twice of it rad/s.
pub const BACK: f64 = 0.5;
/// How long it has to stay so, s.
const STAYS: f64 = 0.25;
/// Steps between two looks.
const LOOK: u64 = 5;
/// Farther from the start than this nothing comes back in time, m.
const GONE: f64 = 100.0;

/// Which starts to fly, and for how long.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RecoveryPlan {
    /// Largest tilt, rad, within [0, π], and in how many intervals from zero, 1 to 360. Default π in 18.
    pub tilt: (f64, usize),
    /// Largest body rate, rad/s, within [0, 1000], and in how many intervals from zero, 1 to 360. Default 12 in 6.
    pub rate: (f64, usize),
    /// Largest speed of a start, m/s, in a random direction; [0, 100]. Default 0.
    pub speed: f64,
    /// Starts per cell; at most 10 million in all. Default 64.
    pub n: usize,
    /// Longest flight, s; more than 0.25, at most 1000. Default 6.
    pub duration: f64,
    /// Confidence of the bounds; [0.5, 0.999999]. Default 0.95.
    pub confidence: f64,
    /// Seed of the starts. Default 0.
    pub seed: u64,
}

impl Default for RecoveryPlan {
    /// Tilts to 180° in 18 intervals, rates to 12 rad/s in 6, 64 starts each, 6 s, 95 %.
    fn default() -> Self {
        Self { tilt: (PI, 18), rate: (12.0, 6), speed: 0.0, n: 64, duration: 6.0, confidence: 0.95, seed: 0 }
    }
}

/// Most intervals of tilt, and of body rate.
pub const MAX_INTERVALS: usize = 360;
/// Most starts of a map.
pub const MAX_RECOVERIES: usize = 10_000_000;

impl RecoveryPlan {
    fn check(&self, dt: f64) -> Result<u64> {
        let rows = [
            ("largest tilt", self.tilt.0, 0.0..=PI, "within [0, π] rad"),
            ("largest body rate", self.rate.0, 0.0..=1e3, "within [0, 1000] rad/s"),
            ("largest speed", self.speed, 0.0..=1e2, "within [0, 100] m/s"),
            ("confidence", self.confidence, 0.5..=0.999_999, "within [0.5, 0.999999]"),
            ("duration", self.duration, STAYS + dt..=1e3, "more than 0.25 s and at most 1000 s"),
        ];
        for (what, value, range, rule) in rows {
            if !range.contains(&value) {
                return Err(Error::value(what, value, rule, "Leave it out for the default."));
            }
        }
        for (what, n) in [("intervals of tilt", self.tilt.1), ("intervals of body rate", self.rate.1)] {
            if !(1..=MAX_INTERVALS).contains(&n) {
                return Err(Error::limit(what, n, format!("1 to {MAX_INTERVALS}"), "18 and 6 are the defaults."));
            }
        }
        let n = self.n_cell().saturating_mul(self.n);
        if !(1..=MAX_RECOVERIES).contains(&n) {
            let value = format!("{} × {} cells of {}", self.tilt.1, self.rate.1, self.n);
            let limit = format!("1 to {MAX_RECOVERIES} in all");
            return Err(Error::limit("starts", value, limit, "Take fewer cells, or fewer starts in each."));
        }
        Ok((self.duration / dt).round() as u64)
    }

    /// Number of cells.
    pub fn n_cell(&self) -> usize {
        self.tilt.1 * self.rate.1
    }

    /// Start `i` of cell `cell`, from the plant at hover.
    fn start(&self, hover: &[f64], root: usize, cell: usize, i: usize) -> Vec<f64> {
        let mut stream = Stream::new(self.seed, i as u64, cell as u64, Purpose::RESET);
        let (row, column) = (cell / self.rate.1, cell % self.rate.1);
        let within = |(most, n): (f64, usize), k: usize, at: f64| most * (k as f64 + at) / n as f64;
        let [tilt, rate] = [stream.unit(), stream.unit()];
        let (tilt, rate) = (within(self.tilt, row, tilt), within(self.rate, column, rate));
        let about = stream.uniform(-PI, PI);
        let mut state = hover.to_vec();
        let hover = [6, 7, 8, 9].map(|k| state[root + k]);
        let tilted = exponential([tilt * about.cos(), tilt * about.sin(), 0.0]);
        state[root + 6..root + 10].copy_from_slice(&multiply(tilted, hover));
        let mut direction = || {
            let v = [stream.normal(), stream.normal(), stream.normal()];
            let length = v.iter().map(|x| x * x).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
            v.map(|x| x / length)
        };
        let (turn, way) = (direction(), direction());
        let speed = self.speed * stream.unit();
        for k in 0..3 {
            state[root + 10 + k] = rate * turn[k];
            state[root + 3 + k] = speed * way[k];
        }
        state
    }
}

/// What became of the starts of one interval of tilt and of body rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RecoveryCell {
    /// From and to, rad.
    pub tilt: [f64; 2],
    /// From and to, rad/s.
    pub rate: [f64; 2],
    /// Starts.
    pub n: usize,
    /// Those that came back.
    pub recovered: usize,
    /// Bounds `[low, high]` of the share that comes back, at the plan's confidence ([`clopper_pearson`]).
    pub bounds: [f64; 2],
    /// Most height lost on the way by those that came back, m.
    pub sunk: f64,
    /// Longest time until one was back, s.
    pub slowest: f64,
}

/// Shares of starts that come back.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecoveryMap {
    /// What was flown.
    pub plan: RecoveryPlan,
    /// Row-major `[tilt, rate]`.
    pub cells: Vec<RecoveryCell>,
    /// Whether they flew in lanes, in `f32`.
    pub batched: bool,
}

impl RecoveryMap {
    /// All cells within a tilt (rad) and a rate (rad/s) as one.
    pub fn within(&self, tilt: f64, rate: f64) -> RecoveryCell {
        let inside = |c: &&RecoveryCell| c.tilt[1] <= tilt + 1e-9 && c.rate[1] <= rate + 1e-9;
        let mut all = RecoveryCell {
            tilt: [0.0; 2],
            rate: [0.0; 2],
            n: 0,
            recovered: 0,
            bounds: [0.0; 2],
            sunk: 0.0,
            slowest: 0.0,
        };
        for c in self.cells.iter().filter(inside) {
            (all.n, all.recovered) = (all.n + c.n, all.recovered + c.recovered);
            (all.sunk, all.slowest) = (all.sunk.max(c.sunk), all.slowest.max(c.slowest));
            (all.tilt[1], all.rate[1]) = (all.tilt[1].max(c.tilt[1]), all.rate[1].max(c.rate[1]));
        }
        all.bounds = clopper_pearson(all.recovered, all.n, self.plan.confidence);
        all
    }
}

/// Flies a plant from all starts of a plan under controllers that `build` makes.
///
/// # Errors
/// [`Error::Value`] or [`Error::Limit`] for a plan out of range; as [`Plant::hover_state`], the controller, and the recording.
pub fn recovery_map(
    plant: &Plant,
    build: &(dyn Fn() -> Result<Box<dyn Controller>> + Sync),
    plan: &RecoveryPlan,
    threads: &Threads,
) -> Result<RecoveryMap> {
    let n_step = plan.check(plant.physics().dt)?;
    let effects = plant.physics().effects;
    if effects.contact || effects.ground_effect {
        let remedy = "Leave them out: starts fall as far as they have to.";
        return Err(Error::value("effects contact and ground_effect", "on", "off where there is no ground", remedy));
    }
    let roots = plant.roots();
    if roots.len() != 1 {
        let what = format!("trees of '{}'", plant.name());
        return Err(Error::value(what, roots.len(), "1 to be brought back", "Fly each of them alone."));
    }
    let controller = build()?;
    let here = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
    let hover = start_on(plant, &controller, &here)?;
    let flights = Flights { plan, hover, here, n_step, dt: plant.physics().dt, root: roots[0] };
    let law = controller.recorded(plant)?;
    let batched = law.is_some();
    let fates = match law {
        Some(law) => flights.in_lanes(&ClosedLoop::new(plant.clone(), LawController::of(law))?, threads)?,
        None => flights.one_by_one(plant, build, threads)?,
    };
    let cell = |(cell, fates): (usize, &[Watch])| {
        let (row, column) = (cell / plan.rate.1, cell % plan.rate.1);
        let edges = |(most, n): (f64, usize), k: usize| [k, k + 1].map(|k| most * k as f64 / n as f64);
        let back = || fates.iter().filter_map(|w| Some((w.back_at?, w.sunk)));
        let recovered = back().count();
        RecoveryCell {
            tilt: edges(plan.tilt, row),
            rate: edges(plan.rate, column),
            n: fates.len(),
            recovered,
            bounds: clopper_pearson(recovered, fates.len(), plan.confidence),
            sunk: back().fold(0.0, |most, (_, sunk)| most.max(sunk)),
            slowest: back().fold(0.0, |most, (at, _)| most.max(at)),
        }
    };
    let cells = fates.chunks_exact(plan.n).enumerate().map(cell).collect();
    Ok(RecoveryMap { plan: *plan, cells, batched })
}

/// Steps in which a clock is expected to have come round.
const ROUND: u64 = 2000;

/// The rows of the first steps, behind which they come again and again up to step `n`; all of them where they do not.
fn one_period(n: u64, row: impl Fn(u64) -> Vec<f64>) -> Vec<Vec<f64>> {
    let mut rows: Vec<_> = (0..n.min(ROUND)).map(&row).collect();
    let comes_again = |n: &usize| rows[*n..].iter().zip(&rows).all(|(later, row)| later == row);
    let period = (1..rows.len()).find(comes_again).unwrap_or(rows.len());
    if (rows.len() as u64..n).all(|k| row(k) == rows[k as usize % period]) {
        rows.truncate(period);
        return rows;
    }
    rows.extend((rows.len() as u64..n).map(row));
    rows
}

/// All flights of a map.
struct Flights<'a> {
    plan: &'a RecoveryPlan,
    hover: Vec<f64>,
    here: Reference,
    n_step: u64,
    dt: f64,
    root: usize,
}

impl Flights<'_> {
    fn n(&self) -> usize {
        self.plan.n_cell() * self.plan.n
    }

    fn start(&self, flight: usize) -> Vec<f64> {
        self.plan.start(&self.hover, self.root, flight / self.plan.n, flight % self.plan.n)
    }

    fn in_lanes(&self, system: &ClosedLoop<LawController<RecordedLaw>>, threads: &Threads) -> Result<Vec<Watch>> {
        let inputs = |k| {
            let mut row = vec![0.0; system.n_input()];
            system.write_input(k, Target::level(&self.here), &Disturbance::none(), &mut row);
            row
        };
        let rows = one_period(self.n_step, inputs);
        let step = ClockedStep::new(system, 0..system.n_input(), rows.iter().cloned())?;
        // parts that all threads get some of, long against their last flights
        let size = (self.n() / 32).clamp(BLOCK, 64 * BLOCK);
        let parts = threads.map(self.n().div_ceil(size), |part| {
            self.part_in_lanes(system, &step, &rows, part * size..self.n().min((part + 1) * size))
        });
        Ok(parts.concat())
    }

    /// Some of the flights: as soon as one is decided the next takes its lane, in step with the clock of the others.
    fn part_in_lanes(
        &self,
        system: &ClosedLoop<LawController<RecordedLaw>>,
        step: &ClockedStep,
        rows: &[Vec<f64>],
        flights: Range<usize>,
    ) -> Vec<Watch> {
        let n_step = self.n_step * flights.len().div_ceil(BLOCK) as u64;
        let (mut block, theta) = (step.block(n_step), system.parameters());
        let (mut fates, mut waiting) = (vec![Watch::default(); flights.len()], flights.clone());
        // (flight, steps flown) by lane
        let mut lanes: Vec<(usize, u64)> = Vec::new();
        while !(lanes.is_empty() && waiting.is_empty()) {
            while lanes.len() < BLOCK
                && let Some(flight) = waiting.next()
            {
                let state = system.initial_state(&self.start(flight));
                block.load(lanes.len(), state.iter().chain(&rows[0]).chain(&theta));
                lanes.push((flight, 0));
            }
            for row in rows {
                block.advance(step, lanes.len(), row);
                for lane in (0..lanes.len()).rev() {
                    let (flight, flown) = &mut lanes[lane];
                    *flown += 1;
                    if !flown.is_multiple_of(LOOK) && *flown < self.n_step {
                        continue;
                    }
                    let watch = &mut fates[*flight - flights.start];
                    if flown.is_multiple_of(LOOK) {
                        let x = |i: usize| f64::from(block.number(self.root + i, lane));
                        watch.look(*flown as f64 * self.dt, x, &self.hover[self.root..]);
                    }
                    if watch.decided || *flown == self.n_step {
                        lanes.swap_remove(lane);
                        block.move_lane(lanes.len(), lane);
                    }
                }
            }
        }
        fates
    }

    fn one_by_one(
        &self,
        plant: &Plant,
        build: &(dyn Fn() -> Result<Box<dyn Controller>> + Sync),
        threads: &Threads,
    ) -> Result<Vec<Watch>> {
        let flown = threads.map(self.n(), |flight| -> Result<Watch> {
            let mut system = ClosedLoop::new(plant.clone(), build()?)?;
            let (mut x, mut watch, calm) = (self.start(flight), Watch::default(), ExogenousInputs::none());
            let mut next = x.clone();
            for k in 0..self.n_step {
                system.advance(&x, Target::level(&self.here), &calm, &mut next)?;
                std::mem::swap(&mut x, &mut next);
                if (k + 1).is_multiple_of(LOOK) {
                    watch.look((k + 1) as f64 * self.dt, |i| x[self.root + i], &self.hover[self.root..]);
                    if watch.decided {
                        break;
                    }
                }
            }
            Ok(watch)
        });
        flown.into_iter().collect()
    }
}

/// How one start fares.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Watch {
    /// Height lost so far, m.
    sunk: f64,
    /// Back since, s.
    since: Option<f64>,
    /// Back for good.
    back_at: Option<f64>,
    decided: bool,
}

impl Watch {
    /// Looks at the thirteen numbers of the root.
    fn look(&mut self, time: f64, x: impl Fn(usize) -> f64, hover: &[f64]) {
        if self.decided {
            return;
        }
        let norm = |first: usize, from: &[f64]| (0..3).map(|k| (x(first + k) - from[k]).powi(2)).sum::<f64>().sqrt();
        let away = norm(0, hover);
        if away.is_nan() || away >= GONE {
            self.decided = true;
            return;
        }
        self.sunk = self.sunk.max(hover[2] - x(2));
        // what pointed up in hover
        let up = || rotate_back([hover[6], hover[7], hover[8], hover[9]], [0.0, 0.0, 1.0]);
        let is_level = || rotate([x(6), x(7), x(8), x(9)], up())[2] > BACK.cos();
        let is_still = || norm(3, &[0.0; 3]) < BACK && norm(10, &[0.0; 3]) < 2.0 * BACK;
        if away >= BACK || !is_still() || !is_level() {
            self.since = None;
            return;
        }
        let since = *self.since.get_or_insert(time);
        if time - since >= STAYS {
            (self.back_at, self.decided) = (Some(since), true);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Rates, registry};
    use super::*;
    use dynamics::{Physics, vehicles};

    #[test]
    fn a_start_fares_the_same_in_whatever_lane_and_behind_whatever_flight() {
        let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), Physics::default()).unwrap();
        let controller = registry::default_controller(&plant, &registry::Setup::new(None, &Rates::default())).unwrap();
        let system = || {
            ClosedLoop::new(plant.clone(), LawController::of(controller.recorded(&plant).unwrap().unwrap())).unwrap()
        };
        let here = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
        let hover = start_on(&plant, &controller, &here).unwrap();
        let fates = |n| {
            let plan = RecoveryPlan { tilt: (PI, 2), rate: (8.0, 1), n, duration: 3.0, ..RecoveryPlan::default() };
            let (hover, here, dt) = (hover.clone(), here.clone(), plant.physics().dt);
            let flights = Flights { plan: &plan, hover, here, n_step: plan.check(dt).unwrap(), dt, root: 0 };
            flights.in_lanes(&system(), &Threads::new(2).unwrap()).unwrap()
        };
        // 2 × 1100 starts are flown in parts of 68, so that lanes are taken again; 2 × 24 are side by side
        let (many, few) = (fates(1100), fates(24));
        let back = few.iter().filter(|w| w.back_at.is_some()).count();
        assert!((1..few.len()).contains(&back), "{back} of {} came back in time", few.len());
        for cell in 0..2 {
            assert_eq!(many[cell * 1100..][..24], few[cell * 24..][..24]);
        }
    }

    #[test]
    fn a_clock_is_asked_for_as_many_steps_as_it_takes_to_come_round() {
        let tens = |k: u64| vec![(k % 10) as f64];
        assert_eq!(one_period(50_000, tens), (0..10).map(tens).collect::<Vec<_>>());
        let late = |k: u64| vec![if k == ROUND + 7 { 1.0 } else { 0.0 }];
        assert_eq!(one_period(ROUND + 9, late), (0..ROUND + 9).map(late).collect::<Vec<_>>(), "no period");
        assert_eq!(one_period(3, tens).len(), 3);
    }
}
