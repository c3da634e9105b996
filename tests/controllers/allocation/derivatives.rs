//! Derivatives of answers: forward against differences, reverse against forward, both against the closed form.

use super::problems::{Kind, gimballed, stream, tilting, trouble, vehicles, wanted};
use nalgebra::DMatrix;
use omnidrones::controllers::allocation::{
    AllocationSensitivity, Allocator, AllocatorSettings, Problem, Solver, Variation,
};
use omnidrones::rng::Stream;

/// A random direction in all numbers that may move: bounds that are infinite or have no room between them stay.
fn direction(problem: &Problem, wrench: &[f64; 6], r: &mut Stream) -> Variation {
    let mut change = Variation::zero(problem);
    change.numbers_mut().for_each(|x| *x = r.uniform(-1.0, 1.0));
    let size = problem.scales(wrench).input;
    for k in 0..6 {
        change.wrench[k] *= size;
        change.weights[k] *= problem.weights[k];
    }
    change.regularisation *= problem.regularisation;
    for i in 0..problem.n_input() {
        let shut = problem.lower[i] == problem.upper[i];
        change.preference[i] *= size;
        change.lower[i] *= if problem.lower[i].is_finite() && !shut { size } else { 0.0 };
        change.upper[i] *= if problem.upper[i].is_finite() && !shut { size } else { 0.0 };
    }
    // a cone whose apex is the origin keeps it: thrust vectors have no direction there, and no derivative if it moves
    for (cone, rows) in problem.cones.iter().zip(&mut change.cones) {
        if cone.rows().all(|row| row.constant == 0.0) {
            rows.iter_mut().for_each(|row| row.constant = 0.0);
        }
    }
    change
}

fn answer(problem: &Problem, wrench: &[f64; 6]) -> Vec<f64> {
    let mut allocator =
        Allocator::with_settings(problem.clone(), AllocatorSettings { warm: false, ..AllocatorSettings::default() })
            .unwrap();
    let solution = allocator.solve(wrench);
    assert_ne!(solution.solver, Solver::Held);
    solution.inputs.clone()
}

/// Largest relative difference of forward derivative and central difference, and of the two sides of
/// ⟨ū, du⟩ = ⟨θ̄, dθ⟩; `None` near a switch.
fn check(problem: &Problem, wrench: &[f64; 6], r: &mut Stream) -> Option<(f64, f64)> {
    let mut allocator = Allocator::new(problem.clone()).unwrap();
    let solution = allocator.solve(wrench).clone();
    let sensitivity = AllocationSensitivity::new(problem, wrench, &solution)?;
    if sensitivity.margin() < 1e-3 {
        return None;
    }
    let change = direction(problem, wrench, r);
    let du = sensitivity.forward(&change);
    let size = du.iter().fold(1e-12, |m: f64, x| m.max(x.abs()));
    // the step that suits: large ones bend, small ones drown in rounding
    let miss = [1e-4, 1e-5, 1e-6, 1e-7].map(|step| {
        let [more, less] = [step, -step].map(|h| {
            let (moved, w) = change.applied(problem, wrench, h);
            answer(&moved, &w)
        });
        let each = (0..du.len()).map(|i| ((more[i] - less[i]) / (2.0 * step) - du[i]).abs());
        each.fold(0.0, f64::max)
    });
    let cotangent: Vec<f64> = du.iter().map(|_| r.uniform(-1.0, 1.0)).collect();
    let gradient = sensitivity.reverse(&cotangent);
    let (left, right) = (cotangent.iter().zip(&du).map(|(a, b)| a * b).sum::<f64>(), gradient.dot(&change));
    Some((miss.into_iter().fold(f64::INFINITY, f64::min) / size, (left - right).abs() / left.abs().max(size)))
}

