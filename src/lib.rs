//! placeholder
pub(crate) mod atomic_file;
pub mod autodiff;
pub mod dynamics;
pub mod error;
pub mod flight;
#[cfg(feature = "plot")]
pub mod plot;
