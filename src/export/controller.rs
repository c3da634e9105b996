//! Controllers as C: a tick of a straight-line law, with its memory and its clock.

use super::frames::{add_state_from_ned, add_target_from_ned};
use super::golden::{Golden, Twin};
use super::identifier::of_macro;
use super::module::{CModule, Cost, ExportOptions, MemoryField, ModuleBuilder, array};
use super::plant::{add_period, add_rotors, at_hover, begins_with_body, disturb_by, input_array, state_array};
use autodiff::System;
use autodiff::emit::{Access, ExportPrecision, NamedArray, NamedFunction};
use base::error::{Error, Result};
use controllers::reference::{Hover, Reference, Setpoint};
use controllers::{ControlLaw, Controller, RecordedLaw, Target};
use dynamics::Plant;
use std::fmt::Write;

/// Rows of golden vectors.
const ROWS: usize = 40;

/// Ticks in which a schedule has to show its rhythm.
const WATCHED: u64 = 20_000;

/// Of a wrench that rotors side by side make: more of them share it in many ways.
const RANK: usize = 4;

/// How far actions may differ in `float` where they do; seen over the vehicles that are built in: 0.08.
const AMBIGUOUS: f64 = 0.15;

/// What is to be known there.
const SHARED: &str = "Where rotors are at their limits, those that are left may make a wrench in several ways: in float, rounding decides \
    which one it is. Thrust, roll and pitch are those of double; yaw and forces sideways, which count least, are not to the last percents.";

/// A tick of a controller for a plant: from state and target to the plant's input, with memory and clock in a struct of the caller.
///
/// # Errors
/// [`Error::Value`] for a controller that is no straight-line law, for a custom function without C text, and for a name that is none in
/// C; otherwise as [`Controller::recorded`].
pub fn controller_as_c(controller: &dyn Controller, plant: &Plant, options: &ExportOptions) -> Result<CModule> {
    let Some(law) = controller.recorded(plant)? else {
        let what = format!("controller '{}'", controller.name());
        let remedy = "Export cascade, lqr or lqi, indi or formation.";
        return Err(Error::value(
            what,
            controller.why_no_law(),
            "a law without branches and solvers without bound",
            remedy,
        ));
    };
    let period = law.rate().map_or(plant.physics().dt, |rate| 1.0 / rate);
    let default_name = format!("{} {}", plant.name(), controller.name());
    let mut module =
        ModuleBuilder::new(&default_name, format!("'{}' of '{}'", controller.name(), plant.name()), options)?;
    module.about.push(format!("{}.", upper(&controller.description())));
    add_period(&mut module, period);
    let tick = tick(&law, plant);
    let is_ambiguous = tick.recording.has_operations()
        && plant.rotor_places().len() > RANK
        && options.precision == ExportPrecision::Single;
    if is_ambiguous {
        module.about.push(SHARED.into());
    }
    let every = rhythm(&law)?;
    describe_rhythm(&mut module, &every, period);
    add_tick(&mut module, &tick, plant, &every, &law.memory())?;
    let steps = (period / plant.physics().dt).round() as usize;
    let rough = flown(&module, &law, &tick, plant, steps, &Reference::by_name("lemniscate")?, 1.0)?;
    if is_ambiguous {
        if let Some(gentle) = gentle(&module, &law, &tick, plant, steps)? {
            module.golden(gentle);
        }
        module.golden(Golden { tolerance: Some((AMBIGUOUS, "rotors at limits")), ..rough });
    } else {
        module.golden(rough);
    }
    add_rotors(&mut module, plant, steps)?;
    if begins_with_body(plant) {
        add_state_from_ned(&mut module, plant.n_state());
    }
    if law.n_target() == Setpoint::<f64>::DIM {
        add_target_from_ned(&mut module, law.n_target());
    }
    module.describe_rotors(plant);
    module.example = example(&module, plant, &tick);
    Ok(module.finished())
}

/// A loop of a vehicle whose speeds of rotors nobody measures.
fn example(module: &ModuleBuilder, plant: &Plant, tick: &NamedFunction) -> String {
    let (name, real, upper) = (module.name(), module.real(), of_macro(module.name()));
    let Some(first) = first_speed(plant).filter(|_| tick.arrays[1].numbers.len() == Setpoint::<f64>::DIM) else {
        return String::new();
    };
    let (n_state, n_rotor, n_input) = (plant.n_state(), plant.rotor_places().len(), plant.n_input());
    let (memory, reset, passed) = if module.has_memory() {
        (format!("static {name}_memory memory;\n"), format!("    {name}_reset(&memory);\n"), "&memory, ")
    } else {
        Default::default()
    };
    let hover = module.number(plant.hover_state().map_or(0.0, |state| state[first]));
    format!(
        "{memory}static {real} state[{n_state}], target[18], input[{n_input}], speeds[{n_rotor}];

void begin(void)
{{
{reset}    for (int k = 0; k < {n_rotor}; k++) speeds[k] = {hover}; /* as rotors turn: here in hover */
}}

/* every {upper}_PERIOD seconds; actions of the rotors are in input then */
void run(const {real} position[3], const {real} velocity[3], const {real} attitude[4], const {real} rates[3],
         const {real} wanted[3], {real} yaw)
{{
    const {real} still[3] = {{0}};
    {name}_state_from_ned(position, velocity, attitude, rates, state);
    for (int k = 0; k < {n_rotor}; k++) state[{first} + k] = speeds[k]; /* measured, or the model's */
    {name}_target_from_ned(wanted, still, still, yaw, {zero}, target);
    {name}_tick({passed}state, target, input); /* 0, and all as it was, where a number is none */
    {name}_rotors(input, speeds);
}}
",
        zero = module.number(0.0),
    )
}

