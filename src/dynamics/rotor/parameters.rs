//! The sixteen numbers of a rotor: one table, from which vectors, names, packing, signs and printed sheets come.

use crate::domain::Domain;
use crate::vehicle::Rotor;

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

/// The table, and the place of each of its rows.
macro_rules! rotor_parameters {
    ($($name:ident: $domain:ident, $symbol:literal, $unit:literal, $meaning:literal, $field:ident $([$axis:literal])?;)*) => {
        /// Physical parameters of one rotor, in the order of every vector, name list and kernel. The radius is geometry,
        /// not among them.
        pub const ROTOR_PARAMETERS: [RotorParameter; N_ROTOR_PARAMETER] = [$(RotorParameter {
            name: stringify!($name),
            symbol: $symbol,
            unit: $unit,
            meaning: $meaning,
            domain: Domain::$domain,
            get: |rotor| rotor.$field$([$axis])?,
            set: |rotor, value| rotor.$field$([$axis])? = value,
        }),*];

        #[allow(non_camel_case_types)]
        enum Place { $($name),* }

        /// Places among the numbers of one rotor.
        #[allow(non_upper_case_globals, dead_code)]
        pub mod at {
            $(pub const $name: usize = super::Place::$name as usize;)*
        }
    };
}

/// Numbers of one rotor.
pub const N_ROTOR_PARAMETER: usize = 16;

rotor_parameters! {
    position_x: AnySign, "r_x", "m", "hub, forward", position[0];
    position_y: AnySign, "r_y", "m", "hub, left", position[1];
    position_z: AnySign, "r_z", "m", "hub, up", position[2];
    axis_x: UnitVector, "n_x", "-", "direction of thrust, forward", axis[0];
    axis_y: UnitVector, "n_y", "-", "direction of thrust, left", axis[1];
    axis_z: UnitVector, "n_z", "-", "direction of thrust, up", axis[2];
    spin: Spin, "σ", "-", "counter-clockwise or clockwise seen from the axis", spin;
    thrust_coefficient: Positive, "k_f", "N s²/rad²", "thrust per speed squared", thrust_coefficient;
    moment_per_thrust: NonNegative, "κ", "m", "moment per thrust", moment_per_thrust;
    max_speed: Positive, "Ω_max", "rad/s", "largest speed", max_speed;
    time_constant_up: Positive, "τ up", "s", "motor speeding up", time_constant_up;
    time_constant_down: Positive, "τ down", "s", "motor slowing down", time_constant_down;
    inertia: NonNegative, "I_p", "kg m²", "inertia about the axis", inertia;
    drag_coefficient: NonNegative, "k_d", "N s²/(m rad)", "drag across the axis", drag_coefficient;
    axial_drag_coefficient: NonNegative, "k_z", "N s²/(m rad)", "drag along the axis", axial_drag_coefficient;
    rolling_coefficient: NonNegative, "μ", "N s²/rad", "rolling moment", rolling_coefficient;
}

impl Rotor {
    /// Its numbers, SI, in the order of all vectors of parameters (`ROTOR_PARAMETERS`): position 3, axis 3, spin,
    /// thrust_coefficient, moment_per_thrust, max_speed, time_constant_up, time_constant_down, inertia, drag_coefficient,
    /// axial_drag_coefficient, rolling_coefficient. The radius is not among them.
    pub fn parameters(&self) -> [f64; N_ROTOR_PARAMETER] {
        ROTOR_PARAMETERS.map(|p| (p.get)(self))
    }

    /// Takes the numbers of [`Rotor::parameters`].
    pub fn set_parameters(&mut self, values: &[f64; N_ROTOR_PARAMETER]) {
        for (p, value) in ROTOR_PARAMETERS.iter().zip(values) {
            (p.set)(self, *value);
        }
    }

    /// Names of its numbers in the same order: `rotor_0.spin`.
    pub fn parameter_names(&self) -> impl Iterator<Item = String> + '_ {
        ROTOR_PARAMETERS.iter().map(|p| format!("{}.{}", self.name, p.name))
    }
}
