//! PayloadHover: hold a slung ball at a point while it is pushed.
//!
//! - DIFFERENCE: Δv is clipped at ±3σ; published ones on the upper side alone (defect 22).
//! - DIFFERENCE: starts with q_z < 0.2 m are drawn again; they come with bars above 1.3 m alone.
//! - DIFFERENCE: the bar swings without stops; published ones are at ±120° (see `load`).
//! - DIFFERENCE: a drawn mass takes centre of mass and inertia with it (defect 25).
//! - DIFFERENCE: the ball's share is of the total mass, not of the base link's (defect 5).
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).

use super::load::{LOAD, Load, LoadSettings, Side, hold_loss};
use super::track::calm_pose;
use super::{MotionLoss, PoseReward, StartAttitude, StartRange, less, made_of};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::exponential_kernel;
use crate::settings;
use crate::start::{Draws, Start};
use crate::task::{BuiltIn, Task, TaskReference, View};
use crate::task_spec::Success;
use autodiff::{Array, Mask, Scalar, Trace, TraceMask, safe};
use base::error::Result;
use dynamics::spatial::{Vec3, constants, scale, sub};
use std::f64::consts::PI;

/// Places of the step of the last push and of its kick in the goal.
const PUSH: usize = LOAD;
const KICKED: usize = LOAD + 1;

/// Where starts are.
fn start_range() -> StartRange {
    let position = [[-2.5, 2.5], [-2.5, 2.5], [1.5, 2.5]];
    StartRange { position, attitude: StartAttitude { tilt: 0.1 * PI, ..StartAttitude::default() } }
}

settings! {
    /// Settings of [`PayloadHover`].
    pub(crate) struct PayloadHoverSettings {
        load: LoadSettings = LoadSettings::default() => flat;
        horizon: usize = 500 => ("steps", "T", Any);
        kick: [f64; 3] = [1.0, 1.0, 0.5] => ("m/s, world", "σ of a push", NotNegative);
        calm: f64 = 2.0 => ("s", "mean time between pushes", Positive);
        target: [f64; 3] = [0.0, 0.0, 1.0] => ("m, world", "q_t", Any);
        start: StartRange = start_range() => group;
        min_height: f64 = 0.2 => ("m", "lower is a crash of drone or ball", Any);
        success_distance: f64 = 0.1 => ("m", "position error of a success, at the end of the longest time without a push", Positive);
        arrival: f64 = 2.0 => ("s", "from the start; the way there is no time without a push", NotNegative);
        pose_scale: f64 = 1.6 => ("1/m", "how steeply r_p falls", NotNegative);
        reward: PoseReward = PoseReward { up: 0.5, spin: 0.5, ..PoseReward::default() } => group;
        loss: MotionLoss = MotionLoss::default() => group;
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct PayloadHover {
    load: Load,
    settings: PayloadHoverSettings,
    /// Seconds per step.
    dt: f64,
}

impl BuiltIn for PayloadHover {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: PayloadHoverSettings = config.settings()?;
        Ok(Self { load: Load::pushed(config, &settings.load, Side::Hanging)?, settings, dt: config.dt })
    }
}

impl PayloadHover {
    /// q_t − q.
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(constants(self.settings.target), self.load.ball(view).position)
    }

    /// Steps until the next push: the first that is behind a time of mean `calm`.
    fn wait(&self, draws: &mut Draws<'_>) -> Trace {
        draws.geometric(1.0 / -(-self.dt / self.settings.calm).exp_m1())
    }

    /// Draws the load; no push yet.
    fn draw(&self, start: &mut Start<'_>) {
        self.load.draw(start);
        start.goal.field("push_step", "steps", "k of the last push, −1 before the first").number(-1.0);
        start.goal.field("push_kick", "m/s, world", "Δv of the last push").array([0.0; 3]);
    }
}

impl Task for PayloadHover {
    made_of!(self: self.load.robot, self.settings);

