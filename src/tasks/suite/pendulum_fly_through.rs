//! InvPendulumFlyThrough: carry a ball that stands on a bar past two level bars.
//!
//! | Observation | size | unit | meaning | |
//! |---|---|---|---|---|
//! | `drone_from_ball` | 3 | m, world | p − q | smooth |
//! | `position` | 3 | m, world | p | smooth |
//! | `attitude` | 4 | -, body → world | unit quaternion, w ≥ 0 | non-smooth |
//! | `velocity` | 3 | m/s, world | v | smooth |
//! | `angular_velocity` | 3 | rad/s, world | ω | smooth |
//! | `heading` | 3 | -, world | h = R e_x | smooth |
//! | `up` | 3 | -, world | u = R e_z | smooth |
//! | `throttle` | 4 | - | 2s − 1, s = Ω/Ω_max | smooth |
//! | `target` | 3 | m, world | q_t − q | smooth |
//! | `ball_velocity` | 3 | m/s, world | v_q = q̇ | smooth |
//! | `bar_angular_velocity` | 3 | rad/s, world | ω_b | smooth |
//! | `bars` | 4 | m, world | (x, z) of lower and upper bar − (x, z) of p | smooth |
//! | `clock` | 4 | - | k/T, four times | smooth |
//! | *total* | 43 | | | |
//!
//! | Reward | term | at most | |
//! |---|---|---|---|
//! | `pose` | (1 − c) r_p, r_p = 1/(1 + 1.2 d) | 1 | non-smooth |
//! | `balance` | (1 − c) r_p b | 1 | non-smooth |
//! | `spin` | (1 − c) r_p/(1 + ω_z²) | 1 | non-smooth |
//! | `swing` | (1 − c) r_p e^{−‖v_q‖} | 1 | non-smooth |
//! | `effort` | (1 − c) 0.1 e^{−e} | 0.1 | non-smooth |
//! | *sum* | | 4.1 | |
//!
//! | Episode end | when |
//! |---|---|
//! | `crash` | z < 0.2 m |
//! | `wide` | \|y\| > 2 m |
//! | `fall` | b < 0.1 |
//! | `high` | q_z > 3 m |
//! | `contact` | c = 1, if `reset_on_collision` |
//! | `diverged` | a number of the state leaves ±1e8 |
//! | *truncated* | k ≥ `horizon` |
//!
//! | Configuration | default | meaning |
//! |---|---|---|
//! | `vehicle` | "hummingbird" | what flies |
//! | `horizon` | 500 | T, steps |
//! | `length` | [0.85, 0.85] | L, lowest and highest, m; drawn once per environment |
//! | `ball_share` | [0.2, 0.3] | m_q over the vehicle's mass, lowest and highest |
//! | `spacing` | [0.9, 1.2] | of the obstacles, lowest and highest, m |
//! | `reset_on_collision` | false | whether touch ends the episode |
//!
//! p drone, q ball, b = (q − p)_z/L, ω angular velocity of the drone (world), e = Σ s effort, k steps, v_q = q̇, ω_b angular
//! velocity of the bar, d = ‖q_t − q‖, c = 1 while drone, bar or ball touch an obstacle, else 0. Ball 0.2 to 0.3 of the
//! vehicle's mass, bar 0.01 to 0.04 kg. Obstacles: two level bars along y at x = 0, z = 1.2 m and `spacing` above. Target:
//! q_t = (1.5, 0, 2.3) m. Start: p uniform in [−2.2, −1] × 0 × [1, 2] m, roll and pitch within ±0.15π, any yaw, the bar along
//! the drone's z, at rest. Shapes that touch have the middle of `length`.
//!
//! - Success: `position_error` < 0.2 m, once in the episode.
//! - Loss: √(d² + 0.1²) + 0.02 ‖v_q‖² + 0.005 ‖ω‖² + 1 − b + 0.5 e^{−10 max(`clearance`, −0.2 m)}.
//!
//! - DIFFERENCE: r_p = 1/(1 + 1.2 d) is that of the current code; the paper's was e^{−1.2 d}.
//! - DIFFERENCE: c is geometric, of the shapes that push; the published one asks for a contact force.
//! - DIFFERENCE: starts with q_z > 3 m are drawn again; they come with bars above 1 m alone.
//! - DIFFERENCE: a drawn mass takes centre of mass and inertia with it (defect 25).
//! - DIFFERENCE: the ball's share is of the total mass, not of the base link's (defect 5).
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).

