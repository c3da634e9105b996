//! Text against programs: compiled by the C compiler of the machine, where there is one.

use super::*;
use crate::Scalar;
use crate::emit::NamedNumber;
use crate::native::tests::{draws, number, random_form};
use crate::trace::Recording;
use crate::{Trace, program::BLOCK};
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

const STRICT: [&str; 7] =
    ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"];

fn has_compiler() -> bool {
    let found = Command::new("cc").arg("--version").output().is_ok();
    if !found {
        println!("no C compiler here: left out");
    }
    found
}

/// Compiles text with a main program that reads and writes numbers as bytes.
fn compiled(folder: &Path, text: &str, flags: &[&str]) -> std::path::PathBuf {
    let (source, binary) = (folder.join("own.c"), folder.join("own"));
    std::fs::write(&source, text).unwrap();
    let output = Command::new("cc").args(STRICT).args(flags).arg("-o").arg(&binary).arg(&source).arg("-lm").output();
    let output = output.unwrap();
    assert!(output.status.success(), "{}\n{text}", String::from_utf8_lossy(&output.stderr));
    binary
}

fn run(binary: &Path, input: &[u8]) -> Vec<u8> {
    let mut child = Command::new(binary).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let input = input.to_vec();
    let feed = std::thread::Builder::new().spawn(move || stdin.write_all(&input)).unwrap();
    let output = child.wait_with_output().unwrap();
    feed.join().unwrap().unwrap();
    assert!(output.status.success());
    output.stdout
}

/// Many functions in one file, and a main program that calls number k with as many numbers as it reads, row by row.
fn program(text: CText, functions: &[(CFunction, usize, usize)]) -> String {
    let real = text.precision().c_type();
    let mut main = String::from("#include <math.h>\n#include <stdint.h>\n#include <stdio.h>\n\n");
    main += &text.finished();
    main += "\nint main(void)\n{\n";
    for (function, n_in, n_out) in functions {
        let name = &function.name;
        main += &format!(
            "    for (int row = 0; row < {ROWS}; row++) {{\n        {real} x[{}] = {{0}}, y[{}];\n        \
             if (fread(x, sizeof x[0], {n_in}, stdin) != {n_in}) return 1;\n        {name}(x, y);\n        \
             fwrite(y, sizeof y[0], {n_out}, stdout);\n    }}\n",
            n_in.max(&1),
            n_out.max(&1),
        );
    }
    main + "    return 0;\n}\n"
}

const ROWS: usize = 8;

#[test]
fn text_in_double_has_the_bits_of_the_interpreter_for_every_operation() {
    if !has_compiler() {
        return;
    }
    // in these programs and in no recording: what nobody reads, and functions of constants, which compilers compute with other digits
    let forms: Vec<Arc<ValueForm>> = (0..96).map(random_form).map(Arc::new).collect();
    let mut text = CText::new("own", ExportPrecision::Double);
    let functions: Vec<(CFunction, usize, usize)> =
        forms.iter().map(|form| (text.part(form).unwrap(), form.n_input(), form.results().len())).collect();
    let folder = tempfile::tempdir().unwrap();
    let binary = compiled(
        folder.path(),
        &program(text, &functions),
        &["-O1", "-fno-builtin", "-Wno-unused-variable", "-Wno-unused-but-set-variable"],
    );
    let mut r = draws(7);
    let (mut input, mut expected) = (Vec::new(), Vec::new());
    for form in &forms {
        let own = Program::of_form((**form).clone(), false);
        let mut work = own.interpreter_workspace();
        for _ in 0..ROWS {
            let x: Vec<f64> = (0..form.n_input()).map(|_| number(&mut r)).collect();
            let mut y = vec![0.0; form.results().len()];
            own.evaluate(&mut work, &x, &mut y);
            input.extend(x.iter().flat_map(|x| x.to_le_bytes()));
            expected.extend(y);
        }
    }
    let output = run(&binary, &input);
    let got: Vec<f64> = output.chunks_exact(8).map(|x| f64::from_le_bytes(x.try_into().unwrap())).collect();
    assert_eq!(got.len(), expected.len());
    let differs = |(a, b): &(&f64, &f64)| a.to_bits() != b.to_bits() && !(a.is_nan() && b.is_nan());
    let n = got.iter().zip(&expected).filter(differs).count();
    println!("{n} of {} results differ", got.len());
    assert_eq!(n, 0);
}

