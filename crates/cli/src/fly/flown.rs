//! What came of a flight: whether it held its reference, its figures and tables, its page and JSON.

use super::around::Approach;
use super::beside::Comparison;
use super::derivatives::Derivatives;
use super::estimate;
use super::{Arguments, What};
use crate::arguments::{Outputs, is_optimal};
use crate::failure::Story;
use crate::filters;
use crate::npz::Npz;
use crate::page::plain_facts;
use crate::prelude::*;
use crate::sheet::{KeyFigures, key_facts, vector};
use omnidrones::controllers::linear::{StepFigures, step_figures};
use omnidrones::controllers::reference::Hover;
use omnidrones::controllers::{Flight, FlightCheck, FlightPlan, Note, Reference, RotorFailure};
use omnidrones::dynamics::aero::wind::Wind;
use omnidrones::dynamics::sensors::{ReadingLayout, SensorConfig};
use omnidrones::dynamics::tree::{Motion, Multibody};
use omnidrones::dynamics::{Plant, Quantity};
use omnidrones::flight::{Commanded, FlightSummary, Scans};
use omnidrones::internals;
use omnidrones_plot::flight::FlightFigures;
use omnidrones_plot::robot::{JointHistory, RobotFigures, joints};
use omnidrones_plot::sensors::sensor_figures;
use std::fmt::Write;

/// Writes figures and tables.
pub(super) fn write(
    a: &Arguments,
    outputs: &mut Outputs,
    plant: &Plant,
    flight: &Flight,
    sensors: &[SensorConfig],
    after: f64,
    story: Option<&Story>,
) -> Result<()> {
    if let Some(extension) = outputs.plots {
        let spinner = progress::spinner("drawing", a.output.json);
        let drawn = match plant.tree() {
            Some(system) => {
                RobotFigures::new(system, &flight.log, &flight.states, after).save(&outputs.folder, extension)?
            }
            None => {
                let events = story.into_iter().flat_map(Story::events);
                let figures = FlightFigures::new(&flight.log, after);
                let figures = events.fold(figures, |figures, (at, name)| figures.event(&name, at));
                figures.save(&outputs.folder, extension)?
            }
        };
        drawn.iter().for_each(|path| files::note_saved(path));
        outputs.written.extend(drawn);
        for (name, figure) in sensor_figures(sensors, &flight.log) {
            outputs.draw(&sensor_file(&name), || figure)?;
        }
        if let Some(found) = &flight.estimates {
            outputs.draw("estimate", || estimate::figure(found, &flight.log))?;
        }
        spinner.finish_and_clear();
    }
    if a.csv {
        let size = flight.log.csv_size();
        let spinner = progress::spinner(&format!("writing CSV, about {}B", count(size as f64)), a.output.json);
        tell_size("flight.csv", size, a);
        outputs.put("flight.csv", |path| flight.log.write_csv(path))?;
        if let Some(system) = plant.tree().filter(|system| !joints(system, &[]).is_empty()) {
            outputs.text("joints.csv", joint_csv(system, flight))?;
        }
        if let Some(found) = &flight.estimates {
            outputs.text("estimate.csv", estimate::csv(found, &flight.log))?;
        }
        for scans in &flight.log.scans {
            let name = format!("{}.csv", sensor_file(&scans.sensor));
            tell_size(&name, scans.csv_size(), a);
            outputs.put(&name, |path| scans.write_csv(path))?;
        }
        spinner.finish_and_clear();
    }
    if a.npz {
        let width = flight.log.csv_header().len() + flight.states.len() / flight.log.len().max(1);
        let scanned: usize = flight.log.scans.iter().map(|scans| scans.readings.len()).sum();
        tell_size("flight.npz", (8 * (width * flight.log.len() + scanned)) as u64, a);
        outputs.put("flight.npz", |path| write_npz(path, plant, flight))?;
    }
    Ok(())
}

/// Larger logs are told of before they are written, bytes.
const LARGE: u64 = 50_000_000;

