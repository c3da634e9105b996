//! What flies, rigid or articulated, behind one type: state, inputs, parameters by name, step, frames, rotors.

use super::domain::Domain;
use super::frame::Frame;
use super::hover::BALANCED;
use super::multirotor::{Multirotor, Physics};
use super::rigid::{self, RIGID_DIM};
use super::spatial::multiply;
use super::tree::{self, Model, Motion, Multibody, TreePlace, carrier};
use super::vehicle::{GRAVITY, Rotor, Vehicle};
use autodiff::{Scalar, System};
use base::error::{Error, Result};

/// Speed that a lost rotor keeps, as a share of its largest: the equations of a motor need one. Its thrust is 1e-6 T_max.
const STOPPED: f64 = 1e-3;

/// A rigid vehicle in closed form or an articulated system, as a [`System`]: state, input and parameters as theirs.
#[derive(Debug, Clone)]
#[expect(clippy::large_enum_variant, reason = "a few per simulation")]
pub enum Plant {
    /// One vehicle, in closed form.
    Rigid(Multirotor),
    /// Bodies in trees.
    Tree(Multibody),
}

/// Name and unit of one number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Quantity {
    /// As in files and tables: `rotor_0.max_speed`.
    pub name: String,
    /// SI; `-` for a pure number.
    pub unit: &'static str,
}

impl Quantity {
    fn new(name: impl Into<String>, unit: &'static str) -> Self {
        Self { name: name.into(), unit }
    }
}

/// Where the numbers of one rotor stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RotorPlace {
    /// Place of its speed in the state.
    pub speed: usize,
    /// Place of its action in the input.
    pub action: usize,
    /// Nominal largest speed, rad/s.
    pub max_speed: f64,
}

impl From<Multirotor> for Plant {
    fn from(vehicle: Multirotor) -> Self {
        Self::Rigid(vehicle)
    }
}

impl From<Multibody> for Plant {
    fn from(system: Multibody) -> Self {
        Self::Tree(system)
    }
}

impl Plant {
    /// A vehicle in closed form.
    ///
    /// # Errors
    /// As [`Multirotor::new`].
    pub fn of_vehicle(vehicle: &Vehicle, physics: Physics) -> Result<Self> {
        Multirotor::new(vehicle, physics).map(Self::Rigid)
    }

    /// An articulated model.
    ///
    /// # Errors
    /// As [`Multibody::new`].
    pub fn of_model(model: &Model, physics: Physics) -> Result<Self> {
        Multibody::new(model, physics).map(Self::Tree)
    }

    /// The same plant with its physical parameters as θ; pass [`Plant::parameters`] to `step`.
    pub fn with_parameters(self) -> Self {
        match self {
            Self::Rigid(m) => Self::Rigid(m.with_parameters()),
            Self::Tree(m) => Self::Tree(m.with_parameters()),
        }
    }

    /// The plant as it flies on when rotor i keeps the share e = `effectiveness[i]` (0 to 1) of its largest thrust: √e of its largest
    /// speed, of a lost one 10⁻³. Rotors without an entry are whole.
    ///
    /// # Errors
    /// None for a valid plant.
    pub fn damaged(&self, effectiveness: &[f64]) -> Result<Self> {
        match self {
            Self::Rigid(m) => Self::of_vehicle(&damaged(m.vehicle(), effectiveness), *m.physics()),
            Self::Tree(m) => {
                let mut parts = m.model().parts().clone();
                parts.rotors.iter_mut().zip(effectiveness).for_each(|(r, e)| weaken(&mut r.rotor, *e));
                Self::of_model(&Model::new(parts)?, *m.physics())
            }
        }
    }

    /// The plant with motors that speed up and slow down with the longer of their lags: where both differ, a step has a kink at every
    /// steady speed, and what plans by its derivatives gets stuck there.
    ///
    /// # Errors
    /// None for a valid plant.
    pub fn with_longer_lags(&self) -> Result<Self> {
        let even = |rotor: &mut Rotor| {
            let longer = rotor.time_constant_up.max(rotor.time_constant_down);
            (rotor.time_constant_up, rotor.time_constant_down) = (longer, longer);
        };
        match self {
            Self::Rigid(m) => {
                let mut vehicle = m.vehicle().clone();
                vehicle.rotors.iter_mut().for_each(even);
                Self::of_vehicle(&vehicle, *m.physics())
            }
            Self::Tree(m) => {
                let mut parts = m.model().parts().clone();
                parts.rotors.iter_mut().for_each(|r| even(&mut r.rotor));
                Self::of_model(&Model::new(parts)?, *m.physics())
            }
        }
    }

