//! OverFlyThrough: drones on the arms of a frame bring it through a row of poles that it only passes tilted.
//!
//! - DIFFERENCE: where the poles are is observed; published code leaves it out of the space and drops it (defect 17).
//! - DIFFERENCE: target attitudes as above; published ones lack the factor π: ±0.2 rad, yaw up to 2 rad (defect 16).
//! - DIFFERENCE: the spin term counts the three angular rates; the published one all six velocities (defect 15).
//! - DIFFERENCE: total mass everywhere (defect 5).
//! - DIFFERENCE: contact is that of capsules in the boxes of vehicles, on a material as of rubber, in substeps of at most 4 ms.
//! - DIFFERENCE: starts that touch a pole are drawn again; those of our vehicles never do. The published task states no success.

use super::obstacles::{CollisionShapes, NEARNESS, course, nearness, rounded, touches, touching, where_on};
use super::over::*;
use super::team::{
    ALL_BEYOND, CourseLoss, TeamSettings, arrived, clearance, lowest, observe_load, observes_team, remember_course,
};
use super::{
    PoseReward, PoseSuccess, StartAttitude, StartRange, along_the_course, eased, less, made_of, more, nearer, squared,
    starts_on_host, succeeds_once, times,
};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::rational_kernel;
use crate::robot::Robot;
use crate::settings;
use crate::start::{Start, StartScalar};
use crate::task::{BuiltIn, HostStart, Task, View};
use crate::task_spec::Smoothness;
use autodiff::{Array, Mask, Scalar, Trace, safe};
use base::error::Result;
use dynamics::assembly::rod;
use dynamics::scene::{Obstacle, Scene};
use dynamics::shape::Pose;
use dynamics::spatial::Vec3;
use dynamics::tree::parameters::static_parameters;
use std::f64::consts::PI;

/// Poles at x = 0 and these multiples of their spacing along y.
const POLES: [f64; 3] = [-1.0, 0.0, 1.0];
/// Of a pole, m.
const RADIUS: f64 = 0.05;
/// Of a pole, m.
const HEIGHT: f64 = 5.0;

/// Place of the spacing in the goal.
const SPACING: usize = 6;
/// Starts on the way are no nearer to the poles with the middle of the frame, m: farther than its arms reach.
const CLEAR: f64 = 1.0;

/// The middles of the poles.
fn axes<S: Scalar>(spacing: S) -> [[Vec3<S>; 2]; POLES.len()] {
    let mut axes = [[[S::zero(); 3]; 2]; POLES.len()];
    for i in 0..POLES.len() {
        let y = spacing * S::constant(POLES[i]);
        axes[i] = [[S::zero(), y, S::zero()], [S::zero(), y, S::constant(HEIGHT)]];
    }
    axes
}

/// How near to the poles leaning is asked for, m.
const LEAN_WITHIN: f64 = 0.8;

/// Where starts are.
fn start_range() -> StartRange {
    let position = [[-2.5, -2.0], [-0.5, 0.5], [1.75, 2.5]];
    StartRange { position, attitude: StartAttitude { tilt: 0.4 * PI, ..StartAttitude::default() } }
}

