use super::*;
use crate::jet::Jet;
use crate::lanes::{Kernel, Lanes, dispatch_each};
use crate::program::BLOCK;
use crate::{
    BatchRollout, CertificateBounds, JacobianScratch, Objective, Program, Recording, Rollout, System, Trace, certify,
    jacobian,
};
use base::parallel::Threads;
use nalgebra::Const;
use num_dual::{Derivative, Dual64, DualSVec64, HyperDual64};
use rng::{Purpose, Stream};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Smooth, 3 → 2.
fn swirl<S: Scalar>(x: &[S]) -> [S; 2] {
    let (s, _) = (x[0] * x[1]).sin_cos();
    [s + x[2].square(), (S::constant(0.5) * x[0]).exp() * x[2]]
}

/// The same, with a Jacobian by hand, counting how often it is asked.
#[derive(Default)]
struct Swirl {
    values: Arc<AtomicUsize>,
    reverses: Arc<AtomicUsize>,
}

fn swirl_jacobian(x: &[f64]) -> [[f64; 3]; 2] {
    let (c, e) = ((x[0] * x[1]).cos(), (0.5 * x[0]).exp());
    [[x[1] * c, x[0] * c, 2.0 * x[2]], [0.5 * e * x[2], 0.0, e]]
}

impl CustomFunction for Swirl {
    fn n_input(&self) -> usize {
        3
    }
    fn n_output(&self) -> usize {
        2
    }
    fn value(&self, x: &[f64], y: &mut [f64]) {
        self.values.fetch_add(1, Ordering::Relaxed);
        y.copy_from_slice(&swirl(x));
    }
    fn forward(&self, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        for (dy, row) in dy.iter_mut().zip(swirl_jacobian(x)) {
            *dy = (0..3).map(|k| row[k] * dx[k]).sum();
        }
    }
    fn reverse(&self, x: &[f64], y_bar: &[f64], x_bar: &mut [f64]) {
        self.reverses.fetch_add(1, Ordering::Relaxed);
        let [a, b] = swirl_jacobian(x);
        for k in 0..3 {
            x_bar[k] = a[k] * y_bar[0] + b[k] * y_bar[1];
        }
    }
}

/// A y = b of two unknowns by Cramer's rule: [a₁₁, a₁₂, a₂₁, a₂₂, b₁, b₂] → y.
fn solve<S: Scalar>(z: &[S]) -> [S; 2] {
    let over = (z[0] * z[3] - z[1] * z[2]).recip();
    [(z[3] * z[4] - z[1] * z[5]) * over, (z[0] * z[5] - z[2] * z[4]) * over]
}

/// The same by elimination with a pivot, which branches; derivatives by the implicit function theorem.
struct Solve;

fn eliminate(a: [f64; 4], b: [f64; 2]) -> [f64; 2] {
    let ([p, q], [r, s], [f, g]) = if a[0].abs() >= a[2].abs() {
        ([a[0], a[1]], [a[2], a[3]], b)
    } else {
        ([a[2], a[3]], [a[0], a[1]], [b[1], b[0]])
    };
    let last = (g - r / p * f) / (s - r / p * q);
    [(f - q * last) / p, last]
}

impl CustomFunction for Solve {
    fn n_input(&self) -> usize {
        6
    }
    fn n_output(&self) -> usize {
        2
    }
    fn value(&self, z: &[f64], y: &mut [f64]) {
        y.copy_from_slice(&eliminate([z[0], z[1], z[2], z[3]], [z[4], z[5]]));
    }
    fn forward(&self, z: &[f64], dz: &[f64], dy: &mut [f64]) {
        let mut y = [0.0; 2];
        self.value(z, &mut y);
        let rest = [dz[4] - dz[0] * y[0] - dz[1] * y[1], dz[5] - dz[2] * y[0] - dz[3] * y[1]];
        dy.copy_from_slice(&eliminate([z[0], z[1], z[2], z[3]], rest));
    }
    fn reverse(&self, z: &[f64], y_bar: &[f64], z_bar: &mut [f64]) {
        let mut y = [0.0; 2];
        self.value(z, &mut y);
        let w = eliminate([z[0], z[2], z[1], z[3]], [y_bar[0], y_bar[1]]);
        z_bar.copy_from_slice(&[-w[0] * y[0], -w[0] * y[1], -w[1] * y[0], -w[1] * y[1], w[0], w[1]]);
    }
}