    /// Name of the vehicle or model.
    pub fn name(&self) -> &str {
        match self {
            Self::Rigid(m) => &m.vehicle().name,
            Self::Tree(m) => m.model().name(),
        }
    }

    /// Nominal mass of all bodies, kg.
    pub fn mass(&self) -> f64 {
        match self {
            Self::Rigid(system) => system.vehicle().mass_properties().mass,
            Self::Tree(system) => system.model().mass(),
        }
    }

    /// Time step, integrator, effects.
    pub fn physics(&self) -> &Physics {
        match self {
            Self::Rigid(m) => m.physics(),
            Self::Tree(m) => m.physics(),
        }
    }

    /// The articulated system, if it is one.
    pub fn tree(&self) -> Option<&Multibody> {
        match self {
            Self::Rigid(_) => None,
            Self::Tree(m) => Some(m),
        }
    }

    /// Nominal physical parameters, SI: `rigid::parameter_vector` of a vehicle, `tree::model_parameters` of a model.
    pub fn parameters(&self) -> Vec<f64> {
        match self {
            Self::Rigid(m) => m.parameters(),
            Self::Tree(m) => m.parameters().to_vec(),
        }
    }

    /// Names of [`Plant::parameters`].
    pub fn parameter_names(&self) -> Vec<String> {
        match self {
            Self::Rigid(m) => rigid::parameter_names(m.vehicle()),
            Self::Tree(m) => tree::model_parameter_names(m.model()),
        }
    }

    /// What each of [`Plant::parameters`] may be.
    pub fn parameter_domains(&self) -> Vec<Domain> {
        match self {
            Self::Rigid(m) => rigid::parameter_domains(m.vehicle()),
            Self::Tree(m) => tree::model_parameter_domains(m.model()),
        }
    }

    /// Name and unit of every number of the state, `[n_state]`.
    pub fn state_quantities(&self) -> Vec<Quantity> {
        let several = self.roots().len() > 1;
        self.state_numbers(|owner, what| match owner {
            Owner::Body(body) if several => format!("{body}.{what}"),
            Owner::Body(_) => what.into(),
            Owner::Joint(joint) if [ANGLE, SHIFT].contains(&what) => joint.into(),
            Owner::Joint(name) | Owner::Rotor(name) => format!("{name}.{what}"),
        })
    }

    /// The state, then the actions, in words: `velocity_x of body 'arm'`.
    pub(crate) fn numbers_in_words(&self) -> Vec<Quantity> {
        let mut all = self.state_numbers(|owner, what| match owner {
            Owner::Body(name) => format!("{what} of body '{name}'"),
            Owner::Joint(name) => format!("{what} of joint '{name}'"),
            Owner::Rotor(name) => format!("{what} of rotor '{name}'"),
        });
        let rotors = self.rotors().into_iter().zip(self.rotor_places());
        let mut actions: Vec<_> =
            rotors.map(|(rotor, place)| (place.action, format!("action of rotor '{}'", rotor.name))).collect();
        if let Self::Tree(m) = self {
            let drives = m.model().bodies().iter().zip(&m.layout().drive);
            actions.extend(
                drives.filter_map(|(body, at)| Some(((*at)?, format!("command of joint '{}'", body.joint.name)))),
            );
        }
        actions.sort();
        all.extend(actions.into_iter().map(|(_, name)| Quantity::new(name, "-")));
        all
    }

