//! An articulated system from whatever the user typed: a configuration, or a vehicle as one body.

use super::arguments::{VehicleArguments, is_path};
use super::source;
use crate::prelude::*;
use omnidrones::dynamics::assembly::single;
use omnidrones::dynamics::tree::Model;
use omnidrones::dynamics::{configurations, vehicles};

/// A model and its story.
pub struct Robot {
    /// What was named.
    pub model: Model,
    /// `configuration, built in`; `vehicle file x.toml, as one body`.
    pub origin: String,
    /// One line, empty for a file.
    pub description: String,
}

/// The configuration of that name, if there is one.
pub fn configuration(named: &str) -> Option<&'static configurations::Entry> {
    configurations::REGISTRY.iter().find(|entry| entry.name.eq_ignore_ascii_case(named))
}

/// Loads what `named` means.
pub fn load(named: &str, arguments: &VehicleArguments) -> Result<Robot> {
    if let Some(entry) = configuration(named) {
        if arguments.rotors.is_some() || !arguments.package.is_empty() {
            let (value, rule) = (format!("with configuration '{}'", entry.name), "used with a URDF");
            return Err(Error::value("--rotors or --package", value, rule, "Leave it out."));
        }
        return Ok(Robot {
            model: (entry.build)()?,
            origin: "configuration, built in".into(),
            description: entry.description.into(),
        });
    }
    known(named)?;
    let loaded = source::to_use(Some(named), arguments)?;
    let built_in = vehicles::REGISTRY.iter().find(|entry| entry.name == loaded.vehicle.name);
    Ok(Robot {
        model: single(&loaded.vehicle)?,
        origin: format!("vehicle as one body, {}", loaded.origin),
        description: built_in.map_or_else(String::new, |entry| entry.description.into()),
    })
}

/// Refuses a name that is neither a configuration, nor a vehicle, nor a file, and names the nearest of both.
pub fn known(named: &str) -> Result<()> {
    let vehicle = vehicles::names().iter().any(|name| name.eq_ignore_ascii_case(named));
    if vehicle || is_path(named) || configuration(named).is_some() {
        return Ok(());
    }
    let names = configurations::names().into_iter().chain(vehicles::names());
    Err(Error::Unknown {
        kind: "configuration or vehicle",
        name: named.into(),
        known: names.map(String::from).collect(),
    })
}
