//! `omnidrones show`: an articulated system as a tree, as tables, as JSON, as a drawing.

use super::arguments::{PlotArguments, VehicleArguments};
use super::robot::{self, Robot};
use super::sheet::vector;
use crate::prelude::*;
use omnidrones::dynamics::tree::{Body, Drive, Joint, Model, Motion, Multibody, center_of_mass};
use omnidrones::dynamics::{GRAVITY, Physics, configurations, vehicles};
use omnidrones_plot::model;

/// What the command is for.
pub const ABOUT: &str = "\
Show an articulated system: its tree of bodies with masses and joints; rotors, servos, named frames, totals; where \
every number stands in state and input. A vehicle is shown as a tree of one body. With --plot, draw it.";

const EXAMPLES: &str = "\
Examples:
  omnidrones show                                every configuration and vehicle
  omnidrones show payload                        its tree and tables
  omnidrones show dragon --plot dragon.svg       and a drawing
  omnidrones show drone.urdf --plot drone.png    your own vehicle
  omnidrones show transport --json               everything, as JSON

Body x points forward, y left, z up; a joint's axis is given in the frame of the body that it moves. Hinges count by the \
right hand.

JSON: SI units, radians; 'model' holds the parts as the library reads them.

Exit codes: 0 shown; 2 unusable input or arguments.";

/// Arguments of `show`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("plot", |plot| plot.help("Draw it at rest into this file (.png or .svg)")))]
pub struct Arguments {
    /// A configuration, a built-in vehicle, or a file FILE.toml or FILE.urdf; without it, the list
    #[arg(value_name = "CONFIG|VEHICLE|FILE")]
    named: Option<String>,
    #[command(flatten)]
    rotors: VehicleArguments,
    #[command(flatten)]
    output: PlotArguments,
}

/// Shows.
pub fn run(a: &Arguments) -> Result<Report> {
    let Some(named) = &a.named else { return list(a.output.json) };
    a.output.check()?;
    let robot = robot::load(named, &a.rotors)?;
    let system = Multibody::new(&robot.model, Physics::default())?;
    if let Some(file) = &a.output.plot {
        model::figure(&system, &system.rest_state()).subtitle(subtitle(&robot)).save(file)?;
    }
    if a.output.json {
        return Ok(Report::json(&as_json(&robot, &system, a.output.plot.as_ref()), true));
    }
    let mut page = Page::new();
    page.title(robot.model.name(), &robot.origin);
    if !robot.description.is_empty() {
        page.line(format!("  {}", robot.description));
    }
    page.heading("Tree").table(tree(&robot.model));
    page.heading("Totals").facts(totals(&robot.model, &system));
    tables(&mut page, &robot.model);
    page.written(a.output.plot.as_slice());
    Ok(Report::page(&page, true))
}

fn list(as_json: bool) -> Result<Report> {
    let models: Vec<(&configurations::ConfigurationEntry, Model)> =
        configurations::REGISTRY.iter().map(|e| Ok((e, (e.build)()?))).collect::<Result<_>>()?;
    if as_json {
        let row = |(entry, model): &(&configurations::ConfigurationEntry, Model)| {
            json!({
                "name": entry.name,
                "description": entry.description,
                "bodies": model.bodies().len(),
                "rotors": model.rotors().len(),
                "mass": model.mass(),
                "degrees_of_freedom": model.layout().n_velocity(),
            })
        };
        let rows: Vec<Value> = models.iter().map(row).collect();
        let value = json!({ "command": "show", "configurations": rows, "vehicles": vehicles::names() });
        return Ok(Report::json(&value, true));
    }
    let mut table = Table::new("configuration | >drones | >rotors | >mass [kg] | >freedoms | ");
    for (entry, model) in &models {
        table.row([
            entry.name.to_string(),
            model.drones().len().to_string(),
            model.rotors().len().to_string(),
            short(model.mass(), 4),
            model.layout().n_velocity().to_string(),
            entry.description.to_string(),
        ]);
    }
    let stories: Vec<Fact> = vehicles::REGISTRY.iter().map(|e| Fact::new(e.name, e.description)).collect();
    let mut page = Page::new();
    page.table(table);
    page.heading("Vehicles, shown as one body").facts(stories);
    page.line("\nomnidrones show NAME prints one of them, with --plot FILE it is drawn; omnidrones fly NAME flies it.");
    Ok(Report::page(&page, true))
}

