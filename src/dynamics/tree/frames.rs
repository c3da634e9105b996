//! Frames of all bodies by quaternions: what tasks observe.
//!
//! The same chain as in `kinematics`, with attitudes as quaternions and without the biases that accelerations need:
//! q_i = q_p ⊗ q_joint ⊗ q(θ), p_i = p_p + R_p r, v_i = v_p + ω_p × (p_i − p_p), ω_i = ω_p + R_i ω_J.

use super::model::IDENTITY;
use super::parameters::{ParameterView, at, link_parameters};
use super::topology::{Axis, Kind, Link, Topology};
use crate::frame::{FRAME, Frame};
use crate::spatial::*;
use autodiff::{Array, Scalar};

/// Writes the frame of every body, [`FRAME`] numbers each.
pub(crate) fn write<S: Scalar, P: ParameterView<S>>(t: &Topology, numbers: P, x: &[S], out: &mut [S]) {
    for i in 0..t.n_body() {
        let link = &t.links[i];
        let origin = numbers.vector(link_parameters(i) + at::JOINT_POSITION);
        let parent = match link.parent {
            Some(p) => Frame::read(&out[p * FRAME..]),
            None => world(),
        };
        let frame = place(link, origin, x, &parent);
        frame.write(&mut out[i * FRAME..]);
    }
}

#[inline]
fn world<S: Scalar>() -> Frame<S> {
    let o = [S::zero(); 3];
    Frame { position: o, velocity: o, attitude: identity(), angular_velocity: o }
}

fn place<S: Scalar>(link: &Link, origin: Vec3<S>, x: &[S], parent: &Frame<S>) -> Frame<S> {
    if link.kind == Kind::Floating {
        let mut own = Frame::of_vehicle(&x[link.position..]);
        own.attitude = unit(own.attitude);
        return own;
    }
    let fixed = match link.turn {
        Some(turn) if turn != IDENTITY => multiply(parent.attitude, constants(from_matrix::<f64>(turn))),
        _ => parent.attitude,
    };
    let (position, velocity) = if link.coincident { (parent.position, parent.velocity) } else { parent.point(origin) };
    let mut own = Frame { position, velocity, attitude: fixed, angular_velocity: parent.angular_velocity };
    let (angle, rate) = (link.position, link.velocity);
    match link.kind {
        Kind::Hinge(axis) => {
            let axis: Vec3<S> = vector(axis);
            let (s, c) = (x[angle] * S::constant(0.5)).sin_cos();
            own.attitude = multiply(fixed, [c, s * axis[0], s * axis[1], s * axis[2]]);
            own.angular_velocity = axpy(own.angular_velocity, x[rate], rotate(fixed, axis));
        }
        Kind::Slide(axis) => {
            let along = rotate(fixed, vector(axis));
            let shift = scale(x[angle], along);
            own.position = add(own.position, shift);
            let carried = add(own.velocity, cross(parent.angular_velocity, shift));
            own.velocity = axpy(carried, x[rate], along);
        }
        Kind::Ball | Kind::Floating => {
            own.attitude = multiply(fixed, unit(x.array(angle)));
            own.angular_velocity = add(own.angular_velocity, rotate(own.attitude, x.array(rate)));
        }
    }
    own
}

/// An axis as a vector.
fn vector<S: Scalar>(axis: Axis) -> Vec3<S> {
    let (o, l) = (S::zero(), S::one());
    match axis {
        Axis::X => [l, o, o],
        Axis::Y => [o, l, o],
        Axis::Z => [o, o, l],
        Axis::General(a) => constants(a),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::configurations;
    use crate::tree::Motion;
    use crate::tree::kinematics::forward;
    use crate::tree::parameters::{Source, model_parameters};
    use crate::tree::scratch::scratch_on_stack;
    use autodiff::safe;
    use rng::{Purpose, Stream};

    #[test]
    fn frames_are_those_of_the_kinematics_that_accelerations_use() {
        let mut worst = 0.0_f64;
        for model in configurations::all().unwrap() {
            let t = Topology::bare(&model);
            let numbers = model_parameters(&model);
            let mut r = Stream::new(9, 0, 0, Purpose::user(9));
            for _ in 0..20 {
                let mut x: Vec<f64> = (0..t.n_state).map(|_| r.uniform(-1.0, 1.0)).collect();
                for (body, place) in model.bodies().iter().zip(&model.layout().bodies) {
                    let first = match body.joint.motion {
                        Motion::Floating => place.position + 6,
                        Motion::Ball => place.position,
                        Motion::Revolute(_) | Motion::Prismatic(_) => continue,
                    };
                    let unit = safe::normalise([x[first], x[first + 1], x[first + 2], x[first + 3]]);
                    x[first..first + 4].copy_from_slice(&unit);
                }
                let mut out = vec![0.0; t.n_body() * FRAME];
                write(&t, Source::Constants(&numbers), &x, &mut out[..]);
                scratch_on_stack!(scratch, &t, f64);
                forward(&t, Source::Constants(&numbers), &x, scratch.bodies);
                for i in 0..t.n_body() {
                    let (frame, body) = (Frame::read(&out[i * FRAME..]), &scratch.bodies[i]);
                    for k in 0..3 {
                        worst = worst.max((frame.position[k] - body.position[k]).abs());
                        worst = worst.max((frame.velocity[k] - body.velocity[k]).abs());
                        worst = worst.max((frame.angular_velocity[k] - body.angular_velocity[k]).abs());
                        let (a, b) = (matrix(frame.attitude)[k], body.rotation[k]);
                        worst = (0..3).fold(worst, |w, j| w.max((a[j] - b[j]).abs()));
                    }
                }
            }
        }
        println!("frames against kinematics {worst:.1e}");
        assert!(worst < 1e-12, "{worst:e}"); // measured 2.4e-15
    }
}
