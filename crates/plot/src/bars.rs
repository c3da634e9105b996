//! Horizontal bars with their values written out: benches, ratios, comparisons.

use super::axis::{Axis, drawable, short};
use super::canvas::{Anchor, Area, Canvas};
use super::font;
use super::legend::{Entry, Header, Mark};
use super::theme::{Colour, size};

/// One bar.
#[derive(Debug, Clone, PartialEq)]
pub struct Bar {
    /// Left of the bar.
    pub name: String,
    /// Its length, to the left of zero where it is negative; not finite shows as text alone.
    pub value: f64,
    /// After the value, as in `4.1 ×`.
    pub note: String,
    /// `None` is blue.
    pub colour: Option<Colour>,
}

impl Bar {
    /// A blue bar without a note.
    pub fn new(name: impl Into<String>, value: f64) -> Self {
        Self { name: name.into(), value, note: String::new(), colour: None }
    }

    /// With a remark after its value.
    pub fn note(mut self, note: impl Into<String>) -> Self {
        self.note = note.into();
        self
    }

    /// With `colour`.
    pub fn colour(mut self, colour: Colour) -> Self {
        self.colour = Some(colour);
        self
    }
}

/// A bar chart, top to bottom in the order given.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Bars {
    /// Above the chart.
    pub title: String,
    /// Below the axis, with its unit.
    pub label: String,
    /// The bars.
    pub bars: Vec<Bar>,
    /// A dashed line to compare with: name and value.
    pub baseline: Option<(String, f64)>,
    /// Logarithmic lengths, from a decade below the least value.
    pub log: bool,
}

impl Bars {
    /// An empty chart.
    pub fn new(title: impl Into<String>, label: impl Into<String>) -> Self {
        Self { title: title.into(), label: label.into(), ..Self::default() }
    }

    /// With one more bar.
    pub fn bar(mut self, bar: Bar) -> Self {
        self.bars.push(bar);
        self
    }

    /// With a line to compare with, as in `("plain loop", 1.0)`.
    pub fn baseline(mut self, name: impl Into<String>, value: f64) -> Self {
        self.baseline = Some((name.into(), value));
        self
    }

    /// With logarithmic lengths.
    pub fn log(mut self) -> Self {
        self.log = true;
        self
    }

