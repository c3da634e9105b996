//! `omnidrones fly`: a vehicle along a reference, its derivatives certified, its flight drawn.

use super::arguments::{FlightArguments, FormatName, VehicleArguments};
use super::failure::{FailureArguments, Story};
use super::page::{Fact, Page, duration, length, short};
use super::sheet::{KeyFigures, key_facts};
use super::source::{self, Source};
use super::table::{Align, Table, number};
use super::{Report, arguments, files, fly_rig, progress, rig};
use omnidrones::autodiff::{Bounds, Certificate, JacobianScratch, System, certify, jacobian};
use omnidrones::controllers::design::{Sensitivity, sensitivity};
use omnidrones::controllers::{ClosedLoop, Flight, FlightPlan, SmoothPoint, Tilt, fly};
use omnidrones::dynamics::aero::wind::Wind;
use omnidrones::dynamics::{Effects, Gains, Multirotor, Vehicle};
use omnidrones::error::{Error, Result};
use omnidrones::flight::{FlightSummary, LOST};
use omnidrones_plot::flight::FlightFigures;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::time::Instant;

/// Seconds left out of the RMSE: the reference starts with a jump of acceleration.
const TRANSIENT: f64 = 2.0;

/// What the command is for.
pub const ABOUT: &str = "\
Fly a vehicle, or a configuration of several bodies, closed loop along a reference. The flight starts on the reference, at rest; position, velocity, attitude \
and rate controllers compute at their own rates. Prints what the vehicle is, how well it tracked, and, for a single \
vehicle, a certificate that the derivatives of the very equations it flew are exact; writes plots.

Configurations have controllers by their make: one drone with a load has optimal feedback of the whole state (payload, \
inverted_pendulum), a load under several drones is tracked itself (transport), thrusters that tilt and drones on the joints of \
a frame hold position and attitude apart (omav_tilting, dragon, platform): --roll and --pitch turn them. They follow a slow \
lemniscate, high enough for what hangs below. Anything falls to the ground with --drop.

'omav' is a rigid vehicle that flies like any other; with --roll or --pitch it is flown as 'omav_tilting', the same machine with \
its tilts free.";

const EXAMPLES: &str = "\
Examples:
  omnidrones fly                                      a quadrotor read from URDF
  omnidrones fly crazyflie --reference circle         a built-in vehicle on a circle
  omnidrones fly drone.urdf --rotors drone.toml       your vehicle, with these rotor data
  omnidrones fly iris --wind 4,0,0                    a steady wind of 4 m/s along x
  omnidrones fly iris --wind dryden:7.7 --seed 3      7.7 m/s with gusts (light turbulence)
  omnidrones fly firefly --gains out/firefly/gains.toml --format svg
  omnidrones fly hummingbird --json --no-plots --max-rmse 0.1
  omnidrones fly firefly --reference hover --fail 1   a rotor stops at 3 s; it flies on, without yaw
  omnidrones fly iris --fail 0:0.8 --at 5             a rotor keeps 80 % of its thrust from 5 s on
  omnidrones fly transport --reference hover          four drones hold a box
  omnidrones fly omav --roll 30 --reference hover     30° of roll, held in place
  omnidrones fly platform --roll 20                   a frame that flies on with 20° of roll
  omnidrones fly dragon --shape arc:30                a chain that bends while it flies
  omnidrones fly payload --effects downwash,contact   with these effects
  omnidrones fly payload --drop=0.5                   falls half a metre to the ground

Files in --out: overview, path, error, rotors, attitude (.png or .svg), and with --csv flight.csv (one line per step, \
units in the header). Of a configuration also joints (angles) and with --csv joints.csv; of a drop only drop, drop.csv.

The tracking RMSE is the root mean square distance to the reference after the first 2 s (over the whole flight if it is \
no longer than that).

JSON: SI units, radians; thrusts and saturation as shares of 1; null where a number does not exist.

Exit codes: 0 flown; 1 the flight diverged, its reference was lost (farther than 5 m in the end), its RMSE is not finite or above --max-rmse, or a failure took the vehicle \
more than 10 m away; 2 unusable input or arguments.";

