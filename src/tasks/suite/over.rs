//! What the tasks of the over-actuated platform share: the model and its target attitude.

use super::team::{LoadNames, TeamSettings, mean_throttle_difference, squared_sum};
use super::{PoseLoss, PoseReward, rate_cost, speed_cost, squared, times};
use crate::config::EnvConfig;
use crate::declare::{Loss, Writer};
use crate::reward::{rational_kernel, smooth_norm};
use crate::robot::Robot;
use crate::settings;
use crate::start::{ANY_YAW, START_TILT, Start, StartScalar};
use crate::task::{TaskReference, View};
use crate::task_spec::Smoothness;
use autodiff::{Array, Scalar, Trace, safe};
use base::error::{Error, Result};
use controllers::reference::Tilt;
use dynamics::Vehicle;
use dynamics::configurations::{PER_DEGREE, Platform};
use dynamics::frame::Frame;
use dynamics::spatial::{Quat, Vec3, constants, cross, dot, from_euler, from_matrix, rotate, sub, to_euler};
use dynamics::tree::Model;

/// The frame: the root of the model.
pub(crate) const FRAME_BODY: usize = 0;

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

/// The robot of Hover and Track: wakes, nothing to touch.
///
/// # Errors
/// As [`platform`] and [`EnvConfig::vehicle`].
pub(crate) fn free_robot(config: &EnvConfig, team: &TeamSettings) -> Result<Robot> {
    let vehicle = config.vehicle(&team.vehicle)?;
    let physics = config.physics_with(|e| e.downwash = true);
    Robot::of_model(&platform(&vehicle, team.n_drone, 0.002)?, physics, Some(&vehicle), |_| Vec::new())
}

/// What observations call the frame's attitude and motion.
pub(crate) const FRAME_NAMES: LoadNames =
    ["frame_attitude", "frame_velocity", "frame_angular_velocity", "frame_heading", "frame_up"];

settings! {
    /// A pose to reach.
    pub struct TargetPose {
        position: [f64; 3] = [0.0, 0.0, 2.25] => ("m, world", "p_t", Any);
        tilt: f64 = START_TILT => ("rad", "largest roll and pitch of the target", NotNegative);
        yaw: [f64; 2] = ANY_YAW => ("rad", "yaw of the target, lowest and highest", Ordered);
    }
}

/// Keeps an attitude in the goal.
pub(crate) fn set_attitude<S: StartScalar>(start: &mut Start<'_, S>, attitude: Quat<S>) {
    let axes = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| rotate(attitude, constants(axis)));
    start.goal.field("target_heading", "-, world", "h_t").within(-1.0, 1.0).array(axes[0]);
    start.goal.field("target_up", "-, world", "u_t").within(-1.0, 1.0).array(axes[1]);
}

impl TargetPose {
    /// Draws an attitude into the goal.
    pub fn draw<S: StartScalar>(&self, start: &mut Start<'_, S>) {
        let (r, tilt) = (&mut start.task, self.tilt);
        let (roll, pitch) = (r.uniform(-tilt, tilt), r.uniform(-tilt, tilt));
        let yaw = r.uniform(self.yaw[0], self.yaw[1]);
        set_attitude(start, from_euler(roll, pitch, yaw));
    }

    /// The frame there, level.
    pub fn ideal(&self, start: &mut Start<'_>) {
        let level = [1.0, 0.0, 0.0, 0.0];
        set_attitude(start, constants(level));
        start.place(FRAME_BODY, self.position, level);
    }
}

/// The target attitude, held from the first second on.
pub(crate) fn pose_reference(view: &View<'_, f64>, target: [f64; 3]) -> TaskReference {
    let (h, u) = (view.goal.array(0), view.goal.array(3));
    let side = cross(u, h);
    let attitude: [[f64; 3]; 3] = [0, 1, 2].map(|k| [h[k], side[k], u[k]]);
    let [roll, pitch, yaw] = to_euler(from_matrix(attitude));
    let tilt = Tilt { roll, pitch, at: 0.0, ramp: 1.0 };
    TaskReference { tilt, ..TaskReference::way(&view.frame(FRAME_BODY), target, yaw, 1.0) }
}

