//! `omnidrones rollout`: the episodes of a task under a controller, as figures, tables and files.

use super::arguments;
use super::episodes::{Flown, check_horizon};
use super::rollout_all;
use super::rollout_files::{EpisodeArguments, Told};
use crate::prelude::*;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use omnidrones::controllers::optimal::MpcSettings;
use omnidrones::controllers::registry::REGISTRY;
use omnidrones::parallel::Threads;
use omnidrones::rl::parts::TrainingObjective;
use omnidrones::rl::planner::{Planner, PlannerConfig};
use omnidrones::tasks::registry::{self, TaskEntry};
use omnidrones::tasks::{Autoreset, Baseline, Buffers, Env, EnvConfig, EvaluationStep};

/// What the command is for.
pub const ABOUT: &str = "\
Fly one episode of every environment of a task, from fixed starts, with one of our controllers, with random actions or by plans: \
what a learner has to beat. Prints return, errors, success, crashes by reason, and the reward by its terms; draws the \
error of all episodes over time.";

const EXAMPLES: &str = "\
Examples:
  omnidrones rollout Hover                             256 episodes under our controller
  omnidrones rollout Hover --controller random         under random actions
  omnidrones rollout Hover --controller planner --envs 8   by plans, which no policy can know
  omnidrones rollout PayloadHover --controller mpc     by another controller than the usual one
  omnidrones rollout Track --envs 1024 --seed 7        more episodes, other starts
  omnidrones rollout Track --csv --out track           every step and every episode as CSV
  omnidrones rollout Track --npz --trajectories 256    all its episodes for NumPy: states, observations, actions, rewards
  omnidrones rollout DragonHover --replay              its first episodes to turn around and look at, in a browser
  omnidrones rollout Hover --vehicle crazyflie         with another drone
  omnidrones rollout Hover --randomise mass:0.7:1.3    of another mass in every episode
  omnidrones rollout --all                             one line per task

Controllers: default is the cascade (position, velocity, attitude, rate) for a drone alone, and for systems of bodies the \
controller that 'omnidrones fly' takes; it sees the true state and acts on the rotors. Names of the table of controllers, as \
lqr or mpc, put that one in its place, where it is made for what flies; free drones of a team keep their cascades. One \
flies each environment, all of them at once on --threads. random draws every command \
uniformly in every step. planner plans the next two seconds through the simulator itself, by exact gradients, with every \
hidden number of the episode: what it loses may be beyond any policy. It takes seconds for a few episodes of one drone, and \
minutes to hours for many or for teams (--envs). \
What falls over by itself wants shorter plans and larger steps: --plan-steps 64 --plan-rate 0.02.

The bound is the best reward of a step times the steps of an episode: nothing reaches it, for the start counts too.

Files in --out: rollout (.png or .svg; spreads as long as a tenth of the episodes goes on), and with --csv steps.csv (one line per step: mean, 10 %, median, 90 % over the \
episodes that go on), episodes.csv (one line per episode) and trajectories.csv, with --npz trajectories.npz, with --replay replay.html. Of \
--all: tasks (.png or .svg).

Trajectories are the first episodes (--trajectories) step by step: state and observation before a step, the action, reward and \
ends that came of it; in the CSV one more line behind each episode for what it ended in, in the NPZ final_state and \
final_observation. Units stand in the header, in the NPZ in state_columns and its like.

JSON: SI units; shares from 0 to 1; null where a number does not exist.

Exit codes: 0 flown; 2 unusable input or arguments.";

/// Most environments: each has a controller of its own.
const MAX_EPISODES: usize = 100_000;
/// Arguments of `rollout`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("envs", |envs| envs.help("Environments, one episode each [default: 256; 32 of each task with --all]")))]
#[command(mut_arg("csv", |csv| csv.conflicts_with("all")))]
#[command(mut_arg("npz", |npz| npz.conflicts_with("all")))]
#[command(mut_arg("mcap", |mcap| mcap.conflicts_with("all")))]
#[command(mut_arg("replay", |replay| replay.conflicts_with("all")))]
#[command(mut_arg("out", |out| arguments::out(out, "Folder for what is written [default: out/TASK, out/tasks with --all]")))]
pub struct Arguments {
    /// A task ('omnidrones tasks')
    #[arg(value_name = "TASK", required_unless_present = "all", conflicts_with = "all")]
    task: Option<String>,
    /// Every task that the controller can fly, one line each
    #[arg(long)]
    all: bool,
    /// Who commands it
    #[arg(long, value_name = "NAME", default_value = "default", value_parser = controller_names())]
    pub(super) controller: ControllerName,
    /// How --controller mpc plans: a file of its settings, as of 'omnidrones fly --mpc'
    #[arg(long, value_name = "FILE.toml", conflicts_with = "all")]
    mpc: Option<PathBuf>,
    #[command(flatten)]
    pub(super) plan: PlanArguments,
    #[command(flatten)]
    pub(super) episodes: EpisodeArguments,
}

