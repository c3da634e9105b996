//! What a plant looks like: its visible bodies with their shapes, rotors and struts, and where they are in a state.

use omnidrones::dynamics::shape::{Geometry, Shape};
use omnidrones::dynamics::spatial::from_matrix;
use omnidrones::dynamics::tree::Model;
use omnidrones::dynamics::{GRAVITY, Plant, Rotor};
use omnidrones::internals::{body_poses, contact_forces};
use omnidrones_plot::model::{ROTOR_RADIUS, struts};
use serde::Serialize;

/// Bodies, in the order of the plant's, those without anything to see left out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Look {
    /// Of the plant.
    pub name: String,
    /// Farthest point of the plant at rest from its middle, m.
    pub size: f64,
    /// Weight, N: what forces are drawn against.
    pub weight: f64,
    /// Number of rotors of all bodies.
    pub rotors: usize,
    pub(crate) bodies: Vec<BodyLook>,
    /// What stands still in the world.
    pub(crate) still: Vec<Shape>,
}

/// A body; all lengths in its frame, m.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct BodyLook {
    pub name: String,
    /// Number in the plant.
    #[serde(skip)]
    number: usize,
    /// Which drone it is the middle of.
    drone: Option<usize>,
    /// Whether a joint ties it to a body that carries rotors: a link of a chain, the core of a machine that tilts.
    beside_rotors: bool,
    pub solids: Vec<Shape>,
    pub struts: Vec<[[f64; 3]; 2]>,
    pub rotors: Vec<RotorLook>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct RotorLook {
    /// Number in the plant.
    number: usize,
    pub position: [f64; 3],
    pub axis: [f64; 3],
    pub radius: f64,
    pub spin: f64,
    /// N, by the nominal coefficient.
    max_thrust: f64,
}

impl RotorLook {
    fn of(number: usize, rotor: &Rotor, apart: f64) -> Self {
        // one that does not tell its radius must not touch its neighbours
        let radius = if rotor.radius > 0.0 { rotor.radius } else { ROTOR_RADIUS.min(0.48 * apart) };
        let &Rotor { position, axis, spin, .. } = rotor;
        Self { number, position, axis, radius, spin, max_thrust: rotor.max_thrust() }
    }
}

/// Least distance of two of these points, m.
fn least_apart(points: &[[f64; 3]]) -> f64 {
    let pairs = points.iter().enumerate().flat_map(|(i, a)| points[..i].iter().map(move |b| (a, b)));
    let distance = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    // coaxial ones stand above each other and may overlap
    pairs.map(distance).filter(|d| *d > 1e-3).fold(f64::INFINITY, f64::min)
}

impl Look {
    /// Of a vehicle or a system of bodies.
    pub fn of(plant: &Plant) -> Self {
        let mut look = match plant {
            Plant::Rigid(own) => {
                let vehicle = own.vehicle();
                let apart = least_apart(&vehicle.rotors.iter().map(|r| r.position).collect::<Vec<_>>());
                let rotors = vehicle.rotors.iter().enumerate().map(|(i, r)| RotorLook::of(i, r, apart)).collect();
                let body = BodyLook {
                    name: vehicle.name.clone(),
                    number: 0,
                    drone: Some(0),
                    beside_rotors: false,
                    solids: vehicle.shapes.clone(),
                    struts: Vec::new(),
                    rotors,
                };
                let weight = vehicle.mass_properties().mass * GRAVITY;
                Self::new(plant, vec![body], Vec::new(), weight)
            }
            Plant::Tree(system) => {
                let model = system.model();
                let weight = model.mass() * model.parts().gravity;
                Self::new(plant, bodies(model), still(model), weight)
            }
        };
        look.size = look.reach(plant);
        look
    }

    fn new(plant: &Plant, bodies: Vec<BodyLook>, still: Vec<Shape>, weight: f64) -> Self {
        let rotors = bodies.iter().map(|b| b.rotors.len()).sum();
        Self { name: plant.name().into(), size: 0.0, weight, rotors, bodies, still }
    }

    /// Number of visible bodies.
    pub fn n_body(&self) -> usize {
        self.bodies.len()
    }

    /// Number of shapes that stand still.
    pub fn n_still(&self) -> usize {
        self.still.len()
    }

    /// Position and attitude `[x, y, z, w, x, y, z]` of every visible body, world.
    pub fn poses(&self, plant: &Plant, state: &[f64]) -> Vec<[f64; 7]> {
        let Some(system) = plant.tree() else {
            let of = |from: usize, k: usize| state.get(from + k).copied().unwrap_or(f64::NAN);
            let pose = [of(0, 0), of(0, 1), of(0, 2), of(6, 0), of(6, 1), of(6, 2), of(6, 3)];
            return vec![pose; self.bodies.len()];
        };
        let poses = body_poses(system, state);
        let pose = |body: &BodyLook| {
            let own = &poses[body.number];
            let ([x, y, z], [w, i, j, k]) = (own.position, from_matrix(own.rotation));
            [x, y, z, w, i, j, k]
        };
        self.bodies.iter().map(pose).collect()
    }

