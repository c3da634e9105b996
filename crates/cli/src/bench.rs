//! `omnidrones bench`: how fast this machine steps and differentiates, against a plain loop in the same run; or how fast it
//! steps the environments of a task.

use super::arguments::{self, OutputArguments};
use super::environment::EnvArguments;
use crate::prelude::*;
use omnidrones::autodiff::lane_width;
use omnidrones::autodiff::native::instructions;
use omnidrones::tasks::EnvConfig;
use omnidrones::tasks::registry::{self, TaskEntry};
use omnidrones_bench::environment::{self, Case, SIZES};
use omnidrones_bench::{BenchPlan, BenchRow, learning};
use omnidrones_plot::{Bar, Bars, Colour, Figure};
use std::time::Duration;

/// What the command is for.
pub const ABOUT: &str = "\
Measure how fast this machine steps and differentiates a multirotor: single steps on each kind of number, batches on \
one and more threads, Jacobians, adjoints, rollout gradients; and steps of every built-in configuration. Each figure is set against a plain loop measured in the \
same run, so that ratios hold where absolute figures depend on the machine.

With a task: environment steps per second, everything included (actions, control, physics, observation, reward, ends, \
resets), for batches of several sizes, against the physics alone of one environment in a plain loop.";

const EXAMPLES: &str = "\
Examples:
  omnidrones bench --quick               a first impression, in seconds
  omnidrones bench                       steadier figures
  omnidrones bench --threads 1           batches on one thread only
  omnidrones bench --json --no-plots     for a program
  omnidrones bench Hover                 environment steps per second of a task
  omnidrones bench Track --envs 16384 --threads 2
  omnidrones bench --policy              Track and OverHover with a 3 × 256 policy, beside the paper
  omnidrones bench Hover --vehicle firefly --randomise mass:0.8:1.2

Without a task the subject is a Hummingbird, then every configuration, under RK4 at 16 ms with linear drag. A ratio says how many times the baseline: in speed for rates, in time for durations.

With a task: random actions close to hover, episodes that begin anywhere in time; 'rotor' and 'rate' are the level at \
which actions enter, --control and --integrator name one. The plain loop steps one vehicle or model in f64, without task, observations or resets. One environment in a \
loop is a batch of one: it computes a block of 64 lanes and uses one.

Files in --out: bench.png or bench.svg, with a task TASK.png or TASK.svg. Close other programs: figures fall with their load.

Exit codes: 0 measured; 2 unusable arguments.";

/// Time per row with --quick.
const QUICK: Duration = Duration::from_millis(60);

/// Arguments of `bench`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("out", |out| arguments::out(out, "Folder for the plot [default: out/bench]")))]
pub struct Arguments {
    /// A task ('omnidrones tasks'); without it, steps and derivatives of vehicles
    #[arg(value_name = "TASK")]
    task: Option<String>,
    /// Short runs: about 5 s instead of 20 s, and less steady figures
    #[arg(long)]
    quick: bool,
    /// Most threads of the batch rows: 1, 2, 4 … up to this [default: all cores]
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Environments of the batch rows [default: 4096; of a task 1024, 4096 and 65536, with --quick 1024 and 4096]
    #[arg(long, value_name = "N")]
    envs: Option<usize>,
    /// Track and OverHover with a policy of these hidden layers in the loop, beside the OmniDrones paper [without units:
    /// 256,256,256]
    #[arg(long, value_name = "UNITS", value_delimiter = ',', num_args = 0..=1, default_missing_value = "256,256,256")]
    #[arg(conflicts_with_all = ["task", "envs"])]
    policy: Vec<usize>,
    #[command(flatten)]
    output: OutputArguments,
    #[command(flatten)]
    environment: EnvArguments,
}

/// Measures.
pub fn run(a: &Arguments) -> Result<Report> {
    let usual = BenchPlan::default();
    let threads = a.threads.unwrap_or(usual.threads);
    if !(1..=1024).contains(&threads) {
        return Err(Error::limit("--threads", threads, "1 to 1024", "Use as many as there are cores."));
    }
    let task = a.task.as_deref().map(registry::by_name).transpose()?;
    if task.is_none() && a.environment.given() {
        let remedy = "Name a task: omnidrones bench Hover.";
        return Err(Error::value("options of environments", "given without a task", "left out", remedy));
    }
    let mut outputs = a.output.open("out/bench", false)?;
    let spinner = progress::spinner("measuring", a.output.json);
    let budget = if a.quick { QUICK } else { usual.budget };
    let plan = BenchPlan { budget, n_env: a.envs.unwrap_or(usual.n_env), threads };
    let mut tell = |row: &BenchRow| spinner.set_message(format!("measured {}: {}", row.group, row.name));
    let rows = match task {
        None if !a.policy.is_empty() => learning::run(&plan, &a.policy, &mut tell)?,
        None => omnidrones_bench::run(&plan, &mut tell)?,
        Some(entry) => measure(a, entry, &plan, &mut tell)?,
    };
    spinner.finish_and_clear();

    match task {
        Some(entry) => outputs.draw(entry.name, || task_figure(entry, &rows)),
        None if !a.policy.is_empty() => outputs.draw("policy", || policy_figure(&a.policy, &rows)),
        None => outputs.draw("bench", || figure(&rows)),
    }?;
    let written = outputs.written;
    if a.output.json {
        let value = json!({
            "command": "bench",
            "version": env!("CARGO_PKG_VERSION"),
            "quick": a.quick,
            "task": task.map(|entry| entry.name),
            "lane_width": lane_width(),
            "instructions": instructions(),
            "rows": rows,
            "files": files::names(&written),
        });
        return Ok(Report::json(&value, true));
    }
    let mut page = Page::new();
    page.line(machine());
    let mut table = Table::new("what |  | >figure | unit | >ratio | against");
    let mut group = "";
    for row in &rows {
        let first = if row.group == group { "" } else { row.group };
        group = row.group;
        let (ratio, against) = match row.ratio {
            Some(r) => (format!("{} ×", short(r, 3)), row.baseline),
            None => (String::new(), ""),
        };
        table.row([first, &row.name, &short(row.value, 4), row.unit, &ratio, against].map(str::to_string));
    }
    page.table(table);
    page.written(&written);
    Ok(Report::page(&page, true))
}

