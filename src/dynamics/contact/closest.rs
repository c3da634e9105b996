//! Nearest points of segments, and directions between points that may coincide.

use crate::spatial::{Vec3, axpy, dot, sub};
use autodiff::{Scalar, safe};

/// Floor on the squared length of a segment, m²: a shorter one is a point.
const SQUARED_LENGTH_FLOOR: f64 = 1e-12;
/// sin² of the angle at which two segments are half way to being treated as parallel.
const PARALLEL: f64 = 1e-6;

/// (v/‖v‖, ‖v‖); below 1e-9 the direction is world z and the length 0, both with derivative 0.
///
/// Unlike [`safe::normalise`] the direction always has unit length, so that coincident centres are pushed apart.
pub fn direction<S: Scalar>(v: Vec3<S>) -> (Vec3<S>, S) {
    let tiny = safe::squared_norm(v).lt(S::constant(safe::SQUARED_NORM_FLOOR));
    let mut u = [S::zero(), S::zero(), S::one()];
    for i in 0..3 {
        u[i] = S::select(tiny, u[i], v[i]);
    }
    let squared = safe::squared_norm(u);
    let recip = safe::recip_sqrt(squared, safe::SQUARED_NORM_FLOOR);
    let length = S::select(tiny, S::zero(), squared * recip);
    ([u[0] * recip, u[1] * recip, u[2] * recip], length)
}

/// Where on the segment `a` → `b` (0 to 1) the point nearest to `p` lies. A segment of no length answers 0.
#[inline]
pub(crate) fn fraction_on_segment<S: Scalar>(a: Vec3<S>, b: Vec3<S>, p: Vec3<S>) -> S {
    let d = sub(b, a);
    let along = dot(sub(p, a), d) * dot(d, d).max(S::constant(SQUARED_LENGTH_FLOOR)).recip();
    along.clamp(S::zero(), S::one())
}

/// The point of the segment `a` → `b` nearest to `p`.
#[inline]
pub(crate) fn point_on_segment<S: Scalar>(a: Vec3<S>, b: Vec3<S>, p: Vec3<S>) -> Vec3<S> {
    axpy(a, fraction_on_segment(a, b, p), sub(b, a))
}

/// The points of the segments `a` → `b` and `c` → `d` that are nearest to each other.
///
/// The lines' nearest points, held on the segments in turn (Ericson 2005, section 5.1.9). Where the segments become
/// parallel those points are not unique and run away; the start of the search then goes over, smoothly in the angle
/// and within about 1e-3 rad, to the middle of the stretch where the segments lie beside each other. The square of the
/// distance so found is too large by at most l² · 2.5e-7, with l the first segment's length.
pub(crate) fn points_of_segments<S: Scalar>(a: Vec3<S>, b: Vec3<S>, c: Vec3<S>, d: Vec3<S>) -> (Vec3<S>, Vec3<S>) {
    let (zero, one) = (S::zero(), S::one());
    let floor = S::constant(SQUARED_LENGTH_FLOOR);
    let (u, v, r) = (sub(b, a), sub(d, c), sub(a, c));
    let (uu, vv) = (dot(u, u).max(floor), dot(v, v).max(floor));
    let (uv, ur, vr) = (dot(u, v), dot(u, r), dot(v, r));
    // uu vv sin², and the nearest point of the lines, s* = (uv vr − ur vv)/(uu vv sin²)
    let determinant = uu.mul_add(vv, -(uv * uv)).max(zero);
    let epsilon = uu * vv * S::constant(PARALLEL);
    let lines = uv.mul_add(vr, -(ur * vv)) * (determinant + epsilon * S::constant(1e-6)).recip();
    let lines = lines.clamp(zero, one);
    // the middle of the second segment's shadow on the first
    let recip_uu = uu.recip();
    let shadow_c = (-(ur * recip_uu)).clamp(zero, one);
    let shadow_d = ((uv - ur) * recip_uu).clamp(zero, one);
    let middle = (shadow_c + shadow_d) * S::constant(0.5);
    let s = determinant.mul_add(lines, epsilon * middle) * (determinant + epsilon).recip();
    // from there the nearest point of the second, and back
    let t = (uv.mul_add(s, vr) * vv.recip()).clamp(zero, one);
    let s = (uv.mul_add(t, -ur) * recip_uu).clamp(zero, one);
    (axpy(a, s, u), axpy(c, t, v))
}

#[cfg(test)]
mod tests {
    use super::*;
    use autodiff::safe::norm;
    use num_dual::Dual64;
    use rng::{Purpose, Stream};

    fn random(r: &mut Stream) -> Vec3<f64> {
        [r.uniform(-1.0, 1.0), r.uniform(-1.0, 1.0), r.uniform(-1.0, 1.0)]
    }

