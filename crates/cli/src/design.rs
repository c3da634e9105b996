//! `omnidrones design`: a vehicle's steady flight, its modes, and what its control loop bears.

mod estimated;
mod figures;
mod noise;
mod planned;
mod report;

use self::estimated::EstimatorArguments;
use self::figures::Loops;
use self::noise::Noise;
use self::report::Subject;
use super::arguments::{self, PlotArguments, WRITTEN, mpc_settings};
use super::filters::{self, FilterArguments};
use super::robot::FlyerArguments;
use super::robustness::{self, PlantArguments};
use super::source::Source;
use crate::prelude::*;
use nalgebra::Complex;
use omnidrones::controllers::cascade::Rates;
use omnidrones::controllers::design::{
    AnalysisPoint, ErrorState, LoopMargins, LoopModel, Robustness, Stability, Trim, TrimTarget, trim,
};
use omnidrones::controllers::linear::{
    DiskMargin, HiddenModes, Mode, ON_CIRCLE, Signal, StateSpace, modes, unreachable,
};
use omnidrones::controllers::reference::{Hover, Reference};
use omnidrones::controllers::registry::REGISTRY;
use omnidrones::controllers::{ClosedLoop, FilterSettings, Target};
use omnidrones::dynamics::sensors::{SensorConfig, SensorSet};
use omnidrones::dynamics::spatial::to_euler;
use omnidrones::dynamics::{Disturbance, Gains, Physics, Plant, Vehicle};
use std::f64::consts::PI;

/// What the command is for.
pub const ABOUT: &str = "\
Report what a control engineer asks of a vehicle: the steady flight (hover, or hover in a wind), the modes of the vehicle \
alone, the poles of its control loop, gain, phase, delay and disk margins at every command and at what is measured, and the disk \
margin of all commands at once. The loop is that of the cascade as it flies: sampled, with the rate of every level, its holds and its latency.

With --controller mpc it is that of a model predictive controller where no bound acts: the feedback of its plan about hover, its poles and \
margins, and how long a tick takes on a short flight. It reports configurations too.

With --estimator and --sensors it tells what the loop bears with an estimator in it, beside what it bears on the true state.";

const EXAMPLES: &str = "\
Examples:
  omnidrones design hummingbird                          the report at hover
  omnidrones design hummingbird --wind 8,0,0             as at 8 m/s through still air
  omnidrones design iris --latency 5                     commands 5 steps late
  omnidrones design firefly --gains derived --json       for a program
  omnidrones design hummingbird --spread 0.3 --samples 20   on plants that are not as believed
  omnidrones design iris --filters low_pass:80,notch:150:30   filters of body rates, whose lag is in all margins
  omnidrones design iris --sensors imu:bmi088            how far its noise moves vehicle and commands
  omnidrones design hummingbird --plot loop.svg          loop and sensitivity over frequency
  omnidrones design hummingbird --save model.json        the linear plant, for other tools
  omnidrones design iris --report iris.html              the report as a page, with plots
  omnidrones design hummingbird --controller mpc         of a plan in every tick: feedback, poles, margins, time
  omnidrones design payload --controller mpc             of a drone with a load
  omnidrones design iris --sensors imu:bmi088,motion_capture:optical --estimator ekf   on estimates

Margins are of the loop broken at one point while all other paths stay closed. A disk margin is a change of gain and phase \
at once, in all commands together where it says so (Seiler, Packard and Gahinet 2020): 0.5 stands for a factor of 0.6 to 1.67 \
or 28°. The delay is the first that ends stability, in whole steps: one step less is borne.

--spread judges the same loop on other plants than the law believes in: of random ones the share that is stable, with exact bounds \
(Clopper and Pearson 1934), and the least disk margin at the corners of the box and by a search from the worst of them, with the \
factors of that plant.

Files: --save writes A, B, C, D of one step with the names and units of all signals (.json), or as one table (.csv). --report \
writes one page that needs no other file and no network: all tables, gains, Nyquist curves, poles, steps of the position, \
loop and sensitivity.

--controller mpc: motors answer with the longer of their lags here too. The estimate of disturbances and the latency are left out, \
since a plan begins where commands act. --save writes the plant of a tick, with the errors that the feedback multiplies as states. The \
flight follows the lemniscate of 'fly' for 5 s, with commands as late as the settings say. Times are of this machine.

--sensors gives the controller the truth and the white noise of these sensors: of an imu the gyroscope's in the body rates, of a motion \
capture its own in position and attitude. The table shows standard deviations of states and commands: those of the linear loop, by \
the Lyapunov equation, beside those of a flight. Biases are left out, for they wander; so are lost samples and latency.

