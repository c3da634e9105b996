//! The controllers of this crate as policies: what learners have to beat.
//!
//! A vehicle alone is flown by its cascade, all levels in every step; a model by the pilot that suits it
//! ([`suited`]). Both see the true state and the task's
//! [`wanted`](super::Task::wanted) reference, and act on the rotors.

use super::env::{Buffers, Env};
use super::rig::{Craft, Rig};
use crate::controllers::cascade::{Cascade, Level, Rates};
use crate::controllers::kinematics::Kinematics;
use crate::controllers::pilot::{Command, Pilot, suited};
use crate::controllers::reference::{Reference, Tilt};
use crate::dynamics::MAX_ROTORS;
use crate::error::{Error, Result};

/// One controller per environment.
pub struct Baseline {
    seats: Vec<Seat>,
    name: String,
    dt: f64,
    n_action: usize,
}

struct Seat {
    controller: Controller,
    reference: Reference,
    tilt: Tilt,
    input: Vec<f64>,
    step: u64,
}

enum Controller {
    Cascade(Box<Cascade>),
    Pilot(Box<dyn Pilot>),
}

impl Baseline {
    /// Controllers for every environment of a batch in rotor mode. They learn their references at the first call of
    /// [`Baseline::act`] after a reset: make a new one for new episodes.
    ///
    /// # Errors
    /// [`Error::Value`] if the environment is in another control mode or nothing is wanted that a reference can say;
    /// otherwise as the controllers.
    pub fn new(env: &Env) -> Result<Self> {
        let (spec, rig) = (env.spec(), env.rig());
        if spec.config.control != Level::Rotor {
            let remedy = "Leave `control` out.";
            return Err(Error::value("control", spec.config.control.name(), "'rotor' for a controller", remedy));
        }
        let blank = vec![0.0; env.goal_size()];
        if env.wanted(&blank).is_none() {
            let what = format!("task {}: reference", spec.task);
            return Err(Error::value(what, "none", "one that a controller can track", "Try --controller random."));
        }
        let seat = || {
            Ok(Seat {
                controller: controller(rig, spec.dt)?,
                reference: Reference::by_name("hover")?,
                tilt: Tilt::LEVEL,
                input: vec![0.0; rig.n_input()],
                step: 0,
            })
        };
        let seats = (0..spec.n_env).map(|_| seat()).collect::<Result<Vec<Seat>>>()?;
        let name = match &seats[0].controller {
            Controller::Cascade(_) => "cascade".into(),
            Controller::Pilot(p) => p.name().into(),
        };
        Ok(Self { seats, name, dt: spec.dt, n_action: spec.n_agent * spec.action.len() })
    }

    /// What flies, in one word.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Actions of all agents of all environments for the state as it is.
    ///
    /// # Errors
    /// None for the environment it was made for.
    pub fn act(&mut self, env: &Env, actions: &mut [f32]) -> Result<()> {
        for (i, seat) in self.seats.iter_mut().enumerate() {
            let state: Vec<f64> = env.state(i)?.iter().map(|x| f64::from(*x)).collect();
            if seat.step == 0
                && let Some((reference, tilt)) = env.wanted(&env.goal(i)?)
            {
                (seat.reference, seat.tilt) = (reference, tilt);
            }
            seat.fly(&state, self.dt);
            let mut own = actions[i * self.n_action..].iter_mut();
            for drone in env.rig().drones() {
                let places = drone.rotors.iter().map(|r| r.action).chain(drone.drives.iter().map(|d| d.command));
                places.zip(&mut own).for_each(|(place, a)| *a = seat.input[place].clamp(-1.0, 1.0) as f32);
            }
        }
        Ok(())
    }

    /// As a policy for [`evaluate`](super::evaluate()).
    pub fn policy(&mut self) -> impl FnMut(&Env, &Buffers, &mut [f32]) + '_ {
        |env, _, actions| {
            // the environment is the one it was made for
            let _ = self.act(env, actions);
        }
    }
}

impl Seat {
    fn fly(&mut self, state: &[f64], dt: f64) {
        let time = self.step as f64 * dt;
        self.step += 1;
        match &mut self.controller {
            Controller::Cascade(cascade) => {
                let rotors = cascade.position(&Kinematics::read(state), &self.reference.sample(time));
                let n = self.input.len().min(rotors.len());
                self.input[..n].copy_from_slice(&rotors[..n]);
            }
            Controller::Pilot(pilot) => {
                let moment = Command { time, state, reference: &self.reference, tilt: &self.tilt };
                pilot.command(moment, &mut self.input);
            }
        }
    }
}

fn controller(rig: &Rig, dt: f64) -> Result<Controller> {
    let rates = Rates::every_step(dt);
    Ok(match &rig.craft {
        Craft::Vehicle(m) => {
            let vehicle = m.vehicle();
            Controller::Cascade(Box::new(Cascade::<MAX_ROTORS>::new(vehicle, &vehicle.gains(), &rates, dt)?))
        }
        Craft::Model(m) => Controller::Pilot(suited(m, None, &rates)?),
    })
}
