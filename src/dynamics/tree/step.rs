//! One step of an articulated system, or its time derivative.
//!
//! As for the closed-form multirotor: RK4 with quaternions renormalised, or semi-implicit Euler with gyroscopic moments,
//! damping, springs and limits implicit. Rotor lag has its closed form. Drives are sampled once per substep: an implicit
//! evaluation (h d + h² k added to the inertia that each drive moves) finds the torques, a second one those of the others
//! where some have reached their bound; then they are held, so that a stiff servo is stable at any step. Damping and
//! springs of hinges and slides too fast for RK4 are sampled with them; those of ball joints are explicit in RK4. Friction
//! that sticks is sampled and held alike (see `contact_loads`). Wakes are held through a substep too.
//!
//! Everything evaluates accelerations at one place, in a loop over stages: the kernels are large, and each copy of them
//! would be compiled again for every scalar.

use super::aba::accelerate;
use super::contact_loads::{self, Friction};
use super::kinematics::forward;
use super::loads;
use super::parameters::ParameterView;
use super::scratch::Scratch;
use super::topology::{Kind, Topology};
use super::torque::{self, Drives, Pass};
use super::wakes;
use crate::integrate::{Grid, Integrator};
use crate::spatial::{derivative, unit};
use autodiff::Scalar;

/// What to do with accelerations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Task {
    /// Replace the state in `end` by that after one step.
    Step(Grid),
    /// Leave d/dt of the state in `end` in `rate`, drives in continuous time.
    Derivative,
}

/// The stages of a substep: torques without their bounds, torques with those that are reached, then four of RK4 or the
/// one of the semi-implicit step, which keeps torques below their bound implicit and needs no second pass for them.
const SAMPLE: usize = 0;
const SETTLE: usize = 1;
const FIRST: usize = 2;

/// Does the task with `s.input` held.
pub(crate) fn run<S: Scalar, P: ParameterView<S>>(t: &Topology, numbers: P, task: Task, s: &mut Scratch<'_, S>) {
    let (h, substeps, n_stage) = match task {
        Task::Step(Grid { integrator: Integrator::RungeKutta4, substep, substeps }) => (substep, substeps, 4),
        Task::Step(grid) => (grid.substep, grid.substeps, 1),
        Task::Derivative => (1.0, 1, 1),
    };
    let semi_implicit = n_stage == 1 && task != Task::Derivative;
    let sticks = t.sticks && task != Task::Derivative;
    let begin = if (t.holds_torque || sticks) && task != Task::Derivative { SAMPLE } else { FIRST };
    loads::prepare_rotors(t, numbers, s.input, s.rotors);
    let is_step = task != Task::Derivative;
    for _ in 0..substeps {
        if is_step {
            S::begin_function();
        }
        loads::start_rotors(t, numbers, h, s.end, s.rotors);
        for k in 0..t.n_state {
            s.start[k] = s.end[k];
            s.at[k] = s.end[k];
        }
        for r in 0..t.n_rotor() {
            s.rate[t.rotor_speed[r]] = S::zero();
        }
        for stage in begin..FIRST + n_stage {
            if (semi_implicit || !t.holds_torque) && stage == SETTLE {
                continue;
            }
            if semi_implicit && stage == FIRST {
                loads::advance_rotors(t, s.rotors);
            }
            let friction = match sticks {
                false => Friction::Explicit,
                true if stage == SAMPLE => Friction::Sampled(h),
                true => Friction::Held(h),
            };
            let pass = match task {
                Task::Derivative => Pass { implicit: 0.0, drives: Drives::Continuous, friction },
                Task::Step(_) if stage == SAMPLE => Pass { implicit: 0.0, drives: Drives::Sampled(h), friction },
                Task::Step(_) => Pass { implicit: if semi_implicit { h } else { 0.0 }, drives: Drives::Held, friction },
            };
            if stage == begin {
                forward(t, numbers, s.at, s.bodies);
                wakes::hold(t, s.bodies, s.rotors);
            }
            // up to the first stage the state stays as it was, and what was made of it is used again
            let is_function = is_step && stage > FIRST;
            if is_function {
                S::begin_function();
                forward(t, numbers, s.at, s.bodies);
            }
            loads::apply(t, numbers, s.input, friction, s.bodies, s.rotors);
            accelerate(t, numbers, s.at, s.input, pass, s.bodies, s.rate);
            if is_function {
                S::end_function(&mut s.rate[..t.n_state]);
            }
            if sticks && stage == SAMPLE {
                contact_loads::settle(t, numbers, h, s.bodies);
            }
            if stage < FIRST {
                hold_torques(t, numbers, stage, h, s);
            } else if semi_implicit {
                loads::advance_rotors(t, s.rotors);
                velocities_then_positions(t, h, s);
            } else if task != Task::Derivative {
                runge_kutta_stage(t, stage - FIRST, h, s);
            }
        }
        if task == Task::Derivative {
            rotor_rates(t, s);
        } else {
            finish(t, s);
        }
        if is_step {
            S::end_function(&mut s.end[..t.n_state]);
        }
    }
}

fn hold_torques<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    numbers: P,
    stage: usize,
    h: f64,
    s: &mut Scratch<'_, S>,
) {
    for i in 0..t.n_body() {
        let link = &t.links[i];
        if link.drive.is_some() || link.stiff {
            let found = (s.rate[link.velocity], h);
            s.bodies[i].held = if stage == SAMPLE {
                torque::split(link, i, numbers, (s.at, s.input), found)
            } else {
                torque::settle(link, i, numbers, s.at, s.bodies[i].held, found)
            };
        }
    }
}

/// Adds a stage's share and moves on to where the next one is evaluated.
fn runge_kutta_stage<S: Scalar>(t: &Topology, stage: usize, h: f64, s: &mut Scratch<'_, S>) {
    let weight = [h / 6.0, h / 3.0, h / 3.0, h / 6.0];
    let ahead = [0.5 * h, 0.5 * h, h, 0.0];
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

/// Velocities first, then positions with the new ones.
fn velocities_then_positions<S: Scalar>(t: &Topology, h: f64, s: &mut Scratch<'_, S>) {
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
#[inline]
fn turn<S: Scalar>(s: &mut Scratch<'_, S>, q: usize, w: usize, step: S) {
    let attitude = [s.at[q], s.at[q + 1], s.at[q + 2], s.at[q + 3]];
    let turning = derivative(attitude, [s.end[w], s.end[w + 1], s.end[w + 2]]);
    for k in 0..4 {
        s.end[q + k] = step.mul_add(turning[k], attitude[k]);
    }
}

/// Unit quaternions, and the rotor speeds that their closed form has reached.
fn finish<S: Scalar>(t: &Topology, s: &mut Scratch<'_, S>) {
    for i in 0..t.n_body() {
        let q = match t.links[i].kind {
            Kind::Floating => t.links[i].position + 6,
            Kind::Ball => t.links[i].position,
            Kind::Hinge(_) | Kind::Slide(_) => continue,
        };
        let attitude = unit([s.end[q], s.end[q + 1], s.end[q + 2], s.end[q + 3]]);
        for k in 0..4 {
            s.end[q + k] = attitude[k];
        }
    }
    for r in 0..t.n_rotor() {
        s.end[t.rotor_speed[r]] = s.rotors[r].speed;
    }
}

#[inline]
fn rotor_rates<S: Scalar>(t: &Topology, s: &mut Scratch<'_, S>) {
    for r in 0..t.n_rotor() {
        let rotor = &s.rotors[r];
        s.rate[t.rotor_speed[r]] = rotor.lag.acceleration(rotor.speed);
    }
}
