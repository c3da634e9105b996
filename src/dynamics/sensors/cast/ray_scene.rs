//! What rays can hit: capsules, turned boxes, ground, and triangle meshes.
//!
//! A sphere is a capsule without length, a gate is four capsules. Numbers lie side by side, sixteen solids to a block, so that
//! lanes go over solids where the eye's frame is made, and over rays afterwards.

use crate::mesh::{Mesh, PlacedMesh};
use crate::scene::{Element, Scene};
use crate::shape::{Geometry, Pose};
use crate::spatial::{Vec3, add, matrix, rotate, scale, sub, unit};
use crate::uneven_ground::UnevenGround;
use base::error::{Error, Result};

/// Solids of a block and rays of a packet: a multiple of every width of lanes.
pub(super) const LANES: usize = 16;
/// One number of each solid of a block, or of each ray of a packet.
pub(super) type Row = [f32; LANES];

/// Id of a miss.
pub const NOTHING: u32 = 0;
/// Id of the ground.
pub const GROUND: u32 = 1;
/// Most capsules, and most boxes, of one world.
pub const MAX_SOLIDS: usize = 1 << 16;
/// Id of the first triangle of the first mesh; those of capsules and boxes are below.
const FIRST_TRIANGLE: u32 = 1 << 18;
/// Most triangles of all meshes of one world: ids are below 2²³.
pub const MAX_TRIANGLES: usize = (1 << 23) - (1 << 18);
/// Beyond this no coordinate or size is taken, m: squares of such numbers are far from the end of `f32`.
pub(super) const FARTHEST: f32 = 1e6;

/// What a solid belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum RayTarget {
    /// Ground, a gate, an obstacle or a mesh of the scene.
    Scene(Element),
    /// Something else, by the number that it was pushed with: another vehicle, say.
    Moving(u32),
}

/// Sixteen capsules: all points within `radius` of the segment base + s axis, 0 ≤ s ≤ length.
#[derive(Debug, Clone)]
pub(super) struct CapsuleBlock {
    /// World, m.
    pub base: [Row; 3],
    /// Unit, world.
    pub axis: [Row; 3],
    /// m.
    pub length: Row,
    /// m.
    pub radius: Row,
}

/// Sixteen boxes.
#[derive(Debug, Clone)]
pub(super) struct BoxBlock {
    /// World, m.
    pub center: [Row; 3],
    /// `axes[k]`: direction of edge k, unit, world.
    pub axes: [[Row; 3]; 3],
    /// Half of each edge, m.
    pub half: [Row; 3],
    /// From the centre to a corner, m.
    pub reach: Row,
}

/// Places without a solid hold no numbers: every comparison with them fails, so they are never seen.
const NONE: Row = [f32::NAN; LANES];

impl CapsuleBlock {
    pub(super) const EMPTY: Self = Self { base: [NONE; 3], axis: [NONE; 3], length: NONE, radius: NONE };

    fn set(&mut self, lane: usize, base: [f32; 3], axis: [f32; 3], length: f32, radius: f32) {
        for k in 0..3 {
            self.base[k][lane] = base[k];
            self.axis[k][lane] = axis[k];
        }
        self.length[lane] = length;
        self.radius[lane] = radius;
    }

    /// Puts capsule `from` of `other` at `lane`.
    #[inline(always)]
    pub(super) fn copy(&mut self, lane: usize, other: &Self, from: usize) {
        for k in 0..3 {
            self.base[k][lane] = other.base[k][from];
            self.axis[k][lane] = other.axis[k][from];
        }
        self.length[lane] = other.length[from];
        self.radius[lane] = other.radius[from];
    }
}

impl BoxBlock {
    pub(super) const EMPTY: Self = Self { center: [NONE; 3], axes: [[NONE; 3]; 3], half: [NONE; 3], reach: NONE };

    /// Puts box `from` of `other` at `lane`.
    #[inline(always)]
    pub(super) fn copy(&mut self, lane: usize, other: &Self, from: usize) {
        for k in 0..3 {
            self.center[k][lane] = other.center[k][from];
            self.half[k][lane] = other.half[k][from];
            for i in 0..3 {
                self.axes[k][i][lane] = other.axes[k][i][from];
            }
        }
        self.reach[lane] = other.reach[from];
    }
}

