//! A differentiable multirotor simulator. One definition of the physics flies a vehicle closed loop, gives its exact
//! derivatives, steps thousands of copies at once, tunes controllers by gradients through whole flights, poses the tasks of a
//! benchmark, and trains policies on them.
//!
//! ```
//! use omnidrones::prelude::*;
//!
//! let hummingbird = vehicles::by_name("hummingbird")?;
//!
//! // Fly: fifteen seconds of a lemniscate under the published gains.
//! let flight = fly_vehicle(&hummingbird, &hummingbird.gains(), &FlightPlan::default(), &mut |_| ())?;
//! assert!(flight.log.rmse(2.0).unwrap() < 0.10); // m, after the first 2 s
//!
//! // Differentiate: the exact A and B of one 2 ms step at hover.
//! let system = Multirotor::new(&hummingbird, Physics::default())?;
//! let hover = linearise(&system, &system.hover_state([0.0, 0.0, 1.0])?, &system.hover_input()?, &[]);
//! assert_eq!((hover.state.shape(), hover.input.shape()), ((17, 17), (17, 4)));
//! assert!((hover.state[(0, 3)] - 0.002).abs() < 1e-6); // position grows by dt times velocity
//!
//! // Learn: many environments of one task, stepped into arrays of the caller.
//! let mut env = Env::make("Hover", &EnvConfig { n_env: 64, ..EnvConfig::default() })?;
//! let mut out = Buffers::new(env.spec());
//! env.reset(None, None, &mut out.out())?;
//! env.step(&[-0.4; 64 * 4], &mut out.out())?;
//! assert!(out.reward.iter().all(|r| *r > 0.0));
//! # Ok::<(), omnidrones::error::Error>(())
//! ```
//!
//! # Where to begin
//!
//! | who you are | start at | then | program in `examples/` |
//! |---|---|---|---|
//! | **control engineer**: design a controller, show that it holds | [`fly`](controllers::fly()), [`FlightPlan`](controllers::FlightPlan) | [`design`](controllers::design) (trim, LQR, margins of the loop that flies, [`tune`](controllers::design::tune())), [`linear`](controllers::linear), [`allocation`](controllers::allocation), [`MonteCarlo`](controllers::MonteCarlo), [`recovery_map`](controllers::recovery_map()) | `linearise_and_poles`, `tune_gains` |
//! | **researcher of gradients**: optimise through flights and episodes | [`System`](autodiff::System), [`Rollout`](autodiff::Rollout), [`certify`](autodiff::certify()) | [`linearise`](autodiff::linearise()), [`ClosedLoop`](controllers::ClosedLoop), [`Tape`](tasks::Tape), [`apg`](rl::apg), [`shac`](rl::shac) | `gradient_of_a_rollout`, `gradient_of_an_episode` |
//! | **learner of policies**: a fast and correct batch of environments | [`Env`](tasks::Env), [`EnvConfig`](tasks::EnvConfig) | [`Trainer`](rl::Trainer), [`TrainConfig`](rl::TrainConfig), [`evaluate`](rl::evaluate()), [`SingleEnv`](tasks::SingleEnv) | `randomised_batch`, `learn_hover_apg` |
//! | **author of a task**: goals and rewards of one's own | [`Task`](tasks::Task), [the example](tasks#adding-a-task) | [`check_env`](tasks::check_env()), [`reward`](tasks::reward), [`settings!`] | `own_task`, `own_task_and_algorithm` |
//! | **owner of a URDF**: fly it, learn what is wrong with it | [`import_file`](dynamics::urdf::import_file()), [`Vehicle::warnings`](dynamics::Vehicle::warnings) | [`Assembly`](dynamics::assembly::Assembly), [`Multibody`](dynamics::tree::Multibody), [`configurations`](dynamics::configurations) | `import_urdf`, `own_vehicle` |
//!
//! The tasks, with what they observe and reward, are listed by `omnidrones tasks` and in the repository's `docs/learning.md`. A debug
//! build steps environments tens of times slower: give dependencies `opt-level = 3` (`[profile.dev.package."*"]`).
//!
//! # Five types
//!
//! 1. [`Vehicle`](dynamics::Vehicle) is what flies, as data: parts, rotors, drag, gains; built in, from TOML or from URDF.
//! 2. [`Plant`](dynamics::Plant) is its equations under given [`Physics`](dynamics::Physics): a [`System`](autodiff::System)
//!    x⁺ = f(x, u, θ), differentiable. An articulated model makes one too.
//! 3. [`ClosedLoop`](controllers::ClosedLoop) is a plant under a [`ControlLaw`](controllers::ControlLaw), with latency, disturbances
//!    and failures: a `System` again, so a whole flight is differentiated by its gains.
//! 4. [`Env`](tasks::Env) steps thousands of environments of one [`Task`](tasks::Task), with sensors and randomisation, and gives
//!    gradients through their episodes.
//! 5. [`Policy`](rl::Policy) is what a [`Trainer`](rl::Trainer) learns in them; it flies as a
//!    [`Controller`](controllers::Controller), too.
//!
//! All else hangs on one of these; the [prelude] has the names that most programs begin with, the
//! [glossary](conventions#glossary) says what a word means.
//!
//! # The rooms
//!
//! Each room is a crate of its own, shown here as a module. Imports go upwards in this table only: `autodiff` does not know drones,
//! `dynamics` does not know controllers.
//!
//! | module | what | look here for |
//! |---|---|---|
//! | [`autodiff`] | numbers that differentiate | [`Scalar`](autodiff::Scalar), [`System`](autodiff::System), [`linearise`](autodiff::linearise()), [`Rollout`](autodiff::Rollout), [`certify`](autodiff::certify()) |
//! | [`dynamics`] | bodies | [`Vehicle`](dynamics::Vehicle), [`vehicles`](dynamics::vehicles), [`urdf`](dynamics::urdf), [`Multirotor`](dynamics::Multirotor), [`Plant`](dynamics::Plant), [`World`](dynamics::World), [`Fleet`](dynamics::Fleet), [`Scene`](dynamics::scene::Scene), [`sensors`](dynamics::sensors) |
//! | [`controllers`] | commands | [`fly`](controllers::fly()), [`Controller`](controllers::Controller), [`ControlLaw`](controllers::ControlLaw), [`ClosedLoop`](controllers::ClosedLoop), [`Reference`](controllers::Reference), [`tune`](controllers::design::tune()) |
//! | [`tasks`] | goals | [`Env`](tasks::Env), [`EnvConfig`](tasks::EnvConfig), [`SingleEnv`](tasks::SingleEnv), [`registry`](tasks::registry), [`Task`](tasks::Task), [`Tape`](tasks::Tape), [`evaluate`](tasks::evaluate()) |
//! | [`rl`] | learning | [`Trainer`](rl::Trainer), [`TrainConfig`](rl::TrainConfig), [`apg`](rl::apg), [`shac`](rl::shac), [`ppo`](rl::ppo), [`Policy`](rl::Policy), [`evaluate`](rl::evaluate()) |
//! | [`export`] | what leaves the house: C99, ONNX | [`controller_as_c`](export::controller_as_c), [`policy_as_c`](export::policy_as_c), [`onnx`](export::onnx::onnx) |
//! | [`flight`] | what was flown | [`FlightLog`](flight::FlightLog), key figures, CSV |
//! | [`error`], [`layers`], [`rng`], [`parallel`] | serve all | [`Error`](error::Error), [`Layer`](layers::Layer) of settings, [`Stream`](rng::Stream), [`Threads`](parallel::Threads) |
//! | [`conventions`] | frames, units, layouts, names | what any number means |
//!
//! Building blocks (vectors and rotations, networks and their kernels, parts of learners, states of files) are public in their rooms
//! and left out of these pages: `dynamics::spatial`, `rl::nn`, `rl::parts`, `rl::checkpoint`. Their sources document them; they may
//! change with any version.
//!
//! # One scalar, many numbers
//!
//! Physics, controllers and costs are written once over [`Scalar`](autodiff::Scalar), without branches on values
//! (`select`, `min`, `max`, `clamp`). The same lines then run as
//!
//! | scalar | gives |
//! |---|---|
//! | `f64`, `f32` | the reference simulation |
//! | duals (`Dual64`, `DualSVec64`, `HyperDual64` of num-dual) | exact first and second derivatives |
//! | [`Jet`](autodiff::Jet) | time derivatives of a reference: velocity to snap |
//! | SIMD lanes | one environment per lane, width chosen at run time: [`World`](dynamics::World), [`Env`](tasks::Env) |
//! | [`Trace`](autodiff::Trace) | a recording, compiled to a [`Program`](autodiff::Program) and its adjoint: gradients of rollouts and of episodes |
//!
//! To differentiate a system of your own, implement [`System`](autodiff::System) and, before you trust its gradient,
//! [`certify`](autodiff::certify()) it. A [`Task`](tasks::Task) of your own is such lines too: observation and reward run in
//! lanes and have gradients like the physics.
//!
//! # Promises
//!
//! Each is held by tests.
//!
//! - **One source.** A dual step has the value of the plain step bit for bit; lanes and compiled programs agree with it
//!   to rounding; adjoints agree with duals to 1e-10, through motor saturation and closed loops.
//! - **Determinism.** The result of an environment in a [`World`](dynamics::World) or an [`Env`](tasks::Env) is bit-identical
//!   for any number of threads, any batch size and any place in the batch; so is what follows a saved state.
//! - **Containment.** A NaN action or a diverging state stops a vehicle of a [`World`](dynamics::World) with a
//!   [reason](dynamics::batch::StopReason) and changes no bit of its neighbours. In an [`Env`](tasks::Env) such an action flies
//!   the safe command and is counted, and such a state ends the episode.
//! - **No panic on data.** Files, configurations, names and sizes give an [`Error`](error::Error) that names the value,
//!   the limit and the remedy; a hundred thousand mutated URDF files are part of the test suite. Functions that panic on
//!   a mistake of the caller (a slice of the wrong length) say so.
//! - **No allocation** while stepping, evaluating or differentiating, after warm-up; clarabel, which solves allocations
//!   with cones, does allocate.
//!
//! # Beside the library
//!
//! Crates of the same workspace build on it: `omnidrones-plot` (figures as PNG, SVG and GIF), `omnidrones-bench` (what a step
//! and a gradient cost on this machine) and `omnidrones-cli`, the `omnidrones` command.

