//! Position level: position error → velocity command.

use super::attitude::Orientation;
use super::kinematics::Kinematics;
use super::parameters::{BodyModel, GainSet};
use super::reference::Setpoint;
use super::velocity::{VelocityCommand, desired_attitude};
use autodiff::{Scalar, safe};
use dynamics::spatial::{Vec3, add, cross, from_matrix, hadamard, identity, mat_vec, rotate, rotate_back, scale, sub};

/// Floor under velocity gains the position level divides by, 1/s.
const GAIN_FLOOR: f64 = 1e-9;

/// v_cmd = v_ref + (K_p/K_v)(p_ref − p), world: with the velocity level, a = a_ref + K_p e_p + K_v e_v exactly.
///
/// Acceleration, jerk, snap and yaw pass through.
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

/// [T, M] that fly a reference without error, linear drag included.
pub fn flat_wrench(body: &BodyModel<f64>, sample: &Setpoint<f64>) -> [f64; 4] {
    flat_command(body, sample).1
}

/// Attitude, rates and [T, M] that fly a reference without error, linear drag included.
pub(crate) fn flat_command(body: &BodyModel<f64>, sample: &Setpoint<f64>) -> (Orientation<f64>, [f64; 4]) {
    let mut state = Kinematics { attitude: identity(), ..Kinematics::at_rest(sample.position) };
    let mut wanted = Orientation::at_rest([[0.0; 3]; 3]);
    let mut thrust = 0.0;
    // drag depends on the attitude that it changes a little
    for _ in 0..8 {
        let derivatives = [sample.velocity, sample.acceleration, sample.jerk];
        let command = add_drag(body, &state, derivatives, &VelocityCommand::along(sample));
        let mut force = command.acceleration;
        force[2] += body.gravity;
        wanted = Orientation::of_series(desired_attitude(command.force_series(force), command.yaw_series()));
        state.attitude = from_matrix(wanted.attitude);
        thrust = body.mass * force.iter().map(|f| f * f).sum::<f64>().sqrt();
    }
    let w = wanted.angular_velocity;
    let moment = add(mat_vec(body.inertia, wanted.angular_acceleration), cross(w, mat_vec(body.inertia, w)));
    (wanted, [thrust, moment[0], moment[1], moment[2]])
}
