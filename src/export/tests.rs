//! Modules that are compiled and test themselves.

mod driver;
mod firmware;
mod stacks;

use self::driver::Driver;
use super::compiler::{checked, has_compiler};
use super::episode::Remembering;
use super::plant::{disturb, start};
use super::policy::Networks;
use super::sample_policies::{Sample, named, samples};
use super::*;
use autodiff::System;
use controllers::cascade::Rates;
use controllers::registry::{REGISTRY, Setup, controller as make};
use controllers::{Controller, Measurement, Reference, Target, start_on};
use dynamics::{Physics, Plant, configurations, vehicles};

const BOTH: [ExportPrecision; 2] = [ExportPrecision::Single, ExportPrecision::Double];

fn options(precision: ExportPrecision) -> ExportOptions {
    ExportOptions { precision, ..ExportOptions::default() }
}

fn hummingbird() -> Plant {
    Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), Physics::default()).unwrap()
}

fn good(module: &CModule, flags: &[&str]) {
    for function in &module.functions {
        println!("{}: stack {} bytes, {} operations", function.name, function.stack, function.n_instruction);
    }
    println!("source: {} bytes of text", module.file(".c").len());
    println!("{}", checked(module, flags).unwrap());
}

#[test]
fn a_vehicles_step_tests_itself() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    for precision in BOTH {
        good(&plant_as_c(&hummingbird(), &options(precision)).unwrap(), &["-O1"]);
    }
}

#[test]
fn controllers_of_one_vehicle_test_themselves() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    let plant = hummingbird();
    for name in ["cascade", "lqr", "lqi", "indi"] {
        let own = make(name, &plant, &Setup::new(None, &Rates::default())).unwrap();
        for precision in BOTH {
            good(&controller_as_c(&*own, &plant, &options(precision)).unwrap(), &["-O1"]);
        }
    }
}

#[test]
fn allocations_in_float_test_themselves_on_every_vehicle_they_fly() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    for vehicle in vehicles::all() {
        let plant = Plant::of_vehicle(&vehicle, Physics::default()).unwrap();
        let Ok(own) = make("indi", &plant, &Setup::new(None, &Rates::default())) else { continue };
        let Ok(module) = controller_as_c(&*own, &plant, &options(ExportPrecision::Single)) else { continue };
        let said = checked(&module, &["-O0"]).unwrap_or_else(|error| panic!("{}: {error}", vehicle.name));
        let groups = said.lines().filter(|line| line.contains("_tick")).count();
        println!(
            "{}: {}",
            vehicle.name,
            said.lines().filter(|line| line.contains("_tick")).collect::<Vec<_>>().join("; ")
        );
        // where several ways make a wrench, one flight has no rotor at a limit
        assert_eq!(groups, if plant.rotor_places().len() > 4 { 2 } else { 1 }, "{said}");
    }
}

#[test]
fn a_module_of_another_thing_is_left_and_one_of_the_same_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let single = options(ExportPrecision::Single);
    let hover = reference_as_c(&controllers::Reference::by_name("hover").unwrap(), &single).unwrap();
    let task = task_as_c("Hover", &tasks::EnvConfig::default(), &single).unwrap();
    hover.write(folder.path(), false).unwrap();
    hover.write(folder.path(), false).unwrap();
    let said = task.write(folder.path(), false).unwrap_err().to_string();
    assert!(said.contains("the reference 'hover'") && said.contains("another name"), "{said}");
    assert_eq!(std::fs::read_to_string(folder.path().join("hover.h")).unwrap(), hover.file(".h"));
    task.write(folder.path(), true).unwrap();
    assert_eq!(std::fs::read_to_string(folder.path().join("hover.h")).unwrap(), task.file(".h"));
}

#[test]
fn pages_tell_of_rotors_rhythm_and_origin() {
    let plant = hummingbird();
    let own = make("cascade", &plant, &Setup::new(None, &Rates::default())).unwrap();
    let origin = Some("a test".to_string());
    let module = controller_as_c(&*own, &plant, &ExportOptions { origin, ..options(ExportPrecision::Single) }).unwrap();
    for file in [".h", ".md"] {
        let text = module.file(file).replace("\n * ", " ");
        assert!(text.contains("Made from: a test") && text.contains("levels compute at 100, 250, 500 Hz"), "{text}");
    }
    let page = module.file(".md");
    for rotor in plant.rotors() {
        let lags = format!("{:.2}, {:.2}", 1e3 * rotor.time_constant_up, 1e3 * rotor.time_constant_down);
        let line = page.lines().find(|line| line.contains(&format!("| {} |", rotor.name))).unwrap();
        assert!(line.contains(&lags), "{line}");
        // seen from above the hummingbird's axes point up
        assert_eq!(line.contains("| counter-clockwise |"), rotor.spin > 0.0, "{line}");
    }
}

