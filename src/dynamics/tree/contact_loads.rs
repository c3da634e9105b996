//! Contact forces between the shapes of an environment, and on the ground.
//!
//! The law is that of [`contact`](crate::dynamics::contact); here is which shape touches which, and on which body the
//! force then acts. Needs kinematics.

use super::parameters::{ParameterView, contact_parameters, static_parameters};
use super::scratch::BodyScratch;
use super::topology::{Feature, Form, Topology};
use crate::autodiff::{Scalar, safe};
use crate::dynamics::contact::pairs::{capsule_capsule, sphere_capsule, sphere_plane, sphere_sphere};
use crate::dynamics::contact::{Contact, Material, force};
use crate::dynamics::spatial::*;

/// Adds contact forces to the outside loads of every body, and to its net contact force.
#[inline(always)]
pub(crate) fn apply<S: Scalar, P: ParameterView<S>>(t: &Topology, numbers: P, bodies: &mut [BodyScratch<S>]) {
    let n = contact_parameters(t.n_body(), t.n_rotor());
    let material = Material {
        stiffness: numbers.get(n),
        dissipation: numbers.get(n + 1),
        friction: numbers.get(n + 2),
        slip_speed: numbers.get(n + 3),
    };
    let ground = numbers.get(n + 4);
    for i in 0..t.n_body() {
        bodies[i].contact = [S::zero(); 3];
    }
    for k in 0..t.on_ground.len() {
        let feature = &t.features[t.on_ground[k]];
        if let Some(body) = feature.body {
            on_ground(feature, &material, ground, &mut bodies[body]);
        }
    }
    for k in 0..t.pairs.len() {
        let (i, j) = t.pairs[k];
        between(t, (i, j), numbers, &material, bodies);
    }
}

#[inline(always)]
fn on_ground<S: Scalar>(feature: &Feature, material: &Material<S>, ground: S, body: &mut BodyScratch<S>) {
    let radius = S::constant(feature.radius);
    let points = feature.form.points();
    for k in 0..points.len() {
        let center = world(body, points[k]);
        let contact = sphere_plane(center, radius, ground);
        let pushed = force::force(material, &contact, velocity_at(body, contact.point));
        push(body, contact.point, pushed);
    }
}

#[inline(always)]
fn world<S: Scalar>(body: &BodyScratch<S>, point: [f64; 3]) -> Vec3<S> {
    add(body.position, mat_vec(body.rotation, constants(point)))
}

#[inline(always)]
fn velocity_at<S: Scalar>(body: &BodyScratch<S>, point: Vec3<S>) -> Vec3<S> {
    add(body.velocity, cross(body.angular_velocity, sub(point, body.position)))
}

/// A force at a point of the world.
#[inline(always)]
fn push<S: Scalar>(body: &mut BodyScratch<S>, point: Vec3<S>, force: Vec3<S>) {
    body.contact = add(body.contact, force);
    body.force = add(body.force, force);
    body.moment = add(body.moment, cross(sub(point, body.position), force));
}

/// Where a rounded feature's points are in the world.
#[inline(always)]
fn ends<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    feature: &Feature,
    numbers: P,
    bodies: &[BodyScratch<S>],
) -> [Vec3<S>; 2] {
    let (a, b) = match &feature.form {
        Form::Sphere(point) => (*point, *point),
        Form::Capsule([a, b]) => (*a, *b),
        // boxes have no pairs
        Form::Box(corners) => (corners[0], corners[7]),
    };
    match feature.body {
        Some(body) => [world(&bodies[body], a), world(&bodies[body], b)],
        None => {
            let origin = numbers.vector(static_parameters(t.n_body(), t.n_rotor(), feature.still));
            [add(origin, constants(a)), add(origin, constants(b))]
        }
    }
}

/// Where and how two rounded features touch, the first pushed along the normal.
#[inline(always)]
fn contact_of<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    (i, j): (usize, usize),
    numbers: P,
    bodies: &[BodyScratch<S>],
) -> Contact<S> {
    let (first, second) = (&t.features[i], &t.features[j]);
    let ([a1, b1], [a2, b2]) = (ends(t, first, numbers, bodies), ends(t, second, numbers, bodies));
    let (r1, r2) = (S::constant(first.radius), S::constant(second.radius));
    match (matches!(first.form, Form::Sphere(_)), matches!(second.form, Form::Sphere(_))) {
        (true, true) => sphere_sphere(a1, r1, a2, r2),
        (true, false) => sphere_capsule(a1, r1, a2, b2, r2),
        (false, true) => opposite(sphere_capsule(a2, r2, a1, b1, r1)),
        (false, false) => capsule_capsule([a1, b1], r1, [a2, b2], r2),
    }
}

#[inline(always)]
fn between<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    (i, j): (usize, usize),
    numbers: P,
    material: &Material<S>,
    bodies: &mut [BodyScratch<S>],
) {
    let (first, second) = (&t.features[i], &t.features[j]);
    let contact = contact_of(t, (i, j), numbers, bodies);
    let mut relative = [S::zero(); 3];
    if let Some(b) = first.body {
        relative = velocity_at(&bodies[b], contact.point);
    }
    if let Some(b) = second.body {
        relative = sub(relative, velocity_at(&bodies[b], contact.point));
    }
    let pushed = force::force(material, &contact, relative);
    if let Some(b) = first.body {
        push(&mut bodies[b], contact.point, pushed);
    }
    if let Some(b) = second.body {
        push(&mut bodies[b], contact.point, neg(pushed));
    }
}

/// The same contact seen from the other body.
#[inline(always)]
fn opposite<S: Scalar>(contact: Contact<S>) -> Contact<S> {
    Contact { normal: neg(contact.normal), ..contact }
}

/// Energy ⅖ k δ^{5/2} stored in all contacts, J. Needs kinematics.
pub(crate) fn elastic_energy<S: Scalar, P: ParameterView<S>>(t: &Topology, numbers: P, bodies: &[BodyScratch<S>]) -> S {
    let n = contact_parameters(t.n_body(), t.n_rotor());
    let (stiffness, ground): (S, S) = (numbers.get(n), numbers.get(n + 4));
    let mut sum = S::zero();
    for k in &t.on_ground {
        let feature = &t.features[*k];
        let Some(body) = feature.body else { continue };
        for point in feature.form.points() {
            let contact = sphere_plane(world(&bodies[body], *point), S::constant(feature.radius), ground);
            sum += stored(contact.depth);
        }
    }
    for pair in &t.pairs {
        sum += stored(contact_of(t, *pair, numbers, bodies).depth);
    }
    stiffness * sum
}

/// ⅖ δ^{5/2}.
fn stored<S: Scalar>(depth: S) -> S {
    let depth = depth.max(S::zero());
    S::constant(0.4) * depth * depth * safe::sqrt(depth, 1e-12)
}
