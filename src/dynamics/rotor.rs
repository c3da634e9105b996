//! One rotor: from its command to its speed, from its speed to its wrench; for rigid and articulated vehicles alike.
//!
//! ```text
//! Ω_cmd = Ω_max √max((a + 1)/2, 10⁻⁴)                      command a, clipped to [−1, 1]
//! Ω(t) = Ω_cmd + (Ω₀ − Ω_cmd) e^{−t/τ}                     τ up or down, by the sign of Ω_cmd − Ω₀
//! F = k_f Ω² n,   M = r × F − σ κ F                        thrust, reaction moment
//! F = −Ω (k_d v⊥ + k_z v∥),   M = r × F − σ Ω μ v⊥         rotor drag, rolling moment; v of the hub in the air
//! H = σ I_p Ω n                                            angular momentum
//! ```
//!
//! Moments are about a reference point that hubs r are given from: the centre of mass of a rigid vehicle, the origin of an
//! articulated body.

mod parameters;

#[doc(hidden)]
pub use parameters::N_ROTOR_PARAMETER;
#[doc(hidden)]
pub use parameters::at;
pub use parameters::{ROTOR_PARAMETERS, RotorParameter};

use super::aero::ground_effect;
use super::rigid::Effects;
use super::spatial::*;
use autodiff::{Scalar, safe};

/// Least share of its largest thrust that a command asks of a rotor: it idles at 1 % of its speed, and the slope of the
/// command stays finite at a = −1.
pub const LEAST_THRUST: f64 = 1e-4;

/// Ω_cmd of an action a, clipped to [−1, 1], rad/s.
#[inline(always)]
pub fn commanded_speed<S: Scalar>(max_speed: S, action: S) -> S {
    let one = S::one();
    let fraction = (action.clamp(-one, one) + one) * S::constant(0.5);
    max_speed * safe::sqrt(fraction, LEAST_THRUST)
}

/// The action that asks for a share of the largest thrust, within [0, 1]: a = 2 T/T_max − 1.
#[inline(always)]
pub fn thrust_action<S: Scalar>(share: S) -> S {
    S::constant(2.0) * share - S::one()
}

/// The action that holds a speed, both in rad/s: the inverse of [`commanded_speed`] above its floor.
pub fn holding_action(max_speed: f64, speed: f64) -> f64 {
    thrust_action((speed / max_speed).powi(2))
}

/// The lag of a motor in one direction, for substeps of h seconds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motor<S> {
    /// 1/τ.
    pub rate: S,
    /// e^{−h/2τ}.
    pub decay: S,
}

impl<S: Scalar> Motor<S> {
    /// For a time constant and a substep, s.
    #[inline(always)]
    pub(crate) fn new(time_constant: S, substep: f64) -> Self {
        let rate = time_constant.recip();
        Self { rate, decay: (S::constant(-0.5 * substep) * rate).exp() }
    }

    /// Reaches any command at once.
    #[inline(always)]
    pub(crate) fn none() -> Self {
        Self { rate: S::zero(), decay: S::zero() }
    }
}

/// A motor both ways.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motors<S> {
    /// Speeding up.
    pub up: Motor<S>,
    /// Slowing down.
    pub down: Motor<S>,
}

impl<S: Scalar> Motors<S> {
    /// From the numbers of a rotor (`ROTOR_PARAMETERS`), for substeps of `substep` seconds.
    #[inline(always)]
    pub(crate) fn new(p: &[S], substep: f64) -> Self {
        let [up, down] = [p[at::time_constant_up], p[at::time_constant_down]];
        Self { up: Motor::new(up, substep), down: Motor::new(down, substep) }
    }

    /// Those of [`RotorModel::dead`].
    #[inline(always)]
    pub(crate) fn none() -> Self {
        Self { up: Motor::none(), down: Motor::none() }
    }

    /// The one from `start` towards `target`.
    #[inline(always)]
    pub(crate) fn towards(&self, start: S, target: S) -> Motor<S> {
        let (up, down, rises) = (self.up, self.down, start.lt(target));
        Motor { rate: S::select(rises, up.rate, down.rate), decay: S::select(rises, up.decay, down.decay) }
    }
}

impl Motors<f64> {
    /// The same constants over another scalar.
    #[inline(always)]
    pub(crate) fn cast<S: Scalar>(&self) -> Motors<S> {
        let cast = |m: Motor<f64>| Motor { rate: S::constant(m.rate), decay: S::constant(m.decay) };
        Motors { up: cast(self.up), down: cast(self.down) }
    }
}

/// The speed of a rotor through one substep, from the closed form of its lag.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lag<S> {
    /// Ω_cmd.
    pub target: S,
    motor: Motor<S>,
    /// Ω − Ω_cmd at the half substep reached.
    gap: S,
}

impl<S: Scalar> Lag<S> {
    /// At rest.
    #[inline(always)]
    pub(crate) fn none() -> Self {
        Self { target: S::zero(), motor: Motor::none(), gap: S::zero() }
    }

    /// From `start` towards `target`.
    #[inline(always)]
    pub(crate) fn new(motor: Motor<S>, start: S, target: S) -> Self {
        Self { target, motor, gap: start - target }
    }

    /// The speed half a substep on.
    #[inline(always)]
    pub(crate) fn advance(&mut self) -> S {
        let speed = self.gap.mul_add(self.motor.decay, self.target);
        self.gap *= self.motor.decay;
        speed
    }