    /// The numbers of the state, named by `name` after what has them and what they are.
    fn state_numbers(&self, name: impl Fn(Owner<'_>, &str) -> String) -> Vec<Quantity> {
        let mut all = vec![Quantity::new("", "-"); self.n_state()];
        let mut put = |at: usize, owner: Owner<'_>, what: &str, unit| all[at] = Quantity::new(name(owner, what), unit);
        let root = |first: usize| ROOT.iter().enumerate().map(move |(k, (what, unit))| (first + k, *what, *unit));
        match self {
            Self::Rigid(m) => root(0).for_each(|(at, what, unit)| put(at, Owner::Body(&m.vehicle().name), what, unit)),
            Self::Tree(m) => {
                for (body, place) in m.model().bodies().iter().zip(&m.layout().bodies) {
                    let owner = match body.joint.motion {
                        Motion::Floating => Owner::Body(&body.name),
                        _ => Owner::Joint(&body.joint.name),
                    };
                    let mut put = |at: usize, what: &str, unit| put(at, owner, what, unit);
                    match body.joint.motion {
                        Motion::Floating => root(place.position).for_each(|(at, what, unit)| put(at, what, unit)),
                        Motion::Ball => {
                            ["w", "x", "y", "z"].iter().enumerate().for_each(|(k, c)| {
                                put(place.position + k, &format!("attitude_{c}"), "-");
                            });
                            ["x", "y", "z"].iter().enumerate().for_each(|(k, c)| {
                                put(place.velocity + k, &format!("rate_{c}"), "rad/s");
                            });
                        }
                        Motion::Revolute(_) => {
                            put(place.position, ANGLE, "rad");
                            put(place.velocity, "rate", "rad/s");
                        }
                        Motion::Prismatic(_) => {
                            put(place.position, SHIFT, "m");
                            put(place.velocity, "rate", "m/s");
                        }
                    }
                }
            }
        }
        for (rotor, place) in self.rotors().into_iter().zip(self.rotor_places()) {
            put(place.speed, Owner::Rotor(&rotor.name), "speed", "rad/s");
        }
        all
    }

    /// Name and unit of every number of the input, `[n_input]`: actions and drive commands in [−1, 1], disturbances.
    pub fn input_quantities(&self) -> Vec<Quantity> {
        let mut all = vec![Quantity::new("", "-"); self.n_input()];
        for (rotor, place) in self.rotors().iter().zip(self.rotor_places()) {
            all[place.action].name = format!("{}.action", rotor.name);
        }
        if let Self::Tree(m) = self {
            for (body, at) in m.model().bodies().iter().zip(&m.layout().drive) {
                at.iter().for_each(|at| all[*at].name = format!("{}.command", body.joint.name));
            }
        }
        let several = self.disturbances().len() > 1;
        for (i, first) in self.disturbances().into_iter().enumerate() {
            let prefix = if several { format!("tree_{i}.") } else { String::new() };
            for (block, (what, unit)) in [("wind", "m/s"), ("force", "N"), ("moment", "N m")].into_iter().enumerate() {
                for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
                    all[first + 3 * block + k] = Quantity::new(format!("{prefix}{what}_{axis}"), unit);
                }
            }
        }
        all
    }

    /// Its rotors, in order.
    pub fn rotors(&self) -> Vec<&Rotor> {
        match self {
            Self::Rigid(m) => m.vehicle().rotors.iter().collect(),
            Self::Tree(m) => m.model().rotors().iter().map(|r| &r.rotor).collect(),
        }
    }

    /// Where the numbers of each rotor stand.
    pub fn rotor_places(&self) -> Vec<RotorPlace> {
        let place = |(i, rotor): (usize, &Rotor)| match self {
            Self::Rigid(_) => RotorPlace { speed: RIGID_DIM + i, action: i, max_speed: rotor.max_speed },
            Self::Tree(m) => RotorPlace {
                speed: m.layout().rotor_speed[i],
                action: m.layout().rotor_action[i],
                max_speed: rotor.max_speed,
            },
        };
        self.rotors().into_iter().enumerate().map(place).collect()
    }

    /// Moves rotors from a steady state by 10⁻⁷ of their speed, to where they answer with the longer of their lags: where a motor
    /// speeds up and slows down with different ones, rounding would else decide which of them a derivative there is of. No entry of A
    /// or B differs from that at the steady state by more than 3·10⁻⁷ of the largest of its row.
    #[doc(hidden)]
    pub fn take_longer_lags(&self, state: &mut [f64]) {
        for (place, rotor) in self.rotor_places().iter().zip(self.rotors()) {
            let slows = rotor.time_constant_down >= rotor.time_constant_up;
            state[place.speed] *= if slows { 1.0 + 1e-7 } else { 1.0 - 1e-7 };
        }
    }

