//! The physics of a model as one vector of numbers, and how kernels read it.
//!
//! Gravity first; then [`LINK_PARAMETERS`] per body, then `ROTOR_PARAMETERS`
//! per rotor, [`CONTACT_PARAMETERS`], the position of every shape that stands still in the world, and [`CABLE_PARAMETERS`] per cable. The first twenty entries of a one-body model are those of
//! [`parameter_vector`](crate::rigid::parameter_vector). Rotations of joints, axes and topology are not
//! numbers: they stay as they were built.

use super::model::{Body, BodyShape, Model};
use crate::domain::Domain::{self, AnySign, NonNegative, Positive};
use crate::rigid::BODY_PARAMETERS;
use crate::rotor::{N_ROTOR_PARAMETER, ROTOR_PARAMETERS};
use crate::spatial::Vec3;
use autodiff::Scalar;

/// Physical parameters of one body and its joint, in order, and what each may be: those of an airframe but gravity, then
/// the joint's.
#[doc(hidden)]
pub const LINK_PARAMETERS: [(&str, Domain); OF_BODY + JOINT_PARAMETERS.len()] = {
    let mut all = [JOINT_PARAMETERS[0]; OF_BODY + JOINT_PARAMETERS.len()];
    let mut k = 0;
    while k < all.len() {
        all[k] = if k < OF_BODY {
            (BODY_PARAMETERS[k + 1].name, BODY_PARAMETERS[k + 1].domain)
        } else {
            JOINT_PARAMETERS[k - OF_BODY]
        };
        k += 1;
    }
    all
};

const OF_BODY: usize = BODY_PARAMETERS.len() - 1;

#[rustfmt::skip]
const JOINT_PARAMETERS: [(&str, Domain); 14] = [
    ("joint_position_x", AnySign), ("joint_position_y", AnySign), ("joint_position_z", AnySign),
    ("joint_damping", NonNegative), ("joint_stiffness", NonNegative),
    ("joint_rest", AnySign), ("joint_armature", NonNegative),
    ("limit_lower", AnySign), ("limit_upper", AnySign),
    ("limit_stiffness", NonNegative), ("limit_dissipation", NonNegative),
    ("drive_stiffness", NonNegative), ("drive_damping", NonNegative), ("drive_max_torque", NonNegative),
];

/// Physical parameters of contact, in order, and what each may be.
#[rustfmt::skip]
#[doc(hidden)]
pub const CONTACT_PARAMETERS: [(&str, Domain); 5] = [
    ("contact.stiffness", NonNegative), ("contact.dissipation", NonNegative), ("contact.friction", NonNegative),
    ("contact.slip_speed", Positive), ("contact.ground", AnySign),
];

/// Physical parameters of a cable, in order, and what each may be.
#[doc(hidden)]
pub const CABLE_PARAMETERS: [(&str, Domain); 3] =
    [("length", Positive), ("stiffness", NonNegative), ("dissipation", NonNegative)];

/// All numbers of a model.
#[doc(hidden)]
pub fn model_parameters(model: &Model) -> Vec<f64> {
    let mut p = vec![model.parts().gravity];
    model.bodies().iter().for_each(|b| push_body(&mut p, b));
    model.rotors().iter().for_each(|r| p.extend(r.rotor.parameters()));
    let contact = &model.parts().contact;
    let m = &contact.material;
    p.extend([m.stiffness, m.dissipation, m.friction, m.slip_speed, contact.ground.unwrap_or(0.0)]);
    still_shapes(model).for_each(|s| p.extend(s.shape.position));
    model.cables().iter().for_each(|c| p.extend([c.length, c.stiffness, c.dissipation]));
    p
}

/// Shapes that stand still in the world, in order.
fn still_shapes(model: &Model) -> impl Iterator<Item = &BodyShape> {
    model.shapes().iter().filter(|s| s.body.is_none())
}

fn push_body(p: &mut Vec<f64>, body: &Body) {
    let (i, d, j) = (&body.inertia, &body.drag, &body.joint);
    p.push(body.mass);
    p.extend(body.center_of_mass);
    p.extend([i.xx, i.yy, i.zz, i.xy, i.xz, i.yz]);
    p.extend(d.linear.iter().chain(&d.quadratic).chain(&d.angular));
    p.extend(j.position);
    p.extend([j.damping, j.stiffness, j.rest, j.armature]);
    p.extend(j.limits.map_or([0.0; 4], |l| [l.lower, l.upper, l.stiffness, l.dissipation]));
    p.extend(j.drive.map_or([0.0; 3], |d| [d.stiffness, d.damping, d.max_torque]));
}

