//! `omnidrones rollout`: the episodes of a task under a controller, as figures, tables and files.

use super::arguments::{self, OutputArguments, ThreadArguments};
use super::environment::EnvArguments;
use super::page::{Fact, Page, duration, percent, share_of, short};
use super::replay::{SHOWN, Seen};
use super::rollout_files::{self as out, LINES};
use super::table::Table;
use super::trajectories::Trajectories;
use super::{Report, files, progress, rollout_all, tasks};
use clap::ValueEnum;
use omnidrones::error::{Error, Result};
use omnidrones::parallel::Threads;
use omnidrones::rl::parts::Objective;
use omnidrones::rl::planner::{Planner, PlannerConfig};
use omnidrones::rl::refine::Refined;
use omnidrones::tasks::registry::{self, Entry};
use omnidrones::tasks::{
    Act, Autoreset, Baseline, Buffers, Env, EnvConfig, Evaluation, Record, Spec, Spread, Watched, evaluate,
};
use omnidrones_viewer::page;
use serde_json::{Value, json};
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::time::Instant;

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
  omnidrones rollout Track --envs 1024 --seed 7        more episodes, other starts
  omnidrones rollout Track --csv --out track           every step and every episode as CSV
  omnidrones rollout Track --npz --trajectories 256    all its episodes for NumPy: states, observations, actions, rewards
  omnidrones rollout DragonHover --replay              its first episodes to turn around and look at, in a browser
  omnidrones rollout Hover --vehicle crazyflie         with another drone
  omnidrones rollout Hover --randomise mass:0.7:1.3    of another mass in every episode
  omnidrones rollout --all                             one line per task

Controllers: default is the cascade (position, velocity, attitude, rate) for a drone alone, and for systems of bodies the \
controller that 'omnidrones fly' takes; it sees the true state and acts on the rotors. random draws every command \
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
/// Longest episode: each step is kept.
const MAX_STEPS: usize = 100_000;

/// Arguments of `rollout`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("envs", |envs| envs.help("Environments, one episode each [default: 256; 32 of each task with --all]")))]
#[command(mut_arg("csv", |csv| csv.conflicts_with("all")))]
#[command(mut_arg("npz", |npz| npz.conflicts_with("all")))]
#[cfg_attr(feature = "mcap", command(mut_arg("mcap", |mcap| mcap.conflicts_with("all"))))]
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
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub(super) controller: ControllerName,
    #[command(flatten)]
    pub(super) plan: PlanArguments,
    #[command(flatten)]
    pub(super) episodes: EpisodeArguments,
}

/// Which episodes are flown, and where they are told.
#[derive(Debug, clap::Args)]
pub struct EpisodeArguments {
    /// Environments, one episode each
    #[arg(long, value_name = "N")]
    pub envs: Option<usize>,
    #[command(flatten)]
    pub threads: ThreadArguments,
    #[command(flatten)]
    pub environment: EnvArguments,
    #[command(flatten)]
    pub output: OutputArguments,
    /// Write every step and every episode as CSV, and the first episodes step by step
    #[arg(long, help_heading = "Output")]
    pub csv: bool,
    /// Write the first episodes step by step for NumPy: states, observations, actions, rewards
    #[arg(long, help_heading = "Output")]
    pub npz: bool,
    /// Write the first episodes for Foxglove and rerun
    #[cfg(feature = "mcap")]
    #[arg(long, help_heading = "Output")]
    pub mcap: bool,
    /// How many episodes --csv, --npz and --mcap keep step by step
    #[arg(long, value_name = "N", default_value_t = 16, help_heading = "Output")]
    pub trajectories: usize,
    /// Write replay.html: the first 4 episodes in space, a page for any browser
    #[arg(long, help_heading = "Output")]
    pub replay: bool,
}

impl EpisodeArguments {
    /// Whether a log for Foxglove and rerun is wanted.
    fn mcap(&self) -> bool {
        #[cfg(feature = "mcap")]
        return self.mcap;
        #[cfg(not(feature = "mcap"))]
        return false;
    }
}

/// Names of controllers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ControllerName {
    /// The controller of this crate that suits what flies
    Default,
    /// Every command drawn uniformly in every step
    Random,
    /// Plans by the exact gradient of the simulator, which knows every number of the episode
    Planner,
}