    fn about(&self) -> &'static str {
        "p drone, q ball, u = R e_z, ω angular velocity of the drone (world), e = Σ s effort, k steps, v_q = q̇, ω_b \
         angular velocity of the bar, d = ‖q_t − q‖. Ball {ball_share} of the vehicle's mass, bar {bar_mass} kg. \
         Target: q_t = {target} m. Start: p uniform in {start_position} m, roll and pitch within ±{start_tilt} rad, \
         yaw within {start_yaw} rad, the bar along the drone's −z, at rest. From step 1 on pushes come at random, \
         every {calm} s on average: for that step the world force m_q Δv/dt acts on the ball, a kick of Δv ~ N(0, \
         {kick} m/s). Along the bar the drone takes its share."
    }

    fn start(&self, start: &mut Start<'_>) {
        self.draw(start);
        start.event_at = self.wait(&mut start.task);
        start.again(100, |start| {
            let (position, attitude) = self.settings.start.draw(start);
            self.load.place(start, position, attitude)[2].gt(self.settings.min_height)
        });
    }

    fn event(&self, start: &mut Start<'_>) {
        start.goal[PUSH] = start.event_at;
        for (i, sigma) in self.settings.kick.into_iter().enumerate() {
            start.goal[KICKED + i] = start.task.normal().clamp((-3.0).into(), 3.0.into()) * sigma;
        }
        start.event_at += self.wait(&mut start.task);
    }

    /// Keeps the error of the step that is longest after a push. The arrival from the start is as good as a push.
    fn remember(&self, view: &View, task_state: &mut Writer) {
        let arrival = Trace::constant(self.settings.arrival / self.dt);
        let (quiet, longest) = (view.step - view.goal[PUSH].max(arrival), view.task_state[0]);
        let counts = quiet.lt(longest).not().or(view.step.lt(arrival));
        let error = Trace::select(counts, safe::norm(self.error(view)), view.task_state[1]);
        task_state
            .field("quiet", "steps", "without a push since the arrival, at most so far")
            .number(longest.max(quiet));
        task_state.field("quiet_error", "m", "‖q_t − q‖ at its end; before the arrival of now").number(error);
    }

    fn disturb(&self, view: &View, _: usize) -> [Trace; 9] {
        let now = (view.step - view.goal[PUSH]).abs().lt(Trace::constant(0.5));
        let size = Trace::select(now, view.goal[1] * Trace::constant(1.0 / self.dt), Trace::zero());
        let force = scale(size, view.goal.array::<3>(KICKED));
        let zero = Trace::zero();
        [zero, zero, zero, force[0], force[1], force[2], zero, zero, zero]
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        self.load.observe_lever(view, out);
        out.field("target", "m, world", "q_t − q").array(self.error(view));
        view.observe_drone(0, out);
        self.load.observe_motion(view, out);
        view.observe_clock(out);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let pose = exponential_kernel(self.settings.pose_scale, self.error(view));
        calm_pose(view, pose, &self.settings.reward, "{×reward_pose}r_p, r_p = e^{−{×pose_scale}d}", terms);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let least = self.settings.min_height;
        ends.when("crash", "z < {min_height} m", less(view.drone(0).position[2], least));
        ends.when("ball_crash", "q_z < {min_height} m", less(self.load.ball(view).position[2], least));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("position_error", "m", safe::norm(self.error(view)));
        out.metric("uprightness", "-", view.drone(0).up()[2]);
        out.metric("throttle_difference", "-", view.throttle_difference(0));
        out.metric("quiet_error", "m", view.task_state[1]);
    }

    fn success(&self, view: &View) -> TraceMask {
        less(view.task_state[1], self.settings.success_distance)
    }

    fn success_rule(&self) -> Success {
        Success::below("quiet_error", self.settings.success_distance)
    }

    fn loss(&self, view: &View, loss: &mut Loss) {
        hold_loss(view, &self.settings.loss, self.error(view), &self.load.ball(view), loss);
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        self.load.reference(view, self.settings.target)
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.draw(start);
        self.load.place_upright(start, self.settings.target);
    }
}
