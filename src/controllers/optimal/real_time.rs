//! Model predictive control by real-time iteration: one quadratic program a tick, about the plan of the last.
//!
//! The plan of the last tick is carried on to the time of this one, the problem is expanded about it, and its program is solved from the
//! state that is measured; of the step as much is taken as lowers cost and gaps, nearly always all of it. Plans need not obey the dynamics between ticks: gaps are closed as the next
//! program does. With more iterations a tick it is full sequential quadratic programming.
//!
//! Source: Diehl, Bock and Schlöder 2005 (real-time iteration); Gros, Zanon, Quirynen, Bemporad and Diehl 2020.

use super::largest;
use super::problem::{OptimalProblem, OptimalTrajectory, length};
use super::qp_solver::{QpReport, QpSettings, QpSolver, QpStatus};
use super::stage_expansion::{Expanded, StageExpansion};
use super::stage_qp::StageQp;
use base::error::Result;

/// Gaps of a plan, on average over its stages and in SI units, above which it is rolled out anew.
const LARGEST_GAP: f64 = 5.0;

/// Numbers of states above which a flight under the inputs of the plan is no better guess than the plan.
const LARGEST_STATE: f64 = 1e6;

/// Share of what a step is expected to gain that it must gain.
const ENOUGH: f64 = 0.05;

/// Least share of a step.
const SHORTEST_SHARE: f64 = 0.125;

/// Programs behind the first of a tick do not make cost and gaps so many times as large: from far away, they may lead ever farther.
const MOST_GROWTH: f64 = 2.0;

/// A receding problem and the plan that stands.
#[derive(Debug, Clone)]
pub struct RealTimeIteration {
    problem: OptimalProblem,
    expansion: StageExpansion,
    solver: QpSolver,
    plan: OptimalTrajectory,
    settings: QpSettings,
    error: Vec<f64>,
    moved: Vec<f64>,
    /// λₖ₊₁ of every stage, where the model has exact curvatures.
    costates: Vec<f64>,
    trial: OptimalTrajectory,
}

/// What a tick came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TickReport {
    /// Of the last program.
    pub qp: QpReport,
    /// Recursions of all programs.
    pub recursions: usize,
    /// Cost of the plan that the last program was made about.
    pub cost: f64,
    /// Σ |c| of its gaps.
    pub gap: f64,
    /// Largest number of the last step: of inputs in their ranges, of states in SI units; NaN where it was not gone.
    pub step: f64,
    /// Whether the plan comes from this tick: its first program was solved, or stopped within its bounds, and led somewhere.
    pub is_planned: bool,
}

impl RealTimeIteration {
    /// Of a problem, with the plan that rests at its start under these inputs, `[n_input]`.
    ///
    /// # Errors
    /// [`Error::Value`](base::error::Error::Value) for another length; [`Error::Limit`](base::error::Error::Limit) for more than 1024 states
    /// and inputs.
    pub fn new(problem: OptimalProblem, inputs: &[f64]) -> Result<Self> {
        let (m, stages) = (problem.model().n_input(), problem.n_stage());
        length("inputs", inputs.len(), m)?;
        let expansion = StageExpansion::new(&problem)?;
        let n_error = problem.model().errors.n_error();
        let plan = OptimalTrajectory { states: problem.start().repeat(stages + 1), inputs: inputs.repeat(stages) };
        Ok(Self {
            solver: QpSolver::new(&expansion.qp),
            error: vec![0.0; n_error],
            moved: vec![0.0; n_error],
            costates: vec![0.0; stages * n_error],
            trial: plan.clone(),
            settings: QpSettings::default(),
            expansion,
            plan,
            problem,
        })
    }

    /// The problem.
    pub fn problem(&self) -> &OptimalProblem {
        &self.problem
    }

    /// The problem, to say what a tick is about.
    pub fn problem_mut(&mut self) -> &mut OptimalProblem {
        &mut self.problem
    }

    /// The plan that stands.
    pub fn plan(&self) -> &OptimalTrajectory {
        &self.plan
    }

    /// Another plan to begin with.
    ///
    /// # Errors
    /// [`Error::Value`](base::error::Error::Value) for another length, or numbers that are not finite.
    pub fn begin_with(&mut self, plan: &OptimalTrajectory) -> Result<()> {
        length("states of the plan", plan.states.len(), self.plan.states.len())?;
        length("inputs of the plan", plan.inputs.len(), self.plan.inputs.len())?;
        base::error::finite("states of the plan", &plan.states)?;
        base::error::finite("inputs of the plan", &plan.inputs)?;
        self.plan.copy_from(plan);
        self.solver.forget();
        Ok(())
    }

