//! The command line as a stranger meets it, through the built binary.

mod adaptation;
mod command;
mod control;
mod export;
mod filters;
mod general;
mod hostile;
mod keeping;
mod learning;
mod logs;
mod promises;
mod reports;
mod robots;
mod study;
mod surroundings;
mod tasks;
mod verdicts;
mod viewing;
