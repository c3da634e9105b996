//! A flown path in space against its reference: equal scales, ground shadow, attitude marks, colour by a quantity.

use super::axis::{drawable, number, short, step};
use super::canvas::{Anchor, Area, Canvas, Point};
use super::drawing::{Item, paint};
use super::font;
use super::legend::{Entry, Header, Mark};
use super::projection::View;
use super::theme::{Colour, size};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// A quantity along the path, shown as colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Heat {
    /// With its unit: `speed [m/s]`.
    pub label: String,
    /// One value per point of the path.
    pub values: Vec<f64>,
}

/// Where the vehicle was and how it stood.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// World, m.
    pub position: [f64; 3],
    /// Body → world, `[w, x, y, z]`.
    pub attitude: [f64; 4],
}

/// A three-dimensional path chart in parallel projection; x, y and z have the same scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Path3d {
    /// Above the chart, at the left.
    pub title: String,
    /// What the path is in the legend.
    pub name: String,
    /// Points of the path, m; non-finite ones leave gaps.
    pub flown: Vec<[f64; 3]>,
    /// Points of the reference, m, drawn dashed.
    pub reference: Vec<[f64; 3]>,
    /// Colours the path.
    pub heat: Option<Heat>,
    /// Small vehicles drawn along the path.
    pub poses: Vec<Pose>,
    /// Rotors of each of them, evenly about its axis; 4 unless told otherwise.
    pub n_rotor: usize,
    /// Balls at true scale, m: what hangs on the vehicle, with its radius.
    pub balls: Vec<([f64; 3], f64)>,
    /// Straight lines at true scale, m: what hangs on the vehicle, here and there along the path.
    pub sticks: Vec<[[f64; 3]; 2]>,
    /// What stands about, at true scale; what is far from the path is left out.
    pub obstacles: Vec<Item>,
    /// Direction of the viewer about z, counter-clockwise from +x, degrees.
    pub azimuth_deg: f64,
    /// Height of the viewer above the horizon, degrees in [5, 85].
    pub elevation_deg: f64,
}

impl Path3d {
    /// A path seen from between +x and −y, 26° above the horizon.
    pub fn new(title: impl Into<String>, flown: Vec<[f64; 3]>) -> Self {
        Self {
            title: title.into(),
            name: "flown".into(),
            flown,
            reference: Vec::new(),
            heat: None,
            poses: Vec::new(),
            n_rotor: 4,
            balls: Vec::new(),
            sticks: Vec::new(),
            obstacles: Vec::new(),
            azimuth_deg: -62.0,
            elevation_deg: 26.0,
        }
    }

    /// Under another name than `flown` in the legend.
    pub fn called(mut self, name: impl Into<String>) -> Self {
        self.name = name.into();
        self
    }

    /// With a dashed reference.
    pub fn reference(mut self, points: Vec<[f64; 3]>) -> Self {
        self.reference = points;
        self
    }

    /// Coloured by `values`, one per point of the path.
    pub fn heat(mut self, label: impl Into<String>, values: Vec<f64>) -> Self {
        self.heat = Some(Heat { label: label.into(), values });
        self
    }

    /// With small vehicles along the path.
    pub fn poses(mut self, poses: Vec<Pose>) -> Self {
        self.poses = poses;
        self
    }

    /// The vehicles with so many rotors.
    pub fn rotors(mut self, n_rotor: usize) -> Self {
        self.n_rotor = n_rotor;
        self
    }

    /// With balls at true scale: centre and radius, m.
    pub fn balls(mut self, balls: Vec<([f64; 3], f64)>) -> Self {
        self.balls = balls;
        self
    }

    /// With straight lines at true scale.
    pub fn sticks(mut self, sticks: Vec<[[f64; 3]; 2]>) -> Self {
        self.sticks = sticks;
        self
    }

    /// Among what stands about: bars, balls and boxes.
    pub fn obstacles(mut self, obstacles: Vec<Item>) -> Self {
        self.obstacles = obstacles;
        self
    }

