//! What an environment is made of, as plain data: in TOML by the same names.

use super::bounds::Bounds;
use super::observation::ObservationTransform;
use super::randomise::Randomisation;
use super::robot::{Robot, benchmark, benchmark_effects};
use super::settings::{Settings, find};
use base::error::{Error, Result};
use base::layers::{self, Layer};
use controllers::action::ActionScale;
use controllers::cascade::Level;
use dynamics::configurations::Omav;
use dynamics::integrate::Integrator;
use dynamics::sensors::SensorConfig;
use dynamics::{Effects, Physics, Vehicle, vehicles};
use serde::{Deserialize, Deserializer, Serialize};

/// What a done environment does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Autoreset {
    /// Restarts in the same step: `final_*` hold the end, `obs` the first observation of the next episode.
    #[default]
    SameStep,
    /// Restarts in the next step, whose action is ignored and whose reward is 0 (Gymnasium's default).
    NextStep,
    /// Stands still until [`Env::reset`](super::Env::reset).
    Disabled,
}

impl Autoreset {
    /// All three.
    pub const ALL: [Self; 3] = [Self::SameStep, Self::NextStep, Self::Disabled];
}

/// How numbers of an action become commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub enum ActionSpace {
    /// Each in [−1, 1].
    #[default]
    Continuous,
    /// One number in 0 … levelsⁿ − 1 per agent: its digits to the base `levels` are the commands, evenly spaced over
    /// [−1, 1], the first command the highest digit.
    Discrete {
        /// 2 or more.
        levels: usize,
    },
    /// One number in 0 … levels − 1 per command.
    MultiDiscrete {
        /// 2 or more.
        levels: usize,
    },
}

/// Steps between an action and its effect, drawn anew for every episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Delay {
    /// Fewest, steps. Default 0.
    pub min: usize,
    /// Most, steps, up to 32. Default 0.
    pub max: usize,
}

/// Most steps of delay.
pub(crate) const MAX_DELAY: usize = 32;
/// Most steps of an episode: batches count them in `f32`, exactly up to 2²⁴.
pub(crate) const MAX_HORIZON: usize = 1 << 24;
/// Most memory of an environment unless [`EnvConfig::memory_limit`] says otherwise, bytes.
pub(crate) const MEMORY_LIMIT: u64 = 8 << 30;

