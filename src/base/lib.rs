//! What every room of omnidrones stands on, and nothing of drones: errors, files, settings in layers, memory that is asked for, threads.
//!
//! | file | what |
//! |---|---|
//! | [`error`] | the one error type |
//! | [`layers`] | settings in tables of TOML, each over those before it |
//! | [`reader`] | types from values, with line and column of mistakes |
//! | [`defaults`] | settings with their defaults beside them |
//! | [`documented`] | what the documentation of a struct says of its fields |
//! | [`file_gate`] | how files are read, and appear whole or not at all |
//! | [`memory`] | what may be asked for |
//! | [`names`] | names in files and cells |
//! | [`parallel`] | the one door to threads |
//!
//! The front of the library is the crate `omnidrones`; of this one it shows `error`, `layers` and `parallel`.

pub mod defaults;
pub mod documented;
pub mod error;
pub mod file_gate;
pub mod layers;
pub mod memory;
pub mod names;
pub mod parallel;
pub mod reader;

/// Examples of the documentation name things as users of `omnidrones` do.
#[doc(hidden)]
pub mod omnidrones {
    pub use crate::{error, layers};
}
