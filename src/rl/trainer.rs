//! What all training has in common: update, log, evaluate, save, go on.
//!
//! ```text
//! <run>/config.toml     every setting of the run
//!       log.jsonl       the course of it, a JSON object per line
//!       curve.csv       the same as a table
//!       events.…        the same for TensorBoard
//!       checkpoints/    the newest few, each whole or absent
//! ```
//!
//! A run that was stopped or killed goes on from its newest whole checkpoint to the same bits as if nothing had
//! happened: at most the updates since are flown again. Columns of the log:
//!
//! | name | what |
//! |---|---|
//! | `update`, `env_steps`, `seconds` | so far; the time is that of training, without evaluations |
//! | `steps_per_second` | since the last line |
//! | `loss`, `reward`, `gradient_norm` | means over the updates since the last line |
//! | `episodes`, `return`, `length`, `crashed`, `succeeded` | of episodes that ended since then: how many, means, shares |
//! | `rate` and more | the algorithm's own, in the last update |
//! | `eval_…` | figures of an [`Evaluation`], where one was made |
//! | `time_…` | share of each phase in the time since the last line |

mod predecessor;

use super::checkpoint::{Checkpoint, CheckpointWriter, Manifest, SkippedCheckpoint, Store, Tensors, check_room};
use super::config::TrainConfig;
use super::config_diff::described;
use super::curriculum::{Difficulty, GoodEpisode};
use super::ending::{AtWork, RunLeft};
use super::evaluate::{Starts, evaluate};
use super::learner::{Episodes, Learner, Update};
use super::log::{Curve, Line, Log};
use super::policy::Policy;
use super::policy_io::put_policy;
use super::predecessor::SAFE;
use super::state;
use super::task_record::put_task;
use super::warm_start::WarmStart;
use autodiff::native;
use base::error::{Error, Result};
use base::file_gate;
use base::parallel::Threads;
use predecessor::{Predecessor, predecessor};
use serde_json::json;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tasks::{Env, EnvConfig, Evaluation, registry};

/// A run: a learner, its clock, its files.
///
/// ```
/// # use omnidrones_rl::omnidrones;
/// use omnidrones::parallel::Threads;
/// use omnidrones::rl::{TrainConfig, Trainer};
/// use std::ops::ControlFlow;
///
/// let own = "evaluate.envs = 16\n[apg]\nn_env = 16\nhorizon = 8\nupdates = 4\n[env.task]\nhorizon = 40";
/// let config = TrainConfig::for_task("Hover", None, Some((own, "tiny")))?;
/// let mut trainer = Trainer::new("Hover", config, Threads::default())?;
/// let outcome = trainer.run(&mut |progress| {
///     println!("{} of {}", progress.update, progress.budget);
///     ControlFlow::Continue(()) // Break stops after this update
/// })?;
/// assert_eq!((outcome.updates, outcome.evaluation.n_episode), (4, 16));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
pub struct Trainer {
    task: &'static str,
    config: TrainConfig,
    threads: Threads,
    learner: Box<dyn Learner>,
    difficulty: Option<Difficulty>,
    /// Steps of environments that the policy it began from took.
    earlier_steps: u64,
    /// Updates so far; unlike the learner's it never goes back.
    update: u64,
    clock: Clock,
    /// Since the run began or went on.
    phases: Phases,
    since: Since,
    curve: Curve,
    evaluation: Option<Evaluation>,
    /// Instructions that it was begun with, where they are others than those of this processor.
    other_instructions: Option<String>,
    files: Option<Files>,
}

/// Whether a processor with these instructions rounds a product before it is added to something.
fn rounds_twice(instructions: &str) -> bool {
    !["avx512", "avx2", "neon"].iter().any(|set| instructions.split(' ').next() == Some(set))
}

/// Within a run's folder that of the run that it begins from.
const FROM: &str = "from";

/// Name of the steps before a run in its checkpoints.
const EARLIER: &str = "earlier_steps";

/// Where a run is kept.
struct Files {
    folder: PathBuf,
    log: Log,
    writer: CheckpointWriter,
    saved: Option<u64>,
    skipped: Vec<SkippedCheckpoint>,
    /// When the last checkpoint was made, or the run went on, and how long that took.
    last: (Instant, Duration),
}

/// A checkpoint takes at most a share of 1 / so many of the time, where it is made because of the time.
const SPARING: u32 = 50;

