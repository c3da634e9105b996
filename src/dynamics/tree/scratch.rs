//! Memory of one evaluation: what each body and rotor holds between the passes.
//!
//! Lives on the stack of the caller in one of three sizes, so that a step allocates nothing whatever the scalar.

use super::model::{MAX_BODIES, MAX_TREE_ROTORS};
use super::topology::Topology;
use crate::rigid::Symmetric;
use crate::rotor::{Lag, RotorModel};
use crate::spatial::{Mat3, Vec3, Wrench};
use autodiff::Scalar;

/// Articulated inertia `[A B; Bᵀ D]`: (moment, force) about a point from the (angular, linear) acceleration of that
/// point; A and D are symmetric.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Articulated<S> {
    pub a: Symmetric<S>,
    pub b: Mat3<S>,
    pub d: Symmetric<S>,
}

impl<S: Scalar> Articulated<S> {
    #[inline]
    pub(crate) fn zero() -> Self {
        let o = S::zero();
        Self { a: [o; 6], b: [[o; 3]; 3], d: [o; 6] }
    }

    /// Another one, about the same point.
    pub(crate) fn add(&mut self, more: &Self) {
        for k in 0..6 {
            self.a[k] += more.a[k];
            self.d[k] += more.d[k];
        }
        for row in 0..3 {
            for column in 0..3 {
                self.b[row][column] += more.b[row][column];
            }
        }
    }
}

/// One body. All vectors along world axes; moments and velocities at the joint's origin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BodyScratch<S> {
    /// Body → world.
    pub rotation: Mat3<S>,
    /// Of the joint's origin.
    pub position: Vec3<S>,
    /// From the parent's origin.
    pub offset: Vec3<S>,
    pub velocity: Vec3<S>,
    pub angular_velocity: Vec3<S>,
    /// Joint axis of a hinge or slide.
    pub axis: Vec3<S>,
    /// Centre of mass from the origin.
    pub center: Vec3<S>,
    /// Outside force and moment.
    pub force: Vec3<S>,
    pub moment: Vec3<S>,
    /// Acceleration at zero joint acceleration, less the parent's.
    pub bias_angular: Vec3<S>,
    pub bias_linear: Vec3<S>,
    pub inertia: Articulated<S>,
    pub bias_force: Vec3<S>,
    pub bias_moment: Vec3<S>,
    /// Articulated inertia times the joint's axes: one column of a hinge or slide, three of a ball.
    pub column_moment: [Vec3<S>; 3],
    pub column_force: [Vec3<S>; 3],
    /// Inverse of what these give along the axes; its first entry for one axis.
    pub inverse: Symmetric<S>,
    /// Joint torque less the bias along the axes.
    pub torque: Vec3<S>,
    pub acceleration: Vec3<S>,
    pub angular_acceleration: Vec3<S>,
    /// Torque that the joint holds through a substep, and its slope against acceleration.
    pub held: (S, S),
    /// Net contact force.
    pub contact: Vec3<S>,
    /// Friction against what stands still, held through a substep; about the origin, world axes.
    pub grip: Wrench<S>,
    /// Σ μ F_n and Σ μ F_n u² of what grips it, u the slip over the slip speed.
    pub slip: [S; 2],
    /// Wakes of drones on the one at this body, or on this load, held through a substep.
    pub wake: Vec3<S>,
    /// Moment about the origin of wakes on a load.
    pub wake_moment: Vec3<S>,
}

impl<S: Scalar> BodyScratch<S> {
    fn blank() -> Self {
        let o = S::zero();
        let v = [o; 3];
        Self {
            rotation: [v; 3],
            position: v,
            offset: v,
            velocity: v,
            angular_velocity: v,
            axis: v,
            center: v,
            force: v,
            moment: v,
            bias_angular: v,
            bias_linear: v,
            inertia: Articulated::zero(),
            bias_force: v,
            bias_moment: v,
            column_moment: [v; 3],
            column_force: [v; 3],
            inverse: [o; 6],
            torque: v,
            acceleration: v,
            angular_acceleration: v,
            held: (o, o),
            contact: v,
            grip: Wrench { force: v, moment: v },
            slip: [o; 2],
            wake: v,
            wake_moment: v,
        }
    }
}

