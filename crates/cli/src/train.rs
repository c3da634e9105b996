//! `omnidrones train`: a task, a policy from random weights, and what it came to.

use super::arguments::{self, OutputArguments, algorithms};
use super::baseline::{MAX_COMPARED, compare, results, spec};
use super::environment::{self, EnvArguments, usual_vehicle};
use super::episodes::{SUCCESS, success};
use super::replay;
use super::train_plot::{self, Curves};
use super::train_search::{self, axis, combinations};
use super::train_seeds::{self, Asked};
use crate::prelude::*;
use omnidrones::layers::{self, Layer};
use omnidrones::parallel::Threads;
use omnidrones::rl::checkpoint::Manifest;
use omnidrones::rl::policy_io::load_policy;
use omnidrones::rl::trainer::{RunProgress, TrainResult, Trainer};
use omnidrones::rl::{Starts, TrainConfig, checkpoint};
use omnidrones::tasks::registry::{self, TaskEntry};
use omnidrones::tasks::{EnvConfig, Evaluation, Metric, Spec};
use std::collections::BTreeMap;
use std::io::Write;
use std::ops::ControlFlow;

/// What the command is for.
pub const ABOUT: &str = "\
Train a policy for a task from random weights, evaluate it on starts that training never saw, and draw how it learnt. \
Every run is kept in a folder from which it goes on after a kill, and from which 'replay', 'eval' and 'watch' fly the policy.";

const EXAMPLES: &str = "\
Examples:
  omnidrones train Hover                               from nothing to a policy that hovers
  omnidrones train Hover --vehicle crazyflie           on another drone
  omnidrones train Track --algo ppo --updates 100      with another algorithm, for 100 updates
  omnidrones train Hover --algo sac                    from kept experience, without gradients of the physics
  omnidrones train Hover --set apg.horizon=32          with another setting
  omnidrones train Hover --envs 128 --horizon 300      more environments, shorter episodes
  omnidrones train Hover --randomise mass:0.7:1.3      of another mass in every episode
  omnidrones train Hover --toml                        every setting, as a file for --config
  omnidrones train Hover --resume                      go on after a kill
  omnidrones train Hover --resume --updates 2000       go on beyond its end
  omnidrones train Hover --seeds 5                     five seeds side by side: means and intervals
  omnidrones train Hover --search apg.learning_rate.from=0.005,0.01,0.02 --search apg.n_env=32,64
  omnidrones eval runs/Hover-apg-s0                    fly the policy, with plots
  omnidrones replay runs/Hover-apg-s0                  see it fly, in a browser

Algorithms: apg takes the gradient of a smooth loss through the physics; shac does so over shorter windows with a \
critic behind them; ppo samples actions, sac and td3 learn from kept experience, and dqn does so where each number of an \
action has a few values: none of these needs a gradient of the physics. dagger imitates. mappo is ppo with a critic that sees \
the whole team, happo with a policy for each agent too; ddpg, maddpg, matd3 and fasttd3, which has many environments and large \
batches, are settings of td3, vdn and qmix of dqn, and rma, which learns from the past what a teacher is told of the drone, of \
dagger. Without --algo a task has its usual one.

Settings: options win over --config, the file wins over the task's recipe, the recipe over the defaults. A key of --set \
is that of the file: seed, apg.horizon, apg.network.hidden=[32,32], apg.learning_rate.from=0.005; dt is env.dt and horizon \
env.task.horizon. A file that names its task is refused for another.";

const FILES: &str = "\
Ctrl-C saves behind the update that is running, and --resume goes on from there to the same bits; a second one ends it at once. \
After a kill it goes on from the newest checkpoint: there is one every checkpoint.every updates and checkpoint.seconds. With --resume the settings \
are those of the run; only --updates and --threads may change. Schedules, as of the learning rate, stretch over the new \
number of updates, so the result differs from a fresh run of as many.

A folder that holds other files is refused, and so is a run that is there already: --resume goes on with it, --force \
begins another in its place.

With --seeds, one folder s0, s1, … per seed in --out, seeds.json (what --json prints) and curve: the mean of all and its \
95 % confidence interval. A seed that fails leaves the others alone.

