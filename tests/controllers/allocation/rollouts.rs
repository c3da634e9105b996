//! Allocation inside rollouts: exact gradients of a closed loop through bounds and cones.

use super::problems::{Kind, gimballed, stream, trouble};
use omnidrones::autodiff::program::BLOCK;
use omnidrones::autodiff::{CertificateBounds, Objective, Program, Recording, Rollout, Scalar, System, Trace, certify};
use omnidrones::controllers::allocation::active_set::{BoxQp, Factor, Tolerances};
use omnidrones::controllers::allocation::{AllocationFunction, Problem};
use omnidrones::dynamics::vehicles;

/// A unit mass pushed by allocated thrusts towards a target: state position and velocity (3 + 3), parameters two gains
/// and the target.
struct Pushed {
    problem: Problem,
    function: AllocationFunction,
}

impl System for Pushed {
    fn n_state(&self) -> usize {
        6
    }
    fn n_input(&self) -> usize {
        3
    }
    fn n_parameter(&self) -> usize {
        2
    }
    fn step<S: Scalar>(&self, x: &[S], input: &[S], gains: &[S], next: &mut [S]) {
        let mut wrench = [S::zero(); 6];
        for k in 0..3 {
            wrench[k] = gains[0] * (input[k] - x[k]) - gains[1] * x[3 + k];
        }
        wrench[2] += S::constant(9.81 * 2.0);
        let mut u = vec![S::zero(); self.problem.n_input()];
        self.function.call(&self.problem, &wrench, &mut u);
        for k in 0..3 {
            let mut force = S::zero();
            for j in 0..u.len() {
                force += S::constant(self.problem.geometry[(k, j)]) * u[j];
            }
            let gravity = if k == 2 { 9.81 } else { 0.0 };
            let v = x[3 + k] + S::constant(0.05) * (force * S::constant(0.5) - S::constant(gravity));
            next[3 + k] = v;
            next[k] = x[k] + S::constant(0.05) * v;
        }
    }
}

struct Far;
impl Objective for Far {
    fn stage<S: Scalar>(&self, x: &[S], input: &[S], _: &[S]) -> S {
        let mut cost = S::zero();
        for k in 0..3 {
            cost += (x[k] - input[k]).square() + S::constant(0.1) * x[3 + k].square();
        }
        cost
    }
}

fn system(case: u64) -> Pushed {
    let mut problem = gimballed(&mut stream(50, case));
    problem.regularisation = 1e-2;
    Pushed { function: AllocationFunction::new(problem.clone()).unwrap(), problem }
}

#[test]
fn the_certificate_holds_for_a_system_that_allocates_through_cones() {
    let mut at_limit = 0;
    for case in 0..6 {
        let system = system(case);
        let target = [6.0 * case as f64, -1.0, 1.0];
        let x = [0.1, 0.2, 0.3, -0.1, 0.05, 0.2];
        let c = certify(&system, &x, &target, &[3.0, 2.5]).unwrap();
        println!("case {case}: {c}"); // measured: adjoint 1.9e-16, differences 2.6e-8
        assert!(c.holds(CertificateBounds::default()), "case {case}: {c}");
        let wrench: [f64; 6] = std::array::from_fn(|k| match k {
            0..3 => 3.0 * (target[k] - x[k]) - 2.5 * x[3 + k] + if k == 2 { 9.81 * 2.0 } else { 0.0 },
            _ => 0.0,
        });
        let mut u = [0.0; 12];
        system.function.call(&system.problem, &wrench, &mut u);
        at_limit += usize::from(system.problem.cones.iter().any(|c| c.slack(&u) < 1e-9));
    }
    println!("{at_limit} of 6 at a cone");
    assert!((1..6).contains(&at_limit), "{at_limit}");
}