use crate::autodiff::{Pen, Scalar, safe};
use crate::dynamics::spatial::{constants, sub};
use crate::error::Result;
use crate::tasks::config::EnvConfig;
use crate::tasks::reward::{smooth_norm, still, tip};
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{End, Metric, Setting, Sheet, Slice, Term};
use crate::tasks::suite::load::{BALL_SHARE, DRAWN_BAR, Load, Plan, Side, leaning, load_settings};
use crate::tasks::suite::obstacles::{Bars, free, nearness, touches, where_on};
use crate::tasks::suite::{clock_slice, drone_slices, latch};
use crate::tasks::task::{ANY_YAW, Ends, Start, Task, View};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// q_t, m, world.
const TARGET: [f64; 3] = [1.5, 0.0, 2.3];
/// Highest ball, m.
const HIGH: f64 = 3.0;

/// Settings of [`InvPendulumFlyThrough`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InvPendulumFlyThroughSettings {
    /// What flies.
    pub vehicle: String,
    /// T, steps.
    pub horizon: usize,
    /// Of the bar, lowest and highest, m.
    pub length: [f64; 2],
    /// Mass of the ball as a share of the vehicle's, lowest and highest.
    pub ball_share: [f64; 2],
    /// Of the obstacles, lowest and highest, m.
    pub spacing: [f64; 2],
    /// Whether touch ends the episode.
    pub reset_on_collision: bool,
}

