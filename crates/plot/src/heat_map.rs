//! A table of numbers as coloured cells: recovery maps, sweeps over two settings.

use super::axis::Axis;
use super::canvas::{Anchor, Area, Canvas};
use super::legend::Header;
use super::theme::{Colour, size};

/// Cells over two axes, coloured from dark (low) to bright (high), each with its text.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HeatMap {
    /// Above the chart.
    pub title: String,
    /// Below and beside it, with units.
    pub labels: [String; 2],
    /// First and last edge of the columns and of the rows.
    pub ranges: [(f64, f64); 2],
    /// Row by row, the lowest first, shares of 1; NaN stays pale.
    pub rows: Vec<Vec<f64>>,
    /// Written into each cell where it fits, in the same order; empty for none.
    pub texts: Vec<Vec<String>>,
    /// Whether cells touch: many, without text.
    pub seamless: bool,
}

impl HeatMap {
    /// Without numbers yet.
    pub fn new(title: impl Into<String>, x: impl Into<String>, y: impl Into<String>) -> Self {
        Self { title: title.into(), labels: [x.into(), y.into()], ..Self::default() }
    }

    /// With edges of the columns and of the rows from the first to the last.
    pub fn ranges(mut self, x: (f64, f64), y: (f64, f64)) -> Self {
        self.ranges = [x, y];
        self
    }

    /// With cells that touch.
    pub fn seamless(mut self) -> Self {
        self.seamless = true;
        self
    }

    /// With one more row above the others: shares of 1, and what is written into them.
    pub fn row(mut self, shares: Vec<f64>, texts: Vec<String>) -> Self {
        self.rows.push(shares);
        self.texts.push(texts);
        self
    }

    pub(super) fn draw(&self, canvas: &mut Canvas, area: Area) {
        let header = Header::new(&self.title, Vec::new(), area.width());
        header.draw(canvas, area.x0, area.x1, area.y0);
        let plot =
            Area { x0: area.x0 + 42.0, y0: area.y0 + header.height + 2.0, x1: area.x1 - 6.0, y1: area.y1 - 30.0 };
        let n_column = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        if n_column == 0 || plot.width() < 20.0 || plot.height() < 10.0 {
            return;
        }
        let (width, height) = (plot.width() / n_column as f64, plot.height() / self.rows.len() as f64);
        let gap = if self.seamless { 0.0 } else { 0.4 };
        for (i, row) in self.rows.iter().enumerate() {
            for (j, share) in row.iter().enumerate() {
                let (x0, y1) = (plot.x0 + j as f64 * width, plot.y1 - i as f64 * height);
                let cell = Area { x0: x0 + gap, y0: y1 - height + gap, x1: x0 + width - gap, y1: y1 - gap };
                let colour = if share.is_nan() { Colour::PALE } else { Colour::heat(*share) };
                canvas.rectangle(cell, colour, 1.0);
                let text = self.texts.get(i).and_then(|t| t.get(j)).map_or("", String::as_str);
                if super::font::width(text, size::TICK) < width - 3.0 && height > size::TICK + 2.0 {
                    let at = (x0 + 0.5 * width, y1 - 0.5 * height + 0.36 * size::TICK);
                    // dark letters on bright cells
                    let ink = if *share > 0.6 { Colour::INK } else { Colour::PALE };
                    canvas.text(at, text, size::TICK, ink, Anchor::Middle, false);
                }
            }
        }
        let [x, y] = self.ranges.map(|(lo, hi)| Axis::fit(lo, hi, false, 0.0, 8));
        let inside = |u: &f64| (-1e-9..=1.0 + 1e-9).contains(u);
        for (u, label) in x.ticks.iter().filter(|(u, _)| inside(u)) {
            let at = (plot.x0 + u * plot.width(), plot.y1 + 11.5);
            canvas.text(at, label, size::TICK, Colour::GREY, Anchor::Middle, false);
        }
        for (u, label) in y.ticks.iter().filter(|(u, _)| inside(u)) {
            let at = (plot.x0 - 5.0, plot.y1 - u * plot.height() + 0.36 * size::TICK);
            canvas.text(at, label, size::TICK, Colour::GREY, Anchor::End, false);
        }
        let [under, beside] = [(&self.labels[0], &x), (&self.labels[1], &y)].map(|(label, axis)| {
            if axis.multiplier.is_empty() { label.clone() } else { format!("{label} · {}", axis.multiplier) }
        });
        let at = (0.5 * (plot.x0 + plot.x1), area.y1 - 4.0);
        canvas.text(at, &under, size::LABEL, Colour::INK, Anchor::Middle, false);
        let at = (area.x0 + 10.0, 0.5 * (plot.y0 + plot.y1));
        canvas.text(at, &beside, size::LABEL, Colour::INK, Anchor::Middle, true);
    }
}