/// Names of the entries of [`model_parameters`]: `body.mass`, `rotor.spin`.
#[doc(hidden)]
pub fn model_parameter_names(model: &Model) -> Vec<String> {
    let bodies = model.bodies().iter().flat_map(|b| LINK_PARAMETERS.iter().map(|(n, _)| format!("{}.{n}", b.name)));
    let rotors = model.rotors().iter().flat_map(|r| r.rotor.parameter_names());
    let contact = CONTACT_PARAMETERS.iter().map(|(n, _)| n.to_string());
    let still = still_shapes(model)
        .enumerate()
        .flat_map(|(i, s)| ["x", "y", "z"].iter().map(move |axis| format!("{}.{i}.position_{axis}", s.part)));
    let cables =
        model.cables().iter().flat_map(|c| CABLE_PARAMETERS.iter().map(move |(n, _)| format!("{}.{n}", c.name)));
    let first = std::iter::once("gravity".to_string());
    first.chain(bodies).chain(rotors).chain(contact).chain(still).chain(cables).collect()
}

/// What each entry of `model_parameters` may be.
#[doc(hidden)]
pub fn model_parameter_domains(model: &Model) -> Vec<Domain> {
    let of = |(_, domain): &(&str, Domain)| *domain;
    let bodies = model.bodies().iter().flat_map(|_| LINK_PARAMETERS.iter().map(of));
    let rotors = model.rotors().iter().flat_map(|_| ROTOR_PARAMETERS.iter().map(|p| p.domain));
    let still = still_shapes(model).flat_map(|_| [AnySign; 3]);
    let contact = CONTACT_PARAMETERS.iter().map(of);
    let cables = model.cables().iter().flat_map(|_| CABLE_PARAMETERS.iter().map(of));
    std::iter::once(BODY_PARAMETERS[0].domain)
        .chain(bodies)
        .chain(rotors)
        .chain(contact)
        .chain(still)
        .chain(cables)
        .collect()
}

/// A source of the numbers over a scalar: constants, parameters that derivatives are taken of, rows of a batch.
pub(crate) trait ParameterView<S: Scalar>: Copy {
    /// Number k of `model_parameters`.
    fn get(self, k: usize) -> S;

    #[inline]
    fn vector(self, k: usize) -> Vec3<S> {
        [self.get(k), self.get(k + 1), self.get(k + 2)]
    }
}

/// Numbers of a single system: nominal ones without derivatives, or values over the scalar itself.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Source<'a, S> {
    Constants(&'a [f64]),
    Values(&'a [S]),
}

impl<S: Scalar> ParameterView<S> for Source<'_, S> {
    #[inline]
    fn get(self, k: usize) -> S {
        match self {
            Self::Constants(numbers) => S::constant(numbers[k]),
            Self::Values(numbers) => numbers[k],
        }
    }
}

impl<S: Scalar> ParameterView<S> for &[S] {
    #[inline]
    fn get(self, k: usize) -> S {
        self[k]
    }
}

/// Places within the numbers of one body.
pub(crate) mod at {
    use crate::rigid::at;

    /// Gravity stands once, before all bodies.
    pub(crate) const MASS: usize = at::mass - 1;
    pub(crate) const CENTER_OF_MASS: usize = at::center_of_mass_x - 1;
    pub(crate) const INERTIA: usize = at::inertia_xx - 1;
    pub(crate) const LINEAR_DRAG: usize = at::linear_drag_x - 1;
    pub(crate) const QUADRATIC_DRAG: usize = at::quadratic_drag_x - 1;
    pub(crate) const ANGULAR_DRAG: usize = at::angular_drag_x - 1;
    pub(crate) const JOINT_POSITION: usize = super::OF_BODY;
    /// Damping, stiffness, rest.
    pub(crate) const SPRING: usize = 22;
    pub(crate) const ARMATURE: usize = 25;
    /// Lower, upper, stiffness, dissipation.
    pub(crate) const LIMITS: usize = 26;
    /// Stiffness, damping, max_torque.
    pub(crate) const DRIVE: usize = 30;
}

/// Where the numbers of body `body` begin.
#[inline]
pub(crate) const fn link_parameters(body: usize) -> usize {
    1 + body * LINK_PARAMETERS.len()
}

/// Where the numbers of rotor `rotor` begin in a model of `n_body` bodies.
#[inline]
pub(crate) const fn rotor_parameters(n_body: usize, rotor: usize) -> usize {
    1 + n_body * LINK_PARAMETERS.len() + rotor * N_ROTOR_PARAMETER
}

/// Where the numbers of contact begin.
#[inline]
pub(crate) const fn contact_parameters(n_body: usize, n_rotor: usize) -> usize {
    rotor_parameters(n_body, n_rotor)
}

/// Where the position of still shape `shape` begins.
#[inline]
pub const fn static_parameters(n_body: usize, n_rotor: usize, shape: usize) -> usize {
    contact_parameters(n_body, n_rotor) + CONTACT_PARAMETERS.len() + 3 * shape
}

/// Where the numbers of cable `cable` begin in a model with `n_still` shapes that stand still.
#[inline]
pub(crate) const fn cable_parameters(n_body: usize, n_rotor: usize, n_still: usize, cable: usize) -> usize {
    static_parameters(n_body, n_rotor, n_still) + CABLE_PARAMETERS.len() * cable
}
