//! The lemniscate that Track tasks follow, drawn anew for every episode.
//!
//! p_ref(k) = origin + R_z(ψ) (S ∘ L(π/2 + τ(w k dt); c)), see [`Lemniscate`].
//!
//! - DIFFERENCE: scaled before it is rotated, so a rotated curve is not sheared (defect 21).
//! - DIFFERENCE: starts are on the scaled curve; published ones miss it by up to 0.18 m (defect 21).

use super::sheet::Slice;
use super::task::Start;
use crate::autodiff::{Rows, Scalar};
use crate::controllers::reference::{Lemniscate, lemniscate_curve, lemniscate_phase};
use crate::dynamics::spatial::{Vec3, scale, sub};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Numbers of a path among a goal's.
pub const PATH: usize = 7;
/// Steps between look-ahead points.
pub const AHEAD: usize = 5;

/// Where the numbers of a path are drawn from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Path {
    /// c, uniform within ± this.
    pub vertical: f64,
    /// S, per axis, lowest and highest, m.
    pub scale: [[f64; 3]; 2],
    /// |w|, rad/s; either sign.
    pub rate: [f64; 2],
    /// m, world.
    pub origin: [f64; 3],
    /// Seconds per step.
    pub dt: f64,
}

impl Path {
    /// What it keeps in the goal.
    pub fn slices() -> Vec<Slice> {
        vec![
            Slice::new("path_vertical", 1, "-", "c"),
            Slice::new("path_scale", 3, "m", "S"),
            Slice::new("path_rate", 1, "rad/s", "w"),
            Slice::new("path_rotation", 2, "-", "(cos ψ, sin ψ)"),
        ]
    }

    /// Draws a path into the goal from `first` on; returns where it starts.
    pub fn draw(&self, start: &mut Start<'_>, first: usize) -> Vec3<f64> {
        let r = &mut start.task;
        let vertical = r.uniform(-self.vertical, self.vertical);
        let scale = [0, 1, 2].map(|i| r.uniform(self.scale[0][i], self.scale[1][i]));
        let sign = if r.unit() < 0.5 { -1.0 } else { 1.0 };
        let rate = sign * r.uniform(self.rate[0], self.rate[1]);
        let rotation = r.uniform(0.0, TAU);
        let numbers = [vertical, scale[0], scale[1], scale[2], rate, rotation.cos(), rotation.sin()];
        start.goal[first..first + PATH].copy_from_slice(&numbers);
        self.at(&Rows::of(&start.goal[first..]), 0.0)
    }

    /// p_ref at step k of the path in `goal`, whose numbers begin at 0.
    #[inline(always)]
    pub fn at<S: Scalar>(&self, goal: &Rows<'_, S>, step: S) -> Vec3<S> {
        let time = step * S::constant(self.dt);
        let phase = S::constant(FRAC_PI_2) + lemniscate_phase(goal.get(4), time);
        let curve = lemniscate_curve(phase, goal.get(0));
        let (x, y) = (goal.get(1) * curve[0], goal.get(2) * curve[1]);
        let (c, s) = (goal.get(5), goal.get(6));
        [
            S::constant(self.origin[0]) + c.mul_add(x, -(s * y)),
            S::constant(self.origin[1]) + s.mul_add(x, c * y),
            S::constant(self.origin[2]) + goal.get(3) * curve[2],
        ]
    }

    /// dp_ref/dt at step k, by central differences over two steps.
    #[inline(always)]
    pub fn velocity<S: Scalar>(&self, goal: &Rows<'_, S>, step: S) -> Vec3<S> {
        let ahead = self.at(goal, step + S::one());
        let behind = self.at(goal, step - S::one());
        scale(S::constant(0.5 / self.dt), sub(ahead, behind))
    }

    /// The same path as a reference for controllers, with a yaw.
    pub fn reference(&self, goal: &Rows<'_, f64>, yaw: f64) -> Lemniscate {
        let g: [f64; PATH] = goal.array(0);
        Lemniscate {
            rate: g[4],
            scale: [g[1], g[2], g[3]],
            vertical: g[0],
            rotation: g[6].atan2(g[5]),
            origin: self.origin,
            yaw,
        }
    }
}
