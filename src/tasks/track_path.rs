//! The lemniscate that Track tasks follow, drawn anew for every episode.
//!
//! p_ref(k) = origin + R_z(ψ) (S ∘ L(π/2 + τ(w k dt); c)), see [`Lemniscate`].
//!
//! - DIFFERENCE: scaled before it is rotated, so a rotated curve is not sheared (defect 21).
//! - DIFFERENCE: starts are on the scaled curve; published ones miss it by up to 0.18 m (defect 21).

use super::declare::Writer;
use super::task::Start;
use crate::autodiff::{Scalar, StridedView};
use crate::controllers::reference::{Lemniscate, lemniscate_curve, lemniscate_phase};
use crate::dynamics::spatial::{Vec3, scale, sub};
use crate::settings;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Numbers of a path among a goal's.
pub const PATH: usize = 7;
/// Steps between look-ahead points.
pub const AHEAD: usize = 5;

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
    range: PathRange,
    /// Seconds per step.
    dt: f64,
}

impl TrackPath {
    /// With steps of `dt` seconds.
    pub fn new(range: &PathRange, dt: f64) -> Self {
        Self { range: range.clone(), dt }
    }

    /// Middle of the path, m, world.
    pub fn origin(&self) -> [f64; 3] {
        self.range.origin
    }

    /// Draws a path into the goal; returns where it starts.
    pub fn draw(&self, start: &mut Start<'_>) -> Vec3<f64> {
        let (r, range) = (&mut start.task, &self.range);
        let vertical = r.uniform(-range.vertical, range.vertical);
        let scale = range.scale.map(|[low, high]| r.uniform(low, high));
        let sign = if r.unit() < 0.5 { -1.0 } else { 1.0 };
        let rate = sign * r.uniform(range.rate[0], range.rate[1]);
        let rotation = r.uniform(0.0, TAU);
        let (goal, turn) = (&mut start.goal, [rotation.cos(), rotation.sin()]);
        goal.field("path_vertical", "-", "c").number(vertical);
        goal.field("path_scale", "m", "S").array(scale);
        goal.field("path_rate", "rad/s", "w").number(rate);
        goal.field("path_rotation", "-", "(cos ψ, sin ψ)").within(-1.0, 1.0).array(turn);
        let numbers = [vertical, scale[0], scale[1], scale[2], rate, turn[0], turn[1]];
        self.at(&StridedView::of(&numbers), 0.0)
    }

    /// p_ref(k + 5i) − `position` for `points` points from i = 0 on.
    #[inline(always)]
    pub fn observe<S: Scalar>(
        &self,
        goal: &StridedView<'_, S>,
        step: S,
        points: usize,
        position: Vec3<S>,
        out: &mut impl Writer<S>,
    ) {
        for i in 0..points {
            out.array(sub(self.at(goal, step + S::constant((AHEAD * i) as f64)), position));
        }
    }

    /// p_ref at step k of the path in `goal`, whose numbers begin at 0.
    #[inline(always)]
    pub fn at<S: Scalar>(&self, goal: &StridedView<'_, S>, step: S) -> Vec3<S> {
        let time = step * S::constant(self.dt);
        let phase = S::constant(FRAC_PI_2) + lemniscate_phase(goal.get(4), time);
        let curve = lemniscate_curve(phase, goal.get(0));
        let (x, y) = (goal.get(1) * curve[0], goal.get(2) * curve[1]);
        let (c, s) = (goal.get(5), goal.get(6));
        [
            S::constant(self.range.origin[0]) + c.mul_add(x, -(s * y)),
            S::constant(self.range.origin[1]) + s.mul_add(x, c * y),
            S::constant(self.range.origin[2]) + goal.get(3) * curve[2],
        ]
    }

    /// dp_ref/dt at step k, by central differences over two steps.
    #[inline(always)]
    pub fn velocity<S: Scalar>(&self, goal: &StridedView<'_, S>, step: S) -> Vec3<S> {
        let ahead = self.at(goal, step + S::one());
        let behind = self.at(goal, step - S::one());
        scale(S::constant(0.5 / self.dt), sub(ahead, behind))
    }

    /// The same path as a reference for controllers, with a yaw.
    pub fn reference(&self, goal: &StridedView<'_, f64>, yaw: f64) -> Lemniscate {
        let g: [f64; PATH] = goal.array(0);
        Lemniscate {
            rate: g[4],
            scale: [g[1], g[2], g[3]],
            vertical: g[0],
            rotation: g[6].atan2(g[5]),
            origin: self.range.origin,
            yaw,
        }
    }
}
