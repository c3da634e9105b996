//! Forest: cross a forest, which is another one in every episode, by what sensors see of it.
//!
//! The sensors are those of the configuration, unless it says otherwise the published lidar of 36 × 4 beams; their readings stand
//! behind what is written here. Reward and ends know the trunks: they do not depend on which sensor flies.
//!
//! - DIFFERENCE: trunks are columns that reach higher than one may fly, at random in a corridor of 24 m × 12 m, anew in every
//!   episode; the published terrain is one for all environments, half of its obstacles are pits and half of the others lower
//!   than the flight.
//! - DIFFERENCE: T = 1000 steps for 24 m; the published 48 m in 12.8 s ask for more than the speed that ends an episode.
//! - DIFFERENCE: height and distance to the target are observed.
//! - DIFFERENCE: touch ends an episode, wherever on the vehicle it is, a ball about every propeller included; published is a beam below
//!   0.3 m, so what no beam met did not count. The term safety is of the clearance, not of the mean beam.
//! - DIFFERENCE: the term progress falls no further than its bound is high.

use super::clear_path::clear_path;
use super::obstacles::Outline;
use super::{
    StartAttitude, StartRange, farther, latch, less, made_of, more, nearer, rate_cost, speed_cost, squared,
    starts_on_host, succeeds_once, times,
};
use crate::config::EnvConfig;
use crate::declare::{Ends, Goal, Loss, Writer};
use crate::grove::{Grove, MAX_TRUNKS};
use crate::reward::upright;
use crate::robot::Robot;
use crate::settings;
use crate::start::{ManyDraw, Start, StartScalar};
use crate::task::{BuiltIn, HostStart, Task, TaskReference, View};
use autodiff::{Array, Mask, Scalar, Trace, safe};
use base::error::Result;
use controllers::reference::{Reference, Waypoint, Waypoints};
use dynamics::scene::{self, Scene};
use dynamics::spatial::{Vec3, constants, scale, sub};
use std::iter;

/// Where trunks stand that an episode leaves out, x, m.
const ELSEWHERE: f64 = -1000.0;
/// Farther than this everything is as far, m.
const REACH: f64 = 10.0;
/// Between which clearances the term safety is one of them, m.
const SAFETY: [f64; 2] = [0.05, 4.0];
/// Starts among trunks are no nearer to them, m.
const CLEAR: f64 = 0.6;
/// Behind the start and beyond the target the corridor goes on, m.
const MARGIN: f64 = 2.0;
/// More than its own reach that a controller keeps from trunks, m.
const ROOM: f64 = 0.08;
/// Share of the rewarded speed that a controller flies at.
const STEADY: f64 = 0.9;
/// In which it comes to it, m/s².
const SPEED_UP: f64 = 1.2;
/// So far beyond the target it comes to rest, m.
const BEYOND: f64 = 1.2;

/// Where starts are.
fn start_range() -> StartRange {
    StartRange { position: [[0.0, 0.5], [-4.0, 4.0], [1.8, 2.2]], attitude: StartAttitude::default() }
}

