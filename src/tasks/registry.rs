//! Every built-in task: one line each; and tasks of one's own, made known by [`register`].

pub use super::task::BuiltIn;

use super::config::EnvConfig;
use super::env::Env;
use super::suite::dragon_hover::DragonHover;
use super::suite::fly_through::FlyThrough;
use super::suite::forest::Forest;
use super::suite::formation::Formation;
use super::suite::gate_switch::GateSwitch;
use super::suite::hover::Hover;
use super::suite::over_fly_through::OverFlyThrough;
use super::suite::over_hover::OverHover;
use super::suite::over_track::OverTrack;
use super::suite::payload_fly_through::PayloadFlyThrough;
use super::suite::payload_hover::PayloadHover;
use super::suite::payload_track::PayloadTrack;
use super::suite::pendulum_fly_through::InvPendulumFlyThrough;
use super::suite::pendulum_hover::InvPendulumHover;
use super::suite::pendulum_track::InvPendulumTrack;
use super::suite::pinball::Pinball;
use super::suite::race::Race;
use super::suite::spread::Spread;
use super::suite::track::Track;
use super::suite::transport_fly_through::TransportFlyThrough;
use super::suite::transport_hover::TransportHover;
use super::suite::transport_track::TransportTrack;
use super::suite::variants;
use base::error::{Error, Result};
use base::layers::{self, Layer};
use std::sync::{PoisonError, RwLock};

/// One line of the registry.
#[derive(Debug, Clone, Copy)]
pub struct TaskEntry {
    /// What users type.
    pub name: &'static str,
    /// What the task is about, for tables in groups: the entries of a family follow each other.
    pub family: &'static str,
    /// One line for tables.
    pub description: &'static str,
    /// Its own defaults, as TOML of an [`EnvConfig`].
    pub defaults: &'static str,
    /// What a variant has of its own, in words; empty otherwise.
    pub own: &'static str,
    make: fn(&str, &EnvConfig) -> Result<Env>,
}

const fn entry<T: BuiltIn>(name: &'static str, family: &'static str, description: &'static str) -> TaskEntry {
    TaskEntry { name, family, description, defaults: "", own: "", make: make::<T> }
}

fn make<T: BuiltIn>(name: &str, config: &EnvConfig) -> Result<Env> {
    Env::of(T::new(config)?, name, config)
}

impl TaskEntry {
    /// The same task with defaults of its own, which `own` says in words.
    const fn variant(self, (defaults, own): (&'static str, &'static str)) -> Self {
        Self { defaults, own, ..self }
    }
}

const ONE: &str = "one drone";
const RANDOM: &str = "another drone in every episode";
const PENDULUM: &str = "a ball that stands on a bar";
const PAYLOAD: &str = "a slung ball";
const OVER: &str = "an over-actuated platform";
const TRANSPORT: &str = "a box carried by a team";
const AROUND: &str = "a way past what sensors see";
const GATES: &str = "gates in order";
const BALL: &str = "a ball in the air";
const TEAM: &str = "a team of single drones";
const TILTING: &str = "thrusters that tilt";

/// Every built-in task.
#[rustfmt::skip]
pub static REGISTRY: &[TaskEntry] = &[
    entry::<Hover>("Hover", ONE, "fly to a point and hold it, with a heading"),
    entry::<Track>("Track", ONE, "follow a lemniscate"),
    entry::<FlyThrough>("FlyThrough", ONE, "fly through a gate that slides sideways"),
    entry::<InvPendulumHover>("InvPendulumHover", PENDULUM, "balance a ball on a bar at a point"),
    entry::<InvPendulumTrack>("InvPendulumTrack", PENDULUM, "lead a ball that stands on a bar along a lemniscate"),
    entry::<InvPendulumFlyThrough>("InvPendulumFlyThrough", PENDULUM, "carry a ball that stands on a bar past two level bars"),
    entry::<PayloadHover>("PayloadHover", PAYLOAD, "hold a slung ball at a point while it is pushed"),
    entry::<PayloadTrack>("PayloadTrack", PAYLOAD, "lead a slung ball along a lemniscate"),
    entry::<PayloadFlyThrough>("PayloadFlyThrough", PAYLOAD, "swing a slung ball past two level bars"),
    entry::<Hover>("HoverRand", RANDOM, "hover with another drone in every episode").variant(variants::HOVER_RAND),
    entry::<Track>("TrackRand", RANDOM, "follow a lemniscate with another drone in every episode").variant(variants::TRACK_RAND),
    entry::<Hover>("OmavHover", TILTING, "hover with an Omav whose rotors tilt").variant(variants::OMAV_HOVER),
    entry::<Track>("OmavTrack", TILTING, "follow a lemniscate with an Omav whose rotors tilt").variant(variants::OMAV_TRACK),
    entry::<DragonHover>("DragonHover", TILTING, "fly a chain of four links to a point"),
    entry::<OverHover>("OverHover", OVER, "bring an over-actuated platform to a pose and hold it"),
    entry::<OverTrack>("OverTrack", OVER, "carry an over-actuated platform along a lemniscate"),
    entry::<OverFlyThrough>("OverFlyThrough", OVER, "bring an over-actuated platform through a row of poles"),
    entry::<TransportHover>("TransportHover", TRANSPORT, "bring a box on bars to a point and hold it"),
    entry::<TransportTrack>("TransportTrack", TRANSPORT, "carry a box on bars along a lemniscate"),
    entry::<TransportFlyThrough>("TransportFlyThrough", TRANSPORT, "take a box on bars between two beams"),
    entry::<Forest>("Forest", AROUND, "cross a forest, another one in every episode").variant(variants::FOREST),
    entry::<Race>("Race", GATES, "fly a course of gates, displaced in every episode"),
    entry::<Pinball>("Pinball", BALL, "keep a ball bouncing on a drone"),
    entry::<Formation>("Formation", TEAM, "form a figure in each other's downwash"),
    entry::<Spread>("Spread", TEAM, "share out targets, whoever takes which"),
    entry::<GateSwitch>("GateSwitch", TEAM, "swap sides through one gate"),
];

