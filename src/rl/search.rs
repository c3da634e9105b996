//! Which settings are best: successive halving over several seeds (Jamieson and Talwalkar 2016; the inner loop of Hyperband,
//! Li et al. 2018).
//!
//! With n candidates and a factor η there are K = ⌊log_η n⌋ rungs before the last. On rung k every candidate that is left
//! trains on to the share η^(k − K) of its updates, and the best ⌈n_k/η⌉ go on; the last rung is the whole run. The best have
//! the largest success, a mean over the seeds; among equals the larger share of the reward's bound, then the first.
//!
//! Schedules stretch over the whole run, not over a rung: a rung pauses a run, which later goes on. So nothing is trained
//! twice, and the winner's runs are those that its settings give alone, to the bit. The price is that a candidate is judged
//! while its rate is still high; where that misleads, take a smaller factor.

use super::config::TrainConfig;
use super::runs::{self, Run};
use super::trainer::{Progress, TrainResult};
use crate::error::{Error, Result};
use crate::file_gate;
use crate::parallel::Threads;
use crate::reader;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// File of what is known so far.
const FILE: &str = "search.json";

/// What is tried.
#[derive(Debug, Clone)]
pub struct Search {
    /// Candidates by their names, which are those of their folders.
    pub candidates: Vec<(String, TrainConfig)>,
    /// Every candidate trains with each.
    pub seeds: Vec<u64>,
    /// η: of so many one goes on.
    pub factor: usize,
}

/// How well a run did on a rung.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Share of successes.
    pub success: f64,
    /// Mean return over the largest.
    pub share_of_bound: f64,
}

/// A candidate on a rung.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Its place.
    pub candidate: usize,
    /// From 0 on.
    pub rung: usize,
    /// Updates done by then.
    pub updates: u64,
    /// Of every seed; none where it failed, which counts as no success.
    pub scores: Vec<Option<Score>>,
}

impl Trial {
    /// Mean success and mean share of the bound over all seeds.
    pub fn mean(&self) -> [f64; 2] {
        let n = self.scores.len().max(1) as f64;
        let of = |what: fn(&Score) -> f64| self.scores.iter().flatten().map(what).sum::<f64>() / n;
        [of(|score| score.success), of(|score| score.share_of_bound)]
    }
}

/// What a search came to.
#[derive(Debug, Clone)]
pub struct SearchResult {
    /// Rung by rung, on each in the order of the candidates.
    pub trials: Vec<Trial>,
    /// Place of the best candidate on the last rung.
    pub winner: usize,
    /// What went wrong: candidate, seed and why.
    pub failures: Vec<(usize, u64, String)>,
}

/// On disk: what was asked, and what is known of it.
#[derive(Serialize, Deserialize)]
struct Known {
    candidates: BTreeMap<String, String>,
    seeds: Vec<u64>,
    factor: usize,
    trials: Vec<Trial>,
    failures: Vec<(usize, u64, String)>,
}

impl Search {
    /// Rungs, the last one included.
    pub fn rungs(&self) -> usize {
        let mut rungs = 1;
        while self.factor > 1 && self.factor.saturating_pow(rungs as u32) <= self.candidates.len() {
            rungs += 1;
        }
        rungs
    }

    /// Updates of a candidate by the end of a rung.
    pub fn updates(&self, candidate: usize, rung: usize) -> u64 {
        let whole = self.candidates[candidate].1.updates();
        let behind = (self.rungs() - 1 - rung) as i32;
        (whole as f64 / (self.factor as f64).powi(behind)).ceil().max(1.0) as u64
    }