--search trains every combination of the values by successive halving (Jamieson and Talwalkar 2016): all for a share of \
their updates, the best third of them (--factor) on to three times as many, until one is left or the whole run is done; best \
is the largest success, a mean over the seeds. Schedules are those of the whole run, which a rung pauses. In --out: a folder \
c0/s0, … per candidate and seed, search.json (what is known), search (the plot), winner.toml (for --config).

Files in --out: config.toml (every setting), log.jsonl, curve.csv and an event file for TensorBoard (the course of the run, one line every few updates), \
checkpoints (weights as safetensors, state, manifest), curve (.png or .svg), result.json (what --json prints), with --replay \
replay.html. With sac, td3 and dqn each checkpoint holds the steps that they learn from, 0.06 GB of Hover and 0.9 GB of a team's, two \
of them and a third while it is written: a disk without room for them is refused before training.

JSON: SI units; shares from 0 to 1; null where a number does not exist.

Exit codes: 0 trained; 1 a seed failed; 2 unusable input or arguments.";

/// Arguments of `train`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = format!("{EXAMPLES}\n\n{SUCCESS}\n\n{FILES}"))]
#[command(mut_arg("out", |out| arguments::out(out, "Folder of the run [default: runs/TASK-ALGO-sSEED, behind TASK vehicle and control level where \
    they are not the task's usual ones]")))]
pub struct Arguments {
    /// A task ('omnidrones tasks')
    #[arg(value_name = "TASK")]
    task: String,
    /// How to learn [default: the task's usual one]
    #[arg(long, value_name = "NAME", value_parser = algorithms(), ignore_case = true)]
    algo: Option<String>,
    /// Environments trained on at once: n_env of the algorithm [default: the recipe's]
    #[arg(long, value_name = "N")]
    envs: Option<u64>,
    /// Updates after which it ends [default: the recipe's; the run's with --resume]
    #[arg(long, value_name = "N")]
    updates: Option<u64>,
    /// Threads; the results do not depend on it [default: all cores]
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Train so many seeds side by side, from that of --seed on [default: 1; 3 with --search]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: Option<u64>,
    /// Find the best of several values of a setting; may be repeated
    #[arg(long, value_name = "KEY=VALUE,VALUE", value_parser = axis)]
    search: Vec<(String, Vec<toml::Value>)>,
    /// Of so many candidates of --search one goes on [default: 3]
    #[arg(long, value_name = "N", requires = "search", value_parser = clap::value_parser!(u64).range(2..))]
    factor: Option<u64>,
    /// Go on with the run in the folder; begin it if there is none
    #[arg(long)]
    resume: bool,
    /// Do not fly our controller from the same starts for comparison
    #[arg(long, help_heading = "Output")]
    no_baseline: bool,
    /// Write replay.html: the policy in space, a page for any browser
    #[arg(long, conflicts_with_all = ["seeds", "search", "toml"], help_heading = "Output")]
    replay: bool,
    /// Print every setting as a file that --config reads, and do not train
    #[arg(long, conflicts_with = "json", help_heading = "Output")]
    toml: bool,
    #[command(flatten)]
    output: OutputArguments,
    #[command(flatten)]
    environment: EnvArguments,
}

