//! Optimal control on the exact model.

pub mod cost;
pub mod ilqr;
pub mod problem;
pub mod projected_newton;
mod stage_expansion;
pub mod stage_model;
pub mod stage_qp;
mod stage_sweeps;

pub use cost::{OptimalCost, StageInput, Terms};
pub use ilqr::{Ilqr, IlqrIteration, IlqrReport, IlqrSettings, IlqrStatus};
pub use problem::{OptimalProblem, OptimalTrajectory};
pub use projected_newton::{QpReport, QpSettings, QpSolver, QpStatus};
pub use stage_model::StageModel;
pub use stage_qp::{SoftBound, StageQp};
