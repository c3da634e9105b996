//! Where a ray enters a solid, from three functions of its direction that are linear in it.
//!
//! Let w lead from the eye to a point on the axis u of an infinite cylinder of radius r, n be the part of w across u, ρ = ‖n‖,
//! c = ρ² − r² = (ρ − r)(ρ + r) > 0 outside, v = n/ρ and b = u × v. A ray t d meets the cylinder where
//!
//! ```text
//! (d_v² + d_b²) t² − 2 ρ d_v t + c = 0        disc/4 = ρ² d_v² − (d_v² + d_b²) c = (r d_v)² − (√c d_b)² = p² − q²
//! t = c / (ρ d_v + √(p² − q²))                the nearer root, without a difference of near numbers
//! ```
//!
//! p = ±q are the two planes through the eye that touch the cylinder. A sphere has the same form with v towards its centre and
//! p² − q² − s², where q and s belong to the two directions across v. The textbook's B² − A C loses the silhouette of a thin
//! rod far away to rounding: p and q are exact to 10⁻⁷ of the distance.
//!
//! The surface of a capsule is the cylinder between its ends and two whole balls: the nearest entry into the three is that into
//! the capsule, for an eye outside, as all are convex and the seams lie inside.
//!
//! A root of a negative number is no number, and every comparison with it fails: rays that miss need no test of their own.

use super::fused;
use autodiff::Mask;
use autodiff::lanes::Lanes;
use autodiff::unrolled::unrolled;

/// Numbers of a piece beside its three forms.
pub(super) const N_NUMBER: usize = 6;

/// A convex piece of a solid.
pub(super) trait Piece {
    /// (t, whether it counts), from the three forms of directions d and the numbers of the piece. t may be no number.
    fn entry<L: Lanes>(forms: [L; 3], numbers: &[L; N_NUMBER]) -> (L, L::Mask);

    /// Above zero where a direction no farther than `chord` from the unit vector of these forms may enter the piece.
    fn reach<L: Lanes>(forms: [L; 3], numbers: &[L; N_NUMBER], chord: L) -> L;
}

/// Directions that enter a ball or the side of a capsule have p − ‖(q, s)‖ > 0, the least of forms d·e with ‖e‖ = √(r² + c) = ρ:
/// along `chord` it changes by no more than `chord` ρ. ρ stands in the fifth number.
#[inline(always)]
fn within<L: Lanes>(p: L, across: L, rho: L, chord: L) -> L {
    let most = fused(chord, rho, p);
    L::select(L::zero().lt(most), fused(most, most, -across), -L::one())
}

/// The round side of a capsule. Forms p, q and d·u; numbers ρ/r, c, height of the eye above
/// the middle, half the length, ρ.
pub(super) struct Side;

impl Piece for Side {
    #[inline(always)]
    fn entry<L: Lanes>([p, q, along]: [L; 3], numbers: &[L; N_NUMBER]) -> (L, L::Mask) {
        let root = fused(p, p, -(q * q)).sqrt();
        let t = numbers[1] / fused(numbers[0], p, root);
        let height = fused(t, along, numbers[2]).abs();
        (t, height.lt(numbers[3]).and(L::zero().lt(t)))
    }

    #[inline(always)]
    fn reach<L: Lanes>([p, q, _]: [L; 3], numbers: &[L; N_NUMBER], chord: L) -> L {
        within(p, q * q, numbers[4], chord)
    }
}

/// A ball. Forms p, q and s; numbers ρ/r, c; the fifth is ρ.
pub(super) struct Ball;

impl Piece for Ball {
    #[inline(always)]
    fn entry<L: Lanes>([p, q, s]: [L; 3], numbers: &[L; N_NUMBER]) -> (L, L::Mask) {
        let root = fused(p, p, -fused(q, q, s * s)).sqrt();
        let t = numbers[1] / fused(numbers[0], p, root);
        (t, L::zero().lt(t))
    }

    #[inline(always)]
    fn reach<L: Lanes>([p, q, s]: [L; 3], numbers: &[L; N_NUMBER], chord: L) -> L {
        within(p, fused(q, q, s * s), numbers[4], chord)
    }
}

/// A box, by slabs (Kay and Kajiya 1986). Forms: the direction along its axes; numbers: where its faces lie along them from the
/// eye, lower three, then upper three.
pub(super) struct Cuboid;

impl Piece for Cuboid {
    #[inline(always)]
    fn entry<L: Lanes>(forms: [L; 3], numbers: &[L; N_NUMBER]) -> (L, L::Mask) {
        let mut entry = L::constant(-1e30);
        let mut exit = L::constant(1e30);
        unrolled!(k in 0..3 {
            // a ray along a slab stays inside it or outside it, never between 0 and ∞ of 0 times ∞
            let d = L::select(forms[k].abs().lt(L::constant(TINY)), L::constant(TINY), forms[k]);
            let inverse = d.recip();
            let (a, b) = (numbers[k] * inverse, numbers[3 + k] * inverse);
            let flipped = b.lt(a);
            entry = entry.max(L::select(flipped, b, a));
            exit = exit.min(L::select(flipped, a, b));
        });
        (entry, entry.lt(exit).and(L::zero().lt(entry)))
    }

    /// The box within a ball: a ray passes its centre w by √(w² − (w·d)²), or by ‖w‖ where it points away, and `chord` ‖w‖ more
    /// or less.
    #[inline(always)]
    fn reach<L: Lanes>(forms: [L; 3], numbers: &[L; N_NUMBER], chord: L) -> L {
        let (mut ahead, mut squared, mut size) = (L::zero(), L::zero(), L::zero());
        unrolled!(k in 0..3 {
            let (middle, half) = (L::constant(0.5) * (numbers[k] + numbers[3 + k]), numbers[3 + k] - numbers[k]);
            ahead = fused(middle, forms[k], ahead);
            squared = fused(middle, middle, squared);
            size = fused(half, half, size);
        });
        let ahead = ahead.max(L::zero());
        let reach = fused(chord, squared.sqrt(), L::constant(0.5) * size.sqrt());
        let past = fused(-ahead, ahead, squared);
        L::select(L::zero().lt(reach), fused(reach, reach, L::constant(1e-5) * squared - past), -L::one())
    }
}

const TINY: f64 = 1e-12;
