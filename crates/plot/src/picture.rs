//! A picture: pixels as squares, what a camera saw.

use super::canvas::{Area, Canvas};
use super::legend::Header;
use super::theme::Colour;

/// Coloured squares, as large as fit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Picture {
    /// Above it.
    pub title: String,
    /// Row by row, from above.
    pub rows: Vec<Vec<Colour>>,
}

impl Picture {
    /// Of rows of pixels, from above.
    pub fn new(title: impl Into<String>, rows: Vec<Vec<Colour>>) -> Self {
        Self { title: title.into(), rows }
    }

    pub(super) fn draw(&self, canvas: &mut Canvas, area: Area) {
        let header = Header::new(&self.title, Vec::new(), area.width());
        header.draw(canvas, area.x0, area.x1, area.y0);
        let room = Area { y0: area.y0 + header.height + 2.0, ..area };
        let n_column = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        if n_column == 0 {
            return;
        }
        let edge = (room.width() / n_column as f64).min(room.height() / self.rows.len() as f64);
        for (i, row) in self.rows.iter().enumerate() {
            for (j, colour) in row.iter().enumerate() {
                let (x0, y0) = (room.x0 + j as f64 * edge, room.y0 + i as f64 * edge);
                canvas.rectangle(Area { x0, y0, x1: x0 + edge, y1: y0 + edge }, *colour, 1.0);
            }
        }
    }
}
