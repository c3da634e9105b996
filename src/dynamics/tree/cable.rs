//! Cables: they pull where they are taut, and hang slack otherwise.
//!
//! Between two points ℓ apart, with e = ℓ − L beyond the cable's own length L and w = [`ROUND`] L,
//!
//! T = (k ψ(e) (1 + d ℓ̇))₊, ψ(e) = 0 for e ≤ 0, e²/(2w) up to w, e − w/2 beyond,
//!
//! along the line between them. A slack cable weighs nothing and exerts nothing. T is continuously differentiable in ℓ, so that
//! gradients pass where it goes taut; the elastic part stores k ∫ψ, the rest takes power k ψ d ℓ̇² out. As with contacts, k and
//! the slope k ψ d are held at what a substep resolves: [`check_cables`](super::check_cables) tells.

use super::model::Model;
use super::parameters::{ParameterView, cable_parameters};
use super::scratch::BodyScratch;
use super::topology::Topology;
use crate::autodiff::{Scalar, safe};
use crate::dynamics::spatial::*;
use crate::error::{Error, Result, finite};
use serde::{Deserialize, Serialize};

/// Share of its length over which a cable goes taut.
pub const ROUND: f64 = 2e-3;

/// Where a cable ends.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CableEnd {
    /// Number of the body; `None` for the world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<usize>,
    /// In the body's frame or in the world, m.
    pub point: [f64; 3],
}

/// A cable without mass that pulls its ends together where they are farther apart than it is long, and never pushes: law in
/// `tree/cable.rs`, T = (k ψ(ℓ − L) (1 + d ℓ̇))₊.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cable {
    /// Unique within the model.
    pub name: String,
    /// Two points of different bodies, or of one and the world.
    pub ends: [CableEnd; 2],
    /// L, m, > 0.
    pub length: f64,
    /// k, N/m, > 0.
    pub stiffness: f64,
    /// d, s/m, ≥ 0.
    pub dissipation: f64,
}

impl Cable {
    /// Of `length` m, 2 kN/m and 1 s/m, between two named frames of a model.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest name.
    pub fn between(model: &Model, name: impl Into<String>, ends: [&str; 2], length: f64) -> Result<Self> {
        let end = |name: &str| model.frame(name).map(|f| CableEnd { body: Some(f.body), point: f.position });
        let ends = [end(ends[0])?, end(ends[1])?];
        Ok(Self { name: name.into(), ends, length, stiffness: 2000.0, dissipation: 1.0 })
    }

    /// Checks numbers and ends; `what` names the model in the error.
    pub(super) fn validate(&self, what: &str, n_body: usize) -> Result<()> {
        let what = format!("{what}cable '{}'", self.name);
        for end in &self.ends {
            finite(&format!("{what}: point"), &end.point)?;
            if let Some(body) = end.body.filter(|b| *b >= n_body) {
                let rule = format!("below {n_body}");
                return Err(Error::value(format!("{what}: body"), body, rule, "Bodies count from 0."));
            }
        }
        if self.ends[0].body == self.ends[1].body {
            let remedy = "It would pull on nothing: tie one of them elsewhere.";
            return Err(Error::value(
                format!("{what}: ends"),
                "on one body",
                "on two, or on one and the world",
                remedy,
            ));
        }
        finite(&format!("{what}: length, stiffness, dissipation"), &[self.length, self.stiffness, self.dissipation])?;
        let bounds = [("length", self.length, 1e-3, 1e3), ("stiffness", self.stiffness, 1e-6, 1e9)];
        for (name, value, least, most) in bounds.into_iter().chain([("dissipation", self.dissipation, 0.0, 1e3)]) {
            if !(least..=most).contains(&value) {
                let rule = format!("between {least} and {most}");
                return Err(Error::value(format!("{what}: {name}"), value, rule, "In m, N/m and s/m."));
            }
        }
        Ok(())
    }
}

