//! The force at a contact, and the sum of forces per body.

use super::material::Material;
use super::pairs::{Contact, Contacts};
use crate::autodiff::{Scalar, safe};
use crate::dynamics::spatial::{Vec3, add, axpy, cross, dot, neg, scale, sub};

/// Floor of the depth under the root, m: below it δ^{3/2} is 1e-6 m^{1/2} · δ.
const DEPTH_FLOOR: f64 = 1e-12;

/// F_n = k δ₊^{3/2} (1 + 3/2 d δ̇)₊ ≥ 0, N, at `depth` δ that grows at `rate` δ̇ (Hunt and Crossley 1975).
///
/// The elastic part stores ⅖ k δ^{5/2}; the rest is k δ^{3/2} · 3/2 d δ̇² ≥ 0 of power taken out. Where (…)₊ holds a
/// body that leaves faster than 2/(3d), stored energy is dropped, never returned twice. Continuously differentiable at
/// touch, where slope is 0 in depth and rate; slope in rate jumps at δ̇ = −2/(3d).
#[inline(always)]
pub fn normal_force<S: Scalar>(material: &Material<S>, depth: S, rate: S) -> S {
    let depth = depth.max(S::zero());
    let elastic = material.stiffness * depth * safe::sqrt(depth, DEPTH_FLOOR);
    let damping = (material.dissipation * S::constant(1.5)).mul_add(rate, S::one()).max(S::zero());
    elastic * damping
}

/// Force on the first body at `contact.point`, N, world; the second takes its opposite there.
///
/// F = F_n n − μ F_n v_t/√(v_t² + v_s²), with `velocity` that of the first body's material at the point relative to the
/// second's, and v_t its part across n. Friction never drives: F_t·v_t ≤ 0. Smooth in slip, zero slip included, with
/// slope up to μ F_n/v_s: an explicit step stays stable where that times dt over the mass is below 2.
#[inline(always)]
pub fn force<S: Scalar>(material: &Material<S>, contact: &Contact<S>, velocity: Vec3<S>) -> Vec3<S> {
    let n = contact.normal;
    let leaving = dot(n, velocity);
    let normal = normal_force(material, contact.depth, -leaving);
    let slip = axpy(velocity, -leaving, n);
    let squared = material.slip_speed.mul_add(material.slip_speed, safe::squared_norm(slip));
    let friction = material.friction * normal * safe::recip_sqrt(squared, safe::SQUARED_NORM_FLOOR);
    axpy(scale(normal, n), -friction, slip)
}

/// How a body moves, world frame.
#[derive(Debug, Clone, Copy)]
pub struct Motion<S> {
    /// Its reference point, the one that moments are about, m.
    pub position: Vec3<S>,
    /// Velocity of that point, m/s.
    pub velocity: Vec3<S>,
    /// In the world frame, rad/s.
    pub angular_velocity: Vec3<S>,
}

impl<S: Scalar> Motion<S> {
    /// What does not move: ground, fixed obstacles.
    #[inline(always)]
    pub fn fixed() -> Self {
        let o = [S::zero(); 3];
        Self { position: o, velocity: o, angular_velocity: o }
    }

    /// Velocity of the body's material at `point` of the world, v + ω × (point − position), m/s.
    #[inline(always)]
    pub fn at(&self, point: Vec3<S>) -> Vec3<S> {
        add(self.velocity, cross(self.angular_velocity, sub(point, self.position)))
    }
}

/// What contacts do to one body, world frame: the net contact force and its moment.
#[derive(Debug, Clone, Copy)]
pub struct Load<S> {
    /// N.
    pub force: Vec3<S>,
    /// About the reference point of the body's [`Motion`], N m.
    pub moment: Vec3<S>,
}

impl<S: Scalar> Load<S> {
    /// None.
    #[inline(always)]
    pub fn zero() -> Self {
        let o = [S::zero(); 3];
        Self { force: o, moment: o }
    }

    /// Adds `force` acting at `point` on the body that moves as `motion`.
    #[inline(always)]
    pub fn add(&mut self, motion: &Motion<S>, point: Vec3<S>, force: Vec3<S>) {
        self.force = add(self.force, force);
        self.moment = add(self.moment, cross(sub(point, motion.position), force));
    }
}

/// Adds the forces of `contacts` to the loads of both bodies: equal and opposite at the same points, so that momentum
/// and angular momentum are kept.
#[inline(always)]
pub fn apply<S: Scalar>(
    material: &Material<S>,
    contacts: &Contacts<S>,
    motions: [&Motion<S>; 2],
    loads: [&mut Load<S>; 2],
) {
    let [first, second] = motions;
    let [on_first, on_second] = loads;
    for i in 0..contacts.count {
        let contact = &contacts.list[i];
        let velocity = sub(first.at(contact.point), second.at(contact.point));
        let f = force(material, contact, velocity);
        on_first.add(first, contact.point, f);
        on_second.add(second, contact.point, neg(f));
    }
}

/// The load of `contacts` on the first body where the second does not move: ground, fixed obstacles.
#[inline(always)]
pub fn load<S: Scalar>(material: &Material<S>, contacts: &Contacts<S>, motion: &Motion<S>) -> Load<S> {
    let mut load = Load::zero();
    for i in 0..contacts.count {
        let contact = &contacts.list[i];
        load.add(motion, contact.point, force(material, contact, motion.at(contact.point)));
    }
    load
}
