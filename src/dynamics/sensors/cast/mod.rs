//! Rays from one point to the nearest surface of a scene: depth images, lidars, range finders.
//!
//! | file | what |
//! |---|---|
//! | `ray_scene` | capsules, boxes, ground and meshes, as numbers for lanes |
//! | `pattern` | ground, then solid by solid, then readings: what images and scans share |
//! | `cull` | which of them an eye can see, nearest first |
//! | `pieces` | their numbers in the frame of the eye, and the tiles of an image that they can touch |
//! | `hit` | the ray's number at which it enters a solid |
//! | `pinhole` | depth images: 4×4 pixels at a time |
//! | `packets` | rays of any directions: sixteen at a time |
//! | `normal` | normals of hits, and the derivative of a range in the sensor's pose |
//! | `uneven` | the first place where a ray meets hills |
//! | `meshes` | triangle meshes, ray by ray, after all that lanes see |
//! | `reference` | one ray after the other in `f64`, for tests |
//!
//! All rays of one call begin at one **eye**, so that whatever a solid and the eye have in common is computed once for both; a
//! pixel is left with three functions that are affine in its direction, a root and a quotient. Frames as everywhere: the eye's
//! x points forward, y to the left, z up.
//!
//! **Solids are seen from outside only**: one that contains the eye is not seen at all, ground included. A ray ends at the
//! first surface; where that is nearer than the least range or beyond the most, or where there is none, it is a miss: its
//! number is the most range and its id [`NOTHING`].
//!
//! **Same bits everywhere.** Every sum of a product is fused, in one lane too, so images do not depend on the processor. What
//! is left out because it cannot be seen is left out by bounds that are wider than all roundings: an image is that of all
//! solids at all pixels, bit for bit.
//!
//! Uneven ground is a plane where it only slopes, and a bounded march where it has waves ([`UnevenGround`](crate::UnevenGround));
//! of triangle meshes ([`Mesh`](crate::Mesh)) every ray that reaches their ball goes down a tree of boxes, in `f64`.
//!
//! Numbers are `f32` about the eye: 10⁻³ (1 + t) m of the exact range holds for scenes within some hundred metres of the
//! origin, whose coordinates `f32` resolves to 10⁻⁵ m.

mod cull;
mod hit;
mod meshes;
#[doc(hidden)]
pub mod normal;
#[doc(hidden)]
pub mod packets;
mod pattern;
mod pieces;
#[doc(hidden)]
pub mod pinhole;
#[doc(hidden)]
pub mod ray_scene;
#[cfg(test)]
mod reference;
#[cfg(test)]
mod tests;
mod uneven;
#[cfg(test)]
mod uneven_tests;

pub use packets::Rays;
pub use pinhole::PinholeCamera;
pub(crate) use ray_scene::MAX_TRIANGLES;
pub use ray_scene::{GROUND, NOTHING, RayScene, RayTarget};

use crate::shape::{MAX_SIZE, Pose};
use crate::spatial::{Vec3, matrix, unit};
use autodiff::lanes::Lanes;
use base::error::{Error, Result, finite};
use ray_scene::LANES;

/// Between which distances a sensor gives a reading, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RangeLimits {
    /// What is nearer gives none, and hides what is behind it.
    pub least: f64,
    /// What is farther gives none.
    pub most: f64,
}

impl RangeLimits {
    /// Checks that 0 ≤ least < most ≤ 10⁴ m.
    ///
    /// # Errors
    /// [`Error::Value`] for numbers that are not finite or out of order; `what` names the sensor in it.
    pub fn validate(&self, what: &str) -> Result<()> {
        finite(&format!("{what}: range"), &[self.least, self.most])?;
        if 0.0 <= self.least && self.least < self.most && self.most <= MAX_SIZE {
            return Ok(());
        }
        Err(Error::value(
            format!("{what}: range"),
            format!("{} to {}", self.least, self.most),
            format!("within 0 to {MAX_SIZE}, the least below the most"),
            "Both are in metres.",
        ))
    }
}

/// Working memory of casts: of one thread. It grows to the largest image and world it has met, and then allocates no more.
///
/// ```
/// # use omnidrones_dynamics::omnidrones;
/// use omnidrones::dynamics::sensors::cast::{PinholeCamera, RayCaster, GROUND, NOTHING, RangeLimits, Rays, RayScene};
/// use omnidrones::dynamics::scene::Scene;
/// use omnidrones::dynamics::shape::Pose;
///
/// let mut world = RayScene::default();
/// world.fill(&Scene::grounded(), &[])?;
/// let ball = world.push_capsule([[3.0, 0.0, 1.0]; 2], 0.5, 0)?;
/// let eye = Pose { position: [0.0, 0.0, 1.0], attitude: [1.0, 0.0, 0.0, 0.0] };
/// let range = RangeLimits { least: 0.1, most: 10.0 };
/// let mut caster = RayCaster::new();
///
/// // straight ahead, straight down, straight up
/// let rays = Rays::new(&[[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], range)?;
/// let (mut ranges, mut ids) = ([0.0; 3], [0; 3]);
/// caster.rays(&world, &rays, &eye, &mut ranges, &mut ids);
/// assert_eq!((ranges, ids), ([2.5, 1.0, 10.0], [ball, GROUND, NOTHING]));
///
/// let camera = PinholeCamera::new(64, 48, 1.5, range)?;
/// let (mut depth, mut ids) = (vec![0.0; 64 * 48], vec![0; 64 * 48]);
/// caster.image(&world, &camera, &eye, &mut depth, &mut ids);
/// assert_eq!((ids[0], ids[24 * 64 + 32], ids[47 * 64]), (NOTHING, ball, GROUND));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct RayCaster {
    kept: cull::Kept,
    tiles: Vec<Tile>,
    /// Of every tile, the farthest of its depths.
    far: Vec<f32>,
    /// Waves of the ground, from this eye.
    hills: uneven::Hills,
}

