//! The solution of a [`StageQp`]: by sets of held inputs where they are nearly known, by an interior-point method where they are not.
//!
//! - A **set step** takes some inputs for held at a bound and some soft bounds for passed: what is left has no bounds, and a Riccati
//!   recursion solves it. Inputs that then violate a bound are held, held ones that would leave it are let go, and the stages up to the
//!   last change are factorised anew (a primal-dual active set; Hintermüller, Ito and Kunisch 2003). From a good guess, as the last tick's,
//!   it takes one to three steps to the exact solution.
//! - From a bad one it may not end. Then the [interior-point method](super::interior_point) goes on, whose steps depend little on how many
//!   bounds act, until it tells which do; set steps finish.
//!
//! Whatever ends the search, inputs are within their bounds.

use super::interior_point::Barriers;
use super::largest;
use super::stage_qp::{Blocks, Sizes, SoftBound, StageQp};
use super::stage_sweeps::{Factors, costates, factorise, feed_forward, roll_out, slopes, step};
use base::defaults::with_defaults;
use nalgebra::DMatrix;

/// A free input may be beyond a bound by this share of 1 + |bound|: it is rounding, and put back.
const AT_BOUND: f64 = 1e-12;

/// Set steps before an interior-point method takes over, and behind it.
const MOST_SET_STEPS: usize = 5;

/// Most steps that remove what rounding left.
const REFINEMENTS: usize = 2;

/// Shares of the first μ at which set steps are tried.
const FINISH: [f64; 4] = [1e-4, 1e-7, 1e-10, 1e-13];

with_defaults! {
    /// When a [`QpSolver`] ends.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct QpSettings {
        /// Largest [`QpReport::residual`] of a solution.
        pub tolerance: f64 = 1e-9,
        /// Most recursions.
        pub max_iterations: usize = 60,
        /// Added to the diagonal of every R.
        pub regularisation: f64 = 0.0,
    }
}

/// How a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum QpStatus {
    /// Within the tolerance.
    Solved,
    /// Out of iterations, or at the end of what rounding allows: a point within the bounds, and how far from the solution the residual
    /// tells.
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
    /// Recursions over stages, whole or in part.
    pub iterations: usize,
    /// How many of them are of the interior-point method.
    pub interior: usize,
    /// Stages that were factorised.
    pub factorised: usize,
    /// Largest |u − P(u − g/d)| over the inputs, as a share of the range between their bounds (of 1 without bounds): g the slope of
    /// the cost with the states eliminated, d the size of its curvature with later inputs optimal, P the projection onto the bounds. 0
    /// at the solution alone.
    pub residual: f64,
}

/// Solves programs of one size again and again, without allocation after the first.
#[derive(Debug, Clone)]
pub struct QpSolver {
    sizes: Sizes,
    factors: Factors,
    /// Inputs and states.
    z: Blocks,
    /// Where the interior-point method stands while sets are tried.
    inside: Blocks,
    w: Blocks,
    /// Slopes with barriers.
    pushed: Blocks,
    costates: Blocks,
    forward: Blocks,
    step: Blocks,
    barriers: Barriers,
    /// 1 where an input is held above, −1 below, 0 where it is free.
    held: Blocks,
    /// Likewise of soft bounds that are passed, by states.
    passed: Blocks,
    regularisation: f64,
}

/// What a set step came to.
enum SetStep {
    /// All signs are right.
    Fits,
    /// The last stage where a set changed.
    Changed(usize),
}

type Failure = QpStatus;

impl QpSolver {
    /// For programs of these sizes.
    pub fn new(qp: &StageQp) -> Self {
        let sizes = qp.sizes;
        let all = || Blocks::zeros(sizes.stages + 1, sizes.all);
        Self {
            factors: Factors::of(&sizes),
            z: all(),
            inside: all(),
            w: all(),
            pushed: all(),
            costates: all(),
            forward: Blocks::zeros(sizes.stages, sizes.first),
            step: all(),
            barriers: Barriers::default(),
            held: Blocks::zeros(sizes.stages, sizes.first),
            passed: Blocks::zeros(sizes.stages + 1, sizes.all),
            regularisation: 0.0,
            sizes,
        }
    }

    /// Forgets which bounds acted.
    pub fn forget(&mut self) {
        self.held.fill(0.0);
        self.passed.fill(0.0);
        self.z.fill(0.0);
    }