/// Arguments of `fly`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// A vehicle ('omnidrones models'), a configuration ('omnidrones show'), or a file FILE.toml or FILE.urdf
    ///
    /// Without it, a quadrotor of 0.67 kg that this program carries as URDF. 'omav' is the rigid vehicle, 'omav_tilting'
    /// the one whose rotor units tilt.
    #[arg(value_name = "VEHICLE|CONFIG|FILE")]
    pub(super) vehicle: Option<String>,
    #[command(flatten)]
    pub(super) rotors: VehicleArguments,
    #[command(flatten)]
    pub(super) flight: FlightArguments,
    /// Drop it from this height above the ground instead, rotors idle [default: 1]
    ///
    /// Bodies touch the ground at z = 0 and what is not joined to them. --seed disturbs the start a little.
    #[arg(long, value_name = "METRES", num_args = 0..=1, require_equals = true, default_missing_value = "1",
          allow_negative_numbers = true, help_heading = "Flight")]
    pub(super) drop: Option<f64>,
    /// Roll to hold beside the reference, -180 to 180 [degrees]; omav, dragon and platform only
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_negative_numbers = true, help_heading = "Flight")]
    pub(super) roll: f64,
    /// Pitch to hold beside the reference, -90 to 90 [degrees]; omav, dragon and platform only
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_negative_numbers = true, help_heading = "Flight")]
    pub(super) pitch: f64,
    /// When to turn to --roll and --pitch, and over how long [s]; a step unless told how long
    #[arg(long, value_name = "AT[:RAMP]", default_value = "1", value_parser = arguments::tilt_at, help_heading = "Flight")]
    pub(super) tilt_at: [f64; 2],
    /// Shape that a chain takes in flight: straight, arc, zigzag, or arc:DEGREES [default: straight]; dragon only
    #[arg(long, value_name = "SHAPE", help_heading = "Flight")]
    pub(super) shape: Option<String>,
    /// Length of the flight [s] [default: 15, or to 2 s after the last waypoint; configurations 20, drops 3]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, help_heading = "Flight")]
    pub(super) duration: Option<f64>,
    /// Wind [m/s]: none, X,Y,Z, dryden:W20, or dryden:W20:X,Y,Z
    ///
    /// X,Y,Z is a steady velocity of the air in world axes. dryden adds turbulence (MIL-F-8785C, low altitude) for a
    /// wind speed W20 at 20 ft: 7.7 light, 15 moderate, 23 severe; around a mean wind of W20 along x, or X,Y,Z. Wind
    /// acts through drag: a vehicle without drag coefficients does not feel it.
    #[arg(long, value_name = "WIND", default_value = "none", value_parser = arguments::wind, allow_hyphen_values = true,
          help_heading = "Flight")]
    pub(super) wind: Wind,
    /// Seed of the gusts, and of the start of a drop
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Flight")]
    pub(super) seed: u64,
    #[command(flatten)]
    pub(super) failure: FailureArguments,
    /// Exit with 1 if the tracking RMSE exceeds this [m]
    #[arg(long, value_name = "METRES", allow_negative_numbers = true, help_heading = "Flight")]
    pub(super) max_rmse: Option<f64>,
    /// Folder for what is written [default: out/VEHICLE]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    pub(super) out: Option<PathBuf>,
    /// File type of the plots
    #[arg(long, value_name = "TYPE", default_value = "png", help_heading = "Output")]
    pub(super) format: FormatName,
    /// Draw nothing
    #[arg(long, help_heading = "Output")]
    pub(super) no_plots: bool,
    /// Write every step to flight.csv
    #[arg(long, help_heading = "Output")]
    pub(super) csv: bool,
    /// Print one JSON object and nothing else
    #[arg(long, help_heading = "Output")]
    pub(super) json: bool,
}

impl Arguments {
    /// The vehicle that was named; one that is to hold a tilt, with its tilts free.
    pub(super) fn named(&self) -> Option<&str> {
        match self.vehicle.as_deref() {
            Some(named) if named.eq_ignore_ascii_case("omav") && self.turns() && self.drop.is_none() => {
                Some("omav_tilting")
            }
            named => named,
        }
    }

    fn turns(&self) -> bool {
        self.roll != 0.0 || self.pitch != 0.0
    }

