//! Signed distance of shapes: positive across a gap, negative in overlap.
//!
//! | pair | apart | overlapping |
//! |---|---|---|
//! | spheres, capsules, plane | exact | exact until a sphere's centre or a capsule's segment is inside |
//! | box–sphere | exact | exact |
//! | box–capsule | exact to 2e-7 of its length | never deeper than the truth |
//! | box–box | never farther than the truth; exact where a face separates | exact |
//!
//! The sign is right everywhere. Gradients are those of the nearest pair of points, of unit norm in position wherever
//! that pair is unique.

use super::closest::point_on_segment;
use super::pairs::{capsule_capsule, corners, round, round_contact, segment, sphere_relief};
use crate::shape::{Geometry, Pose};
use crate::spatial::{Vec3, axpy, constants, cross, dot, mat_mul, mat_vec, matrix, scale, sub, transpose};
use crate::uneven_ground::UnevenGround;
use autodiff::{Mask, Scalar, safe};

/// Steps of the golden section along a capsule: 0.618³² = 2e-7 of its length.
const SEARCH_STEPS: usize = 32;
/// sin² of the angle below which two edges count as parallel and give no axis of their own.
const PARALLEL: f64 = 1e-6;
/// Less than every distance.
const LOWEST: f64 = -1e6;

/// Distance of a point to the sphere about the origin, m.
#[inline]
pub(crate) fn point_sphere<S: Scalar>(local: Vec3<S>, radius: S) -> S {
    safe::norm(local) - radius
}

/// Distance of a point to the capsule around the segment `a` → `b`, m.
#[inline]
pub(crate) fn point_capsule<S: Scalar>(point: Vec3<S>, a: Vec3<S>, b: Vec3<S>, radius: S) -> S {
    safe::norm(sub(point, point_on_segment(a, b, point))) - radius
}

/// Distance of a point to the box about the origin with half edges `half`, m. Exact inside and outside; the gradient
/// has unit norm but on the box's edges (closer than 1e-9 m: 0) and, inside, where two faces are equally near.
pub(crate) fn point_box<S: Scalar>(local: Vec3<S>, half: Vec3<S>) -> S {
    let zero = S::zero();
    let mut q = half;
    let mut outside = half;
    for k in 0..3 {
        q[k] = local[k].abs() - half[k];
        outside[k] = q[k].max(zero);
    }
    let largest = q[0].max(q[1]).max(q[2]);
    let second = q[0].min(q[1]).max(q[0].max(q[1]).min(q[2]));
    // beyond one face the distance is that to the face; beyond two or three it is that to the edge or corner
    let at_edge = zero.lt(second);
    let squared = S::select(at_edge, safe::squared_norm(outside), S::one());
    S::select(at_edge, safe::sqrt(squared, safe::SQUARED_NORM_FLOOR), largest)
}

/// Distance of a point to a geometry at `pose`, m.
pub fn point<S: Scalar>(point: Vec3<S>, geometry: &Geometry, pose: &Pose<S>) -> S {
    let local = pose.local(point);
    match *geometry {
        Geometry::Sphere { radius } => point_sphere(local, S::constant(radius)),
        Geometry::Capsule { radius, length } => {
            let h = S::constant(0.5 * length);
            safe::norm([local[0], local[1], local[2] - local[2].clamp(-h, h)]) - S::constant(radius)
        }
        Geometry::Box { size } => point_box(local, constants(half(size))),
    }
}

/// Signed distance of a geometry at `pose` (world) to the half space below z = `height` (m), m: negative in overlap. Exact.
pub fn plane_distance<S: Scalar>(geometry: &Geometry, pose: &Pose<S>, height: S) -> S {
    let up = matrix(pose.attitude)[2];
    let reach = match *geometry {
        Geometry::Sphere { radius } => S::constant(radius),
        Geometry::Capsule { radius, length } => up[2].abs().mul_add(S::constant(0.5 * length), S::constant(radius)),
        Geometry::Box { size } => support(up, constants(half(size))),
    };
    pose.position[2] - height - reach
}

/// Signed distance of a geometry at `pose` (world) to uneven ground that rises over z = `height`, m: that of the points by which it touches
/// it, a capsule's ends and a box's corners. As exact there as [`UnevenGround::surface`].
pub fn ground_distance<S: Scalar>(geometry: &Geometry, pose: &Pose<S>, height: S, relief: &UnevenGround) -> S {
    match *geometry {
        Geometry::Sphere { radius } => -sphere_relief(pose.position, S::constant(radius), height, relief).depth,
        Geometry::Capsule { radius, length } => {
            let [a, b] = segment(pose, length);
            let r = S::constant(radius);
            -sphere_relief(a, r, height, relief).depth.max(sphere_relief(b, r, height, relief).depth)
        }
        Geometry::Box { size } => {
            let corners = corners(pose, constants(size));
            let mut least = relief.surface(corners[0], height).0;
            for i in 1..8 {
                least = least.min(relief.surface(corners[i], height).0);
            }
            least
        }
    }
}

