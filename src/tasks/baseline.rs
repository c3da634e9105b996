//! The controllers of this crate as policies: what learners have to beat.
//!
//! Free drones are flown by a cascade each, all levels in every step; what is joined together by the pilot that suits it
//! ([`suited`]). All see the true state, the true masses of their episode (a free drone all its
//! numbers) and what the task [tracks](super::Task::reference), and act on the rotors.

use super::env::{Buffers, Env};
use super::rig::{Craft, Inertial, Rig};
use super::task::TaskReference;
use crate::controllers::cascade::{Cascade, Level, Rates};
use crate::controllers::kinematics::Kinematics;
use crate::controllers::pilot::{Command, Pilot, suited};
use crate::controllers::platform::{self, Platform, is_platform};
use crate::controllers::state_feedback::{Lqr, Weights, carries};
use crate::controllers::transport::{Leans, Transport, is_transport};
use crate::dynamics::gains;
use crate::dynamics::rigid::{RIGID_DIM, vehicle_of};
use crate::dynamics::tree::{Model, Multibody};
use crate::dynamics::{Gains, Rotor, Vehicle};
use crate::error::{Error, Result};

/// One controller per environment.
pub struct Baseline {
    /// From the first step of an episode on.
    seats: Vec<Option<Seat>>,
    failures: Vec<(usize, Error)>,
    name: String,
    dt: f64,
    n_action: usize,
}

struct Seat {
    crew: Crew,
    reference: TaskReference,
    input: Vec<f64>,
    step: u64,
}

enum Crew {
    /// One per drone, each a tree of its own.
    Free(Vec<Cascade>),
    /// Of one tree.
    Joined(Box<dyn Pilot>),
    /// Of numbers that no controller flies.
    Nobody,
}

impl Baseline {
    /// Controllers for every environment of a batch in rotor mode. They learn masses and references at the first call of
    /// [`Baseline::act`] after a reset: make a new one for new episodes.
    ///
    /// # Errors
    /// [`Error::Value`] if the environment is in another control mode or no reference says what the task tracks;
    /// otherwise as the controllers.
    pub fn new(env: &Env) -> Result<Self> {
        let spec = env.spec();
        if spec.config.control != Level::Rotor {
            let remedy = "Leave `control` out.";
            return Err(Error::value("control", spec.config.control.name(), "'rotor' for a controller", remedy));
        }
        if env.reference(0)?.is_none() {
            let what = format!("task {}: reference", spec.task);
            return Err(Error::value(what, "none", "one that a controller can track", "Try --controller random."));
        }
        let name = match crew(env.rig(), &env.numbers(0)?, spec.dt)? {
            Crew::Free(_) => "cascade".into(),
            Crew::Joined(pilot) => pilot.name().into(),
            Crew::Nobody => "nobody".into(),
        };
        let seats = (0..spec.n_env).map(|_| None).collect();
        Ok(Self { seats, failures: Vec::new(), name, dt: spec.dt, n_action: spec.n_agent * spec.action.len() })
    }

    /// What flies, in one word.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Actions of all agents of all environments for the state as it is. Who cannot fly the numbers of its episode keeps its
    /// rotors at rest speed: see [`Baseline::failures`].
    ///
    /// # Errors
    /// None for the environment it was made for.
    pub fn act(&mut self, env: &Env, actions: &mut [f32]) -> Result<()> {
        for i in 0..self.seats.len() {
            let state: Vec<f64> = env.state(i)?.iter().map(|x| f64::from(*x)).collect();
            if self.seats[i].is_none() {
                self.seats[i] = Some(self.seat(env, i)?);
            }
            let Some(seat) = &mut self.seats[i] else { continue };
            seat.fly(env.rig(), &state, self.dt);
            let mut own = actions[i * self.n_action..].iter_mut();
            for drone in env.rig().drones() {
                let places = drone.rotors.iter().map(|r| r.action).chain(drone.drives.iter().map(|d| d.command));
                places.zip(&mut own).for_each(|(place, a)| *a = seat.input[place].clamp(-1.0, 1.0) as f32);
            }
        }
        Ok(())
    }

    /// Environments whose numbers no controller could be made for, and why.
    pub fn failures(&self) -> &[(usize, Error)] {
        &self.failures
    }

    /// As a policy for [`evaluate`](super::evaluate()).
    pub fn policy(&mut self) -> impl FnMut(&Env, &Buffers, &mut [f32]) + '_ {
        |env, _, actions| {
            // only another environment makes an error, which the step that follows then tells
            let _ = self.act(env, actions);
        }
    }

    fn seat(&mut self, env: &Env, environment: usize) -> Result<Seat> {
        let rig = env.rig();
        let crew = crew(rig, &env.numbers(environment)?, self.dt).unwrap_or_else(|error| {
            self.failures.push((environment, error));
            Crew::Nobody
        });
        let reference = env.reference(environment)?.unwrap_or(TaskReference::point([0.0; 3], 0.0));
        Ok(Seat { crew, reference, input: rig.hover_input(), step: 0 })
    }
}

