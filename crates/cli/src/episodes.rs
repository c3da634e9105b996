//! Episodes that were flown, by whomever: what is seen of them on the way, and what is told of them.

use super::page::plain_facts;
use super::tasks;
use super::trajectories::Trajectories;
use crate::prelude::*;
use omnidrones::rl::planner::PlannerConfig;
use omnidrones::rl::refine::Refined;
use omnidrones::tasks::{Activity, Buffers, Env, Evaluation, EvaluationStep, PolicyFn, Record, Spec, Spread, evaluate};
use omnidrones_viewer::{Episodes, Recording};
use std::cell::RefCell;
use std::time::Instant;

/// Longest episode: each step is kept.
const MAX_STEPS: usize = 100_000;

/// Single environments drawn behind the spread.
const LINES: usize = 16;
/// Episodes that other commands show.
pub const SHOWN: usize = 4;

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

/// What stands behind the mean change of commands; `dt` is the time of a step.
fn activity(e: &Evaluation, dt: f64) -> String {
    let Some(Activity { last_second, fast, .. }) = e.activity else { return String::new() };
    let (last, fast) = (short(last_second, 3), percent(fast));
    format!("per step; {last} in the last second; {fast} of its power above {} Hz", short(0.25 / dt, 3))
}

/// What flew, and how well.
pub struct Flown {
    pub record: Record,
    /// `cascade`, `random`, `planner`.
    pub controller: String,
    pub evaluation: Evaluation,
    /// Of the episode of median change, and of the busiest.
    pub commands: Vec<Commanded>,
    /// The first episodes, where they were to be kept.
    pub trajectories: Trajectories,
    /// How many episodes no controller could be made for, and why.
    pub unflown: Option<String>,
    /// How the planner planned, where it did.
    pub plan: Option<PlannerConfig>,
    /// What more the episodes held, where that was asked for.
    pub refined: Option<Refined>,
    /// By how much the vehicle leans in hover, rad.
    pub lean: f64,
    pub wall_time: f64,
}

impl Flown {
    /// One episode of every environment under `policy`, which is called `controller`; the first `kept` are kept step by step, and
    /// `watch` sees every step.
    pub fn of(
        env: &mut Env,
        policy: &mut PolicyFn<'_>,
        controller: impl Into<String>,
        kept: usize,
        watch: &mut dyn FnMut(&EvaluationStep<'_>),
    ) -> Result<Self> {
        let (mut record, commands, begun) = (Record::new(env, LINES), Commands::new(env, kept)?, Instant::now());
        let evaluation = evaluate(env, &mut commands.of(policy), &mut |watched| {
            record.see(watched);
            commands.see(watched);
            watch(watched);
        })?;
        let (commands, trajectories) = commands.told()?;
        Ok(Self {
            record,
            controller: controller.into(),
            evaluation,
            commands,
            trajectories,
            unflown: None,
            plan: None,
            refined: None,
            lean: env.robot().hover_lean(),
            wall_time: begun.elapsed().as_secs_f64(),
        })
    }

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
            Fact::new("change of commands", short(e.command_change(), 3)).note(activity(e, spec.dt)),
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
        Table::new("metric | >mean | >10 % | >median | >90 % | unit").filled(self.final_spreads().map(
            |(name, unit, s)| {
                let numbers = [s.mean, s.low, s.median, s.high].map(|v| short(v, 3));
                let [mean, low, median, high] = numbers;
                [name.into(), mean, low, median, high, unit.into()]
            },
        ))
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

/// What the first agent commanded in an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Commanded {
    pub environment: usize,
    /// Mean change of a command in a step.
    pub change: f64,
    /// `[step, command]`.
    pub rows: Vec<Vec<f32>>,
}

/// Episodes whose commands are watched.
const WATCHED: usize = 256;

/// Watches what is commanded: the actions of a step are gone when it is over. Keeps the first episodes step by step.
pub struct Commands {
    n_command: usize,
    given: RefCell<Vec<f32>>,
    episodes: RefCell<Vec<Commanded>>,
    kept: RefCell<Trajectories>,
}

impl Commands {
    /// Which keeps so many episodes.
    pub fn new(env: &Env, kept: usize) -> Result<Self> {
        let n_command = env.spec().action.len().min(env.spec().n_action_of(0));
        let kept = RefCell::new(Trajectories::new(env, kept)?);
        let none = |environment| Commanded { environment, change: 0.0, rows: Vec::new() };
        let episodes = RefCell::new((0..env.spec().n_env.min(WATCHED)).map(none).collect());
        Ok(Self { n_command, given: RefCell::default(), episodes, kept })
    }