settings! {
    /// Settings of [`Forest`].
    pub(crate) struct ForestSettings {
        vehicle: String = "hummingbird".into() => ("", "what flies", Any);
        horizon: usize = 1000 => ("steps", "T", Any);
        length: f64 = 24.0 => ("m", "of the corridor along x", Positive);
        width: f64 = 12.0 => ("m", "of the corridor along y", Positive);
        trunks: usize = 45 => ("", "trunks in the corridor", Any);
        trunks_ease: f64 = 1.0 => ("-", "share of the trunks at difficulty 0", Share);
        radius: [f64; 2] = [0.2, 0.3] => ("m", "of trunks, least and largest", PositiveOrdered);
        gap: f64 = 0.8 => ("m", "least way between two trunks", NotNegative);
        clear: [f64; 2] = [2.0, 1.0] => ("m", "without trunks at the beginning and at the end", Any);
        target: [[f64; 2]; 3] = [[24.0, 24.0], [-4.0, 4.0], [2.0, 2.0]]
            => ("m, world", "p_t, lowest and highest per axis", Ordered);
        start: StartRange = start_range() => group;
        start_along: f64 = 0.0 => ("-", "share of episodes that begin anywhere on the way to the target", Share);
        speed: f64 = 2.0 => ("m/s", "beyond which haste is worth no more", Positive);
        max_speed: f64 = 2.5 => ("m/s", "faster ends the episode", Positive);
        min_height: f64 = 0.2 => ("m", "lower is a crash", Any);
        max_height: f64 = 4.0 => ("m", "higher ends the episode", Any);
        success_distance: f64 = 0.5 => ("m", "position error of a success", Positive);
        reward_progress: f64 = 1.0 => ("s/m", "weight of the term progress", NotNegative);
        reward_up: f64 = 1.0 => ("-", "weight of the term up", NotNegative);
        reward_alive: f64 = 1.0 => ("-", "of every step that does not end", NotNegative);
        reward_safety: f64 = 0.2 => ("-", "weight of the term safety", NotNegative);
        loss_speed: f64 = 1.8 => ("m/s", "that the loss asks for", Positive);
        loss_pace: f64 = 0.3 => ("s²/m", "weight of the error of the velocity in the loss", NotNegative);
        loss_clearance: f64 = 4.0 => ("m", "weight of the clearance in the loss", NotNegative);
        loss_reach: f64 = 0.3 => ("m", "over which it falls by e", Positive);
        loss_heading: f64 = 0.3 => ("m", "weight of ‖h − n‖² in the loss: beams ahead then look where it goes", NotNegative);
        loss_up: f64 = 0.1 => ("m", "weight of ‖e_z − u‖² in the loss", NotNegative);
        loss_rate: f64 = 0.005 => ("m s²/rad²", "weight of the angular velocity in the loss", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Forest {
    robot: Robot,
    settings: ForestSettings,
    grove: Grove,
    /// What draws the places of its trunks.
    places: ManyDraw,
    /// Radii of the trunks, m.
    radii: Vec<f64>,
    outline: Outline,
}

impl BuiltIn for Forest {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: ForestSettings = config.settings()?;
        let grove = Grove::new(scene::Forest {
            seed: 0,
            length: settings.length,
            width: settings.width,
            clear: settings.clear,
            trunks: settings.trunks,
            radius: settings.radius,
            height: settings.max_height + 1.0,
            gap: settings.gap,
        })?;
        let outline = Outline::of(&config.vehicle(&settings.vehicle)?);
        let (robot, places) = (config.single_robot(&settings.vehicle)?, ManyDraw::Forest(Box::new(grove.clone())));
        Ok(Self { robot, radii: grove.radii(), settings, grove, places, outline })
    }
}

impl Forest {
    /// p_t − p.
    fn error<S: Scalar>(view: &View<'_, S>) -> Vec3<S> {
        sub(view.goal.array(0), view.drone(0).position)
    }

    /// (p_t − p)/d.
    fn direction<S: Scalar>(error: Vec3<S>) -> Vec3<S> {
        scale(safe::recip_sqrt(safe::squared_norm(error), safe::SQUARED_NORM_FLOOR), error)
    }

    /// Least distance between the vehicle and a trunk, m: below the trunks' tops that of their outlines from above.
    fn clearance<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let places = |i: usize| [view.goal[3 + 2 * i], view.goal[4 + 2 * i]];
        self.outline.clearance(&view.drone(0), places, &self.radii, REACH)
    }

    /// Keeps p_t, then the places of the trunks, of which the first `standing` stand, displaced.
    fn set_goal<S: StartScalar>(&self, goal: &mut Goal<'_, S>, target: Vec3<f64>, standing: usize, offsets: &[f64]) {
        goal.field("target", "m, world", "p_t").array(target);
        goal.field("trunks", "m, world", "(x, y) of every trunk");
        for (i, trunk) in self.grove.trunks().iter().enumerate() {
            let [x, y, _] = trunk.shape.position;
            let place = [x + offsets[3 * i], y + offsets[3 * i + 1]];
            goal.array(if i < standing { place } else { [ELSEWHERE, 0.0] });
        }
    }
}

impl HostStart for Forest {
    fn start(&self, start: &mut Start<'_, f64>) {
        let own = &self.settings;
        let target = own.target.map(|[low, high]| start.task.uniform(low, high));
        let share = super::eased(own.trunks_ease, start.difficulty);
        let standing = share * own.trunks as f64;
        let (mut offsets, n) = ([0.0; 3 * MAX_TRUNKS], 3 * self.radii.len());
        start.task.many(&self.places, &[standing], &mut offsets[..n]);
        let standing = standing.round() as usize;
        self.set_goal(&mut start.goal, target, standing, &offsets);
        let (position, attitude) = own.start.draw(start);
        let position = self.along(start, position, target);
        start.place(0, position, attitude);
    }
}

impl Task for Forest {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p drone, v, ω velocity and angular velocity (world), h = R e_x, u = R e_z, c least distance between trunks and \
         drone, propellers included, up to 10 m, d = ‖p_t − p‖, n = (p_t − p)/d. {trunks} trunks of radius {radius} m stand in a corridor of {length} m × \
         {width} m, {gap} m or more apart. Target: p_t uniform in {target} m. Start: p uniform in {start_position} m, \
         roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, at rest."
    }

    fn scene(&self) -> Scene {
        self.grove.scene().clone()
    }

    fn place_scene(&self, goal: &[f64], placement: &mut [f64]) {
        for (i, trunk) in self.grove.trunks().iter().enumerate() {
            placement[3 * i] = goal[3 + 2 * i] - trunk.shape.position[0];
            placement[3 * i + 1] = goal[4 + 2 * i] - trunk.shape.position[1];
        }
    }

    starts_on_host!();

    fn remember(&self, view: &View, task_state: &mut Writer) {
        let reached = latch(view.task_state[0], nearer(Self::error(view), self.settings.success_distance));
        task_state.field("reached", "-", "1 once d < {success_distance} m").number(reached);
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        let error = Self::error(view);
        out.field("direction", "-, world", "n").within(-1.0, 1.0).array(Self::direction(error));
        view.observe_drone(0, out);
        out.field("height", "m, world", "z").number(view.drone(0).position[2]);
        out.field("distance", "m", "d").number(safe::norm(error));
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let (drone, own) = (view.drone(0), &self.settings);
        let n = Self::direction(Self::error(view));
        let v = drone.velocity;
        let towards = n[0].mul_add(v[0], n[1].mul_add(v[1], n[2] * v[2]));
        let towards = towards.min(Trace::constant(own.speed)).max(Trace::constant(-own.speed));
        let most = own.reward_progress * own.speed;
        terms.term("progress", "{×reward_progress}min(v·n, {speed} m/s), no less than −{speed} m/s", most);
        terms.within(-most, most).piecewise().number(times(own.reward_progress, towards));
        terms.term("up", "{×reward_up}((u_z + 1)/2)²", own.reward_up).number(times(own.reward_up, upright(drone.up())));
        terms.term("alive", "{×reward_alive}1", own.reward_alive).number(Trace::constant(own.reward_alive));
        let clearance = self.clearance(view).max(Trace::constant(SAFETY[0])).min(Trace::constant(SAFETY[1]));
        let [low, high] = SAFETY.map(|c| own.reward_safety * c.ln());
        terms.term("safety", "{×reward_safety}ln(c/m), c held within 0.05 to 4 m", high);
        terms.within(low, high).piecewise().number(times(own.reward_safety, clearance.ln()));
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let (drone, own) = (view.drone(0), &self.settings);
        let [x, y, z] = drone.position;
        ends.when("crash", "z < {min_height} m", less(z, own.min_height));
        ends.when("high", "z > {max_height} m", more(z, own.max_height));
        ends.when("fast", "‖v‖ > {max_speed} m/s", farther(drone.velocity, own.max_speed));
        let beyond = less(x, -MARGIN).or(more(x, own.length + MARGIN));
        let outside = more(y.abs(), 0.5 * own.width).or(beyond);
        ends.when("corridor", "2 m before or behind the corridor of {length} m, or beside its {width} m", outside);
        ends.when("contact", "c < 0", less(self.clearance(view), 0.0));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("position_error", "m", safe::norm(Self::error(view)));
        out.metric("uprightness", "-", view.drone(0).up()[2]);
        out.metric("clearance", "m", self.clearance(view));
        out.metric("speed", "m/s", safe::norm(view.drone(0).velocity));
    }

    succeeds_once!(self, view: view.task_state[0], self.settings.success_distance);

    fn loss(&self, view: &View, loss: &mut Loss) {
        let (drone, own, error) = (view.drone(0), &self.settings, Self::error(view));
        // a second before the target it slows down
        let slow = Trace::constant(own.loss_speed * own.loss_speed);
        let pace = times(own.loss_speed, (safe::squared_norm(error) + slow).sqrt().recip());
        loss.add(
            "{×loss_pace}h₅(v − v_t), v_t = {loss_speed} m/s (p_t − p)/√(d² + ({loss_speed} m)²)",
            speed_cost(own.loss_pace, sub(drone.velocity, scale(pace, error))),
        );
        let clearance = self.clearance(view).max(Trace::constant(-0.2));
        let near = (Trace::constant(-1.0 / own.loss_reach) * clearance).exp();
        loss.add("{×loss_clearance}e^{−max(c, −0.2 m)/{loss_reach} m}", times(own.loss_clearance, near));
        let turn = sub(drone.heading(), Self::direction(error));
        loss.add("{×loss_heading}‖h − n‖²", squared(own.loss_heading, turn));
        let lean = sub(constants([0.0, 0.0, 1.0]), drone.up());
        loss.add("{×loss_up}‖e_z − u‖²", squared(own.loss_up, lean));
        loss.add("{×loss_rate}h₁₀(ω)", rate_cost(own.loss_rate, drone.angular_velocity));
    }

    /// Along a path that keeps away from all trunks, from rest to a steady pace and through the target: by a controller that
    /// knows where they stand. Straight ahead where there is no such path.
    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        let (from, to, yaw) = (view.drone(0).position, view.goal.array::<3>(0), view.drone(0).yaw());
        let straight = || vec![[from[0], from[1]], [to[0], to[1]]];
        let mut path = self.path(view, from, to).unwrap_or_else(straight);
        path.push([to[0] + BEYOND, to[1]]);
        let gone: Vec<f64> = iter::once(0.0)
            .chain(path.windows(2).map(|p| (p[1][0] - p[0][0]).hypot(p[1][1] - p[0][1])))
            .scan(0.0, |sum, way| {
                *sum += way;
                Some(*sum)
            })
            .collect();
        let length = *gone.last()?;
        let point = |(at, gone): (&[f64; 2], &f64)| {
            let height = from[2] + gone / length * (to[2] - from[2]);
            let time = time_from_rest_to_rest(*gone, length, STEADY * self.settings.speed, SPEED_UP);
            Waypoint { time, position: [at[0], at[1], height], yaw }
        };
        let way = Waypoints::new(path.iter().zip(&gone).map(point).collect()).ok()?;
        Some(TaskReference::one(Reference::Waypoints(way)))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        self.set_goal(&mut start.goal, [self.settings.length, 0.0, 2.0], 0, &[0.0; 3 * MAX_TRUNKS]);
        start.place(0, [0.5 * self.settings.length, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]);
        let at = self.robot.roots()[0];
        start.state[at + 3] = self.settings.speed.into();
    }
}

