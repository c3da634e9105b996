//! A drone with a ball on a bar, hanging or standing: what the payload and pendulum tasks share.
//!
//! p drone, q ball, L bar length, R_b, ω_b attitude and angular velocity of the bar, hinged at the drone's origin:
//! q = p ∓ L R_b e_z, q̇ = v + ω_b × (q − p). The bar is a capsule of radius 0.01 m, the ball has a radius of 0.04 m.
//!
//! Masses are drawn for every episode, the length once for every environment. Bar and ball are one body, whose mass, centre
//! of mass and inertia follow (Steiner). Rotors start at the speed that carries the drawn total weight.
//!
//! The joint has no stops. With one hinge near 90° the other turns the bar about its own axis, where it has a sixtieth of the
//! inertia that stops at ±120° are made for: at 16 ms they blew up 421 of 4057 random flights of PayloadHover, at 2 ms 1 of
//! 3898; without them none of 3879 did. Tumbling so far, a flight is lost.

use super::obstacles::{Bars, BarsSettings, rounded, softened, touching};
use super::{
    MotionLoss, PathSuccess, StartAttitude, StartRange, along_the_course, latch, nearer, rate_cost, speed_cost, times,
};
use crate::config::EnvConfig;
use crate::declare::{Loss, Writer};
use crate::reward::smooth_norm;
use crate::robot::{Inertial, Robot};
use crate::settings;
use crate::start::{Start, StartScalar};
use crate::task::{TaskReference, View};
use crate::track_path::{Follow, PathRange, TrackPath};
use autodiff::{Scalar, Trace, TraceMask, safe};
use base::error::Result;
use controllers::reference::{Carried, LoadPath, Reference};
use dynamics::Vehicle;
use dynamics::assembly::Member;
use dynamics::configurations::{InvertedPendulum, Payload, environment};
use dynamics::frame::Frame;
use dynamics::spatial::{Quat, Vec3, add, rotate, sub};
use dynamics::tree::{Model, ModelParts};
use std::f64::consts::PI;

/// m.
const BAR_RADIUS: f64 = 0.01;
/// m.
const BALL_RADIUS: f64 = 0.04;
/// Mass of a bar that is drawn, kg.
pub(super) const DRAWN_BAR: [f64; 2] = [0.01, 0.04];
/// Of the ways that controllers give a ball that hangs and one that stands ([`TaskReference::way`]).
const SLOWNESS: [f64; 2] = [0.8, 1.3];
/// Numbers of a load in a goal, where it comes first.
pub(super) const LOAD: usize = 2;

settings! {
    /// A drone with a ball on a bar.
    pub struct LoadSettings {
        vehicle: String = "hummingbird".into() => ("", "what flies", Any);
        length: [f64; 2] = [1.0, 1.0]
            => ("m", "L of the bar, lowest and highest; drawn once per environment", PositiveOrdered);
        ball_share: [f64; 2] = [0.2, 0.3] => ("-", "m_q over the vehicle's mass, lowest and highest", PositiveOrdered);
        bar_mass: [f64; 2] = [0.001, 0.001] => ("kg", "of the bar, lowest and highest", PositiveOrdered);
    }
}

settings! {
    /// A ball that follows a path.
    pub struct LoadTrackSettings {
        load: LoadSettings = LoadSettings::default() => flat;
        follow: Follow = Follow {
            reset_distance: 0.8,
            path: PathRange { rate: [0.7, 1.0], ..PathRange::default() },
            ..Follow::default()
        } => flat;
        start: StartAttitude = StartAttitude { tilt: 0.1 * PI, ..StartAttitude::default() } => group;
        success: PathSuccess = PathSuccess::default() => group;
        pose_scale: f64 = 1.6 => ("1/m", "how steeply r_p falls", NotNegative);
        loss: MotionLoss = MotionLoss::default() => group;
    }
}

