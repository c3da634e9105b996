//! TransportTrack: drones on bars carry a box of unknown mass along a lemniscate.
//!
//! | Observation | size | unit | meaning | |
//! |---|---|---|---|---|
//! | `place` | 3 | m, world | p_i − p of the box | smooth |
//! | `attitude` | 4 | -, body → world | unit quaternion, w ≥ 0 | non-smooth |
//! | `velocity` | 3 | m/s, world | v | smooth |
//! | `angular_velocity` | 3 | rad/s, world | ω | smooth |
//! | `heading` | 3 | -, world | h = R e_x | smooth |
//! | `up` | 3 | -, world | u = R e_z | smooth |
//! | `throttle` | 4 | - | 2s − 1, s = Ω/Ω_max | smooth |
//! | `index` | 4 | - | 1 at i, else 0 | smooth |
//! | `others` | 42 | m, m, -, m/s, rad/s; world | p_i − p_j, ‖p_i − p_j‖, q_j, v_j, ω_j for every other j, ascending | non-smooth |
//! | `path` | 12 | m, world | p_ref(k + 5i) − p for i = 0 … 3 | smooth |
//! | `box_attitude` | 4 | -, body → world | unit quaternion, w ≥ 0 | non-smooth |
//! | `box_velocity` | 3 | m/s, world | v | smooth |
//! | `box_angular_velocity` | 3 | rad/s, world | ω | smooth |
//! | `box_heading` | 3 | -, world | h = R e_x | smooth |
//! | `box_up` | 3 | -, world | u = R e_z | smooth |
//! | `clock` | 4 | - | k/T, four times | smooth |
//! | *total* | 101 | | | |
//!
//! | Reward | term | at most | |
//! |---|---|---|---|
//! | `pose` | r_s r_p, r_p = e^{−1.2 d} | 1 | piecewise |
//! | `up` | r_s r_p ((u_z + 1)/2)² | 1 | piecewise |
//! | `spin` | 0.8 r_s r_p e^{−(|ω_x| + |ω_y| + |ω_z|)²} | 0.8 | piecewise |
//! | `swing` | 0.8 r_s r_p e^{−(|v_x| + |v_y| + |v_z|)²} | 0.8 | piecewise |
//! | `joints` | 0.5 r_s mean(1 − q̂²) | 0.5 | piecewise |
//! | `effort` | 0.1 r_s · mean e^{−e_i} | 0.1 | piecewise |
//! | *sum* | | 4.2 | |
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
//! | `vehicle` | "hummingbird" | what flies on every bar |
//! | `n_drone` | 4 | drones: 4 or 6 |
//! | `horizon` | 600 | T, steps |
//! | `reset_distance` | 0.7 | largest distance from the path, m |
//!
//! p, u, v, ω box (world), p_i drones, e_i = Σ s effort of drone i, q̂ angles of the bars' joints as shares of their
//! range of ±120°, sep the least distance of two drones, r_s = min((sep/0.5 m)², 1), k steps, p_ref(k) the path (a
//! [lemniscate](crate::tasks::path) of vertical part c, scale S and rate w) with c within ±0.6, S within (2.4, 2.4,
//! 1.2) … (3.6, 3.6, 1.6) m, |w| within 0.8 … 1.1 rad/s about (0, 0, 2) m. Mass of the box: uniform in [0.5, 0.8] Σ
//! m_i. Start: box on the path, level, any yaw, drones upright above it, at rest. d = ‖p_ref(k) − p‖.
//!
//! - Success: `position_error` < 0.3 m.
//! - Loss: √(d² + 0.1²) + 0.3 ‖e_z − u‖² + 0.02 ‖ṗ_ref − v‖² + 0.005 ‖ω‖².
//!
//! - DIFFERENCE: the box's inertia follows its mass (defect 25); its damping, published as 0.1 1/s, is that of a mass of
//!   0.65 Σ m_i.
//! - DIFFERENCE: q̂ runs over all bars' joints by name; published code reads 16, whatever their number (defect 24).
//! - DIFFERENCE: integrated semi-implicitly, whatever `integrator` says, see [`stiff_physics`](super::transport::stiff_physics).
//! - DIFFERENCE: total mass everywhere; the published share counts base links alone (defect 5).

use super::team::{
    carried_slices, lowest, mean_throttle_difference, observe_drones, observe_load, observe_others, observe_own,
    squared_separation,
};
use super::transport::{BOX, Load, free_rig, load_loss, steady, steady_terms};
use crate::autodiff::{Pen, Scalar, safe};
use crate::controllers::reference::Reference;
use crate::dynamics::spatial::{Vec3, sub};
use crate::error::Result;
use crate::tasks::config::EnvConfig;
use crate::tasks::path::{AHEAD, Path};
use crate::tasks::reward::tip;
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{End, Metric, Setting, Sheet, Slice};
use crate::tasks::task::{ANY_YAW, Ends, Start, Task, View, Wanted};
use serde::{Deserialize, Serialize};

