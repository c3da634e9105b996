//! `omnidrones train-all`: every task by its recipe, several seeds, one table beside our controllers.

use super::arguments::{self, OutputArguments, ThreadArguments, algorithms};
use super::baseline::{FIGURES, compare, spec};
use super::over_seeds;
use super::over_seeds::{Failure, shown, spread};
use super::rollout_all::told_errors;
use super::run_table::{self, MAX_ROW, Row};
use super::train_all_plot::{self, Learnt};
use crate::prelude::*;
use omnidrones::internals;
use omnidrones::parallel::Threads;
use omnidrones::rl::TrainConfig;
use omnidrones::rl::log::Line as LogLine;
use omnidrones::rl::recipes::recipes_of;
use omnidrones::tasks::registry::{self, REGISTRY, TaskEntry};
use omnidrones::tasks::{Evaluation, Metric};
use omnidrones_studies::plan::budgeted;
use std::collections::BTreeMap;

/// What the command is for.
pub const ABOUT: &str = "\
Train every task by its recipe, with several seeds, and print one table: success, crashes, errors, return, time and \
environment steps, and under each task what our controller does from the same starts. Runs are kept, so a table that was \
killed goes on where it stopped.";

const EXAMPLES: &str = "\
Examples:
  omnidrones train-all                                 every task by all its recipes, 5 seeds each
  omnidrones train-all --tasks Hover,Track --seeds 10  some tasks, more seeds
  omnidrones train-all --algo ppo                      every task by PPO: its recipe, or else the defaults
  omnidrones train-all --budget 4                      four times as many updates
  omnidrones train-all --budget 0.1 --seeds 1          a quick look

