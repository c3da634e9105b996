//! Trajectories of least cost: iterated linear-quadratic regulators with bounds.
//!
//! An iteration expands the problem about its trajectory ([`StageExpansion`]), solves the quadratic program with all bounds on inputs
//! ([`QpSolver`]), and rolls the system out under the policy that the program gives,
//!
//! ```text
//! uₖ = P(ūₖ + α vₖ + Kₖ ((xₖ ⊖ x̄ₖ) − α δₖ))     xₖ₊₁ = f(xₖ, uₖ) ⊕ −(1 − α) cₖ
//! ```
//!
//! with the largest α of 1, ½, ¼ … that lowers cost and gaps enough. Gaps close by the share α of a step, so a start need not obey the
//! dynamics. Conditions g ≤ 0, h = 0 are kept by an augmented Lagrangian around it.
//!
//! Source: Li and Todorov 2004 (the iteration); Tassa, Mansard and Todorov 2014 (bounds); Mastalli and others 2020 (gaps); Bertsekas 1982
//! and Howell, Jackson and Manchester 2019 (conditions). The bounds are kept by the program of all stages at once, not stage by stage.

use super::problem::{OptimalProblem, OptimalTrajectory, length};
use super::qp_solver::{QpSettings, QpSolver, QpStatus};
use super::stage_expansion::{Expanded, StageExpansion};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

with_defaults! {
    /// When an [`Ilqr`] ends, and how it keeps conditions.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct IlqrSettings {
        /// Solved where a step would lower the cost by less than this share of 1 + |cost|, and gaps are below it too.
        pub tolerance: f64 = 1e-9,
        /// Most iterations, over all rounds of conditions.
        pub max_iterations: usize = 200,
        /// Largest violation of a condition.
        pub condition_tolerance: f64 = 1e-6,
        /// Weight of squares of conditions at first.
        pub penalty: f64 = 10.0,
        /// Most rounds of multipliers; with 1 there is the penalty alone, which mostly ends as [`IlqrStatus::Violated`].
        pub max_rounds: usize = 25,
    }
}

/// How a search for a trajectory ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IlqrStatus {
    /// Within the tolerances; of a model with exact curvatures a minimum, of another a place where the slope is zero.
    Solved,
    /// Out of iterations.
    OutOfIterations,
    /// No step lowers the cost any more, but the place is not surely flat: rounding is in the way, or an input has no weight.
    NoStep,
    /// A condition stays violated.
    Violated,
}

/// One iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IlqrIteration {
    /// The cost of the trajectory that was found, with squares of conditions.
    pub cost: f64,
    /// Σ |c| of its gaps.
    pub gap: f64,
    /// Largest violation of a condition of that trajectory.
    pub violation: f64,
    /// By how much the program expected the cost to fall.
    pub expected: f64,
    /// α; 0 where none was taken.
    pub step: f64,
    /// What was added to the diagonal of every R.
    pub regularisation: f64,
    /// Newton steps of the program.
    pub newton_steps: usize,
    /// Round of multipliers, from 0.
    pub round: usize,
}

/// What a search came to.
#[derive(Debug, Clone, PartialEq)]
pub struct IlqrReport {
    /// How it ended.
    pub status: IlqrStatus,
    /// Of the trajectory, without squares of conditions.
    pub cost: f64,
    /// Σ |c| of its gaps.
    pub gap: f64,
    /// Largest violation of a condition.
    pub violation: f64,
    /// All iterations.
    pub iterations: Vec<IlqrIteration>,
}

/// Shortest step.
const SHORTEST: f64 = 1.0 / 1024.0;

/// Share of what a step is expected to gain that it must gain.
const ENOUGH: f64 = 0.05;

/// Regularisation at first and at most, as shares of the largest curvature by an input.
const REGULARISATION: [f64; 2] = [1e-8, 1e8];

/// A search for trajectories of problems of one [`StageModel`](super::StageModel) and length; for another it panics.
#[derive(Debug, Clone)]
pub struct Ilqr {
    expansion: StageExpansion,
    solver: QpSolver,
    trajectory: OptimalTrajectory,
    trial: OptimalTrajectory,
    error: Vec<f64>,
    /// −(1 − α) c.
    shift: Vec<f64>,
    /// λₖ₊₁ of every stage, where exact curvatures are there.
    costates: Vec<f64>,
    /// Whether those are of this problem.
    knows_costates: bool,
}

