//! Bodies in space: bars, balls, boxes, rotors and joints in parallel projection, the nearest painted last.

use super::axis::{drawable, short, step};
use super::canvas::{Anchor, Area, Canvas, Point};
use super::legend::{Entry, Header, Mark};
use super::projection::View;
use super::theme::{Colour, size};
use nalgebra::Vector3;
use std::f64::consts::TAU;

mod labels;

/// Something to draw; world, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Item {
    /// A round bar.
    Bar {
        /// One end.
        from: [f64; 3],
        /// The other end.
        to: [f64; 3],
        /// m.
        radius: f64,
        /// Of its side.
        colour: Colour,
    },
    /// A ball.
    Ball {
        /// Its centre.
        at: [f64; 3],
        /// m.
        radius: f64,
        /// Of its side.
        colour: Colour,
    },
    /// A box.
    Box {
        /// Its centre.
        at: [f64; 3],
        /// Half edges, as vectors at right angles.
        half: [[f64; 3]; 3],
        /// Of its sides.
        colour: Colour,
    },
    /// A line without thickness: what joins things that have no shape.
    Stick {
        /// One end.
        from: [f64; 3],
        /// The other end.
        to: [f64; 3],
        /// Of the line.
        colour: Colour,
    },
    /// A disc with an arrow along its turn and its number.
    Rotor {
        /// Its centre.
        hub: [f64; 3],
        /// Unit vector.
        axis: [f64; 3],
        /// m.
        radius: f64,
        /// +1 counter-clockwise seen from the tip of the axis.
        spin: f64,
        /// As its command's.
        number: usize,
        /// Whether it stands above what carries it: then it hides that where both meet.
        above: bool,
    },
    /// The axis of a hinge, drawn through its joint.
    Hinge {
        /// The joint.
        at: [f64; 3],
        /// Unit vector.
        axis: [f64; 3],
    },
    /// The way of a slide, drawn as a double arrow.
    Slide {
        /// The joint.
        at: [f64; 3],
        /// Unit vector.
        axis: [f64; 3],
    },
    /// A joint that turns every way.
    Pivot {
        /// The joint.
        at: [f64; 3],
    },
}

/// A name beside a point.
#[derive(Debug, Clone, PartialEq)]
pub struct Label {
    /// World, m.
    pub at: [f64; 3],
    /// What to write.
    pub text: String,
    /// Of the text.
    pub colour: Colour,
}

/// A drawing of bodies seen from one side; x, y and z have the same scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    /// Above the chart, at the left.
    pub title: String,
    /// In any order.
    pub items: Vec<Item>,
    /// Placed where they hide little.
    pub labels: Vec<Label>,
    /// Direction of the viewer about z, counter-clockwise from +x, degrees.
    pub azimuth_deg: f64,
    /// Height of the viewer above the horizon, degrees.
    pub elevation_deg: f64,
    /// Height of a floor to draw with a grid, m.
    pub floor: Option<f64>,
    /// Opposite corners of a box that fills the chart whatever the items do: for pictures that follow each other.
    pub room: Option<[[f64; 3]; 2]>,
    /// Whether to explain colours above the chart.
    pub legend: bool,
}

impl Drawing {
    /// Seen from between +x and −y, 24° above the horizon.
    pub fn new(title: impl Into<String>, items: Vec<Item>) -> Self {
        Self {
            title: title.into(),
            items,
            labels: Vec::new(),
            azimuth_deg: -58.0,
            elevation_deg: 24.0,
            floor: None,
            room: None,
            legend: false,
        }
    }

    /// With names.
    pub fn labels(mut self, labels: Vec<Label>) -> Self {
        self.labels = labels;
        self
    }

    /// From elsewhere: azimuth and elevation in degrees.
    pub fn seen_from(mut self, azimuth_deg: f64, elevation_deg: f64) -> Self {
        (self.azimuth_deg, self.elevation_deg) = (azimuth_deg, elevation_deg);
        self
    }

    /// With a floor at this height, m.
    pub fn floor(mut self, height: f64) -> Self {
        self.floor = Some(height);
        self
    }

    /// With a box that fills the chart, by opposite corners.
    pub fn room(mut self, corners: [[f64; 3]; 2]) -> Self {
        self.room = Some(corners);
        self
    }