/// Signed distance between two geometries at their poses (world), m: positive across a gap, negative in overlap. The sign is right.
///
/// Spheres and capsules: exact, until the centre of a sphere or the segment of a capsule is inside. Box and sphere: exact. Box and
/// capsule: exact to 2e-7 of its length apart, never deeper than the truth in overlap. Two boxes: exact where a face separates, never
/// farther than the truth apart and in overlap of faces (separating axes; Gottschalk, Lin and Manocha 1996). Gradients are those of the
/// nearest pair of points.
pub fn distance<S: Scalar>(geometry1: &Geometry, pose1: &Pose<S>, geometry2: &Geometry, pose2: &Pose<S>) -> S {
    match (round(geometry1), round(geometry2), *geometry1, *geometry2) {
        (Some((r1, l1)), Some((r2, l2)), ..) => -round_contact((pose1, r1, l1), (pose2, r2, l2)).depth,
        (Some((radius, length)), None, _, Geometry::Box { size }) => round_box(pose1, radius, length, pose2, size),
        (None, Some((radius, length)), Geometry::Box { size }, _) => round_box(pose2, radius, length, pose1, size),
        (_, _, Geometry::Box { size: s1 }, Geometry::Box { size: s2 }) => box_box(pose1, s1, pose2, s2),
        _ => unreachable!("what is neither sphere nor capsule is a box"),
    }
}

/// Distance of a geometry at `pose` to the capsule of `radius` around the segment `axis` of the world, m.
pub fn to_capsule<S: Scalar>(geometry: &Geometry, pose: &Pose<S>, axis: [Vec3<S>; 2], radius: f64) -> S {
    let around = S::constant(radius);
    match *geometry {
        Geometry::Sphere { radius } => point_capsule(pose.position, axis[0], axis[1], around) - S::constant(radius),
        Geometry::Capsule { radius, length } => {
            -capsule_capsule(segment(pose, length), S::constant(radius), axis, around).depth
        }
        Geometry::Box { size } => segment_box(pose.local(axis[0]), pose.local(axis[1]), constants(half(size))) - around,
    }
}

/// A sphere, or a capsule where it has a length, against a box.
fn round_box<S: Scalar>(pose: &Pose<S>, radius: f64, length: Option<f64>, frame: &Pose<S>, size: [f64; 3]) -> S {
    let half = constants(half(size));
    let nearest = match length {
        None => point_box(frame.local(pose.position), half),
        Some(length) => {
            let [a, b] = segment(pose, length);
            segment_box(frame.local(a), frame.local(b), half)
        }
    };
    nearest - S::constant(radius)
}

/// Least distance of the points of `a` → `b` to the box about the origin.
///
/// The distance to a convex body is convex along a line, so a golden section finds its least value; the fraction found
/// is a constant to derivatives, which at a minimum is exact.
fn segment_box<S: Scalar>(a: Vec3<S>, b: Vec3<S>, half: Vec3<S>) -> S {
    let d = sub(b, a);
    let golden = S::constant(0.618_033_988_749_894_9);
    let (mut from, mut width) = (S::zero(), S::one());
    let mut left = S::one() - golden;
    let mut at_left = point_box(axpy(a, left, d), half);
    let mut at_right = point_box(axpy(a, golden, d), half);
    for _ in 0..SEARCH_STEPS {
        let keep_left = at_left.lt(at_right);
        width *= golden;
        from = S::select(keep_left, from, left);
        // one inner point stays, the other is new
        let new_left = from + (S::one() - golden) * width;
        let new_right = from + golden * width;
        let fresh = point_box(axpy(a, S::select(keep_left, new_left, new_right), d), half);
        let (old_left, old_right) = (at_left, at_right);
        at_left = S::select(keep_left, fresh, old_right);
        at_right = S::select(keep_left, old_left, fresh);
        left = new_left;
    }
    // the ends themselves are never tried by the section
    at_left.min(at_right).min(point_box(a, half)).min(point_box(b, half))
}

