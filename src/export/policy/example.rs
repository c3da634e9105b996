//! The program on a policy's page: it flies one vehicle, in the frames of flight controllers.

use super::action;
use crate::controller::first_speed;
use crate::golden::Golden;
use crate::identifier::of_macro;
use crate::module::ModuleBuilder;
use autodiff::System;
use autodiff::emit::{Access, NamedArray};
use dynamics::Plant;
use std::fmt::Write;
use tasks::TaskFunctions;

/// The program, of a vehicle whose speeds of rotors nobody measures; none for several agents, and where commands are of more than action and
/// state. `seen` holds what the task showed in an episode; `aims` says whether there is a setpoint.
pub(super) fn example(
    module: &ModuleBuilder,
    plant: &Plant,
    functions: &TaskFunctions,
    seen: &Golden,
    aims: bool,
) -> String {
    let given = read_beside(&functions.observe.arrays, &["state"]);
    let is_one = functions.n_agent == 1 && read_beside(&functions.act.arrays, &["action", "state"]).is_empty();
    let Some(first) = first_speed(plant).filter(|_| is_one) else { return String::new() };
    let has_heading = given.iter().any(|array| heading_at(array).is_some());
    let own = Example { module, plant, functions, given, first, has_heading, aims };
    own.declarations(seen) + &own.begin() + &own.run()
}

/// Arrays that are read, but for these.
fn read_beside<'a>(arrays: &'a [NamedArray], names: &[&str]) -> Vec<&'a NamedArray> {
    let is_read = |array: &&NamedArray| array.access == Access::Read && !array.numbers.is_empty();
    arrays.iter().filter(is_read).filter(|array| !names.contains(&array.name.as_str())).collect()
}

/// Where a goal holds a heading that is to be reached.
fn heading_at(array: &NamedArray) -> Option<usize> {
    array.numbers.iter().position(|number| number.name == "target_heading_x")
}

/// An argument of the first call.
fn first_given<'a>(golden: &'a Golden, name: &str) -> &'a [f64] {
    let at: usize = golden.arrays.iter().take_while(|array| array.name != name).map(|array| array.n).sum();
    let n = golden.arrays.iter().find(|array| array.name == name).map_or(0, |array| array.n);
    &golden.rows[0][at..at + n]
}

fn indented(lines: &str, by: &str) -> String {
    lines.lines().map(|line| format!("{by}{line}\n")).collect()
}

struct Example<'a> {
    module: &'a ModuleBuilder,
    plant: &'a Plant,
    functions: &'a TaskFunctions,
    /// What is observed beside the state.
    given: Vec<&'a NamedArray>,
    /// Place of the first rotor's speed in the state.
    first: usize,
    has_heading: bool,
    aims: bool,
}

