//! Material of a contact: as data ([`ContactMaterial`]) and as numbers for kernels ([`Material`]).

use crate::integrate::{Grid, Integrator};
use crate::shape::within;
use crate::vehicle::GRAVITY;
use autodiff::Scalar;
use base::error::Result;
use serde::{Deserialize, Serialize};

/// Stiffness, dissipation and friction of one contact point.
///
/// At a depth δ (m) that grows at δ̇, with the slip velocity v_t across the normal n (unit, world), the first body is pushed by
///
/// ```text
/// F = F_n n − μ F_n v_t/√(v_t² + v_s²)      F_n = k δ₊^{3/2} (1 + 3/2 d δ̇)₊      (Hunt and Crossley 1975)
/// ```
///
/// How stiff it may be is a matter of the step. A body of mass m that rests on n points sinks by
/// δ₀ = (m g/(n k))^{2/3} and bobs there at ω = √(3g/(2δ₀)), whatever its mass. The default lets 0.7 kg on four
/// points sink by 0.51 mm: ω = 170 rad/s, ω·dt = 0.34 at 2 ms, where RK4 is stable below 2.8 and accurate below 0.5.
/// A lighter body sinks less and bobs faster on the same material: [`ContactMaterial::resting`] finds its stiffness. A
/// [`Multibody`](crate::tree::Multibody) takes no more of it, nor of damping, than its substep resolves
/// (`tree::check_contact`).
///
/// Impacts are stiffer than rest: from 1 m that body bounces at up to 400 rad/s. Friction damps slip at up to
/// μ F_n/(m v_s), 8000/s with the default. A step of 2 ms does not resolve the latter, yet it gained at most 5e-5 J in
/// any step of such falls at the default slip speed, and 3e-3 J at half of it; none gained energy over a bounce. Below
/// 50 m/s² times the substep a [`Multibody`](crate::tree::Multibody) samples friction implicitly (see its module).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactMaterial {
    /// k of F = k δ^{3/2}, N/m^{3/2}.
    pub stiffness: f64,
    /// d of the factor 1 + 3/2 d δ̇, s/m: a slow impact at speed v leaves with 1 − d v of it.
    pub dissipation: f64,
    /// μ, coefficient of sliding friction.
    pub friction: f64,
    /// v_s, m/s: at slip v_s friction reaches 71 % of μ F_n. Below, it is viscous: a body at rest on a slope of angle α
    /// creeps at v_s r/√(1 − r²), r = tan α/μ. Where friction sticks, as in a
    /// [`Multibody`](crate::tree::Multibody) that does not resolve v_s, at v_s r/(1 − r⁴)^{1/4}.
    pub slip_speed: f64,
}

impl Default for ContactMaterial {
    /// 1.5e5 N/m^{3/2}, 0.3 s/m, 0.5, 0.1 m/s.
    fn default() -> Self {
        Self { stiffness: 1.5e5, dissipation: 0.3, friction: 0.5, slip_speed: 0.1 }
    }
}

impl ContactMaterial {
    /// The default with a slip speed of 1 mm/s: in a [`Multibody`](crate::tree::Multibody) what rests on a slope then
    /// stands, within that creep. The step must resolve the stiffness all the same.
    #[must_use]
    pub fn sticking() -> Self {
        Self { slip_speed: 1e-3, ..Self::default() }
    }

    /// The default with the stiffness k = m g/(n δ₀^{3/2}) on which a body of `mass` kg at rest on `n_contact` ≥ 1 points
    /// sinks by `sink` = δ₀ m.
    pub fn resting(mass: f64, n_contact: usize, sink: f64) -> Self {
        Self { stiffness: mass * GRAVITY / (n_contact as f64 * sink.powf(1.5)), ..Self::default() }
    }

    /// How deep a body of `mass` kg at rest on `n_contact` ≥ 1 points sinks: (m g/(n k))^{2/3}, m.
    pub fn sink(&self, mass: f64, n_contact: usize) -> f64 {
        (mass * GRAVITY / (n_contact as f64 * self.stiffness)).powf(2.0 / 3.0)
    }

    /// Rate √(F′/m) of small vertical oscillations of that body about its rest, rad/s. RK4 wants this times the step
    /// below 0.5.
    pub fn natural_frequency(&self, mass: f64, n_contact: usize) -> f64 {
        (1.5 * GRAVITY / self.sink(mass, n_contact)).sqrt()
    }

