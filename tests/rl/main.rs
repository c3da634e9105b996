//! Learning: exact parts, known optima, runs that stop and go on.

mod algorithms;
mod learning;
mod memory;
mod mutated_settings;
mod networks;
mod recipes;
mod regulate;
mod rows;
mod schedules;
mod shards;
mod tensors;
mod training;
mod unlike;
