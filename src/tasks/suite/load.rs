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

use crate::autodiff::{Pen, Scalar, safe};
use crate::controllers::reference::{Carried, LoadPath, Reference};
use crate::dynamics::Vehicle;
use crate::dynamics::assembly::Member;
use crate::dynamics::configurations::{InvertedPendulum, Payload, environment};
use crate::dynamics::frame::Frame;
use crate::dynamics::shape::Geometry;
use crate::dynamics::spatial::{Quat, Vec3, add, rotate, sub};
use crate::dynamics::tree::{Model, ModelParts};
use crate::error::{Error, Result};
use crate::tasks::config::EnvConfig;
use crate::tasks::path::{AHEAD, Path};
use crate::tasks::reward::{bell, smooth_norm, still, tip};
use crate::tasks::rig::{Inertial, Rig};
use crate::tasks::sheet::{Setting, Slice, Term};
use crate::tasks::suite::obstacles::{Bars, rounded, softened, touching};
use crate::tasks::task::{ANY_YAW, Start, View, Wanted};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// m.
const BAR_RADIUS: f64 = 0.01;
/// m.
const BALL_RADIUS: f64 = 0.04;
/// Mass of the ball as a share of the vehicle's, lowest and highest, unless a setting says otherwise.
pub(super) const BALL_SHARE: [f64; 2] = [0.2, 0.3];
/// Mass of a bar that is not drawn, kg.
pub(super) const LIGHT_BAR: [f64; 2] = [0.001; 2];
/// Mass of a bar that is, kg.
pub(super) const DRAWN_BAR: [f64; 2] = [0.01, 0.04];
/// Of the ways that controllers give a ball that hangs and one that stands ([`Wanted::way`]).
const SLOWNESS: [f64; 2] = [0.8, 1.3];
/// Numbers of a load in a goal, where it comes first.
pub(super) const LOAD: usize = 2;

/// Settings of the hover tasks with a load.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LoadSettings {
    /// What flies.
    pub vehicle: String,
    /// T, steps.
    pub horizon: usize,
    /// Of the bar, lowest and highest, m.
    pub length: [f64; 2],
    /// Mass of the ball as a share of the vehicle's, lowest and highest.
    pub ball_share: [f64; 2],
}

impl Default for LoadSettings {
    fn default() -> Self {
        Self { vehicle: "hummingbird".into(), horizon: 500, length: [1.0, 1.0], ball_share: BALL_SHARE }
    }
}

/// Settings of the track tasks with a load.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LoadTrackSettings {
    /// What flies.
    pub vehicle: String,
    /// T, steps.
    pub horizon: usize,
    /// Of the bar, lowest and highest, m.
    pub length: [f64; 2],
    /// Mass of the ball as a share of the vehicle's, lowest and highest.
    pub ball_share: [f64; 2],
    /// Largest distance of the ball from the path, m.
    pub reset_distance: f64,
}

impl Default for LoadTrackSettings {
    fn default() -> Self {
        Self {
            vehicle: "hummingbird".into(),
            horizon: 600,
            length: [1.0, 1.0],
            ball_share: BALL_SHARE,
            reset_distance: 0.8,
        }
    }
}

/// Lines of the settings that all tasks with a load have.
pub(super) fn load_settings(horizon: usize, length: &str) -> Vec<Setting> {
    vec![
        Setting::new("vehicle", "\"hummingbird\"", "what flies"),
        Setting::new("horizon", horizon, "T, steps"),
        Setting::new("length", length, "L, lowest and highest, m; drawn once per environment").positive(),
        Setting::new("ball_share", "[0.2, 0.3]", "m_q over the vehicle's mass, lowest and highest").positive(),
    ]
}

/// Which way the ball is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    /// Below the drone.
    Hanging,
    /// Above it.
    Standing,
}

/// What a load is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Plan<'a> {
    pub vehicle: &'a str,
    pub side: Side,
    /// Lowest and highest, m.
    pub length: [f64; 2],
    /// Mass of the ball as a share of the vehicle's, lowest and highest.
    pub ball: [f64; 2],
    /// Mass of the bar, lowest and highest, kg.
    pub bar: [f64; 2],
}

/// A drone with a load.
#[derive(Debug, Clone)]
pub(super) struct Load {
    pub rig: Rig,
    /// Body of bar and ball.
    bar: usize,
    /// −1 below, +1 above.
    sign: f64,
    length: [f64; 2],
    ball_share: [f64; 2],
    bar_mass: [f64; 2],
    /// Of the vehicle, kg.
    vehicle_mass: f64,
}

