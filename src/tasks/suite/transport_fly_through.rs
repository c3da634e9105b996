//! TransportFlyThrough: drones on bars take a box of unknown mass between two beams, bars lowered to fit.
//!
//! - DIFFERENCE: the box's inertia follows its mass (defect 25); its damping, published as 0.1 1/s, is that of a mass of
//!   0.65 Σ m_i.
//! - DIFFERENCE: q̂ runs over all bars' joints by name; published code reads 16, whatever their number (defect 24).
//! - DIFFERENCE: q̂² counts up to 1, at the stops; published rewards fall without end beyond them.
//! - DIFFERENCE: integrated semi-implicitly, whatever `integrator` says, see `stiff_physics`,
//!   in substeps of at most 4 ms.
//! - DIFFERENCE: total mass everywhere; the published share counts base links alone (defect 5).
//! - DIFFERENCE: contact is that of capsules in the boxes of load and vehicles, on a material as of rubber.
//! - DIFFERENCE: starts that touch a beam are drawn again; those of our vehicles never do.

use super::obstacles::{
    Bars, BarsSettings, CollisionShapes, NEARNESS, course, nearness, rounded, touches, touching, where_on,
};
use super::team::{
    ALL_BEYOND, arrived, clearance, highest, lowest, mean_throttle_difference, observe_load, observes_team,
    remember_course, squared_separation,
};
use super::transport::{
    BOX, BOX_NAMES, CarryReward, GroupLoss, GroupSettings, Load, TO_TARGET, group, group_loss, stiff_physics,
};
use super::{
    StartAttitude, StartRange, along_the_course, less, made_of, more, nearer, starts_on_host, succeeds_once, times,
};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{exponential_kernel, upright};
use crate::robot::Robot;
use crate::settings;
use crate::start::{Start, StartScalar};
use crate::task::{BuiltIn, HostStart, Task, View};
use autodiff::{Array, Scalar, Trace, safe};
use base::error::Result;
use dynamics::shape::Pose;
use dynamics::spatial::{Vec3, sub};
use std::f64::consts::FRAC_PI_2;

/// Starts on the way are no nearer to the beams with the middle of the box, m: half its length and more.
const CLEAR: f64 = 1.0;
/// Where the beams' heights stand in the goal.
const HEIGHTS: usize = 3;

/// Where starts are.
fn start_range() -> StartRange {
    let attitude = StartAttitude { tilt: 0.0, yaw: [-FRAC_PI_2, FRAC_PI_2], ..StartAttitude::default() };
    StartRange { position: [[-2.5, -1.5], [-0.5, 0.5], [1.0, 2.0]], attitude }
}