    /// The policy, watched.
    pub fn of<'a>(&'a self, policy: &'a mut PolicyFn<'_>) -> impl FnMut(&Env, &Buffers, &mut [f32]) -> Result<()> + 'a {
        move |env, out, actions| {
            policy(env, out, actions)?;
            let mut given = self.given.borrow_mut();
            given.clear();
            given.extend_from_slice(actions);
            self.kept.borrow_mut().before(env, out, actions);
            Ok(())
        }
    }

    /// Takes a step in: the commands of episodes that it belonged to.
    pub fn see(&self, watched: &EvaluationStep<'_>) {
        self.kept.borrow_mut().after(watched);
        let (given, mut episodes) = (self.given.borrow(), self.episodes.borrow_mut());
        let each = given.len() / watched.flying.len().max(1);
        for episode in episodes.iter_mut().filter(|episode| watched.flying[episode.environment]) {
            episode.rows.push(given[episode.environment * each..][..self.n_command].to_vec());
        }
    }

    /// Commands in the episode of median change and in the busiest, and the episodes that were kept.
    pub fn told(self) -> Result<(Vec<Commanded>, Trajectories)> {
        let mut episodes = self.episodes.into_inner();
        for Commanded { change, rows, .. } in &mut episodes {
            let steps = rows.windows(2).flat_map(|two| two[0].iter().zip(&two[1]));
            let sum: f64 = steps.map(|(before, now)| f64::from((now - before).abs())).sum();
            *change = sum / (rows.len().saturating_sub(1) * self.n_command).max(1) as f64;
        }
        episodes.sort_by(|a, b| a.change.total_cmp(&b.change));
        let busiest = episodes.pop();
        let median = (!episodes.is_empty()).then(|| episodes.swap_remove(episodes.len() / 2));
        Ok((median.into_iter().chain(busiest).collect(), self.kept.into_inner().checked()?))
    }
}

/// Whether every step of an episode can be kept.
pub fn check_horizon(env: &Env) -> Result<()> {
    let horizon = env.spec().horizon;
    if horizon <= MAX_STEPS {
        return Ok(());
    }
    let limit = format!("1 to {MAX_STEPS} steps");
    Err(Error::limit("horizon", horizon, limit, "Every step is recorded: fly shorter ones."))
}

/// What is recorded of episodes while they are flown.
pub struct Seen {
    most: usize,
    episodes: Option<Episodes>,
    refused: Option<Error>,
}

impl Seen {
    /// Of the first `most` environments; of none, nothing is done.
    pub fn new(most: usize) -> Self {
        Self { most, episodes: None, refused: None }
    }

    /// Sees a step; whether a frame came of it.
    pub fn see(&mut self, watched: &EvaluationStep<'_>) {
        let _ = self.frame(watched);
    }

    /// As [`see`](Self::see), and whether a frame came of it.
    pub fn frame(&mut self, watched: &EvaluationStep<'_>) -> bool {
        if self.most == 0 || self.refused.is_some() {
            return false;
        }
        self.seen(watched).unwrap_or_else(|error| {
            self.refused = Some(error);
            false
        })
    }

    fn seen(&mut self, watched: &EvaluationStep<'_>) -> Result<bool> {
        if watched.step == 1 {
            self.episodes = Some(Episodes::new(watched.env, self.most)?);
        }
        self.episodes.as_mut().map_or(Ok(false), |episodes| episodes.see(watched))
    }

    /// What was recorded up to now.
    pub fn so_far(&self) -> Option<&Recording> {
        self.episodes.as_ref().and_then(Episodes::so_far)
    }

    /// The recording, with who flew and how well.
    pub fn recording(self, flown: &Flown) -> Result<Recording> {
        if let Some(error) = self.refused {
            return Err(error);
        }
        let Some(mut recording) = self.episodes.and_then(Episodes::recording) else {
            return Err(Error::value("recording", "empty", "at least one step", "Fly longer episodes."));
        };
        recording.title = flown.title();
        recording.remark = flown.headline();
        recording.facts = plain_facts(&flown.facts());
        Ok(recording)
    }
}
