//! InvPendulumTrack: lead a ball that stands on a bar along a lemniscate.
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
//! | `path` | 18 | m, world | p_ref(k + 5i) − q for i = 0 … 5 | smooth |
//! | `ball_velocity` | 3 | m/s, world | v_q = q̇ | smooth |
//! | `bar_angular_velocity` | 3 | rad/s, world | ω_b | smooth |
//! | `clock` | 4 | - | k/T, four times | smooth |
//! | *total* | 51 | | | |
//!
//! | Reward | term | at most | |
//! |---|---|---|---|
//! | `pose` | e^{−1.6 d} | 1 | piecewise |
//! | `effort` | 0.1 e^{−e} | 0.1 | smooth |
//! | *sum* | | 1.1 | |
//!
//! | Episode end | when |
//! |---|---|
//! | `crash` | z < 0.2 m |
//! | `fall` | b < 0.2 |
//! | `far` | d > `reset_distance` |
//! | `diverged` | a number of the state leaves ±1e8 |
//! | *truncated* | k ≥ `horizon` |
//!
//! | Configuration | default | meaning |
//! |---|---|---|
//! | `vehicle` | "hummingbird" | what flies |
//! | `horizon` | 600 | T, steps |
//! | `length` | [1.0, 1.0] | L, lowest and highest, m; drawn once per environment |
//! | `ball_share` | [0.2, 0.3] | m_q over the vehicle's mass, lowest and highest |
//! | `reset_distance` | 0.8 | largest distance of the ball from the path, m |
//!
//! p drone, q ball, b = (q − p)_z/L, ω angular velocity of the drone (world), e = Σ s effort, k steps, v_q = q̇, ω_b
//! angular velocity of the bar, p_ref(k) the path (a [lemniscate](crate::tasks::path) of vertical part c, scale S and
//! rate w) with c within ±0.6, S within (1.8, 1.8, 1) … (3.2, 3.2, 1.5) m, |w| within 0.7 … 1 rad/s about (0, 0, 3) m,
//! d = ‖p_ref(k) − q‖. Ball 0.2 to 0.3 of the vehicle's mass, bar 1 g. Start: p one bar below the path, roll and pitch
//! within ±0.1π, any yaw, the bar along the drone's z, at rest.
//!
//! - Success: `position_error` < 0.3 m.
//! - Loss: √(d² + 0.1²) + 0.02 ‖ṗ_ref − v_q‖² + 0.005 ‖ω‖² + 1 − b.
//!
//! - DIFFERENCE: starts with d > `reset_distance` are drawn again; they come with bars above 1.8 m alone.
//! - DIFFERENCE: a drawn mass takes centre of mass and inertia with it (defect 25).
//! - DIFFERENCE: the ball's share is of the total mass, not of the base link's (defect 5).

use crate::autodiff::{Pen, Scalar, safe};
use crate::error::Result;
use crate::tasks::config::EnvConfig;
use crate::tasks::path::Path;
use crate::tasks::reward::tip;
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{End, Metric, Sheet, Term};
use crate::tasks::suite::load::{LIGHT_BAR, Load, LoadTrack, LoadTrackSettings, Plan, Side, leaning};
use crate::tasks::suite::{clock_slice, drone_slices};
use crate::tasks::task::{Ends, Start, Task, View, Wanted};

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct InvPendulumTrack {
    track: LoadTrack,
}

impl InvPendulumTrack {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`] and [`EnvConfig::vehicle`]; [`Error::Value`](crate::error::Error::Value) for a length that
    /// is none.
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let settings: LoadTrackSettings = config.settings()?;
        let (vehicle, length, ball) = (settings.vehicle.as_str(), settings.length, settings.ball_share);
        let load = Load::new(config, &Plan { vehicle, side: Side::Standing, length, ball, bar: LIGHT_BAR })?;
        Ok(Self { track: LoadTrack::new(load, settings, 3.0, config.dt) })
    }
}

impl Task for InvPendulumTrack {
    fn rig(&self) -> &Rig {
        &self.track.load.rig
    }

    fn horizon(&self) -> usize {
        self.track.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let mut observation = vec![Load::lever_slice()];
        observation.extend(drone_slices(self.rig().drone()));
        observation.push(LoadTrack::ahead_slice());
        observation.extend(Load::motion_slices());
        observation.push(clock_slice());
        let mut goal = Load::slices();
        goal.extend(Path::slices());
        Sheet {
            observation,
            central: Vec::new(),
            reward: vec![Term::piecewise("pose", "e^{−1.6 d}", 1.0), Term::smooth("effort", "0.1 e^{−e}", 0.1)],
            ends: vec![
                End::new("crash", "z < 0.2 m"),
                End::new("fall", "b < 0.2"),
                End::new("far", "d > `reset_distance`"),
            ],
            metrics: vec![
                Metric { name: "position_error", unit: "m" },
                Metric { name: "balance", unit: "-" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal,
            memo: Vec::new(),
            settings: LoadTrack::settings(),
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        self.track.start(start);
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, view: &View<'_, S>, _: usize, out: &mut Pen<'_, S>) {
        self.track.load.observe_lever(view, out);
        view.observe_drone(0, out);
        self.track.observe_ahead(view, out);
        self.track.load.observe_motion(view, out);
        view.observe_clock(out);
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        terms.number(tip(1.6, self.track.error(view, 0)));
        terms.number(S::constant(0.1) * (-view.effort(0)).exp());
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        let low = S::constant(0.2);
        ends.when(view.drone(0).position[2].lt(low));
        ends.when(self.track.load.ball(view).up()[2].lt(low));
        ends.when(self.track.far(view));
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.number(safe::norm(self.track.error(view, 0)));
        out.number(self.track.load.ball(view).up()[2]);
        out.number(view.throttle_difference(0));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        self.track.success(view)
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        self.track.loss(view) + leaning(&self.track.load.ball(view))
    }

    fn wanted(&self, view: &View<'_, f64>) -> Option<Wanted> {
        self.track.wanted(view)
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.track.ideal(start);
    }
}
