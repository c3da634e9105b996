//! Linear systems: what remains of a plant or a loop near one condition, and what control engineers ask of it.
//!
//! | file | idea |
//! |---|---|
//! | `state_space`: [`StateSpace`], [`Signal`] | x' = A x + B u, y = C x + D u with named signals; connections |
//! | `sampling`: [`Hold`] | hold equivalents, Tustin's substitution and its inverse |
//! | `modes`: [`modes()`], [`Mode`] | poles, zeros, damping, time constants, who takes part |
//! | `structure`: [`HiddenModes`], [`minimal()`] | what inputs do not reach and outputs do not show; minimal realisations |
//! | `response`: [`FrequencyResponse`], [`StepFigures`] | over frequency and over time; figures of a step |
//! | `margins`: [`Margins`], [`margins()`] | gain, phase and delay margins of one loop |
//! | `norms`: [`PeakGain`], [`h_infinity()`] | peaks over frequency (H∞), energy of the impulse response (H₂) |
//! | `disk`: [`DiskMargin`], [`disk_margin()`] | disk margins, of one loop and of several at once |
//! | `swept` | one system at many frequencies |
//! | `dense`: [`eigenvalues()`], [`spectral_radius()`] | eigenvalues and singular values, from faer |

pub(crate) mod dense;
#[doc(hidden)]
pub mod disk;
#[doc(hidden)]
pub mod margins;
#[doc(hidden)]
pub mod modes;
#[doc(hidden)]
pub mod norms;
#[doc(hidden)]
pub mod response;
#[doc(hidden)]
pub mod sampling;
#[doc(hidden)]
pub mod state_space;
#[doc(hidden)]
pub mod structure;
pub(crate) mod swept;

pub use dense::{eigenvalues, spectral_radius};
pub use disk::{DiskMargin, disk_margin, multiloop_disk_margin};
pub use margins::{Crossing, Margins, complementary, margins};
pub use modes::{Mode, modes, poles, root_locus, zeros};
pub use norms::{PeakGain, h_infinity, h2_norm};
pub use response::{
    FrequencyResponse, StepFigures, frequencies, frequency_response, simulate, step_figures, step_response, unwrapped,
};
pub use sampling::Hold;
pub use state_space::{Signal, StateSpace};
pub use structure::{HiddenModes, NO_COUPLING, ON_CIRCLE, minimal, unobservable, unreachable};
