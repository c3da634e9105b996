//! Forces from outside on every body: rotors, air, disturbance, wakes.
//!
//! The same equations as of the closed-form multirotor ([`rigid`](crate::dynamics::rigid)), body by body: wrenches are
//! summed in the body's frame about its origin, then turned into world axes once.

use super::numbers::{Numbers, at, body_numbers, contact_numbers, rotor_numbers};
use super::scratch::{BodyScratch, RotorScratch};
use super::topology::{Link, Topology};
use super::touch;
use crate::autodiff::{Scalar, safe};
use crate::dynamics::aero::{downwash, ground_effect};
use crate::dynamics::rigid::Effects;
use crate::dynamics::spatial::*;

/// Places within the numbers of one rotor.
mod rotor_at {
    pub(super) const POSITION: usize = 0;
    pub(super) const AXIS: usize = 3;
    pub(super) const SPIN: usize = 6;
    pub(super) const THRUST: usize = 7;
    pub(super) const MOMENT: usize = 8;
    pub(super) const MAX_SPEED: usize = 9;
    pub(super) const TIME_UP: usize = 10;
    pub(super) const TIME_DOWN: usize = 11;
    pub(super) const INERTIA: usize = 12;
    pub(super) const DRAG: usize = 13;
    pub(super) const AXIAL_DRAG: usize = 14;
    pub(super) const ROLLING: usize = 15;
}

/// Wrench per Ω² and target speed of every rotor: what stays the same through a step.
#[inline(always)]
pub(crate) fn prepare_rotors<S: Scalar, P: Numbers<S>>(
    t: &Topology,
    numbers: P,
    input: &[S],
    rotors: &mut [RotorScratch<S>],
) {
    let (one, half) = (S::one(), S::constant(0.5));
    for r in 0..t.n_rotor() {
        let n = rotor_numbers(t.n_body(), r);
        let rotor = &mut rotors[r];
        let (hub, axis) = (numbers.vector(n + rotor_at::POSITION), numbers.vector(n + rotor_at::AXIS));
        let (spin, kappa) = (numbers.get(n + rotor_at::SPIN), numbers.get(n + rotor_at::MOMENT));
        rotor.force = scale(numbers.get(n + rotor_at::THRUST), axis);
        rotor.moment = sub(cross(hub, rotor.force), scale(spin * kappa, rotor.force));
        let fraction = (input[t.rotor_action[r]].clamp(-one, one) + one) * half;
        rotor.target = numbers.get(n + rotor_at::MAX_SPEED) * safe::sqrt(fraction, 1e-4);
    }
}

/// τ and e^{−h/2τ} of every rotor for a substep from its present speeds; h in seconds.
#[inline(always)]
pub(crate) fn start_rotors<S: Scalar, P: Numbers<S>>(
    t: &Topology,
    numbers: P,
    substep: f64,
    x: &[S],
    rotors: &mut [RotorScratch<S>],
) {
    let half = S::constant(-0.5 * substep);
    for r in 0..t.n_rotor() {
        let n = rotor_numbers(t.n_body(), r);
        let rotor = &mut rotors[r];
        rotor.start = x[t.rotor_speed[r]];
        rotor.speed = rotor.start;
        let (up, down) = (numbers.get(n + rotor_at::TIME_UP), numbers.get(n + rotor_at::TIME_DOWN));
        rotor.rate = S::select(rotor.start.lt(rotor.target), up, down).recip();
        rotor.decay = (half * rotor.rate).exp();
    }
}

/// Half a substep on: Ω ← Ω_cmd + (Ω − Ω_cmd) e^{−h/2τ}.
#[inline(always)]
pub(crate) fn advance_rotors<S: Scalar>(t: &Topology, rotors: &mut [RotorScratch<S>]) {
    for r in 0..t.n_rotor() {
        let rotor = &mut rotors[r];
        rotor.speed = (rotor.speed - rotor.target).mul_add(rotor.decay, rotor.target);
    }
}

