//! A problem about a trajectory: the quadratic program of what is to be changed.
//!
//! With x = x̄ ⊕ δ and u = ū + v the program has the gaps cₖ = f(x̄ₖ, ūₖ) ⊖ x̄ₖ₊₁, A and B in axes of the errors, exact slopes and
//! Hessians of the cost, and bounds lower − ū ≤ v ≤ upper − ū.

use super::problem::{OptimalProblem, OptimalTrajectory};
use super::stage_model::{Entries, Lengths, StageModel, StageWork};
use super::stage_qp::{SoftBound, StageQp};
use autodiff::columns::LINE;
use base::error::Result;
use std::sync::Arc;

/// Shifts and weights of conditions, `[N, n]`, then those of the end.
#[derive(Debug, Clone, Default)]
pub(super) struct Conditions {
    pub shifts: Vec<f64>,
    pub weights: Vec<f64>,
    /// g and h where they were evaluated last.
    pub values: Vec<f64>,
}

/// What an expansion came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Expanded {
    /// With the squares of conditions and soft bounds.
    pub cost: f64,
    /// Σ |c|.
    pub gap: f64,
}

/// The program about a trajectory, made anew without allocation.
#[derive(Debug, Clone)]
pub(super) struct StageExpansion {
    model: Arc<StageModel>,
    pub work: StageWork,
    pub qp: StageQp,
    pub conditions: Conditions,
    /// f(x̄ₖ, ūₖ), one after the other.
    pub next: Vec<f64>,
    soft: Vec<SoftBound>,
    own_soft: Vec<SoftBound>,
}

impl StageExpansion {
    pub(super) fn new(problem: &OptimalProblem) -> Result<Self> {
        let (model, stages) = (problem.model().clone(), problem.n_stage());
        let Lengths { n_error, n_input, n_state, n_condition, .. } = model.lengths;
        let n = stages * n_condition[0] + n_condition[1];
        let soft: Vec<SoftBound> = (problem.soft_bounds().iter())
            .map(|bound| SoftBound { state: model.errors.place(bound.state), ..*bound })
            .collect();
        Ok(Self {
            work: model.work(),
            qp: StageQp::new(n_error, n_input, stages)?,
            conditions: Conditions { shifts: vec![0.0; n], weights: vec![0.0; n], values: vec![0.0; n] },
            next: vec![0.0; stages * n_state],
            own_soft: problem.soft_bounds().to_vec(),
            soft,
            model,
        })
    }

    /// Where the conditions of a stage begin; of stage N those of the end.
    fn conditions_at(&self, stage: usize) -> usize {
        stage * self.model.lengths.n_condition[0]
    }

    /// Takes on a problem of the same model and length.
    ///
    /// # Panics
    /// For another model or length.
    pub(super) fn take_on(&mut self, problem: &OptimalProblem) {
        let fits = Arc::ptr_eq(problem.model(), &self.model) && problem.n_stage() == self.qp.sizes.stages;
        assert!(fits, "a problem of the model and the stages that this was made for");
        if self.own_soft != problem.soft_bounds() {
            self.own_soft = problem.soft_bounds().to_vec();
            let errors = &self.model.errors;
            self.soft = self.own_soft.iter().map(|b| SoftBound { state: errors.place(b.state), ..*b }).collect();
        }
    }

    /// Makes the program about a trajectory.
    ///
    /// # Panics
    /// As [`take_on`](Self::take_on).
    pub(super) fn expand(&mut self, problem: &OptimalProblem, at: &OptimalTrajectory) -> Expanded {
        self.take_on(problem);
        let stages = problem.n_stage();
        let (mut cost, mut gap) = (0.0, 0.0);
        for from in (0..stages).step_by(LINE) {
            let n = (stages - from).min(LINE);
            for lane in 0..LINE {
                self.write_arguments(problem, at, from + lane.min(n - 1), lane);
            }
            self.model.expand(&mut self.work, n, false);
            for lane in 0..n {
                let stage = from + lane;
                cost += self.read_stage(problem, at, stage, lane);
                gap += self.qp.gaps.of(stage).iter().map(|c| c.abs()).sum::<f64>();
            }
        }
        for lane in 0..LINE {
            self.write_arguments(problem, at, stages, lane);
        }
        self.model.expand(&mut self.work, 1, true);
        cost += self.read_cost(stages, 0, 0);
        Expanded { cost: cost + self.soft_cost(at), gap }
    }

