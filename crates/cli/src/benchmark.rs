//! `omnidrones benchmark`: controllers on the references of a published comparison, beside the published figures.

use super::arguments::{self, OutputArguments, ThreadArguments};
use crate::prelude::*;
use omnidrones::controllers::registry::REGISTRY;
use omnidrones::dynamics::Plant;
use omnidrones_plot::{Figure, HeatMap};
use omnidrones_studies::ellipse_study::{
    ACCELERATIONS, COUNTED, PUBLISHED_OVER_ALL, SPEEDS, Tracking, TrackingCondition, TrackingFlight, TrackingRow,
    physics, quadrotor,
};

/// What the command is for.
pub const ABOUT: &str = "\
Fly a published comparison of controllers again. 'tracking' is that of Sun, Romero, Foehn, Kaufmann and Scaramuzza (T-RO 2022): 144 \
ellipses, level and standing, with peak accelerations to 60 m/s² and speeds to 20 m/s, flown by a quadrotor of 0.75 kg whose rotors \
have enough for 63 of them; and again with more mass, a shifted centre of mass, late commands and a moment that the \
controller does not know of.";

const EXAMPLES: &str = "\
Examples:
  omnidrones benchmark tracking                           all controllers, all conditions
  omnidrones benchmark tracking --quick --no-plots        the nominal plant alone
  omnidrones benchmark tracking --quick --controllers indi,cascade --out out/two
  omnidrones benchmark tracking --quick --no-plots --json   every reference by itself, for a program

A reference is feasible if the rotors stay within their limits on the whole lap, by differential flatness with drag and without \
motor lag. The error is the root of the mean squared distance over 10 s after 4 s in which the flight gathers speed from rest; its \
mean is over the references that were not crashed on. A flight has crashed once it is more than 10 m off. Feasible is what the \
nominal vehicle can do.

Other than in the paper: 600 Hz for 500 (so that 300 Hz divide them), no lift from forward speed, a constant heading with standing \
ellipses across it, a centre of mass shifted forward, a moment about body x; cascade and indi do not integrate. The lines below each \
table tell flatness-based control and nonlinear MPC as published, over the 76 references that the paper calls feasible.

Files in --out: tracking.png or tracking.svg.

Exit codes: 0 flown; 2 unusable arguments.";

/// Which comparison.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Comparison {
    /// 144 ellipses, to 60 m/s² and 20 m/s
    Tracking,
}

/// Arguments of `benchmark`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("out", |out| arguments::out(out, "Folder for the plot [default: out/benchmark]")))]
pub struct Arguments {
    /// The comparison
    #[arg(value_name = "COMPARISON")]
    comparison: Comparison,
    /// The nominal plant alone
    #[arg(long)]
    quick: bool,
    /// Who flies [default: every controller of rigid vehicles]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    controllers: Vec<String>,
    #[command(flatten)]
    threads: ThreadArguments,
    #[command(flatten)]
    output: OutputArguments,
}

