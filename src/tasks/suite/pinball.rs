//! Pinball: keep a ball bouncing on a drone.
//!
//! - DIFFERENCE: a touch counts once, after 0.2 s in the air and an apex of 0.3 m above the drone; the published score is paid in
//!   every step of contact, so that a ball that lies still is worth more than one that bounces.
//! - DIFFERENCE: the ball starts up to 0.3 m beside the drone; the published offset is drawn up and not used.
//! - DIFFERENCE: the drone carries a plate of 0.3 m × 0.3 m; published is the box of its body alone.
//! - DIFFERENCE: a drawn mass takes the ball's inertia with it.
//! - DIFFERENCE: the drone itself ends the episode where it leaves the room of the ball.
//! - DIFFERENCE: restitution is that of Hunt and Crossley's law, 0.8 at 5 m/s and more below.

use super::{StartAttitude, StartRange, less, made_of, more, rate_cost, speed_cost, squared, times};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{pseudo_huber, smooth_norm};
use crate::robot::{Inertial, Robot};
use crate::settings;
use crate::start::Start;
use crate::task::{BuiltIn, Task, View};
use crate::task_spec::Success;
use autodiff::{Mask, Scalar, Trace, TraceMask, safe};
use base::error::Result;
use dynamics::assembly::{Assembly, Member, Solid, single};
use dynamics::configurations::environment;
use dynamics::contact::ContactMaterial;
use dynamics::frame::Frame;
use dynamics::scene::Scene;
use dynamics::shape::{Geometry, Shape};
use dynamics::spatial::{Vec3, constants, sub};
use dynamics::tree::Model;
use dynamics::vehicle::{GRAVITY, Vehicle};
use std::f64::consts::PI;

/// Of the ball, m.
const RADIUS: f64 = 0.05;
/// Edges of the plate, m, and how far above the drone's origin its middle is.
const PLATE: Vec3<f64> = [0.3, 0.3, 0.06];
const PLATE_HEIGHT: f64 = 0.02;
/// Of ball on plate: k of k δ^{3/2}, N/m^{3/2}. 50 g at 5.5 m/s sink 2.8 cm into it.
const STIFFNESS: f64 = 1.5e4;
/// d of 1 + 3/2 d δ̇ that gives back 0.8 of 5 m/s, s/m: with a = 3/2 d · 5 m/s, 1.8 a = ln((1 + a)/(1 − 0.8 a)).
const DISSIPATION: f64 = 0.0497;
/// Longest substep that resolves it, s.
const SUBSTEP: f64 = 0.002;
/// What changes a ball's velocity by more in a step, m/s, is a touch.
const KICK: f64 = 0.3;

/// Places in the task state.
const WAS: usize = 0;
const AIR: usize = 1;
const APEX: usize = 2;
const TOUCHES: usize = 3;
const SCORED: usize = 4;

/// Where starts are.
fn start_range() -> StartRange {
    let position = [[-1.0, 1.0], [-1.0, 1.0], [1.25, 1.5]];
    StartRange { position, attitude: StartAttitude { tilt: 0.1 * PI, ..StartAttitude::default() } }
}

