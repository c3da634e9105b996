//! One step of the rigid multirotor: RK4, or semi-implicit Euler with an implicit gyroscopic term.
//!
//! The rotor lag is not integrated: both use its closed form ([`rotor`](super::rotor)), so it does not depend on
//! the step. Explicit Euler in ω is not offered; it gains energy without bound.

use super::rigid::{Disturbance, Effects, Motion, RigidModel, RigidState, RotorPath, full, symmetric_times};
use super::spatial::*;
use super::vehicle::MAX_ROTORS;
use autodiff::Scalar;
use serde::{Deserialize, Serialize};

/// How a step is integrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Integrator {
    /// Classical Runge–Kutta, fourth order, then the quaternion renormalised.
    #[default]
    #[serde(rename = "rk4")]
    RungeKutta4,
    /// Semi-implicit Euler, first order, half the work: ω by one Newton step of the implicit gyroscopic equation in the body frame,
    /// J(ω⁺ − ω) + h ω⁺ × (Jω⁺ + H) = h M with the substep h (Catto 2015), then velocity, then position and attitude with the new ones.
    SemiImplicit,
}

/// Time grid of a step: `substeps` integrator steps of `substep` seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)]
pub struct Grid {
    pub integrator: Integrator,
    pub substep: f64,
    pub substeps: usize,
}

/// x⁺ after one step with rotor `action` in [−1, 1] and `air` held.
#[inline(always)]
pub fn step<S: Scalar, const R: usize>(
    model: &RigidModel<S, R>,
    effects: Effects,
    grid: Grid,
    x: &RigidState<S, R>,
    action: &[S; R],
    air: &Disturbance<S>,
) -> RigidState<S, R> {
    let target = model.target_speed(action);
    let mut motion = model.center_of_mass_motion(x);
    let mut speed = x.rotor_speed;
    for _ in 0..grid.substeps {
        S::begin_function();
        let path = model.rotor_path(speed, target);
        motion = match grid.integrator {
            Integrator::RungeKutta4 => runge_kutta_4(model, effects, grid.substep, &motion, &path, air),
            Integrator::SemiImplicit => semi_implicit(model, effects, grid.substep, &motion, &path, air),
        };
        speed = path.end;
        end_substep(&mut motion, &mut speed);
    }
    model.base_origin_state(&motion, speed)
}

/// What a recorded substep gives: motion and rotor speeds.
#[inline(always)]
fn end_substep<S: Scalar, const R: usize>(m: &mut Motion<S>, speed: &mut [S; R]) {
    const { assert!(R <= MAX_ROTORS) };
    let mut all = [S::zero(); 13 + MAX_ROTORS];
    write_motion([m.position, m.velocity, m.angular_velocity], m.attitude, &mut all);
    for r in 0..R {
        all[13 + r] = speed[r];
    }
    S::end_function(&mut all[..13 + R]);
    let ([position, velocity, angular_velocity], attitude) = read_motion(&all);
    *m = Motion { position, velocity, attitude, angular_velocity };
    for r in 0..R {
        speed[r] = all[13 + r];
    }
}

/// What a recorded stage gives.
#[inline(always)]
fn end_stage<S: Scalar>(k: &mut Rate<S>) {
    let mut all = [S::zero(); 13];
    write_motion([k.position, k.velocity, k.angular_velocity], k.attitude, &mut all);
    S::end_function(&mut all);
    let ([position, velocity, angular_velocity], attitude) = read_motion(&all);
    *k = Rate { position, velocity, attitude, angular_velocity };
}

#[inline(always)]
fn write_motion<S: Scalar>(vectors: [Vec3<S>; 3], attitude: Quat<S>, all: &mut [S]) {
    for i in 0..3 {
        for k in 0..3 {
            all[3 * i + k] = vectors[i][k];
        }
    }
    for k in 0..4 {
        all[9 + k] = attitude[k];
    }
}

#[inline(always)]
fn read_motion<S: Scalar>(all: &[S]) -> ([Vec3<S>; 3], Quat<S>) {
    let vectors = [[all[0], all[1], all[2]], [all[3], all[4], all[5]], [all[6], all[7], all[8]]];
    (vectors, [all[9], all[10], all[11], all[12]])
}

/// d/dt of a motion.
#[derive(Clone, Copy)]
struct Rate<S> {
    position: Vec3<S>,
    velocity: Vec3<S>,
    attitude: Quat<S>,
    angular_velocity: Vec3<S>,
}

impl<S: Scalar> Rate<S> {
    #[inline(always)]
    fn zero() -> Self {
        let o = S::zero();
        Self { position: [o; 3], velocity: [o; 3], attitude: [o; 4], angular_velocity: [o; 3] }
    }
}