#[test]
fn references_test_themselves() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    for name in controllers::Reference::NAMES {
        let reference = controllers::Reference::by_name(name).unwrap();
        for precision in BOTH {
            good(&reference_as_c(&reference, &options(precision)).unwrap(), &["-O1"]);
        }
    }
}

/// States that a controller meets in ten thousand ticks of a lemniscate, measured with noise, and what it commands.
struct Flown {
    rows: Vec<Vec<f64>>,
    commands: Vec<Vec<f64>>,
}

fn flown(plant: &Plant, own: &mut dyn Controller, steps: usize) -> Flown {
    let law = own.recorded(plant).unwrap().unwrap();
    let reference = Reference::by_name("lemniscate").unwrap();
    let mut x = start_on(plant, &*own, &reference).unwrap();
    let (mut next, mut target) = (x.clone(), vec![0.0; controllers::ControlLaw::n_target(&law)]);
    let mut flown = Flown { rows: Vec::new(), commands: Vec::new() };
    own.reset();
    for tick in 0..steps {
        let time = tick as f64 * plant.physics().dt;
        let mut seen = x.clone();
        disturb(&mut seen, plant, tick);
        controllers::ControlLaw::write_target(&law, Target::level(&reference), time, &mut target);
        let mut commands = vec![0.0; plant.n_input()];
        own.tick(Measurement { time, state: &seen, readings: &[] }, Target::level(&reference), &mut commands);
        flown.rows.push([&seen[..], &target].concat());
        plant.step(&x, &commands, &[], &mut next);
        flown.commands.push(commands);
        std::mem::swap(&mut x, &mut next);
    }
    assert!(x.iter().all(|x| x.is_finite() && x.abs() < 2e3), "it flies: {x:?}");
    flown
}

/// Results that differ, and by how much at most.
fn apart(got: &[Vec<f64>], want: &[Vec<f64>]) -> (usize, f64) {
    let pairs = got.iter().flatten().zip(want.iter().flatten());
    pairs.fold((0, 0.0), |(n, worst), (a, b)| (n + usize::from(a != b), f64::max(worst, (a - b).abs())))
}

#[test]
fn ten_thousand_ticks_in_c_are_those_that_flew_to_the_bit_in_double_and_to_rounding_in_float() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    let plant = hummingbird();
    let rates = Rates { rate: 500.0, attitude: 250.0, velocity: 50.0 };
    for name in ["cascade", "lqr", "lqi", "indi"] {
        let mut own = make(name, &plant, &Setup::new(None, &rates)).unwrap();
        let Flown { rows, commands } = flown(&plant, &mut *own, 10_000);
        for precision in BOTH {
            let module = controller_as_c(&*own, &plant, &options(precision)).unwrap();
            let arrays = [(plant.n_state(), false), (18, false), (plant.n_input(), true)];
            let driver = Driver::new(&module, &format!("{}_tick", module.name), module.memory > 0, &arrays, &["-O1"]);
            let (n, worst) = apart(&driver.run(&rows), &commands);
            println!("{name} in {precision:?}: {n} of {} commands differ, worst {worst:.1e}", 4 * rows.len());
            match precision {
                ExportPrecision::Double => assert_eq!(n, 0),
                // measured: 4.5e-6, 1.0e-6, 1.5e-6, 2.2e-5
                ExportPrecision::Single => assert!(worst < 1e-4),
            }
        }
    }
}

