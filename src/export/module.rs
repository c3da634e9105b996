//! A C module: header, source, test with golden vectors, description.

use super::golden::{Golden, test_text};
use super::identifier::{self, of_macro};
use super::words::{comment, plain};
use autodiff::emit::{
    Access, CFunction, CText, ExportPrecision, Linkage, NamedArray, NamedFunction, NamedNumber, literal,
};
use base::error::{Error, Result};
use dynamics::Plant;
use sha2::{Digest, Sha256};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// What a module is made with.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportOptions {
    /// What its files and functions are called; by default after what is exported.
    pub name: Option<String>,
    /// Its numbers. Default: `float`.
    pub precision: ExportPrecision,
    /// What it was made from, for whoever finds the files: a command, a run. It stands in header and page.
    pub origin: Option<String>,
}

impl Default for ExportOptions {
    fn default() -> Self {
        Self { name: None, precision: ExportPrecision::Single, origin: None }
    }
}

/// A function that callers see.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExportedFunction {
    /// `hover_step`.
    pub name: String,
    /// As the header declares it.
    pub prototype: String,
    /// What it computes.
    pub about: String,
    /// Bytes of stack at most, counted from above: held against gcc 12 for x86-64 over all that is built in, at `-O2`, in `float` at `-Os`
    /// too, and a part of it at `-O0`. What libm needs is not in it. Other compilers and levels may take more: `-fstack-usage` tells.
    pub stack: usize,
    /// Operations of one call; a loop that ends early counts once.
    pub n_instruction: usize,
    /// Operations of one call at most.
    pub n_most: usize,
}

/// Something as C99: four files of text.
#[derive(Debug, Clone, PartialEq)]
pub struct CModule {
    /// What files and functions begin with.
    pub name: String,
    /// What it is, in a line.
    pub title: String,
    /// Of its numbers.
    pub precision: ExportPrecision,
    /// What callers see.
    pub functions: Vec<ExportedFunction>,
    /// Bytes that a caller keeps from call to call; 0 where nothing is.
    pub memory: usize,
    /// Bytes of constant tables.
    pub tables: usize,
    /// Names of the files, and their text.
    pub files: Vec<(String, String)>,
}

impl CModule {
    /// The text of the file that ends so.
    ///
    /// # Panics
    /// For an ending that no file has: `.h`, `.c`, `_test.c`, `.md` there are.
    pub fn file(&self, ending: &str) -> &str {
        let found = self.files.iter().find(|(name, _)| *name == format!("{}{ending}", self.name));
        found.map(|(_, text)| text.as_str()).expect("an ending of a file of the module")
    }

    /// Writes its files into a folder, which is made where it is missing, and replaces an earlier export of the same thing. Files of
    /// others and of other modules are left, unless `force`.
    ///
    /// # Errors
    /// [`Error::Value`] where another file has such a name: nothing is written then; [`Error::File`] where the disk refuses.
    pub fn write(&self, folder: impl AsRef<Path>, force: bool) -> Result<Vec<PathBuf>> {
        let folder = folder.as_ref();
        std::fs::create_dir_all(folder).map_err(|error| Error::file(folder, error))?;
        let places: Vec<PathBuf> = self.files.iter().map(|(name, _)| folder.join(name)).collect();
        let is_of_others =
            |place: &&PathBuf| place.exists() && !std::fs::read_to_string(place).is_ok_and(|text| text.contains(MARK));
        if let Some(place) = places.iter().find(is_of_others).filter(|_| !force) {
            let value = format!("'{}', which omnidrones did not write", place.display());
            return Err(Error::value(
                "file to write",
                value,
                "a new one",
                "Force it, or choose another folder or name.",
            ));
        }
        let title = |text: &str| text.lines().next().map(|line| line.trim_start_matches("/* ").to_string());
        let there = std::fs::read_to_string(folder.join(format!("{}.h", self.name))).ok().as_deref().and_then(title);
        if let Some(other) = there.filter(|there| Some(there) != title(self.file(".h")).as_ref() && !force) {
            let value = format!("in '{}' already that of {other}", folder.display());
            let remedy = "Give this one another name, or force it.";
            return Err(Error::value(format!("module '{}'", self.name), value, "new, or of the same thing", remedy));
        }
        for (place, (_, text)) in places.iter().zip(&self.files) {
            base::file_gate::replace(place, text.as_bytes())?;
        }
        Ok(places)
    }
}

