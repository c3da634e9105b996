//! What a careless caller gives: broken bounds, huge numbers, loose bounds, cones with bounds, answers gone stale.

use super::problems::{Kind, gimballed, stream, tilting, trouble, vehicles, wanted};
use nalgebra::DMatrix;
use omnidrones::controllers::allocation::{
    AllocationSensitivity, Allocator, AllocatorSettings, BatchAllocator, HoldReason, PrioritisedAllocator, Problem,
    Solver, Variation, rate_window,
};
use omnidrones::parallel::Threads;

/// Two rotors that push up.
fn lift(upper: [f64; 2]) -> Problem {
    let mut geometry = DMatrix::zeros(6, 2);
    (geometry[(2, 0)], geometry[(2, 1)]) = (1.0, 1.0);
    Problem::boxed(geometry, [1.0; 6], upper.to_vec()).unwrap()
}

fn up(thrust: f64) -> [f64; 6] {
    [0.0, 0.0, thrust, 0.0, 0.0, 0.0]
}

#[test]
fn broken_bounds_with_a_broken_wrench_hold_without_panic() {
    for (lower, upper) in [([0.0; 2], [f64::NAN, 1.0]), ([3.0, 0.0], [1.0, 1.0]), ([f64::INFINITY, 0.0], [9.0, 1.0])] {
        let mut allocator = Allocator::new(lift([3.0, 3.0])).unwrap();
        allocator.solve(&up(4.0));
        allocator.set_bounds(&lower, &upper);
        let held = allocator.solve(&[f64::NAN; 6]);
        assert_eq!(held.reason, Some(HoldReason::Bounds));
        assert!(held.inputs[1] <= 1.0, "what is in order holds: {held:?}");
        let mut stages = PrioritisedAllocator::new(lift([3.0, 3.0]), &[&[2], &[5]]).unwrap();
        stages.set_bounds(&lower, &upper);
        assert_eq!(stages.solve(&up(4.0)).solution.solver, Solver::Held);
    }
    assert_eq!(rate_window(0.0, 2.0, 1.0, 0.5), (0.5, 1.5));
    assert_eq!(rate_window(0.0, 0.0, 3.0, 0.5), (0.0, 0.0));
    assert_eq!(rate_window(2.0, 1.0, f64::NAN, 0.5), (2.0, 1.0));
}

#[test]
fn a_refused_answer_moves_nothing() {
    let (_, problem) = vehicles().into_iter().find(|(name, _)| name == "firefly").unwrap();
    let mut allocator = Allocator::new(problem).unwrap();
    let good = allocator.solve(&up(12.0)).inputs.clone();
    let mut huge = up(0.0);
    huge[2..].fill(f64::MAX);
    let held = allocator.solve(&huge);
    assert_eq!((held.solver, held.reason, &held.inputs), (Solver::Held, Some(HoldReason::Wrench), &good));
    // a tolerance that no answer with rounding meets
    for fast in [true, false] {
        let settings = AllocatorSettings { fast, tolerance: 1e-300, ..AllocatorSettings::default() };
        let mut strict = Allocator::with_settings(lift([3.0, 3.0]), settings).unwrap();
        let mut held = 0;
        for k in 1..=100 {
            let before = strict.solution().inputs.clone();
            let answer = strict.solve(&up(0.0333 * f64::from(k)));
            if answer.solver == Solver::Held {
                assert_eq!((answer.reason, &answer.inputs), (Some(HoldReason::Uncertified), &before));
                held += 1;
            }
        }
        assert_eq!(held, 100, "fast {fast}");
    }
    for tolerance in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
        assert!(
            Allocator::with_settings(lift([3.0; 2]), AllocatorSettings { tolerance, ..AllocatorSettings::default() })
                .is_err()
        );
    }
}

#[test]
fn a_loose_or_missing_bound_does_not_loosen_the_certificate() {
    for loose in [1e13, f64::INFINITY, f64::MAX] {
        let mut allocator = Allocator::new(lift([3.0, loose])).unwrap();
        for (thrust, expected) in [(-5.0, [0.0, 0.0]), (8.0, [3.0, 5.0]), (2.0, [1.0, 1.0]), (0.0, [0.0, 0.0])] {
            let answer = allocator.solve(&up(thrust));
            assert_ne!(answer.solver, Solver::Held, "{loose:e}, {thrust}: {answer:?}");
            for (u, wanted) in answer.inputs.iter().zip(expected) {
                assert!((u - wanted).abs() < 1e-4, "{loose:e}, {thrust}: {answer:?}");
            }
        }
    }
    let mut free = lift([f64::INFINITY; 2]);
    free.lower = vec![f64::NEG_INFINITY; 2];
    let answer = Allocator::new(free).unwrap().solve(&up(8.0)).clone();
    assert!(answer.solver == Solver::ClosedForm && (answer.inputs[0] - 4.0).abs() < 1e-4, "{answer:?}");
}

