//! Vehicles as C: one step of their equations, and what their rotors turn at.

use super::frames::add_state_from_ned;
use super::golden::{Golden, Twin};
use super::identifier::of_macro;
use super::module::{CModule, ExportOptions, ModuleBuilder, array};
use autodiff::emit::{Access, NamedArray, NamedFunction};
use autodiff::{Recording, Scalar, System, Trace};
use base::error::Result;
use dynamics::{Plant, Quantity};

/// Rows of golden vectors.
const ROWS: usize = 24;

/// One step of a plant, x⁺ = f(x, u), with its numbers as constants; and of its rotors alone, for those who cannot measure their speeds.
///
/// # Errors
/// [`Error::Value`](base::error::Error::Value) for a name that is none in C; as [`Program::compile`](autodiff::Program::compile).
pub fn plant_as_c(plant: &Plant, options: &ExportOptions) -> Result<CModule> {
    let dt = plant.physics().dt;
    let title = format!("one step of {dt} s of '{}'", plant.name());
    let mut module = ModuleBuilder::new(plant.name(), title, options)?;
    module.about.push(format!(
        "The equations that '{}' has under the physics it was exported with: integrator {:?}, substeps {}.",
        plant.name(),
        plant.physics().integrator,
        plant.physics().substeps
    ));
    add_period(&mut module, dt);
    let step = step(plant);
    module.public(&step)?;
    let arrays: Vec<&NamedArray> = step.arrays.iter().collect();
    let mut golden = Golden::of_function(format!("{}_step", module.name()), false, &arrays);
    let mut twin = Twin::of(&step)?;
    // swift, so that a step changes much
    let mut state = start(plant);
    disturb_by(10.0, &mut state, plant, 3);
    for row in 0..ROWS {
        let input: Vec<f64> = (0..plant.n_input()).map(|k| 0.2 * wave(row, k) - 0.2).collect();
        let inputs = [state.clone(), input].concat();
        let next = twin.call(&inputs);
        golden.rows.push([inputs, next.clone()].concat());
        state = next;
    }
    module.golden(golden);
    add_rotors(&mut module, plant, 1)?;
    if begins_with_body(plant) {
        add_state_from_ned(&mut module, plant.n_state());
    }
    module.describe_rotors(plant);
    let (name, real) = (module.name().to_string(), module.real());
    let (n, m) = (plant.n_state(), plant.n_input().max(1));
    let upper = of_macro(&name);
    let passed = if plant.n_input() > 0 { "input, " } else { "" };
    module.example = format!(
        "static {real} state[{n}]; /* where it begins */

/* one step of {upper}_PERIOD seconds */
void run(const {real} input[{m}])
{{
    {name}_step(state, {passed}state);
}}
"
    );
    Ok(module.finished())
}

/// Seconds from call to call.
pub(crate) fn add_period(module: &mut ModuleBuilder, period: f64) {
    let value = module.number(period);
    module.define("period", value, "s from call to call");
}

/// A number within [−1, 1] that looks like none.
pub(crate) fn wave(row: usize, k: usize) -> f64 {
    (1.7 * row as f64 + 2.3 * k as f64 + 0.4 * (row * k) as f64).sin()
}

/// In hover, or at rest where nothing hovers.
pub(crate) fn at_hover(plant: &Plant) -> Vec<f64> {
    plant.hover_state().unwrap_or_else(|_| at_rest(plant))
}

/// A state from which golden vectors begin: that of hover, moved a little.
pub(crate) fn start(plant: &Plant) -> Vec<f64> {
    let mut state = at_hover(plant);
    disturb(&mut state, plant, 0);
    state
}

/// At the origin, rotors still.
fn at_rest(plant: &Plant) -> Vec<f64> {
    plant.tree().map_or_else(
        || {
            let mut state = vec![0.0; plant.n_state()];
            state[6] = 1.0;
            state
        },
        |system| system.rest_state(),
    )
}

/// Moves everything a little, as measurements do; attitudes stay unit quaternions.
pub(crate) fn disturb(state: &mut [f64], plant: &Plant, row: usize) {
    disturb_by(1.0, state, plant, row);
}

/// The same, so many times as much.
pub(crate) fn disturb_by(size: f64, state: &mut [f64], plant: &Plant, row: usize) {
    let quantities = plant.state_quantities();
    let is_attitude = |quantity: &Quantity| quantity.name.contains("attitude_");
    for (k, quantity) in quantities.iter().enumerate().filter(|(_, quantity)| !is_attitude(quantity)) {
        state[k] += size * wave(row, k) * if quantity.name.ends_with(".speed") { 5.0 } else { 0.05 };
    }
    for first in (0..quantities.len()).filter(|k| quantities[*k].name.ends_with("attitude_w")) {
        for k in 1..4 {
            state[first + k] += 0.05 * size * wave(row, first + k);
        }
        let norm = state[first..first + 4].iter().map(|q| q * q).sum::<f64>().sqrt();
        state[first..first + 4].iter_mut().for_each(|q| *q /= norm);
    }
}