/// Ranges and ids of sixteen rays while solids are put into them.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct Tile {
    range: [f32; LANES],
    id: [f32; LANES],
}

impl RayCaster {
    /// Without memory yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Makes room for `n` tiles that nothing stands in the way of yet.
    #[inline(always)]
    fn prepare(&mut self, n: usize, most: f32) {
        if self.tiles.len() < n {
            self.tiles.resize(n, Tile::missed(most));
            self.far.resize(n, most);
        }
        self.far[..n].fill(most);
    }
}

impl Tile {
    /// Sixteen misses.
    fn missed(most: f32) -> Self {
        Self { range: [most; LANES], id: [ray_scene::number(NOTHING); LANES] }
    }
}

/// Where rays begin, and the axes of their frame.
#[derive(Debug, Clone, Copy)]
struct Eye {
    /// World, m.
    position: [f32; 3],
    /// Forward, left and up, world.
    axes: [[f32; 3]; 3],
}

impl Eye {
    /// Of a pose; `None` where a number is not finite, too large for `f32`, or the quaternion none.
    fn new(pose: &Pose<f64>) -> Option<Self> {
        let squared = pose.attitude.iter().map(|x| x * x).sum::<f64>();
        let m = matrix(unit(pose.attitude));
        let axes: [[f32; 3]; 3] = std::array::from_fn(|k| std::array::from_fn(|i| m[i][k] as f32));
        let position = pose.position.map(|x| x as f32);
        let sound = squared > 1e-6 && squared < 1e6 && position.iter().all(|x| x.abs() <= ray_scene::FARTHEST);
        sound.then_some(Self { position, axes })
    }

    /// Distance of the eye from the plane of the ground, m, and that plane's normal along its axes; `None` from below.
    #[inline(always)]
    fn above(&self, ground: Option<f32>, slope: [f64; 2]) -> Option<(f32, [f32; 3])> {
        let ground = ground?;
        let (height, up) = if slope == [0.0; 2] {
            (self.position[2] - ground, [self.axes[0][2], self.axes[1][2], self.axes[2][2]])
        } else {
            let (x, y, z) = (self.position[0], self.position[1], self.position[2]);
            let above = f64::from(z) - f64::from(ground) - slope[0] * f64::from(x) - slope[1] * f64::from(y);
            let length = (1.0 + slope[0] * slope[0] + slope[1] * slope[1]).sqrt();
            ((above / length) as f32, self.along([-slope[0] / length, -slope[1] / length, 1.0 / length]))
        };
        if height > 0.0 { Some((height, up)) } else { None }
    }

    /// A vector of the world along its axes.
    #[inline(always)]
    fn along(&self, v: [f64; 3]) -> [f32; 3] {
        let part = |a: &[f32; 3]| f64::from(a[0]) * v[0] + f64::from(a[1]) * v[1] + f64::from(a[2]) * v[2];
        [part(&self.axes[0]) as f32, part(&self.axes[1]) as f32, part(&self.axes[2]) as f32]
    }

    /// A vector of its frame in the world.
    fn outward(&self, d: [f32; 3]) -> Vec3<f64> {
        [0, 1, 2].map(|i| (0..3).map(|k| f64::from(self.axes[k][i]) * f64::from(d[k])).sum())
    }
}

/// a b + c in one rounding, also in one lane, where [`Scalar::mul_add`](autodiff::Scalar::mul_add) makes two.
#[inline(always)]
fn fused<L: Lanes>(a: L, b: L, c: L) -> L {
    if L::WIDTH > 1 {
        return a.mul_add(b, c);
    }
    let mut x = [[0.0_f32; 1]; 3];
    a.store(&mut x[0]);
    b.store(&mut x[1]);
    c.store(&mut x[2]);
    L::load(&[x[0][0].mul_add(x[1][0], x[2][0])])
}

/// The same number in every lane.
#[inline(always)]
fn splat<L: Lanes>(x: f32) -> L {
    L::constant(f64::from(x))
}

/// a·b of vectors, in three roundings.
#[inline(always)]
fn dot<L: Lanes>(a: Vec3<L>, b: Vec3<L>) -> L {
    fused(a[0], b[0], fused(a[1], b[1], a[2] * b[2]))
}
