//! Every link's frame, mass and inertia in the base frame, with all joints at zero.

use super::fault::{clean, fault, few, in_file};
use super::tree::Tree;
use crate::assembly::{Placement, WORLD};
use crate::shape::{Geometry, Pose, Shape};
use crate::spatial::multiply;
use crate::vehicle::Inertia;
use base::error::Result;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use std::collections::HashMap;

/// A link in the base frame (the root link's frame).
pub(super) struct Body {
    pub name: String,
    pub line: u32,
    /// Origin of the link frame, m.
    pub origin: Vector3<f64>,
    /// Link frame → base frame.
    pub rotation: Matrix3<f64>,
    /// kg.
    pub mass: f64,
    /// Centre of mass, m.
    pub center_of_mass: Vector3<f64>,
    /// About the centre of mass, base axes, kg m².
    pub inertia: Inertia,
    /// Joint that carries the link; `None` for the root.
    pub joint: Option<Joint>,
    /// What of its collision geometry the library has, in the link's frame.
    pub shapes: Vec<Shape>,
    /// How many of its collision geometries the library has not: meshes.
    pub meshes: usize,
    /// How many of them are cylinders, which stand among `shapes` by what fits into them.
    pub cylinders: usize,
}

/// The joint of a [`Body`].
pub(super) struct Joint {
    pub name: String,
    pub line: u32,
    pub kind: String,
    pub fixed: bool,
    /// Base axes, not normalised.
    pub axis: Vector3<f64>,
    /// Index of the parent body.
    pub parent: usize,
    /// Of the joint's frame in the parent's.
    pub place: Placement,
    /// In the joint's frame, not normalised.
    pub own_axis: [f64; 3],
    /// Of `<limit>`, 0 where absent; rad or m.
    pub range: [f64; 2],
    /// Whether `<limit>` bounds effort or rate.
    pub bounded: bool,
    /// Of `<dynamics>`, N m s/rad or N s/m.
    pub damping: f64,
    /// Of `<dynamics>`, N m or N.
    pub friction: f64,
    /// The joint that it mimics.
    pub mimics: Option<String>,
}

impl Joint {
    /// Its limits, in words, where rest at zero is beyond them.
    pub fn never_at_zero(&self) -> Option<String> {
        let unit = match self.kind.as_str() {
            "revolute" => "rad",
            "prismatic" => "m",
            _ => return None,
        };
        let [lower, upper] = self.range;
        (lower > 0.0 || upper < 0.0).then(|| format!("limits of {lower} to {upper} {unit}"))
    }
}

/// Limits beyond which there is none, SI: files write 1e16 for "no limit".
pub(super) const NO_LIMIT: f64 = 1e6;

impl Body {
    /// Whether it is the root that stands still in a model; files write it `World` and `WORLD`, too.
    pub fn is_world(&self) -> bool {
        self.joint.is_none() && self.name.eq_ignore_ascii_case(WORLD)
    }

    pub fn has_inertia(&self) -> bool {
        self.inertia != Inertia::zero()
    }

    /// Its collision shapes in the base frame.
    pub fn shapes_in_base(&self) -> impl Iterator<Item = Shape> + '_ {
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(self.rotation));
        let frame = Pose { position: self.origin.into(), attitude: [q.w, q.i, q.j, q.k] };
        self.shapes.iter().map(move |shape| {
            let Pose { position, attitude } = shape.pose(&frame);
            Shape { geometry: shape.geometry, position, rotation: attitude }
        })
    }

    /// Moment of inertia about an axis of unit length through `point`, base frame, kg m².
    pub fn moment_about(&self, point: &Vector3<f64>, axis: &Vector3<f64>) -> f64 {
        axis.dot(&(self.inertia.matrix() * axis)) + self.mass * (self.center_of_mass - point).cross(axis).norm_squared()
    }
}

