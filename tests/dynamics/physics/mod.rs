//! Physics certificates: what the multirotor model promises, one property per file.
//!
//! Each bound stands beside the value that was measured when it was written. A guard has a twin with the defect
//! switched on, which must fail. Loops run over `vehicles::all()`, so a new vehicle is covered on arrival. Only the
//! public door is used: `Multirotor`, its `step`, `derivative` and `drag_wrench`.

mod closed_forms;
pub mod common;
mod conservation;
mod convergence;
mod dissipation;
mod golden;
mod gyroscopic;
mod hover;
mod motor;
mod signs;
mod symmetry;
mod witness;
