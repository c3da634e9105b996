//! Energy, momentum, mass matrix, poses and Jacobians of an articulated system.

use super::aba::accelerate;
use super::cable_loads;
use super::contact_loads::{self, Friction};
use super::jacobian::{mass_matrix_of, point_jacobian, poses_of};
use super::kinematics::{FrameKinematics, forward, pose_of};
use super::loads;
use super::model::{Model, NamedFrame};
use super::multibody::Multibody;
use super::parameters::{ParameterView, Source, at, link_parameters};
use super::scratch::{BodyScratch, Scratch, scratch_on_stack};
use super::topology::{Kind, Topology, joined};
use super::torque::{Drives, Pass};
use super::wakes;
use crate::rigid::full;
use crate::spatial::*;
use crate::{contact, shape};
use autodiff::Scalar;
use base::error::Result;
use nalgebra::DMatrix;

/// Linear and angular momentum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Momentum<S> {
    /// Σ m v, kg m/s, world.
    pub linear: Vec3<S>,
    /// About the centre of mass of all, kg m²/s, world; spinning rotors not counted.
    pub angular: Vec3<S>,
}

/// Pose and velocity of every body, in the order of the model, `[n_body]`. Here and below `state` is `[n_state]`, and physical parameters
/// are the nominal ones.
pub fn body_poses<S: Scalar>(system: &Multibody, state: &[S]) -> Vec<FrameKinematics<S>> {
    let mut poses = Vec::new();
    body_poses_into(system, state, &mut poses);
    poses
}

/// As [`body_poses`], over what `poses` holds: allocates in its first call only.
#[doc(hidden)]
pub fn body_poses_into<S: Scalar>(system: &Multibody, state: &[S], poses: &mut Vec<FrameKinematics<S>>) {
    let t = system.topology();
    scratch_on_stack!(scratch, t, S);
    forward(t, Source::Constants(system.parameters()), state, scratch.bodies);
    poses.clear();
    poses.extend(scratch.bodies[..t.n_body()].iter().map(pose_of));
}

/// Pose and velocity of a named frame (see [`Model::frame`]).
pub fn frame_pose<S: Scalar>(system: &Multibody, state: &[S], frame: &NamedFrame) -> FrameKinematics<S> {
    let t = system.topology();
    scratch_on_stack!(scratch, t, S);
    forward(t, Source::Constants(system.parameters()), state, scratch.bodies);
    let body = pose_of(&scratch.bodies[frame.body]);
    let lever = mat_vec(body.rotation, constants(frame.position));
    let own = [constants(frame.rotation[0]), constants(frame.rotation[1]), constants(frame.rotation[2])];
    FrameKinematics {
        position: add(body.position, lever),
        rotation: mat_mul(body.rotation, own),
        velocity: add(body.velocity, cross(body.angular_velocity, lever)),
        angular_velocity: body.angular_velocity,
    }
}

/// Tension of every cable, N, in their order; 0 of one that is slack.
pub fn cable_tensions<S: Scalar>(system: &Multibody, state: &[S]) -> Vec<S> {
    let (t, numbers) = (system.topology(), Source::Constants(system.parameters()));
    scratch_on_stack!(scratch, t, S);
    forward(t, numbers, state, scratch.bodies);
    cable_loads::tensions(t, numbers, scratch.bodies)
}

/// Kinetic energy ½ νᵀ M ν of all bodies and geared motors, J; spinning rotors not counted.
pub fn kinetic_energy<S: Scalar>(system: &Multibody, state: &[S]) -> S {
    let (t, numbers) = (system.topology(), Source::Constants(system.parameters()));
    scratch_on_stack!(scratch, t, S);
    forward(t, numbers, state, scratch.bodies);
    let mut twice = S::zero();
    for i in 0..t.n_body() {
        let (p, l) = own_momentum(i, numbers, &scratch.bodies[i]);
        twice += dot(p, center_velocity(&scratch.bodies[i])) + dot(l, scratch.bodies[i].angular_velocity);
        let link = &t.links[i];
        if matches!(link.kind, Kind::Hinge(_) | Kind::Slide(_)) {
            let armature: S = numbers.get(link_parameters(i) + at::ARMATURE);
            twice += armature * state[link.velocity].square();
        }
    }
    twice * S::constant(0.5)
}

