//! Golden vectors: what functions gave here, for a program that asks whether they give it there.

use super::module::MARK;
use autodiff::emit::{Access, ExportPrecision, NamedArray, NamedFunction, literal};
use autodiff::{Program, Workspace};
use base::error::Result;
use std::fmt::Write;

/// An argument of a function that is called.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GoldenArray {
    pub name: String,
    /// Numbers that are given or compared.
    pub n: usize,
    pub kind: GoldenKind,
}

/// What a call does with an argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum GoldenKind {
    Read,
    /// A number, by value.
    ReadNumber,
    /// Of so many numbers, of which the first are compared.
    Write(usize),
    /// Numbers before the call, then those behind it.
    Update,
}

impl GoldenArray {
    pub fn new(name: &str, n: usize, kind: GoldenKind) -> Self {
        Self { name: name.into(), n, kind }
    }

    /// Numbers in a row.
    fn width(&self) -> usize {
        if self.kind == GoldenKind::Update { 2 * self.n } else { self.n }
    }
}

/// A number of what a caller keeps that is set before a row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GoldenPreset {
    pub row: usize,
    /// `judge[1]`.
    pub place: String,
    pub value: f64,
}

/// Calls of one function, one after the other.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Golden {
    /// Of the function, whole.
    pub function: String,
    /// Whether its first argument is the memory.
    pub remembers: bool,
    /// Whether it says that it computed, which it must.
    pub answers: bool,
    pub arrays: Vec<GoldenArray>,
    /// Of all arrays, one behind the other.
    pub rows: Vec<Vec<f64>>,
    pub presets: Vec<GoldenPreset>,
    /// Where it is another one than that of the module, with why.
    pub tolerance: Option<(f64, &'static str)>,
}

impl Golden {
    pub fn new(function: String, remembers: bool, arrays: Vec<GoldenArray>) -> Self {
        let arrays = arrays.into_iter().filter(|array| array.n > 0).collect();
        Self { function, remembers, answers: false, arrays, rows: Vec::new(), presets: Vec::new(), tolerance: None }
    }

    /// Of the arrays of a recorded function but for what is kept.
    pub fn of_function(function: String, remembers: bool, arrays: &[&NamedArray]) -> Self {
        let own = |array: &&NamedArray| {
            let n = array.numbers.len();
            let kind = match array.access {
                Access::Read => GoldenKind::Read,
                Access::Write => GoldenKind::Write(n),
                Access::Update => GoldenKind::Update,
            };
            GoldenArray::new(&array.name, n, kind)
        };
        Self::new(function, remembers, arrays.iter().map(own).collect())
    }

    /// As a function that says whether it computed.
    pub fn answering(self) -> Self {
        Self { answers: true, ..self }
    }
}

/// A recorded function in `f64`.
pub(crate) struct Twin {
    program: Program,
    work: Workspace,
}

impl Twin {
    pub fn of(function: &NamedFunction) -> Result<Self> {
        let program = Program::compile(&function.recording)?;
        Ok(Self { work: program.workspace(), program })
    }

    pub fn call(&mut self, inputs: &[f64]) -> Vec<f64> {
        let mut outputs = vec![0.0; self.program.n_output()];
        self.program.evaluate(&mut self.work, inputs, &mut outputs);
        outputs
    }
}