impl Ilqr {
    /// For problems of these sizes.
    ///
    /// # Errors
    /// [`Error::Limit`] for more than 1024 states and inputs.
    pub fn new(problem: &OptimalProblem) -> Result<Self> {
        let expansion = StageExpansion::new(problem)?;
        let (n, m, stages) = (problem.model().n_state(), problem.model().n_input(), problem.n_stage());
        let empty = OptimalTrajectory { states: vec![0.0; (stages + 1) * n], inputs: vec![0.0; stages * m] };
        let n_error = problem.model().errors.n_error();
        let [error, shift] = [0, 1].map(|_| vec![0.0; n_error]);
        let solver = QpSolver::new(&expansion.qp);
        let costates = vec![0.0; stages * n_error];
        let (trial, trajectory) = (empty.clone(), empty);
        Ok(Self { expansion, solver, trial, trajectory, error, shift, costates, knows_costates: false })
    }

    /// Begins with inputs, row-major `[N, n_input]`, and the states that follow from them.
    ///
    /// # Errors
    /// [`Error::Value`] for another length, or a number that is not finite.
    pub fn start_from_inputs(&mut self, problem: &OptimalProblem, inputs: &[f64]) -> Result<()> {
        length("inputs", inputs.len(), self.trajectory.inputs.len())?;
        base::error::finite("inputs", inputs)?;
        let (n, m) = (problem.model().n_state(), problem.model().n_input());
        self.take_inputs(problem, inputs);
        self.trajectory.states[..n].copy_from_slice(problem.start());
        for k in 0..problem.n_stage() {
            let (states, input) = (&mut self.trajectory.states[k * n..], &self.trajectory.inputs[k * m..(k + 1) * m]);
            self.expansion.evaluate(problem, k, &states[..n], input);
            states[n..2 * n].copy_from_slice(&self.expansion.work.single_results[..n]);
            if let Some(at) = states[n..2 * n].iter().position(|x| !x.is_finite()) {
                let what = format!("state {at} behind stage {k} of the first guess");
                let remedy = "Begin with inputs that fly, or with states of your own.";
                return Err(Error::value(what, states[n + at], "finite", remedy));
            }
        }
        Ok(())
    }

    /// Begins with states and inputs, whether they obey the dynamics or not; the first state is that of the problem, quaternions are made unit
    /// ones.
    ///
    /// # Errors
    /// [`Error::Value`] for another length, a number that is not finite, or a quaternion of no length.
    pub fn start_from(&mut self, problem: &OptimalProblem, guess: &OptimalTrajectory) -> Result<()> {
        length("inputs", guess.inputs.len(), self.trajectory.inputs.len())?;
        length("states", guess.states.len(), self.trajectory.states.len())?;
        base::error::finite("inputs", &guess.inputs)?;
        base::error::finite("states", &guess.states)?;
        self.take_inputs(problem, &guess.inputs);
        let n = problem.model().n_state();
        self.trajectory.states.copy_from_slice(&guess.states);
        self.trajectory.states[..n].copy_from_slice(problem.start());
        self.trajectory.states.chunks_exact_mut(n).try_for_each(|state| problem.model().errors.unite(state))
    }

    /// Inputs of a guess, put within their bounds before anything can be refused.
    fn take_inputs(&mut self, problem: &OptimalProblem, inputs: &[f64]) {
        let m = problem.model().n_input();
        self.trajectory.inputs.copy_from_slice(inputs);
        for (k, input) in self.trajectory.inputs.chunks_exact_mut(m).enumerate() {
            let (lower, upper) = problem.bounds(k);
            input
                .iter_mut()
                .zip(lower.iter().zip(upper))
                .for_each(|(u, (lower, upper))| *u = u.max(*lower).min(*upper));
        }
    }

    /// The trajectory as it stands.
    pub fn trajectory(&self) -> &OptimalTrajectory {
        &self.trajectory
    }

    /// Kₖ, n_input × n_error, of all stages: δu = K (x ⊖ x̄) is the optimal answer to small deviations from the trajectory, 0 for inputs at
    /// a bound. Time-varying LQR along it.
    pub fn gains(&self) -> Vec<DMatrix<f64>> {
        (0..self.expansion.qp.n_stage()).map(|k| self.solver.gain(k)).collect()
    }

    /// Lowers the cost from where it stands; `progress` is told every iteration.
    ///
    /// # Errors
    /// [`Error::Value`] where the cost or a derivative is not finite where the search begins, or not convex in the inputs however much is
    /// added to it; as the settings.
    pub fn solve(
        &mut self,
        problem: &OptimalProblem,
        settings: &IlqrSettings,
        mut progress: impl FnMut(usize, &IlqrIteration),
    ) -> Result<IlqrReport> {
        self.solve_while(problem, settings, |k, iteration| {
            progress(k, iteration);
            true
        })
    }

