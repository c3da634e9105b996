//! What joints do by themselves: damping, springs, soft limits, drives.
//!
//! Each torque comes as a pair (τ, s): the value, and how much an acceleration over the step ahead changes it, so that
//! the joint obeys τ − s q̈. With s = 0 the torque is explicit; the inertia of a geared motor is an s of its own.

use super::contact_loads::Friction;
use super::parameters::{ParameterView, at, link_parameters};
use super::topology::{Link, Servo};
use crate::spatial::*;
use autodiff::Scalar;

/// How an evaluation treats joint torques.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pass {
    /// Step over which damping, springs, limits and gyroscopic moments act implicitly, s; 0 for explicit.
    pub implicit: f64,
    pub drives: Drives,
    pub friction: Friction,
}

/// How an evaluation treats drives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Drives {
    /// In continuous time.
    Continuous,
    /// Implicitly over a step of so many seconds, without the torque bound.
    Sampled(f64),
    /// The torque that was sampled.
    Held,
}

/// (τ, s) of a hinge or slide.
pub(crate) fn of_axis<S: Scalar, P: ParameterView<S>>(
    link: &Link,
    body: usize,
    numbers: P,
    x: &[S],
    input: &[S],
    held: (S, S),
    pass: Pass,
) -> (S, S) {
    let (q, rate) = (x[link.position], x[link.velocity]);
    let n = link_parameters(body);
    let h = S::constant(pass.implicit);
    let (mut torque, mut slope) = (S::zero(), S::zero());
    let step = match pass.drives {
        Drives::Sampled(step) if link.stiff => step,
        _ => pass.implicit,
    };
    let is_held = link.stiff && pass.drives == Drives::Held;
    if (link.damped || link.sprung) && !is_held {
        (torque, slope) = spring(numbers, n, q, rate, step);
    }
    if is_held {
        (torque, slope) = held;
    }
    if link.limited {
        let (more, steeper) = limits(numbers, n, q, rate, h);
        torque += more;
        slope += steeper;
    }
    if link.geared {
        slope += numbers.get(n + at::ARMATURE);
    }
    if let Some(servo) = &link.drive {
        match pass.drives {
            Drives::Held if is_held => {}
            Drives::Held => {
                torque += held.0;
                slope += held.1;
            }
            Drives::Continuous => {
                let (wanted, _) = servo_torque(servo, numbers, n, q, rate, input, 0.0);
                torque += bounded(numbers, n, wanted);
            }
            Drives::Sampled(step) => {
                let (wanted, steeper) = servo_torque(servo, numbers, n, q, rate, input, step);
                torque += wanted;
                slope += steeper;
            }
        }
    }
    (torque, slope)
}

/// τ = −d q̇ − k (q + h q̇ − rest) and s = h d + h² k.
#[inline]
fn spring<S: Scalar, P: ParameterView<S>>(numbers: P, n: usize, q: S, rate: S, step: f64) -> (S, S) {
    let [damping, stiffness, rest] = numbers.vector(n + at::SPRING);
    let h = S::constant(step);
    let ahead = h.mul_add(rate, q);
    let torque = -(damping.mul_add(rate, stiffness * (ahead - rest)));
    (torque, h * h.mul_add(stiffness, damping))
}

/// k δ (1 + d δ̇)₊ at either end.
fn limits<S: Scalar, P: ParameterView<S>>(numbers: P, n: usize, q: S, rate: S, h: S) -> (S, S) {
    let (o, l) = (S::zero(), S::one());
    let (lower, upper) = (numbers.get(n + at::LIMITS), numbers.get(n + at::LIMITS + 1));
    let (stiffness, dissipation) = (numbers.get(n + at::LIMITS + 2), numbers.get(n + at::LIMITS + 3));
    let (below, above) = ((lower - q).max(o), (q - upper).max(o));
    let (out, into) = ((-dissipation).mul_add(rate, l).max(o), dissipation.mul_add(rate, l).max(o));
    let torque = stiffness * (below * out - above * into);
    // slopes against q and q̇ where a stop is touched
    let by_position = stiffness * (S::select(o.lt(below), out, o) + S::select(o.lt(above), into, o));
    let by_rate = stiffness * dissipation * (S::select(o.lt(out), below, o) + S::select(o.lt(into), above, o));
    let lag = h * by_position;
    ((-lag).mul_add(rate, torque), h * (lag + by_rate))
}

