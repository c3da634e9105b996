//! Contract: the forces that inverse dynamics finds for our accelerations are those that acted.
//!
//! The inverse is Newton's and Euler's equations body by body in the world, summed from the leaves along the tree
//! (recursive Newton–Euler, without articulated inertias): nothing of the forward algorithm is in it.

use super::common::*;
use super::models;
use crate::common::measure::larger;
use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use omnidrones::dynamics::tree::{Body, BodyPlace, Motion, Multibody};

type V = Vector3<f64>;

/// A body's frame in the world and how it moves.
#[derive(Clone, Copy)]
struct Frame {
    rotation: Matrix3<f64>,
    position: V,
    acceleration: V,
    spin: V,
    spin_rate: V,
}

const GROUND: Frame = Frame {
    rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
    position: V::new(0.0, 0.0, 0.0),
    acceleration: V::new(0.0, 0.0, 0.0),
    spin: V::new(0.0, 0.0, 0.0),
    spin_rate: V::new(0.0, 0.0, 0.0),
};

/// The joint's frame at q = 0.
fn joint_frame(up: &Frame, body: &Body) -> Matrix3<f64> {
    up.rotation * Matrix3::from_fn(|i, j| body.joint.rotation[i][j])
}

/// Where a body is and how it moves, from its parent's motion, the state and its rate.
fn moved(up: &Frame, body: &Body, place: &BodyPlace, x: &[f64], rate: &[f64]) -> Frame {
    let (p, v, o) = (place.position, place.velocity, V::zeros());
    let frame = joint_frame(up, body);
    let anchor = up.rotation * V::from(body.joint.position);
    // of the joint: rotation, turning and its rate, slipping and its rate, reach from the parent's origin
    let (rotation, turn, turn_rate, slip, slip_rate, reach) = match body.joint.motion {
        Motion::Floating => {
            let rotation = quaternion(x, p + 6).to_rotation_matrix().into_inner();
            return Frame {
                rotation,
                position: vector(x, p),
                acceleration: vector(rate, v),
                spin: rotation * vector(x, p + 10),
                spin_rate: rotation * vector(rate, p + 10),
            };
        }
        Motion::Revolute(a) => {
            let turned = Rotation3::from_axis_angle(&Unit::new_normalize(V::from(a)), x[p]);
            let axis = frame * V::from(a);
            (frame * turned.into_inner(), axis * x[v], axis * rate[v], o, o, anchor)
        }
        Motion::Prismatic(a) => {
            let axis = frame * V::from(a);
            (frame, o, o, axis * x[v], axis * rate[v], anchor + axis * x[p])
        }
        Motion::Ball => {
            let rotation = frame * quaternion(x, p).to_rotation_matrix().into_inner();
            (rotation, rotation * vector(x, v), rotation * vector(rate, v), o, o, anchor)
        }
    };
    Frame {
        rotation,
        position: up.position + reach,
        acceleration: up.acceleration
            + up.spin_rate.cross(&reach)
            + up.spin.cross(&up.spin.cross(&reach))
            + up.spin.cross(&slip) * 2.0
            + slip_rate,
        spin: up.spin + turn,
        spin_rate: up.spin_rate + turn_rate + up.spin.cross(&turn),
    }
}

/// Force, and moment about the body's origin, that a body alone needs besides its weight.
fn needed(body: &Body, frame: &Frame, gravity: f64) -> (V, V) {
    let (w, w_rate) = (frame.spin, frame.spin_rate);
    let c = frame.rotation * V::from(body.center_of_mass);
    let inertia = frame.rotation * body.inertia.matrix() * frame.rotation.transpose();
    let acceleration = frame.acceleration + w_rate.cross(&c) + w.cross(&w.cross(&c));
    let force = (acceleration + V::new(0.0, 0.0, gravity)) * body.mass;
    (force, inertia * w_rate + w.cross(&(inertia * w)) + c.cross(&force))
}

