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
use super::trainer::{RunProgress, TrainResult, is_run};
use base::error::{Error, Result};
use base::file_gate;
use base::parallel::Threads;
use base::reader;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
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
    /// η, at least 2: of so many candidates one goes on to the next rung.
    pub factor: usize,
}

/// How well a run did on a rung.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Share of evaluated episodes that were a success.
    pub success: f64,
    /// Mean return over the largest, [`Evaluation::share_of_bound`](tasks::Evaluation::share_of_bound).
    pub share_of_bound: f64,
}

/// A candidate on a rung.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Its place in [`Search::candidates`].
    pub candidate: usize,
    /// From 0 on.
    pub rung: usize,
    /// Updates done by then.
    pub updates: u64,
    /// Score of every seed; none where it failed, which counts as no success.
    pub scores: Vec<Option<Score>>,
}

impl Trial {
    /// Mean success and mean share of the bound over all seeds.
    pub fn mean(&self) -> [f64; 2] {
        let n = self.scores.len().max(1) as f64;
        let of = |what: fn(&Score) -> f64| self.scores.iter().flatten().map(what).sum::<f64>() / n;
        [of(|score| score.success), of(|score| score.share_of_bound)]
    }

    /// Whether a run of it came to a score.
    pub fn is_trained(&self) -> bool {
        self.scores.iter().any(Option::is_some)
    }