/// Both functions, called or written out.
#[derive(Clone)]
enum Way {
    Plain,
    Called { swirl: Operation, solve: Operation },
}

fn called() -> Way {
    Way::Called { swirl: Operation::new(Swirl::default()), solve: Operation::new(Solve) }
}

impl Way {
    fn swirl<S: Scalar>(&self, x: &[S]) -> [S; 2] {
        let Way::Called { swirl: operation, .. } = self else { return swirl(x) };
        let mut y = [S::zero(); 2];
        operation.call(x, &mut y);
        y
    }

    fn solve<S: Scalar>(&self, z: &[S]) -> [S; 2] {
        let Way::Called { solve: operation, .. } = self else { return solve(z) };
        let mut y = [S::zero(); 2];
        operation.call(z, &mut y);
        y
    }

    /// Each function of the other's results, between ordinary operations; 3 → 3.
    fn chain<S: Scalar>(&self, x: &[S]) -> [S; 3] {
        let c = S::constant;
        let [p, q] = self.swirl(&[x[0], x[1].tanh(), x[2]]);
        let [u, v] = self.solve(&[c(3.0) + p, x[1], q, c(-2.0), x[0], p * q]);
        let [r, _] = self.swirl(&[u, x[0], v]);
        [r + x[1], u * v, q]
    }
}

const POINTS: [[f64; 3]; 3] = [[0.4, -0.7, 1.1], [-1.3, 0.2, 0.5], [0.0, 0.9, -0.8]];

/// Columns of the Jacobian of `chain` by plain duals.
fn plain_columns(x: [f64; 3]) -> [[f64; 3]; 3] {
    [0, 1, 2]
        .map(|k| Way::Plain.chain(&[0, 1, 2].map(|i| Dual64::new(x[i], f64::from(u8::from(i == k))))).map(|y| y.eps))
}

fn worst(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let error = |(a, b): (&f64, &f64)| if a.is_nan() { f64::INFINITY } else { (a - b).abs() / b.abs().max(1.0) };
    a.iter().zip(b).map(error).fold(0.0, f64::max)
}

fn run(program: &Program, inputs: &[f64]) -> Vec<f64> {
    let mut outputs = vec![f64::NAN; program.n_output()];
    program.evaluate(&mut program.workspace(), inputs, &mut outputs);
    outputs
}

#[test]
fn a_called_function_has_the_values_and_derivatives_of_the_written_one_by_every_scalar() {
    let way = called();
    let mut error = 0.0_f64;
    for x in POINTS {
        let (value, columns) = (Way::Plain.chain(&x), plain_columns(x));
        let mut check = |got: [f64; 3], want: &[f64]| error = error.max(worst(&got, want));
        check(way.chain(&x), &value);
        let wide =
            way.chain(&[0, 1, 2].map(|i| DualSVec64::<3>::new(x[i], Derivative::derivative_generic(Const, Const, i))));
        check(wide.map(|y| y.re), &value);
        for k in 0..3 {
            let unit = |i: usize| f64::from(u8::from(i == k));
            let dual = way.chain(&[0, 1, 2].map(|i| Dual64::new(x[i], unit(i))));
            check(dual.map(|y| y.re), &value);
            check(dual.map(|y| y.eps), &columns[k]);
            check(wide.map(|y| y.eps.unwrap_generic(Const::<3>, Const::<1>)[k]), &columns[k]);
            let hyper = way.chain(&[0, 1, 2].map(|i| HyperDual64::new(x[i], unit(i), -unit(i), 0.0)));
            check(hyper.map(|y| y.eps1), &columns[k]);
            check(hyper.map(|y| -y.eps2), &columns[k]);
            let jet = way.chain(&[0, 1, 2].map(|i| Jet::<f64, 2> { coefficients: [x[i], unit(i)] }));
            check(jet.map(|y| y.value()), &value);
            check(jet.map(|y| y.derivative(1)), &columns[k]);
        }
    }
    println!("worst {error:.1e}");
    assert!(error <= 1e-12, "{error:e}"); // measured 1.9e-16
}