/// One rotor: its constants about the body's origin (body axes), and its speed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RotorScratch<S> {
    pub model: RotorModel<S>,
    /// Its target stands from the beginning of a step.
    pub lag: Lag<S>,
    /// In force during an evaluation.
    pub speed: S,
}

impl<S: Scalar> RotorScratch<S> {
    #[inline]
    fn blank() -> Self {
        let o = S::zero();
        // all zeros, which is the cheapest to write: small models leave most slots unused
        let model = RotorModel { max_speed: o, axis: [o; 3], ..RotorModel::dead() };
        Self { model, lag: Lag::none(), speed: o }
    }
}

/// Memory for up to B bodies, R rotors and X numbers of state or input.
pub(crate) struct Storage<S, const B: usize, const R: usize, const X: usize> {
    bodies: [BodyScratch<S>; B],
    rotors: [RotorScratch<S>; R],
    vectors: [[S; X]; 5],
}

/// Largest state: every body floating.
pub(crate) const MAX_STATE: usize = 13 * MAX_BODIES + MAX_TREE_ROTORS;

/// Memory for the largest model.
pub(crate) type Large<S> = Storage<S, MAX_BODIES, MAX_TREE_ROTORS, MAX_STATE>;
/// Memory for platforms, groups and Dragon.
pub(crate) type Medium<S> = Storage<S, 26, 32, 160>;
/// Memory for a drone with a load.
pub(crate) type Small<S> = Storage<S, 8, 16, 64>;

impl<S: Scalar, const B: usize, const R: usize, const X: usize> Storage<S, B, R, X> {
    #[inline]
    pub(crate) fn new() -> Self {
        Self { bodies: [BodyScratch::blank(); B], rotors: [RotorScratch::blank(); R], vectors: [[S::zero(); X]; 5] }
    }

    /// Whether a model has room.
    #[inline]
    pub(crate) fn fits(t: &Topology) -> bool {
        t.n_body() <= B && t.n_rotor() <= R && t.n_state <= X && t.n_input <= X
    }

    #[inline]
    pub(crate) fn view(&mut self) -> Scratch<'_, S> {
        let [input, start, at, rate, end] = &mut self.vectors;
        Scratch { bodies: &mut self.bodies, rotors: &mut self.rotors, input, start, at, rate, end }
    }
}

/// The memory of one evaluation, whatever its size.
pub(crate) struct Scratch<'a, S> {
    pub bodies: &'a mut [BodyScratch<S>],
    pub rotors: &'a mut [RotorScratch<S>],
    /// Input of a step.
    pub input: &'a mut [S],
    /// State before a substep.
    pub start: &'a mut [S],
    /// State of a stage.
    pub at: &'a mut [S],
    /// Its derivative.
    pub rate: &'a mut [S],
    /// State gathered over the stages.
    pub end: &'a mut [S],
}

/// A [`Scratch`] of the smallest size that has room for a topology, on the caller's stack.
macro_rules! scratch_on_stack {
    ($name:ident, $topology:expr, $scalar:ty) => {
        let (mut small, mut medium, mut large);
        #[allow(unused_mut)]
        let mut $name: $crate::tree::scratch::Scratch<'_, $scalar> =
            if $crate::tree::scratch::Small::<$scalar>::fits($topology) {
                small = $crate::tree::scratch::Small::<$scalar>::new();
                small.view()
            } else if $crate::tree::scratch::Medium::<$scalar>::fits($topology) {
                medium = $crate::tree::scratch::Medium::<$scalar>::new();
                medium.view()
            } else {
                large = $crate::tree::scratch::Large::<$scalar>::new();
                large.view()
            };
    };
}
pub(crate) use scratch_on_stack;
