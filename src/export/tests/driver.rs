//! A function of a module, compiled once and called row by row.

use crate::CModule;
use crate::compiler::compile;
use autodiff::emit::ExportPrecision;
use std::io::Write;
use std::process::{Command, Stdio};

/// One function with its arrays: how many numbers each has, and whether it is written.
pub struct Driver {
    folder: tempfile::TempDir,
    double: bool,
    n_in: usize,
    n_out: usize,
}

impl Driver {
    /// `remembers`: whether its first argument is the memory, which is reset before the first row.
    pub fn new(module: &CModule, function: &str, remembers: bool, arrays: &[(usize, bool)], flags: &[&str]) -> Self {
        let (name, real) = (&module.name, module.precision.c_type());
        let mut text = format!("#include \"{name}.h\"\n#include <stdio.h>\n\nint main(void)\n{{\n");
        let mut arguments = Vec::new();
        if remembers {
            text += &format!("    {name}_memory memory;\n    {name}_reset(&memory);\n");
            arguments.push("&memory".to_string());
        }
        let (mut reads, mut writes) = (String::new(), String::new());
        for (k, (n, is_written)) in arrays.iter().enumerate() {
            text += &format!("    {real} a{k}[{n}];\n");
            arguments.push(format!("a{k}"));
            if *is_written {
                writes += &format!("        fwrite(a{k}, sizeof a{k}[0], {n}, stdout);\n");
            } else {
                reads += &format!("        if (fread(a{k}, sizeof a{k}[0], {n}, stdin) != {n}) return 0;\n");
            }
        }
        text += &format!("    for (;;) {{\n{reads}        {function}({});\n{writes}    }}\n}}\n", arguments.join(", "));
        let folder = tempfile::tempdir().unwrap();
        module.write(folder.path(), true).unwrap();
        std::fs::write(folder.path().join("driver.c"), text).unwrap();
        compile(folder.path(), &[format!("{name}.c"), "driver.c".into()], "driver", flags).unwrap();
        let sum = |written: bool| arrays.iter().filter(|(_, own)| *own == written).map(|(n, _)| n).sum();
        Self { folder, double: module.precision == ExportPrecision::Double, n_in: sum(false), n_out: sum(true) }
    }

    /// Results of calls with these rows, one after the other.
    pub fn run(&self, rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
        assert!(rows.iter().all(|row| row.len() == self.n_in), "numbers of a row");
        let bytes = |x: &f64| if self.double { x.to_le_bytes().to_vec() } else { (*x as f32).to_le_bytes().to_vec() };
        let input: Vec<u8> = rows.iter().flatten().flat_map(bytes).collect();
        let mut command = Command::new(self.folder.path().join("driver"));
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let mut stdin = child.stdin.take().unwrap();
        let output = std::thread::scope(|scope| {
            scope.spawn(move || stdin.write_all(&input).unwrap());
            child.wait_with_output().unwrap()
        });
        let numbers: Vec<f64> = if self.double {
            output.stdout.chunks_exact(8).map(|x| f64::from_le_bytes(x.try_into().unwrap())).collect()
        } else {
            output.stdout.chunks_exact(4).map(|x| f64::from(f32::from_le_bytes(x.try_into().unwrap()))).collect()
        };
        assert_eq!(numbers.len(), rows.len() * self.n_out);
        numbers.chunks_exact(self.n_out).map(<[f64]>::to_vec).collect()
    }
}
