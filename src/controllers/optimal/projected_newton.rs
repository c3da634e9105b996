//! The solution of a [`StageQp`] by projected Newton steps.
//!
//! Inputs that stand at a bound and would leave it are held; the others take the Newton step of the program without bounds, which a
//! Riccati recursion finds, and are put back within their bounds (Bertsekas 1982). Sets of held inputs change by many members at once, so
//! few steps are needed, and each begins from where the last one ended: a step refactorises the stages up to the last one whose set
//! changed. Every iterate keeps the dynamics and the bounds, so whatever ends the search, its inputs can be applied.

use super::stage_qp::{Blocks, Sizes, StageQp};
use super::stage_sweeps::{At, Factors, Way, costates, factorise, feed_forward, roll_out, slopes, step};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use nalgebra::DMatrix;

/// Share of the decrease along the slope that a step must reach.
const ENOUGH: f64 = 0.05;

/// Shortest step that is tried.
const SHORTEST: f64 = 1e-9;

/// An input this near to a bound, relative to 1 and to the bound, stands at it.
const AT_BOUND: f64 = 1e-14;

with_defaults! {
    /// When a [`QpSolver`] ends.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct QpSettings {
        /// Largest [`QpReport::residual`] of a solution. Default 1e-9.
        pub tolerance: f64 = 1e-9,
        /// Most Newton steps. Default 100.
        pub max_iterations: usize = 100,
        /// Added to the diagonal of every R. Default 0.
        pub regularisation: f64 = 0.0,
    }
}

/// How a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum QpStatus {
    /// Within the tolerance.
    Solved,
    /// Out of iterations, or of steps that lower the cost: a feasible point, and how far from the solution the residual tells.
    Stopped,
    /// The cost is not convex in the inputs of this stage.
    NotConvex(usize),
    /// A number of the program or of the start is not finite.
    NotFinite,
}

/// What a search did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QpReport {
    /// How it ended.
    pub status: QpStatus,
    /// Newton steps.
    pub iterations: usize,
    /// Stages that were factorised, a recursion over all of them counting N.
    pub factorised: usize,
    /// Largest |u − P(u − g/d)| over the inputs, as a share of the range between their bounds (of 1 without bounds): g the slope of
    /// the cost with the states eliminated, d its curvature with later inputs optimal, P the projection onto the bounds. 0 at the
    /// solution alone.
    pub residual: f64,
}

/// Solves programs of one size again and again, without allocation after the first.
#[derive(Debug, Clone)]
pub struct QpSolver {
    sizes: Sizes,
    factors: Factors,
    /// Inputs and states.
    z: Blocks,
    w: Blocks,
    costates: Blocks,
    forward: Blocks,
    direction: Blocks,
    trial: Blocks,
    regularisation: f64,
}

impl QpSolver {
    /// For programs of these sizes.
    pub fn new(qp: &StageQp) -> Self {
        let sizes = qp.sizes;
        let all = || Blocks::zeros(sizes.stages + 1, sizes.all);
        Self {
            factors: Factors::of(&sizes),
            z: all(),
            w: all(),
            costates: all(),
            forward: Blocks::zeros(sizes.stages, sizes.first),
            direction: all(),
            trial: all(),
            regularisation: 0.0,
            sizes,
        }
    }

    /// Inputs that the next search begins with, row-major `[N, m]`; as long as nobody says, those of the last solution.
    ///
    /// # Errors
    /// [`Error::Value`] for another length.
    pub fn start_from(&mut self, inputs: &[f64]) -> Result<()> {
        let Sizes { m, stages, .. } = self.sizes;
        if inputs.len() != stages * m {
            let remedy = "Give one row of inputs per stage.";
            return Err(Error::value("length of the inputs", inputs.len(), format!("{}", stages * m), remedy));
        }
        for (k, row) in inputs.chunks_exact(m).enumerate() {
            self.z.of_mut(k)[..m].copy_from_slice(row);
        }
        Ok(())
    }