/// A word on what of the joints and of the collision geometry has no counterpart; `held` are the bodies whose joints do not
/// move.
pub(super) fn left_out(bodies: &[Body], held: impl Fn(usize) -> bool) -> Vec<String> {
    let mut said = Vec::new();
    let having = |number: fn(&Body) -> usize| {
        let odd: Vec<&Body> = bodies.iter().filter(|b| number(b) > 0).collect();
        let names: Vec<&str> = odd.iter().map(|b| b.name.as_str()).collect();
        let count: usize = odd.iter().map(|b| number(b)).sum();
        (count > 0).then(|| format!("({count}) in the collision geometry of {}", few(&names)))
    };
    if let Some(whose) = having(|b| b.cylinders) {
        said.push(format!(
            "The cylinders {whose} touch by what fits into them: two boxes turned by 45°, which stand on eight points of \
             the rim, and where longer than wide a capsule, which rolls."
        ));
    }
    if let Some(whose) = having(|b| b.meshes) {
        said.push(format!(
            "The meshes {whose} touch nothing, since none is opened: use boxes, cylinders, spheres or capsules."
        ));
    }
    let bounded = |(i, b): (usize, &Body)| {
        let joint = b.joint.as_ref().filter(|j| !j.fixed && j.bounded && !held(i));
        joint.map(|j| j.name.clone())
    };
    let names: Vec<String> = bodies.iter().enumerate().filter_map(bounded).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    if !names.is_empty() {
        said.push(format!(
            "The limits of effort and velocity of joints {} are left out: rotors are bounded by their own data, and URDF \
             names no other motor.",
            few(&names)
        ));
    }
    said
}

/// `R = Rz(yaw) Ry(pitch) Rx(roll)` of a URDF origin, and its offset.
fn pose(pose: &urdf_rs::Pose) -> (Matrix3<f64>, Vector3<f64>) {
    let [roll, pitch, yaw] = pose.rpy.0;
    (*Rotation3::from_euler_angles(roll, pitch, yaw).matrix(), Vector3::from(pose.xyz.0))
}

/// The same for the builder of models.
fn placement(pose: &urdf_rs::Pose) -> Placement {
    let [roll, pitch, yaw] = pose.rpy.0;
    let q = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    Placement { position: pose.xyz.0, rotation: [q.w, q.i, q.j, q.k] }
}

/// A link's collision geometry in shapes that touch, and how many meshes and cylinders it has.
fn shapes(link: &urdf_rs::Link) -> (Vec<Shape>, [usize; 2]) {
    let (mut shapes, mut meshes, mut cylinders) = (Vec::new(), 0, 0);
    for collision in &link.collision {
        let Placement { position, rotation } = placement(&collision.origin);
        let here = |geometry| Shape { geometry, position, rotation };
        match &collision.geometry {
            urdf_rs::Geometry::Box { size } => shapes.push(here(Geometry::Box { size: size.0 })),
            urdf_rs::Geometry::Sphere { radius } => shapes.push(here(Geometry::Sphere { radius: *radius })),
            urdf_rs::Geometry::Capsule { radius, length } => {
                shapes.push(here(Geometry::Capsule { radius: *radius, length: *length }));
            }
            urdf_rs::Geometry::Cylinder { radius, length } => {
                shapes.extend(within_cylinder(*radius, *length, &here));
                cylinders += 1;
            }
            urdf_rs::Geometry::Mesh { .. } => meshes += 1,
        }
    }
    (shapes, [meshes, cylinders])
}

/// What fits into a cylinder along z: two boxes with their long edges on its side, turned by 45° against each other, and, where
/// it is longer than wide, a capsule between its ends.
fn within_cylinder(radius: f64, length: f64, here: &impl Fn(Geometry) -> Shape) -> Vec<Shape> {
    let edge = std::f64::consts::SQRT_2 * radius;
    let block = here(Geometry::Box { size: [edge, edge, length] });
    let (s, c) = std::f64::consts::FRAC_PI_8.sin_cos();
    let mut shapes = vec![block, block.turned(multiply(block.rotation, [c, 0.0, 0.0, s]))];
    if length > 2.0 * radius {
        shapes.push(here(Geometry::Capsule { radius, length: length - 2.0 * radius }));
    }
    shapes
}

