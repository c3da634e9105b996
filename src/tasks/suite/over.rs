//! What the tasks of the over-actuated platform share: the model and its target attitude.

use crate::autodiff::{Rows, Scalar, safe};
use crate::controllers::reference::Tilt;
use crate::dynamics::Vehicle;
use crate::dynamics::configurations::{PER_DEGREE, Platform};
use crate::dynamics::frame::Frame;
use crate::dynamics::spatial::{Quat, Vec3, constants, cross, dot, from_euler, from_matrix, rotate, sub, to_euler};
use crate::dynamics::tree::Model;
use crate::error::{Error, Result};
use crate::tasks::config::EnvConfig;
use crate::tasks::reward::smooth_norm;
use crate::tasks::rig::Rig;
use crate::tasks::sheet::Slice;
use crate::tasks::task::{ANY_YAW, START_TILT, Start, View, Wanted};

/// The frame: the root of the model.
pub const FRAME_BODY: usize = 0;

/// The platform; `damping` of its joints in N m s per **degree**.
///
/// # Errors
/// [`Error::Value`] unless there are 2, 4 or 6 drones.
pub fn platform(vehicle: &Vehicle, n_drone: usize, damping: f64) -> Result<Model> {
    if ![2, 4, 6].contains(&n_drone) {
        return Err(Error::value("task.n_drone", n_drone, "2, 4 or 6", "The benchmark's is 4."));
    }
    let drone = vehicle.clone();
    Ok(Platform { drone, n_drone, damping: damping * PER_DEGREE, ..Platform::default() }.build()?.model)
}

/// The rig of Hover and Track: wakes, nothing to touch.
///
/// # Errors
/// As [`platform`] and [`EnvConfig::vehicle`].
pub fn free_rig(config: &EnvConfig, vehicle: &str, n_drone: usize) -> Result<Rig> {
    let vehicle = config.vehicle(vehicle)?;
    let physics = config.physics_with(|e| e.downwash = true);
    Rig::of_model(&platform(&vehicle, n_drone, 0.002)?, physics, Some(&vehicle), |_| Vec::new())
}

/// What a target attitude keeps in the goal.
pub fn attitude_slices() -> Vec<Slice> {
    vec![Slice::new("target_heading", 3, "-, world", "h_t"), Slice::new("target_up", 3, "-, world", "u_t")]
}

/// Keeps an attitude in the goal.
pub fn set_attitude(start: &mut Start<'_>, attitude: Quat<f64>) {
    start.goal[..3].copy_from_slice(&rotate(attitude, [1.0, 0.0, 0.0]));
    start.goal[3..6].copy_from_slice(&rotate(attitude, [0.0, 0.0, 1.0]));
}

/// Draws a target attitude into the goal: roll and pitch within ±0.2π, any yaw.
pub fn draw_attitude(start: &mut Start<'_>) {
    let r = &mut start.task;
    let (roll, pitch) = (r.uniform(-START_TILT, START_TILT), r.uniform(-START_TILT, START_TILT));
    let yaw = r.uniform(ANY_YAW.0, ANY_YAW.1);
    set_attitude(start, from_euler(roll, pitch, yaw));
}

/// The target attitude, held from the first second on.
pub fn wanted_pose(view: &View<'_, f64>, target: [f64; 3]) -> Wanted {
    let (h, u) = (view.goal.array(0), view.goal.array(3));
    let side = cross(u, h);
    let attitude: [[f64; 3]; 3] = [0, 1, 2].map(|k| [h[k], side[k], u[k]]);
    let [roll, pitch, yaw] = to_euler(from_matrix(attitude));
    let tilt = Tilt { roll, pitch, at: 0.0, ramp: 1.0 };
    Wanted { tilt, ..Wanted::way(&view.frame(FRAME_BODY), target, yaw, 1.0) }
}

/// ((u·u_t + 1)/2)².
#[inline(always)]
pub fn aligned<S: Scalar>(up: Vec3<S>, wanted: Vec3<S>) -> S {
    (S::constant(0.5) * (dot(up, wanted) + S::one())).square()
}

/// (p_t − p, h_t − h, u_t − u).
#[inline(always)]
pub fn pose_error<S: Scalar>(frame: &Frame<S>, target: [f64; 3], goal: &Rows<'_, S>) -> [S; 9] {
    let p = sub(constants(target), frame.position);
    let h = sub(goal.array(0), frame.heading());
    let u = sub(goal.array(3), frame.up());
    [p[0], p[1], p[2], h[0], h[1], h[2], u[0], u[1], u[2]]
}

/// What [`pose_error`] gives, in an observation.
pub fn error_slices() -> Vec<Slice> {
    vec![
        Slice::new("target", 3, "m, world", "p_t − p"),
        Slice::new("heading_error", 3, "-, world", "h_t − h"),
        Slice::new("up_error", 3, "-, world", "u_t − u"),
    ]
}

/// ‖p_t − p‖² of a [`pose_error`].
#[inline(always)]
pub fn squared_distance<S: Scalar>(error: &[S; 9]) -> S {
    safe::squared_norm([error[0], error[1], error[2]])
}

/// A smooth cost of being away from a pose and of moving.
#[inline(always)]
pub fn pose_loss<S: Scalar>(frame: &Frame<S>, e: &[S; 9]) -> S {
    let position = smooth_norm([e[0], e[1], e[2]], 0.1);
    let turn = S::constant(0.3) * safe::squared_norm([e[3], e[4], e[5], e[6], e[7], e[8]]);
    let speed = S::constant(0.02) * safe::squared_norm(frame.velocity);
    position + turn + speed + S::constant(0.005) * safe::squared_norm(frame.angular_velocity)
}
