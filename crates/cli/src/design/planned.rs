//! The report of a model predictive controller: its feedback about hover, what that loop bears, and how long a tick takes.

use super::figures::{self, Loops};
use super::report::steps;
use super::{Arguments, all_commands, degrees, disk_json, margins_json, mode_json, modes_table, unlimited};
use crate::fly::slow_lemniscate;
use crate::html::html;
use crate::prelude::*;
use crate::robot::Flyer;
use omnidrones::controllers::design::LoopMargins;
use omnidrones::controllers::linear::{
    DiskMargin, Margins, Mode, Signal, disk_margin, frequency_response, modes, multiloop_disk_margin,
};
use omnidrones::controllers::optimal::{LinearMpc, Mpc, MpcSettings, MpcStatistics};
use omnidrones::controllers::{FlightPlan, Reference, Setup, default_controller, fly};
use omnidrones::dynamics::Plant;
use omnidrones_plot::Figure;

/// Length of the flight on which ticks are timed, s.
const TIMED: f64 = 5.0;
/// Its error is told from then on, s.
const SETTLED: f64 = 2.0;
/// Below this a gain margin is not met: as of the cascade, up to factors of 100.
const LEAST_GAIN: f64 = 0.01;
/// Commands whose feedback stands in the page.
const SHOWN: usize = 4;

/// What was found.
struct Planned {
    plant: Plant,
    origin: String,
    settings: MpcSettings,
    linear: LinearMpc,
    stable: bool,
    modes: Vec<Mode>,
    /// Of the loop cut at each command.
    rows: Vec<(String, LoopMargins)>,
    /// Of all commands at once, where the loop is stable.
    all: Option<DiskMargin>,
    flown: Flown,
}

/// A flight whose ticks were timed.
struct Flown {
    reference: Reference,
    statistics: MpcStatistics,
    rmse: Option<f64>,
    /// When it was lost, s.
    lost_at: Option<f64>,
    /// Median, and what 99 % are within, s.
    times: [f64; 2],
}

/// Reports.
pub fn run(a: &Arguments, settings: Option<MpcSettings>, save: Option<(&Path, bool)>) -> Result<Report> {
    check(a)?;
    let physics = a.flyer.flight.physics();
    let (plant, origin) = match a.flyer.flyer()? {
        Flyer::Configuration(model) => (Plant::of_model(&model, physics)?, "configuration, built in".into()),
        Flyer::Vehicle(source) => (Plant::of_vehicle(&source.vehicle, physics)?, source.origin),
    };
    let settings = settings.unwrap_or_else(|| MpcSettings::for_plant(&plant));
    let found = Planned::of(a, plant, origin, settings)?;
    if let Some((file, as_json)) = save {
        let model = &found.linear.plant;
        let text = if as_json { format!("{:#}\n", model.to_json()) } else { model.to_csv() };
        files::replace(file, text.as_bytes())?;
        files::note_saved(file);
    }
    found.draw(a)?;
    let written: Vec<PathBuf> = a.output.plot.iter().chain(&a.save).chain(&a.report).cloned().collect();
    if a.output.json {
        return Ok(Report::json(&found.json(&written), found.holds()));
    }
    let mut page = Page::new();
    page.title(found.plant.name(), &found.origin);
    found.tell(&mut page);
    page.written(&written);
    Ok(Report::page(&page, found.holds()))
}

/// Refuses what does not bear on a plan about hover.
fn check(a: &Arguments) -> Result<()> {
    let flight = &a.flyer.flight;
    let wind = a.wind.as_ref().map(|wind| format!("{wind:?}"));
    let latency = (a.latency > 0).then(|| a.latency.to_string());
    let spread = a.plants.spread().map(|spread| spread.to_string());
    let rates = flight.rates.map(|r| format!("{},{},{}", r.rate, r.attitude, r.velocity));
    for (option, given, why, remedy) in [
        ("--wind", wind, "its feedback is about hover in still air", "'omnidrones fly' flies it in wind."),
        (
            "--latency",
            latency,
            "its plan begins where commands act",
            "The delay margins are of one command at a time, without the estimate. 'latency' in the file of --mpc tells it.",
        ),
        ("--spread", spread, "plants other than believed are judged for the cascade", "Leave out one of both."),
        ("--rates", rates, "it has no levels", "Its rate stands in the file of --mpc."),
        ("--filters", a.filters.given(), "it is no cascade, which filters body rates", "Leave it out."),
        ("--sensors", a.sensors.clone(), "noise is followed through the cascade", "Leave it out."),
        ("--gains", flight.gains.clone(), "its feedback follows from weights", "They stand in the file of --mpc."),
    ] {
        if let Some(given) = given {
            let what = format!("{option} with --controller mpc");
            return Err(Error::value(what, given, format!("left out: {why}"), remedy));
        }
    }
    Ok(())
}

