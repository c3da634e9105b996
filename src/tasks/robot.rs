//! What flies in a task: a vehicle or an articulated model, its drones, and where their numbers stand.
//!
//! Every task sees the same picture: **frames**, the motion of bodies along world axes, and **drones**, each with a frame,
//! rotors and drives. A vehicle alone has one frame; a model has one per body.

use autodiff::{Array, Scalar, System};
use base::error::{Error, Result};
use dynamics::domain::Domain;
pub use dynamics::plant::RotorPlace;
use dynamics::rotor::holding_action;
use dynamics::spatial::{Quat, conjugate, constants, multiply, up_axis};
use dynamics::tree::{Model, Multibody};
use dynamics::{Effects, Physics, Plant, Vehicle, tree};

/// Time constant of the motors in the benchmark tasks, s: the paper's filter of 0.43 per 16 ms.
pub const MOTOR_TIME_CONSTANT: f64 = 0.02846;
/// Rates at which speed and rotation fade in the benchmark tasks, 1/s: F = −0.2 m v, M = −0.2 J ω.
pub const DAMPING: f64 = 0.2;

/// A vehicle as the benchmark tasks fly it: the paper's motor lag and effective damping, no other drag.
pub fn benchmark(vehicle: &Vehicle) -> Vehicle {
    let total = vehicle.mass_properties();
    let mut own = vehicle.clone();
    own.drag.linear = [DAMPING * total.mass; 3];
    own.drag.quadratic = [0.0; 3];
    own.drag.angular = [0, 1, 2].map(|i| DAMPING * total.inertia[(i, i)]);
    for rotor in &mut own.rotors {
        (rotor.time_constant_up, rotor.time_constant_down) = (MOTOR_TIME_CONSTANT, MOTOR_TIME_CONSTANT);
    }
    own
}

/// A model whose motors have the paper's lag.
///
/// # Errors
/// As [`Model::new`].
pub fn benchmark_motors(model: &Model) -> Result<Model> {
    let mut parts = model.parts().clone();
    for mounted in &mut parts.rotors {
        let rotor = &mut mounted.rotor;
        (rotor.time_constant_up, rotor.time_constant_down) = (MOTOR_TIME_CONSTANT, MOTOR_TIME_CONSTANT);
    }
    Model::new(parts)
}

/// A drive of a drone: a tilting unit, a gimbal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DrivePlace {
    /// Of its angle in the state.
    pub angle: usize,
    /// Of its rate in the state.
    pub rate: usize,
    /// Of its command in the input.
    pub command: usize,
}

/// One drone of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct DronePlace {
    /// Its frame.
    pub frame: usize,
    /// In the vehicle's order.
    pub rotors: Vec<RotorPlace>,
    /// What its other actions move.
    pub drives: Vec<DrivePlace>,
}

impl DronePlace {
    /// Numbers of its actions: rotors, then drives.
    pub fn n_action(&self) -> usize {
        self.rotors.len() + self.drives.len()
    }

    /// Places of its actions in the input: rotors, then drives.
    pub fn commands(&self) -> impl Iterator<Item = usize> + '_ {
        self.rotors.iter().map(|r| r.action).chain(self.drives.iter().map(|d| d.command))
    }
}

/// What flies in a task.
#[derive(Debug, Clone)]
pub struct Robot {
    pub(crate) plant: Plant,
    /// The vehicle of every drone, if they are plain multirotors; what control modes are built from.
    pub(crate) vehicle: Option<Vehicle>,
    drones: Vec<DronePlace>,
    rest: Vec<f64>,
    /// First of each tree's numbers in the state.
    roots: Vec<usize>,
    /// Per tree: how a vehicle that does not hover level leans, as a turn from the axes in which it does.
    leans: Vec<Option<Quat<f64>>>,
    /// Numbers that differ between environments, ascending.
    varied: Vec<usize>,
}

impl Robot {
    /// A vehicle alone; build it with `benchmark` for the benchmark's physics.
    ///
    /// # Errors
    /// As [`Plant::of_vehicle`] and [`Plant::hover_state`].
    pub fn of_vehicle(vehicle: &Vehicle, physics: Physics) -> Result<Self> {
        let plant = Plant::of_vehicle(vehicle, physics)?;
        let drone = DronePlace { frame: 0, rotors: plant.rotor_places(), drives: Vec::new() };
        Self::of_plant(plant, vec![drone], Some(vehicle.clone()))
    }

