//! Several models as one: a forest in one environment.

use super::emit::moved as shape_moved;
use super::placement::{Placement, clean, rows};
use crate::shape::Pose;
use crate::tree::{ContactSettings, Model, ModelParts};
use base::error::{Error, Result};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// One model of a group.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// All its names get this and `/` before them, or stay as they are where it is empty; unique within the group.
    pub prefix: String,
    /// What to add.
    pub model: Model,
    /// Where: moves joints to the world, and the starts of floating roots (the joint's `position` and `rotation`, which
    /// the dynamics do not read).
    pub place: Placement,
}

impl Member {
    /// A model at a place.
    pub fn new(prefix: impl Into<String>, model: Model, place: impl Into<Placement>) -> Self {
        Self { prefix: prefix.into(), model, place: place.into() }
    }
}

/// Concatenates models; ground and self-collision are the first member's, the contact material the softest: state and input follow each other, tree by tree, in the order of the members.
///
/// # Errors
/// [`Error::Value`] for no member, a repeated prefix, a place that is none, or gravities that differ; otherwise as
/// [`Model::new`].
pub fn group(name: impl Into<String>, members: &[Member]) -> Result<Model> {
    let name = name.into();
    let at = |what: &str| format!("group '{name}': {what}");
    let Some(first) = members.first() else {
        return Err(Error::value(at("number of members"), 0, "≥ 1", "Add a model."));
    };
    let gravity = first.model.parts().gravity;
    let contact = contact_of(members, first);
    let mut all = ModelParts {
        name: name.clone(),
        gravity,
        bodies: Vec::new(),
        rotors: Vec::new(),
        drones: Vec::new(),
        frames: Vec::new(),
        shapes: Vec::new(),
        contact,
        mesh: Vec::new(),
        pushed: Vec::new(),
        cables: Vec::new(),
    };
    for (i, member) in members.iter().enumerate() {
        member.place.validate(&at(&format!("place of '{}'", member.prefix)))?;
        if members[..i].iter().any(|m| m.prefix == member.prefix) {
            return Err(Error::value(at("prefix"), format!("'{}' twice", member.prefix), "unique", "Rename one."));
        }
        let own = member.model.parts().gravity;
        if own != gravity {
            let what = at(&format!("gravity of '{}'", member.prefix));
            return Err(Error::value(
                what,
                own,
                format!("{gravity}, as of the first"),
                "Build both under one gravity.",
            ));
        }
        append(&mut all, member);
    }
    Model::new(all)
}

fn append(all: &mut ModelParts, member: &Member) {
    let Member { prefix, model, place } = member;
    let (body_0, rotor_0) = (all.bodies.len(), all.rotors.len());
    let named = |name: &str| if prefix.is_empty() { name.into() } else { format!("{prefix}/{name}") };
    let mut own = model.parts().clone();
    for body in &mut own.bodies {
        (body.name, body.joint.name) = (named(&body.name), named(&body.joint.name));
        match &mut body.parent {
            Some(parent) => *parent += body_0,
            None => (body.joint.position, body.joint.rotation) = moved(place, body.joint.position, body.joint.rotation),
        }
    }
    own.pushed.iter_mut().for_each(|body| *body += body_0);
    for rotor in &mut own.rotors {
        rotor.body += body_0;
        rotor.rotor.name = named(&rotor.rotor.name);
    }
    for drone in &mut own.drones {
        (drone.name, drone.body) = (named(&drone.name), drone.body + body_0);
        drone.rotors.iter_mut().for_each(|r| *r += rotor_0);
    }
    for frame in &mut own.frames {
        (frame.name, frame.body) = (named(&frame.name), frame.body + body_0);
    }
    for shape in &mut own.shapes {
        shape.part = named(&shape.part);
        match &mut shape.body {
            Some(body) => *body += body_0,
            None => shape.shape = shape_moved(&shape.shape, &place.isometry()),
        }
    }
    for cable in &mut own.cables {
        cable.name = named(&cable.name);
        for end in &mut cable.ends {
            match &mut end.body {
                Some(body) => *body += body_0,
                None => end.point = (place.isometry() * nalgebra::Point3::from(end.point)).into(),
            }
        }
    }
    all.cables.append(&mut own.cables);
    all.bodies.append(&mut own.bodies);
    all.rotors.append(&mut own.rotors);
    all.drones.append(&mut own.drones);
    all.frames.append(&mut own.frames);
    all.shapes.append(&mut own.shapes);
    let outer = Pose { position: place.position, attitude: place.rotation };
    for mesh in &mut own.mesh {
        let pose = outer.then(&Pose { position: mesh.position, attitude: mesh.rotation });
        mesh.name = named(&mesh.name);
        (mesh.position, mesh.rotation) = (pose.position, pose.attitude);
    }
    all.mesh.append(&mut own.mesh);
    all.pushed.append(&mut own.pushed);
}

/// Ground and flags of the first, the softest material of all: the lightest member sets the step.
fn contact_of(members: &[Member], first: &Member) -> ContactSettings {
    let mut contact = first.model.parts().contact.clone();
    for member in members {
        let own = member.model.parts().contact.material;
        if own.stiffness < contact.material.stiffness {
            contact.material = own;
        }
    }
    contact
}

/// A joint's frame on the world, moved.
fn moved(place: &Placement, position: [f64; 3], rotation: [[f64; 3]; 3]) -> ([f64; 3], [[f64; 3]; 3]) {
    if *place == Placement::IDENTITY {
        return (position, rotation);
    }
    let outer = place.isometry();
    let own = Rotation3::from_matrix_unchecked(Matrix3::from_fn(|i, j| rotation[i][j]));
    let turned = outer.rotation * UnitQuaternion::from_rotation_matrix(&own);
    let at = outer.rotation * Vector3::from(position) + outer.translation.vector;
    (clean(at, 1.0), rows(&turned))
}
