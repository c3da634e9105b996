//! Articulated-body algorithm: accelerations from forces, in time proportional to the number of bodies.
//!
//! Featherstone (2008, "Rigid Body Dynamics Algorithms", chapter 7), written along world axes about each joint's origin
//! with accelerations of material points (see [`kinematics`](super::kinematics)): an articulated inertia then moves to
//! its parent by a shift alone, without a rotation, and a third of the usual products remain.
//!
//! ```text
//! leaves to root:  U = I s,  D = s·U + slope,  u = τ − s·p
//!                  I_parent += shift(I − U Uᵀ/D),  p_parent += shift(p + (I − U Uᵀ/D) bias + U u/D)
//! root to leaves:  a' = shift(a_parent) + bias,  q̈ = (u − U·a')/D,  a = a' + s q̈
//! ```
//!
//! Accelerations in the scratch are proper ones (what an accelerometer reads): gravity is the world's upward acceleration.

use super::contact_loads::Friction;
use super::parameters::{ParameterView, at, link_parameters};
use super::scratch::{Articulated, BodyScratch};
use super::topology::{Kind, Topology};
use super::torque::{self, Pass};
use crate::integrate::gyroscopic_jacobian;
use crate::rigid::{Symmetric, full, symmetric};
use crate::spatial::*;
use autodiff::Scalar;

/// Accelerations of all bodies and joints, from kinematics and outside forces; d/dt of state `x` into `rate`, but for
/// the rotors.
pub(crate) fn accelerate<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    numbers: P,
    x: &[S],
    input: &[S],
    pass: Pass,
    bodies: &mut [BodyScratch<S>],
    rate: &mut [S],
) {
    for i in 0..t.n_body() {
        let grip = bodies[i].inertia;
        own_inertia(t, i, numbers, pass.implicit, &mut bodies[i]);
        if let Friction::Sampled(_) = pass.friction {
            bodies[i].inertia.add(&grip);
        }
    }
    for i in (0..t.n_body()).rev() {
        to_parent(t, i, numbers, x, input, pass, bodies);
    }
    let gravity = numbers.get(0);
    for i in 0..t.n_body() {
        from_parent(t, i, gravity, x, bodies, rate);
    }
}

/// Inertia and bias force of a body alone.
fn own_inertia<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    i: usize,
    numbers: P,
    implicit: f64,
    body: &mut BodyScratch<S>,
) {
    let (link, n) = (&t.links[i], link_parameters(i));
    body.inertia = Articulated::zero();
    (body.bias_force, body.bias_moment) = (neg(body.force), neg(body.moment));
    if link.massless {
        return;
    }
    let mass = numbers.get(n + at::MASS);
    let about_center = turned_inertia(numbers, n, link.products, &body.rotation);
    let w = body.angular_velocity;
    let gyroscopic = if implicit > 0.0 {
        implicit_gyroscopic(&about_center, w, implicit)
    } else {
        cross(w, times(&about_center, w))
    };
    body.bias_moment = add(body.bias_moment, gyroscopic);
    body.inertia.a = about_center;
    let o = S::zero();
    body.inertia.d = [mass, mass, mass, o, o, o];
    if !link.centered {
        let c = body.center;
        let swing = scale(mass, cross(w, cross(w, c)));
        body.bias_force = add(body.bias_force, swing);
        body.bias_moment = add(body.bias_moment, cross(c, swing));
        let mc = scale(mass, c);
        body.inertia.b = skew(mc);
        let moment = [
            mc[1].mul_add(c[1], mc[2] * c[2]),
            mc[0].mul_add(c[0], mc[2] * c[2]),
            mc[0].mul_add(c[0], mc[1] * c[1]),
            -(mc[0] * c[1]),
            -(mc[0] * c[2]),
            -(mc[1] * c[2]),
        ];
        body.inertia.a = add(about_center, moment);
    }
}