    /// Exact curvatures in place of those by squares, with costates λₖ₊₁ of every stage, `[N, n_error]`.
    pub(super) fn curve(&mut self, problem: &OptimalProblem, at: &OptimalTrajectory, costates: &[f64]) {
        let (stages, n) = (problem.n_stage(), self.model.lengths.n_error);
        let first = self.model.lengths.n_argument(false);
        for from in (0..stages).step_by(LINE) {
            let n_lane = (stages - from).min(LINE);
            for lane in 0..LINE {
                let stage = from + lane.min(n_lane - 1);
                self.write_arguments(problem, at, stage, lane);
                let own = &costates[stage * n..(stage + 1) * n];
                self.work.arguments[first..].iter_mut().zip(own).for_each(|(row, value)| row[lane] = *value);
            }
            self.model.curve(&mut self.work, n_lane, false);
            (0..n_lane).for_each(|lane| self.read_curvature(from + lane, lane));
        }
        (0..LINE).for_each(|lane| self.write_arguments(problem, at, stages, lane));
        self.model.curve(&mut self.work, 1, true);
        self.read_curvature(stages, 0);
    }

    fn read_curvature(&mut self, stage: usize, lane: usize) {
        let (sizes, n_error) = (self.qp.sizes, self.model.lengths.n_error);
        let Some(own) = &self.model.curvatures else { return };
        let place = |z: u32| {
            let z = z as usize;
            if z < n_error { sizes.first + z } else { z - n_error }
        };
        let hessian = self.qp.hessians.of_mut(stage);
        hessian.fill(0.0);
        let entries = &own[usize::from(stage == sizes.stages)].entries;
        for ((row, column), value) in entries.iter().zip(&self.work.results) {
            let (row, column) = (place(*row), place(*column));
            hessian[column * sizes.all + row] = value[lane];
            hessian[row * sizes.all + column] = value[lane];
        }
    }

    /// Arguments of a stage into a lane.
    fn write_arguments(&mut self, problem: &OptimalProblem, at: &OptimalTrajectory, stage: usize, lane: usize) {
        let is_end = stage == problem.n_stage();
        let Lengths { n_state, n_input, n_condition, .. } = self.model.lengths;
        let first = self.conditions_at(stage);
        let own = first..first + n_condition[usize::from(is_end)];
        let input = if is_end { &[][..] } else { &at.inputs[stage * n_input..(stage + 1) * n_input] };
        let all = at.states[stage * n_state..(stage + 1) * n_state]
            .iter()
            .chain(input)
            .chain(problem.parameters(stage))
            .chain(&self.conditions.shifts[own.clone()])
            .chain(&self.conditions.weights[own]);
        for (row, value) in self.work.arguments.iter_mut().zip(all) {
            row[lane] = *value;
        }
    }

    /// The dynamics, bounds and cost of a stage out of a lane; its cost.
    fn read_stage(&mut self, problem: &OptimalProblem, at: &OptimalTrajectory, stage: usize, lane: usize) -> f64 {
        let Lengths { n_state, n_error, n_input, n_condition, .. } = self.model.lengths;
        let sizes = self.qp.sizes;
        for (k, next) in self.next[stage * n_state..(stage + 1) * n_state].iter_mut().enumerate() {
            *next = self.work.results[k][lane];
        }
        let next = &self.next[stage * n_state..(stage + 1) * n_state];
        let wanted = &at.states[(stage + 1) * n_state..(stage + 2) * n_state];
        self.model.errors.write_difference(next, wanted, &mut self.qp.gaps.of_mut(stage)[..n_error]);
        let (columns, by_rows) = (self.qp.columns.of_mut(stage), self.qp.by_rows.of_mut(stage));
        let first = n_state + 1 + n_condition[0];
        for ((row, column), value) in self.model.entries.dynamics.iter().zip(&self.work.results[first..]) {
            let (row, column) = (*row as usize, *column as usize);
            let z = if column < n_error { sizes.first + column } else { column - n_error };
            columns[z * sizes.rows + row] = value[lane];
            by_rows[row * sizes.all + z] = value[lane];
        }
        let (lower, upper) = problem.bounds(stage);
        let input = &at.inputs[stage * n_input..(stage + 1) * n_input];
        let (own_lower, own_upper) = (self.qp.lower.of_mut(stage), self.qp.upper.of_mut(stage));
        for i in 0..n_input {
            own_lower[i] = lower[i] - input[i];
            own_upper[i] = upper[i] - input[i];
        }
        let soft = &mut self.qp.soft[stage];
        soft.clear();
        for (bound, own) in self.soft.iter().zip(&self.own_soft) {
            let x = wanted[own.state];
            soft.push(SoftBound { lower: bound.lower - x, upper: bound.upper - x, ..*bound });
        }
        self.read_cost(stage, lane, n_state)
    }

