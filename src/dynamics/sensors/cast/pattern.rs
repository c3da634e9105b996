//! What images and scans have in common: ground, solids nearest first, what is too near, readings.

use super::cull::{BOX, View};
use super::hit::{Ball, Cuboid, N_NUMBER, Piece, Side};
use super::pieces::PieceBlock;
use super::ray_scene::{self, LANES, NOTHING, RayScene};
use super::{Eye, RangeLimits, RayCaster, Tile, meshes, splat, uneven};
use crate::shape::Pose;
use crate::spatial::Vec3;
use autodiff::Mask;
use autodiff::lanes::{Kernel, Lanes, dispatch};
use autodiff::unrolled::unrolled;

/// Rays in tiles of sixteen, and what they read in their order.
pub(super) trait Pattern: View {
    /// How many readings.
    fn n_reading(&self) -> usize;
    /// How many tiles.
    fn n_tile(&self) -> usize;
    /// Of the readings.
    fn range(&self) -> RangeLimits;
    /// The plane below the eye: t = −h/d_z where that is ahead and in range.
    fn ground<L: Lanes>(&self, height: f32, up: [f32; 3], tiles: &mut [Tile]);
    /// Directions of rays `at` and behind of a tile, in the frame of the eye.
    fn directions<L: Lanes>(&self, tile: usize, at: usize) -> Vec3<L>;
    /// The direction of one ray of a tile.
    fn direction_of(&self, tile: usize, lane: usize) -> [f32; 3];
    /// Puts `piece` into all tiles that it can touch, or into all tiles with `ALL`.
    fn put<L: Lanes, P: Piece, const ALL: bool>(&self, piece: &OnePiece<'_, L>, tiles: &mut [Tile], far: &mut [f32]);
    /// From tiles to readings.
    fn write(&self, tiles: &[Tile], ranges: &mut [f32], ids: &mut [u32]);
}

/// One piece of a solid, in all lanes.
pub(super) struct OnePiece<'a, L> {
    pub block: &'a PieceBlock,
    pub lane: usize,
    pub numbers: [L; N_NUMBER],
    pub forms: [Vec3<L>; 3],
    pub id: L,
    /// Below all ranges that it gives.
    pub near: f32,
}

impl<'a, L: Lanes> OnePiece<'a, L> {
    /// Piece `lane` of a block.
    #[inline(always)]
    fn of(block: &'a PieceBlock, lane: usize, id: f32) -> Self {
        let (mut numbers, mut forms) = ([L::zero(); N_NUMBER], [[L::zero(); 3]; 3]);
        for k in 0..N_NUMBER {
            numbers[k] = splat(block.numbers[k][lane]);
        }
        unrolled!(i in 0..3 {
            unrolled!(k in 0..3 {
                forms[i][k] = splat(block.forms[i][k][lane]);
            });
        });
        Self { block, lane, numbers, forms, id: splat(id), near: block.near[lane] }
    }
}

impl RayCaster {
    /// Readings of a pattern from `pose`; with `ALL` by trying all solids on all rays.
    pub(super) fn cast<V: Pattern, const ALL: bool>(
        &mut self,
        world: &RayScene,
        pattern: &V,
        pose: &Pose<f64>,
        ranges: &mut [f32],
        ids: &mut [u32],
    ) {
        let n = pattern.n_reading();
        assert!(ranges.len() == n && ids.len() == n, "{} ranges, {} ids for {n} readings", ranges.len(), ids.len());
        match Eye::new(pose) {
            Some(eye) => dispatch(Cast::<V, ALL> { caster: self, world, pattern, eye: &eye, ranges, ids }),
            None => {
                ranges.fill(pattern.range().most as f32);
                ids.fill(NOTHING);
            }
        }
    }
}

struct Cast<'a, V, const ALL: bool> {
    caster: &'a mut RayCaster,
    world: &'a RayScene,
    pattern: &'a V,
    eye: &'a Eye,
    ranges: &'a mut [f32],
    ids: &'a mut [u32],
}

