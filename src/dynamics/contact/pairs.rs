//! Where two bodies touch: point, normal and depth for every pair that has a force.
//!
//! The functions on centres and segment ends take world coordinates over any scalar; [`between`] and [`with_plane`] call
//! them for two [`Geometry`]s with their poses.

use super::closest::{direction, point_on_segment, points_of_segments};
use crate::shape::{Geometry, Pose};
use crate::spatial::{Mat3, Vec3, axpy, constants, mat_vec, sub, transpose};
use crate::uneven_ground::UnevenGround;
use autodiff::Scalar;

/// Most points at which one pair touches: the corners of a box.
pub const MAX_CONTACTS: usize = 8;

/// One point of contact between a first and a second body, world frame.
#[derive(Debug, Clone, Copy)]
pub struct ContactPoint<S> {
    /// Where the force acts: half way between the two surfaces, m.
    pub point: Vec3<S>,
    /// Unit vector from the second body to the first: the way the first is pushed.
    pub normal: Vec3<S>,
    /// How deep the bodies overlap along the normal, m; negative across a gap.
    pub depth: S,
}

impl<S: Scalar> ContactPoint<S> {
    /// No contact: infinitely far apart for every purpose of a force.
    #[inline]
    pub fn none() -> Self {
        let o = S::zero();
        Self { point: [o; 3], normal: [o, o, S::one()], depth: -S::one() }
    }
}

/// All contacts of one pair.
#[derive(Debug, Clone, Copy)]
pub struct Contacts<S> {
    /// The first `count` are in use; their number depends on the kinds of bodies alone.
    pub list: [ContactPoint<S>; MAX_CONTACTS],
    /// 0 for a pair without a force.
    pub count: usize,
}

impl<S: Scalar> Contacts<S> {
    /// None at all.
    #[inline]
    pub fn none() -> Self {
        Self { list: [ContactPoint::none(); MAX_CONTACTS], count: 0 }
    }

    /// Adds one.
    ///
    /// # Panics
    /// If there are [`MAX_CONTACTS`] already.
    #[inline]
    pub fn push(&mut self, contact: ContactPoint<S>) {
        self.list[self.count] = contact;
        self.count += 1;
    }
}

/// A sphere on the plane z = `height`, which pushes up.
#[inline]
pub(crate) fn sphere_plane<S: Scalar>(center: Vec3<S>, radius: S, height: S) -> ContactPoint<S> {
    let depth = height + radius - center[2];
    let level = (height + center[2] - radius) * S::constant(0.5);
    ContactPoint { point: [center[0], center[1], level], normal: [S::zero(), S::zero(), S::one()], depth }
}

/// A capsule around the segment `a` → `b` on the plane z = `height`: one contact per end.
#[inline]
pub(crate) fn capsule_plane<S: Scalar>(a: Vec3<S>, b: Vec3<S>, radius: S, height: S) -> [ContactPoint<S>; 2] {
    [sphere_plane(a, radius, height), sphere_plane(b, radius, height)]
}

/// Two spheres. Coincident centres are pushed apart along world z.
#[inline]
pub(crate) fn sphere_sphere<S: Scalar>(center1: Vec3<S>, radius1: S, center2: Vec3<S>, radius2: S) -> ContactPoint<S> {
    let (normal, gap) = direction(sub(center1, center2));
    let depth = radius1 + radius2 - gap;
    // from the second centre to its surface, then half the overlap back
    let reach = depth.mul_add(S::constant(-0.5), radius2);
    ContactPoint { point: axpy(center2, reach, normal), normal, depth }
}

/// A sphere and a capsule around the segment `a` → `b`.
#[inline]
pub(crate) fn sphere_capsule<S: Scalar>(
    center: Vec3<S>,
    radius1: S,
    a: Vec3<S>,
    b: Vec3<S>,
    radius2: S,
) -> ContactPoint<S> {
    sphere_sphere(center, radius1, point_on_segment(a, b, center), radius2)
}

