//! The sixteen numbers of a rotor: one table, from which vectors, names, packing, signs and printed sheets come.

use crate::dynamics::domain::Domain;
use crate::dynamics::vehicle::Rotor;

/// One number of a rotor: how it is called and printed, what it may be, where a [`Rotor`] holds it.
#[derive(Debug, Clone, Copy)]
pub struct RotorParameter {
    /// As in files and names: `rotor_0.spin`.
    pub name: &'static str,
    /// As in equations.
    pub symbol: &'static str,
    /// SI.
    pub unit: &'static str,
    /// A few words.
    pub meaning: &'static str,
    /// What it may be.
    pub domain: Domain,
    /// Its value.
    pub get: fn(&Rotor) -> f64,
    /// Gives it another value.
    pub set: fn(&mut Rotor, f64),
}

/// A row of the table; the field is named once for reading and for writing.
macro_rules! row {
    ($domain:ident, $name:literal, $symbol:literal, $unit:literal, $meaning:literal, $($field:tt)+) => {
        RotorParameter {
            name: $name,
            symbol: $symbol,
            unit: $unit,
            meaning: $meaning,
            domain: Domain::$domain,
            get: |rotor| rotor.$($field)+,
            set: |rotor, value| rotor.$($field)+ = value,
        }
    };
}

/// Physical parameters of one rotor, in the order of every vector, name list and kernel. The radius is geometry, not
/// among them.
#[rustfmt::skip]
pub const ROTOR_PARAMETERS: [RotorParameter; 16] = [
    row!(AnySign, "position_x", "r_x", "m", "hub, forward", position[0]),
    row!(AnySign, "position_y", "r_y", "m", "hub, left", position[1]),
    row!(AnySign, "position_z", "r_z", "m", "hub, up", position[2]),
    row!(UnitVector, "axis_x", "n_x", "-", "direction of thrust, forward", axis[0]),
    row!(UnitVector, "axis_y", "n_y", "-", "direction of thrust, left", axis[1]),
    row!(UnitVector, "axis_z", "n_z", "-", "direction of thrust, up", axis[2]),
    row!(Spin, "spin", "σ", "-", "counter-clockwise or clockwise seen from the axis", spin),
    row!(Positive, "thrust_coefficient", "k_f", "N s²/rad²", "thrust per speed squared", thrust_coefficient),
    row!(NonNegative, "moment_per_thrust", "κ", "m", "moment per thrust", moment_per_thrust),
    row!(Positive, "max_speed", "Ω_max", "rad/s", "largest speed", max_speed),
    row!(Positive, "time_constant_up", "τ up", "s", "motor speeding up", time_constant_up),
    row!(Positive, "time_constant_down", "τ down", "s", "motor slowing down", time_constant_down),
    row!(NonNegative, "inertia", "I_p", "kg m²", "inertia about the axis", inertia),
    row!(NonNegative, "drag_coefficient", "k_d", "N s²/(m rad)", "drag across the axis", drag_coefficient),
    row!(NonNegative, "axial_drag_coefficient", "k_z", "N s²/(m rad)", "drag along the axis", axial_drag_coefficient),
    row!(NonNegative, "rolling_coefficient", "μ", "N s²/rad", "rolling moment", rolling_coefficient),
];

/// Places among the numbers of one rotor.
pub(crate) mod at {
    use super::place;

    /// Three numbers.
    pub(crate) const POSITION: usize = place("position_x");
    /// Three numbers.
    pub(crate) const AXIS: usize = place("axis_x");
    pub(crate) const SPIN: usize = place("spin");
    pub(crate) const THRUST: usize = place("thrust_coefficient");
    pub(crate) const MOMENT_PER_THRUST: usize = place("moment_per_thrust");
    pub(crate) const MAX_SPEED: usize = place("max_speed");
    pub(crate) const TIME_UP: usize = place("time_constant_up");
    pub(crate) const TIME_DOWN: usize = place("time_constant_down");
    pub(crate) const INERTIA: usize = place("inertia");
    pub(crate) const DRAG: usize = place("drag_coefficient");
    pub(crate) const AXIAL_DRAG: usize = place("axial_drag_coefficient");
    pub(crate) const ROLLING: usize = place("rolling_coefficient");
}

/// Where the table has a number; does not compile for a name that it lacks.
const fn place(name: &str) -> usize {
    let mut k = 0;
    while !equal(ROTOR_PARAMETERS[k].name.as_bytes(), name.as_bytes()) {
        k += 1;
    }
    k
}

const fn equal(a: &[u8], b: &[u8]) -> bool {
    let mut k = 0;
    while k < a.len() && k < b.len() && a[k] == b[k] {
        k += 1;
    }
    k == a.len() && k == b.len()
}

impl Rotor {
    /// Its numbers in the order of [`ROTOR_PARAMETERS`].
    pub fn parameters(&self) -> [f64; ROTOR_PARAMETERS.len()] {
        ROTOR_PARAMETERS.map(|p| (p.get)(self))
    }

    /// Takes the numbers of [`Rotor::parameters`].
    pub fn set_parameters(&mut self, values: &[f64; ROTOR_PARAMETERS.len()]) {
        for (p, value) in ROTOR_PARAMETERS.iter().zip(values) {
            (p.set)(self, *value);
        }
    }

    /// Names of its numbers: `rotor_0.spin`.
    pub fn parameter_names(&self) -> impl Iterator<Item = String> + '_ {
        ROTOR_PARAMETERS.iter().map(|p| format!("{}.{}", self.name, p.name))
    }
}