/// A program that makes the calls and compares.
pub(crate) fn test_text(
    name: &str,
    precision: ExportPrecision,
    has_memory: bool,
    golden: &[Golden],
    tolerance: f64,
) -> String {
    let real = precision.c_type();
    let mut text = format!(
        "/* Golden vectors of {name}: 0 where it computes what omnidrones did. {MARK}. */\n#include \"{name}.h\"\n\n#include <math.h>\n#include <stdio.h>\n\n"
    );
    for (k, own) in golden.iter().enumerate() {
        let width: usize = own.arrays.iter().map(GoldenArray::width).sum();
        let _ = writeln!(text, "static const {real} rows_{k}[{}][{width}] = {{", own.rows.len());
        for row in &own.rows {
            assert_eq!(row.len(), width, "numbers of a row of {}", own.function);
            let numbers: Vec<String> = row.iter().map(|x| literal(*x, precision)).collect();
            let _ = writeln!(text, "    {{{}}},", numbers.join(", "));
        }
        text += "};\n\n";
    }
    let abs = if precision == ExportPrecision::Double { "x < 0.0 ? -x : x" } else { "x < 0.0f ? -x : x" };
    let zero = literal(0.0, precision);
    let _ = write!(
        text,
        "static {real} size({real} x)\n{{\n    return {abs};\n}}\n\n\
         /* the larger of `worst` and how far two rows are apart, over 1 + their size; -1 for what is no number */\n\
         static {real} farther({real} worst, const {real} *got, const {real} *want, int n)\n{{\n    \
         for (int k = 0; k < n; k++) {{\n        \
         const {real} far = size(got[k] - want[k]) / ({one} + size(want[k]));\n        \
         if (!(far >= {zero}) || worst < {zero}) return -{one};\n        \
         if (worst < far) worst = far;\n    }}\n    return worst;\n}}\n\n\
         static int told(const char *name, int calls, {real} worst, {real} most)\n{{\n    \
         const int good = worst >= {zero} && worst <= most;\n    \
         printf(\"%s: %d calls, worst difference %.2g (at most %.2g): %s\\n\", name, calls, (double)worst, (double)most,\n           \
         good ? \"good\" : \"WRONG\");\n    return good ? 0 : 1;\n}}\n\nint main(void)\n{{\n    int wrong = 0;\n",
        one = literal(1.0, precision),
    );
    if has_memory && golden.iter().any(|own| own.remembers) {
        let _ = writeln!(text, "    {name}_memory memory;");
    }
    for (k, own) in golden.iter().enumerate() {
        let n = own.rows.len();
        let _ = writeln!(text, "    {{\n        {real} worst = {zero};");
        if own.remembers {
            let _ = writeln!(text, "        {name}_reset(&memory);");
        }
        let _ = writeln!(text, "        for (int row = 0; row < {n}; row++) {{");
        for GoldenPreset { row, place, value } in &own.presets {
            let value = literal(*value, precision);
            let _ = writeln!(text, "            if (row == {row}) memory.{place} = {value};");
        }
        let mut arguments = if own.remembers { vec!["&memory".to_string()] } else { Vec::new() };
        let (mut at, mut checks) = (0, String::new());
        for array in &own.arrays {
            let GoldenArray { name, n, kind } = array;
            match kind {
                GoldenKind::Read => arguments.push(format!("rows_{k}[row] + {at}")),
                GoldenKind::ReadNumber => arguments.push(format!("rows_{k}[row][{at}]")),
                GoldenKind::Write(size) => {
                    let _ = writeln!(text, "            {real} {name}[{size}];");
                    let _ = writeln!(checks, "            worst = farther(worst, {name}, rows_{k}[row] + {at}, {n});");
                    arguments.push(name.clone());
                }
                GoldenKind::Update => {
                    let _ = writeln!(text, "            {real} {name}[{n}];");
                    let from = format!("rows_{k}[row][{at} + k]");
                    let _ = writeln!(text, "            for (int k = 0; k < {n}; k++) {name}[k] = {from};");
                    let behind = at + n;
                    let _ =
                        writeln!(checks, "            worst = farther(worst, {name}, rows_{k}[row] + {behind}, {n});");
                    arguments.push(name.clone());
                }
            }
            at += array.width();
        }
        let (function, arguments) = (&own.function, arguments.join(", "));
        let (most, why) = own.tolerance.map_or((tolerance, String::new()), |(most, why)| (most, format!(", {why}")));
        let call = if own.answers {
            format!("if (!{function}({arguments})) worst = -{};", literal(1.0, precision))
        } else {
            format!("{function}({arguments});")
        };
        let _ = write!(
            text,
            "            {call}\n{checks}        }}\n        wrong |= told(\"{function}{why}\", {n}, worst, {most});\n    }}\n",
            most = literal(most, precision),
        );
    }
    text + "    return wrong;\n}\n"
}
