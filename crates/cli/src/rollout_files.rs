//! How commands tell of episodes: which are asked for; figures, and every step and episode as CSV.

use super::arguments::{OutputArguments, ThreadArguments};
use super::environment::EnvArguments;
use super::episodes::{Commanded, Flown, SHOWN, Seen};
use super::files::write_table;
use crate::prelude::*;
use omnidrones::tasks::{ActionSpace, Column, EvaluationStep, Record, RecordedStep};
use omnidrones_plot::{Colour, Figure, Panel, Series};
use omnidrones_viewer::page;

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
    #[cfg_attr(not(feature = "mcap"), arg(hide = true))]
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
        cfg!(feature = "mcap") && self.mcap
    }
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
        fly: impl FnOnce(usize, &mut dyn FnMut(&EvaluationStep<'_>)) -> Result<Flown>,
    ) -> Result<Report> {
        let EpisodeArguments { output, csv, npz, replay, .. } = arguments;
        crate::arguments::check_mcap(arguments.mcap)?;
        let logs = *csv || *npz || arguments.mcap();
        let mut outputs = output.open(self.usual, logs || *replay)?;
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
        outputs.draw(self.command, || figure(&flown))?;
        if *csv {
            outputs.put("steps.csv", |path| write_steps(&flown.record, path))?;
            outputs.put("episodes.csv", |path| write_episodes(&flown.record, path))?;
            outputs.put("trajectories.csv", |path| flown.trajectories.write_csv(path))?;
        }
        if *npz {
            outputs.put("trajectories.npz", |path| flown.trajectories.write_npz(path))?;
        }
        #[cfg(feature = "mcap")]
        if arguments.mcap {
            let recording = logged.recording(&flown)?;
            outputs.put("trajectories.mcap", |path| flown.trajectories.write_mcap(path, &recording))?;
        }
        if *replay {
            outputs.text(files::REPLAY, page(&flown.title(), &[seen.recording(&flown)?]))?;
        }
        let written = outputs.done(|name| name == self.command)?;
        Ok(Report::told(output.json, true, || flown.json(self.command, self.by, &written), || flown.page(&written)))
    }
}

/// A median that ends below its largest value by more than this needs a logarithmic axis.
const FALL: f64 = 40.0;
/// Least share of the episodes over which a spread is drawn.
const ENOUGH: f64 = 0.1;

/// One task: its error, its returns, its reward, its commands.
pub fn figure(flown: &Flown) -> Figure {
    let record = &flown.record;
    let height = if record.steps.iter().any(|s| s.n_flying < record.spec().n_env) { 0.45 } else { 0.0 };
    let mut rows = vec![1.15, 1.0, 0.8];
    if height > 0.0 {
        rows.insert(1, height);
    }
    let last = rows.len() - 2;
    let mut figure =
        Figure::new(format!("{}: {} episodes, flown by {}", flown.task(), record.spec().n_env, flown.controller))
            .subtitle(flown.headline())
            .size(1000.0, 760.0 + 300.0 * height)
            .grid(&[1.0, 1.0], &rows)
            .place((0, 0), (2, 1), error(record))
            .place((0, last), (1, 1), returns(record))
            .place((1, last), (1, 1), reward(record));
    let which: &[&str] =
        if flown.commands.len() == 1 { &["the only one"] } else { &["of median change", "the busiest"] };
    let width = 2 / which.len();
    for (i, (episode, which)) in flown.commands.iter().zip(which).enumerate() {
        figure = figure.place((i, last + 1), (width, 1), commands(flown, which, episode));
    }
    if height > 0.0 {
        figure = figure.place((0, 1), (2, 1), flying(record));
    }
    figure
}

/// Name of the task's first metric as people write it, with its unit.
fn error_label(record: &Record) -> (String, String) {
    let info = &record.spec().info[record.first_metric()];
    (info.name.replace('_', " "), info.unit.clone())
}

fn error(record: &Record) -> Panel {
    let (name, unit) = error_label(record);
    let title = name[..1].to_uppercase() + &name[1..];
    let dt = record.spec().dt;
    let mut panel = Panel::new(title, "time [s]", format!("{name} [{unit}]")).from_zero();
    let median: Vec<(f64, f64)> = crowded(record).map(|s| (s.time, s.metrics[0].median)).collect();
    let spread = crowded(record).map(|s| (s.time, s.metrics[0].low, s.metrics[0].high)).collect();
    let largest = median.iter().map(|p| p.1).fold(0.0, f64::max);
    if median.last().is_some_and(|end| end.1 > 0.0 && largest > FALL * end.1) {
        panel = panel.log_y();
    }
    panel = panel.ribbon("10 to 90 % of the episodes that go on", spread, Colour::BLUE);
    for (i, line) in record.lines.iter().enumerate() {
        let points = line.iter().enumerate().map(|(k, e)| ((k + 1) as f64 * dt, f64::from(*e))).collect();
        let name = if i == 0 { "single episodes" } else { "" };
        panel = panel.series(Series::line(name, points).colour(Colour::SKY).width(0.5));
    }
    if let Some(limit) = limit(record) {
        panel = panel.level(format!("limit of a success, {limit} {unit}"), limit, Colour::GREEN);
    }
    whole_time(panel.series(Series::line("median", median).colour(Colour::BLUE).width(2.0)), record)
}

