//! InvPendulumTrack: lead a ball that stands on a bar along a lemniscate.
//!
//! - DIFFERENCE: starts with d > `reset_distance` are drawn again; they come with bars above 1.8 m alone.
//! - DIFFERENCE: a drawn mass takes centre of mass and inertia with it (defect 25).
//! - DIFFERENCE: the ball's share is of the total mass, not of the base link's (defect 5).

use super::load::{LoadTrack, LoadTrackSettings, Side, leaning};
use super::{MotionLoss, ease_of_flight, less, made_of, succeeds_within, times};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::exponential_kernel;
use crate::settings;
use crate::start::Start;
use crate::task::{BuiltIn, Task, TaskReference, View};
use crate::track_path::{Follow, PathRange, about_path};
use autodiff::safe;
use base::error::Result;

/// What both track tasks have, with the numbers of this one.
fn track() -> LoadTrackSettings {
    let usual = LoadTrackSettings::default();
    let loss = MotionLoss { velocity: 0.1, ..usual.loss };
    let path = PathRange { origin: [0.0, 0.0, 3.0], ..usual.follow.path };
    LoadTrackSettings { follow: Follow { path, ..usual.follow }, loss, ..usual }
}

settings! {
    /// Settings of [`InvPendulumTrack`].
    pub(crate) struct InvPendulumTrackSettings {
        track: LoadTrackSettings = track() => flat;
        horizon: usize = 600 => ("steps", "T", Any);
        min_height: f64 = 0.2 => ("m", "lower is a crash", Any);
        min_balance: f64 = 0.2 => ("-", "b below which the ball falls", Any);
        reward_pose: f64 = 1.0 => ("-", "weight of the term pose", NotNegative);
        reward_effort: f64 = 0.1 => ("-", "weight of the term effort", NotNegative);
        loss_balance: f64 = 1.0 => ("m", "weight of the lean in the loss", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct InvPendulumTrack {
    track: LoadTrack,
    settings: InvPendulumTrackSettings,
}

impl BuiltIn for InvPendulumTrack {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: InvPendulumTrackSettings = config.settings()?;
        Ok(Self { track: LoadTrack::new(config, &settings.track, Side::Standing)?, settings })
    }
}

impl Task for InvPendulumTrack {
    made_of!(self: self.track.load.robot, self.settings);

    fn about(&self) -> &'static str {
        concat!(
            "p drone, q ball, b = (q − p)_z/L, ω angular velocity of the drone (world), e = Σ s effort, k steps, v_q \
             = q̇, ω_b angular velocity of the bar, ",
            about_path!(),
            ", d = ‖p_ref(k) − q‖. Ball {ball_share} of the vehicle's mass, bar {bar_mass} kg. Start: p one bar below \
             the path, roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, the bar along the drone's \
             z, at rest."
        )
    }

    fn start(&self, start: &mut Start<'_>) {
        self.track.start(&self.settings.track, start);
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        self.track.load.observe_lever(view, out);
        view.observe_drone(0, out);
        self.track.observe_ahead(view, out);
        self.track.load.observe_motion(view, out);
        view.observe_clock(out);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let own = &self.settings;
        terms.term("pose", "{×reward_pose}e^{−{×pose_scale}d}", own.reward_pose).piecewise();
        terms.number(times(own.reward_pose, exponential_kernel(own.track.pose_scale, self.track.error(view))));
        let effort = ease_of_flight(own.reward_effort, view);
        terms.term("effort", "{×reward_effort}e^{−e}", own.reward_effort).number(effort);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let own = &self.settings;
        ends.when("crash", "z < {min_height} m", less(view.drone(0).position[2], own.min_height));
        ends.when("fall", "b < {min_balance}", less(self.track.load.ball(view).up()[2], own.min_balance));
        ends.when("far", "d > {reset_distance} m", self.track.far(view));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("position_error", "m", safe::norm(self.track.error(view)));
        out.metric("balance", "-", self.track.load.ball(view).up()[2]);
        out.metric("throttle_difference", "-", view.throttle_difference(0));
    }

    succeeds_within!(self, view: self.track.error(view), self.settings.track.success.distance; held self.settings.track.success.time);

    fn loss(&self, view: &View, loss: &mut Loss) {
        self.track.loss(&self.settings.track.loss, view, loss);
        loss.add("{×loss_balance}(1 − b)", leaning(self.settings.loss_balance, &self.track.load.ball(view)));
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        self.track.reference(view)
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.track.ideal(start);
    }
}