    /// What to hold beside the reference.
    pub(super) fn tilt(&self) -> Result<Tilt> {
        let [at, ramp] = self.tilt_at;
        for (what, value, most) in [("--roll", self.roll, 180.0), ("--pitch", self.pitch, 90.0)] {
            if value.is_nan() || value.abs() > most {
                let rule = format!("within ±{most}");
                return Err(Error::value(what, format!("{value}°"), rule, "Give it in degrees."));
            }
        }
        let tilt = Tilt { roll: self.roll.to_radians(), pitch: self.pitch.to_radians(), at, ramp };
        tilt.validate()?;
        Ok(tilt)
    }

    /// Refuses a tilt or a shape for what has neither.
    pub(super) fn level(&self) -> Result<()> {
        let what = if self.shape.is_some() { "--shape" } else { "--roll or --pitch" };
        if !self.turns() && self.shape.is_none() {
            return Ok(());
        }
        let (value, rule) = ("for what does not tilt its thrusters", "left out");
        Err(Error::value(what, value, rule, "omav_tilting, dragon and platform hold a tilt, dragon takes a shape."))
    }
}

/// Flies.
pub fn run(a: &Arguments) -> Result<Report> {
    if let Some(limit) = a.max_rmse.filter(|m| !(*m > 0.0 && m.is_finite())) {
        return Err(Error::value("--max-rmse", limit, "> 0 m", "Leave it out to accept any finite error."));
    }
    a.flight.check()?;
    let configuration = a.named().is_some_and(|named| rig::configuration(named).is_some());
    if configuration || a.drop.is_some() {
        if !a.failure.fail.is_empty() {
            let limit = "a single vehicle that flies";
            return Err(Error::value("--fail", "a configuration or a drop", limit, "Name a vehicle, without --drop."));
        }
        return fly_rig::run(a);
    }
    a.level()?;
    if let Some(named) = &a.vehicle {
        rig::known(named)?;
    }
    alone(&a.flight.physics().effects)?;
    let source = source::load(a.vehicle.as_deref(), &a.rotors)?;
    let mut plan = a.flight.plan(a.duration, a.wind.clone(), a.seed)?;
    plan.failures = a.failure.of(&source.vehicle)?;
    plan.detection_delay = a.failure.detection;
    let n_step = plan.n_step()?;
    let (gains, gains_name) = a.flight.gains(&source.vehicle)?;
    let writes = a.csv || !a.no_plots;
    let folder = a.out.clone().unwrap_or_else(|| files::default_folder(&source.vehicle.name));
    // checks vehicle, gains and rates before any folder is made
    ClosedLoop::new(&source.vehicle, plan.physics, &gains, &plan.rates)?;
    if writes {
        files::prepare_folder(&folder)?;
    }

    let bar = progress::bar(n_step, "flying", a.json);
    let start = Instant::now();
    let flight = fly(&source.vehicle, &gains, &plan, &mut |k| {
        if k % 512 == 0 {
            bar.set_position(k);
        }
    })?;
    let wall_time = start.elapsed().as_secs_f64();
    bar.finish_and_clear();

    let derivatives = Derivatives::of(&source.vehicle, &gains, &plan, &flight)?;
    let story = Story::of(&source.vehicle, &plan, &flight)?;

    let after = if plan.duration > TRANSIENT { TRANSIENT } else { 0.0 };
    let summary = flight.log.summary(after);
    let mut written = Vec::new();
    if !a.no_plots {
        let spinner = progress::spinner("drawing", a.json);
        let mut figures = FlightFigures::new(&flight.log, after);
        for (at, name) in story.iter().flat_map(Story::events) {
            figures = figures.event(&name, at);
        }
        written.extend(figures.save(&folder, a.format.extension())?);
        spinner.finish_and_clear();
    }
    if a.csv {
        let path = folder.join("flight.csv");
        let spinner = progress::spinner("writing CSV", a.json);
        flight.log.write_csv(&path)?;
        spinner.finish_and_clear();
        written.push(path);
    }
    let result = Flown { source, plan, gains, gains_name, derivatives, story, flight, summary, wall_time, written };
    let verdict = result.verdict(a.max_rmse);
    if a.json {
        return Ok(Report::json(&result.json(&verdict), verdict.is_ok()));
    }
    Ok(Report { success: verdict.is_ok(), text: result.page(&verdict) })
}