/// τ = k (q_target − q − h q̇) + d (q̇_target − q̇) and s = h d + h² k.
fn servo_torque<S: Scalar, P: ParameterView<S>>(
    servo: &Servo,
    numbers: P,
    n: usize,
    q: S,
    rate: S,
    input: &[S],
    step: f64,
) -> (S, S) {
    let (l, h) = (S::one(), S::constant(step));
    let command = input[servo.command].clamp(-l, l);
    let target = command.mul_add(S::constant(servo.range), S::constant(servo.center));
    let (stiffness, damping) = (numbers.get(n + at::DRIVE), numbers.get(n + at::DRIVE + 1));
    let slope = h * h.mul_add(stiffness, damping);
    if servo.holds_position {
        let ahead = h.mul_add(rate, q);
        (stiffness.mul_add(target - ahead, -(damping * rate)), slope)
    } else {
        (damping * (target - rate), slope)
    }
}

/// A drive's torque within its bound.
#[inline]
fn bounded<S: Scalar, P: ParameterView<S>>(numbers: P, n: usize, torque: S) -> S {
    let most = numbers.get(n + at::DRIVE + 2);
    torque.clamp(-most, most)
}

/// What drive, and stiff damping and spring, of a joint give through a substep, from the `acceleration` that an implicit
/// pass without bounds found: a drive over its bound gives the bound, all else stays implicit.
pub(crate) fn split<S: Scalar, P: ParameterView<S>>(
    link: &Link,
    body: usize,
    numbers: P,
    (x, input): (&[S], &[S]),
    (acceleration, step): (S, f64),
) -> (S, S) {
    let n = link_parameters(body);
    let (q, rate) = (x[link.position], x[link.velocity]);
    let (mut torque, mut slope) = (S::zero(), S::zero());
    if let Some(servo) = &link.drive {
        let (wanted, steep) = servo_torque(servo, numbers, n, q, rate, input, step);
        let free = (-steep).mul_add(acceleration, wanted);
        let within = free.abs().lt(numbers.get(n + at::DRIVE + 2));
        torque = S::select(within, wanted, bounded(numbers, n, free));
        slope = S::select(within, steep, slope);
    }
    if link.stiff {
        let (more, steeper) = spring(numbers, n, q, rate, step);
        torque += more;
        slope += steeper;
    }
    (torque, slope)
}

/// The torque that a joint then holds, from the acceleration that the pass with [`split`] torques found.
pub(crate) fn settle<S: Scalar, P: ParameterView<S>>(
    link: &Link,
    body: usize,
    numbers: P,
    x: &[S],
    (torque, slope): (S, S),
    (acceleration, step): (S, f64),
) -> (S, S) {
    let n = link_parameters(body);
    let total = (-slope).mul_add(acceleration, torque);
    let mut passive = S::zero();
    if link.stiff {
        let (more, steeper) = spring(numbers, n, x[link.position], x[link.velocity], step);
        passive = (-steeper).mul_add(acceleration, more);
    }
    let held = if link.drive.is_some() { bounded(numbers, n, total - passive) + passive } else { total };
    (held, S::zero())
}

/// Moment (world) and slope of a ball joint: −d ω_rel and the spring −k sin θ about the axis of rotation.
pub(crate) fn of_ball<S: Scalar, P: ParameterView<S>>(
    link: &Link,
    body: usize,
    numbers: P,
    x: &[S],
    rotation: &Mat3<S>,
    pass: Pass,
) -> (Vec3<S>, S) {
    if !(link.damped || link.sprung) {
        return ([S::zero(); 3], S::zero());
    }
    let [damping, stiffness, _] = numbers.vector(link_parameters(body) + at::SPRING);
    let rate = [x[link.velocity], x[link.velocity + 1], x[link.velocity + 2]];
    let mut own = scale(-damping, rate);
    let h = S::constant(pass.implicit);
    let mut slope = h * damping;
    if link.sprung {
        let q = link.position;
        let attitude = unit([x[q], x[q + 1], x[q + 2], x[q + 3]]);
        // sin θ n = 2 w v, the same in both frames
        let sine = scale(attitude[0] + attitude[0], [attitude[1], attitude[2], attitude[3]]);
        own = axpy(own, -stiffness, axpy(sine, h, rate));
        slope = h.mul_add(h * stiffness, slope);
    }
    (mat_vec(*rotation, own), slope)
}
