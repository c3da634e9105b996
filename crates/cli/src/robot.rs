//! What flies, from whatever the user typed: a vehicle, a configuration, or a vehicle as one body.

use super::arguments::{FlightArguments, VehicleArguments, is_path};
use super::source::{self, Source};
use crate::prelude::*;
use clap::{Arg, Args};
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

/// What is named, and how it flies.
#[derive(Debug, Clone, Args)]
pub struct FlyerArguments {
    /// A built-in vehicle ('omnidrones models' lists them), or a file FILE.toml or FILE.urdf
    #[arg(value_name = "VEHICLE|FILE")]
    pub vehicle: String,
    #[command(flatten)]
    pub rotors: VehicleArguments,
    #[command(flatten)]
    pub flight: FlightArguments,
}

/// The option `vehicle` of a command that takes configurations too.
pub fn any_flyer(option: Arg) -> Arg {
    let what = "A vehicle ('omnidrones models'), a configuration ('omnidrones show'), or a file FILE.toml or FILE.urdf";
    option.value_name("VEHICLE|CONFIG|FILE").help(what)
}

impl FlyerArguments {
    /// The vehicle, with what is odd about it told.
    pub fn source(&self) -> Result<Source> {
        source::to_use(Some(&self.vehicle), &self.rotors)
    }

    /// The configuration of that name, if there is one; else a vehicle, or an error that names the nearest of both.
    pub fn flyer(&self) -> Result<Flyer> {
        if configuration(&self.vehicle).is_some() {
            return Ok(Flyer::Configuration(Box::new(load(&self.vehicle, &self.rotors)?.model)));
        }
        known(&self.vehicle)?;
        Ok(Flyer::Vehicle(Box::new(self.source()?)))
    }

    /// Refuses a reference for a command that flies none.
    pub fn refuse_reference(&self, command: &str, remedy: &str) -> Result<()> {
        let Some(given) = &self.flight.reference else { return Ok(()) };
        Err(Error::value("--reference", given, format!("none in '{command}'"), remedy))
    }
}

/// What [`FlyerArguments`] name.
pub enum Flyer {
    Vehicle(Box<Source>),
    Configuration(Box<Model>),
}

/// The configuration of that name, if there is one.
pub fn configuration(named: &str) -> Option<&'static configurations::ConfigurationEntry> {
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