#[test]
fn every_controller_that_fly_can_name_is_exported_or_refused_with_the_reason() {
    let physics = Physics::default();
    let of_vehicles = ["hummingbird", "omav"].map(|name| Plant::of_vehicle(&vehicles::by_name(name).unwrap(), physics));
    let of_models = configurations::names().into_iter().map(|name| configurations::by_name(name).unwrap());
    let of_models = of_models.map(|model| Plant::of_model(&model, physics));
    let mut told = std::collections::BTreeMap::new();
    for plant in of_vehicles.into_iter().chain(of_models).map(Result::unwrap) {
        let kind = |name| (name, plant.tree().is_some());
        // one of a kind: large ones take seconds
        for entry in REGISTRY.iter().filter(|entry| entry.suits(&plant)) {
            if told.contains_key(&kind(entry.name)) {
                continue;
            }
            let Ok(own) = entry.build(&plant, &Setup::new(None, &Rates::default())) else { continue };
            let is_law = own.recorded(&plant).unwrap().is_some();
            let exported = controller_as_c(&*own, &plant, &options(ExportPrecision::Single));
            let said = exported.map_or_else(|error| error.to_string(), |module| format!("exported as {}", module.name));
            assert_eq!(said.starts_with("exported"), is_law, "{}: {said}", entry.name);
            assert!(is_law || said.contains("but it must be a law"), "{said}");
            println!("{} of {}: {said}", entry.name, plant.name());
            told.insert(kind(entry.name), said);
        }
    }
    let met = |name: &&str| told.keys().any(|(own, _)| own == name);
    let missing: Vec<&str> = REGISTRY.iter().map(|entry| entry.name).filter(|name| !met(name)).collect();
    assert!(missing.is_empty(), "never met: {missing:?}");
}

#[test]
fn every_vehicle_is_exported_and_a_tree_tests_itself() {
    for vehicle in vehicles::all() {
        let plant = Plant::of_vehicle(&vehicle, Physics::default()).unwrap();
        plant_as_c(&plant, &options(ExportPrecision::Single)).unwrap();
    }
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    let plant = Plant::of_model(&configurations::by_name("payload").unwrap(), Physics::default()).unwrap();
    for precision in BOTH {
        good(&plant_as_c(&plant, &options(precision)).unwrap(), &["-O1"]);
    }
}

#[test]
fn every_task_tests_itself() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    let (mut worst, mut n) = (Vec::new(), 0);
    for (k, task) in tasks::registry::names().into_iter().enumerate() {
        let config = tasks::EnvConfig::default();
        // both of a few: large ones take seconds
        let module = task_as_c(task, &config, &options(BOTH[k % 2])).unwrap();
        let said = checked(&module, &["-O0"]).unwrap_or_else(|error| error.to_string());
        println!("{said}");
        let unread: Vec<&str> = module.file(".h").lines().filter(|line| line.contains('?')).collect();
        assert!(unread.is_empty() && module.file(".h").is_ascii(), "{unread:?}");
        n += 1;
        if said.contains("WRONG") || !said.contains("good") {
            worst.push(said);
        }
    }
    assert!(worst.is_empty(), "{} of {n}: {worst:?}", worst.len());
}

