//! OverTrack: drones on the arms of a frame carry it along a lemniscate while its axis points at a fixed point.
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
//! | `path` | 12 | m, world | p_ref(k + 5i) − p for i = 0 … 3 | smooth |
//! | `up_error` | 3 | -, world | u_t − u | smooth |
//! | `frame_attitude` | 4 | -, body → world | unit quaternion, w ≥ 0 | non-smooth |
//! | `frame_velocity` | 3 | m/s, world | v | smooth |
//! | `frame_angular_velocity` | 3 | rad/s, world | ω | smooth |
//! | `frame_heading` | 3 | -, world | h = R e_x | smooth |
//! | `frame_up` | 3 | -, world | u = R e_z | smooth |
//! | `clock` | 4 | - | k/T, four times | smooth |
//! | *total* | 101 | | | |
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
//! | `far` | d > `reset_distance` |
//! | `diverged` | a number of the state leaves ±1e8 |
//! | *truncated* | k ≥ `horizon` |
//!
//! | Configuration | default | meaning |
//! |---|---|---|
//! | `vehicle` | "hummingbird" | what flies at every arm |
//! | `n_drone` | 4 | drones: 2, 4 or 6 |
//! | `horizon` | 500 | T, steps |
//! | `reset_distance` | 0.5 | largest distance from the path, m |
//!
//! p, u, v, ω frame (world), e_i = Σ s effort of drone i, k steps, p_ref(k) the path
//! (a [lemniscate](crate::tasks::path) of vertical part c, scale S and rate w) with c within ±0.6, S within
//! (2.4, 2.4, 1.2) … (3.6, 3.6, 1.6) m, |w| within 0.8 … 1.1 rad/s about (0, 0, 2) m. The point a to look at: 3 m from
//! (0, 0, 2) m in any direction, then with its height above it made positive and 0.1 m added; u_t = (a − p)/‖a − p‖.
//! Start: frame on the path, roll and pitch within ±0.2π, any yaw, at rest, joints at zero. d = ‖p_ref(k) − p‖.
//!
//! - Success: `position_error` < 0.3 m.
//! - Loss: √(d² + 0.1²) + 0.3 ‖u_t − u‖² + 0.02 ‖ṗ_ref − v‖² + 0.005 ‖ω‖².
//!
//! - DIFFERENCE: the spin term counts the three angular rates; the published one all six velocities (defect 15).
//! - DIFFERENCE: total mass everywhere (defect 5).

use super::over::{FRAME_BODY, aligned, free_rig};
use super::team::{
    carried_slices, lowest, mean_throttle_difference, observe_drones, observe_load, observe_others, observe_own,
    squared_sum,
};
use crate::autodiff::{Pen, Scalar, safe};
use crate::controllers::reference::Reference;
use crate::dynamics::spatial::{Vec3, dot, sub};
use crate::error::Result;
use crate::tasks::config::EnvConfig;
use crate::tasks::path::{AHEAD, PATH, Path};
use crate::tasks::reward::{bell, smooth_norm, tip};
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{End, Metric, Setting, Sheet, Slice, Term};
use crate::tasks::task::{ANY_YAW, Ends, START_TILT, Start, Task, View, Wanted};
use serde::{Deserialize, Serialize};

/// Look-ahead points.
const POINTS: usize = 4;
/// From the path's origin to the point to look at, m.
const LOOK: f64 = 3.0;

/// Settings of [`OverTrack`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OverTrackSettings {
    /// What flies at every arm.
    pub vehicle: String,
    /// Drones.
    pub n_drone: usize,
    /// T, steps.
    pub horizon: usize,
    /// Largest distance from the path, m.
    pub reset_distance: f64,
}