/// The limit that a task's success sets on its first metric, if it sets one.
fn limit(record: &Record) -> Option<f64> {
    let spec = record.spec();
    let own = &spec.info.get(record.first_metric())?.name;
    spec.success.limits.iter().find(|limit| limit.metric == *own).map(|limit| limit.below).filter(|x| x.is_finite())
}

/// What the first agent commands in an episode: a median over episodes hides commands that jump.
fn commands(flown: &Flown, which: &str, episode: &Commanded) -> Panel {
    let (record, names) = (&flown.record, &flown.record.spec().commands);
    let change = short(episode.change, 2);
    let title = format!("Commands in episode {}, {which} ({change} per step)", episode.environment);
    let mut panel = Panel::new(title, "time [s]", "command [-]");
    let (n, dt) = (episode.rows.first().map_or(0, Vec::len), record.spec().dt);
    for k in 0..n {
        let points = episode.rows.iter().enumerate().map(|(t, row)| (t as f64 * dt, f64::from(row[k]))).collect();
        let name = if n == names.len() && n <= NAMED { names[k].as_str() } else { "" };
        panel = panel.series(Series::line(name, points).colour(Colour::nth(k)).width(1.0));
    }
    let continuous = record.spec().config.actions == ActionSpace::Continuous;
    whole_time(if continuous { panel.y_range(-1.05, 1.05) } else { panel }, record)
}

/// Up to so many commands have a name.
const NAMED: usize = 12;

/// Steps that enough episodes share.
fn crowded(record: &Record) -> impl Iterator<Item = &RecordedStep> {
    let least = ENOUGH * record.spec().n_env as f64;
    record.steps.iter().filter(move |s| s.n_flying as f64 >= least)
}

/// From the start to the last step.
fn whole_time(panel: Panel, record: &Record) -> Panel {
    panel.x_range(0.0, record.steps.last().map_or(1.0, |s| s.time))
}

fn flying(record: &Record) -> Panel {
    let n = record.spec().n_env as f64;
    let share = record.steps.iter().map(|s| (s.time, 100.0 * s.n_flying as f64 / n)).collect();
    let panel = Panel::new("Episodes that go on", "time [s]", "share [%]").y_range(0.0, 105.0);
    whole_time(panel.series(Series::line("", share).colour(Colour::VERMILLION)), record)
}

fn returns(record: &Record) -> Panel {
    let spec = record.spec();
    let mut returns = record.spec().column(Column::Return).map_or_else(Vec::new, |k| record.ended(k));
    returns.sort_by(|a, b| f32::total_cmp(b, a));
    let n = returns.len() as f64;
    let points = returns.iter().enumerate().map(|(i, r)| (100.0 * (i as f64 + 0.5) / n, f64::from(*r))).collect();
    let best = spec.reward_bound * spec.horizon as f64;
    Panel::new("Returns, best first", "share of the episodes [%]", "return")
        .from_zero()
        .x_range(0.0, 100.0)
        .series(Series::line("return", points).colour(Colour::BLUE).width(1.8))
        .level("bound", best, Colour::GREY)
}

fn reward(record: &Record) -> Panel {
    let mut panel = Panel::new("Reward per step by term", "time [s]", "reward").from_zero();
    for (k, term) in record.spec().reward.iter().enumerate() {
        let points = crowded(record).map(|s| (s.time, s.terms[k])).collect();
        panel = panel.series(Series::line(term.name.as_str(), points));
    }
    whole_time(panel, record)
}

/// A line per step, over the episodes that go on.
pub fn write_steps(record: &Record, path: &Path) -> Result<()> {
    let rows = record.steps.iter().map(|s| {
        let spreads = s.metrics.iter().flat_map(|m| [m.mean, m.low, m.median, m.high]);
        let numbers = [s.time, s.n_flying as f64, s.reward].into_iter().chain(s.terms.iter().copied()).chain(spreads);
        numbers.map(|x| x.to_string()).collect()
    });
    write_table(path, step_header(record), rows)
}

/// A line per episode.
pub fn write_episodes(record: &Record, path: &Path) -> Result<()> {
    let spec = record.spec();
    let units = spec.info.iter().map(|i| format!("{} [{}]", i.name, i.unit));
    let header = ["environment".to_string(), "ended_by".into()].into_iter().chain(units).collect();
    let ends = (0..spec.n_env).map(|i| record.why(i)).collect::<Result<Vec<_>>>()?;
    let rows = record.last.chunks_exact(spec.info.len()).zip(ends).enumerate();
    write_table(
        path,
        header,
        rows.map(|(i, (row, end))| {
            [i.to_string(), end.into()].into_iter().chain(row.iter().map(f32::to_string)).collect()
        }),
    )
}

fn step_header(record: &Record) -> Vec<String> {
    let spec = record.spec();
    let mut header = vec!["time [s]".into(), "flying [-]".into(), "reward [-]".into()];
    header.extend(spec.reward.iter().map(|t| format!("reward_{} [-]", t.name)));
    for info in &spec.info[record.first_metric()..] {
        header.extend(["mean", "p10", "median", "p90"].map(|what| format!("{}_{what} [{}]", info.name, info.unit)));
    }
    header
}
