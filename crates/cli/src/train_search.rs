//! `train --search`: which settings are best, by successive halving over seeds.

use super::arguments::Outputs;
use super::train_seeds::Asked;
use crate::prelude::*;
use omnidrones::internals;
use omnidrones::layers::{self, Layer};
use omnidrones::parallel::Threads;
use omnidrones::rl::TrainConfig;
use omnidrones::rl::search::{Search, SearchResult, Trial};
use omnidrones_plot::{Colour, Figure, Panel, Series};
use std::collections::BTreeMap;
use std::sync::Mutex;

/// Most candidates: each is trained with every seed.
const MOST: usize = 1000;

/// `KEY=VALUE,VALUE`, each as in a file.
pub fn axis(text: &str) -> std::result::Result<(String, Vec<toml::Value>), String> {
    let Some((key, values)) = text.split_once('=').filter(|(key, values)| !key.is_empty() && !values.is_empty()) else {
        return Err("expected KEY=VALUE,VALUE, as in apg.n_env=32,64".into());
    };
    let read = toml::from_str::<toml::Table>(&format!("values = [{values}]")).ok();
    let list = read.and_then(|mut table| table.remove("values")?.as_array().cloned());
    let words = || values.split(',').map(|word| toml::Value::String(word.trim().into())).collect();
    Ok((key.into(), list.unwrap_or_else(words)))
}

/// Names and layers of all combinations of the values, the last key turning fastest.
pub fn combinations(axes: &[(String, Vec<toml::Value>)]) -> Result<Vec<(String, Vec<Layer>)>> {
    let n = axes.iter().map(|(_, values)| values.len()).fold(1_usize, usize::saturating_mul);
    if n > MOST {
        return Err(Error::limit("candidates of --search", n, MOST, "Give fewer values."));
    }
    let mut all = vec![(Vec::new(), Vec::new())];
    for (key, values) in axes {
        let with = |(names, layers): &(Vec<String>, Vec<Layer>)| {
            let each = values.iter().map(|value| {
                let layer = Layer::of_table(&format!("--search {key}"), layers::at(key, value.clone()));
                let (name, mut names, mut layers) = (format!("{key}={value}"), names.clone(), layers.clone());
                names.push(name);
                layers.push(layer);
                (names, layers)
            });
            each.collect::<Vec<_>>()
        };
        all = all.iter().flat_map(with).collect();
    }
    Ok(all.into_iter().map(|(names, layers)| (names.join(" "), layers)).collect())
}

/// Searches; `named` are the candidates with what they change.
pub fn run(asked: &Asked<'_>, named: Vec<(String, TrainConfig)>, factor: usize, threads: &Threads) -> Result<Report> {
    let mut outputs = asked.output.open(&asked.usual, true)?;
    let folder = outputs.folder.clone();
    let known = folder.join("search.json");
    if !asked.resume {
        if known.symlink_metadata().is_ok() && !asked.output.force {
            let value = format!("'{}', which holds a search already", folder.display());
            let remedy = "Go on with it (--resume), replace it (--force), or name another folder (--out).";
            return Err(Error::value("folder of the search", value, "new", remedy));
        }
        if asked.output.force {
            remove(&folder, named.len(), &asked.seeds)?;
        }
    }
    let (names, configs): (Vec<String>, Vec<TrainConfig>) = named.into_iter().unzip();
    let candidates = configs.into_iter().enumerate().map(|(k, config)| (format!("c{k}"), config)).collect();
    let search = Search { candidates, seeds: asked.seeds.clone(), factor };
    let bar = progress::bar(total(&search), "searching", asked.output.json);
    let done = Mutex::new(BTreeMap::new());
    let told = search.run(&folder, threads, &|candidate, seed, progress| {
        let Ok(mut done) = done.lock() else { return };
        done.insert((candidate, seed), progress.done);
        bar.set_position(done.values().sum());
        progress::say(&bar, &format!("{} · seed {seed} · update {}", names[candidate], progress.done));
    });
    bar.finish_and_clear();
    let told = told?;
    let title = format!("{}: search by {}", asked.entry.name, asked.algorithm);
    outputs.draw("search", || figure(&told, &names, &title))?;
    let (_, config) = &search.candidates[told.winner];
    outputs.text("winner.toml", format!("# {}\n{}", names[told.winner], config.to_toml()?))?;
    outputs.written.push(known);
    let success = told.failures.is_empty();
    Ok(Report::told(
        asked.output.json,
        success,
        || value(&told, &names, asked),
        || page(&told, &names, &search, asked, &outputs),
    ))
}

