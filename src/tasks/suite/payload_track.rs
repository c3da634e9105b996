//! PayloadTrack: lead a slung ball along a lemniscate.
//!
//! - DIFFERENCE: starts with d > `reset_distance` are drawn again; they come with bars above 1.8 m alone.
//! - DIFFERENCE: the bar swings without stops; published ones are at ±120° (see `load`).
//! - DIFFERENCE: a drawn mass takes centre of mass and inertia with it (defect 25).
//! - DIFFERENCE: the ball's share is of the total mass, not of the base link's (defect 5).
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).

use super::load::{LoadTrack, LoadTrackSettings, Side};
use super::track::calm_pose;
use super::{PoseReward, less, made_of, succeeds_within};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::exponential_kernel;
use crate::settings;
use crate::start::Start;
use crate::task::{BuiltIn, Task, TaskReference, View};
use crate::track_path::about_path;
use autodiff::safe;
use base::error::Result;

settings! {
    /// Settings of [`PayloadTrack`].
    pub(crate) struct PayloadTrackSettings {
        track: LoadTrackSettings = LoadTrackSettings::default() => flat;
        horizon: usize = 600 => ("steps", "T", Any);
        min_height: f64 = 0.1 => ("m", "lower is a crash", Any);
        reward: PoseReward = PoseReward { up: 0.5, spin: 0.5, ..PoseReward::default() } => group;
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct PayloadTrack {
    track: LoadTrack,
    settings: PayloadTrackSettings,
}

impl BuiltIn for PayloadTrack {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: PayloadTrackSettings = config.settings()?;
        Ok(Self { track: LoadTrack::new(config, &settings.track, Side::Hanging)?, settings })
    }
}

impl Task for PayloadTrack {
    made_of!(self: self.track.load.robot, self.settings);

    fn about(&self) -> &'static str {
        concat!(
            "p drone, q ball, u = R e_z, ω angular velocity of the drone (world), e = Σ s effort, k steps, v_q = q̇, \
             ω_b angular velocity of the bar, ",
            about_path!(),
            ", d = ‖p_ref(k) − q‖. Ball {ball_share} of the vehicle's mass, bar {bar_mass} kg. Start: p one bar above \
             the path, roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, the bar along the drone's \
             −z, at rest."
        )
    }

    fn start(&self, start: &mut Start<'_>) {
        self.track.start(&self.settings.track, start);
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        self.track.load.observe_lever(view, out);
        self.track.observe_ahead(view, out);
        view.observe_drone(0, out);
        self.track.load.observe_motion(view, out);
        view.observe_clock(out);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let pose = exponential_kernel(self.settings.track.pose_scale, self.track.error(view));
        calm_pose(view, pose, &self.settings.reward, "{×reward_pose}r_p, r_p = e^{−{×pose_scale}d}", terms);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        ends.when("crash", "z < {min_height} m", less(view.drone(0).position[2], self.settings.min_height));
        ends.when("far", "d > {reset_distance} m", self.track.far(view));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("position_error", "m", safe::norm(self.track.error(view)));
        out.metric("uprightness", "-", view.drone(0).up()[2]);
        out.metric("throttle_difference", "-", view.throttle_difference(0));
    }

    succeeds_within!(self, view: self.track.error(view), self.settings.track.success.distance; held self.settings.track.success.time);

    fn loss(&self, view: &View, loss: &mut Loss) {
        self.track.loss(&self.settings.track.loss, view, loss);
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        self.track.reference(view)
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.track.ideal(start);
    }
}