    /// The room of all that is drawn, and which obstacles stand in it.
    fn scene(&self) -> (Box3, Vec<Item>) {
        let seen = |p: &&[f64; 3]| p.iter().all(|v| drawable(*v, false));
        let path = self.flown.iter().chain(&self.reference).chain(self.sticks.as_flattened()).filter(seen);
        let mut scene = Box3::around(path);
        let near = scene.wider(NEAR.max(0.5 * scene.longest()));
        let stands = |item: &&Item| {
            let own = Box3::around(item.extent().iter().filter(seen));
            // a wall or a floor that is much larger than the flight would make it a speck
            near.meets(&own) && own.longest() <= 4.0 * near.longest()
        };
        let obstacles: Vec<Item> = self.obstacles.iter().filter(stands).copied().collect();
        for item in &obstacles {
            scene = scene.with(&Box3::around(item.extent().iter().filter(seen)));
        }
        scene.tidy();
        (scene, obstacles)
    }

    pub(super) fn draw(&self, canvas: &mut Canvas, area: Area) {
        let seen = |p: &&[f64; 3]| p.iter().all(|v| drawable(*v, false));
        let heat_range = self.heat_range();
        let header = Header::new(&self.title, self.entries(), area.width());
        header.draw(canvas, area.x0, area.x1, area.y0);
        let bar = if heat_range.is_some() { 24.0 } else { 0.0 };
        let room = Area { x0: area.x0, y0: area.y0 + header.height + 4.0, x1: area.x1, y1: area.y1 - bar };
        let (scene, obstacles) = self.scene();
        let inner = Area {
            x0: room.x0 + LABEL_ROOM.0,
            y0: room.y0 + 4.0,
            x1: room.x1 - LABEL_ROOM.0,
            y1: room.y1 - LABEL_ROOM.1,
        };
        let elevation = if self.elevation_deg.is_finite() { self.elevation_deg.clamp(5.0, 85.0) } else { 23.0 };
        let Some(view) = View::fit(self.azimuth_deg, elevation, &scene.corners(), inner) else { return };
        draw_box(canvas, &view, &scene);
        // behind the path, all of which is to be seen
        paint(canvas, &view, &obstacles);
        let floor = scene.lo[2];
        let shadow: Vec<Point> = self.flown.iter().map(|p| view.point([p[0], p[1], floor])).collect();
        for run in runs(&shadow) {
            canvas.line(&super::chart::decimate(run), Colour::SHADOW, 1.6);
        }
        let reference: Vec<Point> = self.reference.iter().map(|p| view.point(*p)).collect();
        for run in runs(&reference) {
            canvas.dashed(&super::chart::decimate(run), Colour::INK, 1.0, 4.0, 3.0);
        }
        self.draw_flown(canvas, &view, heat_range);
        for [a, b] in &self.sticks {
            canvas.line(&[view.point(*a), view.point(*b)], Colour::INK, 0.9);
        }
        for (at, radius) in &self.balls {
            canvas.disc(view.point(*at), (radius * view.scale).max(2.0), Colour::ORANGE);
        }
        let arm = 0.026 * scene.longest();
        for pose in &self.poses {
            draw_pose(canvas, &view, pose, arm, self.n_rotor);
        }
        let ends = [self.flown.iter().find(seen), self.flown.iter().rev().find(seen)];
        if let [Some(first), Some(last)] = ends {
            canvas.disc(view.point(*first), 4.2, Colour(255, 255, 255));
            canvas.disc(view.point(*first), 3.4, Colour::GREEN);
            let (x, y) = view.point(*last);
            let square = |r: f64| Area { x0: x - r, y0: y - r, x1: x + r, y1: y + r };
            canvas.rectangle(square(3.9), Colour(255, 255, 255), 1.0);
            canvas.rectangle(square(3.1), Colour::VERMILLION, 1.0);
        } else if self.reference.iter().find(seen).is_none() {
            let middle = (0.5 * (room.x0 + room.x1), 0.5 * (room.y0 + room.y1));
            canvas.text(middle, "no finite data", size::LABEL, Colour::GREY, Anchor::Middle, false);
        }
        if let (Some(heat), Some(range)) = (&self.heat, heat_range) {
            draw_heat_bar(canvas, &heat.label, range, 0.5 * (area.x0 + area.x1), area.y1 - 8.0);
        }
    }

    fn entries(&self) -> Vec<Entry> {
        let mut entries = Vec::new();
        let mut add = |name: &str, colour, mark| entries.push(Entry { name: name.into(), colour, mark });
        let flown = if self.heat.is_some() { Colour::heat(0.45) } else { Colour::BLUE };
        add(&self.name, flown, Mark::Line { dashed: false, width: 2.0 });
        if !self.reference.is_empty() {
            add("reference", Colour::INK, Mark::Line { dashed: true, width: 1.0 });
        }
        add("shadow on the floor", Colour::SHADOW, Mark::Line { dashed: false, width: 1.6 });
        add("start", Colour::GREEN, Mark::Dot);
        add("end", Colour::VERMILLION, Mark::Square);
        entries
    }

