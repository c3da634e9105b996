//! The controllers of this crate as policies: what learners have to beat.
//!
//! Free drones are flown by a cascade each, all levels in every step; what is joined together by its
//! [`default_controller`]. All see the true state, the true masses of their episode (a free drone all its
//! numbers) and what the task [tracks](super::Task::reference), and act on the rotors.

use super::env::{Buffers, Env};
use super::robot::{Inertial, Robot};
use super::task::TaskReference;
use crate::controllers::cascade::{Cascade, Level, Rates};
use crate::controllers::controller::{Controller, Measurement, Target};
use crate::controllers::kinematics::Kinematics;
use crate::controllers::registry::{Setup, default_controller, swift};
use crate::dynamics::rigid::{RIGID_DIM, vehicle_of};
use crate::dynamics::tree::Model;
use crate::dynamics::{Plant, Rotor, Vehicle};
use crate::error::{Error, Result};

/// One controller per environment.
pub struct Baseline {
    /// From the first step of an episode on.
    seats: Vec<Option<Seat>>,
    failures: Vec<(usize, Error)>,
    name: String,
    dt: f64,
    n_action: usize,
    /// Of the environment it was made for: what flies is numbered so.
    config_hash: u64,
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
    Joined(Box<dyn Controller>),
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
        let name = match crew(env.robot(), &env.parameters(0)?, spec.dt)? {
            Crew::Free(_) => "cascade".into(),
            Crew::Joined(one) => one.name().into(),
            Crew::Nobody => "nobody".into(),
        };
        let seats = (0..spec.n_env).map(|_| None).collect();
        let n_action = spec.n_agent * spec.action.len();
        Ok(Self { seats, failures: Vec::new(), name, dt: spec.dt, n_action, config_hash: env.config_hash() })
    }

    /// What flies, in one word.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Actions of all agents of all environments for the state as it is. Who cannot fly the numbers of its episode keeps its
    /// rotors at rest speed: see [`Baseline::failures`].
    ///
    /// # Errors
    /// [`Error::Value`] for another environment than the one it was made for, or actions of the wrong length.
    pub fn act(&mut self, env: &Env, actions: &mut [f32]) -> Result<()> {
        if env.config_hash() != self.config_hash || env.spec().n_env != self.seats.len() {
            let (got, wanted) = (format!("{env:?}"), format!("one like that it was made for, of {}", self.seats.len()));
            return Err(Error::value("environment of a baseline", got, wanted, "Make a new one: Baseline::new(&env)."));
        }
        let wanted = self.seats.len() * self.n_action;
        if actions.len() != wanted {
            let remedy = "Rows are [environment, agent, action], row-major.";
            return Err(Error::value("length of actions", actions.len(), wanted.to_string(), remedy));
        }
        for i in 0..self.seats.len() {
            let state: Vec<f64> = env.state(i)?.iter().map(|x| f64::from(*x)).collect();
            if self.seats[i].is_none() {
                self.seats[i] = Some(self.seat(env, i)?);
            }
            let Some(seat) = &mut self.seats[i] else { continue };
            seat.fly(env.robot(), &state, self.dt);
            let mut own = actions[i * self.n_action..].iter_mut();
            for drone in env.robot().drones() {
                let places = drone.rotors.iter().map(|r| r.action).chain(drone.drives.iter().map(|d| d.command));
                places.zip(&mut own).for_each(|(place, a)| *a = seat.input[place].clamp(-1.0, 1.0) as f32);
            }
        }
        Ok(())
    }

    /// Makes a new controller for environment `environment` at the next [`Baseline::act`]: where an episode began.
    pub fn forget(&mut self, environment: usize) {
        if let Some(seat) = self.seats.get_mut(environment) {
            *seat = None;
        }
    }

    /// Environments whose numbers no controller could be made for, and why.
    pub fn failures(&self) -> &[(usize, Error)] {
        &self.failures
    }

    /// As a policy for [`evaluate`](super::evaluate()).
    pub fn policy(&mut self) -> impl FnMut(&Env, &Buffers, &mut [f32]) -> Result<()> + '_ {
        |env, _, actions| self.act(env, actions)
    }

    fn seat(&mut self, env: &Env, environment: usize) -> Result<Seat> {
        let robot = env.robot();
        let crew = crew(robot, &env.parameters(environment)?, self.dt).unwrap_or_else(|error| {
            self.failures.push((environment, error));
            Crew::Nobody
        });
        let reference = env.reference(environment)?.unwrap_or(TaskReference::point([0.0; 3], 0.0));
        Ok(Seat { crew, reference, input: robot.hover_input(), step: 0 })
    }
}

impl Seat {
    fn fly(&mut self, robot: &Robot, state: &[f64], dt: f64) {
        let time = self.step as f64 * dt;
        self.step += 1;
        let references = &self.reference.references;
        match &mut self.crew {
            Crew::Free(cascades) => {
                for (i, cascade) in cascades.iter_mut().enumerate() {
                    let own = Kinematics::read(&state[robot.roots()[i]..][..RIGID_DIM]);
                    let wanted = &references[i.min(references.len() - 1)];
                    let actions = cascade.position(&own, &wanted.sample(time));
                    robot.drones()[i].rotors.iter().zip(actions).for_each(|(r, a)| self.input[r.action] = a);
                }
            }
            Crew::Joined(one) => {
                let target = Target { reference: &references[0], tilt: &self.reference.tilt };
                one.tick(Measurement { time, state }, target, &mut self.input);
            }
            Crew::Nobody => {}
        }
    }
}

/// For a robot with these numbers.
fn crew(robot: &Robot, numbers: &[f64], dt: f64) -> Result<Crew> {
    match robot.plant() {
        Plant::Rigid(m) => {
            // who cannot hold its height sinks under any controller: the nominal one's does not refuse to try
            let own = cascade(&vehicle_of(m.vehicle(), numbers)?, dt);
            Ok(Crew::Free(vec![own.or_else(|_| cascade(m.vehicle(), dt))?]))
        }
        Plant::Tree(m) if m.layout().trees.len() > 1 => {
            let Some(vehicle) = &robot.vehicle else {
                return Err(Error::value("drones", "no plain vehicles", "vehicles, to fly freely", "Join them."));
            };
            let own = robot.drones().iter().map(|_| cascade(vehicle, dt));
            own.collect::<Result<Vec<_>>>().map(Crew::Free)
        }
        Plant::Tree(m) => {
            let known = Plant::of_model(&with_numbers(m.model(), numbers)?, *m.physics())?;
            let setup = Setup { gains: None, rates: &Rates::every_step(dt), swift: robot.vehicle.as_ref() };
            default_controller(&known, &setup).map(Crew::Joined)
        }
    }
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

/// The model with the masses that are in force.
fn with_numbers(model: &Model, numbers: &[f64]) -> Result<Model> {
    let mut parts = model.parts().clone();
    for (i, body) in parts.bodies.iter_mut().enumerate() {
        let own = Inertial::read(numbers, i);
        (body.mass, body.center_of_mass, body.inertia) = (own.mass, own.center_of_mass, own.inertia);
    }
    Model::new(parts)
}
