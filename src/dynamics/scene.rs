//! What stands around the vehicles: ground, gates, obstacles, and the signed distance to them.
//!
//! A [`Scene`] is plain data, shared by all environments of a batch. What differs between them, offsets and slides, is
//! their **placement**, a flat slice over any scalar:
//!
//! | entries | what |
//! |---|---|
//! | per gate, in order: 3 | offset of its position, world, m |
//! | then, for a sliding gate: 1 | slide coordinate along its local y, m |
//! | per obstacle, in order: 3 | offset of its position, world, m |
//!
//! Zeros are the nominal placement. A placement of another length is a mistake of the program: kernels panic.
//!
//! Scenes come from seeds ([`Generator`]: forests, corridors, rooms, gates, rubble, terrain) and from files
//! ([`Scene::from_toml_file`]); [`environment`](crate::configurations::environment()) lets them push back.

mod file;
mod gate;
mod generate;

pub use gate::{Gate, GateSlide, Passage};
pub use generate::{Corridor, Course, Forest, Generator, KINDS, Rooms, Rubble, Terrain};

use super::assembly::rod;
use super::contact::ContactMaterial;
use super::contact::distance::{self, ground_distance, plane_distance};
use super::mesh::Mesh;
use super::shape::{Geometry, MAX_SIZE, Pose, Shape, within};
use super::spatial::{Vec3, add, constants};
use super::uneven_ground::UnevenGround;
use autodiff::Scalar;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashSet};

/// Most gates, and most obstacles, of one scene.
pub(crate) const MAX_ELEMENTS: usize = 4096;
/// Keys of [`Scene::materials`] that stand for all elements of a kind.
const KINDS_OF_ELEMENTS: [&str; 3] = ["ground", "gates", "obstacles"];
/// Distance to a scene without elements, m.
pub const FAR: f64 = 1e6;

/// A solid that does not move, with its pose in the world.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Obstacle {
    /// Unique in its scene; for messages.
    pub name: String,
    /// Geometry and pose in the world.
    pub shape: Shape,
}

/// Ground, gates, obstacles, and meshes that are only seen.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Scene {
    /// Height of the ground, m; `None` for none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ground: Option<f64>,
    /// What rises over that height; `None` for a level plane.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relief: Option<UnevenGround>,
    /// Fixed and sliding.
    pub gates: Vec<Gate>,
    /// Capsules, boxes, spheres.
    pub obstacles: Vec<Obstacle>,
    /// Triangle meshes and height fields, which sensors see and nothing touches: distances know nothing of them, and no
    /// placement moves them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub mesh: Vec<Mesh>,
    /// What things are made of, where it is not the material of what flies: by the name of a gate or obstacle, or for all of
    /// a kind under `ground`, `gates`, `obstacles`.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub materials: BTreeMap<String, ContactMaterial>,
}

/// One thing of a [`Scene`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Element {
    /// The plane, or what rises over it.
    Ground,
    /// By its index in [`Scene::gates`].
    Gate(usize),
    /// By its index in [`Scene::obstacles`].
    Obstacle(usize),
    /// By its index in [`Scene::mesh`]: seen only.
    Mesh(usize),
}

impl Scene {
    /// Level ground at z = 0 and nothing else.
    pub fn grounded() -> Self {
        Self { ground: Some(0.0), ..Self::default() }
    }

    /// What a thing is made of: by its own name, else by its kind; `None` for what it touches.
    pub fn material(&self, element: Element) -> Option<ContactMaterial> {
        let (name, kind) = match element {
            Element::Ground => (KINDS_OF_ELEMENTS[0], KINDS_OF_ELEMENTS[0]),
            Element::Gate(i) => (self.gates[i].name.as_str(), KINDS_OF_ELEMENTS[1]),
            Element::Obstacle(i) => (self.obstacles[i].name.as_str(), KINDS_OF_ELEMENTS[2]),
            Element::Mesh(_) => return None,
        };
        self.materials.get(name).or_else(|| self.materials.get(kind)).copied()
    }

    /// Signed distance of a world point to the ground, m, where there is one. With waves as exact as [`UnevenGround::surface`].
    #[inline]
    fn over_ground<S: Scalar>(&self, point: Vec3<S>) -> Option<S> {
        let height = S::constant(self.ground?);
        Some(match &self.relief {
            None => point[2] - height,
            Some(relief) => relief.surface(point, height).0,
        })
    }

    /// Numbers of a placement.
    pub fn n_placement(&self) -> usize {
        self.obstacle_start() + 3 * self.obstacles.len()
    }

    /// Where everything stands as its own fields say: zeros.
    pub fn nominal_placement(&self) -> Vec<f64> {
        vec![0.0; self.n_placement()]
    }

