//! Track: follow a lemniscate.
//!
//! | Observation | size | unit | meaning | |
//! |---|---|---|---|---|
//! | `path` | 12 | m, world | p_ref(k + 5i) − p for i = 0 … 3 | smooth |
//! | `attitude` | 4 | -, body → world | unit quaternion, w ≥ 0 | non-smooth |
//! | `velocity` | 3 | m/s, world | v | smooth |
//! | `angular_velocity` | 3 | rad/s, world | ω | smooth |
//! | `heading` | 3 | -, world | h = R e_x | smooth |
//! | `up` | 3 | -, world | u = R e_z | smooth |
//! | `throttle` | 4 | - | 2s − 1, s = Ω/Ω_max | smooth |
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
//! | `crash` | z < 0.1 m |
//! | `far` | d > `reset_distance` |
//! | `diverged` | a number of the state leaves ±1e8 |
//! | *truncated* | k ≥ `horizon` |
//!
//! | Configuration | default | meaning |
//! |---|---|---|
//! | `vehicle` | "hummingbird" | what flies |
//! | `horizon` | 600 | T, steps |
//! | `reset_distance` | 0.5 | largest distance from the path, m |
//!
//! p drone, v, ω velocity and angular velocity (world), u = R e_z, e = Σ s effort, k steps, p_ref(k) the path
//! (a [lemniscate](crate::tasks::path) of vertical part c, scale S and rate w) with c within ±0.6, S within
//! (1.8, 1.8, 1) … (3.2, 3.2, 1.5) m, |w| within 0.8 … 1.1 rad/s about (0, 0, 2) m. Start: on the path, roll and pitch
//! within ±0.2π, any yaw, at rest. d = ‖p_ref(k) − p‖.
//!
//! - Success: `position_error` < 0.3 m.
//! - Loss: √(d² + 0.1²) + 0.02 ‖ṗ_ref − v‖² + 0.005 ‖ω‖².
//!
//! - DIFFERENCE: truncates at T; published code one step before (defect 27).
//! - DIFFERENCE: no wind of eight sines, which is off in the published defaults; `randomise` has a constant one per episode:
//!   `{ what = "wind", range = [-1.0, 1.0], by = "set" }`.
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).
//! - DIFFERENCE: `position_error` is positive; the published tracking error is its negative (defect 27).

use crate::autodiff::{Pen, Scalar, safe};
use crate::controllers::reference::Reference;
use crate::dynamics::spatial::sub;
use crate::error::Result;
use crate::tasks::config::EnvConfig;
use crate::tasks::path::{AHEAD, PATH, Path};
use crate::tasks::reward::{bell, smooth_norm, still, tip};
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{End, Metric, Setting, Sheet, Slice, Term, total};
use crate::tasks::suite::{clock_slice, drone_slices};
use crate::tasks::task::{ANY_YAW, Ends, START_TILT, Start, Task, View, Wanted};
use serde::{Deserialize, Serialize};

/// Look-ahead points.
const POINTS: usize = 4;

/// Settings of [`Track`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrackSettings {
    /// What flies.
    pub vehicle: String,
    /// T, steps.
    pub horizon: usize,
    /// Largest distance from the path, m.
    pub reset_distance: f64,
}

impl Default for TrackSettings {
    fn default() -> Self {
        Self { vehicle: "hummingbird".into(), horizon: 600, reset_distance: 0.5 }
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Track {
    rig: Rig,
    settings: TrackSettings,
    path: Path,
}

impl Track {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`] and [`EnvConfig::single_rig`].
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let settings: TrackSettings = config.settings()?;
        let path = Path {
            vertical: 0.6,
            scale: [[1.8, 1.8, 1.0], [3.2, 3.2, 1.5]],
            rate: [0.8, 1.1],
            origin: [0.0, 0.0, 2.0],
            dt: config.dt,
        };
        Ok(Self { rig: config.single_rig(&settings.vehicle)?, settings, path })
    }

    /// p_ref(k + ahead) − p.
    #[inline(always)]
    fn error<S: Scalar>(&self, view: &View<'_, S>, ahead: usize) -> [S; 3] {
        let point = self.path.at(&view.goal, view.step + S::constant(ahead as f64));
        sub(point, view.drone(0).position)
    }
}

impl Task for Track {
    fn rig(&self) -> &Rig {
        &self.rig
    }

    fn horizon(&self) -> usize {
        self.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let mut observation = vec![Slice::new("path", 3 * POINTS, "m, world", "p_ref(k + 5i) − p for i = 0 … 3")];
        observation.extend(drone_slices(self.rig.drone()));
        observation.push(clock_slice());
        let goal = Path::slices();
        debug_assert_eq!(total(&goal), PATH);
        Sheet {
            observation,
            central: Vec::new(),
            reward: vec![
                Term::piecewise("pose", "r_p = e^{−1.6 d}", 1.0),
                Term::piecewise("up", "0.5 r_p/(1 + (1 − u_z)²)", 0.5),
                Term::piecewise("spin", "0.5 r_p/(1 + ω_z²)", 0.5),
                Term::smooth("effort", "0.1 e^{−e}", 0.1),
            ],
            ends: vec![End::new("crash", "z < 0.1 m"), End::new("far", "d > `reset_distance`")],
            metrics: vec![
                Metric { name: "position_error", unit: "m" },
                Metric { name: "uprightness", unit: "-" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal,
            memo: Vec::new(),
            settings: vec![
                Setting::new("vehicle", "\"hummingbird\"", "what flies"),
                Setting::new("horizon", 600, "T, steps"),
                Setting::new("reset_distance", 0.5, "largest distance from the path, m").positive(),
            ],
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        let position = self.path.draw(start, 0);
        let attitude = start.attitude(START_TILT, ANY_YAW);
        start.place(0, position, attitude);
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, view: &View<'_, S>, _: usize, out: &mut Pen<'_, S>) {
        for i in 0..POINTS {
            out.array(self.error(view, AHEAD * i));
        }
        view.observe_drone(0, out);
        view.observe_clock(out);
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        let (drone, half) = (view.drone(0), S::constant(0.5));
        let pose = tip(1.6, self.error(view, 0));
        terms.number(pose);
        terms.number(half * pose * bell(1.0, (S::one() - drone.up()[2]).square()));
        terms.number(half * pose * still(drone.angular_velocity));
        terms.number(S::constant(0.1) * (-view.effort(0)).exp());
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        let far = self.settings.reset_distance;
        ends.when(view.drone(0).position[2].lt(S::constant(0.1)));
        ends.when(S::constant(far * far).lt(safe::squared_norm(self.error(view, 0))));
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.number(safe::norm(self.error(view, 0)));
        out.number(view.drone(0).up()[2]);
        out.number(view.throttle_difference(0));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        safe::squared_norm(self.error(view, 0)).lt(S::constant(0.09))
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let drone = view.drone(0);
        let slip = sub(self.path.velocity(&view.goal, view.step), drone.velocity);
        let position = smooth_norm(self.error(view, 0), 0.1);
        let speed = S::constant(0.02) * safe::squared_norm(slip);
        position + speed + S::constant(0.005) * safe::squared_norm(drone.angular_velocity)
    }

    fn wanted(&self, view: &View<'_, f64>) -> Option<Wanted> {
        Some(Wanted::one(Reference::Lemniscate(self.path.reference(&view.goal, view.drone(0).yaw()))))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let position = self.path.draw(start, 0);
        start.place(0, position, [1.0, 0.0, 0.0, 0.0]);
    }
}