settings! {
    /// Settings of [`OverFlyThrough`].
    pub(crate) struct OverFlyThroughSettings {
        team: TeamSettings = TeamSettings::default() => flat;
        horizon: usize = 500 => ("steps", "T", Any);
        reset_on_collision: bool = false => ("", "whether touching a pole ends the episode", Any);
        target: TargetPose = TargetPose { position: [2.0, 0.0, 2.25], ..TargetPose::default() } => group;
        start: StartRange = start_range() => group;
        start_along: f64 = 0.0 => ("-", "share of episodes that begin anywhere on the way to the target", Share);
        pole_spacing: f64 = 1.0 => ("m", "of the poles", Positive);
        spacing_ease: f64 = 1.0 => ("-", "factor of the spacing at difficulty 0", Positive);
        min_height: f64 = 0.2 => ("m", "a lower drone is a crash", Any);
        max_side: f64 = 1.5 => ("m", "farther along y ends the episode", Positive);
        success: PoseSuccess = PoseSuccess { distance: 0.2, ..PoseSuccess::default() } => group;
        pose_scale: f64 = 1.0 => ("1/m", "how steeply r_p falls", NotNegative);
        reward: PoseReward = PoseReward::default() => group;
        loss: CourseLoss = CourseLoss::default() => group;
        loss_lean: f64 = 0.0 => ("m", "weight of u_z² between the poles in the loss", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct OverFlyThrough {
    robot: Robot,
    settings: OverFlyThroughSettings,
    skin: CollisionShapes,
    /// Of starts.
    rest: CollisionShapes,
    /// Where the poles' y stand among the robot's numbers.
    poles: [usize; POLES.len()],
}

impl BuiltIn for OverFlyThrough {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: OverFlyThroughSettings = config.settings()?;
        let vehicle = config.vehicle(&settings.team.vehicle)?;
        let team = platform(&rounded(&vehicle), settings.team.n_drone, 0.001)?;
        let pole = |(i, y): (usize, &f64)| Obstacle {
            name: format!("pole_{i}"),
            shape: rod([0.0, y * settings.pole_spacing, 0.0], [0.0, y * settings.pole_spacing, HEIGHT], RADIUS),
        };
        let obstacles = POLES.iter().enumerate().map(pole).collect();
        let model = course("over_fly_through", team, &Scene { obstacles, ..Scene::default() })?;
        let mut physics = touching(config);
        physics.effects.downwash = true;
        let robot = Robot::of_model(&model, physics, Some(&vehicle), |_| Vec::new())?;
        let y = |i| static_parameters(model.bodies().len(), model.rotors().len(), i) + 1;
        let poles: [usize; POLES.len()] = std::array::from_fn(y);
        let rest = CollisionShapes::at_rest(&robot, &model);
        // numbers that may differ cost time, in physics and in gradients
        let robot = if settings.spacing_ease == 1.0 { robot } else { robot.varying(poles) };
        Ok(Self { settings, skin: CollisionShapes::of(&model), rest, robot, poles })
    }
}

impl OverFlyThrough {
    /// Keeps the spacing of the poles, and moves them.
    fn space<S: StartScalar>(&self, start: &mut Start<'_, S>) -> S {
        let spacing = S::from(self.settings.pole_spacing) * eased(self.settings.spacing_ease, start.difficulty);
        start.goal.field("pole_spacing", "m", "of the poles").number(spacing);
        self.poles.iter().zip(POLES).for_each(|(y, pole)| start.numbers[*y] = times(pole, spacing));
        spacing
    }

    /// Least distance to a pole, m.
    fn clearance<S: Scalar>(&self, view: &View<'_, S>) -> S {
        self.skin.clearance(view, &axes(view.goal[SPACING]), RADIUS)
    }

    fn error<S: Scalar>(&self, view: &View<'_, S>) -> [S; 9] {
        pose_error(&view.frame(FRAME_BODY), self.settings.target.position, view.goal)
    }

    /// What follows the drones in observations.
    fn observe_shared(&self, view: &View, out: &mut Writer) {
        let frame = view.frame(FRAME_BODY);
        observe_error(&self.error(view), out);
        out.field("poles", "m, world", "(x, y) of every pole − (x, y) of the frame");
        for i in 0..POLES.len() {
            let y = view.goal[SPACING] * Trace::constant(POLES[i]);
            out.array([-frame.position[0], y - frame.position[1]]);
        }
        observe_load(view, &FRAME_NAMES, &frame, out);
    }
}

impl HostStart for OverFlyThrough {
    fn start(&self, start: &mut Start<'_, f64>) {
        let own = &self.settings;
        own.target.draw(start);
        let spacing = self.space(start);
        for _ in 0..100 {
            let (position, attitude) = own.start.draw(start);
            let position = along_the_course(start, own.start_along, position, own.target.position, CLEAR);
            start.place(FRAME_BODY, position, attitude);
            if self.rest.clearance_at(&Pose { position, attitude }, &axes(spacing), RADIUS) > 0.0 {
                break;
            }
        }
    }
}

impl Task for OverFlyThrough {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p, h, u, v, ω frame (world), p_i drones, e_i = Σ s effort of drone i, c clearance: the least distance of the \
         robot's bodies to a pole, negative in contact. Poles: three vertical capsules of radius 0.05 m and length 5 m \
         about z = 2.5 m, at x = 0, {pole_spacing} m apart along y about 0; the robot's arms reach 0.85 m. Target: {target_position} m, heading \
         h_t and up u_t of an attitude with roll and pitch within ±{target_tilt} rad and yaw within {target_yaw} rad. \
         Start: frame uniform in {start_position} m, roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} \
         rad, at rest, joints at zero. d = ‖(p_t − p, h_t − h, u_t − u)‖."
    }

    starts_on_host!();

    fn remember(&self, view: &View, task_state: &mut Writer) {
        let own = &self.settings.success;
        let aligned = more(heading_alignment(view), own.alignment).and(more(up_alignment(view), own.alignment));
        let near = nearer(place_error(&self.error(view)), own.distance).and(aligned);
        remember_course(view, near, self.clearance(view), task_state);
    }

    observes_team!(self, FRAME_BODY, false);

    fn reward(&self, view: &View, terms: &mut Writer) {
        let w = &self.settings.reward;
        let pose = rational_kernel(self.settings.pose_scale, safe::squared_norm(self.error(view)));
        terms.term("pose", "{×reward_pose}r_p, r_p = 1/(1 + ({×pose_scale}d)²)", w.pose);
        pose_reward(view, (pose, Smoothness::Smooth), view.goal.array(3), w, terms);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let own = &self.settings;
        ends.when("crash", "min z_i < {min_height} m", less(lowest(view), own.min_height));
        ends.when("aside", "|y| > {max_side} m", more(view.frame(FRAME_BODY).position[1].abs(), own.max_side));
        let contact = where_on::<Trace>(own.reset_on_collision, touches(clearance(view)));
        ends.when("collision", "c < 0, if reset_on_collision", contact);
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        pose_metrics(view, &self.error(view), out);
        out.metric("clearance", "m", clearance(view));
        throttle_metric(view, out);
    }

    succeeds_once!(
        self, view: arrived(view), self.settings.success.distance,
        "heading_alignment": self.settings.success.alignment, "up_alignment": self.settings.success.alignment; ALL_BEYOND
    );

    fn loss(&self, view: &View, loss: &mut Loss) {
        let w = &self.settings.loss;
        pose_loss(&view.frame(FRAME_BODY), &self.error(view), &w.pose, loss);
        loss.add(NEARNESS, nearness(w.clearance, clearance(view)));
        if self.settings.loss_lean > 0.0 {
            // a level frame between two poles touches both: its clearance does not tell which way to lean
            let frame = view.frame(FRAME_BODY);
            let between = (-squared(1.0 / (LEAN_WITHIN * LEAN_WITHIN), [frame.position[0]])).exp();
            loss.add("{×loss_lean}u_z² e^{−(x/0.8 m)²}", between * squared(self.settings.loss_lean, [frame.up()[2]]));
        }
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.settings.target.ideal(start);
        self.space(start);
    }
}
