//! FlyThrough: fly through a gate that slides sideways.
//!
//! The gate has the same size in all episodes: a shape of a body is none of the numbers that may differ between environments.
//! What makes its passage easier is `gate_ease`, the share of its offset.
//!
//! - DIFFERENCE: gate observations, rewards and ends read the frame; the published ones its fixed mount (defect 19).
//! - DIFFERENCE: the slide is damped, ζ = 0.14, so the gate comes to rest; the published one swings for ever (defect 20).
//!   `gate_damping` = 0 is the published gate.
//! - DIFFERENCE: contact is that of capsules along the diagonals of the vehicle's boxes, and `contact` is geometric.
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).
//! - DIFFERENCE: the term gate falls no further than 5 m beside the gate, where every flight has ended.
//! - DIFFERENCE: ends `high` and `wide` are those of the current code; the paper's had neither.

use super::obstacles::{CollisionShapes, NEARNESS, nearness, rounded, softened, touches, touching, where_on};
use super::{
    MotionLoss, PoseReward, StartAttitude, StartRange, along_the_course, ease_of_flight, eased, farther, latch, less,
    made_of, more, nearer, rate_cost, speed_cost, succeeds_once, times,
};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{exponential_kernel, rational_kernel, smooth_norm, still, upright};
use crate::robot::Robot;
use crate::settings;
use crate::start::{Start, flag};
use crate::task::{BuiltIn, Task, View};
use autodiff::{Array, Mask, Scalar, Trace, safe};
use base::error::Result;
use dynamics::assembly::{Member, single};
use dynamics::configurations::environment;
use dynamics::frame::Frame;
use dynamics::scene::{Gate, GateSlide, Scene};
use dynamics::shape::Pose;
use dynamics::spatial::{Vec3, sub};

/// Starts on the way are no nearer to the gate, m.
const CLEAR: f64 = 0.5;
/// Beside the gate's middle the term gate falls no further than this, m: beyond where flights end.
const FAR_BESIDE: f64 = 5.0;

/// Where starts are.
fn start_range() -> StartRange {
    let position = [[-2.5, -2.0], [-1.5, 1.5], [1.5, 2.5]];
    StartRange { position, attitude: StartAttitude { yaw: [0.0, 0.0], ..StartAttitude::default() } }
}

