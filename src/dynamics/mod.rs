//! placeholder
pub mod aero;
pub mod gains;
pub mod spatial;
pub mod vehicle;
pub mod vehicle_file;
pub mod vehicles;
pub use vehicle::*;
