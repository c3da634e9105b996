//! Hover: fly to a point and hold it, with a heading.
//!
//! - DIFFERENCE: starts with d > 4 are drawn again; published ones reach 4.18 and end at once (defect 26).
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).
//! - DIFFERENCE: the default vehicle is the Hummingbird; the published one's is the Firefly (`vehicle = "firefly"`).
//! - DIFFERENCE: total mass everywhere; the published hover throttle counts the base link alone (defect 5).

use super::{
    PoseLoss, PoseReward, PoseSuccess, StartRange, drive_loss, ease_of_flight, farther, less, made_of, rate_cost,
    speed_cost, squared, succeeds_within, times,
};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{both, rational_kernel, smooth_norm, still, upright};
use crate::robot::Robot;
use crate::settings;
use crate::start::{ANY_YAW, Start};
use crate::task::{BuiltIn, Task, TaskReference, View};
use autodiff::{Array, Mask, Scalar, Trace, safe};
use base::error::Result;
use dynamics::spatial::{Vec3, constants, dot, rotate, sub, yawed};

settings! {
    /// Settings of [`Hover`].
    pub(crate) struct HoverSettings {
        vehicle: String = "hummingbird".into() => ("", "what flies", Any);
        horizon: usize = 500 => ("steps", "T", Any);
        target: [f64; 3] = [0.0, 0.0, 2.0] => ("m, world", "p_t", Any);
        start: StartRange = StartRange::default() => group;
        min_height: f64 = 0.2 => ("m", "lower is a crash", Any);
        max_distance: f64 = 4.0 => ("-", "largest d", Positive);
        success: PoseSuccess = PoseSuccess::default() => group;
        pose_scale: f64 = 1.2 => ("1/m", "how steeply r_p falls", NotNegative);
        reward: PoseReward = PoseReward::default() => group;
        loss: PoseLoss = PoseLoss::default() => group;
        loss_up: f64 = 0.0 => ("m", "weight of the squared error of u in the loss", NotNegative);
        loss_drives: f64 = 0.01 => ("m s²/rad²", "weight of the rates of drives in the loss", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Hover {
    robot: Robot,
    settings: HoverSettings,
}

impl BuiltIn for Hover {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: HoverSettings = config.settings()?;
        Ok(Self { robot: config.single_robot(&settings.vehicle)?, settings })
    }
}

/// Keeps h_t.
pub(super) fn set_heading(start: &mut Start<'_>, heading: Vec3<impl Into<Trace>>) {
    start.goal.field("target_heading", "-, world", "h_t").within(-1.0, 1.0).array(heading);
}

impl Hover {
    /// p_t − p.
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(constants(self.settings.target), view.drone(0).position)
    }

    /// h_t − h.
    fn heading_error<S: Scalar>(view: &View<'_, S>) -> Vec3<S> {
        sub(view.goal.array(0), view.drone(0).heading())
    }
}

impl Task for Hover {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p drone, v, ω velocity and angular velocity (world), h = R e_x heading, u = R e_z, e = Σ s effort, k steps. \
         Target: p_t = {target} m, heading h_t at any yaw. Start: p uniform in {start_position} m, roll and pitch \
         within ±{start_tilt} rad, yaw within {start_yaw} rad, at rest, d ≤ {max_distance}. d = ‖(p_t − p, h_t − \
         h)‖."
    }

    fn start(&self, start: &mut Start<'_>) {
        let own = &self.settings;
        let heading = yawed(start.task.uniform(ANY_YAW[0], ANY_YAW[1]));
        set_heading(start, heading);
        start.again(100, |start| {
            let (position, attitude) = own.start.draw(start);
            start.place(0, position, attitude);
            let h = rotate(attitude, constants([1.0, 0.0, 0.0]));
            farther(both(sub(constants(own.target), position), sub(heading, h)), own.max_distance).not()
        });
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("target", "m, world", "p_t − p").array(self.error(view));
        view.observe_drone(0, out);
        out.field("heading_error", "-, world", "h_t − h").within(-2.0, 2.0).array(Self::heading_error(view));
        view.observe_clock(out);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let (drone, own, w) = (view.drone(0), &self.settings, &self.settings.reward);
        let pose =
            rational_kernel(own.pose_scale, safe::squared_norm(both(self.error(view), Self::heading_error(view))));
        terms.term("pose", "{×reward_pose}r_p, r_p = 1/(1 + ({×pose_scale}d)²)", w.pose).number(times(w.pose, pose));
        terms.term("up", "{×reward_up}r_p ((u_z + 1)/2)²", w.up).number(times(w.up, pose) * upright(drone.up()));
        terms.term("spin", "{×reward_spin}r_p/(1 + ω_z²)", w.spin);
        terms.number(times(w.spin, pose) * still(drone.angular_velocity));
        terms.term("effort", "{×reward_effort}e^{−e}", w.effort).number(ease_of_flight(w.effort, view));
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        ends.when("crash", "z < {min_height} m", less(view.drone(0).position[2], self.settings.min_height));
        let error = both(self.error(view), Self::heading_error(view));
        ends.when("far", "d > {max_distance}", farther(error, self.settings.max_distance));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        let drone = view.drone(0);
        out.metric("position_error", "m", safe::norm(self.error(view)));
        out.metric("heading_alignment", "-", dot(drone.heading(), view.goal.array::<3>(0)));
        out.metric("uprightness", "-", drone.up()[2]);
        out.metric("throttle_difference", "-", view.throttle_difference(0));
    }

    succeeds_within!(
        self, view: self.error(view), self.settings.success.distance,
        "heading_alignment": dot(view.drone(0).heading(), view.goal.array::<3>(0)), self.settings.success.alignment,
        "uprightness": view.drone(0).up()[2], self.settings.success.alignment
    );

    fn loss(&self, view: &View, loss: &mut Loss) {
        let (drone, w) = (view.drone(0), &self.settings.loss);
        loss.add("√(‖p_t − p‖² + {loss_radius}²)", smooth_norm(self.error(view), w.motion.radius));
        loss.add("{×loss_velocity}h₅(v)", speed_cost(w.motion.velocity, drone.velocity));
        loss.add("{×loss_rate}h₁₀(ω)", rate_cost(w.motion.rate, drone.angular_velocity));
        loss.add("{×loss_turn}‖h_t − h‖²", squared(w.turn, Self::heading_error(view)));
        if self.settings.loss_up > 0.0 {
            let lean = sub(constants([0.0, 0.0, 1.0]), drone.up());
            loss.add("{×loss_up}‖e_z − u‖²", squared(self.settings.loss_up, lean));
        }
        drive_loss(self.settings.loss_drives, view, loss);
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        let yaw = view.goal[1].atan2(view.goal[0]);
        Some(TaskReference::way(&view.drone(0), self.settings.target, yaw, 0.7))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        set_heading(start, [1.0, 0.0, 0.0]);
        start.place(0, self.settings.target, [1.0, 0.0, 0.0, 0.0]);
    }
}