    /// Which did better on a rung: one that was trained, then more success, then a larger share of the bound.
    pub fn compare(&self, other: &Self) -> Ordering {
        let ([a, b], [x, y]) = (self.mean(), other.mean());
        self.is_trained().cmp(&other.is_trained()).then(a.total_cmp(&x)).then(b.total_cmp(&y))
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
#[serde(deny_unknown_fields)]
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

    /// Updates of a candidate by the end of a rung, ⌈N η^−(rungs − 1 − rung)⌉ of the N of its run.
    ///
    /// # Panics
    /// If there is no such candidate or rung.
    pub fn updates(&self, candidate: usize, rung: usize) -> u64 {
        let whole = self.candidates[candidate].1.updates();
        let behind = (self.rungs() - 1 - rung) as i32;
        (whole as f64 / (self.factor as f64).powi(behind)).ceil().max(1.0) as u64
    }

    /// Trains, or goes on where a search in `folder` was stopped. `watch` sees every update: candidate, seed, progress.
    ///
    /// # Errors
    /// [`Error::Value`] for no candidate, no seed, a factor below 2, a folder with another search or with runs that no search lists,
    /// and if every run of the last rung failed; [`Error::File`] if the disk refuses. Runs that fail beside others stand in
    /// [`SearchResult::failures`].
    pub fn run(
        &self,
        folder: &Path,
        threads: &Threads,
        watch: &(dyn Fn(usize, u64, &RunProgress<'_>) + Sync),
    ) -> Result<SearchResult> {
        self.check_asked()?;
        for (name, _) in &self.candidates {
            file_gate::own_folder(&folder.join(name))?;
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
            alive = best(&trials, self.kept(rung, alive.len()));
        }
        let told = SearchResult { trials: known.trials, winner: alive[0], failures: known.failures };
        if !told.trials.iter().any(|trial| trial.rung + 1 == self.rungs() && trial.is_trained()) {
            return Err(nothing_trained(&told));
        }
        Ok(told)
    }

    /// That there is something to search.
    fn check_asked(&self) -> Result<()> {
        for (what, n, least) in
            [("candidates", self.candidates.len(), 1), ("seeds", self.seeds.len(), 1), ("factor", self.factor, 2)]
        {
            if n < least {
                let remedy = "3 candidates or more, 2 seeds or more and a factor of 3 are usual.";
                return Err(Error::value(format!("{what} of the search"), n, format!("≥ {least}"), remedy));
            }
        }
        Ok(())
    }

    fn rung(
        &self,
        rung: usize,
        alive: &[usize],
        folder: &Path,
        threads: &Threads,
        watch: &(dyn Fn(usize, u64, &RunProgress<'_>) + Sync),
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
            return self.check_no_run(folder).map(|()| own);
        }
        let known = read(&path)?;
        if (&known.candidates, &known.seeds, known.factor) != (&own.candidates, &own.seeds, own.factor) {
            let value = format!("'{}', of other settings, seeds or factor", folder.display());
            return Err(Error::value("folder of the search", value, "new or that of this search", "Name another one."));
        }
        self.check(&known, &path)?;
        Ok(known)
    }

    /// Refuses runs in the places of its own: they are of another search, or of settings that nobody knows.
    fn check_no_run(&self, folder: &Path) -> Result<()> {
        let all = self.candidates.iter().flat_map(|(name, _)| self.seeds.iter().map(move |seed| (name, seed)));
        let mut runs = all.map(|(name, seed)| folder.join(name).join(format!("s{seed}")));
        let Some(run) = runs.find(|run| is_run(run)) else { return Ok(()) };
        let value =
            format!("'{}', where {} is a run already and no {FILE} tells of it", folder.display(), run.display());
        let remedy = "Replace its runs (--force), or name another folder (--out).";
        Err(Error::value("folder of the search", value, "new, empty or that of a search", remedy))
    }

    /// Checks what a file tells of the rungs of this search.
    fn check(&self, known: &Known, path: &Path) -> Result<()> {
        let mut alive: Vec<usize> = (0..self.candidates.len()).collect();
        for (i, trial) in known.trials.iter().enumerate() {
            if let Some(rule) = self.fault(trial, &known.trials[..i]) {
                return Err(damaged(path, format!("trials[{i}]"), rule));
            }
        }
        for rung in 0..self.rungs() {
            let trials: Vec<&Trial> = known.trials.iter().filter(|trial| trial.rung == rung).collect();
            if let Some(trial) = trials.iter().find(|trial| !alive.contains(&trial.candidate)) {
                let rule = format!("candidate {} did not come to it", trial.candidate);
                return Err(damaged(path, format!("trials of rung {rung}"), rule));
            }
            // one that was not over says nothing about the next
            alive = if trials.len() < alive.len() { Vec::new() } else { best(&trials, self.kept(rung, alive.len())) };
        }
        let all = known.failures.iter().enumerate();
        let mut unknown = all.filter(|(_, (c, seed, _))| *c >= self.candidates.len() || !self.seeds.contains(seed));
        unknown.next().map_or(Ok(()), |(i, (candidate, seed, _))| {
            let rule = format!("there is no candidate {candidate} with seed {seed}");
            Err(damaged(path, format!("failures[{i}]"), rule))
        })
    }

    /// What is wrong with a trial that stands behind these.
    fn fault(&self, trial: &Trial, before: &[Trial]) -> Option<String> {
        let Trial { candidate, rung, updates, scores } = trial;
        if *candidate >= self.candidates.len() || *rung >= self.rungs() {
            let (n, rungs) = (self.candidates.len(), self.rungs());
            return Some(format!("candidate {candidate} on rung {rung}: there are {n} candidates and {rungs} rungs"));
        }
        if before.iter().any(|other| (other.candidate, other.rung) == (*candidate, *rung)) {
            return Some(format!("candidate {candidate} on rung {rung} stands there twice"));
        }
        if scores.len() != self.seeds.len() {
            return Some(format!("{} scores for {} seeds", scores.len(), self.seeds.len()));
        }
        let wanted = self.updates(*candidate, *rung);
        if *updates != wanted {
            return Some(format!("{updates} updates, where the rung has {wanted}"));
        }
        let sound = |s: &Score| (0.0..=1.0).contains(&s.success) && s.share_of_bound.is_finite();
        let wrong = scores.iter().flatten().find(|score| !sound(score))?;
        Some(format!("success {} or share_of_bound {} is out of range", wrong.success, wrong.share_of_bound))
    }

    /// How many go on from a rung to which so many came.
    fn kept(&self, rung: usize, alive: usize) -> usize {
        if rung + 1 < self.rungs() { alive.div_ceil(self.factor) } else { 1 }
    }
}

/// Most candidates of a search that its folder tells.
const MAX_CANDIDATES: usize = 1000;

/// A run of a search that failed: its candidate, its seed, and why.
pub type Failure = (usize, u64, String);

/// A search as its folder holds it: what was asked, the trials so far, and what failed.
///
/// # Errors
/// [`Error::File`], [`Error::Limit`] and [`Error::Format`] for a file that cannot be read, or whose content contradicts itself.
pub fn read_search(folder: &Path) -> Result<(Search, Vec<Trial>, Vec<Failure>)> {
    let path = folder.join(FILE);
    let known = read(&path)?;
    if known.candidates.len() > MAX_CANDIDATES {
        let rule = format!("there are {}, over the limit of {MAX_CANDIDATES}", known.candidates.len());
        return Err(damaged(&path, "candidates", rule));
    }
    let candidate = |k: usize| {
        let name = format!("c{k}");
        let Some(text) = known.candidates.get(&name) else {
            let rule = format!("they are not called c0 to c{}", known.candidates.len() - 1);
            return Err(damaged(&path, "candidates", rule));
        };
        let config = TrainConfig::from_toml(text, "its settings");
        let config = config.map_err(|error| damaged(&path, format!("candidate {name}"), error.to_string()))?;
        Ok((name, config))
    };
    let candidates = (0..known.candidates.len()).map(candidate).collect::<Result<_>>()?;
    let search = Search { candidates, seeds: known.seeds.clone(), factor: known.factor };
    search.check_asked().map_err(|error| damaged(&path, "what was asked", error.to_string()))?;
    search.check(&known, &path)?;
    Ok((search, known.trials, known.failures))
}

fn read(path: &Path) -> Result<Known> {
    let text = file_gate::read_text(path, file_gate::MAX_LOG)?;
    reader::of_json(text.as_bytes(), &path.display().to_string(), REMEDY)
}

const REMEDY: &str = "Search anew in another folder (--out), or replace this one (--force).";

fn damaged(path: &Path, place: impl Into<String>, rule: impl Into<String>) -> Error {
    let file = path.display().to_string();
    Error::Format { file, place: place.into(), rule: rule.into(), remedy: REMEDY.into() }
}

fn save(known: &Known, folder: &Path) -> Result<()> {
    let path = folder.join(FILE);
    std::fs::create_dir_all(folder).map_err(|e| Error::file(folder, e))?;
    let text = serde_json::to_string_pretty(known).unwrap_or_default();
    file_gate::replace(&path, &text)
}

/// Every run of the last rung failed.
fn nothing_trained(told: &SearchResult) -> Error {
    let why =
        told.failures.last().map_or(String::new(), |(c, seed, why)| format!("; candidate {c}, seed {seed}: {why}"));
    let value = format!("none of those on the last rung{why}");
    let remedy = "Mend what is told there, and search anew (--force).";
    Error::value("candidates that were trained", value, "one or more", remedy)
}

/// The `n` best candidates of a rung, in their order.
fn best(trials: &[&Trial], n: usize) -> Vec<usize> {
    let mut ranked: Vec<&&Trial> = trials.iter().collect();
    // stable: among equals the first stays first
    ranked.sort_by(|a, b| b.compare(a));
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
        // what failed is no better than what was trained badly
        let bad = [trial(0, &[None, None]), trial(1, &[None, Some((0.0, -9.0))])];
        assert_eq!(best(&bad.iter().collect::<Vec<_>>(), 1), [1]);
        let all: Vec<&Trial> = all.iter().collect();
        assert_eq!((best(&all, 1), best(&all, 2), best(&all, 3)), (vec![3], vec![1, 3], vec![1, 2, 3]));
    }

    /// What a search of four candidates with two seeds and a factor of two tells after two of its three rungs.
    fn sound() -> (Search, serde_json::Value) {
        let own = search(4, 2);
        let trial = |candidate: usize, rung: usize| Trial {
            candidate,
            rung,
            updates: own.updates(candidate, rung),
            scores: vec![Some(Score { success: 0.1 * candidate as f64, share_of_bound: 0.5 }), None],
        };
        let known = Known {
            candidates: own.candidates.iter().map(|(name, c)| (name.clone(), c.to_toml().unwrap())).collect(),
            seeds: own.seeds.clone(),
            factor: own.factor,
            trials: [(0, 0), (1, 0), (2, 0), (3, 0), (2, 1), (3, 1)].map(|(c, rung)| trial(c, rung)).into(),
            failures: vec![(0, 4, "why".into())],
        };
        (own, serde_json::to_value(&known).unwrap())
    }

    #[test]
    fn a_file_that_tells_what_cannot_be_is_refused_with_its_place_and_nothing_is_trained() {
        use serde_json::{Value, json};
        let (own, sound) = sound();
        let folder = tempfile::tempdir().unwrap();
        let write = |value: &Value| std::fs::write(folder.path().join(FILE), value.to_string()).unwrap();
        write(&sound);
        assert!(read_search(folder.path()).is_ok_and(|(search, trials, failures)| {
            (search.candidates.len(), trials.len(), failures.len()) == (4, 6, 1)
        }));
        let forged: Vec<(&str, Value, &str)> = vec![
            ("/failures/0/0", json!(99), "failures[0]"),
            ("/failures/0/1", json!(9), "failures[0]"),
            ("/trials/0/candidate", json!(4), "trials[0]"),
            ("/trials/3/candidate", json!(u64::from(u32::MAX)), "trials[3]"),
            ("/trials/2/candidate", json!(0), "trials[2]: candidate 0 on rung 0 stands there twice"),
            ("/trials/5/candidate", json!(1), "trials of rung 1: candidate 1 did not come to it"),
            ("/trials/4/rung", json!(7), "trials[4]"),
            ("/trials/4/rung", json!(2), "trials[4]: 5 updates, where the rung has 9"),
            ("/trials/1/updates", json!(1), "trials[1]"),
            ("/trials/1/scores", json!([]), "trials[1]: 0 scores for 2 seeds"),
            ("/trials/1/scores", json!([null, null, null]), "trials[1]: 3 scores"),
            ("/trials/1/scores/0/success", json!(2.0), "trials[1]: success 2"),
            ("/trials/1/scores/0/success", json!(null), "success"),
            ("/trials/1/scores/0/share_of_bound", json!("x"), "share_of_bound"),
            ("/trials", json!([sound["trials"][4]]), "trials of rung 1"),
            ("/trials", json!({}), "trials"),
            ("/seeds", json!([]), "seeds of the search"),
            ("/factor", json!(1), "factor of the search"),
            ("/factor", json!(0), "factor of the search"),
            ("/candidates", json!({}), "candidates of the search"),
            ("/candidates", json!({ "a": sound["candidates"]["c0"], "b": sound["candidates"]["c1"] }), "not called c0"),
            ("/candidates/c1", json!("task = 'Nothing'"), "Nothing"),
            ("/candidates/c1", json!("["), "candidate c1"),
            ("/candidates", (0..1001).map(|k| (format!("c{k}"), json!("["))).collect(), "over the limit of 1000"),
        ];
        for (place, value, words) in forged {
            let mut own_file = sound.clone();
            *own_file.pointer_mut(place).unwrap() = value.clone();
            write(&own_file);
            let text = read_search(folder.path()).err().unwrap_or_else(|| panic!("{place} = {value}")).to_string();
            assert!(text.contains(words) && text.contains(FILE), "{place} = {value}: {text}");
            let run = own.run(folder.path(), &Threads::new(1).unwrap(), &|_, _, _| panic!("{place} = {value}"));
            assert!(run.is_err(), "{place} = {value}");
        }
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
        save(&own.known(&parts).unwrap(), &parts).unwrap();
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
        // runs of which nothing tells are nobody's
        std::fs::remove_file(parts.join(FILE)).unwrap();
        for n in [1, 2, 3] {
            let refused =
                search(n, 3).run(&parts, &two, &|_, _, _| panic!("nothing is trained")).unwrap_err().to_string();
            assert!(refused.contains("is a run already and no search.json tells of it"), "{n}: {refused}");
        }
    }

    #[test]
    fn a_search_whose_every_run_fails_has_no_winner() {
        for n in [1, 3] {
            let folder = tempfile::tempdir().unwrap();
            // a file where each run is to have its folder
            for k in 0..n {
                std::fs::create_dir(folder.path().join(format!("c{k}"))).unwrap();
                [3, 4].iter().for_each(|s| std::fs::write(folder.path().join(format!("c{k}/s{s}")), "").unwrap());
            }
            for _ in 0..2 {
                let told = search(n, 3).run(folder.path(), &Threads::new(1).unwrap(), &|_, _, _| ());
                let text = told.unwrap_err().to_string();
                assert!(
                    text.starts_with("candidates that were trained is none of those") && text.contains("seed 4"),
                    "{text}"
                );
            }
        }
    }
}