#[test]
fn cones_with_bounds_and_rates_are_kept_from_tick_to_tick() {
    let (mut held, mut ticks) = (0, 0);
    for case in 0..200 {
        let mut r = stream(60, case);
        let problem = if case % 2 == 0 { tilting(&mut r) } else { gimballed(&mut r) };
        let mut allocator = Allocator::new(problem).unwrap();
        let mut wrench = wanted(allocator.problem(), 0.2, &mut r);
        for _ in 0..10 {
            wrench.iter_mut().for_each(|w| *w += r.uniform(-3.0, 3.0));
            let previous = allocator.solution().inputs.clone();
            allocator.limit_rates(&previous, &[1.5; 12]);
            let answer = allocator.solve(&wrench).clone();
            (ticks, held) = (ticks + 1, held + usize::from(answer.solver == Solver::Held));
            assert_eq!(allocator.problem().violation(&answer.inputs), 0.0, "case {case}: {answer:?}");
            let moved = answer.inputs.iter().zip(&previous).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(moved <= 1.5 + 1e-12, "case {case}: {moved}");
        }
    }
    println!("{held} of {ticks} held"); // measured 0 of 2000
    assert!(held * 200 <= ticks, "{held} of {ticks}");
}

#[test]
fn gradients_of_shut_inputs_are_zero_and_stale_ones_are_refused() {
    let mut geometry = DMatrix::zeros(6, 2);
    (geometry[(2, 0)], geometry[(0, 1)]) = (1.0, 1.0);
    let problem = Problem::boxed(geometry, [1.0; 6], vec![10.0, 0.0]).unwrap();
    let mut allocator = Allocator::new(problem.clone()).unwrap();
    allocator.solve(&up(5.0));
    let mut out = Variation::zero(&problem);
    allocator.reverse(&[1.0, 1.0], &mut out).unwrap();
    assert_eq!(out.wrench[0], 0.0, "a failed input does not answer");
    assert!((out.wrench[2] - 1.0).abs() < 1e-5);
    allocator.set_bounds(&[0.0; 2], &[9.0, 0.0]);
    assert!(allocator.reverse(&[1.0, 1.0], &mut out).is_none() && out.wrench[2].is_nan());
    allocator.solve(&[f64::NAN; 6]);
    assert!(allocator.reverse(&[1.0, 1.0], &mut out).is_none());
    let held = allocator.solution().clone();
    assert!(AllocationSensitivity::new(&problem, &up(5.0), &held).is_none());
}

#[test]
fn twenty_inputs_and_thirty_are_solved_too() {
    for n in [16, 20, 24, 30] {
        let mut r = stream(61, n as u64);
        let geometry = DMatrix::from_fn(6, n, |_, _| r.uniform(-1.0, 1.0));
        let base = Problem::boxed(geometry, [1.0; 6], vec![1.5; n]).unwrap();
        for case in 0..50 {
            let (problem, wrench) = trouble(&base, Kind::ALL[case % 9], &mut r);
            let mut allocator = Allocator::new(problem.clone()).unwrap();
            let mine = allocator.solve(&wrench).clone();
            let settings = AllocatorSettings { fast: false, ..AllocatorSettings::default() };
            let other = Allocator::with_settings(problem.clone(), settings).unwrap().solve(&wrench).inputs.clone();
            assert_ne!(mine.solver, Solver::Held, "{n}, case {case}");
            assert_eq!(mine.solver == Solver::Clarabel, n > 24, "{n}, case {case}: {mine:?}");
            let (a, b) = (problem.objective(&wrench, &mine.inputs), problem.objective(&wrench, &other));
            assert!((a - b).abs() <= 1e-6 * b.max(1.0), "{n}, case {case}: {a} {b}");
        }
        if n == 16 {
            let coarse = Problem { regularisation: 1e3 * base.regularisation, ..base };
            let mut lanes = BatchAllocator::new(&coarse, 70, 64, Threads::default()).unwrap();
            let wrenches: Vec<f32> = (0..70 * 6).map(|_| r.uniform(-6.0, 6.0) as f32).collect();
            let mut inputs = vec![0.0; 70 * n];
            assert_eq!(lanes.solve(&wrenches, &mut inputs).unfinished, 0);
            assert!((0..70).all(|e| lanes.is_finished(e) && !lanes.is_held(e)));
            let error = BatchAllocator::new(&Problem { upper: vec![1e39; n], ..coarse }, 1, 24, Threads::default());
            let mut odd = error.unwrap();
            odd.solve(&[1.0; 6], &mut inputs[..n]);
            assert!(inputs[..n].iter().all(|u| u.is_finite()), "{inputs:?}");
        }
    }
}

#[test]
fn stages_hold_their_last_whole_answer() {
    let (_, problem) = vehicles().into_iter().find(|(name, _)| name == "firefly").unwrap();
    let half: Vec<f64> = problem.upper.iter().map(|hi| 0.5 * hi).collect();
    let mut wrench = problem.delivered(&half);
    wrench[5] = 0.1;
    let mut stages = PrioritisedAllocator::new(problem, &[&[2, 3, 4], &[5]]).unwrap();
    let good = stages.solve(&wrench).solution.inputs;
    let held = stages.solve(&[f64::NAN; 6]).solution;
    assert_eq!((held.solver, held.reason, held.inputs), (Solver::Held, Some(HoldReason::Wrench), good));
    assert_eq!((stages.counts().whole, stages.counts().held), (1, 1));
}
