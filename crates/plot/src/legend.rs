//! A legend in rows above the data, so that it never covers them.

use super::canvas::{Anchor, Area, Canvas};
use super::font;
use super::shape;
use super::theme::{Colour, size};

/// The sample drawn before a name.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Mark {
    Line {
        dashed: bool,
        width: f64,
    },
    /// A line with marks.
    Shaped {
        shape: usize,
        width: f64,
    },
    Dot,
    Square,
    Band(f64),
}

/// One entry.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Entry {
    pub name: String,
    pub colour: Colour,
    pub mark: Mark,
}

impl Entry {
    fn swatch(&self) -> f64 {
        match self.mark {
            Mark::Line { .. } | Mark::Shaped { .. } => 18.0,
            Mark::Band(_) => 12.0,
            Mark::Dot | Mark::Square => 7.0,
        }
    }

    fn width(&self) -> f64 {
        self.swatch() + 4.0 + font::width(&self.name, size::LEGEND)
    }
}

const BETWEEN: f64 = 12.0;
/// Height of a row.
pub(super) const ROW: f64 = 13.5;

/// Entries split into rows no wider than `room` (an entry wider than that has a row of its own).
pub(super) fn rows(entries: &[Entry], room: f64) -> Vec<&[Entry]> {
    let mut out = Vec::new();
    let (mut start, mut used) = (0, 0.0);
    for (i, entry) in entries.iter().enumerate() {
        let width = entry.width();
        if i > start && used + BETWEEN + width > room {
            out.push(&entries[start..i]);
            (start, used) = (i, width);
        } else {
            used += if i > start { BETWEEN + width } else { width };
        }
    }
    if start < entries.len() {
        out.push(&entries[start..]);
    }
    out
}

/// Width of one row.
pub(super) fn row_width(row: &[Entry]) -> f64 {
    row.iter().map(Entry::width).sum::<f64>() + BETWEEN * row.len().saturating_sub(1) as f64
}

/// Draws one row from `x` with its text baseline at `y`; an entry alone in its row ends before `end`.
pub(super) fn draw_row(canvas: &mut Canvas, row: &[Entry], mut x: f64, y: f64, end: f64) {
    let middle = y - 0.35 * size::LEGEND;
    for entry in row {
        let swatch = entry.swatch();
        match entry.mark {
            Mark::Line { dashed: false, width } => {
                canvas.line(&[(x, middle), (x + swatch, middle)], entry.colour, width);
            }
            Mark::Line { dashed: true, width } => {
                canvas.dashed(&[(x, middle), (x + swatch, middle)], entry.colour, width, 4.4, 2.4);
            }
            Mark::Shaped { shape, width } => {
                canvas.line(&[(x, middle), (x + swatch, middle)], entry.colour, width);
                shape::draw(canvas, shape, (x + 0.5 * swatch, middle), entry.colour);
            }
            Mark::Dot => canvas.disc((x + 3.5, middle), 3.5, entry.colour),
            Mark::Square => {
                let area = Area { x0: x, y0: middle - 3.5, x1: x + 7.0, y1: middle + 3.5 };
                canvas.rectangle(area, entry.colour, 1.0);
            }
            Mark::Band(opacity) => {
                let area = Area { x0: x, y0: middle - 4.0, x1: x + swatch, y1: middle + 4.0 };
                canvas.rectangle(area, entry.colour, opacity);
            }
        }
        let room = if row.len() == 1 { end - x - swatch - 4.0 } else { f64::INFINITY };
        let (name, em) = font::fitted(entry.name.clone(), size::LEGEND, room);
        canvas.text((x + swatch + 4.0, y), &name, em, Colour::INK, Anchor::Start, false);
        x += entry.width() + BETWEEN;
    }
}

/// The title at the left and the legend: beside the title where both fit, else in rows below it.
#[derive(Debug, Clone)]
pub(super) struct Header {
    title: String,
    entries: Vec<Entry>,
    beside: bool,
    pub height: f64,
}

impl Header {
    pub fn new(title: &str, entries: Vec<Entry>, width: f64) -> Self {
        let title_width = font::width(title, size::TITLE);
        let beside = !entries.is_empty() && title_width + 2.0 * BETWEEN + row_width(&entries) <= width;
        let below = if beside { 0 } else { rows(&entries, width).len() };
        let first = if title.is_empty() && !beside { 0.0 } else { 17.0 };
        Self { title: title.to_string(), entries, beside, height: first + below as f64 * ROW + 3.0 }
    }

    /// Draws between `x0` and `x1`, from `top` down.
    pub fn draw(&self, canvas: &mut Canvas, x0: f64, x1: f64, top: f64) {
        let (title, em) = font::fitted(self.title.clone(), size::TITLE, x1 - x0);
        canvas.text((x0, top + 11.5), &title, em, Colour::INK, Anchor::Start, false);
        if self.beside {
            draw_row(canvas, &self.entries, x1 - row_width(&self.entries), top + 11.5, x1);
            return;
        }
        let first = if self.title.is_empty() { 0.0 } else { 17.0 };
        for (i, row) in rows(&self.entries, x1 - x0).into_iter().enumerate() {
            draw_row(canvas, row, x0, top + first + 10.0 + i as f64 * ROW, x1);
        }
    }
}