#[test]
fn the_gradient_of_a_rollout_through_cones_is_its_dual_gradient() {
    let rollout = Rollout::new(system(3), Far).unwrap();
    let inputs: Vec<f64> = (0..20).flat_map(|k| [4.0, if k < 10 { 2.0 } else { -2.0 }, 1.0]).collect();
    let (x, gains) = ([0.0; 6], [3.0, 2.5]);
    let (cost, reverse) = rollout.gradient(&x, &inputs, &gains);
    let (same, forward) = rollout.gradient_forward(&x, &inputs, &gains);
    assert_eq!(cost, same);
    let worst = reverse.parameters.iter().zip(&forward.parameters).map(|(a, b)| (a - b).abs() / b.abs().max(1.0));
    let worst = worst.fold(0.0, f64::max);
    println!("cost {cost:.3}, gradient {:?}, reverse against forward {worst:.1e}", reverse.parameters);
    // measured 4.4e-16
    assert!(worst < 4e-14, "{worst:e}");
    // twin: gains do matter
    assert!(reverse.parameters.iter().all(|g| g.abs() > 1e-3));
}

/// The active set as straight-line code: 12 steps without derivative, then one that lives.
fn straight<S: Scalar>(problem: &Problem, wrench: &[S; 6]) -> [S; 4] {
    const N: usize = 4;
    let (h, unit) = (problem.hessian(), problem.upper[0]);
    let cost = h.diagonal().max();
    let mut program = BoxQp::<S, N>::empty();
    for i in 0..N {
        for j in 0..N {
            program.hessian[i][j] = S::constant(h[(i, j)] / cost);
        }
        for k in 0..6 {
            let pull = problem.geometry[(k, i)] * problem.weights[k] / (cost * unit);
            program.linear[i] -= S::constant(pull) * wrench[k];
        }
        program.lower[i] = S::constant(problem.lower[i] / unit);
        program.upper[i] = S::constant(problem.upper[i] / unit);
    }
    let mut x = program.start(N, &[S::constant(0.5); N]);
    let mut factor = Factor::new();
    for _ in 0..12 {
        program.step(N, &mut x, &mut factor, true, Tolerances::DOUBLE);
    }
    let mut u = program.live(N, &x, &mut factor, Tolerances::DOUBLE);
    for i in 0..N {
        x.inputs[i] = x.inputs[i].detach();
        u[i] *= S::constant(unit);
    }
    u
}

#[test]
fn straight_line_and_called_allocations_have_the_same_values_and_derivatives() {
    use num_dual::Dual64;
    let problem = Problem::of_vehicle(&vehicles::by_name("hummingbird").unwrap()).unwrap();
    let problem = Problem { regularisation: 1e-3, ..problem };
    let function = AllocationFunction::new(problem.clone()).unwrap();
    let (mut value, mut slope) = (0.0_f64, 0.0_f64);
    for case in 0..500 {
        let mut r = stream(51, case);
        let wrench = [0.0, 0.0, r.uniform(0.0, 30.0), r.uniform(-2.0, 2.0), r.uniform(-2.0, 2.0), r.uniform(-0.3, 0.3)];
        let seeds: [f64; 6] = std::array::from_fn(|_| r.uniform(-1.0, 1.0));
        let live: [Dual64; 6] = std::array::from_fn(|k| Dual64::new(wrench[k], seeds[k]));
        let (a, mut b) = (straight(&problem, &live), [Dual64::from(0.0); 4]);
        function.call(&problem, &live, &mut b);
        for (a, b) in a.iter().zip(&b) {
            value = value.max((a.re - b.re).abs());
            slope = slope.max((a.eps - b.eps).abs());
        }
    }
    println!("value {value:.1e}, slope {slope:.1e}"); // measured 4.5e-14, 1.2e-14
    assert!(value < 4e-12 && slope < 2e-12, "{value:e} {slope:e}");
}

