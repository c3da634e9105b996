//! One ray after the other, against one solid after the other, in `f64` and by other equations: what lanes are compared with.

use super::ray_scene::{self, GROUND, LANES, NOTHING, RayScene};
use crate::shape::Pose;
use crate::spatial::{Vec3, axpy, dot, rotate, sub, unit};

/// The nearest entry of a ray o + t d, t > 0: (t, id); (∞, [`NOTHING`]) for none. `d` may have any length.
pub(super) fn nearest(world: &RayScene, o: Vec3<f64>, d: Vec3<f64>) -> (f64, u32) {
    let mut best = (f64::INFINITY, NOTHING);
    let mut try_one = |t: Option<f64>, id: u32| {
        if let Some(t) = t.filter(|t| *t > 0.0 && *t < best.0) {
            best = (t, id);
        }
    };
    if let Some(height) = world.ground.map(f64::from) {
        try_one((o[2] > height).then(|| (height - o[2]) / d[2]), GROUND);
    }
    for i in 0..world.capsules.len() {
        let (base, axis, length, radius) = capsule(world, i);
        try_one(into_capsule(o, d, base, axis, length, radius), ray_scene::capsule_id(i));
    }
    for i in 0..world.boxes.len() {
        let (center, axes, half) = cuboid(world, i);
        try_one(into_box(o, d, center, axes, half), ray_scene::box_id(i));
    }
    best
}

/// The ray of a sensor at `pose` along `direction` of its frame.
pub(super) fn from_pose(world: &RayScene, pose: &Pose<f64>, direction: Vec3<f64>) -> (f64, u32) {
    nearest(world, pose.position, rotate(unit(pose.attitude), direction))
}

fn capsule(world: &RayScene, i: usize) -> (Vec3<f64>, Vec3<f64>, f64, f64) {
    let (block, lane) = (&world.capsules.blocks[i / LANES], i % LANES);
    let vector = |rows: &[[f32; LANES]; 3]| [0, 1, 2].map(|k| f64::from(rows[k][lane]));
    // the axis to full length: in f32 its length is off by 1e-8
    let axis = vector(&block.axis);
    let norm = dot(axis, axis).sqrt();
    (vector(&block.base), axis.map(|x| x / norm), f64::from(block.length[lane]), f64::from(block.radius[lane]))
}

fn cuboid(world: &RayScene, i: usize) -> (Vec3<f64>, [Vec3<f64>; 3], Vec3<f64>) {
    let (block, lane) = (&world.boxes.blocks[i / LANES], i % LANES);
    let vector = |rows: &[[f32; LANES]; 3]| [0, 1, 2].map(|k| f64::from(rows[k][lane]));
    (vector(&block.center), [0, 1, 2].map(|k| vector(&block.axes[k])), vector(&block.half))
}

/// The side where it is entered between the ends, or one of these as balls.
fn into_capsule(o: Vec3<f64>, d: Vec3<f64>, base: Vec3<f64>, axis: Vec3<f64>, length: f64, radius: f64) -> Option<f64> {
    let w = sub(o, base);
    let s = dot(w, axis).clamp(0.0, length);
    let v = axpy(w, -s, axis);
    if dot(v, v) <= radius * radius {
        return None;
    }
    let (across_d, across_w) = (axpy(d, -dot(d, axis), axis), axpy(w, -dot(w, axis), axis));
    let side = root(across_w, across_d, radius).filter(|t| {
        let height = dot(w, axis) + t * dot(d, axis);
        (0.0..=length).contains(&height)
    });
    let ends = [root(w, d, radius), root(axpy(w, -length, axis), d, radius)];
    [side, ends[0], ends[1]].into_iter().flatten().filter(|t| *t > 0.0).min_by(f64::total_cmp)
}

/// Back from where the line passes the centre by half a chord, √(r² − passing²).
fn root(w: Vec3<f64>, d: Vec3<f64>, radius: f64) -> Option<f64> {
    let squared = dot(d, d);
    let passing = -dot(d, w) / squared;
    let across = axpy(w, passing, d);
    let chord = radius * radius - dot(across, across);
    (chord > 0.0 && squared > 0.0).then(|| passing - (chord / squared).sqrt())
}

/// Face by face: the point where the ray meets its plane lies within the others.
fn into_box(o: Vec3<f64>, d: Vec3<f64>, center: Vec3<f64>, axes: [Vec3<f64>; 3], half: Vec3<f64>) -> Option<f64> {
    let w = sub(o, center);
    let (p, v) = ([0, 1, 2].map(|k| dot(w, axes[k])), [0, 1, 2].map(|k| dot(d, axes[k])));
    let mut best = None;
    for k in 0..3 {
        if p[k].abs() <= half[k] || p[k] * v[k] >= 0.0 {
            continue;
        }
        let t = (half[k] * p[k].signum() - p[k]) / v[k];
        let inside = (0..3).all(|i| i == k || (p[i] + t * v[i]).abs() <= half[i]);
        if inside {
            best = Some(t);
        }
    }
    best
}

/// The least distance of a point to any surface, from outside or inside, m; of boxes inside, that to the nearest face.
pub(super) fn gap(world: &RayScene, p: Vec3<f64>) -> f64 {
    let mut least = world.ground.map_or(f64::INFINITY, |height| (p[2] - f64::from(height)).abs());
    for i in 0..world.capsules.len() {
        let (base, axis, length, radius) = capsule(world, i);
        let w = sub(p, base);
        let v = axpy(w, -dot(w, axis).clamp(0.0, length), axis);
        least = least.min((dot(v, v).sqrt() - radius).abs());
    }
    for i in 0..world.boxes.len() {
        let (center, axes, half) = cuboid(world, i);
        let w = sub(p, center);
        let out = [0, 1, 2].map(|k| dot(w, axes[k]).abs() - half[k]);
        let outside = out.iter().map(|x| x.max(0.0).powi(2)).sum::<f64>().sqrt();
        least = least.min(if outside > 0.0 { outside } else { out.iter().fold(f64::INFINITY, |a, x| a.min(-x)) });
    }
    least
}
