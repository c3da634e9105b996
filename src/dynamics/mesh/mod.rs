//! Static triangle meshes and height fields, which sensors see and nothing touches.
//!
//! | file | what |
//! |---|---|
//! | `check` | what a mesh must be: closed, its outside out |
//! | `heights` | a grid of heights as a closed mesh |
//! | `table` | meshes in TOML, and the files that they name |
//! | `bvh` | how rays go down the tree of boxes (obvhs), and files of triangles (stl_io): with the feature `mesh` |
//! | `boxes` | how that tree is made: in n log n, whatever the triangles |
//! | `bvh_stub` | the error that there is in their place without it |
//!
//! A [`Mesh`] is seen by rays ([`sensors::cast`](crate::sensors::cast)) from outside, as everything else. It exerts no
//! force, and distances ([`Scene::distance`](crate::scene::Scene::distance)) do not know it; so that nobody takes it for a wall, a scene
//! refuses one that does not say so ([`Mesh::only_seen`]). What is to be touched is stood in for by boxes and capsules: obstacles that the
//! mesh encloses.
//!
//! Its triangles and their tree are shared by all environments and all placements; what differs is a pose and a scale.

#[cfg(not(feature = "mesh"))]
#[path = "bvh_stub.rs"]
mod backend;
#[cfg(feature = "mesh")]
#[path = "bvh.rs"]
mod backend;
#[cfg(feature = "mesh")]
mod boxes;
mod check;
mod heights;
mod table;
#[cfg(all(test, feature = "mesh"))]
mod tests;

use super::shape::{MAX_SIZE, Pose, upright, validate_pose, within};
use super::spatial::{Vec3, cross, dot, rotate, rotate_back, scale, sub, unit};
use backend::Tree;
use base::error::{Error, Result};
use check::Triangles;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;
pub(crate) use table::{MeshTable, meshes};

/// Most triangles of one mesh.
pub const MAX_TRIANGLES: usize = 1_000_000;

/// A closed surface of triangles that stands still, with its pose in the world.
///
/// ```no_run
/// # use omnidrones_dynamics::omnidrones;
/// use omnidrones::dynamics::Mesh;
/// use omnidrones::dynamics::scene::Scene;
/// let hall = Mesh::from_file("hall", "hall.stl")?.scaled(1e-3).at([4.0, 0.0, 0.0]).only_seen();
/// let scene = Scene { mesh: vec![hall], ..Scene::grounded() };
/// scene.validate()?;
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(into = "MeshTable", try_from = "MeshTable")]
pub struct Mesh {
    /// Unique in its scene; for messages.
    pub name: String,
    /// Of its origin, world, m.
    pub position: [f64; 3],
    /// Unit quaternion `[w, x, y, z]`, mesh → world.
    pub rotation: [f64; 4],
    /// Metres of one unit of its vertices: 0.001 where they are in millimetres.
    pub scale: f64,
    /// Whether it was taken for something that can be touched. It cannot: [`validate`](Self::validate) refuses true.
    pub contact: bool,
    source: Source,
    surface: Arc<Surface>,
}

/// What a mesh was made from, to be written down again.
#[derive(Debug, Clone, PartialEq)]
enum Source {
    Triangles,
    File(PathBuf),
    /// A file of heights, and their spacing.
    HeightFile(PathBuf, [f64; 2]),
    Heights(Arc<Vec<Vec<f64>>>, [f64; 2]),
}

/// Triangles in the frame of their mesh, in its units, and their tree.
#[derive(Debug)]
struct Surface {
    triangles: Triangles,
    tree: Tree,
    /// Of a ball around all.
    center: Vec3<f64>,
    radius: f64,
}

impl PartialEq for Surface {
    fn eq(&self, other: &Self) -> bool {
        self.triangles == other.triangles
    }
}

impl Mesh {
    /// A mesh of `triangles`, by the numbers of their corners among the `vertices` (m): counter-clockwise seen from outside.
    ///
    /// # Errors
    /// [`Error::Limit`] for fewer than 4 or more than 10⁶. [`Error::Value`] for vertices that are not finite,
    /// corners that there are not, triangles without area, edges that are not shared by exactly two triangles in opposite
    /// directions, and an outside that is in; without the feature `mesh`.
    pub fn new(name: impl Into<String>, vertices: Vec<[f64; 3]>, triangles: Vec<[u32; 3]>) -> Result<Self> {
        Self::of(name.into(), Triangles { vertices, triangles }, Source::Triangles)
    }