/// The place of the first rotor's speed, where all of them stand one behind the other behind the motion of one body.
pub(crate) fn first_speed(plant: &Plant) -> Option<usize> {
    let places = plant.rotor_places();
    let first = places.first()?.speed;
    let in_order = places.iter().enumerate().all(|(k, place)| place.speed == first + k && place.action == k);
    (begins_with_body(plant) && in_order && places.len() == plant.n_input()).then_some(first)
}

fn upper(words: &str) -> String {
    let mut letters = words.chars();
    letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
}

/// The law as a function of arrays.
fn tick(law: &RecordedLaw, plant: &Plant) -> NamedFunction {
    let numbered = |name: &str, about: &str, access, n: usize| {
        let names: Vec<String> = (0..n).map(|k| format!("{name}_{k}")).collect();
        array(name, about, access, names.iter().map(|name| (&name[..], "-")))
    };
    NamedFunction {
        name: "law".into(),
        about: String::new(),
        arrays: vec![
            state_array(plant, "state", Access::Read),
            target(law.n_target()),
            numbered("ticks", "which levels compute", Access::Read, law.n_tick()),
            numbered("memory", "what it remembers", Access::Update, law.memory().len()),
            input_array(plant, "input", Access::Write),
        ],
        recording: law.recording(),
    }
}

/// Names of a target: those of setpoints, one or several.
fn target(n: usize) -> NamedArray {
    let (size, setpoint) = (Setpoint::<f64>::DIM, Setpoint::<f64>::NUMBERS);
    let name = |k: usize| match (n / size, n % size) {
        (1, 0) => (setpoint[k].0.to_string(), setpoint[k].1),
        (_, 0) => (format!("drone_{}.{}", k / size, setpoint[k % size].0), setpoint[k % size].1),
        _ => (format!("target_{k}"), "-"),
    };
    let names: Vec<(String, &str)> = (0..n).map(name).collect();
    array("target", "where to be", Access::Read, names.iter().map(|(name, unit)| (&name[..], *unit)))
}

/// In which ticks each level computes: every so many.
fn rhythm(law: &RecordedLaw) -> Result<Vec<u64>> {
    let n = law.n_tick();
    let mut ticks = vec![0.0; n];
    let mut at = |tick: u64| {
        law.write_ticks(tick, &mut ticks);
        ticks.clone()
    };
    let every: Vec<u64> = (0..n).map(|k| (1..WATCHED).find(|tick| at(*tick)[k] > 0.5).unwrap_or(WATCHED)).collect();
    let is_so = |tick: u64, now: Vec<f64>| {
        now.iter()
            .zip(&every)
            .all(|(now, every)| (*now == 1.0) == tick.is_multiple_of(*every) && [0.0, 1.0].contains(now))
    };
    if let Some(tick) = (0..WATCHED).find(|tick| !is_so(*tick, at(*tick))) {
        let what = format!("controller '{}': ticks of its levels", law.name());
        return Err(Error::value(
            what,
            format!("another in tick {tick}"),
            "every so many ticks",
            "Tick in a fixed rhythm.",
        ));
    }
    Ok(every)
}

/// How often levels compute.
fn describe_rhythm(module: &mut ModuleBuilder, every: &[u64], period: f64) {
    if every.iter().any(|every| *every > 1) {
        let rates: Vec<String> = every.iter().map(|every| format!("{:.4}", 1.0 / (period * *every as f64))).collect();
        let rates: Vec<&str> = rates.iter().map(|rate| rate.trim_end_matches('0').trim_end_matches('.')).collect();
        module.about.push(format!("Its levels compute at {} Hz.", rates.join(", ")));
    }
}

