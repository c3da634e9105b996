//! `omnidrones train-all`: every task by its recipe, several seeds, one table beside our controllers.

use super::arguments::{self, OutputArguments, ThreadArguments};
use super::page::{Page, duration, short};
use super::rollout_all::told_errors;
use super::rollout_files::percent;
use super::table::{Align, Table};
use super::train::{algorithm_of, algorithms, compare, count, spec};
use super::train_all_plot::{self, Learnt};
use super::{Report, files, progress};
use omnidrones::error::{Error, Result};
use omnidrones::parallel::Threads;
use omnidrones::rl::TrainConfig;
use omnidrones::rl::recipes::recipes_of;
use omnidrones::rl::trainer::{TrainResult, Trainer};
use omnidrones::tasks::registry::{self, Entry, REGISTRY};
use omnidrones::tasks::{Evaluation, Metric};
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
  omnidrones train-all                                 every task by all its recipes, 3 seeds each
  omnidrones train-all --tasks Hover,Track --seeds 10  some tasks, more seeds
  omnidrones train-all --algo ppo                      every task by PPO: its recipe, or else the defaults
  omnidrones train-all --budget 4                      four times as many updates
  omnidrones train-all --budget 0.1 --seeds 1          a quick look

A figure is the mean over seeds, in brackets the least and the largest. Time is that of training alone; share is the mean \
return over the largest reward of a step times the steps of an episode.

Exit codes: 0 all trained; 1 something was not; 2 unusable input or arguments.

Files in --out: a folder per run, table.json (what --json prints), curves (.png or .svg: success over environment steps).";

/// Arguments of `train-all`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("out", |out| arguments::out(out, "Folder of the runs and of the table [default: runs/all]")))]
pub struct Arguments {
    /// Tasks, separated by commas [default: all that are registered]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    tasks: Vec<String>,
    /// Train by this algorithm alone [default: by every algorithm that has a recipe for the task]
    #[arg(long, value_name = "NAME", value_parser = algorithms())]
    algo: Option<String>,
    /// Seeds of each task
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Updates, as a factor on those of the recipes
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    budget: f64,
    #[command(flatten)]
    threads: ThreadArguments,
    #[command(flatten)]
    output: OutputArguments,
}

/// A task by an algorithm: its runs, or why it was not trained; our controller in the last line of a task.
struct Line {
    entry: &'static Entry,
    algorithm: &'static str,
    /// What its error is; none where it was not trained.
    error: Option<Metric>,
    runs: std::result::Result<Vec<TrainResult>, String>,
    baseline: Option<(String, Evaluation)>,
}

/// Trains them.
pub fn run(a: &Arguments) -> Result<Report> {
    if !(a.budget.is_finite() && a.budget > 0.0) {
        return Err(Error::value("--budget", a.budget, "finite and > 0", "1 takes the recipes' updates."));
    }
    let threads = a.threads.threads()?;
    let entries = match &a.tasks[..] {
        [] => REGISTRY.iter().collect(),
        names => names.iter().map(|name| registry::by_name(name)).collect::<Result<Vec<_>>>()?,
    };
    let folder = a.output.folder("runs/all")?;
    let algorithms =
        |entry: &Entry| a.algo.as_deref().map_or_else(|| recipes_of(entry.name), |one| vec![algorithm_of(one)]);
    let trained: Vec<(&'static Entry, Vec<&str>)> = entries.into_iter().map(|e| (e, algorithms(e))).collect();
    let n: usize = trained.iter().map(|(_, algorithms)| algorithms.len()).sum();
    let bar = progress::bar(n as u64 * a.seeds, "training", a.output.json);
    let mut lines = Vec::new();
    for (entry, algorithms) in trained {
        lines.extend(algorithms.into_iter().map(|algorithm| line(entry, algorithm, a, &folder, &threads, &bar)));
        if let Some(last) = lines.last_mut() {
            progress::say(&bar, &format!("{} · by our controller", entry.name));
            let config = TrainConfig::for_task(entry.name, None, None)?;
            last.baseline = compare(entry, &config, &threads);
        }
    }
    bar.finish_and_clear();
    let mut written = Vec::new();
    if !a.output.no_plots {
        written.push(folder.join(format!("curves.{}", a.output.format.extension())));
        train_all_plot::draw(&learnt(&lines), &written[0])?;
    }
    let table = folder.join("table.json");
    files::write_new(&table, &format!("{:#}\n", value(&lines, a)), true)?;
    written.push(table);
    let success = lines.iter().all(|line| line.runs.is_ok());
    if a.output.json {
        return Ok(Report::json(&value(&lines, a), success));
    }
    written.push(folder);
    Ok(Report { text: page(&lines, a, &written), success })
}

fn line(
    entry: &'static Entry,
    algorithm: &str,
    a: &Arguments,
    folder: &Path,
    threads: &Threads,
    bar: &indicatif::ProgressBar,
) -> Line {
    let baseline = None;
    let config = match TrainConfig::for_task(entry.name, Some(algorithm), None) {
        Ok(config) => {
            let updates = (config.updates() as f64 * a.budget).ceil().max(1.0) as u64;
            config.with_updates(updates)
        }
        Err(error) => return Line { entry, algorithm: "–", error: None, runs: Err(error.to_string()), baseline },
    };
    let algorithm = config.algorithm.name();
    let each = (0..a.seeds).map(|seed| {
        let folder = folder.join(format!("{}-{algorithm}-u{}-s{seed}", entry.name, config.updates()));
        let own = TrainConfig { seed, ..config.clone() };
        let mut trainer = Trainer::new(entry.name, own, threads.clone())?.in_folder(folder, true)?;
        let outcome = trainer.run(&mut |p| {
            let words = format!("{} · {algorithm} · seed {seed} · {} of {}", entry.name, p.done, p.budget);
            progress::say(bar, &words);
            ControlFlow::Continue(())
        });
        bar.inc(1);
        outcome
    });
    let runs = each.collect::<Result<Vec<_>>>().map_err(|error| error.to_string());
    let error = spec(entry, &config).ok().map(|(_, error)| error);
    Line { entry, algorithm, error, runs, baseline }
}

/// Mean, least, largest.
fn spread(runs: &[TrainResult], of: impl Fn(&TrainResult) -> f64) -> [f64; 3] {
    let values: Vec<f64> = runs.iter().map(of).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let edge = |pick: fn(f64, f64) -> f64| values.iter().copied().fold(f64::NAN, pick);
    [mean, edge(f64::min), edge(f64::max)]
}

fn shown([mean, least, most]: [f64; 3], show: impl Fn(f64) -> String) -> String {
    let (mean, least, most) = (show(mean), show(least), show(most));
    if least == most { mean } else { format!("{mean} ({least}–{most})") }
}

/// The unit of all errors in the table, if it is one: then it stands in the head, else with every number.
fn unit<'a>(errors: impl Iterator<Item = &'a Metric>) -> Option<&'a str> {
    let mut units = errors.map(|error| error.unit.as_str());
    let first = units.next()?;
    units.all(|unit| unit == first).then_some(first)
}

