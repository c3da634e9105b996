//! An articulated system as immutable data: bodies in a tree, joints, drives, rotors.
//!
//! Every moving body hangs on its parent, or on the world, by one joint; parents come before children. Fixed joints and
//! universal joints do not occur here: [`Assembly`](crate::assembly::Assembly), which builds models from
//! vehicles and primitives, merges the former and splits the latter into two hinges with a massless body between.

use super::cable::Cable;
use crate::contact::ContactMaterial;
use crate::mesh::Mesh;
use crate::shape::Shape;
use crate::uneven_ground::UnevenGround;
use crate::vehicle::{Drag, Inertia, Rotor};
use serde::{Deserialize, Serialize};

/// Most moving bodies of one model.
pub(crate) const MAX_BODIES: usize = 64;
/// Most rotors of one model.
pub(crate) const MAX_TREE_ROTORS: usize = 64;

/// How a body moves relative to its parent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    /// Freely: six degrees of freedom, on the world only.
    Floating,
    /// About a unit axis through the joint's origin, along which q (rad) counts by the right hand.
    Revolute([f64; 3]),
    /// Along a unit axis, q in m.
    Prismatic([f64; 3]),
    /// About the joint's origin: q is a unit quaternion, child → parent.
    Ball,
}

/// Range of a hinge or slide, beyond which it is pushed back: τ = k δ (1 + d δ̇)₊ for an excess δ, which dissipates and
/// never pulls.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointLimits {
    /// rad or m.
    pub lower: f64,
    /// rad or m.
    pub upper: f64,
    /// k, N m/rad or N/m.
    pub stiffness: f64,
    /// d, s/rad or s/m.
    pub dissipation: f64,
}

/// A servo on a hinge or slide with torque τ = clamp(k (q_target − q) + d (q̇_target − q̇), ±τ_max).
///
/// Its command a ∈ [−1, 1] means the target `center + range · a`: of q̇ where the stiffness is 0 (a rate servo), else of
/// q with q̇_target = 0. Sampled once per integrator step and integrated implicitly: stable for any gains and step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drive {
    /// k, N m/rad or N/m; 0 for a rate servo.
    pub stiffness: f64,
    /// d, N m s/rad or N s/m.
    pub damping: f64,
    /// τ_max, N m or N, > 0.
    pub max_torque: f64,
    /// Target at a = 0.
    pub center: f64,
    /// Change of the target from a = 0 to a = 1.
    pub range: f64,
}

/// What holds a body to its parent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Joint {
    /// Unique within the model.
    pub name: String,
    /// Degrees of freedom.
    pub motion: Motion,
    /// Origin of the joint and of the child's frame, in the parent's frame (or the world), m.
    pub position: [f64; 3],
    /// Rotation matrix by rows, child at q = 0 → parent.
    pub rotation: [[f64; 3]; 3],
    /// Viscous: τ = −d q̇, N m s/rad or N s/m.
    pub damping: f64,
    /// Spring: τ = −k (q − rest), N m/rad or N/m; about a ball joint the moment −k sin θ along the axis of rotation.
    pub stiffness: f64,
    /// q of the relaxed spring, rad or m.
    pub rest: f64,
    /// Inertia of a geared motor seen at a hinge or slide, kg m² or kg: adds to what the joint accelerates and to nothing
    /// else.
    #[serde(default)]
    pub armature: f64,
    /// Range of a hinge or slide.
    pub limits: Option<JointLimits>,
    /// Servo of a hinge or slide.
    pub drive: Option<Drive>,
}

impl Joint {
    /// A free joint at the parent's origin, without damping, spring, limits or drive.
    pub fn new(name: impl Into<String>, motion: Motion) -> Self {
        Self {
            name: name.into(),
            motion,
            position: [0.0; 3],
            rotation: IDENTITY,
            damping: 0.0,
            stiffness: 0.0,
            rest: 0.0,
            armature: 0.0,
            limits: None,
            drive: None,
        }
    }
}

