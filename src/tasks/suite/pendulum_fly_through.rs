//! InvPendulumFlyThrough: carry a ball that stands on a bar past two level bars.
//!
//! - DIFFERENCE: r_p = 1/(1 + 1.2 d) is that of the current code; the paper's was e^{−1.2 d}.
//! - DIFFERENCE: c is geometric, of the shapes that push; the published one asks for a contact force.
//! - DIFFERENCE: starts with q_z > 3 m are drawn again; they come with bars above 1 m alone.
//! - DIFFERENCE: a drawn mass takes centre of mass and inertia with it (defect 25).
//! - DIFFERENCE: the ball's share is of the total mass, not of the base link's (defect 5).
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).

use super::load::{BalanceReward, DRAWN_BAR, LoadCourse, LoadCourseSettings, LoadSettings, Side, hold_loss, leaning};
use super::obstacles::{BarsSettings, NEARNESS, free, nearness, touches, where_on};
use super::{MotionLoss, StartAttitude, StartRange, ease_of_flight, less, made_of, more, nearer, succeeds_once, times};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{exponential_kernel, still};
use crate::settings;
use crate::start::Start;
use crate::task::{BuiltIn, Task, View};
use autodiff::{Scalar, Trace, safe};
use base::error::Result;
use dynamics::spatial::{Vec3, constants, sub};
use std::f64::consts::PI;

/// What both fly-through tasks have, with the numbers of this one.
fn course() -> LoadCourseSettings {
    let position = [[-2.2, -1.0], [0.0, 0.0], [1.0, 2.0]];
    LoadCourseSettings {
        load: LoadSettings { length: [0.85, 0.85], bar_mass: DRAWN_BAR, ..LoadSettings::default() },
        bars: BarsSettings { spacing: [0.9, 1.2], ..BarsSettings::default() },
        start: StartRange { position, attitude: StartAttitude { tilt: 0.15 * PI, ..StartAttitude::default() } },
        loss: MotionLoss { velocity: 0.1, ..MotionLoss::default() },
        ..LoadCourseSettings::default()
    }
}

settings! {
    /// Settings of [`InvPendulumFlyThrough`].
    pub(crate) struct InvPendulumFlyThroughSettings {
        course: LoadCourseSettings = course() => flat;
        horizon: usize = 500 => ("steps", "T", Any);
        target: [f64; 3] = [1.5, 0.0, 2.3] => ("m, world", "q_t", Any);
        min_balance: f64 = 0.1 => ("-", "b below which the ball falls", Any);
        ball_max_height: f64 = 3.0 => ("m", "a higher ball ends the episode", Any);
        reward: BalanceReward = BalanceReward::default() => group;
        loss_balance: f64 = 1.0 => ("m", "weight of the lean in the loss", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct InvPendulumFlyThrough {
    course: LoadCourse,
    settings: InvPendulumFlyThroughSettings,
}

impl BuiltIn for InvPendulumFlyThrough {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: InvPendulumFlyThroughSettings = config.settings()?;
        Ok(Self { course: LoadCourse::new(config, &settings.course, Side::Standing)?, settings })
    }
}

impl InvPendulumFlyThrough {
    /// q_t − q.
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(constants(self.settings.target), self.course.load.ball(view).position)
    }
}

impl Task for InvPendulumFlyThrough {
    made_of!(self: self.course.load.robot, self.settings);

    fn about(&self) -> &'static str {
        "p drone, q ball, b = (q − p)_z/L, ω angular velocity of the drone (world), e = Σ s effort, k steps, v_q = \
         q̇, ω_b angular velocity of the bar, d = ‖q_t − q‖, c = 1 while drone, bar or ball touch an obstacle, else \
         0. Ball {ball_share} of the vehicle's mass, bar {bar_mass} kg. Obstacles: two level bars along y at x = 0, z \
         = 1.2 m and {spacing} m above. Target: q_t = {target} m. Start: p uniform in {start_position} m, roll and \
         pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, the bar along the drone's z, at rest. Shapes \
         that touch have the middle of the bar's lengths."
    }

    fn start(&self, start: &mut Start<'_>) {
        self.course.draw(start);
        start.again(100, |start| {
            let ball = self.course.begin(&self.settings.course, start, constants(self.settings.target));
            ball[2].lt(self.settings.ball_max_height)
        });
    }

    fn remember(&self, view: &View, task_state: &mut Writer) {
        LoadCourse::remember(view, nearer(self.error(view), self.settings.course.success_distance), task_state);
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        let position = view.drone(0).position;
        self.course.load.observe_lever(view, out);
        out.field("position", "m, world", "p").array(position);
        view.observe_drone(0, out);
        out.field("target", "m, world", "q_t − q").array(self.error(view));
        self.course.load.observe_motion(view, out);
        self.course.bars.observe(view, position, out);
        view.observe_clock(out);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let (ball, own, w) = (self.course.load.ball(view), &self.settings, &self.settings.reward);
        let free = free(self.course.bars.clearance(view));
        let distance = safe::norm(self.error(view));
        let pose = free * Trace::constant(own.course.pose_scale).mul_add(distance, Trace::one()).recip();
        let formula = "{×reward_pose}(1 − c) r_p, r_p = 1/(1 + {×pose_scale}d)";
        terms.term("pose", formula, w.pose).non_smooth().number(times(w.pose, pose));
        terms.term("balance", "{×reward_balance}(1 − c) r_p b", w.balance).within(-w.balance, w.balance).non_smooth();
        terms.number(times(w.balance, pose) * ball.up()[2]);
        terms.term("spin", "{×reward_spin}(1 − c) r_p/(1 + ω_z²)", w.spin).non_smooth();
        terms.number(times(w.spin, pose) * still(view.drone(0).angular_velocity));
        terms.term("swing", "{×reward_swing}(1 − c) r_p e^{−‖v_q‖}", w.swing).non_smooth();
        terms.number(times(w.swing, pose) * exponential_kernel(1.0, ball.velocity));
        terms.term("effort", "{×reward_effort}(1 − c) e^{−e}", w.effort).non_smooth();
        terms.number(free * ease_of_flight(w.effort, view));
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let (position, ball, own) = (view.drone(0).position, self.course.load.ball(view), &self.settings);
        ends.when("crash", "z < {min_height} m", less(position[2], own.course.min_height));
        ends.when("wide", "|y| > {max_side} m", more(position[1].abs(), own.course.max_side));
        ends.when("fall", "b < {min_balance}", less(ball.up()[2], own.min_balance));
        ends.when("high", "q_z > {ball_max_height} m", more(ball.position[2], own.ball_max_height));
        let contact = where_on::<Trace>(own.course.reset_on_collision, touches(self.course.bars.clearance(view)));
        ends.when("contact", "c = 1, if reset_on_collision", contact);
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        self.course.metrics(view, self.error(view), ("balance", self.course.load.ball(view).up()[2]), out);
    }

    succeeds_once!(self, view: view.task_state[0], self.settings.course.success_distance);

    fn loss(&self, view: &View, loss: &mut Loss) {
        let (ball, own) = (self.course.load.ball(view), &self.settings.course);
        hold_loss(view, &own.loss, self.error(view), &ball, loss);
        loss.add("{×loss_balance}(1 − b)", leaning(self.settings.loss_balance, &ball));
        loss.add(NEARNESS, nearness(own.loss_clearance, self.course.bars.clearance(view)));
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.course.draw(start);
        self.course.load.place_upright(start, self.settings.target);
    }
}
