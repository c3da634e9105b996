//! OverHover: drones on the arms of a frame bring it to a pose and hold it there, tilted.
//!
//! | Observation | size | unit | meaning | |
//! |---|---|---|---|---|
//! | `place` | 3 | m, world | p_i − p of the frame | smooth |
//! | `attitude` | 4 | -, body → world | unit quaternion, w ≥ 0 | non-smooth |
//! | `velocity` | 3 | m/s, world | v | smooth |
//! | `angular_velocity` | 3 | rad/s, world | ω | smooth |
//! | `heading` | 3 | -, world | h = R e_x | smooth |
//! | `up` | 3 | -, world | u = R e_z | smooth |
//! | `throttle` | 4 | - | 2s − 1, s = Ω/Ω_max | smooth |
//! | `index` | 4 | - | 1 at i, else 0 | smooth |
//! | `others` | 39 | m, -, m/s, rad/s; world | p_i − p_j, q_j, v_j, ω_j for every other j, ascending | non-smooth |
//! | `target` | 3 | m, world | p_t − p | smooth |
//! | `heading_error` | 3 | -, world | h_t − h | smooth |
//! | `up_error` | 3 | -, world | u_t − u | smooth |
//! | `frame_attitude` | 4 | -, body → world | unit quaternion, w ≥ 0 | non-smooth |
//! | `frame_velocity` | 3 | m/s, world | v | smooth |
//! | `frame_angular_velocity` | 3 | rad/s, world | ω | smooth |
//! | `frame_heading` | 3 | -, world | h = R e_x | smooth |
//! | `frame_up` | 3 | -, world | u = R e_z | smooth |
//! | `clock` | 4 | - | k/T, four times | smooth |
//! | *total* | 95 | | | |
//!
//! | Reward | term | at most | |
//! |---|---|---|---|
//! | `pose` | r_p = e^{−1.2 d} | 1 | piecewise |
//! | `up` | r_p ((u·u_t + 1)/2)² | 1 | piecewise |
//! | `spin` | r_p/(1 + (|ω_x| + |ω_y| + |ω_z|)²) | 1 | piecewise |
//! | `effort` | 0.25 · mean e^{−e_i} | 0.25 | smooth |
//! | *sum* | | 3.25 | |
//!
//! | Episode end | when |
//! |---|---|
//! | `crash` | min z_i < 0.2 m |
//! | `far` | d > 5 |
//! | `diverged` | a number of the state leaves ±1e8 |
//! | *truncated* | k ≥ `horizon` |
//!
//! | Configuration | default | meaning |
//! |---|---|---|
//! | `vehicle` | "hummingbird" | what flies at every arm |
//! | `n_drone` | 4 | drones: 2, 4 or 6 |
//! | `horizon` | 500 | T, steps |
//!
//! p, h, u, v, ω frame (world), p_i drones, e_i = Σ s effort of drone i, k steps. Target: (0, 0, 2.25) m, heading h_t
//! and up u_t of an attitude with roll and pitch within ±0.2π and any yaw. Start: frame uniform in
//! ±3 × ±3 × [1.5, 2.5] m, the same attitudes, at rest, joints at zero. d = ‖(p_t − p, h_t − h, u_t − u)‖.
//!
//! - Success: `position_error` < 0.1 m.
//! - Loss: √(‖p_t − p‖² + 0.1²) + 0.3 (‖h_t − h‖² + ‖u_t − u‖²) + 0.02 ‖v‖² + 0.005 ‖ω‖².
//!
//! - DIFFERENCE: target attitudes as above; published ones lack the factor π: ±0.2 rad, yaw up to 2 rad (defect 16).
//! - DIFFERENCE: starts with d > 4.5 are drawn again; published ones reach 4.8 of the 5 that end an episode (defect 26).
//! - DIFFERENCE: the spin term counts the three angular rates; the published one all six velocities (defect 15).
//! - DIFFERENCE: total mass everywhere (defect 5).

use super::over::*;
use super::team::{
    TeamSettings, carried_slices, lowest, mean_throttle_difference, observe_drones, observe_load, observe_others,
    observe_own, squared_sum,
};
use crate::autodiff::{Pen, Rows, Scalar, safe};
use crate::dynamics::frame::Frame;
use crate::dynamics::spatial::dot;
use crate::error::Result;
use crate::tasks::config::EnvConfig;
use crate::tasks::reward::{bell, tip};
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{End, Metric, Setting, Sheet, Term};
use crate::tasks::task::{ANY_YAW, Ends, START_TILT, Start, Task, View, Wanted};

