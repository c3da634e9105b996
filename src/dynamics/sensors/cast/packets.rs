//! Rays of any directions from one eye, sixteen at a time: lidars, range finders, fans of beams.
//!
//! Directions have unit length, so t is the **distance**. Solids within range are kept, nearest first, and tried on each packet
//! whose farthest range they could shorten and whose cone of directions they reach into.

use super::cull::View;
use super::hit::{N_NUMBER, Piece};
use super::pattern::{OnePiece, Pattern, largest, nearer};
use super::pieces::{Grid, widened};
use super::ray_scene::{self, GROUND, LANES, NOTHING, RayScene, Row};
use super::{RangeLimits, RayCaster, Tile, dot, fused, splat};
use crate::shape::Pose;
use crate::spatial::Vec3;
use autodiff::Mask;
use autodiff::lanes::Lanes;
use autodiff::unrolled::unrolled;
use base::error::{Error, Result, finite};

/// Most rays of one sensor.
pub const MAX_RAYS: usize = 1 << 20;

/// Rays from one point, by their directions in the frame of the sensor.
#[derive(Debug, Clone)]
pub struct Rays {
    n: usize,
    range: RangeLimits,
    directions: Vec<[Row; 3]>,
    cones: Vec<Cones>,
}

/// Around the directions of sixteen packets.
#[derive(Debug, Clone)]
struct Cones {
    /// Unit vectors.
    middle: [Row; 3],
    /// The longest vector from there to a direction; far below zero where there is no packet.
    chord: Row,
}

impl Rays {
    /// Rays along `directions`, of any length > 0.
    ///
    /// # Errors
    /// [`Error::Limit`] for no direction or more than 2²⁰ (`MAX_RAYS`); [`Error::Value`] for one that is not finite or has no length; a
    /// range as [`RangeLimits::validate`] refuses.
    pub fn new(directions: &[Vec3<f64>], range: RangeLimits) -> Result<Self> {
        range.validate("rays")?;
        let mut rays = Self { n: 0, range, directions: Vec::new(), cones: Vec::new() };
        rays.aim(directions)?;
        Ok(rays)
    }

    /// A lidar of `n` beams around z, evenly from straight ahead to the left, at each of the `elevations` (rad, up); ray
    /// `beam · elevations + elevation`.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn lidar(n: usize, elevations: &[f64], range: RangeLimits) -> Result<Self> {
        let count = n.saturating_mul(elevations.len());
        check(count)?;
        let direction = |i: usize| {
            let (sin, cos) = (std::f64::consts::TAU * (i / elevations.len()) as f64 / n as f64).sin_cos();
            let (rise, flat) = elevations[i % elevations.len()].sin_cos();
            [flat * cos, flat * sin, rise]
        };
        Self::new(&(0..count).map(direction).collect::<Vec<_>>(), range)
    }

    /// Other directions, for patterns that do not repeat; without allocation where there are no more than before.
    ///
    /// # Errors
    /// As [`new`](Self::new); the rays stay as they were then.
    pub fn aim(&mut self, directions: &[Vec3<f64>]) -> Result<()> {
        check(directions.len())?;
        for (i, d) in directions.iter().enumerate() {
            let length = norm(d);
            if !(1e-6..=1e6).contains(&length) {
                finite(&format!("rays: direction {i}"), d)?;
                let remedy = "Any vector along the ray will do.";
                return Err(Error::value(format!("rays: length of direction {i}"), length, "1e-6 to 1e6", remedy));
            }
        }
        self.n = directions.len();
        self.directions.clear();
        for sixteen in directions.chunks(LANES) {
            let mut packet = [[0.0; LANES]; 3];
            for lane in 0..LANES {
                // a packet that is not full repeats its last ray
                let d = &sixteen[lane.min(sixteen.len() - 1)];
                unrolled!(k in 0..3 {
                    packet[k][lane] = (d[k] / norm(d)) as f32;
                });
            }
            self.directions.push(packet);
        }
        self.cones.clear();
        for sixteen in self.directions.chunks(LANES) {
            let mut cones = Cones { middle: [[0.0; LANES]; 3], chord: [-1e9; LANES] };
            for (lane, packet) in sixteen.iter().enumerate() {
                let (middle, chord) = cone(packet);
                unrolled!(k in 0..3 {
                    cones.middle[k][lane] = middle[k];
                });
                cones.chord[lane] = chord;
            }
            self.cones.push(cones);
        }
        Ok(())
    }

    /// Places that are there without a further allocation.
    #[cfg(test)]
    pub(super) fn room(&self) -> [usize; 2] {
        [self.directions.capacity(), self.cones.capacity()]
    }

    /// How many.
    pub fn n_ray(&self) -> usize {
        self.n
    }

    /// Of its readings, along the rays.
    pub fn range(&self) -> RangeLimits {
        self.range
    }

    /// Unit direction of ray `index`, in the frame of the sensor.
    pub fn direction(&self, index: usize) -> Vec3<f64> {
        let packet = &self.directions[index / LANES];
        [0, 1, 2].map(|k| f64::from(packet[k][index % LANES]))
    }
}

