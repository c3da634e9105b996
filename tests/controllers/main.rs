//! Commands: flights, allocation, failures, optimal feedback, tuning.

mod allocation;
mod closed_loop;
mod confidence;
mod endless;
mod failure;
mod flight;
mod flight_log;
#[path = "../common/geometry.rs"]
#[allow(dead_code)]
mod geometry;
mod hostile_plans;
mod hover;
mod indi;
mod integral;
mod linear;
mod loop_model;
mod lqr;
mod mishaps;
mod over_actuated;
mod recovery;
mod references;
mod robustness;
mod sensors;
mod six_axis;
mod structure;
mod tilting;
mod trim;
mod tuning;
mod tuning_through_allocation;
