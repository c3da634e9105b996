//! Forces from outside on every body: rotors, air, disturbance, wakes.
//!
//! The same equations as of the closed-form multirotor ([`rigid`](crate::rigid)), body by body: wrenches are
//! summed in the body's frame about its origin, then turned into world axes once.

use super::cable_loads;
use super::contact_loads::{self, Friction};
use super::parameters::{ParameterView, at, contact_parameters, link_parameters, rotor_parameters};
use super::scratch::{BodyScratch, RotorScratch};
use super::topology::{Link, Topology};
use super::wakes;
use crate::rotor::{self, Lag, Motor, N_ROTOR_PARAMETER, RotorModel, commanded_speed};
use crate::spatial::*;
use autodiff::{Scalar, safe};

/// Constants and target speed of every rotor: what stays the same through a step.
pub(crate) fn prepare_rotors<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    numbers: P,
    input: &[S],
    rotors: &mut [RotorScratch<S>],
) {
    let o = S::zero();
    for r in 0..t.n_rotor() {
        let n = rotor_parameters(t.n_body(), r);
        let mut own = [o; N_ROTOR_PARAMETER];
        for k in 0..N_ROTOR_PARAMETER {
            own[k] = numbers.get(n + k);
        }
        let rotor = &mut rotors[r];
        rotor.model = RotorModel::new(&own, [o; 3], t.rotor_radius[r]);
        rotor.lag.target = commanded_speed(rotor.model.max_speed, input[t.rotor_action[r]]);
    }
}

/// Every rotor at the start of a substep of `substep` seconds, from its present speed. The motor is made for the one
/// direction that it takes: most steps are one substep, and an exponential is dear.
pub(crate) fn start_rotors<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    numbers: P,
    substep: f64,
    x: &[S],
    rotors: &mut [RotorScratch<S>],
) {
    for r in 0..t.n_rotor() {
        let (rotor, n) = (&mut rotors[r], rotor_parameters(t.n_body(), r));
        let (up, down) = (numbers.get(n + rotor::at::time_constant_up), numbers.get(n + rotor::at::time_constant_down));
        let (speed, target) = (x[t.rotor_speed[r]], rotor.lag.target);
        let motor = Motor::new(S::select(speed.lt(target), up, down), substep);
        (rotor.speed, rotor.lag) = (speed, Lag::new(motor, speed, target));
    }
}

/// Half a substep on.
#[inline]
pub(crate) fn advance_rotors<S: Scalar>(t: &Topology, rotors: &mut [RotorScratch<S>]) {
    for r in 0..t.n_rotor() {
        rotors[r].speed = rotors[r].lag.advance();
    }
}

/// Outside force and moment on every body, world axes, about its origin. Needs kinematics.
pub(crate) fn apply<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    numbers: P,
    input: &[S],
    friction: Friction,
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
            let mut wrench = Wrench::zero();
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
        contact_loads::apply(t, numbers, friction, bodies);
    }
    cable_loads::apply(t, numbers, bodies);
    wakes::apply(t, bodies);
}

/// About the body's origin, body axes.
fn rotor_wrench<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    link: &Link,
    numbers: P,
    body: &BodyScratch<S>,
    rotors: &[RotorScratch<S>],
) -> Wrench<S> {
    let mut sum = Wrench::zero();
    for k in link.rotors.0..link.rotors.1 {
        let rotor = &rotors[t.rotor_order[k]];
        let mut height = None;
        if t.effects.ground_effect {
            let ground: S = numbers.get(contact_parameters(t.n_body(), t.n_rotor()) + 4);
            height = Some(body.position[2] + dot(body.rotation[2], rotor.model.hub) - ground);
        }
        rotor.model.add_thrust(rotor.speed, height, true, &mut sum);
    }
    sum
}

/// Drag of airframe and rotors, rolling moment, and what spinning rotors hold against turning.
fn air_wrench<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    i: usize,
    numbers: P,
    input: &[S],
    body: &BodyScratch<S>,
    rotors: &[RotorScratch<S>],
    wrench: &mut Wrench<S>,
) {
    let (link, effects, n) = (&t.links[i], t.effects, link_parameters(i));
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
    rotor_air(t, link, rotors, (velocity, w), wrench);
}

fn rotor_air<S: Scalar>(
    t: &Topology,
    link: &Link,
    rotors: &[RotorScratch<S>],
    (velocity, w): (Vec3<S>, Vec3<S>),
    wrench: &mut Wrench<S>,
) {
    let (mut momentum, mut rate) = ([S::zero(); 3], [S::zero(); 3]);
    for k in link.rotors.0..link.rotors.1 {
        let RotorScratch { model, lag, speed } = rotors[t.rotor_order[k]];
        if t.effects.rotor_air() {
            model.add_drag(speed, velocity, w, t.effects, wrench);
        }
        if t.effects.rotor_inertia {
            model.add_momentum(speed, lag.acceleration(speed), &mut momentum, &mut rate);
        }
    }
    if t.effects.rotor_inertia {
        wrench.moment = sub(sub(wrench.moment, rate), cross(w, momentum));
    }
}