/// Trains.
pub fn run(a: &Arguments) -> Result<Report> {
    let entry = registry::by_name(&a.task)?;
    let mut config = a.config(entry, &[])?;
    if a.toml {
        return Ok(Report::done(environment::run_file(entry, &config)?));
    }
    let threads = a.threads.map_or_else(|| Ok(Threads::default()), Threads::new)?;
    if !a.resume {
        // before any folder is made
        config.validate_from()?;
    }
    if a.seeds.is_some() || !a.search.is_empty() {
        return several(a, entry, &config, &threads);
    }
    let folder = a.output.out.clone().map_or_else(|| default_folder(entry, &config, a.algo.as_deref()), Ok)?;
    if let Some(own) = own_settings(&folder)?.filter(|_| a.resume) {
        config = a.going_on(config, own);
    }
    // before any folder is made
    let trainer = Trainer::new(entry.name, config, threads.clone())?;
    let mut outputs = a.output.open(&folder, true)?;
    if a.output.force && !a.resume {
        files::remove_run(&folder)?;
    }
    let mut trainer = trainer.in_folder(&folder, a.resume)?;
    if trainer.kept_bytes() >= 100_000_000 && !trainer.is_over() {
        let (each, copies) = (trainer.kept_bytes() as f64 / 1e9, trainer.config().checkpoint.keep + 1);
        let all = each * copies as f64;
        note(&format!("a checkpoint keeps {each:.2} GB of steps, up to {copies} at once: {all:.1} GB of disk"));
    }
    let skipped = trainer.skipped().iter().map(|s| format!("{}: {}", s.folder.display(), s.why));
    let notes = skipped.chain(trainer.differs()).collect();
    let was_over = (trainer.update() > 0 && trainer.is_over()).then(|| (trainer.done(), trainer.budget()));
    let outcome = train(&mut trainer, a.output.json)?;
    for folder in trainer.spared() {
        note(&format!("{} is an old checkpoint and stays: it holds files of others", folder.display()));
    }
    let config = trainer.config().clone();
    let spinner = progress::spinner("flying our controller from the same starts", a.output.json);
    let baseline = if a.no_baseline { None } else { compare(entry, &config, &threads) };
    spinner.finish_and_clear();
    let (spec, error) = spec(entry, &config)?;
    let algorithm = a.algo.clone().unwrap_or_else(|| config.algorithm.name().into());
    let (first, written) = (First::of(&folder, &config), Vec::new());
    let mut trained =
        Trained { entry, spec, error, algorithm, config, was_over, outcome, baseline, first, notes, written };
    if a.replay {
        outputs.text(files::REPLAY, replay::of_run(&folder)?)?;
    }
    outputs.draw("curve", || train_plot::figure(&trained.curves()))?;
    trained.written = outputs.written.clone();
    outputs.text("result.json", format!("{:#}\n", trained.json()))?;
    let files = ["log.jsonl", "curve.csv", "config.toml", "result.json"].map(|name| folder.join(name));
    trained.written.extend(files.into_iter().chain(trained.outcome.checkpoint.clone()));
    Ok(Report::told(a.output.json, true, || trained.json(), || trained.page(&folder)))
}

/// Several seeds, or a search over settings.
fn several(a: &Arguments, entry: &TaskEntry, config: &TrainConfig, threads: &Threads) -> Result<Report> {
    let searches = !a.search.is_empty();
    let n = a.seeds.unwrap_or(if searches { 3 } else { 1 });
    let usual = default_folder(entry, config, a.algo.as_deref())?;
    let what = if searches { "search" } else { "seeds" };
    let settings = |folder: &Path, seed: u64| {
        let fresh = TrainConfig { seed, ..config.clone() };
        let own = own_settings(folder)?.filter(|_| a.resume);
        Ok(own.map_or(fresh.clone(), |own| TrainConfig { seed, ..a.going_on(fresh, own) }))
    };
    let asked = Asked {
        entry,
        algorithm: a.algo.as_deref().unwrap_or(config.algorithm.name()),
        config,
        settings: &settings,
        seeds: (config.seed..config.seed.saturating_add(n)).collect(),
        usual: PathBuf::from(format!("{}-{what}", usual.display())),
        resume: a.resume,
        output: &a.output,
    };
    if !searches {
        return train_seeds::run(&asked, threads);
    }
    if let Some((key, values)) = a.search.iter().find(|(key, _)| key == "seed") {
        let remedy = "Every candidate is trained with the same seeds: --seeds 5 gives it five.";
        return Err(Error::value("--search", format!("{key} = {}", values.len()), "a setting, no seed", remedy));
    }
    let axes = a
        .search
        .iter()
        .map(|(key, values)| Ok((environment::place(key, Some(entry), a.algo.as_deref())?, values.clone())));
    let combinations = combinations(&axes.collect::<Result<Vec<_>>>()?)?;
    let named = combinations.into_iter().map(|(name, layers)| Ok((name, a.config(entry, &layers)?)));
    train_search::run(&asked, named.collect::<Result<_>>()?, a.factor.unwrap_or(3) as usize, threads)
}

impl Arguments {
    /// The settings with which a run of the settings `own` goes on: what options ask for must be what it is, but for its length.
    fn going_on(&self, config: TrainConfig, own: TrainConfig) -> TrainConfig {
        let seed = self.environment.seed().unwrap_or(own.seed);
        let length = self.updates.unwrap_or(own.updates());
        if self.changes_settings() { TrainConfig { seed, ..config } } else { own }.with_updates(length)
    }