/// Places all links, in the order of the file.
pub(super) fn place(robot: &urdf_rs::Robot, tree: &Tree, file: &str) -> Result<Vec<Body>> {
    let links: HashMap<&str, &urdf_rs::Link> = robot.links.iter().map(|l| (l.name.as_str(), l)).collect();
    let joints: HashMap<&str, &urdf_rs::Joint> = robot.joints.iter().map(|j| (j.name.as_str(), j)).collect();
    let mut bodies: Vec<Option<Body>> = tree.links.iter().map(|_| None).collect();
    for &index in &tree.order {
        let Some(site) = tree.links.get(index) else { continue };
        let lost = || fault(file, format!("line {}", site.line), "urdf-rs read other names", "Use plain names.");
        let link = links.get(site.name.as_str()).ok_or_else(lost)?;
        let (mut rotation, mut origin, mut joint) = (Matrix3::identity(), Vector3::zeros(), None);
        if let Some(at) = site.joint.and_then(|j| tree.joints.get(j)) {
            let data = joints.get(at.name.as_str()).ok_or_else(lost)?;
            let parent = bodies.get(at.parent).and_then(Option::as_ref).ok_or_else(lost)?;
            let (turn, offset) = pose(&data.origin);
            origin = parent.origin + parent.rotation * offset;
            rotation = parent.rotation * turn;
            joint = Some(Joint {
                name: at.name.clone(),
                line: at.line,
                kind: at.kind.clone(),
                fixed: at.is_fixed(),
                axis: rotation * Vector3::from(data.axis.xyz.0),
                parent: at.parent,
                place: placement(&data.origin),
                own_axis: data.axis.xyz.0,
                range: [data.limit.lower, data.limit.upper],
                bounded: [data.limit.effort, data.limit.velocity].iter().any(|x| *x > 0.0 && *x < NO_LIMIT),
                damping: data.dynamics.as_ref().map_or(0.0, |d| d.damping),
                friction: data.dynamics.as_ref().map_or(0.0, |d| d.friction),
                mimics: data.mimic.as_ref().map(|m| m.joint.clone()),
            });
        }
        let body = body(link, site.line, (rotation, origin), joint, file)?;
        if let Some(slot) = bodies.get_mut(index) {
            *slot = Some(body);
        }
    }
    Ok(bodies.into_iter().flatten().collect())
}

fn body(
    link: &urdf_rs::Link,
    line: u32,
    (rotation, origin): (Matrix3<f64>, Vector3<f64>),
    joint: Option<Joint>,
    file: &str,
) -> Result<Body> {
    let place = format!("line {line}, link '{}'", clean(&link.name));
    let mass = link.inertial.mass.value;
    if mass < 0.0 {
        let rule = format!("the mass is {mass} kg, but it must be ≥ 0");
        return Err(fault(file, place, rule, "Correct the sign."));
    }
    let i = &link.inertial.inertia;
    let own = Inertia { xx: i.ixx, yy: i.iyy, zz: i.izz, xy: i.ixy, xz: i.ixz, yz: i.iyz };
    own.validate("it").map_err(|e| in_file(e, file, &place))?;
    let (turn, offset) = pose(&link.inertial.origin);
    let to_base = rotation * turn;
    let (shapes, [meshes, cylinders]) = shapes(link);
    Ok(Body {
        shapes,
        meshes,
        cylinders,
        name: link.name.clone(),
        line,
        origin,
        rotation,
        mass,
        center_of_mass: origin + rotation * offset,
        inertia: turned(&own, &to_base),
        joint,
    })
}

/// R J Rᵀ, exact where R is the identity.
fn turned(own: &Inertia, rotation: &Matrix3<f64>) -> Inertia {
    if *rotation == Matrix3::identity() {
        return *own;
    }
    let full = rotation * own.matrix() * rotation.transpose();
    Inertia::from_matrix(&((full + full.transpose()) * 0.5))
}

/// Total mass, kg.
pub(super) fn total_mass(bodies: &[Body]) -> f64 {
    bodies.iter().map(|b| b.mass).sum()
}

/// Hub positions of rotor links: the frames' origins, or, where these all coincide while the centres of mass differ,
/// the centres of mass (gym-pybullet-drones writes them so). True where the second rule was used.
pub(super) fn hubs(rotors: &[&Body]) -> (Vec<Vector3<f64>>, bool) {
    let apart = |a: &Vector3<f64>, b: &Vector3<f64>| (a - b).norm() > 1e-6;
    let pairs = || rotors.iter().enumerate().flat_map(|(i, a)| rotors.iter().skip(i + 1).map(move |b| (*a, *b)));
    let by_mass = rotors.len() > 1
        && pairs().all(|(a, b)| !apart(&a.origin, &b.origin) && apart(&a.center_of_mass, &b.center_of_mass));
    (rotors.iter().map(|b| if by_mass { b.center_of_mass } else { b.origin }).collect(), by_mass)
}
