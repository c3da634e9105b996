//! The learning curves of a study: a panel per task of a part, a curve per algorithm, the mean over seeds.

use super::Told;
use crate::train_all_plot::{columns, over_seeds};
use crate::train_plot::{Steps, with};
use omnidrones::rl::log::Line;
use omnidrones_plot::{Colour, Figure, Panel, Series};
use std::collections::BTreeMap;

/// Styles beyond so many are dashed: colours begin anew.
const N_COLOUR: usize = 6;

/// Of the rows whose curves are known; none if there are none.
pub fn figure(title: &str, rows: &[Told]) -> Option<Figure> {
    let mut names: Vec<(&str, &str)> = rows.iter().map(|row| (&row.cell.part[..], &row.cell.config.task[..])).collect();
    names.dedup();
    let drawn = rows.iter().filter(|row| !row.curves.is_empty());
    let styles = styles(drawn.map(|row| ((&row.cell.part[..], &row.cell.config.task[..]), row.cell.label())));
    let of = |(part, task): &(&str, &str)| {
        let own: Vec<&Told> =
            rows.iter().filter(|row| row.cell.part == *part && row.cell.config.task == *task).collect();
        panel(&format!("{task}: {part}"), &own, &styles)
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

/// A style for every label, the same in all panels: the first that nothing in a panel with it has.
fn styles<P: PartialEq, L: Ord + Clone>(rows: impl Iterator<Item = (P, L)>) -> BTreeMap<L, usize> {
    let rows: Vec<(P, L)> = rows.collect();
    let mut styles = BTreeMap::<L, usize>::new();
    for (_, label) in &rows {
        if styles.contains_key(label) {
            continue;
        }
        let beside = |panel: &P| rows.iter().any(|(other, own)| other == panel && own == label);
        let taken: Vec<usize> =
            rows.iter().filter(|(panel, _)| beside(panel)).filter_map(|(_, own)| styles.get(own).copied()).collect();
        let free = (0..).find(|style| !taken.contains(style)).unwrap_or_default();
        styles.insert(label.clone(), free);
    }
    styles
}

fn panel(title: &str, rows: &[&Told], styles: &BTreeMap<String, usize>) -> Panel {
    let steps = Steps::of(rows.iter().flat_map(|row| row.curves.iter().flatten()));
    let mut panel = steps.panel(title, "success [%]").y_range(-2.0, 104.0);
    for row in rows {
        let Some(style) = styles.get(&row.cell.label()) else { continue };
        let runs: Vec<&[Line]> = row.curves.iter().map(|curve| &curve[..]).collect();
        let points = steps.points(&over_seeds(&runs), "eval_success", 100.0);
        let series = Series::line(row.cell.label(), points).colour(Colour::nth(style % N_COLOUR)).width(1.6);
        panel = with(panel, if *style < N_COLOUR { series } else { series.dashed() });
    }
    steps.align(panel)
}

#[cfg(test)]
mod tests {
    use super::styles;

    #[test]
    fn an_algorithm_has_one_style_in_all_panels_and_shares_it_with_none_beside_it() {
        let rows =
            [(0, "ppo"), (0, "sac"), (1, "mappo"), (1, "sac"), (1, "td3"), (2, "td3"), (2, "ppo"), (3, "ppo, rate")];
        let styles = styles(rows.into_iter());
        for (panel, label) in rows {
            for (other, beside) in rows {
                assert!(panel != other || label == beside || styles[label] != styles[beside], "{label}, {beside}");
            }
        }
        assert_eq!(styles["ppo, rate"], 0, "{styles:?}"); // alone in its panel
    }
}