/// A mesh in its place.
#[derive(Debug, Clone)]
pub(super) struct Placed {
    pub mesh: PlacedMesh,
    /// Id of its first triangle.
    pub first: u32,
}

/// Blocks of one kind of solid and how many are taken.
#[derive(Debug, Clone)]
pub(super) struct Blocks<B> {
    pub blocks: Vec<B>,
    pub owners: Vec<RayTarget>,
}

impl<B> Default for Blocks<B> {
    fn default() -> Self {
        Self { blocks: Vec::new(), owners: Vec::new() }
    }
}

impl<B: Clone> Blocks<B> {
    pub(super) fn len(&self) -> usize {
        self.owners.len()
    }

    /// The next free place, after a check of the limit.
    fn place(&mut self, empty: &B, owner: RayTarget) -> Result<usize> {
        let at = self.len();
        if at >= MAX_SOLIDS {
            let remedy = "Leave out what no ray can reach.";
            return Err(Error::limit("world: number of solids of one kind", at + 1, MAX_SOLIDS, remedy));
        }
        if at.is_multiple_of(LANES) {
            self.blocks.push(empty.clone());
        }
        self.owners.push(owner);
        Ok(at)
    }

    /// Leaves the first `n`. Places behind them are emptied.
    fn truncate(&mut self, n: usize, empty: &B, erase: impl Fn(&mut B, usize, &B)) {
        for at in n..self.len() {
            erase(&mut self.blocks[at / LANES], at % LANES, empty);
        }
        self.owners.truncate(n);
        self.blocks.truncate(n.div_ceil(LANES));
    }
}

/// Everything that rays of one environment can hit.
///
/// [`fill`](Self::fill) takes over a [`Scene`] at the start of an episode; what moves is pushed behind it and taken away again
/// by [`clear_moving`](Self::clear_moving). Ids count kinds apart, so those of the scene stay as they are.
///
/// ```
/// # use omnidrones_dynamics::omnidrones;
/// use omnidrones::dynamics::scene::Scene;
/// use omnidrones::dynamics::sensors::cast::RayScene;
///
/// let mut world = RayScene::default();
/// world.fill(&Scene::grounded(), &[])?;
/// let ball = world.push_capsule([[3.0, 0.0, 1.0]; 2], 0.2, 7)?;
/// assert_eq!(world.n_solid(), 1);
/// world.clear_moving();
/// assert_eq!((world.n_solid(), world.owner(ball)), (0, None));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct RayScene {
    pub(super) capsules: Blocks<CapsuleBlock>,
    pub(super) boxes: Blocks<BoxBlock>,
    pub(super) ground: Option<f32>,
    /// What rises over it: nothing where it is level.
    pub(super) relief: UnevenGround,
    pub(super) meshes: Vec<Placed>,
    /// Capsules and boxes of the scene.
    still: [usize; 2],
}

impl RayScene {
    /// Takes over ground, gates, obstacles and meshes of a scene where `placement` puts them, instead of all there was.
    ///
    /// # Errors
    /// [`Error::Limit`] for more than 65 536 capsules or boxes (`MAX_SOLIDS`), and for more than 8 126 464 triangles of all meshes
    /// (`MAX_TRIANGLES`).
    ///
    /// # Panics
    /// On a placement of another length than [`Scene::n_placement`].
    pub fn fill(&mut self, scene: &Scene, placement: &[f64]) -> Result<()> {
        let want = scene.n_placement();
        assert!(placement.len() == want, "a placement of {} numbers for a scene of {want}", placement.len());
        self.still = [0; 2];
        self.clear_moving();
        self.ground = scene.ground.map(|height| height as f32);
        self.relief.slope = scene.relief.as_ref().map_or([0.0; 2], |relief| relief.slope);
        self.relief.waves.clear();
        self.relief.waves.extend(scene.relief.iter().flat_map(|relief| &relief.waves));
        self.place_meshes(&scene.mesh)?;
        for (i, gate) in scene.gates.iter().enumerate() {
            let owner = RayTarget::Scene(Element::Gate(i));
            for bar in gate.bars(&scene.gate_pose(placement, i)) {
                self.add_capsule(bar, gate.bar_radius(), owner)?;
            }
        }
        for (i, obstacle) in scene.obstacles.iter().enumerate() {
            let owner = RayTarget::Scene(Element::Obstacle(i));
            self.add(&obstacle.shape.geometry, &scene.obstacle_pose(placement, i), owner)?;
        }
        self.still = [self.capsules.len(), self.boxes.len()];
        Ok(())
    }