    fn lerp(a: Vec3<f64>, b: Vec3<f64>, t: f64) -> Vec3<f64> {
        axpy(a, t, sub(b, a))
    }

    #[test]
    fn no_sampled_pair_of_points_is_nearer_than_the_pair_found() {
        let mut r = Stream::new(7, 0, 0, Purpose::user(1));
        let mut worst = 0.0_f64;
        for case in 0..400 {
            let (a, b, c) = (random(&mut r), random(&mut r), random(&mut r));
            // skew, then exactly parallel, then short, then none at all
            let d = match case % 4 {
                0 => random(&mut r),
                1 => axpy(c, r.uniform(-2.0, 2.0), sub(b, a)),
                2 => axpy(c, 1e-3, random(&mut r)),
                _ => c,
            };
            let (p, q) = points_of_segments(a, b, c, d);
            let found = norm(sub(p, q));
            let mut least = f64::INFINITY;
            for i in 0..=200 {
                let x = lerp(a, b, f64::from(i) / 200.0);
                least = least.min(norm(sub(x, point_on_segment(c, d, x))));
                let x = lerp(c, d, f64::from(i) / 200.0);
                least = least.min(norm(sub(x, point_on_segment(a, b, x))));
            }
            worst = worst.max(found - least);
            // crossing segments at a small angle: √(l² 2.5e-7)
            assert!(found <= least + 1e-6, "case {case}: {found} against {least}");
            // the points lie on their segments
            assert!(norm(sub(p, point_on_segment(a, b, p))) < 2e-9, "case {case}");
            assert!(norm(sub(q, point_on_segment(c, d, q))) < 2e-9, "case {case}");
        }
        println!("longer than the best sample by at most {worst:.1e}");
    }

    #[test]
    fn nearly_parallel_segments_lose_no_more_than_is_stated() {
        let mut worst = 0.0_f64;
        for k in 0..60 {
            let angle = 10_f64.powf(-6.0 + 0.1 * f64::from(k));
            let (sin, cos) = angle.sin_cos();
            for gap in [0.02, 0.1] {
                // they cross at the first one's start, where the middle is far from best
                let (a, b) = ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
                let (c, d) = ([-0.1 * cos, -0.1 * sin, gap], [cos, sin, gap]);
                let (p, q) = points_of_segments(a, b, c, d);
                let excess = safe::squared_norm(sub(p, q)) - gap * gap;
                worst = worst.max(excess);
                assert!(excess < 2.5e-7, "{angle:e} rad: {excess:e}");
            }
        }
        println!("largest excess of the squared distance {worst:.1e} m²");
    }

    #[test]
    fn parallel_segments_meet_in_the_middle_and_turn_away_from_it_smoothly() {
        let (a, b) = ([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
        let (p, q) = points_of_segments(a, b, [0.0, 0.0, 0.5], [3.0, 0.0, 0.5]);
        assert!((p[0] - 0.5).abs() < 1e-9 && (q[0] - 0.5).abs() < 1e-9, "{p:?} {q:?}");
        // tilt about y through zero: no jump larger than that of the angle over 1e-3 rad
        let at = |angle: Dual64| {
            let (sin, cos) = Scalar::sin_cos(angle);
            let z = Dual64::from(0.5);
            let c = [-cos, Dual64::from(0.0), z - sin];
            let d = [cos, Dual64::from(0.0), z + sin];
            points_of_segments(a.map(Dual64::from), b.map(Dual64::from), c, d).0[0]
        };
        for k in -2000..2000 {
            let angle = 1e-6 * f64::from(k);
            let here = at(Dual64::new(angle, 1.0));
            let jump = at(Dual64::from(angle + 1e-6)).re - here.re;
            assert!(jump.abs() < 1e-2, "{angle:e}: jumps by {jump}");
            assert!(here.eps.is_finite() && here.eps.abs() < 1e4, "{angle:e}: slope {}", here.eps);
        }
    }

    #[test]
    fn direction_is_a_unit_vector_with_finite_derivative_even_at_zero() {
        for x in [0.0, 1e-300, 1e-12, 1e-9, 1e-6, 1.0, 1e6] {
            for k in 0..3 {
                let mut v = [Dual64::from(0.0); 3];
                v[0] = Dual64::from(x);
                v[k].eps = 1.0;
                let (n, length) = direction(v);
                assert!((norm(n).re - 1.0).abs() < 1e-12, "{x}: {n:?}");
                assert!(n.iter().all(|n| n.eps.is_finite() && n.eps.abs() <= 1.1e9), "{x}: {n:?}");
                assert!((length.re - x).abs() <= 1e-9 && length.eps.abs() <= 1.0 + 1e-12, "{x}: {length:?}");
            }
        }
    }
}
