//! Goals: observations, rewards, ends, and many environments stepped together.
//!
//! | file | what |
//! |---|---|
//! | [`registry`] | the built-in tasks by name, one line each |
//! | [`suite`] | the tasks of the benchmark, one file each, opened by their tables |
//! | [`task`](mod@task) | [`Task`]: what a task is; what it is shown ([`View`]) and where episodes begin ([`Start`]) |
//! | [`sheet`] | [`Sheet`]: names, sizes, units and bounds of what a task writes |
//! | [`rig`] | [`Rig`]: what flies, its drones and where their numbers stand |
//! | [`reward`], [`path`] | shapes that rewards are made of; the lemniscate of the Track tasks |
//! | [`config`] | [`EnvConfig`]: a batch as plain data, in TOML too |
//! | [`mod@env`] | [`Env`]: many environments of one task; steps, restarts, gradients |
//! | [`observation`] | [`Stage`]: history, noise, normalisation, privileged numbers, by name |
//! | [`with`] | [`With`]: transforms composed at compile time |
//! | [`randomise`] | [`Change`]: what differs between environments and episodes |
//! | [`baseline`] | [`Baseline`]: the controllers of this crate as policies |
//! | [`mod@evaluate`], [`record`] | how well a policy does, from fixed starts; step by step |
//! | [`probe`] | tasks whose value is known in closed form |
//!
//! What every number means (arrays, frames, actions, the order within a step, what to bootstrap from) is said in the
//! [conventions](crate::conventions).
//!
//! # The main path
//!
//! ```
//! use omnidrones::tasks::{Buffers, Env, EnvConfig};
//!
//! let mut env = Env::make("Track", &EnvConfig { n_env: 100, ..EnvConfig::default() })?;
//! let mut out = Buffers::new(env.spec());
//! env.reset(None, None, &mut out.out())?;
//! let mut actions = vec![0.0; 100 * env.spec().n_agent * env.spec().action.len()];
//! for t in 0..50 {
//!     env.sample(t, &mut actions); // a policy, from out.observation
//!     env.step(&actions, &mut out.out())?; // out.reward, out.terminated, out.truncated, out.final_observation, ...
//! }
//! let column = env.spec().info_column("return").unwrap();
//! let returns: Vec<f32> = out.info.chunks(env.spec().info.len()).map(|row| row[column]).collect();
//! assert!(returns.iter().all(|r| r.is_finite()));
//! # Ok::<(), omnidrones::error::Error>(())
//! ```
//!
//! # Adding a task
//!
//! A struct that implements [`Task`], in a file of its own in [`suite`], and one line of the [`registry`]:
//! `entry("Climb", "rise to a height", include_str!("suite/climb.rs"), |name, config| Env::of(Climb::new(config)?, name,
//! config))`. The tests that loop over the registry then hold its contract, its gradients, its tables and the bound of its
//! reward. Outside the crate the struct alone is enough:
//!
//! ```
//! use omnidrones::autodiff::{Pen, Scalar};
//! use omnidrones::error::Result;
//! use omnidrones::tasks::reward::bell;
//! use omnidrones::tasks::{End, Ends, Env, EnvConfig, Metric, Rig, Sheet, Slice, Start, Task, Term, View, check_env};
//!
//! /// Rises to a height that is drawn for every episode.
//! struct Climb {
//!     rig: Rig,
//! }
//!
//! /// Height to go, m.
//! #[inline(always)]
//! fn left<S: Scalar>(view: &View<'_, S>) -> S {
//!     view.goal.get(0) - view.drone(0).position[2]
//! }
//!
//! impl Task for Climb {
//!     fn rig(&self) -> &Rig {
//!         &self.rig
//!     }
//!     fn horizon(&self) -> usize {
//!         100
//!     }
//!     fn sheet(&self) -> Sheet {
//!         Sheet {
//!             observation: vec![Slice::new("left", 1, "m, world", "h"), Slice::new("velocity", 3, "m/s, world", "v")],
//!             central: vec![],
//!             reward: vec![Term::smooth("near", "1/(1 + h²)", 1.0)],
//!             ends: vec![End::new("crash", "z < 0.2 m")],
//!             metrics: vec![Metric { name: "height_error", unit: "m" }],
//!             goal: vec![Slice::new("height", 1, "m, world", "to rise to")],
//!             memo: vec![],
//!             settings: vec![],
//!         }
//!     }
//!     fn start(&self, start: &mut Start<'_>) {
//!         start.goal[0] = start.task.uniform(1.0, 4.0);
//!         start.place(0, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]); // otherwise at rest, rotors at hover
//!     }
//!     #[inline(always)]
//!     fn observe<S: Scalar>(&self, view: &View<'_, S>, _agent: usize, out: &mut Pen<'_, S>) {
//!         out.number(left(view));
//!         out.array(view.drone(0).velocity);
//!     }
//!     #[inline(always)]
//!     fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
//!         terms.number(bell(1.0, left(view).square()));
//!     }
//!     #[inline(always)]
//!     fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
//!         ends.when(view.drone(0).position[2].lt(S::constant(0.2)));
//!     }
//!     #[inline(always)]
//!     fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
//!         out.number(left(view).abs());
//!     }
//!     #[inline(always)]
//!     fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
//!         left(view).abs().lt(S::constant(0.1))
//!     }
//!     fn ideal(&self, start: &mut Start<'_>) {
//!         start.goal[0] = 2.0;
//!         start.place(0, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]);
//!     }
//! }
//!
//! let make = |config: &EnvConfig| Env::of(Climb { rig: config.single_rig("hummingbird")? }, "Climb", config);
//! let findings = check_env(&make, &EnvConfig::default())?;
//! assert!(findings.iter().all(|finding| finding.objection.is_none()));
//! # Ok::<(), omnidrones::error::Error>(())
//! ```

pub mod baseline;
pub mod config;
pub mod env;
pub mod evaluate;
pub mod observation;
pub mod path;
pub(crate) mod physical;
pub mod probe;
pub mod randomise;
pub mod record;
pub mod registry;
pub mod reward;
pub mod rig;
pub mod sheet;
pub mod suite;
pub mod task;
pub mod with;

pub use baseline::Baseline;
pub use config::{ActionSpace, Autoreset, Delay, EnvConfig};
pub use env::check::{Finding, check_env};
pub use env::single::{Outcome, SingleEnv};
pub use env::{
    Adjoint, Buffers, Cotangents, Env, Info, Jacobian, Pending, Places, Space, Spec, StepOut, Sweep, SweepOptions, Tape,
};
pub use evaluate::{Evaluation, Watched, evaluate};
pub use observation::{Stage, Statistics};
pub use randomise::{Change, Distribution, Quantity};
pub use record::{Record, Recorded, Spread};
pub use rig::Rig;
pub use sheet::{End, Metric, Setting, Sheet, Sign, Slice, Smoothness, Term};
pub use task::{Ends, Start, Task, View, Wanted};
pub use with::{Pick, Scale, Transform, With};
