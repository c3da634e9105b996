//! A drone of a model as the vehicle that it is alone.

use super::model::Model;
use crate::{Inertia, Part, Vehicle};
use base::error::{Error, Result};

/// The body of a drone with its rotors as a vehicle of its own: what its cascade believes to fly.
///
/// # Errors
/// [`Error::Value`] where the drone has rotors on other bodies.
#[doc(hidden)]
pub fn carrier(model: &Model, number: usize) -> Result<Vehicle> {
    let drone = &model.drones()[number];
    let body = &model.bodies()[drone.body];
    let away = drone.rotors.iter().find(|r| model.rotors()[**r].body != drone.body);
    if let Some(rotor) = away {
        return Err(Error::value(
            format!("drone '{}': rotor '{}'", drone.name, model.rotors()[*rotor].rotor.name),
            "on another body",
            "on the drone's own body",
            "Steer it as one rigid vehicle: controllers::LockedJoints.",
        ));
    }
    let inertia = Inertia { ..body.inertia };
    Ok(Vehicle {
        name: drone.name.clone(),
        source: format!("model '{}'", model.name()),
        parts: vec![Part::new(&body.name, body.mass, body.center_of_mass, inertia)],
        rotors: drone.rotors.iter().map(|r| model.rotors()[*r].rotor.clone()).collect(),
        drag: body.drag,
        shapes: Vec::new(),
        published_gains: None,
    })
}
