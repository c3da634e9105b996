//! Who flies a robot: a cascade each where drones are free, the [`default_controller`] of what is joined together.

use super::robot::{Inertial, Robot};
use super::task::TaskReference;
use base::error::{Error, Result};
use controllers::cascade::{Cascade, Rates};
use controllers::controller::{Controller, Measurement, Target};
use controllers::kinematics::Kinematics;
use controllers::optimal::MpcSettings;
use controllers::registry::{REGISTRY, Setup, controller, default_controller, swift};
use controllers::{ControlLaw, LawController, WrittenLaw};
use dynamics::rigid::{RIGID_DIM, vehicle_of};
use dynamics::tree::Model;
use dynamics::{Inertia, Plant, Rotor, Vehicle};

/// A controller in place of the usual ones.
pub(crate) enum Asked {
    /// Of the registry.
    Named {
        name: String,
        /// How `mpc` plans; without, as suits what flies.
        mpc: Option<Box<MpcSettings>>,
    },
    /// One that is data, recorded for the plant that it is in every environment.
    Written(Box<WrittenLaw>),
}

impl Asked {
    fn name(&self) -> &str {
        match self {
            Self::Named { name, .. } => name,
            Self::Written(law) => law.name(),
        }
    }
}

/// Controllers of everything that flies in one environment, all levels in every step.
pub(crate) enum BaselineControllers {
    /// One per drone, each a tree of its own.
    Free(Vec<Cascade>),
    /// Of one tree.
    Joined(Box<dyn Controller>),
    /// Of numbers that no controller flies.
    Nobody,
}

impl BaselineControllers {
    /// For a robot with these numbers, in steps of `dt` seconds: the one that is asked for, or the usual ones.
    pub(crate) fn of(robot: &Robot, numbers: &[f64], dt: f64, asked: Option<&Asked>) -> Result<Self> {
        if let Some(asked) = asked {
            return Self::asked(robot, numbers, dt, asked);
        }
        match robot.plant() {
            Plant::Rigid(m) => {
                // who cannot hold its height sinks under any controller: the nominal one's does not refuse to try
                let own = cascade(&vehicle_of(m.vehicle(), numbers)?, dt);
                Ok(Self::Free(vec![own.or_else(|_| cascade(m.vehicle(), dt))?]))
            }
            Plant::Tree(m) if m.layout().trees.len() > 1 => {
                let Some(vehicle) = &robot.vehicle else {
                    return Err(Error::value("drones", "no plain vehicles", "vehicles, to fly freely", "Join them."));
                };
                let own = robot.drones().iter().map(|_| cascade(vehicle, dt));
                own.collect::<Result<Vec<_>>>().map(Self::Free)
            }
            Plant::Tree(m) => {
                let known = Plant::of_model(&with_numbers(m.model(), numbers)?, *m.physics())?;
                let rates = Rates::every_step(dt);
                let setup = Setup { swift: robot.vehicle.as_ref(), ..Setup::new(None, &rates) };
                default_controller(&known, &setup).map(Self::Joined)
            }
        }
    }

    fn asked(robot: &Robot, numbers: &[f64], dt: f64, asked: &Asked) -> Result<Self> {
        let (n_tree, name) = (robot.plant().roots().len(), asked.name());
        let is_known = matches!(asked, Asked::Written(_)) || REGISTRY.iter().any(|entry| entry.name == name);
        if n_tree > 1 && is_known {
            let (what, rule) = (format!("controller '{name}': trees of bodies"), "1: it leads one reference");
            return Err(Error::value(what, n_tree, rule, "Leave it out: a cascade flies each drone."));
        }
        let mpc = match asked {
            Asked::Named { mpc, .. } => mpc,
            Asked::Written(law) => {
                law.check_plant(robot.plant())?;
                return Ok(Self::Joined(Box::new(LawController::of(WrittenLaw::clone(law)))));
            }
        };
        let known = match robot.plant() {
            Plant::Rigid(m) => Plant::of_vehicle(&vehicle_of(m.vehicle(), numbers)?, *m.physics())?,
            Plant::Tree(m) => Plant::of_model(&with_numbers(m.model(), numbers)?, *m.physics())?,
        };
        let rates = Rates::every_step(dt);
        let setup = Setup { swift: robot.vehicle.as_ref(), mpc: mpc.as_deref(), ..Setup::new(None, &rates) };
        controller(name, &known, &setup).map(Self::Joined)
    }

    /// What flies, in one word.
    pub(crate) fn name(&self) -> &str {
        match self {
            Self::Free(_) => "cascade",
            Self::Joined(one) => one.name(),
            Self::Nobody => "nobody",
        }
    }

    /// Whether commands depend on earlier steps.
    pub(crate) fn remembers(&self) -> bool {
        matches!(self, Self::Joined(one) if one.remembers())
    }

    /// Commands into the input of the robot's plant for the state at `time` seconds since its reference began.
    pub(crate) fn fly(&mut self, robot: &Robot, wanted: &TaskReference, time: f64, state: &[f64], input: &mut [f64]) {
        let references = &wanted.references;
        match self {
            Self::Free(cascades) => {
                for (i, cascade) in cascades.iter_mut().enumerate() {
                    let own = Kinematics::read(&state[robot.roots()[i]..][..RIGID_DIM]);
                    let reference = &references[i.min(references.len() - 1)];
                    let actions = cascade.position(&own, &reference.sample(time));
                    robot.drones()[i].rotors.iter().zip(actions).for_each(|(r, a)| input[r.action] = a);
                }
            }
            Self::Joined(one) => {
                let target = Target { reference: &references[0], tilt: &wanted.tilt };
                one.tick(Measurement { time, state, readings: &[] }, target, input);
            }
            Self::Nobody => {}
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
        let [xx, yy, zz, xy, xz, yz] = own.inertia;
        (body.mass, body.center_of_mass) = (own.mass, own.center_of_mass);
        body.inertia = Inertia { xx, yy, zz, xy, xz, yz };
    }
    Model::new(parts)
}
