//! placeholder
pub mod spatial;
pub mod vehicle;
pub use vehicle::*;
