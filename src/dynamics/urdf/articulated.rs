//! Links and joints through the assembly: a URDF as a model whose joints move.

use super::bodies::{Body, Joint, NO_LIMIT, left_out, total_mass};
use super::fault::{clean, fault, few, in_file};
use super::import::{Read, check_part_names, read, read_files};
use super::options::ImportOptions;
use super::rotors::RotorFile;
use super::{Warning, resolve};
use crate::assembly::{Assembly, JointKind, JointSpec, Solid, WORLD};
use crate::tree::Model;
use crate::vehicle::{Inertia, Rotor};
use base::error::Result;
use nalgebra::{Matrix3, Vector3};
use std::path::Path;

/// What an import of a model gives.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelImport {
    /// The articulated system.
    pub model: Model,
    /// What of the file was probably not meant.
    pub warnings: Vec<Warning>,
    /// Everything that was concluded rather than read, one sentence each.
    pub assumptions: Vec<String>,
}

/// Reads a URDF file and its rotor file, found as by [`import_file`](super::import_file), as a model; it may have no
/// rotors at all.
///
/// # Errors
/// [`Error::File`](base::error::Error::File) where a file cannot be read; otherwise as [`import_model_text`].
pub fn import_model_file(path: impl AsRef<Path>, options: &ImportOptions) -> Result<ModelImport> {
    let (text, file, rotors) = read_files(path.as_ref(), options)?;
    import_model_text(&text, &file, rotors.as_ref(), options)
}

/// Reads a URDF text as a model.
///
/// - revolute, continuous, prismatic and spherical joints move, with the damping of `<dynamics>` and, where `<limit>`
///   gives a range, soft stops; they are passive, since URDF names no motor. Fixed links are merged and keep their names
///   as frames.
/// - The root link floats, unless it is called `world`: then it stands still, and a joint of type floating under it
///   frees its child.
/// - Rotors come from the rotor file or `<properties>`, mounted on their links (those without a link on the root), given
///   in the base frame with all joints at zero; joints of rotor links are held, since rotor speed is a state of its own.
///   All rotors are one drone, centred on the root link.
///
/// # Errors
/// As [`import_text`](super::import_text); planar joints, and floating ones elsewhere, name their line.
pub fn import_model_text(
    text: &str,
    file_name: &str,
    rotors: Option<&RotorFile>,
    options: &ImportOptions,
) -> Result<ModelImport> {
    let mut read = read(text, file_name, options)?;
    if total_mass(&read.bodies) <= 0.0 {
        let rule = "no link has a mass: the total is 0 kg, but it must be > 0";
        return Err(fault(file_name, "<robot>", rule, "Give the links an <inertial> with mass and inertia."));
    }
    if let Some(file) = rotors {
        check_part_names(&read.bodies, file)?;
    }
    let mounts = mounts(&mut read, rotors)?;
    remark(&mut read, &mounts);
    let name = rotors.and_then(|f| f.name.clone()).unwrap_or_else(|| read.name());
    let mut assembly = Assembly::new(name.clone());
    links(&mut assembly, &read, &mounts, rotors);
    joints(&mut assembly, &read, &mounts)?;
    extras(&mut assembly, &read, rotors);
    let carriers: Vec<String> = mounts.iter().filter_map(|m| read.bodies.get(m.body)).map(|b| b.name.clone()).collect();
    if let (Some(root), Some(first)) = (root(&read.bodies), carriers.first()) {
        let center = if root.is_world() { first.clone() } else { root.name.clone() };
        assembly.drone(name, center, [0.0; 3], carriers);
        assembly.rotor_order(mounts.iter().map(|m| m.rotor.name.clone()));
    }
    let model = assembly.model().map_err(|e| in_file(e, file_name, "<robot>"))?;
    Ok(ModelImport { model, warnings: read.warnings, assumptions: read.assumptions })
}

/// A rotor and the link that carries it.
struct Mount {
    /// Index of the body.
    body: usize,
    /// Whether the link is the rotor, so that its joint is held.
    is_link: bool,
    /// In the link's frame.
    rotor: Rotor,
}

fn root(bodies: &[Body]) -> Option<&Body> {
    bodies.iter().find(|b| b.joint.is_none())
}

/// Rotors in the order of the action vector, each in the frame of its link.
fn mounts(read: &mut Read, file: Option<&RotorFile>) -> Result<Vec<Mount>> {
    let links: Vec<Option<usize>> = match (file, &read.properties) {
        (Some(file), _) => resolve::links(file, &read.bodies)?,
        (None, Some(properties)) => properties.links(&read.file, &read.bodies)?.into_iter().map(Some).collect(),
        (None, None) => {
            read.assumptions.push("There is no rotor file: the model has no rotors.".into());
            return Ok(Vec::new());
        }
    };
    let rotors = read.rotors(file)?;
    let base = read.bodies.iter().position(|b| b.joint.is_none()).unwrap_or(0);
    let mut mounts = Vec::with_capacity(rotors.len());
    for (rotor, link) in rotors.into_iter().zip(links) {
        let body = link.unwrap_or(base);
        let Some(on) = read.bodies.get(body) else { continue };
        let back = on.rotation.transpose();
        let position = (back * (Vector3::from(rotor.position) - on.origin)).into();
        let axis = (back * Vector3::from(rotor.axis)).into();
        mounts.push(Mount { body, is_link: link.is_some(), rotor: Rotor { position, axis, ..rotor } });
    }
    Ok(mounts)
}

