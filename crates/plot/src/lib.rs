//! Figures as PNG or SVG files, without system fonts.
//!
//! A [`Figure`] is a grid of charts: [`Panel`] (curves, spreads, bands, limits), [`Path3d`] (a path in space), [`Drawing`] (bodies
//! in space), [`Bars`], [`HeatMap`], [`Picture`]. Axes,
//! ticks, legends and the projection are laid out here, in figure units (one CSS pixel of an SVG, two pixels of a PNG);
//! plotters paints. [`flight`] makes the figures of a [`FlightLog`](omnidrones::flight::FlightLog).
//!
//! | file | idea |
//! |---|---|
//! | `theme.rs`, `font.rs` | colours, sizes, the bundled font |
//! | `canvas.rs` | shapes, replayed into PNG or SVG by plotters |
//! | `axis.rs`, `legend.rs` | ticks and labels, legends beside or below the title |
//! | `projection.rs` | space onto the page |
//! | `chart.rs`, `path3d.rs`, `drawing.rs`, `bars.rs`, `heat_map.rs`, `picture.rs` | the six charts |
//! | `animation.rs` | figures one after the other as a GIF |
//! | `flight.rs`, `compare_flights.rs` | the figures of a flight; two flights over each other |
//! | `sensors.rs` | what sensors read along a flight |
//! | `model.rs`, `robot.rs` | an articulated system as a drawing; the figures of its flight or fall |
//!
//! ```
//! use omnidrones_plot::{Figure, Panel, Series};
//! let wave = (0..200).map(|i| (0.01 * i as f64, (0.1 * i as f64).sin())).collect();
//! let panel = Panel::new("Swing", "time [s]", "angle [rad]").series(Series::line("pendulum", wave));
//! let svg = Figure::new("A pendulum").chart(panel).svg()?;
//! assert!(svg.contains("pendulum"));
//! # Ok::<(), omnidrones::error::Error>(())
//! ```

pub mod animation;
mod axis;
mod bars;
mod canvas;
mod chart;
pub mod compare_flights;
mod drawing;
pub mod flight;
mod font;
mod heat_map;
mod legend;
pub mod model;
mod path3d;
mod picture;
mod projection;
pub mod robot;
pub mod sensors;
mod shape;
mod theme;

pub use bars::{Bar, Bars};
pub use chart::{Band, Panel, Ribbon, Rule, Series};
pub use drawing::{Drawing, Item, Label};
pub use heat_map::HeatMap;
pub use path3d::{Heat, Path3d, Pose};
pub use picture::Picture;
pub use theme::Colour;

use canvas::{Anchor, Area, Canvas};
use omnidrones::error::{Error, Result};
use omnidrones::internals::replace;
use std::path::Path;
use theme::size;

/// Height of a line of the subtitle, units.
const SUBTITLE_ROW: f64 = 13.0;

/// Smallest and largest width and height of a figure, units.
const SIZE_LIMITS: (f64, f64) = (120.0, 4000.0);

/// Any chart a figure can hold.
#[derive(Debug, Clone, PartialEq)]
pub enum Chart {
    /// Curves.
    Panel(Panel),
    /// A path in space.
    Path(Box<Path3d>),
    /// Bodies in space.
    Drawing(Box<Drawing>),
    /// Bars.
    Bars(Bars),
    /// Coloured cells.
    HeatMap(HeatMap),
    /// Pixels.
    Picture(Picture),
}

impl From<Panel> for Chart {
    fn from(panel: Panel) -> Self {
        Self::Panel(panel)
    }
}

impl From<Path3d> for Chart {
    fn from(path: Path3d) -> Self {
        Self::Path(Box::new(path))
    }
}

impl From<Drawing> for Chart {
    fn from(drawing: Drawing) -> Self {
        Self::Drawing(Box::new(drawing))
    }
}

impl From<Bars> for Chart {
    fn from(bars: Bars) -> Self {
        Self::Bars(bars)
    }
}

impl From<HeatMap> for Chart {
    fn from(map: HeatMap) -> Self {
        Self::HeatMap(map)
    }
}

impl From<Picture> for Chart {
    fn from(picture: Picture) -> Self {
        Self::Picture(picture)
    }
}

/// A chart and the grid cells it covers.
#[derive(Debug, Clone, PartialEq)]
struct Cell {
    column: usize,
    row: usize,
    columns: usize,
    rows: usize,
    chart: Chart,
}

