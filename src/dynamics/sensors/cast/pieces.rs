//! The numbers of solids in the frame of an eye: what `hit` needs, and which tiles of an image they can touch.
//!
//! A window bounds a piece by the tangents of its two end balls, above, below and at the sides; the side of a capsule is bounded
//! in every row of tiles by the two planes through the eye that touch it, too. Bounds are wider than roundings by [`SLACK`] of
//! the distance and a hundredth of a pixel.

use super::hit::N_NUMBER;
use super::ray_scene::{BoxBlock, CapsuleBlock, LANES, Row};
use super::{Eye, dot, fused, splat};
use crate::spatial::Vec3;
use autodiff::Mask;
use autodiff::lanes::Lanes;
use autodiff::unrolled::unrolled;

/// Roundings of a position in the eye's frame, relative to its distance; 2⁻²³ is 1.2e-7, and some ten of them add up.
const SLACK: f64 = 4e-6;

const ZERO: Row = [0.0; LANES];

/// Pieces of sixteen solids.
#[derive(Debug, Clone)]
pub(super) struct PieceBlock {
    /// Coefficients of the three forms along forward, left and up.
    pub forms: [[Row; 3]; 3],
    /// As `hit` says for each kind.
    pub numbers: [Row; N_NUMBER],
    /// No entry is nearer; ∞ where the piece cannot be seen.
    pub near: Row,
    /// First row and column of tiles that it can touch, then those behind the last: their whole parts count.
    pub window: [Row; 4],
    /// In row k of tiles, columns begin at the larger of `edges[0] + k edges[1]` and `edges[2] + k edges[3]` and end before
    /// the smaller of `edges[4] + k edges[5]` and `edges[6] + k edges[7]`.
    pub edges: [Row; 8],
}

/// More tiles than any image has.
const ALL_TILES: Row = [1e9; LANES];

impl PieceBlock {
    pub(super) const EMPTY: Self = Self {
        forms: [[ZERO; 3]; 3],
        numbers: [ZERO; N_NUMBER],
        near: ZERO,
        window: [ZERO; 4],
        // only sides of capsules have any
        edges: [ZERO, ZERO, ZERO, ZERO, ALL_TILES, ZERO, ALL_TILES, ZERO],
    };
}

/// Pixels as slopes: column j of row i looks along (1, left − j step, top − i step).
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    pub left: f32,
    pub top: f32,
    pub step: f32,
    /// Of tiles.
    pub rows: usize,
    /// Of tiles.
    pub columns: usize,
    /// Slopes of the sides of the picture.
    pub side: [f32; 2],
    /// √(1 + side²).
    pub slant: [f32; 2],
}

impl Grid {
    /// Whether a ball of this centre and radius lies wholly outside one side of the picture.
    #[inline(always)]
    pub(super) fn outside<L: Lanes>(&self, center: Vec3<L>, radius: L) -> L::Mask {
        let mut out = (center[0] + radius).lt(L::zero());
        unrolled!(k in 0..2 {
            let beyond = fused(splat(-self.side[k]), center[0], center[1 + k].abs());
            out = out.or((radius * splat(self.slant[k])).lt(beyond));
        });
        out
    }
}

/// One register of each of these rows.
#[inline(always)]
pub(super) fn load<L: Lanes, const N: usize>(rows: &[Row; N], at: usize) -> [L; N] {
    let mut all = [L::zero(); N];
    for k in 0..N {
        all[k] = L::load(&rows[k][at..]);
    }
    all
}

/// A direction of the world in the eye's frame.
#[inline(always)]
pub(super) fn turned<L: Lanes>(eye: &Eye, v: Vec3<L>) -> Vec3<L> {
    let mut out = [L::zero(); 3];
    unrolled!(k in 0..3 {
        let axis = [splat(eye.axes[k][0]), splat(eye.axes[k][1]), splat(eye.axes[k][2])];
        out[k] = dot(axis, v);
    });
    out
}

/// A point of the world in the eye's frame.
#[inline(always)]
pub(super) fn seen<L: Lanes>(eye: &Eye, p: Vec3<L>) -> Vec3<L> {
    let mut from = [L::zero(); 3];
    unrolled!(k in 0..3 {
        from[k] = p[k] - splat(eye.position[k]);
    });
    turned(eye, from)
}

/// v + s u.
#[inline(always)]
fn along<L: Lanes>(v: Vec3<L>, s: L, u: Vec3<L>) -> Vec3<L> {
    [fused(s, u[0], v[0]), fused(s, u[1], v[1]), fused(s, u[2], v[2])]
}

