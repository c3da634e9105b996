//! Our controller from the starts of a run, and figures of evaluations beside each other.

use crate::prelude::*;
use omnidrones::controllers::cascade::Level;
use omnidrones::parallel::Threads;
use omnidrones::rl::TrainConfig;
use omnidrones::tasks::registry::TaskEntry;
use omnidrones::tasks::{Autoreset, Baseline, EnvConfig, Evaluation, Metric, Spec, evaluate};

/// Most episodes that a controller flies for comparison: it is slower than a policy.
pub const MAX_COMPARED: usize = 256;

/// A figure of an evaluation, how it is printed, and by which factor its interval is printed larger.
pub type Figure = (fn(&Evaluation) -> f64, fn(f64) -> String, f64);

/// What tables tell of evaluations: success, crashed, final error, mean error, change of commands, return, share of bound.
pub const FIGURES: [Figure; 7] = [
    (|e| e.success, percent, 100.0),
    (|e| e.crashed, percent, 100.0),
    (|e| e.final_error, |x| short(x, 3), 1.0),
    (|e| e.mean_error, |x| short(x, 3), 1.0),
    (Evaluation::command_change, |x| if x.is_nan() { "–".into() } else { short(x, 2) }, 1.0),
    (|e| e.return_mean, |x| short(x, 4), 1.0),
    (|e| e.share_of_bound, percent, 100.0),
];

/// What an environment of the run is like, and what the task's error is.
pub fn spec(entry: &TaskEntry, config: &TrainConfig) -> Result<(Spec, Metric)> {
    let env = entry.env(&EnvConfig { n_env: 1, ..config.seen_env() })?;
    let error = env.task_spec().metrics.first().cloned();
    Ok((env.spec().clone(), error.unwrap_or(Metric { name: "error".into(), unit: "–".into() })))
}

/// The environments of a run's evaluations for one of our controllers, which acts on the rotors. One that stands beside a policy of
/// velocities, say, which is asked a few times a second, is asked as often as a rotor must be, for as long.
pub fn for_controller(entry: &TaskEntry, config: &TrainConfig) -> EnvConfig {
    let mut env = EnvConfig {
        n_env: config.evaluate.envs.min(MAX_COMPARED),
        seed: config.evaluate.seed,
        first_environment: 0,
        autoreset: Autoreset::Disabled,
        control: Level::Rotor,
        residual: 0.0,
        actions: Default::default(),
        observation: Vec::new(),
        ..config.env.clone().whole_episodes()
    };
    let usual = EnvConfig::default();
    if config.env.control != Level::Rotor && env.dt > usual.dt {
        if let Ok(made) = entry.env(&EnvConfig { n_env: 1, ..env.clone() }) {
            let steps = (made.spec().horizon as f64 * env.dt / usual.dt).round();
            env.task.insert("horizon".into(), (steps as i64).into());
        }
        (env.dt, env.control_rate) = (usual.dt, usual.control_rate);
    }
    env
}

/// Our controller from the first of the same starts; none if there is no controller for the task.
pub fn compare(entry: &TaskEntry, config: &TrainConfig, threads: &Threads) -> Option<(String, Evaluation)> {
    let env = for_controller(entry, config);
    let slower = config.env.dt / env.dt;
    let mut env = entry.env(&env).ok()?;
    env.set_threads(threads.clone());
    let mut own = Baseline::new(&env).ok()?;
    let mut name = own.name().to_string();
    if slower > 1.0 {
        name += &format!(", every {} ms", short(1e3 * env.spec().dt, 3));
    }
    let mut told = evaluate(&mut env, &mut own.policy(), &mut |_| {}).ok()?;
    if slower > 1.0 {
        // sums over steps, as over those of the policy beside it
        let sums = [&mut told.return_mean, &mut told.return_std, &mut told.length];
        sums.into_iter().chain(&mut told.terms).for_each(|sum| *sum /= slower);
    }
    Some((name, told))
}

/// Who flew how well, a row each; errors in this unit.
pub fn results<'a>(unit: &str, flown: impl IntoIterator<Item = &'a (String, Evaluation)>) -> Table {
    Table::new(&format!(
        "flown by | >success | >crashed | >final error [{unit}] | >mean error [{unit}] | >Δ command | >return | >share of bound | >length"
    )).filled(flown.into_iter().map(|(name, e)| {
        let mut figures = FIGURES.map(|(of, show, _)| show(of(e)));
        figures[1] = share_of(e.crashed, e.n_episode);
[name.clone()].into_iter().chain(figures).chain([short(e.length, 4)])
}))
}
