//! Learning: exact parts, known optima, runs that stop and go on.

mod learning;
mod memory;
mod mutated_settings;
mod regulate;
mod rows;
mod training;
mod unlike;