/// ‖v‖.
#[inline(always)]
fn length<L: Lanes>(v: Vec3<L>) -> L {
    dot(v, v).sqrt()
}

/// `radius` and the roundings of `center`.
#[inline(always)]
pub(super) fn widened<L: Lanes>(radius: L, center: Vec3<L>) -> L {
    let size = center[0].abs() + center[1].abs() + center[2].abs();
    fused(splat(SLACK as f32), size + radius, radius)
}

/// One register of a piece, into its block.
#[inline(always)]
fn write<L: Lanes>(out: &mut PieceBlock, at: usize, forms: &[Vec3<L>; 3], numbers: &[L], near: L) {
    unrolled!(i in 0..3 {
        unrolled!(k in 0..3 {
            forms[i][k].store(&mut out.forms[i][k][at..]);
        });
    });
    for k in 0..numbers.len() {
        numbers[k].store(&mut out.numbers[k][at..]);
    }
    near.store(&mut out.near[at..]);
}

/// Least and largest slope, to the left and up.
#[derive(Clone, Copy)]
struct Slopes<L> {
    low: [L; 2],
    high: [L; 2],
}

/// Slopes of the tangents of a ball more than its radius ahead of the eye: roots of (x² − r²) s² − 2 x y s + y² − r² = 0.
#[inline(always)]
fn tangents<L: Lanes>(center: Vec3<L>, radius: L) -> Slopes<L> {
    let inverse = ((center[0] - radius) * (center[0] + radius)).recip();
    let mut s = Slopes { low: [L::zero(); 2], high: [L::zero(); 2] };
    unrolled!(k in 0..2 {
        let y = center[1 + k];
        let root = fused(center[0], center[0], fused(y, y, -(radius * radius))).max(L::zero()).sqrt();
        let (middle, half) = (center[0] * y * inverse, radius * root * inverse);
        s.low[k] = middle - half;
        s.high[k] = middle + half;
    });
    s
}

/// What a ball covers: its tangents; anything where it is beside the eye; nothing beyond the sides of the picture.
#[inline(always)]
fn covered<L: Lanes>(grid: &Grid, center: Vec3<L>, radius: L) -> Slopes<L> {
    let mut s = tangents(center, radius);
    let (ahead, out) = (radius.lt(center[0]), grid.outside(center, radius));
    let wide = L::constant(WIDE);
    unrolled!(k in 0..2 {
        s.low[k] = L::select(out, wide, L::select(ahead, s.low[k], -wide));
        s.high[k] = L::select(out, -wide, L::select(ahead, s.high[k], wide));
    });
    s
}

/// A slope that no picture has.
const WIDE: f64 = 1e6;

/// Writes the tiles between slopes.
#[inline(always)]
fn write_window<L: Lanes>(out: &mut PieceBlock, at: usize, grid: &Grid, slopes: Slopes<L>) {
    let per_tile = 0.25 / grid.step;
    let first = [grid.top, grid.left];
    let count = [grid.rows, grid.columns];
    unrolled!(k in 0..2 {
        let (from, to) = (slopes.high[1 - k], slopes.low[1 - k]);
        // in tiles; the first pixel at or behind a place is its place rounded up, the last one is rounded down
        let start = splat::<L>(first[k] * per_tile);
        let low = fused(from, splat(-per_tile), start + L::constant(0.25 * (1.0 - PIXEL)));
        let high = fused(to, splat(-per_tile), start + L::constant(1.0 + 0.25 * PIXEL));
        let last = L::constant(count[k] as f64);
        low.max(L::zero()).min(last).store(&mut out.window[k][at..]);
        high.max(L::zero()).min(last).store(&mut out.window[2 + k][at..]);
    });
}

/// By how much of a pixel bounds are widened.
const PIXEL: f64 = 0.01;

