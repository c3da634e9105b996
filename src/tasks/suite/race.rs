//! Race: fly through gates in order, round and round, by what the state says of the next two, or by what sensors see of them.
//!
//! The course is the published one, a track of the University of Zurich at a scale of 0.6, or one of the configuration's own:
//! `gates`. Every gate is displaced anew in every episode. Gates stand in the scene, where cameras and lidars of the configuration
//! see them; reward and ends do not depend on which sensor flies. What makes the course easier is `gate_ease`, the share of
//! the displacement.
//!
//! - DIFFERENCE: gates are displaced by up to `gate_offset`; published ones stand still. Their yaw is that of the course.
//! - DIFFERENCE: gates are OmniDrones' frame at scale 1.1, as in [FlyThrough](super::fly_through); published ones at 1.2 × 1.1.
//! - DIFFERENCE: the upper of the two gates above each other is at 2.7 m; published at 2.4 m, where their frames overlap.
//! - DIFFERENCE: the whole opening counts, and touch ends an episode wherever on the vehicle it is, propellers included; a
//!   published passage is one within 0.4 m of the middle.
//! - DIFFERENCE: what is observed is ours: the published observation is that of another simulator, in the body's frame.
//! - DIFFERENCE: the term progress is the speed towards the gate, held within a bound; published is the way of a step without one.
//! - DIFFERENCE: no term forward, whose sign rewards to look away from the gate; none of smoothness and of reach, whose place the
//!   loss takes; the terms up and spin are those of the other tasks, between 0 and 1.
//! - DIFFERENCE: starts are before any gate; published before one of the first five.

use super::obstacles::{Ball, balls};
use super::{StartAttitude, eased, less, made_of, more, narrowed, rate_cost, speed_cost, squared, times};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{still, upright};
use crate::robot::Robot;
use crate::settings;
use crate::start::{Draw, Start};
use crate::task::{BuiltIn, Task, TaskReference, View};
use crate::task_spec::Success;
use autodiff::{Array, Mask, Scalar, Trace, TraceMask, safe};
use base::error::{Error, Result};
use controllers::reference::{Reference, Waypoint, Waypoints};
use dynamics::scene::{FAR, Gate, Scene};
use dynamics::shape::Pose;
use dynamics::spatial::{Quat, Vec3, constants, dot, from_euler, rotate, scale, sub};

/// Fewest and most gates of a course: a controller's path has two points per gate.
const GATES: [usize; 2] = [2, 30];
/// Starts are no nearer to the bars of a gate, m.
const CLEAR: f64 = 0.5;
/// Within this of the point that the loss aims at, it asks for less speed, m.
const NEAR: f64 = 0.3;
/// Our controllers fly straight from so far before a gate to as far behind it, m.
const STRAIGHT: f64 = 0.5;
/// Their speed on straight ways, m/s, what starting and stopping take beside that, s, and turning, s/rad.
const PACE: f64 = 3.0;
const EASING: f64 = 1.0;
const TURNING: f64 = 0.4;

/// Places in the task state.
const POSITION: usize = 0;
const NEXT: usize = 3;
const PASSED: usize = 4;
const MISSED: usize = 5;
const SCORED: usize = 6;
const CLEARANCE: usize = 7;

/// The published course: (x, y, z) m and the direction of flight, rad.
fn course() -> Vec<[f64; 4]> {
    let degrees = [
        [-0.6, 0.75, 1.2, 0.0],
        [4.8, 3.75, 1.2, -15.0],
        [4.8, -1.875, 1.2, 225.0],
        [-2.25, -3.6, 1.2, 180.0],
        [-2.25, -3.6, 2.7, 0.0],
        [2.625, -0.375, 1.2, 85.0],
        [-1.5, 3.75, 1.2, 195.0],
    ];
    degrees.map(|[x, y, z, yaw]: [f64; 4]| [x, y, z, yaw.to_radians()]).to_vec()
}

