//! PayloadHover: hold a slung ball at a point while it is pushed.
//!
//! | Observation | size | unit | meaning | |
//! |---|---|---|---|---|
//! | `drone_from_ball` | 3 | m, world | p − q | smooth |
//! | `target` | 3 | m, world | q_t − q | smooth |
//! | `attitude` | 4 | -, body → world | unit quaternion, w ≥ 0 | non-smooth |
//! | `velocity` | 3 | m/s, world | v | smooth |
//! | `angular_velocity` | 3 | rad/s, world | ω | smooth |
//! | `heading` | 3 | -, world | h = R e_x | smooth |
//! | `up` | 3 | -, world | u = R e_z | smooth |
//! | `throttle` | 4 | - | 2s − 1, s = Ω/Ω_max | smooth |
//! | `ball_velocity` | 3 | m/s, world | v_q = q̇ | smooth |
//! | `bar_angular_velocity` | 3 | rad/s, world | ω_b | smooth |
//! | `clock` | 4 | - | k/T, four times | smooth |
//! | *total* | 36 | | | |
//!
//! | Reward | term | at most | |
//! |---|---|---|---|
//! | `pose` | r_p = e^{−1.6 d} | 1 | piecewise |
//! | `up` | 0.5 r_p/(1 + (1 − u_z)²) | 0.5 | piecewise |
//! | `spin` | 0.5 r_p/(1 + ω_z²) | 0.5 | piecewise |
//! | `effort` | 0.1 e^{−e} | 0.1 | smooth |
//! | *sum* | | 2.1 | |
//!
//! | Episode end | when |
//! |---|---|
//! | `crash` | z < 0.2 m |
//! | `ball_crash` | q_z < 0.2 m |
//! | `diverged` | a number of the state leaves ±1e8 |
//! | *truncated* | k ≥ `horizon` |
//!
//! | Configuration | default | meaning |
//! |---|---|---|
//! | `vehicle` | "hummingbird" | what flies |
//! | `horizon` | 500 | T, steps |
//! | `length` | [1.0, 1.0] | L, lowest and highest, m; drawn once per environment |
//! | `ball_share` | [0.2, 0.3] | m_q over the vehicle's mass, lowest and highest |
//! | `kick` | [1.0, 1.0, 0.5] | σ of a push, m/s |
//!
//! p drone, q ball, m_q its mass, u = R e_z, ω angular velocity of the drone (world), e = Σ s effort, k steps, v_q = q̇, ω_b
//! angular velocity of the bar, d = ‖q_t − q‖. Ball 0.2 to 0.3 of the vehicle's mass, bar 1 g. Target: q_t = (0, 0, 1) m.
//! Start: p uniform in ±2.5 × ±2.5 × [1.5, 2.5] m, roll and pitch within ±0.1π, any yaw, the bar along the drone's −z, at
//! rest. From step 1 on a push comes with probability 1 − e^{−dt/2} per step: for that step the world force m_q Δv/dt acts on
//! the ball, a kick of Δv ~ N(0, (1, 1, 0.5) m/s). Along the bar the drone takes its share.
//!
//! - Success: `position_error` < 0.1 m.
//! - Loss: √(d² + 0.1²) + 0.02 ‖v_q‖² + 0.005 ‖ω‖².
//!
//! - DIFFERENCE: Δv is clipped at ±3σ; published ones on the upper side alone (defect 22).
//! - DIFFERENCE: starts with q_z < 0.2 m are drawn again; they come with bars above 1.3 m alone.
//! - DIFFERENCE: the bar swings without stops; published ones are at ±120° (see [`load`](crate::tasks::suite::load)).
//! - DIFFERENCE: a drawn mass takes centre of mass and inertia with it (defect 25).
//! - DIFFERENCE: the ball's share is of the total mass, not of the base link's (defect 5).
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).

use crate::autodiff::{Pen, Scalar, safe};
use crate::dynamics::spatial::{constants, scale, sub};
use crate::error::{Result, finite};
use crate::rng::Stream;
use crate::tasks::config::EnvConfig;
use crate::tasks::reward::smooth_norm;
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{End, Metric, Setting, Sheet, Slice};
use crate::tasks::suite::load::{
    LIGHT_BAR, LOAD, Load, LoadSettings, Plan, Side, carry_reward, carry_terms, load_settings,
};
use crate::tasks::suite::{clock_slice, drone_slices};
use crate::tasks::task::{ANY_YAW, Ends, Start, Task, View, Wanted};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// q_t, m, world.
const TARGET: [f64; 3] = [0.0, 0.0, 1.0];
/// Lowest drone and ball, m.
const LOW: f64 = 0.2;
/// Mean time between pushes, s.
const CALM: f64 = 2.0;
/// Places of the step of the last push and of its kick in the goal.
const PUSH: usize = LOAD;
const KICKED: usize = LOAD + 1;

/// Settings of [`PayloadHover`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PayloadHoverSettings {
    /// What flies.
    pub vehicle: String,
    /// T, steps.
    pub horizon: usize,
    /// Of the bar, lowest and highest, m.
    pub length: [f64; 2],
    /// Mass of the ball as a share of the vehicle's, lowest and highest.
    pub ball_share: [f64; 2],
    /// σ of a push, world, m/s.
    pub kick: [f64; 3],
}