JSON: SI units, radians; margins that are not met up to factors of 100 and delays of 128 steps are null. Motors answer with the longer of their lags, up or down.

Exit codes: 0 reported, and the loop is stable; 1 it is not, or does not settle; 2 unusable input or arguments.";

/// Arguments of `design`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("reference", |reference| reference.hide(true)))]
#[command(mut_arg("plot", |plot| plot.help("Draw loop and sensitivity at every command into this file (.png or .svg)")))]
pub struct Arguments {
    #[command(flatten)]
    flyer: FlyerArguments,
    /// Whose loop: cascade or mpc; with --estimator cascade, lqr or lqi
    #[arg(long, value_name = "NAME", default_value = "cascade", help_heading = "Controller")]
    controller: String,
    /// How --controller mpc plans: a file of its settings, as 'fly --help' lists them
    #[arg(long, value_name = "FILE.toml", help_heading = "Controller")]
    mpc: Option<PathBuf>,
    /// Steady wind [m/s] in which the vehicle holds its place
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true, help_heading = "Flight")]
    wind: Option<Vec<f64>>,
    /// Steps of dt by which commands act late
    #[arg(long, value_name = "STEPS", default_value_t = 0, help_heading = "Controller")]
    latency: usize,
    /// Write the linear plant into this file (.json or .csv)
    #[arg(long, value_name = "FILE", group = WRITTEN, help_heading = "Output")]
    save: Option<PathBuf>,
    /// Write the report as one page with plots into this file (.html)
    #[arg(long, value_name = "FILE.html", group = WRITTEN, help_heading = "Output")]
    report: Option<PathBuf>,
    #[command(flatten)]
    estimated: EstimatorArguments,
    #[command(flatten)]
    filters: FilterArguments,
    /// Sensors: KIND[:PRESET],…, or a TOML file with [[sensor]] tables, as of 'fly'
    ///
    /// With --estimator those that it has. Without, the noise of these in what the controller is given (imu, motion_capture): a table of
    /// standard deviations of states and commands in hover, of the linear loop, and flown.
    #[arg(long, value_name = "LIST|FILE.toml", help_heading = "Controller")]
    sensors: Option<String>,
    #[command(flatten)]
    plants: PlantArguments,
    #[command(flatten)]
    output: PlotArguments,
}

/// What was found.
struct Findings {
    trim: Trim,
    plant: StateSpace,
    modes: Vec<Mode>,
    hidden: HiddenModes,
    model: LoopModel,
    stability: Stability,
    rows: Vec<(String, LoopMargins)>,
    /// Of all commands at once, where the loop is stable.
    all: Option<DiskMargin>,
    poles: Vec<Complex<f64>>,
    /// Whether the loop would be stable if motors answered with the shorter of their lags: asked where it is not with the longer.
    with_shorter_lags: bool,
    /// Of the measured body rates.
    filters: Vec<FilterSettings>,
    rates: Rates,
    /// What noise of sensors does, where it is asked for and the loop is stable.
    noise: Option<Noise>,
}

/// What the loop is made of beside the vehicle.
struct Setting<'a> {
    gains: &'a Gains,
    rates: Rates,
    filters: Vec<FilterSettings>,
    latency: usize,
    air: Disturbance<f64>,
    sensors: Vec<SensorConfig>,
    quiet: bool,
}