fn is_rotor(mounts: &[Mount], body: usize) -> bool {
    mounts.iter().any(|m| m.body == body && m.is_link)
}

/// A word on everything that is in the file but not in the model.
fn remark(read: &mut Read, mounts: &[Mount]) {
    let moving = |(i, b): (usize, &Body)| {
        let joint = b.joint.as_ref().filter(|j| !j.fixed && j.kind != "floating" && !is_rotor(mounts, i));
        joint.map(|j| j.name.clone())
    };
    let names: Vec<String> = read.bodies.iter().enumerate().filter_map(moving).collect();
    if !names.is_empty() {
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        read.assumptions.push(format!("Joints {} are passive: URDF names no motor.", few(&names)));
    }
    let said = left_out(&read.bodies, |i| is_rotor(mounts, i));
    read.assumptions.extend(said);
    let mut odd = Vec::new();
    for (i, body) in read.bodies.iter().enumerate() {
        let Some(joint) = body.joint.as_ref().filter(|j| !j.fixed && !is_rotor(mounts, i)) else { continue };
        let element = format!("joint '{}'", clean(&joint.name));
        if joint.friction != 0.0 {
            let rule = format!("a dry friction of {}", joint.friction);
            odd.push((joint.line, element.clone(), rule, "It is left out: joints have viscous damping only."));
        }
        if let Some(other) = &joint.mimics {
            let rule = format!("it mimics joint '{}'", clean(other));
            odd.push((joint.line, element, rule, "It moves by itself here: joints are not coupled."));
        }
    }
    for (line, element, rule, remedy) in odd {
        read.warn(line, element, rule, remedy);
    }
}

/// One part per link, rotors and shapes on it.
fn links(assembly: &mut Assembly, read: &Read, mounts: &[Mount], file: Option<&RotorFile>) {
    for (i, body) in read.bodies.iter().enumerate() {
        let is_root = body.joint.is_none();
        if body.is_world() {
            continue;
        }
        let back = body.rotation.transpose();
        let center = back * (body.center_of_mass - body.origin);
        let mut solid = Solid::explicit(body.mass, center.into(), turned(&body.inertia, &back));
        solid = body.shapes.iter().fold(solid, |solid, shape| solid.and(*shape));
        for mount in mounts.iter().filter(|m| m.body == i) {
            solid = solid.rotor(mount.rotor.clone());
        }
        if let Some(file) = file.filter(|_| is_root) {
            solid = solid.drag(file.drag);
        }
        assembly.part(&body.name, solid);
    }
}

/// R J Rᵀ, exact where R is the identity.
fn turned(own: &Inertia, rotation: &Matrix3<f64>) -> Inertia {
    if *rotation == Matrix3::identity() {
        return *own;
    }
    Inertia::from_matrix(&(rotation * own.matrix() * rotation.transpose()))
}

fn joints(assembly: &mut Assembly, read: &Read, mounts: &[Mount]) -> Result<()> {
    for (i, body) in read.bodies.iter().enumerate() {
        let Some(joint) = &body.joint else { continue };
        let Some(parent) = read.bodies.get(joint.parent) else { continue };
        let kind = if is_rotor(mounts, i) { JointKind::Fixed } else { kind(joint, parent, &read.file)? };
        let carrier = if parent.is_world() { WORLD } else { &parent.name };
        let mut join = JointSpec::new(&joint.name, kind, carrier, &body.name).at(joint.place);
        if kind != JointKind::Fixed {
            join = join.damping(joint.damping);
        }
        let [lower, upper] = joint.range;
        let bounded = lower != upper && lower.abs().min(upper.abs()) < NO_LIMIT;
        if bounded && joint.kind != "continuous" && matches!(kind, JointKind::Revolute(_) | JointKind::Prismatic(_)) {
            join = join.range(lower, upper);
        }
        assembly.join(join);
    }
    Ok(())
}

fn kind(joint: &Joint, parent: &Body, file: &str) -> Result<JointKind> {
    let place = || format!("line {}, joint '{}'", joint.line, clean(&joint.name));
    match joint.kind.as_str() {
        "fixed" => Ok(JointKind::Fixed),
        "revolute" | "continuous" => Ok(JointKind::Revolute(joint.own_axis)),
        "prismatic" => Ok(JointKind::Prismatic(joint.own_axis)),
        "spherical" => Ok(JointKind::Ball),
        "floating" if parent.is_world() => Ok(JointKind::Floating),
        "floating" => {
            let rule = "a floating joint under a link that moves";
            Err(fault(file, place(), rule, "Only a root link called 'world' lets others float: use two files."))
        }
        other => {
            let rule = format!("a joint of type '{}' has no counterpart", clean(other));
            Err(fault(file, place(), rule, "Write a planar joint as two prismatic ones and a revolute one."))
        }
    }
}

/// Masses that only the rotor file has, welded to the root.
fn extras(assembly: &mut Assembly, read: &Read, file: Option<&RotorFile>) {
    let Some(root) = root(&read.bodies) else { return };
    for part in file.iter().flat_map(|f| &f.parts) {
        assembly.part(&part.name, Solid::explicit(part.mass, part.position, part.inertia));
        assembly.join(JointSpec::new(format!("weld of {}", part.name), JointKind::Fixed, &root.name, &part.name));
    }
}