/// ((u·u_t + 1)/2)².
pub fn aligned<S: Scalar>(up: Vec3<S>, wanted: Vec3<S>) -> S {
    (S::constant(0.5) * (dot(up, wanted) + S::one())).square()
}

/// (p_t − p, h_t − h, u_t − u).
pub(crate) fn pose_error<S: Scalar>(frame: &Frame<S>, target: [f64; 3], goal: &[S]) -> [S; 9] {
    let p = sub(constants(target), frame.position);
    let h = sub(goal.array(0), frame.heading());
    let u = sub(goal.array(3), frame.up());
    [p[0], p[1], p[2], h[0], h[1], h[2], u[0], u[1], u[2]]
}

/// Writes a [`pose_error`].
pub(crate) fn observe_error(e: &[Trace; 9], out: &mut Writer) {
    out.field("target", "m, world", "p_t − p").array([e[0], e[1], e[2]]);
    out.field("heading_error", "-, world", "h_t − h").within(-2.0, 2.0).array([e[3], e[4], e[5]]);
    out.field("up_error", "-, world", "u_t − u").within(-2.0, 2.0).array([e[6], e[7], e[8]]);
}

/// p_t − p of a [`pose_error`].
pub(crate) fn place_error<S: Scalar>(error: &[S; 9]) -> Vec3<S> {
    [error[0], error[1], error[2]]
}

/// The reward of a pose r_p, aligned with u_t and without spin, whose term is open.
pub(crate) fn pose_reward(
    view: &View,
    (pose, smoothness): (Trace, Smoothness),
    up: Vec3<Trace>,
    w: &PoseReward,
    terms: &mut Writer,
) {
    let frame = view.frame(FRAME_BODY);
    terms.smoothness(smoothness).number(times(w.pose, pose));
    terms.term("up", "{×reward_up}r_p ((u·u_t + 1)/2)²", w.up).smoothness(smoothness);
    terms.number(times(w.up, pose) * aligned(frame.up(), up));
    terms.term("spin", "{×reward_spin}r_p/(1 + (|ω_x| + |ω_y| + |ω_z|)²)", w.spin).piecewise();
    terms.number(times(w.spin, pose) * rational_kernel(1.0, squared_sum(frame.angular_velocity)));
    terms.term("effort", "{×reward_effort}mean e^{−e_i}", w.effort).number(times(w.effort, view.mean_effort_reward()));
}

/// Figures of a pose.
pub(crate) fn pose_metrics(view: &View, error: &[Trace; 9], out: &mut Writer) {
    let distance = safe::sqrt(safe::squared_norm(place_error(error)), safe::SQUARED_NORM_FLOOR);
    out.metric("position_error", "m", distance);
    out.metric("heading_alignment", "-", heading_alignment(view));
    out.metric("up_alignment", "-", up_alignment(view));
}

/// h·h_t of a target in the goal.
pub(crate) fn heading_alignment<S: Scalar>(view: &View<'_, S>) -> S {
    dot(view.frame(FRAME_BODY).heading(), view.goal.array(0))
}

/// u·u_t of a target in the goal.
pub(crate) fn up_alignment<S: Scalar>(view: &View<'_, S>) -> S {
    dot(view.frame(FRAME_BODY).up(), view.goal.array(3))
}

/// Δs, the last figure.
pub(crate) fn throttle_metric(view: &View, out: &mut Writer) {
    out.metric("throttle_difference", "-", mean_throttle_difference(view));
}

/// A smooth cost of being away from a pose and of moving.
pub(crate) fn pose_loss(frame: &Frame<Trace>, e: &[Trace; 9], w: &PoseLoss, loss: &mut Loss) {
    loss.add("√(‖p_t − p‖² + {loss_radius}²)", smooth_norm(place_error(e), w.motion.radius));
    let axes = [e[3], e[4], e[5], e[6], e[7], e[8]];
    loss.add("{×loss_turn}(‖h_t − h‖² + ‖u_t − u‖²)", squared(w.turn, axes));
    loss.add("{×loss_velocity}h₅(v)", speed_cost(w.motion.velocity, frame.velocity));
    loss.add("{×loss_rate}h₁₀(ω)", rate_cost(w.motion.rate, frame.angular_velocity));
}