    /// A model: each of its drones is one, with the drives that `drives` gives it. Rotors rest at the share of weight that
    /// falls on them. `vehicle` is what every drone is, if they are alike: control modes and controllers are built from it.
    ///
    /// # Errors
    /// As [`Multibody::new`]; [`Error::Value`] for a vehicle with other numbers of rotors than a drone.
    pub fn of_model(
        model: &Model,
        physics: Physics,
        vehicle: Option<&Vehicle>,
        drives: impl Fn(usize) -> Vec<usize>,
    ) -> Result<Self> {
        let system = Multibody::new(model, physics)?;
        let own = |(i, drone): (usize, &tree::Drone)| place(&system, drone.body, &drone.rotors, &drives(i));
        let drones: Vec<DronePlace> = model.drones().iter().enumerate().map(own).collect();
        for n in drones.iter().map(|drone| drone.rotors.len()) {
            if let Some(vehicle) = vehicle.filter(|vehicle| vehicle.n_rotor() != n) {
                let limit = format!("{n}, as of every drone that it stands for");
                let remedy = "Give no vehicle where drones are unlike.";
                return Err(Error::value("rotors of the vehicle", vehicle.n_rotor(), limit, remedy));
            }
        }
        Self::of_plant(system.into(), drones, vehicle.cloned())
    }

    /// A model as one drone with all its rotors, in their order, and these drives; body `frame` is where it is. For
    /// machines whose parts are no drones by themselves.
    ///
    /// # Errors
    /// As [`Multibody::new`].
    pub fn of_model_as_one(model: &Model, physics: Physics, frame: usize, drives: &[usize]) -> Result<Self> {
        let system = Multibody::new(model, physics)?;
        let rotors: Vec<usize> = (0..model.rotors().len()).collect();
        let drone = place(&system, frame, &rotors, drives);
        Self::of_plant(system.into(), vec![drone], None)
    }

