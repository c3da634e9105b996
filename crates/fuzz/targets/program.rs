//! Any recording computes the same bits as machine code and as a plain walk over its values.
#![no_main]

use libfuzzer_sys::fuzz_target;
use omnidrones::autodiff::{Mask, Program, Recording, Scalar, Trace};

/// Three bytes an operation: what, and which of the numbers so far.
fn record(bytes: &[u8]) -> Recording {
    Recording::of(4, |inputs| {
        let mut numbers = inputs.to_vec();
        for step in bytes.chunks_exact(3) {
            let pick = |byte: u8| numbers[numbers.len() - 1 - usize::from(byte) % numbers.len()];
            let (a, b) = (pick(step[1]), pick(step[2]));
            numbers.push(match step[0] % 16 {
                0 => a + b,
                1 => a - b,
                2 | 3 => a * b,
                4 => a / b,
                5 => -a,
                6 => a.sqrt(),
                7 => a.sin_cos().0,
                8 => a.sin_cos().1,
                9 => a.exp(),
                10 => a.ln(),
                11 => a.tanh(),
                12 => a.atan2(b),
                13 => Trace::select(a.lt(b), a, b),
                14 => Trace::select(a.lt(b).not(), a, Trace::constant(f64::from(step[2]) - 100.0)),
                _ => a.mul_add(b, pick(step[0] / 16)),
            });
        }
        let first = numbers.len().saturating_sub(8);
        numbers[first..].to_vec()
    })
}

fuzz_target!(|bytes: &[u8]| {
    let Some((numbers, steps)) = bytes.split_at_checked(32) else { return };
    let inputs: Vec<f64> = numbers.chunks_exact(8).map(|number| f64::from_le_bytes(number.try_into().unwrap())).collect();
    let program = Program::compile(&record(steps)).unwrap();
    let (mut got, mut want) = (vec![0.0; program.n_output()], vec![0.0; program.n_output()]);
    program.evaluate(&mut program.workspace(), &inputs, &mut got);
    program.evaluate_over(&inputs, &mut want);
    for (got, want) in got.iter().zip(&want) {
        assert!(got.to_bits() == want.to_bits() || got.is_nan() && want.is_nan(), "{got:e}, not {want:e}");
    }
});
