//! What the rotors of an articulated system can do in its present shape.

use super::problem::WRENCH;
use dynamics::spatial::{Vec3, add, axpy, cross, mat_vec, rotate_back, scale, sub};
use dynamics::tree::{FrameKinematics, Motion, Multibody, body_poses, center_of_mass};
use nalgebra::DMatrix;

/// B, 6 × n: the wrench `[force; moment]` of each rotor per newton of its thrust, about the instantaneous centre of mass,
/// in the axes of the root: column i is [nᵢ; (rᵢ − c) × nᵢ − σᵢ κᵢ nᵢ] of the true places, tilts and spins.
///
/// B T is the rate at which thrusts T change linear and angular momentum of the whole system, whatever its joints do:
/// what acts within a tree changes neither.
///
/// # Panics
/// If the state is shorter than the layout says.
pub fn wrench_matrix(system: &Multibody, state: &[f64]) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(WRENCH, system.model().rotors().len());
    wrench_matrix_into(system, state, &body_poses(system, state), &mut matrix);
    matrix
}

/// As [`wrench_matrix`], with the poses of the state.
pub(crate) fn wrench_matrix_into(
    system: &Multibody,
    state: &[f64],
    poses: &[FrameKinematics<f64>],
    matrix: &mut DMatrix<f64>,
) {
    let (center, root) = (center_of_mass(system, state), attitude(system, state));
    for (j, mounted) in system.model().rotors().iter().enumerate() {
        let (rotor, pose) = (&mounted.rotor, &poses[mounted.body]);
        let (axis, lever) = (mat_vec(pose.rotation, rotor.axis), sub(at(pose, rotor.position), center));
        let moment = axpy(cross(lever, axis), -rotor.spin * rotor.moment_per_thrust, axis);
        put(matrix, j, rotate_back(root, axis), rotate_back(root, moment));
    }
}

/// J about the instantaneous centre of mass, in the axes of the root, joints held, kg m².
///
/// # Panics
/// If the state is shorter than the layout says.
pub fn composite_inertia(system: &Multibody, state: &[f64]) -> [[f64; 3]; 3] {
    composite_inertia_at(system, state, &body_poses(system, state))
}

/// As [`composite_inertia`], with the poses of the state.
pub(crate) fn composite_inertia_at(system: &Multibody, state: &[f64], poses: &[FrameKinematics<f64>]) -> [[f64; 3]; 3] {
    let (center, root) = (center_of_mass(system, state), attitude(system, state));
    let mut total = [[0.0; 3]; 3];
    for (body, pose) in system.model().bodies().iter().zip(poses).filter(|(b, _)| b.mass > 0.0) {
        let lever = rotate_back(root, sub(at(pose, body.center_of_mass), center));
        for k in 0..3 {
            let mut unit = [0.0; 3];
            unit[k] = 1.0;
            // J e = R J_own Rᵀ e + m r × (e × r)
            let world = dynamics::spatial::rotate(root, unit);
            let local = [0, 1, 2].map(|j| (0..3).map(|i| pose.rotation[i][j] * world[i]).sum::<f64>());
            let turned = nalgebra::Vector3::from(local);
            let own: Vec3<f64> = (body.inertia.matrix() * turned).into();
            let own = rotate_back(root, mat_vec(pose.rotation, own));
            let column = add(own, scale(body.mass, cross(lever, cross(unit, lever))));
            for row in 0..3 {
                total[row][k] += column[row];
            }
        }
    }
    total
}

/// D of the force −D v that the air puts on everything that moves at v, world axes, N s/m: linear drag of bodies and
/// drag of rotors at their speeds, as far as those effects are on.
///
/// # Panics
/// If the state is shorter than the layout says.
pub fn resistance(system: &Multibody, state: &[f64]) -> [[f64; 3]; 3] {
    resistance_at(system, state, &body_poses(system, state))
}

/// As [`resistance`], with the poses of the state.
pub(crate) fn resistance_at(system: &Multibody, state: &[f64], poses: &[FrameKinematics<f64>]) -> [[f64; 3]; 3] {
    let effects = system.physics().effects;
    let mut total = [[0.0; 3]; 3];
    // Σ d e eᵀ
    let mut along = |d: f64, e: Vec3<f64>| {
        for i in 0..3 {
            for j in 0..3 {
                total[i][j] += d * e[i] * e[j];
            }
        }
    };
    if effects.body_drag {
        for (body, pose) in system.model().bodies().iter().zip(poses) {
            (0..3).for_each(|k| along(body.drag.linear[k], [0, 1, 2].map(|i| pose.rotation[i][k])));
        }
    }
    if effects.rotor_drag {
        for (mounted, at) in system.model().rotors().iter().zip(&system.layout().rotor_speed) {
            let (rotor, speed) = (&mounted.rotor, state[*at]);
            let axis = mat_vec(poses[mounted.body].rotation, rotor.axis);
            for e in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
                along(rotor.drag_coefficient * speed, e);
            }
            along((rotor.axial_drag_coefficient - rotor.drag_coefficient) * speed, axis);
        }
    }
    total
}

/// Attitude of the root, body → world; level where the root does not float.
pub(crate) fn attitude(system: &Multibody, state: &[f64]) -> [f64; 4] {
    if system.model().bodies()[0].joint.motion != Motion::Floating {
        return [1.0, 0.0, 0.0, 0.0];
    }
    let root = system.layout().bodies[0].position;
    [0, 1, 2, 3].map(|k| state[root + 6 + k])
}

