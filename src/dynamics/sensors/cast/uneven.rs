//! Rays at hills: the first zero of how high a ray is above a slope with waves.
//!
//! Along a ray t d that height is f(t) = c + g·d t − Σ a sin(φ + κ t), κ = k·d. As |f″| ≤ M = Σ |a| κ² and f′ ≥ g·d − D with
//! D = Σ |a κ|, no zero is nearer than
//!
//! ```text
//! f/(D − g·d)                            from the steepest slope, and
//! 2f/(√(f′² + 2 M f) − f′)               from the largest curvature
//! ```
//!
//! ahead. A ray goes on by the larger of the two until that is no more than [`CLOSE`]: it never passes the first zero, and near
//! it the second is a step of Newton's. Rays begin where they sink below the highest crest there can be, and end where they rise above it.

use super::pattern::Pattern;
use super::ray_scene::{self, GROUND, LANES, NOTHING, RayScene};
use super::{Eye, Tile, dot, fused, splat};
use crate::spatial::Vec3;
use autodiff::Mask;
use autodiff::lanes::Lanes;

/// A step of less than this times 1 + t ends the march, m.
const CLOSE: f64 = 1e-5;
/// After so many steps a ray that skims over crests is a miss. Of 20 000 rays over hills none took more than 22.
const MOST_STEPS: usize = 2000;

/// Uneven ground about an eye.
#[derive(Debug, Clone, Default)]
pub(super) struct Hills {
    /// c: of the eye above the slope, m.
    height: f32,
    /// g, along the axes of the eye.
    rising: [f32; 3],
    /// Σ |a|, m.
    crest: f32,
    waves: Vec<Swell>,
}

/// One wave about an eye.
#[derive(Debug, Clone, Copy)]
struct Swell {
    /// m.
    amplitude: f32,
    /// k along the axes of the eye, rad/m.
    number: [f32; 3],
    /// At the eye, rad.
    phase: f32,
}

impl Hills {
    /// The ground of a world from `eye`; false where there is none, or the eye is not above it.
    pub(super) fn look(&mut self, world: &RayScene, eye: &Eye) -> bool {
        let Some(ground) = world.ground.map(f64::from) else { return false };
        let (relief, [x, y, z]) = (&world.relief, eye.position.map(f64::from));
        let [sx, sy] = relief.slope;
        self.height = (z - ground - sx * x - sy * y) as f32;
        self.rising = eye.along([-sx, -sy, 1.0]);
        self.crest = relief.waves.iter().map(|wave| wave.amplitude.abs()).sum::<f64>() as f32;
        self.waves.clear();
        self.waves.extend(relief.waves.iter().map(|wave| {
            let [kx, ky] = wave.number;
            let phase = (kx * x + ky * y + wave.phase) % std::f64::consts::TAU;
            Swell { amplitude: wave.amplitude as f32, number: eye.along([kx, ky, 0.0]), phase: phase as f32 }
        }));
        relief.surface([x, y, z], ground).0 > 0.0
    }
}

/// Ranges and ids of the ground in all tiles.
#[inline(always)]
pub(super) fn put<L: Lanes, V: Pattern>(pattern: &V, hills: &Hills, tiles: &mut [Tile]) {
    let most = splat::<L>(pattern.range().most as f32);
    let (ground, nothing) = (splat::<L>(ray_scene::number(GROUND)), splat::<L>(ray_scene::number(NOTHING)));
    for i in 0..tiles.len() {
        let mut at = 0;
        while at < LANES {
            let t = march::<L>(hills, pattern.directions(i, at), most);
            let hit = t.lt(most);
            L::select(hit, t, most).store(&mut tiles[i].range[at..]);
            L::select(hit, ground, nothing).store(&mut tiles[i].id[at..]);
            at += L::WIDTH;
        }
    }
}

/// Where rays meet the ground first; `most` or more where they do not before.
#[inline(always)]
fn march<L: Lanes>(hills: &Hills, d: Vec3<L>, most: L) -> L {
    let (zero, none) = (L::zero(), L::constant(f64::INFINITY));
    let (height, crest) = (splat::<L>(hills.height), splat::<L>(hills.crest));
    let linear = dot(d, [splat(hills.rising[0]), splat(hills.rising[1]), splat(hills.rising[2])]);
    let (steep, bend) = bounds::<L>(hills, d);
    let fall = (steep - linear).max(L::constant(1e-12));
    let sinks = linear.lt(zero);
    let above = (height - crest) / (-linear).max(L::constant(1e-12));
    let mut t = L::select(crest.lt(height), L::select(sinks, above, none), zero);
    let mut met = none;
    let mut steps = 0;
    while steps < MOST_STEPS && any_below(t, most) {
        let (f, slope) = height_over::<L>(hills, d, t, linear);
        let root = fused(slope, slope, L::constant(2.0) * bend * f.max(zero)).sqrt();
        // the same step in two forms, of which neither is a difference of near numbers
        let rising = (slope + root) / bend;
        let falling = (f + f) / (root - slope);
        let step = L::select(zero.lt(slope), rising, falling).max(f / fall);
        let under = f.lt(L::constant(1e-30));
        let close = under.or(step.lt(fused(L::constant(CLOSE), t, L::constant(CLOSE))));
        let here = t.lt(most).and(close);
        met = L::select(here, L::select(under, t, t + step), met);
        let gone = zero.lt(linear).and(crest.lt(fused(t, linear, height)));
        t = L::select(close.or(gone), none, t + step);
        steps += 1;
    }
    met
}

