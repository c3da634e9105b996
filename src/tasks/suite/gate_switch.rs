//! GateSwitch: two drones swap sides through one gate, one after the other.
//!
//! The second drone does as the first, turned by half a turn about z: it begins beyond the gate, faces it and flies against x.
//! The gate stands in the scene and drones are shapes, where a depth camera of the configuration sees both.
//!
//! - DIFFERENCE: all agents share the mean reward; published ones have half of it and half their own.
//! - DIFFERENCE: weights are those of the published MultiGate, whose form it names; its code does not run.
//! - DIFFERENCE: which drone goes first is settled at the start, and each sees whether it may go. The loss asks the other one to
//!   wait aside; reward and success do not.
//! - DIFFERENCE: no contact: touch of the frame ends the episode, wherever on the vehicle it is, propellers included, and drones
//!   that come closer than 0.5 m do before they touch.
//! - DIFFERENCE: the term gate falls no further than 5 m beside the gate; the spin term has ω_z², not ω_z⁴ (defect 14).
//! - DIFFERENCE: ends `high` and `wide`; without a camera all is observed, the other drone too. The published camera is 320 × 240
//!   pixels of 0.2 to 5 m.

use super::obstacles::{Ball, NEARNESS, balls, nearness};
use super::team::{
    CROWD, crowded, free_team, highest, lowest, mean_throttle_difference, observe_others, squared_separation,
};
use super::{
    MotionLoss, PoseReward, StartAttitude, StartRange, latch, less, made_of, more, rate_cost, speed_cost, times,
};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{exponential_kernel, rational_kernel, smooth_norm, still, upright};
use crate::robot::Robot;
use crate::settings;
use crate::start::{Start, flag};
use crate::task::{BuiltIn, Task, TaskReference, View};
use crate::task_spec::Success;
use autodiff::{Array, Mask, Scalar, Trace, TraceMask, safe};
use base::error::Result;
use controllers::reference::{Reference, Tilt, Waypoint, Waypoints};
use dynamics::scene::{FAR, Gate, Scene};
use dynamics::shape::Pose;
use dynamics::spatial::{Vec3, constants, multiply, sub};

/// Drones.
const N: usize = 2;
/// Beside the gate's middle the term gate falls no further than this, m.
const FAR_BESIDE: f64 = 5.0;
/// How far behind the gate the first drone is when the second may go, m.
const THROUGH: f64 = 0.6;
/// Where the second waits: so far before the gate, and so far aside of the first one's target, m.
const WAIT: [f64; 2] = [2.0, 1.2];
/// Of our controllers, s: when each drone is where it waits, leaves there, is before the gate, behind it, and at its target.
const TIMES: [[f64; 5]; N] = [[0.0, 0.0, 1.5, 2.1, 3.5], [1.5, 2.4, 3.8, 4.4, 5.8]];
/// They fly straight from so far before the gate to as far behind it, m.
const STRAIGHT: f64 = 0.5;

/// Places in the goal.
const FIRST: usize = 3 * N;
const WAITING: usize = FIRST + 1;
/// Places in the task state, behind a number per drone.
const MISSED: usize = N;
const TURN: usize = N + 1;
const CLEARANCE: usize = N + 2;

/// Where starts are.
fn start_range() -> StartRange {
    let position = [[-2.5, -2.0], [-0.5, 0.5], [1.75, 2.25]];
    StartRange { position, attitude: StartAttitude { yaw: [0.0, 0.0], ..StartAttitude::default() } }
}

