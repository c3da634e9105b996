//! What counts of what flies, for ground, terrain and obstacles alike: its shapes, and its rotors as discs.
//!
//! A rotor without a radius counts as its hub; where a model has neither shapes nor rotors, the origins of its bodies count.

use dynamics::contact::{self, distance};
use dynamics::shape::{Geometry, Pose};
use dynamics::spatial::{add, cross, dot, from_matrix, mat_vec, matrix, multiply, scale, transpose};
use dynamics::tree::{self, Multibody, body_poses};
use dynamics::uneven_ground::UnevenGround;
use std::f64::consts::FRAC_PI_4;

const UP: [f64; 3] = [0.0, 0.0, 1.0];
/// Where the search across a disc ends, as a share of its radius.
const FINE: f64 = 1e-3;

/// Something of a body, in the world.
enum CollisionPart {
    Solid { geometry: Geometry, pose: Pose<f64> },
    Disc { center: [f64; 3], axis: [f64; 3], radius: f64 },
}

/// All that counts of what moves.
fn extents(bodies: &Multibody, state: &[f64]) -> Vec<CollisionPart> {
    let (model, poses) = (bodies.model(), body_poses(bodies, state));
    let shapes = model.shapes().iter().filter_map(|s| {
        let carrier = &poses[s.body?];
        let attitude = multiply(from_matrix(carrier.rotation), s.shape.rotation);
        let pose = Pose { position: on(carrier, s.shape.position), attitude };
        Some(CollisionPart::Solid { geometry: s.shape.geometry, pose })
    });
    let rotors = model.rotors().iter().map(|r| {
        let (pose, rotor) = (&poses[r.body], &r.rotor);
        let axis = mat_vec(pose.rotation, rotor.axis);
        CollisionPart::Disc { center: on(pose, rotor.position), axis, radius: rotor.radius }
    });
    let all: Vec<CollisionPart> = shapes.chain(rotors).collect();
    if !all.is_empty() {
        return all;
    }
    poses.iter().map(|pose| CollisionPart::Disc { center: pose.position, axis: UP, radius: 0.0 }).collect()
}

/// Height of the lowest point of shapes and rotors, m; of the lowest body's origin where there are none.
pub fn lowest_point(bodies: &Multibody, state: &[f64]) -> f64 {
    let lowest = |extent: &CollisionPart| match extent {
        CollisionPart::Solid { geometry, pose } => pose.position[2] - below(geometry, transpose(matrix(pose.attitude))),
        CollisionPart::Disc { center, axis, radius } => center[2] - radius * across(*axis, UP),
    };
    extents(bodies, state).iter().map(lowest).fold(f64::INFINITY, f64::min)
}

/// Least distance of the same to hills over z = `height`, m: exact on slopes and of first order on waves.
pub(super) fn over(bodies: &Multibody, state: &[f64], height: f64, relief: &UnevenGround) -> f64 {
    let own = |extent: &CollisionPart| match extent {
        CollisionPart::Solid { geometry, pose } => contact::ground_distance(geometry, pose, height, relief),
        CollisionPart::Disc { center, axis, radius } => {
            let (distance, normal) = relief.surface(*center, height);
            distance - radius * across(*axis, normal)
        }
    };
    extents(bodies, state).iter().map(own).fold(f64::INFINITY, f64::min)
}

/// What stands still (by its number in [`Model::shapes`](tree::Model::shapes)) and is nearer to shapes or rotors than `least` m,
/// and how near: negative inside.
pub fn nearest_still(bodies: &Multibody, state: &[f64], least: f64) -> Option<(usize, f64)> {
    let own = extents(bodies, state);
    let (mut least, mut nearest) = (least, None);
    for (k, still) in bodies.model().shapes().iter().enumerate().filter(|(_, s)| s.body.is_none() && s.collides) {
        let (geometry, shape) = (&still.shape.geometry, &still.shape);
        let pose = Pose { position: shape.position, attitude: shape.rotation };
        for extent in &own {
            let distance = match extent {
                CollisionPart::Solid { geometry: moving, pose: at } => contact::distance(moving, at, geometry, &pose),
                // no point of a disc is farther from its hub than its radius
                CollisionPart::Disc { center, radius, .. }
                    if distance::point(*center, geometry, &pose) - radius >= least =>
                {
                    continue;
                }
                CollisionPart::Disc { center, axis, radius } => {
                    to_disc(*center, *axis, *radius, &|point| distance::point(point, geometry, &pose))
                }
            };
            if distance < least {
                (least, nearest) = (distance, Some((k, distance)));
            }
        }
    }
    nearest
}