/// Reports.
pub fn run(a: &Arguments) -> Result<Report> {
    a.flyer.flight.check()?;
    a.output.check()?;
    a.flyer.refuse_reference("design", "Leave it out: linear models are of steady flights.")?;
    if let Some(named) = &a.estimated.estimator {
        return estimated::run(a, named);
    }
    check_controller(&a.controller)?;
    let mpc = mpc_settings(a.mpc.as_deref(), &a.controller)?;
    let save = files::model_file(a.save.as_deref(), a.output.force)?;
    check_report(a)?;
    if a.controller == "mpc" {
        return planned::run(a, mpc, save);
    }
    let source = a.flyer.source()?;
    let (gains, gains_name) = a.flyer.flight.gains(&source.vehicle)?;
    let mut physics = a.flyer.flight.physics();
    let air = match a.wind.as_deref() {
        None => Disturbance::none(),
        Some(&[x, y, z]) if [x, y, z].iter().all(|v| v.abs() <= 100.0) => {
            physics.effects.disturbance = true;
            Disturbance { wind: [x, y, z], ..Disturbance::none() }
        }
        Some(wind) => {
            return Err(Error::value("--wind", format!("{wind:?}"), "three numbers up to 100 m/s", "As 8,0,0."));
        }
    };
    let rates = a.flyer.flight.rates();
    if a.latency > LoopModel::MOST_DELAY {
        let most = format!("0 to {} steps", LoopModel::MOST_DELAY);
        let remedy = format!("It counts steps of dt, here {} ms, not milliseconds.", short(1e3 * physics.dt, 3));
        return Err(Error::limit("--latency", a.latency, most, &remedy));
    }
    let setting = Setting {
        gains: &gains,
        rates,
        filters: a.filters.settings()?,
        latency: a.latency,
        air,
        sensors: a.sensors.as_deref().map_or(Ok(Vec::new()), arguments::sensors)?,
        quiet: a.output.json,
    };
    let found = match findings(&source.vehicle, physics, &setting) {
        Err(error) if does_not_settle(&error) => return Ok(unsettled(&source, &gains_name, &error, a.output.json)),
        found => found?,
    };
    let stable = found.stability.is_stable();
    let plants = a.plants.judge(&source.vehicle, &gains, (&physics, &rates, &found.filters), (a.latency, &air))?;
    if let Some((file, as_json)) = save {
        let text = if as_json { format!("{:#}\n", found.plant.to_json()) } else { found.plant.to_csv() };
        files::replace(file, text.as_bytes())?;
        files::note_saved(file);
    }
    draw(a, &source, (&gains, &gains_name), (&found, plants.as_ref()), stable)?;
    let written: Vec<PathBuf> = a.output.plot.iter().chain(&a.save).chain(&a.report).cloned().collect();
    if a.output.json {
        let mut value = as_json(&source.vehicle, &gains_name, &found, stable, &written);
        value["plants"] = json!(plants);
        return Ok(Report::json(&value, stable));
    }
    let mut page = Page::new();
    page.title(&source.vehicle.name, &source.origin);
    tell(&mut page, &gains_name, a, &found, stable);
    if let Some(plants) = &plants {
        robustness::tell(&mut page, plants);
    }
    page.written(&written);
    Ok(Report::page(&page, stable))
}

/// Whether a loop never came to rest, so that there is nothing to linearise.
fn does_not_settle(error: &Error) -> bool {
    matches!(error, Error::Value { what, limit, .. } if what.starts_with("loop of") && limit == "steady")
}

fn unsettled(source: &Source, gains: &str, error: &Error, as_json: bool) -> Report {
    if as_json {
        let value = json!({
            "command": "design", "vehicle": source.vehicle.name, "gains": gains, "stable": false, "error": error.to_string(),
        });
        return Report::json(&value, false);
    }
    let mut page = Page::new();
    page.title(&source.vehicle.name, &source.origin);
    page.line(format!("\nFAILED: {error}"));
    Report::page(&page, false)
}

/// Refuses a controller whose loop is not judged here.
fn check_controller(name: &str) -> Result<()> {
    let judged = ["cascade", "mpc"];
    if judged.contains(&name) {
        return Ok(());
    }
    if REGISTRY.iter().all(|entry| entry.name != name) {
        let known = judged.map(String::from).to_vec();
        return Err(Error::Unknown { kind: "controller of 'design'", name: name.into(), known });
    }
    let remedy = match name {
        "lqr" | "lqi" => "With --estimator it is judged too. 'omnidrones fly' flies it.",
        "mpc_indi" => "Take mpc: its plan is the same, but the increments between plan and rotors are left out.",
        _ => "Take one of them. 'omnidrones fly' and 'omnidrones recover' fly the others.",
    };
    Err(Error::value("--controller", name, "cascade or mpc in 'design'", remedy))
}

/// Refuses a report that cannot be written, before any work.
fn check_report(a: &Arguments) -> Result<()> {
    let Some(file) = &a.report else { return Ok(()) };
    if file.extension().is_none_or(|e| !e.eq_ignore_ascii_case("html")) {
        return Err(Error::value("--report", file.display(), "a file .html", "Name it so."));
    }
    files::check_new(file, a.output.force)?;
    files::make_parent(file)
}