#[test]
fn a_policy_of_every_kind_tests_itself() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    let mut wrong = Vec::new();
    // whose environments are none that can be made
    let all = samples().into_iter().filter(|sample| sample.name != "unlike_agents");
    for (k, Sample { name, policy, spec }) in all.enumerate() {
        let own = ExportOptions { name: Some(format!("own_{name}")), precision: BOTH[k % 2], ..Default::default() };
        let module = policy_as_c(&policy, &spec.task, &spec.config, &own);
        let said = module.and_then(|module| checked(&module, &["-O1"])).unwrap_or_else(|error| error.to_string());
        println!("{said}");
        if said.contains("WRONG") || !said.contains("good") {
            wrong.push(said);
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// States around hover, with a fixed goal, as a policy is shown them, and its actions in `f64`.
fn shown(policy: &rl::Policy, spec: &tasks::Spec, steps: usize) -> Flown {
    let config = &spec.config;
    let starts = rl::Starts { n_env: 1, seed: 3 };
    let threads = base::parallel::Threads::new(1).unwrap();
    let mut env = rl::evaluate::eval_env(policy, &spec.task, config, starts, &threads).unwrap();
    let functions = env.functions().unwrap();
    let mut out = tasks::Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let goal: Vec<f64> = env.goal(0).unwrap().into_iter().map(f64::from).collect();
    let plant = env.robot().plant().clone();
    let mut observe = Remembering::of(&functions.observe).unwrap();
    let networks = Networks::of(policy, &env);
    let mut running = networks.running();
    let mut flown = Flown { rows: Vec::new(), commands: Vec::new() };
    for row in 0..steps {
        let mut state = start(&plant);
        for _ in 0..4 {
            disturb(&mut state, &plant, row);
        }
        let (seen, observed) = observe.call(&[("state", &state), ("goal", &goal)]);
        flown.rows.push(seen);
        flown.commands.push(running.act(&observed));
    }
    flown
}

#[test]
fn ten_thousand_steps_of_policies_in_c_are_those_of_their_networks_to_the_bit_in_double_and_to_rounding_in_float() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    for Sample { name, policy, spec } in ["plain", "normalised_history", "gru"].map(named) {
        let Flown { rows, commands } = shown(&policy, &spec, 10_000);
        for precision in BOTH {
            let module = policy_as_c(&policy, &spec.task, &spec.config, &options(precision)).unwrap();
            let n_goal = 3;
            let arrays = [(rows[0].len() - n_goal, false), (n_goal, false), (commands[0].len(), true)];
            let driver = Driver::new(&module, &format!("{}_step", module.name), true, &arrays, &["-O1"]);
            let (n, worst) = apart(&driver.run(&rows), &commands);
            println!("{name} in {precision:?}: {n} of {} actions differ, worst {worst:.1e}", 4 * rows.len());
            match precision {
                ExportPrecision::Double => assert_eq!(n, 0),
                // measured: 5.9e-7, 2.0e-7, 2.5e-7
                ExportPrecision::Single => assert!(worst < 2e-6),
            }
        }
    }
}

/// Flies every kind of policy in its environment, and asks what is exported of it for the same actions.
#[test]
fn what_is_exported_acts_as_policies_do_in_their_environments() {
    let threads = base::parallel::Threads::new(1).unwrap();
    let mut worst = 0.0_f64;
    // what is exported adds no noise
    let is_noisy = |stage: &tasks::ObservationTransform| matches!(stage, tasks::ObservationTransform::Noise { .. });
    let is_alike = |own: &Sample| own.name != "unlike_agents" && !own.spec.config.observation.iter().any(is_noisy);
    for Sample { name, mut policy, spec } in samples().into_iter().filter(is_alike) {
        let starts = rl::Starts { n_env: 1, seed: 3 };
        let mut env = rl::evaluate::eval_env(&policy, &spec.task, &spec.config, starts, &threads).unwrap();
        let functions = env.functions().unwrap();
        let mut out = tasks::Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        let mut observe = Remembering::of(&functions.observe).unwrap();
        let networks = Networks::of(&policy, &env);
        let mut running = networks.running();
        let mut actions = vec![0.0; env.spec().n_agent * env.spec().action.len()];
        for _ in 0..20 {
            let beside = env.shown_beside(0).unwrap();
            let [state, goal] = [env.state(0), env.goal(0)].map(|x| x.unwrap().into_iter().map(f64::from).collect());
            let (state, goal): (Vec<f64>, Vec<f64>) = (state, goal);
            let (_, observed) = observe.call(&[
                ("state", &state),
                ("goal", &goal),
                ("start", &beside.start),
                ("varied", &beside.varied),
                ("readings", &beside.readings),
            ]);
            policy.act(&out.observation, &mut actions).unwrap();
            let own = running.act(&observed);
            let is_whole = !env.spec().config.actions.eq(&tasks::EnvConfig::default().actions);
            for (a, b) in actions.iter().zip(&own) {
                let a = if is_whole { f64::from(*a) } else { f64::from(*a).clamp(-1.0, 1.0) };
                worst = worst.max((a - b).abs());
                assert!((a - b).abs() < 2e-5, "{name}: {actions:?} {own:?}");
            }
            env.step(&actions, &mut out.out()).unwrap();
            if out.terminated[0] + out.truncated[0] > 0 {
                break;
            }
        }
    }
    println!("worst {worst:.1e}");
}

/// The policy that an algorithm begins with on a task by its recipe.
fn first_policy(task: &str, algorithm: Option<&str>) -> base::error::Result<(rl::Policy, tasks::EnvConfig)> {
    let config = rl::TrainConfig::for_task(task, algorithm, None)?;
    let env = tasks::EnvConfig { n_env: 1, ..config.seen_env() };
    let made = tasks::Env::make(task, &env)?;
    let actor = config.algorithm.actor(made.spec())?;
    let parameters: Vec<f32> = (0..actor.n_parameter()).map(|k| 0.03 * ((k * k % 17) as f32 - 8.0)).collect();
    Ok((rl::Policy::of(&actor, &parameters, &made)?, env))
}

#[test]
fn what_train_can_name_is_exported() {
    let mut n = 0;
    let names = rl::algorithm::names().into_iter().chain(rl::algorithm::VARIANTS.iter().map(|own| own.name));
    for algorithm in names {
        let mut met = false;
        for task in ["Hover", "Spread"] {
            let (policy, env) = match first_policy(task, Some(algorithm)) {
                Ok(own) => own,
                Err(error) => {
                    println!("{algorithm} does not learn {task}: {error}");
                    continue;
                }
            };
            met = true;
            let own =
                ExportOptions { name: Some(format!("{}_{algorithm}", task.to_lowercase())), ..Default::default() };
            let module = policy_as_c(&policy, task, &env, &own).unwrap();
            n += 1;
            if has_compiler() {
                println!("{}", checked(&module, &["-O0"]).unwrap());
            }
        }
        assert!(met, "{algorithm} learns neither");
    }
    println!("{n} policies");
}

#[test]
fn the_policy_of_every_tasks_recipe_is_exported() {
    for task in tasks::registry::names() {
        let (policy, env) = first_policy(task, None).unwrap();
        let module = policy_as_c(&policy, task, &env, &options(ExportPrecision::Single)).unwrap();
        println!("{}: {} bytes of tables", module.name, module.tables);
    }
}

#[test]
fn whatever_names_a_vehicle_has_its_module_compiles_and_every_index_has_a_name() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    for (name, rotors) in [
        ("evil */ int x; /*", ["arm-1", "arm_1", "Arm 1", "arm 1"]),
        ("左 ??/ \\", ["左", "右", "前", "後"]),
        (&"long".repeat(40), ["size", "SIZE", "position_x", "9"]),
        ("int", ["", "a /* b", "a */ b", "a\nb"]),
    ] {
        let module = match hummingbird_named(name, rotors) {
            Some(plant) => plant_as_c(&plant, &options(ExportPrecision::Single)).unwrap(),
            None => continue,
        };
        checked(&module, &["-O0"]).unwrap_or_else(|error| panic!("{name}: {error}"));
        let header = module.file(".h");
        let mut names: Vec<&str> =
            header.lines().filter_map(|line| line.strip_prefix("#define ")?.split(' ').next()).collect();
        let n = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), n, "{header}");
    }
}

