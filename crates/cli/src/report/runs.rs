//! Single runs: one, or several side by side.

use super::Telling;
use crate::baseline::{results, spec};
use crate::environment::EnvArguments;
use crate::episodes::{Flown, SHOWN, Seen, success};
use crate::eval::Ready;
use crate::prelude::*;
use crate::rollout_files;
use crate::train_plot::{self, Curves};
use omnidrones::rl::TrainConfig;
use omnidrones::rl::checkpoint::Manifest;
use omnidrones::rl::log::{self, Line};
use omnidrones::tasks::registry::{self, TaskEntry};
use omnidrones::tasks::{Evaluation, Metric, Spec};
use omnidrones_viewer::Recording;
use std::collections::{BTreeMap, BTreeSet};

/// Most flights beside each other under one clock.
pub const BESIDE: usize = 4;

/// A run whose policy has flown.
pub struct Told {
    folder: PathBuf,
    entry: &'static TaskEntry,
    name: String,
    manifest: Manifest,
    config: TrainConfig,
    lines: Vec<Line>,
    spec: Spec,
    error: Metric,
    flown: Flown,
    baseline: Option<(String, Evaluation)>,
    recording: Option<Recording>,
}

impl Told {
    /// Flies the newest policy of a run from the starts of its evaluations.
    pub fn of(folder: &Path, telling: &Telling) -> Result<Self> {
        let mut ready = Ready::new(folder, &EnvArguments::default(), None, &telling.threads)?;
        let entry = registry::by_name(&ready.saved.manifest.task)?;
        let (manifest, config) = (ready.saved.manifest.clone(), ready.saved.config.clone());
        let (spec, error) = spec(entry, &config)?;
        let mut seen = Seen::new(if telling.replays { SHOWN } else { 0 });
        let flown = ready.fly(0, &mut |watched| seen.see(watched))?;
        Ok(Self {
            baseline: telling.baseline(entry, &config),
            recording: telling.replays.then(|| seen.recording(&flown)).transpose()?,
            // a checkpoint that was carried elsewhere has no log beside it
            lines: log::read(folder).unwrap_or_default(),
            folder: folder.into(),
            entry,
            name: format!("{} {} s{}", entry.name, manifest.algorithm, manifest.seed),
            manifest,
            config,
            spec,
            error,
            flown,
        })
    }

    /// How it was trained.
    pub fn config(&self) -> &TrainConfig {
        &self.config
    }

    /// Our controller from the same starts.
    pub fn baseline(&self) -> Option<&(String, Evaluation)> {
        self.baseline.as_ref()
    }

    /// `Hover apg s0`, or its folder where another run is called so.
    fn name(&self) -> String {
        self.name.clone()
    }

    /// Its settings by their dotted names.
    fn settings(&self) -> Result<BTreeMap<String, String>> {
        dotted(&self.config)
    }

    fn facts(&self) -> Vec<Fact> {
        let Manifest { update, env_steps, seconds, version, instructions, .. } = &self.manifest;
        let policy = &self.config;
        vec![
            Fact::new("task", self.entry.name).note(self.entry.description),
            Fact::new("algorithm", policy.algorithm.name()).note(format!("{update} updates of {}", policy.updates())),
            Fact::new("trained in", duration(*seconds)).note("without evaluations"),
            Fact::new("environment steps", count(*env_steps as f64))
                .note(format!("{} per second", count(*env_steps as f64 / seconds.max(1e-9)))),
            Fact::new("episodes", format!("{} steps of {} s", self.spec.horizon, short(self.spec.dt, 4))),
            Fact::new("made by", format!("omnidrones {version}")).note(format!("instructions {instructions}")),
            Fact::new("folder", self.folder.display().to_string()),
        ]
    }

    fn curves(&self) -> Curves<'_> {
        Curves {
            title: format!("{}: {}, seed {}", self.entry.name, self.manifest.algorithm, self.manifest.seed),
            subtitle: self.flown.headline(),
            lines: &self.lines,
            loss: self.config.algorithm.loss(),
            bound: self.spec.reward_bound * self.spec.horizon as f64,
            error: &self.error,
            baseline: self.baseline.as_ref(),
        }
    }
}

/// Names runs that are called alike by their folders.
pub fn tell_apart(runs: &mut [Told]) {
    let names: Vec<String> = runs.iter().map(Told::name).collect();
    for run in runs.iter_mut().filter(|run| names.iter().filter(|name| **name == run.name).count() > 1) {
        run.name = run.folder.display().to_string();
    }
}

/// What the page is called.
pub fn title(runs: &[Told]) -> String {
    runs.iter().map(Told::name).collect::<Vec<_>>().join(" beside ")
}

/// The page of one run or of several.
pub fn tell(page: &mut Page, runs: &[Told]) -> Result<()> {
    if let [one] = runs {
        page.heading("Run").facts(one.facts());
    } else {
        page.heading("Runs");
        for run in runs {
            page.subheading(&run.name()).facts(run.facts());
        }
    }
    page.heading("Held-out starts");
    flown_by(page, runs);
    if runs.iter().any(|run| !run.lines.is_empty()) {
        page.heading("Learning curves").figure(learning(runs).svg()?);
    }
    replay(page, runs);
    page.heading("In flight");
    for run in runs {
        page.figure(rollout_files::figure(&run.flown).svg()?);
    }
    settings(page, runs)
}