impl Default for OverTrackSettings {
    fn default() -> Self {
        Self { vehicle: "hummingbird".into(), n_drone: 4, horizon: 500, reset_distance: 0.5 }
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct OverTrack {
    rig: Rig,
    settings: OverTrackSettings,
    path: Path,
}

impl OverTrack {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`] and [`free_rig`].
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let settings: OverTrackSettings = config.settings()?;
        let path = Path {
            vertical: 0.6,
            scale: [[2.4, 2.4, 1.2], [3.6, 3.6, 1.6]],
            rate: [0.8, 1.1],
            origin: [0.0, 0.0, 2.0],
            dt: config.dt,
        };
        Ok(Self { rig: free_rig(config, &settings.vehicle, settings.n_drone)?, settings, path })
    }

    /// p_ref(k + ahead) − p.
    #[inline(always)]
    fn error<S: Scalar>(&self, view: &View<'_, S>, ahead: usize) -> Vec3<S> {
        let point = self.path.at(&view.goal, view.step + S::constant(ahead as f64));
        sub(point, view.frame(FRAME_BODY).position)
    }

    /// u_t.
    #[inline(always)]
    fn wanted_up<S: Scalar>(view: &View<'_, S>) -> Vec3<S> {
        safe::normalise(sub(view.goal.array(PATH), view.frame(FRAME_BODY).position))
    }

    /// What follows the drones in observations.
    #[inline(always)]
    fn observe_shared<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        let frame = view.frame(FRAME_BODY);
        for i in 0..POINTS {
            out.array(self.error(view, AHEAD * i));
        }
        out.array(sub(Self::wanted_up(view), frame.up()));
        observe_load(view, &frame, out);
    }

    /// Draws path and point to look at; returns where the path starts.
    fn draw(&self, start: &mut Start<'_>) -> Vec3<f64> {
        let first = self.path.draw(start, 0);
        let along = safe::normalise([0, 1, 2].map(|_| start.task.normal()));
        let look = [LOOK * along[0], LOOK * along[1], (LOOK * along[2]).abs() + 0.1];
        for i in 0..3 {
            start.goal[PATH + i] = self.path.origin[i] + look[i];
        }
        first
    }
}

impl Task for OverTrack {
    fn rig(&self) -> &Rig {
        &self.rig
    }

    fn horizon(&self) -> usize {
        self.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let ahead = [
            Slice::new("path", 3 * POINTS, "m, world", "p_ref(k + 5i) − p for i = 0 … 3"),
            Slice::new("up_error", 3, "-, world", "u_t − u"),
        ];
        let (observation, central) = carried_slices(&self.rig, "frame", false, &ahead);
        let mut goal = Path::slices();
        goal.push(Slice::new("look", 3, "m, world", "a"));
        Sheet {
            observation,
            central,
            reward: vec![
                Term::piecewise("pose", "r_p = e^{−1.2 d}", 1.0),
                Term::piecewise("up", "r_p ((u·u_t + 1)/2)²", 1.0),
                Term::piecewise("spin", "r_p/(1 + (|ω_x| + |ω_y| + |ω_z|)²)", 1.0),
                Term::smooth("effort", "0.25 · mean e^{−e_i}", 0.25),
            ],
            ends: vec![End::new("crash", "min z_i < 0.2 m"), End::new("far", "d > `reset_distance`")],
            metrics: vec![
                Metric { name: "position_error", unit: "m" },
                Metric { name: "up_alignment", unit: "-" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal,
            memo: Vec::new(),
            settings: vec![
                Setting::new("vehicle", "\"hummingbird\"", "what flies at every arm"),
                Setting::new("n_drone", 4, "drones: 2, 4 or 6"),
                Setting::new("horizon", 500, "T, steps"),
                Setting::new("reset_distance", 0.5, "largest distance from the path, m").positive(),
            ],
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        let position = self.draw(start);
        let attitude = start.attitude(START_TILT, ANY_YAW);
        start.place(FRAME_BODY, position, attitude);
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, view: &View<'_, S>, agent: usize, out: &mut Pen<'_, S>) {
        observe_own(view, agent, view.frame(FRAME_BODY).position, out);
        observe_others(view, agent, false, out);
        self.observe_shared(view, out);
    }

    #[inline(always)]
    fn central<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        observe_drones(view, view.frame(FRAME_BODY).position, out);
        self.observe_shared(view, out);
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        let frame = view.frame(FRAME_BODY);
        let pose = tip(1.2, self.error(view, 0));
        terms.number(pose);
        terms.number(pose * aligned(frame.up(), Self::wanted_up(view)));
        terms.number(pose * bell(1.0, squared_sum(frame.angular_velocity)));
        terms.number(S::constant(0.25) * view.mean_effort_reward());
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        let far = self.settings.reset_distance;
        ends.when(lowest(view).lt(S::constant(0.2)));
        ends.when(S::constant(far * far).lt(safe::squared_norm(self.error(view, 0))));
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.number(safe::norm(self.error(view, 0)));
        out.number(dot(view.frame(FRAME_BODY).up(), Self::wanted_up(view)));
        out.number(mean_throttle_difference(view));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        safe::squared_norm(self.error(view, 0)).lt(S::constant(0.09))
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let frame = view.frame(FRAME_BODY);
        let slip = sub(self.path.velocity(&view.goal, view.step), frame.velocity);
        let tilt = sub(Self::wanted_up(view), frame.up());
        let position = smooth_norm(self.error(view, 0), 0.1);
        let motion = S::constant(0.02) * safe::squared_norm(slip);
        let turn = S::constant(0.3) * safe::squared_norm(tilt);
        position + motion + turn + S::constant(0.005) * safe::squared_norm(frame.angular_velocity)
    }

    fn wanted(&self, view: &View<'_, f64>) -> Option<Wanted> {
        let yaw = view.frame(FRAME_BODY).yaw();
        Some(Wanted::one(Reference::Lemniscate(self.path.reference(&view.goal, yaw))))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let position = self.draw(start);
        // the shortest turn from e_z to u_t, which points upwards
        let look = [0, 1, 2].map(|i| start.goal[PATH + i]);
        let up = safe::normalise(sub(look, position));
        start.place(FRAME_BODY, position, safe::normalise([1.0 + up[2], -up[1], up[0], 0.0]));
    }
}
