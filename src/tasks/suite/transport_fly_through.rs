//! TransportFlyThrough: drones on bars take a box of unknown mass between two beams, bars lowered to fit.
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
//! | `bars` | 4 | m, world | (x, z) of lower and upper bar − (x, z) of p | smooth |
//! | `box_attitude` | 4 | -, body → world | unit quaternion, w ≥ 0 | non-smooth |
//! | `box_velocity` | 3 | m/s, world | v | smooth |
//! | `box_angular_velocity` | 3 | rad/s, world | ω | smooth |
//! | `box_heading` | 3 | -, world | h = R e_x | smooth |
//! | `box_up` | 3 | -, world | u = R e_z | smooth |
//! | `clock` | 4 | - | k/T, four times | smooth |
//! | *total* | 96 | | | |
//!
//! | Reward | term | at most | |
//! |---|---|---|---|
//! | `pose` | r_s r_p, r_p = e^{−‖p_t − p‖} | 1 | piecewise |
//! | `up` | r_s r_p ((u_z + 1)/2)² | 1 | piecewise |
//! | `joints` | 0.5 r_s mean(1 − q̂²) | 0.5 | piecewise |
//! | `effort` | 0.2 r_s · mean e^{−e_i} | 0.2 | piecewise |
//! | *sum* | | 2.7 | |
//!
//! | Episode end | when |
//! |---|---|
//! | `crash` | min z_i < 0.2 m |
//! | `high` | max z_i > 3.6 m |
//! | `box_low` | z < 0.3 m |
//! | `collision` | c < 0, if `reset_on_collision` |
//! | `diverged` | a number of the state leaves ±1e8 |
//! | *truncated* | k ≥ `horizon` |
//!
//! | Configuration | default | meaning |
//! |---|---|---|
//! | `vehicle` | "hummingbird" | what flies on every bar |
//! | `n_drone` | 4 | drones: 4 or 6 |
//! | `horizon` | 500 | T, steps |
//! | `reset_on_collision` | false | whether touching a beam ends the episode |
//!
//! p, u, v, ω box (world), p_i drones, e_i = Σ s effort of drone i, q̂ angles of the joints of the bars that carry it
//! as shares of their range of ±120°, sep the least distance of two drones, r_s = min((sep/0.5 m)², 1), c clearance:
//! the least distance of the rig's bodies to a beam, negative in contact. Beams (`bars` when observed): two level
//! capsules along y of radius 0.04 m and length 5 m at x = 0, z = 1.2 m and 1 to 1.2 m above; the group is 1.3 m high.
//! Mass of the box: uniform in [0.5, 0.8] Σ m_i. Target: uniform in [1.75, 2.25] × ±0.2 × [1.25, 1.75] m. Start: box
//! uniform in [−2.5, −1.5] × ±0.5 × [1, 2] m, level, yaw within ±0.5π, drones upright above it, at rest.
//!
//! - Success: `position_error` < 0.2 m with all drones beyond x = 0.05 m, once in the episode.
//! - Loss: √(‖p_t − p‖² + 0.1²) + 0.3 ‖e_z − u‖² + 0.02 ‖v‖² + 0.005 ‖ω‖² of the box + 0.5 e^{−10 max(`clearance`,
//!   −0.2 m)}.
//!
//! - DIFFERENCE: the box's inertia follows its mass (defect 25); its damping, published as 0.1 1/s, is that of a mass of
//!   0.65 Σ m_i.
//! - DIFFERENCE: q̂ runs over all bars' joints by name; published code reads 16, whatever their number (defect 24).
//! - DIFFERENCE: integrated semi-implicitly, whatever `integrator` says, see [`stiff_physics`],
//!   in substeps of at most 4 ms.
//! - DIFFERENCE: total mass everywhere; the published share counts base links alone (defect 5).
//! - DIFFERENCE: contact is that of capsules in the boxes of load and vehicles, on a material as of rubber.
//! - DIFFERENCE: starts that touch a beam are drawn again; those of our vehicles never do.

use super::obstacles::{Bars, Skin, course, nearness, rounded, touches, touching, where_on};
use super::team::{
    CourseSettings, apart, arrived, carried_slices, clearance, course_memo, highest, hindmost, lowest,
    mean_throttle_difference, observe_drones, observe_load, observe_others, observe_own, squared_separation,
};
use super::transport::{APART, BOX, Load, group, load_loss, stiff_physics};
use crate::autodiff::{Mask, Pen, Scalar, safe};
use crate::dynamics::shape::Pose;
use crate::dynamics::spatial::{Vec3, sub};
use crate::error::Result;
use crate::tasks::config::EnvConfig;
use crate::tasks::reward::{tip, upright};
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{End, Metric, Setting, Sheet, Slice, Term};
use crate::tasks::task::{Ends, Start, Task, View};
use std::f64::consts::FRAC_PI_2;

/// Of the beams, lowest and highest, m.
const SPACING: [f64; 2] = [1.0, 1.2];
/// Where their heights stand in the goal.
const HEIGHTS: usize = 3;

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct TransportFlyThrough {
    rig: Rig,
    settings: CourseSettings,
    load: Load,
    bars: Bars,
    /// Of starts.
    rest: Skin,
}