#[test]
fn derivatives_within_bounds_are_those_of_central_differences_away_from_switching() {
    let (mut difference, mut transpose, mut n) = (0.0_f64, 0.0_f64, 0);
    for (number, (name, base)) in vehicles().iter().enumerate() {
        for (k, kind) in Kind::ALL.into_iter().enumerate().filter(|(_, k)| *k != Kind::NotFinite && *k != Kind::FarOut)
        {
            for case in 0..20 {
                let mut r = stream(10, (1000 * number + 20 * k + case) as u64);
                let (mut problem, wrench) = trouble(base, kind, &mut r);
                // a weak ρ makes u* steep: differences then need steps below their own rounding
                problem.regularisation *= 1e3;
                if let Some((d, t)) = check(&problem, &wrench, &mut r) {
                    assert!(d < 1e-6, "{name}, {kind:?}, case {case}: {d:e}");
                    (difference, transpose, n) = (difference.max(d), transpose.max(t), n + 1);
                }
            }
        }
    }
    // measured: 799 cases, 4.7e-7, 1.1e-11
    println!("{n} cases: differences {difference:.1e}, transpose {transpose:.1e}");
    assert!(n > 500 && transpose < 1e-10, "{n} {transpose:e}");
}

#[test]
fn the_fast_derivatives_are_the_general_ones() {
    let (mut worst, mut worst_forward, mut cases) = (0.0_f64, 0.0_f64, 0);
    for (number, (name, base)) in vehicles().iter().enumerate() {
        for (k, kind) in Kind::ALL.into_iter().enumerate().filter(|(_, k)| *k != Kind::NotFinite) {
            let mut r = stream(13, (20 * number + k) as u64);
            let (problem, wrench) = trouble(base, kind, &mut r);
            let problem = Problem { regularisation: 1e3 * problem.regularisation, ..problem };
            let mut allocator = Allocator::new(problem.clone()).unwrap();
            let solution = allocator.solve(&wrench).clone();
            let cotangent: Vec<f64> = solution.inputs.iter().map(|_| r.uniform(-1.0, 1.0)).collect();
            let mut fast = Variation::zero(&problem);
            let margin = allocator.reverse(&cotangent, &mut fast).unwrap();
            let general = AllocationSensitivity::new(&problem, &wrench, &solution).unwrap();
            if general.margin() < 1e-9 {
                continue;
            }
            assert!(
                (margin - general.margin()).abs() <= 0.5 * margin,
                "{name}, {kind:?}: {margin:e}, {:e}",
                general.margin()
            );
            cases += 1;
            let change = direction(&problem, &wrench, &mut r);
            let (mut du, wanted) = (vec![f64::NAN; cotangent.len()], general.forward(&change));
            assert_eq!(allocator.forward(&change, &mut du), Some(margin));
            let size = wanted.iter().fold(1e-12, |m: f64, x| m.max(x.abs()));
            worst_forward = du.iter().zip(&wanted).fold(worst_forward, |m, (a, b)| m.max((a - b).abs() / size));
            let general = general.reverse(&cotangent);
            let size = general.numbers().fold(0.0, |m: f64, x| m.max(x.abs()));
            let miss = fast.numbers().zip(general.numbers()).map(|(a, b)| (a - b).abs() / size);
            worst = worst.max(miss.fold(0.0, f64::max));
        }
    }
    println!("{cases} cases, worst {worst:.1e} in reverse, {worst_forward:.1e} forward"); // measured 54, 1.4e-11, 7.5e-12
    assert!(cases > 40 && worst < 1e-10 && worst_forward < 6e-10, "{cases} {worst:e} {worst_forward:e}");
}