/// A batch of environments: how many, what physics, which transforms. The task's own settings stand in `task`.
///
/// ```
/// # use omnidrones_tasks::omnidrones;
/// use omnidrones::tasks::EnvConfig;
/// let config = EnvConfig::from_toml("n_env = 256\ncontrol = 'rate'\n[task]\nvehicle = 'crazyflie'", "my.toml")?;
/// assert_eq!((config.n_env, config.control_steps()), (256, 4));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EnvConfig {
    /// Environments, E, at least 1; memory sets the upper limit. Default 4096.
    #[serde(deserialize_with = "whole")]
    pub n_env: usize,
    /// Seed of all randomness. Default 0.
    pub seed: u64,
    /// Number of the first environment: a shard of a larger batch gives its own. Default 0.
    pub first_environment: u64,
    /// Where actions enter the cascade. Default `rotor`.
    pub control: Level,
    /// What an action of 1 means in the control modes.
    pub action_scale: ActionScale,
    /// How far an action of 1 changes what the task's own controller commands, of a rotor's or drive's range of [−1, 1]:
    /// u = u_c + residual · a, clipped. The controller sees the true state but the nominal numbers, and reacts without
    /// `delay`. [0, 2]; 0, the default: no controller, actions are the commands.
    pub residual: f64,
    /// Numbers of an action. Default continuous.
    pub actions: ActionSpace,
    /// Steps between an action and its effect. Default none.
    pub delay: Delay,
    /// Seconds per step of the environment. Default 0.016.
    pub dt: f64,
    /// Computations of the control modes' rate level per step, each followed by the physics of its time; 0 means 1 in
    /// rotor mode and 4 otherwise. At most 1000. Default 0.
    pub control_rate: usize,
    /// Integrator steps per computation, 1 to 1000. Default 1.
    pub substeps: usize,
    /// How each is integrated. Default RK4.
    pub integrator: Integrator,
    /// Weight of the change of throttle in a step, (1/m) Σ ‖s − s_before‖² over the drones (s = Ω/Ω_max): a term of the reward
    /// that is taken off, and a summand of the training loss. It calms commands that jump from step to step. [0, 1e6]; 0, the default:
    /// none.
    #[serde(skip_serializing_if = "is_zero")]
    pub throttle_change: f64,
    /// Transforms of the observation, in order. Default none.
    pub observation: Vec<ObservationTransform>,
    /// What differs between environments and episodes; none for the task's own, an empty list for nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub randomise: Option<Vec<Randomisation>>,
    /// Sensors of every agent, whose readings stand behind the task's own numbers in its observation; none for the task's own,
    /// an empty list for none at all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<Vec<SensorConfig>>,
    /// Difficulty of episodes, 0 to 1: the share of the ranges of `randomise` that they take, and what a task makes of
    /// [`Start::difficulty`](super::Start::difficulty). A curriculum begins here. Default 1.
    pub difficulty: f64,
    /// Share of the episodes whose difficulty is drawn, uniformly between 0 and [`difficulty`](Self::difficulty); the others have
    /// that one. Where hard episodes end early, a learner whose difficulty rises goes on seeing how good ones go on. [0, 1]. Default 0.
    pub easier: f64,
    /// Bounds of the state: an episode that leaves them ends as `diverged`.
    pub bounds: Bounds,
    /// What a done environment does. Default [`Autoreset::SameStep`].
    pub autoreset: Autoreset,
    /// Whether first episodes begin anywhere in time, so that time-outs do not come together. Default false.
    pub stagger: bool,
    /// Mean number of steps after which episodes are truncated at random, m: every step is the last with a probability of 1/m, and
    /// at the horizon time is over as ever. 0: at the horizon alone. Learners, who know truncation from an end, see more of how
    /// episodes begin than of what comes when all is flown: where flying there is hard and staying is not, that is what they need.
    /// Default 0.
    pub truncate_after: usize,
    /// Names of the columns of [`Spec::info`](super::Spec::info) that are reported, in the order of that list however they are named;
    /// none for all. What is left out is not computed. Learners add the columns that they read, and evaluations report all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub info: Option<Vec<String>>,
    /// Most memory, bytes. Default 8 GiB.
    pub memory_limit: u64,
    /// A vehicle of one's own, which the task's setting `vehicle` names like a built-in one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub own_vehicle: Option<Vehicle>,
    /// Of a task that was written down, which record: [`TaskRecord::id`](super::written::TaskRecord::id). Environments say it of
    /// themselves; empty, the default: the newest one that fits.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub task_record: String,
    /// The task's own settings.
    pub task: toml::Table,
}

/// A share of a curriculum.
pub(crate) fn check_difficulty(share: f64) -> Result<()> {
    if (0.0..=1.0).contains(&share) {
        return Ok(());
    }
    Err(Error::value("difficulty", share, "within [0, 1]", "1 takes all randomisation, 0 none."))
}

impl Default for EnvConfig {
    fn default() -> Self {
        Self {
            n_env: 4096,
            seed: 0,
            first_environment: 0,
            control: Level::Rotor,
            action_scale: ActionScale::default(),
            residual: 0.0,
            actions: ActionSpace::Continuous,
            delay: Delay::default(),
            dt: 0.016,
            control_rate: 0,
            substeps: 1,
            integrator: Integrator::RungeKutta4,
            throttle_change: 0.0,
            observation: Vec::new(),
            randomise: None,
            sensor: None,
            difficulty: 1.0,
            easier: 0.0,
            bounds: Bounds::default(),
            autoreset: Autoreset::SameStep,
            stagger: false,
            truncate_after: 0,
            info: None,
            memory_limit: MEMORY_LIMIT,
            own_vehicle: None,
            task_record: String::new(),
            task: toml::Table::new(),
        }
    }
}

/// What nobody set is not written: hashes of settings stay.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "as serde asks")]
fn is_zero(weight: &f64) -> bool {
    *weight == 0.0
}