    /// Where in a placement the offset of a gate or obstacle starts; a sliding gate's coordinate follows it. `None` for the
    /// ground and for meshes.
    ///
    /// # Panics
    /// On an index that the scene does not have.
    pub fn placement_index(&self, element: Element) -> Option<usize> {
        match element {
            Element::Ground | Element::Mesh(_) => None,
            Element::Gate(i) => {
                assert!(i < self.gates.len(), "gate {i} of {}", self.gates.len());
                Some(self.gate_start(i))
            }
            Element::Obstacle(i) => {
                assert!(i < self.obstacles.len(), "obstacle {i} of {}", self.obstacles.len());
                Some(self.obstacle_start() + 3 * i)
            }
        }
    }

    #[inline]
    fn gate_start(&self, i: usize) -> usize {
        let mut at = 0;
        for k in 0..i {
            at += if self.gates[k].slide.is_some() { 4 } else { 3 };
        }
        at
    }

    #[inline]
    fn obstacle_start(&self) -> usize {
        self.gate_start(self.gates.len())
    }

    /// Pose of the frame of gate `i`, world. `placement`, here and below, has [`n_placement`](Self::n_placement) numbers.
    ///
    /// # Panics
    /// If there is no such gate, or `placement` is too short.
    #[inline]
    pub fn gate_pose<S: Scalar>(&self, placement: &[S], i: usize) -> Pose<S> {
        self.gate_pose_at(placement, i, self.gate_start(i))
    }

    #[inline]
    fn gate_pose_at<S: Scalar>(&self, placement: &[S], i: usize, at: usize) -> Pose<S> {
        let gate = &self.gates[i];
        let slide = if gate.slide.is_some() { placement[at + 3] } else { S::zero() };
        gate.pose([placement[at], placement[at + 1], placement[at + 2]], slide)
    }

    /// Pose of obstacle `i`, world.
    ///
    /// # Panics
    /// If there is no such obstacle, or `placement` is too short.
    #[inline]
    pub fn obstacle_pose<S: Scalar>(&self, placement: &[S], i: usize) -> Pose<S> {
        self.obstacle_pose_at(placement, i, self.obstacle_start() + 3 * i)
    }

    #[inline]
    fn obstacle_pose_at<S: Scalar>(&self, placement: &[S], i: usize, at: usize) -> Pose<S> {
        let shape = &self.obstacles[i].shape;
        let offset = [placement[at], placement[at + 1], placement[at + 2]];
        Pose { position: add(constants(shape.position), offset), attitude: constants(shape.rotation) }
    }

    /// Gates, as their four bars each, then obstacles, where a placement puts them in the world. Neither ground nor meshes.
    ///
    /// # Panics
    /// If `placement` is too short.
    pub fn solids(&self, placement: &[f64]) -> Vec<Shape> {
        let bars = |(i, gate): (usize, &Gate)| {
            gate.bars(&self.gate_pose(placement, i)).map(|[from, to]| rod(from, to, gate.bar_radius()))
        };
        let obstacle = |(i, own): (usize, &Obstacle)| own.shape.at(self.obstacle_pose(placement, i).position);
        let gates = self.gates.iter().enumerate().flat_map(bars);
        gates.chain(self.obstacles.iter().enumerate().map(obstacle)).collect()
    }

    /// Signed distance of a world point to the nearest element, m: negative inside; [`FAR`] at most.
    ///
    /// Exact outside. The gradient in the point has unit norm wherever one nearest point of one surface is nearest; where
    /// two are (half way between elements, on the axis of a bar, in the middle of a box) it is that of one of them, or 0
    /// on the axis itself.
    ///
    /// # Panics
    /// As [`nearest`](Self::nearest).
    pub fn distance<S: Scalar>(&self, placement: &[S], point: Vec3<S>) -> S {
        self.check(placement.len());
        let mut least = S::constant(FAR);
        if let Some(distance) = self.over_ground(point) {
            least = least.min(distance);
        }
        let mut at = 0;
        for i in 0..self.gates.len() {
            let pose = self.gate_pose_at(placement, i, at);
            least = least.min(self.gates[i].distance(&pose, point));
            at += if self.gates[i].slide.is_some() { 4 } else { 3 };
        }
        for i in 0..self.obstacles.len() {
            let pose = self.obstacle_pose_at(placement, i, at);
            least = least.min(distance::point(point, &self.obstacles[i].shape.geometry, &pose));
            at += 3;
        }
        least
    }

    /// Signed distance of a body to the nearest element, m; [`FAR`] at most. As exact as
    /// `contact::distance` is for the pair: the sign is right for all.
    ///
    /// # Panics
    /// As [`nearest`](Self::nearest).
    pub fn clearance<S: Scalar>(&self, placement: &[S], geometry: &Geometry, pose: &Pose<S>) -> S {
        self.check(placement.len());
        let mut least = S::constant(FAR);
        if let Some(height) = self.ground {
            let height = S::constant(height);
            least = least.min(match &self.relief {
                None => plane_distance(geometry, pose, height),
                Some(relief) => ground_distance(geometry, pose, height, relief),
            });
        }
        let mut at = 0;
        for i in 0..self.gates.len() {
            let gate = &self.gates[i];
            let bars = gate.bars(&self.gate_pose_at(placement, i, at));
            for k in 0..4 {
                least = least.min(distance::to_capsule(geometry, pose, bars[k], gate.bar_radius()));
            }
            at += if gate.slide.is_some() { 4 } else { 3 };
        }
        for i in 0..self.obstacles.len() {
            let other = self.obstacle_pose_at(placement, i, at);
            least = least.min(distance::distance(geometry, pose, &self.obstacles[i].shape.geometry, &other));
            at += 3;
        }
        least
    }