    /// With an explanation of the colours.
    pub fn legend(mut self) -> Self {
        self.legend = true;
        self
    }

    pub(super) fn draw(&self, canvas: &mut Canvas, area: Area) {
        let header = Header::new(&self.title, if self.legend { self.entries() } else { Vec::new() }, area.width());
        header.draw(canvas, area.x0, area.x1, area.y0);
        let side = if self.labels.is_empty() { 10.0 } else { 30.0 };
        let room = Area {
            x0: area.x0 + side,
            y0: area.y0 + header.height + if self.labels.is_empty() { 8.0 } else { 16.0 },
            x1: area.x1 - side,
            y1: area.y1 - 34.0,
        };
        let mut points: Vec<[f64; 3]> = match self.room {
            Some(box_) => (0..8).map(|k| [0, 1, 2].map(|i| box_[k >> i & 1][i])).collect(),
            None => self.items.iter().flat_map(Item::extent).collect(),
        };
        points.retain(|p| p.iter().all(|v| drawable(*v, false)));
        let floor = self.floor.filter(|_| self.elevation_deg > 1.0 && !points.is_empty());
        let floor = floor.map(|height| Floor::under(&points, height));
        points.extend(floor.iter().flat_map(Floor::corners));
        let view = (!points.is_empty()).then(|| View::fit(self.azimuth_deg, self.elevation_deg, &points, room));
        let Some(view) = view.flatten() else {
            let middle = (0.5 * (room.x0 + room.x1), 0.5 * (room.y0 + room.y1));
            canvas.text(middle, "nothing to draw", size::LABEL, Colour::GREY, Anchor::Middle, false);
            return;
        };
        let bar = step(0.24 * room.width().min(room.height()) / view.scale, 1);
        if let Some(floor) = floor {
            floor.draw(canvas, &view);
        }
        paint(canvas, &view, &self.items);
        let busy: Vec<Point> = self.items.iter().flat_map(|item| item.busy(&view)).map(|p| view.point(p)).collect();
        labels::place(canvas, &view, &self.labels, &busy, area);
        draw_triad(canvas, &view, (area.x0 + 24.0, area.y1 - 24.0));
        draw_scale_bar(canvas, &view, bar, (area.x1 - 6.0, area.y1 - 8.0));
    }

    fn entries(&self) -> Vec<Entry> {
        let mut entries = Vec::new();
        let mut add = |name: &str, colour, mark| entries.push(Entry { name: name.into(), colour, mark });
        let line = Mark::Line { dashed: false, width: 2.0 };
        let any = |of: fn(&Item) -> bool| self.items.iter().any(of);
        if any(|i| matches!(i, Item::Rotor { spin, .. } if *spin > 0.0)) {
            add("rotor, counter-clockwise", Colour::BLUE, line);
        }
        if any(|i| matches!(i, Item::Rotor { spin, .. } if *spin <= 0.0)) {
            add("rotor, clockwise", Colour::VERMILLION, line);
        }
        if any(|i| matches!(i, Item::Hinge { .. })) {
            add("axis of a hinge", Colour::PURPLE, line);
        }
        if any(|i| matches!(i, Item::Slide { .. })) {
            add("slide", Colour::GREEN, line);
        }
        if any(|i| matches!(i, Item::Pivot { .. })) {
            add("ball joint", Colour::PURPLE, Mark::Dot);
        }
        entries
    }
}

/// Paints things, the nearest last.
pub(super) fn paint(canvas: &mut Canvas, view: &View, items: &[Item]) {
    let mut faces: Vec<Face> = items.iter().flat_map(|item| item.faces(view)).collect();
    faces.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    for face in &faces {
        face.paint.draw(canvas);
    }
}

/// One thing to paint, and how near the viewer it is.
struct Face {
    depth: f64,
    paint: Paint,
}

enum Paint {
    Polygon(Vec<Point>, Colour),
    Line(Vec<Point>, Colour, f64),
    /// Filled, with a rim.
    Disc(Point, f64, Colour, Colour),
    Number(Point, String, Colour),
}