    /// A height field: `heights[i][j]` (m) stands at x = j `spacing[0]`, y = i `spacing[1]`. It becomes closed by walls at its
    /// border and a floor 1 m below its lowest height. A cell is two triangles, split from its first corner to the opposite one.
    ///
    /// # Errors
    /// As [`new`](Self::new); fewer than 2 × 2 heights, rows of different lengths, a spacing that is not above 0.
    pub fn height_field(name: impl Into<String>, heights: Vec<Vec<f64>>, spacing: [f64; 2]) -> Result<Self> {
        let name = name.into();
        backend::ready()?;
        let triangles = heights::closed(&format!("mesh '{name}'"), &heights, spacing)?;
        Self::of(name, triangles, Source::Heights(Arc::new(heights), spacing))
    }

    /// Reads the triangles of an STL file, binary or text, of at most 256 MiB. Corners at the same place become one.
    ///
    /// # Errors
    /// As [`new`](Self::new); [`Error::File`], [`Error::Format`] and [`Error::Limit`] for what cannot be read.
    pub fn from_file(name: impl Into<String>, path: impl AsRef<Path>) -> Result<Self> {
        let (name, path) = (name.into(), path.as_ref());
        backend::ready()?;
        let triangles = table::read_stl(&format!("mesh '{name}'"), path)?;
        Self::of(name, triangles, Source::File(path.to_path_buf()))
    }

    /// A height field from a CSV file of at most 64 MiB without a header: a row of heights (m) per line, as
    /// [`height_field`](Self::height_field) takes them.
    ///
    /// # Errors
    /// As there and of [`from_file`](Self::from_file).
    pub fn height_field_from_file(name: impl Into<String>, path: impl AsRef<Path>, spacing: [f64; 2]) -> Result<Self> {
        let (name, path) = (name.into(), path.as_ref());
        backend::ready()?;
        let triangles = heights::closed(&format!("mesh '{name}'"), &table::read_heights(path)?, spacing)?;
        Self::of(name, triangles, Source::HeightFile(path.to_path_buf(), spacing))
    }

    fn of(name: String, triangles: Triangles, source: Source) -> Result<Self> {
        backend::ready()?;
        triangles.check(&format!("mesh '{name}'"))?;
        let (center, radius) = triangles.ball();
        let tree = Tree::new(&triangles, center, radius)?;
        let surface = Arc::new(Surface { triangles, tree, center, radius });
        let (position, rotation) = ([0.0; 3], upright());
        Ok(Self { name, position, rotation, scale: 1.0, contact: true, source, surface })
    }

    /// With its origin there, world, m.
    pub fn at(self, position: [f64; 3]) -> Self {
        Self { position, ..self }
    }

    /// Turned by this unit quaternion `[w, x, y, z]`, mesh → world.
    pub fn turned(self, rotation: [f64; 4]) -> Self {
        Self { rotation, ..self }
    }

    /// With a unit of its vertices of so many metres.
    pub fn scaled(self, scale: f64) -> Self {
        Self { scale, ..self }
    }

    /// Says that it is known not to be touched: `contact = false`.
    pub fn only_seen(self) -> Self {
        Self { contact: false, ..self }
    }

    /// How many triangles.
    pub fn n_triangle(&self) -> usize {
        self.surface.triangles.triangles.len()
    }

    /// Checks place and scale, and that it says not to be touched; triangles were checked when it was made. `what` names it.
    ///
    /// # Errors
    /// A pose as [`Shape::validate`](crate::shape::Shape::validate) refuses; a scale that is not above 0, or makes it
    /// larger than 10⁴ m; `contact`.
    pub fn validate(&self, what: &str) -> Result<()> {
        if self.contact {
            let limit = "false: meshes are seen and not touched";
            let remedy =
                "Say contact = false (Mesh::only_seen), and stand boxes or capsules in for what is to be touched.";
            return Err(Error::value(format!("{what}: contact"), "true unless told otherwise", limit, remedy));
        }
        validate_pose(what, &self.position, &self.rotation)?;
        within(&format!("{what}: scale"), self.scale, 1e-9, 1e9)?;
        within(&format!("{what}: size times scale"), 2.0 * self.surface.radius * self.scale, 0.0, MAX_SIZE)
    }