/// What stands in every file that is exported.
pub(crate) const MARK: &str = "Made by omnidrones";

/// A number of a module's macros.
struct Macro {
    name: String,
    value: String,
    comment: String,
}

/// A field of the memory that a caller keeps.
pub(crate) struct MemoryField {
    pub name: String,
    pub about: String,
    /// In the beginning.
    pub initial: Vec<f64>,
}

/// What a call costs: bytes of stack, operations, operations at most.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cost {
    pub stack: usize,
    pub n_instruction: usize,
    pub n_most: usize,
}

impl Cost {
    /// Of a few assignments.
    pub const LITTLE: Self = Self { stack: 64, n_instruction: 16, n_most: 16 };

    /// Of a function that calls these, one after the other, with so many bytes of its own.
    pub fn calling(own: usize, functions: &[&CFunction]) -> Self {
        let sum = |of: fn(&CFunction) -> usize| functions.iter().map(|function| of(function)).sum();
        Self {
            // a compiler that puts them into the caller may keep the place of one while another works
            stack: own + 64 + sum(|function| function.stack),
            n_instruction: sum(|function| function.n_instruction),
            n_most: sum(|function| function.n_most),
        }
    }
}

/// Bytes of an argument: where it is kept without optimisation, and where it is passed in memory.
const POINTER: usize = 16;

/// A module that is being made.
pub(crate) struct ModuleBuilder {
    pub text: CText,
    pub title: String,
    /// Paragraphs of the header's comment.
    pub about: Vec<String>,
    macros: Vec<Macro>,
    arrays: Vec<NamedArray>,
    memory: Vec<MemoryField>,
    /// Whether it counts calls.
    counts: bool,
    has_finite: bool,
    functions: Vec<ExportedFunction>,
    golden: Vec<Golden>,
    tables: usize,
    origin: Option<String>,
    /// A table of rotors.
    rotors: String,
    /// A program that uses it, behind its includes.
    pub example: String,
    /// Of golden vectors.
    pub tolerance: f64,
}

/// The frames of all numbers.
pub(crate) const FRAMES: &str = "World: z up, right-handed; body: x forward, y left, z up. \
    Attitudes are Hamilton quaternions w, x, y, z from body to world. SI units, radians. \
    Actions of rotors lie in [-1, 1]: (action + 1)/2 is the share of the rotor's largest thrust, the square of that of its speed.";

impl ModuleBuilder {
    pub fn new(default_name: &str, title: impl Into<String>, options: &ExportOptions) -> Result<Self> {
        let name = options.name.clone().unwrap_or_else(|| identifier::of_module(default_name));
        identifier::checked(&name)?;
        Ok(Self {
            text: CText::new(name, options.precision),
            title: plain(&title.into()),
            about: Vec::new(),
            macros: Vec::new(),
            arrays: Vec::new(),
            memory: Vec::new(),
            counts: false,
            has_finite: false,
            functions: Vec::new(),
            golden: Vec::new(),
            tables: 0,
            origin: options.origin.clone(),
            rotors: String::new(),
            example: String::new(),
            tolerance: if options.precision == ExportPrecision::Double { 1e-9 } else { 2e-5 },
        })
    }

    pub fn name(&self) -> &str {
        self.text.prefix()
    }

