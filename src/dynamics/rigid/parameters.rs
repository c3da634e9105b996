//! The physics of a vehicle as one vector of numbers.

use crate::domain::Domain;
use crate::rotor::{N_ROTOR_PARAMETER, ROTOR_PARAMETERS};
use crate::vehicle::{GRAVITY, Inertia, Part, Rotor, Vehicle};
use base::error::{Error, Result};

/// One number of an airframe: how it is called and printed, and what it may be.
#[derive(Debug, Clone, Copy)]
pub struct BodyParameter {
    /// As in names: `mass`.
    pub name: &'static str,
    /// As in equations.
    pub symbol: &'static str,
    /// SI.
    pub unit: &'static str,
    /// A few words.
    pub meaning: &'static str,
    /// What it may be.
    pub domain: Domain,
}

/// The table, and the place of each of its rows.
macro_rules! body_parameters {
    ($($name:ident: $domain:ident, $symbol:literal, $unit:literal, $meaning:literal;)*) => {
        /// Physical parameters of the airframe in the order of every vector, name list and kernel; those of the rotors follow.
        pub const BODY_PARAMETERS: [BodyParameter; N_BODY_PARAMETER] = [$(BodyParameter {
            name: stringify!($name),
            symbol: $symbol,
            unit: $unit,
            meaning: $meaning,
            domain: Domain::$domain,
        }),*];

        #[allow(non_camel_case_types)]
        enum Place { $($name),* }

        /// Places among the numbers of an airframe; groups of three and the six of the inertia by the first.
        #[allow(non_upper_case_globals, dead_code)]
        pub mod at {
            $(pub const $name: usize = super::Place::$name as usize;)*
        }
    };
}

/// Numbers of an airframe.
pub(crate) const N_BODY_PARAMETER: usize = 20;

body_parameters! {
    gravity: AnySign, "g", "m/s²", "downwards";
    mass: Positive, "m", "kg", "of the whole";
    center_of_mass_x: AnySign, "c_x", "m", "forward";
    center_of_mass_y: AnySign, "c_y", "m", "left";
    center_of_mass_z: AnySign, "c_z", "m", "up";
    inertia_xx: Positive, "J_xx", "kg m²", "about the centre of mass";
    inertia_yy: Positive, "J_yy", "kg m²", "about the centre of mass";
    inertia_zz: Positive, "J_zz", "kg m²", "about the centre of mass";
    inertia_xy: AnySign, "J_xy", "kg m²", "an entry of the matrix, −∫xy dm";
    inertia_xz: AnySign, "J_xz", "kg m²", "an entry of the matrix, −∫xz dm";
    inertia_yz: AnySign, "J_yz", "kg m²", "an entry of the matrix, −∫yz dm";
    linear_drag_x: NonNegative, "d_x", "N s/m", "drag per speed, forward";
    linear_drag_y: NonNegative, "d_y", "N s/m", "drag per speed, left";
    linear_drag_z: NonNegative, "d_z", "N s/m", "drag per speed, up";
    quadratic_drag_x: NonNegative, "q_x", "N s²/m²", "drag per speed squared, forward";
    quadratic_drag_y: NonNegative, "q_y", "N s²/m²", "drag per speed squared, left";
    quadratic_drag_z: NonNegative, "q_z", "N s²/m²", "drag per speed squared, up";
    angular_drag_x: NonNegative, "a_x", "N m s", "moment per angular velocity, forward";
    angular_drag_y: NonNegative, "a_y", "N m s", "moment per angular velocity, left";
    angular_drag_z: NonNegative, "a_z", "N m s", "moment per angular velocity, up";
}

/// Physical parameters of a vehicle as one vector, `BODY_PARAMETERS` then `ROTOR_PARAMETERS` per rotor: what
/// derivatives with respect to physics are taken of, and what randomisation scales.
pub fn parameter_vector(vehicle: &Vehicle) -> Vec<f64> {
    let total = vehicle.mass_properties();
    let (c, j) = (total.center_of_mass, total.inertia);
    let drag = &vehicle.drag;
    let mut p = vec![GRAVITY, total.mass, c.x, c.y, c.z];
    p.extend([j[(0, 0)], j[(1, 1)], j[(2, 2)], j[(0, 1)], j[(0, 2)], j[(1, 2)]]);
    p.extend(drag.linear.iter().chain(&drag.quadratic).chain(&drag.angular));
    for r in &vehicle.rotors {
        p.extend(r.parameters());
    }
    p
}

/// Names of the entries of `parameter_vector`.
pub fn parameter_names(vehicle: &Vehicle) -> Vec<String> {
    let body = BODY_PARAMETERS.iter().map(|own| own.name.to_string());
    body.chain(vehicle.rotors.iter().flat_map(Rotor::parameter_names)).collect()
}

/// What each entry of `parameter_vector` may be.
pub fn parameter_domains(vehicle: &Vehicle) -> Vec<Domain> {
    let rotors = vehicle.rotors.iter().flat_map(|_| ROTOR_PARAMETERS.iter().map(|p| p.domain));
    BODY_PARAMETERS.iter().map(|own| own.domain).chain(rotors).collect()
}

/// The vehicle that a `parameter_vector` describes, as one part; names and whatever the vector leaves out are those of
/// `vehicle`. Gravity is [`GRAVITY`], whatever the vector says.
///
/// # Errors
/// [`Error::Value`] for another length; as [`Vehicle::validate`] for numbers that are no vehicle.
pub fn vehicle_of(vehicle: &Vehicle, parameters: &[f64]) -> Result<Vehicle> {
    let wanted = BODY_PARAMETERS.len() + N_ROTOR_PARAMETER * vehicle.n_rotor();
    if parameters.len() != wanted {
        let what = format!("vehicle '{}': number of parameters", vehicle.name);
        return Err(Error::value(what, parameters.len(), wanted.to_string(), "Take them from parameter_vector."));
    }
    let (body, rotors) = parameters.split_at(BODY_PARAMETERS.len());
    let three = |first: usize| [body[first], body[first + 1], body[first + 2]];
    let inertia = Inertia {
        xx: body[at::inertia_xx],
        yy: body[at::inertia_yy],
        zz: body[at::inertia_zz],
        xy: body[at::inertia_xy],
        xz: body[at::inertia_xz],
        yz: body[at::inertia_yz],
    };
    let mut own = vehicle.clone();
    own.parts = vec![Part::new("body", body[at::mass], three(at::center_of_mass_x), inertia)];
    own.drag.linear = three(at::linear_drag_x);
    own.drag.quadratic = three(at::quadratic_drag_x);
    own.drag.angular = three(at::angular_drag_x);
    for (rotor, values) in own.rotors.iter_mut().zip(rotors.as_chunks().0) {
        rotor.set_parameters(values);
    }
    own.validate()?;
    Ok(own)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicles;

    #[test]
    fn a_vehicle_of_other_numbers_has_those_numbers() {
        for name in vehicles::names() {
            let vehicle = vehicles::by_name(name).unwrap();
            let mut wanted = parameter_vector(&vehicle);
            wanted[at::mass] *= 1.3;
            wanted[at::center_of_mass_z] += 0.01;
            let thrust = BODY_PARAMETERS.len() + crate::rotor::at::thrust_coefficient;
            wanted[thrust] *= 0.9;
            let own = vehicle_of(&vehicle, &wanted).unwrap();
            let off = parameter_vector(&own).iter().zip(&wanted).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs()));
            assert!(off < 1e-12, "{name}: {off:e}");
            assert!(vehicle_of(&vehicle, &wanted[1..]).is_err());
        }
    }
}