fn step(plant: &Plant) -> NamedFunction {
    let (n, m) = (plant.n_state(), plant.n_input());
    let recording = Recording::of(n + m, |z| {
        let mut next = vec![Trace::zero(); n];
        plant.step(&z[..n], &z[n..n + m], &[], &mut next);
        next
    });
    NamedFunction {
        name: "step".into(),
        about: "The state after one step with held input; `next` may be `state`.".into(),
        arrays: vec![
            state_array(plant, "state", Access::Read),
            input_array(plant, "input", Access::Read),
            state_array(plant, "next", Access::Write),
        ],
        recording,
    }
}

/// Adds `NAME_rotors`: speeds of rotors so many steps later, from those before and their actions. What a model knows of them where
/// nobody measures.
pub(crate) fn add_rotors(module: &mut ModuleBuilder, plant: &Plant, steps: usize) -> Result<()> {
    let Some(function) = rotors(plant, steps) else { return Ok(()) };
    let period = module.number(steps as f64 * plant.physics().dt);
    module.define("rotors_period", period, "s from call to call of rotors");
    module.public(&function)?;
    let arrays: Vec<&NamedArray> = function.arrays.iter().collect();
    let mut golden = Golden::of_function(format!("{}_rotors", module.name()), false, &arrays);
    let (mut twin, places) = (Twin::of(&function)?, plant.rotor_places());
    for row in 0..8 {
        let actions: Vec<f64> = (0..places.len()).map(|k| wave(row, k)).collect();
        let speeds: Vec<f64> =
            places.iter().enumerate().map(|(k, place)| place.max_speed * (0.5 + 0.4 * wave(row + 3, k))).collect();
        let given = [actions, speeds].concat();
        golden.rows.push([given.clone(), twin.call(&given)].concat());
    }
    module.golden(golden);
    Ok(())
}

/// From actions and speeds to speeds so many steps later, where nothing else moves them.
fn rotors(plant: &Plant, steps: usize) -> Option<NamedFunction> {
    let places = plant.rotor_places();
    let (n, m) = (plant.n_state(), plant.n_input());
    if places.is_empty() {
        return None;
    }
    let at_rest = start(plant);
    let recording = Recording::of(2 * places.len(), |z| {
        let (actions, speeds) = z.split_at(places.len());
        let mut speeds = speeds.to_vec();
        for _ in 0..steps {
            let mut state: Vec<Trace> = at_rest.iter().map(|x| Trace::constant(*x)).collect();
            let mut input = vec![Trace::zero(); m];
            for (k, place) in places.iter().enumerate() {
                (state[place.speed], input[place.action]) = (speeds[k], actions[k]);
            }
            let mut next = vec![Trace::zero(); n];
            plant.step(&state, &input, &[], &mut next);
            speeds = places.iter().map(|place| next[place.speed]).collect();
        }
        speeds
    });
    let rotors = plant.rotors();
    let numbers = |what: &str| rotors.iter().map(|rotor| format!("{}.{what}", rotor.name)).collect::<Vec<_>>();
    let (actions, speeds) = (numbers("action"), numbers("speed"));
    let about =
        "Speeds of the rotors one step later under these actions, by the model: for those who do not measure them.";
    Some(NamedFunction {
        name: "rotors".into(),
        about: about.into(),
        arrays: vec![
            array("actions", "actions of the rotors", Access::Read, actions.iter().map(|name| (&name[..], "-"))),
            array("speeds", "speeds of the rotors", Access::Update, speeds.iter().map(|name| (&name[..], "rad/s"))),
        ],
        recording,
    })
}

/// Whether the state is the motion of one body, then other things.
pub(crate) fn begins_with_body(plant: &Plant) -> bool {
    plant.roots() == [0] && plant.state_quantities().get(6).is_some_and(|quantity| quantity.name == "attitude_w")
}

pub(crate) fn state_array(plant: &Plant, name: &str, access: Access) -> NamedArray {
    let about = if name == "state" { "the state" } else { "the state after it" };
    quantities(name, about, access, &plant.state_quantities())
}

pub(crate) fn input_array(plant: &Plant, name: &str, access: Access) -> NamedArray {
    quantities(
        name,
        "what acts on it: actions and commands in [-1, 1], disturbances",
        access,
        &plant.input_quantities(),
    )
}

fn quantities(name: &str, about: &str, access: Access, all: &[Quantity]) -> NamedArray {
    array(name, about, access, all.iter().map(|own| (&own.name[..], own.unit)))
}
