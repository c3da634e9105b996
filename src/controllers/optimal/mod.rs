//! Optimal control on the exact model: trajectories of least cost, model predictive control, and how both depend on what they are told.
//!
//! ```text
//! System + OptimalCost ─▶ StageModel ─▶ OptimalProblem ─▶ Ilqr               a trajectory, with gains along it
//!                         (recorded      (numbers of      RealTimeIteration  a plan a tick ─▶ Mpc, a controller
//!                          once)          its stages)     SolutionSensitivity
//!                                               └▶ StageQp ─▶ QpSolver       the program of all of them
//! ```
//!
//! A system and its cost are written once over any scalar. They are recorded once; exact gradients, Hessians and Jacobians in error
//! coordinates are derived from the recording and computed for eight stages side by side.
//!
//! | file | idea |
//! |---|---|
//! | `cost`: [`OptimalCost`], [`Terms`] | what a trajectory is to keep small, and what is to hold |
//! | `stage_model`: [`StageModel`] | a system and a cost, recorded with their derivatives |
//! | `problem`: [`OptimalProblem`], [`OptimalTrajectory`] | start, bounds, parameters of every stage |
//! | `stage_qp`: [`StageQp`], [`SoftBound`] | a quadratic program over linked stages |
//! | `qp_solver`: [`QpSolver`] | its solution by sets of held inputs, and by an interior-point method where those are not known |
//! | `interior_point` | that method |
//! | `stage_sweeps` | Riccati recursions in registers |
//! | `stage_expansion` | the program about a trajectory |
//! | `ilqr`: [`Ilqr`] | trajectories of least cost, conditions by an augmented Lagrangian |
//! | `real_time`: [`RealTimeIteration`] | one program a tick |
//! | `sensitivity`: [`SolutionSensitivity`] | derivatives of solutions |
//! | `planned_plant`: [`PlannedPlant`], [`PlannedInput`] | a plant as plans see it |
//! | `tracking_cost`: [`TrackingCost`], [`TrackingWeights`] | what it costs to be off a reference |
//! | `flat_motion` | how a plant moves that is on it |
//! | `course`: [`CourseCost`], [`CourseGate`], [`CourseObstacle`] | gates and obstacles |
//! | `problem_file`: [`ProblemFile`], [`CourseProblem`] | problems as TOML, some of them built in |
//! | `mpc`: [`Mpc`], [`MpcSettings`] | model predictive control as a controller |
//! | `linear_mpc`: [`LinearMpc`] | its feedback about hover, with poles and margins |
//! | `planned_indi`: [`PlannedIndi`] | a plan in front of incremental inversion |
//! | `mpc_law`: [`MpcLaw`] | the same as a law, for gradients through closed loops |
//!
//! A pendulum is swung up within its torque:
//!
//! ```
//! # use omnidrones_controllers::omnidrones;
//! use omnidrones::autodiff::{Scalar, System};
//! use omnidrones::controllers::design::ErrorState;
//! use omnidrones::controllers::optimal::*;
//! use std::sync::Arc;
//!
//! struct Pendulum;
//! impl System for Pendulum {
//!     fn n_state(&self) -> usize { 2 }
//!     fn n_input(&self) -> usize { 1 }
//!     fn step<S: Scalar>(&self, x: &[S], u: &[S], _: &[S], next: &mut [S]) {
//!         let dt = S::constant(0.05);
//!         next[1] = x[1] + dt * (u[0] - S::constant(9.81) * x[0].sin_cos().0);
//!         next[0] = x[0] + dt * next[1];
//!     }
//! }
//!
//! struct Up;
//! impl OptimalCost for Up {
//!     fn stage<S: Scalar>(&self, now: StageInput<'_, S>, terms: &mut Terms<S>) {
//!         terms.square(S::constant(0.01), now.input[0]);
//!     }
//!     fn terminal<S: Scalar>(&self, end: StageInput<'_, S>, terms: &mut Terms<S>) {
//!         terms.square(S::constant(1000.0), end.state[0] - S::constant(std::f64::consts::PI));
//!         terms.square(S::constant(100.0), end.state[1]);
//!     }
//! }
//!
//! let model = StageModel::new(&Pendulum, &Up, ErrorState::new(2, &[])?)?.with_curvature(&Pendulum, &Up)?;
//! let mut problem = OptimalProblem::new(Arc::new(model), 80, &[0.0, 0.0])?;
//! problem.set_bounds(&[-5.0], &[5.0])?;
//! let mut search = Ilqr::new(&problem)?;
//! search.start_from_inputs(&problem, &[0.1; 80])?;
//! let report = search.solve(&problem, &IlqrSettings::default(), |_, _| {})?;
//! assert_eq!(report.status, IlqrStatus::Solved);
//! let end = &search.trajectory().states[160..];
//! assert!((end[0] - std::f64::consts::PI).abs() < 0.05 && search.trajectory().inputs.iter().all(|u| u.abs() <= 5.0));
//! # Ok::<(), omnidrones::error::Error>(())
//! ```

#[doc(hidden)]
pub mod cost;
#[doc(hidden)]
pub mod course;
mod flat_motion;
#[doc(hidden)]
pub mod ilqr;
mod interior_point;
#[doc(hidden)]
pub mod linear_mpc;
#[doc(hidden)]
pub mod mpc;
#[doc(hidden)]
pub mod mpc_law;
#[doc(hidden)]
pub mod planned_indi;
#[doc(hidden)]
pub mod planned_plant;
#[doc(hidden)]
pub mod problem;
#[doc(hidden)]
pub mod problem_file;
#[doc(hidden)]
pub mod qp_solver;
#[doc(hidden)]
pub mod real_time;
#[doc(hidden)]
pub mod sensitivity;
mod stage_expansion;
#[doc(hidden)]
pub mod stage_model;
#[doc(hidden)]
pub mod stage_qp;
mod stage_sweeps;
#[doc(hidden)]
pub mod state_bound;
#[doc(hidden)]
pub mod tracking_cost;

pub use cost::{OptimalCost, StageInput, Terms};
pub use course::{CourseCost, CourseGate, CourseObstacle};
pub use ilqr::{Ilqr, IlqrIteration, IlqrReport, IlqrSettings, IlqrStatus};
pub use linear_mpc::LinearMpc;
pub use mpc::{Mpc, MpcSettings, MpcStatistics};
pub use mpc_law::MpcLaw;
pub use planned_indi::PlannedIndi;
pub use planned_plant::{PlannedInput, PlannedPlant};
pub use problem::{OptimalProblem, OptimalTrajectory};
pub use problem_file::{CourseProblem, FirstGuess, ProblemFile};
pub use qp_solver::{QpReport, QpSettings, QpSolver, QpStatus};
pub use real_time::{RealTimeIteration, TickReport};
pub use sensitivity::{SolutionAdjoint, SolutionSensitivity};
pub use stage_model::StageModel;
pub use stage_qp::{SoftBound, StageQp};
pub use state_bound::StateBound;
pub use tracking_cost::{TrackingCost, TrackingWeights};

/// The larger, or what is no number.
fn largest(a: f64, b: f64) -> f64 {
    if b <= a || a.is_nan() { a } else { b }
}
