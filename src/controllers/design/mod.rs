//! Design on the differentiable loop: optimal feedback from linearisations, tuning gains by gradients through flights.
//!
//! | file | idea |
//! |---|---|
//! | [`riccati`] | Riccati and Lyapunov equations by doubling |
//! | `error_state`: [`ErrorState`] | linearisations without the redundancy of quaternions |
//! | `estimated_loop`: [`LoopModel::with_estimator`] | the same loop with an estimator between sensors and controller |
//! | `gain_evaluation` | how tuned gains fare where they were not tuned |
//! | `loop_model`: [`LoopModel`], [`AnalysisPoint`] | the linear model of a loop that is flown, its margins at any point |
//! | `loop_noise`: [`MeasurementNoise`], [`LoopDeviations`] | what noise of sensors does to such a loop, by the Lyapunov equation and as flown |
//! | `margin_constraint` | such a gate while gains are tuned |
//! | `margin_gate`: [`MarginGate`], [`Corner`] | what a controller has to bear: margins in winds, on plants not as believed |
//! | `lqr`: [`lqr()`], [`FiniteHorizon`] | state feedback of least cost, with integrators or over a finite time, weights by Bryson's rule |
//! | `feed_forward`: [`FeedForward`], [`feed_forward()`] | feed-forward along smooth references |
//! | `flight_grid`: [`FlightGrid`], [`GridCell`] | circles on a grid of acceleration and speed, half to tune on, half to judge on |
//! | `gain_sensitivity`: [`GainSensitivity`], [`gain_sensitivity()`] | how the error of one flight depends on each gain |
//! | `robustness`: [`Robustness`], [`robustness()`] | a box of plants: the share of stable ones, the least margin in it |
//! | `stability`: [`Stability`] | whether a loop settles, grows, or neither |
//! | `trim`: [`Trim`], [`trim()`] | steady flights: hover, forward flight, turns, spins |
//! | `tune_plan`, `mod@tune` | what gains are tuned on; gains by descent on flights |
//! | `tune_law`: [`tune_law()`], [`LawTuning`] | the same of a law that is data |
//! | `tuned_loop` | those flights: the loop over ln K, starts, plants |

#[doc(hidden)]
pub mod error_state;
mod estimated_loop;
#[doc(hidden)]
pub mod feed_forward;
#[doc(hidden)]
pub mod flight_grid;
mod gain_evaluation;
#[doc(hidden)]
pub mod gain_sensitivity;
#[doc(hidden)]
pub mod loop_model;
mod loop_noise;
#[doc(hidden)]
pub mod lqr;
mod margin_constraint;
#[doc(hidden)]
pub mod margin_gate;
pub mod riccati;
#[doc(hidden)]
pub mod robustness;
mod stability;
#[doc(hidden)]
pub mod trim;
#[doc(hidden)]
pub mod tune;
mod tune_law;
mod tune_plan;
mod tuned_loop;

pub use error_state::ErrorState;
pub use feed_forward::{FeedForward, feed_forward};
pub use flight_grid::{FlightGrid, GridCell};
pub use gain_sensitivity::{GainSensitivity, gain_sensitivity};
pub use loop_model::{AnalysisPoint, LoopMargins, LoopModel};
pub use loop_noise::{LoopDeviations, MeasurementNoise, NoiseFlight, flown_deviations};
pub use lqr::{FiniteHorizon, Regulator, bryson, finite_horizon, lqi, lqi_of, lqr, lqr_of};
#[doc(hidden)]
pub use margin_gate::truth;
pub use margin_gate::{Corner, MarginFailure, MarginGate, MarginReport};
pub use robustness::{PlantMargin, PlantUncertainty, Robustness, robustness};
pub use stability::Stability;
pub use trim::{Trim, TrimTarget, trim, trim_damaged, trim_from, trim_spin};
pub use tune::{AlongReference, Descent, GainEvaluation, Iteration, TunePlan, Tuning, tune};
pub use tune_law::{LawTuning, tune_law};
