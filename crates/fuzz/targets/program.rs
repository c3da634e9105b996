//! Any recording computes the same bits as machine code and interpreted: one number, eight side by side, 1 to 64 environments, with
//! results apart from arguments and over them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use omnidrones::autodiff::native::{Executable, Place, Row, RowLayout, Rows};
use omnidrones::autodiff::program::BLOCK;
use omnidrones::autodiff::{Mask, Program, Recording, Scalar, Trace};

const N_INPUT: usize = 4;

/// Three bytes an operation: what, and which of the numbers so far.
fn record(bytes: &[u8]) -> Recording {
    Recording::of(N_INPUT, |inputs| {
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

/// Bits, any NaN as one.
fn bits(x: f64) -> u64 {
    if x.is_nan() { f64::NAN.to_bits() } else { x.to_bits() }
}

/// Runs over `n` numbers of each row, results apart and over the arguments; `wanted` of a row says the bits that are right.
fn hold<R: Row + PartialEq>(
    program: &Program,
    inputs: &[R],
    blank: R,
    n: usize,
    wanted: &[R],
    bits: impl Fn(&R, usize) -> u64,
) {
    let (n_input, n_output) = (program.n_input(), program.n_output());
    let over = |n: usize| (0..n as u32).map(|row| Place { array: 0, row }).collect();
    for layout in [RowLayout::apart(n_input, n_output), RowLayout::new(over(n_input), over(n_output)).unwrap()] {
        let is_apart = layout.n_array() == 2;
        let executable = Executable::<R>::new(program, layout).unwrap();
        let mut results = vec![blank; n_input.max(n_output)];
        if is_apart {
            let mut arrays = [Rows::Read(inputs), Rows::Write(&mut results)];
            executable.run(&mut executable.work(), &mut arrays, n).unwrap();
        } else {
            results[..n_input].copy_from_slice(inputs);
            executable.run(&mut executable.work(), &mut [Rows::Write(&mut results)], n).unwrap();
        }
        for (k, (got, want)) in results.iter().zip(wanted).enumerate() {
            for lane in 0..n {
                let (got, want) = (bits(got, lane), bits(want, lane));
                assert_eq!(got, want, "result {k}, lane {lane} of {n}, apart: {is_apart}: {got:x}, not {want:x}");
            }
        }
    }
}

fuzz_target!(|bytes: &[u8]| {
    let Some((numbers, rest)) = bytes.split_at_checked(8 * N_INPUT) else { return };
    let Some((&count, steps)) = rest.split_first() else { return };
    let program = Program::compile(&record(steps)).unwrap();
    let m = program.n_output();
    // other lanes have other bytes of the same numbers
    let wide = |k: usize, lane: usize| f64::from_le_bytes(numbers[(8 * k + 3 * lane) % 25..][..8].try_into().unwrap());
    let narrow =
        |k: usize, lane: usize| f32::from_le_bytes(numbers[(4 * k + 5 * lane) % 29..][..4].try_into().unwrap());

    let steps: Vec<[f64; 8]> = (0..N_INPUT).map(|k| std::array::from_fn(|lane| wide(k, lane))).collect();
    let mut wanted = vec![[0.0; 8]; m];
    let (mut plain, mut interpreted) = (vec![0.0; m], vec![0.0; m]);
    for lane in 0..8 {
        let point: Vec<f64> = steps.iter().map(|row| row[lane]).collect();
        program.evaluate_over(&point, &mut plain);
        program.evaluate(&mut program.interpreter_workspace(), &point, &mut interpreted);
        for (k, (plain, interpreted)) in plain.iter().zip(&interpreted).enumerate() {
            assert_eq!(bits(*plain), bits(*interpreted), "result {k}: {interpreted:e}, not {plain:e}");
            wanted[k][lane] = *plain;
        }
    }
    hold(&program, &steps, [0.0; 8], 1 + usize::from(count) % 8, &wanted, |row, lane| bits(row[lane]));
    let point: Vec<f64> = steps.iter().map(|row| row[0]).collect();
    let first: Vec<f64> = wanted.iter().map(|row| row[0]).collect();
    hold(&program, &point, 0.0, 1, &first, |number, _| bits(*number));

    let block: Vec<[f32; BLOCK]> = (0..N_INPUT).map(|k| std::array::from_fn(|lane| narrow(k, lane))).collect();
    let mut wanted = vec![[0.0; BLOCK]; m];
    program.evaluate_block(&mut program.interpreter_block_workspace(), &block, &mut wanted);
    hold(&program, &block, [0.0; BLOCK], 1 + usize::from(count) % BLOCK, &wanted, |row, lane| bits(row[lane].into()));
});
