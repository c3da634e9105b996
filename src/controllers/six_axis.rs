//! Six axes at once: a wrench for a pose whose attitude does not depend on the force.
//!
//! ```text
//! position ─▶ velocity command ─▶ f = a_ref + K_v (v_cmd − v) + g e_z ─▶ F = m Rᵀf
//! attitude ─▶ rate command     ─▶ M = K_ω (ω_cmd − ω) + ω × Jω + J α_ff
//! ```
//!
//! The levels are those of the cascade ([`position`](super::position), [`velocity`](super::velocity),
//! [`attitude`](super::attitude), [`rate`](super::rate)); only the link between them is cut: the force does not choose the
//! attitude. All about the centre of mass, whose motion `state` gives; axes of the body.

use super::attitude::{Orientation, rate_command};
use super::kinematics::Kinematics;
use super::parameters::{BodyModel, ForceLimits, GainSet};
use super::position::{add_drag, velocity_command};
use super::rate::{RateCommand, moment};
use super::reference::Setpoint;
use super::velocity::{VelocityCommand, limit_force, specific_force};
use autodiff::Scalar;
use dynamics::spatial::{Vec3, add, mat_vec, rotate_back, scale};

/// `[force; moment]` at the centre of mass, body axes, N and N m.
pub type Wrench<S> = [S; 6];

/// The parameters of the law, and its entry points.
///
/// Each entry computes its level and those below at once. Who computes levels at different rates calls
/// [`force`](Self::force), `rate_command` and [`rate`](Self::rate) one by one and holds what they said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SixAxis<S> {
    /// Mass, inertia, drag, gravity.
    pub body: BodyModel<S>,
    /// Per level and axis.
    pub gains: GainSet<S>,
    /// Of the force: its least vertical part keeps its direction defined. `thrust` plays no part.
    pub limits: ForceLimits<S>,
}

impl<S: Scalar> SixAxis<S> {
    /// The wanted force without gravity's help, world, N: limited, height before direction.
    pub fn force(&self, state: &Kinematics<S>, command: &VelocityCommand<S>) -> Vec3<S> {
        let wanted = [command.velocity, command.acceleration, command.jerk];
        let command = add_drag(&self.body, state, wanted, command);
        let f = specific_force(&self.gains, self.body.gravity, &command, state.velocity);
        let limits = &self.limits;
        let largest = limits.force * self.body.mass.recip();
        let vertical = [limits.vertical, limits.ceiling * largest];
        scale(self.body.mass, limit_force(f, limits.tilt_tangent, vertical, largest))
    }

    /// Enters with a pose: a sample of a reference (its yaw plays no part) and an orientation.
    #[inline]
    pub fn position(&self, state: &Kinematics<S>, sample: &Setpoint<S>, orientation: &Orientation<S>) -> Wrench<S> {
        self.velocity(state, &velocity_command(&self.gains, sample, state), orientation)
    }

    /// Enters with a velocity (its yaw plays no part) and an orientation. Drag at the wanted velocity is fed forward.
    pub fn velocity(
        &self,
        state: &Kinematics<S>,
        command: &VelocityCommand<S>,
        orientation: &Orientation<S>,
    ) -> Wrench<S> {
        self.attitude(state, self.force(state, command), orientation)
    }

    /// Enters with a force (world, N) and an orientation.
    #[inline]
    pub fn attitude(&self, state: &Kinematics<S>, force: Vec3<S>, orientation: &Orientation<S>) -> Wrench<S> {
        let command = orientation.with_thrust(S::zero());
        let rate = rate_command(&self.gains, &command, state.attitude, state.angular_velocity);
        self.rate(state, rotate_back(state.attitude, force), &rate)
    }

