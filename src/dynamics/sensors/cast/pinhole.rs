//! Depth images of a pinhole camera, a tile of 4×4 pixels at a time.
//!
//! Pixels look along (1, a, b): t is then the **planar depth** itself, and a form of `hit` costs one fused operation per pixel
//! once its part in b is known for the row. Solids are drawn nearest first into the tiles of their windows; a tile whose
//! farthest depth is nearer than a piece can be is left alone. Ground comes first: it is a quotient.

use super::cull::View;
use super::hit::Piece;
use super::pattern::{OnePiece, Pattern, largest, nearer};
use super::pieces::{Grid, PieceBlock, widened};
use super::ray_scene::{self, GROUND, LANES, NOTHING, RayScene, Row};
use super::{RangeLimits, RayCaster, Tile, fused, splat};
use crate::shape::Pose;
use crate::spatial::Vec3;
use autodiff::Mask;
use autodiff::lanes::Lanes;
use autodiff::unrolled::unrolled;
use base::error::{Error, Result, finite};

/// Most pixels of an image.
pub const MAX_PIXELS: usize = 1 << 22;
/// Pixels along the edge of a tile.
const SIDE: usize = 4;

/// A pinhole camera: looks along x of its frame, columns run to the right (−y), rows down (−z).
#[derive(Debug, Clone)]
pub struct PinholeCamera {
    width: usize,
    height: usize,
    range: RangeLimits,
    grid: Grid,
    /// Slopes of the pixels of a tile, by column and by row of tiles.
    left: Vec<Row>,
    up: Vec<Row>,
}

impl PinholeCamera {
    /// A camera of `width` × `height` square pixels whose outer edges are `field_of_view` (rad) apart from left to right: pixel
    /// (i, j) looks along (1, a, b), a = (1 − (2j + 1)/width) tan(½ `field_of_view`), b = (height − 2i − 1)/width · the same.
    ///
    /// # Errors
    /// [`Error::Limit`] for no pixels or more than 2²² (`MAX_PIXELS`); [`Error::Value`] for a field of view outside 10⁻³ … 3 rad, or
    /// whose tangent over the height exceeds 20; a range as [`RangeLimits::validate`] refuses.
    pub fn new(width: usize, height: usize, field_of_view: f64, range: RangeLimits) -> Result<Self> {
        range.validate("camera")?;
        let pixels = width.saturating_mul(height);
        if pixels == 0 || pixels > MAX_PIXELS {
            let remedy = "Take a smaller image, or several cameras.";
            return Err(Error::limit("camera: pixels", pixels, format!("1 to {MAX_PIXELS}"), remedy));
        }
        finite("camera: field_of_view", &[field_of_view])?;
        let half = (0.5 * field_of_view).tan();
        let tall = half * height as f64 / width as f64;
        if !(1e-3..=3.0).contains(&field_of_view) || tall > 20.0 {
            let limit = "within 0.001 to 3 rad, and such that its tangent times height/width stays below 20";
            let remedy = "A wider view takes several cameras, or rays.";
            return Err(Error::value("camera: field_of_view", field_of_view, limit, remedy));
        }
        let step = 2.0 * half / width as f64;
        let (left, top) = (half - 0.5 * step, tall - 0.5 * step);
        let (rows, columns) = (height.div_ceil(SIDE), width.div_ceil(SIDE));
        let slopes = |first: f64, k: usize| (first - k as f64 * step) as f32;
        // pixels of the last tiles that lie outside the image look where its sides do not hide them from the bounds
        let sides = [left - (SIDE * columns) as f64 * step, top - (SIDE * rows) as f64 * step];
        let side = [half.max(-sides[0]) as f32, tall.max(-sides[1]) as f32];
        let grid = Grid {
            left: left as f32,
            top: top as f32,
            step: step as f32,
            rows,
            columns,
            side,
            slant: side.map(|s| (1.0 + s * s).sqrt()),
        };
        let row = |first: f64, tile: usize, of: fn(usize) -> usize| {
            std::array::from_fn(|lane| slopes(first, SIDE * tile + of(lane)))
        };
        Ok(Self {
            width,
            height,
            range,
            grid,
            left: (0..columns).map(|c| row(left, c, |lane| lane % SIDE)).collect(),
            up: (0..rows).map(|r| row(top, r, |lane| lane / SIDE)).collect(),
        })
    }