    /// As [`solve`](Self::solve), as long as `goes_on` answers an iteration with yes; it is out of iterations behind a no.
    ///
    /// # Errors
    /// As [`solve`](Self::solve).
    pub fn solve_while(
        &mut self,
        problem: &OptimalProblem,
        settings: &IlqrSettings,
        mut goes_on: impl FnMut(usize, &IlqrIteration) -> bool,
    ) -> Result<IlqrReport> {
        settings.validate()?;
        self.knows_costates = false;
        let mut iterations = Vec::new();
        let has_conditions = !self.expansion.conditions.values.is_empty();
        let conditions = &mut self.expansion.conditions;
        conditions.shifts.fill(0.0);
        conditions.weights.fill(settings.penalty);
        let mut last = f64::INFINITY;
        for round in 0.. {
            let mut is_told_to_stop = false;
            let mut told = |k: usize, iteration: &IlqrIteration| {
                is_told_to_stop = !goes_on(k, iteration);
                !is_told_to_stop
            };
            let status = self.descend(problem, settings, round, &mut iterations, &mut told)?;
            let (cost, gap) = self.judged(problem);
            let violation = self.violation(problem);
            let report = |status| IlqrReport { status, cost, gap, violation, iterations: iterations.clone() };
            let left = violation.max(self.slack_of_multipliers(problem));
            let is_kept = left <= settings.condition_tolerance;
            if !has_conditions || is_kept && status == IlqrStatus::Solved {
                return Ok(report(status));
            }
            if is_told_to_stop || iterations.len() >= settings.max_iterations {
                return Ok(report(IlqrStatus::OutOfIterations));
            }
            if round + 1 >= settings.max_rounds {
                let is_violated = !is_kept && status != IlqrStatus::OutOfIterations;
                return Ok(report(if is_violated { IlqrStatus::Violated } else { status }));
            }
            self.multiply(problem, left > 0.25 * last);
            last = left;
        }
        unreachable!("rounds end")
    }

