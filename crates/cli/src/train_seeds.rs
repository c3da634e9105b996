//! `train --seeds`: several seeds side by side in one process, and what they say together.

use super::arguments::OutputArguments;
use super::baseline::{FIGURES, spec};
use super::over_seeds::{Failure, Outcome, split, spread, value};
use super::train_all_plot::{self, Learnt};
use crate::prelude::*;
use omnidrones::internals;
use omnidrones::parallel::Threads;
use omnidrones::rl::TrainConfig;
use omnidrones::rl::runs::{self, Run, SeedSummary};
use omnidrones::rl::trainer::TrainResult;
use omnidrones::tasks::Metric;
use omnidrones::tasks::registry::TaskEntry;
use std::sync::Mutex;

/// What is asked for.
pub struct Asked<'a> {
    pub entry: &'a TaskEntry,
    pub algorithm: &'a str,
    pub config: &'a TrainConfig,
    /// Those with which the run of a seed in a folder begins or goes on.
    pub settings: &'a dyn Fn(&Path, u64) -> Result<TrainConfig>,
    pub seeds: Vec<u64>,
    /// The folder unless another one was named.
    pub usual: PathBuf,
    pub resume: bool,
    pub output: &'a OutputArguments,
}

/// Trains them.
pub fn run(asked: &Asked<'_>, threads: &Threads) -> Result<Report> {
    let mut outputs = asked.output.open(&asked.usual, true)?;
    let root = outputs.folder.clone();
    let own = |seed: &u64| root.join(format!("s{seed}"));
    if asked.output.force && !asked.resume {
        // all of them before the first is removed
        for folder in asked.seeds.iter().map(own) {
            internals::own_folder(&folder)?;
            files::check_removable(&folder)?;
        }
    }
    for folder in asked.seeds.iter().map(own) {
        begin(&folder, asked.resume, asked.output.force)?;
    }
    let run = |seed: &u64| {
        let folder = own(seed);
        Ok(Run { config: (asked.settings)(&folder, *seed)?, folder, until: u64::MAX })
    };
    let all = asked.seeds.iter().map(run).collect::<Result<Vec<Run>>>()?;
    let bar = progress::bar(all.iter().map(|run| run.config.updates()).sum(), "training", asked.output.json);
    let told = train(&all, threads, &bar);
    bar.finish_and_clear();
    let (done, failed) = split(&asked.seeds, &told);
    // what earlier calls came to stays
    if done.is_empty() && asked.resume && root.join("seeds.json").exists() {
        let first = told.into_iter().find_map(Result::err);
        return Err(first.unwrap_or_else(|| Error::value("seeds", 0, "≥ 1", "Give --seeds 5.")));
    }
    outputs.written.extend(asked.seeds.iter().map(own));
    let runs = told.iter().flatten().map(|result| &result.curve[..]).collect();
    let learnt = Learnt { task: asked.entry.name, algorithm: asked.algorithm, runs, controller: None };
    outputs.draw("curve", || train_all_plot::figure(&[learnt]))?;
    let mut json = value(&done, &failed);
    json["command"] = "train".into();
    json["task"] = asked.entry.name.into();
    json["algorithm"] = asked.algorithm.into();
    outputs.text("seeds.json", format!("{json:#}\n"))?;
    let success = failed.is_empty();
    if asked.output.json {
        return Ok(Report::json(&json, success));
    }
    let (_, error) = spec(asked.entry, asked.config)?;
    Ok(Report::page(&page(asked, &error, &done, &failed, &outputs.written), success))
}

/// Refuses a run that is there, unless it is to go on or to be replaced.
pub fn begin(folder: &Path, resume: bool, force: bool) -> Result<()> {
    internals::own_folder(folder)?;
    if !folder.join("config.toml").exists() || resume {
        return Ok(());
    }
    if force {
        return files::remove_run(folder);
    }
    let remedy = "Go on with it (--resume), replace it (--force), or name another folder (--out).";
    let value = format!("'{}', which holds a run already", folder.display());
    Err(Error::value("folder of the run", value, "new", remedy))
}

/// Trains under one bar: updates of all, and of each how far it is.
pub fn train(all: &[Run], threads: &Threads, bar: &indicatif::ProgressBar) -> Vec<Result<TrainResult>> {
    let done = Mutex::new(vec![(0, None::<f64>); all.len()]);
    runs::train(all, threads, &|k, progress| {
        let Ok(mut done) = done.lock() else { return };
        done[k] = (progress.done, progress.evaluation.map(|e| e.success));
        bar.set_position(done.iter().map(|(updates, _)| updates).sum());
        let each = done.iter().map(|(_, success)| success.map_or("…".into(), percent));
        progress::say(bar, &format!("success {}", each.collect::<Vec<_>>().join(" ")));
    })
}

fn page(asked: &Asked<'_>, error: &Metric, done: &[Outcome], failed: &[Failure], written: &[PathBuf]) -> Page {
    let mut page = Page::new();
    let updates = asked.config.updates();
    let seeds = counted(asked.seeds.len(), "seed");
    page.title(asked.entry.name, &format!("{}, {seeds}, {updates} updates", asked.algorithm));
    page.table(table(error, done));
    page.line("\n± 95 %: half the width of the confidence interval of the mean over seeds, by Student's t.");
    page.lines("Failed", failed.iter().map(|Failure { seed, why }| format!("seed {seed}: {why}")));
    page.written(written);
    page
}

/// A row per seed, then mean, interval, least and largest.
pub fn table(error: &Metric, done: &[Outcome]) -> Table {
    let (last, mean) = (format!("final error [{}]", error.unit), format!("mean error [{}]", error.unit));
    let mut table = Table::new(&format!(
        "seed | >success | >crashed | >{last} | >{mean} | >Δ command | >return | >share of bound | >time | >env steps"
    ));
    for run in done {
        let figures = FIGURES.map(|(of, show, _)| show(of(&run.evaluation)));
        let cost = [duration(run.seconds), count(run.env_steps as f64)];
        table.row([run.seed.to_string()].into_iter().chain(figures).chain(cost));
    }
    let all = FIGURES.map(|(of, show, scale)| (spread(done, |run| of(&run.evaluation)), show, scale));
    let mut row = |name: &str, text: &dyn Fn(SeedSummary, fn(f64) -> String, f64) -> String| {
        let cell = |(spread, show, scale): &(Option<SeedSummary>, fn(f64) -> String, f64)| {
            spread.map_or("–".into(), |spread| text(spread, *show, *scale))
        };
        table.row([name.to_string()].into_iter().chain(all.iter().map(cell)));
    };
    row("mean", &|spread, show, _| show(spread.mean));
    row("± 95 %", &|spread, _, scale| spread.half_width.map_or("–".into(), |half| short(scale * half, 2)));
    row("least", &|spread, show, _| show(spread.least));
    row("largest", &|spread, show, _| show(spread.largest));
    table
}