/// The controller, with what flies where no plan is found.
fn controller(a: &Arguments, plant: &Plant, settings: &MpcSettings) -> Result<Mpc> {
    let rates = a.flyer.flight.rates();
    Ok(Mpc::new(plant, settings)?.with_fallback(default_controller(plant, &Setup::new(None, &rates))?))
}

impl Planned {
    fn of(a: &Arguments, plant: Plant, origin: String, settings: MpcSettings) -> Result<Self> {
        let mut mpc = controller(a, &plant, &settings)?;
        let linear = mpc.linear()?;
        let stable = linear.poles.iter().all(|pole| pole.norm() < 1.0);
        let (mut rows, mut all) = (Vec::new(), None);
        if stable {
            rows = margins(&linear, a.output.json)?;
            all = Some(multiloop_disk_margin(&linear.cut()?, 0.0)?);
        }
        let modes = modes(&linear.closed()?)?;
        let flown = Flown::of(a, &plant, &mut mpc)?;
        Ok(Self { plant, origin, settings, linear, stable, modes, rows, all, flown })
    }

    fn draw(&self, a: &Arguments) -> Result<()> {
        if a.output.plot.is_none() && a.report.is_none() {
            return Ok(());
        }
        let names: Vec<&str> = self.linear.plant.inputs().iter().map(|input| input.name.as_str()).collect();
        let loops = Loops::broken_at(&names, self.linear.period, &self.rows, &|i, omega| {
            let response = frequency_response(&self.linear.cut_at(i)?, omega);
            Ok(response.values.iter().map(|value| value[(0, 0)]).collect())
        })?;
        if let Some(file) = &a.output.plot {
            loops.bode(self.plant.name()).save(file)?;
        }
        let Some(file) = &a.report else { return Ok(()) };
        files::write_new(file, &self.html(a, &loops)?, a.output.force)
    }

    /// The report as one page for a browser or a printer.
    fn html(&self, a: &Arguments, loops: &Loops) -> Result<String> {
        let mut page = Page::new();
        let title = format!("{}: design of model predictive control", self.plant.name());
        page.title(&title, &format!("{}; omnidrones {}", self.origin, env!("CARGO_PKG_VERSION")));
        self.tell(&mut page);
        let plane = Figure::new("").size(1000.0, 500.0).grid(&[1.0, 1.0], &[1.0]);
        let poles = figures::poles(&self.linear.poles, self.linear.period);
        let plane = plane.place((0, 0), (1, 1), loops.nyquist()).place((1, 0), (1, 1), poles);
        page.heading("Stability").figure(plane.svg()?);
        let mut mpc = controller(a, &self.plant, &self.settings)?;
        let plan = plan(a, &self.plant, &self.settings);
        steps(&mut page, &plan, &mut |plan| Ok(fly(&self.plant, &mut mpc, plan, &mut |_| {})?.log))?;
        page.line("A plan sees the step before it comes, and sets out early.");
        page.heading("Loop and sensitivity").figure(loops.bode(self.plant.name()).svg()?);
        Ok(html(&page))
    }

    /// Whether the loop is stable, and the flight was not lost.
    fn holds(&self) -> bool {
        self.stable && self.flown.lost_at.is_none()
    }

    fn tell(&self, page: &mut Page) {
        page.heading("Plan").facts(self.plan_facts());
        page.heading("Feedback about hover").table(self.feedback());
        page.line(format!("  {}", self.remark()));
        page.heading("Poles of the loop about hover").table(modes_table(&self.modes, &self.linear.plant));
        page.heading("Control loop about hover").facts(self.loop_facts());
        if self.stable {
            page.heading("Margins").table(self.margins());
            page.line("  Each of the loop cut at one command while the others stay closed; the modulus is the least distance to −1.");
        } else {
            page.line("\nFAILED: the loop is not stable, so that there are no margins.");
        }
        page.heading("Ticks").facts(self.flown.facts(self.linear.period));
    }