/// A row of every elementary function and of sums that fuse.
fn elementary(x: &[Trace]) -> Vec<Trace> {
    let (a, b, c) = (x[0], x[1], x[2]);
    let (sine, cosine) = a.sin_cos();
    let sums = [a * b + c, c - a * b, a * b - c, a * b + c * a, a * b - b * c];
    [sine, cosine, a.exp(), b.abs().ln(), a.tanh(), a.atan2(b), (c * c).sqrt(), a / b, b.recip()]
        .into_iter()
        .chain(sums)
        .collect()
}

#[test]
fn text_in_float_has_the_bits_of_lanes_where_the_processor_fuses() {
    if !has_compiler() {
        return;
    }
    if crate::instruction_set() == "scalar" || !cfg!(target_arch = "x86_64") {
        println!("no fused products here: left out");
        return;
    }
    let recording = Recording::of(3, elementary);
    let own = Program::compile(&recording).unwrap();
    let mut text = CText::new("own", ExportPrecision::Single);
    let form = Program::text_form(&recording).unwrap();
    let (function, n_out) = (text.part(&form).unwrap(), form.results().len());
    let folder = tempfile::tempdir().unwrap();
    let source = program(text, &[(function, 3, n_out)]).replace("row < 8", "row < 4096");
    let binary = compiled(folder.path(), &source, &["-O1", "-mfma"]);
    let mut r = draws(8);
    let (mut input, mut expected) = (Vec::new(), Vec::new());
    let mut work = own.interpreter_block_workspace();
    for _ in 0..4096 / BLOCK {
        let mut x = [[0.0_f32; BLOCK]; 3];
        x.iter_mut().flatten().for_each(|x| *x = r.uniform(-6.0, 6.0) as f32 * [1.0, 0.05, 20.0][r.below(3) as usize]);
        let mut y = vec![[0.0; BLOCK]; n_out];
        own.evaluate_block(&mut work, &x, &mut y);
        for lane in 0..BLOCK {
            input.extend(x.iter().flat_map(|x| x[lane].to_le_bytes()));
            expected.extend(y.iter().map(|y| y[lane]));
        }
    }
    let output = run(&binary, &input);
    let got: Vec<f32> = output.chunks_exact(4).map(|x| f32::from_le_bytes(x.try_into().unwrap())).collect();
    assert_eq!(got.len(), expected.len());
    let differs = |(a, b): &(&f32, &f32)| a.to_bits() != b.to_bits() && !(a.is_nan() && b.is_nan());
    let n = got.iter().zip(&expected).filter(differs).count();
    println!("{n} of {} results differ", got.len());
    assert_eq!(n, 0);
}