A figure is the mean over seeds, ± half the width of its 95 % confidence interval (Student's t), in brackets the least and the \
largest. Time is that of training alone; share is the mean return over the largest reward of a step times the steps of an \
episode.

A row that is finished stands in a file of its own, with the commit that trained each seed and a hash of its settings, task and \
physics. It is kept the next time, and trained anew where the hash has changed; seeds that are missing are added. A seed that \
fails leaves the others alone.

Exit codes: 0 all trained; 1 something was not; 2 unusable input or arguments.

Files in --out: a row per task and algorithm (TASK-ALGO-uUPDATES.json), a folder per run, table.json (what --json prints), \
curves (.png or .svg: success over environment steps). A row holds its curves: the folders of its runs, of sac, td3 and dqn up to \
gigabytes each, may be removed.";

/// Arguments of `train-all`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("out", |out| arguments::out(out, "Folder of the runs and of the table [default: runs/all]")))]
pub struct Arguments {
    /// Tasks, separated by commas [default: all that are registered]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    tasks: Vec<String>,
    /// Train by this algorithm alone [default: by every algorithm that has a recipe for the task]
    #[arg(long, value_name = "NAME", value_parser = algorithms(), ignore_case = true)]
    algo: Option<String>,
    /// Seeds of each task
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Updates, as a factor on those of the recipes
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    budget: f64,
    #[command(flatten)]
    threads: ThreadArguments,
    #[command(flatten)]
    output: OutputArguments,
}

/// A task by an algorithm: its row, or why there is none; our controller in the last line of a task.
pub struct Line {
    entry: &'static TaskEntry,
    algorithm: String,
    /// What its error is; none where it was not trained.
    error: Option<Metric>,
    row: std::result::Result<Row, String>,
    /// The course of every seed.
    curves: Vec<Vec<LogLine>>,
    baseline: Option<(String, Evaluation)>,
}

/// Files of a folder that are called as rows are.
fn row_files(folder: &Path) -> Vec<PathBuf> {
    let names = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> = names.filter(|path| run_table::is_row(path)).collect();
    files.sort();
    files
}

/// Whether a folder holds rows.
pub fn has_rows(folder: &Path) -> bool {
    !row_files(folder).is_empty()
}

/// The rows of a folder in the order of the tasks, and what could not be read of it; our controller's figures from the table
/// there, if there is one, else flown by `fly`.
pub fn read(
    folder: &Path,
    fly: &dyn Fn(&'static TaskEntry) -> Option<(String, Evaluation)>,
) -> (Vec<Line>, Vec<String>) {
    let (mut rows, mut unread): (Vec<(&'static TaskEntry, Row)>, _) = (Vec::new(), Vec::new());
    for path in row_files(folder) {
        match run_table::read(&path).and_then(|row| Ok((registry::by_name(&row.task)?, row))) {
            Ok(row) => rows.push(row),
            Err(error) => unread.push(error.to_string()),
        }
    }
    let place = |entry: &TaskEntry| REGISTRY.iter().position(|e| e.name == entry.name);
    rows.sort_by_key(|(entry, row)| (place(entry), row.label()));
    let known = known_baselines(&folder.join("table.json")).unwrap_or_else(|error| {
        unread.push(error.to_string());
        BTreeMap::new()
    });
    let line = |(entry, row): (&'static TaskEntry, Row)| {
        let config = TrainConfig::for_task(entry.name, Some(&row.algorithm), None).ok();
        Line {
            entry,
            algorithm: row.label(),
            error: config.and_then(|config| spec(entry, &config).ok()).map(|(_, error)| error),
            curves: row.curves(folder),
            row: Ok(row),
            baseline: None,
        }
    };
    let mut lines: Vec<Line> = rows.into_iter().map(line).collect();
    for k in 0..lines.len() {
        let entry = lines[k].entry;
        if lines.get(k + 1).is_none_or(|next| next.entry.name != entry.name) {
            lines[k].baseline = known.get(entry.name).cloned().or_else(|| fly(entry));
        }
    }
    (lines, unread)
}

/// Our controller's figures by task, as the table of a folder tells them.
fn known_baselines(table: &Path) -> Result<BTreeMap<String, (String, Evaluation)>> {
    if table.symlink_metadata().is_err() {
        return Ok(BTreeMap::new());
    }
    let text = files::read_text(table, MAX_ROW)?;
    let remedy = "Remove it: 'omnidrones train-all' writes it anew.";
    let value: Value = internals::of_json(text.as_bytes(), &table.display().to_string(), remedy)?;
    let of = |task: &Value| {
        let (name, told) = (task["task"].as_str()?, &task["baseline"]);
        let evaluation = serde_json::from_value(told["evaluation"].clone()).ok()?;
        Some((name.to_string(), (told["flown_by"].as_str()?.to_string(), evaluation)))
    };
    Ok(value["tasks"].as_array().into_iter().flatten().filter_map(of).collect())
}

impl Line {
    /// Where each row comes from, for a table, and folders of its runs that are here.
    pub fn origin(&self, folder: &Path) -> Option<([String; 5], Vec<PathBuf>)> {
        let row = self.row.as_ref().ok()?;
        let runs = row.runs.iter().map(|run| row.run_folder(folder, run.seed)).filter(|path| path.is_dir()).collect();
        Some((row.origin(), runs))
    }
}

/// Trains them.
pub fn run(a: &Arguments) -> Result<Report> {
    run_table::check_budget(a.budget)?;
    let threads = a.threads.threads()?;
    let entries = match &a.tasks[..] {
        [] => REGISTRY.iter().collect(),
        names => names.iter().map(|name| registry::by_name(name)).collect::<Result<Vec<_>>>()?,
    };
    let mut outputs = a.output.open("runs/all", true)?;
    let folder = outputs.folder.clone();
    let algorithms = |entry: &TaskEntry| a.algo.as_deref().map_or_else(|| recipes_of(entry.name), |one| vec![one]);
    let trained: Vec<(&'static TaskEntry, Vec<&str>)> = entries.into_iter().map(|e| (e, algorithms(e))).collect();
    let bar = progress::bar(0, "training", a.output.json);
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
    outputs.draw("curves", || train_all_plot::figure(&learnt(&lines)))?;
    outputs.text("table.json", format!("{:#}\n", value(&lines, a)))?;
    let success = lines.iter().all(|line| line.row.as_ref().is_ok_and(|row| row.failed.is_empty()));
    outputs.written.push(folder);
    Ok(Report::told(a.output.json, success, || value(&lines, a), || page(&lines, a, &outputs.written)))
}

fn line(
    entry: &'static TaskEntry,
    algorithm: &str,
    a: &Arguments,
    folder: &Path,
    threads: &Threads,
    bar: &indicatif::ProgressBar,
) -> Line {
    let mut line = Line {
        entry,
        algorithm: algorithm.into(),
        error: None,
        row: Err(String::new()),
        curves: Vec::new(),
        baseline: None,
    };
    let config = TrainConfig::for_task(entry.name, Some(algorithm), None).map(|config| budgeted(config, a.budget));
    line.error = config.as_ref().ok().and_then(|config| spec(entry, config).ok()).map(|(_, error)| error);
    let train = |config: TrainConfig| {
        let asked = run_table::Asked { algorithm, setting: "", config: &config, seeds: a.seeds };
        run_table::train(&asked, folder, threads, bar)
    };
    line.row = config.and_then(train).map_err(|error| error.to_string());
    if let Ok(row) = &line.row {
        line.curves = row.curves(folder);
    }
    line
}

/// The unit of all errors in the table, if it is one: then it stands in the head, else with every number.
fn unit<'a>(errors: impl Iterator<Item = &'a Metric>) -> Option<&'a str> {
    let mut units = errors.map(|error| error.unit.as_str());
    let first = units.next()?;
    units.all(|unit| unit == first).then_some(first)
}

/// A row per algorithm, our controller below those of a task.
pub fn table(lines: &[Line]) -> Table {
    let unit = unit(lines.iter().filter_map(|line| line.error.as_ref()));
    let head = |name: &str| unit.map_or(name.to_string(), |unit| format!("{name} [{unit}]"));
    let (last, mean) = (head("final error"), head("mean error"));
    let mut table = Table::new(&format!(
        "task | flown by | >success | >crashed | >{last} | >{mean} | >Δ command | >return | >share | >time | >env steps"
    ));
    for line in lines {
        let Some(Row { runs, .. }) = line.row.as_ref().ok().filter(|row| !row.runs.is_empty()) else { continue };
        let of = |figure: fn(&Evaluation) -> f64| spread(runs, |run| figure(&run.evaluation));
        let mean = |figure: fn(&Evaluation) -> f64| of(figure).map_or(f64::NAN, |all| all.mean);
        let own = line.error.as_ref().filter(|_| unit.is_none()).map_or(String::new(), |e| format!(" {}", e.unit));
        let error = |x: f64| short(x, 3) + &own;
        table.row([
            line.entry.name.to_string(),
            line.algorithm.clone(),
            shown(of(|e| e.success), percent, 100.0),
            percent(mean(|e| e.crashed)),
            error(mean(|e| e.final_error)),
            error(mean(|e| e.mean_error)),
            short(mean(Evaluation::command_change), 2),
            short(mean(|e| e.return_mean), 4),
            shown(of(|e| e.share_of_bound), percent, 100.0),
            spread(runs, |run| run.seconds).map_or("–".into(), |all| duration(all.mean)),
            spread(runs, |run| run.env_steps as f64).map_or("–".into(), |all| count(all.mean)),
        ]);
        if let Some((name, e)) = &line.baseline {
            let mut figures = FIGURES.map(|(of, show, _)| show(of(e)));
            figures[2..4].iter_mut().for_each(|figure| *figure += &own);
            table.row([String::new(), name.clone()].into_iter().chain(figures).chain(["–".into(), "–".into()]));
        }
    }
    table
}

fn page(lines: &[Line], a: &Arguments, written: &[PathBuf]) -> Page {
    let mut page = Page::new();
    let seeds = if a.seeds == 1 { "1 seed".into() } else { format!("{} seeds", a.seeds) };
    page.title("Learning", &format!("{seeds}, budgets × {}, held-out starts", short(a.budget, 3)));
    page.table(table(lines));
    page.line(format!("\n{}", key(lines)));
    page.lines("Not trained", lines.iter().flat_map(failures));
    page.written(written);
    page
}

/// What the errors of the table are.
pub fn key(lines: &[Line]) -> String {
    let errors = lines.iter().filter_map(|line| Some((line.entry.name, line.error.as_ref()?.name.as_str())));
    format!("{}; final: in the last step, also of who crashed.", told_errors(errors))
}

/// What was not trained in a line, in words.
fn failures(line: &Line) -> Vec<String> {
    let name = format!("{} by {}", line.entry.name, line.algorithm);
    match &line.row {
        Err(why) => vec![format!("{name}: {why}")],
        Ok(row) => row.failed.iter().map(|Failure { seed, why }| format!("{name}, seed {seed}: {why}")).collect(),
    }
}

fn value(lines: &[Line], a: &Arguments) -> Value {
    let tasks = lines.iter().map(|line| {
        let (runs, failed) = line.row.as_ref().map_or((&[][..], &[][..]), |row| (&row.runs, &row.failed));
        let mut told = over_seeds::value(runs, failed);
        told["task"] = line.entry.name.into();
        told["algorithm"] = line.algorithm.as_str().into();
        told["error"] = json!(line.error);
        told["hash"] = json!(line.row.as_ref().ok().map(|row| &row.hash));
        told["not_trained"] = json!(line.row.as_ref().err());
        let baseline = controller(line, lines).map(|(name, e)| json!({ "flown_by": name, "evaluation": e }));
        told["baseline"] = json!(baseline);
        told
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
pub fn learnt(lines: &[Line]) -> Vec<Learnt<'_>> {
    fn of<'a>(line: &'a Line, lines: &[Line]) -> Option<Learnt<'a>> {
        let runs: Vec<&[LogLine]> = line.curves.iter().map(|curve| &curve[..]).collect();
        let controller = controller(line, lines).map(|(_, e)| e.success);
        (!runs.is_empty()).then_some(Learnt { task: line.entry.name, algorithm: &line.algorithm, runs, controller })
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
    fn a_unit_that_all_errors_share_stands_in_the_head() {
        let metric = |name: &str, unit: &str| Metric { name: name.into(), unit: unit.into() };
        let (metre, other) = (metric("position_error", "m"), metric("heading", "rad"));
        assert_eq!(unit([&metre, &metre].into_iter()), Some("m"));
        assert_eq!(unit([&metre, &other].into_iter()), None);
        assert_eq!(unit([].into_iter()), None);
    }
}