    pub(super) fn draw(&self, canvas: &mut Canvas, area: Area) {
        let entries = self.baseline.iter().map(|(name, _)| Entry {
            name: name.clone(),
            colour: Colour::INK,
            mark: Mark::Line { dashed: true, width: 1.0 },
        });
        let header = Header::new(&self.title, entries.collect(), area.width());
        let names = self.bars.iter().map(|b| font::width(&b.name, size::LABEL)).fold(0.0, f64::max);
        let values = self.bars.iter().map(|b| font::width(&text(b), size::LABEL)).fold(0.0, f64::max);
        let plot = Area {
            x0: area.x0 + (names + 8.0).min(0.5 * area.width()),
            y0: area.y0 + header.height,
            x1: area.x1 - (values + 10.0).min(0.3 * area.width()),
            y1: area.y1 - 14.0 - if self.label.is_empty() { 0.0 } else { 14.0 },
        };
        header.draw(canvas, area.x0, area.x1, area.y0);
        if plot.width() < 20.0 || plot.height() < 10.0 {
            return;
        }
        let axis = self.axis(plot.width());
        for (u, label) in axis.ticks.iter().filter(|t| (-1e-9..=1.0 + 1e-9).contains(&t.0)) {
            let x = plot.x0 + u * plot.width();
            canvas.line(&[(x, plot.y0), (x, plot.y1)], Colour::GRID, 0.7);
            canvas.text((x, plot.y1 + 11.5), label, size::TICK, Colour::GREY, Anchor::Middle, false);
        }
        let pitch = plot.height() / self.bars.len().max(1) as f64;
        let half = (0.34 * pitch).min(11.0);
        let zero = if self.log { plot.x0 } else { plot.x0 + axis.unit(0.0).clamp(0.0, 1.0) * plot.width() };
        let mut values = Vec::new();
        for (i, bar) in self.bars.iter().enumerate() {
            let y = plot.y0 + (i as f64 + 0.5) * pitch;
            let u = axis.unit(bar.value).clamp(0.0, 1.0);
            let tip = if u.is_finite() { plot.x0 + u * plot.width() } else { zero };
            let end = tip.max(zero);
            let shape = Area { x0: tip.min(zero), y0: y - half, x1: end, y1: y + half };
            canvas.rectangle(shape, bar.colour.unwrap_or(Colour::BLUE), 1.0);
            let base = y + 0.36 * size::LABEL;
            canvas.text((plot.x0 - 8.0, base), &bar.name, size::LABEL, Colour::INK, Anchor::End, false);
            values.push(((end + 5.0, base), text(bar)));
        }
        canvas.line(&[(zero, plot.y0), (zero, plot.y1)], Colour::FRAME, 0.9);
        if let Some((_, value)) = &self.baseline {
            let x = plot.x0 + axis.unit(*value) * plot.width();
            if (plot.x0..=plot.x1).contains(&x) {
                canvas.dashed(&[(x, plot.y0), (x, plot.y1)], Colour::INK, 1.0, 4.4, 2.8);
            }
        }
        // over the line, on white: it would run through the digits
        for ((x, base), value) in values {
            let wide = font::width(&value, size::LABEL);
            let paper =
                Area { x0: x - 2.0, y0: base - 0.86 * size::LABEL, x1: x + wide + 2.0, y1: base + 0.2 * size::LABEL };
            canvas.rectangle(paper, Colour(255, 255, 255), 1.0);
            canvas.text((x, base), &value, size::LABEL, Colour::INK, Anchor::Start, false);
        }
        if self.bars.is_empty() {
            let middle = (0.5 * (plot.x0 + plot.x1), 0.5 * (plot.y0 + plot.y1));
            canvas.text(middle, "no finite data", size::LABEL, Colour::GREY, Anchor::Middle, false);
        }
        let label = if axis.multiplier.is_empty() {
            self.label.clone()
        } else {
            format!("{} · {}", self.label, axis.multiplier.trim_start_matches('×'))
        };
        let under = (0.5 * (plot.x0 + plot.x1), area.y1 - 4.0);
        canvas.text(under, &label, size::LABEL, Colour::INK, Anchor::Middle, false);
    }

    fn axis(&self, width: f64) -> Axis {
        let values = self.bars.iter().map(|b| b.value).chain(self.baseline.iter().map(|b| b.1));
        let (lo, hi) = values
            .filter(|v| drawable(*v, self.log))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)));
        let wanted = ((width / 60.0) as usize).clamp(2, 8);
        if self.log {
            Axis::fit(lo / 10.0, hi, true, 0.0, wanted)
        } else {
            Axis::fit(lo.min(0.0), hi.max(0.0), false, 0.0, wanted)
        }
    }
}

fn text(bar: &Bar) -> String {
    if bar.note.is_empty() { short(bar.value) } else { format!("{} {}", short(bar.value), bar.note) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_runs_below_the_numbers_of_bars_that_it_crosses() {
        for value in [0.5, 0.9, 0.98] {
            let bars = Bars::new("b", "share")
                .bar(Bar::new("one", value).note("×"))
                .bar(Bar::new("two", 1.0))
                .baseline("all", 1.0);
            let svg = crate::Figure::new("").chart(bars).svg().unwrap();
            // the digits, and the white before them, come after the last dash
            let dash = svg.rfind("<polyline").unwrap();
            let digits = svg.find(&format!("{} ×", short(value))).unwrap();
            let white = svg[..digits].rfind("<rect").unwrap();
            assert!(white > dash, "{value}");
        }
    }
}