/// Writes the figure and the report that were asked for.
fn draw(
    a: &Arguments,
    source: &Source,
    (gains, gains_name): (&Gains, &str),
    (found, plants): (&Findings, Option<&Robustness>),
    stable: bool,
) -> Result<()> {
    if a.output.plot.is_none() && a.report.is_none() {
        return Ok(());
    }
    let loops = Loops::of(found)?;
    if let Some(file) = &a.output.plot {
        loops.bode(&source.vehicle.name).save(file)?;
    }
    let Some(file) = &a.report else { return Ok(()) };
    let subject = Subject { arguments: a, source, gains, gains_name, found, loops: &loops, plants, stable };
    files::write_new(file, &subject.html()?, a.output.force)
}

fn findings(
    vehicle: &Vehicle,
    physics: Physics,
    Setting { gains, rates, filters, latency, air, sensors, quiet }: &Setting<'_>,
) -> Result<Findings> {
    vehicle.check_steerable()?;
    let plant = Plant::of_vehicle(vehicle, physics)?;
    SensorSet::new(sensors, physics.dt, &plant.body_names())?;
    let trim = trim(&plant, &TrimTarget { air: *air, ..TrimTarget::hover() })?;
    let linear = ErrorState::of_plant(&plant)?.state_space(&plant, &trim.state, &trim.input, trim.yaw_rate)?;
    let hover = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
    let closed_with = |vehicle: &Vehicle| {
        ClosedLoop::of_vehicle(vehicle, physics, gains, rates)?.with_filters(filters)?.with_latency(*latency)
    };
    let model_of =
        |vehicle: &Vehicle| LoopModel::of_vehicle(closed_with(vehicle)?, Target::level(&hover), air, &trim.state);
    let model = model_of(vehicle)?;
    let poles = model.poles()?;
    let stability = model.stability()?;
    let with_shorter_lags = match (stability.is_stable(), shorter_lags(vehicle)) {
        (false, Some(quicker)) => model_of(&quicker).and_then(|model| model.stability()).is_ok_and(|s| s.is_stable()),
        _ => false,
    };
    // a loop that is not stable has no margins to list
    let stable = stability.is_stable();
    let rows = if stable { margins(&model, *quiet)? } else { Vec::new() };
    let noise = match stable && !sensors.is_empty() {
        true => Some(Noise::of(sensors, &model, &closed_with(vehicle)?, air, &trim.state)?),
        false => None,
    };
    Ok(Findings {
        noise,
        filters: filters.clone(),
        rates: *rates,
        modes: modes(&linear)?,
        hidden: out_of_reach(&linear)?,
        stability,
        all: if stable { Some(model.disk_margin(AnalysisPoint::Commands, 0.0)?) } else { None },
        poles,
        plant: linear,
        trim,
        model,
        rows,
        with_shorter_lags,
    })
}

/// The vehicle whose motors have the shorter of their lags both ways; none where they have but one.
fn shorter_lags(vehicle: &Vehicle) -> Option<Vehicle> {
    let mut quicker = vehicle.clone();
    for rotor in &mut quicker.rotors {
        let lag = rotor.time_constant_up.min(rotor.time_constant_down);
        (rotor.time_constant_up, rotor.time_constant_down) = (lag, lag);
    }
    (quicker != *vehicle).then_some(quicker)
}

/// What the loop bears at every command and at the first dozen of measurements.
fn margins(model: &LoopModel, quiet: bool) -> Result<Vec<(String, LoopMargins)>> {
    let commands = (0..model.commands.len()).map(|i| (model.commands[i].name.clone(), AnalysisPoint::Command(i)));
    let measured = (0..model.measurements.len().min(12))
        .map(|i| (model.measurements[i].name.clone(), AnalysisPoint::Measurement(i)));
    let all: Vec<(String, AnalysisPoint)> = commands.chain(measured).collect();
    let bar = progress::bar(all.len() as u64, "margins", quiet);
    let rows = all.into_iter().map(|(name, point)| {
        let found = (name, model.margins(point)?);
        bar.inc(1);
        Ok(found)
    });
    let rows = rows.collect();
    bar.finish_and_clear();
    rows
}

fn tell(page: &mut Page, gains: &str, a: &Arguments, found: &Findings, stable: bool) {
    page.heading("Steady flight").facts(trim_facts(a, found));
    page.heading("Modes of the vehicle alone").table(modes_table(&found.modes, &found.plant));
    page.line(format!("  {}", reach(&found.hidden, &found.plant)));
    page.heading("Control loop").facts(loop_facts(gains, a, found, stable));
    if stable {
        page.heading("Margins").table(margins_table(found));
        page.line(format!("  Searched up to factors of 100 and delays of {} steps.", LoopModel::MOST_DELAY));
        if let Some(noise) = &found.noise {
            noise.tell(page);
        }
    } else {
        page.line(failed(&found.stability));
        if found.with_shorter_lags {
            page.line(SWITCHING);
        }
    }
}