#[inline(always)]
fn rate<S: Scalar, const R: usize>(
    model: &RigidModel<S, R>,
    effects: Effects,
    m: &Motion<S>,
    speed: &[S; R],
    path: &RotorPath<S, R>,
    air: &Disturbance<S>,
) -> Rate<S> {
    let (acceleration, moment, momentum) = model.loads(m, speed, path, air, effects);
    Rate {
        position: m.velocity,
        velocity: acceleration,
        attitude: derivative(m.attitude, m.angular_velocity),
        angular_velocity: model.angular_acceleration(m.angular_velocity, moment, momentum, effects),
    }
}

#[inline(always)]
fn moved<S: Scalar>(m: &Motion<S>, h: S, k: &Rate<S>) -> Motion<S> {
    Motion {
        position: axpy(m.position, h, k.position),
        velocity: axpy(m.velocity, h, k.velocity),
        attitude: axpy(m.attitude, h, k.attitude),
        angular_velocity: axpy(m.angular_velocity, h, k.angular_velocity),
    }
}

#[inline(always)]
fn runge_kutta_4<S: Scalar, const R: usize>(
    model: &RigidModel<S, R>,
    effects: Effects,
    substep: f64,
    m: &Motion<S>,
    path: &RotorPath<S, R>,
    air: &Disturbance<S>,
) -> Motion<S> {
    let speeds = [&path.start, &path.middle, &path.middle, &path.end];
    let advance = [0.0, substep / 2.0, substep / 2.0, substep];
    let weight = [substep / 6.0, substep / 3.0, substep / 3.0, substep / 6.0];
    let mut k = Rate::zero();
    let mut end = *m;
    // a loop, not four copies: a quarter of the code to compile and to keep in the instruction cache
    for stage in 0..4 {
        let at = moved(m, S::constant(advance[stage]), &k);
        S::begin_function();
        k = rate(model, effects, &at, speeds[stage], path, air);
        end_stage(&mut k);
        end = moved(&end, S::constant(weight[stage]), &k);
    }
    end.attitude = unit(end.attitude);
    end
}

#[inline(always)]
fn semi_implicit<S: Scalar, const R: usize>(
    model: &RigidModel<S, R>,
    effects: Effects,
    substep: f64,
    m: &Motion<S>,
    path: &RotorPath<S, R>,
    air: &Disturbance<S>,
) -> Motion<S> {
    let h = S::constant(substep);
    let (acceleration, moment, momentum) = model.loads(m, &path.middle, path, air, effects);
    let angular_velocity = implicit_gyroscopic(model, effects, h, m.angular_velocity, moment, momentum);
    let velocity = axpy(m.velocity, h, acceleration);
    Motion {
        position: axpy(m.position, h, velocity),
        velocity,
        attitude: unit(axpy(m.attitude, h, derivative(m.attitude, angular_velocity))),
        angular_velocity,
    }
}

/// One Newton step from ω on J(ω⁺ − ω) + h ω⁺ × (Jω⁺ + H) = h M (Catto 2015, GDC "Numerical methods"):
/// (J + h([ω]× J − [Jω + H]×)) Δω = h (M − ω × (Jω + H)).
#[inline(always)]
fn implicit_gyroscopic<S: Scalar, const R: usize>(
    model: &RigidModel<S, R>,
    effects: Effects,
    h: S,
    w: Vec3<S>,
    moment: Vec3<S>,
    momentum: Vec3<S>,
) -> Vec3<S> {
    let total = add(symmetric_times(&model.inertia, w, effects), momentum);
    let residual = scale(h, sub(moment, cross(w, total)));
    let jacobian = if effects.products_of_inertia {
        gyroscopic_jacobian(full(model.inertia), total, w, h)
    } else {
        principal_gyroscopic_jacobian([model.inertia[0], model.inertia[1], model.inertia[2]], total, w, h)
    };
    add(w, mat_vec(inverse(jacobian), residual))
}

/// As [`gyroscopic_jacobian`] along principal axes, to the same bits: a lane does not know that its zeros are zeros.
#[inline(always)]
fn principal_gyroscopic_jacobian<S: Scalar>(inertia: Vec3<S>, momentum: Vec3<S>, w: Vec3<S>, h: S) -> Mat3<S> {
    let ([a, b, c], [x, y, z]) = (inertia, momentum);
    [
        [a, h * (z - w[2] * b), h * (w[1] * c - y)],
        [h * (w[2] * a - z), b, h * (x - w[0] * c)],
        [h * (y - w[1] * a), h * (w[0] * b - x), c],
    ]
}

/// J + h([ω]× J − [L]×): how J(ω⁺ − ω) + h ω⁺ × L⁺ answers to ω⁺ at ω, where the angular momentum is L.
#[inline(always)]
pub(crate) fn gyroscopic_jacobian<S: Scalar>(inertia: Mat3<S>, momentum: Vec3<S>, w: Vec3<S>, h: S) -> Mat3<S> {
    let (spin, lever) = (mat_mul(skew(w), inertia), skew(momentum));
    let mut jacobian = inertia;
    for i in 0..3 {
        for j in 0..3 {
            jacobian[i][j] = h.mul_add(spin[i][j] - lever[i][j], inertia[i][j]);
        }
    }
    jacobian
}

#[cfg(test)]
mod tests;