    /// The element nearest to a world point, and its signed distance, m; `None` for an empty scene.
    ///
    /// # Panics
    /// On a placement of another length than [`n_placement`](Self::n_placement).
    pub fn nearest(&self, placement: &[f64], point: Vec3<f64>) -> Option<(Element, f64)> {
        self.check(placement.len());
        let ground = self.over_ground(point).map(|distance| (Element::Ground, distance));
        let gates = self
            .gates
            .iter()
            .enumerate()
            .map(|(i, gate)| (Element::Gate(i), gate.distance(&self.gate_pose(placement, i), point)));
        let obstacles = self.obstacles.iter().enumerate().map(|(i, o)| {
            let pose = self.obstacle_pose(placement, i);
            (Element::Obstacle(i), distance::point(point, &o.shape.geometry, &pose))
        });
        ground.into_iter().chain(gates).chain(obstacles).min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// How the step from `from` to `to` (world, m) meets the opening of gate `i`.
    ///
    /// # Panics
    /// As [`nearest`](Self::nearest), and if there is no such gate.
    #[inline]
    pub fn passage<S: Scalar>(&self, placement: &[S], i: usize, from: Vec3<S>, to: Vec3<S>) -> Passage<S> {
        self.check(placement.len());
        self.gates[i].passage(&self.gate_pose(placement, i), from, to)
    }

    #[inline]
    fn check(&self, length: usize) {
        let want = self.n_placement();
        assert!(length == want, "a placement of {length} numbers for a scene of {want}");
    }

    /// Checks every element; errors name it: `gate 'second'`, `obstacle 'pillar'`.
    ///
    /// # Errors
    /// Numbers as [`Gate::validate`], [`Shape::validate`] and [`Mesh::validate`] refuse; a ground beyond 1e4 m; a name used twice;
    /// more than 4096 gates, obstacles or meshes ([`Error::Limit`]; all else is [`Error::Value`]).
    pub fn validate(&self) -> Result<()> {
        if let Some(height) = self.ground {
            within("scene: ground", height, -MAX_SIZE, MAX_SIZE)?;
        }
        if let Some(relief) = &self.relief {
            relief.validate("scene: relief")?;
            if self.ground.is_none() {
                let (what, rule) = ("scene: ground", "the height that the relief rises over");
                return Err(Error::value(what, "none", rule, "Give ground = 0.0, or leave out the relief."));
            }
        }
        for (what, count) in
            [("gates", self.gates.len()), ("obstacles", self.obstacles.len()), ("meshes", self.mesh.len())]
        {
            if count > MAX_ELEMENTS {
                let remedy = "Leave out what no vehicle can reach.";
                return Err(Error::limit(format!("scene: number of {what}"), count, MAX_ELEMENTS, remedy));
            }
        }
        for gate in &self.gates {
            gate.validate(&format!("gate '{}'", gate.name))?;
        }
        for obstacle in &self.obstacles {
            obstacle.shape.validate(&format!("obstacle '{}'", obstacle.name))?;
        }
        for mesh in &self.mesh {
            mesh.validate(&format!("mesh '{}'", mesh.name))?;
        }
        unique("mesh", self.mesh.iter().map(|mesh| mesh.name.as_str()))?;
        unique("gate", self.gates.iter().map(|gate| gate.name.as_str()))?;
        unique("obstacle", self.obstacles.iter().map(|obstacle| obstacle.name.as_str()))?;
        self.check_materials()
    }

    fn check_materials(&self) -> Result<()> {
        let names = self.gates.iter().map(|g| &g.name).chain(self.obstacles.iter().map(|o| &o.name));
        let known: Vec<String> = KINDS_OF_ELEMENTS.iter().map(|kind| kind.to_string()).chain(names.cloned()).collect();
        for (name, material) in &self.materials {
            if !known.contains(name) {
                return Err(Error::Unknown { kind: "element of a scene", name: name.clone(), known });
            }
            material.validate(&format!("material of '{name}'"))?;
        }
        Ok(())
    }
}

/// Refuses a name that stands there twice.
pub(crate) fn unique<'a>(kind: &str, names: impl Iterator<Item = &'a str>) -> Result<()> {
    let mut seen = HashSet::new();
    for name in names {
        if !seen.insert(name) {
            let what = format!("scene: {kind} name");
            return Err(Error::value(what, format!("'{name}' twice"), "unique", "Rename one of them."));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
