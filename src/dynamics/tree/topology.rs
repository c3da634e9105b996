//! What kernels branch on: the shape of a model without its numbers.
//!
//! All of it is plain data, equal for every environment and every scalar, so that kernels may branch on it. Flags say
//! where a number is zero in the model at hand; a batch whose environments differ keeps them general.

use super::cable::CableEnd;
use super::layout::Layout;
use super::model::{Body, BodyShape, Drive, IDENTITY, Model, Motion, root_of};
use crate::contact::ContactMaterial;
use crate::contact::material::Resolved;
use crate::contact::pairs::{corners, segment};
use crate::rigid::Effects;
use crate::shape::{Geometry, Pose};
use crate::spatial::{matrix, transpose};
use crate::uneven_ground::UnevenGround;
use std::f64::consts::PI;

/// Axis of a hinge or slide in its joint's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Axis {
    X,
    Y,
    Z,
    General([f64; 3]),
}

impl Axis {
    fn of(axis: [f64; 3]) -> Self {
        match axis {
            [1.0, 0.0, 0.0] => Self::X,
            [0.0, 1.0, 0.0] => Self::Y,
            [0.0, 0.0, 1.0] => Self::Z,
            general => Self::General(general),
        }
    }
}

/// A joint as kernels see it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Kind {
    Floating,
    Hinge(Axis),
    Slide(Axis),
    Ball,
}

/// One body as kernels see it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Link {
    pub parent: Option<usize>,
    pub kind: Kind,
    /// Rotation of the joint's frame in the parent, if any.
    pub turn: Option<[[f64; 3]; 3]>,
    /// Places in the state.
    pub position: usize,
    pub velocity: usize,
    /// First degree of freedom.
    pub freedom: usize,
    /// The joint's origin is the parent's.
    pub coincident: bool,
    /// No mass of its own.
    pub massless: bool,
    /// The centre of mass is the frame's origin.
    pub centered: bool,
    pub products: bool,
    pub linear_drag: bool,
    pub quadratic_drag: bool,
    pub damped: bool,
    pub sprung: bool,
    /// Damping and spring of a hinge or slide are too fast for the step: sampled implicitly and held, as drives are.
    pub stiff: bool,
    pub limited: bool,
    pub geared: bool,
    pub drive: Option<Servo>,
    /// Rotors that it carries, a range of `Topology::rotor_order`.
    pub rotors: (usize, usize),
    /// Disturbance of its tree in the input, on a root.
    pub disturbance: Option<usize>,
    /// Wind of its tree in the input.
    pub wind: Option<usize>,
}

/// A drive as kernels see it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Servo {
    /// Its command in the input.
    pub command: usize,
    pub center: f64,
    pub range: f64,
    /// Whether the command is a position.
    pub holds_position: bool,
}

/// One source of wakes as kernels see it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Source {
    pub body: usize,
    pub position: [f64; 3],
    pub rotors: Vec<usize>,
}

/// A shape as points of a body with a radius around them, as contact sees it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Feature {
    pub body: Option<usize>,
    /// Place among the still shapes, where it has no body.
    pub still: usize,
    pub form: Form,
    pub radius: f64,
    /// By which it touches where boxes are.
    pub balls: Vec<Ball>,
    /// Its own.
    pub material: Option<ContactMaterial>,
}

/// Points in the body's frame, or about a still shape's position.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a few per model, read where they lie")]
pub(crate) enum Form {
    Sphere([f64; 3]),
    Capsule([[f64; 3]; 2]),
    Box(OrientedBox),
}

/// A ball within a feature, in the body's frame; a corner of a box where it has no radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ball {
    pub center: [f64; 3],
    pub radius: f64,
}

/// A box.
#[derive(Debug, Clone, PartialEq)]
#[doc(hidden)]
pub struct OrientedBox {
    pub corners: [[f64; 3]; 8],
    pub center: [f64; 3],
    /// By rows, box → body.
    pub rotation: [[f64; 3]; 3],
    pub half: [f64; 3],
}

/// Two features that push on each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pair {
    pub first: usize,
    pub second: usize,
    /// The first touches by its balls: one of the two is a box. It is what moves, or else what is no box.
    pub by_balls: bool,
}

/// What touches, and the material where it is not the model's.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Touch<W> {
    pub what: W,
    pub material: Option<ContactMaterial>,
}

