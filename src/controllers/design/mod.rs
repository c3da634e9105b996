//! Design on the differentiable loop: optimal feedback from linearisations, tuning gains by gradients through flights.
//!
//! | file | idea |
//! |---|---|
//! | [`riccati`] | Riccati and Lyapunov equations by doubling |
//! | [`error_state`] | linearisations without the redundancy of quaternions |
//! | [`mod@lqr`] | state feedback of least cost, its poles, weights by Bryson's rule |
//! | [`mod@follow`] | feed-forward along smooth references |
//! | [`gain_sensitivity`] | how the error of one flight depends on each gain |
//! | [`mod@tune`] | gains by descent on flights |

pub mod error_state;
pub mod follow;
pub mod gain_sensitivity;
pub mod lqr;
pub mod riccati;
pub mod tune;

pub use error_state::ErrorState;
pub use follow::{Following, follow};
pub use gain_sensitivity::{GainSensitivity, sensitivity};
pub use lqr::{Regulator, bryson, eigenvalues, lqr, spectral_radius};
pub use tune::{Descent, Evaluation, Iteration, TunePlan, Tuning, tune};