/// What holds it there.
fn trim_facts(a: &Arguments, found: &Findings) -> Vec<Fact> {
    let trim = &found.trim;
    let [roll, pitch, _] = to_euler([6, 7, 8, 9].map(|k| trim.state[k])).map(degrees);
    let commands: Vec<String> = trim.input[..found.model.commands.len()].iter().map(|u| short(*u, 3)).collect();
    let air = a.wind.as_ref().map_or("still air".into(), |w| {
        format!("wind {} m/s", w.iter().map(|v| short(*v, 3)).collect::<Vec<_>>().join(", "))
    });
    vec![
        Fact::new("hover in", air),
        Fact::new("roll, pitch", format!("{}, {}°", short(tidy(roll), 3), short(tidy(pitch), 3))),
        Fact::new("commands", commands.join(", ")).note("−1 stands, 1 is full thrust"),
        Fact::new("at a limit", trim.limited.len().to_string()),
    ]
}

/// Of a loop that is stable with the one lag and not with the other.
const SWITCHING: &str = "That is with the longer of the motors' lags, up or down; with the shorter it is stable. A flight switches between \
the two and may settle: 'fly' tells, from a start beside hover.";

/// Why there are no margins.
fn failed(stability: &Stability) -> String {
    let why = match stability {
        Stability::Marginal(_) => format!("the loop is {stability}"),
        _ => "the loop is not stable".into(),
    };
    format!("\nFAILED: {why}, so that there are no margins.")
}

/// What commands do not reach: gusts, which are inputs too, command nothing.
pub fn out_of_reach(plant: &StateSpace) -> Result<HiddenModes> {
    let names = |signals: &[Signal]| signals.iter().map(|s| s.name.clone()).collect::<Vec<_>>();
    let (inputs, outputs) = (names(plant.inputs()), names(plant.outputs()));
    let commands: Vec<&str> = inputs.iter().map(String::as_str).filter(|name| is_command(name)).collect();
    unreachable(&plant.select(&commands, &outputs.iter().map(String::as_str).collect::<Vec<_>>())?)
}

/// Whether an input of a plant is a command.
pub fn is_command(name: &str) -> bool {
    name.ends_with(".action") || name.ends_with(".command")
}

/// What commands reach of the state, and which combinations they do not.
pub fn reach(hidden: &HiddenModes, plant: &StateSpace) -> String {
    let all = format!("commands reach {} of {} directions of the state", hidden.reached, plant.n_state());
    match hidden.names(plant.states()) {
        names if names.is_empty() => all,
        names => format!("{all}, not {}", names.join(", ")),
    }
}

/// Its clock, whether it is stable, what all commands together bear.
fn loop_facts(gains: &str, a: &Arguments, found: &Findings, stable: bool) -> Vec<Fact> {
    let model = &found.model;
    let mut facts = vec![
        Fact::new("gains", gains),
        Fact::new("period of all rates", format!("{} steps of {} ms", model.period(), short(model.dt * 1e3, 3))),
        Fact::new("latency", format!("{} steps", a.latency)),
        Fact::new("stable", if stable { "yes" } else { "NO" }),
        match &found.stability {
            Stability::Stable => {
                let decay = found.poles.iter().map(|p| p.norm()).filter(|p| *p < 1.0 - ON_CIRCLE).fold(0.0, f64::max);
                let lasting = -model.dt * model.period() as f64 / decay.ln();
                Fact::new("slowest pole decays in", format!("{} s", unlimited(lasting, 3))).note("to 1/e")
            }
            Stability::Marginal(what) => Fact::new("does not settle", what.join(", ")),
            Stability::Unstable { growth, .. } => {
                Fact::new("worst pole grows in", format!("{} s", unlimited(1.0 / growth, 3))).note("by e")
            }
        },
    ];
    facts.extend(found.all.as_ref().map(all_commands));
    let at = facts.len().min(3);
    facts.splice(at..at, filters::fact(&found.filters, found.rates.rate));
    facts
}

/// What the loop bears in all commands at once.
fn all_commands(disk: &DiskMargin) -> Fact {
    Fact::new("disk margin, all commands", short(disk.alpha, 3)).note(format!(
        "gains {} to {} or phases of {}° in every command at once, met at {} rad/s",
        short(disk.gain.0, 3),
        unlimited(disk.gain.1, 3),
        short(degrees(disk.phase), 3),
        short(disk.omega, 3)
    ))
}

