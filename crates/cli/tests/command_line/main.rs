//! The command line as a stranger meets it, through the built binary.

mod command;
mod control;
mod general;
mod hostile;
mod learning;
mod promises;
mod robots;
mod tasks;
mod viewing;
