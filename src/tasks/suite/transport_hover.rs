//! TransportHover: drones on bars bring a box of unknown mass to a point and hold it there, with a heading.
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
//! | `target` | 3 | m, world | p_t − p | smooth |
//! | `heading_error` | 3 | -, world | h_t − h | smooth |
//! | `box_attitude` | 4 | -, body → world | unit quaternion, w ≥ 0 | non-smooth |
//! | `box_velocity` | 3 | m/s, world | v | smooth |
//! | `box_angular_velocity` | 3 | rad/s, world | ω | smooth |
//! | `box_heading` | 3 | -, world | h = R e_x | smooth |
//! | `box_up` | 3 | -, world | u = R e_z | smooth |
//! | `clock` | 4 | - | k/T, four times | smooth |
//! | *total* | 95 | | | |
//!
//! | Reward | term | at most | |
//! |---|---|---|---|
//! | `pose` | r_s r_p, r_p = e^{−1.2 ‖(p_t − p, h_t − h)‖} | 1 | piecewise |
//! | `up` | r_s r_p ((u_z + 1)/2)² | 1 | piecewise |
//! | `spin` | 0.8 r_s r_p e^{−(|ω_x| + |ω_y| + |ω_z|)²} | 0.8 | piecewise |
//! | `swing` | 0.8 r_s r_p e^{−(|v_x| + |v_y| + |v_z|)²} | 0.8 | piecewise |
//! | `joints` | 0.5 r_s mean(1 − q̂²) | 0.5 | piecewise |
//! | `effort` | 0.2 r_s · mean e^{−e_i} | 0.2 | piecewise |
//! | *sum* | | 4.3 | |
//!
//! | Episode end | when |
//! |---|---|
//! | `crash` | min z_i < 0.2 m |
//! | `grounded` | the box reaches below z = 0 |
//! | `diverged` | a number of the state leaves ±1e8 |
//! | *truncated* | k ≥ `horizon` |
//!
//! | Configuration | default | meaning |
//! |---|---|---|
//! | `vehicle` | "hummingbird" | what flies on every bar |
//! | `n_drone` | 4 | drones: 4 or 6 |
//! | `horizon` | 500 | T, steps |
//!
//! p, h, u, v, ω box (world), p_i drones, e_i = Σ s effort of drone i, q̂ angles of the bars' joints as shares of their
//! range of ±120°, sep the least distance of two drones, r_s = min((sep/0.5 m)², 1), k steps. Mass of the box: uniform in
//! [0.5, 0.8] Σ m_i. Target: (0, 0, 2) m, heading h_t at any yaw. Start: box uniform in ±3 × ±3 × [1, 2.5] m, level, any
//! yaw, drones upright above it, at rest.
//!
//! - Success: `position_error` < 0.1 m.
//! - Loss: √(‖p_t − p‖² + 0.1²) + 0.3 (‖h_t − h‖² + ‖e_z − u‖²) + 0.02 ‖v‖² + 0.005 ‖ω‖².
//!
//! - DIFFERENCE: the box's inertia follows its mass (defect 25); its damping, published as 0.1 1/s, is that of a mass of
//!   0.65 Σ m_i.
//! - DIFFERENCE: q̂ runs over all bars' joints by name; published code reads 16, whatever their number (defect 24).
//! - DIFFERENCE: integrated semi-implicitly, whatever `integrator` says, see [`stiff_physics`](super::transport::stiff_physics).
//! - DIFFERENCE: `grounded` ends the episode, for there is no ground; the published box comes to rest on one.
//! - DIFFERENCE: total mass everywhere; the published share counts base links alone (defect 5).

use super::team::{
    TeamSettings, carried_slices, lowest, mean_throttle_difference, observe_drones, observe_load, observe_others,
    observe_own, squared_separation,
};
use super::transport::{BOX, Load, free_rig, load_loss, steady, steady_terms};
use crate::autodiff::{Pen, Scalar, safe};
use crate::dynamics::spatial::{Vec3, constants, dot, sub, yawed};
use crate::error::Result;
use crate::tasks::config::EnvConfig;
use crate::tasks::reward::{both, tip};
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{End, Metric, Setting, Sheet, Slice};
use crate::tasks::task::{ANY_YAW, Ends, Start, Task, View, Wanted};