settings! {
    /// Settings of [`GateSwitch`].
    pub(crate) struct GateSwitchSettings {
        vehicle: String = "hummingbird".into() => ("", "what both drones are", Any);
        horizon: usize = 500 => ("steps", "T", Any);
        gate_height: f64 = 2.0 => ("m", "z of the gate's middle, at x = y = 0", Any);
        gate_aperture: f64 = 0.5 => ("m", "farther beside the gate's middle along y or z it is missed", Positive);
        target: [[f64; 2]; 3] = [[1.75, 2.25], [-0.5, 0.5], [1.75, 2.25]]
            => ("m, world", "p_t of the first drone, lowest and highest per axis", Ordered);
        start: StartRange = start_range() => group;
        min_height: f64 = 0.2 => ("m", "a lower drone is a crash", Any);
        max_height: f64 = 3.5 => ("m", "a higher drone ends the episode", Any);
        max_side: f64 = 2.5 => ("m", "a drone farther along y ends the episode", Positive);
        max_distance: f64 = 6.0 => ("m", "a drone farther from its target ends the episode", Positive);
        min_separation: f64 = 0.5 => ("m", "closer drones touch", Positive);
        success_distance: f64 = 0.3 => ("m", "position error of a success", Positive);
        pose_scale: f64 = 1.0 => ("1/m", "how steeply r_p falls", NotNegative);
        pose_floor: f64 = 0.3 => ("-", "what up and spin are worth far from the target", NotNegative);
        reward: PoseReward = PoseReward { pose: 1.4, up: 0.5, ..PoseReward::default() } => group;
        reward_gate: f64 = 1.0 => ("-", "weight of the term gate", NotNegative);
        loss: MotionLoss = MotionLoss::default() => group;
        loss_gate: f64 = 1.0 => ("1/m", "weight of the way to the gate's middle in the loss", NotNegative);
        loss_clearance: f64 = 0.5 => ("m", "weight of the clearance in the loss", NotNegative);
        loss_crowd: f64 = 1.0 => ("m", "weight of drones too close to each other in the loss", NotNegative);
        loss_separation: f64 = 0.9 => ("m", "least distance of two drones that costs nothing in the loss", Positive);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct GateSwitch {
    robot: Robot,
    settings: GateSwitchSettings,
    gate: Gate,
    balls: Vec<Ball>,
}

impl BuiltIn for GateSwitch {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: GateSwitchSettings = config.settings()?;
        let gate = Gate { position: [0.0, 0.0, settings.gate_height], ..Gate::default() };
        gate.validate("task.gate_height")?;
        let balls = balls(&config.vehicle(&settings.vehicle)?);
        let robot = free_team("gate_switch", config, &settings.vehicle, N)?;
        Ok(Self { robot, settings, gate, balls })
    }
}

/// +1 for the drone that flies along x, −1 for the one against it.
fn sign(i: usize) -> f64 {
    if i == 0 { 1.0 } else { -1.0 }
}

/// A place as drone `i` has it: of the second one turned by half a turn about z.
fn turned<S: Scalar>(i: usize, [x, y, z]: Vec3<S>) -> Vec3<S> {
    [times(sign(i), x), times(sign(i), y), z]
}

impl GateSwitch {
    /// p_t,i − p_i.
    fn error<S: Scalar>(view: &View<'_, S>, i: usize) -> Vec3<S> {
        sub(view.goal.array(3 * i), view.drone(i).position)
    }

    /// max ‖p_t,i − p_i‖².
    fn squared_error<S: Scalar>(view: &View<'_, S>) -> S {
        safe::squared_norm(Self::error(view, 0)).max(safe::squared_norm(Self::error(view, 1)))
    }

    /// g − p_i.
    fn way<S: Scalar>(&self, view: &View<'_, S>, i: usize) -> Vec3<S> {
        sub(constants(self.gate.position), view.drone(i).position)
    }

    /// a_i: how far drone i is beyond the gate, negative before it, m.
    fn beyond<S: Scalar>(view: &View<'_, S>, i: usize) -> S {
        times(sign(i), view.drone(i).position[0])
    }

    /// 1 where drone i goes first, else 0.
    fn goes_first<S: Scalar>(view: &View<'_, S>, i: usize) -> S {
        let second = view.goal[FIRST];
        if i == 0 { S::one() - second } else { second }
    }

    /// 1 where drone i may go through, else 0.
    fn may_go<S: Scalar>(view: &View<'_, S>, i: usize) -> S {
        let first = Self::goes_first(view, i);
        (S::one() - first).mul_add(view.task_state[TURN], first)
    }

    /// Where the loss wants drone i, less where it is: at its target, or where it waits.
    fn wanted<S: Scalar>(view: &View<'_, S>, i: usize) -> Vec3<S> {
        let (go, position) = (more(Self::may_go(view, i), 0.5), view.drone(i).position);
        let (target, waiting): (Vec3<S>, Vec3<S>) = (view.goal.array(3 * i), view.goal.array(WAITING));
        let mut way = [S::zero(); 3];
        for k in 0..3 {
            way[k] = S::select(go, target[k], waiting[k]) - position[k];
        }
        way
    }

    /// Least distance between a drone and the gate's bars, m.
    fn clearance<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let pose = Pose { position: constants(self.gate.position), attitude: constants(self.gate.rotation) };
        let mut least = S::constant(FAR);
        for i in 0..N {
            let drone = view.drone(i);
            for k in 0..self.balls.len() {
                let Ball { centre, radius } = self.balls[k];
                let distance = self.gate.distance(&pose, drone.point(constants(centre)).0);
                least = least.min(distance - S::constant(radius));
            }
        }
        least
    }

    /// Keeps targets, who goes first from here, and where the other one waits.
    fn set_goal(&self, start: &mut Start<'_>, targets: [Vec3<Trace>; N], from: [Vec3<Trace>; N]) {
        let ways = from.map(|p| safe::squared_norm(sub(constants(self.gate.position), p)));
        let second = ways[1].lt(ways[0]);
        let [along, aside] = WAIT.map(Trace::from);
        let target = Trace::select(second, targets[1][1], targets[0][1]);
        let waiting = [
            Trace::select(second, along * sign(1), along * sign(0)),
            Trace::select(target.lt(0.0), aside, -aside),
            self.gate.position[2].into(),
        ];
        start.goal.field("targets", "m, world", "p_t of both drones");
        targets.iter().for_each(|target| start.goal.array(*target));
        start.goal.field("first", "-", "which drone goes first, 0 or 1").number(flag::<Trace>(second));
        start.goal.field("waiting", "m, world", "where the other one waits").array(waiting);
    }

    /// What drone i sees of itself.
    fn observe_own(&self, view: &View, i: usize, out: &mut Writer) {
        view.observe_drone(i, out);
        out.field("target", "m, world", "p_t,i − p_i").array(Self::error(view, i));
        out.field("gate", "m, world", "g − p_i").array(self.way(view, i));
        out.field("direction", "-", "1 where it flies along x, −1 against it").within(-1.0, 1.0);
        out.number(Trace::constant(sign(i)));
        out.field("turn", "-", "1 where it may go, else 0").within(0.0, 1.0).number(Self::may_go(view, i));
    }
}