    /// Puts meshes where they say; their surfaces are shared.
    fn place_meshes(&mut self, meshes: &[Mesh]) -> Result<()> {
        self.meshes.clear();
        let mut first = FIRST_TRIANGLE as usize;
        for mesh in meshes {
            let n = mesh.n_triangle();
            if first + n > FIRST_TRIANGLE as usize + MAX_TRIANGLES {
                let (all, remedy) = (first + n - FIRST_TRIANGLE as usize, "Simplify meshes, or leave some out.");
                return Err(Error::limit("world: triangles of all meshes", all, MAX_TRIANGLES, remedy));
            }
            self.meshes.push(Placed { mesh: mesh.placed(), first: first as u32 });
            first += n;
        }
        Ok(())
    }

    /// Which mesh a triangle is of, and its number there.
    pub(super) fn triangle(&self, id: u32) -> Option<(usize, usize)> {
        let at = self.meshes.partition_point(|placed| placed.first <= id).checked_sub(1)?;
        let k = (id - self.meshes[at].first) as usize;
        (k < self.meshes[at].mesh.n_triangle()).then_some((at, k))
    }

    /// Whether its ground is anything but a level plane.
    pub(in crate::sensors) fn is_uneven(&self) -> bool {
        self.ground.is_some() && (self.relief.slope != [0.0; 2] || !self.relief.waves.is_empty())
    }

    /// Takes away all that was pushed since [`fill`](Self::fill).
    pub fn clear_moving(&mut self) {
        let erase = |block: &mut CapsuleBlock, lane: usize, empty: &CapsuleBlock| block.copy(lane, empty, 0);
        self.capsules.truncate(self.still[0], &CapsuleBlock::EMPTY, erase);
        let erase = |block: &mut BoxBlock, lane: usize, empty: &BoxBlock| block.copy(lane, empty, 0);
        self.boxes.truncate(self.still[1], &BoxBlock::EMPTY, erase);
    }

    /// Adds all points within `radius` of the segment between `ends` (world, m), a sphere where both are one. Its id. One whose
    /// numbers are not finite, or beyond 10⁶ m, is never seen.
    ///
    /// # Errors
    /// [`Error::Limit`] for a capsule more than `MAX_SOLIDS`.
    pub fn push_capsule(&mut self, ends: [Vec3<f64>; 2], radius: f64, owner: u32) -> Result<u32> {
        self.add_capsule(ends, radius, RayTarget::Moving(owner))
    }

    /// Adds a box of these edge lengths (m) about the origin of `pose` (world). Its id. One whose numbers are not finite, or
    /// beyond 10⁶ m, is never seen.
    ///
    /// # Errors
    /// [`Error::Limit`] for a box more than `MAX_SOLIDS`.
    pub fn push_box(&mut self, pose: &Pose<f64>, size: Vec3<f64>, owner: u32) -> Result<u32> {
        self.add_box(pose, size, RayTarget::Moving(owner))
    }

    /// Adds a shape at a pose in the world: a part of a vehicle, say. Its id.
    ///
    /// # Errors
    /// [`Error::Limit`] for a solid more than `MAX_SOLIDS` of its kind.
    pub fn push(&mut self, geometry: &Geometry, pose: &Pose<f64>, owner: u32) -> Result<u32> {
        self.add(geometry, pose, RayTarget::Moving(owner))
    }

    fn add(&mut self, geometry: &Geometry, pose: &Pose<f64>, owner: RayTarget) -> Result<u32> {
        match *geometry {
            Geometry::Sphere { radius } => self.add_capsule([pose.position; 2], radius, owner),
            Geometry::Capsule { radius, length } => {
                let half = rotate(unit(pose.attitude), [0.0, 0.0, 0.5 * length]);
                self.add_capsule([sub(pose.position, half), add(pose.position, half)], radius, owner)
            }
            Geometry::Box { size } => self.add_box(pose, size, owner),
        }
    }