/// Look-ahead points.
const POINTS: usize = 4;

/// Settings of [`TransportTrack`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TransportTrackSettings {
    /// What flies on every bar.
    pub vehicle: String,
    /// Drones.
    pub n_drone: usize,
    /// T, steps.
    pub horizon: usize,
    /// Largest distance from the path, m.
    pub reset_distance: f64,
}

impl Default for TransportTrackSettings {
    fn default() -> Self {
        Self { vehicle: "hummingbird".into(), n_drone: 4, horizon: 600, reset_distance: 0.7 }
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct TransportTrack {
    rig: Rig,
    settings: TransportTrackSettings,
    load: Load,
    path: Path,
}

impl TransportTrack {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`] and [`free_rig`].
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let settings: TransportTrackSettings = config.settings()?;
        let (rig, load) = free_rig(config, &settings.vehicle, settings.n_drone)?;
        let path = Path {
            vertical: 0.6,
            scale: [[2.4, 2.4, 1.2], [3.6, 3.6, 1.6]],
            rate: [0.8, 1.1],
            origin: [0.0, 0.0, 2.0],
            dt: config.dt,
        };
        Ok(Self { rig, settings, load, path })
    }

    /// p_ref(k + ahead) − p.
    #[inline(always)]
    fn error<S: Scalar>(&self, view: &View<'_, S>, ahead: usize) -> Vec3<S> {
        let point = self.path.at(&view.goal, view.step + S::constant(ahead as f64));
        sub(point, view.frame(BOX).position)
    }

    /// What follows the drones in observations.
    #[inline(always)]
    fn observe_shared<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        for i in 0..POINTS {
            out.array(self.error(view, AHEAD * i));
        }
        observe_load(view, &view.frame(BOX), out);
    }
}

impl Task for TransportTrack {
    fn rig(&self) -> &Rig {
        &self.rig
    }

    fn horizon(&self) -> usize {
        self.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let ahead = [Slice::new("path", 3 * POINTS, "m, world", "p_ref(k + 5i) − p for i = 0 … 3")];
        let (observation, central) = carried_slices(&self.rig, "box", true, &ahead);
        Sheet {
            observation,
            central,
            reward: steady_terms("e^{−1.2 d}", 0.1),
            ends: vec![End::new("crash", "min z_i < 0.2 m"), End::new("far", "d > `reset_distance`")],
            metrics: vec![
                Metric { name: "position_error", unit: "m" },
                Metric { name: "uprightness", unit: "-" },
                Metric { name: "separation", unit: "m" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal: Path::slices(),
            memo: Vec::new(),
            settings: vec![
                Setting::new("vehicle", "\"hummingbird\"", "what flies on every bar"),
                Setting::new("n_drone", 4, "drones: 4 or 6"),
                Setting::new("horizon", 600, "T, steps"),
                Setting::new("reset_distance", 0.7, "largest distance from the path, m").positive(),
            ],
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        self.load.draw_mass(start);
        let position = self.path.draw(start, 0);
        let attitude = start.attitude(0.0, ANY_YAW);
        start.place(BOX, position, attitude);
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, view: &View<'_, S>, agent: usize, out: &mut Pen<'_, S>) {
        observe_own(view, agent, view.frame(BOX).position, out);
        observe_others(view, agent, true, out);
        self.observe_shared(view, out);
    }

    #[inline(always)]
    fn central<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        observe_drones(view, view.frame(BOX).position, out);
        self.observe_shared(view, out);
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        steady(view, &self.load, tip(1.2, self.error(view, 0)), 0.1, terms);
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
        out.number(view.frame(BOX).up()[2]);
        out.number(squared_separation(view).sqrt());
        out.number(mean_throttle_difference(view));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        safe::squared_norm(self.error(view, 0)).lt(S::constant(0.09))
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let wanted = self.path.velocity(&view.goal, view.step);
        load_loss(&view.frame(BOX), self.error(view, 0), wanted)
    }

    fn wanted(&self, view: &View<'_, f64>) -> Option<Wanted> {
        let yaw = view.frame(BOX).yaw();
        Some(Wanted::one(Reference::Lemniscate(self.path.reference(&view.goal, yaw))))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let position = self.path.draw(start, 0);
        start.place(BOX, position, [1.0, 0.0, 0.0, 0.0]);
    }
}