/// Refuses effects that need more than one rigid vehicle.
fn alone(effects: &Effects) -> Result<()> {
    let wrong = [("contact", effects.contact, "Drop it with --drop."), ("downwash", effects.downwash, "Leave it out.")];
    match wrong.into_iter().find(|(_, on, _)| *on) {
        None => Ok(()),
        Some((name, _, remedy)) => Err(Error::value(
            "--effects",
            format!("{name} for a single vehicle in flight"),
            "used with a configuration",
            remedy,
        )),
    }
}

struct Flown {
    source: Source,
    plan: FlightPlan,
    gains: Gains,
    gains_name: String,
    derivatives: Derivatives,
    story: Option<Story>,
    flight: Flight,
    summary: FlightSummary,
    wall_time: f64,
    written: Vec<PathBuf>,
}

impl Flown {
    /// Whether it flew, or why not.
    fn verdict(&self, max_rmse: Option<f64>) -> std::result::Result<(), String> {
        if let Some(t) = self.flight.diverged_at {
            return Err(format!(
                "the flight diverged at {} s: gains too high for dt, or a reference beyond the vehicle",
                short(t, 4)
            ));
        }
        if let Some(reason) = self.story.as_ref().and_then(Story::lost) {
            return Err(reason);
        }
        tracked(&self.summary, max_rmse)
    }

    /// Simulated over real time.
    fn speed(&self) -> f64 {
        self.summary.duration / self.wall_time.max(1e-9)
    }

