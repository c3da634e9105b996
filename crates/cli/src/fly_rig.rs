//! `omnidrones fly` for configurations, and drops of anything.

use super::fly::{Arguments, tracked};
use super::page::{Fact, Page, duration, length, short};
use super::rig::{self, Rig};
use super::table::{Align, Table, number};
use super::{Report, files, progress};
use omnidrones::controllers::pilot::{clearance, start_above, start_on, steerable};
use omnidrones::controllers::reference::{Hover, Lemniscate};
use omnidrones::controllers::{
    Bends, FlightPlan, Note, Passive, Pilot, Reference, RigFlight, Shape, Vectored, fly_rig, suited, vectored,
};
use omnidrones::dynamics::aero::wind::Wind;
use omnidrones::dynamics::tree::{Multibody, contact_forces, kinetic_energy, potential_energy};
use omnidrones::dynamics::{Gains, configurations};
use omnidrones::error::{Error, Result};
use omnidrones::flight::FlightSummary;
use omnidrones_plot::model;
use omnidrones_plot::rig::{Fall, JointHistory, RigFigures, fall, joints};
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Seconds left out of the RMSE.
const TRANSIENT: f64 = 2.0;
/// Of the lemniscate that configurations follow unless told otherwise, rad/s.
const GENTLE: f64 = 0.5;
/// Least way between the ground and whatever hangs lowest on that lemniscate, m.
const ROOM: f64 = 0.5;

/// Flies a configuration, or drops anything.
pub fn run(a: &Arguments) -> Result<Report> {
    let named = a.named().unwrap_or("hummingbird");
    let rig = rig::load(named, &a.rotors)?;
    // what nobody steers yet falls
    let alone = !rig.model.drones().is_empty() && !steerable(&rig.model);
    if a.drop.is_some() || alone { dropped(a, &rig) } else { flown(a, &rig) }
}

/// The system with the effects of the arguments, and of the wind.
fn system(a: &Arguments, rig: &Rig, contact: bool) -> Result<Multibody> {
    let mut physics = a.flight.physics();
    physics.effects.disturbance |= a.wind != Wind::Calm;
    physics.effects.contact |= contact;
    Multibody::new(&rig.model, physics)
}

fn gains(a: &Arguments) -> Result<Option<Gains>> {
    match a.flight.gains.as_deref() {
        None | Some("derived") => Ok(None),
        Some("published") => Err(Error::value(
            "--gains",
            "published, but nobody published gains for configurations",
            "derived or a TOML file",
            "Leave the option out for gains derived from what each controller flies.",
        )),
        Some(file) => files::read_toml(Path::new(file)).map(Some),
    }
}

/// What was asked, else a slow lemniscate high enough for what hangs below.
fn reference(a: &Arguments, system: &Multibody) -> Result<Reference> {
    if a.flight.reference.is_some() {
        return a.flight.reference();
    }
    let below = -model::lowest(system, &system.rest_state());
    let usual = Lemniscate::default();
    let dip = usual.scale[2] * usual.vertical;
    let height = (ROOM + dip + below).max(usual.origin[2]);
    Ok(Reference::Lemniscate(Lemniscate { rate: GENTLE, origin: [0.0, 0.0, (10.0 * height).ceil() / 10.0], ..usual }))
}

/// Who flies, in what shape.
fn pilot(a: &Arguments, system: &Multibody, plan: &FlightPlan) -> Result<Box<dyn Pilot>> {
    let gains = gains(a)?;
    if !vectored(system.model()) {
        let pilot = suited(system, gains.as_ref(), &plan.rates)?;
        if a.shape.is_some() || !pilot.holds_tilt() {
            a.level()?;
        }
        return Ok(pilot);
    }
    let shape = a.shape.as_deref().map_or(Ok(Shape::Straight), Shape::parse)?;
    let bends = Bends::new(system.model(), shape, plan.tilt.at)?;
    Ok(Box::new(Vectored::new(system, gains.as_ref(), &plan.rates)?.with_bends(bends)))
}

