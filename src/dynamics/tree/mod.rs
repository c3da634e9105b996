//! Articulated systems: bodies in a tree, joints, drives, rotors, over any scalar.
//!
//! | file | what |
//! |---|---|
//! | `parts` | an articulated system as data |
//! | `model` | the same, checked and immutable |
//! | `layout` | where every number stands in state and input |
//! | `parameters` | the physics as one vector, for derivatives and randomisation |
//! | `topology` | what kernels branch on |
//! | `scratch` | memory of one evaluation |
//! | `kinematics` | where every body is and how it moves |
//! | `frames` | the same by quaternions, for observations |
//! | `loads` | rotors, air, disturbance |
//! | `wakes` | wakes of drones on each other and on loads |
//! | `contact_loads` | contact forces |
//! | `drone_vehicle` | a drone of a model as the vehicle that it is alone |
//! | `cable`, `cable_loads` | cables, and what they pull |
//! | `jacobian` | mass matrix and Jacobians of a model alone |
//! | `mobility` | how points give way, for what a step resolves of contacts and joints |
//! | `torque` | damping, springs, limits, drives |
//! | `aba` | accelerations from forces |
//! | `rnea` | forces from accelerations |
//! | `analysis` | energy, momentum, poses, forces |
//! | `step` | RK4 and the semi-implicit step |
//! | `multibody` | model + physics as a [`System`](autodiff::System) |

mod aba;
pub(crate) mod analysis;
mod cable;
mod cable_loads;
mod contact_loads;
mod drone_vehicle;
pub(crate) mod frames;
#[cfg(test)]
pub(crate) mod free_motion;
mod jacobian;
mod kinematics;
pub(crate) mod layout;
mod loads;
mod mobility;
pub(crate) mod model;
pub(crate) mod multibody;
#[doc(hidden)]
pub mod parameters;
mod parts;
pub(crate) mod rnea;
pub(crate) mod scratch;
mod start;
pub(crate) mod step;
pub(crate) mod topology;
mod torque;
mod wakes;

pub use analysis::{
    Momentum, Separation, body_poses, cable_tensions, center_of_mass, contact_forces, frame_jacobian, frame_pose,
    kinetic_energy, mass_matrix, momentum, potential_energy, separations,
};
#[doc(hidden)]
pub use analysis::{body_poses_into, contact_forces_with};
pub use cable::{Cable, CableEnd, ROUND as CABLE_ROUND};
pub use drone_vehicle::carrier;
pub use kinematics::FrameKinematics;
pub use layout::{BodyPlace, Layout, TreePlace};
pub use model::*;
pub use multibody::Multibody;
pub use parameters::{
    CABLE_PARAMETERS, CONTACT_PARAMETERS, LINK_PARAMETERS, model_parameter_domains, model_parameter_names,
    model_parameters,
};
pub use rnea::inverse_dynamics;
pub use start::{check_cables, check_contact, check_start};

#[cfg(test)]
mod tests;
