//! OverTrack: drones on the arms of a frame carry it along a lemniscate while its axis points at a fixed point.
//!
//! - DIFFERENCE: the spin term counts the three angular rates; the published one all six velocities (defect 15).
//! - DIFFERENCE: total mass everywhere (defect 5).

use super::over::*;
use super::team::{TeamSettings, lowest, observe_load, observes_team};
use super::{
    PathSuccess, PoseLoss, PoseReward, StartAttitude, less, made_of, rate_cost, speed_cost, squared, succeeds_within,
};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{exponential_kernel, smooth_norm};
use crate::robot::Robot;
use crate::settings;
use crate::start::Start;
use crate::task::{BuiltIn, Task, TaskReference, View};
use crate::task_spec::Smoothness;
use crate::track_path::{Follow, PATH, PathRange, TrackPath, about_path};
use autodiff::{Array, Mask, Scalar, Trace, safe};
use base::error::Result;
use controllers::reference::{Pointed, Reference};
use dynamics::spatial::{Vec3, dot, sub};

/// Until the frame of our controllers points at the place, s: of 2, 3 and 4 s the one in which fewest frames left the path.
const TURN: f64 = 4.0;
/// Most that it leans, rad: drones push within 70° of its axis, and what is left of that bends the path.
const MOST: f64 = 1.0;

/// The path of a heavy team.
pub(super) fn wide_path() -> PathRange {
    PathRange { scale: [[2.4, 3.6], [2.4, 3.6], [1.2, 1.6]], ..PathRange::default() }
}

settings! {
    /// Settings of [`OverTrack`].
    pub(crate) struct OverTrackSettings {
        team: TeamSettings = TeamSettings::default() => flat;
        horizon: usize = 500 => ("steps", "T", Any);
        follow: Follow = Follow { path: wide_path(), ..Follow::default() } => flat;
        look_distance: f64 = 3.0 => ("m", "from the path's middle to the point to look at", Positive);
        start: StartAttitude = StartAttitude::default() => group;
        min_height: f64 = 0.2 => ("m", "a lower drone is a crash", Any);
        success: PathSuccess = PathSuccess::default() => group;
        success_alignment: f64 = 0.95
            => ("-", "cosine of the angle between the frame's axis and the asked one above which a success is", Any);
        pose_scale: f64 = 1.2 => ("1/m", "how steeply r_p falls", NotNegative);
        reward: PoseReward = PoseReward { effort: 0.25, ..PoseReward::default() } => group;
        loss: PoseLoss = PoseLoss::default() => group;
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct OverTrack {
    robot: Robot,
    settings: OverTrackSettings,
    path: TrackPath,
}

impl BuiltIn for OverTrack {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: OverTrackSettings = config.settings()?;
        let path = TrackPath::new(&settings.follow, config.dt);
        Ok(Self { robot: free_robot(config, &settings.team)?, settings, path })
    }
}

impl OverTrack {
    /// p_ref(k) − p.
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(self.path.at(view.goal, view.step), view.frame(FRAME_BODY).position)
    }

    /// u_t.
    fn target_up<S: Scalar>(view: &View<'_, S>) -> Vec3<S> {
        safe::normalise(sub(view.goal.array(PATH), view.frame(FRAME_BODY).position))
    }

    /// What follows the drones in observations.
    fn observe_shared(&self, view: &View, out: &mut Writer) {
        let frame = view.frame(FRAME_BODY);
        self.path.observe_ahead(view, frame.position, out);
        let tilt = sub(Self::target_up(view), frame.up());
        out.field("up_error", "-, world", "u_t − u").within(-2.0, 2.0).array(tilt);
        observe_load(view, &FRAME_NAMES, &frame, out);
    }

    /// Draws path and point to look at; returns where the path starts, and the point.
    fn draw(&self, start: &mut Start<'_>) -> [Vec3<Trace>; 2] {
        let first = self.path.draw(start);
        let along = safe::normalise([0, 1, 2].map(|_| start.task.normal()));
        let (far, origin) = (self.settings.look_distance, self.path.origin());
        let look = [along[0] * far, along[1] * far, (along[2] * far).abs() + 0.1];
        let look = [0, 1, 2].map(|i| look[i] + origin[i]);
        start.goal.field("look", "m, world", "a").array(look);
        [first, look]
    }
}

impl Task for OverTrack {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        concat!(
            "p, u, v, ω frame (world), e_i = Σ s effort of drone i, k steps, ",
            about_path!(),
            ". The point a to look at: {look_distance} m from {path_origin} m in any direction, then with its height \
             above it made positive and 0.1 m added; u_t = (a − p)/‖a − p‖. Start: frame on the path, roll and pitch \
             within ±{start_tilt} rad, yaw within {start_yaw} rad, at rest, joints at zero. d = ‖p_ref(k) − p‖."
        )
    }

    fn start(&self, start: &mut Start<'_>) {
        let [position, _] = self.draw(start);
        let attitude = self.settings.start.draw(start);
        start.place(FRAME_BODY, position, attitude);
        self.path.join(start, 0, None);
    }

    observes_team!(self, FRAME_BODY, false);

    fn reward(&self, view: &View, terms: &mut Writer) {
        let w = &self.settings.reward;
        let pose = exponential_kernel(self.settings.pose_scale, self.error(view));
        terms.term("pose", "{×reward_pose}r_p, r_p = e^{−{×pose_scale}d}", w.pose);
        pose_reward(view, (pose, Smoothness::Piecewise), Self::target_up(view), w, terms);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        ends.when("crash", "min z_i < {min_height} m", less(lowest(view), self.settings.min_height));
        ends.when("far", "d > {reset_distance} m", self.path.far(view.goal, self.error(view)));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("position_error", "m", safe::norm(self.error(view)));
        out.metric("up_alignment", "-", dot(view.frame(FRAME_BODY).up(), Self::target_up(view)));
        throttle_metric(view, out);
    }

    succeeds_within!(
        self, view: self.error(view), self.settings.success.distance,
        "up_alignment": dot(view.frame(FRAME_BODY).up(), Self::target_up(view)), self.settings.success_alignment;
        held self.settings.success.time
    );

    fn loss(&self, view: &View, loss: &mut Loss) {
        let (frame, w) = (view.frame(FRAME_BODY), &self.settings.loss);
        let slip = sub(self.path.velocity(view.goal, view.step), frame.velocity);
        loss.add("√(d² + {loss_radius}²)", smooth_norm(self.error(view), w.motion.radius));
        loss.add("{×loss_velocity}h₅(ṗ_ref − v)", speed_cost(w.motion.velocity, slip));
        loss.add("{×loss_turn}‖u_t − u‖²", squared(w.turn, sub(Self::target_up(view), frame.up())));
        loss.add("{×loss_rate}h₁₀(ω)", rate_cost(w.motion.rate, frame.angular_velocity));
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        let frame = view.frame(FRAME_BODY);
        let path = self.path.reference(view.goal, frame.yaw());
        let led = Pointed { path, place: view.goal.array(PATH), ramp: TURN, most: MOST };
        Some(TaskReference::one(Reference::Pointed(led)).of(frame.position))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let [position, look] = self.draw(start);
        // the shortest turn from e_z to u_t, which points upwards
        let up = safe::normalise(sub(look, position));
        start.place(FRAME_BODY, position, safe::normalise([1.0 + up[2], -up[1], up[0], Trace::zero()]));
    }
}