    /// Defaults, recipe, file, options, then `more`.
    fn config(&self, entry: &TaskEntry, more: &[Layer]) -> Result<TrainConfig> {
        let file = self.environment.file(&format!("omnidrones train {} --toml", entry.name))?;
        let mut foreign = Vec::new();
        let file = file.map(|layer| {
            layer.map(TrainConfig::lifted).map(|mut table| {
                foreign = TrainConfig::take_foreign(&mut table);
                table
            })
        });
        let options = self.environment.options(Some(entry), self.algo.as_deref())?;
        let mut layers: Vec<Layer> = file.iter().chain(&options).cloned().collect();
        let algorithm = self.algo.as_deref();
        if let Some(n) = self.envs {
            let algorithm = TrainConfig::layered(entry.name, algorithm, &layers)?.algorithm.name();
            let n = i64::try_from(n).unwrap_or(i64::MAX);
            layers.push(Layer::of_table("--envs", layers::at(&format!("{algorithm}.n_env"), n.into())));
        }
        layers.extend(more.iter().cloned());
        let mut config = TrainConfig::layered(entry.name, algorithm, &layers)?;
        if let Some(updates) = self.updates {
            config = config.with_updates(updates);
        }
        config.validate()?;
        for option in options.iter().chain(more) {
            refuse_unused(&config, option)?;
        }
        if let Some(file) = &file {
            for (key, remedy) in foreign {
                warn(&format!("{}: {key} is not used in training. {remedy}", file.name()));
            }
            for other in config.unused(file.table()) {
                let (file, own) = (file.name(), config.algorithm.name());
                warn(&format!("{file}: [{other}] is not used, for {own} trains. --algo {other} would use it."));
            }
        }
        Ok(config)
    }

    /// Whether options say how to train.
    fn changes_settings(&self) -> bool {
        self.environment.given() || self.envs.is_some() || self.algo.is_some()
    }
}

/// Nobody may read it: that is no reason not to train.
fn warn(text: &str) {
    let _ = writeln!(std::io::stderr(), "warning: {text}");
}

fn note(text: &str) {
    let _ = writeln!(std::io::stderr(), "note: {text}");
}

/// Refuses an option of an algorithm that does not train; a file may carry such tables for other runs.
fn refuse_unused(config: &TrainConfig, option: &Layer) -> Result<()> {
    let [other, ..] = config.unused(option.table())[..] else { return Ok(()) };
    let limit = format!("one of {}, which trains", config.algorithm.name());
    let remedy = format!("Add --algo {other}, or leave it out.");
    Err(Error::value(option.name(), format!("a setting of {other}"), limit, remedy))
}

/// `runs/TASK-ALGO-sSEED`, behind the task vehicle and control level where they are not its usual ones.
fn default_folder(entry: &TaskEntry, config: &TrainConfig, asked: Option<&str>) -> Result<PathBuf> {
    let algorithm = config.algorithm.name();
    let usual = TrainConfig::for_task(entry.name, Some(algorithm), None)?;
    let vehicle = |config: &TrainConfig| config.env.task.get("vehicle")?.as_str().map(str::to_lowercase);
    let mut parts = vec![entry.name.to_string()];
    if let Some(own) = vehicle(config) {
        let env = entry.env(&EnvConfig { n_env: 1, ..usual.env.clone() })?;
        let common = vehicle(&usual).or_else(|| usual_vehicle(env.task_spec()));
        parts.extend(Some(files::plain_name(&own)).filter(|_| common.as_ref() != Some(&own)));
    }
    if config.env.control != usual.env.control {
        parts.push(config.env.control.name().into());
    }
    parts.extend([asked.unwrap_or(algorithm).into(), format!("s{}", config.seed)]);
    Ok(Path::new("runs").join(parts.join("-")))
}

/// The settings of the run in a folder, if there is one.
fn own_settings(folder: &Path) -> Result<Option<TrainConfig>> {
    let path = folder.join("config.toml");
    if !path.exists() {
        return Ok(None);
    }
    TrainConfig::from_toml(&files::read_settings(&path, "omnidrones train TASK --toml")?, &path.display().to_string())
        .map(Some)
}