/// Outside force and moment on every body, world axes, about its origin. Needs kinematics.
#[inline(always)]
pub(crate) fn apply<S: Scalar, P: Numbers<S>>(
    t: &Topology,
    numbers: P,
    input: &[S],
    bodies: &mut [BodyScratch<S>],
    rotors: &[RotorScratch<S>],
) {
    let o = [S::zero(); 3];
    let effects = t.effects;
    for i in 0..t.n_body() {
        let link = &t.links[i];
        let body = &mut bodies[i];
        (body.force, body.moment) = (o, o);
        let has_rotors = link.rotors.0 < link.rotors.1;
        let drags = (effects.body_drag && link.linear_drag) || (effects.quadratic_drag && link.quadratic_drag);
        if has_rotors || drags {
            let mut wrench = Wrench { force: o, moment: o };
            if has_rotors {
                wrench = rotor_wrench(t, link, numbers, body, rotors);
            }
            let moving_air = drags || (has_rotors && (effects.rotor_air() || effects.rotor_inertia));
            if moving_air {
                air_wrench(t, i, numbers, input, body, rotors, &mut wrench);
            }
            body.force = mat_vec(body.rotation, wrench.force);
            body.moment = mat_vec(body.rotation, wrench.moment);
        }
        if let Some(d) = link.disturbance {
            let force = [input[d + 3], input[d + 4], input[d + 5]];
            let moment = mat_vec(body.rotation, [input[d + 6], input[d + 7], input[d + 8]]);
            body.force = add(body.force, force);
            body.moment = add(add(body.moment, moment), cross(body.center, force));
        }
    }
    if effects.contact {
        touch::apply(t, numbers, bodies);
    }
    if effects.downwash && t.sources.len() > 1 {
        for s in 0..t.sources.len() {
            let body = &mut bodies[t.sources[s].body];
            let lever = mat_vec(body.rotation, constants(t.sources[s].position));
            body.force = add(body.force, body.wake);
            body.moment = add(body.moment, cross(lever, body.wake));
        }
    }
}

/// About the body's origin, body axes.
#[derive(Clone, Copy)]
struct Wrench<S> {
    force: Vec3<S>,
    moment: Vec3<S>,
}

#[inline(always)]
fn rotor_wrench<S: Scalar, P: Numbers<S>>(
    t: &Topology,
    link: &Link,
    numbers: P,
    body: &BodyScratch<S>,
    rotors: &[RotorScratch<S>],
) -> Wrench<S> {
    let mut sum = Wrench { force: [S::zero(); 3], moment: [S::zero(); 3] };
    for k in link.rotors.0..link.rotors.1 {
        let r = t.rotor_order[k];
        let rotor = &rotors[r];
        let squared = rotor.speed * rotor.speed;
        let (mut force, mut moment) = (rotor.force, rotor.moment);
        if t.effects.ground_effect {
            let hub = numbers.vector(rotor_numbers(t.n_body(), r) + rotor_at::POSITION);
            let ground: S = numbers.get(contact_numbers(t.n_body(), t.n_rotor()) + 4);
            let height = body.position[2] + dot(body.rotation[2], hub) - ground;
            let gain = ground_effect::factor(height, S::constant(t.rotor_radius[r]));
            // thrust grows near the ground, the reaction torque does not
            moment = add(moment, cross(hub, scale(gain - S::one(), force)));
            force = scale(gain, force);
        }
        sum.force = axpy(sum.force, squared, force);
        sum.moment = axpy(sum.moment, squared, moment);
    }
    sum
}

/// Drag of airframe and rotors, rolling moment, and what spinning rotors hold against turning.
#[inline(always)]
fn air_wrench<S: Scalar, P: Numbers<S>>(
    t: &Topology,
    i: usize,
    numbers: P,
    input: &[S],
    body: &BodyScratch<S>,
    rotors: &[RotorScratch<S>],
    wrench: &mut Wrench<S>,
) {
    let (link, effects, n) = (&t.links[i], t.effects, body_numbers(i));
    let still = match link.wind {
        Some(w) => sub(body.velocity, [input[w], input[w + 1], input[w + 2]]),
        None => body.velocity,
    };
    let back = transpose(body.rotation);
    let (velocity, w) = (mat_vec(back, still), mat_vec(back, body.angular_velocity));
    let center = numbers.vector(n + at::CENTER_OF_MASS);
    let at_center = if link.centered { velocity } else { add(velocity, cross(w, center)) };
    let mut force = [S::zero(); 3];
    if effects.body_drag && link.linear_drag {
        force = neg(hadamard(numbers.vector(n + at::LINEAR_DRAG), at_center));
        wrench.moment = sub(wrench.moment, hadamard(numbers.vector(n + at::ANGULAR_DRAG), w));
    }
    if effects.quadratic_drag && link.quadratic_drag {
        let speed = safe::norm(at_center);
        force = axpy(force, -speed, hadamard(numbers.vector(n + at::QUADRATIC_DRAG), at_center));
    }
    wrench.force = add(wrench.force, force);
    if !link.centered {
        wrench.moment = add(wrench.moment, cross(center, force));
    }
    rotor_air(t, link, effects, numbers, rotors, (velocity, w), wrench);
}

