//! Integral action: the accelerations that the believed body misses, learnt from its motion and taken off what is asked.
//!
//! Told the rotor thrusts T, the body is believed to move by
//!
//! ```text
//! v̇ = R e_z F/m − g e_z − R D Rᵀ v/m        ω̇ = J⁻¹(M − C Rᵀ v − D_ω ω − ω × Jω)        [F, M] = B T
//! ```
//!
//! What it gained in a period P of the rate level beyond P·(v̇, ω̇), divided by P, is missing: wind, mass, a shifted centre of
//! mass, weak rotors. Its estimate d̂ follows at the rate L, d̂⁺ = d̂ + (1 − e^(−LP))(d − d̂), and the velocity and rate levels
//! ask for d̂ less.
//!
//! - With perfect motors the poles of the loop are those of the PD gains and −L beside them: what is missing decays as
//!   s/(s + L), and a reference that is flown well leaves nothing to learn. Above an ideal attitude loop this is the PID with
//!   K_i = L K_p, K_p' = K_p + L K_v and K_v' = K_v + L.
//! - T is what the rotors were told **after** clipping, so that nothing winds up while they are at a limit.
//!
//! Source: Ohnishi, Shibata and Murakami 1996 (disturbance observers of motion control); the automatic reset of
//! Åström and Hägglund 2006, section 3.5.

use super::kinematics::Kinematics;
use super::nominal_body::NominalBody;
use autodiff::Scalar;

/// The memory of integral action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct IntegralState<S> {
    /// Velocity (world) and angular velocity (body) as they should be at the next tick.
    expected: [S; 6],
    /// d̂: of v̇ (world, m/s²) and ω̇ (body, rad/s²).
    pub(super) estimate: [S; 6],
    /// 0 before the first tick, when there is nothing to compare with.
    pub(super) started: S,
}

impl<S: Scalar> IntegralState<S> {
    /// Numbers in the flat form: what is expected, what is missing, whether it has begun.
    pub(super) const DIM: usize = 13;

    #[inline]
    pub(super) fn read(x: &[S]) -> Self {
        let (mut expected, mut estimate) = ([S::zero(); 6], [S::zero(); 6]);
        for k in 0..6 {
            (expected[k], estimate[k]) = (x[k], x[6 + k]);
        }
        Self { expected, estimate, started: x[12] }
    }

    #[inline]
    pub(super) fn write(&self, out: &mut [S]) {
        for k in 0..6 {
            (out[k], out[6 + k]) = (self.expected[k], self.estimate[k]);
        }
        out[12] = self.started;
    }

    /// Compares where `tick` > ½: `rates` are L of force and moment, 1/s.
    pub(super) fn observe(&mut self, tick: S, state: &Kinematics<S>, rates: [S; 2], period: f64) {
        let due = S::constant(0.5).lt(tick * self.started);
        let per_period = S::constant(1.0 / period);
        for k in 0..6 {
            let now = if k < 3 { state.velocity[k] } else { state.angular_velocity[k - 3] };
            let share = S::one() - (rates[k / 3] * S::constant(-period)).exp();
            let fresh = (now - self.expected[k]) * per_period;
            let learnt = share.mul_add(fresh - self.estimate[k], self.estimate[k]);
            self.estimate[k] = S::select(due, learnt, self.estimate[k]);
        }
    }

    /// What is expected at the next tick, with the wrench [F_z, M] that the rotors give from now on.
    pub(super) fn expect(
        &mut self,
        tick: S,
        state: &Kinematics<S>,
        believed: &NominalBody,
        rotors: [S; 4],
        period: f64,
    ) {
        let due = S::constant(0.5).lt(tick);
        let gained = believed.acceleration(state, rotors);
        for k in 0..6 {
            let now = if k < 3 { state.velocity[k] } else { state.angular_velocity[k - 3] };
            let next = gained[k].mul_add(S::constant(period), now);
            self.expected[k] = S::select(due, next, self.expected[k]);
        }
        self.started = S::one();
    }

    /// Of v̇, world, m/s².
    #[inline]
    pub(super) fn acceleration(&self) -> [S; 3] {
        [self.estimate[0], self.estimate[1], self.estimate[2]]
    }

    /// Of ω̇, body, rad/s².
    #[inline]
    pub(super) fn angular_acceleration(&self) -> [S; 3] {
        [self.estimate[3], self.estimate[4], self.estimate[5]]
    }
}