#[test]
fn a_called_function_has_the_same_program_adjoint_and_compiled_jacobian() {
    let way = called();
    let recording = Recording::of(3, |z| way.chain(z).to_vec());
    let [forward, adjoint, jacobian] =
        [&recording, &recording.adjoint(0..3), &recording.jacobian(0..3)].map(|r| Program::compile(r).unwrap());
    let mut error = 0.0_f64;
    for x in POINTS {
        let (value, columns) = (Way::Plain.chain(&x), plain_columns(x));
        assert_eq!(run(&forward, &x), way.chain(&x), "the same bits as the direct call");
        error = error.max(worst(&run(&forward, &x), &value));
        error = error.max(worst(&run(&jacobian, &x), columns.as_flattened()));
        let seed = [0.3, -1.2, 0.8];
        let want = columns.map(|column| (0..3).map(|i| column[i] * seed[i]).sum::<f64>());
        error = error.max(worst(&run(&adjoint, &[x, seed].concat()), &want));
    }
    println!("worst {error:.1e}");
    assert!(error <= 1e-12, "{error:e}"); // measured 3.0e-16
}

/// Values by lanes and by single `f32`, for every width.
#[derive(Clone, Copy)]
struct InLanes<'a>(&'a Way);

impl Kernel for InLanes<'_> {
    type Output = ();
    fn run<L: Lanes>(self) {
        let rows: Vec<Vec<f32>> =
            (0..3).map(|k| (0..16).map(|lane| 0.3 + 0.1 * k as f32 - 0.05 * lane as f32).collect()).collect();
        let Way::Called { swirl, .. } = self.0 else { return };
        let mut y = [L::zero(); 2];
        swirl.call(&[0, 1, 2].map(|k| L::load(&rows[k])), &mut y);
        for j in 0..2 {
            let mut got = [0.0; 16];
            y[j].store(&mut got);
            for lane in 0..L::WIDTH {
                let mut single = [0.0; 2];
                swirl.call(&[0, 1, 2].map(|k| rows[k][lane]), &mut single);
                assert_eq!(got[lane].to_bits(), single[j].to_bits(), "lane {lane} of {}", L::WIDTH);
                let exact = super::tests::swirl(&[0, 1, 2].map(|k| f64::from(rows[k][lane])));
                assert_eq!(single[j], exact[j] as f32, "f64 rounded once");
            }
        }
    }
}

#[test]
fn every_width_of_lanes_calls_lane_by_lane_through_f64() {
    dispatch_each(InLanes(&called()));
}

#[test]
fn a_block_calls_for_each_of_its_environments_and_a_nan_stays_in_its_own() {
    let way = called();
    let recording = Recording::of(3, |z| way.chain(z).to_vec());
    let mut inputs = [[0.0_f32; BLOCK]; 3];
    for lane in 0..BLOCK {
        for k in 0..3 {
            inputs[k][lane] = (0.7 * lane as f32 + k as f32).sin();
        }
    }
    let evaluate = |recording: &Recording, inputs: &[[f32; BLOCK]]| {
        let program = Program::compile(recording).unwrap();
        let mut outputs = vec![[0.0; BLOCK]; program.n_output()];
        program.evaluate_block(&mut program.block_workspace(), inputs, &mut outputs);
        outputs
    };
    let plain = Recording::of(3, |z| Way::Plain.chain(z).to_vec());
    let mut error = 0.0_f64;
    let seeded: Vec<_> = inputs.iter().copied().chain([[1.0; BLOCK]; 3]).collect();
    for (got, want) in [
        (evaluate(&recording, &inputs), evaluate(&plain, &inputs)),
        (evaluate(&recording.adjoint(0..3), &seeded), evaluate(&plain.adjoint(0..3), &seeded)),
    ] {
        for (got, want) in got.as_flattened().iter().zip(want.as_flattened()) {
            error = error.max(worst(&[f64::from(*got)], &[f64::from(*want)]));
        }
    }
    println!("worst {error:.1e}");
    assert!(error <= 5e-6, "{error:e}"); // measured 4.8e-7

    let healthy = evaluate(&recording, &inputs);
    inputs[0][17] = f32::NAN;
    for (with, without) in evaluate(&recording, &inputs).iter().zip(healthy) {
        for lane in (0..BLOCK).filter(|lane| *lane != 17) {
            assert_eq!(with[lane].to_bits(), without[lane].to_bits());
        }
        assert!(with[17].is_nan());
    }
}

