//! Every built-in task: one line each.

use super::config::EnvConfig;
use super::env::Env;
use super::suite::*;
use crate::error::{Error, Result};

/// One line of the registry.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    /// What users type.
    pub name: &'static str,
    /// One line for tables.
    pub description: &'static str,
    /// Its own defaults, as TOML of an [`EnvConfig`].
    pub defaults: &'static str,
    /// Documentation and code.
    pub source: &'static str,
    make: fn(&str, &EnvConfig) -> Result<Env>,
}

const fn entry(
    name: &'static str,
    description: &'static str,
    source: &'static str,
    make: fn(&str, &EnvConfig) -> Result<Env>,
) -> Entry {
    Entry { name, description, defaults: "", source, make }
}

/// Groups of tasks by how their names begin or end; the first that fits counts.
const FAMILIES: [(&str, &str, &str); 8] = [
    ("", "Rand", "another drone in every episode"),
    ("InvPendulum", "", "a ball that stands on a bar"),
    ("Payload", "", "a slung ball"),
    ("Over", "", "an over-actuated platform"),
    ("Transport", "", "a box carried by a team"),
    ("Formation", "", "a team of single drones"),
    ("Omav", "", "thrusters that tilt"),
    ("Dragon", "", "thrusters that tilt"),
];

impl Entry {
    /// What the task is about, for tables in groups: the entries of a family follow each other.
    pub fn family(&self) -> &'static str {
        let fits = |(head, tail, _): &&(&str, &str, &str)| self.name.starts_with(head) && self.name.ends_with(tail);
        FAMILIES.iter().find(fits).map_or("one drone", |(_, _, family)| family)
    }

    /// The same task with defaults of its own.
    const fn with_defaults(self, defaults: &'static str) -> Self {
        Self { defaults, ..self }
    }
}

/// Every built-in task.
pub static REGISTRY: &[Entry] = &[
    entry("Hover", "fly to a point and hold it, with a heading", include_str!("suite/hover.rs"), |name, config| {
        Env::of(hover::Hover::new(config)?, name, config)
    }),
    entry("Track", "follow a lemniscate", include_str!("suite/track.rs"), |name, config| {
        Env::of(track::Track::new(config)?, name, config)
    }),
    entry(
        "FlyThrough",
        "fly through a gate that slides sideways",
        include_str!("suite/fly_through.rs"),
        |name, config| Env::of(fly_through::FlyThrough::new(config)?, name, config),
    ),
    entry(
        "InvPendulumHover",
        "balance a ball on a bar at a point",
        include_str!("suite/pendulum_hover.rs"),
        |name, config| Env::of(pendulum_hover::InvPendulumHover::new(config)?, name, config),
    ),
    entry(
        "InvPendulumTrack",
        "lead a ball that stands on a bar along a lemniscate",
        include_str!("suite/pendulum_track.rs"),
        |name, config| Env::of(pendulum_track::InvPendulumTrack::new(config)?, name, config),
    ),
    entry(
        "InvPendulumFlyThrough",
        "carry a ball that stands on a bar past two level bars",
        include_str!("suite/pendulum_fly_through.rs"),
        |name, config| Env::of(pendulum_fly_through::InvPendulumFlyThrough::new(config)?, name, config),
    ),
    entry(
        "PayloadHover",
        "hold a slung ball at a point while it is pushed",
        include_str!("suite/payload_hover.rs"),
        |name, config| Env::of(payload_hover::PayloadHover::new(config)?, name, config),
    ),
    entry(
        "PayloadTrack",
        "lead a slung ball along a lemniscate",
        include_str!("suite/payload_track.rs"),
        |name, config| Env::of(payload_track::PayloadTrack::new(config)?, name, config),
    ),
    entry(
        "PayloadFlyThrough",
        "swing a slung ball past two level bars",
        include_str!("suite/payload_fly_through.rs"),
        |name, config| Env::of(payload_fly_through::PayloadFlyThrough::new(config)?, name, config),
    ),
    entry(
        "HoverRand",
        "hover with another drone in every episode",
        include_str!("suite/variants.rs"),
        |name, config| Env::of(hover::Hover::new(config)?, name, config),
    )
    .with_defaults(variants::HOVER_RAND),
    entry(
        "TrackRand",
        "follow a lemniscate with another drone in every episode",
        include_str!("suite/variants.rs"),
        |name, config| Env::of(track::Track::new(config)?, name, config),
    )
    .with_defaults(variants::TRACK_RAND),
    entry("OmavHover", "hover with an Omav whose rotors tilt", include_str!("suite/variants.rs"), |name, config| {
        Env::of(hover::Hover::new(config)?, name, config)
    })
    .with_defaults(variants::OMAV),
    entry(
        "OmavTrack",
        "follow a lemniscate with an Omav whose rotors tilt",
        include_str!("suite/variants.rs"),
        |name, config| Env::of(track::Track::new(config)?, name, config),
    )
    .with_defaults(variants::OMAV),
    entry(
        "DragonHover",
        "fly a chain of four links to a point",
        include_str!("suite/dragon_hover.rs"),
        |name, config| Env::of(dragon_hover::DragonHover::new(config)?, name, config),
    ),
    entry(
        "OverHover",
        "bring an over-actuated platform to a pose and hold it",
        include_str!("suite/over_hover.rs"),
        |name, config| Env::of(over_hover::OverHover::new(config)?, name, config),
    ),
    entry(
        "OverTrack",
        "carry an over-actuated platform along a lemniscate",
        include_str!("suite/over_track.rs"),
        |name, config| Env::of(over_track::OverTrack::new(config)?, name, config),
    ),
    entry(
        "OverFlyThrough",
        "bring an over-actuated platform through a row of poles",
        include_str!("suite/over_fly_through.rs"),
        |name, config| Env::of(over_fly_through::OverFlyThrough::new(config)?, name, config),
    ),
    entry(
        "TransportHover",
        "bring a box on bars to a point and hold it",
        include_str!("suite/transport_hover.rs"),
        |name, config| Env::of(transport_hover::TransportHover::new(config)?, name, config),
    ),
    entry(
        "TransportTrack",
        "carry a box on bars along a lemniscate",
        include_str!("suite/transport_track.rs"),
        |name, config| Env::of(transport_track::TransportTrack::new(config)?, name, config),
    ),
    entry(
        "TransportFlyThrough",
        "take a box on bars between two beams",
        include_str!("suite/transport_fly_through.rs"),
        |name, config| Env::of(transport_fly_through::TransportFlyThrough::new(config)?, name, config),
    ),
    entry("Formation", "form a figure in each other's downwash", include_str!("suite/formation.rs"), |name, config| {
        Env::of(formation::Formation::new(config)?, name, config)
    }),
];

