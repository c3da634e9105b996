//! What the loop bears with an estimator between sensors and controller, beside what it bears on the true state.

use super::{Arguments, LoopModel, degrees, disk_json, margins_json, unlimited};
use crate::arguments;
use crate::fly::estimate;
use crate::prelude::*;
use omnidrones::controllers::design::{AnalysisPoint, LoopMargins, Stability, TrimTarget, trim};
use omnidrones::controllers::estimation::{ESTIMATORS, EstimatorSettings};
use omnidrones::controllers::linear::DiskMargin;
use omnidrones::controllers::reference::{Hover, Reference};
use omnidrones::controllers::{CascadeLaw, ClosedLoop, ControlLaw, HoverFeedback, HoverWeights, LawController, Target};
use omnidrones::dynamics::sensors::{SensorConfig, SensorSet};
use omnidrones::dynamics::{Disturbance, Plant};

/// Controllers whose loop is judged with an estimator.
const JUDGED: [&str; 3] = ["cascade", "lqr", "lqi"];

/// Numbers of the error of a body: place, velocity, rotation vector, rate.
const BODY: usize = 12;

/// An estimator and its sensors.
#[derive(Debug, clap::Args)]
pub struct EstimatorArguments {
    /// Margins with an estimator between sensors and controller, about hover: ekf, complementary, kalman, or a file as of 'fly'
    ///
    /// Beside those on the true state. 'kalman' is driven by the commands: with --controller lqr its loop is that of LQG. The others are
    /// driven by an imu, which feels whatever the vehicle does: what is estimated of the body then costs no margin, but for the
    /// latency of the imu. Rotor speeds follow the commands; lqr and lqi look at them.
    #[arg(long, value_name = "NAME|FILE.toml", requires = "sensors", help_heading = "Controller")]
    pub estimator: Option<String>,
}

/// A point, the margins with the estimator, and those on the true state where that loop has the same point.
type Row = (String, LoopMargins, Option<LoopMargins>);

/// What was found.
struct Estimated {
    name: String,
    kind: &'static str,
    sensors: Vec<SensorConfig>,
    model: LoopModel,
    stability: [Stability; 2],
    rows: Vec<Row>,
    /// Of all commands at once, with the estimator and on the true state; none where that loop is not stable.
    all: [Option<DiskMargin>; 2],
}

/// Reports.
pub fn run(a: &Arguments, named: &str) -> Result<Report> {
    check(a)?;
    let source = a.flyer.source()?;
    let physics = a.flyer.flight.physics();
    let plant = Plant::of_vehicle(&source.vehicle, physics)?;
    let sensors = a.sensors.as_deref().map_or(Ok(Vec::new()), arguments::sensors)?;
    SensorSet::new(&sensors, physics.dt, &plant.body_names())?;
    let settings = estimate::settings(named, &sensors)?;
    source.vehicle.check_steerable()?;
    let rates = a.flyer.flight.rates();
    let (gains, _) = a.flyer.flight.gains(&source.vehicle)?;
    let (weights, filters) = (HoverWeights::default(), a.filters.settings()?);
    if !filters.is_empty() && a.controller != "cascade" {
        let remedy = "Leave out --filters, or take the cascade.";
        return Err(Error::value("--controller with --filters", &a.controller, "cascade", remedy));
    }
    let model = match a.controller.as_str() {
        "lqr" => model(a, &plant, LawController::of(HoverFeedback::lqr(&plant, &rates, &weights)?))?,
        "lqi" => model(a, &plant, LawController::of(HoverFeedback::lqi(&plant, &rates, &weights)?))?,
        _ => model(
            a,
            &plant,
            CascadeLaw::new(&source.vehicle, &physics, &gains, &rates)?.with_filters(&filters)?.running(),
        )?,
    };
    let found = Estimated::of(a, &plant, &model, sensors, &settings)?;
    if a.output.json {
        return Ok(Report::json(&found.json(a), found.holds()));
    }
    let mut page = Page::new();
    page.title(&found.name, &source.origin);
    found.tell(a, &mut page);
    Ok(Report::page(&page, found.holds()))
}

