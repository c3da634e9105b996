//! What several seeds came to: figures with mean, least, largest and interval, and what to do about seeds that failed.

use crate::prelude::*;
use omnidrones::internals;
use omnidrones::rl::log::Line;
use omnidrones::rl::runs::SeedSummary;
use omnidrones::rl::search::{Score, Trial};
use omnidrones::rl::trainer::TrainResult;
use omnidrones::tasks::Evaluation;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Most points that are kept of a run's curve.
const CURVE: usize = 64;

/// What is kept of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    pub seed: u64,
    /// That trained it, if it is known.
    #[serde(default)]
    pub commit: Option<String>,
    pub evaluation: Evaluation,
    pub seconds: f64,
    pub env_steps: u64,
    pub updates: u64,
    /// Updates, environment steps and the share of successes from held-out starts after them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub curve: Vec<(u64, u64, f64)>,
}

impl Outcome {
    /// Of a run that is over.
    pub fn of(seed: u64, result: &TrainResult) -> Self {
        let TrainResult { evaluation, seconds, env_steps, updates, curve, .. } = result;
        Self {
            seed,
            commit: option_env!("OMNIDRONES_COMMIT").map(String::from),
            evaluation: evaluation.clone(),
            seconds: *seconds,
            env_steps: *env_steps,
            updates: *updates,
            curve: thinned(curve),
        }
    }

    /// Its curve as lines of a log.
    pub fn lines(&self) -> Vec<Line> {
        let line = |(update, env_steps, success): &(u64, u64, f64)| {
            let mut line = Line::new(*update);
            line.put("env_steps", *env_steps as f64);
            line.put("seconds", self.seconds * *update as f64 / self.updates.max(1) as f64);
            line.put("eval_success", *success);
            line
        };
        self.curve.iter().map(line).collect()
    }
}

/// What is wrong with runs as a file tells them.
pub fn fault(runs: &[Outcome]) -> Option<String> {
    let mut seeds = BTreeSet::new();
    if let Some(run) = runs.iter().find(|run| !seeds.insert(run.seed)) {
        return Some(format!("seed {} stands there twice", run.seed));
    }
    let sound = |run: &&Outcome| {
        let rising = run.curve.windows(2).all(|pair| pair[0].0 < pair[1].0);
        run.seconds.is_finite() && run.seconds >= 0.0 && rising && run.curve.iter().all(|(_, _, x)| x.is_finite())
    };
    let wrong = runs.iter().find(|run| !sound(run))?;
    Some(format!("seed {}: its time is no number of seconds, or its curve none", wrong.seed))
}

/// Evaluations of a log: every one, or every so many as leave [`CURVE`], and the last.
fn thinned(log: &[Line]) -> Vec<(u64, u64, f64)> {
    let point = |line: &Line| {
        let of = |name| line.get(name);
        Some((of("update")? as u64, of("env_steps")? as u64, of("eval_success")?))
    };
    let all: Vec<_> = log.iter().filter_map(point).collect();
    let every = all.len().div_ceil(CURVE).max(1);
    all.iter().rev().step_by(every).rev().copied().collect()
}

/// A seed that failed, and why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    pub seed: u64,
    pub why: String,
}

/// Results by whether they are some.
pub fn split(seeds: &[u64], results: &[Result<TrainResult>]) -> (Vec<Outcome>, Vec<Failure>) {
    let (mut done, mut failed) = (Vec::new(), Vec::new());
    for (seed, result) in seeds.iter().zip(results) {
        match result {
            Ok(result) => done.push(Outcome::of(*seed, result)),
            Err(error) => failed.push(Failure { seed: *seed, why: error.to_string() }),
        }
    }
    (done, failed)
}

/// A figure over the seeds that were trained.
pub fn spread(runs: &[Outcome], of: impl Fn(&Outcome) -> f64) -> Option<SeedSummary> {
    SeedSummary::of(&runs.iter().map(of).collect::<Vec<_>>())
}

/// `98.2 % ± 0.4 (97.5 %–99.1 %)`: mean, half the width of its interval, least and largest.
pub fn shown(spread: Option<SeedSummary>, show: impl Fn(f64) -> String, scale: f64) -> String {
    let Some(SeedSummary { mean, least, largest, half_width }) = spread else { return "–".into() };
    let (middle, least, largest) = (show(mean), show(least), show(largest));
    if least == largest {
        return middle;
    }
    let half = half_width.map_or(String::new(), |half| format!(" ± {}", short(scale * half, 2)));
    format!("{middle}{half} ({least}–{largest})")
}

/// Largest file of several runs that is read, bytes.
pub const MAX_JSON: u64 = 64 << 20;

/// The runs of several seeds.
#[derive(Deserialize)]
struct Seeds {
    runs: Vec<Outcome>,
}