/// A count that may be written as `1e6`; what it cannot be, the message says.
fn whole<'de, D: Deserializer<'de>>(deserializer: D) -> std::result::Result<usize, D::Error> {
    let value = f64::deserialize(deserializer)?;
    if (1.0..=9e15).contains(&value) && value.fract() == 0.0 {
        return Ok(value as usize);
    }
    let text = format!("n_env is {value}, but it must be a whole number from 1 on. Memory sets the upper limit");
    Err(serde::de::Error::custom(text))
}

impl EnvConfig {
    /// From TOML text; `file` is for messages.
    ///
    /// # Errors
    /// [`Error::Format`] with line, column and the nearest known key.
    pub fn from_toml(text: &str, file: &str) -> Result<Self> {
        layers::read(toml::Table::new(), &[Layer::of_text(text, file)?])
    }

    /// From a table, as other languages give it.
    ///
    /// # Errors
    /// [`Error::Format`] with the path of the key and the nearest known one.
    pub fn from_table(table: toml::Table) -> Result<Self> {
        layers::read(toml::Table::new(), &[Layer::of_table("configuration", table)])
    }

    /// The names of its settings.
    pub fn keys() -> Vec<String> {
        let whole = Self {
            randomise: Some(Vec::new()),
            sensor: Some(Vec::new()),
            info: Some(Vec::new()),
            throttle_change: 1.0,
            ..Self::default()
        };
        let told = toml::Table::try_from(whole).unwrap_or_default();
        told.keys().cloned().chain(["own_vehicle", "task_record"].map(String::from)).collect()
    }

    /// The changes between environments and episodes, as far as the configuration says.
    pub fn changes(&self) -> &[Randomisation] {
        self.randomise.as_deref().unwrap_or_default()
    }

    /// Whether what sensors read stands in the observation.
    pub(crate) fn shows_readings(&self) -> bool {
        !matches!(self.observation.first(), Some(ObservationTransform::Estimate { readings: false, .. }))
    }

    /// The sensors of every agent, as far as the configuration says.
    pub fn sensors(&self) -> &[SensorConfig] {
        self.sensor.as_deref().unwrap_or_default()
    }

    /// The same with episodes that are flown from their start to their end, none of them made easier, and every column reported: without
    /// [`stagger`](Self::stagger), [`truncate_after`](Self::truncate_after), [`easier`](Self::easier) and [`info`](Self::info), which
    /// are for learners.
    #[must_use]
    pub fn whole_episodes(self) -> Self {
        Self { stagger: false, truncate_after: 0, easier: 0.0, info: None, ..self }
    }