fn subtitle(robot: &Robot) -> String {
    let m = &robot.model;
    let mut numbers = format!("{} kg   ·   degrees of freedom: {}", short(m.mass(), 4), m.layout().n_velocity());
    if !m.rotors().is_empty() {
        numbers += &format!("   ·   rotors: {}", m.rotors().len());
    }
    if robot.description.is_empty() { numbers } else { format!("{}   ·   {numbers}", robot.description) }
}

/// One row per body, indented below its parent.
fn tree(model: &Model) -> Table {
    let mut table = Table::new("body | >mass [kg] | >rotors | joint | moves | ");
    table.row(["world"]);
    branch(model, None, "", &mut table);
    table
}

fn branch(model: &Model, parent: Option<usize>, indent: &str, table: &mut Table) {
    let children: Vec<usize> = (0..model.bodies().len()).filter(|i| model.bodies()[*i].parent == parent).collect();
    for (k, &i) in children.iter().enumerate() {
        let last = k + 1 == children.len();
        let body = &model.bodies()[i];
        let rotors = model.rotors().iter().filter(|r| r.body == i).count();
        let [moves, more] = joint(&body.joint);
        table.row([
            format!("{indent}{} {}", if last { "└─" } else { "├─" }, body.name),
            if body.mass > 0.0 { short(body.mass, 4) } else { "–".into() },
            if rotors > 0 { rotors.to_string() } else { String::new() },
            body.joint.name.clone(),
            moves,
            more,
        ]);
        branch(model, Some(i), &format!("{indent}{}", if last { "   " } else { "│  " }), table);
    }
}

/// How a joint moves, and what holds it.
fn joint(joint: &Joint) -> [String; 2] {
    let (moves, degrees) = match joint.motion {
        Motion::Floating => ("freely".into(), false),
        Motion::Ball => ("every way about a point".into(), false),
        Motion::Revolute(axis) => (format!("about {}", direction(axis)), true),
        Motion::Prismatic(axis) => (format!("along {}", direction(axis)), false),
    };
    let mut more = Vec::new();
    if let Some(l) = &joint.limits {
        more.push(interval(l.lower, l.upper, degrees));
    }
    if let Some(drive) = &joint.drive {
        more.push(servo(drive, degrees));
    }
    let (per, force) = if degrees { ("N m", "rad") } else { ("N", "m") };
    if joint.stiffness > 0.0 {
        more.push(format!("spring {} {per}/{force}", short(joint.stiffness, 3)));
    }
    if joint.damping > 0.0 {
        more.push(format!("damping {} {per} s/{force}", short(joint.damping, 3)));
    }
    [moves, more.join(", ")]
}

fn servo(drive: &Drive, turns: bool) -> String {
    let unit = if turns { "N m" } else { "N" };
    let bound = format!("at most {} {unit}", short(drive.max_torque, 3));
    if drive.stiffness > 0.0 {
        let range = interval(drive.center - drive.range, drive.center + drive.range, turns);
        return format!("position servo {range} {bound}");
    }
    let rate = if turns { "rad/s" } else { "m/s" };
    format!("rate servo ±{} {rate} {bound}", short(drive.range, 3))
}

/// `±120°`, `-0.5 to 2 m`.
fn interval(lower: f64, upper: f64, degrees: bool) -> String {
    let value = |v: f64| if degrees { short(v.to_degrees(), 4) } else { short(v, 4) };
    let unit = if degrees { "°" } else { " m" };
    if (lower + upper).abs() < 1e-12 * upper.abs().max(1.0) {
        format!("±{}{unit}", value(upper))
    } else {
        format!("{} to {}{unit}", value(lower), value(upper))
    }
}

/// `x`, `−y`, or the vector.
fn direction(axis: [f64; 3]) -> String {
    for (k, name) in ["x", "y", "z"].iter().enumerate() {
        if (axis[k].abs() - 1.0).abs() < 1e-12 {
            return if axis[k] > 0.0 { name.to_string() } else { format!("−{name}") };
        }
    }
    vector(&axis, 3)
}