impl Example<'_> {
    fn n_rotor(&self) -> usize {
        self.plant.rotor_places().len()
    }

    /// The argument of a function that remembers.
    fn memory(&self, short: &str) -> &'static str {
        if self.module.takes_memory(short) { "&memory, " } else { "" }
    }

    fn declarations(&self, seen: &Golden) -> String {
        let (name, real, n_rotor) = (self.module.name(), self.module.real(), self.n_rotor());
        let mut text = String::from(if self.has_heading { "#include <math.h>\n\n" } else { "" });
        if self.module.has_memory() {
            let _ = writeln!(text, "static {name}_memory memory;");
        }
        let n_state = self.plant.n_state();
        let more = if self.aims { format!(", seen[{n_state}]") } else { String::new() };
        let n_action = action(&self.functions.act.arrays).numbers.len();
        let _ = writeln!(
            text,
            "static {real} state[{n_state}]{more}, action[{n_action}], commands[{n_rotor}], speeds[{n_rotor}];"
        );
        for array in &self.given {
            let numbers = first_given(seen, &array.name).iter().map(|x| self.module.number(*x)).collect::<Vec<_>>();
            let (name, n, numbers) = (&array.name, numbers.len(), numbers.join(", "));
            let what = "of an episode of the task: set it as yours is";
            let _ = writeln!(text, "static {real} {name}[{n}] = {{{numbers}}}; /* {what} */");
        }
        text + if self.functions.n_act > 1 { "static int count; /* calls since the last step */\n" } else { "" }
    }

    fn begin(&self) -> String {
        let hover = self.module.number(self.plant.hover_state().map_or(0.0, |state| state[self.first]));
        let name = self.module.name();
        let reset = if self.module.has_memory() { format!("    {name}_reset(&memory);\n") } else { String::new() };
        format!(
            "\nvoid begin(void)\n{{\n{reset}    for (int k = 0; k < {}; k++) speeds[k] = {hover}; /* as rotors turn: here in hover */\n}}\n",
            self.n_rotor()
        )
    }

    fn run(&self) -> String {
        let (name, real, upper) = (self.module.name(), self.module.real(), of_macro(self.module.name()));
        let n_act = self.functions.n_act;
        let (period, angle) = (
            if n_act > 1 { "COMMANDS_PERIOD" } else { "PERIOD" },
            if self.has_heading { "; yaw clockwise from north" } else { "" },
        );
        let wanted = if self.aims { format!(",\n         const {real} wanted[3]") } else { String::new() };
        let yaw = if self.has_heading { format!(", {real} yaw") } else { String::new() };
        let mut text = format!(
            "\n/* every {upper}_{period} seconds; north, east, down, and forward, right, down{angle};\n   \
             what the rotors are told is in commands then */\n\
             void run(const {real} position[3], const {real} velocity[3], const {real} attitude[4], const {real} rates[3]{wanted}{yaw})\n{{\n"
        );
        if self.aims {
            let _ = writeln!(text, "    const {real} setpoint[3] = {{wanted[0], -wanted[1], -wanted[2]}};");
        }
        let _ = write!(
            text,
            "    {name}_state_from_ned(position, velocity, attitude, rates, state);\n    \
             for (int k = 0; k < {}; k++) state[{} + k] = speeds[k]; /* measured, or the model's */\n",
            self.n_rotor(),
            self.first
        );
        if n_act > 1 {
            let step = indented(&self.step(), "        ");
            let _ = write!(text, "    if (count == 0) {{\n{step}    }}\n");
            let _ = writeln!(text, "    count = count == {upper}_COMMANDS_PER_STEP - 1 ? 0 : count + 1;");
        } else {
            text += &indented(&self.step(), "    ");
        }
        let is_passed = |array: &&NamedArray| array.access != Access::Update && !array.numbers.is_empty();
        let passed = self.functions.act.arrays.iter().filter(is_passed);
        let passed = passed.map(|array| array.name.as_str()).collect::<Vec<_>>().join(", ");
        let _ = writeln!(text, "    {name}_commands({}{passed});", self.memory("commands"));
        text + &format!("    {name}_rotors(commands, speeds);\n}}\n")
    }

    /// From state and goal to an action.
    fn step(&self) -> String {
        let name = self.module.name();
        let mut text = if self.aims { format!("{name}_aim(setpoint, state, seen);\n") } else { String::new() };
        let suffix = if self.module.real() == "float" { "f" } else { "" };
        for (array, at) in self.given.iter().filter_map(|array| Some((array, heading_at(array)?))) {
            let (goal, y, z, zero) = (&array.name, at + 1, at + 2, self.module.number(0.0));
            let _ = writeln!(
                text,
                "{goal}[{at}] = cos{suffix}(yaw);\n{goal}[{y}] = -sin{suffix}(yaw);\n{goal}[{z}] = {zero};"
            );
        }
        let passed = self.given.iter().map(|array| format!("{}, ", array.name)).collect::<String>();
        let (memory, state) = (self.memory("step"), if self.aims { "seen" } else { "state" });
        text + &format!(
            "{name}_step({memory}{state}, {passed}action); /* 0, and all as it was, where a number is none */\n"
        )
    }
}
