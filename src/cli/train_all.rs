//! `omnidrones train-all`: every task by its recipe, several seeds, one table beside our controllers.

use super::arguments::FormatName;
use super::page::{Page, duration, short};
use super::rollout_files::percent;
use super::table::{Align, Table};
use super::train::{compare, count};
use super::{Report, files, progress};
use omnidrones::error::{Error, Result};
use omnidrones::parallel::Threads;
use omnidrones::plot::{Colour, Figure, Panel, Series};
use omnidrones::rl::TrainConfig;
use omnidrones::rl::trainer::{Outcome, Trainer};
use omnidrones::tasks::Evaluation;
use omnidrones::tasks::registry::{self, Entry, REGISTRY};
use serde_json::{Value, json};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// What the command is for.
pub const ABOUT: &str = "\
Train every task by its recipe, with several seeds, and print one table: success, crashes, errors, return, time and \
environment steps, and under each task what our controller does from the same starts. Runs are kept, so a table that was \
killed goes on where it stopped.";

const EXAMPLES: &str = "\
Examples:
  omnidrones train-all                                 every task, 3 seeds, the budgets of the recipes
  omnidrones train-all --tasks Hover,Track --seeds 10  some tasks, more seeds
  omnidrones train-all --budget 4                      four times as many updates
  omnidrones train-all --budget 0.1 --seeds 1          a quick look

A figure is the mean over seeds, in brackets the least and the largest. Time is that of training alone; share is the mean \
return over the largest reward of a step times the steps of an episode.";

/// Arguments of `train-all`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Tasks, separated by commas [default: all that are registered]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    tasks: Vec<String>,
    /// Seeds of each task
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Updates, as a factor on those of the recipes
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    budget: f64,
    /// Threads; the results do not depend on it [default: all cores]
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Folder of the runs and of the table
    #[arg(long, value_name = "DIR", default_value = "runs/all", help_heading = "Output")]
    out: PathBuf,
    /// File type of the plot
    #[arg(long, value_name = "TYPE", default_value = "svg", help_heading = "Output")]
    format: FormatName,
    /// Print one JSON object and nothing else
    #[arg(long, help_heading = "Output")]
    json: bool,
}

/// A task: its runs, or why it was not trained, and our controller.
struct Line {
    entry: &'static Entry,
    algorithm: &'static str,
    runs: std::result::Result<Vec<Outcome>, String>,
    baseline: Option<(String, Evaluation)>,
}

/// Trains them.
pub fn run(a: &Arguments) -> Result<Report> {
    if !(a.budget.is_finite() && a.budget > 0.0) {
        return Err(Error::value("--budget", a.budget, "finite and > 0", "1 takes the recipes' updates."));
    }
    let threads = a.threads.map_or_else(|| Ok(Threads::default()), Threads::new)?;
    let entries = match &a.tasks[..] {
        [] => REGISTRY.iter().collect(),
        names => names.iter().map(|name| registry::by_name(name)).collect::<Result<Vec<_>>>()?,
    };
    files::prepare_folder(&a.out)?;
    let bar = progress::bar(entries.len() as u64 * a.seeds, "training", a.json);
    let mut lines = Vec::new();
    for entry in entries {
        lines.push(line(entry, a, &threads, &bar));
    }
    bar.finish_and_clear();
    let mut written = vec![a.out.join(format!("curves.{}", a.format.extension())), a.out.join("table.json")];
    draw(&lines, &written[0])?;
    files::write_new(&written[1], &format!("{:#}\n", value(&lines, a)), true)?;
    if a.json {
        return Ok(Report::json(&value(&lines, a), true));
    }
    written.push(a.out.clone());
    Ok(Report::done(page(&lines, a, &written)))
}

fn line(entry: &'static Entry, a: &Arguments, threads: &Threads, bar: &indicatif::ProgressBar) -> Line {
    let config = match TrainConfig::for_task(entry.name, None, None) {
        Ok(config) => {
            let updates = (config.updates() as f64 * a.budget).ceil().max(1.0) as u64;
            config.with_updates(updates)
        }
        Err(error) => return Line { entry, algorithm: "–", runs: Err(error.to_string()), baseline: None },
    };
    let algorithm = config.algorithm.name();
    let each = (0..a.seeds).map(|seed| {
        let folder = a.out.join(format!("{}-{algorithm}-u{}-s{seed}", entry.name, config.updates()));
        let own = TrainConfig { seed, ..config.clone() };
        let mut trainer = Trainer::new(entry.name, own, threads.clone())?.in_folder(folder, true)?;
        let outcome = trainer.run(&mut |p| {
            bar.set_message(format!("{} ({algorithm}, seed {seed}): {} of {}", entry.name, p.done, p.budget));
            ControlFlow::Continue(())
        });
        bar.inc(1);
        outcome
    });
    let runs = each.collect::<Result<Vec<_>>>().map_err(|error| error.to_string());
    bar.set_message(format!("{} by our controller", entry.name));
    Line { entry, algorithm, runs, baseline: compare(entry, &config, threads) }
}

/// Mean, least, largest.
fn spread(runs: &[Outcome], of: impl Fn(&Outcome) -> f64) -> [f64; 3] {
    let values: Vec<f64> = runs.iter().map(of).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let edge = |pick: fn(f64, f64) -> f64| values.iter().copied().fold(f64::NAN, pick);
    [mean, edge(f64::min), edge(f64::max)]
}