impl ControllerName {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Random => "random",
            Self::Planner => "planner",
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
            objective: if self.plan_reward { Objective::Reward } else { Objective::Loss },
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

/// What a success is, for the help of commands that tell its share.
pub const SUCCESS: &str = "\
Success is the share of episodes that were not terminated (crashed) and met what the task asks: in the last step an \
error within its limit, 0.1 m of position in Hover, and where the task asks for an attitude or heading, that within 18°; \
along a path an error within its limit through the last 2 s; in PayloadHover the error at the end of the longest time \
without a push; the FlyThrough tasks, Forest, Pinball and Race ask once in the episode, OverFlyThrough and \
TransportFlyThrough with all drones beyond x = 0.05 m. The page names the rule, and 'omnidrones tasks TASK' too.";

/// What a success is, as a line below a table.
pub fn success(spec: &Spec) -> String {
    format!("  Success, not crashed: {}.", spec.success.text())
}

/// What flew, and how well.
pub struct Flown {
    pub record: Record,
    /// `cascade`, `random`, `planner`.
    pub controller: String,
    pub evaluation: Evaluation,
    /// Step by step, of every command of one agent.
    pub commands: Vec<Vec<Spread>>,
    /// The first episodes, where they were to be kept.
    pub trajectories: Trajectories,
    /// How many episodes no controller could be made for, and why.
    pub(super) unflown: Option<String>,
    /// How the planner planned, where it did.
    pub(super) plan: Option<PlannerConfig>,
    /// What more the episodes held, where that was asked for.
    pub(super) refined: Option<Refined>,
    /// By how much the vehicle leans in hover, rad.
    pub(super) lean: f64,
    pub(super) wall_time: f64,
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

/// Watches what is commanded: the actions of a step are gone when it is over. Keeps the first episodes step by step.
pub struct Commands {
    n_command: usize,
    given: RefCell<Vec<f32>>,
    steps: RefCell<Vec<Vec<Spread>>>,
    kept: RefCell<Trajectories>,
}

impl Commands {
    /// Which keeps so many episodes.
    pub fn new(env: &Env, kept: usize) -> Result<Self> {
        let n_command = env.spec().action.len();
        let kept = RefCell::new(Trajectories::new(env, kept)?);
        Ok(Self { n_command, given: RefCell::default(), steps: RefCell::default(), kept })
    }

    /// The policy, watched.
    pub fn of<'a>(&'a self, policy: &'a mut Act<'_>) -> impl FnMut(&Env, &Buffers, &mut [f32]) -> Result<()> + 'a {
        move |env, out, actions| {
            policy(env, out, actions)?;
            let mut given = self.given.borrow_mut();
            given.clear();
            given.extend_from_slice(actions);
            self.kept.borrow_mut().before(env, out, actions);
            Ok(())
        }
    }

    /// Takes a step in: its commands over all agents whose episode it belonged to.
    pub fn see(&self, watched: &Watched<'_>) {
        self.kept.borrow_mut().after(watched);
        let given = self.given.borrow();
        let agents = given.chunks_exact(self.n_command.max(1));
        let each = (agents.len() / watched.flying.len().max(1)).max(1);
        let flying: Vec<(usize, &[f32])> = agents.enumerate().filter(|(row, _)| watched.flying[row / each]).collect();
        let spread = |k: usize| {
            let moves = flying.iter().filter(|(row, _)| k < watched.env.spec().n_action_of(row % each));
            Spread::of(&mut moves.map(|(_, a)| a[k]).collect::<Vec<f32>>())
        };
        self.steps.borrow_mut().push((0..self.n_command).map(spread).collect());
    }

    /// Commands step by step, and the episodes that were kept.
    pub fn told(self) -> Result<(Vec<Vec<Spread>>, Trajectories)> {
        Ok((self.steps.into_inner(), self.kept.into_inner().checked()?))
    }
}

/// Draws of a random policy: one number per step, apart for every seed.
fn draw(seed: u64, step: usize) -> u64 {
    seed.rotate_left(32) ^ step as u64
}

/// Whether every step of an episode can be kept.
pub(super) fn check_horizon(env: &Env) -> Result<()> {
    let horizon = env.spec().horizon;
    if horizon <= MAX_STEPS {
        return Ok(());
    }
    let limit = format!("1 to {MAX_STEPS} steps");
    Err(Error::limit("horizon", horizon, limit, "Every step is recorded: fly shorter ones."))
}

/// Environments with who flies them.
pub(super) struct Ready {
    env: Env,
    pilot: Pilot,
}

enum Pilot {
    Baseline(Baseline),
    Random,
    Planner(Box<Planner>),
}