    /// Enters with a force (body, N) and body rates; the thrust of the command plays no part.
    #[inline]
    pub fn rate(&self, state: &Kinematics<S>, force: Vec3<S>, command: &RateCommand<S>) -> Wrench<S> {
        let m = moment(&self.gains, self.body.inertia, command, state.angular_velocity);
        let m = add(m, mat_vec(self.body.drag_moment, rotate_back(state.attitude, state.velocity)));
        [force[0], force[1], force[2], m[0], m[1], m[2]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cascade::tests::hummingbird;
    use crate::parameters::CommandLimits;
    use crate::reference::{Reference, Tilt};
    use dynamics::spatial::{from_euler, inverse, mat_mul, matrix, rotate, sub, transpose};

    fn law() -> SixAxis<f64> {
        let vehicle = hummingbird();
        SixAxis {
            body: BodyModel { drag: [0.0; 3], drag_moment: [[0.0; 3]; 3], ..BodyModel::of(&vehicle) },
            gains: GainSet::constant(&vehicle.derived_gains()),
            limits: ForceLimits::constant(&CommandLimits::default(), 30.0, 0.0),
        }
    }

    /// On the reference, with its velocities.
    fn on(reference: &Reference, tilt: &Tilt, t: f64) -> (Kinematics<f64>, Setpoint<f64>, Orientation<f64>) {
        let (sample, wanted) = (reference.sample(t), tilt.orientation(reference, t));
        let attitude = dynamics::spatial::from_matrix(wanted.attitude);
        let state = Kinematics {
            position: sample.position,
            velocity: sample.velocity,
            attitude,
            angular_velocity: wanted.angular_velocity,
        };
        (state, sample, wanted)
    }

    #[test]
    fn on_the_reference_the_wrench_is_what_the_motion_needs() {
        let (law, tilt) = (law(), Tilt { roll: 0.8, pitch: 0.4, at: 0.5, ramp: 1.2 });
        let reference = Reference::by_name("lemniscate").unwrap();
        let mut worst = 0.0_f64;
        for t in [0.3, 0.9, 1.3, 2.7] {
            let (state, sample, wanted) = on(&reference, &tilt, t);
            let wrench = law.position(&state, &sample, &wanted);
            let f = scale(law.body.mass, add(sample.acceleration, [0.0, 0.0, law.body.gravity]));
            let force = rotate(state.attitude, [wrench[0], wrench[1], wrench[2]]);
            let j = law.body.inertia;
            let w = wanted.angular_velocity;
            let euler = sub([wrench[3], wrench[4], wrench[5]], dynamics::spatial::cross(w, mat_vec(j, w)));
            let alpha = mat_vec(inverse(j), euler);
            for i in 0..3 {
                worst = worst.max((force[i] - f[i]).abs()).max((alpha[i] - wanted.angular_acceleration[i]).abs());
            }
        }
        println!("worst {worst:.1e}");
        // measured: 2.1e-14
        assert!(worst < 1e-12, "{worst:e}");
    }

    #[test]
    fn force_and_attitude_do_not_know_of_each_other() {
        let law = law();
        let state = Kinematics { attitude: from_euler(0.3, -0.2, 0.9), ..Kinematics::at_rest([0.0; 3]) };
        let command = VelocityCommand::constant([0.4, -0.2, 0.1], 0.0);
        let [a, b] = [(0.0, 0.0), (1.2, -0.5)].map(|(roll, pitch)| {
            let orientation = Orientation::at_rest(matrix(from_euler(roll, pitch, 0.0)));
            law.velocity(&state, &command, &orientation)
        });
        assert_eq!(a[..3], b[..3]);
        assert!((a[3] - b[3]).abs() > 0.1, "{a:?} {b:?}");
        // every level of entry leads to the same wrench
        let orientation = Orientation::at_rest(mat_mul(transpose(matrix(state.attitude)), matrix(state.attitude)));
        let sample = Setpoint { velocity: [0.4, -0.2, 0.1], ..Setpoint::at_rest([0.0; 3], 0.0) };
        let force = law.force(&state, &command);
        let lower = law.attitude(&state, force, &orientation);
        assert_eq!(law.position(&state, &sample, &orientation), lower);
        assert_eq!(law.velocity(&state, &command, &orientation), lower);
    }
}
