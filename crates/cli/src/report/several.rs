//! Folders of several runs: seeds, a search over settings, every task.

use super::runs::{self, BESIDE, Told, differing, dotted};
use super::{Kind, Telling};
use crate::baseline::{results, spec};
use crate::over_seeds::{self, Failure, Outcome, best};
use crate::prelude::*;
use crate::train_all_plot::{self, Learnt};
use crate::{train_all, train_search, train_seeds};
use omnidrones::internals;
use omnidrones::rl::TrainConfig;
use omnidrones::rl::log::{self, Line};
use omnidrones::rl::search::SearchResult;
use omnidrones::tasks::registry;
use serde::Deserialize;
use std::collections::BTreeMap;

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

const REMEDY: &str = "It is written by 'omnidrones train': make it anew.";

/// What a file of a folder says.
fn read<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    internals::of_json(files::read_text(path, over_seeds::MAX_JSON)?.as_bytes(), &path.display().to_string(), REMEDY)
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
    let path = folder.join("seeds.json");
    let told: Seeds = read(&path)?;
    if let Some(rule) = over_seeds::fault(&told.runs) {
        return Err(Error::Format {
            file: path.display().to_string(),
            place: "runs".into(),
            rule,
            remedy: REMEDY.into(),
        });
    }
    let entry = registry::by_name(&told.task)?;
    let own = |seed: u64| folder.join(format!("s{seed}"));
    page.heading(&format!("{}: {}, {}", told.task, told.algorithm, counted(told.runs.len(), "seed")));
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

fn search(page: &mut Page, folder: &Path, telling: &Telling) -> Result<()> {
    let (search, trials, failures) = internals::read_search(folder)?;
    let configs: Vec<TrainConfig> = search.candidates.iter().map(|(_, config)| config.clone()).collect();
    let names = named(&configs)?;
    let best = best(&trials);
    let (candidates, seeds) = (counted(names.len(), "candidate"), counted(search.seeds.len(), "seed"));
    page.heading(&format!("A search over {candidates}, {seeds}"));
    let Some(best) = best else {
        page.line(if trials.is_empty() { "No rung of it is over." } else { "No candidate could be trained." });
        page.lines("Failed", failed(&failures, &names));
        return Ok(());
    };
    let told = SearchResult { winner: best, trials, failures };
    page.table(train_search::table(&told, &names)).line(train_search::KEY);
    page.lines("Failed", failed(&told.failures, &names));
    page.figure(train_search::figure(&told, &names, "Search").svg()?);
    let own = folder.join(&search.candidates[best].0);
    let runs = search.seeds.iter().map(|seed| own.join(format!("s{seed}")));
    if let Some(run) = runs.into_iter().find(|run| run.join("checkpoints").is_dir()) {
        page.heading(&format!("The best: {}", names[best]));
        runs::tell(page, &[Told::of(&run, telling)?])?;
    }
    Ok(())
}

/// Runs of a search that failed, and why.
fn failed<'a>(failures: &'a [(usize, u64, String)], names: &'a [String]) -> impl Iterator<Item = String> + 'a {
    failures.iter().map(|(candidate, seed, why)| format!("{}, seed {seed}: {why}", names[*candidate]))
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
    let fly = |entry: &'static registry::TaskEntry| {
        telling.baseline(entry, &TrainConfig::for_task(entry.name, None, None).ok()?)
    };
    let (lines, unread) = train_all::read(folder, &fly);
    for why in &unread {
        eprintln!("warning: {}", shown(why));
    }
    page.heading("Tasks").table(train_all::table(&lines)).line(train_all::key(&lines));
    page.line(
        "Mean over seeds, ± half the width of its 95 % confidence interval (least–largest); indented: our controller.",
    );
    page.lines("Could not be read", unread);
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