/// A cable at one moment.
struct Line<S> {
    /// Its ends, world, m.
    points: [Vec3<S>; 2],
    /// Unit, from the first to the second.
    along: Vec3<S>,
    /// e, m.
    excess: S,
    /// ℓ̇, m/s.
    rate: S,
    /// w, m.
    round: S,
    stiffness: S,
    dissipation: S,
}

impl<S: Scalar> Line<S> {
    #[inline(always)]
    fn of<P: ParameterView<S>>(t: &Topology, k: usize, numbers: P, bodies: &[BodyScratch<S>]) -> Self {
        let ends = &t.cables[k];
        let ((a, va), (b, vb)) = (end(&ends[0], bodies), end(&ends[1], bodies));
        let [length, stiffness, dissipation] = numbers.vector(cable_parameters(t.n_body(), t.n_rotor(), t.n_still, k));
        let apart = sub(b, a);
        let along = safe::normalise(apart);
        Self {
            points: [a, b],
            along,
            excess: dot(apart, along) - length,
            rate: dot(sub(vb, va), along),
            round: S::constant(ROUND) * length,
            stiffness: stiffness.min(S::constant(t.resolved.cables[k].stiffness)),
            dissipation,
        }
    }

    /// T, N.
    #[inline(always)]
    fn tension(&self, most_damping: f64) -> S {
        let (zero, half) = (S::zero(), S::constant(0.5));
        let rounded = self.excess.max(zero).min(self.round);
        let stretch = rounded * (-half).mul_add(rounded, self.excess.max(zero)) * self.round.recip();
        let elastic = self.stiffness * stretch;
        let damping = (elastic * self.dissipation).min(S::constant(most_damping));
        damping.mul_add(self.rate, elastic).max(zero)
    }

    /// k ∫ψ, J.
    fn energy(&self) -> S {
        let (rounded, taut) = (self.excess.max(S::zero()).min(self.round), self.excess.max(self.round));
        let going = rounded * rounded * rounded * self.round.recip() * S::constant(1.0 / 6.0);
        self.stiffness * (S::constant(0.5) * taut).mul_add(taut - self.round, going)
    }
}

/// Place and velocity of an end.
#[inline(always)]
fn end<S: Scalar>(end: &CableEnd, bodies: &[BodyScratch<S>]) -> (Vec3<S>, Vec3<S>) {
    let Some(body) = end.body else { return (constants(end.point), [S::zero(); 3]) };
    let body = &bodies[body];
    let lever = mat_vec(body.rotation, constants(end.point));
    (add(body.position, lever), add(body.velocity, cross(body.angular_velocity, lever)))
}

/// Adds what cables pull to the outside loads of bodies. Needs kinematics.
#[inline(always)]
pub(super) fn apply<S: Scalar, P: ParameterView<S>>(t: &Topology, numbers: P, bodies: &mut [BodyScratch<S>]) {
    for k in 0..t.cables.len() {
        let line = Line::of(t, k, numbers, bodies);
        let pull = scale(line.tension(t.resolved.cables[k].damping), line.along);
        for (side, force) in [(0, pull), (1, neg(pull))] {
            if let Some(body) = t.cables[k][side].body {
                let body = &mut bodies[body];
                body.force = add(body.force, force);
                body.moment = add(body.moment, cross(sub(line.points[side], body.position), force));
            }
        }
    }
}

/// Tension of every cable, N. Needs kinematics.
pub(super) fn tensions<S: Scalar, P: ParameterView<S>>(t: &Topology, numbers: P, bodies: &[BodyScratch<S>]) -> Vec<S> {
    let tension = |k| Line::of(t, k, numbers, bodies).tension(t.resolved.cables[k].damping);
    (0..t.cables.len()).map(tension).collect()
}

/// Stored in all cables, J. Needs kinematics.
pub(super) fn energy<S: Scalar, P: ParameterView<S>>(t: &Topology, numbers: P, bodies: &[BodyScratch<S>]) -> S {
    (0..t.cables.len()).fold(S::zero(), |sum, k| sum + Line::of(t, k, numbers, bodies).energy())
}