settings! {
    /// A ball that goes past two level bars.
    pub struct LoadCourseSettings {
        load: LoadSettings = LoadSettings::default() => flat;
        bars: BarsSettings = BarsSettings::default() => flat;
        reset_on_collision: bool = false => ("", "whether touch ends the episode", Any);
        start: StartRange = StartRange::default() => group;
        start_along: f64 = 0.0 => ("-", "share of episodes that begin anywhere on the way to the target", Share);
        min_height: f64 = 0.2 => ("m", "lower is a crash", Any);
        max_side: f64 = 2.0 => ("m", "farther along y ends the episode", Positive);
        success_distance: f64 = 0.2 => ("m", "position error of a success", Positive);
        pose_scale: f64 = 1.2 => ("1/m", "how steeply r_p falls", NotNegative);
        loss: MotionLoss = MotionLoss::default() => group;
        loss_clearance: f64 = 0.5 => ("m", "weight of the clearance in the loss", NotNegative);
    }
}

settings! {
    /// Weights of the reward for balancing.
    pub struct BalanceReward {
        balance: f64 = 1.0 => ("-", "weight of the term balance", NotNegative);
        pose: f64 = 1.0 => ("-", "weight of the term pose", NotNegative);
        spin: f64 = 1.0 => ("-", "weight of the term spin", NotNegative);
        swing: f64 = 1.0 => ("-", "weight of the term swing", NotNegative);
        effort: f64 = 0.1 => ("-", "weight of the term effort", NotNegative);
    }
}

/// Which way the ball is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    /// Below the drone.
    Hanging,
    /// Above it.
    Standing,
}

/// A drone with a load.
#[derive(Debug, Clone)]
pub(super) struct Load {
    pub robot: Robot,
    /// Body of bar and ball.
    bar: usize,
    /// −1 below, +1 above.
    sign: f64,
    settings: LoadSettings,
    /// Of the vehicle, kg.
    vehicle_mass: f64,
}

impl Load {
    /// In free air.
    ///
    /// # Errors
    /// As [`EnvConfig::vehicle`] and [`Robot::of_model`].
    pub(super) fn new(config: &EnvConfig, settings: &LoadSettings, side: Side) -> Result<Self> {
        let vehicle = config.vehicle(&settings.vehicle)?;
        let (model, bar) = build(settings, side, vehicle.clone())?;
        let robot = Robot::of_model(&model, config.physics(), Some(&vehicle), |_| vec![])?;
        Ok(Self::of(settings, side, robot, bar, &vehicle))
    }

    /// In free air, with the disturbance of its tree on the ball.
    ///
    /// # Errors
    /// As [`Load::new`].
    pub(super) fn pushed(config: &EnvConfig, settings: &LoadSettings, side: Side) -> Result<Self> {
        let vehicle = config.vehicle(&settings.vehicle)?;
        let (model, bar) = build(settings, side, vehicle.clone())?;
        let model = Model::new(ModelParts { pushed: vec![bar], ..model.parts().clone() })?;
        let physics = config.physics_with(|e| e.disturbance = true);
        let robot = Robot::of_model(&model, physics, Some(&vehicle), |_| vec![])?;
        Ok(Self::of(settings, side, robot, bar, &vehicle))
    }

    fn of(settings: &LoadSettings, side: Side, robot: Robot, bar: usize, vehicle: &Vehicle) -> Self {
        Self {
            robot: robot.varying_inertial(bar),
            bar,
            sign: if side == Side::Hanging { -1.0 } else { 1.0 },
            settings: settings.clone(),
            vehicle_mass: vehicle.mass_properties().mass,
        }
    }

