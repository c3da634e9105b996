//! What flies in a task, as data: from which a configuration makes the robot.

use crate::config::EnvConfig;
use crate::robot::{Robot, benchmark_motors};
use crate::suite::team::team_of;
use base::error::{Error, Result};
use dynamics::Effects;
use dynamics::tree::{Model, ModelParts};
use serde::{Deserialize, Serialize};

/// What flies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub enum RobotSource {
    /// One drone: the configuration's own vehicle or a built-in one, as the benchmark flies it.
    Vehicle {
        /// Its name.
        vehicle: String,
        /// Whether wind, forces and moments may act on it.
        #[serde(default)]
        disturbance: bool,
    },
    /// Drones that are free of each other but for their wakes.
    Team {
        /// What every drone is.
        vehicle: String,
        /// Drones.
        n_drone: usize,
        /// Whether wind, forces and moments may act on them.
        #[serde(default)]
        disturbance: bool,
    },
    /// What flies in a task of the registry.
    OfTask {
        /// Its name.
        task: String,
        /// Its settings.
        #[serde(default)]
        settings: toml::Table,
    },
    /// A model of one's own, with the benchmark's motors.
    Model {
        /// Bodies, joints, rotors, drones, shapes.
        model: Box<ModelParts>,
        /// What every drone is, if they are alike: control modes and controllers are built from it.
        vehicle: Option<String>,
        /// Per drone the joints that its further actions drive.
        #[serde(default)]
        drives: Vec<Vec<String>>,
        /// Whether bodies touch.
        #[serde(default)]
        contact: bool,
        /// Whether drones feel each other's wakes.
        #[serde(default)]
        downwash: bool,
        /// Whether wind, forces and moments may act on it.
        #[serde(default)]
        disturbance: bool,
    },
}

impl RobotSource {
    /// The robot.
    ///
    /// # Errors
    /// Those of vehicles, models and tasks.
    pub fn robot(&self, config: &EnvConfig) -> Result<Robot> {
        let with = |disturbance: bool, change: &dyn Fn(&mut Effects)| {
            config.physics_with(|e| {
                e.disturbance |= disturbance;
                change(e);
            })
        };
        match self {
            Self::Vehicle { vehicle, disturbance: false } => config.single_robot(vehicle),
            Self::Vehicle { vehicle, disturbance: true } => {
                Robot::of_vehicle(&config.vehicle(vehicle)?, with(true, &|_| ()))
            }
            Self::Team { vehicle, n_drone, disturbance } => {
                if !(1..=MOST_DRONES).contains(n_drone) {
                    let limit = format!("1 to {MOST_DRONES}");
                    return Err(Error::limit("drones of a team", n_drone, limit, "Fly fewer."));
                }
                team_of("team", with(*disturbance, &|e| e.downwash = true), &config.vehicle(vehicle)?, *n_drone)
            }
            Self::OfTask { task, settings } => {
                let own = EnvConfig { task: settings.clone(), ..config.clone() };
                let own = EnvConfig { task_record: String::new(), ..own };
                Ok(super::in_rust(task)?.task(&own)?.robot().clone())
            }
            Self::Model { model, vehicle, drives, contact, downwash, disturbance } => {
                let model = benchmark_motors(&Model::new((**model).clone())?)?;
                let vehicle = vehicle.as_ref().map(|name| config.vehicle(name)).transpose()?;
                let body = |joint: &String| model.joint(joint);
                let drives =
                    drives.iter().map(|own| own.iter().map(body).collect()).collect::<Result<Vec<Vec<_>>>>()?;
                let physics = with(*disturbance, &|e| (e.contact, e.downwash) = (*contact, *downwash));
                let of = |drone: usize| drives.get(drone).cloned().unwrap_or_default();
                Robot::of_model(&model, physics, vehicle.as_ref(), of)
            }
        }
    }
}

/// Most drones of a team.
const MOST_DRONES: usize = 32;
