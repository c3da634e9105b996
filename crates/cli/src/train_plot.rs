//! How a policy learnt: success, error, return and loss over environment steps.

use crate::prelude::*;
use omnidrones::rl::log::Line;
use omnidrones::tasks::{Evaluation, Metric};
use omnidrones_plot::{Colour, Figure, Panel, Series};

/// What a learning curve is drawn from.
pub struct Curves<'a> {
    pub title: String,
    pub subtitle: String,
    pub lines: &'a [Line],
    /// What is minimised.
    pub loss: &'a str,
    /// Largest return.
    pub bound: f64,
    /// The task's error.
    pub error: &'a Metric,
    /// What to beat.
    pub baseline: Option<&'a (String, Evaluation)>,
}

/// Panels side by side, two to a row, those without data left out.
pub fn figure(curves: &Curves<'_>) -> Figure {
    let dashed = curves.baseline.map(|(name, _)| format!("   ·   dashed: {name}, our controller"));
    let subtitle = format!("{}{}", curves.subtitle, dashed.unwrap_or_default());
    arranged(&curves.title, &subtitle, panels(curves))
}

/// Several runs in the same panels: success, error and return from held-out starts; `error` is the name and unit of theirs.
pub fn beside(title: &str, runs: &[(String, &[Line])], error: &str) -> Figure {
    let steps = Steps::of(runs.iter().flat_map(|(_, lines)| *lines));
    let panel = |title: &str, y: &str, column: &str, scale: f64| {
        let mut panel = steps.panel(title, y);
        for (i, (name, lines)) in runs.iter().enumerate() {
            let series = Series::line(name, steps.points(lines, column, scale)).colour(Colour::nth(i));
            panel = with(panel, series.width(1.8));
        }
        panel
    };
    let errors = panel("Error in the last step", error, "eval_final_error", 1.0);
    let errors = if is_wide(&errors) { errors.log_y() } else { errors.from_zero() };
    let shares = panel("Success", "share of episodes [%]", "eval_success", 100.0).y_range(-2.0, 104.0);
    let panels = [shares, errors, panel("Return", "return of an episode", "eval_return", 1.0).from_zero()];
    let panels = panels.into_iter().filter(|panel| !panel.series.is_empty());
    arranged(title, "from held-out starts", panels.map(|panel| steps.align(panel)).collect())
}

/// The panels that have something to show.
fn panels(curves: &Curves<'_>) -> Vec<Panel> {
    let steps = Steps::of(curves.lines);
    let panels = [shares(curves, &steps), errors(curves, &steps), returns(curves, &steps), loss(curves, &steps)];
    let panels = panels.into_iter().chain(health(curves, &steps)).filter(|panel| !panel.series.is_empty());
    panels.map(|panel| steps.align(panel)).collect()
}

fn arranged(title: &str, subtitle: &str, panels: Vec<Panel>) -> Figure {
    let (n, rows) = (panels.len(), panels.len().div_ceil(2));
    let columns = n.clamp(1, 2);
    let size = (HALF * columns.max(2) as f64, 60.0 + ROW * rows.max(1) as f64);
    let mut figure =
        Figure::new(title).subtitle(subtitle).size(size.0, size.1).grid(&vec![1.0; columns], &vec![1.0; rows]);
    for (k, panel) in panels.into_iter().enumerate() {
        let (at, wide) = place(k, n, columns);
        figure = figure.place(at, (wide, 1), panel);
    }
    figure
}

/// Column and row of panel `k` of `n`, and over how many columns it goes: the last of an odd number has the row for
/// itself.
fn place(k: usize, n: usize, columns: usize) -> ((usize, usize), usize) {
    ((k % columns, k / columns), if k + 1 == n && k.is_multiple_of(columns) { columns } else { 1 })
}

