//! The tree as bodies: welded parts merged, universal joints split, everything moved into the bodies' frames.

use super::connect::Tree;
use super::joint_spec::{JointKind, JointSpec};
use super::placement::{clean, rows, snap};
use super::solid::combined;
use super::{Assembly, Placement};
use crate::contact::ContactMaterial;
use crate::shape::Shape;
use crate::tree::*;
use crate::vehicle::{Drag, Inertia, MassProperties, Rotor};
use base::error::{Error, Result};
use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};

/// A model whose servos and stops are not tuned yet.
pub(super) struct UntunedModel {
    pub parts: ModelParts,
    /// Per body the joint that it came from.
    pub source: Vec<Option<JointSpec>>,
}

/// Where a part ended up.
#[derive(Clone, Copy)]
struct Site {
    /// `None` for the world.
    body: Option<usize>,
    /// Part → body (or world).
    place: Isometry3<f64>,
}

struct Emitter<'a> {
    assembly: &'a Assembly,
    tree: &'a Tree,
    sites: Vec<Option<Site>>,
    bodies: Vec<Body>,
    source: Vec<Option<JointSpec>>,
    masses: Vec<Vec<MassProperties>>,
}

pub(super) fn emit(assembly: &Assembly, tree: &Tree) -> Result<UntunedModel> {
    let mut emitter = Emitter::new(assembly, tree);
    emitter.place()?;
    emitter.weigh();
    let rotors = emitter.rotors()?;
    let drones = emitter.drones(&rotors)?;
    let rotors = rotors.into_iter().map(|(_, mounted)| mounted).collect();
    let (frames, shapes) = (emitter.frames(), emitter.shapes());
    let mass: f64 = emitter.bodies.iter().map(|b| b.mass).sum();
    // sinks by 0.5 mm on four points whatever it weighs, so that one step size suits all
    let material = ContactMaterial::resting(mass, 4, 5e-4);
    let contact = ContactSettings { material, ..assembly.contact.clone() };
    let parts = ModelParts {
        name: assembly.name.clone(),
        gravity: assembly.gravity,
        bodies: emitter.bodies,
        rotors,
        drones,
        frames,
        shapes,
        contact,
        mesh: Vec::new(),
        pushed: Vec::new(),
        cables: Vec::new(),
    };
    Ok(UntunedModel { parts, source: emitter.source })
}

impl<'a> Emitter<'a> {
    fn new(assembly: &'a Assembly, tree: &'a Tree) -> Self {
        let sites = vec![None; assembly.parts.len()];
        Self { assembly, tree, sites, bodies: Vec::new(), source: Vec::new(), masses: Vec::new() }
    }

    /// A part that has been placed: all have, after [`Emitter::place`].
    fn site(&self, part: usize) -> Site {
        self.sites[part].unwrap_or(Site { body: None, place: Isometry3::identity() })
    }

    /// Bodies and joints, parents first.
    fn place(&mut self) -> Result<()> {
        for &part in &self.tree.order {
            let name = &self.assembly.parts[part].0;
            let site = match self.tree.carrier[part] {
                None => {
                    let joint = Joint::new(format!("{name}.free"), Motion::Floating);
                    self.push(name, None, joint, None);
                    Site { body: Some(self.bodies.len() - 1), place: Isometry3::identity() }
                }
                Some(number) => {
                    let parent = self.tree.ends[number].0;
                    let world = Site { body: None, place: Isometry3::identity() };
                    let below = parent.map_or(world, |p| self.site(p));
                    self.hang(name, &self.assembly.joins[number], below)
                }
            };
            self.sites[part] = Some(site);
        }
        if self.bodies.is_empty() {
            let remedy = "Join a part to the world with a joint that moves, or leave that joint out.";
            return Err(Error::value(self.assembly.label(), "fixed to the world", "able to move", remedy));
        }
        Ok(())
    }