impl Load {
    /// In free air.
    ///
    /// # Errors
    /// [`Error::Value`] for a length that is none; as [`EnvConfig::vehicle`] and [`Rig::of_model`].
    pub(super) fn new(config: &EnvConfig, plan: &Plan<'_>) -> Result<Self> {
        let vehicle = config.vehicle(plan.vehicle)?;
        let (model, bar) = plan.build(vehicle.clone())?;
        let rig = Rig::of_model(&model, config.physics(), Some(&vehicle), |_| vec![])?;
        Ok(plan.load(rig, bar, vehicle.mass_properties().mass))
    }

    /// In free air, with the disturbance of its tree on the ball.
    ///
    /// # Errors
    /// As [`Load::new`].
    pub(super) fn pushed(config: &EnvConfig, plan: &Plan<'_>) -> Result<Self> {
        let vehicle = config.vehicle(plan.vehicle)?;
        let (model, bar) = plan.build(vehicle.clone())?;
        let model = Model::new(ModelParts { pushed: vec![bar], ..model.parts().clone() })?;
        let physics = config.physics_with(|e| e.disturbance = true);
        let rig = Rig::of_model(&model, physics, Some(&vehicle), |_| vec![])?;
        Ok(plan.load(rig, bar, vehicle.mass_properties().mass))
    }

    /// With two bars in the way, whose heights follow the load in the goal.
    ///
    /// # Errors
    /// As [`Load::new`].
    pub(super) fn among_bars(config: &EnvConfig, plan: &Plan<'_>, spacing: [f64; 2]) -> Result<(Self, Bars)> {
        ordered("spacing", spacing)?;
        let vehicle = config.vehicle(plan.vehicle)?;
        let (model, bar) = plan.build(rounded(&vehicle))?;
        let member = Member::new(model.name(), model.clone(), [0.0; 3]);
        let model = environment("fly_through", &[member], &Bars::scene(spacing))?;
        let model = softened(&model, vehicle.mass_properties().mass)?;
        let bars = Bars::of(&model, spacing, LOAD);
        let rig = Rig::of_model(&model, touching(config), Some(&vehicle), |_| vec![])?.varying(bars.numbers());
        Ok((plan.load(rig, bar, vehicle.mass_properties().mass), bars))
    }

    /// What it keeps in the goal.
    pub(super) fn slices() -> Vec<Slice> {
        vec![Slice::new("length", 1, "m", "L"), Slice::new("ball_mass", 1, "kg", "m_q")]
    }

    /// p − q as observed.
    pub(super) fn lever_slice() -> Slice {
        Slice::new("drone_from_ball", 3, "m, world", "p − q")
    }

    /// What [`Load::observe_motion`] writes.
    pub(super) fn motion_slices() -> [Slice; 2] {
        [
            Slice::new("ball_velocity", 3, "m/s, world", "v_q = q̇"),
            Slice::new("bar_angular_velocity", 3, "rad/s, world", "ω_b"),
        ]
    }

    /// Draws length and masses into goal, numbers and rotor speeds; returns the length, m.
    pub(super) fn draw(&self, start: &mut Start<'_>) -> f64 {
        let length = start.once.uniform(self.length[0], self.length[1]);
        let ball = self.vehicle_mass * start.task.uniform(self.ball_share[0], self.ball_share[1]);
        let bar = start.task.uniform(self.bar_mass[0], self.bar_mass[1]);
        let nominal = Inertial::read(start.numbers, self.bar).mass;
        let own = self.inertial(length, bar, ball);
        own.write(start.numbers, self.bar);
        let faster = ((self.vehicle_mass + own.mass) / (self.vehicle_mass + nominal)).sqrt();
        for rotor in &start.rig.drone().rotors {
            start.state[rotor.speed] = (faster * start.state[rotor.speed]).min(rotor.max_speed);
        }
        start.goal[..LOAD].copy_from_slice(&[length, ball]);
        length
    }

    /// Of bar and ball in the frame of their body.
    pub(super) fn inertial(&self, length: f64, bar: f64, ball: f64) -> Inertial {
        let rod = Geometry::Capsule { radius: BAR_RADIUS, length };
        let center_of_mass = [0.0, 0.0, 0.5 * self.sign * length];
        let bar = Inertial { mass: bar, center_of_mass, inertia: rod.inertia(bar) };
        bar.and(&Inertial::ball(ball, BALL_RADIUS, [0.0, 0.0, self.sign * length]))
    }

