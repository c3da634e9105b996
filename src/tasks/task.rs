//! What a task is: goals, observations, rewards and ends, written once over recorded numbers.
//!
//! A task does not step physics. The environment does, then shows it a [`View`] of the new state; the task answers with
//! numbers. These are recorded numbers ([`Trace`]): a task is asked when a recording is made, not when environments step, and
//! what it computed then is what all environments run, and what gradients through whole episodes are taken of. So it must answer
//! alike whenever it is asked, and nothing branches on a value; [`Scalar::select`] picks between two. Settings may be branched on.
//!
//! To add one: a file with a struct that implements [`Task`], and a line in the [registry](super::registry).

use super::config::EnvConfig;
use super::declare::{Ends, Loss, Writer};
use super::robot::{DronePlace, Robot};
use super::settings::Setting;
use super::start::Start;
use super::task_spec::Success;
use autodiff::{Scalar, Trace, TraceMask, safe};
use base::error::Result;
use controllers::reference::{Hover, Reference, Tilt, Waypoint, Waypoints};
use dynamics::frame::{FRAME, Frame};
use dynamics::scene::Scene;
use dynamics::spatial::{Vec3, sub};
use std::f64::consts::{PI, TAU};

/// A task: what flies, where an episode starts, what is seen, rewarded and forbidden.
///
/// Whatever is written is named as it is written ([`Writer`]): that is the whole of a task's [`TaskSpec`](super::TaskSpec).
///
/// A branch on a recorded number does not compile:
///
/// ```compile_fail,E0369
/// # use omnidrones_tasks::omnidrones;
/// use omnidrones::tasks::View;
///
/// fn is_low(view: &View) -> bool {
///     view.drone(0).position[2] < view.drone(1).position[2]
/// }
/// ```
///
/// ```compile_fail,E0369
/// # use omnidrones_tasks::omnidrones;
/// use omnidrones::tasks::View;
///
/// fn is_first(view: &View) -> bool {
///     view.step == view.clock
/// }
/// ```
///
/// A comparison by `lt` gives a truth for each environment, which `Scalar::select` picks by:
///
/// ```
/// # use omnidrones_tasks::omnidrones;
/// use omnidrones::autodiff::{Scalar, Trace};
/// use omnidrones::tasks::View;
///
/// fn depth(view: &View) -> Trace {
///     let height = view.drone(0).position[2];
///     Trace::select(height.lt(1.0), 1.0 - height, Trace::zero())
/// }
/// ```
pub trait Task: Send + Sync {
    /// What flies.
    fn robot(&self) -> &Robot;

    /// Steps until truncation, T.
    fn horizon(&self) -> usize;

    /// Agents, by default one per drone; each acts with its drone's rotors and drives. Drones may be unlike: rows
    /// of actions are as wide as the widest one's, and what stands behind an agent's own numbers moves nothing.
    fn n_agent(&self) -> usize {
        self.robot().drones().len()
    }

    /// What it is built with: [`Settings::list`](super::settings::Settings::list).
    fn settings(&self) -> Vec<Setting> {
        Vec::new()
    }

    /// Symbols, target and start of an episode, in words; `{key}` stands for the value of a setting.
    fn about(&self) -> &str {
        ""
    }

    /// What stands around, beside the shapes of the robot's model: sensors see both. By default level ground.
    fn scene(&self) -> Scene {
        Scene::grounded()
    }

    /// Where gates and obstacles of the scene stand with this goal: writes its [placement](dynamics::scene), of zeros.
    fn place_scene(&self, _goal: &[f64], _placement: &mut [f64]) {}