#[test]
fn text_in_float_survives_compilers_that_reorder_sums() {
    if !has_compiler() {
        return;
    }
    let recording = Recording::of(1, |x| {
        let (sine, cosine) = x[0].sin_cos();
        vec![sine, cosine, x[0].exp()]
    });
    let mut text = CText::new("own", ExportPrecision::Single);
    let function = text.part(&Program::text_form(&recording).unwrap()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let source = program(text, &[(function, 1, 3)]);
    let binary = compiled(folder.path(), &source, &["-O2", "-funsafe-math-optimizations"]);
    let x: Vec<f32> = (0..ROWS).map(|k| 2.3 * k as f32 - 7.9).collect();
    let output = run(&binary, &x.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>());
    let got: Vec<f32> = output.chunks_exact(4).map(|x| f32::from_le_bytes(x.try_into().unwrap())).collect();
    assert_eq!(got.len(), 3 * ROWS);
    for (x, got) in x.iter().zip(got.chunks_exact(3)) {
        let worst = [x.sin() - got[0], x.cos() - got[1], got[2] / x.exp() - 1.0].map(f32::abs);
        assert!(worst.iter().all(|far| *far < 4e-6), "{x}: {got:?}");
    }
}

#[test]
fn arrays_may_be_the_same_since_results_are_written_last() {
    let numbers = |n: usize| {
        let own = |k| super::super::NamedNumber { name: format!("x_{k}"), unit: "-".into() };
        (0..n).map(own).collect::<Vec<_>>()
    };
    let array =
        |name: &str, access| NamedArray { name: name.into(), about: String::new(), access, numbers: numbers(3) };
    let shift = NamedFunction {
        name: "shift".into(),
        about: String::new(),
        arrays: vec![array("line", Access::Update)],
        recording: Recording::of(3, |x| vec![x[2] + x[0], x[0], x[1]]),
    };
    let mut text = CText::new("own", ExportPrecision::Single);
    let own = text.function(&shift, Linkage::Static).unwrap();
    assert_eq!(own.prototype, "static void own_shift(float line[3])");
    let all = text.finished();
    let (read, written) = (all.rfind("= line[").unwrap(), all.find("line[0] =").unwrap());
    assert!(read < written, "{all}");
}

#[test]
fn a_custom_function_without_text_is_refused_by_what_it_is() {
    struct Own;
    impl crate::CustomFunction for Own {
        fn n_input(&self) -> usize {
            1
        }
        fn n_output(&self) -> usize {
            1
        }
        fn value(&self, x: &[f64], y: &mut [f64]) {
            y[0] = x[0];
        }
        fn forward(&self, _: &[f64], dx: &[f64], dy: &mut [f64]) {
            dy[0] = dx[0];
        }
        fn reverse(&self, _: &[f64], y_bar: &[f64], x_bar: &mut [f64]) {
            x_bar[0] = y_bar[0];
        }
    }
    let operation = crate::Operation::new(Own);
    let recording = Recording::of(1, |x| {
        let mut y = [Trace::zero()];
        operation.call(x, &mut y);
        y.to_vec()
    });
    let form = Program::text_form(&recording).unwrap();
    let error = CText::new("own", ExportPrecision::Single).part(&form).unwrap_err().to_string();
    assert!(error.contains("custom function of 1 numbers") && error.contains("c_function"), "{error}");
}

#[test]
fn a_floor_in_text_is_that_of_the_library() {
    if !has_compiler() {
        return;
    }
    let form = Program::text_form(&Recording::of(1, |x| vec![crate::floor(x[0])])).unwrap();
    let rows: [f64; ROWS] = [-0.5, 2.5, -2.5, 3.0, -7.0, 8388607.5, -1e20, f64::INFINITY];
    for precision in [ExportPrecision::Double, ExportPrecision::Single] {
        let mut text = CText::new("own", precision);
        let function = text.part(&form).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let binary = compiled(folder.path(), &program(text, &[(function, 1, 1)]), &[]);
        let is_double = matches!(precision, ExportPrecision::Double);
        let bytes = |x: &f64| if is_double { x.to_le_bytes().to_vec() } else { (*x as f32).to_le_bytes().to_vec() };
        let output = run(&binary, &rows.iter().flat_map(bytes).collect::<Vec<u8>>());
        let floor = |x: &f64| if is_double { x.floor() } else { f64::from((*x as f32).floor()) };
        let expected: Vec<u8> = rows.iter().flat_map(|x| bytes(&floor(x))).collect();
        assert_eq!(output, expected, "{is_double}");
    }
}

#[test]
fn arrays_with_names_are_written_when_all_is_read_on_a_device_too() {
    let recording = Recording::of(2, |z| vec![z[0] + z[1], z[0] * z[1]]);
    let number = |k: usize| NamedNumber { name: format!("n_{k}"), unit: "-".into() };
    let state = NamedArray {
        name: "s".into(),
        about: String::new(),
        access: Access::Update,
        numbers: vec![number(0), number(1)],
    };
    let of = NamedFunction { name: "f".into(), about: String::new(), arrays: vec![state], recording };
    let mut text = CText::cuda("od");
    text.function(&of, Linkage::Static).unwrap();
    let text = text.finished();
    let (product, written) = (text.find("s[0] * s[1]").unwrap(), text.find("s[0] = ").unwrap());
    assert!(product < written, "{text}");
}
