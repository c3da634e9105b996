//! Shapes of bodies and obstacles: sphere, capsule, box, with volume and inertia of the solid.
//!
//! A [`Geometry`] is centred on its own origin; a [`Shape`] is a geometry with its pose in the frame of what carries it
//! (a body, or the world for an obstacle). Sizes are plain `f64`; [`Pose`] is generic, since bodies move.

use super::spatial::{Quat, Vec3, add, constants, matrix, multiply, rotate, rotate_back, sub};
use super::vehicle::Inertia;
use autodiff::Scalar;
use base::error::{Error, Result, finite};
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Least size of a shape, m: below it squares leave the range of `f32` lanes.
pub(crate) const MIN_SIZE: f64 = 1e-6;
/// Largest size or distance of a shape, m.
pub(crate) const MAX_SIZE: f64 = 1e4;

/// A solid about its own origin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case")]
pub enum Geometry {
    /// A ball.
    Sphere {
        /// m, > 0.
        radius: f64,
    },
    /// A cylinder along local z with a half ball on either end: all points within `radius` of a segment.
    Capsule {
        /// m, > 0.
        radius: f64,
        /// Of the cylindrical part, m, ≥ 0; the whole is `length + 2 radius` long.
        length: f64,
    },
    /// A cuboid with its edges along the local axes.
    Box {
        /// Full edge lengths, m, > 0.
        size: [f64; 3],
    },
}

impl Geometry {
    /// Volume of the solid, m³.
    pub fn volume(&self) -> f64 {
        match *self {
            Self::Sphere { radius } => 4.0 / 3.0 * PI * radius.powi(3),
            Self::Capsule { radius, length } => PI * radius * radius * (length + 4.0 / 3.0 * radius),
            Self::Box { size } => size[0] * size[1] * size[2],
        }
    }

    /// Mass ρV of a solid of `density` ρ in kg/m³, kg.
    pub fn mass(&self, density: f64) -> f64 {
        density * self.volume()
    }

    /// Inertia of a homogeneous solid of `mass` kg about its centre, along its own axes.
    ///
    /// Sphere ⅖ m r². Box m (b² + c²)/12 per axis. Capsule: cylinder m_c and two half balls of m_s together, split by
    /// volume, whose centres of mass lie 3r/8 outside the cylinder (Huygens–Steiner):
    /// about z m_c r²/2 + ⅖ m_s r², across m_c (L²/12 + r²/4) + m_s (⅖ r² + L²/4 + ⅜ L r).
    pub fn inertia(&self, mass: f64) -> Inertia {
        match *self {
            Self::Sphere { radius } => {
                let moment = 0.4 * mass * radius * radius;
                Inertia::diagonal(moment, moment, moment)
            }
            Self::Capsule { radius: r, length: l } => {
                let balls = mass * 4.0 * r / (3.0 * l + 4.0 * r);
                let cylinder = mass - balls;
                let across =
                    cylinder * (l * l / 12.0 + r * r / 4.0) + balls * (0.4 * r * r + l * l / 4.0 + 0.375 * l * r);
                Inertia::diagonal(across, across, cylinder * r * r / 2.0 + 0.4 * balls * r * r)
            }
            Self::Box { size: [a, b, c] } => {
                let m = mass / 12.0;
                Inertia::diagonal(m * (b * b + c * c), m * (c * c + a * a), m * (a * a + b * b))
            }
        }
    }

    /// Every length times `factor` > 0.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        match *self {
            Self::Sphere { radius } => Self::Sphere { radius: factor * radius },
            Self::Capsule { radius, length } => Self::Capsule { radius: factor * radius, length: factor * length },
            Self::Box { size } => Self::Box { size: size.map(|edge| factor * edge) },
        }
    }

    /// Distance from the centre to the farthest point, m.
    pub fn reach(&self) -> f64 {
        match *self {
            Self::Sphere { radius } => radius,
            Self::Capsule { radius, length } => 0.5 * length + radius,
            Self::Box { size } => 0.5 * size.iter().map(|edge| edge * edge).sum::<f64>().sqrt(),
        }
    }

    /// Checks the sizes; `what` names the shape in the error.
    ///
    /// # Errors
    /// [`Error::Value`]: a size that is not finite or outside 1e-6 to 1e4 m (a capsule's length may
    /// be 0).
    pub fn validate(&self, what: &str) -> Result<()> {
        let at = |name: &str| format!("{what}: {name}");
        match *self {
            Self::Sphere { radius } => within(&at("radius"), radius, MIN_SIZE, MAX_SIZE),
            Self::Capsule { radius, length } => {
                within(&at("radius"), radius, MIN_SIZE, MAX_SIZE)?;
                within(&at("length"), length, 0.0, MAX_SIZE)
            }
            Self::Box { size } => {
                for k in 0..3 {
                    within(&at(&format!("size[{k}]")), size[k], MIN_SIZE, MAX_SIZE)?;
                }
                Ok(())
            }
        }
    }
}

