//! Which solids an eye can see, nearest first.
//!
//! Two passes in lanes over solids. The first asks of all whether they reach into the view, by a few products each; those that do
//! are moved together, and the second computes their numbers for them alone.

use super::Eye;
use super::pieces::{Grid, PieceBlock, capsule, cuboid, load, seen, turned};
use super::ray_scene::{self, BoxBlock, CapsuleBlock, LANES, RayScene, Row};
use crate::spatial::Vec3;
use autodiff::lanes::Lanes;

const ZERO: Row = [0.0; LANES];

/// What an eye sees.
#[derive(Debug, Clone, Default)]
pub(super) struct Kept {
    keys: Vec<Row>,
    places: Vec<(u32, f32)>,
    capsules: Vec<CapsuleBlock>,
    boxes: Vec<BoxBlock>,
    /// Per block of capsules: side, ball at the base, ball at the other end.
    pub capsule_pieces: Vec<[PieceBlock; 3]>,
    pub capsule_ids: Vec<f32>,
    pub box_pieces: Vec<PieceBlock>,
    pub box_ids: Vec<f32>,
    /// Nearest first: bits of the nearness, then [`BOX`], then the place.
    pub order: Vec<u64>,
}

/// The bit of a box in the order.
pub(super) const BOX: u64 = 1 << 31;

/// What a view can see, solids being capsules in the eye's frame.
pub(super) trait View {
    /// (a number below all that it can measure of the solid, whether it can see any of it).
    fn reaches<L: Lanes>(&self, base: Vec3<L>, axis: Vec3<L>, length: L, radius: L) -> (L, L::Mask);
    /// The pixels of an image; `None` for rays of any directions.
    fn grid(&self) -> Option<&Grid>;
}

impl Kept {
    /// Finds what `view` sees of `world` from `eye`; with `ALL` all that there is, in the same order.
    #[inline(always)]
    pub(super) fn look<L: Lanes, V: View, const ALL: bool>(&mut self, world: &RayScene, eye: &Eye, view: &V) {
        self.make_room(world);
        for i in 0..world.capsules.blocks.len() {
            let block = &world.capsules.blocks[i];
            let mut at = 0;
            while at < LANES {
                let (base, axis) = (seen(eye, load::<L, 3>(&block.base, at)), turned(eye, load(&block.axis, at)));
                let (length, radius) = (L::load(&block.length[at..]), L::load(&block.radius[at..]));
                key::<L, V, ALL>(view, base, axis, length, radius).store(&mut self.keys[i][at..]);
                at += L::WIDTH;
            }
        }
        self.gather_capsules(world);
        for i in 0..self.capsule_ids.len().div_ceil(LANES) {
            let (mut at, n) = (0, self.capsule_ids.len() - i * LANES);
            while at < n.min(LANES) {
                capsule::<L>(&self.capsules[i], at, eye, view.grid(), &mut self.capsule_pieces[i]);
                at += L::WIDTH;
            }
        }
        for i in 0..world.boxes.blocks.len() {
            let block = &world.boxes.blocks[i];
            let mut at = 0;
            while at < LANES {
                let (center, reach) = (seen(eye, load::<L, 3>(&block.center, at)), L::load(&block.reach[at..]));
                let none = [L::zero(); 3];
                key::<L, V, ALL>(view, center, none, L::zero(), reach).store(&mut self.keys[i][at..]);
                at += L::WIDTH;
            }
        }
        self.gather_boxes(world);
        for i in 0..self.box_ids.len().div_ceil(LANES) {
            let (mut at, n) = (0, self.box_ids.len() - i * LANES);
            while at < n.min(LANES) {
                cuboid::<L>(&self.boxes[i], at, eye, view.grid(), &mut self.box_pieces[i]);
                at += L::WIDTH;
            }
        }
        self.order.sort_unstable();
    }

