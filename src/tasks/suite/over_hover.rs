//! OverHover: drones on the arms of a frame bring it to a pose and hold it there, tilted.
//!
//! - DIFFERENCE: target attitudes as above; published ones lack the factor π: ±0.2 rad, yaw up to 2 rad (defect 16).
//! - DIFFERENCE: starts with d > 4.5 are drawn again; published ones reach 4.8 of the 5 that end an episode (defect 26).
//! - DIFFERENCE: the spin term counts the three angular rates; the published one all six velocities (defect 15).
//! - DIFFERENCE: total mass everywhere (defect 5).

use super::over::*;
use super::team::{TeamSettings, lowest, observe_load, observes_team};
use super::{PoseLoss, PoseReward, PoseSuccess, StartRange, farther, less, made_of, succeeds_within};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::exponential_kernel;
use crate::robot::Robot;
use crate::settings;
use crate::start::Start;
use crate::task::{BuiltIn, Task, TaskReference, View};
use crate::task_spec::Smoothness;
use autodiff::{Array, Mask, Scalar};
use base::error::Result;
use dynamics::frame::Frame;
use dynamics::spatial::constants;

/// Where starts are.
fn start_range() -> StartRange {
    StartRange { position: [[-3.0, 3.0], [-3.0, 3.0], [1.5, 2.5]], ..StartRange::default() }
}

settings! {
    /// Settings of [`OverHover`].
    pub(crate) struct OverHoverSettings {
        team: TeamSettings = TeamSettings::default() => flat;
        horizon: usize = 500 => ("steps", "T", Any);
        target: TargetPose = TargetPose::default() => group;
        start: StartRange = start_range() => group;
        start_distance: f64 = 4.5 => ("-", "largest d of a start", Positive);
        min_height: f64 = 0.2 => ("m", "a lower drone is a crash", Any);
        max_distance: f64 = 5.0 => ("-", "largest d", Positive);
        success: PoseSuccess = PoseSuccess::default() => group;
        pose_scale: f64 = 1.2 => ("1/m", "how steeply r_p falls", NotNegative);
        reward: PoseReward = PoseReward { effort: 0.25, ..PoseReward::default() } => group;
        loss: PoseLoss = PoseLoss::default() => group;
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct OverHover {
    robot: Robot,
    settings: OverHoverSettings,
}

impl BuiltIn for OverHover {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: OverHoverSettings = config.settings()?;
        Ok(Self { robot: free_robot(config, &settings.team)?, settings })
    }
}

impl OverHover {
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> [S; 9] {
        pose_error(&view.frame(FRAME_BODY), self.settings.target.position, view.goal)
    }

    /// What follows the drones in observations.
    fn observe_shared(&self, view: &View, out: &mut Writer) {
        observe_error(&self.error(view), out);
        observe_load(view, &FRAME_NAMES, &view.frame(FRAME_BODY), out);
    }
}

impl Task for OverHover {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p, h, u, v, ω frame (world), p_i drones, e_i = Σ s effort of drone i, k steps. Target: {target_position} m, \
         heading h_t and up u_t of an attitude with roll and pitch within ±{target_tilt} rad and yaw within \
         {target_yaw} rad. Start: frame uniform in {start_position} m, roll and pitch within ±{start_tilt} rad, yaw \
         within {start_yaw} rad, at rest, joints at zero, d ≤ {start_distance}. d = ‖(p_t − p, h_t − h, u_t − u)‖."
    }

    fn start(&self, start: &mut Start<'_>) {
        let own = &self.settings;
        own.target.draw(start);
        start.again(100, |start| {
            let (position, attitude) = own.start.draw(start);
            start.place(FRAME_BODY, position, attitude);
            let still = constants([0.0; 3]);
            let frame = Frame { position, velocity: still, attitude, angular_velocity: still };
            farther(pose_error(&frame, own.target.position, &start.goal), own.start_distance).not()
        });
    }

    observes_team!(self, FRAME_BODY, false);

    fn reward(&self, view: &View, terms: &mut Writer) {
        let w = &self.settings.reward;
        let pose = exponential_kernel(self.settings.pose_scale, self.error(view));
        terms.term("pose", "{×reward_pose}r_p, r_p = e^{−{×pose_scale}d}", w.pose);
        pose_reward(view, (pose, Smoothness::Piecewise), view.goal.array(3), w, terms);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        ends.when("crash", "min z_i < {min_height} m", less(lowest(view), self.settings.min_height));
        ends.when("far", "d > {max_distance}", farther(self.error(view), self.settings.max_distance));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        pose_metrics(view, &self.error(view), out);
        throttle_metric(view, out);
    }

    succeeds_within!(
        self, view: place_error(&self.error(view)), self.settings.success.distance,
        "heading_alignment": heading_alignment(view), self.settings.success.alignment,
        "up_alignment": up_alignment(view), self.settings.success.alignment
    );

    fn loss(&self, view: &View, loss: &mut Loss) {
        pose_loss(&view.frame(FRAME_BODY), &self.error(view), &self.settings.loss, loss);
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        Some(pose_reference(view, self.settings.target.position))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.settings.target.ideal(start);
    }
}