impl Entry {
    /// The environment of a configuration. What differs in it from [`EnvConfig::default`] wins over the task's own
    /// defaults, each setting of `task` by itself; a list of observation stages or of changes replaces the task's list.
    ///
    /// # Errors
    /// As [`Env::of`].
    pub fn env(&self, config: &EnvConfig) -> Result<Env> {
        (self.make)(self.name, &self.merged(config)?)
    }

    /// The configuration over the task's own defaults.
    fn merged(&self, config: &EnvConfig) -> Result<EnvConfig> {
        let EnvConfig {
            n_env,
            seed,
            first_environment,
            control,
            action_scale,
            actions,
            delay,
            dt,
            control_rate,
            substeps,
            integrator,
            observation,
            randomise,
            difficulty,
            autoreset,
            stagger,
            memory_limit,
            task,
        } = self.default_config()?;
        let (mut own, usual) = (config.clone(), EnvConfig::default());
        macro_rules! take {
            ($($key:ident)*) => {
                $(if own.$key == usual.$key {
                    own.$key = $key;
                })*
            };
        }
        take!(n_env seed first_environment control action_scale actions delay dt control_rate substeps integrator);
        take!(observation randomise difficulty autoreset stagger memory_limit);
        for (key, value) in task {
            own.task.entry(key).or_insert(value);
        }
        Ok(own)
    }

    /// The task's own defaults.
    ///
    /// # Errors
    /// None for the registry as it is: a test reads them all.
    pub fn default_config(&self) -> Result<EnvConfig> {
        EnvConfig::from_toml(self.defaults, self.name)
    }
}

/// The names that [`by_name`] knows.
pub fn names() -> Vec<&'static str> {
    REGISTRY.iter().map(|entry| entry.name).collect()
}

/// The built-in task of that name (case does not matter).
///
/// # Errors
/// [`Error::Unknown`] with the nearest.
pub fn by_name(name: &str) -> Result<&'static Entry> {
    REGISTRY.iter().find(|entry| entry.name.eq_ignore_ascii_case(name)).ok_or_else(|| Error::Unknown {
        kind: "task",
        name: name.to_string(),
        known: names().into_iter().map(String::from).collect(),
    })
}
