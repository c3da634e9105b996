//! Recursive Newton–Euler: forces from accelerations.
//!
//! Featherstone (2008, chapter 5) in the axes and accelerations of `kinematics`. With the loads left
//! out and accelerations zero it gives the bias h(q, ν); with loads, the generalised force that joints must supply.

use super::contact_loads::Friction;
use super::kinematics::forward;
use super::loads;
use super::multibody::Multibody;
use super::parameters::{ParameterView, Source, at, link_parameters};
use super::scratch::{BodyScratch, scratch_on_stack};
use super::topology::{Kind, Topology};
use super::wakes;
use crate::rigid::full;
use crate::spatial::*;
use autodiff::Scalar;

/// Generalised forces τ = M(q) ν̇ + h(q, ν) − Σ Jᵀ f of outside loads (rotors, air, disturbance), about the velocity
/// vector ν of [`mass_matrix`](super::mass_matrix()): at a hinge the moment its joint supplies by damping, spring, limits and drive
/// together; at a floating root the wrench `[force (world); moment (body)]` that is missing, zero in free motion.
///
/// `acceleration` and `force` have `n_velocity` numbers. Rotor speeds come from the state; `input` gives their commands,
/// which matter through the rotors' spin-up torque alone.
///
/// # Panics
/// If a slice is shorter than the layout says.
pub fn inverse_dynamics<S: Scalar>(system: &Multibody, state: &[S], input: &[S], acceleration: &[S], force: &mut [S]) {
    let t = system.topology();
    let numbers = Source::Constants(system.parameters());
    scratch_on_stack!(scratch, t, S);
    loads::prepare_rotors(t, numbers, input, scratch.rotors);
    loads::start_rotors(t, numbers, 1.0, state, scratch.rotors);
    forward(t, numbers, state, scratch.bodies);
    wakes::hold(t, scratch.bodies, scratch.rotors);
    loads::apply(t, numbers, input, Friction::Explicit, scratch.bodies, scratch.rotors);
    newton_euler(t, numbers, acceleration, scratch.bodies, force);
}

fn newton_euler<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    numbers: P,
    acceleration: &[S],
    bodies: &mut [BodyScratch<S>],
    force: &mut [S],
) {
    for i in 0..t.n_body() {
        accelerated(t, i, numbers.get(0), acceleration, bodies);
        net_force(t, i, numbers, &mut bodies[i]);
    }
    for i in (0..t.n_body()).rev() {
        let link = &t.links[i];
        let body = &bodies[i];
        let n = link.freedom;
        match link.kind {
            Kind::Hinge(_) => force[n] = dot(body.axis, body.bias_moment) + geared(numbers, i, acceleration[n]),
            Kind::Slide(_) => force[n] = dot(body.axis, body.bias_force) + geared(numbers, i, acceleration[n]),
            Kind::Ball => write(force, n, mat_vec(transpose(body.rotation), body.bias_moment)),
            Kind::Floating => {
                write(force, n, body.bias_force);
                write(force, n + 3, mat_vec(transpose(body.rotation), body.bias_moment));
            }
        }
        if let Some(p) = link.parent {
            let (f, m) = (body.bias_force, add(body.bias_moment, cross(body.offset, body.bias_force)));
            bodies[p].bias_force = add(bodies[p].bias_force, f);
            bodies[p].bias_moment = add(bodies[p].bias_moment, m);
        }
    }
}

/// Torque that speeds up a geared motor.
#[inline]
fn geared<S: Scalar, P: ParameterView<S>>(numbers: P, body: usize, acceleration: S) -> S {
    numbers.get(link_parameters(body) + at::ARMATURE) * acceleration
}

#[inline]
fn write<S: Scalar>(to: &mut [S], at: usize, v: Vec3<S>) {
    for k in 0..3 {
        to[at + k] = v[k];
    }
}

/// Proper acceleration of a body from its parent's and its joint's.
fn accelerated<S: Scalar>(t: &Topology, i: usize, gravity: S, acceleration: &[S], bodies: &mut [BodyScratch<S>]) {
    let (link, o) = (&t.links[i], S::zero());
    let (up, spin) = match link.parent {
        Some(p) => (bodies[p].acceleration, bodies[p].angular_acceleration),
        None => ([o, o, gravity], [o; 3]),
    };
    let body = &mut bodies[i];
    let n = link.freedom;
    if link.kind == Kind::Floating {
        body.acceleration = [acceleration[n], acceleration[n + 1], acceleration[n + 2] + gravity];
        let own = [acceleration[n + 3], acceleration[n + 4], acceleration[n + 5]];
        body.angular_acceleration = mat_vec(body.rotation, own);
        return;
    }
    body.angular_acceleration = add(spin, body.bias_angular);
    body.acceleration = add(add(up, cross(spin, body.offset)), body.bias_linear);
    match link.kind {
        Kind::Hinge(_) => body.angular_acceleration = axpy(body.angular_acceleration, acceleration[n], body.axis),
        Kind::Slide(_) => body.acceleration = axpy(body.acceleration, acceleration[n], body.axis),
        Kind::Ball | Kind::Floating => {
            let own = [acceleration[n], acceleration[n + 1], acceleration[n + 2]];
            body.angular_acceleration = add(body.angular_acceleration, mat_vec(body.rotation, own));
        }
    }
}

/// Rate of momentum of a body about its origin, less the outside loads.
fn net_force<S: Scalar, P: ParameterView<S>>(t: &Topology, i: usize, numbers: P, body: &mut BodyScratch<S>) {
    let (link, n) = (&t.links[i], link_parameters(i));
    (body.bias_force, body.bias_moment) = (neg(body.force), neg(body.moment));
    if link.massless {
        return;
    }
    let (w, alpha, c) = (body.angular_velocity, body.angular_acceleration, body.center);
    let at_center = add(body.acceleration, add(cross(alpha, c), cross(w, cross(w, c))));
    let force = scale(numbers.get(n + at::MASS), at_center);
    let (d, p) = (numbers.vector(n + at::INERTIA), numbers.vector(n + at::INERTIA + 3));
    let own = full([d[0], d[1], d[2], p[0], p[1], p[2]]);
    let back = transpose(body.rotation);
    let (w_own, alpha_own) = (mat_vec(back, w), mat_vec(back, alpha));
    let euler = add(mat_vec(own, alpha_own), cross(w_own, mat_vec(own, w_own)));
    body.bias_force = add(body.bias_force, force);
    body.bias_moment = add(body.bias_moment, add(mat_vec(body.rotation, euler), cross(c, force)));
}