    /// Begins with a plan that rests at a state under these inputs.
    pub(super) fn begin_at_rest(&mut self, state: &[f64], inputs: &[f64]) -> Result<()> {
        let stages = self.problem.n_stage();
        self.begin_with(&OptimalTrajectory { states: state.repeat(stages + 1), inputs: inputs.repeat(stages) })
    }

    /// Carries the plan on by a share of a stage, 0 to 1: states and inputs between those of two stages, the last ones kept.
    pub fn carry_on(&mut self, share: f64) {
        let (n, m) = (self.problem.model().n_state(), self.problem.model().n_input());
        let stages = self.problem.n_stage();
        let errors = &self.problem.model().errors;
        for k in 0..stages {
            let (own, next) = self.plan.states[k * n..(k + 2) * n].split_at_mut(n);
            errors.write_difference(next, own, &mut self.error);
            self.error.iter_mut().for_each(|e| *e *= share);
            errors.move_by(own, &self.error);
            if k + 1 < stages {
                let (own, next) = self.plan.inputs[k * m..(k + 2) * m].split_at_mut(m);
                own.iter_mut().zip(next).for_each(|(own, next)| *own += share * (*next - *own));
            }
        }
        if share >= 1.0 {
            self.solver.shift();
        }
    }

    /// Plans from a state, `[n_state]`, by so many programs; fewer where a step is shorter than `tolerance`. Programs behind the first have
    /// exact curvatures where the model has them and they are convex.
    ///
    /// # Panics
    /// If `state` has another length.
    pub fn tick(&mut self, state: &[f64], iterations: usize, tolerance: f64) -> TickReport {
        let n = self.problem.model().n_state();
        assert_eq!(state.len(), n, "states");
        let mut report = self.iterate(state, false, f64::INFINITY);
        for _ in 1..iterations {
            if !report.step.is_finite() || report.step <= tolerance && report.gap <= tolerance {
                break;
            }
            let next = self.iterate(state, self.problem.model().has_curvature(), MOST_GROWTH);
            report = TickReport { recursions: report.recursions + next.recursions, is_planned: true, ..next };
        }
        report
    }

    /// One program about the plan, and its step unless that makes cost and gaps so many times as large.
    fn iterate(&mut self, state: &[f64], is_exact: bool, growth: f64) -> TickReport {
        let n = self.problem.model().n_state();
        let mut expanded = self.expansion.expand(&self.problem, &self.plan);
        if !(expanded.gap <= LARGEST_GAP * self.problem.n_stage() as f64 && expanded.cost.is_finite()) {
            self.roll_out(state);
            expanded = self.expansion.expand(&self.problem, &self.plan);
        }
        let Expanded { cost, gap } = expanded;
        let errors = &self.problem.model().errors;
        errors.write_difference(state, &self.plan.states[..n], &mut self.error);
        let gap = gap + self.error.iter().map(|e| e.abs()).sum::<f64>();
        if is_exact {
            self.expansion.curve(&self.problem, &self.plan, &self.costates);
        }
        let mut qp = self.solver.solve(&self.expansion.qp, &self.error, &self.settings);
        if is_exact && matches!(qp.status, QpStatus::NotConvex(_)) {
            self.expansion.expand(&self.problem, &self.plan);
            qp = self.solver.solve(&self.expansion.qp, &self.error, &self.settings);
        }
        if self.problem.model().has_curvature() {
            let n = self.error.len();
            for (k, own) in self.costates.chunks_exact_mut(n).enumerate() {
                own.copy_from_slice(self.solver.costate(k + 1));
            }
        }
        let mut step = f64::NAN;
        if matches!(qp.status, QpStatus::Solved | QpStatus::Stopped) {
            step = self.advance(cost, gap, growth);
        }
        TickReport { qp, recursions: qp.iterations, cost, gap, step, is_planned: step.is_finite() }
    }