impl Paint {
    fn draw(&self, canvas: &mut Canvas) {
        match self {
            Self::Polygon(points, colour) => canvas.polygon(points.clone(), *colour),
            Self::Line(points, colour, width) => canvas.line(points, *colour, *width),
            Self::Disc(at, radius, fill, rim) => {
                canvas.disc(*at, radius + 0.45, *rim);
                canvas.disc(*at, (radius - 0.45).max(0.0), *fill);
            }
            Self::Number(at, text, colour) => {
                canvas.text((at.0, at.1 + 2.6), text, 7.5, *colour, Anchor::Middle, false);
            }
        }
    }
}

/// Half length of the drawn axis of a hinge and of a slide, figure units.
const AXIS: f64 = 9.0;
const SLIDE: f64 = 24.0;
/// Joints lie inside bodies: they are painted last.
const ON_TOP: f64 = 1e9;

impl Item {
    /// Points that must lie in the picture.
    pub(super) fn extent(&self) -> Vec<[f64; 3]> {
        match *self {
            Self::Bar { from, to, radius, .. } => [from, to].iter().flat_map(|p| around(*p, radius)).collect(),
            Self::Ball { at, radius, .. } => around(at, radius).to_vec(),
            Self::Box { at, half, .. } => corners(at, &half).to_vec(),
            Self::Stick { from, to, .. } => vec![from, to],
            Self::Rotor { hub, axis, radius, .. } => circle(hub, axis, radius, 0.0, TAU, 16),
            Self::Hinge { at, .. } | Self::Slide { at, .. } | Self::Pivot { at } => vec![at],
        }
    }

    /// Points that labels should not cover.
    fn busy(&self, view: &View) -> Vec<[f64; 3]> {
        match *self {
            Self::Bar { from, to, .. } | Self::Stick { from, to, .. } => {
                pieces(view, from, to).into_iter().map(|(a, _)| a).chain([to]).collect()
            }
            Self::Rotor { hub, axis, radius, .. } => {
                let mut points = circle(hub, axis, radius, 0.0, TAU, 20);
                points.extend(circle(hub, axis, 0.5 * radius, 0.0, TAU, 10));
                points
            }
            Self::Box { at, half, .. } => {
                let third = |k: usize| [k % 3, k / 3 % 3, k / 9].map(|i| i as f64 - 1.0);
                let offset = |s: [f64; 3]| (0..3).map(|i| Vector3::from(half[i]) * s[i]).sum::<Vector3<f64>>();
                (0..27).map(|k| moved(at, offset(third(k)))).collect()
            }
            Self::Ball { at, radius, .. } => around(at, 0.7 * radius).into_iter().chain([at]).collect(),
            Self::Hinge { at, axis } => ends(view, at, axis, AXIS / view.scale).into_iter().chain([at]).collect(),
            Self::Slide { at, axis } => {
                let [a, b] = ends(view, at, axis, SLIDE / view.scale);
                (0..=4).map(|k| mix(a, b, f64::from(k) / 4.0)).collect()
            }
            Self::Pivot { at } => vec![at],
        }
    }

    fn faces(&self, view: &View) -> Vec<Face> {
        match *self {
            Self::Bar { from, to, radius, colour } => bar(view, from, to, radius, colour),
            Self::Ball { at, radius, colour } => {
                let r = (radius * view.scale).max(1.6);
                // as if it began where its surface does: bars end in it
                let depth = view.depth(at) + radius;
                vec![Face { depth, paint: Paint::Disc(view.point(at), r, colour, colour.darker()) }]
            }
            Self::Box { at, half, colour } => cuboid(view, at, &half, colour),
            Self::Stick { from, to, colour } => pieces(view, from, to)
                .into_iter()
                .map(|(a, b)| Face {
                    depth: view.depth(mix(a, b, 0.5)),
                    paint: Paint::Line(vec![view.point(a), view.point(b)], colour, 1.5),
                })
                .collect(),
            Self::Rotor { .. } => rotor(view, self),
            Self::Hinge { at, axis } => {
                let [a, b] = ends(view, at, axis, AXIS / view.scale);
                let depth = view.depth(at) + ON_TOP;
                let (line, p) = (vec![view.point(a), view.point(b)], view.point(at));
                vec![
                    Face { depth, paint: Paint::Line(line.clone(), WHITE, 3.4) },
                    Face { depth, paint: Paint::Line(line, Colour::PURPLE, 2.0) },
                    Face { depth, paint: Paint::Disc(p, 2.4, WHITE, Colour::PURPLE) },
                ]
            }
            Self::Slide { at, axis } => slide(view, at, axis),
            Self::Pivot { at } => {
                let depth = view.depth(at) + ON_TOP;
                vec![Face { depth, paint: Paint::Disc(view.point(at), 3.6, WHITE, Colour::PURPLE) }]
            }
        }
    }
}