settings! {
    /// Settings of [`TransportFlyThrough`].
    pub(crate) struct TransportFlyThroughSettings {
        group: GroupSettings = GroupSettings::default() => flat;
        horizon: usize = 500 => ("steps", "T", Any);
        bars: BarsSettings = BarsSettings { spacing: [1.0, 1.2], ..BarsSettings::default() } => flat;
        reset_on_collision: bool = false => ("", "whether touching a beam ends the episode", Any);
        target: [[f64; 2]; 3] = [[1.75, 2.25], [-0.2, 0.2], [1.25, 1.75]]
            => ("m, world", "p_t, lowest and highest per axis", Ordered);
        start: StartRange = start_range() => group;
        start_along: f64 = 0.0 => ("-", "share of episodes that begin anywhere on the way to the target", Share);
        min_height: f64 = 0.2 => ("m", "a lower drone is a crash", Any);
        max_height: f64 = 3.6 => ("m", "a higher drone ends the episode", Any);
        box_min_height: f64 = 0.3 => ("m", "a lower box ends the episode", Any);
        success_distance: f64 = 0.2 => ("m", "position error of a success", Positive);
        pose_scale: f64 = 1.0 => ("1/m", "how steeply r_p falls", NotNegative);
        reward: CarryReward = CarryReward::default() => group;
        loss: GroupLoss = GroupLoss::default() => group;
        loss_clearance: f64 = 0.5 => ("m", "weight of the clearance in the loss", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct TransportFlyThrough {
    robot: Robot,
    settings: TransportFlyThroughSettings,
    load: Load,
    bars: Bars,
    /// Of starts.
    rest: CollisionShapes,
}

impl BuiltIn for TransportFlyThrough {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: TransportFlyThroughSettings = config.settings()?;
        let vehicle = config.vehicle(&settings.group.team.vehicle)?;
        let built = group(&rounded(&vehicle), &settings.group, true)?;
        let load = Load::new(&vehicle, &settings.group, &built);
        let model = course("transport_fly_through", built.model, &Bars::scene(&settings.bars))?;
        let robot = Robot::of_model(&model, stiff_physics(touching(config)), Some(&vehicle), |_| Vec::new())?;
        let (bars, rest) = (Bars::of(&model, &settings.bars, HEIGHTS), CollisionShapes::at_rest(&robot, &model));
        Ok(Self { robot: robot.varying_inertial(BOX).varying(bars.numbers()), settings, load, bars, rest })
    }
}

impl TransportFlyThrough {
    /// p_t − p.
    fn error<S: Scalar>(view: &View<'_, S>) -> Vec3<S> {
        sub(view.goal.array(0), view.frame(BOX).position)
    }

    /// What follows the drones in observations.
    fn observe_shared(&self, view: &View, out: &mut Writer) {
        let frame = view.frame(BOX);
        out.field("target", "m, world", "p_t − p").array(Self::error(view));
        self.bars.observe(view, frame.position, out);
        observe_load(view, &BOX_NAMES, &frame, out);
    }

    /// Keeps p_t, and draws the beams.
    fn draw<S: StartScalar>(&self, start: &mut Start<'_, S>, target: Vec3<f64>) {
        start.goal.field("target", "m, world", "p_t").array(target);
        self.bars.draw(start);
    }
}

impl HostStart for TransportFlyThrough {
    fn start(&self, start: &mut Start<'_, f64>) {
        self.load.draw_mass(start);
        let target = self.settings.target.map(|[low, high]| start.task.uniform(low, high));
        self.draw(start, target);
        for _ in 0..100 {
            let (position, attitude) = self.settings.start.draw(start);
            let position = along_the_course(start, self.settings.start_along, position, target, CLEAR);
            start.place(BOX, position, attitude);
            if self.bars.clear_of(start, &self.rest, &Pose { position, attitude }) {
                break;
            }
        }
    }
}

impl Task for TransportFlyThrough {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p, u, v, ω box (world), p_i drones, e_i = Σ s effort of drone i, q̂ angles of the joints of the bars that \
         carry it as shares of their range of ±120°, sep the least distance of two drones, r_s = \
         min((sep/{separation} m)², 1), c clearance: the least distance of the robot's bodies to a beam, negative in \
         contact. Beams (bars when observed): two level capsules along y of radius 0.04 m and length 5 m at x = 0, z \
         = 1.2 m and {spacing} m above; the group is 1.3 m high. Mass of the box: uniform in {box_share} Σ m_i. \
         Target: uniform in {target} m. Start: box uniform in {start_position} m, roll and pitch within ±{start_tilt} \
         rad, yaw within {start_yaw} rad, drones upright above it, at rest."
    }

    starts_on_host!();

    fn remember(&self, view: &View, task_state: &mut Writer) {
        let near = nearer(Self::error(view), self.settings.success_distance);
        remember_course(view, near, self.bars.clearance(view), task_state);
    }

    observes_team!(self, BOX, true);

    fn reward(&self, view: &View, terms: &mut Writer) {
        let (near, w) = (self.load.apart(view), &self.settings.reward);
        let posed = near * exponential_kernel(self.settings.pose_scale, Self::error(view));
        terms.term("pose", "{×reward_pose}r_s r_p, r_p = e^{−{×pose_scale}‖p_t − p‖}", w.pose).piecewise();
        terms.number(times(w.pose, posed));
        terms.term("up", "{×reward_up}r_s r_p ((u_z + 1)/2)²", w.up).piecewise();
        terms.number(times(w.up, posed) * upright(view.frame(BOX).up()));
        self.load.ease(view, near, w, terms);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let own = &self.settings;
        ends.when("crash", "min z_i < {min_height} m", less(lowest(view), own.min_height));
        ends.when("high", "max z_i > {max_height} m", more(highest(view), own.max_height));
        ends.when("box_low", "z < {box_min_height} m", less(view.frame(BOX).position[2], own.box_min_height));
        let contact = where_on::<Trace>(own.reset_on_collision, touches(clearance(view)));
        ends.when("collision", "c < 0, if reset_on_collision", contact);
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("position_error", "m", safe::norm(Self::error(view)));
        out.metric("uprightness", "-", view.frame(BOX).up()[2]);
        out.metric("separation", "m", squared_separation(view).sqrt());
        out.metric("clearance", "m", clearance(view));
        out.metric("throttle_difference", "-", mean_throttle_difference(view));
    }

    succeeds_once!(self, view: arrived(view), self.settings.success_distance; ALL_BEYOND);

    fn loss(&self, view: &View, loss: &mut Loss) {
        let w = &self.settings.loss;
        let motion = (TO_TARGET[1], [Trace::zero(); 3]);
        group_loss((view, &self.load), (TO_TARGET[0], Self::error(view)), motion, w, loss);
        loss.add(NEARNESS, nearness(self.settings.loss_clearance, clearance(view)));
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let target = self.settings.target.map(|[low, high]| 0.5 * (low + high));
        self.draw(start, target);
        start.place(BOX, target, [1.0, 0.0, 0.0, 0.0]);
    }
}
