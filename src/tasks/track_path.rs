//! The lemniscate that Track tasks follow, drawn anew for every episode.
//!
//! p_ref(k) = origin + R_z(ψ) (S ∘ L(π/2 + τ(w (k + k₀) dt); c)), see [`Lemniscate`].
//!
//! - DIFFERENCE: scaled before it is rotated, so a rotated curve is not sheared (defect 21).
//! - DIFFERENCE: starts are on the scaled curve; published ones miss it by up to 0.18 m (defect 21).

use super::declare::Writer;
use super::task::{Start, TaskReference, View, eased};
use crate::autodiff::{Array, Scalar, Trace, safe};
use crate::controllers::reference::{Lemniscate, Reference, lemniscate_curve, lemniscate_phase};
use crate::dynamics::GRAVITY;
use crate::dynamics::frame::Frame;
use crate::dynamics::spatial::{Vec3, add, cross, from_euler, multiply, rotate_back, scale, sub, to_euler};
use crate::rng::Stream;
use crate::settings;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Numbers of a path among a goal's.
pub(crate) const PATH: usize = 9;
/// Places of what follows the curve among them: steps that the path is ahead, and its reset distance.
const AHEAD_BY: usize = 7;
const RESET: usize = 8;
/// Steps between look-ahead points.
pub(crate) const AHEAD: usize = 5;

settings! {
    /// Where the numbers of a path are drawn from.
    pub struct PathRange {
        vertical: f64 = 0.6 => ("-", "c of the path, uniform within ± this", NotNegative);
        scale: [[f64; 2]; 3] = [[1.8, 3.2], [1.8, 3.2], [1.0, 1.5]]
            => ("m", "S of the path, lowest and highest per axis", PositiveOrdered);
        rate: [f64; 2] = [0.8, 1.1] => ("rad/s", "|w| of the path, lowest and highest; either sign", PositiveOrdered);
        origin: [f64; 3] = [0.0, 0.0, 2.0] => ("m, world", "middle of the path", Any);
    }
}

settings! {
    /// What tasks have that follow a path.
    pub struct Follow {
        reset_distance: f64 = 0.5 => ("m", "largest distance from the path", Positive);
        reset_ease: f64 = 1.0 => ("-", "factor of the reset distance at difficulty 0", Positive);
        rate_ease: f64 = 1.0 => ("-", "factor of the path's rate at difficulty 0", Positive);
        start_along: f64 = 0.0
            => ("-", "share of episodes that begin along the path, with its velocity and, of one drone, its lean", Share);
        path: PathRange = PathRange::default() => group;
    }
}

/// What paths say in [`Task::about`](super::Task::about); about `{path_origin}` m.
macro_rules! about_path {
    () => {
        "p_ref(k) the path, a lemniscate of vertical part c within ±{path_vertical}, scale S within {path_scale} m \
         and rate |w| within {path_rate} rad/s about {path_origin} m"
    };
}

pub(crate) use about_path;

/// A path that episodes draw.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackPath {
    own: Follow,
    /// Seconds per step.
    dt: f64,
}

impl TrackPath {
    /// With steps of `dt` seconds.
    pub fn new(own: &Follow, dt: f64) -> Self {
        Self { own: own.clone(), dt }
    }

    /// Middle of the path, m, world.
    pub fn origin(&self) -> [f64; 3] {
        self.own.path.origin
    }

    /// Draws a path into the goal; returns where it starts.
    pub fn draw(&self, start: &mut Start<'_>) -> Vec3<f64> {
        let (r, range) = (&mut start.task, &self.own.path);
        let vertical = r.uniform(-range.vertical, range.vertical);
        let scale = range.scale.map(|[low, high]| r.uniform(low, high));
        let sign = if r.unit() < 0.5 { -1.0 } else { 1.0 };
        let rate = sign * r.uniform(range.rate[0], range.rate[1]) * eased(self.own.rate_ease, start.difficulty);
        let rotation = r.uniform(0.0, TAU);
        let ahead = if self.own.start_along > 0.0 { self.draw_ahead(r, rate) } else { 0.0 };
        let reset = self.own.reset_distance * eased(self.own.reset_ease, start.difficulty);
        let (goal, turn) = (&mut start.goal, [rotation.cos(), rotation.sin()]);
        goal.field("path_vertical", "-", "c").number(vertical);
        goal.field("path_scale", "m", "S").array(scale);
        goal.field("path_rate", "rad/s", "w").number(rate);
        goal.field("path_rotation", "-", "(cos ψ, sin ψ)").within(-1.0, 1.0).array(turn);
        goal.field("path_ahead", "steps", "that the path is ahead of k").number(ahead);
        goal.field("reset_distance", "m", "beyond which the episode ends").number(reset);
        let numbers = [vertical, scale[0], scale[1], scale[2], rate, turn[0], turn[1], ahead, reset];
        self.at(&numbers, 0.0)
    }

    /// In the share of episodes that begin along the path: anywhere in a lap, 2 s after its rest; else 0. Whole steps.
    fn draw_ahead(&self, r: &mut Stream, rate: f64) -> f64 {
        let (along, lap) = (r.unit() < self.own.start_along, TAU / rate.abs());
        let ahead = r.uniform(2.0, 2.0 + lap);
        if along { (ahead / self.dt).round() } else { 0.0 }
    }