    fn of_plant(plant: Plant, drones: Vec<DronePlace>, vehicle: Option<Vehicle>) -> Result<Self> {
        let (rest, roots) = (plant.hover_state()?, plant.roots());
        let at = |state: &[f64], root: usize| [6, 7, 8, 9].map(|k| state[root + k]);
        let level =
            plant.tree().map_or_else(|| [[0.0; 6], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]].concat(), Multibody::rest_state);
        let floats = |tree: usize| {
            plant.tree().is_none_or(|m| {
                let root = m.layout().trees[tree].bodies.start;
                m.model().bodies()[root].joint.motion == tree::Motion::Floating
            })
        };
        let lean = |(tree, root): (usize, &usize)| {
            let turn =
                floats(tree).then(|| (at(&level, *root), at(&rest, *root))).filter(|(level, own)| level != own)?;
            Some(multiply(conjugate(turn.0), turn.1))
        };
        Ok(Self {
            leans: roots.iter().enumerate().map(lean).collect(),
            rest,
            roots,
            plant,
            vehicle,
            drones,
            varied: Vec::new(),
        })
    }

    /// The attitude of a tree's root for one of the axes in which it hovers level.
    pub(crate) fn attitude_of_body<S: Scalar>(&self, tree: usize, attitude: Quat<S>) -> Quat<S> {
        self.leans[tree].map_or(attitude, |turn| multiply(attitude, constants(turn)))
    }

    /// The inverse of [`attitude_of_body`](Self::attitude_of_body).
    pub(crate) fn attitude_of_hover_axes<S: Scalar>(&self, tree: usize, attitude: Quat<S>) -> Quat<S> {
        self.leans[tree].map_or(attitude, |turn| multiply(attitude, constants(conjugate(turn))))
    }

    /// The same robot with these numbers ([`Robot::parameters`]) differing between environments.
    pub fn varying(mut self, numbers: impl IntoIterator<Item = usize>) -> Self {
        self.varied.extend(numbers);
        self.varied.sort_unstable();
        self.varied.dedup();
        self
    }

    /// The same robot with mass, centre of mass and inertia of body `body` differing between environments.
    pub fn varying_inertial(self, body: usize) -> Self {
        let place = Inertial::place(body);
        self.varying(place..place + 10)
    }

    /// Which of [`Robot::parameters`] differ between environments.
    pub fn varied(&self) -> &[usize] {
        &self.varied
    }

    /// Its drones, in the order of the agents.
    pub fn drones(&self) -> &[DronePlace] {
        &self.drones
    }

    /// Where the commands of all agents go in the input, in rows of `width`; nowhere behind an agent's own.
    pub(crate) fn command_places(&self, width: usize) -> impl Iterator<Item = Option<usize>> + '_ {
        self.drones.iter().flat_map(move |drone| {
            let none = width.saturating_sub(drone.n_action());
            drone.commands().map(Some).chain(std::iter::repeat_n(None, none))
        })
    }

    /// Drone 0.
    pub fn drone(&self) -> &DronePlace {
        &self.drones[0]
    }

    /// The system that is simulated.
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// The articulated model, if it is one.
    pub fn model(&self) -> Option<&Model> {
        self.plant.tree().map(Multibody::model)
    }

    /// Time step, integrator, effects.
    pub fn physics(&self) -> &Physics {
        self.plant.physics()
    }

    /// Numbers of the state.
    pub fn n_state(&self) -> usize {
        self.rest.len()
    }

    /// Numbers of the input, disturbances included.
    pub fn n_input(&self) -> usize {
        self.plant.n_input()
    }

    /// Number of frames: one per body.
    pub fn n_frame(&self) -> usize {
        self.plant.n_frame()
    }

    /// Every joint at rest, rotors at hover: where [`Start`](super::Start) begins.
    pub fn rest(&self) -> &[f64] {
        &self.rest
    }

    /// The largest angle by which a vehicle leans in hover ([`HoverTrim::lean`](dynamics::HoverTrim::lean)), rad: starts have it, and
    /// what a task rewards along body z is missed by its cosine.
    pub fn hover_lean(&self) -> f64 {
        let lean = |turn: &Quat<f64>| up_axis(*turn)[2].clamp(-1.0, 1.0).acos();
        self.leans.iter().flatten().map(lean).fold(0.0, f64::max)
    }

    /// Input that holds the rotors at the speeds of [`Robot::rest`], all else 0.
    pub fn hover_input(&self) -> Vec<f64> {
        let mut input = vec![0.0; self.n_input()];
        for rotor in self.drones.iter().flat_map(|d| &d.rotors) {
            input[rotor.action] = holding_action(rotor.max_speed, self.rest[rotor.speed]);
        }
        input
    }

    /// Nominal numbers: [`Plant::parameters`].
    pub fn parameters(&self) -> Vec<f64> {
        self.plant.parameters()
    }

    /// Names of [`Robot::parameters`].
    pub fn parameter_names(&self) -> Vec<String> {
        self.plant.parameter_names()
    }

    /// What each of [`Robot::parameters`] may be.
    pub fn parameter_domains(&self) -> Vec<Domain> {
        self.plant.parameter_domains()
    }

    /// First of each tree's numbers in the state.
    #[doc(hidden)]
    pub fn roots(&self) -> &[usize] {
        &self.roots
    }

    /// Where the nine numbers of each tree's disturbance stand in the input.
    #[doc(hidden)]
    pub fn disturbances(&self) -> Vec<usize> {
        self.plant.disturbances()
    }
}

/// A drone of a model: its frame, rotors and drives by number.
fn place(system: &Multibody, frame: usize, rotors: &[usize], drives: &[usize]) -> DronePlace {
    let (model, layout) = (system.model(), system.layout());
    let rotor = |r: &usize| RotorPlace {
        speed: layout.rotor_speed[*r],
        action: layout.rotor_action[*r],
        max_speed: model.rotors()[*r].rotor.max_speed,
    };
    let drive = |body: &usize| {
        let own = &layout.bodies[*body];
        layout.drive[*body].map(|command| DrivePlace { angle: own.position, rate: own.velocity, command })
    };
    DronePlace { frame, rotors: rotors.iter().map(rotor).collect(), drives: drives.iter().filter_map(drive).collect() }
}

/// The effects of the benchmark tasks: damping alone.
pub(crate) fn benchmark_effects() -> Effects {
    Effects::lean()
}