/// The target, m, world.
const TARGET: [f64; 3] = [0.0, 0.0, 2.25];
/// Largest pose distance.
const FAR: f64 = 5.0;
/// Largest at the start.
const START_FAR: f64 = 4.5;

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct OverHover {
    rig: Rig,
    settings: TeamSettings,
}

impl OverHover {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`] and [`free_rig`].
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let settings: TeamSettings = config.settings()?;
        Ok(Self { rig: free_rig(config, &settings.vehicle, settings.n_drone)?, settings })
    }

    #[inline(always)]
    fn error<S: Scalar>(view: &View<'_, S>) -> [S; 9] {
        pose_error(&view.frame(FRAME_BODY), TARGET, &view.goal)
    }

    /// What follows the drones in observations.
    #[inline(always)]
    fn observe_shared<S: Scalar>(view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.array(Self::error(view));
        observe_load(view, &view.frame(FRAME_BODY), out);
    }
}

impl Task for OverHover {
    fn rig(&self) -> &Rig {
        &self.rig
    }

    fn horizon(&self) -> usize {
        self.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let (observation, central) = carried_slices(&self.rig, "frame", false, &error_slices());
        Sheet {
            observation,
            central,
            reward: vec![
                Term::piecewise("pose", "r_p = e^{−1.2 d}", 1.0),
                Term::piecewise("up", "r_p ((u·u_t + 1)/2)²", 1.0),
                Term::piecewise("spin", "r_p/(1 + (|ω_x| + |ω_y| + |ω_z|)²)", 1.0),
                Term::smooth("effort", "0.25 · mean e^{−e_i}", 0.25),
            ],
            ends: vec![End::new("crash", "min z_i < 0.2 m"), End::new("far", "d > 5")],
            metrics: vec![
                Metric { name: "position_error", unit: "m" },
                Metric { name: "heading_alignment", unit: "-" },
                Metric { name: "up_alignment", unit: "-" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal: attitude_slices(),
            memo: Vec::new(),
            settings: vec![
                Setting::new("vehicle", "\"hummingbird\"", "what flies at every arm"),
                Setting::new("n_drone", 4, "drones: 2, 4 or 6"),
                Setting::new("horizon", 500, "T, steps"),
            ],
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        draw_attitude(start);
        for _ in 0..100 {
            let position = start.position([-3.0, -3.0, 1.5], [3.0, 3.0, 2.5]);
            let attitude = start.attitude(START_TILT, ANY_YAW);
            start.place(FRAME_BODY, position, attitude);
            let frame = Frame { position, velocity: [0.0; 3], attitude, angular_velocity: [0.0; 3] };
            let error = pose_error(&frame, TARGET, &Rows::of(start.goal));
            if safe::norm(error) <= START_FAR {
                break;
            }
        }
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, view: &View<'_, S>, agent: usize, out: &mut Pen<'_, S>) {
        observe_own(view, agent, view.frame(FRAME_BODY).position, out);
        observe_others(view, agent, false, out);
        Self::observe_shared(view, out);
    }

    #[inline(always)]
    fn central<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        observe_drones(view, view.frame(FRAME_BODY).position, out);
        Self::observe_shared(view, out);
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        let frame = view.frame(FRAME_BODY);
        let pose = tip(1.2, Self::error(view));
        terms.number(pose);
        terms.number(pose * aligned(frame.up(), view.goal.array(3)));
        terms.number(pose * bell(1.0, squared_sum(frame.angular_velocity)));
        terms.number(S::constant(0.25) * view.mean_effort_reward());
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        ends.when(lowest(view).lt(S::constant(0.2)));
        ends.when(S::constant(FAR * FAR).lt(safe::squared_norm(Self::error(view))));
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        let frame = view.frame(FRAME_BODY);
        out.number(safe::sqrt(squared_distance(&Self::error(view)), safe::SQUARED_NORM_FLOOR));
        out.number(dot(frame.heading(), view.goal.array(0)));
        out.number(dot(frame.up(), view.goal.array(3)));
        out.number(mean_throttle_difference(view));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        squared_distance(&Self::error(view)).lt(S::constant(0.01))
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        pose_loss(&view.frame(FRAME_BODY), &Self::error(view))
    }

    fn wanted(&self, view: &View<'_, f64>) -> Option<Wanted> {
        Some(wanted_pose(view, TARGET))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let level = [1.0, 0.0, 0.0, 0.0];
        set_attitude(start, level);
        start.place(FRAME_BODY, TARGET, level);
    }
}