    /// First of each tree's numbers in the state; a floating root's 13 begin there.
    pub fn roots(&self) -> Vec<usize> {
        match self {
            Self::Rigid(_) => vec![0],
            Self::Tree(m) => m.layout().trees.iter().map(|t| t.state.start).collect(),
        }
    }

    /// Where the nine numbers of each tree's [`Disturbance`](super::Disturbance) stand in the input: none where that
    /// effect is off.
    pub fn disturbances(&self) -> Vec<usize> {
        match self {
            Self::Rigid(m) if m.physics().effects.disturbance => vec![m.vehicle().n_rotor()],
            Self::Rigid(_) => Vec::new(),
            Self::Tree(m) => m.layout().trees.iter().filter_map(|t| t.disturbance).collect(),
        }
    }

    /// Number of frames: one per body.
    pub fn n_frame(&self) -> usize {
        match self {
            Self::Rigid(_) => 1,
            Self::Tree(m) => m.model().bodies().len(),
        }
    }

    /// Names of the bodies, in the order of their frames; a vehicle in closed form is one body with its own name.
    pub fn body_names(&self) -> Vec<String> {
        match self {
            Self::Rigid(m) => vec![m.vehicle().name.clone()],
            Self::Tree(m) => m.model().bodies().iter().map(|body| body.name.clone()).collect(),
        }
    }

    /// Motion of every body along world axes in a state with these physical parameters, row-major `[n_frame, 13]`: the numbers of a
    /// [`Frame`]. `parameters` is read of articulated plants alone, `[n_parameter]`.
    pub fn write_frames<S: Scalar>(&self, parameters: &[S], state: &[S], frames: &mut [S]) {
        match self {
            Self::Tree(m) => tree::frames::write(m.topology(), parameters, state, frames),
            Self::Rigid(_) => Frame::of_vehicle(state).write(frames),
        }
    }

    /// Every joint at rest at the origin (or where the model says), rotors at the speeds that carry the weight, `[n_state]`: of a vehicle,
    /// also one that is a body of a tree alone under usual gravity, attitude and thrusts of [`Vehicle::hover`]; of other trees level,
    /// with the same share of every rotor's largest thrust.
    ///
    /// # Errors
    /// [`Error::Value`] for a vehicle that cannot hover.
    pub fn hover_state(&self) -> Result<Vec<f64>> {
        let m = match self {
            Self::Rigid(m) => return m.hover_state([0.0; 3]),
            Self::Tree(m) => m,
        };
        let (model, layout) = (m.model(), m.layout());
        let mut state = m.rest_state();
        for tree in &layout.trees {
            let mass: f64 = model.bodies()[tree.bodies.clone()].iter().map(|b| b.mass).sum();
            let weight = mass * model.parts().gravity;
            let lift: f64 = model.rotors()[tree.rotors.clone()].iter().map(|r| r.rotor.max_thrust()).sum();
            let mut shares = vec![(weight / lift).clamp(0.0, 1.0); tree.rotors.len()];
            if let Some(vehicle) = lone_vehicle(model, tree) {
                let hover = vehicle.hover()?;
                if !hover.is_level() {
                    let root = tree.state.start;
                    let turned = multiply(array(&state[root + 6..]), hover.attitude);
                    state[root + 6..root + 10].copy_from_slice(&turned);
                }
                for (share, (thrust, rotor)) in shares.iter_mut().zip(hover.thrusts.iter().zip(&vehicle.rotors)) {
                    let own = thrust / rotor.max_thrust();
                    *share = if (own - *share).abs() <= BALANCED { *share } else { own };
                }
            }
            for (r, share) in tree.rotors.clone().zip(shares) {
                state[layout.rotor_speed[r]] = model.rotors()[r].rotor.max_speed * share.sqrt();
            }
        }
        Ok(state)
    }

    /// Checks the length of a state and that its numbers are finite.
    ///
    /// # Errors
    /// [`Error::Value`] that names both lengths, or the number that is not finite.
    pub fn check_state(&self, state: &[f64]) -> Result<()> {
        let n = self.n_state();
        if state.len() != n {
            let rule = format!("{n}, as Plant::state_quantities lists them");
            return Err(Error::value("start: length of the state", state.len(), rule, "Take Plant::hover_state."));
        }
        base::error::finite("start: state", state)
    }
}