    /// Takes the bounds that acted in stage k + 1 for those of stage k, as a receding horizon does.
    pub fn shift(&mut self) {
        let Sizes { stages, .. } = self.sizes;
        for k in 1..stages {
            for blocks in [&mut self.held, &mut self.z] {
                let (own, next) = blocks.pair_mut(k - 1);
                own.copy_from_slice(next);
            }
        }
        for k in 1..=stages {
            let (own, next) = self.passed.pair_mut(k - 1);
            own.copy_from_slice(next);
        }
    }

    /// Solves a program from the state `start`, `[n]`, beginning with the bounds that acted in the last one.
    ///
    /// # Panics
    /// If the program or the start is of other sizes.
    pub fn solve(&mut self, qp: &StageQp, start: &[f64], settings: &QpSettings) -> QpReport {
        assert!(qp.sizes == self.sizes && start.len() == self.sizes.n, "sizes of the program");
        let Sizes { n, first, .. } = self.sizes;
        self.regularisation = settings.regularisation;
        self.z.of_mut(0)[first..first + n].copy_from_slice(start);
        let mut report =
            QpReport { status: QpStatus::Stopped, iterations: 0, interior: 0, factorised: 0, residual: f64::INFINITY };
        let end = self
            .by_sets(qp, settings, &mut report)
            .and_then(|is_solved| if is_solved { Ok(true) } else { self.by_barriers(qp, settings, &mut report) });
        match end {
            Err(status) => {
                self.within(qp);
                report.status = status;
            }
            Ok(fits) => {
                report.residual = self.residual(qp);
                for _ in 0..if fits { REFINEMENTS } else { 0 } {
                    if report.residual <= settings.tolerance {
                        break;
                    }
                    let fits = self.refine(qp);
                    report.residual = self.residual(qp);
                    if !fits {
                        break;
                    }
                }
                if report.residual.is_nan() {
                    report.status = QpStatus::NotFinite;
                } else if report.residual <= settings.tolerance {
                    report.status = QpStatus::Solved;
                }
            }
        }
        report
    }

    /// Set steps; whether they ended.
    fn by_sets(
        &mut self,
        qp: &StageQp,
        settings: &QpSettings,
        report: &mut QpReport,
    ) -> std::result::Result<bool, Failure> {
        let mut last = self.sizes.stages - 1;
        self.fit_sets(qp);
        for _ in 0..MOST_SET_STEPS {
            if report.iterations >= settings.max_iterations {
                break;
            }
            match self.set_step(qp, last, report)? {
                SetStep::Fits => return Ok(true),
                SetStep::Changed(stage) => last = stage,
            }
        }
        Ok(false)
    }

    /// Bounds of a single value hold, and those that there are not do not.
    fn fit_sets(&mut self, qp: &StageQp) {
        let Sizes { m, stages, first, .. } = self.sizes;
        for k in 0..stages {
            let (lower, upper, held) = (qp.lower.of(k), qp.upper.of(k), self.held.of_mut(k));
            for i in 0..m {
                let bound = if held[i] > 0.0 { upper[i] } else { lower[i] };
                if lower[i] == upper[i] {
                    held[i] = 1.0;
                } else if !bound.is_finite() {
                    held[i] = 0.0;
                }
            }
            let passed = self.passed.of_mut(k + 1);
            if qp.soft[k].is_empty() {
                passed.fill(0.0);
            }
            for bound in &qp.soft[k] {
                let own = &mut passed[first + bound.state];
                let beyond = if *own > 0.0 { bound.upper } else { bound.lower };
                if !beyond.is_finite() {
                    *own = 0.0;
                }
            }
        }
    }

    /// The solution for the sets that stand, and how they change.
    fn set_step(&mut self, qp: &StageQp, last: usize, report: &mut QpReport) -> std::result::Result<SetStep, Failure> {
        self.prepare(qp, true);
        report.iterations += 1;
        report.factorised += last + 1;
        self.factorise(qp, last)?;
        roll_out(qp, &mut self.z);
        self.find_slopes(qp);
        feed_forward(qp, &self.factors, &self.w, &mut self.forward);
        self.take(qp, 1.0);
        self.find_slopes(qp);
        costates(qp, &self.w, &mut self.costates);
        Ok(self.change_sets(qp))
    }

    /// One more step with the factors and sets that stand: what rounding left of the first, where numbers of a program are of very different
    /// sizes. Whether the sets still fit.
    fn refine(&mut self, qp: &StageQp) -> bool {
        feed_forward(qp, &self.factors, &self.w, &mut self.forward);
        self.take(qp, 1.0);
        self.find_slopes(qp);
        costates(qp, &self.w, &mut self.costates);
        let fits = matches!(self.change_sets(qp), SetStep::Fits);
        if !fits {
            self.within(qp);
            roll_out(qp, &mut self.z);
            self.find_slopes(qp);
            costates(qp, &self.w, &mut self.costates);
        }
        fits
    }

