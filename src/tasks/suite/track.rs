//! Track: follow a lemniscate.
//!
//! - DIFFERENCE: truncates at T; published code one step before (defect 27).
//! - DIFFERENCE: no wind of eight sines, which is off in the published defaults; `randomise` has a constant one per episode:
//!   `{ what = "wind", range = [-1.0, 1.0], by = "set" }`.
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).
//! - DIFFERENCE: `position_error` is positive; the published tracking error is its negative (defect 27).

use super::{
    MotionLoss, PathSuccess, PoseReward, StartAttitude, drive_loss, ease_of_flight, less, made_of, rate_cost,
    speed_cost, succeeds_within, times,
};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{exponential_kernel, rational_kernel, smooth_norm, still};
use crate::robot::Robot;
use crate::settings;
use crate::start::Start;
use crate::task::{BuiltIn, Task, TaskReference, View};
use crate::track_path::{Follow, TrackPath, about_path};
use autodiff::{Scalar, Trace, safe};
use base::error::Result;
use dynamics::spatial::{Vec3, sub};

settings! {
    /// Settings of [`Track`].
    pub(crate) struct TrackSettings {
        vehicle: String = "hummingbird".into() => ("", "what flies", Any);
        horizon: usize = 600 => ("steps", "T", Any);
        follow: Follow = Follow::default() => flat;
        start: StartAttitude = StartAttitude::default() => group;
        min_height: f64 = 0.1 => ("m", "lower is a crash", Any);
        success: PathSuccess = PathSuccess::default() => group;
        pose_scale: f64 = 1.6 => ("1/m", "how steeply r_p falls", NotNegative);
        reward: PoseReward = PoseReward { up: 0.5, spin: 0.5, ..PoseReward::default() } => group;
        loss: MotionLoss = MotionLoss::default() => group;
        loss_drives: f64 = 0.01 => ("m s²/rad²", "weight of the rates of drives in the loss", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Track {
    robot: Robot,
    settings: TrackSettings,
    path: TrackPath,
}

impl BuiltIn for Track {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: TrackSettings = config.settings()?;
        let path = TrackPath::new(&settings.follow, config.dt);
        Ok(Self { robot: config.single_robot(&settings.vehicle)?, settings, path })
    }
}

impl Track {
    /// p_ref(k) − p.
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(self.path.at(view.goal, view.step), view.drone(0).position)
    }
}

impl Task for Track {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        concat!(
            "p drone, v, ω velocity and angular velocity (world), u = R e_z, e = Σ s effort, k steps, ",
            about_path!(),
            ". Start: on the path, roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, at rest. d = \
             ‖p_ref(k) − p‖."
        )
    }

    fn start(&self, start: &mut Start<'_>) {
        let position = self.path.draw(start);
        let attitude = self.settings.start.draw(start);
        start.place(0, position, attitude);
        self.path.join(start, 0, Some(Trace::zero()));
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        self.path.observe_ahead(view, view.drone(0).position, out);
        view.observe_drone(0, out);
        view.observe_clock(out);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let (own, w) = (&self.settings, &self.settings.reward);
        let pose = exponential_kernel(own.pose_scale, self.error(view));
        calm_pose(view, pose, w, "{×reward_pose}r_p, r_p = e^{−{×pose_scale}d}", terms);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        ends.when("crash", "z < {min_height} m", less(view.drone(0).position[2], self.settings.min_height));
        ends.when("far", "d > {reset_distance} m", self.path.far(view.goal, self.error(view)));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("position_error", "m", safe::norm(self.error(view)));
        out.metric("uprightness", "-", view.drone(0).up()[2]);
        out.metric("throttle_difference", "-", view.throttle_difference(0));
    }

    succeeds_within!(self, view: self.error(view), self.settings.success.distance; held self.settings.success.time);

    fn loss(&self, view: &View, loss: &mut Loss) {
        let (drone, w) = (view.drone(0), &self.settings.loss);
        let slip = sub(self.path.velocity(view.goal, view.step), drone.velocity);
        loss.add("√(d² + {loss_radius}²)", smooth_norm(self.error(view), w.radius));
        loss.add("{×loss_velocity}h₅(ṗ_ref − v)", speed_cost(w.velocity, slip));
        loss.add("{×loss_rate}h₁₀(ω)", rate_cost(w.rate, drone.angular_velocity));
        drive_loss(self.settings.loss_drives, view, loss);
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        Some(self.path.lead(view, &view.drone(0)))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let position = self.path.draw(start);
        start.place(0, position, [1.0, 0.0, 0.0, 0.0]);
    }
}

/// The reward of a pose r_p that has a tip, upright and without spin.
pub(super) fn calm_pose(view: &View, pose: Trace, w: &PoseReward, formula: &'static str, terms: &mut Writer) {
    let drone = view.drone(0);
    terms.term("pose", formula, w.pose).piecewise().number(times(w.pose, pose));
    terms.term("up", "{×reward_up}r_p/(1 + (1 − u_z)²)", w.up).piecewise();
    terms.number(times(w.up, pose) * rational_kernel(1.0, (Trace::one() - drone.up()[2]).square()));
    terms.term("spin", "{×reward_spin}r_p/(1 + ω_z²)", w.spin).piecewise();
    terms.number(times(w.spin, pose) * still(drone.angular_velocity));
    terms.term("effort", "{×reward_effort}e^{−e}", w.effort).number(ease_of_flight(w.effort, view));
}