/// The two kinds of files a figure can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Pixels, two per figure unit.
    Png,
    /// Vectors and text.
    Svg,
}

impl Format {
    /// By file extension, in either case.
    pub fn of(path: &Path) -> Result<Self> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        match extension.as_deref() {
            Some("png") => Ok(Self::Png),
            Some("svg") => Ok(Self::Svg),
            _ => Err(Error::value(
                "extension of the figure file",
                format!("'{}' (in {})", extension.unwrap_or_default(), path.display()),
                "png or svg",
                "End the file name in .png or .svg.",
            )),
        }
    }
}

/// A grid of charts under a common title, saved as PNG or SVG.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    title: String,
    subtitle: String,
    width: f64,
    height: f64,
    columns: Vec<f64>,
    rows: Vec<f64>,
    cells: Vec<Cell>,
}

impl Figure {
    /// An empty figure of 800 × 500 units: a PNG of 1600 × 1000 pixels.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            subtitle: String::new(),
            width: 800.0,
            height: 500.0,
            columns: vec![1.0],
            rows: Vec::new(),
            cells: Vec::new(),
        }
    }

    /// Changes every panel.
    pub(crate) fn for_each_panel(&mut self, mut change: impl FnMut(&mut Panel)) {
        for cell in &mut self.cells {
            if let Chart::Panel(panel) = &mut cell.chart {
                change(panel);
            }
        }
    }

    /// With a line of smaller text below the title: the numbers that matter.
    pub fn subtitle(mut self, text: impl Into<String>) -> Self {
        self.subtitle = text.into();
        self
    }

    /// With another size, in units: CSS pixels of an SVG, half the pixels of a PNG.
    pub fn size(mut self, width: f64, height: f64) -> Self {
        (self.width, self.height) = (width, height);
        self
    }

    /// With a grid of these relative column widths and row heights, for [`place`](Self::place).
    pub fn grid(mut self, columns: &[f64], rows: &[f64]) -> Self {
        (self.columns, self.rows) = (columns.to_vec(), rows.to_vec());
        self
    }

    /// With `chart` in a new row over the whole width.
    pub fn chart(mut self, chart: impl Into<Chart>) -> Self {
        self.rows.push(1.0);
        let (row, columns) = (self.rows.len() - 1, self.columns.len());
        self.cells.push(Cell { column: 0, row, columns, rows: 1, chart: chart.into() });
        self
    }

    /// With `chart` at (`column`, `row`), covering `columns` × `rows` cells of the grid.
    pub fn place(
        mut self,
        (column, row): (usize, usize),
        (columns, rows): (usize, usize),
        chart: impl Into<Chart>,
    ) -> Self {
        self.cells.push(Cell { column, row, columns, rows, chart: chart.into() });
        self
    }

    /// Writes the figure as PNG or SVG, by the extension of `path`; the file appears whole or not at all.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        match Format::of(path)? {
            Format::Png => self.paint()?.save_png(path),
            Format::Svg => {
                let text = self.svg()?;
                replace(path, &text)
            }
        }
    }

    /// The figure as an SVG document.
    pub fn svg(&self) -> Result<String> {
        self.paint()?.svg()
    }

    fn check(&self) -> Result<()> {
        let (least, most) = SIZE_LIMITS;
        for (what, value) in [("figure width", self.width), ("figure height", self.height)] {
            if !(value >= least && value <= most) {
                return Err(Error::limit(what, value, format!("{least} to {most} units"), "800 × 500 is the default."));
            }
        }
        let weights = || self.columns.iter().chain(&self.rows);
        if let Some(bad) = weights().find(|w| !(**w > 0.0 && w.is_finite())) {
            return Err(Error::value("grid weight", bad, "> 0", "Weights are relative widths or heights."));
        }
        let fits = |c: &Cell| {
            let (right, bottom) = (c.column.saturating_add(c.columns), c.row.saturating_add(c.rows));
            c.columns > 0 && c.rows > 0 && right <= self.columns.len() && bottom <= self.rows.len()
        };
        match self.cells.iter().find(|c| !fits(c)) {
            None => Ok(()),
            Some(c) => Err(Error::value(
                "place of a chart",
                format!("column {} + {}, row {} + {}", c.column, c.columns, c.row, c.rows),
                format!("inside the grid of {} columns and {} rows", self.columns.len(), self.rows.len()),
                "Call `grid` first, with enough columns and rows.",
            )),
        }
    }

    fn paint(&self) -> Result<Canvas> {
        self.check()?;
        let mut canvas = Canvas::new(self.width, self.height);
        let mut top = size::MARGIN;
        if !self.title.is_empty() {
            let at = (size::MARGIN, top + 13.0);
            canvas.text(at, &self.title, size::FIGURE_TITLE, Colour::INK, Anchor::Start, false);
            top += 21.0;
        }
        if !self.subtitle.is_empty() {
            let lines = font::lines(&self.subtitle, size::SUBTITLE, self.width - 2.0 * size::MARGIN);
            for line in &lines {
                canvas.text((size::MARGIN, top + 9.0), line, size::SUBTITLE, Colour::GREY, Anchor::Start, false);
                top += SUBTITLE_ROW;
            }
            top += 4.0;
        }
        let inside = Area {
            x0: size::MARGIN,
            y0: top + if top > size::MARGIN { 5.0 } else { 0.0 },
            x1: self.width - size::MARGIN,
            y1: self.height - 0.6 * size::MARGIN,
        };
        let xs = spread(&self.columns, inside.x0, inside.x1, 1.4 * size::GAP);
        let ys = spread(&self.rows, inside.y0, inside.y1, 0.7 * size::GAP);
        let area = |c: &Cell| Area {
            x0: xs[c.column].0,
            y0: ys[c.row].0,
            x1: xs[c.column + c.columns - 1].1,
            y1: ys[c.row + c.rows - 1].1,
        };
        let layouts: Vec<_> = self
            .cells
            .iter()
            .map(|c| match &c.chart {
                Chart::Panel(panel) => Some(panel.layout(area(c))),
                _ => None,
            })
            .collect();
        for (cell, layout) in self.cells.iter().zip(&layouts) {
            match (&cell.chart, layout) {
                (Chart::Panel(panel), Some(layout)) => {
                    // Charts in one column share their left margin, so that their time axes line up.
                    let column = self.cells.iter().zip(&layouts).filter(|(c, _)| c.column == cell.column);
                    let left = column.filter_map(|(_, l)| l.as_ref()).map(|l| l.left).fold(0.0, f64::max);
                    panel.draw(&mut canvas, layout, left);
                }
                (Chart::Path(path), _) => path.draw(&mut canvas, area(cell)),
                (Chart::Drawing(drawing), _) => drawing.draw(&mut canvas, area(cell)),
                (Chart::Bars(bars), _) => bars.draw(&mut canvas, area(cell)),
                (Chart::HeatMap(map), _) => map.draw(&mut canvas, area(cell)),
                (Chart::Picture(picture), _) => picture.draw(&mut canvas, area(cell)),
                _ => {}
            }
        }
        Ok(canvas)
    }
}