    /// Columns and rows of the image.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Of its readings, in planar depth.
    pub fn range(&self) -> RangeLimits {
        self.range
    }

    /// Where pixel `index` (row by row) looks, in its frame; the forward part is 1.
    pub fn direction(&self, index: usize) -> Vec3<f64> {
        let (i, j) = (index / self.width, index % self.width);
        let (a, b) = (self.left[j / SIDE][j % SIDE], self.up[i / SIDE][i % SIDE * SIDE]);
        [1.0, f64::from(a), f64::from(b)]
    }
}

impl View for PinholeCamera {
    #[inline(always)]
    fn reaches<L: Lanes>(&self, base: Vec3<L>, axis: Vec3<L>, length: L, radius: L) -> (L, L::Mask) {
        let mut end = base;
        unrolled!(k in 0..3 {
            end[k] = fused(length, axis[k], base[k]);
        });
        let (r0, r1) = (widened(radius, base), widened(radius, end));
        let near = (base[0] - r0).min(end[0] - r1);
        let far = (base[0] + r0).max(end[0] + r1);
        let mut seen = near.lt(splat(self.range.most as f32)).and(L::zero().lt(far));
        unrolled!(k in 0..2 {
            let (side, slant) = (splat::<L>(-self.grid.side[k]), splat::<L>(-self.grid.slant[k]));
            // by how much either end is inside either side
            let (a, b) = (fused(side, base[0], slant * r0), fused(side, end[0], slant * r1));
            let left = (base[1 + k] + a).min(end[1 + k] + b);
            let right = (a - base[1 + k]).min(b - end[1 + k]);
            seen = seen.and(left.lt(L::zero())).and(right.lt(L::zero()));
        });
        (near, seen)
    }

    #[inline(always)]
    fn grid(&self) -> Option<&Grid> {
        Some(&self.grid)
    }
}

impl RayCaster {
    /// Planar depths (m) and ids of all pixels, row by row, as the camera at `pose` (its frame → world) sees `world`. From a
    /// pose that is not finite, all are misses.
    ///
    /// # Panics
    /// On slices of another length than width × height.
    pub fn image(
        &mut self,
        world: &RayScene,
        camera: &PinholeCamera,
        pose: &Pose<f64>,
        depth: &mut [f32],
        ids: &mut [u32],
    ) {
        self.cast::<PinholeCamera, false>(world, camera, pose, depth, ids);
    }

    /// The same by trying all solids at all pixels.
    #[cfg(test)]
    pub(crate) fn image_of_all(
        &mut self,
        world: &RayScene,
        camera: &PinholeCamera,
        pose: &Pose<f64>,
        depth: &mut [f32],
        ids: &mut [u32],
    ) {
        self.cast::<PinholeCamera, true>(world, camera, pose, depth, ids);
    }
}

impl Pattern for PinholeCamera {
    #[inline(always)]
    fn n_reading(&self) -> usize {
        self.width * self.height
    }

    #[inline(always)]
    fn n_tile(&self) -> usize {
        self.grid.rows * self.grid.columns
    }

    #[inline(always)]
    fn range(&self) -> RangeLimits {
        self.range
    }

    #[inline(always)]
    fn ground<L: Lanes>(&self, height: f32, up: [f32; 3], tiles: &mut [Tile]) {
        let (most, id) = (splat::<L>(self.range.most as f32), splat::<L>(ray_scene::number(GROUND)));
        let columns = self.grid.columns;
        for r in 0..self.grid.rows {
            let mut at = 0;
            while at < LANES {
                let rising = fused(L::load(&self.up[r][at..]), splat(up[2]), splat(up[0]));
                for c in 0..columns {
                    let tile = &mut tiles[r * columns + c];
                    let rising = fused(L::load(&self.left[c][at..]), splat(up[1]), rising);
                    let t = splat::<L>(-height) / rising;
                    let hit = L::zero().lt(t).and(t.lt(most));
                    L::select(hit, t, most).store(&mut tile.range[at..]);
                    L::select(hit, id, splat(ray_scene::number(NOTHING))).store(&mut tile.id[at..]);
                }
                at += L::WIDTH;
            }
        }
    }