/// Width of half a figure and height of a row, units.
const HALF: f64 = 500.0;
const ROW: f64 = 300.0;
/// Up to so many points of a curve are marked: a run may have a single evaluation.
const FEW: usize = 40;
/// Room that an axis with marks leaves at both ends, as a share of its length.
const ROOM: f64 = 0.03;
/// A level that is so many times smaller than all that was measured would squeeze the curves of a logarithmic axis.
const FAR: f64 = 30.0;
/// Values that differ by less than this factor need no logarithmic axis: it would have a tick or two.
const WIDE: f64 = 8.0;

/// Environment steps as an axis: named, and scaled so that its numbers are short.
pub struct Steps {
    label: &'static str,
    scale: f64,
    /// Where the last line is, on the axis.
    end: f64,
}

impl Steps {
    /// An axis that all lines fit on.
    pub fn of<'a>(lines: impl IntoIterator<Item = &'a Line>) -> Self {
        let most = lines.into_iter().filter_map(|line| line.get("env_steps")).fold(0.0, f64::max);
        let (label, scale) = match most {
            n if n >= 2e9 => ("environment steps [billion]", 1e-9),
            n if n >= 2e6 => ("environment steps [million]", 1e-6),
            n if n >= 2e3 => ("environment steps [thousand]", 1e-3),
            _ => ("environment steps", 1.0),
        };
        Self { label, scale, end: (scale * most).max(1e-9) }
    }

    /// A column of the log; lines without it are left out, so that evaluations join.
    pub fn points(&self, lines: &[Line], column: &str, scale: f64) -> Vec<(f64, f64)> {
        let point = |line: &Line| Some((self.scale * line.get("env_steps")?, scale * line.get(column)?));
        lines.iter().filter_map(point).collect()
    }

    /// An empty chart over the whole run.
    pub fn panel(&self, title: impl Into<String>, y: impl Into<String>) -> Panel {
        Panel::new(title, self.label, y)
    }

    /// The panel over the whole run, with the same ends as the others: marks alone make a chart leave room there.
    pub fn align(&self, panel: Panel) -> Panel {
        let room = if panel.series.iter().any(|s| s.markers) { 0.0 } else { ROOM * self.end };
        panel.x_range(-room, self.end + room)
    }
}

/// The panel with a curve, if there is anything of it; few points are marked.
pub fn with(panel: Panel, series: Series) -> Panel {
    match series.points.len() {
        0 => panel,
        n if n <= FEW => panel.series(series.markers()),
        _ => panel.series(series),
    }
}

/// With a curve of training: thin, since it is noisy, and without marks.
fn with_training(panel: Panel, series: Series) -> Panel {
    if series.points.is_empty() { panel } else { panel.series(series.width(1.0)) }
}

/// With the controller's figure as a dashed level, if it flew.
fn with_level(panel: Panel, curves: &Curves<'_>, of: fn(&Evaluation) -> f64) -> Panel {
    match curves.baseline {
        Some((name, e)) => panel.level(name.clone(), of(e), Colour::GREEN),
        None => panel,
    }
}

fn shares(curves: &Curves<'_>, steps: &Steps) -> Panel {
    let of = |name, column| Series::line(name, steps.points(curves.lines, column, 100.0));
    let panel = steps.panel("Success and crashes", "share of episodes [%]").y_range(-2.0, 104.0);
    let panel = with_training(panel, of("crashed in training", "crashed").colour(Colour::ORANGE));
    let panel = with(panel, of("crashed", "eval_crashed").colour(Colour::VERMILLION).width(1.8));
    let panel = with(panel, of("success", "eval_success").colour(Colour::BLUE).width(1.8));
    with_level(panel, curves, |e| 100.0 * e.success)
}

fn errors(curves: &Curves<'_>, steps: &Steps) -> Panel {
    let (name, unit) = (curves.error.name.replace('_', " "), &curves.error.unit);
    let of = |column| steps.points(curves.lines, column, 1.0);
    let title = name[..1].to_uppercase() + &name[1..];
    let panel = steps.panel(title, format!("{name} [{unit}]"));
    let panel = with(panel, Series::line("mean of all steps", of("eval_mean_error")).colour(Colour::SKY).width(1.4));
    let panel = with(panel, Series::line("last step", of("eval_final_error")).colour(Colour::BLUE).width(1.8));
    if !is_wide(&panel) {
        return with_level(panel.from_zero(), curves, |e| e.final_error);
    }
    match curves.baseline {
        Some((name, e)) => error_level(panel.log_y(), name, e.final_error, unit),
        None => panel.log_y(),
    }
}