impl Form {
    #[inline]
    pub(crate) fn points(&self) -> &[[f64; 3]] {
        match self {
            Self::Sphere(point) => std::slice::from_ref(point),
            Self::Capsule(points) => points,
            Self::Box(block) => &block.corners,
        }
    }
}

/// The shape of a model under given effects.
#[derive(Debug, Clone)]
pub(crate) struct Topology {
    pub links: Vec<Link>,
    pub sources: Vec<Source>,
    /// Of every source, 1/A of the A = Σ π r² of its rotors, 1/m²; 0 where they have no radius.
    pub per_area: Vec<f64>,
    /// What wakes push beside drones, where that effect is on, body by body.
    pub loads: Vec<Load>,
    /// The bodies of these.
    pub loaded: Vec<usize>,
    /// Rotor numbers sorted by the body that carries them.
    pub rotor_order: Vec<usize>,
    /// Per rotor.
    pub rotor_body: Vec<usize>,
    pub rotor_speed: Vec<usize>,
    pub rotor_action: Vec<usize>,
    pub rotor_radius: Vec<f64>,
    pub layout: Layout,
    pub n_state: usize,
    pub n_input: usize,
    pub effects: Effects,
    /// Whether any joint torque is sampled at the start of a substep and held.
    pub holds_torque: bool,
    pub features: Vec<Feature>,
    /// Features of bodies, where there is a ground.
    pub on_ground: Vec<Touch<usize>>,
    /// Features that push on each other.
    pub pairs: Vec<Touch<Pair>>,
    /// The ends of cables.
    pub cables: Vec<[CableEnd; 2]>,
    /// Shapes that stand still in the world.
    pub n_still: usize,
    /// What rises over the ground.
    pub relief: Option<UnevenGround>,
    /// Friction is steeper than the stages of a step resolve: sampled implicitly at its start and held.
    pub sticks: bool,
    /// What a substep resolves.
    pub resolved: ResolvedTouches,
}

/// A shape that wakes push, as kernels see it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Load {
    pub body: usize,
    /// In the body's frame, m.
    pub center: [f64; 3],
    /// Its axes by rows, in the body's frame.
    pub axes: [[f64; 3]; 3],
    /// m² that face a wake along the unit vector d: end + side √(1 − d_z²) + Σ faces |d| along its axes.
    pub end: f64,
    pub side: f64,
    pub faces: [f64; 3],
}

impl Load {
    /// Shapes of bodies that carry no rotors, body by body.
    fn all(model: &Model) -> Vec<Self> {
        let flies = |body: usize| {
            model.rotors().iter().any(|r| r.body == body) || model.drones().iter().any(|d| d.body == body)
        };
        let loads = model.shapes().iter().filter_map(|s| Some((s.body.filter(|b| !flies(*b))?, s)));
        let loads = loads.filter(|(body, _)| model.bodies()[*body].mass > 0.0);
        let mut all: Vec<_> = loads.map(|(body, shape)| Self::of(body, shape)).collect();
        all.sort_by_key(|load| load.body);
        all
    }

    fn of(body: usize, BodyShape { shape, .. }: &BodyShape) -> Self {
        let (center, axes) = (shape.position, transpose(matrix(shape.rotation)));
        let none = Self { body, center, axes, end: 0.0, side: 0.0, faces: [0.0; 3] };
        match shape.geometry {
            Geometry::Sphere { radius } => Self { end: PI * radius * radius, ..none },
            Geometry::Capsule { radius, length } => {
                Self { end: PI * radius * radius, side: 2.0 * radius * length, ..none }
            }
            Geometry::Box { size: [x, y, z] } => Self { faces: [y * z, z * x, x * y], ..none },
        }
    }
}

/// What a substep resolves of every touch, in their order. Of the nominal masses: a batch keeps its first model's.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ResolvedTouches {
    pub on_ground: Vec<Resolved>,
    pub pairs: Vec<Resolved>,
    /// Of cables: stiffnesses in N/m.
    pub cables: Vec<Resolved>,
}

impl Topology {
    /// Of the bodies alone, without effects: enough for kinematics.
    pub(crate) fn bare(model: &Model) -> Self {
        Self::with_links(model, Effects::none(), Self::links(model, Effects::none(), false))
    }