/// Two capsules around the segments `a1` → `b1` and `a2` → `b2`: one contact at their nearest points, in the middle of
/// the common stretch where they are parallel.
pub(crate) fn capsule_capsule<S: Scalar>(
    [a1, b1]: [Vec3<S>; 2],
    radius1: S,
    [a2, b2]: [Vec3<S>; 2],
    radius2: S,
) -> ContactPoint<S> {
    let (p, q) = points_of_segments(a1, b1, a2, b2);
    sphere_sphere(p, radius1, q, radius2)
}

/// The corners of a box of full edge lengths `size`, world.
pub fn corners<S: Scalar>(pose: &Pose<S>, size: Vec3<S>) -> [Vec3<S>; 8] {
    let mut corners = [pose.position; 8];
    for i in 0..8 {
        let mut local = size;
        for k in 0..3 {
            local[k] = size[k] * S::constant(if i >> k & 1 == 1 { 0.5 } else { -0.5 });
        }
        corners[i] = pose.point(local);
    }
    corners
}

/// A sphere on or above uneven ground, which pushes it along the normal below its lowest point.
#[inline]
pub(crate) fn sphere_relief<S: Scalar>(
    center: Vec3<S>,
    radius: S,
    height: S,
    relief: &UnevenGround,
) -> ContactPoint<S> {
    let (_, below) = relief.surface(center, height);
    let bottom = axpy(center, -radius, below);
    let (distance, normal) = relief.surface(bottom, height);
    ContactPoint { point: axpy(bottom, distance * S::constant(-0.5), normal), normal, depth: -distance }
}

/// A sphere and the box of half edges `half` at `position` with the world axes `rotation`, which pushes the sphere out along
/// the nearest way.
pub(crate) fn sphere_box<S: Scalar>(
    center: Vec3<S>,
    radius: S,
    (position, rotation): (Vec3<S>, &Mat3<S>),
    half: Vec3<S>,
) -> ContactPoint<S> {
    let local = mat_vec(transpose(*rotation), sub(center, position));
    let (zero, one) = (S::zero(), S::one());
    let (mut beyond, mut depth) = ([zero; 3], [zero; 3]);
    let mut side = [one; 3];
    for k in 0..3 {
        side[k] = S::select(local[k].lt(zero), -one, one);
        depth[k] = local[k].abs() - half[k];
        beyond[k] = depth[k].max(zero) * side[k];
    }
    // outside of the box from the nearest point of its surface to the centre, inside through the nearest face
    let is_inside = depth[0].max(depth[1]).max(depth[2]).lt(S::constant(1e-9));
    let (out, gap) = direction(beyond);
    let first = depth[1].max(depth[2]).lt(depth[0]);
    let second = depth[2].lt(depth[1]);
    let through = [
        S::select(first, side[0], zero),
        S::select(first, zero, S::select(second, side[1], zero)),
        S::select(first, zero, S::select(second, zero, side[2])),
    ];
    let distance = S::select(is_inside, depth[0].max(depth[1]).max(depth[2]), gap);
    let mut normal = out;
    for k in 0..3 {
        normal[k] = S::select(is_inside, through[k], out[k]);
    }
    let normal = mat_vec(*rotation, normal);
    let overlap = radius - distance;
    // half way between the two surfaces
    let reach = overlap.mul_add(S::constant(0.5), -radius);
    ContactPoint { point: axpy(center, reach, normal), normal, depth: overlap }
}

/// A box on the plane z = `height`: one contact per corner.
pub(crate) fn box_plane<S: Scalar>(pose: &Pose<S>, size: Vec3<S>, height: S) -> [ContactPoint<S>; 8] {
    let corners = corners(pose, size);
    let mut contacts = [ContactPoint::none(); 8];
    for i in 0..8 {
        contacts[i] = sphere_plane(corners[i], S::zero(), height);
    }
    contacts
}

/// The ends of a capsule's segment of `length`, along the local z axis, world.
#[inline]
pub fn segment<S: Scalar>(pose: &Pose<S>, length: f64) -> [Vec3<S>; 2] {
    let o = S::zero();
    [pose.point([o, o, S::constant(-0.5 * length)]), pose.point([o, o, S::constant(0.5 * length)])]
}