/// Refuses what is not judged with an estimator.
fn check(a: &Arguments) -> Result<()> {
    if !JUDGED.contains(&a.controller.as_str()) {
        let remedy = "Leave out --estimator, or take one of them.";
        return Err(Error::value("--controller with --estimator", &a.controller, JUDGED.join(", "), remedy));
    }
    let path = |file: &Option<PathBuf>| file.as_ref().map(|file| file.display().to_string());
    for (option, given) in [
        ("--wind", a.wind.as_ref().map(|wind| format!("{wind:?}"))),
        ("--spread", a.plants.spread().map(|spread| spread.to_string())),
        ("--mpc", path(&a.mpc)),
        ("--plot", path(&a.output.plot)),
        ("--save", path(&a.save)),
        ("--report", path(&a.report)),
    ] {
        if let Some(given) = given {
            let rule = "left out: margins with an estimator are of hover in still air, as a table or as JSON";
            return Err(Error::value(format!("{option} with --estimator"), given, rule, "Leave one of both out."));
        }
    }
    Ok(())
}

/// The loop on the true state, about hover.
fn model<L: ControlLaw>(a: &Arguments, plant: &Plant, law: LawController<L>) -> Result<LoopModel> {
    let start = trim(plant, &TrimTarget::hover())?.state;
    let hover = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
    let closed = ClosedLoop::new(plant.clone(), law)?.with_latency(a.latency)?;
    LoopModel::new(closed, Target::level(&hover), &Disturbance::none(), &start)
}

impl Estimated {
    fn of(
        a: &Arguments,
        plant: &Plant,
        truth: &LoopModel,
        sensors: Vec<SensorConfig>,
        settings: &EstimatorSettings,
    ) -> Result<Self> {
        let model = truth.with_estimator(plant, &sensors, settings, a.latency)?;
        let stability = [model.stability()?, truth.stability()?];
        let both = [&model, truth];
        let all = [0, 1].map(|k| {
            if !stability[k].is_stable() {
                return Ok(None);
            }
            both[k].disk_margin(AnalysisPoint::Commands, 0.0).map(Some)
        });
        let [with, without] = all;
        let (name, kind) = (plant.name().to_string(), settings.kind());
        let rows = if stability[0].is_stable() { rows(&model, truth, a.output.json)? } else { Vec::new() };
        Ok(Self { name, kind, sensors, stability, rows, all: [with?, without?], model })
    }

    fn holds(&self) -> bool {
        self.stability[0].is_stable()
    }

    fn tell(&self, a: &Arguments, page: &mut Page) {
        let about = ESTIMATORS.iter().find(|entry| entry.name == self.kind).map_or("", |entry| entry.about);
        let named = |own: &SensorConfig| own.model.kind().to_string();
        let sensors: Vec<String> = self.sensors.iter().map(named).collect();
        let period = format!("{} of {} ms", counted(self.model.period(), "step"), short(self.model.dt * 1e3, 3));
        let stable = |own: &Stability| if own.is_stable() { "yes" } else { "NO" };
        let mut facts = vec![
            Fact::new("controller", a.controller.as_str()),
            Fact::new("estimator", self.kind).note(about),
            Fact::new("sensors", sensors.join(", ")),
            Fact::new("period of all rates", period),
            Fact::new("latency of commands", counted(a.latency, "step")),
            Fact::new("stable", stable(&self.stability[0]))
                .note(format!("on the true state: {}", stable(&self.stability[1]))),
        ];
        if let [Some(with), Some(without)] = &self.all {
            facts.push(
                Fact::new("disk margin, all commands", short(with.alpha, 3))
                    .note(format!("on the true state {}", short(without.alpha, 3))),
            );
        }
        page.heading("Control loop about hover, with an estimator").facts(facts);
        if !self.holds() {
            page.line("\nFAILED: the loop is not stable with this estimator, so that there are no margins.");
            return;
        }
        page.heading("Margins").table(self.table());
        page.line("  Each of the loop broken at one point while all other paths stay closed; the last two are those on the true state.");
        page.line(match self.kind {
            "kalman" => "  Commands are changed behind the filter, which goes by those that were given; sensors are changed as it reads them.",
            _ => "  Commands are changed behind the estimator, whose rotor speeds go by those that were given; estimates as the controller sees them.",
        });
        if self.kind != "kalman" {
            page.line("  Whether sensors tell enough for the estimate to settle is not judged here: 'omnidrones fly' shows it.");
        }
    }

