//! Things in the way: what vehicles touch, how softly, and how far away it is.
//!
//! Contact pushes spheres and capsules apart. Boxes have no force there, so where tasks put something in the way, capsules
//! within them, as wide as their shortest edge, take their place: along the diagonals of a vehicle's boxes, as its arms are,
//! and side by side along the longest edge of a load's. Clearance, and with it every collision of the suite, is that of the
//! very shapes that push.
//!
//! The material is that of rubber: k = 4e4 N/m^{3/2} per kg of what flies stops it within 4 cm at 3 m/s, and substeps of
//! 4 ms resolve that (√(3k√δ/2m) ≈ 100 rad/s for all of it, 230 rad/s for a fifth of its mass). What flies is the vehicle, or
//! a team with what it holds: its thin bars are thinner than the way on which a vehicle's share of k would stop it. Ours.

use super::{eased, times};
use crate::config::EnvConfig;
use crate::declare::Writer;
use crate::robot::Robot;
use crate::settings;
use crate::start::{Start, StartScalar};
use crate::task::View;
use autodiff::{Mask, Scalar, Trace, safe};
use base::error::Result;
use dynamics::assembly::{Member, rod};
use dynamics::configurations::environment;
use dynamics::contact::ContactMaterial;
use dynamics::contact::distance::to_capsule;
use dynamics::frame::{FRAME, Frame};
use dynamics::scene::{FAR, Obstacle, Scene};
use dynamics::shape::{Geometry, Pose, Shape};
use dynamics::spatial::{Vec3, constants};
use dynamics::tree::parameters::static_parameters;
use dynamics::tree::{BodyShape, Model, ModelParts};
use dynamics::{Effects, Physics, Vehicle};

/// Longest substep that resolves the material, s.
const SUBSTEP: f64 = 0.004;
/// k per kg of what flies, N/m^{3/2}.
const STIFFNESS: f64 = 4e4;

/// Physics in which things touch.
pub(super) fn touching(config: &EnvConfig) -> Physics {
    let mut physics = config.physics_with(|e: &mut Effects| e.contact = true);
    physics.substeps = physics.substeps.max((physics.dt / SUBSTEP).ceil() as usize);
    physics
}

/// A model whose contacts are those of `mass` kg that fly, with capsules for the boxes of its bodies.
///
/// # Errors
/// None for a mass that a vehicle may have.
pub(super) fn softened(model: &Model, mass: f64) -> Result<Model> {
    let mut parts: ModelParts = model.parts().clone();
    let shapes = parts.shapes.iter().flat_map(|own| {
        match (own.body, own.shape.geometry) {
            (Some(_), Geometry::Box { size }) => slats(&own.shape, size),
            _ => vec![own.shape],
        }
        .into_iter()
        .map(|shape| BodyShape { shape, ..own.clone() })
    });
    parts.shapes = shapes.collect();
    parts.contact.material =
        ContactMaterial { stiffness: STIFFNESS * mass, slip_speed: 1.0, ..ContactMaterial::default() };
    Model::new(parts)
}

/// A team in a scene, with the contacts of all that it weighs.
///
/// # Errors
/// As [`environment()`].
pub(super) fn course(name: &str, team: Model, scene: &Scene) -> Result<Model> {
    let mass = team.bodies().iter().map(|body| body.mass).sum();
    softened(&environment(name, &[Member::new("rig", team, [0.0; 3])], scene)?, mass)
}

/// The vehicle with capsules along the diagonals of its boxes.
pub(super) fn rounded(vehicle: &Vehicle) -> Vehicle {
    let shapes = vehicle.shapes.iter().flat_map(|shape| match shape.geometry {
        Geometry::Box { size } => diagonals(shape, size),
        _ => vec![*shape],
    });
    Vehicle { shapes: shapes.collect(), ..vehicle.clone() }
}

/// Capsules within a box along those of its diagonals that differ.
fn diagonals(shape: &Shape, size: [f64; 3]) -> Vec<Shape> {
    let radius = 0.5 * size.into_iter().fold(f64::INFINITY, f64::min);
    let half = size.map(|edge| 0.5 * edge - radius);
    let mut ends: Vec<[f64; 3]> = Vec::new();
    for [y, z] in [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]] {
        let end = [half[0], y * half[1], z * half[2]];
        if !ends.iter().any(|e| *e == end || *e == end.map(|x| -x)) {
            ends.push(end);
        }
    }
    let carrier = Pose { position: shape.position, attitude: shape.rotation };
    ends.into_iter().map(|end| rod(carrier.point(end.map(|x| -x)), carrier.point(end), radius)).collect()
}