    /// Whether an error is beyond the reset distance of the episode.
    pub fn far<S: Scalar>(&self, goal: &[S], error: Vec3<S>) -> S::Mask {
        goal[RESET].square().lt(safe::squared_norm(error))
    }

    /// Where the path of a goal whose numbers begin at `first` is ahead: gives the root of tree 0, placed with the attitude of a
    /// start, the velocity that leads a point on the path. Where `lever` is given the root leans as a body does that is held by
    /// its thrust along the path, the point `lever` below its origin along its axis (Peng et al. 2018: reference state
    /// initialisation).
    pub fn join(&self, start: &mut Start<'_>, first: usize, lever: Option<f64>) {
        let goal: [f64; PATH] = std::array::from_fn(|k| start.goal[first + k]);
        if goal[AHEAD_BY] == 0.0 {
            return;
        }
        let view = &goal[..];
        let (position, velocity) = (self.at(view, 0.0), self.velocity(view, 0.0));
        let root = start.robot.roots()[0];
        start.state[root + 3..root + 6].copy_from_slice(&velocity);
        let Some(lever) = lever else { return };
        let half_step = 0.5 / self.dt;
        let up_rate = scale(half_step, sub(self.lean(view, 1.0).0, self.lean(view, -1.0).0));
        let (up, pull) = self.lean(view, 0.0);
        let own = std::array::from_fn(|k| start.state[root + 6 + k]);
        let yaw = to_euler(start.robot.attitude_of_hover_axes(0, own))[2];
        // the shortest turn from e_z to the lean, after the yaw
        let lean = safe::normalise([1.0 + up[2], -up[1], up[0], 0.0]);
        let attitude = multiply(lean, from_euler(0.0, 0.0, yaw));
        start.place(0, add(position, scale(lever, up)), attitude);
        start.state[root + 3..root + 6].copy_from_slice(&add(velocity, scale(lever, up_rate)));
        let rate = rotate_back(start.robot.attitude_of_body(0, attitude), cross(up, up_rate));
        start.state[root + 10..root + 13].copy_from_slice(&rate);
        for rotor in start.robot.drones().iter().flat_map(|d| &d.rotors) {
            start.state[rotor.speed] = (start.state[rotor.speed] * pull.sqrt()).min(rotor.max_speed);
        }
    }

    /// Direction of the specific force at step k of a path, and its size over g.
    fn lean(&self, goal: &[f64], step: f64) -> (Vec3<f64>, f64) {
        let (before, after) = (self.velocity(goal, step - 1.0), self.velocity(goal, step + 1.0));
        let mut force = scale(0.5 / self.dt, sub(after, before));
        force[2] += GRAVITY;
        (safe::normalise(force), safe::norm(force) / GRAVITY)
    }

    /// The path ahead of a body at `position`, where it comes first in the goal.
    pub fn observe_ahead(&self, view: &View, position: Vec3<Trace>, out: &mut Writer) {
        out.field("path", "m, world", "p_ref(k + 5i) − p for i = 0 … 3");
        self.observe(view.goal, view.step, 4, position, out);
    }

    /// The path for who is led along it, where it comes first in the goal.
    pub fn lead(&self, view: &View<'_, f64>, led: &Frame<f64>) -> TaskReference {
        let path = self.reference(view.goal, led.yaw());
        TaskReference::one(Reference::Lemniscate(path)).of(led.position)
    }

    /// p_ref(k + 5i) − `position` for `points` points from i = 0 on.
    pub fn observe(&self, goal: &[Trace], step: Trace, points: usize, position: Vec3<Trace>, out: &mut Writer) {
        for i in 0..points {
            out.array(sub(self.at(goal, step + Trace::constant((AHEAD * i) as f64)), position));
        }
    }

    /// p_ref at step k of the path in `goal`, whose numbers begin at 0.
    pub fn at<S: Scalar>(&self, goal: &[S], step: S) -> Vec3<S> {
        let time = (step + goal[AHEAD_BY]) * S::constant(self.dt);
        let phase = S::constant(FRAC_PI_2) + lemniscate_phase(goal[4], time);
        let curve = lemniscate_curve(phase, goal[0]);
        let (x, y) = (goal[1] * curve[0], goal[2] * curve[1]);
        let (c, s) = (goal[5], goal[6]);
        [
            S::constant(self.own.path.origin[0]) + c.mul_add(x, -(s * y)),
            S::constant(self.own.path.origin[1]) + s.mul_add(x, c * y),
            S::constant(self.own.path.origin[2]) + goal[3] * curve[2],
        ]
    }

    /// dp_ref/dt at step k, by central differences over two steps.
    pub fn velocity<S: Scalar>(&self, goal: &[S], step: S) -> Vec3<S> {
        let ahead = self.at(goal, step + S::one());
        let behind = self.at(goal, step - S::one());
        scale(S::constant(0.5 / self.dt), sub(ahead, behind))
    }

    /// The same path as a reference for controllers, with a yaw.
    pub fn reference(&self, goal: &[f64], yaw: f64) -> Lemniscate {
        let g: [f64; PATH] = goal.array(0);
        Lemniscate {
            rate: g[4],
            scale: [g[1], g[2], g[3]],
            vertical: g[0],
            rotation: g[6].atan2(g[5]),
            origin: self.own.path.origin,
            yaw,
            ahead: g[AHEAD_BY] * self.dt,
        }
    }
}