/// A particle pushed through `chain`.
struct Particle(Way);

impl System for Particle {
    fn n_state(&self) -> usize {
        3
    }
    fn n_input(&self) -> usize {
        1
    }
    fn n_parameter(&self) -> usize {
        1
    }
    fn step<S: Scalar>(&self, x: &[S], u: &[S], theta: &[S], next: &mut [S]) {
        let force = self.0.chain(&[x[0], theta[0] * x[1], x[2] + u[0]]);
        for k in 0..3 {
            next[k] = x[k] + S::constant(0.01) * (force[k] - x[k]);
        }
    }
}

/// A cost that is itself a called function.
struct Cost(Way);

impl Objective for Cost {
    fn stage<S: Scalar>(&self, x: &[S], u: &[S], _: &[S]) -> S {
        let [a, b] = self.0.swirl(&[x[0], u[0], x[1]]);
        a.square() + b.square()
    }
    fn terminal<S: Scalar>(&self, x: &[S], theta: &[S]) -> S {
        self.0.swirl(x)[1].square() * theta[0]
    }
}

#[test]
fn a_rollout_through_called_functions_has_the_gradient_of_the_written_ones() {
    let (x0, theta) = ([0.3, -0.4, 0.6], [0.9]);
    let inputs: Vec<f64> = (0..60).map(|k| 0.2 * (0.3 * f64::from(k)).sin()).collect();
    let way = called();
    let of = |way: &Way| Rollout::new(Particle(way.clone()), Cost(way.clone())).unwrap();
    let (cost, gradient) = of(&way).gradient(&x0, &inputs, &theta);
    let (plain_cost, plain) = of(&Way::Plain).gradient(&x0, &inputs, &theta);
    let (_, dual) = of(&way).gradient_forward(&x0, &inputs, &theta);
    let all = |g: &crate::Gradient| [&g.state[..], &g.parameters, &g.inputs].concat();
    let written = worst(&[vec![cost], all(&gradient)].concat(), &[vec![plain_cost], all(&plain)].concat());
    let forward = worst(&[&gradient.state[..], &gradient.parameters].concat(), &all(&dual));
    println!("against the written {written:.1e}, against duals {forward:.1e}");
    assert!(written <= 1e-12 && forward <= 1e-12, "{written:e} {forward:e}"); // measured 9.1e-16, 7.8e-16

    let batch = BatchRollout::new(&Particle(way.clone()), &Cost(way)).unwrap();
    let starts: Vec<f32> = (0..70).flat_map(|_| x0.map(|x| x as f32)).collect();
    let many = batch.gradient(&starts, &inputs, &theta, &Threads::new(2).unwrap()).unwrap();
    let error = worst(&many.parameters, &plain.parameters);
    println!("in lanes {error:.1e}");
    assert!(error <= 2e-6 && many.n_finite == 70, "{error:e}"); // measured 1.6e-7
}