    /// Iterations of one round.
    fn descend(
        &mut self,
        problem: &OptimalProblem,
        settings: &IlqrSettings,
        round: usize,
        iterations: &mut Vec<IlqrIteration>,
        goes_on: &mut impl FnMut(usize, &IlqrIteration) -> bool,
    ) -> Result<IlqrStatus> {
        let (mut factor, mut weight_of_gaps) = (0.0_f64, 0.0_f64);
        let (mut is_first, mut is_stuck) = (true, false);
        // below this the program was not convex
        let mut least = 0.0_f64;
        loop {
            let Expanded { cost, gap } = self.expansion.expand(problem, &self.trajectory);
            if is_first && !(cost.is_finite() && gap.is_finite()) {
                let remedy = "Begin with another guess, or bound what the cost divides by.";
                return Err(Error::value("cost of the first guess", cost, "finite", remedy));
            }
            is_first = false;
            let violation = self.violation(problem);
            let scale = self.largest_curvature();
            let mut is_exact = self.knows_costates && problem.model().has_curvature();
            if is_exact {
                self.expansion.curve(problem, &self.trajectory, &self.costates);
            }
            let (report, expected, slope) = loop {
                let qp = &self.expansion.qp;
                let qp_settings = QpSettings { regularisation: factor * scale, ..QpSettings::default() };
                let start = vec![0.0; qp.n_state()];
                let report = self.solver.solve(qp, &start, &qp_settings);
                match report.status {
                    QpStatus::Solved | QpStatus::Stopped => {
                        let expected = self.solver.change(qp);
                        break (report, expected, self.solver.slope(qp));
                    }
                    QpStatus::NotFinite => {
                        let remedy = "Keep what the cost divides by, or takes roots of, away from zero.";
                        return Err(Error::value("derivatives of the cost or the dynamics", "NaN", "finite", remedy));
                    }
                    QpStatus::NotConvex(_) if is_exact => {
                        self.expansion.expand(problem, &self.trajectory);
                        is_exact = false;
                    }
                    QpStatus::NotConvex(_) if factor < REGULARISATION[1] => {
                        factor = (10.0 * factor).max(REGULARISATION[0]);
                        least = factor;
                    }
                    QpStatus::NotConvex(stage) => {
                        let what = format!("curvature of the cost by the inputs of stage {stage}");
                        let remedy = "Weigh every input, or give the cost as squares.";
                        return Err(Error::value(what, "negative", "positive", remedy));
                    }
                }
            };
            let knew_costates = self.knows_costates;
            if problem.model().has_curvature() {
                self.keep_costates();
            }
            // exact penalty: gaps weigh more than what closing them may cost
            if gap > 0.0 {
                weight_of_gaps = weight_of_gaps.max(2.0 * expected.max(0.0) / gap);
            }
            let is_closed = gap <= settings.tolerance * (1.0 + self.trajectory.states.len() as f64);
            let is_flat = expected.abs() <= settings.tolerance * (1.0 + cost.abs());
            if is_closed && is_flat {
                if factor == 0.0 {
                    if problem.model().has_curvature() && !knew_costates {
                        // a saddle is flat too: the exact curvature tells
                        continue;
                    }
                    let is_sure = report.status == QpStatus::Solved && is_exact == problem.model().has_curvature();
                    return Ok(if is_sure { IlqrStatus::Solved } else { IlqrStatus::NoStep });
                }
                // what is added to the curvature shortens steps, so that every place looks flat
                if is_stuck || factor <= least {
                    return Ok(IlqrStatus::NoStep);
                }
                factor = relaxed(factor).max(least);
                continue;
            }
            if iterations.len() >= settings.max_iterations {
                return Ok(IlqrStatus::OutOfIterations);
            }
            let merit = cost + weight_of_gaps * gap;
            let (mut alpha, mut taken) = (1.0, None);
            while alpha >= SHORTEST {
                let found = self.roll_out(problem, alpha);
                // where soft bounds bend the cost, the slope alone is sure
                let bent = alpha * slope + alpha * alpha * (expected - slope);
                let gained = if bent < 0.0 { bent } else { alpha * slope } - weight_of_gaps * alpha * gap;
                let rounding = 1e-14 * (1.0 + merit.abs());
                let own = found + weight_of_gaps * (1.0 - alpha) * gap;
                if own.is_finite() && own - merit <= ENOUGH * gained + rounding && gained < 0.0 {
                    taken = Some(found);
                    break;
                }
                alpha *= 0.5;
            }
            let mut iteration = IlqrIteration {
                cost,
                gap,
                violation,
                expected: -expected,
                step: 0.0,
                regularisation: factor * scale,
                newton_steps: report.iterations,
                round,
            };
            if let Some(found) = taken {
                std::mem::swap(&mut self.trajectory, &mut self.trial);
                (iteration.cost, iteration.gap, iteration.step) = (found, (1.0 - alpha) * gap, alpha);
                iteration.violation = self.violation(problem);
                factor = if alpha > 0.5 { relaxed(factor) } else { factor };
                least = 0.0;
            }
            is_stuck = taken.is_none();
            let is_told_to_stop = !goes_on(iterations.len(), &iteration);
            iterations.push(iteration);
            if is_told_to_stop {
                return Ok(IlqrStatus::OutOfIterations);
            }
            if taken.is_none() {
                if factor >= REGULARISATION[1] {
                    return Ok(if is_closed { IlqrStatus::NoStep } else { IlqrStatus::OutOfIterations });
                }
                factor = (100.0 * factor).max(1e-4);
            }
        }
    }

    fn keep_costates(&mut self) {
        let n = self.error.len();
        for (k, own) in self.costates.chunks_exact_mut(n).enumerate() {
            own.copy_from_slice(self.solver.costate(k + 1));
        }
        self.knows_costates = true;
    }

    fn largest_curvature(&self) -> f64 {
        let qp = &self.expansion.qp;
        let (m, all) = (qp.sizes.m, qp.sizes.all);
        let of_stage = |k: usize| (0..m).map(move |i| qp.hessians.of(k)[i * all + i].abs());
        (0..qp.sizes.stages).flat_map(of_stage).fold(1e-12, f64::max)
    }