#[inline(always)]
fn rotor_air<S: Scalar, P: Numbers<S>>(
    t: &Topology,
    link: &Link,
    effects: Effects,
    numbers: P,
    rotors: &[RotorScratch<S>],
    (velocity, w): (Vec3<S>, Vec3<S>),
    wrench: &mut Wrench<S>,
) {
    let mut momentum = [S::zero(); 3];
    for k in link.rotors.0..link.rotors.1 {
        let r = t.rotor_order[k];
        let (rotor, n) = (&rotors[r], rotor_numbers(t.n_body(), r));
        let axis = numbers.vector(n + rotor_at::AXIS);
        let spin = numbers.get(n + rotor_at::SPIN);
        if effects.rotor_air() {
            let hub = numbers.vector(n + rotor_at::POSITION);
            let at_hub = add(velocity, cross(w, hub));
            let along = scale(dot(at_hub, axis), axis);
            let across = sub(at_hub, along);
            if effects.rotor_drag {
                let (k_d, k_z) = (numbers.get(n + rotor_at::DRAG), numbers.get(n + rotor_at::AXIAL_DRAG));
                let force = scale(-rotor.speed, add(scale(k_d, across), scale(k_z, along)));
                wrench.force = add(wrench.force, force);
                wrench.moment = add(wrench.moment, cross(hub, force));
            }
            if effects.rolling_moment {
                let rolling = spin * numbers.get(n + rotor_at::ROLLING);
                wrench.moment = axpy(wrench.moment, -(rolling * rotor.speed), across);
            }
        }
        if effects.rotor_inertia {
            let inertia = spin * numbers.get(n + rotor_at::INERTIA);
            let rate = (rotor.target - rotor.speed) * rotor.rate;
            momentum = axpy(momentum, inertia * rotor.speed, axis);
            wrench.moment = axpy(wrench.moment, -(inertia * rate), axis);
        }
    }
    if effects.rotor_inertia {
        wrench.moment = sub(wrench.moment, cross(w, momentum));
    }
}

/// Wakes of all drones on all others, held through a substep as commands are. Needs kinematics.
#[inline(always)]
pub(crate) fn hold_wakes<S: Scalar>(t: &Topology, bodies: &mut [BodyScratch<S>], rotors: &[RotorScratch<S>]) {
    if !t.effects.downwash || t.sources.len() < 2 {
        return;
    }
    let (k_r, k_z) = (S::constant(downwash::DEFAULT_RADIAL), S::constant(downwash::DEFAULT_AXIAL));
    for s in 0..t.sources.len() {
        bodies[t.sources[s].body].wake = [S::zero(); 3];
    }
    for s in 0..t.sources.len() {
        let source = &t.sources[s];
        let thrust = thrust_of(source, bodies, rotors, t);
        let from = source_position(source, bodies);
        for other in 0..t.sources.len() {
            if other != s {
                let to = source_position(&t.sources[other], bodies);
                let force = downwash::force(sub(from, to), thrust, k_r, k_z);
                let body = &mut bodies[t.sources[other].body];
                body.wake = add(body.wake, force);
            }
        }
    }
}

#[inline(always)]
fn source_position<S: Scalar>(source: &super::topology::Source, bodies: &[BodyScratch<S>]) -> Vec3<S> {
    let body = &bodies[source.body];
    add(body.position, mat_vec(body.rotation, constants(source.position)))
}

/// Σ k_f Ω² n of a drone's rotors, world.
#[inline(always)]
fn thrust_of<S: Scalar>(
    source: &super::topology::Source,
    bodies: &[BodyScratch<S>],
    rotors: &[RotorScratch<S>],
    t: &Topology,
) -> Vec3<S> {
    let mut thrust = [S::zero(); 3];
    for k in 0..source.rotors.len() {
        let r = source.rotors[k];
        let (rotor, body) = (&rotors[r], &bodies[t.rotor_body[r]]);
        let force = scale(rotor.speed * rotor.speed, rotor.force);
        thrust = add(thrust, mat_vec(body.rotation, force));
    }
    thrust
}