/// `tick` with the clock of its levels, over what a caller keeps.
fn add_tick(
    module: &mut ModuleBuilder,
    law: &NamedFunction,
    plant: &Plant,
    every: &[u64],
    memory: &[f64],
) -> Result<()> {
    let [state, target, ticks, kept, input] = &law.arrays[..] else { unreachable!("the arrays of a law") };
    [state, target, input].iter().for_each(|array| module.describe(array));
    let inner = module.inner(law)?;
    let about = "what the law remembers".to_string();
    let cycle = every.iter().copied().fold(1, lcm);
    module.keep(vec![MemoryField { name: "law".into(), about, initial: memory.to_vec() }], cycle > 1);
    module.need_finite();
    let (real, name) = (module.real(), module.name().to_string());
    let (n_state, n_target) = (state.numbers.len(), target.numbers.len());
    let mut body = String::new();
    if !every.is_empty() {
        let _ = writeln!(body, "    {real} ticks[{}];", every.len());
    }
    let _ = writeln!(
        body,
        "    if (!({name}_all_finite(state, {n_state}) && {name}_all_finite(target, {n_target}){})) return 0;",
        if begins_with_body(plant) { module.is_turned("state") } else { String::new() }
    );
    if !every.is_empty() {
        for (k, every) in every.iter().enumerate() {
            let [one, zero] = [1.0, 0.0].map(|x| module.number(x));
            let _ = match every {
                1 => writeln!(body, "    ticks[{k}] = {one};"),
                n => writeln!(body, "    ticks[{k}] = memory->tick % {n}u == 0u ? {one} : {zero};"),
            };
        }
    }
    if cycle > 1 {
        let _ = writeln!(body, "    memory->tick = memory->tick + 1u == {cycle}u ? 0u : memory->tick + 1u;");
    }
    let mut arguments = Vec::new();
    let mut parameters = if module.has_memory() { vec![format!("{name}_memory *memory")] } else { Vec::new() };
    for (array, argument) in
        [(state, "state"), (target, "target"), (ticks, "ticks"), (kept, "memory->law"), (input, "input")]
    {
        let n = array.numbers.len();
        if n == 0 {
            continue;
        }
        arguments.push(argument);
        if [&state, &target].contains(&&array) {
            parameters.push(format!("const {real} {}[{n}]", array.name));
        } else if array == input {
            parameters.push(format!("{real} {}[{n}]", array.name));
        }
    }
    let _ = writeln!(body, "    {}({});\n    return 1;", inner.name, arguments.join(", "));
    let about = "One tick: from the measured state and the target to the input of the vehicle. Returns 1; where a number of them is \
        not finite, or an attitude no unit quaternion, 0, and leaves memory and input as they were. Not to be called on the ground: \
        what integrates would.";
    let cost = Cost::calling(every.len() * module.text.precision().bytes(), &[&inner]);
    module.composed_of("int", "tick", about, &parameters.join(", "), &body, cost);
    Ok(())
}

fn lcm(a: u64, b: u64) -> u64 {
    let (mut x, mut y) = (a, b);
    while y != 0 {
        (x, y) = (y, x % y);
    }
    a / x * b
}

/// Golden vectors of a flight on the spot in which no rotor comes to a limit: there they are as near as everywhere.
fn gentle(
    module: &ModuleBuilder,
    law: &RecordedLaw,
    tick: &NamedFunction,
    plant: &Plant,
    steps: usize,
) -> Result<Option<Golden>> {
    let hover = at_hover(plant);
    let spot = Reference::Hover(Hover { position: [hover[0], hover[1], hover[2]], ..Hover::default() });
    for size in [0.1, 0.03, 0.01, 3e-3, 1e-3] {
        let flight = flown(module, law, tick, plant, steps, &spot, size)?;
        let is_inside = |row: &Vec<f64>| row[row.len() - plant.n_input()..].iter().all(|action| action.abs() < FREE);
        if flight.rows.iter().all(is_inside) {
            return Ok(Some(flight));
        }
    }
    Ok(None)
}

/// Actions that are far from their limits.
const FREE: f64 = 0.98;

/// Golden vectors of a flight, so roughly measured.
fn flown(
    module: &ModuleBuilder,
    law: &RecordedLaw,
    tick: &NamedFunction,
    plant: &Plant,
    steps: usize,
    reference: &Reference,
    roughness: f64,
) -> Result<Golden> {
    let [state, target, _, kept, input] = &tick.arrays[..] else { unreachable!("the arrays of a law") };
    let arrays = [state, target, input];
    let mut golden = Golden::of_function(format!("{}_tick", module.name()), module.has_memory(), &arrays).answering();
    let (mut twin, mut memory) = (Twin::of(tick)?, law.memory());
    let (mut x, mut next) = (at_hover(plant), vec![0.0; plant.n_state()]);
    disturb_by(roughness, &mut x, plant, 0);
    let (mut wanted, mut ticks) = (vec![0.0; law.n_target()], vec![0.0; law.n_tick()]);
    for row in 0..ROWS {
        law.write_target(Target::level(reference), row as f64 * steps as f64 * plant.physics().dt, &mut wanted);
        law.write_ticks(row as u64, &mut ticks);
        let mut seen = x.clone();
        disturb_by(roughness, &mut seen, plant, row);
        let told = twin.call(&[&seen[..], &wanted, &ticks, &memory].concat());
        let (new, command) = told.split_at(kept.numbers.len());
        memory.copy_from_slice(new);
        golden.rows.push([&seen[..], &wanted, command].concat());
        for _ in 0..steps {
            plant.step(&x, command, &[], &mut next);
            std::mem::swap(&mut x, &mut next);
        }
    }
    Ok(golden)
}
