//! A model with the names of its parts as numbers.

use crate::tree::Model;
use base::error::{Error, Result};

/// Converts a coefficient per degree into one per radian.
#[doc(hidden)]
pub const PER_DEGREE: f64 = 180.0 / std::f64::consts::PI;

/// A model and the names of its parts as numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Configuration<M> {
    /// For [`Multibody`](crate::tree::Multibody).
    pub model: Model,
    /// Bodies, joints and rotors by name.
    pub map: M,
}

/// A vehicle within a model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DroneMap {
    /// Number of its body.
    pub body: usize,
    /// Numbers of its rotors in the model, in the vehicle's order.
    pub rotors: Vec<usize>,
}

impl DroneMap {
    /// The drone that the part `name` became.
    pub(super) fn find(model: &Model, name: &str) -> Result<Self> {
        let drone = model.drones().iter().find(|d| d.name == name).ok_or_else(|| Error::Unknown {
            kind: "drone",
            name: name.into(),
            known: model.drones().iter().map(|d| d.name.clone()).collect(),
        })?;
        Ok(Self { body: drone.body, rotors: drone.rotors.clone() })
    }
}

/// Numbers of the two hinges of a universal joint.
pub(super) fn pair(model: &Model, joint: &str, letters: [&str; 2]) -> Result<[usize; 2]> {
    let [a, b] = letters.map(|l| model.joint(&format!("{joint}.{l}")));
    Ok([a?, b?])
}