    fn plan_facts(&self) -> Vec<Fact> {
        let MpcSettings { stages, stage, substeps, rate, iterations, endless, estimate, latency, .. } = &self.settings;
        let milliseconds = |seconds: f64| format!("{} ms", short(1e3 * seconds, 3));
        let end = if *endless { "the cost of an endless flight" } else { "the weights of a stage, per second" };
        let substeps = if *substeps == 1 { String::new() } else { format!(", in {substeps} steps each") };
        let weights = &self.settings.weights;
        let all = |of: [f64; 3]| of.map(|w| short(w, 4)).join(", ");
        let late = duration(*latency as f64 * self.plant.physics().dt);
        vec![
            Fact::new("stages", format!("{stages} of {}{substeps}", milliseconds(*stage)))
                .note(format!("{} ahead; ends with {end}", duration(*stages as f64 * stage))),
            Fact::new("tick", milliseconds(self.linear.period)).note(format!(
                "at most {} a second; {} each",
                short(*rate, 4),
                counted(*iterations, "program")
            )),
            Fact::new(
                "disturbance estimate",
                if *estimate > 0.0 { format!("{} 1/s", short(*estimate, 3)) } else { "none".into() },
            )
            .note("left out of the loop below"),
            Fact::new("told latency", counted(*latency, "step")).note(if *latency > 0 {
                format!("{late}: plans begin then")
            } else {
                String::new()
            }),
            Fact::new("weights", format!("position {}", all(weights.position))).note(format!(
                "velocity {}; attitude {}; rates {}; inputs {}",
                all(weights.velocity),
                all(weights.attitude),
                all(weights.angular_velocity),
                short(weights.input, 3)
            )),
        ]
    }

    /// K, errors below each other.
    fn feedback(&self) -> Table {
        let (gain, model) = (&self.linear.gain, &self.linear.plant);
        let names = model.inputs().iter().take(SHOWN).map(|input| input.name.clone());
        let mut table = Table::new("error | unit").with(Align::Right, names);
        for (j, error) in model.states().iter().enumerate() {
            // rounding of what a command does not depend on
            let least = 1e-9 * gain.amax();
            let row = (0..gain.nrows().min(SHOWN)).map(|i| gain[(i, j)]);
            let row = row.map(|k| if k.abs() < least { "0".into() } else { short(k, 3) });
            table.row([error.name.clone(), error.unit.clone()].into_iter().chain(row));
        }
        table
    }

    fn remark(&self) -> String {
        let told = "Per unit of the error; rotors are told shares of their largest speed.";
        match self.linear.gain.nrows() {
            n if n > SHOWN => format!("{told} The first {SHOWN} of {n} commands: --json has all."),
            _ => told.into(),
        }
    }

    fn loop_facts(&self) -> Vec<Fact> {
        let slowest = self.linear.poles.first().map_or(0.0, |pole| pole.norm());
        let decay = -self.linear.period / slowest.ln();
        let mut facts = vec![
            Fact::new("stable", if self.stable { "yes" } else { "NO" }),
            if self.stable {
                Fact::new("slowest pole decays in", format!("{} s", unlimited(decay, 3))).note("to 1/e")
            } else {
                Fact::new("worst pole grows in", format!("{} s", unlimited(-decay, 3))).note("by e")
            },
        ];
        facts.extend(self.all.as_ref().map(all_commands));
        facts
    }

    fn margins(&self) -> Table {
        let header = "cut at | >gain down | >gain up | >phase [°] | >delay [ms] | >modulus | >disk | >at [rad/s]";
        Table::new(header).filled(self.rows.iter().zip(&self.linear.margins).map(|((name, m), (_, own))| {
            [
                name.clone(),
                short(m.gain_down, 3),
                unlimited(m.gain_up, 3),
                unlimited(degrees(m.phase), 3),
                unlimited(m.delay * 1e3, 3),
                short(own.modulus, 3),
                short(m.disk.alpha, 3),
                unlimited(m.disk.omega, 3),
            ]
        }))
    }

    fn json(&self, written: &[PathBuf]) -> Value {
        let LinearMpc { gain, plant, poles, margins, period } = &self.linear;
        let names = |signals: &[Signal]| signals.iter().map(|signal| signal.name.clone()).collect::<Vec<_>>();
        let feedback: Vec<Vec<f64>> = gain.row_iter().map(|row| row.iter().copied().collect()).collect();
        let rows: Vec<Value> = self
            .rows
            .iter()
            .zip(margins)
            .map(|(row, (_, own))| {
                let mut value = margins_json(row);
                value["modulus"] = json!(own.modulus);
                value
            })
            .collect();
        json!({
            "command": "design", "vehicle": self.plant.name(), "controller": "mpc", "stable": self.stable,
            "dt": self.plant.physics().dt, "tick": period, "settings": self.settings,
            "feedback": { "commands": names(plant.inputs()), "errors": names(plant.states()), "gain": feedback },
            "modes": self.modes.iter().map(mode_json(plant)).collect::<Vec<_>>(),
            "poles": poles.iter().map(|p| [p.re, p.im]).collect::<Vec<_>>(),
            "all_commands": self.all.as_ref().map(disk_json), "margins": self.stable.then_some(rows),
            "ticks": self.flown.json(), "files": files::names(written),
        })
    }
}