    fn table(&self) -> Table {
        let header =
            "broken at | >gain down | >gain up | >phase [°] | >delay [ms] | >disk | >true: phase [°] | >true: disk";
        let beyond =
            |value: f64, most: f64| if value.is_finite() { short(value, 3) } else { format!("> {}", short(most, 3)) };
        let longest = LoopModel::MOST_DELAY as f64 * self.model.dt * 1e3;
        Table::new(header).filled(self.rows.iter().map(|(name, with, without)| {
            let without = without.as_ref();
            let told = |value: Option<f64>| value.map_or_else(|| "–".into(), |value| unlimited(value, 3));
            [
                name.clone(),
                short(with.gain_down, 3),
                beyond(with.gain_up, 100.0),
                unlimited(degrees(with.phase), 3),
                beyond(with.delay * 1e3, longest),
                short(with.disk.alpha, 3),
                told(without.map(|own| degrees(own.phase))),
                told(without.map(|own| own.disk.alpha)),
            ]
        }))
    }

    fn json(&self, a: &Arguments) -> Value {
        let row = |(name, with, without): &Row| {
            let mut value = margins_json(&(name.clone(), with.clone()));
            value["on_the_true_state"] = json!(without.clone().map(|own| margins_json(&(name.clone(), own))));
            value
        };
        let rows: Vec<Value> = self.rows.iter().map(row).collect();
        let [with, without] = self.all.each_ref().map(|disk| disk.as_ref().map(disk_json));
        json!({
            "command": "design", "vehicle": self.name, "controller": a.controller, "estimator": self.kind,
            "stable": self.stability[0].is_stable(), "stability": self.stability[0],
            "stable_on_the_true_state": self.stability[1].is_stable(), "dt": self.model.dt, "period": self.model.period(),
            "all_commands": with, "all_commands_on_the_true_state": without,
            "margins": self.holds().then_some(rows),
        })
    }
}

/// What the loop bears at every command and at all that is measured.
#[allow(clippy::type_complexity)]
fn rows(model: &LoopModel, truth: &LoopModel, quiet: bool) -> Result<Vec<(String, LoopMargins, Option<LoopMargins>)>> {
    let commands = (0..model.commands.len()).map(|i| (model.commands[i].name.clone(), AnalysisPoint::Command(i)));
    // of what a controller is given the body; all that sensors read
    let n = if model.measurements == truth.measurements { BODY } else { model.measurements.len() };
    let measured = model.measurements.iter().enumerate().take(n);
    let measured = measured.map(|(i, own)| (own.name.clone(), AnalysisPoint::Measurement(i)));
    let all: Vec<(String, AnalysisPoint)> = commands.chain(measured).collect();
    let bar = progress::bar(all.len() as u64, "margins", quiet);
    let rows = all.into_iter().map(|(name, point)| {
        let with = model.margins(point)?;
        let same = match point {
            AnalysisPoint::Measurement(i) => truth.measurements.get(i).is_some_and(|own| own.name == name),
            _ => true,
        };
        let without = if same { Some(truth.margins(point)?) } else { None };
        bar.inc(1);
        Ok((name, with, without))
    });
    let rows = rows.collect();
    bar.finish_and_clear();
    rows
}
