//! What sensors that cast rays look at, and what they work with.

use super::cast::{PinholeCamera, RayCaster, RayScene, Rays};
use super::gradient::ReadingRay;
use super::solids::PosedShape;
use crate::shape::Pose;

/// Working memory of sensors that cast rays: of one thread. It grows to the largest image and world it has met, and then
/// allocates no more.
#[derive(Debug, Clone, Default)]
pub struct RayScratch {
    caster: RayCaster,
    ranges: Vec<f32>,
    ids: Vec<u32>,
    met: Vec<ReadingRay>,
}

/// What stands and moves around sensors, and the memory to look at it.
///
/// Sensors look past the body that carries them: they see ground, gates, obstacles and all other bodies.
#[derive(Debug)]
pub struct SensorContext<'a> {
    world: &'a mut RayScene,
    solids: &'a [PosedShape],
    eyes: &'a mut RayScratch,
    /// The body whose solids are left out of the world now.
    from: Option<usize>,
    /// Whether slopes are told to who has them.
    has_slopes: bool,
    /// Whether the sensor that looks now tells them.
    tells: bool,
}

impl<'a> SensorContext<'a> {
    /// Of a world as [`RayScene::fill`] made it, with the shapes `solids` of bodies in it; `eyes` is the thread's working memory.
    pub fn new(world: &'a mut RayScene, solids: &'a [PosedShape], eyes: &'a mut RayScratch) -> Self {
        Self { world, solids, eyes, from: None, has_slopes: true, tells: false }
    }

    /// Spares sensors with a [`SensorGradient`](super::SensorGradient) the work for it: their slopes are zeros.
    pub fn without_slopes(self) -> Self {
        Self { has_slopes: false, ..self }
    }

    /// The world as the sensor that looks now sees it.
    pub fn world(&self) -> &RayScene {
        self.world
    }

    /// Looks from `body`, without seeing it.
    pub(crate) fn look_from(&mut self, body: usize) {
        if self.from == Some(body) {
            return;
        }
        self.from = Some(body);
        self.world.clear_moving();
        for solid in self.solids.iter().filter(|solid| solid.body != body) {
            // one that no longer fits among 2¹⁶ is not seen
            let _ = self.world.push(&solid.geometry, &solid.pose, solid.body as u32);
        }
    }

    /// Whether the sensor that samples next, which `wants` slopes, is to tell what its readings met.
    pub(crate) fn begin(&mut self, wants: bool) -> bool {
        self.tells = wants && self.has_slopes;
        self.eyes.met.clear();
        self.tells
    }

    /// Changes what the sensor that samples now told, if it tells.
    pub(crate) fn finish(&mut self, change: impl FnOnce(&mut Vec<ReadingRay>)) {
        if self.tells {
            change(&mut self.eyes.met);
        }
    }

    /// What gave the readings of the sensor that sampled last, reading by reading, if it tells.
    pub(crate) fn met(&self) -> &[ReadingRay] {
        &self.eyes.met
    }

    /// Distances along all rays from `pose` (their frame → world), m, and the ids of what they hit.
    pub(crate) fn rays(&mut self, rays: &Rays, pose: &Pose<f64>) -> Readings<'_> {
        let RayScratch { caster, ranges, ids, met } = self.eyes;
        let n = rays.n_ray();
        make_room(ranges, ids, n);
        caster.rays(self.world, rays, pose, &mut ranges[..n], &mut ids[..n]);
        let met = if self.tells { Some(met) } else { None };
        Readings { ranges: &mut ranges[..n], ids: &ids[..n], world: self.world, met }
    }

    /// Planar depths of all pixels of a camera at `pose`, m, row by row, and the ids of what they see.
    pub(crate) fn image(&mut self, camera: &PinholeCamera, pose: &Pose<f64>) -> Readings<'_> {
        let RayScratch { caster, ranges, ids, met } = self.eyes;
        let [width, height] = camera.size();
        let n = width * height;
        make_room(ranges, ids, n);
        caster.image(self.world, camera, pose, &mut ranges[..n], &mut ids[..n]);
        let met = if self.tells { Some(met) } else { None };
        Readings { ranges: &mut ranges[..n], ids: &ids[..n], world: self.world, met }
    }
}

/// What rays met, in their order.
pub(crate) struct Readings<'a> {
    /// m.
    pub ranges: &'a mut [f32],
    pub ids: &'a [u32],
    pub world: &'a RayScene,
    /// Of one entry per reading, where the sensor is to tell what they met.
    pub met: Option<&'a mut Vec<ReadingRay>>,
}

fn make_room(ranges: &mut Vec<f32>, ids: &mut Vec<u32>, n: usize) {
    if ranges.len() < n {
        ranges.resize(n, 0.0);
        ids.resize(n, 0);
    }
}
