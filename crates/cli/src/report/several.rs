//! Folders of several runs: seeds, a search over settings, every task.

use super::runs::{self, BESIDE, Told, differing, dotted};
use super::{Kind, Telling};
use crate::baseline::{results, spec};
use crate::over_seeds::{Failure, Outcome};
use crate::prelude::*;
use crate::train_all_plot::{self, Learnt};
use crate::{train_all, train_search, train_seeds};
use omnidrones::rl::TrainConfig;
use omnidrones::rl::log::{self, Line};
use omnidrones::rl::search::{SearchResult, Trial};
use omnidrones::tasks::registry;
use serde::Deserialize;
use std::collections::BTreeMap;

/// Largest file that is read, bytes.
const MAX_JSON: u64 = 64 << 20;

/// Whether a folder holds rows of 'train-all'.
pub fn has_rows(folder: &Path) -> bool {
    !train_all::read(folder, &|_| None).is_empty()
}

/// The chapter of a folder.
pub(super) fn tell(page: &mut Page, folder: &Path, kind: &Kind, telling: &Telling) -> Result<()> {
    match kind {
        Kind::Run => {
            page.heading(&folder.display().to_string());
            runs::tell(page, &[Told::of(folder, telling)?])
        }
        Kind::Seeds => seeds(page, folder, telling),
        Kind::Search => search(page, folder, telling),
        Kind::All => all(page, folder, telling),
    }
}

/// What a file of a folder says.
fn read<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_str(&files::read_text(path, MAX_JSON)?).map_err(|error| Error::Format {
        file: path.display().to_string(),
        place: format!("line {}", error.line()),
        rule: format!("{error}"),
        remedy: "It is written by 'omnidrones train': make it anew.".into(),
    })
}

/// What `train --seeds` keeps of its runs.
#[derive(Deserialize)]
struct Seeds {
    task: String,
    algorithm: String,
    runs: Vec<Outcome>,
    failed: Vec<Failure>,
}

fn seeds(page: &mut Page, folder: &Path, telling: &Telling) -> Result<()> {
    let told: Seeds = read(&folder.join("seeds.json"))?;
    let entry = registry::by_name(&told.task)?;
    let own = |seed: u64| folder.join(format!("s{seed}"));
    page.heading(&format!("{}: {}, {} seeds", told.task, told.algorithm, told.runs.len()));
    let Some(first) = told.runs.first() else {
        page.line("No seed was trained.");
        return Ok(());
    };
    let one = Told::of(&own(first.seed), telling)?;
    let (_, error) = spec(entry, one.config())?;
    page.table(train_seeds::table(&error, &told.runs));
    page.line("± 95 %: half the width of the confidence interval of the mean over seeds, by Student's t.");
    for Failure { seed, why } in &told.failed {
        page.line(format!("Seed {seed} failed: {why}"));
    }
    if let Some(controller) = one.baseline() {
        page.subheading("Our controller from the same starts").table(results(&error.unit, [controller]));
    }
    let curves: Vec<Vec<Line>> = told.runs.iter().filter_map(|run| log::read(own(run.seed)).ok()).collect();
    let learnt = Learnt {
        task: entry.name,
        algorithm: &told.algorithm,
        runs: curves.iter().map(|curve| &curve[..]).collect(),
        controller: one.baseline().map(|(_, e)| e.success),
    };
    page.figure(train_all_plot::figure(&[learnt]).svg()?);
    runs::replay(page, std::slice::from_ref(&one));
    runs::settings(page, std::slice::from_ref(&one))
}

/// What a search keeps.
#[derive(Deserialize)]
struct Known {
    candidates: BTreeMap<String, String>,
    seeds: Vec<u64>,
    trials: Vec<Trial>,
    #[serde(default)]
    failures: Vec<(usize, u64, String)>,
}

fn search(page: &mut Page, folder: &Path, telling: &Telling) -> Result<()> {
    let known: Known = read(&folder.join("search.json"))?;
    let name = |k: usize| format!("c{k}");
    let configs: Vec<TrainConfig> = (0..known.candidates.len())
        .filter_map(|k| Some((k, known.candidates.get(&name(k))?)))
        .map(|(k, text)| TrainConfig::from_toml(text, &name(k)))
        .collect::<Result<_>>()?;
    let names = named(&configs)?;
    let key = |trial: &&Trial| (trial.rung, trial.mean());
    let best = known.trials.iter().max_by(|a, b| {
        let ((i, x), (j, y)) = (key(a), key(b));
        i.cmp(&j).then(x[0].total_cmp(&y[0])).then(x[1].total_cmp(&y[1])).then(b.candidate.cmp(&a.candidate))
    });
    page.heading(&format!("A search over {} candidates, {} seeds", names.len(), known.seeds.len()));
    let Some(best) = best.map(|trial| trial.candidate) else {
        page.line("No rung of it is over.");
        return Ok(());
    };
    let told = SearchResult { winner: best, trials: known.trials, failures: known.failures };
    page.table(train_search::table(&told, &names)).line(train_search::KEY);
    for (candidate, seed, why) in &told.failures {
        page.line(format!("{}, seed {seed}, failed: {why}", names[*candidate]));
    }
    page.figure(train_search::figure(&told, &names, "Search").svg()?);
    let runs = known.seeds.iter().map(|seed| folder.join(name(best)).join(format!("s{seed}")));
    if let Some(run) = runs.into_iter().find(|run| run.join("checkpoints").is_dir()) {
        page.heading(&format!("The best: {}", names[best]));
        runs::tell(page, &[Told::of(&run, telling)?])?;
    }
    Ok(())
}

/// Candidates by the settings in which they differ.
fn named(configs: &[TrainConfig]) -> Result<Vec<String>> {
    let columns: Vec<(String, BTreeMap<String, String>)> =
        configs.iter().map(|config| Ok((String::new(), dotted(config)?))).collect::<Result<_>>()?;
    let table = differing(&columns);
    let name = |k: usize| {
        let own = table.rows().iter().map(|row| format!("{}={}", row[0], row[k + 1]));
        own.collect::<Vec<_>>().join(" ")
    };
    Ok((0..configs.len()).map(name).collect())
}

fn all(page: &mut Page, folder: &Path, telling: &Telling) -> Result<()> {
    let fly =
        |entry: &'static registry::Entry| telling.baseline(entry, &TrainConfig::for_task(entry.name, None, None).ok()?);
    let lines = train_all::read(folder, &fly);
    page.heading("Tasks").table(train_all::table(&lines)).line(train_all::key(&lines));
    page.line(
        "Mean over seeds, ± half the width of its 95 % confidence interval (least–largest); indented: our controller.",
    );
    let learnt = train_all::learnt(&lines);
    if !learnt.is_empty() {
        page.heading("Learning curves").figure(train_all_plot::figure(&learnt).svg()?);
    }
    let mut origins = Table::new("task | algorithm | seeds | commit | hash of settings, task and physics");
    let mut here: Vec<PathBuf> = Vec::new();
    for (cells, runs) in lines.iter().filter_map(|line| line.origin(folder)) {
        origins.row(cells);
        here.extend(runs.into_iter().next());
    }
    if telling.replays && !here.is_empty() {
        let plain = Telling { baselines: false, threads: telling.threads.clone(), ..*telling };
        let flown = here.iter().take(BESIDE).map(|run| Told::of(run, &plain)).collect::<Result<Vec<_>>>()?;
        runs::replay(page, &flown);
        if here.len() > BESIDE {
            page.line(format!("The first {BESIDE} of {} tasks whose runs are here.", here.len()));
        }
    }
    page.heading("Where the rows come from").table(origins);
    Ok(())
}
