//! Lanes: bounds to the bit, optimal to the precision of `f32`.

use super::problems::{Kind, stream, trouble, vehicles};
use omnidrones::controllers::allocation::residual::residual;
use omnidrones::controllers::allocation::{Allocator, BatchAllocator, Problem};
use omnidrones::parallel::Threads;
use omnidrones::rng::Stream;

/// ρ at which rounding to `f32` does not decide: 1e-3 of the largest entry of BᵀWB.
fn coarse(base: &Problem) -> Problem {
    Problem { regularisation: 1e3 * base.regularisation, ..base.clone() }
}

/// A batch of troubles that share geometry and weights: what lanes take.
fn batch(base: &Problem, n_env: usize, r: &mut Stream) -> Vec<(Kind, Problem, [f64; 6])> {
    let shared = [
        Kind::Reachable,
        Kind::Unreachable,
        Kind::FarOut,
        Kind::Vertex,
        Kind::Failed,
        Kind::Weakened,
        Kind::RateLimited,
        Kind::NotFinite,
    ];
    (0..n_env)
        .map(|e| {
            let kind = shared[e % shared.len()];
            let (problem, wrench) = trouble(base, kind, r);
            (kind, problem, wrench)
        })
        .collect()
}

fn rows(v: impl Iterator<Item = f64>) -> Vec<f32> {
    v.map(|x| x as f32).collect()
}

#[test]
fn a_hundred_thousand_problems_in_lanes_stay_in_bounds_and_reach_the_optimum() {
    let (mut worst, mut gap, mut unfinished, mut total) = (0.0_f64, 0.0_f64, 0, 0);
    for (number, (name, base)) in vehicles().iter().enumerate() {
        let base = coarse(base);
        let (n, n_env) = (base.n_input(), 17_000);
        let cases = batch(&base, n_env, &mut stream(30, number as u64));
        let lower = rows(cases.iter().flat_map(|(_, p, _)| p.lower.clone()));
        let upper = rows(cases.iter().flat_map(|(_, p, _)| p.upper.clone()));
        let wrenches = rows(cases.iter().flat_map(|(_, _, w)| *w));
        let mut allocator = BatchAllocator::new(&base, n_env, 48, Threads::default()).unwrap();
        allocator.set_bounds(&lower, &upper);
        let mut inputs = vec![0.0; n_env * n];
        let report = allocator.solve(&wrenches, &mut inputs);
        assert_eq!(report.held, cases.iter().filter(|(k, _, _)| *k == Kind::NotFinite).count(), "{name}");
        (unfinished, total) = (unfinished + report.unfinished, total + n_env);
        for (e, (kind, problem, wrench)) in cases.iter().enumerate() {
            let at = e * n..(e + 1) * n;
            let inside = inputs[at.clone()].iter().zip(&lower[at.clone()]).zip(&upper[at.clone()]);
            assert!(inside.clone().all(|((u, lo), hi)| lo <= u && u <= hi), "{name}, {kind:?}, case {e}");
            if *kind == Kind::NotFinite {
                continue;
            }
            // the program that the lanes were given: numbers rounded to f32
            let wide = |v: &[f32]| v.iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
            let given = Problem { lower: wide(&lower[at.clone()]), upper: wide(&upper[at.clone()]), ..problem.clone() };
            let w = wrench.map(|w| f64::from(w as f32));
            let u = wide(&inputs[at]);
            let kkt = residual(&given, &w, &u, &[], given.scales(&w), &mut vec![0.0; n]);
            let mut exact = Allocator::new(given.clone()).unwrap();
            let best = exact.solve(&w).inputs.clone();
            let (a, b) = (given.objective(&w, &u), given.objective(&w, &best));
            let size = (b - given.objective(&w, &vec![0.0; n])).abs().max(b.abs());
            (worst, gap) = (worst.max(kkt), gap.max((a - b).abs() / size));
            assert!(kkt <= 2e-5, "{name}, {kind:?}, case {e}: {kkt:e}");
        }
    }
    // measured: residual 1.2e-6, gap 4.4e-10
    println!("{total} cases: residual {worst:.1e}, gap {gap:.1e}, unfinished {unfinished}");
    assert!(gap <= 3e-8 && unfinished == 0, "{gap:e}, {unfinished}");
}

#[test]
fn an_environment_does_not_depend_on_its_place_or_its_neighbours() {
    let (_, base) = vehicles().into_iter().max_by_key(|(_, p)| p.n_input()).unwrap();
    let base = coarse(&base);
    let (n, n_env) = (base.n_input(), 200);
    let cases = batch(&base, n_env, &mut stream(31, 0));
    let wrenches = rows(cases.iter().flat_map(|(_, _, w)| *w));
    let mut together = BatchAllocator::new(&base, n_env, 48, Threads::default()).unwrap();
    let mut inputs = vec![0.0; n_env * n];
    for _ in 0..2 {
        together.solve(&wrenches, &mut inputs);
    }
    for e in [0, 7, 63, 64, 199] {
        let mut alone = BatchAllocator::new(&base, 1, 48, Threads::default()).unwrap();
        let mut own = vec![0.0; n];
        for _ in 0..2 {
            alone.solve(&wrenches[6 * e..6 * e + 6], &mut own);
        }
        assert_eq!(own, inputs[e * n..(e + 1) * n], "environment {e}");
    }
}

#[test]
fn a_batch_that_does_not_fit_into_memory_is_refused_with_what_would() {
    let (_, base) = vehicles().swap_remove(0);
    let base = coarse(&base);
    for n_env in [1_000_000_000_000, usize::MAX] {
        let text = BatchAllocator::new(&base, n_env, 48, Threads::default()).unwrap_err().to_string();
        let says = [format!("allocation: n_env is {n_env} ("), "GiB left".into(), "fewer environments at once".into()];
        assert!(says.iter().all(|part| text.contains(part.as_str())), "{text}");
    }
}

#[test]
fn a_held_environment_comes_back_to_bounds_that_moved() {
    let (_, base) = vehicles().swap_remove(0);
    let error = BatchAllocator::new(&base, 1, 48, Threads::default()).unwrap_err().to_string();
    assert!(error.contains("regularisation in lanes"), "{error}");
    let base = coarse(&base);
    let n = base.n_input();
    let mut allocator = BatchAllocator::new(&base, 1, 48, Threads::default()).unwrap();
    let wrench = rows(base.delivered(&base.upper.iter().map(|hi| 0.9 * hi).collect::<Vec<_>>()).into_iter());
    let mut inputs = vec![0.0; n];
    allocator.solve(&wrench, &mut inputs);
    let upper: Vec<f32> = inputs.iter().map(|u| 0.5 * u).collect();
    allocator.set_bounds(&vec![0.0; n], &upper);
    let report = allocator.solve(&[f32::NAN; 6], &mut inputs);
    assert_eq!((report.held, report.unfinished), (1, 0));
    assert_eq!(inputs, upper);
}