const WHITE: Colour = Colour(255, 255, 255);

fn mix(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + t * (b[i] - a[i]))
}

fn moved(a: [f64; 3], d: Vector3<f64>) -> [f64; 3] {
    (Vector3::from(a) + d).into()
}

fn around(p: [f64; 3], r: f64) -> [[f64; 3]; 6] {
    let unit = |k: usize| Vector3::from_fn(|i, _| if i == k % 3 { if k < 3 { r } else { -r } } else { 0.0 });
    std::array::from_fn(|k| moved(p, unit(k)))
}

fn corners(at: [f64; 3], half: &[[f64; 3]; 3]) -> [[f64; 3]; 8] {
    let sign = |k: usize, i: usize| if k >> i & 1 == 0 { -1.0 } else { 1.0 };
    std::array::from_fn(|k| moved(at, (0..3).map(|i| Vector3::from(half[i]) * sign(k, i)).sum()))
}

/// Two unit vectors across `axis`, right-handed with it.
fn across(axis: [f64; 3]) -> [Vector3<f64>; 2] {
    let n = Vector3::from(axis);
    let least = if n.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let u = (least - n * n.dot(&least)).normalize();
    [u, n.cross(&u)]
}

/// Points of an arc about `axis`, by the right hand.
fn circle(hub: [f64; 3], axis: [f64; 3], radius: f64, from: f64, to: f64, n: usize) -> Vec<[f64; 3]> {
    let [u, v] = across(axis);
    let point = |k: usize| {
        let (s, c) = (from + (to - from) * k as f64 / n as f64).sin_cos();
        moved(hub, (u * c + v * s) * radius)
    };
    (0..=n).map(point).collect()
}

/// `at` ± `length` along `axis`.
fn ends(view: &View, at: [f64; 3], axis: [f64; 3], length: f64) -> [[f64; 3]; 2] {
    let n = Vector3::from(axis);
    // an axis towards the viewer keeps a visible length
    let (x, y) = view.direction(n);
    let shown = length * (0.6 / x.hypot(y).max(1e-3)).clamp(1.0, 1.8);
    [moved(at, -n * shown), moved(at, n * shown)]
}

/// Short parts of a line, so that depth is known along it.
fn pieces(view: &View, from: [f64; 3], to: [f64; 3]) -> Vec<([f64; 3], [f64; 3])> {
    let length = (Vector3::from(to) - Vector3::from(from)).norm() * view.scale;
    let n = (length / 8.0).ceil().clamp(1.0, 120.0);
    let at = |k: usize| mix(from, to, k as f64 / n);
    (0..n as usize).map(|k| (at(k), at(k + 1))).collect()
}

fn bar(view: &View, from: [f64; 3], to: [f64; 3], radius: f64, colour: Colour) -> Vec<Face> {
    let r = (radius * view.scale).max(1.1);
    let end = |p: [f64; 3]| Face {
        depth: view.depth(p) - 1e-9,
        paint: Paint::Disc(view.point(p), r, colour, colour.darker()),
    };
    let mut faces = vec![end(from), end(to)];
    let (a, b) = (view.point(from), view.point(to));
    let length = (b.0 - a.0).hypot(b.1 - a.1);
    if length < 0.5 {
        return faces;
    }
    let n = (-(b.1 - a.1) / length * r, (b.0 - a.0) / length * r);
    let side = |p: Point, s: f64| (p.0 + s * n.0, p.1 + s * n.1);
    for (p, q) in pieces(view, from, to) {
        let depth = view.depth(mix(p, q, 0.5));
        let (p, q) = (view.point(p), view.point(q));
        let quad = vec![side(p, 1.0), side(q, 1.0), side(q, -1.0), side(p, -1.0)];
        faces.push(Face { depth, paint: Paint::Polygon(quad, colour) });
        for s in [1.0, -1.0] {
            faces.push(Face { depth, paint: Paint::Line(vec![side(p, s), side(q, s)], colour.darker(), 0.9) });
        }
    }
    faces
}