    /// Draws the goal and the first state of an episode, at rest unless said otherwise. Recorded as all else, with draws for
    /// inputs.
    fn start(&self, start: &mut Start<'_>);

    /// What happens to the goal at the time that [`Start::event_at`] asked for: a push, a new target. Changes of the task state
    /// and of numbers that vary count too, those of the state do not. It comes behind the reward of its step and before the
    /// observation, which shows the new goal; gradients take that observation for one of the old goal.
    fn event(&self, _start: &mut Start<'_>) {}

    /// Where episodes and events begin that no recording can hold: then neither [`start`](Self::start) nor
    /// [`event`](Self::event) is asked.
    fn start_on_host(&self) -> Option<&dyn HostStart> {
        None
    }

    /// Wind, force and moment on tree `tree` in the coming step, as [`Disturbance`](dynamics::Disturbance);
    /// asked only where the robot's physics have that effect.
    fn disturb(&self, _view: &View, _tree: usize) -> [Trace; 9] {
        [Trace::zero(); 9]
    }

    /// What the task keeps, after a step, from a view with what it kept before; zeros where an episode begins.
    fn remember(&self, _view: &View, _task_state: &mut Writer) {}

    /// One agent's observation. Agents may see unlike things: rows are as wide as the widest one's, and who writes fewer
    /// numbers sees 0 behind them. Fields are named after the first of those that see most, so what all see comes first.
    fn observe(&self, view: &View, agent: usize, out: &mut Writer);

    /// The central state, for critics that see everything.
    fn central(&self, _view: &View, _out: &mut Writer) {}

    /// The summands of the reward, [one](Writer::term) after the other. All agents share the sum.
    fn reward(&self, view: &View, terms: &mut Writer);

    /// Which reasons to terminate hold.
    fn ends(&self, view: &View, ends: &mut Ends);

    /// [Figures](Writer::metric) that are reported in every step; the first is the error, as a rule.
    fn metrics(&self, _view: &View, _out: &mut Writer) {}

    /// Whether the goal counts as reached in this step.
    fn success(&self, view: &View) -> TraceMask;

    /// What [`success`](Self::success) asks, as data.
    fn success_rule(&self) -> Success {
        Success::default()
    }

    /// A cost per step that gradient methods minimise: smooth, and steep from afar too. The negative reward unless said
    /// otherwise.
    fn loss(&self, view: &View, loss: &mut Loss) {
        let terms = Writer::written(|terms| self.reward(view, terms)).numbers();
        let sum = terms.into_iter().fold(Trace::zero(), |sum, term| sum - term);
        loss.add("−reward", sum);
    }

    /// What the task's own controllers track in an episode that begins as `view` shows; `None` where no reference can express it.
    fn reference(&self, _view: &View<'_, f64>) -> Option<TaskReference> {
        None
    }

    /// A state and goal with which the reward, effort aside, comes within 1e-6 of its bound.
    fn ideal(&self, start: &mut Start<'_>);
}

/// Starts and events in plain numbers, one environment after the other: for searches, assignments, and whatever else branches on what
/// was drawn. A task of this kind leaves [`Task::start`] empty. A goal that is longer than the ideal's is cut; an event has 256 words of
/// every stream for its step.
pub trait HostStart {
    /// As [`Task::start`].
    fn start(&self, start: &mut Start<'_, f64>);

    /// As [`Task::event`].
    fn event(&self, _start: &mut Start<'_, f64>) {}
}

/// A task that is made from a configuration alone: what a name can stand for.
pub trait BuiltIn: Task + Sized + 'static {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`], [`EnvConfig::vehicle`] and the model that flies.
    fn new(config: &EnvConfig) -> Result<Self>;
}

/// What controllers track.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskReference {
    /// One for the whole, or one per drone.
    pub references: Vec<Reference>,
    /// Roll and pitch to hold beside the one reference.
    pub tilt: Tilt,
    /// Present position of the point that the one reference leads, world, m; none where each drone follows a reference of its own.
    pub follower: Option<Vec3<f64>>,
}

impl TaskReference {
    /// One reference for the whole, level.
    pub fn one(reference: Reference) -> Self {
        Self { references: vec![reference], tilt: Tilt::LEVEL, follower: None }
    }

    /// Of something at `position`, world, m.
    pub fn of(self, position: Vec3<f64>) -> Self {
        Self { follower: Some(position), ..self }
    }

    /// A point, world, m, and a yaw, rad.
    pub fn point(position: Vec3<f64>, yaw: f64) -> Self {
        Self::one(Reference::Hover(Hover { position, yaw }))
    }

    /// From where a frame is to a point and a yaw, the short way round, in `slowness` · (1 + d/(1 m)) seconds over d metres,
    /// with the least snap: a far point at once would ask for all the tilt there is.
    pub fn way(from: &Frame<f64>, position: Vec3<f64>, yaw: f64, slowness: f64) -> Self {
        let way = Self::waypoints(from, position, yaw, slowness);
        way.map_or_else(|| Self::point(position, yaw), |way| Self::one(Reference::Waypoints(way))).of(from.position)
    }

    /// The path of [`way`](Self::way); `None` for numbers that are not finite.
    pub fn waypoints(from: &Frame<f64>, position: Vec3<f64>, yaw: f64, slowness: f64) -> Option<Waypoints> {
        let here = from.yaw();
        let turn = (yaw - here + PI).rem_euclid(TAU) - PI;
        let time = slowness * (1.0 + safe::norm(sub(position, from.position)));
        let start = Waypoint { time: 0.0, position: from.position, yaw: here };
        Waypoints::new(vec![start, Waypoint { time, position, yaw: here + turn }]).ok()
    }
}

/// What a task sees after a step: recorded numbers, or plain ones where references are asked for.
#[derive(Debug, Clone, Copy)]
pub struct View<'a, S = Trace> {
    /// What flies.
    pub robot: &'a Robot,
    /// State of the physics, SI, in the robot's layout.
    pub state: &'a [S],
    /// Motion of every body, 13 numbers each; [`frame`](Self::frame) reads them.
    pub frames: &'a [S],
    /// Rotor speeds before the step, rad/s, in the order of the drones; those of the state in the first view of an episode.
    pub speeds_before: &'a [S],
    /// What stays through the episode ([`TaskSpec::goal`](super::TaskSpec::goal)).
    pub goal: &'a [S],
    /// What the task keeps from step to step ([`TaskSpec::task_state`](super::TaskSpec::task_state)).
    pub task_state: &'a [S],
    /// Steps since the episode began, k.
    pub step: S,
    /// Share of the time that is over: (k + offset)/T.
    pub clock: S,
}

impl<S: Scalar> View<'_, S> {
    /// Motion of body `body`.
    pub fn frame(&self, body: usize) -> Frame<S> {
        Frame::read(&self.frames[body * FRAME..])
    }

    /// Motion of drone `drone`.
    pub fn drone(&self, drone: usize) -> Frame<S> {
        self.frame(self.robot.drones()[drone].frame)
    }

    /// s = Ω/Ω_max of a rotor.
    pub fn throttle(&self, drone: usize, rotor: usize) -> S {
        let place = &self.robot.drones()[drone].rotors[rotor];
        self.state[place.speed] * S::constant(1.0 / place.max_speed)
    }

    /// e = Σ s of a drone's rotors.
    pub fn effort(&self, drone: usize) -> S {
        let mut sum = S::zero();
        for i in 0..self.robot.drones()[drone].rotors.len() {
            sum += self.throttle(drone, i);
        }
        sum
    }

    /// (1/m) Σ e^{−e_i} over the drones.
    pub fn mean_effort_reward(&self) -> S {
        let m = self.robot.drones().len();
        let mut sum = S::zero();
        for i in 0..m {
            sum += (-self.effort(i)).exp();
        }
        sum * S::constant(1.0 / m as f64)
    }

    /// Δs = ‖s − s_before‖ over a drone's rotors.
    pub fn throttle_difference(&self, drone: usize) -> S {
        safe::sqrt(self.squared_throttle_difference(drone), safe::SQUARED_NORM_FLOOR)
    }

    /// (1/m) Σ Δs² over the drones.
    pub(crate) fn mean_squared_throttle_difference(&self) -> S {
        let m = self.robot.drones().len();
        let mut sum = S::zero();
        for i in 0..m {
            sum += self.squared_throttle_difference(i);
        }
        sum * S::constant(1.0 / m as f64)
    }

    fn squared_throttle_difference(&self, drone: usize) -> S {
        let mut first = 0;
        for i in 0..drone {
            first += self.robot.drones()[i].rotors.len();
        }
        let place: &DronePlace = &self.robot.drones()[drone];
        let mut sum = S::zero();
        for i in 0..place.rotors.len() {
            let rotor = &place.rotors[i];
            let change = self.state[rotor.speed] - self.speeds_before[first + i];
            let change = change * S::constant(1.0 / rotor.max_speed);
            sum = change.mul_add(change, sum);
        }
        sum
    }

    /// The part of a drone's observation that all tasks share, ŝ: attitude (w ≥ 0), velocity, angular velocity, heading,
    /// up, 2s − 1 per rotor, then direction and rate of every drive.
    pub fn observe_drone(&self, drone: usize, out: &mut Writer<S>) {
        let frame = self.drone(drone);
        out.field("attitude", "-, body → world", "unit quaternion, w ≥ 0").within(-1.0, 1.0).non_smooth();
        out.array(frame.observed_attitude());
        out.field("velocity", "m/s, world", "v").array(frame.velocity);
        out.field("angular_velocity", "rad/s, world", "ω").array(frame.angular_velocity);
        out.field("heading", "-, world", "h = R e_x").within(-1.0, 1.0).array(frame.heading());
        out.field("up", "-, world", "u = R e_z").within(-1.0, 1.0).array(frame.up());
        self.observe_throttle(drone, out);
        let drives = &self.robot.drones()[drone].drives;
        if !drives.is_empty() {
            out.field("drive_direction", "-", "(cos, sin) of the angles of its drives").within(-1.0, 1.0);
            for i in 0..drives.len() {
                out.array(self.turned(drives[i].angle));
            }
            out.field("drive_rate", "rad/s", "of its drives");
            for i in 0..drives.len() {
                out.number(self.state[drives[i].rate]);
            }
        }
    }

    /// (cos, sin) of the angle at place `at` of the state: alike after whole turns.
    pub fn turned(&self, at: usize) -> [S; 2] {
        let (sin, cos) = self.state[at].sin_cos();
        [cos, sin]
    }

    /// 2s − 1 per rotor.
    pub fn observe_throttle(&self, drone: usize, out: &mut Writer<S>) {
        out.field("throttle", "-", "2s − 1, s = Ω/Ω_max").within(-1.0, 1.0);
        let two = S::constant(2.0);
        for i in 0..self.robot.drones()[drone].rotors.len() {
            out.number(two.mul_add(self.throttle(drone, i), -S::one()));
        }
    }

    /// The time code: the clock, four times.
    pub fn observe_clock(&self, out: &mut Writer<S>) {
        out.field("clock", "-", "k/T, four times").within(0.0, 1.0).array([self.clock; 4]);
    }
}
