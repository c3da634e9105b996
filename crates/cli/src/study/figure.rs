//! The learning curves of a study: a panel per task of a part, a curve per algorithm, the mean over seeds.

use super::Told;
use crate::train_all_plot::{columns, over_seeds};
use crate::train_plot::{Steps, with};
use omnidrones::rl::log::Line;
use omnidrones_plot::{Colour, Figure, Panel, Series};

/// Curves beyond so many in a panel are dashed: colours begin anew.
const N_COLOUR: usize = 6;

/// Of the rows whose curves are known; none if there are none.
pub fn figure(title: &str, rows: &[Told]) -> Option<Figure> {
    let mut names: Vec<(&str, &str)> = rows.iter().map(|row| (&row.cell.part[..], &row.cell.config.task[..])).collect();
    names.dedup();
    let of = |(part, task): &(&str, &str)| {
        let own: Vec<&Told> =
            rows.iter().filter(|row| row.cell.part == *part && row.cell.config.task == *task).collect();
        panel(&format!("{task}: {part}"), &own)
    };
    let panels: Vec<Panel> = names.iter().map(of).filter(|panel| !panel.series.is_empty()).collect();
    if panels.is_empty() {
        return None;
    }
    let columns = columns(panels.len()).min(2);
    let n_row = panels.len().div_ceil(columns);
    let mut figure = Figure::new(title)
        .subtitle("success from held-out starts, mean over seeds")
        .size(500.0 * columns as f64, 60.0 + 300.0 * n_row as f64)
        .grid(&vec![1.0; columns], &vec![1.0; n_row]);
    for (k, panel) in panels.into_iter().enumerate() {
        figure = figure.place((k % columns, k / columns), (1, 1), panel);
    }
    Some(figure)
}

fn panel(title: &str, rows: &[&Told]) -> Panel {
    let steps = Steps::of(rows.iter().flat_map(|row| row.curves.iter().flatten()));
    let mut panel = steps.panel(title, "success [%]").y_range(-2.0, 104.0);
    for (k, row) in rows.iter().enumerate() {
        let runs: Vec<&[Line]> = row.curves.iter().map(|curve| &curve[..]).collect();
        let points = steps.points(&over_seeds(&runs), "eval_success", 100.0);
        let series = Series::line(row.cell.label(), points).colour(Colour::nth(k % N_COLOUR)).width(1.6);
        panel = with(panel, if k < N_COLOUR { series } else { series.dashed() });
    }
    steps.align(panel)
}