    fn page(&self, verdict: &std::result::Result<(), String>) -> String {
        let mut page = Page::new();
        self.source.describe(&mut page);
        page.heading("Vehicle").facts(&key_facts(&self.source.vehicle));
        page.heading("Flight").facts(&self.facts());
        if let Some(story) = &self.story {
            story.page(&mut page, &self.source.vehicle, &self.plan);
        }
        page.heading("Derivatives of what was flown");
        if !self.derivatives.certificates.is_empty() {
            page.table(&self.derivatives.table());
            page.line(self.derivatives.remark());
        }
        if let Some(line) = self.derivatives.gradient_line() {
            page.line(&line);
        }
        for remark in &self.derivatives.left_out {
            page.line(format!("  left out: {remark}"));
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
        let from =
            if s.rmse_after > 0.0 { format!("after the first {} s", s.rmse_after) } else { "whole flight".into() };
        let rates = &plan.rates;
        let hz = |rate: f64| short(rate, 4);
        let (gains, file) = match self.gains_name.as_str() {
            known @ ("published" | "derived") => (known, String::new()),
            file => ("from a file", format!("{file}; ")),
        };
        let mut facts = vec![
            Fact::new("reference", plan.reference.name()).note(plan.reference.description()),
            Fact::new("simulated", format!("{} s", short(s.duration, 5))).note(format!(
                "{} steps of {} in {}: {} × real time",
                s.samples.saturating_sub(1),
                duration(plan.physics.dt),
                duration(self.wall_time),
                short(self.speed(), 3)
            )),
            Fact::new("gains", gains).note(format!(
                "{file}rate {} Hz, attitude {} Hz, velocity and position {} Hz",
                hz(rates.rate),
                hz(rates.attitude),
                hz(rates.velocity)
            )),
        ];
        if let Some((kind, wind)) = describe_wind(&plan.wind) {
            facts.push(Fact::new("wind", kind).note(wind));
        }
        let with_start = match (s.max_error, s.max_error_overall) {
            (Some(late), Some(overall)) if overall > late => format!("{} with the start", length(overall)),
            _ => String::new(),
        };
        facts.extend([
            Fact::new("tracking RMSE", length(s.rmse)).note(from),
            Fact::new("largest error", length(s.max_error)).note(with_start),
            Fact::new("top speed", format!("{} m/s", number(s.max_speed, 2))),
            Fact::new("largest tilt", format!("{}°", number(s.max_tilt.map(f64::to_degrees), 1))),
            Fact::new("rotors at a limit", format!("{} %", number(s.saturation.map(|v| 100.0 * v), 1)))
                .note("of all commands"),
        ]);
        facts
    }

    fn json(&self, verdict: &std::result::Result<(), String>) -> Value {
        json!({
            "command": "fly",
            "version": env!("CARGO_PKG_VERSION"),
            "success": verdict.is_ok(),
            "failure": verdict.as_ref().err(),
            "vehicle": KeyFigures::of(&self.source.vehicle).json(&self.source.vehicle),
            "source": self.source.json(),
            "plan": self.plan,
            "gains": self.gains,
            "gains_from": self.gains_name,
            "flight": self.summary,
            "diverged_at": self.flight.diverged_at,
            "failures": self.story.as_ref().map(|s| s.json(&self.source.vehicle)),
            "wall_time": self.wall_time,
            "times_real_time": self.speed(),
            "derivatives": self.derivatives.json(),
            "sensitivity": self.derivatives.through.as_ref().map(|(s, _)| s),
            "left_out": self.derivatives.left_out,
            "files": files::names(&self.written),
        })
    }
}

fn describe_wind(wind: &Wind) -> Option<(&'static str, String)> {
    let three = |v: &[f64; 3]| super::sheet::vector(v, 3);
    match wind {
        Wind::Calm => None,
        Wind::Constant { velocity } => Some(("steady", format!("{} m/s", three(velocity)))),
        Wind::Sinusoid(s) => {
            Some(("sinusoidal", format!("{} harmonics around {} m/s", s.frequencies.len(), three(&s.mean))))
        }
        Wind::Dryden(d) => {
            let gusts = d.intensity().map(|s| short(s, 2)).join(", ");
            Some(("Dryden", format!("mean {} m/s, gusts of {gusts} m/s rms along, across, up", three(&d.mean))))
        }
    }
}

/// Whether a flight kept to its reference, or why not.
pub fn tracked(summary: &FlightSummary, max_rmse: Option<f64>) -> std::result::Result<(), String> {
    if let Some(since) = summary.lost_at {
        let far = length(summary.max_error_overall);
        return Err(format!(
            "the reference was lost: farther than {} from {} s to the end, {far} at most",
            length(LOST),
            short(since, 3)
        ));
    }
    match (summary.rmse, max_rmse) {
        (None, _) => Err("the tracking RMSE is not finite".into()),
        (Some(rmse), Some(limit)) if rmse > limit => {
            Err(format!("the tracking RMSE of {} exceeds --max-rmse {}", length(rmse), length(limit)))
        }
        _ => Ok(()),
    }
}

/// One system's Jacobian at a point, derived three ways.
struct Row {
    what: &'static str,
    rows: usize,
    columns: usize,
    time: f64,
    certificate: Certificate,
}

/// Certificates at the point of the flight farthest from kinks, and the gradient of its error through all of it.
struct Derivatives {
    certificates: Vec<Row>,
    through: Option<(Sensitivity, f64)>,
    /// What was left out, and why.
    left_out: Vec<String>,
}

impl Derivatives {
    fn of(vehicle: &Vehicle, gains: &Gains, plan: &FlightPlan, flight: &Flight) -> Result<Self> {
        let mut d = Self { certificates: Vec::new(), through: None, left_out: Vec::new() };
        if flight.diverged_at.is_some() {
            d.left_out.push("the flight diverged: there is no finite point to differentiate at".into());
            return Ok(d);
        }
        if !plan.failures.is_empty() {
            d.left_out.push("the control law switches at a failure: fly without --fail for derivatives".into());
            return Ok(d);
        }
        let mut physics = plan.physics;
        physics.effects.disturbance |= plan.wind != Wind::Calm;
        let plant = Multirotor::new(vehicle, physics)?;
        let system = ClosedLoop::new(vehicle, physics, gains, &plan.rates)?.with_gains();
        let SmoothPoint { state, input, actions, .. } = &flight.smoothest;
        let body = &state[..plant.n_state()];
        let mut action = actions.clone();
        action.extend(&input[input.len() - (plant.n_input() - actions.len())..]);
        let step = d.small_enough(certified("one step of the vehicle", &plant, body, &action, &[]))?;
        let closed = certified("one step of the closed loop", &system, state, input, &system.gain_vector());
        let closed = d.small_enough(closed)?;
        d.certificates.extend(step.into_iter().chain(closed));
        let start = Instant::now();
        let through = d.small_enough(sensitivity(vehicle, gains, plan))?;
        d.through = through.map(|s| (s, start.elapsed().as_secs_f64()));
        Ok(d)
    }

