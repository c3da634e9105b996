//! What is exported as firmware uses it: the programs of `examples/firmware`, and modules for another processor.

use super::*;
use crate::compiler::{STRICT, compile, compiler};
use controllers::{FlightPlan, fly_from};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Modules of the Hummingbird: the vehicle, controllers, a reference.
fn modules(precision: ExportPrecision) -> Vec<CModule> {
    let plant = hummingbird();
    let controllers = ["cascade", "lqr", "indi"].map(|name| {
        let own = make(name, &plant, &Setup::new(None, &Rates::default())).unwrap();
        controller_as_c(&*own, &plant, &options(precision)).unwrap()
    });
    let named = ExportOptions { name: Some("lemniscate_reference".into()), precision, ..Default::default() };
    let reference = reference_as_c(&Reference::by_name("lemniscate").unwrap(), &named).unwrap();
    let vehicle = plant_as_c(&plant, &options(precision)).unwrap();
    [vehicle].into_iter().chain(controllers).chain([reference]).collect()
}

/// Modules in a folder, where examples find them.
fn folder_of_modules(precision: ExportPrecision) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    modules(precision).iter().for_each(|module| drop(module.write(folder.path(), true).unwrap()));
    folder
}

fn examples() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/firmware").canonicalize().unwrap()
}

fn path(path: &Path) -> String {
    path.to_str().unwrap().into()
}

/// Rad/s of `START_SPEED` in `lemniscate.c`.
const START_SPEED: f64 = 453.25;

/// The state after 15 s along the lemniscate, at rest and level in the beginning.
fn flown_in_rust() -> Vec<f64> {
    let plant = hummingbird();
    let plan = FlightPlan::default();
    let mut own = make("cascade", &plant, &Setup::new(None, &plan.rates)).unwrap();
    let mut state = vec![0.0; plant.n_state()];
    state[..3].copy_from_slice(&plan.reference.sample(0.0).position);
    state[6] = 1.0;
    state[13..].fill(START_SPEED);
    let flight = fly_from(&plant, &mut *own, &plan, &state, &mut |_| ()).unwrap();
    assert_eq!(flight.diverged_at, None);
    flight.states[flight.states.len() - plant.n_state()..].to_vec()
}

/// What the program `lemniscate` says of its last state.
fn flown_in_c(precision: ExportPrecision) -> Vec<f64> {
    let folder = folder_of_modules(precision);
    let mut files = vec![path(&examples().join("lemniscate.c"))];
    files.extend(["hummingbird.c", "hummingbird_cascade.c", "lemniscate_reference.c"].map(String::from));
    let real = format!("-DREAL={}", precision.c_type());
    compile(folder.path(), &files, "lemniscate", &["-O1", "-I.", &real]).unwrap();
    let log = folder.path().join("flight.csv");
    let output = Command::new(folder.path().join("lemniscate")).arg(&log).output().unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{said}");
    println!("{precision:?}: {said}");
    let rows = std::fs::read_to_string(log).unwrap().lines().count();
    assert_eq!(rows, 7500);
    let last = said.lines().find_map(|line| line.strip_prefix("last state: ")).unwrap();
    last.split(',').map(|x| x.trim().parse().unwrap()).collect()
}

#[test]
fn a_flight_in_c_ends_in_double_with_the_bits_of_the_flight_in_rust_and_in_float_beside_it() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    let want = flown_in_rust();
    for precision in BOTH {
        let (n, worst) = apart(&[flown_in_c(precision)], std::slice::from_ref(&want));
        println!("{precision:?}: {n} of {} numbers of the last state differ, worst {worst:.1e}", want.len());
        match precision {
            ExportPrecision::Double => assert_eq!(n, 0),
            // measured: 1.9e-3 rad/s of a rotor, after 7500 ticks
            ExportPrecision::Single => assert!(worst < 0.02),
        }
    }
}

fn said_by(program: &Path) -> String {
    let output = Command::new(program).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said}");
    said
}

#[test]
fn a_mixer_in_the_shape_of_betaflight_hovers_and_keeps_height_where_it_loses_its_position() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    let (folder, own) = (folder_of_modules(ExportPrecision::Single), examples().join("betaflight"));
    let mut files = ["main.c", "omnidrones_mixer.c"].map(|file| path(&own.join(file))).to_vec();
    files.extend(["hummingbird.c", "hummingbird_cascade.c"].map(String::from));
    let include = [own.clone(), own.join("stub")].map(|folder| format!("-I{}", path(&folder)));
    compile(folder.path(), &files, "hover", &["-O1", "-I.", &include[0], &include[1]]).unwrap();
    println!("{}", said_by(&folder.path().join("hover")));
}

/// Compiles strictly what is C or C++ by its name, to objects.
fn objects(folder: &Path, command: &str, standard: &str, files: &[String], flags: &[String]) {
    let strict = STRICT.iter().filter(|flag| !flag.starts_with("-std"));
    let mut own = Command::new(command);
    own.current_dir(folder).arg(standard).args(strict).args(["-O1", "-c"]).args(flags).args(files);
    let output = own.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_module_in_the_shape_of_px4_climbs_hovers_and_follows_setpoints() {
    let has_cpp = || Command::new("c++").arg("--version").output().is_ok_and(|output| output.status.success());
    if !has_compiler() || !has_cpp() {
        return println!("no C and C++ compilers here: left out");
    }
    let (folder, own) = (folder_of_modules(ExportPrecision::Single), examples().join("px4"));
    let include = [".".into(), path(&own), path(&own.join("stub"))].map(|folder: String| format!("-I{folder}"));
    objects(folder.path(), &compiler(), "-std=c99", &["hummingbird.c", "hummingbird_cascade.c"].map(String::from), &[]);
    let files = ["main.cpp", "HummingbirdControl.cpp"].map(|file| path(&own.join(file)));
    objects(folder.path(), "c++", "-std=c++14", &files, &include);
    let names = ["main.o", "HummingbirdControl.o", "hummingbird.o", "hummingbird_cascade.o", "-o", "hover"];
    let linked = Command::new("c++").current_dir(folder.path()).args(names).output().unwrap();
    assert!(linked.status.success(), "{}", String::from_utf8_lossy(&linked.stderr));
    println!("{}", said_by(&folder.path().join("hover")));
}

/// A policy of Hover of two layers of 64 units.
fn policy() -> CModule {
    let Sample { policy, spec, .. } = named("plain");
    policy_as_c(&policy, &spec.task, &spec.config, &options(ExportPrecision::Single)).unwrap()
}

#[test]
#[ignore = "writes modules into the folder $OMNIDRONES_MODULES, for .ci/cortex-m4"]
fn modules_for_another_processor() {
    let folder = PathBuf::from(std::env::var_os("OMNIDRONES_MODULES").expect("a folder"));
    for module in modules(ExportPrecision::Single).into_iter().chain([policy()]) {
        module.write(folder.join(&module.name), true).unwrap();
        for function in &module.functions {
            println!("function {} {} {} {}", module.name, function.name, function.stack, function.n_instruction);
        }
        println!("module {} {} {}", module.name, module.memory, module.tables);
    }
}