    /// Whether it is the same surface in the same place.
    pub(crate) fn is_that(&self, other: &Self) -> bool {
        let place = |mesh: &Self| (mesh.position, mesh.rotation, mesh.scale);
        Arc::ptr_eq(&self.surface, &other.surface) && place(self) == place(other)
    }

    /// Where rays meet it.
    pub(crate) fn placed(&self) -> PlacedMesh {
        let pose = Pose { position: self.position, attitude: unit(self.rotation) };
        PlacedMesh { surface: self.surface.clone(), pose, scale: self.scale }
    }
}

/// A surface in its place, for rays.
#[derive(Debug, Clone)]
pub(crate) struct PlacedMesh {
    surface: Arc<Surface>,
    pose: Pose<f64>,
    scale: f64,
}

impl PlacedMesh {
    pub(crate) fn n_triangle(&self) -> usize {
        self.surface.triangles.triangles.len()
    }

    /// Centre (world, m) and radius (m) of a ball around it.
    pub(crate) fn ball(&self) -> (Vec3<f64>, f64) {
        let own = &self.surface;
        (self.pose.point(scale(self.scale, own.center)), self.scale * own.radius)
    }

    /// A point of the world in its frame and units.
    pub(crate) fn local_point(&self, p: Vec3<f64>) -> Vec3<f64> {
        scale(1.0 / self.scale, self.pose.local(p))
    }

    /// A vector of the world in its frame and units: numbers along a ray stay what they are.
    pub(crate) fn local_direction(&self, d: Vec3<f64>) -> Vec3<f64> {
        scale(1.0 / self.scale, rotate_back(self.pose.attitude, d))
    }

    /// The nearest entry of o + t d, 0 < t < `most`, from outside: t and the number of the triangle, of two as near the first.
    pub(crate) fn nearest(&self, o: Vec3<f64>, d: Vec3<f64>, most: f64) -> Option<(f64, u32)> {
        let own = &self.surface;
        own.tree.nearest(&own.triangles, own.center, own.radius, [o, d], most)
    }

    /// The same by trying all triangles.
    pub(crate) fn nearest_of_all(&self, o: Vec3<f64>, d: Vec3<f64>) -> Option<(f64, u32)> {
        let mut best = (f64::INFINITY, u32::MAX);
        for k in 0..self.n_triangle() as u32 {
            best = sooner(best, entry(self.surface.triangles.corners(k), o, d), k);
        }
        best.0.is_finite().then_some(best)
    }

    /// Outward unit normal of a triangle, world.
    pub(crate) fn normal(&self, k: usize) -> Vec3<f64> {
        let n = area(self.surface.triangles.corners(k as u32));
        rotate(self.pose.attitude, scale(1.0 / dot(n, n).sqrt(), n))
    }
}

/// The nearer of what is known and triangle `k` at t, of two as near the one with the lower number.
#[inline]
fn sooner(best: (f64, u32), t: f64, k: u32) -> (f64, u32) {
    if t < best.0 || (t == best.0 && k < best.1) { (t, k) } else { best }
}

/// Where a ray o + t d enters the outside of a triangle, t > 0; infinite where it does not.
///
/// Whether it passes an edge on the one side or the other is the sign of one number for both triangles that share the edge, so no ray slips
/// between them; one that meets the edge itself meets both.
#[inline]
fn entry([a, b, c]: [Vec3<f64>; 3], o: Vec3<f64>, d: Vec3<f64>) -> f64 {
    let (p, q, r) = (sub(a, o), sub(b, o), sub(c, o));
    if dot(cross(q, p), d) < 0.0 || dot(cross(r, q), d) < 0.0 || dot(cross(p, r), d) < 0.0 {
        return f64::INFINITY;
    }
    let n = area([a, b, c]);
    let facing = dot(n, d);
    let t = dot(n, p) / facing;
    if facing < 0.0 && t > 0.0 { t } else { f64::INFINITY }
}

/// Twice the area, along the outward normal.
#[inline]
fn area([a, b, c]: [Vec3<f64>; 3]) -> Vec3<f64> {
    cross(sub(b, a), sub(c, a))
}