settings! {
    /// Settings of [`FlyThrough`].
    pub(crate) struct FlyThroughSettings {
        vehicle: String = "hummingbird".into() => ("", "what flies", Any);
        horizon: usize = 500 => ("steps", "T", Any);
        gate_position: [f64; 3] = [0.0, 0.0, 2.0] => ("m, world", "of the gate at rest", Any);
        gate_offset: f64 = 1.0 => ("m", "largest offset of the gate at the start, along y", NotNegative);
        gate_ease: f64 = 1.0 => ("-", "factor of that offset at difficulty 0", NotNegative);
        gate_damping: f64 = 1.0 => ("N s/m", "of the gate's slide", NotNegative);
        gate_aperture: f64 = 0.5 => ("m", "farther beside the gate's middle along y or z it is missed", Positive);
        reset_on_collision: bool = false => ("", "whether touch ends the episode", Any);
        target: [[f64; 2]; 3] = [[1.5, 2.5], [-1.0, 1.0], [1.5, 2.5]]
            => ("m, world", "p_t, lowest and highest per axis", Ordered);
        start: StartRange = start_range() => group;
        start_along: f64 = 0.0 => ("-", "share of episodes that begin anywhere on the way to the target", Share);
        min_height: f64 = 0.2 => ("m", "lower is a crash", Any);
        max_height: f64 = 2.5 => ("m", "higher ends the episode", Any);
        max_side: f64 = 2.0 => ("m", "farther along y ends the episode", Positive);
        max_distance: f64 = 6.0 => ("m", "farther from the target ends the episode", Positive);
        success_distance: f64 = 0.2 => ("m", "position error of a success", Positive);
        pose_scale: f64 = 1.0 => ("1/m", "how steeply r_p falls", NotNegative);
        pose_floor: f64 = 0.3 => ("-", "what up and spin are worth far from the target", NotNegative);
        reward: PoseReward = PoseReward { up: 0.5, spin: 0.5, ..PoseReward::default() } => group;
        reward_gate: f64 = 0.5 => ("-", "weight of the term gate", NotNegative);
        loss: MotionLoss = MotionLoss::default() => group;
        loss_gate: f64 = 1.0 => ("1/m", "weight of the way to the gate's middle in the loss", NotNegative);
        loss_clearance: f64 = 0.5 => ("m", "weight of the clearance in the loss", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct FlyThrough {
    robot: Robot,
    settings: FlyThroughSettings,
    gate: Gate,
    skin: CollisionShapes,
    /// Body of the gate's frame.
    frame: usize,
    /// Its coordinate in the state.
    slide: usize,
}

impl BuiltIn for FlyThrough {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: FlyThroughSettings = config.settings()?;
        let vehicle = config.vehicle(&settings.vehicle)?;
        let slide = GateSlide { damping: settings.gate_damping, ..GateSlide::default() };
        let gate = Gate { position: settings.gate_position, slide: Some(slide), ..Gate::default() };
        let scene = Scene { gates: vec![gate.clone()], ..Scene::default() };
        let drone = Member::new("drone", single(&rounded(&vehicle))?, [0.0; 3]);
        let model = softened(&environment("fly_through", &[drone], &scene)?, vehicle.mass_properties().mass)?;
        let frame = model.joint("gate/slide")?;
        let slide = model.layout().bodies[frame].position;
        let robot = Robot::of_model(&model, touching(config), Some(&vehicle), |_| vec![])?;
        Ok(Self { robot, settings, gate, skin: CollisionShapes::of(&model), frame, slide })
    }
}

impl FlyThrough {
    /// p_t − p.
    fn error<S: Scalar>(view: &View<'_, S>) -> Vec3<S> {
        sub(view.goal.array(0), view.drone(0).position)
    }

    fn gate<S: Scalar>(&self, view: &View<'_, S>) -> Frame<S> {
        view.frame(self.frame)
    }

    /// g − p.
    fn way<S: Scalar>(&self, view: &View<'_, S>) -> [S; 3] {
        sub(self.gate(view).position, view.drone(0).position)
    }

    /// Least distance of the drone to the frame, m.
    fn clearance<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let frame = self.gate(view);
        let bars = self.gate.bars(&Pose { position: frame.position, attitude: frame.attitude });
        self.skin.clearance(view, &bars, self.gate.bar_radius())
    }
}

impl Task for FlyThrough {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p drone, g, v_g the gate's middle and its velocity, v, ω velocity and angular velocity of the drone (world), \
         u = R e_z, e = Σ s effort, k steps, d = ‖p_t − p‖. The gate stands at {gate_position} m, its opening has \
         half sizes of 0.616 × 0.561 m; it starts within ±{gate_offset} m along y and swings back on a spring (4 kg, \
         3 N/m). Target: p_t uniform in {target} m. Start: p uniform in {start_position} m, roll and pitch within \
         ±{start_tilt} rad, yaw within {start_yaw} rad, at rest."
    }

    fn start(&self, start: &mut Start<'_>) {
        let own = &self.settings;
        let target = own.target.map(|[low, high]| start.task.uniform(low, high));
        set_target(start, target);
        let offset = start.task.uniform(-own.gate_offset, own.gate_offset);
        start.state[self.slide] = eased(own.gate_ease, start.difficulty) * offset;
        let (position, attitude) = own.start.draw(start);
        let position = along_the_course(start, own.start_along, position, target, CLEAR);
        start.place(0, position, attitude);
        // what begins behind the gate has crossed it
        start.task_state[0] = flag(position[0].gt(own.gate_position[0]));
    }

    fn remember(&self, view: &View, task_state: &mut Writer) {
        let (way, half, own) = (self.way(view), Trace::constant(0.5), &self.settings);
        let crossed = view.task_state[0];
        let beyond = way[0].lt(Trace::zero());
        let inside = less(way[1].abs(), own.gate_aperture).and(less(way[2].abs(), own.gate_aperture));
        let missed = beyond.and(inside.not()).and(crossed.lt(half));
        task_state.field("crossed", "-", "1 once x > 0").number(latch(crossed, beyond));
        let missed = Trace::select(missed, Trace::one(), Trace::zero());
        task_state.field("missed", "-", "1 in the first step with x > 0 beside the gate").number(missed);
        let reached = latch(view.task_state[2], nearer(Self::error(view), own.success_distance));
        task_state.field("reached", "-", "1 once d < {success_distance} m").number(reached);
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        view.observe_drone(0, out);
        out.field("target", "m, world", "p_t − p").array(Self::error(view));
        out.field("gate_velocity", "m/s, world", "v_g").array(self.gate(view).velocity);
        out.field("gate", "m, world", "g − p").array(self.way(view));
        view.observe_clock(out);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let (drone, way, own, w) = (view.drone(0), self.way(view), &self.settings, &self.settings.reward);
        let pose = exponential_kernel(own.pose_scale, Self::error(view));
        let (before, ahead) = (Trace::zero().lt(way[0]), way[0].max(Trace::zero()));
        let beside = (way[1].abs() + way[2].abs()).min(Trace::constant(FAR_BESIDE));
        let middle = (Trace::constant(0.8) - beside) * (-ahead).exp();
        let kept = pose + Trace::constant(own.pose_floor);
        let most = 1.0 + own.pose_floor;
        terms
            .term("pose", "{×reward_pose}r_p, r_p = e^{−{×pose_scale}d}", w.pose)
            .piecewise()
            .number(times(w.pose, pose));
        let formula = "{×reward_gate}(0.8 − min(|g_y − y| + |g_z − z|, 5 m)) e^{x} for x < 0, else {reward_gate}";
        terms.term("gate", formula, own.reward_gate);
        terms.within(own.reward_gate * (0.8 - FAR_BESIDE), own.reward_gate).non_smooth();
        terms.number(times(own.reward_gate, Trace::select(before, middle, Trace::one())));
        terms.term("up", "{×reward_up}(r_p + {pose_floor}) ((u_z + 1)/2)²", w.up * most).piecewise();
        terms.number(times(w.up, kept) * upright(drone.up()));
        terms.term("spin", "{×reward_spin}(r_p + {pose_floor})/(1 + ω_z²)", w.spin * most).piecewise();
        terms.number(times(w.spin, kept) * still(drone.angular_velocity));
        terms.term("effort", "{×reward_effort}e^{−e}", w.effort).number(ease_of_flight(w.effort, view));
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let (position, own) = (view.drone(0).position, &self.settings);
        ends.when("crash", "z < {min_height} m", less(position[2], own.min_height));
        ends.when("high", "z > {max_height} m", more(position[2], own.max_height));
        ends.when("wide", "|y| > {max_side} m", more(position[1].abs(), own.max_side));
        ends.when("far", "d > {max_distance} m", farther(Self::error(view), own.max_distance));
        let missed = "not |g_y − y| < {gate_aperture} m and |g_z − z| < {gate_aperture} m in the first step with x > 0";
        ends.when("missed", missed, more(view.task_state[1], 0.5));
        let contact = where_on::<Trace>(own.reset_on_collision, touches(self.clearance(view)));
        ends.when("contact", "touches the frame, if reset_on_collision", contact);
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("position_error", "m", safe::norm(Self::error(view)));
        out.metric("uprightness", "-", view.drone(0).up()[2]);
        out.metric("clearance", "m", self.clearance(view));
        out.metric("throttle_difference", "-", view.throttle_difference(0));
    }

    succeeds_once!(self, view: view.task_state[2], self.settings.success_distance);

    fn loss(&self, view: &View, loss: &mut Loss) {
        let (drone, way, own, w) = (view.drone(0), self.way(view), &self.settings, &self.settings.loss);
        loss.add("√(d² + {loss_radius}²)", smooth_norm(Self::error(view), w.radius));
        // the middle of the opening counts near its plane
        let aside = speed_cost(own.loss_gate, [way[1], way[2]]) * rational_kernel(2.0, way[0].square());
        loss.add("{×loss_gate}h₅(b, c)/(1 + 4a²) with (a, b, c) = g − p", aside);
        loss.add("{×loss_velocity}h₅(v)", speed_cost(w.velocity, drone.velocity));
        loss.add("{×loss_rate}h₁₀(ω)", rate_cost(w.rate, drone.angular_velocity));
        loss.add(NEARNESS, nearness(own.loss_clearance, self.clearance(view)));
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let target = self.settings.target.map(|[low, high]| 0.5 * (low + high));
        set_target(start, target);
        start.place(0, target, [1.0, 0.0, 0.0, 0.0]);
    }
}

/// Keeps p_t.
fn set_target(start: &mut Start<'_>, target: Vec3<impl Into<Trace>>) {
    start.goal.field("target", "m, world", "p_t").array(target);
}