/// Removes what a search of so many candidates keeps in its folder, be its own file there or not.
fn remove(folder: &Path, n: usize, seeds: &[u64]) -> Result<()> {
    let own = |k: usize| folder.join(format!("c{k}"));
    let all = || (0..n).flat_map(|k| seeds.iter().map(move |seed| own(k).join(format!("s{seed}"))));
    // what else bears such a name is no run, and training refuses it
    let runs = || all().filter(|run| run.join("checkpoints").is_dir());
    // all of them before the first is removed
    (0..n).try_for_each(|k| internals::own_folder(&own(k)))?;
    all().try_for_each(|run| internals::own_folder(&run))?;
    runs().try_for_each(|run| files::check_removable(&run))?;
    let known = folder.join("search.json");
    match std::fs::remove_file(&known) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(Error::file(&known, error)),
        _ => {}
    }
    runs().try_for_each(|run| files::remove_run(&run))
}

/// Updates of all runs, if the first candidates went on at every rung.
fn total(search: &Search) -> u64 {
    let mut alive = search.candidates.len();
    let (mut before, mut sum) = (0, 0);
    for rung in 0..search.rungs() {
        let until = search.updates(0, rung);
        sum += alive as u64 * search.seeds.len() as u64 * (until - before);
        (before, alive) = (until, alive.div_ceil(search.factor));
    }
    sum
}

/// Candidates, the best first: those that came further, then those that did better there.
fn ranked(told: &SearchResult) -> Vec<&Trial> {
    let mut last: BTreeMap<usize, &Trial> = BTreeMap::new();
    for trial in &told.trials {
        last.insert(trial.candidate, trial);
    }
    let mut all: Vec<&Trial> = last.into_values().collect();
    let key = |trial: &Trial| (trial.candidate == told.winner, trial.rung);
    all.sort_by(|a, b| key(b).cmp(&key(a)).then(b.compare(a)));
    all
}

/// What the numbers of the table are.
pub const KEY: &str =
    "Success, and the share of the reward's bound: means over seeds, after so many updates of a whole run.";

/// Candidates, the best first, with what they came to rung by rung.
pub fn table(told: &SearchResult, names: &[String]) -> Table {
    let of = |candidate: usize| told.trials.iter().filter(move |trial| trial.candidate == candidate);
    let updates = of(told.winner).map(|trial| format!("after {}", trial.updates));
    let mut table = Table::new("candidate").with(Align::Right, updates);
    for last in ranked(told) {
        let cells = of(last.candidate).map(|trial| {
            let [success, bound] = trial.mean();
            format!("{} ({} of bound)", percent(success), percent(bound))
        });
        table.row([names[last.candidate].clone()].into_iter().chain(cells));
    }
    table
}

fn page(told: &SearchResult, names: &[String], search: &Search, asked: &Asked<'_>, outputs: &Outputs) -> Page {
    let mut page = Page::new();
    let (n, seeds) = (counted(names.len(), "candidate"), counted(asked.seeds.len(), "seed"));
    page.title(asked.entry.name, &format!("{}, {n}, {seeds}, one in {} goes on", asked.algorithm, search.factor));
    page.table(table(told, names));
    page.line(format!("\n{KEY}"));
    let failed = told.failures.iter();
    page.lines("Failed", failed.map(|(candidate, seed, why)| format!("{}, seed {seed}: {why}", names[*candidate])));
    page.written(&outputs.written);
    page.heading("Next");
    let file = outputs.folder.join("winner.toml");
    page.line(format!(
        "  omnidrones train {} --config {}   the best again, with any seed",
        asked.entry.name,
        file.display()
    ));
    page
}

/// Between candidates that came to the same, as a share of the updates of the whole run.
const APART: f64 = 0.012;