    pub(super) fn links(model: &Model, effects: Effects, general: bool) -> Vec<Link> {
        let layout = Layout::with_disturbance(model.parts(), effects.disturbance);
        let rotor_order = rotor_order(model);
        let mut links = Vec::with_capacity(model.bodies().len());
        for (i, body) in model.bodies().iter().enumerate() {
            let mut link = Link::of(body, general);
            let place = layout.bodies[i];
            (link.position, link.velocity, link.freedom) = (place.position, place.velocity, place.freedom);
            link.drive = body.joint.drive.as_ref().zip(layout.drive[i]).map(|(d, at)| Servo::of(d, at));
            let first = rotor_order.partition_point(|r| model.rotors()[*r].body < i);
            let last = rotor_order.partition_point(|r| model.rotors()[*r].body <= i);
            link.rotors = (first, last);
            let tree = layout.trees.iter().find(|t| t.bodies.contains(&i));
            link.wind = tree.and_then(|t| t.disturbance);
            let pushed = model.parts().pushed.iter().find(|b| tree.is_some_and(|t| t.bodies.contains(b)));
            link.disturbance = link.wind.filter(|_| pushed.map_or(body.parent.is_none(), |b| *b == i));
            links.push(link);
        }
        links
    }

    pub(super) fn with_links(model: &Model, effects: Effects, links: Vec<Link>) -> Self {
        let layout = Layout::with_disturbance(model.parts(), effects.disturbance);
        let rotor_order = rotor_order(model);
        let features = features(model);
        let (on_ground, pairs) = (on_ground(model, &features), pairs(model, &features));
        let sources = model.drones().iter().filter(|d| !d.rotors.is_empty());
        let loads = if effects.load_downwash { Load::all(model) } else { Vec::new() };
        let mut loaded: Vec<usize> = loads.iter().map(|load| load.body).collect();
        loaded.dedup();
        let per = |area: f64| if area > 0.0 { area.recip() } else { 0.0 };
        let disc = |r: &usize| PI * model.rotors()[*r].rotor.radius.powi(2);
        Self {
            resolved: ResolvedTouches {
                on_ground: vec![Resolved::ANY; on_ground.len()],
                pairs: vec![Resolved::ANY; pairs.len()],
                cables: vec![Resolved::ANY; model.cables().len()],
            },
            on_ground,
            pairs,
            sticks: false,
            cables: model.cables().iter().map(|cable| cable.ends).collect(),
            n_still: model.shapes().iter().filter(|s| s.body.is_none()).count(),
            relief: model.parts().contact.relief.clone(),
            features,
            holds_torque: links.iter().any(|l| l.drive.is_some() || l.stiff),
            links,
            sources: sources
                .clone()
                .map(|d| Source { body: d.body, position: d.position, rotors: d.rotors.clone() })
                .collect(),
            per_area: sources.map(|d| d.rotors.iter().map(disc).sum()).map(per).collect(),
            loaded,
            loads,
            rotor_order,
            rotor_body: model.rotors().iter().map(|r| r.body).collect(),
            rotor_speed: layout.rotor_speed.clone(),
            rotor_action: layout.rotor_action.clone(),
            rotor_radius: model.rotors().iter().map(|r| r.rotor.radius).collect(),
            n_state: layout.n_state(),
            n_input: layout.n_input(),
            layout,
            effects,
        }
    }

    /// What another model has differently than numbers, if anything; `general` as in [`Topology::new`].
    pub(crate) fn difference(&self, model: &Model, general: bool) -> Option<String> {
        let mut links = Self::links(model, self.effects, general);
        // which joints are stiff follows from numbers, and is the batch's choice
        for (own, link) in links.iter_mut().zip(&self.links) {
            own.stiff = link.stiff;
        }
        let other = Self::with_links(model, self.effects, links);
        if self.cables != other.cables {
            return Some("with other cables, or tied elsewhere".into());
        }
        if self.layout != other.layout || self.rotor_body != other.rotor_body {
            return Some("with other bodies, joints, drives or rotors".into());
        }
        let unequal = self.links.iter().zip(&other.links).position(|(a, b)| a != b);
        if let Some(i) = unequal {
            return Some(format!("with body {i} joined otherwise or with numbers that are zero in one of the two"));
        }
        // what no effect reads may differ: a rope's length is not its capsule's where nothing touches
        let e = self.effects;
        let same = (!e.ground_effect || self.rotor_radius == other.rotor_radius)
            && (!e.downwash && !e.load_downwash || self.sources == other.sources)
            && (!e.load_downwash || (&self.loads, &self.per_area) == (&other.loads, &other.per_area))
            && (!e.contact
                || (&self.features, &self.on_ground, &self.pairs, &self.relief)
                    == (&other.features, &other.on_ground, &other.pairs, &other.relief));
        (!same).then(|| "with other rotor radii, drones or shapes".into())
    }