/// R J Rᵀ.
fn turned_inertia<S: Scalar, P: ParameterView<S>>(numbers: P, n: usize, products: bool, r: &Mat3<S>) -> Symmetric<S> {
    let diagonal: Vec3<S> = numbers.vector(n + at::INERTIA);
    let rj = if products {
        let p: Vec3<S> = numbers.vector(n + at::INERTIA + 3);
        mat_mul(*r, full([diagonal[0], diagonal[1], diagonal[2], p[0], p[1], p[2]]))
    } else {
        [hadamard(r[0], diagonal), hadamard(r[1], diagonal), hadamard(r[2], diagonal)]
    };
    [dot(rj[0], r[0]), dot(rj[1], r[1]), dot(rj[2], r[2]), dot(rj[0], r[1]), dot(rj[0], r[2]), dot(rj[1], r[2])]
}

/// M v of a symmetric matrix.
#[inline]
fn times<S: Scalar>(m: &Symmetric<S>, v: Vec3<S>) -> Vec3<S> {
    mat_vec(full(*m), v)
}

/// The moment −J Δω/h of the body alone over a step h, with Δω from one Newton step of the implicit gyroscopic equation
/// (see [`integrate`](crate::integrate)): ω × Jω as h → 0, never feeding energy in.
#[inline]
fn implicit_gyroscopic<S: Scalar>(inertia: &Symmetric<S>, w: Vec3<S>, step: f64) -> Vec3<S> {
    let m = full(*inertia);
    let momentum = mat_vec(m, w);
    let jacobian = gyroscopic_jacobian(m, momentum, w, S::constant(step));
    let change = mat_vec(inverse(jacobian), cross(w, momentum));
    mat_vec(m, change)
}

/// Eliminates a body's joint and adds what remains to its parent.
fn to_parent<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    i: usize,
    numbers: P,
    x: &[S],
    input: &[S],
    pass: Pass,
    bodies: &mut [BodyScratch<S>],
) {
    let link = &t.links[i];
    let body = &mut bodies[i];
    match link.kind {
        Kind::Floating => {}
        Kind::Hinge(_) | Kind::Slide(_) => {
            let (torque, slope) = torque::of_axis(link, i, numbers, x, input, body.held, pass);
            let turns = matches!(link.kind, Kind::Hinge(_));
            eliminate_axis(body, torque, slope, turns);
        }
        Kind::Ball => {
            let (torque, slope) = torque::of_ball(link, i, numbers, x, &body.rotation, pass);
            eliminate_ball(body, torque, slope);
        }
    }
    let Some(p) = link.parent else { return };
    let (before, after) = bodies.split_at_mut(i);
    add_shifted(&mut before[p], &after[0], link.coincident);
}

fn eliminate_axis<S: Scalar>(body: &mut BodyScratch<S>, torque: S, slope: S, turns: bool) {
    let s = body.axis;
    let i = &body.inertia;
    let (moment, force, along, bias) = if turns {
        let moment = times(&i.a, s);
        (moment, mat_vec(transpose(i.b), s), dot(s, moment), dot(s, body.bias_moment))
    } else {
        let force = times(&i.d, s);
        (mat_vec(i.b, s), force, dot(s, force), dot(s, body.bias_force))
    };
    let inverse = (along + slope).recip();
    let u = torque - bias;
    body.column_moment[0] = moment;
    body.column_force[0] = force;
    body.inverse[0] = inverse;
    body.torque[0] = u;
    let (mi, fi) = (scale(inverse, moment), scale(inverse, force));
    let (a, b, d) = (&mut body.inertia.a, &mut body.inertia.b, &mut body.inertia.d);
    *a = minus_outer(*a, mi, moment);
    *d = minus_outer(*d, fi, force);
    for row in 0..3 {
        b[row] = axpy(b[row], -mi[row], force);
    }
    body.bias_moment = axpy(body.bias_moment, u, mi);
    body.bias_force = axpy(body.bias_force, u, fi);
}