/// Least and largest y of the curves.
fn span(panel: &Panel) -> (f64, f64) {
    let values = panel.series.iter().flat_map(|s| &s.points).map(|p| p.1);
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), y| (lo.min(y), hi.max(y)))
}

/// Whether the curves need a logarithmic axis, and can have one.
fn is_wide(panel: &Panel) -> bool {
    let (least, most) = span(panel);
    least > 0.0 && most > WIDE * least
}

/// With the controller's error in the last step: as a line, or in words where it is far below the curves.
fn error_level(panel: Panel, name: &str, level: f64, unit: &str) -> Panel {
    let (least, most) = span(&panel);
    if level >= least / FAR {
        return panel.level(name, level, Colour::GREEN);
    }
    let told = format!("{name}: {} {unit}, below", short(level, 2));
    panel.y_range(0.7 * least, 1.4 * most).level(told, level, Colour::GREEN)
}

fn returns(curves: &Curves<'_>, steps: &Steps) -> Panel {
    let of = |name, column| Series::line(name, steps.points(curves.lines, column, 1.0));
    let panel = steps.panel("Return", "return of an episode").from_zero();
    let panel = with_training(panel, of("in training", "return").colour(Colour::SKY));
    let panel = with(panel, of("held-out starts", "eval_return").colour(Colour::BLUE).width(1.8));
    with_level(panel, curves, |e| e.return_mean).level("bound", curves.bound, Colour::GREY)
}

fn loss(curves: &Curves<'_>, steps: &Steps) -> Panel {
    let points = steps.points(curves.lines, "loss", 1.0);
    let panel = with(steps.panel("Training loss", curves.loss), Series::line("", points).colour(Colour::PURPLE));
    if is_wide(&panel) { panel.log_y() } else { panel.from_zero() }
}

