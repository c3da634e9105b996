//! Forward kinematics: where every body is and how it moves.
//!
//! World axes throughout, at each body's joint origin. Accelerations are those of material points (not Featherstone's
//! spatial ones), so nothing depends on the velocity of the whole: with r the offset from the parent's origin,
//!
//! ```text
//! ω_i = ω_p + ω_J            v_i = v_p + ω_p × r + v_J
//! α_i = α_p + bias_ω + α_J   a_i = a_p + α_p × r + bias_v + a_J
//! ```
//!
//! where a hinge has bias_ω = ω_p × ω_J, bias_v = ω_p × (ω_p × r), and a slide 2 ω_p × v_J more.

use super::parameters::{ParameterView, at, link_parameters};
use super::scratch::BodyScratch;
use super::topology::{Axis, Kind, Link, Topology};
use crate::spatial::*;
use autodiff::Scalar;

/// Where a frame is and how it moves, world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameKinematics<S> {
    /// Origin, m, world.
    pub position: Vec3<S>,
    /// Rotation matrix by rows, frame → world.
    pub rotation: Mat3<S>,
    /// Of the origin, m/s, world.
    pub velocity: Vec3<S>,
    /// rad/s, world.
    pub angular_velocity: Vec3<S>,
}

pub(super) fn pose_of<S: Scalar>(body: &BodyScratch<S>) -> FrameKinematics<S> {
    FrameKinematics {
        position: body.position,
        rotation: body.rotation,
        velocity: body.velocity,
        angular_velocity: body.angular_velocity,
    }
}

/// Fills position, rotation, velocities, axes and biases of every body from a state.
pub(crate) fn forward<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    numbers: P,
    x: &[S],
    bodies: &mut [BodyScratch<S>],
) {
    for i in 0..t.n_body() {
        let link = &t.links[i];
        let origin = numbers.vector(link_parameters(i) + at::JOINT_POSITION);
        let center: Vec3<S> = numbers.vector(link_parameters(i) + at::CENTER_OF_MASS);
        match link.parent {
            Some(p) => {
                let (before, after) = bodies.split_at_mut(i);
                let parent = &before[p];
                place_child(link, origin, x, parent, &mut after[0]);
            }
            None => place_root(link, origin, x, &mut bodies[i]),
        }
        let body = &mut bodies[i];
        body.center = if link.centered { [S::zero(); 3] } else { mat_vec(body.rotation, center) };
    }
}

#[inline]
fn attitude_of<S: Scalar>(x: &[S], at: usize) -> Quat<S> {
    unit([x[at], x[at + 1], x[at + 2], x[at + 3]])
}

#[inline]
fn vector_of<S: Scalar>(x: &[S], at: usize) -> Vec3<S> {
    [x[at], x[at + 1], x[at + 2]]
}

/// A body that hangs on the world.
fn place_root<S: Scalar>(link: &Link, origin: Vec3<S>, x: &[S], body: &mut BodyScratch<S>) {
    let o = [S::zero(); 3];
    (body.velocity, body.angular_velocity, body.bias_angular, body.bias_linear) = (o, o, o, o);
    let frame: Mat3<S> = match link.turn {
        Some(turn) => constant_matrix(turn),
        None => constant_matrix(super::model::IDENTITY),
    };
    let (position, velocity) = (link.position, link.velocity);
    match link.kind {
        Kind::Floating => {
            body.rotation = matrix(attitude_of(x, position + 6));
            body.position = vector_of(x, position);
            body.velocity = vector_of(x, velocity);
            body.angular_velocity = mat_vec(body.rotation, vector_of(x, position + 10));
        }
        Kind::Hinge(axis) => {
            body.axis = axis_in(&frame, axis);
            body.rotation = turned(&frame, axis, x[position].sin_cos());
            body.position = origin;
            body.angular_velocity = scale(x[velocity], body.axis);
        }
        Kind::Slide(axis) => {
            body.axis = axis_in(&frame, axis);
            body.rotation = frame;
            body.position = axpy(origin, x[position], body.axis);
            body.velocity = scale(x[velocity], body.axis);
        }
        Kind::Ball => {
            body.rotation = mat_mul(frame, matrix(attitude_of(x, position)));
            body.position = origin;
            body.angular_velocity = mat_vec(body.rotation, vector_of(x, velocity));
        }
    }
    body.offset = body.position;
}

