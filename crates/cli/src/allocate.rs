//! `omnidrones allocate`: which thrusts make a wrench, what they cannot make, and why.

use super::arguments::{PlotArguments, VehicleArguments, list};
use super::failure::named;
use super::robot;
use super::source;
use crate::prelude::*;
use nalgebra::DMatrix;
use omnidrones::controllers::allocation::characteristic_length;
use omnidrones::controllers::allocation::failure;
use omnidrones::controllers::allocation::problem::{Problem, WRENCH, balanced_weights};
use omnidrones::controllers::allocation::{
    AllocationSensitivity, AllocationSolution, Allocator, AttainableWrenches, Axis, PrioritisedAllocator, Variation,
    WrenchMargin, wrench_matrix,
};
use omnidrones::dynamics::hover::BALANCED;
use omnidrones::dynamics::spatial::rotate;
use omnidrones::dynamics::tree::Multibody;
use omnidrones::dynamics::{GRAVITY, Physics};
use omnidrones_plot::{Bar, Bars, Colour, Figure};

/// What the command is for.
pub const ABOUT: &str = "\
Find the rotor thrusts that make a wanted wrench as nearly as the rotors' limits allow, and explain the answer: who found \
it and how exactly, which rotors are at a limit, what is missing, what the clipped pseudo-inverse would have done, and how \
far the wrench lies inside what the rotors can make. Rotors may be lost or weakened. A configuration is taken at rest, with \
all joints held.";

const EXAMPLES: &str = "\
Examples:
  omnidrones allocate firefly                                 hover
  omnidrones allocate firefly --wrench 0,0,15,0.5,0,0.2       forces [N], then moments [N m]
  omnidrones allocate firefly --fail 2                        hover without rotor 2
  omnidrones allocate hummingbird --wrench 0,0,12,1,0,1 --yaw-last   thrust, roll and pitch first, yaw with what is left
  omnidrones allocate omav --gradient                         and how each thrust answers to each axis
  omnidrones allocate firefly --wrench 0,0,30,2,0,0 --plot wrench.png

The cost is the squared missing wrench, moments divided by the characteristic length, plus a little for thrust. The wrench \
is about the centre of mass, in body axes: x forward, y left, z up.

JSON: SI units, radians.

Exit codes: 0 allocated, or told why not exactly; 2 unusable input or arguments.";

/// Arguments of `allocate`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("plot", |plot| plot.help("Draw thrusts, limits, wanted and delivered wrench into this file (.png or .svg)")))]
pub struct Arguments {
    /// A built-in vehicle or configuration, or a file FILE.toml or FILE.urdf
    #[arg(value_name = "VEHICLE|CONFIG|FILE")]
    vehicle: String,
    #[command(flatten)]
    rotors: VehicleArguments,
    /// Wanted force [N] and moment [N m]: FX,FY,FZ,MX,MY,MZ [default: the weight]
    #[arg(long, value_name = "SIX NUMBERS", value_parser = wrench, allow_hyphen_values = true, help_heading = "Wrench")]
    wrench: Option<[f64; WRENCH]>,
    /// A rotor that is lost, or weakened as ROTOR:SHARE; may be repeated
    #[arg(long, value_name = "ROTOR[:SHARE]", help_heading = "Wrench")]
    fail: Vec<String>,
    /// Thrust, roll and pitch first; side forces and yaw only with what is left
    #[arg(long, help_heading = "Wrench")]
    yaw_last: bool,
    /// Print how each thrust answers to each axis of the wrench, limits included
    #[arg(long, conflicts_with = "yaw_last", help_heading = "Output")]
    gradient: bool,
    #[command(flatten)]
    output: PlotArguments,
}

fn wrench(text: &str) -> std::result::Result<[f64; WRENCH], String> {
    list(text, "FX,FY,FZ,MX,MY,MZ")
}

/// What is allocated to.
struct Subject {
    name: String,
    rotors: Vec<String>,
    problem: Problem,
    /// Of whole rotors, N.
    largest: Vec<f64>,
    weight: f64,
    /// What holds the weight: of a vehicle in the attitude of its hover, body axes.
    hover: [f64; WRENCH],
    /// Of a vehicle that leans in hover: its geometry in the axes in which it hovers level, and the turn to those.
    upright: Option<(DMatrix<f64>, [f64; 4])>,
    /// What is wrong with it, whatever the wrench.
    warnings: Vec<String>,
}

