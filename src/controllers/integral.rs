//! Integral action: the accelerations that the believed body misses, learnt from its motion and taken off what is asked.
//!
//! Told the rotor thrusts T, the body is believed to move by
//!
//! ```text
//! v̇ = R e_z F/m − g e_z − R D Rᵀ v/m        ω̇ = J⁻¹(M − C Rᵀ v − D_ω ω − ω × Jω)        [F, M] = B T
//! ```
//!
//! What it gained in a period P of the rate level beyond P·(v̇, ω̇), divided by P, is missing: wind, mass, a shifted centre of
//! mass, weak rotors. Its estimate d̂ follows at the rate L, d̂⁺ = d̂ + (1 − e^(−LP))(d − d̂), and the velocity and rate levels
//! ask for d̂ less.
//!
//! - With perfect motors the poles of the loop are those of the PD gains and −L beside them: what is missing decays as
//!   s/(s + L), and a reference that is flown well leaves nothing to learn. Above an ideal attitude loop this is the PID with
//!   K_i = L K_p, K_p' = K_p + L K_v and K_v' = K_v + L.
//! - T is what the rotors were told **after** clipping, so that nothing winds up while they are at a limit.
//!
//! Source: Ohnishi, Shibata and Murakami 1996 (disturbance observers of motion control); the automatic reset of
//! Åström and Hägglund 2006, section 3.5.

use super::kinematics::Kinematics;
use super::parameters::{BodyModel, rotor_resistances};
use crate::autodiff::Scalar;
use crate::dynamics::spatial::{Mat3, add, cross, hadamard, mat_vec, rotate, rotate_back, scale, sub};
use crate::dynamics::{MAX_ROTORS, Vehicle};
use crate::error::{Error, Result};
use nalgebra::{Matrix3, Vector3};

/// A body under its rotors, as it is believed to be.
#[derive(Debug, Clone)]
pub(super) struct Believed {
    body: BodyModel<f64>,
    inverse_inertia: Mat3<f64>,
    /// D_ω of airframe and rotors at hover, N m s.
    angular_drag: Mat3<f64>,
    /// [F_z, M_x, M_y, M_z] of one newton per rotor.
    effect: Vec<[f64; 4]>,
    max_thrust: Vec<f64>,
}

impl Believed {
    /// # Errors
    /// [`Error::Value`] where the inertia has no inverse.
    pub(super) fn new(vehicle: &Vehicle) -> Result<Self> {
        let inverse = vehicle.mass_properties().inertia.try_inverse().ok_or_else(|| {
            let what = format!("vehicle '{}': inertia", vehicle.name);
            Error::value(what, "singular", "invertible", "Give every axis an inertia above zero.")
        })?;
        let rows = |m: Matrix3<f64>| [0, 1, 2].map(|row| [m[(row, 0)], m[(row, 1)], m[(row, 2)]]);
        let b = vehicle.allocation_matrix();
        Ok(Self {
            body: BodyModel::of(vehicle),
            inverse_inertia: rows(inverse),
            angular_drag: rows(angular_drag(vehicle)),
            effect: b.column_iter().map(|c| [c[2], c[3], c[4], c[5]]).collect(),
            max_thrust: vehicle.rotors.iter().map(|r| r.max_thrust()).collect(),
        })
    }

    /// v̇ (world) and ω̇ (body) under rotor actions.
    #[inline(always)]
    fn acceleration<S: Scalar>(&self, state: &Kinematics<S>, actions: &[S]) -> [S; 6] {
        let mut wrench = [S::zero(); 4];
        for i in 0..self.effect.len().min(MAX_ROTORS) {
            let thrust = S::constant(0.5 * self.max_thrust[i]) * (actions[i] + S::one());
            for k in 0..4 {
                wrench[k] = S::constant(self.effect[i][k]).mul_add(thrust, wrench[k]);
            }
        }
        let body = BodyModel::<S>::constant(&self.body);
        let (q, w) = (state.attitude, state.angular_velocity);
        let v = rotate_back(q, state.velocity);
        let mut force = scale(-S::one(), hadamard(body.drag, v));
        force[2] += wrench[0];
        let mut gained = rotate(q, scale(body.mass.recip(), force));
        gained[2] -= body.gravity;
        let resistance =
            add(mat_vec(body.drag_moment, v), mat_vec(self.angular_drag.map(|row| row.map(S::constant)), w));
        let moment = sub([wrench[1], wrench[2], wrench[3]], resistance);
        let moment = sub(moment, cross(w, mat_vec(body.inertia, w)));
        let inverse = self.inverse_inertia.map(|row| row.map(S::constant));
        let turned = mat_vec(inverse, moment);
        [gained[0], gained[1], gained[2], turned[0], turned[1], turned[2]]
    }
}

