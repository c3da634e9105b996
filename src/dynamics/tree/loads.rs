//! Forces from outside on every body: rotors, air, disturbance, wakes.
//!
//! The same equations as of the closed-form multirotor ([`rigid`](crate::dynamics::rigid)), body by body: wrenches are
//! summed in the body's frame about its origin, then turned into world axes once.

use super::cable;
use super::contact_loads::{self, Friction};
use super::parameters::{ParameterView, at, contact_parameters, link_parameters, rotor_parameters};
use super::scratch::{BodyScratch, RotorScratch};
use super::topology::{Link, Load, Topology};
use crate::autodiff::{Scalar, safe};
use crate::dynamics::aero::downwash;
use crate::dynamics::rotor::{self, Lag, Motor, N_ROTOR_PARAMETER, RotorModel, commanded_speed};
use crate::dynamics::spatial::*;

/// Constants and target speed of every rotor: what stays the same through a step.
#[inline(always)]
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
#[inline(always)]
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
#[inline(always)]
pub(crate) fn advance_rotors<S: Scalar>(t: &Topology, rotors: &mut [RotorScratch<S>]) {
    for r in 0..t.n_rotor() {
        rotors[r].speed = rotors[r].lag.advance();
    }
}

/// Outside force and moment on every body, world axes, about its origin. Needs kinematics.
#[inline(always)]
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
    cable::apply(t, numbers, bodies);
    let mut pushed = None;
    for k in 0..t.loads.len() {
        if pushed != Some(t.loads[k].body) {
            pushed = Some(t.loads[k].body);
            let body = &mut bodies[t.loads[k].body];
            body.force = add(body.force, body.load_wake.force);
            body.moment = add(body.moment, body.load_wake.moment);
        }
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
#[inline(always)]
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
#[inline(always)]
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

#[inline(always)]
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

/// Wakes of all drones on all others and on loads, held through a substep as commands are. Needs kinematics.
#[inline(always)]
pub(crate) fn hold_wakes<S: Scalar>(t: &Topology, bodies: &mut [BodyScratch<S>], rotors: &[RotorScratch<S>]) {
    if t.effects.downwash && t.sources.len() > 1 {
        hold_wakes_on_drones(t, bodies, rotors);
    }
    for k in 0..t.loads.len() {
        bodies[t.loads[k].body].load_wake = Wrench::zero();
    }
    for k in 0..t.loads.len() {
        hold_wakes_on_load(t, &t.loads[k], bodies, rotors);
    }
}

#[inline(always)]
fn hold_wakes_on_drones<S: Scalar>(t: &Topology, bodies: &mut [BodyScratch<S>], rotors: &[RotorScratch<S>]) {
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

/// −a T S(T̂)/A of every source, A the area of its rotors and S that of the load as the wake sees it, S/A at most 1.
#[inline(always)]
fn hold_wakes_on_load<S: Scalar>(t: &Topology, load: &Load, bodies: &mut [BodyScratch<S>], rotors: &[RotorScratch<S>]) {
    let (k_r, k_z) = (S::constant(downwash::DEFAULT_RADIAL), S::constant(downwash::DEFAULT_AXIAL));
    let (rotation, position) = (bodies[load.body].rotation, bodies[load.body].position);
    let lever = mat_vec(rotation, constants(load.center));
    let mut force = [S::zero(); 3];
    for s in 0..t.sources.len() {
        let source = &t.sources[s];
        let thrust = thrust_of(source, bodies, rotors, t);
        let along = mat_vec(transpose(rotation), safe::normalise(thrust));
        let share = (facing(load, along) * S::constant(t.per_area[s])).min(S::one());
        let separation = sub(source_position(source, bodies), add(position, lever));
        force = axpy(force, share, downwash::force(separation, thrust, k_r, k_z));
    }
    let held = &mut bodies[load.body].load_wake;
    held.force = add(held.force, force);
    held.moment = add(held.moment, cross(lever, force));
}

/// Area of a load seen along a unit vector of its body's frame, m².
#[inline(always)]
fn facing<S: Scalar>(load: &Load, along: Vec3<S>) -> S {
    let mut area = S::constant(load.end);
    for k in 0..3 {
        let part = dot(constants(load.axes[k]), along);
        if load.faces[k] > 0.0 {
            area = S::constant(load.faces[k]).mul_add(part.abs(), area);
        }
        if k == 2 && load.side > 0.0 {
            let across = safe::sqrt((S::one() - part * part).max(S::zero()), 1e-6);
            area = S::constant(load.side).mul_add(across, area);
        }
    }
    area
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
        let force = scale(rotor.speed * rotor.speed, rotor.model.force);
        thrust = add(thrust, mat_vec(body.rotation, force));
    }
    thrust
}

#[cfg(test)]
mod tests {
    use crate::autodiff::certificate::Bounds;
    use crate::autodiff::{System, certify};
    use crate::dynamics::configurations::{SlungLoad, by_name};
    use crate::dynamics::tree::{Model, Multibody};
    use crate::dynamics::{Effects, Integrator, Physics};
    use std::f64::consts::PI;

    fn system(model: &Model, load_downwash: bool, dt: f64) -> Multibody {
        let effects = Effects { load_downwash, ..Effects::none() };
        let physics = Physics { dt, substeps: 1, integrator: Integrator::SemiImplicit, effects };
        Multibody::new(model, physics).unwrap()
    }

    /// What wakes add to the velocity of the ball in a step, over the step, times its mass: N.
    fn force(load: &SlungLoad, place: [f64; 3]) -> [f64; 3] {
        let model = load.build().unwrap().model;
        let mut after = [[0.0; 3]; 2];
        for (on, after) in [false, true].into_iter().zip(&mut after) {
            let system = system(&model, on, 1e-6);
            let mut x = system.rest_state();
            x[17..20].copy_from_slice(&place);
            x[13..17].fill(500.0);
            let mut next = x.clone();
            system.step(&x, &[0.0; 4], &[], &mut next);
            after.copy_from_slice(&next[20..23]);
        }
        [0, 1, 2].map(|k| (after[1][k] - after[0][k]) / 1e-6 * load.payload_mass)
    }

    #[test]
    fn a_load_under_its_drone_is_pushed_by_the_pressure_of_the_wake_on_the_area_that_faces_it() {
        let load = SlungLoad::default();
        let rotors = &load.drone.rotors;
        let thrust: f64 = rotors.iter().map(|r| r.thrust_coefficient * 500.0 * 500.0).sum();
        let area: f64 = rotors.iter().map(|r| PI * r.radius * r.radius).sum();
        let want = thrust / 1.3_f64.powi(2) * PI * 0.04 * 0.04 / area;
        let got = force(&load, [0.0, 0.0, -1.0]);
        println!("pushed by {:.6} N of {want:.6} N, thrust {thrust:.3} N", -got[2]);
        // what rotors gain in the step, 1.5e-5
        assert!((got[2] + want).abs() < 1e-4 * want && got[0].abs() + got[1].abs() < 1e-9, "{got:?} against {want}");
        // beside the cone and above the drone nothing is felt
        let beside = force(&load, [0.99, 0.0, -0.05]);
        let above = force(&load, [0.0, 0.0, 0.5]);
        assert!(beside[2].abs() < 1e-9 && above == [0.0; 3], "{beside:?}, {above:?}");
        // rotors without a radius are unknown to wakes
        let mut unknown = load.clone();
        unknown.drone.rotors.iter_mut().for_each(|rotor| rotor.radius = 0.0);
        assert_eq!(force(&unknown, [0.0, 0.0, -1.0]), [0.0; 3]);
        // a load wider than the rotors takes no more than the thrust
        let wide = force(&SlungLoad { payload_radius: 0.5, ..load }, [0.0, 0.0, -1.0]);
        assert!((wide[2] + thrust / 1.69).abs() < 1e-4 * thrust, "{wide:?} against {thrust}");
    }

    #[test]
    fn wakes_on_balls_bars_and_boxes_pass_the_gradient_certificate() {
        let slung = SlungLoad::default().build().unwrap().model;
        let others = ["payload", "transport", "platform"].map(|name| by_name(name).unwrap());
        for model in [slung].into_iter().chain(others) {
            let name = model.name().to_string();
            let system = system(&model, true, 0.002);
            let mut x = system.rest_state();
            system.topology().rotor_speed.iter().for_each(|at| x[*at] = 400.0);
            x[3] = 0.2;
            if name == "slung_load" {
                // away from where the cable goes taut, where differences see both sides
                x[19] += 0.05;
            }
            let input = vec![0.1; system.n_input()];
            let pushed = system.topology().loads.len();
            let certificate = certify(&system, &x, &input, &[]).unwrap();
            println!("{name}: {pushed} shapes in the wakes");
            assert!(certificate.holds(Bounds::default()), "{name}: {certificate:?}");
            assert!(pushed > 0, "{name}");
        }
    }
}
