use super::*;
use crate::custom::{CustomFunction, Operation};
use crate::example::Quadrotor;
use crate::{System, Trace, safe};

/// (a, b) → (a b, a − b).
struct Pair;
impl CustomFunction for Pair {
    fn n_input(&self) -> usize {
        2
    }
    fn n_output(&self) -> usize {
        2
    }
    fn value(&self, x: &[f64], y: &mut [f64]) {
        y.copy_from_slice(&[x[0] * x[1], x[0] - x[1]]);
    }
    fn forward(&self, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        dy.copy_from_slice(&[x[1] * dx[0] + x[0] * dx[1], dx[0] - dx[1]]);
    }
    fn reverse(&self, x: &[f64], y: &[f64], x_bar: &mut [f64]) {
        x_bar.copy_from_slice(&[x[1] * y[0] + y[1], x[0] * y[0] - y[1]]);
    }
}

/// Every operation, what folds (constants, signs, zeros, ones) and what is fused.
fn everything<S: Scalar>(x: &[S], operation: &Operation) -> Vec<S> {
    let c = S::constant;
    let (a, b, d) = (x[0], x[1], x[2]);
    let (sine, cosine) = a.sin_cos();
    let (is_less, is_positive) = (a.lt(b), c(0.0).lt(d));
    let mut called = [a; 2];
    operation.call(&[sine, d], &mut called);
    let mut of_constants = [a; 2];
    operation.call(&[c(2.0), c(-0.1)], &mut of_constants);
    vec![
        a + b * d,
        a.mul_add(b, d) - b.mul_add(c(1.0), d),
        a.mul_add(c(0.0), d) + b.mul_add(c(-1.0), a),
        -(a - b) * (-d) + c(0.1) * c(0.7) - c(1.0) / c(3.0),
        (a * c(1.0) + c(0.0)) / (d * c(-1.0)),
        (sine * cosine + c(0.3).sin_cos().0).exp() + b.sin_cos().1,
        (a * a + c(1.0)).ln().sqrt().recip() + c(2.0).sqrt(),
        a.tanh().atan2(b.detach()),
        S::select(is_less.and(is_positive.not()), a, b),
        S::select(is_less.or(is_positive), S::select(is_less, d, d), c(0.5)),
        S::select(c(1.0).lt(c(2.0)), a, b) + a.max(b).min(c(2.0)),
        safe::norm([a, b, d]),
        called[0] * called[1] + of_constants[0] * called[0],
        of_constants[1] + b * d,
        a,
        c(0.1),
    ]
}

/// Nodes, calls, results and all.
fn assert_walked_is_direct(name: &str, n_input: usize, f: &dyn Fn(&[Trace]) -> Vec<Trace>) {
    let written = Recording::as_written(n_input, f);
    let walked = |x: &[Trace]| {
        let mut walk = Walk::new(&written);
        walk.run(&mut |_, k| x[k]);
        (0..written.n_output()).map(|k| walk.output(k)).collect()
    };
    assert_eq!(Recording::of(n_input, walked), Recording::of(n_input, f), "{name}");
    assert_eq!(Recording::of_lanes(n_input, walked), Recording::of_lanes(n_input, f), "{name}, of lanes");
    assert_eq!(Recording::as_written(n_input, f), written, "{name}, again");
}

#[test]
fn what_was_written_once_is_recorded_again_as_if_it_were_written_there() {
    let operation = Operation::new(Pair);
    assert_walked_is_direct("everything", 3, &|x| everything(x, &operation));
    assert_walked_is_direct("a call alone", 2, &|x| {
        let mut y = [x[1], x[0]];
        operation.call(x, &mut y);
        y.to_vec()
    });
    for is_loaded in [false, true] {
        let quadrotor = Quadrotor { is_loaded };
        let n = quadrotor.n_state();
        assert_walked_is_direct("a step", n + 4, &|x| {
            let mut next = x[..n].to_vec();
            quadrotor.step(&x[..n], &x[n..], &[], &mut next);
            next
        });
    }
}
