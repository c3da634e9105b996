//! Goals: observations, rewards, ends, and many environments stepped together.
//!
//! | file | what |
//! |---|---|
//! | [`registry`] | the built-in tasks by name, one line each |
//! | `suite` | the tasks of the benchmark, one file each |
//! | `task`: [`HostStart`], [`TaskReference`] | [`Task`]: what a task is; what it is shown ([`View`]) and where episodes begin ([`Start`]) |
//! | `declare`: [`Ends`], [`Goal`] | [`Writer`]: numbers with their names beside them |
//! | `task_spec`: [`End`], [`Field`] | [`TaskSpec`]: names, sizes, units and bounds of what a task writes |
//! | `any_task` | lets a task declare itself |
//! | [`settings!`](crate::settings!) | `settings!`: what `[task]` sets, each number stated once |
//! | `robot` | [`Robot`]: what flies, its drones and where their numbers stand |
//! | [`reward`], `track_path` | shapes that rewards are made of; the lemniscate of the Track tasks |
//! | `clearance`, `grove` | how far away things are from what flies; a forest that stands elsewhere in every episode |
//! | `config`: [`ActionSpace`], [`Autoreset`] | [`EnvConfig`]: a batch as plain data, in TOML too |
//! | `bounds` | [`Bounds`]: how far a simulation may go |
//! | `env`: [`Finding`], [`SingleEnv`] | [`Env`]: many environments of one task; steps, restarts, gradients |
//! | `observation`: [`Statistics`] | [`ObservationTransform`]: history, noise, normalisation, privileged numbers, by name |
//! | `randomise`: [`Distribution`], [`RandomisationOperation`] | [`Randomisation`]: what differs between environments and episodes |
//! | `baseline` | [`Baseline`]: the library's controllers as policies |
//! | `evaluate`, `record` | how well a policy does, from fixed starts; step by step |
//! | [`written`] | tasks as data, asked once for everything: how tasks of other languages come in |
//! | `probe` | tasks whose value is known in closed form |
//!
//! What every number means (arrays, frames, actions, the order within a step, what to bootstrap from) is said in
//! `conventions`.
//!
//! # The main path
//!
//! ```
//! # use omnidrones_tasks::omnidrones;
//! use omnidrones::tasks::{Buffers, Column, Env, EnvConfig};
//!
//! let mut env = Env::make("Track", &EnvConfig { n_env: 100, ..EnvConfig::default() })?;
//! let mut out = Buffers::new(env.spec());
//! env.reset(None, None, &mut out.out())?;
//! let mut actions = vec![0.0; 100 * env.spec().n_agent * env.spec().action.len()];
//! for t in 0..50 {
//!     env.sample(t, &mut actions); // a policy, from out.observation
//!     env.step(&actions, &mut out.out())?; // out.reward, out.terminated, out.truncated, out.final_observation, ...
//! }
//! let column = env.spec().needed_column(Column::Return)?;
//! let returns: Vec<f32> = out.info.chunks(env.spec().info.len()).map(|row| row[column]).collect();
//! assert!(returns.iter().all(|r| r.is_finite()));
//! # Ok::<(), omnidrones::error::Error>(())
//! ```
//!
//! # Adding a task
//!
//! A struct that implements [`Task`] and [`BuiltIn`], in a file of its own in `suite`, and one line of the
//! [`registry`]: `entry::<Climb>("Climb", ONE_DRONE, "rise to a height")`. The tests that loop over the registry then hold its
//! contract, its gradients, its bounds and its success. Outside the crate the struct alone is enough. What it writes it names
//! in the same breath; that is all of its documentation, its layout and its infos:
//!
//! ```
//! # use omnidrones_tasks::omnidrones;
//! use omnidrones::autodiff::{Scalar, Trace, TraceMask};
//! use omnidrones::error::Result;
//! use omnidrones::settings;
//! use omnidrones::tasks::reward::rational_kernel;
//! use omnidrones::tasks::{Ends, Env, EnvConfig, Robot, Setting, Settings, Start, Task, View, Writer, check_env};
//!
//! settings! {
//!     /// What `[task]` may say.
//!     struct ClimbSettings {
//!         horizon: usize = 100 => ("steps", "T", Any);
//!         height: [f64; 2] = [1.0, 4.0] => ("m, world", "to rise to, lowest and highest", PositiveOrdered);
//!     }
//! }
//!
//! /// Rises to a height that is drawn for every episode.
//! struct Climb {
//!     robot: Robot,
//!     settings: ClimbSettings,
//! }
//!
//! /// Height to go, m.
//! fn left(view: &View) -> Trace {
//!     view.goal[0] - view.drone(0).position[2]
//! }
//!
//! impl Climb {
//!     fn begin(&self, start: &mut Start<'_>, height: impl Into<Trace>) {
//!         start.goal.field("height", "m, world", "to rise to").number(height);
//!         start.place(0, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]); // otherwise at rest, rotors at hover
//!     }
//! }
//!
//! impl Task for Climb {
//!     fn robot(&self) -> &Robot {
//!         &self.robot
//!     }
//!     fn horizon(&self) -> usize {
//!         self.settings.horizon
//!     }
//!     fn settings(&self) -> Vec<Setting> {
//!         self.settings.list()
//!     }
//!     fn start(&self, start: &mut Start<'_>) {
//!         let height = start.task.uniform(self.settings.height[0], self.settings.height[1]);
//!         self.begin(start, height);
//!     }
//!     fn observe(&self, view: &View, _agent: usize, out: &mut Writer) {
//!         out.field("left", "m, world", "h").number(left(view));
//!         out.field("velocity", "m/s, world", "v").array(view.drone(0).velocity);
//!     }
//!     fn reward(&self, view: &View, terms: &mut Writer) {
//!         terms.term("near", "1/(1 + h²)", 1.0).number(rational_kernel(1.0, left(view).square()));
//!     }
//!     fn ends(&self, view: &View, ends: &mut Ends) {
//!         ends.when("crash", "z < 0.2 m", view.drone(0).position[2].lt(0.2));
//!     }
//!     fn metrics(&self, view: &View, out: &mut Writer) {
//!         out.metric("height_error", "m", left(view).abs());
//!     }
//!     fn success(&self, view: &View) -> TraceMask {
//!         left(view).abs().lt(0.1)
//!     }
//!     fn ideal(&self, start: &mut Start<'_>) {
//!         self.begin(start, 2.0);
//!     }
//! }
//!
//! let build = |config: &EnvConfig| -> Result<Climb> {
//!     Ok(Climb { robot: config.single_robot("hummingbird")?, settings: config.settings()? })
//! };
//! let make = |config: &EnvConfig| Env::of(build(config)?, "Climb", config);
//! let findings = check_env(&make, &EnvConfig::default())?;
//! assert!(findings.iter().all(|finding| finding.objection.is_none()));
//! # Ok::<(), omnidrones::error::Error>(())
//! ```