    pub fn real(&self) -> &'static str {
        self.text.precision().c_type()
    }

    pub fn number(&self, x: f64) -> String {
        literal(x, self.text.precision())
    }

    /// A number in the header.
    pub fn define(&mut self, name: &str, value: impl Into<String>, comment: &str) {
        let name = format!("{}_{}", of_macro(self.name()), of_macro(name));
        self.macros.push(Macro { name, value: value.into(), comment: comment.into() });
    }

    /// Sizes and indices of an array in the header, once.
    pub fn describe(&mut self, array: &NamedArray) {
        if !self.arrays.iter().any(|own| own.name == array.name) {
            self.arrays.push(array.clone());
        }
    }

    /// What a caller keeps: a struct with `reset`. With `counts`, calls are counted too.
    pub fn keep(&mut self, fields: Vec<MemoryField>, counts: bool) {
        self.memory.extend(fields.into_iter().filter(|field| !field.initial.is_empty()));
        self.counts |= counts;
    }

    pub fn has_memory(&self) -> bool {
        self.counts || !self.memory.is_empty()
    }

    /// A recorded function that callers see.
    pub fn public(&mut self, function: &NamedFunction) -> Result<()> {
        function.arrays.iter().for_each(|array| self.describe(array));
        let CFunction { name, prototype, stack, n_instruction, n_most } =
            self.text.function(function, Linkage::Public)?;
        let about = function.about.clone();
        self.functions.push(ExportedFunction { name, prototype, about, stack, n_instruction, n_most });
        Ok(())
    }

    /// A recorded function that callers see, whose array `memory`, if it has one, is a field of what they keep.
    ///
    /// `first` are statements before it.
    pub fn remembering(&mut self, function: &NamedFunction, name: &str, first: &str) -> Result<()> {
        let mut own = function.clone();
        if first.is_empty() && function.arrays.iter().all(|array| array.access != Access::Update) {
            own.name = name.into();
            return self.public(&own);
        }
        let inner = self.inner_remembering(function, name)?;
        let real = self.real();
        let mut parameters = vec![format!("{}_memory *memory", self.name())];
        let mut arguments = Vec::new();
        for array in function.arrays.iter().filter(|array| !array.numbers.is_empty()) {
            if array.access == Access::Update {
                arguments.push(format!("memory->{name}"));
                continue;
            }
            self.describe(array);
            let constant = if array.access == Access::Read { "const " } else { "" };
            parameters.push(format!("{constant}{real} {}[{}]", array.name, array.numbers.len()));
            arguments.push(array.name.clone());
        }
        let body = format!("{first}    {}({});\n", inner.name, arguments.join(", "));
        self.composed(name, &function.about, &parameters.join(", "), &body, Cost::calling(0, &[&inner]));
        Ok(())
    }

    /// A recorded function that the module's own call, whose array `memory`, if it has one, is a field of what a caller keeps.
    pub fn inner_remembering(&mut self, function: &NamedFunction, name: &str) -> Result<CFunction> {
        let mut own = function.clone();
        own.name = format!("{name}_of");
        if let Some(memory) = function.arrays.iter().find(|array| array.access == Access::Update) {
            let names: Vec<&str> = memory.numbers.iter().map(|own| own.name.as_str()).collect();
            let about = match names[..] {
                [first, .., last] if names.len() > 8 => format!("{first} to {last}"),
                _ => names.join(", "),
            };
            self.keep(vec![MemoryField { name: name.into(), about, initial: vec![0.0; memory.numbers.len()] }], false);
        }
        self.inner(&own)
    }

    /// Whether a function of callers takes what they keep.
    pub fn takes_memory(&self, short: &str) -> bool {
        let name = format!("{}_{short}", self.name());
        self.functions.iter().any(|own| own.name == name && own.prototype.contains("_memory *memory"))
    }

    /// A condition behind others: that the attitude of a state that begins with a body's motion is near a unit quaternion.
    pub fn is_turned(&self, state: &str) -> String {
        let square = (6..10).map(|k| format!("{state}[{k}] * {state}[{k}]")).collect::<Vec<_>>().join(" + ");
        format!(" && {square} > {}", self.number(0.5))
    }

    /// Where rotors sit, and what an action makes of them.
    pub fn describe_rotors(&mut self, plant: &Plant) {
        let (rotors, places) = (plant.rotors(), plant.rotor_places());
        if rotors.is_empty() {
            return;
        }
        let mut text = "| action | rotor | x, y, z [m] | thrust along | turns, seen from above | at 1 [rad/s] | thrust at 1 [N] | lag up, down [ms] |\n\
            |---|---|---|---|---|---|---|---|\n"
            .to_string();
        for (rotor, place) in rotors.iter().zip(&places) {
            let three = |v: [f64; 3]| v.map(|x| format!("{}", (x * 1e4).round() / 1e4 + 0.0)).join(", ");
            let turns = if rotor.spin * rotor.axis[2].signum() > 0.0 { "counter-clockwise" } else { "clockwise" };
            let most = rotor.thrust_coefficient * rotor.max_speed * rotor.max_speed;
            let [up, down] = [rotor.time_constant_up, rotor.time_constant_down].map(|t| format!("{:.2}", 1e3 * t));
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {turns} | {:.1} | {most:.3} | {up}, {down} |",
                place.action,
                plain(&rotor.name),
                three(rotor.position),
                three(rotor.axis),
                place.max_speed,
            );
        }
        self.rotors = text;
    }

    /// Asks for `NAME_all_finite`, once.
    pub fn need_finite(&mut self) {
        if std::mem::replace(&mut self.has_finite, true) {
            return;
        }
        let (name, real, zero) = (self.name().to_string(), self.real(), self.number(0.0));
        self.text.add(&format!(
            "static int {name}_all_finite(const {real} *x, int n)\n{{\n    for (int k = 0; k < n; k++) {{\n        \
             if (!(x[k] - x[k] >= {zero})) return 0;\n    }}\n    return 1;\n}}\n"
        ));
    }

    /// A recorded function that the module's own call.
    pub fn inner(&mut self, function: &NamedFunction) -> Result<CFunction> {
        self.text.function(function, Linkage::Static)
    }

    /// A function of text: its parameters, and statements.
    pub fn composed(&mut self, name: &str, about: &str, parameters: &str, body: &str, cost: Cost) {
        self.composed_of("void", name, about, parameters, body, cost);
    }

    /// The same with a result.
    pub fn composed_of(&mut self, result: &str, name: &str, about: &str, parameters: &str, body: &str, cost: Cost) {
        let name = format!("{}_{name}", self.name());
        let prototype = format!("{result} {name}({parameters})");
        self.text.add(&format!("{prototype}\n{{\n{body}}}\n"));
        let Cost { stack, n_instruction, n_most } = cost;
        let stack = stack + POINTER * parameters.split(", ").count();
        self.functions.push(ExportedFunction { name, prototype, about: about.into(), stack, n_instruction, n_most });
    }

    pub fn golden(&mut self, golden: Golden) {
        self.golden.push(golden);
    }

    pub fn add_tables(&mut self, bytes: usize) {
        self.tables += bytes;
    }

    /// The module.
    pub fn finished(mut self) -> CModule {
        if self.has_memory() {
            self.add_reset();
        }
        let (name, precision, memory) = (self.name().to_string(), self.text.precision(), self.memory_bytes());
        let (header, readme) = (self.header(), self.readme());
        let test = test_text(&name, precision, self.has_memory(), &self.golden, self.tolerance);
        let source =
            format!("/* {}. {MARK}. */\n{}", self.title, SOURCE_HEAD.replace("NAME", &name)) + &self.text.finished();
        let hash: String = Sha256::digest(source.as_bytes()).iter().take(8).map(|byte| format!("{byte:02x}")).collect();
        let header = header.replace("HASH", &hash);
        let files = vec![
            (format!("{name}.h"), header),
            (format!("{name}.c"), source),
            (format!("{name}_test.c"), test),
            (format!("{name}.md"), readme.replace("HASH", &hash)),
        ];
        CModule { name, title: self.title, precision, functions: self.functions, memory, tables: self.tables, files }
    }

    fn memory_bytes(&self) -> usize {
        let numbers: usize = self.memory.iter().map(|field| field.initial.len()).sum();
        // a count, and what brings the whole to a multiple of a number
        numbers * self.text.precision().bytes() + if self.counts { self.text.precision().bytes() } else { 0 }
    }

    fn add_reset(&mut self) {
        let mut body = String::new();
        for field in &self.memory {
            // no compiler calls memset for what is volatile
            let (n, name) = (field.initial.len(), &field.name);
            let _ = writeln!(body, "    volatile {} *{name} = memory->{name};", self.real());
            if field.initial.iter().all(|x| *x == field.initial[0]) {
                let value = self.number(field.initial[0]);
                let _ = writeln!(body, "    for (int k = 0; k < {n}; k++) {name}[k] = {value};");
            } else {
                for (k, x) in field.initial.iter().enumerate() {
                    let _ = writeln!(body, "    {name}[{k}] = {};", self.number(*x));
                }
            }
        }
        if self.counts {
            body += "    memory->tick = 0;\n";
        }
        let name = self.name().to_string();
        self.composed(
            "reset",
            "Forgets what was integrated, filtered and remembered: the next call is the first. To be called where the vehicle is armed.",
            &format!("{name}_memory *memory"),
            &body,
            Cost::LITTLE,
        );
        self.functions.rotate_right(1);
    }

    fn memory_struct(&self) -> String {
        let mut text = "/* what is kept from call to call: one for each vehicle */\ntypedef struct {\n".to_string();
        for MemoryField { name, about, initial } in &self.memory {
            let mut words = String::new();
            comment(&mut words, about);
            let words = words.trim_end().replacen(" *", "/*", 1).replace("\n *", "\n       ");
            let _ = writeln!(text, "    {words} */\n    {} {name}[{}];", self.real(), initial.len());
        }
        if self.counts {
            text += "    uint32_t tick; /* calls so far */\n";
        }
        text + &format!("}} {}_memory;\n\n", self.name())
    }

    fn header(&self) -> String {
        let guard = format!("{}_H", of_macro(self.name()));
        let mut text = format!("/* {}\n *\n", self.title);
        let origin = self.origin.as_ref().map(|origin| format!("Made from: {origin}"));
        for paragraph in self.about.iter().chain(&origin).map(String::as_str).chain([FRAMES]) {
            comment(&mut text, paragraph);
            text += " *\n";
        }
        let _ = write!(
            text,
            " * {MARK} {}: change what it was made from, not this file. Hash of the source: HASH. */\n\
             #ifndef {guard}\n#define {guard}\n\n#include <stdint.h>\n\n",
            env!("CARGO_PKG_VERSION"),
        );
        for Macro { name, value, comment } in &self.macros {
            let _ = writeln!(text, "#define {name} {value} /* {} */", plain(comment));
        }
        for array in &self.arrays {
            text += &self.array_macros(array);
        }
        text += "\n#ifdef __cplusplus\nextern \"C\" {\n#endif\n\n";
        if self.has_memory() {
            text += &self.memory_struct();
        }
        for function in &self.functions {
            let about = format!("{} Stack: at most {} bytes.", function.about, function.stack);
            text += "/*";
            let mut lines = String::new();
            comment(&mut lines, &about);
            text += lines.trim_start_matches(" *").trim_end();
            let _ = write!(text, " */\n{};\n\n", function.prototype);
        }
        text + "#ifdef __cplusplus\n}\n#endif\n\n#endif\n"
    }

    /// The size of an array, and the index of each number.
    fn array_macros(&self, array: &NamedArray) -> String {
        let own = format!("{}_{}", of_macro(self.name()), of_macro(&array.name));
        let (about, n) = (plain(&array.about), array.numbers.len());
        let mut text = format!("\n/* {about} */\n#define {own}_SIZE {n}\n");
        let mut taken = vec!["SIZE".to_string()];
        for (k, number) in array.numbers.iter().enumerate() {
            // what differs here may be the same there
            let name = of_macro(&number.name);
            let mut tries = (2..).map(|copy| format!("{name}_{copy}"));
            let name =
                [name.clone()].into_iter().chain(&mut tries).find(|name| !taken.contains(name)).unwrap_or_default();
            let _ = writeln!(text, "#define {own}_{name} {k} /* {} */", plain(&with_frame(array, number)));
            taken.push(name);
        }
        text
    }

    fn readme(&self) -> String {
        let (name, real) = (self.name(), self.real());
        let mut text = format!("# {name}: {}\n\n", self.title);
        let origin = self.origin.as_ref().map(|origin| format!("Made from: {}", plain(origin)));
        for paragraph in self.about.iter().chain(&origin).map(String::as_str).chain([FRAMES]) {
            let _ = writeln!(text, "{paragraph}\n");
        }
        let _ = write!(
            text,
            "C99, numbers are `{real}`. No heap, no globals that change, no recursion; of libraries it needs some of libm.\n\n\
             | function | stack, at most | operations | at most |\n|---|---|---|---|\n"
        );
        for function in &self.functions {
            let _ = writeln!(
                text,
                "| `{}` | {} bytes | {} | {} |",
                function.prototype, function.stack, function.n_instruction, function.n_most
            );
        }
        let _ = write!(
            text,
            "\nThe stack is counted from above: functions like these were held against it with gcc 12 for x86-64 at `-O0`, `-Os` and \
             `-O2`. What libm's functions need is not in it, nor what interrupts need. Other compilers and levels may take more: \
             ask yours, `-fstack-usage` of gcc and clang says how much. Operations count both sides of a choice."
        );
        if self.has_memory() {
            let _ = write!(text, " A caller keeps {} bytes (`{name}_memory`).", self.memory_bytes());
        }
        if self.tables > 0 {
            let _ = write!(text, " Tables: {} bytes of constants.", self.tables);
        }
        if !self.rotors.is_empty() {
            let _ = write!(
                text,
                "\n\n## Rotors\n\n{}\nBody: x forward, y left, z up, from the origin of the state. Under an action a in [-1, 1] a rotor \
                 turns at sqrt((a + 1)/2) of what it does at 1. `{name}_rotors` has these lags: where your motors have others, measure.",
                self.rotors
            );
        }
        if !self.example.is_empty() {
            let _ = write!(text, "\n\n## Use\n\n```c\n#include \"{name}.h\"\n\n{}```", self.example);
        }
        let _ = write!(
            text,
            "\n\n## Test\n\n```sh\ncc -std=c99 -O2 {name}.c {name}_test.c -lm -o {name}_test && ./{name}_test\n```\n\n\
             It calls the functions with {} rows of numbers that were computed by omnidrones, says by how much they differ at \
             most, and ends with 1 where that is too much.\n\n{}Do not compile it with `-ffast-math`. Products are fused into sums \
             where the text says so: leave `-ffp-contract=off`, which `-std=c99` sets.\n\n{MARK}. Hash of the source: HASH\n",
            self.golden.iter().map(|golden| golden.rows.len()).sum::<usize>(),
            if self.text.precision() == ExportPrecision::Single { ON_CORTEX_M4 } else { "" },
        );
        text
    }
}

