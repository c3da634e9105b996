//! Bytes of stack that modules tell of, against those that gcc counts.

use super::*;
use crate::compiler::compiler;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// Bytes of frames with those of what they call, of a file that gcc compiled with `-fcallgraph-info=su`.
fn stacks(text: &str) -> BTreeMap<String, usize> {
    let field = |line: &str, name: &str| {
        let (_, rest) = line.split_once(&format!("{name}: \""))?;
        Some(rest.split_once('"')?.0.to_string())
    };
    let (mut frames, mut calls) = (BTreeMap::new(), Vec::new());
    for line in text.lines() {
        if let Some(label) = line.starts_with("node").then(|| field(line, "label")).flatten() {
            // where nothing is told the function is another file's, of libm
            let bytes = label.split("\\n").find_map(|part| part.split_once(" bytes (")?.0.parse().ok());
            frames.insert(field(line, "title").unwrap(), bytes.unwrap_or(0));
        } else if line.starts_with("edge") {
            calls.push((field(line, "sourcename").unwrap(), field(line, "targetname").unwrap()));
        }
    }
    fn deepest(name: &str, frames: &BTreeMap<String, usize>, calls: &[(String, String)]) -> usize {
        let below = calls.iter().filter(|(caller, _)| caller == name);
        let below = below.map(|(_, callee)| deepest(callee, frames, calls)).max();
        frames.get(name).copied().unwrap_or(0) + below.unwrap_or(0)
    }
    frames.keys().map(|name| (name.clone(), deepest(name, &frames, &calls))).collect()
}

/// Everything that is built in, with whether it is compiled at all levels; others are where the worst is nearly always.
fn everything(each: &mut dyn FnMut(CModule, bool)) {
    for precision in BOTH {
        for (k, task) in tasks::registry::names().into_iter().enumerate() {
            each(task_as_c(task, &tasks::EnvConfig::default(), &options(precision)).unwrap(), k % 5 == 0);
        }
        for vehicle in ["hummingbird", "firefly", "omav"] {
            let plant = Plant::of_vehicle(&vehicles::by_name(vehicle).unwrap(), Physics::default()).unwrap();
            each(plant_as_c(&plant, &options(precision)).unwrap(), true);
            for name in ["cascade", "lqr", "lqi", "indi"] {
                let own = make(name, &plant, &Setup::new(None, &Rates::default())).unwrap();
                each(controller_as_c(&*own, &plant, &options(precision)).unwrap(), vehicle != "firefly");
            }
        }
        for name in Reference::NAMES {
            each(reference_as_c(&Reference::by_name(name).unwrap(), &options(precision)).unwrap(), true);
        }
    }
    // whose environments are none that can be made
    for (k, sample) in samples().into_iter().filter(|sample| sample.name != "unlike_agents").enumerate() {
        let Sample { name, policy, spec } = sample;
        let own = ExportOptions { name: Some(format!("own_{name}")), precision: BOTH[k % 2], ..Default::default() };
        each(policy_as_c(&policy, &spec.task, &spec.config, &own).unwrap(), k % 3 == 0);
    }
}

/// A module that is being compiled at several levels.
struct Compiled {
    module: CModule,
    folder: tempfile::TempDir,
    levels: Vec<(&'static str, Child)>,
}

impl Compiled {
    fn begun(module: CModule, at_all: bool) -> Self {
        let folder = tempfile::tempdir().unwrap();
        module.write(folder.path(), true).unwrap();
        let skipped = match (at_all, module.precision) {
            (true, _) => 0,
            (false, ExportPrecision::Single) => 1,
            (false, ExportPrecision::Double) => 2,
        };
        let levels = ["-O0", "-Os", "-O2"].into_iter().skip(skipped);
        let levels = levels.map(|level| (level, Self::compile(folder.path(), &module.name, level))).collect();
        Self { module, folder, levels }
    }

    fn compile(folder: &Path, name: &str, level: &str) -> Child {
        let mut own = Command::new(compiler());
        own.current_dir(folder).args(["-std=c99", level, "-c", "-fcallgraph-info=su"]);
        if cfg!(target_arch = "x86_64") {
            // of a red zone below the frame nothing is told
            own.arg("-mno-red-zone");
        }
        own.arg(format!("{name}.c")).arg("-o").arg(format!("own{level}.o")).stdout(Stdio::null()).spawn().unwrap()
    }

    /// Of each function what is told, and the worst that was counted.
    fn told(self) -> Vec<(String, usize, usize)> {
        let mut worst: BTreeMap<String, (usize, String)> = BTreeMap::new();
        for (level, mut child) in self.levels {
            assert!(child.wait().unwrap().success(), "{} at {level}", self.module.name);
            let told = std::fs::read_to_string(self.folder.path().join(format!("own{level}.ci"))).unwrap();
            for (name, bytes) in stacks(&told) {
                let own = worst.entry(name).or_default();
                own.0 = own.0.max(bytes);
                own.1 += &format!(" {bytes} at {level}");
            }
        }
        let of = |function: &ExportedFunction| {
            let (bytes, all) = &worst[&function.name];
            let precision = self.module.precision.c_type();
            println!("{precision} {}: told {};{all}", function.name, function.stack);
            (format!("{precision} {}", function.name), function.stack, *bytes)
        };
        self.module.functions.iter().map(of).collect()
    }
}

#[test]
fn no_function_needs_more_stack_than_its_module_says() {
    let is_gcc = || {
        let output = Command::new(compiler()).arg("--version").output();
        output.is_ok_and(|output| String::from_utf8_lossy(&output.stdout).contains("Free Software Foundation"))
    };
    if !has_compiler() || !is_gcc() {
        return println!("no gcc here: left out");
    }
    let (mut all, mut before) = (Vec::new(), None::<Compiled>);
    everything(&mut |module, at_all| {
        let own = Compiled::begun(module, at_all);
        all.extend(before.replace(own).map(Compiled::told).unwrap_or_default());
    });
    all.extend(before.map(Compiled::told).unwrap_or_default());
    let more: Vec<_> = all.iter().filter(|(_, told, counted)| counted > told).collect();
    // of small ones the rest of a frame is most
    let large: Vec<_> = all.iter().filter(|(_, _, counted)| *counted > 256).collect();
    let far: Vec<_> = large.iter().filter(|(_, told, counted)| *told > 3 * counted).collect();
    println!(
        "{} functions, {} of them large, {} of those with less than a third of what is told",
        all.len(),
        large.len(),
        far.len()
    );
    assert!(more.is_empty(), "{more:?}");
    // most are not compiled without optimisation here, which takes more
    assert!(far.len() * 5 < large.len(), "{far:?}");
}
