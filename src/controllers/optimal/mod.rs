//! Optimal control on the exact model.

pub mod cost;
pub mod course;
pub mod ilqr;
pub mod mpc;
pub mod planned_indi;
pub mod planned_plant;
pub mod problem;
pub mod problem_file;
mod interior_point;
pub mod qp_solver;
mod stage_expansion;
pub mod real_time;
pub mod stage_model;
mod flat_motion;
pub mod stage_qp;
pub mod tracking_cost;
mod stage_sweeps;

pub use course::{CourseCost, CourseGate, CourseObstacle};
pub use cost::{OptimalCost, StageInput, Terms};
pub use mpc::{Mpc, MpcSettings, MpcStatistics, StateBound};
pub use ilqr::{Ilqr, IlqrIteration, IlqrReport, IlqrSettings, IlqrStatus};
pub use planned_indi::PlannedIndi;
pub use planned_plant::{PlannedInput, PlannedPlant};
pub use problem::{OptimalProblem, OptimalTrajectory};
pub use problem_file::{CourseProblem, FirstGuess, ProblemFile};
pub use qp_solver::{QpReport, QpSettings, QpSolver, QpStatus};
pub use real_time::{RealTimeIteration, TickReport};
pub use stage_model::StageModel;
pub use stage_qp::{SoftBound, StageQp};
pub use tracking_cost::{TrackingCost, TrackingWeights};