/// D and M.
#[inline(always)]
fn bounds<L: Lanes>(hills: &Hills, d: Vec3<L>) -> (L, L) {
    let (mut steep, mut bend) = (L::zero(), L::constant(1e-12));
    for i in 0..hills.waves.len() {
        let wave = hills.waves[i];
        let turn = turning(&wave, d).abs();
        let slope = splat::<L>(wave.amplitude.abs()) * turn;
        steep += slope;
        bend = fused(slope, turn, bend);
    }
    // and what rounds
    (steep * L::constant(1.000_01), bend * L::constant(1.000_01))
}

/// κ.
#[inline(always)]
fn turning<L: Lanes>(wave: &Swell, d: Vec3<L>) -> L {
    dot(d, [splat(wave.number[0]), splat(wave.number[1]), splat(wave.number[2])])
}

/// f and f′.
#[inline(always)]
fn height_over<L: Lanes>(hills: &Hills, d: Vec3<L>, t: L, linear: L) -> (L, L) {
    let (mut f, mut slope) = (fused(t, linear, splat(hills.height)), linear);
    for i in 0..hills.waves.len() {
        let wave = hills.waves[i];
        let turn = turning(&wave, d);
        let (sin, cos) = sin_cos(fused(turn, t, splat(wave.phase)));
        let down = splat::<L>(-wave.amplitude);
        f = fused(down, sin, f);
        slope = fused(down * turn, cos, slope);
    }
    (f, slope)
}

/// As [`Scalar::sin_cos`](autodiff::Scalar::sin_cos) of lanes, with the same bits in one lane: π/2 is taken off in two parts, then one
/// polynomial for each, and the quadrant picks and signs them. Within 10⁻⁷ for |x| < 10⁶.
#[inline(always)]
fn sin_cos<L: Lanes>(x: L) -> (L, L) {
    let c = L::constant;
    // 1.5 · 2²³ leaves no place for what is behind the point
    let shifted = fused(x, c(std::f64::consts::FRAC_2_PI), c(12_582_912.0));
    let k = shifted - c(12_582_912.0);
    let r = fused(-k, c(1.570_796_370_506_286_6), x);
    let r = fused(-k, c(-4.371_139_000_186_241e-8), r);
    let z = r * r;
    let s = fused(z, fused(z, c(-1.951_529_589_1e-4), c(8.332_160_873_6e-3)), c(-1.666_665_461_1e-1));
    let s = fused(r * z, s, r);
    let q = fused(z, fused(z, c(2.443_315_711_809_948e-5), c(-1.388_731_625_493_765e-3)), c(4.166_664_568_298_827e-2));
    let q = fused(z * z, q, fused(-z, c(0.5), c(1.0)));
    // k mod 4 as −2, −1, 0, 1 or 2
    let quarter = fused(k, c(0.25), c(12_582_912.0)) - c(12_582_912.0);
    let quadrant = fused(quarter, c(-4.0), k);
    let distance = quadrant.abs();
    let odd = c(0.5).lt(distance).and(distance.lt(c(1.5)));
    let opposite = c(1.5).lt(distance);
    let (sine, cosine) = (L::select(odd, q, s), L::select(odd, s, q));
    let sine_negative = opposite.or(quadrant.lt(c(-0.5)));
    let cosine_negative = opposite.or(c(0.5).lt(quadrant));
    (L::select(sine_negative, -sine, sine), L::select(cosine_negative, -cosine, cosine))
}

/// Whether a lane of `t` is below that of `most`.
#[inline(always)]
fn any_below<L: Lanes>(t: L, most: L) -> bool {
    let mut lanes = [0.0; LANES];
    L::select(t.lt(most), L::one(), L::zero()).store(&mut lanes);
    let mut some = 0.0_f32;
    for k in 0..L::WIDTH {
        some += lanes[k];
    }
    some > 0.0
}
