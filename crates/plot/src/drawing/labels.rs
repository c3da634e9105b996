//! Names beside points, placed where they cover neither each other nor what is drawn.

use super::super::canvas::{Anchor, Area, Canvas, Point};
use super::super::font;
use super::super::projection::View;
use super::super::theme::{Colour, size};
use super::Label;

const HEIGHT: f64 = 10.0;

/// Writes each label at the best of many places around its point, with a thin line to it where it stands off.
pub(super) fn place(canvas: &mut Canvas, view: &View, labels: &[Label], busy: &[Point], area: Area) {
    let mut taken: Vec<Area> = Vec::new();
    for label in labels {
        let at = view.point(label.at);
        let width = font::width(&label.text, size::TICK);
        let boxes = candidates(at, width).filter(|b| inside(b, &area));
        let cost = |b: &Area| {
            let hidden = busy.iter().filter(|p| holds(b, **p, 1.5)).count() as f64;
            let crossed = taken.iter().filter(|t| overlap(b, t)).count() as f64;
            let far = distance(b, at);
            400.0 * crossed + 9.0 * hidden + far + if far > STANDS_OFF { 4.0 } else { 0.0 }
        };
        let Some(best) = boxes.min_by(|a, b| cost(a).total_cmp(&cost(b))) else { continue };
        if distance(&best, at) > STANDS_OFF {
            let foot = (at.0.clamp(best.x0, best.x1), at.1.clamp(best.y0, best.y1));
            canvas.line(&[at, foot], Colour::FRAME, 0.7);
        }
        canvas.rectangle(Area { x0: best.x0 - 1.0, x1: best.x1 + 1.0, ..best }, Colour(255, 255, 255), 0.75);
        canvas.text((best.x0, best.y1 - 2.4), &label.text, size::TICK, label.colour, Anchor::Start, false);
        taken.push(best);
    }
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