/// How far what a joint passes on is from what its damper, spring and motor's inertia give; all of it on a floating body.
fn unbalanced(
    body: &Body,
    place: &BodyPlace,
    (x, rates): (&[f64], &[f64]),
    frame: &Matrix3<f64>,
    own: &Matrix3<f64>,
    load: (V, V),
) -> f64 {
    let (p, v, joint, (force, moment)) = (place.position, place.velocity, &body.joint, load);
    let given = || -joint.damping * x[v] - joint.stiffness * (x[p] - joint.rest) - joint.armature * rates[v];
    match joint.motion {
        Motion::Floating => force.norm().max(moment.norm()),
        Motion::Revolute(a) => ((frame * V::from(a)).dot(&moment) - given()).abs(),
        Motion::Prismatic(a) => ((frame * V::from(a)).dot(&force) - given()).abs(),
        Motion::Ball => {
            let sine = vector(x, p + 1) * (2.0 * x[p]);
            (own.transpose() * moment + vector(x, v) * joint.damping + sine * joint.stiffness).norm()
        }
    }
}

/// Largest unbalanced force or moment over the largest product of an inertia and an acceleration, or force on a joint: what
/// rounding is relative to.
fn residual(system: &Multibody, x: &[f64], rate: &[f64]) -> f64 {
    let (bodies, places) = (system.model().bodies(), &system.layout().bodies);
    let gravity = system.model().parts().gravity;
    let mut frames: Vec<Frame> = Vec::new();
    for (body, place) in bodies.iter().zip(places) {
        let up = body.parent.map_or(GROUND, |k| frames[k]);
        frames.push(moved(&up, body, place, x, rate));
    }
    let mut loads: Vec<(V, V)> = bodies.iter().zip(&frames).map(|(b, f)| needed(b, f, gravity)).collect();
    let sizes = bodies.iter().zip(&frames).map(|(b, f)| {
        let turning = b.inertia.matrix().norm() * f.spin_rate.norm();
        turning.max(b.mass * f.acceleration.norm())
    });
    let mut scale = sizes.fold(0.0, f64::max);
    for (mounted, at) in system.model().rotors().iter().zip(&system.layout().rotor_speed) {
        let (rotor, rotation) = (&mounted.rotor, frames[mounted.body].rotation);
        let thrust = rotation * V::from(rotor.axis) * (rotor.thrust_coefficient * x[*at] * x[*at]);
        let arm = rotation * V::from(rotor.position);
        scale = scale.max(thrust.norm());
        loads[mounted.body].0 -= thrust;
        loads[mounted.body].1 -= arm.cross(&thrust) - thrust * (rotor.spin * rotor.moment_per_thrust);
    }
    let mut worst = 0.0_f64;
    for i in (0..bodies.len()).rev() {
        let up = bodies[i].parent.map_or(GROUND, |k| frames[k]);
        let (force, moment) = loads[i];
        scale = scale.max(force.norm()).max(moment.norm());
        let frame = joint_frame(&up, &bodies[i]);
        worst = larger(worst, unbalanced(&bodies[i], &places[i], (x, rate), &frame, &frames[i].rotation, loads[i]));
        if let Some(k) = bodies[i].parent {
            let arm = frames[i].position - frames[k].position;
            loads[k].0 += force;
            loads[k].1 += moment + arm.cross(&force);
        }
    }
    worst / scale
}

#[test]
fn inverse_dynamics_of_our_accelerations_gives_back_what_acted() {
    for model in models::all().into_iter().chain(models::combined()) {
        let system = bare(&model);
        let mut stream = stream(5);
        let mut worst = 0.0_f64;
        for _ in 0..1000 {
            let x = random_state(&system, &mut stream);
            worst = larger(worst, residual(&system, &x, &derivative(&system, &x)));
        }
        // measured 1.1e-13, the pendulum on a Crazyflie
        at_most(&format!("{}: RNEA of ABA", model.name()), worst, 1e-12);
        // twin: one acceleration off by a millionth
        let x = random_state(&system, &mut stream);
        let mut rate = derivative(&system, &x);
        let last = system.layout().bodies.last().unwrap();
        rate[last.velocity] += 1e-6 * (1.0 + rate[last.velocity].abs());
        let defect = residual(&system, &x, &rate);
        assert!(defect > 1e-10, "{}: {defect:.3e}", model.name());
    }
}