fn cuboid(view: &View, at: [f64; 3], half: &[[f64; 3]; 3], colour: Colour) -> Vec<Face> {
    let mut faces = Vec::new();
    for i in 0..3 {
        let n = Vector3::from(half[i]);
        let facing = n.dot(&view.toward);
        let n = if facing < 0.0 { -n } else { n };
        if facing.abs() < 1e-9 * n.norm() {
            continue;
        }
        let (u, v) = (Vector3::from(half[(i + 1) % 3]), Vector3::from(half[(i + 2) % 3]));
        let centre = moved(at, n);
        let rim: Vec<Point> = [u + v, v - u, -u - v, u - v, u + v].map(|d| view.point(moved(centre, d))).into();
        // lighter from above, darker at the sides
        let light = 0.80 + 0.26 * (n.z / n.norm()).max(0.0) + 0.08 * (n.x / n.norm()).abs();
        let depth = view.depth(at) + 0.25 * facing.abs();
        faces.push(Face { depth, paint: Paint::Polygon(rim[..4].to_vec(), colour.times(light)) });
        faces.push(Face { depth, paint: Paint::Line(rim, colour.darker(), 0.9) });
    }
    faces
}

fn rotor(view: &View, item: &Item) -> Vec<Face> {
    let Item::Rotor { hub, axis, radius, spin, number, above } = *item else { return Vec::new() };
    let colour = if spin > 0.0 { Colour::BLUE } else { Colour::VERMILLION };
    let facing = Vector3::from(axis).dot(&view.toward);
    let depth = view.depth(hub) + if above && facing > 0.0 { 0.95 * radius } else { 0.0 };
    let page = |points: Vec<[f64; 3]>| points.into_iter().map(|p| view.point(p)).collect::<Vec<Point>>();
    let rim = page(circle(hub, axis, radius, 0.0, TAU, 40));
    // the arrow stands on the rim's near side
    let [u, v] = across(axis);
    let near = (v.dot(&view.toward)).atan2(u.dot(&view.toward));
    let tip = near + spin * 0.30;
    let place = |angle: f64, r: f64| moved(hub, (u * angle.cos() + v * angle.sin()) * r);
    let back = tip - spin * (8.0 / (radius * view.scale)).min(0.8);
    let half = 3.6 / view.scale;
    let head = page(vec![place(tip, radius), place(back, radius + half), place(back, radius - half)]);
    let mut faces = vec![
        Face { depth, paint: Paint::Polygon(rim[..40].to_vec(), colour.tint()) },
        Face { depth, paint: Paint::Line(rim, colour, 1.1) },
    ];
    if radius * view.scale > 5.0 {
        faces.push(Face { depth, paint: Paint::Polygon(head, colour) });
    }
    if radius * view.scale * facing.abs() > 4.0 {
        faces.push(Face { depth, paint: Paint::Number(view.point(hub), number.to_string(), colour.darker()) });
    }
    faces
}

fn slide(view: &View, at: [f64; 3], axis: [f64; 3]) -> Vec<Face> {
    let [a, b] = ends(view, at, axis, SLIDE / view.scale);
    let (a, b, depth) = (view.point(a), view.point(b), view.depth(at) + ON_TOP);
    let length = (b.0 - a.0).hypot(b.1 - a.1).max(1e-9);
    let (ux, uy) = ((b.0 - a.0) / length, (b.1 - a.1) / length);
    let head = |p: Point, s: f64| {
        let foot = (p.0 - s * 5.5 * ux, p.1 - s * 5.5 * uy);
        vec![p, (foot.0 - 3.0 * uy, foot.1 + 3.0 * ux), (foot.0 + 3.0 * uy, foot.1 - 3.0 * ux)]
    };
    vec![
        Face { depth, paint: Paint::Line(vec![a, b], Colour::GREEN, 1.8) },
        Face { depth, paint: Paint::Polygon(head(b, 1.0), Colour::GREEN) },
        Face { depth, paint: Paint::Polygon(head(a, -1.0), Colour::GREEN) },
    ]
}