    /// Solves a program from the state `start`, `[n]`.
    ///
    /// # Panics
    /// If the program or the start is of other sizes.
    pub fn solve(&mut self, qp: &StageQp, start: &[f64], settings: &QpSettings) -> QpReport {
        assert!(qp.sizes == self.sizes && start.len() == self.sizes.n, "sizes of the program");
        let Sizes { n, first, stages, .. } = self.sizes;
        self.regularisation = settings.regularisation;
        self.z.of_mut(0)[first..first + n].copy_from_slice(start);
        self.hold_within(qp);
        roll_out(qp, &mut self.z);
        for k in 0..stages {
            self.factors.free.of_mut(k).fill(-1.0); // neither free nor held: all are new
        }
        let mut report = QpReport { status: QpStatus::Stopped, iterations: 0, factorised: 0, residual: f64::INFINITY };
        loop {
            slopes(qp, &self.z, &mut self.factors, &mut self.w);
            costates(qp, &self.w, &mut self.costates);
            let changed = self.hold(qp);
            if report.iterations > 0 {
                report.residual = self.residual(qp);
                if report.residual.is_nan() {
                    return QpReport { status: QpStatus::NotFinite, ..report };
                }
                if report.residual <= settings.tolerance {
                    return QpReport { status: QpStatus::Solved, ..report };
                }
            }
            if report.iterations >= settings.max_iterations {
                return report;
            }
            // a soft bound may have been passed anywhere
            let last = if qp.soft.iter().any(|bounds| !bounds.is_empty()) { Some(stages - 1) } else { changed };
            if let Some(last) = last {
                report.factorised += last + 1;
                if let Err(stage) = factorise(qp, &mut self.factors, last, settings.regularisation) {
                    let pivot = self.factors.pivots.of(stage)[..self.sizes.m].iter().sum::<f64>();
                    let status = if pivot.is_finite() { QpStatus::NotConvex(stage) } else { QpStatus::NotFinite };
                    return QpReport { status, ..report };
                }
            }
            report.iterations += 1;
            if !self.advance(qp) {
                report.residual = self.residual(qp);
                let is_solved = report.residual <= settings.tolerance;
                return QpReport { status: if is_solved { QpStatus::Solved } else { QpStatus::Stopped }, ..report };
            }
        }
    }

    /// Puts the inputs within their bounds, and onto a bound those that differ from it by rounding: a step that ends there by sum of where
    /// it began and how far it went would else stop short of it, and the next one would be as short as the difference.
    fn hold_within(&mut self, qp: &StageQp) {
        let Sizes { m, stages, .. } = self.sizes;
        for k in 0..stages {
            let (z, lower, upper) = (self.z.of_mut(k), qp.lower.of(k), qp.upper.of(k));
            for i in 0..m {
                let own = if z[i].is_nan() { 0.0 } else { z[i] };
                let is_at = |bound: f64| (own - bound).abs() <= AT_BOUND * (1.0 + bound.abs().min(1e300));
                z[i] = if is_at(lower[i]) { lower[i] } else if is_at(upper[i]) { upper[i] } else { own };
                z[i] = z[i].max(lower[i]).min(upper[i]);
            }
        }
    }

    /// Finds which inputs are held; the last stage where that changes.
    fn hold(&mut self, qp: &StageQp) -> Option<usize> {
        let Sizes { m, stages, .. } = self.sizes;
        let mut changed = None;
        for k in 0..stages {
            let (z, slope) = (self.z.of(k), self.costates.of(k));
            let (lower, upper, free) = (qp.lower.of(k), qp.upper.of(k), self.factors.free.of_mut(k));
            for i in 0..m {
                let is_held = z[i] <= lower[i] && slope[i] >= 0.0 || z[i] >= upper[i] && slope[i] <= 0.0;
                let own = if is_held { 0.0 } else { 1.0 };
                if free[i] != own {
                    free[i] = own;
                    changed = Some(k);
                }
            }
        }
        changed
    }

    fn residual(&self, qp: &StageQp) -> f64 {
        let Sizes { m, stages, .. } = self.sizes;
        let mut largest: f64 = 0.0;
        for k in 0..stages {
            let (z, slope, pivots) = (self.z.of(k), self.costates.of(k), self.factors.pivots.of(k));
            let (lower, upper) = (qp.lower.of(k), qp.upper.of(k));
            for i in 0..m {
                let range = upper[i] - lower[i];
                let moved = z[i] - (z[i] - slope[i] / pivots[i]).max(lower[i]).min(upper[i]);
                let own = if range.is_finite() { moved.abs() / range.max(f64::MIN_POSITIVE) } else { moved.abs() };
                // also where it is no number
                largest = if own <= largest { largest } else { own };
            }
        }
        largest
    }

    /// One step that lowers the cost; false where there is none.
    fn advance(&mut self, qp: &StageQp) -> bool {
        let Self { factors, z, w, costates, forward, direction, trial, sizes, .. } = self;
        feed_forward(qp, factors, w, forward);
        let Sizes { n, first, stages, .. } = *sizes;
        let at = |bounded| At { z, w, costates, bounded };
        direction.of_mut(0)[first..first + n].fill(0.0);
        trial.of_mut(0)[first..first + n].fill(0.0);
        let accepted = |[change, slope]: [f64; 2], trial: &Blocks| {
            let change = change + soft_change(qp, z, trial);
            slope < 0.0 && change <= ENOUGH * slope
        };
        let mut taken = accepted(step(qp, factors, &at(true), Way::Feedback, forward, trial), trial);
        if !taken {
            step(qp, factors, &at(false), Way::Feedback, forward, direction);
            let mut length = 1.0;
            while !taken && length > SHORTEST {
                taken = accepted(step(qp, factors, &at(true), Way::Scaled(length), direction, trial), trial);
                length *= 0.5;
            }
        }
        if taken {
            for k in 0..=stages {
                let (z, step) = (self.z.of_mut(k), self.trial.of(k));
                z.iter_mut().zip(step).for_each(|(z, step)| *z += step);
            }
            self.hold_within(qp);
        }
        taken
    }

