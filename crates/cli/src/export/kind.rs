//! What a name means that is to be exported.

use crate::arguments::is_path;
use crate::prelude::*;
use crate::robot;
use omnidrones::controllers::Reference;
use omnidrones::controllers::registry::REGISTRY;
use omnidrones::dynamics::{configurations, vehicles};
use omnidrones::tasks::registry;

/// What is exported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Model,
    Controller,
    Policy,
    Task,
    Reference,
}

impl Kind {
    /// Names, and what they are.
    pub const NAMES: [(&str, &str, Self); 5] = [
        ("model", "A vehicle or a configuration: one step of it", Self::Model),
        ("controller", "A controller of --vehicle: one tick of it", Self::Controller),
        ("policy", "What was learnt: the folder of a run", Self::Policy),
        ("task", "What a task observes, rewards and ends", Self::Task),
        ("reference", "Where to be at a time", Self::Reference),
    ];

    /// As on the command line.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(.., kind)| *kind == self).map_or("", |(name, ..)| name)
    }

    /// What a name is.
    pub fn of(what: &str) -> Result<Self> {
        let is_run = is_path(what) && Path::new(what).is_dir();
        let is_missing_run = is_path(what) && !Path::new(what).exists() && Path::new(what).extension().is_none();
        let is_file = is_path(what) && !is_run && !is_missing_run;
        let is_reference = is_file && is_reference(Path::new(what));
        let is_model =
            vehicles::names().contains(&what) || robot::configuration(what).is_some() || is_file && !is_reference;
        let found = [
            (Self::Model, is_model),
            (Self::Controller, REGISTRY.iter().any(|entry| entry.name == what)),
            // a path without a file's ending is a run that is not there: that is said where it is loaded
            (Self::Policy, is_run || is_missing_run),
            (Self::Task, registry::names().contains(&what)),
            (Self::Reference, Reference::NAMES.contains(&what) || is_reference),
        ];
        let found: Vec<Self> = found.into_iter().filter(|(_, is)| *is).map(|(kind, _)| kind).collect();
        match found[..] {
            [kind] => Ok(kind),
            [] => Err(Error::Unknown {
                kind: "model, controller, policy, task or reference",
                name: what.into(),
                known: known(),
            }),
            _ => {
                let all = found.iter().map(|kind| kind.name()).collect::<Vec<_>>().join(" and a ");
                let remedy = format!("Say which with --kind {}.", found[0].name());
                Err(Error::value(format!("'{what}'"), format!("the name of a {all}"), "one of them", remedy))
            }
        }
    }
}

/// Whether a file says which kind of reference it is.
fn is_reference(file: &Path) -> bool {
    let text = files::read_text(file, files::MAX_CONFIG_BYTES).unwrap_or_default();
    let table: toml::Table = text.parse().unwrap_or_default();
    table.get("kind").and_then(toml::Value::as_str).is_some_and(|kind| Reference::NAMES.contains(&kind))
}

/// All names.
fn known() -> Vec<String> {
    (vehicles::names().into_iter().chain(configurations::names()).chain(REGISTRY.iter().map(|entry| entry.name)))
        .chain(registry::names())
        .chain(Reference::NAMES)
        .map(String::from)
        .collect()
}
