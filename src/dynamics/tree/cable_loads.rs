//! What cables pull: the law of `cable`.

use super::cable::{CableEnd, ROUND};
use super::parameters::{ParameterView, cable_parameters};
use super::scratch::BodyScratch;
use super::topology::Topology;
use crate::spatial::*;
use autodiff::{Scalar, safe};

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
#[inline]
fn end<S: Scalar>(end: &CableEnd, bodies: &[BodyScratch<S>]) -> (Vec3<S>, Vec3<S>) {
    let Some(body) = end.body else { return (constants(end.point), [S::zero(); 3]) };
    let body = &bodies[body];
    let lever = mat_vec(body.rotation, constants(end.point));
    (add(body.position, lever), add(body.velocity, cross(body.angular_velocity, lever)))
}

/// Adds what cables pull to the outside loads of bodies. Needs kinematics.
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
