//! Rows of tables of runs: one configuration, several seeds, kept in a file of its own that a later call goes on with.

use super::over_seeds::{self, Failure, Outcome, split};
use super::train_seeds;
use crate::prelude::*;
use omnidrones::internals;
use omnidrones::parallel::Threads;
use omnidrones::rl::TrainConfig;
use omnidrones::rl::algorithm;
use omnidrones::rl::log::{self, Line};
use omnidrones::rl::runs::{Run, fingerprint};
use omnidrones::tasks::registry;
use omnidrones_studies::plan::label;
use serde::{Deserialize, Serialize};

/// Largest file of a row, bytes.
pub const MAX_ROW: u64 = 16 << 20;

/// What is kept of a configuration and its seeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    pub task: String,
    pub algorithm: String,
    /// What sets it apart from others of its task and algorithm, as part of a name.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub setting: String,
    /// Of settings, task and physics.
    pub hash: String,
    pub runs: Vec<Outcome>,
    pub failed: Vec<Failure>,
}

/// A row that is asked for.
pub struct Asked<'a> {
    pub algorithm: &'a str,
    pub setting: &'a str,
    pub config: &'a TrainConfig,
    pub seeds: u64,
}

/// Refuses factors on updates that mean nothing.
///
/// # Errors
/// [`Error::Value`].
pub fn check_budget(factor: f64) -> Result<()> {
    if factor.is_finite() && factor > 0.0 {
        return Ok(());
    }
    Err(Error::value("--budget", factor, "finite and > 0", "1 takes the updates as they are."))
}

impl Row {
    fn new(asked: &Asked<'_>) -> Result<Self> {
        Ok(Self {
            task: asked.config.task.clone(),
            algorithm: asked.algorithm.into(),
            setting: asked.setting.into(),
            hash: fingerprint(asked.config)?,
            runs: Vec::new(),
            failed: Vec::new(),
        })
    }

    /// What is wrong with it, and where.
    fn fault(&self) -> Option<(&'static str, String)> {
        if let Err(error) = registry::by_name(&self.task) {
            return Some(("task", error.to_string()));
        }
        if let Err(error) = algorithm::by_name(algorithm::base(&self.algorithm)) {
            return Some(("algorithm", error.to_string()));
        }
        if files::plain_name(&self.setting) != self.setting {
            return Some(("setting", format!("'{}' is no part of a file's name", self.setting)));
        }
        if self.hash.is_empty() || self.hash.len() > 64 || !self.hash.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Some(("hash", format!("'{}' is no hexadecimal number", self.hash)));
        }
        over_seeds::fault(&self.runs).map(|rule| ("runs", rule))
    }

    /// `dqn, joint`.
    pub fn label(&self) -> String {
        label(&self.algorithm, &self.setting)
    }

    /// Task, algorithm, seeds, commits that trained them and hash: where it comes from, for a table.
    pub fn origin(&self) -> [String; 5] {
        let seeds: Vec<String> = self.runs.iter().map(|run| run.seed.to_string()).collect();
        let mut commits: Vec<&str> = Vec::new();
        for commit in self.runs.iter().map(|run| run.commit.as_deref().unwrap_or("–")) {
            if !commits.contains(&commit) {
                commits.push(commit);
            }
        }
        [self.task.clone(), self.label(), seeds.join(", "), commits.join(", "), self.hash.clone()]
    }

    /// Task, algorithm and setting, as in names of files.
    fn stem(&self) -> String {
        let parts = [&self.task, &self.algorithm, &self.setting];
        parts.into_iter().filter(|part| !part.is_empty()).cloned().collect::<Vec<_>>().join("-")
    }

    /// A run's folder bears the hash of its row: other physics begin elsewhere.
    pub fn run_folder(&self, folder: &Path, seed: u64) -> PathBuf {
        folder.join(format!("{}-{}-s{seed}", self.stem(), self.hash))
    }

    /// The course of its runs: their logs where they are here, else what is kept of them.
    pub fn curves(&self, folder: &Path) -> Vec<Vec<Line>> {
        let course = |run: &Outcome| log::read(self.run_folder(folder, run.seed)).unwrap_or_else(|_| run.lines());
        self.runs.iter().map(course).filter(|lines| !lines.is_empty()).collect()
    }

    fn path(&self, folder: &Path, updates: u64) -> PathBuf {
        folder.join(format!("{}-u{updates}.json", self.stem()))
    }
}

/// The row as it is kept in `folder`, with all of its seeds; an empty one where it is not there or stale.
///
/// # Errors
/// As [`fingerprint`].
pub fn known(asked: &Asked<'_>, folder: &Path) -> Result<Row> {
    let fresh = Row::new(asked)?;
    Ok(kept(&fresh.path(folder, asked.config.updates()), &fresh).unwrap_or(fresh))
}

