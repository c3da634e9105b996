//! Contact forces between the shapes of an environment, and on the ground.
//!
//! The law is that of [`contact`](crate::contact); here is which shape touches which, and on which body the
//! force then acts. Needs kinematics.
//!
//! **Stiffness.** An explicit step h gains energy at a contact that is stiffer than it resolves, and throws a light body off. So
//! every touch has a bound by what its points feel: with the mobility 1/m, the largest eigenvalue of J M⁻¹ Jᵀ at rest over
//! points and directions, k is at most m g/δ^{3/2} with δ = 6 g h², what bobs at ½/h there (6 g h² = 3g/(2ω²)), and damping at
//! most m/h (RK4) or m/(2h). For the semi-implicit step m on the ground is also at most that of all points of a side of the
//! body that meet it at once, over their number. The force stays that of a material, conservative but for its damping. Against boxes all balls of
//! what touches may rest at once (m is that of a quarter of their sum where that is less), and the corners of a box within
//! another, where the nearest face changes, take a sixteenth of k.
//!
//! **Friction that sticks.** A body at rest creeps at a share of the slip speed v_s, so v_s is small, and friction, with a
//! slope of up to μ F_n/v_s, far steeper than the stages of a step resolve. Against what stands still it is sampled at the
//! start of a substep h: the articulated-body algorithm finds the accelerations a under −(μ F_n/v_s)(v_t + h a_t) at all
//! points of contact at once (h μ F_n/v_s across the normal adds to the inertia of what touches). What acts, held through the
//! substep, is −μ F_n u/(1 + U⁴)^{1/4} with u = (v_t + h a_t)/v_s and U² the mean of u² over the points of the tree, weighed
//! by μ F_n: one factor for all of them, since forces that are cut one by one could drive. So their sum never exceeds
//! Σ μ F_n, and where all slip alike each obeys Coulomb. Never steeper than 1/h in the velocity, it is stable for any
//! v_s, does not turn slip around, and never exceeds μ F_n. Between two bodies that both move it stays explicit, at a slip
//! speed that the stages resolve, 0.1 m/s at least.

use super::parameters::{ParameterView, contact_parameters, static_parameters};
use super::scratch::{Articulated, BodyScratch};
use super::topology::{Ball, Feature, Form, Pair, Topology};
use crate::contact::material::Resolved;
use crate::contact::pairs::{capsule_capsule, sphere_box, sphere_capsule, sphere_plane, sphere_relief, sphere_sphere};
use crate::contact::{ContactMaterial, ContactPoint, Material, force};
use crate::rigid::symmetric;
use crate::spatial::*;
use autodiff::{Scalar, safe};

/// Least slip speed between two bodies that both move, m/s: what sticks to what moves is not resolved.
const LEAST_SLIP: f64 = 0.1;

/// How an evaluation treats friction against what stands still.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Friction {
    /// As the law says at the velocity of the moment.
    Explicit,
    /// Linear and implicit over a step of so many seconds.
    Sampled(f64),
    /// What was found from that, over a step of so many seconds.
    Held(f64),
}

/// What is done at each contact.
#[derive(Clone, Copy)]
struct Visit<S> {
    friction: Friction,
    /// Of the topology.
    sticks: bool,
    /// Forces are being found from accelerations that a sample gave; else forces and inertias are being added.
    settles: bool,
    gravity: S,
}

/// Adds contact forces to the outside loads of every body, and to its net contact force. A sample adds to inertias too: they
/// are zeroed here.
pub(crate) fn apply<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    numbers: P,
    friction: Friction,
    bodies: &mut [BodyScratch<S>],
) {
    for i in 0..t.n_body() {
        let body = &mut bodies[i];
        body.contact = [S::zero(); 3];
        match friction {
            Friction::Explicit => {}
            Friction::Sampled(_) => body.inertia = Articulated::zero(),
            Friction::Held(_) => {
                body.contact = body.grip.force;
                body.force = add(body.force, body.grip.force);
                body.moment = add(body.moment, body.grip.moment);
            }
        }
    }
    visit(t, numbers, Visit { friction, sticks: t.sticks, settles: false, gravity: numbers.get(0) }, bodies);
}

/// Least load of a tree's contacts that counts, N.
const LEAST_LOAD: f64 = 1e-9;