#[test]
fn derivatives_through_cones_are_those_of_central_differences_away_from_switching() {
    let (mut difference, mut transpose, mut n) = (0.0_f64, 0.0_f64, 0);
    for case in 0..400 {
        let mut r = stream(11, case);
        let mut problem = if case % 2 == 0 { tilting(&mut r) } else { gimballed(&mut r) };
        problem.regularisation = 1e-2;
        let wrench = wanted(&problem, [0.2, 1.0, 3.0][r.below(3) as usize], &mut r);
        if let Some((d, t)) = check(&problem, &wrench, &mut r) {
            (difference, transpose, n) = (difference.max(d), transpose.max(t), n + 1);
            if d > 1e-7 {
                let solution = Allocator::new(problem.clone()).unwrap().solve(&wrench).clone();
                let at = AllocationSensitivity::new(&problem, &wrench, &solution).unwrap();
                println!("case {case}: {d:.1e}, residual {:.1e}, margin {:.1e}", solution.residual, at.margin());
            }
        }
    }
    // measured: 252 cases, 1.5e-9, 2.1e-13
    println!("{n} cases: differences {difference:.1e}, transpose {transpose:.1e}");
    assert!(n > 100 && transpose < 2e-11 && difference < 1e-7, "{n} {difference:e} {transpose:e}");
}

#[test]
fn without_active_bounds_the_derivative_is_the_closed_form() {
    let mut worst = 0.0_f64;
    for (number, (name, base)) in vehicles().iter().enumerate() {
        let half: Vec<f64> = base.upper.iter().map(|hi| 0.5 * hi).collect();
        // κ(H) 1e4 instead of 1e6 and more, so that the witness below has eleven digits itself
        let regularisation = 100.0 * base.regularisation;
        let problem = Problem { preference: half.clone(), regularisation, ..base.clone() };
        let wrench = problem.delivered(&half);
        let mut allocator = Allocator::new(problem.clone()).unwrap();
        let solution = allocator.solve(&wrench).clone();
        assert_eq!(solution.solver, Solver::ClosedForm, "{name}");
        let sensitivity = AllocationSensitivity::new(&problem, &wrench, &solution).unwrap();
        // du/dw = H⁻¹ BᵀW, du/du_pref = ρ H⁻¹
        let inverse = problem.hessian().try_inverse().unwrap();
        let weights = DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&problem.weights));
        let gain = &inverse * problem.geometry.transpose() * weights;
        let mut r = stream(12, number as u64);
        let cotangent: Vec<f64> = (0..problem.n_input()).map(|_| r.uniform(-1.0, 1.0)).collect();
        let gradient = sensitivity.reverse(&cotangent);
        let v = nalgebra::DVector::from_column_slice(&cotangent);
        let expected = gain.transpose() * &v;
        let size = expected.amax();
        for k in 0..6 {
            worst = worst.max((gradient.wrench[k] - expected[k]).abs() / size);
        }
        let expected = inverse * v * problem.regularisation;
        for i in 0..problem.n_input() {
            worst = worst.max((gradient.preference[i] - expected[i]).abs() / expected.amax());
        }
        assert!(gradient.lower.iter().chain(&gradient.upper).all(|x| *x == 0.0));
    }
    println!("worst {worst:.1e}"); // measured 1.8e-12
    assert!(worst <= 1e-10, "{worst:e}");
}

#[test]
fn a_bound_that_touches_without_force_is_flagged_and_its_derivative_is_one_sided() {
    // two equal rotors: thrust 2 wanted, the first may push exactly its share
    let mut geometry = DMatrix::zeros(6, 2);
    geometry[(2, 0)] = 1.0;
    geometry[(2, 1)] = 1.0;
    let mut problem = Problem::boxed(geometry, [1.0; 6], vec![1.0, 5.0]).unwrap();
    problem.preference = vec![1.0, 1.0];
    let wrench = [0.0, 0.0, 2.0, 0.0, 0.0, 0.0];
    let mut allocator = Allocator::new(problem.clone()).unwrap();
    let solution = allocator.solve(&wrench).clone();
    let sensitivity = AllocationSensitivity::new(&problem, &wrench, &solution).unwrap();
    assert!(sensitivity.is_one_sided(), "margin {:e}", sensitivity.margin());
    let mut change = Variation::zero(&problem);
    change.wrench[2] = 1.0;
    let du = sensitivity.forward(&change);
    // more: the second alone, 1; less: both, a half each
    let right = (du[0].abs() < 1e-9 && (du[1] - 1.0).abs() < 1e-5) || du.iter().all(|x| (x - 0.5).abs() < 1e-5);
    assert!(right, "{du:?}");
}