    fn heat_range(&self) -> Option<(f64, f64)> {
        let values = &self.heat.as_ref()?.values;
        let finite = values.iter().copied().filter(|v| drawable(*v, false));
        let (lo, hi) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)));
        (lo <= hi).then_some((lo, hi.max(lo + LEAST_HEAT)))
    }

    fn draw_flown(&self, canvas: &mut Canvas, view: &View, heat_range: Option<(f64, f64)>) {
        let points: Vec<Point> = self.flown.iter().map(|p| view.point(*p)).collect();
        let (Some(heat), Some((lo, hi))) = (&self.heat, heat_range) else {
            for run in runs(&points) {
                canvas.line(&super::chart::decimate(run), Colour::BLUE, 2.0);
            }
            return;
        };
        // Runs of one colour out of 48 become one polyline each; neighbours share an end so that no gap shows.
        let shade = |i: usize| {
            let v = heat.values.get(i).copied().unwrap_or(lo);
            ((v - lo) / (hi - lo) * 47.0).round().clamp(0.0, 47.0) as u8
        };
        let mut start = 0;
        for i in 1..=points.len() {
            if i == points.len() || shade(i) != shade(start) {
                let end = (i + 1).min(points.len());
                for run in runs(&points[start..end]) {
                    let thin = super::chart::decimate(run);
                    canvas.line(&thin, Colour::heat(f64::from(shade(start)) / 47.0), 2.0);
                }
                start = i;
            }
        }
    }
}

/// Maximal runs of finite points.
fn runs(points: &[Point]) -> impl Iterator<Item = &[Point]> {
    points.split(|p| !(p.0.is_finite() && p.1.is_finite())).filter(|r| !r.is_empty())
}

/// Obstacles nearer to the path than this are drawn, m.
const NEAR: f64 = 2.0;
/// A path no longer than this is a point, m.
const STANDS: f64 = 1e-3;
/// Least range of what colours a path, in its unit.
const LEAST_HEAT: f64 = 1e-3;

/// Bounds of the data.
#[derive(Debug, Clone, Copy)]
struct Box3 {
    lo: [f64; 3],
    hi: [f64; 3],
}

impl Box3 {
    fn around<'a>(points: impl Iterator<Item = &'a [f64; 3]>) -> Self {
        let mut bounds = Self { lo: [f64::INFINITY; 3], hi: [f64::NEG_INFINITY; 3] };
        for p in points {
            for (i, v) in p.iter().enumerate() {
                bounds.lo[i] = bounds.lo[i].min(*v);
                bounds.hi[i] = bounds.hi[i].max(*v);
            }
        }
        if bounds.lo[0] > bounds.hi[0] { Self { lo: [0.0; 3], hi: [1.0; 3] } } else { bounds }
    }

    /// With this much more room on every side, m.
    fn wider(&self, room: f64) -> Self {
        Self { lo: self.lo.map(|v| v - room), hi: self.hi.map(|v| v + room) }
    }

    fn meets(&self, other: &Self) -> bool {
        (0..3).all(|i| self.lo[i] <= other.hi[i] && other.lo[i] <= self.hi[i])
    }

    /// That holds both.
    fn with(&self, other: &Self) -> Self {
        let fold = |of: fn(f64, f64) -> f64, a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|i| of(a[i], b[i]));
        Self { lo: fold(f64::min, self.lo, other.lo), hi: fold(f64::max, self.hi, other.hi) }
    }

    fn corners(&self) -> [[f64; 3]; 8] {
        std::array::from_fn(|k| std::array::from_fn(|i| if k >> i & 1 == 0 { self.lo[i] } else { self.hi[i] }))
    }

    fn longest(&self) -> f64 {
        (0..3).map(|i| self.hi[i] - self.lo[i]).fold(0.0, f64::max)
    }

    /// Some room around the data, no side much shorter than the others, the floor at z = 0 when that is near.
    fn tidy(&mut self) {
        let size = self.lo.iter().chain(&self.hi).fold(0.0f64, |m, v| m.max(v.abs()));
        let longest = self.longest();
        // what moves less than a millimetre stands: a smaller room would show rounding
        let longest = if longest > STANDS.max(1e-9 * size) { longest } else { (0.2 * size).max(1.0) };
        for i in 0..3 {
            let least = if i == 2 { 0.3 } else { 0.45 } * longest;
            let lack = (least - (self.hi[i] - self.lo[i])).max(0.1 * longest);
            self.lo[i] -= 0.5 * lack;
            self.hi[i] += 0.5 * lack;
        }
        let below = self.lo[2];
        if below > 0.0 && below < 0.5 * longest {
            self.lo[2] = 0.0;
        }
    }
}

