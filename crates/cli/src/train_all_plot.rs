//! The learning curves of `train-all`: success over environment steps, a panel per task.

use super::train_plot::{Steps, with};
use crate::prelude::*;
use omnidrones::rl::log::Line;
use omnidrones::rl::runs::SeedSummary;
use omnidrones_plot::{Colour, Figure, Panel, Series};

/// Most panels side by side.
const MOST_COLUMNS: usize = 4;

/// What is drawn of a task.
pub struct Learnt<'a> {
    pub task: &'a str,
    pub algorithm: &'a str,
    /// The log of every seed.
    pub runs: Vec<&'a [Line]>,
    /// Share of successes of our controller, where there is one.
    pub controller: Option<f64>,
}

/// As large as the number of its panels asks for.
pub fn figure(tasks: &[Learnt<'_>]) -> Figure {
    let panels: Vec<Panel> = tasks.iter().map(panel).filter(|panel| !panel.series.is_empty()).collect();
    let columns = columns(panels.len());
    let rows = panels.len().div_ceil(columns).max(1);
    let (width, height) = (280.0 * columns as f64 + 200.0, 60.0 + 230.0 * rows as f64);
    let mut figure = Figure::new("Learning curves")
        .subtitle(key(tasks))
        .size(width, height)
        .grid(&vec![1.0; columns], &vec![1.0; rows]);
    for (k, panel) in panels.into_iter().enumerate() {
        figure = figure.place((k % columns, k / columns), (1, 1), panel);
    }
    figure
}

/// The number of columns, up to the most, that leaves the fewest places empty; about a square.
pub fn columns(n: usize) -> usize {
    let least = (1..MOST_COLUMNS).find(|c| c * c >= n).unwrap_or(MOST_COLUMNS);
    (least..=MOST_COLUMNS).min_by_key(|c| n.div_ceil(*c) * c - n).unwrap_or(MOST_COLUMNS)
}

/// What lines mean: said once, since all panels share it.
fn key(tasks: &[Learnt<'_>]) -> String {
    let mut parts = vec!["success from held-out starts"];
    if tasks.iter().any(|task| task.runs.len() > 1) {
        parts.extend(["thick: mean over seeds", "thin: its 95 % confidence interval"]);
    }
    if tasks.iter().any(|task| task.controller.is_some()) {
        parts.push("dashed: our controller");
    }
    parts.join("   ·   ")
}

fn panel(task: &Learnt<'_>) -> Panel {
    let steps = Steps::of(task.runs.iter().copied().flatten());
    let title = format!("{}: {}, trained in {}", task.task, task.algorithm, duration(seconds(&task.runs)));
    let mut panel = steps.panel(title, "success [%]").y_range(-2.0, 104.0);
    let lines = over_seeds(&task.runs);
    for edge in ["low", "high"] {
        let points = steps.points(&lines, edge, 100.0);
        if !points.is_empty() {
            panel = panel.series(Series::line("", points).colour(Colour::SKY).width(0.8));
        }
    }
    let middle = steps.points(&lines, "eval_success", 100.0);
    panel = with(panel, Series::line("", middle).colour(Colour::BLUE).width(1.8));
    if let Some(success) = task.controller {
        panel = panel.level("", 100.0 * success, Colour::GREEN);
    }
    steps.align(panel)
}

/// Median time of training, s.
fn seconds(runs: &[&[Line]]) -> f64 {
    median(runs.iter().filter_map(|run| run.last()?.get("seconds")).collect())
}

/// Mean steps and success, and the edges of the interval of the latter, at the updates after which at least half of the runs
/// were evaluated.
pub fn over_seeds(runs: &[&[Line]]) -> Vec<Line> {
    let mut updates: Vec<u64> = runs.iter().flat_map(|run| run.iter().filter_map(evaluated)).collect();
    updates.sort_unstable();
    updates.dedup();
    updates.into_iter().filter_map(|update| line_of(runs, update)).collect()
}

fn line_of(runs: &[&[Line]], update: u64) -> Option<Line> {
    let lines: Vec<&Line> =
        runs.iter().filter_map(|run| run.iter().find(|line| evaluated(line) == Some(update))).collect();
    let of = |column| SeedSummary::of(&lines.iter().filter_map(|line| line.get(column)).collect::<Vec<_>>());
    let (steps, success) = (of("env_steps")?, of("eval_success")?);
    let mut line = Line::new(update);
    line.put("env_steps", steps.mean);
    line.put("eval_success", success.mean);
    if let Some(half) = success.half_width {
        line.put("low", (success.mean - half).max(0.0));
        line.put("high", (success.mean + half).min(1.0));
    }
    (2 * lines.len() >= runs.len()).then_some(line)
}

/// The update of a line that has an evaluation.
fn evaluated(line: &Line) -> Option<u64> {
    line.get("eval_success").and(line.get("update")).map(|update| update as u64)
}

/// The value in the middle, or the mean of the two there; NaN of none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n == 0 { f64::NAN } else { 0.5 * (values[(n - 1) / 2] + values[n / 2]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(successes: &[(u64, f64)]) -> Vec<Line> {
        let line = |(update, success): &(u64, f64)| {
            let mut line = Line::new(*update);
            line.put("env_steps", 100.0 * *update as f64);
            line.put("eval_success", *success);
            line
        };
        successes.iter().map(line).collect()
    }

    #[test]
    fn panels_are_arranged_about_in_a_square_with_few_empty_places() {
        let arranged: Vec<usize> = (0..=10).map(columns).collect();
        assert_eq!(arranged, [1, 1, 2, 3, 2, 3, 3, 4, 4, 3, 4]);
        assert_eq!((columns(21), columns(100)), (4, 4));
    }

    #[test]
    fn a_mean_is_taken_where_half_of_the_runs_were_evaluated() {
        let runs = [run(&[(1, 0.0), (2, 0.5)]), run(&[(1, 0.3), (2, 1.0), (3, 1.0)]), run(&[(1, 0.3), (2, f64::NAN)])];
        let runs: Vec<&[Line]> = runs.iter().map(|run| &run[..]).collect();
        let told: Vec<_> = over_seeds(&runs)
            .iter()
            .map(|l| ["env_steps", "eval_success", "low", "high"].map(|c| l.get(c).unwrap()))
            .collect();
        assert_eq!(told.len(), 2);
        assert!((told[0][1] - 0.2).abs() < 1e-12 && told[0][2] == 0.0, "{told:?}"); // 0.2 ± 4.303 · 0.1
        assert_eq!(told[1], [200.0, 0.75, 0.0, 1.0]);
        assert!(over_seeds(&[]).is_empty());
    }

    #[test]
    fn several_seeds_have_a_thin_interval_about_a_thick_mean_and_one_is_alone() {
        let runs = [run(&[(1, 0.0), (2, 1.0)]), run(&[(1, 0.5), (2, 1.0)])];
        let learnt = |n: usize| Learnt {
            task: "Hover",
            algorithm: "apg",
            runs: runs[..n].iter().map(|run| &run[..]).collect(),
            controller: Some(1.0),
        };
        let widths = |n| panel(&learnt(n)).series.iter().map(|s| s.width).collect::<Vec<f64>>();
        assert_eq!((widths(1), widths(2)), (vec![1.8], vec![0.8, 0.8, 1.8]));
        assert!(key(&[learnt(2)]).contains("thick") && !key(&[learnt(1)]).contains("thick"));
        assert!(figure(&[learnt(1)]).svg().is_ok() && figure(&[learnt(0)]).svg().is_ok() && figure(&[]).svg().is_ok());
    }
}