/// Nothing where the library does not take such names.
fn hummingbird_named(name: &str, rotors: [&str; 4]) -> Option<Plant> {
    let mut vehicle = vehicles::by_name("hummingbird").unwrap();
    vehicle.name = name.into();
    vehicle.rotors.iter_mut().zip(rotors).for_each(|(rotor, name)| rotor.name = name.into());
    Plant::of_vehicle(&vehicle, Physics::default()).ok()
}

#[test]
fn what_is_no_number_leaves_a_controller_and_a_policy_as_they_were() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    let plant = hummingbird();
    for name in ["cascade", "indi", "lqi"] {
        let mut own = make(name, &plant, &Setup::new(None, &Rates::default())).unwrap();
        let Flown { rows, commands } = flown(&plant, &mut *own, 200);
        let module = controller_as_c(&*own, &plant, &options(ExportPrecision::Double)).unwrap();
        let arrays = [(plant.n_state(), false), (18, false), (4, true)];
        let driver = Driver::new(&module, &format!("{}_tick", module.name), module.memory > 0, &arrays, &["-O1"]);
        // broken samples between those of the flight
        let mut all = Vec::new();
        for (k, row) in rows.iter().enumerate() {
            all.push(row.clone());
            let mut broken = row.clone();
            match k % 4 {
                // no attitude, as estimators begin
                3 => broken[6..10].fill(0.0),
                of => broken[k % row.len()] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY][of],
            }
            all.push(broken);
        }
        let told = driver.run(&all);
        for (k, want) in commands.iter().enumerate() {
            assert_eq!((&told[2 * k], &told[2 * k + 1]), (want, want), "{name}, tick {k}");
        }
    }
}