/// A point of a body in the world, m.
pub(crate) fn at(pose: &FrameKinematics<f64>, point: [f64; 3]) -> Vec3<f64> {
    add(pose.position, mat_vec(pose.rotation, point))
}

/// Writes column j.
pub(crate) fn put(matrix: &mut DMatrix<f64>, j: usize, force: Vec3<f64>, moment: Vec3<f64>) {
    for k in 0..3 {
        matrix[(k, j)] = force[k];
        matrix[(3 + k, j)] = moment[k];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynamics::assembly::single;
    use dynamics::configurations;
    use dynamics::rotor::holding_action;
    use dynamics::spatial::{from_euler, rotate};
    use dynamics::tree::{Model, Motion, momentum};
    use dynamics::{Effects, Physics, vehicles};

    fn bare(model: &Model) -> Multibody {
        Multibody::new(model, Physics { effects: Effects::none(), ..Physics::default() }).unwrap()
    }

    /// Everything displaced and moving, rotors at rest.
    fn moving(system: &Multibody) -> Vec<f64> {
        let (layout, model) = (system.layout(), system.model());
        let mut state = system.rest_state();
        let mut next = 0.37_f64;
        let mut any = || {
            next = (next * 7.31 + 0.123).fract();
            next - 0.5
        };
        for (place, body) in layout.bodies.iter().zip(model.bodies()) {
            match body.joint.motion {
                Motion::Floating => {
                    let q = from_euler(any(), any(), any());
                    state[place.position + 6..place.position + 10].copy_from_slice(&q);
                    (0..3).for_each(|k| state[place.velocity + k] = any());
                    (10..13).for_each(|k| state[place.position + k] = any());
                }
                _ => {
                    state[place.position] += 1.6 * any();
                    state[place.velocity] = any();
                }
            }
        }
        state
    }

    /// Rate of change of `[linear; angular]` momentum in the root's axes.
    fn momentum_rate(system: &Multibody, state: &[f64]) -> [f64; 6] {
        let mut rate = vec![0.0; state.len()];
        let mut input = system.rest_input();
        for (r, (at, speed)) in system.layout().rotor_action.iter().zip(&system.layout().rotor_speed).enumerate() {
            input[*at] = holding_action(system.model().rotors()[r].rotor.max_speed, state[*speed]);
        }
        system.derivative(state, &input, &[], &mut rate);
        let h = 1e-6;
        let shifted = |s: f64| -> Vec<f64> { state.iter().zip(&rate).map(|(x, r)| x + s * h * r).collect() };
        let [a, b] = [-1.0, 1.0].map(|s| momentum(system, &shifted(s)));
        let (linear, angular) = (sub(b.linear, a.linear), sub(b.angular, a.angular));
        let root = attitude(system, state);
        let [f, m] = [linear, angular].map(|v| rotate_back(root, scale(0.5 / h, v)));
        [f[0], f[1], f[2], m[0], m[1], m[2]]
    }

    #[test]
    fn thrusts_change_momentum_as_the_matrix_says_in_any_shape_and_motion() {
        for name in ["omav_tilting", "dragon", "platform"] {
            let system = bare(&configurations::by_name(name).unwrap());
            let state = moving(&system);
            let (matrix, still) = (wrench_matrix(&system, &state), momentum_rate(&system, &state));
            let mut spun = state.clone();
            let mut thrusts = Vec::new();
            for (r, at) in system.layout().rotor_speed.iter().enumerate() {
                let rotor = &system.model().rotors()[r].rotor;
                spun[*at] = rotor.max_speed * (0.3 + 0.05 * r as f64).fract();
                thrusts.push(rotor.thrust_coefficient * spun[*at] * spun[*at]);
            }
            let wrench = matrix * nalgebra::DVector::from_vec(thrusts);
            let turning = momentum_rate(&system, &spun);
            let gap = (0..6).map(|i| (turning[i] - still[i] - wrench[i]).abs()).fold(0.0, f64::max);
            println!("worst {name} {gap:.1e} of {:.1}", wrench.amax());
            // measured: 3.1e-10 of 84 (omav), 4.3e-10 of 6.1 (dragon), 1.8e-10 of 31; momentum by central differences
            assert!(gap < 1e-8 * wrench.amax(), "{name}: {gap:e}");
        }
    }

    #[test]
    fn a_rigid_vehicle_has_its_own_allocation_matrix_and_inertia() {
        for vehicle in vehicles::all() {
            let system = bare(&single(&vehicle).unwrap());
            let mut state = system.rest_state();
            state[6..10].copy_from_slice(&from_euler(0.4, -0.9, 2.0));
            state[0..3].copy_from_slice(&rotate(from_euler(0.1, 0.2, 0.3), [3.0, -1.0, 7.0]));
            let gap = (wrench_matrix(&system, &state) - vehicle.allocation_matrix()).amax();
            let (j, own) = (composite_inertia(&system, &state), vehicle.mass_properties().inertia);
            let heavier = (0..9).map(|k| (j[k / 3][k % 3] - own[(k / 3, k % 3)]).abs()).fold(0.0, f64::max);
            println!("worst {} {gap:.1e} {heavier:.1e}", vehicle.name);
            // measured: 1.6e-15 (firefly), 1.1e-16 (omav)
            assert!(gap < 1e-12 && heavier < 1e-14, "{}: {gap:e} {heavier:e}", vehicle.name);
        }
    }
}
