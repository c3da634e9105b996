//! Certificates of articulated systems: their accelerations, against other engines and against themselves.
//!
//! Each bound stands beside the value that was measured when it was written. Loops run over the registries and the
//! models of `models`, so a new vehicle or configuration is covered on arrival.

mod accelerations;
mod common;
mod inverse;
pub mod models;
mod one_body;