/// Results of a program over a block beside those of each environment alone, as `f32`: equal bits, any NaN equals any NaN.
fn assert_block_is_its_points(program: &Program, points: &[Vec<f64>]) {
    let rounded = |x: f64| f64::from(x as f32);
    let (mut block, mut single) = (program.block_workspace(), program.workspace());
    let (mut rows, mut alone) = (vec![[0.0; BLOCK]; program.n_output()], vec![0.0; program.n_output()]);
    for (number, points) in points.chunks(BLOCK).enumerate() {
        let inputs: Vec<[f32; BLOCK]> = (0..program.n_input())
            .map(|k| std::array::from_fn(|lane| points[lane.min(points.len() - 1)][k] as f32))
            .collect();
        program.evaluate_block(&mut block, &inputs, &mut rows);
        for (lane, point) in points.iter().enumerate() {
            let point: Vec<f64> = point.iter().map(|x| rounded(*x)).collect();
            program.evaluate(&mut single, &point, &mut alone);
            for (k, (row, alone)) in rows.iter().zip(&alone).enumerate() {
                let (got, want) = (row[lane], *alone as f32);
                let is_equal = got.to_bits() == want.to_bits() || (got.is_nan() && want.is_nan());
                assert!(is_equal, "block {number}, environment {lane}, result {k}: {got}, not {want}");
            }
        }
    }
}

/// With numbers that `f32` has.
fn rounded(base: &Problem) -> Problem {
    let all = |numbers: &[f64]| numbers.iter().map(|x| f64::from(*x as f32)).collect();
    Problem {
        weights: base.weights.map(|x| f64::from(x as f32)),
        regularisation: f64::from(base.regularisation as f32),
        geometry: base.geometry.map(|x| f64::from(x as f32)),
        preference: all(&base.preference),
        lower: all(&base.lower),
        upper: all(&base.upper),
        ..base.clone()
    }
}

#[test]
fn allocations_over_a_block_are_those_of_its_points_to_the_bit_also_backwards() {
    for (number, (name, base)) in super::problems::vehicles().into_iter().enumerate() {
        let base = rounded(&base);
        let function = AllocationFunction::new(base.clone()).unwrap();
        let n = base.n_input();
        let recording = Recording::of(6, |wrench| {
            let wrench = std::array::from_fn(|k| wrench[k]);
            let mut inputs = vec![Trace::zero(); n];
            function.call(&base, &wrench, &mut inputs);
            inputs
        });
        let kinds = [Kind::Reachable, Kind::Unreachable, Kind::FarOut, Kind::Vertex, Kind::NotFinite];
        let mut r = stream(60, number as u64);
        // 10⁵ wrenches over six vehicles
        let points: Vec<Vec<f64>> =
            (0..17_000).map(|k| trouble(&base, kinds[k % kinds.len()], &mut r).1.to_vec()).collect();
        assert_block_is_its_points(&Program::compile(&recording).unwrap(), &points);
        let adjoint = Program::compile(&recording.adjoint(0..6)).unwrap();
        let with_seeds = |point: &Vec<f64>| -> Vec<f64> {
            point.iter().copied().chain((0..n).map(|k| if k == 2 { 0.0 } else { 0.3 - 0.1 * k as f64 })).collect()
        };
        println!("{name}");
        assert_block_is_its_points(&adjoint, &points[..2000].iter().map(with_seeds).collect::<Vec<_>>());
    }
}

#[test]
fn an_environment_of_a_block_does_not_see_other_environments_problems() {
    let base = Problem::of_vehicle(&vehicles::by_name("firefly").unwrap()).unwrap();
    let function = AllocationFunction::new(base.clone()).unwrap();
    let n = base.n_input();
    let recording = Recording::of(function.n_number(), |numbers| {
        let mut inputs = vec![Trace::zero(); n];
        function.call_numbers(numbers, &mut inputs);
        inputs
    });
    let program = Program::compile(&recording).unwrap();
    let mut r = stream(61, 0);
    let point = |kind: Kind, r: &mut omnidrones::rng::Stream| -> Vec<f64> {
        let (problem, wrench) = trouble(&base, kind, r);
        let geometry = problem.geometry.iter().copied();
        (wrench.into_iter().chain(problem.weights).chain([problem.regularisation]).chain(geometry))
            .chain(problem.preference.clone())
            .chain(problem.lower.clone())
            .chain(problem.upper.clone())
            .collect()
    };
    let points: Vec<Vec<f64>> = (0..3000).map(|k| point(Kind::ALL[k * k % Kind::ALL.len()], &mut r)).collect();
    assert_block_is_its_points(&program, &points);
}
