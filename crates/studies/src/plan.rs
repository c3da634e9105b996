//! What a study compares, as data: rows of tasks by algorithms, and statements that they bear on.

use omnidrones::error::{Error, Result};
use omnidrones::layers::Layer;
use omnidrones::rl::TrainConfig;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

/// Studies by name.
const STUDIES: [(&str, &str); 1] = [("paper", include_str!("paper.toml"))];

/// All of them.
pub fn names() -> [&'static str; 1] {
    STUDIES.map(|(name, _)| name)
}

/// A study.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    pub title: String,
    pub seeds: u64,
    /// Share of our controller's return with which a task counts as flown.
    pub flies: f64,
    #[serde(rename = "part")]
    pub parts: Vec<Part>,
    #[serde(rename = "claim")]
    pub claims: Vec<Claim>,
}

/// Tasks, each by every entry.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Part {
    pub name: String,
    tasks: Vec<String>,
    entries: Vec<Entry>,
    /// Of all rows.
    #[serde(default)]
    settings: String,
    /// Of the rows of a task.
    #[serde(default)]
    of: BTreeMap<String, String>,
}

/// How tasks are learnt.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    algorithm: String,
    #[serde(default)]
    setting: String,
    #[serde(default)]
    settings: String,
}

/// A statement about some algorithms, and what speaks for reading it anew.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Claim {
    pub says: String,
    pub parts: Vec<String>,
    pub algorithms: Vec<String>,
    /// Whether it says that they fly their tasks, or that they fail to.
    pub flies: bool,
    #[serde(default)]
    pub why: String,
}

/// A row to be trained.
pub struct Cell {
    /// Name of its part.
    pub part: String,
    pub algorithm: String,
    /// What sets it apart from others of its task and algorithm.
    pub setting: String,
    pub config: TrainConfig,
}

/// An algorithm with what sets a row of it apart.
pub fn label(algorithm: &str, setting: &str) -> String {
    if setting.is_empty() { algorithm.into() } else { format!("{algorithm}, {setting}") }
}

/// With so many times the updates, one at least.
pub fn budgeted(config: TrainConfig, factor: f64) -> TrainConfig {
    let updates = (config.updates() as f64 * factor).ceil().max(1.0) as u64;
    config.with_updates(updates)
}

impl Cell {
    /// `dqn, joint`.
    pub fn label(&self) -> String {
        label(&self.algorithm, &self.setting)
    }
}

impl Plan {
    /// The study of that name.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest.
    pub fn by_name(name: &str) -> Result<Self> {
        let known = STUDIES.iter().find(|(own, _)| *own == name);
        let (name, text) = known.ok_or_else(|| Error::Unknown {
            kind: "study",
            name: name.into(),
            known: names().map(String::from).to_vec(),
        })?;
        omnidrones::internals::of_toml(text, name)
    }

    /// Its rows of these tasks and algorithms (of all for none), with a factor on their updates.
    ///
    /// # Errors
    /// [`Error::Unknown`] for names that the study does not have, [`Error::Value`] for some that no row has together, and as
    /// [`TrainConfig::layered`].
    pub fn cells(&self, tasks: &[String], algorithms: &[String], budget: f64) -> Result<Vec<Cell>> {
        let entries = self.parts.iter().flat_map(|part| &part.entries);
        check("task of the study", tasks, self.parts.iter().flat_map(|part| &part.tasks))?;
        check("algorithm of the study", algorithms, entries.map(|entry| &entry.algorithm))?;
        let asked = |names: &[String], name: &String| names.is_empty() || names.iter().any(|own| same(own, name));
        let mut cells = Vec::new();
        for part in &self.parts {
            for task in part.tasks.iter().filter(|task| asked(tasks, task)) {
                for entry in part.entries.iter().filter(|entry| asked(algorithms, &entry.algorithm)) {
                    cells.push(part.cell(task, entry, budget)?);
                }
            }
        }
        if cells.is_empty() {
            let value = format!("{} by {}", tasks.join(","), algorithms.join(","));
            let remedy = "Leave --tasks or --algos out to see what there is.";
            return Err(Error::value("rows of the study", value, "a task and an algorithm of the same part", remedy));
        }
        Ok(cells)
    }
}