impl Forest {
    /// A path in the plane that keeps the whole vehicle away from all trunks, however it is turned.
    fn path(&self, view: &View<'_, f64>, from: Vec3<f64>, to: Vec3<f64>) -> Option<Vec<[f64; 2]>> {
        let reach = self.outline.reach() + ROOM;
        let circle = |i: usize| [view.goal[3 + 2 * i], view.goal[4 + 2 * i], self.radii[i] + reach];
        let circles: Vec<_> = (0..self.radii.len()).map(circle).collect();
        let side = 0.5 * self.settings.width - reach;
        let bounds = [[from[0].min(to[0]) - 1.0, -side], [from[0].max(to[0]) + 1.0, side]];
        clear_path([from[0], from[1]], [to[0], to[1]], bounds, &circles)
    }

    /// Where an episode begins that should begin at `from`: in a share of episodes anywhere on the straight way to `to` where
    /// nothing is near.
    fn along(&self, start: &mut Start<'_, f64>, from: Vec3<f64>, to: Vec3<f64>) -> Vec3<f64> {
        if self.settings.start_along == 0.0 || start.reset.unit() >= self.settings.start_along {
            return from;
        }
        for _ in 0..20 {
            let share = start.reset.unit();
            let place = [0, 1, 2].map(|i| from[i] + share * (to[i] - from[i]));
            let mut trunks = start.goal[3..].chunks_exact(2).zip(&self.radii);
            let free = |(at, radius): (&[f64], &f64)| (at[0] - place[0]).hypot(at[1] - place[1]) > radius + CLEAR;
            if trunks.all(free) {
                return place;
            }
        }
        from
    }
}

/// When a way of `length` m is `gone` m gone, s: at `speed` after and before constant accelerations from and to rest.
fn time_from_rest_to_rest(gone: f64, length: f64, speed: f64, acceleration: f64) -> f64 {
    let speed = speed.min((acceleration * length).sqrt());
    let ramp = 0.5 * speed * speed / acceleration;
    let whole = length / speed + speed / acceleration;
    if gone < ramp {
        (2.0 * gone / acceleration).sqrt()
    } else if gone < length - ramp {
        gone / speed + 0.5 * speed / acceleration
    } else {
        whole - (2.0 * (length - gone).max(0.0) / acceleration).sqrt()
    }
}