    /// `None` with a remark where something is too large to record, or a gain is zero.
    fn small_enough<T>(&mut self, result: Result<T>) -> Result<Option<T>> {
        match result {
            Ok(value) => Ok(Some(value)),
            Err(e @ (Error::Limit { .. } | Error::Value { .. })) => {
                let reason = e.to_string();
                if !self.left_out.contains(&reason) {
                    self.left_out.push(reason);
                }
                Ok(None)
            }
            Err(e) => Err(e),
        }
    }

    /// The gain whose relative change moves the RMSE most, in words.
    fn gradient_line(&self) -> Option<String> {
        let (s, time) = self.through.as_ref()?;
        let g = &s.gradient;
        let named = [("position", g.position), ("velocity", g.velocity), ("attitude", g.attitude), ("rate", g.rate)];
        let all = named.iter().flat_map(|(n, v)| ["x", "y", "z"].iter().zip(v).map(move |(a, x)| (*n, *a, *x)));
        let (name, axis, most) = all.max_by(|a, b| a.2.abs().total_cmp(&b.2.abs()))?;
        Some(format!(
            "  gradient of the RMSE over 12 gains, backwards through {} closed-loop steps: {}\n  \
             most felt: {name} gain {axis}, {:+.2} mm for 10 % more",
            s.steps,
            duration(*time),
            most * 1.1_f64.ln() * 1e3
        ))
    }

    fn table(&self) -> Table {
        let mut table = Table::new(&[
            ("Jacobian of", Align::Left),
            ("size", Align::Right),
            ("time", Align::Right),
            ("adjoint − duals", Align::Right),
            ("duals − differences", Align::Right),
            ("Taylor order", Align::Right),
            ("", Align::Left),
        ]);
        for row in &self.certificates {
            let c = &row.certificate;
            let order = c.taylor_order.map_or_else(|| "affine".into(), |order| number(order, 3));
            table.row([
                row.what.to_string(),
                format!("{} × {}", row.rows, row.columns),
                duration(row.time),
                format!("{:.0e}", c.adjoint_error),
                format!("{:.0e}", c.difference_error),
                order,
                if c.holds(Bounds::default()) { "certified".into() } else { "NOT HELD".to_string() },
            ]);
        }
        table
    }

    fn remark(&self) -> &'static str {
        if self.certificates.iter().all(|r| r.certificate.holds(Bounds::default())) {
            "  reverse adjoint, forward duals and finite differences agree (relative); order 2 is exact"
        } else {
            "  not held: the point lies on a kink (a saturated command), or a derivative is wrong"
        }
    }

    fn json(&self) -> Value {
        let row = |r: &Row| {
            json!({
                "of": r.what,
                "rows": r.rows,
                "columns": r.columns,
                "time": r.time,
                "adjoint_error": r.certificate.adjoint_error,
                "difference_error": r.certificate.difference_error,
                "taylor_order": r.certificate.taylor_order,
                "value_error": r.certificate.value_error,
                "holds": r.certificate.holds(Bounds::default()),
            })
        };
        self.certificates.iter().map(row).collect()
    }
}

fn certified<F: System>(what: &'static str, system: &F, x: &[f64], u: &[f64], theta: &[f64]) -> Result<Row> {
    let certificate = certify(system, x, u, theta)?;
    let (rows, columns) = (system.n_state(), x.len() + u.len() + theta.len());
    let mut scratch = JacobianScratch::new(system);
    let mut entries = vec![0.0; rows * columns];
    // the best of a few: other work on the machine only adds
    let mut time = f64::INFINITY;
    for _ in 0..50 {
        let start = Instant::now();
        jacobian(system, x, u, theta, &mut scratch, &mut entries);
        time = time.min(start.elapsed().as_secs_f64());
    }
    Ok(Row { what, rows, columns, time, certificate })
}
