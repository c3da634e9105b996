//! A list of shapes in figure units, replayed into a PNG or an SVG file by plotters' back ends.
//!
//! plotters draws on whole pixels without smoothing wide lines. A PNG is therefore drawn 3 times larger than its final
//! size and averaged down; an SVG is drawn on a grid of a tenth of a unit and scaled by its view box.

use super::font;
use super::theme::Colour;
use omnidrones::error::{Error, Result};
use omnidrones::internals::{replace_with, steers};
use plotters::prelude::{BitMapBackend, DrawingBackend, SVGBackend};
use plotters::style::{Color, RGBAColor, RGBColor, ShapeStyle};
use std::path::Path;

/// Longest text drawn, characters: names come from files of anybody, and every letter costs.
const LONGEST_TEXT: usize = 300;

/// Between a text and the edge of the figure, at least, units.
const EDGE: f64 = 3.0;

/// x to the right, y down, in figure units.
pub(super) type Point = (f64, f64);

/// Pixels of a PNG per figure unit.
const PIXELS_PER_UNIT: usize = 2;
/// Supersampling of a PNG along each axis.
const SAMPLES: usize = 3;
/// Grid steps of an SVG per figure unit.
const SVG_STEPS: f64 = 10.0;

/// Which part of a text sits at its point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

#[derive(Debug, Clone)]
enum Shape {
    Line { points: Vec<Point>, colour: Colour, width: f64 },
    Polygon { points: Vec<Point>, colour: Colour },
    Rectangle { from: Point, to: Point, colour: Colour, opacity: f64 },
    Text { at: Point, text: String, em: f64, colour: Colour, anchor: Anchor, vertical: bool },
}

/// An axis-parallel rectangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Area {
    pub x0: f64,
    pub y0: f64,
    pub x1: f64,
    pub y1: f64,
}

impl Area {
    pub fn width(&self) -> f64 {
        self.x1 - self.x0
    }

    pub fn height(&self) -> f64 {
        self.y1 - self.y0
    }
}

/// Shapes in the order they are painted.
#[derive(Debug, Clone)]
pub(super) struct Canvas {
    width: f64,
    height: f64,
    shapes: Vec<Shape>,
}

impl Canvas {
    pub fn new(width: f64, height: f64) -> Self {
        Self { width, height, shapes: Vec::new() }
    }

    /// A polyline; parts with non-finite points are left out.
    pub fn line(&mut self, points: &[Point], colour: Colour, width: f64) {
        for run in points.split(|p| !(p.0.is_finite() && p.1.is_finite())) {
            if run.len() >= 2 {
                self.shapes.push(Shape::Line { points: run.to_vec(), colour, width });
            }
        }
    }

    /// A polyline of dashes `on` long with gaps `off`.
    pub fn dashed(&mut self, points: &[Point], colour: Colour, width: f64, on: f64, off: f64) {
        for run in points.split(|p| !(p.0.is_finite() && p.1.is_finite())) {
            for dash in dashes(run, on, off) {
                self.line(&dash, colour, width);
            }
        }
    }

    pub fn polygon(&mut self, points: Vec<Point>, colour: Colour) {
        if points.len() >= 3 && points.iter().all(|p| p.0.is_finite() && p.1.is_finite()) {
            self.shapes.push(Shape::Polygon { points, colour });
        }
    }

    pub fn disc(&mut self, centre: Point, radius: f64, colour: Colour) {
        let corner = |i: usize| {
            let (s, c) = (i as f64 * std::f64::consts::TAU / 24.0).sin_cos();
            (centre.0 + radius * c, centre.1 + radius * s)
        };
        self.polygon((0..24).map(corner).collect(), colour);
    }

    pub fn rectangle(&mut self, area: Area, colour: Colour, opacity: f64) {
        if area.width() > 0.0 && area.height() > 0.0 {
            self.shapes.push(Shape::Rectangle { from: (area.x0, area.y0), to: (area.x1, area.y1), colour, opacity });
        }
    }