fn flown(a: &Arguments, rig: &Rig) -> Result<Report> {
    let system = system(a, rig, false)?;
    let reference = reference(a, &system)?;
    let usual = reference.duration().map_or(20.0, |end| end + 2.0);
    let mut plan = a.flight.plan(Some(a.duration.unwrap_or(usual)), a.wind.clone(), a.seed)?;
    (plan.reference, plan.physics) = (reference, *system.physics());
    let n_step = plan.n_step()?;
    plan.tilt = a.tilt()?;
    let mut pilot = pilot(a, &system, &plan)?;
    let start = start_on(&system, pilot.as_ref(), &plan.reference);
    let folder = a.out.clone().unwrap_or_else(|| files::default_folder(rig.model.name()));
    if a.csv || !a.no_plots {
        files::prepare_folder(&folder)?;
    }
    let bar = progress::bar(n_step, "flying", a.json);
    let clock = Instant::now();
    let flight = fly_rig(&system, pilot.as_mut(), &plan, &start, &mut |k| {
        if k % 64 == 0 {
            bar.set_position(k);
        }
    })?;
    let wall_time = clock.elapsed().as_secs_f64();
    bar.finish_and_clear();

    let after = if plan.duration > TRANSIENT { TRANSIENT } else { 0.0 };
    let mut written = Vec::new();
    if !a.no_plots {
        let spinner = progress::spinner("drawing", a.json);
        let figures = RigFigures::new(&system, &flight.log, &flight.states, after);
        written.extend(figures.save(&folder, a.format.extension())?);
        spinner.finish_and_clear();
    }
    if a.csv {
        let (log, own) = (folder.join("flight.csv"), folder.join("joints.csv"));
        flight.log.write_csv(&log)?;
        files::write_new(&own, &joint_csv(&system, &flight), true)?;
        written.extend([log, own]);
    }
    let n = system.rest_state().len();
    let heights = flight.states.chunks_exact(n).step_by(5).map(|row| model::lowest(&system, row));
    let result = Flown {
        rig,
        controller: [pilot.name().into(), pilot.description()],
        notes: pilot.notes(),
        joints: joints(&system, &flight.states),
        lowest: heights.fold(f64::INFINITY, f64::min),
        summary: flight.log.summary(after),
        contact: plan.physics.effects.contact,
        plan,
        flight,
        wall_time,
        written,
    };
    let verdict = result.verdict(a.max_rmse);
    let text = if a.json { format!("{:#}\n", result.json(&verdict)) } else { result.page(&verdict) };
    Ok(Report { success: verdict.is_ok(), text })
}

/// Angles and rates of all joints, one line per sample.
fn joint_csv(system: &Multibody, flight: &RigFlight) -> String {
    let layout = system.layout();
    let own = |i: &usize| layout.bodies[*i].n_freedom == 1;
    let places: Vec<usize> = (0..layout.bodies.len()).filter(own).collect();
    let mut text = String::from("time [s]");
    for i in &places {
        let body = &system.model().bodies()[*i];
        let turns = matches!(body.joint.motion, omnidrones::dynamics::tree::Motion::Revolute(_));
        let unit = if turns { "rad" } else { "m" };
        let _ = write!(text, ",{0} [{unit}],{0} rate [{unit}/s]", body.joint.name);
    }
    text.push('\n');
    for (time, row) in flight.log.time.iter().zip(flight.states.chunks_exact(system.rest_state().len())) {
        let _ = write!(text, "{time}");
        for i in &places {
            let _ = write!(text, ",{},{}", row[layout.bodies[*i].position], row[layout.bodies[*i].velocity]);
        }
        text.push('\n');
    }
    text
}

struct Flown<'a> {
    rig: &'a Rig,
    /// Name and description.
    controller: [String; 2],
    /// What it says about itself.
    notes: Vec<Note>,
    plan: FlightPlan,
    flight: RigFlight,
    summary: FlightSummary,
    joints: Vec<JointHistory>,
    lowest: f64,
    contact: bool,
    wall_time: f64,
    written: Vec<PathBuf>,
}

/// Largest and root-mean-square value of a history.
fn extremes(history: &JointHistory) -> [f64; 2] {
    let v = &history.values;
    let most = v.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    [most, (v.iter().map(|x| x * x).sum::<f64>() / v.len().max(1) as f64).sqrt()]
}

