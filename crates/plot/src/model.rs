//! An articulated system as a drawing: its shapes, rotors and joints in a given state.

use super::drawing::{Drawing, Item, Label};
use super::{Colour, Figure};
use omnidrones::controllers::flight_check::lowest_point;
use omnidrones::dynamics::Rotor;
use omnidrones::dynamics::shape::{Geometry, Shape};
use omnidrones::dynamics::spatial::{add, dot, from_matrix, mat_vec, matrix, multiply, scale, sub, transpose};
use omnidrones::dynamics::tree::{FrameKinematics, Model, Motion, Multibody, body_poses};

/// Surfaces of bodies that carry rotors, and of the others.
const DRONE: Colour = Colour(206, 213, 220);
const LOAD: Colour = Colour(236, 217, 180);
/// Of what stands in the world.
const WORLD: Colour = Colour(222, 226, 230);
/// Drawn radius of a rotor that does not tell its own, m.
pub const ROTOR_RADIUS: f64 = 0.08;

/// A page with the system in a state: one large view with names, and from above and from the side without.
pub fn figure(system: &Multibody, state: &[f64]) -> Figure {
    let model = system.model();
    let items = items(system, state);
    let floor = lowest_point(system, state);
    let main = Drawing::new("", items.clone()).labels(labels(system, state)).floor(floor).legend();
    let above = Drawing::new("from above", items.clone()).seen_from(-90.0, 90.0);
    let side = side_view(items);
    Figure::new(model.name())
        .size(1000.0, 560.0)
        .grid(&[2.1, 1.0], &[1.0, 1.0])
        .place((0, 0), (1, 2), main)
        .place((1, 0), (1, 1), above)
        .place((1, 1), (1, 1), side)
}

/// Along y, or along x where the system is wider that way.
fn side_view(items: Vec<Item>) -> Drawing {
    let points: Vec<[f64; 3]> = items.iter().flat_map(Item::extent).collect();
    let width = |i: usize| {
        let values = points.iter().map(|p| p[i]);
        values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min)
    };
    if width(1) > 1.2 * width(0) {
        Drawing::new("from the front", items).seen_from(0.0, 0.0)
    } else {
        Drawing::new("from the side", items).seen_from(-90.0, 0.0)
    }
}

/// What stands in the world.
pub fn obstacles(system: &Multibody) -> Vec<Item> {
    let still = system.model().shapes().iter().filter(|shape| shape.body.is_none());
    still.map(|shape| solid(&shape.shape.geometry, shape.shape.position, shape.shape.rotation, WORLD)).collect()
}

/// A shape at a place, turned.
fn solid(geometry: &Geometry, at: [f64; 3], turn: [f64; 4], colour: Colour) -> Item {
    let r = transpose(matrix(turn));
    match *geometry {
        Geometry::Sphere { radius } => Item::Ball { at, radius, colour },
        Geometry::Capsule { radius, length } => {
            let half = scale(0.5 * length, r[2]);
            Item::Bar { from: sub(at, half), to: add(at, half), radius, colour }
        }
        Geometry::Box { size } => Item::Box { at, half: [0, 1, 2].map(|k| scale(0.5 * size[k], r[k])), colour },
    }
}