settings! {
    /// Settings of [`Race`].
    pub(crate) struct RaceSettings {
        vehicle: String = "hummingbird".into() => ("", "what flies", Any);
        horizon: usize = 1250 => ("steps", "T", Any);
        gates: Vec<[f64; 4]> = Vec::new() => ("m, m, m, rad; world", "middle of every gate and direction to fly through it; none: the published course", Any);
        gate_scale: f64 = 1.1 => ("-", "of the frames: 1 has half sizes of 0.56 m × 0.51 m within its bars", Positive);
        gate_offset: [f64; 3] = [0.5, 0.5, 0.1] => ("m", "largest displacement of a gate along x, y and z", NotNegative);
        gate_ease: f64 = 1.0 => ("-", "factor of that displacement at difficulty 0", NotNegative);
        start_place: [[f64; 2]; 3] = [[-3.0, -1.0], [-0.5, 0.5], [-0.3, 0.3]]
            => ("m", "place of starts along a gate's x, y and z, lowest and highest", Ordered);
        start_anywhere: f64 = 1.0 => ("-", "share of episodes that begin before any gate, not the first", Share);
        start: StartAttitude = StartAttitude::default() => group;
        min_height: f64 = 0.3 => ("m", "lower is a crash", Any);
        max_height: f64 = 5.0 => ("m", "higher ends the episode", Any);
        max_distance: f64 = 12.0 => ("m", "farther from the next gate ends the episode", Positive);
        speed: f64 = 4.0 => ("m/s", "beyond which haste is worth no more", Positive);
        reward_progress: f64 = 0.5 => ("s/m", "weight of the term progress", NotNegative);
        reward_gate: f64 = 10.0 => ("-", "of a gate passed", NotNegative);
        reward_alive: f64 = 1.0 => ("-", "of every step that does not end", NotNegative);
        reward_up: f64 = 0.2 => ("-", "weight of the term up", NotNegative);
        reward_spin: f64 = 0.1 => ("-", "weight of the term spin", NotNegative);
        loss_speed: f64 = 3.0 => ("m/s", "that the loss asks for", Positive);
        loss_ahead: f64 = 1.0 => ("m", "behind the middle of a gate, where the loss aims from before it", NotNegative);
        loss_pace: f64 = 0.3 => ("s²/m", "weight of the error of the velocity in the loss", NotNegative);
        loss_clearance: f64 = 2.0 => ("m", "weight of the clearance in the loss", NotNegative);
        loss_reach: f64 = 0.15 => ("m", "over which it falls by e", Positive);
        loss_up: f64 = 0.1 => ("m", "weight of ‖e_z − u‖² in the loss", NotNegative);
        loss_rate: f64 = 0.005 => ("m s²/rad²", "weight of the angular velocity in the loss", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Race {
    robot: Robot,
    settings: RaceSettings,
    scene: Scene,
    balls: Vec<Ball>,
}

impl BuiltIn for Race {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: RaceSettings = config.settings()?;
        let gates = if settings.gates.is_empty() { course() } else { settings.gates.clone() };
        let n = gates.len();
        if !(GATES[0]..=GATES[1]).contains(&n) {
            let limit = format!("{} to {} gates", GATES[0], GATES[1]);
            return Err(Error::limit("task.gates", n, limit, "For a single gate there is FlyThrough."));
        }
        check_course(&gates, &settings)?;
        let gate = |(i, [x, y, z, yaw]): (usize, &[f64; 4])| Gate {
            name: format!("gate {i}"),
            position: [*x, *y, *z],
            rotation: from_euler(0.0, 0.0, *yaw),
            scale: settings.gate_scale,
            ..Gate::default()
        };
        let scene = Scene { gates: gates.iter().enumerate().map(gate).collect(), ..Scene::grounded() };
        scene.validate()?;
        let balls = balls(&config.vehicle(&settings.vehicle)?);
        let robot = config.single_robot(&settings.vehicle)?;
        Ok(Self { robot, settings, scene, balls })
    }
}

/// Refuses a course on which a passage, or a start before a gate, would end the episode.
fn check_course(gates: &[[f64; 4]], own: &RaceSettings) -> Result<()> {
    let offset = safe::norm(own.gate_offset);
    let [lowest, highest] = own.start_place[2];
    for (i, [x, y, z, _]) in gates.iter().enumerate() {
        let [to_x, to_y, to_z, _] = gates[(i + 1) % gates.len()];
        let way = safe::norm([to_x - x, to_y - y, to_z - z]) + 2.0 * offset;
        if way >= own.max_distance {
            let (value, limit) =
                (format!("up to {way:.2} m"), format!("less than max_distance, {} m", own.max_distance));
            let remedy = "Move them together, or raise task.max_distance.";
            return Err(Error::value(format!("task.gates: from gate {i} to the next"), value, limit, remedy));
        }
        let [low, high] = [z + lowest - own.gate_offset[2], z + highest + own.gate_offset[2]];
        if low <= own.min_height || high >= own.max_height {
            let (value, limit) =
                (format!("{low:.2} to {high:.2} m"), format!("within {} to {} m", own.min_height, own.max_height));
            let remedy = "Move the gate, or change task.min_height and task.max_height.";
            return Err(Error::value(format!("task.gates: heights of starts before gate {i}"), value, limit, remedy));
        }
    }
    Ok(())
}

impl Race {
    fn n(&self) -> usize {
        self.scene.gates.len()
    }

    /// Of gate `i`.
    fn pose<S: Scalar>(&self, goal: &[S], i: usize) -> Pose<S> {
        Pose { position: goal.array(3 * i), attitude: constants(self.scene.gates[i].rotation) }
    }

    /// Of the gate whose number is nearest to `index`.
    fn pose_at<S: Scalar>(&self, goal: &[S], index: S) -> Pose<S> {
        let mut pose = self.pose(goal, 0);
        for i in 1..self.n() {
            let (here, own) = (more(index, i as f64 - 0.5), self.pose(goal, i));
            for k in 0..3 {
                pose.position[k] = S::select(here, own.position[k], pose.position[k]);
            }
            for k in 0..4 {
                pose.attitude[k] = S::select(here, own.attitude[k], pose.attitude[k]);
            }
        }
        pose
    }

    /// Of the next gate.
    fn next<S: Scalar>(&self, view: &View<'_, S>) -> Pose<S> {
        self.pose_at(view.goal, view.task_state[NEXT])
    }

    /// The number behind a gate's: the first follows the last.
    fn following<S: Scalar>(&self, index: S) -> S {
        let n = self.n() as f64;
        let following = index + S::one();
        S::select(more(following, n - 0.5), following - S::constant(n), following)
    }

    /// Least distance between the drone and the bars of all gates, m.
    fn clearance<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let (drone, mut least) = (view.drone(0), S::constant(FAR));
        for k in 0..self.balls.len() {
            let Ball { centre, radius } = self.balls[k];
            let point = drone.point(constants(centre)).0;
            for i in 0..self.n() {
                let distance = self.scene.gates[i].distance(&self.pose(view.goal, i), point);
                least = least.min(distance - S::constant(radius));
            }
        }
        least
    }

    /// Keeps where gates stand, displaced by `offset` of their number and axis, and which of them comes first.
    fn set_goal(&self, start: &mut Start<'_>, first: Trace, mut offset: impl FnMut(&mut Start<'_>, usize) -> Trace) {
        start.goal.field("gates", "m, world", "middle of every gate");
        for gate in &self.scene.gates {
            for k in 0..3 {
                let x = offset(start, k) + gate.position[k];
                start.goal.number(x);
            }
        }
        start.goal.field("first", "-", "number of the gate that is the first to pass, from 0 on").number(first);
    }

    /// Puts the drone before gate `first`, at `place` in its frame.
    fn begin(&self, start: &mut Start<'_>, first: Trace, place: Vec3<Trace>, attitude: Quat<Trace>) {
        let position = self.pose_at(&start.goal, first).point(place);
        start.place(0, position, attitude);
        start.task_state[POSITION..POSITION + 3].copy_from_slice(&position);
        start.task_state[NEXT] = first;
    }

    /// Least distance between a point and the bars of all gates, m.
    fn distance(&self, goal: &[Trace], point: Vec3<Trace>) -> Trace {
        let gates = self.scene.gates.iter().enumerate();
        gates.fold(Trace::constant(FAR), |least, (i, gate)| least.min(gate.distance(&self.pose(goal, i), point)))
    }
}

