//! placeholder
pub mod spatial;
pub mod urdf;
pub mod vehicle;
pub use vehicle::*;