/// Room for tick labels around the projected box, figure units.
const LABEL_ROOM: (f64, f64) = (34.0, 26.0);

/// Floor, the two far walls, their grid, tick labels and axis names.
fn draw_box(canvas: &mut Canvas, view: &View, scene: &Box3) {
    let far = |i: usize| if view.toward[i] > 0.0 { scene.lo[i] } else { scene.hi[i] };
    let near = |i: usize| if view.toward[i] > 0.0 { scene.hi[i] } else { scene.lo[i] };
    let (floor, top) = (scene.lo[2], scene.hi[2]);
    let every = step(scene.longest(), 6);
    let decimals = (-(every * 1.0001).log10().floor()).clamp(0.0, 9.0) as usize;
    let ticks = |i: usize| {
        let first = (scene.lo[i] / every - 1e-9).ceil();
        let count = ((scene.hi[i] / every + 1e-9).floor() - first).clamp(-1.0, 20.0) as i64;
        (0..=count).map(move |k| (first + k as f64) * every).collect::<Vec<f64>>()
    };
    let label = |v: f64| if (1e-3..1e5).contains(&every) { number(v, decimals) } else { short(v) };
    let floor_corners = [
        [scene.lo[0], scene.lo[1]],
        [scene.hi[0], scene.lo[1]],
        [scene.hi[0], scene.hi[1]],
        [scene.lo[0], scene.hi[1]],
    ];
    canvas.polygon(floor_corners.iter().map(|c| view.point([c[0], c[1], floor])).collect(), Colour(248, 249, 250));
    let mut segment = |a: [f64; 3], b: [f64; 3], colour: Colour, width: f64| {
        canvas.line(&[view.point(a), view.point(b)], colour, width);
    };
    for x in ticks(0) {
        segment([x, scene.lo[1], floor], [x, scene.hi[1], floor], Colour::GRID, 0.7);
        segment([x, far(1), floor], [x, far(1), top], Colour::GRID, 0.7);
    }
    for y in ticks(1) {
        segment([scene.lo[0], y, floor], [scene.hi[0], y, floor], Colour::GRID, 0.7);
        segment([far(0), y, floor], [far(0), y, top], Colour::GRID, 0.7);
    }
    for z in ticks(2) {
        segment([far(0), scene.lo[1], z], [far(0), scene.hi[1], z], Colour::GRID, 0.7);
        segment([scene.lo[0], far(1), z], [scene.hi[0], far(1), z], Colour::GRID, 0.7);
    }
    for (a, b) in [(0, 1), (1, 2), (2, 3), (3, 0)] {
        let (a, b) = (floor_corners[a], floor_corners[b]);
        segment([a[0], a[1], floor], [b[0], b[1], floor], Colour::FRAME, 0.9);
    }
    for corner in [[far(0), far(1)], [near(0), far(1)], [far(0), near(1)]] {
        segment([corner[0], corner[1], floor], [corner[0], corner[1], top], Colour::FRAME, 0.9);
    }
    // Labels stand off the front edges of the floor, away from its middle.
    let centre = view.point([view.middle[0], view.middle[1], floor]);
    let mut edge = |i: usize, name: &str| {
        let at = |v: f64| if i == 0 { view.point([v, near(1), floor]) } else { view.point([near(0), v, floor]) };
        let middle = at(view.middle[i]);
        let side = if middle.0 < centre.0 { -1.0 } else { 1.0 };
        let (a, b) = (at(scene.lo[i]), at(scene.hi[i]));
        let length = (b.0 - a.0).hypot(b.1 - a.1).max(1e-9);
        let steep = ((b.1 - a.1) / length).abs();
        let anchor = if steep < 0.2 {
            Anchor::Middle
        } else if side < 0.0 {
            Anchor::End
        } else {
            Anchor::Start
        };
        let mut last: Option<Point> = None;
        for v in ticks(i) {
            let p = at(v);
            let clear = last.is_none_or(|q| (p.0 - q.0).hypot(p.1 - q.1) > 14.0);
            if clear {
                let spot = (p.0 + side * 4.0 * steep.sqrt(), p.1 + 10.5 - 3.0 * steep);
                canvas.text(spot, &label(v), size::TICK, Colour::GREY, anchor, false);
                last = Some(p);
            }
        }
        let spot = (middle.0 + side * (10.0 + 26.0 * steep), middle.1 + 24.0 - 2.0 * steep);
        canvas.text(spot, name, size::LABEL, Colour::INK, anchor, false);
    };
    edge(0, "x [m]");
    edge(1, "y [m]");
    let sides = [[near(0), far(1)], [far(0), near(1)]];
    let left = |c: &[f64; 2]| view.point([c[0], c[1], floor]).0;
    let corner = if left(&sides[0]) < left(&sides[1]) { sides[0] } else { sides[1] };
    let mut lowest = f64::INFINITY;
    for z in ticks(2) {
        let p = view.point([corner[0], corner[1], z]);
        if lowest - p.1 > 11.0 {
            canvas.text((p.0 - 5.0, p.1 + 3.2), &label(z), size::TICK, Colour::GREY, Anchor::End, false);
            lowest = p.1;
        }
    }
    let p = view.point([corner[0], corner[1], 0.5 * (floor + top)]);
    let widest = ticks(2).iter().map(|z| font::width(&label(*z), size::TICK)).fold(0.0, f64::max);
    canvas.text((p.0 - widest - 13.0, p.1), "z [m]", size::LABEL, Colour::INK, Anchor::Middle, true);
}