/// (g − p)·v/‖g − p‖.
fn towards<S: Scalar>(way: Vec3<S>, velocity: Vec3<S>) -> S {
    dot(way, velocity) * safe::recip_sqrt(safe::squared_norm(way), safe::SQUARED_NORM_FLOOR)
}

/// A controller's path goes on to a place: at its pace, and slower by the angles between the way there and `turns`.
fn go_on(path: &mut Vec<Waypoint>, position: Vec3<f64>, turns: impl Iterator<Item = Vec3<f64>>) {
    let last = path[path.len() - 1];
    let way = sub(position, last.position);
    // before the first reset all gates are in one place
    let length = safe::norm(way).max(1e-9);
    let angles: f64 = turns.map(|turn| safe::acos(dot(turn, way) / length)).sum();
    path.push(Waypoint { time: last.time + length / PACE + TURNING * angles, position, ..last });
}

/// e_x of a gate.
fn direction<S: Scalar>(gate: &Pose<S>) -> Vec3<S> {
    rotate(gate.attitude, constants([1.0, 0.0, 0.0]))
}

impl Task for Race {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p drone, v, ω velocity and angular velocity (world), u = R e_z, g, n middle of the next gate and the direction to fly \
         through it, g₂, n₂ of the one after it, c least distance between the bars of all gates and the drone, propellers \
         included. A gate is passed where p crosses its plane along n within its opening; then the next is the one after it, \
         and the first follows the last. Gates stand where the course says, displaced by up to {gate_offset} m. Start: before \
         any gate in a share of {start_anywhere}, else before the first, at x, y, z uniform in {start_place} m of its frame, \
         roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, at rest."
    }

    fn scene(&self) -> Scene {
        self.scene.clone()
    }

    fn place_scene(&self, goal: &[f64], placement: &mut [f64]) {
        for (i, gate) in self.scene.gates.iter().enumerate() {
            (0..3).for_each(|k| placement[3 * i + k] = goal[3 * i + k] - gate.position[k]);
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        let own = &self.settings;
        let share = eased(own.gate_ease, start.difficulty);
        let (anywhere, any) = start.task.sometimes(own.start_anywhere, Draw::Below(self.n() as u64));
        let first = Trace::select(anywhere, any, Trace::zero());
        self.set_goal(start, first, |start, k| share * start.task.uniform(-own.gate_offset[k], own.gate_offset[k]));
        let share = own.start.share(start);
        start.again(100, |start| {
            let place = start.position(own.start_place.map(|range| narrowed(range, share)));
            let attitude = own.start.draw(start);
            self.begin(start, first, place, attitude);
            let position = start.task_state.array(POSITION);
            self.distance(&start.goal, position).gt(CLEAR)
        });
    }

    fn remember(&self, view: &View, task_state: &mut Writer) {
        let (zero, one) = (Trace::zero(), Trace::one());
        let (from, to, next) = (view.task_state.array(POSITION), view.drone(0).position, view.task_state[NEXT]);
        let passage = self.scene.gates[0].passage(&self.next(view), from, to);
        let (crossed, inside) = (more(passage.direction, 0.5), more(passage.margin, 0.0));
        let passed = crossed.and(inside);
        task_state.field("position", "m, world", "p after the last step").array(to);
        let following = Trace::select(passed, self.following(next), next);
        task_state.field("next", "-", "number of the next gate, from 0 on").number(following);
        let scored = Trace::select(passed, one, zero);
        task_state.field("passed", "-", "gates passed so far").number(view.task_state[PASSED] + scored);
        let missed = Trace::select(crossed.and(inside.not()), one, zero);
        task_state.field("missed", "-", "1 in a step through the next gate's plane beside its opening").number(missed);
        task_state.field("scored", "-", "1 in a step through the next gate").number(scored);
        task_state.field("clearance", "m", "c after the last step").number(self.clearance(view));
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        let (position, next) = (view.drone(0).position, view.task_state[NEXT]);
        view.observe_drone(0, out);
        out.field("height", "m, world", "z").number(position[2]);
        let gate = self.pose_at(view.goal, next);
        out.field("gate", "m, world", "g − p").array(sub(gate.position, position));
        out.field("gate_direction", "-, world", "n").within(-1.0, 1.0).array(direction(&gate));
        let gate = self.pose_at(view.goal, self.following(next));
        out.field("following", "m, world", "g₂ − p").array(sub(gate.position, position));
        out.field("following_direction", "-, world", "n₂").within(-1.0, 1.0).array(direction(&gate));
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let (drone, own) = (view.drone(0), &self.settings);
        let way = sub(self.next(view).position, drone.position);
        let speed = towards(way, drone.velocity).min(Trace::constant(own.speed)).max(Trace::constant(-own.speed));
        let most = own.reward_progress * own.speed;
        terms.term("progress", "{×reward_progress}v·(g − p)/‖g − p‖, held within ±{speed} m/s", most);
        terms.within(-most, most).piecewise().number(times(own.reward_progress, speed));
        terms.term("gate", "{×reward_gate}1 where a gate is passed", own.reward_gate).non_smooth();
        terms.number(times(own.reward_gate, view.task_state[SCORED]));
        terms.term("alive", "{×reward_alive}1", own.reward_alive).number(Trace::constant(own.reward_alive));
        terms.term("up", "{×reward_up}((u_z + 1)/2)²", own.reward_up).number(times(own.reward_up, upright(drone.up())));
        terms.term("spin", "{×reward_spin}1/(1 + ω_z²)", own.reward_spin);
        terms.number(times(own.reward_spin, still(drone.angular_velocity)));
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let (position, own) = (view.drone(0).position, &self.settings);
        ends.when("crash", "z < {min_height} m", less(position[2], own.min_height));
        ends.when("high", "z > {max_height} m", more(position[2], own.max_height));
        let way = sub(self.next(view).position, position);
        ends.when("far", "‖g − p‖ > {max_distance} m", super::farther(way, own.max_distance));
        let missed = "the next gate's plane is crossed along n beside its opening";
        ends.when("missed", missed, more(view.task_state[MISSED], 0.5));
        ends.when("contact", "c < 0", less(view.task_state[CLEARANCE], 0.0));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        let (drone, passed) = (view.drone(0), view.task_state[PASSED]);
        out.metric("gates_left", "-", (Trace::constant(self.n() as f64) - passed).max(Trace::zero()));
        out.metric("gates_passed", "-", passed);
        out.metric("gate_distance", "m", safe::norm(sub(self.next(view).position, drone.position)));
        out.metric("clearance", "m", view.task_state[CLEARANCE]);
        out.metric("speed", "m/s", safe::norm(drone.velocity));
        out.metric("uprightness", "-", drone.up()[2]);
    }

    fn success(&self, view: &View) -> TraceMask {
        more(view.task_state[PASSED], self.n() as f64 - 0.5)
    }

    fn success_rule(&self) -> Success {
        Success::below("gates_left", 0.5).once()
    }

    fn loss(&self, view: &View, loss: &mut Loss) {
        let (drone, own, gate) = (view.drone(0), &self.settings, self.next(view));
        let [_, y, z] = gate.local(drone.position);
        let beside = safe::norm([y, z]);
        let aim = gate.point([Trace::constant(own.loss_ahead) - beside, Trace::zero(), Trace::zero()]);
        let way = sub(aim, drone.position);
        let soft = Trace::constant(NEAR * NEAR);
        let wanted = scale(Trace::constant(own.loss_speed) * (safe::squared_norm(way) + soft).sqrt().recip(), way);
        loss.add(
            "{×loss_pace}h₅(v − v_t), v_t = {loss_speed} m/s (q − p)/√(‖q − p‖² + (0.3 m)²), q = g + ({loss_ahead} m − b) n, b \
             the distance of p to the line through g along n",
            speed_cost(own.loss_pace, sub(drone.velocity, wanted)),
        );
        let clearance = view.task_state[CLEARANCE].max(Trace::constant(-0.2));
        let near = (Trace::constant(-1.0 / own.loss_reach) * clearance).exp();
        loss.add("{×loss_clearance}e^{−max(c, −0.2 m)/{loss_reach} m}", times(own.loss_clearance, near));
        let lean = sub(constants([0.0, 0.0, 1.0]), drone.up());
        loss.add("{×loss_up}‖e_z − u‖²", squared(own.loss_up, lean));
        loss.add("{×loss_rate}h₁₀(ω)", rate_cost(own.loss_rate, drone.angular_velocity));
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        let (drone, n) = (view.drone(0), self.n());
        let first = view.goal[3 * n] as usize;
        let mut points = vec![Waypoint { time: 0.0, position: drone.position, yaw: drone.yaw() }];
        let mut behind = None;
        for i in (first..first + n).map(|i| i % n) {
            let gate = self.pose(view.goal, i);
            let [before, after] = [-STRAIGHT, STRAIGHT].map(|x| gate.point([x, 0.0, 0.0]));
            let turns = [behind, Some(direction(&gate))].into_iter().flatten();
            go_on(&mut points, before, turns);
            go_on(&mut points, after, std::iter::empty());
            behind = Some(direction(&gate));
        }
        // it begins and stops at rest
        points.iter_mut().skip(1).for_each(|point| point.time += EASING);
        points.last_mut()?.time += EASING;
        Some(TaskReference::one(Reference::Waypoints(Waypoints::new(points).ok()?)))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.set_goal(start, Trace::zero(), |_, _| Trace::zero());
        self.begin(start, Trace::zero(), constants([-2.0, 0.0, 0.0]), constants([1.0, 0.0, 0.0, 0.0]));
        let velocity = scale(self.settings.speed.into(), direction(&self.pose(&start.goal, 0)));
        let at = self.robot.roots()[0];
        start.state[at + 3..at + 6].copy_from_slice(&velocity);
        start.task_state[SCORED] = Trace::one();
    }
}