/// A body that hangs on another.
fn place_child<S: Scalar>(link: &Link, origin: Vec3<S>, x: &[S], parent: &BodyScratch<S>, body: &mut BodyScratch<S>) {
    let o = [S::zero(); 3];
    let (q, rate) = (link.position, link.velocity);
    let frame = match link.turn {
        Some(turn) => mat_mul_constant(&parent.rotation, turn),
        None => parent.rotation,
    };
    let (w, mut relative_angular, mut relative_linear) = (parent.angular_velocity, o, o);
    body.offset = if link.coincident { o } else { mat_vec(parent.rotation, origin) };
    match link.kind {
        Kind::Hinge(axis) => {
            body.axis = axis_in(&frame, axis);
            body.rotation = turned(&frame, axis, x[q].sin_cos());
            relative_angular = scale(x[rate], body.axis);
        }
        Kind::Slide(axis) => {
            body.axis = axis_in(&frame, axis);
            body.rotation = frame;
            body.offset = axpy(body.offset, x[q], body.axis);
            relative_linear = scale(x[rate], body.axis);
        }
        // a floating body hangs on the world only: the model's checks see to that
        Kind::Ball | Kind::Floating => {
            body.rotation = mat_mul(frame, matrix(attitude_of(x, q)));
            relative_angular = mat_vec(body.rotation, vector_of(x, rate));
        }
    }
    body.angular_velocity = add(w, relative_angular);
    body.bias_angular = cross(w, relative_angular);
    if link.coincident {
        (body.position, body.velocity, body.bias_linear) = (parent.position, parent.velocity, o);
        return;
    }
    body.position = add(parent.position, body.offset);
    let swing = cross(w, body.offset);
    body.velocity = add(parent.velocity, swing);
    body.bias_linear = cross(w, swing);
    if let Kind::Slide(_) = link.kind {
        body.velocity = add(body.velocity, relative_linear);
        let coriolis = cross(w, relative_linear);
        body.bias_linear = add(body.bias_linear, add(coriolis, coriolis));
    }
}

/// The axis of a joint along world axes.
fn axis_in<S: Scalar>(frame: &Mat3<S>, axis: Axis) -> Vec3<S> {
    match axis {
        Axis::X => [frame[0][0], frame[1][0], frame[2][0]],
        Axis::Y => [frame[0][1], frame[1][1], frame[2][1]],
        Axis::Z => [frame[0][2], frame[1][2], frame[2][2]],
        Axis::General(a) => mat_vec(*frame, constants(a)),
    }
}

/// `frame` turned about an axis of its own: R = F (c I + s `[a]×` + (1 − c) a aᵀ).
fn turned<S: Scalar>(frame: &Mat3<S>, axis: Axis, (s, c): (S, S)) -> Mat3<S> {
    let mut r = *frame;
    match axis {
        Axis::X => mix(&mut r, 1, 2, s, c),
        Axis::Y => mix(&mut r, 2, 0, s, c),
        Axis::Z => mix(&mut r, 0, 1, s, c),
        Axis::General(a) => {
            let (a, versine): (Vec3<S>, S) = (constants(a), S::one() - c);
            let mut own = skew(scale(s, a));
            for i in 0..3 {
                for j in 0..3 {
                    own[i][j] = (versine * a[i]).mul_add(a[j], own[i][j]);
                }
                own[i][i] += c;
            }
            r = mat_mul(*frame, own);
        }
    }
    r
}

/// Columns i and j turned into each other: cᵢ ← c cᵢ + s cⱼ, cⱼ ← c cⱼ − s cᵢ.
#[inline]
fn mix<S: Scalar>(r: &mut Mat3<S>, i: usize, j: usize, s: S, c: S) {
    for row in 0..3 {
        let (a, b) = (r[row][i], r[row][j]);
        r[row][i] = c.mul_add(a, s * b);
        r[row][j] = c.mul_add(b, -(s * a));
    }
}

#[inline]
fn constant_matrix<S: Scalar>(m: [[f64; 3]; 3]) -> Mat3<S> {
    [constants(m[0]), constants(m[1]), constants(m[2])]
}

#[inline]
fn mat_mul_constant<S: Scalar>(a: &Mat3<S>, b: [[f64; 3]; 3]) -> Mat3<S> {
    mat_mul(*a, constant_matrix(b))
}