    /// A part on its joint; `below` is its parent.
    fn hang(&mut self, name: &str, join: &JointSpec, below: Site) -> Site {
        let (at, child_at) = (below.place * join.at.isometry(), join.child_at.isometry());
        if join.kind == JointKind::Fixed {
            return Site { body: below.body, place: at * child_at.inverse() };
        }
        // the body has the part's axes and its origin at the joint
        let turn = child_at.rotation;
        let rotation = at.rotation * turn.inverse();
        let axis = |a: [f64; 3]| {
            let unit = turn * Vector3::from(a).normalize();
            std::array::from_fn(|k| snap(unit[k]))
        };
        let joint = |name: String, motion: Motion| Joint {
            position: clean(at.translation.vector, 1.0),
            rotation: rows(&rotation),
            damping: join.damping,
            stiffness: join.stiffness,
            rest: join.rest,
            armature: join.armature,
            ..Joint::new(name, motion)
        };
        match join.kind {
            JointKind::Revolute(a) => {
                self.push(name, below.body, joint(join.name.clone(), Motion::Revolute(axis(a))), Some(join))
            }
            JointKind::Prismatic(a) => {
                self.push(name, below.body, joint(join.name.clone(), Motion::Prismatic(axis(a))), Some(join))
            }
            JointKind::Ball => self.push(name, below.body, joint(join.name.clone(), Motion::Ball), Some(join)),
            JointKind::Fixed | JointKind::Floating => {
                self.push(name, None, joint(join.name.clone(), Motion::Floating), Some(join))
            }
            JointKind::Universal(a, b) => {
                let [first, second] = axis_names(&join.name, a, b);
                let cross = format!("{}.cross", join.name);
                self.push(&cross, below.body, joint(first, Motion::Revolute(axis(a))), Some(join));
                let middle = self.bodies.len() - 1;
                let mut outer = joint(second, Motion::Revolute(axis(b)));
                (outer.position, outer.rotation) = ([0.0; 3], IDENTITY);
                self.push(name, Some(middle), outer, Some(join));
            }
        }
        let place = Isometry3::from_parts(Translation3::from(-child_at.translation.vector), UnitQuaternion::identity());
        Site { body: Some(self.bodies.len() - 1), place }
    }

    fn push(&mut self, name: &str, parent: Option<usize>, joint: Joint, source: Option<&JointSpec>) {
        self.bodies.push(Body {
            name: name.into(),
            parent,
            joint,
            mass: 0.0,
            center_of_mass: [0.0; 3],
            inertia: Inertia::zero(),
            drag: Drag::default(),
        });
        self.source.push(source.cloned());
        self.masses.push(Vec::new());
    }

    /// Mass, centre, inertia and drag of every body from its parts.
    fn weigh(&mut self) {
        for (part, (_, solid)) in self.assembly.parts.iter().enumerate() {
            let Site { body: Some(body), place } = self.site(part) else { continue };
            let r: Matrix3<f64> = place.rotation.to_rotation_matrix().into_inner();
            let own = solid.properties();
            self.masses[body].push(MassProperties {
                mass: own.mass,
                center_of_mass: place.rotation * own.center_of_mass + place.translation.vector,
                inertia: r * own.inertia * r.transpose(),
            });
            let (drag, turned) = (&mut self.bodies[body].drag, solid.total_drag());
            for (sum, own) in [
                (&mut drag.linear, turned.linear),
                (&mut drag.quadratic, turned.quadratic),
                (&mut drag.angular, turned.angular),
            ] {
                *sum = std::array::from_fn(|k| sum[k] + (0..3).map(|i| snap(r[(k, i)]).powi(2) * own[i]).sum::<f64>());
            }
        }
        for (body, parts) in self.bodies.iter_mut().zip(&self.masses) {
            let own = combined(parts.iter().copied());
            body.mass = own.mass;
            body.center_of_mass = own.center_of_mass.into();
            body.inertia = cleaned(&own.inertia);
        }
    }

    /// Rotors in the order of commands, each with the part that carries it.
    fn rotors(&self) -> Result<Vec<(usize, MountedRotor)>> {
        let mut rotors = Vec::new();
        for (part, (name, solid)) in self.assembly.parts.iter().enumerate() {
            let Site { body, place } = self.site(part);
            for rotor in solid.rotors() {
                let Some(body) = body else {
                    let what = format!("{}: part '{name}'", self.assembly.label());
                    let remedy = "Its rotors would move nothing: give it a joint that moves.";
                    return Err(Error::value(what, "fixed to the world", "able to move, since it has rotors", remedy));
                };
                let own = if solid.is_vehicle() { format!("{name}/{}", rotor.name) } else { rotor.name.clone() };
                let axis = place.rotation * Vector3::from(rotor.axis);
                let rotor = Rotor {
                    name: own,
                    position: (place * nalgebra::Point3::from(rotor.position)).into(),
                    axis: std::array::from_fn(|k| snap(axis[k])),
                    ..rotor.clone()
                };
                rotors.push((part, MountedRotor { body, rotor }));
            }
        }
        self.sort(&mut rotors)?;
        Ok(rotors)
    }