    /// Goes the longest of the shares 1, ½, ¼, ⅛ of the step that lowers the cost with its gaps; where none does the shortest, unless that
    /// makes them so many times as large. The largest number of the whole step; NaN where none was gone.
    fn advance(&mut self, cost: f64, gap: f64, growth: f64) -> f64 {
        let stages = self.problem.n_stage();
        // a gap costs at most its costate
        let of_stage = |k: usize| self.solver.costate(k).iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        let weight = (0..=stages).map(of_stage).fold(0.0, f64::max);
        let slope = self.solver.slope(&self.expansion.qp) - weight * gap;
        let merit = cost + weight * gap;
        let (mut length, mut whole) = (1.0, None);
        loop {
            let taken = self.write_trial(length);
            let step = *whole.get_or_insert(taken);
            let (found, left) = self.judge_trial();
            let own = found + weight * (left + (1.0 - length) * self.error.iter().map(|e| e.abs()).sum::<f64>());
            let is_lower = own <= merit + ENOUGH * length * slope + 1e-12 * merit.abs();
            if is_lower || length <= SHORTEST_SHARE {
                if !(own.is_finite() && step.is_finite() && own <= growth * merit.abs().max(1.0)) {
                    return f64::NAN;
                }
                std::mem::swap(&mut self.plan, &mut self.trial);
                return step;
            }
            length *= 0.5;
        }
    }

    /// The plan after a share of the solver's step; its largest number.
    fn write_trial(&mut self, length: f64) -> f64 {
        let (n, m) = (self.problem.model().n_state(), self.problem.model().n_input());
        let Self { problem, solver, plan, trial, moved, .. } = self;
        let mut step: f64 = 0.0;
        trial.states.copy_from_slice(&plan.states);
        for k in 0..=problem.n_stage() {
            moved.iter_mut().zip(solver.state(k)).for_each(|(moved, x)| *moved = length * x);
            step = moved.iter().fold(step, |step, x| largest(step, x.abs()));
            problem.model().errors.move_by(&mut trial.states[k * n..(k + 1) * n], moved);
        }
        for k in 0..problem.n_stage() {
            let (lower, upper) = problem.bounds(k);
            for (i, moved) in solver.input(k).iter().enumerate() {
                let range = upper[i] - lower[i];
                let scale = if range.is_finite() && range > 0.0 { 1.0 / range } else { 1.0 };
                step = largest(step, scale * length * moved.abs());
                trial.inputs[k * m + i] = (plan.inputs[k * m + i] + length * moved).max(lower[i]).min(upper[i]);
            }
        }
        step
    }

    /// Cost and gaps of the trial.
    fn judge_trial(&mut self) -> (f64, f64) {
        let (n, m) = (self.problem.model().n_state(), self.problem.model().n_input());
        let Self { problem, expansion, trial, moved, .. } = self;
        let (mut cost, mut gap) = (0.0, 0.0);
        for k in 0..problem.n_stage() {
            let state = &trial.states[k * n..(k + 1) * n];
            cost += expansion.evaluate(problem, k, state, &trial.inputs[k * m..(k + 1) * m]);
            let next = &expansion.work.single_results[..n];
            problem.model().errors.write_difference(next, &trial.states[(k + 1) * n..(k + 2) * n], moved);
            gap += moved.iter().map(|e| e.abs()).sum::<f64>();
        }
        let stages = problem.n_stage();
        cost += expansion.evaluate(problem, stages, &trial.states[stages * n..], &[]);
        (cost + expansion.soft_cost(trial), gap)
    }

    /// States that follow from a state and the inputs of the plan; the plan stays where they lead beyond all measure.
    fn roll_out(&mut self, state: &[f64]) {
        let (n, m) = (self.problem.model().n_state(), self.problem.model().n_input());
        self.trial.states[..n].copy_from_slice(state);
        for k in 0..self.problem.n_stage() {
            let (own, next) = self.trial.states[k * n..(k + 2) * n].split_at_mut(n);
            self.expansion.evaluate(&self.problem, k, own, &self.plan.inputs[k * m..(k + 1) * m]);
            next.copy_from_slice(&self.expansion.work.single_results[..n]);
        }
        if self.trial.states.iter().all(|x| x.abs() <= LARGEST_STATE) {
            std::mem::swap(&mut self.plan.states, &mut self.trial.states);
            self.solver.forget();
        }
    }

    /// uₖ of the plan, `[n_input]`.
    ///
    /// # Panics
    /// For a stage beyond N − 1.
    pub fn input(&self, stage: usize) -> &[f64] {
        let m = self.problem.model().n_input();
        &self.plan.inputs[stage * m..(stage + 1) * m]
    }

    /// xₖ of the plan, `[n_state]`.
    ///
    /// # Panics
    /// For a stage beyond N.
    pub fn state(&self, stage: usize) -> &[f64] {
        let n = self.problem.model().n_state();
        &self.plan.states[stage * n..(stage + 1) * n]
    }

    /// The last program, about the plan that stood before it.
    #[doc(hidden)]
    pub fn program(&self) -> &StageQp {
        &self.expansion.qp
    }

    /// The solver of the last program.
    pub fn solver(&self) -> &QpSolver {
        &self.solver
    }
}