/// Finds the friction that is held through a substep of `step` s, from the accelerations of a sample.
pub(crate) fn settle<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    numbers: P,
    step: f64,
    bodies: &mut [BodyScratch<S>],
) {
    for i in 0..t.n_body() {
        bodies[i].grip = Wrench::zero();
        bodies[i].slip = [S::zero(); 2];
    }
    let visit_all = Visit { friction: Friction::Sampled(step), sticks: true, settles: true, gravity: numbers.get(0) };
    visit(t, numbers, visit_all, bodies);
    for k in 0..t.layout.trees.len() {
        let (first, end) = (t.layout.trees[k].bodies.start, t.layout.trees[k].bodies.end);
        let mut sum = [S::zero(); 2];
        for i in first..end {
            sum = add(sum, bodies[i].slip);
        }
        let mean = sum[1] * sum[0].max(S::constant(LEAST_LOAD)).recip();
        let share = force::share(mean);
        for i in first..end {
            let grip = &mut bodies[i].grip;
            (grip.force, grip.moment) = (scale(share, grip.force), scale(share, grip.moment));
        }
    }
}

fn visit<S: Scalar, P: ParameterView<S>>(t: &Topology, numbers: P, at: Visit<S>, bodies: &mut [BodyScratch<S>]) {
    let n = contact_parameters(t.n_body(), t.n_rotor());
    let usual = usual_material(numbers, n);
    let ground = numbers.get(n + 4);
    for k in 0..t.on_ground.len() {
        let feature = &t.features[t.on_ground[k].what];
        let material = material_of(&t.on_ground[k].material, &usual).within(&t.resolved.on_ground[k]);
        if let Some(body) = feature.body {
            let points = feature.form.points();
            for i in 0..points.len() {
                let contact = ground_contact(t, world(&bodies[body], points[i]), feature.radius, ground);
                touch(at, &material, &contact, (Some(body), None), bodies);
            }
        }
    }
    for k in 0..t.pairs.len() {
        let pair = t.pairs[k].what;
        let material = material_of(&t.pairs[k].material, &usual).within(&t.resolved.pairs[k]);
        let (first, second) = (&t.features[pair.first], &t.features[pair.second]);
        let both = (first.body, second.body);
        if pair.by_balls {
            for b in 0..first.balls.len() {
                let contact = ball_contact(t, (first, first.balls[b]), second, numbers, bodies);
                touch(at, &material, &contact, both, bodies);
            }
        } else {
            let contact = contact_of(t, pair, numbers, bodies);
            touch(at, &material, &contact, both, bodies);
        }
    }
}

/// Of what has none of its own, from the numbers of contact at `n`.
fn usual_material<S: Scalar, P: ParameterView<S>>(numbers: P, n: usize) -> Material<S> {
    Material {
        stiffness: numbers.get(n),
        dissipation: numbers.get(n + 1),
        friction: numbers.get(n + 2),
        slip_speed: numbers.get(n + 3),
        ..ContactMaterial::default().cast()
    }
}

#[inline]
fn material_of<S: Scalar>(own: &Option<ContactMaterial>, usual: &Material<S>) -> Material<S> {
    match own {
        Some(material) => material.cast(),
        None => *usual,
    }
}

/// Force and inertia at one contact of a first with a second body; `None` stands still.
fn touch<S: Scalar>(
    at: Visit<S>,
    material: &Material<S>,
    contact: &ContactPoint<S>,
    (first, second): (Option<usize>, Option<usize>),
    bodies: &mut [BodyScratch<S>],
) {
    match (at.friction, first, second) {
        (Friction::Sampled(step), Some(body), None) => grip(at, step, material, contact, &mut bodies[body]),
        (Friction::Sampled(step), None, Some(body)) => {
            grip(at, step, material, &opposite(*contact), &mut bodies[body]);
        }
        (Friction::Held(_), Some(body), None) => hold(material, contact, &mut bodies[body]),
        (Friction::Held(_), None, Some(body)) => hold(material, &opposite(*contact), &mut bodies[body]),
        (friction, ..) => {
            if at.settles {
                return;
            }
            let mut material = *material;
            if first.is_some() && second.is_some() {
                material.slip_speed = material.slip_speed.max(S::constant(LEAST_SLIP));
            }
            if let Friction::Sampled(step) | Friction::Held(step) = friction {
                material.slip_speed = material.slip_speed.max(S::constant(force::RESOLVED * step));
            }
            let mut relative = [S::zero(); 3];
            if let Some(b) = first {
                relative = velocity_at(&bodies[b], contact.point);
            }
            if let Some(b) = second {
                relative = sub(relative, velocity_at(&bodies[b], contact.point));
            }
            let pushed = if at.sticks && (first.is_none() || second.is_none()) {
                let leaving = dot(contact.normal, relative);
                let normal = force::normal_force(&material, contact.depth, -leaving);
                let friction = force::sticking(&material, normal, axpy(relative, -leaving, contact.normal));
                axpy(friction, normal, contact.normal)
            } else {
                force::force(&material, contact, relative)
            };
            if let Some(b) = first {
                push(&mut bodies[b], contact.point, pushed);
            }
            if let Some(b) = second {
                push(&mut bodies[b], contact.point, neg(pushed));
            }
        }
    }
}

