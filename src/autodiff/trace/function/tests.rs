use super::*;
use crate::custom::{CustomFunction, Operation};
use crate::program::Program;
use crate::scalar::Scalar;
use num_dual::{Dual64, HyperDual64};
use rng::{Purpose, Stream};

/// x → (x₀ x₁, sin x₁).
struct Mixed;
impl CustomFunction for Mixed {
    fn n_input(&self) -> usize {
        2
    }
    fn n_output(&self) -> usize {
        2
    }
    fn value(&self, x: &[f64], y: &mut [f64]) {
        y.copy_from_slice(&[x[0] * x[1], x[1].sin()]);
    }
    fn forward(&self, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        dy.copy_from_slice(&[x[1] * dx[0] + x[0] * dx[1], x[1].cos() * dx[1]]);
    }
    fn reverse(&self, x: &[f64], y: &[f64], x_bar: &mut [f64]) {
        x_bar.copy_from_slice(&[x[1] * y[0], x[0] * y[0] + x[1].cos() * y[1]]);
    }
}

/// A random kernel of bounded numbers. Its inner parts are functions, or are not.
#[derive(Clone)]
struct Kernel {
    seed: u64,
    has_functions: bool,
    /// Custom functions have no second derivative.
    operation: Option<Operation>,
}

impl Kernel {
    fn new(seed: u64, has_custom: bool) -> Self {
        Self { seed, has_functions: true, operation: has_custom.then(|| Operation::new(Mixed)) }
    }

    fn without_functions(&self) -> Self {
        Self { has_functions: false, ..self.clone() }
    }

    fn run<S: Scalar>(&self, x: &[S]) -> Vec<S> {
        let mut values = x.to_vec();
        self.grow(&mut Stream::new(7, self.seed, 0, Purpose::user(7)), &mut values, 3);
        values[values.len() - 4..].to_vec()
    }

    fn grow<S: Scalar>(&self, r: &mut Stream, values: &mut Vec<S>, depth: u64) {
        for _ in 0..3 + r.below(if depth == 3 { 12 } else { 30 }) {
            let n = values.len() as u64;
            let any = |r: &mut Stream| values[(n - 1 - r.below(n.min(12))) as usize];
            let (a, b) = (any(r), any(r));
            let constant = S::constant(r.uniform(-1.0, 1.0));
            let new = match r.below(12) {
                0 | 1 if depth > 0 => {
                    // the same part twice and more: equal functions of other numbers
                    let (part, n_result) = (r.below(4), 1 + r.below(5) as usize);
                    let mut results = vec![constant; n_result];
                    let body = |results: &mut [S]| {
                        let mut inner = values[(n - n.min(5)) as usize..].to_vec();
                        let mut own = Stream::new(8, part, depth, Purpose::user(8));
                        self.grow(&mut own, &mut inner, depth - 1);
                        for (result, value) in results.iter_mut().skip(1).zip(inner.iter().rev()) {
                            *result = *value;
                        }
                    };
                    if self.has_functions {
                        S::function(&mut results, body)
                    } else {
                        body(&mut results)
                    }
                    values.extend(results);
                    continue;
                }
                2 if self.operation.is_some() => {
                    let mut y = [S::zero(); 2];
                    self.operation.iter().for_each(|operation| operation.call(&[a.tanh(), b.tanh()], &mut y));
                    y[0] + y[1]
                }
                3 => (a * a + b * b + S::one()).sqrt().recip(),
                4 => S::select(a.lt(b), a * constant, b),
                5 => a.detach() * b.tanh(),
                6 => (a * b).tanh(),
                7 => a.sin_cos().0 * constant,
                8 => a - b.sin_cos().1 * S::constant(0.5),
                9 => (a * constant + b * S::constant(0.3)).tanh(),
                10 => a * constant,
                _ => (a + b) * S::constant(0.5),
            };
            values.push(new);
        }
    }
}

fn point(seed: u64, n: usize) -> Vec<f64> {
    let mut r = Stream::new(9, seed, 0, Purpose::user(9));
    (0..n).map(|_| r.uniform(-1.0, 1.0)).collect()
}

fn recorded(kernel: &Kernel) -> Recording {
    Recording::of(5, |x| kernel.run(x))
}

fn value(recording: &Recording, x: &[f64]) -> Vec<f64> {
    let program = Program::compile(recording).unwrap();
    let mut y = vec![0.0; program.n_output()];
    program.evaluate(&mut program.workspace(), x, &mut y);
    y
}