#![warn(missing_docs)]

#[cfg(all(test, target_arch = "x86_64", target_os = "linux", target_env = "gnu"))]
mod golden;
#[doc(hidden)]
pub mod internals;
pub mod prelude;
#[cfg(test)]
mod speed_gate;

#[doc(inline)]
pub use base::{error, layers, parallel};
#[cfg(feature = "cuda")]
#[doc(inline)]
pub use gpu;
#[doc(inline)]
pub use {autodiff, controllers, dynamics, export, flight, rl, rng, tasks};

#[doc(inline)]
pub use tasks::settings;

/// Vectors and matrices of the interface are of this version.
pub use nalgebra;
/// Duals that implement [`Scalar`](autodiff::Scalar) are of this version.
pub use num_dual;

// read by documentation alone: a word in them compiles nothing anew
/// Units, frames, orders of arrays, and what holds everywhere.
#[cfg_attr(any(doc, doctest), doc = "", doc = include_str!("../CONVENTIONS.md"))]
pub mod conventions {}
/// What every version changed.
#[cfg_attr(any(doc, doctest), doc = "", doc = include_str!("../CHANGELOG.md"))]
pub mod changelog {}

/// The examples of the README and of `docs/`, run with the documentation's: a module per file that has any.
#[cfg(doctest)]
mod documents {
    #[doc = include_str!("../README.md")]
    mod readme {}
    #[doc = include_str!("../docs/batches-and-speed.md")]
    mod batches_and_speed {}
    #[doc = include_str!("../docs/learning.md")]
    mod learning {}
}