fn table(lines: &[Line]) -> Table {
    let unit = unit(lines.iter().filter_map(|line| line.error.as_ref()));
    let head = |name: &str| unit.map_or(name.to_string(), |unit| format!("{name} [{unit}]"));
    let (last, mean) = (head("final error"), head("mean error"));
    let mut table = Table::new(&[
        ("task", Align::Left),
        ("flown by", Align::Left),
        ("success", Align::Right),
        ("crashed", Align::Right),
        (&last, Align::Right),
        (&mean, Align::Right),
        ("return", Align::Right),
        ("share", Align::Right),
        ("time", Align::Right),
        ("env steps", Align::Right),
    ]);
    for line in lines {
        let Ok(runs) = &line.runs else { continue };
        let of = |figure: fn(&Evaluation) -> f64| spread(runs, |o| figure(&o.evaluation));
        let own = line.error.as_ref().filter(|_| unit.is_none()).map_or(String::new(), |e| format!(" {}", e.unit));
        let error = |x: f64| short(x, 3) + &own;
        table.row([
            line.entry.name.to_string(),
            line.algorithm.into(),
            shown(of(|e| e.success), percent),
            shown(of(|e| e.crashed), percent),
            error(of(|e| e.final_error)[0]),
            error(of(|e| e.mean_error)[0]),
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
                error(e.final_error),
                error(e.mean_error),
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
    let errors = lines.iter().filter_map(|line| Some((line.entry.name, line.error.as_ref()?.name.as_str())));
    page.line(format!("\n{}; final: in the last step, also of who crashed.", told_errors(errors)));
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
            let run = |(seed, o): (usize, &TrainResult)| {
                json!({ "seed": seed, "evaluation": o.evaluation, "seconds": o.seconds, "env_steps": o.env_steps, "updates": o.updates })
            };
            runs.iter().enumerate().map(run).collect()
        });
        json!({
            "task": line.entry.name,
            "algorithm": line.algorithm,
            "error": line.error,
            "runs": runs,
            "not_trained": line.runs.as_ref().err(),
            "baseline": controller(line, lines).map(|(name, e)| json!({ "flown_by": name, "evaluation": e })),
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

/// What is drawn.
fn learnt(lines: &[Line]) -> Vec<Learnt<'_>> {
    fn of<'a>(line: &'a Line, lines: &[Line]) -> Option<Learnt<'a>> {
        let runs = line.runs.as_ref().ok()?.iter().map(|outcome| &outcome.curve[..]).collect();
        let controller = controller(line, lines).map(|(_, e)| e.success);
        Some(Learnt { task: line.entry.name, algorithm: line.algorithm, runs, controller })
    }
    lines.iter().filter_map(|line| of(line, lines)).collect()
}

/// What our controller does in the task of a line.
fn controller<'a>(line: &Line, lines: &'a [Line]) -> Option<&'a (String, Evaluation)> {
    lines.iter().filter(|other| other.entry.name == line.entry.name).find_map(|other| other.baseline.as_ref())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_shows_its_edges_only_where_they_differ() {
        assert_eq!(shown([0.5, 0.4, 0.6], percent), "50 % (40 %–60 %)");
        assert_eq!(shown([1.0, 1.0, 1.0], percent), "100 %");
    }

    #[test]
    fn a_unit_that_all_errors_share_stands_in_the_head() {
        let metric = |name: &str, unit: &str| Metric { name: name.into(), unit: unit.into() };
        let (metre, other) = (metric("position_error", "m"), metric("heading", "rad"));
        assert_eq!(unit([&metre, &metre].into_iter()), Some("m"));
        assert_eq!(unit([&metre, &other].into_iter()), None);
        assert_eq!(unit([].into_iter()), None);
    }
}