fn assert_near(got: &[f64], want: &[f64], what: &str) {
    assert_eq!(got.len(), want.len());
    for (got, want) in got.iter().zip(want) {
        assert!((got - want).abs() <= 1e-12 * want.abs().max(1.0), "{what}: {got:e}, not {want:e}"); // measured 6e-15
    }
}

#[test]
fn functions_change_no_bit_of_values_and_jacobians_and_adjoints_but_by_the_order_of_sums() {
    let mut n_function = 0;
    for seed in 0..300 {
        let kernel = Kernel::new(seed, seed % 2 == 0);
        let (with, without) = (recorded(&kernel), recorded(&kernel.without_functions()));
        n_function += Program::compile(&with).unwrap().value_form().functions().len();
        let x = point(seed, 5);
        let bits = |y: Vec<f64>| y.into_iter().map(f64::to_bits).collect::<Vec<_>>();
        let plain = bits(kernel.run(&x));
        assert_eq!(bits(value(&with, &x)), plain, "{seed}: value with functions");
        assert_eq!(bits(value(&without, &x)), plain, "{seed}: value without");
        assert_eq!(bits(value(&with.jacobian(0..5), &x)), bits(value(&without.jacobian(0..5), &x)), "{seed}: Jacobian");
        let z: Vec<f64> = x.iter().copied().chain(point(seed ^ 77, 4)).collect();
        assert_near(&value(&with.adjoint(0..5), &z), &value(&without.adjoint(0..5), &z), &format!("{seed}: adjoint"));
        // some seeds are zero, some derivatives are not asked for
        let part = |recording: &Recording| value(&recording.adjoint_of(|k| k % 2 == 0, 1..3), &z);
        assert_near(&part(&with), &part(&without), &format!("{seed}: part of the adjoint"));
    }
    assert!(n_function > 300, "{n_function} functions");
}

#[test]
fn adjoints_of_functions_are_those_of_duals_and_adjoints_of_adjoints_those_of_hyper_duals() {
    for seed in 1000..1100 {
        let kernel = Kernel::new(seed, false);
        let (x, weights) = (point(seed, 5), point(seed ^ 5, 4));
        let adjoint = recorded(&kernel).adjoint(0..5);
        let z: Vec<f64> = x.iter().chain(&weights).copied().collect();
        let along = |k: usize| {
            let x: Vec<Dual64> = (0..5).map(|i| Dual64::new(x[i], f64::from(u8::from(i == k)))).collect();
            kernel.run(&x).iter().zip(&weights).map(|(y, w)| y.eps * w).sum()
        };
        let want: Vec<f64> = (0..5).map(along).collect();
        assert_near(&value(&adjoint, &z), &want, &format!("{seed}: adjoint"));
        // ∂(x̄ᵀ s)/∂x, the product of the Hessian of wᵀ y with s
        let s = point(seed ^ 6, 5);
        let second = adjoint.adjoint(0..5);
        let along = |k: usize| {
            let unit = |i| if i == k { 1.0 } else { 0.0 };
            let x: Vec<HyperDual64> = (0..5).map(|i| HyperDual64::new(x[i], unit(i), s[i], 0.0)).collect();
            kernel.run(&x).iter().zip(&weights).map(|(y, w)| y.eps1eps2 * w).sum()
        };
        let want: Vec<f64> = (0..5).map(along).collect();
        let z: Vec<f64> = z.iter().chain(&s).copied().collect();
        // numbers that are detached have no derivative of any order
        assert_near(&value(&second, &z), &want, &format!("{seed}: adjoint of the adjoint"));
    }
}

/// A part long enough to be a function.
fn long<S: Scalar>(x: S, y: S, n: usize) -> S {
    (0..n).fold(x, |sum, _| (sum * y + x).tanh())
}

fn in_function<S: Scalar>(body: impl FnOnce() -> S) -> S {
    let mut result = [S::zero()];
    S::function(&mut result, |result| result[0] = body());
    result[0]
}

