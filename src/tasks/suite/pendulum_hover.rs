//! InvPendulumHover: balance a ball on a bar at a point.
//!
//! - DIFFERENCE: the bar is as long as configured; the published one is always 1 m (defect 23).
//! - DIFFERENCE: starts with d > 3.3 m are drawn again; they come with bars of 1.7 m or more alone.
//! - DIFFERENCE: a drawn mass takes centre of mass and inertia with it (defect 25).
//! - DIFFERENCE: the ball's share is of the total mass, not of the base link's (defect 5).
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).

use super::load::{BalanceReward, DRAWN_BAR, LOAD, Load, LoadSettings, Side, hold_loss, leaning};
use super::{
    MotionLoss, StartAttitude, StartRange, ease_of_flight, eased, less, made_of, nearer, succeeds_within, times,
};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{exponential_kernel, still};
use crate::settings;
use crate::start::Start;
use crate::task::{BuiltIn, Task, TaskReference, View};
use autodiff::{Scalar, safe};
use base::error::Result;
use dynamics::spatial::{Vec3, constants, sub};
use std::f64::consts::PI;

/// Place of the distance in the goal beyond which the episode ends.
const FAR: usize = LOAD;

/// Where starts are.
fn start_range() -> StartRange {
    let position = [[-1.5, 1.5], [-1.5, 1.5], [1.0, 2.0]];
    StartRange { position, attitude: StartAttitude { tilt: 0.15 * PI, ..StartAttitude::default() } }
}

settings! {
    /// Settings of [`InvPendulumHover`].
    pub(crate) struct InvPendulumHoverSettings {
        load: LoadSettings = LoadSettings { bar_mass: DRAWN_BAR, ..LoadSettings::default() } => flat;
        horizon: usize = 500 => ("steps", "T", Any);
        target: [f64; 3] = [0.0, 0.0, 2.5] => ("m, world", "q_t", Any);
        start: StartRange = start_range() => group;
        min_height: f64 = 0.2 => ("m", "lower is a crash", Any);
        min_balance: f64 = 0.2 => ("-", "b below which the ball falls", Any);
        max_distance: f64 = 3.3 => ("m", "largest distance of the ball", Positive);
        max_distance_ease: f64 = 1.0 => ("-", "factor of the largest distance at difficulty 0", Positive);
        success_distance: f64 = 0.1 => ("m", "position error of a success", Positive);
        pose_scale: f64 = 1.2 => ("1/m", "how steeply the term pose falls", NotNegative);
        reward: BalanceReward = BalanceReward::default() => group;
        loss: MotionLoss = MotionLoss { velocity: 0.1, ..MotionLoss::default() } => group;
        loss_balance: f64 = 1.0 => ("m", "weight of the lean in the loss", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct InvPendulumHover {
    load: Load,
    settings: InvPendulumHoverSettings,
}

impl BuiltIn for InvPendulumHover {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: InvPendulumHoverSettings = config.settings()?;
        Ok(Self { load: Load::new(config, &settings.load, Side::Standing)?, settings })
    }
}

impl InvPendulumHover {
    /// q_t − q.
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(constants(self.settings.target), self.load.ball(view).position)
    }

    /// Draws the load; how far the ball may go follows it in the goal.
    fn draw(&self, start: &mut Start<'_>) {
        self.load.draw(start);
        let own = &self.settings;
        let far = eased(own.max_distance_ease, start.difficulty) * own.max_distance;
        start.goal.field("max_distance", "m", "beyond which the episode ends").number(far);
    }
}

impl Task for InvPendulumHover {
    made_of!(self: self.load.robot, self.settings);

    fn about(&self) -> &'static str {
        "p drone, q ball, b = (q − p)_z/L, ω angular velocity of the drone (world), e = Σ s effort, k steps, v_q = \
         q̇, ω_b angular velocity of the bar, d = ‖q_t − q‖. Ball {ball_share} of the vehicle's mass, bar {bar_mass} \
         kg. Target: q_t = {target} m. Start: p uniform in {start_position} m, roll and pitch within ±{start_tilt} \
         rad, yaw within {start_yaw} rad, the bar along the drone's z, at rest."
    }

    fn start(&self, start: &mut Start<'_>) {
        self.draw(start);
        let own = &self.settings;
        start.again(100, |start| {
            let (position, attitude) = own.start.draw(start);
            let ball = self.load.place(start, position, attitude);
            nearer(sub(constants(own.target), ball), own.max_distance)
        });
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        self.load.observe_lever(view, out);
        out.field("position", "m, world", "p").array(view.drone(0).position);
        view.observe_drone(0, out);
        out.field("target", "m, world", "q_t − q").array(self.error(view));
        self.load.observe_motion(view, out);
        view.observe_clock(out);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let (ball, own, w) = (self.load.ball(view), &self.settings, &self.settings.reward);
        let balance = ball.up()[2];
        terms.term("balance", "{×reward_balance}b", w.balance).within(-w.balance, w.balance);
        terms.number(times(w.balance, balance));
        terms.term("pose", "{×reward_pose}e^{−{×pose_scale}d}", w.pose).piecewise();
        terms.number(times(w.pose, exponential_kernel(own.pose_scale, self.error(view))));
        terms.term("spin", "{×reward_spin}b/(1 + ω_z²)", w.spin).within(-w.spin, w.spin);
        terms.number(times(w.spin, balance) * still(view.drone(0).angular_velocity));
        terms.term("swing", "{×reward_swing}b e^{−‖v_q‖}", w.swing).within(-w.swing, w.swing).piecewise();
        terms.number(times(w.swing, balance) * exponential_kernel(1.0, ball.velocity));
        terms.term("effort", "{×reward_effort}e^{−e}", w.effort).number(ease_of_flight(w.effort, view));
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let own = &self.settings;
        ends.when("crash", "z < {min_height} m", less(view.drone(0).position[2], own.min_height));
        ends.when("fall", "b < {min_balance}", less(self.load.ball(view).up()[2], own.min_balance));
        let far = view.goal[FAR].square().lt(safe::squared_norm(self.error(view)));
        ends.when("far", "d > {max_distance} m", far);
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("position_error", "m", safe::norm(self.error(view)));
        out.metric("balance", "-", self.load.ball(view).up()[2]);
        out.metric("throttle_difference", "-", view.throttle_difference(0));
    }

    succeeds_within!(self, view: self.error(view), self.settings.success_distance);

    fn loss(&self, view: &View, loss: &mut Loss) {
        let ball = self.load.ball(view);
        hold_loss(view, &self.settings.loss, self.error(view), &ball, loss);
        loss.add("{×loss_balance}(1 − b)", leaning(self.settings.loss_balance, &ball));
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        self.load.reference(view, self.settings.target)
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.draw(start);
        self.load.place_upright(start, self.settings.target);
    }
}