/// Steps of a task's environments.
fn measure(
    a: &Arguments,
    entry: &TaskEntry,
    plan: &BenchPlan,
    tell: &mut dyn FnMut(&BenchRow),
) -> Result<Vec<BenchRow>> {
    let config = a.environment.config(&EnvConfig::default(), Some(entry))?;
    let sizes = match a.envs {
        Some(n) => vec![n],
        None if a.quick => SIZES[..2].to_vec(),
        None => SIZES.to_vec(),
    };
    let wanted = |case: &Case| {
        a.environment.level().is_none_or(|level| level == case.control)
            && a.environment.integrator().is_none_or(|integrator| integrator == case.integrator)
    };
    let mut cases: Vec<Case> = Case::USUAL.into_iter().filter(wanted).collect();
    if let (Some(control), true) = (a.environment.level(), cases.is_empty()) {
        let all = Case::USUAL.into_iter().take(2).map(|case| Case { control, ..case });
        cases = all.filter(wanted).collect();
    }
    environment::run(plan, entry, &config, &cases, &sizes, tell)
}

/// Throughput by batch size, one colour per control level and integrator.
fn task_figure(entry: &TaskEntry, rows: &[BenchRow]) -> Figure {
    let mut bars =
        Bars::new("Whole steps: actions to observations, rewards, resets", "million environment steps per second");
    let mut groups: Vec<&str> = Vec::new();
    for row in rows.iter().filter(|row| row.unit == "M steps/s") {
        if !groups.contains(&row.group) {
            groups.push(row.group);
        }
        let note = row.ratio.filter(|r| *r != 1.0).map_or_else(String::new, |r| format!("({} ×)", short(r, 3)));
        let name = format!("{}: {}", row.group, row.name);
        bars = bars.bar(Bar::new(name, row.value).note(note).colour(Colour::nth(groups.len() - 1)));
    }
    Figure::new(format!("{}: speed of environments", entry.name))
        .subtitle(format!("{}; (×) against the physics of one in a plain loop", machine()))
        .size(1000.0, (130.0 + 22.0 * bars.bars.len() as f64).min(3000.0))
        .chart(bars)
}

/// Frames per second with a policy in the loop, and the paper's beside each.
fn policy_figure(hidden: &[usize], rows: &[BenchRow]) -> Figure {
    let mut bars = Bars::new("Observation, policy, action, step", "thousand environment steps per second");
    for row in rows {
        let name = format!("{}, {}", row.group, row.name);
        bars = bars.bar(Bar::new(format!("{name}: here"), row.value).colour(Colour::BLUE));
        let paper = row.value / row.ratio.unwrap_or(1.0);
        bars = bars.bar(Bar::new(format!("{name}: paper"), paper).colour(Colour::GREY));
    }
    let units: Vec<String> = hidden.iter().map(usize::to_string).collect();
    Figure::new("Environments with a policy in the loop")
        .subtitle(format!("hidden layers {}; {}; paper: one RTX 4090", units.join(", "), machine()))
        .size(1000.0, 130.0 + 22.0 * bars.bars.len() as f64)
        .chart(bars)
}

/// What it ran on.
fn machine() -> String {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    format!("a machine of {cores} cores, {} lanes of f32 per SIMD register, {}", lane_width(), instructions())
}

/// Throughput of batches, and every other figure as a multiple of its baseline.
fn figure(rows: &[BenchRow]) -> Figure {
    let mut batch = Bars::new("Batches in SIMD lanes", "million environment steps per second");
    let mut cost = Bars::new("Cost of steps and derivatives", "times one plain f64 step (a gradient: one rollout)")
        .baseline("one step, one rollout", 1.0)
        .log();
    let mut groups: Vec<&str> = Vec::new();
    for row in rows {
        let Some(ratio) = row.ratio else { continue };
        if row.unit == "M steps/s" {
            let note = format!("({} × {})", short(ratio, 3), row.baseline);
            batch = batch.bar(Bar::new(row.name.clone(), row.value).note(note));
            continue;
        }
        if !groups.contains(&row.group) {
            groups.push(row.group);
        }
        // a ratio of rates says how many times as fast, one of times how many times as dear
        let cost_of = if row.unit.ends_with("/s") { 1.0 / ratio } else { ratio };
        let note = format!("× ({} {})", short(row.value, 3), row.unit);
        let name = if row.group == "step" { format!("step on {}", row.name) } else { row.name.clone() };
        cost = cost.bar(Bar::new(name, cost_of).note(note).colour(Colour::nth(groups.len())));
    }
    let heights = [&batch, &cost].map(|bars| 70.0 + 22.0 * bars.bars.len() as f64);
    Figure::new("Speed of steps and derivatives")
        .subtitle(machine())
        .size(1000.0, (60.0 + heights[0] + heights[1]).min(3000.0))
        .grid(&[1.0], &heights)
        .place((0, 0), (1, 1), batch)
        .place((0, 1), (1, 1), cost)
}
