//! The `omnidrones` command line.

#[allow(dead_code, reason = "the commands that print tables and progress follow")]
mod cli;

fn main() {}
