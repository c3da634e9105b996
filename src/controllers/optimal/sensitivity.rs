//! How a solution depends on its start and its parameters.
//!
//! At a solution with inputs held at their bounds the first-order conditions are equations, and the implicit function theorem gives
//!
//! ```text
//! [H Gᵀ; G 0] [w; μ] = [s; 0]        dsᵀz = −(wᵀ ∂²L/∂z∂p + μᵀ ∂f/∂p) dp − μ₀ᵀ dx₀
//! ```
//!
//! with H the exact Hessian of the Lagrangian, G the linearised dynamics and s what is asked of z = (x, u). It is a program of the same
//! structure, solved by one more recursion. Where a bound is about to act or to be left the solution has a kink: the derivative is that of
//! the set that stands ([`least_distance`](SolutionSensitivity::least_distance) tells how near that is).
//!
//! Source: Fiacco 1983; Frey and others 2025 (solution sensitivities of optimal control in acados).

use super::largest;
use super::problem::{OptimalProblem, OptimalTrajectory};
use super::qp_solver::{QpSettings, QpSolver, QpStatus};
use super::stage_expansion::StageExpansion;
use super::stage_model::Lengths;
use base::error::{Error, Result};
use nalgebra::{DMatrix, DVector};

/// Largest step that the program about a solution may ask for: of inputs in their unit, of states in theirs.
const SETTLED: f64 = 1e-5;

/// The derivative of a solution, in both directions.
#[derive(Debug, Clone)]
pub struct SolutionSensitivity {
    expansion: StageExpansion,
    solver: QpSolver,
    trajectory: OptimalTrajectory,
    parameters: Vec<f64>,
    costates: Vec<f64>,
    distance: f64,
}

/// Adjoints of start and parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct SolutionAdjoint {
    /// Of x₀, `[n_state]`.
    pub start: Vec<f64>,
    /// Of the parameters of all stages, row-major `[N + 1, n_parameter]`.
    pub parameters: Vec<f64>,
}

impl SolutionSensitivity {
    /// Of the solution of a problem whose model has [exact curvatures](super::StageModel::with_curvature).
    ///
    /// # Errors
    /// [`Error::Value`] for a model without them, a trajectory that is no solution, or one where the second-order conditions do not hold.
    pub fn new(problem: &OptimalProblem, solution: &OptimalTrajectory) -> Result<Self> {
        if !problem.model().has_curvature() {
            let remedy = "Make it by StageModel::with_curvature.";
            return Err(Error::value("model of the problem", "without exact curvatures", "with them", remedy));
        }
        if problem.model().n_condition() != [0, 0] {
            let remedy = "Give them as costs.";
            return Err(Error::value("conditions of the problem", "there", "none, to be differentiated", remedy));
        }
        let mut expansion = StageExpansion::new(problem)?;
        expansion.expand(problem, solution);
        let mut solver = QpSolver::new(&expansion.qp);
        let n = expansion.qp.n_state();
        let report = solver.solve(&expansion.qp, &vec![0.0; n], &QpSettings::default());
        let steps = (0..problem.n_stage()).flat_map(|k| solver.input(k).iter().chain(solver.state(k + 1)));
        let step = steps.fold(0.0, |most, x| largest(most, x.abs()));
        let is_solved = matches!(report.status, QpStatus::Solved | QpStatus::Stopped);
        if !(is_solved && step <= SETTLED) {
            let value = if is_solved { format!("{step:e} away") } else { format!("{:?}", report.status) };
            let remedy = "Solve it to convergence first.";
            return Err(Error::value("solution to be differentiated", value, "within 1e-5 of one", remedy));
        }
        let costates: Vec<f64> = (1..=problem.n_stage()).flat_map(|k| solver.costate(k).to_vec()).collect();
        let distance = least_distance(problem, solution, &solver);
        expansion.curve(problem, solution, &costates);
        for k in 0..=problem.n_stage() {
            expansion.qp.slopes.of_mut(k).fill(0.0);
        }
        for k in 0..problem.n_stage() {
            expansion.qp.gaps.of_mut(k).fill(0.0);
            // soft bounds that are passed are squares like others
            let (first, all) = (expansion.qp.sizes.first, expansion.qp.sizes.all);
            for bound in std::mem::take(&mut expansion.qp.soft[k]) {
                if solver.is_passed(k + 1, bound.state) {
                    expansion.qp.hessians.of_mut(k + 1)[(first + bound.state) * (all + 1)] += bound.weight;
                }
            }
        }
        let parameters = (0..=problem.n_stage()).flat_map(|k| problem.parameters(k).to_vec()).collect();
        let mut own = Self { expansion, solver, trajectory: solution.clone(), parameters, costates, distance };
        own.checked()?;
        Ok(own)
    }

