//! TransportTrack: drones on bars carry a box of unknown mass along a lemniscate.
//!
//! - DIFFERENCE: the box's inertia follows its mass (defect 25); its damping, published as 0.1 1/s, is that of a mass of
//!   0.65 Σ m_i.
//! - DIFFERENCE: q̂ runs over all bars' joints by name; published code reads 16, whatever their number (defect 24).
//! - DIFFERENCE: q̂² counts up to 1, at the stops; published rewards fall without end beyond them.
//! - DIFFERENCE: integrated semi-implicitly, whatever `integrator` says, see `stiff_physics`.
//! - DIFFERENCE: total mass everywhere; the published share counts base links alone (defect 5).

use super::over_track::wide_path;
use super::team::{lowest, mean_throttle_difference, observe_load, observes_team, squared_separation};
use super::transport::{
    BOX, BOX_NAMES, CarryReward, GroupLoss, GroupSettings, Load, SteadyReward, free_robot, group_loss, steady,
};
use super::{PathSuccess, StartAttitude, less, made_of, succeeds_within};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::exponential_kernel;
use crate::robot::Robot;
use crate::settings;
use crate::start::Start;
use crate::task::{BuiltIn, Task, TaskReference, View};
use crate::track_path::{Follow, TrackPath, about_path};
use autodiff::{Scalar, safe};
use base::error::Result;
use dynamics::spatial::{Vec3, sub};

/// Weights of this task.
fn reward() -> SteadyReward {
    SteadyReward { carry: CarryReward { effort: 0.1, ..CarryReward::default() }, ..SteadyReward::default() }
}

settings! {
    /// Settings of [`TransportTrack`].
    pub(crate) struct TransportTrackSettings {
        group: GroupSettings = GroupSettings::default() => flat;
        horizon: usize = 600 => ("steps", "T", Any);
        follow: Follow = Follow { reset_distance: 0.7, path: wide_path(), ..Follow::default() } => flat;
        start: StartAttitude = StartAttitude { tilt: 0.0, ..StartAttitude::default() } => group;
        min_height: f64 = 0.2 => ("m", "a lower drone is a crash", Any);
        success: PathSuccess = PathSuccess::default() => group;
        pose_scale: f64 = 1.2 => ("1/m", "how steeply r_p falls", NotNegative);
        reward: SteadyReward = reward() => group;
        loss: GroupLoss = GroupLoss::default() => group;
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct TransportTrack {
    robot: Robot,
    settings: TransportTrackSettings,
    load: Load,
    path: TrackPath,
}

impl BuiltIn for TransportTrack {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: TransportTrackSettings = config.settings()?;
        let (robot, load) = free_robot(config, &settings.group)?;
        let path = TrackPath::new(&settings.follow, config.dt);
        Ok(Self { robot, settings, load, path })
    }
}

impl TransportTrack {
    /// p_ref(k) − p.
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(self.path.at(view.goal, view.step), view.frame(BOX).position)
    }

    /// What follows the drones in observations.
    fn observe_shared(&self, view: &View, out: &mut Writer) {
        let frame = view.frame(BOX);
        self.path.observe_ahead(view, frame.position, out);
        observe_load(view, &BOX_NAMES, &frame, out);
    }
}

impl Task for TransportTrack {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        concat!(
            "p, u, v, ω box (world), p_i drones, e_i = Σ s effort of drone i, q̂ angles of the bars' joints as shares \
             of their range of ±120°, sep the least distance of two drones, r_s = min((sep/{separation} m)², 1), k \
             steps, ",
            about_path!(),
            ". Mass of the box: uniform in {box_share} Σ m_i. Start: box on the path, roll and pitch within \
             ±{start_tilt} rad, yaw within {start_yaw} rad, drones upright above it, at rest. d = ‖p_ref(k) − p‖."
        )
    }

    fn start(&self, start: &mut Start<'_>) {
        self.load.draw_mass(start);
        let position = self.path.draw(start);
        let attitude = self.settings.start.draw(start);
        start.place(BOX, position, attitude);
        self.path.join(start, 0, None);
    }

    observes_team!(self, BOX, true);

    fn reward(&self, view: &View, terms: &mut Writer) {
        let w = &self.settings.reward;
        terms.term("pose", "{×reward_pose}r_s r_p, r_p = e^{−{×pose_scale}d}", w.carry.pose);
        steady(view, &self.load, exponential_kernel(self.settings.pose_scale, self.error(view)), w, terms);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        ends.when("crash", "min z_i < {min_height} m", less(lowest(view), self.settings.min_height));
        ends.when("far", "d > {reset_distance} m", self.path.far(view.goal, self.error(view)));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("position_error", "m", safe::norm(self.error(view)));
        out.metric("uprightness", "-", view.frame(BOX).up()[2]);
        out.metric("separation", "m", squared_separation(view).sqrt());
        out.metric("throttle_difference", "-", mean_throttle_difference(view));
    }

    succeeds_within!(self, view: self.error(view), self.settings.success.distance; held self.settings.success.time);

    fn loss(&self, view: &View, loss: &mut Loss) {
        let distance = ("√(d² + {loss_radius}²)", self.error(view));
        let motion = ("{×loss_velocity}h₅(ṗ_ref − v)", self.path.velocity(view.goal, view.step));
        group_loss((view, &self.load), distance, motion, &self.settings.loss, loss);
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        Some(self.path.lead(view, &view.frame(BOX)))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let position = self.path.draw(start);
        start.place(BOX, position, [1.0, 0.0, 0.0, 0.0]);
    }
}