/// The run that did best in a folder of seeds or of a search, where its file tells that.
pub fn best_run(folder: &Path) -> Option<PathBuf> {
    let rank = |e: &Evaluation| (e.success, e.share_of_bound);
    let better = |a: (f64, f64), b: (f64, f64)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1));
    let seeds = folder.join("seeds.json");
    let told = files::read_text(&seeds, MAX_JSON);
    if let Ok(Seeds { runs }) = told.and_then(|text| internals::of_json(text.as_bytes(), "seeds.json", "")) {
        let best = runs.iter().max_by(|a, b| better(rank(&a.evaluation), rank(&b.evaluation)))?;
        return Some(folder.join(format!("s{}", best.seed)));
    }
    let (search, trials, _) = internals::read_search(folder).ok()?;
    let winner = best(&trials)?;
    let last = trials.iter().filter(|trial| trial.candidate == winner).max_by_key(|trial| trial.rung)?;
    let scores = last.scores.iter().zip(&search.seeds).filter_map(|(score, seed)| Some((score.as_ref()?, seed)));
    let of = |score: &Score| (score.success, score.share_of_bound);
    let (_, seed) = scores.max_by(|(a, _), (b, _)| better(of(a), of(b)))?;
    Some(folder.join(&search.candidates[winner].0).join(format!("s{seed}")))
}

/// The best candidate so far: on the last rung that was reached. One of which no run was trained is none.
pub fn best(trials: &[Trial]) -> Option<usize> {
    let best = trials.iter().max_by(|a, b| a.rung.cmp(&b.rung).then(a.compare(b)).then(b.candidate.cmp(&a.candidate)));
    best.filter(|trial| trial.is_trained()).map(|trial| trial.candidate)
}

/// All of it, for programs.
pub fn value(runs: &[Outcome], failed: &[Failure]) -> Value {
    let of = |what: fn(&Outcome) -> f64| spread(runs, what);
    json!({
        "runs": runs,
        "failed": failed,
        "success": of(|run| run.evaluation.success),
        "crashed": of(|run| run.evaluation.crashed),
        "share_of_bound": of(|run| run.evaluation.share_of_bound),
        "return": of(|run| run.evaluation.return_mean),
        "change_of_commands": of(|run| run.evaluation.command_change()),
        "final_error": of(|run| run.evaluation.final_error),
        "mean_error": of(|run| run.evaluation.mean_error),
        "seconds": of(|run| run.seconds),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_is_thinned_to_few_evaluations_and_keeps_the_last() {
        let line = |update: u64| {
            let mut line = Line::new(update);
            line.put("env_steps", 10.0 * update as f64);
            line.put("eval_success", if update.is_multiple_of(2) { 0.5 } else { f64::NAN });
            line
        };
        let of = |n: u64| thinned(&(1..=n).map(line).collect::<Vec<_>>());
        assert_eq!(of(5), [(2, 20, 0.5), (4, 40, 0.5)]);
        let long = of(400);
        assert_eq!((long.len(), long.last()), (50, Some(&(400, 4000, 0.5)))); // 200 evaluations, every 4th
        assert!(of(0).is_empty());
    }

    #[test]
    fn seeds_that_stand_there_twice_and_curves_that_are_none_are_faults() {
        let one = r#"{"seed": 0, "seconds": 1, "env_steps": 1, "updates": 1, "evaluation": {
            "n_episode": 1, "return_mean": 0, "return_std": 0, "share_of_bound": 0, "terms": [], "success": 0,
            "success_interval": [0, 0], "success_by_last_error": 0, "crashed": 0, "length": 0, "final_metrics": [],
            "final_error": 0, "mean_error": 0, "ends": []}}"#;
        let one: Outcome = serde_json::from_str(one).unwrap();
        let of = |seed: u64| Outcome { seed, ..one.clone() };
        assert_eq!(fault(&[]).or(fault(&[of(0), of(u64::MAX), of(3)])), None);
        for seed in [0, 7, u64::MAX] {
            let told = fault(&[of(seed), of(1), of(seed)]).unwrap();
            assert_eq!(told, format!("seed {seed} stands there twice"));
        }
        for (seconds, curve) in [
            (-1.0, vec![]),
            (f64::NAN, vec![]),
            (1.0, vec![(2, 2, 0.1), (2, 3, 0.1)]),
            (1.0, vec![(1, 1, f64::INFINITY)]),
        ] {
            assert!(fault(&[of(0), Outcome { seconds, curve, ..of(1) }]).unwrap().starts_with("seed 1: its time"));
        }
    }

    #[test]
    fn a_figure_shows_its_edges_and_its_interval_only_where_seeds_differ() {
        let of = |values: &[f64]| shown(SeedSummary::of(values), percent, 100.0);
        assert_eq!(of(&[0.4, 0.5, 0.6]), "50 % ± 25 (40 %–60 %)"); // 4.303 · 0.1/√3
        assert_eq!((of(&[1.0, 1.0]), of(&[1.0]), of(&[])), ("100 %".into(), "100 %".into(), "–".into()));
    }
}