/// Where the rotors of a small multirotor are, in arms: evenly about its axis, a pair to the front.
fn rotor_places(n_rotor: usize) -> Vec<[f64; 2]> {
    let angle = |i: usize| std::f64::consts::TAU * (i as f64 + 0.5) / n_rotor as f64;
    (0..n_rotor).map(|i| [angle(i).cos(), angle(i).sin()]).collect()
}

/// A small multirotor: an arm and a disc per rotor, an arrow along the thrust axis.
fn draw_pose(canvas: &mut Canvas, view: &View, pose: &Pose, arm: f64, n_rotor: usize) {
    let [w, x, y, z] = pose.attitude;
    let norm = (w * w + x * x + y * y + z * z).sqrt();
    if !(norm.is_finite() && norm > 1e-6 && pose.position.iter().all(|v| drawable(*v, false))) {
        return;
    }
    let q = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let origin = Vector3::from(pose.position);
    let at = |body: Vector3<f64>| {
        let p = origin + q * body;
        view.point([p.x, p.y, p.z])
    };
    let places = rotor_places(n_rotor);
    // discs of neighbours do not overlap
    let radius = arm * 0.48f64.min(2.4 / n_rotor.max(1) as f64);
    for place in &places {
        let tip = Vector3::new(place[0], place[1], 0.0) * arm;
        canvas.line(&[at(Vector3::zeros()), at(tip)], Colour::INK, 1.1);
        let rim = |k: usize| {
            let (s, c) = (k as f64 * std::f64::consts::TAU / 16.0).sin_cos();
            at(tip + Vector3::new(c, s, 0.0) * radius)
        };
        // The front discs are red, so that the heading can be read.
        let colour = if place[0] > 0.45 { Colour::VERMILLION } else { Colour::INK };
        let ring: Vec<Point> = (0..=16).map(rim).collect();
        canvas.line(&ring, colour, 0.9);
    }
    let (foot, head) = (at(Vector3::zeros()), at(Vector3::new(0.0, 0.0, 2.2 * arm)));
    canvas.line(&[foot, head], Colour::INK, 1.1);
    let (dx, dy) = (head.0 - foot.0, head.1 - foot.1);
    let length = dx.hypot(dy);
    if length > 3.0 {
        let (ux, uy) = (dx / length, dy / length);
        let wing = |s: f64| (head.0 - 3.6 * ux + s * 1.9 * uy, head.1 - 3.6 * uy - s * 1.9 * ux);
        canvas.polygon(vec![(head.0 + 1.2 * ux, head.1 + 1.2 * uy), wing(1.0), wing(-1.0)], Colour::INK);
    }
}