#[test]
fn a_policy_flies_on_beyond_the_horizon_of_its_task_by_the_clock_of_the_last_step() {
    let Sample { policy, spec, .. } = named("plain");
    let Flown { commands, .. } = shown(&policy, &spec, 5_000);
    let env = tasks::Env::make(&spec.task, &tasks::EnvConfig { n_env: 1, ..spec.config.clone() }).unwrap();
    let mut observe = Remembering::of(&env.functions().unwrap().observe).unwrap();
    let state = start(env.robot().plant());
    let clock =
        spec.observation.iter().take_while(|field| field.name != "clock").map(|field| field.size).sum::<usize>();
    let mut last = 0.0;
    for step in 0..3 * env.spec().horizon {
        let (_, seen) = observe.call(&[("state", &state), ("goal", &[1.0, 0.0, 0.0])]);
        let most = (env.spec().horizon - 1) as f64 / env.spec().horizon as f64;
        assert!(seen[clock] <= most + 1e-12 && seen[clock] >= last, "step {step}: {}", seen[clock]);
        last = seen[clock];
    }
    assert!(last > 0.99 && commands.iter().flatten().all(|x| x.is_finite()));
}

/// What a module's object needs of others.
fn undefined(module: &CModule, flags: &[&str]) -> std::collections::BTreeSet<String> {
    let folder = tempfile::tempdir().unwrap();
    module.write(folder.path(), true).unwrap();
    let source = format!("{}.c", module.name);
    compiler::compile(folder.path(), &[source], "own.o", &[&["-c"], flags].concat()).unwrap();
    let output = std::process::Command::new("nm").args(["-u", "own.o"]).current_dir(folder.path()).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    text.split_whitespace().filter(|word| *word != "U").map(String::from).collect()
}

#[test]
fn modules_need_nothing_but_libm() {
    if !has_compiler() || std::process::Command::new("nm").arg("--version").output().is_err() {
        return println!("no C compiler or no nm here: left out");
    }
    // compilers call sine and cosine at once
    const LIBM: [&str; 11] = ["sqrt", "sqrtf", "sin", "cos", "sincos", "exp", "log", "tanh", "atan2", "fmaf", "fabsf"];
    // what compilers for other processors call, that for x86 writes out
    const CALLS: &[&str] = if cfg!(target_arch = "x86_64") {
        &["-mmemset-strategy=libcall:-1:noalign", "-mmemcpy-strategy=libcall:-1:noalign"]
    } else {
        &[]
    };
    let plant = hummingbird();
    let indi = make("indi", &plant, &Setup::new(None, &Rates::default())).unwrap();
    for precision in BOTH {
        let mut modules = vec![controller_as_c(&*indi, &plant, &options(precision)).unwrap()];
        for name in ["history_of_normalised", "gru", "set_max", "multi_discrete"] {
            let Sample { policy, spec, .. } = named(name);
            modules.push(policy_as_c(&policy, &spec.task, &spec.config, &options(precision)).unwrap());
        }
        for module in &modules {
            for level in ["-O2", "-Os"] {
                let flags = [&[level], CALLS].concat();
                let needed = undefined(module, &flags);
                println!("{} in {precision:?} with {flags:?}: {needed:?}", module.name);
                assert!(needed.iter().all(|own| LIBM.contains(&own.as_str())), "{needed:?}");
            }
        }
    }
}

/// The program of a module's page.
fn example_of(module: &CModule) -> Option<String> {
    let (_, rest) = module.file(".md").split_once("```c\n")?;
    Some(rest.split_once("```")?.0.to_string())
}

#[test]
fn examples_of_pages_compile() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    let plant = hummingbird();
    let setup = (None, Rates::default());
    let mut modules = vec![plant_as_c(&plant, &options(ExportPrecision::Single)).unwrap()];
    for name in ["cascade", "lqr", "indi"] {
        let own = make(name, &plant, &Setup::new(setup.0, &setup.1)).unwrap();
        modules.push(controller_as_c(&*own, &plant, &options(ExportPrecision::Double)).unwrap());
    }
    for name in ["plain", "gru", "privileged", "conv2d", "rate", "velocity"] {
        let Sample { policy, spec, .. } = named(name);
        modules.push(policy_as_c(&policy, &spec.task, &spec.config, &options(ExportPrecision::Single)).unwrap());
    }
    for module in modules {
        let example = example_of(&module).unwrap_or_else(|| panic!("{} shows none", module.name));
        let folder = tempfile::tempdir().unwrap();
        module.write(folder.path(), true).unwrap();
        std::fs::write(folder.path().join("use.c"), &example).unwrap();
        let flags = ["-O1", "-c"];
        compiler::compile(folder.path(), &["use.c".into()], "use.o", &flags)
            .unwrap_or_else(|e| panic!("{e}\n{example}"));
    }
}