    /// For all solids of a world at once, so that what is seen of it later allocates nothing.
    fn make_room(&mut self, world: &RayScene) {
        let (capsules, boxes) = (&world.capsules.blocks, &world.boxes.blocks);
        grow(&mut self.keys, capsules, &ZERO);
        grow(&mut self.keys, boxes, &ZERO);
        grow(&mut self.capsules, capsules, &CapsuleBlock::EMPTY);
        grow(&mut self.capsule_pieces, capsules, &[PieceBlock::EMPTY; 3]);
        grow(&mut self.boxes, boxes, &BoxBlock::EMPTY);
        grow(&mut self.box_pieces, boxes, &PieceBlock::EMPTY);
        let n = self.keys.len() * LANES;
        if self.places.len() < n {
            self.places.resize(n, (0, 0.0));
        }
        self.order.clear();
        self.order.reserve(world.n_solid());
        self.capsule_ids.clear();
        self.capsule_ids.reserve(world.capsules.len());
        self.box_ids.clear();
        self.box_ids.reserve(world.boxes.len());
    }

    /// Places that are there without a further allocation.
    #[cfg(test)]
    pub(super) fn room(&self) -> [usize; 9] {
        [
            self.keys.capacity(),
            self.places.capacity(),
            self.capsules.capacity(),
            self.boxes.capacity(),
            self.capsule_pieces.capacity(),
            self.capsule_ids.capacity(),
            self.box_pieces.capacity(),
            self.box_ids.capacity(),
            self.order.capacity(),
        ]
    }

    /// Moves the capsules with a finite key together.
    #[inline(always)]
    fn gather_capsules(&mut self, world: &RayScene) {
        let n = places(&self.keys[..world.capsules.blocks.len()], &mut self.places);
        for i in 0..n {
            let (place, key) = self.places[i];
            let from = place as usize;
            self.capsules[i / LANES].copy(i % LANES, &world.capsules.blocks[from / LANES], from % LANES);
            self.capsule_ids.push(ray_scene::number(ray_scene::capsule_id(from)));
            self.order.push(u64::from(key.to_bits()) << 32 | i as u64);
        }
    }

    /// Likewise the boxes.
    #[inline(always)]
    fn gather_boxes(&mut self, world: &RayScene) {
        let n = places(&self.keys[..world.boxes.blocks.len()], &mut self.places);
        for i in 0..n {
            let (place, key) = self.places[i];
            let from = place as usize;
            self.boxes[i / LANES].copy(i % LANES, &world.boxes.blocks[from / LANES], from % LANES);
            self.box_ids.push(ray_scene::number(ray_scene::box_id(from)));
            self.order.push(u64::from(key.to_bits()) << 32 | BOX | i as u64);
        }
    }
}

/// How near solids are; ∞ where they are not kept.
#[inline(always)]
pub(super) fn key<L: Lanes, V: View, const ALL: bool>(
    view: &V,
    base: Vec3<L>,
    axis: Vec3<L>,
    length: L,
    radius: L,
) -> L {
    let (near, mut kept) = view.reaches(base, axis, length, radius);
    if ALL {
        kept = L::zero().lt(radius);
    }
    L::select(kept, near.max(L::zero()), L::constant(f64::INFINITY))
}

/// As many blocks as `like` has. What is there of earlier casts stays: lanes behind the last solid are computed and not looked at.
fn grow<B: Clone, C>(blocks: &mut Vec<B>, like: &[C], empty: &B) {
    if blocks.len() < like.len() {
        blocks.resize(like.len(), empty.clone());
    }
}

/// Places and keys of the solids that are kept, and how many.
#[inline(always)]
fn places(keys: &[Row], places: &mut [(u32, f32)]) -> usize {
    let mut n = 0;
    for i in 0..keys.len() {
        for lane in 0..LANES {
            // written in any case and taken back where it is not kept: there is nothing to foresee
            places[n] = ((i * LANES + lane) as u32, keys[i][lane]);
            n += usize::from(keys[i][lane] < f32::INFINITY);
        }
    }
    n
}