    /// xₖ, `[n]`, of the last solution.
    ///
    /// # Panics
    /// For a stage beyond N.
    pub fn state(&self, stage: usize) -> &[f64] {
        let Sizes { n, first, .. } = self.sizes;
        &self.z.of(stage)[first..first + n]
    }

    /// uₖ, `[m]`.
    ///
    /// # Panics
    /// For a stage beyond N − 1.
    pub fn input(&self, stage: usize) -> &[f64] {
        assert!(stage < self.sizes.stages, "stage {stage} of {}", self.sizes.stages);
        &self.z.of(stage)[..self.sizes.m]
    }

    /// Costate of xₖ, `[n]`: the slope of the cost from there on.
    ///
    /// # Panics
    /// For a stage beyond N.
    pub fn costate(&self, stage: usize) -> &[f64] {
        let Sizes { n, first, .. } = self.sizes;
        &self.costates.of(stage)[first..first + n]
    }

    /// Whether an input is free, not held at a bound, in the last factorisation.
    ///
    /// # Panics
    /// For a stage or input that there is not.
    pub fn is_free(&self, stage: usize, input: usize) -> bool {
        self.factors.free.of(stage)[..self.sizes.m][input] != 0.0
    }

    /// u += K δ of the free inputs of a stage.
    pub(super) fn add_feedback(&self, stage: usize, error: &[f64], input: &mut [f64]) {
        let Sizes { m, first, all, .. } = self.sizes;
        let (swept, free) = (self.factors.of_stage(stage), self.factors.free.of(stage));
        for (j, e) in error.iter().enumerate() {
            let column = &swept[(first + j) * all..(first + j) * all + m];
            for i in 0..m {
                input[i] -= free[i] * column[i] * e;
            }
        }
    }

    /// Factorises with the inputs that are held at the solution, so that gains and costs to go are those there.
    pub(super) fn refactorise(&mut self, qp: &StageQp) {
        let last = self.sizes.stages - 1;
        // it was factorised with more inputs held or fewer; where that is not convex, what was there stays
        let _ = factorise(qp, &mut self.factors, last, self.regularisation);
    }

    /// Slope of the cost along the last solution from 0.
    pub(super) fn slope(&self, qp: &StageQp) -> f64 {
        let blocks = (0..=self.sizes.stages).map(|k| (self.z.of(k), qp.slopes.of(k)));
        blocks.map(|(z, slope)| z.iter().zip(slope).map(|(z, h)| z * h).sum::<f64>()).sum()
    }

    /// K of a stage, m × n: δu = K δx about the solution, 0 for inputs that are held.
    ///
    /// # Panics
    /// For a stage beyond N − 1.
    pub fn gain(&self, stage: usize) -> DMatrix<f64> {
        let Sizes { n, m, first, all, .. } = self.sizes;
        let (swept, free) = (self.factors.of_stage(stage), self.factors.free.of(stage));
        DMatrix::from_fn(m, n, |i, j| -free[i] * swept[(first + j) * all + i])
    }

    /// P of a stage, n × n: ½ δxᵀ P δx is what a deviation costs beside its slope.
    ///
    /// # Panics
    /// For a stage beyond N.
    pub fn cost_to_go(&self, stage: usize) -> DMatrix<f64> {
        let Sizes { n, first, all, .. } = self.sizes;
        let swept = self.factors.of_stage(stage);
        DMatrix::from_fn(n, n, |i, j| swept[(first + j) * all + first + i])
    }

    /// The cost of the last solution.
    pub fn cost(&self, qp: &StageQp) -> f64 {
        let Sizes { n, m, stages, first, all, .. } = self.sizes;
        let mut sum = 0.0;
        for k in 0..=stages {
            let (z, hessian, slope) = (self.z.of(k), qp.hessians.of(k), qp.slopes.of(k));
            let own = |z: usize| if z < m { z } else { first + z - m };
            for j in (0..n + m).map(own) {
                let product: f64 = (0..n + m).map(own).map(|i| hessian[j * all + i] * z[i]).sum();
                sum += if k < stages || j >= first { z[j] * (0.5 * product + slope[j]) } else { 0.0 };
            }
            for bound in if k > 0 { &qp.soft[k - 1][..] } else { &[] } {
                sum += 0.5 * bound.weight * bound.beyond(z[first + bound.state]).powi(2);
            }
        }
        sum
    }
}

/// What soft bounds add to the change of a quadratic step, whose slopes know of them already.
fn soft_change(qp: &StageQp, z: &Blocks, step: &Blocks) -> f64 {
    let first = qp.sizes.first;
    let mut sum = 0.0;
    for (k, bounds) in qp.soft.iter().enumerate() {
        let (z, step) = (z.of(k + 1), step.of(k + 1));
        for bound in bounds {
            let (at, by) = (z[first + bound.state], step[first + bound.state]);
            let (before, after) = (bound.beyond(at), bound.beyond(at + by));
            sum += bound.weight * (0.5 * (after - before) * (after + before) - before * by);
        }
    }
    sum
}

#[cfg(test)]
mod tests;