/// Capsules within a box along its longest edge, side by side no further apart than ¾ of their width: no bar goes between.
fn slats(shape: &Shape, size: [f64; 3]) -> Vec<Shape> {
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| size[*a].total_cmp(&size[*b]));
    let [short, middle, long] = order;
    let radius = 0.5 * size[short];
    let (reach, half) = (0.5 * size[middle] - radius, 0.5 * size[long] - radius);
    let gaps = (reach / (0.75 * radius)).ceil();
    let carrier = Pose { position: shape.position, attitude: shape.rotation };
    let slat = |i: usize| {
        let mut ends = [[0.0; 3]; 2];
        for (end, sign) in ends.iter_mut().zip([-1.0, 1.0]) {
            end[middle] = if gaps > 0.0 { reach * (2.0 * i as f64 / gaps - 1.0) } else { 0.0 };
            end[long] = sign * half;
        }
        rod(carrier.point(ends[0]), carrier.point(ends[1]), radius)
    };
    (0..=gaps as usize).map(slat).collect()
}

/// A ball on a vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ball {
    /// Its middle, body, m.
    pub centre: Vec3<f64>,
    /// m.
    pub radius: f64,
}

/// What may touch without contact forces: a ball about every propeller and one about every shape of a vehicle.
pub(super) fn balls(vehicle: &Vehicle) -> Vec<Ball> {
    let about = |shape: &Shape| {
        let radius = match shape.geometry {
            Geometry::Sphere { radius } => radius,
            Geometry::Capsule { radius, length } => radius + 0.5 * length,
            Geometry::Box { size } => 0.5 * size.into_iter().fold(0.0, f64::max),
        };
        Ball { centre: shape.position, radius }
    };
    let propellers = vehicle.rotors.iter().map(|rotor| Ball { centre: rotor.position, radius: rotor.radius });
    propellers.chain(vehicle.shapes.iter().map(about)).collect()
}

/// What touches, propellers included: all points within a radius of segments between two points of a vehicle.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Outline(Vec<Bar>);

/// All points within `radius` of the segment between two points of a vehicle, m, body.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Bar {
    ends: [Vec3<f64>; 2],
    radius: f64,
}

impl Outline {
    /// Capsules and balls of a vehicle, of its boxes the diagonals, and a ball about every propeller.
    pub(crate) fn of(vehicle: &Vehicle) -> Self {
        let bar = |shape: &Shape| {
            let (radius, length) = match shape.geometry {
                Geometry::Capsule { radius, length } => (radius, length),
                Geometry::Sphere { radius } => (radius, 0.0),
                Geometry::Box { size } => (0.5 * size.into_iter().fold(f64::INFINITY, f64::min), 0.0),
            };
            let pose = Pose { position: shape.position, attitude: shape.rotation };
            Bar { ends: [-0.5, 0.5].map(|share| pose.point([0.0, 0.0, share * length])), radius }
        };
        let propellers = vehicle.rotors.iter().map(|rotor| Bar { ends: [rotor.position; 2], radius: rotor.radius });
        Self(rounded(vehicle).shapes.iter().map(bar).chain(propellers).collect())
    }

    /// Least distance of a vehicle at `frame` to upright columns, up to `most`, m: of their outlines from above.
    pub(crate) fn clearance<S: Scalar>(
        &self,
        frame: &Frame<S>,
        place: impl Fn(usize) -> [S; 2],
        radii: &[f64],
        most: f64,
    ) -> S {
        let (zero, one) = (S::zero(), S::one());
        let mut least = S::constant(most);
        for k in 0..self.0.len() {
            let bar = &self.0[k];
            let is_ball = bar.ends[0] == bar.ends[1];
            let a = frame.point(constants(bar.ends[0])).0;
            let b = if is_ball { a } else { frame.point(constants(bar.ends[1])).0 };
            let along = [b[0] - a[0], b[1] - a[1]];
            let inverse = safe::squared_norm(along).max(S::constant(1e-9)).recip();
            for i in 0..radii.len() {
                let [x, y] = place(i);
                let mut away = [x - a[0], y - a[1]];
                if !is_ball {
                    let share = (along[0].mul_add(away[0], along[1] * away[1]) * inverse).max(zero).min(one);
                    away = [(-share).mul_add(along[0], away[0]), (-share).mul_add(along[1], away[1])];
                }
                least = least.min(safe::norm(away) - S::constant(radii[i] + bar.radius));
            }
        }
        least
    }