fn totals(model: &Model, system: &Multibody) -> Vec<Fact> {
    let center = center_of_mass(system, &system.rest_state());
    let thrust: f64 = model.rotors().iter().map(|r| r.rotor.max_thrust()).sum();
    let weight = model.mass() * model.parts().gravity;
    let count = |of: fn(&Body) -> bool| model.bodies().iter().filter(|b| of(b)).count();
    let crosses = count(|b| b.mass == 0.0);
    let touching = model.shapes().iter().filter(|s| s.collides && s.body.is_some()).count();
    let bodies = model.bodies().len() - crosses;
    let mut facts = vec![
        Fact::new("mass", format!("{} kg", short(model.mass(), 4))).note(format!("weight {} N", short(weight, 4))),
        Fact::new("centre of mass", vector(&center, 3)).note("m, world, at rest with the root at the origin"),
        Fact::new("bodies", bodies.to_string()).note(if crosses > 0 {
            format!("and without mass between the hinges of universal joints: {crosses}")
        } else {
            String::new()
        }),
        Fact::new("degrees of freedom", model.layout().n_velocity().to_string()),
    ];
    if !model.rotors().is_empty() {
        let ratio = short(thrust / (model.mass() * GRAVITY), 3);
        facts.push(
            Fact::new("rotors", model.rotors().len().to_string())
                .note(format!("{} N together at full speed, {ratio} times the weight", short(thrust, 4))),
        );
    }
    let shapes = Fact::new("shapes", model.shapes().len().to_string());
    facts.push(shapes.note(format!("{touching} of them touch the ground and other trees (effect contact)")));
    facts
}

fn tables(page: &mut Page, model: &Model) {
    if !model.rotors().is_empty() {
        page.heading("Rotors").table(rotors(model));
        page.line("  hub and axis in the frame of the body; T_max and Ω_max at full command");
    }
    if model.bodies().iter().any(|b| b.joint.drive.is_some()) {
        page.heading("Servos").table(servos(model));
        page.line("  a command of ±1 asks for the ends of the target; torques are bounded");
    }
    if !model.parts().frames.is_empty() {
        page.heading("Frames").table(frames(model));
        page.line("  parts that were welded into a body keep their frames by name");
    }
    page.heading("State and input").table(places(model));
}

fn rotors(model: &Model) -> Table {
    Table::new(">rotor | name | on | hub [m] | axis | spin | >T_max [N] | >Ω_max [rad/s] | >lag [ms]").filled(
        model.rotors().iter().enumerate().map(|(i, mounted)| {
            let r = &mounted.rotor;
            let lag = [r.time_constant_up, r.time_constant_down].map(|t| short(1e3 * t, 3));
            [
                i.to_string(),
                r.name.clone(),
                model.bodies()[mounted.body].name.clone(),
                vector(&r.position, 3),
                direction(r.axis),
                if r.spin > 0.0 { "counter-clockwise".into() } else { "clockwise".into() },
                short(r.max_thrust(), 4),
                short(r.max_speed, 4),
                if lag[0] == lag[1] { lag[0].clone() } else { lag.join(" / ") },
            ]
        }),
    )
}

fn servos(model: &Model) -> Table {
    let mut table = Table::new("joint | target | >stiffness | >damping | >bound | >input");
    for (i, body) in model.bodies().iter().enumerate() {
        let Some(drive) = &body.joint.drive else { continue };
        let turns = matches!(body.joint.motion, Motion::Revolute(_));
        let (force, length) = if turns { ("N m", "rad") } else { ("N", "m") };
        let target = if drive.stiffness > 0.0 {
            interval(drive.center - drive.range, drive.center + drive.range, turns)
        } else {
            format!("±{} {length}/s", short(drive.range, 3))
        };
        table.row([
            body.joint.name.clone(),
            target,
            if drive.stiffness > 0.0 {
                format!("{} {force}/{length}", short(drive.stiffness, 3))
            } else {
                "–".into()
            },
            format!("{} {force} s/{length}", short(drive.damping, 3)),
            format!("{} {force}", short(drive.max_torque, 3)),
            model.layout().drive[i].map_or_else(String::new, |at| at.to_string()),
        ]);
    }
    table
}