impl Subject {
    fn load(a: &Arguments) -> Result<Self> {
        if robot::configuration(&a.vehicle).is_some() {
            return Self::robot(a);
        }
        robot::known(&a.vehicle)?;
        let vehicle = source::to_use(Some(&a.vehicle), &a.rotors)?.vehicle;
        let problem = Problem::of_vehicle(&vehicle)?;
        let weight = vehicle.mass_properties().mass * GRAVITY;
        let hover = failure::hover(&vehicle);
        let warnings = source::verdicts(&vehicle);
        let leaning = vehicle.hover().ok().filter(|hover| !hover.is_level());
        let upright = leaning.map(|hover| (vehicle.upright().allocation_matrix(), hover.attitude));
        let rotors = vehicle.rotors.iter().map(|r| r.name.clone()).collect();
        let largest = problem.upper.clone();
        Ok(Self { name: vehicle.name, rotors, largest, problem, weight, hover, upright, warnings })
    }

    fn robot(a: &Arguments) -> Result<Self> {
        let model = robot::load(&a.vehicle, &a.rotors)?.model;
        let largest: Vec<f64> = model.rotors().iter().map(|r| r.rotor.max_thrust()).collect();
        if largest.is_empty() {
            return Err(Error::value(format!("'{}': rotors", a.vehicle), 0, "≥ 1", "Name something that flies."));
        }
        let system = Multibody::new(&model, Physics::default())?;
        let geometry = wrench_matrix(&system, &system.rest_state());
        let weights = balanced_weights(characteristic_length(&geometry));
        let problem = Problem::boxed(geometry, weights, largest.clone())?;
        let rotors = model.rotors().iter().map(|r| r.rotor.name.clone()).collect();
        let weight = model.mass() * GRAVITY;
        let hover = [0.0, 0.0, weight, 0.0, 0.0, 0.0];
        let (name, warnings) = (model.name().into(), Vec::new());
        Ok(Self { name, rotors, problem, largest, weight, hover, upright: None, warnings })
    }

    /// Problem, wrench and hover in the axes in which it hovers level: margins are asked there.
    fn in_hover_axes(&self, wanted: [f64; WRENCH]) -> (Problem, [f64; WRENCH], [f64; WRENCH]) {
        let Some((geometry, turn)) = &self.upright else { return (self.problem.clone(), wanted, self.hover) };
        let turned = |w: [f64; WRENCH]| {
            let [force, moment] = [rotate(*turn, [w[0], w[1], w[2]]), rotate(*turn, [w[3], w[4], w[5]])];
            [force[0], force[1], force[2], moment[0], moment[1], moment[2]]
        };
        (Problem { geometry: geometry.clone(), ..self.problem.clone() }, turned(wanted), turned(self.hover))
    }

    /// Lowers the upper bounds of what fails.
    fn fail(&mut self, failures: &[String]) -> Result<()> {
        for text in failures {
            let (rotor, share) = named(text, &self.rotors)?;
            if !(0.0..1.0).contains(&share) {
                let remedy = "0 is a lost rotor; leave --fail out for a whole one.";
                return Err(Error::value(format!("--fail {text}: share"), share, "in [0, 1)", remedy));
            }
            self.problem.upper[rotor] = self.problem.upper[rotor].min(share * self.largest[rotor]);
        }
        Ok(())
    }
}

/// The answer with what is said about it.
struct Answer {
    wanted: [f64; WRENCH],
    solution: AllocationSolution,
    delivered: [f64; WRENCH],
    /// Thrusts of the least-squares solution without limits, clipped, and what they make.
    clipped: Vec<f64>,
    clipped_wrench: [f64; WRENCH],
    reach: Option<WrenchMargin>,
    /// How much of the way from the weight alone to the wanted wrench is possible.
    share: Option<f64>,
    length: f64,
}