const ON_CORTEX_M4: &str = "\
On a Cortex-M4F: `-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard -Os -fno-math-errno`. Nothing is computed in double or in \
software, products fuse (`vfma`), roots are `vsqrt`; without `-fno-math-errno` gcc calls `sqrtf` for negative numbers, and compilers \
that have neither `__builtin_elementwise_fma` nor GNU's builtins may call `fmaf`: in software that takes sixty times as long.\n\n";

const SOURCE_HEAD: &str = "\
#include \"NAME.h\"

#include <math.h>
#include <stdint.h>

#if defined(__FAST_MATH__) || defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__)
#error \"compile NAME.c without -ffast-math and its parts: it rounds on purpose\"
#endif
#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0
#error \"compile NAME.c without -ffinite-math-only: it looks for what is no number\"
#endif
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

";

/// The unit of a number, with its frame where it is one of the motion of a body.
fn with_frame(array: &NamedArray, number: &NamedNumber) -> String {
    let unit = &number.unit;
    if !["state", "next", "seen"].contains(&array.name.as_str()) {
        return unit.clone();
    }
    let last = number.name.rsplit('.').next().unwrap_or_default();
    match last.trim_end_matches(['w', 'x', 'y', 'z']) {
        "position_" | "velocity_" => format!("{unit}, world"),
        "angular_velocity_" => format!("{unit}, body"),
        "attitude_" => format!("{unit}, body -> world"),
        _ => unit.clone(),
    }
}

/// An array of so many numbers with names and units.
pub(crate) fn array<'a>(
    name: &str,
    about: &str,
    access: Access,
    numbers: impl Iterator<Item = (&'a str, &'a str)>,
) -> NamedArray {
    let number = |(name, unit): (&str, &str)| autodiff::emit::NamedNumber { name: name.into(), unit: unit.into() };
    NamedArray { name: name.into(), about: about.into(), access, numbers: numbers.map(number).collect() }
}