impl Ready {
    pub(super) fn new(
        entry: &Entry,
        config: &EnvConfig,
        threads: &Threads,
        (controller, plan): (ControllerName, &PlanArguments),
    ) -> Result<Self> {
        if let Some(name) = plan.given().filter(|_| controller != ControllerName::Planner) {
            let remedy = "Leave it out, or add --controller planner.";
            return Err(Error::value(name, "given", "of --controller planner alone", remedy));
        }
        let mut env = entry.env(config)?;
        check_horizon(&env)?;
        env.set_threads(threads.clone());
        let pilot = match controller {
            ControllerName::Default => Pilot::Baseline(Baseline::new(&env)?),
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
    pub(super) fn fly(&mut self, kept: usize, watch: &mut dyn FnMut(&Watched<'_>)) -> Result<Flown> {
        if let Pilot::Baseline(own) = &mut self.pilot {
            // it learns the numbers of an episode once
            *own = Baseline::new(&self.env)?;
        }
        let mut record = Record::new(&self.env, LINES);
        let (seed, start) = (self.env.spec().config.seed, Instant::now());
        let commands = Commands::new(&self.env, kept)?;
        let mut watch = |watched: &Watched<'_>| {
            record.see(watched);
            commands.see(watched);
            watch(watched);
        };
        let mut steps = 0;
        let mut random = |env: &Env, _: &Buffers, actions: &mut [f32]| {
            env.sample(draw(seed, steps), actions);
            steps += 1;
            Ok(())
        };
        let (controller, evaluation) = match &mut self.pilot {
            Pilot::Baseline(own) => {
                let name = own.name().to_string();
                (name, evaluate(&mut self.env, &mut commands.of(&mut own.policy()), &mut watch)?)
            }
            Pilot::Random => ("random".into(), evaluate(&mut self.env, &mut commands.of(&mut random), &mut watch)?),
            Pilot::Planner(own) => {
                let mut plan = |env: &Env, _: &Buffers, actions: &mut [f32]| own.act(env, actions);
                ("planner".into(), evaluate(&mut self.env, &mut commands.of(&mut plan), &mut watch)?)
            }
        };
        let (commands, trajectories) = commands.told()?;
        let (failures, plan) = match &self.pilot {
            Pilot::Baseline(own) => (own.failures(), None),
            Pilot::Random => (&[][..], None),
            Pilot::Planner(own) => (&[][..], Some(own.config().clone())),
        };
        let unflown = failures.first().map(|(_, first)| {
            format!("{} of the episodes could not be flown, the first because: {first}", failures.len())
        });
        let wall_time = start.elapsed().as_secs_f64();
        let lean = self.env.robot().hover_lean();
        Ok(Flown {
            record,
            controller,
            evaluation,
            commands,
            trajectories,
            unflown,
            plan,
            refined: None,
            lean,
            wall_time,
        })
    }
}

fn one(a: &Arguments, entry: &Entry, config: &EnvConfig, threads: &Threads) -> Result<Report> {
    // before any folder is made
    let mut ready = Ready::new(entry, config, threads, (a.controller, &a.plan))?;
    let horizon = ready.env.spec().horizon;
    let told = Told { command: "rollout", by: a.controller.name(), usual: Path::new("out").join(entry.name) };
    told.of(&a.episodes, horizon, |kept, watch| ready.fly(kept, watch))
}

/// How a command tells of the episodes that it flies.
pub struct Told<'a> {
    /// Its name, that of its figure too.
    pub command: &'static str,
    /// Who flies, in JSON.
    pub by: &'a str,
    /// The folder unless another one was named.
    pub usual: PathBuf,
}

impl Told<'_> {
    /// Flies behind a bar of `horizon` steps, draws and writes what the options want, and tells.
    pub fn of(
        self,
        arguments: &EpisodeArguments,
        horizon: usize,
        fly: impl FnOnce(usize, &mut dyn FnMut(&Watched<'_>)) -> Result<Flown>,
    ) -> Result<Report> {
        let EpisodeArguments { output, csv, npz, replay, .. } = arguments;
        let logs = *csv || *npz || arguments.mcap();
        let writes = logs || *replay || !output.no_plots;
        let folder = if writes { output.folder(self.usual)? } else { PathBuf::new() };
        let bar = progress::bar(horizon as u64, "flying", output.json);
        let kept = if logs { arguments.trajectories } else { 0 };
        let mut seen = Seen::new(if *replay { SHOWN } else { 0 });
        let mut logged = Seen::new(if arguments.mcap() { kept } else { 0 });
        let flown = fly(kept, &mut |watched| {
            bar.set_position(watched.step as u64);
            seen.see(watched);
            logged.see(watched);
        })?;
        bar.finish_and_clear();
        let mut written = Vec::new();
        if !output.no_plots {
            let path = folder.join(format!("{}.{}", self.command, output.format.extension()));
            let spinner = progress::spinner("drawing", output.json);
            out::draw(&flown, &path)?;
            spinner.finish_and_clear();
            written.push(path);
        }
        if *csv {
            written.extend(out::write_csv(&flown.record, &folder)?);
            let path = folder.join("trajectories.csv");
            flown.trajectories.write_csv(&path)?;
            written.push(path);
        }
        if *npz {
            let path = folder.join("trajectories.npz");
            flown.trajectories.write_npz(&path)?;
            written.push(path);
        }
        #[cfg(feature = "mcap")]
        if arguments.mcap {
            let path = folder.join("trajectories.mcap");
            flown.trajectories.write_mcap(&path, &logged.recording(&flown)?)?;
            written.push(path);
        }
        if *replay {
            let path = folder.join("replay.html");
            files::replace(&path, page(&flown.title(), &[seen.recording(&flown)?]))?;
            written.push(path);
        }
        Ok(Report::told(output.json, true, || flown.json(self.command, self.by, &written), || flown.page(&written)))
    }
}

impl Flown {
    /// The registered name.
    pub fn task(&self) -> &str {
        &self.record.spec().task
    }

    /// Who flew what.
    pub fn title(&self) -> String {
        format!("{}: {}", self.task(), self.controller)
    }

    /// Steps of episodes, all together.
    fn n_step(&self) -> usize {
        self.record.steps.iter().map(|s| s.n_flying).sum()
    }

    /// The numbers that matter.
    pub fn headline(&self) -> String {
        let (e, record) = (&self.evaluation, &self.record);
        let error = &record.spec().info[record.first_metric()];
        let mut parts = vec![
            format!("return {} ± {}", short(e.return_mean, 4), short(e.return_std, 3)),
            format!("{} of the bound", percent(e.share_of_bound)),
            format!("success {}", percent(e.success)),
            format!("crashed {}", share_of(e.crashed, record.spec().n_env)),
        ];
        if let Some((_, unit, last)) = self.final_spreads().next() {
            let name = error.name.replace('_', " ");
            parts.push(format!("median {name} at the end {} {unit}", short(last.median, 3)));
        }
        parts.join("   ·   ")
    }

    /// All figures, and what was written.
    pub fn page(&self, written: &[PathBuf]) -> Page {
        let mut page = Page::new();
        let spec = self.record.spec();
        let how = format!("{} episodes, seed {}, flown by {}", spec.n_env, spec.config.seed, self.controller);
        page.title(&spec.task, &how).facts(self.facts());
        page.line(success(spec));
        if let Some(note) = &self.unflown {
            page.line(format!("  {note}"));
        }
        page.heading("How episodes ended").table(self.ends());
        page.heading("Reward").table(self.terms());
        page.heading("In the last step").table(self.metrics());
        page.written(written);
        page
    }

    pub fn facts(&self) -> Vec<Fact> {
        let (e, spec) = (&self.evaluation, self.record.spec());
        let error = &spec.info[self.record.first_metric()];
        let with_unit = |v: f64| format!("{} {}", short(v, 3), error.unit);
        let bound = spec.reward_bound * spec.horizon as f64;
        let rate = self.n_step() as f64 / self.wall_time.max(1e-9);
        let reached = self.refined.as_ref().map(|refined| {
            Fact::new("share of what is in reach", refined.share().map_or("–".into(), percent)).note(format!(
                "{} after {} steps up its gradient, {} of them a success: the best flights near its own, by one who knows the episode",
                short(refined.means().1, 4),
                refined.iterations,
                percent(refined.success())
            ))
        });
        let mut facts = vec![
            Fact::new("return", format!("{} ± {}", short(e.return_mean, 4), short(e.return_std, 3)))
                .note("mean and standard deviation over the episodes"),
            Fact::new("share of the bound", percent(e.share_of_bound)).note(format!(
                "{} = {} × {} steps",
                short(bound, 5),
                short(spec.reward_bound, 4),
                spec.horizon
            )),
            Fact::new("success", percent(e.success)).note(format!(
                "{} to {} with 95 % confidence; by the last error alone {}",
                percent(e.success_interval[0]),
                percent(e.success_interval[1]),
                percent(e.success_by_last_error)
            )),
            Fact::new("crashed", share_of(e.crashed, spec.n_env)).note("ended before their time"),
            Fact::new("length", format!("{} steps", short(e.length, 4))).note(format!(
                "{} of {} s",
                short(e.length * spec.dt, 3),
                short(spec.horizon as f64 * spec.dt, 3)
            )),
            Fact::new(format!("{}, mean", error.name.replace('_', " ")), with_unit(e.mean_error))
                .note("over all steps, the start included"),
            Fact::new("in the last step", with_unit(e.final_error)).note("mean, crashed episodes included"),
            Fact::new("took", duration(self.wall_time))
                .note(format!("{} k steps per second, the controller included", short(1e-3 * rate, 3))),
        ];
        facts.splice(2..2, reached);
        facts.extend(tasks::lean(self.lean, spec));
        facts
    }

    fn ends(&self) -> Table {
        let (spec, e) = (self.record.spec(), &self.evaluation);
        let mut table = Table::new("reason | >episodes | when");
        let mut diverged = spec.diverged();
        if let Some((i, breach)) = (0..spec.n_env).find_map(|i| Some((i, self.record.breach(i)?))) {
            diverged.condition += &format!(": in episode {i} {breach}");
        }
        for (end, share) in spec.ends.iter().chain([&diverged]).zip(&e.ends) {
            table.row([&end.name, &share_of(*share, spec.n_env), &end.condition]);
        }
        table.row(["time", &percent(1.0 - e.crashed), &format!("{} steps are over", spec.horizon)]);
        table
    }

    fn terms(&self) -> Table {
        let mut table = Table::new("term | >mean per episode | >share of its bound | is");
        let spec = self.record.spec();
        for (term, mean) in spec.reward.iter().zip(&self.evaluation.terms) {
            let share =
                if term.bound > 0.0 { percent(mean / (term.bound * spec.horizon as f64)) } else { "–".into() };
            table.row([term.name.to_string(), short(*mean, 4), share, term.formula.clone()]);
        }
        table
    }

    fn metrics(&self) -> Table {
        let mut table = Table::new("metric | >mean | >10 % | >median | >90 % | unit");
        for (name, unit, s) in self.final_spreads() {
            let numbers = [s.mean, s.low, s.median, s.high].map(|v| short(v, 3));
            let [mean, low, median, high] = &numbers;
            table.row([name, mean, low, median, high, unit]);
        }
        table
    }

    fn final_spreads(&self) -> impl Iterator<Item = (&str, &str, Spread)> {
        let first = self.record.first_metric();
        let infos = self.record.spec().info.iter().enumerate().skip(first);
        infos.map(|(k, info)| (info.name.as_str(), info.unit.as_str(), Spread::of(&mut self.record.ended(k))))
    }

    /// The same for programs.
    pub fn json(&self, command: &str, controller: &str, written: &[PathBuf]) -> Value {
        let (spec, e) = (self.record.spec(), &self.evaluation);
        let names = spec.ends.iter().map(|end| end.name.as_str()).chain(["diverged"]);
        let ends: serde_json::Map<_, _> = names.zip(&e.ends).map(|(name, share)| (name.into(), json!(share))).collect();
        let terms = spec.reward.iter().zip(&e.terms);
        let terms: serde_json::Map<_, _> = terms.map(|(t, mean)| (t.name.clone(), json!(mean))).collect();
        let refined = self.refined.as_ref().map(|refined| {
            let (mean, share, success) = (refined.means().1, refined.share(), refined.success());
            json!({ "iterations": refined.iterations, "return_mean": mean, "share": share, "success": success, "flown": refined.flown, "best": refined.best })
        });
        let metrics: serde_json::Map<_, _> =
            self.final_spreads().map(|(name, unit, s)| (name.into(), json!({ "unit": unit, "last": s }))).collect();
        json!({
            "command": command,
            "version": env!("CARGO_PKG_VERSION"),
            "task": spec.task,
            "controller": controller,
            "flown_by": self.controller,
            "plan": self.plan,
            "refined": refined,
            "evaluation": e,
            "ends": ends,
            "terms": terms,
            "metrics": metrics,
            "horizon": spec.horizon,
            "dt": spec.dt,
            "reward_bound": spec.reward_bound,
            "unflown": self.unflown,
            "wall_time": self.wall_time,
            "config": spec.config,
            "files": files::names(written),
        })
    }
}