    /// Largest distance of a point of it from the origin, m.
    pub(crate) fn reach(&self) -> f64 {
        let ends = self.0.iter().flat_map(|bar| bar.ends.map(|end| safe::norm(end) + bar.radius));
        ends.fold(0.0, f64::max)
    }
}

/// What touches: shapes of one tree, each with the body that carries it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CollisionShapes(Vec<(usize, Shape)>);

impl CollisionShapes {
    /// Of the model's first tree.
    pub(super) fn of(model: &Model) -> Self {
        Self::of_tree(model, 0)
    }

    /// Of a tree.
    pub(crate) fn of_tree(model: &Model, tree: usize) -> Self {
        let own = &model.layout().trees[tree].bodies;
        let touches = model.shapes().iter().filter(|s| s.collides);
        Self(touches.filter_map(|s| s.body.filter(|b| own.contains(b)).map(|b| (b, s.shape))).collect())
    }

    /// All on the root, where joints at rest have it: for starts that place the root alone.
    pub(super) fn at_rest(robot: &Robot, model: &Model) -> Self {
        let mut state = robot.rest().to_vec();
        state[..3].fill(0.0);
        state[6..10].copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
        let mut frames = vec![0.0; robot.n_frame() * FRAME];
        robot.plant().write_frames(&robot.parameters(), &state, &mut frames);
        let on_root = |(body, shape): (usize, Shape)| {
            let carrier = Frame::read(&frames[body * FRAME..]);
            let pose = shape.pose(&Pose { position: carrier.position, attitude: carrier.attitude });
            (0, Shape { position: pose.position, rotation: pose.attitude, ..shape })
        };
        Self(Self::of(model).0.into_iter().map(on_root).collect())
    }

    /// Least distance to capsules of `radius` around `axes`, m: negative where they touch.
    pub(crate) fn clearance<S: Scalar>(&self, view: &View<'_, S>, axes: &[[Vec3<S>; 2]], radius: f64) -> S {
        let mut least = S::constant(FAR);
        for i in 0..self.0.len() {
            let (body, shape) = &self.0[i];
            let carrier = view.frame(*body);
            let pose = Pose { position: carrier.position, attitude: carrier.attitude };
            least = least.min(gap(shape, &pose, axes, radius));
        }
        least
    }

    /// The same of a skin [at rest](CollisionShapes::at_rest) whose root is at `pose`.
    pub(super) fn clearance_at(&self, pose: &Pose<f64>, axes: &[[Vec3<f64>; 2]], radius: f64) -> f64 {
        self.0.iter().fold(FAR, |least, (_, shape)| least.min(gap(shape, pose, axes, radius)))
    }
}

/// Least distance of a shape on a carrier to capsules of `radius` around `axes`, m.
fn gap<S: Scalar>(shape: &Shape, carrier: &Pose<S>, axes: &[[Vec3<S>; 2]], radius: f64) -> S {
    let pose = shape.pose(carrier);
    let mut least = S::constant(FAR);
    for k in 0..axes.len() {
        least = least.min(to_capsule(&shape.geometry, &pose, axes[k], radius));
    }
    least
}

/// Whether a clearance means touch.
pub(super) fn touches<S: Scalar>(clearance: S) -> S::Mask {
    clearance.lt(S::zero())
}

/// 1 where nothing touches, else 0.
pub(super) fn free<S: Scalar>(clearance: S) -> S {
    S::select(touches(clearance), S::zero(), S::one())
}

/// The mask of an end that a setting switches on.
pub(super) fn where_on<S: Scalar>(on: bool, mask: S::Mask) -> S::Mask {
    if on { mask } else { mask.and(mask.not()) }
}

/// What training losses pay near a bar, see [`nearness`].
pub(super) const NEARNESS: &str = "{×loss_clearance}e^{−10 max(clearance, −0.2 m)}";

