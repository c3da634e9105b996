//! Commands: what a multirotor is asked to do, from a trajectory down to the thrust of each rotor.
//!
//! | file | idea |
//! |---|---|
//! | `kinematics`: [`Kinematics`] | the state a controller sees |
//! | `hover_axes`: [`HoverAxes`] | the axes in which a vehicle hovers level |
//! | [`mod@reference`] | hover, step, circle, lemniscate, waypoints, sampled curves, with exact derivatives up to snap |
//! | `parameters`: [`BodyModel`], [`CommandLimits`] | gains, body and limits as scalars, so that they can be traced, dual or per lane |
//! | `position` | position error → velocity command |
//! | `velocity`: [`VelocityCommand`] | velocity command → thrust, attitude, and feed-forward rates by differential flatness |
//! | `attitude`: [`AttitudeCommand`], [`Orientation`] | attitude command → rate command |
//! | `rate`: [`RateCommand`] | rate command → moments |
//! | [`allocation`] | thrust and moments → rotor thrusts, by pseudo-inverse of the true geometry, yaw last |
//! | `six_axis`: [`SixAxis`] | force and attitude independent of each other: pose → wrench |
//! | `nominal_body` | a body under its rotors as a controller believes it to move |
//! | `integral` | integral action: what the believed body misses, learnt and taken off |
//! | `action`: [`ActionScale`] | the paper's action modes, bounded |
//! | `cascade`: [`Cascade`], [`CascadeMemory`] | all levels together, each at its own rate, entered at any of them |
//! | `controller`: [`Controller`], [`Measurement`] | what a controller is: a measurement and a target in, commands out |
//! | `law`: [`ControlLaw`], [`LawController`] | straight-line controllers, over any scalar |
//! | `written_law`: [`WrittenLaw`], [`RecordedLaw`] | laws that are data: recorded once, computed over any scalar |
//! | [`linear`] | linear systems: state space, responses, margins |
//! | `cascade_law`: [`CascadeLaw`] | the cascade as such a law |
//! | [`registry`] | which controller flies what |
//! | `closed_loop`: [`ClosedLoop`], [`ExogenousInputs`] | a plant under a controller: latency, disturbances, injections, failures |
//! | `clocked_step` | the recorded step of a loop, compiled for each thing its clock says |
//! | `confidence`: [`Proportion`], [`Quantile`] | exact bounds of shares and quantiles |
//! | `monte_carlo`: [`MonteCarlo`], [`MonteCarloDraw`] | one loop over thousands of randomised plants |
//! | `monte_carlo_plan`: [`MonteCarloPlan`], [`MonteCarloRun`] | the same by a plan: which numbers vary, and how far |
//! | `recovery`: [`RecoveryCell`], [`RecoveryMap`] | from which starts a controller comes back, with confidence |
//! | `start`: [`start_on()`] | where flights and drops begin |
//! | `fault_tolerant`: [`FaultTolerant`] | the cascade that flies on with the rotors that are left, yaw sacrificed first |
//! | `flight`: [`Flight`], [`FlightPlan`] | a whole flight along a reference, logged |
//! | `formation`: [`FormationController`], [`FormationLaw`] | drones that hold their places and carry something together |
//! | `locked_joints`: [`LockedJoints`] | servos held at rest, flown as one rigid vehicle |
//! | `vectored`: [`Vectored`], [`vectored()`] | thrusters that tilt: pose and shape of Omav, Dragon and their like |
//! | `chain_shape`: [`ChainShape`], [`ChainRamp`] | the shape of a chain |
//! | `indi`: [`IndiLaw`] | flatness over incremental inversion of the dynamics, at the limits of the rotors |
//! | `filter`: [`DigitalFilter`], [`FilterSettings`] | low-passes and notches, and rows of them |
//! | `hover_feedback`: [`HoverFeedback`], [`HoverWeights`] | LQR and LQI of one rigid vehicle about hover |
//! | `state_feedback`: [`Lqr`], [`LqrWeights`] | optimal feedback for a drone with swinging loads |
//! | `gimballed` | a drone on a cardan joint that pushes its carrier with a wanted force |
//! | `platform_controller`: [`PlatformController`] | a frame under such drones, steered in six axes |
//! | `transport_controller`: [`TransportController`], [`TiltLimits`] | a load under drones on bars, its own pose tracked |
//! | `collision_parts` | what counts of what flies for the ground and for obstacles: shapes and rotor discs |
//! | `flight_check`: [`FlightCheck`], [`Mishap`] | what fails a flight however small its errors are: the ground, a load that turned over |
//! | [`design`] | Riccati equations, optimal feedback, tuning |
//! | [`optimal`] | trajectories of least cost, model predictive control |
//!
//! At equal rates the four levels compose to the geometric law of Lee, Leok and McClamroch (2010), term by term:
//! F = m(a_ref + K_p e_p + K_v e_v + g e_z), M = −K_R e_R − K_ω e_ω + ω×Jω − J(ω̂RᵀR_dω_d − RᵀR_dω̇_d).
//! Every kernel is branch-free over [`Scalar`](autodiff::Scalar).