impl Answer {
    fn of(subject: &Subject, wanted: [f64; WRENCH], yaw_last: bool) -> Result<Self> {
        let problem = &subject.problem;
        let solution = if yaw_last {
            PrioritisedAllocator::new(problem.clone(), &[&[2, 3, 4], &[0, 1, 5]])?.solve(&wanted).solution
        } else {
            Allocator::new(problem.clone())?.solve(&wanted).clone()
        };
        let length = characteristic_length(&problem.geometry);
        let delivered = problem.delivered(&solution.inputs);
        let free = Problem { upper: subject.largest.iter().map(|_| f64::INFINITY).collect(), ..problem.clone() };
        let free = Problem { lower: vec![f64::NEG_INFINITY; free.n_input()], ..free };
        let mut clipped = Allocator::new(free)?.solve(&wanted).inputs.clone();
        for (u, (lo, hi)) in clipped.iter_mut().zip(problem.lower.iter().zip(&problem.upper)) {
            *u = u.clamp(*lo, *hi);
        }
        let clipped_wrench = problem.delivered(&clipped);
        let (problem, asked, hover) = subject.in_hover_axes(wanted);
        let sideways = asked[..2].iter().any(|f| f.abs() > BALANCED * subject.weight);
        let axes = if sideways { &Axis::ALL[..] } else { &Axis::STEERED[..] };
        // too many rotors to enumerate: the answer stands without a margin
        let set = AttainableWrenches::of(&problem, axes).ok();
        let reach = set.as_ref().map(|set| WrenchMargin::within(&problem, set, &asked)).transpose()?;
        let away: [f64; WRENCH] = std::array::from_fn(|k| asked[k] - hover[k]);
        let share = set.and_then(|set| set.farthest(&hover, &away));
        Ok(Self { wanted, solution, delivered, clipped, clipped_wrench, reach, share, length })
    }

    /// ‖delivered − wanted‖ with moments divided by the length, N.
    fn missing(&self, delivered: &[f64; WRENCH]) -> f64 {
        let e: Vec<f64> =
            (0..WRENCH).map(|k| (delivered[k] - self.wanted[k]) / if k < 3 { 1.0 } else { self.length }).collect();
        // squares of the largest numbers are none
        let most = e.iter().fold(0.0, |most: f64, e| most.max(e.abs()));
        if most == 0.0 { 0.0 } else { most * e.iter().map(|e| (e / most) * (e / most)).sum::<f64>().sqrt() }
    }
}

/// Allocates and explains.
pub fn run(a: &Arguments) -> Result<Report> {
    a.output.check()?;
    let mut subject = Subject::load(a)?;
    subject.fail(&a.fail)?;
    let wanted = a.wrench.unwrap_or(subject.hover);
    let answer = Answer::of(&subject, wanted, a.yaw_last)?;
    if let Some(file) = &a.output.plot {
        figure(&subject, &answer).save(file)?;
    }
    if a.output.json {
        return Ok(Report::json(&as_json(&subject, &answer), true));
    }
    let mut page = Page::new();
    page.title(&subject.name, &headline(&subject, &answer));
    page.notes("warning", &subject.warnings, 3, "");
    page.facts(facts(&subject, &answer, a));
    page.heading("Thrusts").table(thrusts(&subject, &answer));
    page.heading("Wrench").table(wrenches(&answer));
    if a.gradient {
        gradient(&mut page, &subject, &answer);
    }
    page.written(a.output.plot.as_slice());
    Ok(Report::page(&page, true))
}

/// Below this share of the largest thrust nothing counts as missing.
const EXACT: f64 = 1e-4;

fn headline(subject: &Subject, answer: &Answer) -> String {
    let size = subject.largest.iter().fold(0.0, |m: f64, t| m.max(*t));
    let held = held(subject, answer);
    let limits = match held {
        0 => "no rotor at a limit".into(),
        1 => "one rotor at a limit".into(),
        n => format!("{n} rotors at a limit"),
    };
    if let Some(reason) = answer.solution.reason {
        return format!("not solved ({reason:?}): the preferred thrusts, within their limits");
    }
    match answer.missing(&answer.delivered) {
        m if m > EXACT * size => format!("{} N of the wrench are missing, {limits}", short(m, 3)),
        _ => format!("the wrench is made, {limits}"),
    }
}

fn held(subject: &Subject, answer: &Answer) -> usize {
    (0..subject.rotors.len()).filter(|i| !["free", "lost"].contains(&state(subject, answer, *i))).count()
}

