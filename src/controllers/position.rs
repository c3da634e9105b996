//! Position level: position error → velocity command.

use super::kinematics::Kinematics;
use super::parameters::{BodyModel, GainSet};
use super::reference::Setpoint;
use super::velocity::VelocityCommand;
use crate::autodiff::{Scalar, safe};
use crate::dynamics::spatial::{Vec3, add, hadamard, rotate, rotate_back, scale, sub};

/// Floor under velocity gains the position level divides by, 1/s.
const GAIN_FLOOR: f64 = 1e-9;

/// v_cmd = v_ref + (K_p/K_v)(p_ref − p), world: with the velocity level, a = a_ref + K_p e_p + K_v e_v exactly.
///
/// Acceleration, jerk, snap and yaw pass through.
#[inline(always)]
pub fn velocity_command<S: Scalar>(
    gains: &GainSet<S>,
    sample: &Setpoint<S>,
    state: &Kinematics<S>,
) -> VelocityCommand<S> {
    let error = sub(sample.position, state.position);
    let mut velocity = sample.velocity;
    for i in 0..3 {
        let ratio = safe::div(gains.position[i], gains.velocity[i], GAIN_FLOOR);
        velocity[i] = ratio.mul_add(error[i], velocity[i]);
    }
    VelocityCommand { velocity, ..VelocityCommand::along(sample) }
}

/// Adds the force that balances linear drag at the wanted velocity: a += R D Rᵀ v/m, and to jerk and snap the same
/// map of v̇ and v̈, with R taken as constant. World; v, v̇, v̈ are the reference's, so that errors are not fed forward.
///
/// Source: Faessler, Franchi, Scaramuzza 2018 (rotor drag is part of the flat output map); first order, R measured.
#[inline(always)]
pub(crate) fn add_drag<S: Scalar>(
    body: &BodyModel<S>,
    state: &Kinematics<S>,
    derivatives: [Vec3<S>; 3],
    command: &VelocityCommand<S>,
) -> VelocityCommand<S> {
    let per_mass = scale(body.mass.recip(), body.drag);
    let mut sum = *command;
    let q = state.attitude;
    sum.acceleration = add(sum.acceleration, rotate(q, hadamard(per_mass, rotate_back(q, derivatives[0]))));
    sum.jerk = add(sum.jerk, rotate(q, hadamard(per_mass, rotate_back(q, derivatives[1]))));
    sum.snap = add(sum.snap, rotate(q, hadamard(per_mass, rotate_back(q, derivatives[2]))));
    sum
}
