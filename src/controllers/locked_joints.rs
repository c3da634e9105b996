//! An articulated system flown as the rigid vehicle that it is with its joints at rest.
//!
//! Servos hold the rest pose: position servos by themselves, rate servos by a proportional loop around them. All rotors
//! then serve one cascade, whose base frame stands at the centre of mass and keeps the root's axes.

use super::cascade::{Cascade, RateDivisors, Rates};
use super::controller::{Controller, Measurement, Target};
use super::kinematics::Kinematics;
use base::error::Result;
use dynamics::spatial::{add, mat_vec, rotate_back, scale, sub};
use dynamics::tree::{Multibody, body_poses, center_of_mass, momentum};
use dynamics::{Drag, Gains, Inertia, Part, Rotor, Vehicle};
use flight::Commanded;
use nalgebra::{Matrix3, Vector3};

/// How fast a rate servo is sent back to rest, 1/s: well below the inverse of its lag.
const RETURN_RATE: f64 = 10.0;

/// One cascade over all rotors of a model.
#[derive(Debug, Clone)]
pub struct LockedJoints {
    system: Multibody,
    cascade: Cascade,
    actions: Vec<usize>,
    /// Rate servos: place of the angle in the state, its rest, place of the command, rate at full command.
    held: Vec<(usize, f64, usize, f64)>,
}

impl LockedJoints {
    /// For a model with up to 16 rotors. Without `gains`, those derived from the rigid vehicle.
    ///
    /// # Errors
    /// [`Error`](base::error::Error) if the rigid vehicle is not valid or cannot be lifted, or for rates that do not
    /// divide 1/dt.
    pub fn new(system: &Multibody, gains: Option<&Gains>, rates: &Rates) -> Result<Self> {
        let vehicle = rigid(system);
        vehicle.validate()?;
        let gains = gains.copied().unwrap_or_else(|| vehicle.derived_gains());
        let (layout, rest) = (system.layout(), system.rest_state());
        let mut held = Vec::new();
        for (i, body) in system.model().bodies().iter().enumerate() {
            if let (Some(drive), Some(at)) = (&body.joint.drive, layout.drive[i])
                && drive.stiffness == 0.0
            {
                let angle = layout.bodies[i].position;
                held.push((angle, rest[angle], at, drive.range));
            }
        }
        let cascade = Cascade::new(&vehicle, &gains, rates, system.physics().dt)?;
        Ok(Self { system: system.clone(), cascade, actions: layout.rotor_action.clone(), held })
    }
}

impl Controller for LockedJoints {
    fn schedule(&self) -> Option<RateDivisors> {
        Some(self.cascade.schedule)
    }

    fn reset(&mut self) {
        self.cascade.reset();
    }

    fn name(&self) -> &str {
        "frozen"
    }

    fn why_no_law(&self) -> &'static str {
        "a cascade around the centre of mass of many bodies, which is computed anew in every shape"
    }

    fn description(&self) -> String {
        "servos hold the rest pose; one cascade over all rotors, at the centre of mass".into()
    }

    fn commanded(&self) -> Option<Commanded> {
        Some(self.cascade.model.axes.commanded(self.cascade.latched().commanded()))
    }

    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        let own = super::formation::root(&self.system, state);
        let velocity = scale(1.0 / self.system.model().mass(), momentum(&self.system, state).linear);
        Kinematics { position: center_of_mass(&self.system, state), velocity, ..own }
    }

    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, input: &mut [f64]) {
        let own = self.tracked(seen.state);
        let actions = self.cascade.position(&own, &target.sample(seen.time));
        for (at, action) in self.actions.iter().zip(actions) {
            input[*at] = action;
        }
        for (angle, rest, at, range) in &self.held {
            input[*at] = (RETURN_RATE * (rest - seen.state[*angle]) / range).clamp(-1.0, 1.0);
        }
    }
}

/// The rigid vehicle that a model is at rest: its base frame at the centre of mass with the root's axes.
pub fn rigid(system: &Multibody) -> Vehicle {
    let (model, rest) = (system.model(), system.rest_state());
    let poses = body_poses(system, &rest);
    let (root, center) = (super::formation::root(system, &rest).attitude, center_of_mass(system, &rest));
    let local = |v: [f64; 3]| rotate_back(root, v);
    let point =
        |body: usize, p: [f64; 3]| local(sub(add(poses[body].position, mat_vec(poses[body].rotation, p)), center));
    let mut drag = Drag::default();
    let mut parts = Vec::new();
    for (i, body) in model.bodies().iter().enumerate().filter(|(_, b)| b.mass > 0.0) {
        let columns = [0, 1, 2].map(|k| Vector3::from(local([0, 1, 2].map(|row| poses[i].rotation[row][k]))));
        let turn = Matrix3::from_columns(&columns);
        let inertia = Inertia::from_matrix(&(turn * body.inertia.matrix() * turn.transpose()));
        parts.push(Part::new(&body.name, body.mass, point(i, body.center_of_mass), inertia));
        for k in 0..3 {
            drag.linear[k] += body.drag.linear[k];
        }
    }
    let rotor = |r: &dynamics::tree::MountedRotor| Rotor {
        position: point(r.body, r.rotor.position),
        axis: local(mat_vec(poses[r.body].rotation, r.rotor.axis)),
        ..r.rotor.clone()
    };
    Vehicle {
        name: model.name().into(),
        source: "the model at rest".into(),
        parts,
        rotors: model.rotors().iter().map(rotor).collect(),
        drag,
        shapes: Vec::new(),
        published_gains: None,
    }
}