    fn add_capsule(&mut self, ends: [Vec3<f64>; 2], radius: f64, owner: RayTarget) -> Result<u32> {
        let at = self.capsules.place(&CapsuleBlock::EMPTY, owner)?;
        let along = sub(ends[1], ends[0]);
        let length = along.iter().map(|x| x * x).sum::<f64>().sqrt();
        let axis = if length > 1e-9 { scale(1.0 / length, along) } else { [0.0, 0.0, 1.0] };
        let numbers = [ends[0][0], ends[0][1], ends[0][2], length, radius];
        if sound(&numbers) && radius > 0.0 {
            let (base, axis) = (ends[0].map(|x| x as f32), axis.map(|x| x as f32));
            let length = if length > 1e-9 { length as f32 } else { 0.0 };
            self.capsules.blocks[at / LANES].set(at % LANES, base, axis, length, radius as f32);
        }
        Ok(capsule_id(at))
    }

    fn add_box(&mut self, pose: &Pose<f64>, size: Vec3<f64>, owner: RayTarget) -> Result<u32> {
        let at = self.boxes.place(&BoxBlock::EMPTY, owner)?;
        let m = matrix(unit(pose.attitude));
        let reach = 0.5 * size.iter().map(|x| x * x).sum::<f64>().sqrt();
        let (block, lane) = (&mut self.boxes.blocks[at / LANES], at % LANES);
        let turned = pose.attitude.iter().all(|x| x.is_finite());
        if sound(&pose.position) && sound(&[reach]) && turned && size.iter().all(|x| *x > 0.0) {
            for k in 0..3 {
                block.center[k][lane] = pose.position[k] as f32;
                block.half[k][lane] = (0.5 * size[k]) as f32;
                for i in 0..3 {
                    block.axes[k][i][lane] = m[i][k] as f32;
                }
            }
            block.reach[lane] = reach as f32;
        }
        Ok(box_id(at))
    }

    /// Places that are there without a further allocation.
    #[cfg(test)]
    pub(super) fn room(&self) -> [usize; 4] {
        let (capsules, boxes) = (&self.capsules, &self.boxes);
        [capsules.blocks.capacity(), capsules.owners.capacity(), boxes.blocks.capacity(), boxes.owners.capacity()]
    }

    /// Capsules and boxes.
    pub fn n_solid(&self) -> usize {
        self.capsules.len() + self.boxes.len()
    }

    /// What the solid of an id belongs to; `None` for [`NOTHING`] and for ids that this world has not.
    pub fn owner(&self, id: u32) -> Option<RayTarget> {
        match solid(id) {
            Solid::Nothing => None,
            Solid::Ground => self.ground.map(|_| RayTarget::Scene(Element::Ground)),
            Solid::Capsule(i) => self.capsules.owners.get(i).copied(),
            Solid::Box(i) => self.boxes.owners.get(i).copied(),
            Solid::Triangle(id) => self.triangle(id).map(|(i, _)| RayTarget::Scene(Element::Mesh(i))),
        }
    }
}

/// Whether `f32` carries these numbers.
fn sound(numbers: &[f64]) -> bool {
    numbers.iter().all(|x| x.abs() <= f64::from(FARTHEST))
}

/// What an id stands for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Solid {
    Nothing,
    Ground,
    Capsule(usize),
    Box(usize),
    /// By its id.
    Triangle(u32),
}

pub(super) fn capsule_id(i: usize) -> u32 {
    2 + 2 * i as u32
}

pub(super) fn box_id(i: usize) -> u32 {
    3 + 2 * i as u32
}

pub(super) fn solid(id: u32) -> Solid {
    match id {
        NOTHING => Solid::Nothing,
        GROUND => Solid::Ground,
        FIRST_TRIANGLE.. => Solid::Triangle(id),
        _ if id.is_multiple_of(2) => Solid::Capsule((id as usize - 2) / 2),
        _ => Solid::Box((id as usize - 3) / 2),
    }
}

/// 2²³ as bits of an `f32`, whose mantissa then counts in ones.
const WHOLE: u32 = 0x4B00_0000;

/// An id below 2²³ as a number that lanes can carry: 2²³ + id.
#[inline(always)]
pub(super) fn number(id: u32) -> f32 {
    f32::from_bits(WHOLE | id)
}

/// The id of such a number.
#[inline(always)]
pub(super) fn id(number: f32) -> u32 {
    number.to_bits() & !WHOLE
}