#[test]
fn the_certificate_holds_for_a_system_that_calls_and_not_for_a_wrong_derivative() {
    let certificate = certify(&Particle(called()), &[0.3, -0.4, 0.6], &[0.1], &[0.9]).unwrap();
    println!("{certificate}");
    assert!(certificate.holds(CertificateBounds::default()), "{certificate}");

    /// `Solve` whose reverse forgets to transpose.
    struct Wrong;
    impl CustomFunction for Wrong {
        fn n_input(&self) -> usize {
            6
        }
        fn n_output(&self) -> usize {
            2
        }
        fn value(&self, z: &[f64], y: &mut [f64]) {
            Solve.value(z, y);
        }
        fn forward(&self, z: &[f64], dz: &[f64], dy: &mut [f64]) {
            Solve.forward(z, dz, dy);
        }
        fn reverse(&self, z: &[f64], y_bar: &[f64], z_bar: &mut [f64]) {
            Solve.reverse(&[z[0], z[2], z[1], z[3], z[4], z[5]], y_bar, z_bar);
        }
    }
    let wrong = Way::Called { swirl: Operation::new(Swirl::default()), solve: Operation::new(Wrong) };
    let certificate = certify(&Particle(wrong), &[0.3, -0.4, 0.6], &[0.1], &[0.9]).unwrap();
    assert!(!certificate.holds(CertificateBounds::default()), "{certificate}");
}

#[test]
fn equal_calls_are_made_once_and_dead_ones_never() {
    let function = Swirl::default();
    let (values, reverses) = (function.values.clone(), function.reverses.clone());
    let swirl = Operation::new(function);
    let call = |x: &[Trace]| {
        let mut y = [Trace::zero(); 2];
        swirl.clone().call(x, &mut y);
        y
    };
    let recording = Recording::of(3, |z| {
        let (first, again, _dead) = (call(z), call(z), call(&[z[2], z[1], z[0]]));
        vec![first[0] * again[1], again[0]]
    });
    let count = |recording: &Recording, inputs: &[f64]| {
        let program = Program::compile(recording).unwrap();
        values.store(0, Ordering::Relaxed);
        reverses.store(0, Ordering::Relaxed);
        run(&program, inputs);
        (values.load(Ordering::Relaxed), reverses.load(Ordering::Relaxed))
    };
    let x = [0.3, 0.5, 0.7];
    assert_eq!(count(&recording, &x), (1, 0));
    assert_eq!(count(&recording.adjoint(0..3), &[&x[..], &[1.0, 2.0]].concat()), (1, 1));
    let twice = recording.adjoint(0..3).adjoint(0..0);
    assert_eq!(count(&twice, &[&x[..], &[1.0, 2.0], &[1.0; 3]].concat()), (0, 0), "nothing asked, nothing done");

    let detached = Recording::of(3, |z| vec![call(&[z[0].detach(), z[1].detach(), z[2].detach()])[0] + call(z)[1]]);
    assert_eq!(count(&detached, &x), (1, 0), "the same call but for a detachment");
    assert_eq!(count(&detached.adjoint(0..3), &[0.3, 0.5, 0.7, 1.0]), (0, 1));
    let all_detached = Recording::of(3, |z| vec![call(z)[0].detach() * z[0]]);
    assert_eq!(count(&all_detached.adjoint(0..3), &[0.3, 0.5, 0.7, 1.0]), (1, 0));

    let constant = Recording::of(1, |z| {
        let y = call(&[0.3, 0.5, 0.7].map(Trace::constant));
        vec![y[0], y[1] * z[0]]
    });
    assert_eq!(count(&constant, &[2.0]), (0, 0), "folded while recording");
    let [a, b] = super::tests::swirl(&x);
    assert_eq!(run(&Program::compile(&constant).unwrap(), &[2.0]), [a, 2.0 * b]);
}

#[test]
fn a_result_that_nobody_reads_takes_no_slot_and_spoils_none() {
    let solve = Operation::new(Many(40));
    for k in 0..40 {
        let recording = Recording::of(40, |z| {
            let mut y = [Trace::zero(); 40];
            solve.call(z, &mut y);
            vec![y[k] + z[0], z[39]]
        });
        let program = Program::compile(&recording).unwrap();
        assert_eq!((program.len(), program.n_slot()), (2, 40));
        let x: Vec<f64> = (0..40).map(f64::from).collect();
        assert_eq!(run(&program, &x), [2.0 * (39 - k) as f64, 39.0]);
        let adjoint = Program::compile(&recording.adjoint(0..40)).unwrap();
        let mut want = vec![0.0; 40];
        want[0] += 1.0;
        want[39] += 5.0;
        want[39 - k] += 2.0;
        assert_eq!(run(&adjoint, &[&x[..], &[1.0, 5.0]].concat()), want);
    }
}

