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
use super::task::Task;
use super::written::{TaskRecord, keep_record, record_of};
use base::error::{Error, Result};
use base::layers::{self, Layer};
use std::fmt;
use std::sync::{Arc, PoisonError, RwLock};

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
    make: Make,
}

/// How a task is made.
#[derive(Clone, Copy)]
enum Make {
    Of(fn(&EnvConfig) -> Result<Box<dyn Task>>),
    Source(&'static RwLock<Arc<dyn TaskSource>>),
}

impl fmt::Debug for Make {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if matches!(self, Self::Of(_)) { "built in" } else { "registered" })
    }
}

/// Writes tasks down that are no types of Rust.
pub trait TaskSource: Send + Sync {
    /// The task with the settings of a configuration, over [`defaults`](Self::defaults).
    ///
    /// # Errors
    /// What speaks against the configuration or the task.
    fn record(&self, config: &EnvConfig) -> Result<Arc<TaskRecord>>;

    /// Keys of its settings.
    ///
    /// # Errors
    /// What speaks against them.
    fn setting_keys(&self) -> Result<Vec<String>>;

    /// The task's own defaults, over those of [`EnvConfig`].
    fn defaults(&self) -> toml::Table {
        toml::Table::new()
    }

    /// One line for tables.
    fn description(&self) -> String {
        String::new()
    }
}

const fn entry<T: BuiltIn>(name: &'static str, family: &'static str, description: &'static str) -> TaskEntry {
    TaskEntry { name, family, description, defaults: "", own: "", make: Make::Of(make::<T>) }
}

fn make<T: BuiltIn>(config: &EnvConfig) -> Result<Box<dyn Task>> {
    Ok(Box::new(T::new(config)?))
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
        let own = self.pinned(self.over_defaults(config)?)?;
        Env::of_task(self.task_of(&own)?, self.name, &own)
    }

    /// The task of that configuration.
    ///
    /// # Errors
    /// As [`Self::env`].
    pub fn task(&self, config: &EnvConfig) -> Result<Box<dyn Task>> {
        self.task_of(&self.pinned(self.over_defaults(config)?)?)
    }

    /// The configuration with the record that it means, where the task was written down: what a name stands for may change, a record
    /// does not.
    ///
    /// # Errors
    /// As [`TaskSource::record`].
    pub fn pinned(&self, config: EnvConfig) -> Result<EnvConfig> {
        let Make::Source(source) = &self.make else { return Ok(config) };
        if !config.task_record.is_empty() {
            return Ok(config);
        }
        let record = read(source).record(&self.over_defaults(&config)?)?;
        Ok(EnvConfig { task_record: keep_record(&record)?, ..config })
    }

    /// The record of a configuration that names one.
    ///
    /// # Errors
    /// [`Error::Unknown`] for one that nobody has read or written in this process.
    pub fn record(&self, config: &EnvConfig) -> Result<Option<Arc<TaskRecord>>> {
        match &self.make {
            Make::Of(_) => Ok(None),
            Make::Source(_) => record_of(self.name, &self.pinned(config.clone())?.task_record).map(Some),
        }
    }

    fn task_of(&self, config: &EnvConfig) -> Result<Box<dyn Task>> {
        match &self.make {
            Make::Of(make) => make(config),
            Make::Source(_) => Ok(Box::new(record_of(self.name, &config.task_record)?.task(config)?)),
        }
    }

    /// Whether it is written down, not in Rust.
    #[doc(hidden)]
    pub fn is_source(&self) -> bool {
        !self.is_in_rust()
    }

    /// Whether it is a task in Rust.
    pub(crate) fn is_in_rust(&self) -> bool {
        matches!(self.make, Make::Of(_))
    }

    /// Keys of the task's own settings.
    ///
    /// # Errors
    /// Those of tasks that are not built in.
    pub fn setting_keys(&self) -> Result<Vec<String>> {
        match &self.make {
            Make::Of(make) => Ok(make(&self.default_config()?)?.settings().into_iter().map(|own| own.key).collect()),
            Make::Source(source) => read(source).setting_keys(),
        }
    }

    /// One line for tables.
    pub fn about(&self) -> String {
        match &self.make {
            Make::Of(_) => self.description.into(),
            Make::Source(source) => read(source).description(),
        }
    }

    /// A configuration over the task's own defaults.
    #[doc(hidden)]
    pub fn over_defaults(&self, config: &EnvConfig) -> Result<EnvConfig> {
        let (mut own, usual) = (config.clone(), self.default_config()?);
        own.randomise = own.randomise.or(usual.randomise);
        own.sensor = own.sensor.or(usual.sensor);
        for (key, value) in usual.task {
            own.task.entry(key).or_insert(value);
        }
        Ok(own)
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
        match &self.make {
            Make::Of(_) => Ok(Layer::of_text(self.defaults, self.name)?.table().clone()),
            Make::Source(source) => Ok(read(source).defaults()),
        }
    }

    /// The task's own defaults.
    ///
    /// # Errors
    /// None for the registry as it is: a test reads them all.
    pub fn default_config(&self) -> Result<EnvConfig> {
        layers::read(self.default_table()?, &[])
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

/// Makes tasks of a source known by a name, in place of those of an earlier source of that name: who writes a task writes it more
/// than once.
///
/// # Errors
/// [`Error::Value`] for the name of a task in Rust (case does not matter), and for one that is none.
pub fn register_source(name: &str, source: Arc<dyn TaskSource>) -> Result<&'static TaskEntry> {
    let is_word = name.chars().all(|c| c.is_ascii_alphanumeric() || "_-+.".contains(c));
    if !(is_word && name.starts_with(|c: char| c.is_ascii_alphabetic()) && name.len() <= LONGEST_NAME) {
        let limit = format!("letters, digits, '_', '-', '+' and '.', a letter first, {LONGEST_NAME} at most");
        return Err(Error::value("name of the task", format!("'{name}'"), limit, "Name it otherwise."));
    }
    let mut own = OWN.write().unwrap_or_else(PoisonError::into_inner);
    let mut known = REGISTRY.iter().chain(own.iter().copied());
    if let Some(known) = known.find(|known| known.name.eq_ignore_ascii_case(name)) {
        let Make::Source(old) = &known.make else {
            return Err(Error::value("name of the task", name, "one that is not taken", "Name it otherwise."));
        };
        let old = std::mem::replace(&mut *old.write().unwrap_or_else(PoisonError::into_inner), source);
        let known = *known;
        // what goes may call anything: not under the locks
        drop(own);
        drop(old);
        return by_name(known.name);
    }
    let make = Make::Source(Box::leak(Box::new(RwLock::new(source))));
    let (family, description) = ("tasks of one's own", "");
    let entry = TaskEntry { name: name.to_string().leak(), family, description, defaults: "", own: "", make };
    own.push(Box::leak(Box::new(entry)));
    Ok(own[own.len() - 1])
}

/// Longest name of a task.
const LONGEST_NAME: usize = 64;

fn read(source: &RwLock<Arc<dyn TaskSource>>) -> Arc<dyn TaskSource> {
    source.read().unwrap_or_else(PoisonError::into_inner).clone()
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
