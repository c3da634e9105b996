//! PayloadFlyThrough: swing a slung ball past two level bars.
//!
//! - DIFFERENCE: observes p − q; the published code p − q_t under that name (defect 18).
//! - DIFFERENCE: c is geometric, of the shapes that push; the published one asks for a contact force.
//! - DIFFERENCE: starts with q_z < 0.15 m are drawn again; they come with bars above 1.35 m alone.
//! - DIFFERENCE: the bar swings without stops; published ones are at ±120° (see `load`).
//! - DIFFERENCE: a drawn mass takes centre of mass and inertia with it (defect 25).
//! - DIFFERENCE: the ball's share is of the total mass, not of the base link's (defect 5).
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).

use super::load::{LOAD, LoadCourse, LoadCourseSettings, Side, hold_loss};
use super::obstacles::{BARS, NEARNESS, free, nearness, touches, where_on};
use super::{PoseReward, StartRange, ease_of_flight, less, made_of, more, nearer, succeeds_once, times};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{exponential_kernel, rational_kernel, still, upright};
use crate::settings;
use crate::start::Start;
use crate::task::{BuiltIn, Task, View};
use autodiff::{Array, Scalar, Trace, safe};
use base::error::Result;
use dynamics::spatial::{Vec3, sub};

/// Place of q_t in the goal.
const TARGET: usize = LOAD + BARS;

/// What both fly-through tasks have, with the numbers of this one.
fn course() -> LoadCourseSettings {
    let position = [[-2.5, -1.0], [0.0, 0.0], [1.5, 2.0]];
    LoadCourseSettings { start: StartRange { position, ..StartRange::default() }, ..LoadCourseSettings::default() }
}

settings! {
    /// Settings of [`PayloadFlyThrough`].
    pub(crate) struct PayloadFlyThroughSettings {
        course: LoadCourseSettings = course() => flat;
        horizon: usize = 500 => ("steps", "T", Any);
        target: [[f64; 2]; 2] = [[1.3, 1.5], [1.0, 1.5]]
            => ("m, world", "q_t along x and z, lowest and highest", Ordered);
        max_height: f64 = 2.5 => ("m", "higher ends the episode", Any);
        ball_min_height: f64 = 0.15 => ("m", "lower is a crash of the ball", Any);
        reward: PoseReward = PoseReward { spin: 0.5, ..PoseReward::default() } => group;
        reward_swing: f64 = 0.5 => ("-", "weight of the term swing", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct PayloadFlyThrough {
    course: LoadCourse,
    settings: PayloadFlyThroughSettings,
}

impl BuiltIn for PayloadFlyThrough {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: PayloadFlyThroughSettings = config.settings()?;
        Ok(Self { course: LoadCourse::new(config, &settings.course, Side::Hanging)?, settings })
    }
}

impl PayloadFlyThrough {
    /// q_t − q.
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(view.goal.array(TARGET), self.course.load.ball(view).position)
    }

    /// Draws load, obstacles and target; returns q_t.
    fn draw(&self, start: &mut Start<'_>) -> Vec3<Trace> {
        self.course.draw(start);
        let [x, z] = self.settings.target.map(|[low, high]| start.task.uniform(low, high));
        let target = [x, Trace::zero(), z];
        start.goal.field("target", "m, world", "q_t").array(target);
        target
    }
}

impl Task for PayloadFlyThrough {
    made_of!(self: self.course.load.robot, self.settings);

    fn about(&self) -> &'static str {
        "p drone, q ball, u = R e_z, ω angular velocity of the drone (world), e = Σ s effort, k steps, v_q = q̇, ω_b \
         angular velocity of the bar, d = ‖q_t − q‖, c = 1 while drone, bar or ball touch an obstacle, else 0. Ball \
         {ball_share} of the vehicle's mass, bar {bar_mass} kg. Obstacles: two level bars along y at x = 0, z = 1.2 m \
         and {spacing} m above. Target: q_t uniform in {target} m along x and z, y = 0. Start: p uniform in \
         {start_position} m, roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, the bar along the \
         drone's −z, at rest. Shapes that touch have the middle of the bar's lengths."
    }

    fn start(&self, start: &mut Start<'_>) {
        let target = self.draw(start);
        start.again(100, |start| {
            self.course.begin(&self.settings.course, start, target)[2].gt(self.settings.ball_min_height)
        });
    }

    fn remember(&self, view: &View, task_state: &mut Writer) {
        LoadCourse::remember(view, nearer(self.error(view), self.settings.course.success_distance), task_state);
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        self.course.load.observe_lever(view, out);
        view.observe_drone(0, out);
        out.field("target", "m, world", "q_t − q").array(self.error(view));
        self.course.load.observe_motion(view, out);
        self.course.bars.observe(view, view.drone(0).position, out);
        view.observe_clock(out);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let (drone, own, w) = (view.drone(0), &self.settings, &self.settings.reward);
        let free = free(self.course.bars.clearance(view));
        let pose = free * rational_kernel(own.course.pose_scale, safe::squared_norm(self.error(view)));
        let formula = "{×reward_pose}(1 − c) r_p, r_p = 1/(1 + ({×pose_scale}d)²)";
        terms.term("pose", formula, w.pose).non_smooth().number(times(w.pose, pose));
        terms.term("up", "{×reward_up}(1 − c) r_p ((u_z + 1)/2)²", w.up).non_smooth();
        terms.number(times(w.up, pose) * upright(drone.up()));
        terms.term("spin", "{×reward_spin}(1 − c) r_p/(1 + ω_z²)", w.spin).non_smooth();
        terms.number(times(w.spin, pose) * still(drone.angular_velocity));
        terms.term("swing", "{×reward_swing}(1 − c) r_p e^{−‖v_q‖}", own.reward_swing).non_smooth();
        terms.number(times(own.reward_swing, pose) * exponential_kernel(1.0, self.course.load.ball(view).velocity));
        terms.term("effort", "{×reward_effort}(1 − c) e^{−e}", w.effort).non_smooth();
        terms.number(free * ease_of_flight(w.effort, view));
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let (position, own, course) = (view.drone(0).position, &self.settings, &self.settings.course);
        ends.when("crash", "z < {min_height} m", less(position[2], course.min_height));
        ends.when("high", "z > {max_height} m", more(position[2], own.max_height));
        ends.when("wide", "|y| > {max_side} m", more(position[1].abs(), course.max_side));
        let low = less(self.course.load.ball(view).position[2], own.ball_min_height);
        ends.when("ball_crash", "q_z < {ball_min_height} m", low);
        let contact = where_on::<Trace>(course.reset_on_collision, touches(self.course.bars.clearance(view)));
        ends.when("contact", "c = 1, if reset_on_collision", contact);
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        self.course.metrics(view, self.error(view), ("uprightness", view.drone(0).up()[2]), out);
    }

    succeeds_once!(self, view: view.task_state[0], self.settings.course.success_distance);

    fn loss(&self, view: &View, loss: &mut Loss) {
        let own = &self.settings.course;
        hold_loss(view, &own.loss, self.error(view), &self.course.load.ball(view), loss);
        loss.add(NEARNESS, nearness(own.loss_clearance, self.course.bars.clearance(view)));
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let target = self.draw(start);
        self.course.load.place_upright(start, target);
    }
}