/// Contacts of a body at `pose` (world) with the plane z = `height` (m) below it; the body is the first of the pair. One point of a
/// sphere, two of a capsule (its ends), eight of a box (its corners).
pub fn with_plane<S: Scalar>(geometry: &Geometry, pose: &Pose<S>, height: S) -> Contacts<S> {
    let mut contacts = Contacts::none();
    match *geometry {
        Geometry::Sphere { radius } => contacts.push(sphere_plane(pose.position, S::constant(radius), height)),
        Geometry::Capsule { radius, length } => {
            let [a, b] = segment(pose, length);
            let pair = capsule_plane(a, b, S::constant(radius), height);
            contacts.push(pair[0]);
            contacts.push(pair[1]);
        }
        Geometry::Box { size } => {
            let eight = box_plane(pose, constants(size), height);
            for i in 0..8 {
                contacts.push(eight[i]);
            }
        }
    }
    contacts
}

/// Contacts between two bodies at their poses (world), the first pushed along the normal; none where either is a box
/// ([`distance`](super::distance()) answers those).
#[inline]
pub fn between<S: Scalar>(geometry1: &Geometry, pose1: &Pose<S>, geometry2: &Geometry, pose2: &Pose<S>) -> Contacts<S> {
    let mut contacts = Contacts::none();
    if let (Some((r1, l1)), Some((r2, l2))) = (round(geometry1), round(geometry2)) {
        contacts.push(round_contact((pose1, r1, l1), (pose2, r2, l2)));
    }
    contacts
}

/// (radius, length of the segment) of a sphere or capsule; a sphere's segment has none.
#[inline]
pub(super) fn round(geometry: &Geometry) -> Option<(f64, Option<f64>)> {
    match *geometry {
        Geometry::Sphere { radius } => Some((radius, None)),
        Geometry::Capsule { radius, length } => Some((radius, Some(length))),
        Geometry::Box { .. } => None,
    }
}