    /// What is added to the diagonal for the sets that stand, and which inputs are free; held ones are moved to their bounds.
    fn prepare(&mut self, qp: &StageQp, moves: bool) {
        let Sizes { m, stages, first, .. } = self.sizes;
        self.factors.added.fill(0.0);
        for k in 0..stages {
            let (held, free, added) = (self.held.of(k), self.factors.free.of_mut(k), self.factors.added.of_mut(k));
            let (lower, upper, z) = (qp.lower.of(k), qp.upper.of(k), self.z.of_mut(k));
            for i in 0..m {
                added[i] = self.regularisation;
                free[i] = if held[i] == 0.0 { 1.0 } else { 0.0 };
                if moves {
                    z[i] = match held[i] {
                        0.0 if z[i].is_finite() => z[i],
                        0.0 => 0.0,
                        side if side > 0.0 => upper[i],
                        _ => lower[i],
                    };
                }
            }
            let (passed, added) = (self.passed.of(k + 1), self.factors.added.of_mut(k + 1));
            for bound in &qp.soft[k] {
                if passed[first + bound.state] != 0.0 {
                    added[first + bound.state] += bound.weight;
                }
            }
        }
    }

    fn factorise(&mut self, qp: &StageQp, last: usize) -> std::result::Result<(), Failure> {
        factorise(qp, &mut self.factors, last).map_err(|stage| {
            let pivots = &self.factors.pivots.of(stage)[..self.sizes.m];
            let swept = self.factors.of_stage(stage);
            let is_finite = pivots.iter().chain(swept).all(|p| p.is_finite());
            if is_finite { QpStatus::NotConvex(stage) } else { QpStatus::NotFinite }
        })
    }

    /// w at z, with the slopes of soft bounds that count as passed.
    fn find_slopes(&mut self, qp: &StageQp) {
        let first = self.sizes.first;
        self.find_plain_slopes(qp);
        for (k, bounds) in qp.soft.iter().enumerate() {
            let (z, passed, w) = (self.z.of(k + 1), self.passed.of(k + 1), self.w.of_mut(k + 1));
            for bound in bounds {
                let at = first + bound.state;
                if passed[at] != 0.0 {
                    let beyond = if passed[at] > 0.0 { bound.upper } else { bound.lower };
                    w[at] += bound.weight * (z[at] - beyond);
                }
            }
        }
    }

    /// w at z without soft bounds, with what was added to R.
    fn find_plain_slopes(&mut self, qp: &StageQp) {
        let Sizes { m, stages, .. } = self.sizes;
        slopes(qp, &self.z, &mut self.w);
        for k in 0..stages {
            let (z, w) = (self.z.of(k), self.w.of_mut(k));
            (0..m).for_each(|i| w[i] += self.regularisation * z[i]);
        }
    }

    /// Goes a share of the step that what inputs add by themselves leads to.
    fn take(&mut self, qp: &StageQp, share: f64) {
        let Sizes { n, first, stages, .. } = self.sizes;
        self.step.of_mut(0)[first..first + n].fill(0.0);
        step(qp, &self.factors, &self.forward, &mut self.step);
        self.go(share, stages);
    }

    fn go(&mut self, share: f64, stages: usize) {
        for k in 0..=stages {
            let (z, step) = (self.z.of_mut(k), self.step.of(k));
            z.iter_mut().zip(step).for_each(|(z, step)| *z += share * step);
        }
    }

    /// Which inputs are held and which soft bounds are passed, by signs at the point that stands. Where all are right, inputs that are
    /// beyond a bound by rounding are put onto it.
    fn change_sets(&mut self, qp: &StageQp) -> SetStep {
        let Sizes { m, stages, first, .. } = self.sizes;
        let mut changed = None;
        for k in 0..stages {
            let (lower, upper, held) = (qp.lower.of(k), qp.upper.of(k), self.held.of_mut(k));
            let (z, slope) = (self.z.of_mut(k), self.costates.of(k));
            for i in 0..m {
                let before = held[i];
                if lower[i] == upper[i] {
                    continue;
                }
                if before == 0.0 {
                    let beyond = |bound: f64| AT_BOUND * (1.0 + bound.abs().min(1e300));
                    if z[i] > upper[i] + beyond(upper[i]) {
                        held[i] = 1.0;
                    } else if z[i] < lower[i] - beyond(lower[i]) {
                        held[i] = -1.0;
                    } else {
                        z[i] = z[i].max(lower[i]).min(upper[i]);
                    }
                } else if before * slope[i] > 0.0 {
                    held[i] = 0.0;
                }
                if held[i] != before {
                    changed = Some(k);
                }
            }
            let (z, passed) = (self.z.of(k + 1), self.passed.of_mut(k + 1));
            for bound in &qp.soft[k] {
                let (own, x) = (&mut passed[first + bound.state], z[first + bound.state]);
                let now = if x > bound.upper {
                    1.0
                } else if x < bound.lower {
                    -1.0
                } else {
                    0.0
                };
                if now != *own {
                    // it is in P of its stage, hence in all before it
                    *own = now;
                    changed = Some(changed.map_or(k, |c: usize| c.max(k)).max((k + 1).min(stages - 1)));
                }
            }
        }
        changed.map_or(SetStep::Fits, SetStep::Changed)
    }