/// Two boxes by separating axes: the largest gap over three faces of each and nine products of edges (Gottschalk, Lin
/// and Manocha 1996).
fn box_box<S: Scalar>(pose1: &Pose<S>, size1: [f64; 3], pose2: &Pose<S>, size2: [f64; 3]) -> S {
    let (half1, half2): (Vec3<S>, Vec3<S>) = (constants(half(size1)), constants(half(size2)));
    // axes of the second as rows, in the frame of the first, and the way to it
    let axes1 = transpose(matrix(pose1.attitude));
    let axes2 = mat_mul(transpose(matrix(pose2.attitude)), transpose(axes1));
    let way = mat_vec(axes1, sub(pose2.position, pose1.position));
    let mut largest = S::constant(LOWEST);
    for i in 0..3 {
        let mut e = [S::zero(); 3];
        e[i] = S::one();
        largest = largest.max(gap(e, way, half1, axes2, half2));
        largest = largest.max(gap(axes2[i], way, half1, axes2, half2));
    }
    for i in 0..3 {
        let mut e = [S::zero(); 3];
        e[i] = S::one();
        for k in 0..3 {
            let axis = cross(e, axes2[k]);
            let squared = safe::squared_norm(axis);
            let parallel = squared.lt(S::constant(PARALLEL));
            let unit = scale(safe::recip_sqrt(squared, PARALLEL), axis);
            let found = gap(unit, way, half1, axes2, half2);
            largest = S::select(parallel.or(found.lt(largest)), largest, found);
        }
    }
    largest
}

/// Gap of two boxes along the unit vector `axis`; all in the frame of the first.
#[inline]
fn gap<S: Scalar>(axis: Vec3<S>, way: Vec3<S>, half1: Vec3<S>, axes2: [Vec3<S>; 3], half2: Vec3<S>) -> S {
    dot(way, axis).abs() - support(axis, half1) - support(mat_vec(axes2, axis), half2)
}

/// Half the extent of a box along a direction given in its frame.
#[inline]
fn support<S: Scalar>(direction: Vec3<S>, half: Vec3<S>) -> S {
    let mut sum = direction[0].abs() * half[0];
    for k in 1..3 {
        sum = direction[k].abs().mul_add(half[k], sum);
    }
    sum
}