/// The 3×3 identity.
#[doc(hidden)]
pub const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// One rigid moving body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Unique within the model.
    pub name: String,
    /// Number of the body it hangs on, smaller than its own; `None` for the world.
    pub parent: Option<usize>,
    /// How it hangs there.
    pub joint: Joint,
    /// kg; 0 only for a body between two joints.
    pub mass: f64,
    /// In the body's frame, m.
    pub center_of_mass: [f64; 3],
    /// About the centre of mass, along the body's axes, kg m².
    pub inertia: Inertia,
    /// Drag along the body's axes, at its centre of mass.
    pub drag: Drag,
}

/// A rotor and the body that carries it: thrust and reaction torque act on that body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MountedRotor {
    /// Number of the body.
    pub body: usize,
    /// Position and axis in the body's frame.
    pub rotor: Rotor,
}

/// A group of rotors whose wake others feel: one drone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drone {
    /// Unique within the model.
    pub name: String,
    /// The body that wakes push.
    pub body: usize,
    /// Its centre in the body's frame, m: where the wake starts and where others push.
    pub position: [f64; 3],
    /// Numbers of its rotors.
    pub rotors: Vec<usize>,
}

/// A named frame fixed to a moving body: every part that was merged into it keeps its name this way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NamedFrame {
    /// Unique within the model.
    pub name: String,
    /// Number of the body.
    pub body: usize,
    /// Origin in the body's frame, m.
    pub position: [f64; 3],
    /// Rotation matrix by rows, frame → body.
    pub rotation: [[f64; 3]; 3],
}

/// A shape that a body carries, or that stands still in the world, for contact and drawing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[doc(hidden)]
pub struct BodyShape {
    /// Number of the body; `None` for the world.
    pub body: Option<usize>,
    /// Name of the part it belongs to.
    pub part: String,
    /// In the body's frame, or in the world's.
    pub shape: Shape,
    /// Whether it touches others; else it is drawn only.
    pub collides: bool,
    /// Its own, where it is not that of the model: see [`ContactMaterial::against`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<ContactMaterial>,
}

/// What contact is like in an environment; it acts with the effect `contact`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactSettings {
    /// Material of every pair that touches, but for shapes and ground with one of their own. Its numbers are parameters of the model;
    /// where one of the two has its own, the pair's are constants.
    pub material: ContactMaterial,
    /// Height of the ground in the world, m; `None` for no ground.
    pub ground: Option<f64>,
    /// What rises over that height; `None` for level ground.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relief: Option<UnevenGround>,
    /// Material of the ground, where it is not [`material`](Self::material).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ground_material: Option<ContactMaterial>,
    /// Whether bodies of one tree touch each other, those joined to each other apart.
    pub self_collision: bool,
}

impl Default for ContactSettings {
    /// Ground at z = 0, the default material, no contact within a tree.
    fn default() -> Self {
        Self {
            material: ContactMaterial::default(),
            ground: Some(0.0),
            relief: None,
            ground_material: None,
            self_collision: false,
        }
    }
}

/// The parts of a [`Model`](super::Model) before they are checked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelParts {
    /// As in the registry and in messages.
    pub name: String,
    /// m/s², downwards.
    pub gravity: f64,
    /// Parents first; the bodies of one root and its descendants follow each other.
    pub bodies: Vec<Body>,
    /// In the order of their commands; those of one root's tree follow each other, in the order of the roots.
    pub rotors: Vec<MountedRotor>,
    /// Sources of wakes.
    pub drones: Vec<Drone>,
    /// Named points.
    pub frames: Vec<NamedFrame>,
    /// For contact and drawing.
    #[serde(default)]
    pub shapes: Vec<BodyShape>,
    /// Ground, material, what may touch what.
    #[serde(default)]
    pub contact: ContactSettings,
    /// Stand still in the world for sensors alone: nothing touches them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub mesh: Vec<Mesh>,
    /// Bodies that take force and moment of their tree's disturbance in place of the root, at their centre of mass; one
    /// per tree.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pushed: Vec<usize>,
    /// What pulls points together where they are too far apart.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cables: Vec<Cable>,
}

/// Number of the root that each body descends from.
pub(crate) fn root_of(bodies: &[Body]) -> Vec<usize> {
    let mut roots = Vec::with_capacity(bodies.len());
    for (i, body) in bodies.iter().enumerate() {
        roots.push(body.parent.map_or(i, |p| roots[p]));
    }
    roots
}