#[test]
fn different_functions_of_equal_arguments_are_not_confused() {
    struct Scale(f64);
    impl CustomFunction for Scale {
        fn n_input(&self) -> usize {
            1
        }
        fn n_output(&self) -> usize {
            1
        }
        fn value(&self, x: &[f64], y: &mut [f64]) {
            y[0] = self.0 * x[0];
        }
        fn forward(&self, _: &[f64], dx: &[f64], dy: &mut [f64]) {
            dy[0] = self.0 * dx[0];
        }
        fn reverse(&self, _: &[f64], y_bar: &[f64], x_bar: &mut [f64]) {
            x_bar[0] = self.0 * y_bar[0];
        }
    }
    let operations = [2.0, 3.0, 3.0].map(|scale| Operation::new(Scale(scale)));
    let recording = Recording::of(1, |z| {
        let mut y = [Trace::zero(); 3];
        for k in 0..3 {
            operations[k].call(z, &mut y[k..k + 1]);
        }
        y.to_vec()
    });
    let program = Program::compile(&recording).unwrap();
    assert_eq!((run(&program, &[5.0]), program.len()), (vec![10.0, 15.0, 15.0], 3));
    let adjoint = Program::compile(&recording.adjoint(0..1)).unwrap();
    assert_eq!(run(&adjoint, &[5.0, 1.0, 10.0, 100.0]), [2.0 + 30.0 + 300.0]);
    assert_eq!(operations[0], operations[0].clone());
    assert_ne!(operations[1], operations[2]);
}

/// y₍ₖ₎ = 2 x₍ₙ₋₁₋ₖ₎: more numbers than any stack buffer holds, if asked.
struct Many(usize);

impl CustomFunction for Many {
    fn n_input(&self) -> usize {
        self.0
    }
    fn n_output(&self) -> usize {
        self.0
    }
    fn value(&self, x: &[f64], y: &mut [f64]) {
        for (y, x) in y.iter_mut().zip(x.iter().rev()) {
            *y = 2.0 * x;
        }
    }
    fn forward(&self, _: &[f64], dx: &[f64], dy: &mut [f64]) {
        self.value(dx, dy);
    }
    fn reverse(&self, _: &[f64], y_bar: &[f64], x_bar: &mut [f64]) {
        self.value(y_bar, x_bar);
    }
}

#[derive(Clone, Copy)]
struct ManyInLanes;

impl Kernel for ManyInLanes {
    type Output = ();
    fn run<L: Lanes>(self) {
        check_many(
            |x| L::constant(f64::from(x)),
            |y| {
                let mut out = [0.0; 16];
                y.store(&mut out);
                f64::from(out[L::WIDTH - 1])
            },
        );
    }
}

fn check_many<S: Scalar>(lift: impl Fn(u16) -> S, value: impl Fn(S) -> f64) {
    let x: Vec<S> = (0..700).map(lift).collect();
    let mut y = x.clone();
    Operation::new(Many(700)).call(&x, &mut y);
    for (k, y) in y.into_iter().enumerate() {
        assert_eq!(value(y), 2.0 * (699 - k) as f64);
    }
}

#[test]
fn a_function_of_hundreds_of_numbers_is_called_like_a_small_one() {
    check_many(f64::from, |y| y);
    check_many(f32::from, f64::from);
    check_many(|x| Dual64::new(0.0, f64::from(x)), |y| y.eps);
    check_many(|x| Jet::<f64, 2> { coefficients: [0.0, f64::from(x)] }, |y| y.derivative(1));
    dispatch_each(ManyInLanes);
}