    /// Checks every number but the size of the batch, which needs the task.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        self.physics().validate()?;
        self.action_scale.validate()?;
        self.bounds.validate()?;
        let counts = [("control_rate", self.control_rate, 0, 1000), ("substeps", self.substeps, 1, 1000)];
        for (what, value, least, most) in counts {
            if value < least || value > most {
                return Err(Error::limit(what, value, format!("{least} to {most}"), "Lower dt instead."));
            }
        }
        if self.delay.min > self.delay.max || self.delay.max > MAX_DELAY {
            let (value, limit) =
                (format!("{} to {}", self.delay.min, self.delay.max), format!("0 to {MAX_DELAY} steps"));
            return Err(Error::limit("delay", value, limit, "Give min ≤ max."));
        }
        if let ActionSpace::Discrete { levels } | ActionSpace::MultiDiscrete { levels } = self.actions
            && !(2..=1024).contains(&levels)
        {
            return Err(Error::limit("actions.levels", levels, "2 to 1024", "Use continuous actions."));
        }
        check_difficulty(self.difficulty)?;
        if !(0.0..=1.0).contains(&self.easier) {
            let remedy = "1 draws the difficulty of every episode, 0 of none.";
            return Err(Error::value("easier", self.easier, "within [0, 1]", remedy));
        }
        if !(0.0..=2.0).contains(&self.residual) {
            let remedy = "0 leaves the controller out, 2 reaches every command from every other.";
            return Err(Error::value("residual", self.residual, "within [0, 2]", remedy));
        }
        if !(0.0..=1e6).contains(&self.throttle_change) {
            let remedy = "0 takes nothing off for commands that jump; 0.1 to 10 are usual.";
            return Err(Error::value("throttle_change", self.throttle_change, "within [0, 1e6]", remedy));
        }
        self.own_vehicle.as_ref().map_or(Ok(()), Vehicle::validate)?;
        self.check_task()?;
        self.observation.iter().try_for_each(ObservationTransform::validate)?;
        self.changes().iter().try_for_each(Randomisation::validate)
    }

    /// Every number of the task's settings is finite.
    fn check_task(&self) -> Result<()> {
        for (key, value) in &self.task {
            if let Some(x) = find(value, &|x| !x.is_finite()) {
                return Err(Error::value(format!("task.{key}"), x, "finite", "Leave it out for the task's own."));
            }
            if let toml::Value::Integer(count @ ..0) = value {
                return Err(Error::value(format!("task.{key}"), count, "≥ 0", "Leave it out for the task's own."));
            }
        }
        Ok(())
    }

    /// Computations of the control modes per step.
    pub fn control_steps(&self) -> usize {
        match (self.control_rate, self.control) {
            (0, Level::Rotor) => 1,
            (0, _) => 4,
            (n, _) => n,
        }
    }

    /// Physics of one computation: its time step is dt/[`control_steps`](Self::control_steps).
    pub fn physics(&self) -> Physics {
        let windy = self.changes().iter().any(|c| c.blows());
        Physics {
            dt: self.dt / self.control_steps() as f64,
            substeps: self.substeps,
            integrator: self.integrator,
            effects: Effects { disturbance: windy, ..benchmark_effects() },
        }
    }

    /// As [`EnvConfig::physics`] with other effects beside the benchmark's.
    pub fn physics_with(&self, change: impl FnOnce(&mut Effects)) -> Physics {
        let mut physics = self.physics();
        change(&mut physics.effects);
        physics
    }

    /// The task's settings.
    ///
    /// # Errors
    /// As [`Settings::of`]; [`Error::Value`] for a number that is not finite.
    pub fn settings<T: Settings>(&self) -> Result<T> {
        self.check_task()?;
        T::of(&self.task)
    }

    /// The benchmark's form of a vehicle: the configuration's own, or a built-in one.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest.
    pub fn vehicle(&self, name: &str) -> Result<Vehicle> {
        Ok(benchmark(&self.plain_vehicle(name)?))
    }

    /// As its file gives it.
    fn plain_vehicle(&self, name: &str) -> Result<Vehicle> {
        let own = self.own_vehicle.as_ref().filter(|own| own.name.eq_ignore_ascii_case(name));
        let known = |error| match (error, &self.own_vehicle) {
            (Error::Unknown { kind, name, mut known }, Some(own)) => {
                known.push(own.name.clone());
                Error::Unknown { kind, name, known }
            }
            (other, _) => other,
        };
        own.map_or_else(|| vehicles::by_name(name).map_err(known), |own| Ok(own.clone()))
    }

    /// A single drone: the configuration's own vehicle, any built-in one, or `omav_tilting` with its tilting units.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest.
    pub fn single_robot(&self, name: &str) -> Result<Robot> {
        if name.eq_ignore_ascii_case(TILTING) {
            let robot = Omav { vehicle: self.vehicle("omav")?, ..Omav::default() }.build()?;
            return Robot::of_model(&robot.model, self.physics(), None, |_| robot.map.units.to_vec());
        }
        let vehicle = self.plain_vehicle(name).map_err(|error| match error {
            Error::Unknown { kind, name, mut known } => {
                known.push(TILTING.into());
                Error::Unknown { kind, name, known }
            }
            other => other,
        })?;
        Robot::of_vehicle(&benchmark(&vehicle), self.physics())
    }

    /// `horizon` within its limits.
    ///
    /// # Errors
    /// [`Error::Limit`] otherwise.
    pub fn check_horizon(horizon: usize) -> Result<()> {
        if (1..=MAX_HORIZON).contains(&horizon) {
            return Ok(());
        }
        Err(Error::limit("horizon", horizon, format!("1 to {MAX_HORIZON} steps"), "The benchmark's are 500 and 600."))
    }
}

/// The Omav with tilting units, as a vehicle.
pub const TILTING: &str = "omav_tilting";
