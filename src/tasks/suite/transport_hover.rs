//! TransportHover: drones on bars bring a box of unknown mass to a point and hold it there, with a heading.
//!
//! - DIFFERENCE: the box's inertia follows its mass (defect 25); its damping, published as 0.1 1/s, is that of a mass of
//!   0.65 Σ m_i.
//! - DIFFERENCE: q̂ runs over all bars' joints by name; published code reads 16, whatever their number (defect 24).
//! - DIFFERENCE: q̂² counts up to 1, at the stops; published rewards fall without end beyond them.
//! - DIFFERENCE: integrated semi-implicitly, whatever `integrator` says, see `stiff_physics`.
//! - DIFFERENCE: `grounded` ends the episode, for there is no ground; the published box comes to rest on one.
//! - DIFFERENCE: total mass everywhere; the published share counts base links alone (defect 5).

use super::hover::set_heading;
use super::team::{lowest, mean_throttle_difference, observe_load, observes_team, squared_separation};
use super::transport::{
    BOX, BOX_NAMES, GroupLoss, GroupSettings, Load, SteadyReward, TO_TARGET, free_robot, group_loss, steady,
};
use super::{PoseSuccess, StartAttitude, StartRange, less, made_of, squared, succeeds_within};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{both, exponential_kernel};
use crate::robot::Robot;
use crate::settings;
use crate::start::{ANY_YAW, Start};
use crate::task::{BuiltIn, Task, TaskReference, View};
use autodiff::{Array, Mask, Scalar, Trace, safe};
use base::error::Result;
use dynamics::spatial::{Vec3, constants, dot, sub, yawed};

/// Where starts are.
fn start_range() -> StartRange {
    let position = [[-3.0, 3.0], [-3.0, 3.0], [1.0, 2.5]];
    StartRange { position, attitude: StartAttitude { tilt: 0.0, ..StartAttitude::default() } }
}

settings! {
    /// Settings of [`TransportHover`].
    pub(crate) struct TransportHoverSettings {
        group: GroupSettings = GroupSettings::default() => flat;
        horizon: usize = 500 => ("steps", "T", Any);
        target: [f64; 3] = [0.0, 0.0, 2.0] => ("m, world", "p_t", Any);
        start: StartRange = start_range() => group;
        min_height: f64 = 0.2 => ("m", "a lower drone is a crash", Any);
        success: PoseSuccess = PoseSuccess::default() => group;
        pose_scale: f64 = 1.2 => ("1/m", "how steeply r_p falls", NotNegative);
        reward: SteadyReward = SteadyReward::default() => group;
        loss: GroupLoss = GroupLoss::default() => group;
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct TransportHover {
    robot: Robot,
    settings: TransportHoverSettings,
    load: Load,
}

impl BuiltIn for TransportHover {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: TransportHoverSettings = config.settings()?;
        let (robot, load) = free_robot(config, &settings.group)?;
        Ok(Self { robot, settings, load })
    }
}

impl TransportHover {
    /// p_t − p.
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(constants(self.settings.target), view.frame(BOX).position)
    }

    /// h_t − h.
    fn heading_error<S: Scalar>(view: &View<'_, S>) -> Vec3<S> {
        sub(view.goal.array(0), view.frame(BOX).heading())
    }

    /// What follows the drones in observations.
    fn observe_shared(&self, view: &View, out: &mut Writer) {
        out.field("target", "m, world", "p_t − p").array(self.error(view));
        out.field("heading_error", "-, world", "h_t − h").within(-2.0, 2.0).array(Self::heading_error(view));
        observe_load(view, &BOX_NAMES, &view.frame(BOX), out);
    }
}

impl Task for TransportHover {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p, h, u, v, ω box (world), p_i drones, e_i = Σ s effort of drone i, q̂ angles of the bars' joints as shares \
         of their range of ±120°, sep the least distance of two drones, r_s = min((sep/{separation} m)², 1), k steps. \
         Mass of the box: uniform in {box_share} Σ m_i. Target: {target} m, heading h_t at any yaw. Start: box \
         uniform in {start_position} m, roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, drones \
         upright above it, at rest."
    }

    fn start(&self, start: &mut Start<'_>) {
        self.load.draw_mass(start);
        let heading = yawed(start.task.uniform(ANY_YAW[0], ANY_YAW[1]));
        set_heading(start, heading);
        let (position, attitude) = self.settings.start.draw(start);
        start.place(BOX, position, attitude);
    }

    observes_team!(self, BOX, true);

    fn reward(&self, view: &View, terms: &mut Writer) {
        let w = &self.settings.reward;
        let pose = exponential_kernel(self.settings.pose_scale, both(self.error(view), Self::heading_error(view)));
        terms.term("pose", "{×reward_pose}r_s r_p, r_p = e^{−{×pose_scale}‖(p_t − p, h_t − h)‖}", w.carry.pose);
        steady(view, &self.load, pose, w, terms);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        ends.when("crash", "min z_i < {min_height} m", less(lowest(view), self.settings.min_height));
        ends.when("grounded", "the box reaches below z = 0", self.load.height(view).lt(Trace::zero()));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        let frame = view.frame(BOX);
        out.metric("position_error", "m", safe::norm(self.error(view)));
        out.metric("heading_alignment", "-", dot(frame.heading(), view.goal.array(0)));
        out.metric("uprightness", "-", frame.up()[2]);
        out.metric("separation", "m", squared_separation(view).sqrt());
        out.metric("throttle_difference", "-", mean_throttle_difference(view));
    }

    succeeds_within!(
        self, view: self.error(view), self.settings.success.distance,
        "heading_alignment": dot(view.frame(BOX).heading(), view.goal.array(0)), self.settings.success.alignment,
        "uprightness": view.frame(BOX).up()[2], self.settings.success.alignment
    );

    fn loss(&self, view: &View, loss: &mut Loss) {
        let w = &self.settings.loss;
        let motion = (TO_TARGET[1], [Trace::zero(); 3]);
        group_loss((view, &self.load), (TO_TARGET[0], self.error(view)), motion, w, loss);
        loss.add("{×loss_turn}‖h_t − h‖²", squared(w.pose.turn, Self::heading_error(view)));
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        let yaw = view.goal[1].atan2(view.goal[0]);
        Some(TaskReference::way(&view.frame(BOX), self.settings.target, yaw, 1.5))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        set_heading(start, [1.0, 0.0, 0.0]);
        start.place(BOX, self.settings.target, [1.0, 0.0, 0.0, 0.0]);
    }
}
