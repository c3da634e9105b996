//! Normals of hits, and how a range changes with the pose of the sensor.
//!
//! A ray o + t d that ends on a surface with outward normal n keeps to it while the sensor moves: with the sensor at r in a
//! body at p, R and body turns δθ (R exp(δθ^)),
//!
//! ```text
//! ∂t/∂p = −n/(n·d)                       world
//! ∂t/∂θ = −((r + t d_b) × n_b)/(n·d)     d_b, n_b: along body axes
//! ```
//!
//! Both need t and the id of the hit, and nothing of the search for it. A ray that grazes a surface has a range without bounds
//! on its slope: |n·d| is held at [`GRAZING`] of ‖d‖ or above. Misses have slope 0. At silhouettes the range jumps, which no slope
//! tells: the gradient of an image in the pose is biased by what its edges sweep.

use super::ray_scene::{LANES, RayScene, Solid, solid};
use crate::shape::Pose;
use crate::spatial::{Vec3, axpy, cross, dot, rotate, rotate_back, scale, sub};

/// Least |n·d| of a unit direction that slopes are divided by: rays within 5.7° of the surface.
pub const GRAZING: f64 = 0.1;

/// How a range t changes with the pose of the body that carries the sensor.
///
/// With the sensor at r in a body at p, R, the ray's direction d and the outward normal n of the surface it meets,
/// ∂t/∂p = −n/(n·d) and ∂t/∂θ = −((r + t d_b) × n_b)/(n·d), where R turns by exp(δθ^) and d_b, n_b are along body axes. |n·d| is held
/// at 0.1 ‖d‖ or above; misses have slope 0. Jumps at silhouettes are not seen.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RangeJacobian {
    /// ∂t/∂p: m per metre of the body's origin, world.
    pub position: [f64; 3],
    /// ∂t/∂θ: m per radian of the body's turn about its own axes.
    pub attitude: [f64; 3],
}

impl RayScene {
    /// Outward unit normal (world) of the solid `id` at `point` (world, m) on its surface; `None` for a miss and for ids that
    /// this world has not.
    pub fn normal(&self, id: u32, point: Vec3<f64>) -> Option<Vec3<f64>> {
        match solid(id) {
            Solid::Nothing => None,
            Solid::Ground => self.ground.map(|height| self.relief.surface(point, f64::from(height)).1),
            Solid::Triangle(id) => self.triangle(id).map(|(i, k)| self.meshes[i].mesh.normal(k)),
            Solid::Capsule(i) if i < self.capsules.len() => Some(self.capsule_normal(i, point)),
            Solid::Box(i) if i < self.boxes.len() => Some(self.box_normal(i, point)),
            _ => None,
        }
    }

    /// Away from the nearest point of the axis.
    fn capsule_normal(&self, i: usize, point: Vec3<f64>) -> Vec3<f64> {
        let (block, lane) = (&self.capsules.blocks[i / LANES], i % LANES);
        let axis = vector(&block.axis, lane);
        // f32 keeps its length to 10⁻⁷, which a thin capsule's end would show
        let axis = scale(1.0 / dot(axis, axis).sqrt(), axis);
        let w = sub(point, vector(&block.base, lane));
        let along = dot(w, axis).clamp(0.0, f64::from(block.length[lane]).max(0.0));
        let away = axpy(w, -along, axis);
        let length = dot(away, away).sqrt();
        // on the axis itself any direction is as good
        if length > 1e-12 { scale(1.0 / length, away) } else { [0.0, 0.0, 1.0] }
    }

    /// That of the face from which the point is farthest out.
    fn box_normal(&self, i: usize, point: Vec3<f64>) -> Vec3<f64> {
        let (block, lane) = (&self.boxes.blocks[i / LANES], i % LANES);
        let w = sub(point, vector(&block.center, lane));
        let (mut out, mut normal) = (f64::NEG_INFINITY, [0.0, 0.0, 1.0]);
        for k in 0..3 {
            let axis = vector(&block.axes[k], lane);
            let place = dot(w, axis);
            let beyond = place.abs() - f64::from(block.half[k][lane]);
            if beyond > out {
                (out, normal) = (beyond, scale(place.signum(), axis));
            }
        }
        normal
    }

    /// Slope of the number `t` of the ray along `direction` (sensor's frame) of a sensor at `mount` in a body at `body`, which
    /// hit the solid `id`. t counts in lengths of `direction`: planar depth where that is a camera's, distance where it is a unit
    /// vector.
    pub fn slope(&self, id: u32, t: f64, direction: Vec3<f64>, mount: &Pose<f64>, body: &Pose<f64>) -> RangeJacobian {
        let point = body.point(axpy(mount.position, t, rotate(mount.attitude, direction)));
        match self.normal(id, point).filter(|_| point.iter().all(|x| x.is_finite())) {
            Some(normal) => on_surface(normal, t, direction, mount, body),
            None => RangeJacobian::default(),
        }
    }
}

/// As [`RayScene::slope`], on a surface with this outward unit normal (world).
pub(crate) fn on_surface(
    normal: Vec3<f64>,
    t: f64,
    direction: Vec3<f64>,
    mount: &Pose<f64>,
    body: &Pose<f64>,
) -> RangeJacobian {
    let along = rotate(mount.attitude, direction);
    let d = rotate(body.attitude, along);
    let lever = axpy(mount.position, t, along);
    let bound = -GRAZING * dot(d, d).sqrt();
    // a surface that was entered faces the ray: n·d < 0
    let factor = -1.0 / dot(normal, d).min(bound);
    let turn = cross(lever, rotate_back(body.attitude, normal));
    RangeJacobian { position: scale(factor, normal), attitude: scale(factor, turn) }
}

fn vector(rows: &[[f32; LANES]; 3], lane: usize) -> Vec3<f64> {
    [0, 1, 2].map(|k| f64::from(rows[k][lane]))
}