/// The three pieces of capsules.
#[inline(always)]
pub(super) fn capsule<L: Lanes>(
    block: &CapsuleBlock,
    at: usize,
    eye: &Eye,
    grid: Option<&Grid>,
    out: &mut [PieceBlock; 3],
) {
    let (zero, none) = (L::zero(), L::constant(f64::INFINITY));
    let (w, u) = (seen(eye, load::<L, 3>(&block.base, at)), turned(eye, load(&block.axis, at)));
    let (long, radius) = (L::load(&block.length[at..]), L::load(&block.radius[at..]));
    let end = along(w, long, u);
    let height = -dot(w, u);
    let nearest = along(w, height.max(zero).min(long), u);
    let visible = radius.lt(length(nearest));
    let n = along(w, height, u);
    let rho = length(n);
    let gap = (rho - radius) * (rho + radius);
    let inverse = rho.max(L::constant(1e-12)).recip();
    let v = scaled(inverse, n);
    let root = gap.max(zero).sqrt();
    let forms = [scaled(radius, v), scaled(root, cross(u, v)), u];
    let half = L::constant(0.5) * long;
    let side = visible.and(zero.lt(gap)).and(zero.lt(long));
    let (r0, r1) = (widened(radius, w), widened(radius, end));
    let near = (w[0] - r0).min(end[0] - r1);
    let near = if grid.is_some() { near } else { length(nearest) - r0.max(r1) };
    let unseen = L::constant(f64::NAN);
    let numbers = [rho / radius, L::select(side, gap, unseen), height - half, half, rho];
    write(&mut out[0], at, &forms, &numbers, L::select(side, near, none));
    ball(w, radius, visible, at, grid.is_some(), &mut out[1]);
    ball(end, radius, visible.and(zero.lt(long)), at, grid.is_some(), &mut out[2]);
    if let Some(grid) = grid {
        write_windows(out, at, grid, [(w, r0), (end, r1)]);
        write_edges(&mut out[0], at, grid, &forms, rho);
    }
}

/// The windows of the three pieces of capsules, from their two balls.
#[inline(always)]
fn write_windows<L: Lanes>(out: &mut [PieceBlock; 3], at: usize, grid: &Grid, balls: [(Vec3<L>, L); 2]) {
    let [(a, r0), (b, r1)] = balls;
    write_window(&mut out[1], at, grid, covered(grid, a, r0));
    write_window(&mut out[2], at, grid, covered(grid, b, r1));
    // with an end beside the eye or behind it, the side may be anywhere
    let ahead = r0.lt(a[0]).and(r1.lt(b[0]));
    let (mut all, other) = (tangents(a, r0), tangents(b, r1));
    unrolled!(k in 0..2 {
        all.low[k] = L::select(ahead, all.low[k].min(other.low[k]), L::constant(-WIDE));
        all.high[k] = L::select(ahead, all.high[k].max(other.high[k]), L::constant(WIDE));
    });
    write_window(&mut out[0], at, grid, all);
}

/// One end of a capsule: the ball about `center`.
#[inline(always)]
fn ball<L: Lanes>(center: Vec3<L>, radius: L, visible: L::Mask, at: usize, image: bool, out: &mut PieceBlock) {
    let (rho, zero) = (length(center), L::zero());
    let gap = (rho - radius) * (rho + radius);
    let inverse = rho.max(L::constant(1e-12)).recip();
    let v = scaled(inverse, center);
    let (a, b) = across(v);
    let root = gap.max(L::zero()).sqrt();
    let visible = visible.and(L::zero().lt(gap));
    let gap = L::select(visible, gap, L::constant(f64::NAN));
    let reach = widened(radius, center);
    let near = if image { center[0] - reach } else { rho - reach };
    let near = L::select(visible, near, L::constant(f64::INFINITY));
    write(out, at, &[scaled(radius, v), scaled(root, a), scaled(root, b)], &[rho / radius, gap, zero, zero, rho], near);
}

/// Two unit vectors across a unit vector and each other (Duff et al. 2017, about x).
#[inline(always)]
fn across<L: Lanes>(v: Vec3<L>) -> (Vec3<L>, Vec3<L>) {
    let one = L::one();
    let sign = L::select(v[0].lt(L::zero()), -one, one);
    let a = -(sign + v[0]).recip();
    let b = v[1] * v[2] * a;
    let first = [-(sign * v[1]), fused(sign * v[1] * v[1], a, one), sign * b];
    let second = [-v[2], b, fused(v[2] * v[2], a, sign)];
    (first, second)
}

#[inline(always)]
fn scaled<L: Lanes>(s: L, v: Vec3<L>) -> Vec3<L> {
    [s * v[0], s * v[1], s * v[2]]
}

#[inline(always)]
fn cross<L: Lanes>(a: Vec3<L>, b: Vec3<L>) -> Vec3<L> {
    let mut out = [L::zero(); 3];
    unrolled!(k in 0..3 {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        out[k] = fused(a[i], b[j], -(a[j] * b[i]));
    });
    out
}