/// Says how large a log gets before it takes the disk.
fn tell_size(name: &str, bytes: u64, a: &Arguments) {
    if bytes < LARGE || a.output.json {
        return;
    }
    use std::io::Write as _;
    let _ = writeln!(std::io::stderr(), "{name}: about {}B", count(bytes as f64));
}

/// Stem of the files of a sensor, whose name may hold a slash.
fn sensor_file(name: &str) -> String {
    format!("sensor_{}", name.replace('/', "~"))
}

/// Times and readings of a camera or lidar as arrays of its own shape: rows, columns, and channels of a pixel.
fn write_scans(npz: &mut Npz<'_>, scans: &Scans) -> Result<()> {
    let (n, name) = (scans.len(), sensor_file(&scans.sensor));
    let shape = match scans.layout {
        ReadingLayout::Image { height, width, channels } => vec![n, height, width, channels],
        ReadingLayout::Lidar { rows, columns } => vec![n, rows, columns],
        ReadingLayout::Vector => vec![n, scans.channels.len()],
    };
    npz.numbers(&format!("{name}_time"), &[n], &scans.time)?;
    npz.numbers(&name, &shape, &scans.readings)
}

/// Arrays of all samples, with the whole state.
fn write_npz(path: &Path, plant: &Plant, flight: &Flight) -> Result<()> {
    let log = &flight.log;
    let (n, rotors, channels) = (log.len(), log.n_rotor(), log.sensor_channels.len());
    let quantities = plant.state_quantities();
    let named = |all: &[Quantity]| all.iter().map(|q| format!("{} [{}]", q.name, q.unit)).collect::<Vec<String>>();
    Npz::write(path, |npz| {
        npz.texts("vehicle", &[], &[&log.vehicle])?;
        npz.numbers("time", &[n], &log.time)?;
        for (name, rows) in [
            ("position", &log.position),
            ("velocity", &log.velocity),
            ("angular_velocity", &log.angular_velocity),
            ("reference_position", &log.reference_position),
            ("reference_velocity", &log.reference_velocity),
            ("reference_acceleration", &log.reference_acceleration),
            ("wind", &log.wind),
        ] {
            npz.numbers(name, &[n, 3], rows.as_flattened())?;
        }
        npz.numbers("attitude", &[n, 4], log.attitude.as_flattened())?;
        npz.numbers("reference_yaw", &[n], &log.reference_yaw)?;
        for (name, rows) in
            [("rotor_speed", &log.rotor_speed), ("rotor_command", &log.rotor_command), ("thrust", &log.thrust)]
        {
            npz.numbers(name, &[n, rotors], rows)?;
        }
        npz.texts("rotor_names", &[rotors], &plant.rotors().iter().map(|r| &r.name).collect::<Vec<_>>())?;
        if !log.commanded.is_empty() {
            let of = |what: fn(&Commanded) -> Vec<f64>| log.commanded.iter().flat_map(what).collect::<Vec<f64>>();
            npz.numbers("commanded_thrust", &[n], &of(|c| vec![c.thrust]))?;
            npz.numbers("commanded_attitude", &[n, 4], &of(|c| c.attitude.to_vec()))?;
            npz.numbers("commanded_angular_velocity", &[n, 3], &of(|c| c.angular_velocity.to_vec()))?;
        }
        if channels > 0 {
            npz.numbers("sensors", &[n, channels], &log.sensor_readings)?;
            npz.texts("sensors_columns", &[channels], &named(&log.sensor_channels))?;
        }
        log.scans.iter().try_for_each(|scans| write_scans(npz, scans))?;
        npz.numbers("state", &[n, quantities.len()], &flight.states)?;
        npz.texts("state_columns", &[quantities.len()], &named(&quantities))
    })
}