/// Trains under a bar.
fn train(trainer: &mut Trainer, quiet: bool) -> Result<TrainResult> {
    let bar = progress::bar(trainer.config().updates(), "training", quiet);
    let (begun, before) = (std::time::Instant::now(), std::cell::Cell::new(None::<u64>));
    let outcome = trainer.run(&mut |p| {
        if !bar.is_hidden() {
            let first = before.get().unwrap_or(p.env_steps);
            before.set(Some(first));
            bar.set_position(p.done);
            progress::say(&bar, &message(p, (p.env_steps - first) as f64 / begun.elapsed().as_secs_f64()));
        }
        ControlFlow::Continue(())
    });
    bar.finish_and_clear();
    outcome
}

/// `return 412 · success 98 % · 3.1 M steps/s · fly 36 % sweep 61 %`.
fn message(p: &RunProgress<'_>, rate: f64) -> String {
    let mut parts = Vec::new();
    if let Some(mean) = p.line.and_then(|(line, _)| line.get("return")) {
        parts.push(format!("return {}", short(mean, 3)));
    }
    if let Some(e) = p.evaluation {
        parts.push(format!("success {}", percent(e.success)));
    }
    parts.push(format!("{} steps/s", count(rate)));
    let phases = p.phases.iter().filter(|(_, share)| *share > 0.05);
    parts.push(phases.map(|(name, share)| format!("{name} {:.0} %", 100.0 * share)).collect::<Vec<_>>().join(" "));
    parts.join(" · ")
}

/// A run that was trained first, for another to begin from.
struct First {
    /// `Hover by apg`.
    name: String,
    folder: PathBuf,
    updates: u64,
    env_steps: u64,
    seconds: f64,
}

impl First {
    /// That of a run, where it has one in its folder.
    fn of(folder: &Path, config: &TrainConfig) -> Option<Self> {
        let folder = folder.join("from");
        if config.from.is_empty() || !folder.join("checkpoints").is_dir() {
            return None;
        }
        let Manifest { task, algorithm, update, env_steps, seconds, .. } = load_policy(&folder).ok()?.manifest;
        Some(Self { name: format!("{task} by {algorithm}"), folder, updates: update, env_steps, seconds })
    }

    fn share(&self, whole: &TrainResult) -> [f64; 2] {
        [self.seconds / whole.seconds.max(1e-9), self.env_steps as f64 / (whole.env_steps as f64).max(1.0)]
    }

    fn fact(&self, whole: &TrainResult) -> Fact {
        let Self { folder, updates, env_steps, seconds, .. } = self;
        let [time, steps] = self.share(whole).map(percent);
        let steps = format!("{} env steps ({steps})", count(*env_steps as f64));
        Fact::new("trained first", &self.name).note(format!(
            "{updates} updates, {} ({time} of the time), {steps}; in {}",
            duration(*seconds),
            folder.display()
        ))
    }

    fn json(&self, whole: &TrainResult) -> Value {
        let [time, steps] = self.share(whole);
        json!({
            "name": self.name,
            "folder": self.folder.display().to_string(),
            "updates": self.updates,
            "env_steps": self.env_steps,
            "seconds": self.seconds,
            "share_of_time": time,
            "share_of_env_steps": steps,
        })
    }
}

/// A run that is over.
pub struct Trained<'a> {
    entry: &'a TaskEntry,
    spec: Spec,
    /// The task's error.
    error: Metric,
    /// As it was asked for.
    algorithm: String,
    config: TrainConfig,
    /// Before the command came: updates done, and its budget.
    was_over: Option<(u64, u64)>,
    outcome: TrainResult,
    baseline: Option<(String, Evaluation)>,
    /// What was trained first.
    first: Option<First>,
    /// Checkpoints that were passed over.
    notes: Vec<String>,
    written: Vec<PathBuf>,
}