/// M − a bᵀ where a is a multiple of b.
fn minus_outer<S: Scalar>(m: Symmetric<S>, a: Vec3<S>, b: Vec3<S>) -> Symmetric<S> {
    [
        (-a[0]).mul_add(b[0], m[0]),
        (-a[1]).mul_add(b[1], m[1]),
        (-a[2]).mul_add(b[2], m[2]),
        (-a[0]).mul_add(b[1], m[3]),
        (-a[0]).mul_add(b[2], m[4]),
        (-a[1]).mul_add(b[2], m[5]),
    ]
}

fn eliminate_ball<S: Scalar>(body: &mut BodyScratch<S>, torque: Vec3<S>, slope: S) {
    let (a, b) = (full(body.inertia.a), body.inertia.b);
    let mut stiffened = body.inertia.a;
    for k in 0..3 {
        stiffened[k] += slope;
    }
    let inverse = symmetric(inverse(full(stiffened)));
    let u = sub(torque, body.bias_moment);
    body.column_moment = a;
    body.column_force = transpose(b);
    body.inverse = inverse;
    body.torque = u;
    let gain = full(inverse);
    let (ga, gb) = (mat_mul(gain, a), mat_mul(gain, b));
    let back = transpose(b);
    let (aa, ab, bb) = (mat_mul(a, ga), mat_mul(a, gb), mat_mul(back, gb));
    body.inertia.a = sub(body.inertia.a, symmetric(aa));
    body.inertia.d = sub(body.inertia.d, symmetric(bb));
    for row in 0..3 {
        body.inertia.b[row] = sub(b[row], ab[row]);
    }
    let gu = mat_vec(gain, u);
    body.bias_moment = add(body.bias_moment, mat_vec(a, gu));
    body.bias_force = add(body.bias_force, mat_vec(back, gu));
}

/// Moves inertia and bias force from a body's origin to its parent's and adds them there.
fn add_shifted<S: Scalar>(parent: &mut BodyScratch<S>, body: &BodyScratch<S>, coincident: bool) {
    let (i, r) = (&body.inertia, body.offset);
    let (cw, cv) = (body.bias_angular, body.bias_linear);
    let mut moment = add(body.bias_moment, times(&i.a, cw));
    let mut force = add(body.bias_force, mat_vec(transpose(i.b), cw));
    let target = &mut parent.inertia;
    target.d = add(target.d, i.d);
    if coincident {
        target.a = add(target.a, i.a);
        for row in 0..3 {
            target.b[row] = add(target.b[row], i.b[row]);
        }
    } else {
        moment = add(moment, mat_vec(i.b, cv));
        force = add(force, times(&i.d, cv));
        let d = full(i.d);
        // B' = B + [r]D, column by column; A' = A − B[r] + [r]B'ᵀ
        let columns = [cross(r, d[0]), cross(r, d[1]), cross(r, d[2])];
        let mut shifted = i.b;
        for row in 0..3 {
            for column in 0..3 {
                shifted[row][column] += columns[column][row];
            }
            target.b[row] = add(target.b[row], shifted[row]);
        }
        let left = [cross(r, i.b[0]), cross(r, i.b[1]), cross(r, i.b[2])];
        let right = [cross(r, shifted[0]), cross(r, shifted[1]), cross(r, shifted[2])];
        let more = [
            left[0][0] + right[0][0],
            left[1][1] + right[1][1],
            left[2][2] + right[2][2],
            left[0][1] + right[1][0],
            left[0][2] + right[2][0],
            left[1][2] + right[2][1],
        ];
        target.a = add(target.a, add(i.a, more));
        moment = add(moment, cross(r, force));
    }
    parent.bias_moment = add(parent.bias_moment, moment);
    parent.bias_force = add(parent.bias_force, force);
}

