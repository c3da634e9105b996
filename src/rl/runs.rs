//! Several runs in one process, side by side: seeds of one, or one of several settings; and what they say together.
//!
//! With at least as many runs as threads each runs on a thread of its own, so that none waits for another; with fewer, they
//! share the threads. The bits of a run are those that it has alone. Their folders are no links: one leads to another run.

use super::config::TrainConfig;
use super::predecessor::predecessor_config;
use super::trainer::{RunProgress, TrainResult, Trainer};
use base::error::Result;
use base::file_gate;
use base::parallel::Threads;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use tasks::{Buffers, Env, EnvConfig};

/// A run to be made, or to go on with.
#[derive(Debug, Clone)]
pub struct Run {
    /// Its settings, with its task.
    pub config: TrainConfig,
    /// Where it is kept.
    pub folder: PathBuf,
    /// Updates after which it pauses, to go on another time.
    pub until: u64,
}

/// Trains runs side by side; `watch` sees every update of each, by its place. One that fails leaves the others alone.
/// Results stand in the order of the runs.
pub fn train(
    runs: &[Run],
    threads: &Threads,
    watch: &(dyn Fn(usize, &RunProgress<'_>) + Sync),
) -> Vec<Result<TrainResult>> {
    let side_by_side = threads.count().min(runs.len()).max(1);
    let each = Threads::new(threads.count() / side_by_side);
    let next = AtomicUsize::new(0);
    let results: Vec<Mutex<Option<Result<TrainResult>>>> = runs.iter().map(|_| Mutex::new(None)).collect();
    std::thread::scope(|scope| {
        for _ in 0..side_by_side {
            scope.spawn(|| {
                loop {
                    let k = next.fetch_add(1, Ordering::Relaxed);
                    let Some(run) = runs.get(k) else { break };
                    let threads = each.as_ref().map_or_else(|_| Threads::default(), Clone::clone);
                    let result = one(run, threads, &mut |progress| watch(k, progress));
                    *results[k].lock().unwrap_or_else(PoisonError::into_inner) = Some(result);
                }
            });
        }
    });
    results.into_iter().filter_map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner)).collect()
}

fn one(run: &Run, threads: Threads, watch: &mut dyn FnMut(&RunProgress<'_>)) -> Result<TrainResult> {
    file_gate::own_folder(&run.folder)?;
    let mut trainer = Trainer::new(&run.config.task, run.config.clone(), threads)?.in_folder(&run.folder, true)?;
    trainer.run_until(run.until, &mut |progress| {
        watch(progress);
        ControlFlow::Continue(())
    })
}

/// What the result of a recipe depends on, as sixteen hexadecimal digits: all settings but the seed, and what task and physics
/// do with them, by the bits of 32 steps of 64 environments under random actions. Processors that fuse multiplications
/// otherwise have other bits. What an algorithm does is not in it.
///
/// # Errors
/// As [`Env::make`].
pub fn fingerprint(config: &TrainConfig) -> Result<String> {
    let mut hash = Sha256::new();
    hash.update(config.text_of_rows()?);
    // a folder that is gone has taught what it could
    if let Ok(Some((_, own))) = predecessor_config(config) {
        hash.update(fingerprint(&own)?);
    }
    let env = EnvConfig { n_env: 64, seed: 5, info: None, ..config.seen_env() };
    let mut env = Env::make(&config.task, &env)?;
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out())?;
    let mut actions = vec![0.0; 64 * env.spec().n_agent * env.spec().action.len()];
    for t in 0..32 {
        env.sample(t, &mut actions);
        env.step(&actions, &mut out.out())?;
        for x in out.observation.iter().chain(&out.central).chain(&out.reward).chain(&out.info) {
            hash.update(x.to_le_bytes());
        }
    }
    Ok(hash.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect())
}

/// A figure of several seeds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SeedSummary {
    /// Its mean.
    pub mean: f64,
    /// The least.
    pub least: f64,
    /// The largest.
    pub largest: f64,
    /// Half the width of the 95 % confidence interval of the mean, t s/√n with Student's t of n − 1 degrees of freedom: where
    /// the mean of many more seeds is to be expected. None for one seed.
    pub half_width: Option<f64>,
}

impl SeedSummary {
    /// Of its values; none of no value.
    pub fn of(values: &[f64]) -> Option<Self> {
        let n = values.len() as f64;
        let (least, largest) = (values.iter().copied().reduce(f64::min)?, values.iter().copied().reduce(f64::max)?);
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let half_width = (values.len() > 1).then(|| student(values.len() - 1) * (variance / n).sqrt());
        Some(Self { mean, least, largest, half_width })
    }
}

/// The 0.975 quantile of Student's t with so many degrees of freedom, to 0.15 %: a table, then the expansion about the
/// normal quantile (Abramowitz and Stegun 1964, 26.7.5).
fn student(degrees: usize) -> f64 {
    const TABLE: [f64; 9] = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262];
    let n = degrees as f64;
    TABLE.get(degrees - 1).copied().unwrap_or(1.959_964 + 2.372 / n + 2.823 / (n * n))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fingerprint_is_of_settings_and_task_and_not_of_the_seed() {
        let of = |text: &str| fingerprint(&TrainConfig::for_task("Hover", None, Some((text, "t"))).unwrap()).unwrap();
        let usual = of("");
        assert_eq!((usual.len(), of("seed = 3")), (16, usual.clone()));
        assert!([of("apg.horizon = 3"), of("env.task.max_distance = 3.0")].iter().all(|other| *other != usual));
    }

    #[test]
    fn runs_side_by_side_have_the_bits_of_runs_alone_and_one_that_fails_leaves_the_others() {
        let folder = tempfile::tempdir().unwrap();
        let text = "evaluate = { every = 0, envs = 8, seed = 99 }\n[apg]\nn_env = 8\nshard = 4\nhorizon = 4\nupdates = 5\n\
                    network.hidden = [8]\n[env.task]\nhorizon = 10";
        let config = TrainConfig::for_task("Hover", None, Some((text, "tiny"))).unwrap();
        let run = |seed: u64| Run {
            config: TrainConfig { seed, ..config.clone() },
            folder: folder.path().join(format!("s{seed}")),
            until: u64::MAX,
        };
        // held-out starts must have another seed
        let all = [run(1), run(99), run(2)];
        let told = train(&all, &Threads::new(2).unwrap(), &|_, _| ());
        assert!(told[1].as_ref().is_err_and(|e| e.to_string().contains("evaluate.seed")));
        for (run, told) in [(&all[0], &told[0]), (&all[2], &told[2])] {
            let mut alone = Trainer::new("Hover", run.config.clone(), Threads::new(2).unwrap()).unwrap();
            let alone = alone.run(&mut |_| ControlFlow::Continue(())).unwrap();
            let told = told.as_ref().unwrap();
            assert_eq!((told.policy.parameters(), &told.evaluation), (alone.policy.parameters(), &alone.evaluation));
        }
    }

    #[test]
    fn an_interval_is_that_of_students_t() {
        let told = SeedSummary::of(&[1.0, 2.0, 3.0]).unwrap();
        assert_eq!((told.mean, told.least, told.largest), (2.0, 1.0, 3.0));
        assert!((told.half_width.unwrap() - 4.303 / 3.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(SeedSummary::of(&[0.5]).unwrap().half_width, None);
        assert_eq!(SeedSummary::of(&[]), None);
        // tabulated: 2.228 and 2.042
        assert!((student(10) - 2.228).abs() < 0.003 && (student(30) - 2.042).abs() < 0.001);
    }
}
