//! Any file of a recording is refused, or can be evaluated, recorded anew, in lanes too, compiled, run and saved again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use omnidrones::autodiff::custom::SavedFunction;
use omnidrones::autodiff::trace::SavedLimits;
use omnidrones::autodiff::{BLOCK, CustomFunction, Operation, Program, Recording, Scalar};
use omnidrones::error::{Error, Result};
use std::sync::LazyLock;

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
    fn saved(&self) -> Option<SavedFunction> {
        Some(SavedFunction { name: "p".into(), data: Vec::new() })
    }
}

/// Equal files call the same operation.
static PAIR: LazyLock<Operation> = LazyLock::new(|| Operation::new(Pair));

fn operation(name: &str, data: &[u8]) -> Result<Operation> {
    match (name, data) {
        ("p", []) => Ok(PAIR.clone()),
        _ => Err(Error::Unknown { kind: "operation", name: name.into(), known: vec!["p".into()] }),
    }
}

fn walked<S: Scalar>(recording: &Recording, x: &[S]) -> Vec<S> {
    let mut y = vec![S::zero(); recording.n_output()];
    recording.evaluate(x, &mut y);
    y
}

fuzz_target!(|bytes: &[u8]| {
    // how every file begins: it need not be found
    let empty = Recording::as_written(0, |_| Vec::new()).to_bytes().unwrap();
    let file = [&empty[..8], bytes].concat();
    let limits =
        SavedLimits { n_input: 64, n_output: 64, n_node: 4_000, n_operation: 20_000, depth: 6, n_late_input: 0 };
    let Ok(recording) = Recording::from_bytes(&file, &operation, &limits) else { return };
    assert!(recording.n_operation() <= limits.n_operation);
    let saved = recording.to_bytes().unwrap();
    assert_eq!(Recording::from_bytes(&saved, &operation, &limits).unwrap(), recording);

    let n = recording.n_input();
    let x: Vec<f64> = (0..n).map(|k| f64::from(bytes[k % bytes.len()]) / 64.0 - 2.0).collect();
    let mut y = walked(&recording, &x);
    let program = Program::compile(&Recording::of(n, |x| walked(&recording, x))).unwrap();
    program.evaluate(&mut program.workspace(), &x, &mut y);
    let lanes = Program::compile(&Recording::of_lanes(n, |x| walked(&recording, x))).unwrap();
    let rows: Vec<[f32; BLOCK]> = x.iter().map(|x| [*x as f32; BLOCK]).collect();
    lanes.evaluate_block(&mut lanes.block_workspace(), &rows, &mut vec![[0.0; BLOCK]; y.len()]);
});
