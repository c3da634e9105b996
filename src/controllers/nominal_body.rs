//! A body under its rotors, as a controller believes it to move: what the motion is compared with.

use super::kinematics::Kinematics;
use super::parameters::{BodyModel, rotor_resistances};
use autodiff::Scalar;
use base::error::{Error, Result};
use dynamics::spatial::{Mat3, add, constants, cross, hadamard, mat_vec, rotate, rotate_back, scale, sub};
use dynamics::{MAX_ROTORS, Vehicle};
use nalgebra::{Matrix3, Vector3};

/// A body under its rotors, as it is believed to be.
#[derive(Debug, Clone)]
pub(super) struct NominalBody {
    body: BodyModel<f64>,
    inverse_inertia: Mat3<f64>,
    /// D_ω of airframe and rotors at hover, N m s.
    angular_drag: Mat3<f64>,
    /// [F_z, M_x, M_y, M_z] of one newton per rotor.
    effect: Vec<[f64; 4]>,
    max_thrust: Vec<f64>,
}

impl NominalBody {
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

    /// The body alone.
    #[inline]
    pub(super) fn body<S: Scalar>(&self) -> BodyModel<S> {
        BodyModel::constant(&self.body)
    }

    /// J⁻¹, 1/(kg m²).
    #[inline]
    pub(super) fn inverse_inertia<S: Scalar>(&self) -> Mat3<S> {
        self.inverse_inertia.map(constants)
    }

    /// [F_z, M] of the rotors' thrusts, N.
    pub(super) fn wrench<S: Scalar>(&self, thrust: impl Fn(usize) -> S) -> [S; 4] {
        let mut wrench = [S::zero(); 4];
        for i in 0..self.effect.len().min(MAX_ROTORS) {
            let thrust = thrust(i);
            for k in 0..4 {
                wrench[k] = S::constant(self.effect[i][k]).mul_add(thrust, wrench[k]);
            }
        }
        wrench
    }

    /// The wrench of rotor actions.
    #[inline]
    pub(super) fn wrench_of_actions<S: Scalar>(&self, actions: &[S]) -> [S; 4] {
        self.wrench(|i| S::constant(0.5 * self.max_thrust[i]) * (actions[i] + S::one()))
    }

    /// v̇ (world) and ω̇ (body) under a wrench [F_z, M] of the rotors.
    pub(super) fn acceleration<S: Scalar>(&self, state: &Kinematics<S>, rotors: [S; 4]) -> [S; 6] {
        let body = self.body::<S>();
        let (q, w) = (state.attitude, state.angular_velocity);
        let v = rotate_back(q, state.velocity);
        let mut force = scale(-S::one(), hadamard(body.drag, v));
        force[2] += rotors[0];
        let mut gained = rotate(q, scale(body.mass.recip(), force));
        gained[2] -= body.gravity;
        let resistance = add(mat_vec(body.drag_moment, v), mat_vec(self.angular_drag.map(constants), w));
        let moment = sub([rotors[1], rotors[2], rotors[3]], resistance);
        let moment = sub(moment, cross(w, mat_vec(body.inertia, w)));
        let turned = mat_vec(self.inverse_inertia(), moment);
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