/// Potential energy of gravity (zero at z = 0), springs, cables, compressed limits and, with that effect, contacts, J; position
/// drives not counted.
pub fn potential_energy<S: Scalar>(system: &Multibody, state: &[S]) -> S {
    let (t, numbers) = (system.topology(), Source::Constants(system.parameters()));
    scratch_on_stack!(scratch, t, S);
    forward(t, numbers, state, scratch.bodies);
    let (mut energy, half) = (S::zero(), S::constant(0.5));
    let gravity: S = numbers.get(0);
    for i in 0..t.n_body() {
        let (link, n) = (&t.links[i], link_parameters(i));
        let height = scratch.bodies[i].position[2] + scratch.bodies[i].center[2];
        let mass: S = numbers.get(n + at::MASS);
        energy += mass * gravity * height;
        let [_, stiffness, rest]: Vec3<S> = numbers.vector(n + at::SPRING);
        match link.kind {
            Kind::Hinge(_) | Kind::Slide(_) => {
                let q = state[link.position];
                energy += half * stiffness * (q - rest).square();
                if link.limited {
                    let lower: S = numbers.get(n + at::LIMITS);
                    let upper: S = numbers.get(n + at::LIMITS + 1);
                    let stop: S = numbers.get(n + at::LIMITS + 2);
                    let out = (lower - q).max(S::zero()) + (q - upper).max(S::zero());
                    energy += half * stop * out.square();
                }
            }
            Kind::Ball => {
                // 2 k sin²(θ/2)
                let v = [state[link.position + 1], state[link.position + 2], state[link.position + 3]];
                energy += (stiffness + stiffness) * dot(v, v);
            }
            Kind::Floating => {}
        }
    }
    energy += cable_loads::energy(t, numbers, scratch.bodies);
    if t.effects.contact {
        energy += contact_loads::elastic_energy(t, numbers, scratch.bodies);
    }
    energy
}

/// Net contact force on every body, `[n_body]`, N, world: zero without the effect `contact`. Friction that sticks is what the next substep
/// would hold, with rotors at their speeds and drives where they are; all else is the law at this state.
pub fn contact_forces<S: Scalar>(system: &Multibody, state: &[S]) -> Vec<Vec3<S>> {
    contact_forces_with(system, system.parameters(), state)
}

/// As [`contact_forces`] with these numbers of the model.
#[doc(hidden)]
pub fn contact_forces_with<S: Scalar>(system: &Multibody, numbers: &[f64], state: &[S]) -> Vec<Vec3<S>> {
    let (t, numbers) = (system.topology(), Source::Constants(numbers));
    scratch_on_stack!(scratch, t, S);
    let friction = if t.sticks { grip(system, numbers, state, &mut scratch) } else { Friction::Explicit };
    forward(t, numbers, state, scratch.bodies);
    if t.effects.contact {
        contact_loads::apply(t, numbers, friction, scratch.bodies);
    }
    scratch.bodies[..t.n_body()].iter().map(|b| b.contact).collect()
}

/// Finds the friction that a substep from this state would hold.
fn grip<S: Scalar, P: ParameterView<S>>(
    system: &Multibody,
    numbers: P,
    state: &[S],
    scratch: &mut Scratch<'_, S>,
) -> Friction {
    let (t, h) = (system.topology(), system.physics().grid().substep);
    let mut input = vec![S::zero(); t.n_input];
    for (r, rotor) in system.model().rotors().iter().enumerate() {
        let share = state[t.rotor_speed[r]] * S::constant(1.0 / rotor.rotor.max_speed);
        input[t.rotor_action[r]] = S::constant(2.0).mul_add(share.square(), -S::one());
    }
    for link in &t.links[..t.n_body()] {
        if let Some(servo) = link.drive.as_ref().filter(|servo| servo.holds_position) {
            input[servo.command] = (state[link.position] - S::constant(servo.center)) * S::constant(1.0 / servo.range);
        }
    }
    let friction = Friction::Sampled(h);
    loads::prepare_rotors(t, numbers, &input, scratch.rotors);
    loads::start_rotors(t, numbers, h, state, scratch.rotors);
    forward(t, numbers, state, scratch.bodies);
    wakes::hold(t, scratch.bodies, scratch.rotors);
    loads::apply(t, numbers, &input, friction, scratch.bodies, scratch.rotors);
    let pass = Pass { implicit: 0.0, drives: Drives::Sampled(h), friction };
    accelerate(t, numbers, state, &input, pass, scratch.bodies, scratch.rate);
    contact_loads::settle(t, numbers, h, scratch.bodies);
    Friction::Held(h)
}

/// Two shapes, or a shape and the ground, and the signed distance between them.
#[derive(Debug, Clone, PartialEq)]
#[doc(hidden)]
pub struct Separation<S> {
    /// Numbers of the shapes in [`Model::shapes`]; the second is `None` for the ground.
    pub shapes: (usize, Option<usize>),
    /// m; negative where they overlap. See [`distance`](fn@crate::contact::distance).
    pub distance: S,
}