fn state(subject: &Subject, answer: &Answer, i: usize) -> &'static str {
    let (u, p) = (answer.solution.inputs[i], &subject.problem);
    let at = |limit: f64| (u - limit).abs() <= 1e-9 * subject.largest[i];
    match () {
        () if p.upper[i] == 0.0 => "lost",
        () if at(p.upper[i]) && p.upper[i] < subject.largest[i] => "at its weakened limit",
        () if at(p.upper[i]) => "at its largest",
        () if at(p.lower[i]) => "at rest",
        () => "free",
    }
}

fn facts(subject: &Subject, answer: &Answer, a: &Arguments) -> Vec<Fact> {
    let s = &answer.solution;
    let order = if a.yaw_last { "thrust, roll, pitch before the rest" } else { "all axes together" };
    let mut facts = vec![
        Fact::new("found by", s.solver.name()).note(format!("{order}; {} steps", s.steps)),
        Fact::new("KKT residual", format!("{:.1e}", s.residual)).note("recomputed, scaled; 1e-7 is the limit"),
    ];
    if let Some(reach) = &answer.reach {
        let [weak, strong] = [reach.smallest_singular_value, reach.largest_singular_value].map(|v| short(v, 3));
        let rank = format!("{} of {}", reach.rank, reach.axes.len());
        facts
            .push(Fact::new("rank", rank).note(format!("weakest direction {weak} N, strongest {strong} N per newton")));
        let dropped: Vec<&str> = reach.dropped.iter().map(|axis| axis.name()).collect();
        if !dropped.is_empty() {
            facts.push(Fact::new("not commanded alone", dropped.join(", ")));
        }
        let margin = reach.margin.distance;
        let what = match margin {
            m if m.abs() < 1e-9 * subject.weight => "on the edge of what the rotors can make",
            m if m > 0.0 => "inside what the rotors can make",
            _ => "outside what the rotors can make, by at least that",
        };
        let note = format!("{what}; nearest limit {}", reach.weakest());
        let size = if margin.abs() < 1e-9 * subject.weight { 0.0 } else { margin };
        facts.push(Fact::new("margin", format!("{} N", short(size, 3))).note(note));
    }
    if let Some(share) = answer.share
        && a.wrench.is_some()
    {
        let note = "of the way from hover to this wrench is possible";
        facts.push(Fact::new("reach", format!("{} %", short(100.0 * share, 3))).note(note));
    }
    let (mine, theirs) = (answer.missing(&answer.delivered), answer.missing(&answer.clipped_wrench));
    let note = format!("the pseudo-inverse, clipped, misses {} N", short(theirs, 3));
    facts.push(Fact::new("missing", format!("{} N", short(mine, 3))).note(note));
    facts.push(Fact::new("weight", format!("{} N", short(subject.weight, 4))));
    facts
}

fn thrusts(subject: &Subject, answer: &Answer) -> Table {
    Table::new(">rotor | name | >thrust [N] | >limit [N] | >share | >command | state | >pseudo-inverse, clipped [N]")
        .filled(subject.rotors.iter().enumerate().map(|(i, name)| {
            let (u, limit) = (answer.solution.inputs[i], subject.problem.upper[i]);
            let share = if limit > 0.0 { format!("{} %", number(100.0 * u / limit, 0)) } else { "–".into() };
            [
                i.to_string(),
                name.clone(),
                number(u, 3),
                number(limit, 3),
                share,
                if limit > 0.0 { format!("{:+.3}", 2.0 * u / limit - 1.0) } else { "–".into() },
                state(subject, answer, i).to_string(),
                number(answer.clipped[i], 3),
            ]
        }))
}

const UNITS: [&str; WRENCH] = ["N", "N", "N", "N m", "N m", "N m"];

fn wrenches(answer: &Answer) -> Table {
    Table::new("axis | >wanted | >delivered | >missing | >pseudo-inverse, clipped | unit").filled(
        Axis::ALL.iter().enumerate().map(|(k, axis)| {
            let (want, got) = (answer.wanted[k], answer.delivered[k]);
            [
                axis.name().to_string(),
                number(want, 3),
                tidy(got),
                tidy(want - got),
                tidy(answer.clipped_wrench[k]),
                UNITS[k].to_string(),
            ]
        }),
    )
}

