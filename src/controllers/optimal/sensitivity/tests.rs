use super::super::{
    OptimalProblem, PlannedInput, PlannedPlant, RealTimeIteration, SoftBound, StageModel, TrackingCost, TrackingWeights,
};
use super::*;
use crate::kinematics::Kinematics;
use autodiff::System;
use dynamics::{Effects, Physics, Plant, vehicles};
use std::sync::Arc;

/// Back to a point from where it moves and leans; inputs reach their bounds.
fn problem() -> (OptimalProblem, Vec<f64>) {
    let effects = Effects { disturbance: true, ..Effects::default() };
    let physics = Physics { dt: 0.05, effects, ..Physics::default() };
    let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), physics).unwrap();
    let planned = PlannedPlant::new(plant.with_longer_lags().unwrap(), PlannedInput::Speed).unwrap();
    let cost = TrackingCost::new(&planned, 0).unwrap();
    let model = StageModel::new(&planned, &cost, planned.errors().unwrap()).unwrap();
    let model = model.with_curvature(&planned, &cost).unwrap();
    let (mut start, inputs) = planned.hover().unwrap();
    start[..13].copy_from_slice(&[0.6, -0.4, 0.3, 0.8, 0.1, -0.2, 0.98, 0.1, 0.15, 0.05, 0.4, -0.3, 0.2]);
    let norm = start[6..10].iter().map(|x| x * x).sum::<f64>().sqrt();
    start[6..10].iter_mut().for_each(|x| *x /= norm);
    let mut problem = OptimalProblem::new(Arc::new(model), 12, &start).unwrap();
    let (lower, upper) = planned.bounds();
    problem.set_bounds(&lower, &upper).unwrap();
    problem.set_soft_bounds(&[SoftBound { state: 3, lower: -0.7, upper: 0.7, weight: 30.0 }]).unwrap();
    let mut row = vec![0.0; problem.model().n_parameter()];
    let first = planned.n_parameter();
    for k in 0..=12 {
        let own =
            Kinematics { velocity: [0.1 * k as f64, 0.0, 0.0], ..Kinematics::at_rest([0.05 * k as f64, 0.0, 0.0]) };
        row[3..6].copy_from_slice(&[0.3, -0.2, 0.1]);
        cost.write_parameters(&own, &inputs, &TrackingWeights::default(), &mut row[first..]);
        problem.set_parameters(k, &row).unwrap();
    }
    (problem, inputs)
}

fn solved(problem: &OptimalProblem, inputs: &[f64]) -> RealTimeIteration {
    let mut iteration = RealTimeIteration::new(problem.clone(), inputs).unwrap();
    let report = iteration.tick(problem.start(), 200, 1e-13);
    assert!(report.is_planned && report.step < 1e-9, "{report:?}");
    iteration
}

#[test]
fn derivatives_of_a_solution_are_those_of_differences() {
    let (problem, inputs) = problem();
    let solution = solved(&problem, &inputs);
    let mut own = SolutionSensitivity::new(&problem, solution.plan()).unwrap();
    let (m, np) = (inputs.len(), problem.model().n_parameter());
    let at_bounds = (0..12 * m).filter(|i| !own.solver.is_free(i / m, i % m)).count();
    let (by_start, by_parameters) = own.first_input(&problem);
    println!("{at_bounds} inputs at bounds, least distance {:.1e}", own.least_distance());
    assert!(at_bounds > 0);
    let first = |problem: &OptimalProblem| {
        let mut iteration = solution.clone();
        *iteration.problem_mut() = problem.clone();
        let report = iteration.tick(problem.start(), 200, 1e-13);
        assert!(report.step < 1e-9, "{report:?}");
        iteration.input(0).to_vec()
    };
    let (h, mut worst) = (1e-5, 0.0_f64);
    let mut compare = |difference: &dyn Fn(f64) -> Vec<f64>, column: &dyn Fn(usize) -> f64, what: String| {
        let (more, less) = (difference(h), difference(-h));
        for i in 0..m {
            let (found, wanted) = ((more[i] - less[i]) / (2.0 * h), column(i));
            let error = (found - wanted).abs() / (1.0 + wanted.abs());
            worst = worst.max(error);
            assert!(error < 1e-6, "{what}, input {i}: {found} by differences, {wanted}");
        }
    };
    for j in (0..problem.start().len()).filter(|j| !(6..10).contains(j)) {
        let moved = |by: f64| {
            let (mut other, mut start) = (problem.clone(), problem.start().to_vec());
            start[j] += by;
            other.set_start(&start).unwrap();
            first(&other)
        };
        compare(&moved, &|i| by_start[(i, j)], format!("state {j}"));
    }
    for (stage, j) in [0, 1, 5, 12].into_iter().flat_map(|stage| (0..np).map(move |j| (stage, j))) {
        // the attitude of the reference stays a unit quaternion, and nobody reads inputs of the end
        let number = j.wrapping_sub(9);
        if (6..10).contains(&number) {
            continue;
        }
        let moved = |by: f64| {
            let (mut other, mut row) = (problem.clone(), problem.parameters(stage).to_vec());
            row[j] += by;
            other.set_parameters(stage, &row).unwrap();
            first(&other)
        };
        compare(&moved, &|i| by_parameters[(i, stage * np + j)], format!("parameter {j} of stage {stage}"));
    }
    println!("worst {worst:.1e}");
}

#[test]
fn what_is_no_solution_is_not_differentiated() {
    let (problem, inputs) = problem();
    let iteration = RealTimeIteration::new(problem.clone(), &inputs).unwrap();
    let refused = SolutionSensitivity::new(&problem, iteration.plan()).unwrap_err().to_string();
    assert!(refused.contains("Solve it to convergence first"), "{refused}");
}