/// Label, least value, a strip of the colours, largest value, centred at `middle`.
fn draw_heat_bar(canvas: &mut Canvas, label: &str, (lo, hi): (f64, f64), middle: f64, y: f64) {
    const WIDTH: f64 = 130.0;
    let (lo_text, hi_text) = (short(lo), short(hi));
    let name = font::width(label, size::LEGEND);
    let total = name + 12.0 + font::width(&lo_text, size::TICK) + 5.0 + WIDTH + 5.0 + font::width(&hi_text, size::TICK);
    let mut x = middle - 0.5 * total;
    canvas.text((x, y), label, size::LEGEND, Colour::INK, Anchor::Start, false);
    x += name + 12.0;
    canvas.text((x, y), &lo_text, size::TICK, Colour::GREY, Anchor::Start, false);
    x += font::width(&lo_text, size::TICK) + 5.0;
    for i in 0..65 {
        let x0 = x + WIDTH * f64::from(i) / 65.0;
        // Slices overlap a little: their edges must not show as lines.
        let x1 = (x0 + WIDTH / 65.0 + 0.3).min(x + WIDTH);
        canvas.rectangle(Area { x0, y0: y - 8.0, x1, y1: y }, Colour::heat(f64::from(i) / 64.0), 1.0);
    }
    canvas.text((x + WIDTH + 5.0, y), &hi_text, size::TICK, Colour::GREY, Anchor::Start, false);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vehicle_is_drawn_with_as_many_rotors_as_it_has_a_pair_of_them_in_front() {
        for n in [4, 6, 8] {
            let places = rotor_places(n);
            assert_eq!((places.len(), places.iter().filter(|p| p[0] > 0.45).count()), (n, 2), "{n}");
        }
        let drawn = |n: usize| {
            let poses = vec![Pose { position: [0.0; 3], attitude: [1.0, 0.0, 0.0, 0.0] }];
            let chart = Path3d::new("", vec![[0.0; 3], [1.0, 1.0, 1.0]]).poses(poses).rotors(n);
            crate::Figure::new("").chart(chart).svg().unwrap().matches("<polyline").count()
        };
        assert_eq!(drawn(6) - drawn(4), 4, "an arm and a disc per rotor");
    }

    #[test]
    fn obstacles_near_the_path_are_in_the_picture_and_far_ones_are_not() {
        let bar = |x: f64, y: f64| Item::Bar { from: [x, y, 0.0], to: [x, y, 4.0], radius: 0.1, colour: Colour::GREY };
        let path: Vec<[f64; 3]> = (0..50).map(|i| [0.02 * f64::from(i), 0.0, 1.0]).collect();
        let wall = Item::Box {
            at: [0.0; 3],
            half: [[400.0, 0.0, 0.0], [0.0, 400.0, 0.0], [0.0, 0.0, 0.1]],
            colour: Colour::GREY,
        };
        let all = vec![bar(1.5, 1.0), bar(-0.5, -1.0), bar(30.0, 0.0), wall];
        let chart = Path3d::new("", path.clone()).obstacles(all.clone());
        let (scene, drawn) = chart.scene();
        assert_eq!(drawn, all[..2], "two trunks stand about, one is far, and a floor of 800 m would make it a speck");
        for item in &drawn {
            assert!(
                item.extent().iter().all(|p| (0..3).all(|i| scene.lo[i] <= p[i] && p[i] <= scene.hi[i])),
                "{item:?}"
            );
        }
        let polygons = |chart: Path3d| crate::Figure::new("").chart(chart).svg().unwrap().matches("<polygon").count();
        assert!(polygons(chart) > polygons(Path3d::new("", path)) + 4);
    }

    #[test]
    fn a_hover_is_drawn_in_a_room_of_its_size_not_of_its_rounding() {
        for size in [0.0, 1e-14, 1e-9, 1e-5] {
            let path: Vec<[f64; 3]> = (0..50).map(|i| [size * f64::from(i % 2), 0.0, 1.0]).collect();
            let heat = vec![size; path.len()];
            let chart = Path3d::new("", path).heat("speed [m/s]", heat);
            assert!(chart.scene().0.longest() > 0.1, "{size}: {}", chart.scene().0.longest());
            let (lo, hi) = chart.heat_range().unwrap();
            assert!(hi - lo >= LEAST_HEAT, "{size}");
        }
        let path: Vec<[f64; 3]> = (0..50).map(|i| [0.004 * f64::from(i), 0.0, 1.0]).collect();
        assert!(Path3d::new("", path).scene().0.longest() < 0.5, "what moves is drawn in its own");
    }
}