impl Part {
    fn cell(&self, task: &str, entry: &Entry, budget: f64) -> Result<Cell> {
        let of_task = self.of.get(task).map_or("", String::as_str);
        let texts = [self.settings.as_str(), of_task, entry.settings.as_str()];
        let layers = texts.map(|text| Layer::of_text(text, &self.name)).into_iter().collect::<Result<Vec<_>>>()?;
        let config = TrainConfig::layered(task, Some(&entry.algorithm), &layers)?;
        Ok(Cell {
            part: self.name.clone(),
            algorithm: entry.algorithm.clone(),
            setting: entry.setting.clone(),
            config: budgeted(config, budget),
        })
    }
}

fn same(a: &str, b: &str) -> bool {
    a.eq_ignore_ascii_case(b)
}

/// Refuses a name that is not known.
fn check<'a>(kind: &'static str, asked: &[String], known: impl Iterator<Item = &'a String>) -> Result<()> {
    let known: BTreeSet<&String> = known.collect();
    match asked.iter().find(|name| !known.iter().any(|own| same(own, name))) {
        None => Ok(()),
        Some(name) => Err(Error::Unknown { kind, name: name.clone(), known: known.into_iter().cloned().collect() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use omnidrones::controllers::cascade::Level;

    #[test]
    fn every_row_of_every_study_has_settings_and_a_name_of_its_own() {
        for name in names() {
            let plan = Plan::by_name(name).unwrap();
            let cells = plan.cells(&[], &[], 1.0).unwrap();
            let mut names: Vec<String> =
                cells.iter().map(|cell| format!("{} {}", cell.config.task, cell.label())).collect();
            let n = names.len();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), n, "{name}");
            for claim in &plan.claims {
                let of = |part: &str, own: &str| cells.iter().any(|cell| cell.part == part && cell.algorithm == own);
                let all = |part: &String| claim.algorithms.iter().all(|own| of(part, own));
                assert!(!claim.parts.is_empty() && claim.parts.iter().all(all), "{}", claim.says);
            }
        }
    }

    #[test]
    fn velocities_that_rows_of_track_command_reach_those_of_its_path() {
        let cells = Plan::by_name("paper").unwrap().cells(&["Track".into()], &[], 1.0).unwrap();
        let commanded = cells.iter().map(|cell| &cell.config.env).filter(|env| env.control == Level::Velocity);
        let most: Vec<f64> = commanded.map(|env| env.action_scale.velocity).collect();
        // the lemniscate's largest scale by its largest rate; at 1 m/s no flight reached its end
        assert!(!most.is_empty() && most.iter().all(|most| *most >= 3.2 * 1.1), "{most:?}");
    }

    #[test]
    fn rows_are_chosen_by_task_and_algorithm_and_wrong_names_are_told() {
        let plan = Plan::by_name("paper").unwrap();
        let of = |tasks: &[&str], algorithms: &[&str]| {
            let own = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<_>>();
            plan.cells(&own(tasks), &own(algorithms), 0.5)
        };
        let cells = of(&["hover"], &["dqn"]).unwrap();
        assert_eq!(cells.iter().map(Cell::label).collect::<Vec<_>>(), ["dqn, joint", "dqn, apart"]);
        let whole = &plan.cells(&[], &["dqn".into()], 1.0).unwrap()[0];
        assert_eq!(2 * cells[0].config.updates(), whole.config.updates());
        assert!(of(&["Hoover"], &[]).err().unwrap().to_string().contains("'Hover'"));
        assert!(of(&["Track"], &["mappo"]).err().unwrap().to_string().contains("Track by mappo"));
        assert!(of(&[], &["apg"]).err().unwrap().to_string().contains("algorithm of the study"));
        assert!(Plan::by_name("papr").err().unwrap().to_string().contains("'paper'"));
    }
}
