//! PayloadFlyThrough: swing a slung ball past two level bars.
//!
//! | Observation | size | unit | meaning | |
//! |---|---|---|---|---|
//! | `drone_from_ball` | 3 | m, world | p − q | smooth |
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
//! | *total* | 40 | | | |
//!
//! | Reward | term | at most | |
//! |---|---|---|---|
//! | `pose` | (1 − c) r_p, r_p = 1/(1 + (1.2 d)²) | 1 | non-smooth |
//! | `up` | (1 − c) r_p ((u_z + 1)/2)² | 1 | non-smooth |
//! | `spin` | (1 − c) 0.5 r_p/(1 + ω_z²) | 0.5 | non-smooth |
//! | `swing` | (1 − c) 0.5 r_p e^{−‖v_q‖} | 0.5 | non-smooth |
//! | `effort` | (1 − c) 0.1 e^{−e} | 0.1 | non-smooth |
//! | *sum* | | 3.1 | |
//!
//! | Episode end | when |
//! |---|---|
//! | `crash` | z < 0.2 m |
//! | `high` | z > 2.5 m |
//! | `wide` | \|y\| > 2 m |
//! | `ball_crash` | q_z < 0.15 m |
//! | `contact` | c = 1, if `reset_on_collision` |
//! | `diverged` | a number of the state leaves ±1e8 |
//! | *truncated* | k ≥ `horizon` |
//!
//! | Configuration | default | meaning |
//! |---|---|---|
//! | `vehicle` | "hummingbird" | what flies |
//! | `horizon` | 500 | T, steps |
//! | `length` | [1.0, 1.0] | L, lowest and highest, m; drawn once per environment |
//! | `ball_share` | [0.2, 0.3] | m_q over the vehicle's mass, lowest and highest |
//! | `spacing` | [0.85, 0.85] | of the obstacles, lowest and highest, m |
//! | `reset_on_collision` | false | whether touch ends the episode |
//!
//! p drone, q ball, u = R e_z, ω angular velocity of the drone (world), e = Σ s effort, k steps, v_q = q̇, ω_b angular velocity
//! of the bar, d = ‖q_t − q‖, c = 1 while drone, bar or ball touch an obstacle, else 0. Ball 0.2 to 0.3 of the vehicle's mass,
//! bar 1 g. Obstacles: two level bars along y at x = 0, z = 1.2 m and `spacing` above. Target: q_t uniform in
//! [1.3, 1.5] × 0 × [1, 1.5] m. Start: p uniform in [−2.5, −1] × 0 × [1.5, 2] m, roll and pitch within ±0.2π, any yaw, the bar
//! along the drone's −z, at rest. Shapes that touch have the middle of `length`.
//!
//! - Success: `position_error` < 0.2 m, once in the episode.
//! - Loss: √(d² + 0.1²) + 0.02 ‖v_q‖² + 0.005 ‖ω‖² + 0.5 e^{−10 max(`clearance`, −0.2 m)}.
//!
//! - DIFFERENCE: observes p − q; the published code p − q_t under that name (defect 18).
//! - DIFFERENCE: c is geometric, of the shapes that push; the published one asks for a contact force.
//! - DIFFERENCE: starts with q_z < 0.15 m are drawn again; they come with bars above 1.35 m alone.
//! - DIFFERENCE: the bar swings without stops; published ones are at ±120° (see [`load`](crate::tasks::suite::load)).
//! - DIFFERENCE: a drawn mass takes centre of mass and inertia with it (defect 25).
//! - DIFFERENCE: the ball's share is of the total mass, not of the base link's (defect 5).
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).

use crate::autodiff::{Pen, Scalar, safe};
use crate::dynamics::spatial::sub;
use crate::error::Result;
use crate::tasks::config::EnvConfig;
use crate::tasks::reward::{bell, smooth_norm, still, tip, upright};
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{End, Metric, Setting, Sheet, Slice, Term};
use crate::tasks::suite::load::{BALL_SHARE, LIGHT_BAR, LOAD, Load, Plan, Side, load_settings};
use crate::tasks::suite::obstacles::{BARS, Bars, free, nearness, touches, where_on};
use crate::tasks::suite::{clock_slice, drone_slices, latch};
use crate::tasks::task::{ANY_YAW, Ends, START_TILT, Start, Task, View};
use serde::{Deserialize, Serialize};

/// Place of q_t in the goal.
const TARGET: usize = LOAD + BARS;
/// Lowest ball, m.
const LOW: f64 = 0.15;

/// Settings of [`PayloadFlyThrough`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PayloadFlyThroughSettings {
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

