//! Rows of a block of single multirotors, and the step that they are stepped by.
//!
//! A block holds [`BLOCK`](autodiff::program::BLOCK) environments as structure of arrays: row k is number k of every environment.
//! State rows come first, then the action's, the disturbance's, the flag `alive`. The model's constants stand in rows of their own, one
//! set for all environments that share them.

use crate::integrate::{Grid, step};
use crate::rigid::{Disturbance, Effects, RigidModel, RigidState};
use crate::rotor::{Motors, RotorModel};
use crate::vehicle::MAX_ROTORS;
use autodiff::{Scalar, Trace};

/// Largest magnitude of a healthy state, SI units.
pub const DIVERGED_ABOVE: f64 = 1e8;

/// Values of the row `alive`: stepping whatever comes of it, stepping, stopped in this step, stopped earlier and listed.
pub(crate) const UNCHECKED: f32 = 2.0;
pub const ALIVE: f32 = 1.0;
pub const STOPPED: f32 = 0.0;
pub(crate) const REPORTED: f32 = -1.0;

/// Applies a macro to the numbers of a rotor that lean kernels read, in the order of their rows.
macro_rules! lean_rotor {
    ($each:ident, $r:ident, $m:ident) => {
        $each!($r.force[2], $r.moment[0], $r.moment[1], $r.moment[2], $r.max_speed, $m.up.decay, $m.down.decay)
    };
}

/// As `lean_rotor` for what other kernels read besides.
#[rustfmt::skip]
macro_rules! rest_rotor {
    ($each:ident, $r:ident, $m:ident) => {
        $each!(
            $r.force[0], $r.force[1], $m.up.rate, $m.down.rate, $r.hub[0], $r.hub[1], $r.hub[2],
            $r.axis[0], $r.axis[1], $r.axis[2], $r.spin_inertia, $r.drag, $r.axial_drag, $r.rolling, $r.radius
        )
    };
}

/// Whether any effect needs the constants behind the lean ones.
fn needs_rest(e: Effects) -> bool {
    e.quadratic_drag
        || e.rotor_drag
        || e.rolling_moment
        || e.rotor_inertia
        || e.ground_effect
        || e.tilted_rotors
        || e.products_of_inertia
}

/// A model as numbers in the order that [`unpack`] reads them, one by one into `put`.
pub(crate) fn pack<S: Scalar>(m: &RigidModel<S, MAX_ROTORS>, mut put: impl FnMut(S)) {
    let mut all = |numbers: &[S]| numbers.iter().for_each(|x| put(*x));
    all(&[m.gravity, m.inverse_mass]);
    all(&m.center_of_mass);
    all(&m.inertia[..3]);
    all(&m.inverse_inertia[..3]);
    all(&m.linear_drag);
    all(&m.angular_drag);
    macro_rules! put {
        ($($number:expr),*) => { all(&[$($number),*]) };
    }
    for (rotor, motors) in m.rotors.iter().zip(&m.motors).take(m.n_rotor) {
        lean_rotor!(put, rotor, motors);
    }
    all(&[m.mass]);
    all(&m.inertia[3..]);
    all(&m.inverse_inertia[3..]);
    all(&m.quadratic_drag);
    all(&[m.ground_height]);
    for (rotor, motors) in m.rotors.iter().zip(&m.motors).take(m.n_rotor) {
        rest_rotor!(put, rotor, motors);
    }
}

/// Reads numbers one after the other.
struct Cursor<'a, S> {
    numbers: &'a [S],
    at: usize,
}

impl<S: Scalar> Cursor<'_, S> {
    fn next(&mut self) -> S {
        self.at += 1;
        self.numbers[self.at - 1]
    }

    fn array<const N: usize>(&mut self) -> [S; N] {
        std::array::from_fn(|_| self.next())
    }
}

/// The model that [`pack`] made numbers of.
pub(super) fn unpack<S: Scalar>(numbers: &[S], n_rotor: usize, effects: Effects) -> RigidModel<S, MAX_ROTORS> {
    let mut cursor = Cursor { numbers, at: 0 };
    let (c, o) = (&mut cursor, S::zero());
    let (gravity, inverse_mass) = (c.next(), c.next());
    let center_of_mass = c.array();
    let [xx, yy, zz] = c.array();
    let [ixx, iyy, izz] = c.array();
    let (linear_drag, angular_drag) = (c.array(), c.array());
    macro_rules! take {
        ($($number:expr),*) => { $($number = c.next();)* };
    }
    let (mut rotors, mut motors) = ([RotorModel::dead(); MAX_ROTORS], [Motors::none(); MAX_ROTORS]);
    for (rotor, own) in rotors.iter_mut().zip(&mut motors).take(n_rotor) {
        lean_rotor!(take, rotor, own);
    }
    let mut model = RigidModel {
        gravity,
        mass: o,
        inverse_mass,
        center_of_mass,
        inertia: [xx, yy, zz, o, o, o],
        inverse_inertia: [ixx, iyy, izz, o, o, o],
        linear_drag,
        angular_drag,
        quadratic_drag: [o; 3],
        ground_height: o,
        n_rotor,
        rotors,
        motors,
    };
    if needs_rest(effects) {
        model.mass = c.next();
        model.inertia[3..].copy_from_slice(&c.array::<3>());
        model.inverse_inertia[3..].copy_from_slice(&c.array::<3>());
        model.quadratic_drag = c.array();
        model.ground_height = c.next();
        for (rotor, own) in model.rotors.iter_mut().zip(&mut model.motors).take(n_rotor) {
            rest_rotor!(take, rotor, own);
        }
    }
    model
}

/// The next state of a vehicle with as many rotors, of state, input and numbers as rows have them.
pub(super) fn next_state(
    n_rotor: usize,
    effects: Effects,
    grid: Grid,
    (state, input, numbers): (&[Trace], &[Trace], &[Trace]),
) -> Vec<Trace> {
    let model = unpack(numbers, n_rotor, effects);
    let x = RigidState::read(state);
    let mut action = [Trace::zero(); MAX_ROTORS];
    action[..n_rotor].copy_from_slice(&input[..n_rotor]);
    let air = if effects.disturbance { Disturbance::read(&input[n_rotor..]) } else { Disturbance::none() };
    let mut next = vec![Trace::zero(); state.len()];
    step(&model, effects, grid, &x, &action, &air).write(&mut next);
    next
}

/// Lanes that are to show where a step leads.
#[inline]
pub(crate) fn is_unchecked<S: Scalar>(alive: S) -> S::Mask {
    S::constant(0.5 * f64::from(ALIVE + UNCHECKED)).lt(alive)
}