/// Names of controllers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ControllerName {
    /// The controller of this crate that suits what flies
    Default,
    /// Every command drawn uniformly in every step
    Random,
    /// Plans by the exact gradient of the simulator, which knows every number of the episode
    Planner,
    /// Of the library's table
    Named(&'static str),
}

/// Those that are no controllers of the table, each with what it is.
const OWN_NAMES: [(ControllerName, &str); 3] = [
    (ControllerName::Default, "The controller of this crate that suits what flies"),
    (ControllerName::Random, "Every command drawn uniformly in every step"),
    (ControllerName::Planner, "Plans by the exact gradient of the simulator, which knows every number of the episode"),
];

/// What --controller takes, each with what it is.
fn controller_names() -> impl TypedValueParser<Value = ControllerName> {
    let all = OWN_NAMES.into_iter().chain(REGISTRY.iter().map(|e| (ControllerName::Named(e.name), e.flies)));
    PossibleValuesParser::new(all.map(|(own, what)| PossibleValue::new(own.name()).help(what))).try_map(|given| {
        let own = OWN_NAMES.into_iter().map(|(own, _)| own).find(|own| own.name() == given);
        let of_table = || REGISTRY.iter().find(|e| e.name == given).map(|e| ControllerName::Named(e.name));
        own.or_else(of_table).ok_or("it is not known")
    })
}

impl ControllerName {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Random => "random",
            Self::Planner => "planner",
            Self::Named(name) => name,
        }
    }
}

/// How the planner plans.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct PlanArguments {
    /// Steps that the planner looks ahead [default: 128]
    #[arg(long, value_name = "N", help_heading = "Planner")]
    plan_steps: Option<usize>,
    /// Steps down the gradient before every action, and ten times as many before the first [default: 8]
    #[arg(long, value_name = "N", help_heading = "Planner")]
    plan_iterations: Option<usize>,
    /// Size of such a step, of actions between -1 and 1 [default: 0.005]
    #[arg(long, value_name = "X", help_heading = "Planner")]
    plan_rate: Option<f64>,
    /// Steps that the last one of a plan stands for [default: 20]
    #[arg(long, value_name = "N", help_heading = "Planner")]
    plan_beyond: Option<f32>,
    /// Plan for the reward, not for the training loss
    #[arg(long, help_heading = "Planner")]
    plan_reward: bool,
}

impl PlanArguments {
    /// What they come to, by their own names.
    pub(super) fn config(&self) -> Result<PlannerConfig> {
        let usual = PlannerConfig::default();
        let iterations = self.plan_iterations.unwrap_or(usual.iterations);
        for (name, n, most) in [("--plan-steps", self.plan_steps, 65536), ("--plan-iterations", Some(iterations), 6553)]
        {
            if let Some(n) = n.filter(|n| !(1..=most).contains(n)) {
                return Err(Error::limit(name, n, format!("1 to {most}"), "128 and 8 are usual."));
            }
        }
        for (name, x) in [("--plan-rate", self.plan_rate), ("--plan-beyond", self.plan_beyond.map(f64::from))] {
            if let Some(x) = x.filter(|x| !(x.is_finite() && *x > 0.0)) {
                return Err(Error::value(name, x, "finite and > 0", "0.005 and 20 are usual."));
            }
        }
        Ok(PlannerConfig {
            horizon: self.plan_steps.unwrap_or(usual.horizon),
            iterations,
            first_iterations: iterations.saturating_mul(10),
            learning_rate: self.plan_rate.unwrap_or(usual.learning_rate),
            beyond: self.plan_beyond.unwrap_or(usual.beyond),
            objective: if self.plan_reward { TrainingObjective::Reward } else { TrainingObjective::Loss },
            ..usual
        })
    }

    /// The first that was given.
    fn given(&self) -> Option<&'static str> {
        let all = [
            (self.plan_steps.is_some(), "--plan-steps"),
            (self.plan_iterations.is_some(), "--plan-iterations"),
            (self.plan_rate.is_some(), "--plan-rate"),
            (self.plan_beyond.is_some(), "--plan-beyond"),
            (self.plan_reward, "--plan-reward"),
        ];
        all.into_iter().find(|(given, _)| *given).map(|(_, name)| name)
    }
}