/// Contact of two of those, each with its pose, radius and length.
pub(super) fn round_contact<S: Scalar>(
    (pose1, radius1, length1): (&Pose<S>, f64, Option<f64>),
    (pose2, radius2, length2): (&Pose<S>, f64, Option<f64>),
) -> ContactPoint<S> {
    let (r1, r2) = (S::constant(radius1), S::constant(radius2));
    let (c1, c2) = (pose1.position, pose2.position);
    match (length1, length2) {
        (None, None) => sphere_sphere(c1, r1, c2, r2),
        (None, Some(l2)) => {
            let [a, b] = segment(pose2, l2);
            sphere_capsule(c1, r1, a, b, r2)
        }
        (Some(l1), None) => {
            let [a, b] = segment(pose1, l1);
            sphere_sphere(point_on_segment(a, b, c2), r1, c2, r2)
        }
        (Some(l1), Some(l2)) => capsule_capsule(segment(pose1, l1), r1, segment(pose2, l2), r2),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::distance::{plane_distance, point};
    use crate::spatial::{dot, from_euler};
    use rng::{Purpose, Stream};

    const SHAPES: [Geometry; 3] = [
        Geometry::Sphere { radius: 0.3 },
        Geometry::Capsule { radius: 0.2, length: 0.7 },
        Geometry::Box { size: [0.4, 0.6, 0.8] },
    ];

    fn pose(r: &mut Stream) -> Pose<f64> {
        let mut u = |x: f64| r.uniform(-x, x);
        Pose { position: [u(1.0), u(1.0), u(1.0)], attitude: from_euler(u(3.0), u(1.5), u(3.0)) }
    }

    #[test]
    fn the_point_of_contact_lies_half_the_depth_inside_both_bodies() {
        let mut r = Stream::new(31, 0, 0, Purpose::user(9));
        for case in 0..400 {
            let (one, two) = (SHAPES[case & 1], SHAPES[case >> 1 & 1]);
            let (p, q) = (pose(&mut r), pose(&mut r));
            let contacts = between(&one, &p, &two, &q);
            let c = contacts.list[0];
            assert!(contacts.count == 1 && (dot(c.normal, c.normal) - 1.0).abs() < 1e-12);
            if c.depth > 0.39 {
                continue; // half of it is beyond the axis of a capsule
            }
            for (geometry, pose) in [(&one, &p), (&two, &q)] {
                let d = point(c.point, geometry, pose);
                // across a gap both are half the gap away, in overlap both are half of it deep
                assert!((d + 0.5 * c.depth).abs() < 1e-9, "case {case}: {d} at depth {}", c.depth);
            }
            // one step along the normal leaves the second body
            let out = axpy(c.point, 1e-3, c.normal);
            assert!(point(out, &two, &q) > point(c.point, &two, &q), "case {case}");
        }
        assert_eq!(between(&SHAPES[2], &pose(&mut r), &SHAPES[0], &pose(&mut r)).count, 0);
    }

    #[test]
    fn a_ball_on_a_box_is_pushed_out_the_nearest_way_as_deep_as_it_overlaps() {
        let mut r = Stream::new(33, 0, 0, Purpose::user(9));
        let size = [0.4, 0.6, 0.8];
        let (mut inside, mut outside) = (0, 0);
        for case in 0..600 {
            let frame = pose(&mut r);
            let center = frame.point([r.uniform(-0.5, 0.5), r.uniform(-0.5, 0.5), r.uniform(-0.5, 0.5)]);
            let rotation = crate::spatial::matrix(frame.attitude);
            let c = sphere_box(center, 0.1, (frame.position, &rotation), size.map(|edge| 0.5 * edge));
            let distance = point(center, &Geometry::Box { size }, &frame);
            assert!((c.depth - (0.1 - distance)).abs() < 2e-9, "case {case}: {} at {distance}", c.depth);
            assert!((dot(c.normal, c.normal) - 1.0).abs() < 1e-12, "case {case}: {:?}", c.normal);
            // along the normal the box is left as fast as can be
            let further = point(axpy(center, 1e-4, c.normal), &Geometry::Box { size }, &frame);
            assert!((further - distance - 1e-4).abs() < 1e-9, "case {case}: {further} after {distance}");
            inside += usize::from(distance < 0.0);
            outside += usize::from(distance > 0.0);
        }
        assert!(inside > 100 && outside > 100, "{inside} inside, {outside} outside");
    }

    #[test]
    fn a_ball_on_a_slope_is_as_deep_as_geometry_says() {
        let relief = crate::UnevenGround::inclined(0.3);
        // its centre 8 cm above the ground along the normal
        let center = [1.0 - 0.08 * 0.3_f64.sin(), 2.0, 1.0 * 0.3_f64.tan() + 0.08 * 0.3_f64.cos() + 0.5];
        let c = sphere_relief(center, 0.1, 0.5, &relief);
        assert!((c.depth - 0.02).abs() < 1e-14 && (c.normal[0] + 0.3_f64.sin()).abs() < 1e-14, "{c:?}");
        // half way between the two surfaces
        assert!((relief.surface(c.point, 0.5).0 + 0.01).abs() < 1e-14);
    }

    #[test]
    fn the_deepest_contact_with_the_plane_is_as_deep_as_the_body() {
        let mut r = Stream::new(32, 0, 0, Purpose::user(9));
        for (geometry, count) in [(SHAPES[0], 1), (SHAPES[1], 2), (SHAPES[2], 8)] {
            for _ in 0..100 {
                let p = pose(&mut r);
                let contacts = with_plane(&geometry, &p, 0.2);
                assert_eq!(contacts.count, count);
                let deepest = contacts.list[..count].iter().fold(f64::NEG_INFINITY, |d, c| d.max(c.depth));
                assert!((deepest + plane_distance(&geometry, &p, 0.2)).abs() < 1e-14);
                for c in &contacts.list[..count] {
                    assert!(c.normal == [0.0, 0.0, 1.0] && (c.point[2] - 0.2 + 0.5 * c.depth).abs() < 1e-14);
                }
            }
        }
    }
}