#[test]
fn a_second_derivative_is_nan_where_it_is_unknown_and_exact_where_a_direction_is_zero() {
    let way = called();
    let x = POINTS[0];
    let columns = [0, 1].map(|j| swirl_jacobian(&x)[j]);
    let hyper = |a: f64, b: f64, ab: f64| {
        way.swirl(&[HyperDual64::new(x[0], a, b, ab), HyperDual64::from(x[1]), HyperDual64::from(x[2])])
    };
    assert!(hyper(1.0, 1.0, 3.0).iter().all(|y| y.eps1eps2.is_nan() && y.eps1.is_finite() && y.eps2.is_finite()));
    assert_eq!(hyper(1.0, 0.0, 3.0).map(|y| y.eps1eps2), [0, 1].map(|j| 3.0 * columns[j][0]));

    let jet = |c: [f64; 4]| way.swirl(&[Jet { coefficients: c }, Jet::fixed(x[1]), Jet::fixed(x[2])]);
    let curved = jet([x[0], 1.0, 0.0, 0.0])[0].coefficients;
    assert_eq!((curved[1], curved[2].is_nan(), curved[3].is_nan()), (columns[0][0], true, true));
    let late = jet([x[0], 0.0, 2.0, 0.0])[0].coefficients;
    assert_eq!((late[1], late[2], late[3].is_nan()), (0.0, 2.0 * columns[0][0], true));
    assert_eq!(jet([x[0], 0.0, 0.0, 0.0])[1].coefficients[1..], [0.0; 3], "a constant stays one");
    let nested = way.swirl(&[0, 1, 2].map(|k| Jet::<Dual64, 2>::variable(Dual64::new(x[k], 1.0))));
    assert!(nested.iter().all(|y| y.derivative(0).eps == y.derivative(1).re && y.derivative(1).eps.is_nan()));

    // x̄ = J(x)ᵀ ȳ: its adjoint is J with respect to ȳ, and not known with respect to x
    let adjoint = Recording::of(3, |z| way.swirl(z).to_vec()).adjoint(0..3);
    let seed = [0.5, -1.0, 2.0];
    let inputs = [&x[..], &[1.0, 1.0], &seed].concat();
    let by_seed = run(&Program::compile(&adjoint.adjoint(3..5)).unwrap(), &inputs);
    let exact = columns.map(|row| (0..3).map(|k| row[k] * seed[k]).sum::<f64>());
    assert!(worst(&by_seed, &exact) <= 1e-15); // measured 0
    assert!(run(&Program::compile(&adjoint.adjoint(0..3)).unwrap(), &inputs).iter().all(|x| x.is_nan()));
}

/// A y = b by Jacobi's iteration on detached numbers, then one live step with a detached inverse.
fn implicit_solve<S: Scalar>(z: &[S]) -> [S; 2] {
    let held: [S; 6] = [0, 1, 2, 3, 4, 5].map(|k| z[k].detach());
    let mut y = [S::zero(); 2];
    for _ in 0..60 {
        y = [(held[4] - held[1] * y[1]) * held[0].recip(), (held[5] - held[2] * y[0]) * held[3].recip()];
    }
    let rest = [z[4] - z[0] * y[0] - z[1] * y[1], z[5] - z[2] * y[0] - z[3] * y[1]];
    let step = solve(&[held[0], held[1], held[2], held[3], rest[0], rest[1]]);
    [y[0] + step[0], y[1] + step[1]]
}

/// A function over any scalar as a system without inputs, to take Jacobians of.
struct Static<const CALLED: bool>(Operation);

impl<const CALLED: bool> System for Static<CALLED> {
    fn n_state(&self) -> usize {
        6
    }
    fn n_input(&self) -> usize {
        0
    }
    fn step<S: Scalar>(&self, z: &[S], _: &[S], _: &[S], next: &mut [S]) {
        next.fill(S::zero());
        if CALLED {
            self.0.call(z, &mut next[..2]);
        } else {
            next[..2].copy_from_slice(&implicit_solve(z));
        }
    }
}

