//! Names beside points, placed where they cover neither each other nor what is drawn.

use super::super::canvas::{Anchor, Area, Canvas, Point};
use super::super::font;
use super::super::projection::View;
use super::super::theme::{Colour, size};
use super::Label;

const HEIGHT: f64 = 10.0;

/// Where a label stands, and the line to its point where it stands off.
struct Placed {
    own: Area,
    line: Option<[Point; 2]>,
}

/// Writes each label at the best of many places around its point, with a thin line to it where it stands off. No line is drawn over
/// a label.
pub(super) fn place(canvas: &mut Canvas, view: &View, labels: &[Label], busy: &[Point], area: Area) {
    let found = places(view, labels, busy, area);
    for line in found.iter().filter_map(|(_, placed)| placed.line) {
        canvas.line(&line, Colour::FRAME, 0.7);
    }
    for (label, Placed { own, .. }) in &found {
        canvas.rectangle(Area { x0: own.x0 - 1.0, x1: own.x1 + 1.0, ..*own }, Colour(255, 255, 255), 0.75);
        canvas.text((own.x0, own.y1 - 2.4), &label.text, size::TICK, label.colour, Anchor::Start, false);
    }
}

fn places<'a>(view: &View, labels: &'a [Label], busy: &[Point], area: Area) -> Vec<(&'a Label, Placed)> {
    let mut found: Vec<(&Label, Placed)> = Vec::new();
    let points: Vec<Point> = labels.iter().map(|label| view.point(label.at)).collect();
    for (label, at) in labels.iter().zip(points.iter().copied()) {
        let boxes = candidates(at, font::width(&label.text, size::TICK)).filter(|b| inside(b, &area));
        let cost = |own: &Area| {
            let hidden = busy.iter().filter(|p| holds(own, **p, 1.5)).count() as f64;
            let crossed = found.iter().filter(|(_, other)| overlap(own, &other.own)).count() as f64;
            let line = line_to(own, at);
            let struck = found.iter().filter(|(_, other)| {
                line.is_some_and(|line| crosses(&line, &other.own))
                    || other.line.is_some_and(|line| crosses(&line, own))
            });
            let far = distance(own, at);
            let apart = |p: &&Point| (p.0 - at.0).hypot(p.1 - at.1) > 1.0;
            let misread = points.iter().filter(apart).filter(|p| distance(own, **p) < far).count() as f64;
            25.0 * misread
                + 400.0 * crossed
                + 30.0 * struck.count() as f64
                + 9.0 * hidden
                + far
                + if line.is_some() { 4.0 } else { 0.0 }
        };
        let Some(own) = boxes.min_by(|a, b| cost(a).total_cmp(&cost(b))) else { continue };
        let line = line_to(&own, at);
        found.push((label, Placed { own, line }));
    }
    found
}

/// From a point to a label that stands off.
fn line_to(own: &Area, at: Point) -> Option<[Point; 2]> {
    let foot = (at.0.clamp(own.x0, own.x1), at.1.clamp(own.y0, own.y1));
    (distance(own, at) > STANDS_OFF).then_some([at, foot])
}

/// Whether a line goes over a label, by points a few units apart.
fn crosses(line: &[Point; 2], own: &Area) -> bool {
    const POINTS: usize = 24;
    let [from, to] = line;
    (0..=POINTS).any(|k| {
        let t = k as f64 / POINTS as f64;
        holds(own, (from.0 + t * (to.0 - from.0), from.1 + t * (to.1 - from.1)), 0.5)
    })
}

/// Beyond this a label has a line to its point, figure units.
const STANDS_OFF: f64 = 11.0;

/// Boxes on rings around a point.
fn candidates(at: Point, width: f64) -> impl Iterator<Item = Area> {
    let rings = [6.0, 12.0, 20.0, 30.0, 42.0, 56.0, 72.0];
    rings.into_iter().flat_map(move |r: f64| {
        (0..16).map(move |k| {
            let (s, c) = (std::f64::consts::TAU * f64::from(k) / 16.0).sin_cos();
            // the box touches the ring with its nearest side
            let (x, y) = (at.0 + r * c + 0.5 * width * c, at.1 - r * s - 0.5 * HEIGHT * s);
            Area { x0: x - 0.5 * width, y0: y - 0.5 * HEIGHT, x1: x + 0.5 * width, y1: y + 0.5 * HEIGHT }
        })
    })
}

fn inside(b: &Area, area: &Area) -> bool {
    b.x0 >= area.x0 && b.x1 <= area.x1 && b.y0 >= area.y0 && b.y1 <= area.y1 - 14.0
}

fn holds(b: &Area, p: Point, room: f64) -> bool {
    p.0 > b.x0 - room && p.0 < b.x1 + room && p.1 > b.y0 - room && p.1 < b.y1 + room
}

fn overlap(a: &Area, b: &Area) -> bool {
    a.x0 < b.x1 + 3.0 && b.x0 < a.x1 + 3.0 && a.y0 < b.y1 + 1.0 && b.y0 < a.y1 + 1.0
}

/// From a point to a box, 0 inside.
fn distance(b: &Area, p: Point) -> f64 {
    let (dx, dy) = ((b.x0 - p.0).max(p.0 - b.x1).max(0.0), (b.y0 - p.1).max(p.1 - b.y1).max(0.0));
    dx.hypot(dy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_strikes_the_labels_that_it_goes_over_and_no_others() {
        let own = Area { x0: 10.0, y0: 10.0, x1: 40.0, y1: 20.0 };
        for (from, to, over) in [
            ((0.0, 15.0), (50.0, 15.0), true),
            ((25.0, 0.0), (25.0, 30.0), true),
            ((0.0, 0.0), (50.0, 30.0), true),
            ((0.0, 5.0), (50.0, 5.0), false),
            ((0.0, 15.0), (8.0, 15.0), false),
        ] {
            assert_eq!(crosses(&[from, to], &own), over, "{from:?} to {to:?}");
        }
    }
}