impl Flown<'_> {
    fn verdict(&self, max_rmse: Option<f64>) -> std::result::Result<(), String> {
        if let Some(t) = self.flight.diverged_at {
            return Err(format!("the flight diverged at {} s: try a slower --reference, or hover", short(t, 4)));
        }
        tracked(&self.summary, max_rmse)
    }

    fn page(&self, verdict: &std::result::Result<(), String>) -> String {
        let mut page = Page::new();
        page.title(self.rig.model.name(), &self.rig.origin);
        page.line(format!("  {}", self.rig.description));
        page.heading("Flight").facts(&self.facts());
        if !self.joints.is_empty() {
            let mut table = Table::new(&[("joint", Align::Left), ("largest", Align::Right), ("rms", Align::Right)]);
            for joint in &self.joints {
                let show = |v: f64| {
                    if joint.turns { format!("{}°", number(v.to_degrees(), 1)) } else { length(v) }
                };
                table.row([joint.name.clone()].into_iter().chain(extremes(joint).map(show)));
            }
            page.heading("Joints").table(&table);
            page.line("  away from rest; of a universal joint both hinges together");
        }
        if !self.written.is_empty() {
            page.heading("Written");
            for path in &self.written {
                page.line(format!("  {}", path.display()));
            }
        }
        if let Err(reason) = verdict {
            page.line(format!("\nFAILED: {reason}"));
        }
        page.finish()
    }

    fn facts(&self) -> Vec<Fact> {
        let (s, plan) = (&self.summary, &self.plan);
        let speed = match &plan.reference {
            Reference::Lemniscate(l) => {
                format!("; {} rad/s around ({}) m", l.rate, l.origin.map(|v| short(v, 3)).join(", "))
            }
            Reference::Hover(Hover { position, .. }) => format!("; ({}) m", position.map(|v| short(v, 3)).join(", ")),
            _ => String::new(),
        };
        let ground = match (self.lowest < 0.0, self.contact) {
            (false, _) => "of all bodies and rotors, over the whole flight",
            (true, true) => "of all bodies and rotors: it touched the ground",
            (true, false) => "below the ground at 0, which is not simulated here: --effects contact",
        };
        let mut facts = vec![
            Fact::new("controller", &self.controller[0]).note(&self.controller[1]),
            Fact::new("reference", plan.reference.name()).note(format!("{}{speed}", plan.reference.description())),
            Fact::new("simulated", format!("{} s", short(s.duration, 5))).note(format!(
                "{} steps of {}{} in {}: {} × real time",
                s.samples.saturating_sub(1),
                duration(plan.physics.dt),
                if plan.physics.substeps > 1 {
                    format!(" ({} substeps)", plan.physics.substeps)
                } else {
                    String::new()
                },
                duration(self.wall_time),
                short(s.duration / self.wall_time.max(1e-9), 3)
            )),
            Fact::new("tracking RMSE", length(s.rmse)).note(format!("after the first {} s", s.rmse_after)),
            Fact::new("largest error", length(s.max_error)),
            Fact::new("top speed", format!("{} m/s", number(s.max_speed, 2))),
            Fact::new("largest tilt", format!("{}°", number(s.max_tilt.map(f64::to_degrees), 1))).note("of the root"),
            Fact::new("rotors at a limit", format!("{} %", number(s.saturation.map(|v| 100.0 * v), 1)))
                .note("of all commands"),
            Fact::new("lowest point", format!("{} m", short(self.lowest, 3))).note(ground),
        ];
        if !plan.tilt.is_level() {
            let [roll, pitch] = [plan.tilt.roll, plan.tilt.pitch].map(|a| short(a.to_degrees(), 3));
            let over =
                if plan.tilt.ramp > 0.0 { format!(" over {} s", short(plan.tilt.ramp, 3)) } else { String::new() };
            let note = format!("from {} s on{over}", short(plan.tilt.at, 3));
            facts.insert(2, Fact::new("held beside it", format!("roll {roll}°, pitch {pitch}°")).note(note));
        }
        facts.extend(self.notes.iter().map(|n| Fact::new(&n.name, &n.value).note(&n.note)));
        facts
    }

    fn json(&self, verdict: &std::result::Result<(), String>) -> Value {
        let joint = |j: &JointHistory| {
            let [largest, rms] = extremes(j);
            json!({ "name": j.name, "turns": j.turns, "largest": largest, "rms": rms })
        };
        json!({
            "command": "fly",
            "version": env!("CARGO_PKG_VERSION"),
            "success": verdict.is_ok(),
            "failure": verdict.as_ref().err(),
            "configuration": self.rig.model.name(),
            "controller": self.controller[0],
            "controller_notes": self.notes.iter().map(|n| json!([n.name, n.value, n.note])).collect::<Vec<_>>(),
            "plan": self.plan,
            "flight": self.summary,
            "joints": self.joints.iter().map(joint).collect::<Vec<_>>(),
            "lowest": self.lowest,
            "diverged_at": self.flight.diverged_at,
            "wall_time": self.wall_time,
            "files": files::names(&self.written),
        })
    }
}