    /// Text whose baseline passes through `at`; `vertical` text runs upwards.
    pub fn text(&mut self, at: Point, text: &str, em: f64, colour: Colour, anchor: Anchor, vertical: bool) {
        if !text.is_empty() && at.0.is_finite() && at.1.is_finite() {
            let text = text.chars().take(LONGEST_TEXT).map(|c| if steers(c) { '·' } else { c }).collect::<String>();
            let (along, end) = if vertical { (at.1, self.height) } else { (at.0, self.width) };
            let (before, behind) = (along - EDGE, end - EDGE - along);
            let room = match (anchor, vertical) {
                (Anchor::Middle, _) => 2.0 * before.min(behind),
                (Anchor::Start, false) | (Anchor::End, true) => behind,
                (Anchor::End, false) | (Anchor::Start, true) => before,
            };
            let (text, em) = font::fitted(text, em, room);
            self.shapes.push(Shape::Text { at, text, em, colour, anchor, vertical });
        }
    }

    /// The picture as an SVG document.
    pub fn svg(&self) -> Result<String> {
        let mut text = String::new();
        let size = ((self.width * SVG_STEPS).round() as u32, (self.height * SVG_STEPS).round() as u32);
        {
            let mut back = SVGBackend::with_string(&mut text, size);
            self.replay(&mut back, SVG_STEPS, true, Path::new("<svg>"))?;
            back.present().map_err(|e| drawing("<svg>", e))?;
        }
        // Shown at one CSS pixel per figure unit; the view box keeps the finer grid. Round joins, since paths turn.
        let drawn = format!("<svg width=\"{}\" height=\"{}\"", size.0, size.1);
        let shown = format!(
            "<svg width=\"{:.0}\" height=\"{:.0}\" stroke-linejoin=\"round\" stroke-linecap=\"butt\"",
            self.width, self.height
        );
        Ok(self.with_widths(&text.replacen(&drawn, &shown, 1)))
    }

    /// An SVG document whose longer texts are as wide as they were laid out, whatever face a reader has in place of ours.
    fn with_widths(&self, svg: &str) -> String {
        let texts = self.shapes.iter().filter_map(|shape| match shape {
            Shape::Text { text, em, .. } => Some((text, em)),
            _ => None,
        });
        let mut parts = svg.split("<text ");
        let mut out = parts.next().unwrap_or_default().to_string();
        let mut texts = texts.fuse();
        for part in parts {
            out += "<text ";
            if let Some((text, em)) = texts.next().filter(|(text, _)| text.chars().count() > SHORT) {
                let width = font::width(text, *em) * SVG_STEPS;
                out += &format!("textLength=\"{width:.0}\" lengthAdjust=\"spacingAndGlyphs\" ");
            }
            out += part;
        }
        out
    }

    /// Width, height and RGB bytes, row by row from the top, of a picture of `per_unit` pixels per unit.
    pub fn pixels(&self, per_unit: usize, path: &Path) -> Result<(usize, usize, Vec<u8>)> {
        let (w, h) = (self.width.round() as usize * per_unit, self.height.round() as usize * per_unit);
        let (big_w, big_h) = (w * SAMPLES, h * SAMPLES);
        let mut big = vec![255u8; big_w * big_h * 3];
        {
            let mut back = BitMapBackend::with_buffer(&mut big, (big_w as u32, big_h as u32));
            self.replay(&mut back, (per_unit * SAMPLES) as f64, false, path)?;
            back.present().map_err(|e| drawing(path, e))?;
        }
        Ok((w, h, average(&big, w, h)))
    }

    /// Writes a PNG of two pixels per unit.
    pub fn save_png(&self, path: &Path) -> Result<()> {
        let (w, h, small) = self.pixels(PIXELS_PER_UNIT, path)?;
        replace_with(path, |file| {
            let mut encoder = png::Encoder::new(file, w as u32, h as u32);
            encoder.set_color(png::ColorType::Rgb);
            let mut image = encoder.write_header().map_err(|e| drawing(path, e))?;
            image.write_image_data(&small).and_then(|()| image.finish()).map_err(|e| drawing(path, e))
        })
    }