/// The target, m, world.
const TARGET: [f64; 3] = [0.0, 0.0, 2.0];

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct TransportHover {
    rig: Rig,
    settings: TeamSettings,
    load: Load,
}

impl TransportHover {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`] and [`free_rig`].
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let settings: TeamSettings = config.settings()?;
        let (rig, load) = free_rig(config, &settings.vehicle, settings.n_drone)?;
        Ok(Self { rig, settings, load })
    }

    /// p_t − p.
    #[inline(always)]
    fn error<S: Scalar>(view: &View<'_, S>) -> Vec3<S> {
        sub(constants(TARGET), view.frame(BOX).position)
    }

    /// h_t − h.
    #[inline(always)]
    fn heading_error<S: Scalar>(view: &View<'_, S>) -> Vec3<S> {
        sub(view.goal.array(0), view.frame(BOX).heading())
    }

    /// What follows the drones in observations.
    #[inline(always)]
    fn observe_shared<S: Scalar>(view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.array(Self::error(view));
        out.array(Self::heading_error(view));
        observe_load(view, &view.frame(BOX), out);
    }
}

impl Task for TransportHover {
    fn rig(&self) -> &Rig {
        &self.rig
    }

    fn horizon(&self) -> usize {
        self.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let errors =
            [Slice::new("target", 3, "m, world", "p_t − p"), Slice::new("heading_error", 3, "-, world", "h_t − h")];
        let (observation, central) = carried_slices(&self.rig, "box", true, &errors);
        Sheet {
            observation,
            central,
            reward: steady_terms("e^{−1.2 ‖(p_t − p, h_t − h)‖}", 0.2),
            ends: vec![End::new("crash", "min z_i < 0.2 m"), End::new("grounded", "the box reaches below z = 0")],
            metrics: vec![
                Metric { name: "position_error", unit: "m" },
                Metric { name: "heading_alignment", unit: "-" },
                Metric { name: "uprightness", unit: "-" },
                Metric { name: "separation", unit: "m" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal: vec![Slice::new("target_heading", 3, "-, world", "h_t")],
            memo: Vec::new(),
            settings: vec![
                Setting::new("vehicle", "\"hummingbird\"", "what flies on every bar"),
                Setting::new("n_drone", 4, "drones: 4 or 6"),
                Setting::new("horizon", 500, "T, steps"),
            ],
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        self.load.draw_mass(start);
        let yaw = start.task.uniform(ANY_YAW.0, ANY_YAW.1);
        start.goal.copy_from_slice(&yawed(yaw));
        let position = start.position([-3.0, -3.0, 1.0], [3.0, 3.0, 2.5]);
        let attitude = start.attitude(0.0, ANY_YAW);
        start.place(BOX, position, attitude);
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, view: &View<'_, S>, agent: usize, out: &mut Pen<'_, S>) {
        observe_own(view, agent, view.frame(BOX).position, out);
        observe_others(view, agent, true, out);
        Self::observe_shared(view, out);
    }

    #[inline(always)]
    fn central<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        observe_drones(view, view.frame(BOX).position, out);
        Self::observe_shared(view, out);
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        let pose = tip(1.2, both(Self::error(view), Self::heading_error(view)));
        steady(view, &self.load, pose, 0.2, terms);
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        ends.when(lowest(view).lt(S::constant(0.2)));
        ends.when(self.load.height(view).lt(S::zero()));
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        let frame = view.frame(BOX);
        out.number(safe::norm(Self::error(view)));
        out.number(dot(frame.heading(), view.goal.array(0)));
        out.number(frame.up()[2]);
        out.number(squared_separation(view).sqrt());
        out.number(mean_throttle_difference(view));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        safe::squared_norm(Self::error(view)).lt(S::constant(0.01))
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let heading = S::constant(0.3) * safe::squared_norm(Self::heading_error(view));
        load_loss(&view.frame(BOX), Self::error(view), [S::zero(); 3]) + heading
    }

    fn wanted(&self, view: &View<'_, f64>) -> Option<Wanted> {
        Some(Wanted::way(&view.frame(BOX), TARGET, view.goal.get(1).atan2(view.goal.get(0)), 1.5))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        start.goal.copy_from_slice(&[1.0, 0.0, 0.0]);
        start.place(BOX, TARGET, [1.0, 0.0, 0.0, 0.0]);
    }
}
