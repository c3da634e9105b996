//! placeholder
pub mod aero;
pub mod batch;
pub mod integrate;
pub mod multirotor;
pub mod rigid;
pub mod spatial;
pub mod vehicle;
pub use batch::World;
pub use integrate::Integrator;
pub use multirotor::{Multirotor, Physics};
pub use rigid::{Disturbance, Effects, RigidModel, RigidState};
pub use vehicle::*;
