//! placeholder
pub mod jet;
pub mod safe;
pub mod scalar;
pub use scalar::{Mask, Scalar};
