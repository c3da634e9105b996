//! A checked articulated system, and where its numbers stand.

pub use super::parts::*;

use super::cable::{Cable, CableEnd};
use super::layout::Layout;
use crate::spatial::from_matrix;
use base::error::{Error, Result, finite};

/// A checked articulated system: a forest of bodies whose roots hang on the world.
///
/// Immutable. States and inputs are flat slices whose places [`Model::layout`] knows.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    parts: ModelParts,
    layout: Layout,
}

impl Model {
    /// Checks the parts and lays out state and input.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] naming the body, joint or rotor: parents after children, no mass at a leaf,
    /// axes that are not unit vectors, limits that cross, drives without torque bound, repeated names, too many bodies.
    pub fn new(parts: ModelParts) -> Result<Self> {
        Check { parts: &parts }.run()?;
        Ok(Self { layout: Layout::of(&parts), parts })
    }

    /// As in the registry.
    pub fn name(&self) -> &str {
        &self.parts.name
    }

    /// All parts, as given.
    pub fn parts(&self) -> &ModelParts {
        &self.parts
    }

    /// The bodies, parents first.
    pub fn bodies(&self) -> &[Body] {
        &self.parts.bodies
    }

    /// The rotors, in the order of their commands.
    pub fn rotors(&self) -> &[MountedRotor] {
        &self.parts.rotors
    }

    /// Sources of wakes.
    pub fn drones(&self) -> &[Drone] {
        &self.parts.drones
    }

    /// Shapes for contact and drawing.
    pub fn shapes(&self) -> &[BodyShape] {
        &self.parts.shapes
    }

    /// What pulls points together where they are too far apart.
    pub fn cables(&self) -> &[Cable] {
        &self.parts.cables
    }

    /// The same model with more cables.
    ///
    /// # Errors
    /// As [`Model::new`]: ends on no body or on one, numbers out of bounds, repeated names.
    pub fn with_cables(&self, cables: impl IntoIterator<Item = Cable>) -> Result<Self> {
        let mut parts = self.parts.clone();
        parts.cables.extend(cables);
        Self::new(parts)
    }

    /// Places of all numbers in state and input.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Σ mᵢ, kg.
    pub fn mass(&self) -> f64 {
        self.parts.bodies.iter().map(|b| b.mass).sum()
    }

    /// Number of a body.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest name.
    pub fn body(&self, name: &str) -> Result<usize> {
        find("body", name, self.parts.bodies.iter().map(|b| &b.name))
    }

    /// Number of the body that a joint moves.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest name.
    pub fn joint(&self, name: &str) -> Result<usize> {
        find("joint", name, self.parts.bodies.iter().map(|b| &b.joint.name))
    }

    /// Number of a rotor.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest name.
    pub fn rotor(&self, name: &str) -> Result<usize> {
        find("rotor", name, self.parts.rotors.iter().map(|r| &r.rotor.name))
    }

    /// A named frame: a body's own, or that of a part merged into one.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest name.
    pub fn frame(&self, name: &str) -> Result<NamedFrame> {
        if let Some(frame) = self.parts.frames.iter().find(|f| f.name == name) {
            return Ok(frame.clone());
        }
        let names = self.parts.frames.iter().map(|f| &f.name).chain(self.parts.bodies.iter().map(|b| &b.name));
        let at = find("frame", name, names)? - self.parts.frames.len();
        Ok(NamedFrame { name: name.into(), body: at, position: [0.0; 3], rotation: IDENTITY })
    }
}

impl Cable {
    /// Of `length` m, 2 kN/m and 1 s/m, between the origins of two named frames of a model.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest name.
    pub fn between(model: &Model, name: impl Into<String>, ends: [&str; 2], length: f64) -> Result<Self> {
        let end = |name: &str| model.frame(name).map(|f| CableEnd { body: Some(f.body), point: f.position });
        let ends = [end(ends[0])?, end(ends[1])?];
        Ok(Self { name: name.into(), ends, length, stiffness: 2000.0, dissipation: 1.0 })
    }
}

/// Every joint at rest (springs relaxed, position drives at their centre, else zero), every floating root where its joint
/// says (the world's origin, upright, unless it was placed), rotors still: `[n_state]`.
pub fn rest_state(model: &Model) -> Vec<f64> {
    let mut x = vec![0.0; model.layout().n_state()];
    for (body, place) in model.bodies().iter().zip(&model.layout().bodies) {
        let joint = &body.joint;
        match joint.motion {
            Motion::Floating => {
                x[place.position..place.position + 3].copy_from_slice(&joint.position);
                x[place.position + 6..place.position + 10].copy_from_slice(&from_matrix(joint.rotation));
            }
            Motion::Ball => x[place.position] = 1.0,
            Motion::Revolute(_) | Motion::Prismatic(_) => {
                x[place.position] = match joint.drive {
                    Some(drive) if drive.stiffness > 0.0 => drive.center,
                    _ => joint.rest,
                };
            }
        }
    }
    x
}

