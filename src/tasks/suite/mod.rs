//! The benchmark tasks, one file each; `load`, `team`, `over`, `transport` and `obstacles` hold what several share.
//!
//! - DIFFERENCE: metrics are those of the step; published ones are running means from 0, mostly 0.8 old + 0.2 new.

pub mod dragon_hover;
pub mod fly_through;
pub mod formation;
pub mod hover;
pub mod load;
mod obstacles;
pub mod over;
pub mod over_fly_through;
pub mod over_hover;
pub mod over_track;
pub mod payload_fly_through;
pub mod payload_hover;
pub mod payload_track;
pub mod pendulum_fly_through;
pub mod pendulum_hover;
pub mod pendulum_track;
pub mod team;
pub mod track;
pub mod transport;
pub mod transport_fly_through;
pub mod transport_hover;
pub mod transport_track;
pub mod variants;

#[cfg(test)]
mod tests_multi;

#[cfg(test)]
mod tests_single;

use super::rig::DronePlace;
use super::sheet::{Slice, Smoothness};
use crate::autodiff::Scalar;

/// What [`View::observe_drone`](super::View::observe_drone) writes.
pub fn drone_slices(drone: &DronePlace) -> Vec<Slice> {
    let mut slices = vec![
        Slice::new("attitude", 4, "-, body → world", "unit quaternion, w ≥ 0").but(Smoothness::NonSmooth),
        Slice::new("velocity", 3, "m/s, world", "v"),
        Slice::new("angular_velocity", 3, "rad/s, world", "ω"),
        Slice::new("heading", 3, "-, world", "h = R e_x"),
        Slice::new("up", 3, "-, world", "u = R e_z"),
        Slice::new("throttle", drone.rotors.len(), "-", "2s − 1, s = Ω/Ω_max"),
    ];
    if !drone.drives.is_empty() {
        slices.push(Slice::new("drive_angle", drone.drives.len(), "rad", "of its drives"));
        slices.push(Slice::new("drive_rate", drone.drives.len(), "rad/s", "of its drives"));
    }
    slices
}

/// What [`View::observe_clock`](super::View::observe_clock) writes.
pub fn clock_slice() -> Slice {
    Slice::new("clock", 4, "-", "k/T, four times")
}

/// A flag of a memo that stays 1 once the mask held.
#[inline(always)]
pub(crate) fn latch<S: Scalar>(flag: S, now: S::Mask) -> S {
    S::select(now, S::one(), flag)
}