/// A geometry with its pose in the frame of what carries it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shape {
    /// What it is.
    pub geometry: Geometry,
    /// Its centre, m.
    #[serde(default)]
    pub position: [f64; 3],
    /// Its axes: a unit quaternion `[w, x, y, z]`, shape → carrier.
    #[serde(default = "upright")]
    pub rotation: [f64; 4],
}

pub(super) fn upright() -> [f64; 4] {
    [1.0, 0.0, 0.0, 0.0]
}

impl Shape {
    /// A geometry at the origin of its carrier, axes aligned.
    pub fn new(geometry: Geometry) -> Self {
        Self { geometry, position: [0.0; 3], rotation: upright() }
    }

    /// The same shape centred on `position`, m.
    #[must_use]
    pub fn at(self, position: [f64; 3]) -> Self {
        Self { position, ..self }
    }

    /// The same shape turned to `rotation`, a unit quaternion `[w, x, y, z]`.
    #[must_use]
    pub fn turned(self, rotation: [f64; 4]) -> Self {
        Self { rotation, ..self }
    }

    /// m³.
    pub fn volume(&self) -> f64 {
        self.geometry.volume()
    }

    /// Mass ρV of a solid of `density` ρ in kg/m³, kg.
    pub fn mass(&self, density: f64) -> f64 {
        self.geometry.mass(density)
    }

    /// Inertia R J Rᵀ of a homogeneous solid of `mass` kg about its own centre, along the axes of its carrier: what a
    /// [`Part`](super::Part) at `position` states.
    pub fn inertia(&self, mass: f64) -> Inertia {
        let r = Matrix3::from_fn(|row, column| matrix(self.rotation)[row][column]);
        Inertia::from_matrix(&(r * self.geometry.inertia(mass).matrix() * r.transpose()))
    }

    /// Sizes and position times `factor` > 0: the carrier scaled about its origin.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            geometry: self.geometry.scaled(factor),
            position: self.position.map(|x| factor * x),
            rotation: self.rotation,
        }
    }

    /// Checks sizes and pose; `what` names the shape in the error.
    ///
    /// # Errors
    /// Sizes as [`Geometry::validate`]; a position beyond 1e4 m; a rotation that is not of unit length (to 1e-6).
    pub fn validate(&self, what: &str) -> Result<()> {
        self.geometry.validate(what)?;
        validate_pose(what, &self.position, &self.rotation)
    }

    /// Its pose in the world where `carrier` is the pose in the world of what carries it.
    #[inline]
    pub fn pose<S: Scalar>(&self, carrier: &Pose<S>) -> Pose<S> {
        carrier.then(&Pose { position: constants(self.position), attitude: constants(self.rotation) })
    }
}

/// Where a frame is and how it is turned.
#[derive(Debug, Clone, Copy)]
pub struct Pose<S> {
    /// Its origin in the outer frame, m.
    pub position: Vec3<S>,
    /// Unit quaternion, this frame → outer frame.
    pub attitude: Quat<S>,
}

impl<S: Scalar> Pose<S> {
    /// The frame `inner`, given in this one, in the outer frame.
    #[inline]
    pub fn then(&self, inner: &Self) -> Self {
        Self { position: self.point(inner.position), attitude: multiply(self.attitude, inner.attitude) }
    }

    /// A point of this frame in the outer frame, m.
    #[inline]
    pub fn point(&self, local: Vec3<S>) -> Vec3<S> {
        add(self.position, rotate(self.attitude, local))
    }

    /// A point of the outer frame in this one, m.
    #[inline]
    pub fn local(&self, outer: Vec3<S>) -> Vec3<S> {
        rotate_back(self.attitude, sub(outer, self.position))
    }
}