/// The middle of a packet's directions, and the longest vector from there to one of them, and a little.
fn cone(packet: &[Row; 3]) -> ([f32; 3], f32) {
    let sum = [0, 1, 2].map(|k| packet[k].iter().map(|x| f64::from(*x)).sum::<f64>());
    let length = norm(&sum);
    // directions all around have no middle: any will do, with a chord that excludes nothing
    let middle = if length > 1e-3 { sum.map(|x| (x / length) as f32) } else { [1.0, 0.0, 0.0] };
    let to = |lane: usize| norm(&[0, 1, 2].map(|k| f64::from(packet[k][lane] - middle[k])));
    (middle, (0..LANES).map(to).fold(0.0, f64::max) as f32 + 1e-5)
}

fn norm(d: &Vec3<f64>) -> f64 {
    d.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn check(n: usize) -> Result<()> {
    if (1..=MAX_RAYS).contains(&n) {
        return Ok(());
    }
    Err(Error::limit("rays: number of directions", n, format!("1 to {MAX_RAYS}"), "Split them into several sensors."))
}

impl View for Rays {
    #[inline(always)]
    fn reaches<L: Lanes>(&self, base: Vec3<L>, axis: Vec3<L>, length: L, radius: L) -> (L, L::Mask) {
        let along = (-dot(base, axis)).max(L::zero()).min(length);
        let mut nearest = base;
        unrolled!(k in 0..3 {
            nearest[k] = fused(along, axis[k], base[k]);
        });
        // what rounds is relative to the far end, from which the nearest point was computed
        let near = dot(nearest, nearest).sqrt() - widened(widened(radius, base), nearest);
        (near, near.lt(splat(self.range.most as f32)))
    }

    #[inline(always)]
    fn grid(&self) -> Option<&Grid> {
        None
    }
}

impl RayCaster {
    /// Ranges (m) and ids of all rays in their order, as the sensor at `pose` (its frame → world) finds them in `world`. From
    /// a pose that is not finite, all are misses.
    ///
    /// # Panics
    /// On slices of another length than there are rays.
    pub fn rays(&mut self, world: &RayScene, rays: &Rays, pose: &Pose<f64>, ranges: &mut [f32], ids: &mut [u32]) {
        self.cast::<Rays, false>(world, rays, pose, ranges, ids);
    }

    /// The same by trying all solids on all rays.
    #[cfg(test)]
    pub(crate) fn rays_of_all(
        &mut self,
        world: &RayScene,
        rays: &Rays,
        pose: &Pose<f64>,
        ranges: &mut [f32],
        ids: &mut [u32],
    ) {
        self.cast::<Rays, true>(world, rays, pose, ranges, ids);
    }
}

impl Pattern for Rays {
    #[inline(always)]
    fn n_reading(&self) -> usize {
        self.n
    }

    #[inline(always)]
    fn n_tile(&self) -> usize {
        self.directions.len()
    }

    #[inline(always)]
    fn range(&self) -> RangeLimits {
        self.range
    }

    #[inline(always)]
    fn ground<L: Lanes>(&self, height: f32, up: [f32; 3], tiles: &mut [Tile]) {
        // along no ray is it nearer than below
        if height >= self.range.most as f32 {
            tiles.fill(Tile::missed(self.range.most as f32));
            return;
        }
        let (most, id) = (splat::<L>(self.range.most as f32), splat::<L>(ray_scene::number(GROUND)));
        let up = [splat::<L>(up[0]), splat(up[1]), splat(up[2])];
        for i in 0..self.directions.len() {
            let mut at = 0;
            while at < LANES {
                let t = splat::<L>(-height) / form(&self.directions[i], at, &up);
                let hit = L::zero().lt(t).and(t.lt(most));
                L::select(hit, t, most).store(&mut tiles[i].range[at..]);
                L::select(hit, id, splat(ray_scene::number(NOTHING))).store(&mut tiles[i].id[at..]);
                at += L::WIDTH;
            }
        }
    }

    #[inline(always)]
    fn directions<L: Lanes>(&self, tile: usize, at: usize) -> Vec3<L> {
        let packet = &self.directions[tile];
        [L::load(&packet[0][at..]), L::load(&packet[1][at..]), L::load(&packet[2][at..])]
    }

    #[inline(always)]
    fn direction_of(&self, tile: usize, lane: usize) -> [f32; 3] {
        let packet = &self.directions[tile];
        [packet[0][lane], packet[1][lane], packet[2][lane]]
    }

    #[inline(always)]
    fn put<L: Lanes, P: Piece, const ALL: bool>(&self, piece: &OnePiece<'_, L>, tiles: &mut [Tile], far: &mut [f32]) {
        let OnePiece { numbers, forms, id, near, .. } = piece;
        for group in 0..self.cones.len() {
            let mut open = [1.0; LANES];
            let mut at = 0;
            while !ALL && at < LANES {
                let cones = &self.cones[group];
                let middle =
                    [L::load(&cones.middle[0][at..]), L::load(&cones.middle[1][at..]), L::load(&cones.middle[2][at..])];
                let values = [dot(middle, forms[0]), dot(middle, forms[1]), dot(middle, forms[2])];
                P::reach(values, numbers, L::load(&cones.chord[at..])).store(&mut open[at..]);
                at += L::WIDTH;
            }
            for k in 0..LANES.min(self.directions.len() - group * LANES) {
                let i = group * LANES + k;
                if ALL || (open[k] > 0.0 && far[i] > *near) {
                    far[i] = try_packet::<L, P>(&self.directions[i], forms, numbers, *id, &mut tiles[i]);
                }
            }
        }
    }

    #[inline(always)]
    fn write(&self, tiles: &[Tile], ranges: &mut [f32], ids: &mut [u32]) {
        let (whole, last) = ranges.as_chunks_mut::<LANES>();
        let (whole_ids, last_ids) = ids.as_chunks_mut::<LANES>();
        for i in 0..whole.len() {
            whole[i] = tiles[i].range;
            for k in 0..LANES {
                whole_ids[i][k] = ray_scene::id(tiles[i].id[k]);
            }
        }
        for k in 0..last.len() {
            last[k] = tiles[whole.len()].range[k];
            last_ids[k] = ray_scene::id(tiles[whole.len()].id[k]);
        }
    }
}

/// A linear function of the directions of a packet.
#[inline(always)]
fn form<L: Lanes>(packet: &[Row; 3], at: usize, of: &Vec3<L>) -> L {
    let d = [L::load(&packet[0][at..]), L::load(&packet[1][at..]), L::load(&packet[2][at..])];
    dot(d, *of)
}

/// Tries a piece on sixteen rays; the farthest range then.
#[inline(always)]
fn try_packet<L: Lanes, P: Piece>(
    packet: &[Row; 3],
    forms: &[Vec3<L>; 3],
    numbers: &[L; N_NUMBER],
    id: L,
    tile: &mut Tile,
) -> f32 {
    let mut farthest = L::zero();
    let mut at = 0;
    while at < LANES {
        let values = [form(packet, at, &forms[0]), form(packet, at, &forms[1]), form(packet, at, &forms[2])];
        let (t, counts) = P::entry(values, numbers);
        farthest = farthest.max(nearer(tile, at, t, counts, id));
        at += L::WIDTH;
    }
    largest(farthest)
}