    /// Places the drone with the bar along its axis; returns q.
    pub(super) fn place(&self, start: &mut Start<'_>, position: Vec3<f64>, attitude: Quat<f64>) -> Vec3<f64> {
        start.place(0, position, attitude);
        add(position, rotate(attitude, [0.0, 0.0, self.sign * start.goal[0]]))
    }

    /// p for a ball at `ball` and an upright bar.
    pub(super) fn drone_of(&self, start: &Start<'_>, ball: Vec3<f64>) -> Vec3<f64> {
        [ball[0], ball[1], ball[2] - self.sign * start.goal[0]]
    }

    /// The way of the drone that brings the ball to `target`.
    pub(super) fn wanted(&self, view: &View<'_, f64>, target: Vec3<f64>) -> Option<Wanted> {
        let ball = Frame { attitude: view.drone(0).attitude, ..self.ball(view) };
        let way = Wanted::waypoints(&ball, target, ball.yaw(), SLOWNESS[usize::from(self.sign > 0.0)])?;
        Some(self.carried(view, LoadPath::Waypoints(way)))
    }

    /// The way of the drone for a path of the ball.
    fn carried(&self, view: &View<'_, f64>, path: LoadPath) -> Wanted {
        Wanted::one(Reference::Carried(Carried { path, lever: -self.sign * view.goal.get(0) }))
    }

    /// Position and velocity of the ball, attitude and angular velocity of the bar.
    #[inline(always)]
    pub(super) fn ball<S: Scalar>(&self, view: &View<'_, S>) -> Frame<S> {
        let bar = view.frame(self.bar);
        let end = S::constant(self.sign) * view.goal.get(0);
        let (position, velocity) = bar.point([S::zero(), S::zero(), end]);
        Frame { position, velocity, ..bar }
    }

    /// p − q.
    #[inline(always)]
    pub(super) fn observe_lever<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.array(sub(view.drone(0).position, self.ball(view).position));
    }

    /// v_q, ω_b.
    #[inline(always)]
    pub(super) fn observe_motion<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        let ball = self.ball(view);
        out.array(ball.velocity);
        out.array(ball.angular_velocity);
    }
}