impl Default for PayloadHoverSettings {
    fn default() -> Self {
        let LoadSettings { vehicle, horizon, length, ball_share } = LoadSettings::default();
        Self { vehicle, horizon, length, ball_share, kick: [1.0, 1.0, 0.5] }
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

impl PayloadHover {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`] and [`EnvConfig::vehicle`]; [`Error::Value`](crate::error::Error::Value) for a length that
    /// is none.
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let settings: PayloadHoverSettings = config.settings()?;
        finite("task.kick", &settings.kick)?;
        let (vehicle, length, ball) = (settings.vehicle.as_str(), settings.length, settings.ball_share);
        let load = Load::pushed(config, &Plan { vehicle, side: Side::Hanging, length, ball, bar: LIGHT_BAR })?;
        Ok(Self { load, settings, dt: config.dt })
    }

    /// q_t − q.
    #[inline(always)]
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> [S; 3] {
        sub(constants(TARGET), self.load.ball(view).position)
    }

    /// Steps until the next push, 1 or more: geometric.
    fn wait(&self, stream: &mut Stream) -> f64 {
        1.0 + (-(1.0 - stream.unit()).ln() * CALM / self.dt).floor()
    }
}

impl Task for PayloadHover {
    fn rig(&self) -> &Rig {
        &self.load.rig
    }

    fn horizon(&self) -> usize {
        self.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let mut observation = vec![Load::lever_slice(), Slice::new("target", 3, "m, world", "q_t − q")];
        observation.extend(drone_slices(self.rig().drone()));
        observation.extend(Load::motion_slices());
        observation.push(clock_slice());
        let mut goal = Load::slices();
        goal.push(Slice::new("push_step", 1, "steps", "k of the last push, −1 before the first"));
        goal.push(Slice::new("push_kick", 3, "m/s, world", "Δv of the last push"));
        Sheet {
            observation,
            central: Vec::new(),
            reward: carry_terms(),
            ends: vec![End::new("crash", "z < 0.2 m"), End::new("ball_crash", "q_z < 0.2 m")],
            metrics: vec![
                Metric { name: "position_error", unit: "m" },
                Metric { name: "uprightness", unit: "-" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal,
            memo: Vec::new(),
            settings: {
                let mut settings = load_settings(500, "[1.0, 1.0]");
                settings.push(Setting::new("kick", "[1.0, 1.0, 0.5]", "σ of a push, m/s").not_negative());
                settings
            },
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        self.load.draw(start);
        start.goal[PUSH] = -1.0;
        start.event_at = self.wait(&mut start.task);
        for _ in 0..100 {
            let position = start.position([-2.5, -2.5, 1.5], [2.5, 2.5, 2.5]);
            let attitude = start.attitude(0.1 * PI, ANY_YAW);
            if self.load.place(start, position, attitude)[2] > LOW {
                break;
            }
        }
    }

    fn event(&self, start: &mut Start<'_>) {
        start.goal[PUSH] = start.event_at;
        for (i, sigma) in self.settings.kick.into_iter().enumerate() {
            start.goal[KICKED + i] = sigma * start.task.normal().clamp(-3.0, 3.0);
        }
        start.event_at += self.wait(&mut start.task);
    }

    #[inline(always)]
    fn disturb<S: Scalar>(&self, view: &View<'_, S>, _: usize) -> [S; 9] {
        let now = (view.step - view.goal.get(PUSH)).abs().lt(S::constant(0.5));
        let size = S::select(now, view.goal.get(1) * S::constant(1.0 / self.dt), S::zero());
        let force = scale(size, view.goal.array::<3>(KICKED));
        let zero = S::zero();
        [zero, zero, zero, force[0], force[1], force[2], zero, zero, zero]
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, view: &View<'_, S>, _: usize, out: &mut Pen<'_, S>) {
        self.load.observe_lever(view, out);
        out.array(self.error(view));
        view.observe_drone(0, out);
        self.load.observe_motion(view, out);
        view.observe_clock(out);
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        carry_reward(view, self.error(view), terms);
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        ends.when(view.drone(0).position[2].lt(S::constant(LOW)));
        ends.when(self.load.ball(view).position[2].lt(S::constant(LOW)));
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.number(safe::norm(self.error(view)));
        out.number(view.drone(0).up()[2]);
        out.number(view.throttle_difference(0));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        safe::squared_norm(self.error(view)).lt(S::constant(0.01))
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let speed = S::constant(0.02) * safe::squared_norm(self.load.ball(view).velocity);
        let rate = S::constant(0.005) * safe::squared_norm(view.drone(0).angular_velocity);
        smooth_norm(self.error(view), 0.1) + speed + rate
    }

    fn wanted(&self, view: &View<'_, f64>) -> Option<Wanted> {
        self.load.wanted(view, TARGET)
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.load.draw(start);
        start.goal[PUSH] = -1.0;
        let position = self.load.drone_of(start, TARGET);
        self.load.place(start, position, [1.0, 0.0, 0.0, 0.0]);
    }
}
