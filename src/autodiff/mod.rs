//! placeholder
pub mod dual;
pub(crate) mod lanes;
pub mod safe;
pub mod scalar;
pub use lanes::lane_width;
pub use scalar::{Mask, Scalar};
pub mod program;
pub mod trace;
pub use program::Program;
pub use trace::{Recording, Trace};
pub mod system;
pub use system::{Objective, System};
