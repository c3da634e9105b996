//! `omnidrones eval`: a trained policy from held-out starts, as figures, tables and files.

use super::arguments;
use super::environment::EnvArguments;
use super::episodes::{Flown, SUCCESS, check_horizon};
use super::over_seeds;
use super::rollout_files::{EpisodeArguments, Told};
use crate::prelude::*;
use omnidrones::parallel::Threads;
use omnidrones::rl::policy_io::{SavedPolicy, load_policy};
use omnidrones::rl::refine::{RefineConfig, Refined, refine};
use omnidrones::rl::{Starts, eval_env};
use omnidrones::tasks::registry;
use omnidrones::tasks::{Buffers, Env, EnvConfig, EvaluationStep};

/// What the command is for.
pub const ABOUT: &str = "\
Fly a trained policy, one episode of every environment from starts that training never saw. Prints return, errors, \
success, crashes by reason, and the reward by its terms; draws the error of all episodes over time. Options change the \
environments: another vehicle, heavier ones, longer episodes; the policy stays as it is.";

const EXAMPLES: &str = "\
Examples:
  omnidrones eval runs/Hover-apg-s0                           the newest checkpoint of a run
  omnidrones eval runs/Hover-apg-s0/checkpoints/000000800     a certain one
  omnidrones eval runs/Hover-apg-s0 --envs 4096 --seed 5      more episodes, other starts
  omnidrones eval runs/Hover-apg-s0 --vehicle crazyflie       on a drone that it has not met
  omnidrones eval runs/Hover-apg-s0 --randomise mass:0.7:1.3  on heavier and lighter ones
  omnidrones eval runs/Hover-apg-s0 --refine 100 --envs 64    beside the best flights of these episodes
  omnidrones eval runs/Hover-apg-s0 --csv                     every step and every episode as CSV
  omnidrones eval runs/Hover-apg-s0 --replay                  the first episodes in space, for a browser

A policy flies environments that show and take the same numbers: other control levels, time steps or numbers of rotors \
are refused. Without options the environments, their number and their starts are those that training evaluated on.";

const FILES: &str = "\
Files in --out: eval (.png or .svg), with --csv steps.csv, episodes.csv and trajectories.csv, with --npz trajectories.npz, with --replay replay.html, as of 'omnidrones rollout'.

JSON: SI units; shares from 0 to 1; null where a number does not exist.

Exit codes: 0 flown; 2 unusable input or arguments.";

/// Arguments of `eval`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = format!("{EXAMPLES}\n\n{SUCCESS}\n\n{FILES}"))]
#[command(mut_arg("envs", |envs| envs.help("Environments, one episode each [default: as in training, 1024]")))]
#[command(mut_arg("out", |out| arguments::out(out, "Folder for what is written [default: RUN/eval]")))]
pub struct Arguments {
    /// Folder of a run, or of one of its checkpoints
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Search N times for more return along each flight, with the policy in the loop and all of the episode known: what is in reach
    #[arg(long, value_name = "N")]
    refine: Option<usize>,
    #[command(flatten)]
    episodes: EpisodeArguments,
}

/// Flies.
pub fn run(a: &Arguments) -> Result<Report> {
    let (own, threads) = (&a.episodes, a.episodes.threads.threads()?);
    let ready = || Ready::new(&a.run, &own.environment, own.envs, &threads);
    let mut again = a.refine.map(|n| Ok((n, ready()?))).transpose()?;
    let mut ready = ready()?;
    let (horizon, by) = (ready.env.spec().horizon, ready.saved.manifest.algorithm.clone());
    let told = Told { command: "eval", by: &by, usual: a.run.join("eval") };
    // before any folder is made
    let refined = again.as_mut().map(|(n, ready)| ready.refine(*n, &threads, own.output.json)).transpose()?;
    told.of(own, horizon, |kept, watch| Ok(Flown { refined, ..ready.fly(kept, watch)? }))
}

/// Most runs that an error names.
const MAX_NAMED: usize = 5;