/// Signs that two minus make are taken out once, and again where a recording is repeated: two calls become equal then.
#[test]
fn calls_that_become_equal_keep_adjoints_of_their_own() {
    let operation = Operation::new(Mixed);
    let kernel = |x: &[Trace], has_functions: bool| {
        let (e, c, w) = (x[0], x[1], x[2]);
        let part = |y: Trace| {
            let body = |results: &mut [Trace]| {
                results[0] = long(y, w, 20);
                results[1] = long(w, y, 7);
            };
            let mut results = [Trace::zero(); 2];
            if has_functions {
                Trace::function(&mut results, body)
            } else {
                body(&mut results)
            }
            results
        };
        let [a, _] = part((-e) - (-c));
        let mut between = [Trace::zero(); 2];
        operation.call(&[x[3], e], &mut between);
        let [_, b] = part(c - e);
        vec![a, between[0] + between[1], b]
    };
    let z = [0.3, -0.2, 0.7, 0.4, 1.0, -0.5, 0.25];
    let adjoint = |has_functions| value(&Recording::of(4, |x| kernel(x, has_functions)).adjoint(0..4), &z);
    assert_near(&adjoint(true), &adjoint(false), "adjoint");
}

#[test]
fn what_is_called_in_many_places_stays_a_function_wherever_one_of_them_is_put() {
    let inner = |x: Trace, y: Trace| in_function(|| long(x, y, 200));
    let size = |calls_it_too: bool| {
        let recording = Recording::of(2, |x| {
            let outer = in_function(|| (0..20).fold(x[0], |sum, _| inner(sum, x[1])));
            let own = if calls_it_too { inner(x[1], x[0]) } else { x[1] };
            vec![outer, own]
        });
        Program::compile(&recording).unwrap().len()
    };
    assert!(size(true) < size(false) + 10, "{} and {} instructions", size(true), size(false));
}

#[test]
fn equal_parts_are_one_function_also_of_other_numbers_and_of_other_recordings() {
    let record = || {
        Recording::of(3, |x| {
            vec![
                in_function(|| long(x[0], x[1], 20)),
                in_function(|| long(x[2], x[1], 20)),
                in_function(|| long(x[0], x[1], 21)),
            ]
        })
    };
    let functions = |recording: &Recording| -> Vec<Function> {
        let function =
            |call: &Call| if let Callee::Function(function) = &call.callee { Some(function.clone()) } else { None };
        recording.calls.iter().filter_map(function).collect()
    };
    let recording = record();
    let [a, b, c] = &functions(&recording)[..] else { panic!("three calls") };
    assert!(Arc::ptr_eq(&a.0, &b.0) && a != c);
    assert!(Arc::ptr_eq(&a.0, &functions(&record())[0].0));
    let elsewhere = std::thread::spawn(move || functions(&record())[0].clone()).join().unwrap();
    assert!(!Arc::ptr_eq(&a.0, &elsewhere.0) && *a == elsewhere, "equal, though not the same");
}

#[test]
fn equal_calls_are_one_and_calls_that_no_result_needs_are_none() {
    let program = |f: fn(&[Trace]) -> Vec<Trace>| Program::compile(&Recording::of(2, f)).unwrap();
    let twice = program(|x| {
        let _dead = in_function(|| long(x[1], x[0], 40));
        vec![in_function(|| long(x[0], x[1], 40)), in_function(|| long(x[0], x[1], 40))]
    });
    assert_eq!((twice.value_form().calls().len(), twice.value_form().instructions().len()), (1, 1));
}

#[test]
fn what_is_constant_for_a_function_is_folded_and_what_it_passes_through_is_no_result() {
    let recording = Recording::of(2, |x| {
        let (two, mut results) = (Trace::constant(2.0), [Trace::zero(); 4]);
        Trace::function(&mut results, |results| {
            results[0] = long(x[0], two * two, 20);
            results[1] = two;
            results[2] = x[1];
        });
        results.to_vec()
    });
    let form = Program::compile(&recording).unwrap().value_form().clone();
    assert_eq!((form.calls()[0].operands.len(), form.calls()[0].callee.n_output()), (1, 1));
    assert_eq!(value(&recording, &[0.5, 3.0])[1..], [2.0, 3.0, 0.0]);
    let constant = Recording::of(0, |_| vec![in_function(|| long(Trace::one(), Trace::one(), 30))]);
    assert!(constant.calls.is_empty());
}

#[test]
fn short_parts_are_no_functions() {
    let short = Recording::of(2, |x| vec![in_function(|| x[0] * x[1] + x[0])]);
    assert!(short.calls.is_empty());
}

