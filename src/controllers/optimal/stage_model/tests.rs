use super::super::stage_expansion::StageExpansion;
use super::super::{OptimalProblem, OptimalTrajectory, PlannedInput, PlannedPlant, TrackingCost, TrackingWeights};
use crate::kinematics::Kinematics;
use autodiff::{System, linearise};
use dynamics::{Physics, Plant, configurations, vehicles};
use nalgebra::DVector;
use rng::{Purpose, Stream};
use std::sync::Arc;

use super::StageModel;

/// Expansions of a stage about random states against derivatives by duals and by differences.
fn compare(plant: Plant, seed: u64) {
    let planned = PlannedPlant::new(plant, PlannedInput::Speed).unwrap();
    let cost = TrackingCost::new(&planned, 0).unwrap();
    let errors = planned.errors().unwrap();
    let model = StageModel::new(&planned, &cost, errors.clone()).unwrap();
    let model = Arc::new(model.with_curvature(&planned, &cost).unwrap());
    let (hover, inputs) = planned.hover().unwrap();
    let (n, m, n_error) = (hover.len(), inputs.len(), errors.n_error());
    let mut draw = Stream::new(seed, 0, 0, Purpose::TASK);
    let moved: Vec<f64> = (0..n_error).map(|_| 0.1 * draw.normal()).collect();
    let state = errors.moved(&hover, &moved);
    let mut problem = OptimalProblem::new(model, 1, &state).unwrap();
    let mut row = vec![0.0; problem.model().n_parameter()];
    let weights = TrackingWeights { joint: 2.0, joint_rate: 0.5, ..TrackingWeights::default() };
    let first = planned.n_parameter();
    cost.write_parameters(&Kinematics::at_rest([0.3, 0.2, 0.1]), &inputs, &weights, &mut row[first..]);
    problem.set_parameters(0, &row).unwrap();
    let input: Vec<f64> = inputs.iter().map(|u| u + 0.05 * draw.normal()).collect();
    let step = linearise(&planned, &state, &input, &row[..first]);
    let at = |state: &[f64], input: &[f64]| {
        let mut next = vec![0.0; n];
        planned.step(state, input, &row[..first], &mut next);
        OptimalTrajectory { states: [state, &next].concat(), inputs: input.to_vec() }
    };
    let mut expansion = StageExpansion::new(&problem).unwrap();
    expansion.expand(&problem, &at(&state, &input));
    let (a, b) = errors.reduce(&state, &step);
    let sizes = expansion.qp.sizes;
    let columns = |expansion: &StageExpansion| -> Vec<Vec<f64>> {
        let own = |z: usize| expansion.qp.columns.of(0)[z * sizes.rows..z * sizes.rows + n_error].to_vec();
        (0..n_error).map(|j| own(sizes.first + j)).chain((0..m).map(own)).collect()
    };
    let slopes = |expansion: &StageExpansion| -> Vec<f64> {
        let own = expansion.qp.slopes.of(0);
        own[sizes.first..sizes.first + n_error].iter().chain(&own[..m]).copied().collect()
    };
    let size = 1.0 + a.amax().max(b.amax());
    let mut worst: f64 = 0.0;
    for (j, column) in columns(&expansion).into_iter().enumerate() {
        let wanted = if j < n_error { a.column(j).into_owned() } else { b.column(j - n_error).into_owned() };
        worst = worst.max((DVector::from(column) - wanted).amax() / size);
    }
    // slopes and curvatures by differences, with costates that weigh the step
    let costates: Vec<f64> = (0..n_error).map(|_| 10.0 * draw.normal()).collect();
    let (own_slopes, h) = (slopes(&expansion), 1e-5);
    expansion.curve(&problem, &at(&state, &input), &costates);
    let curvature = expansion.qp.hessians.of(0).to_vec();
    let place = |z: usize| if z < n_error { sizes.first + z } else { z - n_error };
    let mut shifted = |z: usize, by: f64| {
        let (mut error, mut input) = (vec![0.0; n_error], input.clone());
        if z < n_error {
            error[z] = by
        } else {
            input[z - n_error] += by
        }
        let cost = expansion.evaluate(&problem, 0, &errors.moved(&state, &error), &input);
        let next = expansion.work.single_results[..n].to_vec();
        let weighed = errors.difference(&next, step.next.as_slice());
        (cost, weighed.iter().zip(&costates).map(|(e, l)| e * l).sum::<f64>())
    };
    let (mut worst_slope, mut worst_curvature) = (0.0_f64, 0.0_f64);
    let largest = own_slopes.iter().fold(1.0, |most: f64, s| most.max(s.abs()));
    for z in 0..n_error + m {
        let (more, less) = (shifted(z, h), shifted(z, -h));
        worst_slope = worst_slope.max(((more.0 - less.0) / (2.0 * h) - own_slopes[z]).abs() / largest);
        let h = 1e-3;
        let (more, middle, less) = (shifted(z, h), shifted(z, 0.0), shifted(z, -h));
        let second = (more.0 + more.1 - 2.0 * (middle.0 + middle.1) + less.0 + less.1) / (h * h);
        let own = curvature[place(z) * sizes.all + place(z)];
        worst_curvature = worst_curvature.max((second - own).abs() / (1.0 + own.abs()));
    }
    println!(
        "{}: A, B {worst:.1e}, slopes {worst_slope:.1e}, curvatures {worst_curvature:.1e}",
        planned.plant().name()
    );
    // measured: 2e-15, 1e-9, 3e-4 (by second differences)
    assert!(worst < 1e-12 && worst_slope < 1e-6 && worst_curvature < 1e-2);
}

#[test]
fn expansions_are_those_of_duals_and_differences() {
    let physics = Physics { dt: 0.05, ..Physics::default() };
    for (name, seed) in [("hummingbird", 1), ("crazyflie", 2)] {
        compare(Plant::of_vehicle(&vehicles::by_name(name).unwrap(), physics).unwrap(), seed);
    }
    let payload = configurations::by_name("payload").unwrap();
    compare(Plant::of_model(&payload, Physics { dt: 0.02, ..physics }).unwrap(), 3);
}