/// Intervals of lengths proportional to `weights` between `from` and `to`, with `gap` between them.
fn spread(weights: &[f64], from: f64, to: f64, gap: f64) -> Vec<(f64, f64)> {
    let free = (to - from - gap * weights.len().saturating_sub(1) as f64).max(1.0);
    let total: f64 = weights.iter().sum();
    let mut at = from;
    weights
        .iter()
        .map(|w| {
            let interval = (at, at + free * w / total);
            at = interval.1 + gap;
            interval
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_subtitle_has_as_many_lines_as_it_needs() {
        let parts = ["thick: mean over seeds", "thin: its 95 % confidence interval", "dashed: our controller"];
        let told = parts.repeat(3).join("   ·   ");
        for width in [240.0, 480.0, 1000.0] {
            let svg = Figure::new("t").subtitle(&told).size(width, 600.0).chart(Panel::new("", "", "")).svg().unwrap();
            let lines: Vec<&str> = svg.lines().filter(|l| !l.contains('<') && l.len() > 3).collect();
            let words = |text: &str| text.split_whitespace().map(String::from).collect::<Vec<_>>();
            assert_eq!(words(&lines.join(" ")).iter().filter(|w| *w == "dashed:").count(), 3, "{width}: {lines:?}");
            assert!(lines.iter().all(|l| font::width(l, size::SUBTITLE) <= width), "{width}: {lines:?}");
        }
    }
}
