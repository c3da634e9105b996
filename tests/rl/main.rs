//! Learning: exact parts, known optima, runs that stop and go on.

mod learning;
mod regulate;
mod training;