#[test]
fn an_implicit_step_and_a_custom_function_give_one_derivative_of_a_linear_system() {
    let z = [3.0, 0.7, -0.4, 2.5, 1.3, -0.6];
    let of = |jacobian_of: &dyn Fn(&mut [f64])| {
        let mut columns = vec![0.0; 36];
        jacobian_of(&mut columns);
        columns
    };
    let (custom, implicit) = (Static::<true>(Operation::new(Solve)), Static::<false>(Operation::new(Solve)));
    let by_call = of(&|j| jacobian(&custom, &z, &[], &[], &mut JacobianScratch::new(&custom), j));
    let by_step = of(&|j| jacobian(&implicit, &z, &[], &[], &mut JacobianScratch::new(&implicit), j));
    let recording = Recording::of(6, |z| implicit_solve(z).to_vec());
    let by_program = run(&Program::compile(&recording.jacobian(0..6)).unwrap(), &z);
    let by_program: Vec<f64> = by_program.chunks(2).flat_map(|c| [c[0], c[1], 0.0, 0.0, 0.0, 0.0]).collect();
    let error = worst(&by_step, &by_call).max(worst(&by_program, &by_call));
    println!("worst {error:.1e}");
    assert!(error <= 1e-15, "{error:e}"); // measured 5.6e-17
    for certificate in [certify(&custom, &z, &[], &[]).unwrap(), certify(&implicit, &z, &[], &[]).unwrap()] {
        assert!(certificate.holds(CertificateBounds::default()), "{certificate}");
    }
}

/// Calls and ordinary operations at random, of any scalar; some results are read often, some never.
fn random_calls<S: Scalar>(way: &Way, seed: u64, inputs: &[S]) -> Vec<S> {
    let mut r = Stream::new(62, seed, 0, Purpose::user(62));
    let mut values = inputs.to_vec();
    let c = S::constant;
    for _ in 0..3 + r.below(25) {
        let mut pick = || values[r.below(values.len() as u64) as usize].tanh();
        let z = [pick(), pick(), pick(), pick()];
        match r.below(5) {
            0 => values.push(z[0] * z[1] + z[2]),
            1 => values.push(z[0].sin_cos().1 - z[3].detach() * z[1]),
            2 => values.push(S::select(z[0].lt(z[1]), z[2], z[3])),
            3 => values.extend(way.swirl(&z[..3])),
            _ => values.extend(way.solve(&[c(3.0) + z[0], z[1], z[2], c(-2.5), z[3], z[0]])),
        }
    }
    let n = values.len();
    (0..3).map(|_| values[r.below(n as u64) as usize]).chain([values[n - 1]]).collect()
}

#[test]
fn random_graphs_with_calls_compute_the_bits_of_direct_evaluation_and_the_gradient_of_duals() {
    let way = called();
    let mut error = 0.0_f64;
    for seed in 0..1000 {
        let recording = Recording::of(3, |z| random_calls(&way, seed, z));
        let program = Program::compile(&recording).unwrap();
        let adjoint = Program::compile(&recording.adjoint(0..3)).unwrap();
        let mut r = Stream::new(63, seed, 0, Purpose::user(63));
        let x = [(); 3].map(|()| r.uniform(-1.5, 1.5));
        assert_eq!(run(&program, &x), random_calls(&way, seed, &x), "graph {seed}");
        let seeds = [0.4, -0.9, 1.3, 0.8];
        let want = [0, 1, 2].map(|k| {
            let lifted = [0, 1, 2].map(|i| Dual64::new(x[i], f64::from(u8::from(i == k))));
            random_calls(&Way::Plain, seed, &lifted).iter().zip(seeds).map(|(y, s)| y.eps * s).sum::<f64>()
        });
        error = error.max(worst(&run(&adjoint, &[&x[..], &seeds].concat()), &want));
    }
    println!("worst {error:.1e}");
    assert!(error <= 1e-12, "{error:e}"); // measured 1.7e-15
}

#[test]
#[should_panic(expected = "lengths of a custom function")]
fn a_call_with_the_wrong_lengths_is_a_mistake_of_the_program() {
    Operation::new(Solve).call(&[1.0; 5], &mut [0.0; 2]);
}