/// Least of a distance over a disc. That to a convex body is convex, and smooth outside: steps in eight directions find it.
fn to_disc(center: [f64; 3], axis: [f64; 3], radius: f64, distance: &impl Fn([f64; 3]) -> f64) -> f64 {
    let mut best = distance(center);
    if radius <= 0.0 {
        return best;
    }
    let least = (0..3).min_by(|a, b| axis[*a].abs().total_cmp(&axis[*b].abs())).unwrap_or(0);
    let mut beside = [0.0; 3];
    beside[least] = 1.0;
    let u = cross(axis, beside);
    let u = scale(1.0 / dot(u, u).sqrt(), u);
    let v = cross(axis, u);
    let at = |a: f64, b: f64| distance(add(center, add(scale(radius * a, u), scale(radius * b, v))));
    let (mut place, mut step) = ([0.0_f64; 2], 1.0);
    while step > FINE {
        let from = place;
        for k in 0..8 {
            let (s, c) = (f64::from(k) * FRAC_PI_4).sin_cos();
            let (a, b) = (from[0] + step * c, from[1] + step * s);
            let within = a.hypot(b).max(1.0);
            let d = at(a / within, b / within);
            if d < best {
                (best, place) = (d, [a / within, b / within]);
            }
        }
        if place == from {
            step *= 0.5;
        }
    }
    best
}

/// Sine of the angle between two directions.
fn across(axis: [f64; 3], normal: [f64; 3]) -> f64 {
    let flat = cross(axis, normal);
    dot(flat, flat).sqrt()
}

/// How far a geometry with axes `turn` reaches below its centre, m.
fn below(geometry: &Geometry, turn: [[f64; 3]; 3]) -> f64 {
    match *geometry {
        Geometry::Sphere { radius } => radius,
        Geometry::Capsule { radius, length } => radius + 0.5 * length * turn[2][2].abs(),
        Geometry::Box { size } => (0..3).map(|k| 0.5 * size[k] * turn[k][2].abs()).sum(),
    }
}

fn on(pose: &tree::FrameKinematics<f64>, point: [f64; 3]) -> [f64; 3] {
    add(pose.position, mat_vec(pose.rotation, point))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynamics::spatial::from_euler;

    #[test]
    fn the_distance_of_a_disc_is_that_of_its_nearest_point() {
        let shapes = [
            Geometry::Sphere { radius: 0.05 },
            Geometry::Capsule { radius: 0.01, length: 1.0 },
            Geometry::Box { size: [0.2, 0.02, 0.6] },
        ];
        let mut inside = 0;
        for k in 0..120 {
            let t = f64::from(k);
            let geometry = &shapes[k as usize % 3];
            let pose = Pose { position: [0.3, -0.2, 1.0], attitude: from_euler(0.7 * t, 0.3 * t, 1.1 * t) };
            let away = 0.05 + 0.4 * (0.5 + 0.5 * (2.3 * t).sin());
            let (s, c) = (1.7 * t).sin_cos();
            let center = add(pose.position, [away * c, away * s, 0.3 * (0.9 * t).sin()]);
            let axis = matrix(from_euler(0.4 * t, 0.9 * t, 0.0)).map(|row| row[2]);
            let radius = [0.0, 0.08, 0.3][k as usize / 3 % 3];
            let point = |p| distance::point(p, geometry, &pose);
            let found = to_disc(center, axis, radius, &point);
            // by brute force
            let u = cross(axis, if axis[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] });
            let u = scale(1.0 / dot(u, u).sqrt(), u);
            let v = cross(axis, u);
            let mut truth = f64::INFINITY;
            for i in 0..=60 {
                for j in 0..180 {
                    let r = radius * f64::from(i) / 60.0;
                    let (s, c) = (f64::from(j) * std::f64::consts::TAU / 180.0).sin_cos();
                    truth = truth.min(point(add(center, add(scale(r * c, u), scale(r * s, v)))));
                }
            }
            // inside the corners of its level curves may hold a search up; what touches is told
            let fine = if truth > 0.003 { (found - truth).abs() < 0.003 } else { found < 0.003 };
            assert!(fine, "{k}: {found} for {truth}, {geometry:?}, radius {radius}");
            inside += i32::from(truth < 0.0);
        }
        assert!(inside > 10, "{inside} of 120 touch");
    }
}