/// Mass, centre of mass and inertia about it, as a task changes them at a reset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertial<S = f64> {
    /// kg.
    pub mass: S,
    /// m, body.
    pub center_of_mass: [S; 3],
    /// About the centre of mass, kg m²: xx, yy, zz, xy, xz, yz.
    pub inertia: [S; 6],
}

impl<S: Scalar> Inertial<S> {
    fn along_axes(mass: S, moments: [S; 3], center_of_mass: [S; 3]) -> Self {
        let [x, y, z] = moments;
        Self { mass, center_of_mass, inertia: [x, y, z, S::zero(), S::zero(), S::zero()] }
    }

    /// A solid ball.
    pub fn ball(mass: S, radius: f64, center_of_mass: [S; 3]) -> Self {
        Self::along_axes(mass, [S::constant(0.4 * radius * radius) * mass; 3], center_of_mass)
    }

    /// A solid box with edges `size`.
    pub fn cuboid(mass: S, size: [f64; 3], center_of_mass: [S; 3]) -> Self {
        let [x, y, z] = size.map(|s| s * s / 12.0);
        Self::along_axes(mass, [y + z, x + z, x + y].map(|own| S::constant(own) * mass), center_of_mass)
    }

    /// A solid capsule along z, `length` between the middles of its ends: [`Geometry::inertia`](dynamics::shape::Geometry::inertia).
    pub fn capsule(mass: S, radius: f64, length: S, center_of_mass: [S; 3]) -> Self {
        let (r, square) = (radius, length.square());
        let constant = S::constant;
        let balls = mass * constant(4.0 * r) / (constant(3.0) * length + constant(4.0 * r));
        let cylinder = mass - balls;
        let across = cylinder * (constant(1.0 / 12.0) * square + constant(0.25 * r * r))
            + balls * (constant(0.4 * r * r) + constant(0.25) * square + constant(0.375 * r) * length);
        let along = constant(0.5 * r * r) * cylinder + constant(0.4 * r * r) * balls;
        Self::along_axes(mass, [across, across, along], center_of_mass)
    }

    /// The same body `factor` times as heavy.
    pub fn scaled(&self, factor: S) -> Self {
        let inertia = self.inertia.map(|own| factor * own);
        Self { mass: factor * self.mass, center_of_mass: self.center_of_mass, inertia }
    }

    /// Two bodies welded together (Steiner's theorem).
    pub fn and(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        let inverse = S::one() / mass.max(S::constant(1e-30));
        let center_of_mass =
            [0, 1, 2].map(|i| (self.mass * self.center_of_mass[i] + other.mass * other.center_of_mass[i]) * inverse);
        let (a, b) = (self.about(center_of_mass), other.about(center_of_mass));
        Self { mass, center_of_mass, inertia: std::array::from_fn(|k| a[k] + b[k]) }
    }

    fn about(&self, point: [S; 3]) -> [S; 6] {
        let [x, y, z] = [0, 1, 2].map(|i| self.center_of_mass[i] - point[i]);
        let (m, [xx, yy, zz, xy, xz, yz]) = (self.mass, self.inertia);
        [
            xx + m * (y * y + z * z),
            yy + m * (x * x + z * z),
            zz + m * (x * x + y * y),
            xy - m * x * y,
            xz - m * x * z,
            yz - m * y * z,
        ]
    }

    /// From the numbers of body 0 of a [`Robot`]'s, or of body `body` where there are several.
    pub fn read(numbers: &[S], body: usize) -> Self {
        let n: [S; 10] = numbers.array(Inertial::place(body));
        let [mass, x, y, z, inertia @ ..] = n;
        Self { mass, center_of_mass: [x, y, z], inertia }
    }

    /// Over the numbers of body `body`.
    pub fn write(&self, numbers: &mut [S], body: usize) {
        let own = &mut numbers[Inertial::place(body)..][..10];
        own[0] = self.mass;
        own[1..4].copy_from_slice(&self.center_of_mass);
        own[4..].copy_from_slice(&self.inertia);
    }
}

impl Inertial {
    /// Where a body's mass stands among the numbers of a robot; centre of mass and inertia follow.
    pub fn place(body: usize) -> usize {
        1 + body * tree::LINK_PARAMETERS.len()
    }
}