    /// Draws length and masses into goal, numbers and rotor speeds.
    pub(super) fn draw(&self, start: &mut Start<'_>) {
        let own = &self.settings;
        let length = start.once.uniform(own.length[0], own.length[1]);
        let ball = start.task.uniform(own.ball_share[0], own.ball_share[1]) * self.vehicle_mass;
        let bar = start.task.uniform(own.bar_mass[0], own.bar_mass[1]);
        let nominal = Inertial::read(start.numbers, self.bar).mass;
        let own = self.inertial(length, bar, ball);
        own.write(start.numbers, self.bar);
        let faster = ((self.vehicle_mass + own.mass) / (self.vehicle_mass + nominal)).sqrt();
        start.spin_up(faster);
        start.goal.field("length", "m", "L").number(length);
        start.goal.field("ball_mass", "kg", "m_q").number(ball);
    }

    /// Of bar and ball in the frame of their body.
    pub(super) fn inertial<S: StartScalar>(&self, length: S, bar: S, ball: S) -> Inertial<S> {
        let along = |share: f64| [S::zero(), S::zero(), S::from(share * self.sign) * length];
        let bar = Inertial::capsule(bar, BAR_RADIUS, length, along(0.5));
        bar.and(&Inertial::ball(ball, BALL_RADIUS, along(1.0)))
    }

    /// Places the drone with the bar along its axis; returns q.
    pub(super) fn place(&self, start: &mut Start<'_>, position: Vec3<Trace>, attitude: Quat<Trace>) -> Vec3<Trace> {
        start.place(0, position, attitude);
        add(position, rotate(attitude, [Trace::zero(), Trace::zero(), start.goal[0] * self.sign]))
    }

    /// p for a ball at `ball` and an upright bar.
    pub(super) fn drone_of(&self, start: &Start<'_>, ball: Vec3<Trace>) -> Vec3<Trace> {
        [ball[0], ball[1], ball[2] - start.goal[0] * self.sign]
    }

    /// Places the ball at `ball`, the bar upright.
    pub(super) fn place_upright(&self, start: &mut Start<'_>, ball: Vec3<impl Into<Trace>>) {
        let position = self.drone_of(start, ball.map(Into::into));
        start.place(0, position, [1.0, 0.0, 0.0, 0.0]);
    }

    /// The way of the drone that brings the ball to `target`.
    pub(super) fn reference(&self, view: &View<'_, f64>, target: Vec3<f64>) -> Option<TaskReference> {
        let ball = Frame { attitude: view.drone(0).attitude, ..self.ball(view) };
        let way = TaskReference::waypoints(&ball, target, ball.yaw(), SLOWNESS[usize::from(self.sign > 0.0)])?;
        Some(self.carried(view, LoadPath::Waypoints(way)))
    }

    /// The way of the drone for a path of the ball.
    fn carried(&self, view: &View<'_, f64>, path: LoadPath) -> TaskReference {
        let carried = Reference::Carried(Carried { path, lever: -self.sign * view.goal[0] });
        TaskReference::one(carried).of(self.ball(view).position)
    }

    /// Position and velocity of the ball, attitude and angular velocity of the bar.
    pub(super) fn ball<S: Scalar>(&self, view: &View<'_, S>) -> Frame<S> {
        let bar = view.frame(self.bar);
        let end = S::constant(self.sign) * view.goal[0];
        let (position, velocity) = bar.point([S::zero(), S::zero(), end]);
        Frame { position, velocity, ..bar }
    }

    /// p − q.
    pub(super) fn observe_lever(&self, view: &View, out: &mut Writer) {
        out.field("drone_from_ball", "m, world", "p − q").array(sub(view.drone(0).position, self.ball(view).position));
    }

    /// v_q, ω_b.
    pub(super) fn observe_motion(&self, view: &View, out: &mut Writer) {
        let ball = self.ball(view);
        out.field("ball_velocity", "m/s, world", "v_q = q̇").array(ball.velocity);
        out.field("bar_angular_velocity", "rad/s, world", "ω_b").array(ball.angular_velocity);
    }
}