    /// What acts between a body of this material and one of another: stiffnesses k₁ and k₂ as springs in series, doubled, so
    /// that equals leave it as it is; the mean dissipation; √(μ₁ μ₂); the lesser slip speed, so that it is enough for one of them to hold.
    #[must_use]
    pub fn against(&self, other: &Self) -> Self {
        Self {
            stiffness: 2.0 * self.stiffness * other.stiffness / (self.stiffness + other.stiffness),
            dissipation: 0.5 * (self.dissipation + other.dissipation),
            friction: (self.friction * other.friction).sqrt(),
            slip_speed: self.slip_speed.min(other.slip_speed),
        }
    }

    /// Checks every number; `what` names the material in the error.
    ///
    /// # Errors
    /// [`Error::Value`](base::error::Error::Value): a number that is not finite; stiffness outside 1e-3 to 1e12; dissipation or friction
    /// outside 0 to 100; slip speed outside 1e-6 to 1e3 m/s.
    pub fn validate(&self, what: &str) -> Result<()> {
        within(&format!("{what}: stiffness"), self.stiffness, 1e-3, 1e12)?;
        within(&format!("{what}: dissipation"), self.dissipation, 0.0, 100.0)?;
        within(&format!("{what}: friction"), self.friction, 0.0, 100.0)?;
        within(&format!("{what}: slip_speed"), self.slip_speed, 1e-6, 1e3)
    }

    /// As constants of any scalar.
    pub fn cast<S: Scalar>(&self) -> Material<S> {
        Material {
            stiffness: S::constant(self.stiffness),
            dissipation: S::constant(self.dissipation),
            friction: S::constant(self.friction),
            slip_speed: S::constant(self.slip_speed),
            most_damping: S::constant(Resolved::ANY.damping),
        }
    }
}

/// What a substep resolves at a point of contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Resolved {
    /// Most k, N/m^{3/2}.
    pub stiffness: f64,
    /// Most slope of the force in rate, N s/m.
    pub damping: f64,
}

impl Resolved {
    /// No bound. Finite, so that no derivative of it is 0 · ∞.
    pub(crate) const ANY: Self = Self { stiffness: 1e30, damping: 1e30 };
    /// ω h.
    const MOST_ANGLE: f64 = 0.5;

    /// At a point that gives way with `mobility` 1/m, 1/kg, in substeps h: what bobs at ω where m alone rests on it,
    /// k = m g/δ^{3/2} with δ = 3g/(2ω²), and damping c that takes a speed in the time T = m/c. With ω h ≤ 0.5, and h/T ≤ 1
    /// for RK4 or ½ for the semi-implicit step, impacts of a few m/s, up to three times as fast, gain no energy.
    pub(crate) fn of(mobility: f64, grid: Grid) -> Self {
        if mobility <= 0.0 {
            return Self::ANY;
        }
        let loss = match grid.integrator {
            Integrator::RungeKutta4 => 1.0,
            Integrator::SemiImplicit => 0.5,
        };
        let mass = mobility.recip();
        let stiffness = ContactMaterial::resting(mass, 1, Self::sink(grid)).stiffness;
        Self { stiffness, damping: loss * mass / grid.substep }
    }

    /// As [`Self::of`] of a spring, its stiffness in N/m: ω h ≤ 0.5.
    pub(crate) fn of_spring(mobility: f64, grid: Grid) -> Self {
        let stiffness = (Self::MOST_ANGLE / grid.substep).powi(2) / mobility.max(f64::MIN_POSITIVE);
        Self { stiffness: stiffness.min(Self::ANY.stiffness), ..Self::of(mobility, grid) }
    }

    /// By how much what rests sinks into the softest that [`Self::of`] asks for, m: 6 g h².
    pub(crate) fn sink(grid: Grid) -> f64 {
        1.5 * GRAVITY * (grid.substep / Self::MOST_ANGLE).powi(2)
    }
}

/// [`ContactMaterial`] over any scalar, so that its numbers may be parameters.
#[derive(Debug, Clone, Copy)]
pub struct Material<S> {
    /// k, N/m^{3/2}, ≥ 0.
    pub stiffness: S,
    /// d, s/m, ≥ 0.
    pub dissipation: S,
    /// μ ≥ 0.
    pub friction: S,
    /// v_s, m/s, > 0.
    pub slip_speed: S,
    /// Most slope of the normal force in rate, N s/m, > 0: what a step resolves.
    pub most_damping: S,
}

impl<S: Scalar> Material<S> {
    /// No stiffer than a step resolves.
    #[inline]
    pub(crate) fn within(self, most: &Resolved) -> Self {
        Self {
            stiffness: self.stiffness.min(S::constant(most.stiffness)),
            most_damping: S::constant(most.damping),
            ..self
        }
    }
}