impl TransportFlyThrough {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`], [`EnvConfig::vehicle`] and [`group`].
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let settings: CourseSettings = config.settings()?;
        let vehicle = config.vehicle(&settings.vehicle)?;
        let built = group(&rounded(&vehicle), settings.n_drone, true)?;
        let load = Load::new(&vehicle, &built);
        let model = course("transport_fly_through", built.model, &Bars::scene(SPACING))?;
        let rig = Rig::of_model(&model, stiff_physics(touching(config)), Some(&vehicle), |_| Vec::new())?;
        let (bars, rest) = (Bars::of(&model, SPACING, HEIGHTS), Skin::at_rest(&rig, &model));
        Ok(Self { rig: rig.varying_inertial(BOX).varying(bars.numbers()), settings, load, bars, rest })
    }

    /// p_t − p.
    #[inline(always)]
    fn error<S: Scalar>(view: &View<'_, S>) -> Vec3<S> {
        sub(view.goal.array(0), view.frame(BOX).position)
    }

    /// What follows the drones in observations.
    #[inline(always)]
    fn observe_shared<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        let frame = view.frame(BOX);
        out.array(Self::error(view));
        self.bars.observe(view, frame.position, out);
        observe_load(view, &frame, out);
    }
}

impl Task for TransportFlyThrough {
    fn rig(&self) -> &Rig {
        &self.rig
    }

    fn horizon(&self) -> usize {
        self.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let shared = [Slice::new("target", 3, "m, world", "p_t − p"), Bars::observed()];
        let (observation, central) = carried_slices(&self.rig, "box", true, &shared);
        Sheet {
            observation,
            central,
            reward: vec![
                Term::piecewise("pose", "r_s r_p, r_p = e^{−‖p_t − p‖}", 1.0),
                Term::piecewise("up", "r_s r_p ((u_z + 1)/2)²", 1.0),
                Term::piecewise("joints", "0.5 r_s mean(1 − q̂²)", 0.5),
                Term::piecewise("effort", "0.2 r_s · mean e^{−e_i}", 0.2),
            ],
            ends: vec![
                End::new("crash", "min z_i < 0.2 m"),
                End::new("high", "max z_i > 3.6 m"),
                End::new("box_low", "z < 0.3 m"),
                End::new("collision", "c < 0, if `reset_on_collision`"),
            ],
            metrics: vec![
                Metric { name: "position_error", unit: "m" },
                Metric { name: "uprightness", unit: "-" },
                Metric { name: "separation", unit: "m" },
                Metric { name: "clearance", unit: "m" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal: vec![Slice::new("target", 3, "m, world", "p_t"), Bars::slice()],
            memo: course_memo(),
            settings: vec![
                Setting::new("vehicle", "\"hummingbird\"", "what flies on every bar"),
                Setting::new("n_drone", 4, "drones: 4 or 6"),
                Setting::new("horizon", 500, "T, steps"),
                Setting::new("reset_on_collision", false, "whether touching a beam ends the episode"),
            ],
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        self.load.draw_mass(start);
        let r = &mut start.task;
        let target = [r.uniform(1.75, 2.25), r.uniform(-0.2, 0.2), r.uniform(1.25, 1.75)];
        start.goal[..HEIGHTS].copy_from_slice(&target);
        self.bars.draw(start);
        for _ in 0..100 {
            let position = start.position([-2.5, -0.5, 1.0], [-1.5, 0.5, 2.0]);
            let attitude = start.attitude(0.0, (-FRAC_PI_2, FRAC_PI_2));
            start.place(BOX, position, attitude);
            if self.bars.clear_of(start, &self.rest, &Pose { position, attitude }) {
                break;
            }
        }
    }

    #[inline(always)]
    fn remember<S: Scalar>(&self, view: &View<'_, S>, memo: &mut Pen<'_, S>) {
        let near = safe::squared_norm(Self::error(view)).lt(S::constant(0.04));
        let here = near.and(S::constant(0.05).lt(hindmost(view)));
        memo.number(S::select(here, S::one(), arrived(view)));
        memo.number(self.bars.clearance(view));
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
        let near = apart(view, APART);
        let posed = near * tip(1.0, Self::error(view));
        terms.number(posed);
        terms.number(posed * upright(view.frame(BOX).up()));
        terms.number(near * self.load.straight(view));
        terms.number(near * S::constant(0.2) * view.mean_effort_reward());
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        ends.when(lowest(view).lt(S::constant(0.2)));
        ends.when(S::constant(3.6).lt(highest(view)));
        ends.when(view.frame(BOX).position[2].lt(S::constant(0.3)));
        ends.when(where_on::<S>(self.settings.reset_on_collision, touches(clearance(view))));
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.number(safe::norm(Self::error(view)));
        out.number(view.frame(BOX).up()[2]);
        out.number(squared_separation(view).sqrt());
        out.number(clearance(view));
        out.number(mean_throttle_difference(view));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        S::constant(0.5).lt(arrived(view))
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        load_loss(&view.frame(BOX), Self::error(view), [S::zero(); 3]) + nearness(clearance(view))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let target = [2.0, 0.0, 1.5];
        start.goal[..HEIGHTS].copy_from_slice(&target);
        self.bars.draw(start);
        start.place(BOX, target, [1.0, 0.0, 0.0, 0.0]);
    }
}