fn frames(model: &Model) -> Table {
    Table::new("frame | on | origin [m]").filled(
        model
            .parts()
            .frames
            .iter()
            .map(|frame| [frame.name.clone(), model.bodies()[frame.body].name.clone(), vector(&frame.position, 3)]),
    )
}

/// Where everything stands, equal kinds of neighbours together.
fn places(model: &Model) -> Table {
    let mut table = Table::new("slice | holds");
    for (slice, what) in slices(model) {
        table.row([slice, what]);
    }
    let layout = model.layout();
    table.row([format!("state: {} numbers, input: {}", layout.n_state(), layout.n_input()), String::new()]);
    table
}

fn slices(model: &Model) -> Vec<(String, String)> {
    let layout = model.layout();
    let mut rows = Vec::new();
    let span = |what: &str, from: usize, n: usize| format!("{what}[{from}..{}]", from + n);
    for place in &layout.trees {
        let (mut position, mut velocity) = (Vec::new(), Vec::new());
        for i in place.bodies.clone() {
            let (body, at) = (&model.bodies()[i], layout.bodies[i]);
            if body.joint.motion == Motion::Floating {
                for (name, from, n) in
                    [("position", 0, 3), ("velocity", 3, 3), ("attitude w x y z", 6, 4), ("angular velocity", 10, 3)]
                {
                    rows.push((span("state", at.position + from, n), format!("{name} of {}", body.name)));
                }
            } else {
                let numbers = if body.joint.motion == Motion::Ball { 4 } else { 1 };
                position.push((at.position, numbers, body.joint.name.as_str()));
                velocity.push((at.velocity, at.n_freedom, body.joint.name.as_str()));
            }
        }
        for (list, what) in [(position, "joint positions"), (velocity, "joint velocities")] {
            if let (Some(first), Some(last)) = (list.first(), list.last()) {
                let names: Vec<&str> = list.iter().map(|l| l.2).collect();
                rows.push((span("state", first.0, last.0 + last.1 - first.0), format!("{what}: {}", few(&names))));
            }
        }
        let n = place.rotors.len();
        if n > 0 {
            let first = place.rotors.start;
            rows.push((span("state", layout.rotor_speed[first], n), "rotor speeds".into()));
            rows.push((span("input", layout.rotor_action[first], n), "rotor actions".into()));
        }
        let driven: Vec<(usize, &str)> = place
            .bodies
            .clone()
            .filter_map(|i| layout.drive[i].map(|at| (at, model.bodies()[i].joint.name.as_str())))
            .collect();
        if let Some((first, _)) = driven.first() {
            let names: Vec<&str> = driven.iter().map(|d| d.1).collect();
            rows.push((span("input", *first, driven.len()), format!("servo commands: {}", few(&names))));
        }
    }
    rows
}

/// The first names, and how many more.
fn few(names: &[&str]) -> String {
    match names {
        all if all.len() <= 8 => all.join(", "),
        [first @ .., last] => format!("{}, … {last} ({} in the order of the tree)", first[..6].join(", "), names.len()),
        [] => String::new(),
    }
}

fn as_json(robot: &Robot, system: &Multibody, plot: Option<&PathBuf>) -> Value {
    let model = &robot.model;
    let layout = model.layout();
    let places: Vec<Value> =
        slices(model).into_iter().map(|(slice, holds)| json!({ "slice": slice, "holds": holds })).collect();
    json!({
        "command": "show",
        "name": model.name(),
        "origin": robot.origin,
        "description": robot.description,
        "mass": model.mass(),
        "center_of_mass": center_of_mass(system, &system.rest_state()),
        "degrees_of_freedom": layout.n_velocity(),
        "n_state": layout.n_state(),
        "n_input": layout.n_input(),
        "places": places,
        "rest_state": system.rest_state(),
        "rest_input": system.rest_input(),
        "model": model.parts(),
        "files": plot.map(|p| p.display().to_string()).into_iter().collect::<Vec<_>>(),
    })
}