/// A pale rectangle under everything, with a grid.
struct Floor {
    lo: [f64; 2],
    hi: [f64; 2],
    height: f64,
    every: f64,
}

impl Floor {
    fn under(points: &[[f64; 3]], height: f64) -> Self {
        let fold = |i: usize, of: fn(f64, f64) -> f64, start: f64| points.iter().map(|p| p[i]).fold(start, of);
        let lo = [0, 1].map(|i| fold(i, f64::min, f64::INFINITY));
        let hi = [0, 1].map(|i| fold(i, f64::max, f64::NEG_INFINITY));
        let longest = (hi[0] - lo[0]).max(hi[1] - lo[1]).max(1e-6);
        let room = 0.05 * longest;
        Self { lo: lo.map(|v| v - room), hi: hi.map(|v| v + room), height, every: step(longest, 5) }
    }

    fn corners(&self) -> [[f64; 3]; 4] {
        let (lo, hi, z) = (self.lo, self.hi, self.height);
        [[lo[0], lo[1], z], [hi[0], lo[1], z], [hi[0], hi[1], z], [lo[0], hi[1], z]]
    }

    fn draw(&self, canvas: &mut Canvas, view: &View) {
        canvas.polygon(self.corners().map(|c| view.point(c)).into(), Colour(248, 249, 250));
        let at = |x: f64, y: f64| view.point([x, y, self.height]);
        let lines = |i: usize| {
            let first = (self.lo[i] / self.every).ceil();
            let n = ((self.hi[i] / self.every).floor() - first).clamp(0.0, 60.0) as usize;
            (0..=n).map(move |k| (first + k as f64) * self.every)
        };
        canvas.line(&[0, 1, 2, 3, 0].map(|k| view.point(self.corners()[k])), Colour::GRID, 0.9);
        for x in lines(0) {
            canvas.line(&[at(x, self.lo[1]), at(x, self.hi[1])], Colour::GRID, 0.7);
        }
        for y in lines(1) {
            canvas.line(&[at(self.lo[0], y), at(self.hi[0], y)], Colour::GRID, 0.7);
        }
    }
}

/// The directions of x, y and z.
fn draw_triad(canvas: &mut Canvas, view: &View, foot: Point) {
    const LENGTH: f64 = 20.0;
    let axes = [("x", Vector3::x()), ("y", Vector3::y()), ("z", Vector3::z())];
    for (name, axis) in axes {
        let (x, y) = view.direction(axis);
        let length = x.hypot(y);
        let tip = (foot.0 + LENGTH * x, foot.1 + LENGTH * y);
        if length < 0.15 {
            continue;
        }
        canvas.line(&[foot, tip], Colour::INK, 1.1);
        let (ux, uy) = (x / length, y / length);
        let wing = |s: f64| (tip.0 - 2.4 * ux + s * 1.7 * uy, tip.1 - 2.4 * uy - s * 1.7 * ux);
        canvas.polygon(vec![(tip.0 + 2.4 * ux, tip.1 + 2.4 * uy), wing(1.0), wing(-1.0)], Colour::INK);
        let spot = (tip.0 + 8.0 * ux, tip.1 + 8.0 * uy + 3.0);
        canvas.text(spot, name, size::TICK, Colour::INK, Anchor::Middle, false);
    }
}

/// A length on the page, ending at the right.
fn draw_scale_bar(canvas: &mut Canvas, view: &View, length: f64, (right, y): Point) {
    let left = right - length * view.scale;
    canvas.line(&[(left, y), (right, y)], Colour::INK, 1.3);
    for x in [left, right] {
        canvas.line(&[(x, y - 3.0), (x, y + 3.0)], Colour::INK, 1.3);
    }
    let text = if length < 0.095 { format!("{} mm", short(1e3 * length)) } else { format!("{} m", plain(length)) };
    canvas.text((0.5 * (left + right), y - 5.0), &text, size::TICK, Colour::INK, Anchor::Middle, false);
}

/// A tidy length without trailing zeros.
fn plain(length: f64) -> String {
    let text = format!("{length:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}