    /// Steps of the interior-point method, then set steps; whether these ended.
    fn by_barriers(
        &mut self,
        qp: &StageQp,
        settings: &QpSettings,
        report: &mut QpReport,
    ) -> std::result::Result<bool, Failure> {
        let Sizes { m, stages, first, .. } = self.sizes;
        self.within(qp);
        self.barriers.begin(qp, &mut self.z);
        if self.barriers.all.is_empty() {
            return Ok(false);
        }
        roll_out(qp, &mut self.z);
        self.find_plain_slopes(qp);
        costates(qp, &self.w, &mut self.costates);
        self.barriers.centre(&self.z, &self.costates, first);
        let (start, mut finish) = (self.barriers.mu(), FINISH.iter());
        let mut next = finish.next();
        while report.iterations < settings.max_iterations {
            self.factors.added.fill(0.0);
            for k in 0..stages {
                let (lower, upper) = (qp.lower.of(k), qp.upper.of(k));
                let (free, added) = (self.factors.free.of_mut(k), self.factors.added.of_mut(k));
                for i in 0..m {
                    free[i] = if lower[i] < upper[i] { 1.0 } else { 0.0 };
                    added[i] = self.regularisation;
                }
            }
            self.barriers.add_curvature(&mut self.factors.added);
            report.iterations += 1;
            report.interior += 1;
            report.factorised += stages;
            self.factorise(qp, stages - 1)?;
            self.find_plain_slopes(qp);
            // predictor
            self.barriers.keep_second_order(false);
            let longest = self.aim(qp, 0.0);
            let mu = self.barriers.mu();
            let left = (self.barriers.mu_after(longest.min(1.0)) / mu).max(0.0);
            // corrector
            self.barriers.keep_second_order(true);
            let longest = self.aim(qp, left.powi(3) * mu);
            let share = Barriers::taken(longest);
            if share.is_nan() || share <= 1e-10 || !mu.is_finite() {
                break;
            }
            self.go(share, stages);
            let is_due = next.is_some_and(|next| self.barriers.mu_after(share) <= next * start);
            if is_due {
                self.read_sets();
            }
            self.barriers.advance(share);
            if is_due {
                next = finish.next();
                self.inside.copy_from(&self.z);
                if self.by_sets(qp, settings, report)? {
                    return Ok(true);
                }
                self.z.copy_from(&self.inside);
                if next.is_none() {
                    break;
                }
            }
        }
        self.within(qp);
        roll_out(qp, &mut self.z);
        self.read_sets();
        self.read_passed(qp);
        self.prepare(qp, false);
        report.iterations += 1;
        report.factorised += stages;
        self.factorise(qp, stages - 1)?;
        self.find_slopes(qp);
        costates(qp, &self.w, &mut self.costates);
        Ok(false)
    }

    /// A step towards products t y = μ; the largest share of it that keeps slacks and multipliers positive.
    fn aim(&mut self, qp: &StageQp, mu: f64) -> f64 {
        let Sizes { n, first, stages, .. } = self.sizes;
        for k in 0..=stages {
            self.pushed.of_mut(k).copy_from_slice(self.w.of(k));
        }
        self.barriers.add_push(&self.z, mu, &mut self.pushed);
        feed_forward(qp, &self.factors, &self.pushed, &mut self.forward);
        self.step.of_mut(0)[first..first + n].fill(0.0);
        step(qp, &self.factors, &self.forward, &mut self.step);
        self.barriers.follow(&self.z, &self.step, mu)
    }

    /// Bounds that act, as barriers tell.
    fn read_sets(&mut self) {
        self.held.fill(0.0);
        self.passed.fill(0.0);
        for b in self.barriers.all.iter().filter(|b| b.is_active()) {
            let set = if b.at < self.sizes.first { &mut self.held } else { &mut self.passed };
            set.of_mut(b.stage)[b.at] = b.sign;
        }
    }

