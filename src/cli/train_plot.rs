//! How a policy learnt: return, success and loss over environment steps and over time.

use omnidrones::error::Result;
use omnidrones::plot::{Colour, Figure, Panel, Series};
use omnidrones::rl::log::Line;
use omnidrones::tasks::Evaluation;
use std::path::Path;

/// What a learning curve is drawn from.
pub struct Curves<'a> {
    pub title: String,
    pub subtitle: String,
    pub lines: &'a [Line],
    /// Largest return.
    pub bound: f64,
    /// Of the task's error.
    pub unit: &'a str,
    /// What to beat.
    pub baseline: Option<&'a (String, Evaluation)>,
}

/// Where a point of a curve stands along x.
#[derive(Clone, Copy)]
struct Along {
    label: &'static str,
    column: &'static str,
    scale: f64,
}

/// Draws them.
pub fn draw(curves: &Curves<'_>, path: &Path) -> Result<()> {
    let most = curves.lines.iter().filter_map(|line| line.get("env_steps")).fold(0.0, f64::max);
    let (label, scale) = match most {
        n if n >= 2e6 => ("environment steps [million]", 1e-6),
        n if n >= 2e3 => ("environment steps [thousand]", 1e-3),
        _ => ("environment steps", 1.0),
    };
    let steps = Along { label, column: "env_steps", scale };
    let time = Along { label: "training time [s]", column: "seconds", scale: 1.0 };
    Figure::new(&curves.title)
        .subtitle(&curves.subtitle)
        .size(1000.0, 760.0)
        .grid(&[1.0, 1.0], &[1.0, 1.0, 0.9])
        .place((0, 0), (1, 1), returns(curves, steps))
        .place((1, 0), (1, 1), returns(curves, time))
        .place((0, 1), (1, 1), shares(curves, steps))
        .place((1, 1), (1, 1), shares(curves, time))
        .place((0, 2), (1, 1), errors(curves, steps))
        .place((1, 2), (1, 1), loss(curves, time))
        .save(path)
}

impl Curves<'_> {
    /// A column over x; lines without it are left out, so that evaluations join.
    fn points(&self, along: Along, column: &str, scale: f64) -> Vec<(f64, f64)> {
        let point = |line: &Line| Some((along.scale * line.get(along.column)?, scale * line.get(column)?));
        self.lines.iter().filter_map(point).collect()
    }

    fn panel(&self, title: &str, along: Along, y: &str) -> Panel {
        let most = self.lines.iter().filter_map(|line| line.get(along.column)).fold(0.0, f64::max);
        Panel::new(title, along.label, y).x_range(0.0, (along.scale * most).max(1e-9))
    }
}

fn returns(curves: &Curves<'_>, along: Along) -> Panel {
    let training = Series::line("while training", curves.points(along, "return", 1.0));
    let held_out = Series::line("held-out starts", curves.points(along, "eval_return", 1.0));
    let mut panel = curves
        .panel("Return", along, "return")
        .from_zero()
        .series(training.colour(Colour::SKY).width(1.1))
        .series(held_out.colour(Colour::BLUE).width(1.8).markers());
    if let Some((name, e)) = curves.baseline {
        panel = panel.level(name.clone(), e.return_mean, Colour::GREEN);
    }
    panel.level("bound", curves.bound, Colour::GREY)
}

fn shares(curves: &Curves<'_>, along: Along) -> Panel {
    let success = Series::line("success", curves.points(along, "eval_success", 100.0));
    let crashed = Series::line("crashed", curves.points(along, "eval_crashed", 100.0));
    let training = Series::line("crashed while training", curves.points(along, "crashed", 100.0));
    curves
        .panel("Held-out starts", along, "share [%]")
        .y_range(0.0, 104.0)
        .series(training.colour(Colour::ORANGE).width(0.9))
        .series(crashed.colour(Colour::VERMILLION).width(1.8).markers())
        .series(success.colour(Colour::BLUE).width(1.8).markers())
}

fn errors(curves: &Curves<'_>, along: Along) -> Panel {
    let last = Series::line("in the last step", curves.points(along, "eval_final_error", 1.0));
    let mean = Series::line("mean of all steps", curves.points(along, "eval_mean_error", 1.0));
    let panel = curves
        .panel("Held-out starts", along, &format!("error [{}]", curves.unit))
        .series(last.colour(Colour::BLUE).width(1.8).markers())
        .series(mean.colour(Colour::SKY).width(1.4).markers());
    match curves.baseline {
        Some((name, e)) if e.final_error > 0.0 => {
            panel.log_y().level(format!("{name}, last step"), e.final_error, Colour::GREEN)
        }
        _ => panel.log_y(),
    }
}

fn loss(curves: &Curves<'_>, along: Along) -> Panel {
    let points = curves.points(along, "loss", 1.0);
    let positive = points.iter().all(|p| p.1 > 0.0) && !points.is_empty();
    let panel = curves.panel("Training loss", along, "loss").series(Series::line("", points).colour(Colour::PURPLE));
    if positive { panel.log_y() } else { panel }
}