/// Refuses arguments of a controller.
fn uncontrolled(a: &Arguments) -> Result<()> {
    let given = [
        ("--reference", a.flight.reference.is_some()),
        ("--gains", a.flight.gains.is_some()),
        ("--rates", a.flight.rates.is_some()),
        ("--max-rmse", a.max_rmse.is_some()),
    ];
    match given.into_iter().find(|(_, given)| *given) {
        None => Ok(()),
        Some((name, _)) => {
            let value = if a.drop.is_some() { "with --drop" } else { "for a configuration that nobody steers yet" };
            Err(Error::value(name, value, "left out: nothing is controlled", "It falls to the ground: leave it out."))
        }
    }
}

fn dropped(a: &Arguments, rig: &Rig) -> Result<Report> {
    uncontrolled(a)?;
    a.level()?;
    let height = a.drop.unwrap_or(1.0);
    if !(0.0..=1000.0).contains(&height) {
        return Err(Error::value("--drop", format!("{height} m"), "0 to 1000 m", "--drop alone means 1 m."));
    }
    let system = system(a, rig, true)?;
    let start = start_above(&system, height, a.seed)?;
    let mut plan = a.flight.plan(Some(a.duration.unwrap_or(3.0)), a.wind.clone(), a.seed)?;
    (plan.physics, plan.reference) = (*system.physics(), Reference::Hover(Hover::default()));
    let n_step = plan.n_step()?;
    let folder = a.out.clone().unwrap_or_else(|| files::default_folder(rig.model.name()));
    if a.csv || !a.no_plots {
        files::prepare_folder(&folder)?;
    }
    let bar = progress::bar(n_step, "falling", a.json);
    let flight = fly_rig(&system, &mut Passive(system.clone()), &plan, &start, &mut |k| {
        if k % 64 == 0 {
            bar.set_position(k);
        }
    })?;
    bar.finish_and_clear();
    let fallen = Fallen::of(rig, &system, &flight, height);
    let mut written = Vec::new();
    if !a.no_plots {
        let path = folder.join(format!("drop.{}", a.format.extension()));
        let figure = fall(&system, fallen.drawn());
        figure.subtitle(fallen.subtitle()).save(&path)?;
        written.push(path);
    }
    if a.csv {
        let path = folder.join("drop.csv");
        files::write_new(&path, &fallen.csv(), true)?;
        written.push(path);
    }
    let success = flight.diverged_at.is_none() && !fallen.gained();
    let text = if a.json { format!("{:#}\n", fallen.json(&written)) } else { fallen.page(&written) };
    Ok(Report { success, text })
}

/// A fall and what it was like in every sample.
struct Fallen<'a> {
    rig: &'a Rig,
    flight: &'a RigFlight,
    height: f64,
    clearance: Vec<f64>,
    energy: Vec<f64>,
    /// Of the ground on everything, in weights.
    load: Vec<f64>,
    speed: f64,
}

impl<'a> Fallen<'a> {
    fn of(rig: &'a Rig, system: &Multibody, flight: &'a RigFlight, height: f64) -> Self {
        let rows: Vec<&[f64]> = flight.states.chunks_exact(system.rest_state().len()).collect();
        let weight = rig.model.mass() * rig.model.parts().gravity;
        let force = |row: &&[f64]| contact_forces(system, row).iter().map(|f| f[2]).sum::<f64>() / weight;
        let kinetic = |row: &&[f64]| kinetic_energy(system, row);
        Self {
            rig,
            flight,
            height,
            clearance: rows.iter().map(|row| clearance(system, row).unwrap_or(f64::NAN)).collect(),
            energy: rows.iter().map(|row| kinetic(row) + potential_energy(system, row)).collect(),
            load: rows.iter().map(force).collect(),
            speed: rows.last().map_or(f64::NAN, |row| (2.0 * kinetic(row) / rig.model.mass()).sqrt()),
        }
    }