/// The model with the middle of every range, and its body of bar and ball.
fn build(settings: &LoadSettings, side: Side, drone: Vehicle) -> Result<(Model, usize)> {
    let middle = |range: [f64; 2]| 0.5 * (range[0] + range[1]);
    let (length, bar_mass) = (middle(settings.length), middle(settings.bar_mass));
    let (bar_radius, payload_radius) = (BAR_RADIUS, BALL_RADIUS);
    let payload_mass = middle(settings.ball_share) * drone.mass_properties().mass;
    match side {
        Side::Hanging => {
            let defaults = Payload::default();
            let own = Payload { drone, length, bar_radius, bar_mass, payload_radius, payload_mass, ..defaults };
            let built = own.build()?;
            Ok((without_stops(&built.model)?, built.map.bar))
        }
        Side::Standing => {
            let defaults = InvertedPendulum::default();
            let own =
                InvertedPendulum { drone, length, bar_radius, bar_mass, payload_radius, payload_mass, ..defaults };
            own.build().map(|built| (built.model, built.map.bar))
        }
    }
}

fn without_stops(model: &Model) -> Result<Model> {
    let mut parts = model.parts().clone();
    parts.bodies.iter_mut().for_each(|body| body.joint.limits = None);
    Model::new(parts)
}

/// w (1 − b) of a bar: what training losses pay for a pendulum that leans.
pub(super) fn leaning<S: Scalar>(weight: f64, ball: &Frame<S>) -> S {
    times(weight, S::one() - ball.up()[2])
}

/// Distance, slip of the ball against `velocity` and the drone's rate.
fn motion_loss(
    view: &View,
    w: &MotionLoss,
    error: Vec3<Trace>,
    (formula, slip): (&'static str, Vec3<Trace>),
    loss: &mut Loss,
) {
    loss.add("√(d² + {loss_radius}²)", smooth_norm(error, w.radius));
    loss.add(formula, speed_cost(w.velocity, slip));
    loss.add("{×loss_rate}h₁₀(ω)", rate_cost(w.rate, view.drone(0).angular_velocity));
}

/// [`motion_loss`] of a ball that should stand still.
pub(super) fn hold_loss(view: &View, w: &MotionLoss, error: Vec3<Trace>, ball: &Frame<Trace>, loss: &mut Loss) {
    motion_loss(view, w, error, ("{×loss_velocity}h₅(v_q)", ball.velocity), loss);
}

/// Look-ahead points of the track tasks.
const POINTS: usize = 6;

/// A ball that follows a lemniscate: what both track tasks share. The path follows the load in the goal.
#[derive(Debug, Clone)]
pub(super) struct LoadTrack {
    pub load: Load,
    path: TrackPath,
}

impl LoadTrack {
    /// # Errors
    /// As [`Load::new`].
    pub(super) fn new(config: &EnvConfig, settings: &LoadTrackSettings, side: Side) -> Result<Self> {
        Ok(Self { load: Load::new(config, &settings.load, side)?, path: TrackPath::new(&settings.follow, config.dt) })
    }

    /// Where the drone must be for the ball to follow the path.
    pub(super) fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        let path = self.path.reference(&view.goal[LOAD..], view.drone(0).yaw());
        Some(self.load.carried(view, LoadPath::Lemniscate(path)))
    }

    /// Draws load, path and a first state within `reset_distance`.
    pub(super) fn start(&self, settings: &LoadTrackSettings, start: &mut Start<'_>) {
        self.load.draw(start);
        let first = self.path.draw(start);
        let position = self.load.drone_of(start, first);
        start.again(100, |start| {
            let attitude = settings.start.draw(start);
            let ball = self.load.place(start, position, attitude);
            nearer(sub(first, ball), settings.follow.reset_distance)
        });
        self.path.join(start, LOAD, Some(start.goal[0] * -self.load.sign));
    }

    /// p_ref(k) − q.
    pub(super) fn error<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(self.path.at(&view.goal[LOAD..], view.step), self.load.ball(view).position)
    }

    /// The path ahead, seen from the ball.
    pub(super) fn observe_ahead(&self, view: &View, out: &mut Writer) {
        out.field("path", "m, world", "p_ref(k + 5i) − q for i = 0 … 5");
        self.path.observe(&view.goal[LOAD..], view.step, POINTS, self.load.ball(view).position, out);
    }

    /// d > the reset distance of the episode.
    pub(super) fn far<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        self.path.far(&view.goal[LOAD..], self.error(view))
    }

    /// Distance, slip against the path and the drone's rate.
    pub(super) fn loss(&self, w: &MotionLoss, view: &View, loss: &mut Loss) {
        let slip = sub(self.path.velocity(&view.goal[LOAD..], view.step), self.load.ball(view).velocity);
        motion_loss(view, w, self.error(view), ("{×loss_velocity}h₅(ṗ_ref − v_q)", slip), loss);
    }

    /// The ball on the path, the bar upright.
    pub(super) fn ideal(&self, start: &mut Start<'_>) {
        self.load.draw(start);
        let first = self.path.draw(start);
        self.load.place_upright(start, first);
    }
}