/// A module with a line of its source written otherwise: that which contains `what`, the last one.
fn broken(module: &CModule, what: &str, otherwise: &str) -> CModule {
    let mut own = module.clone();
    let source = own.files.iter_mut().find(|(name, _)| name.ends_with(".c") && !name.contains("_test")).unwrap();
    let at = source.1.rfind(what).unwrap_or_else(|| panic!("no line with {what}"));
    let end = at + source.1[at..].find('\n').unwrap();
    source.1.replace_range(at..end, otherwise);
    own
}

#[test]
fn golden_vectors_tell_of_what_is_wrong() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    let single = options(ExportPrecision::Single);
    let step = plant_as_c(&hummingbird(), &single).unwrap();
    let mut all = Vec::new();
    for k in [0, 2, 3, 6, 8, 10, 12, 14] {
        all.push(broken(&step, &format!("next[{k}] = "), &format!("next[{k}] = state[{k}];")));
    }
    all.push(broken(&step, "state[8] = -attitude[2];", "state[8] = attitude[2];"));
    all.push(broken(&step, "speeds[1] = ", "speeds[1] = speeds[1] + 0.01f;"));
    let own = make("cascade", &hummingbird(), &Setup::new(None, &Rates::default())).unwrap();
    let cascade = controller_as_c(&*own, &hummingbird(), &single).unwrap();
    all.push(broken(&cascade, "memory->tick % 5u", "ticks[0] = 1.0f;"));
    all.push(broken(&cascade, "target[15] = -yaw;", "target[15] = yaw;"));
    let hover = task_as_c("Hover", &tasks::EnvConfig::default(), &single).unwrap();
    for (what, otherwise) in [
        ("ends[0] = ", "ends[0] = 0.0f;"),
        ("ends[1] = ", "ends[1] = 0.0f;"),
        ("reasons[0] = ", "reasons[0] = 0.0f;"),
        ("commands[0] = ", "commands[0] = action[0];"),
        ("commands[2] = ", "commands[2] = action[2];"),
    ] {
        all.push(broken(&hover, what, otherwise));
    }
    let good =
        all.iter().map(|module| checked(module, &["-O0", "-Wno-unused-but-set-variable", "-Wno-unused-variable"]));
    let missed: Vec<usize> = good.enumerate().filter_map(|(k, own)| own.is_ok().then_some(k)).collect();
    assert!(missed.is_empty(), "of {} these are called good: {missed:?}", all.len());
}

#[test]
fn modules_of_both_precisions_are_one_file_to_a_compiler() {
    if !has_compiler() {
        return println!("no C compiler here: left out");
    }
    let plant = hummingbird();
    let cascade = make("cascade", &plant, &Setup::new(None, &Rates::default())).unwrap();
    let Sample { policy, spec, .. } = named("layer_norm");
    let folder = tempfile::tempdir().unwrap();
    let mut all = String::new();
    for precision in BOTH {
        let named = |name: &str| {
            let name = Some(format!("{name}_{}", precision.c_type()));
            ExportOptions { name, precision, ..Default::default() }
        };
        for module in [
            controller_as_c(&*cascade, &plant, &named("cascade")).unwrap(),
            policy_as_c(&policy, &spec.task, &spec.config, &named("policy")).unwrap(),
        ] {
            module.write(folder.path(), true).unwrap();
            all += &format!("#include \"{}.c\"\n", module.name);
        }
    }
    std::fs::write(folder.path().join("all.c"), all).unwrap();
    compiler::compile(folder.path(), &["all.c".into()], "all.o", &["-c", "-O1"]).unwrap();
}

#[test]
fn parts_of_fast_math_are_refused_where_compilers_tell_of_them() {
    let is_gcc = || {
        let output = std::process::Command::new(compiler::compiler()).arg("--version").output();
        output.is_ok_and(|output| String::from_utf8_lossy(&output.stdout).contains("Free Software Foundation"))
    };
    if !has_compiler() || !is_gcc() {
        return println!("no gcc here: left out");
    }
    let module = plant_as_c(&hummingbird(), &options(ExportPrecision::Single)).unwrap();
    for flag in ["-ffast-math", "-funsafe-math-optimizations", "-freciprocal-math", "-ffinite-math-only"] {
        let said = checked(&module, &["-O2", flag]).unwrap_err().to_string();
        assert!(said.contains("#error") && said.contains("hummingbird.c without"), "{flag}: {said}");
    }
}