impl Files {
    /// Whether it is time for a checkpoint, whatever the number of updates.
    fn is_due(&self, seconds: u64) -> bool {
        let (made, took) = self.last;
        is_late(seconds, made.elapsed(), took)
    }
}

/// Whether a checkpoint is late that was last made so long ago and took so long.
fn is_late(seconds: u64, ago: Duration, took: Duration) -> bool {
    seconds > 0 && ago >= Duration::from_secs(seconds).max(took.saturating_mul(SPARING))
}

/// Sees every update, and may break behind it.
pub type Watch<'a> = dyn FnMut(&RunProgress<'_>) -> ControlFlow<()> + 'a;

/// How far a run is, after an update.
#[derive(Debug)]
pub struct RunProgress<'a> {
    /// What is trained: the run's own, or before it what it begins from.
    pub config: &'a TrainConfig,
    /// Updates done, repeated ones included.
    pub update: u64,
    /// Of the learner's budget: falls back where a learner begins again.
    pub done: u64,
    /// Updates after which it ends.
    pub budget: u64,
    /// Steps of environments.
    pub env_steps: u64,
    /// Time spent training, s.
    pub seconds: f64,
    /// Share of each phase in the time of training.
    pub phases: Vec<(&'static str, f64)>,
    /// Figures of the update.
    pub last: &'a Update,
    /// The newest line of the log, and whether it is of this update.
    pub line: Option<(&'a Line, bool)>,
    /// The newest evaluation.
    pub evaluation: Option<&'a Evaluation>,
}

/// What a run came to.
#[derive(Debug)]
pub struct TrainResult {
    /// Evaluation of the policy as it is now.
    pub evaluation: Evaluation,
    /// Ready to fly.
    pub policy: Policy,
    /// Updates done.
    pub updates: u64,
    /// Steps of environments.
    pub env_steps: u64,
    /// Time spent training, s, without evaluations.
    pub seconds: f64,
    /// Lines of the log: all of the first [`CURVE`](super::log::CURVE), evenly thinned beyond them. The files hold all.
    pub curve: Vec<Line>,
    /// Whether it was asked to stop before its end.
    pub stopped: bool,
    /// The newest checkpoint.
    pub checkpoint: Option<PathBuf>,
}

impl Trainer {
    /// A run from random weights, kept nowhere; the clock starts.
    ///
    /// # Errors
    /// As [`TrainConfig::validate`], [`registry::by_name`], and the learner's; [`Error::Value`] for settings of another
    /// task.
    pub fn new(task: &str, config: TrainConfig, threads: Threads) -> Result<Self> {
        let clock = Clock::new();
        config.validate()?;
        let task = registry::by_name(task)?.name;
        if !config.task.is_empty() && !config.task.eq_ignore_ascii_case(task) {
            let remedy = format!("Train {}, or take settings of {task}.", config.task);
            return Err(Error::value("task of the settings", config.task, format!("{task}, which is trained"), remedy));
        }
        let env = registry::by_name(task)?.pinned(config.env)?;
        let config = TrainConfig { task: task.into(), env, ..config };
        let learner = config.learner(task, &threads)?;
        let since = Since::new(0, 0.0);
        let difficulty = difficulty(task, &config)?;
        let (curve, evaluation, files) = (Curve::default(), None, None);
        let phases = Phases::default();
        let (update, earlier_steps) = (0, 0);
        Ok(Self {
            task,
            config,
            threads,
            learner,
            difficulty,
            earlier_steps,
            update,
            clock,
            phases,
            since,
            curve,
            evaluation,
            other_instructions: None,
            files,
        })
    }

    /// Keeps the run in `folder`. With `resume`, goes on from the newest whole checkpoint there, or begins if there is
    /// none.
    ///
    /// # Errors
    /// [`Error::Value`] for a folder with files of another kind, without `resume` if there is a run already, with it if that has other
    /// settings (number of updates, logs, evaluations and checkpoints may differ) or is longer, and if another process writes there;
    /// [`Error::Format`] if no checkpoint is whole; [`Error::Limit`] if the disk has no room for what they keep; [`Error::File`] if it
    /// refuses.
    pub fn in_folder(mut self, folder: impl AsRef<Path>, resume: bool) -> Result<Self> {
        let folder = folder.as_ref();
        if !resume && is_run(folder) {
            let remedy = "Go on with it (--resume), replace it (--force), or name another folder.";
            let value = format!("'{}', which holds a run already", folder.display());
            return Err(Error::value("folder of the run", value, "new", remedy));
        }
        check_own(folder)?;
        if !is_run(folder) {
            // before a folder is made; a run that is there may outlive what it began from
            self.config.validate_from()?;
        }
        let known = Store::open(folder).and_then(|store| store.updates()).map_or(0, |updates| updates.len());
        // the oldest goes when the newest is there
        check_room(folder, self.learner.kept_bytes(), (self.config.checkpoint.keep + 1).saturating_sub(known))?;
        let mut writer = Store::open_to_write(folder, self.config.checkpoint.keep)?;
        let found = writer.latest()?;
        let skipped = match found {
            None => Vec::new(),
            Some(found) => {
                self.go_on(&found.checkpoint, &found.folder, folder)?;
                found.skipped
            }
        };
        let text = self.config.to_toml()?;
        write_text(&folder.join("config.toml"), &text)?;
        let (log, lines) = Log::open(folder, self.update, self.config.tensorboard)?;
        self.curve = lines;
        let saved = (self.update > 0).then_some(self.update);
        let last = (Instant::now(), Duration::ZERO);
        self.files = Some(Files { folder: folder.to_path_buf(), log, writer, saved, skipped, last });
        Ok(self)
    }

    fn go_on(&mut self, checkpoint: &Checkpoint, at: &Path, folder: &Path) -> Result<()> {
        let Checkpoint { manifest, policy, state } = checkpoint;
        let file = at.join("manifest.json").display().to_string();
        let then = TrainConfig::from_toml(&manifest.config, &file)?;
        let differences = then.differences(&self.config)?;
        if !differences.is_empty() {
            return Err(Error::Format {
                file,
                place: "settings of the run".into(),
                rule: format!("they differ from those that it was begun with ({})", described(&differences)),
                remedy: "Repeat its options, or train in another folder.".into(),
            });
        }
        [policy, state].into_iter().try_for_each(|tensors| state::check_sense(tensors, &file))?;
        // who is done needs no teacher any more
        if self.config.algorithm.is_taught() && (1..self.config.updates()).contains(&manifest.update) {
            let go_on = &mut |_: &RunProgress<'_>| ControlFlow::Continue(());
            let from = predecessor(&self.config, Some(&folder.join(FROM)), &self.threads, go_on)?;
            self.teach(from)?;
        }
        self.learner.load(policy, state)?;
        if let Some(difficulty) = &mut self.difficulty {
            difficulty.load(state)?;
        }
        if state.tensor(EARLIER).is_ok() {
            self.earlier_steps = state.get::<u64>(EARLIER, &[1])?[0];
        }
        let (done, budget) = (self.done(), self.budget());
        if done > budget {
            let limit = format!("≥ {done}, the updates of the run in {file}");
            let remedy = "Give at least as many updates, or train in another folder.";
            return Err(Error::value("number of updates", budget, limit, remedy));
        }
        (self.update, self.clock.before) = (manifest.update, manifest.seconds);
        let others = rounds_twice(&manifest.instructions) != rounds_twice(&native::instructions());
        self.other_instructions = others.then(|| manifest.instructions.clone());
        self.since = Since::new(self.env_steps(), manifest.seconds);
        Ok(())
    }

    /// Updates so far, repeated ones included.
    pub fn update(&self) -> u64 {
        self.update
    }

    /// Of the learner's budget: falls back where a learner begins again.
    pub fn done(&self) -> u64 {
        self.learner.n_update()
    }

    /// Updates after which it ends.
    pub fn budget(&self) -> u64 {
        self.learner.budget()
    }

    /// Whether there is nothing left to train.
    pub fn is_over(&self) -> bool {
        self.done() >= self.budget()
    }

    /// Settings of the run.
    pub fn config(&self) -> &TrainConfig {
        &self.config
    }

    /// Bytes that steps which are kept to be learnt from take in each checkpoint; 0 for learners that keep none.
    pub fn kept_bytes(&self) -> u64 {
        self.learner.kept_bytes()
    }

    /// Checkpoints that were damaged when the run went on.
    pub fn skipped(&self) -> &[SkippedCheckpoint] {
        self.files.as_ref().map_or(&[], |files| &files.skipped)
    }

    /// Folders of old checkpoints that were to be removed and stay, since they hold files that this crate did not write.
    pub fn spared(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().flat_map(|files| files.writer.spared())
    }

    /// Why a resumed run differs in its last bits from one that was never stopped: a processor of another kind rounds sums elsewhere.
    /// `None` where it does not differ.
    pub fn differs(&self) -> Option<String> {
        let then = self.other_instructions.as_ref()?;
        Some(format!(
            "begun with {then}, goes on with {}: the bits differ from those of one machine",
            native::instructions()
        ))
    }

    /// Trains to the end of the budget, or until `watch` breaks; then evaluates and saves. May be called again.
    ///
    /// # Errors
    /// As the environment's, [`Error::File`] if the disk refuses, [`Error::Value`] if the policy is not finite. The
    /// checkpoints of before remain.
    pub fn run(&mut self, watch: &mut Watch<'_>) -> Result<TrainResult> {
        self.run_until(u64::MAX, watch)
    }

    /// As [`Trainer::run`], but for a pause after `until` updates of the learner's budget: schedules are those of the whole
    /// budget, and who goes on comes to the same bits as without a pause.
    ///
    /// # Errors
    /// As there; [`Error::Value`] for a run that is beyond `until` already.
    pub fn run_until(&mut self, until: u64, watch: &mut Watch<'_>) -> Result<TrainResult> {
        if self.done() > until {
            let remedy = "Give at least as many, or train in another folder.";
            return Err(Error::value("updates at which to pause", until, format!("≥ {}", self.done()), remedy));
        }
        let mut stopped = self.begin(watch)? || !self.is_over() && self.done() == until;
        let at_work = AtWork::begin();
        while !stopped && !self.is_over() {
            let mut last = self.learner.update()?;
            self.update += 1;
            self.move_difficulty(&mut last)?;
            self.since.add(&last);
            last.phases.iter().for_each(|(name, time)| self.phases.add(name, *time));
            self.keep(&last)?;
            if at_work.is_asked() {
                let left = self.leave();
                at_work.rest(left);
            }
            stopped = watch(&self.progress(&last)).is_break() || !self.is_over() && self.done() == until;
            if stopped && self.since.updates > 0 {
                self.log(&last, None)?;
            }
        }
        self.finish(stopped)
    }

    /// Saves before the process ends.
    fn leave(&mut self) -> RunLeft {
        let Some(saved) = self.files.as_ref().map(|files| files.saved) else {
            return RunLeft::Lost(format!("a run of {} is kept nowhere", self.task));
        };
        let kept = if saved == Some(self.update) { Ok(()) } else { self.save() };
        match kept {
            Ok(()) => RunLeft::Saved(self.folder().map(Path::to_path_buf).unwrap_or_default(), self.update),
            Err(error) => RunLeft::Lost(error.to_string()),
        }
    }

    /// Takes the weights of the policy to begin from, where there is one and nothing is learnt yet. Gives whether its training
    /// was asked to stop.
    fn begin(&mut self, watch: &mut Watch<'_>) -> Result<bool> {
        if self.config.from.is_empty() || self.update > 0 {
            return Ok(false);
        }
        let env = Env::make(self.task, &EnvConfig { n_env: 1, ..self.config.seen_env() })?;
        let actor = self.config.algorithm.actor(env.spec())?;
        if self.config.from == SAFE {
            let own = self.learner.policy()?;
            self.learner.warm_start(&WarmStart::at(&actor, own.parameters(), &env)?)?;
            return Ok(false);
        }
        let begun = Instant::now();
        let folder = self.folder().map(|folder| folder.join(FROM));
        let from = predecessor(&self.config, folder.as_deref(), &self.threads, watch)?;
        if from.stopped {
            // its time and steps count when it is done
            self.clock.pause(begun.elapsed());
            return Ok(true);
        }
        let (seconds, env_steps) = (from.seconds, from.env_steps);
        if self.config.algorithm.is_taught() {
            self.teach(from)?;
        } else {
            self.learner.warm_start(&WarmStart::new(&from.policy, &from.spec, &actor, env.spec())?)?;
        }
        self.clock.pause(begun.elapsed());
        self.clock.before += seconds;
        self.earlier_steps = env_steps;
        self.since = Since::new(self.env_steps(), self.clock.seconds());
        Ok(false)
    }

    fn teach(&mut self, teacher: Predecessor) -> Result<()> {
        self.learner.teach(teacher.policy, &teacher.spec, &|config| Env::make(self.task, config))
    }

    /// The curriculum behind an update, and its figure in the log.
    fn move_difficulty(&mut self, last: &mut Update) -> Result<()> {
        let Some(difficulty) = &mut self.difficulty else { return Ok(()) };
        let progress = self.learner.n_update() as f64 / self.learner.budget().max(1) as f64;
        if difficulty.take(&last.episodes, progress) {
            self.learner.set_difficulty(difficulty.share())?;
        }
        last.extra.push(("difficulty", difficulty.share()));
        Ok(())
    }

    /// Steps of environments, with those of the policy it began from.
    fn env_steps(&self) -> u64 {
        self.earlier_steps + self.learner.env_steps()
    }

    /// Evaluates, logs and saves after an update, where it is time.
    fn keep(&mut self, last: &Update) -> Result<()> {
        let (update, done) = (self.update, self.is_over());
        let due = |every: u64| done || every > 0 && update.is_multiple_of(every);
        let evaluated = due(self.config.evaluate.every);
        if evaluated {
            self.evaluation = Some(self.evaluate()?);
        }
        let saves = due(self.config.checkpoint.every) && self.files.is_some();
        let seconds = self.config.checkpoint.seconds;
        let late = self.files.as_ref().is_some_and(|files| files.is_due(seconds));
        if evaluated || saves || due(self.config.log_every) {
            let figures = self.evaluation.clone().filter(|_| evaluated);
            self.log(last, figures.as_ref())?;
        }
        if saves || late {
            self.save()?;
        }
        Ok(())
    }

    fn finish(&mut self, stopped: bool) -> Result<TrainResult> {
        let last = self.curve.newest().is_some_and(|l| l.get("eval_success").is_some());
        let evaluation = match self.evaluation.clone().filter(|_| last) {
            Some(known) => known,
            None => self.evaluate()?,
        };
        self.evaluation = Some(evaluation.clone());
        if self.files.as_ref().is_some_and(|files| files.saved != Some(self.update)) {
            self.save()?;
        }
        let newest = |files: &Files| Some(files.writer.store().path(files.saved?));
        Ok(TrainResult {
            evaluation,
            policy: self.learner.policy()?,
            updates: self.update,
            env_steps: self.env_steps(),
            seconds: self.clock.seconds(),
            curve: self.curve.lines().to_vec(),
            stopped,
            checkpoint: self.files.as_ref().and_then(newest),
        })
    }

    fn evaluate(&mut self) -> Result<Evaluation> {
        let begun = Instant::now();
        let starts = Starts { n_env: self.config.evaluate.envs, seed: self.config.evaluate.seed };
        let mut policy = self.learner.policy()?;
        let told = evaluate(&mut policy, self.task, &self.config.seen_env(), starts, &self.threads, &mut |_| {});
        self.clock.pause(begun.elapsed());
        told
    }

    fn log(&mut self, last: &Update, evaluation: Option<&Evaluation>) -> Result<()> {
        let (steps, seconds) = (self.env_steps(), self.clock.seconds());
        let line = self.since.line(self.update, steps, seconds, last, evaluation);
        if let Some(files) = &mut self.files {
            files.log.write(&line)?;
        }
        self.curve.push(line);
        self.since = Since::new(steps, seconds);
        Ok(())
    }

    fn save(&mut self) -> Result<()> {
        let begun = Instant::now();
        let (mut policy, mut state) = (Tensors::new(), Tensors::new());
        let own = self.learner.policy()?;
        self.learner.save(&mut policy, &mut state)?;
        put_policy(&own, &mut policy, &mut state)?;
        put_task(self.task, &self.config.env, &mut state)?;
        if let Some(difficulty) = &self.difficulty {
            difficulty.save(&mut state)?;
        }
        if self.earlier_steps > 0 {
            state.insert(EARLIER, &[1], vec![self.earlier_steps])?;
        }
        let mut manifest = Manifest {
            algorithm: self.config.algorithm.name().into(),
            task: self.task.into(),
            spec_hash: own.spec_hash(),
            config: self.config.to_toml()?,
            seed: self.config.seed,
            update: self.update,
            env_steps: self.env_steps(),
            seconds: self.clock.seconds(),
            ..Manifest::default()
        };
        if let Some(e) = &self.evaluation {
            manifest.extra.insert("evaluation".into(), json!(e));
        }
        if let Some(files) = &mut self.files {
            files.log.sync()?;
            files.writer.save(&Checkpoint { manifest, policy, state })?;
            files.saved = Some(self.update);
            files.last = (Instant::now(), begun.elapsed());
        }
        self.phases.add(SAVE, begun.elapsed());
        self.since.phases.add(SAVE, begun.elapsed());
        Ok(())
    }

    fn progress<'a>(&'a self, last: &'a Update) -> RunProgress<'a> {
        let newest = self.curve.newest();
        RunProgress {
            config: &self.config,
            update: self.update,
            done: self.done(),
            budget: self.budget(),
            env_steps: self.env_steps(),
            seconds: self.clock.seconds(),
            phases: self.phases.shares(),
            last,
            line: newest.map(|line| (line, line.get("update") == Some(self.update as f64))),
            evaluation: self.evaluation.as_ref(),
        }
    }

    /// Where the run is kept.
    pub fn folder(&self) -> Option<&Path> {
        self.files.as_ref().map(|files| files.folder.as_path())
    }
}

/// Whether a folder holds a run.
pub(super) fn is_run(folder: &Path) -> bool {
    let begun = |name: &str| folder.join(name).metadata().is_ok_and(|m| m.len() > 0);
    begun(super::log::JSON) || Store::open(folder).and_then(|s| s.updates()).is_ok_and(|u| !u.is_empty())
}

/// Refuses a folder whose files would be overwritten, though no run wrote them.
fn check_own(folder: &Path) -> Result<()> {
    let names = ["config.toml", super::log::JSON, super::log::CSV, super::tensorboard::EVENTS];
    let foreign = names.into_iter().find(|name| folder.join(name).symlink_metadata().is_ok());
    let Some(name) = foreign.filter(|_| !folder.join("checkpoints").is_dir()) else { return Ok(()) };
    let value = format!("'{}', whose {name} is of no run", folder.display());
    Err(Error::value("folder of the run", value, "new, empty or that of a run", "Name another folder."))
}

/// The curriculum of a run, where it has one.
fn difficulty(task: &str, config: &TrainConfig) -> Result<Option<Difficulty>> {
    if !config.curriculum.is_on() {
        return Ok(None);
    }
    let env = Env::make(task, &EnvConfig { n_env: 1, ..config.env.clone() })?;
    let largest = env.spec().reward_bound * env.spec().horizon as f64;
    if config.curriculum.good == GoodEpisode::Return {
        let limit = match config.env.truncate_after {
            _ if !(largest.is_finite() && largest > 0.0) => Some("of a task whose reward has a largest value above 0"),
            0 => None,
            _ => Some("of whole episodes, without env.truncate_after"),
        };
        if let Some(limit) = limit {
            let value = format!("return, up to {largest}");
            return Err(Error::value("curriculum.good", value, limit, "Take \"survival\"."));
        }
    }
    Ok(Some(Difficulty::new(&config.curriculum, largest)))
}

fn write_text(path: &Path, text: &str) -> Result<()> {
    file_gate::replace(path, text)
}

/// Time spent training.
struct Clock {
    begun: Instant,
    paused: Duration,
    /// Before the run went on, s.
    before: f64,
}

impl Clock {
    fn new() -> Self {
        Self { begun: Instant::now(), paused: Duration::ZERO, before: 0.0 }
    }

    fn pause(&mut self, time: Duration) {
        self.paused += time;
    }

    fn seconds(&self) -> f64 {
        self.before + self.begun.elapsed().saturating_sub(self.paused).as_secs_f64()
    }
}

/// Writing a checkpoint, as a phase.
const SAVE: &str = "save";

/// Time by what it was spent on.
#[derive(Clone, Default)]
struct Phases(Vec<(&'static str, Duration)>);

impl Phases {
    fn add(&mut self, name: &'static str, time: Duration) {
        match self.0.iter_mut().find(|(own, _)| *own == name) {
            Some((_, sum)) => *sum += time,
            None => self.0.push((name, time)),
        }
    }

    fn shares(&self) -> Vec<(&'static str, f64)> {
        let total: f64 = self.0.iter().map(|(_, time)| time.as_secs_f64()).sum();
        self.0.iter().map(|(name, time)| (*name, time.as_secs_f64() / total.max(1e-12))).collect()
    }
}

/// What happened since the last line of the log.
struct Since {
    updates: u64,
    loss: f64,
    reward: f64,
    gradient_norm: f64,
    episodes: Episodes,
    phases: Phases,
    env_steps: u64,
    seconds: f64,
}

impl Since {
    /// A line at these steps and seconds.
    fn new(env_steps: u64, seconds: f64) -> Self {
        Self {
            updates: 0,
            loss: 0.0,
            reward: 0.0,
            gradient_norm: 0.0,
            episodes: Episodes::default(),
            phases: Phases::default(),
            env_steps,
            seconds,
        }
    }

    fn add(&mut self, update: &Update) {
        self.updates += 1;
        self.loss += update.loss;
        self.reward += update.reward;
        self.gradient_norm += update.gradient_norm;
        self.episodes.add(&update.episodes);
        update.phases.iter().for_each(|(name, time)| self.phases.add(name, *time));
    }

    fn line(&self, update: u64, steps: u64, seconds: f64, last: &Update, evaluation: Option<&Evaluation>) -> Line {
        let mut line = Line::new(update);
        let per_update = |sum: f64| sum / self.updates as f64;
        let Episodes { count, total_return, total_length, crashed, succeeded } = self.episodes;
        // 0/0 where no episode ended: written as missing
        let per_episode = |sum: f64| sum / count as f64;
        let rate = (steps - self.env_steps) as f64 / (seconds - self.seconds);
        let own = [
            ("env_steps", steps as f64),
            ("seconds", seconds),
            ("steps_per_second", rate),
            ("loss", per_update(self.loss)),
            ("reward", per_update(self.reward)),
            ("episodes", count as f64),
            ("return", per_episode(total_return)),
            ("length", per_episode(total_length)),
            ("crashed", per_episode(crashed as f64)),
            ("succeeded", per_episode(succeeded as f64)),
            ("gradient_norm", per_update(self.gradient_norm)),
            ("rate", last.rate),
        ];
        own.into_iter().chain(last.extra.iter().copied()).for_each(|(name, x)| line.put(name, x));
        let figure = |of: fn(&Evaluation) -> f64| evaluation.map_or(f64::NAN, of);
        line.put("eval_return", figure(|e| e.return_mean));
        line.put("eval_share_of_bound", figure(|e| e.share_of_bound));
        line.put("eval_success", figure(|e| e.success));
        line.put("eval_crashed", figure(|e| e.crashed));
        line.put("eval_length", figure(|e| e.length));
        line.put("eval_final_error", figure(|e| e.final_error));
        line.put("eval_mean_error", figure(|e| e.mean_error));
        line.put("eval_command_change", figure(Evaluation::command_change));
        let mut phases = self.phases.clone();
        // a column of every line
        phases.add(SAVE, Duration::ZERO);
        phases.shares().into_iter().for_each(|(name, share)| line.put(format!("time_{name}"), share));
        line
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkpoint_is_late_after_its_seconds_and_takes_a_fiftieth_of_the_time_at_most() {
        let of = |seconds: u64, ago: f64, took: f64| {
            is_late(seconds, Duration::from_secs_f64(ago), Duration::from_secs_f64(took))
        };
        assert!(!of(0, 1e6, 0.0) && !of(60, 59.9, 0.1) && of(60, 60.0, 0.1) && of(60, 60.0, 1.2));
        assert!(!of(60, 60.0, 2.0) && !of(60, 99.9, 2.0) && of(60, 100.0, 2.0));
    }

    #[test]
    fn runs_go_on_alike_on_sets_that_round_alike_however_programs_ran() {
        for set in ["avx512", "avx2", "neon"] {
            for how in ["", " (machine code)", " (interpreted: switched off by OMNIDRONES_NATIVE=off)"] {
                assert!(!rounds_twice(&format!("{set}{how}")), "{set}{how}");
            }
        }
        for other in ["", "scalar", "scalar (interpreted: the processor has no AVX2 with FMA)", "avx", "avx2000"] {
            assert!(rounds_twice(other), "{other}");
        }
    }
}