impl Default for PayloadFlyThroughSettings {
    fn default() -> Self {
        Self {
            vehicle: "hummingbird".into(),
            horizon: 500,
            length: [1.0, 1.0],
            ball_share: BALL_SHARE,
            spacing: [0.85, 0.85],
            reset_on_collision: false,
        }
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct PayloadFlyThrough {
    load: Load,
    bars: Bars,
    settings: PayloadFlyThroughSettings,
}

impl PayloadFlyThrough {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`] and [`EnvConfig::vehicle`]; [`Error::Value`](crate::error::Error::Value) for a length or
    /// spacing that is none.
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let settings: PayloadFlyThroughSettings = config.settings()?;
        let (vehicle, length, ball) = (settings.vehicle.as_str(), settings.length, settings.ball_share);
        let plan = Plan { vehicle, side: Side::Hanging, length, ball, bar: LIGHT_BAR };
        let (load, bars) = Load::among_bars(config, &plan, settings.spacing)?;
        Ok(Self { load, bars, settings })
    }

    /// q_t − q.
    #[inline(always)]
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> [S; 3] {
        sub(view.goal.array(TARGET), self.load.ball(view).position)
    }

    /// Draws load, obstacles and target; returns q_t.
    fn draw(&self, start: &mut Start<'_>) -> [f64; 3] {
        self.load.draw(start);
        self.bars.draw(start);
        let target = [start.task.uniform(1.3, 1.5), 0.0, start.task.uniform(1.0, 1.5)];
        start.goal[TARGET..TARGET + 3].copy_from_slice(&target);
        target
    }
}

impl Task for PayloadFlyThrough {
    fn rig(&self) -> &Rig {
        &self.load.rig
    }

    fn horizon(&self) -> usize {
        self.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let mut observation = vec![Load::lever_slice()];
        observation.extend(drone_slices(self.rig().drone()));
        observation.push(Slice::new("target", 3, "m, world", "q_t − q"));
        observation.extend(Load::motion_slices());
        observation.push(Bars::observed());
        observation.push(clock_slice());
        let mut goal = Load::slices();
        goal.push(Bars::slice());
        goal.push(Slice::new("target", 3, "m, world", "q_t"));
        let mut settings = load_settings(500, "[1.0, 1.0]");
        settings.push(Setting::new("spacing", "[0.85, 0.85]", "of the obstacles, lowest and highest, m").positive());
        settings.push(Setting::new("reset_on_collision", false, "whether touch ends the episode"));
        Sheet {
            observation,
            central: Vec::new(),
            reward: vec![
                Term::non_smooth("pose", "(1 − c) r_p, r_p = 1/(1 + (1.2 d)²)", 1.0),
                Term::non_smooth("up", "(1 − c) r_p ((u_z + 1)/2)²", 1.0),
                Term::non_smooth("spin", "(1 − c) 0.5 r_p/(1 + ω_z²)", 0.5),
                Term::non_smooth("swing", "(1 − c) 0.5 r_p e^{−‖v_q‖}", 0.5),
                Term::non_smooth("effort", "(1 − c) 0.1 e^{−e}", 0.1),
            ],
            ends: vec![
                End::new("crash", "z < 0.2 m"),
                End::new("high", "z > 2.5 m"),
                End::new("wide", "\\|y\\| > 2 m"),
                End::new("ball_crash", "q_z < 0.15 m"),
                End::new("contact", "c = 1, if `reset_on_collision`"),
            ],
            metrics: vec![
                Metric { name: "position_error", unit: "m" },
                Metric { name: "uprightness", unit: "-" },
                Metric { name: "clearance", unit: "m" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal,
            memo: vec![Slice::new("reached", 1, "-", "1 once d < 0.2 m")],
            settings,
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        self.draw(start);
        for _ in 0..100 {
            let position = start.position([-2.5, 0.0, 1.5], [-1.0, 0.0, 2.0]);
            let attitude = start.attitude(START_TILT, ANY_YAW);
            if self.load.place(start, position, attitude)[2] > LOW {
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
        self.load.observe_lever(view, out);
        view.observe_drone(0, out);
        out.array(self.error(view));
        self.load.observe_motion(view, out);
        self.bars.observe(view, view.drone(0).position, out);
        view.observe_clock(out);
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        let (drone, half) = (view.drone(0), S::constant(0.5));
        let free = free(self.bars.clearance(view));
        let pose = free * bell(1.2, safe::squared_norm(self.error(view)));
        terms.number(pose);
        terms.number(pose * upright(drone.up()));
        terms.number(half * pose * still(drone.angular_velocity));
        terms.number(half * pose * tip(1.0, self.load.ball(view).velocity));
        terms.number(free * S::constant(0.1) * (-view.effort(0)).exp());
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        let position = view.drone(0).position;
        ends.when(position[2].lt(S::constant(0.2)));
        ends.when(S::constant(2.5).lt(position[2]));
        ends.when(S::constant(2.0).lt(position[1].abs()));
        ends.when(self.load.ball(view).position[2].lt(S::constant(LOW)));
        ends.when(where_on::<S>(self.settings.reset_on_collision, touches(self.bars.clearance(view))));
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.number(safe::norm(self.error(view)));
        out.number(view.drone(0).up()[2]);
        out.number(self.bars.clearance(view));
        out.number(view.throttle_difference(0));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        S::constant(0.5).lt(view.memo.get(0))
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let speed = S::constant(0.02) * safe::squared_norm(self.load.ball(view).velocity);
        let rate = S::constant(0.005) * safe::squared_norm(view.drone(0).angular_velocity);
        smooth_norm(self.error(view), 0.1) + speed + rate + nearness(self.bars.clearance(view))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let target = self.draw(start);
        let position = self.load.drone_of(start, target);
        self.load.place(start, position, [1.0, 0.0, 0.0, 0.0]);
    }
}