impl Default for InvPendulumFlyThroughSettings {
    fn default() -> Self {
        Self {
            vehicle: "hummingbird".into(),
            horizon: 500,
            length: [0.85, 0.85],
            ball_share: BALL_SHARE,
            spacing: [0.9, 1.2],
            reset_on_collision: false,
        }
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct InvPendulumFlyThrough {
    load: Load,
    bars: Bars,
    settings: InvPendulumFlyThroughSettings,
}

impl InvPendulumFlyThrough {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`] and [`EnvConfig::vehicle`]; [`Error::Value`](crate::error::Error::Value) for a length or
    /// spacing that is none.
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let settings: InvPendulumFlyThroughSettings = config.settings()?;
        let (vehicle, length, ball) = (settings.vehicle.as_str(), settings.length, settings.ball_share);
        let plan = Plan { vehicle, side: Side::Standing, length, ball, bar: DRAWN_BAR };
        let (load, bars) = Load::among_bars(config, &plan, settings.spacing)?;
        Ok(Self { load, bars, settings })
    }

    /// q_t − q.
    #[inline(always)]
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> [S; 3] {
        sub(constants(TARGET), self.load.ball(view).position)
    }
}

impl Task for InvPendulumFlyThrough {
    fn rig(&self) -> &Rig {
        &self.load.rig
    }

    fn horizon(&self) -> usize {
        self.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let mut observation = vec![Load::lever_slice(), Slice::new("position", 3, "m, world", "p")];
        observation.extend(drone_slices(self.rig().drone()));
        observation.push(Slice::new("target", 3, "m, world", "q_t − q"));
        observation.extend(Load::motion_slices());
        observation.push(Bars::observed());
        observation.push(clock_slice());
        let mut goal = Load::slices();
        goal.push(Bars::slice());
        let mut settings = load_settings(500, "[0.85, 0.85]");
        settings.push(Setting::new("spacing", "[0.9, 1.2]", "of the obstacles, lowest and highest, m").positive());
        settings.push(Setting::new("reset_on_collision", false, "whether touch ends the episode"));
        Sheet {
            observation,
            central: Vec::new(),
            reward: vec![
                Term::non_smooth("pose", "(1 − c) r_p, r_p = 1/(1 + 1.2 d)", 1.0),
                Term::non_smooth("balance", "(1 − c) r_p b", 1.0),
                Term::non_smooth("spin", "(1 − c) r_p/(1 + ω_z²)", 1.0),
                Term::non_smooth("swing", "(1 − c) r_p e^{−‖v_q‖}", 1.0),
                Term::non_smooth("effort", "(1 − c) 0.1 e^{−e}", 0.1),
            ],
            ends: vec![
                End::new("crash", "z < 0.2 m"),
                End::new("wide", "\\|y\\| > 2 m"),
                End::new("fall", "b < 0.1"),
                End::new("high", "q_z > 3 m"),
                End::new("contact", "c = 1, if `reset_on_collision`"),
            ],
            metrics: vec![
                Metric { name: "position_error", unit: "m" },
                Metric { name: "balance", unit: "-" },
                Metric { name: "clearance", unit: "m" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal,
            memo: vec![Slice::new("reached", 1, "-", "1 once d < 0.2 m")],
            settings,
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        self.load.draw(start);
        self.bars.draw(start);
        for _ in 0..100 {
            let position = start.position([-2.2, 0.0, 1.0], [-1.0, 0.0, 2.0]);
            let attitude = start.attitude(0.15 * PI, ANY_YAW);
            if self.load.place(start, position, attitude)[2] < HIGH {
                break;
            }
        }
    }

    #[inline(always)]
    fn remember<S: Scalar>(&self, view: &View<'_, S>, memo: &mut Pen<'_, S>) {
        let now = safe::squared_norm(self.error(view)).lt(S::constant(0.04));
        memo.number(latch(view.memo.get(0), now));
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, view: &View<'_, S>, _: usize, out: &mut Pen<'_, S>) {
        let position = view.drone(0).position;
        self.load.observe_lever(view, out);
        out.array(position);
        view.observe_drone(0, out);
        out.array(self.error(view));
        self.load.observe_motion(view, out);
        self.bars.observe(view, position, out);
        view.observe_clock(out);
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        let (ball, free) = (self.load.ball(view), free(self.bars.clearance(view)));
        let distance = safe::norm(self.error(view));
        let pose = free * S::constant(1.2).mul_add(distance, S::one()).recip();
        terms.number(pose);
        terms.number(pose * ball.up()[2]);
        terms.number(pose * still(view.drone(0).angular_velocity));
        terms.number(pose * tip(1.0, ball.velocity));
        terms.number(free * S::constant(0.1) * (-view.effort(0)).exp());
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        let (position, ball) = (view.drone(0).position, self.load.ball(view));
        ends.when(position[2].lt(S::constant(0.2)));
        ends.when(S::constant(2.0).lt(position[1].abs()));
        ends.when(ball.up()[2].lt(S::constant(0.1)));
        ends.when(S::constant(HIGH).lt(ball.position[2]));
        ends.when(where_on::<S>(self.settings.reset_on_collision, touches(self.bars.clearance(view))));
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.number(safe::norm(self.error(view)));
        out.number(self.load.ball(view).up()[2]);
        out.number(self.bars.clearance(view));
        out.number(view.throttle_difference(0));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        S::constant(0.5).lt(view.memo.get(0))
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let ball = self.load.ball(view);
        let speed = S::constant(0.02) * safe::squared_norm(ball.velocity);
        let rate = S::constant(0.005) * safe::squared_norm(view.drone(0).angular_velocity);
        let near = nearness(self.bars.clearance(view));
        smooth_norm(self.error(view), 0.1) + speed + rate + leaning(&ball) + near
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.load.draw(start);
        self.bars.draw(start);
        let position = self.load.drone_of(start, TARGET);
        self.load.place(start, position, [1.0, 0.0, 0.0, 0.0]);
    }
}