    /// Ω̇ at a speed: (Ω_cmd − Ω)/τ.
    #[inline(always)]
    pub(crate) fn acceleration(&self, speed: S) -> S {
        (self.target - speed) * self.motor.rate
    }
}

/// What the forces of one rotor are made of, as kernels see it.
#[derive(Debug, Clone, Copy)]
pub struct RotorModel<S> {
    /// k_f n: force per Ω².
    pub(crate) force: Vec3<S>,
    /// k_f (r × n − σ κ n): moment per Ω².
    pub(crate) moment: Vec3<S>,
    pub(crate) max_speed: S,
    /// r, from the reference point.
    pub(crate) hub: Vec3<S>,
    pub(crate) axis: Vec3<S>,
    /// σ I_p.
    pub(crate) spin_inertia: S,
    pub(crate) drag: S,
    pub(crate) axial_drag: S,
    /// σ μ.
    pub(crate) rolling: S,
    pub(crate) radius: S,
}

impl<S: Scalar> RotorModel<S> {
    /// No thrust, no drag, no inertia: pads a vehicle to the next compiled rotor count.
    #[inline(always)]
    pub(crate) fn dead() -> Self {
        let (o, l) = (S::zero(), S::one());
        Self {
            force: [o; 3],
            moment: [o; 3],
            max_speed: l,
            hub: [o; 3],
            axis: [o, o, l],
            spin_inertia: o,
            drag: o,
            axial_drag: o,
            rolling: o,
            radius: o,
        }
    }

    /// From its numbers (`ROTOR_PARAMETERS`), about a reference point at `origin`.
    #[inline(always)]
    pub(crate) fn new(p: &[S], origin: Vec3<S>, radius: f64) -> Self {
        let hub = sub([p[at::position_x], p[at::position_y], p[at::position_z]], origin);
        let axis = [p[at::axis_x], p[at::axis_y], p[at::axis_z]];
        let (spin, force) = (p[at::spin], scale(p[at::thrust_coefficient], axis));
        Self {
            force,
            moment: sub(cross(hub, force), scale(spin * p[at::moment_per_thrust], force)),
            max_speed: p[at::max_speed],
            hub,
            axis,
            spin_inertia: spin * p[at::inertia],
            drag: p[at::drag_coefficient],
            axial_drag: p[at::axial_drag_coefficient],
            rolling: spin * p[at::rolling_coefficient],
            radius: S::constant(radius),
        }
    }

    /// Adds thrust and reaction moment, with the ground effect of a hub at `height` (m) where one is given. The caller
    /// may leave out what is zero where no rotor is `tilted` away from z.
    #[inline(always)]
    pub(crate) fn add_thrust(&self, speed: S, height: Option<S>, tilted: bool, sum: &mut Wrench<S>) {
        let squared = speed * speed;
        let (mut force, mut moment) = (self.force, self.moment);
        if let Some(height) = height {
            let gain = ground_effect::factor(height, self.radius);
            // thrust grows near the ground, the reaction torque does not
            moment = add(moment, cross(self.hub, scale(gain - S::one(), force)));
            force = scale(gain, force);
        }
        if tilted {
            sum.force[0] = force[0].mul_add(squared, sum.force[0]);
            sum.force[1] = force[1].mul_add(squared, sum.force[1]);
        }
        sum.force[2] = force[2].mul_add(squared, sum.force[2]);
        for k in 0..3 {
            sum.moment[k] = moment[k].mul_add(squared, sum.moment[k]);
        }
    }

    /// Adds rotor drag and rolling moment, those of the `effects` that are on; `velocity` is that of the reference point
    /// in the air, both in the axes of the body.
    #[inline(always)]
    pub(crate) fn add_drag(
        &self,
        speed: S,
        velocity: Vec3<S>,
        angular_velocity: Vec3<S>,
        effects: Effects,
        sum: &mut Wrench<S>,
    ) {
        let at_hub = add(velocity, cross(angular_velocity, self.hub));
        let along = scale(dot(at_hub, self.axis), self.axis);
        let across = sub(at_hub, along);
        if effects.rotor_drag {
            let force = scale(-speed, add(scale(self.drag, across), scale(self.axial_drag, along)));
            sum.force = add(sum.force, force);
            sum.moment = add(sum.moment, cross(self.hub, force));
        }
        if effects.rolling_moment {
            sum.moment = axpy(sum.moment, -(self.rolling * speed), across);
        }
    }

    /// Adds the angular momentum at a speed to `momentum`, and its rate under an acceleration of the rotor to `rate`.
    #[inline(always)]
    pub(crate) fn add_momentum(&self, speed: S, acceleration: S, momentum: &mut Vec3<S>, rate: &mut Vec3<S>) {
        *momentum = axpy(*momentum, self.spin_inertia * speed, self.axis);
        *rate = axpy(*rate, self.spin_inertia * acceleration, self.axis);
    }
}

impl RotorModel<f64> {
    /// The same constants over another scalar.
    #[inline(always)]
    pub(crate) fn cast<S: Scalar>(&self) -> RotorModel<S> {
        let c = S::constant;
        RotorModel {
            force: constants(self.force),
            moment: constants(self.moment),
            max_speed: c(self.max_speed),
            hub: constants(self.hub),
            axis: constants(self.axis),
            spin_inertia: c(self.spin_inertia),
            drag: c(self.drag),
            axial_drag: c(self.axial_drag),
            rolling: c(self.rolling),
            radius: c(self.radius),
        }
    }
}

#[cfg(test)]
mod tests;