    fn drawn(&self) -> Fall<'_> {
        Fall {
            log: &self.flight.log,
            states: &self.flight.states,
            clearance: &self.clearance,
            energy: &self.energy,
            load: &self.load,
        }
    }

    /// When something first touched the ground, s.
    fn touched(&self) -> Option<f64> {
        self.clearance.iter().position(|c| *c < 0.0).map(|i| self.flight.log.time[i])
    }

    fn deepest(&self) -> f64 {
        self.clearance.iter().fold(0.0_f64, |m, c| m.max(-c))
    }

    fn hardest(&self) -> f64 {
        self.load.iter().fold(0.0, |m: f64, v| m.max(*v))
    }

    fn lost(&self) -> [f64; 2] {
        [self.energy.first(), self.energy.last()].map(|e| e.copied().unwrap_or(f64::NAN))
    }

    /// Whether energy came from nowhere, which a step too long for the ground's stiffness does.
    fn gained(&self) -> bool {
        let most = self.energy.iter().fold(f64::NEG_INFINITY, |m, e| m.max(*e));
        most > 1.01 * self.lost()[0] + 1e-6
    }

    fn subtitle(&self) -> String {
        let when = self.touched().map_or("no touch".into(), |t| format!("touches the ground at {} s", short(t, 3)));
        format!(
            "from {} m, rotors idle   ·   {when}   ·   at most {} weights   ·   sinks in by {} at most",
            short(self.height, 3),
            short(self.hardest(), 3),
            length(self.deepest())
        )
    }

    fn page(&self, written: &[PathBuf]) -> String {
        let [first, last] = self.lost();
        let mut page = Page::new();
        page.title(self.rig.model.name(), &self.rig.origin);
        let mut facts = vec![
            Fact::new("height", format!("{} m", short(self.height, 4))).note("of the lowest point, rotors idle"),
            Fact::new("first touch", self.touched().map_or("never".into(), |t| format!("{} s", short(t, 4)))).note(
                format!("in free fall {} s", short((2.0 * self.height / self.rig.model.parts().gravity).sqrt(), 4)),
            ),
            Fact::new("hardest push", format!("{} weights", short(self.hardest(), 3))).note("upwards, of the ground"),
            Fact::new("deepest", length(self.deepest())).note("into the ground, which is compliant"),
            Fact::new("energy", format!("{} J", short(last, 4))).note(format!("{} J at the start", short(first, 4))),
            Fact::new("speed at the end", format!("{} m/s", short(self.speed, 2))).note("of all masses, rms"),
        ];
        let ghosts = self.rig.model.shapes().iter().filter(|s| !s.collides).count();
        if ghosts > 0 {
            let all = self.rig.model.shapes().len();
            facts.push(Fact::new("untouchable", format!("{ghosts} of {all}")).note("shapes pass through the ground"));
        }
        if self.gained() {
            let note = "energy came from nowhere: the step is too long for the ground, try --dt 0.002 or less";
            facts.push(Fact::new("wrong", "energy gained").note(note));
        }
        if let Some(t) = self.flight.diverged_at {
            facts.push(Fact::new("diverged", format!("{} s", short(t, 4))).note("a smaller --dt may help"));
        }
        if !steerable(&self.rig.model) {
            page.line("  nobody steers it yet: it falls, rotors idle");
        }
        page.heading("Drop").facts(&facts);
        if !written.is_empty() {
            page.heading("Written");
            for path in written {
                page.line(format!("  {}", path.display()));
            }
        }
        page.finish()
    }

    fn csv(&self) -> String {
        let mut text = String::from("time [s],lowest_point [m],energy [J],ground_force [weights]\n");
        let rows = self.flight.log.time.iter().zip(&self.clearance).zip(&self.energy).zip(&self.load);
        for (((time, clearance), energy), load) in rows {
            let _ = writeln!(text, "{time},{clearance},{energy},{load}");
        }
        text
    }

    fn json(&self, written: &[PathBuf]) -> Value {
        let [first, last] = self.lost();
        json!({
            "command": "fly",
            "version": env!("CARGO_PKG_VERSION"),
            "success": self.flight.diverged_at.is_none(),
            "dropped": self.rig.model.name(),
            "configuration": configurations::names().contains(&self.rig.model.name()),
            "height": self.height,
            "first_touch": self.touched(),
            "largest_ground_force": self.hardest(),
            "deepest": self.deepest(),
            "energy_start": first,
            "energy_end": last,
            "speed_end": self.speed,
            "diverged_at": self.flight.diverged_at,
            "files": files::names(written),
        })
    }
}
