//! The force at a contact.

use super::material::Material;
use super::pairs::ContactPoint;
use crate::spatial::{Vec3, axpy, dot, scale};
use autodiff::{Scalar, safe};

/// Floor of the depth under the root, m: below it δ^{3/2} is 1e-6 m^{1/2} · δ.
const DEPTH_FLOOR: f64 = 1e-12;

/// F_n = k δ₊^{3/2} (1 + 3/2 d δ̇)₊ ≥ 0, N, at `depth` δ that grows at `rate` δ̇ (Hunt and Crossley 1975), its slope in rate
/// 3/2 d k δ^{3/2} held at `most_damping`.
///
/// The elastic part stores ⅖ k δ^{5/2}; the rest is slope · δ̇² ≥ 0 of power taken out. Where (…)₊ holds a
/// body that leaves faster than 2/(3d), stored energy is dropped, never returned twice. Continuously differentiable at
/// touch, where slope is 0 in depth and rate; slope in rate jumps at δ̇ = −2/(3d), slope in depth where damping is held.
pub fn normal_force<S: Scalar>(material: &Material<S>, depth: S, rate: S) -> S {
    let depth = depth.max(S::zero());
    let elastic = material.stiffness * depth * safe::sqrt(depth, DEPTH_FLOOR);
    let loss = material.dissipation * S::constant(1.5);
    let damping = loss.mul_add(rate, S::one()).max(S::zero());
    let is_held = material.most_damping.lt(loss * elastic);
    S::select(is_held, material.most_damping.mul_add(rate, elastic).max(S::zero()), elastic * damping)
}

/// Slip speed per second of a step, m/s²: friction that is smoother than this times the step is resolved by explicit stages.
pub(crate) const RESOLVED: f64 = 50.0;

/// (1 + u⁴)^{−1/4} of the square of a slip u over the slip speed: what is left of viscous friction −μ F_n u. To 1 % all of it up
/// to 45 % of μ F_n, so that a step which takes it as viscous finds the creep at rest.
#[inline]
pub(crate) fn share<S: Scalar>(squared: S) -> S {
    let fourth = squared.mul_add(squared, S::one());
    safe::recip_sqrt(safe::sqrt(fourth, 1.0), 1.0)
}

/// Friction that sticks, −μ F_n u (1 + u⁴)^{−1/4} with u = v_t/v_s, N, at the part `slip` of a velocity across the normal.
#[inline]
pub(crate) fn sticking<S: Scalar>(material: &Material<S>, normal: S, slip: Vec3<S>) -> Vec3<S> {
    let slip = scale(material.slip_speed.recip(), slip);
    scale(-(material.friction * normal * share(safe::squared_norm(slip))), slip)
}

/// Force on the first body at `contact.point`, N, world; the second takes its opposite there.
///
/// F = F_n n − μ F_n v_t/√(v_t² + v_s²), with `velocity` that of the first body's material at the point relative to the
/// second's, and v_t its part across n. Friction never drives: F_t·v_t ≤ 0. Smooth in slip, zero slip included, with
/// slope up to μ F_n/v_s: an explicit step stays stable where that times dt over the mass is below 2.
pub fn force<S: Scalar>(material: &Material<S>, contact: &ContactPoint<S>, velocity: Vec3<S>) -> Vec3<S> {
    let n = contact.normal;
    let leaving = dot(n, velocity);
    let normal = normal_force(material, contact.depth, -leaving);
    let slip = axpy(velocity, -leaving, n);
    let squared = material.slip_speed.mul_add(material.slip_speed, safe::squared_norm(slip));
    let friction = material.friction * normal * safe::recip_sqrt(squared, safe::SQUARED_NORM_FLOOR);
    axpy(scale(normal, n), -friction, slip)
}