// Kernels are index loops: iterators and slice copies cost lanes their speed.
#![allow(clippy::needless_range_loop, clippy::manual_memcpy)]

#[doc(hidden)]
pub mod action;
pub mod allocation;
#[doc(hidden)]
pub mod attitude;
#[doc(hidden)]
pub mod cascade;
pub(crate) mod cascade_law;
#[doc(hidden)]
pub mod chain_shape;
pub(crate) mod clocked_step;
#[doc(hidden)]
pub mod closed_loop;
pub(crate) mod collision_parts;
#[doc(hidden)]
pub mod confidence;
#[doc(hidden)]
pub mod controller;
#[doc(hidden)]
pub mod controller_batch;
pub mod design;
pub mod estimation;
#[doc(hidden)]
pub mod fault_tolerant;
#[doc(hidden)]
pub mod filter;
#[doc(hidden)]
pub mod flight;
#[doc(hidden)]
pub mod flight_check;
#[doc(hidden)]
pub mod formation;
pub(crate) mod gimballed;
#[doc(hidden)]
pub mod hover_axes;
#[doc(hidden)]
pub mod hover_feedback;
pub(crate) mod incremental;
#[doc(hidden)]
pub mod indi;
pub(crate) mod integral;
#[doc(hidden)]
pub mod kinematics;
#[doc(hidden)]
pub mod law;
pub mod linear;
pub(crate) mod load_flatness;
#[doc(hidden)]
pub mod locked_joints;
#[doc(hidden)]
pub mod monte_carlo;
#[doc(hidden)]
pub mod monte_carlo_plan;
pub(crate) mod nominal_body;
pub mod optimal;
#[doc(hidden)]
pub mod parameters;
mod period;
#[doc(hidden)]
pub mod platform_controller;
#[doc(hidden)]
pub mod position;
#[doc(hidden)]
pub mod rate;
#[doc(hidden)]
pub mod recovery;
pub mod reference;
pub mod registry;
#[doc(hidden)]
pub mod six_axis;
#[doc(hidden)]
pub mod start;
#[doc(hidden)]
pub mod state_feedback;
#[doc(hidden)]
pub mod transport_controller;
#[doc(hidden)]
pub mod vectored;
#[doc(hidden)]
pub mod velocity;
#[doc(hidden)]
pub mod written_law;

pub use action::ActionScale;
pub use allocation::{Assessment, Authority, Axis, Capability, FailureTable, Mixer, RotorFailure};
pub use attitude::{AttitudeCommand, Orientation};
pub use cascade::{Cascade, CascadeMemory, CascadeModel, Level, RateDivisors, Rates};
pub use cascade_law::CascadeLaw;
pub use chain_shape::{ChainRamp, ChainShape};
pub use closed_loop::{ClosedLoop, ExogenousInputs};
pub use confidence::{Proportion, Quantile, clopper_pearson};
pub use controller::{Controller, Measurement, Note, Passive, Target};
pub use controller_batch::ControllerBatch;
pub use fault_tolerant::FaultTolerant;
pub use filter::{DigitalFilter, FilterFile, FilterSettings, MAX_FILTERS};
pub use flight::{Flight, FlightEstimates, FlightPlan, SmoothPoint, fly, fly_from, fly_vehicle, fly_while};
pub use flight_check::{FlightCheck, Mishap, check_flight};
pub use formation::{FormationController, FormationLaw};
pub use hover_axes::HoverAxes;
pub use hover_feedback::{HoverFeedback, HoverWeights};
pub use indi::IndiLaw;
pub use kinematics::Kinematics;
pub use law::{ControlLaw, LawController, LawInput};
pub use load_flatness::LoadFlatness;
pub use locked_joints::LockedJoints;
pub use monte_carlo::{MonteCarlo, MonteCarloDraw, MonteCarloResult, MonteCarloSummary};
pub use monte_carlo_plan::{MonteCarloPlan, MonteCarloRun};
pub use parameters::{BodyModel, CommandLimits, ForceLimits, GainSet};
pub use platform_controller::PlatformController;
pub use rate::RateCommand;
pub use recovery::{RecoveryCell, RecoveryMap, RecoveryPlan, recovery_map};
pub use reference::{Curve, Reference, Setpoint, Tilt, Trajectory};
pub use registry::{Setup, default_controller};
pub use six_axis::SixAxis;
pub use start::start_on;
pub use state_feedback::{Lqr, LqrWeights};
pub use transport_controller::{TiltLimits, TransportController};
pub use vectored::{Vectored, vectored};
pub use velocity::VelocityCommand;
pub use written_law::{LawDescription, RecordedLaw, WrittenLaw};

/// Examples of the documentation name things as users of `omnidrones` do.
#[doc(hidden)]
pub mod omnidrones {
    pub use crate as controllers;
    pub use {autodiff, base::error, dynamics};
}