/// The refusal of a folder that is no run with the runs there are; any other error as it is.
fn with_runs(error: Error) -> Error {
    match error {
        Error::NoRun { path, lacks, remedy } => {
            let remedy = runs_within(&path).unwrap_or_else(|| format!("{remedy} {}", known_runs()));
            Error::NoRun { path, lacks, remedy }
        }
        other => other,
    }
}

/// The runs in a folder of several, of seeds or of a search, with the best where the folder tells it.
fn runs_within(folder: &Path) -> Option<String> {
    let mut own = files::runs(folder);
    own.sort_by_key(|path| {
        path.components().map(|part| files::natural(&part.as_os_str().to_string_lossy())).collect::<Vec<_>>()
    });
    let named: Vec<String> = own.iter().take(MAX_NAMED).map(|path| path.display().to_string()).collect();
    let more = if own.len() > named.len() { format!(", … ({} in all)", own.len()) } else { String::new() };
    let best = over_seeds::best_run(folder).filter(|best| own.contains(best));
    let best = best.map_or(String::new(), |best| format!(" The best is {}.", best.display()));
    (!own.is_empty()).then(|| format!("It is a folder of several: name one of {}{more}.{best}", named.join(", ")))
}

fn known_runs() -> String {
    let runs = files::runs(Path::new("runs"));
    let named: Vec<String> = runs.iter().take(MAX_NAMED).map(|path| path.display().to_string()).collect();
    match named.len() {
        0 => "There are none under runs/.".into(),
        n if n < runs.len() => format!("There are {}, … ({} in all).", named.join(", "), runs.len()),
        _ => format!("There are {}.", named.join(", ")),
    }
}

/// A policy and environments that it can fly.
pub struct Ready {
    pub saved: SavedPolicy,
    pub env: Env,
}

impl Ready {
    /// The policy of a run at the starts of its evaluations, but for what options change.
    pub fn new(run: &Path, options: &EnvArguments, envs: Option<usize>, threads: &Threads) -> Result<Self> {
        let mut saved = load_policy(run).map_err(with_runs)?;
        let usual = EnvConfig {
            n_env: saved.config.evaluate.envs,
            seed: saved.config.evaluate.seed,
            ..saved.config.seen_env()
        };
        let config = options.config(&usual, registry::by_name(&saved.manifest.task).ok())?;
        saved.check(&config)?;
        let starts = Starts { n_env: envs.unwrap_or(config.n_env), seed: config.seed };
        let env = eval_env(&saved.policy, &saved.manifest.task, &config, starts, threads)?;
        check_horizon(&env)?;
        saved.policy.set_threads(threads.clone());
        Ok(Self { saved, env })
    }

    /// One episode of every environment, of which the first `kept` are kept step by step; `watch` sees every step.
    pub fn fly(&mut self, kept: usize, watch: &mut dyn FnMut(&EvaluationStep<'_>)) -> Result<Flown> {
        let (manifest, policy) = (&self.saved.manifest, &mut self.saved.policy);
        policy.reset();
        let act = &mut |_: &Env, out: &Buffers, actions: &mut [f32]| policy.act(&out.observation, actions);
        let controller = format!("a policy ({}, update {})", manifest.algorithm, manifest.update);
        let flown = Flown::of(&mut self.env, act, controller, kept, watch)?;
        let unflown =
            self.saved.skipped.first().map(|first| {
                format!("an older checkpoint flew: {} is damaged ({})", first.folder.display(), first.why)
            });
        Ok(Flown { unflown, ..flown })
    }

    /// What more the episodes held, by `iterations` steps up the gradient of the return.
    fn refine(&mut self, iterations: usize, threads: &Threads, quiet: bool) -> Result<Refined> {
        let bar = progress::bar(iterations as u64 + 1, "refining", quiet);
        let config = RefineConfig { iterations, ..RefineConfig::default() };
        let told = refine(&self.saved.policy, &mut self.env, threads, &config, &mut |n| bar.set_position(n as u64));
        bar.finish_and_clear();
        told
    }
}