fn shown([mean, least, most]: [f64; 3], show: impl Fn(f64) -> String) -> String {
    let (mean, least, most) = (show(mean), show(least), show(most));
    if least == most { mean } else { format!("{mean} ({least}–{most})") }
}

fn table(lines: &[Line]) -> Table {
    let mut table = Table::new(&[
        ("task", Align::Left),
        ("flown by", Align::Left),
        ("success", Align::Right),
        ("crashed", Align::Right),
        ("final error [m]", Align::Right),
        ("mean error [m]", Align::Right),
        ("return", Align::Right),
        ("share", Align::Right),
        ("time", Align::Right),
        ("env steps", Align::Right),
    ]);
    for line in lines {
        let Ok(runs) = &line.runs else { continue };
        let of = |figure: fn(&Evaluation) -> f64| spread(runs, |o| figure(&o.evaluation));
        table.row([
            line.entry.name.to_string(),
            line.algorithm.into(),
            shown(of(|e| e.success), percent),
            shown(of(|e| e.crashed), percent),
            short(of(|e| e.final_error)[0], 3),
            short(of(|e| e.mean_error)[0], 3),
            short(of(|e| e.return_mean)[0], 4),
            percent(of(|e| e.share_of_bound)[0]),
            duration(spread(runs, |o| o.seconds)[0]),
            count(spread(runs, |o| o.env_steps as f64)[0]),
        ]);
        if let Some((name, e)) = &line.baseline {
            table.row([
                String::new(),
                name.clone(),
                percent(e.success),
                percent(e.crashed),
                short(e.final_error, 3),
                short(e.mean_error, 3),
                short(e.return_mean, 4),
                percent(e.share_of_bound),
                "–".into(),
                "–".into(),
            ]);
        }
    }
    table
}

fn page(lines: &[Line], a: &Arguments, written: &[PathBuf]) -> String {
    let mut page = Page::new();
    let seeds = if a.seeds == 1 { "1 seed".into() } else { format!("{} seeds", a.seeds) };
    page.title("Learning", &format!("{seeds}, budgets × {}, held-out starts", short(a.budget, 3)));
    page.table(&table(lines));
    let failed: Vec<&Line> = lines.iter().filter(|line| line.runs.is_err()).collect();
    if !failed.is_empty() {
        page.heading("Not trained");
        for line in failed {
            page.line(format!("  {}: {}", line.entry.name, line.runs.as_ref().err().map_or("", |why| why)));
        }
    }
    page.heading("Written");
    for path in written {
        page.line(format!("  {}", path.display()));
    }
    page.finish()
}

fn value(lines: &[Line], a: &Arguments) -> Value {
    let tasks = lines.iter().map(|line| {
        let runs = line.runs.as_ref().map_or(Vec::new(), |runs| {
            let run = |(seed, o): (usize, &Outcome)| {
                json!({ "seed": seed, "evaluation": o.evaluation, "seconds": o.seconds, "env_steps": o.env_steps, "updates": o.updates })
            };
            runs.iter().enumerate().map(run).collect()
        });
        json!({
            "task": line.entry.name,
            "algorithm": line.algorithm,
            "runs": runs,
            "not_trained": line.runs.as_ref().err(),
            "baseline": line.baseline.as_ref().map(|(name, e)| json!({ "flown_by": name, "evaluation": e })),
        })
    });
    json!({
        "command": "train-all",
        "version": env!("CARGO_PKG_VERSION"),
        "seeds": a.seeds,
        "budget": a.budget,
        "tasks": tasks.collect::<Vec<_>>(),
    })
}

/// Success over training time, a panel per task, a line per seed.
fn draw(lines: &[Line], path: &Path) -> Result<()> {
    const COLUMNS: usize = 4;
    let trained: Vec<(&Line, &Vec<Outcome>)> =
        lines.iter().filter_map(|line| Some((line, line.runs.as_ref().ok()?))).collect();
    let rows = trained.len().div_ceil(COLUMNS).max(1);
    let mut figure = Figure::new("Learning curves")
        .subtitle("success from held-out starts over training time, a line per seed; dashed: our controller")
        .size(1200.0, 60.0 + 210.0 * rows as f64)
        .grid(&[1.0; COLUMNS], &vec![1.0; rows]);
    for (k, (line, runs)) in trained.into_iter().enumerate() {
        let title = format!("{} ({})", line.entry.name, line.algorithm);
        let mut panel = Panel::new(&title, "time [s]", "success [%]").y_range(0.0, 104.0);
        for outcome in runs {
            let point = |l: &omnidrones::rl::log::Line| Some((l.get("seconds")?, 100.0 * l.get("eval_success")?));
            let points = outcome.curve.iter().filter_map(point).collect();
            panel = panel.series(Series::line("", points).colour(Colour::BLUE).width(1.2));
        }
        if let Some((_, e)) = &line.baseline {
            panel = panel.level("", 100.0 * e.success, Colour::GREEN);
        }
        figure = figure.place((k % COLUMNS, k / COLUMNS), (1, 1), panel);
    }
    figure.save(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_shows_its_edges_only_where_they_differ() {
        assert_eq!(shown([0.5, 0.4, 0.6], percent), "50 % (40 %–60 %)");
        assert_eq!(shown([1.0, 1.0, 1.0], percent), "100 %");
    }
}
