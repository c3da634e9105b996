//! The lemniscate that Track tasks follow, drawn anew for every episode.
//!
//! p_ref(k) = origin + R_z(ψ) (S ∘ L(π/2 + τ(w (k + k₀) dt); c)), see [`Lemniscate`].
//!
//! - DIFFERENCE: scaled before it is rotated, so a rotated curve is not sheared (defect 21).
//! - DIFFERENCE: starts are on the scaled curve; published ones miss it by up to 0.18 m (defect 21).

use super::declare::Writer;
use super::start::{Draws, Start, eased};
use super::task::{TaskReference, View};
use crate::settings;
use autodiff::{Array, Jet, Scalar, Trace, safe};
use controllers::reference::{Lemniscate, Reference, lemniscate_curve, lemniscate_phase};
use dynamics::GRAVITY;
use dynamics::frame::Frame;
use dynamics::spatial::{Vec3, add, cross, from_euler, multiply, rotate_back, scale, sub, to_euler};
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

/// The whole number nearest to one from 0 to `most`, bit by bit.
fn nearest_whole(x: Trace, most: f64) -> Trace {
    let bits = ((most + 0.5).max(1.0).log2().floor() as i32).min(23);
    (0..=bits).rev().fold(Trace::zero(), |whole, bit| {
        let more = whole + 2.0_f64.powi(bit);
        Trace::select(x.lt(more - 0.5), whole, more)
    })
}

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
    pub fn draw(&self, start: &mut Start<'_>) -> Vec3<Trace> {
        let (r, range) = (&mut start.task, &self.own.path);
        let vertical = r.uniform(-range.vertical, range.vertical);
        let scale = range.scale.map(|[low, high]| r.uniform(low, high));
        let sign = Trace::select(r.unit().lt(0.5), (-1.0).into(), Trace::one());
        let rate = sign * r.uniform(range.rate[0], range.rate[1]) * eased(self.own.rate_ease, start.difficulty);
        let rotation = r.uniform(0.0, TAU);
        let ahead = if self.own.start_along > 0.0 { self.draw_ahead(r, rate) } else { Trace::zero() };
        let reset = eased(self.own.reset_ease, start.difficulty) * self.own.reset_distance;
        let (sin, cos) = rotation.sin_cos();
        let (goal, turn) = (&mut start.goal, [cos, sin]);
        goal.field("path_vertical", "-", "c").number(vertical);
        goal.field("path_scale", "m", "S").array(scale);
        goal.field("path_rate", "rad/s", "w").number(rate);
        goal.field("path_rotation", "-", "(cos ψ, sin ψ)").within(-1.0, 1.0).array(turn);
        goal.field("path_ahead", "steps", "that the path is ahead of k").number(ahead);
        goal.field("reset_distance", "m", "beyond which the episode ends").number(reset);
        let numbers = [vertical, scale[0], scale[1], scale[2], rate, turn[0], turn[1], ahead, reset];
        self.at(&numbers, Trace::zero())
    }

    /// In the share of episodes that begin along the path: anywhere in a lap, 2 s after its rest; else 0. Whole steps.
    fn draw_ahead(&self, r: &mut Draws<'_>, rate: Trace) -> Trace {
        let (along, lap) = (r.unit().lt(self.own.start_along), TAU / rate.abs());
        let ahead = r.uniform(2.0, 2.0 + lap);
        let slowest = self.own.path.rate[0] * self.own.rate_ease.min(1.0);
        let most = (2.0 + TAU / slowest) / self.dt;
        Trace::select(along, nearest_whole(ahead * (1.0 / self.dt), most), Trace::zero())
    }

    /// Whether an error is beyond the reset distance of the episode.
    pub fn far<S: Scalar>(&self, goal: &[S], error: Vec3<S>) -> S::Mask {
        goal[RESET].square().lt(safe::squared_norm(error))
    }

    /// Where the path of a goal whose numbers begin at `first` is ahead: gives the root of tree 0, placed with the attitude of a
    /// start, the velocity that leads a point on the path. Where `lever` is given the root leans as a body does that is held by
    /// its thrust along the path, the point `lever` below its origin along its axis (Peng et al. 2018: reference state
    /// initialisation). Derivatives of the path are exact here; [`velocity`](Self::velocity) is a difference, off by dt²/6 of the third.
    pub fn join(&self, start: &mut Start<'_>, first: usize, lever: Option<Trace>) {
        if self.own.start_along == 0.0 {
            return;
        }
        let (joins, before) = (start.goal[first + AHEAD_BY].gt(0.5), start.state.to_vec());
        self.give_motion(start, first, lever);
        start.state.iter_mut().zip(before).for_each(|(x, before)| *x = Trace::select(joins, *x, before));
    }

    fn give_motion(&self, start: &mut Start<'_>, first: usize, lever: Option<Trace>) {
        let [position, velocity, acceleration, jerk] = self.motion(&start.goal[first..]);
        let root = start.robot.roots()[0];
        start.state[root + 3..root + 6].copy_from_slice(&velocity);
        let Some(lever) = lever else { return };
        let mut force = [0, 1, 2].map(|i| Jet::from_derivatives([acceleration[i], jerk[i]]));
        force[2] += Jet::constant(GRAVITY);
        let direction = safe::normalise(force);
        let (up, up_rate) = (direction.map(|x| x.value()), direction.map(|x| x.derivative(1)));
        let pull = safe::norm(force.map(|x| x.value())) * (1.0 / GRAVITY);
        let own = Array::array(&*start.state, root + 6);
        let [_, _, yaw] = to_euler(start.robot.attitude_of_hover_axes(0, own));
        // the shortest turn from e_z to the lean, after the yaw
        let lean = safe::normalise([1.0 + up[2], -up[1], up[0], Trace::zero()]);
        let attitude = multiply(lean, from_euler(Trace::zero(), Trace::zero(), yaw));
        start.place(0, add(position, scale(lever, up)), attitude);
        start.state[root + 3..root + 6].copy_from_slice(&add(velocity, scale(lever, up_rate)));
        let rate = rotate_back(start.robot.attitude_of_body(0, attitude), cross(up, up_rate));
        start.state[root + 10..root + 13].copy_from_slice(&rate);
        for rotor in start.robot.drones().iter().flat_map(|d| &d.rotors) {
            start.state[rotor.speed] = (start.state[rotor.speed] * pull.sqrt()).min(rotor.max_speed.into());
        }
    }

    /// Where the path in `goal` begins, and its first three derivatives by time.
    fn motion(&self, goal: &[Trace]) -> [Vec3<Trace>; 4] {
        let goal: [Jet<Trace, 4>; PATH] = std::array::from_fn(|k| Jet::fixed(goal[k]));
        let along = self.at(&goal, Jet::variable(Trace::zero()));
        std::array::from_fn(|order| {
            let per_step = self.dt.powi(-(order as i32));
            along.map(|x| x.derivative(order) * per_step)
        })
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
