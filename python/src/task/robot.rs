//! What flies in a task of one's own, from Python.

use crate::error::OrRaise;
use crate::settings;
use omnidrones::dynamics::configurations;
use omnidrones::error::Error;
use omnidrones::tasks::written::RobotSource;
use omnidrones::tasks::{self, EnvConfig, Inertial};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// What flies in a task: one drone by name, `Robot.team`, `Robot.of_task`, `Robot.of_configuration`.
///
/// Parameters
/// ----------
/// vehicle : str
///     A built-in vehicle, or that of the configuration (`vehicle=`), as the benchmark flies it.
/// disturbance : bool
///     Whether winds, forces and moments may act on it.
#[pyclass(module = "omnidrones", name = "Robot", frozen)]
#[derive(Clone)]
pub struct PyRobot {
    pub source: RobotSource,
    varied: Vec<Varied>,
}

/// Numbers that differ between environments.
#[derive(Clone)]
enum Varied {
    Named(String),
    Inertial(usize),
}

impl PyRobot {
    fn of(source: RobotSource) -> Self {
        Self { source, varied: Vec::new() }
    }

    /// Built for a configuration, and which of its numbers vary beside its own.
    pub fn robot(&self, config: &EnvConfig, disturbed: bool) -> Result<(tasks::Robot, RobotSource, Vec<usize>), Error> {
        let mut source = self.source.clone();
        if let RobotSource::Vehicle { disturbance, .. }
        | RobotSource::Team { disturbance, .. }
        | RobotSource::Model { disturbance, .. } = &mut source
        {
            *disturbance |= disturbed;
        }
        let robot = source.robot(config)?;
        let names = robot.parameter_names();
        let mut varied = Vec::new();
        for own in &self.varied {
            match own {
                Varied::Named(name) => match names.iter().position(|own| own == name) {
                    Some(k) => varied.push(k),
                    None => return Err(Error::Unknown { kind: "physical number", name: name.clone(), known: names }),
                },
                Varied::Inertial(body) if *body < robot.n_frame() => {
                    varied.extend(Inertial::place(*body)..Inertial::place(*body) + 10);
                }
                Varied::Inertial(body) => {
                    let limit = format!("0 to {}", robot.n_frame() - 1);
                    return Err(Error::limit("body", body, limit, "Bodies count from 0."));
                }
            }
        }
        varied.sort_unstable();
        varied.dedup();
        Ok((robot.varying(varied.iter().copied()), source, varied))
    }

    fn built(&self) -> PyResult<tasks::Robot> {
        self.robot(&EnvConfig::default(), false).map(|(robot, ..)| robot).or_raise()
    }
}

#[pymethods]
impl PyRobot {
    #[new]
    #[pyo3(signature = (vehicle, *, disturbance=false))]
    fn new(vehicle: String, disturbance: bool) -> Self {
        Self::of(RobotSource::Vehicle { vehicle, disturbance })
    }

    /// `n_drone` drones that are free of each other but for their wakes; agent i flies drone i.
    #[staticmethod]
    #[pyo3(signature = (vehicle, n_drone, *, disturbance=false))]
    fn team(vehicle: String, n_drone: usize, disturbance: bool) -> Self {
        Self::of(RobotSource::Team { vehicle, n_drone, disturbance })
    }

    /// What flies in a built-in task, with that task's settings: `Robot.of_task("PayloadTrack", length=[1.0, 1.0])`.
    #[staticmethod]
    #[pyo3(signature = (task, /, **settings))]
    fn of_task(task: String, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut table = toml::Table::new();
        for (key, given) in settings.into_iter().flatten() {
            let key: String = key.extract()?;
            if let Some(value) = settings::value(&key, &given)? {
                table.insert(key, value);
            }
        }
        Ok(Self::of(RobotSource::OfTask { task, settings: table }))
    }

    /// A built-in configuration by name. `vehicle` is what every drone is, if they are alike. `drives` names,
    /// per drone, the joints that its further actions drive. `contact`: whether bodies touch. `downwash`: whether drones feel each other.
    #[staticmethod]
    #[pyo3(signature = (configuration, *, vehicle=None, drives=Vec::new(), contact=false, downwash=false, disturbance=false))]
    fn of_configuration(
        configuration: &str,
        vehicle: Option<String>,
        drives: Vec<Vec<String>>,
        contact: bool,
        downwash: bool,
        disturbance: bool,
    ) -> PyResult<Self> {
        let model = Box::new(configurations::by_name(configuration).or_raise()?.parts().clone());
        Ok(Self::of(RobotSource::Model { model, vehicle, drives, contact, downwash, disturbance }))
    }

    /// The same robot with physical numbers that differ between environments, by name; `parameter_names` lists them.
    #[pyo3(signature = (*names))]
    fn varying(&self, names: Vec<String>) -> Self {
        let mut own = self.clone();
        own.varied.extend(names.into_iter().map(Varied::Named));
        own
    }

    /// The same robot with mass, centre of mass and inertia of a body that differ between environments.
    fn varying_inertial(&self, body: usize) -> Self {
        let mut own = self.clone();
        own.varied.push(Varied::Inertial(body));
        own
    }

    /// Names of the numbers of the state, with units.
    #[getter]
    fn state_names(&self) -> PyResult<Vec<String>> {
        let told = |q: &omnidrones::dynamics::Quantity| format!("{} [{}]", q.name, q.unit);
        Ok(self.built()?.plant().state_quantities().iter().map(told).collect())
    }

    /// Names of the physical numbers.
    #[getter]
    fn parameter_names(&self) -> PyResult<Vec<String>> {
        Ok(self.built()?.parameter_names())
    }

    /// Names of its bodies, in the order of `View.body`; that of a vehicle alone.
    #[getter]
    fn bodies(&self) -> PyResult<Vec<String>> {
        let robot = self.built()?;
        Ok(robot
            .model()
            .map_or_else(|| vec!["body".into()], |model| model.bodies().iter().map(|body| body.name.clone()).collect()))
    }

    /// Total mass, kg.
    #[getter]
    fn mass(&self) -> PyResult<f64> {
        let robot = self.built()?;
        Ok(robot.model().map_or_else(
            || robot.parameters()[Inertial::place(0)],
            |model| model.bodies().iter().map(|body| body.mass).sum(),
        ))
    }
}