/// Updates and success [%] of the candidates, the best first. Of those that came to the same each stands a little right of the one
/// before: none hides another.
fn beside_each_other(told: &SearchResult) -> Vec<Vec<(f64, f64)>> {
    let whole = told.trials.iter().map(|trial| trial.updates).max().unwrap_or(0) as f64;
    let mut taken: Vec<(u64, f64)> = Vec::new();
    let mut place = |trial: &Trial| {
        let success = 100.0 * trial.mean()[0];
        let met = taken.iter().filter(|(at, other)| *at == trial.updates && (other - success).abs() < 1.0).count();
        taken.push((trial.updates, success));
        (trial.updates as f64 + APART * whole * met as f64, success)
    };
    let rungs = |candidate: usize| told.trials.iter().filter(move |trial| trial.candidate == candidate);
    ranked(told).into_iter().map(|last| rungs(last.candidate).map(&mut place).collect()).collect()
}

/// Success of the candidates over updates.
pub fn figure(told: &SearchResult, names: &[String], title: &str) -> Figure {
    let panel = Panel::new("Success of the candidates, rung by rung", "updates", "success [%]").y_range(-2.0, 104.0);
    let panel = panel.x_range(0.0, told.trials.iter().map(|trial| trial.updates).max().unwrap_or(1) as f64 * 1.05);
    let series = ranked(told).into_iter().zip(beside_each_other(told)).map(|(last, points)| {
        let best = last.candidate == told.winner;
        let (name, colour, width) =
            if best { (names[told.winner].as_str(), Colour::BLUE, 1.8) } else { ("", Colour::SKY, 0.8) };
        Series::line(name, points).colour(colour).width(width).markers()
    });
    let panel = series.rev().fold(panel, Panel::series);
    let figure = Figure::new(title).subtitle("mean over seeds   ·   thick: the best").size(700.0, 420.0);
    figure.grid(&[1.0], &[1.0]).place((0, 0), (1, 1), panel)
}

fn value(told: &SearchResult, names: &[String], asked: &Asked<'_>) -> Value {
    let failures: Vec<Value> = told
        .failures
        .iter()
        .map(|(candidate, seed, why)| json!({ "candidate": candidate, "seed": seed, "why": why }))
        .collect();
    json!({
        "command": "train",
        "task": asked.entry.name,
        "algorithm": asked.algorithm,
        "candidates": names,
        "seeds": asked.seeds,
        "trials": told.trials,
        "winner": told.winner,
        "failed": failures,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use omnidrones::rl::search::Score;

    #[test]
    fn values_are_read_as_in_a_file_and_combined() {
        let axes =
            [axis("apg.learning_rate.from=0.002,0.005"), axis("apg.network.hidden=[32,32],[64]"), axis("control=rate")];
        let all = combinations(&axes.map(|axis| axis.unwrap())).unwrap();
        assert_eq!(all.len(), 4);
        assert_eq!(all[1].0, "apg.learning_rate.from=0.002 apg.network.hidden=[64] control=\"rate\"");
        assert_eq!(all[3].1[0].table()["apg"]["learning_rate"]["from"].as_float(), Some(0.005));
        assert!(axis("apg.n_env").is_err() && axis("=3").is_err() && axis("a=").is_err());
    }

    #[test]
    fn candidates_that_come_to_the_same_stand_beside_each_other_and_others_where_they_are() {
        for same in [1, 2, 5] {
            let score = |success: f64| vec![Some(Score { success, share_of_bound: 0.5 })];
            let trial =
                |candidate: usize, success: f64| Trial { candidate, rung: 0, updates: 60, scores: score(success) };
            let mut trials: Vec<Trial> = (0..same).map(|candidate| trial(candidate, 0.25)).collect();
            trials.push(trial(same, 0.75));
            let told = SearchResult { trials, winner: same, failures: Vec::new() };
            let points = beside_each_other(&told).concat();
            assert_eq!(points[0], (60.0, 75.0));
            for (i, a) in points.iter().enumerate() {
                assert!(points[..i].iter().all(|b| a != b) && a.0 < 1.06 * 60.0, "{points:?}");
            }
        }
    }
}