impl Seat {
    fn fly(&mut self, rig: &Rig, state: &[f64], dt: f64) {
        let time = self.step as f64 * dt;
        self.step += 1;
        let references = &self.reference.references;
        match &mut self.crew {
            Crew::Free(cascades) => {
                for (i, cascade) in cascades.iter_mut().enumerate() {
                    let own = Kinematics::read(&state[rig.roots()[i]..][..RIGID_DIM]);
                    let wanted = &references[i.min(references.len() - 1)];
                    let actions = cascade.position(&own, &wanted.sample(time));
                    rig.drones()[i].rotors.iter().zip(actions).for_each(|(r, a)| self.input[r.action] = a);
                }
            }
            Crew::Joined(pilot) => {
                let moment = Command { time, state, reference: &references[0], tilt: &self.reference.tilt };
                pilot.command(moment, &mut self.input);
            }
            Crew::Nobody => {}
        }
    }
}

/// For a rig with these numbers.
fn crew(rig: &Rig, numbers: &[f64], dt: f64) -> Result<Crew> {
    let rates = Rates::every_step(dt);
    match &rig.craft {
        Craft::Vehicle(m) => Ok(Crew::Free(vec![cascade(&vehicle_of(m.vehicle(), numbers)?, dt)?])),
        Craft::Model(m) if m.layout().trees.len() > 1 => {
            let Some(vehicle) = &rig.vehicle else {
                return Err(Error::value("drones", "no plain vehicles", "vehicles, to fly freely", "Join them."));
            };
            let own = rig.drones().iter().map(|_| cascade(vehicle, dt));
            own.collect::<Result<Vec<_>>>().map(Crew::Free)
        }
        Craft::Model(m) => {
            let known = Multibody::new(&with_numbers(m.model(), numbers)?, *m.physics())?;
            pilot(&known, rig.vehicle.as_ref(), &rates).map(Crew::Joined)
        }
    }
}

/// The pilot that suits a model, with swift drones where its loops are placed by theirs.
fn pilot(system: &Multibody, vehicle: Option<&Vehicle>, rates: &Rates) -> Result<Box<dyn Pilot>> {
    let model = system.model();
    Ok(match vehicle {
        Some(vehicle) if carries(model) => {
            let standing = model.bodies().iter().skip(1).any(|b| b.center_of_mass[2] > 0.0);
            let weights = if standing { STANDING } else { Weights::default() };
            Box::new(Lqr::with_weights(system, Some(&swift(vehicle, 2.0)), rates, &weights)?)
        }
        Some(vehicle) if is_platform(model) => {
            let mut gains = swift(vehicle, 2.3);
            let pole = gains.position[0].sqrt() * gains::SEPARATION / SEPARATION_OF_FRAMES;
            (gains.position, gains.velocity) = ([pole * pole; 3], [2.0 * pole; 3]);
            Box::new(Platform::new(system, Some(&gains), rates)?)
        }
        Some(_) if is_transport(model) => Box::new(Transport::with_leans(system, None, rates, Leans::STEEP)?),
        _ => suited(system, None, rates)?,
    })
}

/// All levels in every step; gains as if all motors had the mean lag.
fn cascade(vehicle: &Vehicle, dt: f64) -> Result<Cascade> {
    let mut even = vehicle.clone();
    let mean = |of: fn(&Rotor) -> f64| vehicle.rotors.iter().map(of).sum::<f64>() / vehicle.n_rotor() as f64;
    let [up, down] = [mean(|r| r.time_constant_up), mean(|r| r.time_constant_down)];
    even.rotors.iter_mut().for_each(|r| (r.time_constant_up, r.time_constant_down) = (up, down));
    let mut gains = swift(&even, 2.0);
    gains.velocity = gains.velocity.map(|k| 1.2 * k);
    Cascade::new(vehicle, &gains, &Rates::every_step(dt), dt)
}

/// [`Vehicle::derived_gains`] with all poles `factor` times as fast.
fn swift(vehicle: &Vehicle, factor: f64) -> Gains {
    let derived = vehicle.derived_gains();
    let [once, twice] = [factor, factor * factor];
    Gains {
        position: derived.position.map(|k| k * twice),
        velocity: derived.velocity.map(|k| k * once),
        attitude: derived.attitude.map(|k| k * twice),
        rate: derived.rate.map(|k| k * once),
    }
}

/// A load that stands is led gently: it has to lean before it can follow.
const STANDING: Weights = Weights { position: 0.7, swing: 4.0, acceleration: 4.0, preview: Some(0.0), reach: 0.4 };
/// A little more than the platform asks for.
const SEPARATION_OF_FRAMES: f64 = 1.01 * platform::SEPARATION;

/// The model with the masses that are in force.
fn with_numbers(model: &Model, numbers: &[f64]) -> Result<Model> {
    let mut parts = model.parts().clone();
    for (i, body) in parts.bodies.iter_mut().enumerate() {
        let own = Inertial::read(numbers, i);
        (body.mass, body.center_of_mass, body.inertia) = (own.mass, own.center_of_mass, own.inertia);
    }
    Model::new(parts)
}