/// The edges of a box, the rims of what is round: of a shape that would hide the rotors within it.
fn outline(item: &Item) -> Vec<[[f64; 3]; 2]> {
    let point =
        |at: [f64; 3], half: &[[f64; 3]; 3], s: [f64; 3]| (0..3).fold(at, |at, i| add(at, scale(s[i], half[i])));
    match *item {
        Item::Box { at, half, .. } => {
            let corner = |k: usize| point(at, &half, [0, 1, 2].map(|i| if k >> i & 1 == 0 { -1.0 } else { 1.0 }));
            let edges = (0..3).flat_map(|i| (0..8usize).filter(move |k| k >> i & 1 == 0).map(move |k| (k, k | 1 << i)));
            edges.map(|(a, b)| [corner(a), corner(b)]).collect()
        }
        Item::Ball { at, radius, .. } => [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
            .into_iter()
            .flat_map(|n| rotor_ring(at, n, radius))
            .collect(),
        Item::Bar { from, to, radius, .. } => {
            let way = sub(to, from);
            let axis = scale(1.0 / dot(way, way).sqrt().max(1e-9), way);
            let (first, last) = (rotor_ring(from, axis, radius), rotor_ring(to, axis, radius));
            let sides: Vec<[[f64; 3]; 2]> = first.iter().zip(&last).step_by(4).map(|(a, b)| [a[0], b[0]]).collect();
            [first, last, sides].concat()
        }
        _ => Vec::new(),
    }
}

/// Everything that can be seen of the system in a state.
pub fn items(system: &Multibody, state: &[f64]) -> Vec<Item> {
    let (model, poses) = (system.model(), body_poses(system, state));
    let mut items = Vec::new();
    for shape in model.shapes() {
        let colour = match shape.body {
            None => WORLD,
            Some(b) if carries_rotors(model, b) => DRONE,
            Some(_) => LOAD,
        };
        let (at, turn) = match shape.body {
            Some(b) => {
                (on(&poses[b], shape.shape.position), multiply(from_matrix(poses[b].rotation), shape.shape.rotation))
            }
            None => (shape.shape.position, shape.shape.rotation),
        };
        let item = solid(&shape.shape.geometry, at, turn, colour);
        if shape.body.is_some_and(|b| hides_a_rotor(model, b, &shape.shape)) {
            items.extend(outline(&item).into_iter().map(|[from, to]| Item::Stick { from, to, colour: Colour::FRAME }));
        } else {
            items.push(item);
        }
    }
    for [from, to] in skeleton(model, &poses) {
        items.push(Item::Stick { from, to, colour: Colour::GREY });
    }
    for (number, rotor) in model.rotors().iter().enumerate() {
        let pose = &poses[rotor.body];
        let radius = drawn_radius(&rotor.rotor);
        let axis = mat_vec(pose.rotation, rotor.rotor.axis);
        let hub = on(pose, rotor.rotor.position);
        let above = dot(rotor.rotor.position, rotor.rotor.axis) > 0.0;
        items.push(Item::Rotor { hub, axis, radius, spin: rotor.rotor.spin, number, above });
    }
    for (i, body) in model.bodies().iter().enumerate() {
        let (pose, at) = (&poses[i], poses[i].position);
        match body.joint.motion {
            Motion::Floating => {}
            Motion::Revolute(axis) => items.push(Item::Hinge { at, axis: mat_vec(pose.rotation, axis) }),
            Motion::Prismatic(axis) => items.push(Item::Slide { at, axis: mat_vec(pose.rotation, axis) }),
            Motion::Ball => items.push(Item::Pivot { at }),
        }
    }
    items
}

/// The rim of a rotor's disc as lines: `hub` m, `axis` a unit vector, `radius` m.
pub fn rotor_ring(hub: [f64; 3], axis: [f64; 3], radius: f64) -> Vec<[[f64; 3]; 2]> {
    const SIDES: usize = 14;
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let least = if axis[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let u = cross(axis, least);
    let norm = dot(u, u).sqrt().max(1e-9);
    let u = u.map(|x| x / norm);
    let v = cross(axis, u);
    let rim = |k: usize| {
        let (s, c) = (std::f64::consts::TAU * k as f64 / SIDES as f64).sin_cos();
        [0, 1, 2].map(|i| hub[i] + radius * (c * u[i] + s * v[i]))
    };
    (0..SIDES).map(|k| [rim(k), rim(k + 1)]).collect()
}

/// Lines for what no shape shows: from a body to its rotors and to the joints of its children.
pub fn sticks(system: &Multibody, state: &[f64]) -> Vec<[[f64; 3]; 2]> {
    let (model, poses) = (system.model(), body_poses(system, state));
    let mut lines = skeleton(model, &poses);
    for shape in model.shapes() {
        if let (Some(b), Geometry::Capsule { length, .. }) = (shape.body, shape.shape.geometry) {
            let z = mat_vec(matrix(shape.shape.rotation), [0.0, 0.0, 0.5 * length]);
            let ends = [sub(shape.shape.position, z), add(shape.shape.position, z)];
            lines.push(ends.map(|p| on(&poses[b], p)));
        }
        if let (Some(b), Geometry::Box { size }) = (shape.body, shape.shape.geometry)
            && !carries_rotors(model, b)
        {
            let corner = |k: usize| [0, 1, 2].map(|i| if k >> i & 1 == 0 { -0.5 * size[i] } else { 0.5 * size[i] });
            let at =
                |k: usize| on(&poses[b], add(shape.shape.position, mat_vec(matrix(shape.shape.rotation), corner(k))));
            let edges = (0..3).flat_map(|i| (0..8usize).filter(move |k| k >> i & 1 == 0).map(move |k| (k, k | 1 << i)));
            lines.extend(edges.map(|(a, b)| [at(a), at(b)]));
        }
    }
    lines
}

fn skeleton(model: &Model, poses: &[FrameKinematics<f64>]) -> Vec<[[f64; 3]; 2]> {
    struts(model).into_iter().map(|(body, ends)| ends.map(|p| on(&poses[body], p))).collect()
}

/// Lines for what no shape shows, each with its body, in the frame of that body, m: to its rotors and to the joints of its
/// children.
pub fn struts(model: &Model) -> Vec<(usize, [[f64; 3]; 2])> {
    let mut lines = Vec::new();
    let mut reach = |body: usize, point: [f64; 3]| {
        let (start, covered) = nearest(model, body, point);
        if !covered {
            lines.push((body, [start, point]));
        }
    };
    for rotor in model.rotors() {
        reach(rotor.body, rotor.rotor.position);
    }
    for body in model.bodies() {
        if let Some(parent) = body.parent.filter(|p| model.bodies()[*p].mass > 0.0) {
            reach(parent, body.joint.position);
        }
    }
    lines
}

/// The point of a body's shapes (else of its frame) from which a line to `point` starts, and whether a shape holds the
/// point already; body frame.
fn nearest(model: &Model, body: usize, point: [f64; 3]) -> ([f64; 3], bool) {
    let own = model.shapes().iter().filter(|s| s.body == Some(body)).map(|s| &s.shape);
    let own = own.filter(|shape| !hides_a_rotor(model, body, shape));
    let foot = own.map(|shape| {
        let r = matrix(shape.rotation);
        let local = mat_vec(transpose(r), sub(point, shape.position));
        // on the axis of a capsule, else the centre; how far the surface is from there
        let (start, thickness) = match shape.geometry {
            Geometry::Sphere { radius } => ([0.0; 3], radius),
            Geometry::Capsule { radius, length } => ([0.0, 0.0, local[2].clamp(-0.5 * length, 0.5 * length)], radius),
            Geometry::Box { size } => {
                let inside = (0..3).all(|k| local[k].abs() <= 0.5 * size[k]);
                ([0.0, 0.0, local[2].clamp(-0.5 * size[2], 0.5 * size[2])], if inside { f64::INFINITY } else { 0.0 })
            }
        };
        let gap = sub(local, start);
        let distance = dot(gap, gap).sqrt();
        (add(shape.position, mat_vec(r, start)), distance <= thickness + 0.011, distance)
    });
    let best = foot.min_by(|a, b| a.2.total_cmp(&b.2));
    best.map_or(([0.0; 3], dot(point, point) < 1e-6), |(start, covered, _)| (start, covered))
}

/// Whether the shape hides a rotor of its body: what collides, mostly, which is larger than what flies.
fn hides_a_rotor(model: &Model, body: usize, shape: &Shape) -> bool {
    // how deep a point is below the surface
    let depth = |point: [f64; 3]| {
        let local = mat_vec(transpose(matrix(shape.rotation)), sub(point, shape.position));
        match shape.geometry {
            Geometry::Sphere { radius } => radius - dot(local, local).sqrt(),
            Geometry::Capsule { radius, length } => {
                let gap = sub(local, [0.0, 0.0, local[2].clamp(-0.5 * length, 0.5 * length)]);
                radius - dot(gap, gap).sqrt()
            }
            Geometry::Box { size } => (0..3).map(|k| 0.5 * size[k] - local[k].abs()).fold(f64::INFINITY, f64::min),
        }
    };
    let hidden = |rotor: &Rotor| depth(rotor.position) > 0.4 * drawn_radius(rotor);
    model.rotors().iter().any(|r| r.body == body && hidden(&r.rotor))
}

/// m.
fn drawn_radius(rotor: &Rotor) -> f64 {
    if rotor.radius > 0.0 { rotor.radius } else { ROTOR_RADIUS }
}

/// Names of bodies, and of joints where they are few.
fn labels(system: &Multibody, state: &[f64]) -> Vec<Label> {
    let (model, poses) = (system.model(), body_poses(system, state));
    let mut labels = Vec::new();
    for (i, body) in model.bodies().iter().enumerate().filter(|(_, b)| b.mass > 0.0) {
        let at = on(&poses[i], visible_middle(model, i));
        labels.push(Label { at, text: body.name.clone(), colour: Colour::INK });
    }
    let mut joints: Vec<Label> = Vec::new();
    for (i, body) in model.bodies().iter().enumerate().filter(|(_, b)| b.joint.motion != Motion::Floating) {
        let text = body.joint.name.split('.').next().unwrap_or_default().to_string();
        // the two hinges of a universal joint share a name
        if joints.iter().all(|l| l.text != text) {
            joints.push(Label { at: poses[i].position, text, colour: JOINT_NAME });
        }
    }
    if labels.len() + joints.len() <= 22 {
        labels.extend(joints);
    }
    labels
}

const JOINT_NAME: Colour = Colour(163, 72, 121);

/// Where a name belongs: the first shape's centre, else the centre of mass.
fn visible_middle(model: &Model, body: usize) -> [f64; 3] {
    let own = model.shapes().iter().find(|s| s.body == Some(body));
    own.map_or(model.bodies()[body].center_of_mass, |s| s.shape.position)
}

fn on(pose: &FrameKinematics<f64>, point: [f64; 3]) -> [f64; 3] {
    add(pose.position, mat_vec(pose.rotation, point))
}

fn carries_rotors(model: &Model, body: usize) -> bool {
    model.rotors().iter().any(|r| r.body == body)
}

#[cfg(test)]
mod tests {
    use super::*;
    use omnidrones::dynamics::configurations::environment::vehicle_in;
    use omnidrones::dynamics::scene::Scene;
    use omnidrones::dynamics::{Effects, Physics, vehicles};

    /// A vehicle of one shape, at rest.
    fn drawn(name: &str, geometry: Geometry) -> Vec<Item> {
        let mut vehicle = vehicles::by_name(name).unwrap();
        vehicle.shapes = vec![Shape { geometry, position: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0] }];
        let model = vehicle_in(&vehicle, &Scene::grounded()).unwrap();
        let system = Multibody::new(&model, Physics { effects: Effects::none(), ..Physics::default() }).unwrap();
        items(&system, &system.rest_state())
    }

    #[test]
    fn what_collides_is_an_outline_where_it_would_hide_rotors_and_a_body_where_not() {
        let solid =
            |items: &[Item]| items.iter().any(|i| matches!(i, Item::Box { .. } | Item::Ball { .. } | Item::Bar { .. }));
        for name in ["hummingbird", "firefly"] {
            let rotors = vehicles::by_name(name).unwrap().rotors.len();
            for (large, small) in [
                (Geometry::Box { size: [1.0, 1.0, 0.4] }, Geometry::Box { size: [0.1, 0.1, 0.05] }),
                (Geometry::Sphere { radius: 0.6 }, Geometry::Sphere { radius: 0.05 }),
                (Geometry::Capsule { radius: 0.5, length: 0.1 }, Geometry::Capsule { radius: 0.05, length: 0.02 }),
            ] {
                let (large, small) = (drawn(name, large), drawn(name, small));
                assert!(!solid(&large) && solid(&small), "{name}");
                // arms are drawn to all rotors either way
                let sticks = |items: &[Item]| items.iter().filter(|i| matches!(i, Item::Stick { .. })).count();
                assert!(sticks(&large) > rotors && sticks(&small) == rotors, "{name}: {}", sticks(&small));
            }
        }
    }
}
