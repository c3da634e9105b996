//! Laws that articulated systems obey over time, for every built-in configuration.
//!
//! | module | claim |
//! |---|---|
//! | `drift` | what nothing pushes keeps its energy and momenta; quaternions stay of unit length |
//! | `power` | energy changes by the work of rotors, drag, damping and contact |
//! | `convergence` | orders of the integrators, error of a trajectory |
//! | `servos` | drives lag as told, are stable at any step and gain, and keep their bounds |
//! | `symmetry` | no place, heading, speed or hand is special |
//! | `contact` | bodies bounce without gain, rest, and push back as hard as they are pushed |
//!
//! `PHYSICS_PRINT=1 cargo test --test dynamics multibody -- --nocapture` prints what was measured.

pub mod common;
mod contact;
mod convergence;
mod drift;
mod power;
mod servos;
mod symmetry;