impl TaskEntry {
    /// The environment of a configuration over the task's own defaults: they hold for settings of `task` that it does not
    /// name, and for `randomise` and `sensor` where they are none.
    ///
    /// # Errors
    /// As [`Env::of`].
    pub fn env(&self, config: &EnvConfig) -> Result<Env> {
        let (mut own, usual) = (config.clone(), self.default_config()?);
        own.randomise = own.randomise.or(usual.randomise);
        own.sensor = own.sensor.or(usual.sensor);
        for (key, value) in usual.task {
            own.task.entry(key).or_insert(value);
        }
        (self.make)(self.name, &own)
    }

    /// The configuration of layers, each over those before it, all over the task's own defaults.
    ///
    /// # Errors
    /// As [`layers::read`].
    pub fn config(&self, over: &[Layer]) -> Result<EnvConfig> {
        layers::read(self.default_table()?, over)
    }

    /// The task's own defaults as a table.
    #[doc(hidden)]
    pub fn default_table(&self) -> Result<toml::Table> {
        Ok(Layer::of_text(self.defaults, self.name)?.table().clone())
    }

    /// The task's own defaults.
    ///
    /// # Errors
    /// None for the registry as it is: a test reads them all.
    pub fn default_config(&self) -> Result<EnvConfig> {
        EnvConfig::from_toml(self.defaults, self.name)
    }
}

impl Env {
    /// A registered task by its name (case does not matter), with its own defaults under the configuration.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest name; otherwise as [`Env::of`].
    pub fn make(task: &str, config: &EnvConfig) -> Result<Self> {
        by_name(task)?.env(config)
    }
}

static OWN: RwLock<Vec<&'static TaskEntry>> = RwLock::new(Vec::new());

/// Makes a task of one's own known by its name in this process, as built-in ones are: to environments, training, evaluation,
/// checkpoints and their messages. Do so before runs or policies of it are read.
///
/// # Errors
/// [`Error::Value`] for a name that is taken (case does not matter).
pub fn register<T: BuiltIn>(name: &'static str, description: &'static str) -> Result<()> {
    let mut own = OWN.write().unwrap_or_else(PoisonError::into_inner);
    if REGISTRY.iter().chain(own.iter().copied()).any(|known| known.name.eq_ignore_ascii_case(name)) {
        return Err(Error::value("name of the task", name, "one that is not taken", "Name it otherwise."));
    }
    own.push(Box::leak(Box::new(entry::<T>(name, "tasks of one's own", description))));
    Ok(())
}

/// The names that [`by_name`] knows, built-in ones first.
pub fn names() -> Vec<&'static str> {
    all().iter().map(|entry| entry.name).collect()
}

fn all() -> Vec<&'static TaskEntry> {
    let own = OWN.read().unwrap_or_else(PoisonError::into_inner);
    REGISTRY.iter().chain(own.iter().copied()).collect()
}

/// The task of that name (case does not matter).
///
/// # Errors
/// [`Error::Unknown`] with the nearest.
pub fn by_name(name: &str) -> Result<&'static TaskEntry> {
    all().into_iter().find(|entry| entry.name.eq_ignore_ascii_case(name)).ok_or_else(|| Error::Unknown {
        kind: "task",
        name: name.to_string(),
        known: names().into_iter().map(String::from).collect(),
    })
}