impl Plan<'_> {
    /// The model with the middle of every range, and its body of bar and ball.
    fn build(&self, drone: Vehicle) -> Result<(Model, usize)> {
        ordered("length", self.length)?;
        ordered("ball_share", self.ball)?;
        let middle = |range: [f64; 2]| 0.5 * (range[0] + range[1]);
        let (length, bar_mass) = (middle(self.length), middle(self.bar));
        let (bar_radius, payload_radius) = (BAR_RADIUS, BALL_RADIUS);
        let payload_mass = middle(self.ball) * drone.mass_properties().mass;
        match self.side {
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

    fn load(&self, rig: Rig, bar: usize, vehicle_mass: f64) -> Load {
        let sign = if self.side == Side::Hanging { -1.0 } else { 1.0 };
        Load {
            rig: rig.varying_inertial(bar),
            bar,
            sign,
            length: self.length,
            ball_share: self.ball,
            bar_mass: self.bar,
            vehicle_mass,
        }
    }
}

fn without_stops(model: &Model) -> Result<Model> {
    let mut parts = model.parts().clone();
    parts.bodies.iter_mut().for_each(|body| body.joint.limits = None);
    Model::new(parts)
}

/// Lowest and highest of a setting, both > 0 and in order.
fn ordered(what: &str, [low, high]: [f64; 2]) -> Result<()> {
    if low > 0.0 && low <= high && high.is_finite() {
        return Ok(());
    }
    Err(Error::value(
        what,
        format!("[{low}, {high}]"),
        "[low, high] with 0 < low ≤ high",
        "Give both the same to fix it.",
    ))
}

/// Terms of the payload tasks that hold a point, with d the ball's distance from it.
pub(super) fn carry_terms() -> Vec<Term> {
    vec![
        Term::piecewise("pose", "r_p = e^{−1.6 d}", 1.0),
        Term::piecewise("up", "0.5 r_p/(1 + (1 − u_z)²)", 0.5),
        Term::piecewise("spin", "0.5 r_p/(1 + ω_z²)", 0.5),
        Term::smooth("effort", "0.1 e^{−e}", 0.1),
    ]
}

/// Writes [`carry_terms`] of an error.
#[inline(always)]
pub(super) fn carry_reward<S: Scalar>(view: &View<'_, S>, error: Vec3<S>, terms: &mut Pen<'_, S>) {
    let (drone, half) = (view.drone(0), S::constant(0.5));
    let pose = tip(1.6, error);
    terms.number(pose);
    terms.number(half * pose * bell(1.0, (S::one() - drone.up()[2]).square()));
    terms.number(half * pose * still(drone.angular_velocity));
    terms.number(S::constant(0.1) * (-view.effort(0)).exp());
}

/// 1 − b of a bar: what training losses pay for a pendulum that leans.
#[inline(always)]
pub(super) fn leaning<S: Scalar>(ball: &Frame<S>) -> S {
    S::one() - ball.up()[2]
}

/// Look-ahead points of the track tasks.
const POINTS: usize = 6;

/// A ball that follows a lemniscate: what both track tasks share. The path follows the load in the goal.
#[derive(Debug, Clone)]
pub(super) struct LoadTrack {
    pub load: Load,
    pub settings: LoadTrackSettings,
    path: Path,
}

impl LoadTrack {
    /// About (0, 0, `height`) m.
    pub(super) fn new(load: Load, settings: LoadTrackSettings, height: f64, dt: f64) -> Self {
        let path = Path {
            vertical: 0.6,
            scale: [[1.8, 1.8, 1.0], [3.2, 3.2, 1.5]],
            rate: [0.7, 1.0],
            origin: [0.0, 0.0, height],
            dt,
        };
        Self { load, settings, path }
    }

    /// Where the drone must be for the ball to follow the path.
    pub(super) fn wanted(&self, view: &View<'_, f64>) -> Option<Wanted> {
        let path = self.path.reference(&view.goal.from(LOAD), view.drone(0).yaw());
        Some(self.load.carried(view, LoadPath::Lemniscate(path)))
    }

    /// What [`LoadTrack::observe_ahead`] writes.
    pub(super) fn ahead_slice() -> Slice {
        Slice::new("path", 3 * POINTS, "m, world", "p_ref(k + 5i) − q for i = 0 … 5")
    }

    /// Lines of the settings.
    pub(super) fn settings() -> Vec<Setting> {
        let mut settings = load_settings(600, "[1.0, 1.0]");
        settings.push(Setting::new("reset_distance", 0.8, "largest distance of the ball from the path, m").positive());
        settings
    }

    /// Draws load, path and a first state within `reset_distance`.
    pub(super) fn start(&self, start: &mut Start<'_>) {
        self.load.draw(start);
        let first = self.path.draw(start, LOAD);
        let position = self.load.drone_of(start, first);
        for _ in 0..100 {
            let attitude = start.attitude(0.1 * PI, ANY_YAW);
            let ball = self.load.place(start, position, attitude);
            if safe::norm(sub(first, ball)) < self.settings.reset_distance {
                break;
            }
        }
    }

    /// p_ref(k + ahead) − q.
    #[inline(always)]
    pub(super) fn error<S: Scalar>(&self, view: &View<'_, S>, ahead: usize) -> Vec3<S> {
        let point = self.path.at(&view.goal.from(LOAD), view.step + S::constant(ahead as f64));
        sub(point, self.load.ball(view).position)
    }

    /// The path ahead, seen from the ball.
    #[inline(always)]
    pub(super) fn observe_ahead<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        for i in 0..POINTS {
            out.array(self.error(view, AHEAD * i));
        }
    }

    /// d > `reset_distance`.
    #[inline(always)]
    pub(super) fn far<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        let far = self.settings.reset_distance;
        S::constant(far * far).lt(safe::squared_norm(self.error(view, 0)))
    }

    /// d < 0.3 m.
    #[inline(always)]
    pub(super) fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        safe::squared_norm(self.error(view, 0)).lt(S::constant(0.09))
    }

    /// Distance, slip against the path and the drone's rate.
    #[inline(always)]
    pub(super) fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let slip = sub(self.path.velocity(&view.goal.from(LOAD), view.step), self.load.ball(view).velocity);
        let rate = S::constant(0.005) * safe::squared_norm(view.drone(0).angular_velocity);
        smooth_norm(self.error(view, 0), 0.1) + S::constant(0.02) * safe::squared_norm(slip) + rate
    }

    /// The ball on the path, the bar upright.
    pub(super) fn ideal(&self, start: &mut Start<'_>) {
        self.load.draw(start);
        let first = self.path.draw(start, LOAD);
        let position = self.load.drone_of(start, first);
        self.load.place(start, position, [1.0, 0.0, 0.0, 0.0]);
    }
}