#[test]
fn a_number_of_another_recording_is_an_error_and_the_next_recording_is_as_ever() {
    let foreign = |inner: fn(Trace, Trace) -> Trace| {
        let attempt = || {
            Recording::of(1, |x| {
                let mut result = Trace::zero();
                Recording::of(1, |y| {
                    result = inner(x[0], y[0]);
                    vec![result]
                });
                vec![result]
            })
        };
        std::panic::catch_unwind(attempt).map(|_| ())
    };
    for inner in [|x, y| x + y, |x: Trace, _| x, |_, y: Trace| y] {
        let failure = foreign(inner).unwrap_err();
        assert!(failure.downcast_ref::<&str>().is_some_and(|text| text.contains("another recording")));
    }
    // of a function that has ended
    let late = std::panic::catch_unwind(|| {
        Recording::of(1, |x| {
            let mut kept = x[0];
            let _ = in_function(|| {
                kept = x[0] + x[0];
                kept
            });
            vec![kept]
        })
    });
    assert!(late.is_err());
    assert_eq!(value(&Recording::of(1, |x| vec![x[0] + x[0]]), &[3.0]), [6.0]);
}

#[test]
fn recordings_nest() {
    let recording = Recording::of(1, |x| {
        let inner = Recording::of(1, |y| vec![y[0] * y[0]]);
        let nine = value(&inner, &[3.0])[0];
        vec![x[0] + Trace::constant(nine)]
    });
    assert_eq!(value(&recording, &[1.0]), [10.0]);
}

#[test]
fn a_thousand_steps_are_a_thousand_calls_and_their_adjoint_as_many_again() {
    let steps = |n: usize| {
        Recording::of(2, move |x| {
            let mut state = x.to_vec();
            for _ in 0..n {
                Trace::function(&mut state, |state| {
                    for _ in 0..5 {
                        let sine = state[0].sin_cos().0;
                        state[1] -= sine * Trace::constant(1e-3);
                        state[0] += state[1] * Trace::constant(1e-3);
                    }
                });
            }
            state
        })
    };
    let (few, many) = (steps(10), steps(1000));
    assert_eq!(few.calls.len(), 10);
    assert_eq!(many.calls.len(), 1000);
    let adjoint = Program::compile(&many.adjoint(0..2)).unwrap();
    assert_eq!((adjoint.value_form().functions().len(), adjoint.value_form().calls().len()), (2, 2000));
    // energy is nearly kept, and so is the area of the plane of states: the Jacobian has determinant 1
    let rows: Vec<f64> = [[1.0, 0.0], [0.0, 1.0]]
        .iter()
        .flat_map(|seed| value(&many.adjoint(0..2), &[0.3, 0.1, seed[0], seed[1]]))
        .collect();
    assert!((rows[0] * rows[3] - rows[1] * rows[2] - 1.0).abs() < 1e-12);
}

#[test]
fn a_form_with_functions_is_printed_with_them_behind_it() {
    let recording =
        Recording::of(2, |x| vec![in_function(|| long(x[0], x[1], 9)) + in_function(|| long(x[1], x[0], 9))]);
    let text = Program::compile(&recording).unwrap().value_form().to_string();
    let head = "2 inputs: v0 to v1\nv2 = function 0 (v0, v1)\nv3 = function 0 (v1, v0)\nv4 = v2 + v3\nresults: v4\n\n\
                function 0 of 2 inputs: v0 to v1\nv2 = v0·v1 + v0\nv3 = tanh v2\n";
    assert!(text.starts_with(head), "{text}");
}

#[test]
fn what_was_written_once_is_recorded_again_with_its_functions() {
    let (mut n_own, mut n_again) = (0, 0);
    for seed in 0..60 {
        let kernel = Kernel::new(seed, seed % 2 == 0);
        let written = Recording::as_written(5, |x| kernel.run(x));
        let again = Recording::of(5, |x| {
            let mut results = vec![Trace::zero(); written.n_output()];
            written.evaluate(x, &mut results);
            results
        });
        let (own, x) = (recorded(&kernel), point(seed, 5));
        assert_eq!(value(&again, &x), value(&own, &x), "{seed}");
        assert_eq!(value(&again.jacobian(0..5), &x), value(&own.jacobian(0..5), &x), "{seed}: Jacobian");
        let n_function = |recording: &Recording| Program::compile(recording).unwrap().value_form().functions().len();
        (n_own, n_again) = (n_own + n_function(&own), n_again + n_function(&again));
    }
    // what is a function in one of them alone is long before constants are folded, and short behind it
    assert!(n_own > 60 && n_own.abs_diff(n_again) * 20 < n_own, "{n_own} functions, again {n_again}");
}