/// A table of policies and controllers; of several tasks one each.
fn flown_by(page: &mut Page, runs: &[Told]) {
    let tasks: BTreeSet<&str> = runs.iter().map(|run| run.entry.name).collect();
    for task in tasks {
        let own = || runs.iter().filter(|run| run.entry.name == task);
        let named = |run: &Told| {
            let name = if runs.len() == 1 { "policy".into() } else { run.name() };
            (format!("{name} (update {})", run.manifest.update), run.flown.evaluation.clone())
        };
        let mut rows: Vec<(String, Evaluation)> = own().map(named).collect();
        // one line for controllers that did the same in the same starts
        for baseline in own().filter_map(|run| run.baseline.clone()) {
            if !rows.contains(&baseline) {
                rows.push(baseline);
            }
        }
        let Some(first) = own().next() else { continue };
        if runs.len() > 1 {
            page.subheading(task);
        }
        let error = first.error.name.replace('_', " ");
        page.table(results(&first.error.unit, &rows)).line(success(&first.spec));
        page.line(format!("Error: {error}; final: in the last step, also of who crashed."));
    }
}

/// Curves of one run in all their panels, of several in the same ones.
fn learning(runs: &[Told]) -> omnidrones_plot::Figure {
    if let [one] = runs {
        return train_plot::figure(&one.curves());
    }
    let errors: BTreeSet<String> =
        runs.iter().map(|run| format!("{} [{}]", run.error.name.replace('_', " "), run.error.unit)).collect();
    let label = if errors.len() == 1 { errors.into_iter().next() } else { None };
    let named: Vec<(String, &[Line])> = runs.iter().map(|run| (run.name(), &run.lines[..])).collect();
    train_plot::beside("Learning curves", &named, label.as_deref().unwrap_or("error of the task"))
}

/// The first flights beside each other.
pub fn replay(page: &mut Page, runs: &[Told]) {
    let flights: Vec<Recording> = runs.iter().take(BESIDE).filter_map(|run| run.recording.clone()).collect();
    if flights.is_empty() {
        return;
    }
    page.heading("Replay").within("the policy in flight", omnidrones_viewer::page(&title(runs), &flights));
    page.line("The first four episodes. Drag to turn, wheel to come nearer; space plays, 1 2 3 choose the camera.");
    if runs.len() > BESIDE {
        page.line(format!("The first {BESIDE} of {} runs are shown.", runs.len()));
    }
}

/// Settings that differ: from those that the task has with this algorithm, or between runs; and all of each.
pub fn settings(page: &mut Page, runs: &[Told]) -> Result<()> {
    let mut columns: Vec<(String, BTreeMap<String, String>)> =
        runs.iter().map(|run| Ok((run.name(), run.settings()?))).collect::<Result<_>>()?;
    if let [one] = runs {
        columns[0].0 = "this run".into();
        let usual = TrainConfig::for_task(one.entry.name, Some(one.config.algorithm.name()), None)?;
        columns.push(("the task's recipe".into(), dotted(&usual)?));
    }
    page.heading("Settings");
    let table = differing(&columns);
    if table.is_empty() {
        page.line(if runs.len() == 1 { "Those of the task's recipe." } else { "The same in all." });
    } else {
        page.line("Those that differ:").table(table);
    }
    for run in runs {
        page.folded(&format!("all settings of {}", run.name()), &run.config.to_toml()?);
    }
    Ok(())
}

/// All settings by their dotted names.
pub fn dotted(config: &TrainConfig) -> Result<BTreeMap<String, String>> {
    fn walk(prefix: &str, value: &toml::Value, to: &mut BTreeMap<String, String>) {
        match value {
            toml::Value::Table(table) => {
                let dot = if prefix.is_empty() { "" } else { "." };
                table.iter().for_each(|(key, value)| walk(&format!("{prefix}{dot}{key}"), value, to));
            }
            value => {
                to.insert(prefix.into(), value.to_string());
            }
        }
    }
    let table: toml::Table = toml::from_str(&config.to_toml()?).unwrap_or_default();
    let mut all = BTreeMap::new();
    walk("", &table.into(), &mut all);
    Ok(all)
}

/// A row for every setting that is not the same in all columns.
pub fn differing(columns: &[(String, BTreeMap<String, String>)]) -> Table {
    let mut table = Table::new("setting").with(Align::Left, columns.iter().map(|(name, _)| name));
    let keys: BTreeSet<&String> = columns.iter().flat_map(|(_, settings)| settings.keys()).collect();
    for key in keys {
        let values: Vec<String> =
            columns.iter().map(|(_, settings)| settings.get(key).cloned().unwrap_or("–".into())).collect();
        if values.iter().any(|value| *value != values[0]) {
            table.row([key.clone()].into_iter().chain(values));
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_differ_are_told_by_their_dotted_names_and_no_others() {
        let of = |text: &str| {
            let config = TrainConfig::for_task("Hover", Some("apg"), Some((text, "own"))).unwrap();
            (text.to_string(), dotted(&config).unwrap())
        };
        let (usual, other) = (of(""), of("seed = 3\napg.horizon = 7"));
        let table = differing(&[usual.clone(), other]);
        let rows: Vec<&[String]> = table.rows().iter().map(|row| &row[..]).collect();
        assert_eq!(rows.len(), 2, "{rows:?}");
        assert!(rows.iter().any(|row| row[0] == "apg.horizon" && row[2] == "7"), "{rows:?}");
        assert!(rows.iter().any(|row| row[0] == "seed" && row[1] == "0" && row[2] == "3"), "{rows:?}");
        assert!(differing(&[usual.clone(), usual]).is_empty());
    }
}
