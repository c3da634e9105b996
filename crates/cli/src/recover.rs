//! `omnidrones recover`: from which attitudes and body rates a controller brings a vehicle or a configuration back.

use super::arguments::{self, PlotArguments, ThreadArguments};
use super::robot::{self, Flyer, FlyerArguments};
use crate::prelude::*;
use omnidrones::controllers::recovery::BACK;
use omnidrones::controllers::registry::controller;
use omnidrones::controllers::{
    Controller, RecoveryCell, RecoveryMap, RecoveryPlan, Setup, default_controller, recovery_map,
};
use omnidrones::dynamics::{Gains, Plant};
use omnidrones_plot::{Figure, HeatMap};
use std::f64::consts::PI;
use std::time::Instant;

/// What the command is for.
pub const ABOUT: &str = "\
Fly a vehicle or a configuration from random starts, tilted by any angle and turning at any rate, and count how many its \
controller brings back, with exact bounds of the share (Clopper and Pearson 1934), the height that was lost and the time it \
took. Straight-line controllers fly 64 starts at a time in lanes.";

const EXAMPLES: &str = "\
Examples:
  omnidrones recover hummingbird                          tilts to 180°, rates to 12 rad/s
  omnidrones recover crazyflie --tilt 60 --rate 0         released at rest, up to 60° of tilt
  omnidrones recover iris --speed 5 --plot thrown.svg     thrown, too; the map as a figure
  omnidrones recover payload --starts 8 --tilt 90         with a load; its controller flies one start after the other
  omnidrones recover firefly --controller fault_tolerant --cells 4,2 --starts 16

A start has come back when it is within 0.5 m of where it was released, level within 29°, slower than 0.5 m/s and 1 rad/s, for a \
quarter of a second. There is no ground: the height lost is beside it.

JSON: SI units, radians.

Exit codes: 0 flown; 1 not one start came back; 2 unusable input or arguments.";

/// Arguments of `recover`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("vehicle", robot::any_flyer), mut_arg("reference", |reference| reference.hide(true)))]
#[command(mut_arg("plot", |plot| plot.help("Draw the map into this file (.png or .svg)")))]
pub struct Arguments {
    #[command(flatten)]
    flyer: FlyerArguments,
    /// Who flies [default: the controller of its make]
    #[arg(long, value_name = "NAME", help_heading = "Controller")]
    controller: Option<String>,
    /// Largest tilt [degrees]
    #[arg(long, value_name = "DEGREES", default_value_t = 180.0, help_heading = "Starts")]
    tilt: f64,
    /// Largest body rate [rad/s]
    #[arg(long, value_name = "RATE", default_value_t = 12.0, help_heading = "Starts")]
    rate: f64,
    /// Largest speed [m/s], in a random direction
    #[arg(long, value_name = "SPEED", default_value_t = 0.0, help_heading = "Starts")]
    speed: f64,
    /// Intervals of tilt and of rate
    #[arg(long, value_name = "TILTS,RATES", value_delimiter = ',', default_values_t = [18, 6], help_heading = "Starts")]
    cells: Vec<usize>,
    /// Starts per cell
    #[arg(long, value_name = "N", default_value_t = 64, help_heading = "Starts")]
    starts: usize,
    /// Longest flight [s]
    #[arg(long, value_name = "SECONDS", default_value_t = 6.0, help_heading = "Starts")]
    duration: f64,
    /// Seed of the starts
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Starts")]
    seed: u64,
    #[command(flatten)]
    threads: ThreadArguments,
    #[command(flatten)]
    output: PlotArguments,
}

impl Arguments {
    fn plan(&self) -> Result<RecoveryPlan> {
        let rows = [
            ("--tilt", self.tilt, 0.0..=180.0, "within [0, 180] degrees"),
            ("--rate", self.rate, 0.0..=1e3, "within [0, 1000] rad/s"),
            ("--speed", self.speed, 0.0..=1e2, "within [0, 100] m/s"),
        ];
        for (what, value, range, rule) in rows {
            if !range.contains(&value) {
                return Err(Error::value(what, value, rule, "Leave it out for the default."));
            }
        }
        let &[tilts, rates] = &self.cells[..] else {
            return Err(Error::value("--cells", format!("{:?}", self.cells), "two numbers", "As 18,6."));
        };
        let tilt = self.tilt / 180.0 * PI;
        Ok(RecoveryPlan {
            // one interval where there is nothing to divide
            tilt: (tilt, if self.tilt == 0.0 { 1 } else { tilts }),
            rate: (self.rate, if self.rate == 0.0 { 1 } else { rates }),
            speed: self.speed,
            n: self.starts,
            duration: self.duration,
            seed: self.seed,
            ..RecoveryPlan::default()
        })
    }
}

