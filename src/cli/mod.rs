//! What the command line shows on a terminal.

pub mod progress;
pub mod table;