    /// Soft bounds that are passed at z.
    fn read_passed(&mut self, qp: &StageQp) {
        let first = self.sizes.first;
        for (k, bounds) in qp.soft.iter().enumerate() {
            let (z, passed) = (self.z.of(k + 1), self.passed.of_mut(k + 1));
            for bound in bounds {
                let beyond = bound.beyond(z[first + bound.state]);
                passed[first + bound.state] = if beyond == 0.0 { 0.0 } else { beyond.signum() };
            }
        }
    }

    /// Puts the inputs within their bounds.
    fn within(&mut self, qp: &StageQp) {
        let Sizes { m, stages, .. } = self.sizes;
        for k in 0..stages {
            let (z, lower, upper) = (self.z.of_mut(k), qp.lower.of(k), qp.upper.of(k));
            for i in 0..m {
                let own = if z[i].is_nan() { 0.0 } else { z[i] };
                z[i] = own.max(lower[i]).min(upper[i]);
            }
        }
    }

    fn residual(&self, qp: &StageQp) -> f64 {
        let Sizes { m, stages, .. } = self.sizes;
        let mut worst: f64 = 0.0;
        for k in 0..stages {
            let (z, slope, pivots) = (self.z.of(k), self.costates.of(k), self.factors.pivots.of(k));
            let (lower, upper) = (qp.lower.of(k), qp.upper.of(k));
            for i in 0..m {
                if !slope[i].is_finite() {
                    return f64::NAN; // a bound would hide it
                }
                let range = upper[i] - lower[i];
                // where a bound holds an input, the cost may be concave in it
                let wanted = z[i] - slope[i] / pivots[i].abs().max(f64::MIN_POSITIVE);
                let moved = z[i] - wanted.max(lower[i]).min(upper[i]);
                let own = if range.is_finite() { moved.abs() / range.max(f64::MIN_POSITIVE) } else { moved.abs() };
                worst = largest(worst, own);
            }
        }
        worst
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

    /// Slopes of the cost by the inputs of a stage, `[m]`, with what follows from them: the multipliers of their bounds, ≥ 0 at the lower one,
    /// ≤ 0 at the upper one, 0 of free inputs but for rounding.
    ///
    /// # Panics
    /// For a stage beyond N − 1.
    pub fn multiplier(&self, stage: usize) -> &[f64] {
        assert!(stage < self.sizes.stages, "stage {stage} of {}", self.sizes.stages);
        &self.costates.of(stage)[..self.sizes.m]
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

    /// Solves a program from δx₀ = 0 with the inputs that are held now, at 0; no bound acts beside that.
    ///
    /// # Errors
    /// [`QpStatus::NotConvex`] or [`QpStatus::NotFinite`].
    pub(super) fn solve_held(&mut self, qp: &StageQp) -> std::result::Result<(), QpStatus> {
        let stages = self.sizes.stages;
        self.regularisation = 0.0;
        self.z.fill(0.0);
        self.prepare(qp, false);
        self.factorise(qp, stages - 1)?;
        self.find_plain_slopes(qp);
        feed_forward(qp, &self.factors, &self.w, &mut self.forward);
        self.take(qp, 1.0);
        self.find_plain_slopes(qp);
        costates(qp, &self.w, &mut self.costates);
        Ok(())
    }

    /// Slope of the cost along the last solution from 0, with soft bounds.
    pub(super) fn slope(&self, qp: &StageQp) -> f64 {
        let blocks = (0..=self.sizes.stages).map(|k| (self.z.of(k), qp.slopes.of(k)));
        let plain: f64 = blocks.map(|(z, slope)| z.iter().zip(slope).map(|(z, h)| z * h).sum::<f64>()).sum();
        let of_bound = |k: usize, b: &SoftBound| b.weight * b.beyond(0.0) * self.state(k + 1)[b.state];
        let soft = qp.soft.iter().enumerate().flat_map(|(k, all)| all.iter().map(move |b| of_bound(k, b)));
        plain + soft.sum::<f64>()
    }

    /// By how much the last solution is cheaper than 0, as a negative number: the cost there less the cost of soft bounds at 0.
    pub(super) fn change(&self, qp: &StageQp) -> f64 {
        let before = qp.soft.iter().flatten().map(|b| 0.5 * b.weight * b.beyond(0.0).powi(2));
        self.cost(qp) - before.sum::<f64>()
    }

    /// Whether a soft bound of a state counts as passed.
    pub(super) fn is_passed(&self, stage: usize, state: usize) -> bool {
        self.passed.of(stage)[self.sizes.first + state] != 0.0
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

#[cfg(test)]
mod tests;