/// The row as it is kept in `folder`, with the seeds that are missing trained.
///
/// # Errors
/// As [`fingerprint`], and of the file of the row.
pub fn train(asked: &Asked<'_>, folder: &Path, threads: &Threads, bar: &indicatif::ProgressBar) -> Result<Row> {
    let fresh = Row::new(asked)?;
    let config = asked.config;
    let path = fresh.path(folder, config.updates());
    let known = kept(&path, &fresh);
    let mut row = known.clone().unwrap_or(fresh);
    row.failed.clear();
    let missing: Vec<u64> = (0..asked.seeds).filter(|seed| row.runs.iter().all(|run| run.seed != *seed)).collect();
    let run = |seed: &u64| Run {
        config: TrainConfig { seed: *seed, ..config.clone() },
        folder: row.run_folder(folder, *seed),
        until: u64::MAX,
    };
    let all: Vec<Run> = missing.iter().map(run).collect();
    bar.set_length(config.updates().saturating_mul(all.len() as u64));
    progress::say(bar, &format!("{} · {}", row.task, asked.algorithm));
    let (done, failed) = split(&missing, &train_seeds::train(&all, threads, bar));
    row.runs.extend(done);
    row.runs.sort_by_key(|run| run.seed);
    row.failed = failed;
    if known.as_ref() != Some(&row) {
        let text = serde_json::to_string_pretty(&row).unwrap_or_default();
        files::replace(&path, (text + "\n").as_bytes())?;
        files::note_saved(&path);
    }
    row.runs.retain(|run| run.seed < asked.seeds);
    Ok(row)
}

/// The row of a file, unless it is stale. One that cannot be read is told and trained anew.
fn kept(path: &Path, fresh: &Row) -> Option<Row> {
    if path.symlink_metadata().is_err() {
        return None;
    }
    match read(path) {
        Ok(row) => (row.hash == fresh.hash).then_some(row),
        Err(error) => {
            eprintln!("warning: {}", shown(&format!("{error} It is trained anew.")));
            None
        }
    }
}

/// Whether a file is called as rows are: `TASK-ALGO-u300.json`.
pub fn is_row(path: &Path) -> bool {
    let name = path.file_name().map(|name| name.to_string_lossy());
    let updates = name.as_ref().and_then(|name| name.strip_suffix(".json")?.rsplit_once("-u"));
    updates.is_some_and(|(_, n)| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
}

/// A row as its file tells it, checked as a whole.
pub fn read(path: &Path) -> Result<Row> {
    let row: Row =
        internals::of_json(files::read_text(path, MAX_ROW)?.as_bytes(), &path.display().to_string(), REMEDY)?;
    match row.fault() {
        None => Ok(row),
        Some((place, rule)) => {
            let (file, remedy) = (path.display().to_string(), REMEDY.into());
            Err(Error::Format { file, place: place.into(), rule, remedy })
        }
    }
}

const REMEDY: &str = "Remove it, and train it anew.";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finished_row_is_kept_until_its_hash_changes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("row.json");
        let row = |hash: &str| Row {
            task: "Hover".into(),
            algorithm: "apg".into(),
            setting: String::new(),
            hash: hash.into(),
            runs: Vec::new(),
            failed: vec![Failure { seed: 3, why: "no".into() }],
        };
        assert_eq!(kept(&path, &row("1")), None);
        std::fs::write(&path, serde_json::to_string(&row("1")).unwrap()).unwrap();
        assert_eq!(kept(&path, &row("1")), Some(row("1")));
        assert_eq!(kept(&path, &row("2")), None);
    }

    #[test]
    fn a_row_whose_seeds_came_later_tells_each_commit_once() {
        let run = |seed: u64, commit: &str| {
            format!(
                r#"{{"seed": {seed}, "commit": {commit}, "seconds": 1, "env_steps": 1, "updates": 1, "evaluation": {{
                "n_episode": 1, "return_mean": 0, "return_std": 0, "share_of_bound": 0, "terms": [], "success": 0,
                "success_interval": [0, 0], "success_by_last_error": 0, "crashed": 0, "length": 0, "final_metrics": [],
                "final_error": 0, "mean_error": 0, "ends": []}}}}"#
            )
        };
        let runs = [run(0, r#""abc""#), run(1, r#""def""#), run(2, r#""abc""#), run(3, "null")].join(",");
        let text = format!(r#"{{"task": "Hover", "algorithm": "apg", "hash": "1", "runs": [{runs}], "failed": []}}"#);
        let row: Row = serde_json::from_str(&text).unwrap();
        assert_eq!(row.origin(), ["Hover", "apg", "0, 1, 2, 3", "abc, def, –", "1"].map(String::from));
    }

    #[test]
    fn names_of_files_hold_the_setting_where_there_is_one() {
        let of = |setting: &str| {
            let config = TrainConfig::for_task("Hover", Some("dqn"), None).unwrap();
            Row::new(&Asked { algorithm: "dqn", setting, config: &config, seeds: 1 }).unwrap()
        };
        let folder = Path::new("f");
        assert_eq!(of("").path(folder, 3), Path::new("f/Hover-dqn-u3.json"));
        assert_eq!(of("joint").path(folder, 3), Path::new("f/Hover-dqn-joint-u3.json"));
        assert_ne!(of("").run_folder(folder, 0), of("joint").run_folder(folder, 0));
    }
}