/// F_n, and the velocity that it goes with, of a body that something still pushes.
#[inline]
fn normal_of<S: Scalar>(material: &Material<S>, contact: &ContactPoint<S>, body: &BodyScratch<S>) -> (S, Vec3<S>) {
    let velocity = velocity_at(body, contact.point);
    (force::normal_force(material, contact.depth, -dot(contact.normal, velocity)), velocity)
}

/// The normal force alone: friction is held.
#[inline]
fn hold<S: Scalar>(material: &Material<S>, contact: &ContactPoint<S>, body: &mut BodyScratch<S>) {
    let (normal, _) = normal_of(material, contact, body);
    push(body, contact.point, scale(normal, contact.normal));
}

/// Friction over a step: as inertia and force on the way to accelerations, as a force held once they are known.
fn grip<S: Scalar>(
    at: Visit<S>,
    step: f64,
    material: &Material<S>,
    contact: &ContactPoint<S>,
    body: &mut BodyScratch<S>,
) {
    let (n, h) = (contact.normal, S::constant(step));
    let (normal, velocity) = normal_of(material, contact, body);
    let lever = sub(contact.point, body.position);
    let w = body.angular_velocity;
    let mut ahead = axpy(velocity, h, cross(w, cross(w, lever)));
    ahead[2] -= h * at.gravity;
    if at.settles {
        let more = add(body.acceleration, cross(body.angular_acceleration, lever));
        let ahead = axpy(ahead, h, more);
        let (load, slip) =
            (material.friction * normal, scale(material.slip_speed.recip(), axpy(ahead, -dot(n, ahead), n)));
        let held = scale(-load, slip);
        body.grip.force = add(body.grip.force, held);
        body.grip.moment = add(body.grip.moment, cross(lever, held));
        body.slip = add(body.slip, [load, load * safe::squared_norm(slip)]);
        return;
    }
    let damping = material.friction * normal * material.slip_speed.recip();
    let held = scale(-damping, axpy(ahead, -dot(n, ahead), n));
    let pushed = axpy(held, normal, n);
    body.force = add(body.force, pushed);
    body.moment = add(body.moment, cross(lever, pushed));
    let k = h * damping;
    let kn = scale(k, n);
    let across = [
        [k - kn[0] * n[0], -(kn[0] * n[1]), -(kn[0] * n[2])],
        [-(kn[0] * n[1]), k - kn[1] * n[1], -(kn[1] * n[2])],
        [-(kn[0] * n[2]), -(kn[1] * n[2]), k - kn[2] * n[2]],
    ];
    // [r]K by rows, and [r]K[r]ᵀ
    let turned = transpose([cross(lever, across[0]), cross(lever, across[1]), cross(lever, across[2])]);
    let about = [cross(lever, turned[0]), cross(lever, turned[1]), cross(lever, turned[2])];
    body.inertia.d = add(body.inertia.d, symmetric(across));
    body.inertia.a = add(body.inertia.a, symmetric(about));
    for row in 0..3 {
        body.inertia.b[row] = add(body.inertia.b[row], turned[row]);
    }
}

#[inline]
fn world<S: Scalar>(body: &BodyScratch<S>, point: [f64; 3]) -> Vec3<S> {
    add(body.position, mat_vec(body.rotation, constants(point)))
}

#[inline]
fn velocity_at<S: Scalar>(body: &BodyScratch<S>, point: Vec3<S>) -> Vec3<S> {
    add(body.velocity, cross(body.angular_velocity, sub(point, body.position)))
}

/// A force at a point of the world.
#[inline]
fn push<S: Scalar>(body: &mut BodyScratch<S>, point: Vec3<S>, force: Vec3<S>) {
    body.contact = add(body.contact, force);
    body.force = add(body.force, force);
    body.moment = add(body.moment, cross(sub(point, body.position), force));
}

/// A ball about `center` on the ground.
#[inline]
fn ground_contact<S: Scalar>(t: &Topology, center: Vec3<S>, radius: f64, ground: S) -> ContactPoint<S> {
    match &t.relief {
        None => sphere_plane(center, S::constant(radius), ground),
        Some(relief) => sphere_relief(center, S::constant(radius), ground, relief),
    }
}