impl<V: Pattern, const ALL: bool> Kernel for Cast<'_, V, ALL> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { caster, world, pattern, eye, ranges, ids } = self;
        let (n, range) = (pattern.n_tile(), pattern.range());
        caster.prepare(n, range.most as f32);
        let RayCaster { kept, tiles, far, hills } = caster;
        let tiles = &mut tiles[..n];
        if world.relief.waves.is_empty() {
            match eye.above(world.ground, world.relief.slope) {
                Some((height, up)) => pattern.ground::<L>(height, up, tiles),
                None => tiles.fill(Tile::missed(range.most as f32)),
            }
        } else if hills.look(world, eye) {
            uneven::put::<L, V>(pattern, hills, tiles);
        } else {
            tiles.fill(Tile::missed(range.most as f32));
        }
        kept.look::<L, V, ALL>(world, eye, pattern);
        for k in 0..kept.order.len() {
            let order = kept.order[k];
            let i = (order & (BOX - 1)) as usize;
            let (block, lane) = (i / LANES, i % LANES);
            if order & BOX == 0 {
                let (pieces, id) = (&kept.capsule_pieces[block], kept.capsule_ids[i]);
                put::<L, V, Side, ALL>(pattern, &pieces[0], lane, id, tiles, far);
                put::<L, V, Ball, ALL>(pattern, &pieces[1], lane, id, tiles, far);
                put::<L, V, Ball, ALL>(pattern, &pieces[2], lane, id, tiles, far);
            } else {
                put::<L, V, Cuboid, ALL>(pattern, &kept.box_pieces[block], lane, kept.box_ids[i], tiles, far);
            }
        }
        for k in 0..world.meshes.len() {
            let mesh = &world.meshes[k];
            let near = meshes::nearness::<L, V, ALL>(pattern, mesh, eye);
            if near < f32::INFINITY {
                meshes::put::<V, ALL>(pattern, mesh, eye, near, tiles);
            }
        }
        if range.least > 0.0 {
            drop_near::<L>(range, tiles);
        }
        pattern.write(tiles, ranges, ids);
    }
}

#[inline(always)]
fn put<L: Lanes, V: Pattern, P: Piece, const ALL: bool>(
    pattern: &V,
    block: &PieceBlock,
    lane: usize,
    id: f32,
    tiles: &mut [Tile],
    far: &mut [f32],
) {
    if ALL || block.near[lane] < f32::INFINITY {
        pattern.put::<L, P, ALL>(&OnePiece::of(block, lane, id), tiles, far);
    }
}

/// Puts t and `id` where t counts and is nearer than what is there; the ranges then.
#[inline(always)]
pub(super) fn nearer<L: Lanes>(tile: &mut Tile, at: usize, t: L, counts: L::Mask, id: L) -> L {
    // neither has a sign to lose: of a choice between a number and what is in its place the compiler would make a masked store,
    // which takes longer than all the rest
    let (range, before) = (L::load(&tile.range[at..]).abs(), L::load(&tile.id[at..]).abs());
    let hit = counts.and(t.lt(range));
    let range = L::select(hit, t, range);
    range.store(&mut tile.range[at..]);
    L::select(hit, id, before).store(&mut tile.id[at..]);
    range
}

/// The largest lane of numbers ≥ 0.
#[inline(always)]
pub(super) fn largest<L: Lanes>(x: L) -> f32 {
    let mut lanes = [0.0; LANES];
    x.store(&mut lanes);
    let mut n = L::WIDTH;
    while n > 1 {
        n /= 2;
        for k in 0..n {
            lanes[k] = if lanes[k] < lanes[k + n] { lanes[k + n] } else { lanes[k] };
        }
    }
    lanes[0]
}

/// Makes misses of what is too near.
#[inline(always)]
pub(super) fn drop_near<L: Lanes>(range: RangeLimits, tiles: &mut [Tile]) {
    let (least, most) = (splat::<L>(range.least as f32), splat::<L>(range.most as f32));
    for i in 0..tiles.len() {
        let mut at = 0;
        while at < LANES {
            let (t, id) = (L::load(&tiles[i].range[at..]).abs(), L::load(&tiles[i].id[at..]).abs());
            let near = t.lt(least);
            L::select(near, most, t).store(&mut tiles[i].range[at..]);
            L::select(near, splat(ray_scene::number(NOTHING)), id).store(&mut tiles[i].id[at..]);
            at += L::WIDTH;
        }
    }
}