/// What the loop bears, broken at one point.
fn margins_table(found: &Findings) -> Table {
    let mut table = Table::new("broken at | >gain down | >gain up | >phase [°] | >delay [ms] | >disk | >at [rad/s]");
    let longest = LoopModel::MOST_DELAY as f64 * found.model.dt * 1e3;
    for (name, m) in &found.rows {
        table.row([
            name.clone(),
            short(m.gain_down, 3),
            beyond(m.gain_up, 100.0),
            unlimited(degrees(m.phase), 3),
            beyond(m.delay * 1e3, longest),
            short(m.disk.alpha, 3),
            unlimited(m.disk.omega, 3),
        ]);
    }
    table
}

/// Below it a rate or an angle is what rounding left of 0.
const NOTHING: f64 = 1e-9;

/// The value, or 0 for what rounding left of it.
pub fn tidy(value: f64) -> f64 {
    if value.abs() < NOTHING { 0.0 } else { value }
}

/// Rate, frequency, damping and time constant of each mode, and the states that take part most.
pub fn modes_table(modes: &[Mode], plant: &StateSpace) -> Table {
    Table::new(">rate [1/s] | >frequency [rad/s] | >damping | >time constant [s] | of").filled(modes.iter().map(
        |mode| {
            let names: Vec<&str> = mode.states.iter().take(3).map(|(i, _)| plant.states()[*i].name.as_str()).collect();
            let rate = if mode.rate.im.abs() > 1e-9 {
                format!("{} ± {}j", short(mode.rate.re, 3), short(mode.rate.im, 3))
            } else {
                short(tidy(mode.rate.re), 3)
            };
            [
                rate,
                short(tidy(mode.frequency), 3),
                if mode.frequency < NOTHING { "–".into() } else { short(mode.damping, 2) },
                unlimited(if mode.frequency < NOTHING { f64::INFINITY } else { mode.time_constant }, 3),
                names.join(", "),
            ]
        },
    ))
}

/// A mode for JSON, with the names of a model's states.
pub fn mode_json(plant: &StateSpace) -> impl Fn(&Mode) -> Value {
    |m: &Mode| {
        json!({
            "rate": [m.rate.re, m.rate.im], "frequency": m.frequency, "damping": m.damping, "time_constant": m.time_constant,
            "states": m.states.iter().map(|(i, share)| json!({ "name": plant.states()[*i].name, "share": share })).collect::<Vec<_>>(),
        })
    }
}

fn disk_json(d: &DiskMargin) -> Value {
    json!({ "alpha": d.alpha, "omega": d.omega, "gain": [d.gain.0, d.gain.1], "phase": d.phase })
}

fn margins_json((name, m): &(String, LoopMargins)) -> Value {
    json!({
        "at": name, "gain_down": m.gain_down, "gain_up": m.gain_up, "phase": m.phase, "delay": m.delay, "disk": disk_json(&m.disk),
    })
}

fn as_json(vehicle: &Vehicle, gains: &str, found: &Findings, stable: bool, written: &[PathBuf]) -> Value {
    let rows: Vec<Value> = found.rows.iter().map(margins_json).collect();
    json!({
        "command": "design", "vehicle": vehicle.name, "gains": gains, "stable": stable, "stability": found.stability, "stable_with_shorter_lags": stable || found.with_shorter_lags, "dt": found.model.dt, "period": found.model.period(),
        "trim": { "state": found.trim.state, "input": found.trim.input, "residual": found.trim.residual, "limited": found.trim.limited },
        "modes": found.modes.iter().map(mode_json(&found.plant)).collect::<Vec<_>>(),
        "reached": found.hidden.reached, "out_of_reach": found.hidden.names(found.plant.states()),
        "poles": found.poles.iter().map(|p| [p.re, p.im]).collect::<Vec<_>>(),
        "all_commands": found.all.as_ref().map(disk_json), "margins": stable.then_some(rows),
        "filters": found.filters, "noise": found.noise.as_ref().map(Noise::json), "files": files::names(written),
    })
}

fn degrees(radians: f64) -> f64 {
    radians * 180.0 / PI
}

/// What was not found up to `most`.
fn beyond(value: f64, most: f64) -> String {
    if value.is_finite() { short(value, 3) } else { format!("> {}", short(most, 3)) }
}

fn unlimited(value: f64, digits: usize) -> String {
    if value.is_finite() { short(value, digits) } else { "∞".into() }
}