/// Starts on the way are no nearer to the bars, m.
const CLEAR: f64 = 1.0;

/// A load with two bars in the way, whose heights follow it in the goal: what both fly-through tasks share.
#[derive(Debug, Clone)]
pub(super) struct LoadCourse {
    pub load: Load,
    pub bars: Bars,
}

impl LoadCourse {
    /// # Errors
    /// As [`Load::new`].
    pub(super) fn new(config: &EnvConfig, settings: &LoadCourseSettings, side: Side) -> Result<Self> {
        let vehicle = config.vehicle(&settings.load.vehicle)?;
        let (model, bar) = build(&settings.load, side, rounded(&vehicle))?;
        let member = Member::new(model.name(), model.clone(), [0.0; 3]);
        let model = environment("fly_through", &[member], &Bars::scene(&settings.bars))?;
        let model = softened(&model, vehicle.mass_properties().mass)?;
        let bars = Bars::of(&model, &settings.bars, LOAD);
        let robot = Robot::of_model(&model, touching(config), Some(&vehicle), |_| vec![])?.varying(bars.numbers());
        Ok(Self { load: Load::of(&settings.load, side, robot, bar, &vehicle), bars })
    }

    /// Draws load and obstacles.
    pub(super) fn draw(&self, start: &mut Start<'_>) {
        self.load.draw(start);
        self.bars.draw(start);
    }

    /// A start, as [`Load::place`]: at `ball_target`'s side of the bars too, where the settings say so.
    pub(super) fn begin(
        &self,
        settings: &LoadCourseSettings,
        start: &mut Start<'_>,
        ball_target: Vec3<Trace>,
    ) -> Vec3<Trace> {
        let (position, attitude) = settings.start.draw(start);
        let to = self.load.drone_of(start, ball_target);
        // a tilted bar reaches farther than the drone
        let position = along_the_course(start, settings.start_along, position, to, CLEAR);
        self.load.place(start, position, attitude)
    }

    /// Keeps whether the goal was reached once.
    pub(super) fn remember(view: &View, now: TraceMask, task_state: &mut Writer) {
        let reached = latch(view.task_state[0], now);
        task_state.field("reached", "-", "1 once d < {success_distance} m").number(reached);
    }

    /// Figures of both tasks, with what the middle one is called.
    pub(super) fn metrics(
        &self,
        view: &View,
        error: Vec3<Trace>,
        (name, upright): (&'static str, Trace),
        out: &mut Writer,
    ) {
        out.metric("position_error", "m", safe::norm(error));
        out.metric(name, "-", upright);
        out.metric("clearance", "m", self.bars.clearance(view));
        out.metric("throttle_difference", "-", view.throttle_difference(0));
    }
}
