//! Commands: flights, allocation, failures, optimal feedback, tuning.

mod allocation;
mod failure;
mod flight;
mod flight_log;
mod lqr;
mod over_actuated;
mod six_axis;
mod tuning;
mod tuning_through_allocation;