/// Columns of each row of tiles within the planes p − q = 0 and p + q = 0 that touch the side of a capsule: e = p ± q is linear
/// in column and row of a pixel and positive inside.
#[inline(always)]
fn write_edges<L: Lanes>(out: &mut PieceBlock, at: usize, grid: &Grid, forms: &[Vec3<L>; 3], rho: L) {
    let (zero, step) = (L::zero(), splat::<L>(grid.step));
    let reach = splat::<L>(1.0 + grid.side[0] + grid.side[1]);
    unrolled!(i in 0..2 {
        let mut e = [zero; 3];
        unrolled!(k in 0..3 {
            e[k] = if i == 0 { forms[0][k] - forms[1][k] } else { forms[0][k] + forms[1][k] };
        });
        let first = fused(splat(grid.left), e[1], fused(splat(grid.top), e[2], e[0]));
        let (column, row) = (-(step * e[1]), -(step * e[2]));
        // the most that it is in the four rows of a tile, and what rounds
        let lift = L::constant(1.5) * row;
        let most = first + lift + lift.abs() + L::constant(SLACK) * rho * reach;
        // where it hardly changes along a row of pixels, it bounds nothing
        let steep = (L::constant(1e-4) * rho).lt(column.abs());
        let inverse = -column.recip();
        let (place, per_row) = (most * inverse, row * inverse);
        let (begins, ends) = (steep.and(zero.lt(column)), steep.and(column.lt(zero)));
        let quarter = L::constant(0.25);
        let low = fused(quarter, place, L::constant(0.25 * (1.0 - PIXEL)));
        let high = fused(quarter, place, L::constant(1.0 + 0.25 * PIXEL));
        L::select(begins, low, zero).store(&mut out.edges[2 * i][at..]);
        L::select(begins, per_row, zero).store(&mut out.edges[2 * i + 1][at..]);
        L::select(ends, high, L::constant(grid.columns as f64)).store(&mut out.edges[4 + 2 * i][at..]);
        L::select(ends, per_row, zero).store(&mut out.edges[4 + 2 * i + 1][at..]);
    });
}

/// Boxes.
#[inline(always)]
pub(super) fn cuboid<L: Lanes>(block: &BoxBlock, at: usize, eye: &Eye, grid: Option<&Grid>, out: &mut PieceBlock) {
    let (zero, none) = (L::zero(), L::constant(f64::INFINITY));
    let w = seen(eye, load::<L, 3>(&block.center, at));
    let half = load::<L, 3>(&block.half, at);
    let (mut forms, mut numbers) = ([[zero; 3]; 3], [zero; N_NUMBER]);
    let mut gap = L::constant(-1e30);
    unrolled!(k in 0..3 {
        forms[k] = turned(eye, load(&block.axes[k], at));
        let middle = dot(w, forms[k]);
        numbers[k] = middle - half[k];
        numbers[3 + k] = middle + half[k];
        gap = gap.max(middle.abs() - half[k]);
    });
    let visible = zero.lt(gap);
    let unseen = L::select(visible, zero, L::constant(f64::NAN));
    for k in 0..N_NUMBER {
        numbers[k] += unseen;
    }
    let slack = widened(zero, w) + L::constant(SLACK) * L::load(&block.reach[at..]);
    let Some(grid) = grid else {
        write(out, at, &forms, &numbers, L::select(visible, gap - slack, none));
        return;
    };
    let (mut nearest, mut low, mut high) = (none, [none; 2], [-none; 2]);
    for corner in 0..8 {
        let mut p = w;
        unrolled!(k in 0..3 {
            let edge = if corner >> k & 1 == 0 { half[k] } else { -half[k] };
            p = along(p, edge, forms[k]);
        });
        nearest = nearest.min(p[0]);
        let inverse = p[0].recip();
        unrolled!(k in 0..2 {
            let slope = p[1 + k] * inverse;
            let wide = slack * inverse * (L::one() + slope.abs());
            low[k] = low[k].min(slope - wide);
            high[k] = high[k].max(slope + wide);
        });
    }
    write(out, at, &forms, &numbers, L::select(visible, nearest - slack, none));
    let ahead = (slack + slack).lt(nearest);
    unrolled!(k in 0..2 {
        low[k] = L::select(ahead, low[k], L::constant(-WIDE));
        high[k] = L::select(ahead, high[k], L::constant(WIDE));
    });
    write_window(out, at, grid, Slopes { low, high });
}