/// Checks position and unit quaternion of what `what` names.
pub(super) fn validate_pose(what: &str, position: &[f64; 3], rotation: &[f64; 4]) -> Result<()> {
    finite(&format!("{what}: position"), position)?;
    for k in 0..3 {
        within(&format!("{what}: position[{k}]"), position[k], -MAX_SIZE, MAX_SIZE)?;
    }
    finite(&format!("{what}: rotation"), rotation)?;
    let length = rotation.iter().map(|x| x * x).sum::<f64>().sqrt();
    if (length - 1.0).abs() > 1e-6 {
        return Err(Error::value(
            format!("{what}: rotation"),
            format!("a quaternion of length {length}"),
            "a unit quaternion [w, x, y, z]",
            "Divide it by its length; [1, 0, 0, 0] turns nothing.",
        ));
    }
    Ok(())
}

/// Checks that a finite `value` lies in [`least`, `most`].
pub(super) fn within(what: &str, value: f64, least: f64, most: f64) -> Result<()> {
    finite(what, &[value])?;
    if (least..=most).contains(&value) {
        return Ok(());
    }
    let limit = format!("between {least:e} and {most:e} in SI units");
    Err(Error::value(what, value, limit, "Check its sign and units."))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPES: [Geometry; 4] = [
        Geometry::Sphere { radius: 0.3 },
        Geometry::Capsule { radius: 0.2, length: 0.7 },
        Geometry::Capsule { radius: 0.2, length: 0.0 },
        Geometry::Box { size: [0.2, 0.5, 0.9] },
    ];

    fn contains(geometry: &Geometry, p: [f64; 3]) -> bool {
        match *geometry {
            Geometry::Sphere { radius } => p.iter().map(|x| x * x).sum::<f64>() <= radius * radius,
            Geometry::Capsule { radius, length } => {
                let z = (p[2].abs() - 0.5 * length).max(0.0);
                p[0] * p[0] + p[1] * p[1] + z * z <= radius * radius
            }
            Geometry::Box { size } => (0..3).all(|k| p[k].abs() <= 0.5 * size[k]),
        }
    }

    fn entries(j: &Inertia) -> [f64; 6] {
        [j.xx, j.yy, j.zz, j.xy, j.xz, j.yz]
    }

    #[test]
    fn volume_and_inertia_are_those_of_numerical_integration() {
        const N: usize = 160;
        let mut worst = [0.0_f64; 2];
        for geometry in SHAPES {
            // midpoints of a grid over a cuboid that just encloses the shape
            let half = match geometry {
                Geometry::Sphere { radius } => [radius; 3],
                Geometry::Capsule { radius, length } => [radius, radius, radius + 0.5 * length],
                Geometry::Box { size } => size.map(|edge| 0.5 * edge),
            };
            let (mut count, mut sums) = (0.0, [0.0; 3]);
            for i in 0..N * N * N {
                let cell = [i % N, i / N % N, i / (N * N)];
                let p: [f64; 3] = std::array::from_fn(|k| half[k] * ((2 * cell[k] + 1) as f64 / N as f64 - 1.0));
                if contains(&geometry, p) {
                    count += 1.0;
                    for k in 0..3 {
                        sums[k] += p[k] * p[k];
                    }
                }
            }
            let volume = count * half.iter().map(|h| 2.0 * h / N as f64).product::<f64>();
            let error = (volume / geometry.volume() - 1.0).abs();
            worst[0] = worst[0].max(error);
            // largest 1.1e-4, the staircase of the grid
            assert!(error < 1e-3, "{geometry:?}: volume off by {error:e}");
            let j = geometry.inertia(2.0);
            let [x, y, z] = sums.map(|s| 2.0 * s / count);
            for (have, want) in [(j.xx, y + z), (j.yy, z + x), (j.zz, x + y)] {
                worst[1] = worst[1].max((have / want - 1.0).abs());
                // largest 7.1e-5
                assert!((have / want - 1.0).abs() < 1e-3, "{geometry:?}: {have} against {want}");
            }
        }
        println!("volume and moments off by {:.1e} and {:.1e}", worst[0], worst[1]);
    }

    #[test]
    fn a_scaled_shape_of_one_density_has_the_cube_of_mass_and_the_fifth_power_of_inertia() {
        for geometry in SHAPES {
            let shape = Shape::new(geometry).at([0.1, -0.2, 0.3]);
            let big = shape.scaled(2.0);
            assert_eq!(big.position, [0.2, -0.4, 0.6]);
            let (m, mm) = (shape.mass(700.0), big.mass(700.0));
            assert!((mm / m - 8.0).abs() < 1e-13, "{geometry:?}");
            let (j, jj) = (entries(&shape.inertia(m)), entries(&big.inertia(mm)));
            for k in 0..3 {
                assert!((jj[k] / j[k] - 32.0).abs() < 1e-12, "{geometry:?}");
            }
            assert!((big.geometry.reach() / geometry.reach() - 2.0).abs() < 1e-14);
        }
    }

    #[test]
    fn a_capsule_without_length_is_a_sphere_and_a_thin_one_is_a_rod() {
        let (ball, point) = (Geometry::Sphere { radius: 0.2 }, Geometry::Capsule { radius: 0.2, length: 0.0 });
        assert!((ball.volume() / point.volume() - 1.0).abs() < 1e-15);
        for k in 0..3 {
            let (a, b) = (entries(&ball.inertia(1.5))[k], entries(&point.inertia(1.5))[k]);
            assert!((a / b - 1.0).abs() < 1e-15, "{a} {b}");
        }
        let rod = Geometry::Capsule { radius: 1e-4, length: 1.0 }.inertia(3.0);
        assert!((rod.xx - 0.25).abs() < 3e-4, "{}", rod.xx);
    }

    #[test]
    fn inertia_turns_with_the_shape() {
        // a quarter turn about x brings the capsule's axis from z to −y
        let h = 0.5_f64.sqrt();
        let capsule = Geometry::Capsule { radius: 0.1, length: 1.0 };
        let (own, j) = (capsule.inertia(1.0), Shape::new(capsule).turned([h, h, 0.0, 0.0]).inertia(1.0));
        for (have, want) in [(j.xx, own.xx), (j.yy, own.zz), (j.zz, own.yy), (j.xy, 0.0), (j.xz, 0.0), (j.yz, 0.0)] {
            assert!((have - want).abs() < 1e-15, "{j:?}");
        }
        j.validate("turned").unwrap();
    }

    #[test]
    fn poses_compose_and_invert() {
        let q = crate::spatial::from_euler(0.3, -0.4, 1.2);
        let outer = Pose { position: [1.0, 2.0, 3.0], attitude: q };
        let shape = Shape::new(SHAPES[0]).at([0.1, 0.2, 0.3]).turned([0.6, 0.0, 0.8, 0.0]);
        let pose = shape.pose(&outer);
        let p = [0.4, -0.5, 0.6];
        let world = pose.point(p);
        let want = outer.point(add(shape.position, rotate(shape.rotation, p)));
        for k in 0..3 {
            assert!((world[k] - want[k]).abs() < 1e-15);
            assert!((pose.local(world)[k] - p[k]).abs() < 1e-15);
        }
    }

    #[test]
    fn shapes_are_toml_and_unknown_keys_are_errors() {
        for geometry in SHAPES {
            let shape = Shape::new(geometry).at([0.1, 0.2, 0.3]).turned([0.6, 0.0, 0.8, 0.0]);
            let text = toml::to_string(&shape).unwrap();
            assert_eq!(toml::from_str::<Shape>(&text).unwrap(), shape, "{text}");
        }
        let least: Shape = toml::from_str("geometry = { capsule = { radius = 0.1, length = 1.0 } }").unwrap();
        assert_eq!(least, Shape::new(Geometry::Capsule { radius: 0.1, length: 1.0 }));
        for text in [
            "geometry = { sphere = { radius = 0.1, colour = 1 } }",
            "geometry = { cone = { radius = 0.1 } }",
            "mass = 1.0\ngeometry = { sphere = { radius = 0.1 } }",
        ] {
            assert!(toml::from_str::<Shape>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn errors_name_shape_value_and_limit() {
        for (shape, start) in [
            (Shape::new(Geometry::Sphere { radius: -1.0 }), "leg: radius is -1, but it must be between 1e-6 and 1e4"),
            (Shape::new(Geometry::Capsule { radius: 0.1, length: f64::NAN }), "leg: length is NaN"),
            (Shape::new(Geometry::Box { size: [1.0, 0.0, 1.0] }), "leg: size[1] is 0"),
            (Shape::new(SHAPES[0]).at([0.0, f64::INFINITY, 0.0]), "leg: position[1] is inf"),
            (Shape::new(SHAPES[0]).turned([1.0, 1.0, 0.0, 0.0]), "leg: rotation is a quaternion of length 1.41"),
        ] {
            let text = shape.validate("leg").unwrap_err().to_string();
            assert!(text.starts_with(start), "{text}");
        }
        for geometry in SHAPES {
            Shape::new(geometry).validate("leg").unwrap();
        }
    }
}
