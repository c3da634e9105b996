//! What sensors that cast rays look at, and what they work with.

use super::cast::{Camera, Caster, Rays, World};
use super::solids::Solid;
use crate::dynamics::shape::Pose;

/// Working memory of sensors that cast rays: of one thread. It grows to the largest image and world it has met, and then
/// allocates no more.
#[derive(Debug, Clone, Default)]
pub struct Eyes {
    caster: Caster,
    ranges: Vec<f32>,
    ids: Vec<u32>,
}

/// What stands and moves around sensors, and the memory to look at it.
///
/// Sensors look past the body that carries them: they see ground, gates, obstacles and all other bodies.
#[derive(Debug)]
pub struct Sight<'a> {
    world: &'a mut World,
    solids: &'a [Solid],
    eyes: &'a mut Eyes,
    /// The body whose solids are left out of the world now.
    from: Option<usize>,
}

impl<'a> Sight<'a> {
    /// Of a world as [`World::fill`] made it, with these bodies in it; `eyes` are those of the thread.
    pub fn new(world: &'a mut World, solids: &'a [Solid], eyes: &'a mut Eyes) -> Self {
        Self { world, solids, eyes, from: None }
    }

    /// The world as the sensor that looks now sees it.
    pub fn world(&self) -> &World {
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

    /// Distances along all rays from `pose` (their frame → world), m, and the ids of what they hit.
    pub(crate) fn rays(&mut self, rays: &Rays, pose: &Pose<f64>) -> Readings<'_> {
        let Eyes { caster, ranges, ids } = self.eyes;
        let n = rays.n_ray();
        make_room(ranges, ids, n);
        caster.rays(self.world, rays, pose, &mut ranges[..n], &mut ids[..n]);
        Readings { ranges: &mut ranges[..n], ids: &ids[..n], world: self.world }
    }

    /// Planar depths of all pixels of a camera at `pose`, m, row by row, and the ids of what they see.
    pub(crate) fn image(&mut self, camera: &Camera, pose: &Pose<f64>) -> Readings<'_> {
        let Eyes { caster, ranges, ids } = self.eyes;
        let [width, height] = camera.size();
        let n = width * height;
        make_room(ranges, ids, n);
        caster.image(self.world, camera, pose, &mut ranges[..n], &mut ids[..n]);
        Readings { ranges: &mut ranges[..n], ids: &ids[..n], world: self.world }
    }
}

/// What rays met, in their order.
pub(crate) struct Readings<'a> {
    /// m.
    pub ranges: &'a mut [f32],
    pub ids: &'a [u32],
    pub world: &'a World,
}

fn make_room(ranges: &mut Vec<f32>, ids: &mut Vec<u32>, n: usize) {
    if ranges.len() < n {
        ranges.resize(n, 0.0);
        ids.resize(n, 0);
    }
}
