//! One step of an articulated system.
//!
//! As for the closed-form multirotor: RK4 with quaternions renormalised, or semi-implicit Euler with gyroscopic moments,
//! damping, springs and limits implicit. Rotor lag has its closed form. Drives are sampled once per substep: an implicit
//! evaluation (h d + h² k added to the inertia that each drive moves) finds the torque, which is bounded and held, so that
//! a stiff servo is stable at any step. Wakes are held through a substep too.

use super::aba::accelerate;
use super::kinematics::forward;
use super::loads;
use super::numbers::Numbers;
use super::scratch::Scratch;
use super::topology::{Kind, Topology};
use super::torque::{self, Drives, Pass};
use crate::autodiff::Scalar;
use crate::dynamics::integrate::{Grid, Integrator};
use crate::dynamics::spatial::unit;

/// Replaces the state in `s.end` by x⁺ after one step with `s.input` held.
#[inline(always)]
pub(crate) fn step_in_place<S: Scalar, P: Numbers<S>>(t: &Topology, numbers: P, grid: Grid, s: &mut Scratch<'_, S>) {
    loads::prepare_rotors(t, numbers, s.input, s.rotors);
    for _ in 0..grid.substeps {
        substep(t, numbers, grid, s);
    }
}

#[inline(always)]
fn substep<S: Scalar, P: Numbers<S>>(t: &Topology, numbers: P, grid: Grid, s: &mut Scratch<'_, S>) {
    let h = grid.substep;
    loads::start_rotors(t, numbers, h, s.end, s.rotors);
    let starts_early = t.has_drives || (t.effects.downwash && t.sources.len() > 1);
    if starts_early {
        forward(t, numbers, s.end, s.bodies);
        loads::hold_wakes(t, s.bodies, s.rotors);
    }
    if t.has_drives {
        sample_drives(t, numbers, h, s);
    }
    for k in 0..t.n_state {
        s.at[k] = s.end[k];
        s.start[k] = s.end[k];
    }
    match grid.integrator {
        Integrator::RungeKutta4 => runge_kutta_4(t, numbers, h, s),
        Integrator::SemiImplicit => semi_implicit(t, numbers, h, s),
    }
    normalise(t, s.end);
    for r in 0..t.n_rotor() {
        s.end[t.rotor_speed[r]] = s.rotors[r].speed;
    }
}

#[inline(always)]
fn sample_drives<S: Scalar, P: Numbers<S>>(t: &Topology, numbers: P, h: f64, s: &mut Scratch<'_, S>) {
    loads::apply(t, numbers, s.input, s.bodies, s.rotors);
    let pass = Pass { implicit: 0.0, drives: Drives::Sampled(h) };
    accelerate(t, numbers, s.end, s.input, pass, s.bodies, s.rate);
    for i in 0..t.n_body() {
        let link = &t.links[i];
        if let Some(servo) = &link.drive {
            let sampled = (s.rate[link.velocity], h);
            s.bodies[i].drive = torque::held(link, servo, i, numbers, s.end, s.input, sampled);
        }
    }
}

/// d/dt of `s.at` into `s.rate`, rotor speeds as they stand in `s.rotors`.
#[inline(always)]
fn evaluate<S: Scalar, P: Numbers<S>>(t: &Topology, numbers: P, pass: Pass, s: &mut Scratch<'_, S>) {
    forward(t, numbers, s.at, s.bodies);
    loads::apply(t, numbers, s.input, s.bodies, s.rotors);
    accelerate(t, numbers, s.at, s.input, pass, s.bodies, s.rate);
}

#[inline(always)]
fn runge_kutta_4<S: Scalar, P: Numbers<S>>(t: &Topology, numbers: P, h: f64, s: &mut Scratch<'_, S>) {
    let pass = Pass { implicit: 0.0, drives: Drives::Held };
    let weight = [h / 6.0, h / 3.0, h / 3.0, h / 6.0];
    let ahead = [0.5 * h, 0.5 * h, h, 0.0];
    for r in 0..t.n_rotor() {
        s.rate[t.rotor_speed[r]] = S::zero();
    }
    // a loop, not four copies: a quarter of the code to compile and to keep in the instruction cache
    for stage in 0..4 {
        evaluate(t, numbers, pass, s);
        if stage == 0 || stage == 2 {
            loads::advance_rotors(t, s.rotors);
        }
        let (w, a) = (S::constant(weight[stage]), S::constant(ahead[stage]));
        for k in 0..t.n_state {
            let rate = s.rate[k];
            s.at[k] = a.mul_add(rate, s.start[k]);
            s.end[k] = w.mul_add(rate, s.end[k]);
        }
    }
}