impl Task for GateSwitch {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p_i, v_i, ω_i drones (world), u_i = R e_z, d_i = ‖p_t,i − p_i‖, e_i = Σ s effort, g the gate's middle at z = \
         {gate_height} m, across x, its opening of half sizes 0.616 × 0.561 m; a_i = x for drone 0 and −x for drone 1, which does \
         all as drone 0 turned by half a turn about z; c least distance between the gate's bars and the drones, propellers \
         included; sep distance of the drones; k steps. Target: p_t,0 uniform in {target} m. Start: p_0 uniform in \
         {start_position} m, roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, at rest. The drone nearer to \
         the gate there goes first; the other one may go once that is 0.6 m behind the gate, and until then the loss wants it \
         2 m before the gate, 1.2 m aside: w_i is where it wants drone i, p_t,i or there."
    }

    fn scene(&self) -> Scene {
        Scene { gates: vec![self.gate.clone()], ..Scene::grounded() }
    }

    fn start(&self, start: &mut Start<'_>) {
        let own = &self.settings;
        let mut targets = [[Trace::zero(); 3]; N];
        let mut from = targets;
        for i in 0..N {
            targets[i] = turned(i, own.target.map(|[low, high]| start.task.uniform(low, high)));
            let (position, attitude) = own.start.draw(start);
            from[i] = turned(i, position);
            let half_turn = constants([0.0, 0.0, 0.0, 1.0]);
            start.place(i, from[i], if i == 0 { attitude } else { multiply(half_turn, attitude) });
        }
        self.set_goal(start, targets, from);
    }

    fn remember(&self, view: &View, task_state: &mut Writer) {
        let own = &self.settings;
        let (mut missed, mut turn) = (Trace::zero(), view.task_state[TURN]);
        task_state.field("crossed", "-", "1 once a_i > 0, of both drones");
        for i in 0..N {
            let (crossed, way, beyond) = (view.task_state[i], self.way(view, i), Self::beyond(view, i));
            let inside = less(way[1].abs(), own.gate_aperture).and(less(way[2].abs(), own.gate_aperture));
            let now = more(beyond, 0.0);
            missed = latch(missed, now.and(less(crossed, 0.5)).and(inside.not()));
            turn = latch(turn, more(Self::goes_first(view, i), 0.5).and(more(beyond, THROUGH)));
            task_state.number(latch(crossed, now));
        }
        task_state
            .field("missed", "-", "1 in a step in which a drone first has a_i > 0, beside the gate")
            .number(missed);
        task_state.field("turn", "-", "1 once the first drone is 0.6 m behind the gate").number(turn);
        task_state.field("clearance", "m", "c after the last step").number(self.clearance(view));
    }

    fn observe(&self, view: &View, agent: usize, out: &mut Writer) {
        self.observe_own(view, agent, out);
        view.observe_clock(out);
        observe_others(view, agent, true, out);
    }

    fn central(&self, view: &View, out: &mut Writer) {
        out.field("drones", "as observed", "attitude … turn of both drones");
        for i in 0..N {
            out.unnamed(|out| self.observe_own(view, i, out));
        }
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let (own, w) = (&self.settings, &self.settings.reward);
        let [mut pose, mut gate, mut up, mut spin] = [Trace::zero(); 4];
        for i in 0..N {
            let (drone, way, beyond) = (view.drone(i), self.way(view, i), Self::beyond(view, i));
            let near = exponential_kernel(own.pose_scale, Self::error(view, i));
            let kept = near + Trace::constant(own.pose_floor);
            let beside = (way[1].abs() + way[2].abs()).min(Trace::constant(FAR_BESIDE));
            let middle = (Trace::constant(0.8) - beside) * beyond.min(Trace::zero()).exp();
            pose += near;
            gate += Trace::select(less(beyond, 0.0), middle, Trace::one());
            up += kept * upright(drone.up());
            spin += kept * still(drone.angular_velocity);
        }
        let (half, most) = (1.0 / N as f64, 1.0 + own.pose_floor);
        terms.term("pose", "{×reward_pose}mean r_p, r_p = e^{−{×pose_scale}d_i}", w.pose).piecewise();
        terms.number(times(half * w.pose, pose));
        let formula = "{×reward_gate}mean((0.8 − min(|g_y − y_i| + |g_z − z_i|, 5 m)) e^{a_i}, 1 if a_i ≥ 0)";
        terms.term("gate", formula, own.reward_gate);
        terms.within(own.reward_gate * (0.8 - FAR_BESIDE), own.reward_gate).non_smooth();
        terms.number(times(half * own.reward_gate, gate));
        terms.term("up", "{×reward_up}mean (r_p + {pose_floor}) ((u_z + 1)/2)²", w.up * most).piecewise();
        terms.number(times(half * w.up, up));
        terms.term("spin", "{×reward_spin}mean (r_p + {pose_floor})/(1 + ω_z²)", w.spin * most).piecewise();
        terms.number(times(half * w.spin, spin));
        terms.term("effort", "{×reward_effort}mean e^{−e_i}", w.effort);
        terms.number(times(w.effort, view.mean_effort_reward()));
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let own = &self.settings;
        let (least, most) = (own.min_separation, own.max_distance);
        let side = view.drone(0).position[1].abs().max(view.drone(1).position[1].abs());
        ends.when("crash", "min z_i < {min_height} m", less(lowest(view), own.min_height));
        ends.when("high", "max z_i > {max_height} m", more(highest(view), own.max_height));
        ends.when("wide", "max |y_i| > {max_side} m", more(side, own.max_side));
        ends.when("far", "max d_i > {max_distance} m", more(Self::squared_error(view), most * most));
        let missed =
            "not |g_y − y_i| < {gate_aperture} m and |g_z − z_i| < {gate_aperture} m in the first step with a_i > 0";
        ends.when("missed", missed, more(view.task_state[MISSED], 0.5));
        ends.when("contact", "c < 0", less(view.task_state[CLEARANCE], 0.0));
        ends.when("touch", "sep < {min_separation} m", less(squared_separation(view), least * least));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        let floor = safe::SQUARED_NORM_FLOOR;
        out.metric("position_error", "m", safe::sqrt(Self::squared_error(view), floor));
        out.metric("separation", "m", safe::sqrt(squared_separation(view), floor));
        out.metric("clearance", "m", view.task_state[CLEARANCE]);
        out.metric("crossed", "-", view.task_state[0] + view.task_state[1]);
        out.metric("throttle_difference", "-", mean_throttle_difference(view));
    }

    fn success(&self, view: &View) -> TraceMask {
        let most = self.settings.success_distance;
        less(Self::squared_error(view), most * most)
    }

    fn success_rule(&self) -> Success {
        Success::below("position_error", self.settings.success_distance)
    }

    fn loss(&self, view: &View, loss: &mut Loss) {
        let (own, w) = (&self.settings, &self.settings.loss);
        let mut sum = Trace::zero();
        for i in 0..N {
            let (drone, way) = (view.drone(i), self.way(view, i));
            sum += smooth_norm(Self::wanted(view, i), w.radius);
            // the middle of the opening counts near its plane
            sum += speed_cost(own.loss_gate, [way[1], way[2]]) * rational_kernel(2.0, way[0].square());
            sum += speed_cost(w.velocity, drone.velocity);
            sum += rate_cost(w.rate, drone.angular_velocity);
        }
        let formula = "mean(√(‖w_i − p_i‖² + {loss_radius}²) + {×loss_gate}h₅(b, c)/(1 + 4a²) + {×loss_velocity}h₅(v_i) + \
             {×loss_rate}h₁₀(ω_i)), (a, b, c) = g − p_i";
        loss.add(formula, Trace::constant(1.0 / N as f64) * sum);
        loss.add(NEARNESS, nearness(own.loss_clearance, view.task_state[CLEARANCE]));
        loss.add(CROWD, crowded(own.loss_crowd, view, own.loss_separation));
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        let way = |i: usize| {
            let (drone, target) = (view.drone(i), view.goal.array(3 * i));
            let waits = usize::from(Self::goes_first(view, i) < 0.5);
            let waiting: Vec3<f64> = view.goal.array(WAITING);
            let [before, behind] = [-STRAIGHT, STRAIGHT].map(|x| turned(i, [x, 0.0, self.gate.position[2]]));
            let places = [waiting, waiting, before, behind, target];
            let on_the_way = TIMES[waits].into_iter().zip(places).filter(|(time, _)| *time > 0.0);
            let points = std::iter::once((0.0, drone.position)).chain(on_the_way);
            let point = |(time, position)| Waypoint { time, position, yaw: drone.yaw() };
            Waypoints::new(points.map(point).collect()).ok().map(Reference::Waypoints)
        };
        let references = (0..N).map(way).collect::<Option<Vec<_>>>()?;
        Some(TaskReference { references, tilt: Tilt::LEVEL, follower: None })
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let middle = self.settings.target.map(|[low, high]| 0.5 * (low + high));
        let targets = [0, 1].map(|i| turned(i, constants(middle)));
        (0..N).for_each(|i| start.place(i, targets[i], [1.0, 0.0, 0.0, 0.0]));
        self.set_goal(start, targets, targets);
    }
}