/// What tells whether an actor and a critic learn well: how far the policy moves, how freely it draws, how much of the
/// returns the critic explains. Only what the algorithm logs.
fn health(curves: &Curves<'_>, steps: &Steps) -> [Panel; 3] {
    let of = |title: &str, y: &str, column: &str, colour| {
        let series = Series::line("", steps.points(curves.lines, column, 1.0)).colour(colour);
        with_training(steps.panel(title, y), series)
    };
    [
        of("Divergence of the policy from the last", "KL [nat]", "kl", Colour::ORANGE).from_zero(),
        of("Entropy of the policy", "entropy [nat]", "entropy", Colour::GREEN),
        of("Explained by the critic", "explained variance [-]", "explained_variance", Colour::BLUE).level(
            "all",
            1.0,
            Colour::GREY,
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    static ERROR: std::sync::LazyLock<Metric> =
        std::sync::LazyLock::new(|| Metric { name: "position_error".into(), unit: "m".into() });

    fn line(update: u64, more: &[(&str, f64)]) -> Line {
        let mut line = Line::new(update);
        line.put("env_steps", 1000.0 * update as f64);
        more.iter().for_each(|(name, x)| line.put(*name, *x));
        line
    }

    fn curves(lines: &[Line]) -> Curves<'_> {
        let (title, subtitle) = (String::new(), String::new());
        Curves { title, subtitle, lines, loss: "mean cost of a step", bound: 9.0, error: &ERROR, baseline: None }
    }

    fn titles(lines: &[Line]) -> Vec<String> {
        panels(&curves(lines)).into_iter().map(|panel| panel.title).collect()
    }

    #[test]
    fn a_panel_without_data_is_left_out() {
        assert_eq!(titles(&[line(1, &[("loss", 2.0), ("return", f64::NAN)])]), ["Training loss"]);
        let all = [("loss", 2.0), ("eval_success", 0.0), ("eval_return", 1.0), ("eval_final_error", 1.0)];
        assert_eq!(titles(&[line(1, &all)]), ["Success and crashes", "Position error", "Return", "Training loss"]);
        assert!(titles(&[]).is_empty());
        let ppo = [("kl", 0.01), ("entropy", 1.0), ("explained_variance", 0.5)];
        assert_eq!(titles(&[line(1, &ppo)]).len(), 3);
    }

    #[test]
    fn panels_fill_a_grid_of_two_columns_whatever_their_number() {
        let places = |n: usize| (0..n).map(|k| place(k, n, n.clamp(1, 2))).collect::<Vec<_>>();
        assert_eq!(places(1), [((0, 0), 1)]);
        assert_eq!(places(2), [((0, 0), 1), ((1, 0), 1)]);
        assert_eq!(places(3), [((0, 0), 1), ((1, 0), 1), ((0, 1), 2)]);
        assert_eq!(places(4), [((0, 0), 1), ((1, 0), 1), ((0, 1), 1), ((1, 1), 1)]);
        for n in 0..5 {
            assert!(arranged("", "", vec![Panel::new("a", "b", "c"); n]).svg().is_ok(), "{n}");
        }
    }

    #[test]
    fn few_points_are_marked_and_many_are_not() {
        let marked = |n: u64| {
            let lines: Vec<Line> = (0..n).map(|k| line(k, &[("eval_success", 0.5)])).collect();
            panels(&curves(&lines))[0].series[0].markers
        };
        assert!(marked(1) && marked(FEW as u64) && !marked(FEW as u64 + 1));
    }

    #[test]
    fn an_evaluation_before_the_first_update_stands_at_zero() {
        let lines = [line(0, &[("eval_success", 0.25)]), line(5, &[("eval_success", 1.0), ("loss", 1.0)])];
        let steps = Steps::of(&lines);
        assert_eq!(steps.points(&lines, "eval_success", 100.0), [(0.0, 25.0), (5.0, 100.0)]);
        assert_eq!(steps.label, "environment steps [thousand]");
    }

    #[test]
    fn charts_with_and_without_marks_have_the_same_ends() {
        let lines: Vec<Line> = (0..100).map(|k| line(k, &[("loss", 1.0)])).collect();
        let steps = Steps::of(&lines);
        let series = Series::line("", vec![(0.0, 1.0)]);
        let ends = |panel: Panel| steps.align(panel).x_range.unwrap();
        let (plain, marked) = (Panel::default().series(series.clone()), Panel::default().series(series.markers()));
        let ((a, b), (c, d)) = (ends(plain), ends(marked));
        let room = ROOM * (d - c);
        assert!((a - (c - room)).abs() < 1e-9 && (b - (d + room)).abs() < 1e-9);
    }

    #[test]
    fn a_controller_far_below_the_curves_does_not_squeeze_them() {
        let panel = || Panel::default().log_y().series(Series::line("", vec![(0.0, 20.0), (1.0, 0.5)]));
        let near = error_level(panel(), "cascade", 0.1, "m");
        assert_eq!((near.rules[0].name.as_str(), near.y_range), ("cascade", None));
        let far = error_level(panel(), "cascade", 1e-5, "m");
        assert_eq!(far.rules[0].name, "cascade: 1e-5 m, below");
        assert!(far.y_range.is_some_and(|(lo, hi)| lo > 0.1 && lo < 0.5 && hi > 20.0));
    }

    #[test]
    fn an_axis_is_logarithmic_where_values_are_positive_and_far_apart() {
        let log = |values: [f64; 2]| {
            let points = values.map(|y| (y, y)).to_vec();
            is_wide(&Panel::default().series(Series::line("", points)))
        };
        assert!(log([0.01, 1.0]) && !log([0.5, 1.0]) && !log([-0.01, 1.0]) && !log([0.0, 1.0]));
        assert!(!is_wide(&Panel::default()));
    }
}
