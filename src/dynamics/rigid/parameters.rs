//! The physics of a vehicle as one vector of numbers.

use crate::dynamics::domain::Domain::{self, AnySign, NonNegative, Positive};
use crate::dynamics::rotor::{N_ROTOR_PARAMETER, ROTOR_PARAMETERS};
use crate::dynamics::vehicle::{GRAVITY, Inertia, Part, Rotor, Vehicle};
use crate::error::{Error, Result};

/// Physical parameters of the airframe in the parameter vector, in order, and what each may be; the rotors' follow.
#[rustfmt::skip]
pub(crate) const BODY_PARAMETERS: [(&str, Domain); 20] = [
    ("gravity", AnySign), ("mass", Positive),
    ("center_of_mass_x", AnySign), ("center_of_mass_y", AnySign), ("center_of_mass_z", AnySign),
    ("inertia_xx", Positive), ("inertia_yy", Positive), ("inertia_zz", Positive),
    ("inertia_xy", AnySign), ("inertia_xz", AnySign), ("inertia_yz", AnySign),
    ("linear_drag_x", NonNegative), ("linear_drag_y", NonNegative), ("linear_drag_z", NonNegative),
    ("quadratic_drag_x", NonNegative), ("quadratic_drag_y", NonNegative), ("quadratic_drag_z", NonNegative),
    ("angular_drag_x", NonNegative), ("angular_drag_y", NonNegative), ("angular_drag_z", NonNegative),
];

/// Physical parameters of a vehicle as one vector, `BODY_PARAMETERS` then [`ROTOR_PARAMETERS`] per rotor: what
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

/// Names of the entries of [`parameter_vector`].
pub fn parameter_names(vehicle: &Vehicle) -> Vec<String> {
    let body = BODY_PARAMETERS.iter().map(|(name, _)| name.to_string());
    body.chain(vehicle.rotors.iter().flat_map(Rotor::parameter_names)).collect()
}

/// What each entry of [`parameter_vector`] may be.
pub fn parameter_domains(vehicle: &Vehicle) -> Vec<Domain> {
    let rotors = vehicle.rotors.iter().flat_map(|_| ROTOR_PARAMETERS.iter().map(|p| p.domain));
    BODY_PARAMETERS.iter().map(|(_, domain)| *domain).chain(rotors).collect()
}

/// The vehicle that a [`parameter_vector`] describes, as one part; names and whatever the vector leaves out are those of
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
    let inertia = Inertia { xx: body[5], yy: body[6], zz: body[7], xy: body[8], xz: body[9], yz: body[10] };
    let mut own = vehicle.clone();
    own.parts = vec![Part::new("body", body[1], three(2), inertia)];
    (own.drag.linear, own.drag.quadratic, own.drag.angular) = (three(11), three(14), three(17));
    for (rotor, values) in own.rotors.iter_mut().zip(rotors.as_chunks().0) {
        rotor.set_parameters(values);
    }
    own.validate()?;
    Ok(own)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::vehicles;

    #[test]
    fn a_vehicle_of_other_numbers_has_those_numbers() {
        for name in vehicles::names() {
            let vehicle = vehicles::by_name(name).unwrap();
            let mut wanted = parameter_vector(&vehicle);
            wanted[1] *= 1.3;
            wanted[4] += 0.01;
            let thrust = BODY_PARAMETERS.len() + crate::dynamics::rotor::at::thrust_coefficient;
            wanted[thrust] *= 0.9;
            let own = vehicle_of(&vehicle, &wanted).unwrap();
            let off = parameter_vector(&own).iter().zip(&wanted).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs()));
            assert!(off < 1e-12, "{name}: {off:e}");
            assert!(vehicle_of(&vehicle, &wanted[1..]).is_err());
        }
    }
}