#[inline]
fn half(size: [f64; 3]) -> [f64; 3] {
    [0.5 * size[0], 0.5 * size[1], 0.5 * size[2]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spatial::from_euler;
    use num_dual::Dual64;
    use rng::{Purpose, Stream};

    fn pose(r: &mut Stream, spread: f64) -> Pose<f64> {
        let mut u = |x: f64| r.uniform(-x, x);
        Pose { position: [u(spread), u(spread), u(spread)], attitude: from_euler(u(3.0), u(1.5), u(3.0)) }
    }

    fn stream(index: u64) -> Stream {
        Stream::new(9, index, 0, Purpose::user(2))
    }

    /// Points of a box, surface and inside, on a grid.
    fn grid(pose: &Pose<f64>, size: [f64; 3], n: usize) -> Vec<Vec3<f64>> {
        let mut points = Vec::new();
        for i in 0..=n {
            for j in 0..=n {
                for k in 0..=n {
                    let at = |m: usize, axis: usize| size[axis] * (m as f64 / n as f64 - 0.5);
                    points.push(pose.point([at(i, 0), at(j, 1), at(k, 2)]));
                }
            }
        }
        points
    }

    #[test]
    fn distance_to_a_box_is_that_of_its_nearest_surface_point() {
        let half = [0.5, 0.3, 0.2];
        for (p, want) in [
            ([0.0, 0.0, 0.0], -0.2),
            ([0.45, 0.0, 0.0], -0.05),
            ([0.7, 0.1, -0.1], 0.2),
            ([0.9, 0.6, 0.0], 0.5),
            ([-0.6, -0.5, 0.4], 0.3),
            ([0.5, 0.3, 0.2], 0.0),
        ] {
            let have = point_box(p, half);
            assert!((have - want).abs() < 2e-9, "{p:?}: {have} against {want}");
        }
    }

    #[test]
    fn gradients_in_the_point_have_unit_norm_inside_and_outside_and_on_faces() {
        let mut r = stream(1);
        let shapes = [
            Geometry::Sphere { radius: 0.3 },
            Geometry::Capsule { radius: 0.2, length: 0.7 },
            Geometry::Box { size: [0.6, 0.9, 0.3] },
        ];
        let frame = pose(&mut r, 0.2);
        let mut points: Vec<Vec3<f64>> = (0..500).map(|_| pose(&mut r, 1.0).position).collect();
        points.push(frame.point([0.3, 0.1, 0.05]));
        points.push(frame.point([0.3 + 1e-10, 0.1, 0.05]));
        for geometry in shapes {
            for p in &points {
                let mut squared = 0.0;
                for k in 0..3 {
                    let mut x = p.map(Dual64::from);
                    x[k].eps = 1.0;
                    let lifted =
                        Pose { position: frame.position.map(Dual64::from), attitude: frame.attitude.map(Dual64::from) };
                    squared += point(x, &geometry, &lifted).eps.powi(2);
                }
                assert!((squared - 1.0).abs() < 1e-9, "{geometry:?} at {p:?}: {squared}");
            }
        }
    }

    #[test]
    fn box_against_sphere_and_capsule_agrees_with_samples() {
        let mut r = stream(2);
        let size = [0.6, 0.9, 0.3];
        let block = Geometry::Box { size };
        let mut worst = 0.0_f64;
        for case in 0..300 {
            let (frame, other) = (pose(&mut r, 0.3), pose(&mut r, 1.0));
            let length = if case % 3 == 0 { 0.0 } else { 0.8 };
            let capsule = Geometry::Capsule { radius: 0.1, length };
            let have = distance(&capsule, &other, &block, &frame);
            assert_eq!(have, distance(&block, &frame, &capsule, &other));
            let [a, b] = segment(&other, length);
            let mut want = f64::INFINITY;
            for i in 0..=4000 {
                let p = axpy(a, f64::from(i) / 4000.0, sub(b, a));
                want = want.min(point_box(frame.local(p), half(size)) - 0.1);
            }
            worst = worst.max((have - want).abs());
            // never above a sample, and a sample is at most half its spacing of 2e-4 m from the best
            assert!(have <= want + 1e-12 && have > want - 1.1e-4, "case {case}: {have} against {want}");
            if length == 0.0 {
                let ball = distance(&Geometry::Sphere { radius: 0.1 }, &other, &block, &frame);
                assert!((ball - have).abs() < 1e-15);
            }
        }
        println!("capsule and box against samples {worst:.1e} m");
    }

    #[test]
    fn boxes_touch_where_samples_do_and_their_distance_is_no_more_than_the_truth() {
        let mut r = stream(3);
        let (s1, s2) = ([0.6, 0.9, 0.3], [0.5, 0.2, 0.7]);
        let (mut apart, mut touching, mut exact) = (0, 0, 0);
        for case in 0..300 {
            let (one, two) = (pose(&mut r, 0.3), pose(&mut r, 0.8));
            let have = distance(&Geometry::Box { size: s1 }, &one, &Geometry::Box { size: s2 }, &two);
            let mut truth = f64::INFINITY;
            for p in grid(&two, s2, 14) {
                truth = truth.min(point_box(one.local(p), half(s1)));
            }
            for p in grid(&one, s1, 14) {
                truth = truth.min(point_box(two.local(p), half(s2)));
            }
            if have > 0.0 {
                apart += 1;
                assert!(truth > 0.0 && have <= truth + 1e-12, "case {case}: {have} against {truth}");
                exact += usize::from((have - truth).abs() < 1e-9);
            } else {
                touching += 1;
                // the samples miss the deepest point by at most their spacing
                assert!(truth < 0.08, "case {case}: {have} against {truth}");
            }
        }
        println!("{apart} apart ({exact} by a face), {touching} touching");
        assert!(apart > 50 && touching > 50);
    }

    #[test]
    fn overlap_of_boxes_is_the_shortest_way_out() {
        let cube = Geometry::Box { size: [1.0; 3] };
        let at = |x: f64, yaw: f64| Pose { position: [x, 0.1, 0.2], attitude: from_euler(0.0, 0.0, yaw) };
        let here = Pose { position: [0.0; 3], attitude: [1.0, 0.0, 0.0, 0.0] };
        assert!((distance(&cube, &here, &cube, &at(0.7, 0.0)) + 0.3).abs() < 1e-14);
        assert!((distance(&cube, &here, &cube, &at(1.7, 0.0)) - 0.7).abs() < 1e-14);
        // turned by an eighth, the edge is √½ out
        let want = 1.5 - 0.5 - 0.5_f64.sqrt();
        assert!((distance(&cube, &here, &cube, &at(1.5, std::f64::consts::FRAC_PI_4)) - want).abs() < 1e-14);
    }

    #[test]
    fn the_plane_is_reached_by_the_lowest_corner() {
        let mut r = stream(4);
        let size = [0.6, 0.9, 0.3];
        for _ in 0..100 {
            let frame = pose(&mut r, 1.0);
            let lowest = corners(&frame, size).iter().fold(f64::INFINITY, |z, c| z.min(c[2]));
            assert!((plane_distance(&Geometry::Box { size }, &frame, 0.2) - (lowest - 0.2)).abs() < 1e-14);
            let ends = segment(&frame, 0.7);
            let lowest = ends[0][2].min(ends[1][2]) - 0.1;
            let capsule = Geometry::Capsule { radius: 0.1, length: 0.7 };
            assert!((plane_distance(&capsule, &frame, 0.2) - (lowest - 0.2)).abs() < 1e-14);
        }
    }
}