/// Flies from all starts.
pub fn run(a: &Arguments) -> Result<Report> {
    a.flyer.flight.check()?;
    a.output.check()?;
    a.flyer.refuse_reference("recover", "Leave it out: every start returns to a point.")?;
    let (plan, rates, physics) = (a.plan()?, a.flyer.flight.rates(), a.flyer.flight.physics());
    let (plant, gains): (Plant, Option<Gains>) = match a.flyer.flyer()? {
        Flyer::Configuration(model) => (Plant::of_model(&model, physics)?, a.flyer.flight.own_gains()?),
        Flyer::Vehicle(source) => {
            (Plant::of_vehicle(&source.vehicle, physics)?, Some(a.flyer.flight.gains(&source.vehicle)?.0))
        }
    };
    arguments::check_gains(&a.flyer.flight, a.controller.as_deref(), plant.tree().is_none())?;
    let build = || -> Result<Box<dyn Controller>> {
        let setup = Setup::new(gains.as_ref(), &rates);
        match &a.controller {
            Some(name) => controller(name, &plant, &setup),
            None => default_controller(&plant, &setup),
        }
    };
    let spinner = progress::spinner("recovering", a.output.json);
    let clock = Instant::now();
    let map = recovery_map(&plant, &build, &plan, &a.threads.threads()?)?;
    let time = clock.elapsed().as_secs_f64();
    spinner.finish_and_clear();
    let name = build()?.name().to_string();
    let all = map.within(PI + 1.0, f64::INFINITY);
    if let Some(file) = &a.output.plot {
        figure(plant.name(), &name, &map, &all).save(file)?;
    }
    if a.output.json {
        let value = json!({
            "command": "recover", "version": env!("CARGO_PKG_VERSION"), "success": all.recovered > 0, "plant": plant.name(),
            "controller": name, "wall_time": time, "all": all, "map": map,
        });
        return Ok(Report::json(&value, all.recovered > 0));
    }
    Ok(Report::page(&page(a, plant.name(), &name, &map, &all, time), all.recovered > 0))
}

fn page(a: &Arguments, plant: &str, controller: &str, map: &RecoveryMap, all: &RecoveryCell, time: f64) -> Page {
    let mut page = Page::new();
    page.title(plant, &format!("under '{controller}'"));
    let how = if map.batched { "in lanes, f32" } else { "one after the other, f64" };
    page.heading("Starts").facts(vec![
        Fact::new("flown", all.n.to_string()).note(format!("{how}, in {}", duration(time))),
        Fact::new("came back", share(all)).note(format!("{} of {}", all.recovered, all.n)),
        Fact::new("most height lost", length(all.sunk)).note("by those that came back"),
        Fact::new("slowest", duration(all.slowest)).note(format!("until within {BACK} m and still")),
    ]);
    let columns = map.plan.rate.1;
    let rates = map.cells[..columns].iter().map(|c| format!("{} rad/s", interval(c.rate)));
    let mut table =
        Table::new(">tilt [°]").with(Align::Right, rates.chain(["height lost", "slowest"].map(String::from)));
    for row in map.cells.chunks_exact(columns) {
        let sunk = row.iter().fold(0.0, |most: f64, c| most.max(c.sunk));
        let slowest = row.iter().fold(0.0, |most: f64, c| most.max(c.slowest));
        let shares = row.iter().map(|c| format!("{} %", short(100.0 * c.recovered as f64 / c.n as f64, 3)));
        let tilt = interval(row[0].tilt.map(|t| t * 180.0 / PI));
        table.row(std::iter::once(tilt).chain(shares).chain([length(sunk), duration(slowest)]));
    }
    page.heading("Came back, by tilt and body rate").table(table);
    let widest = map.cells.iter().map(|c| c.bounds[1] - c.bounds[0]).fold(0.0, f64::max);
    page.line(format!(
        "  {} starts in each cell; with {} % confidence its share is known within {} points",
        map.plan.n,
        short(100.0 * map.plan.confidence, 3),
        short(100.0 * widest, 2)
    ));
    page.written(a.output.plot.as_slice());
    page
}

/// `97.3 % (96.1 to 98.2)`.
fn share(cell: &RecoveryCell) -> String {
    let [percent, low, high] =
        [cell.recovered as f64 / cell.n.max(1) as f64, cell.bounds[0], cell.bounds[1]].map(|v| short(100.0 * v, 3));
    format!("{percent} % ({low} to {high})")
}

fn interval([from, to]: [f64; 2]) -> String {
    if from == to { short(from, 3) } else { format!("{}–{}", short(from, 3), short(to, 3)) }
}

fn figure(plant: &str, controller: &str, map: &RecoveryMap, all: &RecoveryCell) -> Figure {
    let columns = map.plan.rate.1;
    let chart = HeatMap::new("Share that came back [%]", "tilt [°]", "body rate [rad/s]")
        .ranges((0.0, map.plan.tilt.0 * 180.0 / PI), (0.0, map.plan.rate.0));
    let chart = (0..columns).fold(chart, |chart, column| {
        let cells = || map.cells.iter().skip(column).step_by(columns);
        let shares: Vec<f64> = cells().map(|c| c.recovered as f64 / c.n as f64).collect();
        let texts = shares.iter().map(|s| format!("{:.0}", 100.0 * s)).collect();
        chart.row(shares, texts)
    });
    Figure::new(format!("{plant} under '{controller}': starts that come back"))
        .subtitle(format!(
            "{} of {} starts: {}; most height lost {}",
            all.recovered,
            all.n,
            share(all),
            length(all.sunk)
        ))
        .size(860.0, 420.0)
        .chart(chart)
}