    #[inline(always)]
    fn directions<L: Lanes>(&self, tile: usize, at: usize) -> Vec3<L> {
        let (row, column) = (tile / self.grid.columns, tile % self.grid.columns);
        [L::one(), L::load(&self.left[column][at..]), L::load(&self.up[row][at..])]
    }

    #[inline(always)]
    fn direction_of(&self, tile: usize, lane: usize) -> [f32; 3] {
        [1.0, self.left[tile % self.grid.columns][lane], self.up[tile / self.grid.columns][lane]]
    }

    #[inline(always)]
    fn put<L: Lanes, P: Piece, const ALL: bool>(&self, piece: &OnePiece<'_, L>, tiles: &mut [Tile], far: &mut [f32]) {
        let OnePiece { block, lane, numbers, forms, id, near } = piece;
        let columns = self.grid.columns;
        let mut rows = [block.window[0][*lane] as usize, block.window[2][*lane] as usize];
        if ALL {
            rows = [0, self.grid.rows];
        }
        for r in rows[0]..rows[1].min(self.grid.rows) {
            let (first, behind) = if ALL { (0, columns) } else { span(block, *lane, r) };
            let mut partial = [[0.0; LANES]; 3];
            let mut at = 0;
            while at < LANES {
                let up = L::load(&self.up[r][at..]);
                unrolled!(i in 0..3 {
                    fused(up, forms[i][2], forms[i][0]).store(&mut partial[i][at..]);
                });
                at += L::WIDTH;
            }
            for c in first..behind.min(columns) {
                let place = r * columns + c;
                if !ALL && far[place] <= *near {
                    continue;
                }
                let (tile, mut farthest) = (&mut tiles[place], L::zero());
                let mut at = 0;
                while at < LANES {
                    let left = L::load(&self.left[c][at..]);
                    let mut values = [L::zero(); 3];
                    unrolled!(i in 0..3 {
                        values[i] = fused(left, forms[i][1], L::load(&partial[i][at..]));
                    });
                    let (t, counts) = P::entry(values, numbers);
                    farthest = farthest.max(nearer(tile, at, t, counts, *id));
                    at += L::WIDTH;
                }
                far[place] = largest(farthest);
            }
        }
    }

    #[inline(always)]
    fn write(&self, tiles: &[Tile], depth: &mut [f32], ids: &mut [u32]) {
        let (width, whole) = (self.width, self.width / SIDE);
        for i in 0..self.height {
            let row = &tiles[i / SIDE * self.grid.columns..][..self.grid.columns];
            let from = i % SIDE * SIDE;
            let (depth, ids) = (&mut depth[i * width..][..width], &mut ids[i * width..][..width]);
            let (depths, last_depths) = depth.as_chunks_mut::<SIDE>();
            let (all_ids, last_ids) = ids.as_chunks_mut::<SIDE>();
            for c in 0..whole {
                for k in 0..SIDE {
                    depths[c][k] = row[c].range[from + k];
                    all_ids[c][k] = ray_scene::id(row[c].id[from + k]);
                }
            }
            for k in 0..last_depths.len() {
                last_depths[k] = row[whole].range[from + k];
                last_ids[k] = ray_scene::id(row[whole].id[from + k]);
            }
        }
    }
}

/// Columns of tiles in row `r` that piece `lane` can touch.
#[inline(always)]
fn span(block: &PieceBlock, lane: usize, r: usize) -> (usize, usize) {
    let (row, edges) = (r as f32, &block.edges);
    let edge = |k: usize| row * edges[k + 1][lane] + edges[k][lane];
    let low = block.window[1][lane].max(edge(0)).max(edge(2));
    let high = block.window[3][lane].min(edge(4)).min(edge(6));
    (low as usize, high as usize)
}