    fn replay<B: DrawingBackend>(&self, back: &mut B, scale: f64, svg: bool, path: &Path) -> Result<()> {
        font::register();
        let at = |p: &Point| ((p.0 * scale).round() as i32, (p.1 * scale).round() as i32);
        let solid = |colour: &Colour, opacity: f64| RGBAColor(colour.0, colour.1, colour.2, opacity).filled();
        let end = (self.width, self.height);
        back.draw_rect((0, 0), at(&end), &solid(&Colour(255, 255, 255), 1.0), true).map_err(|e| drawing(path, e))?;
        for shape in &self.shapes {
            match shape {
                Shape::Line { points, colour, width } if svg => {
                    let color = RGBAColor(colour.0, colour.1, colour.2, 1.0);
                    let stroke_width = (width * scale).round().max(1.0) as u32;
                    back.draw_path(points.iter().map(at), &ShapeStyle { color, filled: false, stroke_width })
                        .map_err(|e| drawing(path, e))?;
                }
                Shape::Line { points, colour, width } => {
                    for piece in stroke(points, *width) {
                        back.fill_polygon(piece.iter().map(at), &solid(colour, 1.0)).map_err(|e| drawing(path, e))?;
                    }
                }
                Shape::Polygon { points, colour } => {
                    back.fill_polygon(points.iter().map(at), &solid(colour, 1.0)).map_err(|e| drawing(path, e))?;
                }
                Shape::Rectangle { from, to, colour, opacity } => {
                    back.draw_rect(at(from), at(to), &solid(colour, *opacity), true).map_err(|e| drawing(path, e))?;
                }
                Shape::Text { at: point, text, em, colour, anchor, vertical } => {
                    let ink = RGBColor(colour.0, colour.1, colour.2);
                    let (style, baseline) = font::style(em * scale, ink, *anchor, *vertical, svg);
                    let (x, y) = (point.0 * scale, point.1 * scale);
                    let (x, y) = if *vertical { (x - baseline, y) } else { (x, y - baseline) };
                    back.draw_text(text, &style, (x.round() as i32, y.round() as i32)).map_err(|e| drawing(path, e))?;
                }
            }
        }
        Ok(())
    }
}

fn drawing(path: impl AsRef<Path>, error: impl std::fmt::Display) -> Error {
    Error::file(path, std::io::Error::other(error.to_string()))
}

/// Letters of a text that another face does not make so wide that it meets the next one.
const SHORT: usize = 6;

/// Means over blocks of SAMPLES × SAMPLES pixels.
fn average(big: &[u8], w: usize, h: usize) -> Vec<u8> {
    let row = w * SAMPLES * 3;
    let mut small = vec![0u8; w * h * 3];
    let mut sums = vec![0u32; w * 3];
    for y in 0..h {
        sums.fill(0);
        for line in big[y * SAMPLES * row..(y + 1) * SAMPLES * row].chunks_exact(row) {
            for (sum, block) in sums.chunks_exact_mut(3).zip(line.chunks_exact(3 * SAMPLES)) {
                for pixel in block.chunks_exact(3) {
                    for (s, value) in sum.iter_mut().zip(pixel) {
                        *s += u32::from(*value);
                    }
                }
            }
        }
        let count = (SAMPLES * SAMPLES) as u32;
        for (target, sum) in small[y * w * 3..(y + 1) * w * 3].iter_mut().zip(&sums) {
            *target = ((sum + count / 2) / count) as u8;
        }
    }
    small
}