impl Trained<'_> {
    fn rate(&self) -> f64 {
        self.outcome.env_steps as f64 / self.outcome.seconds.max(1e-9)
    }

    /// Updates of the task's recipe.
    fn recipe(&self) -> Option<u64> {
        Some(TrainConfig::for_task(self.entry.name, Some(&self.algorithm), None).ok()?.updates())
    }

    /// Share of each phase in the time of training.
    fn phases(&self) -> Vec<(String, f64)> {
        let mut sums: Vec<(String, f64)> = Vec::new();
        let (mut before, mut total) = (0.0, 0.0);
        for line in &self.outcome.curve {
            let seconds = line.get("seconds").unwrap_or(before) - before;
            (before, total) = (before + seconds, total + seconds);
            for (name, share) in line.iter().filter_map(|(name, x)| Some((name.strip_prefix("time_")?, x))) {
                match sums.iter_mut().find(|(own, _)| own == name) {
                    Some((_, sum)) => *sum += seconds * share,
                    None => sums.push((name.into(), seconds * share)),
                }
            }
        }
        sums.into_iter().map(|(name, sum)| (name, sum / total.max(1e-12))).collect()
    }

    fn headline(&self) -> String {
        let (o, e) = (&self.outcome, &self.outcome.evaluation);
        [
            format!("success {}", percent(e.success)),
            format!("crashed {}", share_of(e.crashed, e.n_episode)),
            format!("return {}", short(e.return_mean, 4)),
            format!("{} of the bound", percent(e.share_of_bound)),
            format!("trained in {}", duration(o.seconds)),
            format!("{} env steps", count(o.env_steps as f64)),
        ]
        .join("   ·   ")
    }

    fn curves(&self) -> Curves<'_> {
        let vehicle = self.config.env.task.get("vehicle").and_then(toml::Value::as_str);
        let of = vehicle.map_or(String::new(), |name| format!(", {name}"));
        Curves {
            title: format!("{}: {}{of}, seed {}", self.entry.name, self.algorithm, self.config.seed),
            subtitle: self.headline(),
            lines: &self.outcome.curve,
            loss: self.config.algorithm.loss(),
            bound: self.spec.reward_bound * self.spec.horizon as f64,
            error: &self.error,
            baseline: self.baseline.as_ref(),
        }
    }

    fn page(&self, folder: &Path) -> Page {
        let (o, mut page) = (&self.outcome, Page::new());
        let how = format!("{}, seed {}, {} updates", self.algorithm, self.config.seed, o.updates);
        page.title(self.entry.name, &how).facts(self.facts());
        if let Some((done, budget)) = self.was_over {
            page.line(format!(
                "  This run was over: update {done} of {budget}. Nothing was trained; \
                 --resume --updates N goes on to N."
            ));
        }
        let restarts = o.curve.last().and_then(|line| line.get("restarts")).unwrap_or(0.0);
        if restarts > 0.0 {
            let times = if restarts == 1.0 { "once".into() } else { format!("{} times", short(restarts, 3)) };
            let led = self.config.updates().min(o.updates);
            let led = if o.stopped { String::new() } else { format!(": {led} of {} updates led here", o.updates) };
            page.line(format!("  It began again {times}, with other weights, since hidden units were saturated{led}."));
        }
        if let Some(recipe) = self.recipe().filter(|recipe| *recipe > o.updates) {
            page.line(format!("  The recipe trains for {recipe} updates: a first look, behind {}.", o.updates));
        }
        page.notes("damaged", &self.notes, 3, "see the folder");
        let starts = Starts { n_env: self.config.evaluate.envs, seed: self.config.evaluate.seed };
        page.heading(&format!("Evaluation: {} episodes from held-out starts, seed {}", starts.n_env, starts.seed));
        page.table(self.table());
        page.line(success(&self.spec));
        if self.baseline.is_some() && starts.n_env > MAX_COMPARED {
            page.line(format!("  The controller flew the first {MAX_COMPARED} of these starts."));
        }
        page.written(&self.written);
        page.heading("Next");
        page.line(format!("  omnidrones replay {}  the policy in flight, as a page for a browser", folder.display()));
        page.line(format!("  omnidrones report {}  all of it, as one page", folder.display()));
        page.line(format!("  omnidrones eval {}    errors over time, as plots", folder.display()));
        page.line(format!("  omnidrones watch {}   the policy in flight, as a GIF", folder.display()));
        page
    }

    fn facts(&self) -> Vec<Fact> {
        let o = &self.outcome;
        let phases = self.phases().into_iter().filter(|(_, share)| *share >= 0.005);
        let phases: Vec<String> = phases.map(|(name, share)| format!("{name} {:.0} %", 100.0 * share)).collect();
        let policy = &o.policy;
        let first = self.first.iter().map(|first| first.fact(o));
        let own = vec![
            Fact::new("trained in", duration(o.seconds)).note("without evaluations"),
            Fact::new("env steps", count(o.env_steps as f64)).note(format!("{} per second", count(self.rate()))),
            Fact::new("phases", phases.join(", ")),
            Fact::new("policy", format!("{} weights", policy.parameters().len())).note(format!(
                "{} numbers in, {} out",
                policy.actor().n_observation(),
                policy.actor().n_action()
            )),
        ];
        own.into_iter().chain(first).collect()
    }

    fn table(&self) -> Table {
        let own = (format!("policy ({})", self.algorithm), self.outcome.evaluation.clone());
        results(&self.error.unit, std::iter::once(&own).chain(&self.baseline))
    }

    fn json(&self) -> Value {
        let o = &self.outcome;
        json!({
            "command": "train",
            "version": env!("CARGO_PKG_VERSION"),
            "task": self.entry.name,
            "algorithm": self.algorithm,
            "seed": self.config.seed,
            "updates": o.updates,
            "env_steps": o.env_steps,
            "seconds": o.seconds,
            "steps_per_second": self.rate(),
            "phases": self.phases().into_iter().collect::<BTreeMap<_, _>>(),
            "stopped": o.stopped,
            "was_over": self.was_over.is_some(),
            "trained_first": self.first.as_ref().map(|first| first.json(o)),
            "evaluation": o.evaluation,
            "baseline": self.baseline.as_ref().map(|(name, e)| json!({ "flown_by": name, "evaluation": e })),
            "reward_bound": self.spec.reward_bound,
            "horizon": self.spec.horizon,
            "config": self.config.to_toml().unwrap_or_default(),
            "checkpoint": o.checkpoint.as_ref().map(|path| path.display().to_string()),
            "passed_over": self.notes,
            "format": checkpoint::FORMAT,
            "files": files::names(&self.written),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_named_after_what_is_not_usual() {
        for (task, text, folder) in [
            ("Hover", "", "Hover-apg-s0"),
            ("Hover", "env.task.vehicle = 'Hummingbird'\nenv.control = 'rotor'", "Hover-apg-s0"),
            ("Hover", "env.task.vehicle = 'crazyflie'", "Hover-crazyflie-apg-s0"),
            ("Hover", "env.control = 'rate'\nalgorithm = 'ppo'\nseed = 3", "Hover-rate-ppo-s3"),
            (
                "HoverRand",
                "env.task.vehicle = 'Firefly'\nenv.control = 'velocity'",
                "HoverRand-firefly-velocity-apg-s0",
            ),
            ("OmavHover", "env.task.vehicle = 'omav_tilting'", "OmavHover-apg-s0"),
            ("Hover", "env.task.vehicle = '../../etc'", "Hover-_.._etc-apg-s0"),
        ] {
            let config = TrainConfig::for_task(task, None, Some((text, "own"))).unwrap();
            let named = default_folder(registry::by_name(task).unwrap(), &config, None).unwrap();
            assert_eq!(named, Path::new("runs").join(folder), "{text}");
        }
    }

    #[test]
    fn the_limit_that_the_help_names_is_that_of_hover_and_the_tasks_with_other_rules_are_named() {
        let success = |entry: &TaskEntry| {
            entry.env(&EnvConfig { n_env: 1, ..EnvConfig::default() }).unwrap().spec().success.clone()
        };
        let hover = success(registry::by_name("Hover").unwrap()).text();
        assert!(hover.starts_with("position_error < 0.1 m and heading_alignment > 0.95"), "{hover}");
        assert!(SUCCESS.contains("0.1 m of position in Hover") && 0.95_f64.acos().to_degrees().round() == 18.0);
        for entry in registry::REGISTRY {
            let (name, success) = (entry.name, success(entry));
            let said = success.text();
            assert_eq!(success.held > 0.0, name.contains("Track") && success.held == 2.0, "{name}: {said}");
            let once = name.ends_with("FlyThrough") || ["Forest", "Pinball", "Race"].contains(&name);
            assert_eq!(success.once, once, "{name}: {said}");
            let beyond = ["OverFlyThrough", "TransportFlyThrough"].contains(&name);
            assert_eq!(said.contains("with all drones beyond x = 0.05 m"), beyond, "{name}: {said}");
        }
    }
}