/// w e^{−10 c} of a clearance held above −0.2 m.
pub(super) fn nearness<S: Scalar>(weight: f64, clearance: S) -> S {
    times(weight, times(-10.0, clearance.max(S::constant(-0.2))).exp())
}

settings! {
    /// Two level bars in the way.
    pub struct BarsSettings {
        spacing: [f64; 2] = [0.85, 0.85] => ("m", "of the obstacles, lowest and highest", PositiveOrdered);
        spacing_ease: f64 = 1.0 => ("-", "factor of the spacing at difficulty 0", Positive);
    }
}

/// Half length of a level bar, m.
const HALF_LENGTH: f64 = 2.5;
/// Of a level bar, m.
const RADIUS: f64 = 0.04;
/// Height of the lower bar, m.
const LOW: f64 = 1.2;
/// Numbers of two bars in a goal.
pub(super) const BARS: usize = 2;

/// Two level bars along y across the way, at x = 0: capsules of radius 0.04 m, 5 m long, one at z = 1.2 m, one above.
#[derive(Debug, Clone)]
pub(super) struct Bars {
    skin: CollisionShapes,
    /// Where their heights stand among the robot's numbers.
    numbers: [usize; BARS],
    settings: BarsSettings,
    /// Where their heights stand in the goal.
    goal: usize,
}

impl Bars {
    /// At their nominal place.
    pub(super) fn scene(settings: &BarsSettings) -> Scene {
        let bar = |name: &str, z: f64| Obstacle {
            name: name.into(),
            shape: rod([0.0, -HALF_LENGTH, z], [0.0, HALF_LENGTH, z], RADIUS),
        };
        let high = LOW + 0.5 * (settings.spacing[0] + settings.spacing[1]);
        Scene { obstacles: vec![bar("lower", LOW), bar("upper", high)], ..Scene::default() }
    }

    /// Of a model in [`Bars::scene`], with their heights in the goal from `goal` on.
    pub(super) fn of(model: &Model, settings: &BarsSettings, goal: usize) -> Self {
        let z = |i| static_parameters(model.bodies().len(), model.rotors().len(), i) + 2;
        Self { skin: CollisionShapes::of(model), numbers: [z(0), z(1)], settings: settings.clone(), goal }
    }

    /// Numbers of the robot that vary.
    pub(super) fn numbers(&self) -> [usize; BARS] {
        self.numbers
    }

    /// Draws their heights into the goal.
    pub(super) fn draw<S: StartScalar>(&self, start: &mut Start<'_, S>) {
        let [low, high] = self.settings.spacing;
        let factor = eased(self.settings.spacing_ease, start.difficulty);
        let heights = [S::from(LOW), S::from(LOW) + factor * start.task.uniform(low, high)];
        start.goal.field("bars", "m, world", "z of lower and upper bar").array(heights);
        for (place, z) in self.numbers.into_iter().zip(heights) {
            start.numbers[place] = z;
        }
    }

    fn axes<S: Scalar>(&self, goal: &[S]) -> [[Vec3<S>; 2]; BARS] {
        let (zero, y) = (S::zero(), S::constant(HALF_LENGTH));
        let mut axes = [[[zero; 3]; 2]; BARS];
        for i in 0..BARS {
            let z = goal[self.goal + i];
            axes[i] = [[zero, -y, z], [zero, y, z]];
        }
        axes
    }

    /// Least distance of everything that flies, m.
    pub(super) fn clearance<S: Scalar>(&self, view: &View<'_, S>) -> S {
        self.skin.clearance(view, &self.axes(view.goal), RADIUS)
    }

    /// Whether a skin at rest, its root at `pose`, is clear of the bars as drawn.
    pub(super) fn clear_of(&self, start: &Start<'_, f64>, rest: &CollisionShapes, pose: &Pose<f64>) -> bool {
        rest.clearance_at(pose, &self.axes(&start.goal), RADIUS) > 0.0
    }

    /// Where they are, seen from `position`.
    pub(super) fn observe(&self, view: &View, position: Vec3<Trace>, out: &mut Writer) {
        out.field("bars", "m, world", "(x, z) of lower and upper bar − (x, z) of p");
        for i in 0..BARS {
            out.array([-position[0], view.goal[self.goal + i] - position[2]]);
        }
    }
}