impl System for Plant {
    fn n_state(&self) -> usize {
        match self {
            Self::Rigid(m) => m.n_state(),
            Self::Tree(m) => m.n_state(),
        }
    }
    fn n_input(&self) -> usize {
        match self {
            Self::Rigid(m) => m.n_input(),
            Self::Tree(m) => m.n_input(),
        }
    }
    fn n_parameter(&self) -> usize {
        match self {
            Self::Rigid(m) => m.n_parameter(),
            Self::Tree(m) => m.n_parameter(),
        }
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], next: &mut [S]) {
        match self {
            Self::Rigid(m) => m.step(state, input, parameters, next),
            Self::Tree(m) => m.step(state, input, parameters, next),
        }
    }
}

/// A drone that is a floating tree by itself, as a vehicle.
fn lone_vehicle(model: &Model, tree: &TreePlace) -> Option<Vehicle> {
    let root = tree.bodies.start;
    let floats = model.bodies()[root].joint.motion == Motion::Floating;
    let number = model.drones().iter().position(|drone| drone.body == root)?;
    let lone = tree.bodies.len() == 1 && model.drones()[number].rotors.len() == tree.rotors.len();
    let usual = model.parts().gravity == GRAVITY && !tree.rotors.is_empty();
    (floats && lone && usual).then(|| carrier(model, number).ok()).flatten()
}

fn array(x: &[f64]) -> [f64; 4] {
    [x[0], x[1], x[2], x[3]]
}

/// What has a number of the state.
#[derive(Clone, Copy)]
enum Owner<'a> {
    Body(&'a str),
    Joint(&'a str),
    Rotor(&'a str),
}

/// Coordinates of hinges and slides.
const ANGLE: &str = "angle";
const SHIFT: &str = "displacement";

/// The 13 numbers of a floating root, with units.
const ROOT: [(&str, &str); RIGID_DIM] = [
    ("position_x", "m"),
    ("position_y", "m"),
    ("position_z", "m"),
    ("velocity_x", "m/s"),
    ("velocity_y", "m/s"),
    ("velocity_z", "m/s"),
    ("attitude_w", "-"),
    ("attitude_x", "-"),
    ("attitude_y", "-"),
    ("attitude_z", "-"),
    ("angular_velocity_x", "rad/s"),
    ("angular_velocity_y", "rad/s"),
    ("angular_velocity_z", "rad/s"),
];

/// A rotor that keeps a share of its largest thrust.
fn weaken(rotor: &mut Rotor, effectiveness: f64) {
    if effectiveness < 1.0 {
        rotor.max_speed *= effectiveness.sqrt().max(STOPPED);
    }
}

/// The vehicle as it flies on: rotor i reaches √eᵢ of its largest speed, hence eᵢ of its largest thrust. A lost one
/// keeps 10⁻³ of its speed.
pub fn damaged(vehicle: &Vehicle, effectiveness: &[f64]) -> Vehicle {
    let mut vehicle = vehicle.clone();
    vehicle.rotors.iter_mut().zip(effectiveness).for_each(|(rotor, e)| weaken(rotor, *e));
    vehicle
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Effects, configurations, vehicles};

    #[test]
    fn every_number_of_every_plant_has_a_name_of_its_own() {
        let physics = Physics { effects: Effects { disturbance: true, ..Effects::default() }, ..Physics::default() };
        let vehicles = vehicles::all().into_iter().map(|v| Plant::of_vehicle(&v, physics).unwrap());
        let models = configurations::names()
            .into_iter()
            .map(|name| Plant::of_model(&configurations::by_name(name).unwrap(), physics).unwrap());
        for plant in vehicles.chain(models) {
            let names = |q: Vec<Quantity>| q.into_iter().map(|q| q.name).collect::<Vec<_>>();
            for (mut list, n) in [
                (names(plant.state_quantities()), plant.n_state()),
                (names(plant.input_quantities()), plant.n_input()),
                (plant.parameter_names(), plant.parameters().len()),
            ] {
                assert_eq!(list.len(), n, "{}", plant.name());
                assert!(list.iter().all(|name| !name.is_empty()), "{}: {list:?}", plant.name());
                list.sort();
                list.dedup();
                assert_eq!(list.len(), n, "{}", plant.name());
            }
        }
    }
}