    /// Whether the second-order conditions hold.
    fn checked(&mut self) -> Result<()> {
        self.solver.solve_held(&self.expansion.qp).map_err(|status| {
            let remedy = "It is no strict minimum: weigh every input.";
            Error::value(
                "curvature at the solution",
                format!("{status:?}"),
                "positive on what the dynamics allow",
                remedy,
            )
        })
    }

    /// How far the nearest input is from where the set of active bounds changes: a free one from its bounds, in shares of their range.
    pub fn least_distance(&self) -> f64 {
        self.distance
    }

    /// Adjoints of start and parameters for those of the solution: of uₖ, row-major `[N, n_input]`, and of the errors of xₖ,
    /// row-major `[N + 1, n_error]`; empty for none.
    ///
    /// # Panics
    /// For other lengths.
    pub fn reverse(&mut self, problem: &OptimalProblem, inputs: &[f64], errors: &[f64]) -> SolutionAdjoint {
        let Lengths { n_state, n_error, n_input, n_parameter, .. } = problem.model().lengths;
        let stages = problem.n_stage();
        assert!(inputs.is_empty() || inputs.len() == stages * n_input, "adjoints of inputs");
        assert!(errors.is_empty() || errors.len() == (stages + 1) * n_error, "adjoints of states");
        let first = self.expansion.qp.sizes.first;
        for k in 0..=stages {
            let slope = self.expansion.qp.slopes.of_mut(k);
            slope.fill(0.0);
            if k < stages && !inputs.is_empty() {
                (0..n_input).for_each(|i| slope[i] = -inputs[k * n_input + i]);
            }
            if !errors.is_empty() {
                (0..n_error).for_each(|i| slope[first + i] = -errors[k * n_error + i]);
            }
        }
        // the factorisation was checked with the same numbers
        let _ = self.solver.solve_held(&self.expansion.qp);
        let mut parameters = Vec::with_capacity((stages + 1) * n_parameter);
        for k in 0..=stages {
            let is_end = k == stages;
            let mut arguments = self.trajectory.states[k * n_state..(k + 1) * n_state].to_vec();
            if !is_end {
                arguments.extend_from_slice(&self.trajectory.inputs[k * n_input..(k + 1) * n_input]);
            }
            arguments.extend_from_slice(&self.parameters[k * n_parameter..(k + 1) * n_parameter]);
            self.expansion.extend_conditions(k, &mut arguments);
            if !is_end {
                arguments.extend_from_slice(&self.costates[k * n_error..(k + 1) * n_error]);
            }
            arguments.extend_from_slice(self.solver.state(k));
            if !is_end {
                arguments.extend_from_slice(self.solver.input(k));
                arguments.extend_from_slice(self.solver.costate(k + 1));
            }
            parameters.extend(problem.model().pull(is_end, &arguments).into_iter().map(|x| -x));
        }
        let own = DVector::from_iterator(n_error, self.solver.costate(0).iter().map(|x| -x));
        let back = problem.model().errors.cotangent(&self.trajectory.states[..n_state]);
        SolutionAdjoint { start: back.tr_mul(&own).as_slice().to_vec(), parameters }
    }

    /// ∂u₀/∂x₀, n_input × n_state, and ∂u₀/∂p of all stages, n_input × (N + 1) n_parameter: for derivatives forward.
    pub fn first_input(&mut self, problem: &OptimalProblem) -> (DMatrix<f64>, DMatrix<f64>) {
        let (m, stages) = (problem.model().n_input(), problem.n_stage());
        let rows: Vec<SolutionAdjoint> = (0..m)
            .map(|i| {
                let mut inputs = vec![0.0; stages * m];
                inputs[i] = 1.0;
                self.reverse(problem, &inputs, &[])
            })
            .collect();
        let by_start = DMatrix::from_fn(m, rows[0].start.len(), |i, j| rows[i].start[j]);
        let by_parameters = DMatrix::from_fn(m, rows[0].parameters.len(), |i, j| rows[i].parameters[j]);
        (by_start, by_parameters)
    }
}

fn least_distance(problem: &OptimalProblem, at: &OptimalTrajectory, solver: &QpSolver) -> f64 {
    let m = problem.model().n_input();
    let mut least = f64::INFINITY;
    for k in 0..problem.n_stage() {
        let (lower, upper) = problem.bounds(k);
        for i in (0..m).filter(|i| solver.is_free(k, *i)) {
            let (u, range) = (at.inputs[k * m + i], upper[i] - lower[i]);
            let own = (u - lower[i]).min(upper[i] - u) / if range.is_finite() { range } else { 1.0 };
            least = least.min(own);
        }
    }
    least
}

#[cfg(test)]
mod tests;