    /// Force of contacts on every visible body, N, world; empty where contacts are not simulated.
    pub fn forces(&self, plant: &Plant, state: &[f64]) -> Vec<[f64; 3]> {
        let Some(system) = plant.tree().filter(|_| plant.physics().effects.contact) else { return Vec::new() };
        let all = contact_forces(system, state);
        self.bodies.iter().map(|body| all[body.number]).collect()
    }

    fn reach(&self, plant: &Plant) -> f64 {
        let Ok(rest) = plant.hover_state() else { return 1.0 };
        let poses = self.poses(plant, &rest);
        let mut points: Vec<([f64; 3], f64)> = Vec::new();
        for (body, pose) in self.bodies.iter().zip(&poses) {
            let at = |p: [f64; 3]| turned(pose, p);
            points.extend(body.rotors.iter().map(|r| (at(r.position), r.radius)));
            points.extend(body.solids.iter().map(|s| (at(s.position), extent(&s.geometry))));
        }
        let n = points.len().max(1) as f64;
        let middle = [0, 1, 2].map(|k| points.iter().map(|(p, _)| p[k]).sum::<f64>() / n);
        let far = |(p, r): &([f64; 3], f64)| r + (0..3).map(|k| (p[k] - middle[k]).powi(2)).sum::<f64>().sqrt();
        points.iter().map(far).fold(0.02, f64::max)
    }
}

/// A body's point in the world.
pub(crate) fn turned(pose: &[f64; 7], [a, b, c]: [f64; 3]) -> [f64; 3] {
    let [x, y, z, w, i, j, k] = *pose;
    // v + 2 q × (q × v + w v)
    let t = [2.0 * (j * c - k * b), 2.0 * (k * a - i * c), 2.0 * (i * b - j * a)];
    let turned =
        [a + w * t[0] + j * t[2] - k * t[1], b + w * t[1] + k * t[0] - i * t[2], c + w * t[2] + i * t[1] - j * t[0]];
    [x + turned[0], y + turned[1], z + turned[2]]
}

/// Farthest point of a shape from its middle, m.
fn extent(geometry: &Geometry) -> f64 {
    match *geometry {
        Geometry::Sphere { radius } => radius,
        Geometry::Capsule { radius, length } => radius + 0.5 * length,
        Geometry::Box { size } => 0.5 * size.iter().map(|s| s * s).sum::<f64>().sqrt(),
    }
}

fn bodies(model: &Model) -> Vec<BodyLook> {
    let struts = struts(model);
    let hubs: Vec<[f64; 3]> = model.rotors().iter().map(|r| r.rotor.position).collect();
    let carries = |body: usize| model.rotors().iter().any(|r| r.body == body);
    let look = |number: usize| {
        let own = |i: &usize| model.rotors()[*i].body == number;
        let mine: Vec<usize> = (0..hubs.len()).filter(own).collect();
        let apart = least_apart(&mine.iter().map(|i| hubs[*i]).collect::<Vec<_>>());
        BodyLook {
            name: model.bodies()[number].name.clone(),
            number,
            drone: model.drones().iter().position(|d| d.body == number),
            beside_rotors: tied(model, number).any(carries),
            solids: model.shapes().iter().filter(|s| s.body == Some(number)).map(|s| s.shape).collect(),
            struts: struts.iter().filter(|(body, _)| *body == number).map(|(_, ends)| *ends).collect(),
            rotors: mine.iter().map(|i| RotorLook::of(*i, &model.rotors()[*i].rotor, apart)).collect(),
        }
    };
    let seen = |b: &BodyLook| !(b.solids.is_empty() && b.struts.is_empty() && b.rotors.is_empty());
    (0..model.bodies().len()).map(look).filter(seen).collect()
}

/// Bodies that hang on a body by gimbals of up to two hinges and carry no shape in between.
fn tied(model: &Model, number: usize) -> impl Iterator<Item = usize> + '_ {
    let parent = move |i: usize| model.bodies()[i].parent;
    (0..model.bodies().len()).filter(move |i| {
        let above = parent(*i);
        let bare = |b: &usize| model.shapes().iter().all(|s| s.body != Some(*b));
        above == Some(number) || above.filter(bare).is_some_and(|b| parent(b) == Some(number))
    })
}

fn still(model: &Model) -> Vec<Shape> {
    model.shapes().iter().filter(|s| s.body.is_none()).map(|s| s.shape).collect()
}