/// Signed distance of every pair of colliding shapes that may meet: on different trees, of a tree and the world or the
/// ground, and within a tree those not joined to each other.
#[doc(hidden)]
pub fn separations<S: Scalar>(system: &Multibody, state: &[S]) -> Vec<Separation<S>> {
    let model = system.model();
    let shapes: Vec<usize> = (0..model.shapes().len()).filter(|i| model.shapes()[*i].collides).collect();
    let poses = body_poses(system, state);
    let pose = |i: usize| {
        let own = &model.shapes()[i];
        let carrier = match own.body {
            Some(b) => shape::Pose { position: poses[b].position, attitude: from_matrix(poses[b].rotation) },
            None => shape::Pose { position: [S::zero(); 3], attitude: identity() },
        };
        own.shape.pose(&carrier)
    };
    let mut list = Vec::new();
    for (n, &i) in shapes.iter().enumerate() {
        let first = &model.shapes()[i];
        if let (Some(_), Some(height)) = (first.body, model.parts().contact.ground) {
            let (geometry, height) = (&first.shape.geometry, S::constant(height));
            let distance = match &model.parts().contact.relief {
                None => contact::plane_distance(geometry, &pose(i), height),
                Some(relief) => contact::ground_distance(geometry, &pose(i), height, relief),
            };
            list.push(Separation { shapes: (i, None), distance });
        }
        for &j in &shapes[n + 1..] {
            let second = &model.shapes()[j];
            let meet = match (first.body, second.body) {
                (None, None) => false,
                (Some(a), Some(b)) => a != b && !joined(model, a, b),
                _ => true,
            };
            if meet {
                let distance = contact::distance(&first.shape.geometry, &pose(i), &second.shape.geometry, &pose(j));
                list.push(Separation { shapes: (i, Some(j)), distance });
            }
        }
    }
    list
}

/// Centre of mass of all bodies, m, world.
pub fn center_of_mass<S: Scalar>(system: &Multibody, state: &[S]) -> Vec3<S> {
    let (t, numbers) = (system.topology(), Source::Constants(system.parameters()));
    scratch_on_stack!(scratch, t, S);
    forward(t, numbers, state, scratch.bodies);
    center(t, numbers, scratch.bodies)
}

fn center<S: Scalar, P: ParameterView<S>>(t: &Topology, numbers: P, bodies: &[BodyScratch<S>]) -> Vec3<S> {
    let (mut sum, mut total) = ([S::zero(); 3], S::zero());
    for i in 0..t.n_body() {
        let mass = numbers.get(link_parameters(i) + at::MASS);
        sum = axpy(sum, mass, add(bodies[i].position, bodies[i].center));
        total += mass;
    }
    scale(total.recip(), sum)
}

/// Linear and angular momentum of all bodies together.
pub fn momentum<S: Scalar>(system: &Multibody, state: &[S]) -> Momentum<S> {
    let (t, numbers) = (system.topology(), Source::Constants(system.parameters()));
    scratch_on_stack!(scratch, t, S);
    forward(t, numbers, state, scratch.bodies);
    let middle = center(t, numbers, scratch.bodies);
    let (mut linear, mut angular) = ([S::zero(); 3], [S::zero(); 3]);
    for i in 0..t.n_body() {
        let body = &scratch.bodies[i];
        let (p, l) = own_momentum(i, numbers, body);
        let lever = sub(add(body.position, body.center), middle);
        linear = add(linear, p);
        angular = add(angular, add(l, cross(lever, p)));
    }
    Momentum { linear, angular }
}

fn center_velocity<S: Scalar>(body: &BodyScratch<S>) -> Vec3<S> {
    add(body.velocity, cross(body.angular_velocity, body.center))
}

/// m v and J ω of one body at its centre of mass.
fn own_momentum<S: Scalar, P: ParameterView<S>>(i: usize, numbers: P, body: &BodyScratch<S>) -> (Vec3<S>, Vec3<S>) {
    let n = link_parameters(i);
    let (d, p) = (numbers.vector(n + at::INERTIA), numbers.vector(n + at::INERTIA + 3));
    let inertia = full([d[0], d[1], d[2], p[0], p[1], p[2]]);
    let own = mat_vec(transpose(body.rotation), body.angular_velocity);
    (scale(numbers.get(n + at::MASS), center_velocity(body)), mat_vec(body.rotation, mat_vec(inertia, own)))
}

/// The joint-space mass matrix M(q), n × n over the velocity vector ν: kinetic energy is ½ νᵀ M ν.
///
/// ν is body by body: of a floating body the velocity of its origin 3 (m/s, world) and angular velocity 3 (rad/s, body); q̇ of a hinge or
/// slide; of a ball the angular velocity relative to its parent 3 (rad/s, child). `state` is `[n_state]`.
///
/// Built from body Jacobians, Σ m Jvᵀ Jv + Jωᵀ (R J Rᵀ) Jω: for design, not for stepping.
///
/// # Errors
/// [`Error::Value`](base::error::Error::Value) if the state has another length than the layout says.
pub fn mass_matrix(model: &Model, state: &[f64]) -> Result<DMatrix<f64>> {
    Multibody::check_length("state", state.len(), model.layout().n_state())?;
    Ok(mass_matrix_of(model, state))
}

/// Jacobian of a named frame, 6 × n: `[velocity of its origin; angular velocity]` (m/s and rad/s, world) = J ν, with ν as of
/// [`mass_matrix`](super::mass_matrix()).
///
/// # Errors
/// [`Error::Value`](base::error::Error::Value) if the state has another length than the layout says.
pub fn frame_jacobian(model: &Model, state: &[f64], frame: &NamedFrame) -> Result<DMatrix<f64>> {
    Multibody::check_length("state", state.len(), model.layout().n_state())?;
    Ok(point_jacobian(model, &poses_of(model, state), frame.body, frame.position))
}