    /// Number of bodies.
    #[inline]
    pub(crate) fn n_body(&self) -> usize {
        self.links.len()
    }

    /// Number of rotors.
    #[inline]
    pub(crate) fn n_rotor(&self) -> usize {
        self.rotor_body.len()
    }
}

impl Link {
    fn of(body: &Body, general: bool) -> Self {
        let j = &body.joint;
        let kind = match j.motion {
            Motion::Floating => Kind::Floating,
            Motion::Revolute(axis) => Kind::Hinge(Axis::of(axis)),
            Motion::Prismatic(axis) => Kind::Slide(Axis::of(axis)),
            Motion::Ball => Kind::Ball,
        };
        let slides = matches!(kind, Kind::Slide(_));
        let i = &body.inertia;
        let any = |v: &[f64]| general || v.iter().any(|x| *x != 0.0);
        let moving = kind != Kind::Floating;
        // a body without mass and inertia stays so in every environment: mass is scaled, never added
        let massless = body.mass == 0.0 && [i.xx, i.yy, i.zz].iter().all(|x| *x == 0.0);
        Self {
            parent: body.parent,
            kind,
            turn: (j.rotation != IDENTITY).then_some(j.rotation),
            position: 0,
            velocity: 0,
            freedom: 0,
            coincident: !slides && !any(&j.position),
            massless,
            centered: !any(&body.center_of_mass),
            products: any(&[i.xy, i.xz, i.yz]),
            linear_drag: any(&body.drag.linear) || any(&body.drag.angular),
            quadratic_drag: any(&body.drag.quadratic),
            damped: moving && any(&[j.damping]),
            sprung: moving && any(&[j.stiffness]),
            stiff: false,
            limited: j.limits.is_some(),
            geared: moving && any(&[j.armature]),
            drive: None,
            rotors: (0, 0),
            disturbance: None,
            wind: None,
        }
    }
}

/// Rotor numbers sorted by the body that carries them.
fn rotor_order(model: &Model) -> Vec<usize> {
    let mut order: Vec<usize> = (0..model.rotors().len()).collect();
    order.sort_by_key(|r| model.rotors()[*r].body);
    order
}

/// Colliding shapes of a model, in order.
fn features(model: &Model) -> Vec<Feature> {
    let mut still = 0;
    let mut list = Vec::new();
    for shape in model.shapes() {
        if shape.collides {
            list.push(Feature::of(shape, still));
        }
        still += usize::from(shape.body.is_none());
    }
    list
}

fn on_ground(model: &Model, features: &[Feature]) -> Vec<Touch<usize>> {
    let contact = &model.parts().contact;
    let falls = |f: &usize| features[*f].body.is_some() && contact.ground.is_some();
    let touch =
        |f: usize| Touch { what: f, material: own_material(model, features[f].material, contact.ground_material) };
    (0..features.len()).filter(falls).map(touch).collect()
}

/// Of two things of which one at least has its own.
fn own_material(
    model: &Model,
    first: Option<ContactMaterial>,
    second: Option<ContactMaterial>,
) -> Option<ContactMaterial> {
    let usual = model.parts().contact.material;
    (first.is_some() || second.is_some()).then(|| first.unwrap_or(usual).against(&second.unwrap_or(usual)))
}

/// Pairs with a force: of different trees, of a tree and the world, and of one tree where it collides
/// with itself, those joined to each other (massless bodies between not counted) apart.
fn pairs(model: &Model, features: &[Feature]) -> Vec<Touch<Pair>> {
    let roots = root_of(model.bodies());
    let mut list = Vec::new();
    for i in 0..features.len() {
        for j in i + 1..features.len() {
            let is_box = |k: usize| matches!(features[k].form, Form::Box(_));
            let may = match (features[i].body, features[j].body) {
                (None, None) => false,
                (None, Some(_)) | (Some(_), None) => true,
                (Some(a), Some(b)) if roots[a] != roots[b] => true,
                (Some(a), Some(b)) => model.parts().contact.self_collision && a != b && !joined(model, a, b),
            };
            if may {
                let by_balls = is_box(i) || is_box(j);
                let both_move = features[i].body.is_some() && features[j].body.is_some();
                let turned = if both_move { is_box(i) && !is_box(j) } else { features[i].body.is_none() };
                let (first, second) = if by_balls && turned { (j, i) } else { (i, j) };
                let what = Pair { first, second, by_balls };
                list.push(Touch { what, material: own_material(model, features[i].material, features[j].material) });
            }
        }
    }
    list
}