/// Flies all of it.
pub fn run(a: &Arguments) -> Result<Report> {
    let Comparison::Tracking = a.comparison;
    let names = controllers(&a.controllers)?;
    let conditions = if a.quick { &TrackingCondition::ALL[..1] } else { &TrackingCondition::ALL[..] };
    let mut outputs = a.output.open("out/benchmark", false)?;
    let threads = a.threads.threads()?;
    let bar = progress::bar((names.len() * conditions.len()) as u64, "tracking", a.output.json);
    let (benchmark, mut rows) = (Tracking::new(&threads)?, Vec::new());
    for condition in conditions {
        for name in &names {
            progress::say(&bar, &format!("{name}: {}", condition.name()));
            rows.push(benchmark.fly(name, *condition, &threads)?);
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    outputs.draw("tracking", || figure(&rows))?;
    let written = outputs.written;
    if a.output.json {
        let value = json!({
            "command": "benchmark", "version": env!("CARGO_PKG_VERSION"), "success": true, "comparison": "tracking",
            "vehicle": quadrotor().name, "rows": rows.iter().map(told).collect::<Vec<_>>(), "files": files::names(&written),
        });
        return Ok(Report::json(&value, true));
    }
    Ok(Report::page(&page(&benchmark, &rows, &written), true))
}

/// Those asked for, or all that fly a rigid vehicle.
fn controllers(asked: &[String]) -> Result<Vec<String>> {
    let plant = Plant::of_vehicle(&quadrotor(), physics())?;
    let known: Vec<String> = REGISTRY.iter().filter(|e| e.suits(&plant)).map(|e| e.name.to_string()).collect();
    match asked.iter().find(|name| !known.contains(name)) {
        Some(name) => Err(Error::Unknown { kind: "controller of rigid vehicles", name: name.clone(), known }),
        None if asked.is_empty() => Ok(known),
        None => Ok(asked.to_vec()),
    }
}

fn all(_: &TrackingFlight) -> bool {
    true
}

fn feasible(flight: &TrackingFlight) -> bool {
    flight.feasible
}

fn told(row: &TrackingRow) -> Value {
    let (crashed, n) = row.crashes(all);
    json!({
        "controller": row.controller, "condition": row.condition, "rmse": row.mean_rmse(all), "rmse_feasible": row.mean_rmse(feasible),
        "crashed": crashed, "n": n, "published": row.condition.published(), "published_mpc": row.condition.published_mpc(),
        "flights": row.flights,
    })
}

fn page(benchmark: &Tracking, rows: &[TrackingRow], written: &[PathBuf]) -> Page {
    let mut page = Page::new();
    let (n, n_feasible) = (benchmark.cells().len(), benchmark.cells().iter().filter(|(_, feasible)| *feasible).count());
    page.title("tracking", &format!("{n} ellipses, {n_feasible} of them feasible"));
    for group in rows.chunk_by(|a, b| a.condition == b.condition) {
        let condition = group[0].condition;
        let mut beside = format!("published, feasible: {}", without_and_with(condition.published()));
        if condition == TrackingCondition::Nominal {
            beside += &format!("; all: {} m without INDI", short(PUBLISHED_OVER_ALL, 2));
        }
        let mut table = Table::new("controller | >feasible [m] | >all [m] | >crashed | >of feasible");
        for row in group {
            let counted = |(crashed, n): (usize, usize)| format!("{crashed} of {n}");
            let metres = |mean: Option<f64>| mean.map_or_else(|| "–".into(), |m| short(m, 3));
            table.row([
                row.controller.clone(),
                metres(row.mean_rmse(feasible)),
                metres(row.mean_rmse(all)),
                counted(row.crashes(all)),
                counted(row.crashes(feasible)),
            ]);
        }
        page.heading(condition.name()).table(table);
        page.line(format!("  {beside}"));
        let (published, crashed) = condition.published_mpc();
        let crashed = crashed.map_or_else(String::new, |share| format!("; {share} % crashed"));
        page.line(format!("  of nonlinear MPC: {}{crashed}", without_and_with(published)));
    }
    page.line(format!("\n  errors over {COUNTED} s, of flights that did not crash"));
    page.written(written);
    page
}

/// Published errors, m.
fn without_and_with([without, with]: [Option<f64>; 2]) -> String {
    let told = |m: Option<f64>, how: &str| m.map(|m| format!("{} m {how}", short(m, 3)));
    [told(without, "without INDI"), told(with, "with it")].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// Error over acceleration and speed on the nominal plant, a map per controller.
fn figure(rows: &[TrackingRow]) -> Figure {
    let nominal: Vec<&TrackingRow> = rows.iter().filter(|row| row.condition == TrackingCondition::Nominal).collect();
    let columns = nominal.len().clamp(1, 2);
    let lines = nominal.len().div_ceil(columns);
    let mut figure = Figure::new("Tracking ellipses: error [m] by peak acceleration and speed")
        .subtitle("mean of six ellipses; in brackets how many crashed; dark is 0, bright 1 m and more")
        .size(1000.0, 90.0 + 250.0 * lines as f64)
        .grid(&vec![1.0; columns], &vec![1.0; lines]);
    for (i, row) in nominal.iter().enumerate() {
        figure = figure.place((i % columns, i / columns), (1, 1), map(row));
    }
    figure
}

fn map(row: &TrackingRow) -> HeatMap {
    let chart = HeatMap::new(row.controller.clone(), "peak acceleration [m/s²]", "peak speed [m/s]")
        .ranges((5.0, 65.0), (2.5, 22.5));
    SPEEDS.into_iter().fold(chart, |chart, speed| {
        let cells = ACCELERATIONS.map(|acceleration| {
            let here = |f: &TrackingFlight| f.cell.speed == speed && f.cell.acceleration == acceleration;
            let crashed = row.flights.iter().filter(|f| here(f) && f.rmse.is_none()).count();
            match row.mean_rmse(here) {
                Some(m) if crashed == 0 => (m.min(1.0), short(m, 2)),
                Some(m) => (m.min(1.0), format!("{} ({crashed})", short(m, 2))),
                None => (f64::NAN, format!("({crashed})")),
            }
        });
        let (shares, texts) = cells.into_iter().unzip();
        chart.row(shares, texts)
    })
}
