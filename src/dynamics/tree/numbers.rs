//! The physics of a model as one vector of numbers, and how kernels read it.
//!
//! Gravity first; then [`BODY_NUMBERS`] per body, then [`ROTOR_PARAMETERS`]
//! per rotor, [`CONTACT_NUMBERS`], and the position of every shape that stands still in the world. The first twenty entries of a one-body model are those of
//! [`parameter_vector`](crate::dynamics::rigid::parameter_vector). Rotations of joints, axes and topology are not
//! numbers: they stay as they were built.

use super::model::{Body, BodyShape, Model, MountedRotor};
use crate::autodiff::{Rows, Scalar};
use crate::dynamics::rigid::ROTOR_PARAMETERS;
use crate::dynamics::spatial::Vec3;

/// Physical parameters of one body and its joint, in order.
pub const BODY_NUMBERS: [&str; 33] = [
    "mass",
    "center_of_mass_x",
    "center_of_mass_y",
    "center_of_mass_z",
    "inertia_xx",
    "inertia_yy",
    "inertia_zz",
    "inertia_xy",
    "inertia_xz",
    "inertia_yz",
    "linear_drag_x",
    "linear_drag_y",
    "linear_drag_z",
    "quadratic_drag_x",
    "quadratic_drag_y",
    "quadratic_drag_z",
    "angular_drag_x",
    "angular_drag_y",
    "angular_drag_z",
    "joint_position_x",
    "joint_position_y",
    "joint_position_z",
    "joint_damping",
    "joint_stiffness",
    "joint_rest",
    "joint_armature",
    "limit_lower",
    "limit_upper",
    "limit_stiffness",
    "limit_dissipation",
    "drive_stiffness",
    "drive_damping",
    "drive_max_torque",
];

/// Physical parameters of contact, in order.
pub const CONTACT_NUMBERS: [&str; 5] =
    ["contact.stiffness", "contact.dissipation", "contact.friction", "contact.slip_speed", "contact.ground"];

/// All numbers of a model.
pub fn number_vector(model: &Model) -> Vec<f64> {
    let mut p = vec![model.parts().gravity];
    model.bodies().iter().for_each(|b| push_body(&mut p, b));
    model.rotors().iter().for_each(|r| push_rotor(&mut p, r));
    let contact = &model.parts().contact;
    let m = &contact.material;
    p.extend([m.stiffness, m.dissipation, m.friction, m.slip_speed, contact.ground.unwrap_or(0.0)]);
    still_shapes(model).for_each(|s| p.extend(s.shape.position));
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

fn push_rotor(p: &mut Vec<f64>, mounted: &MountedRotor) {
    let r = &mounted.rotor;
    p.extend(r.position.iter().chain(&r.axis));
    p.extend([r.spin, r.thrust_coefficient, r.moment_per_thrust, r.max_speed]);
    p.extend([r.time_constant_up, r.time_constant_down, r.inertia]);
    p.extend([r.drag_coefficient, r.axial_drag_coefficient, r.rolling_coefficient]);
}

/// Names of the entries of [`number_vector`]: `body.mass`, `rotor.spin`.
pub fn number_names(model: &Model) -> Vec<String> {
    let bodies = model.bodies().iter().flat_map(|b| BODY_NUMBERS.iter().map(|n| format!("{}.{n}", b.name)));
    let rotors = model.rotors().iter().flat_map(|r| ROTOR_PARAMETERS.iter().map(|n| format!("{}.{n}", r.rotor.name)));
    let contact = CONTACT_NUMBERS.iter().map(|n| n.to_string());
    let still = still_shapes(model)
        .enumerate()
        .flat_map(|(i, s)| ["x", "y", "z"].iter().map(move |axis| format!("{}.{i}.position_{axis}", s.part)));
    std::iter::once("gravity".to_string()).chain(bodies).chain(rotors).chain(contact).chain(still).collect()
}

/// A source of the numbers over a scalar: constants, parameters that derivatives are taken of, rows of a batch.
pub(crate) trait Numbers<S: Scalar>: Copy {
    /// Number k of [`number_vector`].
    fn get(self, k: usize) -> S;

    #[inline(always)]
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

impl<S: Scalar> Numbers<S> for Source<'_, S> {
    #[inline(always)]
    fn get(self, k: usize) -> S {
        match self {
            Self::Constants(numbers) => S::constant(numbers[k]),
            Self::Values(numbers) => numbers[k],
        }
    }
}

impl<S: Scalar> Numbers<S> for Rows<'_, S> {
    #[inline(always)]
    fn get(self, k: usize) -> S {
        Rows::get(&self, k)
    }
}

/// Places within the numbers of one body.
pub(crate) mod at {
    pub(crate) const MASS: usize = 0;
    pub(crate) const CENTER_OF_MASS: usize = 1;
    pub(crate) const INERTIA: usize = 4;
    pub(crate) const LINEAR_DRAG: usize = 10;
    pub(crate) const QUADRATIC_DRAG: usize = 13;
    pub(crate) const ANGULAR_DRAG: usize = 16;
    pub(crate) const JOINT_POSITION: usize = 19;
    /// Damping, stiffness, rest.
    pub(crate) const SPRING: usize = 22;
    pub(crate) const ARMATURE: usize = 25;
    /// Lower, upper, stiffness, dissipation.
    pub(crate) const LIMITS: usize = 26;
    /// Stiffness, damping, max_torque.
    pub(crate) const DRIVE: usize = 30;
}

/// Where the numbers of body `body` begin.
#[inline(always)]
pub(crate) const fn body_numbers(body: usize) -> usize {
    1 + body * BODY_NUMBERS.len()
}

/// Where the numbers of rotor `rotor` begin in a model of `n_body` bodies.
#[inline(always)]
pub(crate) const fn rotor_numbers(n_body: usize, rotor: usize) -> usize {
    1 + n_body * BODY_NUMBERS.len() + rotor * ROTOR_PARAMETERS.len()
}

/// Where the numbers of contact begin.
#[inline(always)]
pub(crate) const fn contact_numbers(n_body: usize, n_rotor: usize) -> usize {
    rotor_numbers(n_body, n_rotor)
}

/// Where the position of still shape `shape` begins.
#[inline(always)]
pub(crate) const fn still_numbers(n_body: usize, n_rotor: usize, shape: usize) -> usize {
    contact_numbers(n_body, n_rotor) + CONTACT_NUMBERS.len() + 3 * shape
}