/// Accelerations of a body from its parent's.
fn from_parent<S: Scalar>(t: &Topology, i: usize, gravity: S, x: &[S], bodies: &mut [BodyScratch<S>], rate: &mut [S]) {
    let link = &t.links[i];
    let o = S::zero();
    let (up, spin) = match link.parent {
        Some(p) => (bodies[p].acceleration, bodies[p].angular_acceleration),
        None => ([o, o, gravity], [o; 3]),
    };
    let body = &mut bodies[i];
    let (position, velocity) = (link.position, link.velocity);
    if link.kind == Kind::Floating {
        float(body, gravity, x, position, rate);
        return;
    }
    let angular = add(spin, body.bias_angular);
    let linear = if link.coincident { up } else { add(add(up, cross(spin, body.offset)), body.bias_linear) };
    (body.angular_acceleration, body.acceleration) = (angular, linear);
    match link.kind {
        Kind::Hinge(_) | Kind::Slide(_) => {
            let load = dot(body.column_moment[0], angular) + dot(body.column_force[0], linear);
            let q = (body.torque[0] - load) * body.inverse[0];
            if let Kind::Hinge(_) = link.kind {
                body.angular_acceleration = axpy(angular, q, body.axis);
            } else {
                body.acceleration = axpy(linear, q, body.axis);
            }
            rate[position] = x[velocity];
            rate[velocity] = q;
        }
        Kind::Ball | Kind::Floating => {
            let load =
                add(mat_vec(transpose(body.column_moment), angular), mat_vec(transpose(body.column_force), linear));
            let relative = mat_vec(full(body.inverse), sub(body.torque, load));
            body.angular_acceleration = add(angular, relative);
            let own = mat_vec(transpose(body.rotation), relative);
            let w = [x[velocity], x[velocity + 1], x[velocity + 2]];
            let turning = derivative([x[position], x[position + 1], x[position + 2], x[position + 3]], w);
            for k in 0..3 {
                rate[velocity + k] = own[k];
            }
            for k in 0..4 {
                rate[position + k] = turning[k];
            }
        }
    }
}

/// A floating body: I a = −p.
fn float<S: Scalar>(body: &mut BodyScratch<S>, gravity: S, x: &[S], at: usize, rate: &mut [S]) {
    let (linear, angular) = solve(&body.inertia, neg(body.bias_force), neg(body.bias_moment));
    (body.acceleration, body.angular_acceleration) = (linear, angular);
    let own = mat_vec(transpose(body.rotation), angular);
    let w = [x[at + 10], x[at + 11], x[at + 12]];
    let turning = derivative([x[at + 6], x[at + 7], x[at + 8], x[at + 9]], w);
    for k in 0..3 {
        rate[at + k] = x[at + 3 + k];
        rate[at + 3 + k] = linear[k];
        rate[at + 10 + k] = own[k];
    }
    rate[at + 5] -= gravity;
    for k in 0..4 {
        rate[at + 6 + k] = turning[k];
    }
}

/// (a, α) of `[D Bᵀ; B A]` (a, α) = (f, n), by L D Lᵀ without pivoting: the matrix is positive definite.
fn solve<S: Scalar>(i: &Articulated<S>, force: Vec3<S>, moment: Vec3<S>) -> (Vec3<S>, Vec3<S>) {
    let (a, d) = (full(i.a), full(i.d));
    let mut l = [[S::zero(); 6]; 6];
    for row in 0..3 {
        for column in 0..3 {
            l[row][column] = d[row][column];
            l[row + 3][column] = i.b[row][column];
            l[row + 3][column + 3] = a[row][column];
        }
    }
    let mut y = [force[0], force[1], force[2], moment[0], moment[1], moment[2]];
    let mut inverse = [S::zero(); 6];
    // after column k, l[row][k] holds L·D and is divided where it is used
    for k in 0..6 {
        inverse[k] = l[k][k].recip();
        for row in k + 1..6 {
            let factor = l[row][k] * inverse[k];
            for column in k + 1..=row {
                l[row][column] = (-factor).mul_add(l[column][k], l[row][column]);
            }
            y[row] = (-factor).mul_add(y[k], y[row]);
        }
    }
    for k in 0..6 {
        let row = 5 - k;
        let mut sum = y[row];
        for below in row + 1..6 {
            sum = (-l[below][row]).mul_add(y[below], sum);
        }
        y[row] = sum * inverse[row];
    }
    ([y[0], y[1], y[2]], [y[3], y[4], y[5]])
}