fn find<'a>(kind: &'static str, name: &str, names: impl Iterator<Item = &'a String> + Clone) -> Result<usize> {
    let known = || names.clone().cloned().collect();
    names.clone().position(|n| n == name).ok_or_else(|| Error::Unknown { kind, name: name.into(), known: known() })
}

/// The checks of [`Model::new`].
struct Check<'a> {
    parts: &'a ModelParts,
}

impl Check<'_> {
    fn run(&self) -> Result<()> {
        let p = self.parts;
        finite(&self.at("gravity"), &[p.gravity])?;
        if p.gravity < 0.0 {
            let remedy = "It counts downwards: give 9.81 for Earth, 0 for none.";
            return Err(Error::value(self.at("gravity"), p.gravity, "≥ 0 m/s²", remedy));
        }
        for (what, n, least, most) in [
            ("number of bodies", p.bodies.len(), 1, MAX_BODIES),
            ("number of rotors", p.rotors.len(), 0, MAX_TREE_ROTORS),
        ] {
            if n < least || n > most {
                let remedy = "Merge parts that move together, or split the system.";
                return Err(Error::limit(self.at(what), n, format!("{least} to {most}"), remedy));
            }
        }
        unique(&self.at("bodies"), p.bodies.iter().map(|b| &b.name))?;
        unique(&self.at("joints"), p.bodies.iter().map(|b| &b.joint.name))?;
        unique(&self.at("rotors"), p.rotors.iter().map(|r| &r.rotor.name))?;
        unique(&self.at("drones"), p.drones.iter().map(|d| &d.name))?;
        unique(&self.at("frames"), p.frames.iter().map(|f| &f.name))?;
        unique(&self.at("cables"), p.cables.iter().map(|c| &c.name))?;
        p.cables.iter().try_for_each(|cable| cable.validate(&self.at(""), p.bodies.len()))?;
        for number in 0..p.bodies.len() {
            self.body(number)?;
        }
        self.order()?;
        for rotor in &p.rotors {
            self.exists("rotor", &rotor.rotor.name, rotor.body)?;
            rotor.rotor.validate(&self.at(""))?;
        }
        for frame in &p.frames {
            self.exists("frame", &frame.name, frame.body)?;
            finite(&self.at(&format!("frame '{}': position", frame.name)), &frame.position)?;
            self.rotation(&format!("frame '{}'", frame.name), &frame.rotation)?;
        }
        for body in &p.pushed {
            self.exists("pushed body", "", *body)?;
        }
        for shape in &p.shapes {
            self.exists("shape", &shape.part, shape.body.unwrap_or(0))?;
            let what = self.at(&format!("shape of '{}'", shape.part));
            shape.shape.validate(&what)?;
            shape.material.map_or(Ok(()), |m| m.validate(&format!("{what}: material")))?;
        }
        p.contact.material.validate(&self.at("contact.material"))?;
        let of_ground = p.contact.ground_material;
        of_ground.map_or(Ok(()), |m| m.validate(&self.at("contact.ground_material")))?;
        finite(&self.at("contact.ground"), &[p.contact.ground.unwrap_or(0.0)])?;
        unique(&self.at("meshes"), p.mesh.iter().map(|mesh| &mesh.name))?;
        p.mesh.iter().try_for_each(|mesh| mesh.validate(&self.at(&format!("mesh '{}'", mesh.name))))?;
        p.contact.relief.as_ref().map_or(Ok(()), |r| r.validate(&self.at("contact.relief")))?;
        for drone in &p.drones {
            self.exists("drone", &drone.name, drone.body)?;
            finite(&self.at(&format!("drone '{}': position", drone.name)), &drone.position)?;
            if p.drones.iter().filter(|d| d.body == drone.body).count() > 1 {
                let what = self.at(&format!("drone '{}': body", drone.name));
                return Err(Error::value(what, drone.body, "the body of no other drone", "Merge the two drones."));
            }
            if let Some(r) = drone.rotors.iter().find(|r| **r >= p.rotors.len()) {
                let what = self.at(&format!("drone '{}': rotor", drone.name));
                return Err(Error::value(what, r, format!("below {}", p.rotors.len()), "Rotors count from 0."));
            }
        }
        Ok(())
    }

    fn at(&self, what: &str) -> String {
        format!("model '{}': {what}", self.parts.name)
    }

    fn exists(&self, kind: &str, name: &str, body: usize) -> Result<()> {
        let n = self.parts.bodies.len();
        if body < n {
            return Ok(());
        }
        Err(Error::value(
            self.at(&format!("{kind} '{name}': body")),
            body,
            format!("below {n}"),
            "Bodies count from 0.",
        ))
    }

    fn body(&self, number: usize) -> Result<()> {
        let body = &self.parts.bodies[number];
        let at = |what: &str| self.at(&format!("body '{}': {what}", body.name));
        if let Some(parent) = body.parent
            && parent >= number
        {
            let remedy = "List parents before their children; a loop of bodies is not a tree.";
            return Err(Error::value(at("parent"), parent, format!("below its own number {number}"), remedy));
        }
        finite(&at("mass"), &[body.mass])?;
        finite(&at("center_of_mass"), &body.center_of_mass)?;
        if !(0.0..=1e6).contains(&body.mass) {
            return Err(Error::value(at("mass"), body.mass, "between 0 and 1e6 kg", "Check the units."));
        }
        body.inertia.validate(&self.at(&format!("body '{}'", body.name)))?;
        let drag = &body.drag;
        for (what, values) in [("linear", drag.linear), ("quadratic", drag.quadratic), ("angular", drag.angular)] {
            finite(&at(&format!("drag.{what}")), &values)?;
            if let Some(v) = values.iter().find(|v| **v < 0.0) {
                return Err(Error::value(at(&format!("drag.{what}")), v, "≥ 0", "Drag dissipates: check the sign."));
            }
        }
        self.moves_with_inertia(number)?;
        self.joint(number)
    }

    /// A joint acceleration exists only if what hangs on the joint has inertia along it.
    fn moves_with_inertia(&self, number: usize) -> Result<()> {
        let bodies = &self.parts.bodies;
        let body = &bodies[number];
        let is_leaf = !bodies.iter().any(|b| b.parent == Some(number));
        let at = |what: &str| self.at(&format!("body '{}': {what}", body.name));
        if body.mass <= 0.0 && (is_leaf || matches!(body.joint.motion, Motion::Floating)) {
            let remedy = "Give it its mass, or weld it to its neighbour.";
            return Err(Error::value(at("mass"), body.mass, "> 0 kg: nothing with mass hangs on its joint", remedy));
        }
        let lightest = body.inertia.matrix().symmetric_eigenvalues().min();
        let turns = matches!(body.joint.motion, Motion::Floating | Motion::Revolute(_) | Motion::Ball);
        if is_leaf && turns && self.moment_about_joint(number) <= 0.0 {
            let remedy = "Give it an inertia tensor, or move its centre of mass off the axis.";
            let value = format!("{lightest:.3e} kg m² about its joint");
            return Err(Error::value(at("inertia"), value, "> 0 about the axis that it turns about", remedy));
        }
        Ok(())
    }

    /// Smallest moment of inertia of a body about the axes of its joint, kg m².
    fn moment_about_joint(&self, number: usize) -> f64 {
        let body = &self.parts.bodies[number];
        let c = nalgebra::Vector3::from(body.center_of_mass);
        let about_origin =
            body.inertia.matrix() + (nalgebra::Matrix3::identity() * c.norm_squared() - c * c.transpose()) * body.mass;
        match body.joint.motion {
            Motion::Floating => body.inertia.matrix().symmetric_eigenvalues().min(),
            Motion::Ball => about_origin.symmetric_eigenvalues().min(),
            Motion::Revolute(axis) => {
                let a = nalgebra::Vector3::from(axis);
                a.dot(&(about_origin * a))
            }
            Motion::Prismatic(_) => body.mass,
        }
    }

    fn joint(&self, number: usize) -> Result<()> {
        let (body, joint) = (&self.parts.bodies[number], &self.parts.bodies[number].joint);
        let at = |what: &str| self.at(&format!("joint '{}': {what}", joint.name));
        finite(&at("position"), &joint.position)?;
        self.rotation(&format!("joint '{}'", joint.name), &joint.rotation)?;
        if joint.motion == Motion::Floating && body.parent.is_some() {
            let remedy = "Give the two bodies models of their own in one environment.";
            return Err(Error::value(at("parent"), &body.name, "the world, for a floating body", remedy));
        }
        if let Motion::Revolute(axis) | Motion::Prismatic(axis) = joint.motion {
            finite(&at("axis"), &axis)?;
            let length = nalgebra::Vector3::from(axis).norm();
            if (length - 1.0).abs() > 1e-9 {
                let value = format!("{axis:?} of length {length}");
                return Err(Error::value(
                    at("axis"),
                    value,
                    "a unit vector",
                    "Give the direction the joint moves along.",
                ));
            }
        }
        for (what, value) in [("damping", joint.damping), ("stiffness", joint.stiffness), ("armature", joint.armature)]
        {
            finite(&at(what), &[value])?;
            if value < 0.0 {
                return Err(Error::value(at(what), value, "≥ 0", "A negative one feeds energy in: check the sign."));
            }
        }
        finite(&at("rest"), &[joint.rest])?;
        if joint.armature > 0.0 {
            self.one_dimensional(joint, "armature")?;
        }
        self.limits(joint)?;
        self.drive(joint)
    }

    fn one_dimensional(&self, joint: &Joint, what: &str) -> Result<()> {
        if matches!(joint.motion, Motion::Revolute(_) | Motion::Prismatic(_)) {
            return Ok(());
        }
        let at = self.at(&format!("joint '{}': {what}", joint.name));
        Err(Error::value(at, "given", "absent on a ball or floating joint", "Use two hinges where a range matters."))
    }

    fn limits(&self, joint: &Joint) -> Result<()> {
        let Some(limits) = &joint.limits else { return Ok(()) };
        self.one_dimensional(joint, "limits")?;
        let at = |what: &str| self.at(&format!("joint '{}': limits.{what}", joint.name));
        finite(
            &at("lower, upper, stiffness, dissipation"),
            &[limits.lower, limits.upper, limits.stiffness, limits.dissipation],
        )?;
        if limits.lower >= limits.upper {
            let rule = format!("below the upper limit {}", limits.upper);
            return Err(Error::value(at("lower"), limits.lower, rule, "Swap the two, or weld the joint."));
        }
        for (what, value) in [("stiffness", limits.stiffness), ("dissipation", limits.dissipation)] {
            if value < 0.0 || (what == "stiffness" && value == 0.0) {
                return Err(Error::value(at(what), value, "> 0 (dissipation ≥ 0)", "A stop pushes back."));
            }
        }
        Ok(())
    }

    fn drive(&self, joint: &Joint) -> Result<()> {
        let Some(drive) = &joint.drive else { return Ok(()) };
        self.one_dimensional(joint, "drive")?;
        let at = |what: &str| self.at(&format!("joint '{}': drive.{what}", joint.name));
        finite(&at("stiffness, damping, center, range"), &[drive.stiffness, drive.damping, drive.center, drive.range])?;
        if !(drive.max_torque > 0.0 && drive.max_torque.is_finite()) {
            let remedy = "Every servo has a limit: give the largest torque of the real one.";
            return Err(Error::value(at("max_torque"), drive.max_torque, "> 0 and finite", remedy));
        }
        for (what, value) in [("stiffness", drive.stiffness), ("damping", drive.damping)] {
            if value < 0.0 {
                return Err(Error::value(at(what), value, "≥ 0", "A negative gain is unstable: check the sign."));
            }
        }
        if drive.stiffness == 0.0 && drive.damping == 0.0 {
            let rule = "> 0 for a rate servo, or the stiffness > 0 for a position servo";
            return Err(Error::value(at("damping"), 0.0, rule, "A drive without gains does nothing: leave it out."));
        }
        Ok(())
    }

    fn rotation(&self, what: &str, rotation: &[[f64; 3]; 3]) -> Result<()> {
        for row in rotation {
            finite(&self.at(&format!("{what}: rotation")), row)?;
        }
        let r = nalgebra::Matrix3::from_fn(|i, j| rotation[i][j]);
        let error = (r * r.transpose() - nalgebra::Matrix3::identity()).norm();
        if error > 1e-9 || r.determinant() < 0.0 {
            let value = format!("off by {error:.1e}, determinant {:.3}", r.determinant());
            let what = self.at(&format!("{what}: rotation"));
            return Err(Error::value(what, value, "a proper rotation matrix", "Build it from a unit quaternion."));
        }
        Ok(())
    }

    /// Trees follow each other, and so do their rotors.
    fn order(&self) -> Result<()> {
        let roots = root_of(&self.parts.bodies);
        for (i, pair) in roots.windows(2).enumerate() {
            if pair[1] != pair[0] && pair[1] != i + 1 {
                let body = &self.parts.bodies[i + 1];
                let what = self.at(&format!("body '{}': place", body.name));
                return Err(Error::value(
                    what,
                    i + 1,
                    "among the bodies of its own tree",
                    "List one tree after the other.",
                ));
            }
        }
        let owners: Vec<usize> = self.parts.rotors.iter().filter_map(|r| roots.get(r.body).copied()).collect();
        match owners.windows(2).position(|w| w[1] < w[0]) {
            None => Ok(()),
            Some(i) => {
                let what = self.at(&format!("rotor '{}': place", self.parts.rotors[i + 1].rotor.name));
                Err(Error::value(what, i + 1, "after the rotors of earlier trees", "List one tree after the other."))
            }
        }
    }
}

fn unique<'a>(what: &str, names: impl Iterator<Item = &'a String>) -> Result<()> {
    let mut seen = std::collections::BTreeSet::new();
    for name in names {
        if !seen.insert(name) {
            return Err(Error::value(what, format!("'{name}' twice"), "named once each", "Rename one of them."));
        }
    }
    Ok(())
}