/// A point of a feature in the world.
fn place<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    feature: &Feature,
    point: [f64; 3],
    numbers: P,
    bodies: &[BodyScratch<S>],
) -> Vec3<S> {
    match feature.body {
        Some(body) => world(&bodies[body], point),
        None => add(numbers.vector(static_parameters(t.n_body(), t.n_rotor(), feature.still)), constants(point)),
    }
}

/// A ball of a first feature against a second.
fn ball_contact<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    (first, ball): (&Feature, Ball),
    second: &Feature,
    numbers: P,
    bodies: &[BodyScratch<S>],
) -> ContactPoint<S> {
    let (center, radius) = (place(t, first, ball.center, numbers, bodies), S::constant(ball.radius));
    let Form::Box(block) = &second.form else {
        let [a, b] = ends(t, second, numbers, bodies);
        return sphere_capsule(center, radius, a, b, S::constant(second.radius));
    };
    let position = place(t, second, block.center, numbers, bodies);
    let own = [constants(block.rotation[0]), constants(block.rotation[1]), constants(block.rotation[2])];
    let rotation = match second.body {
        Some(body) => mat_mul(bodies[body].rotation, own),
        None => own,
    };
    sphere_box(center, radius, (position, &rotation), constants(block.half))
}

/// Where a rounded feature's points are in the world.
fn ends<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    feature: &Feature,
    numbers: P,
    bodies: &[BodyScratch<S>],
) -> [Vec3<S>; 2] {
    let points = feature.form.points();
    let last = points.len() - 1;
    [place(t, feature, points[0], numbers, bodies), place(t, feature, points[last], numbers, bodies)]
}

/// Where and how two rounded features touch, the first pushed along the normal.
fn contact_of<S: Scalar, P: ParameterView<S>>(
    t: &Topology,
    pair: Pair,
    numbers: P,
    bodies: &[BodyScratch<S>],
) -> ContactPoint<S> {
    let (first, second) = (&t.features[pair.first], &t.features[pair.second]);
    let ([a1, b1], [a2, b2]) = (ends(t, first, numbers, bodies), ends(t, second, numbers, bodies));
    let (r1, r2) = (S::constant(first.radius), S::constant(second.radius));
    match (matches!(first.form, Form::Sphere(_)), matches!(second.form, Form::Sphere(_))) {
        (true, true) => sphere_sphere(a1, r1, a2, r2),
        (true, false) => sphere_capsule(a1, r1, a2, b2, r2),
        (false, true) => opposite(sphere_capsule(a2, r2, a1, b1, r1)),
        (false, false) => capsule_capsule([a1, b1], r1, [a2, b2], r2),
    }
}

/// The same contact seen from the other body.
#[inline]
fn opposite<S: Scalar>(contact: ContactPoint<S>) -> ContactPoint<S> {
    ContactPoint { normal: neg(contact.normal), ..contact }
}

/// Energy ⅖ k δ^{5/2} stored in all contacts, J. Needs kinematics.
pub(crate) fn elastic_energy<S: Scalar, P: ParameterView<S>>(t: &Topology, numbers: P, bodies: &[BodyScratch<S>]) -> S {
    let n = contact_parameters(t.n_body(), t.n_rotor());
    let (usual, ground) = (usual_material(numbers, n), numbers.get(n + 4));
    let stiffness = |own: &Option<ContactMaterial>, most: &Resolved| material_of(own, &usual).within(most).stiffness;
    let mut sum = S::zero();
    for (touch, most) in t.on_ground.iter().zip(&t.resolved.on_ground) {
        let feature = &t.features[touch.what];
        let Some(body) = feature.body else { continue };
        for point in feature.form.points() {
            let contact = ground_contact(t, world(&bodies[body], *point), feature.radius, ground);
            sum += stiffness(&touch.material, most) * stored(contact.depth);
        }
    }
    for (pair, most) in t.pairs.iter().zip(&t.resolved.pairs) {
        let (first, second) = (&t.features[pair.what.first], &t.features[pair.what.second]);
        let mut own = S::zero();
        if pair.what.by_balls {
            for ball in &first.balls {
                own += stored(ball_contact(t, (first, *ball), second, numbers, bodies).depth);
            }
        } else {
            own = stored(contact_of(t, pair.what, numbers, bodies).depth);
        }
        sum += stiffness(&pair.material, most) * own;
    }
    sum
}

/// ⅖ δ^{5/2}.
fn stored<S: Scalar>(depth: S) -> S {
    let depth = depth.max(S::zero());
    S::constant(0.4) * depth * depth * safe::sqrt(depth, 1e-12)
}
