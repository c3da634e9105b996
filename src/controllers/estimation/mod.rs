//! Estimation: from what sensors read to a state, with how well it is known.
//!
//! | file | idea |
//! |---|---|
//! | `kalman`: [`KalmanFilter`], [`steady_kalman()`], [`lqg()`] | linear systems: LQE by the Riccati equation, covariances that go along, LQG |
//! | `noise`: [`BiasProcess`] | what a filter believes of the errors of a sensor |
//! | `navigation_state`: [`NavigationState`], [`predict()`] | an inertial unit: state, errors, one sample further |
//! | `aiding`: [`Aid`], [`correct()`] | what other sensors tell, and how the state takes it in |
//! | `sensor_filter`: [`SensorFilter`] | from settings of sensors to such a filter |
//! | `state_estimator`: [`StateEstimator`] | the filter as it runs on board, with readings that come late |
//! | `innovations`: [`InnovationRecord`] | which readings are none, which disagree, which are believed again |
//! | `state_estimator_batch`: [`StateEstimatorBatch`] | many filters of the same sensors, in lanes |
//! | `complementary`: [`ComplementaryFilter`] | a filter with fixed gains, over any scalar |
//! | `hover_kalman`: [`HoverKalman`] | the steady filter about hover, driven by commands: LQG in flight |
//! | `fix` | what sensors tell of a body's own motion, as filters with fixed gains take it in |
//! | `estimator`: [`Estimator`], [`EstimatorSettings`], [`ESTIMATORS`] | all kinds, one row each |
//! | `estimated_state`: [`EstimatedState`] | the state that a controller is given in place of the truth |

mod aiding;
mod complementary;
mod estimated_state;
mod estimator;
mod fix;
mod hover_kalman;
mod innovations;
mod kalman;
mod navigation_state;
mod noise;
mod sensor_filter;
mod state_estimator;
mod state_estimator_batch;
#[cfg(test)]
mod tests;

pub use aiding::{Agreement, Aid, AidKind, correct};
pub use complementary::{ComplementaryFilter, ComplementarySettings, ComplementaryState};
pub use estimated_state::{EstimateTally, EstimatedState};
pub use estimator::{ESTIMATORS, Estimator, EstimatorEntry, EstimatorSettings};
pub use hover_kalman::{HoverKalman, HoverKalmanSettings};
pub use innovations::InnovationRecord;
pub use kalman::{Innovation, KalmanFilter, SteadyKalman, lqg, steady_kalman};
pub use navigation_state::{ERRORS, InertialNoise, NAVIGATION, NavigationState, predict};
pub use noise::BiasProcess;
pub(crate) use noise::white_variance;
pub use sensor_filter::{ScheduledAid, SensorFilter, SensorSchedule};
pub use state_estimator::{StateEstimator, StateEstimatorSettings};
pub use state_estimator_batch::StateEstimatorBatch;