/// Velocities first, then positions with the new ones.
#[inline(always)]
fn semi_implicit<S: Scalar, P: Numbers<S>>(t: &Topology, numbers: P, h: f64, s: &mut Scratch<'_, S>) {
    let pass = Pass { implicit: h, drives: Drives::Held };
    loads::advance_rotors(t, s.rotors);
    evaluate(t, numbers, pass, s);
    loads::advance_rotors(t, s.rotors);
    let step = S::constant(h);
    for i in 0..t.n_body() {
        let (p, v) = (t.links[i].position, t.links[i].velocity);
        match t.links[i].kind {
            Kind::Floating => {
                for k in 0..3 {
                    s.end[p + 3 + k] = step.mul_add(s.rate[p + 3 + k], s.at[p + 3 + k]);
                    s.end[p + 10 + k] = step.mul_add(s.rate[p + 10 + k], s.at[p + 10 + k]);
                    s.end[p + k] = step.mul_add(s.end[p + 3 + k], s.at[p + k]);
                }
                turn(s, p + 6, p + 10, step);
            }
            Kind::Hinge(_) | Kind::Slide(_) => {
                s.end[v] = step.mul_add(s.rate[v], s.at[v]);
                s.end[p] = step.mul_add(s.end[v], s.at[p]);
            }
            Kind::Ball => {
                for k in 0..3 {
                    s.end[v + k] = step.mul_add(s.rate[v + k], s.at[v + k]);
                }
                turn(s, p, v, step);
            }
        }
    }
}

/// The quaternion at `q` turned by the new angular velocity at `w`.
#[inline(always)]
fn turn<S: Scalar>(s: &mut Scratch<'_, S>, q: usize, w: usize, step: S) {
    let attitude = [s.at[q], s.at[q + 1], s.at[q + 2], s.at[q + 3]];
    let turning = crate::dynamics::spatial::derivative(attitude, [s.end[w], s.end[w + 1], s.end[w + 2]]);
    for k in 0..4 {
        s.end[q + k] = step.mul_add(turning[k], attitude[k]);
    }
}

#[inline(always)]
fn normalise<S: Scalar>(t: &Topology, x: &mut [S]) {
    for i in 0..t.n_body() {
        let q = match t.links[i].kind {
            Kind::Floating => t.links[i].position + 6,
            Kind::Ball => t.links[i].position,
            Kind::Hinge(_) | Kind::Slide(_) => continue,
        };
        let attitude = unit([x[q], x[q + 1], x[q + 2], x[q + 3]]);
        for k in 0..4 {
            x[q + k] = attitude[k];
        }
    }
}

/// d/dt of state x in continuous time into `rate`: what a step integrates.
#[inline(always)]
pub(crate) fn derivative<S: Scalar, P: Numbers<S>>(
    t: &Topology,
    numbers: P,
    x: &[S],
    input: &[S],
    s: &mut Scratch<'_, S>,
    rate: &mut [S],
) {
    loads::prepare_rotors(t, numbers, input, s.rotors);
    loads::start_rotors(t, numbers, 1.0, x, s.rotors);
    forward(t, numbers, x, s.bodies);
    loads::hold_wakes(t, s.bodies, s.rotors);
    loads::apply(t, numbers, input, s.bodies, s.rotors);
    let pass = Pass { implicit: 0.0, drives: Drives::Continuous };
    accelerate(t, numbers, x, input, pass, s.bodies, rate);
    for r in 0..t.n_rotor() {
        let rotor = &s.rotors[r];
        rate[t.rotor_speed[r]] = (rotor.target - rotor.speed) * rotor.rate;
    }
}