    /// Slopes and Hessian of a stage out of a lane; its cost.
    fn read_cost(&mut self, stage: usize, lane: usize, first: usize) -> f64 {
        let is_end = stage == self.qp.sizes.stages;
        let Lengths { n_error, n_condition, .. } = self.model.lengths;
        let n_condition = n_condition[usize::from(is_end)];
        let sizes = self.qp.sizes;
        let entries: &Entries = if is_end { &self.model.end_entries } else { &self.model.entries };
        let results = &self.work.results[first..];
        let conditions = self.conditions_at(stage);
        for (k, own) in self.conditions.values[conditions..conditions + n_condition].iter_mut().enumerate() {
            *own = results[1 + k][lane];
        }
        let place = |z: u32| {
            let z = z as usize;
            if z < n_error { sizes.first + z } else { z - n_error }
        };
        let mut values = results[1 + n_condition + if is_end { 0 } else { entries.dynamics.len() }..].iter();
        let slope = self.qp.slopes.of_mut(stage);
        for (z, value) in entries.slopes.iter().zip(&mut values) {
            slope[place(*z)] = value[lane];
        }
        let hessian = self.qp.hessians.of_mut(stage);
        if self.model.curvatures.is_some() {
            hessian.fill(0.0); // exact ones have other entries
        }
        for ((row, column), value) in entries.hessian.iter().zip(&mut values) {
            let (row, column) = (place(*row), place(*column));
            hessian[column * sizes.all + row] = value[lane];
            hessian[row * sizes.all + column] = value[lane];
        }
        results[0][lane]
    }

    /// Shifts and weights of the conditions of a stage behind `arguments`.
    pub(super) fn extend_conditions(&self, stage: usize, arguments: &mut Vec<f64>) {
        let first = self.conditions_at(stage);
        let n = self.model.lengths.n_condition[usize::from(stage == self.qp.sizes.stages)];
        arguments.extend_from_slice(&self.conditions.shifts[first..first + n]);
        arguments.extend_from_slice(&self.conditions.weights[first..first + n]);
    }

    /// What soft bounds add to the cost of a trajectory.
    pub(super) fn soft_cost(&self, at: &OptimalTrajectory) -> f64 {
        let n = self.model.n_state();
        let of_state = |x: &[f64]| -> f64 {
            self.own_soft.iter().map(|bound| 0.5 * bound.weight * bound.beyond(x[bound.state]).powi(2)).sum()
        };
        if self.own_soft.is_empty() { 0.0 } else { at.states.chunks_exact(n).skip(1).map(of_state).sum() }
    }

    /// x⁺ and ℓ of one stage into `work.single_results`; its conditions into `values`.
    pub(super) fn evaluate(&mut self, problem: &OptimalProblem, stage: usize, state: &[f64], input: &[f64]) -> f64 {
        let is_end = stage == problem.n_stage();
        let Lengths { n_state, n_condition, .. } = self.model.lengths;
        let first = self.conditions_at(stage);
        let own = first..first + n_condition[usize::from(is_end)];
        let all = state
            .iter()
            .chain(input)
            .chain(problem.parameters(stage))
            .chain(&self.conditions.shifts[own.clone()])
            .chain(&self.conditions.weights[own.clone()]);
        for (argument, value) in self.work.single.iter_mut().zip(all) {
            *argument = *value;
        }
        self.model.evaluate(&mut self.work, is_end);
        let at = if is_end { 0 } else { n_state };
        let results = &self.work.single_results[at..];
        self.conditions.values[own.clone()].copy_from_slice(&results[1..1 + own.len()]);
        results[0]
    }
}