/// Three decimals without a negative zero.
fn tidy(v: f64) -> String {
    number(if v.abs() < 5e-4 { 0.0 } else { v }, 3)
}

fn gradient(page: &mut Page, subject: &Subject, answer: &Answer) {
    let Some(at) = AllocationSensitivity::new(&subject.problem, &answer.wanted, &answer.solution) else { return };
    let mut table = Table::new(">rotor").with(Align::Right, Axis::ALL.iter().map(|axis| axis.name()));
    let answers: Vec<Vec<f64>> = (0..WRENCH)
        .map(|k| {
            let mut change = Variation::zero(&subject.problem);
            change.wrench[k] = 1.0;
            at.forward(&change)
        })
        .collect();
    for i in 0..subject.rotors.len() {
        let row = answers.iter().map(|column| tidy(column[i]));
        table.row(std::iter::once(i.to_string()).chain(row));
    }
    page.heading("Thrust per newton and newton metre wanted [N/N, N/(N m)]").table(table);
    let side = if at.is_one_sided() { "one side of a change of limits" } else { "until the limits change" };
    page.line(format!("  holds for {side}; distance to the nearest change, scaled: {:.1e}", at.margin()));
}

fn figure(subject: &Subject, answer: &Answer) -> Figure {
    let name = |i: usize| format!("{i} {}", subject.rotors[i]);
    let mut rotors = Bars::new("Thrusts", "share of the largest thrust [%]").baseline("largest", 100.0);
    for i in 0..subject.rotors.len() {
        let colour = match state(subject, answer, i) {
            "free" => Colour::BLUE,
            "lost" => Colour::GREY,
            _ => Colour::VERMILLION,
        };
        let (u, largest) = (answer.solution.inputs[i], subject.largest[i]);
        let note = format!("%   {} N, {}", short(u, 3), state(subject, answer, i));
        rotors = rotors.bar(Bar::new(name(i), 100.0 * u / largest).note(note).colour(colour));
    }
    let mut axes = Bars::new("Wanted and delivered", "size [N], moments divided by the characteristic length");
    for (k, axis) in Axis::ALL.iter().enumerate() {
        let scale = if k < 3 { 1.0 } else { 1.0 / answer.length };
        let (want, got) = (answer.wanted[k], answer.delivered[k]);
        if want.abs().max(got.abs()) * scale < EXACT * subject.weight {
            continue;
        }
        let note = |v: f64| format!("  ({} {})", tidy(v), UNITS[k]);
        axes = axes
            .bar(Bar::new(format!("{} wanted", axis.name()), want * scale).note(note(want)).colour(Colour::GREY))
            .bar(Bar::new("delivered", got * scale).note(note(got)));
    }
    let (n, m) = (subject.rotors.len() as f64 + 3.0, axes.bars.len() as f64 + 3.0);
    Figure::new(format!("{}: {}", subject.name, headline(subject, answer)))
        .size(900.0, 60.0 + 26.0 * (n + m))
        .grid(&[1.0], &[n, m])
        .place((0, 0), (1, 1), rotors)
        .place((0, 1), (1, 1), axes)
}

fn as_json(subject: &Subject, answer: &Answer) -> Value {
    let s = &answer.solution;
    json!({
        "command": "allocate",
        "name": subject.name,
        "warnings": subject.warnings,
        "rotors": subject.rotors,
        "wanted": answer.wanted,
        "delivered": answer.delivered,
        "thrusts": s.inputs,
        "upper": subject.problem.upper,
        "state": (0..subject.rotors.len()).map(|i| state(subject, answer, i)).collect::<Vec<_>>(),
        "path": s.solver.name(),
        "held_because": s.reason.map(|r| format!("{r:?}")),
        "kkt_residual": s.residual,
        "steps": s.steps,
        "missing": answer.missing(&answer.delivered),
        "missing_by_clipped_pseudo_inverse": answer.missing(&answer.clipped_wrench),
        "rank": answer.reach.as_ref().map(|r| r.rank),
        "margin": answer.reach.as_ref().map(|r| r.margin.distance),
        "nearest_limit": answer.reach.as_ref().map(WrenchMargin::weakest),
        "share_of_the_way_from_hover": answer.share,
    })
}