/// Flies.
pub fn run(a: &Arguments) -> Result<Report> {
    let usual = EnvConfig { n_env: if a.all { 32 } else { 256 }, ..EnvConfig::default() };
    let entry = a.task.as_deref().map(registry::by_name).transpose()?;
    let config = a.episodes.environment.config(&usual, entry)?;
    let n_env = a.episodes.envs.unwrap_or(config.n_env);
    let config = EnvConfig { autoreset: Autoreset::Disabled, n_env, ..config.whole_episodes() };
    if !(1..=MAX_EPISODES).contains(&config.n_env) {
        let limit = format!("1 to {MAX_EPISODES}");
        return Err(Error::limit("n_env", config.n_env, limit, "256 episodes tell a mean return to a few percent."));
    }
    let threads = a.episodes.threads.threads()?;
    match entry {
        Some(entry) => one(a, entry, &config, &threads),
        None => rollout_all::run(a, &config, &threads),
    }
}

/// Draws of a random policy: one number per step, apart for every seed.
fn draw(seed: u64, step: usize) -> u64 {
    seed.rotate_left(32) ^ step as u64
}

/// Environments with who flies them.
pub(super) struct Ready {
    env: Env,
    pilot: Pilot,
}

enum Pilot {
    Baseline(Box<Own>),
    Random,
    Planner(Box<Planner>),
}

/// Our controllers.
struct Own {
    flying: Baseline,
    named: Option<&'static str>,
    mpc: Option<MpcSettings>,
}

impl Own {
    fn new(env: &Env, named: Option<&'static str>, mpc: Option<MpcSettings>) -> Result<Self> {
        let flying = match (named, &mpc) {
            (Some(name), Some(settings)) => Baseline::with_plans(env, name, settings)?,
            (Some(name), _) => Baseline::with_controller(env, name)?,
            (None, _) => Baseline::new(env)?,
        };
        Ok(Self { flying, named, mpc })
    }
}

impl Ready {
    pub(super) fn new(
        entry: &TaskEntry,
        config: &EnvConfig,
        threads: &Threads,
        (controller, plan, mpc): (ControllerName, &PlanArguments, Option<MpcSettings>),
    ) -> Result<Self> {
        if let Some(name) = plan.given().filter(|_| controller != ControllerName::Planner) {
            let remedy = "Leave it out, or add --controller planner.";
            return Err(Error::value(name, "given", "of --controller planner alone", remedy));
        }
        let mut env = entry.env(config)?;
        check_horizon(&env)?;
        env.set_threads(threads.clone());
        let pilot = match controller {
            ControllerName::Default => Pilot::Baseline(Box::new(Own::new(&env, None, None)?)),
            ControllerName::Named(name) => Pilot::Baseline(Box::new(Own::new(&env, Some(name), mpc)?)),
            ControllerName::Random => Pilot::Random,
            ControllerName::Planner => {
                let mut twin = entry.env(config)?;
                twin.set_threads(threads.clone());
                Pilot::Planner(Box::new(Planner::new(twin, plan.config()?)?))
            }
        };
        Ok(Self { env, pilot })
    }

    /// One episode of every environment, of which the first `kept` are kept step by step; `watch` sees every step.
    pub(super) fn fly(&mut self, kept: usize, watch: &mut dyn FnMut(&EvaluationStep<'_>)) -> Result<Flown> {
        let seed = self.env.spec().config.seed;
        let env = &mut self.env;
        match &mut self.pilot {
            Pilot::Baseline(own) => {
                // it learns the numbers of an episode once
                **own = Own::new(env, own.named, own.mpc.take())?;
                let own = &mut own.flying;
                let name = own.name().to_string();
                let flown = Flown::of(env, &mut own.policy(), name, kept, watch)?;
                let unflown = own.failures().first().map(|(_, first)| {
                    let n = own.failures().len();
                    format!("{n} of the episodes could not be flown, the first because: {first}")
                });
                Ok(Flown { unflown, ..flown })
            }
            Pilot::Random => {
                let mut steps = 0;
                let mut random = |env: &Env, _: &Buffers, actions: &mut [f32]| {
                    env.sample(draw(seed, steps), actions);
                    steps += 1;
                    Ok(())
                };
                Flown::of(env, &mut random, "random", kept, watch)
            }
            Pilot::Planner(own) => {
                let mut plan = |env: &Env, _: &Buffers, actions: &mut [f32]| own.act(env, actions);
                let flown = Flown::of(env, &mut plan, "planner", kept, watch)?;
                Ok(Flown { plan: Some(own.config().clone()), ..flown })
            }
        }
    }
}

fn one(a: &Arguments, entry: &TaskEntry, config: &EnvConfig, threads: &Threads) -> Result<Report> {
    // before any folder is made
    let mpc = arguments::mpc_settings(a.mpc.as_deref(), a.controller.name())?;
    let mut ready = Ready::new(entry, config, threads, (a.controller, &a.plan, mpc))?;
    let horizon = ready.env.spec().horizon;
    let told = Told { command: "rollout", by: a.controller.name(), usual: Path::new("out").join(entry.name) };
    told.of(&a.episodes, horizon, |kept, watch| ready.fly(kept, watch))
}