pub(crate) mod activity;
pub(crate) mod any_task;
pub(crate) mod baseline;
pub(crate) mod baseline_controllers;
#[doc(hidden)]
pub mod bounds;
pub(crate) mod clearance;
#[doc(hidden)]
pub mod config;
#[doc(hidden)]
pub mod declare;
#[doc(hidden)]
pub mod env;
pub(crate) mod evaluate;
#[doc(hidden)]
pub mod groups;
pub(crate) mod grove;
pub(crate) mod mass_groups;
#[doc(hidden)]
pub mod observation;
#[doc(hidden)]
pub mod probe;
#[doc(hidden)]
pub mod randomise;
pub(crate) mod record;
pub mod registry;
pub mod reward;
#[doc(hidden)]
pub mod robot;
#[doc(hidden)]
pub mod settings;
pub(crate) mod start;
#[doc(hidden)]
pub mod suite;
pub(crate) mod task;
#[doc(hidden)]
pub mod task_spec;
pub(crate) mod track_path;
pub mod written;

pub use activity::{Activity, EpisodeActivity};
pub use baseline::Baseline;
pub use bounds::Bounds;
pub use config::{ActionSpace, Autoreset, Delay, EnvConfig};
pub use declare::{Ends, Goal, Loss, Writer};
pub use env::check::{Finding, check_env};
pub use env::single::{SingleEnv, SingleStep};
pub use env::{
    Adjoint, AgentWidths, Buffers, Column, Cotangents, Env, Info, Jacobian, PendingStatistics, Seeds, Space, Spec,
    StepLayout, StepOut, StepPhases, Sweep, SweepOptions, Tape,
};
#[doc(hidden)]
pub use env::{ShownBeside, TaskFunctions};
pub use evaluate::{EpisodeRows, Evaluation, EvaluationStep, PolicyFn, evaluate, wilson};
pub use groups::{Dtype, Group, GroupKind};
#[doc(hidden)]
pub use grove::Grove;
pub use observation::{ObservationTransform, Statistics};
pub use randomise::{Distribution, Randomisation, RandomisationOperation, RandomisationTime, RandomisedQuantity};
pub use record::{Record, RecordedStep, Spread};
pub use registry::BuiltIn;
pub use robot::{Inertial, Robot};
pub use settings::{Setting, SettingDomain, Settings};
pub use start::{ANY_YAW, Draw, Draws, ManyDraw, START_TILT, Start, StartScalar};
#[doc(hidden)]
pub use suite::assignment::assignment;
pub use task::{HostStart, Task, TaskReference, View};
pub use task_spec::{End, Field, FieldLayout, Limit, Metric, Smoothness, Success, TaskSpec, Term};
pub use track_path::{Follow, PathRange, TrackPath};

/// Examples of the documentation name things as users of `omnidrones` do.
#[doc(hidden)]
pub mod omnidrones {
    pub use crate as tasks;
    pub use crate::settings;
    pub use {autodiff, base::error, base::parallel, controllers, dynamics, rng};
}
