//! Mass matrix and Jacobians of a model alone, in `f64`.

use super::kinematics::{FrameKinematics, forward, pose_of};
use super::model::{Model, Motion, rest_state};
use super::parameters::{Source, model_parameters};
use super::scratch::scratch_on_stack;
use super::topology::Topology;
use crate::spatial::*;
use nalgebra::DMatrix;

/// M at [`rest_state`](super::rest_state).
pub(super) fn mass_matrix_at_rest(model: &Model) -> DMatrix<f64> {
    mass_matrix_of(model, &rest_state(model))
}

pub(super) fn mass_matrix_of(model: &Model, state: &[f64]) -> DMatrix<f64> {
    let poses = poses_of(model, state);
    let n = model.layout().n_velocity();
    let mut m = DMatrix::zeros(n, n);
    for (i, body) in model.bodies().iter().enumerate() {
        let own = model.layout().bodies[i].freedom;
        m[(own, own)] += body.joint.armature;
        let jacobian = point_jacobian(model, &poses, i, body.center_of_mass);
        let (linear, angular) = (jacobian.rows(0, 3), jacobian.rows(3, 3));
        let r = nalgebra::Matrix3::from_fn(|a, b| poses[i].rotation[a][b]);
        let inertia = r * body.inertia.matrix() * r.transpose();
        m += linear.transpose() * linear * body.mass + angular.transpose() * inertia * angular;
    }
    m
}

/// Poses of all bodies of a model alone.
pub(super) fn poses_of(model: &Model, state: &[f64]) -> Vec<FrameKinematics<f64>> {
    let bare = Topology::bare(model);
    let numbers = model_parameters(model);
    scratch_on_stack!(scratch, &bare, f64);
    forward(&bare, Source::Constants(&numbers), state, scratch.bodies);
    scratch.bodies[..bare.n_body()].iter().map(pose_of).collect()
}

/// As [`frame_jacobian`](super::frame_jacobian) of a point of a body, at [`rest_state`](super::rest_state).
pub(super) fn point_jacobian_at_rest(model: &Model, body: usize, point: [f64; 3]) -> DMatrix<f64> {
    point_jacobian(model, &poses_of(model, &rest_state(model)), body, point)
}

/// Of a body, at [`rest_state`](super::rest_state).
pub(super) fn pose_at_rest(model: &Model, body: usize) -> FrameKinematics<f64> {
    poses_of(model, &rest_state(model))[body]
}

/// Jacobian of a point of a body given in the body's frame.
pub(super) fn point_jacobian(
    model: &Model,
    poses: &[FrameKinematics<f64>],
    body: usize,
    point: [f64; 3],
) -> DMatrix<f64> {
    let mut j = DMatrix::zeros(6, model.layout().n_velocity());
    let at = add(poses[body].position, mat_vec(poses[body].rotation, point));
    let mut next = Some(body);
    while let Some(i) = next {
        let (place, pose) = (model.layout().bodies[i], &poses[i]);
        let lever = sub(at, pose.position);
        let mut column = |k: usize, linear: Vec3<f64>, angular: Vec3<f64>| {
            for row in 0..3 {
                j[(row, place.freedom + k)] = linear[row];
                j[(row + 3, place.freedom + k)] = angular[row];
            }
        };
        let axis = |k: usize| [pose.rotation[0][k], pose.rotation[1][k], pose.rotation[2][k]];
        match model.bodies()[i].joint.motion {
            // the body's own axis equals the joint's: a hinge leaves its axis where it was
            Motion::Revolute(a) => {
                let s = mat_vec(pose.rotation, a);
                column(0, cross(s, lever), s);
            }
            Motion::Prismatic(a) => column(0, mat_vec(pose.rotation, a), [0.0; 3]),
            Motion::Ball => (0..3).for_each(|k| column(k, cross(axis(k), lever), axis(k))),
            Motion::Floating => {
                for k in 0..3 {
                    let mut unit = [0.0; 3];
                    unit[k] = 1.0;
                    column(k, unit, [0.0; 3]);
                    column(3 + k, cross(axis(k), lever), axis(k));
                }
            }
        }
        next = model.bodies()[i].parent;
    }
    j
}