/// D_ω = diag(airframe) − Σ [r − c]× K [r − c]×, K the resistance of a rotor at hover.
fn angular_drag(vehicle: &Vehicle) -> Matrix3<f64> {
    let airframe = Matrix3::from_diagonal(&vehicle.drag.angular.into());
    let center = vehicle.mass_properties().center_of_mass;
    rotor_resistances(vehicle).fold(airframe, |sum, (rotor, resistance)| {
        let lever = (Vector3::from(rotor.position) - center).cross_matrix();
        sum - lever * resistance * lever
    })
}

/// The memory of integral action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Missing<S> {
    /// Velocity (world) and angular velocity (body) as they should be at the next tick.
    expected: [S; 6],
    /// d̂: of v̇ (world, m/s²) and ω̇ (body, rad/s²).
    pub(super) estimate: [S; 6],
    /// 0 before the first tick, when there is nothing to compare with.
    started: S,
}

impl<S: Scalar> Missing<S> {
    /// Numbers in the flat form: what is expected, what is missing, whether it has begun.
    pub(super) const DIM: usize = 13;

    #[inline(always)]
    pub(super) fn read(x: &[S]) -> Self {
        let (mut expected, mut estimate) = ([S::zero(); 6], [S::zero(); 6]);
        for k in 0..6 {
            (expected[k], estimate[k]) = (x[k], x[6 + k]);
        }
        Self { expected, estimate, started: x[12] }
    }

    #[inline(always)]
    pub(super) fn write(&self, out: &mut [S]) {
        for k in 0..6 {
            (out[k], out[6 + k]) = (self.expected[k], self.estimate[k]);
        }
        out[12] = self.started;
    }

    /// Compares where `tick` > ½: `rates` are L of force and moment, 1/s.
    #[inline(always)]
    pub(super) fn observe(&mut self, tick: S, state: &Kinematics<S>, rates: [S; 2], period: f64) {
        let due = S::constant(0.5).lt(tick * self.started);
        let per_period = S::constant(1.0 / period);
        for k in 0..6 {
            let now = if k < 3 { state.velocity[k] } else { state.angular_velocity[k - 3] };
            let share = S::one() - (rates[k / 3] * S::constant(-period)).exp();
            let fresh = (now - self.expected[k]) * per_period;
            let learnt = share.mul_add(fresh - self.estimate[k], self.estimate[k]);
            self.estimate[k] = S::select(due, learnt, self.estimate[k]);
        }
    }

    /// What is expected at the next tick, with the actions that the rotors are told now.
    #[inline(always)]
    pub(super) fn expect(&mut self, tick: S, state: &Kinematics<S>, believed: &Believed, actions: &[S], period: f64) {
        let due = S::constant(0.5).lt(tick);
        let gained = believed.acceleration(state, actions);
        for k in 0..6 {
            let now = if k < 3 { state.velocity[k] } else { state.angular_velocity[k - 3] };
            let next = gained[k].mul_add(S::constant(period), now);
            self.expected[k] = S::select(due, next, self.expected[k]);
        }
        self.started = S::one();
    }

    /// Of v̇, world, m/s².
    #[inline(always)]
    pub(super) fn acceleration(&self) -> [S; 3] {
        [self.estimate[0], self.estimate[1], self.estimate[2]]
    }

    /// Of ω̇, body, rad/s².
    #[inline(always)]
    pub(super) fn angular_acceleration(&self) -> [S; 3] {
        [self.estimate[3], self.estimate[4], self.estimate[5]]
    }
}