settings! {
    /// Settings of [`Pinball`].
    pub(crate) struct PinballSettings {
        vehicle: String = "hummingbird".into() => ("", "what flies", Any);
        horizon: usize = 600 => ("steps", "T", Any);
        ball_mass: [f64; 2] = [0.01, 0.05] => ("kg", "of the ball, least and largest", PositiveOrdered);
        ball_height: f64 = 1.6 => ("m", "of the ball above the drone at the start", Positive);
        ball_offset: f64 = 0.3 => ("m", "of the ball beside it, the most along x and y", NotNegative);
        start: StartRange = start_range() => group;
        air_time: f64 = 0.2 => ("s", "in the air, before a touch that counts", NotNegative);
        air_height: f64 = 0.3 => ("m", "above the drone, before a touch that counts", NotNegative);
        min_height: f64 = 0.3 => ("m", "lower the drone crashes", Any);
        ball_low: f64 = 0.2 => ("m", "lower the ball is lost", Any);
        ball_high: f64 = 4.5 => ("m", "higher it is lost", Any);
        side: f64 = 2.5 => ("m", "farther along x or y drone or ball is lost", Positive);
        success_touches: usize = 5 => ("", "touches of a success", Any);
        reward_below: f64 = 1.0 => ("-", "weight of the term below", NotNegative);
        reward_height: f64 = 0.8 => ("1/m", "weight of the term height", NotNegative);
        reward_touch: f64 = 3.0 => ("-", "of a touch that counts", NotNegative);
        loss_radius: f64 = 0.05 => ("m", "δ in the loss's distance √(d² + δ²)", Positive);
        loss_apex: f64 = 0.5 => ("1/m", "weight of the error of the ball's apex in the loss", NotNegative);
        apex: f64 = 2.6 => ("m", "height of the ball's apex that the loss asks for", Any);
        height: f64 = 1.4 => ("m", "height of the drone that the loss asks for", Any);
        loss_height: f64 = 0.2 => ("1/m", "weight of the error of the drone's height in the loss", NotNegative);
        loss_middle: f64 = 0.1 => ("1/m", "weight of the way to the middle in the loss", NotNegative);
        loss_ball: f64 = 0.1 => ("s²/m", "weight of the ball's velocity along x and y in the loss", NotNegative);
        loss_up: f64 = 0.2 => ("m", "weight of ‖e_z − u‖² in the loss", NotNegative);
        loss_rate: f64 = 0.005 => ("m s²/rad²", "weight of the angular velocity in the loss", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Pinball {
    robot: Robot,
    settings: PinballSettings,
    /// Body of the ball.
    ball: usize,
    /// Seconds per step.
    dt: f64,
}

impl BuiltIn for Pinball {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: PinballSettings = config.settings()?;
        let vehicle = config.vehicle(&settings.vehicle)?;
        let mean = 0.5 * (settings.ball_mass[0] + settings.ball_mass[1]);
        let model = model(&vehicle, mean)?;
        let mut physics = config.physics_with(|effects| effects.contact = true);
        physics.substeps = physics.substeps.max((physics.dt / SUBSTEP).ceil() as usize);
        let ball = model.body("ball/ball")?;
        let robot = Robot::of_model(&model, physics, Some(&vehicle), |_| vec![])?.varying_inertial(ball);
        Ok(Self { robot, settings, ball, dt: config.dt })
    }
}

/// A drone with a plate, and a ball.
fn model(vehicle: &Vehicle, mass: f64) -> Result<Model> {
    let plate = Shape::new(Geometry::Box { size: PLATE }).at([0.0, 0.0, PLATE_HEIGHT]);
    let racket = Vehicle { shapes: vec![plate], ..vehicle.clone() };
    let mut ball = Assembly::new("ball");
    ball.part("ball", Solid::sphere(RADIUS).mass(mass));
    let members = [Member::new("drone", single(&racket)?, [0.0; 3]), Member::new("ball", ball.model()?, [0.0; 3])];
    let mut parts = environment("pinball", &members, &Scene::default())?.parts().clone();
    parts.contact.material =
        ContactMaterial { stiffness: STIFFNESS, dissipation: DISSIPATION, friction: 0.2, ..ContactMaterial::default() };
    Model::new(parts)
}

impl Pinball {
    fn ball<S: Scalar>(&self, view: &View<'_, S>) -> Frame<S> {
        view.frame(self.ball)
    }

    /// b − p.
    fn way<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(self.ball(view).position, view.drone(0).position)
    }

    /// Where the ball comes down to the drone, x and y.
    fn landing<S: Scalar>(&self, view: &View<'_, S>) -> [S; 2] {
        let Frame { position: b, velocity: v, .. } = self.ball(view);
        let height = (self.way(view)[2] - S::constant(RADIUS + PLATE_HEIGHT + 0.5 * PLATE[2])).max(S::zero());
        let fall = safe::sqrt(S::constant(2.0 * GRAVITY).mul_add(height, v[2].square()), safe::SQUARED_NORM_FLOOR);
        let time = S::constant(1.0 / GRAVITY) * (v[2] + fall);
        [time.mul_add(v[0], b[0]), time.mul_add(v[1], b[1])]
    }
}

impl Task for Pinball {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p drone, v, ω velocity and angular velocity (world), u = R e_z, b, v_b the ball's middle and its velocity, l where it \
         comes down to the drone, x and y, k steps. The ball has a radius of 0.05 m, {ball_mass} kg and bounces with 0.8 of \
         5 m/s. Start: p uniform in {start_position} m, roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, \
         at rest; the ball at rest {ball_height} m above, within ±{ball_offset} m along x and y."
    }

    fn start(&self, start: &mut Start<'_>) {
        let own = &self.settings;
        let mass = start.task.uniform(own.ball_mass[0], own.ball_mass[1]);
        start.goal.field("mass", "kg", "of the ball").number(mass);
        Inertial::ball(mass, RADIUS, constants([0.0; 3])).write(start.numbers, self.ball);
        let beside = [0, 1].map(|_| start.task.uniform(-own.ball_offset, own.ball_offset));
        let (position, attitude) = own.start.draw(start);
        start.place(0, position, attitude);
        let above = [position[0] + beside[0], position[1] + beside[1], position[2] + own.ball_height];
        start.place(1, above, [1.0, 0.0, 0.0, 0.0]);
    }

    fn remember(&self, view: &View, task_state: &mut Writer) {
        let own = &self.settings;
        let (zero, one) = (Trace::zero(), Trace::one());
        let speed = self.ball(view).velocity[2];
        let kick = speed - view.task_state[WAS] + Trace::constant(GRAVITY * self.dt);
        let touched = more(kick, KICK);
        let (air, apex) = (view.task_state[AIR], view.task_state[APEX]);
        let counts = touched.and(less(air, own.air_time).not()).and(less(apex, own.air_height).not());
        let scored = Trace::select(counts, one, zero);
        task_state.field("ball_speed", "m/s", "v_b,z behind the last step").number(speed);
        let air = Trace::select(touched, zero, air + Trace::constant(self.dt));
        task_state.field("air_time", "s", "since the last touch").number(air);
        let apex = Trace::select(touched, zero, apex.max(self.way(view)[2]));
        task_state.field("air_height", "m", "most of b_z − z since the last touch").number(apex);
        let touches = view.task_state[TOUCHES] + scored;
        task_state.field("touches", "-", "that counted").number(touches);
        task_state.field("scored", "-", "1 in a step with a touch that counts").number(scored);
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("position", "m, world", "p").array(view.drone(0).position);
        view.observe_drone(0, out);
        out.field("ball", "m, world", "b − p").array(self.way(view));
        out.field("ball_velocity", "m/s, world", "v_b").array(self.ball(view).velocity);
        view.observe_clock(out);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let (own, way) = (&self.settings, self.way(view));
        let beside = safe::norm([way[0], way[1]]);
        let formula = "{×reward_below}1/(1 + ‖(b − p)_xy‖)";
        terms.term("below", formula, own.reward_below).piecewise();
        terms.number(times(own.reward_below, (Trace::one() + beside).recip()));
        let floor = view.drone(0).position[2].max(Trace::one());
        let height = (self.ball(view).position[2] - floor).max(Trace::zero()).min(Trace::constant(2.0));
        let formula = "{×reward_height}(b_z − max(z, 1 m)), held within 0 to 2 m";
        terms.term("height", formula, 2.0 * own.reward_height).piecewise().number(times(own.reward_height, height));
        let scored = view.task_state[SCORED];
        terms.term(
            "touch",
            "{×reward_touch}1 where a touch counts: once, after {air_time} s and {air_height} m",
            own.reward_touch,
        );
        terms.non_smooth().number(times(own.reward_touch, scored));
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let (own, [x, y, z], ball) = (&self.settings, view.drone(0).position, self.ball(view).position);
        ends.when("crash", "z < {min_height} m", less(z, own.min_height));
        ends.when("ball_low", "b_z < {ball_low} m", less(ball[2], own.ball_low));
        ends.when("ball_high", "b_z > {ball_high} m", more(ball[2], own.ball_high));
        let aside = more(ball[0].abs(), own.side).or(more(ball[1].abs(), own.side));
        ends.when("ball_wide", "|b_x| or |b_y| > {side} m", aside);
        let aside = more(x.abs(), own.side).or(more(y.abs(), own.side)).or(more(z, own.ball_high));
        ends.when("wide", "|x| or |y| > {side} m, or z > {ball_high} m", aside);
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        let touches = view.task_state[TOUCHES];
        out.metric("touches_left", "-", Trace::constant(self.settings.success_touches as f64) - touches);
        out.metric("touches", "-", touches);
        out.metric("ball_distance", "m", safe::norm(self.way(view)));
        out.metric("uprightness", "-", view.drone(0).up()[2]);
    }

    fn success(&self, view: &View) -> TraceMask {
        more(view.task_state[TOUCHES], self.settings.success_touches as f64 - 0.5)
    }

    fn success_rule(&self) -> Success {
        Success::below("touches_left", 0.5).once()
    }

    fn loss(&self, view: &View, loss: &mut Loss) {
        let (own, drone, ball) = (&self.settings, view.drone(0), self.ball(view));
        let (at, p) = (self.landing(view), drone.position);
        loss.add("√(‖l − p_xy‖² + {loss_radius}²)", smooth_norm([at[0] - p[0], at[1] - p[1]], own.loss_radius));
        let apex = Trace::constant(0.5 / GRAVITY)
            .mul_add(ball.velocity[2].square(), ball.position[2] - Trace::constant(own.apex));
        loss.add("{×loss_apex}h₁(b_z + v_b,z²/2g − {apex} m)", times(own.loss_apex, pseudo_huber([apex], 1.0)));
        let height = p[2] - Trace::constant(own.height);
        loss.add("{×loss_height}h₁(z − {height} m)", times(own.loss_height, pseudo_huber([height], 1.0)));
        loss.add("{×loss_middle}h₁(l)", times(own.loss_middle, pseudo_huber(at, 1.0)));
        loss.add("{×loss_ball}h₅(v_b,xy)", speed_cost(own.loss_ball, [ball.velocity[0], ball.velocity[1]]));
        let lean = sub(constants([0.0, 0.0, 1.0]), drone.up());
        loss.add("{×loss_up}‖e_z − u‖²", squared(own.loss_up, lean));
        loss.add("{×loss_rate}h₁₀(ω)", rate_cost(own.loss_rate, drone.angular_velocity));
    }

    fn ideal(&self, start: &mut Start<'_>) {
        start.goal.field("mass", "kg", "of the ball").number(0.03);
        start.place(0, [0.0, 0.0, 1.5], [1.0, 0.0, 0.0, 0.0]);
        start.place(1, [0.0, 0.0, 3.5], [1.0, 0.0, 0.0, 0.0]);
        start.task_state[SCORED] = Trace::one();
    }
}