/// Angles and rates of all joints, one line per sample.
fn joint_csv(system: &Multibody, flight: &Flight) -> String {
    let layout = system.layout();
    let own = |i: &usize| layout.bodies[*i].n_freedom == 1;
    let places: Vec<usize> = (0..layout.bodies.len()).filter(own).collect();
    let mut text = String::from("time [s]");
    for i in &places {
        let body = &system.model().bodies()[*i];
        let turns = matches!(body.joint.motion, Motion::Revolute(_));
        let unit = if turns { "rad" } else { "m" };
        let name = &body.joint.name;
        let head =
            [format!("{name} [{unit}]"), format!("{name} rate [{unit}/s]")].map(|own| internals::quoted_cell(&own));
        let _ = write!(text, ",{}", head.join(","));
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

/// A flight, and all that is told of it.
pub(super) struct Flown {
    pub plant: Plant,
    pub what: What,
    /// Name and description.
    pub controller: [String; 2],
    /// What it says about itself.
    pub notes: Vec<Note>,
    pub plan: FlightPlan,
    pub flight: Flight,
    pub summary: FlightSummary,
    /// Of a vehicle.
    pub derivatives: Option<Derivatives>,
    /// Of a vehicle whose rotors fail.
    pub story: Option<Story>,
    /// With an earlier one.
    pub beside: Option<Comparison>,
    pub joints: Vec<JointHistory>,
    /// How it was over the ground, and what befell it.
    pub judgement: FlightCheck,
    /// Where something stands around it.
    pub approach: Option<Approach>,
    /// Whether a policy flew.
    pub learnt: bool,
    /// What may surprise.
    pub warnings: Vec<String>,
    pub wall_time: f64,
    pub written: Vec<PathBuf>,
}

/// Largest and root-mean-square value of a history.
fn extremes(history: &JointHistory) -> [f64; 2] {
    let v = &history.values;
    let most = v.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    [most, (v.iter().map(|x| x * x).sum::<f64>() / v.len().max(1) as f64).sqrt()]
}

impl Flown {
    /// The flight as a page for a browser.
    pub fn replay(&self) -> String {
        let mut recording = omnidrones_viewer::flight(&self.plant, &self.flight, &self.plan);
        let rmse = format!("tracking RMSE {}", length(self.summary.rmse));
        recording.remark = format!("{}, flown by {}   ·   {rmse}", self.plan.reference.name(), self.controller[0]);
        recording.facts = plain_facts(&self.facts(false));
        omnidrones_viewer::page(&format!("{}: a flight", self.plant.name()), &[recording])
    }

    /// The flight for Foxglove and rerun.
    #[cfg(feature = "mcap")]
    pub fn write_mcap(&self, path: &Path) -> Result<()> {
        let (log, flight) = (&self.flight.log, &self.flight);
        let (columns, values): (Vec<String>, Vec<Vec<f64>>) = log.columns().into_iter().unzip();
        let n = (flight.states.len() / log.len().max(1)).max(1);
        let track = omnidrones_viewer::Track {
            times: log.time.clone(),
            states: flight.states.chunks_exact(n).map(<[f64]>::to_vec).collect(),
            goals: log.reference_position.iter().map(|at| vec![*at]).collect(),
            numbers: (0..log.len()).map(|k| values.iter().map(|column| column[k]).collect()).collect(),
        };
        let recording = omnidrones_viewer::flight(&self.plant, flight, &self.plan);
        crate::trajectories::mcap(path, &self.plant, &recording, &columns, &[track])
    }

    /// Simulated over real time.
    fn speed(&self) -> f64 {
        self.summary.duration / self.wall_time.max(1e-9)
    }

    pub fn page(&self, verdict: &std::result::Result<(), String>) -> Page {
        let mut page = Page::new();
        match &self.what {
            What::Vehicle { source, .. } => {
                source.describe(&mut page);
                page.heading("Vehicle").facts(key_facts(&source.vehicle));
            }
            What::Model(robot) => {
                page.title(robot.model.name(), &robot.origin);
                page.line(format!("  {}", robot.description));
            }
        }
        page.heading("Flight").facts(self.facts(true));
        page.notes("warning:", &self.warnings, 8, "");
        if let (Some(story), What::Vehicle { source, .. }) = (&self.story, &self.what) {
            story.page(&mut page, &source.vehicle, &self.plan);
        }
        if let Some(derivatives) = &self.derivatives {
            derivatives.page(&mut page);
        }
        if let Some(beside) = &self.beside {
            beside.page(&mut page, &self.summary);
        }
        if let Some(found) = self.flight.estimates.as_ref().filter(|found| found.has_covariance()) {
            page.heading("Innovations").table(estimate::table(found));
            page.line("  ν²/S per number of a reading: 1 where sensor and filter agree; left out beyond the gate");
        }
        if !self.joints.is_empty() {
            let mut table = Table::new("joint | >largest | >rms");
            for joint in &self.joints {
                let show = |v: f64| {
                    if joint.turns { format!("{}°", number(v.to_degrees(), 1)) } else { length(v) }
                };
                table.row([joint.name.clone()].into_iter().chain(extremes(joint).map(show)));
            }
            page.heading("Joints").table(table);
            page.line("  away from rest; of a universal joint both hinges together");
        }
        page.written(&self.written);
        if let Err(reason) = verdict {
            page.line(format!("\nFAILED: {reason}"));
        }
        page
    }

    /// With how long it took to compute, or of the flight alone.
    fn facts(&self, took: bool) -> Vec<Fact> {
        let (s, plan) = (&self.summary, &self.plan);
        let place = match &plan.reference {
            Reference::Lemniscate(l) => {
                format!("; {} rad/s around ({}) m", l.rate, l.origin.map(|v| short(v, 3)).join(", "))
            }
            Reference::Hover(Hover { position, .. }) => format!("; ({}) m", position.map(|v| short(v, 3)).join(", ")),
            _ => String::new(),
        };
        let substeps = match plan.physics.substeps {
            1 => String::new(),
            n => format!(" ({n} substeps)"),
        };
        let computed = match took {
            true => format!(" in {}: {} × real time", duration(self.wall_time), short(self.speed(), 3)),
            false => String::new(),
        };
        let mut facts = vec![
            Fact::new("controller", &self.controller[0]).note(&self.controller[1]),
            Fact::new("reference", plan.reference.name()).note(format!("{}{place}", plan.reference.description())),
        ];
        facts.extend(self.tilt_fact());
        facts.push(Fact::new("simulated", format!("{} s", short(s.duration, 5))).note(format!(
            "{} steps of {}{substeps}{computed}",
            s.samples.saturating_sub(1),
            duration(plan.physics.dt),
        )));
        if !self.learnt && (self.plant.tree().is_some() || !is_optimal(&self.controller[0])) {
            facts.push(self.gains_fact());
            facts.extend(filters::fact(&plan.filters, plan.rates.rate));
        }
        if let Some((kind, wind)) = describe_wind(&plan.wind) {
            facts.push(Fact::new("wind", kind).note(wind));
            if let What::Vehicle { source, .. } = &self.what
                && is_slippery(&source.vehicle)
            {
                facts.push(
                    Fact::new("", "moves nothing")
                        .note("the vehicle has no drag: give its rotors or its airframe some"),
                );
            }
        }
        if plan.latency > 0 {
            let late = duration(plan.physics.dt * plan.latency as f64);
            facts.push(
                Fact::new("latency", format!("{} steps", plan.latency)).note(format!("commands act {late} late")),
            );
        }
        facts.extend(self.failure_facts());
        facts.extend(self.plan.sensors.iter().map(|sensor| self.sensor_fact(sensor)));
        facts.extend(self.flight.estimates.iter().flat_map(estimate::facts));
        let from =
            if s.rmse_after > 0.0 { format!("after the first {} s", s.rmse_after) } else { "whole flight".into() };
        let with_start = match (s.max_error, s.max_error_overall) {
            (Some(late), Some(overall)) if overall > late => format!("{} with the start", length(overall)),
            _ => String::new(),
        };
        let whose = if self.plant.tree().is_some() { "of the root" } else { "" };
        facts.extend([
            Fact::new("tracking RMSE", length(s.rmse)).note(from),
            Fact::new("largest error", length(s.max_error)).note(with_start),
            self.heading_fact(),
            Fact::new("top speed", format!("{} m/s", number(s.max_speed, 2))),
            Fact::new("largest tilt", format!("{}°", number(s.max_tilt.map(f64::to_degrees), 1))).note(whose),
            Fact::new("rotors at a limit", format!("{} %", number(s.saturation.map(|v| 100.0 * v), 1)))
                .note("of all commands"),
        ]);
        facts.push(self.lowest_fact());
        facts.extend(self.approach.iter().map(Approach::fact));
        if let Some(step) = self.step() {
            let seconds = |t: f64| if t.is_finite() { format!("{} s", short(t, 3)) } else { "never".into() };
            facts.push(Fact::new("step: rise time", seconds(step.rise_time)).note(format!(
                "10 to 90 % of the way; within 2 % of its end after {}, overshoot {} %",
                seconds(step.settling_time),
                number(100.0 * step.overshoot, 1)
            )));
        }
        facts.extend(self.notes.iter().map(|n| Fact::new(&n.name, &n.value).note(&n.note)));
        facts
    }

    /// Figures of the step that was asked for, along its way, from the jump on.
    fn step(&self) -> Option<StepFigures> {
        let Reference::Step(step) = &self.plan.reference else { return None };
        let way = [0, 1, 2].map(|k| step.to[k] - step.from[k]);
        let length = way.iter().map(|w| w * w).sum::<f64>().sqrt();
        if length == 0.0 {
            return None;
        }
        let along = |p: &[f64; 3]| (0..3).map(|k| (p[k] - step.from[k]) * way[k]).sum::<f64>() / length;
        let log = &self.flight.log;
        let after = log.time.iter().zip(&log.position).filter(|(t, _)| **t >= step.time);
        let (times, values): (Vec<f64>, Vec<f64>) = after.map(|(t, p)| (t - step.time, along(p))).unzip();
        step_figures(&times, &values, 0.0).ok()
    }

    fn tilt_fact(&self) -> Option<Fact> {
        let tilt = &self.plan.tilt;
        let [roll, pitch] = [tilt.roll, tilt.pitch].map(|a| short(a.to_degrees(), 3));
        let over = if tilt.ramp > 0.0 { format!(" over {} s", short(tilt.ramp, 3)) } else { String::new() };
        let note = format!("from {} s on{over}", short(tilt.at, 3));
        (!tilt.is_level()).then(|| Fact::new("held beside it", format!("roll {roll}°, pitch {pitch}°")).note(note))
    }

    fn gains_fact(&self) -> Fact {
        let rates = &self.plan.rates;
        let hz = |rate: f64| short(rate, 4);
        let (gains, file) = match &self.what {
            What::Model(_) => ("its own", String::new()),
            What::Vehicle { gains_name, .. } => match gains_name.as_str() {
                known @ ("published" | "derived") => (known, String::new()),
                file => ("from a file", format!("{file}; ")),
            },
        };
        Fact::new("gains", gains).note(format!(
            "{file}rate {} Hz, attitude {} Hz, velocity and position {} Hz",
            hz(rates.rate),
            hz(rates.attitude),
            hz(rates.velocity)
        ))
    }

    /// What a sensor reads, how often, how late.
    fn sensor_fact(&self, sensor: &SensorConfig) -> Fact {
        let kind = sensor.model.kind();
        let body = sensor.on.as_deref().map_or_else(String::new, |on| format!(" on {on}"));
        let n = sensor.model.channels().len();
        let columns = match sensor.model.layout() {
            ReadingLayout::Vector => format!("{} of the log", counted(n, "column")),
            _ => format!("{n} numbers a reading"),
        };
        let dt = self.plan.physics.dt;
        // a flight that was flown had steps for both
        let every = sensor.steps_between(dt).map_or(f64::NAN, |n| n as f64 * dt);
        let late = match sensor.steps_late(dt) {
            Ok(n) if n > 0 => format!("{} late", duration(n as f64 * dt)),
            _ => "at once".into(),
        };
        let note = format!("{} Hz, {late}; {columns}", short(1.0 / every, 4));
        Fact::new(format!("sensor '{}'", sensor.name), format!("{kind}{body}")).note(note)
    }

    /// What failed of a configuration; a vehicle has a story of it.
    fn failure_facts(&self) -> Vec<Fact> {
        let rotors = if self.story.is_none() { self.plant.rotors() } else { Vec::new() };
        let known = format!("its controller was told {} later", duration(self.plan.detection_delay));
        let fact = |f: &RotorFailure| {
            let left =
                if f.effectiveness > 0.0 { format!("{} % left", 100.0 * f.effectiveness) } else { "lost".into() };
            let rotor = rotors.get(f.rotor)?;
            Some(Fact::new(&rotor.name, format!("{left} at {} s", short(f.at, 4))).note(&known))
        };
        self.plan.failures.iter().filter_map(fact).collect()
    }

    pub fn json(&self, verdict: &std::result::Result<(), String>) -> Value {
        let mut value = json!({
            "command": "fly",
            "version": env!("CARGO_PKG_VERSION"),
            "success": verdict.is_ok(),
            "failure": verdict.as_ref().err(),
            "controller": self.controller[0],
            "controller_notes": self.notes.iter().map(|n| json!([n.name, n.value, n.note])).collect::<Vec<_>>(),
            "plan": self.plan,
            "flight": self.summary,
            "step": self.step(),
            "diverged_at": self.flight.diverged_at,
            "lost_at": self.flight.lost().map(|(at, _)| at),
            "wall_time": self.wall_time,
            "times_real_time": self.speed(),
            "files": files::names(&self.written),
        });
        match &self.what {
            What::Vehicle { source, gains, gains_name } => {
                value["vehicle"] = KeyFigures::of(&source.vehicle).json(&source.vehicle);
                value["source"] = source.json();
                if !is_optimal(&self.controller[0]) {
                    value["gains"] = json!(gains);
                    value["gains_from"] = json!(gains_name);
                }
                value["failures"] = json!(self.story.as_ref().map(|s| s.json(&source.vehicle)));
            }
            What::Model(robot) => {
                let joint = |j: &JointHistory| {
                    let [largest, rms] = extremes(j);
                    json!({ "name": j.name, "turns": j.turns, "largest": largest, "rms": rms })
                };
                value["configuration"] = json!(robot.model.name());
                value["joints"] = self.joints.iter().map(joint).collect();
            }
        }
        value["lowest"] = json!(self.judgement.lowest);
        value["mishaps"] = json!(self.judgement.mishaps);
        value["warnings"] = json!(self.warnings);
        if let Some(approach) = &self.approach {
            value["scene"] = approach.json();
        }
        if let Some(found) = &self.flight.estimates {
            value["estimate"] = estimate::json(found);
        }
        if let Some(beside) = &self.beside {
            value["beside"] = beside.json();
        }
        if let Some(derivatives) = &self.derivatives {
            value["derivatives"] = derivatives.json();
            value["sensitivity"] = json!(derivatives.through.as_ref().map(|(s, _)| s));
            value["left_out"] = json!(derivatives.left_out);
        }
        value
    }
}

/// Whether no wind can push it.
fn is_slippery(vehicle: &omnidrones::dynamics::Vehicle) -> bool {
    let rotors = vehicle.rotors.iter();
    let of_rotors = rotors.flat_map(|r| [r.drag_coefficient, r.axial_drag_coefficient, r.rolling_coefficient]);
    let (linear, quadratic) = (vehicle.drag.linear, vehicle.drag.quadratic);
    linear.into_iter().chain(quadratic).chain(of_rotors).all(|k| k == 0.0)
}

fn describe_wind(wind: &Wind) -> Option<(&'static str, String)> {
    let three = |v: &[f64; 3]| vector(v, 3);
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
        Wind::Own(_) => Some(("own", "a function of time".into())),
    }
}