    /// The trial trajectory of a step; its cost.
    fn roll_out(&mut self, problem: &OptimalProblem, alpha: f64) -> f64 {
        let Self { expansion, solver, trajectory, trial, error, shift, .. } = self;
        let model = problem.model();
        let (n, m, errors) = (model.n_state(), model.n_input(), &model.errors);
        let n_error = errors.n_error();
        trial.states[..n].copy_from_slice(problem.start());
        let mut cost = 0.0;
        for k in 0..problem.n_stage() {
            let (state, behind) = trial.states[k * n..(k + 2) * n].split_at_mut(n);
            errors.write_difference(state, &trajectory.states[k * n..(k + 1) * n], error);
            error.iter_mut().zip(solver.state(k)).for_each(|(e, step)| *e -= alpha * step);
            let input = &mut trial.inputs[k * m..(k + 1) * m];
            let before = &trajectory.inputs[k * m..(k + 1) * m];
            for (i, u) in input.iter_mut().enumerate() {
                *u = before[i] + alpha * solver.input(k)[i];
            }
            solver.add_feedback(k, error, input);
            let (lower, upper) = problem.bounds(k);
            input
                .iter_mut()
                .zip(lower.iter().zip(upper))
                .for_each(|(u, (lower, upper))| *u = u.max(*lower).min(*upper));
            cost += expansion.evaluate(problem, k, state, input);
            behind.copy_from_slice(&expansion.work.single_results[..n]);
            if alpha < 1.0 {
                let gaps = &expansion.qp.gaps.of(k)[..n_error];
                shift.iter_mut().zip(gaps).for_each(|(shift, c)| *shift = -(1.0 - alpha) * c);
                errors.move_by(behind, shift);
            }
        }
        let stages = problem.n_stage();
        cost += expansion.evaluate(problem, stages, &trial.states[stages * n..], &[]);
        cost + expansion.soft_cost(trial)
    }

    /// Cost of the trajectory without squares of conditions, and its gaps.
    fn judged(&mut self, problem: &OptimalProblem) -> (f64, f64) {
        let weights = std::mem::take(&mut self.expansion.conditions.weights);
        self.expansion.conditions.weights = vec![0.0; weights.len()];
        let Expanded { cost, gap } = self.expansion.expand(problem, &self.trajectory);
        self.expansion.conditions.weights = weights;
        (cost, gap)
    }

    /// Whether each condition is g ≤ 0.
    fn kinds(problem: &OptimalProblem) -> impl Iterator<Item = bool> + '_ {
        let lengths = problem.model().lengths;
        (0..=problem.n_stage()).flat_map(move |k| {
            let end = usize::from(k == problem.n_stage());
            (0..lengths.n_condition[end]).map(move |c| c < lengths.n_at_most[end])
        })
    }

    fn violation(&self, problem: &OptimalProblem) -> f64 {
        let own = self.expansion.conditions.values.iter().zip(Self::kinds(problem));
        own.map(|(g, is_at_most)| if is_at_most { g.max(0.0) } else { g.abs() }).fold(0.0, f64::max)
    }

    /// Largest min(−g, λ/w) of the conditions g ≤ 0 with multipliers λ: how far one that pushes is from acting.
    ///
    /// Source: Birgin and Martínez 2014, chapter 4.
    fn slack_of_multipliers(&self, problem: &OptimalProblem) -> f64 {
        let conditions = &self.expansion.conditions;
        let own = conditions.values.iter().zip(&conditions.shifts).zip(Self::kinds(problem));
        own.map(|((g, shift), is_at_most)| if is_at_most { shift.min(-g) } else { 0.0 }).fold(0.0, f64::max)
    }

    /// New multipliers, and larger weights where violations do not fall.
    fn multiply(&mut self, problem: &OptimalProblem, grows: bool) {
        let conditions = &mut self.expansion.conditions;
        let all = conditions.shifts.iter_mut().zip(&mut conditions.weights).zip(&conditions.values);
        for (((shift, weight), value), is_at_most) in all.zip(Self::kinds(problem)) {
            *shift += value;
            if is_at_most {
                *shift = shift.max(0.0);
            }
            if grows && *weight < 1e10 {
                (*weight, *shift) = (10.0 * *weight, 0.1 * *shift);
            }
        }
    }
}

impl IlqrSettings {
    /// Checks that tolerances and penalty are > 0, and that there is an iteration and a round.
    ///
    /// # Errors
    /// [`Error::Value`] for the first that is not.
    pub fn validate(&self) -> Result<()> {
        let positive = [
            ("tolerance", self.tolerance),
            ("condition_tolerance", self.condition_tolerance),
            ("penalty", self.penalty),
        ];
        if let Some((what, value)) = positive.into_iter().find(|(_, x)| !(*x > 0.0 && x.is_finite())) {
            return Err(Error::value(what, value, "> 0", "Leave it out for the default."));
        }
        for (what, value) in [("max_iterations", self.max_iterations), ("max_rounds", self.max_rounds)] {
            if value == 0 {
                return Err(Error::value(what, value, "≥ 1", "Leave it out for the default."));
            }
        }
        Ok(())
    }
}

/// A tenth of a regularisation, or none.
fn relaxed(factor: f64) -> f64 {
    Some(0.1 * factor).filter(|next| *next >= REGULARISATION[0]).unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
