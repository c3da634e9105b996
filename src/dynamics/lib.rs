//! Bodies: vehicles as data, models for kernels, forces, integrators, batches.
//!
//! | file | what |
//! |---|---|
//! | `vehicle` | a multirotor as plain data: parts, rotors, drag, gains |
//! | [`vehicles`] | the built-in ones, one file each |
//! | `vehicle_file` | vehicles as TOML |
//! | `hover`: [`HoverTrim`] | attitude and thrusts at which force and moment vanish |
//! | `authority` | what a vehicle's rotors can do: rank, weakest direction, axes that do not turn apart |
//! | `plausibility`: [`VehicleWarning`] | what of a vehicle's numbers is probably not meant |
//! | `gains` | gains derived from inertia and motor lag |
//! | `rotor` | one rotor: command, lag, wrench, and the table of its numbers |
//! | `domain`: [`Domain`] | what a physical number may be |
//! | `rigid`: [`Disturbance`], [`Effects`] | the rigid multirotor's equations, over any scalar |
//! | `integrate`: [`Integrator`] | RK4 and the semi-implicit step |
//! | `multirotor`: [`Multirotor`], [`Physics`] | vehicle + physics as a [`System`](autodiff::System) |
//! | `plant`: [`Plant`], [`Quantity`] | such a vehicle or an articulated system, behind one type |
//! | `frame`: [`Frame`] | where a body is and how it moves |
//! | `fleet`: [`Fleet`], [`Downwash`] | several multirotors in each other's downwash, as one system |
//! | [`tree`] | articulated systems: bodies in a tree, joints, drives, rotors |
//! | [`assembly`] | vehicles and primitives joined into such a system |
//! | [`configurations`] | the built-in ones, one file each |
//! | [`contact`] | compliant contact with friction; distances between shapes |
//! | [`aero`] | ground effect, downwash, wind |
//! | `batch`: [`Breach`], [`StopReason`] | many environments in lanes |
//! | [`shape`] | spheres, capsules and boxes: volume, inertia, pose |
//! | `uneven_ground`: [`UnevenGround`], [`GroundWave`] | uneven ground: a slope with waves on it |
//! | `mesh`: [`Mesh`] | triangle meshes and height fields, which are only seen |
//! | [`scene`] | ground, gates and obstacles; distance to them |
//! | [`sensors`] | what vehicles sense: parts with their errors, and rays at a scene |
//! | `spatial` | vectors and quaternions over any scalar |

pub mod aero;
pub mod assembly;
#[doc(hidden)]
pub mod authority;
#[doc(hidden)]
pub mod batch;
pub mod configurations;
pub mod contact;
#[doc(hidden)]
pub mod domain;
#[doc(hidden)]
pub mod fleet;
#[doc(hidden)]
pub mod frame;
#[doc(hidden)]
pub mod gains;
#[doc(hidden)]
pub mod hover;
#[doc(hidden)]
pub mod integrate;
pub(crate) mod mesh;
#[doc(hidden)]
pub mod multirotor;
#[doc(hidden)]
pub mod plant;
pub(crate) mod plausibility;
#[doc(hidden)]
pub mod rigid;
#[doc(hidden)]
pub mod rotor;
pub mod scene;
pub mod sensors;
pub mod shape;
#[doc(hidden)]
pub mod spatial;
pub mod tree;
#[doc(hidden)]
pub mod uneven_ground;
pub mod urdf;
#[doc(hidden)]
pub mod vehicle;
pub(crate) mod vehicle_file;
pub mod vehicles;

pub use batch::{Breach, StopReason, Stopped, World};
pub use domain::Domain;
pub use fleet::{Downwash, Fleet};
pub use frame::Frame;
pub use hover::HoverTrim;
pub use integrate::Integrator;
pub use mesh::Mesh;
pub use multirotor::{Multirotor, Physics};
pub use plant::{Plant, Quantity};
pub use plausibility::VehicleWarning;
pub use rigid::{Disturbance, Effects, RigidModel, RigidState};
pub use uneven_ground::{GroundWave, UnevenGround};
pub use vehicle::*;

/// Examples of the documentation name things as users of `omnidrones` do.
#[doc(hidden)]
pub mod omnidrones {
    pub use crate as dynamics;
    pub use {autodiff, base::error, rng};
}
