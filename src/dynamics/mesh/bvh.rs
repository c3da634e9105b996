//! How rays go down a tree of boxes, by obvhs, and files of triangles, by stl_io.
//!
//! The tree leaves out triangles that a ray cannot meet, and decides nothing: what it keeps is tried in `f64`, and of all hits
//! the nearest counts, so the order in which boxes are opened changes no bit. Its boxes are `f32` about the middle of the mesh, and
//! rays begin for it where they enter the ball around the mesh: what rounds is then below 2 · 10⁻⁶ of the ball's radius, and boxes are wider by [`SLACK`] of it.

use super::boxes::tree;
use super::check::Triangles;
use super::{entry, sooner};
use crate::spatial::{Vec3, axpy, dot, sub};
use base::error::Result;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::ray::{Ray, RayHit};

/// By how much boxes are wider, in radii of the ball around the mesh.
const SLACK: f32 = 2e-5;

/// Boxes around triangles.
pub(super) struct Tree(Bvh2);

impl std::fmt::Debug for Tree {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Tree of {} boxes", self.0.nodes.len())
    }
}

/// That there are meshes.
pub(super) fn ready() -> Result<()> {
    Ok(())
}

impl Tree {
    pub(super) fn new(triangles: &Triangles, center: Vec3<f64>, radius: f64) -> Result<Self> {
        let boxes: Vec<Aabb> = (0..triangles.triangles.len() as u32)
            .map(|k| {
                // of radius 1: no square is beyond f32
                let corners = triangles.corners(k).map(|p| single(sub(p, center), radius));
                let bound = |pick: fn(f32, f32) -> f32, slack: f32| {
                    [0, 1, 2].map(|i| pick(pick(corners[0][i], corners[1][i]), corners[2][i]) + slack)
                };
                Aabb { min: bound(f32::min, -SLACK).into(), max: bound(f32::max, SLACK).into() }
            })
            .collect();
        Ok(Self(tree(&boxes)))
    }

    /// The nearest entry of a ray o + t d, 0 < t < `most`, and its triangle.
    pub(super) fn nearest(
        &self,
        triangles: &Triangles,
        center: Vec3<f64>,
        radius: f64,
        [o, d]: [Vec3<f64>; 2],
        most: f64,
    ) -> Option<(f64, u32)> {
        let (start, end) = within_ball(sub(o, center), d, radius)?;
        let most = most.min(end);
        if start >= most {
            return None;
        }
        // directions of length 1, so that numbers along the ray count in radii
        let length = dot(d, d).sqrt();
        let per = radius / length;
        let direction = single(d, length);
        let origin = single(axpy(sub(o, center), start, d), radius);
        let (mut best, reach) = ((f64::INFINITY, u32::MAX), ((most - start) / per) as f32 + 1e-5);
        let ray = Ray::new(origin.into(), direction.into(), 0.0, reach);
        self.0.ray_traverse(ray, &mut RayHit::none(), |_, place| {
            let k = self.0.primitive_indices[place];
            best = sooner(best, entry(triangles.corners(k), o, d), k);
            // boxes behind this are not opened; those at it are
            ((best.0 - start) / per) as f32 + 1e-5
        });
        (best.0 < most).then_some(best)
    }
}

fn single(v: Vec3<f64>, over: f64) -> [f32; 3] {
    v.map(|x| (x / over) as f32)
}

/// Between which numbers ≥ 0 a ray w + t d is within a ball about the origin.
fn within_ball(w: Vec3<f64>, d: Vec3<f64>, radius: f64) -> Option<(f64, f64)> {
    let (squared, along) = (dot(d, d), dot(w, d));
    let sound = squared > 1e-300 && squared.is_finite();
    if !sound {
        return None;
    }
    let nearest = axpy(w, -along / squared, d);
    let chord = radius * radius - dot(nearest, nearest);
    if chord.is_nan() || chord <= 0.0 {
        return None;
    }
    let half = (chord / squared).sqrt();
    let (start, end) = (-along / squared - half, -along / squared + half);
    (end > 0.0).then_some((start.max(0.0), end))
}

/// Corners of the triangles of an STL file, one after the other; what its reader did not like, if anything.
pub(super) fn corners_of_stl(
    mut bytes: Vec<u8>,
    take: &mut dyn FnMut([[f32; 3]; 3]) -> Result<()>,
) -> Result<Option<String>> {
    let count = bytes.get(80..84).and_then(|n| n.try_into().ok()).map(u32::from_le_bytes);
    if count.is_some_and(|n| bytes.len() as u64 == 84 + 50 * u64::from(n)) {
        // headers of binary files may begin as text does
        bytes[..5].fill(0);
    } else if bytes.split(|b| *b == b'\n').filter(|line| line.trim_ascii_start().starts_with(b"endsolid")).count() > 1 {
        // the reader ends with the first
        return Ok(Some("holds several solids: make one of them, or a file of each".into()));
    }
    let mut from = std::io::Cursor::new(bytes);
    let reader = match stl_io::create_stl_reader(&mut from) {
        Ok(reader) => reader,
        Err(error) => return Ok(Some(error.to_string())),
    };
    for triangle in reader {
        match triangle {
            Ok(triangle) => take(triangle.vertices.map(|v| [v[0], v[1], v[2]]))?,
            Err(error) => return Ok(Some(error.to_string())),
        }
    }
    Ok(None)
}