/// A polyline as filled pieces: a quadrilateral per segment and a small polygon per inner corner.
fn stroke(points: &[Point], width: f64) -> Vec<Vec<Point>> {
    let r = 0.5 * width;
    let mut pieces = Vec::with_capacity(2 * points.len());
    for (i, pair) in points.windows(2).enumerate() {
        let (a, b) = (pair[0], pair[1]);
        let length = (b.0 - a.0).hypot(b.1 - a.1);
        if length > 0.0 {
            let n = (-(b.1 - a.1) / length * r, (b.0 - a.0) / length * r);
            pieces.push(vec![
                (a.0 + n.0, a.1 + n.1),
                (b.0 + n.0, b.1 + n.1),
                (b.0 - n.0, b.1 - n.1),
                (a.0 - n.0, a.1 - n.1),
            ]);
        }
        if i > 0 {
            let corner = |k: usize| {
                let (s, c) = (k as f64 * std::f64::consts::TAU / 10.0).sin_cos();
                (a.0 + r * c, a.1 + r * s)
            };
            pieces.push((0..10).map(corner).collect());
        }
    }
    pieces
}

/// Cuts a polyline into dashes by arc length.
fn dashes(points: &[Point], on: f64, off: f64) -> Vec<Vec<Point>> {
    let Some(first) = points.first() else { return Vec::new() };
    let (mut out, mut current) = (Vec::new(), vec![*first]);
    let (mut drawing, mut left) = (true, on);
    for pair in points.windows(2) {
        let (mut a, b) = (pair[0], pair[1]);
        let mut length = (b.0 - a.0).hypot(b.1 - a.1);
        while length > left {
            let t = left / length;
            a = (a.0 + t * (b.0 - a.0), a.1 + t * (b.1 - a.1));
            length -= left;
            if drawing {
                current.push(a);
                out.push(std::mem::take(&mut current));
            } else {
                current = vec![a];
            }
            drawing = !drawing;
            left = if drawing { on } else { off };
        }
        left -= length;
        if drawing {
            current.push(b);
        }
    }
    if drawing && current.len() >= 2 {
        out.push(current);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_text_leaves_the_figure_wherever_it_stands() {
        let long = "success of every candidate, mean over the seeds with its 95 % interval";
        for anchor in [Anchor::Start, Anchor::Middle, Anchor::End] {
            for x in [5.0, 60.0, 200.0, 380.0] {
                let mut canvas = Canvas::new(400.0, 300.0);
                canvas.text((x, 20.0), long, 11.0, Colour::INK, anchor, false);
                canvas.text((20.0, 0.75 * x), long, 11.0, Colour::INK, anchor, true);
                for shape in &canvas.shapes {
                    let Shape::Text { at, text, em, vertical, .. } = shape else { panic!("a text") };
                    let (along, end) = if *vertical { (at.1, 300.0) } else { (at.0, 400.0) };
                    let wide = font::width(text, *em);
                    let before = match (anchor, vertical) {
                        (Anchor::Middle, _) => 0.5 * wide,
                        (Anchor::End, false) | (Anchor::Start, true) => wide,
                        _ => 0.0,
                    };
                    // an ellipsis at the very edge is all that may stand over it
                    let room = font::width("…", *em);
                    assert!(along - before > -room && along - before + wide < end + room, "{anchor:?} {x}: {text}");
                }
            }
        }
    }

    #[test]
    fn a_reader_without_our_face_is_told_how_wide_every_longer_text_is() {
        let mut canvas = Canvas::new(400.0, 300.0);
        let texts = ["0.5", "limit of a success, 0.3 m", "time [s]", "a <text > in a name", "1"];
        for (i, text) in texts.iter().enumerate() {
            canvas.text((20.0, 20.0 + 30.0 * i as f64), text, 11.0, Colour::INK, Anchor::Start, i == 2);
        }
        let svg = canvas.svg().unwrap();
        let told: Vec<&str> = svg.split("<text ").skip(1).collect();
        assert_eq!(told.len(), texts.len(), "{svg}");
        for (part, text) in told.iter().zip(texts) {
            let width = part.strip_prefix("textLength=\"").map(|rest| rest.split('"').next().unwrap());
            let width: Option<f64> = width.map(|width| width.parse().unwrap());
            assert_eq!(width.is_some(), text.len() > SHORT, "{part}");
            let own = font::width(text, 11.0) * SVG_STEPS;
            assert!(width.is_none_or(|width| (width - own).abs() <= 0.5), "{part}: {own}");
        }
    }
}