/// Whether one body hangs on the other, with nothing but massless bodies between.
pub(crate) fn joined(model: &Model, a: usize, b: usize) -> bool {
    let hangs_on = |child: usize, parent: usize| {
        let mut at = model.bodies()[child].parent;
        while let Some(i) = at {
            if i == parent {
                return true;
            }
            if model.bodies()[i].mass > 0.0 {
                return false;
            }
            at = model.bodies()[i].parent;
        }
        false
    };
    hangs_on(a, b) || hangs_on(b, a)
}

impl Feature {
    fn of(shape: &BodyShape, still: usize) -> Self {
        let own = Pose::<f64> { position: shape.shape.position, attitude: shape.shape.rotation };
        // a still shape's position is a number of the model, so its points count from there
        let pose = if shape.body.is_none() { Pose { position: [0.0; 3], ..own } } else { own };
        let (form, radius, balls) = match shape.shape.geometry {
            Geometry::Sphere { radius } => {
                (Form::Sphere(pose.position), radius, vec![Ball { center: pose.position, radius }])
            }
            Geometry::Capsule { radius, length } => {
                let ends = segment(&pose, length);
                (Form::Capsule(ends), radius, balls_of_capsule(ends, radius))
            }
            Geometry::Box { size } => {
                let (rotation, half) = (matrix(pose.attitude), size.map(|edge| 0.5 * edge));
                let corners = corners(&pose, size);
                let balls = balls_of_box(&pose, &corners, half);
                (Form::Box(OrientedBox { corners, center: pose.position, rotation, half }), 0.0, balls)
            }
        };
        Self { body: shape.body, still, form, radius, balls, material: shape.material }
    }
}

/// Way between the balls by which a shape touches boxes, over their radius: what lies between two is at most 0.073 of it too
/// deep.
const BALLS: f64 = 0.75;
/// Most gaps between balls along a capsule, and along an edge of a box.
const MAX_GAPS: [f64; 2] = [64.0, 8.0];

/// Balls along the axis of a capsule, its ends included.
fn balls_of_capsule([a, b]: [[f64; 3]; 2], radius: f64) -> Vec<Ball> {
    let along = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
    let length = along.iter().map(|x| x * x).sum::<f64>().sqrt();
    let gaps = (length / (BALLS * radius)).ceil().clamp(1.0, MAX_GAPS[0]) as usize;
    let at = |i: usize| std::array::from_fn(|k| a[k] + along[k] * i as f64 / gaps as f64);
    (0..=gaps).map(|i| Ball { center: at(i), radius }).collect()
}

/// The corners of a box, and balls within it as thick as it is.
fn balls_of_box(pose: &Pose<f64>, corners: &[[f64; 3]; 8], half: [f64; 3]) -> Vec<Ball> {
    let mut balls: Vec<Ball> = corners.iter().map(|c| Ball { center: *c, radius: 0.0 }).collect();
    let radius = half[0].min(half[1]).min(half[2]);
    let room = half.map(|h| h - radius);
    let gaps = room.map(|room| (2.0 * room / (BALLS * radius)).ceil().min(MAX_GAPS[1]) as usize);
    let at = |k: usize, i: usize| if gaps[k] == 0 { 0.0 } else { room[k] * (2.0 * i as f64 / gaps[k] as f64 - 1.0) };
    for x in 0..=gaps[0] {
        for y in 0..=gaps[1] {
            for z in 0..=gaps[2] {
                balls.push(Ball { center: pose.point([at(0, x), at(1, y), at(2, z)]), radius });
            }
        }
    }
    balls
}

impl Servo {
    fn of(drive: &Drive, command: usize) -> Self {
        Self { command, center: drive.center, range: drive.range, holds_position: drive.stiffness > 0.0 }
    }
}