    /// Trains, or goes on where a search in `folder` was stopped. `watch` sees every update: candidate, seed, progress.
    ///
    /// # Errors
    /// [`Error::Value`] for no candidate, no seed, a factor below 2, and a folder with another search; [`Error::File`] if
    /// the disk refuses. Runs that fail are told in the result.
    pub fn run(
        &self,
        folder: &Path,
        threads: &Threads,
        watch: &(dyn Fn(usize, u64, &Progress<'_>) + Sync),
    ) -> Result<SearchResult> {
        for (what, n, least) in
            [("candidates", self.candidates.len(), 1), ("seeds", self.seeds.len(), 1), ("factor", self.factor, 2)]
        {
            if n < least {
                let remedy = "3 candidates or more, 2 seeds or more and a factor of 3 are usual.";
                return Err(Error::value(format!("{what} of the search"), n, format!("≥ {least}"), remedy));
            }
        }
        let mut known = self.known(folder)?;
        // from the beginning: a search that is killed on its first rung is one
        save(&known, folder)?;
        let mut alive: Vec<usize> = (0..self.candidates.len()).collect();
        for rung in 0..self.rungs() {
            let done = known.trials.iter().filter(|trial| trial.rung == rung).count() == alive.len();
            if !done {
                known.trials.retain(|trial| trial.rung < rung);
                let (trials, failed) = self.rung(rung, &alive, folder, threads, watch);
                known.trials.extend(trials);
                known.failures.extend(failed);
                save(&known, folder)?;
            }
            let trials: Vec<&Trial> = known.trials.iter().filter(|trial| trial.rung == rung).collect();
            let kept = if rung + 1 < self.rungs() { alive.len().div_ceil(self.factor) } else { 1 };
            alive = best(&trials, kept);
        }
        Ok(SearchResult { trials: known.trials, winner: alive[0], failures: known.failures })
    }

    fn rung(
        &self,
        rung: usize,
        alive: &[usize],
        folder: &Path,
        threads: &Threads,
        watch: &(dyn Fn(usize, u64, &Progress<'_>) + Sync),
    ) -> (Vec<Trial>, Vec<(usize, u64, String)>) {
        let pairs: Vec<(usize, u64)> = alive.iter().flat_map(|c| self.seeds.iter().map(|seed| (*c, *seed))).collect();
        let run = |(candidate, seed): &(usize, u64)| {
            let (name, config) = &self.candidates[*candidate];
            let config = TrainConfig { seed: *seed, ..config.clone() };
            Run { config, folder: folder.join(name).join(format!("s{seed}")), until: self.updates(*candidate, rung) }
        };
        let all: Vec<Run> = pairs.iter().map(run).collect();
        let told = runs::train(&all, threads, &|k, progress| watch(pairs[k].0, pairs[k].1, progress));
        let mut failures = Vec::new();
        let mut scores = pairs.iter().zip(told).map(|((candidate, seed), told)| match told {
            Ok(TrainResult { evaluation: e, .. }) => {
                // what is no number is the worst of all
                let share_of_bound = if e.share_of_bound.is_finite() { e.share_of_bound } else { f64::MIN };
                Some(Score { success: e.success, share_of_bound })
            }
            Err(error) => {
                failures.push((*candidate, *seed, error.to_string()));
                None
            }
        });
        let trial = |candidate: &usize| Trial {
            candidate: *candidate,
            rung,
            updates: self.updates(*candidate, rung),
            scores: scores.by_ref().take(self.seeds.len()).collect(),
        };
        let trials = alive.iter().map(trial).collect();
        (trials, failures)
    }

    /// What is known in a folder, which must be of this search.
    fn known(&self, folder: &Path) -> Result<Known> {
        let text = |(name, config): &(String, TrainConfig)| Ok((name.clone(), config.to_toml()?));
        let candidates = self.candidates.iter().map(text).collect::<Result<_>>()?;
        let own = Known {
            candidates,
            seeds: self.seeds.clone(),
            factor: self.factor,
            trials: Vec::new(),
            failures: Vec::new(),
        };
        let path = folder.join(FILE);
        if path.symlink_metadata().is_err() {
            return Ok(own);
        }
        let text = file_gate::read_text(&path, file_gate::MAX_LOG)?;
        let remedy = "Search anew in another folder (--out), or replace this one (--force).";
        let known: Known = reader::of_json(text.as_bytes(), &path.display().to_string(), remedy)?;
        if (&known.candidates, &known.seeds, known.factor) != (&own.candidates, &own.seeds, own.factor) {
            let value = format!("'{}', of other settings, seeds or factor", folder.display());
            return Err(Error::value("folder of the search", value, "new or that of this search", "Name another one."));
        }
        Ok(known)
    }
}

fn save(known: &Known, folder: &Path) -> Result<()> {
    let path = folder.join(FILE);
    std::fs::create_dir_all(folder).map_err(|e| Error::file(folder, e))?;
    let text = serde_json::to_string_pretty(known).unwrap_or_default();
    file_gate::replace(&path, &text)
}

/// The `n` best candidates of a rung, in their order.
fn best(trials: &[&Trial], n: usize) -> Vec<usize> {
    let mut ranked: Vec<&&Trial> = trials.iter().collect();
    let compare = |a: [f64; 2], b: [f64; 2]| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]));
    // stable: among equals the first stays first
    ranked.sort_by(|a, b| compare(b.mean(), a.mean()));
    let mut kept: Vec<usize> = ranked.into_iter().take(n).map(|trial| trial.candidate).collect();
    kept.sort_unstable();
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn search(n: usize, factor: usize) -> Search {
        let text = "log_every = 1\nevaluate = { every = 0, envs = 8, seed = 1 }\n[apg]\nn_env = 8\nshard = 8\nhorizon = 4\n\
                    updates = 9\nnetwork.hidden = [8]\n[env.task]\nhorizon = 10";
        let one = |k: usize| {
            let own = format!("{text}\n[apg.learning_rate]\nkind = 'constant'\nvalue = 0.00{}", k + 1);
            let config = TrainConfig::for_task("Hover", None, Some((&own, "tiny"))).unwrap();
            (format!("c{k}"), config)
        };
        Search { candidates: (0..n).map(one).collect(), seeds: vec![3, 4], factor }
    }

    #[test]
    fn rungs_and_updates_are_those_of_successive_halving() {
        let nine = search(9, 3);
        assert_eq!(nine.rungs(), 3);
        assert_eq!([0, 1, 2].map(|rung| nine.updates(0, rung)), [1, 3, 9]);
        assert_eq!((search(1, 3).rungs(), search(2, 3).rungs(), search(4, 2).rungs()), (1, 1, 3));
    }

    #[test]
    fn the_best_have_the_largest_mean_success_then_the_larger_return_then_the_first_place() {
        let trial = |candidate, scores: &[Option<(f64, f64)>]| {
            let score = |s: &(f64, f64)| Score { success: s.0, share_of_bound: s.1 };
            Trial { candidate, rung: 0, updates: 1, scores: scores.iter().map(|s| s.as_ref().map(score)).collect() }
        };
        let all = [
            trial(0, &[Some((0.5, 0.2)), Some((0.5, 0.2))]),
            trial(1, &[Some((1.0, 0.9)), None]),
            trial(2, &[Some((0.5, 0.4)), Some((0.5, 0.4))]),
            trial(3, &[Some((0.6, 0.1)), Some((0.6, 0.1))]),
        ];
        let all: Vec<&Trial> = all.iter().collect();
        assert_eq!((best(&all, 1), best(&all, 2), best(&all, 3)), (vec![3], vec![1, 3], vec![1, 2, 3]));
    }

    #[test]
    fn a_search_that_was_stopped_goes_on_to_the_same_result_and_the_winner_has_the_bits_of_a_run_alone() {
        let folder = tempfile::tempdir().unwrap();
        let [whole, parts] = ["whole", "parts"].map(|name| folder.path().join(name));
        let (own, two) = (search(3, 3), Threads::new(2).unwrap());
        let told = own.run(&whole, &two, &|_, _, _| ()).unwrap();
        assert_eq!(
            told.trials.iter().map(|t| (t.rung, t.updates)).collect::<Vec<_>>(),
            [(0, 3), (0, 3), (0, 3), (1, 9)]
        );
        assert!(told.failures.is_empty());
        // stopped in the middle of a rung: some runs are there, no word of the rung is
        let pairs = own.rung(0, &[1, 2], &parts, &Threads::new(1).unwrap(), &|_, _, _| ());
        assert_eq!(pairs.0[..], told.trials[1..3]);
        let again = own.run(&parts, &Threads::new(1).unwrap(), &|_, _, _| ()).unwrap();
        assert_eq!((&again.trials, again.winner), (&told.trials, told.winner));
        assert_eq!(own.run(&parts, &two, &|_, _, _| panic!("nothing is left to train")).unwrap().trials, told.trials);
        let (name, config) = &own.candidates[told.winner];
        let config = TrainConfig { seed: 3, ..config.clone() };
        let mut alone = super::super::Trainer::new("Hover", config, Threads::default()).unwrap();
        let alone = alone.run(&mut |_| std::ops::ControlFlow::Continue(())).unwrap();
        let kept = super::super::load_policy(whole.join(name).join("s3")).unwrap();
        assert_eq!(kept.policy.parameters(), alone.policy.parameters());
        let other = search(2, 3).run(&parts, &two, &|_, _, _| ()).unwrap_err().to_string();
        assert!(other.contains("of other settings, seeds or factor"), "{other}");
    }
}