    fn sort(&self, rotors: &mut [(usize, MountedRotor)]) -> Result<()> {
        if let Some(order) = &self.assembly.rotor_order {
            let known: Vec<String> = rotors.iter().map(|(_, r)| r.rotor.name.clone()).collect();
            for name in order {
                if !known.contains(name) {
                    return Err(Error::Unknown { kind: "rotor", name: name.clone(), known });
                }
            }
            let rank = |name: &String| order.iter().position(|n| n == name);
            if let Some(name) = known.iter().find(|name| rank(name).is_none()) {
                let what = format!("{}: place of rotor '{name}'", self.assembly.label());
                return Err(Error::value(what, "missing", "in the order of rotors", "List every rotor once."));
            }
            rotors.sort_by_key(|(_, r)| rank(&r.rotor.name));
        }
        let mut root = vec![0; self.bodies.len()];
        for i in 0..self.bodies.len() {
            root[i] = self.bodies[i].parent.map_or(i, |p| root[p]);
        }
        rotors.sort_by_key(|(_, r)| root[r.body]);
        Ok(())
    }

    /// Vehicles and declared drones; those welded into one body become one, named after the first and centred between.
    fn drones(&self, rotors: &[(usize, MountedRotor)]) -> Result<Vec<Drone>> {
        let of = |parts: &[usize]| (0..rotors.len()).filter(|r| parts.contains(&rotors[*r].0)).collect::<Vec<_>>();
        let mut found: Vec<(Drone, f64)> = Vec::new();
        let mut add = |name: &str, part: usize, position: [f64; 3], carriers: &[usize]| {
            let Site { body: Some(body), place } = self.site(part) else { return };
            let center = place * nalgebra::Point3::from(position);
            if let Some((drone, n)) = found.iter_mut().find(|(d, _)| d.body == body) {
                *n += 1.0;
                drone.position = std::array::from_fn(|k| drone.position[k] + (center[k] - drone.position[k]) / *n);
                drone.rotors.extend(of(carriers));
            } else {
                let drone =
                    Drone { name: name.into(), body, position: clean(center.coords, 1.0), rotors: of(carriers) };
                found.push((drone, 1.0));
            }
        };
        for (part, (name, solid)) in self.assembly.parts.iter().enumerate() {
            if solid.is_vehicle() {
                add(name, part, [0.0; 3], &[part]);
            }
        }
        for group in &self.assembly.drones {
            let part = self.assembly.number(&group.part)?;
            let carriers = group.carriers.iter().map(|c| self.assembly.number(c)).collect::<Result<Vec<_>>>()?;
            add(&group.name, part, group.position, &carriers);
        }
        Ok(found.into_iter().map(|(drone, _)| drone).collect())
    }

    /// Every part whose frame is not that of a body of its name.
    fn frames(&self) -> Vec<NamedFrame> {
        let mut frames = Vec::new();
        for (part, (name, _)) in self.assembly.parts.iter().enumerate() {
            let Site { body: Some(body), place } = self.site(part) else { continue };
            let frame = NamedFrame {
                name: name.clone(),
                body,
                position: clean(place.translation.vector, 1.0),
                rotation: rows(&place.rotation),
            };
            let same = frame.position == [0.0; 3] && frame.rotation == IDENTITY;
            if self.bodies[body].name != *name || !same {
                frames.push(frame);
            }
        }
        frames
    }

    fn shapes(&self) -> Vec<BodyShape> {
        let mut shapes = Vec::new();
        for (part, (name, solid)) in self.assembly.parts.iter().enumerate() {
            let Site { body, place } = self.site(part);
            let on = |shape: &Shape| BodyShape {
                body,
                part: name.clone(),
                shape: moved(shape, &place),
                collides: solid.collides(),
                material: None,
            };
            shapes.extend(solid.shapes().iter().map(on));
        }
        shapes
    }
}

/// A shape in the outer frame.
pub(super) fn moved(shape: &Shape, place: &Isometry3<f64>) -> Shape {
    let own = Placement { position: shape.position, rotation: shape.rotation };
    let outer = Placement::of(&(place * own.isometry()));
    Shape { geometry: shape.geometry, position: clean(Vector3::from(outer.position), 1.0), rotation: outer.rotation }
}

/// Symmetric, rounding errors next to the largest entry made zero.
fn cleaned(inertia: &Matrix3<f64>) -> Inertia {
    let least = 1e-15 * inertia.amax();
    let even = (inertia + inertia.transpose()) * 0.5;
    Inertia::from_matrix(&even.map(|x| if x.abs() <= least { 0.0 } else { x }))
}

/// `swing.x` and `swing.y`; `.a` and `.b` where an axis is not one of the frame's.
fn axis_names(joint: &str, first: [f64; 3], second: [f64; 3]) -> [String; 2] {
    let letter = |axis: [f64; 3]| match axis.map(|x| x != 0.0) {
        [true, false, false] => Some("x"),
        [false, true, false] => Some("y"),
        [false, false, true] => Some("z"),
        _ => None,
    };
    let letters = match (letter(first), letter(second)) {
        (Some(a), Some(b)) => [a, b],
        _ => ["a", "b"],
    };
    letters.map(|l| format!("{joint}.{l}"))
}