/// What the loop bears at every command.
fn margins(linear: &LinearMpc, quiet: bool) -> Result<Vec<(String, LoopMargins)>> {
    let bar = progress::bar(linear.margins.len() as u64, "margins", quiet);
    let rows = linear.margins.iter().enumerate().map(|(i, (name, own))| {
        let disk = disk_margin(&linear.cut_at(i)?, 0.0)?;
        bar.inc(1);
        let Margins { stable, gain_up, phase, delay, .. } = *own;
        // what is met only at zero, up to rounding
        let gain_down = if own.gain_down < LEAST_GAIN { 0.0 } else { own.gain_down };
        Ok((name.clone(), LoopMargins { stable, gain_up, gain_down, phase, delay, disk }))
    });
    let rows = rows.collect();
    bar.finish_and_clear();
    rows
}

/// How it is flown here: with commands as late as its plans are told.
fn plan(a: &Arguments, plant: &Plant, settings: &MpcSettings) -> FlightPlan {
    FlightPlan {
        physics: *plant.physics(),
        rates: a.flyer.flight.rates(),
        latency: settings.latency,
        ..FlightPlan::default()
    }
}

impl Flown {
    fn of(a: &Arguments, plant: &Plant, mpc: &mut Mpc) -> Result<Self> {
        let reference = plant.tree().map_or_else(|| Reference::Lemniscate(Default::default()), slow_lemniscate);
        let own = plan(a, plant, mpc.settings());
        let plan = FlightPlan { reference: reference.clone(), duration: TIMED, ..own };
        let bar = progress::bar(plan.n_step()?, "flying", a.output.json);
        let flight = fly(plant, mpc, &plan, &mut |k| {
            if k % 256 == 0 {
                bar.set_position(k);
            }
        })?;
        bar.finish_and_clear();
        let statistics = mpc.statistics().clone();
        let times = [0.5, 0.99].map(|share| statistics.time_within(share).unwrap_or(f64::NAN));
        let lost_at = flight.diverged_at.or(flight.lost().map(|(time, _)| time));
        Ok(Self { reference, statistics, rmse: flight.log.rmse(SETTLED), lost_at, times })
    }

    fn per_tick(&self) -> f64 {
        self.statistics.recursions as f64 / self.statistics.ticks.max(1) as f64
    }

    fn facts(&self, period: f64) -> Vec<Fact> {
        let MpcStatistics { ticks, kept, fallen_back, stopped, residual, .. } = &self.statistics;
        let flown = match self.lost_at {
            None => duration(TIMED),
            Some(time) => format!("{}, LOST after {}", duration(TIMED), duration(time)),
        };
        let [median, late] = self.times.map(duration);
        vec![
            Fact::new("flown", format!("{} for {flown}", self.reference.name()))
                .note(format!("RMSE {} after the first {SETTLED} s", length(self.rmse))),
            Fact::new("plans", format!("{} of {ticks} ticks", ticks - kept - fallen_back))
                .note(format!("the others flew on with the last plan ({kept}) or the fallback ({fallen_back})")),
            Fact::new("recursions", format!("{} a tick", number(self.per_tick(), 2)))
                .note(format!("residual {residual:.0e} at most; {stopped} programs stopped at what rounding allows")),
            Fact::new("time of a tick", median)
                .note(format!("median; 99 % within {late}, of the {} until the next", duration(period))),
        ]
    }

    fn json(&self) -> Value {
        let MpcStatistics { ticks, kept, fallen_back, stopped, residual, .. } = &self.statistics;
        json!({
            "reference": self.reference, "duration": TIMED, "rmse": self.rmse, "rmse_after": SETTLED, "n": ticks, "kept": kept,
            "fallen_back": fallen_back, "stopped": stopped, "lost_at": self.lost_at, "recursions": self.per_tick(), "residual": residual,
            "median": self.times[0], "within_99": self.times[1],
        })
    }
}
