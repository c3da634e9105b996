//! The motion and the inputs with which a plant follows a reference without error: what a plan is compared with.

use super::planned_plant::{PlannedInput, PlannedPlant};
use crate::allocation::Mixer;
use crate::cascade_law::with_drag_of;
use crate::controller::Target;
use crate::kinematics::Kinematics;
use crate::parameters::BodyModel;
use crate::position::flat_command;
use crate::reference::Setpoint;
use base::error::Result;
use dynamics::spatial::{from_matrix, multiply, rotate, rotate_back};
use dynamics::{MAX_ROTORS, Plant};

/// Specific force below which its direction says nothing, m/s².
const FREE_FALL: f64 = 2.0;

/// What pushes a root from outside: force (N, world) and moment (N m, body).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Push {
    pub(super) force: [f64; 3],
    pub(super) moment: [f64; 3],
}

/// Of a rigid vehicle by differential flatness with linear drag; of other plants at the heading of the reference with the tilt beside it, with
/// the inputs of hover.
#[derive(Debug, Clone)]
pub(super) struct FlatMotion {
    vehicle: Option<FlatVehicle>,
    hover: Vec<f64>,
    /// Body → world in hover at yaw 0.
    attitude: [f64; 4],
}

#[derive(Debug, Clone)]
struct FlatVehicle {
    body: BodyModel<f64>,
    mixer: [[f64; 4]; MAX_ROTORS],
    max_thrust: Vec<f64>,
    input: PlannedInput,
    lower: Vec<f64>,
    upper: Vec<f64>,
}

impl FlatMotion {
    /// Of a plant.
    ///
    /// # Errors
    /// As [`Mixer::new`] and [`Plant::hover_state`].
    pub(super) fn new(plant: &PlannedPlant) -> Result<Self> {
        let (state, hover) = plant.hover()?;
        let attitude = [state[6], state[7], state[8], state[9]];
        let vehicle = match plant.plant() {
            Plant::Tree(_) => None,
            Plant::Rigid(m) => {
                let vehicle = with_drag_of(m.vehicle(), m.physics().effects).upright();
                let (lower, upper) = plant.bounds();
                Some(FlatVehicle {
                    body: BodyModel::of(&vehicle),
                    mixer: Mixer::new(&vehicle)?.carrying(&vehicle).padded()?,
                    max_thrust: vehicle.rotors.iter().map(|r| r.max_thrust()).collect(),
                    input: plant.input(),
                    lower,
                    upper,
                })
            }
        };
        Ok(Self { vehicle, hover, attitude })
    }

    /// The attitude of hover at the heading of a sample.
    fn upright(&self, sample: &Setpoint<f64>) -> [f64; 4] {
        let (s, c) = (0.5 * sample.yaw).sin_cos();
        multiply([c, 0.0, 0.0, s], self.attitude)
    }

    /// Motion of the root's attitude and rates with position and velocity of the reference, and the inputs; a rigid vehicle leans against
    /// what pushes it. Near free fall, where the map has no attitude, it is the one `before`.
    pub(super) fn at(
        &self,
        target: Target<'_>,
        time: f64,
        push: &Push,
        before: Option<[f64; 4]>,
        inputs: &mut [f64],
    ) -> Kinematics<f64> {
        let sample = &target.sample(time);
        let mut motion = Kinematics {
            velocity: sample.velocity,
            attitude: self.upright(sample),
            ..Kinematics::at_rest(sample.position)
        };
        motion.angular_velocity = rotate_back(motion.attitude, [0.0, 0.0, sample.yaw_rate]);
        inputs.copy_from_slice(&self.hover);
        let Some(own) = &self.vehicle else {
            let wanted = target.orientation(time);
            motion.attitude = multiply(from_matrix(wanted.attitude), self.attitude);
            motion.angular_velocity = rotate_back(self.attitude, wanted.angular_velocity);
            return motion;
        };
        let acceleration = [0, 1, 2].map(|k| sample.acceleration[k] - push.force[k] / own.body.mass);
        let (orientation, mut wrench) = flat_command(&own.body, &Setpoint { acceleration, ..*sample });
        let moment = rotate(self.attitude, push.moment);
        (0..3).for_each(|k| wrench[1 + k] -= moment[k]);
        let attitude = multiply(from_matrix(orientation.attitude), self.attitude);
        let rates = rotate_back(self.attitude, orientation.angular_velocity);
        if wrench[0] < FREE_FALL * own.body.mass {
            motion.attitude = before.unwrap_or(motion.attitude);
            motion.angular_velocity = [0.0; 3];
            inputs.copy_from_slice(&own.lower);
            return motion;
        }
        // not for a force along the heading
        if attitude.iter().chain(&rates).chain(&wrench).all(|x| x.is_finite()) {
            (motion.attitude, motion.angular_velocity) = (attitude, rates);
            for (i, input) in inputs.iter_mut().enumerate() {
                let thrust: f64 = own.mixer[i].iter().zip(wrench).map(|(p, w)| p * w).sum();
                let share = (thrust / own.max_thrust[i]).clamp(0.0, 1.0);
                let wanted = match own.input {
                    PlannedInput::Speed => share.sqrt(),
                    PlannedInput::Thrust => share * own.max_thrust[i],
                };
                *input = wanted.max(own.lower[i]).min(own.upper[i]);
            }
        }
        motion
    }
}
